//! Which way contacts and forces point, and what varies with height.

use super::contact_forces;
use crate::grains::{Grains, Shape};
use crate::model::Model;
use crate::state::State;
use glam::DVec3;
use porograin_geometry::triangulation::wall;

/// Number of classes of the angle to the vertical, each of the same solid angle.
pub const CLASSES: usize = 10;
/// Number of layers of a profile.
pub const LAYERS: usize = 12;

/// How contacts between grains and their forces are distributed over the angle to the vertical.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Directions {
    /// Density of contact normals: 1 everywhere where all directions are alike.
    pub contacts: [f64; CLASSES],
    /// Mean normal force over the mean of all contacts.
    pub normal: [f64; CLASSES],
    /// Mean tangential force over the mean normal force of all contacts.
    pub tangential: [f64; CLASSES],
}

/// Directions of the contacts between grains: class k holds those with `|n_z|` from `k/10` to `(k + 1)/10`, from horizontal to
/// vertical; classes of equal width in the cosine are bands of equal area on the sphere.
pub fn directions(state: &State, model: &Model) -> Directions {
    let mut found = Directions::default();
    let (mut count, mut sum) = (0.0, 0.0);
    for ([_, second], touch, force) in contact_forces(state, model) {
        if wall(second).is_some() {
            continue;
        }
        let class = ((touch.normal.z.abs() * CLASSES as f64) as usize).min(CLASSES - 1);
        let pressing = -force.dot(touch.normal);
        found.contacts[class] += 1.0;
        found.normal[class] += pressing;
        found.tangential[class] += (force + pressing * touch.normal).length();
        count += 1.0;
        sum += pressing;
    }
    if count > 0.0 && sum != 0.0 {
        let mean = sum / count;
        for class in 0..CLASSES {
            let own = f64::max(found.contacts[class], 1.0);
            found.normal[class] /= own * mean;
            found.tangential[class] /= own * mean;
            found.contacts[class] *= CLASSES as f64 / count;
        }
    }
    found
}

/// What varies with height, in layers of equal thickness from bottom to top.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Profile {
    /// Solid part of each layer [-].
    pub solid: [f64; LAYERS],
    /// Mean velocity of the solid in it [m/s].
    pub velocity: [DVec3; LAYERS],
}

/// Solid fraction and mean velocity by height; each grain counts in every layer with the volume it has there, exactly.
pub fn profile(state: &State) -> Profile {
    let (grains, cell) = (&state.grains, &state.domain.cell);
    let (bottom, height) = (cell.wall_position(4), cell.wall_position(5) - cell.wall_position(4));
    let thickness = height / LAYERS as f64;
    let mut found = Profile::default();
    for k in 0..grains.len() {
        let (z, r) = (grains.position[k].z - bottom, grains.radius[k]);
        let layers = ((z - r) / thickness).floor() as i64..=((z + r) / thickness).floor() as i64;
        for layer in layers {
            let lower = layer as f64 * thickness;
            let part = part_below(grains, k, lower + thickness - z) - part_below(grains, k, lower - z);
            // Through periodic sides a grain goes on at the other end; at walls an overlap counts in the last layer.
            let last = LAYERS as i64 - 1;
            let place = if cell.periodic[2] { layer.rem_euclid(LAYERS as i64) } else { layer.clamp(0, last) }
                as usize;
            found.solid[place] += part;
            found.velocity[place] += part * grains.velocity[k];
        }
    }
    let volume = cell.volume() / LAYERS as f64;
    for layer in 0..LAYERS {
        if found.solid[layer] > 0.0 {
            found.velocity[layer] /= found.solid[layer];
        }
        found.solid[layer] /= volume;
    }
    found
}

/// Volume of grain `k` below the height `h` above its centre [m³].
fn part_below(grains: &Grains, k: usize, h: f64) -> f64 {
    let r = grains.radius[k];
    let h = h.clamp(-r, r);
    match grains.shape {
        // The cap of height r + h.
        Shape::Sphere => std::f64::consts::PI * (r + h) * (r + h) * (2.0 * r - h) / 3.0,
        Shape::Disc { thickness } => {
            let root = (r * r - h * h).max(0.0).sqrt();
            thickness * (h * root + r * r * (h / r).asin() + std::f64::consts::FRAC_PI_2 * r * r)
        }
    }
}
