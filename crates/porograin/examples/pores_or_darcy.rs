//! Draws two runs of one consolidation on one graph: settlement and pressure at mid-height against time.
//!
//! `cargo run --release --example pores_or_darcy -- PORES_RUN DARCY_RUN OUT.svg`, the folders of the runs of `case.toml` and
//! `darcy.toml` of `examples/21-pores-or-darcy`.

use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use std::error::Error;

/// Time since the last stage began [s], settlement [mm] and pressure at mid-height [kPa].
fn history(folder: &str) -> Result<Vec<[f64; 3]>, Box<dyn Error>> {
    let text = std::fs::read_to_string(format!("{folder}/history.csv"))?;
    let mut lines = text.lines();
    let heads: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let place = |name: &str| heads.iter().position(|head| *head == name).ok_or(format!("no column {name}"));
    let columns = [place("time [s]")?, place("settlement [m]")?, place("pressure_6 [Pa]")?];
    let mut rows = Vec::new();
    for line in lines.filter(|line| line.starts_with("load,")) {
        let cells: Vec<&str> = line.split(',').collect();
        let [time, settlement, pressure] = columns.map(|column| cells[column].parse::<f64>());
        rows.push([time?, 1e3 * settlement?, 1e-3 * pressure?]);
    }
    let start = rows.first().map_or(0.0, |row| row[0]);
    rows.iter_mut().for_each(|row| row[0] -= start);
    Ok(rows)
}

fn main() -> Result<(), Box<dyn Error>> {
    let usage = "usage: pores_or_darcy PORES_RUN DARCY_RUN OUT.svg";
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [pores, darcy, out] = arguments.as_slice() else { return Err(usage.into()) };
    let runs = [(history(pores)?, Mark::Line, "pore by pore"), (history(darcy)?, Mark::Dots, "on a grid")];
    let chart = |quantity: usize, title: &str, label: &str| Chart {
        title: title.into(),
        x: Axis { label: "time since the load was put on [s]".into(), ..Axis::default() },
        y: Axis { label: label.into(), ..Axis::default() },
        series: (runs.iter().enumerate())
            .map(|(colour, (rows, mark, name))| Series {
                name: (*name).into(),
                points: rows.iter().map(|row| [row[0], row[quantity]]).collect(),
                mark: *mark,
                colour,
            })
            .collect(),
    };
    let charts =
        [chart(1, "Settlement", "settlement [mm]"), chart(2, "Pressure at mid-height", "pressure [kPa]")];
    std::fs::write(out, svg(&charts))?;
    Ok(())
}
