//! What a case asks of single places in the water: pressures and sources at points, regions that let no water through.

use super::carry::middle;
use super::mesh::{BLOCKED, Mesh, POINT};
use crate::boundary::Signal;
use glam::DVec3;
use porograin_geometry::locate::locate;
use porograin_geometry::throat::Packing;
use serde::{Deserialize, Serialize};

/// A point in the water with a rule of its own: the pore that contains it keeps the rule, whatever pore that is after the
/// next mesh.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Point {
    /// Where [m].
    pub at: [f64; 3],
    /// What.
    pub water: PointWater,
}

/// What happens to the water at a point.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointWater {
    /// The excess pressure is imposed [Pa].
    Pressure(Signal),
    /// Water comes in at this rate [m³/s]; it leaves where negative.
    Source(Signal),
}

impl PointWater {
    /// The pressure or the rate.
    pub fn signal(&self) -> &Signal {
        match self {
            PointWater::Pressure(signal) | PointWater::Source(signal) => signal,
        }
    }
}

/// A box whose pores let no water through, as if cemented: those whose middle lies in it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Block {
    /// Low corner [m].
    pub from: [f64; 3],
    /// High corner [m].
    pub to: [f64; 3],
}

impl Block {
    /// Whether a point [m] lies in it.
    pub fn contains(&self, x: DVec3) -> bool {
        DVec3::from_array(self.from).cmple(x).all() && x.cmple(DVec3::from_array(self.to)).all()
    }
}

/// What of points and blocks shapes the mesh: a change calls for a new one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Places {
    /// Where the points are [m], and whether their pressure is imposed.
    pub points: Vec<([f64; 3], bool)>,
    /// Regions that let no water through.
    pub blocks: Vec<Block>,
}

impl Places {
    /// Of the points and blocks of a case.
    pub fn new(points: &[Point], blocks: &[Block]) -> Places {
        let place = |point: &Point| (point.at, matches!(point.water, PointWater::Pressure(_)));
        Places { points: points.iter().map(place).collect(), blocks: blocks.to_vec() }
    }

    /// Blocks the pores of the regions, then finds the nodes of the points and holds those whose pressure is imposed. A pressure
    /// given at a point goes before that of a face; a blocked pore stays blocked.
    pub fn apply(&self, packing: Packing, mesh: &mut Mesh) {
        if self.points.is_empty() && self.blocks.is_empty() {
            return;
        }
        for pore in 0..mesh.node.len() {
            let x = middle(packing, mesh, pore);
            if self.blocks.iter().any(|block| block.contains(x)) {
                mesh.held[mesh.node[pore] as usize] = BLOCKED;
            }
        }
        for (&[i, j], g) in mesh.links.iter().zip(&mut mesh.conductance) {
            if mesh.held[i as usize] == BLOCKED || mesh.held[j as usize] == BLOCKED {
                *g = 0.0;
            }
        }
        mesh.census.blocked = mesh.held.iter().filter(|held| **held == BLOCKED).count();
        mesh.points.clear();
        for &(at, held) in &self.points {
            let pore =
                locate(packing, &mesh.triangulation, DVec3::from_array(at), 0).map_or(0, |found| found.pore);
            let node = mesh.node[pore as usize];
            mesh.points.push(node);
            if held && mesh.held[node as usize] != BLOCKED {
                mesh.held[node as usize] = POINT;
            }
        }
        let Mesh { holds, held, .. } = mesh;
        holds.retain(|&(node, _)| held[node as usize] < POINT);
        mesh.number();
    }
}
