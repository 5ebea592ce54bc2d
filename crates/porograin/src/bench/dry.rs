//! The cost of the step without water.

use super::{DENSITY, timed};
use crate::boundary::{Domain, Face};
use crate::contact::{Contacts, Law, Linear};
use crate::grains::Grains;
use crate::model::{Model, TimeStep};
use crate::state::State;
use crate::step::StepError;
use glam::DVec3;
use serde::Serialize;

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

/// The model of the dry benchmark: walls fixed and frictionless, E = 15 MPa, k_t/k_n = 0.5, 30° between grains,
/// damping 0.2.
pub fn dry_model() -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(15e6, 0.5, 30.0)).into(),
        damping: 0.2,
        faces: std::array::from_fn(|_| Face::default()),
        fluid: None,
        stage_start: 0.0,
    }
}

/// The grains at rest in their box.
pub(super) fn at_rest(position: Vec<DVec3>, radius: Vec<f64>, domain: Domain) -> State {
    let grains = crate::packing::ordered(&domain.cell, Grains::at_rest(position, radius, DENSITY));
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
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
    rayon::scope(|_| hold(&mut at_rest(position, radius, domain), steps))
}

/// Times the dry step of a state.
pub(super) fn hold(state: &mut State, steps: usize) -> Result<DryBench, StepError> {
    let timed = timed(state, &dry_model(), steps)?;
    Ok(DryBench {
        grains: state.grains.len(),
        contacts: state.contacts.len(),
        steps: timed.reports.len(),
        ns_per_contact_step: 1e9 * timed.seconds_per_step / state.contacts.len().max(1) as f64,
        grain_steps_per_second: state.grains.len() as f64 / timed.seconds_per_step,
        seconds_per_step: timed.seconds_per_step,
        phases: timed.phases,
    })
}
