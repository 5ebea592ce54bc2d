//! Measures of a state: pure functions, evaluated only when somebody asks.

use crate::contact::Surroundings;
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::state::State;

/// Mean resultant on a grain over mean contact force (Catalano 2.16): how far the packing is from equilibrium [-].
///
/// `loads` are those of the last step. Without any contact the value is 1: nothing balances anything.
pub fn unbalanced(state: &State, model: &Model, loads: &Loads) -> f64 {
    let State { grains, domain, contacts, .. } = state;
    let law = model.contact.as_law();
    let surroundings = Surroundings::new(grains, domain, &model.faces, law.friction());
    let force = |(&pair, &shear): (&[u32; 2], &glam::DVec3)| {
        // No time passes, so the law only reads the shear force; the copy is thrown away.
        law.load(&surroundings.touch(pair), &mut { shear }, 0.0).length()
    };
    let contact = contacts.pairs.iter().zip(&contacts.shear).map(force).sum::<f64>() / contacts.len() as f64;
    let resultant = loads.force.iter().map(|f| f.length()).sum::<f64>() / grains.len() as f64;
    if contact > 0.0 { resultant / contact } else { 1.0 }
}

/// Kinetic energy of the grains, turning included [J]; the velocities are those of the middle of the last step.
pub fn kinetic_energy(grains: &Grains) -> f64 {
    (0..grains.len())
        .map(|i| {
            let (v, w) = (grains.velocity[i].length_squared(), grains.spin[i].length_squared());
            0.5 * (grains.mass[i] * v + grains.inertia(i) * w)
        })
        .sum()
}
