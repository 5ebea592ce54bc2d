//! Pictures of results.

use super::chart::{Axis, Chart, Mark, Series, svg};
use crate::consolidation::{self, Comparison, Point, Record};

/// A consolidation, measured and in theory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Consolidation {
    /// Profiles of the excess pressure, each at one time.
    pub isochrones: Vec<Isochrone>,
    /// The settlement against time.
    pub settlement: Vec<SettlementPoint>,
}

/// A profile of the excess pressure; the three lists run in parallel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Isochrone {
    /// Time factor `C_v t / L²` [-].
    pub tv: f64,
    /// Height over the height of the sample, from 0 to 1.
    pub z: Vec<f64>,
    /// Measured pressure over the initial one.
    pub measured: Vec<f64>,
    /// Theoretical pressure over the initial one.
    pub theory: Vec<f64>,
}

/// One instant of a settlement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SettlementPoint {
    /// Time factor `C_v t / L²` [-].
    pub tv: f64,
    /// Measured settlement over the final one.
    pub measured: f64,
    /// Theoretical settlement over the final one.
    pub theory: f64,
}

/// Time factors at which profiles are drawn.
const ISOCHRONES: [f64; 6] = [0.02, 0.05, 0.1, 0.2, 0.4, 0.8];

impl Consolidation {
    /// The profiles nearest to some time factors, and the whole settlement.
    pub fn new(seen: &consolidation::Consolidation, comparison: &Comparison) -> Self {
        let tv = |record: &Record| seen.dimensionless(record.time, seen.path());
        let last = seen.records.last().map_or(0.0, tv);
        let nearest = |asked: f64| {
            let distance = |record: &&Record| (tv(record) / asked).ln().abs();
            seen.records.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
        };
        let isochrones = ISOCHRONES.into_iter().filter(|&asked| asked < 1.1 * last).filter_map(nearest);
        // Theory on a finer grid than the measured heights would hide where the two are compared.
        let heights: Vec<f64> = (0..13).map(|k| k as f64 / 12.0).collect();
        let isochrone = |record: &Record| Isochrone {
            tv: tv(record),
            z: heights.clone(),
            measured: record.profile.iter().map(|p| p / seen.load).collect(),
            theory: heights.iter().map(|z| seen.theory(z * seen.height, record.time)).collect(),
        };
        let point =
            |p: &Point| SettlementPoint { tv: p.tv, measured: p.settlement, theory: p.settlement_theory };
        Consolidation {
            isochrones: isochrones.map(isochrone).collect(),
            settlement: comparison.points.iter().map(point).collect(),
        }
    }

    /// The picture: pressure profiles at the left, settlement at the right, dots measured and lines in theory.
    pub fn svg(&self) -> String {
        let mut profiles = Vec::new();
        for (colour, isochrone) in self.isochrones.iter().enumerate() {
            let curve = |values: &[f64]| values.iter().zip(&isochrone.z).map(|(&p, &z)| [p, z]).collect();
            profiles.push(Series {
                name: String::new(),
                points: curve(&isochrone.theory),
                mark: Mark::Line,
                colour,
            });
            profiles.push(Series {
                name: format!("Tv = {}", short(isochrone.tv)),
                points: curve(&isochrone.measured),
                mark: Mark::Dots,
                colour,
            });
        }
        let settlement = vec![
            Series {
                name: "Terzaghi".into(),
                points: self.settlement.iter().map(|s| [s.tv, s.theory]).collect(),
                mark: Mark::Line,
                colour: 6,
            },
            Series {
                name: "measured".into(),
                points: self.settlement.iter().map(|s| [s.tv, s.measured]).collect(),
                mark: Mark::Dots,
                colour: 0,
            },
        ];
        let axis = |label: &str, range: Option<[f64; 2]>, logarithmic: bool| Axis {
            label: label.into(),
            logarithmic,
            range,
        };
        svg(&[
            Chart {
                title: "Excess pressure (dots) and Terzaghi (lines)".into(),
                x: axis("p / p0", Some([0.0, 1.5]), false),
                y: axis("z / H", Some([0.0, 1.0]), false),
                series: profiles,
            },
            Chart {
                title: "Settlement".into(),
                x: axis("time factor Tv", None, true),
                y: axis("degree of consolidation U", Some([0.0, 1.05]), false),
                series: settlement,
            },
        ])
    }
}

/// A number with three figures and no more zeros than it needs.
fn short(value: f64) -> String {
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0502, 0.1, 1.0, 20.0].map(short), ["0.0502", "0.1", "1", "20"]);
    }

    #[test]
    fn every_isochrone_is_drawn_and_named() {
        let isochrone = |tv| Isochrone {
            tv,
            z: vec![0.0, 0.5, 1.0],
            measured: vec![0.0, tv, 0.0],
            theory: vec![0.0, tv, 0.0],
        };
        let settlement = vec![SettlementPoint { tv: 0.01, measured: 0.1, theory: 0.11 }];
        let text = Consolidation { isochrones: vec![isochrone(0.05), isochrone(0.2)], settlement }.svg();
        assert!(text.contains("Tv = 0.05") && text.contains("Tv = 0.2"));
        assert_eq!(text.matches("<circle").count(), 2 * 3 + 2 + 1 + 1);
        assert_eq!(text.matches("<polyline").count(), 3);
    }
}
