//! Energies, and how far from rest.

use super::contact_forces;
use crate::contact::{ContactLaw, Memory, Surroundings};
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::state::State;
use glam::DVec3;

/// Kinetic energy of the grains, spins included [J].
pub fn kinetic_energy(grains: &Grains) -> f64 {
    kinetic_energy_at(grains, &grains.velocity)
}

/// The same, beside the flow of a periodic cell: what goes with its deformation depends on where its corner is [J].
pub fn kinetic_energy_beside(state: &State) -> f64 {
    let State { grains, domain, .. } = state;
    let beside = |(&x, &v): (&DVec3, &DVec3)| domain.peculiar(x, v);
    let velocity: Vec<DVec3> = grains.position.iter().zip(&grains.velocity).map(beside).collect();
    kinetic_energy_at(grains, &velocity)
}

/// Kinetic energy of grains that turn as they do and move at other velocities [m/s] [J].
pub fn kinetic_energy_at(grains: &Grains, velocity: &[DVec3]) -> f64 {
    let of = |k: usize| {
        grains.mass[k] * velocity[k].length_squared() + grains.inertia(k) * grains.spin[k].length_squared()
    };
    0.5 * (0..grains.len()).map(of).sum::<f64>()
}

/// Energy stored in the contacts [J].
pub fn elastic_energy(state: &State, model: &Model) -> f64 {
    let around = Surroundings::new(&state.grains, &state.domain, &model.faces, &model.walls, &model.contact);
    let energy = |(pair, memory): ([u32; 2], Memory)| {
        let (law, touch) = (around.law(pair), around.touch(pair));
        law.holds(&touch, &memory).then(|| law.energy(&touch, &memory))
    };
    // The sum of nothing is -0.
    state.contacts.iter().filter_map(energy).sum::<f64>() + 0.0
}

/// Mean resultant on a grain over mean contact force (Catalano 2.16): how far the packing is from equilibrium [-].
///
/// `loads` are those of the last step. Without any contact the value is 1: nothing balances anything. Where contacts are fewer than grains
/// the contact forces are averaged over the grains: otherwise one blow between two grains of a cloud, shared by all others, would look
/// like rest.
pub fn unbalanced(state: &State, model: &Model, loads: &Loads) -> f64 {
    let grains = loads.force.len().max(1) as f64;
    let resultant = loads.force.iter().map(|f| f.length()).sum::<f64>() / grains;
    let (count, sum) =
        contact_forces(state, model).fold((0, 0.0), |(n, s), (_, _, f)| (n + 1, s + f.length()));
    if sum > 0.0 { resultant / (sum / f64::from(count).max(grains)) } else { 1.0 }
}
