//! An elimination order of little fill: nested dissection.

use crate::Matrix;
use glam::DVec3;
use std::collections::VecDeque;

/// Sets of at most this many nodes are not cut further.
const LEAF: usize = 20;
/// Each side of a cut has at least so many of the nodes, of this many.
const SIDE: [usize; 2] = [2, 5];
/// Sets are cut across sides at least this long in terms of the longest.
const LONG: f64 = 0.5;
/// No node.
const NONE: u32 = u32::MAX;

/// Nodes in the order of their elimination. Each set is cut in two where fewest nodes of one half touch the other, and the fewest
/// nodes that take part in all throats across come last.
pub fn nested_dissection(matrix: &Matrix, positions: &[DVec3]) -> Vec<u32> {
    let n = matrix.nodes();
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut dissection = Dissection::new(matrix, positions);
    // Sets still to cut, as ranges of `order`.
    let mut sets = Vec::new();
    sets.push(0..n);
    while let Some(range) = sets.pop() {
        if range.len() > LEAF {
            let [left, right] = dissection.cut(&mut order[range.clone()]);
            let middle = range.start + left;
            sets.extend([range.start..middle, middle..middle + right]);
        }
    }
    order
}

struct Dissection<'a> {
    matrix: &'a Matrix,
    positions: &'a [DVec3],
    /// Where each node stands along each axis.
    rank: [Vec<u32>; 3],
    /// The last set each node was in, and its place there.
    set: Vec<u32>,
    place: Vec<u32>,
    /// The number of the set being cut.
    current: u32,
}

impl Dissection<'_> {
    fn new<'a>(matrix: &'a Matrix, positions: &'a [DVec3]) -> Dissection<'a> {
        let n = matrix.nodes();
        let rank = [0, 1, 2].map(|axis: usize| {
            let mut sorted: Vec<u32> = (0..n as u32).collect();
            let key = |i: u32| positions[i as usize][axis];
            sorted.sort_unstable_by(|&i, &j| key(i).total_cmp(&key(j)).then(i.cmp(&j)));
            let mut rank = vec![0; n];
            (0..).zip(sorted).for_each(|(k, i)| rank[i as usize] = k);
            rank
        });
        Dissection { matrix, positions, rank, set: vec![0; n], place: vec![0; n], current: 0 }
    }

    /// Puts the nodes on the left of a cut first, then those on the right, and last those that part them. Returns how many there
    /// are of the first two.
    fn cut(&mut self, set: &mut [u32]) -> [usize; 2] {
        self.current += 1;
        set.iter().for_each(|&i| self.set[i as usize] = self.current);
        let (axis, left) = self.best_cut(set);
        self.sort(set, axis);
        let cover = self.cover(set, left);
        let parted = |side: std::ops::Range<usize>, covered: bool| {
            side.filter(|&k| cover[k] == covered).map(|k| set[k]).collect::<Vec<u32>>()
        };
        let n = set.len();
        let (left, right, between) = (parted(0..left, false), parted(left..n, false), parted(0..n, true));
        for (to, from) in set.iter_mut().zip(left.iter().chain(&right).chain(&between)) {
            *to = *from;
        }
        [left.len(), right.len()]
    }

    /// The axis to cut across, and how many nodes to leave on the left.
    fn best_cut(&mut self, set: &mut [u32]) -> (usize, usize) {
        let n = set.len();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &i in &*set {
            low = low.min(self.positions[i as usize]);
            high = high.max(self.positions[i as usize]);
        }
        let extent = high - low;
        let mut best = (f64::INFINITY, 0, n / 2);
        for axis in (0..3).filter(|&axis| extent[axis] >= LONG * extent.max_element()) {
            self.sort(set, axis);
            // By how much more nodes touch the other half when the cut moves on beyond a node: those on the left, those on the right.
            let mut more = vec![[0i32; 2]; n + 1];
            for (k, &i) in set.iter().enumerate() {
                let (least, most) = self.near(i).fold((k, k), |(least, most), j| (least.min(j), most.max(j)));
                more[k + 1][0] += 1;
                more[most + 1][0] -= 1;
                more[least + 1][1] += 1;
                more[k + 1][1] -= 1;
            }
            let mut touch = [0; 2];
            let least = (n * SIDE[0]).div_ceil(SIDE[1]);
            for (left, more) in more.iter().enumerate() {
                touch = [touch[0] + more[0], touch[1] + more[1]];
                if (least..=n - least).contains(&left) {
                    let cost = f64::from(touch[0].min(touch[1])) / (left as f64 * (n - left) as f64);
                    if cost < best.0 {
                        best = (cost, axis, left);
                    }
                }
            }
        }
        (best.1, best.2)
    }

    /// Which nodes make up the smallest set that takes part in all throats between the first `left` nodes and the others: as many as
    /// pairs of nodes across can be told apart (König 1931).
    fn cover(&self, set: &[u32], left: usize) -> Vec<bool> {
        let across = |k: usize| self.near(set[k]).filter(|&j| j >= left);
        let mut partner = vec![NONE; set.len()];
        // From which node on the left each one on the right was reached, and when.
        let (mut from, mut round) = (vec![0; set.len()], vec![NONE; set.len()]);
        let mut queue = VecDeque::new();
        for root in 0..left {
            queue.clear();
            queue.push_back(root);
            'search: while let Some(k) = queue.pop_front() {
                for j in across(k) {
                    if round[j] == root as u32 {
                        continue;
                    }
                    (round[j], from[j]) = (root as u32, k as u32);
                    if partner[j] != NONE {
                        queue.push_back(partner[j] as usize);
                        continue;
                    }
                    // One more pair: all on the way back change partners.
                    let mut j = j as u32;
                    while j != NONE {
                        let k = from[j as usize] as usize;
                        partner[j as usize] = k as u32;
                        j = std::mem::replace(&mut partner[k], j);
                    }
                    break 'search;
                }
            }
        }
        // What can be reached from nodes on the left without a partner: the right ones of that, and the left ones of all else.
        let mut reached = vec![false; set.len()];
        queue.clear();
        queue.extend((0..left).filter(|&k| partner[k] == NONE));
        while let Some(k) = queue.pop_front() {
            reached[k] = true;
            for j in across(k) {
                if !std::mem::replace(&mut reached[j], true) {
                    queue.push_back(partner[j] as usize);
                }
            }
        }
        (0..set.len())
            .map(|k| if k < left { partner[k] != NONE && !reached[k] } else { reached[k] })
            .collect()
    }

    /// The places in the current set of the neighbours that a node has there.
    fn near(&self, i: u32) -> impl Iterator<Item = usize> {
        let here = |&&j: &&u32| self.set[j as usize] == self.current;
        self.matrix.row(i as usize).0.iter().filter(here).map(|&j| self.place[j as usize] as usize)
    }

    /// Sorts the current set along an axis.
    fn sort(&mut self, set: &mut [u32], axis: usize) {
        set.sort_unstable_by_key(|&i| self.rank[axis][i as usize]);
        (0..).zip(&*set).for_each(|(k, &i)| self.place[i as usize] = k);
    }
}

/// Stand-in positions where none are known: steps to three nodes far from each other.
pub fn landmarks(matrix: &Matrix) -> Vec<DVec3> {
    let n = matrix.nodes();
    let mut coordinates = vec![[0.0; 3]; n];
    let mut nearest = vec![u32::MAX; n];
    let mut steps = vec![0u32; n];
    let mut source = 0;
    for k in 0..4 {
        steps.fill(u32::MAX);
        // A search from the source, then from the lowest node of each other component.
        for root in std::iter::once(source).chain(0..n) {
            if n == 0 || steps[root] != u32::MAX {
                continue;
            }
            steps[root] = 0;
            let mut queue = vec![root as u32];
            let mut head = 0;
            while head < queue.len() {
                let i = queue[head] as usize;
                head += 1;
                for &j in matrix.row(i).0 {
                    if steps[j as usize] == u32::MAX {
                        steps[j as usize] = steps[i] + 1;
                        queue.push(j);
                    }
                }
            }
        }
        // The first search only finds a rim node to start from.
        for i in 0..n {
            if k > 0 {
                coordinates[i][k - 1] = f64::from(steps[i]);
                nearest[i] = nearest[i].min(steps[i]);
            }
        }
        let far = if k == 0 { &steps } else { &nearest };
        source = (0..n).max_by_key(|&i| (far[i], std::cmp::Reverse(i))).unwrap_or(0);
    }
    coordinates.into_iter().map(DVec3::from_array).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every node of a cube of `side`³ with its neighbours along the axes, and some with others that a small generator picks.
    fn cube(side: u32, more: u32) -> (Matrix, Vec<DVec3>) {
        let n = side.pow(3);
        let place = |i: u32| [i % side, i / side % side, i / side.pow(2)];
        let mut ends = Vec::new();
        for i in 0..n {
            for (axis, step) in [1, side, side.pow(2)].into_iter().enumerate() {
                if place(i)[axis] + 1 < side {
                    ends.push([i, i + step]);
                }
            }
        }
        let mut seed = 1u32;
        let mut next = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) % n
        };
        ends.extend((0..more).map(|_| [next(), next()]));
        let positions = (0..n).map(|i| DVec3::from_array(place(i).map(f64::from))).collect();
        (Matrix::new(n as usize, &ends, &vec![1.0; ends.len()], &vec![1.0; n as usize]).unwrap(), positions)
    }

    #[test]
    fn as_few_nodes_part_the_halves_as_there_are_pairs_across() {
        let (matrix, positions) = cube(9, 400);
        let mut set: Vec<u32> = (0..729).collect();
        let mut dissection = Dissection::new(&matrix, &positions);
        dissection.current = 1;
        dissection.set.fill(1);
        dissection.sort(&mut set, 2);
        for left in [300, 364, 400] {
            let cover = dissection.cover(&set, left);
            let across = |k: usize| dissection.near(set[k]).filter(move |&j| j >= left);
            for k in 0..left {
                assert!(across(k).all(|j| cover[k] || cover[j]), "a throat across that no node is in");
            }
            // Pairs without a common node need one node each: no cover is smaller than the largest set of pairs.
            let size = cover.iter().filter(|&&c| c).count();
            let touching = (0..left).filter(|&k| across(k).next().is_some()).count();
            assert!(size < touching, "{size} {touching}");
            assert_eq!(size, pairs(left, across), "as many as pairs");
        }
    }

    /// The largest number of pairs, by trying each node in turn and making room where that is possible.
    fn pairs<I: Iterator<Item = usize>>(left: usize, across: impl Fn(usize) -> I) -> usize {
        fn room<I: Iterator<Item = usize>>(
            k: usize,
            across: &impl Fn(usize) -> I,
            taken: &mut std::collections::HashMap<usize, usize>,
            tried: &mut std::collections::HashSet<usize>,
        ) -> bool {
            for j in across(k) {
                if tried.insert(j)
                    && taken.get(&j).copied().is_none_or(|other| room(other, across, taken, tried))
                {
                    taken.insert(j, k);
                    return true;
                }
            }
            false
        }
        let mut taken = std::collections::HashMap::new();
        (0..left).filter(|&k| room(k, &across, &mut taken, &mut std::collections::HashSet::new())).count()
    }

    #[test]
    fn the_two_sides_of_a_cut_do_not_touch() {
        let (matrix, positions) = cube(9, 100);
        let mut set: Vec<u32> = (0..729).collect();
        let [left, right] = Dissection::new(&matrix, &positions).cut(&mut set);
        assert!(left >= 200 && right >= 200, "{left} {right}");
        for i in &set[..left] {
            assert!(matrix.row(*i as usize).0.iter().all(|j| !set[left..left + right].contains(j)));
        }
        let mut order = nested_dissection(&matrix, &positions);
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..729));
    }
}
