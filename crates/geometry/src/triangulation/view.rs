//! The vertices of pores as seen from a query grain, and the exact tests on them.

use super::FACET;
use super::lattice::Lattice;
use crate::predicates::{self, ExactQuery, ExactRow, Filter, Forms, Row, Sphere};

/// Where the grains are, and what settles ties.
#[derive(Clone, Copy)]
pub(super) struct Space {
    /// Positions of the lower walls.
    pub lower: [f64; 3],
    /// Positions of the upper walls.
    pub upper: [f64; 3],
    pub lattice: Lattice,
    pub forms: Forms,
    /// A typical distance of neighbours (a power of two) and the largest weight.
    pub reach: f64,
    pub largest: f64,
}

/// The grains of a triangulation. Vertices are grains `0..n` or walls `first_wall + face`.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    /// `[x, y, z, w]` of every grain, whole numbers.
    pub points: &'a [[f64; 4]],
    /// Index of every grain in the user's numbering, for ties.
    label: &'a [u32],
    first_wall: u32,
    lower: [f64; 3],
    upper: [f64; 3],
    /// Differences are taken to the nearest image; without periods that changes nothing.
    pub lattice: Lattice,
    pub torus: bool,
    forms: Forms,
    /// A power of two near the distance of neighbours: wall rows are scaled by it so that the columns of the
    /// determinants hold numbers of one magnitude (the filter needs that).
    reach: f64,
    pub filter: Filter,
    /// Spheres of a larger power do not fit into the period, see [`FIT`](super::periodic::FIT).
    pub most_power: f64,
}

impl<'a> View<'a> {
    /// Points and labels in the numbering of the vertices; walls are numbered from `first_wall`.
    pub fn new(points: &'a [[f64; 4]], label: &'a [u32], first_wall: u32, space: &Space) -> Self {
        let radius = space.lattice.least_height() * (1.0 - 1e-9) / super::periodic::FIT;
        View {
            points,
            label,
            first_wall,
            lower: space.lower,
            upper: space.upper,
            lattice: space.lattice,
            torus: space.lattice.periodic != [false; 3],
            forms: space.forms,
            reach: space.reach,
            filter: Filter::new(space.reach, space.largest),
            most_power: radius * radius - space.largest,
        }
    }

    /// The same with other numbers for the walls.
    pub fn with_walls_from(self, first_wall: u32) -> Self {
        View { first_wall, ..self }
    }

    #[inline(always)]
    pub fn is_grain(&self, vertex: u32) -> bool {
        (vertex as usize) < self.points.len()
    }

    /// The face of a wall.
    fn face(&self, wall: u32) -> usize {
        (wall - self.first_wall) as usize
    }

    /// The row of a vertex seen from a query.
    #[inline(always)]
    pub fn row(&self, vertex: u32, query: [f64; 4]) -> Row {
        match self.points.get(vertex as usize) {
            Some(p) => {
                let d = self.lattice.nearest([p[0] - query[0], p[1] - query[1], p[2] - query[2]]);
                predicates::grain_row(d, p[3] - query[3])
            }
            None => self.wall_row(self.face(vertex), query),
        }
    }

    fn wall_row(&self, face: usize, query: [f64; 4]) -> Row {
        let axis = face / 2;
        let normal = if face % 2 == 0 { -1.0 } else { 1.0 };
        let distance = self.distance(face, query);
        let l = 2.0 * distance * self.reach;
        let mut d = [0.0; 3];
        d[axis] = normal * self.reach;
        Row { x: d[0], y: d[1], z: d[2], l, t: l + self.reach * self.reach }
    }

    /// Distance of a query from a wall.
    fn distance(&self, face: usize, query: [f64; 4]) -> f64 {
        let axis = face / 2;
        if face % 2 == 0 { query[axis] - self.lower[axis] } else { self.upper[axis] - query[axis] }
    }

    /// The rows of a pore, all seen in the same image.
    ///
    /// In a torus the nearest of the four is met at its nearest image, the others from there. Of a pore in conflict or in a tie with
    /// the query that is the image meant (all four lie within two radii, see [`FIT`](super::periodic::FIT)); any other pore is in conflict
    /// in no image.
    pub fn rows(&self, vertex: [u32; 4], query: [f64; 4]) -> [Row; 4] {
        let [a, b, c, d] = vertex;
        if !self.torus {
            return [self.row(a, query), self.row(b, query), self.row(c, query), self.row(d, query)];
        }
        let close = |v: u32| self.points.get(v as usize).is_none_or(|p| self.is_close(p, &query));
        if close(a) && close(b) && close(c) && close(d) {
            return [self.row(a, query), self.row(b, query), self.row(c, query), self.row(d, query)];
        }
        let mut rows = [Row::default(); 4];
        for k in 0..4 {
            rows[k] = self.row(vertex[k], query);
        }
        let square = |r: &Row| r.x * r.x + r.y * r.y + r.z * r.z;
        let grains = (0..4).filter(|&k| self.is_grain(vertex[k]));
        let base = grains.min_by(|&i, &j| square(&rows[i]).total_cmp(&square(&rows[j]))).unwrap_or(0);
        for k in (0..4).filter(|&k| k != base) {
            rows[k] = self.row_beside(vertex[k], vertex[base], &rows[base], query);
        }
        rows
    }

    /// Whether two points are so close that others as close are in the same image.
    #[inline(always)]
    fn is_close(&self, p: &[f64; 4], q: &[f64; 4]) -> bool {
        self.lattice.is_close([p[0] - q[0], p[1] - q[1], p[2] - q[2]])
    }

    /// Whether the nearest images of two grains are so close that others as close to the first are in the same image.
    pub fn are_close(&self, a: u32, b: u32) -> bool {
        let (p, q) = (self.points[a as usize], self.points[b as usize]);
        self.lattice.is_close(self.lattice.nearest([p[0] - q[0], p[1] - q[1], p[2] - q[2]]))
    }

    /// The row of a vertex in the image nearest to another grain of the same pore.
    #[inline]
    pub fn row_beside(&self, vertex: u32, beside: u32, row: &Row, query: [f64; 4]) -> Row {
        match self.points.get(vertex as usize) {
            Some(p) => {
                let d = [p[0] - query[0], p[1] - query[1], p[2] - query[2]];
                if self.lattice.is_close(d) && self.lattice.is_close([row.x, row.y, row.z]) {
                    return predicates::grain_row(d, p[3] - query[3]);
                }
                let b = self.points[beside as usize];
                let d = self.lattice.nearest([p[0] - b[0], p[1] - b[1], p[2] - b[2]]);
                predicates::grain_row([d[0] + row.x, d[1] + row.y, d[2] + row.z], p[3] - query[3])
            }
            None => self.row(vertex, query),
        }
    }

    /// The exact direction of a row: whole numbers.
    pub fn exact_direction(&self, vertex: u32, row: &Row) -> [i64; 3] {
        if self.is_grain(vertex) {
            return [row.x as i64, row.y as i64, row.z as i64];
        }
        [(row.x / self.reach) as i64, (row.y / self.reach) as i64, (row.z / self.reach) as i64]
    }

    pub fn exact_row(&self, vertex: u32, row: &Row, grain: u32) -> ExactRow {
        let query = self.points[grain as usize];
        let d = self.exact_direction(vertex, row);
        match self.points.get(vertex as usize) {
            Some(p) => {
                let squared = |c: i64| i128::from(c) * i128::from(c);
                let square = squared(d[0]) + squared(d[1]) + squared(d[2]);
                // The conversion is slow.
                let l = if p[3] == query[3] { square } else { square - (p[3] as i128 - query[3] as i128) };
                ExactRow { d, l, grain: Some(self.label[vertex as usize]) }
            }
            None => {
                let distance = self.distance(self.face(vertex), query);
                ExactRow { d, l: 2 * distance as i128, grain: None }
            }
        }
    }

    #[cold]
    pub fn outside_exact(&self, vertex: [u32; 4], rows: &[Row; 4], k: usize) -> bool {
        let [a, b, c] = match k {
            0 => [1, 2, 3],
            1 => [0, 2, 3],
            2 => [0, 1, 3],
            _ => [0, 1, 2],
        };
        let d = |j: usize| self.exact_direction(vertex[j], &rows[j]);
        predicates::side_exact(k, [&d(a), &d(b), &d(c)]) < 0
    }

    #[cold]
    pub fn conflict_exact(&self, vertex: [u32; 4], grain: u32, query: [f64; 4]) -> bool {
        let rows = self.rows(vertex, query);
        let (value, bound) = predicates::power([&rows[0], &rows[1], &rows[2], &rows[3]]);
        if value.abs() > bound {
            return value > 0.0;
        }
        self.conflict_exactly(vertex, &rows, grain)
    }

    /// The test in whole numbers, ties broken.
    #[cold]
    pub fn conflict_exactly(&self, vertex: [u32; 4], rows: &[Row; 4], grain: u32) -> bool {
        // Spelled out: the compiler does not inline a closure over the array.
        let exact = |k: usize| self.exact_row(vertex[k], &rows[k], grain);
        let exact = [exact(0), exact(1), exact(2), exact(3)];
        // Relative to the lower walls: not negative.
        let query = self.points[grain as usize];
        let place = [0, 1, 2].map(|k| (query[k] - self.lower[k]) as i64);
        let query = ExactQuery { place, grain: self.label[grain as usize] };
        predicates::conflict_exact(&exact, rows, &query, &self.forms)
    }

    /// A vertex in the user's numbering.
    pub fn label(&self, vertex: u32) -> u32 {
        match self.label.get(vertex as usize) {
            Some(&label) => label,
            None => super::FIRST_WALL + self.face(vertex) as u32,
        }
    }

    /// Centre and power of the sphere of a pore, accurate even if the pore is nearly flat.
    pub fn sphere(&self, vertex: [u32; 4], sphere: &Sphere) -> ([f64; 3], f64) {
        if !sphere.power.is_nan() {
            return (sphere.centre, sphere.power);
        }
        // From one of its grains: the first in the order of the facets.
        let base = (0..4).find(|&k| self.is_grain(vertex[k])).unwrap_or(0);
        let query = self.points[vertex[base] as usize];
        let row = |k: usize| self.exact_row(vertex[k], &self.row(vertex[k], query), vertex[base]);
        let [a, b, c] = FACET[base];
        let c = predicates::centre_exact([&row(a), &row(b), &row(c)]);
        let power = c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - query[3];
        ([query[0] + c[0], query[1] + c[1], query[2] + c[2]], power)
    }
}
