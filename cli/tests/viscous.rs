//! Example 05: its README quotes what is checked here.

use std::path::Path;
use std::process::Command;

#[test]
#[ignore = "long: half a minute in a release build"]
fn very_viscous_water_consolidates_in_implicit_steps() {
    let case = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/05-viscous-oedometer/quick.toml");
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("viscous");
    let _ = std::fs::remove_dir_all(&out);
    let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(["run", case.to_str().unwrap(), "--quiet", "--json", "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let summary = &summary["summary"];
    assert_eq!(summary["stages"][2]["water_step"], "implicit");
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let budget = &summary["budget"];
    let iterations = number(&budget["iterations"]) / number(&budget["steps"]);
    assert!((3.0..5.0).contains(&iterations), "{iterations}");
    assert!(number(&budget["flux"]) < 4e-3 && number(&budget["power"]) < 1.5e-2, "{budget}");
    assert!(number(&budget["mass_drift"]).abs() < 1e-5, "{budget}");
    let terzaghi = &summary["terzaghi"];
    assert!(number(&terzaghi["max_error"]) < 0.075, "{}", terzaghi["max_error"]);
    assert!(number(&terzaghi["max_settlement_error"]) < 0.03, "{}", terzaghi["max_settlement_error"]);
}
