//! The bed of `examples/04-seabed-pressure` and the numbers of its README.

// The tests draw no pictures.
#[allow(dead_code)]
#[path = "../examples/seabed_pressure.rs"]
mod seabed;

use seabed::run;

/// Root mean square and largest error over the mean pressure, and water entering over theory, of every bed whose wave is not
/// at its node.
fn errors(overrides: &[&str]) -> Vec<[f64; 3]> {
    let beds = run(overrides).into_iter().filter(|bed| bed.wave.abs() > 0.5);
    beds.map(|bed| [bed.error()[0], bed.error()[1], bed.entering()]).collect()
}

#[test]
fn a_small_bed_has_the_analytic_field() {
    for bed in run(&["grains.packing.cloud.count=1000"]) {
        let [mean, worst] = bed.error();
        assert!(mean < 0.035 * bed.wave.abs() + 1e-5, "t = {}: {mean}", bed.time);
        assert!(worst < 0.13 * bed.wave.abs() + 1e-4, "t = {}: {worst}", bed.time);
    }
    // The field is in step with the wave: its errors scale with it, and the flow too.
    let seen = errors(&["grains.packing.cloud.count=1000", "stage.wave.until.steps=5"]);
    assert_eq!(seen.len(), 4);
    assert!(seen.iter().all(|[.., entering]| (entering - 1.065).abs() < 0.005), "{seen:?}");
}

#[test]
fn the_numbers_of_the_readme() {
    let [mean, worst, entering] = errors(&["stage.wave.until.steps=1"])[0];
    assert!((mean - 0.029).abs() < 0.001, "{mean}");
    assert!((worst - 0.101).abs() < 0.003, "{worst}");
    assert!((entering - 0.998).abs() < 0.003, "{entering}");
}
