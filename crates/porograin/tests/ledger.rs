//! The budget of the energy closes.

use porograin::State;
use porograin::case::Case;
use porograin::ledger::Ledger;

use porograin::progress::Progress;
use porograin::run::Simulation;
use std::path::Path;

/// 100 grains under gravity thrown together by pistons, then pressed slowly from above; whether contacts conserve the energy in the two.
fn case(law: &str, safety: f64, conserving: [bool; 2]) -> Case {
    let [first, second] = conserving;
    let case = format!(
        r#"
        title = "budget"
        gravity = [0.0, 0.0, -9.81]
        time-step = {{ automatic = {{ safety = {safety} }} }}
        [domain]
        size = [0.02, 0.02, 0.02]
        [grains]
        packing = {{ cloud = {{ count = 100, spread = 0.2, seed = 3, porosity = 0.7 }} }}
        density = 2600.0
        {law}
        [face.all]
        friction = 20.0
        [face.bottom]
        solid = "fixed"
        [[stage]]
        name = "press"
        conserve-energy = {first}
        face.all.solid = {{ servo = {{ stress = 1000.0 }} }}
        until = {{ unbalanced = 1e-2, stress-error = 0.02, max-steps = 2000000 }}
        [[stage]]
        name = "shear"
        conserve-energy = {second}
        face.top.solid = {{ moving = {{ velocity = [0.0, 0.0, -0.01] }} }}
        face.sides.solid = {{ servo = {{ stress = 1000.0 }} }}
        until = {{ time = 0.03 }}
        [[watch]]
        measures = ["energy-budget"]
        every = {{ steps = 1000 }}
        "#
    );
    Case::from_text("case.toml", &case, Path::new("."), &[]).unwrap()
}

/// The ledgers at the ends of the two stages.
fn ledgers(case: &Case) -> [Ledger; 2] {
    let mut simulation = Simulation::new(case).unwrap();
    let mut ends = [Ledger::default(); 2];
    while simulation.advance().unwrap().is_some() {
        if simulation.progress.began.is_none() {
            ends[simulation.progress.stage - 1] = simulation.progress.ledger.unwrap();
        }
    }
    ends
}

const LINEAR: &str = "[contact.linear]\nyoung = 1e6\nstiffness-ratio = 0.5\nfriction = 30.0";
const DAMPED: &str = "restitution = 0.3\nrolling = { friction = 0.1 }";
const BONDED: &str = "adhesion = { tension = 1e3, cohesion = 1e3, renew = true }";
const WET: &str = "capillary = { volume = 1e-12, surface-tension = 0.07 }";
const HERTZ: &str = "[contact.hertz-mindlin]\nyoung = 2e7\npoisson = 0.3\nfriction = 30.0";

#[test]
fn the_budget_closes_to_a_millionth_in_slow_loading_and_with_the_square_of_the_step_in_collisions() {
    for law in [LINEAR, &format!("{LINEAR}\n{DAMPED}"), HERTZ] {
        let [coarse, fine] = [0.4, 0.1].map(|safety| ledgers(&case(law, safety, [false; 2])));
        let part = |ledger: &Ledger| (ledger.integration / ledger.input()).abs();
        assert!(part(&fine[1]) < 1e-6, "slow loading: {:e} of {:?}", part(&fine[1]), fine[1]);
        // A quarter of the step: a sixteenth of the error.
        let (before, after) = (part(&coarse[0]), part(&fine[0]));
        assert!(before < 2e-3 && after < before / 8.0, "collisions: {before:e}, {after:e}");
        // With what the integration of the contacts lost, the budget closes to round-off at any step.
        for ledger in coarse.iter().chain(&fine) {
            assert!(ledger.error().abs() < 1e-10 * ledger.input(), "{:e} of {ledger:?}", ledger.error());
        }
        // Nothing is small that should be there.
        for lost in [fine[0].friction, fine[0].damping, fine[0].gravity, fine[0].walls] {
            assert!(lost > 0.01 * fine[0].input(), "{:?}", fine[0]);
        }
        let viscous = fine[0].viscous / fine[0].input();
        assert!(if law.contains("restitution") { viscous > 0.01 } else { viscous.abs() < 1e-12 });
    }
}

/// At the default step, under every law, in collisions and in slow loading; also when it begins with contacts that are there already.
#[test]
fn the_budget_closes_to_a_millionth_at_the_default_step_where_contacts_conserve_the_energy() {
    let with = |more: &str| format!("{LINEAR}\n{more}");
    for law in [LINEAR.to_owned(), with(DAMPED), with(BONDED), with(WET), HERTZ.to_owned()] {
        for first in [true, false] {
            let ends = ledgers(&case(&law, 0.8, [first, true]));
            for ledger in &ends[usize::from(!first)..] {
                let lost = ledger.integration / ledger.input();
                assert!(lost.abs() < 1e-7, "{law}: {lost:e} of {ledger:?}");
                assert!(ledger.error().abs() < 1e-10 * ledger.input(), "{:e} of {ledger:?}", ledger.error());
            }
            let lost = ends[0].integration / ends[0].input();
            assert!(first || lost.abs() > 1e-5, "{law}: {lost:e} of {:?}", ends[0]);
        }
    }
}

/// Grains in a periodic cell, and grains in a membrane pressed by a plate: the budget closes there as well.
#[test]
fn the_budget_closes_in_a_cell_and_in_a_membrane() {
    let grains = r#"
        [grains]
        packing = { cloud = { count = 100, spread = 0.2, seed = 3, porosity = 0.7 } }
        density = 2600.0
        [[watch]]
        measures = ["energy-budget"]
        every = { steps = 1000 }
        "#;
    let cell = r#"
        title = "cell"
        [domain]
        size = [0.0083, 0.0083, 0.0083]
        periodic = "xyz"
        [[stage]]
        name = "press"
        cell = { stress = { xx = 1000.0, yy = 1000.0, zz = 1000.0 } }
        until = { time = 0.05 }
        [[stage]]
        name = "shear"
        cell = { gradient = { xz = 2.0, yx = -1.0 }, stress = { zz = 1000.0 } }
        until = { time = 0.05 }
        "#;
    let channel = r#"
        title = "channel"
        gravity = [3.0, 0.0, -9.81]
        [domain]
        size = [0.0083, 0.0083, 0.0083]
        periodic = "xy"
        [[stage]]
        name = "press"
        cell = { stress = { xx = 1000.0 } }
        face.bottom.solid = { servo = { stress = 1000.0 } }
        face.top.solid = { servo = { stress = 1000.0 } }
        until = { time = 0.05 }
        [[stage]]
        name = "shear"
        cell = { gradient = { xx = 0.5, xy = 1.0 } }
        face.bottom.solid = "fixed"
        face.top.solid = { moving = { velocity = [0.01, 0.0, -0.01] } }
        until = { time = 0.03 }
        "#;
    let membrane = r#"
        title = "membrane"
        [domain]
        size = [0.0139, 0.0139, 0.0139]
        [[stage]]
        name = "press"
        face.all.solid = { servo = { stress = 1000.0 } }
        until = { time = 0.05 }
        [[stage]]
        name = "shear"
        membrane = { stress = 1000.0 }
        face.sides.solid = "fixed"
        face.top.solid = { moving = { velocity = [0.0, 0.0, -0.01] } }
        until = { time = 0.03 }
        "#;
    for law in [LINEAR, HERTZ] {
        for (place, who) in [(cell, 0), (channel, 1), (membrane, 2)] {
            for conserving in [false, true] {
                let text = format!("conserve-energy = {conserving}\n{place}{grains}{law}");
                let case = Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap();
                let ends = ledgers(&case);
                for ledger in &ends {
                    let [error, lost] =
                        [ledger.error(), ledger.integration].map(|e| e.abs() / ledger.input());
                    assert!(error < 1e-10, "{who}: {error:e} of {ledger:?}");
                    assert!(!conserving || lost < 1e-7, "{who}: {lost:e} of {ledger:?}");
                }
                let came = [ends[1].cell, ends[1].cell, ends[1].membrane][who];
                assert!(came.abs() > 0.01 * ends[1].input(), "{who}: {:?}", ends[1]);
            }
        }
    }
}

#[test]
fn a_resumed_run_keeps_the_same_ledger() {
    let case = case(LINEAR, 0.8, [false, true]);
    let mut whole = Simulation::new(&case).unwrap();
    let mut stopped = None;
    while whole.advance().unwrap().is_some() {
        if whole.progress.stage == 1 && stopped.is_none() && whole.state.step % 97 == 0 {
            stopped = Some((whole.state.clone(), whole.progress.clone()));
        }
    }
    let (state, progress): (State, Progress) = stopped.unwrap();
    assert!(state.contacts.iter().any(|(_, memory)| memory.account.surplus != 0.0));
    let mut resumed = Simulation::resume(&case, state, progress);
    while resumed.advance().unwrap().is_some() {}
    assert_eq!(resumed.progress, whole.progress);
    assert!(resumed.state == whole.state);
}

/// In a drum that turns, whose wall goes another way wherever a grain is.
#[test]
fn the_budget_closes_in_a_drum() {
    let text = r#"
        title = "drum"
        gravity = [0.0, 0.0, -9.81]
        conserve-energy = true
        [domain]
        size = [0.03, 0.012, 0.03]
        [grains]
        packing = { cloud = { count = 100, spread = 0.2, seed = 3, radius = 0.6e-3, within = [[0.006, 0.0, 0.006], [0.024, 0.012, 0.024]] } }
        density = 2600.0
        [contact.linear]
        young = 1e6
        stiffness-ratio = 0.5
        friction = 30.0
        [[wall]]
        name = "drum"
        shape = { cylinder = { point = [0.015, 0.0, 0.015], axis = [0.0, 1.0, 0.0], radius = 0.0149 } }
        motion = { rotating = { point = [0.015, 0.0, 0.015], axis = [0.0, 1.0, 0.0], rate = 10.0 } }
        friction = 30.0
        [[stage]]
        name = "fall"
        until = { time = 0.05 }
        [[stage]]
        name = "turn"
        until = { time = 0.1 }
        [[watch]]
        measures = ["energy-budget"]
        every = { steps = 1000 }
        "#;
    let case = Case::from_text("case.toml", text, Path::new("."), &[]).unwrap();
    for ledger in ledgers(&case) {
        let [error, lost] = [ledger.error(), ledger.integration].map(|e| e.abs() / ledger.input());
        assert!(error < 1e-10 && lost < 1e-7, "{error:e} {lost:e} of {ledger:?}");
        assert!(ledger.walls > 0.01 * ledger.input(), "{ledger:?}");
    }
}

/// The example `25-energy-budget`, as it is and without: what its page says is lost.
#[test]
fn nothing_is_missing_in_the_example() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/25-energy-budget/case.toml");
    let [conserving, plain] = ["true", "false"]
        .map(|value| ledgers(&Case::from_file(&file, &[format!("conserve-energy={value}")]).unwrap()));
    for ledger in conserving.iter().chain(&plain) {
        assert!(ledger.error().abs() < 1e-12 * ledger.input(), "{:e} of {ledger:?}", ledger.error());
    }
    for ledger in &conserving {
        assert!(ledger.integration.abs() < 1e-9 * ledger.input(), "{ledger:?}");
    }
    let lost = plain.map(|ledger| ledger.integration / ledger.input());
    assert!(lost[0] > 1e-3 && lost[0] < 1e-2 && lost[1].abs() > 1e-6, "{lost:?}");
}
