//! Power (Voronoi) cells of the grains: facets between neighbours and volumes.
//!
//! The facet between two grains is the polygon of the radical centres of the pores around their edge; the facet between a
//! grain and a wall is the grain's part of the wall.

use crate::throat::{Centres, Packing, shift_to};
use crate::triangulation::{Triangulation, Vertex, wall};
use glam::DVec3;

/// The polygon between two neighbouring power cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Facet {
    /// A grain, and another of higher index (or an image of the same) or a wall.
    pub between: [Vertex; 2],
    /// Period of the second grain relative to the first.
    pub shift: [i8; 3],
    /// Area times the unit normal from the first to the second [m²]. Zero for neighbours that touch in an edge or a point only
    /// (ties, as on a cubic lattice).
    pub area: DVec3,
    /// Centroid of the polygon in the frame of the first grain [m].
    pub centroid: DVec3,
    /// Where the corners are in [`Voronoi::corners`].
    first: u32,
    last: u32,
}

/// All power cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Voronoi {
    /// Facets, sorted by their grains and shift; each once.
    pub facets: Vec<Facet>,
    /// Volume of each grain's power cell [m³]; they sum to the volume of the cell. Zero for hidden grains.
    pub volume: Vec<f64>,
    corners: Vec<DVec3>,
    start: Vec<u32>,
    around: Vec<u32>,
}

impl Voronoi {
    /// Corners of a facet, counter-clockwise seen from the second vertex, in the frame of the first [m].
    pub fn corners(&self, facet: &Facet) -> &[DVec3] {
        &self.corners[facet.first as usize..facet.last as usize]
    }

    /// The facets of a grain's cell, by their places in [`facets`](Self::facets); one between the grain and its own
    /// image is named twice.
    pub fn around(&self, grain: u32) -> &[u32] {
        &self.around[self.start[grain as usize] as usize..self.start[grain as usize + 1] as usize]
    }
}

/// The edges of a pore as pairs of places, with the two other places such that the four are an even permutation.
const EDGES: [[usize; 4]; 6] =
    [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]];

/// The number in [`EDGES`] of the edge between two places.
const NUMBER: [[usize; 4]; 4] = [[6, 0, 1, 2], [0, 6, 3, 4], [1, 3, 6, 5], [2, 4, 5, 6]];

/// Facets, volumes and neighbours of all power cells.
///
/// `centres` are the radical centres of `mesh`. Time is linear in the number of pores.
pub fn voronoi(packing: Packing, mesh: &Triangulation, centres: &Centres) -> Voronoi {
    let grains = packing.position.len();
    let mut done = vec![0u8; mesh.pores.len()];
    let mut all = Voronoi { volume: vec![0.0; grains], ..Default::default() };
    for pore in 0..mesh.pores.len() {
        for (number, &[i, j, k, l]) in EDGES.iter().enumerate() {
            let [a, b] = [i, j].map(|v| (mesh.pores[pore][v], shift(mesh, pore, v)));
            let walls = wall(a.0).is_some() && wall(b.0).is_some();
            if done[pore] & (1 << number) == 0 && !walls {
                // From the smaller to the larger; swapping two pairs keeps the orientation.
                let start = if a <= b { [i, j, k, l] } else { [j, i, l, k] };
                all.add_ring(packing, mesh, centres, pore, start, &mut done);
            }
        }
    }
    all.facets.sort_by_key(|f| (f.between, f.shift));
    let mut count = vec![0u32; grains + 1];
    let ends = |f: &Facet| f.between.into_iter().filter(|&v| wall(v).is_none());
    all.facets.iter().flat_map(ends).for_each(|g| count[g as usize + 1] += 1);
    (0..grains).for_each(|g| count[g + 1] += count[g]);
    all.start = count.clone();
    all.around = vec![0; count[grains] as usize];
    for (number, facet) in (0..).zip(&all.facets) {
        for g in ends(facet) {
            all.around[count[g as usize] as usize] = number;
            count[g as usize] += 1;
        }
    }
    all
}

/// The shift of a vertex in its pore; zero for walls and without periods.
fn shift(mesh: &Triangulation, pore: usize, k: usize) -> [i8; 3] {
    if mesh.shifts.is_empty() || wall(mesh.pores[pore][k]).is_some() { [0; 3] } else { mesh.shifts[pore][k] }
}

impl Voronoi {
    /// Goes once around the edge from place `i` to place `j` of a pore, counter-clockwise.
    fn add_ring(
        &mut self,
        packing: Packing,
        mesh: &Triangulation,
        centres: &Centres,
        pore: usize,
        places: [usize; 4],
        done: &mut [u8],
    ) {
        let moved = |s: [i8; 3], by: [i32; 3]| [0, 1, 2].map(|a| i32::from(s[a]) + by[a]);
        // The frame in which the first grain has no shift; walls are in every frame.
        let frame = shift(mesh, pore, places[0]).map(|s| -i32::from(s));
        let name = |pore: usize, k: usize, frame: [i32; 3]| {
            let v = mesh.pores[pore][k];
            (v, if wall(v).is_some() { [0; 3] } else { moved(shift(mesh, pore, k), frame) })
        };
        let ends = [name(pore, places[0], frame), name(pore, places[1], frame)];
        let first = self.corners.len();
        let mut now = (pore, places, frame);
        loop {
            let (p, [i, j, k, l], by) = now;
            done[p] |= 1 << NUMBER[i][j];
            let offset =
                packing.cell.edges * DVec3::new(f64::from(by[0]), f64::from(by[1]), f64::from(by[2]));
            self.corners.push(centres.point[p] + offset);
            let next = mesh.neighbours[p][k] as usize;
            let next_frame = moved(shift_to(mesh, p, k, next), by);
            let known = [ends[0], ends[1], name(p, l, by)];
            // Even permutation (i, j, k, l) again, with the old l as the new k.
            let [Some(i), Some(j), Some(k)] = known.map(|n| (0..4).find(|&m| name(next, m, next_frame) == n))
            else {
                break; // not a triangulation
            };
            now = (next, [i, j, k, 6 - i - j - k], next_frame);
            if now == (pore, places, frame) || self.corners.len() - first > mesh.pores.len() * 6 {
                break;
            }
        }
        let at = |(v, s): (Vertex, [i32; 3])| {
            let by = packing.cell.edges * DVec3::new(f64::from(s[0]), f64::from(s[1]), f64::from(s[2]));
            wall(v).is_none().then(|| packing.position[v as usize] + by)
        };
        let corner = &self.corners[first..];
        let (mut area, mut middle, mut sum) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        let triangles = || corner.windows(2).skip(1).map(|c| [corner[0], c[0], c[1]]);
        triangles().for_each(|[a, b, c]| area += 0.5 * (b - a).cross(c - a));
        for [a, b, c] in triangles() {
            let part = (b - a).cross(c - a).dot(area);
            middle += (a + b + c) * part;
            sum += 3.0 * part;
        }
        let mean = corner.iter().sum::<DVec3>() / corner.len() as f64;
        let centroid = if sum > 0.0 { middle / sum } else { mean };
        for (end, sign) in ends.into_iter().zip([1.0, -1.0]) {
            if let Some(x) = at(end) {
                let volume: f64 = triangles().map(|[a, b, c]| (a - x).dot((b - x).cross(c - x))).sum();
                self.volume[end.0 as usize] += sign * volume / 6.0;
            }
        }
        self.facets.push(Facet {
            between: ends.map(|e| e.0),
            shift: ends[1].1.map(|s| s as i8),
            area,
            centroid,
            first: first as u32,
            last: self.corners.len() as u32,
        });
    }
}
