//! One instant for ParaView.

use super::vtk::{self, Field, PoreMesh, Values};
use crate::watch::Snapshot;
use glam::DVec3;

/// The grains, in order of their id.
pub fn grains(now: &Snapshot) -> Vec<u8> {
    let grains = &now.state.grains;
    let mut order: Vec<usize> = (0..grains.len()).collect();
    order.sort_by_key(|&i| grains.id[i]);
    let vectors = |values: &[DVec3]| -> Vec<DVec3> {
        order.iter().map(|&i| values.get(i).copied().unwrap_or_default()).collect()
    };
    let radius: Vec<f64> = order.iter().map(|&i| grains.radius[i]).collect();
    let id: Vec<u32> = order.iter().map(|&i| grains.id[i]).collect();
    let (velocity, spin) = (vectors(&grains.velocity), vectors(&grains.spin));
    let force = vectors(&now.loads.force);
    vtk::points(
        &vectors(&grains.position),
        &[
            Field { name: "id", values: Values::Integers(&id) },
            Field { name: "radius [m]", values: Values::Scalars(&radius) },
            Field { name: "velocity [m/s]", values: Values::Vectors(&velocity) },
            Field { name: "spin [rad/s]", values: Values::Vectors(&spin) },
            Field { name: "resultant [N]", values: Values::Vectors(&force) },
        ],
    )
}

/// The pores; `None` in a dry stage.
pub fn pores(_now: &Snapshot) -> Option<PoreMesh> {
    None
}
