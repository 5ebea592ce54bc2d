//! The column of Goodarzi et al. (2013) of `examples/20-seepage-column`, its numbers and its theory (`physics` §5).

#[path = "../examples/seepage_column.rs"]
mod column;

use column::{Column, INFLOW, run};

fn near(value: f64, expected: f64, part: f64) {
    assert!((value / expected - 1.0).abs() < part, "{value} is not within {part} of {expected}");
}

/// Largest relative error of the uplift, and of the pressure at the bottom, for t > 0.05 s.
fn errors(column: &Column) -> [f64; 2] {
    let late = column.seen.iter().filter(|s| s.time > 0.05);
    late.fold([0.0, 0.0], |[uplift, pressure], s| {
        let of = |value: f64, theory: f64| (value / theory - 1.0).abs();
        [
            uplift.max(of(s.uplift, column.uplift(s.time))),
            pressure.max(of(s.pressure[0], column.pressure(s.time, 1.0))),
        ]
    })
}

#[test]
fn the_column_settles_and_swells_as_the_paper_says() {
    let column = run(1e7, &[]);
    near(column.settlement, 0.162e-3, 2e-3);
    near(column.porosity(), 0.2121, 5e-4);
    near(column.compressibility(), 1.012e-5, 0.015);
    near(column.conductivity(), 1.00e-3, 1e-3);
    let last = column.seen.last().unwrap();
    near(last.uplift, 0.124e-3, 0.01);
    near(last.pressure[0], 9806.65 * INFLOW * column.height() / column.conductivity(), 0.01);
    let [uplift, pressure] = errors(&column);
    assert!(uplift < 0.03 && pressure < 0.03, "{uplift} {pressure}");
    // The whole profile, as a part of the last pressure at the bottom.
    for s in column.seen.iter().filter(|s| s.time > 0.05) {
        for (k, p) in s.pressure.iter().enumerate() {
            let theory = column.pressure(s.time, 1.0 - k as f64 / 12.0);
            assert!((p - theory).abs() < 0.03 * last.pressure[0], "t = {} height {k}: {p} {theory}", s.time);
        }
    }
}

#[test]
fn a_soft_water_slows_the_column_as_its_storage_predicts() {
    for bulk_modulus in [1e5, 1e4] {
        let long = ["stage.settle.until.time=5", "stage.seep.until.time=1.5"];
        let column = run(bulk_modulus, &long);
        // The column swings a little at first, the softer the water the longer: errors as parts of the last values.
        let (risen, last) = (column.uplift(1e9), column.pressure(1e9, 1.0));
        for s in column.seen.iter().filter(|s| s.time > 0.05) {
            near(risen + s.uplift - column.uplift(s.time), risen, 0.03);
            near(last + s.pressure[0] - column.pressure(s.time, 1.0), last, 0.03);
        }
        // How much slower: the time at which half of the uplift is reached.
        let half = 0.5 * risen;
        let after = column.seen.iter().position(|s| s.uplift > half).unwrap();
        let [a, b] = [column.seen[after - 1], column.seen[after]];
        let seen = a.time + (half - a.uplift) / (b.uplift - a.uplift) * (b.time - a.time);
        let theory = (0..30_000).map(|k| 5e-5 * f64::from(k)).find(|&t| column.uplift(t) > half).unwrap();
        near(seen, theory, 0.03);
    }
}

#[test]
fn inflow_at_the_critical_gradient_lifts_the_column() {
    // The weight of the discs in water over that of the column of water: i_c = (1 - n)(rho_s/rho_f - 1) at the height
    // they have when they carry nothing.
    let column = run(1e7, &["stage.seep.until.steps=1"]);
    let critical = column.conductivity() * std::f64::consts::PI / 4.0 * 1.65;
    for (part, lifts) in [(0.98, false), (1.02, true)] {
        let inflow = format!("stage.seep.face.bottom.water.inflow={}", part * critical);
        let column = run(1e7, &[&inflow, "stage.seep.until.time=8"]);
        let rise = column.seen.last().unwrap().uplift - column.settlement;
        assert_eq!(column.stands, !lifts, "{part}: {rise}");
        assert_eq!(rise > 1e-4, lifts, "{part}: {rise}");
    }
}
