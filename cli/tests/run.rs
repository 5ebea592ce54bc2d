//! Whole runs through the command line: what they leave behind, killed and resumed, with one and two threads.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const CASE: &str = r#"
title = "Grains of a lattice fall and settle"
gravity = [0.3, 0.2, -9.81]
[domain]
size = [0.01, 0.01, 0.012]
[grains]
packing = { lattice = { count = [4, 4, 5], radius = 1e-3 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[face.top]
solid = { servo = { stress = 100.0 } }
[[stage]]
name = "fall"
until = { time = 0.05 }
[[stage]]
name = "hold"
gravity = [0, 0, -9.81]
until = { steps = 40000 }
[[watch]]
measures = ["porosity", "settlement", "face-stress", "contacts", "kinetic-energy"]
every = { steps = 50 }
[[watch]]
measures = ["size"]
every = { seconds = 0.01 }
[output]
vtk = { seconds = 0.05 }
checkpoint = 0.01
"#;

/// The same with water: compacted, filled, loaded, compared with theory, the mesh renewed on the way.
const WET: &str = r#"
title = "A small saturated sample"
[domain]
size = [0.01, 0.01, 0.01]
[grains]
packing = { cloud = { count = 120, spread = 0.2, seed = 3 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[fluid]
viscosity = 2.0
flow = { pores = { remesh = { strain = 0.002 } } }
[[stage]]
name = "confine"
fluid = false
friction = 2.0
face.all.solid.servo.stress = 2e3
until = { unbalanced = 1e-2, stress-error = 0.02, max-steps = 100000 }
[[stage]]
name = "load"
consolidation = true
face.top = { solid = { servo = { stress = 4e3 } }, water = { pressure = 0.0 } }
face.bottom.water.pressure = 0.0
until = { steps = 1500 }
[[watch]]
measures = ["settlement", "pressure-profile", "pressure", "outflow", "face-stress", "stress", "unbalanced"]
every = { steps = 20 }
[output]
vtk = { steps = 500 }
network = true
checkpoint = 0.01
[[field]]
name = "axis"
at = { line = { from = [0.005, 0.005, 0.0], to = [0.005, 0.005, 0.01], count = 11 } }
every = { steps = 100 }
"#;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("run").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("tiny.toml"), CASE).unwrap();
    fs::write(folder.join("wet.toml"), WET).unwrap();
    folder
}

fn start(folder: &Path, arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(arguments)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Runs to the end; standard output and standard error.
fn finish(folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = start(folder, arguments).wait_with_output().unwrap();
    let (stdout, stderr) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {stderr}");
    (stdout, stderr)
}

/// Every file of a run that must not depend on when it was computed, with its bytes.
fn results(run: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<PathBuf> = fs::read_dir(run.join("vtk")).unwrap().map(|e| e.unwrap().path()).collect();
    files.extend(["case.toml", "history.csv", "checkpoint"].map(|name| run.join(name)));
    files.extend([run.join("field-axis.csv")].into_iter().filter(|file| file.exists()));
    files.sort();
    files
        .into_iter()
        .map(|f| (f.file_name().unwrap().to_string_lossy().into(), fs::read(&f).unwrap()))
        .collect()
}

#[track_caller]
fn same(a: &Path, b: &Path) {
    let (a, b) = (results(a), results(b));
    let names = |list: &[(String, Vec<u8>)]| list.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    for (x, y) in a.iter().zip(&b) {
        assert!(x.1 == y.1, "{} differs", x.0);
    }
}

/// Runs `case` whole, and again killed at many moments and resumed, with the threads changing from sitting to sitting.
fn killed_and_resumed(name: &str, case: &str, longest: u64) -> PathBuf {
    let folder = folder(name);
    finish(&folder, &["run", case, "--out", "whole", "--quiet", "--threads", "1"]);
    let broken = folder.join("broken");
    let mut pause = 1u64;
    let mut kill_soon = |arguments: &[&str]| {
        let mut child = start(&folder, arguments);
        while !broken.join("checkpoint").exists() && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // A fixed list of pauses, as good as random for where in the run they fall.
        pause = pause * 37 % (longest + 1);
        std::thread::sleep(Duration::from_millis(pause));
        let running = child.try_wait().unwrap().is_none();
        child.kill().unwrap();
        child.wait().unwrap();
        usize::from(running)
    };
    let mut kills = kill_soon(&["run", case, "--out", "broken", "--quiet"]);
    for threads in ["1", "2", "1", "2", "1", "2", "1", "2"] {
        kills += kill_soon(&["resume", "broken", "--quiet", "--threads", threads]);
    }
    assert!(kills >= 2, "the runs were over before they could be killed");
    finish(&folder, &["resume", "broken"]);
    same(&folder.join("whole"), &broken);
    folder
}

/// Every key of the object is named in the documents.
#[track_caller]
fn documented(value: &serde_json::Value) {
    let document =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/output.md")).unwrap();
    let mut left = vec![value];
    while let Some(value) = left.pop() {
        match value {
            serde_json::Value::Array(all) => left.extend(all.first()),
            serde_json::Value::Object(all) => {
                for (key, inner) in all {
                    assert!(document.contains(&format!("`{key}`")), "docs/output.md says nothing of `{key}`");
                    if key != "phases" {
                        left.push(inner);
                    }
                }
            }
            _ => {}
        }
    }
}

#[test]
fn killed_anywhere_and_resumed_gives_the_same_bytes() {
    killed_and_resumed("killed", "tiny.toml", 100);
}

#[test]
fn killed_with_water_and_resumed_gives_the_same_bytes_and_the_same_picture() {
    let folder = killed_and_resumed("killed-wet", "wet.toml", 400);
    let picture = |run: &str| fs::read(folder.join(run).join("consolidation.svg")).unwrap();
    assert!(picture("whole") == picture("broken"));
    let summary = fs::read_to_string(folder.join("broken/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    for key in ["pores", "throats", "permeability", "oedometric_modulus"] {
        assert!(summary["sample"][key].as_f64().unwrap() > 0.0, "{key}");
    }
    assert!(summary["terzaghi"]["max_error"].is_number());
    documented(&summary);
}

#[test]
fn one_and_two_threads_give_the_same_bytes() {
    let folder = folder("threads");
    finish(&folder, &["run", "tiny.toml", "--out", "one", "--threads", "1"]);
    finish(&folder, &["run", "tiny.toml", "--out", "two", "--threads", "2"]);
    same(&folder.join("one"), &folder.join("two"));
}

#[test]
fn stopping_at_a_time_and_going_on_gives_the_same_bytes() {
    let folder = folder("until");
    finish(&folder, &["run", "tiny.toml", "--out", "whole"]);
    let (_, said) = finish(&folder, &["run", "tiny.toml", "--out", "parts", "--until", "0.03"]);
    assert!(said.contains("go on with: porograin resume parts"), "{said}");
    let (stdout, _) = finish(&folder, &["resume", "parts", "--until", "0.06", "--json"]);
    let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(object["ended"], "until");
    assert_eq!(object["summary"]["stages"][0]["ended"], "time");
    assert_eq!(object["summary"]["stages"][1]["ended"], "running");
    finish(&folder, &["resume", "parts"]);
    same(&folder.join("whole"), &folder.join("parts"));
}

#[cfg(unix)]
#[test]
fn asked_to_stop_it_saves_and_says_how_to_go_on() {
    let folder = folder("interrupted");
    finish(&folder, &["run", "tiny.toml", "--out", "whole"]);
    // Long enough that it cannot be over before it is asked to stop.
    let long = ["run", "tiny.toml", "--out", "long", "--set", "stage.hold.until.steps=100000000"];
    let child = start(&folder, &long);
    while !folder.join("long/checkpoint").exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(50));
    let asked = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(asked.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("error: interrupted at t = "), "{said}");
    assert!(said.contains("go on with: porograin resume long"), "{said}");
}

#[test]
fn a_run_leaves_what_the_contract_says() {
    let folder = folder("contract");
    let (stdout, stderr) =
        finish(&folder, &["run", "tiny.toml", "--set", "contact.linear.friction=25", "--quiet", "--json"]);
    assert_eq!(stderr, "");
    let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((&object["out"], &object["ended"]), (&"out/tiny".into(), &"finished".into()));
    let run = folder.join("out/tiny");
    let read = |name: &str| fs::read_to_string(run.join(name)).unwrap();
    let case = read("case.toml");
    assert!(case.starts_with(&format!("# Run by porograin {}.\n", env!("CARGO_PKG_VERSION"))), "{case}");
    assert!(case.contains("friction = 25\n"), "{case}");
    let summary: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(summary, object["summary"]);
    assert_eq!((&summary["finished"], &summary["stages"][1]["steps"]), (&true.into(), &40000.into()));
    assert!(summary["stages"][0]["phases"]["contact"].as_f64().unwrap() > 0.0);
    let history = read("history.csv");
    let rows: Vec<Vec<&str>> = history.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()));
    assert_eq!(rows[0][..4], ["stage", "step [-]", "time [s]", "porosity [-]"]);
    assert_eq!(rows[1][..2], ["fall", "1"]);
    let frames = fs::read_dir(run.join("vtk")).unwrap().count();
    assert!(read("vtk/grains.pvd").matches("<DataSet").count() == frames - 1 && frames > 3);
}

#[test]
fn a_run_keeps_its_grain_file_and_can_be_run_again_from_its_folder() {
    let folder = folder("grains");
    let grains = "x,y,z,r\n0.003,0.003,0.003,0.001\n0.006,0.003,0.003,0.001\n";
    fs::create_dir_all(folder.join("from here")).unwrap();
    fs::write(folder.join("from here/two grains.csv"), grains).unwrap();
    let packing = "--set=grains.packing={ file = \"from here/two grains.csv\" }";
    let short = ["--set=stage.fall.until.time=0.001", "--set=stage.hold.until.steps=5"];
    finish(&folder, &["run", "tiny.toml", packing, short[0], short[1], "--out", "first"]);
    fs::remove_dir_all(folder.join("from here")).unwrap();
    finish(&folder, &["run", "first/case.toml", "--out", "second"]);
    same(&folder.join("first"), &folder.join("second"));
    // Into the folder where the grains are: they stay what they are.
    let alone = folder.join("alone");
    fs::create_dir(&alone).unwrap();
    fs::write(alone.join("g.csv"), grains).unwrap();
    fs::copy(folder.join("tiny.toml"), alone.join("tiny.toml")).unwrap();
    let packing = "--set=grains.packing={ file = \"g.csv\" }";
    finish(&alone, &["run", "tiny.toml", packing, short[0], short[1], "--out", "."]);
    assert_eq!(fs::read_to_string(alone.join("g.csv")).unwrap(), grains);
}

#[test]
fn the_summary_of_a_run_that_failed_tells_the_sample_it_left() {
    let folder = folder("failed");
    let text = CASE.replace("until = { time = 0.05 }", "until = { unbalanced = 1e-12, max-steps = 60 }");
    fs::write(folder.join("case.toml"), text).unwrap();
    let status = start(&folder, &["run", "case.toml", "--out", "out"]).wait().unwrap();
    assert_eq!(status.code(), Some(1));
    let summary = fs::read_to_string(folder.join("out/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["stages"][0]["ended"], "failed");
    assert_eq!(summary["sample"]["grains"], 80);
    assert_eq!(summary["sample"]["porosity"], summary["stages"][0]["reached"]["porosity"]);
}

/// The domain that an export begins with, and its grains, are the sheared sample for a new case: with the same velocities, as before.
#[test]
fn an_exported_sample_goes_on_in_another_case() {
    let folder = folder("exported");
    let domain = "domain = { size = [0.01, 0.01, 0.01], periodic = \"xyz\" }";
    let text = |domain: &str, packing: &str| {
        format!(
            "title = \"A cell\"\n{domain}\ngrains = {{ packing = {{ {packing} }}, density = 2600.0 }}\n[contact.linear]\n\
             young = 1e6\nstiffness-ratio = 0.5\nfriction = 0.0\n[cell]\ngradient = {{ xz = 40.0 }}\n\
             [[stage]]\nname = \"shear\"\nuntil = {{ time = 0.02 }}\n\
             [[watch]]\nmeasures = [\"kinetic-energy\"]\nevery = {{ steps = 1000 }}\n"
        )
    };
    let first = text(domain, "cloud = { count = 150, spread = 0.2, seed = 1, porosity = 0.7 }");
    fs::write(folder.join("first.toml"), first).unwrap();
    finish(&folder, &["run", "first.toml", "--out", "one", "--quiet"]);
    finish(&folder, &["export", "one", "grains.csv", "--velocities"]);
    let grains = fs::read_to_string(folder.join("grains.csv")).unwrap();
    let lines: Vec<&str> = grains.lines().collect();
    assert!(
        lines[1].starts_with("# domain = { origin = [") && lines[1].contains("periods = [["),
        "{}",
        lines[1]
    );
    assert_eq!((lines[2], lines.len()), ("x,y,z,r,vx,vy,vz", 153));
    let second = text(&lines[1][2..], "file = \"grains.csv\"");
    fs::write(folder.join("second.toml"), second).unwrap();
    let (_, said) =
        finish(&folder, &["run", "second.toml", "--out", "two", "--set", "stage.shear.until.time=1e-9"]);
    let energy = |run: &str| -> f64 {
        let history = fs::read_to_string(folder.join(run).join("history.csv")).unwrap();
        history.lines().last().unwrap().split(',').nth(3).unwrap().parse().unwrap()
    };
    let (before, after) = (energy("one"), energy("two"));
    assert!(before > 0.0 && (after / before - 1.0).abs() < 0.05, "{before} {after} {said}");
}

#[test]
fn with_glued_grains_there_is_no_budget_of_the_energy() {
    let folder = folder("glued");
    let text = CASE
        .replace("measures = [\"size\"]", "measures = [\"energy-budget\"]")
        .replace("name = \"hold\"", "name = \"hold\"\nface.bottom.glue = true")
        .replace("steps = 40000", "steps = 100");
    fs::write(folder.join("case.toml"), text).unwrap();
    finish(&folder, &["run", "case.toml", "--out", "out", "--quiet"]);
    let history = fs::read_to_string(folder.join("out/history.csv")).unwrap();
    let mut lines = history.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let heads = lines.next().unwrap();
    let column = heads.iter().position(|head| head.starts_with("energy_error")).unwrap();
    let lines: Vec<_> = lines.collect();
    let told = |stage: &str| lines.iter().filter(|l| l[0] == stage && !l[column].is_empty()).count();
    assert!(told("fall") > 0 && told("hold") == 0, "{history}");
}

#[test]
fn two_processes_cannot_share_a_run() {
    let folder = folder("shared");
    let mut child =
        start(&folder, &["run", "tiny.toml", "--out", "long", "--set", "stage.hold.until.steps=100000000"]);
    while !folder.join("long/checkpoint").exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = start(&folder, &["resume", "long"]).wait_with_output().unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("long belongs to a run that is going on"), "{said}");
}

#[cfg(unix)]
#[test]
fn a_run_goes_on_when_nobody_listens_any_more() {
    let folder = folder("unheard");
    let mut child = start(&folder, &["run", "tiny.toml", "--out", "long", "--until", "0.06"]);
    drop(child.stderr.take());
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_lost_summary_is_told() {
    let folder = folder("lost");
    finish(&folder, &["run", "tiny.toml", "--out", "run", "--until", "0.01"]);
    fs::write(folder.join("run/summary.json"), "{").unwrap();
    let (stdout, said) = finish(&folder, &["resume", "run", "--until", "0.02", "--json"]);
    assert!(said.contains("warning: summary.json was lost or damaged"), "{said}");
    assert!(stdout.contains("summary.json was lost or damaged"), "{stdout}");
}

/// Water driven through a periodic cell of loose grains that its gradient just carries.
const DRIVEN: &str = r#"
title = "Grains float in a stream"
gravity = [0.0, 0.0, -9.81]
time-step = { fixed = 1e-6 }
[domain]
size = [0.01, 0.01, 0.01]
periodic = "xyz"
[grains]
packing = { cloud = { count = 40, porosity = 0.75, seed = 5 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[fluid]
viscosity = 1e-2
# (rho_s - rho_f) g (1 - n)
flow = { pores = { gradient = [0.0, 0.0, -3924.0], residual = 1e-10, implicit-residual = 1e-10 } }
[[stage]]
name = "float"
until = { steps = 101 }
[[watch]]
measures = ["discharge", "water-stress", "pressure-profile", "pressure-profile-x", "pressure", "outflow"]
every = { steps = 1 }
[[field]]
name = "up"
at = { line = { from = [0.005, 0.005, 0.0], to = [0.005, 0.005, 0.01], count = 3 } }
every = { steps = 100 }
"#;

#[test]
fn a_gradient_drives_water_as_the_permeability_says_and_the_budget_is_told() {
    let folder = folder("driven");
    fs::write(folder.join("driven.toml"), DRIVEN).unwrap();
    // One step of grains at rest, and the permeability of these grains.
    finish(&folder, &["run", "driven.toml", "--out", "one", "--set", "stage.float.until.steps=1", "--quiet"]);
    finish(&folder, &["export", "one", "grains.csv"]);
    let measured =
        ["permeability", "grains.csv", "--period", "0.01,0.01,0.01", "--viscosity", "1e-2", "--json"];
    let (stdout, _) = finish(&folder, &measured);
    let found: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let k = |row: usize| found["permeability_tensor"][row][2].as_f64().unwrap();
    let history = fs::read_to_string(folder.join("one/history.csv")).unwrap();
    let mut lines = history.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let (heads, row) = (lines.next().unwrap(), lines.next().unwrap());
    let value = |name: &str| -> f64 {
        let column = heads.iter().position(|head| head.starts_with(&format!("{name} ["))).unwrap();
        row[column].parse().unwrap()
    };
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let (flux, expected) = (value(&format!("discharge_{name}")), k(axis) * 3924.0 / 1e-2);
        // In that step the grains begin to move.
        assert!((flux - expected).abs() < 1e-3 * k(2) * 3924.0 / 1e-2, "{name}: {flux} {expected}");
    }
    // Ends of a profile along a period are one place; without the macroscopic part their pressures are one.
    for name in ["pressure", "pressure_x"] {
        assert_eq!(value(&format!("{name}_0")), value(&format!("{name}_12")));
    }
    assert!(value("water_stress_xx").abs() > 0.0);
    // The field has the macroscopic part: over the period it is what the gradient says.
    let field = fs::read_to_string(folder.join("one/field-up.csv")).unwrap();
    let pressure =
        |line: usize| -> f64 { field.lines().nth(line).unwrap().split(',').nth(5).unwrap().parse().unwrap() };
    assert!((pressure(1) - pressure(3) - 39.24).abs() < 1e-6, "{field}");
    // All that must balance, told at the end, and that the level is free.
    let (_, said) = finish(&folder, &["run", "driven.toml", "--out", "whole"]);
    for item in [
        "iterations per step",
        "flux left over",
        "force sum",
        "work less dissipation",
        "mass drift",
        "a macroscopic gradient gave",
        "0 meshes made for their strain",
        "1 for new rules",
        "pores merged",
        "throats closed",
        "clamped",
        "no pressure is given anywhere: pressures count from their mean",
    ] {
        assert!(said.contains(item), "{item} is not told in {said}");
    }
    let summary = fs::read_to_string(folder.join("whole/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    documented(&summary);
    let budget = |key: &str| summary["budget"][key].as_f64().unwrap();
    assert!(budget("gradient_work") > 0.0 && budget("power") < 1e-6 && budget("flux") < 1e-6, "{said}");
    assert!(budget("mass_drift").abs() < 1e-9 && budget("force") < 1e-12, "{said}");
    // A careless solve does not go on.
    let careless =
        ["step=explicit", "solver=cg", "residual=0.9"].map(|set| format!("fluid.flow.pores.{set}"));
    let mut arguments = vec!["run", "driven.toml", "--out", "careless"];
    careless.iter().for_each(|set| arguments.extend(["--set", set]));
    let output = start(&folder, &arguments).wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("in the stage `float`, the budget of the water is off: the flux left over in a pore"),
        "{said}"
    );
    // Before the run too, and in a sealed box, but not where a pressure is given.
    let level = |more: &[&str]| {
        let (stdout, stderr) = finish(&folder, &[&["check", "driven.toml"], more].concat());
        (stdout + &stderr).contains("no pressure is given anywhere")
    };
    assert!(level(&[]));
    let walled = ["--set", "domain.periodic=''", "--set", "fluid.flow.pores.gradient=[0,0,0]"];
    assert!(level(&walled));
    assert!(!level(&[&walled[..], &["--set", "face.top.water.pressure=0"]].concat()));
}
