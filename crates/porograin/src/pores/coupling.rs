//! The reciprocal coupling (`physics` §3b): one set of coefficients gives both the force of a throat's pressure
//! difference on its grains and, transposed, the volume their motion carries through it. So the water can never do
//! more work than it is given.

use super::conductance::{Conductance, Passage};
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::throat::Packing;
use porograin_geometry::triangulation::wall;
use std::ops::{AddAssign, SubAssign};

/// What a pore does to one of its vertices per unit of its pressure: force [m²], then torque [m³]. Also the volume that leaves the pore
/// per unit of velocity, then spin, of that vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push(pub [f64; 6]);

impl Push {
    /// Of a force [m²] and a torque [m³].
    pub fn new(force: DVec3, torque: DVec3) -> Push {
        Push([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    }

    /// [m²]
    pub fn force(&self) -> DVec3 {
        DVec3::from_slice(&self.0)
    }

    /// [m³]
    pub fn torque(&self) -> DVec3 {
        DVec3::from_slice(&self.0[3..])
    }
}

impl AddAssign for Push {
    fn add_assign(&mut self, other: Push) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }
}

impl SubAssign for Push {
    fn sub_assign(&mut self, other: Push) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a -= b);
    }
}

/// Force and torque on each vertex per unit of `p_i - p_j` [m², m³]; also the volume carried from pore i to pore j
/// per unit velocity and spin of that vertex. Walls have no torque.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThroatCoupling {
    /// `(A_k + A_f w_k) n`.
    pub force: [DVec3; 3],
    /// `A_f s_k l_k x n`.
    pub torque: [DVec3; 3],
}

/// The coupling of one throat whose vertices stand at `points` (`None`: a wall).
///
/// The pressure acts on the areas the grains cover; the viscous force on the fluid area is shared by `s_k` and
/// acts on the grains' surfaces, at `l_k = R_k e_k`. The throat's water is in balance only if its total acts
/// through the centroid of the fluid area, which shifts the shares along the facet. Three grains balance both
/// moments of the facet; two grains and a wall the one along the wall, for the wall (a mirror) takes the other;
/// one grain between two walls takes all.
pub fn coupling(
    packing: Packing,
    passage: &Passage,
    points: [Option<DVec3>; 3],
    conductance: Conductance,
) -> ThroatCoupling {
    let shape = passage.shape;
    let mut result = ThroatCoupling::default();
    let Some(origin) = points.iter().flatten().next().copied() else { return result };
    if shape.area == 0.0 {
        return result;
    }
    let n = shape.normal;
    let fluid = shape.fluid_area;
    let share = conductance.shares(passage);

    // First moment of the fluid area about `origin`; its centroid tells which way the water pulls.
    let mut moment = shape.area * (shape.centroid - origin);
    for k in 0..3 {
        if let Some(x) = points[k] {
            moment -= shape.covered[k] * (x - origin) + shape.covered_moment[k];
        }
    }
    let centroid = if fluid > 1e-6 * shape.area { origin + moment / fluid } else { shape.centroid };

    // What of that moment the shares at the surfaces leave over.
    let mut lever = [DVec3::ZERO; 3];
    let mut rest = moment;
    for k in 0..3 {
        match points[k] {
            Some(x) => {
                let radius = packing.radius[passage.vertices[k] as usize];
                lever[k] = (centroid - x).normalize_or_zero() * radius;
                rest -= fluid * share[k] * (x - origin + lever[k]);
            }
            None => rest -= fluid * share[k] * (centroid - origin),
        }
    }

    let mut weight: [f64; 3] = std::array::from_fn(|k| shape.covered[k] + fluid * share[k]);
    match points {
        [Some(a), Some(b), Some(c)] => {
            for (k, edge) in [c - b, a - c, b - a].into_iter().enumerate() {
                weight[k] += n.cross(edge).dot(rest) / (2.0 * shape.area);
            }
        }
        _ => {
            let grains: Vec3Index = grains_of(points);
            if let (Some((i, a)), Some((j, b)), Some(face)) = (grains[0], grains[1], wall_of(passage)) {
                let normal = NORMALS[face];
                let along = (b - a) - normal * (b - a).dot(normal);
                let shifted = along.dot(rest) / along.length_squared();
                weight[i] -= shifted;
                weight[j] += shifted;
            }
        }
    }
    for k in 0..3 {
        result.force[k] = weight[k] * n;
        if points[k].is_some() {
            // A disc cut by the opposite edge keeps, for the spin, the moment of its whole sector: the wedges of
            // a pore then still close around each grain, and a rigid rotation pumps nothing.
            let cut = shape.covered_moment[k] - shape.sector_moment[k];
            result.torque[k] = (fluid * share[k] * lever[k] + cut).cross(n);
        }
    }
    result
}

type Vec3Index = [Option<(usize, DVec3)>; 2];

/// The first two grains of a facet, with their slots.
fn grains_of(points: [Option<DVec3>; 3]) -> Vec3Index {
    let mut grains = points.iter().enumerate().filter_map(|(k, p)| p.map(|p| (k, p)));
    [grains.next(), grains.next()]
}

/// The face of the first wall of a facet.
fn wall_of(passage: &Passage) -> Option<usize> {
    passage.vertices.iter().find_map(|&v| wall(v))
}
