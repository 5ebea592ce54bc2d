//! Velocities and pressures of the water at any place: what is exact about them.

mod random;

use glam::{DMat3, DVec3};
use porograin::boundary::Slip;
use porograin::measure::{PoreFlow, Sensor, Site, Walk};
use porograin::permeability::{
    PeriodicOutcome, PeriodicProblem, Problem, measure, measure_periodic, outflow,
};
use porograin::pores::mesh::{Mesh, Walls};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin_geometry::throat::Packing;
use porograin_geometry::{Cell, Period};
use random::Random;

struct Sample {
    cell: Cell,
    x: Vec<DVec3>,
    r: Vec<f64>,
}

impl Sample {
    /// Spheres at random that overlap no other and no image.
    fn new(cell: Cell, radii: &[f64], seed: u64) -> Sample {
        let (mut random, period) = (Random(seed), Period::of(&cell));
        let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
        while x.len() < radii.len() {
            let radius = radii[x.len()];
            let mut place = random.vector() + 0.5;
            for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
                let margin = radius / cell.edges.col(axis).length();
                place[axis] = margin + place[axis] * (1.0 - 2.0 * margin);
            }
            let p = cell.origin + cell.edges * place;
            let image = |d: DVec3| d + period.as_ref().map_or(DVec3::ZERO, |period| period.nearest(d));
            if x.iter().zip(&r).all(|(q, b): (&DVec3, &f64)| image(p - q).length() > radius + b) {
                x.push(p);
                r.push(radius);
            }
        }
        Sample { cell, x, r }
    }

    fn packing(&self) -> Packing<'_> {
        Packing { cell: &self.cell, position: &self.x, radius: &self.r }
    }
}

fn sheared() -> Cell {
    let edges =
        DMat3::from_cols(DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.3, 0.9, 0.1), DVec3::new(-0.2, 0.4, 0.95));
    Cell::periodic(DVec3::new(0.5, -2.0, 1.0), edges)
}

fn mixture() -> Vec<f64> {
    [vec![0.17; 6], vec![0.06; 70]].concat()
}

fn walled() -> Sample {
    let cell = Cell::walled(DVec3::new(-0.2, 0.1, 3.0), DVec3::new(0.8, 1.3, 3.9));
    let spread: Vec<f64> = (0..300).map(|k| 0.07 * 3.0_f64.powf(-(k as f64) / 300.0)).collect();
    Sample::new(cell, &spread, 2)
}

fn periodic_samples() -> Vec<Sample> {
    let cube = Cell::periodic(DVec3::new(0.3, -0.2, 1.0), DMat3::IDENTITY);
    let cubic = |x: &[f64], r: f64| Sample {
        cell: cube,
        x: x.iter().map(|&x| DVec3::splat(x)).collect(),
        r: vec![r; x.len()],
    };
    vec![
        Sample::new(cube, &[0.11; 50], 1),
        Sample::new(sheared(), &mixture(), 2),
        Sample::new(sheared(), &[0.3, 0.25, 0.2, 0.2], 4),
        cubic(&[0.1], 0.5),
        cubic(&[0.0, 0.5], 0.75_f64.sqrt() / 2.0),
    ]
}

fn periodic_flow(sample: &Sample) -> PeriodicOutcome {
    let problem = PeriodicProblem {
        slope: 12.0,
        viscosity: 0.7,
        conductance: Conductance::LocalDrag,
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: 1e-12,
    };
    measure_periodic(&sample.cell, &sample.x, &sample.r, &problem).unwrap()
}

fn problem(axis: usize) -> Problem {
    Problem {
        axis,
        drop: 3.0,
        sides: Slip::Symmetry,
        viscosity: 0.7,
        conductance: Conductance::LocalDrag,
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: 1e-12,
    }
}

/// The flow of a [`problem`], with its site.
fn walled_flow<'a>(
    packing: Packing<'a>,
    mesh: &'a Mesh,
    pressure: &[f64],
    axis: usize,
) -> (Site<'a>, PoreFlow) {
    let site = Site::new(packing, mesh);
    let mut open = [false; 6];
    open[2 * axis..2 * axis + 2].fill(true);
    let flow = PoreFlow::new(&site, &mesh.link_fluxes(DVec3::ZERO, pressure), &outflow(mesh, pressure), open);
    (site, flow)
}

fn still<'a>(grain: &'a [DVec3]) -> Walk<'a> {
    Walk { grain, wall: [DVec3::ZERO; 6], gradient: DMat3::ZERO }
}

#[test]
fn the_mean_of_the_pores_is_darcys_flux() {
    for sample in periodic_samples() {
        let found = periodic_flow(&sample);
        let packing = Packing { position: &found.position, ..sample.packing() };
        let site = Site::new(packing, &found.mesh);
        for flow in &found.flows {
            let flux = found.mesh.link_fluxes(flow.gradient, &flow.pressure);
            let pores = PoreFlow::new(&site, &flux, &vec![0.0; found.mesh.nodes()], [false; 6]);
            let void: f64 = pores.void.iter().sum();
            assert!((void / sample.cell.volume() - found.porosity).abs() < 1e-11);
            let off = (pores.discharge(&site) - flow.mean_velocity).length() / flow.mean_velocity.length();
            assert!(off < 1e-10, "{} grains: {off:e}", sample.x.len());
        }
    }
    let sample = walled();
    for axis in 0..3 {
        let found = measure(&sample.cell, &sample.x, &sample.r, &problem(axis)).unwrap();
        let (site, pores) = walled_flow(sample.packing(), &found.mesh, &found.pressure, axis);
        let size = sample.cell.upper() - sample.cell.origin;
        let darcy = found.inflow * size[axis] / sample.cell.volume();
        let found = pores.discharge(&site);
        assert!((found[axis] / darcy - 1.0).abs() < 1e-10, "{axis}: {found} {darcy}");
    }
}

#[test]
fn around_every_grain_of_a_cubic_lattice_the_water_moves_alike() {
    let x = (0..64).map(|i| DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64) + 0.5).collect();
    let sample = Sample { cell: Cell::walled(DVec3::ZERO, DVec3::splat(4.0)), x, r: vec![0.4; 64] };
    let found = measure(&sample.cell, &sample.x, &sample.r, &problem(2)).unwrap();
    let (site, pores) = walled_flow(sample.packing(), &found.mesh, &found.pressure, 2);
    let rest = vec![DVec3::ZERO; 64];
    let velocity = pores.velocity(&site, &still(&rest));
    let around = pores.around_grains(&site, &still(&rest), &velocity);
    // The velocity in the pores: what Darcy's flux must be in the void.
    let expected = DVec3::new(0.0, 0.0, found.inflow / 16.0 / found.porosity);
    for (mut u, x) in around.into_iter().zip(&sample.x) {
        if (x.z - 2.0).abs() > 1.0 {
            // Beside the open walls, where the water turns into the throats, along the flow only.
            (u.x, u.y) = (0.0, 0.0);
        }
        assert!((u - expected).length() < 1e-9 * expected.z, "{x}: {u} {expected}");
    }
}

#[test]
fn a_pressure_that_varies_linearly_is_found_everywhere() {
    let sample = walled();
    let walls = Walls { open: [false, false, false, false, true, true], slip: [Slip::Symmetry; 6] };
    let mesh = Mesh::new(sample.packing(), &walls, Conductance::LocalDrag, 0.7).unwrap();
    let linear = |x: DVec3| 7.0 + DVec3::new(3.0, -5.0, 11.0).dot(x - sample.cell.origin);
    let mut pressure = vec![f64::NAN; mesh.nodes()];
    for (pore, &node) in mesh.node.iter().enumerate().rev() {
        pressure[node as usize] = linear(mesh.centre[pore]);
    }
    let site = Site::new(sample.packing(), &mesh);
    let mut sensor = Sensor::new(&site, &pressure);
    let (from, to) = (sample.cell.origin, sample.cell.upper());
    let mut random = Random(3);
    for k in 0..=300 {
        // A diagonal from corner to corner, and anywhere.
        let along = from + (to - from) * (k as f64 / 300.0);
        for x in [along, from + (random.vector() + 0.5) * (to - from)] {
            let found = sensor.at(x).unwrap().pressure;
            assert!((found - linear(x)).abs() < 1e-8, "{x}: {found} {}", linear(x));
        }
    }
    assert_eq!(sensor.at(to + DVec3::new(0.0, 0.0, 0.01)), None);
}

#[test]
fn what_sensors_find_is_continuous_and_near_the_pressures_of_the_pores() {
    let sample = walled();
    let found = measure(&sample.cell, &sample.x, &sample.r, &problem(2)).unwrap();
    let site = Site::new(sample.packing(), &found.mesh);
    let mut sensor = Sensor::new(&site, &found.pressure);
    let (from, to) = (sample.cell.origin, sample.cell.upper());
    // Across a thousandth of the drop no step is larger than some times what the mean slope says.
    let steps = 20_000;
    let path = |k: usize| from + (to - from) * DVec3::new(0.37, 0.61, k as f64 / steps as f64);
    let mut last = sensor.at(path(0)).unwrap().pressure;
    for k in 1..=steps {
        let now = sensor.at(path(k)).unwrap().pressure;
        assert!((now - last).abs() < 20.0 * 3.0 / steps as f64, "{k}: {last} {now}");
        last = now;
    }
    let (mut sum, mut weight) = (0.0, 0.0);
    for (pore, &node) in found.mesh.node.iter().enumerate() {
        let here = sensor.at(found.mesh.centre[pore]).unwrap().pressure;
        sum += found.mesh.volume[pore] * (here - found.pressure[node as usize]).powi(2);
        weight += found.mesh.volume[pore];
    }
    let rms = (sum / weight).sqrt();
    // The pressure falls by 3 Pa over some ten grains.
    assert!(rms < 0.03 * 3.0, "{rms}");
}

#[test]
fn moving_along_with_the_sample_changes_nothing_else() {
    let sample = walled();
    let found = measure(&sample.cell, &sample.x, &sample.r, &problem(2)).unwrap();
    let (site, pores) = walled_flow(sample.packing(), &found.mesh, &found.pressure, 2);
    let (rest, along) = (vec![DVec3::ZERO; 300], DVec3::new(0.3, -0.2, 0.5));
    let moving = vec![along; 300];
    let walk = Walk { grain: &moving, wall: [along; 6], gradient: DMat3::ZERO };
    let [still, moved] = [still(&rest), walk].map(|walk| {
        let velocity = pores.velocity(&site, &walk);
        (pores.around_grains(&site, &walk, &velocity), velocity)
    });
    for (a, b) in [(still.0, moved.0), (still.1, moved.1)] {
        let off = a.iter().zip(&b).map(|(a, b)| (a + along - b).length()).fold(0.0, f64::max);
        assert!(off < 1e-12, "{off:e}");
    }
}

/// x to y to z to x.
fn turned(v: DVec3) -> DVec3 {
    DVec3::new(v.z, v.x, v.y)
}

#[test]
fn velocities_turn_with_the_sample() {
    let sample = walled();
    let turn = Sample {
        cell: Cell::walled(turned(sample.cell.origin), turned(sample.cell.upper())),
        x: sample.x.iter().map(|&x| turned(x)).collect(),
        r: sample.r.clone(),
    };
    let rest = vec![DVec3::ZERO; 300];
    let around = |sample: &Sample, axis: usize| {
        let found = measure(&sample.cell, &sample.x, &sample.r, &problem(axis)).unwrap();
        let (site, pores) = walled_flow(sample.packing(), &found.mesh, &found.pressure, axis);
        let velocity = pores.velocity(&site, &still(&rest));
        pores.around_grains(&site, &still(&rest), &velocity)
    };
    let (first, second) = (around(&sample, 2), around(&turn, 0));
    let largest = first.iter().map(|u| u.length()).fold(0.0, f64::max);
    for (a, b) in first.iter().zip(&second) {
        assert!((turned(*a) - *b).length() < 1e-9 * largest, "{a} {b}");
    }
}

#[test]
fn images_of_grains_and_places_do_not_matter() {
    let sample = Sample::new(sheared(), &mixture(), 2);
    let mut random = Random(9);
    let gradient = DMat3::from_cols(random.vector(), random.vector(), random.vector());
    let velocity: Vec<DVec3> = sample.x.iter().map(|_| random.vector()).collect();
    let around = |sample: &Sample, velocity: &[DVec3]| {
        // The mesh is made of the grains where they are named, not where they were taken back to.
        let walls = Walls { open: [false; 6], slip: [Slip::Symmetry; 6] };
        let mesh = Mesh::new(sample.packing(), &walls, Conductance::LocalDrag, 0.7).unwrap();
        let site = Site::new(sample.packing(), &mesh);
        let pressure: Vec<f64> = vec![0.0; mesh.nodes()];
        let flux = mesh.link_fluxes(DVec3::new(0.0, 0.0, -5.0), &pressure);
        let pores = PoreFlow::new(&site, &flux, &pressure, [false; 6]);
        let walk = Walk { grain: velocity, wall: [DVec3::ZERO; 6], gradient };
        let solids = PoreFlow { seepage: vec![DVec3::ZERO; pores.seepage.len()], ..pores };
        let inside = solids.velocity(&site, &walk);
        solids.around_grains(&site, &walk, &inside)
    };
    let first = around(&sample, &velocity);
    let mut other = Sample { cell: sample.cell, x: sample.x.clone(), r: sample.r.clone() };
    let mut also = velocity.clone();
    for k in (0..other.x.len()).step_by(3) {
        let d = sample.cell.shift([1, -1, (k % 2) as i8]);
        other.x[k] += d;
        also[k] += gradient * d;
    }
    let second = around(&other, &also);
    for k in 0..first.len() {
        let d = other.x[k] - sample.x[k];
        assert!((first[k] + gradient * d - second[k]).length() < 1e-12, "{k}");
    }
    // A smooth pressure with the period of the cell, at a place and its images.
    let found = periodic_flow(&sample);
    let packing = Packing { position: &found.position, ..sample.packing() };
    let site = Site::new(packing, &found.mesh);
    let flow = &found.flows[0];
    let macroscopic = |x: DVec3| flow.gradient.dot(x - sample.cell.origin);
    let local = found.mesh.pore_pressure(flow.gradient, &flow.pressure);
    let mut beside = vec![0.0; found.mesh.nodes()];
    for (pore, &node) in found.mesh.node.iter().enumerate() {
        beside[node as usize] = local[pore] - macroscopic(found.mesh.centre[pore]);
    }
    let mut sensor = Sensor::new(&site, &beside);
    for _ in 0..200 {
        let x = sample.cell.origin + sample.cell.edges * (random.vector() + 0.5);
        let here = sensor.at(x).unwrap().pressure;
        let there = sensor.at(x + sample.cell.shift([-2, 1, 3])).unwrap().pressure;
        assert!((here - there).abs() < 1e-9, "{x}: {here} {there}");
    }
}
