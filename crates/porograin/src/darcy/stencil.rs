//! The system of the pressures as a product: every cell and its six neighbours, each at one distance in memory.

use super::grid::Grid;
use porograin_linear::Operator;
use rayon::prelude::*;

/// Cells handed to a thread at once.
const BLOCK: usize = 4096;

/// `A x` for the cells of a grid.
pub struct Stencil {
    /// Cells that are not unknowns, before all others: none, or the first.
    first: usize,
    /// What leads from a cell to the next along each axis.
    stride: [usize; 3],
    /// Of each cell.
    diagonal: Vec<f64>,
    /// What links each cell to the one before along each axis, 0 if nothing does; as many zeros as the stride at the end.
    before: [Vec<f64>; 3],
    /// The unknowns between zeros.
    x: Vec<f64>,
}

impl Stencil {
    /// Of links `g` [m³/(Pa s)] between the cells, and `excess`, what each row sums to. The first cell is held where it is if
    /// `first` is 1.
    pub fn new(grid: &Grid, g: &[f64], excess: &[f64], first: usize) -> Stencil {
        let ([nx, ny, _], cells) = (grid.count, grid.census.cells);
        let stride = [1, nx, nx * ny];
        let mut before = stride.map(|stride| vec![0.0; cells + stride]);
        let mut diagonal = excess.to_vec();
        for (axis, before) in before.iter_mut().enumerate() {
            for link in grid.links(axis) {
                let [low, high] = grid.ends[link].map(|end| end as usize);
                if low < cells && high < cells {
                    diagonal[low] += g[link];
                    diagonal[high] += g[link];
                    before[high] = if low < first { 0.0 } else { g[link] };
                }
            }
        }
        Stencil { first, stride, diagonal, before, x: vec![0.0; cells + 2 * stride[2]] }
    }
}

impl Operator for Stencil {
    fn nodes(&self) -> usize {
        self.diagonal.len() - self.first
    }

    fn apply(&mut self, x: &[f64], y: &mut [f64]) {
        let Stencil { first, stride, diagonal, before, x: between, .. } = self;
        let pad = stride[2];
        between[pad + *first..][..x.len()].copy_from_slice(x);
        let [one, row, layer] = *stride;
        y.par_chunks_mut(BLOCK).enumerate().for_each(|(block, y)| {
            let (n, start) = (y.len(), *first + block * BLOCK);
            let at = |place: usize| &between[place..][..n];
            let link = |axis: usize, place: usize| &before[axis][place..][..n];
            let (own, x) = (&diagonal[start..][..n], at(pad + start));
            let (left, right) = (at(pad + start - one), at(pad + start + one));
            let (front, back) = (at(pad + start - row), at(pad + start + row));
            let (below, above) = (at(pad + start - layer), at(pad + start + layer));
            let (to_left, to_right) = (link(0, start), link(0, start + one));
            let (to_front, to_back) = (link(1, start), link(1, start + row));
            let (to_below, to_above) = (link(2, start), link(2, start + layer));
            for k in 0..n {
                let along_x = to_left[k] * left[k] + to_right[k] * right[k];
                let along_y = to_front[k] * front[k] + to_back[k] * back[k];
                let along_z = to_below[k] * below[k] + to_above[k] * above[k];
                y[k] = own[k] * x[k] - (along_x + along_y + along_z);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::darcy::grid::Plan;
    use crate::darcy::{Permeability, Transfer};
    use crate::grains::Grains;
    use glam::DVec3;
    use porograin_linear::{FIXED, Matrix};

    #[test]
    fn the_product_is_that_of_the_matrix() {
        let planes = [3usize, 1, 4].map(|n| (0..=n).map(|k| k as f64).collect());
        let plan = Plan {
            planes,
            transfer: Transfer::Overlap,
            permeability: Permeability::Given([1.0; 3]),
            viscosity: 1.0,
            slowed: &[],
        };
        let grid = Grid::new(&Grains::at_rest(vec![DVec3::splat(0.5)], vec![0.1], 1.0), &plan);
        let cells = grid.census.cells as u32;
        let g: Vec<f64> = (0..grid.ends.len()).map(|link| 1.0 + 0.1 * link as f64).collect();
        let excess: Vec<f64> = (0..cells).map(|cell| 0.2 * f64::from(cell % 5)).collect();
        for first in [0, 1] {
            let inside = || grid.ends.iter().zip(&g).filter(|(ends, _)| ends.iter().all(|&end| end < cells));
            let ends: Vec<[u32; 2]> =
                inside().map(|(ends, _)| ends.map(|end| end.checked_sub(first).unwrap_or(FIXED))).collect();
            let values: Vec<f64> = inside().map(|(_, g)| *g).collect();
            let first = first as usize;
            let n = grid.census.cells - first;
            let matrix = Matrix::new(n, &ends, &values, &excess[first..]).unwrap();
            let mut stencil = Stencil::new(&grid, &g, &excess, first);
            assert_eq!(stencil.nodes(), n);
            let x: Vec<f64> = (0..n).map(|k| (k as f64).sin()).collect();
            let (mut y, mut z) = (vec![0.0; n], vec![0.0; n]);
            (&matrix).apply(&x, &mut y);
            stencil.apply(&x, &mut z);
            for (y, z) in y.iter().zip(&z) {
                assert!((y - z).abs() < 1e-13, "{y} {z}");
            }
        }
    }
}
