//! How far a run has come.

use crate::budget::Budget;
use crate::compaction::Compaction;
use crate::consolidation::Consolidation;
use crate::ledger::Ledger;
use crate::rain::Fallen;
use crate::trouble::KINDS;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Where in a case a simulation stands: with the [`State`], all that a restart needs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Index of the stage that is going on; the number of stages when all are done.
    pub stage: usize,
    /// How the stage began; `None` before its first step.
    pub began: Option<Began>,
    /// The stages that are done.
    pub done: Vec<Done>,
    /// The last stage that was to be compared with Terzaghi's theory, as seen so far.
    pub consolidation: Option<Consolidation>,
    /// How far the compaction of the stage has come.
    pub compaction: Compaction,
    /// Where the grains were when the stage began, in order of their id [m].
    pub places: Vec<DVec3>,
    /// Work and losses of the stage, where the case watches them.
    pub ledger: Option<Ledger>,
    /// How far the rain of the stage has come.
    pub fallen: Fallen,
    /// By how much the stage has grown all radii; `None` where nothing grew.
    pub grown: Option<f64>,
    /// Which kinds of trouble were told in the stage.
    pub told: [bool; KINDS],
    /// What must balance about the water, over all stages.
    pub budget: Budget,
}

/// How a stage began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Began {
    /// [s]
    pub time: f64,
    /// Steps done before it.
    pub step: u64,
    /// Height of the top face [m].
    pub top: f64,
    /// Edges of the cell, as columns [m].
    pub edges: glam::DMat3,
}

/// How a stage ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Its name.
    pub name: String,
    /// Steps it took.
    pub steps: u64,
    /// Seconds it lasted, simulated.
    pub time: f64,
    /// What ended it.
    pub ended: String,
}

impl Began {
    /// How far the top face has come down since [m].
    pub fn settlement(&self, state: &crate::state::State) -> f64 {
        self.top - state.domain.cell.wall_position(5)
    }
}
