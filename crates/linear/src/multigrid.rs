//! Aggregation multigrid with a K-cycle (Notay 2010), in single precision: a preconditioner whose cost per node and
//! quality hardly depend on the number of nodes.
//!
//! Smoothing is one Gauss-Seidel sweep forwards before and one backwards after the coarse correction, within parts
//! of fixed length; between parts the old values count. So the result does not depend on the number of threads,
//! and the smoother stays convergent (a regular splitting of an M-matrix).

use crate::aggregate::{Graph, NONE};
use crate::vector::{ALONE, fill, power_below};
use crate::{Matrix, Preconditioner};

/// Networks of at most this many nodes are solved by a dense inverse.
const COARSEST: usize = 64;
/// Nodes per part of a sweep, on levels large enough to be worth several threads.
const PART: usize = 8192;
/// The second inner iteration of the K-cycle is spared when the first reduced the residual to this share.
const GOOD: f64 = 0.25;

/// The matrix of one level.
struct Rows {
    part: usize,
    /// Entries of row `i` sit at `bounds[3 i]..bounds[3 i + 3]`: first those below the diagonal within the part,
    /// then those of other parts from `bounds[3 i + 1]`, then those above the diagonal from `bounds[3 i + 2]`.
    bounds: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
    /// One over the diagonal raised by what leads to other parts; an entry of the row itself among those of other parts takes
    /// the same off again. So sweeps damp the exchange between parts (Baker et al. 2011), which would otherwise
    /// bounce for ever along a strong throat across parts.
    inverse: Vec<f32>,
    /// What the rows of the matrix sum to.
    excess: Vec<f32>,
}

/// One level.
struct Level {
    rows: Rows,
    /// The coarse node of each node, or [`NONE`]; and the up to four nodes of each coarse node, filled up with n.
    aggregate: Vec<u32>,
    members: Vec<[u32; 4]>,
    b: Vec<f32>,
    x: Vec<f32>,
    old: Vec<f32>,
    /// First inner iterate and its product, below the finest level.
    first: Vec<f32>,
    product: Vec<f32>,
}

/// The hierarchy.
pub struct Multigrid {
    levels: Vec<Level>,
    bottom: Bottom,
    /// The matrix was multiplied by this.
    scale: f64,
    sums: Sums,
}

impl Multigrid {
    /// Coarsens `matrix` until nothing is left but a few nodes.
    pub fn new(matrix: &Matrix) -> Multigrid {
        let n = matrix.nodes();
        let scale = n as f64 / matrix.diagonal().iter().sum::<f64>();
        let mut graph = Graph {
            starts: matrix.starts().to_vec(),
            columns: matrix.columns().to_vec(),
            values: matrix.values().iter().map(|a| -a * scale).collect(),
            excess: matrix.excess().iter().map(|e| e * scale).collect(),
        };
        let mut levels = Vec::new();
        // A network that no longer shrinks has only weak throats left: sweeps do.
        let mut shrinking = true;
        while (levels.is_empty() || graph.nodes() > COARSEST) && shrinking {
            let (aggregate, coarse) = graph.coarsen();
            shrinking = coarse.nodes() < graph.nodes() * 9 / 10;
            levels.push(Level::new(&graph, aggregate, coarse.nodes(), levels.is_empty()));
            graph = coarse;
        }
        let m = graph.nodes();
        let inverse = if m <= COARSEST { dense_inverse(&graph) } else { Vec::new() };
        let bottom = Bottom { inverse, b: vec![0.0; m], x: vec![0.0; m] };
        Multigrid { levels, bottom, scale, sums: Vec::new() }
    }

    /// Entries of the matrices of all levels.
    pub fn entries(&self) -> usize {
        self.levels.iter().map(|level| level.rows.columns.len() + level.x.len()).sum()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.levels
            .iter()
            .map(|l| {
                let vectors = l.rows.bounds.len() + l.x.len() * 6 + l.members.len() * 4 + l.first.len() * 2;
                8 * l.rows.columns.len() + 4 * vectors
            })
            .sum()
    }
}

impl Level {
    fn new(graph: &Graph, aggregate: Vec<u32>, coarse: usize, finest: bool) -> Level {
        let n = graph.nodes();
        let part = if n < ALONE { n.max(1) } else { PART };
        let mut bounds = Vec::with_capacity(3 * n + 1);
        bounds.push(0);
        let mut columns = Vec::with_capacity(graph.columns.len());
        let mut values = Vec::with_capacity(graph.columns.len());
        let mut inverse = Vec::with_capacity(n);
        for i in 0..n {
            let (js, gs) = graph.row(i);
            let own = i / part * part..(i / part + 1) * part;
            let group = |j: u32| match j as usize {
                j if !own.contains(&j) => 1,
                j if j < i => 0,
                _ => 2,
            };
            let across: f64 = js.iter().zip(gs).filter(|(j, _)| group(**j) == 1).map(|(_, g)| g).sum();
            for wanted in 0..3 {
                for (&j, &g) in js.iter().zip(gs).filter(|(j, _)| group(**j) == wanted) {
                    columns.push(j);
                    values.push(-g as f32);
                }
                if wanted == 1 && across > 0.0 {
                    columns.push(i as u32);
                    values.push(-across as f32);
                }
                bounds.push(columns.len() as u32);
            }
            let d = graph.excess[i] + gs.iter().sum::<f64>() + across;
            inverse.push((1.0 / d) as f32);
        }
        let mut members = vec![[n as u32; 4]; coarse];
        let mut count = vec![0u8; coarse];
        for (i, &a) in aggregate.iter().enumerate().filter(|(_, a)| **a != NONE) {
            members[a as usize][count[a as usize] as usize] = i as u32;
            count[a as usize] += 1;
        }
        let inner = if finest { 0 } else { n };
        Level {
            rows: Rows {
                part,
                bounds,
                columns,
                values,
                inverse,
                excess: graph.excess.iter().map(|e| *e as f32).collect(),
            },
            aggregate,
            members,
            b: vec![0.0; n],
            x: vec![0.0; n],
            old: vec![0.0; n],
            first: vec![0.0; inner],
            product: vec![0.0; inner],
        }
    }
}

impl Rows {
    /// `sum_j A_ij x_j` over the entries of row `i` between two of its bounds.
    #[inline(always)]
    fn sum(&self, i: usize, from: usize, to: usize, x: &[f32]) -> f32 {
        let range = self.bounds[3 * i + from] as usize..self.bounds[3 * i + to] as usize;
        let (columns, values) = (&self.columns[range.clone()], &self.values[range]);
        columns.iter().zip(values).map(|(&j, a)| a * x[j as usize]).sum()
    }

    /// `sum_j g_ij (x_i - x_j)` over row `i`. The same sum as `d x_i - sum_j g_ij x_j`, but the two ends of a throat
    /// see opposite fluxes to the last bit: in single precision the rounding of a throat 10⁶ times the median would
    /// otherwise be a source that drowns the residual.
    #[inline(always)]
    fn flux(&self, i: usize, x: &[f32]) -> f32 {
        let range = self.bounds[3 * i] as usize..self.bounds[3 * i + 3] as usize;
        let (columns, values) = (&self.columns[range.clone()], &self.values[range]);
        columns.iter().zip(values).map(|(&j, a)| a * (x[j as usize] - x[i])).sum()
    }

    /// The same for entries within the part that begins at `start` and of which `x` is the slice.
    #[inline(always)]
    fn sum_within(&self, i: usize, from: usize, to: usize, start: usize, x: &[f32]) -> f32 {
        let range = self.bounds[3 * i + from] as usize..self.bounds[3 * i + to] as usize;
        let (columns, values) = (&self.columns[range.clone()], &self.values[range]);
        columns.iter().zip(values).map(|(&j, a)| a * x[j as usize - start]).sum()
    }

    /// The forward sweep from zero, `x = (D + L)⁻¹ b`.
    fn forward(&self, b: &[f32], x: &mut [f32], sums: &mut Sums) {
        fill(x, self.part, sums, |start, x| {
            for k in 0..x.len() {
                let i = start + k;
                x[k] = (b[i] - self.sum_within(i, 0, 1, start, x)) * self.inverse[i];
            }
            [0.0; 3]
        });
    }

    /// The residual of [`Rows::forward`], summed over the members of each coarse node.
    fn restrict(&self, members: &[[u32; 4]], x: &[f32], coarse: &mut [f32], sums: &mut Sums) {
        let n = x.len();
        fill(coarse, PART, sums, |start, coarse| {
            for (c, members) in coarse.iter_mut().zip(&members[start..]) {
                let mut sum = 0.0;
                for &i in members.iter().take_while(|&&i| (i as usize) < n) {
                    sum += self.sum(i as usize, 1, 3, x);
                }
                *c = -sum;
            }
            [0.0; 3]
        });
    }

    /// The backward sweep from `old`, `x = old + (D + U)⁻¹ (b - A old)`.
    fn backward(&self, b: &[f32], old: &[f32], x: &mut [f32], sums: &mut Sums) {
        fill(x, self.part, sums, |start, x| {
            for k in (0..x.len()).rev() {
                let i = start + k;
                let rest = b[i] - self.sum(i, 0, 2, old) - self.sum_within(i, 2, 3, start, x);
                x[k] = rest * self.inverse[i];
            }
            [0.0; 3]
        });
    }

    /// `y = A x`, returning `[x · b, x · y, b · b]`.
    fn multiply(&self, x: &[f32], b: &[f32], y: &mut [f32], sums: &mut Sums) -> [f64; 3] {
        fill(y, PART, sums, |start, y| {
            let mut dots = [0.0; 3];
            for k in 0..y.len() {
                let i = start + k;
                y[k] = self.excess[i] * x[i] + self.flux(i, x);
                let (x, y, b) = (f64::from(x[i]), f64::from(y[k]), f64::from(b[i]));
                dots[0] += x * b;
                dots[1] += x * y;
                dots[2] += b * b;
            }
            dots
        })
    }
}

type Sums = Vec<[f64; 3]>;

/// The solution and right-hand side of the network below the coarsest level.
struct Bottom {
    /// Dense inverse, row after row; empty if the network stopped shrinking before it was small.
    inverse: Vec<f64>,
    b: Vec<f32>,
    x: Vec<f32>,
}

impl Bottom {
    fn solve(&mut self) {
        let m = self.b.len();
        if self.inverse.is_empty() {
            self.x.fill(0.0);
        } else {
            for (x, row) in self.x.iter_mut().zip(self.inverse.chunks_exact(m)) {
                *x = row.iter().zip(&self.b).map(|(a, b)| a * f64::from(*b)).sum::<f64>() as f32;
            }
        }
    }
}

/// One cycle: the approximate solution of the first level's `b` in its `x`.
fn cycle(levels: &mut [Level], bottom: &mut Bottom, sums: &mut Sums) {
    let [level, coarser @ ..] = levels else { return };
    let Level { rows, aggregate, members, b, x, old, .. } = level;
    rows.forward(b, x, sums);
    let correction = match coarser.first_mut() {
        Some(next) => {
            rows.restrict(members, x, &mut next.b, sums);
            inner(coarser, bottom, sums);
            &coarser[0].x
        }
        None => {
            rows.restrict(members, x, &mut bottom.b, sums);
            bottom.solve();
            &bottom.x
        }
    };
    fill(old, PART, sums, |start, old| {
        for k in 0..old.len() {
            let a = aggregate[start + k];
            old[k] = x[start + k] + if a == NONE { 0.0 } else { correction[a as usize] };
        }
        [0.0; 3]
    });
    rows.backward(b, old, x, sums);
}

/// The coarse problem by one or two conjugate gradient iterations, each preconditioned by a cycle.
fn inner(levels: &mut [Level], bottom: &mut Bottom, sums: &mut Sums) {
    cycle(levels, bottom, sums);
    let Level { rows, b, x, first, product, .. } = &mut levels[0];
    let [xb, xax, bb] = rows.multiply(x, b, product, sums);
    if !(xb > 0.0 && xax > 0.0) {
        return; // nothing to solve for, or nothing left of single precision
    }
    let step = (xb / xax) as f32;
    let [rr, ..] = fill(b, PART, sums, |start, b| {
        let mut rr = 0.0;
        for k in 0..b.len() {
            b[k] -= step * product[start + k];
            rr += f64::from(b[k]) * f64::from(b[k]);
        }
        [rr, 0.0, 0.0]
    });
    if rr <= GOOD * GOOD * bb {
        fill(x, PART, sums, |_, x| {
            x.iter_mut().for_each(|x| *x *= step);
            [0.0; 3]
        });
        return;
    }
    std::mem::swap(first, x);
    cycle(levels, bottom, sums);
    let Level { rows, b, x, first, product, old, .. } = &mut levels[0];
    // The product of the first iterate is orthogonalised against, not recomputed; `old` is free until the next cycle.
    let [zr, zaz, _] = rows.multiply(x, b, old, sums);
    let [cross, ..] = {
        let mut cross = 0.0;
        for (z, v) in x.iter().zip(&*product) {
            cross += f64::from(*z) * f64::from(*v);
        }
        [cross]
    };
    let curvature = zaz - cross * cross / xax;
    let (mut one, mut two) = (f64::from(step), 0.0);
    if curvature > 1e-6 * zaz {
        one -= cross * zr / (xax * curvature);
        two = zr / curvature;
    }
    let (one, two) = (one as f32, two as f32);
    fill(x, PART, sums, |start, x| {
        for k in 0..x.len() {
            x[k] = one * first[start + k] + two * x[k];
        }
        [0.0; 3]
    });
}

impl Preconditioner for Multigrid {
    fn apply(&mut self, r: &[f64], z: &mut [f64]) {
        let Multigrid { levels, bottom, scale, sums } = self;
        let Some(down) = power_below(r) else {
            z.copy_from_slice(r);
            return;
        };
        fill(&mut levels[0].b, PART, sums, |start, b| {
            b.iter_mut().zip(&r[start..]).for_each(|(b, r)| *b = (r * down) as f32);
            [0.0; 3]
        });
        cycle(levels, bottom, sums);
        let (x, up) = (&levels[0].x, *scale / down);
        fill(z, PART, sums, |start, z| {
            z.iter_mut().zip(&x[start..]).for_each(|(z, x)| *z = f64::from(*x) * up);
            [0.0; 3]
        });
    }
}

/// The inverse of a small network by Gauss-Jordan elimination without exchanges (it is positive definite).
fn dense_inverse(graph: &Graph) -> Vec<f64> {
    let m = graph.nodes();
    let mut a = vec![0.0; m * m];
    for i in 0..m {
        let (columns, values) = graph.row(i);
        a[i * m + i] = graph.excess[i] + values.iter().sum::<f64>();
        for (&j, &g) in columns.iter().zip(values) {
            a[i * m + j as usize] -= g;
        }
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
