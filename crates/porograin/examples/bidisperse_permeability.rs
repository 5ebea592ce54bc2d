//! Permeability of mixtures of two sizes of beads against the mass of the small ones: draws the picture of
//! `examples/03-bidisperse-permeability`.
//!
//! `cargo run --release --example bidisperse_permeability` writes `permeability.svg` there and prints the table.

use glam::{DMat3, DVec3};
use porograin::State;
use porograin::boundary::Slip;
use porograin::case::Case;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::permeability::{PeriodicProblem, Problem, measure, measure_periodic};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin::run::Simulation;
use porograin_geometry::Cell;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Diameters of the two classes of beads [m].
const SMALL: [f64; 2] = [0.5e-3, 0.63e-3];
const LARGE: [f64; 2] = [2.8e-3, 3.15e-3];
/// Porosity of the cloud that is pressed.
const LOOSE: f64 = 0.75;
/// Residual of the pressures.
const RESIDUAL: f64 = 1e-8;

/// A pressed mixture.
#[derive(Clone, Copy, Debug)]
pub struct Mixture {
    /// Mass of small beads over all mass.
    pub small: f64,
    /// Number of beads.
    pub count: usize,
    /// Porosity.
    pub porosity: f64,
    /// Mean of the permeabilities along x, y and z [m²].
    pub permeability: f64,
    /// Least and greatest of them [m²].
    pub range: [f64; 2],
    /// Surface over volume of the solid [1/m].
    pub surface: f64,
}

/// The folder of the example.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/03-bidisperse-permeability")
}

/// Presses about `count` beads, of which the part `small` by mass are small, in a periodic cell or between walls.
pub fn pressed(small: f64, count: f64, periodic: bool) -> State {
    let volume = |[a, b]: [f64; 2]| PI / 6.0 * (0.5 * (a + b)).powi(3);
    // Beads per volume of the solid.
    let beads = small / volume(SMALL) + (1.0 - small) / volume(LARGE);
    let side = (count / beads / (1.0 - LOOSE)).cbrt();
    let sieve = format!(
        "grains.packing.cloud.grading.sieve=[[{:?}, 0.0], [{:?}, {small:?}], [{:?}, {small:?}], [{:?}, 1.0]]",
        SMALL[0], SMALL[1], LARGE[0], LARGE[1]
    );
    let name = if periodic { "case.toml" } else { "walled.toml" };
    let all = [format!("domain.size=[{side:?}, {side:?}, {side:?}]"), sieve];
    let case = Case::from_file(&folder().join(name), &all).unwrap_or_else(|e| panic!("{e}"));
    let mut simulation = Simulation::new(&case).unwrap_or_else(|e| panic!("{e}"));
    while simulation.advance().unwrap_or_else(|e| panic!("{e}")).is_some() {}
    simulation.state
}

/// The permeability tensor of beads in a periodic cell [m²].
pub fn tensor(cell: &Cell, position: &[DVec3], radius: &[f64]) -> DMat3 {
    let problem = PeriodicProblem {
        slope: 1.0,
        viscosity: 1e-3,
        conductance: Conductance::LocalDrag,
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: RESIDUAL,
    };
    measure_periodic(cell, position, radius, &problem).expect("pores conduct").tensor
}

/// The permeability along x, y and z of beads between walls that mirror the flow [m²].
pub fn along(cell: &Cell, position: &[DVec3], radius: &[f64]) -> [f64; 3] {
    [0, 1, 2].map(|axis| {
        let problem = Problem {
            axis,
            drop: 1.0,
            sides: Slip::Symmetry,
            viscosity: 1e-3,
            conductance: Conductance::LocalDrag,
            coupling: Coupling::Reciprocal,
            solver: Solver::Auto,
            residual: RESIDUAL,
        };
        measure(cell, position, radius, &problem).expect("pores conduct").permeability
    })
}

/// The mean permeability of a walled sample and its seven reflections in a cell of twice its size [m²].
pub fn reflected(state: &State) -> f64 {
    let State { domain, grains, .. } = state;
    let (low, mut position) = (domain.cell.origin, Vec::new());
    for k in 0..8 {
        let sign = DVec3::from([0, 1, 2].map(|axis| if k >> axis & 1 == 0 { 1.0 } else { -1.0 }));
        position.extend(grains.position.iter().map(|&x| low + sign * (x - low)));
    }
    let cell = Cell::periodic(low - domain.cell.edges * DVec3::ONE, 2.0 * domain.cell.edges);
    let tensor = tensor(&cell, &position, &grains.radius.repeat(8));
    (tensor.x_axis.x + tensor.y_axis.y + tensor.z_axis.z) / 3.0
}

/// Measures a pressed mixture.
pub fn measured(small: f64, state: &State) -> Mixture {
    let State { domain, grains, .. } = state;
    let along = if domain.is_periodic() {
        let tensor = tensor(&domain.cell, &grains.position, &grains.radius);
        [0, 1, 2].map(|axis| tensor.col(axis)[axis])
    } else {
        along(&domain.cell, &grains.position, &grains.radius)
    };
    let sum = |power: i32| grains.radius.iter().map(|r| r.powi(power)).sum::<f64>();
    Mixture {
        small,
        count: grains.len(),
        porosity: 1.0 - grains.volume() / domain.cell.volume(),
        permeability: along.iter().sum::<f64>() / 3.0,
        range: [along.into_iter().fold(f64::INFINITY, f64::min), along.into_iter().fold(0.0, f64::max)],
        surface: 3.0 * sum(2) / sum(3),
    }
}

impl Mixture {
    /// The diameter that a tenth of the mass is finer than [m].
    pub fn d10(&self) -> f64 {
        let within = |[a, b]: [f64; 2], part: f64| a + part * (b - a);
        if self.small >= 0.1 {
            within(SMALL, 0.1 / self.small)
        } else {
            within(LARGE, (0.1 - self.small) / (1.0 - self.small))
        }
    }

    /// Slichter (1905): `k = 0.01 n^3.287 d10²` [m²].
    pub fn slichter(&self) -> f64 {
        0.01 * self.porosity.powf(3.287) * self.d10().powi(2)
    }

    /// Terzaghi (1925): `k = 8.4e-3 ((n - 0.13)/(1 - n)^(1/3))² d10²` [m²]; the thesis lost the square.
    pub fn terzaghi(&self) -> f64 {
        8.4e-3 * ((self.porosity - 0.13) / (1.0 - self.porosity).cbrt() * self.d10()).powi(2)
    }

    /// Kozeny and Carman (Carrier 2003): `k = n³/(5 S² (1 - n)²)`, S the surface of the solid over its volume [m²].
    pub fn kozeny_carman(&self) -> f64 {
        self.porosity.powi(3) / (5.0 * (self.surface * (1.0 - self.porosity)).powi(2))
    }
}

fn picture(periodic: &[Mixture], walled: &[Mixture], reflections: &[[f64; 2]]) -> String {
    let points = |mixtures: &[Mixture], of: fn(&Mixture) -> f64| -> Vec<[f64; 2]> {
        mixtures.iter().map(|m| [m.small, of(m)]).collect()
    };
    let series =
        |points: Vec<[f64; 2]>, mark, name: &str, colour| Series { name: name.into(), points, mark, colour };
    let x = || Axis {
        label: "mass of small beads over all mass [-]".into(),
        range: Some([0.0, 1.0]),
        ..Axis::default()
    };
    let k = |m: &Mixture| m.permeability;
    let n = |m: &Mixture| m.porosity;
    let permeability = Chart {
        title: "Permeability of beads of 0.5-0.63 and 2.8-3.15 mm".into(),
        x: x(),
        y: Axis { label: "permeability [m²]".into(), logarithmic: true, range: Some([2e-11, 3e-8]) },
        series: vec![
            series(points(walled, k), Mark::Dots, "between walls", 1),
            series(reflections.to_vec(), Mark::Line, "the same, reflected and periodic", 1),
            series(points(periodic, k), Mark::Dots, "periodic", 0),
            series(points(periodic, Mixture::kozeny_carman), Mark::Line, "Kozeny-Carman", 0),
            series(points(periodic, Mixture::terzaghi), Mark::Line, "Terzaghi", 3),
            series(points(periodic, Mixture::slichter), Mark::Line, "Slichter", 2),
        ],
    };
    let porosity = Chart {
        title: "Porosity of the same samples".into(),
        x: x(),
        y: Axis { label: "porosity [-]".into(), range: Some([0.2, 0.5]), ..Axis::default() },
        series: vec![
            series(points(walled, n), Mark::Dots, "between walls", 1),
            series(points(periodic, n), Mark::Dots, "periodic", 0),
        ],
    };
    svg(&[permeability, porosity])
}

#[allow(dead_code)] // the tests use the rest
fn main() -> std::io::Result<()> {
    let count = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(2000.0_f64);
    let (mut periodic, mut walled, mut reflections) = (Vec::new(), Vec::new(), Vec::new());
    for small in [0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0] {
        // Large beads alone need no crowd.
        let count = if small == 0.0 { count.min(600.0) } else { count };
        let [cell, walls] = [true, false].map(|kind| pressed(small, count, kind));
        let (a, b, again) = (measured(small, &cell), measured(small, &walls), reflected(&walls));
        println!(
            "| {small} | {} | {:.3} | {:.2e} | {:.3} | {:.2e} | {again:.2e} | {:.2e} | {:.2e} | {:.2e} |",
            a.count,
            a.porosity,
            a.permeability,
            b.porosity,
            b.permeability,
            a.kozeny_carman(),
            a.terzaghi(),
            a.slichter()
        );
        periodic.push(a);
        walled.push(b);
        reflections.push([small, again]);
    }
    std::fs::write(folder().join("permeability.svg"), picture(&periodic, &walled, &reflections))
}
