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
//!
//! Subtrees of the elimination tree have nothing to do with each other, so the factor is a tree of parts that several threads can take. Each
//! part has its unknowns, and those beyond that its columns reach, together in a vector of its own.

use crate::eight::{Eight, Halves, LANES, Lanes, narrow};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SymbolicSupernodalCholesky};
use faer::{Accum, Mat, Par};
use rayon::prelude::*;

/// Parts of at most this share of all entries are not divided.
const SHARE: usize = 8;
/// Nor are parts of at most so many entries: handing them out would cost more than it gains.
const SMALLEST: usize = 1 << 16;

/// One supernode: where its things are.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// Its number in the factor.
    supernode: u32,
    /// First unknown in the part and number of unknowns.
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
    root: Part,
}

/// A part of the elimination tree: supernodes, and the subtrees below them.
#[derive(Default)]
struct Part {
    below: Vec<Part>,
    blocks: Vec<Block>,
    /// Rows below each supernode, filled up to whole blocks with the spare row.
    rows: Vec<u32>,
    /// For each supernode: `-W` by row blocks (all columns of eight rows, column after column).
    shares: Vec<Halves>,
    /// For each supernode: the lower half of `D` likewise, each block up to and with its diagonal.
    values: Vec<Lanes>,
    /// The largest entry of `-W` in each column: `shares` are in its terms, so that it is exact itself. Beside a throat 10⁵
    /// times its neighbours it is almost 1, and what it lacks is what matters.
    largest: Vec<f32>,
    /// The number in the matrix of each of its unknowns.
    own: Vec<u32>,
    /// Where each unknown beyond is in the part above.
    beyond: Vec<u32>,
    /// The unknowns under way: its own, those beyond, and the spare row.
    x: Vec<f32>,
    /// The unknowns of a supernode, in terms of `largest`.
    z: Vec<f32>,
    /// Those in the rows below a supernode.
    t: Vec<Lanes>,
    sums: Vec<Lanes>,
}

/// The elimination tree of the supernodes.
struct Tree<'a> {
    symbolic: &'a SymbolicSupernodalCholesky<u32>,
    /// Those right below each supernode; those below none at all come last.
    children: Vec<Vec<usize>>,
    /// Entries of each subtree.
    entries: Vec<usize>,
    /// The lowest supernode of each subtree: it consists of all from there on.
    lowest: Vec<usize>,
    /// Subtrees of fewer entries stay whole.
    least: usize,
}

impl Tree<'_> {
    fn new(symbolic: &SymbolicSupernodalCholesky<u32>) -> Tree<'_> {
        let count = symbolic.n_supernodes();
        let mut supernode = vec![0; symbolic.nrows()];
        for s in 0..count {
            let columns = symbolic.supernode_begin()[s] as usize..symbolic.supernode_end()[s] as usize;
            supernode[columns].fill(s);
        }
        let mut children = vec![Vec::new(); count + 1];
        let (mut entries, mut lowest) = (vec![0; count + 1], (0..=count).collect::<Vec<_>>());
        for s in 0..count {
            let pattern = symbolic.supernode(s).pattern();
            let columns = (symbolic.supernode_end()[s] - symbolic.supernode_begin()[s]) as usize;
            entries[s] += columns * (pattern.len() + columns / 2);
            let parent = pattern.first().map_or(count, |&row| supernode[row as usize]);
            children[parent].push(s);
            entries[parent] += entries[s];
            lowest[parent] = lowest[parent].min(lowest[s]);
        }
        let least = SMALLEST.max(entries[count] / SHARE);
        Tree { symbolic, children, entries, lowest, least }
    }

    /// The part of these subtrees; the rows `beyond` are those of the matrix for now. `place` is scratch.
    fn part(&self, mut roots: Vec<usize>, place: &mut [u32]) -> Part {
        let mut own = Vec::new();
        let mut below = Vec::new();
        while !roots.is_empty() {
            let (large, small): (Vec<_>, Vec<_>) =
                roots.into_iter().partition(|&root| self.entries[root] > self.least);
            for root in small {
                own.extend(self.lowest[root]..=root);
            }
            roots = Vec::new();
            match large[..] {
                [] => {}
                [root] => {
                    own.push(root);
                    roots = self.children[root].clone();
                }
                _ => below = large.into_iter().map(|root| self.part(vec![root], place)).collect(),
            }
        }
        own.sort_unstable();
        Part::new(self.symbolic, &own, below, place)
    }
}

impl Packed {
    /// Room for a factor of this structure, with the number in the matrix of each of its rows.
    pub fn new(symbolic: &SymbolicSupernodalCholesky<u32>, order: &[u32]) -> Packed {
        let tree = Tree::new(symbolic);
        let roots = tree.children.last().cloned().unwrap_or_default();
        let mut root = tree.part(roots, &mut vec![0; symbolic.nrows()]);
        root.number(order);
        Packed { root }
    }

    /// Takes over the values of a factor.
    pub fn refresh(&mut self, factor: SupernodalLltRef<'_, u32, f64>) {
        self.root.refresh(factor);
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.root.bytes()
    }

    /// Both sweeps: `b` gives the right-hand side of an unknown, by its number in the matrix, and `x` takes the solution.
    pub fn solve(&mut self, b: impl Fn(usize) -> f32 + Sync, mut x: impl FnMut(usize, f32)) {
        let alone = rayon::current_num_threads() == 1;
        self.root.forward(&b, alone);
        self.root.backward(alone);
        self.root.each(&mut x);
    }
}

impl Part {
    fn new(
        symbolic: &SymbolicSupernodalCholesky<u32>,
        supernodes: &[usize],
        mut below: Vec<Part>,
        place: &mut [u32],
    ) -> Part {
        let mut part = Part::default();
        let mut beyond: Vec<u32> = below.iter().flat_map(|part| part.beyond.iter().copied()).collect();
        for &s in supernodes {
            let columns = symbolic.supernode_begin()[s]..symbolic.supernode_end()[s];
            for (k, column) in (part.own.len() as u32..).zip(columns.clone()) {
                place[column as usize] = k;
            }
            part.own.extend(columns);
            beyond.extend_from_slice(symbolic.supernode(s).pattern());
        }
        beyond.sort_unstable();
        beyond.dedup();
        beyond.retain(|&row| part.own.get(place[row as usize] as usize) != Some(&row));
        for (k, &row) in (part.own.len() as u32..).zip(&beyond) {
            place[row as usize] = k;
        }
        for row in below.iter_mut().flat_map(|part| &mut part.beyond) {
            *row = place[*row as usize];
        }
        let spare = part.own.len() + beyond.len();
        let (mut start, mut shares, mut values, mut widest, mut longest) = (0, 0, 0, 0, 0);
        for &s in supernodes {
            let pattern = symbolic.supernode(s).pattern();
            let k = (symbolic.supernode_end()[s] - symbolic.supernode_begin()[s]) as usize;
            let below = pattern.len().div_ceil(LANES);
            part.blocks.push(Block {
                supernode: s as u32,
                start: start as u32,
                size: k as u32,
                rows: part.rows.len() as u32,
                below: below as u32,
                shares,
                values,
            });
            part.rows.extend(pattern.iter().map(|&row| place[row as usize]));
            part.rows.resize(part.rows.len().next_multiple_of(LANES), spare as u32);
            start += k;
            shares += below * k;
            values += (0..k.div_ceil(LANES)).map(|q| k.min((q + 1) * LANES)).sum::<usize>();
            widest = widest.max(k);
            longest = longest.max(below);
        }
        Part {
            below,
            beyond,
            shares: vec![[0; LANES]; shares],
            values: vec![[0.0; LANES]; values],
            largest: vec![0.0; start],
            x: vec![0.0; spare + 1],
            z: vec![0.0; widest],
            t: vec![[0.0; LANES]; longest],
            sums: vec![[0.0; LANES]; widest],
            ..part
        }
    }

    /// Names unknowns by their numbers in the matrix, which `order` has for each row of the factor.
    fn number(&mut self, order: &[u32]) {
        self.own.iter_mut().for_each(|row| *row = order[*row as usize]);
        self.below.iter_mut().for_each(|part| part.number(order));
    }

    fn refresh(&mut self, factor: SupernodalLltRef<'_, u32, f64>) {
        self.below.iter_mut().for_each(|part| part.refresh(factor));
        for block in &self.blocks {
            let node = factor.supernode(block.supernode as usize);
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

    fn bytes(&self) -> usize {
        let entries = std::mem::size_of_val(&*self.shares) + std::mem::size_of_val(&*self.values);
        let numbers =
            self.rows.len() + self.own.len() + self.beyond.len() + self.largest.len() + self.x.len();
        let below: usize = self.below.iter().map(Part::bytes).sum();
        entries + 4 * numbers + std::mem::size_of_val(&*self.blocks) + below
    }

    /// The forward sweep of the part and of those below; what it adds to unknowns beyond is left for the part above.
    fn forward(&mut self, b: &(impl Fn(usize) -> f32 + Sync), alone: bool) {
        if alone {
            self.below.iter_mut().for_each(|part| part.forward(b, alone));
        } else {
            self.below.par_iter_mut().for_each(|part| part.forward(b, alone));
        }
        let (own, rest) = self.x.split_at_mut(self.own.len());
        own.iter_mut().zip(&self.own).for_each(|(x, &i)| *x = b(i as usize));
        rest.fill(0.0);
        for part in &self.below {
            for (&at, x) in part.beyond.iter().zip(&part.x[part.own.len()..]) {
                self.x[at as usize] += x;
            }
        }
        sweep(self, false);
    }

    /// The backward sweep, when the unknowns beyond are known.
    fn backward(&mut self, alone: bool) {
        sweep(self, true);
        let Part { below, x, .. } = self;
        let follow = |part: &mut Part| {
            for (&at, mine) in part.beyond.iter().zip(&mut part.x[part.own.len()..]) {
                *mine = x[at as usize];
            }
            part.backward(alone);
        };
        if alone {
            below.iter_mut().for_each(follow);
        } else {
            below.par_iter_mut().for_each(follow);
        }
    }

    /// Calls `f` with each unknown and its value.
    fn each(&self, f: &mut impl FnMut(usize, f32)) {
        self.own.iter().zip(&self.x).for_each(|(&i, &x)| f(i as usize, x));
        self.below.iter().for_each(|part| part.each(f));
    }

    #[inline(always)]
    fn down<V: Eight>(&mut self) {
        let Part { blocks, rows, shares, largest, x, z, .. } = self;
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
    }

    #[inline(always)]
    fn up<V: Eight>(&mut self) {
        let Part { blocks, rows, shares, values, largest, x, t, sums, .. } = self;
        for block in blocks.iter().rev() {
            let (start, k) = (block.start as usize, block.size as usize);
            let (below, shares) = block.below(rows, shares);
            let sums = &mut sums[..k];
            for (t, rows) in t.iter_mut().zip(below.chunks_exact(LANES)) {
                *t = std::array::from_fn(|lane| x[rows[lane] as usize]);
            }
            let t = &t[..block.below as usize];
            // Few columns at a time, so that their sums stay in registers.
            let (fours, ones) = sums.as_chunks_mut::<4>();
            for (q, sums) in fours.iter_mut().enumerate() {
                columns::<_, V, _>(shares, k, 4 * q, t, sums);
            }
            let first = k - ones.len();
            for (c, sum) in ones.iter_mut().enumerate() {
                columns::<_, V, _>(shares, k, first + c, t, std::array::from_mut(sum));
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

/// The sweep up or down over the supernodes of a part.
fn sweep(part: &mut Part, up: bool) {
    #[cfg(target_arch = "x86_64")]
    if crate::eight::Avx::available() {
        // SAFETY: the processor has the features, as just asked.
        unsafe { sweep_avx(part, up) };
        return;
    }
    sweep_with::<Lanes>(part, up);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,f16c")]
fn sweep_avx(part: &mut Part, up: bool) {
    sweep_with::<crate::eight::Avx>(part, up);
}

#[inline(always)]
fn sweep_with<V: Eight>(part: &mut Part, up: bool) {
    if up { part.up::<V>() } else { part.down::<V>() }
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

/// `sum_q w[q][c] t[q]` lane by lane for `N` columns c from `first` on, where `w` has `k` columns in each block of rows.
#[inline(always)]
fn columns<C: Column, V: Eight, const N: usize>(
    w: &[C],
    k: usize,
    first: usize,
    t: &[Lanes],
    sums: &mut [Lanes; N],
) {
    let mut sum = [V::splat(0.0); N];
    for (w, t) in w.chunks_exact(k).zip(t) {
        let (Some(w), t) = (w[first..].first_chunk::<N>(), V::load(t)) else { return };
        for (sum, w) in sum.iter_mut().zip(w) {
            *sum = sum.add_product(w.read(), t);
        }
    }
    sums.iter_mut().zip(sum).for_each(|(to, sum)| sum.store(to));
}

/// `sums[c] += w[c] t` lane by lane.
#[inline(always)]
fn gather<C: Column, V: Eight>(w: &[C], t: V, sums: &mut [Lanes]) {
    for (w, s) in w.iter().zip(sums) {
        V::load(s).add_product(w.read(), t).store(s);
    }
}
