//! One pass over the touching pairs: every load, every reaction, on any number of threads with the same bits.
//!
//! Grains are cut into blocks of [`BLOCK`] in order of index, and the contacts, which are sorted by their first
//! grain, with them. A block adds its loads in order of contact to its own grains and puts aside what acts on grains
//! of later blocks; that is added afterwards in order of contact. The order of every sum depends on [`BLOCK`] alone.

use super::{ContactLaw, Contacts, Law, Surroundings, Touch, turn, with_law};
use crate::grains::Loads;
use glam::DVec3;
use porograin_geometry::triangulation::wall;

/// Grains per block: large enough that most contacts stay inside, small enough to share a few thousand grains
/// between threads.
const BLOCK: usize = 512;

/// What the contacts keep between steps to be fast; dropping it changes no bit.
#[derive(Debug, Default)]
pub struct Scratch {
    /// Near pairs that do not touch.
    pub(super) apart: Vec<[u32; 2]>,
    /// Pairs that came to touch in this step.
    pub(super) born: Vec<[u32; 2]>,
    /// How many contacts `apart` goes with.
    pub(super) known: usize,
    blocks: Vec<Block>,
}

/// What a block finds besides the loads on its own grains.
#[derive(Debug, Default)]
struct Block {
    later: Vec<Later>,
    parted: Vec<u32>,
    wall: [DVec3; 6],
}

/// The load of one contact on a grain of a later block.
#[derive(Debug)]
struct Later {
    grain: u32,
    force: DVec3,
    torque: DVec3,
}

/// Adds the loads of all contacts and turns and advances their memory; `last` is the length of the step that led
/// here [s]. Pairs that have parted leave the list.
pub fn add(
    loads: &mut Loads,
    contacts: &mut Contacts,
    law: &Law,
    surroundings: &Surroundings,
    last: f64,
    scratch: &mut Scratch,
) {
    let blocks = loads.force.len().div_ceil(BLOCK).max(1);
    scratch.blocks.resize_with(blocks, Block::default);
    let share = Share {
        first_block: 0,
        first_contact: 0,
        pairs: &contacts.pairs,
        shear: &mut contacts.shear,
        force: &mut loads.force,
        torque: &mut loads.torque,
        blocks: &mut scratch.blocks,
    };
    with_law!(law, law => share.split(law, surroundings, last));

    for block in &scratch.blocks {
        for later in &block.later {
            loads.force[later.grain as usize] += later.force;
            loads.torque[later.grain as usize] += later.torque;
        }
        for face in 0..6 {
            loads.wall[face] += block.wall[face];
        }
    }
    remove_parted(contacts, scratch);
}

/// Consecutive blocks with the grains and contacts that belong to them.
struct Share<'a> {
    first_block: usize,
    first_contact: usize,
    pairs: &'a [[u32; 2]],
    shear: &'a mut [DVec3],
    force: &'a mut [DVec3],
    torque: &'a mut [DVec3],
    blocks: &'a mut [Block],
}

impl Share<'_> {
    /// Halves the blocks between threads until one is left.
    fn split<L: ContactLaw>(self, law: &L, surroundings: &Surroundings, last: f64) {
        let half = self.blocks.len() / 2;
        if half == 0 {
            return self.run(law, surroundings, last);
        }
        let (grain, middle) = (half * BLOCK, (self.first_block + half) * BLOCK);
        let cut = self.pairs.partition_point(|pair| (pair[0] as usize) < middle);
        let (pairs, more_pairs) = self.pairs.split_at(cut);
        let (shear, more_shear) = self.shear.split_at_mut(cut);
        let (force, more_force) = self.force.split_at_mut(grain);
        let (torque, more_torque) = self.torque.split_at_mut(grain);
        let (blocks, more_blocks) = self.blocks.split_at_mut(half);
        let (first_block, first_contact) = (self.first_block, self.first_contact);
        let front = Share { first_block, first_contact, pairs, shear, force, torque, blocks };
        let back = Share {
            first_block: first_block + half,
            first_contact: first_contact + cut,
            pairs: more_pairs,
            shear: more_shear,
            force: more_force,
            torque: more_torque,
            blocks: more_blocks,
        };
        rayon::join(|| front.split(law, surroundings, last), || back.split(law, surroundings, last));
    }

    fn run<L: ContactLaw>(self, law: &L, surroundings: &Surroundings, last: f64) {
        let block = &mut self.blocks[0];
        block.later.clear();
        block.parted.clear();
        block.wall = [DVec3::ZERO; 6];
        let offset = self.first_block * BLOCK;
        for k in 0..self.pairs.len() {
            let pair = self.pairs[k];
            let touch = surroundings.touch(pair);
            if touch.overlap <= 0.0 {
                block.parted.push((self.first_contact + k) as u32);
                continue;
            }
            let (force, moment) = evaluate(law, &touch, &mut self.shear[k], last);
            let [near, far] = touch.levers();
            let i = pair[0] as usize - offset;
            self.force[i] += force;
            self.torque[i] += near * moment;
            if let Some(face) = wall(pair[1]) {
                block.wall[face] -= force;
            } else if let Some(on) = self.force.get_mut(pair[1] as usize - offset) {
                *on -= force;
                self.torque[pair[1] as usize - offset] += far * moment;
            } else {
                block.later.push(Later { grain: pair[1], force: -force, torque: far * moment });
            }
        }
    }
}

/// Force on the first of the pair, and `n x F`: times a lever it is the torque, of the same sense on both.
#[inline(always)]
fn evaluate<L: ContactLaw>(law: &L, touch: &Touch, shear: &mut DVec3, last: f64) -> (DVec3, DVec3) {
    *shear = turn(*shear, touch.normal, touch.twist * last);
    let force = law.load(touch, shear, last);
    (force, touch.normal.cross(force))
}

/// Takes the pairs that parted out of the contacts and back among the near ones.
fn remove_parted(contacts: &mut Contacts, scratch: &mut Scratch) {
    let mut parted = scratch.blocks.iter().flat_map(|block| &block.parted).map(|&k| k as usize).peekable();
    let Some(&first) = parted.peek() else { return };
    let mut kept = first;
    for k in first..contacts.pairs.len() {
        if parted.next_if_eq(&k).is_some() {
            scratch.apart.push(contacts.pairs[k]);
        } else {
            contacts.pairs[kept] = contacts.pairs[k];
            contacts.shear[kept] = contacts.shear[k];
            kept += 1;
        }
    }
    contacts.pairs.truncate(kept);
    contacts.shear.truncate(kept);
    scratch.known = kept;
}
