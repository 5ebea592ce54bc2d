//! Periodic cells: invariants of grains that see images, of a lattice that deforms, and of stresses that are held.

use glam::{DMat3, DVec3};
use porograin::case::Case;
use porograin::cell::Components;
use porograin::contact::{Contacts, Law, Linear};
use porograin::measure;
use porograin::run::Simulation;
use porograin::{CellRule, Domain, Face, Grains, Model, Signal, State, TimeStep, Work, step};
use porograin_geometry::{Cell, Period};
use std::path::Path;

fn model(stiffness_ratio: f64, friction: f64) -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.5 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, stiffness_ratio, friction)).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| Face::default()),
        walls: Vec::new(),
        membrane: None,
        cell: CellRule::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn sheared() -> Cell {
    let edges =
        DMat3::from_cols(DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.3, 0.9, 0.0), DVec3::new(-0.2, 0.4, 0.95));
    Cell::periodic(DVec3::new(0.5, -2.0, 1.0), edges)
}

fn state(cell: Cell, grains: Grains) -> State {
    let domain = Domain::of(cell);
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
}

/// Random grains with velocities, some overlapping by up to a twentieth, images included.
fn cloud(cell: &Cell, n: usize, seed: u64) -> Grains {
    let mut bits = seed;
    let mut next = || {
        bits = bits.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (bits >> 11) as f64 / (1u64 << 53) as f64
    };
    let period = Period::of(cell).unwrap();
    let (mut position, mut radius): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while position.len() < n {
        let x = cell.origin + cell.edges * DVec3::new(next(), next(), next());
        let r = 0.09 + 0.03 * next();
        let free = |(y, s): (&DVec3, &f64)| {
            let branch: DVec3 = x - *y;
            (branch + period.nearest(branch)).length() > 0.95 * (r + s)
        };
        if position.iter().zip(&radius).all(free) {
            position.push(x);
            radius.push(r);
        }
    }
    let mut grains = Grains::at_rest(position, radius, 1000.0);
    for k in 0..n {
        grains.velocity[k] = 0.5 * DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
        grains.spin[k] = 2.0 * DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
    }
    grains
}

/// `sum m c`, c the velocities besides the flow of the cell, and `sum m |c|`.
fn momentum(state: &State) -> (DVec3, f64) {
    let peculiar = |k: usize| {
        let (x, v) = (state.grains.position[k], state.grains.velocity[k]);
        state.grains.mass[k] * state.domain.peculiar(x, v)
    };
    let n = state.grains.len();
    ((0..n).map(peculiar).sum(), (0..n).map(|k| peculiar(k).length()).sum())
}

fn without_drift(mut state: State) -> State {
    let mean = momentum(&state).0 / state.grains.mass.iter().sum::<f64>();
    state.grains.velocity.iter_mut().for_each(|v| *v -= mean);
    state
}

#[test]
fn a_cell_at_rest_keeps_momentum_and_energy_and_knows_how_far_grains_went() {
    let mut state = state(sheared(), cloud(&sheared(), 60, 3));
    let start = state.grains.position.clone();
    let model = Model { time_step: TimeStep::Automatic { safety: 0.1 }, ..model(0.0, 0.0) };
    let mut work = Work::default();
    let (before, size) = momentum(&state);
    let energy = |s: &State| {
        let elastic = measure::elastic_energy(s, &model);
        measure::kinetic_energy(&s.grains) + elastic
    };
    step(&mut state, &model, &mut work).unwrap();
    let first = energy(&state);
    while state.time < 3.0 {
        step(&mut state, &model, &mut work).unwrap();
    }
    assert!((momentum(&state).0 - before).length() < 1e-12 * size);
    assert!((energy(&state) / first - 1.0).abs() < 0.02, "{}", energy(&state) / first);
    let period = Period::of(&state.domain.cell).unwrap();
    assert!(state.grains.position.iter().all(|&x| period.beyond(x) == DVec3::ZERO));
    // The centre of mass went straight on, through the sides of the cell.
    let total: f64 = state.grains.mass.iter().sum();
    let gone: DVec3 = (0..60)
        .map(|k| {
            let now = state.domain.unwrapped(k, state.grains.position[k]);
            state.grains.mass[k] * (now - start[k])
        })
        .sum();
    assert!((gone - state.time * before).length() < 1e-9 * total, "{gone} {}", state.time * before);
    assert!(state.domain.crossed.iter().flatten().any(|&c| c != 0));
}

/// The same sample with another choice of origin, period vectors and images goes the same way.
#[test]
fn the_choice_of_images_does_not_matter() {
    let cell = sheared();
    let grains = cloud(&cell, 90, 5);
    let mut other = Cell { origin: cell.origin + DVec3::new(0.37, 0.11, -0.4), ..cell };
    other.edges.z_axis += other.edges.y_axis - other.edges.x_axis;
    let mut moved = grains.clone();
    for (k, x) in moved.position.iter_mut().enumerate() {
        *x += cell.shift([k as i8 % 3 - 1, k as i8 % 2, -1]);
    }
    let (model, period) = (model(0.5, 30.0), Period::of(&cell).unwrap());
    let (mut a, mut b) = (state(cell, grains), state(other, moved));
    let mut works = [Work::default(), Work::default()];
    let mut crossing: std::collections::BTreeSet<[u32; 2]> = Default::default();
    // Round-off grows with every collision: few enough of them to tell.
    for _ in 0..200 {
        step(&mut a, &model, &mut works[0]).unwrap();
        let apart = |[i, j]: [u32; 2]| a.grains.position[j as usize] - a.grains.position[i as usize];
        crossing.extend(a.contacts.pairs().filter(|pair| period.nearest(apart(*pair)) != DVec3::ZERO));
        step(&mut b, &model, &mut works[1]).unwrap();
    }
    assert!(a.contacts.pairs().eq(b.contacts.pairs()));
    assert!(crossing.len() > 20, "{}", crossing.len());
    for (x, y) in a.grains.position.iter().zip(&b.grains.position) {
        let apart = *y - *x;
        let off = (apart + period.nearest(apart)).length();
        assert!(off < 1e-10, "{off:e}");
    }
}

fn driven(xz: f64, zz: f64) -> CellRule {
    let gradient = Components {
        xz: Some(Signal::Constant(xz)),
        zz: Some(Signal::Constant(zz)),
        ..Components::default()
    };
    CellRule { gradient, ..CellRule::default() }
}

#[test]
fn shear_keeps_momentum_a_good_lattice_and_the_same_bits_without_scratch() {
    let cell = sheared();
    let model = Model { cell: driven(1.5, 0.0), ..model(0.5, 30.0) };
    let mut state = without_drift(state(cell, cloud(&cell, 60, 7)));
    let mut again = state.clone();
    let (mut work, mut flips) = (Work::default(), 0);
    while state.time < 2.0 {
        let before = state.domain.cell.edges.z_axis.x;
        step(&mut state, &model, &mut work).unwrap();
        step(&mut again, &model, &mut Work::default()).unwrap();
        flips += u32::from(state.domain.cell.edges.z_axis.x < before);
    }
    assert_eq!(state, again);
    assert!((2..=4).contains(&flips), "{flips}");
    assert!((state.domain.strain.z_axis.x / (1.5 * state.time) - 1.0).abs() < 1e-12);
    assert!((state.domain.cell.volume() / cell.volume() - 1.0).abs() < 1e-12);
    assert!(Period::of(&state.domain.cell).unwrap().height() > 0.6);
    let (sum, size) = momentum(&state);
    assert!(sum.length() < 1e-11 * size, "{sum} {size}");
    // The flips are in the count of periods: a grain at rest in the flow has gone as far as its height says.
    let drift: f64 = (0..60)
        .map(|k| {
            let x = state.domain.unwrapped(k, state.grains.position[k]) - state.domain.cell.origin;
            let (y, z) = (x.y, x.z);
            assert!(y.abs() < 3.0 && z.abs() < 3.0, "only the shear carries grains far: {x}");
            x.x
        })
        .fold(0.0, f64::max);
    assert!(drift > 1.5, "{drift}");
}

/// A sheared cell under a held stress, large enough to be shared between threads.
#[test]
fn a_held_and_sheared_cell_gives_the_same_bits_on_two_threads_and_after_a_restart() {
    let n = 11;
    let cell = Cell::periodic(DVec3::ZERO, DMat3::IDENTITY * (0.199 * n as f64));
    let place = |k: usize| DVec3::new((k % n) as f64, (k / n % n) as f64, (k / n / n) as f64);
    let count = n * n * n;
    let shake = |k: usize, a: f64| (a * k as f64).sin();
    let position = (0..count).map(|k| 0.199 * (place(k) + 0.5) + 0.002 * shake(k, 2.3)).collect();
    let mut grains = Grains::at_rest(position, vec![0.1; count], 1000.0);
    for k in 0..count {
        grains.velocity[k] = 0.1 * DVec3::new(shake(k, 1.1), shake(k, 3.7), shake(k, 5.9));
    }
    let start = state(cell, grains);
    let mut rule = driven(1.5, 0.0);
    (rule.gradient.zz, rule.stress.zz) = (None, Some(Signal::Constant(5e3)));
    let model = Model { cell: rule, damping: 0.1, ..model(0.5, 30.0) };
    let run = |threads: usize, restart: bool| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let (mut state, mut work) = (start.clone(), Work::default());
            for k in 0..60 {
                if restart && k % 20 == 10 {
                    state = postcard::from_bytes(&postcard::to_stdvec(&state).unwrap()).unwrap();
                    work = Work::default();
                }
                step(&mut state, &model, &mut work).unwrap();
                // The stress that drives the cell is the one that is measured (contacts as the step found them).
                assert!(work.loads.virial.is_some());
            }
            state
        })
    };
    let one = run(1, false);
    assert!(one.domain.rate.z_axis.z != 0.0);
    assert!(one == run(2, false));
    assert!(one == run(2, true));
}

/// What the contact pass adds up for the cell is the stress that is measured, walls included.
#[test]
fn the_virial_of_the_step_is_the_measured_stress() {
    let cell = Cell { periodic: [true, true, false], ..Cell::walled(DVec3::ZERO, DVec3::ONE) };
    let mut grains = cloud(&Cell { periodic: [true; 3], ..cell }, 60, 7);
    grains.position.iter_mut().for_each(|x| x.z = x.z.clamp(0.09, 0.91));
    let mut rule = CellRule::default();
    rule.stress.xx = Some(Signal::Constant(1e3));
    let model = Model { time_step: TimeStep::Fixed(0.0), cell: rule, ..model(0.5, 30.0) };
    let (mut state, mut work) = (state(cell, grains), Work::default());
    step(&mut state, &model, &mut work).unwrap();
    let volume = state.domain.cell.volume();
    let (found, asked) =
        (work.loads.virial.unwrap() * volume.recip(), measure::contact_stress(&state, &model));
    assert!(asked.z_axis.z.abs() > 1.0);
    for column in 0..3 {
        let off = (found.col(column) - asked.col(column)).abs().max_element();
        assert!(off < 1e-12 * asked.col(column).length().max(asked.z_axis.z), "{found} {asked}");
    }
}

/// A cubic close packing follows the cell exactly: what the stress works is what the contacts store.
#[test]
fn the_work_of_the_stress_is_the_energy_of_the_contacts() {
    let (n, radius) = (3, 0.1);
    let side = 2.0 * 2f64.sqrt() * radius;
    let mut position = Vec::new();
    for k in 0..n * n * n {
        let corner = side * DVec3::new((k % n) as f64, (k / n % n) as f64, (k / n / n) as f64);
        for motif in
            [DVec3::ZERO, DVec3::new(0.5, 0.5, 0.0), DVec3::new(0.5, 0.0, 0.5), DVec3::new(0.0, 0.5, 0.5)]
        {
            position.push(corner + side * (motif + 0.2));
        }
    }
    let count = position.len();
    let grains = Grains::at_rest(position, vec![1.01 * radius; count], 1000.0);
    let cell = Cell::periodic(DVec3::ZERO, side * n as f64 * DMat3::IDENTITY);
    let error = |dt: f64| {
        let model = Model { time_step: TimeStep::Fixed(dt), cell: driven(0.03, -0.02), ..model(0.5, 80.0) };
        let mut state = state(cell, grains.clone());
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        assert_eq!(state.contacts.len(), 6 * count);
        let mut energy = measure::elastic_energy(&state, &model);
        let first = energy;
        let mut done = 0.0;
        let mut power = 0.0;
        for k in 0..=(0.2 / dt) as usize {
            // Springs are advanced at the beginning of a step: compare states between their middles.
            step(&mut state, &model, &mut work).unwrap();
            let stress = measure::contact_stress(&state, &model);
            let rate = state.domain.rate;
            let now =
                -state.domain.cell.volume() * (0..3).map(|b| stress.col(b).dot(rate.col(b))).sum::<f64>();
            if k == 0 {
                energy = measure::elastic_energy(&state, &model);
            } else {
                done += 0.5 * dt * (now + power);
            }
            power = now;
        }
        for (x, v) in state.grains.position.iter().zip(&state.grains.velocity) {
            assert!(state.domain.peculiar(*x, *v).length() < 1e-9);
        }
        let stored = measure::elastic_energy(&state, &model) - energy;
        assert!(stored > 0.05 * first);
        (done / stored - 1.0).abs()
    };
    let errors = [error(4e-4), error(2e-4)];
    assert!(errors.iter().all(|e| *e < 5e-5), "{errors:?}");
}

fn run(case: &str) -> Simulation {
    let case = Case::from_text("periodic", case, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
    let mut simulation = Simulation::new(&case).unwrap_or_else(|e| panic!("{e}"));
    while simulation.advance().unwrap_or_else(|e| panic!("{e}")).is_some() {}
    simulation
}

#[test]
fn held_stresses_are_reached() {
    let simulation = run(r#"
title = "a periodic sample is pressed unequally"
[domain]
size = [0.01, 0.01, 0.01]
periodic = "xyz"
[grains]
packing = { cloud = { count = 150, spread = 0.2, seed = 1, porosity = 0.7 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 10.0
[[stage]]
name = "press"
cell = { stress = { xx = 1000.0, yy = 1000.0, zz = 1500.0 } }
until = { steps = 12000 }
"#);
    let stress = measure::contact_stress(&simulation.state, &simulation.stages()[0].model);
    for (axis, asked) in [1000.0, 1000.0, 1500.0].into_iter().enumerate() {
        assert!((stress.col(axis)[axis] / asked - 1.0).abs() < 0.01, "{stress}");
    }
    let solid = 1.0 - measure::porosity(&simulation.state);
    assert!((0.58..0.68).contains(&solid), "{solid}");
}

#[test]
fn two_plates_press_a_sample_without_sides() {
    let simulation = run(r#"
title = "two plates"
[domain]
size = [0.01, 0.01, 0.012]
periodic = [true, true, false]
[grains]
packing = { cloud = { count = 150, spread = 0.2, seed = 1, porosity = 0.7 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 10.0
[face.top]
solid = { servo = { stress = 1000.0 } }
friction = 30.0
[[stage]]
name = "press"
until = { unbalanced = 1e-3, stress-error = 0.01, max-steps = 40000 }
"#);
    let state = &simulation.state;
    let faces = measure::wall_stress(&state.domain);
    assert!((faces[4] / 1000.0 - 1.0).abs() < 0.02 && faces[0] == 0.0, "{faces:?}");
    let inner = measure::contact_stress(state, &simulation.stages()[0].model);
    assert!((inner.z_axis.z / 1000.0 - 1.0).abs() < 0.02, "{inner}");
    assert!(state.grains.position.iter().all(|x| x.z > 0.0 && x.z < state.domain.cell.upper().z));
    let momentum: DVec3 =
        (0..state.grains.len()).map(|k| state.grains.mass[k] * state.grains.velocity[k]).sum();
    assert!(momentum.length() < 1e-2 * state.grains.mass.iter().sum::<f64>());
}

/// A frictionless sample in a cell that `domain` describes, with `packing`; until `until`.
fn frictionless(domain: &str, packing: &str, stage: &str) -> String {
    format!(
        r#"
title = "period vectors"
[domain]
periodic = "xyz"
{domain}
[grains]
packing = {packing}
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 0.0
[[stage]]
name = "go"
{stage}
"#
    )
}

/// The lattice of a cell has many period vectors: whichever a case names, the sample is the same. A sheared sample goes on in a new
/// case from its grains and its period vectors.
#[test]
fn a_case_names_any_period_vectors() {
    let stage = "cell = { stress = { xx = 1e3, yy = 1e3, zz = 1e3 } }\nuntil = { steps = 2500 }\n\
                 [[stage]]\nname = \"shear\"\ncell = { gradient = { xz = 15.0, yx = 7.0 } }\nuntil = { steps = 1500 }";
    let cloud = "{ cloud = { count = 100, spread = 0.2, seed = 1, porosity = 0.6 } }";
    let before = run(&frictionless("size = [0.01, 0.01, 0.01]", cloud, stage));
    let (cell, grains) = (before.state.domain.cell, &before.state.grains);
    let stress = measure::contact_stress(&before.state, before.model());
    assert!(cell.edges.z_axis.x.abs() > 1e-4 && stress.x_axis.x > 100.0, "{cell:?} {stress}");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let line = |k: usize| {
        let (x, r) = (grains.position[k], grains.radius[k]);
        format!("{:e},{:e},{:e},{r:e}\n", x.x, x.y, x.z)
    };
    std::fs::write(folder.join("leaning.csv"), (0..grains.len()).map(line).collect::<String>()).unwrap();
    let [a, b, c] = [0, 1, 2].map(|k| cell.edges.col(k));
    for periods in [[a, b, c], [a, b + 3.0 * a, c - 2.0 * b + a]] {
        let words: Vec<String> =
            periods.iter().map(|v| format!("[{:e}, {:e}, {:e}]", v.x, v.y, v.z)).collect();
        let domain = format!("periods = [{}]", words.join(", "));
        let text = frictionless(&domain, "{ file = \"leaning.csv\" }", "until = { steps = 1 }");
        let case = Case::from_text("case.toml", &text, folder, &[]).unwrap_or_else(|e| panic!("{e}"));
        let simulation = Simulation::new(&case).unwrap();
        let state = &simulation.state;
        assert!(Period::of(&state.domain.cell).unwrap().height() > 0.8 * Period::of(&cell).unwrap().height());
        // A step too short to move anything finds the contacts.
        let model = Model { time_step: TimeStep::Fixed(1e-15), ..simulation.model().clone() };
        let mut state = state.clone();
        step(&mut state, &model, &mut Work::default()).unwrap();
        let mut then = before.state.clone();
        then.grains.velocity.fill(DVec3::ZERO);
        (then.domain.rate, then.domain.gradient) = Default::default();
        step(&mut then, &model, &mut Work::default()).unwrap();
        let difference = measure::contact_stress(&state, &model) - measure::contact_stress(&then, &model);
        assert_eq!(state.contacts.len(), then.contacts.len());
        assert!(difference.to_cols_array().iter().all(|d| d.abs() < 1e-9 * stress.x_axis.x), "{difference}");
    }
}

/// Between two plates the period vectors lie along them; grains are thrown and spread in cells that lean.
#[test]
fn clouds_and_lattices_fill_cells_that_lean() {
    let two = "size = [0.01, 0.01, 0.01]";
    for (periodic, periods) in [
        ("xyz", "[[0.01, 0.0, 0.0], [0.004, 0.01, 0.0], [-0.003, 0.002, 0.012]]"),
        ("xy", "[[0.01, 0.002, 0.0], [-0.004, 0.01, 0.0], [0.0, 0.0, 0.012]]"),
    ] {
        for packing in [
            "{ cloud = { count = 200, spread = 0.2, seed = 1, porosity = 0.75 } }",
            "{ lattice = { count = [5, 5, 6], radius = 0.9e-3 } }",
        ] {
            let text = frictionless(two, packing, "until = { steps = 1 }")
                .replace("\"xyz\"", &format!("\"{periodic}\""))
                .replace(two, &format!("periods = {periods}"));
            let case =
                Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
            let state = Simulation::new(&case).unwrap().state;
            let (cell, grains) = (state.domain.cell, &state.grains);
            let asked = if packing.contains("cloud") { 0.75 } else { measure::porosity(&state) };
            assert!((measure::porosity(&state) - asked).abs() < 1e-12);
            let across = if periodic == "xyz" { 0.012 } else { 0.012 * (1.0 + 0.08) };
            assert!((cell.volume() / (1e-4 * across) - 1.0).abs() < 1e-12, "{}", cell.volume());
            let period = Period::of(&cell).unwrap();
            for (i, &x) in grains.position.iter().enumerate() {
                assert_eq!(period.beyond(x), DVec3::ZERO);
                let r = grains.radius[i];
                assert!(periodic == "xyz" || (r..=0.012 - r).contains(&x.z), "{x}");
                for j in 0..i {
                    let branch = grains.position[j] - x;
                    let gap = (branch + period.nearest(branch)).length() - grains.radius[j] - r;
                    assert!(gap > 0.0, "{i} {j} {gap:e}");
                }
            }
        }
    }
}

/// Resident memory of this process [pages].
#[cfg(target_os = "linux")]
fn resident() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    statm.split(' ').nth(1).unwrap().parse().unwrap()
}

/// A million steps, a strain of hundreds.
#[test]
#[ignore = "long: a million steps"]
#[cfg(target_os = "linux")]
fn a_million_steps_of_shear_keep_momentum_lattice_and_memory() {
    let cell = sheared();
    let mut model = Model { cell: driven(20.0, 0.0), ..model(0.5, 30.0) };
    // Without dampers the grains would get hotter and hotter.
    let restitution = Some(0.5.into());
    model.contact = Law::Linear(Linear { restitution, ..Linear::new(1e6, 0.5, 30.0) }).into();
    let mut state = without_drift(state(cell, cloud(&cell, 60, 7)));
    let (mut work, mut memory, mut worst) = (Work::default(), 0, [0.0_f64, f64::INFINITY]);
    // Inside the pool: entering it anew for every loop would cost more than the loops.
    rayon::scope(|_| {
        for k in 0..1_000_000 {
            step(&mut state, &model, &mut work).unwrap();
            if k == 100_000 {
                memory = resident();
            }
            if k % 1000 == 0 {
                let (sum, size) = momentum(&state);
                worst[0] = worst[0].max(sum.length() / size);
                worst[1] = worst[1].min(Period::of(&state.domain.cell).unwrap().height());
            }
        }
    });
    let strain = state.domain.strain.z_axis.x;
    println!(
        "strain {strain}, momentum {:e}, least height {}, {} pages more",
        worst[0],
        worst[1],
        resident() as i64 - memory as i64
    );
    assert!(strain > 100.0, "{strain}");
    assert!(worst[0] < 1e-9, "{}", worst[0]);
    assert!(worst[1] > 0.6, "{}", worst[1]);
    assert!((state.domain.cell.volume() / cell.volume() - 1.0).abs() < 1e-9);
    assert!(resident() <= memory + 64, "{} pages more", resident() - memory);
}
