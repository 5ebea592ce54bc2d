//! The finest level of the multigrid: clusters solved exactly, one after the other in the same sense as Jacobi's points.
//!
//! With `D` the matrix without the throats between clusters and `N` those throats, `A = D - N`, a cycle is
//! `x = D⁻¹ b`; `e`, one value per cluster, from the coarser levels for the residual `N x`; `x + e + D⁻¹ (N x - A e)`.
//! Both `N x` and `A e` only know throats between clusters, so the strong ones inside enter through the exact `D⁻¹` alone.

use crate::Matrix;
use crate::aggregate::{NONE, Rows, Sparse};
use crate::clusters::{LARGEST, Star, clusters};
use crate::vector::{CHUNK, Sums, alone, chunk_dot, each_and_sum};
use rayon::prelude::*;
use std::ops::Range;

/// The finest level. Nodes are numbered cluster by cluster, each cluster in the order of its elimination, and worked on in parts of
/// whole clusters.
///
/// Most nodes have no, one or two of anything, so loops over lists of throats are several times faster than loops over the throats of each
/// node, whose ends no processor foresees.
pub struct Finest {
    /// The number in the matrix of each node; the node of each number in the matrix.
    order: Vec<u32>,
    place: Vec<u32>,
    /// The cluster of each number in the matrix.
    cluster: Vec<u32>,
    /// The cluster of each node, counted from the first of its part.
    owner: Vec<u16>,
    /// First node of each cluster, length clusters + 1.
    starts: Vec<u32>,
    parts: Vec<Part>,
    /// `D = (I - T)⁻¹ diag(1 / inverse) (I - T)⁻ᵀ`: the entries of `T`, of each cluster in the order in which its nodes are taken out,
    /// [interleaved](interleave).
    shares: Vec<Share>,
    inverse: Vec<f32>,
    /// The throats between clusters of one part, those of each cluster together, interleaved.
    inner: Vec<Inner>,
    /// Those that lead to other parts, likewise; each is there twice, once for either end.
    outer: Vec<Outer>,
    /// What the rows of the matrix sum to.
    excess: Vec<f32>,
    /// `D⁻¹ b`; the answer without `e`.
    x: Vec<f32>,
    answer: Vec<f32>,
}

/// Some thousand nodes.
struct Part {
    nodes: Range<usize>,
    clusters: Range<usize>,
    shares: Range<usize>,
    inner: Range<usize>,
    outer: Range<usize>,
}

/// Puts the first entry of every cluster of a part before the second one of every cluster, and so on. `ranks` says which one of its
/// cluster each is.
///
/// Neighbouring entries then have nothing to do with each other. Those of one cluster add to the same few sums, and each would wait for
/// the one before it to be written.
fn interleave<T: Copy>(entries: &mut [T], ranks: &[u32]) {
    let mut starts = vec![0; ranks.iter().max().map_or(0, |&most| most as usize + 2)];
    ranks.iter().for_each(|&rank| starts[rank as usize + 1] += 1);
    for rank in 1..starts.len() {
        starts[rank] += starts[rank - 1];
    }
    let given = entries.to_vec();
    for (&entry, &rank) in given.iter().zip(ranks) {
        let at = &mut starts[rank as usize];
        entries[*at] = entry;
        *at += 1;
    }
}

/// A share of what enters a node when it is taken out goes on to another node. Both count from the beginning of the part.
#[derive(Clone, Copy)]
struct Share {
    from: u16,
    to: u16,
    part: f32,
}

/// A throat between two nodes of a part. They count from its beginning.
#[derive(Clone, Copy)]
struct Inner {
    nodes: [u16; 2],
    conductance: f32,
}

/// A throat of a node, and of its cluster, to a node of another part, and to the cluster of that. The first two count from the beginning
/// of the part.
#[derive(Clone, Copy)]
struct Outer {
    node: u16,
    cluster: u16,
    to: u32,
    beyond: u32,
    conductance: f32,
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
        let mut finest = Finest {
            order,
            place,
            cluster,
            owner: Vec::with_capacity(n),
            starts,
            parts: Vec::new(),
            shares: Vec::with_capacity(2 * n),
            inverse: Vec::with_capacity(n),
            inner: Vec::with_capacity(n),
            outer: Vec::new(),
            excess: Vec::new(),
            x: vec![0.0; n],
            answer: vec![0.0; n],
        };
        let mut first = 0;
        for c in 1..=count {
            let nodes = finest.starts[first] as usize..finest.starts[c] as usize;
            if nodes.len() >= CHUNK || c == count {
                let own = finest.order[nodes.clone()].iter();
                finest.owner.extend(own.map(|&i| (finest.cluster[i as usize] - first as u32) as u16));
                finest.parts.push(Part { nodes, clusters: first..c, shares: 0..0, inner: 0..0, outer: 0..0 });
                first = c;
            }
        }
        finest.factor(matrix, scale);
        finest.excess = finest.order.iter().map(|&i| (matrix.excess()[i as usize] * scale) as f32).collect();
        let coarse = finest.join(matrix, scale);
        (finest, coarse)
    }

    /// Factors every cluster and puts its nodes in the order of their elimination.
    fn factor(&mut self, matrix: &Matrix, scale: f64) {
        let Finest { order, place, cluster, starts, parts, shares, inverse, .. } = self;
        let mut star = Star::new();
        let (mut old, mut now) = ([0u32; LARGEST], [0u16; LARGEST]);
        let mut ranks = Vec::new();
        for part in parts {
            let before = shares.len();
            ranks.clear();
            for c in part.clusters.clone() {
                let range = starts[c] as usize..starts[c + 1] as usize;
                let (first, size) = (range.start, range.len());
                old[..size].copy_from_slice(&order[range]);
                for k in 0..size {
                    let i = old[k] as usize;
                    star.begin(k, matrix.excess()[i] * scale);
                    let (js, entries) = matrix.row(i);
                    for (&j, &a) in js.iter().zip(entries).filter(|(_, a)| **a != 0.0) {
                        if cluster[j as usize] as usize == c {
                            star.join(k, place[j as usize] as usize - first, -a * scale);
                        } else {
                            star.add_outside(k, -a * scale);
                        }
                    }
                }
                let mut left = u64::MAX >> (LARGEST - size);
                let begin = shares.len();
                for at in first..first + size {
                    let k = star.next(left);
                    left &= !(1 << k);
                    now[k] = (at - part.nodes.start) as u16;
                    let total = star.take(k, |m, part| {
                        shares.push(Share { from: now[k], to: m as u16, part: part as f32 });
                    });
                    inverse.push((1.0 / total) as f32);
                    order[at] = old[k];
                }
                shares[begin..].iter_mut().for_each(|share| share.to = now[share.to as usize]);
                ranks.extend(0..(shares.len() - begin) as u32);
                for k in 0..size {
                    place[old[k] as usize] = part.nodes.start as u32 + u32::from(now[k]);
                }
            }
            interleave(&mut shares[before..], &ranks);
            part.shares = before..shares.len();
        }
    }

    /// Collects the throats between clusters and sums them up to the network of clusters.
    fn join(&mut self, matrix: &Matrix, scale: f64) -> Sparse {
        let count = self.starts.len() - 1;
        let mut rows = Rows::with_room(count);
        let mut diagonal = Vec::with_capacity(count);
        let mut seen = vec![NONE; count];
        let (mut inner_ranks, mut outer_ranks) = (Vec::new(), Vec::new());
        for part in &mut self.parts {
            let before = (self.inner.len(), self.outer.len());
            inner_ranks.clear();
            outer_ranks.clear();
            for c in part.clusters.clone() {
                let begin = (self.inner.len(), self.outer.len());
                let mut sum = 0.0;
                for k in self.starts[c] as usize..self.starts[c + 1] as usize {
                    let i = self.order[k] as usize;
                    sum += matrix.excess()[i] * scale;
                    let (js, entries) = matrix.row(i);
                    for (&j, &a) in js.iter().zip(entries) {
                        let (d, a) = (self.cluster[j as usize], a * scale);
                        if d as usize == c || a == 0.0 {
                            continue;
                        }
                        let (to, conductance) = (self.place[j as usize], -a as f32);
                        let local = |k: usize| (k - part.nodes.start) as u16;
                        if !part.nodes.contains(&(to as usize)) {
                            let (node, cluster) = (local(k), (c - part.clusters.start) as u16);
                            self.outer.push(Outer { node, cluster, to, beyond: d, conductance });
                        } else if k < to as usize {
                            self.inner.push(Inner { nodes: [local(k), local(to as usize)], conductance });
                        }
                        sum -= a;
                        rows.add(&mut seen, d, a);
                    }
                }
                rows.end();
                diagonal.push(sum);
                inner_ranks.extend(0..(self.inner.len() - begin.0) as u32);
                outer_ranks.extend(0..(self.outer.len() - begin.1) as u32);
            }
            interleave(&mut self.inner[before.0..], &inner_ranks);
            interleave(&mut self.outer[before.1..], &outer_ranks);
            part.inner = before.0..self.inner.len();
            part.outer = before.1..self.outer.len();
        }
        Sparse { rows, diagonal }
    }

    /// What the rows of the network of clusters sum to.
    pub fn excess(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.starts.len() - 1];
        for (&i, &excess) in self.order.iter().zip(&self.excess) {
            sums[self.cluster[i as usize] as usize] += f64::from(excess);
        }
        sums
    }

    /// One node of each cluster, by its number in the matrix: the last one taken out, where the cluster hangs together.
    pub fn leaders(&self) -> impl Iterator<Item = u32> {
        self.starts[1..].iter().map(|&end| self.order[end as usize - 1])
    }

    /// Entries held.
    pub fn entries(&self) -> usize {
        self.shares.len() + self.inverse.len() + 2 * self.inner.len() + self.outer.len()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.shares)
            + size_of_val(&*self.inner)
            + size_of_val(&*self.outer)
            + size_of_val(&*self.owner)
            + 4 * (7 * self.order.len() + self.starts.len())
    }

    /// Begins a cycle for the right-hand side `factor r`; writes that of the clusters into `coarse`.
    pub fn down(&mut self, r: &[f64], factor: f64, coarse: &mut [f32]) {
        let mut x = std::mem::take(&mut self.x);
        self.by_part(
            &mut x,
            |part| part.nodes.len(),
            |part, x| {
                for (x, &i) in x.iter_mut().zip(&self.order[part.nodes.clone()]) {
                    *x = (r[i as usize] * factor) as f32;
                }
                self.solve(part, x);
            },
        );
        self.by_part(
            coarse,
            |part| part.clusters.len(),
            |part, coarse| {
                coarse.fill(0.0);
                let (own, owner) = (&x[part.nodes.clone()], &self.owner[part.nodes.clone()]);
                for &Inner { nodes: [a, b], conductance } in &self.inner[part.inner.clone()] {
                    let (a, b) = (a as usize, b as usize);
                    coarse[owner[a] as usize] += conductance * own[b];
                    coarse[owner[b] as usize] += conductance * own[a];
                }
                for throat in &self.outer[part.outer.clone()] {
                    coarse[throat.cluster as usize] += throat.conductance * x[throat.to as usize];
                }
            },
        );
        self.x = x;
    }

    /// Ends the cycle with the correction of the clusters: the answer, times `factor`, goes to `z`. Returns `z · r`.
    pub fn up(&mut self, correction: &[f32], factor: f64, r: &[f64], z: &mut [f64], sums: &mut Sums) -> f64 {
        let (x, mut answer) = (std::mem::take(&mut self.x), std::mem::take(&mut self.answer));
        self.by_part(
            &mut answer,
            |part| part.nodes.len(),
            |part, answer| {
                let mut second = [0.0; CHUNK + LARGEST];
                let second = &mut second[..answer.len()];
                let e = &correction[part.clusters.clone()];
                let (own, owner) = (&x[part.nodes.clone()], &self.owner[part.nodes.clone()]);
                let excess = &self.excess[part.nodes.clone()];
                for ((y, excess), &cluster) in second.iter_mut().zip(excess).zip(owner) {
                    *y = -excess * e[cluster as usize];
                }
                for &Inner { nodes: [a, b], conductance } in &self.inner[part.inner.clone()] {
                    let (a, b) = (a as usize, b as usize);
                    let step = e[owner[b] as usize] - e[owner[a] as usize];
                    second[a] += conductance * (own[b] + step);
                    second[b] += conductance * (own[a] - step);
                }
                for throat in &self.outer[part.outer.clone()] {
                    let step = correction[throat.beyond as usize] - e[throat.cluster as usize];
                    second[throat.node as usize] += throat.conductance * (x[throat.to as usize] + step);
                }
                self.solve(part, second);
                answer.iter_mut().zip(own).zip(second).for_each(|((answer, x), y)| *answer = x + *y);
            },
        );
        // Only here do the two parts meet, in double precision: `e` is smooth and large, `x` differs along the strong throats by what
        // rounding `e` to single precision would drown.
        let whole = |i: usize| {
            let e = correction[self.cluster[i] as usize];
            (f64::from(e) + f64::from(answer[self.place[i] as usize])) * factor
        };
        let [zr, ..] = each_and_sum(z, sums, whole, |range, z| [chunk_dot(&r[range], z), 0.0, 0.0]);
        (self.x, self.answer) = (x, answer);
        zr
    }

    /// `x = D⁻¹ x` for the nodes of one part.
    #[inline(always)]
    fn solve(&self, part: &Part, x: &mut [f32]) {
        let shares = &self.shares[part.shares.clone()];
        for share in shares {
            x[share.to as usize] += share.part * x[share.from as usize];
        }
        x.iter_mut().zip(&self.inverse[part.nodes.clone()]).for_each(|(x, inverse)| *x *= inverse);
        for share in shares.iter().rev() {
            x[share.from as usize] += share.part * x[share.to as usize];
        }
    }

    /// Calls `f` with each part and its `length` entries of `x`.
    fn by_part(&self, x: &mut [f32], length: impl Fn(&Part) -> usize, f: impl Fn(&Part, &mut [f32]) + Sync) {
        let alone = alone(self.order.len());
        let mut slices = Vec::with_capacity(if alone { 0 } else { self.parts.len() });
        let mut rest = x;
        for part in &self.parts {
            let (slice, after) = rest.split_at_mut(length(part));
            if alone {
                f(part, slice);
            } else {
                slices.push((part, slice));
            }
            rest = after;
        }
        slices.into_par_iter().for_each(|(part, slice)| f(part, slice));
    }
}
