//! Point location: which pore contains a point.

use crate::cell::NORMALS;
use crate::throat::{Packing, shift_to};
use crate::triangulation::{FACET, NONE, Triangulation, wall};
use glam::DVec3;

/// A pore that contains a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// The pore.
    pub pore: u32,
    /// What to add to the positions of its vertices (as [`Packing::point`] gives them) to surround the point [m]; zero
    /// without periodic axes.
    pub offset: DVec3,
}

/// The pore that contains `x`, or `None` if there are no pores, `x` is not finite, or it lies more than a million periods away.
///
/// Walks from the pore `hint` (any will do; a close one makes it quick, the last result is best) through the facets
/// that have the point on their far side. Points on a facet belong to either pore; points beyond a wall to the pore at
/// that wall. If round-off should make the walk circle, all pores are searched.
pub fn locate(packing: Packing, mesh: &Triangulation, x: DVec3, hint: u32) -> Option<Located> {
    if mesh.pores.is_empty() || !x.is_finite() {
        return None;
    }
    let periods = |d: DVec3| nearest_periods(packing, d);
    let mut pore = if (hint as usize) < mesh.pores.len() { hint } else { 0 };
    // Whole numbers, as every crossing adds one: no round-off piles up.
    let mut shift = periods(x - any_grain(packing, mesh, pore))?;
    let at = |shift: DVec3| packing.cell.edges * shift;
    let mut from = NONE;
    // A few pores of a small period may be crossed several times.
    for _ in 0..mesh.pores.len() + 200 {
        let out = (0..4).find(|&k| {
            let next = mesh.neighbours[pore as usize][k];
            next != NONE && next != from && side(packing, mesh, pore, k, x - at(shift)) < 0.0
        });
        let Some(k) = out else { return Some(Located { pore, offset: at(shift) }) };
        let next = mesh.neighbours[pore as usize][k];
        let [a, b, c] = shift_to(mesh, pore as usize, k, next as usize).map(f64::from);
        shift += DVec3::new(a, b, c);
        // In a torus of a few pores the way on may lead back through the same neighbour.
        from = if mesh.shifts.is_empty() { pore } else { NONE };
        pore = next;
    }
    // The least outside of all pores, each at the image nearest to the point.
    let depth = |pore: u32| {
        let shift = periods(x - any_grain(packing, mesh, pore)).unwrap_or(DVec3::ZERO);
        let least = (0..4).map(|k| side(packing, mesh, pore, k, x - at(shift))).fold(f64::INFINITY, f64::min);
        (least, Located { pore, offset: at(shift) })
    };
    (0..mesh.pores.len() as u32).map(depth).max_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
}

fn any_grain(packing: Packing, mesh: &Triangulation, pore: u32) -> DVec3 {
    (0..4).find_map(|k| packing.point(mesh, pore as usize, k)).unwrap_or(packing.cell.origin)
}

/// The whole periods in a difference, rounded to the nearest; zero along walled axes.
fn nearest_periods(packing: Packing, d: DVec3) -> Option<DVec3> {
    let mut shift = DVec3::ZERO;
    if packing.cell.periodic != [false; 3] {
        let f = packing.cell.edges.inverse() * d;
        for k in (0..3).filter(|&k| packing.cell.periodic[k]) {
            shift[k] = f[k].round();
        }
    }
    (shift.abs().max_element() < 1e6).then_some(shift)
}

/// Six times the signed volume of the tetrahedron of facet `k` and the point: positive inside. A wall stands for its outward normal.
fn side(packing: Packing, mesh: &Triangulation, pore: u32, k: usize, x: DVec3) -> f64 {
    let [a, b, c] = FACET[k].map(|j| match packing.point(mesh, pore as usize, j) {
        Some(p) => p - x,
        None => NORMALS[wall(mesh.pores[pore as usize][j]).unwrap_or(0)],
    });
    a.dot(b.cross(c))
}
