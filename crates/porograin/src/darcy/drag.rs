//! The drag on grains that move against the mean of their cell.

use super::grid::Grid;
use glam::DVec3;
use rayon::prelude::*;

/// How each cell holds the grains in it. The forces of a cell sum to zero.
///
/// A grain that moves at `v_p` in a cell whose grains move at `v_s` feels `beta/(1 - n) V_p (v_s - v_p)` beside its share of
/// the pressure gradient, `beta = n²/M` with the mobility M of the cell (Goodarzi 8-9). It is taken at the end of the
/// kick, `beta -> beta/(1 + kick beta/((1 - n) rho))`, and so sets no limit to the time step.
#[derive(Clone, Debug, Default)]
pub struct Resistance {
    /// Mean velocity of the grains [m/s] and resistance per volume of grain [kg/(m³ s)] of each cell.
    cells: Vec<[DVec3; 2]>,
}

impl Resistance {
    /// Takes the mean velocity of every cell. Each sums its grains in rising order, gathered or scattered.
    pub fn feel(&mut self, grid: &Grid, velocity: &[DVec3], kick: f64) {
        self.cells.clear();
        self.cells.resize(grid.census.cells, [DVec3::ZERO; 2]);
        if rayon::current_num_threads() == 1 {
            for (k, &v) in velocity.iter().enumerate() {
                grid.in_cells.row(k).for_each(|(cell, part)| self.cells[cell][0] += part * v);
            }
        } else {
            self.cells.par_iter_mut().with_min_len(64).enumerate().for_each(|(cell, [sum, _])| {
                *sum = grid.of_cells.row(cell).fold(DVec3::ZERO, |sum, (k, part)| sum + part * velocity[k]);
            });
        }
        for (cell, [mean, resistance]) in self.cells.iter_mut().enumerate() {
            let solid = grid.solid[cell];
            if solid > 0.0 {
                let n = grid.porosity[cell];
                let viscous = n * n / (1.0 - n) / grid.mobility[cell];
                (*mean, *resistance) = (*mean / solid, viscous / (1.0 + kick / grid.density * viscous));
            }
        }
    }

    /// The force on grain `k` at a velocity [N].
    pub fn on(&self, grid: &Grid, k: usize, velocity: DVec3) -> DVec3 {
        let parts = grid.in_cells.row(k);
        parts.map(|(cell, part)| part * self.cells[cell][1] * (self.cells[cell][0] - velocity)).sum()
    }
}
