//! Pores that no water reaches: why the pressures of a mesh cannot be found, in the words of grains.

use super::mesh::{BLOCKED, FREE, Mesh};
use porograin_geometry::triangulation::wall;
use std::collections::BTreeSet;
use std::fmt;

/// Sets of pores that are told of.
const SETS: usize = 3;
/// Grains around each that are told of.
const GRAINS: usize = 8;

/// Connected sets of pores without a way to a held pressure; where none is held anywhere, all but the largest set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Detached {
    /// How many nodes they have in all.
    pub nodes: usize,
    /// Ids of the grains around each set, in rising order; sets by their first pore.
    pub around: Vec<Vec<u32>>,
    /// Whether no pressure is held anywhere.
    pub closed: bool,
}

impl Detached {
    /// Of a mesh; `id` is what users call a grain.
    pub fn of(mesh: &Mesh, id: impl Fn(u32) -> u32) -> Detached {
        let mut ways = vec![Vec::new(); mesh.nodes()];
        for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance) {
            if g > 0.0 {
                ways[i as usize].push(j as usize);
                ways[j as usize].push(i as usize);
            }
        }
        let mut set_of = vec![None; mesh.nodes()];
        // Number of nodes of each set, and whether one of them is held.
        let mut sets: Vec<(usize, bool)> = Vec::new();
        for start in 0..mesh.nodes() {
            if mesh.held[start] != FREE || set_of[start].is_some() {
                continue;
            }
            let (mut next, mut size, mut held) = (vec![start], 0, false);
            set_of[start] = Some(sets.len());
            while let Some(node) = next.pop() {
                size += 1;
                for &other in &ways[node] {
                    held |= !matches!(mesh.held[other], FREE | BLOCKED);
                    if mesh.held[other] == FREE && set_of[other].is_none() {
                        set_of[other] = Some(sets.len());
                        next.push(other);
                    }
                }
            }
            sets.push((size, held));
        }
        let closed = mesh.held.iter().all(|held| matches!(*held, FREE | BLOCKED));
        let largest = (0..sets.len()).max_by_key(|&set| (sets[set].0, std::cmp::Reverse(set)));
        let detached = |set: usize| if closed { Some(set) != largest } else { !sets[set].1 };
        let mut around = vec![BTreeSet::new(); sets.len()];
        for (vertices, &node) in mesh.triangulation.pores.iter().zip(&mesh.node) {
            if let Some(set) = set_of[node as usize].filter(|&set| detached(set)) {
                around[set].extend(vertices.iter().filter(|&&v| wall(v).is_none()).map(|&v| id(v)));
            }
        }
        let all = (0..sets.len()).filter(|&set| detached(set));
        Detached {
            nodes: all.clone().map(|set| sets[set].0).sum(),
            around: all.map(|set| around[set].iter().copied().collect()).collect(),
            closed,
        }
    }
}

impl fmt::Display for Detached {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let told = |grains: &Vec<u32>| {
            let names: Vec<String> = grains.iter().take(GRAINS).map(u32::to_string).collect();
            let more = grains.len().saturating_sub(GRAINS);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            format!("{}{more}", names.join(", "))
        };
        let sets: Vec<String> = self.around.iter().take(SETS).map(told).collect();
        let many = self.around.len();
        let where_ = match many {
            1 => format!("in one place, between the grains {}", sets.join("")),
            _ if many <= SETS => format!("in {many} places, between the grains {}", sets.join("; between ")),
            _ => format!("in {many} places, the first between the grains {}", sets.join("; between ")),
        };
        let (pores, are) = if self.nodes == 1 { ("pore", "is") } else { ("pores", "are") };
        let from = if self.closed { "all others" } else { "every place with an imposed pressure" };
        write!(
            f,
            "{} {pores} {are} cut off from {from}, {where_}: overlapping grains or blocked regions close all throats \
             around them",
            self.nodes
        )
    }
}
