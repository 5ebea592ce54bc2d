//! Wrong input: each `bad/NAME.expected` holds a command and, to the letter, what it must say.
//!
//! `BLESS=1 cargo test -p porograin-cli --test bad` writes what is said now into the files: read the difference.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Every file below `folder` with its bytes.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut all = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path.clone());
                all.insert(path, None);
            } else {
                let bytes = fs::read(&path).unwrap();
                all.insert(path, Some(bytes));
            }
        }
    }
    all
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

fn porograin(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_porograin")).args(arguments).current_dir(folder).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// Folders with a run in them that cannot be resumed.
fn damage(folder: &Path) {
    for name in ["damaged", "edited", "older", "foreign"] {
        let (code, _, said) = porograin(folder, &["run", "fine.toml", "--out", name]);
        assert_eq!(code, Some(0), "{said}");
    }
    let change = |name: &str, edit: fn(&mut Vec<u8>)| {
        let path = folder.join(name);
        let mut bytes = fs::read(&path).unwrap();
        edit(&mut bytes);
        fs::write(path, bytes).unwrap();
    };
    change("damaged/checkpoint", |bytes| {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
    });
    change("edited/case.toml", |bytes| bytes.extend(b"# later\n"));
    change("older/checkpoint", |bytes| bytes[8] = 200);
    change("foreign/checkpoint", |bytes| *bytes = b"something else altogether".to_vec());
}

#[test]
fn every_wrong_input_is_refused_in_the_words_expected() {
    let bad = Path::new(env!("CARGO_MANIFEST_DIR")).join("../bad");
    let work = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bad");
    let _ = fs::remove_dir_all(&work);
    copy(&bad, &work);
    damage(&work);
    let before = contents(&work);
    let mut wrong = Vec::new();
    let mut seen = 0;
    let mut names: Vec<PathBuf> = fs::read_dir(&bad).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    for path in names.into_iter().filter(|p| p.extension().is_some_and(|e| e == "expected")) {
        seen += 1;
        let expected = fs::read_to_string(&path).unwrap();
        let (command, said) = expected.split_once('\n').unwrap();
        let arguments: Vec<&str> = command.strip_prefix("$ porograin ").unwrap().split(' ').collect();
        let (code, stdout, stderr) = porograin(&work, &arguments);
        if std::env::var_os("BLESS").is_some() {
            fs::write(&path, format!("{command}\n{stderr}")).unwrap();
            continue;
        }
        if stderr != said {
            wrong.push(format!("{command}\nis expected to say\n{said}\nbut says\n{stderr}"));
        }
        if code != Some(2) || !stdout.is_empty() {
            wrong.push(format!("{command}\nends with {code:?} and prints {stdout:?}"));
        }
    }
    assert!(seen > 50, "the folder bad/ is not where it should be");
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    let after = contents(&work);
    let changed: Vec<_> = after
        .iter()
        .filter(|&(path, bytes)| before.get(path) != Some(bytes))
        .map(|(path, _)| path)
        .chain(before.keys().filter(|path| !after.contains_key(*path)))
        .collect();
    assert!(changed.is_empty(), "refused commands changed {changed:?}");
}

#[test]
fn a_refusal_is_one_json_object_where_asked() {
    let bad = Path::new(env!("CARGO_MANIFEST_DIR")).join("../bad");
    let (code, stdout, _) = porograin(&bad, &["check", "unknown-key.toml", "--json"]);
    assert_eq!(code, Some(2));
    let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(object["error"], "unknown key `yuong` in `contact.linear`");
}
