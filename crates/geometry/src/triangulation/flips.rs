//! Bistellar flips: the pores around one facet, or one edge, replaced by the other triangulation of the same vertices.
//!
//! For a facet of the pore `p` between its vertex `d` and `e` across, put `e` in the place of each vertex of the facet in turn.
//! Those of the three tetrahedra that are positively oriented are the new pores:
//!
//! - all three: two pores become three;
//! - one negative: `e` lies beyond that side of `p`, and if the pore there has the vertex `e` too, three become two;
//! - one flat: an edge of the facet is in one plane with `d` and `e`, and if four pores share it, they become four around the
//!   other diagonal of that plane.
//!
//! A flip of a facet that is not locally regular lowers the lifted surface, so flips come to an end. They may get
//! stuck; what remains is left to the holes of [`repair`](super::repair).

use super::repair::{GaveUp, Patch};
use super::view::View;
use super::{FACET, NONE, Vertex};
use crate::predicates::{Row, Sphere};

/// The exchange of two to four pores for others on the same five or six vertices.
///
/// In here vertices are known by their place in `vertices`: those of `p` in order, then `e`, then the sixth.
struct Flip<'a> {
    view: View<'a>,
    vertices: [Vertex; 6],
    count: usize,
    /// All vertices as seen from `d` or, if that is a wall, from `e`.
    rows: [Row; 6],
    base: usize,
    old: [u32; 4],
    olds: usize,
    new: [([usize; 4], Sphere); 4],
    news: usize,
}

/// Place of `e`.
const E: usize = 4;
/// Place of the sixth vertex.
const W: usize = 5;

impl<'a> Flip<'a> {
    /// Nothing yet but the five vertices; `None` if both apexes are walls.
    fn new(view: View<'a>, p: [Vertex; 4], k: usize, e: Vertex) -> Option<Self> {
        let base = if view.is_grain(p[k]) { k } else { E };
        let mut flip = Flip {
            view,
            vertices: [p[0], p[1], p[2], p[3], e, NONE],
            count: 5,
            rows: [Row::default(); 6],
            base,
            old: [NONE; 4],
            olds: 0,
            new: [([0; 4], Sphere::default()); 4],
            news: 0,
        };
        let query = *view.points.get(flip.vertices[base] as usize)?;
        for i in 0..5 {
            flip.rows[i] = view.row(flip.vertices[i], query);
        }
        Some(flip)
    }

    fn sixth(&mut self, w: Vertex) {
        (self.vertices[W], self.count) = (w, 6);
        self.rows[W] = self.view.row(w, self.view.points[self.vertices[self.base] as usize]);
    }

    fn old(&self) -> &[u32] {
        &self.old[..self.olds]
    }

    fn remove(&mut self, pore: u32) {
        self.old[self.olds] = pore;
        self.olds += 1;
    }

    /// Adds a new pore if it is positively oriented; the sign of its orientation.
    fn put(&mut self, pore: [usize; 4]) -> i32 {
        let at = pore.iter().position(|&i| i == self.base).unwrap_or(0);
        let others = FACET[at].map(|k| pore[k]);
        let name = others.map(|i| self.vertices[i]);
        let row = |k: usize| &self.rows[others[k]];
        let (sphere, sign) =
            self.view.oriented_rows(self.vertices[self.base], name, [row(0), row(1), row(2)]);
        if sign > 0 {
            self.new[self.news] = (pore, sphere);
            self.news += 1;
        }
        sign
    }

    fn place(&self, vertex: Vertex) -> usize {
        self.vertices[..self.count].iter().position(|&v| v == vertex).unwrap_or(0)
    }
}

impl<'a> Patch<'a> {
    /// Flips, from a pore on, until all facets met are locally regular or cannot be flipped: then their pores are stuck.
    pub(super) fn settle(&mut self, pore: u32, sphere: Sphere) -> Result<(), GaveUp> {
        let kept = self.kept as u32;
        let mut open = std::mem::take(&mut self.open);
        open.push((pore, sphere));
        while let Some((p, sphere)) = open.pop() {
            if self.is_free(p) {
                continue;
            }
            for k in 0..4 {
                let across = self.mesh.neighbours[p as usize][k];
                // The newer of two pores looks at their facet; of two old ones the first, as in the survey.
                let due = if p < kept { p < across && across < kept } else { across < p };
                if !due {
                    continue;
                }
                let vertex = self.mesh.pores[p as usize];
                let all = |v: [Vertex; 4]| v[0] ^ v[1] ^ v[2] ^ v[3];
                // Three of the four cancel.
                let e = all(self.mesh.pores[across as usize]) ^ all(vertex) ^ vertex[k];
                if !self.view.conflicts(vertex, &sphere, e) {
                    continue;
                }
                match self.flip(p, k, across, e) {
                    Some(flip) => {
                        self.report.flips += 1;
                        self.exchange(&flip, &mut open);
                        self.replaced(flip.olds)?;
                        break;
                    }
                    None => self.stuck.push(p),
                }
            }
        }
        self.open = open;
        Ok(())
    }

    /// The flip of the facet `k` of a pore, if there is one; all pores around must be positively oriented.
    fn flip(&self, p: u32, k: usize, q: u32, e: Vertex) -> Option<Flip<'a>> {
        let (pores, neighbours) = (&self.mesh.pores, &self.mesh.neighbours);
        let vertex = pores[p as usize];
        if vertex.contains(&e) {
            return None;
        }
        // The pore across the facet opposite a vertex.
        let beyond = |pore: u32, v: Vertex| {
            let place = pores[pore as usize].iter().position(|&u| u == v)?;
            Some(neighbours[pore as usize][place])
        };
        let mut flip = Flip::new(self.view, vertex, k, e)?;
        flip.remove(p);
        flip.remove(q);
        let mut flat = None;
        for j in FACET[k] {
            let mut new = [0, 1, 2, 3];
            new[j] = E;
            match flip.put(new) {
                1 => {}
                0 if flat.is_none() => flat = Some(j),
                -1 if flip.olds == 2 => {
                    // The same pore seen from both sides.
                    let r = neighbours[p as usize][j];
                    if r == NONE || beyond(q, vertex[j])? != r || !pores[r as usize].contains(&e) {
                        return None;
                    }
                    flip.remove(r);
                }
                _ => return None,
            }
        }
        if let Some(j) = flat {
            let (r, s) = (neighbours[p as usize][j], beyond(q, vertex[j])?);
            if flip.olds > 2 || r == NONE || s == NONE || r == s || beyond(r, vertex[k])? != s {
                return None;
            }
            let far = pores[r as usize];
            let w = far[neighbours[r as usize].iter().position(|&pore| pore == p)?];
            let around = w != e && !vertex.contains(&w) && pores[s as usize].contains(&w);
            if !around {
                return None;
            }
            flip.remove(r);
            flip.remove(s);
            flip.sixth(w);
            let far = far.map(|v| flip.place(v));
            for i in (0..4).filter(|&i| far[i] != k && far[i] != W) {
                let mut new = far;
                new[i] = E;
                if flip.put(new) != 1 {
                    return None;
                }
            }
        }
        self.see_each_other(&flip.vertices[..flip.count]).then_some(flip)
    }

    /// Puts the new pores in the place of the old, and notes that their facets are to be looked at.
    fn exchange(&mut self, flip: &Flip, open: &mut Vec<(u32, Sphere)>) {
        // What is on the other side of each facet, known by its set of vertices.
        const NOTHING: u8 = u8::MAX;
        let mut other = [(NONE, NOTHING); 64];
        for &pore in flip.old() {
            let (vertex, sides) = (self.mesh.pores[pore as usize], self.mesh.neighbours[pore as usize]);
            let bits = vertex.map(|v| 1 << flip.place(v));
            let set: usize = bits.iter().sum();
            for k in (0..4).filter(|&k| sides[k] == NONE || !flip.old().contains(&sides[k])) {
                let around = self.mesh.neighbours.get(sides[k] as usize);
                let back = around.and_then(|around| around.iter().position(|&q| q == pore)).unwrap_or(0);
                other[set - bits[k]] = (sides[k], back as u8);
            }
            self.free(pore);
        }
        for &(places, sphere) in &flip.new[..flip.news] {
            let pore = self.push(places.map(|i| flip.vertices[i]));
            open.push((pore, sphere));
            let set: usize = places.iter().map(|i| 1 << i).sum();
            for k in 0..4 {
                let facet = &mut other[set - (1 << places[k])];
                match *facet {
                    (_, NOTHING) => *facet = (pore, k as u8),
                    (outside, back) => self.join(pore, k, outside, back as usize),
                }
            }
        }
    }
}
