//! Stages: an ordered list, each with what it overrides and when it ends.

use super::{FaceTable, WallRule};
use crate::boundary::Signal;
use crate::cell::CellRule;
use crate::compaction::Compact;
use crate::contact::Law;
use crate::growth::Grow;
use crate::membrane::Membrane;
use crate::model::{Flow, TimeStep};
use crate::rain::Rain;
use crate::trouble::On;
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One stage: what differs from the case itself during it, and when it ends. Nothing carries over to the next stage.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct StageTable {
    /// A short name.
    pub name: String,
    /// When it ends.
    pub until: Until,
    /// Another contact law.
    pub contact: Option<Law>,
    /// Another friction angle between grains [degrees].
    pub friction: Option<f64>,
    /// Other rules of faces.
    #[serde(default)]
    pub face: FaceTable,
    /// What is different about walls, by name.
    #[serde(default)]
    pub wall: BTreeMap<String, WallRule>,
    /// Another membrane, complete.
    pub membrane: Option<Membrane>,
    /// Another rule of the periodic cell, complete.
    pub cell: Option<CellRule>,
    /// Another gravity [m/s²].
    pub gravity: Option<[Signal; 3]>,
    /// Another damping.
    pub damping: Option<f64>,
    /// Whether contacts give back what the time integration takes, in this stage.
    pub conserve_energy: Option<bool>,
    /// Another time step.
    pub time_step: Option<TimeStep>,
    /// `false`: dry. A table: other properties of the water.
    pub fluid: Option<Water>,
    /// Grains to let fall.
    pub rain: Option<Rain>,
    /// What to grow the grains to.
    pub grow: Option<Grow>,
    /// The porosity to compact to.
    pub compact: Option<Compact>,
    /// Another choice of what to do about signs of trouble.
    pub on: Option<On>,
    /// Whether to compare the stage with Terzaghi's theory of consolidation.
    #[serde(default)]
    pub consolidation: bool,
}

/// What a stage says of the water.
#[derive(Clone, Debug, PartialEq)]
pub enum Water {
    /// `fluid = true` or `false`: the water of the case, or none.
    Present(bool),
    /// A table: what it gives replaces what the case says.
    Other(Box<Liquid>),
}

/// Properties of the water that a stage replaces.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Liquid {
    /// Dynamic viscosity [Pa s].
    pub viscosity: Option<f64>,
    /// [kg/m³]
    pub density: Option<f64>,
    /// Bulk modulus [Pa].
    pub bulk_modulus: Option<f64>,
    /// How its flow is computed.
    pub flow: Option<Flow>,
}

impl<'de> Deserialize<'de> for Water {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct BoolOrTable;
        impl<'de> Visitor<'de> for BoolOrTable {
            type Value = Water;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("true, false or a table such as { viscosity = 1e-3 }")
            }
            fn visit_bool<E>(self, present: bool) -> Result<Water, E> {
                Ok(Water::Present(present))
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Water, A::Error> {
                let liquid = Liquid::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(Water::Other(Box::new(liquid)))
            }
        }
        deserializer.deserialize_any(BoolOrTable)
    }
}

/// When a stage ends: at `time` or `steps`, or as soon as all the other conditions hold together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Until {
    /// After so many seconds.
    pub time: Option<f64>,
    /// After so many steps.
    pub steps: Option<u64>,
    /// When the mean resultant on a grain is below this part of the mean contact force (Catalano 2.16).
    pub unbalanced: Option<f64>,
    /// When every servo is within this part of what is asked, as in [`Held::error`](crate::servo::Held::error).
    pub stress_error: Option<f64>,
    /// The stage fails if its conditions do not hold after so many seconds.
    pub max_time: Option<f64>,
    /// The stage fails if its conditions do not hold after so many steps.
    pub max_steps: Option<u64>,
}

impl Until {
    /// Whether there is any condition to wait for, besides time and steps.
    pub fn waits(&self) -> bool {
        self.unbalanced.is_some() || self.stress_error.is_some()
    }
}
