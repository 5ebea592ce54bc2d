//! The finest level of the multigrid: clusters solved exactly, one after the other in the same sense as Jacobi's points.
//!
//! With `D` the matrix without the throats between clusters and `N` those throats, `A = D - N`, a cycle is
//! `x = D⁻¹ b`; `e`, one value per cluster, from the coarser levels for the residual `N x`; `x + e + D⁻¹ (N x - A e)`.
//! Both `N x` and `A e` only know throats between clusters, so the strong ones inside enter through the exact `D⁻¹` alone.

use crate::Matrix;
use crate::aggregate::{NONE, Rows, Sparse};
use crate::clusters::{LARGEST, Star, clusters};
use crate::vector::{ALONE, CHUNK, each};
use rayon::prelude::*;
use std::ops::Range;

/// The finest level. Nodes are numbered cluster by cluster, each cluster in the order of its elimination.
pub struct Finest {
    /// The number in the matrix of each node; the node and the cluster of each number in the matrix.
    order: Vec<u32>,
    place: Vec<u32>,
    cluster: Vec<u32>,
    /// First node of each cluster, length clusters + 1.
    starts: Vec<u32>,
    /// The first cluster of each of the parts that threads take, and the end.
    parts: Vec<u32>,
    /// `D = (I - T)⁻¹ diag(1 / inverse) (I - T)⁻ᵀ` with `T` by columns: which share of what enters a node goes on to which node.
    takes: Vec<u32>,
    targets: Vec<u32>,
    shares: Vec<f32>,
    inverse: Vec<f32>,
    /// The throats between clusters, by rows.
    bounds: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
    /// What the rows of the matrix sum to.
    excess: Vec<f32>,
    /// `D⁻¹ b`, then the answer without `e`; `D⁻¹ b + e`.
    x: Vec<f32>,
    raised: Vec<f32>,
}

impl Finest {
    /// The finest level of `scale A`, and the matrix of the network of clusters.
    pub fn new(matrix: &Matrix, scale: f64) -> (Finest, Sparse) {
        let n = matrix.nodes();
        let (cluster, count) = clusters(matrix);
        let mut starts = vec![0u32; count + 1];
        for &c in &cluster {
            starts[c as usize + 1] += 1;
        }
        for c in 0..count {
            starts[c + 1] += starts[c];
        }
        let mut cursor = starts[..count].to_vec();
        let (mut order, mut place) = (vec![0u32; n], vec![0u32; n]);
        for (i, &c) in cluster.iter().enumerate() {
            let at = &mut cursor[c as usize];
            (order[*at as usize], place[i]) = (i as u32, *at);
            *at += 1;
        }
        let mut parts = vec![0];
        for c in 1..count {
            let begin = parts.last().map_or(0, |&p| starts[p as usize]);
            if starts[c] - begin >= CHUNK as u32 {
                parts.push(c as u32);
            }
        }
        parts.push(count as u32);
        let mut finest = Finest {
            order,
            place,
            cluster,
            starts,
            parts,
            takes: vec![0],
            targets: Vec::with_capacity(2 * n),
            shares: Vec::with_capacity(2 * n),
            inverse: Vec::with_capacity(n),
            bounds: vec![0],
            columns: Vec::new(),
            values: Vec::new(),
            excess: Vec::new(),
            x: vec![0.0; n],
            raised: vec![0.0; n],
        };
        finest.factor(matrix, scale);
        finest.excess = finest.order.iter().map(|&i| (matrix.excess()[i as usize] * scale) as f32).collect();
        let coarse = finest.join(matrix, scale);
        (finest, coarse)
    }

    /// Factors every cluster and puts its nodes in the order of their elimination.
    fn factor(&mut self, matrix: &Matrix, scale: f64) {
        let mut star = Star::new();
        let (mut old, mut now) = ([0u32; LARGEST], [0u32; LARGEST]);
        for c in 0..self.starts.len() - 1 {
            let range = self.starts[c] as usize..self.starts[c + 1] as usize;
            let (first, size) = (range.start, range.len());
            old[..size].copy_from_slice(&self.order[range]);
            for k in 0..size {
                let i = old[k] as usize;
                star.begin(k, matrix.excess()[i] * scale);
                let (js, entries) = matrix.row(i);
                for (&j, &a) in js.iter().zip(entries).filter(|(_, a)| **a != 0.0) {
                    if self.cluster[j as usize] as usize == c {
                        star.join(k, self.place[j as usize] as usize - first, -a * scale);
                    } else {
                        star.add_outside(k, -a * scale);
                    }
                }
            }
            let mut left = u64::MAX >> (LARGEST - size);
            let begin = self.targets.len();
            for at in first..first + size {
                let k = star.next(left);
                left &= !(1 << k);
                let total = star.take(k, |m, part| {
                    self.targets.push(m as u32);
                    self.shares.push(part as f32);
                });
                self.inverse.push((1.0 / total) as f32);
                self.takes.push(self.targets.len() as u32);
                self.order[at] = old[k];
                now[k] = at as u32;
            }
            self.targets[begin..].iter_mut().for_each(|t| *t = now[*t as usize]);
            for k in 0..size {
                self.place[old[k] as usize] = now[k];
            }
        }
    }

    /// Collects the throats between clusters and sums them up to the network of clusters.
    fn join(&mut self, matrix: &Matrix, scale: f64) -> Sparse {
        let count = self.starts.len() - 1;
        let mut rows = Rows::with_room(count);
        let mut diagonal = Vec::with_capacity(count);
        let mut seen = vec![NONE; count];
        for c in 0..count {
            let mut sum = 0.0;
            for k in self.starts[c]..self.starts[c + 1] {
                let i = self.order[k as usize] as usize;
                sum += matrix.excess()[i] * scale;
                let (js, entries) = matrix.row(i);
                for (&j, &a) in js.iter().zip(entries) {
                    let (d, a) = (self.cluster[j as usize], a * scale);
                    if d as usize == c || a == 0.0 {
                        continue;
                    }
                    self.columns.push(self.place[j as usize]);
                    self.values.push(-a as f32);
                    sum -= a;
                    rows.add(&mut seen, d, a);
                }
                self.bounds.push(self.columns.len() as u32);
            }
            rows.end();
            diagonal.push(sum);
        }
        Sparse { rows, diagonal }
    }

    /// Entries held.
    pub fn entries(&self) -> usize {
        self.shares.len() + self.inverse.len() + self.columns.len()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (2 * self.shares.len() + 2 * self.columns.len() + 9 * self.order.len() + self.starts.len())
    }

    /// Begins a cycle for the right-hand side `factor r`; writes that of the clusters into `coarse`.
    pub fn down(&mut self, r: &[f64], factor: f64, coarse: &mut [f32]) {
        let mut x = std::mem::take(&mut self.x);
        self.by_part(&mut x, |clusters, x| {
            let start = self.starts[clusters.start] as usize;
            for c in clusters {
                let nodes = self.starts[c] as usize..self.starts[c + 1] as usize;
                for k in nodes.clone() {
                    x[k - start] = (r[self.order[k] as usize] * factor) as f32;
                }
                self.solve(nodes, start, x);
            }
        });
        each(coarse, |c| {
            let throats = self.throats(self.starts[c] as usize, self.starts[c + 1] as usize);
            throats.map(|(j, g)| g * x[j]).sum()
        });
        self.x = x;
    }

    /// Ends the cycle with the correction of the clusters: the answer, times `factor`, goes to `z`.
    pub fn up(&mut self, correction: &[f32], factor: f64, z: &mut [f64]) {
        let (mut x, mut raised) = (std::mem::take(&mut self.x), std::mem::take(&mut self.raised));
        self.by_part(&mut raised, |clusters, raised| {
            let start = self.starts[clusters.start] as usize;
            for c in clusters {
                for k in self.starts[c] as usize..self.starts[c + 1] as usize {
                    raised[k - start] = x[k] + correction[c];
                }
            }
        });
        self.by_part(&mut x, |clusters, x| {
            let start = self.starts[clusters.start] as usize;
            let mut first = [0.0; LARGEST];
            for c in clusters {
                let (nodes, e) = (self.starts[c] as usize..self.starts[c + 1] as usize, correction[c]);
                for (k, first) in nodes.clone().zip(&mut first) {
                    let flow: f32 = self.throats(k, k + 1).map(|(j, g)| g * (raised[j] - e)).sum();
                    *first = std::mem::replace(&mut x[k - start], flow - self.excess[k] * e);
                }
                self.solve(nodes.clone(), start, x);
                for (k, first) in nodes.zip(&first) {
                    x[k - start] += first;
                }
            }
        });
        // Only here do the two parts meet, in double precision: `e` is smooth and large, `x` differs along the strong throats by what
        // rounding `e` to single precision would drown.
        each(z, |i| {
            let e = correction[self.cluster[i] as usize];
            (f64::from(e) + f64::from(x[self.place[i] as usize])) * factor
        });
        (self.x, self.raised) = (x, raised);
    }

    /// The throats to other clusters from the nodes `from..to`.
    #[inline(always)]
    fn throats(&self, from: usize, to: usize) -> impl Iterator<Item = (usize, f32)> {
        let range = self.bounds[from] as usize..self.bounds[to] as usize;
        self.columns[range.clone()].iter().zip(&self.values[range]).map(|(&j, &g)| (j as usize, g))
    }

    /// `x = D⁻¹ x` for the nodes of one cluster; `x` begins at the node `start`.
    #[inline(always)]
    fn solve(&self, nodes: Range<usize>, start: usize, x: &mut [f32]) {
        for k in nodes.clone() {
            let range = self.takes[k] as usize..self.takes[k + 1] as usize;
            let enters = x[k - start];
            for (&t, share) in self.targets[range.clone()].iter().zip(&self.shares[range]) {
                x[t as usize - start] += share * enters;
            }
            x[k - start] = enters * self.inverse[k];
        }
        for k in nodes.rev() {
            let range = self.takes[k] as usize..self.takes[k + 1] as usize;
            let shares = self.targets[range.clone()].iter().zip(&self.shares[range]);
            x[k - start] += shares.map(|(&t, share)| share * x[t as usize - start]).sum::<f32>();
        }
    }

    /// Calls `f` with the clusters of each part and the entries of `x` at their nodes.
    fn by_part(&self, x: &mut [f32], f: impl Fn(Range<usize>, &mut [f32]) + Sync) {
        if x.len() < ALONE {
            return f(0..self.starts.len() - 1, x);
        }
        let mut slices = Vec::with_capacity(self.parts.len());
        let mut rest = x;
        for part in self.parts.windows(2) {
            let clusters = part[0] as usize..part[1] as usize;
            let nodes = self.starts[clusters.end] - self.starts[clusters.start];
            let (slice, after) = rest.split_at_mut(nodes as usize);
            slices.push((clusters, slice));
            rest = after;
        }
        slices.into_par_iter().for_each(|(clusters, slice)| f(clusters, slice));
    }
}
