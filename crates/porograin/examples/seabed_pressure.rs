//! The pressure in a seabed under a standing wave against the analytic field (Catalano 6.24-6.26, corrected).
//!
//! `cargo run --release --example seabed_pressure` writes `seabed.svg` into `examples/04-seabed-pressure`.

use glam::DVec3;
use porograin::boundary::Slip;
use porograin::case::Case;
use porograin::permeability::{Problem, measure, outflow};
use porograin::pores::mesh::{FREE, Mesh};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin::run::Simulation;
use porograin_geometry::locate::locate;
use porograin_geometry::throat::Packing;
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Half a wave length, and the depth of the bed [m].
const LENGTH: f64 = 2.0;
const DEPTH: f64 = 1.0;
/// Mean pressure on the bed [Pa]; the wave adds and takes as much.
const MEAN: f64 = 50.0;
/// Across the wave [m].
const WIDTH: f64 = 0.4;

/// The folder of the example.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/04-seabed-pressure")
}

/// The excess pressure at `x`, z counted from the bottom, `wave` being the cosine of the phase [Pa].
pub fn theory(x: DVec3, wave: f64) -> f64 {
    let decay = (PI * x.z / LENGTH).cosh() / (PI * DEPTH / LENGTH).cosh();
    MEAN * (1.0 + decay * (PI * x.x / LENGTH).cos() * wave)
}

/// The bed at one time.
pub struct Bed {
    /// Since the wave began [s].
    pub time: f64,
    /// Cosine of the phase at the last solve.
    pub wave: f64,
    mesh: Mesh,
    pressure: Vec<f64>,
    position: Vec<DVec3>,
    radius: Vec<f64>,
    cell: porograin_geometry::Cell,
}

/// Runs the case with overrides `key=value`; the bed after every step.
pub fn run(overrides: &[&str]) -> Vec<Bed> {
    let all: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
    let case = Case::from_file(&folder().join("case.toml"), &all).expect("the case is sound");
    let mut simulation = Simulation::new(&case).expect("the grains can be made");
    let mut beds = Vec::new();
    while simulation.stage().is_some() {
        let time = simulation.state.time;
        if simulation.advance().expect("the step can be done").is_none() {
            break;
        }
        let state = &simulation.state;
        let (Some(mesh), Some(water)) = (simulation.work().fluid.mesh(), state.pores()) else { break };
        beds.push(Bed {
            time,
            wave: (2.0 * PI * time).cos(),
            mesh: mesh.clone(),
            pressure: water.pressure.clone(),
            position: state.grains.position.clone(),
            radius: state.grains.radius.clone(),
            cell: state.domain.cell,
        });
    }
    beds
}

impl Bed {
    fn packing(&self) -> Packing<'_> {
        Packing { cell: &self.cell, position: &self.position, radius: &self.radius }
    }

    /// The excess pressure of the pore that contains `x` [Pa].
    pub fn at(&self, x: DVec3) -> f64 {
        let pore = locate(self.packing(), &self.mesh.triangulation, x, 0).map_or(0, |found| found.pore);
        self.pressure[self.mesh.node[pore as usize] as usize]
    }

    /// Root mean square over the free pores, weighted by volume, and the largest difference from theory where each pore's
    /// pressure lives, over the mean pressure.
    pub fn error(&self) -> [f64; 2] {
        let (mut sum, mut volume, mut worst) = (0.0, 0.0, 0.0f64);
        for (pore, &node) in self.mesh.node.iter().enumerate() {
            if self.mesh.held[node as usize] == FREE {
                let error = (self.pressure[node as usize] - theory(self.mesh.centre[pore], self.wave)) / MEAN;
                sum += self.mesh.volume[pore] * error * error;
                volume += self.mesh.volume[pore];
                worst = worst.max(error.abs());
            }
        }
        [(sum / volume).sqrt(), worst]
    }

    /// Water that enters the bed where the wave presses, x below a quarter of a wave, over what theory says:
    /// `k/mu MEAN tanh(pi h/L) wave` times the width. `k` is the bed's permeability along x and z, the geometric mean.
    pub fn entering(&self) -> f64 {
        let out = outflow(&self.mesh, &self.pressure);
        let mut seen = vec![false; self.mesh.nodes()];
        let mut entering = 0.0;
        for (pore, &node) in self.mesh.node.iter().enumerate() {
            let node = node as usize;
            if self.mesh.held[node] != FREE && !seen[node] && self.mesh.centre[pore].x < 0.5 * LENGTH {
                seen[node] = true;
                entering += out[node];
            }
        }
        let along = |axis| {
            let problem = Problem {
                axis,
                drop: 1.0,
                sides: Slip::Symmetry,
                viscosity: 1e-3,
                conductance: Conductance::LocalDrag,
                coupling: Coupling::Reciprocal,
                solver: Solver::Auto,
                residual: 1e-8,
            };
            measure(&self.cell, &self.position, &self.radius, &problem).expect("it flows").permeability
        };
        let mobility = (along(0) * along(2)).sqrt() / 1e-3;
        entering / (mobility * MEAN * (PI * DEPTH / LENGTH).tanh() * self.wave * WIDTH)
    }
}

/// Pixels along x and z of one picture.
const PIXELS: [usize; 2] = [100, 50];

fn main() -> std::io::Result<()> {
    let beds = run(&[]);
    let mut svg = String::new();
    let (cell, gap, shown) = (4.0, 30.0, [0, 4]);
    let (width, height) = (cell * PIXELS[0] as f64, cell * PIXELS[1] as f64);
    let (all, tall) = (2.0 * width + 3.0 * gap, 2.0 * (height + 1.5 * gap) + gap);
    let _ = writeln!(
        svg,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{all}\" height=\"{tall}\" viewBox=\"0 0 {all} {tall}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\">\n<rect width=\"{all}\" height=\"{tall}\" \
         fill=\"white\"/>"
    );
    for (row, bed) in shown.into_iter().map(|k| &beds[k]).enumerate() {
        let fields: [(&str, &dyn Fn(DVec3) -> f64); 2] =
            [("pore by pore", &|x| bed.at(x)), ("theory", &|x| theory(x, bed.wave))];
        for (column, (name, field)) in fields.into_iter().enumerate() {
            let (left, top) = (gap + column as f64 * (width + gap), gap + row as f64 * (height + 1.5 * gap));
            let _ = writeln!(
                svg,
                "<text x=\"{left}\" y=\"{}\">{name}, t = {} s: 0 (white) to 100 Pa (blue)</text>",
                top - 8.0,
                bed.time
            );
            let _ = writeln!(svg, "<g transform=\"translate({left},{top})\" shape-rendering=\"crispEdges\">");
            for j in 0..PIXELS[1] {
                // Pixels of one colour side by side are one rectangle.
                let shade = |i: usize| {
                    let x = (i as f64 + 0.5) / PIXELS[0] as f64 * LENGTH;
                    let z = (1.0 - (j as f64 + 0.5) / PIXELS[1] as f64) * DEPTH;
                    (field(DVec3::new(x, 0.5 * WIDTH, z)) / (2.0 * MEAN) * 20.0).round().clamp(0.0, 20.0)
                        as i32
                };
                let mut start = 0;
                for i in 1..=PIXELS[0] {
                    if i < PIXELS[0] && shade(i) == shade(start) {
                        continue;
                    }
                    let part = 1.0 - f64::from(shade(start)) / 20.0;
                    let [red, green] = [255.0 * part, 114.0 + 141.0 * part].map(f64::round);
                    let _ = writeln!(
                        svg,
                        "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{cell}\" fill=\"rgb({red},{green},{})\"/>",
                        cell * start as f64,
                        cell * j as f64,
                        cell * (i - start) as f64,
                        (178.0 + 77.0 * part).round()
                    );
                    start = i;
                }
            }
            let _ = writeln!(
                svg,
                "</g><rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"#333\"/>"
            );
        }
    }
    svg.push_str("</svg>\n");
    std::fs::write(folder().join("seabed.svg"), svg)
}
