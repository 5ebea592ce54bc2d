//! Incremental insertion (Bowyer-Watson): walk to the query, collect the pores in conflict, fill the hole with a star.
//!
//! Because walls are vertices at infinity along the axes, the pores cover the whole space from the first grain on:
//! there is no outside to treat apart.

use super::lattice::Lattice;
use super::{FACET, NONE};
use crate::predicates::{self, ExactQuery, ExactRow, Filter, Forms, Row, Sphere};
use std::collections::HashMap;

/// A pore under construction. Vertices are grains `0..n` in insertion numbering or walls `n + face`.
///
/// One cache line: most tests read nothing else.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Pore {
    pub vertex: [u32; 4],
    pub neighbour: [u32; 4],
    pub sphere: Sphere,
}

/// Marks a free slot in [`Mesh::pores`] (as first vertex).
pub(super) const FREE: u32 = u32::MAX;

/// Up to this many vertices around a hole, its edges are matched in a square table, beyond in a hash map.
const TABLE: usize = 512;

/// A facet of the hole with the new pore on it.
#[derive(Clone, Copy)]
struct Facet {
    vertex: [u32; 4],
    near: [u32; 4],
    /// Place of the query in `vertex`.
    apex: usize,
    outside: u32,
    /// Facet of `outside` that looks here.
    back: usize,
}

/// A vertex met during one insertion, seen from its query.
#[derive(Clone, Copy)]
struct Near {
    row: Row,
    vertex: u32,
    /// Still a vertex after the insertion.
    kept: bool,
}

pub(super) struct Mesh {
    /// `[x, y, z, w]` of every grain, whole numbers.
    pub(super) points: Vec<[f64; 4]>,
    /// Index of every grain in the user's numbering, for ties.
    pub(super) label: Vec<u32>,
    pub(super) lower: [f64; 3],
    pub(super) upper: [f64; 3],
    /// Differences are taken to the nearest image; without periods that changes nothing.
    pub(super) lattice: Lattice,
    pub(super) torus: bool,
    pub(super) forms: Forms,
    /// A power of two near the distance of neighbours: wall rows are scaled by it so that the columns of the
    /// determinants hold numbers of one magnitude (the filter needs that).
    pub(super) reach: f64,
    pub(super) filter: Filter,
    pub pores: Vec<Pore>,
    /// `2 i + 1` in conflict with, `2 i` tested against the `i`-th query.
    pub(super) stamp: Vec<u32>,
    pub(super) round: u32,
    pub(super) free: Vec<u32>,
    pub(super) last: u32,
    /// Grains without a pore, insertion numbering.
    pub hidden: Vec<u32>,
    /// Place of each vertex in `near`, valid if that entry names the vertex.
    place: Vec<u32>,
    near: Vec<Near>,
    hole: Vec<(u32, [u32; 4])>,
    facets: Vec<Facet>,
    /// Vertices of the hole under repair.
    pub(super) candidates: Vec<u32>,
    table: Vec<u32>,
    map: HashMap<(u32, u32), u32>,
}

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

impl Mesh {
    pub fn new(points: Vec<[f64; 4]>, label: Vec<u32>, space: &Space) -> Self {
        let n = points.len();
        Mesh {
            label,
            lower: space.lower,
            upper: space.upper,
            lattice: space.lattice,
            torus: space.lattice.periodic != [false; 3],
            forms: space.forms,
            reach: space.reach,
            filter: Filter::new(space.reach, space.largest),
            pores: Vec::with_capacity(7 * n + 8),
            stamp: Vec::with_capacity(7 * n + 8),
            round: 0,
            free: Vec::new(),
            last: 0,
            hidden: Vec::new(),
            place: vec![0; n + 6],
            near: Vec::new(),
            hole: Vec::new(),
            facets: Vec::new(),
            candidates: Vec::new(),
            table: Vec::new(),
            map: HashMap::new(),
            points,
        }
    }

    /// Eight octants around the first grain.
    pub fn start(&mut self, grain: u32) {
        let query = self.points[grain as usize];
        let wall = self.points.len() as u32;
        for octant in 0..8u32 {
            let face = |axis: u32, high: u32| wall + 2 * axis + high;
            let [x, y, z] = [octant & 1, octant >> 1 & 1, octant >> 2 & 1];
            let mut vertex = [grain, face(0, x), face(1, y), face(2, z)];
            let mut neighbour = [NONE, octant ^ 1, octant ^ 2, octant ^ 4];
            if (x + y + z) % 2 == 0 {
                // An odd number of normals points backwards.
                vertex.swap(1, 2);
                neighbour.swap(1, 2);
            }
            let [a, b, c] = [1, 2, 3].map(|k| self.row(vertex[k], query));
            let sphere = self.filter.sphere(&a, &b, &c, query);
            self.pores.push(Pore { vertex, neighbour, sphere });
            self.stamp.push(0);
        }
    }

    /// Takes over the pores of a coarser triangulation of some of the grains of a torus.
    pub fn resume(&mut self, pores: Vec<Pore>, hidden: Vec<u32>) {
        self.stamp = vec![0; pores.len()];
        (self.pores, self.hidden) = (pores, hidden);
    }

    /// Inserts a grain; grains it hides, or itself if it is hidden, go to [`hidden`](Self::hidden).
    pub fn insert(&mut self, grain: u32) {
        let query = self.points[grain as usize];
        let first = self.locate(query, self.last);
        self.round += 2;
        self.near.clear();
        self.hole.clear();
        self.facets.clear();
        if !self.conflict(first, grain, query) {
            self.hidden.push(grain);
            return;
        }
        self.stamp[first as usize] = self.round + 1;
        let near = self.look(first, query);
        self.hole.push((first, near));
        self.dig(grain, query);
        self.hide();
        self.fill(query);
    }

    /// The row of a vertex seen from a query.
    #[inline(always)]
    pub(super) fn row(&self, vertex: u32, query: [f64; 4]) -> Row {
        match self.points.get(vertex as usize) {
            Some(&p) => {
                let d = self.lattice.nearest([p[0] - query[0], p[1] - query[1], p[2] - query[2]]);
                predicates::grain_row(d, p[3] - query[3])
            }
            None => self.wall_row(vertex as usize - self.points.len(), query),
        }
    }

    fn wall_row(&self, face: usize, query: [f64; 4]) -> Row {
        let axis = face / 2;
        let normal = if face % 2 == 0 { -1.0 } else { 1.0 };
        let distance = self.distance(face, query);
        let l = 2.0 * distance * self.reach;
        let mut d = [0.0; 3];
        d[axis] = normal * self.reach;
        Row { x: d[0], y: d[1], z: d[2], l, t: l }
    }

    /// Distance of a query from a wall.
    fn distance(&self, face: usize, query: [f64; 4]) -> f64 {
        let axis = face / 2;
        if face % 2 == 0 { query[axis] - self.lower[axis] } else { self.upper[axis] - query[axis] }
    }

    /// The rows of a pore, all seen in the same image.
    ///
    /// In a torus the nearest of the four is met at its nearest image (it lies within two radii of the largest power
    /// sphere, of which six fit into a period), the others from there.
    fn rows(&self, vertex: [u32; 4], query: [f64; 4]) -> [Row; 4] {
        let mut rows = [Row::default(); 4];
        for k in 0..4 {
            rows[k] = self.row(vertex[k], query);
        }
        if self.torus {
            let square = |r: &Row| r.x * r.x + r.y * r.y + r.z * r.z;
            let grains = (0..4).filter(|&k| (vertex[k] as usize) < self.points.len());
            let base = grains.min_by(|&i, &j| square(&rows[i]).total_cmp(&square(&rows[j]))).unwrap_or(0);
            for k in (0..4).filter(|&k| k != base) {
                rows[k] = self.row_beside(vertex[k], vertex[base], &rows[base], query);
            }
        }
        rows
    }

    /// The row of a vertex in the image nearest to another grain of the same pore.
    fn row_beside(&self, vertex: u32, beside: u32, row: &Row, query: [f64; 4]) -> Row {
        match self.points.get(vertex as usize) {
            Some(p) => {
                let b = self.points[beside as usize];
                let d = self.lattice.nearest([p[0] - b[0], p[1] - b[1], p[2] - b[2]]);
                predicates::grain_row([d[0] + row.x, d[1] + row.y, d[2] + row.z], p[3] - query[3])
            }
            None => self.row(vertex, query),
        }
    }

    /// The exact direction of a row: whole numbers.
    pub(super) fn exact_direction(&self, vertex: u32, row: &Row) -> [i64; 3] {
        let scale = if (vertex as usize) < self.points.len() { 1.0 } else { self.reach };
        [row.x, row.y, row.z].map(|c| (c / scale) as i64)
    }

    pub(super) fn exact_row(&self, vertex: u32, row: &Row, grain: u32) -> ExactRow {
        let query = self.points[grain as usize];
        let d = self.exact_direction(vertex, row);
        match self.points.get(vertex as usize) {
            Some(p) => {
                let square: i128 = d.iter().map(|&c| i128::from(c) * i128::from(c)).sum();
                let l = square - (p[3] as i128 - query[3] as i128);
                ExactRow { d, l, grain: Some(self.label[vertex as usize]) }
            }
            None => {
                let distance = self.distance(vertex as usize - self.points.len(), query);
                ExactRow { d, l: 2 * distance as i128, grain: None }
            }
        }
    }

    /// A pore that contains the query (on its boundary at worst), by the remembering visibility walk from a hint.
    ///
    /// The walk ends for any regular triangulation (H. Edelsbrunner, "An acyclicity theorem for cell complexes in
    /// d dimensions", 1990), because the side tests are exact.
    fn locate(&self, query: [f64; 4], hint: u32) -> u32 {
        let (mut pore, mut from) = (hint, NONE);
        let mut vertex = self.pores[pore as usize].vertex;
        let mut rows = self.rows(vertex, query);
        'walk: loop {
            let Pore { neighbour, .. } = self.pores[pore as usize];
            for k in 0..4 {
                let next = neighbour[k];
                if next == from || next == NONE {
                    continue;
                }
                let [a, b, c] = FACET[k];
                let (value, bound) = predicates::determinant(&rows[a], &rows[b], &rows[c]);
                // In the order of FACET the determinant is the barycentric coordinate itself.
                let outside =
                    if value.abs() > bound { value < 0.0 } else { self.outside_exact(vertex, &rows, k) };
                if outside {
                    // Keep the three rows that the two pores share.
                    let (old, old_rows) = (vertex, rows);
                    vertex = self.pores[next as usize].vertex;
                    let beside =
                        FACET[k].into_iter().find(|&j| (old[j] as usize) < self.points.len()).unwrap_or(0);
                    for i in 0..4 {
                        rows[i] = match old.iter().position(|&v| v == vertex[i]) {
                            Some(j) => old_rows[j],
                            None if self.torus => {
                                self.row_beside(vertex[i], old[beside], &old_rows[beside], query)
                            }
                            None => self.row(vertex[i], query),
                        };
                    }
                    (from, pore) = (pore, next);
                    continue 'walk;
                }
            }
            return pore;
        }
    }

    #[cold]
    fn outside_exact(&self, vertex: [u32; 4], rows: &[Row; 4], k: usize) -> bool {
        let [a, b, c] = match k {
            0 => [1, 2, 3],
            1 => [0, 2, 3],
            2 => [0, 1, 3],
            _ => [0, 1, 2],
        };
        let d = |j: usize| self.exact_direction(vertex[j], &rows[j]);
        predicates::side_exact(k, [&d(a), &d(b), &d(c)]) < 0
    }

    /// Centre and power of the sphere of a pore, accurate even if the pore is nearly flat.
    pub fn sphere(&self, pore: u32) -> ([f64; 3], f64) {
        let Pore { vertex, sphere, .. } = self.pores[pore as usize];
        if !sphere.power.is_nan() {
            return (sphere.centre, sphere.power);
        }
        // From one of its grains: the first in the order of the facets.
        let base = (0..4).find(|&k| (vertex[k] as usize) < self.points.len()).unwrap_or(0);
        let query = self.points[vertex[base] as usize];
        let row = |k: usize| self.exact_row(vertex[k], &self.row(vertex[k], query), vertex[base]);
        let [a, b, c] = FACET[base];
        let c = predicates::centre_exact([&row(a), &row(b), &row(c)]);
        let power = c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - query[3];
        ([query[0] + c[0], query[1] + c[1], query[2] + c[2]], power)
    }

    /// Places of the vertices of a pore in `near`.
    #[inline(always)]
    fn look(&mut self, pore: u32, query: [f64; 4]) -> [u32; 4] {
        let [a, b, c, d] = self.pores[pore as usize].vertex;
        // Spelled out: the compiler does not inline a closure over the array.
        [self.meet(a, query), self.meet(b, query), self.meet(c, query), self.meet(d, query)]
    }

    /// Place of a vertex in `near`.
    #[inline(always)]
    fn meet(&mut self, vertex: u32, query: [f64; 4]) -> u32 {
        let place = self.place[vertex as usize];
        if self.near.get(place as usize).is_some_and(|n| n.vertex == vertex) {
            return place;
        }
        let place = self.near.len() as u32;
        self.place[vertex as usize] = place;
        self.near.push(Near { row: self.row(vertex, query), vertex, kept: false });
        place
    }

    #[inline(always)]
    fn conflict(&self, pore: u32, grain: u32, query: [f64; 4]) -> bool {
        let Pore { vertex, sphere, .. } = &self.pores[pore as usize];
        let (value, bound) = self.filter.power(sphere, query, &self.lattice);
        // The bound of an inaccurate sphere is not a number.
        if value.abs() > bound { value < 0.0 } else { self.conflict_exact(*vertex, grain, query) }
    }

    #[cold]
    pub(super) fn conflict_exact(&self, vertex: [u32; 4], grain: u32, query: [f64; 4]) -> bool {
        let rows = self.rows(vertex, query);
        let (value, bound) = predicates::power([&rows[0], &rows[1], &rows[2], &rows[3]]);
        if value.abs() > bound {
            return value > 0.0;
        }
        let rows = [0, 1, 2, 3].map(|k| self.exact_row(vertex[k], &rows[k], grain));
        // Relative to the lower walls: not negative.
        let place = [0, 1, 2].map(|k| (query[k] - self.lower[k]) as i64);
        let query = ExactQuery { place, grain: self.label[grain as usize] };
        predicates::conflict_exact(&rows, &query, &self.forms)
    }

    /// Collects all pores in conflict with the grain and the facets of the hole they leave.
    fn dig(&mut self, grain: u32, query: [f64; 4]) {
        let mut done = 0;
        while done < self.hole.len() {
            let (pore, near) = self.hole[done];
            done += 1;
            let Pore { vertex, neighbour, .. } = self.pores[pore as usize];
            for k in 0..4 {
                let outside = neighbour[k];
                let mut back = 0;
                if outside != NONE {
                    let stamp = self.stamp[outside as usize];
                    if stamp == self.round + 1 {
                        continue;
                    }
                    if stamp != self.round {
                        if self.conflict(outside, grain, query) {
                            self.stamp[outside as usize] = self.round + 1;
                            let near = self.look(outside, query);
                            self.hole.push((outside, near));
                            continue;
                        }
                        self.stamp[outside as usize] = self.round;
                    }
                    let sides = self.pores[outside as usize].neighbour;
                    back = sides.iter().position(|&p| p == pore).unwrap_or(0);
                }
                let mut facet = Facet { vertex, near, apex: k, outside, back };
                facet.vertex[k] = grain;
                for j in FACET[k] {
                    self.near[near[j] as usize].kept = true;
                }
                self.facets.push(facet);
            }
        }
    }

    /// Grains all of whose pores are in conflict get hidden.
    fn hide(&mut self) {
        for (_, near) in &self.hole {
            for &k in near {
                let near = &mut self.near[k as usize];
                if !near.kept {
                    near.kept = true; // report it once
                    self.hidden.push(near.vertex);
                }
            }
        }
    }

    /// Replaces the pores of the hole by one pore from each of its facets to the grain.
    fn fill(&mut self, query: [f64; 4]) {
        let side = self.near.len().next_power_of_two();
        let table = side <= TABLE;
        if table && self.table.len() < side * side {
            self.table.resize(side * side, 0);
        }
        self.map.clear();
        let mut reused = 0;
        for f in 0..self.facets.len() {
            let facet = self.facets[f];
            let pore = if reused < self.hole.len() {
                reused += 1;
                self.hole[reused - 1].0
            } else if let Some(free) = self.free.pop() {
                free
            } else {
                self.pores.push(Pore { vertex: [FREE; 4], neighbour: [NONE; 4], sphere: Sphere::default() });
                self.stamp.push(0);
                self.pores.len() as u32 - 1
            };
            let mut neighbour = [NONE; 4];
            neighbour[facet.apex] = facet.outside;
            let row = |k: usize| &self.near[facet.near[FACET[facet.apex][k]] as usize].row;
            let sphere = self.filter.sphere(row(0), row(1), row(2), query);
            self.pores[pore as usize] = Pore { vertex: facet.vertex, neighbour, sphere };
            self.stamp[pore as usize] = 0;
            if facet.outside != NONE {
                self.pores[facet.outside as usize].neighbour[facet.back] = pore;
            }
            for (a, b, _) in edges(&facet) {
                if table {
                    self.table[a as usize * side + b as usize] = pore;
                } else {
                    self.map.insert((a, b), pore);
                }
            }
            self.facets[f].outside = pore; // from here on: the pore on this facet
        }
        // The neighbour across an edge of the hole runs along it the other way.
        for f in 0..self.facets.len() {
            let facet = self.facets[f];
            for (a, b, opposite) in edges(&facet) {
                let other =
                    if table { self.table[b as usize * side + a as usize] } else { self.map[&(b, a)] };
                self.pores[facet.outside as usize].neighbour[opposite] = other;
            }
            self.last = facet.outside;
        }
        for &(pore, _) in &self.hole[reused..] {
            self.pores[pore as usize].vertex[0] = FREE;
            self.free.push(pore);
        }
    }

    pub fn label(&self, vertex: u32) -> u32 {
        let n = self.points.len() as u32;
        if vertex < n { self.label[vertex as usize] } else { super::FIRST_WALL + (vertex - n) }
    }
}

/// Directed edges of a facet of the hole, each with the place of the facet's third vertex.
#[inline(always)]
fn edges(facet: &Facet) -> [(u32, u32, usize); 3] {
    let [a, b, c] = FACET[facet.apex];
    let n = &facet.near;
    [(n[a], n[b], c), (n[b], n[c], a), (n[c], n[a], b)]
}
