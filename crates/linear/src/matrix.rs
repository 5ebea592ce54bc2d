//! The matrix of a pore network: pattern once, values as often as the conductances change.

use crate::Error;
use crate::conjugate_gradients::Operator;
use crate::fours::Fours;
use crate::vector::{self, CHUNK, Sums};

/// As the second end of a throat: a pore whose pressure is given. Its conductance then goes to the diagonal only;
/// the caller adds conductance times pressure to the right-hand side.
pub const FIXED: u32 = u32::MAX;

/// A throat's place in `values`: none, because one end is held or both ends are the same node.
const NO_SLOT: u32 = u32::MAX;

/// A symmetric matrix by rows, the diagonal apart: `A_ij = -g_ij`, `A_ii = sum_j g_ij + extra_i`.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    starts: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f64>,
    diagonal: Vec<f64>,
    fours: Fours,
    /// What a row sums to: given diagonal plus conductances to held pores.
    excess: Vec<f64>,
    ends: Vec<[u32; 2]>,
    /// Where throat `t` sits in the rows of its first and of its second end.
    slots: Vec<[u32; 2]>,
}

impl Matrix {
    /// The matrix of `nodes` nodes joined by throats `ends` (length t) of conductances `conductance` (length t,
    /// finite, not negative), with `extra` (length `nodes`, finite, not negative) added to the diagonal.
    ///
    /// Several throats may join the same two nodes: they add up. An end may be [`FIXED`].
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Node`], [`Error::Value`]; [`Error::Memory`] beyond 2³¹ throats.
    pub fn new(nodes: usize, ends: &[[u32; 2]], conductance: &[f64], extra: &[f64]) -> Result<Matrix, Error> {
        if ends.len() >= 1 << 31 || nodes >= FIXED as usize {
            return Err(Error::Memory);
        }
        for (throat, pair) in ends.iter().enumerate() {
            for &node in pair {
                if node != FIXED && node as usize >= nodes {
                    return Err(Error::Node { throat, node });
                }
            }
        }
        let joins = |[i, j]: [u32; 2]| i != FIXED && j != FIXED && i != j;

        // Two counting sorts: by column, then by row, so that each row comes out sorted by column.
        let mut starts = vec![0u32; nodes + 1];
        for &pair in ends {
            if joins(pair) {
                starts[pair[0] as usize + 1] += 1;
                starts[pair[1] as usize + 1] += 1;
            }
        }
        for i in 0..nodes {
            starts[i + 1] += starts[i];
        }
        let entries = starts[nodes] as usize;
        let mut cursor = starts[..nodes].to_vec();
        let mut by_column = vec![0u32; entries]; // throat * 2 + (the column is its second end)
        for (t, &pair) in ends.iter().enumerate() {
            if joins(pair) {
                for end in 0..2 {
                    let at = &mut cursor[pair[end] as usize];
                    by_column[*at as usize] = 2 * t as u32 + end as u32;
                    *at += 1;
                }
            }
        }
        cursor.copy_from_slice(&starts[..nodes]);
        let mut columns = vec![0u32; entries];
        let mut slots = vec![[NO_SLOT; 2]; ends.len()];
        for &entry in &by_column {
            let (t, end) = (entry as usize / 2, entry as usize % 2);
            let (row, column) = (ends[t][1 - end] as usize, ends[t][end]);
            columns[cursor[row] as usize] = column;
            slots[t][1 - end] = cursor[row];
            cursor[row] += 1;
        }
        drop(by_column);
        merge_repeats(&mut starts, &mut columns, &mut slots);

        let mut matrix = Matrix {
            values: vec![0.0; columns.len()],
            diagonal: vec![0.0; nodes],
            fours: Fours::default(),
            excess: vec![0.0; nodes],
            starts,
            columns,
            ends: ends.to_vec(),
            slots,
        };
        matrix.refresh(conductance, extra)?;
        Ok(matrix)
    }

    /// New values on the same throats, with the meaning and the errors of [`Matrix::new`].
    /// On an error the values are left unusable until a refresh succeeds.
    pub fn refresh(&mut self, conductance: &[f64], extra: &[f64]) -> Result<(), Error> {
        let n = self.diagonal.len();
        if conductance.len() != self.ends.len() {
            let (found, expected) = (conductance.len(), self.ends.len());
            return Err(Error::Length { what: "conductance", found, expected });
        }
        if extra.len() != n {
            return Err(Error::Length { what: "extra diagonal", found: extra.len(), expected: n });
        }
        for (what, array) in [("conductance", conductance), ("extra diagonal", extra)] {
            if let Some(index) = array.iter().position(|&v| !(v >= 0.0 && v.is_finite())) {
                return Err(Error::Value { what, index, value: array[index] });
            }
        }
        self.values.fill(0.0);
        self.excess.copy_from_slice(extra);
        for ((&[i, j], slots), &g) in self.ends.iter().zip(&self.slots).zip(conductance) {
            if slots[0] != NO_SLOT {
                self.values[slots[0] as usize] -= g;
                self.values[slots[1] as usize] -= g;
            } else if i != j {
                // Exactly one end is held, since both held means i == j.
                self.excess[i.min(j) as usize] += g;
            }
        }
        for i in 0..n {
            let row = self.starts[i] as usize..self.starts[i + 1] as usize;
            self.diagonal[i] = self.excess[i] - self.values[row].iter().sum::<f64>();
            if !self.diagonal[i].is_finite() {
                return Err(Error::Value { what: "diagonal", index: i, value: self.diagonal[i] });
            }
        }
        let range = |ends: &[u32]| ends[0] as usize..ends[1] as usize;
        let rows = self.starts.windows(2).map(range);
        self.fours.refresh(rows.map(|row| (&self.columns[row.clone()], &self.values[row])));
        Ok(())
    }

    /// Number of unknowns n.
    #[inline]
    pub fn nodes(&self) -> usize {
        self.diagonal.len()
    }

    /// Row `i` off the diagonal: columns (sorted) and entries `-g_ij`.
    #[inline]
    pub fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let range = self.starts[i] as usize..self.starts[i + 1] as usize;
        (&self.columns[range.clone()], &self.values[range])
    }

    /// `y = A x` for one chunk of rows.
    #[inline(always)]
    fn product(&self, chunk: usize, x: &[f64], y: &mut [f64]) {
        self.fours.chunk(chunk, x, y, 1.0, |i, sum| self.diagonal[i] * x[i] + sum);
    }

    /// Where each row starts in [`Matrix::columns`] and [`Matrix::values`], length n + 1.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// Column of each entry off the diagonal.
    pub fn columns(&self) -> &[u32] {
        &self.columns
    }

    /// Entries off the diagonal, `-g_ij`.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The diagonal `A_ii`, length n.
    pub fn diagonal(&self) -> &[f64] {
        &self.diagonal
    }

    /// The sum of each row: given diagonal plus conductances to held pores, length n.
    pub fn excess(&self) -> &[f64] {
        &self.excess
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let numbers =
            4 * self.starts.len() + 12 * self.columns.len() + 16 * self.diagonal.len() + 16 * self.ends.len();
        numbers + self.fours.bytes()
    }
}

impl Operator for &Matrix {
    fn nodes(&self) -> usize {
        self.diagonal.len()
    }

    fn apply(&mut self, x: &[f64], y: &mut [f64]) {
        vector::by_part(y, CHUNK, |first, y| self.product(first / CHUNK, x, y));
    }

    fn residual(&mut self, b: &[f64], x: &[f64], r: &mut [f64], sums: &mut Sums) -> [f64; 2] {
        let [rr, bb, _] = vector::chunks_and_sum(r, sums, |chunk, r| {
            self.fours.chunk(chunk, x, r, -1.0, |i, sum| b[i] - (self.diagonal[i] * x[i] + sum));
            let b = &b[chunk * CHUNK..][..r.len()];
            [vector::chunk_dot(r, r), vector::chunk_dot(b, b), 0.0]
        });
        [rr, bb]
    }

    fn apply_dots(&mut self, p: &[f64], r: &[f64], q: &mut [f64], sums: &mut Sums) -> [f64; 3] {
        vector::chunks_and_sum(q, sums, |chunk, q| {
            self.product(chunk, p, q);
            let (p, r) = (&p[chunk * CHUNK..][..q.len()], &r[chunk * CHUNK..][..q.len()]);
            vector::chunk_dots(p, r, q)
        })
    }
}

/// Entries of a row with the same column become one; the slots follow.
fn merge_repeats(starts: &mut [u32], columns: &mut Vec<u32>, slots: &mut [[u32; 2]]) {
    let n = starts.len() - 1;
    let repeats =
        (0..n).any(|i| columns[starts[i] as usize..starts[i + 1] as usize].windows(2).any(|w| w[0] == w[1]));
    if !repeats {
        return;
    }
    let mut moved = vec![0u32; columns.len()];
    let mut kept = 0usize;
    let mut begin = 0usize;
    for i in 0..n {
        let end = starts[i + 1] as usize;
        let first = kept;
        for k in begin..end {
            if kept == first || columns[kept - 1] != columns[k] {
                columns[kept] = columns[k];
                kept += 1;
            }
            moved[k] = kept as u32 - 1;
        }
        begin = end;
        starts[i + 1] = kept as u32;
    }
    columns.truncate(kept);
    for slot in slots.iter_mut().flatten().filter(|slot| **slot != NO_SLOT) {
        *slot = moved[*slot as usize];
    }
}

/// The connected sets of nodes of a matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct Components {
    /// The component of each node, length n; components are numbered by their lowest node.
    pub of: Vec<u32>,
    /// Whether some row of the component sums to more than zero, so that its level is determined.
    pub anchored: Vec<bool>,
}

/// The connected components of `matrix`; a throat of zero conductance connects nothing.
pub fn components(matrix: &Matrix) -> Components {
    let n = matrix.nodes();
    let mut of = vec![u32::MAX; n];
    let mut anchored = Vec::new();
    let mut stack = Vec::new();
    for root in 0..n {
        if of[root] != u32::MAX {
            continue;
        }
        let label = anchored.len() as u32;
        let mut held = false;
        of[root] = label;
        stack.push(root as u32);
        while let Some(i) = stack.pop() {
            held |= matrix.excess[i as usize] > 0.0;
            let (columns, values) = matrix.row(i as usize);
            for (&j, &a) in columns.iter().zip(values) {
                if a != 0.0 && of[j as usize] == u32::MAX {
                    of[j as usize] = label;
                    stack.push(j);
                }
            }
        }
        anchored.push(held);
    }
    Components { of, anchored }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense(matrix: &Matrix) -> Vec<Vec<f64>> {
        let n = matrix.nodes();
        let mut a = vec![vec![0.0; n]; n];
        for i in 0..n {
            a[i][i] = matrix.diagonal()[i];
            let (columns, values) = matrix.row(i);
            for (&j, &v) in columns.iter().zip(values) {
                a[i][j as usize] += v;
            }
        }
        a
    }

    #[test]
    fn throats_assemble_with_repeats_loops_and_held_ends() {
        let ends = [[0, 1], [2, 1], [1, 0], [2, 2], [FIXED, 2], [FIXED, FIXED], [1, 2]];
        let g = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
        let mut matrix = Matrix::new(3, &ends, &g, &[0.5, 0.0, 0.0]).unwrap();
        assert_eq!(dense(&matrix), [vec![5.5, -5.0, 0.0], vec![-5.0, 71.0, -66.0], vec![0.0, -66.0, 82.0]]);
        assert_eq!(matrix.row(1).0, [0, 2]);
        assert_eq!(matrix.excess(), [0.5, 0.0, 16.0]);
        matrix.refresh(&[1.0; 7], &[0.0; 3]).unwrap();
        assert_eq!(matrix, Matrix::new(3, &ends, &[1.0; 7], &[0.0; 3]).unwrap());
        let mut y = [0.0; 3];
        (&matrix).apply(&[1.0, 2.0, 4.0], &mut y);
        assert_eq!(y, [-2.0, -2.0, 8.0]);
    }

    #[test]
    fn bad_input_is_named() {
        let new =
            |ends: [u32; 2], g: f64, extra: f64| Matrix::new(2, &[[0, 1], ends], &[1.0, g], &[0.0, extra]);
        assert_eq!(new([0, 2], 1.0, 0.0), Err(Error::Node { throat: 1, node: 2 }));
        assert_eq!(new([0, 1], -1.0, 0.0), Err(Error::Value { what: "conductance", index: 1, value: -1.0 }));
        assert!(matches!(
            new([0, 1], f64::NAN, 0.0),
            Err(Error::Value { what: "conductance", index: 1, .. })
        ));
        assert!(matches!(
            new([0, 1], 1.0, f64::INFINITY),
            Err(Error::Value { what: "extra diagonal", index: 1, .. })
        ));
        assert!(matches!(Matrix::new(2, &[[0, 1]], &[], &[0.0; 2]), Err(Error::Length { .. })));
        assert!(matches!(Matrix::new(2, &[[0, 1]], &[1.0], &[0.0; 3]), Err(Error::Length { .. })));
        assert!(matches!(Matrix::new(2, &[[0, 1]], &[f64::MAX], &[f64::MAX; 2]), Err(Error::Value { .. })));
    }

    #[test]
    fn components_see_zero_conductances_and_anchors() {
        let matrix =
            Matrix::new(5, &[[0, 1], [1, 2], [3, 4], [4, FIXED]], &[1.0, 0.0, 1.0, 0.1], &[0.0; 5]).unwrap();
        let found = components(&matrix);
        assert_eq!(found.of, [0, 0, 1, 2, 2]);
        assert_eq!(found.anchored, [false, false, true]);
    }
}
