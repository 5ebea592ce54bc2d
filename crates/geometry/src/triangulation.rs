//! The regular (weighted Delaunay) triangulation of spheres in a [`Cell`](crate::Cell).
//!
//! A wall is the limit of a sphere of infinite radius, a vertex at infinity; the triangulation is then exactly the dual of the
//! power diagram restricted to the box. Topology is decided exactly for positions rounded once to `2^-50` of the
//! cell, ties by an infinitesimal distortion of the metric (see `predicates`), so the result depends neither on the
//! numbering of the grains (but for coinciding ones) nor on the order of insertion nor on the unit of length.

mod canonical;
mod flips;
pub(crate) mod frame;
pub(crate) mod lattice;
mod mesh;
mod periodic;
mod regular;
mod repair;
mod view;

use crate::predicates::Forms;
use crate::{Cell, order};
use frame::Frame;
use glam::DVec3;
use mesh::Mesh;
use repair::{GaveUp, Patch};
use view::{Space, View};

/// A vertex of a pore: a grain `0..n`, or a wall `FIRST_WALL + face`.
pub type Vertex = u32;
/// The vertex number of the wall of face 0; wall `f` is `FIRST_WALL + f`. Numbers from `FIRST_WALL + 6` on are free for
/// walls that are no faces of the box.
pub const FIRST_WALL: Vertex = 1 << 31;
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
        Sample::new(cell, position, radius)?.triangulate(cell, position)
    }

    /// Follows the grains to new positions, radii or a new cell: the same result as [`new`](Self::new), bit for bit, and
    /// cheaper if few pores change.
    ///
    /// Any triangulation of as many grains will do as a start; if too much has changed, or if the power spheres are not small against
    /// the period (a few hundred grains), it is rebuilt.
    ///
    /// # Errors
    /// Those of [`new`](Self::new); the triangulation is then unchanged.
    pub fn repair(
        &mut self,
        cell: &Cell,
        position: &[DVec3],
        radius: &[f64],
    ) -> Result<Repair, TriangulationError> {
        let sample = Sample::new(cell, position, radius)?;
        if let Some(report) = sample.follow(self)? {
            return Ok(report);
        }
        *self = sample.triangulate(cell, position)?;
        Ok(Repair { rebuilt: true, ..Default::default() })
    }
}

/// What a [repair](Triangulation::repair) did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repair {
    /// The triangulation was made afresh.
    pub rebuilt: bool,
    /// Number of flips: two pores made three, three made two, or four made four.
    pub flips: usize,
    /// Number of holes that were refilled where flips do not help.
    pub holes: usize,
    /// Number of pores that were replaced.
    pub replaced: usize,
    /// Number of grains that were inserted anew: hidden before, or left without a pore.
    pub reinserted: usize,
}

/// Checked and snapped input, in the user's numbering.
struct Sample {
    points: Vec<[f64; 4]>,
    /// Periods taken away from each grain; empty without a periodic axis.
    periods: Vec<[i32; 3]>,
    space: Space,
    spacing: f64,
}

impl Sample {
    fn new(cell: &Cell, position: &[DVec3], radius: &[f64]) -> Result<Self, TriangulationError> {
        if position.len() != radius.len() {
            return Err(TriangulationError::Lengths { positions: position.len(), radii: radius.len() });
        }
        if position.len() > MOST_GRAINS {
            return Err(TriangulationError::TooMany);
        }
        let frame = Frame::new(cell)?;
        let mut points = Vec::with_capacity(position.len());
        let mut periods = Vec::new();
        for (grain, (&x, &r)) in position.iter().zip(radius).enumerate() {
            let placed = frame.place(grain, x, r)?;
            points.push(placed.point);
            if cell.periodic != [false; 3] {
                periods.push(placed.periods);
            }
        }
        let spacing = (frame.volume / points.len().max(1) as f64).cbrt().max(1.0);
        let space = Space {
            lower: [0.0; 3],
            upper: frame.upper,
            lattice: frame.lattice,
            forms: Forms::new(cell.periodic),
            reach: spacing.log2().round().exp2(),
            largest: points.iter().map(|p| p[3]).fold(0.0, f64::max),
        };
        Ok(Sample { points, periods, space, spacing })
    }

    fn triangulate(&self, cell: &Cell, position: &[DVec3]) -> Result<Triangulation, TriangulationError> {
        let curve = order::hilbert(cell, position);
        let points: Vec<[f64; 4]> = curve.iter().map(|&i| self.points[i as usize]).collect();
        if cell.periodic != [false; 3] {
            return periodic::triangulate(
                &points,
                &curve,
                &self.points,
                &self.periods,
                &self.space,
                self.spacing,
            );
        }
        let grains = points.len();
        let mut mesh = Mesh::new(View::new(&points, &curve, grains as u32, &self.space));
        let mut rounds = order::rounds(grains, 4).0.into_iter();
        if let Some(first) = rounds.next() {
            mesh.start(first);
        }
        rounds.for_each(|grain| mesh.insert(grain));
        Ok(canonical::number(&mesh, grains))
    }

    /// Repairs a triangulation of the same grains; `None` (and no change) if that does not work.
    fn follow(&self, old: &mut Triangulation) -> Result<Option<Repair>, TriangulationError> {
        let n = self.points.len();
        let lattice = &self.space.lattice;
        let torus = lattice.periodic != [false; 3];
        if !old.fits(n, lattice.periodic) {
            return Ok(None);
        }
        let labels: Vec<u32> = (0..n as u32).collect();
        let view = View::new(&self.points, &labels, FIRST_WALL, &self.space);
        // Power spheres must be small against the period, so that vertices are met at the nearest images.
        let small = |power: f64| power < view.most_power;
        // More are as well built afresh (each costs some seven times the survey of a pore); in a torus, where holes must not
        // wind around, even of a small sample.
        let few = old.pores.len() / 3 + if torus { 0 } else { 8 };
        let Some(survey) = view.survey(&old.pores, &old.neighbours, few) else { return Ok(None) };
        if !small(survey.largest) {
            return Ok(None);
        }
        let shifts = |pores: &[[Vertex; 4]]| match torus {
            true => periodic::shifts(pores, &self.points, &self.periods, lattice),
            false => Ok(Vec::new()),
        };
        if survey.bad.is_empty() && survey.inverted.is_empty() && old.hidden.is_empty() {
            old.shifts = shifts(&old.pores)?;
            return Ok(Some(Repair::default()));
        }
        let mut patch = Patch::new(view, old);
        let mended = match patch.mend(&survey) {
            Ok((new, report, largest)) if small(largest) => {
                shifts(&new.pores).map(|shifts| Some((Triangulation { shifts, ..new }, report)))
            }
            Ok(_) | Err(GaveUp) => Ok(None),
        };
        if let Ok(Some((new, report))) = mended {
            *old = new;
            return Ok(Some(report));
        }
        patch.undo();
        mended.map(|_| None)
    }
}

impl Triangulation {
    /// Whether this can be a triangulation of `n` grains in a cell with these periodic axes.
    fn fits(&self, n: usize, periodic: [bool; 3]) -> bool {
        let mut used = vec![false; n];
        let mut before = [0; 4];
        for pore in &self.pores {
            for &v in pore {
                match wall(v) {
                    Some(face) if face > 5 || periodic[face / 2] => return false,
                    Some(_) => {}
                    None if (v as usize) < n => used[v as usize] = true,
                    None => return false,
                }
            }
            // Numbered as `new` does it.
            let [a, b, c, d] = *pore;
            if a >= FIRST_WALL || a > b || b > c || b > d || *pore < before {
                return false;
            }
            before = *pore;
        }
        for &g in &self.hidden {
            match used.get_mut(g as usize) {
                Some(used) if !*used => *used = true,
                _ => return false,
            }
        }
        let pores = self.pores.len();
        n > 0
            && used.iter().all(|&u| u)
            && self.neighbours.len() == pores
            && self.shifts.len() == if periodic == [false; 3] { 0 } else { pores }
            && self.neighbours.iter().all(|sides| sides.iter().all(|&p| p == NONE || (p as usize) < pores))
    }
}
