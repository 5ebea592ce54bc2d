//! Grains and water in periodic cells that deform: what a step solves, that the water gives no energy, that images and
//! scratch do not matter.

mod chance;
mod random;

use chance::Known;
use glam::{DMat3, DVec3};
use porograin::case::Case;
use porograin::cell::Components;
use porograin::contact::{Contacts, Law, Linear};
use porograin::pores::mesh::Carried;
use porograin::pores::{Pores, Remesh, Stepping};
use porograin::run::Simulation;
use porograin::{
    CellRule, Domain, Face, Flow, FluidModel, Grains, Model, Signal, State, TimeStep, Work, measure, step,
};
use porograin_geometry::{Cell, Period};
use random::Random;
use std::path::Path;

fn sheared() -> Cell {
    let edges =
        DMat3::from_cols(DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.3, 0.9, 0.0), DVec3::new(-0.2, 0.4, 0.95));
    Cell::periodic(DVec3::new(0.5, -2.0, 1.0), edges)
}

/// Grains of two sizes, `apart` times the sum of their radii from each other at least, that move at random.
fn start(apart: f64, speed: f64) -> State {
    let cell = sheared();
    let (mut random, period) = (Random(5), Period::of(&cell).unwrap());
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < 60 {
        let radius = if x.len() < 12 { 0.12 } else { 0.06 };
        let p = cell.origin + cell.edges * (random.vector() + 0.5);
        let free = |(q, b): (&DVec3, &f64)| (p - q + period.nearest(p - q)).length() > apart * (radius + b);
        if x.iter().zip(&r).all(free) {
            x.push(p);
            r.push(radius);
        }
    }
    let mut grains = Grains::at_rest(x, r, 2600.0);
    for k in 0..grains.len() {
        grains.velocity[k] = speed * random.vector();
        grains.spin[k] = speed * 10.0 * random.vector();
    }
    let domain = Domain::of(cell);
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
}

fn model(pores: Pores, viscosity: f64) -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.5 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| Face::default()),
        cell: CellRule::default(),
        fluid: Some(FluidModel { viscosity, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) }),
        walls: Vec::new(),
        membrane: None,
        stage_start: 0.0,
    }
}

fn constant(value: f64) -> Option<Signal> {
    Some(Signal::Constant(value))
}

/// What the motion of a state carries out of its nodes and what flows out of them do not balance by this part. The motion
/// is that `before` the step, or that after it: velocities beside the flow of the cell then belong to places a step later.
fn imbalance(state: &State, work: &Work, before: Option<&State>) -> f64 {
    let (mesh, pressure) = (work.fluid.mesh().unwrap(), &state.pores().unwrap().pressure);
    let State { grains, domain, .. } = before.unwrap_or(state);
    let later = if before.is_some() { DMat3::ZERO } else { state.dt * domain.gradient };
    let back = (DMat3::IDENTITY - later).inverse();
    let peculiar = |k: usize| back * domain.peculiar(grains.position[k], grains.velocity[k]);
    let peculiar: Vec<DVec3> = (0..grains.len()).map(peculiar).collect();
    let mut moved = Carried::default();
    mesh.carried(&peculiar, &grains.spin, &domain.wall_velocity, &mut moved);
    mesh.add_stretch(domain.rate, &mut moved);
    let flow = porograin::permeability::outflow(mesh, pressure);
    let largest = moved.node.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    let worst = flow.iter().zip(&moved.node).map(|(out, moved)| (out + moved).abs()).fold(0.0, f64::max);
    worst / largest
}

/// A cell driven in shear whose other shears are held, one of them at its limit.
fn driven() -> CellRule {
    CellRule {
        gradient: Components { xz: constant(0.8), ..Components::default() },
        stress: Components { yz: constant(-20.0), xy: constant(3.0), ..Components::default() },
        mass: None,
        rate: Some(0.003),
    }
}

#[test]
fn pressures_fit_the_motion_of_grains_and_cell_with_either_step() {
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        let pores = Pores { step: stepping, implicit_residual: 1e-11, residual: 1e-11, ..Pores::default() };
        let model = Model { cell: driven(), damping: 0.1, ..model(pores, 20.0) };
        let (mut state, mut work) = (start(0.97, 0.5), Work::default());
        let mut at_limit = 0;
        for _ in 0..60 {
            let before = state.clone();
            step(&mut state, &model, &mut work).unwrap();
            let then = (stepping == Stepping::Explicit).then_some(&before);
            let off = imbalance(&state, &work, then);
            assert!(off < 1e-7, "{stepping:?}: {off:e}");
            at_limit += u32::from(state.domain.rate.z_axis.y.abs() == 0.003);
        }
        assert!(at_limit > 5 && state.domain.rate.y_axis.x != 0.0, "{at_limit} {}", state.domain.rate);
        assert_eq!(state.domain.rate.z_axis.x, 0.8);
    }
}

/// Nothing drives the grains; the shears of the cell are free. At first the grains move, or the cell does.
#[test]
fn water_gives_no_energy_to_grains_or_cell() {
    let free =
        Components { xz: constant(0.0), xy: constant(0.0), yz: constant(0.0), ..Components::default() };
    for (stepping, time_step, steps, speed, rate) in [
        (Stepping::Explicit, TimeStep::Automatic { safety: 0.5 }, 200, 1e-6, 0.0),
        (Stepping::Implicit, TimeStep::Fixed(1e-3), 100, 1e-6, 0.0),
        (Stepping::Explicit, TimeStep::Automatic { safety: 0.5 }, 200, 0.0, 1e-6),
        (Stepping::Implicit, TimeStep::Fixed(1e-3), 100, 0.0, 1e-6),
    ] {
        let pores = Pores { step: stepping, residual: 1e-8, implicit_residual: 1e-8, ..Pores::default() };
        let cell =
            CellRule { stress: free.clone(), mass: Some(50.0), rate: Some(1.0), ..CellRule::default() };
        let model = Model { cell, time_step, ..model(pores, 50.0) };
        let (mut state, mut work) = (start(1.02, speed), Work::default());
        let Domain { cell, .. } = state.domain;
        state.domain.rate = DMat3::from_cols(DVec3::ZERO, DVec3::X, DVec3::new(-1.0, 1.0, 0.0)) * rate;
        state.domain.gradient = state.domain.rate;
        for (x, v) in state.grains.position.iter().zip(&mut state.grains.velocity) {
            *v += state.domain.gradient * (*x - cell.origin);
        }
        let energy = |state: &State| {
            let Grains { position, velocity, spin, mass, .. } = &state.grains;
            let grains: f64 = (0..mass.len())
                .map(|k| {
                    let c = state.domain.peculiar(position[k], velocity[k]);
                    0.5 * (mass[k] * c.length_squared() + state.grains.inertia(k) * spin[k].length_squared())
                })
                .sum();
            let inertia = porograin::cell::inertia(state, &model);
            let cell = (0..3).map(|k| {
                let rate = state.domain.rate.col(k);
                0.5 * (inertia.col(k) * rate).dot(rate)
            });
            [grains, cell.sum()]
        };
        let first: f64 = energy(&state).iter().sum();
        let mut last = first;
        let mut shared = [0.0_f64; 2];
        for _ in 0..steps {
            step(&mut state, &model, &mut work).unwrap();
            let [grains, cell] = energy(&state);
            assert!(grains + cell <= last * (1.0 + 1e-9), "{stepping:?}: {grains} + {cell} after {last}");
            last = grains + cell;
            shared = [shared[0].max(grains), shared[1].max(cell)];
        }
        assert_eq!(state.contacts.len(), 0);
        let least = shared[0].min(shared[1]);
        assert!(last < 0.995 * first && least > 1e-6 * first, "{stepping:?}: {last} of {first}, {shared:?}");
    }
}

/// Compressible water in a cell that shrinks: `dp = K_f dV / V_void`, and it pushes the cell with that pressure.
#[test]
fn a_shrinking_cell_presses_its_water() {
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        let gradient = Components { zz: constant(-0.05), xz: constant(0.02), ..Components::default() };
        let cell = CellRule { gradient, ..CellRule::default() };
        let mut model = Model { cell, ..model(Pores { step: stepping, ..Pores::default() }, 1.0) };
        if let Some(fluid) = &mut model.fluid {
            fluid.bulk_modulus = Some(1e6);
        }
        let (mut state, mut work) = (start(1.02, 0.0), Work::default());
        let (solid, before) = (state.grains.volume(), state.domain.cell.volume());
        for _ in 0..40 {
            step(&mut state, &model, &mut work).unwrap();
        }
        let after = state.domain.cell.volume();
        assert!(after < 0.996 * before);
        // An explicit step answers the motion before it.
        let known = if stepping == Stepping::Explicit { after / (1.0 - 0.05 * state.dt) } else { after };
        let expected = 1e6 * ((before - solid) / (known - solid)).ln();
        let mesh = work.fluid.mesh().unwrap();
        let pressure = &state.pores().unwrap().pressure;
        let mean = pressure.iter().sum::<f64>() / pressure.len() as f64;
        assert!((mean / expected - 1.0).abs() < 0.01, "{stepping:?}: {mean} {expected}");
        let push = work.loads.cell.z_axis.z / mesh.volume.iter().sum::<f64>();
        assert!((push / expected - 1.0).abs() < 0.01, "{stepping:?}: {push} {expected}");
    }
}

#[test]
fn a_drifting_sample_feels_no_water_and_needs_no_new_mesh() {
    let (mut state, mut work) = (start(1.02, 0.0), Work::default());
    let drift = DVec3::new(40.0, -25.0, 13.0);
    state.grains.velocity.fill(drift);
    let model = Model { time_step: TimeStep::Fixed(1e-3), ..model(Pores::default(), 1e3) };
    for _ in 0..200 {
        let report = step(&mut state, &model, &mut work).unwrap();
        assert_eq!(report.remeshed, None);
    }
    assert!(state.domain.crossed.iter().flatten().any(|&crossed| crossed.abs() > 5));
    let change = state.grains.velocity.iter().map(|v| (*v - drift).length()).fold(0.0, f64::max);
    assert!(change < 1e-9, "{change}");
}

/// Dense, sheared, through new meshes and new period vectors.
fn sheared_far() -> (State, Model) {
    let pores = Pores { remesh: Remesh { strain: 0.05 }, ..Pores::default() };
    let gradient = Components { xz: constant(4.0), ..Components::default() };
    let stress = Components { yz: constant(0.0), ..Components::default() };
    let cell = CellRule { gradient, stress, ..CellRule::default() };
    (start(0.95, 0.5), Model { cell, ..model(pores, 20.0) })
}

#[test]
fn threads_scratch_and_a_restart_change_no_bit() {
    let (start, model) = sheared_far();
    let run = |threads: usize, fresh: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (mut state, mut work) = (start.clone(), Work::default());
            let (mut meshes, mut flips) = (0, 0);
            for k in 0..500 {
                let before = state.domain.cell.edges.z_axis.x;
                meshes += u32::from(step(&mut state, &model, &mut work).unwrap().remeshed.is_some());
                flips += u32::from(state.domain.cell.edges.z_axis.x < before);
                if fresh && k % 7 == 0 {
                    work = Work::default();
                }
            }
            (state, meshes, flips)
        })
    };
    let (state, meshes, flips) = run(1, false);
    assert!(meshes > 3 && flips > 0, "{meshes} {flips}");
    assert!(run(2, false).0 == state, "two threads");
    assert!(run(1, true).0 == state, "restarts");
}

#[test]
fn the_choice_of_images_does_not_matter() {
    let (start, model) = sheared_far();
    let period = Period::of(&start.domain.cell).unwrap();
    let mut other = start.clone();
    other.domain.cell.origin += DVec3::new(0.37, 0.11, -0.4);
    other.domain.cell.edges.z_axis += start.domain.cell.edges.x_axis;
    for (k, x) in other.grains.position.iter_mut().enumerate() {
        *x += start.domain.cell.shift([k as i8 % 3 - 1, k as i8 % 2, -1]);
    }
    let (mut a, mut b, mut works) = (start, other, [Work::default(), Work::default()]);
    let model = Model { time_step: TimeStep::Fixed(2e-4), ..model };
    for _ in 0..60 {
        step(&mut a, &model, &mut works[0]).unwrap();
        step(&mut b, &model, &mut works[1]).unwrap();
    }
    // The flow of the cell is zero at its origin: with another one everything moves on together.
    let period = Period::of(&a.domain.cell).unwrap_or(period);
    let apart = |k: usize| b.grains.position[k] - a.grains.position[k];
    for k in 0..a.grains.len() {
        let apart = apart(k) - apart(0);
        let off = (apart + period.nearest(apart)).length();
        assert!(off < 1e-7, "{off:e}");
    }
}

fn run(case: &str) -> Simulation {
    let case = Case::from_text("periodic", case, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
    let mut simulation = Simulation::new(&case).unwrap_or_else(|e| panic!("{e}"));
    while simulation.advance().unwrap_or_else(|e| panic!("{e}")).is_some() {}
    simulation
}

/// Less friction while pressed makes the samples dense, so that they give way little under the load. With no more of it later, some
/// collapse, even long after, and the water carries up to the whole load again.
#[test]
fn a_load_between_plates_is_carried_by_the_water_first_and_by_the_grains_at_last() {
    let case = |seed: usize, viscosity: f64, time: f64| {
        format!(
            r#"
title = "consolidation between two plates, without sides"
[domain]
size = [0.01, 0.01, 0.012]
periodic = "xy"
[grains]
packing = {{ cloud = {{ count = 150, spread = 0.2, seed = {seed}, porosity = 0.7 }} }}
density = 2600.0
[contact.linear]
young = 15e6
stiffness-ratio = 0.5
friction = 30.0
[fluid]
viscosity = {viscosity:?}
[face.top]
solid = {{ servo = {{ stress = 1000.0 }} }}
[[stage]]
name = "press"
friction = 10.0
fluid = false
until = {{ unbalanced = 1e-3, stress-error = 0.01, max-steps = 40000 }}
[[stage]]
name = "load"
face.top = {{ solid = {{ servo = {{ stress = 3000.0 }} }}, water = {{ pressure = 0.0 }} }}
until = {{ time = {time:?} }}
"#
        )
    };
    let bottom = |simulation: &Simulation| simulation.profile().unwrap()[0];
    let stress = |s: &Simulation| measure::contact_stress(&s.state, &s.stages()[1].model).z_axis.z;
    // The servo has come to rest and nothing has drained but the pores next to the top.
    let early = [1, 2].map(|seed| run(&case(seed, 400.0, 0.01)));
    for sample in &early {
        let below = measure::wall_stress(&sample.state.domain)[4];
        assert!((below / 3000.0 - 1.0).abs() < 1e-3, "{below}");
    }
    let shares = early.each_ref().map(|sample| bottom(sample) / 2000.0);
    Known { mean: 0.989, deviation: 0.0147, samples: 32 }.holds("part of the load", &shares);
    for seed in [1, 2] {
        let late = run(&case(seed, 1.0, 0.03));
        assert!(bottom(&late).abs() < 2.0, "{}", bottom(&late));
        assert!((stress(&late) / 3000.0 - 1.0).abs() < 1e-3, "{}", stress(&late));
    }
}
