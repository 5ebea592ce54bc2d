//! An elimination order of little fill: nested dissection.

use crate::Matrix;
use glam::DVec3;

/// Sets of at most this many nodes are not cut further.
const LEAF: usize = 60;

/// Nodes in the order of their elimination. Each set is cut at the median of its longest side; the nodes of the
/// lower half that touch the upper half come last.
pub fn nested_dissection(matrix: &Matrix, positions: &[DVec3]) -> Vec<u32> {
    let n = matrix.nodes();
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut side = vec![0u32; n];
    let mut label = 0;
    // Sets still to cut, as ranges of `order`.
    let mut sets = Vec::new();
    sets.push(0..n);
    let mut scratch = Vec::new();
    while let Some(range) = sets.pop() {
        if range.len() <= LEAF {
            continue;
        }
        let set = &mut order[range.clone()];
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &i in &*set {
            low = low.min(positions[i as usize]);
            high = high.max(positions[i as usize]);
        }
        let extent = (high - low).to_array();
        let axis = (0..3).fold(0, |best, k| if extent[k] > extent[best] { k } else { best });
        let half = set.len() / 2;
        let key = |i: u32| positions[i as usize][axis];
        set.select_nth_unstable_by(half, |&i, &j| key(i).total_cmp(&key(j)).then(i.cmp(&j)));
        label += 1;
        for &i in &set[half..] {
            side[i as usize] = label;
        }
        let cut = |i: u32| matrix.row(i as usize).0.iter().any(|&j| side[j as usize] == label);
        scratch.clear();
        let mut inner = 0;
        for k in 0..half {
            let i = set[k];
            if cut(i) {
                scratch.push(i);
            } else {
                set[inner] = i;
                inner += 1;
            }
        }
        set.copy_within(half.., inner);
        let separator = set.len() - scratch.len();
        set[separator..].copy_from_slice(&scratch);
        let start = range.start;
        sets.push(start..start + inner);
        sets.push(start + inner..start + separator);
    }
    order
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
