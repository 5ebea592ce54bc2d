//! Grains and water together: the same bits whatever is dropped and however many threads, and steps that stay
//! stable up to the limit.

use glam::DVec3;
use porograin::boundary::{Face, Signal, Solid, Water};
use porograin::contact::{Contacts, Law, Linear};
use porograin::pores::Pores;
use porograin::stability::Cause;
use porograin::{Domain, Flow, FluidModel, Grains, Model, State, TimeStep, Work, step};
use porograin_geometry::Repair;

/// A cubic arrangement of touching grains, slightly shaken, under a piston, between two open faces.
fn sample(viscosity: f64) -> (State, Model) {
    cube(5, viscosity)
}

/// The same, `n` grains wide.
fn cube(n: usize, viscosity: f64) -> (State, Model) {
    let d = 0.01;
    let mut seed = 3u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut x = Vec::new();
    for k in 0..n {
        for j in 0..n {
            for i in 0..n {
                let shake = DVec3::new(random(), random(), random()) * 0.02 * d;
                x.push(DVec3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5) * d + shake);
            }
        }
    }
    let radius = vec![0.5 * d; x.len()];
    let state = State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, DVec3::splat(n as f64 * d)),
        grains: Grains::at_rest(x, radius, 2600.0),
        contacts: Contacts::default(),
        fluid: None,
    };
    let mut faces: [Face; 6] = Default::default();
    faces[5].solid = Solid::Servo { stress: Signal::Constant(2e3), mass: None, speed: None };
    for face in [4, 5] {
        faces[face].water = Water::Pressure(Signal::Constant(0.0));
    }
    let model = Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::new(0.0, 0.0, -9.81),
        contact: Law::Linear(Linear::new(15e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces,
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: Some(FluidModel {
            viscosity,
            density: 1000.0,
            bulk_modulus: None,
            flow: Flow::Pores(Pores {
                remesh: porograin::pores::Remesh { strain: 2e-4 },
                step: porograin::pores::Stepping::Explicit,
                conductance: porograin::pores::Conductance::hydraulic_radius(),
                ..Pores::default()
            }),
        }),
        stage_start: 0.0,
    };
    (state, model)
}

fn run(n: usize, threads: usize, steps: usize, drop_every: usize) -> (State, Vec<Repair>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let (mut state, model) = cube(n, 1.0);
        let mut work = Work::default();
        let mut meshes = Vec::new();
        for k in 0..steps {
            if drop_every > 0 && k % drop_every == 0 {
                work = Work::default();
            }
            if step(&mut state, &model, &mut work).unwrap().remeshed.is_some() {
                meshes.push(work.fluid.repair());
            }
        }
        (state, meshes)
    })
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_without_scratch() {
    let one = run(5, 1, 200, 0);
    assert!(!one.1.is_empty(), "the run should make a new mesh on its way");
    // Most follow by flips, the same ones without scratch.
    assert!(one.1.iter().any(|repair| repair.flips > 0), "{:?}", one.1);
    assert_eq!(one, run(5, 2, 200, 0));
    assert_eq!(one, run(5, 1, 200, 7));
    assert_eq!(one, run(5, 2, 200, 1));
}

/// So many grains and pores that every loop is shared out among the threads.
#[test]
fn two_threads_share_a_large_sample_and_give_the_same_bits() {
    let one = run(14, 1, 30, 0).0;
    assert!(one == run(14, 2, 30, 0).0);
    assert!(one == run(14, 2, 30, 13).0);
}

#[test]
fn the_water_limits_the_step_when_it_is_thick() {
    let limit = |viscosity| {
        let (mut state, model) = sample(viscosity);
        step(&mut state, &model, &mut Work::default()).unwrap().limit.unwrap()
    };
    let (thin, thick, thicker) = (limit(1e-6), limit(1e2), limit(2e2));
    assert_ne!(thin.cause, Cause::Water);
    assert_eq!(thick.cause, Cause::Water);
    assert!((thick.seconds / thicker.seconds - 2.0).abs() < 0.02, "{thick:?} {thicker:?}");
}

#[test]
fn an_explicit_step_is_stable_below_the_limit_and_not_above() {
    // Grains that fly apart leave the box or reach absurd speeds; below the limit the load settles.
    let speed = |safety: f64| {
        let (mut state, mut model) = sample(20.0);
        model.time_step = TimeStep::Automatic { safety };
        let mut work = Work::default();
        for _ in 0..600 {
            if step(&mut state, &model, &mut work).is_err() {
                return f64::INFINITY;
            }
        }
        state.grains.velocity.iter().map(|v| v.length()).fold(0.0, f64::max)
    };
    assert!(speed(0.9) < 0.05, "{}", speed(0.9));
    assert!(speed(1.3) > 1.0, "{}", speed(1.3));
}

/// Where no other load is felt, local damping adds its part of the drag to it.
#[test]
fn an_explicit_step_with_local_damping_is_stable_below_the_limit_and_not_above() {
    let speed = |safety: f64| {
        let (mut state, mut model) = sample(20.0);
        (model.time_step, model.damping) = (TimeStep::Automatic { safety }, 0.8);
        model.faces[5].solid = Solid::Fixed;
        model.gravity = DVec3::ZERO;
        for (k, velocity) in state.grains.velocity.iter_mut().enumerate() {
            *velocity = DVec3::new((k as f64 * 1.1).sin(), (k as f64 * 2.7).sin(), (k as f64 * 3.9).sin());
        }
        let mut work = Work::default();
        for _ in 0..200 {
            if step(&mut state, &model, &mut work).is_err() {
                return f64::INFINITY;
            }
        }
        state.grains.velocity.iter().map(|v| v.length()).fold(0.0, f64::max)
    };
    assert!(speed(0.9) < 0.1, "{}", speed(0.9));
    assert!(speed(1.7) > 1.0, "{}", speed(1.7));
}

#[test]
fn buoyancy_is_the_weight_of_the_water_displaced() {
    let (mut state, mut model) = sample(1e-3);
    model.faces[5].solid = Solid::Fixed;
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let wet: DVec3 = work.loads.force.iter().sum();
    let (mut dry_state, mut dry_model) = sample(1e-3);
    dry_model.faces[5].solid = Solid::Fixed;
    dry_model.fluid = None;
    let mut dry_work = Work::default();
    step(&mut dry_state, &dry_model, &mut dry_work).unwrap();
    let dry: DVec3 = dry_work.loads.force.iter().sum();
    let expected = 1000.0 * 9.81 * state.grains.volume();
    assert!(
        ((wet - dry).z / expected - 1.0).abs() < 1e-9 && (wet - dry).truncate().length() < 1e-9 * expected
    );
}
