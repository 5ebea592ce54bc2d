//! Periodic cells: a coarse triangulation of images, closed into a torus, then insertion in the torus.
//!
//! All grains of a small sample, or a well-spread subset of a large one, are triangulated with as many of their images
//! around one period as it takes (found by checking every power sphere, no length to choose). If the
//! power spheres are small enough, the pores of one period become a torus, a mesh in which differences are taken to the nearest image, and
//! the other grains are inserted there: no image is stored, no shift is carried along.

use super::canonical::{self, PeriodicPore};
use super::lattice::Lattice;
use super::mesh::{FREE, Mesh, Pore};
use super::view::{Space, View};
use super::{FACET, NONE, Triangulation, TriangulationError, Vertex};
use crate::order;
use glam::DVec3;
use std::collections::HashMap;

/// The largest power sphere of a torus, by its radius `rho` (with the largest weight added), must fit this often into the
/// distance of lattice planes.
///
/// A query in conflict with a pore lies within `rho` of its centre, so within `2 rho` of its vertices and `3 rho` of the centres of its
/// neighbours. Then vertices are met at their nearest images (within half a period), and so is the centre of a pore in conflict. Of a
/// neighbour that is not in conflict another image may be nearer, but is not in conflict either: it would lie within `rho` of the centre and
/// `4 rho` of the query. Spheres only shrink as grains come in.
pub(super) const FIT: f64 = 4.0;

/// A vertex of a pore among images: the grain and its period along the reduced basis.
type Image = (u32, [i32; 3]);

/// Pores of one period, with true neighbours.
struct Period {
    pores: Vec<Pore>,
    shifts: Vec<[[i32; 3]; 4]>,
    hidden: Vec<u32>,
    /// Largest `power + largest weight`: the square of `rho`.
    square: f64,
}

/// `points` in space-filling order, `label` their numbers; the same points as the user numbers them, and the periods taken away from each.
pub(super) fn triangulate(
    points: &[[f64; 4]],
    label: &[u32],
    own: &[[f64; 4]],
    periods: &[[i32; 3]],
    space: &Space,
    spacing: f64,
) -> Result<Triangulation, TriangulationError> {
    let n = points.len();
    if n == 0 {
        return Ok(Triangulation::default());
    }
    let height = space.lattice.least_height();
    // Spheres of a well-spread subset have a radius of about 1.4 distances.
    let mut first = (n as f64 * (1.4 * FIT * spacing / height).powi(3)).max(4.0);
    loop {
        // A subset without a grain as large as the period would be asked for images out to its radius.
        let whole = first > 0.7 * n as f64 || FIT * space.largest.sqrt() > height;
        let (order, length) = order::rounds(n, if whole { n } else { first as usize });
        let (subset, rest) = order.split_at(if whole { n } else { length });
        let period =
            one_period(points, label, subset, space, spacing * (n as f64 / subset.len() as f64).cbrt());
        if whole {
            let raw = |k: usize| raw(label, periods, &space.lattice, &period.pores[k], period.shifts[k]);
            let pores: Vec<PeriodicPore> = (0..period.pores.len()).map(raw).collect();
            let hidden = period.hidden.iter().map(|&g| label[g as usize]).collect();
            return canonical::number_periodic(&pores, n, hidden);
        }
        if FIT * period.square.sqrt() < height * (1.0 - 1e-9) {
            let mut mesh = Mesh::new(View::new(points, label, n as u32, space));
            mesh.resume(period.pores, period.hidden);
            rest.iter().for_each(|&grain| mesh.insert(grain));
            let mut t = canonical::number(&mesh, n);
            t.shifts = shifts(&t.pores, own, periods, &space.lattice)?;
            return Ok(t);
        }
        first *= 2.0;
    }
}

/// The shifts of pores whose vertices are different grains at their nearest images; points in the user's numbering.
pub(super) fn shifts(
    pores: &[[Vertex; 4]],
    points: &[[f64; 4]],
    periods: &[[i32; 3]],
    lattice: &Lattice,
) -> Result<Vec<[[i8; 3]; 4]>, TriangulationError> {
    let mut all = Vec::with_capacity(pores.len());
    for pore in pores {
        let base = pore[0] as usize;
        let mut shifts = [[0; 3]; 4];
        for k in 1..4 {
            let grain = pore[k] as usize;
            let (Some(p), b) = (points.get(grain), &points[base]) else { continue };
            let d = [p[0] - b[0], p[1] - b[1], p[2] - b[2]];
            if lattice.is_nearest(d) && periods[grain] == periods[base] {
                continue;
            }
            let near = lattice.shift_to_nearest(d);
            let shift = [0, 1, 2].map(|j| near[j] as i32 + periods[base][j] - periods[grain][j]);
            for (small, whole) in shifts[k].iter_mut().zip(lattice.along_edges(shift)) {
                *small = i8::try_from(whole).map_err(|_| TriangulationError::Far { grain })?;
            }
        }
        all.push(shifts);
    }
    Ok(all)
}

/// A pore in the user's numbering and periods.
fn raw(
    label: &[u32],
    periods: &[[i32; 3]],
    lattice: &Lattice,
    pore: &Pore,
    shift: [[i32; 3]; 4],
) -> PeriodicPore {
    let n = label.len();
    let mut raw = PeriodicPore { vertex: [0; 4], shift: [[0; 3]; 4], neighbour: pore.neighbour };
    for k in 0..4 {
        let v = pore.vertex[k] as usize;
        if v < n {
            raw.vertex[k] = label[v];
            let taken = periods[label[v] as usize];
            raw.shift[k] = lattice.along_edges([0, 1, 2].map(|j| shift[k][j] - taken[j]));
        } else {
            raw.vertex[k] = super::FIRST_WALL + (v - n) as u32;
        }
    }
    raw
}

/// Triangulates the subset with enough images and keeps one period.
fn one_period(points: &[[f64; 4]], label: &[u32], subset: &[u32], space: &Space, spacing: f64) -> Period {
    let mut margin = 2.5 * spacing;
    loop {
        let images = Images::new(points, subset, &space.lattice, margin);
        match images.period(points, label, space, margin) {
            Ok(period) => return period,
            Err(more) => margin = more,
        }
    }
}

struct Images {
    source: Vec<Image>,
    points: Vec<[f64; 4]>,
    lower: [f64; 3],
    upper: [f64; 3],
}

impl Images {
    /// All images of the subset within a distance of the first period.
    fn new(points: &[[f64; 4]], subset: &[u32], lattice: &Lattice, margin: f64) -> Self {
        let mut images = Images { source: Vec::new(), points: Vec::new(), lower: [0.0; 3], upper: [0.0; 3] };
        let reach = [0, 1, 2].map(|j| margin / lattice.height(j));
        for &grain in subset {
            let [x, y, z, w] = points[grain as usize];
            let f = lattice.coordinates([x, y, z]);
            let range = |j: usize| {
                if lattice.periodic[j] {
                    (-reach[j] - f[j]).ceil() as i32..=(1.0 + reach[j] - f[j]).floor() as i32
                } else {
                    0..=0
                }
            };
            for (i, j, k) in
                range(0).flat_map(|i| range(1).flat_map(move |j| range(2).map(move |k| (i, j, k))))
            {
                let [x, y, z] = lattice.moved([x, y, z], [f64::from(i), f64::from(j), f64::from(k)]);
                images.source.push((grain, [i, j, k]));
                images.points.push([x, y, z, w]);
            }
        }
        for axis in (0..3).filter(|&j| (0..3).any(|k| lattice.step[k][j] != 0.0)) {
            let all = || images.points.iter().map(|p| p[axis]);
            images.lower[axis] = all().fold(f64::INFINITY, f64::min) - margin.ceil();
            images.upper[axis] = all().fold(f64::NEG_INFINITY, f64::max) + margin.ceil();
        }
        images
    }

    /// The pores of one period, or the margin it takes.
    fn period(
        mut self,
        points: &[[f64; 4]],
        label: &[u32],
        space: &Space,
        margin: f64,
    ) -> Result<Period, f64> {
        let lattice = space.lattice;
        let mut within = Space { lattice: Lattice::none(), lower: self.lower, upper: self.upper, ..*space };
        for axis in (0..3).filter(|&k| !lattice.periodic[k]) {
            (within.lower[axis], within.upper[axis]) = (space.lower[axis], space.upper[axis]);
        }
        let place = |p: &[f64; 4]| DVec3::new(p[0], p[1], p[2]);
        let order = order::sorted(self.points.iter().map(place), within.lower.into(), within.upper.into());
        self.source = order.iter().map(|&i| self.source[i as usize]).collect();
        self.points = order.iter().map(|&i| self.points[i as usize]).collect();
        let labels: Vec<u32> = self.source.iter().map(|s| label[s.0 as usize]).collect();
        let count = self.points.len();
        let mut mesh = Mesh::new(View::new(&self.points, &labels, count as u32, &within));
        let mut rounds = order::rounds(count, 4).0.into_iter();
        mesh.start(rounds.next().unwrap_or(0));
        rounds.for_each(|grain| mesh.insert(grain));

        let wall = |v: u32| v as usize >= count;
        let image = |v: u32| if wall(v) { (v, [0; 3]) } else { self.source[v as usize] };
        let mut period = Period { pores: Vec::new(), shifts: Vec::new(), hidden: Vec::new(), square: 0.0 };
        let mut needed = 0.0f64;
        for pore in mesh.pores.iter().filter(|p| p.vertex[0] != FREE) {
            let images = pore.vertex.map(image);
            if !(0..4).any(|k| !wall(pore.vertex[k]) && images[k].1 == [0; 3]) {
                continue;
            }
            // The sphere, widened by the largest weight, must not reach beyond the images, nor end at a wall that is none.
            let artificial = |v: u32| wall(v) && lattice.periodic[(v as usize - count) / 2];
            if pore.vertex.into_iter().any(artificial) {
                return Err(1.6 * margin);
            }
            let (centre, power) = mesh.view.sphere(pore.vertex, &pore.sphere);
            let square = (power + space.largest).max(0.0);
            let radius = square.sqrt() * (1.0 + 1e-9) + 1.0;
            let f = lattice.coordinates(centre);
            for j in (0..3).filter(|&j| lattice.periodic[j]) {
                needed = needed.max(radius + lattice.height(j) * (-f[j]).max(f[j] - 1.0));
            }
            period.square = period.square.max(square);
            // Of the images of a pore, the one whose first vertex is in the first period.
            let first = (0..4).filter(|&k| !wall(pore.vertex[k])).map(|k| images[k]).min();
            if first.is_some_and(|(_, shift)| shift == [0; 3]) {
                period.pores.push(*pore);
                period.shifts.push([images[0].1, images[1].1, images[2].1, images[3].1]);
            }
        }
        if needed > margin {
            return Err(1.05 * needed);
        }
        let n = points.len() as u32;
        for pore in &mut period.pores {
            pore.vertex = pore.vertex.map(|v| if wall(v) { n + v - count as u32 } else { image(v).0 });
        }
        if !period.link(n) {
            return Err(1.3 * margin);
        }
        let base = mesh.hidden.iter().map(|&v| self.source[v as usize]).filter(|s| s.1 == [0; 3]);
        period.hidden = base.map(|s| s.0).collect();
        Ok(period)
    }
}

impl Period {
    /// Makes the two pores of each facet neighbours; false if there are not two.
    fn link(&mut self, first_wall: u32) -> bool {
        // A facet is known by its sorted vertices with the shifts relative to the first.
        let mut open: HashMap<[Image; 3], (usize, usize)> = HashMap::new();
        for p in 0..self.pores.len() {
            for k in 0..4 {
                let mut facet = FACET[k].map(|j| (self.pores[p].vertex[j], self.shifts[p][j]));
                facet.sort_unstable(); // walls last
                let (first, shift) = facet[0];
                if first >= first_wall {
                    self.pores[p].neighbour[k] = NONE;
                    continue;
                }
                for (vertex, s) in &mut facet {
                    *s = if *vertex < first_wall { [0, 1, 2].map(|j| s[j] - shift[j]) } else { [0; 3] };
                }
                if let Some((q, back)) = open.remove(&facet) {
                    self.pores[p].neighbour[k] = q as u32;
                    self.pores[q].neighbour[back] = p as u32;
                } else {
                    open.insert(facet, (p, k));
                }
            }
        }
        open.is_empty()
    }
}
