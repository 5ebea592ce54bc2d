//! What the case imposes on the water of the pores: pressures and inflows of faces, points.

use crate::boundary::{Face, Water};
use crate::pores::mesh::{Mesh, POINT};
use crate::pores::{Point, PointWater};
use crate::step::StepError;
use glam::DVec3;

/// The excess pressure that a rule imposes at the place `x` [Pa]; zero where it imposes none.
pub fn imposed(rule: &Water, x: DVec3, time: f64) -> f64 {
    match rule {
        Water::Pressure(signal) => signal.field(x, time),
        Water::Sealed | Water::Inflow(_) => 0.0,
    }
}

/// What comes in through the faces into each node [m³/s], nothing if no face has an inflow; returns the sum of each face.
///
/// # Errors
/// The first place where it has no value.
pub fn inflow(mesh: &Mesh, faces: &[Face; 6], time: f64, source: &mut Vec<f64>) -> Result<[f64; 6], DVec3> {
    source.clear();
    let mut sums = [0.0; 6];
    if !faces.iter().any(|face| matches!(face.water, Water::Inflow(_))) {
        return Ok(sums);
    }
    source.resize(mesh.nodes(), 0.0);
    for side in &mesh.wall_faces {
        if let Water::Inflow(signal) = &faces[side.face as usize].water {
            let pore = side.pore as usize;
            let rate = signal.field(mesh.centre[pore], time);
            if !rate.is_finite() {
                return Err(mesh.centre[pore]);
            }
            source[mesh.node[pore] as usize] += side.area * rate;
            sums[side.face as usize] += side.area * rate;
        }
    }
    Ok(sums)
}

/// Holds the pressures of points, and adds what their sources give [m³/s].
///
/// # Errors
/// The first point without a value.
pub fn points(
    mesh: &Mesh,
    points: &[Point],
    time: f64,
    pressure: &mut [f64],
    source: &mut Vec<f64>,
) -> Result<(), DVec3> {
    for (&node, point) in mesh.points.iter().zip(points) {
        let (node, at) = (node as usize, DVec3::from_array(point.at));
        let value = point.water.signal().field(at, time);
        if !value.is_finite() {
            return Err(at);
        }
        match point.water {
            // A blocked pore has no water to hold.
            PointWater::Pressure(_) if mesh.held[node] == POINT => pressure[node] = value,
            PointWater::Pressure(_) => {}
            PointWater::Source(_) => {
                source.resize(mesh.nodes(), 0.0);
                source[node] += value;
            }
        }
    }
    Ok(())
}

/// What tells the user of such a place.
pub fn no_value(place: DVec3, time: f64) -> StepError {
    StepError::Fluid(format!(
        "what is imposed on the water at ({}, {}, {}) m has no value {time} s after the stage began: \
         check its formula there",
        place.x, place.y, place.z
    ))
}
