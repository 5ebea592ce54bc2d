//! `porograin run` and `porograin resume`.

use crate::arguments::{Resume, Run};
use crate::bar::{Bar, span};
use crate::{Failure, Outcome, quoted, threads};
use porograin::awake::awake;
use porograin::case::Case;
use porograin::consolidation::COMPARE_FROM;
use porograin::output::folder::Folder;
use porograin::pores::Stepping;
use porograin::run::{Ending, Options, RunError, Simulation, run as drive};
use serde_json::json;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// `porograin run`.
pub fn run(arguments: &Run) -> Outcome {
    let case = Case::from_file(&arguments.case, &arguments.set).map_err(|e| Failure::Input(e.to_string()))?;
    threads(arguments.threads)?;
    let simulation = Simulation::new(&case).map_err(|e| Failure::Input(e.to_string()))?;
    let path = arguments.out.clone().unwrap_or_else(|| PathBuf::from("out").join(case.name()));
    let folder = Folder::create(&path, &case).map_err(|e| Failure::Input(e.to_string()))?;
    if !arguments.quiet {
        say!("{}: {} grains, results in {}", case.title, simulation.state.grains.len(), path.display());
    }
    go(&case, simulation, folder, arguments.until, arguments.quiet)
}

/// `porograin resume`.
pub fn resume(arguments: &Resume) -> Outcome {
    let (folder, case, state, progress) =
        Folder::reopen(&arguments.folder).map_err(|e| Failure::Input(e.to_string()))?;
    threads(arguments.threads)?;
    let simulation = Simulation::resume(&case, state, progress);
    if !arguments.quiet {
        let now = &simulation.state;
        say!("{}: going on from step {}, t = {:.4e} s", case.title, now.step, now.time);
    }
    go(&case, simulation, folder, arguments.until, arguments.quiet)
}

fn go(
    case: &Case,
    mut simulation: Simulation,
    mut folder: Folder,
    until: Option<f64>,
    quiet: bool,
) -> Outcome {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        // Asked twice: somebody is in a hurry. The last checkpoint is whole at any moment.
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(1);
        }
    })
    .map_err(|e| Failure::Run(format!("cannot listen for Ctrl-C: {e}")))?;
    let options = Options {
        until,
        checkpoint: Duration::try_from_secs_f64(case.output.checkpoint).unwrap_or(Duration::MAX),
        stop: &stop,
    };
    let clock = Instant::now();
    let mut bar = Bar::new(quiet);
    // Once inside the pool: entering it anew for every loop of every step would cost more than the loops.
    let ending = awake(|| drive(&mut simulation, &mut folder, &options, &mut |view| bar.show(view)));
    bar.finish();
    let (shown, pasted) = (folder.path().display().to_string(), quoted(folder.path()));
    let ending = ending.map_err(|error| {
        let way = match &error {
            // Going on from the checkpoint would end in the same way.
            RunError::Endless { stage, .. } => format!(
                "the last checkpoint is kept; to wait longer run the case again, \
                 with --set stage.{stage}.until.max-steps=… or max-time=…"
            ),
            _ => format!("the last checkpoint is kept: porograin resume {pasted}"),
        };
        Failure::Run(format!("{error}\n  = {way}"))
    })?;
    let word = match ending {
        Ending::Finished => "finished",
        Ending::Until => "until",
        Ending::Interrupted => {
            return Err(Failure::Run(format!(
                "interrupted at t = {:.4e} s\n  = go on with: porograin resume {pasted}",
                simulation.state.time
            )));
        }
    };
    if !quiet {
        report(&folder);
        match ending {
            Ending::Until => {
                say!("stopped at t = {:.4e} s; go on with: porograin resume {pasted}", simulation.state.time)
            }
            _ => say!("done in {}; results in {shown}", span(clock.elapsed())),
        }
    }
    Ok(Some(json!({ "out": shown, "ended": word, "summary": folder.summary })))
}

/// The stages with their steps and where the time went.
fn report(folder: &Folder) {
    for stage in &folder.summary.stages {
        let total: f64 = stage.phases.values().sum();
        let mut phases: Vec<(&String, &f64)> = stage.phases.iter().collect();
        phases.sort_by(|a, b| b.1.total_cmp(a.1));
        let shares: Vec<String> = phases
            .iter()
            .map(|(name, seconds)| format!("{name} {:.0} %", 100.0 * *seconds / total))
            .collect();
        let water = match stage.water_step {
            Some(Stepping::Implicit) => " implicit",
            _ => "",
        };
        say!(
            "{:>12}: {}{water} steps, {:.4e} s simulated in {:.1} s ({})",
            stage.name,
            stage.steps,
            stage.time,
            stage.seconds,
            shares.join(", ")
        );
        if let Some(reached) = &stage.reached {
            let [x, y, z] = reached.stress;
            say!(
                "{:>12}  porosity {:.4}, {:.2} contacts per grain, {} rattlers, stress {x:.3e} {y:.3e} {z:.3e} Pa",
                "",
                reached.porosity,
                reached.coordination,
                reached.rattlers
            );
            let [d10, _, d50, _, d90] = reached.diameters;
            say!("{:>12}  by mass 10, 50 and 90 % finer than {d10:.3e}, {d50:.3e} and {d90:.3e} m", "");
            if let Some((count, mass)) = reached.fallen.zip(reached.fallen_mass) {
                say!("{:>12}  {count} grains have fallen, {mass:.3e} kg", "");
            }
            if let Some(grown) = reached.grown {
                say!("{:>12}  all radii have grown by the factor {grown:.6}", "");
            }
        }
        if stage.free_level {
            say!("              no pressure is given anywhere: pressures count from their mean");
        }
    }
    if let Some(seen) = &folder.summary.terzaghi {
        say!(
            "    Terzaghi: for T_v > {COMPARE_FROM} the pressure at mid-height is within {:.3} of the load, the settlement within \
             {:.3} of the final one; before, the pressure reaches {:.2} of the load",
            seen.max_error,
            seen.max_settlement_error,
            seen.first_pressure
        );
        say!("              {}", folder.path().join("consolidation.svg").display());
    }
    if let Some(error) = folder.summary.sample.grading_error {
        say!("     grading: passing mass within {error:.1e} of what was asked for");
    }
    if let Some(water) = &folder.summary.budget {
        say!(
            "       water: {:.1} iterations per step; flux left over {:.0e}, force sum {:.0e}, work less dissipation \
             {:.0e}, mass drift {:.0e}",
            water.iterations as f64 / water.steps as f64,
            water.flux,
            water.force,
            water.power,
            water.mass_drift
        );
        if water.gradient_work != 0.0 {
            say!(
                "              a macroscopic gradient gave {:.3e} J to water and grains",
                water.gradient_work
            );
        }
        say!(
            "              {} meshes made for their strain ({} rebuilt, the others by {} flips and {} holes), {} for new rules; \
             {} pores merged, {} throats closed, {} clamped",
            water.meshes_for_strain,
            water.rebuilt,
            water.flips,
            water.holes,
            water.meshes_for_rules,
            water.merged,
            water.closed,
            water.clamped
        );
    }
    for warning in &folder.summary.warnings {
        say!("warning: {warning}");
    }
}
