//! `porograin plot`.

use crate::arguments::Plot;
use crate::{Failure, Outcome};
use porograin::case::{Case, reason};
use porograin::output::plot::{History, draw};
use porograin::output::replace;
use serde_json::json;
use std::path::Path;

/// Draws the plots of the first run, with the curves of all runs.
pub fn plot(arguments: &Plot) -> Outcome {
    let first = &arguments.folders[0];
    let case = Case::from_file(&first.join("case.toml"), &[]).map_err(|e| Failure::Input(e.to_string()))?;
    if case.plot.is_empty() {
        return Err(Failure::Input(format!(
            "the case of {} has no [[plot]]: there is nothing to draw",
            first.display()
        )));
    }
    let mut runs = Vec::new();
    for folder in &arguments.folders {
        let path = folder.join("history.csv");
        let history = History::read(&path)
            .map_err(|e| Failure::Input(format!("cannot read {}: {}", path.display(), reason(&e))))?;
        runs.push((name(folder), history));
    }
    let out = arguments.out.as_ref().unwrap_or(first);
    let mut files = Vec::new();
    for (file, picture) in draw(&case.plot, &runs) {
        let path = out.join(file);
        let shown = path.display().to_string();
        std::fs::create_dir_all(out)
            .and_then(|()| replace(&path, picture.as_bytes()))
            .map_err(|e| Failure::Run(format!("cannot write {shown}: {}", reason(&e))))?;
        say!("{shown}");
        files.push(shown);
    }
    Ok(Some(json!({ "files": files })))
}

/// The name of a run: of its folder.
fn name(folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    whole.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned())
}
