//! A Cholesky factor rearranged for fast triangular solves: blocks of eight rows, two bytes per entry off the diagonal.
//!
//! With the columns of a supernode `L11` (k x k) on top and `L21` (m x k) below, `W = L21 L11⁻¹` and
//! `D = (L11 L11ᵀ)⁻¹` give `A = U U'ᵀ` in block form: the forward sweep is `x_rows -= W x_top`, the backward sweep
//! `x_top = D x_top - Wᵀ x_rows`. No short dependent chains remain, `D` is read once instead of `L11` twice, and
//! everything streams.
//!
//! A solve is a pass over memory, so what counts is bytes. The matrices are M-matrices: `-W` says which share of a
//! unit of flow that enters a column leaves through each row below, so its entries lie between 0 and 1 and no column sums
//! to more than 1. Half precision holds them; `D`, which is small but spans decades, is kept in single precision. As a
//! preconditioner the result gains three digits or so per application.

use crate::eight::{Eight, Halves, LANES, Lanes, narrow};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SymbolicSupernodalCholesky};
use faer::{Accum, Mat, Par};

/// One supernode: where its things are.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// First unknown and number of unknowns.
    start: u32,
    size: u32,
    /// First entry in `rows` and number of row blocks below.
    rows: u32,
    below: u32,
    /// First entry in `shares`, in units of `Halves`.
    shares: usize,
    /// First entry in `values`, in units of `Lanes`.
    values: usize,
}

/// The rearranged factor.
pub struct Packed {
    blocks: Vec<Block>,
    /// Rows below each supernode, filled up to whole blocks with the spare row n.
    rows: Vec<u32>,
    /// For each supernode: `-W` by row blocks (all columns of eight rows, column after column).
    shares: Vec<Halves>,
    /// For each supernode: the lower half of `D` likewise, each block up to and with its diagonal.
    values: Vec<Lanes>,
    /// The largest entry of `-W` in each column: `shares` are in its terms, so that it is exact itself. Beside a throat 10⁵
    /// times its neighbours it is almost 1, and what it lacks is what matters.
    largest: Vec<f32>,
    /// The unknowns under way, and the spare row.
    x: Vec<f32>,
    /// The unknowns of a supernode, in terms of `largest`.
    z: Vec<f32>,
    sums: Vec<Lanes>,
}

impl Packed {
    /// Room for a factor of this structure.
    pub fn new(symbolic: &SymbolicSupernodalCholesky<u32>) -> Packed {
        let n = symbolic.nrows();
        let mut blocks = Vec::with_capacity(symbolic.n_supernodes());
        let mut rows = Vec::new();
        let (mut shares, mut count, mut widest) = (0, 0, 0);
        for s in 0..symbolic.n_supernodes() {
            let node = symbolic.supernode(s);
            let k = (symbolic.supernode_end()[s] - symbolic.supernode_begin()[s]) as usize;
            let below = node.pattern().len().div_ceil(LANES);
            blocks.push(Block {
                start: node.start() as u32,
                size: k as u32,
                rows: rows.len() as u32,
                below: below as u32,
                shares,
                values: count,
            });
            rows.extend_from_slice(node.pattern());
            rows.resize(rows.len().next_multiple_of(LANES), n as u32);
            shares += below * k;
            count += (0..k.div_ceil(LANES)).map(|q| k.min((q + 1) * LANES)).sum::<usize>();
            widest = widest.max(k);
        }
        let (shares, values) = (vec![[0; LANES]; shares], vec![[0.0; LANES]; count]);
        Packed {
            blocks,
            rows,
            shares,
            values,
            largest: vec![0.0; n],
            x: vec![0.0; n + 1],
            z: vec![0.0; widest],
            sums: vec![[0.0; LANES]; widest],
        }
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
            let mut scale = Vec::with_capacity(k);
            for c in 0..k {
                let largest = (0..m).fold(0.0f64, |a, r| a.max(-w[(r, c)]));
                self.largest[block.start as usize + c] = largest as f32;
                scale.push(if largest > 0.0 { 1.0 / largest } else { 0.0 });
            }
            let mut at = block.shares;
            for q in 0..block.below as usize {
                for c in 0..k {
                    for lane in 0..LANES.min(m - q * LANES) {
                        self.shares[at][lane] = narrow(-w[(q * LANES + lane, c)] * scale[c]);
                    }
                    at += 1;
                }
            }
            let mut at = block.values;
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
        let entries = std::mem::size_of_val(&*self.shares) + std::mem::size_of_val(&*self.values);
        entries + 4 * (self.rows.len() + 2 * self.x.len()) + std::mem::size_of_val(&*self.blocks)
    }

    /// The unknowns: the right-hand side before [`Packed::solve`], the solution after it. The spare row is last.
    pub fn x(&mut self) -> &mut [f32] {
        &mut self.x
    }

    /// Both sweeps.
    pub fn solve(&mut self) {
        #[cfg(target_arch = "x86_64")]
        if crate::eight::Avx::available() {
            // SAFETY: the processor has the features, as just asked.
            unsafe { self.solve_avx() };
            return;
        }
        self.solve_with::<Lanes>();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,f16c")]
    fn solve_avx(&mut self) {
        self.solve_with::<crate::eight::Avx>();
    }

    #[inline(always)]
    fn solve_with<V: Eight>(&mut self) {
        let Packed { blocks, rows, shares, values, largest, x, z, sums } = self;
        for block in blocks.iter() {
            let (start, k) = (block.start as usize, block.size as usize);
            let (below, shares) = block.below(rows, shares);
            let z = &mut z[..k];
            for ((z, x), scale) in z.iter_mut().zip(&x[start..start + k]).zip(&largest[start..start + k]) {
                *z = x * scale;
            }
            for (rows, w) in below.chunks_exact(LANES).zip(shares.chunks_exact(k)) {
                let mut flow = [0.0; LANES];
                product::<_, V>(w, z).store(&mut flow);
                for (row, flow) in rows.iter().zip(flow) {
                    x[*row as usize] += flow;
                }
            }
        }
        for block in blocks.iter().rev() {
            let (start, k) = (block.start as usize, block.size as usize);
            let (below, shares) = block.below(rows, shares);
            let sums = &mut sums[..k];
            sums.fill([0.0; LANES]);
            // Two blocks of rows at once: every sum is read and written half as often.
            let lift = |rows: &[u32]| {
                let t: Lanes = std::array::from_fn(|lane| x[rows[lane] as usize]);
                V::load(&t)
            };
            let mut pairs = below.chunks_exact(2 * LANES).zip(shares.chunks_exact(2 * k));
            for (rows, w) in &mut pairs {
                let t = [lift(&rows[..LANES]), lift(&rows[LANES..])];
                let (first, second) = w.split_at(k);
                for ((s, a), b) in sums.iter_mut().zip(first).zip(second) {
                    V::load(s).add_product(V::widen(a), t[0]).add_product(V::widen(b), t[1]).store(s);
                }
            }
            if below.len() % (2 * LANES) != 0 {
                let rows = &below[below.len() - LANES..];
                gather(&shares[shares.len() - k..], lift(rows), sums);
            }
            for (s, &scale) in sums.iter_mut().zip(&largest[start..start + k]) {
                V::splat(0.0).add_product(V::load(s), V::splat(scale)).store(s);
            }
            let mut values = &values[block.values..];
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
                let (mut t, mut d) = ([0.0; LANES], [0.0; LANES]);
                product::<_, V>(left, &z[..first]).store(&mut t);
                gather(left, V::load(&own), &mut sums[..first]);
                product::<_, V>(diagonal, &own[..diagonal.len()]).store(&mut d);
                for lane in 0..diagonal.len() {
                    sums[first + lane][0] += t[lane] + d[lane];
                }
            }
            for (x, s) in x[start..start + k].iter_mut().zip(sums.iter()) {
                *x = ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
            }
        }
    }
}

impl Block {
    /// The rows below, and the entries of `-W`.
    #[inline(always)]
    fn below<'a>(&self, rows: &'a [u32], shares: &'a [Halves]) -> (&'a [u32], &'a [Halves]) {
        let (below, k) = (self.below as usize, self.size as usize);
        (&rows[self.rows as usize..][..below * LANES], &shares[self.shares..][..below * k])
    }
}

/// A column of eight rows, as it is stored.
trait Column {
    fn read<V: Eight>(&self) -> V;
}

impl Column for Lanes {
    #[inline(always)]
    fn read<V: Eight>(&self) -> V {
        V::load(self)
    }
}

impl Column for Halves {
    #[inline(always)]
    fn read<V: Eight>(&self) -> V {
        V::widen(self)
    }
}

/// `sum_c w[c] z[c]` for eight rows.
#[inline(always)]
fn product<C: Column, V: Eight>(w: &[C], z: &[f32]) -> V {
    let mut sum = [V::splat(0.0); 4];
    let (whole, last) = w.as_chunks::<4>();
    let (z_whole, z_last) = z.as_chunks::<4>();
    for (w, z) in whole.iter().zip(z_whole) {
        for part in 0..4 {
            sum[part] = sum[part].add_product(w[part].read(), V::splat(z[part]));
        }
    }
    for (w, &z) in last.iter().zip(z_last) {
        sum[0] = sum[0].add_product(w.read(), V::splat(z));
    }
    let one = V::splat(1.0);
    sum[0].add_product(sum[1], one).add_product(sum[2].add_product(sum[3], one), one)
}

/// `sums[c] += w[c] t` lane by lane.
#[inline(always)]
fn gather<C: Column, V: Eight>(w: &[C], t: V, sums: &mut [Lanes]) {
    for (w, s) in w.iter().zip(sums) {
        V::load(s).add_product(w.read(), t).store(s);
    }
}
