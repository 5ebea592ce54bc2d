//! `porograin permeability` of boxes and periods, as a user sees it.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("permeability").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn permeability(folder: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(["permeability", "grains.csv", "--json"])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8(output.stderr).unwrap());
    let object = serde_json::from_slice(&output.stdout).unwrap();
    documented(&object);
    object
}

const GRAINS: &str = "x,y,z,r\n0.3,0.2,0.4,0.2\n0.7,0.3,0.8,0.15\n0.35,0.72,0.7,0.22\n0.8,0.8,0.3,0.18\n";

/// Every key is named in the documents.
#[track_caller]
fn documented(object: &Value) {
    let document =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/output.md")).unwrap();
    for key in object.as_object().unwrap().keys() {
        assert!(document.contains(&format!("`{key}`")), "docs/output.md says nothing of `{key}`");
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn forces(folder: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(folder.join("f.csv")).unwrap();
    text.lines().map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect()
}

#[test]
fn a_period_has_a_tensor_and_its_forces_sum_to_the_gradient() {
    let folder = folder("period");
    std::fs::write(folder.join("grains.csv"), GRAINS).unwrap();
    let options = ["--axis", "all", "--forces", "f.csv", "--slope", "3", "--vtk", "vtk"];
    let all = permeability(&folder, &[&["--period", "1,1,1"][..], &options].concat());
    let tensor: Vec<Vec<f64>> = all["permeability_tensor"].as_array().unwrap().iter().map(numbers).collect();
    assert_eq!(numbers(&all["permeability"]), [tensor[0][0], tensor[1][1], tensor[2][2]]);
    for (row, line) in tensor.iter().enumerate() {
        for (column, k) in line.iter().enumerate() {
            assert!((k - tensor[column][row]).abs() < 1e-11 * tensor[0][0]);
        }
        assert!(
            (numbers(&all["mean_velocity"][row])[row] / (3.0 * tensor[row][row] / 1e-3) - 1.0).abs() < 1e-9
        );
    }
    let lines = forces(&folder);
    assert_eq!((lines.len(), lines[0].len()), (4, 18));
    for axis in 0..3 {
        for component in 0..3 {
            let sum: f64 = lines.iter().map(|line| line[6 * axis + component]).sum();
            let expected = if component == axis { 3.0 } else { 0.0 };
            assert!((sum - expected).abs() < 3e-9, "{axis} {component}: {sum}");
        }
        let name = ["x", "y", "z"][axis];
        assert!(folder.join("vtk").join(name).join("pores.vtu").exists());
    }
    // The same lattice by other vectors, one flow only.
    let one = permeability(&folder, &["--lattice", "1,0,0,1,1,0,0,-1,1", "--axis", "y", "--slope", "3"]);
    assert!((one["permeability"].as_f64().unwrap() / tensor[1][1] - 1.0).abs() < 1e-10);
    assert_eq!(numbers(&one["force_sum"]).len(), 3);
    assert!(one["pressure_level"].as_str().unwrap().contains("free"));
}

#[test]
fn a_box_is_measured_along_each_axis_with_either_coupling() {
    let folder = folder("box");
    std::fs::write(folder.join("grains.csv"), GRAINS).unwrap();
    let walled = ["--box", "0,0,0,1,1,1", "--forces", "f.csv"];
    let all = permeability(&folder, &[&walled[..], &["--axis", "all"]].concat());
    let along = numbers(&all["permeability"]);
    let reciprocal = forces(&folder);
    assert_eq!((reciprocal.len(), reciprocal[0].len(), along.len()), (4, 18, 3));
    let z = permeability(&folder, &[&walled[..], &["--axis", "z", "--coupling", "geometric"]].concat());
    assert_eq!(z["permeability"].as_f64().unwrap(), along[2]);
    let geometric = forces(&folder);
    assert_eq!(geometric[0].len(), 6);
    let same = |k: usize| (geometric[k][2] / reciprocal[k][14] - 1.0).abs() < 1e-6;
    assert!(!same(0) && geometric.iter().all(|line| line[3..] == [0.0; 3]));
}
