//! Grains that stick to a wall: a rough plate.
//!
//! When the glue is switched on the grains that touch the wall become one rigid body with it, and stay so until it is switched off. They
//! move and turn with the wall; what acts on them acts on the wall, which carries their mass besides its own.

use super::find;
use crate::boundary::Domain;
use crate::contact::Contacts;
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::state::State;
use glam::DVec3;
use porograin_geometry::triangulation::wall;
use serde::{Deserialize, Serialize};

/// Which grains stick to which walls. Walls are counted as bodies: the six faces, then those that the case adds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Glue {
    /// Bodies on which the glue is switched on.
    on: Vec<bool>,
    /// Index of each grain that sticks, and its body; sorted.
    pub grains: Vec<[u32; 2]>,
}

impl Glue {
    /// Whether nothing sticks.
    pub fn is_empty(&self) -> bool {
        self.grains.is_empty()
    }

    /// Mass of all that sticks to a body [kg].
    pub fn mass(&self, body: usize, grains: &Grains) -> f64 {
        let stuck = self.grains.iter().filter(|pair| pair[1] as usize == body);
        stuck.map(|pair| grains.mass[pair[0] as usize]).sum()
    }
}

/// Switches the glue of walls on and off as the model says; `contacts` say who touches whom.
fn follow(domain: &mut Domain, contacts: &Contacts, model: &Model) {
    let wanted = || {
        let walls = model.walls.iter().map(|wall| wall.glue && wall.present);
        model.faces.iter().map(|face| face.glue).chain(walls)
    };
    let glue = &mut domain.glue;
    if wanted().eq(glue.on.iter().copied()) || glue.on.is_empty() && wanted().all(|glue| !glue) {
        return;
    }
    let before = std::mem::replace(&mut glue.on, wanted().collect());
    glue.grains.retain(|pair| glue.on[pair[1] as usize]);
    for [first, second] in contacts.pairs() {
        let body = match wall(second) {
            None => continue,
            Some(6..) => 6 + find(&model.walls, second).0,
            Some(face) => face,
        };
        let new = glue.on[body] && !before.get(body).copied().unwrap_or(false);
        if new && glue.grains.iter().all(|pair| pair[0] != first) {
            glue.grains.push([first, body as u32]);
        }
    }
    glue.grains.sort_unstable();
}

/// Switches the glue on and off, and hands what acts on grains that stick to their walls.
pub fn bear(loads: &mut Loads, state: &mut State, model: &Model) {
    follow(&mut state.domain, &state.contacts, model);
    for &[grain, body] in &state.domain.glue.grains {
        let (grain, body) = (grain as usize, body as usize);
        let force = std::mem::take(&mut loads.force[grain]);
        let torque = std::mem::take(&mut loads.torque[grain]);
        match loads.wall.get_mut(body) {
            Some(on) => *on += force,
            None => {
                let k = body - 6;
                let centre = state.domain.walls[k].forth(model.walls[k].shape.centre());
                loads.walls[k].force += force;
                loads.walls[k].moment += (state.grains.position[grain] - centre).cross(force) + torque;
            }
        }
    }
}

/// Gives grains that stick the velocity with which their wall takes them along in a step of length `dt` [s]; `before` is where the
/// walls were that the case adds, the domain has them where they go.
pub fn take_along(domain: &Domain, before: &[super::Place], grains: &mut Grains, dt: f64) {
    for &[grain, body] in &domain.glue.grains {
        let (grain, body) = (grain as usize, body as usize);
        let x = grains.position[grain];
        (grains.velocity[grain], grains.spin[grain]) = match domain.wall_velocity.get(body) {
            Some(&velocity) => (velocity, DVec3::ZERO),
            None => {
                let (now, before) = (&domain.walls[body - 6], &before[body - 6]);
                ((now.forth(before.back(x)) - x) / dt, now.spin)
            }
        };
    }
}
