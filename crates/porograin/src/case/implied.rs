//! What the numbers of a case imply, before anything is simulated. Estimates, each with its formula.

use super::{Case, CaseError, Plan, cost};
use crate::boundary::{Signal, Solid};
use crate::darcy;
use crate::fluid;
use crate::model::{Flow, Model, TimeStep};
use crate::pores::Stepping;
use crate::stability::{self, Cause};
use serde::Serialize;

/// Pores per grain of a random packing, measured on dense walled packings.
const PORES_PER_GRAIN: f64 = 6.6;
/// Porosity of a random packing after compaction, for the estimate of its permeability.
const PACKED_POROSITY: f64 = 0.4;
/// Bytes a grain takes: arrays of grain, contacts, neighbours; and what its pores add.
const BYTES_PER_GRAIN: [f64; 2] = [1.5e3, 20e3];

/// How many times shorter steps become once grains in free flight have packed: each then has several contacts. Measured on the
/// examples 01, 05 and 14: 1.51 to 1.56.
const PACKED_STEPS: f64 = 1.5;

/// What a case implies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Implied {
    /// Title of the case.
    pub title: String,
    /// Number of grains.
    pub grains: usize,
    /// Least, mean and greatest radius [m].
    pub radius: [f64; 3],
    /// Part of the box the grains fill at the start [-].
    pub solid_fraction: f64,
    /// Pores of the saturated sample, 6.6 per grain, where the flow is computed pore by pore.
    pub pores: Option<usize>,
    /// Memory [bytes].
    pub memory: f64,
    /// The stages.
    pub stages: Vec<ImpliedStage>,
}

/// What one stage implies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImpliedStage {
    /// Its name.
    pub name: String,
    /// Stable time step, times the safety; or the fixed one [s].
    pub time_step: f64,
    /// What limits it.
    pub cause: String,
    /// Steps, when it ends at a time or a number of steps; of grains that are still in free flight, as many as they will take when
    /// packed.
    pub steps: Option<u64>,
    /// Wall time of these on one core [s].
    pub seconds: Option<f64>,
    /// Contact modulus over the largest servo stress: above 1e3 grains are rigid for most purposes.
    pub stiffness_number: Option<f64>,
    /// What the water implies.
    pub water: Option<ImpliedWater>,
    /// Cells of its grid along x, y, z, where it is coarse.
    pub cells: Option<[usize; 3]>,
}

/// What the water implies, with the permeability of Kozeny-Carman at porosity 0.4.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ImpliedWater {
    /// `d² n³ / (180 (1 - n)²)` [m²].
    pub permeability: f64,
    /// Seepage speed under the largest servo stress over the height of the box [m/s].
    pub seepage: f64,
    /// `rho_f v d / mu` with that speed: below 1 the flow is viscous, as the model supposes.
    pub reynolds: f64,
    /// `rho_s v d / (9 mu)` with that speed: the inertia of grains against the drag.
    pub stokes: f64,
    /// `(H/2)² mu / (k E/4)`: consolidation with both ends drained, the sample four times softer than its contacts [s].
    pub consolidation: f64,
    /// How many times the water would shorten an explicit step: `800 mu / (d sqrt(rho_s E))`.
    pub shortens: f64,
    /// Whether its steps will be implicit, by that estimate or by the case.
    pub implicit: bool,
    /// Whether no pressure is given anywhere and the water is incompressible, so that pressures count from their mean.
    pub free_level: bool,
}

impl Case {
    /// What the numbers imply; makes the grains.
    ///
    /// # Errors
    /// When the grains cannot be made.
    pub fn implied(&self) -> Result<Implied, CaseError> {
        let Plan { mut state, stages } = self.plan()?;
        if let (true, Some(rain)) = (state.grains.is_empty(), &stages[0].rain) {
            // What is going to fall stands for what is there.
            let [base, floor] = [self.domain.size[0] * self.domain.size[1], self.domain.origin[2]];
            state.grains = rain.sample(base, floor, self.grains.density);
        }
        let grains = &state.grains;
        let count = grains.len();
        let mean = grains.radius.iter().sum::<f64>() / count as f64;
        let least = grains.radius.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = grains.radius.iter().copied().fold(0.0, f64::max);
        let solid_fraction = grains.volume() / state.domain.cell.volume();
        let pores = |model: &Model| matches!(model.fluid.as_ref().map(|f| &f.flow), Some(Flow::Pores(_)));
        let wet = stages.iter().any(|s| pores(&s.model));
        let mut implied = Vec::new();
        for stage in &stages {
            let model = &stage.model;
            let limit = stability::limit(&state, model);
            let (time_step, cause) = match model.time_step {
                TimeStep::Automatic { safety } => (safety * limit.seconds, limit.cause.to_string()),
                TimeStep::Fixed(dt) => (dt, "fixed by the case".into()),
            };
            state.dt = time_step;
            let until = &stage.until;
            let later = match (model.time_step, limit.cause) {
                (TimeStep::Automatic { .. }, Cause::Flight(_)) => time_step / PACKED_STEPS,
                _ => time_step,
            };
            let by_time = until.time.map(|t| (t / later).ceil() as u64);
            let steps = by_time.into_iter().chain(until.steps).min();
            let young = model.contact.all.young();
            let stress = largest_stress(model);
            let water: Option<ImpliedWater> = model.fluid.as_ref().map(|fluid| {
                let (d, n) = (2.0 * mean, PACKED_POROSITY);
                let height = self.domain.size[2];
                let shortens = 800.0 * fluid.viscosity / (d * (self.grains.density * young).sqrt());
                let permeability = d * d * n.powi(3) / (180.0 * (1.0 - n).powi(2));
                let seepage = permeability / fluid.viscosity * stress.unwrap_or(0.0) / height;
                ImpliedWater {
                    permeability,
                    seepage,
                    reynolds: fluid.density * seepage * d / fluid.viscosity,
                    stokes: self.grains.density * seepage * d / (9.0 * fluid.viscosity),
                    consolidation: 0.25 * height * height * fluid.viscosity / (permeability * young / 4.0),
                    shortens,
                    free_level: fluid.bulk_modulus.is_none() && !model.has_pressure(),
                    implicit: match &fluid.flow {
                        Flow::Pores(pores) => match pores.step {
                            Stepping::Auto => shortens > fluid::PAYS,
                            chosen => chosen == Stepping::Implicit,
                        },
                        Flow::Darcy(_) => true,
                    },
                }
            });
            let mut per_step = cost::dry(count as f64, &model.contact);
            if let (Some(Flow::Pores(flow)), Some(water)) = (model.fluid.as_ref().map(|f| &f.flow), &water) {
                let pores = PORES_PER_GRAIN * count as f64;
                let (method, period) = (flow.solver.method(), fluid::EXPECTED_SOLVES);
                per_step += cost::pores(count as f64, pores, method, water.implicit, period);
            }
            let cells = match model.fluid.as_ref().map(|fluid| &fluid.flow) {
                Some(Flow::Darcy(darcy)) => {
                    let size = state.domain.cell.upper() - state.domain.cell.origin;
                    Some(darcy::counts(darcy.cells, size, grains))
                }
                _ => None,
            };
            if let Some(cells) = cells {
                per_step += cost::coarse(count as f64, cells.iter().product::<usize>() as f64);
            }
            implied.push(ImpliedStage {
                name: stage.name.clone(),
                time_step,
                cause,
                steps,
                seconds: steps.map(|n| n as f64 * per_step),
                stiffness_number: stress.map(|s| young / s),
                cells,
                water,
            });
        }
        Ok(Implied {
            title: self.title.clone(),
            grains: count,
            radius: [least, mean, greatest],
            solid_fraction,
            pores: wet.then_some((PORES_PER_GRAIN * count as f64) as usize),
            memory: count as f64 * (BYTES_PER_GRAIN[0] + if wet { BYTES_PER_GRAIN[1] } else { 0.0 }),
            stages: implied,
        })
    }
}

/// The largest stress any servo wall asks for, in size [Pa].
fn largest_stress(model: &Model) -> Option<f64> {
    let largest = |signal: &Signal| match signal {
        Signal::Constant(value) => value.abs(),
        Signal::Ramp { from, to, .. } => from.abs().max(to.abs()),
        Signal::Sine { mean, amplitude, .. } => mean.abs() + amplitude.abs(),
        Signal::Table(points) => points.iter().map(|p| p[1].abs()).fold(0.0, f64::max),
        // A servo's formula is one of time only; its beginning says the order of magnitude.
        Signal::Expression(_) => signal.at(0.0).abs(),
    };
    let stresses = model.faces.iter().filter_map(|face| match &face.solid {
        Solid::Servo { stress, .. } => Some(largest(stress)),
        Solid::Fixed | Solid::Moving { .. } => None,
    });
    stresses.reduce(f64::max).filter(|&s| s > 0.0)
}
