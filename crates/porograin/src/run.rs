//! The outer loop: stages in order, each until its end, and the files it leaves behind.

use crate::boundary::{FACE_NAMES, Solid};
use crate::budget::{Cause, Unbalanced};
use crate::case::{Case, CaseError, Plan, Stage, Until, at, reason};
use crate::cell::COMPONENTS;
use crate::consolidation::{Consolidation, ConsolidationError};
use crate::darcy::Census;
use crate::ledger::{Before, Ledger};
use crate::measure;
use crate::model::Model;
use crate::output::folder::Folder;
use crate::output::report;
use crate::output::summary::{Reached, Sample, StageSummary, Terzaghi};
use crate::packing::Grading;
use crate::pores::PoreState;
use crate::progress::{Began, Done, Progress};
use crate::stability;
use crate::state::State;
use crate::step::{Report, StepError, Work, step};
use crate::trouble::{self, Action, Trouble};
use crate::walls::motion;
use crate::watch::{Measure, Snapshot};
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Steps between two looks at the conditions of a stage that cost a pass over all contacts.
const LOOK_EVERY: u64 = 50;

/// A case being run: the state, and where in the case it stands. It touches no file.
#[derive(Debug)]
pub struct Simulation {
    /// The state now.
    pub state: State,
    /// Where in the case it stands.
    pub progress: Progress,
    stages: Vec<Stage>,
    model: Model,
    /// The sizes that were asked for.
    grading: Option<Grading>,
    /// How the stage of the last step began.
    began: Began,
    work: Work,
    /// What the last step had to be told of.
    news: Vec<Trouble>,
}

/// What a call to [`Simulation::advance`] did.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A step, and the stage goes on.
    Step(Report),
    /// The last step of a stage.
    StageEnd(Report),
}

/// Why a run stopped.
#[derive(Clone, Debug, PartialEq)]
pub enum RunError {
    /// A step could not be done.
    Step {
        /// Name of the stage.
        stage: String,
        /// What happened.
        error: StepError,
    },
    /// There was a sign of trouble at which the case asks to stop.
    Trouble {
        /// Name of the stage.
        stage: String,
        /// What it was.
        trouble: Trouble,
    },
    /// A stage cannot be compared with Terzaghi's theory.
    Consolidation {
        /// Name of the stage.
        stage: String,
        /// What happened.
        error: ConsolidationError,
    },
    /// The water does not balance any more.
    Budget {
        /// Name of the stage.
        stage: String,
        /// What is off.
        error: Unbalanced,
    },
    /// A stage did not reach its end in time.
    Endless {
        /// Name of the stage.
        stage: String,
        /// What it waited for and where it stands.
        why: String,
    },
    /// A file could not be written.
    File {
        /// Its path.
        path: String,
        /// The reason.
        reason: String,
    },
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RunError::Step { stage, error } => write!(f, "in the stage `{stage}`, {error}"),
            RunError::Trouble { stage, trouble } => write!(f, "in the stage `{stage}`, {trouble}"),
            RunError::Consolidation { stage, error } => write!(f, "in the stage `{stage}`, {error}"),
            RunError::Budget { stage, error } => write!(f, "in the stage `{stage}`, {error}"),
            RunError::Endless { stage, why } => {
                write!(f, "the stage `{stage}` did not come to its end: {why}")
            }
            RunError::File { path, reason } => write!(f, "cannot write {path}: {reason}"),
        }
    }
}

impl std::error::Error for RunError {}

impl Simulation {
    /// A simulation at the beginning of a case.
    ///
    /// # Errors
    /// When the grains of the case cannot be made.
    pub fn new(case: &Case) -> Result<Self, CaseError> {
        let Plan { state, stages } = case.plan()?;
        let ledger = case.watches(Measure::EnergyBudget).then(Ledger::default);
        Ok(Self::at(case, state, Progress { ledger, ..Progress::default() }, stages))
    }

    /// A simulation that goes on where `state` and `progress` left off.
    pub fn resume(case: &Case, state: State, progress: Progress) -> Self {
        Self::at(case, state, progress, case.stages())
    }

    fn at(case: &Case, state: State, progress: Progress, stages: Vec<Stage>) -> Self {
        let model = stages[progress.stage.min(stages.len() - 1)].model.clone();
        let began = progress.began.unwrap_or_default();
        let mut model = Model { stage_start: began.time, ..model };
        model.contact.scale_friction(progress.compaction.friction);
        let grading = case.grading();
        Simulation { state, progress, stages, model, grading, began, work: Work::default(), news: Vec::new() }
    }

    /// The stage that is going on; `None` when all are done.
    pub fn stage(&self) -> Option<&Stage> {
        self.stages.get(self.progress.stage)
    }

    /// All stages.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// Mean excess pressure at 13 heights from bottom to top [Pa], after a step with water.
    pub fn profile(&self) -> Option<[f64; 13]> {
        self.work.fluid.profile(&self.state, 2)
    }

    /// What the current stage reads.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The signs of trouble that the last step was the first of its stage to show.
    pub fn news(&self) -> &[Trouble] {
        &self.news
    }

    /// Scratch of the last step: loads, timers.
    pub fn work(&self) -> &Work {
        &self.work
    }

    /// Does one step; `None` when all stages are done.
    ///
    /// # Errors
    /// When the step cannot be done, or the stage passes its `max-time` or `max-steps`.
    pub fn advance(&mut self) -> Result<Option<Event>, RunError> {
        let Some(stage) = self.stages.get(self.progress.stage) else { return Ok(None) };
        let began = match self.progress.began {
            Some(began) => began,
            None => {
                let State { time, step, domain, .. } = &self.state;
                let (top, edges) = (domain.cell.wall_position(5), domain.cell.edges);
                let began = Began { time: *time, step: *step, top, edges };
                self.model = Model { stage_start: began.time, ..stage.model.clone() };
                // Timers are those of the stage; the rest of the scratch is found again by the first step.
                self.work = Work::default();
                if self.model.fluid.is_none() {
                    self.state.fluid = None;
                }
                if stage.consolidation {
                    let consolidation = Consolidation::begin(&self.state, &self.model)
                        .map_err(|error| RunError::Consolidation { stage: stage.name.clone(), error })?;
                    self.progress.consolidation = Some(consolidation);
                }
                self.progress.began = Some(began);
                self.progress.told = Default::default();
                self.progress.compaction = Default::default();
                self.progress.places = measure::places(&self.state);
                self.progress.ledger = self.progress.ledger.map(|_| Ledger::default());
                self.began = began;
                began
            }
        };
        self.model.gravity = at(&stage.gravity, self.state.time - self.model.stage_start);
        let (due, mut found) = (stability::due(&self.state, &self.model), Vec::new());
        let before = self.progress.ledger.and_then(|_| Before::of(&self.state, &self.model));
        let report = match step(&mut self.state, &self.model, &mut self.work) {
            Err(StepError::Outside { trouble, report }) => {
                found.push(trouble);
                *report
            }
            other => other.map_err(|error| RunError::Step { stage: stage.name.clone(), error })?,
        };
        if let (Some(before), Some(ledger)) = (before, &mut self.progress.ledger) {
            ledger.add(&before, &self.state, &self.model, &self.work.loads);
        }
        if due {
            trouble::look(&self.state, &self.model, &mut found);
        }
        if let (Some(water), Some(mesh)) = (&report.water, self.work.fluid.mesh()) {
            let new = self.state.pores().is_some_and(|water| water.made_at_step + 1 == self.state.step);
            let cause = match report.remeshed {
                Some(_) => Cause::Strain(self.work.fluid.repair()),
                None => Cause::Rules,
            };
            self.progress
                .budget
                .add(water, mesh, new.then_some(cause), report.dt)
                .map_err(|error| RunError::Budget { stage: stage.name.clone(), error })?;
        }
        if stage.consolidation
            && let Some(consolidation) = &mut self.progress.consolidation
        {
            consolidation.watch(&self.state, &self.work.fluid);
        }
        let ended = self.ended(stage, began)?;
        let friction = self.progress.compaction.friction;
        if let Some(rule) = &stage.compact
            && self.looks()
        {
            let rests = self.conditions(&stage.until).hold;
            self.progress.compaction.look(rule, measure::porosity(&self.state), rests);
        }
        if self.progress.compaction.friction != friction {
            self.model.contact = stage.model.contact.clone();
            self.model.contact.scale_friction(self.progress.compaction.friction);
        }
        if ended.is_some() {
            trouble::servos(&self.state, &self.model, &mut found);
        }
        self.news.clear();
        for trouble in found {
            match trouble.action(&stage.on) {
                Action::Stop => return Err(RunError::Trouble { stage: stage.name.clone(), trouble }),
                Action::Warn if !self.progress.told[trouble.kind()] => {
                    self.progress.told[trouble.kind()] = true;
                    self.news.push(trouble);
                }
                Action::Warn | Action::Ignore => {}
            }
        }
        let Some(ended) = ended else { return Ok(Some(Event::Step(report))) };
        self.progress.done.push(Done {
            name: stage.name.clone(),
            steps: self.state.step - began.step,
            time: self.state.time - began.time,
            ended,
        });
        self.progress.stage += 1;
        self.progress.began = None;
        Ok(Some(Event::StageEnd(report)))
    }

    /// What ended the stage, if it is at its end.
    fn ended(&self, stage: &Stage, began: Began) -> Result<Option<String>, RunError> {
        let until = &stage.until;
        let (steps, time) = (self.state.step - began.step, self.state.time - began.time);
        if until.time.is_some_and(|end| time >= end) {
            return Ok(Some("time".into()));
        }
        if until.steps.is_some_and(|end| steps >= end) {
            return Ok(Some("steps".into()));
        }
        if !until.waits() {
            return Ok(None);
        }
        let last =
            until.max_steps.is_some_and(|end| steps >= end) || until.max_time.is_some_and(|end| time >= end);
        let last = last || self.progress.compaction.is_stuck();
        if !last && !self.looks() {
            return Ok(None);
        }
        let Conditions { unbalanced, stress, hold } = self.conditions(until);
        let dense = stage.compact.is_none() || self.progress.compaction.reached;
        if hold && dense {
            return Ok(Some("conditions".into()));
        }
        if !last {
            return Ok(None);
        }
        let mut why = Vec::new();
        if let Some((value, limit)) = unbalanced.zip(until.unbalanced) {
            why.push(format!("unbalanced is {value:.3e}, asked {limit:e}"));
        }
        if let Some(((value, what), limit)) = stress.zip(until.stress_error) {
            why.push(format!("the stress {what} is off by {value:.3e}, asked {limit:e}"));
        }
        if let Some(rule) = stage.compact.as_ref().filter(|_| !dense) {
            why.push(format!(
                "the porosity is {:.4}, asked {}, with the friction between grains down to {:.2e} of the stage's",
                measure::porosity(&self.state),
                rule.porosity,
                self.progress.compaction.friction
            ));
        }
        let why = format!("after {steps} steps and {time:.4e} s {}", why.join(" and "));
        Err(RunError::Endless { stage: stage.name.clone(), why })
    }

    /// Whether this step is one of those that look at conditions.
    fn looks(&self) -> bool {
        self.state.step.is_multiple_of(LOOK_EVERY)
    }

    /// What the stage waits for, as it is now.
    fn conditions(&self, until: &Until) -> Conditions {
        let unbalanced =
            until.unbalanced.map(|_| measure::unbalanced(&self.state, &self.model, &self.work.loads));
        let stress = until.stress_error.map(|_| self.stress_error());
        let below = |value: Option<f64>, limit: Option<f64>| value.zip(limit).is_none_or(|(v, l)| v <= l);
        let hold =
            below(unbalanced, until.unbalanced) && below(stress.as_ref().map(|s| s.0), until.stress_error);
        Conditions { unbalanced, stress, hold }
    }

    /// The largest relative distance of a servo wall, or of a held stress of the cell, from its stress, and its name.
    fn stress_error(&self) -> (f64, String) {
        let t = self.state.time - self.model.stage_start;
        let mut worst = (0.0, String::new());
        let mut compare = |found: f64, asked: f64, name: &dyn Fn() -> String| {
            let error = (found - asked).abs() / asked.abs().max(f64::MIN_POSITIVE);
            if error > worst.0 {
                worst = (error, name());
            }
        };
        let stresses = measure::wall_stress(&self.state.domain);
        for (k, face) in self.model.faces.iter().enumerate() {
            if let Solid::Servo { stress, .. } = &face.solid {
                compare(stresses[k], stress.at(t), &|| format!("on the {} wall", FACE_NAMES[k]));
            }
        }
        for (wall, place) in self.model.walls.iter().zip(&self.state.domain.walls) {
            if let (Some(asked), Some((_, along))) =
                (motion::asked(wall, t), motion::servoed(wall, &self.state))
            {
                compare(-place.force.dot(along), asked, &|| format!("on the wall `{}`", wall.name));
            }
        }
        let mut held = self.model.cell.stress.given().peekable();
        if held.peek().is_some() {
            let water = self.work.loads.cell * self.state.domain.cell.volume().recip();
            let stress = measure::contact_stress(&self.state, &self.model) + water;
            for (row, column, signal) in held {
                let name = || format!("{} of the cell", COMPONENTS[3 * row + column]);
                compare(stress.col(column)[row], signal.at(t), &name);
            }
        }
        worst
    }
}

/// What a stage waits for, as it stands.
struct Conditions {
    unbalanced: Option<f64>,
    /// The largest distance from an asked stress, and where.
    stress: Option<(f64, String)>,
    /// Whether all hold.
    hold: bool,
}

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
        let stress = of("stress error", now.stress.map(|s| s.0), until.stress_error);
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
        entry.free_level = simulation.work.fluid.free_level();
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
    Reached {
        porosity: measure::porosity(state),
        coordination: measure::coordination(state),
        friction: (progress.compaction.lowest < 1.0).then_some(progress.compaction.lowest),
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
