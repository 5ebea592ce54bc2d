//! Supernodal Cholesky factorisation (`faer`, double precision) in our own elimination order, applied in single
//! precision.

use crate::order::{landmarks, nested_dissection};
use crate::packed::Packed;
use crate::vector::{Sums, dot, power_below};
use crate::{Error, Matrix, Preconditioner};
use faer::Par;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::sparse::linalg::cholesky::simplicial::{
    prefactorize_symbolic_cholesky, prefactorize_symbolic_cholesky_scratch,
};
use faer::sparse::linalg::cholesky::supernodal::{
    SupernodalLltRef, SymbolicSupernodalCholesky, factorize_supernodal_numeric_llt,
    factorize_supernodal_numeric_llt_scratch, factorize_supernodal_symbolic_cholesky,
    factorize_supernodal_symbolic_cholesky_scratch,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use glam::DVec3;

/// `P A Pᵀ = L Lᵀ`.
pub struct Cholesky {
    /// Old number of each new node.
    order: Vec<u32>,
    /// The permuted matrix by columns, both triangles: the diagonal first, then the row of `Matrix` in its order.
    starts: Vec<u32>,
    rows: Vec<u32>,
    values: Vec<f64>,
    symbolic: SymbolicSupernodalCholesky<u32>,
    /// Empty between factorisations: the solves only need the rearranged copy.
    factor: Vec<f64>,
    packed: Packed,
    scratch: MemBuffer,
    /// The matrix was multiplied by this, to stay within the range of single precision.
    scale: f64,
}

impl Cholesky {
    /// Orders, analyses and factors.
    pub fn new(matrix: &Matrix, positions: Option<&[DVec3]>) -> Result<Cholesky, Error> {
        let order = match positions {
            Some(positions) => nested_dissection(matrix, positions),
            None => nested_dissection(matrix, &landmarks(matrix)),
        };
        Cholesky::with_order(matrix, postorder(matrix, order))
    }

    /// Analyses and factors in a given order.
    pub fn with_order(matrix: &Matrix, order: Vec<u32>) -> Result<Cholesky, Error> {
        let n = matrix.nodes();
        let (starts, rows) = permuted_pattern(matrix, &order);
        // SAFETY: the pattern comes from a valid one by a permutation, so every row is below n and no entry repeats.
        let pattern = unsafe { SymbolicSparseColMatRef::new_unchecked(n, n, &starts, None, &rows) };
        let mut tree = vec![0i32; n];
        let mut counts = vec![0u32; n];
        let requirement = prefactorize_symbolic_cholesky_scratch::<u32>(n, rows.len())
            .or(factorize_supernodal_symbolic_cholesky_scratch::<u32>(n));
        let mut scratch = MemBuffer::try_new(requirement).map_err(|_| Error::Memory)?;
        let tree =
            prefactorize_symbolic_cholesky(&mut tree, &mut counts, pattern, MemStack::new(&mut scratch));
        let symbolic = factorize_supernodal_symbolic_cholesky(
            pattern,
            tree,
            &counts,
            MemStack::new(&mut scratch),
            Default::default(),
        )
        .map_err(|_| Error::Memory)?;
        let requirement =
            factorize_supernodal_numeric_llt_scratch::<u32, f64>(&symbolic, Par::Seq, Default::default());
        let packed = Packed::new(&symbolic, &order);
        let mut cholesky = Cholesky {
            order,
            values: vec![0.0; rows.len()],
            starts,
            rows,
            symbolic,
            packed,
            factor: Vec::new(),
            scratch: MemBuffer::try_new(requirement).map_err(|_| Error::Memory)?,
            scale: 1.0,
        };
        cholesky.refresh(matrix)?;
        Ok(cholesky)
    }

    /// Factors new values on the same pattern.
    pub fn refresh(&mut self, matrix: &Matrix) -> Result<(), Error> {
        let n = matrix.nodes();
        self.scale = n as f64 / matrix.diagonal().iter().sum::<f64>();
        for (c, &i) in self.order.iter().enumerate() {
            let column = &mut self.values[self.starts[c] as usize..self.starts[c + 1] as usize];
            column[0] = self.scale * matrix.diagonal()[i as usize];
            for (to, from) in column[1..].iter_mut().zip(matrix.row(i as usize).1) {
                *to = self.scale * from;
            }
        }
        let entries = self.symbolic.len_val();
        self.factor.try_reserve_exact(entries).map_err(|_| Error::Memory)?;
        self.factor.resize(entries, 0.0);
        // SAFETY: as in `with_order`.
        let pattern = unsafe { SymbolicSparseColMatRef::new_unchecked(n, n, &self.starts, None, &self.rows) };
        factorize_supernodal_numeric_llt(
            &mut self.factor,
            SparseColMatRef::new(pattern, &self.values),
            Default::default(),
            &self.symbolic,
            Par::Seq,
            MemStack::new(&mut self.scratch),
            Default::default(),
        )
        .map_err(|LltError::NonPositivePivot { index }| Error::NotPositive {
            node: self.order.get(index).copied(),
        })?;
        self.packed.refresh(SupernodalLltRef::new(&self.symbolic, &self.factor));
        self.factor = Vec::new();
        Ok(())
    }

    /// `x = A⁻¹ b` all in single precision, for numbers around one.
    pub fn apply_single(&mut self, b: &[f32], x: &mut [f32]) {
        let scale = self.scale as f32;
        self.packed.solve(|i| b[i], |i, found| x[i] = found * scale);
    }

    /// Entries of the factor.
    pub fn entries(&self) -> usize {
        self.symbolic.len_val()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.packed.bytes() + 12 * self.rows.len() + 8 * self.order.len() + 4 * self.symbolic.row_idx().len()
    }
}

impl Preconditioner for Cholesky {
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], sums: &mut Sums) -> f64 {
        let Some(down) = power_below(size) else {
            z.copy_from_slice(r);
            return size * size;
        };
        let up = self.scale / down;
        self.packed.solve(|i| (r[i] * down) as f32, |i, found| z[i] = f64::from(found) * up);
        dot(z, r, sums)
    }
}

/// The pattern of the permuted matrix, as described in [`Cholesky`].
fn permuted_pattern(matrix: &Matrix, order: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let place = inverse(order);
    let mut starts = Vec::with_capacity(order.len() + 1);
    let mut rows = Vec::with_capacity(order.len() + matrix.columns().len());
    starts.push(0);
    for (c, &i) in order.iter().enumerate() {
        rows.push(c as u32);
        rows.extend(matrix.row(i as usize).0.iter().map(|&j| place[j as usize]));
        starts.push(rows.len() as u32);
    }
    (starts, rows)
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut place = vec![0; order.len()];
    for (new, &old) in order.iter().enumerate() {
        place[old as usize] = new as u32;
    }
    place
}

/// The same fill in an order that visits each subtree of the elimination tree in one piece, so that columns of
/// equal pattern become neighbours (Liu 1990).
pub fn postorder(matrix: &Matrix, order: Vec<u32>) -> Vec<u32> {
    const NONE: u32 = u32::MAX;
    let n = order.len();
    let place = inverse(&order);
    let mut parent = vec![NONE; n];
    let mut ancestor = vec![NONE; n];
    for j in 0..n {
        for &i in matrix.row(order[j] as usize).0 {
            let mut k = place[i as usize] as usize;
            while k < j {
                let next = std::mem::replace(&mut ancestor[k], j as u32);
                if next == NONE {
                    parent[k] = j as u32;
                    break;
                }
                k = next as usize;
            }
        }
    }
    // Children as linked lists, the lowest first; roots hang on n.
    let mut first = vec![NONE; n + 1];
    let mut next = vec![NONE; n];
    for k in (0..n).rev() {
        let up = (parent[k] as usize).min(n);
        next[k] = first[up];
        first[up] = k as u32;
    }
    let mut sequence = Vec::with_capacity(n);
    let mut stack = vec![n as u32];
    while let Some(&k) = stack.last() {
        let child = first[k as usize];
        if child != NONE {
            first[k as usize] = next[child as usize];
            stack.push(child);
        } else {
            stack.pop();
            if k as usize != n {
                sequence.push(order[k as usize]);
            }
        }
    }
    sequence
}
