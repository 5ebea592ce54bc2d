//! `porograin bench` as scripts call it.

use std::path::Path;
use std::process::Command;

const BOX: &str = "0,0,0,0.075326733,0.074770267,0.074783642";

fn bench(what: &str, more: &[&str]) -> serde_json::Value {
    let grains = Path::new(env!("CARGO_MANIFEST_DIR")).join("../benches/packings/dense-5000.csv");
    let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(["bench", what, "--box", BOX, "--json", "--grains"])
        .arg(grains)
        .args(more)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_coupled_step_is_timed_on_a_packing_that_consolidates() {
    let cost = bench("coupled", &["--steps", "40", "--residual", "1e-4"]);
    let number = |key: &str| cost[key].as_f64().unwrap_or_else(|| panic!("no number {key} in {cost}"));
    assert_eq!(cost["conductance"], "hydraulic-radius");
    assert_eq!((number("grains"), number("steps"), number("residual")), (5000.0, 40.0, 1e-4));
    let ratio = number("seconds_per_step") / number("dry_seconds_per_step");
    assert!((number("ratio_to_dry") / ratio - 1.0).abs() < 1e-12);
    assert!(number("iterations_per_step") > 0.0);
    // The water carries the load at first: the top sinks, but by less than the dry sample would.
    assert!(number("settlement") > 0.0 && number("settlement") < 1e-4, "{cost}");
    let dt = number("viscous_number") * number("permeability") * 2600.0 / number("viscosity");
    assert!((number("dt") / dt - 1.0).abs() < 1e-12);
    let shares: f64 = cost["phases"].as_array().unwrap().iter().map(|phase| phase[1].as_f64().unwrap()).sum();
    assert!((shares - 1.0).abs() < 1e-9, "{cost}");
    let thick = bench("coupled", &["--steps", "1", "--viscosity", "50"]);
    assert_eq!(thick["limit"], "the viscosity of the water in the pores");
    assert_eq!(thick["viscosity"], 50.0);
}

#[test]
fn the_step_with_coarse_water_is_timed() {
    let cost = bench("coarse", &["--steps", "40"]);
    let number = |key: &str| cost[key].as_f64().unwrap_or_else(|| panic!("no number {key} in {cost}"));
    assert_eq!((number("grains"), number("steps")), (5000.0, 40.0));
    assert!((number("grains") / number("cells") / 8.0 - 1.0).abs() < 0.2, "{cost}");
    assert!(number("settlement") > 0.0 && number("settlement") < 1e-4, "{cost}");
}

#[test]
fn a_permeability_is_timed_in_parts() {
    let cost = bench("permeability", &["--steps", "1"]);
    let seconds = |part: &str| cost["seconds"][part].as_f64().unwrap();
    let parts = seconds("triangulation") + seconds("conductance") + seconds("solve");
    assert!((seconds("total") / parts - 1.0).abs() < 1e-12 && seconds("solve") > 0.0);
    assert_eq!(cost["conductance"], "hydraulic-radius");
    assert!((cost["permeability"].as_f64().unwrap() / 3.1e-8 - 1.0).abs() < 0.1);
}
