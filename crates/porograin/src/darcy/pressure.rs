//! The pressures: water in each cell is stored, carried by the grains, or flows, all at the end of the step.
//!
//! With `v⁺ = v* + k M⁻¹ S p⁺`, v* what all other forces make of the velocities and k the length of the kick, the balance
//! of every cell is `(G + C/dt + k B) (p⁺ - p) = Q - Sᵀ (v* + k M⁻¹ S p) - G p`: generation by the volumetric strain
//! and dissipation (Goodarzi 3-7) in one backward Euler step with `C = n V/K_f`. `B = Sᵀ M⁻¹ S` makes the drag implicit, so
//! that the water sets no limit to the time step; it is replaced by the sum of each of its rows, link by link, which
//! keeps the pattern of the grid, is exact for a uniform gradient, and touches nothing but the change of pressure
//! within the step.
//!
//! The node of a wall has one link only and is eliminated.

use super::grid::Grid;
use crate::grains::Grains;
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_linear::{Error, FIXED, Info, Matrix, Params, Solver};
use rayon::prelude::*;

/// What a system is made for, besides its grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms {
    /// By how much a force changes velocities, times mass [s].
    pub kick: f64,
    /// Over which the water is stored [s].
    pub interval: f64,
    /// Bulk modulus of the water [Pa]; `None`: incompressible.
    pub bulk_modulus: Option<f64>,
    /// Whether the pressure is imposed at each face.
    pub open: [bool; 6],
    /// Mass of each wall that is a piston [kg].
    pub pistons: [Option<f64>; 6],
    /// Relative residual of the solve.
    pub residual: f64,
}

/// What comes from outside in one step.
pub struct Outside<'a> {
    /// Velocity of each grain before the water's force changes [m/s].
    pub velocity: &'a [DVec3],
    /// The same of each wall.
    pub wall_velocity: [DVec3; 6],
    /// By wall node: the pressure where it is imposed [Pa], elsewhere the inflow per area [m/s].
    pub imposed: &'a [f64],
}

/// What a step did to the water.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flows {
    /// Water that leaves through each face [m³/s].
    pub outflow: [f64; 6],
    /// Water stored by compression [m³/s].
    pub stored: f64,
    /// Volume the walls sweep, outwards [m³/s]: minus the sum of all outflows and of what is stored.
    pub swept: f64,
}

/// The linear system of a grid.
pub struct System {
    /// What it was made for.
    pub terms: Terms,
    matrix: Matrix,
    solver: Solver,
    /// Storage of each cell over the interval [m³/(Pa s)].
    storage: Vec<f64>,
    /// `g + k B` of each link [m³/(Pa s)].
    stiffened: Vec<f64>,
    /// What a piston gives at each wall node [m³/(Pa s)].
    give: Vec<f64>,
    /// Nothing holds the level of the pressure: the first cell does not change in the solve, then the mean stays.
    level_is_free: bool,
    rhs: Vec<f64>,
    change: Vec<f64>,
    flux: Vec<f64>,
}

impl System {
    /// Assembles and prepares the solve.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn new(grid: &Grid, grains: &Grains, terms: Terms) -> Result<System, Error> {
        let cells = grid.census.cells;
        let storage: Vec<f64> = (0..cells)
            .map(|cell| {
                let compliance = terms.bulk_modulus.map_or(0.0, |modulus| grid.porosity[cell] / modulus);
                compliance * grid.volume(cell) / terms.interval
            })
            .collect();
        let mut stiffened = grid.conductance.clone();
        if terms.kick > 0.0 {
            add_inertia(grid, grains, terms.kick, &mut stiffened);
        }
        let mut swept = [0.0; 6];
        for (w, &face) in grid.wall_face.iter().enumerate() {
            swept[face as usize] += grid.area[grid.wall_link[w] as usize];
        }
        let give: Vec<f64> = (grid.wall_face.iter().zip(&grid.wall_link))
            .map(|(&face, &link)| {
                let face = face as usize;
                let piston = terms.pistons[face].filter(|_| !terms.open[face]);
                piston.map_or(0.0, |mass| terms.kick * grid.area[link as usize] * swept[face] / mass)
            })
            .collect();
        let mut extra = storage.clone();
        for (w, &link) in grid.wall_link.iter().enumerate() {
            let g = stiffened[link as usize];
            let held = if terms.open[grid.wall_face[w] as usize] { g } else { g * give[w] / (g + give[w]) };
            extra[inner(grid, link as usize)] += held;
        }
        let level_is_free = extra.iter().all(|&e| e == 0.0);
        let shift = u32::from(level_is_free);
        let unknown = |node: u32| if node < shift { FIXED } else { node - shift };
        let mut ends = Vec::with_capacity(grid.ends.len());
        let mut conductance = Vec::with_capacity(grid.ends.len());
        for (&[low, high], &g) in grid.ends.iter().zip(&stiffened) {
            if (low as usize) < cells && (high as usize) < cells {
                ends.push([unknown(low), unknown(high)]);
                conductance.push(g);
            }
        }
        let first = shift as usize;
        let matrix = Matrix::new(cells - first, &ends, &conductance, &extra[first..])?;
        let centres: Vec<DVec3> = (first..cells).map(|cell| grid.centre(cell)).collect();
        let params =
            Params { tolerance: terms.residual, expected_solves: EXPECTED_SOLVES, ..Params::default() };
        let solver = Solver::new(&matrix, &params, Some(&centres))?;
        Ok(System {
            terms,
            matrix,
            solver,
            storage,
            stiffened,
            give,
            level_is_free,
            rhs: vec![0.0; cells],
            change: vec![0.0; cells],
            flux: vec![0.0; grid.ends.len()],
        })
    }

    /// Takes the pressures of all nodes [Pa] one step further.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn advance(
        &mut self,
        grid: &Grid,
        outside: &Outside,
        pressure: &mut [f64],
    ) -> Result<(Info, Flows), Error> {
        let cells = grid.census.cells;
        carried(grid, outside.velocity, &mut self.flux);
        self.rhs.fill(0.0);
        for ((&[low, high], &g), flux) in grid.ends.iter().zip(&grid.conductance).zip(&mut self.flux) {
            *flux += g * (pressure[low as usize] - pressure[high as usize]);
            for (end, sign) in [(low as usize, -1.0), (high as usize, 1.0)] {
                if end < cells {
                    self.rhs[end] += sign * *flux;
                }
            }
        }
        // What a wall node cannot keep goes to its cell; what a held one changes by drags its cell along.
        for (w, &link) in grid.wall_link.iter().enumerate() {
            let (link, face) = (link as usize, grid.wall_face[w] as usize);
            let (g, give) = (self.stiffened[link], self.give[w]);
            let cell = inner(grid, link);
            if self.terms.open[face] {
                self.rhs[cell] += g * (outside.imposed[w] - pressure[cells + w]);
            } else {
                self.rhs[cell] += g / (g + give) * self.wall_excess(grid, outside, w);
            }
        }
        let first = usize::from(self.level_is_free);
        self.change.fill(0.0);
        let info = if cells > first {
            self.solver.solve(&self.matrix, &self.rhs[first..], &mut self.change[first..])?
        } else {
            Info { method: porograin_linear::Method::Cholesky, iterations: 0, residual: 0.0 }
        };
        if self.level_is_free {
            let volume: f64 = (0..cells).map(|cell| grid.volume(cell)).sum();
            let sum: f64 = self.change.iter().enumerate().map(|(cell, d)| d * grid.volume(cell)).sum();
            self.change.iter_mut().for_each(|d| *d -= sum / volume);
        }
        Ok((info, self.finish(grid, outside, pressure)))
    }

    /// Net flux into wall node `w` from outside and from its link, before pressures change [m³/s].
    fn wall_excess(&self, grid: &Grid, outside: &Outside, w: usize) -> f64 {
        let (link, face) = (grid.wall_link[w] as usize, grid.wall_face[w] as usize);
        let inwards = -outside.wall_velocity[face].dot(NORMALS[face]);
        let from_link = if face.is_multiple_of(2) { -self.flux[link] } else { self.flux[link] };
        grid.area[link] * (outside.imposed[w] + inwards) + from_link
    }

    /// Changes the pressures and sums up the flows.
    fn finish(&mut self, grid: &Grid, outside: &Outside, pressure: &mut [f64]) -> Flows {
        let cells = grid.census.cells;
        let mut flows = Flows::default();
        for (cell, (&change, &storage)) in self.change.iter().zip(&self.storage).enumerate() {
            pressure[cell] += change;
            flows.stored += storage * change;
        }
        for (w, &link) in grid.wall_link.iter().enumerate() {
            let (link, face) = (link as usize, grid.wall_face[w] as usize);
            let (g, give) = (self.stiffened[link], self.give[w]);
            let outwards = outside.wall_velocity[face].dot(NORMALS[face]);
            let of_cell = self.change[inner(grid, link)];
            let area = grid.area[link];
            if self.terms.open[face] {
                let change = outside.imposed[w] - pressure[cells + w];
                let along = if face.is_multiple_of(2) { -self.flux[link] } else { self.flux[link] };
                flows.outflow[face] += along + g * (of_cell - change) - area * outwards;
                flows.swept += area * outwards;
                pressure[cells + w] = outside.imposed[w];
            } else {
                let change = (self.wall_excess(grid, outside, w) + g * of_cell) / (g + give);
                pressure[cells + w] += change;
                flows.outflow[face] -= area * outside.imposed[w];
                // A piston gives way to the change of pressure.
                flows.swept += area * outwards + give * change;
            }
        }
        flows
    }
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("System").field("terms", &self.terms).finish_non_exhaustive()
    }
}

/// A grid near rest serves this many steps at least.
const EXPECTED_SOLVES: usize = 1000;

/// The cell at the inner end of a wall's link.
fn inner(grid: &Grid, link: usize) -> usize {
    let [low, high] = grid.ends[link];
    low.min(high) as usize
}

/// `Sᵀ v`: the volume of solid and water together that moving grains carry along each link [m³/s].
///
/// Each link sums its grains in rising order, whether they are gathered (threads) or scattered (one thread).
fn carried(grid: &Grid, velocity: &[DVec3], out: &mut [f64]) {
    if rayon::current_num_threads() == 1 {
        out.fill(0.0);
        for axis in 0..3 {
            let out = &mut out[grid.links(axis)];
            if !out.is_empty() {
                for (k, v) in velocity.iter().enumerate() {
                    let along = v[axis];
                    for (link, weight) in grid.in_links[axis].row(k) {
                        out[link] += weight * along;
                    }
                }
            }
        }
        out.iter_mut().zip(&grid.area).for_each(|(out, area)| *out *= area);
        return;
    }
    for axis in 0..3 {
        let (links, shares) = (grid.links(axis), &grid.of_links[axis]);
        let area = &grid.area[links.clone()];
        out[links].par_iter_mut().with_min_len(256).enumerate().for_each(|(link, out)| {
            let mean = shares.row(link).fold(0.0, |sum, (k, weight)| sum + weight * velocity[k][axis]);
            *out = mean * area[link];
        });
    }
}

/// `S p`: the force of the pressures [Pa] on each grain [N].
pub fn force(grid: &Grid, pressure: &[f64], force: &mut [DVec3]) {
    let pull: Vec<f64> = (grid.ends.iter().zip(&grid.area))
        .map(|(&[low, high], area)| area * (pressure[low as usize] - pressure[high as usize]))
        .collect();
    let pull: [&[f64]; 3] = std::array::from_fn(|axis| &pull[grid.links(axis)]);
    force.par_iter_mut().with_min_len(1024).enumerate().for_each(|(k, force)| {
        *force = DVec3::from_array(std::array::from_fn(|axis| {
            if pull[axis].is_empty() {
                return 0.0;
            }
            grid.in_links[axis].row(k).fold(0.0, |sum, (link, weight)| sum + weight * pull[axis][link])
        }));
    });
}

/// Force of the pressures [Pa] on each wall [N]; at an open face the water outside pushes back.
pub fn wall_force(grid: &Grid, pressure: &[f64], open: &[bool; 6]) -> [DVec3; 6] {
    let mut force = [DVec3::ZERO; 6];
    for (w, &face) in grid.wall_face.iter().enumerate() {
        let face = face as usize;
        if !open[face] {
            let area = grid.area[grid.wall_link[w] as usize];
            force[face] += area * pressure[grid.census.cells + w] * NORMALS[face];
        }
    }
    force
}

/// Adds `k` times the row sums of `Sᵀ M⁻¹ S` over the links along each axis.
fn add_inertia(grid: &Grid, grains: &Grains, kick: f64, conductance: &mut [f64]) {
    for axis in 0..3 {
        let links = grid.links(axis);
        let area = &grid.area[links.clone()];
        if links.is_empty() {
            continue;
        }
        let mobility: Vec<f64> = (0..grains.len())
            .map(|k| grid.in_links[axis].row(k).map(|(link, w)| w * area[link]).sum::<f64>() / grains.mass[k])
            .collect();
        for (link, g) in conductance[links].iter_mut().enumerate() {
            let mean: f64 = grid.of_links[axis].row(link).map(|(k, weight)| weight * mobility[k]).sum();
            *g += kick * area[link] * mean;
        }
    }
}
