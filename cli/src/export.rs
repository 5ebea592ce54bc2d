//! `porograin export`.

use crate::arguments::Export;
use crate::{Failure, Outcome};
use porograin::case::reason;
use porograin::output::folder::last_state;
use porograin::output::table::number;
use serde_json::json;
use std::fmt::Write as _;

/// Writes the grains of the last checkpoint, in order of their id, in the format that cases and `permeability` read.
pub fn export(arguments: &Export) -> Outcome {
    let state = last_state(&arguments.folder).map_err(|e| Failure::Input(e.to_string()))?;
    let (cell, grains) = (&state.domain.cell, &state.grains);
    let mut order: Vec<usize> = (0..grains.len()).collect();
    order.sort_by_key(|&k| grains.id[k]);
    let (lower, upper) = (cell.origin, cell.upper());
    let mut text = format!(
        "# {} grains at t = {} s; --box {},{},{},{},{},{}\nx,y,z,r\n",
        grains.len(),
        number(state.time),
        number(lower.x),
        number(lower.y),
        number(lower.z),
        number(upper.x),
        number(upper.y),
        number(upper.z)
    );
    for k in order {
        let (x, r) = (grains.position[k], grains.radius[k]);
        let _ = writeln!(text, "{},{},{},{}", number(x.x), number(x.y), number(x.z), number(r));
    }
    let shown = arguments.grains.display().to_string();
    std::fs::File::create_new(&arguments.grains)
        .and_then(|mut file| std::io::Write::write_all(&mut file, text.as_bytes()))
        .map_err(|e| Failure::Input(format!("cannot write {shown}: {}", reason(&e))))?;
    say!("{} grains in {shown}", grains.len());
    Ok(Some(
        json!({ "grains": grains.len(), "file": shown, "lower": lower.to_array(), "upper": upper.to_array() }),
    ))
}
