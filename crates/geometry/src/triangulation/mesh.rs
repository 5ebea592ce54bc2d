//! Incremental insertion (Bowyer-Watson): walk to the query, collect the pores in conflict, fill the hole with a star.
//!
//! Because walls are vertices at infinity along the axes, the pores cover the whole space from the first grain on:
//! there is no outside to treat apart.

use super::view::View;
use super::{FACET, NONE};
use crate::predicates::{self, Row, Sphere};
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

pub(super) struct Mesh<'a> {
    pub view: View<'a>,
    pub pores: Vec<Pore>,
    /// `2 i + 1` in conflict with, `2 i` tested against the `i`-th query.
    stamp: Vec<u32>,
    round: u32,
    free: Vec<u32>,
    last: u32,
    /// Grains without a pore, insertion numbering.
    pub hidden: Vec<u32>,
    /// Place of each vertex in `near`, valid if that entry names the vertex.
    place: Vec<u32>,
    near: Vec<Near>,
    hole: Vec<(u32, [u32; 4])>,
    facets: Vec<Facet>,
    table: Vec<u32>,
    map: HashMap<(u32, u32), u32>,
}

impl<'a> Mesh<'a> {
    pub fn new(view: View<'a>) -> Self {
        let n = view.points.len();
        Mesh {
            view,
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
            table: Vec::new(),
            map: HashMap::new(),
        }
    }

    /// Eight octants around the first grain.
    pub fn start(&mut self, grain: u32) {
        let query = self.view.points[grain as usize];
        let wall = self.view.points.len() as u32;
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
            let [a, b, c] = [1, 2, 3].map(|k| self.view.row(vertex[k], query));
            let sphere = self.view.filter.sphere(&a, &b, &c, query);
            self.pores.push(Pore { vertex, neighbour, sphere });
            self.stamp.push(0);
        }
    }

    /// Takes over the pores of a triangulation of some of the grains.
    pub fn resume(&mut self, pores: Vec<Pore>, hidden: Vec<u32>) {
        self.stamp = vec![0; pores.len()];
        self.last = pores.iter().position(|p| p.vertex[0] != FREE).unwrap_or(0) as u32;
        (self.pores, self.hidden) = (pores, hidden);
    }

    /// Inserts a grain; grains it hides, or itself if it is hidden, go to [`hidden`](Self::hidden).
    pub fn insert(&mut self, grain: u32) {
        let query = self.view.points[grain as usize];
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

    /// A pore that contains the query (on its boundary at worst), by the remembering visibility walk from a hint.
    ///
    /// The walk ends for any regular triangulation (H. Edelsbrunner, "An acyclicity theorem for cell complexes in
    /// d dimensions", 1990), because the side tests are exact.
    fn locate(&self, query: [f64; 4], hint: u32) -> u32 {
        let (mut pore, mut from) = (hint, NONE);
        let mut vertex = self.pores[pore as usize].vertex;
        let mut rows = self.view.rows(vertex, query);
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
                    if value.abs() > bound { value < 0.0 } else { self.view.outside_exact(vertex, &rows, k) };
                if outside {
                    // Keep the three rows that the two pores share.
                    let (old, old_rows) = (vertex, rows);
                    vertex = self.pores[next as usize].vertex;
                    let beside = FACET[k].into_iter().find(|&j| self.view.is_grain(old[j])).unwrap_or(0);
                    for i in 0..4 {
                        rows[i] = match old.iter().position(|&v| v == vertex[i]) {
                            Some(j) => old_rows[j],
                            None if self.view.torus => {
                                self.view.row_beside(vertex[i], old[beside], &old_rows[beside], query)
                            }
                            None => self.view.row(vertex[i], query),
                        };
                    }
                    (from, pore) = (pore, next);
                    continue 'walk;
                }
            }
            return pore;
        }
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
        self.near.push(Near { row: self.view.row(vertex, query), vertex, kept: false });
        place
    }

    #[inline(always)]
    fn conflict(&self, pore: u32, grain: u32, query: [f64; 4]) -> bool {
        let sphere = &self.pores[pore as usize].sphere;
        self.decided(self.view.filter.power(sphere, query, &self.view.lattice), pore, grain, query)
    }

    /// The outcome of a test by spheres, or of the exact one if that is not clear.
    #[inline(always)]
    fn decided(&self, (value, bound): (f64, f64), pore: u32, grain: u32, query: [f64; 4]) -> bool {
        // The bound of an inaccurate sphere is not a number.
        if value.abs() > bound {
            value < 0.0
        } else {
            self.view.conflict_exact(self.pores[pore as usize].vertex, grain, query)
        }
    }

    /// Collects all pores in conflict with the grain and the facets of the hole they leave.
    fn dig(&mut self, grain: u32, query: [f64; 4]) {
        let mut done = 0;
        while done < self.hole.len() {
            let (pore, near) = self.hole[done];
            done += 1;
            let Pore { vertex, neighbour, .. } = self.pores[pore as usize];
            // All four at once, though some are known: the loads and sums run side by side instead of behind branches.
            let test = |k: usize| match self.pores.get(neighbour[k] as usize) {
                Some(p) => self.view.filter.power(&p.sphere, query, &self.view.lattice),
                None => (1.0, 0.0),
            };
            let tests = [test(0), test(1), test(2), test(3)];
            for k in 0..4 {
                let outside = neighbour[k];
                let mut back = 0;
                if outside != NONE {
                    let stamp = self.stamp[outside as usize];
                    if stamp == self.round + 1 {
                        continue;
                    }
                    if stamp != self.round {
                        if self.decided(tests[k], outside, grain, query) {
                            self.stamp[outside as usize] = self.round + 1;
                            let near = self.look(outside, query);
                            self.hole.push((outside, near));
                            continue;
                        }
                        self.stamp[outside as usize] = self.round;
                    }
                    let [_, b, c, d] = self.pores[outside as usize].neighbour;
                    back = usize::from(b == pore) + 2 * usize::from(c == pore) + 3 * usize::from(d == pore);
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
            let sphere = self.view.filter.sphere(row(0), row(1), row(2), query);
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
}

/// Directed edges of a facet of the hole, each with the place of the facet's third vertex.
#[inline(always)]
fn edges(facet: &Facet) -> [(u32, u32, usize); 3] {
    let [a, b, c] = FACET[facet.apex];
    let n = &facet.near;
    [(n[a], n[b], c), (n[b], n[c], a), (n[c], n[a], b)]
}
