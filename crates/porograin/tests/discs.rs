//! Discs with water on a grid: what is exact in a plane, as it is for spheres.

mod random;

use glam::DVec3;
use porograin::boundary::{Signal, Solid, Water};
use porograin::case::Case;
use porograin::contact::{Contacts, Law, Linear};
use porograin::darcy::{Cells, Darcy, Drag, Permeability, Transfer};
use porograin::grains::Shape;
use porograin::measure::CoarseFlow;
use porograin::run::Simulation;
use porograin::{Domain, Flow, FluidModel, Grains, Model, State, TimeStep, Work, step};
use random::Random;
use std::f64::consts::PI;
use std::path::Path;

/// Edges of the box [m]; the discs are as thick as it along y.
const SIZE: DVec3 = DVec3::new(0.0805, 0.03, 0.06);

/// Discs of several sizes in rows, shaken, on the way somewhere, in sealed walls.
fn sample(settings: Darcy, bulk_modulus: Option<f64>) -> (State, Model) {
    let (mut random, d) = (Random(11), 0.01);
    let (mut position, mut radius) = (Vec::new(), Vec::new());
    for row in 0..6 {
        for k in 0..8 - row % 2 {
            let place = DVec3::new(k as f64 + 0.5 + 0.5 * (row % 2) as f64, 1.5, row as f64 + 0.5);
            let shake = 0.05 * random.vector();
            position.push(d * (place + DVec3::new(shake.x, 0.0, shake.z)));
            radius.push(d * (0.42 + 0.08 * random.next()));
        }
    }
    let mut grains = Grains::shaped(Shape::Disc { thickness: SIZE.y }, position, radius, 2600.0);
    for v in &mut grains.velocity {
        *v = DVec3::new(random.next() - 0.5, 0.0, random.next() - 0.5) * 0.01;
    }
    let state = State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, SIZE),
        grains,
        contacts: Contacts::default(),
        fluid: None,
    };
    let model = Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(15e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces: Default::default(),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: Some(FluidModel {
            viscosity: 0.1,
            density: 1000.0,
            bulk_modulus,
            flow: Flow::Darcy(settings),
        }),
        stage_start: 0.0,
    };
    (state, model)
}

fn cells(count: [usize; 2], transfer: Transfer) -> Darcy {
    let [x, z] = count;
    Darcy { cells: Cells::Count([x, 1, z]), residual: 1e-14, transfer, ..Darcy::default() }
}

/// Between a sealed piston above, a wall that moves by decree below, and two open walls.
fn driven(settings: Darcy, bulk_modulus: Option<f64>) -> (State, Model) {
    let (state, mut model) = sample(settings, bulk_modulus);
    let zero = || Signal::Constant(0.0);
    model.faces[0].water =
        Water::Pressure(Signal::Sine { mean: 50.0, amplitude: 30.0, period: 0.01, start: 0.0 });
    model.faces[1].water = Water::Pressure(zero());
    model.faces[4].solid = Solid::Moving { velocity: [zero(), zero(), Signal::Constant(0.01)] };
    model.faces[4].water = Water::Inflow(Signal::Constant(1e-4));
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(500.0), mass: None, speed: None };
    (state, model)
}

const TRANSFERS: [Transfer; 2] = [Transfer::Overlap, Transfer::Kernel { width: 2.0 }];

#[test]
fn the_volumes_of_the_discs_in_the_cells_sum_to_that_of_the_discs() {
    for transfer in TRANSFERS {
        let (mut state, model) = sample(cells([5, 4], transfer), None);
        let all: f64 = state.grains.radius.iter().map(|r| PI * r * r * SIZE.y).sum();
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        let grid = work.fluid.darcy.grid().unwrap();
        assert!((grid.solid.iter().sum::<f64>() / all - 1.0).abs() < 1e-13, "{transfer:?}");
        // All of the volume in the same cells as in the plane, by quadrature of one of them.
        if transfer == Transfer::Overlap {
            let (cell, n) = (7, 1000);
            let (middle, size) = (grid.centre(cell), grid.size(cell));
            let inside = (0..n * n).filter(|k| {
                let at = |k: usize| (k as f64 + 0.5) / n as f64 - 0.5;
                let [x, z] = [middle.x + at(k % n) * size.x, middle.z + at(k / n) * size.z];
                let in_disc = |(c, r): (&DVec3, &f64)| (x - c.x).hypot(z - c.z) < *r;
                state.grains.position.iter().zip(&state.grains.radius).any(in_disc)
            });
            let part = inside.count() as f64 / (n * n) as f64;
            assert!((1.0 - grid.porosity[cell] - part).abs() < 1e-3, "{} {part}", grid.porosity[cell]);
        }
    }
}

#[test]
fn water_is_neither_lost_nor_made_and_forces_sum_to_the_resultant_of_the_pressures() {
    for (transfer, bulk_modulus) in [(TRANSFERS[0], None), (TRANSFERS[0], Some(1e6)), (TRANSFERS[1], None)] {
        let settings = Darcy { drag: Drag::Ergun, ..cells([4, 3], transfer) };
        let (mut state, model) = driven(settings, bulk_modulus);
        let mut work = Work::default();
        for _ in 0..100 {
            let time = state.time;
            step(&mut state, &model, &mut work).unwrap();
            let flows = work.fluid.darcy.flows;
            let sum = flows.outflow.iter().sum::<f64>() + flows.stored + flows.swept;
            let size =
                flows.outflow.iter().map(|q| q.abs()).sum::<f64>() + flows.stored.abs() + flows.swept.abs();
            assert!(sum.abs() < 1e-12 * size, "{flows:?}");
            assert_eq!(
                (flows.stored == 0.0, flows.outflow[2], flows.outflow[3]),
                (bulk_modulus.is_none(), 0.0, 0.0)
            );
            // Contacts sum to zero over discs and walls; what is left is the water, that outside pushes back at the open walls.
            let forces = || work.loads.force.iter().chain(&work.loads.wall);
            let (sum, size) = (forces().sum::<DVec3>(), forces().map(|f| f.length()).sum::<f64>());
            let Water::Pressure(signal) = &model.faces[0].water else { unreachable!() };
            let old = &state.grid().unwrap().grid_cell;
            let expected = DVec3::X * signal.at(time) * SIZE.y * (old.upper() - old.origin).z;
            assert!((sum - expected).length() < 1e-12 * size, "{sum} {expected} {size}");
        }
        assert!(state.grains.velocity.iter().all(|v| v.y == 0.0));
        assert!(state.grains.position.iter().all(|x| x.y == 0.5 * SIZE.y));
    }
}

#[test]
fn a_pressure_linear_in_the_plane_is_found_everywhere_and_does_not_depend_on_depth() {
    let given = DVec3::new(1e-9, 1.0, 2e-10);
    let settings =
        Darcy { permeability: Permeability::Given(given.to_array()), ..cells([5, 4], TRANSFERS[0]) };
    let (mut state, mut model) = sample(settings, None);
    // At rest, too heavy to be moved within a short step, and apart.
    model.time_step = TimeStep::Fixed(1e-6);
    state.grains.velocity.fill(DVec3::ZERO);
    state.grains.mass.fill(1e12);
    state.grains.radius.iter_mut().for_each(|r| *r *= 0.8);
    for face in [0, 1, 4, 5] {
        model.faces[face].water = Water::Pressure(Signal::Expression("1000*x - 300*z + 7".parse().unwrap()));
    }
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let grid = work.fluid.darcy.grid().unwrap();
    let flow = CoarseFlow::new(grid, state.grid().unwrap(), &state.grains, &state.domain.cell);
    let darcy = DVec3::new(-1000.0, 0.0, 300.0) * given / 0.1;
    let mut random = Random(3);
    for k in 0..=300 {
        for x in [SIZE * (k as f64 / 300.0), SIZE * (random.vector() + 0.5)] {
            let found = flow.at(x).unwrap();
            assert!((found.pressure - (1000.0 * x.x - 300.0 * x.z + 7.0)).abs() < 1e-9, "{x}: {found:?}");
            assert!((found.seepage - darcy).length() < 1e-9 * darcy.length(), "{x}: {found:?} {darcy}");
            let in_front = flow.at(DVec3::new(x.x, 0.0, x.z)).unwrap();
            assert!((in_front.pressure - found.pressure).abs() < 1e-12 * found.pressure.abs().max(1.0));
            assert_eq!((in_front.velocity, in_front.seepage), (found.velocity, found.seepage));
        }
    }
}

#[test]
fn a_sealed_box_has_a_free_level_that_stays() {
    let (mut state, model) = sample(cells([4, 3], TRANSFERS[0]), None);
    let mut work = Work::default();
    for _ in 0..20 {
        step(&mut state, &model, &mut work).unwrap();
    }
    assert!(work.fluid.free_level(&state));
    let [mean, least, most] =
        work.fluid.darcy.grid().unwrap().mean_least_greatest(&state.grid().unwrap().pressure);
    assert!(mean.abs() < 1e-9 * (most - least) && most > least, "{mean} {least} {most}");
    let (mut state, model) = driven(cells([4, 3], TRANSFERS[0]), None);
    step(&mut state, &model, &mut work).unwrap();
    assert!(!work.fluid.free_level(&state));
}

/// A disc of a heavier material weighs its area times its thickness, and a disc that grows gains by the square of its radius.
#[test]
fn discs_of_materials_and_discs_that_grow_weigh_what_discs_do() {
    let text = r#"
title = "discs"
[domain]
size = [0.04, 0.002, 0.04]
discs = true
[grains]
packing = { lattice = { count = [6, 1, 6], radius = 2e-3 } }
density = 2600.0
[material.glass]
part = 0.5
[material.steel]
part = 0.5
density = 7800.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[[stage]]
name = "grow"
grow = { porosity = 0.4, rate = 5.0 }
until = { unbalanced = 1.0, max-steps = 100000 }
"#;
    let case = Case::from_text("case.toml", text, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
    let mut simulation = Simulation::new(&case).unwrap();
    let weigh = |grains: &Grains| {
        for k in 0..grains.len() {
            let density = [2600.0, 7800.0][usize::from(grains.material[k])];
            let expected = density * PI * grains.radius[k].powi(2) * 0.002;
            assert!((grains.mass[k] / expected - 1.0).abs() < 1e-12, "{k}: {} {expected}", grains.mass[k]);
        }
    };
    weigh(&simulation.state.grains);
    while simulation.advance().unwrap().is_some() {}
    weigh(&simulation.state.grains);
    assert!(simulation.state.grains.radius[0] > 2.1e-3);
    assert!((porograin::measure::porosity(&simulation.state) - 0.4).abs() < 1e-9);
}
