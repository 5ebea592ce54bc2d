//! What `porograin bench` measures.

use crate::boundary::{Domain, Face};
use crate::contact::{Contacts, Law, Linear};
use crate::grains::Grains;
use crate::model::{Model, TimeStep};
use crate::state::State;
use crate::step::{StepError, Work, step};
use glam::DVec3;
use serde::Serialize;
use std::time::Instant;

/// The cost of the dry step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DryBench {
    /// Number of grains.
    pub grains: usize,
    /// Number of contacts, those with walls included, at the end.
    pub contacts: usize,
    /// Steps timed.
    pub steps: usize,
    /// Median time of a step over the number of contacts [ns].
    pub ns_per_contact_step: f64,
    /// Number of grains over the median time of a step [1/s].
    pub grain_steps_per_second: f64,
    /// Median time of a step [s].
    pub seconds_per_step: f64,
    /// Share of each phase, by the names of the step's page.
    pub phases: Vec<(&'static str, f64)>,
}

/// Density of the benchmark's grains [kg/m³].
pub const DENSITY: f64 = 2600.0;

/// The model of the dry benchmark: walls fixed and frictionless, E = 15 MPa, k_t/k_n = 0.5, 30° between grains,
/// damping 0.2.
pub fn dry_model() -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear { young: 15e6, stiffness_ratio: 0.5, friction: 30.0 }),
        damping: 0.2,
        faces: std::array::from_fn(|_| Face::default()),
        fluid: None,
        stage_start: 0.0,
    }
}

/// Holds a packing (centres and radii [m], in any order) in its box for `steps` timed steps, after a tenth as many to warm up.
///
/// # Errors
/// Whatever stops a step; deeply overlapping grains, most likely.
pub fn dry(
    position: Vec<DVec3>,
    radius: Vec<f64>,
    domain: Domain,
    steps: usize,
) -> Result<DryBench, StepError> {
    // Once inside the pool: entering it anew for every loop of every step would cost more than the loops.
    rayon::scope(|_| timed(position, radius, domain, steps))
}

fn timed(
    position: Vec<DVec3>,
    radius: Vec<f64>,
    domain: Domain,
    steps: usize,
) -> Result<DryBench, StepError> {
    let grains = crate::packing::ordered(&domain.cell, Grains::at_rest(position, radius, DENSITY));
    let (model, mut work) = (dry_model(), Work::default());
    let contacts = Contacts::default();
    let mut state = State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts, fluid: None };
    for _ in 0..(steps / 10).max(20) {
        step(&mut state, &model, &mut work)?;
    }
    work.timers = Default::default();
    let mut times = Vec::with_capacity(steps);
    for _ in 0..steps.max(1) {
        let start = Instant::now();
        step(&mut state, &model, &mut work)?;
        times.push(start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    let all: f64 = work.timers.phases().iter().map(|phase| phase.1.as_secs_f64()).sum();
    Ok(DryBench {
        grains: state.grains.len(),
        contacts: state.contacts.len(),
        steps: times.len(),
        ns_per_contact_step: 1e9 * median / state.contacts.len().max(1) as f64,
        grain_steps_per_second: state.grains.len() as f64 / median,
        seconds_per_step: median,
        phases: work.timers.phases().iter().map(|&(name, time)| (name, time.as_secs_f64() / all)).collect(),
    })
}
