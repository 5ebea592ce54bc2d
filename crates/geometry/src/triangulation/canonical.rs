//! A numbering of pores and of their vertices that depends on the triangulation alone, not on how it was made.

use super::mesh::{FREE, Mesh};
use super::{NONE, Triangulation, TriangulationError, Vertex, wall};

/// The even permutations of four places, grouped by their first: they keep the orientation.
const EVEN: [[u8; 4]; 12] = [
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
#[inline(always)]
fn turn<K: Ord>(key: [K; 4]) -> [u8; 4] {
    let mut first = 0;
    for k in 1..4 {
        if key[k] < key[first] {
            first = k;
        }
    }
    let mut best = 3 * first;
    for p in 3 * first + 1..3 * first + 3 {
        if key[EVEN[p][1] as usize] < key[EVEN[best][1] as usize] {
            best = p;
        }
    }
    EVEN[best]
}

/// A pore on its way to its place.
#[derive(Clone, Copy, Default)]
struct Entry<K> {
    vertex: [Vertex; 4],
    /// What else tells pores apart: their shifts.
    rest: K,
    old: u32,
    turn: [u8; 4],
}

/// Sorts by first vertex (a grain in every pore), then by the vertices in order, then by the rest.
fn sorted<K: Ord + Copy + Default>(entries: Vec<Entry<K>>, grains: usize) -> Vec<Entry<K>> {
    let mut start = vec![0u32; grains + 1];
    for entry in &entries {
        start[entry.vertex[0] as usize + 1] += 1;
    }
    for g in 0..grains {
        start[g + 1] += start[g];
    }
    let mut sorted = vec![Entry::default(); entries.len()];
    let mut next = start.clone();
    for entry in entries {
        let place = &mut next[entry.vertex[0] as usize];
        sorted[*place as usize] = entry;
        *place += 1;
    }
    for g in 0..grains {
        let group = &mut sorted[start[g] as usize..start[g + 1] as usize];
        group.sort_unstable_by_key(|entry| (entry.vertex, entry.rest));
    }
    sorted
}

/// Neighbours in the new numbering; `sides` are those of the old pores, of which there were `count`.
fn renumbered<K>(sorted: &[Entry<K>], count: usize, sides: impl Fn(u32) -> [u32; 4]) -> Vec<[u32; 4]> {
    let mut number = vec![NONE; count];
    for (new, entry) in (0..).zip(sorted) {
        number[entry.old as usize] = new;
    }
    let mut neighbours = Vec::with_capacity(sorted.len());
    for entry in sorted {
        let old = sides(entry.old);
        let mut across = [NONE; 4];
        for k in 0..4 {
            // NONE stays NONE.
            across[k] = number.get(old[entry.turn[k] as usize] as usize).copied().unwrap_or(NONE);
        }
        neighbours.push(across);
    }
    neighbours
}

/// Numbers the pores of a walled box by their smallest vertex, then by their vertices in order.
///
/// Pores around a grain are neighbours in memory, and follow the order of the grains.
pub(super) fn number(mesh: &Mesh, grains: usize) -> Triangulation {
    let mut entries = Vec::with_capacity(mesh.pores.len());
    for (old, pore) in (0..).zip(&mesh.pores) {
        if pore.vertex[0] != FREE {
            let [a, b, c, d] = pore.vertex;
            let label = [mesh.view.label(a), mesh.view.label(b), mesh.view.label(c), mesh.view.label(d)];
            let turn = turn(label);
            let [a, b, c, d] = turn;
            let vertex = [label[a as usize], label[b as usize], label[c as usize], label[d as usize]];
            entries.push(Entry { vertex, rest: (), old, turn });
        }
    }
    let sorted = sorted(entries, grains);
    let neighbours = renumbered(&sorted, mesh.pores.len(), |old| mesh.pores[old as usize].neighbour);
    let pores = sorted.iter().map(|entry| entry.vertex).collect();
    Triangulation {
        pores,
        neighbours,
        shifts: Vec::new(),
        hidden: hidden(mesh.hidden.iter().map(|&g| mesh.view.label(g))),
    }
}

/// Numbers the pores anew after some were taken away ([`FREE`]) and others put at the end, from `kept` on; those before are in order.
pub(super) fn merged(old: &Triangulation, kept: usize) -> Triangulation {
    let mut entries: Vec<Entry<()>> = Vec::new();
    for (slot, vertex) in (0..).zip(&old.pores).skip(kept).filter(|(_, vertex)| vertex[0] != FREE) {
        let turn = turn(*vertex);
        entries.push(Entry { vertex: turn.map(|k| vertex[k as usize]), rest: (), old: slot, turn });
    }
    entries.sort_unstable_by_key(|entry| entry.vertex);
    let mut number = vec![NONE; old.pores.len()];
    let mut pores = Vec::with_capacity(kept + entries.len());
    let mut place = |slot: u32, vertex: [Vertex; 4]| {
        number[slot as usize] = pores.len() as u32;
        pores.push(vertex);
    };
    let mut new = entries.iter().peekable();
    for (slot, vertex) in (0..).zip(&old.pores[..kept]).filter(|(_, vertex)| vertex[0] != FREE) {
        while let Some(entry) = new.next_if(|entry| entry.vertex < *vertex) {
            place(entry.old, entry.vertex);
        }
        place(slot, *vertex);
    }
    new.for_each(|entry| place(entry.old, entry.vertex));
    let renamed = |sides: [u32; 4]| sides.map(|p| number.get(p as usize).copied().unwrap_or(NONE));
    let mut neighbours = vec![[NONE; 4]; pores.len()];
    for slot in (0..kept).filter(|&slot| old.pores[slot][0] != FREE) {
        neighbours[number[slot] as usize] = renamed(old.neighbours[slot]);
    }
    for entry in &entries {
        let sides = old.neighbours[entry.old as usize];
        neighbours[number[entry.old as usize] as usize] = renamed(entry.turn.map(|k| sides[k as usize]));
    }
    Triangulation { pores, neighbours, shifts: Vec::new(), hidden: old.hidden.clone() }
}

fn hidden(grains: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut hidden: Vec<u32> = grains.collect();
    hidden.sort_unstable();
    hidden
}

/// A pore of a periodic triangulation in the user's numbering, up to a common shift.
#[derive(Clone, Copy)]
pub(super) struct PeriodicPore {
    pub vertex: [Vertex; 4],
    pub shift: [[i64; 3]; 4],
    pub neighbour: [u32; 4],
}

/// Numbers the pores of a periodic cell: the smallest vertex has the shift zero.
pub(super) fn number_periodic(
    pores: &[PeriodicPore],
    grains: usize,
    hidden_grains: Vec<u32>,
) -> Result<Triangulation, TriangulationError> {
    let mut entries = Vec::with_capacity(pores.len());
    for (old, pore) in (0..).zip(pores) {
        let key = [0, 1, 2, 3].map(|k| (pore.vertex[k], pore.shift[k]));
        let turn = turn(key);
        let vertex = turn.map(|k| pore.vertex[k as usize]);
        let base = pore.shift[turn[0] as usize];
        let mut rest = [[0i8; 3]; 4];
        for k in (0..4).filter(|&k| wall(vertex[k]).is_none()) {
            for axis in 0..3 {
                let shift = pore.shift[turn[k] as usize][axis].saturating_sub(base[axis]);
                let Ok(shift) = i8::try_from(shift) else {
                    return Err(TriangulationError::Far { grain: vertex[k] as usize });
                };
                rest[k][axis] = shift;
            }
        }
        entries.push(Entry { vertex, rest, old, turn });
    }
    let sorted = sorted(entries, grains);
    let neighbours = renumbered(&sorted, pores.len(), |old| pores[old as usize].neighbour);
    Ok(Triangulation {
        pores: sorted.iter().map(|entry| entry.vertex).collect(),
        neighbours,
        shifts: sorted.iter().map(|entry| entry.rest).collect(),
        hidden: hidden(hidden_grains.into_iter()),
    })
}
