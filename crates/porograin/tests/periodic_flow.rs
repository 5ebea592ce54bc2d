//! Water in periodic cells: the permeability tensor and its invariances, the coupling of grains and cell with the water.

mod random;

use glam::{DMat3, DVec3};
use porograin::Loads;
use porograin::boundary::Slip;
use porograin::permeability::{PeriodicOutcome, PeriodicProblem, Problem, measure, measure_periodic};
use porograin::pores::conductance::Passage;
use porograin::pores::coupling::coupling;
use porograin::pores::mesh::{Carried, Mesh, Walls};
use porograin::pores::{Conductance, Coupling, Solver, System, geometric};
use porograin_geometry::throat::{Packing, radical_centres, shape, throats};
use porograin_geometry::triangulation::{FACET, wall};
use porograin_geometry::{Cell, Period};
use random::Random;

struct Sample {
    name: &'static str,
    cell: Cell,
    x: Vec<DVec3>,
    r: Vec<f64>,
}

impl Sample {
    fn packing(&self) -> Packing<'_> {
        Packing { cell: &self.cell, position: &self.x, radius: &self.r }
    }
    fn mesh(&self, slip: Slip, open: [bool; 6]) -> Mesh {
        let walls = Walls { open, slip: [slip; 6] };
        Mesh::new(self.packing(), &walls, Conductance::LocalDrag, 0.7).unwrap()
    }
}

/// Spheres of the given radii added at random where they overlap no other and no image.
fn cloud(name: &'static str, cell: Cell, radii: &[f64], seed: u64) -> Sample {
    let (mut random, period) = (Random(seed), Period::of(&cell).unwrap());
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < radii.len() {
        let radius = radii[x.len()];
        let mut place = random.vector() + 0.5;
        for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
            let margin = radius / cell.edges.col(axis).length();
            place[axis] = margin + place[axis] * (1.0 - 2.0 * margin);
        }
        let p = cell.origin + cell.edges * place;
        let free = |(q, b): (&DVec3, &f64)| (p - q + period.nearest(p - q)).length() > radius + b;
        if x.iter().zip(&r).all(free) {
            x.push(p);
            r.push(radius);
        }
    }
    Sample { name, cell, x, r }
}

fn cube() -> Cell {
    Cell::periodic(DVec3::new(0.3, -0.2, 1.0), DMat3::IDENTITY)
}

fn sheared() -> Cell {
    let edges =
        DMat3::from_cols(DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.3, 0.9, 0.1), DVec3::new(-0.2, 0.4, 0.95));
    Cell::periodic(DVec3::new(0.5, -2.0, 1.0), edges)
}

fn spread(n: usize, big: f64, ratio: f64) -> Vec<f64> {
    (0..n).map(|k| big * ratio.powf(-(k as f64 / n as f64))).collect()
}

/// One to three large grains, the rest a third of their size.
fn mixture(large: usize, small: usize, big: f64) -> Vec<f64> {
    [vec![big; large], vec![big / 3.0; small]].concat()
}

fn samples() -> Vec<Sample> {
    vec![
        cloud("equal", cube(), &[0.11; 50], 1),
        cloud("two sizes, sheared", sheared(), &mixture(6, 70, 0.17), 2),
        cloud("many sizes, sheared", sheared(), &spread(90, 0.16, 5.0), 3),
        cloud("four", sheared(), &[0.3, 0.25, 0.2, 0.2], 4),
        cloud("two", cube(), &[0.4, 0.3], 5),
        cloud("one", sheared(), &[0.35], 6),
        Sample { name: "cubic", cell: cube(), x: vec![DVec3::new(0.1, 0.2, 0.3)], r: vec![0.5] },
        Sample {
            name: "body-centred",
            cell: cube(),
            x: vec![DVec3::ZERO, DVec3::splat(0.5)],
            r: vec![0.75f64.sqrt() / 2.0; 2],
        },
    ]
}

fn problem() -> PeriodicProblem {
    PeriodicProblem {
        slope: 12.0,
        viscosity: 0.7,
        conductance: Conductance::LocalDrag,
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: 1e-10,
    }
}

fn found(sample: &Sample) -> PeriodicOutcome {
    measure_periodic(&sample.cell, &sample.x, &sample.r, &problem()).unwrap()
}

fn size(tensor: DMat3) -> f64 {
    (tensor.x_axis.length_squared() + tensor.y_axis.length_squared() + tensor.z_axis.length_squared()).sqrt()
}

fn same(a: DMat3, b: DMat3, tolerance: f64) -> bool {
    size(a - b) <= tolerance * size(b)
}

#[test]
fn the_tensor_is_symmetric_and_positive() {
    for sample in samples() {
        let tensor = found(&sample).tensor;
        assert!(same(tensor, tensor.transpose(), 1e-11), "{}: {tensor}", sample.name);
        let minor = tensor.x_axis.x * tensor.y_axis.y - tensor.y_axis.x * tensor.x_axis.y;
        assert!(tensor.x_axis.x > 0.0 && minor > 0.0 && tensor.determinant() > 0.0, "{}", sample.name);
    }
}

#[test]
fn forces_sum_to_the_gradient_over_the_volume() {
    for sample in samples() {
        for coupling in [Coupling::Reciprocal, Coupling::Geometric] {
            let problem = PeriodicProblem { coupling, ..problem() };
            let found = measure_periodic(&sample.cell, &sample.x, &sample.r, &problem).unwrap();
            for flow in &found.flows {
                let expected = -flow.gradient * sample.cell.volume();
                let error = (flow.force_sum - expected).length() / expected.length();
                assert!(error < 1e-12, "{}: {} {expected}", sample.name, flow.force_sum);
            }
        }
    }
}

/// Between plates the walls take their share of the gradient along them, and no more.
#[test]
fn between_plates_grains_and_walls_share_the_force_of_the_gradient() {
    let gradient = DVec3::new(0.7, -0.3, 0.0);
    for sample in plates() {
        for coupling in [Coupling::Reciprocal, Coupling::Geometric] {
            let mut mesh = sample.mesh(Slip::NoSlip, [false; 6]);
            if coupling == Coupling::Geometric {
                let walls = Walls { open: [false; 6], slip: [Slip::NoSlip; 6] };
                geometric::couple(&mut mesh, sample.packing(), &walls, Conductance::LocalDrag);
            }
            let mut source = Vec::new();
            mesh.add_gradient_sources(gradient, &mut source);
            let carried: Vec<f64> = source.iter().map(|s| -s).collect();
            let mut pressure = vec![0.0; mesh.nodes()];
            let mut system = System::new(&mesh, Solver::Cholesky.method(), 1e-12, 100).unwrap();
            system.solve(&mesh, &carried, &mut pressure).unwrap();
            let mut loads = Loads::default();
            loads.clear(sample.x.len());
            mesh.add_loads(&pressure, &mut loads);
            mesh.add_gradient_loads(gradient, &mut loads);
            let walls: DVec3 = loads.wall.iter().sum();
            let total = (loads.force.iter().sum::<DVec3>() + walls).truncate();
            let expected = (-gradient * sample.cell.volume()).truncate();
            assert!((total - expected).length() < 1e-12 * expected.length(), "{}: {total}", sample.name);
            assert!(walls.truncate().dot(expected) > 0.0, "{}: {walls}", sample.name);
        }
    }
}

/// Planes across one edge, at any height, with the nodes where the mesh places them.
#[test]
fn the_flux_through_every_cut_is_that_of_the_mean_velocity() {
    for sample in samples() {
        let found = found(&sample);
        let (mesh, edges) = (&found.mesh, sample.cell.edges);
        let mut place = vec![DVec3::NAN; mesh.nodes()];
        for (pore, &node) in mesh.node.iter().enumerate() {
            if place[node as usize].is_nan() {
                place[node as usize] = edges.inverse() * (mesh.centre[pore] - sample.cell.origin);
            }
        }
        let images = mesh.images.as_ref().unwrap();
        let mut beyond = vec![DVec3::ZERO; mesh.links.len()];
        for &(link, away) in &images.crossings {
            beyond[link as usize] = (edges.inverse() * away).round();
        }
        for flow in &found.flows {
            let fluxes = mesh.link_fluxes(flow.gradient, &flow.pressure);
            for axis in 0..3 {
                let (b, c) = (edges.col((axis + 1) % 3), edges.col((axis + 2) % 3));
                let expected = flow.mean_velocity.dot(b.cross(c));
                let scale = flow.mean_velocity.length() * b.cross(c).length();
                for cut in [0.0, 0.13, 0.5, 0.77] {
                    let crosses = |link: usize| {
                        let [i, j] = mesh.links[link].map(|node| place[node as usize][axis]);
                        (j + beyond[link][axis] - cut).floor() - (i - cut).floor()
                    };
                    let flux: f64 = (0..fluxes.len()).map(|link| fluxes[link] * crosses(link)).sum();
                    assert!((flux - expected).abs() < 1e-10 * scale, "{}: {flux} {expected}", sample.name);
                }
            }
        }
    }
}

#[test]
fn a_cubic_lattice_conducts_like_one_between_mirrors_and_like_stokes_flow() {
    let sample = Sample { name: "cubic", cell: cube(), x: vec![DVec3::splat(0.4)], r: vec![0.5] };
    for conductance in [Conductance::LocalDrag, Conductance::hydraulic_radius()] {
        let periodic = PeriodicProblem { conductance, ..problem() };
        let tensor = measure_periodic(&sample.cell, &sample.x, &sample.r, &periodic).unwrap().tensor;
        assert!(same(tensor, DMat3::IDENTITY * tensor.x_axis.x, 1e-11));
        let at = |i: usize| DVec3::new((i % 3) as f64, (i / 3 % 3) as f64, (i / 9) as f64) + 0.5;
        let lattice: Vec<DVec3> = (0..27).map(at).collect();
        let walled = Problem {
            axis: 2,
            drop: 1.0,
            sides: Slip::Symmetry,
            viscosity: 1e-3,
            conductance,
            coupling: Coupling::Reciprocal,
            solver: Solver::Cholesky,
            residual: 1e-10,
        };
        let box_of_27 = Cell::walled(DVec3::ZERO, DVec3::splat(3.0));
        let walled = measure(&box_of_27, &lattice, &[0.5; 27], &walled).unwrap().permeability;
        assert!((tensor.x_axis.x / walled - 1.0).abs() < 1e-9, "{} {walled}", tensor.x_axis.x);
        if conductance == Conductance::LocalDrag {
            // Sangani & Acrivos (1982): K = 42.1 at c = 0.5236, k/a² = 2 R²/(9 c K).
            let exact = 2.0 * 0.25 / (9.0 * std::f64::consts::FRAC_PI_6 * 42.1);
            assert!((tensor.x_axis.x / exact - 1.0).abs() < 0.12, "{} {exact}", tensor.x_axis.x);
        }
    }
}

/// Forces and torques on each grain of the three flows, and the tensor, agree; grain k of `b` is grain `order[k]` of `a`.
fn agree(name: &str, a: &PeriodicOutcome, b: &PeriodicOutcome, order: &[usize]) {
    assert!(same(a.tensor, b.tensor, 1e-10), "{name}: {} {}", a.tensor, b.tensor);
    for (a, b) in a.flows.iter().zip(&b.flows) {
        let largest = a.loads.force.iter().map(|f| f.length()).fold(0.0, f64::max);
        for (k, &i) in order.iter().enumerate() {
            let apart = (a.loads.force[i] - b.loads.force[k]).length();
            assert!(apart < 1e-10 * largest, "{name}, grain {i}: {} {}", a.loads.force[i], b.loads.force[k]);
            let apart = (a.loads.torque[i] - b.loads.torque[k]).length();
            assert!(apart < 1e-10 * largest, "{name}: {} {}", a.loads.torque[i], b.loads.torque[k]);
        }
    }
}

#[test]
fn numbering_origin_images_and_basis_do_not_matter() {
    let mut random = Random(9);
    for sample in samples() {
        let base = found(&sample);
        let n = sample.x.len();
        let order: Vec<usize> = (0..n).rev().collect();
        let shifted = |k: &usize| {
            let periods = (4.0 * random.vector()).round();
            sample.x[*k] + sample.cell.edges * periods
        };
        let other = Sample {
            x: order.iter().map(shifted).collect(),
            r: order.iter().map(|&k| sample.r[k]).collect(),
            ..sample
        };
        agree(sample.name, &base, &found(&other), &order);
        let moved = DVec3::new(0.21, -0.53, 0.37);
        let origin = Cell { origin: sample.cell.origin + 2.3 * moved, ..sample.cell };
        let [a, b, c] = [0, 1, 2].map(|axis| sample.cell.edges.col(axis));
        let leaning = Cell { edges: DMat3::from_cols(a + b, b, c - a + 2.0 * b), ..sample.cell };
        for (cell, x) in [(origin, moved), (leaning, DVec3::ZERO)] {
            let other = Sample {
                cell,
                x: sample.x.iter().map(|&y| y + x).collect(),
                r: sample.r.clone(),
                name: sample.name,
            };
            agree(sample.name, &base, &found(&other), &(0..n).collect::<Vec<_>>());
        }
    }
}

#[test]
fn eight_periods_are_eight_times_one() {
    for sample in samples().iter().filter(|sample| sample.x.len() < 60) {
        let base = found(sample);
        let mut tiled = Sample {
            cell: Cell { edges: 2.0 * sample.cell.edges, ..sample.cell },
            x: Vec::new(),
            r: Vec::new(),
            name: sample.name,
        };
        for k in 0..8 {
            let corner = DVec3::new((k % 2) as f64, (k / 2 % 2) as f64, (k / 4) as f64);
            tiled.x.extend(sample.x.iter().map(|&x| x + sample.cell.edges * corner));
            tiled.r.extend(&sample.r);
        }
        let order: Vec<usize> = (0..tiled.x.len()).map(|k| k % sample.x.len()).collect();
        agree(sample.name, &base, &found(&tiled), &order);
    }
}

#[test]
fn the_tensor_turns_with_the_sample() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
    for sample in samples() {
        let base = found(&sample);
        let other = Sample {
            cell: Cell { origin: turn * sample.cell.origin, edges: turn * sample.cell.edges, ..sample.cell },
            x: sample.x.iter().map(|&x| turn * x).collect(),
            r: sample.r.clone(),
            name: sample.name,
        };
        let turned = found(&other).tensor;
        assert!(same(turned, turn * base.tensor * turn.transpose(), 1e-10), "{}: {turned}", sample.name);
    }
}

#[test]
fn results_scale_with_length_and_viscosity() {
    for sample in samples() {
        let base = found(&sample);
        for (length, viscosity) in [(1e-6, 1.0), (1e5, 1.0), (1.0, 250.0)] {
            let cell = Cell::periodic(sample.cell.origin * length, sample.cell.edges * length);
            let x: Vec<DVec3> = sample.x.iter().map(|&x| x * length).collect();
            let r: Vec<f64> = sample.r.iter().map(|&r| r * length).collect();
            let scaled = PeriodicProblem { viscosity: 0.7 * viscosity, ..problem() };
            let other = measure_periodic(&cell, &x, &r, &scaled).unwrap();
            assert!(same(other.tensor, base.tensor * (length * length), 1e-9), "{}", sample.name);
            let (u, v) = (other.flows[1].mean_velocity, base.flows[1].mean_velocity);
            assert!((u * viscosity / (length * length) - v).length() < 1e-9 * v.length());
        }
    }
}

/// What leaves each pore when grains move at `velocity` beside the flow of the cell.
fn carried(mesh: &Mesh, velocity: &[DVec3], spin: &[DVec3], walls: &[DVec3; 6], rate: DMat3) -> Carried {
    let mut out = Carried::default();
    mesh.carried(velocity, spin, walls, &mut out);
    mesh.add_stretch(rate, &mut out);
    out
}

const TOP_BOTTOM: [bool; 6] = [false, false, false, false, true, true];

/// Periodic along x and y, between walls along z.
fn plates() -> Vec<Sample> {
    let edges =
        DMat3::from_cols(DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.3, 0.9, 0.0), DVec3::new(0.0, 0.0, 1.1));
    let cell = Cell { origin: DVec3::new(-0.3, 0.2, 0.4), edges, periodic: [true, true, false] };
    vec![
        cloud("two sizes between plates", cell, &mixture(6, 60, 0.16), 7),
        cloud("two between plates", cell, &[0.4, 0.3], 8),
    ]
}

#[test]
fn translation_and_rotation_give_no_flow_and_a_strain_that_of_the_volume() {
    for sample in samples().into_iter().chain(plates()) {
        let n = sample.x.len();
        let (still, none) = (vec![DVec3::ZERO; n], [DVec3::ZERO; 6]);
        let walled = sample.cell.periodic != [true; 3];
        for slip in [Slip::Symmetry, Slip::NoSlip] {
            let mesh = sample.mesh(slip, TOP_BOTTOM);
            let v = DVec3::new(0.3, -0.8, 0.5);
            let worst = |out: &Carried| out.pore.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            let out = carried(&mesh, &vec![v; n], &still, &[v; 6], DMat3::ZERO);
            assert!(worst(&out) < 1e-13, "{}: {}", sample.name, worst(&out));
            // Stretching along the plates: what the volume does, whatever the walls are.
            let strain = DMat3::from_diagonal(if walled { DVec3::new(1.0, 1.0, 0.0) } else { DVec3::ONE });
            let out = carried(&mesh, &still, &still, &none, strain);
            let rate = if walled { 2.0 } else { 3.0 };
            let total: f64 = out.pore.iter().sum();
            assert!((total - rate * sample.cell.volume()).abs() < 1e-12, "{}: {total}", sample.name);
            if !walled {
                for (pore, &volume) in out.pore.iter().enumerate() {
                    let error = (volume - 3.0 * mesh.volume[pore]).abs();
                    assert!(error < 1e-13, "{} pore {pore}: {error}", sample.name);
                }
                let omega = DVec3::new(0.4, 1.1, -0.6);
                let turn = DMat3::from_cols(
                    DVec3::new(0.0, omega.z, -omega.y),
                    DVec3::new(-omega.z, 0.0, omega.x),
                    DVec3::new(omega.y, -omega.x, 0.0),
                );
                let out = carried(&mesh, &still, &vec![omega; n], &none, turn);
                assert!(worst(&out) < 1e-13, "{}: {}", sample.name, worst(&out));
            }
        }
    }
}

/// Loads and push on the cell that answer a motion, and what they must be the transpose of.
#[test]
fn pressures_push_as_motion_carries_and_their_work_is_dissipated() {
    let mut random = Random(77);
    for sample in samples().into_iter().chain(plates()) {
        let mesh = sample.mesh(Slip::NoSlip, TOP_BOTTOM);
        let n = sample.x.len();
        let periodic = DVec3::from_array(sample.cell.periodic.map(|p| f64::from(u8::from(p))));
        let velocity: Vec<DVec3> = (0..n).map(|_| random.vector()).collect();
        let spin: Vec<DVec3> = (0..n).map(|_| random.vector()).collect();
        let mut rate = DMat3::from_cols(random.vector(), random.vector(), random.vector());
        rate = DMat3::from_diagonal(periodic) * rate * DMat3::from_diagonal(periodic);
        if periodic == DVec3::ONE {
            // Sealed on all sides: the volume must stay.
            rate -= DMat3::IDENTITY * ((rate.x_axis.x + rate.y_axis.y + rate.z_axis.z) / 3.0);
        }
        let walls: [DVec3; 6] = std::array::from_fn(|_| random.vector());
        let out = carried(&mesh, &velocity, &spin, &walls, rate);
        let power = |pressure: &[f64]| {
            let mut loads = Loads::default();
            loads.clear(n);
            mesh.add_loads(pressure, &mut loads);
            let grains: f64 =
                (0..n).map(|i| loads.force[i].dot(velocity[i]) + loads.torque[i].dot(spin[i])).sum();
            let walls: f64 = (0..6).map(|f| loads.wall[f].dot(walls[f])).sum();
            let cell = (0..3).map(|k| mesh.stretching(pressure).col(k).dot(rate.col(k))).sum::<f64>();
            grains + walls + cell
        };
        let pressure: Vec<f64> = (0..mesh.nodes()).map(|_| random.next()).collect();
        let work: f64 = out.node.iter().zip(&pressure).map(|(v, p)| v * p).sum();
        let scale: f64 = out.pore.iter().map(|v| v.abs()).sum();
        assert!((power(&pressure) - work).abs() < 1e-12 * scale, "{}: {work}", sample.name);
        if mesh.nodes() == 1 {
            continue;
        }
        let mut pressure = vec![0.0; mesh.nodes()];
        let mut system = System::new(&mesh, Solver::Cholesky.method(), 1e-12, 100).unwrap();
        system.solve(&mesh, &out.node, &mut pressure).unwrap();
        let through = mesh.link_fluxes(DVec3::ZERO, &pressure);
        let drop = |&[i, j]: &[u32; 2]| pressure[i as usize] - pressure[j as usize];
        let dissipated: f64 = mesh.links.iter().zip(&through).map(|(link, q)| q * drop(link)).sum();
        let work = power(&pressure);
        assert!((work + dissipated).abs() < 1e-9 * dissipated, "{}: {work} {dissipated}", sample.name);
        assert!(dissipated > 0.0, "{}", sample.name);
    }
}

/// `V = S G⁻¹ Sᵀ` over velocities and spins of the grains and the deviatoric rates of the cell.
fn damping(mesh: &Mesh, n: usize) -> Vec<Vec<f64>> {
    let mut system = System::new(mesh, Solver::Cholesky.method(), 1e-12, 100).unwrap();
    let shears = [
        DMat3::from_diagonal(DVec3::new(1.0, -1.0, 0.0)),
        DMat3::from_diagonal(DVec3::new(1.0, 1.0, -2.0)),
        DMat3::from_cols(DVec3::Y, DVec3::ZERO, DVec3::ZERO),
        DMat3::from_cols(DVec3::ZERO, DVec3::X, DVec3::ZERO),
        DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, DVec3::X),
    ];
    let mut matrix = Vec::new();
    for column in 0..6 * n + shears.len() {
        let unit = |k: usize| DVec3::from_array([0, 1, 2].map(|c| f64::from(u8::from(k + c == column))));
        let velocity: Vec<DVec3> = (0..n).map(|i| unit(3 * i)).collect();
        let spin: Vec<DVec3> = (0..n).map(|i| unit(3 * (n + i))).collect();
        let rate = column.checked_sub(6 * n).map_or(DMat3::ZERO, |k| shears[k]);
        let out = carried(mesh, &velocity, &spin, &[DVec3::ZERO; 6], rate);
        let mut pressure = vec![0.0; mesh.nodes()];
        system.solve(mesh, &out.node, &mut pressure).unwrap();
        let mut loads = Loads::default();
        loads.clear(n);
        mesh.add_loads(&pressure, &mut loads);
        let push = mesh.stretching(&pressure);
        let on_cell = shears.map(|shear| (0..3).map(|k| push.col(k).dot(shear.col(k))).sum::<f64>());
        let on_grains = loads.force.iter().chain(&loads.torque).flat_map(|load| load.to_array());
        matrix.push(on_grains.chain(on_cell).map(|load| -load).collect());
    }
    matrix
}

/// Whether every eigenvalue of a symmetric matrix is above `-shift`: it then has a Cholesky factor.
fn above(mut a: Vec<Vec<f64>>, shift: f64) -> bool {
    let n = a.len();
    for k in 0..n {
        a[k][k] += shift;
    }
    for k in 0..n {
        if a[k][k] <= 0.0 {
            return false;
        }
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k + 1..n {
                a[i][j] -= factor * a[k][j];
            }
        }
    }
    true
}

#[test]
fn the_water_only_damps_grains_and_cell() {
    for sample in samples().iter().filter(|sample| sample.x.len() > 1) {
        let n = sample.x.len();
        let v = damping(&sample.mesh(Slip::Symmetry, [false; 6]), n);
        let largest = (0..v.len()).map(|k| v[k][k]).fold(0.0, f64::max);
        for i in 0..v.len() {
            for j in 0..i {
                let apart = (v[i][j] - v[j][i]).abs();
                assert!(apart < 1e-10 * largest, "{}: {} {}", sample.name, v[i][j], v[j][i]);
            }
        }
        assert!(above(v.clone(), 1e-9 * largest), "{} has a growing mode", sample.name);
        let mut turned = v;
        turned[5][5] -= 2.0 * turned[5][5] + 1e-8 * largest;
        assert!(!above(turned, 1e-9 * largest), "the test sees growing modes");
    }
}

#[test]
fn every_throat_balances_forces_and_moments() {
    let mut random = Random(21);
    for sample in samples() {
        let packing = sample.packing();
        let mesh = sample.mesh(Slip::NoSlip, TOP_BOTTOM);
        let centres = radical_centres(packing, &mesh.triangulation);
        for throat in throats(&mesh.triangulation) {
            let shape = shape(packing, &mesh.triangulation, &centres, &throat);
            let slip = [Slip::NoSlip; 6];
            let passage = Passage::new(packing, &mesh.triangulation, &centres, &throat, &shape, &slip);
            let pore = throat.pores[0] as usize;
            assert!(throat.vertices.iter().all(|&v| wall(v).is_none()));
            let points = FACET[throat.facet as usize].map(|m| packing.point(&mesh.triangulation, pore, m));
            let coupled = coupling(packing, &passage, points, Conductance::LocalDrag);
            let push = shape.area * shape.normal;
            let force: DVec3 = coupled.force.iter().sum();
            assert!((force - push).length() < 1e-12 * shape.area, "{}", sample.name);
            let point = random.vector();
            let mut moment: DVec3 = coupled.torque.iter().sum();
            for (x, force) in points.into_iter().flatten().zip(coupled.force) {
                moment += (x - point).cross(force);
            }
            let sectors: DVec3 = shape.sector_moment.iter().sum();
            let expected = (shape.area * (shape.centroid - point) - sectors).cross(shape.normal);
            let scale = shape.area * (shape.centroid - point).length();
            assert!((moment - expected).length() < 1e-10 * scale, "{}: {moment} {expected}", sample.name);
        }
    }
}
