//! Coarse networks: nodes joined in pairs along their strongest throats, and the pairs in pairs once more
//! (Notay 2010), the values summed.

/// A node left out of the coarse network: its own diagonal is so heavy that a smoothing sweep solves it.
pub const NONE: u32 = u32::MAX;

/// A neighbour is strong from this share of the strongest one on.
const STRONG: f64 = 0.25;

/// A node whose row sums to this many times its conductances needs no coarse correction.
const HEAVY: f64 = 4.0;

/// A network during set-up: conductances (positive) and what each row sums to, in double precision.
pub struct Graph {
    /// Where each row starts, length n + 1.
    pub starts: Vec<u32>,
    /// The neighbours.
    pub columns: Vec<u32>,
    /// Their conductances.
    pub values: Vec<f64>,
    /// Row sums of the matrix.
    pub excess: Vec<f64>,
}

impl Graph {
    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.excess.len()
    }

    /// Neighbours and conductances of node `i`.
    pub fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let range = self.starts[i] as usize..self.starts[i + 1] as usize;
        (&self.columns[range.clone()], &self.values[range])
    }

    /// The aggregate of up to four nodes each node goes into (or [`NONE`]), numbered by their lowest node, and the
    /// coarse network.
    pub fn coarsen(&self) -> (Vec<u32>, Graph) {
        let (mut first, pairs) = self.pair();
        let middle = self.merge(&first, pairs);
        let (second, fours) = middle.pair();
        for a in first.iter_mut().filter(|a| **a != NONE) {
            *a = second[*a as usize];
        }
        let coarse = middle.merge(&second, fours);
        (first, coarse)
    }

    /// Pairs the nodes: first those that are each other's strongest neighbour, so that no outlying conductance is left
    /// between two pairs, then each node left with its strongest free neighbour, in the order of the nodes.
    fn pair(&self) -> (Vec<u32>, usize) {
        const FREE: u32 = u32::MAX - 1;
        let n = self.nodes();
        let mut strongest = vec![(0.0, NONE); n];
        let mut mate = vec![FREE; n];
        for i in 0..n {
            let (columns, values) = self.row(i);
            for (&j, &g) in columns.iter().zip(values) {
                if g > strongest[i].0 {
                    strongest[i] = (g, j);
                }
            }
            if self.excess[i] >= HEAVY * values.iter().sum::<f64>() {
                mate[i] = NONE;
            }
        }
        for i in 0..n {
            let j = strongest[i].1 as usize;
            if j < n && strongest[j].1 as usize == i && mate[i] == FREE && mate[j] == FREE {
                (mate[i], mate[j]) = (j as u32, i as u32);
            }
        }
        let mut pair = vec![NONE; n];
        let mut count = 0;
        for i in 0..n {
            if mate[i] == NONE || pair[i] != NONE {
                continue;
            }
            if mate[i] == FREE {
                let (columns, values) = self.row(i);
                let mut best = (0.0, i as u32);
                for (&j, &g) in columns.iter().zip(values) {
                    if g > best.0 && mate[j as usize] == FREE {
                        best = (g, j);
                    }
                }
                let other = if best.0 >= STRONG * strongest[i].0 { best.1 } else { i as u32 };
                mate[i] = other;
                mate[other as usize] = i as u32;
            }
            pair[mate[i] as usize] = count;
            pair[i] = count;
            count += 1;
        }
        (pair, count as usize)
    }

    /// The network of `count` aggregates.
    fn merge(&self, aggregate: &[u32], count: usize) -> Graph {
        let mut excess = vec![0.0; count];
        // Nodes by aggregate.
        let mut first = vec![0u32; count + 1];
        for &a in aggregate.iter().filter(|a| **a != NONE) {
            first[a as usize + 1] += 1;
        }
        for a in 0..count {
            first[a + 1] += first[a];
        }
        let mut cursor = first.clone();
        let mut members = vec![0u32; first[count] as usize];
        for (i, &a) in aggregate.iter().enumerate().filter(|(_, a)| **a != NONE) {
            members[cursor[a as usize] as usize] = i as u32;
            cursor[a as usize] += 1;
        }
        let mut starts = Vec::with_capacity(count + 1);
        starts.push(0);
        let mut columns: Vec<u32> = Vec::with_capacity(self.columns.len() / 2);
        let mut values: Vec<f64> = Vec::with_capacity(self.columns.len() / 2);
        let mut place = vec![NONE; count]; // where the column sits in the row being made
        for a in 0..count {
            let start = columns.len();
            for &i in &members[first[a] as usize..first[a + 1] as usize] {
                excess[a] += self.excess[i as usize];
                let (neighbours, conductances) = self.row(i as usize);
                for (&j, &g) in neighbours.iter().zip(conductances) {
                    let c = aggregate[j as usize];
                    if c == NONE {
                        // The neighbour stays where it is while this level is corrected.
                        excess[a] += g;
                    } else if c != a as u32 {
                        let at = place[c as usize] as usize;
                        if at >= start && at < columns.len() && columns[at] == c {
                            values[at] += g;
                        } else {
                            place[c as usize] = columns.len() as u32;
                            columns.push(c);
                            values.push(g);
                        }
                    }
                }
            }
            starts.push(columns.len() as u32);
        }
        Graph { starts, columns, values, excess }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strong_pairs_join_and_values_add_up() {
        // A chain 0 - 1 = 2 - 3 = 4 - 5, node 6 heavy on its own and hanging on 5.
        let g = [1.0, 9.0, 1.0, 9.0, 1.0, 0.5];
        let mut starts = vec![0];
        let (mut columns, mut values) = (vec![], vec![]);
        for i in 0..7usize {
            for j in [i.wrapping_sub(1), i + 1] {
                if j < 7 {
                    columns.push(j as u32);
                    values.push(g[i.min(j)]);
                }
            }
            starts.push(columns.len() as u32);
        }
        let graph = Graph { starts, columns, values, excess: vec![0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 7.0] };
        let (pair, count) = graph.pair();
        assert_eq!((pair, count), (vec![0, 1, 1, 2, 2, 3, NONE], 4));
        let (aggregate, coarse) = graph.coarsen();
        assert_eq!(aggregate, [0, 0, 0, 1, 1, 1, NONE]);
        assert_eq!(coarse.row(0), (&[1][..], &[1.0][..]));
        assert_eq!(coarse.row(1), (&[0][..], &[1.0][..]));
        assert_eq!(coarse.excess, [0.1, 0.5]);
    }
}
