//! `porograin check`.

use crate::arguments::Check;
use crate::bar::span;
use crate::{Failure, Outcome};
use porograin::case::{Case, Implied};
use porograin::darcy::grid::FEW_GRAINS;
use serde_json::json;
use std::time::Duration;

/// `porograin check`.
pub fn check(arguments: &Check) -> Outcome {
    let case = Case::from_file(&arguments.case, &arguments.set).map_err(|e| Failure::Input(e.to_string()))?;
    let implied = case.implied().map_err(|e| Failure::Input(e.to_string()))?;
    if !arguments.json {
        show(&implied);
    }
    Ok(Some(json!(implied)))
}

fn show(implied: &Implied) {
    let Implied { title, grains, radius: [least, mean, greatest], solid_fraction, pores, memory, stages } =
        implied;
    say!("{title}");
    say!(
        "  {grains} grains, radius {mean:.4e} m ({least:.4e} to {greatest:.4e}), filling {:.1} % of the box",
        100.0 * solid_fraction
    );
    if let Some(pores) = pores {
        say!("  about {pores} pores");
    }
    say!("  about {:.0} MB of memory", memory / 1e6);
    let count = *grains as f64;
    for stage in stages {
        say!("stage {}", stage.name);
        say!("  time step {:.3e} s, limited by {}", stage.time_step, stage.cause);
        if let Some((steps, seconds)) = stage.steps.zip(stage.seconds) {
            say!(
                "  {steps} steps, about {} on one core",
                span(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
            );
        }
        if let Some(number) = stage.stiffness_number {
            say!("  stiffness number E/stress {number:.0}");
        }
        if let Some(water) = &stage.water {
            say!(
                "  permeability about {:.2e} m2, seepage {:.2e} m/s, Reynolds {:.1e}, Stokes {:.1e}",
                water.permeability,
                water.seepage,
                water.reynolds,
                water.stokes
            );
            let steps = if water.implicit { "implicit" } else { "explicit" };
            say!("  {steps} steps: the water would shorten explicit ones about {:.1} times", water.shortens);
            if water.free_level {
                say!("  no pressure is given anywhere: pressures count from their mean");
            }
            if let Some([nx, ny, nz]) = stage.cells {
                let each = count / (nx * ny * nz) as f64;
                let few = if each < FEW_GRAINS { ", too few for a porosity: use larger cells" } else { "" };
                say!("  {nx} x {ny} x {nz} cells with {each:.1} grains each{few}");
            }
            say!("  consolidation takes about {:.2e} s", water.consolidation);
        }
    }
}
