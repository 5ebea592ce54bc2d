//! The implicit step: what it solves, that it is stable far beyond the limit of explicit ones, and that both tell the
//! same story.

mod random;

use glam::DVec3;
use porograin::boundary::{Face, Signal, Solid, Water};
use porograin::budget::{Audit, Budget, Unbalanced};
use porograin::contact::{Contacts, Law, Linear};
use porograin::pores::Pull;
use porograin::pores::mesh::Carried;
use porograin::pores::{Conductance, Coupling, Pores, Stepping};
use porograin::{Domain, Flow, FluidModel, Grains, Model, State, TimeStep, Work, measure, packing, step};
use random::Random;

/// A dense cloud pressed at 5 kPa from all sides until it rests, then given water and a load on the top.
fn pressed(count: usize) -> (State, Model) {
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(0.03));
    let grains = packing::cloud(&domain.cell, count, 0.2, 3, 0.7, 2600.0).unwrap();
    let contacts = Contacts::default();
    let mut state = State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts, fluid: None };
    let mut faces: [Face; 6] = Default::default();
    for face in &mut faces {
        face.solid = Solid::Servo { stress: Signal::Constant(5e3), mass: None, speed: None };
    }
    let mut model = Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(15e6, 0.5, 5.0)).into(),
        damping: 0.3,
        faces,
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    };
    let mut work = Work::default();
    while state.step < 500 || measure::unbalanced(&state, &model, &work.loads) > 1e-3 {
        step(&mut state, &model, &mut work).unwrap();
        assert!(state.step < 30_000);
    }
    let Law::Linear(linear) = &mut model.contact.all else { unreachable!() };
    linear.friction = 30.0;
    model.damping = 0.0;
    for face in 0..5 {
        model.faces[face].solid = Solid::Fixed;
    }
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(10e3), mass: None, speed: None };
    for face in [4, 5] {
        model.faces[face].water = Water::Pressure(Signal::Constant(0.0));
    }
    (state, model)
}

fn water(viscosity: f64, step: Stepping) -> Option<FluidModel> {
    let pores = Pores { step, conductance: Conductance::hydraulic_radius(), ..Pores::default() };
    Some(FluidModel { viscosity, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) })
}

/// Runs for `steps`; the last settlement [m], and the sum of iterations.
fn settle(start: &State, model: &Model, steps: usize) -> (State, usize) {
    let (mut state, mut work, mut iterations) = (start.clone(), Work::default(), 0);
    for _ in 0..steps {
        iterations += step(&mut state, model, &mut work).unwrap().water.unwrap().iterations;
    }
    (state, iterations)
}

fn settlement(before: &State, after: &State) -> f64 {
    measure::settlement(&before.domain, &after.domain, 5)
}

#[test]
fn the_new_velocities_and_the_pressures_fit() {
    let (start, mut model) = pressed(200);
    // Sealed pistons at the sides, one of them held to a crawl, a wall that moves by decree, and local damping.
    let servo = |speed| Solid::Servo { stress: Signal::Constant(8e3), mass: None, speed };
    model.faces[0].solid = servo(None);
    model.faces[2].solid = servo(Some(1e-7));
    model.faces[3].solid = Solid::Moving { velocity: [0.0, -1e-3, 0.0].map(Signal::Constant) };
    model.faces[5].water = Water::Pressure(Signal::Constant(1e3));
    model.damping = 0.2;
    let pores = Pores {
        step: Stepping::Implicit,
        implicit_residual: 1e-11,
        conductance: Conductance::hydraulic_radius(),
        ..Pores::default()
    };
    model.fluid =
        Some(FluidModel { viscosity: 40.0, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) });
    let (mut state, mut work) = (start, Work::default());
    for _ in 0..20 {
        step(&mut state, &model, &mut work).unwrap();
        let (mesh, pressure) = (work.fluid.mesh().unwrap(), &state.pores().unwrap().pressure);
        let mut moved = Carried::default();
        let State { grains, domain, .. } = &state;
        mesh.carried(&grains.velocity, &grains.spin, &domain.wall_velocity, &mut moved);
        let flow = porograin::permeability::outflow(mesh, pressure);
        let size = |x: f64, y: f64| x.abs().max(y.abs());
        let largest = moved.node.iter().copied().fold(0.0, size);
        let free = 0..mesh.unknowns;
        let worst = free.map(|node| moved.node[node] + flow[node]).fold(0.0, size);
        assert!(worst < 1e-7 * largest, "{worst} {largest}");
    }
    assert_eq!(state.domain.wall_velocity[2].y.abs(), 1e-7);
    assert!(state.domain.wall_velocity[0].x != 0.0);
}

/// Grains of very different sizes that hover apart in a closed box and fly about at random.
fn suspension(step: Stepping) -> (State, Model) {
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(0.02));
    let mut random = Random(9);
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < 150 {
        let radius = 2.5e-3 * 6f64.powf(-(x.len() as f64 / 150.0));
        let p = (random.vector() + 0.5) * (0.02 - 2.0 * radius) + radius;
        if x.iter().zip(&r).all(|(q, b)| q.distance(p) > 1.02 * (radius + b)) {
            x.push(p);
            r.push(radius);
        }
    }
    let mut grains = Grains::at_rest(x, r, 2600.0);
    for i in 0..grains.len() {
        grains.velocity[i] = random.vector() * 1e-6;
        grains.spin[i] = random.vector() * 1e-3;
    }
    let contacts = Contacts::default();
    let state = State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts, fluid: None };
    let model = Model {
        time_step: TimeStep::Fixed(1e-12),
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces: Default::default(),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: water(1.0, step),
        stage_start: 0.0,
    };
    (state, model)
}

#[test]
fn the_water_never_gives_energy_to_an_undriven_suspension() {
    for (stepping, times) in
        [(Stepping::Explicit, 0.95), (Stepping::Implicit, 10.0), (Stepping::Implicit, 1e3)]
    {
        let (mut state, mut model) = suspension(stepping);
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        model.time_step = TimeStep::Fixed(times * 2.0 / state.pores().unwrap().viscous_rate);
        let first = measure::kinetic_energy(&state.grains);
        let mut energy = first;
        for _ in 0..100 {
            step(&mut state, &model, &mut work).unwrap();
            let now = measure::kinetic_energy(&state.grains);
            // What the solve leaves over may stir the last digits.
            assert!(
                now <= energy * (1.0 + 1e-9) + 1e-9 * first,
                "{stepping:?} {times}: {energy:e} to {now:e}"
            );
            energy = now;
        }
        assert!(energy < 0.9 * first, "{stepping:?} {times}: {first:e} to {energy:e}");
    }
}

#[test]
fn the_geometric_coupling_gives_energy_to_a_suspension_of_grains_of_many_sizes() {
    let grown = |coupling| {
        let (mut state, mut model) = suspension(Stepping::Explicit);
        let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &mut model.fluid else { unreachable!() };
        pores.coupling = coupling;
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        model.time_step = TimeStep::Fixed(0.5 * 2.0 / state.pores().unwrap().viscous_rate);
        let first = measure::kinetic_energy(&state.grains);
        for _ in 0..2000 {
            step(&mut state, &model, &mut work).unwrap();
        }
        measure::kinetic_energy(&state.grains) / first
    };
    let (geometric, reciprocal) = (grown(Coupling::Geometric), grown(Coupling::Reciprocal));
    assert!(geometric > 3.0 && reciprocal < 0.5, "{geometric:e} {reciprocal:e}");
}

#[test]
fn implicit_steps_tell_the_story_of_explicit_ones_with_fewer() {
    let (start, mut model) = pressed(300);
    model.time_step = TimeStep::Automatic { safety: 0.8 };
    model.fluid = water(8.0, Stepping::Auto);
    let (state, iterations) = settle(&start, &model, 700);
    let at = state.time - start.time;
    assert!(state.pores().unwrap().implicit.is_some(), "the water limits the step more than three times");
    assert!(iterations < 10 * 700, "{iterations}");
    model.fluid = water(8.0, Stepping::Explicit);
    let (mut explicit, mut work) = (start.clone(), Work::default());
    let mut steps = 0;
    while explicit.time - start.time < at {
        step(&mut explicit, &model, &mut work).unwrap();
        steps += 1;
    }
    let (a, b) = (settlement(&start, &state), settlement(&start, &explicit));
    assert!(steps > 5 * 700 && (a / b - 1.0).abs() < 0.01, "{a:e} {b:e} {steps}");
}

#[test]
fn implicit_steps_are_stable_at_a_thousand_times_the_explicit_limit() {
    let (start, mut model) = pressed(200);
    model.fluid = water(8000.0, Stepping::Implicit);
    let (state, _) = settle(&start, &model, 1500);
    let rate = state.pores().unwrap().viscous_rate;
    assert!(state.dt > 1e3 * 2.0 / rate, "{} {rate}", state.dt);
    // Next to nothing of the work of the piston may still move: what vibrates without moving water is all that can.
    let settled = settlement(&start, &state).abs();
    let (moving, work) = (measure::kinetic_energy(&state.grains), 10e3 * start.domain.area(5) * settled);
    assert!(settled < 1e-4 && moving < 1e-3 * work, "{settled:e} {moving:e} {work:e}");
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_without_scratch() {
    same_bits(150, 150, true);
    // So many grains and pores that every loop is shared out among the threads.
    same_bits(800, 12, false);
}

fn same_bits(grains: usize, steps: usize, meshed_anew: bool) {
    let (start, mut model) = pressed(grains);
    let pores = Pores {
        remesh: porograin::pores::Remesh { strain: 1e-4 },
        step: Stepping::Implicit,
        conductance: Conductance::hydraulic_radius(),
        ..Pores::default()
    };
    model.fluid =
        Some(FluidModel { viscosity: 8.0, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) });
    model.damping = 0.1;
    let run = |threads: usize, drop_every: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (mut state, mut work, mut meshes) = (start.clone(), Work::default(), 0);
            for k in 1..=steps {
                meshes += usize::from(step(&mut state, &model, &mut work).unwrap().remeshed.is_some());
                if k % drop_every == 0 {
                    work = Work::default();
                }
            }
            (state, meshes)
        })
    };
    let (one, meshes) = run(1, 1000);
    assert!(meshes > 0 || !meshed_anew, "the run should make a new mesh on its way");
    assert!(one == run(2, 1000).0);
    assert!(one == run(2, 7).0);
}

#[test]
fn the_budget_balances_and_notices_what_does_not() {
    let (start, mut model) = pressed(150);
    let audit = |model: &Model, steps: u64| {
        let (mut state, mut work, mut budget) = (start.clone(), Work::default(), Budget::default());
        state.step = 0;
        for _ in 0..steps {
            let report = step(&mut state, model, &mut work).unwrap();
            budget.add(&report.water.unwrap(), work.fluid.mesh().unwrap(), None, report.dt)?;
        }
        Ok::<_, Unbalanced>((budget, state, work))
    };
    // A balance to 1e-6 takes a solve to better than that.
    let exact = Pores {
        step: Stepping::Explicit,
        residual: 1e-8,
        conductance: Conductance::hydraulic_radius(),
        ..Pores::default()
    };
    model.fluid = water(8.0, Stepping::Explicit);
    model.fluid.as_mut().unwrap().flow = Flow::Pores(exact);
    let (explicit, ..) = audit(&model, 301).unwrap();
    assert_eq!(explicit.audits, 4);
    assert!(
        explicit.flux < 1e-6 && explicit.power < 1e-6 && explicit.mass_drift.abs() < 1e-9,
        "{explicit:?}"
    );
    model.fluid = water(8.0, Stepping::Implicit);
    let (implicit, state, work) = audit(&model, 301).unwrap();
    assert!(implicit.flux < 1e-2 && implicit.power < 1e-2 && implicit.force < 1e-12, "{implicit:?}");
    assert!(implicit.mass_drift.abs() < 1e-6 && implicit.iterations > 301, "{implicit:?}");
    // Pressures a little wrong are seen at once, ...
    let (mesh, mut carried) = (work.fluid.mesh().unwrap(), Carried::default());
    let State { grains, domain, .. } = &state;
    mesh.carried(&grains.velocity, &grains.spin, &domain.wall_velocity, &mut carried);
    let wrong: Vec<f64> = state.pores().unwrap().pressure.iter().map(|p| 1.5 * p).collect();
    let seen = Audit::of(mesh, &carried, &wrong, &Pull::default(), grains.len(), 1.0);
    assert!(seen.flux > 0.05 && seen.power > 0.05 && seen.force < 1e-12, "{seen:?}");
    // ... and a careless solve stops the run.
    let pores = Pores {
        step: Stepping::Implicit,
        implicit_residual: 0.5,
        conductance: Conductance::hydraulic_radius(),
        ..Pores::default()
    };
    model.fluid = water(800.0, Stepping::Implicit);
    model.fluid.as_mut().unwrap().flow = Flow::Pores(pores);
    let error = audit(&model, 301).map(|_| ()).unwrap_err();
    assert!(error.to_string().starts_with("the budget of the water is off"), "{error}");
}

#[test]
#[ignore = "long: some seconds of explicit steps to compare with"]
fn ten_times_the_explicit_limit_gives_the_same_settlement() {
    let (start, mut model) = pressed(300);
    let ends = [0.005, 0.01, 0.015, 0.02];
    let mut curve = |step_: Stepping| {
        model.fluid = water(20.0, step_);
        let (mut state, mut work, mut seen, mut steps) = (start.clone(), Work::default(), Vec::new(), 0);
        for end in ends {
            let mut before = (state.time, settlement(&start, &state));
            while state.time - start.time < end {
                before = (state.time, settlement(&start, &state));
                step(&mut state, &model, &mut work).unwrap();
                steps += 1;
            }
            let part = (end + start.time - before.0) / (state.time - before.0);
            seen.push(before.1 + part * (settlement(&start, &state) - before.1));
        }
        (seen, steps)
    };
    let (implicit, few) = curve(Stepping::Implicit);
    let (explicit, many) = curve(Stepping::Explicit);
    assert!(many > 10 * few, "{many} {few}");
    for (a, b) in implicit.iter().zip(&explicit) {
        assert!((a / b - 1.0).abs() < 0.002, "{implicit:?} {explicit:?} {many} {few}");
    }
}
