//! A numbering of pores and of their vertices that depends on the triangulation alone, not on how it was made.

use super::mesh::{FREE, Mesh};
use super::{NONE, Triangulation};

/// The even permutations of four places: they keep the orientation.
const EVEN: [[usize; 4]; 12] = [
    [0, 1, 2, 3],
    [0, 2, 3, 1],
    [0, 3, 1, 2],
    [1, 0, 3, 2],
    [1, 3, 2, 0],
    [1, 2, 0, 3],
    [2, 0, 1, 3],
    [2, 1, 3, 0],
    [2, 3, 0, 1],
    [3, 0, 2, 1],
    [3, 2, 1, 0],
    [3, 1, 0, 2],
];

/// The even permutation that puts the smallest vertex first and the second smallest next.
pub(super) fn rotation(vertex: [u32; 4]) -> [usize; 4] {
    let mut first = 0;
    for k in 1..4 {
        if vertex[k] < vertex[first] {
            first = k;
        }
    }
    let start = 3 * first;
    let mut best = start;
    for p in start + 1..start + 3 {
        if vertex[EVEN[p][1]] < vertex[EVEN[best][1]] {
            best = p;
        }
    }
    EVEN[best]
}

/// Numbers the pores by their smallest vertex, then by their vertices in order.
///
/// Pores around a grain are neighbours in memory, and follow the order of the grains.
pub(super) fn number(mesh: &Mesh, grains: usize) -> Triangulation {
    let live = || mesh.pores.iter().enumerate().filter(|(_, p)| p.vertex[0] != FREE);
    let turned = |vertex: [u32; 4]| {
        let labels = vertex.map(|v| mesh.label(v));
        rotation(labels).map(|k| labels[k])
    };
    // Counting sort by the first vertex, which is a grain in every pore.
    let mut start = vec![0u32; grains + 1];
    for (_, pore) in live() {
        start[turned(pore.vertex)[0] as usize + 1] += 1;
    }
    for g in 0..grains {
        start[g + 1] += start[g];
    }
    let mut sorted = vec![([0; 3], 0); start[grains] as usize];
    let mut next = start.clone();
    for (old, pore) in live() {
        let [a, b, c, d] = turned(pore.vertex);
        sorted[next[a as usize] as usize] = ([b, c, d], old as u32);
        next[a as usize] += 1;
    }
    let mut number = vec![NONE; mesh.pores.len()];
    let mut pores = Vec::with_capacity(sorted.len());
    for g in 0..grains {
        let group = &mut sorted[start[g] as usize..start[g + 1] as usize];
        group.sort_unstable();
        for &([b, c, d], old) in group.iter() {
            number[old as usize] = pores.len() as u32;
            pores.push([g as u32, b, c, d]);
        }
    }
    let neighbours = sorted.iter().map(|&(_, old)| {
        let pore = &mesh.pores[old as usize];
        rotation(pore.vertex.map(|v| mesh.label(v))).map(|k| match pore.neighbour[k] {
            NONE => NONE,
            p => number[p as usize],
        })
    });
    let neighbours = neighbours.collect();
    let mut hidden: Vec<u32> = mesh.hidden.iter().map(|&g| mesh.label(g)).collect();
    hidden.sort_unstable();
    Triangulation { pores, neighbours, shifts: Vec::new(), hidden }
}
