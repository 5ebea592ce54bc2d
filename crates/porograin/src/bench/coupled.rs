//! The cost of the step with water: a packing consolidates.

use super::{DENSITY, SpeedUp, dry, timed};
use crate::awake::awake;
use crate::boundary::{Domain, Signal, Slip, Solid, Water};
use crate::measure::wall_stress;
use crate::model::{Flow, FluidModel, Model};
use crate::packing::CloudError;
use crate::permeability::{PermeabilityError, Problem, measure};
use crate::pores::{Conductance, Coupling, Pores, Remesh, Solver, Stepping};
use crate::state::State;
use crate::step::StepError;
use glam::DVec3;
use porograin_linear::Method;
use serde::Serialize;
use std::fmt;

/// The cost of the coupled step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoupledBench {
    /// Number of grains.
    pub grains: usize,
    /// Number of contacts, those with walls included, at the end.
    pub contacts: usize,
    /// Number of pores.
    pub pores: usize,
    /// Steps timed.
    pub steps: usize,
    /// Median time of a step [s].
    pub seconds_per_step: f64,
    /// Median time of a dry step of the same packing, measured just before [s].
    pub dry_seconds_per_step: f64,
    /// The first over the second.
    pub ratio_to_dry: f64,
    /// What more than one thread gains.
    pub speed_up: Option<SpeedUp>,
    /// Share of each phase, by the names of the step's page.
    pub phases: Vec<(&'static str, f64)>,
    /// Mean number of iterations of the pressure solve.
    pub iterations_per_step: f64,
    /// How the pressures are found.
    #[serde(serialize_with = "name")]
    pub solver: Method,
    /// Relative residual at which the pressure solve stops.
    pub residual: f64,
    /// The conductance of the throats.
    pub conductance: &'static str,
    /// Viscosity of the water [Pa s].
    pub viscosity: f64,
    /// Intrinsic permeability of the packing [m²].
    pub permeability: f64,
    /// Length of a step [s].
    pub dt: f64,
    /// `dt mu / (k rho)` [-], rho the density of the grains.
    pub viscous_number: f64,
    /// What limits the step.
    pub limit: String,
    /// The stress added on the top [Pa].
    pub load: f64,
    /// How much the top has sunk by the end [m].
    pub settlement: f64,
}

/// What the top servo adds to the stress the packing has already [Pa].
const LOAD: f64 = 1e3;
/// `dt mu / (k rho)` unless a viscosity is given, dt the length of a dry step and rho the density of the grains.
const VISCOUS_NUMBER: f64 = 0.2;
/// Relative residual of the pressure solve unless given.
pub const RESIDUAL: f64 = 1e-6;
/// The conductance: that of the thesis and of the codes to compare with.
const CONDUCTANCE: Conductance = Conductance::hydraulic_radius();

fn name<S: serde::Serializer>(method: &Method, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(method)
}

/// Why the benchmark failed.
#[derive(Debug)]
pub enum BenchError {
    /// The permeability that the viscosity is chosen by.
    Permeability(PermeabilityError),
    /// A cloud of grains.
    Cloud(CloudError),
    /// A step.
    Step(StepError),
}

impl fmt::Display for BenchError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            BenchError::Permeability(error) => error.fmt(f),
            BenchError::Cloud(error) => error.fmt(f),
            BenchError::Step(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for BenchError {}

impl From<CloudError> for BenchError {
    fn from(error: CloudError) -> Self {
        BenchError::Cloud(error)
    }
}

impl From<StepError> for BenchError {
    fn from(error: StepError) -> Self {
        BenchError::Step(error)
    }
}

/// Consolidates a packing (centres and radii [m], in any order): it is held dry first, which gives the cost of the dry
/// step and the stress at the top; then water fills it, the top becomes a servo with 1 kPa more, the other walls
/// stay fixed, top and bottom are drained, the sides are mirrors, and the mesh is kept. `steps` steps are
/// timed after a tenth as many to warm up. The relative `residual` of the pressure solve is [`RESIDUAL`] unless given.
///
/// # Errors
/// [`BenchError`].
pub fn coupled(
    position: Vec<DVec3>,
    radius: Vec<f64>,
    domain: Domain,
    steps: usize,
    viscosity: Option<f64>,
    residual: Option<f64>,
) -> Result<CoupledBench, BenchError> {
    let mut state = dry::at_rest(position, radius, domain);
    let (mut bench, model) = awake(|| consolidate(&mut state, steps, viscosity, residual))?;
    bench.speed_up = dry::speed_up(&mut state, &model, steps)?;
    Ok(bench)
}

fn consolidate(
    state: &mut State,
    steps: usize,
    viscosity: Option<f64>,
    residual: Option<f64>,
) -> Result<(CoupledBench, Model), BenchError> {
    let held = dry::hold(state, &dry::dry_model(), steps)?;
    let permeability = permeability(state).map_err(BenchError::Permeability)?;
    let viscosity = viscosity.unwrap_or(VISCOUS_NUMBER * permeability * DENSITY / state.dt);
    let residual = residual.unwrap_or(RESIDUAL);
    let model = model(wall_stress(&state.domain)[5] + LOAD, viscosity, residual);
    state.grains.velocity.fill(DVec3::ZERO);
    state.grains.spin.fill(DVec3::ZERO);
    state.dt = 0.0;
    let top = state.domain.cell.upper().z;
    let timed = timed(state, &model, steps)?;
    let water = &timed.water;
    let limit = crate::stability::with_water(crate::stability::limit(state, &model), state, &model);
    let bench = CoupledBench {
        grains: state.grains.len(),
        contacts: state.contacts.len(),
        pores: timed.work.fluid.mesh().map_or(0, |mesh| mesh.census.pores),
        steps: timed.steps,
        seconds_per_step: timed.seconds_per_step,
        dry_seconds_per_step: held.seconds_per_step,
        ratio_to_dry: timed.seconds_per_step / held.seconds_per_step,
        phases: timed.phases,
        iterations_per_step: water.iter().map(|w| w.iterations as f64).sum::<f64>()
            / water.len().max(1) as f64,
        solver: timed.work.fluid.setup().map_or(Method::Auto, |setup| setup.method),
        residual,
        conductance: CONDUCTANCE.name(),
        viscosity,
        permeability,
        dt: state.dt,
        viscous_number: state.dt * viscosity / (permeability * DENSITY),
        limit: limit.cause.to_string(),
        load: LOAD,
        settlement: top - state.domain.cell.upper().z,
        speed_up: None,
    };
    Ok((bench, model))
}

/// Of the packing as it stands [m²].
fn permeability(state: &State) -> Result<f64, PermeabilityError> {
    let problem = Problem {
        axis: 2,
        drop: 1.0,
        sides: Slip::Symmetry,
        viscosity: 1.0,
        conductance: CONDUCTANCE,
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: 1e-6,
    };
    Ok(measure(&state.domain.cell, &state.grains.position, &state.grains.radius, &problem)?.permeability)
}

/// The dry model with water, a servo of `stress` [Pa] on top, and the grains not damped by anything but the water.
fn model(stress: f64, viscosity: f64, residual: f64) -> Model {
    let mut model = dry::dry_model();
    model.damping = 0.0;
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(stress), mass: None, speed: None };
    for face in [4, 5] {
        model.faces[face].water = Water::Pressure(Signal::Constant(0.0));
    }
    let pores = Pores {
        conductance: CONDUCTANCE,
        remesh: Remesh { strain: f64::INFINITY },
        residual,
        solver: Solver::Auto,
        step: Stepping::Explicit,
        ..Pores::default()
    };
    model.fluid =
        Some(FluidModel { viscosity, density: 1000.0, bulk_modulus: None, flow: Flow::Pores(pores) });
    model
}
