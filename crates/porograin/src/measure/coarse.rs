//! Pressure and velocity of coarse water at any place.
//!
//! The grid knows the pressure of every cell and, as two half cells conduct one after the other, of every face between them:
//! `p_f = (m_i p_i + m_j p_j)/(m_i + m_j)`, `m = M/V`, M the mobility of a cell and V its volume; faces at walls have nodes
//! of their own. Edges and corners of cells get the same mean of the cells around, at a wall of its nodes around; where walls
//! meet, of what is linear in each cell, `p_c + sum over its walls there of (p_w - p_c)`. Between the centre of a cell, three of its faces, the
//! edges and the corner where they meet the pressure is trilinear. So it is continuous, exact where it varies linearly in cells
//! that conduct alike, walls and corners included, and exact for a flow through layers that conduct differently.
//!
//! Through every face go the grains around it, v, and past them the water, `w = g (p_i - p_j)/A`. Both are linear between opposite
//! faces of a cell (the lowest space of Raviart and Thomas 1977), so that the divergence of `v + w` is the same all over the cell, that of its
//! balance, and no water appears at a face. The velocity of the water, the mean over the void as in the pores, is `u = v + w/n`.

use super::sensor::beyond_walls;
use crate::darcy::passes::{Moving, Pull};
use crate::darcy::{Grid, GridState};
use crate::grains::Grains;
use glam::DVec3;
use porograin_geometry::Cell;

/// The water of a grid with its grains as they move now.
#[derive(Clone, Debug)]
pub struct CoarseFlow<'a> {
    grid: &'a Grid,
    /// Of each cell and wall face [Pa].
    pressure: &'a [f64],
    /// Darcy's flux through the face of each link, along its axis [m/s].
    seepage: Vec<f64>,
    /// Mean velocity of the grains around the face of each link, along its axis [m/s].
    solid: Vec<f64>,
    /// The box when the grid was made, and now.
    cells: [Cell; 2],
}

/// The water at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoarseFound {
    /// Excess pressure [Pa].
    pub pressure: f64,
    /// Velocity of the water in the void [m/s].
    pub velocity: DVec3,
    /// Flux of the water past the grains, per area of the sample [m/s].
    pub seepage: DVec3,
}

/// Where a place is along one axis of its cell.
#[derive(Clone, Copy)]
struct Along {
    /// The cell, and its neighbour beyond the nearer face: none at a wall.
    cell: usize,
    beyond: Option<usize>,
    /// From the low face, 0, to the high one, 1.
    part: f64,
    /// Of the nearer face: 0 low, 1 high.
    side: usize,
}

impl<'a> CoarseFlow<'a> {
    /// Of the state's water on its grid, its grains and its box now.
    pub fn new(grid: &'a Grid, water: &'a GridState, grains: &Grains, now: &Cell) -> CoarseFlow<'a> {
        let (links, pressure) = (grid.ends.len(), &water.pressure);
        let (force, pulled) = (vec![DVec3::ZERO; grains.len()], vec![Pull::default(); grains.len()]);
        let moving = Moving { velocity: &grains.velocity, mass: &grains.mass, kick: 0.0 };
        let (mut value, mut carried) = (Vec::new(), Vec::new());
        grid.corners.sums(&moving.under(&force, &pulled), &mut value, &mut carried);
        let (mut seepage, mut solid) = (vec![0.0; links], vec![0.0; links]);
        for axis in 0..3 {
            let across = grid.across(axis);
            grid.each_link(axis, |link, corner| {
                let ends = grid.ends[link].map(|end| end as usize);
                let sum: f64 = across.iter().map(|step| carried[corner + step][axis]).sum();
                solid[link] = grid.hold[link] / grid.area[link] * sum;
                let [low, high] = ends.map(|end| pressure[end]);
                seepage[link] = grid.conductance[link] / grid.area[link] * (low - high);
            });
        }
        CoarseFlow { grid, pressure, seepage, solid, cells: [water.grid_cell, *now] }
    }

    /// The water at `x` [m], which may lie in a grain; `None` beyond a wall. Beyond a grid that ends with the grains the water is clear:
    /// it has the pressure and the flux of the end of the grid.
    pub fn at(&self, x: DVec3) -> Option<CoarseFound> {
        let [then, now] = &self.cells;
        if beyond_walls(now, x) {
            return None;
        }
        // The planes stay where the walls were when the grains were distributed.
        let x = then.origin + (x - now.origin) * ((then.upper() - then.origin) / (now.upper() - now.origin));
        let mut clear = false;
        let along: [Along; 3] = std::array::from_fn(|axis| {
            let planes = &self.grid.planes[axis];
            let last = planes.len() - 2;
            let cell = (planes.partition_point(|&plane| plane <= x[axis])).saturating_sub(1).min(last);
            let part = (x[axis] - planes[cell]) / (planes[cell + 1] - planes[cell]);
            clear |= !(-1e-6..=1.0 + 1e-6).contains(&part);
            let part = part.clamp(0.0, 1.0);
            let side = usize::from(part >= 0.5);
            let beyond = if side == 0 { cell.checked_sub(1) } else { (cell < last).then_some(cell + 1) };
            Along { cell, beyond, part, side }
        });
        let place = along.map(|a| a.cell);
        let mix = |of: &[f64]| {
            DVec3::from_array(std::array::from_fn(|axis| {
                let [low, high] =
                    [0, 1].map(|side| self.grid.link(axis, place, side).map_or(0.0, |link| of[link]));
                low + along[axis].part * (high - low)
            }))
        };
        let (seepage, solid) = (mix(&self.seepage), mix(&self.solid));
        let void = if clear { 1.0 } else { self.void(self.grid.cell(place)) };
        Some(CoarseFound { pressure: self.pressure_in(&along), velocity: solid + seepage / void, seepage })
    }

    /// Velocity of the water in the middle of each cell [m/s].
    pub fn in_cells(&self) -> Vec<DVec3> {
        let of = |cell: usize| {
            let [solid, seepage] = [&self.solid, &self.seepage].map(|of| self.middle(cell, of));
            solid + seepage / self.void(cell)
        };
        (0..self.grid.census.cells).map(of).collect()
    }

    /// Flux of the water past the grains per area of the sample [m/s].
    pub fn discharge(&self) -> DVec3 {
        let cells = 0..self.grid.census.cells;
        let (sum, volume) = cells.fold((DVec3::ZERO, 0.0), |(sum, all), cell| {
            let volume = self.grid.volume(cell);
            (sum + volume * self.middle(cell, &self.seepage), all + volume)
        });
        sum / volume
    }

    /// The mean of opposite faces of a cell.
    fn middle(&self, cell: usize, of: &[f64]) -> DVec3 {
        let place = self.grid.place(cell);
        DVec3::from_array(std::array::from_fn(|axis| {
            let side = |side: usize| self.grid.link(axis, place, side).map_or(0.0, |link| of[link]);
            0.5 * (side(0) + side(1))
        }))
    }

    /// The void part of a cell; that of one without grains is all of it.
    fn void(&self, cell: usize) -> f64 {
        self.grid.porosity[cell].max(1.0 - self.grid.solid[cell] / self.grid.volume(cell))
    }

    /// Trilinear between the centre of a cell and the faces, edges and corner of it that are nearest.
    fn pressure_in(&self, along: &[Along; 3]) -> f64 {
        let outwards = along.map(|a| (2.0 * a.part - 1.0).abs());
        let weight = |faces: usize| -> f64 {
            let part =
                |axis: usize| if faces >> axis & 1 == 1 { outwards[axis] } else { 1.0 - outwards[axis] };
            (0..3).map(part).product()
        };
        (0..8).map(|faces| weight(faces) * self.where_faces_meet(along, faces)).sum()
    }

    /// The pressure where faces across these axes (bits) meet: the mean over the cells around.
    fn where_faces_meet(&self, along: &[Along; 3], faces: usize) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for beyond in (0..8).filter(|beyond| beyond & !faces == 0) {
            let place = |axis: usize| match beyond >> axis & 1 {
                0 => Some(along[axis].cell),
                _ => along[axis].beyond,
            };
            let (Some(x), Some(y), Some(z)) = (place(0), place(1), place(2)) else { continue };
            let cell = self.grid.cell([x, y, z]);
            let (middle, mut pressure) = (self.pressure[cell], self.pressure[cell]);
            for axis in (0..3).filter(|&axis| faces >> axis & 1 == 1 && along[axis].beyond.is_none()) {
                let side = along[axis].side;
                let wall = self.grid.link(axis, [x, y, z], side).map(|link| self.grid.ends[link][side]);
                pressure += wall.map_or(0.0, |node| self.pressure[node as usize] - middle);
            }
            // Where permeabilities along the axes differ, they do so alike in all cells.
            let conducts = self.grid.mobility[cell].x / self.grid.volume(cell);
            sum += conducts * pressure;
            weight += conducts;
        }
        sum / weight
    }
}
