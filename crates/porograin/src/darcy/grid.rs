//! The grid: cells between planes, links between them, and which part of each grain belongs to which.
//!
//! A link joins two cells across the face between them, or a cell and a wall. It carries water, `g (p_i - p_j)`, and the
//! solid that moves through its face, `A v`, v the mean velocity of the grains around its four corners (from centre to centre;
//! at a wall from centre to wall), each weighted by its volume there. The force of the link, `A (p_i - p_j)`, goes to
//! the same grains with the same weights: the two are transposes of each other, so pressures do no more work
//! than they take from the motion, and the forces on grains and walls sum to the resultant of the pressures at the faces.

use super::corners::Corners;
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
    /// The links along each axis, run by run.
    pub runs: [Vec<Run>; 3],
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
    /// `A` of each link over the volume of the grains around its corners, or the least volume there may be [1/m].
    pub hold: Vec<f64>,
    /// Which part of each grain is around which corner.
    pub corners: Corners,
    /// Resistance to motion against the other grains around each corner, per volume of grain [kg/(m³ s)].
    pub resistance: Vec<f64>,
    /// What was found.
    pub census: Census,
}

/// Links one after the other whose ends and corners are so as well.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// The first link.
    pub link: usize,
    /// The lowest corner of the first link; [`Grid::across`] leads from there to all four.
    pub corner: usize,
    /// The two nodes of the first link.
    pub ends: [usize; 2],
    /// How many links.
    pub len: usize,
}

impl Run {
    /// Joins the next link, if it is one of these.
    fn take(&mut self, next: Run) -> bool {
        let place = |run: &Run| [run.link, run.corner, run.ends[0], run.ends[1]];
        let fits = place(self).map(|at| at + self.len) == place(&next);
        self.len += usize::from(fits);
        fits
    }
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
            runs: Default::default(),
            axis_start: [0; 4],
            area: Vec::new(),
            conductance: Vec::new(),
            wall_face: Vec::new(),
            wall_link: Vec::new(),
            hold: Vec::new(),
            corners: Corners::new(grains, plan.transfer, planes),
            resistance: Vec::new(),
            census: Census { cells, ..Census::default() },
        };
        grid.join(flat);
        grid.fill(grains, plan);
        grid.conduct();
        grid.attach();
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

    /// The link through the low (0) or the high (1) face across an axis of the cell at a place; discs have none along y.
    pub fn link(&self, axis: usize, mut place: [usize; 3], side: usize) -> Option<usize> {
        let mut count = self.count;
        count[axis] += 1;
        place[axis] += side;
        let link = (place[2] * count[1] + place[1]) * count[0] + place[0];
        (!self.links(axis).is_empty()).then_some(self.axis_start[axis] + link)
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
                        let stride = self.corners.stride;
                        let next = Run {
                            link: self.ends.len(),
                            corner: (0..3).map(|k| at[k] * stride[k]).sum(),
                            ends: sides.map(|end| end as usize),
                            len: 1,
                        };
                        if !self.runs[axis].last_mut().is_some_and(|run| run.take(next)) {
                            self.runs[axis].push(next);
                        }
                        self.ends.push(sides);
                    }
                }
            }
        }
        self.axis_start[3] = self.ends.len();
    }

    /// Calls `each(link, corner)` for the links along an axis, with the lowest of the corners of each; from there
    /// [`Grid::across`] leads to all four.
    pub fn each_link(&self, axis: usize, mut each: impl FnMut(usize, usize)) {
        for run in &self.runs[axis] {
            (0..run.len).for_each(|k| each(run.link + k, run.corner + k));
        }
    }

    /// Adds to each cell what flows into it along the links, less what flows out.
    pub fn gather(&self, flux: &[f64], sum: &mut [f64]) {
        let [nx, ny, nz] = self.count;
        for axis in (0..3).filter(|&axis| !self.links(axis).is_empty()) {
            let mut dims = self.count;
            dims[axis] += 1;
            let step = [1, dims[0], dims[0] * dims[1]][axis];
            for row in 0..ny * nz {
                let link = self.axis_start[axis] + (row / ny * dims[1] + row % ny) * dims[0];
                let (flux_in, flux_out) = (&flux[link..][..nx], &flux[link + step..][..nx]);
                for ((sum, flux_in), flux_out) in sum[row * nx..][..nx].iter_mut().zip(flux_in).zip(flux_out)
                {
                    *sum += flux_in - flux_out;
                }
            }
        }
    }

    /// From the lowest corner of a link along an axis to all four; discs have each twice.
    pub fn across(&self, axis: usize) -> [usize; 4] {
        let (a, b) = (self.corners.stride[(axis + 1) % 3], self.corners.stride[(axis + 2) % 3]);
        [0, a, b, a + b]
    }

    /// Volume of the region around each corner [m³].
    fn around_corners(&self) -> Vec<f64> {
        let reach: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            let planes = &self.planes[axis];
            if self.corners.stride[axis] == 0 {
                return vec![planes[planes.len() - 1] - planes[0]];
            }
            let centre = |cell: usize| 0.5 * (planes[cell] + planes[cell + 1]);
            let last = planes.len() - 1;
            (0..=last)
                .map(|k| {
                    let low = if k > 0 { centre(k - 1) } else { planes[0] };
                    let high = if k < last { centre(k) } else { planes[last] };
                    high - low
                })
                .collect()
        });
        let [x, y, z] = &reach;
        let rows = z.iter().flat_map(|c| y.iter().map(move |b| b * c));
        rows.flat_map(|bc| x.iter().map(move |a| a * bc)).collect()
    }

    /// How links take hold of the grains around their corners, and what resists there. Where there are hardly any, the void that the
    /// porosity lacks is taken to be held by something at rest: else a sliver of a grain would bear what presses on a whole face.
    fn attach(&mut self) {
        let mut hold = vec![0.0; self.ends.len()];
        let around = self.around_corners();
        for axis in 0..3 {
            let across = self.across(axis);
            self.each_link(axis, |link, corner| {
                let sum = |of: &[f64]| across.iter().map(|step| of[corner + step]).sum::<f64>();
                hold[link] =
                    self.area[link] / sum(&self.corners.solid).max((1.0 - POROSITY[1]) * sum(&around));
            });
        }
        self.hold = hold;
        let (mut sum, mut cells) = (vec![0.0; self.corners.len()], vec![0.0; self.corners.len()]);
        let stride = self.corners.stride;
        for cell in (0..self.census.cells).filter(|&cell| self.solid[cell] > 0.0) {
            let place = self.place(cell);
            let n = self.porosity[cell];
            let viscous = n * n / (1.0 - n) / self.mobility[cell].element_product().cbrt();
            for c in 0..8 {
                let at = [place[0] + (c & 1), place[1] + (c >> 1 & 1), place[2] + (c >> 2)];
                let corner = at[0] * stride[0] + at[1] * stride[1] + at[2] * stride[2];
                sum[corner] += viscous;
                cells[corner] += 1.0;
            }
        }
        self.resistance =
            sum.iter().zip(&cells).map(|(sum, cells)| if *cells > 0.0 { sum / cells } else { 0.0 }).collect();
    }

    /// Cuts every grain at the planes: for each piece its cell, its grain and its volume [m³], grain by grain.
    fn pieces(&self, grains: &Grains, transfer: Transfer) -> Vec<(u32, u32, f64)> {
        let flat = matches!(grains.shape, Shape::Disc { .. });
        // The ends are walls: what reaches into a wall stays in the last cell.
        let inner: [&[f64]; 3] = std::array::from_fn(|axis| {
            let planes = self.planes[axis].as_slice();
            if flat && axis == 1 { &[] } else { &planes[1..planes.len() - 1] }
        });
        (0..grains.len())
            .into_par_iter()
            .with_min_len(BLOCK)
            .map_init(Pieces::default, |pieces, k| {
                pieces.cut(transfer, grains.shape, grains.position[k].to_array(), grains.radius[k], inner);
                let [nx, ny, _] = pieces.count;
                let first = pieces.first;
                let parts = pieces.volume.iter().enumerate().filter(|(_, volume)| **volume != 0.0);
                parts
                    .map(|(i, &volume)| {
                        let piece = [i % nx, i / nx % ny, i / nx / ny];
                        let cell = self.cell(std::array::from_fn(|axis| first[axis] + piece[axis]));
                        (cell as u32, k as u32, volume)
                    })
                    .collect::<Vec<_>>()
            })
            .flatten_iter()
            .collect()
    }

    /// Porosity, mean diameter and mobility of every cell.
    fn fill(&mut self, grains: &Grains, plan: &Plan) {
        let cells = self.census.cells;
        // Volume, number and volume over diameter of the grains in each cell.
        let mut sums = vec![[0.0; 3]; cells];
        for (cell, k, part) in self.pieces(grains, plan.transfer) {
            let radius = grains.radius[k as usize];
            let [solid, count, per_diameter] = &mut sums[cell as usize];
            *solid += part;
            *count += part / grains.shape.volume(radius);
            *per_diameter += part / (2.0 * radius);
        }
        self.solid = sums.iter().map(|[solid, ..]| *solid).collect();
        let all: f64 = grains.volume();
        let surface: f64 = grains.radius.iter().map(|&r| grains.shape.volume(r) / (2.0 * r)).sum();
        for (cell, &[_, count, per_diameter]) in sums.iter().enumerate() {
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
