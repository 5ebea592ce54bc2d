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
    // Counting sort by the first vertex, which is a grain in every pore.
    let mut start = vec![0u32; grains + 1];
    let mut turned = Vec::with_capacity(mesh.pores.len());
    for (old, pore) in (0..).zip(&mesh.pores) {
        if pore.vertex[0] != FREE {
            let [a, b, c, d] = pore.vertex;
            let label = [mesh.label(a), mesh.label(b), mesh.label(c), mesh.label(d)];
            let [a, b, c, d] = rotation(label);
            start[label[a] as usize + 1] += 1;
            turned.push((
                [label[a], label[b], label[c], label[d]],
                old,
                [a as u8, b as u8, c as u8, d as u8],
            ));
        }
    }
    for g in 0..grains {
        start[g + 1] += start[g];
    }
    let mut sorted = vec![([0; 4], 0u32, [0u8; 4]); turned.len()];
    let mut next = start.clone();
    for entry in turned {
        let place = &mut next[entry.0[0] as usize];
        sorted[*place as usize] = entry;
        *place += 1;
    }
    let mut number = vec![NONE; mesh.pores.len()];
    for g in 0..grains {
        let group = &mut sorted[start[g] as usize..start[g + 1] as usize];
        group.sort_unstable_by_key(|entry| entry.0);
    }
    let mut pores = Vec::with_capacity(sorted.len());
    for (new, (vertex, old, _)) in (0..).zip(&sorted) {
        number[*old as usize] = new;
        pores.push(*vertex);
    }
    let mut neighbours = Vec::with_capacity(sorted.len());
    for (_, old, turn) in &sorted {
        let sides = mesh.pores[*old as usize].neighbour;
        let mut across = [NONE; 4];
        for k in 0..4 {
            // NONE stays NONE.
            across[k] = number.get(sides[turn[k] as usize] as usize).copied().unwrap_or(NONE);
        }
        neighbours.push(across);
    }
    let mut hidden: Vec<u32> = mesh.hidden.iter().map(|&g| mesh.label(g)).collect();
    hidden.sort_unstable();
    Triangulation { pores, neighbours, shifts: Vec::new(), hidden }
}
