//! Stress of the sample and of each grain, positive in compression.

use super::contact_forces;
use crate::boundary::Domain;
use crate::model::Model;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::cell::NORMALS;
use porograin_geometry::triangulation::wall;

/// Stress of the sample [Pa] from its contacts, `1/V sum F ⊗ branch` (Catalano 2.18 summed): F the force on the
/// second, the branch from centre to centre, or from the centre to the contact point at a wall. Row: direction of the
/// force.
///
/// In a membrane V is the volume inside it. That ends at centres of grains, and so do the branches of contacts with walls.
pub fn contact_stress(state: &State, model: &Model) -> DMat3 {
    let skin = &state.domain.skin;
    let wrapped = !skin.triangles.is_empty();
    let sum: DMat3 = contact_forces(state, model)
        .map(|([_, second], touch, force)| {
            let [near, far] = touch.levers();
            let branch = match wall(second) {
                Some(_) if wrapped => 0.0,
                Some(_) => near,
                None => near + far,
            };
            outer(-force, branch * touch.normal)
        })
        .sum();
    let volume = if wrapped { skin.area_and_volume(&state.grains)[1] } else { state.domain.cell.volume() };
    sum * volume.recip()
}

/// Mean stress carried by the contacts, a third of the trace [Pa].
pub fn mean_stress(state: &State, model: &Model) -> f64 {
    invariants(contact_stress(state, model))[0]
}

/// Normal stress on each face [Pa] from the forces of the last step, grains and water together.
pub fn wall_stress(domain: &Domain) -> [f64; 6] {
    std::array::from_fn(|face| domain.wall_force[face].dot(NORMALS[face]) / domain.area(face))
}

/// Stress of each grain [Pa], `1/V_k sum (x_c - x_k) ⊗ F_c` over its contacts (Catalano 2.18), V_k its own volume.
pub fn grain_stress(state: &State, model: &Model) -> Vec<DMat3> {
    let mut stress = vec![DMat3::ZERO; state.grains.len()];
    for ([first, second], touch, force) in contact_forces(state, model) {
        let [near, far] = touch.levers();
        // Contact points lie along the normal; what presses inwards counts positive.
        stress[first as usize] -= outer(force, near * touch.normal);
        if wall(second).is_none() {
            stress[second as usize] -= outer(force, far * touch.normal);
        }
    }
    for (stress, &radius) in stress.iter_mut().zip(&state.grains.radius) {
        *stress *= state.grains.shape.volume(radius).recip();
    }
    stress
}

/// Mean `tr(S)/3` and deviator `sqrt(3/2 s:s)` of a stress [Pa], s the deviatoric part of its symmetric part; in
/// triaxial compression the deviator is the axial less the radial stress.
pub fn invariants(stress: DMat3) -> [f64; 2] {
    let s = 0.5 * (stress + stress.transpose());
    let mean = (s.x_axis.x + s.y_axis.y + s.z_axis.z) / 3.0;
    let s = s - DMat3::from_diagonal(DVec3::splat(mean));
    let square = s.x_axis.length_squared() + s.y_axis.length_squared() + s.z_axis.length_squared();
    [mean, (1.5 * square).sqrt()]
}

/// `a ⊗ b`, row along `a`.
pub(super) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
