//! Viscous shear between neighbouring grains: balances, invariances, dissipation, and the step it allows.

mod random;

use glam::{DMat3, DVec3};
use porograin::boundary::{Face, Slip};
use porograin::contact::{Contacts, Law, Linear};
use porograin::pores::mesh::Walls;
use porograin::pores::shear::{self, Film};
use porograin::pores::{Pores, Stepping};
use porograin::{Domain, Flow, FluidModel, Grains, Loads, Model, State, TimeStep, Work, measure, step};
use porograin_geometry::throat::{Packing, radical_centres};
use porograin_geometry::{Cell, Triangulation};
use random::Random;

/// Grains of many sizes thrown into a box, at rest.
fn suspension(count: usize) -> (Grains, Domain) {
    let domain = Domain::walled(DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.12, -0.18, 0.32));
    let mut random = Random(9);
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < count {
        let radius = 2.5e-3 * 4f64.powf(-(x.len() as f64 / count as f64));
        let p = domain.cell.origin + (random.vector() + 0.5) * (0.02 - 2.0 * radius) + radius;
        if x.iter().zip(&r).all(|(q, b)| q.distance(p) > 1.02 * (radius + b)) {
            x.push(p);
            r.push(radius);
        }
    }
    (Grains::at_rest(x, r, 2600.0), domain)
}

fn films(grains: &Grains, domain: &Domain, slip: Slip, viscosity: f64) -> Vec<Film> {
    let packing = Packing { cell: &domain.cell, position: &grains.position, radius: &grains.radius };
    let mesh = Triangulation::new(&domain.cell, &grains.position, &grains.radius).unwrap();
    let walls = Walls { open: [false; 6], slip: [slip; 6] };
    shear::films(packing, &mesh, &radical_centres(packing, &mesh), &walls, viscosity)
}

fn loads(films: &[Film], grains: &Grains, domain: &Domain) -> Loads {
    let mut loads = Loads::default();
    loads.clear(grains.len());
    shear::add(&mut loads, films, grains, domain);
    loads
}

#[test]
fn rigid_motion_of_grains_and_walls_drags_nothing() {
    let (mut grains, mut domain) = suspension(80);
    // Walls translate only: with them a translation, without them any rigid motion.
    let (v, w) = (DVec3::new(0.3, -0.2, 0.5), DVec3::new(4.0, -7.0, 2.0));
    domain.wall_velocity = [v; 6];
    grains.velocity.fill(v);
    for slip in [Slip::Symmetry, Slip::NoSlip] {
        let found = loads(&films(&grains, &domain, slip, 1.0), &grains, &domain);
        assert!(found.force.iter().chain(&found.torque).chain(&found.wall).all(|f| f.length() < 1e-15));
    }
    for i in 0..grains.len() {
        grains.velocity[i] = v + w.cross(grains.position[i]);
        grains.spin[i] = w;
    }
    let films = films(&grains, &domain, Slip::Symmetry, 1.0);
    let found = loads(&films, &grains, &domain);
    assert!(found.force.iter().all(|f| f.length() < 1e-14), "{:?}", found.force);
    grains.spin.fill(DVec3::ZERO);
    assert!(loads(&films, &grains, &domain).force.iter().any(|f| f.length() > 1e-6), "the spins matter");
}

#[test]
fn forces_and_moments_balance_and_the_drag_only_takes_energy() {
    let mut random = Random(4);
    let (mut grains, mut domain) = suspension(80);
    for i in 0..grains.len() {
        grains.velocity[i] = random.vector();
        grains.spin[i] = random.vector() * 300.0;
    }
    domain.wall_velocity = std::array::from_fn(|_| random.vector());
    // Walls have no place at which to count their moment: mirrors, which carry nothing, for the moments.
    for slip in [Slip::Symmetry, Slip::NoSlip] {
        let films = films(&grains, &domain, slip, 1.0);
        let at_walls = films.iter().filter(|film| film.between[1] >= grains.len() as u32).count();
        assert_eq!(at_walls > 30, slip == Slip::NoSlip);
        let found = loads(&films, &grains, &domain);
        let sizes: f64 = found.force.iter().map(|f| f.length()).sum();
        let sum: DVec3 = found.force.iter().chain(&found.wall).sum();
        assert!(sum.length() < 1e-14 * sizes, "{slip:?}: {sum}");
        let mut power = 0.0;
        let mut moment = DVec3::ZERO;
        for i in 0..grains.len() {
            power += found.force[i].dot(grains.velocity[i]) + found.torque[i].dot(grains.spin[i]);
            moment += grains.position[i].cross(found.force[i]) + found.torque[i];
        }
        power += (0..6).map(|f| found.wall[f].dot(domain.wall_velocity[f])).sum::<f64>();
        assert!(power < -1e-6, "{slip:?}: {power}");
        if slip == Slip::Symmetry {
            assert!(moment.length() < 1e-14 * sizes, "{moment}");
        }
        // Along the normal nothing: two grains that part are left alone.
        for film in &films {
            let mut pair = grains.clone();
            pair.velocity.fill(DVec3::ZERO);
            pair.spin.fill(DVec3::ZERO);
            let [i, j] = film.between.map(|v| v as usize);
            if j < pair.len() {
                pair.velocity[i] = pair.position[j] - pair.position[i];
                let apart = loads(
                    std::slice::from_ref(film),
                    &pair,
                    &Domain { wall_velocity: Default::default(), ..domain.clone() },
                );
                assert!(apart.force[i].length() < 1e-14 * film.drag);
            }
        }
    }
}

#[test]
fn a_sheared_lattice_is_dragged_as_its_hydraulic_radius_says() {
    // Simple cubic, pitch 1: all facets are unit squares, and all throats around an edge together have the lattice's ratio
    // of void and surface.
    let place = |i: usize| DVec3::new((i % 5) as f64, (i / 5 % 5) as f64, (i / 25) as f64) + 0.5;
    let radius = 0.4;
    let mut grains = Grains::at_rest((0..125).map(place).collect(), vec![radius; 125], 1.0);
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(5.0));
    let (viscosity, rate) = (3.0, 0.7);
    for i in 0..125 {
        grains.velocity[i] = DVec3::X * rate * grains.position[i].z;
    }
    let films = films(&grains, &domain, Slip::Symmetry, viscosity);
    let middle = 62;
    let of_middle: Vec<&Film> = films.iter().filter(|film| film.between.contains(&middle)).collect();
    assert_eq!(of_middle.len(), 6);
    let sphere = 4.0 * std::f64::consts::PI * radius * radius;
    let ratio = (1.0 - sphere * radius / 3.0) / sphere;
    let mean = of_middle.iter().map(|film| film.drag).sum::<f64>() / 6.0;
    assert!((mean * ratio / viscosity - 1.0).abs() < 0.05, "{mean} {}", viscosity / ratio);
    // The grain above pulls, the one below holds back; both turn it, with levers of half a pitch.
    let found = loads(&films, &grains, &domain);
    assert!(found.force[middle as usize].length() < 1e-12);
    let vertical: f64 = (of_middle.iter())
        .filter(|film| (place(film.between[0] as usize) - place(film.between[1] as usize)).z.abs() > 0.5)
        .map(|film| film.drag)
        .sum();
    let torque = DVec3::Y * 0.5 * vertical * rate;
    assert!((found.torque[middle as usize] - torque).length() < 1e-12, "{}", found.torque[middle as usize]);
}

#[test]
fn results_do_not_depend_on_the_unit_of_length() {
    let (mut grains, domain) = suspension(60);
    let mut random = Random(8);
    grains.velocity.iter_mut().for_each(|v| *v = random.vector());
    let base = loads(&films(&grains, &domain, Slip::NoSlip, 1.0), &grains, &domain);
    let scale = 2f64.powi(12);
    let position: Vec<DVec3> = grains.position.iter().map(|x| *x * scale).collect();
    let radius: Vec<f64> = grains.radius.iter().map(|r| r * scale).collect();
    let mut large = Grains::at_rest(position, radius, 2600.0);
    large.velocity.clone_from(&grains.velocity);
    let around = Domain::walled(domain.cell.origin * scale, domain.cell.upper() * scale);
    let found = loads(&films(&large, &around, Slip::NoSlip, 0.5), &large, &around);
    for (a, b) in base.force.iter().zip(&found.force) {
        assert!((*a * 0.5 * scale - *b).length() < 1e-9 * scale, "{a} {b}");
    }
}

fn model(step: Stepping, viscosity: f64, shear_forces: bool) -> Model {
    let face = Face { slip: Slip::NoSlip, ..Face::default() };
    let pores = Pores { step, shear_forces, ..Pores::default() };
    Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| face.clone()),
        cell: Default::default(),
        walls: Vec::new(),
        membrane: None,
        fluid: Some(FluidModel { viscosity, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) }),
        stage_start: 0.0,
    }
}

fn run(stepping: Stepping, viscosity: f64, shear: bool, steps: usize, drop: bool) -> (State, f64) {
    let (mut grains, domain) = suspension(80);
    let mut random = Random(2);
    grains.velocity.iter_mut().for_each(|v| *v = random.vector() * 1e-3);
    let contacts = Contacts::default();
    let mut state = State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts, fluid: None };
    let (model, mut work) = (model(stepping, viscosity, shear), Work::default());
    let mut largest = 0.0f64;
    for _ in 0..steps {
        if drop {
            work = Work::default();
        }
        step(&mut state, &model, &mut work).unwrap();
        largest = largest.max(measure::kinetic_energy(&state.grains));
    }
    (state, largest)
}

#[test]
fn steps_with_shear_are_stable_and_the_same_bits_without_scratch() {
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        let (state, largest) = run(stepping, 5.0, true, 60, false);
        assert!(state == run(stepping, 5.0, true, 60, true).0);
        let left = measure::kinetic_energy(&state.grains);
        assert!(left < 0.9 * largest && largest < 1e-6, "{stepping:?}: {largest:e} {left:e}");
        // What slides past each other is slowed more than without.
        let (without, _) = run(stepping, 5.0, false, 60, false);
        assert!(state != without);
    }
}

#[test]
fn shear_limits_implicit_steps_too() {
    let dt = |viscosity, shear| run(Stepping::Implicit, viscosity, shear, 1, false).0.dt;
    assert_eq!(dt(50.0, false), dt(500.0, false));
    let (thick, thicker) = (dt(50.0, true), dt(500.0, true));
    assert!(thicker < 0.2 * thick && thick < dt(50.0, false), "{thick:e} {thicker:e}");
}

#[test]
fn in_a_sheared_cell_it_does_not_matter_by_which_image_a_grain_is_named() {
    let mut random = Random(12);
    let cell = Cell::periodic(DVec3::ZERO, DMat3::from_diagonal(DVec3::splat(5.0)));
    let mut domain = Domain::of(cell);
    domain.gradient = DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, DVec3::new(0.7, 0.2, 0.0));
    let place = |i: usize| DVec3::new((i % 5) as f64, (i / 5 % 5) as f64, (i / 25) as f64) + 0.5;
    let x = (0..125).map(|i| place(i) + 0.2 * random.vector()).collect();
    let mut grains = Grains::at_rest(x, vec![0.35; 125], 1.0);
    for i in 0..125 {
        grains.velocity[i] = random.vector();
        grains.spin[i] = random.vector();
    }
    let found = loads(&films(&grains, &domain, Slip::Symmetry, 1.0), &grains, &domain);
    for i in (0..125).step_by(3) {
        let shift = domain.cell.shift([(i % 2) as i8, -1, 1]);
        grains.position[i] += shift;
        grains.velocity[i] += domain.gradient * shift;
    }
    let by_images = loads(&films(&grains, &domain, Slip::Symmetry, 1.0), &grains, &domain);
    let largest = found.force.iter().map(|f| f.length()).fold(0.0, f64::max);
    for (a, b) in found.force.iter().chain(&found.torque).zip(by_images.force.iter().chain(&by_images.torque))
    {
        assert!((*a - *b).length() < 1e-11 * largest, "{a} {b}");
    }
}
