//! The system of the pressures as a product: every cell and its six neighbours, each at one distance in memory.

use super::grid::Grid;
use porograin_linear::{Operator, Sums};
use rayon::prelude::*;

/// Cells handed to a thread at once; sums over them are added in order.
const BLOCK: usize = 4096;
/// Cells whose products are summed while they are at hand.
const NEAR: usize = 512;

/// `A x` for the cells of a grid.
pub struct Stencil {
    /// What leads from a cell to the next along each axis.
    stride: [usize; 3],
    /// Of each cell.
    diagonal: Vec<f64>,
    /// What links each cell to the one before along each axis, 0 if nothing does; as many zeros as the stride at the end.
    before: [Vec<f64>; 3],
    /// The unknowns between zeros.
    x: Vec<f64>,
}

/// What to do with a product.
#[derive(Clone, Copy)]
enum After<'a> {
    /// Nothing.
    Keep,
    /// Take it from this, and sum up the squares of both.
    Residual(&'a [f64]),
    /// Sum up products with what was multiplied, with this, and with itself.
    Dots(&'a [f64]),
}

impl Stencil {
    /// Of links `g` [m³/(Pa s)] between the cells, and `excess`, what each row sums to.
    pub fn new(grid: &Grid, g: &[f64], excess: &[f64]) -> Stencil {
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
                    before[high] = g[link];
                }
            }
        }
        Stencil { stride, diagonal, before, x: vec![0.0; cells + 2 * stride[2]] }
    }

    /// `y = A x` and what comes after, block by block.
    fn multiply(&mut self, x: &[f64], y: &mut [f64], sums: &mut Sums, after: After) -> [f64; 3] {
        let pad = self.stride[2];
        self.x[pad..][..x.len()].copy_from_slice(x);
        sums.clear();
        sums.resize(y.len().div_ceil(BLOCK), [0.0; 3]);
        let blocks = (y.par_chunks_mut(BLOCK), sums.par_iter_mut()).into_par_iter().enumerate();
        blocks.for_each(|(block, (y, sum))| *sum = self.block(block * BLOCK, y, after));
        sums.iter().fold([0.0; 3], |sum, part| std::array::from_fn(|k| sum[k] + part[k]))
    }

    /// The cells from `start` on.
    fn block(&self, start: usize, y: &mut [f64], after: After) -> [f64; 3] {
        #[cfg(target_arch = "x86_64")]
        if super::wide::wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.block_wide(start, y, after) };
        }
        self.block_plain(start, y, after)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn block_wide(&self, start: usize, y: &mut [f64], after: After) -> [f64; 3] {
        self.block_plain(start, y, after)
    }

    #[inline(always)]
    fn block_plain(&self, start: usize, y: &mut [f64], after: After) -> [f64; 3] {
        let mut sums = [[0.0; 8]; 3];
        for (part, y) in y.chunks_mut(NEAR).enumerate() {
            let start = start + part * NEAR;
            self.rows(start, y);
            let n = y.len();
            match after {
                After::Keep => {}
                After::Residual(b) => {
                    let b = &b[start..][..n];
                    y.iter_mut().zip(b).for_each(|(y, b)| *y = b - *y);
                    add_dot(&mut sums[0], y, y);
                    add_dot(&mut sums[1], b, b);
                }
                After::Dots(r) => {
                    add_dot(&mut sums[0], &self.x[self.stride[2] + start..][..n], y);
                    add_dot(&mut sums[1], &r[start..][..n], y);
                    add_dot(&mut sums[2], y, y);
                }
            }
        }
        sums.map(|lanes| lanes.iter().sum())
    }

    #[inline(always)]
    fn rows(&self, start: usize, y: &mut [f64]) {
        let ([one, row, layer], n) = (self.stride, y.len());
        let at = |place: usize| &self.x[place..][..n];
        let link = |axis: usize, place: usize| &self.before[axis][place..][..n];
        let from = layer + start;
        let (own, x) = (&self.diagonal[start..][..n], at(from));
        let (left, right) = (at(from - one), at(from + one));
        let (front, back) = (at(from - row), at(from + row));
        let (below, above) = (at(from - layer), at(from + layer));
        let (to_left, to_right) = (link(0, start), link(0, start + one));
        let (to_front, to_back) = (link(1, start), link(1, start + row));
        let (to_below, to_above) = (link(2, start), link(2, start + layer));
        for k in 0..n {
            let along_x = to_left[k] * left[k] + to_right[k] * right[k];
            let along_y = to_front[k] * front[k] + to_back[k] * back[k];
            let along_z = to_below[k] * below[k] + to_above[k] * above[k];
            y[k] = own[k] * x[k] - (along_x + along_y + along_z);
        }
    }
}

/// Adds the products of two vectors to eight sums by turns.
#[inline(always)]
fn add_dot(sums: &mut [f64; 8], a: &[f64], b: &[f64]) {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut lanes = *sums;
    for (a, b) in a.iter().zip(b) {
        for lane in 0..8 {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    lanes[0] += a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>();
    *sums = lanes;
}

impl Operator for Stencil {
    fn nodes(&self) -> usize {
        self.diagonal.len()
    }

    fn apply(&mut self, x: &[f64], y: &mut [f64]) {
        self.multiply(x, y, &mut Sums::new(), After::Keep);
    }

    fn residual(&mut self, b: &[f64], x: &[f64], r: &mut [f64], sums: &mut Sums) -> [f64; 2] {
        let [rr, bb, _] = self.multiply(x, r, sums, After::Residual(b));
        [rr, bb]
    }

    fn apply_dots(&mut self, p: &[f64], r: &[f64], q: &mut [f64], sums: &mut Sums) -> [f64; 3] {
        self.multiply(p, q, sums, After::Dots(r))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::darcy::grid::Plan;
    use crate::darcy::{Permeability, Transfer};
    use crate::grains::Grains;
    use glam::DVec3;
    use porograin_linear::Matrix;

    #[test]
    fn the_product_is_that_of_the_matrix() {
        let planes = [13usize, 5, 11].map(|n| (0..=n).map(|k| k as f64).collect());
        let plan = Plan {
            planes,
            transfer: Transfer::Overlap,
            permeability: Permeability::Given([1.0; 3]),
            viscosity: 1.0,
            slowed: &[],
        };
        let grid = Grid::new(&Grains::at_rest(vec![DVec3::splat(0.5)], vec![0.1], 1.0), &plan);
        let cells = grid.census.cells as u32;
        let g: Vec<f64> = (0..grid.ends.len()).map(|link| 1.0 + 0.5 * (link as f64).sin()).collect();
        let excess: Vec<f64> = (0..cells).map(|cell| 0.2 * f64::from(cell % 5)).collect();
        let inside = || grid.ends.iter().zip(&g).filter(|(ends, _)| ends.iter().all(|&end| end < cells));
        let (ends, values): (Vec<[u32; 2]>, Vec<f64>) = inside().unzip();
        let n = grid.census.cells;
        let matrix = Matrix::new(n, &ends, &values, &excess).unwrap();
        let mut stencil = Stencil::new(&grid, &g, &excess);
        assert_eq!(stencil.nodes(), n);
        let vector = |phase: f64| (0..n).map(|k| (k as f64 + phase).sin()).collect::<Vec<f64>>();
        let (x, b) = (vector(0.0), vector(0.5));
        let (mut y, mut z, mut sums) = (vec![0.0; n], vec![0.0; n], Sums::new());
        let same = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).for_each(|(a, b)| assert!((a - b).abs() <= 1e-13 * b.abs().max(1.0), "{a} {b}"));
        };
        let mut of_matrix = &matrix;
        of_matrix.apply(&x, &mut y);
        stencil.apply(&x, &mut z);
        same(&y, &z);
        let expected = of_matrix.apply_dots(&x, &b, &mut y, &mut sums);
        same(&stencil.apply_dots(&x, &b, &mut z, &mut sums), &expected);
        let expected = of_matrix.residual(&b, &x, &mut y, &mut sums);
        same(&stencil.residual(&b, &x, &mut z, &mut sums), &expected);
        same(&y, &z);
    }
}
