//! The region the grains live in: a parallelepiped whose axes are each walled or periodic.

use glam::{DMat3, DVec3};

/// A parallelepiped `origin + a s0 + b s1 + c s2`, `0 <= a, b, c <= 1`; each axis is walled or periodic.
///
/// The two faces across a walled axis are planes orthogonal to x, y or z. Faces are numbered
/// `0..6`: x low, x high, y low, y high, z low, z high (left, right, front, back, bottom, top).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Cell {
    /// The corner with the lowest coordinates along the edges [m].
    pub origin: DVec3,
    /// The edge vectors as columns [m].
    pub edges: DMat3,
    /// Which axes repeat periodically; the others end at walls.
    pub periodic: [bool; 3],
}

/// Outward unit normals of the six faces of a walled box, in face order.
pub const NORMALS: [DVec3; 6] = [DVec3::NEG_X, DVec3::X, DVec3::NEG_Y, DVec3::Y, DVec3::NEG_Z, DVec3::Z];

impl Cell {
    /// An axis-aligned box with six walls.
    pub fn walled(lower: DVec3, upper: DVec3) -> Self {
        Cell { origin: lower, edges: DMat3::from_diagonal(upper - lower), periodic: [false; 3] }
    }

    /// A fully periodic lattice with the given edge vectors as columns.
    pub fn periodic(origin: DVec3, edges: DMat3) -> Self {
        Cell { origin, edges, periodic: [true; 3] }
    }

    /// The corner opposite to [`origin`](Self::origin); of a walled box the upper corner [m].
    pub fn upper(&self) -> DVec3 {
        self.origin + self.edges.x_axis + self.edges.y_axis + self.edges.z_axis
    }

    /// Volume of one period [m³].
    pub fn volume(&self) -> f64 {
        self.edges.determinant().abs()
    }

    /// Position of a walled face along its axis [m].
    pub fn wall_position(&self, face: usize) -> f64 {
        let axis = face / 2;
        if face % 2 == 0 { self.origin[axis] } else { self.upper()[axis] }
    }

    /// The displacement of the period `shift` [m].
    pub fn shift(&self, shift: [i8; 3]) -> DVec3 {
        self.edges * DVec3::new(shift[0] as f64, shift[1] as f64, shift[2] as f64)
    }
}
