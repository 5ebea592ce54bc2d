//! Following the grains: after small motions only the pores that stopped being right are replaced.
//!
//! A triangulation is regular if every pore is positively oriented and no vertex across a facet conflicts with the pore on this
//! side. All pores and facets are checked; around each failure a hole is opened and grown until the pores around it
//! conflict with none of its vertices. Their facets then belong to the regular triangulation of the vertices of the hole,
//! so that it can be filled by gift wrapping from its facets inwards, and fits. Unlike flips this does
//! not get stuck, and nearly flat pores may turn inside out.

use super::mesh::{FREE, Mesh, Pore};
use super::{FACET, NONE};
use crate::predicates::{self, ExactQuery, Row, Sphere};

/// Holes with more vertices are left to a rebuild.
const LARGEST_HOLE: usize = 200;
/// In a torus all vertices of a hole must be seen at their nearest images.
const LARGEST_TORUS_HOLE: usize = 40;

/// The repair gave up; the mesh must be rebuilt.
pub(super) struct GaveUp;

/// How much a repair replaced.
#[derive(Default)]
pub(super) struct Replaced {
    pub holes: usize,
    pub pores: usize,
    pub reinserted: usize,
}

/// A facet of a hole: the pore to come has these vertices but for place `apex`.
#[derive(Clone, Copy)]
struct Front {
    vertex: [u32; 4],
    apex: usize,
    outside: u32,
    back: usize,
}

impl Mesh {
    /// Fills in the power spheres and returns the pores that are not positively oriented or have a facet that is not
    /// locally regular, and the largest power.
    pub fn survey(&mut self) -> (Vec<u32>, f64) {
        let mut largest = f64::NEG_INFINITY;
        let mut bad = Vec::new();
        for p in 0..self.pores.len() {
            let vertex = self.pores[p].vertex;
            let (sphere, positive) = self.shape(vertex);
            self.pores[p].sphere = sphere;
            if !positive {
                bad.push(p as u32);
            } else if self.torus {
                largest = largest.max(self.sphere(p as u32).1);
            }
        }
        for p in 0..self.pores.len() as u32 {
            if (0..4).any(|k| p < self.pores[p as usize].neighbour[k] && !self.regular(p, k)) {
                bad.push(p);
            }
        }
        (bad, largest)
    }

    /// The largest power of all pores.
    pub fn largest_power(&self) -> f64 {
        let live = (0..self.pores.len()).filter(|&p| self.pores[p].vertex[0] != FREE);
        live.map(|p| self.sphere(p as u32).1).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The power sphere of four vertices, and whether they are positively oriented.
    #[inline(always)]
    fn shape(&self, vertex: [u32; 4]) -> (Sphere, bool) {
        let mut base = 0;
        while vertex[base] as usize >= self.points.len() {
            base += 1;
        }
        let query = self.points[vertex[base] as usize];
        let [a, b, c] = FACET[base];
        let rows = [self.row(vertex[a], query), self.row(vertex[b], query), self.row(vertex[c], query)];
        let (value, bound) = predicates::determinant(&rows[0], &rows[1], &rows[2]);
        let positive = if value.abs() > bound {
            value > 0.0
        } else {
            let d = |k: usize| self.exact_direction(vertex[FACET[base][k]], &rows[k]);
            predicates::side_exact(0, [&d(0), &d(1), &d(2)]) > 0
        };
        (self.filter.sphere(&rows[0], &rows[1], &rows[2], query), positive)
    }

    /// Whether the vertex across facet `k` does not conflict with a pore.
    #[inline(always)]
    fn regular(&self, pore: u32, k: usize) -> bool {
        let Pore { vertex, neighbour, sphere } = &self.pores[pore as usize];
        if neighbour[k] == NONE {
            return true;
        }
        let across = &self.pores[neighbour[k] as usize];
        let back = across.neighbour.iter().position(|&p| p == pore).unwrap_or(0);
        !self.conflicts(*vertex, sphere, across.vertex[back])
    }

    /// Whether a vertex, grain or wall, conflicts with a positively oriented pore.
    #[inline(always)]
    fn conflicts(&self, vertex: [u32; 4], sphere: &Sphere, with: u32) -> bool {
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
        let exact = [0, 1, 2, 3].map(|k| self.exact_row(vertex[k], &rows[k], grain));
        let place = [0, 1, 2].map(|k| (query[k] - self.lower[k]) as i64);
        !predicates::conflict_exact(
            &exact,
            &ExactQuery { place, grain: self.label[grain as usize] },
            &self.forms,
        )
    }

    /// Replaces what is not regular.
    pub fn mend(&mut self, bad: Vec<u32>) -> Result<Replaced, GaveUp> {
        let mut replaced = Replaced::default();
        let mut lost = std::mem::take(&mut self.hidden);
        let most = self.pores.len() / 3 + 100;
        for pore in bad {
            let Pore { vertex, neighbour, .. } = self.pores[pore as usize];
            if vertex[0] == FREE {
                continue;
            }
            let mut hole = vec![pore];
            if self.shape(vertex).1 {
                match (0..4).find(|&k| !self.regular(pore, k)) {
                    Some(k) => hole.push(neighbour[k]),
                    None => continue, // mended with another
                }
            }
            let front = self.grow(&mut hole)?;
            replaced.holes += 1;
            replaced.pores += hole.len();
            if replaced.pores > most {
                return Err(GaveUp);
            }
            self.wrap(&hole, front, &mut lost)?;
        }
        replaced.reinserted = lost.len();
        if let Some(start) = self.pores.iter().position(|p| p.vertex[0] != FREE) {
            self.last = start as u32;
            lost.iter().for_each(|&grain| self.insert(grain));
        }
        Ok(replaced)
    }

    /// Grows a hole until the pores around it conflict with none of its vertices; returns its facets.
    fn grow(&mut self, hole: &mut Vec<u32>) -> Result<Vec<Front>, GaveUp> {
        let limit = if self.torus { LARGEST_TORUS_HOLE } else { LARGEST_HOLE };
        self.round += 2;
        let mut vertices: Vec<u32> = Vec::new();
        let (mut added, mut front) = (0, Vec::new());
        loop {
            for &pore in &hole[added..] {
                self.stamp[pore as usize] = self.round;
                for v in self.pores[pore as usize].vertex {
                    if !vertices.contains(&v) {
                        vertices.push(v);
                    }
                }
            }
            if vertices.len() > limit {
                return Err(GaveUp);
            }
            added = hole.len();
            front.clear();
            for h in 0..added {
                let Pore { vertex, neighbour, .. } = self.pores[hole[h] as usize];
                for k in 0..4 {
                    let outside = neighbour[k];
                    if outside == NONE {
                        front.push(Front { vertex, apex: k, outside, back: 0 });
                        continue;
                    }
                    if self.stamp[outside as usize] == self.round {
                        continue;
                    }
                    let around = &self.pores[outside as usize];
                    let conflicts = |&v: &u32| {
                        !around.vertex.contains(&v) && self.conflicts(around.vertex, &around.sphere, v)
                    };
                    if !self.shape(around.vertex).1 || vertices.iter().any(conflicts) {
                        self.stamp[outside as usize] = self.round;
                        hole.push(outside);
                    } else {
                        let back = around.neighbour.iter().position(|&p| p == hole[h]).unwrap_or(0);
                        front.push(Front { vertex, apex: k, outside, back });
                    }
                }
            }
            if hole.len() == added {
                // Keep the vertices for the wrapping.
                self.candidates = vertices;
                return Ok(front);
            }
        }
    }

    /// Fills a hole by gift wrapping; grains left without a pore go to `lost`.
    fn wrap(&mut self, hole: &[u32], mut front: Vec<Front>, lost: &mut Vec<u32>) -> Result<(), GaveUp> {
        let candidates = std::mem::take(&mut self.candidates);
        let mut used: Vec<u32> = front.iter().flat_map(|f| FACET[f.apex].map(|j| f.vertex[j])).collect();
        for &pore in hole {
            self.pores[pore as usize].vertex[0] = FREE;
            self.free.push(pore);
        }
        let mut budget = 4 * hole.len() + 64;
        while let Some(facet) = front.pop() {
            budget = budget.checked_sub(1).ok_or(GaveUp)?;
            let (vertex, sphere) = self.gift(&facet, &candidates).ok_or(GaveUp)?;
            let pore = self.free.pop().unwrap_or_else(|| {
                self.pores.push(Pore { vertex, neighbour: [NONE; 4], sphere });
                self.stamp.push(0);
                self.pores.len() as u32 - 1
            });
            self.stamp[pore as usize] = 0;
            self.pores[pore as usize] = Pore { vertex, neighbour: [NONE; 4], sphere };
            self.join(pore, facet.apex, facet.outside, facet.back);
            used.push(vertex[facet.apex]);
            for j in FACET[facet.apex] {
                let same = |f: &Front| {
                    FACET[j].iter().all(|&i| f.vertex[f.apex] != vertex[i] && f.vertex.contains(&vertex[i]))
                };
                if let Some(at) = front.iter().position(same) {
                    let other = front.swap_remove(at);
                    self.join(pore, j, other.outside, other.back);
                } else {
                    // Seen from the other side the orientation is the opposite.
                    let mut turned = vertex;
                    turned.swap(FACET[j][0], FACET[j][1]);
                    front.push(Front { vertex: turned, apex: j, outside: pore, back: j });
                }
            }
        }
        let grains = candidates.iter().filter(|&&v| (v as usize) < self.points.len());
        lost.extend(grains.filter(|v| !used.contains(v)));
        Ok(())
    }

    fn join(&mut self, pore: u32, k: usize, outside: u32, back: usize) {
        self.pores[pore as usize].neighbour[k] = outside;
        if outside != NONE {
            self.pores[outside as usize].neighbour[back] = pore;
        }
    }

    /// The pore on a facet whose power sphere holds no candidate.
    fn gift(&self, facet: &Front, candidates: &[u32]) -> Option<([u32; 4], Sphere)> {
        let mut best: Option<([u32; 4], Sphere)> = None;
        for &v in candidates {
            let mut vertex = facet.vertex;
            vertex[facet.apex] = v;
            if FACET[facet.apex].iter().any(|&j| vertex[j] == v) {
                continue;
            }
            if best.as_ref().is_some_and(|(pore, sphere)| !self.conflicts(*pore, sphere, v)) {
                continue;
            }
            // Three walls and a grain, at least: opposite walls do not make a pore.
            if vertex.iter().all(|&v| v as usize >= self.points.len()) {
                continue;
            }
            let (sphere, positive) = self.shape(vertex);
            if positive {
                best = Some((vertex, sphere));
            }
        }
        best
    }
}
