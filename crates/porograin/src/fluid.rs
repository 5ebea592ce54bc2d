//! The water: what flows, and what it does to the grains.

use crate::grains::Loads;
use crate::model::Model;
use crate::state::State;
use crate::step::StepError;

/// What the water keeps between steps to be fast; dropping it changes no bit.
#[derive(Debug, Default)]
pub struct Scratch {}

/// What the water did in a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {}

/// Brings the water to the time of the grains.
pub fn advance(_: &mut State, model: &Model, _: f64, _: &mut Scratch) -> Result<Option<Report>, StepError> {
    match model.fluid {
        None => Ok(None),
        Some(_) => Err(StepError::Fluid("flow between the grains is not there yet".into())),
    }
}

/// Adds what the water does to grains and walls.
pub fn add(_: &mut Loads, _: &State, _: &Model, _: &mut Scratch) {}
