//! The grid: cells between planes, links between them, and which part of each grain belongs to which.
//!
//! A link joins two cells across the face between them, or a cell and a wall. It carries water, `g (p_i - p_j)`, and the
//! solid that moves through its face, `A v`, v the mean velocity of the grains in the slab from centre to centre (at
//! a wall: from centre to wall), each weighted by its volume in there. The force of the link, `A (p_i - p_j)`, goes to
//! the same grains with the same weights: the two are transposes of each other, so pressures do no more work
//! than they take from the motion, and the forces on grains and walls sum to the resultant of the pressures at the faces.

use super::permeability::Permeability;
use super::transfer::{Pieces, Transfer};
use crate::grains::{Grains, Shape};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The void part of a cell is taken to be within these bounds: a cell without grains lets the water pass as if it
/// had one twentieth of solid, some thousand times better than a packing.
const POROSITY: [f64; 2] = [0.05, 0.95];
/// A cell with less solid than this has a mean diameter of no meaning.
const NO_SOLID: f64 = 1e-12;
/// A cell with fewer grains than this has an uncertain porosity.
pub const FEW_GRAINS: f64 = 3.0;
/// Grains handed to a thread at once.
const BLOCK: usize = 512;

/// What was found while making a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Census {
    /// Cells.
    pub cells: usize,
    /// Cells without any grain.
    pub empty: usize,
    /// Cells with some grains, but fewer than [`FEW_GRAINS`].
    pub sparse: usize,
    /// Cells whose porosity was brought within bounds.
    pub bounded: usize,
}

impl Census {
    /// What a user should know of the cells.
    pub fn warning(self) -> Option<String> {
        let Census { cells, sparse, bounded, .. } = self;
        if sparse > 0 {
            return Some(format!(
                "{sparse} of {cells}{WORDS} hold fewer than {FEW_GRAINS} grains each: their porosity says little; use \
                 larger cells, or know that they hold whole grains"
            ));
        }
        (bounded > 0).then(|| {
            format!("{bounded} of {cells}{WORDS} hold nearly no grain, or grains that overlap deeply: their porosity was bounded")
        })
    }

    /// Whether a warning is one of these.
    pub fn wrote(warning: &str) -> bool {
        warning.contains(WORDS)
    }
}

/// In every warning about cells.
const WORDS: &str = " cells of the grid of the water";

/// Rows of numbers with their column: which part of which.
#[derive(Clone, Debug, Default)]
pub struct Shares {
    starts: Vec<u32>,
    index: Vec<u32>,
    part: Vec<f64>,
}

impl Shares {
    /// Columns and parts of a row.
    #[inline]
    pub fn row(&self, k: usize) -> impl Iterator<Item = (usize, f64)> {
        let row = self.starts[k] as usize..self.starts[k + 1] as usize;
        self.index[row.clone()].iter().zip(&self.part[row]).map(|(&i, &part)| (i as usize, part))
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    fn transposed(&self, columns: usize) -> Shares {
        let mut starts = vec![0u32; columns + 1];
        for &i in &self.index {
            starts[i as usize + 1] += 1;
        }
        for k in 0..columns {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut index = vec![0; self.index.len()];
        let mut part = vec![0.0; self.part.len()];
        for k in 0..self.rows() {
            for (i, p) in self.row(k) {
                let at = next[i] as usize;
                index[at] = k as u32;
                part[at] = p;
                next[i] += 1;
            }
        }
        Shares { starts, index, part }
    }

    fn sums(&self) -> Vec<f64> {
        (0..self.rows()).map(|k| self.row(k).map(|(_, part)| part).sum()).collect()
    }
}

/// Cells, links, and the grains in them.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Number of cells along each axis.
    pub count: [usize; 3],
    /// Planes between the cells, both ends included [m].
    pub planes: [Vec<f64>; 3],
    /// Void part of each cell [-].
    pub porosity: Vec<f64>,
    /// Volume over surface of the grains in each cell, times six: their mean (Sauter) diameter [m].
    pub diameter: Vec<f64>,
    /// Volume of grains in each cell [m³].
    pub solid: Vec<f64>,
    /// Least density of a grain [kg/m³].
    pub density: f64,
    /// Permeability over viscosity, along each axis, of each cell [m²/(Pa s)].
    pub mobility: Vec<DVec3>,
    /// The two nodes of each link, in the direction of its axis. Nodes are cells, then walls faces in the order of links.
    pub ends: Vec<[u32; 2]>,
    /// Where the links along x, y, z begin, and the end.
    pub axis_start: [usize; 4],
    /// Area of the face of each link [m²].
    pub area: Vec<f64>,
    /// `g` of each link [m³/(Pa s)].
    pub conductance: Vec<f64>,
    /// The face of each wall node.
    pub wall_face: Vec<u8>,
    /// The link of each wall node.
    pub wall_link: Vec<u32>,
    /// Parts of each grain's volume [m³] by cell.
    pub in_cells: Shares,
    /// The same by cell.
    pub of_cells: Shares,
    /// For each axis, the weight of each grain in the links along it, by grain; weights of a link sum to 1.
    pub in_links: [Shares; 3],
    /// The same by link.
    pub of_links: [Shares; 3],
    /// What was found.
    pub census: Census,
}

/// What a grid is made of besides grains.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// Planes between the cells, both ends included [m].
    pub planes: [Vec<f64>; 3],
    /// How grains share out their volume.
    pub transfer: Transfer,
    /// How cells conduct.
    pub permeability: Permeability,
    /// [Pa s]
    pub viscosity: f64,
    /// Part of the permeability that the inertia of the water leaves in each cell; empty: all.
    pub slowed: &'a [f64],
}

impl Grid {
    /// Distributes the grains.
    pub fn new(grains: &Grains, plan: &Plan) -> Grid {
        let planes = &plan.planes;
        let count: [usize; 3] = std::array::from_fn(|axis| planes[axis].len() - 1);
        let flat = matches!(grains.shape, Shape::Disc { .. });
        let cells = count[0] * count[1] * count[2];
        let mut grid = Grid {
            count,
            planes: plan.planes.clone(),
            porosity: Vec::with_capacity(cells),
            diameter: Vec::with_capacity(cells),
            solid: Vec::new(),
            density: (grains.mass.iter().zip(&grains.radius))
                .map(|(mass, &radius)| mass / grains.shape.volume(radius))
                .fold(f64::INFINITY, f64::min),
            mobility: Vec::with_capacity(cells),
            ends: Vec::new(),
            axis_start: [0; 4],
            area: Vec::new(),
            conductance: Vec::new(),
            wall_face: Vec::new(),
            wall_link: Vec::new(),
            in_cells: Shares::default(),
            of_cells: Shares::default(),
            in_links: Default::default(),
            of_links: Default::default(),
            census: Census { cells, ..Census::default() },
        };
        grid.join(flat);
        grid.share(grains, plan.transfer, flat);
        grid.fill(grains, plan);
        grid.conduct();
        grid
    }

    /// Number of cells and wall faces.
    pub fn nodes(&self) -> usize {
        self.census.cells + self.wall_face.len()
    }

    /// Number of the cell at a place in the grid.
    pub fn cell(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.count[1] + y) * self.count[0] + x
    }

    /// Place in the grid of a cell.
    pub fn place(&self, cell: usize) -> [usize; 3] {
        let [nx, ny, _] = self.count;
        [cell % nx, cell / nx % ny, cell / nx / ny]
    }

    /// Centre of a cell [m].
    pub fn centre(&self, cell: usize) -> DVec3 {
        let place = self.place(cell);
        DVec3::from_array(std::array::from_fn(|axis| {
            0.5 * (self.planes[axis][place[axis]] + self.planes[axis][place[axis] + 1])
        }))
    }

    /// Lengths of the edges of a cell [m].
    pub fn size(&self, cell: usize) -> DVec3 {
        let place = self.place(cell);
        DVec3::from_array(std::array::from_fn(|axis| {
            self.planes[axis][place[axis] + 1] - self.planes[axis][place[axis]]
        }))
    }

    /// Volume of a cell [m³].
    pub fn volume(&self, cell: usize) -> f64 {
        self.size(cell).element_product()
    }

    /// Centre of the face of wall node `w` [m].
    pub fn wall_centre(&self, w: usize) -> DVec3 {
        let [low, high] = self.ends[self.wall_link[w] as usize];
        let (face, cells) = (self.wall_face[w] as usize, self.census.cells as u32);
        let mut centre = self.centre(low.min(high).min(cells - 1) as usize);
        let planes = &self.planes[face / 2];
        centre[face / 2] = if face.is_multiple_of(2) { planes[0] } else { planes[planes.len() - 1] };
        centre
    }

    /// The links along an axis.
    pub fn links(&self, axis: usize) -> std::ops::Range<usize> {
        self.axis_start[axis]..self.axis_start[axis + 1]
    }

    /// Links and wall nodes; none across the plane that discs live in.
    fn join(&mut self, flat: bool) {
        for axis in 0..3 {
            self.axis_start[axis] = self.ends.len();
            if flat && axis == 1 {
                continue;
            }
            let mut dims = self.count;
            dims[axis] += 1;
            for z in 0..dims[2] {
                for y in 0..dims[1] {
                    for x in 0..dims[0] {
                        let at = [x, y, z];
                        let mut sides = [0; 2];
                        for (side, end) in sides.iter_mut().enumerate() {
                            let mut place = at;
                            if side == 0 && at[axis] > 0 {
                                place[axis] -= 1;
                            } else if side == 0 || at[axis] == self.count[axis] {
                                *end = (self.census.cells + self.wall_face.len()) as u32;
                                self.wall_face.push((2 * axis + side) as u8);
                                self.wall_link.push(self.ends.len() as u32);
                                continue;
                            }
                            *end = self.cell(place) as u32;
                        }
                        let place = std::array::from_fn(|k| at[k].min(self.count[k] - 1));
                        self.area.push(self.volume(self.cell(place)) / self.size(self.cell(place))[axis]);
                        self.ends.push(sides);
                    }
                }
            }
        }
        self.axis_start[3] = self.ends.len();
    }

    /// Cuts every grain at the planes and half way between them, and adds the pieces up by cell and by link.
    fn share(&mut self, grains: &Grains, transfer: Transfer, flat: bool) {
        let halves: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            let planes = &self.planes[axis];
            let mut halves = Vec::with_capacity(2 * planes.len());
            for pair in planes.windows(2) {
                halves.extend([pair[0], 0.5 * (pair[0] + pair[1])]);
            }
            // The ends are walls: what reaches into a wall stays in the last half cell.
            halves.split_off(1)
        });
        let halves: [&[f64]; 3] =
            std::array::from_fn(|axis| if flat && axis == 1 { &[] } else { halves[axis].as_slice() });
        let all: Vec<usize> = (0..grains.len()).collect();
        let blocks: Vec<[Rows; 4]> = all
            .par_chunks(BLOCK)
            .map(|block| {
                let mut rows: [Rows; 4] = Default::default();
                let mut pieces = Pieces::default();
                for &k in block {
                    let centre = grains.position[k].to_array();
                    pieces.cut(transfer, grains.shape, centre, grains.radius[k], halves);
                    self.sort(&pieces, &mut rows);
                }
                rows
            })
            .collect();
        let mut shares: [Shares; 4] = Default::default();
        for (kind, shares) in shares.iter_mut().enumerate() {
            shares.starts.push(0);
            for rows in blocks.iter().map(|block| &block[kind]) {
                for &length in &rows.lengths {
                    shares.starts.push(shares.starts[shares.starts.len() - 1] + length);
                }
                shares.index.extend(&rows.index);
                shares.part.extend(&rows.part);
            }
        }
        let [x, y, z, cells] = shares;
        self.of_cells = cells.transposed(self.census.cells);
        self.in_cells = cells;
        self.in_links = [x, y, z];
        for axis in 0..3 {
            let links = self.axis_start[axis + 1] - self.axis_start[axis];
            let by_link = self.in_links[axis].transposed(links);
            let sums = by_link.sums();
            let shares = &mut self.in_links[axis];
            for (&link, part) in shares.index.iter().zip(&mut shares.part) {
                *part /= sums[link as usize];
            }
            self.of_links[axis] = shares.transposed(links);
        }
    }

    /// Adds the pieces of one grain to the rows of the links along x, y, z and of the cells.
    fn sort(&self, pieces: &Pieces, rows: &mut [Rows; 4]) {
        let starts: [usize; 4] = std::array::from_fn(|kind| rows[kind].index.len());
        let [nx, ny, _] = pieces.count;
        for (k, &volume) in pieces.volume.iter().enumerate() {
            if volume == 0.0 {
                continue;
            }
            let piece = [k % nx, k / nx % ny, k / nx / ny];
            let half: [usize; 3] = std::array::from_fn(|axis| pieces.first[axis] + piece[axis]);
            for kind in 0..4 {
                let (mut dims, mut at) = (self.count, half.map(|h| h / 2));
                if kind < 3 {
                    if self.links(kind).is_empty() {
                        continue;
                    }
                    dims[kind] += 1;
                    at[kind] = half[kind].div_ceil(2);
                }
                let index = ((at[2] * dims[1] + at[1]) * dims[0] + at[0]) as u32;
                let rows = &mut rows[kind];
                match rows.index[starts[kind]..].iter().position(|&i| i == index) {
                    Some(known) => rows.part[starts[kind] + known] += volume,
                    None => {
                        rows.index.push(index);
                        rows.part.push(volume);
                    }
                }
            }
        }
        for (kind, start) in starts.into_iter().enumerate() {
            let length = (rows[kind].index.len() - start) as u32;
            rows[kind].lengths.push(length);
        }
    }

    /// Porosity, mean diameter and mobility of every cell.
    fn fill(&mut self, grains: &Grains, plan: &Plan) {
        self.solid = self.of_cells.sums();
        let all: f64 = grains.volume();
        let surface: f64 = grains.radius.iter().map(|&r| grains.shape.volume(r) / (2.0 * r)).sum();
        for cell in 0..self.census.cells {
            let (mut count, mut per_diameter) = (0.0, 0.0);
            for (k, part) in self.of_cells.row(cell) {
                let radius = grains.radius[k];
                count += part / grains.shape.volume(radius);
                per_diameter += part / (2.0 * radius);
            }
            let (solid, volume) = (self.solid[cell], self.volume(cell));
            let empty = solid <= NO_SOLID * volume;
            self.census.empty += usize::from(empty);
            self.census.sparse += usize::from(!empty && count < FEW_GRAINS * (1.0 - 1e-9));
            let porosity = 1.0 - solid / volume;
            let bounded = porosity.clamp(POROSITY[0], POROSITY[1]);
            self.census.bounded += usize::from(!empty && bounded != porosity);
            // A cell without grains borrows the mean diameter of all.
            let diameter = if empty { all / surface } else { solid / per_diameter };
            self.porosity.push(bounded);
            self.diameter.push(diameter);
            let slowed = plan.slowed.get(cell).copied().unwrap_or(1.0);
            self.mobility.push(plan.permeability.of(bounded, diameter) * slowed / plan.viscosity);
        }
    }

    /// Two half cells one after the other.
    fn conduct(&mut self) {
        let cells = self.census.cells as u32;
        self.conductance = vec![0.0; self.ends.len()];
        for axis in 0..3 {
            for link in self.links(axis) {
                let resistance: f64 = self.ends[link]
                    .into_iter()
                    .filter(|&end| end < cells)
                    .map(|end| end as usize)
                    .map(|cell| 0.5 * self.size(cell)[axis] / self.mobility[cell][axis])
                    .sum();
                self.conductance[link] = self.area[link] / resistance;
            }
        }
    }

    /// Mean over the volume, least and greatest pressure of the cells [Pa].
    pub fn mean_least_greatest(&self, pressure: &[f64]) -> [f64; 3] {
        let (mut sum, mut volume) = (0.0, 0.0);
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for (cell, &p) in pressure[..self.census.cells].iter().enumerate() {
            sum += self.volume(cell) * p;
            volume += self.volume(cell);
            (least, greatest) = (least.min(p), greatest.max(p));
        }
        [sum / volume, least, greatest]
    }

    /// Mean pressure at 13 heights between the two ends of an axis [Pa]: of the wall faces, and of the cells of a
    /// layer, with straight lines between their centres. `pressure` has one entry per node.
    pub fn profile(&self, pressure: &[f64], axis: usize) -> [f64; 13] {
        let layers = self.count[axis];
        let (mut sum, mut weight) = (vec![0.0; layers + 2], vec![0.0; layers + 2]);
        for (cell, p) in pressure[..self.census.cells].iter().enumerate() {
            let (layer, area) = (self.place(cell)[axis] + 1, self.volume(cell) / self.size(cell)[axis]);
            sum[layer] += area * p;
            weight[layer] += area;
        }
        for (w, p) in pressure[self.census.cells..].iter().enumerate() {
            let face = self.wall_face[w] as usize;
            if face / 2 == axis {
                let layer = if face.is_multiple_of(2) { 0 } else { layers + 1 };
                sum[layer] += self.area[self.wall_link[w] as usize] * p;
                weight[layer] += self.area[self.wall_link[w] as usize];
            }
        }
        let planes = &self.planes[axis];
        let mut heights = vec![planes[0]];
        heights.extend(planes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])));
        heights.push(planes[layers]);
        let mean: Vec<f64> = sum.iter().zip(&weight).map(|(s, w)| s / w).collect();
        std::array::from_fn(|k| {
            let at = planes[0] + (planes[layers] - planes[0]) * k as f64 / 12.0;
            let next = heights.partition_point(|&z| z <= at).clamp(1, layers + 1);
            let part = (at - heights[next - 1]) / (heights[next] - heights[next - 1]);
            mean[next - 1] + (mean[next] - mean[next - 1]) * part
        })
    }
}

/// Rows being written.
#[derive(Default)]
struct Rows {
    lengths: Vec<u32>,
    index: Vec<u32>,
    part: Vec<f64>,
}
