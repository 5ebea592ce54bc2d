//! Walls besides those at the faces of the box: planes, rectangles, discs, cylinders, boxes, meshes of triangles.
//!
//! A grain touches a wall at every place that is nearer to its centre than all places of the wall around it: a **foot**.
//! A plane has one foot, a corner of a room three. Each lies on one **part** of the wall: a flat patch, an edge, a
//! corner, a rim. Coplanar triangles that share an edge are one patch, so a grain that rolls from one to the other
//! feels nothing. The contacts are pairs of a grain and a part, in the same list as all others.

pub mod glue;
mod mesh;
pub mod motion;
pub mod shape;
pub mod stl;

pub use glue::Glue;
pub use mesh::{Mesh, MeshError};
pub use motion::{Motion, Place};
pub use shape::{Foot, Shape};

use porograin_geometry::triangulation::FIRST_WALL;
use std::sync::Arc;

/// A wall as the case has it: what never changes during a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Its name.
    pub name: Arc<str>,
    /// What it looks like, where the case puts it.
    pub shape: Shape,
    /// How it moves.
    pub motion: Motion,
    /// Friction angle with the grains [degrees].
    pub friction: f64,
    /// Whether it is there: in a stage without it grains pass through.
    pub present: bool,
    /// Whether the grains that touch it when this begins stick to it.
    pub glue: bool,
    /// The number of its first part as the second of a pair, see [`number`].
    pub first: u32,
}

/// The wall and its part that the second of a pair stands for.
#[inline]
pub fn find(walls: &[Wall], second: u32) -> (usize, u32) {
    let wall = walls.partition_point(|wall| wall.first <= second) - 1;
    (wall, second - walls[wall].first)
}

/// Numbers the parts of all walls, as the second of a pair, after the faces of the box.
pub fn number(walls: &mut [Wall]) {
    let mut next = FIRST_WALL + 6;
    for wall in walls {
        wall.first = next;
        next += wall.shape.parts();
    }
}

/// Whether the second of a pair is a part of one of these walls, rather than a grain or a face of the box.
#[inline(always)]
pub fn is_part(second: u32) -> bool {
    second >= FIRST_WALL + 6
}
