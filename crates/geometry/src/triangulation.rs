//! The regular (weighted Delaunay) triangulation of spheres in a [`Cell`](crate::Cell).

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
