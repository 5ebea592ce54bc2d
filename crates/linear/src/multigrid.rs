//! Multigrid in single precision: a preconditioner whose cost per node and quality hardly depend on the number of nodes.
//!
//! The finest level joins strong [clusters](crate::clusters) and solves each exactly; the network of clusters, which is free
//! of extremes, is coarsened by smoothed [aggregation](crate::aggregate). One V-cycle. Where many solves repay it and the
//! network of clusters, a tenth of the nodes, is not too large, it is factored instead: two levels.
//!
//! Smoothing is one Gauss-Seidel sweep forwards before and one backwards after the coarse correction, within parts
//! of fixed length; between parts the old values count. So the result does not depend on the number of threads.

use crate::aggregate::{Rows, Sparse};
use crate::cholesky::Cholesky;
use crate::finest::Finest;
use crate::vector::{Sums, by_part, each, power_below};
use crate::{Error, Matrix, Preconditioner};
use glam::DVec3;

/// Networks of at most this many nodes are solved by a dense inverse.
const COARSEST: usize = 64;
/// Networks of at most this many clusters are factored where that pays: a pass over the factor takes as long as the cycle there, and
/// saves iterations.
const FACTORED: usize = 25_000;
/// Levels of at least this many nodes are swept in two or more parts, which several threads can take.
const PARTED: usize = 1 << 13;
/// Most nodes of a part: the fewer parts, the better the sweep.
const PART: usize = 1 << 15;

/// One level of aggregation.
struct Level {
    part: usize,
    /// Entries of row `i` sit at `bounds[3 i]..bounds[3 i + 3]`: first those below the diagonal within the part,
    /// then those of other parts from `bounds[3 i + 1]`, then those above the diagonal from `bounds[3 i + 2]`.
    bounds: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
    /// One over the diagonal raised by what leads to other parts; an entry of the row itself among those of other parts takes
    /// the same off again. So sweeps damp the exchange between parts (Baker et al. 2011), which would otherwise
    /// bounce for ever across parts.
    inverse: Vec<f32>,
    /// To the nodes from the aggregates, and back.
    interpolation: Transfer,
    restriction: Transfer,
    b: Vec<f32>,
    x: Vec<f32>,
    old: Vec<f32>,
}

/// The interpolation or its transpose.
struct Transfer {
    starts: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
}

/// The hierarchy.
pub struct Multigrid {
    finest: Finest,
    levels: Vec<Level>,
    bottom: Bottom,
    /// The matrix was multiplied by this.
    scale: f64,
}

impl Multigrid {
    /// Coarsens `matrix` until nothing is left but a few nodes; with the positions of its nodes, the network of clusters may be factored.
    pub fn new(matrix: &Matrix, positions: Option<&[DVec3]>) -> Multigrid {
        let n = matrix.nodes();
        let scale = n as f64 / matrix.diagonal().iter().sum::<f64>();
        let (finest, mut network) = Finest::new(matrix, scale);
        let mut levels = Vec::new();
        if let Some(positions) = positions.filter(|_| (COARSEST + 1..=FACTORED).contains(&network.nodes()))
            && let Ok(factor) = factor(&finest, &network, positions)
        {
            return Multigrid { bottom: Bottom::new(network.nodes(), factor), finest, levels, scale };
        }
        while network.nodes() > COARSEST {
            let (of, count) = network.aggregates();
            if count == 0 {
                break; // heavy nodes only: sweeps solve them
            }
            let interpolation = network.interpolation(&of, count);
            let restriction = interpolation.transpose(count);
            let coarse = network.coarse(&interpolation, &restriction);
            levels.push(Level::new(&network, interpolation, restriction));
            network = coarse;
        }
        let m = network.nodes();
        let inverse = if m <= COARSEST { Inverse::Dense(dense_inverse(&network)) } else { Inverse::Nothing };
        let bottom = Bottom::new(m, inverse);
        Multigrid { finest, levels, bottom, scale }
    }

    /// Entries of the matrices of all levels.
    pub fn entries(&self) -> usize {
        let levels = self.levels.iter().map(|level| level.columns.len() + level.x.len());
        let bottom = match &self.bottom.inverse {
            Inverse::Factor(factor) => factor.entries(),
            Inverse::Dense(_) | Inverse::Nothing => 0,
        };
        self.finest.entries() + levels.sum::<usize>() + bottom
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let levels = self.levels.iter().map(|l| {
            let transfers = l.interpolation.columns.len() + l.restriction.columns.len();
            8 * (l.columns.len() + transfers) + 4 * (l.bounds.len() + 6 * l.x.len())
        });
        let bottom = match &self.bottom.inverse {
            Inverse::Factor(factor) => factor.bytes(),
            Inverse::Dense(_) | Inverse::Nothing => 0,
        };
        self.finest.bytes() + levels.sum::<usize>() + bottom
    }
}

impl Transfer {
    fn new(rows: Rows) -> Transfer {
        let values = rows.values.iter().map(|v| *v as f32).collect();
        Transfer { starts: rows.starts, columns: rows.columns, values }
    }

    #[inline(always)]
    fn row(&self, i: usize, x: &[f32]) -> f32 {
        let range = self.starts[i] as usize..self.starts[i + 1] as usize;
        self.columns[range.clone()].iter().zip(&self.values[range]).map(|(&j, v)| v * x[j as usize]).sum()
    }
}

impl Level {
    fn new(network: &Sparse, interpolation: Rows, restriction: Rows) -> Level {
        let n = network.nodes();
        let part = if n < PARTED { n.max(1) } else { n.div_ceil(2).min(PART) };
        let mut bounds = Vec::with_capacity(3 * n + 1);
        bounds.push(0);
        let mut columns = Vec::with_capacity(network.rows.columns.len());
        let mut values = Vec::with_capacity(network.rows.columns.len());
        let mut inverse = Vec::with_capacity(n);
        for i in 0..n {
            let own = i / part * part..(i / part + 1) * part;
            let group = |j: u32| match j as usize {
                j if !own.contains(&j) => 1,
                j if j < i => 0,
                _ => 2,
            };
            let row = network.rows.row(i);
            let across: f64 = row.clone().filter(|e| group(e.0) == 1).map(|e| e.1.abs()).sum();
            for wanted in 0..3 {
                for (j, a) in row.clone().filter(|e| group(e.0) == wanted) {
                    columns.push(j);
                    values.push(a as f32);
                }
                if wanted == 1 && across > 0.0 {
                    columns.push(i as u32);
                    values.push(-across as f32);
                }
                bounds.push(columns.len() as u32);
            }
            inverse.push((1.0 / (network.diagonal[i] + across)) as f32);
        }
        Level {
            part,
            bounds,
            columns,
            values,
            inverse,
            interpolation: Transfer::new(interpolation),
            restriction: Transfer::new(restriction),
            b: vec![0.0; n],
            x: vec![0.0; n],
            old: vec![0.0; n],
        }
    }

    /// `sum_j A_ij x_j` over the entries of row `i` between two of its bounds, `x` beginning at the node `start`.
    #[inline(always)]
    fn sum(&self, i: usize, from: usize, to: usize, start: usize, x: &[f32]) -> f32 {
        let range = self.bounds[3 * i + from] as usize..self.bounds[3 * i + to] as usize;
        let (columns, values) = (&self.columns[range.clone()], &self.values[range]);
        columns.iter().zip(values).map(|(&j, a)| a * x[j as usize - start]).sum()
    }
}

/// The solution and right-hand side of the network below the coarsest level.
struct Bottom {
    inverse: Inverse,
    b: Vec<f32>,
    x: Vec<f32>,
}

/// How the bottom is solved.
enum Inverse {
    /// Dense, row after row.
    Dense(Vec<f64>),
    Factor(Box<Cholesky>),
    /// Heavy nodes only, for which the sweeps above suffice.
    Nothing,
}

impl Bottom {
    fn new(nodes: usize, inverse: Inverse) -> Bottom {
        Bottom { inverse, b: vec![0.0; nodes], x: vec![0.0; nodes] }
    }

    fn solve(&mut self) {
        match &mut self.inverse {
            Inverse::Nothing => self.x.fill(0.0),
            Inverse::Factor(factor) => factor.apply_single(&self.b, &mut self.x),
            Inverse::Dense(rows) => {
                for (x, row) in self.x.iter_mut().zip(rows.chunks_exact(self.b.len())) {
                    *x = row.iter().zip(&self.b).map(|(a, b)| a * f64::from(*b)).sum::<f64>() as f32;
                }
            }
        }
    }
}

/// The factor of the network of clusters.
fn factor(finest: &Finest, network: &Sparse, positions: &[DVec3]) -> Result<Inverse, Error> {
    let m = network.nodes();
    let (mut ends, mut conductance) = (Vec::new(), Vec::new());
    for i in 0..m as u32 {
        for (j, a) in network.rows.row(i as usize).filter(|&(j, _)| j < i) {
            ends.push([i, j]);
            conductance.push(-a);
        }
    }
    // Added up anew: in the diagonal, little that leads out of the network would be lost.
    let matrix = Matrix::new(m, &ends, &conductance, &finest.excess())?;
    let places: Vec<DVec3> = finest.leaders().map(|i| positions[i as usize]).collect();
    Ok(Inverse::Factor(Box::new(Cholesky::new(&matrix, Some(&places))?)))
}

/// One cycle: the approximate solution of the first level's `b` in its `x`.
fn cycle(levels: &mut [Level], bottom: &mut Bottom) {
    let Some((level, coarser)) = levels.split_first_mut() else {
        bottom.solve();
        return;
    };
    let (mut x, mut old) = (std::mem::take(&mut level.x), std::mem::take(&mut level.old));
    let (part, b, inverse) = (level.part, &level.b, &level.inverse);
    // The forward sweep from zero, `x = (D + L)⁻¹ b`, and its residual.
    by_part(&mut x, part, |start, x| {
        for k in 0..x.len() {
            let i = start + k;
            x[k] = (b[i] - level.sum(i, 0, 1, start, x)) * inverse[i];
        }
    });
    each(&mut old, |i| -level.sum(i, 1, 3, 0, &x));
    let below = coarser.first_mut().map_or(&mut bottom.b, |next| &mut next.b);
    each(below, |c| level.restriction.row(c, &old));
    cycle(coarser, bottom);
    let below = coarser.first().map_or(&bottom.x, |next| &next.x);
    each(&mut old, |i| x[i] + level.interpolation.row(i, below));
    // The backward sweep from there, `x = old + (D + U)⁻¹ (b - A old)`.
    by_part(&mut x, part, |start, x| {
        for k in (0..x.len()).rev() {
            let i = start + k;
            let rest = b[i] - level.sum(i, 0, 2, 0, &old) - level.sum(i, 2, 3, start, x);
            x[k] = rest * inverse[i];
        }
    });
    (level.x, level.old) = (x, old);
}

impl Preconditioner for Multigrid {
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], sums: &mut Sums) -> f64 {
        let Multigrid { finest, levels, bottom, scale } = self;
        let Some(down) = power_below(size) else {
            z.copy_from_slice(r);
            return size * size;
        };
        let clusters = levels.first_mut().map_or(&mut bottom.b, |level| &mut level.b);
        finest.down(r, down, clusters);
        cycle(levels, bottom);
        let correction = levels.first().map_or(&bottom.x, |level| &level.x);
        finest.up(correction, *scale / down, r, z, sums)
    }
}

/// The inverse of a small network by Gauss-Jordan elimination without exchanges (it is positive definite).
fn dense_inverse(network: &Sparse) -> Vec<f64> {
    let m = network.nodes();
    let mut a = vec![0.0; m * m];
    for i in 0..m {
        a[i * m + i] = network.diagonal[i];
        network.rows.row(i).for_each(|(j, v)| a[i * m + j as usize] = v);
    }
    for k in 0..m {
        let pivot = 1.0 / a[k * m + k];
        a[k * m + k] = 1.0;
        a[k * m..(k + 1) * m].iter_mut().for_each(|v| *v *= pivot);
        for i in (0..m).filter(|&i| i != k) {
            let factor = std::mem::replace(&mut a[i * m + k], 0.0);
            for j in 0..m {
                a[i * m + j] -= factor * a[k * m + j];
            }
        }
    }
    a
}
