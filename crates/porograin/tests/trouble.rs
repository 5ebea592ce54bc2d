//! Signs of trouble are noticed, named, and heeded as the case asks.

use porograin::case::Case;
use porograin::run::{RunError, Simulation};
use porograin::servo::{Held, Servo};
use porograin::trouble::{Other, Trouble};
use std::path::Path;

/// One grain between two walls, of which the top does what `top` says.
fn squeezed(top: &str, until: &str, more: &str) -> Simulation {
    squeezed_with(top, until, more, "")
}

fn squeezed_with(top: &str, until: &str, more: &str, walls: &str) -> Simulation {
    let text = format!(
        r#"
title = "One grain in a box"
{more}
[domain]
size = [0.02, 0.02, 0.02]
[grains]
packing = {{ lattice = {{ count = [1, 1, 1], radius = 0.01 }} }}
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[face.top]
solid = {top}
[[stage]]
name = "squeeze"
until = {until}
{walls}
"#
    );
    let case = Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
    Simulation::new(&case).unwrap()
}

/// All that is told until the end, or the error.
fn told(mut simulation: Simulation) -> Result<Vec<Trouble>, RunError> {
    let mut all = Vec::new();
    while simulation.advance()?.is_some() {
        all.extend_from_slice(simulation.news());
    }
    Ok(all)
}

const DOWN: &str = "{ moving = { velocity = [0.0, 0.0, -1.0] } }";

#[test]
fn deep_overlaps_are_told_once() {
    let run =
        |on: &str| told(squeezed(DOWN, "{ time = 0.013 }", &format!("time-step = {{ fixed = 1e-5 }}\n{on}")));
    let all = run("").unwrap();
    let [Trouble::DeepOverlap { grain: 0, other: Other::Wall(_), part, time }] = all[..] else {
        panic!("{all:?}")
    };
    // Both walls share what the box has lost, so that the half radius is reached at 10 ms.
    assert!((0.5..0.6).contains(&part) && (0.01..0.013).contains(&time), "{part} {time}");
    let text = all[0].to_string();
    assert!(text.starts_with("grain 0 overlaps the ") && text.contains("too soft"), "{text}");
    assert_eq!(run("on = { deep-overlap = \"ignore\" }").unwrap(), []);
    let stopped = run("on = { deep-overlap = \"stop\" }").unwrap_err();
    assert!(matches!(&stopped, RunError::Trouble { trouble: Trouble::DeepOverlap { .. }, .. }));
    assert!(stopped.to_string().starts_with("in the stage `squeeze`, grain 0 overlaps"), "{stopped}");
}

#[test]
fn a_grain_outside_stops_the_run_unless_the_case_can_do_without() {
    let fast = "{ moving = { velocity = [0.0, 0.0, -500.0] } }";
    let run =
        |on: &str| told(squeezed(fast, "{ time = 3e-5 }", &format!("time-step = {{ fixed = 1e-6 }}\n{on}")));
    let stopped = run("").unwrap_err().to_string();
    assert!(stopped.contains("the centre of grain 0 passed through the top face at t = "), "{stopped}");
    let all = run("on = { outside = \"warn\", deep-overlap = \"ignore\" }").unwrap();
    assert!(matches!(all[..], [Trouble::Outside { grain: 0, face: 5, .. }]), "{all:?}");
}

#[test]
fn a_fixed_step_beyond_the_limit_is_told_with_the_limit() {
    let run = |step: f64| {
        told(squeezed("\"fixed\"", "{ steps = 3 }", &format!("time-step = {{ fixed = {step:e} }}"))).unwrap()
    };
    let all = run(1.0);
    let [Trouble::LongStep { step: 1.0, limit, .. }] = all[..] else { panic!("{all:?}") };
    assert!(run(0.99 * limit.seconds).is_empty());
    assert_eq!(run(1.01 * limit.seconds).len(), 1);
}

#[test]
fn a_servo_off_its_stress_at_the_end_is_told() {
    let servo = "{ servo = { stress = 100.0 } }";
    let all = told(squeezed(servo, "{ steps = 5 }", "")).unwrap();
    let [Trouble::Servo { held: Held { servo: Servo::Face(5), asked: 100.0, found, .. }, .. }] = all[..]
    else {
        panic!("{all:?}")
    };
    assert!(found < 90.0);
    let all =
        told(squeezed(servo, "{ stress-error = 0.01, unbalanced = 0.01, max-steps = 100000 }", "")).unwrap();
    assert_eq!(all, []);
}

/// A cloud in a periodic cell of which `cell` is asked, until `until`.
fn cell(cell: &str, until: &str) -> Result<Vec<Trouble>, RunError> {
    let text = format!(
        r#"
title = "A periodic sample"
[domain]
size = [0.02, 0.02, 0.02]
periodic = "xyz"
[grains]
packing = {{ cloud = {{ count = 150, spread = 0.2, seed = 1 }} }}
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 30.0
[cell]
{cell}
[[stage]]
name = "squeeze"
until = {until}
"#
    );
    let case = Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}"));
    told(Simulation::new(&case).unwrap())
}

#[test]
fn a_cell_off_its_stress_at_the_end_is_told() {
    let all = cell("stress = { xx = 1e3, yy = 1e3, zz = 1e3 }\nrate = 0.1", "{ steps = 20 }").unwrap();
    let [Trouble::Servo { held: Held { servo: Servo::Cell(_), asked: 1e3, .. }, .. }] = all[..] else {
        panic!("{all:?}")
    };
    let text = all[0].to_string();
    assert!(
        text.contains(" of the cell is 0.000e0 Pa at t = ") && text.contains("nothing touches it"),
        "{text}"
    );
}

/// A shear stress of zero is met when it is small beside the stress of the sample: a part of zero it never is.
#[test]
fn shear_stresses_held_at_zero_are_met() {
    let stress = "stress = { xx = 1e3, yy = 1e3, zz = 1e3, xy = 0.0, yz = 0.0, xz = 0.0 }";
    let all = cell(stress, "{ unbalanced = 2e-2, stress-error = 0.02, max-steps = 20000 }").unwrap();
    assert_eq!(all, []);
    let held = |shear: &str| {
        let stress = stress.replace("xz = 0.0", shear);
        cell(&stress, "{ unbalanced = 2e-2, stress-error = 0.02, max-steps = 3000 }").unwrap_err().to_string()
    };
    let text = held("xz = -2e3");
    assert!(text.contains("the stress xz of the cell is off by "), "{text}");
}

/// Each sign stops the run where the case asks for it, named with its place, time and likely cause, and is not told where it is to be ignored.
#[test]
fn every_sign_stops_or_keeps_quiet_by_choice() {
    let plate = r#"
[[wall]]
name = "plate"
shape = { rectangle = { corner = [0.0, 0.0, 0.0199], edges = [[0.02, 0.0, 0.0], [0.0, 0.02, 0.0]] } }
motion = { servo = { along = [0.0, 0.0, -1.0], load = { force = 5.0 }, speed = 1e-6 } }
"#;
    let servo = "{ servo = { stress = 100.0 } }";
    for (key, top, until, more, words) in [
        (
            "outside",
            "{ moving = { velocity = [0.0, 0.0, -500.0] } }",
            "{ time = 3e-5 }",
            "time-step = { fixed = 1e-6 }",
            "the centre of grain 0 passed",
        ),
        ("deep-overlap", DOWN, "{ time = 0.013 }", "time-step = { fixed = 1e-5 }", "grain 0 overlaps the "),
        (
            "long-step",
            "\"fixed\"",
            "{ steps = 3 }",
            "time-step = { fixed = 1.0 }",
            "is longer than the stability limit",
        ),
        ("servo", servo, "{ steps = 5 }", "", "the stress on the top wall is "),
        ("servo", "\"fixed\"", "{ steps = 5 }", plate, "the force on the wall `plate` is "),
    ] {
        let run = |what: &str| {
            let others = if key == "deep-overlap" { "" } else { "deep-overlap = \"ignore\", " };
            let on = format!("on = {{ {others}{key} = \"{what}\" }}");
            let (walls, step) = if more.contains("[[wall]]") { (more, "") } else { ("", more) };
            told(squeezed_with(top, until, &format!("{step}\n{on}"), walls))
        };
        let stopped = run("stop").unwrap_err();
        let text = stopped.to_string();
        assert!(matches!(stopped, RunError::Trouble { .. }) && text.contains(words), "{key}: {text}");
        assert!(text.contains("in the stage `squeeze`") && text.contains("at t = "), "{key}: {text}");
        let warned = run("warn").unwrap();
        assert!(warned.len() == 1 && warned[0].to_string().contains(words), "{key}: {warned:?}");
        assert_eq!(run("ignore").unwrap(), [], "{key}");
    }
}

/// A formula that loses its value on the way stops the run in its own name, before it spoils the sample.
#[test]
fn a_formula_without_a_value_stops_the_run() {
    let top = "{ moving = { velocity = [0.0, 0.0, \"-0.01*sqrt(1e-3 - t)\"] } }";
    let stopped = told(squeezed(top, "{ time = 0.01 }", "time-step = { fixed = 1e-5 }")).unwrap_err();
    let RunError::Undefined { time, .. } = stopped else { panic!("{stopped}") };
    assert!((time - 1e-3).abs() < 2.1e-5, "{time}");
    let text = stopped.to_string();
    assert!(
        text.starts_with("in the stage `squeeze`, the velocity of the top wall has no finite value "),
        "{text}"
    );
    assert!(cell("gradient = { xz = \"log(1e-3 - t)\" }", "{ time = 0.01 }").is_err_and(|error| {
        error.to_string().contains("the gradient xz of the cell has no finite value")
    }));
}

/// Contacts so stiff that a step does not advance time would keep a run going for ever.
#[test]
fn time_that_stands_still_stops_the_run() {
    let mut simulation = squeezed("\"fixed\"", "{ time = 0.01 }", "time-step = { fixed = 1e-9 }");
    simulation.state.time = 1e9;
    let stopped = told(simulation).unwrap_err();
    assert!(matches!(stopped, RunError::Still { dt: 1e-9, time: 1e9, .. }), "{stopped}");
    assert!(stopped.to_string().contains("time stands still at t = 1.000000e9 s"), "{stopped}");
}
