//! A few grains whose motion is known, and many whose invariants are.

use glam::{DMat3, DQuat, DVec3};
use porograin::contact::{Contacts, Law, Linear};
use porograin::trouble::Trouble;
use porograin::{Domain, Face, Grains, Model, Signal, Solid, State, StepError, TimeStep, Work, step};

fn model(stiffness_ratio: f64, friction: f64) -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.3 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, stiffness_ratio, friction)).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| Face { friction, ..Face::default() }),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn state(grains: Grains, size: f64) -> State {
    State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::splat(-size), DVec3::splat(size)),
        grains,
        contacts: Contacts::default(),
        fluid: None,
    }
}

fn kinetic(grains: &Grains) -> f64 {
    (0..grains.len())
        .map(|k| {
            0.5 * grains.mass[k] * grains.velocity[k].length_squared()
                + 0.5 * grains.inertia(k) * grains.spin[k].length_squared()
        })
        .sum()
}

/// Random grains, some overlapping by up to a tenth, with velocities and spins.
fn cloud(n: usize, size: f64, seed: u64) -> Grains {
    let mut bits = seed;
    let mut next = || {
        bits = bits.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (bits >> 11) as f64 / (1u64 << 53) as f64
    };
    let (mut position, mut radius): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while position.len() < n {
        let x = size * DVec3::new(2.0 * next() - 1.0, 2.0 * next() - 1.0, 2.0 * next() - 1.0);
        let r = 0.08 + 0.04 * next();
        if position.iter().zip(&radius).all(|(y, s)| x.distance(*y) > 0.95 * (r + s)) {
            position.push(x);
            radius.push(r);
        }
    }
    let mut grains = Grains::at_rest(position, radius, 1000.0);
    for k in 0..n {
        grains.velocity[k] = 0.2 * DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
        grains.spin[k] = 2.0 * DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
    }
    grains
}

/// Two unequal grains meet head-on and part again: the kinetic energy lost or gained falls as dt².
#[test]
fn a_head_on_collision_keeps_the_energy_to_second_order() {
    let worst = |dt: f64| {
        // The phases at which the grains meet and part within a step matter: take the worst of many.
        (0..400)
            .map(|phase| {
                let apart = 0.25 + 0.2 * dt * (phase % 20) as f64 / 20.0;
                let dt = dt * (1.0 + 0.01 * (phase / 20) as f64);
                let position = vec![DVec3::ZERO, DVec3::new(apart, 0.0, 0.0)];
                let mut grains = Grains::at_rest(position, vec![0.1, 0.15], 1000.0);
                grains.velocity[0].x = 0.2;
                let before = kinetic(&grains);
                let mut state = state(grains, 2.0);
                let model = Model { time_step: TimeStep::Fixed(dt), ..model(0.5, 30.0) };
                let mut work = Work::default();
                let mut met = false;
                while !met || !state.contacts.is_empty() {
                    step(&mut state, &model, &mut work).unwrap();
                    met |= !state.contacts.is_empty();
                }
                assert!(state.grains.velocity[1].x > state.grains.velocity[0].x);
                (kinetic(&state.grains) / before - 1.0).abs()
            })
            .fold(0.0, f64::max)
    };
    let errors = [worst(4e-4), worst(2e-4), worst(1e-4)];
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.8..2.2).contains(&order), "{errors:?} order {order}");
    }
}

/// A sphere set sliding on a floor ends up rolling at 5/7 of its first speed.
#[test]
fn a_sliding_sphere_rolls_at_five_sevenths() {
    let gravity = 10.0;
    let mut model = Model { gravity: DVec3::new(0.0, 0.0, -gravity), ..model(0.5, 20.0) };
    model.contact = Law::Linear(Linear::new(1e8, 0.5, 20.0)).into();
    let mut grains = Grains::at_rest(vec![DVec3::ZERO], vec![0.1], 1000.0);
    // Resting on the floor: k_n d = m g.
    let sink = grains.mass[0] * gravity / (1e8 * 0.1);
    grains.position[0].z = -1.0 + 0.1 - sink;
    grains.velocity[0].x = 0.5;
    let mut state = state(grains, 1.0);
    let mut work = Work::default();
    let (mut slid, mut mean, mut count) = (0.0, 0.0, 0.0);
    while state.time < 0.2 {
        step(&mut state, &model, &mut work).unwrap();
        if state.grains.velocity[0].x > 0.5 * 5.0 / 7.0 + 4e-3 {
            slid = state.time;
        }
        // The shear spring swings a little about rolling: take the mean of many swings.
        if state.time > 0.1 {
            mean += state.grains.velocity[0].x;
            count += 1.0;
        }
    }
    let (v, w) = (state.grains.velocity[0], state.grains.spin[0]);
    mean /= count;
    assert!((mean / 0.5 - 5.0 / 7.0).abs() < 2e-4, "{}", mean / 0.5);
    assert!((w.y * 0.1 / mean - 1.0).abs() < 0.02 && w.x == 0.0 && v.y == 0.0);
    // Sliding lasts 2 v0/(7 mu g).
    let expected = 2.0 * 0.5 / (7.0 * 20f64.to_radians().tan() * gravity);
    assert!((slid / expected - 1.0).abs() < 0.05, "{slid} {expected}");
}

#[test]
fn momentum_and_its_moment_are_kept() {
    let mut state = state(cloud(60, 0.35, 3), 10.0);
    let (model, mut work) = (model(0.5, 30.0), Work::default());
    let momentum = |g: &Grains| (0..g.len()).map(|k| g.mass[k] * g.velocity[k]).sum::<DVec3>();
    let spin = |g: &Grains| {
        (0..g.len())
            .map(|k| g.mass[k] * g.position[k].cross(g.velocity[k]) + g.inertia(k) * g.spin[k])
            .sum::<DVec3>()
    };
    let size: f64 = (0..60).map(|k| state.grains.mass[k] * state.grains.velocity[k].length()).sum();
    let (before, turning) = (momentum(&state.grains), spin(&state.grains));
    for _ in 0..2000 {
        step(&mut state, &model, &mut work).unwrap();
    }
    assert!((momentum(&state.grains) - before).length() < 1e-12 * size);
    assert!((spin(&state.grains) - turning).length() < 1e-11 * size);
}

/// How a state looks in a turned or mirrored frame.
fn seen(state: &State, frame: DMat3) -> State {
    let mut other = state.clone();
    let handed = frame.determinant();
    other.grains.position.iter_mut().for_each(|x| *x = frame * *x);
    other.grains.velocity.iter_mut().for_each(|v| *v = frame * *v);
    other.grains.spin.iter_mut().for_each(|w| *w = handed * (frame * *w));
    let (a, b) = (frame * state.domain.cell.origin, frame * state.domain.cell.upper());
    other.domain = Domain::walled(a.min(b), a.max(b));
    for face in 0..6 {
        let to = face_seen(face, frame);
        other.domain.wall_velocity[to] = frame * state.domain.wall_velocity[face];
        other.domain.wall_force[to] = frame * state.domain.wall_force[face];
    }
    other
}

fn face_seen(face: usize, frame: DMat3) -> usize {
    let normal = frame * porograin_geometry::cell::NORMALS[face];
    porograin_geometry::cell::NORMALS.iter().position(|n| n.distance(normal) < 1e-12).unwrap()
}

fn differ(a: &State, b: &State) -> f64 {
    let far = |p: &[DVec3], q: &[DVec3]| p.iter().zip(q).map(|(x, y)| x.distance(*y)).fold(0.0, f64::max);
    far(&a.grains.position, &b.grains.position)
        .max(far(&a.grains.velocity, &b.grains.velocity))
        .max(0.1 * far(&a.grains.spin, &b.grains.spin))
        .max(a.domain.cell.upper().distance(b.domain.cell.upper()))
        .max(a.domain.cell.origin.distance(b.domain.cell.origin))
}

#[test]
fn the_axes_are_alike_and_so_are_left_and_right() {
    let start = state(cloud(150, 0.55, 4), 0.6);
    let mut model = model(0.5, 30.0);
    model.damping = 0.1;
    model.gravity = DVec3::new(1.0, -2.0, 0.5);
    model.faces[5].solid =
        Solid::Servo { stress: Signal::Constant(2e3), mass: Some(200.0), speed: Some(0.3) };
    model.faces[1].solid =
        Solid::Moving { velocity: [Signal::Constant(-0.3), Signal::Constant(0.4), Signal::Constant(-0.2)] };
    let run = |mut state: State, model: &Model| {
        let mut work = Work::default();
        for _ in 0..250 {
            step(&mut state, model, &mut work).unwrap();
        }
        state
    };
    let end = run(start.clone(), &model);
    assert!(
        end.contacts.len() > 50 && end.domain.cell.upper().z < 0.599,
        "{} {}",
        end.contacts.len(),
        end.domain.cell.upper()
    );
    let frames = [
        DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
        DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::Z),
        DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)),
        DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
    ];
    for frame in frames {
        let mut turned = Model { gravity: frame * model.gravity, ..model.clone() };
        for face in 0..6 {
            let to = face_seen(face, frame);
            turned.faces[to] = model.faces[face].clone();
            if let Solid::Moving { velocity } = &model.faces[face].solid {
                let v = frame * DVec3::from_array(std::array::from_fn(|k| velocity[k].at(0.0)));
                turned.faces[to].solid = Solid::Moving { velocity: v.to_array().map(Signal::Constant) };
            }
        }
        let other = run(seen(&start, frame), &turned);
        let error = differ(&seen(&end, frame), &other);
        assert!(error < 1e-9, "{frame} {error}");
    }
}

#[test]
fn far_from_walls_any_direction_is_like_any_other() {
    let start = state(cloud(80, 0.38, 6), 20.0);
    let model = model(0.5, 30.0);
    let frame = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(1.0, -0.4, 0.7)));
    let mut start = start;
    for k in 0..80 {
        let inwards = -8.0 * start.grains.position[k];
        start.grains.velocity[k] += inwards;
    }
    let mut there = start.clone();
    there.grains.position.iter_mut().for_each(|x| *x = frame * *x);
    there.grains.velocity.iter_mut().for_each(|v| *v = frame * *v);
    there.grains.spin.iter_mut().for_each(|w| *w = frame * *w);
    let mut here = start;
    let (mut work, mut other, mut touched) = (Work::default(), Work::default(), 0);
    for _ in 0..200 {
        step(&mut here, &model, &mut work).unwrap();
        step(&mut there, &model, &mut other).unwrap();
        touched += here.contacts.len();
    }
    assert!(touched > 1000, "{touched}");
    for k in 0..80 {
        assert!(frame.mul_vec3(here.grains.position[k]).distance(there.grains.position[k]) < 1e-10);
        assert!(frame.mul_vec3(here.grains.spin[k]).distance(there.grains.spin[k]) < 1e-7);
    }
}

fn in_threads<T: Send>(threads: usize, job: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(job)
}

/// One and two threads, scratch kept or dropped at any step: the same bits.
#[test]
fn neither_threads_nor_scratch_change_a_bit() {
    let start = state(cloud(2600, 1.45, 8), 1.5);
    let mut model = model(0.5, 30.0);
    model.damping = 0.2;
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(5e3), mass: None, speed: None };
    let run = |threads: usize, keep: usize| {
        let (start, model) = (start.clone(), &model);
        in_threads(threads, move || {
            let (mut state, mut work) = (start, Work::default());
            for k in 0..250 {
                if k % keep == 0 {
                    work = Work::default();
                }
                step(&mut state, model, &mut work).unwrap();
            }
            state
        })
    };
    let reference = run(1, 1000);
    assert!(reference.contacts.len() > 300, "{}", reference.contacts.len());
    assert_eq!(reference, run(2, 1000));
    assert_eq!(reference, run(1, 1));
    assert_eq!(reference, run(2, 7));
}

#[test]
fn a_piston_settles_at_its_stress_and_a_decreed_wall_where_it_was_sent() {
    let mut state = state(cloud(200, 0.55, 5), 0.6);
    state.grains.velocity.fill(DVec3::ZERO);
    let mut model = model(0.5, 5.0);
    model.damping = 0.3;
    model.time_step = TimeStep::Automatic { safety: 0.6 };
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(1e4), mass: None, speed: None };
    let mut work = Work::default();
    for _ in 0..20_000 {
        step(&mut state, &model, &mut work).unwrap();
    }
    let stress = state.domain.wall_force[5].z / state.domain.area(5);
    assert!((stress / 1e4 - 1.0).abs() < 1e-3, "{stress}");
    assert!(state.domain.wall_force.iter().sum::<DVec3>().length() < 1e-3 * 1e4);

    model.faces[5].solid = Solid::Moving {
        velocity: [
            Signal::Constant(0.0),
            Signal::Constant(0.0),
            Signal::Table(vec![[0.0, 0.0], [0.1, 0.2], [0.2, 0.0]]),
        ],
    };
    model.stage_start = state.time;
    let (from, begun) = (state.domain.cell.upper().z, state.time);
    while state.time < begun + 0.25 {
        step(&mut state, &model, &mut work).unwrap();
    }
    assert!((state.domain.cell.upper().z - from - 0.02).abs() < 1e-5);
    assert_eq!(state.domain.wall_velocity[5], DVec3::ZERO);
}

#[test]
fn an_escaping_grain_and_a_nan_are_named() {
    let mut grains = Grains::at_rest(vec![DVec3::ZERO, DVec3::splat(0.5)], vec![0.1, 0.1], 1000.0);
    grains.id = vec![10, 11];
    grains.velocity[1] = DVec3::new(0.0, 1e6, 0.0);
    let mut escaping = state(grains.clone(), 1.0);
    let failure = step(&mut escaping, &model(0.5, 30.0), &mut Work::default()).unwrap_err();
    let StepError::Outside { trouble, .. } = &failure else { panic!("{failure:?}") };
    assert!(matches!(trouble, Trouble::Outside { grain: 11, face: 3, .. }), "{failure:?}");
    assert!(failure.to_string().contains("grain 11 passed through the back face at t = "));

    grains.velocity[1].y = f64::NAN;
    let failure = step(&mut state(grains, 1.0), &model(0.5, 30.0), &mut Work::default()).unwrap_err();
    assert!(matches!(failure, StepError::NotFinite { grain: 11, .. }));
}
