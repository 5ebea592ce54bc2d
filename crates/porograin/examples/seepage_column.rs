//! The column of Goodarzi et al. (2013) against theory: draws its Figures 3 and 4.
//!
//! `cargo run --release --example seepage_column` writes `uplift.svg` and `pressure.svg` into `examples/20-seepage-column`.

use porograin::case::Case;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::run::Simulation;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Unit weight of water [N/m³].
const GAMMA: f64 = 9806.65;
/// Inflow from below [m/s].
pub const INFLOW: f64 = 1e-3;
/// Height of the column before it settles [m].
const HEIGHT: f64 = 0.05;

/// What is seen of the column at one time.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Since the water was let in [s].
    pub time: f64,
    /// Of the top [m].
    pub uplift: f64,
    /// Excess pressure at 13 heights, bottom to top [Pa].
    pub pressure: [f64; 13],
}

/// One run.
#[derive(Clone, Debug)]
pub struct Column {
    /// Bulk modulus of the water [Pa].
    pub bulk_modulus: f64,
    /// How far the top settled under the submerged weight [m].
    pub settlement: f64,
    /// What was seen every 5 ms since the inflow began.
    pub seen: Vec<Seen>,
    /// Whether the bottom disc still stands on the bottom at the end.
    pub stands: bool,
}

/// The folder of the example.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/20-seepage-column")
}

/// Runs the case of the example with overrides `key=value`.
pub fn run(bulk_modulus: f64, overrides: &[&str]) -> Column {
    let mut all = vec![format!("fluid.bulk-modulus={bulk_modulus:e}")];
    all.extend(overrides.iter().map(|&text| text.to_owned()));
    let case = Case::from_file(&folder().join("case.toml"), &all).expect("the case is sound");
    let mut simulation = Simulation::new(&case).expect("the grains can be made");
    let top = |simulation: &Simulation| {
        let grains = &simulation.state.grains;
        grains.position.iter().zip(&grains.radius).map(|(x, r)| x.z + r).fold(0.0, f64::max)
    };
    while simulation.stage().is_some_and(|stage| stage.name == "settle") {
        simulation.advance().expect("the column settles");
    }
    let (settled, start) = (top(&simulation), simulation.state.time);
    let (mut seen, mut next) = (Vec::new(), 0.005);
    while simulation.advance().expect("the column seeps").is_some() {
        let time = simulation.state.time - start;
        if time >= next * (1.0 - 1e-9) {
            next += 0.005;
            let pressure = simulation.profile().expect("there is water");
            seen.push(Seen { time, uplift: top(&simulation) - settled, pressure });
        }
    }
    let stands = simulation.state.grains.position.iter().any(|x| x.z < 0.5e-3);
    Column { bulk_modulus, settlement: HEIGHT - settled, seen, stands }
}

impl Column {
    /// Height when settled [m].
    pub fn height(&self) -> f64 {
        HEIGHT - self.settlement
    }

    /// Porosity when settled.
    pub fn porosity(&self) -> f64 {
        1.0 - 50.0 * PI / 4.0 * 1e-6 / (1e-3 * self.height())
    }

    /// Compressibility from the settlement (Goodarzi 14) [1/Pa].
    pub fn compressibility(&self) -> f64 {
        let submerged = 1650.0 * PI / 4.0 * 9.80665;
        2.0 * self.settlement / (HEIGHT * HEIGHT * submerged)
    }

    /// Hydraulic conductivity when settled (Goodarzi 15) [m/s].
    pub fn conductivity(&self) -> f64 {
        let n = self.porosity();
        1e-6 * n.powi(3) * GAMMA / (150.0 * 1.004e-3 * (1.0 - n).powi(2))
    }

    /// `T_v`, with a compressible water slowed as `C_v -> k/(gamma_w (m_v + n/K_f))`.
    pub fn time_factor(&self, time: f64) -> f64 {
        let storage = self.compressibility() + self.porosity() / self.bulk_modulus;
        self.conductivity() / (GAMMA * storage) * time / self.height().powi(2)
    }

    /// Uplift in theory (Goodarzi 13 corrected) [m].
    pub fn uplift(&self, time: f64) -> f64 {
        let coefficient = self.conductivity() / (GAMMA * self.compressibility());
        let last = INFLOW * self.height().powi(2) / (2.0 * coefficient);
        last * (1.0 - self.series(time, |k| 32.0 * k.sign / (PI * k.odd).powi(3)))
    }

    /// Excess pressure in theory at a depth below the top, as a part of the height (Goodarzi 12 corrected) [Pa].
    pub fn pressure(&self, time: f64, depth: f64) -> f64 {
        let last = self.height() * GAMMA * INFLOW / self.conductivity();
        let mode = |k: Mode| 8.0 * k.sign / (PI * k.odd).powi(2) * (0.5 * PI * k.odd * depth).sin();
        last * (depth - self.series(time, mode))
    }

    fn series(&self, time: f64, term: impl Fn(Mode) -> f64) -> f64 {
        let tv = self.time_factor(time);
        (0..400)
            .map(|k| Mode { odd: f64::from(2 * k + 1), sign: if k % 2 == 0 { 1.0 } else { -1.0 } })
            .map(|k| {
                let decay = (-tv * (k.odd * PI / 2.0).powi(2)).exp();
                term(k) * decay
            })
            .sum()
    }
}

#[derive(Clone, Copy)]
struct Mode {
    odd: f64,
    sign: f64,
}

fn axis(label: &str, range: [f64; 2]) -> Axis {
    Axis { label: label.into(), logarithmic: false, range: Some(range) }
}

/// Figure 3: uplift of the top for three bulk moduli.
fn uplift(columns: &[Column]) -> String {
    let mut series = Vec::new();
    for (colour, column) in columns.iter().enumerate() {
        let dots = column.seen.iter().step_by(10).map(|s| [s.time, 1e3 * s.uplift]).collect();
        let line = (0..=300).map(|k| f64::from(k) * 0.005).map(|t| [t, 1e3 * column.uplift(t)]).collect();
        let name = format!("K_f = {:e} Pa", column.bulk_modulus);
        series.push(Series { name, points: dots, mark: Mark::Dots, colour });
        series.push(Series { name: String::new(), points: line, mark: Mark::Line, colour });
    }
    svg(&[Chart {
        title: "Uplift: discs (dots) and theory (lines)".into(),
        x: axis("time since the inflow began [s]", [0.0, 1.5]),
        y: axis("uplift [mm]", [0.0, 0.14]),
        series,
    }])
}

/// Figure 4: pressure over the height at several times.
fn pressure(column: &Column) -> String {
    let mut series = Vec::new();
    for (colour, time) in [0.01, 0.05, 0.1, 0.2, 0.5].into_iter().enumerate() {
        let Some(seen) = column.seen.iter().find(|s| s.time >= time * (1.0 - 1e-9)) else { continue };
        let height = |k: usize| 1e3 * column.height() * k as f64 / 12.0;
        let dots = seen.pressure.iter().enumerate().map(|(k, p)| [*p, height(k)]).collect();
        let line = (0..=100)
            .map(|k| f64::from(k) / 100.0)
            .map(|depth| [column.pressure(seen.time, depth), 1e3 * column.height() * (1.0 - depth)])
            .collect();
        series.push(Series { name: format!("t = {time} s"), points: dots, mark: Mark::Dots, colour });
        series.push(Series { name: String::new(), points: line, mark: Mark::Line, colour });
    }
    svg(&[Chart {
        title: "Excess pressure: cells (dots) and theory (lines)".into(),
        x: axis("excess pressure [Pa]", [0.0, 500.0]),
        y: axis("height [mm]", [0.0, 50.0]),
        series,
    }])
}

#[allow(dead_code)] // the tests use the rest
fn main() -> std::io::Result<()> {
    let columns = [1e7, 1e5, 1e4].map(|bulk_modulus| run(bulk_modulus, &["stage.settle.until.time=5"]));
    for column in &columns {
        println!(
            "K_f = {:e} Pa: settlement {:.4} mm, porosity {:.4}, m_v {:.4e} 1/Pa, k {:.4e} m/s",
            column.bulk_modulus,
            1e3 * column.settlement,
            column.porosity(),
            column.compressibility(),
            column.conductivity()
        );
    }
    std::fs::write(folder().join("uplift.svg"), uplift(&columns))?;
    std::fs::write(folder().join("pressure.svg"), pressure(&columns[0]))
}
