//! Case files: what is read from them, and what is said of wrong ones.

use porograin::case::Case;
use porograin::{Flow, Signal, Solid, TimeStep, Water};
use std::path::Path;

const GOOD: &str = r#"
title = "Terzaghi consolidation of 5000 grains"
[domain]
size = [0.1, 0.1, 0.1]
[grains]
packing = { cloud = { count = 5000, spread = 0.2, seed = 7 } }
density = 2600.0
[contact.linear]
young = 15e6
stiffness-ratio = 0.5
friction = 30.0                      # degrees
[fluid]
viscosity = 4.0
flow = { pores = { remesh = { strain = 0.01 } } }
[[stage]]
name = "confine"
fluid = false
friction = 3
face.all = { solid = { servo = { stress = { ramp = { from = 0, to = 1e3, end = 0.1 } } } } }
until = { unbalanced = 1e-3, stress-error = 0.01, max-steps = 200000 }
[[stage]]
name = "load"
face.top = { solid = { servo = { stress = 5e3 } }, water = { pressure = 0.0 } }
until = { time = 0.5 }
[[watch]]
measures = ["pressure-profile", "settlement", "porosity", "unbalanced"]
every = { seconds = 1e-3 }
"#;

fn read(text: &str, overrides: &[&str]) -> Result<Case, String> {
    let overrides: Vec<String> = overrides.iter().map(|&s| s.to_owned()).collect();
    Case::from_text("case.toml", text, Path::new("."), &overrides).map_err(|e| e.to_string())
}

fn refused(text: &str, overrides: &[&str]) -> String {
    read(text, overrides).expect_err("the case must be refused")
}

#[test]
fn a_case_becomes_models() {
    let case = read(GOOD, &[]).unwrap();
    let confine = case.model(0, 0.0);
    assert!(confine.fluid.is_none());
    assert_eq!(confine.damping, 0.2);
    let Solid::Servo { stress, .. } = &confine.faces[3].solid else { panic!("{:?}", confine.faces[3]) };
    assert_eq!(*stress, Signal::Ramp { from: 0.0, to: 1e3, start: 0.0, end: 0.1 });
    let load = case.model(1, 2.5);
    assert_eq!(load.stage_start, 2.5);
    assert_eq!(load.damping, 0.0);
    assert_eq!(load.time_step, TimeStep::Automatic { safety: 0.8 });
    // What a stage overrides does not carry over to the next.
    assert_eq!(load.faces[3].solid, Solid::Fixed);
    assert_eq!(load.faces[5].water, Water::Pressure(Signal::Constant(0.0)));
    assert!(matches!(load.faces[5].solid, Solid::Servo { .. }));
    assert_eq!((confine.contact.all.friction(), load.contact.all.friction()), (3.0, 30.0));
    let fluid = load.fluid.unwrap();
    let Flow::Pores(pores) = fluid.flow else { panic!("the flow is that of the pores") };
    assert_eq!((fluid.viscosity, fluid.density, pores.remesh.strain), (4.0, 1000.0, 0.01));
}

#[test]
fn overrides_reach_any_value_and_stand_in_the_text_as_run() {
    let case = read(
        GOOD,
        &[
            "contact.linear.friction=20",
            "stage.load.until.time=0.25",
            "fluid.density=900",
            "title=short",
            "domain.size.2=0.2",
        ],
    )
    .unwrap();
    assert_eq!(case.contact.friction(), 20.0);
    assert_eq!(case.stage[1].until.time, Some(0.25));
    assert_eq!(case.fluid.as_ref().unwrap().density, 900.0);
    assert_eq!((case.title.as_str(), case.domain.size), ("short", [0.1, 0.1, 0.2]));
    assert!(case.text().contains("friction = 20                      # degrees"), "{}", case.text());
    let again = read(case.text(), &[]).unwrap();
    assert_eq!(again.stage[1].until, case.stage[1].until);
}

#[test]
fn wrong_keys_and_types_are_shown_with_a_caret() {
    let shown = refused(&GOOD.replace("young", "yuong"), &[]);
    assert_eq!(
        shown,
        "unknown key `yuong` in `contact.linear`\n --> case.toml:9:1\n  |\n9 | yuong = 15e6\n  | ^^^^^ did you mean \
         young? allowed here: young, stiffness-ratio, friction, restitution, \
         adhesion, rolling, capillary"
    );
    let shown = refused(&GOOD.replace("15e6", "\"stiff\""), &[]);
    assert!(
        shown.starts_with("expected a number, found the text \"stiff\" in `contact.linear`\n -->"),
        "{shown}"
    );
    assert!(shown.ends_with("9 | young = \"stiff\"\n  |         ^^^^^^^"), "{shown}");
    let shown = refused(&GOOD.replace("porosity", "porostiy"), &[]);
    assert!(shown.contains("unknown choice `porostiy`"), "{shown}");
    assert!(shown.contains("did you mean porosity? allowed here: porosity, regions, grading,"), "{shown}");
    let shown = refused(&GOOD.replace("young = 15e6\n", ""), &[]);
    assert!(
        shown.starts_with("the key `young` is missing in `contact.linear`\n --> case.toml:8:"),
        "{shown}"
    );
    let shown = refused(&GOOD.replace("end = 0.1 ", "finish = 0.1 "), &[]);
    assert!(shown.contains("unknown key `finish` in `stage.0.face.all.solid.servo.stress.ramp`"), "{shown}");
    let shown = refused(&GOOD.replace("stress = 5e3", "stress = [1]"), &[]);
    assert!(shown.contains("expected a number, a table such as"), "{shown}");
    let shown = refused(&GOOD.replace("fluid = false", "fluid = { viscosty = 2 }"), &[]);
    assert!(shown.contains("did you mean viscosity?"), "{shown}");
}

#[test]
fn numbers_out_of_range_are_refused_with_their_line() {
    let shown = refused(&GOOD.replace("young = 15e6", "young = -1"), &[]);
    assert!(shown.starts_with("`young` must be greater than 0, not -1\n --> case.toml:9:9\n"), "{shown}");
    let shown = refused(&GOOD.replace("friction = 3\n", "friction = nan\n"), &[]);
    assert!(
        shown.starts_with("`stage.0.friction` is not a finite number\n  --> case.toml:18:12\n"),
        "{shown}"
    );
    let shown = refused(&GOOD.replace("time = 0.5", "time = 0"), &[]);
    assert!(shown.starts_with("`time` must be greater than 0, not 0\n"), "{shown}");
}

#[test]
fn a_wrong_override_is_blamed_and_lines_are_those_of_the_file() {
    let shown = refused(GOOD, &["contact.linear.frction=20"]);
    assert_eq!(
        shown,
        "unknown key `frction` in `contact.linear`\n --> --set\n  |\n  | --set contact.linear.frction=20\n  |       \
         ^^^^^^^^^^^^^^^^^^^^^^^^^ did you mean friction? allowed here: young, stiffness-ratio, friction, restitution, \
         adhesion, rolling, capillary"
    );
    let shown = refused(GOOD, &["contact.linear.friction=much"]);
    assert!(shown.starts_with("expected a number, found the text \"much\""), "{shown}");
    assert!(shown.contains("--set contact.linear.friction=much"), "{shown}");
    let shown = refused(GOOD, &["fluid.viscosity=-1"]);
    assert!(shown.starts_with("`viscosity` must be greater than 0, not -1\n --> --set\n"), "{shown}");
    assert!(refused(GOOD, &["stage.lode.until.time=1"]).starts_with("there is no `stage.lode` to set"));
    assert!(refused(GOOD, &["title.x=1"]).starts_with("`title` is a value, not a table"));
    assert!(refused(GOOD, &["titel"]).starts_with("`--set titel` has no `=`"));
    // The first override adds a line above the fault of the file.
    let shown = refused(&GOOD.replace("young = 15e6", "young = -1"), &["domain.origin=[0,0,1]"]);
    assert!(shown.contains("case.toml:9:9"), "{shown}");
    let shown = refused(&GOOD.replace("young = 15e6", "yuong = 1"), &["domain.origin=[0,0,1]"]);
    assert!(shown.contains("case.toml:9:1"), "{shown}");
}

#[test]
fn tables_that_contradict_each_other_are_refused() {
    let shown = refused(&GOOD.replace(", water = { pressure = 0.0 }", ""), &[]);
    assert!(
        shown.starts_with(
            "in the stage `load` the top wall moves, but the water is incompressible and every face is sealed\n  --> \
             case.toml:23:"
        ),
        "{shown}"
    );
    let shown = refused(&GOOD.replace("until = { time = 0.5 }", "until = { max-time = 0.5 }"), &[]);
    assert!(shown.starts_with("the stage `load` never ends"), "{shown}");
    let shown = refused(&GOOD.replace("\"load\"", "\"confine\""), &[]);
    assert!(shown.starts_with("stages 1 and 2 are both called `confine`"), "{shown}");
}

#[test]
fn grains_of_several_materials_obey_their_own_laws() {
    let more = r#"
[material.glass]
part = 0.75
[material.steel]
part = 0.25
density = 7800.0
[[pair]]
between = ["steel", "glass"]
contact.hertz-mindlin = { young = 7e9, poisson = 0.2, friction = 12.0 }
[[pair]]
between = ["wall", "steel"]
contact.linear = { young = 1e6, stiffness-ratio = 0.5, friction = 7.0 }
"#;
    let plan = read(&format!("{GOOD}{more}"), &[]).unwrap().plan().unwrap();
    let grains = &plan.state.grains;
    let steel: Vec<usize> = (0..grains.len()).filter(|&k| grains.material[k] == 1).collect();
    assert_eq!(steel.len(), (0.25 * grains.len() as f64).round() as usize);
    let density = |k: usize| grains.mass[k] / porograin::grains::sphere_volume(grains.radius[k]);
    assert!(steel.iter().all(|&k| (density(k) - 7800.0).abs() < 1e-9));
    let glass = (0..grains.len()).find(|&k| grains.material[k] == 0).unwrap();
    assert!((density(glass) - 2600.0).abs() < 1e-9);

    let laws = &plan.stages[1].model.contact;
    let friction = |pair: [u32; 2]| laws.own(grains, pair).map(|law| law.friction());
    let (steel, glass, wall) = (steel[0] as u32, glass as u32, porograin_geometry::triangulation::FIRST_WALL);
    assert_eq!(friction([glass, steel]), Some(12.0));
    assert_eq!(friction([steel, glass]), Some(12.0));
    assert_eq!(friction([steel, wall]), Some(7.0));
    assert_eq!((friction([glass, wall]), friction([glass, glass])), (None, None));
    // The friction of a stage holds for all of them.
    let confine = &plan.stages[0].model.contact;
    assert!(confine.iter().all(|law| law.friction() == 3.0));
}

#[test]
fn gravity_may_tilt_during_a_stage() {
    let tilt = "gravity=[{ ramp = { from = 0, to = 5, end = 1e-2 } }, 0, -9.81]";
    let case =
        read(GOOD, &[tilt, "time-step={ fixed = 1e-6 }", "stage.confine.until={ steps = 200 }"]).unwrap();
    let mut simulation = porograin::run::Simulation::new(&case).unwrap();
    let mut weight = porograin::run::Simulation::new(&read(case.text(), &["gravity.0=0"]).unwrap()).unwrap();
    for _ in 0..200 {
        simulation.advance().unwrap();
        weight.advance().unwrap();
    }
    // A grain in flight has the speed that the ramp gives, `5 t²/2 / 10 ms`, half a step before; damping takes a fifth.
    let flying = |s: &porograin::run::Simulation, k: usize| s.state.grains.velocity[k];
    let t = 199.5e-6;
    let expected = 0.8 * 0.5 * 500.0 * t * t;
    let close = (0..5000).filter(|&k| {
        let gained = flying(&simulation, k).x - flying(&weight, k).x;
        (gained / expected - 1.0).abs() < 0.01
    });
    assert!(close.count() > 4000);
    assert!(read(GOOD, &["gravity=[0, { sine = { amplitude = 1, period = 0 } }, 0]"]).is_err());
}
