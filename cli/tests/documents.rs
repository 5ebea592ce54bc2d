//! What the documents show must work: every case in them, and the list of everything a case can choose from.

use std::fs;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

fn porograin(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_porograin")).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn cases_in_the_documents_are_accepted() {
    for document in ["README.md", "docs/case.md"] {
        let text = fs::read_to_string(root().join(document)).unwrap();
        let case = text.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("document.toml");
        fs::write(&path, case).unwrap();
        let (code, stdout, stderr) = porograin(&["check", path.to_str().unwrap(), "--json"]);
        assert_eq!(code, Some(0), "{document}: {stderr}");
        let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert!(object["stages"][0]["time_step"].as_f64().unwrap() > 0.0);
    }
}

#[test]
fn examples_are_accepted_and_can_be_copied() {
    let (_, listed, _) = porograin(&["list"]);
    let page = fs::read_to_string(root().join("examples/README.md")).unwrap();
    for picture in page.split("src=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(root().join("examples").join(picture).exists(), "{picture}");
    }
    let entries = fs::read_dir(root().join("examples")).unwrap().map(|e| e.unwrap().path());
    for folder in entries.filter(|entry| entry.is_dir()) {
        let name = folder.file_name().unwrap().to_str().unwrap();
        assert!(listed.contains(name), "{name} is not listed");
        assert!(page.contains(&format!("({name}/README.md)")), "{name} is not in examples/README.md");
        let copy = Path::new(env!("CARGO_TARGET_TMPDIR")).join("copies").join(name);
        let _ = fs::remove_dir_all(&copy);
        let (code, _, stderr) = porograin(&["new", name, copy.to_str().unwrap()]);
        assert_eq!(code, Some(0), "{stderr}");
        for file in fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()) {
            let copied = copy.join(file.file_name().unwrap());
            assert_eq!(fs::read(&file).unwrap(), fs::read(&copied).unwrap(), "{}", copied.display());
            if file.extension().is_some_and(|e| e == "toml") {
                let (code, _, stderr) = porograin(&["check", copied.to_str().unwrap()]);
                assert_eq!(code, Some(0), "{stderr}");
            }
        }
        let (code, _, stderr) = porograin(&["new", name, copy.to_str().unwrap()]);
        assert!(code == Some(2) && stderr.contains("is there already"), "{stderr}");
    }
}

#[test]
fn the_list_names_every_choice_a_case_may_make() {
    // The refusal of a wrong word names all the right ones; so must the list and the reference.
    let (_, listed, _) = porograin(&["list"]);
    let reference = fs::read_to_string(root().join("docs/case.md")).unwrap();
    for (set, documented) in [
        ("face.all.solid=x", true),
        ("face.all.water=x", true),
        ("face.all.slip=x", true),
        ("wall=[{name='a', shape={x=1}}]", true),
        ("wall=[{name='a', shape={disc={centre=[0,0,0], normal=[1,0,0], radius=1}}, motion={x=1}}]", true),
        ("region=[{name='a', shape={x=1}}]", true),
        ("contact={x=1}", true),
        ("grains.packing={x=1}", true),
        ("grains.packing={cloud={count=1,grading={x=1}}}", true),
        ("grains.packing={lattice={arrangement='x',radius=1e-3}}", true),
        ("watch.0.measures=['x']", false),
        ("fluid.flow={x=1}", true),
        ("fluid.flow.pores.solver=x", true),
        ("fluid.flow.pores.step=x", true),
        ("fluid.flow.pores.coupling=x", true),
        ("fluid.flow.pores.conductance=x", true),
        ("face.top.water.pressure={x=1}", true),
        ("field=[{name='a', every={steps=1}, at={x=1}}]", true),
        ("stage.fall.until={x=1}", true),
        ("stage.fall.x=1", true),
        ("on={x=1}", true),
        ("on.outside=x", true),
    ] {
        let fine = root().join("bad/fine.toml");
        let (code, _, stderr) = porograin(&["check", fine.to_str().unwrap(), "--set", set]);
        assert_eq!(code, Some(2), "{set}");
        let (_, allowed) = stderr.split_once("allowed here: ").unwrap_or_else(|| panic!("{set}: {stderr}"));
        for word in allowed.trim().split(", ") {
            let key_of_stage = set.starts_with("stage");
            assert!(
                key_of_stage || listed.contains(&format!("  {word} ")),
                "`{word}` of {set} is not listed"
            );
            assert!(!documented || reference.contains(word), "`{word}` of {set} is not in docs/case.md");
        }
    }
}
