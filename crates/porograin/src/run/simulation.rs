//! A case being run: one step after the other, stage after stage. It touches no file.

use crate::budget::{Cause, Unbalanced};
use crate::case::{Case, CaseError, Plan, Stage, Until, at};
use crate::consolidation::{Consolidation, ConsolidationError};
use crate::ledger::{Before, Ledger};
use crate::measure::{self, Region};
use crate::model::Model;
use crate::packing::Grading;
use crate::progress::{Began, Done, Progress};
use crate::rain::Fallen;
use crate::servo::Held;
use crate::stability;
use crate::state::State;
use crate::step::{Report, StepError, Work, step};
use crate::trouble::{self, Action, Trouble};
use crate::watch::Measure;
use std::fmt;

/// Steps between two looks at the conditions of a stage that cost a pass over all contacts.
const LOOK_EVERY: u64 = 50;

/// A case being run: the state, and where in the case it stands. It touches no file.
#[derive(Debug)]
pub struct Simulation {
    /// The state now.
    pub state: State,
    /// Where in the case it stands.
    pub progress: Progress,
    pub(super) stages: Vec<Stage>,
    pub(super) model: Model,
    /// The sizes that were asked for.
    pub(super) grading: Option<Grading>,
    /// Where the case measures.
    pub(super) regions: Vec<Region>,
    /// How the stage of the last step began.
    pub(super) began: Began,
    pub(super) work: Work,
    /// What the last step had to be told of.
    pub(super) news: Vec<Trouble>,
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
    /// A signal has no value.
    Undefined {
        /// Name of the stage.
        stage: String,
        /// What it drives.
        what: String,
        /// When, since the stage began [s].
        time: f64,
    },
    /// A step is so short that time stands still.
    Still {
        /// Name of the stage.
        stage: String,
        /// Its length [s].
        dt: f64,
        /// When [s].
        time: f64,
    },
    /// The box is empty, and no grain finds room to fall.
    Empty {
        /// Name of the stage.
        stage: String,
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
            RunError::Undefined { stage, what, time } => write!(
                f,
                "in the stage `{stage}`, {what} has no finite value {time:.4e} s after its beginning: the formula divides by zero, \
                 or takes the root or logarithm of a negative number"
            ),
            RunError::Still { stage, dt, time } => write!(
                f,
                "in the stage `{stage}`, time stands still at t = {time:.6e} s, where a step is {dt:.3e} s long: the contacts are too \
                 stiff for the mass of the grains, or the grains too fast"
            ),
            RunError::Empty { stage } => write!(
                f,
                "in the stage `{stage}`, no grain finds room to fall: the place where they appear is too small for the first, or \
                 walls are in the way"
            ),
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
        let (grading, regions) = (case.grading(), case.regions());
        Simulation {
            state,
            progress,
            stages,
            model,
            grading,
            regions,
            began,
            work: Work::default(),
            news: Vec::new(),
        }
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
                (self.progress.fallen, self.progress.grown) = Default::default();
                self.state.domain.reference = edges;
                self.progress.places = measure::places(&self.state);
                self.progress.ledger = self.progress.ledger.map(|_| Ledger::default());
                self.began = began;
                began
            }
        };
        self.model.gravity = at(&stage.gravity, self.state.time - self.model.stage_start);
        self.prepare();
        let Some(stage) = self.stages.get(self.progress.stage) else { return Ok(None) };
        if self.state.grains.is_empty() {
            return Err(RunError::Empty { stage: stage.name.clone() });
        }
        let now = self.state.time;
        let t = now - self.model.stage_start;
        for time in [t, t + self.state.dt] {
            if let Some(what) = self.model.undefined(time) {
                return Err(RunError::Undefined { stage: stage.name.clone(), what, time });
            }
        }
        let (due, mut found) = (stability::due(&self.state, &self.model), Vec::new());
        let before = self.progress.ledger.and_then(|_| Before::of(&self.state));
        let report = match step(&mut self.state, &self.model, &mut self.work) {
            Err(StepError::Outside { trouble, report }) => {
                found.push(trouble);
                *report
            }
            other => other.map_err(|error| RunError::Step { stage: stage.name.clone(), error })?,
        };
        if self.state.time <= now {
            return Err(RunError::Still { stage: stage.name.clone(), dt: report.dt, time: now });
        }
        if let (Some(before), Some(ledger)) = (before, &mut self.progress.ledger) {
            ledger.add(&before, &self.state, &self.model, &self.work.loads);
        }
        let ended = self.ended(stage, began)?;
        if due || ended.is_some() {
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
        let friction = self.progress.compaction.friction;
        if let Some(rule) = &stage.compact
            && self.looks()
        {
            let rests = self.conditions(&stage.until).hold;
            self.progress.compaction.look(rule, measure::porosity(&self.state), rests);
        }
        if let Some(rain) = stage.rain.as_ref().filter(|rain| rain.layer.is_some())
            && self.looks()
            && self.conditions(&stage.until).hold
        {
            rain.rests(&mut self.progress.fallen);
        }
        if self.progress.compaction.friction != friction {
            self.model.contact = stage.model.contact.clone();
            self.model.contact.scale_friction(self.progress.compaction.friction);
        }
        if ended.is_some() {
            found.extend(trouble::servo(self.held(), self.state.time));
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

    /// Lets grains fall and grow, before a step, where the stage says so.
    fn prepare(&mut self) {
        let Some(stage) = self.stages.get(self.progress.stage) else { return };
        if stage.rain.is_none() && stage.grow.is_none() {
            return;
        }
        let (state, progress) = (&mut self.state, &mut self.progress);
        let energy = |state: &State| {
            measure::kinetic_energy_beside(state) + measure::elastic_energy(state, &self.model)
        };
        let open = progress.ledger.as_mut().and_then(|ledger| ledger.start.as_mut());
        let before = open.as_ref().map(|_| energy(state));
        let (count, mut changed) = (state.grains.len(), false);
        if let Some(rain) = &stage.rain {
            let t = state.time - self.model.stage_start;
            changed = rain.fall(state, &self.model, t, &mut progress.fallen, &stage.kinds) > 0;
            progress.places.extend_from_slice(&state.grains.position[count..]);
        }
        if let Some(grow) = stage.grow {
            let factor = grow.advance(state, &self.model);
            if factor != 1.0 {
                progress.grown = Some(progress.grown.unwrap_or(1.0) * factor);
                changed = true;
            }
        }
        if !changed {
            return;
        }
        // What that gives the grains is there from the start.
        if let (Some(start), Some(before)) = (open, before) {
            *start += energy(state) - before;
        }
        let timers = std::mem::take(&mut self.work.timers);
        self.work = Work::default();
        self.work.timers = timers;
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
        let fallen = stage.rain.is_none() || self.progress.fallen.enough;
        let grown = stage.grow.is_none_or(|grow| grow.is_dense(&self.state));
        if hold && dense && fallen && grown {
            return Ok(Some("conditions".into()));
        }
        if !last {
            return Ok(None);
        }
        let mut why = Vec::new();
        if let Some((value, limit)) = unbalanced.zip(until.unbalanced) {
            why.push(format!("unbalanced is {value:.3e}, asked {limit:e}"));
        }
        if let Some((Held { servo, error, .. }, limit)) = stress.zip(until.stress_error) {
            why.push(format!("{servo} is off by {error:.3e}, asked {limit:e}"));
        }
        if !fallen {
            let Fallen { count, mass, .. } = self.progress.fallen;
            why.push(format!("not enough grains have found room to fall: {count}, {mass:.3e} kg"));
        }
        if let Some(asked) = stage.grow.filter(|_| !grown).and_then(|grow| grow.porosity) {
            let now = measure::porosity(&self.state);
            why.push(format!("the grains have grown to a porosity of {now:.4}, asked {asked}"));
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
    pub(super) fn conditions(&self, until: &Until) -> Conditions {
        let unbalanced =
            until.unbalanced.map(|_| measure::unbalanced(&self.state, &self.model, &self.work.loads));
        let stress = until.stress_error.and_then(|_| Held::worst(self.held()));
        let below = |value: Option<f64>, limit: Option<f64>| value.zip(limit).is_none_or(|(v, l)| v <= l);
        let hold = below(unbalanced, until.unbalanced)
            && below(stress.as_ref().map(|held| held.error), until.stress_error);
        Conditions { unbalanced, stress, hold }
    }

    /// All that is held at a stress or a force, as it stands.
    fn held(&self) -> Vec<Held> {
        let growth = self.stage().and_then(|stage| stage.grow).and_then(|grow| grow.stress);
        Held::all(&self.state, &self.model, growth, self.work.loads.cell)
    }
}

/// What a stage waits for, as it stands.
pub(super) struct Conditions {
    pub(super) unbalanced: Option<f64>,
    /// The servo that is furthest off.
    pub(super) stress: Option<Held>,
    /// Whether all hold.
    pub(super) hold: bool,
}
