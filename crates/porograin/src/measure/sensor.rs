//! The pressure of the water at any place.
//!
//! Pressures live at the radical centres of the pores, not at the corners of anything. So each grain k first gets the
//! plane `f_k(x) = p_k + g_k·(x - x_k)` that fits the pressures of the pores around it best (least squares, weighted by
//! the pores' volumes); at a place inside a pore the planes of its four grains count by the barycentric coordinates `λ_k` of the place:
//! `p(x) = sum λ_k(x) f_k(x)`. In a prism at a wall the coordinates are those of the place's projection along the wall's normal. The
//! result is continuous, also through the period, and exact for a pressure that varies linearly.

use super::flow::Site;
use crate::pores::mesh::BLOCKED;
use glam::{DMat3, DVec3};
use porograin_geometry::Cell;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::locate::locate;
use porograin_geometry::triangulation::wall;

/// What keeps a fit to pores in one plane, or in one point, from dividing by zero: far below what a pressure is known to.
const RIDGE: f64 = 1e-13;

/// Something to hold into the water. It remembers the pore where it was last: close places one after the other are quick.
#[derive(Clone, Debug)]
pub struct Sensor<'a> {
    site: &'a Site<'a>,
    /// Of each node, less the macroscopic part where there is one [Pa].
    pressure: &'a [f64],
    pore: u32,
}

/// What a sensor found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Excess pressure [Pa].
    pub pressure: f64,
    /// The pore that contains the place.
    pub pore: usize,
    /// What to add to the places of its vertices to surround it [m].
    pub offset: DVec3,
}

/// Whether a place [m] is outside of a box; a billionth of it is none.
pub(super) fn beyond_walls(cell: &Cell, x: DVec3) -> bool {
    let (lower, upper) = (cell.origin, cell.upper());
    let beyond = |axis: usize| {
        let slack = 1e-9 * (upper[axis] - lower[axis]);
        x[axis] < lower[axis] - slack || x[axis] > upper[axis] + slack
    };
    (0..3).any(|axis| !cell.periodic[axis] && beyond(axis))
}

impl<'a> Sensor<'a> {
    /// A sensor for these pressures of the nodes [Pa].
    pub fn new(site: &'a Site<'a>, pressure: &'a [f64]) -> Self {
        Sensor { site, pressure, pore: 0 }
    }

    /// The water at `x` [m], which may lie in a grain; `None` beyond a wall, in a blocked pore, and where there are no pores.
    pub fn at(&mut self, x: DVec3) -> Option<Found> {
        let Site { packing, mesh, .. } = self.site;
        if beyond_walls(packing.cell, x) {
            return None;
        }
        let found = locate(*packing, &mesh.triangulation, x, self.pore)?;
        self.pore = found.pore;
        let pore = found.pore as usize;
        if mesh.held[mesh.node[pore] as usize] == BLOCKED {
            return None;
        }
        let mut pressure = 0.0;
        for (k, part) in self.coordinates(pore, x - found.offset).into_iter().enumerate() {
            let vertex = mesh.triangulation.pores[pore][k];
            if wall(vertex).is_none() {
                let away = self.site.shift(pore, k) + found.offset;
                pressure += part * self.plane(vertex as usize, x - away);
            }
        }
        Some(Found { pressure, pore, offset: found.offset })
    }

    /// Barycentric coordinates of `x` in a pore, of a prism those of its projection; zero for walls.
    fn coordinates(&self, pore: usize, x: DVec3) -> [f64; 4] {
        let Site { packing, mesh, .. } = self.site;
        let points: [Option<DVec3>; 4] = std::array::from_fn(|k| packing.point(&mesh.triangulation, pore, k));
        // The first vertex of a pore is a grain.
        let base = points[0].unwrap_or_default();
        let side = |k: usize| match points[k] {
            Some(point) => point - base,
            None => NORMALS[wall(mesh.triangulation.pores[pore][k]).unwrap_or(0)],
        };
        let along = DMat3::from_cols(side(1), side(2), side(3)).inverse() * (x - base);
        let mut parts = [0.0, along.x, along.y, along.z];
        (1..4).filter(|&k| points[k].is_none()).for_each(|k| parts[k] = 0.0);
        parts[0] = 1.0 - parts.iter().sum::<f64>();
        if parts.iter().any(|part| !part.is_finite()) {
            // A flat pore: any of its grains will do.
            return [1.0, 0.0, 0.0, 0.0];
        }
        parts
    }

    /// The value at `x`, beside the grain, of the plane that fits the pores around it best [Pa].
    fn plane(&self, grain: usize, x: DVec3) -> f64 {
        let Site { packing, mesh, centre, .. } = self.site;
        let origin = packing.position[grain];
        let around = || {
            let open = |&(pore, _): &(usize, usize)| mesh.held[mesh.node[pore] as usize] != BLOCKED;
            self.site.slots(grain).filter(open).map(|(pore, k)| {
                let place = centre[pore] - self.site.shift(pore, k) - origin;
                (mesh.volume[pore].max(0.0), place, self.pressure[mesh.node[pore] as usize])
            })
        };
        let (mut weight, mut middle, mut mean) = (0.0, DVec3::ZERO, 0.0);
        for (w, place, p) in around() {
            weight += w;
            middle += w * place;
            mean += w * p;
        }
        (middle, mean) = (middle / weight, mean / weight);
        let (mut spread, mut rise) = (DMat3::ZERO, DVec3::ZERO);
        for (w, place, p) in around() {
            let d = place - middle;
            spread += DMat3::from_cols(w * d * d.x, w * d * d.y, w * d * d.z);
            rise += w * (p - mean) * d;
        }
        let ridge = RIDGE * (spread.x_axis.x + spread.y_axis.y + spread.z_axis.z);
        if ridge == 0.0 {
            return mean;
        }
        let slope = (spread + DMat3::from_diagonal(DVec3::splat(ridge))).inverse() * rise;
        mean + slope.dot(x - origin - middle)
    }
}
