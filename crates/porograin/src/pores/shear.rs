//! Viscous shear of the water between neighbouring grains (Catalano 6.29-6.30, after Marzougui).
//!
//! Grains that slide past each other drag the water between them. On the facet of area S between their Voronoi cells
//! `F = mu dV_t S / R_h`, with `R_h` the hydraulic radius of the throats around their edge, void over wetted surface of all of
//! them together. `dV_t` is the part along the facet of the difference of their velocities where the facet cuts the line of
//! their centres, spins included, and there the force acts: so a rigid motion drags nothing, forces and moments
//! balance exactly, and the drag only takes energy. On walls that water sticks to the grain's part of the wall is the facet.

use super::mesh::Walls;
use crate::boundary::{Domain, Slip};
use crate::grains::{Grains, Loads};
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::throat::{Centres, Packing, shape, throats};
use porograin_geometry::triangulation::{Triangulation, Vertex, wall};
use porograin_geometry::voronoi::voronoi;
use std::collections::HashMap;

/// Two neighbours, or a grain and a wall, and the water between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// A grain, and another or a wall.
    pub between: [Vertex; 2],
    /// Period of the second relative to the first.
    pub shift: [i8; 3],
    /// `mu S / R_h` [N s/m].
    pub drag: f64,
}

/// All pairs of neighbours of a mesh, in a fixed order.
///
/// Facets without area and pairs without void around them are left out.
pub fn films(
    packing: Packing,
    mesh: &Triangulation,
    centres: &Centres,
    walls: &Walls,
    viscosity: f64,
) -> Vec<Film> {
    // Void and wetted surface of the throats around each edge. (Images of a pair in a small period count as one.)
    let mut around: HashMap<[Vertex; 2], [f64; 2]> = HashMap::new();
    for throat in throats(mesh) {
        let shape = shape(packing, mesh, centres, &throat);
        let wetted = |k: usize| match wall(throat.vertices[k]) {
            Some(face) if walls.slip[face] == Slip::Symmetry => 0.0,
            _ => shape.surface[k].max(0.0),
        };
        let surface: f64 = (0..3).map(wetted).sum();
        for k in 0..3 {
            let sum = around.entry(ordered(throat.vertices[k], throat.vertices[(k + 1) % 3])).or_default();
            sum[0] += shape.void;
            sum[1] += surface;
        }
    }
    let sticks = |v: Vertex| wall(v).is_none_or(|face| walls.slip[face] == Slip::NoSlip);
    let facets = voronoi(packing, mesh, centres).facets;
    let film = |facet: &porograin_geometry::voronoi::Facet| {
        let [void, surface] = *around.get(&ordered(facet.between[0], facet.between[1]))?;
        let drag = viscosity * facet.area.length() * surface / void;
        (void > 0.0 && drag > 0.0).then_some(Film { between: facet.between, shift: facet.shift, drag })
    };
    facets.iter().filter(|facet| sticks(facet.between[1])).filter_map(film).collect()
}

fn ordered(a: Vertex, b: Vertex) -> [Vertex; 2] {
    if a < b { [a, b] } else { [b, a] }
}

/// How a pair stands now: from the first grain to the place where the force acts, from the second grain to it, and the normal.
fn stand(film: &Film, grains: &Grains, domain: &Domain) -> Option<[DVec3; 3]> {
    let [i, j] = film.between;
    let x = grains.position[i as usize];
    if let Some(face) = wall(j) {
        let lever = DVec3::AXES[face / 2] * (domain.cell.wall_position(face) - x[face / 2]);
        return Some([lever, DVec3::ZERO, NORMALS[face]]);
    }
    let branch = grains.position[j as usize] + domain.cell.shift(film.shift) - x;
    let length = branch.length();
    let normal = branch.try_normalize()?;
    let (a, b) = (grains.radius[i as usize], grains.radius[j as usize]);
    // The radical plane cuts the branch where both have the same power.
    let part = 0.5 * (length + (a - b) * (a + b) / length);
    Some([part * normal, (part - length) * normal, normal])
}

/// Adds the forces and torques of the films to the loads.
pub fn add(loads: &mut Loads, films: &[Film], grains: &Grains, domain: &Domain) {
    for film in films {
        let Some([lever, other, normal]) = stand(film, grains, domain) else { continue };
        let [i, j] = film.between.map(|v| v as usize);
        let there = match wall(film.between[1]) {
            Some(face) => domain.wall_velocity[face],
            None => {
                let image = domain.gradient * domain.cell.shift(film.shift);
                grains.velocity[j] + image + grains.spin[j].cross(other)
            }
        };
        let slip = there - grains.velocity[i] - grains.spin[i].cross(lever);
        let force = film.drag * (slip - slip.dot(normal) * normal);
        loads.force[i] += force;
        loads.torque[i] += lever.cross(force);
        match wall(film.between[1]) {
            Some(face) => loads.wall[face] -= force,
            None => {
                loads.force[j] -= force;
                loads.torque[j] -= other.cross(force);
            }
        }
    }
}

/// How fast the films damp the grains at most [1/s]: what explicit steps must bear. An upper bound, from the rows of the
/// matrix: every film counts twice on either of its grains, as if the other moved against it.
pub fn rate(films: &[Film], grains: &Grains, domain: &Domain) -> f64 {
    let mut sum = vec![0.0; grains.len()];
    for film in films {
        let Some([lever, other, _]) = stand(film, grains, domain) else { continue };
        let twice = if wall(film.between[1]).is_none() { 2.0 } else { 1.0 };
        for (vertex, lever) in film.between.into_iter().zip([lever, other]) {
            if wall(vertex).is_none() {
                let k = vertex as usize;
                sum[k] +=
                    twice * film.drag * (1.0 / grains.mass[k] + lever.length_squared() / grains.inertia(k));
            }
        }
    }
    sum.into_iter().fold(0.0, f64::max)
}
