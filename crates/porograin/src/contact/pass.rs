//! One pass over the touching pairs: every load, every reaction, on any number of threads with the same bits.
//!
//! Grains are cut into blocks of [a few rows](rows_of_a_block) of contacts in order of index. A block adds its loads in order
//! of contact to its own grains and puts aside what acts on grains of later blocks; those add it afterwards in order of
//! contact. The order of every sum depends on the number of grains alone.

use super::lanes::{BATCH, Batch};
use super::memory::{ROW, Row};
use super::{Account, ContactLaw, Contacts, Law, PairLoad, Plain, Surroundings};
use crate::grains::{Loads, Push};
use crate::walls::is_part;
use glam::{DMat3, DVec3};
use porograin_geometry::triangulation::wall;
use rayon::prelude::*;

/// Rows per block, for so many grains: large enough that most contacts stay inside, small enough to share a few thousand
/// grains between threads.
fn rows_of_a_block(grains: usize) -> usize {
    grains.div_ceil(16 * ROW).clamp(1, 16)
}

/// What the contacts keep between steps to be fast; dropping it changes no bit.
#[derive(Debug, Default)]
pub struct Scratch {
    /// Near pairs that cannot touch before some pair has come closer by [`level`](Self::level) since the list was made.
    pub(super) apart: Vec<[u32; 2]>,
    /// The other near pairs that do not touch.
    pub(super) soon: Vec<[u32; 2]>,
    /// [m]
    pub(super) level: f64,
    /// How many of the pairs that were found since the list was made are among those.
    pub(super) later: usize,
    /// Where among those are the pairs that came to touch in this step.
    pub(super) found: Vec<usize>,
    /// These pairs.
    pub(super) born: Vec<[u32; 2]>,
    /// How many contacts these lists go with.
    pub(super) known: usize,
    /// Grains near walls that the case adds.
    pub(super) near: super::parts::Near,
    blocks: Vec<Block>,
}

/// What a block finds besides the loads on its own grains.
#[derive(Debug, Default)]
struct Block {
    /// What acts on the grains of each later block.
    later: Vec<Vec<Later>>,
    /// Pairs that have parted, other than with parts of walls.
    parted: Vec<[u32; 2]>,
    /// Where in the row at hand those that have parted are.
    ended: Vec<u32>,
    wall: [DVec3; 6],
    /// Pairs with parts of walls that the case adds, and what acts on the grain.
    parts: Vec<([u32; 2], Push)>,
    virial: DMat3,
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
    surroundings: &Surroundings,
    last: f64,
    scratch: &mut Scratch,
) {
    let laws = surroundings.laws;
    contacts.remember(laws);
    loads.walls.resize(surroundings.walls.len(), Push::default());
    let stressed = loads.virial.is_some();
    contacts.cover(loads.force.len());
    let rows = rows_of_a_block(loads.force.len());
    let blocks = loads.force.len().div_ceil(rows * ROW).max(1);
    scratch.blocks.resize_with(blocks, Block::default);
    scratch.blocks.iter_mut().for_each(|block| block.later.resize_with(blocks, Vec::new));
    let share = Share {
        rows_of_a_block: rows,
        first_block: 0,
        stressed,
        rows: &mut contacts.rows,
        force: &mut loads.force,
        torque: &mut loads.torque,
        blocks: &mut scratch.blocks,
    };
    // The choice of law is made here, once; only laws with extras or of several materials choose pair by pair.
    match &laws.all {
        _ if !laws.is_plain() => share.split(&|share| share.run_each(surroundings, last)),
        Law::Linear(law) => share.split(&|share| share.run_plain(&Plain(law), surroundings, last)),
        Law::HertzMindlin(law) => share.split(&|share| share.run_plain(&Plain(law), surroundings, last)),
    }

    let size = rows * ROW;
    let parts = (loads.force.par_chunks_mut(size), loads.torque.par_chunks_mut(size));
    parts.into_par_iter().enumerate().for_each(|(own, (force, torque))| {
        for later in scratch.blocks[..own].iter().flat_map(|block| &block.later[own]) {
            let grain = later.grain as usize - own * size;
            force[grain] += later.force;
            torque[grain] += later.torque;
        }
    });
    for block in &scratch.blocks {
        scratch.soon.extend_from_slice(&block.parted);
        for face in 0..6 {
            loads.wall[face] += block.wall[face];
        }
        if let Some(virial) = &mut loads.virial {
            *virial += block.virial;
        }
        for (pair, on_grain) in &block.parts {
            surroundings.react(*pair, on_grain, &mut loads.walls);
        }
    }
    scratch.known = contacts.len();
}

/// Consecutive blocks with the grains and contacts that belong to them.
struct Share<'a> {
    rows_of_a_block: usize,
    first_block: usize,
    /// Whether the virial is asked for.
    stressed: bool,
    rows: &'a mut [Row],
    force: &'a mut [DVec3],
    torque: &'a mut [DVec3],
    blocks: &'a mut [Block],
}

impl Share<'_> {
    /// Halves the blocks between threads until one is left.
    fn split(self, run: &(impl Fn(Self) + Sync)) {
        let half = self.blocks.len() / 2;
        if half == 0 {
            return run(self);
        }
        let row = half * self.rows_of_a_block;
        let (rows, more_rows) = self.rows.split_at_mut(row);
        let (force, more_force) = self.force.split_at_mut(row * ROW);
        let (torque, more_torque) = self.torque.split_at_mut(row * ROW);
        let (blocks, more_blocks) = self.blocks.split_at_mut(half);
        let Share { rows_of_a_block, first_block, stressed, .. } = self;
        let front = Share { rows_of_a_block, first_block, stressed, rows, force, torque, blocks };
        let back = Share {
            rows_of_a_block,
            first_block: first_block + half,
            stressed,
            rows: more_rows,
            force: more_force,
            torque: more_torque,
            blocks: more_blocks,
        };
        rayon::join(|| front.split(run), || back.split(run));
    }

    /// Springs and friction, one law for all, in the widest vectors of the machine.
    fn run_plain<L: ContactLaw>(self, law: &L, surroundings: &Surroundings, last: f64) {
        #[cfg(target_arch = "x86_64")]
        let bare = !self.stressed && surroundings.walls.is_empty();
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe {
                if bare {
                    self.run_plain_avx2::<L, false>(law, surroundings, last)
                } else {
                    self.run_plain_avx2::<L, true>(law, surroundings, last)
                }
            };
        }
        self.run_lanes::<L, true>(law, surroundings, last);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn run_plain_avx2<L: ContactLaw, const MORE: bool>(
        self,
        law: &L,
        surroundings: &Surroundings,
        last: f64,
    ) {
        self.run_lanes::<L, MORE>(law, surroundings, last);
    }

    /// `MORE`: there may be walls that the case adds, or the virial is asked for.
    #[inline(always)]
    fn run_lanes<L: ContactLaw, const MORE: bool>(mut self, law: &L, surroundings: &Surroundings, last: f64) {
        self.begin();
        let mut batch = Batch::new();
        for row in std::mem::take(&mut self.rows) {
            let (pairs, shear) = (&row.pairs[..], &mut row.shear[..row.pairs.len()]);
            for start in (0..pairs.len()).step_by(BATCH) {
                let end = (start + BATCH).min(pairs.len());
                for k in start..end {
                    if MORE && is_part(pairs[k][1]) {
                        put_part(&mut batch, k - start, surroundings, pairs[k], shear[k]);
                    } else {
                        batch.put(k - start, &surroundings.near_with::<false>(pairs[k]), shear[k]);
                    }
                }
                batch.compute(law, last);
                for k in start..end {
                    let lane = batch.lane(k - start);
                    if lane.overlap > 0.0 {
                        shear[k] = lane.shear;
                        if MORE && self.stressed {
                            self.strain(pairs[k], lane.force, lane.levers, batch.branch(k - start));
                        }
                        self.give::<MORE>(pairs[k], lane.force, lane.turning, lane.levers, DVec3::ZERO);
                    } else {
                        self.end(k);
                    }
                }
            }
            self.part(row);
        }
    }

    /// Any law, looked up pair by pair.
    fn run_each(mut self, surroundings: &Surroundings, last: f64) {
        self.begin();
        for row in std::mem::take(&mut self.rows) {
            for k in 0..row.pairs.len() {
                let pair = row.pairs[k];
                let (law, near, mut memory) =
                    (surroundings.law(pair), surroundings.near(pair), row.memory(k));
                let touch = surroundings.touch_of(pair, &near);
                memory.turn(touch.normal, touch.twist * last);
                let before = memory;
                let (mut load, mut holds) = (PairLoad::default(), law.holds(&touch, &memory));
                if holds {
                    load = law.load(&touch, &mut memory, last);
                    holds = law.holds(&touch, &memory);
                }
                if surroundings.laws.conserving {
                    if !holds {
                        (load, memory) = Default::default();
                    }
                    let now = holds.then_some(&memory);
                    let account =
                        Account::settle(law, &near, &touch, &before, now.map(|now| (now, &load)), last);
                    load.force += account.force;
                    holds |= account != Account::default();
                    row.accounts[k] = account;
                }
                if !holds {
                    self.end(k);
                    continue;
                }
                (row.shear[k], row.more[k]) = (memory.shear, memory.more);
                let turning = touch.normal.cross(load.force);
                if self.stressed {
                    self.strain(pair, load.force, touch.levers(), touch.normal);
                }
                self.give::<true>(pair, load.force, turning, touch.levers(), load.moment);
            }
            self.part(row);
        }
    }

    fn begin(&mut self) {
        let block = &mut self.blocks[0];
        block.later.iter_mut().for_each(Vec::clear);
        block.parted.clear();
        block.wall = [DVec3::ZERO; 6];
        block.parts.clear();
        block.virial = DMat3::ZERO;
    }

    /// Keeps what acts on the grain of a pair with part of a wall that the case adds.
    #[cold]
    #[inline(never)]
    fn put_aside(&mut self, pair: [u32; 2], force: DVec3, moment: DVec3) {
        self.blocks[0].parts.push((pair, Push { force, moment }));
    }

    /// Adds a contact to the virial; `along` is any vector along its branch, which at a wall ends at the contact point.
    #[inline(never)]
    fn strain(&mut self, pair: [u32; 2], force: DVec3, levers: [f64; 2], along: DVec3) {
        let length = if wall(pair[1]).is_some() { levers[0] } else { levers[0] + levers[1] };
        let branch = length * along.normalize_or_zero();
        self.blocks[0].virial -= DMat3::from_cols(force * branch.x, force * branch.y, force * branch.z);
    }

    fn end(&mut self, k: usize) {
        self.blocks[0].ended.push(k as u32);
    }

    /// Takes the pairs that have parted out of their row.
    fn part(&mut self, row: &mut Row) {
        let Block { ended, parted, .. } = &mut self.blocks[0];
        // Where grains meet walls that the case adds is found anew in every step.
        let pairs = ended.iter().map(|&k| row.pairs[k as usize]);
        parted.extend(pairs.filter(|pair| !is_part(pair[1])));
        row.remove(ended);
        ended.clear();
    }

    /// Adds a force and a moment to the first of the pair and the opposite to the second; `turning`, `n x F`, times a lever
    /// is a torque of the same sense on both.
    #[inline(always)]
    fn give<const MORE: bool>(
        &mut self,
        pair: [u32; 2],
        force: DVec3,
        turning: DVec3,
        levers: [f64; 2],
        moment: DVec3,
    ) {
        let offset = self.first_block * self.rows_of_a_block * ROW;
        let i = pair[0] as usize - offset;
        self.force[i] += force;
        self.torque[i] += levers[0] * turning + moment;
        if let Some(face) = wall(pair[1]) {
            match self.blocks[0].wall.get_mut(face) {
                Some(on) => *on -= force,
                None if !MORE => unreachable!("a pair with a wall that the case has not"),
                None => self.put_aside(pair, force, levers[0] * turning + moment),
            }
            return;
        }
        let (j, torque) = (pair[1] as usize - offset, levers[1] * turning - moment);
        if let Some(on) = self.force.get_mut(j) {
            *on -= force;
            self.torque[j] += torque;
        } else {
            let block = pair[1] as usize / (self.rows_of_a_block * ROW);
            self.blocks[0].later[block].push(Later { grain: pair[1], force: -force, torque });
        }
    }
}

/// Puts a pair with part of a wall that the case adds into a batch: apart, so that all others stay in registers on their way there.
#[cold]
#[inline(never)]
fn put_part(batch: &mut Batch, lane: usize, surroundings: &Surroundings, pair: [u32; 2], shear: DVec3) {
    batch.put(lane, &surroundings.near(pair), shear);
}
