//! What the case says: values that never change during a step.

use crate::boundary::{FACE_NAMES, Face, Signal, Solid, Water};
use crate::cell::{COMPONENTS, CellRule, Components};
use crate::contact::Laws;
use crate::darcy::Darcy;
use crate::membrane::Membrane;
use crate::pores::{PointWater, Pores};
use crate::walls::motion::Servoed;
use crate::walls::{Motion, Wall};
use glam::DVec3;
use serde::Deserialize;

/// Everything a step reads besides the state.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// How long a step is.
    pub time_step: TimeStep,
    /// [m/s²]
    pub gravity: DVec3,
    /// The laws of the contacts.
    pub contact: Laws,
    /// Cundall's local damping D (Catalano 2.15) [-], on grains and servoed walls.
    pub damping: f64,
    /// Rules of the six faces.
    pub faces: [Face; 6],
    /// The walls that the case adds.
    pub walls: Vec<Wall>,
    /// The flexible membrane around the sample.
    pub membrane: Option<Membrane>,
    /// What drives the periodic cell.
    pub cell: CellRule,
    /// The water; `None` when the stage is dry.
    pub fluid: Option<FluidModel>,
    /// The time at which the stage began: signals count from here [s].
    pub stage_start: f64,
}

/// How long a step is.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TimeStep {
    /// `safety` times the stability limit, renewed every [`RENEW_EVERY`] steps.
    Automatic {
        /// Fraction of the limit.
        safety: f64,
    },
    /// Always this long [s].
    Fixed(f64),
}

impl Model {
    /// Whether some pressure of the water is given, at a face or a point: otherwise incompressible water knows
    /// differences of pressure only.
    pub fn has_pressure(&self) -> bool {
        let point = |fluid: &FluidModel| match &fluid.flow {
            Flow::Pores(pores) => pores.point.iter().any(|p| matches!(p.water, PointWater::Pressure(_))),
            Flow::Darcy(_) => false,
        };
        self.faces.iter().any(|face| matches!(face.water, Water::Pressure(_)))
            || self.fluid.as_ref().is_some_and(point)
    }

    /// What moves or presses the grains by a signal that has no finite value so long after the beginning of the stage [s].
    pub fn undefined(&self, t: f64) -> Option<String> {
        let bad = |signal: &Signal| !signal.at(t).is_finite();
        if !self.gravity.is_finite() {
            return Some("gravity".into());
        }
        for (face, name) in self.faces.iter().zip(FACE_NAMES) {
            match &face.solid {
                Solid::Fixed => {}
                Solid::Moving { velocity } if !velocity.iter().any(bad) => {}
                Solid::Servo { stress, .. } if !bad(stress) => {}
                Solid::Moving { .. } => return Some(format!("the velocity of the {name} wall")),
                Solid::Servo { .. } => return Some(format!("the stress on the {name} wall")),
            }
        }
        for Wall { name, motion, .. } in &self.walls {
            let (what, found) = match motion {
                Motion::Fixed => continue,
                Motion::Moving { velocity } => ("velocity", velocity.iter().any(bad)),
                Motion::Rotating { rate, .. } => ("rate", bad(rate)),
                Motion::Servo { load: Servoed::Force(load) | Servoed::Stress(load), .. } => {
                    ("load", bad(load))
                }
            };
            if found {
                return Some(format!("the {what} of the wall `{name}`"));
            }
        }
        if self.membrane.as_ref().is_some_and(|membrane| bad(&membrane.stress)) {
            return Some("the stress of the membrane".into());
        }
        let of_cell = |components: &Components, what: &str| {
            let (row, column, _) = components.given().find(|given| bad(given.2))?;
            Some(format!("the {what} {} of the cell", COMPONENTS[3 * row + column]))
        };
        of_cell(&self.cell.gradient, "gradient").or_else(|| of_cell(&self.cell.stress, "stress"))
    }
}

impl Default for TimeStep {
    fn default() -> Self {
        TimeStep::Automatic { safety: 0.8 }
    }
}

/// Steps between two looks at the stability limit.
pub const RENEW_EVERY: u64 = 100;

/// The water in the pores.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct FluidModel {
    /// Dynamic viscosity [Pa s].
    pub viscosity: f64,
    /// [kg/m³]
    #[serde(default = "water")]
    pub density: f64,
    /// Bulk modulus K_f [Pa]; left out: incompressible.
    pub bulk_modulus: Option<f64>,
    /// How its flow is computed.
    #[serde(default)]
    pub flow: Flow,
}

fn water() -> f64 {
    1000.0
}

/// The choice of flow model.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Flow {
    /// Pore by pore (Catalano ch. 3).
    Pores(Pores),
    /// Darcy's law on a grid coarser than the grains (Goodarzi et al. 2013).
    Darcy(Darcy),
}

impl Default for Flow {
    fn default() -> Self {
        Flow::Pores(Pores::default())
    }
}
