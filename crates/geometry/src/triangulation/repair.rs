//! Following the grains: after small motions only the pores that stopped being right are replaced.
//!
//! A triangulation is regular if every pore is positively oriented and no vertex across a facet conflicts with the pore on this
//! side. All pores and facets are checked; around each failure a hole is opened and grown until the pores around it
//! conflict with none of its vertices. Their facets then belong to the regular triangulation of the vertices of the hole,
//! so that it can be filled by gift wrapping from its facets inwards, and fits. Unlike [`flips`](super::flips), which are tried
//! first, this does not get stuck, and nearly flat pores may turn inside out.
//!
//! The work is done in the arrays of the triangulation: new pores are put at the end and merged into the order when all is well.

use super::mesh::{FREE, Mesh, Pore};
use super::regular::Survey;
use super::view::View;
use super::{FACET, NONE, Repair, Triangulation, Vertex, canonical, wall};
use crate::predicates::Sphere;

/// Holes with more vertices are left to a rebuild.
const LARGEST_HOLE: usize = 200;

/// The repair gave up; the mesh must be rebuilt.
pub(super) struct GaveUp;

/// A facet of a hole: the pore to come has these vertices but for place `apex`.
#[derive(Clone, Copy)]
struct Front {
    vertex: [Vertex; 4],
    apex: usize,
    outside: u32,
    back: usize,
}

/// A triangulation under repair. Pores taken away are marked [`FREE`], new ones put behind the old.
pub(super) struct Patch<'a> {
    pub(super) view: View<'a>,
    pub(super) mesh: &'a mut Triangulation,
    /// Number of old pores.
    pub(super) kept: usize,
    /// Old pores of a torus as they were, in the order of change.
    was: Vec<(u32, [Vertex; 4], [u32; 4])>,
    /// The last hole each pore was in.
    stamp: Vec<u32>,
    /// Grains without a pore.
    lost: Vec<u32>,
    /// New pores whose facets are to be looked at.
    pub(super) open: Vec<(u32, Sphere)>,
    /// Pores that cannot be mended by flips.
    pub(super) stuck: Vec<u32>,
    pub(super) report: Repair,
}

impl<'a> Patch<'a> {
    pub fn new(view: View<'a>, mesh: &'a mut Triangulation) -> Self {
        let kept = mesh.pores.len();
        let lost = mesh.hidden.clone();
        Patch {
            view,
            mesh,
            kept,
            was: Vec::new(),
            stamp: vec![0; kept],
            lost,
            open: Vec::new(),
            stuck: Vec::new(),
            report: Repair::default(),
        }
    }

    /// Puts everything back as it was, in a torus: else nothing stands in the way of a rebuild.
    pub fn undo(self) {
        for (pore, vertex, neighbour) in self.was.into_iter().rev() {
            (self.mesh.pores[pore as usize], self.mesh.neighbours[pore as usize]) = (vertex, neighbour);
        }
        self.mesh.pores.truncate(self.kept);
        self.mesh.neighbours.truncate(self.kept);
    }

    fn remember(&mut self, pore: u32) {
        if self.view.torus && (pore as usize) < self.kept {
            let p = pore as usize;
            self.was.push((pore, self.mesh.pores[p], self.mesh.neighbours[p]));
        }
    }

    /// Replaces what is not regular: the new triangulation (without shifts) and the largest power of its new pores.
    pub fn mend(&mut self, survey: &Survey) -> Result<(Triangulation, Repair, f64), GaveUp> {
        // Flips know nothing of pores turned inside out.
        for &pore in &survey.inverted {
            self.refill(pore)?;
        }
        for &pore in &survey.bad {
            if !self.is_free(pore) {
                self.settle(pore, self.view.shape(self.mesh.pores[pore as usize]).0)?;
            }
        }
        for pore in std::mem::take(&mut self.stuck) {
            self.refill(pore)?;
        }
        self.report.reinserted = self.lost.len();
        if !self.lost.is_empty() {
            return Ok(self.reinserted());
        }
        let power = |&vertex: &[Vertex; 4]| self.view.sphere(vertex, &self.view.shape(vertex).0).1;
        let live = self.mesh.pores[self.kept..].iter().filter(|vertex| vertex[0] != FREE);
        let largest = live.map(power).fold(f64::NEG_INFINITY, f64::max);
        Ok((canonical::merged(self.mesh, self.kept), self.report, largest))
    }

    /// Counts replaced pores, up to a limit.
    pub(super) fn replaced(&mut self, pores: usize) -> Result<(), GaveUp> {
        self.report.replaced += pores;
        if self.report.replaced > self.kept + 100 { Err(GaveUp) } else { Ok(()) }
    }

    pub(super) fn is_free(&self, pore: u32) -> bool {
        self.mesh.pores[pore as usize][0] == FREE
    }

    pub(super) fn free(&mut self, pore: u32) {
        self.remember(pore);
        self.mesh.pores[pore as usize][0] = FREE;
    }

    /// A new pore without neighbours.
    pub(super) fn push(&mut self, vertex: [Vertex; 4]) -> u32 {
        self.mesh.pores.push(vertex);
        self.mesh.neighbours.push([NONE; 4]);
        self.stamp.push(0);
        self.mesh.pores.len() as u32 - 1
    }

    /// Opens a hole around a pore that is not right, if it still is not, grows it as far as it must and fills it.
    fn refill(&mut self, pore: u32) -> Result<(), GaveUp> {
        if self.is_free(pore) {
            return Ok(()); // mended with another
        }
        let Triangulation { pores, neighbours, .. } = &*self.mesh;
        let p = pore as usize;
        let mut hole = vec![pore];
        let (sphere, positive) = self.view.shape(pores[p]);
        if positive {
            match (0..4).find(|&k| !self.view.locally_regular(pores, neighbours, p, k, &sphere)) {
                Some(k) => hole.push(neighbours[p][k]),
                None => return Ok(()),
            }
        }
        let (front, vertices) = self.grow(&mut hole)?;
        self.report.holes += 1;
        self.replaced(hole.len())?;
        self.wrap(&hole, front, &vertices)
    }

    /// In a torus the vertices of a hole must see each other at their nearest images.
    pub(super) fn see_each_other(&self, vertices: &[Vertex]) -> bool {
        let mut grains = vertices.iter().filter(|&&v| self.view.is_grain(v));
        let first = grains.next().copied().unwrap_or(0);
        !self.view.torus || grains.all(|&v| self.view.are_close(first, v))
    }

    /// Inserts the grains without a pore.
    fn reinserted(&mut self) -> (Triangulation, Repair, f64) {
        let grains = self.view.points.len() as u32;
        // Insertion numbers the walls behind the grains.
        let view = self.view.with_walls_from(grains);
        let inner = |v: Vertex| wall(v).map_or(v, |face| grains + face as u32);
        let pore = |(&vertex, &neighbour): (&[Vertex; 4], &[u32; 4])| {
            if vertex[0] == FREE {
                return Pore { vertex, neighbour, sphere: Sphere::default() };
            }
            Pore { vertex: vertex.map(inner), neighbour, sphere: self.view.shape(vertex).0 }
        };
        let pores = self.mesh.pores.iter().zip(&self.mesh.neighbours).map(pore).collect();
        let mut mesh = Mesh::new(view);
        mesh.resume(pores, Vec::new());
        self.lost.iter().for_each(|&grain| mesh.insert(grain));
        let live = mesh.pores.iter().filter(|p| p.vertex[0] != FREE);
        let largest = live.map(|p| view.sphere(p.vertex, &p.sphere).1).fold(f64::NEG_INFINITY, f64::max);
        (canonical::number(&mesh, grains as usize), self.report, largest)
    }

    /// Grows a hole until the pores around it conflict with none of its vertices; returns its facets and vertices.
    fn grow(&mut self, hole: &mut Vec<u32>) -> Result<(Vec<Front>, Vec<Vertex>), GaveUp> {
        let round = self.report.holes as u32 + 1;
        let mut vertices: Vec<Vertex> = Vec::new();
        let (mut added, mut front) = (0, Vec::new());
        loop {
            for &pore in &hole[added..] {
                self.stamp[pore as usize] = round;
                for v in self.mesh.pores[pore as usize] {
                    if !vertices.contains(&v) {
                        vertices.push(v);
                    }
                }
            }
            if vertices.len() > LARGEST_HOLE {
                return Err(GaveUp);
            }
            added = hole.len();
            front.clear();
            for h in 0..added {
                let vertex = self.mesh.pores[hole[h] as usize];
                for k in 0..4 {
                    let outside = self.mesh.neighbours[hole[h] as usize][k];
                    if outside == NONE {
                        front.push(Front { vertex, apex: k, outside, back: 0 });
                        continue;
                    }
                    if self.stamp[outside as usize] == round {
                        continue;
                    }
                    let around = self.mesh.pores[outside as usize];
                    let (sphere, positive) = self.view.shape(around);
                    let conflicts =
                        |&v: &Vertex| !around.contains(&v) && self.view.conflicts(around, &sphere, v);
                    if !positive || vertices.iter().any(conflicts) {
                        self.stamp[outside as usize] = round;
                        hole.push(outside);
                    } else {
                        let sides = self.mesh.neighbours[outside as usize];
                        let back = sides.iter().position(|&p| p == hole[h]).unwrap_or(0);
                        front.push(Front { vertex, apex: k, outside, back });
                    }
                }
            }
            if hole.len() == added {
                if !self.see_each_other(&vertices) {
                    return Err(GaveUp);
                }
                return Ok((front, vertices));
            }
        }
    }

    /// Fills a hole by gift wrapping; grains left without a pore go to `lost`.
    fn wrap(&mut self, hole: &[u32], mut front: Vec<Front>, candidates: &[Vertex]) -> Result<(), GaveUp> {
        let mut used: Vec<Vertex> = front.iter().flat_map(|f| FACET[f.apex].map(|j| f.vertex[j])).collect();
        hole.iter().for_each(|&pore| self.free(pore));
        let mut budget = 4 * hole.len() + 64;
        while let Some(facet) = front.pop() {
            budget = budget.checked_sub(1).ok_or(GaveUp)?;
            let vertex = self.gift(&facet, candidates).ok_or(GaveUp)?;
            let pore = self.push(vertex);
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
        let grains = candidates.iter().filter(|&&v| self.view.is_grain(v));
        self.lost.extend(grains.filter(|v| !used.contains(v)));
        Ok(())
    }

    pub(super) fn join(&mut self, pore: u32, k: usize, outside: u32, back: usize) {
        self.mesh.neighbours[pore as usize][k] = outside;
        if outside != NONE {
            self.remember(outside);
            self.mesh.neighbours[outside as usize][back] = pore;
        }
    }

    /// The pore on a facet whose power sphere holds no candidate.
    fn gift(&self, facet: &Front, candidates: &[Vertex]) -> Option<[Vertex; 4]> {
        let mut best: Option<([Vertex; 4], Sphere)> = None;
        for &v in candidates {
            let mut vertex = facet.vertex;
            vertex[facet.apex] = v;
            if FACET[facet.apex].iter().any(|&j| vertex[j] == v) {
                continue;
            }
            if best.as_ref().is_some_and(|(pore, sphere)| !self.view.conflicts(*pore, sphere, v)) {
                continue;
            }
            // Three walls and a grain, at least: opposite walls do not make a pore.
            if !vertex.iter().any(|&v| self.view.is_grain(v)) {
                continue;
            }
            let (sphere, positive) = self.view.shape(vertex);
            if positive {
                best = Some((vertex, sphere));
            }
        }
        best.map(|(vertex, _)| vertex)
    }
}
