//! Walls that a case adds: closed forms, balance, frames, and what must not be felt.

use glam::{DQuat, DVec3};
use porograin::contact::{Contacts, Law, Linear};
use porograin::grains::Push;
use porograin::walls::{self, Mesh, Motion, Place, Shape, Wall, stl};
use porograin::{Domain, Face, Grains, Model, Signal, State, TimeStep, Work, step};
use std::sync::Arc;

fn model(shapes: Vec<(Shape, Motion)>, friction: f64) -> Model {
    let wall = |(k, (shape, motion)): (usize, (Shape, Motion))| Wall {
        name: format!("wall-{k}").as_str().into(),
        shape,
        motion,
        friction,
        present: true,
        glue: false,
        first: 0,
    };
    let mut walls: Vec<Wall> = shapes.into_iter().enumerate().map(wall).collect();
    walls::number(&mut walls);
    Model {
        time_step: TimeStep::Automatic { safety: 0.2 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e7, 0.5, friction)).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| Face::default()),
        walls,
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn state(grains: Grains, model: &Model) -> State {
    let mut domain = Domain::walled(DVec3::splat(-2.0), DVec3::splat(2.0));
    domain.walls = vec![Place::default(); model.walls.len()];
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
}

fn one(position: DVec3, radius: f64) -> Grains {
    Grains::at_rest(vec![position], vec![radius], 1000.0)
}

fn energy(grains: &Grains, k: usize) -> f64 {
    0.5 * (grains.mass[k] * grains.velocity[k].length_squared()
        + grains.inertia(k) * grains.spin[k].length_squared())
}

fn fixed(shape: Shape) -> (Shape, Motion) {
    (shape, Motion::Fixed)
}

fn mesh(mesh: Mesh) -> Shape {
    Shape::Mesh(Arc::new(mesh))
}

fn plane(point: DVec3, normal: DVec3) -> Shape {
    Shape::Plane { point, normal: normal.normalize() }
}

/// A square of side 2 about `centre`, cut into `n` x `n` squares of two triangles that are wound at random.
fn tiles(centre: DVec3, a: DVec3, b: DVec3, n: usize) -> Vec<[DVec3; 3]> {
    let at = |i: usize, j: usize| {
        let part = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
        centre + part(i) * a + part(j) * b
    };
    let mut all = Vec::new();
    for i in 0..n {
        for j in 0..n {
            let (p, q, r, s) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            all.push(if (i + j) % 3 == 0 { [p, q, r] } else { [q, p, r] });
            all.push([p, r, s]);
        }
    }
    all
}

/// One of each shape with a direction from which a grain of radius 0.1 hits it, and where it is then. Edges and corners too.
fn targets() -> Vec<(&'static str, Shape, DVec3, DVec3)> {
    let tilted = DVec3::new(0.36, -0.48, 0.8);
    let disc = || Shape::Disc { centre: DVec3::ZERO, normal: tilted, radius: 0.4 };
    let tube = |length| Shape::Cylinder { point: DVec3::ZERO, axis: tilted, radius: 0.5, length };
    let (a, b) = tilted.any_orthonormal_pair();
    let plate = || mesh(Mesh::rectangle(-0.5 * (a + b), a, b).unwrap());
    let cuboid = || mesh(Mesh::cuboid(DVec3::splat(-0.3), DVec3::splat(0.3)).unwrap());
    vec![
        ("plane", plane(DVec3::ZERO, tilted), -tilted, DVec3::ZERO),
        ("disc, face", disc(), -tilted, 0.2 * a),
        ("disc, rim", disc(), -(a + tilted).normalize(), 0.4 * a),
        ("tube, from inside", tube(None), a, 0.5 * a),
        ("tube, from outside", tube(Some(1.0)), -a, 0.5 * a + 0.3 * tilted),
        ("tube, its end", tube(Some(1.0)), tilted, 0.5 * b),
        ("rectangle, face", plate(), tilted, 0.1 * a + 0.2 * b),
        ("rectangle, edge", plate(), -a, 0.5 * a + 0.2 * b),
        ("rectangle, corner", plate(), -(a + b).normalize(), 0.5 * (a + b)),
        ("box, outside", cuboid(), DVec3::NEG_X, DVec3::new(0.3, 0.1, -0.1)),
        ("box, edge", cuboid(), -DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.3, 0.3, 0.1)),
        ("box, corner", cuboid(), -DVec3::ONE.normalize(), DVec3::splat(0.3)),
        ("box, inside", cuboid(), DVec3::X, DVec3::new(0.3, 0.1, -0.1)),
    ]
}

/// A grain that hits any part of any shape head on comes back with its energy, and meanwhile force and moment balance.
#[test]
fn grains_bounce_elastically_off_every_part_of_every_shape() {
    for (name, shape, toward, foot) in targets() {
        let mut model = model(vec![fixed(shape)], 20.0);
        model.time_step = TimeStep::Automatic { safety: 0.05 };
        let mut grains = one(foot - 0.101 * toward, 0.1);
        grains.velocity[0] = 0.3 * toward;
        let before = energy(&grains, 0);
        let mut state = state(grains, &model);
        let mut work = Work::default();
        let mut met = 0;
        for _ in 0..20_000 {
            let x = state.grains.position[0];
            step(&mut state, &model, &mut work).unwrap();
            if !state.contacts.is_empty() {
                met += 1;
                assert_eq!(state.contacts.len(), 1, "{name}");
            }
            let Push { force, moment } = work.loads.walls[0];
            assert!((force + work.loads.force[0]).length() < 1e-12 * (1.0 + force.length()), "{name}");
            let centre = model.walls[0].shape.centre();
            let about = (x - centre).cross(work.loads.force[0]) + work.loads.torque[0];
            assert!((moment + about).length() < 1e-12 * (1.0 + force.length()), "{name}");
            if met > 0 && state.contacts.is_empty() {
                break;
            }
        }
        assert!(met > 10, "{name} was not met");
        let after = energy(&state.grains, 0);
        assert!((after / before - 1.0).abs() < 2e-3, "{name}: {before} {after}");
        assert!(
            (state.grains.velocity[0] + 0.3 * toward).length() < 1e-3,
            "{name}: {}",
            state.grains.velocity[0]
        );
    }
}

/// A grain in the corner of a box meets three sides at once, one before a convex corner one.
#[test]
fn a_room_has_a_foot_on_each_wall_of_a_corner() {
    let room = Mesh::cuboid(DVec3::ZERO, DVec3::ONE).unwrap();
    assert_eq!(room.census(), [6, 12, 8]);
    let feet = |x: DVec3| {
        let (mut near, mut found) = (Vec::new(), Vec::new());
        room.near(x, 0.1, &mut near);
        room.feet(x, &near, &mut found);
        found.len()
    };
    assert_eq!(feet(DVec3::splat(0.05)), 3);
    assert_eq!(feet(DVec3::new(0.05, 0.05, 0.5)), 2);
    assert_eq!(feet(DVec3::new(-0.05, 0.05, 0.5)), 1);
    assert_eq!(feet(DVec3::splat(-0.05)), 1);
    assert_eq!(feet(DVec3::splat(0.5)), 0);
}

/// Everything turned: grains, walls, gravity. The motion is the turned one.
#[test]
fn motion_on_walls_does_not_depend_on_the_frame() {
    let frame = DQuat::from_scaled_axis(DVec3::new(0.7, -1.1, 0.4));
    let down = DVec3::new(0.3, -0.2, -9.8);
    let place = |turn: DQuat| {
        let t = |x: DVec3| turn * x;
        let tri = |list: Vec<[DVec3; 3]>| list.into_iter().map(|c| c.map(t)).collect::<Vec<_>>();
        let floor = tri(tiles(DVec3::new(0.0, 0.0, -0.5), DVec3::X, DVec3::Y, 4));
        let shapes = vec![
            fixed(mesh(Mesh::new(&floor).unwrap())),
            (
                Shape::Cylinder { point: t(DVec3::ZERO), axis: t(DVec3::Y), radius: 0.6, length: None },
                Motion::Rotating {
                    point: [0.0; 3],
                    axis: t(DVec3::Y).to_array(),
                    rate: Signal::Constant(1.5),
                },
            ),
            fixed(plane(t(DVec3::new(0.0, 0.3, 0.0)), t(DVec3::new(0.0, -1.0, 0.2)))),
        ];
        let mut model = model(shapes, 25.0);
        model.gravity = t(down);
        model.time_step = TimeStep::Fixed(5e-5);
        let at = [DVec3::new(0.1, 0.0, -0.39), DVec3::new(-0.2, 0.1, -0.3), DVec3::new(0.0, 0.12, -0.1)];
        let mut grains = Grains::at_rest(at.map(t).to_vec(), vec![0.1, 0.12, 0.09], 1000.0);
        grains.velocity[0] = t(DVec3::new(2.0, 0.3, 0.0));
        grains.spin[1] = t(DVec3::new(0.0, 2.0, 3.0));
        let mut state = state(grains, &model);
        let mut work = Work::default();
        let mut met = [0; 3];
        for _ in 0..6000 {
            step(&mut state, &model, &mut work).unwrap();
            for (met, load) in met.iter_mut().zip(&work.loads.walls) {
                *met += i32::from(load.force != DVec3::ZERO);
            }
        }
        assert!(met.iter().all(|&met| met > 100), "{met:?}");
        state
    };
    let (straight, turned) = (place(DQuat::IDENTITY), place(frame));
    for k in 0..3 {
        let apart = (frame * straight.grains.position[k]).distance(turned.grains.position[k]);
        assert!(apart < 1e-9, "grain {k}: {apart}");
        let apart = (frame * straight.grains.spin[k]).distance(turned.grains.spin[k]);
        assert!(apart < 1e-6, "grain {k}: {apart}");
    }
    let [a, b] = [&straight, &turned].map(|s| s.domain.walls[1]);
    assert!((frame * a.force).distance(b.force) < 1e-6 && (frame * a.moment).distance(b.moment) < 1e-6);
}

/// A sphere let go on a tilted plane rolls with 5/7 g sin(tilt) below the friction it takes, 2/7 tan(tilt), and slides with
/// g (sin(tilt) - mu cos(tilt)) above.
#[test]
fn a_sphere_on_a_tilted_plane_rolls_or_slides() {
    let gravity = 10.0;
    let tilt: f64 = 0.5;
    let along = DVec3::new(tilt.cos(), 0.0, -tilt.sin());
    let normal = DVec3::new(tilt.sin(), 0.0, tilt.cos());
    for (friction, rolls) in [(20.0_f64, true), (5.0, false)] {
        let mu = friction.to_radians().tan();
        assert_eq!(mu > 2.0 / 7.0 * tilt.tan(), rolls);
        for shape in [
            plane(DVec3::ZERO, normal),
            mesh(Mesh::rectangle(-along - DVec3::Y, 3.0 * along, 2.0 * DVec3::Y).unwrap()),
        ] {
            let mut model = model(vec![fixed(shape)], friction);
            model.contact = Law::Linear(Linear::new(1e8, 0.5, friction)).into();
            model.gravity = DVec3::new(0.0, 0.0, -gravity);
            let mut grains = one(DVec3::ZERO, 0.1);
            let sink = grains.mass[0] * gravity * tilt.cos() / (1e8 * 0.1);
            grains.position[0] = (0.1 - sink) * normal;
            let mut state = state(grains, &model);
            let mut work = Work::default();
            while state.time < 0.3 {
                step(&mut state, &model, &mut work).unwrap();
            }
            let expected = if rolls { 5.0 / 7.0 * tilt.sin() } else { tilt.sin() - mu * tilt.cos() };
            let time = state.time - 0.5 * state.dt;
            let found = state.grains.velocity[0].dot(along) / time / gravity;
            assert!((found / expected - 1.0).abs() < 2e-3, "friction {friction}: {found} {expected}");
        }
    }
}

/// A sphere that rolls to and fro at the bottom of a tube: 2 pi sqrt(7 (R - r) / (5 g)).
#[test]
fn a_sphere_in_a_tube_swings_with_the_period_of_theory() {
    let (gravity, wide, radius, angle) = (10.0, 1.0, 0.1, 0.02_f64);
    let axis = DVec3::new(0.6, 0.8, 0.0);
    let shape = Shape::Cylinder { point: DVec3::ZERO, axis, radius: wide, length: None };
    let mut model = model(vec![fixed(shape)], 40.0);
    model.contact = Law::Linear(Linear::new(1e9, 0.8, 40.0)).into();
    model.gravity = DVec3::new(0.0, 0.0, -gravity);
    let side = DVec3::Z.cross(axis);
    let place = |angle: f64| (wide - radius) * (angle.sin() * side - angle.cos() * DVec3::Z);
    let mut state = state(one(place(angle), radius), &model);
    let mut work = Work::default();
    let mut crossings = Vec::new();
    let mut before = 1.0;
    while crossings.len() < 5 {
        step(&mut state, &model, &mut work).unwrap();
        let now = state.grains.position[0].dot(side);
        if now * before < 0.0 {
            crossings.push(state.time - state.dt * now.abs() / (now - before).abs());
        }
        before = now;
    }
    let found = (crossings[4] - crossings[0]) / 2.0;
    let expected = std::f64::consts::TAU * (7.0 * (wide - radius) / (5.0 * gravity)).sqrt();
    // The finite angle adds angle²/16.
    assert!((found / expected - 1.0 - angle * angle / 16.0).abs() < 3e-4, "{found} {expected}");
}

/// A sphere that slides, then rolls across the edges of coplanar triangles moves as it does on a plane.
#[test]
fn edges_between_coplanar_triangles_are_not_felt() {
    let run = |shape: Shape| {
        let mut model = model(vec![fixed(shape)], 20.0);
        model.gravity = DVec3::new(0.0, 0.0, -10.0);
        model.time_step = TimeStep::Fixed(1e-4);
        let mut grains = one(DVec3::new(-0.8, -0.71, 0.0), 0.1);
        grains.position[0].z = 0.1 - grains.mass[0] * 10.0 / (1e7 * 0.1);
        grains.velocity[0] = DVec3::new(1.5, 1.3, 0.0);
        grains.spin[0] = DVec3::new(0.0, 1.0, 2.0);
        let mut state = state(grains, &model);
        let mut work = Work::default();
        while state.time < 1.0 {
            step(&mut state, &model, &mut work).unwrap();
            assert_eq!(state.contacts.len(), 1);
        }
        state.grains
    };
    let smooth = run(plane(DVec3::ZERO, DVec3::Z));
    let mesh_of = |n: usize| Mesh::new(&tiles(DVec3::ZERO, DVec3::X, DVec3::Y, n)).unwrap();
    assert_eq!(mesh_of(7).census(), [1, 28, 28]);
    for n in [1, 4, 7] {
        let tiled = run(mesh(mesh_of(n)));
        assert!(smooth.position[0].distance(tiled.position[0]) < 1e-12, "{n}");
        assert!(smooth.spin[0].distance(tiled.spin[0]) < 1e-10, "{n}");
    }
}

/// Over a convex edge the contact goes on without a jump of the force: a sphere pivots about the edge of a table as it falls.
#[test]
fn a_contact_goes_on_over_an_edge() {
    let table = Mesh::cuboid(DVec3::new(-1.0, -1.0, -1.0), DVec3::new(0.0, 1.0, 0.0)).unwrap();
    let mut model = model(vec![fixed(mesh(table))], 30.0);
    model.gravity = DVec3::new(0.0, 0.0, -10.0);
    let mut grains = one(DVec3::new(-0.05, 0.0, 0.0), 0.1);
    let sink = grains.mass[0] * 10.0 / (1e7 * 0.1);
    grains.position[0].z = 0.1 - sink;
    grains.velocity[0].x = 0.2;
    grains.spin[0].y = 2.0;
    let mut state = state(grains, &model);
    let mut work = Work::default();
    let (mut last, mut parts): (Option<DVec3>, Vec<u32>) = (None, Vec::new());
    while state.grains.position[0].x < 0.04 {
        step(&mut state, &model, &mut work).unwrap();
        assert_eq!(state.contacts.len(), 1);
        parts.extend(state.contacts.pairs().map(|pair| pair[1]));
        let force = work.loads.walls[0].force;
        if let Some(last) = last {
            assert!(last.distance(force) < 0.02 * state.grains.mass[0] * 10.0, "{last} {force}");
        }
        last = Some(force);
    }
    parts.dedup();
    assert_eq!(parts.len(), 2, "{parts:?}");
}

/// A plate on a grain carries what it is pushed with, and moves only along its direction; a turning drum drags a grain along.
#[test]
fn servoed_moving_and_turning_walls() {
    let push = 30.0;
    let along = DVec3::new(0.0, -0.6, -0.8);
    let (a, b) = along.any_orthonormal_pair();
    let plate = mesh(Mesh::rectangle(-0.201 * along - a - b, 2.0 * a, 2.0 * b).unwrap());
    let servo = Motion::Servo {
        along: (5.0 * along).to_array(),
        load: walls::motion::Servoed::Force(Signal::Constant(push)),
        area: None,
        mass: Some(2.0),
        speed: None,
    };
    let mut pressed = model(vec![(plate, servo), fixed(plane(DVec3::ZERO, -along))], 0.0);
    pressed.damping = 0.3;
    let mut now = state(one(-0.1 * along, 0.1), &pressed);
    let mut work = Work::default();
    while now.time < 0.5 {
        step(&mut now, &pressed, &mut work).unwrap();
    }
    let place = now.domain.walls[0];
    assert!((place.force.dot(-along) / push - 1.0).abs() < 1e-3, "{}", place.force);
    assert!(place.shift.cross(along).length() < 1e-12 && place.shift.length() > 1e-4);
    // A plane is endless: what a stress on it acts on is for the case to say. Of a plate it is its own area, unless the case says another.
    let stress = |area| Motion::Servo {
        along: along.to_array(),
        load: walls::motion::Servoed::Stress(Signal::Constant(6.0)),
        area,
        mass: None,
        speed: None,
    };
    let asked = |shape, area| walls::motion::asked(&model(vec![(shape, stress(area))], 0.0).walls[0], 0.0);
    assert_eq!(asked(plane(DVec3::ZERO, -along), Some(5.0)), Some(push));
    let plate = || mesh(Mesh::rectangle(-0.201 * along - a - b, 2.0 * a, 2.0 * b).unwrap());
    assert!((asked(plate(), None).unwrap() / 24.0 - 1.0).abs() < 1e-12);
    assert_eq!(asked(plate(), Some(5.0)), Some(push));

    // A grain inside a turning tube without gravity ends up turning with it.
    let tube = Shape::Cylinder { point: DVec3::ZERO, axis: DVec3::Y, radius: 0.5, length: None };
    let turning = Motion::Rotating { point: [0.0; 3], axis: [0.0, 2.0, 0.0], rate: Signal::Constant(3.0) };
    let model = model(vec![(tube, turning)], 45.0);
    let mut grains = one(DVec3::new(0.400015, 0.0, 0.0), 0.1);
    grains.velocity[0] = DVec3::new(0.0, 0.0, -1.2);
    grains.spin[0] = DVec3::new(0.0, 3.0, 0.0);
    let mut state = state(grains, &model);
    let mut work = Work::default();
    while state.time < 1.0 {
        step(&mut state, &model, &mut work).unwrap();
    }
    let x = state.grains.position[0];
    let speed = DVec3::new(0.0, 3.0, 0.0).cross(x);
    assert!((state.grains.velocity[0] - speed).length() < 0.01 * speed.length());
    assert!((state.grains.spin[0] - DVec3::new(0.0, 3.0, 0.0)).length() < 0.05);
    let turned = state.domain.walls[0].turn.to_scaled_axis();
    assert!((turned - DVec3::new(0.0, 3.0 * state.time, 0.0)).length() < 1e-9);
}

/// Binary and in words, a file gives the same surface; what is wrong is told with its place.
#[test]
fn stl_files_in_both_forms() {
    let triangles = tiles(DVec3::ZERO, DVec3::X, DVec3::Y, 2);
    let mut words = String::from("solid tiles\n");
    let mut bytes = vec![0_u8; 80];
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for corners in &triangles {
        words += " facet normal 0 0 1\n  outer loop\n";
        bytes.extend([0_u8; 12]);
        for x in corners {
            words += &format!("   vertex {} {:e} {}\n", x.x, x.y, x.z);
            x.to_array().iter().for_each(|&c| bytes.extend((c as f32).to_le_bytes()));
        }
        words += "  endloop\n endfacet\n";
        bytes.extend([0_u8; 2]);
    }
    words += "endsolid tiles\n";
    assert_eq!(stl::read(words.as_bytes()).unwrap(), triangles);
    assert_eq!(stl::read(&bytes).unwrap(), triangles);
    let said = |bytes: &[u8]| stl::read(bytes).unwrap_err().to_string();
    assert_eq!(
        said(&bytes[..200]),
        "byte 200: the file ends here, but its 8 triangles take 484 bytes in all"
    );
    assert!(said(b"nonsense").starts_with("byte 8: the file ends within its head"));
    assert_eq!(said(words.replacen("vertex -1", "vertex -l", 1).as_bytes()), "line 4: `-l` is no coordinate");
    assert_eq!(
        said(&words.as_bytes()[..words.len() - 15]),
        "line 57: the file ends here, but there is no `endsolid`"
    );
    bytes[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(said(&bytes), "byte 96: NaN is no coordinate");
    for bad in [&bytes[..83], &[][..], b"solid", b"solid\nendsolid", &[0xff; 84][..]] {
        let _ = stl::read(bad);
    }
}

/// Many grains among walls of all kinds that move: the same bits with the scratch dropped after every step, and momentum is
/// what the walls and gravity give.
#[test]
fn grains_among_moving_walls_give_the_same_bits_without_the_scratch() {
    let floor = tiles(DVec3::new(0.0, 0.0, -0.5), DVec3::X, DVec3::Y, 6);
    let mixer =
        Mesh::rectangle(DVec3::new(-0.5, -0.3, -0.45), DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.0, 0.1, 0.5));
    let turning = Motion::Rotating { point: [0.0; 3], axis: [0.0, 0.0, 1.0], rate: Signal::Constant(4.0) };
    let shaken = Motion::Moving {
        velocity: [
            Signal::Sine { mean: 0.0, amplitude: 0.3, period: 0.1, start: 0.0 },
            Signal::Constant(0.0),
            Signal::Constant(0.0),
        ],
    };
    let mut model = model(
        vec![
            (mesh(Mesh::new(&floor).unwrap()), shaken),
            (mesh(mixer.unwrap()), turning),
            fixed(Shape::Cylinder { point: DVec3::ZERO, axis: DVec3::Z, radius: 0.7, length: Some(0.8) }),
        ],
        30.0,
    );
    model.gravity = DVec3::new(0.0, 0.0, -10.0);
    let mut position = Vec::new();
    for k in 0..200 {
        let [i, j, l] = [k % 8, k / 8 % 8, k / 64].map(f64::from);
        position.push(DVec3::new(0.121 * i - 0.43 + 0.01 * l, 0.12 * j - 0.42, 0.12 * l - 0.1));
    }
    let grains = Grains::at_rest(position, vec![0.05; 200], 1000.0);
    let clear = |x: &DVec3| x.truncate().length() < 0.64 && !(-0.36..-0.14).contains(&x.y);
    let keep: Vec<usize> = (0..200).filter(|&k| clear(&grains.position[k])).collect();
    let grains =
        Grains::at_rest(keep.iter().map(|&k| grains.position[k]).collect(), vec![0.05; keep.len()], 1000.0);
    let start = state(grains, &model);
    let run = |drop: bool| {
        let mut state = start.clone();
        let mut work = Work::default();
        let mut most = 0;
        for _ in 0..1500 {
            if drop {
                work = Work::default();
            }
            let before: DVec3 =
                state.grains.velocity.iter().zip(&state.grains.mass).map(|(v, m)| *v * *m).sum();
            let kick = state.dt;
            step(&mut state, &model, &mut work).unwrap();
            let after: DVec3 =
                state.grains.velocity.iter().zip(&state.grains.mass).map(|(v, m)| *v * *m).sum();
            let weight = state.grains.mass.iter().sum::<f64>() * model.gravity;
            let given = weight - work.loads.walls.iter().map(|w| w.force).sum::<DVec3>();
            let kick = 0.5 * (kick + state.dt);
            let off = (after - before - kick * given).length();
            assert!(
                off < 1e-9,
                "step {}: {off} {:?} {:?}",
                state.step,
                work.loads.wall,
                state.contacts.len()
            );
            let parts = state.contacts.pairs().filter(|pair| walls::is_part(pair[1])).count();
            most = most.max(parts);
        }
        assert!(most > 25, "{most}");
        state
    };
    assert_eq!(run(false), run(true));
}

/// Grains that touch a plate when the glue is switched on are one body with it; others, and all when it is off, are free.
#[test]
fn glued_grains_are_one_body_with_their_plate() {
    let disc = Shape::Disc { centre: DVec3::new(0.1, 0.0, 0.0), normal: DVec3::Z, radius: 0.6 };
    let turning =
        Motion::Rotating { point: [0.1, 0.0, 0.0], axis: [0.0, 0.0, 1.0], rate: Signal::Constant(2.0) };
    let mut model = model(vec![(disc, turning)], 0.0);
    model.time_step = TimeStep::Fixed(1e-4);
    model.walls[0].glue = true;
    let start = vec![DVec3::new(0.4, 0.1, 0.0999), DVec3::new(-0.2, 0.0, 0.45)];
    let mut now = state(Grains::at_rest(start.clone(), vec![0.1, 0.1], 1000.0), &model);
    let mut work = Work::default();
    let angle = |now: &State| 2.0 * now.time;
    let expected = |now: &State, k: usize| {
        let c = DVec3::new(0.1, 0.0, 0.0);
        c + DQuat::from_rotation_z(angle(now)) * (start[k] - c)
    };
    while now.time < 2.0 {
        work = if now.step % 7 == 0 { Work::default() } else { work };
        step(&mut now, &model, &mut work).unwrap();
    }
    assert_eq!(now.domain.glue.grains, [[0, 6]]);
    assert!(now.grains.position[0].distance(expected(&now, 0)) < 1e-10);
    assert_eq!(now.grains.position[1], start[1]);
    assert!((now.grains.spin[0] - DVec3::new(0.0, 0.0, 2.0)).length() < 1e-12);
    // Thrown off along the tangent once the glue is off; the plate is smooth.
    model.walls[0].glue = false;
    let speed = now.grains.velocity[0];
    while now.time < 2.2 {
        step(&mut now, &model, &mut work).unwrap();
    }
    assert!(now.domain.glue.is_empty());
    assert!((now.grains.velocity[0] - speed).truncate().length() < 1e-3 * speed.length());

    // A piston with a grain stuck to it is as heavy as both, and feels what pushes the grain.
    let mut model = self::model(vec![], 0.0);
    model.faces[4].solid =
        porograin::Solid::Servo { stress: Signal::Constant(1.0), mass: Some(3.0), speed: Some(1e9) };
    model.faces[4].glue = true;
    model.gravity = DVec3::new(0.0, 0.0, -0.5);
    model.time_step = TimeStep::Fixed(1e-3);
    let mut now = state(one(DVec3::new(0.0, 0.0, -1.901), 0.1), &model);
    let mass = now.grains.mass[0];
    let mut work = Work::default();
    for _ in 0..100 {
        step(&mut now, &model, &mut work).unwrap();
    }
    // The face is 4 m square; the first step finds the velocity of half a step later.
    let expected = (16.0 - 0.5 * mass) / (3.0 + mass) * (now.time - 0.5 * now.dt);
    let found = now.domain.wall_velocity[4].z;
    assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    assert_eq!(now.grains.velocity[0].z, found);
}
