//! One touching pair as a law sees it, whether two grains or a grain and a wall.

use crate::boundary::{Domain, Face};
use crate::grains::Grains;
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::triangulation::wall;

/// A touching pair.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// Unit vector from the first to the second.
    pub normal: DVec3,
    /// `R_i + R_j - |x_j - x_i|`, or the depth of a grain in a wall [m].
    pub overlap: f64,
    /// Radii of the two [m]; a wall takes the radius of the grain.
    pub radius: [f64; 2],
    /// Velocity of the second relative to the first, at the contact point, spins included [m/s].
    pub velocity: DVec3,
    /// Mean spin of the two about the normal [rad/s].
    pub twist: f64,
    /// Tangent of the friction angle [-].
    pub friction: f64,
}

/// Tangent stiffnesses of a contact [N/m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiffness {
    /// Along the normal.
    pub normal: f64,
    /// Across it.
    pub shear: f64,
}

impl Touch {
    /// Distances from the two centres to the contact point, the middle of the overlap [m].
    #[inline]
    pub fn levers(&self) -> [f64; 2] {
        [self.radius[0] - 0.5 * self.overlap, self.radius[1] - 0.5 * self.overlap]
    }

    /// A touch of spheres of the given radii that just meet, at rest: what a law's stiffness is asked of before there is a contact.
    pub fn prospective(radius: [f64; 2], overlap: f64) -> Touch {
        Touch { normal: DVec3::X, overlap, radius, velocity: DVec3::ZERO, twist: 0.0, friction: 0.0 }
    }
}

/// All that touches are made from: the grains, where the walls are and how fast, and friction.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    grains: &'a Grains,
    walls: [Wall; 6],
    friction: f64,
}

#[derive(Clone, Copy, Debug)]
struct Wall {
    position: f64,
    velocity: DVec3,
    friction: f64,
}

impl<'a> Surroundings<'a> {
    /// `friction` is the angle between grains, faces have their own [degrees].
    pub fn new(grains: &'a Grains, domain: &Domain, faces: &[Face; 6], friction: f64) -> Self {
        let walls = std::array::from_fn(|face| Wall {
            position: domain.cell.wall_position(face),
            velocity: domain.wall_velocity[face],
            friction: faces[face].friction.to_radians().tan(),
        });
        Surroundings { grains, walls, friction: friction.to_radians().tan() }
    }

    /// The touch of a pair. Without overlap it is still well defined (negative overlap).
    #[inline(always)]
    pub fn touch(&self, [first, second]: [u32; 2]) -> Touch {
        let (i, grains) = (first as usize, self.grains);
        let radius = grains.radius[i];
        match wall(second) {
            None => {
                let j = second as usize;
                let branch = grains.position[j] - grains.position[i];
                let distance = branch.length();
                let normal = branch / distance;
                let radii = [radius, grains.radius[j]];
                let overlap = radii[0] + radii[1] - distance;
                let half = 0.5 * overlap;
                // Both contact points move with their spins: -(l_i w_i + l_j w_j) x n.
                let roll = (radii[0] - half) * grains.spin[i] + (radii[1] - half) * grains.spin[j];
                Touch {
                    normal,
                    overlap,
                    radius: radii,
                    velocity: grains.velocity[j] - grains.velocity[i] - roll.cross(normal),
                    twist: 0.5 * (grains.spin[i] + grains.spin[j]).dot(normal),
                    friction: self.friction,
                }
            }
            Some(face) => {
                let (normal, plane) = (NORMALS[face], &self.walls[face]);
                let outward = if face % 2 == 0 { -1.0 } else { 1.0 };
                let overlap = radius - outward * (plane.position - grains.position[i][face / 2]);
                let lever = radius - 0.5 * overlap;
                Touch {
                    normal,
                    overlap,
                    radius: [radius, radius],
                    velocity: plane.velocity - grains.velocity[i] - (lever * grains.spin[i]).cross(normal),
                    twist: 0.5 * grains.spin[i].dot(normal),
                    friction: plane.friction,
                }
            }
        }
    }

    /// Whether a pair touches: what [`touch`](Self::touch) would call a positive overlap.
    #[inline(always)]
    pub fn touches(&self, [first, second]: [u32; 2]) -> bool {
        let (i, grains) = (first as usize, self.grains);
        match wall(second) {
            None => {
                let j = second as usize;
                let reach = grains.radius[i] + grains.radius[j];
                (grains.position[j] - grains.position[i]).length_squared() < reach * reach
            }
            Some(face) => {
                let outward = if face % 2 == 0 { -1.0 } else { 1.0 };
                grains.radius[i] > outward * (self.walls[face].position - grains.position[i][face / 2])
            }
        }
    }
}

/// The shear force turned with its pair: tilted onto the new tangent plane and twisted by `angle` [rad] about the
/// normal, its size kept. Exact for a rigid rotation in the limit of small steps.
#[inline(always)]
pub fn turn(shear: DVec3, normal: DVec3, angle: f64) -> DVec3 {
    let turned = shear - shear.dot(normal) * normal + angle * normal.cross(shear);
    let (before, after) = (shear.length_squared(), turned.length_squared());
    turned * if after > 0.0 { (before / after).sqrt() } else { 0.0 }
}
