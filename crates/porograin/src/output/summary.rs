//! `summary.json`: what a run did and what it found.

use crate::budget::Budget;
use crate::consolidation::{Comparison, Consolidation, Point};
use crate::darcy::Census;
use crate::pores::Stepping;
use crate::timers::Timers;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The content of `summary.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Version of the program.
    pub version: String,
    /// Title of the case.
    pub title: String,
    /// Whether all stages are done.
    pub finished: bool,
    /// The stages begun so far.
    pub stages: Vec<StageSummary>,
    /// What was measured on the sample.
    #[serde(default)]
    pub sample: Sample,
    /// Comparison with Terzaghi's theory, where a stage asked for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terzaghi: Option<Terzaghi>,
    /// What must balance about the water pore by pore: the worst seen, and the meshes made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// What a user should know before trusting the numbers.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// One stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageSummary {
    /// Its name.
    pub name: String,
    /// Steps.
    pub steps: u64,
    /// Simulated time [s].
    pub time: f64,
    /// Wall time [s], of all sittings.
    pub seconds: f64,
    /// Wall time by phase of the step [s], of all sittings.
    pub phases: BTreeMap<String, f64>,
    /// What ended it; `running` while it goes on.
    pub ended: String,
    /// With water pore by pore: whether its steps are explicit or implicit, as chosen with the last mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub water_step: Option<Stepping>,
    /// With incompressible water and no pressure given anywhere: pressures count from their mean.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub free_level: bool,
    /// The sample as the stage leaves it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reached: Option<Reached>,
}

/// What a stage made of the sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reached {
    /// Void part of the box [-].
    pub porosity: f64,
    /// Contacts per grain [-].
    pub coordination: f64,
    /// Where the stage compacted to a porosity: the lowest friction angle on the way, over that of the stage [-].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// How many grains the stage let fall.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fallen: Option<usize>,
    /// Their mass [kg].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fallen_mass: Option<f64>,
    /// By how much the stage grew all radii [-].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grown: Option<f64>,
    /// The grading: diameters that 10, 30, 50, 60 and 90 % of the mass are finer than [m].
    #[serde(default)]
    pub diameters: [f64; 5],
    /// Grains that carry nothing.
    pub rattlers: usize,
    /// Stress carried by the contacts along x, y, z [Pa].
    pub stress: [f64; 3],
}

/// What was measured on the sample; `None` is what nobody measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Number of grains.
    pub grains: usize,
    /// Number of contacts.
    pub contacts: usize,
    /// Void part of the box [-].
    pub porosity: f64,
    /// Of a cloud: greatest difference of passing mass from the grading asked for [-].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grading_error: Option<f64>,
    /// Number of pores.
    pub pores: Option<usize>,
    /// Number of throats.
    pub throats: Option<usize>,
    /// Pores merged with a neighbour because their radical centres coincide.
    pub merged: Option<usize>,
    /// Cells of the grid of coarse water, when it was last made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<Census>,
    /// Along z [m²].
    pub permeability: Option<f64>,
    /// [Pa]
    pub oedometric_modulus: Option<f64>,
}

/// Comparison with Terzaghi's theory of consolidation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Terzaghi {
    /// Largest error of the pressure at mid-height for `T_v > 0.05`, as part of the load.
    pub max_error: f64,
    /// Largest error of the settlement for `T_v > 0.05`, as part of that of the dry test.
    pub max_settlement_error: f64,
    /// `max_error` had path and modulus been those of the box, walls and held pores included.
    pub max_error_box_path: f64,
    /// `max_error` had the permeability been that without rattlers.
    pub max_error_without_rattlers: f64,
    /// Largest pressure at mid-height for `T_v < 0.05`, as part of the load; theory: 1.
    pub first_pressure: f64,
    /// Added stress on the top [Pa].
    pub load: f64,
    /// Coefficient of consolidation `C_v` [m²/s].
    pub coefficient: f64,
    /// Drainage path: of the free pores, volume over section [m].
    pub path: f64,
    /// Drainage path of the box [m].
    pub box_path: f64,
    /// Oedometric modulus of the bulk, away from the walls [Pa].
    pub modulus: f64,
    /// Permeability of the bulk without rattlers, over that with every grain held.
    pub permeable_without_rattlers: f64,
    /// Part of the settlement that comes at once, that of the drained layers at the walls.
    pub immediate_settlement: f64,
    /// The curves, measured and in theory.
    pub curves: Vec<Point>,
}

impl Terzaghi {
    /// The numbers of a comparison.
    pub fn new(consolidation: &Consolidation, comparison: &Comparison) -> Self {
        Terzaghi {
            max_error: comparison.max_error,
            max_settlement_error: comparison.max_settlement_error,
            max_error_box_path: comparison.max_error_box_path,
            max_error_without_rattlers: comparison.max_error_without_rattlers,
            first_pressure: comparison.first_pressure,
            load: consolidation.load,
            coefficient: consolidation.coefficient(),
            path: consolidation.path(),
            box_path: consolidation.box_path(),
            modulus: consolidation.modulus,
            permeable_without_rattlers: consolidation.permeability_without_rattlers
                / consolidation.permeability,
            immediate_settlement: consolidation.immediate(),
            curves: comparison.points.clone(),
        }
    }
}

impl Summary {
    /// Of a run that begins.
    pub fn new(title: &str) -> Self {
        Summary { version: env!("CARGO_PKG_VERSION").into(), title: title.into(), ..Summary::default() }
    }
}

impl StageSummary {
    /// Adds wall time by phase.
    pub fn add(&mut self, timers: &Timers) {
        for (phase, spent) in timers.phases() {
            *self.phases.entry((*phase).to_owned()).or_default() += spent.as_secs_f64();
        }
    }
}
