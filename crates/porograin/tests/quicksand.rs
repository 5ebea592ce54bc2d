//! The bed of `examples/22-quicksand` and the numbers of its README. With `PICTURE=1` in the environment its picture is drawn anew.

use porograin::case::Case;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::run::Simulation;
use std::path::PathBuf;

/// Inflow at the end of the ramp [m/s], and how long it takes [s].
const RAMP: [f64; 2] = [3.2e-3, 1.6];

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/22-quicksand")
}

/// The bed at one moment.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Inflow [m/s].
    inflow: f64,
    /// Excess pressure at the bottom over the submerged weight per area.
    carried: f64,
    /// Push of water and grains on the bottom over the submerged weight.
    bottom: f64,
    /// Height of the centre of the grains [m].
    centre: f64,
}

/// The bed every 20 ms of the inflow.
fn run() -> Vec<Seen> {
    let mut simulation =
        Simulation::new(&Case::from_file(&folder().join("case.toml"), &[]).unwrap()).unwrap();
    while simulation.stage().is_some_and(|stage| stage.name == "settle") {
        simulation.advance().unwrap();
    }
    let grains = &simulation.state.grains;
    let weight = 9.81 * (grains.mass.iter().sum::<f64>() - 1000.0 * grains.volume()) / 1e-4;
    let (start, mut next, mut seen) = (simulation.state.time, 0.0, Vec::new());
    loop {
        let time = simulation.state.time - start;
        if time >= next {
            next += 0.02;
            let grains = &simulation.state.grains;
            seen.push(Seen {
                inflow: RAMP[0] * time / RAMP[1],
                carried: simulation.profile().unwrap()[0] / weight,
                bottom: -simulation.state.domain.wall_force[4].z / (1e-4 * weight),
                centre: grains.position.iter().map(|x| x.z).sum::<f64>() / grains.len() as f64,
            });
        }
        if simulation.advance().unwrap().is_none() {
            return seen;
        }
    }
}

#[test]
fn the_water_carries_the_bed_from_the_critical_gradient_on() {
    let seen = run();
    let at = |inflow: f64| seen.iter().find(|s| s.inflow >= inflow).unwrap();
    let mean = |from: f64, of: fn(&Seen) -> f64| {
        let late: Vec<f64> = seen.iter().filter(|s| s.inflow > from).map(of).collect();
        late.iter().sum::<f64>() / late.len() as f64
    };
    let critical = 1.5e-3 / at(1.5e-3).carried;
    let rise = |part: f64| at(part * critical).centre / seen[0].centre - 1.0;
    println!(
        "critical inflow {critical:.4e} m/s; carried {:.4}, bottom {:.4}; rises by {:.4} at 0.85, {:.4} at 1.3, {:.4} at 1.5 of it",
        mean(1.2 * critical, |s| s.carried),
        mean(1.2 * critical, |s| s.bottom),
        rise(0.85),
        rise(1.3),
        rise(1.5),
    );
    if std::env::var_os("PICTURE").is_some() {
        let axis = |label: &str| Axis { label: label.into(), ..Axis::default() };
        let chart = |title: &str, y: &str, of: &dyn Fn(&Seen) -> f64| Chart {
            title: title.into(),
            x: axis("inflow [mm/s]"),
            y: axis(y),
            series: vec![Series {
                name: String::new(),
                points: seen.iter().map(|s| [1e3 * s.inflow, of(s)]).collect(),
                mark: Mark::Line,
                colour: 0,
            }],
        };
        let charts = [
            chart("Part of the submerged weight that the water carries", "pressure below / weight", &|s| {
                s.carried
            }),
            chart("Height of the centre of the bed", "height [mm]", &|s| 1e3 * s.centre),
        ];
        std::fs::write(folder().join("quicksand.svg"), svg(&charts)).unwrap();
    }
    assert!((critical - 2.08e-3).abs() < 0.06e-3, "{critical}");
    // Darcy: the pressure grows with the inflow.
    for s in seen.iter().filter(|s| s.inflow > 0.2 * critical && s.inflow < 0.8 * critical) {
        assert!((s.carried / s.inflow * critical - 1.0).abs() < 0.05, "{s:?}");
    }
    // Then the bed floats, but for the lowest grains.
    assert!((mean(1.2 * critical, |s| s.carried) - 0.96).abs() < 0.01);
    assert!((mean(1.2 * critical, |s| s.bottom) - 1.0).abs() < 0.01);
    assert!(rise(0.85) < 0.004 && rise(1.3) > 0.012 && rise(1.5) > 0.035);
}
