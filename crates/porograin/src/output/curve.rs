//! Measures that are a curve at every instant, such as a profile over height: their columns and where each stands.

use super::plot::History;
use crate::measure::{CLASSES, LAYERS, PASSING};
use crate::watch::{Measure, PROFILE_POINTS};

/// The columns of a curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// The measure that writes it.
    pub measure: Measure,
    /// Names of its columns, in order.
    pub columns: Vec<String>,
    /// Where each stands.
    pub places: Vec<f64>,
    /// What `places` are, with their unit.
    pub place: &'static str,
    /// Whether they are drawn upwards, and the values to the right.
    pub upright: bool,
}

/// Names of all curves.
pub const CURVES: [&str; 11] = [
    "solid",
    "velocity_x",
    "velocity_y",
    "velocity_z",
    "contacts",
    "normal",
    "tangential",
    "grading",
    "pressure",
    "pressure_x",
    "pressure_y",
];

impl Curve {
    /// The curve of this name; `None` when there is none.
    pub fn named(name: &str) -> Option<Curve> {
        let numbered = |count: usize| (0..count).map(|k| format!("{name}_{k}")).collect();
        let middles = |count: usize| (0..count).map(|k| (k as f64 + 0.5) / count as f64).collect();
        let ends = || (0..PROFILE_POINTS).map(|k| k as f64 / (PROFILE_POINTS - 1) as f64).collect();
        let (measure, columns, places, place, upright) = match name {
            "solid" | "velocity_x" | "velocity_y" | "velocity_z" => {
                (Measure::Profile, numbered(LAYERS), middles(LAYERS), "height over that of the box [-]", true)
            }
            "contacts" | "normal" | "tangential" => (
                Measure::Directions,
                numbered(CLASSES),
                middles(CLASSES),
                "cosine of the angle to the vertical [-]",
                false,
            ),
            "grading" => {
                let columns = PASSING.map(|part| format!("d{:.0}", 100.0 * part)).to_vec();
                (Measure::Grading, columns, PASSING.to_vec(), "finer part of the mass [-]", true)
            }
            "pressure" => (
                Measure::PressureProfile,
                numbered(PROFILE_POINTS),
                ends(),
                "height over that of the box [-]",
                true,
            ),
            "pressure_x" => (
                Measure::PressureProfileX,
                numbered(PROFILE_POINTS),
                ends(),
                "way from left to right [-]",
                false,
            ),
            "pressure_y" => (
                Measure::PressureProfileY,
                numbered(PROFILE_POINTS),
                ends(),
                "way from front to back [-]",
                false,
            ),
            _ => return None,
        };
        Some(Curve { measure, columns, places, place, upright })
    }

    /// The curve at the end of each stage of a history, by the name of the stage, or, of the last, where it stands; only of `stages`
    /// where these are given.
    pub fn at_ends(&self, history: &History, stages: &[String]) -> Vec<(String, Vec<[f64; 2]>)> {
        let mut found: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
        let columns: Option<Vec<Vec<Option<f64>>>> =
            self.columns.iter().map(|name| Some(history.column(name)?.collect())).collect();
        let Some(columns) = columns else { return found };
        for (row, (stage, _)) in history.rows.iter().enumerate() {
            let values: Option<Vec<f64>> = columns.iter().map(|column| column[row]).collect();
            let Some(values) = values.filter(|_| stages.is_empty() || stages.contains(stage)) else {
                continue;
            };
            let point =
                |(value, &place): (f64, &f64)| if self.upright { [value, place] } else { [place, value] };
            let points = values.into_iter().zip(&self.places).map(point).collect();
            match found.last_mut().filter(|last| last.0 == *stage) {
                Some(last) => last.1 = points,
                None => found.push((stage.clone(), points)),
            }
        }
        found
    }
}
