//! The verbs of the water for the grid.

use super::{Fluid, Report, no_value};
use crate::boundary::Water;
use crate::darcy::{self, Around, Darcy, Scratch, Terms};
use crate::grains::Loads;
use crate::model::{Flow, FluidModel, Model};
use crate::motion::{WallMotion, kick, wall_motion};
use crate::state::State;
use crate::step::StepError;

/// What the grid sees of the rest.
pub fn around<'a>(state: &'a State, model: &'a Model, fluid: &FluidModel) -> Around<'a> {
    Around {
        grains: &state.grains,
        domain: &state.domain,
        faces: &model.faces,
        step: state.step,
        fluid: [fluid.viscosity, fluid.density],
    }
}

/// Sees to it that the grid belongs to the grains.
pub fn follow(
    state: &mut State,
    model: &Model,
    fluid: &FluidModel,
    settings: &Darcy,
    scratch: &mut Scratch,
) -> Result<(), StepError> {
    let mut water = match state.fluid.take() {
        Some(Fluid::Darcy(grid)) => Some(grid),
        _ => None,
    };
    let followed = darcy::follow(&mut water, settings, &around(state, model, fluid), scratch);
    state.fluid = water.map(Fluid::Darcy);
    followed.map_err(StepError::Fluid)
}

/// Solves for the pressures at the end of the step.
pub fn advance(
    loads: &Loads,
    state: &mut State,
    model: &Model,
    dt: f64,
    scratch: &mut Scratch,
) -> Result<Option<Report>, StepError> {
    let Some(fluid @ FluidModel { flow: Flow::Darcy(settings), .. }) = &model.fluid else { return Ok(None) };
    let time = state.time - model.stage_start;
    darcy::impose(&model.faces, time, scratch).map_err(|place| no_value(place, time))?;
    let Some(Fluid::Darcy(mut water)) = state.fluid.take() else { return Ok(None) };
    let open = std::array::from_fn(|f| matches!(model.faces[f].water, Water::Pressure(_)));
    let pressed = scratch.wall_force(&water, &open);
    let walls: [WallMotion; 6] = std::array::from_fn(|face| {
        let load = loads.wall[face] + pressed[face];
        wall_motion(face, state, model, load, load, dt)
    });
    let terms = Terms {
        kick: kick(state, dt),
        interval: dt,
        bulk_modulus: fluid.bulk_modulus,
        open,
        pistons: walls.map(|wall| wall.mobility),
        residual: settings.residual,
    };
    let velocity = walls.map(|wall| wall.allowed());
    let solved = darcy::advance(&mut water, &around(state, model, fluid), terms, loads, velocity, scratch);
    state.fluid = Some(Fluid::Darcy(water));
    let info = solved
        .map_err(|error| StepError::Fluid(format!("the pressures of the grid cannot be found: {error}")))?;
    Ok(Some(Report {
        iterations: info.iterations,
        residual: info.residual,
        implicit: true,
        ..Report::default()
    }))
}
