//! Preparation of samples: compaction to a porosity.

use porograin::case::Case;
use porograin::measure;
use porograin::run::{RunError, Simulation};
use std::path::Path;

fn case(text: &str) -> Case {
    Case::from_text("case.toml", text, Path::new("."), &[]).unwrap()
}

/// A cloud compacted by pistons from five sides.
fn compacting(porosity: f64, steps: u64) -> Case {
    case(&format!(
        r#"
        title = "compaction to a porosity"
        [domain]
        size = [0.02, 0.02, 0.02]
        [grains]
        packing = {{ cloud = {{ count = 300, spread = 0.2, seed = 3, porosity = 0.7 }} }}
        density = 2600.0
        [contact.linear]
        young = 1e6
        stiffness-ratio = 0.5
        friction = 30.0
        [face.all]
        solid = {{ servo = {{ stress = 1000.0 }} }}
        [[stage]]
        name = "compact"
        compact = {{ porosity = {porosity} }}
        until = {{ unbalanced = 2e-2, stress-error = 0.05, max-steps = {steps} }}
        "#
    ))
}

fn run(simulation: &mut Simulation) -> Result<(), RunError> {
    while simulation.advance()?.is_some() {}
    Ok(())
}

/// With its own friction the sample rests looser; friction is lowered until it is at 0.44, and is back then.
#[test]
fn a_sample_is_compacted_to_a_porosity() {
    let case = compacting(0.44, 100_000);
    let mut whole = Simulation::new(&case).unwrap();
    let mut stopped = None;
    while whole.advance().unwrap().is_some() {
        // Half way, friction lowered: to be gone on with.
        if stopped.is_none() && whole.progress.compaction.friction < 0.5 {
            stopped = Some((whole.state.clone(), whole.progress.clone()));
        }
    }
    let porosity = measure::porosity(&whole.state);
    assert!((porosity - 0.44).abs() < 2e-3, "{porosity}");
    let compaction = whole.progress.compaction;
    assert!(compaction.reached && compaction.friction == 1.0 && compaction.lowest < 0.5, "{compaction:?}");
    let friction = whole.model().contact.all.friction();
    assert!((friction - 30.0).abs() < 1e-12, "{friction}");
    // Everything a restart needs is there: the same bits.
    let (state, progress) = stopped.unwrap();
    let mut resumed = Simulation::resume(&case, state, progress);
    run(&mut resumed).unwrap();
    assert_eq!(resumed.state, whole.state);
    assert_eq!(resumed.progress, whole.progress);
}

#[test]
fn a_porosity_out_of_reach_is_told() {
    let mut simulation = Simulation::new(&compacting(0.2, 100_000)).unwrap();
    let told = run(&mut simulation).unwrap_err().to_string();
    assert!(told.contains("the porosity is 0.") && told.contains("asked 0.2"), "{told}");
    assert!(simulation.state.step < 30_000, "it goes on in vain: step {}", simulation.state.step);
    assert!(told.contains("with the friction between grains down to"), "{told}");
}
