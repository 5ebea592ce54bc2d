//! Which of the near pairs have come to touch since the last step.

use super::pass::Scratch;
use super::{Contacts, Surroundings};
use porograin_geometry::Neighbours;
use rayon::prelude::*;

/// Pairs that are worth a thread.
const SHARE: usize = 4096;
/// How much more than pairs have come closer so far they may before more of them are looked at.
const LEVEL: f64 = 1.5;

/// Adds to `contacts` the near pairs that have come to touch; those that parted leave in the [pass](super::add).
///
/// `near` holds the sorted list of near pairs, `rebuilt` says whether it is new. The result depends on where the grains are
/// and on `contacts` alone, not on the scratch.
pub fn follow(
    contacts: &mut Contacts,
    surroundings: &Surroundings,
    near: &Neighbours,
    rebuilt: bool,
    scratch: &mut Scratch,
) {
    contacts.cover(surroundings.grains.len());
    if rebuilt || scratch.known != contacts.len() {
        scratch.apart.clear();
        scratch.soon.clear();
        (scratch.level, scratch.later) = (0.0, 0);
        let mut touching = contacts.pairs().peekable();
        for &pair in &near.pairs {
            while touching.next_if(|t| *t < pair).is_some() {}
            if touching.next_if_eq(&pair).is_none() {
                scratch.apart.push(pair);
            }
        }
    }
    let gap = near.gaps();
    // Pairs found since may be listed already or touch: who touches is told apart below.
    for &pair in &near.later[scratch.later..] {
        let list = if gap(pair) < scratch.level { &mut scratch.soon } else { &mut scratch.apart };
        list.push(pair);
    }
    scratch.later = near.later.len();
    // Pairs that were further apart when they were found than any two have come closer since need no look.
    if scratch.level == 0.0 || near.closer() >= scratch.level {
        scratch.level = (LEVEL * near.closer()).max(near.skin() / 16.0);
        scratch.soon.extend(scratch.apart.extract_if(.., |pair| gap(*pair) < scratch.level));
    }
    let Scratch { soon, found, born, .. } = scratch;
    found.clear();
    let pairs = soon.par_iter().enumerate().with_min_len(SHARE);
    found.par_extend(pairs.filter(|(_, pair)| surroundings.touches(**pair)).map(|(k, _)| k));
    born.clear();
    // From the back, so that whoever takes a place has been looked at.
    born.extend(found.iter().rev().map(|&k| soon.swap_remove(k)));
    if !born.is_empty() {
        born.sort_unstable();
        born.dedup();
        born.retain(|&pair| !contacts.holds(pair));
        contacts.insert(born);
    }
    scratch.near.follow(contacts, surroundings, near, rebuilt);
    scratch.known = contacts.len();
}
