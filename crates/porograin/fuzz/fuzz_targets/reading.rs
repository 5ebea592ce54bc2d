//! `cargo +nightly fuzz run reading` in crates/porograin: any text as a case and as a file of grains; never a panic or a hang.
//! Copies of the cases in `bad/` and `examples/` make a good corpus.
#![no_main]

use glam::DVec3;
use libfuzzer_sys::fuzz_target;
use porograin::case::Case;
use porograin::import;
use std::path::Path;

fuzz_target!(|text: &str| {
    if let Ok(case) = Case::from_text("case.toml", text, Path::new("nowhere"), &[]) {
        // What was accepted is accepted again, as it would be on resuming.
        assert!(Case::from_text("case.toml", case.text(), Path::new("nowhere"), &[]).is_ok());
        case.stages();
    }
    if let Ok(spheres) = import::spheres("grains.csv", text) {
        let _ = spheres.within("grains.csv", text, DVec3::ZERO, DVec3::ONE);
    }
});
