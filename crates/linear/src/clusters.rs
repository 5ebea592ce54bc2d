//! Clusters: nodes tied to each other more strongly than to anything else, which the multigrid joins first.
//!
//! Where radical centres nearly coincide, throats conduct up to 10⁶ times the median, in hubs and chains of falling strength.
//! On such matrices smoothers and the usual rules of coarsening stall. The network of clusters is free of them: what is
//! left in it spans two or three decades.

use crate::Matrix;

/// Two clusters join if a throat between them conducts at least this share of all other throats of one of them.
///
/// At a half, knots of some ten clusters are left here and there that neither the clusters nor their network know: rare, so that
/// large samples have worse ones, and conjugate gradients take ever more iterations. At a fifth clusters run into [`LARGEST`].
const STRONG: f64 = 0.35;
/// Nodes of a cluster at most, so that sets of them are the bits of a word.
pub const LARGEST: usize = 64;

/// The cluster of each node, numbered by their lowest nodes, and the number of clusters.
///
/// Throats are looked at from the strongest down (Kruskal 1956), so that a hub has gathered its own nodes before it is
/// compared with the next one.
pub fn clusters(matrix: &Matrix) -> (Vec<u32>, usize) {
    let n = matrix.nodes();
    let mut throats = Vec::with_capacity(matrix.columns().len() / 2);
    for i in 0..n {
        let start = matrix.starts()[i] as usize;
        let (columns, values) = matrix.row(i);
        for (k, (&j, &a)) in columns.iter().zip(values).enumerate() {
            if (j as usize) < i && a < 0.0 {
                // Positive numbers sort like their bits, and single precision is close enough for an order.
                let key = u64::from(!(-a as f32).to_bits());
                throats.push((key << 32 | (start + k) as u64, i as u32));
            }
        }
    }
    throats.sort_unstable();
    let mut nodes: Vec<Member> =
        (0..n as u32).zip(matrix.diagonal()).map(|(parent, &out)| Member { parent, size: 1, out }).collect();
    for &(entry, i) in &throats {
        let slot = entry as u32 as usize;
        let (j, g) = (matrix.columns()[slot], -matrix.values()[slot]);
        let (a, b) = (leader(&mut nodes, i) as usize, leader(&mut nodes, j) as usize);
        let (one, other) = (nodes[a], nodes[b]);
        if a == b {
            nodes[a].out -= 2.0 * g;
        } else if g >= STRONG * (one.out.min(other.out) - g) && (one.size + other.size) as usize <= LARGEST {
            let (low, high) = (a.min(b), a.max(b));
            nodes[high].parent = low as u32;
            nodes[low].size = one.size + other.size;
            nodes[low].out += nodes[high].out - 2.0 * g;
        }
    }
    let mut cluster = vec![0u32; n];
    let mut count = 0;
    for i in 0..n {
        let first = leader(&mut nodes, i as u32) as usize;
        cluster[i] = if first == i { count } else { cluster[first] };
        count += u32::from(first == i);
    }
    (cluster, count as usize)
}

/// A node, and what the cluster is that it leads: in one place, for throats in order of strength jump about.
#[derive(Clone, Copy)]
struct Member {
    parent: u32,
    size: u32,
    /// What leads out of the cluster.
    out: f64,
}

/// The lowest node of the cluster of `i`.
fn leader(nodes: &mut [Member], mut i: u32) -> u32 {
    while nodes[i as usize].parent != i {
        nodes[i as usize].parent = nodes[nodes[i as usize].parent as usize].parent;
        i = nodes[i as usize].parent;
    }
    i
}

/// A cluster as a small network that is taken apart node by node: the neighbours of a node taken out are joined with each
/// other (star and mesh). Nothing is ever subtracted, so conductances of any contrast lose no digits.
pub struct Star {
    /// The neighbours of each node, as bits.
    near: [u64; LARGEST],
    /// Conductances between nodes, where they are neighbours.
    inside: Vec<f64>,
    /// Conductances out of the cluster.
    outside: [f64; LARGEST],
}

impl Star {
    /// Room for a cluster.
    pub fn new() -> Star {
        Star { near: [0; LARGEST], inside: vec![0.0; LARGEST * LARGEST], outside: [0.0; LARGEST] }
    }

    /// Node `k` begins with no neighbours and a conductance `outside` out of the cluster.
    pub fn begin(&mut self, k: usize, outside: f64) {
        (self.near[k], self.outside[k]) = (0, outside);
    }

    /// Adds to what leads from node `k` out of the cluster.
    pub fn add_outside(&mut self, k: usize, g: f64) {
        self.outside[k] += g;
    }

    /// Node `k` sees node `m` through the conductance `g > 0`; `m` has to see `k` likewise.
    pub fn join(&mut self, k: usize, m: usize, g: f64) {
        self.near[k] |= 1 << m;
        self.inside[k * LARGEST + m] = g;
    }

    /// The node of the set `left` (bits) with the fewest neighbours.
    pub fn next(&self, left: u64) -> usize {
        bits(left).min_by_key(|&k| self.near[k].count_ones()).unwrap_or(0)
    }

    /// Takes node `k` out. Calls `share(m, part)` for each neighbour `m` with the part of whatever enters `k` that goes on to
    /// `m`, and returns all that led away from `k`.
    pub fn take(&mut self, k: usize, mut share: impl FnMut(usize, f64)) -> f64 {
        let Star { near, inside, outside } = self;
        let at = |a: usize, b: usize| a * LARGEST + b;
        let total = outside[k] + bits(near[k]).map(|m| inside[at(k, m)]).sum::<f64>();
        for m in bits(near[k]) {
            let part = inside[at(k, m)] / total;
            share(m, part);
            outside[m] += part * outside[k];
            for o in bits(near[k] & !(1 << m)) {
                let known = if near[m] >> o & 1 == 1 { inside[at(m, o)] } else { 0.0 };
                inside[at(m, o)] = known + part * inside[at(k, o)];
                near[m] |= 1 << o;
            }
            near[m] &= !(1 << k);
        }
        total
    }
}

/// The places of the bits set.
fn bits(mut set: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = set.trailing_zeros() as usize;
        (set != 0).then(|| set &= set - 1).map(|()| lowest)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FIXED;

    #[test]
    fn hubs_gather_their_nodes_and_weak_throats_stay() {
        // Two hubs of three nodes each, 1000 and 100 inside; a throat between them, held pores, and a node that hangs on one.
        let ends = [[0, 1], [1, 2], [3, 4], [4, 5], [2, 3], [0, FIXED], [5, FIXED], [5, 6], [6, FIXED]];
        let with = |joint: f64| {
            let g = [1000.0, 100.0, 1000.0, 100.0, joint, 1.0, 1.0, 0.2, 2.0];
            clusters(&Matrix::new(7, &ends, &g, &[0.0; 7]).unwrap())
        };
        assert_eq!(with(10.0), (vec![0, 0, 0, 0, 0, 0, 1], 2));
        assert_eq!(with(0.2), (vec![0, 0, 0, 1, 1, 1, 2], 3));
    }

    #[test]
    fn no_cluster_grows_beyond_a_word() {
        let ends: Vec<[u32; 2]> = (0..999).map(|i| [i, i + 1]).chain([[999, FIXED]]).collect();
        let (cluster, count) = clusters(&Matrix::new(1000, &ends, &[1.0; 1000], &[0.0; 1000]).unwrap());
        let mut sizes = vec![0; count];
        cluster.iter().for_each(|&c| sizes[c as usize] += 1);
        assert!(sizes.iter().all(|&s| s <= LARGEST) && count < 500, "{count}");
    }

    #[test]
    fn a_star_taken_apart_keeps_every_digit() {
        // 0 = 1 - 2 in a triangle, the first throat 10¹² times the others, each node leaking 1.
        let mut star = Star::new();
        for k in 0..3 {
            star.begin(k, 0.5);
            star.add_outside(k, 0.5);
        }
        for (k, m, g) in [(0, 1, 1e12), (1, 2, 1.0), (0, 2, 1.0)] {
            star.join(k, m, g);
            star.join(m, k, g);
        }
        assert_eq!(star.next(0b111), 0);
        let mut shares = Vec::new();
        let total = star.take(0, |m, part| shares.push((m, part)));
        assert_eq!((total, shares.clone()), (1e12 + 2.0, vec![(1, 1e12 / total), (2, 1.0 / total)]));
        // 1 now stands for 0 as well: it leaks almost 2, and so it conducts to 2.
        let second = star.take(1, |_, _| {});
        assert!((second - 4.0).abs() < 1e-11, "{second}");
        let third = star.take(2, |_, _| panic!("no node is left"));
        assert!((third - (1.0 + 2.0 * 2.0 / 4.0)).abs() < 1e-11, "{third}");
    }
}
