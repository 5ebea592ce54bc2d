//! How easily water passes a throat: pure functions of the throat's shape.

use crate::boundary::Slip;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::throat::{Centres, Packing, Shape, Throat};
use porograin_geometry::triangulation::{FACET, Triangulation, Vertex, wall};
use serde::{Deserialize, Serialize};

/// Solid fractions of a throat that the local drag is calibrated for; others count as the nearest of these.
const SOLID: [f64; 2] = [1e-4, 0.97];

/// The narrowest gap of the local drag, in radii of the grain.
const NARROWEST: f64 = 1e-3;

/// The choice of conductance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Conductance {
    /// `g = A_f R_h² / (2 mu)`, the hydraulic radius `R_h` being void volume over wetted surface (Catalano 3.4-3.5).
    #[default]
    HydraulicRadius,
    /// `g = 2 A V eps^(9/4) / (3 mu D)`, `D = sum(gamma) (1/a + 11/(4 delta)) + 11/4 sum(gamma_w / h_w)`: the drag of
    /// the throat's grains, of mean radius `a`, at gaps `delta`, and of the walls `w` that water sticks to.
    LocalDrag,
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
    /// Radii of its grains [m]; zero at walls.
    pub radius: [f64; 3],
    /// Length of the facet's edge on each wall [m]; zero at grains.
    pub edge: [f64; 3],
    /// Power of the first radical centre, less its squared distance to the facet [m²].
    pub power: f64,
}

impl<'a> Passage<'a> {
    /// What the flow through `throat`, of the given shape, meets.
    pub fn new(
        packing: Packing,
        mesh: &Triangulation,
        centres: &Centres,
        throat: &Throat,
        shape: &'a Shape,
        slip: &'a [Slip; 6],
    ) -> Passage<'a> {
        let pore = throat.pores[0] as usize;
        let points = FACET[throat.facet as usize].map(|m| packing.point(mesh, pore, m));
        let (mut radius, mut edge, mut power) = ([0.0; 3], [0.0; 3], 0.0);
        for k in 0..3 {
            let (next, previous) = (points[(k + 1) % 3], points[(k + 2) % 3]);
            match (points[k], wall(throat.vertices[k])) {
                (Some(x), _) => {
                    radius[k] = packing.radius[throat.vertices[k] as usize];
                    let from = centres.point[pore] - x;
                    let height = from.dot(shape.normal);
                    power = from.length_squared() - radius[k] * radius[k] - height * height;
                }
                (None, Some(face)) => {
                    edge[k] = match (next, previous) {
                        (Some(a), Some(b)) => (b - a).reject_from_normalized(NORMALS[face]).length(),
                        // A rectangle: its other side is the grain's depth below this wall.
                        (Some(x), None) | (None, Some(x)) => {
                            let axis = face / 2;
                            shape.area / (packing.cell.wall_position(face) - x[axis]).abs()
                        }
                        (None, None) => 0.0,
                    };
                }
                (None, None) => {}
            }
        }
        Passage { shape, vertices: throat.vertices, slip, radius, edge, power }
    }

    /// Width of the gap at grain `k`, from its surface to the middle of the throat [m].
    fn gap(&self, k: usize) -> f64 {
        let radius = self.radius[k];
        ((radius * radius + self.power).max(0.0).sqrt() - radius).max(NARROWEST * radius)
    }

    /// `gamma_w / h_w` of wall `k` [m], `h_w` being the fluid area over the edge on the wall.
    fn wall_drag(&self, k: usize) -> f64 {
        self.drag_surface(k) * self.edge[k] / self.shape.fluid_area
    }

    fn is_grain(&self, k: usize) -> bool {
        wall(self.vertices[k]).is_none()
    }

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
            Conductance::LocalDrag => {
                let volume = shape.area * shape.length / 3.0;
                let solid = (1.0 - shape.void / volume).clamp(SOLID[0], SOLID[1]);
                let angles: f64 = shape.angle.iter().sum();
                let (mut surface, mut log_gap, mut walls) = (0.0, 0.0, 0.0);
                for k in 0..3 {
                    if passage.is_grain(k) {
                        surface += passage.drag_surface(k);
                        log_gap += shape.angle[k] / angles * passage.gap(k).ln();
                    } else {
                        walls += passage.wall_drag(k);
                    }
                }
                let radius = 3.0 * solid * volume / surface;
                let drag = surface * (1.0 / radius + 2.75 / log_gap.exp()) + 2.75 * walls;
                2.0 / 3.0 * shape.area * volume * (1.0 - solid).powf(2.25) / (viscosity * drag * shape.length)
            }
        }
    }

    /// Shares (sum 1) of the throat's viscous force: in proportion to the surfaces (Catalano 3.14), or to their
    /// drag `gamma_k (1/R_k + 1/delta_k)`, `gamma_w / h_w` at walls.
    pub fn shares(self, passage: &Passage) -> [f64; 3] {
        let weight: [f64; 3] = std::array::from_fn(|k| match self {
            Conductance::HydraulicRadius => passage.drag_surface(k),
            Conductance::LocalDrag if passage.shape.fluid_area <= 0.0 => passage.drag_surface(k),
            Conductance::LocalDrag if passage.is_grain(k) => {
                passage.drag_surface(k) * (1.0 / passage.radius[k] + 1.0 / passage.gap(k))
            }
            Conductance::LocalDrag => passage.wall_drag(k),
        });
        let total: f64 = weight.iter().sum();
        if total > 0.0 {
            return weight.map(|w| w / total);
        }
        let grains = passage.vertices.map(|v| f64::from(u8::from(wall(v).is_none())));
        let count: f64 = grains.iter().sum();
        grains.map(|g| g / count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::permeability::{Problem, measure};
    use crate::pores::Solver;
    use glam::DVec3;
    use porograin_geometry::Cell;

    /// Permeability over `a²` of 4³ grains on a simple cubic lattice of side `a` between mirrors.
    fn cubic(conductance: Conductance, a: f64, viscosity: f64) -> f64 {
        let at = |i: usize| DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64);
        let position: Vec<DVec3> = (0..64).map(|i| a * (at(i) + 0.5)).collect();
        let cell = Cell::walled(DVec3::ZERO, DVec3::splat(4.0 * a));
        let problem = Problem {
            axis: 2,
            drop: 1.0,
            sides: Slip::Symmetry,
            viscosity,
            conductance,
            solver: Solver::Cholesky,
            residual: 1e-10,
        };
        measure(&cell, &position, &[0.4999 * a; 64], &problem).unwrap().permeability / (a * a)
    }

    #[test]
    fn local_drag_of_a_cubic_lattice_is_near_stokes_flow() {
        // Sangani & Acrivos (1982): K = 42.1 at c = 0.5236, k/a² = 2 R²/(9 c K).
        let exact = 2.0 * 0.25 / (9.0 * std::f64::consts::FRAC_PI_6 * 42.1);
        let found = cubic(Conductance::LocalDrag, 1.0, 1.0);
        assert!((found / exact - 1.0).abs() < 0.12, "{found} against {exact}");
    }

    #[test]
    fn permeability_is_a_length_squared_whatever_the_viscosity() {
        for conductance in [Conductance::HydraulicRadius, Conductance::LocalDrag] {
            let (one, other) = (cubic(conductance, 1.0, 1.0), cubic(conductance, 1e-3, 1e-3));
            assert!(one > 0.0 && (one / other - 1.0).abs() < 1e-6, "{conductance:?}: {one} and {other}");
        }
    }
}
