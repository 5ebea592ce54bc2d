//! What must be exact about the water: translation, rotation, expansion, reciprocity, balances, scaling.

mod random;

use glam::{DMat3, DVec3};
use porograin::Loads;
use porograin::boundary::Slip;
use porograin::permeability::{Problem, measure};
use porograin::pores::conductance::Passage;
use porograin::pores::coupling::coupling;
use porograin::pores::mesh::{Carried, Mesh, Walls};
use porograin::pores::{Conductance, Coupling, Solver, System};
use porograin_geometry::Cell;
use porograin_geometry::throat::{Packing, radical_centres, shape, throats};
use porograin_geometry::triangulation::{FACET, wall};
use random::Random;

/// Non-overlapping spheres by random sequential addition, large ones first, radii between `big/ratio` and `big`.
fn cloud(cell: &Cell, n: usize, big: f64, ratio: f64, seed: u64) -> (Vec<DVec3>, Vec<f64>) {
    let mut random = Random(seed);
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    let size = cell.upper() - cell.origin;
    while x.len() < n {
        let radius = big * ratio.powf(-(x.len() as f64 / n as f64));
        let u = random.vector() + DVec3::splat(0.5);
        let p = cell.origin + DVec3::splat(radius) + u * (size - DVec3::splat(2.0 * radius));
        if x.iter().zip(&r).all(|(q, b)| q.distance(p) > radius + b) {
            x.push(p);
            r.push(radius);
        }
    }
    (x, r)
}

struct Sample {
    name: &'static str,
    cell: Cell,
    x: Vec<DVec3>,
    r: Vec<f64>,
}

/// Twelve large spheres, and small ones of a third of their size.
fn two_sizes(cell: &Cell) -> Sample {
    let mut random = Random(8);
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < 250 {
        let radius = if x.len() < 12 { 0.12 } else { 0.04 };
        let u = random.vector() + DVec3::splat(0.5);
        let p = cell.origin
            + DVec3::splat(radius)
            + u * (cell.upper() - cell.origin - DVec3::splat(2.0 * radius));
        if x.iter().zip(&r).all(|(q, b): (&DVec3, &f64)| q.distance(p) > radius + b) {
            x.push(p);
            r.push(radius);
        }
    }
    Sample { name: "two sizes", cell: *cell, x, r }
}

fn samples() -> Vec<Sample> {
    let cell = Cell::walled(DVec3::new(-0.2, 0.1, 3.0), DVec3::new(0.8, 1.3, 3.9));
    let unit = Cell::walled(DVec3::ZERO, DVec3::splat(4.0));
    let lattice: Vec<DVec3> = (0..64)
        .map(|i| DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64) + DVec3::splat(0.5))
        .collect();
    let make = |name, n, big, ratio, seed| {
        let (x, r) = cloud(&cell, n, big, ratio, seed);
        Sample { name, cell, x, r }
    };
    vec![
        make("equal", 400, 0.045, 1.0, 1),
        make("spread", 500, 0.06, 3.0, 2),
        make("wide", 900, 0.07, 10.0, 3),
        two_sizes(&cell),
        make("few", 3, 0.1, 1.5, 4),
        Sample { name: "cubic lattice", cell: unit, x: lattice, r: vec![0.5; 64] },
    ]
}

fn mesh(sample: &Sample, slip: Slip, open: [bool; 6]) -> Mesh {
    let packing = Packing { cell: &sample.cell, position: &sample.x, radius: &sample.r };
    Mesh::new(packing, &Walls { open, slip: [slip; 6] }, Conductance::hydraulic_radius(), 0.7).unwrap()
}

const TOP_BOTTOM: [bool; 6] = [false, false, false, false, true, true];

fn carried(mesh: &Mesh, velocity: &[DVec3], spin: &[DVec3], walls: &[DVec3; 6]) -> Vec<f64> {
    let mut out = Carried::default();
    mesh.carried(velocity, spin, walls, &mut out);
    out.pore
}

#[test]
fn translation_gives_no_flow() {
    for sample in samples() {
        for slip in [Slip::Symmetry, Slip::NoSlip] {
            let mesh = mesh(&sample, slip, TOP_BOTTOM);
            let v = DVec3::new(0.3, -0.8, 0.5);
            let n = sample.x.len();
            let rate = carried(&mesh, &vec![v; n], &vec![DVec3::ZERO; n], &[v; 6]);
            let scale = sample.r[0] * sample.r[0];
            let worst = rate.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert!(worst < 1e-12 * scale.max(1.0), "{} {slip:?}: {worst}", sample.name);
        }
    }
}

#[test]
fn rigid_rotation_gives_no_flow_away_from_the_walls() {
    for sample in samples() {
        let mesh = mesh(&sample, Slip::Symmetry, TOP_BOTTOM);
        let omega = DVec3::new(0.4, 1.1, -0.6);
        let velocity: Vec<DVec3> = sample.x.iter().map(|&x| omega.cross(x)).collect();
        let rate = carried(&mesh, &velocity, &vec![omega; sample.x.len()], &[DVec3::ZERO; 6]);
        let still = carried(&mesh, &velocity, &vec![DVec3::ZERO; sample.x.len()], &[DVec3::ZERO; 6]);
        let (mut worst, mut without_spin) = (0.0_f64, 0.0_f64);
        for (pore, vertices) in mesh.triangulation.pores.iter().enumerate() {
            if vertices.iter().all(|&v| wall(v).is_none()) {
                worst = worst.max(rate[pore].abs());
                without_spin = without_spin.max(still[pore].abs());
            }
        }
        assert!(worst < 1e-13 * sample.cell.volume(), "{}: {worst}", sample.name);
        if sample.name == "spread" {
            assert!(without_spin > 1e-6, "the spins matter: {without_spin}");
        }
    }
}

#[test]
fn isotropic_strain_changes_every_pore_by_its_volume() {
    for sample in samples() {
        for slip in [Slip::Symmetry, Slip::NoSlip] {
            let mesh = mesh(&sample, slip, TOP_BOTTOM);
            let centre = sample.cell.origin + 0.3 * (sample.cell.upper() - sample.cell.origin);
            let velocity: Vec<DVec3> = sample.x.iter().map(|&x| x - centre).collect();
            let walls = std::array::from_fn(|face| {
                let mut v = DVec3::ZERO;
                v[face / 2] = sample.cell.wall_position(face) - centre[face / 2];
                v
            });
            let rate = carried(&mesh, &velocity, &vec![DVec3::ZERO; sample.x.len()], &walls);
            for (pore, rate) in rate.iter().enumerate() {
                // A no-slip wall drags along itself; its share is not that of an expanding wall.
                let interior = mesh.triangulation.pores[pore].iter().all(|&v| wall(v).is_none());
                if slip == Slip::Symmetry || interior {
                    let error = (rate - 3.0 * mesh.volume[pore]).abs();
                    assert!(error < 1e-12 * sample.cell.volume(), "{} pore {pore}: {error}", sample.name);
                }
            }
        }
    }
}

#[test]
fn forces_are_the_transpose_of_the_volumes_carried() {
    let mut random = Random(77);
    for sample in samples() {
        let mesh = mesh(&sample, Slip::NoSlip, TOP_BOTTOM);
        let n = sample.x.len();
        let velocity: Vec<DVec3> = (0..n).map(|_| random.vector()).collect();
        let spin: Vec<DVec3> = (0..n).map(|_| random.vector()).collect();
        let walls: [DVec3; 6] = std::array::from_fn(|_| random.vector());
        let pressure: Vec<f64> = (0..mesh.nodes()).map(|_| random.next()).collect();
        let mut loads = Loads::default();
        loads.clear(n);
        mesh.add_loads(&pressure, &mut loads);
        let mut power = 0.0;
        for i in 0..n {
            power += loads.force[i].dot(velocity[i]) + loads.torque[i].dot(spin[i]);
        }
        power += (0..6).map(|f| loads.wall[f].dot(walls[f])).sum::<f64>();
        let mut out = Carried::default();
        mesh.carried(&velocity, &spin, &walls, &mut out);
        let work: f64 = out.node.iter().zip(&pressure).map(|(v, p)| v * p).sum();
        assert!((power - work).abs() < 1e-11 * work.abs().max(1e-3), "{}: {power} {work}", sample.name);
    }
}

#[test]
fn pressure_work_of_moving_grains_is_dissipated_in_the_throats() {
    let mut random = Random(5);
    for sample in samples() {
        let mesh = mesh(&sample, Slip::Symmetry, TOP_BOTTOM);
        let n = sample.x.len();
        let velocity: Vec<DVec3> = (0..n).map(|_| random.vector()).collect();
        let mut out = Carried::default();
        mesh.carried(&velocity, &vec![DVec3::ZERO; n], &[DVec3::ZERO; 6], &mut out);
        let mut pressure = vec![0.0; mesh.nodes()];
        let mut system = System::new(&mesh, Solver::Cholesky.method(), 1e-12, 100).unwrap();
        system.solve(&mesh, &out.node, &mut pressure).unwrap();
        let mut loads = Loads::default();
        loads.clear(n);
        mesh.add_loads(&pressure, &mut loads);
        let power: f64 = (0..n).map(|i| loads.force[i].dot(velocity[i])).sum();
        let dissipated: f64 = mesh
            .links
            .iter()
            .zip(&mesh.conductance)
            .map(|(l, g)| g * (pressure[l[0] as usize] - pressure[l[1] as usize]).powi(2))
            .sum();
        assert!(dissipated > 0.0);
        assert!((power + dissipated).abs() < 1e-9 * dissipated, "{}: {power} {dissipated}", sample.name);
    }
}

/// `V = S G⁻¹ Sᵀ` as a full matrix over velocities and spins of the grains and velocities of the walls.
fn damping(mesh: &Mesh, n: usize) -> Vec<Vec<f64>> {
    let mut system = System::new(mesh, Solver::Cholesky.method(), 1e-12, 100).unwrap();
    let size = 6 * n + 18;
    let mut matrix = Vec::new();
    for column in 0..size {
        let unit = |k: usize| DVec3::from_array([0, 1, 2].map(|c| f64::from(u8::from(k + c == column))));
        let velocity: Vec<DVec3> = (0..n).map(|i| unit(3 * i)).collect();
        let spin: Vec<DVec3> = (0..n).map(|i| unit(3 * (n + i))).collect();
        let walls: [DVec3; 6] = std::array::from_fn(|f| unit(3 * (2 * n + f)));
        let mut out = Carried::default();
        mesh.carried(&velocity, &spin, &walls, &mut out);
        let mut pressure = vec![0.0; mesh.nodes()];
        system.solve(mesh, &out.node, &mut pressure).unwrap();
        let mut loads = Loads::default();
        loads.clear(n);
        mesh.add_loads(&pressure, &mut loads);
        let all = loads.force.iter().chain(&loads.torque).chain(&loads.wall);
        matrix.push(all.flat_map(|load| (-*load).to_array()).collect());
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
fn the_water_only_damps() {
    let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
    for (name, n, ratio, seed) in
        [("equal", 40, 1.0, 11), ("two sizes", 60, 0.0, 12), ("many sizes", 60, 6.0, 13)]
    {
        let (x, mut r) = cloud(&cell, n, if ratio > 1.0 { 0.15 } else { 0.1 }, f64::max(ratio, 1.0), seed);
        if ratio == 0.0 {
            // Every other grain half as big.
            r.iter_mut().step_by(2).for_each(|r| *r *= 0.5);
        }
        let sample = Sample { name, cell, x, r };
        for slip in [Slip::Symmetry, Slip::NoSlip] {
            let v = damping(&mesh(&sample, slip, TOP_BOTTOM), n);
            let largest = (0..v.len()).map(|k| v[k][k]).fold(0.0, f64::max);
            for i in 0..v.len() {
                for j in 0..i {
                    assert!((v[i][j] - v[j][i]).abs() < 1e-10 * largest, "{name}: {} {}", v[i][j], v[j][i]);
                }
            }
            assert!(above(v.clone(), 1e-9 * largest), "{name} {slip:?} has a growing mode");
            let mut turned = v;
            turned[5][5] -= 2.0 * turned[5][5];
            assert!(!above(turned, 1e-9 * largest), "the test sees growing modes");
        }
    }
}

#[test]
fn every_throat_balances_forces_and_moments() {
    let mut random = Random(21);
    for sample in samples() {
        let packing = Packing { cell: &sample.cell, position: &sample.x, radius: &sample.r };
        let mesh = mesh(&sample, Slip::NoSlip, TOP_BOTTOM);
        let centres = radical_centres(packing, &mesh.triangulation);
        for throat in throats(&mesh.triangulation) {
            let shape = shape(packing, &mesh.triangulation, &centres, &throat);
            let slip = [Slip::NoSlip; 6];
            let passage = Passage::new(packing, &mesh.triangulation, &centres, &throat, &shape, &slip);
            let pore = throat.pores[0] as usize;
            let points = FACET[throat.facet as usize].map(|m| packing.point(&mesh.triangulation, pore, m));
            let [Some(a), Some(b), Some(c)] = points else { continue };
            let coupled = coupling(packing, &passage, points, Conductance::hydraulic_radius());
            let push = shape.area * shape.normal;
            let force: DVec3 = coupled.force.iter().sum();
            assert!((force - push).length() < 1e-12 * shape.area, "{}", sample.name);
            // The pressure difference acts on the whole facet; the part over the sectors acts on the grains'
            // surfaces, through their centres, and its moment about them closes around each grain of a pore.
            let point = random.vector();
            let mut moment: DVec3 = coupled.torque.iter().sum();
            for (x, force) in [a, b, c].into_iter().zip(coupled.force) {
                moment += (x - point).cross(force);
            }
            let sectors: DVec3 = shape.sector_moment.iter().sum();
            let expected = (shape.area * (shape.centroid - point) - sectors).cross(shape.normal);
            let scale = shape.area * (shape.centroid - point).length();
            assert!((moment - expected).length() < 1e-10 * scale, "{}: {moment} {expected}", sample.name);
        }
    }
}

fn problem(axis: usize, sides: Slip) -> Problem {
    Problem {
        axis,
        drop: 12.0,
        sides,
        viscosity: 1e-3,
        conductance: Conductance::hydraulic_radius(),
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: 1e-8,
    }
}

#[test]
fn forces_sum_to_the_boundary_pressures_and_what_flows_in_flows_out() {
    for sample in samples() {
        for axis in 0..3 {
            for sides in [Slip::Symmetry, Slip::NoSlip] {
                let outcome = measure(&sample.cell, &sample.x, &sample.r, &problem(axis, sides)).unwrap();
                let size = sample.cell.upper() - sample.cell.origin;
                let section = sample.cell.volume() / size[axis];
                let mut expected = DVec3::ZERO;
                expected[axis] = 12.0 * section;
                let total = outcome.force_sum + outcome.loads.wall.iter().sum::<DVec3>();
                assert!((total - expected).length() < 1e-9 * expected.length(), "{}: {total}", sample.name);
                assert!((outcome.inflow / outcome.outflow - 1.0).abs() < 1e-9, "{}", sample.name);
                assert!((outcome.pressure_profile[0] - 12.0).abs() < 1e-9);
                assert!(outcome.pressure_profile[12].abs() < 1e-9);
            }
        }
    }
}

#[test]
fn results_scale_with_length_and_viscosity() {
    for sample in samples() {
        let base = measure(&sample.cell, &sample.x, &sample.r, &problem(2, Slip::NoSlip)).unwrap();
        for (length, viscosity) in [(1e-6, 1.0), (1e5, 1.0), (1.0, 250.0)] {
            let cell = Cell::walled(sample.cell.origin * length, sample.cell.upper() * length);
            let x: Vec<DVec3> = sample.x.iter().map(|&x| x * length).collect();
            let r: Vec<f64> = sample.r.iter().map(|&r| r * length).collect();
            let mut scaled = problem(2, Slip::NoSlip);
            scaled.viscosity *= viscosity;
            let outcome = measure(&cell, &x, &r, &scaled).unwrap();
            let k = outcome.permeability / (length * length);
            assert!((k / base.permeability - 1.0).abs() < 1e-9, "{}: {k} {}", sample.name, base.permeability);
            let q = outcome.inflow * viscosity / length.powi(3);
            assert!((q / base.inflow - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn turning_the_sample_turns_the_result() {
    let sample = &samples()[1];
    let turn = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X); // x -> y -> z -> x
    let base = measure(&sample.cell, &sample.x, &sample.r, &problem(2, Slip::NoSlip)).unwrap();
    let cell = Cell::walled(turn * sample.cell.origin, turn * sample.cell.upper());
    let x: Vec<DVec3> = sample.x.iter().map(|&x| turn * x).collect();
    let turned = measure(&cell, &x, &sample.r, &problem(0, Slip::NoSlip)).unwrap();
    assert!((turned.permeability / base.permeability - 1.0).abs() < 1e-10);
    for i in 0..x.len() {
        assert!(
            (turned.loads.force[i] - turn * base.loads.force[i]).length() < 1e-9 * base.force_sum.length()
        );
    }
}

/// Slivers: the flat pores of a lattice must not care which way rounding tips them.
#[test]
fn shaken_lattices_keep_their_permeability() {
    let cube = DVec3::ONE;
    let simple: &[[f64; 3]] = &[[0.0; 3]];
    let body: &[[f64; 3]] = &[[0.0; 3], [0.5; 3]];
    let face: &[[f64; 3]] = &[[0.0; 3], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]];
    let hexagonal: &[[f64; 3]] = &[[0.0; 3], [0.5, 0.5, 0.0], [0.5, 1.0 / 6.0, 0.5], [0.0, 2.0 / 3.0, 0.5]];
    let lattices = [
        (cube, simple, 0.5),
        (cube, body, 0.75f64.sqrt() / 2.0),
        (cube, face, 0.125f64.sqrt()),
        (DVec3::new(1.0, 3f64.sqrt(), (8.0 / 3.0f64).sqrt()), hexagonal, 0.5),
    ];
    let problems = [
        (Slip::Symmetry, Conductance::hydraulic_radius()),
        (Slip::NoSlip, Conductance::hydraulic_radius()),
        (Slip::Symmetry, Conductance::LocalDrag),
        (Slip::NoSlip, Conductance::LocalDrag),
    ];
    for (edges, basis, radius) in lattices {
        let corners = (0..64).map(|i| DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64));
        let lattice: Vec<DVec3> =
            corners.flat_map(|c| basis.iter().map(move |b| edges * (c + DVec3::from(*b)))).collect();
        let high = lattice.iter().copied().fold(DVec3::ZERO, DVec3::max);
        let cell = Cell::walled(DVec3::splat(-radius), high + radius);
        let r = vec![radius * 0.999; lattice.len()];
        let mut random = Random(8);
        for axis in 0..3 {
            for (slip, conductance) in problems {
                let problem = Problem { conductance, ..problem(axis, slip) };
                let base = measure(&cell, &lattice, &r, &problem).unwrap();
                for shake in [1e-12, 1e-9, 1e-6] {
                    let x: Vec<DVec3> =
                        lattice.iter().map(|&x| x + 2.0 * shake * radius * random.vector()).collect();
                    let shaken = measure(&cell, &x, &r, &problem).unwrap();
                    let change = shaken.permeability / base.permeability - 1.0;
                    assert!(change.abs() < 1e-2, "{edges} {problem:?} {shake}: {change}");
                }
            }
        }
    }
}

/// More grains than one thread loads at a time, in no particular order, so that every patch meets pores of all others.
#[test]
fn threads_load_the_grains_bit_by_bit_as_one_does() {
    let cell = Cell::walled(DVec3::ZERO, DVec3::splat(1.0));
    let (x, r) = cloud(&cell, 4500, 0.02, 1.5, 9);
    let sample = Sample { name: "patches", cell, x, r };
    let mesh = mesh(&sample, Slip::NoSlip, TOP_BOTTOM);
    let mut random = Random(3);
    let pressure: Vec<f64> = (0..mesh.nodes()).map(|_| random.vector().x).collect();
    let loads = |threads: usize| {
        let mut loads = Loads::default();
        loads.clear(sample.x.len());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| mesh.add_loads(&pressure, &mut loads));
        loads
    };
    let (one, two) = (loads(1), loads(2));
    assert!(one.force.iter().all(|f| *f != DVec3::ZERO));
    assert!(one.force == two.force && one.torque == two.torque && one.wall == two.wall);
}
