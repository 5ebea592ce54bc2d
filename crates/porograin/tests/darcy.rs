//! Coarse water: exact sums, balance, orders of accuracy, the same bits, no limit to the time step.

mod random;

use glam::DVec3;
use porograin::boundary::{Signal, Solid, Water};
use porograin::contact::{Contacts, Law, Linear};
use porograin::darcy::grid::Plan;
use porograin::darcy::pressure::Outside;
use porograin::darcy::{Cells, Darcy, Follow, Grid, Permeability, System, Terms, Transfer};
use porograin::measure::CoarseFlow;
use porograin::{Domain, Flow, FluidModel, Grains, Model, State, TimeStep, Work, step};
use random::Random;
use std::f64::consts::PI;

/// A cubic arrangement of touching grains, slightly shaken, in sealed walls.
fn sample(settings: Darcy, viscosity: f64, bulk_modulus: Option<f64>) -> (State, Model) {
    let (n, d) = (6, 0.01);
    let mut seed = 3u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut position = Vec::new();
    for k in 0..n {
        for j in 0..n {
            for i in 0..n {
                let shake = DVec3::new(random(), random(), random()) * 0.1 * d;
                position.push(DVec3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5) * d + shake);
            }
        }
    }
    let radius = vec![0.49 * d; position.len()];
    let mut grains = Grains::at_rest(position, radius, 2600.0);
    for v in &mut grains.velocity {
        *v = DVec3::new(random(), random(), random()) * 0.01;
    }
    let state = State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, DVec3::splat(n as f64 * d)),
        grains,
        contacts: Contacts::default(),
        fluid: None,
    };
    let model = Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::new(0.0, 0.0, -9.81),
        contact: Law::Linear(Linear::new(15e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces: Default::default(),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: Some(FluidModel { viscosity, density: 1000.0, bulk_modulus, flow: Flow::Darcy(settings) }),
        stage_start: 0.0,
    };
    (state, model)
}

fn cells(count: [usize; 3]) -> Darcy {
    Darcy { cells: Cells::Count(count), residual: 1e-14, ..Darcy::default() }
}

/// A sample between a sealed piston, a wall that moves by decree and open faces.
fn driven(settings: Darcy, viscosity: f64, bulk_modulus: Option<f64>) -> (State, Model) {
    let (state, mut model) = sample(settings, viscosity, bulk_modulus);
    let zero = || Signal::Constant(0.0);
    model.faces[1].water =
        Water::Pressure(Signal::Sine { mean: 50.0, amplitude: 30.0, period: 0.01, start: 0.0 });
    model.faces[2].water = Water::Pressure(zero());
    model.faces[4].solid = Solid::Moving { velocity: [zero(), zero(), Signal::Constant(0.01)] };
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(500.0), mass: None, speed: None };
    (state, model)
}

#[test]
fn the_volumes_of_the_grains_in_the_cells_sum_to_that_of_the_grains() {
    for transfer in [Transfer::Overlap, Transfer::Kernel { width: 2.0 }] {
        let (mut state, model) = sample(Darcy { transfer, ..cells([3, 4, 5]) }, 1e-3, None);
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        let grid = work.fluid.darcy.grid().unwrap();
        let (sum, all) = (grid.solid.iter().sum::<f64>(), state.grains.volume());
        assert!((sum / all - 1.0).abs() < 1e-13, "{transfer:?} {sum} {all}");
        // The parts around corners are weights in single precision.
        for k in 0..state.grains.len() {
            let part = grid.corners.volume(k) / state.grains.shape.volume(state.grains.radius[k]);
            assert!((part - 1.0).abs() < 1e-6, "{k}: {part}");
        }
    }
}

#[test]
fn water_is_neither_lost_nor_made() {
    for bulk_modulus in [None, Some(1e6)] {
        let (mut state, model) = driven(cells([3, 3, 3]), 0.1, bulk_modulus);
        let mut work = Work::default();
        for _ in 0..100 {
            step(&mut state, &model, &mut work).unwrap();
            let flows = work.fluid.darcy.flows;
            let sum = flows.outflow.iter().sum::<f64>() + flows.stored + flows.swept;
            let size =
                flows.outflow.iter().map(|q| q.abs()).sum::<f64>() + flows.stored.abs() + flows.swept.abs();
            assert!(sum.abs() < 1e-12 * size, "{flows:?}");
            assert_eq!(flows.stored == 0.0, bulk_modulus.is_none());
        }
    }
}

#[test]
fn forces_on_grains_and_walls_sum_to_the_resultant_of_the_pressures_at_open_faces() {
    for transfer in [Transfer::Overlap, Transfer::Kernel { width: 2.0 }] {
        let (mut state, mut model) = driven(Darcy { transfer, ..cells([3, 2, 4]) }, 0.1, None);
        model.gravity = DVec3::ZERO;
        let mut work = Work::default();
        for _ in 0..20 {
            let before = state.clone();
            step(&mut state, &model, &mut work).unwrap();
            // Contacts sum to zero over grains and walls; what is left is the water.
            let sum = work.loads.force.iter().sum::<DVec3>() + work.loads.wall.iter().sum::<DVec3>();
            let size: f64 = work.loads.force.iter().map(|f| f.length()).sum();
            let size_of = before.domain.cell.upper() - before.domain.cell.origin;
            let Water::Pressure(signal) = &model.faces[1].water else { unreachable!() };
            let expected = DVec3::X * -signal.at(before.time) * size_of.y * size_of.z;
            // The grid's planes are as old as its last renewal.
            let old = &state.grid().unwrap().grid_cell;
            let area = (old.upper() - old.origin).y * (old.upper() - old.origin).z;
            let expected = expected / (size_of.y * size_of.z) * area;
            assert!((sum - expected).length() < 1e-12 * size, "{sum} {expected} {size}");
        }
    }
}

/// The lower half of a sample, moved up, below a gap: bottom at 50 Pa, top open. Force of the water on all grains over 50 Pa times the
/// section; the same if only the links that lie in the gap as a whole lose their force; the largest acceleration over the mean one.
fn below_a_gap(up: f64) -> [f64; 3] {
    let (mut state, mut model) = sample(cells([3, 3, 6]), 1e-3, None);
    model.gravity = DVec3::ZERO;
    // Separated grains, heavy enough to stay.
    let grains = &state.grains;
    let kept: Vec<DVec3> = grains.position.iter().copied().filter(|x| x.z < 0.03).collect();
    let radius = vec![0.8 * grains.radius[0]; kept.len()];
    state.grains = Grains::at_rest(kept.into_iter().map(|x| x + up * DVec3::Z).collect(), radius, 2.6e12);
    model.faces[4].water = Water::Pressure(Signal::Constant(50.0));
    model.faces[5].water = Water::Pressure(Signal::Constant(0.0));
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let (force, grains) = (&work.loads.force, &state.grains);
    let sum = force.iter().map(|f| f.z).sum::<f64>() / (50.0 * 0.0036);
    let acceleration = |k: usize| force[k].length() / grains.mass[k];
    let largest = (0..grains.len()).map(acceleration).fold(0.0, f64::max);
    let mean = 50.0 * 0.0036 / grains.mass.iter().sum::<f64>();
    let mobility = &work.fluid.darcy.grid().unwrap().mobility;
    let (packing, gap) = (1.0 / mobility[4].z, 1.0 / mobility[9 * 5 + 4].z);
    [sum, 1.0 - 2.5 * gap / (3.0 * packing + 3.0 * gap), largest / mean]
}

#[test]
fn a_gap_takes_the_force_of_its_own_pressures_and_a_sliver_no_more_than_its_share() {
    let [sum, expected, largest] = below_a_gap(0.0);
    assert!((sum - expected).abs() < 2e-3 && sum < 1.0, "{sum} {expected}");
    assert!(largest < 2.0, "{largest}");
    // The tops of the grains reach 0.2 mm beyond the centre of a cell.
    let [sum, _, largest] = below_a_gap(0.0063);
    assert!(sum > 0.85 && sum < 1.0, "{sum}");
    assert!(largest < 2.0, "{largest}");
}

#[test]
fn the_drag_holds_grains_back_against_those_around_them_and_sums_to_zero() {
    // Separated grains in sealed walls, at rest but for one, in water so thin that its drag changes no velocity within a step.
    let (mut state, mut model) = sample(cells([3, 3, 3]), 1e-6, Some(1e-30));
    model.gravity = DVec3::ZERO;
    state.grains.radius.iter_mut().for_each(|r| *r *= 0.8);
    state.grains.velocity.fill(DVec3::ZERO);
    // In the middle, where no wall pushes back.
    let (k, v) = (3 * 36 + 3 * 6 + 3, DVec3::new(0.01, -0.02, 0.03));
    state.grains.velocity[k] = v;
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let (force, grid) = (&work.loads.force, work.fluid.darcy.grid().unwrap());
    let size: f64 = force.iter().map(|f| f.length()).sum();
    assert!(force.iter().sum::<DVec3>().length() < 1e-12 * size && size > 0.0);
    // Goodarzi (8): -beta/(1 - n) V_p v, less what its own share of the mean around a corner takes off.
    let volume = state.grains.shape.volume(state.grains.radius[k]);
    let resistance = -force[k].dot(v) / (volume * v.length_squared());
    let bounds = grid.resistance.iter().fold([f64::INFINITY, 0.0], |[a, b], &r| [r.min(a), r.max(b)]);
    assert!(resistance < bounds[1] && resistance > 0.75 * bounds[0], "{resistance} {bounds:?}");
}

#[test]
fn moving_everything_together_moves_no_water_through_the_grains() {
    let (mut state, mut model) = sample(cells([3, 3, 3]), 0.1, None);
    model.gravity = DVec3::ZERO;
    model.faces[5].water = Water::Pressure(Signal::Constant(0.0));
    let v = DVec3::new(0.02, -0.03, 0.01);
    state.grains.velocity.fill(v);
    // Separated grains: no contacts.
    state.grains.radius.iter_mut().for_each(|r| *r *= 0.8);
    for face in 0..5 {
        model.faces[face].solid = Solid::Moving { velocity: v.to_array().map(Signal::Constant) };
    }
    model.faces[5].solid = Solid::Moving { velocity: v.to_array().map(Signal::Constant) };
    let mut work = Work::default();
    for _ in 0..30 {
        step(&mut state, &model, &mut work).unwrap();
    }
    let pressure = &state.grid().unwrap().pressure;
    assert!(pressure.iter().all(|p| p.abs() < 1e-9), "{pressure:?}");
    assert!(work.fluid.darcy.flows.outflow[5].abs() < 1e-15);
    assert!(state.grains.velocity.iter().all(|w| (*w - v).length() < 1e-12));
    // So the water moves along, up to the walls.
    let flow = flow(&state, &work);
    let (from, to) = (state.domain.cell.origin, state.domain.cell.upper());
    for x in anywhere(from, to) {
        let found = flow.at(x).unwrap();
        assert!((found.velocity - v).length() < 1e-12, "{x}: {found:?}");
    }
}

fn run(threads: usize, steps: usize, drop_every: usize, settings: &Darcy) -> (State, u64) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let (mut state, model) = driven(settings.clone(), 0.02, Some(1e7));
        let mut work = Work::default();
        for k in 0..steps {
            if drop_every > 0 && k % drop_every == 0 {
                work = Work::default();
                let bytes = postcard::to_stdvec(&state).unwrap();
                state = postcard::from_bytes(&bytes).unwrap();
            }
            step(&mut state, &model, &mut work).unwrap();
        }
        let made = state.grid().unwrap().made_at_step;
        (state, made)
    })
}

#[test]
fn the_same_bits_on_any_number_of_threads_without_scratch_and_through_a_checkpoint() {
    let settings = Darcy {
        faces: Follow::Grains,
        drag: porograin::darcy::Drag::Ergun,
        renew: 0.002,
        ..cells([3, 3, 3])
    };
    let (one, made) = run(1, 150, 0, &settings);
    assert!(made > 0, "the grid should be renewed on the way");
    assert_eq!(one, run(2, 150, 0, &settings).0);
    assert_eq!(one, run(1, 150, 7, &settings).0);
    assert_eq!(one, run(2, 150, 1, &settings).0);
    assert!(one.grid().unwrap().slowed.iter().any(|&s| s < 1.0));
}

#[test]
fn the_water_sets_no_limit_to_the_time_step() {
    // From thin to thick: drag times step over mass runs from 1e-5 to 1e6. The sample overlaps at the start and bursts
    // apart at 5 m/s when dry.
    for viscosity in [1e-6, 1e-3, 1.0, 1e2, 1e3, 1e5] {
        let (mut state, model) = driven(cells([3, 3, 3]), viscosity, None);
        let mut work = Work::default();
        for _ in 0..1000 {
            step(&mut state, &model, &mut work).unwrap();
        }
        let speed = state.grains.velocity.iter().map(|v| v.length()).fold(0.0, f64::max);
        assert!(speed < 0.5, "{viscosity}: {speed}");
    }
}

/// Pressures that decay as `exp(-pi² D t)` between an open and a sealed end of a bar, grains held: the largest error at a
/// fixed time.
fn decay(cells: usize, steps: usize) -> f64 {
    let n = 24;
    let position: Vec<DVec3> = (0..n).map(|k| DVec3::new(0.5, 0.5, k as f64 + 0.5)).collect();
    let grains = Grains::at_rest(position, vec![0.5; n], 1.0);
    let length = n as f64;
    // Whole grains in every cell: the storage is uniform.
    let line = |k: usize| length * k as f64 / cells as f64;
    let plan = Plan {
        planes: [vec![0.0, 1.0], vec![0.0, 1.0], (0..=cells).map(line).collect()],
        transfer: Transfer::Overlap,
        permeability: Permeability::Given([1.0; 3]),
        viscosity: 1.0,
        slowed: &[],
    };
    let grid = Grid::new(&grains, &plan);
    let porosity = 1.0 - PI / 6.0;
    let (modulus, end) = (100.0, 0.4 * length * length / 100.0);
    let terms = Terms {
        kick: 0.0,
        interval: end / steps as f64,
        bulk_modulus: Some(modulus),
        open: [false, false, false, false, true, false],
        pistons: [0.0; 6],
        residual: 1e-13,
    };
    let wave = PI / (2.0 * length);
    let mut pressure: Vec<f64> = (0..cells).map(|c| (wave * grid.centre(c).z).sin()).collect();
    pressure.resize(grid.nodes(), 0.0);
    for w in 0..grid.wall_face.len() {
        pressure[cells + w] = (wave * grid.wall_centre(w).z).sin();
    }
    let carried = vec![[0.0; 4]; grid.corners.len()];
    let imposed = vec![0.0; grid.wall_face.len()];
    let outside = Outside { carried: &carried, wall_velocity: [DVec3::ZERO; 6], imposed: &imposed };
    let mut change = vec![0.0; cells];
    let mut system = System::new(&grid, terms);
    for _ in 0..steps {
        system.advance(&grid, &outside, &mut pressure, &mut change).unwrap();
    }
    let left = (-wave * wave * modulus / porosity * end).exp();
    (0..cells).map(|c| (pressure[c] - left * (wave * grid.centre(c).z).sin()).abs()).fold(0.0, f64::max)
}

#[test]
fn second_order_in_space_and_first_in_time() {
    // Halving the cells with steps short enough that time does not show, and the other way round.
    let space = [decay(6, 4096), decay(12, 16384)];
    let order = (space[0] / space[1]).log2();
    assert!((order - 2.0).abs() < 0.1, "in space {order} {space:?}");
    let time = [decay(24, 10), decay(24, 20)];
    let order = (time[0] / time[1]).log2();
    assert!((order - 1.0).abs() < 0.1, "in time {order} {time:?}");
}

/// Heavy grains at rest, that the water cannot move, behind a formula at some faces.
fn held(settings: Darcy, faces: [Water; 6]) -> (State, Model) {
    let (mut state, mut model) = sample(settings, 1e-3, None);
    model.gravity = DVec3::ZERO;
    state.grains.mass.fill(1e12);
    state.grains.velocity.fill(DVec3::ZERO);
    // Grains that do not touch have no forces.
    state.grains.radius.iter_mut().for_each(|r| *r *= 0.8);
    for (face, water) in model.faces.iter_mut().zip(faces) {
        face.water = water;
    }
    (state, model)
}

fn formula(text: &str) -> Signal {
    Signal::Expression(text.parse().unwrap())
}

fn flow<'a>(state: &'a State, work: &'a Work) -> CoarseFlow<'a> {
    let grid = work.fluid.darcy.grid().unwrap();
    CoarseFlow::new(grid, state.grid().unwrap(), &state.grains, &state.domain.cell)
}

/// Places in a box: its corners, a diagonal, the walls, and inside.
fn anywhere(from: DVec3, to: DVec3) -> Vec<DVec3> {
    let mut random = Random(5);
    let mut places: Vec<DVec3> = (0..=40).map(|k| from + (to - from) * (k as f64 / 40.0)).collect();
    for k in 0..400 {
        let mut at = (random.vector() + 0.5).to_array();
        match k % 4 {
            0 => {}
            1 => at[k / 4 % 3] = (k / 12 % 2) as f64,
            2 => at[..2].fill((k / 4 % 2) as f64),
            _ => at = [k / 4, k / 8, k / 16].map(|bit| (bit % 2) as f64),
        }
        places.push(from + (to - from) * DVec3::from_array(at));
    }
    places
}

#[test]
fn a_linear_pressure_and_its_flow_are_found_everywhere_and_nothing_beyond_the_walls() {
    let given = DVec3::new(1e-9, 3e-9, 2e-10);
    let permeability = Permeability::Given(given.to_array());
    let slope = DVec3::new(1000.0, -300.0, 70.0);
    let faces = std::array::from_fn(|_| Water::Pressure(formula("1000*x - 300*y + 70*z + 1")));
    let (mut state, model) = held(Darcy { permeability, ..cells([3, 4, 5]) }, faces);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let flow = flow(&state, &work);
    let darcy = -slope * given / 1e-3;
    let (from, to) = (state.domain.cell.origin, state.domain.cell.upper());
    for x in anywhere(from, to) {
        let found = flow.at(x).unwrap();
        assert!((found.pressure - slope.dot(x) - 1.0).abs() < 1e-9, "{x}: {found:?}");
        assert!((found.seepage - darcy).length() < 1e-9 * darcy.length(), "{x}: {found:?} {darcy}");
    }
    assert!((flow.discharge() - darcy).length() < 1e-9 * darcy.length());
    for axis in DVec3::AXES {
        assert_eq!((flow.at(to + 1e-6 * axis), flow.at(from - 1e-6 * axis)), (None, None));
    }
}

#[test]
fn through_layers_the_pressure_falls_in_straight_lines_and_the_flux_is_the_outflow_at_every_height() {
    let mut faces = [const { Water::Sealed }; 6];
    faces[4] = Water::Pressure(Signal::Constant(100.0));
    faces[5] = Water::Pressure(Signal::Constant(0.0));
    let (mut state, model) = held(cells([3, 2, 6]), faces);
    // Layers of one porosity each, thinner and thinner.
    for (x, r) in state.grains.position.iter_mut().zip(&mut state.grains.radius) {
        *x = 0.01 * ((*x / 0.01 - 0.5).round() + 0.5);
        *r = 0.0045 - 0.02 * x.z;
    }
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let (flow, grid) = (flow(&state, &work), work.fluid.darcy.grid().unwrap());
    let layers: Vec<f64> = (0..6).map(|z| 0.01 / grid.mobility[6 * z].z).collect();
    assert!(layers[0] > 3.0 * layers[5], "{layers:?}");
    let flux = 100.0 / layers.iter().sum::<f64>();
    let outflow = work.fluid.darcy.flows.outflow;
    assert!((outflow[5] / (flux * 0.0036) - 1.0).abs() < 1e-11);
    for x in anywhere(DVec3::ZERO, DVec3::splat(0.06)) {
        let below = |(z, layer): (usize, &f64)| layer * (x.z / 0.01 - z as f64).clamp(0.0, 1.0);
        let pressure = 100.0 - flux * layers.iter().enumerate().map(below).sum::<f64>();
        let found = flow.at(x).unwrap();
        assert!((found.pressure - pressure).abs() < 1e-9, "{x}: {found:?} {pressure}");
        assert!((found.seepage - flux * DVec3::Z).length() < 1e-11 * flux, "{x}: {found:?} {flux}");
        let z = ((x.z / 0.01) as usize).min(5);
        let void = 1.0 - 4.0 / 3.0 * PI * (0.0045 - 0.02 * (0.01 * z as f64 + 0.005)).powi(3) / 1e-6;
        assert!((found.velocity.z / (flux / void) - 1.0).abs() < 1e-9, "{x}: {found:?} {void}");
    }
    assert!((flow.discharge().z * 0.0036 / outflow[5] - 1.0).abs() < 1e-11);
}

#[test]
fn the_flow_in_a_cell_has_the_divergence_of_its_balance_and_nothing_jumps_between_cells() {
    // Compressible water between two pressures that have not yet met, around grains that stay.
    let mut faces = [const { Water::Sealed }; 6];
    faces[0] = Water::Pressure(Signal::Constant(100.0));
    faces[5] = Water::Pressure(Signal::Constant(-50.0));
    faces[3] = Water::Inflow(Signal::Constant(1e-4));
    let (mut state, mut model) = held(cells([3, 4, 5]), faces);
    let modulus = 2e4;
    model.fluid.as_mut().unwrap().bulk_modulus = Some(modulus);
    model.time_step = TimeStep::Fixed(1e-5);
    let mut work = Work::default();
    for _ in 0..3 {
        step(&mut state, &model, &mut work).unwrap();
    }
    let before = state.grid().unwrap().pressure.clone();
    step(&mut state, &model, &mut work).unwrap();
    let (flow, grid) = (flow(&state, &work), work.fluid.darcy.grid().unwrap());
    let at = |x: DVec3| flow.at(x).unwrap();
    let mut random = Random(8);
    let mut largest = 0.0_f64;
    for cell in 0..grid.census.cells {
        let (middle, size) = (grid.centre(cell), grid.size(cell));
        let shift = 0.3 * random.vector() * size;
        let slope = |axis: usize| {
            let mut reach = DVec3::ZERO;
            reach[axis] = 0.3 * size[axis];
            (at(middle + shift + reach).seepage - at(middle + shift - reach).seepage)[axis]
                / (0.6 * size[axis])
        };
        let divergence: f64 = (0..3).map(slope).sum();
        let stored =
            grid.porosity[cell] / modulus * (state.grid().unwrap().pressure[cell] - before[cell]) / state.dt;
        largest = largest.max(divergence.abs());
        assert!((divergence + stored).abs() < 1e-6 * largest.max(1e-3), "{cell}: {divergence:e} {stored:e}");
    }
    assert!(largest > 1e-2, "{largest:e}");
    // A hair before and behind each plane, where the pressure is steep.
    for (axis, unit) in DVec3::AXES.into_iter().enumerate() {
        for k in 1..grid.count[axis] {
            for x in anywhere(DVec3::splat(1e-9), DVec3::splat(0.06 - 1e-9)) {
                let x = x + (grid.planes[axis][k] - x[axis]) * unit;
                let [a, b] = [at(x - 1e-12 * unit), at(x + 1e-12 * unit)];
                assert!((a.pressure - b.pressure).abs() < 1e-6, "{x}: {a:?} {b:?}");
                assert!((a.seepage - b.seepage)[axis].abs() < 1e-9 * a.seepage.length(), "{x}: {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn what_is_found_at_a_wall_goes_with_the_wall() {
    // Planes are as old as the grid; the walls have moved since.
    let (mut state, mut model) = driven(Darcy { renew: 1.0, ..cells([3, 3, 3]) }, 0.02, None);
    model.faces[4].solid = Solid::Moving { velocity: [0.0, 0.0, 3.0].map(Signal::Constant) };
    model.faces[4].water = Water::Pressure(Signal::Constant(70.0));
    let mut work = Work::default();
    let start = state.domain.cell.origin.z;
    while state.domain.cell.origin.z < start + 1e-3 {
        step(&mut state, &model, &mut work).unwrap();
    }
    assert_eq!(state.grid().unwrap().grid_cell.origin.z, start);
    let Water::Pressure(signal) = &model.faces[1].water else { unreachable!() };
    let imposed = signal.at(state.time - state.dt);
    let (flow, cell) = (flow(&state, &work), state.domain.cell);
    for x in anywhere(cell.origin, cell.upper()) {
        // Away from edges with walls that push water out.
        let right = DVec3::new(cell.upper().x, x.y.clamp(0.011, 0.049), x.z.clamp(0.011, 0.049));
        let found = flow.at(right).unwrap();
        assert!((found.pressure - imposed).abs() < 1e-9, "{right}: {found:?} {imposed}");
        let bottom = DVec3::new(x.x.clamp(0.011, 0.049), x.y.clamp(0.011, 0.049), cell.origin.z);
        let found = flow.at(bottom).unwrap();
        assert!((found.pressure - 70.0).abs() < 1e-9, "{bottom}: {found:?}");
    }
}

#[test]
fn above_a_grid_that_ends_with_the_grains_the_water_is_clear() {
    let mut faces = [const { Water::Sealed }; 6];
    faces[4] = Water::Inflow(Signal::Constant(1e-3));
    faces[5] = Water::Pressure(Signal::Constant(30.0));
    let (mut state, model) = held(Darcy { faces: Follow::Grains, ..cells([3, 3, 3]) }, faces);
    let kept: Vec<DVec3> = state.grains.position.iter().copied().filter(|x| x.z < 0.03).collect();
    state.grains = Grains::at_rest(kept.clone(), vec![0.004; kept.len()], 2.6e12);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let flow = flow(&state, &work);
    let end = work.fluid.darcy.grid().unwrap().planes[2][3];
    assert!(end > 0.028 && end < 0.031, "{end}");
    // Below it flows past the grains, above through all of the section, as much on average.
    let [mut below, mut above] = [0.0; 2];
    for k in 0..900 {
        let at = |z: f64| DVec3::new(0.002 * (k % 30) as f64 + 0.001, 0.002 * (k / 30) as f64 + 0.001, z);
        let [inside, outside] = [0.5 * end, 0.5 * end + 0.03].map(|z| flow.at(at(z)).unwrap());
        assert!((outside.pressure - 30.0).abs() < 1e-12 && inside.pressure > 30.0, "{outside:?}");
        assert!((outside.velocity - outside.seepage).length() < 1e-12, "{outside:?}");
        assert!(inside.velocity.z > 1.2 * inside.seepage.z, "{inside:?}");
        below += inside.seepage.z / 900.0;
        above += outside.velocity.z / 900.0;
    }
    assert!((below - 1e-3).abs() < 1e-9 && (above - 1e-3).abs() < 1e-9, "{below} {above}");
}

#[test]
fn pressures_that_vary_over_the_faces_are_met_at_every_face_of_a_cell() {
    // A pressure that is linear in place fills the box, whatever the permeability along the axes.
    let permeability = Permeability::Given([1e-9, 3e-9, 2e-10]);
    let linear = || Water::Pressure(formula("1000*x - 300*y + 70*z + 5*t + 1"));
    let faces = std::array::from_fn(|_| linear());
    let (mut state, model) = held(Darcy { permeability, ..cells([3, 4, 5]) }, faces);
    let mut work = Work::default();
    for _ in 0..3 {
        let time = state.time;
        step(&mut state, &model, &mut work).unwrap();
        let grid = work.fluid.darcy.grid().unwrap();
        for (cell, p) in state.grid().unwrap().pressure[..grid.census.cells].iter().enumerate() {
            let x = grid.centre(cell);
            let expected = 1000.0 * x.x - 300.0 * x.y + 70.0 * x.z + 5.0 * time + 1.0;
            assert!((p - expected).abs() < 1e-8, "{x} {p} {expected}");
        }
    }
}

/// Largest error of the pressure under an inflow `v cos(pi x/L)` through the bottom of a cube of edge L, top open, over the
/// largest pressure: `p = v mu/(k q) cos(q x) sinh(q (L - z))/cosh(q L)`, `q = pi/L`.
fn error_of_varying_inflow(n: usize) -> f64 {
    let permeability = Permeability::Given([1e-9; 3]);
    let mut faces = [const { Water::Sealed }; 6];
    faces[4] = Water::Inflow(formula("1e-3*cos(pi*x/0.06)"));
    faces[5] = Water::Pressure(Signal::Constant(0.0));
    let (mut state, model) = held(Darcy { permeability, residual: 1e-12, ..cells([n, 2, n]) }, faces);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let (length, grid) = (0.06, work.fluid.darcy.grid().unwrap());
    let q = PI / length;
    let peak = 1e-3 * 1e-3 / (1e-9 * q);
    let error = |cell: usize| {
        let x = grid.centre(cell);
        let exact = peak * (q * x.x).cos() * (q * (length - x.z)).sinh() / (q * length).cosh();
        (state.grid().unwrap().pressure[cell] - exact).abs() / peak
    };
    (0..grid.census.cells).map(error).fold(0.0, f64::max)
}

#[test]
fn an_inflow_that_varies_over_a_face_follows_its_closed_form_in_second_order() {
    let [coarse, fine] = [8, 16].map(error_of_varying_inflow);
    let order = (coarse / fine).log2();
    assert!(fine < 0.01 && (order - 2.0).abs() < 0.2, "{coarse} {fine} {order}");
}

#[test]
fn the_pressure_in_a_seabed_follows_the_theory() {
    // The bed of example 04 on a grid of its 4000 grains, eight to a cell, at the crest (t = 0) and in the trough (t = 0.5 s).
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/04-seabed-pressure/case.toml");
    let case = porograin::case::Case::from_file(&path, &["fluid.flow={darcy={}}".into()]).unwrap();
    let mut simulation = porograin::run::Simulation::new(&case).unwrap();
    for done in 1..=5 {
        simulation.advance().unwrap();
        if done == 1 || done == 5 {
            let (crest, pressure) =
                (if done == 1 { 1.0 } else { -1.0 }, &simulation.state.grid().unwrap().pressure);
            let grid = simulation.work().fluid.darcy.grid().unwrap();
            let difference = |cell: usize| {
                let (x, q) = (grid.centre(cell), PI / 2.0);
                let theory = 1.0 + (q * x.z).cosh() / q.cosh() * (q * x.x).cos() * crest;
                pressure[cell] / 50.0 - theory
            };
            let cells = grid.census.cells;
            let mean = ((0..cells).map(|c| difference(c).powi(2)).sum::<f64>() / cells as f64).sqrt();
            let most = (0..cells).map(|c| difference(c).abs()).fold(0.0, f64::max);
            println!("crest {crest}: {cells} cells, difference over p0 {mean:.4} rms, {most:.4} at most");
            // No farther off than the pores, see the README of the example.
            assert!(mean < 0.029 && most < 0.101, "{mean} {most}");
        }
    }
}
