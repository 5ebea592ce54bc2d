//! Pressures taken from one mesh to the next.

use super::mesh::Mesh;
use glam::DVec3;
use porograin_geometry::locate::locate;
use porograin_geometry::throat::Packing;
use porograin_geometry::triangulation::{Triangulation, wall};

/// What is left of a mesh when the next one is made: which pores there were, and the node of each.
#[derive(Clone, Debug)]
pub struct Former {
    /// Its triangulation.
    pub triangulation: Triangulation,
    /// The node of each pore.
    pub node: Vec<u32>,
}

/// The old node in which each node of a new mesh lies.
///
/// Pores move with their grains: a new pore is looked up by where the middle of its grains was in the old mesh. So a pore that
/// is in both keeps its pressure.
pub fn former_nodes(old: Packing, former: &Former, new: Packing, mesh: &Mesh) -> Vec<u32> {
    // A grain that has left a periodic cell on one side and come in on the other has no old place beside the others.
    let places = if mesh.triangulation.shifts.is_empty() { old } else { new };
    let mut nodes = vec![0; mesh.nodes()];
    let mut hint = 0;
    // Of several pores of one node the first counts.
    for pore in (0..mesh.node.len()).rev() {
        if let Some(found) = locate(old, &former.triangulation, middle(places, mesh, pore), hint) {
            hint = found.pore;
        }
        nodes[mesh.node[pore] as usize] = former.node[hint as usize];
    }
    nodes
}

/// A point inside a pore [m].
pub fn middle(packing: Packing, mesh: &Mesh, pore: usize) -> DVec3 {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for x in (0..4).filter_map(|k| packing.point(&mesh.triangulation, pore, k)) {
        sum += x;
        count += 1.0;
    }
    let mut middle = sum / count;
    for face in mesh.triangulation.pores[pore].iter().filter_map(|&v| wall(v)) {
        let axis = face / 2;
        middle[axis] = 0.5 * (middle[axis] + packing.cell.wall_position(face));
    }
    middle
}
