//! The arrays everything works on: grains, and the loads that act on them.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What the grains are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// Spheres.
    #[default]
    Sphere,
    /// Discs with axes along y that move in the plane of x and z.
    Disc {
        /// Along y [m].
        thickness: f64,
    },
}

impl Shape {
    /// Volume of a grain of this radius [m³].
    #[inline]
    pub fn volume(self, radius: f64) -> f64 {
        match self {
            Shape::Sphere => sphere_volume(radius),
            Shape::Disc { thickness } => std::f64::consts::PI * radius * radius * thickness,
        }
    }

    /// Moment of inertia over mass and squared radius [-]; of a disc about its axis.
    #[inline]
    pub fn gyration(self) -> f64 {
        match self {
            Shape::Sphere => 0.4,
            Shape::Disc { .. } => 0.5,
        }
    }
}

/// Grains, one entry per grain in every array.
///
/// Velocities belong to the middle of the last step
/// (leapfrog, `physics` §2): `position(t)`, `velocity(t - dt/2)`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Grains {
    /// What they are.
    pub shape: Shape,
    /// Centres [m].
    pub position: Vec<DVec3>,
    /// Velocities of the centres [m/s].
    pub velocity: Vec<DVec3>,
    /// Angular velocities [rad/s].
    pub spin: Vec<DVec3>,
    /// Radii [m].
    pub radius: Vec<f64>,
    /// Masses [kg].
    pub mass: Vec<f64>,
    /// What they are made of: a number the [laws](crate::contact::Laws) tell apart; all 0 where the case names none.
    pub material: Vec<u16>,
    /// The number a user knows the grain by (its line in the input, its order of creation): the arrays are kept in
    /// an order that keeps [neighbours close](crate::packing::ordered), outputs are written in order of `id`.
    pub id: Vec<u32>,
}

impl Grains {
    /// Spheres at rest with `mass = density 4/3 pi r³`, numbered in the given order.
    pub fn at_rest(position: Vec<DVec3>, radius: Vec<f64>, density: f64) -> Self {
        Self::shaped(Shape::Sphere, position, radius, density)
    }

    /// Grains of one shape at rest, numbered in the given order.
    pub fn shaped(shape: Shape, position: Vec<DVec3>, radius: Vec<f64>, density: f64) -> Self {
        let n = position.len();
        Grains {
            shape,
            velocity: vec![DVec3::ZERO; n],
            spin: vec![DVec3::ZERO; n],
            mass: radius.iter().map(|&r| density * shape.volume(r)).collect(),
            material: vec![0; n],
            id: (0..n as u32).collect(),
            position,
            radius,
        }
    }

    /// Number of grains.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Whether there is no grain at all.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Moment of inertia of grain `i`: of a sphere about any axis through its centre, `2/5 m r²`; of a disc about its own,
    /// `1/2 m r²` [kg m²].
    #[inline]
    pub fn inertia(&self, i: usize) -> f64 {
        self.shape.gyration() * self.mass[i] * self.radius[i] * self.radius[i]
    }

    /// Sum of the grains' volumes [m³]; overlaps count twice.
    pub fn volume(&self) -> f64 {
        self.radius.iter().map(|&r| self.shape.volume(r)).sum()
    }
}

/// `4/3 pi r³`.
#[inline]
pub fn sphere_volume(radius: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * radius * radius * radius
}

/// Forces [N] and torques about the centres [N m] of one instant. Every law adds here; only motion reads it.
#[derive(Clone, Debug, PartialEq)]
pub struct Loads {
    /// Force on each grain.
    pub force: Vec<DVec3>,
    /// Torque on each grain.
    pub torque: Vec<DVec3>,
    /// Force on the wall of each face, in face order.
    pub wall: [DVec3; 6],
    /// What acts on each wall that the case adds.
    pub walls: Vec<Push>,
    /// What the water does to a periodic cell: its power per component of the velocity gradient [J]. Over the volume that
    /// is its share of the stress.
    pub cell: DMat3,
    /// `sum F ⊗ branch` over the contacts, F on the second and the row along F [N m]; only where something asks for it.
    pub virial: Option<DMat3>,
}

impl Default for Loads {
    fn default() -> Self {
        // By hand: the default of a matrix is the identity.
        let (force, torque, walls) = (Vec::new(), Vec::new(), Vec::new());
        Loads { force, torque, wall: [DVec3::ZERO; 6], walls, cell: DMat3::ZERO, virial: None }
    }
}

/// A force and a moment on a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// [N]
    pub force: DVec3,
    /// About the centre of the body [N m].
    pub moment: DVec3,
}

/// Loads set to zero by a thread at once.
const CLEARED: usize = 8192;

impl Loads {
    /// Zero loads for `n` grains, keeping the memory.
    pub fn clear(&mut self, n: usize) {
        for list in [&mut self.force, &mut self.torque] {
            list.resize(n, DVec3::ZERO);
            list.par_chunks_mut(CLEARED).for_each(|part| part.fill(DVec3::ZERO));
        }
        self.wall = [DVec3::ZERO; 6];
        self.walls.clear();
        self.cell = DMat3::ZERO;
        self.virial = None;
    }
}
