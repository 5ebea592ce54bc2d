//! A case changes the model of its water by changing one table: everything it asks for is there either way.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A sample is loaded while water seeps through it; every measure of a walled box is watched.
const CASE: &str = r#"
title = "One case, two models of its water"
[domain]
size = [0.01, 0.01, 0.01]
[grains]
packing = { cloud = { count = 150, spread = 0.2, seed = 3 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 20.0
[fluid]
viscosity = 0.1
flow = { pores = {} }
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
until = { steps = 300 }
[[stage]]
name = "seep"
face.top.water.pressure = "20*x/0.01"
face.bottom.water.inflow = { ramp = { from = 0.0, to = 1e-3, end = 1e-3 } }
until = { steps = 300 }
[[region]]
name = "core"
shape = { sphere = { centre = [0.005, 0.005, 0.005], radius = 0.003 } }
[[watch]]
measures = [MEASURES]
every = { steps = 50 }
[[plot]]
file = "pressure.svg"
y = ["pressure_mean", "discharge_z"]
[output]
vtk = { steps = 300 }
[[field]]
name = "axis"
at = { line = { from = [0.005, 0.005, 0.0], to = [0.005, 0.005, 0.01], count = 11 } }
every = { steps = 100 }
[[field]]
name = "around"
at = { grid = { from = [-0.01, 0.002, 0.002], to = [0.02, 0.008, 0.008], count = [3, 2, 2] } }
every = { steps = 100 }
"#;

fn porograin(folder: &Path, arguments: &[&str]) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_porograin")).args(arguments).current_dir(folder).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (stdout, stderr) = (text(output.stdout), text(output.stderr));
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {stderr}");
    stdout
}

/// Heads and rows of a table.
fn table(path: PathBuf) -> (Vec<String>, Vec<Vec<String>>) {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    (lines.next().unwrap(), lines.collect())
}

/// All keys of a summary, `stages.0.phases` and the like.
fn keys(value: &serde_json::Value, path: &str, found: &mut BTreeSet<String>) {
    let at = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match value {
        serde_json::Value::Object(map) => map.iter().for_each(|(key, value)| keys(value, &at(key), found)),
        serde_json::Value::Array(list) => list.iter().for_each(|value| keys(value, path, found)),
        serde_json::Value::Null => {}
        _ => {
            found.insert(path.to_owned());
        }
    }
}

#[test]
fn changing_one_table_changes_the_model_and_leaves_every_output() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("either-water");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let listed = porograin(&folder, &["list"]);
    let (_, measures) = listed.split_once("\nmeasures:\n").unwrap();
    let words = measures.lines().map_while(|line| line.strip_prefix("  ")?.split_whitespace().next());
    let measures: Vec<String> = words.map(|word| format!("{word:?}")).collect();
    assert!(measures.len() > 30, "{measures:?}");
    fs::write(folder.join("case.toml"), CASE.replace("MEASURES", &measures.join(", "))).unwrap();
    porograin(&folder, &["run", "case.toml", "--out", "pores"]);
    porograin(&folder, &["run", "case.toml", "--out", "grid", "--set", "fluid.flow={darcy={}}"]);

    // From one to the other between two stages.
    porograin(&folder, &["run", "case.toml", "--out", "both", "--set", "stage.seep.fluid={flow={darcy={}}}"]);

    let of = |run: &str, name: &str| table(folder.join(run).join(name));
    for name in ["history.csv", "field-axis.csv", "field-around.csv"] {
        let [(heads, pores), (also, grid)] = ["pores", "grid"].map(|run| of(run, name));
        assert_eq!(heads, also);
        // Before there is water the runs are the same; then they have the same rows, and numbers in the same places.
        assert_eq!(pores.len(), grid.len(), "{name}");
        for (a, b) in pores.iter().zip(&grid) {
            for (head, (x, y)) in heads.iter().zip(a.iter().zip(b)) {
                assert_eq!(x.is_empty(), y.is_empty(), "{name}, {head}: {a:?} {b:?}");
                assert!(a[0] != "confine" || x == y, "{name}, {head}");
            }
        }
        assert!(pores.iter().any(|row| row[0] == "seep"), "{name}");
        let (_, both) = of("both", name);
        for stage in ["confine", "load", "seep"] {
            let rows = |table: &[Vec<String>]| table.iter().filter(|row| row[0] == stage).count();
            assert_eq!(rows(&both), rows(&pores), "{name}, {stage}");
        }
        assert_eq!(both[..both.len() / 2], pores[..both.len() / 2], "{name}");
    }
    // The places beyond the walls are told of as such.
    let (heads, rows) = of("grid", "field-around.csv");
    let column = |name: &str| heads.iter().position(|head| head.starts_with(name)).unwrap();
    for row in rows {
        let outside = (row[column("x")].parse::<f64>().unwrap() - 0.005).abs() > 0.01;
        assert_eq!(row[column("pressure")].is_empty(), outside, "{row:?}");
    }

    // Files and what the summaries tell: pores, or cells of a grid.
    let names = |run: &str| -> BTreeSet<String> {
        let all = ["", "vtk"].map(|part| fs::read_dir(folder.join(run).join(part)).unwrap());
        all.into_iter().flatten().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    };
    let swapped = names("pores").iter().map(|name| name.replace("pores", "grid")).collect::<BTreeSet<_>>();
    assert_eq!(swapped, names("grid"));
    for (run, file, field) in [
        ("pores", "pores_000010.vtu", "velocity [m/s]"),
        ("grid", "grid_000010.vtu", "velocity [m/s]"),
        ("pores", "grains_000010.vtp", "fluid velocity [m/s]"),
        ("grid", "grains_000010.vtp", "fluid velocity [m/s]"),
    ] {
        let frame = fs::read(folder.join(run).join("vtk").join(file)).unwrap();
        let head = format!("Name=\"{field}\" NumberOfComponents=\"3\"");
        assert!(frame.windows(head.len()).any(|part| part == head.as_bytes()), "{run}, {file}");
    }
    let told = |run: &str| -> BTreeSet<String> {
        let text = fs::read_to_string(folder.join(run).join("summary.json")).unwrap();
        let mut found = BTreeSet::new();
        keys(&serde_json::from_str(&text).unwrap(), "", &mut found);
        found
    };
    let [pores, grid] = ["pores", "grid"].map(told);
    let own = |key: &&String, prefixes: &[&str]| prefixes.iter().any(|prefix| key.starts_with(prefix));
    let only: Vec<_> = pores.difference(&grid).collect();
    println!("{only:?} {:?}", grid.difference(&pores).collect::<Vec<_>>());
    let of_pores = ["sample.pores", "sample.throats", "sample.merged", "budget.", "stages.water_step"];
    assert!(only.iter().all(|key| own(key, &of_pores)), "{only:?}");
    let only: Vec<_> = grid.difference(&pores).collect();
    assert!(only.iter().all(|key| own(key, &["sample.grid.", "warnings"])), "{only:?}");
}
