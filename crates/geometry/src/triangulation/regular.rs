//! Whether a triangulation is regular: every pore is positively oriented, and no vertex across a facet conflicts with the pore
//! on this side.

use super::view::View;
use super::{FACET, NONE, Vertex};
use crate::predicates::{self, Row, Sphere};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Pores checked in one go.
const BLOCK: usize = 4096;

/// Of so many pores this many in a row are looked at first.
const SAMPLE: (usize, usize) = (2048, 64);

/// What a survey found.
pub(super) struct Survey {
    /// Pores with a facet that is not locally regular; of the two pores of a facet, the first.
    pub bad: Vec<u32>,
    /// Pores that are not positively oriented.
    pub inverted: Vec<u32>,
    /// The largest power of the others; only looked for in a torus.
    pub largest: f64,
}

impl Survey {
    /// Number of pores that are not right.
    fn count(&self) -> usize {
        self.bad.len() + self.inverted.len()
    }
}

impl View<'_> {
    /// Checks all pores and facets, or stops when more than `most` pores are bad, or as soon as a sample makes that likely; the
    /// first vertex of each must be a grain.
    pub fn survey(&self, pores: &[[Vertex; 4]], neighbours: &[[u32; 4]], most: usize) -> Option<Survey> {
        let survey = |range: Range<usize>| match self.torus {
            true => self.survey_block(pores, neighbours, range, |d| self.lattice.nearest(d)),
            false => self.survey_block(pores, neighbours, range, |d| d),
        };
        let mut sampled = (0, 0);
        for start in (0..pores.len()).step_by(SAMPLE.0) {
            let range = start..pores.len().min(start + SAMPLE.1);
            sampled.0 += range.len();
            sampled.1 += survey(range).count();
        }
        // Bad pores come in groups: none of a small sample is taken as proof.
        if sampled.1.saturating_sub(SAMPLE.1) * pores.len() > most * sampled.0 {
            return None;
        }
        let count = AtomicUsize::new(0);
        let block = |b: usize| {
            if count.load(Relaxed) > most {
                return None;
            }
            let found = survey(b * BLOCK..pores.len().min((b + 1) * BLOCK));
            count.fetch_add(found.count(), Relaxed);
            Some(found)
        };
        let blocks = (0..pores.len().div_ceil(BLOCK)).into_par_iter().map(block);
        let blocks: Vec<Survey> = blocks.while_some().collect();
        if count.load(Relaxed) > most {
            return None;
        }
        let largest = blocks.iter().map(|b| b.largest).fold(f64::NEG_INFINITY, f64::max);
        let all =
            |list: fn(&Survey) -> &Vec<u32>| blocks.iter().flat_map(|b| list(b).iter().copied()).collect();
        Some(Survey { bad: all(|b| &b.bad), inverted: all(|b| &b.inverted), largest })
    }

    #[inline(always)]
    fn survey_block(
        &self,
        pores: &[[Vertex; 4]],
        neighbours: &[[u32; 4]],
        range: Range<usize>,
        nearest: impl Fn([f64; 3]) -> [f64; 3],
    ) -> Survey {
        let mut found = Survey { bad: Vec::new(), inverted: Vec::new(), largest: f64::NEG_INFINITY };
        let difference = |a: &[f64], b: &[f64]| nearest([a[0] - b[0], a[1] - b[1], a[2] - b[2]]);
        for p in range {
            let vertex = pores[p];
            let query = self.points[vertex[0] as usize];
            let row = |v: Vertex| match self.points.get(v as usize) {
                Some(x) => predicates::grain_row(difference(x, &query), x[3] - query[3]),
                None => self.row(v, query),
            };
            let [a, b, c] = [row(vertex[1]), row(vertex[2]), row(vertex[3])];
            let (sphere, positive) = self.filter.shape(&a, &b, &c, query);
            let mut unclear = 0;
            let all = |v: [u32; 4]| v[0] ^ v[1] ^ v[2] ^ v[3];
            for k in 0..4 {
                let Some(&across) = pores.get(neighbours[p][k] as usize) else { continue };
                // Three of the four cancel. All four facets, though each is seen twice: cheaper than branches nobody
                // can foresee.
                let opposite = all(across) ^ all(vertex) ^ vertex[k];
                let clear = match self.points.get(opposite as usize) {
                    Some(x) => {
                        let (value, bound) = self.filter.power_at(&sphere, difference(x, &sphere.centre), *x);
                        value > bound
                    }
                    None => false, // a wall: leave it to the full test
                };
                unclear |= u32::from(!clear) << k;
            }
            if !positive && !self.shape(vertex).1 {
                found.inverted.push(p as u32);
            } else if unclear != 0 && !self.regular(pores, neighbours, p, &sphere, unclear) {
                found.bad.push(p as u32);
            } else if self.torus {
                found.largest = found.largest.max(self.sphere(vertex, &sphere).1);
            }
        }
        found
    }

    /// Whether no vertex across the unclear facets of a pore to later pores conflicts with it.
    #[cold]
    fn regular(
        &self,
        pores: &[[Vertex; 4]],
        neighbours: &[[u32; 4]],
        p: usize,
        sphere: &Sphere,
        unclear: u32,
    ) -> bool {
        let facet = |k: usize| {
            unclear & 1 << k == 0
                || p as u32 >= neighbours[p][k]
                || self.locally_regular(pores, neighbours, p, k, sphere)
        };
        (0..4).all(facet)
    }

    /// Whether the vertex across facet `k` of a pore does not conflict with it.
    pub fn locally_regular(
        &self,
        pores: &[[Vertex; 4]],
        neighbours: &[[u32; 4]],
        p: usize,
        k: usize,
        sphere: &Sphere,
    ) -> bool {
        let across = neighbours[p][k];
        if across == NONE {
            return true;
        }
        let back = neighbours[across as usize].iter().position(|&q| q == p as u32).unwrap_or(0);
        !self.conflicts(pores[p], sphere, pores[across as usize][back])
    }

    /// The power sphere of four vertices, and whether they are positively oriented.
    #[inline(always)]
    pub fn shape(&self, vertex: [u32; 4]) -> (Sphere, bool) {
        let (sphere, sign) = self.oriented(vertex);
        (sphere, sign > 0)
    }

    /// The power sphere of four vertices, one of which is a grain, and the sign of their orientation.
    #[inline(always)]
    pub fn oriented(&self, vertex: [u32; 4]) -> (Sphere, i32) {
        let mut base = 0;
        while vertex[base] as usize >= self.points.len() {
            base += 1;
        }
        let query = self.points[vertex[base] as usize];
        let [a, b, c] = FACET[base].map(|k| vertex[k]);
        let rows = [self.row(a, query), self.row(b, query), self.row(c, query)];
        self.oriented_rows(vertex[base], [a, b, c], [&rows[0], &rows[1], &rows[2]])
    }

    /// The same for a grain and three vertices, in the order of the facets, as seen from it.
    #[inline(always)]
    pub fn oriented_rows(&self, base: u32, others: [u32; 3], rows: [&Row; 3]) -> (Sphere, i32) {
        let (value, bound) = predicates::determinant(rows[0], rows[1], rows[2]);
        let sign = if value.abs() > bound {
            if value > 0.0 { 1 } else { -1 }
        } else {
            let d = |k: usize| self.exact_direction(others[k], rows[k]);
            predicates::side_exact(0, [&d(0), &d(1), &d(2)])
        };
        let mut sphere = self.filter.sphere(rows[0], rows[1], rows[2], self.points[base as usize]);
        if sphere.power > self.most_power {
            // Its centre may be nearer to the wrong image: leave it to the full test, which starts from the vertices.
            sphere.power = f64::NAN;
        }
        (sphere, sign)
    }

    /// Whether a vertex, grain or wall, conflicts with a positively oriented pore.
    #[inline(always)]
    pub fn conflicts(&self, vertex: [u32; 4], sphere: &Sphere, with: u32) -> bool {
        match self.points.get(with as usize) {
            Some(&query) => {
                let (value, bound) = self.filter.power(sphere, query, &self.lattice);
                if value.abs() > bound { value < 0.0 } else { self.conflict_exact(vertex, with, query) }
            }
            None => self.conflicts_wall(vertex, with),
        }
    }

    /// The wall trades places with a grain of the pore: the sign of the determinant changes.
    fn conflicts_wall(&self, mut vertex: [u32; 4], with: u32) -> bool {
        let base = (0..4).find(|&k| (vertex[k] as usize) < self.points.len()).unwrap_or(0);
        let grain = vertex[base];
        let query = self.points[grain as usize];
        vertex[base] = with;
        let mut rows = [Row::default(); 4];
        for k in 0..4 {
            rows[k] = self.row(vertex[k], query);
        }
        let (value, bound) = predicates::power([&rows[0], &rows[1], &rows[2], &rows[3]]);
        if value.abs() > bound {
            return value < 0.0;
        }
        !self.conflict_exactly(vertex, &rows, grain)
    }
}
