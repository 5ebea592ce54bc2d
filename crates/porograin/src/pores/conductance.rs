//! How easily water passes a throat: pure functions of the throat's shape.

use crate::boundary::Slip;
use porograin_geometry::throat::Shape;
use porograin_geometry::triangulation::{Vertex, wall};
use serde::{Deserialize, Serialize};

/// The choice of conductance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Conductance {
    /// `g = A_f R_h² / (2 mu)`, the hydraulic radius `R_h` being void volume over wetted surface (Catalano 3.4-3.5).
    #[default]
    HydraulicRadius,
}

/// What the flow through one throat meets.
#[derive(Clone, Copy, Debug)]
pub struct Passage<'a> {
    /// The throat's areas, volumes and surfaces.
    pub shape: &'a Shape,
    /// Its vertices.
    pub vertices: [Vertex; 3],
    /// Whether water sticks to each of the six walls.
    pub slip: &'a [Slip; 6],
}

impl Passage<'_> {
    /// Surface of vertex `k` that resists the flow [m²]: all of a grain's, a wall's only where water sticks to it.
    #[inline]
    pub fn drag_surface(&self, k: usize) -> f64 {
        match wall(self.vertices[k]) {
            Some(face) if self.slip[face] == Slip::Symmetry => 0.0,
            // Where the two radical centres almost coincide rounding can tip the sign.
            _ => self.shape.surface[k].max(0.0),
        }
    }
}

impl Conductance {
    /// `g / L` [m³/(Pa s)]: flux from the first pore to the second per pressure difference. Zero where grains
    /// overlap so much that no void or no open area is left.
    pub fn of(self, passage: &Passage, viscosity: f64) -> f64 {
        let shape = passage.shape;
        if shape.fluid_area <= 0.0 || shape.void <= 0.0 || shape.length <= 0.0 {
            return 0.0;
        }
        match self {
            Conductance::HydraulicRadius => {
                let wetted: f64 = (0..3).map(|k| passage.drag_surface(k)).sum();
                let radius = shape.void / wetted;
                0.5 * shape.fluid_area * radius * radius / (viscosity * shape.length)
            }
        }
    }

    /// Shares (sum 1) of the throat's viscous force: in proportion to the surfaces (Catalano 3.14).
    pub fn shares(self, passage: &Passage) -> [f64; 3] {
        let weight: [f64; 3] = std::array::from_fn(|k| passage.drag_surface(k));
        let total: f64 = weight.iter().sum();
        if total > 0.0 {
            return weight.map(|w| w / total);
        }
        let grains = passage.vertices.map(|v| f64::from(u8::from(wall(v).is_none())));
        let count: f64 = grains.iter().sum();
        grains.map(|g| g / count)
    }
}
