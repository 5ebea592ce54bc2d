//! The regular (weighted Delaunay) triangulation of spheres in a [`Cell`](crate::Cell).
//!
//! A wall is the limit of a sphere of infinite radius, a vertex at infinity; the triangulation is then exactly the dual of the
//! power diagram restricted to the box. Topology is decided exactly for positions rounded once to `2^-50` of the
//! cell, ties by an infinitesimal distortion of the metric (see `predicates`), so the result depends neither on the
//! numbering of the grains (but for coinciding ones) nor on the order of insertion nor on the unit of length.

mod canonical;
pub(crate) mod frame;
pub(crate) mod lattice;
mod mesh;
mod periodic;

use crate::predicates::Forms;
use crate::{Cell, order};
use frame::Frame;
use glam::DVec3;
use mesh::{Mesh, Space};

/// A vertex of a pore: a grain `0..n`, or a wall `FIRST_WALL + face`.
pub type Vertex = u32;
/// The vertex number of the wall of face 0; wall `f` is `FIRST_WALL + f`.
pub const FIRST_WALL: Vertex = u32::MAX - 6;
/// No pore: beyond the outer facets spanned by three walls.
pub const NONE: u32 = u32::MAX;

/// The face number of a wall vertex, or `None` for a grain.
#[inline]
pub fn wall(vertex: Vertex) -> Option<usize> {
    if vertex >= FIRST_WALL { Some((vertex - FIRST_WALL) as usize) } else { None }
}

/// Vertices of facet `k` (opposite to vertex `k`) of a positively oriented pore, ordered so that the right-hand
/// normal points out of the pore.
pub const FACET: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Pores (tetrahedra) and their neighbours.
///
/// A pore with vertices `[a, b, c, d]` is positively oriented: `(b - a) x (c - a) · (d - a) > 0`, a wall counting as
/// the point at infinity along its outward normal (`b - a` is then that normal). Throat `k` of a pore is the
/// facet opposite its vertex `k`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Triangulation {
    /// The four vertices of each pore.
    pub pores: Vec<[Vertex; 4]>,
    /// The pore across each facet, or [`NONE`].
    pub neighbours: Vec<[u32; 4]>,
    /// Period shift of each vertex of each pore; empty without a periodic axis. The neighbour across a facet may
    /// name the same vertices with shifts that differ by one common shift.
    pub shifts: Vec<[[i8; 3]; 4]>,
    /// Grains whose power cell is empty: no pore has them as a vertex.
    pub hidden: Vec<u32>,
}

/// Why a triangulation cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriangulationError {
    /// The cell makes no sense, for the reason given.
    Cell(&'static str),
    /// As many radii as positions are needed.
    Lengths {
        /// Number of positions.
        positions: usize,
        /// Number of radii.
        radii: usize,
    },
    /// More grains than vertex numbers.
    TooMany,
    /// A position is not finite.
    Position {
        /// Index of the grain.
        grain: usize,
    },
    /// A radius is negative, not finite or more than 1000 times the size of the cell.
    Radius {
        /// Index of the grain.
        grain: usize,
    },
    /// A centre is so many periods away from the cell, or from a neighbour, that shifts do not fit 8 bits.
    Far {
        /// Index of the grain.
        grain: usize,
    },
    /// A centre lies beyond a wall.
    Outside {
        /// Index of the grain.
        grain: usize,
        /// Number of the face.
        face: usize,
    },
}

impl std::fmt::Display for TriangulationError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Cell(reason) => write!(f, "the cell cannot hold a triangulation: {reason}"),
            Self::Lengths { positions, radii } => {
                write!(f, "{positions} positions but {radii} radii were given")
            }
            Self::TooMany => write!(f, "more than {MOST_GRAINS} grains cannot be triangulated"),
            Self::Position { grain } => write!(f, "the position of grain {grain} is not finite"),
            Self::Radius { grain } => {
                write!(f, "the radius of grain {grain} is negative, not finite or over 1000 times the cell")
            }
            Self::Far { grain } => {
                write!(f, "grain {grain} lies more than 127 periods from the cell or a neighbour")
            }
            Self::Outside { grain, face } => {
                let name = ["left", "right", "front", "back", "bottom", "top"][*face];
                write!(f, "the centre of grain {grain} lies beyond the {name} wall (face {face})")
            }
        }
    }
}

impl std::error::Error for TriangulationError {}

/// Pore numbers are 32 bits and there are about seven pores per grain, eight and more on lattices.
const MOST_GRAINS: usize = 1 << 28;

impl Triangulation {
    /// The regular triangulation of spheres whose centres lie between the walls (or on them).
    ///
    /// Along periodic axes positions may lie in any period: [`shifts`](Self::shifts) are relative to the positions given. The periods
    /// may have any directions, but those of a partly periodic cell must be parallel to its walls, and walls are normal to
    /// x, y or z.
    ///
    /// `position` \[m\] and `radius` \[m\] have one entry per grain. No grain gives no pores. The numbering of the
    /// pores, and of the vertices in each, depends on the triangulation and the numbering of the grains only: pores come
    /// in the order of their smallest grain, so grains in [space-filling order](crate::order::hilbert) make later loops
    /// cache-friendly. A grain is [hidden](Self::hidden) if its power cell is empty (deep overlap) or if it
    /// coincides with a grain of equal radius and lower index.
    ///
    /// # Errors
    /// [`TriangulationError`] names the first grain that is not finite, has a negative radius or lies outside.
    pub fn new(cell: &Cell, position: &[DVec3], radius: &[f64]) -> Result<Self, TriangulationError> {
        if position.len() != radius.len() {
            return Err(TriangulationError::Lengths { positions: position.len(), radii: radius.len() });
        }
        if position.len() > MOST_GRAINS {
            return Err(TriangulationError::TooMany);
        }
        let frame = Frame::new(cell)?;
        let curve = order::hilbert(cell, position);
        let mut points = Vec::with_capacity(position.len());
        let mut periods = Vec::new();
        for (grain, (&x, &r)) in position.iter().zip(radius).enumerate() {
            let placed = frame.place(grain, x, r)?;
            points.push(placed.point);
            if cell.periodic != [false; 3] {
                periods.push(placed.periods);
            }
        }
        let points: Vec<[f64; 4]> = curve.iter().map(|&i| points[i as usize]).collect();
        let grains = points.len();
        let spacing = (frame.volume / grains.max(1) as f64).cbrt().max(1.0);
        let space = Space {
            lower: [0.0; 3],
            upper: frame.upper,
            lattice: frame.lattice,
            forms: Forms::new(cell.periodic),
            reach: spacing.log2().round().exp2(),
            largest: points.iter().map(|p| p[3]).fold(0.0, f64::max),
        };
        if cell.periodic != [false; 3] {
            return periodic::triangulate(&points, &curve, &periods, &space, spacing);
        }
        let mut mesh = Mesh::new(points, curve, &space);
        let mut rounds = order::rounds(grains, 4).0.into_iter();
        if let Some(first) = rounds.next() {
            mesh.start(first);
        }
        rounds.for_each(|grain| mesh.insert(grain));
        Ok(canonical::number(&mesh, grains))
    }
}
