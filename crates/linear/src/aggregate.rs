//! Coarser networks by smoothed aggregation (Vaněk, Mandel & Brezina 1996): sets of near nodes become one node, whose value is
//! interpolated to them and, smoothed, a little beyond.

/// No node; a node that goes into no aggregate.
pub const NONE: u32 = u32::MAX;

/// Nodes are near if `|a_ij|` is at least this share of `sqrt(a_ii a_jj)`.
const NEAR: f64 = 0.02;
/// The damping of the interpolation's smoothing that damps best when eigenvalues reach up to the bound: 4/3.
const DAMPING: f64 = 4.0 / 3.0;

/// Rows of a matrix during set-up.
#[derive(Debug, PartialEq)]
pub struct Rows {
    /// Where each row starts, length rows + 1.
    pub starts: Vec<u32>,
    /// Columns of the entries.
    pub columns: Vec<u32>,
    /// The entries.
    pub values: Vec<f64>,
}

/// A symmetric matrix during set-up: rows without the diagonal, and the diagonal.
#[derive(Debug, PartialEq)]
pub struct Sparse {
    /// The rows off the diagonal.
    pub rows: Rows,
    /// The diagonal.
    pub diagonal: Vec<f64>,
}

impl Rows {
    /// Room for `count` rows.
    pub fn with_room(count: usize) -> Rows {
        let mut starts = Vec::with_capacity(count + 1);
        starts.push(0);
        Rows { starts, columns: Vec::new(), values: Vec::new() }
    }

    /// Number of rows.
    pub fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Columns and entries of row `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (u32, f64)> + Clone {
        let range = self.starts[i] as usize..self.starts[i + 1] as usize;
        self.columns[range.clone()].iter().copied().zip(self.values[range].iter().copied())
    }

    /// Adds to an entry of the row being made. `seen` (one per column) remembers where the columns of this row are.
    #[inline(always)]
    pub fn add(&mut self, seen: &mut [u32], column: u32, value: f64) {
        let begin = self.starts.last().map_or(0, |&s| s as usize);
        let at = seen[column as usize] as usize;
        if at >= begin && at < self.columns.len() && self.columns[at] == column {
            self.values[at] += value;
        } else {
            seen[column as usize] = self.columns.len() as u32;
            self.columns.push(column);
            self.values.push(value);
        }
    }

    /// Ends the row being made.
    pub fn end(&mut self) {
        self.starts.push(self.columns.len() as u32);
    }

    /// The transpose, with `count` rows.
    pub fn transpose(&self, count: usize) -> Rows {
        let mut starts = vec![0u32; count + 1];
        for &c in &self.columns {
            starts[c as usize + 1] += 1;
        }
        for c in 0..count {
            starts[c + 1] += starts[c];
        }
        let mut cursor = starts[..count].to_vec();
        let (mut columns, mut values) = (vec![0; self.columns.len()], vec![0.0; self.columns.len()]);
        for i in 0..self.count() {
            for (c, v) in self.row(i) {
                let at = &mut cursor[c as usize];
                (columns[*at as usize], values[*at as usize]) = (i as u32, v);
                *at += 1;
            }
        }
        Rows { starts, columns, values }
    }
}

impl Sparse {
    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.diagonal.len()
    }

    fn near(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let least = NEAR * NEAR * self.diagonal[i];
        let near = move |&(j, a): &(u32, f64)| a * a >= least * self.diagonal[j as usize];
        self.rows.row(i).filter(near).map(|(j, a)| (j as usize, a.abs()))
    }

    /// The aggregate of each node and the number of aggregates. A node without near nodes goes into none: sweeps alone
    /// solve for it.
    pub fn aggregates(&self) -> (Vec<u32>, usize) {
        let n = self.nodes();
        let mut of = vec![NONE; n];
        let mut count = 0;
        // Nodes whose near nodes are all free make an aggregate with them.
        for i in 0..n {
            if of[i] == NONE && self.near(i).next().is_some() && self.near(i).all(|(j, _)| of[j] == NONE) {
                of[i] = count;
                self.near(i).for_each(|(j, _)| of[j] = count);
                count += 1;
            }
        }
        // The others join the aggregate of the node they are tied to most.
        let first = of.clone();
        for i in (0..n).filter(|&i| first[i] == NONE) {
            let mut most = 0.0;
            for (j, a) in self.near(i) {
                if first[j] != NONE && a > most {
                    (most, of[i]) = (a, first[j]);
                }
            }
        }
        // Those that are left are among themselves.
        for i in 0..n {
            if of[i] == NONE && self.near(i).next().is_some() {
                of[i] = count;
                for (j, _) in self.near(i) {
                    if of[j] == NONE {
                        of[j] = count;
                    }
                }
                count += 1;
            }
        }
        (of, count as usize)
    }

    /// The interpolation `P = (I - w A) T` from `count` aggregates, `T` being one for a node's own aggregate and zero for others,
    /// `w_i = 4/3 / sum_j |a_ij|`.
    pub fn interpolation(&self, of: &[u32], count: usize) -> Rows {
        let mut p = Rows::with_room(self.nodes());
        let mut seen = vec![NONE; count];
        for i in 0..self.nodes() {
            let bound = self.diagonal[i] + self.rows.row(i).map(|(_, a)| a.abs()).sum::<f64>();
            let w = DAMPING / bound;
            if of[i] != NONE {
                p.add(&mut seen, of[i], 1.0 - w * self.diagonal[i]);
            }
            for (j, a) in self.rows.row(i) {
                if of[j as usize] != NONE {
                    p.add(&mut seen, of[j as usize], -w * a);
                }
            }
            p.end();
        }
        p
    }

    /// `Pᵀ A P`, given `P` and its transpose.
    pub fn coarse(&self, p: &Rows, transposed: &Rows) -> Sparse {
        let count = transposed.count();
        let mut ap = Rows::with_room(self.nodes());
        let mut seen = vec![NONE; count];
        for i in 0..self.nodes() {
            for (j, a) in std::iter::once((i as u32, self.diagonal[i])).chain(self.rows.row(i)) {
                for (c, w) in p.row(j as usize) {
                    ap.add(&mut seen, c, a * w);
                }
            }
            ap.end();
        }
        let mut rows = Rows::with_room(count);
        let mut diagonal = vec![0.0; count];
        seen.fill(NONE);
        for c in 0..count {
            for (i, w) in transposed.row(c) {
                for (d, v) in ap.row(i as usize) {
                    if d as usize == c {
                        diagonal[c] += w * v;
                    } else {
                        rows.add(&mut seen, d, w * v);
                    }
                }
            }
            rows.end();
        }
        Sparse { rows, diagonal }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of `n` nodes, each tied to the next by one, with `excess` on the diagonal.
    fn ring(n: usize, excess: f64) -> Sparse {
        let mut rows = Rows::with_room(n);
        let mut seen = vec![NONE; n];
        for i in 0..n {
            rows.add(&mut seen, ((i + 1) % n) as u32, -1.0);
            rows.add(&mut seen, ((i + n - 1) % n) as u32, -1.0);
            rows.end();
        }
        Sparse { rows, diagonal: vec![2.0 + excess; n] }
    }

    #[test]
    fn near_nodes_make_an_aggregate_and_the_rest_joins() {
        assert_eq!(ring(8, 0.0).aggregates(), (vec![0, 0, 1, 1, 1, 1, 0, 0], 2));
        assert_eq!(ring(3, 1e4).aggregates(), (vec![NONE; 3], 0), "heavy nodes are left alone");
    }

    #[test]
    fn a_constant_is_interpolated_exactly_and_carries_no_flow() {
        let ring = ring(30, 0.0);
        let (of, count) = ring.aggregates();
        let p = ring.interpolation(&of, count);
        for i in 0..30 {
            assert!((p.row(i).map(|(_, w)| w).sum::<f64>() - 1.0).abs() < 1e-15);
        }
        let coarse = ring.coarse(&p, &p.transpose(count));
        for c in 0..count {
            let sum = coarse.diagonal[c] + coarse.rows.row(c).map(|(_, a)| a).sum::<f64>();
            assert!(coarse.diagonal[c] > 0.1 && sum.abs() < 1e-14, "{sum}");
        }
        // A few entries by hand: P of a node inside its aggregate, and beside another one.
        assert_eq!(p.row(0).collect::<Vec<_>>(), [(0, 1.0 - 4.0 / 6.0 + 4.0 / 6.0)]);
        let beside = p.row(1).collect::<Vec<_>>();
        assert_eq!(beside.len(), 2);
        assert!((beside[0].1 - 2.0 / 3.0).abs() < 1e-15 && (beside[1].1 - 1.0 / 3.0).abs() < 1e-15);
    }

    #[test]
    fn transposing_twice_changes_nothing() {
        let ring = ring(12, 0.5);
        let (of, count) = ring.aggregates();
        let p = ring.interpolation(&of, count);
        let transposed = p.transpose(count);
        assert!(transposed.row(0).any(|(i, _)| i == 1));
        // Rows come back sorted.
        let back = transposed.transpose(12);
        for i in 0..12 {
            let mut row: Vec<_> = p.row(i).collect();
            row.sort_by_key(|e| e.0);
            assert_eq!(back.row(i).collect::<Vec<_>>(), row);
        }
    }
}
