//! The weight of the grains.

use crate::grains::{Grains, Loads};
use glam::DVec3;

/// Adds `m g` to every grain; `gravity` in m/s².
pub fn add(loads: &mut Loads, grains: &Grains, gravity: DVec3) {
    if gravity != DVec3::ZERO {
        for (force, mass) in loads.force.iter_mut().zip(&grains.mass) {
            *force += *mass * gravity;
        }
    }
}
