//! Examples 01 and 05: their READMEs quote what is checked here.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// The summary of an example's run.
fn summary(example: &str, case: &str) -> Value {
    let case = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(example).join(case);
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join(example).join(case.file_stem().unwrap());
    let _ = std::fs::remove_dir_all(&out);
    let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(["run", case.to_str().unwrap(), "--json", "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("Terzaghi: for T_v > 0.05 the pressure at mid-height is within 0.0"), "{said}");
    assert!(out.join("consolidation.svg").exists());
    let mut object: Value = serde_json::from_slice(&output.stdout).unwrap();
    object["summary"].take()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[track_caller]
fn near_terzaghi(summary: &Value, pressure: f64, settlement: f64) {
    let terzaghi = &summary["terzaghi"];
    assert!(number(&terzaghi["max_error"]) < pressure, "{}", terzaghi["max_error"]);
    assert!(number(&terzaghi["max_settlement_error"]) < settlement, "{}", terzaghi["max_settlement_error"]);
}

/// The pressure at mid-height at first is the load, but for what is left of the piston's bounce.
#[track_caller]
fn carried_by_the_water_at_first(summary: &Value) {
    let first = number(&summary["terzaghi"]["first_pressure"]);
    assert!((0.98..1.08).contains(&first), "{first}");
    let after_the_ramp = summary["terzaghi"]["curves"].as_array().unwrap().iter().filter(|point| {
        let time = number(&point["time"]);
        time > 0.0032 && number(&point["tv"]) < 0.05
    });
    for point in after_the_ramp {
        let (seen, theory) = (number(&point["middle"]), number(&point["middle_theory"]));
        assert!((seen - theory).abs() < 0.08, "{point}");
    }
}

/// The simulation is ahead of theory with every rattler held, and nowhere behind it.
#[track_caller]
fn ahead_by_the_rattlers(summary: &Value) {
    let terzaghi = &summary["terzaghi"];
    let more = number(&terzaghi["permeable_without_rattlers"]);
    assert!((1.1..1.4).contains(&more), "{more}");
    let worst = |sign: f64| {
        let late = terzaghi["curves"].as_array().unwrap().iter().filter(|point| number(&point["tv"]) > 0.1);
        late.map(|point| sign * (number(&point["middle"]) - number(&point["middle_theory"])))
            .fold(f64::NEG_INFINITY, f64::max)
    };
    assert!(worst(-1.0) > 0.02 && worst(1.0) < 0.005, "{} {}", worst(-1.0), worst(1.0));
}

#[test]
fn a_thousand_grains_consolidate_as_terzaghi_says() {
    let summary = summary("01-oedometer", "quick.toml");
    // Nine grains high: samples differ by as much. What theory has to meet is the sample of 5000 below.
    near_terzaghi(&summary, 0.08, 0.08);
    carried_by_the_water_at_first(&summary);
    ahead_by_the_rattlers(&summary);
}

#[test]
#[ignore = "long: two minutes in a release build"]
fn five_thousand_grains_consolidate_as_terzaghi_says() {
    let summary = summary("01-oedometer", "case.toml");
    near_terzaghi(&summary, 0.05, 0.03);
    carried_by_the_water_at_first(&summary);
}

#[test]
#[ignore = "long: half a minute in a release build"]
fn very_viscous_water_consolidates_in_implicit_steps() {
    let summary = summary("05-viscous-oedometer", "quick.toml");
    assert_eq!(summary["stages"][2]["water_step"], "implicit");
    let budget = &summary["budget"];
    let iterations = number(&budget["iterations"]) / number(&budget["steps"]);
    assert!((3.0..5.0).contains(&iterations), "{iterations}");
    assert!(number(&budget["flux"]) < 4e-3 && number(&budget["power"]) < 1.5e-2, "{budget}");
    assert!(number(&budget["mass_drift"]).abs() < 1e-5, "{budget}");
    near_terzaghi(&summary, 0.075, 0.03);
}
