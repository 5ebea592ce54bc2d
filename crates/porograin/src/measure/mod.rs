//! What can be read off a state: pure functions, no hidden memory.
//!
//! Stresses are positive in compression.

mod coarse;
mod directions;
mod energy;
mod flow;
mod local;
mod microstructure;
mod region;
mod sensor;
mod stress;
pub use coarse::{CoarseFlow, CoarseFound};
pub use directions::{CLASSES, Directions, LAYERS, Profile, directions, profile};
pub use energy::{elastic_energy, kinetic_energy, kinetic_energy_at, kinetic_energy_beside, unbalanced};
pub use flow::{PoreFlow, Site, Walk};
pub use local::{Local, displacement, local, places, strain_deviator};
pub use microstructure::{
    PASSING, carrying, compression, contacts_of_grains, coordination, diameter, fabric, oedometric_modulus,
    porosity, rattlers, settlement,
};
pub use region::{Region, region_porosity};
pub use sensor::{Found, Sensor};
pub use stress::{contact_stress, grain_stress, invariants, mean_stress, wall_stress};

use crate::contact::{ContactLaw, Surroundings, Touch};
use crate::model::Model;
use crate::state::State;
use glam::DVec3;

/// Every contact with its touch and the force on its first grain [N]; a pair that has just parted is left out.
pub fn contact_forces<'a>(
    state: &'a State,
    model: &'a Model,
) -> impl Iterator<Item = ([u32; 2], Touch, DVec3)> + 'a {
    let around = Surroundings::new(&state.grains, &state.domain, &model.faces, &model.walls, &model.contact);
    state.contacts.iter().filter_map(move |(pair, mut memory)| {
        let (law, touch) = (around.law(pair), around.touch(pair));
        law.holds(&touch, &memory).then(|| (pair, touch, law.load(&touch, &mut memory, 0.0).force))
    })
}

#[cfg(test)]
mod tests;
