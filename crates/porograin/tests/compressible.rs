//! Compressible water in the pores: closed forms, mass to round-off, energy, the same bits.

mod random;

use glam::DVec3;
use porograin::boundary::{Face, Signal, Solid, Water};
use porograin::consolidation;
use porograin::contact::{Contacts, Law, Linear};
use porograin::pores::{Pores, Remesh, Stepping};
use porograin::{Domain, Flow, FluidModel, Grains, Model, State, TimeStep, Work, permeability, step};
use random::Random;

const BULK: f64 = 1e6;

/// A lattice of grains of 1 cm pitch, shaken; `radius` in pitches.
fn lattice(count: [usize; 3], radius: f64, shake: f64, density: f64) -> State {
    let [nx, ny, nz] = count;
    let mut random = Random(3);
    let at = |i: usize| DVec3::new((i % nx) as f64, (i / nx % ny) as f64, (i / nx / ny) as f64) + 0.5;
    let x: Vec<DVec3> = (0..nx * ny * nz).map(|i| 0.01 * (at(i) + shake * random.vector())).collect();
    let radius = vec![0.01 * radius; x.len()];
    State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, 0.01 * DVec3::new(nx as f64, ny as f64, nz as f64)),
        grains: Grains::at_rest(x, radius, density),
        contacts: Contacts::default(),
        fluid: None,
    }
}

fn model(viscosity: f64, bulk_modulus: Option<f64>, stepping: Stepping, strain: f64) -> Model {
    let pores = Pores { step: stepping, remesh: Remesh { strain }, ..Pores::default() };
    Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(15e6, 0.0, 0.0)).into(),
        damping: 0.0,
        faces: Default::default(),
        cell: Default::default(),
        walls: Vec::new(),
        membrane: None,
        fluid: Some(FluidModel { viscosity, density: 1000.0, bulk_modulus, flow: Flow::Pores(pores) }),
        stage_start: 0.0,
    }
}

/// Mean pressure, weighted with the void of the nodes [Pa].
fn mean(state: &State, work: &Work) -> f64 {
    let mesh = work.fluid.mesh().unwrap();
    let pressure = &state.pores().unwrap().pressure;
    let sum: f64 = mesh.void.iter().zip(pressure).map(|(v, p)| v * p).sum();
    sum / mesh.void.iter().sum::<f64>()
}

fn void(state: &State) -> f64 {
    state.domain.cell.volume() - state.grains.volume()
}

#[test]
fn a_sealed_sample_is_pressed_as_its_water_is() {
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        for (strain, sideways) in [(f64::INFINITY, 0.0), (2e-3, -0.01)] {
            let mut state = lattice([4, 4, 4], 0.48, 0.02, 2600.0);
            let mut model = model(0.1, Some(BULK), stepping, strain);
            let down = Signal::Constant(-0.02);
            model.faces[5].solid =
                Solid::Moving { velocity: [Signal::Constant(0.0), Signal::Constant(0.0), down] };
            model.faces[1].solid = Solid::Moving {
                velocity: [Signal::Constant(sideways), Signal::Constant(0.0), Signal::Constant(0.0)],
            };
            let (before, mut work, mut meshes) = (void(&state), Work::default(), 0);
            let mut total = f64::NAN;
            for k in 0..1500 {
                // What an explicit step answers is where the walls were before it.
                let now = void(&state);
                let report = step(&mut state, &model, &mut work).unwrap();
                meshes += usize::from(report.remeshed.is_some());
                let store = state.pores().unwrap().store.as_ref().unwrap();
                if k == 0 {
                    total = store.total();
                }
                let drift = store.total() / total - 1.0;
                assert!(drift.abs() < 1e-13, "{stepping:?} {strain} step {k}: {drift:e}");
                if k % 100 == 99 {
                    let after = if stepping == Stepping::Implicit { void(&state) } else { now };
                    let meshed: f64 = work.fluid.mesh().unwrap().void.iter().sum();
                    // The water that filled `before` fills `after`; of one mesh volumes are those when it was made.
                    let expected = BULK * (before - after) / meshed;
                    let found = mean(&state, &work);
                    assert!(
                        (found / expected - 1.0).abs() < 2e-3,
                        "{stepping:?} {strain}: {found} {expected}"
                    );
                }
            }
            assert_eq!(meshes > 3, strain < 1.0, "{meshes}");
            assert!((before / void(&state) - 1.0) > 0.005, "the walls have moved");
        }
    }
}

#[test]
fn pressure_diffuses_through_a_rigid_sample_as_theory_says() {
    // Grains too heavy to move; the bottom sealed, the top brought to 100 Pa at once.
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        let mut state = lattice([4, 4, 24], 0.45, 0.1, 1e12);
        let mut model = model(1e-3, Some(BULK), stepping, 1.0);
        model.faces[5].water = Water::Pressure(Signal::Constant(100.0));
        let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &model.fluid else { unreachable!() };
        let problem = permeability::Problem {
            axis: 2,
            drop: 1.0,
            sides: porograin::Slip::Symmetry,
            viscosity: 1e-3,
            conductance: pores.conductance,
            coupling: pores.coupling,
            solver: pores.solver,
            residual: 1e-10,
        };
        let flow =
            permeability::measure(&state.domain.cell, &state.grains.position, &state.grains.radius, &problem)
                .unwrap();
        let porosity = void(&state) / state.domain.cell.volume();
        let diffusivity = flow.permeability * BULK / (1e-3 * porosity);
        let height = 0.24;
        let end = 0.5 * height * height / diffusivity;
        model.time_step = TimeStep::Fixed(end / 400.0);
        let mut work = Work::default();
        let mut worst = 0.0f64;
        for k in 1..=400 {
            step(&mut state, &model, &mut work).unwrap();
            if k % 40 == 0 {
                // The first explicit solve has no motion before it to answer.
                let steps = if stepping == Stepping::Explicit { k - 1 } else { k };
                let tv = steps as f64 / 400.0 * 0.5;
                let profile = work.fluid.profile(&state, 2).unwrap();
                for (j, pressure) in profile.iter().enumerate().take(12) {
                    let depth = (height - 0.24 * j as f64 / 12.0) / height;
                    let expected = 1.0 - consolidation::pressure(depth, tv);
                    worst = worst.max((pressure / 100.0 - expected).abs());
                }
            }
        }
        assert!(worst < 0.01, "{stepping:?}: {worst}");
    }
}

/// Grains pressed into each other a little, in a sealed box of fixed walls, each given a small random velocity.
fn stirred(stepping: Stepping, bulk_modulus: Option<f64>) -> (State, Model) {
    let mut state = lattice([4, 4, 4], 0.50005, 0.0, 2600.0);
    // Walls as near as neighbours, so that all contacts are pressed alike.
    state.domain = Domain::walled(DVec3::splat(5e-7), DVec3::splat(0.04 - 5e-7));
    let mut random = Random(17);
    for i in 0..state.grains.len() {
        state.grains.velocity[i] = random.vector() * 1e-5;
        state.grains.spin[i] = random.vector() * 1e-3;
    }
    (state, model(0.05, bulk_modulus, stepping, 1.0))
}

/// Overlaps of all touching pairs and of grains with walls, in a fixed order [m].
fn overlaps(state: &State) -> Vec<f64> {
    let (x, r) = (&state.grains.position, &state.grains.radius);
    let mut all = Vec::new();
    for i in 0..x.len() {
        for j in 0..i {
            if x[i].distance(x[j]) < 1.2 * (r[i] + r[j]) {
                all.push(r[i] + r[j] - x[i].distance(x[j]));
            }
        }
        for face in 0..6 {
            let depth = (state.domain.cell.wall_position(face) - x[i][face / 2]).abs();
            all.push(r[i] - depth);
        }
    }
    all
}

#[test]
fn energy_never_rises_in_implicit_steps() {
    // `H = v·M v/2 + x_n·K x_(n+1)/2 + sum C p²/2` (`physics` §3b, the springs' part at mid-step as a product of both
    // ends) falls with every step. Frictionless linear contacts, k = E R for equal grains and at walls alike.
    for (bulk, times) in [(Some(1e5), 0.8), (Some(1e7), 0.8), (Some(1e7), 0.1), (None, 0.8)] {
        let (mut state, mut model) = stirred(Stepping::Implicit, bulk);
        // What solves leave over may stir the energy: leave nothing.
        if let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &mut model.fluid {
            pores.implicit_residual = 1e-10;
        }
        model.time_step = TimeStep::Automatic { safety: times };
        let stiffness = 15e6 * state.grains.radius[0];
        let mut work = Work::default();
        let (mut last, mut first) = (f64::INFINITY, f64::NAN);
        let mut before = overlaps(&state);
        let rest: f64 = before.iter().filter(|d| **d > 0.0).map(|d| 0.5 * stiffness * d * d).sum();
        for k in 0..400 {
            step(&mut state, &model, &mut work).unwrap();
            let after = overlaps(&state);
            let springs: f64 = before
                .iter()
                .zip(&after)
                .filter(|(a, _)| **a > 0.0)
                .map(|(a, b)| 0.5 * stiffness * a * b)
                .sum();
            let water: f64 = {
                let mesh = work.fluid.mesh().unwrap();
                let pressure = &state.pores().unwrap().pressure;
                mesh.void.iter().zip(pressure).map(|(v, p)| bulk.map_or(0.0, |k| 0.5 * v * p * p / k)).sum()
            };
            let energy = porograin::measure::kinetic_energy(&state.grains) + springs - rest + water;
            if k == 0 {
                first = energy;
            } else {
                assert!(energy < last + 5e-4 * first, "{bulk:?} {times} step {k}: {last:e} to {energy:e}");
            }
            last = energy;
            before = after;
        }
        assert!(last < 0.9 * first, "{bulk:?} {times}: {first:e} {last:e}");
    }
}

#[test]
fn explicit_steps_of_compressible_water_are_stable() {
    for bulk in [Some(1e4), Some(1e6), Some(1e9)] {
        let (mut state, model) = stirred(Stepping::Explicit, bulk);
        let mut work = Work::default();
        let first = porograin::measure::kinetic_energy(&state.grains);
        for _ in 0..1000 {
            step(&mut state, &model, &mut work).unwrap();
        }
        let last = porograin::measure::kinetic_energy(&state.grains);
        assert!(last < first, "{bulk:?}: {first:e} {last:e}");
    }
}

fn pressed(stepping: Stepping) -> (State, Model) {
    let state = lattice([4, 4, 4], 0.5, 0.02, 2600.0);
    let mut model = model(0.5, Some(BULK), stepping, 2e-4);
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(2e3), mass: None, speed: None };
    model.faces[4] = Face { water: Water::Pressure(Signal::Constant(0.0)), ..Face::default() };
    (state, model)
}

#[test]
fn the_same_bits_on_any_number_of_threads_without_scratch_and_through_a_checkpoint() {
    for stepping in [Stepping::Explicit, Stepping::Implicit] {
        let run = |threads: usize, drop_every: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (mut state, model) = pressed(stepping);
                let (mut work, mut meshes) = (Work::default(), 0);
                for k in 1..=200 {
                    meshes += usize::from(step(&mut state, &model, &mut work).unwrap().remeshed.is_some());
                    if k % drop_every == 0 {
                        work = Work::default();
                        let bytes = postcard::to_stdvec(&state).unwrap();
                        state = postcard::from_bytes(&bytes).unwrap();
                    }
                }
                (state, meshes)
            })
        };
        let (one, meshes) = run(1, 1000);
        assert!(meshes > 1, "the run should make new meshes on its way");
        assert!(one == run(2, 1000).0);
        assert!(one == run(2, 7).0);
        assert!(one == run(1, 1).0);
    }
}

#[test]
fn nearly_incompressible_water_does_as_incompressible_water() {
    let (_, mut stiff) = pressed(Stepping::Implicit);
    let start = lattice([4, 4, 4], 0.5, 0.0, 2600.0);
    let end = |model: &Model| {
        let (mut state, mut work) = (start.clone(), Work::default());
        for _ in 0..300 {
            step(&mut state, model, &mut work).unwrap();
        }
        state.domain.cell.upper().z
    };
    if let Some(fluid) = &mut stiff.fluid {
        fluid.bulk_modulus = Some(1e13);
    }
    let compressible = end(&stiff);
    if let Some(fluid) = &mut stiff.fluid {
        fluid.bulk_modulus = None;
    }
    let incompressible = end(&stiff);
    let settled = start.domain.cell.upper().z - incompressible;
    assert!(
        (compressible - incompressible).abs() < 0.02 * settled,
        "{compressible} {incompressible} {settled:e}"
    );
}

#[test]
fn a_new_mesh_begins_with_the_pressures_of_the_last() {
    let (mut state, mut model) = pressed(Stepping::Implicit);
    if let Some(fluid) = &mut model.fluid {
        fluid.bulk_modulus = None;
    }
    let (mut work, mut meshes) = (Work::default(), 0);
    for _ in 0..200 {
        let before = work.fluid.mesh().cloned().zip(state.pores().map(|water| water.pressure.clone()));
        let report = step(&mut state, &model, &mut work).unwrap();
        let Some((old, pressure)) = before.filter(|_| report.remeshed.is_some()) else { continue };
        meshes += 1;
        // Pores between the same grains as before.
        let (mesh, started) = (work.fluid.mesh().unwrap(), &state.pores().unwrap().before[0]);
        let of = |pore: &[u32; 4]| {
            let mut sorted = *pore;
            sorted.sort_unstable();
            sorted
        };
        let known: std::collections::HashMap<[u32; 4], f64> = old
            .triangulation
            .pores
            .iter()
            .zip(&old.node)
            .map(|(p, &n)| (of(p), pressure[n as usize]))
            .collect();
        let mut same = 0;
        for (pore, &node) in mesh.triangulation.pores.iter().zip(&mesh.node) {
            if let Some(&before) = known.get(&of(pore)) {
                // Merged pores have the pressure of one of them.
                let alone = mesh.node.iter().filter(|n| **n == node).count() == 1;
                same += usize::from(alone);
                assert!(!alone || started[node as usize] == before);
            }
        }
        assert!(same > mesh.node.len() / 10, "{same} of {}", mesh.node.len());
    }
    assert!(meshes > 1);
}
