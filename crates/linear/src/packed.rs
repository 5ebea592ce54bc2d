//! A Cholesky factor rearranged for fast triangular solves: single precision, blocks of eight rows.
//!
//! With the columns of a supernode `L11` (k x k) on top and `L21` (m x k) below, `W = L21 L11⁻¹` and
//! `D = (L11 L11ᵀ)⁻¹` give `A = U U'ᵀ` in block form: the forward sweep is `x_rows -= W x_top`, the backward sweep
//! `x_top = D x_top - Wᵀ x_rows`. No short dependent chains remain, `D` is read once instead of `L11` twice, and
//! everything streams. Rounded to single precision it is a preconditioner that gains five or six digits.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SymbolicSupernodalCholesky};
use faer::{Accum, Mat, Par};

/// Rows per block.
const LANES: usize = 8;
type Lanes = [f32; LANES];

/// One supernode: where its things are.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// First unknown and number of unknowns.
    start: u32,
    size: u32,
    /// First entry in `rows` and number of row blocks below.
    rows: u32,
    below: u32,
    /// First entry in `values`, in units of `Lanes`.
    values: usize,
}

/// The rearranged factor.
pub struct Packed {
    blocks: Vec<Block>,
    /// Rows below each supernode, filled up to whole blocks with the spare row n.
    rows: Vec<u32>,
    /// For each supernode: `W` by row blocks (all columns of eight rows, column after column), then the lower half of
    /// `D` likewise, each block up to and with its diagonal.
    values: Vec<Lanes>,
    /// The unknowns under way, and the spare row.
    x: Vec<f32>,
    sums: Vec<Lanes>,
}

impl Packed {
    /// Room for a factor of this structure.
    pub fn new(symbolic: &SymbolicSupernodalCholesky<u32>) -> Packed {
        let n = symbolic.nrows();
        let mut blocks = Vec::with_capacity(symbolic.n_supernodes());
        let mut rows = Vec::new();
        let (mut count, mut widest) = (0, 0);
        for s in 0..symbolic.n_supernodes() {
            let node = symbolic.supernode(s);
            let k = (symbolic.supernode_end()[s] - symbolic.supernode_begin()[s]) as usize;
            let below = node.pattern().len().div_ceil(LANES);
            blocks.push(Block {
                start: node.start() as u32,
                size: k as u32,
                rows: rows.len() as u32,
                below: below as u32,
                values: count,
            });
            rows.extend_from_slice(node.pattern());
            rows.resize(rows.len().next_multiple_of(LANES), n as u32);
            count += below * k + (0..k.div_ceil(LANES)).map(|q| k.min((q + 1) * LANES)).sum::<usize>();
            widest = widest.max(k);
        }
        let (values, sums) = (vec![[0.0; LANES]; count], vec![[0.0; LANES]; widest]);
        Packed { blocks, rows, values, x: vec![0.0; n + 1], sums }
    }

    /// Takes over the values of a factor.
    pub fn refresh(&mut self, factor: SupernodalLltRef<'_, u32, f64>) {
        for (s, block) in self.blocks.iter().enumerate() {
            let node = factor.supernode(s);
            let (k, m) = (node.val().ncols(), node.pattern().len());
            let (top, bottom) = node.val().split_at_row(k);
            let mut w = bottom.to_owned();
            solve_upper_triangular_in_place(top.transpose(), w.as_mut().transpose_mut(), Par::Seq);
            let mut inverse = Mat::<f64>::zeros(k, k);
            invert_lower_triangular(inverse.as_mut(), top, Par::Seq);
            let mut d = Mat::<f64>::zeros(k, k);
            matmul(d.as_mut(), Accum::Replace, inverse.transpose(), inverse.as_ref(), 1.0, Par::Seq);
            let mut at = block.values;
            for q in 0..block.below as usize {
                for c in 0..k {
                    for lane in 0..LANES.min(m - q * LANES) {
                        self.values[at][lane] = w[(q * LANES + lane, c)] as f32;
                    }
                    at += 1;
                }
            }
            for q in 0..k.div_ceil(LANES) {
                for c in 0..k.min((q + 1) * LANES) {
                    for lane in 0..LANES.min(k - q * LANES) {
                        self.values[at][lane] = d[(q * LANES + lane, c)] as f32;
                    }
                    at += 1;
                }
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        32 * self.values.len() + 4 * self.rows.len() + 24 * self.blocks.len() + 4 * self.x.len()
    }

    /// The unknowns: the right-hand side before [`Packed::solve`], the solution after it. The spare row is last.
    pub fn x(&mut self) -> &mut [f32] {
        &mut self.x
    }

    /// Both sweeps.
    pub fn solve(&mut self) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the feature, as just asked.
            unsafe { self.solve_avx2() };
            return;
        }
        self.solve_any();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn solve_avx2(&mut self) {
        self.solve_any();
    }

    #[inline(always)]
    fn solve_any(&mut self) {
        let Packed { blocks, rows, values, x, sums } = self;
        for block in blocks.iter() {
            let (start, k) = (block.start as usize, block.size as usize);
            let mut values = &values[block.values..];
            for q in 0..block.below as usize {
                let (w, rest) = values.split_at(k);
                values = rest;
                let t = product(w, &x[start..start + k]);
                let rows = &rows[block.rows as usize + q * LANES..][..LANES];
                for lane in 0..LANES {
                    x[rows[lane] as usize] -= t[lane];
                }
            }
        }
        for block in blocks.iter().rev() {
            let (start, k) = (block.start as usize, block.size as usize);
            let mut values = &values[block.values..];
            let sums = &mut sums[..k];
            sums.fill([0.0; LANES]);
            for q in 0..block.below as usize {
                let (w, rest) = values.split_at(k);
                values = rest;
                let rows = &rows[block.rows as usize + q * LANES..][..LANES];
                let t: Lanes = std::array::from_fn(|lane| -x[rows[lane] as usize]);
                gather(w, &t, sums);
            }
            // D: the rows of the block from the columns so far, and the columns from those rows. The diagonal block is
            // whole, so it only serves its rows.
            for q in 0..k.div_ceil(LANES) {
                let first = q * LANES;
                let (left, rest) = values.split_at(first);
                let (diagonal, rest) = rest.split_at(LANES.min(k - first));
                values = rest;
                let z = &x[start..start + k];
                let mut own: Lanes = [0.0; LANES];
                own[..diagonal.len()].copy_from_slice(&z[first..first + diagonal.len()]);
                let mut t = product(left, &z[..first]);
                gather(left, &own, &mut sums[..first]);
                let d = product(diagonal, &own[..diagonal.len()]);
                for lane in 0..LANES {
                    t[lane] += d[lane];
                }
                for lane in 0..diagonal.len() {
                    sums[first + lane][0] += t[lane];
                }
            }
            for (x, s) in x[start..start + k].iter_mut().zip(sums.iter()) {
                *x = ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
            }
        }
    }
}

/// `sum_c w[c] z[c]` for eight rows.
#[inline(always)]
fn product(w: &[Lanes], z: &[f32]) -> Lanes {
    let mut sum = [[0.0f32; LANES]; 4];
    let (whole, last) = w.as_chunks::<4>();
    let (z_whole, z_last) = z.as_chunks::<4>();
    for (w, z) in whole.iter().zip(z_whole) {
        for part in 0..4 {
            for lane in 0..LANES {
                sum[part][lane] += w[part][lane] * z[part];
            }
        }
    }
    for (w, z) in last.iter().zip(z_last) {
        for lane in 0..LANES {
            sum[0][lane] += w[lane] * z;
        }
    }
    std::array::from_fn(|lane| (sum[0][lane] + sum[1][lane]) + (sum[2][lane] + sum[3][lane]))
}

/// `sums[c] += w[c] t` lane by lane.
#[inline(always)]
fn gather(w: &[Lanes], t: &Lanes, sums: &mut [Lanes]) {
    for (w, s) in w.iter().zip(sums) {
        for lane in 0..LANES {
            s[lane] += w[lane] * t[lane];
        }
    }
}
