//! What can be read off a state: pure functions, no hidden memory.
//!
//! Stresses are positive in compression.

mod energy;
mod microstructure;
mod stress;
pub use energy::{elastic_energy, kinetic_energy, unbalanced};
pub use microstructure::{coordination, oedometric_modulus, porosity, rattlers, settlement};
pub use stress::{contact_stress, grain_stress, wall_stress};

use crate::contact::{Surroundings, Touch};
use crate::model::Model;
use crate::state::State;
use glam::DVec3;

/// Every contact with its touch and the force on its first grain [N]; a pair that has just parted is left out.
pub fn contact_forces(state: &State, model: &Model) -> impl Iterator<Item = ([u32; 2], Touch, DVec3)> {
    let law = model.contact.as_law();
    let around = Surroundings::new(&state.grains, &state.domain, &model.faces, law.friction());
    let contacts = state.contacts.pairs.iter().zip(&state.contacts.shear);
    contacts.filter_map(move |(&pair, &shear)| {
        let touch = around.touch(pair);
        let mut shear = shear;
        (touch.overlap > 0.0).then(|| (pair, touch, law.load(&touch, &mut shear, 0.0)))
    })
}

#[cfg(test)]
mod tests;
