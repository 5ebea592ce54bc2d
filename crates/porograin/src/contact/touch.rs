//! One touching pair as a law sees it, whether two grains or a grain and a wall.

use super::{Law, Laws};
use crate::boundary::{Domain, Face};
use crate::grains::{Grains, Push};
use crate::walls::{self, Wall};
use glam::{DMat3, DVec3};
use porograin_geometry::Period;
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
    /// Spin of the second relative to the first [rad/s]: what rolls and twists.
    pub spin: DVec3,
    /// Mean spin of the two about the normal [rad/s].
    pub twist: f64,
    /// Tangent of the friction angle [-].
    pub friction: f64,
    /// Reduced mass `m_i m_j / (m_i + m_j)`; at a wall the mass of the grain [kg].
    pub mass: f64,
}

/// Tangent stiffnesses of a contact [N/m] and its dampers [N s/m].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stiffness {
    /// Along the normal.
    pub normal: f64,
    /// Across it.
    pub shear: f64,
    /// Damper along the normal.
    pub normal_damper: f64,
    /// Damper across it.
    pub shear_damper: f64,
    /// Against rolling [N m/rad].
    pub roll: f64,
    /// Against twisting [N m/rad].
    pub twist: f64,
}

impl Stiffness {
    /// The dampers in the place of the springs.
    pub fn dampers(&self) -> Stiffness {
        Stiffness { normal: self.normal_damper, shear: self.shear_damper, ..Stiffness::default() }
    }
}

impl Touch {
    /// Distances from the two centres to the contact point, the middle of the overlap [m].
    #[inline(always)]
    pub fn levers(&self) -> [f64; 2] {
        [self.radius[0] - 0.5 * self.overlap, self.radius[1] - 0.5 * self.overlap]
    }

    /// The part of the relative velocity across the normal [m/s].
    #[inline(always)]
    pub fn sliding(&self) -> DVec3 {
        self.velocity - self.velocity.dot(self.normal) * self.normal
    }

    /// A touch of spheres of the given radii [m] and reduced mass [kg] at rest: what a law's stiffness is asked of before
    /// there is a contact.
    pub fn prospective(radius: [f64; 2], overlap: f64, mass: f64) -> Touch {
        Touch {
            normal: DVec3::X,
            overlap,
            radius,
            velocity: DVec3::ZERO,
            spin: DVec3::ZERO,
            twist: 0.0,
            friction: 0.0,
            mass,
        }
    }
}

/// A near pair as it is gathered from the arrays: all that tells a wall from a grain.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// From the centre of the first to that of the second, or to the foot on the wall [m].
    pub branch: DVec3,
    /// Length of the branch at which the two just touch [m].
    pub reach: f64,
    /// Radii of the two [m]; a wall takes the radius of the grain.
    pub radius: [f64; 2],
    /// Velocity of the second relative to the first [m/s]; of a wall, at the foot.
    pub velocity: DVec3,
    /// Spins of the two [rad/s]; a wall has none unless it turns.
    pub spin: [DVec3; 2],
    /// By how much the velocity of a wall that turns changes as the grain goes along it [m/s²].
    pub swing: DVec3,
    /// Tangent of the friction angle [-].
    pub friction: f64,
    /// Reduced mass [kg].
    pub mass: f64,
}

impl Near {
    /// The touch of the pair; without overlap it is still well defined (negative overlap).
    #[inline(always)]
    pub fn touch(&self) -> Touch {
        let distance = self.branch.length();
        let normal = self.branch * (1.0 / distance);
        let overlap = self.reach - distance;
        let half = 0.5 * overlap;
        // Both contact points move with their spins: -(l_i w_i + l_j w_j) x n.
        let roll = (self.radius[0] - half) * self.spin[0] + (self.radius[1] - half) * self.spin[1];
        Touch {
            normal,
            overlap,
            radius: self.radius,
            velocity: self.velocity - roll.cross(normal),
            spin: self.spin[1] - self.spin[0],
            twist: 0.5 * (self.spin[0] + self.spin[1]).dot(normal),
            friction: self.friction,
            mass: self.mass,
        }
    }
}

/// All that touches are made from: the grains, where the walls are and how fast, and friction.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The grains.
    pub grains: &'a Grains,
    /// The laws.
    pub laws: &'a Laws,
    faces: [Side; 6],
    /// The walls that the case adds.
    pub walls: &'a [Wall],
    /// Where all walls are.
    pub domain: &'a Domain,
    friction: f64,
    /// Where the cell is periodic: its periods, and how fast images move per shift [1/s].
    period: Option<(Period, DMat3)>,
}

/// The wall at a face.
#[derive(Clone, Copy, Debug)]
struct Side {
    position: f64,
    velocity: DVec3,
    friction: f64,
}

impl<'a> Surroundings<'a> {
    /// Of a state and a model, in parts.
    pub fn new(
        grains: &'a Grains,
        domain: &'a Domain,
        faces: &[Face; 6],
        walls: &'a [Wall],
        laws: &'a Laws,
    ) -> Self {
        let faces = std::array::from_fn(|face| Side {
            position: domain.cell.wall_position(face),
            velocity: domain.wall_velocity[face],
            friction: faces[face].friction.to_radians().tan(),
        });
        let period = Period::of(&domain.cell).map(|period| (period, domain.gradient));
        let friction = laws.all.friction().to_radians().tan();
        Surroundings { grains, laws, faces, walls, domain, friction, period }
    }

    /// The law of a pair.
    #[inline]
    pub fn law(&self, pair: [u32; 2]) -> &'a Law {
        self.laws.own(self.grains, pair).unwrap_or(&self.laws.all)
    }

    /// The touch of a pair under the law that acts on it.
    #[inline(always)]
    pub fn touch(&self, pair: [u32; 2]) -> Touch {
        self.touch_of(pair, &self.near(pair))
    }

    /// The touch of a pair that is gathered already.
    #[inline(always)]
    pub(super) fn touch_of(&self, pair: [u32; 2], near: &Near) -> Touch {
        let touch = near.touch();
        match self.laws.own(self.grains, pair) {
            Some(law) => Touch { friction: law.friction().to_radians().tan(), ..touch },
            None => touch,
        }
    }

    /// What is gathered of a pair; friction as if there were one law for all.
    #[inline(always)]
    pub fn near(&self, pair: [u32; 2]) -> Near {
        self.near_with::<true>(pair)
    }

    /// The same; where no pair can be with part of a wall that the case adds (`PARTS` is false) the way there is left out,
    /// for its mere presence keeps the compiler from holding the others in registers.
    #[inline(always)]
    pub fn near_with<const PARTS: bool>(&self, [first, second]: [u32; 2]) -> Near {
        let (i, grains) = (first as usize, self.grains);
        let radius = grains.radius[i];
        match wall(second) {
            None => {
                let j = second as usize;
                let reach = radius + grains.radius[j];
                let mut branch = grains.position[j] - grains.position[i];
                let mut velocity = grains.velocity[j] - grains.velocity[i];
                if let Some((period, gradient)) = &self.period
                    && branch.length_squared() > reach * reach
                {
                    let shift = period.nearest(branch);
                    branch += shift;
                    velocity += *gradient * shift;
                }
                Near {
                    branch,
                    reach,
                    radius: [radius, grains.radius[j]],
                    velocity,
                    spin: [grains.spin[i], grains.spin[j]],
                    swing: DVec3::ZERO,
                    friction: self.friction,
                    mass: grains.mass[i] * grains.mass[j] / (grains.mass[i] + grains.mass[j]),
                }
            }
            Some(6..) if PARTS => self.near_part(i, second),
            Some(face) => {
                let plane = &self.faces[face];
                let outward = if face % 2 == 0 { -1.0 } else { 1.0 };
                // A centre on the wall has a normal still.
                let distance = (outward * (plane.position - grains.position[i][face / 2])).max(1e-9 * radius);
                Near {
                    branch: distance * NORMALS[face],
                    reach: radius,
                    radius: [radius, radius],
                    velocity: plane.velocity - grains.velocity[i],
                    spin: [grains.spin[i], DVec3::ZERO],
                    swing: DVec3::ZERO,
                    friction: plane.friction,
                    mass: grains.mass[i],
                }
            }
        }
    }

    /// A grain near a part of a wall that the case adds: out of the way of all other pairs.
    #[cold]
    #[inline(never)]
    fn near_part(&self, i: usize, second: u32) -> Near {
        let (grains, (k, part)) = (self.grains, walls::find(self.walls, second));
        let (wall, place, radius) = (&self.walls[k], &self.domain.walls[k], self.grains.radius[i]);
        let foot = wall.shape.foot(part, place.back(grains.position[i]));
        // A centre on the wall has a normal still.
        let distance = foot.branch.length();
        let branch = if distance > 1e-9 * radius { foot.branch } else { 1e-9 * radius * foot.normal };
        let branch = place.turn * branch;
        // The wall is a grain of the same radius on the other side, which turns with it.
        let across = branch.length();
        let other = grains.position[i] + branch * ((radius + across) / across);
        let centre = place.forth(wall.shape.centre());
        let velocity = place.velocity + place.spin.cross(other - centre);
        Near {
            branch,
            reach: radius,
            radius: [radius, radius],
            velocity: velocity - grains.velocity[i],
            spin: [grains.spin[i], place.spin],
            swing: place.spin.cross(grains.velocity[i] - place.velocity),
            friction: wall.friction.to_radians().tan(),
            mass: grains.mass[i],
        }
    }

    /// Gives the opposite of what acts on a grain about its centre to the wall of the pair, about the wall's centre.
    pub(super) fn react(&self, [first, second]: [u32; 2], on_grain: &Push, on_walls: &mut [Push]) {
        let (k, _) = walls::find(self.walls, second);
        let centre = self.domain.walls[k].forth(self.walls[k].shape.centre());
        let lever = self.grains.position[first as usize] - centre;
        on_walls[k].force -= on_grain.force;
        on_walls[k].moment -= lever.cross(on_grain.force) + on_grain.moment;
    }

    /// Whether a pair touches: what [`touch`](Self::touch) would call a positive overlap.
    #[inline(always)]
    pub fn touches(&self, [first, second]: [u32; 2]) -> bool {
        let (i, grains) = (first as usize, self.grains);
        match wall(second) {
            None => {
                let j = second as usize;
                let reach = grains.radius[i] + grains.radius[j];
                let branch = grains.position[j] - grains.position[i];
                let touches = |branch: DVec3| branch.length_squared() < reach * reach;
                touches(branch)
                    || self.period.as_ref().is_some_and(|(p, _)| touches(branch + p.nearest(branch)))
            }
            Some(6..) => {
                let near = self.near_part(i, second);
                near.branch.length_squared() < near.reach * near.reach
            }
            Some(face) => {
                let outward = if face % 2 == 0 { -1.0 } else { 1.0 };
                grains.radius[i] > outward * (self.faces[face].position - grains.position[i][face / 2])
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
