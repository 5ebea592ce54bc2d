//! `porograin export`.

use crate::arguments::Export;
use crate::{Failure, Outcome};
use glam::DVec3;
use porograin::case::reason;
use porograin::output::folder::last_state;
use porograin::output::table::number;
use porograin_geometry::Cell;
use serde_json::json;
use std::fmt::Write as _;

/// Writes the grains of the last checkpoint, in order of their id, in the format that cases and `permeability` read.
pub fn export(arguments: &Export) -> Outcome {
    let state = last_state(&arguments.folder).map_err(|e| Failure::Input(e.to_string()))?;
    let (cell, grains) = (&state.domain.cell, &state.grains);
    let mut order: Vec<usize> = (0..grains.len()).collect();
    order.sort_by_key(|&k| grains.id[k]);
    let (lower, upper) = (cell.origin, cell.upper());
    // What `porograin permeability` wants to know of the region.
    let (option, region) = if cell.periodic == [true; 3] {
        ("lattice", cell.edges.to_cols_array().to_vec())
    } else {
        ("box", [lower.to_array(), upper.to_array()].concat())
    };
    let region: Vec<String> = region.into_iter().map(number).collect();
    let (count, time, region) = (grains.len(), number(state.time), region.join(","));
    let head = if arguments.velocities { "x,y,z,r,vx,vy,vz" } else { "x,y,z,r" };
    let domain = domain(cell);
    let mut text = format!("# {count} grains at t = {time} s; --{option} {region}\n# {domain}\n{head}\n");
    for k in order {
        let x = grains.position[k];
        let v = state.domain.peculiar(x, grains.velocity[k]);
        let row = [x.x, x.y, x.z, grains.radius[k], v.x, v.y, v.z].map(number);
        let _ = writeln!(text, "{}", row[..if arguments.velocities { 7 } else { 4 }].join(","));
    }
    let shown = arguments.grains.display().to_string();
    std::fs::File::create_new(&arguments.grains)
        .and_then(|mut file| std::io::Write::write_all(&mut file, text.as_bytes()))
        .map_err(|e| Failure::Input(format!("cannot write {shown}: {}", reason(&e))))?;
    say!("{} grains in {shown}", grains.len());
    Ok(Some(
        json!({ "grains": grains.len(), "file": shown, "lower": lower.to_array(), "upper": upper.to_array(), "edges": cell.edges.to_cols_array_2d() }),
    ))
}

/// The domain as a case says it.
fn domain(cell: &Cell) -> String {
    let list = |values: DVec3| format!("[{}]", values.to_array().map(number).join(", "));
    let origin = list(cell.origin);
    if cell.periodic == [false; 3] {
        return format!("domain = {{ origin = {origin}, size = {} }}", list(cell.upper() - cell.origin));
    }
    let periods = [0, 1, 2].map(|k| list(cell.edges.col(k))).join(", ");
    let axes: String = "xyz".chars().zip(cell.periodic).filter_map(|(axis, is)| is.then_some(axis)).collect();
    format!("domain = {{ origin = {origin}, periods = [{periods}], periodic = \"{axes}\" }}")
}
