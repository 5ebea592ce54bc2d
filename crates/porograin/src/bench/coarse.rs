//! The cost of the step with coarse water: a packing consolidates on a grid.

use super::{Clock, DENSITY, dry};
use crate::awake::awake;
use crate::boundary::{Domain, Signal, Solid, Water};
use crate::darcy::{Census, Darcy};
use crate::measure::{porosity, wall_stress};
use crate::model::{Flow, FluidModel, Model};
use crate::state::State;
use crate::step::StepError;
use glam::DVec3;
use serde::Serialize;

/// The cost of the step with coarse water.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoarseBench {
    /// Number of grains.
    pub grains: usize,
    /// Cells of the grid.
    pub cells: usize,
    /// Steps timed.
    pub steps: usize,
    /// Median time of a step [s].
    pub seconds_per_step: f64,
    /// Median time of a step of the same case without water, measured by turns with the other [s].
    pub dry_seconds_per_step: f64,
    /// The first less the second, over the second: what the water costs.
    pub water_over_dry: f64,
    /// Mean time of each phase [s], by the names of the step's page: without water and with it.
    pub phases: Vec<(&'static str, [f64; 2])>,
    /// Mean number of iterations of the pressure solve.
    pub iterations_per_step: f64,
    /// Viscosity of the water [Pa s].
    pub viscosity: f64,
    /// How much the top has sunk by the end [m].
    pub settlement: f64,
}

/// What the top servo adds to the stress the packing has already [Pa].
const LOAD: f64 = 1e3;
/// Steps with or without water before it is the turn of the others.
const TURN: usize = 50;
/// `dt mu / (k rho)`, as in the benchmark of the pores.
const VISCOUS_NUMBER: f64 = 0.2;

/// Consolidates a packing (centres and radii [m], in any order) as the benchmark of the pores does, with eight grains
/// per cell of the grid and all defaults but, where given, the residual of the pressure solve.
///
/// # Errors
/// Whatever stops a step.
pub fn coarse(
    position: Vec<DVec3>,
    radius: Vec<f64>,
    domain: Domain,
    steps: usize,
    residual: Option<f64>,
) -> Result<CoarseBench, StepError> {
    awake(|| consolidate(&mut dry::at_rest(position, radius, domain), steps, residual))
}

fn consolidate(state: &mut State, steps: usize, residual: Option<f64>) -> Result<CoarseBench, StepError> {
    dry::hold(state, &dry::dry_model(), steps / 4)?;
    let mut settings = Darcy::default();
    settings.residual = residual.unwrap_or(settings.residual);
    let diameter = 2.0 * state.grains.radius.iter().sum::<f64>() / state.grains.len() as f64;
    let permeability = settings.permeability.of(porosity(state), diameter).z;
    let viscosity = VISCOUS_NUMBER * permeability * DENSITY / state.dt;
    let mut model = dry::dry_model();
    model.damping = 0.0;
    let stress = Signal::Constant(wall_stress(&state.domain)[5] + LOAD);
    model.faces[5].solid = Solid::Servo { stress, mass: None, speed: None };
    for face in [4, 5] {
        model.faces[face].water = Water::Pressure(Signal::Constant(0.0));
    }
    state.grains.velocity.fill(DVec3::ZERO);
    state.grains.spin.fill(DVec3::ZERO);
    state.dt = 0.0;
    let fluid = FluidModel { viscosity, density: 1000.0, bulk_modulus: None, flow: Flow::Darcy(settings) };
    let wet = Model { fluid: Some(fluid), ..model.clone() };
    let (steps, top) = (steps.max(1), state.domain.cell.upper().z);
    let mut without = state.clone();
    let (mut dry, mut timed) = (Clock::warm(&mut without, &model, steps)?, Clock::warm(state, &wet, steps)?);
    // By turns: whatever else the machine does meets both.
    for start in (0..steps).step_by(TURN) {
        let turn = TURN.min(steps - start);
        dry.run(turn)?;
        timed.run(turn)?;
    }
    let (dry, timed) = (dry.stop(), timed.stop());
    let water = &timed.water;
    let before = |name| dry.phases.iter().find(|phase| phase.0 == name).map_or(0.0, |phase| phase.1);
    let phases = (timed.phases.iter())
        .map(|&(name, part)| (name, [before(name) * dry.mean, part * timed.mean]))
        .collect();
    let Census { cells, .. } = timed.work.fluid.darcy.grid().map_or_else(Census::default, |grid| grid.census);
    Ok(CoarseBench {
        grains: state.grains.len(),
        cells,
        steps: timed.steps,
        seconds_per_step: timed.seconds_per_step,
        dry_seconds_per_step: dry.seconds_per_step,
        water_over_dry: timed.seconds_per_step / dry.seconds_per_step - 1.0,
        phases,
        iterations_per_step: water.iter().map(|w| w.iterations as f64).sum::<f64>()
            / water.len().max(1) as f64,
        viscosity,
        settlement: top - state.domain.cell.upper().z,
    })
}
