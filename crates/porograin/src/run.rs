//! The outer loop: stages in order, each until its end, and the files it leaves behind.

mod simulation;
pub use simulation::{Event, RunError, Simulation};

use crate::case::reason;
use crate::darcy::Census;
use crate::measure;
use crate::output::folder::Folder;
use crate::output::report;
use crate::output::summary::{Reached, Sample, StageSummary, Terzaghi};
use crate::pores::PoreState;
use crate::state::State;
use crate::step::Report;
use crate::trouble::Trouble;
use crate::watch::Snapshot;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How a call to [`run`] is to go.
#[derive(Clone, Copy, Debug)]
pub struct Options<'a> {
    /// Stop at this simulated time [s].
    pub until: Option<f64>,
    /// Wall time between checkpoints.
    pub checkpoint: Duration,
    /// Stop as soon as this is set.
    pub stop: &'a AtomicBool,
}

/// How a call to [`run`] came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All stages are done.
    Finished,
    /// The time asked for is reached.
    Until,
    /// It was asked to stop.
    Interrupted,
}

/// What a progress bar shows.
#[derive(Clone, Debug)]
pub struct View<'a> {
    /// Index of the stage.
    pub stage: usize,
    /// Number of stages.
    pub stages: usize,
    /// Name of the stage.
    pub name: &'a str,
    /// Steps since the run began.
    pub step: u64,
    /// Simulated time [s].
    pub time: f64,
    /// What the last step did.
    pub report: &'a Report,
    /// Signs of trouble, seen for the first time in the stage.
    pub news: &'a [Trouble],
    /// How much of the stage is done, when it ends at a time or a number of steps.
    pub part: Option<f64>,
    /// Wall time until the end of the stage, when `part` tells.
    pub left: Option<Duration>,
    simulation: &'a Simulation,
}

impl View<'_> {
    /// How far the conditions are that the stage waits for, with what is asked in brackets. It costs a pass over all
    /// contacts.
    pub fn standing(&self) -> Option<String> {
        let until = &self.simulation.stages[self.stage].until;
        if !until.waits() {
            return None;
        }
        let now = self.simulation.conditions(until);
        let of = |name: &str, value: Option<f64>, limit: Option<f64>| {
            value.zip(limit).map(|(value, limit)| format!("{name} {value:.1e} ({limit:.0e})"))
        };
        let unbalanced = of("unbalanced", now.unbalanced, until.unbalanced);
        let stress = of("stress error", now.stress.map(|held| held.error), until.stress_error);
        Some(unbalanced.into_iter().chain(stress).collect::<Vec<_>>().join(", "))
    }
}

/// Runs a simulation to its end, or to where `options` stop it, writing its files into `folder`; `show` is called
/// after every step. Whenever it returns, and every `options.checkpoint`, there is a checkpoint to go on from.
///
/// # Errors
/// See [`RunError`]; the last checkpoint stays.
pub fn run(
    simulation: &mut Simulation,
    folder: &mut Folder,
    options: &Options,
    show: &mut dyn FnMut(&View),
) -> Result<Ending, RunError> {
    let mut sitting = Sitting::new(simulation, folder);
    folder.checkpoint(&simulation.state, &simulation.progress).map_err(unwritable)?;
    let mut saved = Instant::now();
    loop {
        let stopped = if options.stop.load(Ordering::Relaxed) {
            Some(Ending::Interrupted)
        } else if simulation.stage().is_none() {
            Some(Ending::Finished)
        } else if options.until.is_some_and(|end| simulation.state.time >= end) {
            Some(Ending::Until)
        } else {
            None
        };
        if let Some(ending) = stopped {
            if simulation.progress.began.is_some() {
                sitting.note(simulation, folder, simulation.progress.stage, "running");
            }
            folder.summary.finished = ending == Ending::Finished;
            results(simulation, folder)?;
            folder.checkpoint(&simulation.state, &simulation.progress).map_err(unwritable)?;
            return Ok(ending);
        }
        let stage = simulation.progress.stage;
        let event = simulation.advance();
        let (report, end) = match event {
            Ok(Some(Event::Step(report))) => (report, false),
            Ok(Some(Event::StageEnd(report))) => (report, true),
            Ok(None) => continue,
            Err(error) => {
                sitting.note(simulation, folder, stage, "failed");
                folder.summary.sample = sample(simulation, &folder.summary.sample);
                // The failure of the stage is what the user must hear, not that of the summary.
                let _ = folder.write_summary();
                return Err(error);
            }
        };
        let began = simulation.began;
        let now = Snapshot {
            stage: &simulation.stages[stage].name,
            state: &simulation.state,
            model: &simulation.model,
            began: &began,
            places: &simulation.progress.places,
            ledger: simulation.progress.ledger.as_ref(),
            regions: &simulation.regions,
            loads: &simulation.work.loads,
            water: &simulation.work.fluid,
            report: &report,
        };
        folder.record(&now, end).map_err(unwritable)?;
        for trouble in &simulation.news {
            let warning = format!("in the stage `{}`, {trouble}", now.stage);
            // A run that was killed and resumed may come by here twice.
            if !folder.summary.warnings.contains(&warning) {
                folder.summary.warnings.push(warning);
            }
        }
        show(&sitting.view(simulation, stage, &report));
        if end || saved.elapsed() >= options.checkpoint {
            let ended = if end { simulation.progress.done[stage].ended.clone() } else { "running".into() };
            sitting.note(simulation, folder, stage, &ended);
            results(simulation, folder)?;
            folder.checkpoint(&simulation.state, &simulation.progress).map_err(unwritable)?;
            saved = Instant::now();
        }
        if end {
            sitting = Sitting::new(simulation, folder);
        }
    }
}

/// The part of a stage that this process computes.
struct Sitting {
    clock: Instant,
    /// When its first step was done, which may have had a lot to prepare, and how much of the stage was done then.
    first: Option<(Instant, f64)>,
    /// What earlier sittings booked for this stage.
    before: StageSummary,
}

impl Sitting {
    fn new(simulation: &Simulation, folder: &Folder) -> Self {
        Sitting {
            clock: Instant::now(),
            first: None,
            before: folder.summary.stages.get(simulation.progress.stage).cloned().unwrap_or_default(),
        }
    }

    /// Writes the stage into the summary as it stands.
    fn note(&self, simulation: &Simulation, folder: &mut Folder, stage: usize, ended: &str) {
        let mut entry = self.before.clone();
        entry.name = simulation.stages[stage].name.clone();
        entry.steps = simulation.state.step - simulation.began.step;
        entry.time = simulation.state.time - simulation.began.time;
        entry.seconds += self.clock.elapsed().as_secs_f64();
        entry.add(&simulation.work.timers);
        entry.ended = ended.to_owned();
        entry.reached = Some(reached(simulation));
        entry.water_step = simulation.state.pores().map(PoreState::stepping);
        entry.free_level = simulation.work.fluid.free_level(&simulation.state);
        folder.summary.stages.truncate(stage);
        folder.summary.stages.push(entry);
    }

    fn view<'a>(&mut self, simulation: &'a Simulation, stage: usize, report: &'a Report) -> View<'a> {
        let State { step, time, .. } = simulation.state;
        let (began, until) = (simulation.began, &simulation.stages[stage].until);
        let by_time = until.time.map(|end| (time - began.time) / end);
        let by_steps = until.steps.map(|end| (step - began.step) as f64 / end as f64);
        let part = by_time.into_iter().chain(by_steps).reduce(f64::max).filter(|_| !until.waits());
        let part = part.map(|part| part.clamp(0.0, 1.0));
        let left = part.and_then(|part| {
            let (since, from) = *self.first.get_or_insert((Instant::now(), part));
            let seconds = since.elapsed().as_secs_f64() * (1.0 - part) / (part - from);
            Duration::try_from_secs_f64(seconds).ok()
        });
        View {
            stage,
            stages: simulation.stages.len(),
            name: &simulation.stages[stage].name,
            step,
            time,
            report,
            news: &simulation.news,
            part,
            left,
            simulation,
        }
    }
}

/// What is known of the sample and of its consolidation so far, into the summary and the picture.
fn results(simulation: &Simulation, folder: &mut Folder) -> Result<(), RunError> {
    folder.summary.sample = sample(simulation, &folder.summary.sample);
    let budget = simulation.progress.budget;
    folder.summary.budget = (budget.steps > 0).then_some(budget);
    if let Some(census) = folder.summary.sample.grid {
        folder.summary.warnings.retain(|warning| !Census::wrote(warning));
        folder.summary.warnings.extend(census.warning());
    }
    folder.draw().map_err(unwritable)?;
    let Some(consolidation) = &simulation.progress.consolidation else { return Ok(()) };
    let Some(comparison) = consolidation.compare() else { return Ok(()) };
    folder.summary.terzaghi = Some(Terzaghi::new(consolidation, &comparison));
    let picture = report::Consolidation::new(consolidation, &comparison).svg();
    folder.write("consolidation.svg", picture.as_bytes()).map_err(unwritable)
}

/// The sample as the stage leaves it.
fn reached(simulation: &Simulation) -> Reached {
    let Simulation { state, model, progress, .. } = simulation;
    let stress = measure::contact_stress(state, model);
    let fell = progress.fallen.count > 0;
    Reached {
        porosity: measure::porosity(state),
        coordination: measure::coordination(state),
        friction: (progress.compaction.lowest < 1.0).then_some(progress.compaction.lowest),
        fallen: fell.then_some(progress.fallen.count),
        fallen_mass: fell.then_some(progress.fallen.mass),
        grown: progress.grown,
        diameters: measure::PASSING.map(|part| measure::diameter(&state.grains, part)),
        rattlers: measure::rattlers(state),
        stress: [stress.x_axis.x, stress.y_axis.y, stress.z_axis.z],
    }
}

/// `before` holds what was known of the pores when there was water.
fn sample(simulation: &Simulation, before: &Sample) -> Sample {
    let State { grains, contacts, .. } = &simulation.state;
    let census = simulation.work.fluid.mesh().map(|mesh| mesh.census);
    let consolidation = simulation.progress.consolidation.as_ref();
    Sample {
        pores: census.map(|c| c.pores).or(before.pores),
        throats: census.map(|c| c.throats).or(before.throats),
        merged: census.map(|c| c.merged).or(before.merged),
        grid: simulation.work.fluid.darcy.grid().map(|grid| grid.census).or(before.grid),
        permeability: consolidation.map(|c| c.permeability),
        oedometric_modulus: consolidation.map(|c| c.box_modulus()),
        grains: grains.len(),
        contacts: contacts.len(),
        porosity: measure::porosity(&simulation.state),
        grading_error: simulation.grading.as_ref().map(|grading| grading.difference(&grains.radius)),
    }
}

fn unwritable((path, error): (PathBuf, io::Error)) -> RunError {
    RunError::File { path: path.display().to_string(), reason: reason(&error) }
}
