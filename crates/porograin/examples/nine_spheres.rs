//! Eight spheres in a cube and a ninth between them, in a steady flow: Table 3.2 and Figures 3.13 and 3.15 of Catalano
//! (2012).
//!
//! `cargo run --release --example nine_spheres` writes `nine-spheres.svg` into `examples/02-nine-spheres`.

use glam::DVec3;
use porograin::boundary::Slip;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::permeability::{Problem, measure};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin_geometry::Cell;
use porograin_geometry::throat::{Packing, radical_centres, shape, throats};
use porograin_geometry::triangulation::wall;
use std::path::{Path, PathBuf};

/// How the water is computed.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    /// Whether it sticks to the four walls along the flow.
    pub sides: Slip,
    /// How a throat conducts.
    pub conductance: Conductance,
    /// How the viscous forces are shared.
    pub coupling: Coupling,
}

/// As in the thesis.
pub fn thesis(sides: Slip) -> Way {
    Way { sides, conductance: Conductance::hydraulic_radius(), coupling: Coupling::Geometric }
}

/// As users get it.
pub fn default(sides: Slip) -> Way {
    Way { sides, conductance: Conductance::LocalDrag, coupling: Coupling::Reciprocal }
}

/// Forces along the flow over section times pressure drop.
#[derive(Clone, Copy, Debug, Default)]
pub struct Force {
    /// Of the pressure on what the grains cover of the throats (Catalano 3.10).
    pub pressure: f64,
    /// The rest, of the viscous stress.
    pub viscous: f64,
}

impl Force {
    /// Both.
    pub fn total(&self) -> f64 {
        self.pressure + self.viscous
    }
}

/// A flow through the cube.
#[derive(Clone, Copy, Debug)]
pub struct Flow {
    /// Permeability over the section of the cube [-].
    pub permeability: f64,
    /// On one of the eight, the mean.
    pub big: Force,
    /// On the ninth.
    pub small: Force,
    /// Along the flow on one wall beside it, the mean of four.
    pub side: f64,
    /// The sum of all forces on spheres and side walls.
    pub sum: f64,
}

/// Centres and radii in the cube of edge 1: eight spheres of diameter 1/2, and in the middle one `ratio` times as large unless
/// that is zero.
pub fn spheres(ratio: f64) -> (Vec<DVec3>, Vec<f64>) {
    let at = |k: usize| 0.25 + 0.5 * (k as f64);
    let mut x: Vec<DVec3> = (0..8).map(|i| DVec3::new(at(i % 2), at(i / 2 % 2), at(i / 4))).collect();
    let mut r = vec![0.25; 8];
    if ratio > 0.0 {
        x.push(DVec3::splat(0.5));
        r.push(0.25 * ratio);
    }
    (x, r)
}

/// The flow along z.
pub fn flow(ratio: f64, way: Way) -> Flow {
    let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
    let (position, radius) = spheres(ratio);
    let problem = Problem {
        axis: 2,
        drop: 1.0,
        sides: way.sides,
        viscosity: 1.0,
        conductance: way.conductance,
        coupling: way.coupling,
        solver: Solver::Cholesky,
        residual: 1e-12,
    };
    let found = measure(&cell, &position, &radius, &problem).expect("the spheres can be meshed");
    // The part of the pressures, throat by throat.
    let mesh = &found.mesh;
    let packing = Packing { cell: &cell, position: &position, radius: &radius };
    let centres = radical_centres(packing, &mesh.triangulation);
    let mut pressure = vec![0.0; position.len()];
    for throat in throats(&mesh.triangulation) {
        let shape = shape(packing, &mesh.triangulation, &centres, &throat);
        let [p, q] = throat.pores.map(|pore| found.pressure[mesh.node[pore as usize] as usize]);
        for k in (0..3).filter(|&k| wall(throat.vertices[k]).is_none()) {
            pressure[throat.vertices[k] as usize] += shape.covered[k] * (p - q) * shape.normal.z;
        }
    }
    let of = |grains: std::ops::Range<usize>| {
        let count = grains.len().max(1) as f64;
        let total: f64 = grains.clone().map(|i| found.loads.force[i].z).sum();
        let pressure: f64 = grains.map(|i| pressure[i]).sum();
        Force { pressure: pressure / count, viscous: (total - pressure) / count }
    };
    let sides: f64 = found.loads.wall[..4].iter().map(|force| force.z).sum();
    Flow {
        permeability: found.permeability,
        big: of(0..8),
        small: of(8..position.len()),
        side: sides / 4.0,
        sum: found.force_sum.z + sides,
    }
}

/// The folder of the example.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/02-nine-spheres")
}

/// Diameter ratios of the figures; beyond 0.732 the ninth would touch the eight.
pub fn ratios() -> impl Iterator<Item = f64> {
    (1..=36).map(|k| 0.02 * f64::from(k))
}

fn main() -> std::io::Result<()> {
    let effective = Way { conductance: Conductance::EffectiveRadius, ..thesis(Slip::NoSlip) };
    let ways = [
        ("local drag, symmetry", default(Slip::Symmetry), Mark::Line),
        ("local drag, no slip", default(Slip::NoSlip), Mark::Dots),
        ("hydraulic radius, symmetry", thesis(Slip::Symmetry), Mark::Line),
        ("hydraulic radius, no slip", thesis(Slip::NoSlip), Mark::Dots),
        ("effective radius, no slip", effective, Mark::Dots),
    ];
    let curve = |name: &str, way: Way, mark, colour, value: &dyn Fn(&Flow) -> f64| Series {
        name: name.into(),
        points: ratios().map(|ratio| [ratio, value(&flow(ratio, way))]).collect(),
        mark,
        colour,
    };
    let x = || Axis { label: "d / D".into(), ..Axis::default() };
    let permeability = Chart {
        title: "Permeability (Fig. 3.13)".into(),
        x: x(),
        y: Axis { label: "k / l0²".into(), logarithmic: true, range: Some([2e-5, 1e-3]) },
        series: (ways.iter().enumerate())
            .map(|(k, &(name, way, mark))| curve(name, way, mark, k / 2, &|flow| flow.permeability))
            .collect(),
    };
    let mut series = Vec::new();
    let shared = Way { coupling: Coupling::Geometric, ..default(Slip::NoSlip) };
    let ways = [
        ("local drag", default(Slip::NoSlip)),
        ("hydraulic radius", thesis(Slip::NoSlip)),
        ("local drag, geometric", shared),
    ];
    for (k, (name, way)) in ways.into_iter().enumerate() {
        series.push(curve(&format!("total, {name}"), way, Mark::Line, k, &|flow| flow.small.total()));
        series.push(curve(&format!("viscous, {name}"), way, Mark::Dots, k, &|flow| flow.small.viscous));
    }
    let forces = Chart {
        title: "Force on the ninth, walls without slip (Fig. 3.15)".into(),
        x: x(),
        y: Axis { label: "F / (S dP)".into(), logarithmic: true, ..Axis::default() },
        series,
    };
    std::fs::write(folder().join("nine-spheres.svg"), svg(&[permeability, forces]))
}
