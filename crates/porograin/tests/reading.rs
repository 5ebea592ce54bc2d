//! Any text as a case or as a file of grains is read or refused in a sentence, never met with a panic.

use glam::DVec3;
use porograin::case::Case;
use porograin::import;
use proptest::prelude::*;
use std::path::Path;

/// Cases with nearly every key, to be damaged.
const CASES: [&str; 2] = [
    r#"
title = "A column"
gravity = [0.0, { sine = { amplitude = 1.0, period = 0.5 } }, -9.81]
time-step = { automatic = { safety = 0.8 } }
on = { outside = "warn" }
[domain]
size = [0.02, 0.02, 0.04]
[grains]
packing = { cloud = { count = 500, spread = 0.2, seed = 1, porosity = 0.75 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 30.0
restitution = 0.5
adhesion = { tension = 1e3, cohesion = 1e3 }
rolling = { friction = 0.1 }
[material.glass]
part = 1.0
[[pair]]
between = ["glass", "wall"]
contact.hertz-mindlin = { young = 1e7, poisson = 0.2, friction = 5.0 }
[face.top]
solid = { servo = { stress = { ramp = { from = 0.0, to = 500.0, end = 0.01 } } } }
water = { pressure = 0.0 }
[fluid]
viscosity = 1e-3
flow = { pores = { remesh = { strain = 0.01 }, residual = 1e-8, solver = "auto" } }
[[stage]]
name = "settle"
fluid = false
until = { unbalanced = 1e-2, max-steps = 300000 }
[[stage]]
name = "load"
until = { time = 0.05 }
[[watch]]
measures = ["settlement", "porosity"]
every = { seconds = 1e-3 }
"#,
    "# x,y,z,r\n0.1,0.2,0.3,0.01\n0.5,0.5,0.5,1e-2\n\n 0.9 , 0.1 , 0.2 , 0.05\n",
];

/// What takes the place of a piece of text.
fn piece() -> impl Strategy<Value = String> {
    let known = [
        "",
        "\n",
        ",",
        "=",
        ".",
        "[",
        "]",
        "{",
        "}",
        "\"",
        "-",
        "nan",
        "inf",
        "-1",
        "0",
        "1e999",
        "99999999999999999999",
        "true",
        "[[stage]]",
        "contact",
        "\u{0}",
        "é",
    ];
    prop_oneof![4 => prop::sample::select(known.map(String::from).to_vec()), 1 => any::<String>()]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_text_is_read_or_refused(
        which in 0..2usize,
        damage in prop::collection::vec((0.0..1.0f64, 0usize..12, piece()), 0..4),
        key in any::<String>(),
    ) {
        let mut text = CASES[which].to_owned();
        for (place, length, new) in damage {
            let mut bounds: Vec<usize> = text.char_indices().map(|(k, _)| k).collect();
            bounds.push(text.len());
            let from = (place * bounds.len() as f64) as usize;
            let to = (from + length).min(bounds.len() - 1);
            text.replace_range(bounds[from]..bounds[to], &new);
        }
        let read = |text: &str, set: &[String]| Case::from_text("case.toml", text, Path::new("nowhere"), set);
        match read(&text, &[]) {
            Ok(case) => {
                prop_assert!(read(case.text(), &[]).is_ok());
                prop_assert_eq!(case.stages().len(), case.stage.len());
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
        for set in [format!("{key}=1"), format!("grains.density={key}")] {
            if let Err(error) = read(CASES[0], &[set]) {
                prop_assert!(!error.to_string().is_empty());
            }
        }
        match import::spheres("grains.csv", &text) {
            Ok(spheres) => {
                prop_assert!(spheres.radius.iter().all(|r| r.is_finite() && *r > 0.0));
                let _ = spheres.within("grains.csv", &text, DVec3::ZERO, DVec3::ONE);
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn any_text_is_read_or_refused(text in any::<String>()) {
        let case = Case::from_text("case.toml", &text, Path::new("nowhere"), &[]);
        prop_assert!(case.is_err_and(|error| !error.to_string().is_empty()));
        let _ = import::spheres("grains.csv", &text);
    }
}

#[test]
fn the_cases_to_be_damaged_are_sound() {
    Case::from_text("case.toml", CASES[0], Path::new("nowhere"), &[]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(import::spheres("grains.csv", CASES[1]).unwrap().radius.len(), 3);
}
