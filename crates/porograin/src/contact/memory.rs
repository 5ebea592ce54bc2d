//! The touching pairs and what each remembers from step to step.

use super::{Account, Bond, Laws, turn};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Grains per [`Row`].
pub(super) const ROW: usize = 512;

/// The touching pairs and what each remembers; sorted by `(first, second)`.
///
/// A pair is `(i, j)` with `i < j` for two grains, or `(i, FIRST_WALL + face)` for a grain and a wall. They are kept in rows,
/// so that one that comes or goes moves those of its row only.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Contacts {
    /// In order of the grains.
    pub(super) rows: Vec<Row>,
    /// Whether contacts remember more than the shear force, as some laws need.
    pub(super) rich: bool,
    /// Whether contacts keep accounts.
    pub(super) conserving: bool,
    /// Whether there was adhesion in the last step.
    adhesive: bool,
}

/// The contacts whose first grain is one of [`ROW`] consecutive ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Row {
    /// The pairs.
    pub pairs: Vec<[u32; 2]>,
    /// Shear force on the first of each pair [N].
    pub shear: Vec<DVec3>,
    /// What some laws remember besides; empty under a law that needs no more than the shear force.
    pub more: Vec<More>,
    /// Their accounts; empty where none are kept.
    pub accounts: Vec<Account>,
}

/// What a contact remembers besides its shear force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct More {
    /// Rolling moment on the first of the pair, across the normal [N m].
    pub roll: DVec3,
    /// Twisting moment on the first of the pair, about the normal [N m].
    pub twist: f64,
    /// The bond, under a law with adhesion.
    pub bond: Bond,
    /// Whether there is a liquid bridge.
    pub bridge: bool,
}

impl More {
    /// Whether a bond broke, or a bridge formed or broke, from here to `now`.
    pub(crate) fn snapped(&self, now: &More) -> bool {
        self.bridge != now.bridge || self.bond == Bond::Whole && now.bond != Bond::Whole
    }
}

/// All that one contact remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    /// Shear force on the first of the pair [N].
    pub shear: DVec3,
    /// Under most laws unused.
    pub more: More,
    /// Unused unless contacts conserve the energy.
    pub account: Account,
}

impl From<DVec3> for Memory {
    /// A contact that remembers a shear force [N] and nothing else.
    fn from(shear: DVec3) -> Self {
        Memory { shear, ..Memory::default() }
    }
}

impl Memory {
    /// Turns it with its pair: the tilt of the normal, and `angle` [rad] about it.
    #[inline]
    pub fn turn(&mut self, normal: DVec3, angle: f64) {
        self.shear = turn(self.shear, normal, angle);
        self.more.roll = turn(self.more.roll, normal, angle);
    }
}

impl Contacts {
    /// Contacts that remember a shear force on the first of the pair [N] and nothing else, in any order.
    pub fn new(contacts: impl IntoIterator<Item = ([u32; 2], DVec3)>) -> Self {
        let mut all: Vec<_> = contacts.into_iter().collect();
        all.sort_by_key(|(pair, _)| *pair);
        let mut contacts = Contacts::default();
        for (pair, shear) in all {
            contacts.cover(pair[0] as usize + 1);
            let row = contacts.row(pair[0]);
            row.pairs.push(pair);
            row.shear.push(shear);
        }
        contacts
    }

    /// Number of touching pairs, those with walls included.
    pub fn len(&self) -> usize {
        self.rows.iter().map(|row| row.pairs.len()).sum()
    }

    /// Whether nothing touches anything.
    pub fn is_empty(&self) -> bool {
        self.rows.iter().all(|row| row.pairs.is_empty())
    }

    /// The touching pairs, sorted.
    pub fn pairs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.rows.iter().flat_map(|row| row.pairs.iter().copied())
    }

    /// Whether a pair touches.
    pub fn holds(&self, pair: [u32; 2]) -> bool {
        self.rows.get(pair[0] as usize / ROW).is_some_and(|row| row.pairs.binary_search(&pair).is_ok())
    }

    /// Every contact and what it remembers, sorted by pair.
    pub fn iter(&self) -> impl Iterator<Item = ([u32; 2], Memory)> {
        self.rows.iter().flat_map(|row| (0..row.pairs.len()).map(|k| (row.pairs[k], row.memory(k))))
    }

    /// Makes room for the contacts of so many grains.
    pub(super) fn cover(&mut self, grains: usize) {
        let rows = grains.div_ceil(ROW).max(self.rows.len());
        self.rows.resize_with(rows, Row::default);
    }

    /// The row of the contacts whose first grain is this one.
    pub(super) fn row(&mut self, first: u32) -> &mut Row {
        &mut self.rows[first as usize / ROW]
    }

    /// Adds sorted new pairs without memory.
    pub(super) fn insert(&mut self, born: &[[u32; 2]]) {
        let (rich, conserving) = (self.rich, self.conserving);
        for part in born.chunk_by(|a, b| a[0] as usize / ROW == b[0] as usize / ROW) {
            self.row(part[0][0]).insert(part, rich, conserving);
        }
    }

    /// Starts or ends remembering more than the shear force; where adhesion begins it bonds what touches.
    pub(super) fn remember(&mut self, laws: &Laws) {
        if laws.is_plain() == self.rich {
            self.rich = !laws.is_plain();
            for row in &mut self.rows {
                row.more = vec![More::default(); if self.rich { row.pairs.len() } else { 0 }];
            }
        }
        if laws.conserving != self.conserving {
            self.conserving = laws.conserving;
            for row in &mut self.rows {
                let length = if self.conserving { row.pairs.len() } else { 0 };
                row.accounts = vec![Account::default(); length];
            }
        }
        if laws.is_adhesive() != self.adhesive {
            self.adhesive = !self.adhesive;
            let bond = if self.adhesive { Bond::Whole } else { Bond::None };
            self.rows.iter_mut().flat_map(|row| &mut row.more).for_each(|more| more.bond = bond);
        }
    }
}

impl Row {
    /// What contact `k` of the row remembers.
    pub fn memory(&self, k: usize) -> Memory {
        Memory {
            shear: self.shear[k],
            more: self.more.get(k).copied().unwrap_or_default(),
            account: self.accounts.get(k).copied().unwrap_or_default(),
        }
    }

    /// Merges sorted new pairs in, from the back so that every entry moves once; `rich` contacts remember more than a shear force,
    /// `conserving` ones keep an account.
    fn insert(&mut self, born: &[[u32; 2]], rich: bool, conserving: bool) {
        let (mut old, mut new) = (self.pairs.len(), born.len());
        lengthen(&mut self.pairs, old + new, [0; 2]);
        lengthen(&mut self.shear, old + new, DVec3::ZERO);
        if rich {
            lengthen(&mut self.more, old + new, More::default());
        }
        if conserving {
            lengthen(&mut self.accounts, old + new, Account::default());
        }
        while new > 0 {
            let to = old + new - 1;
            let stays = old > 0 && self.pairs[old - 1] > born[new - 1];
            if stays {
                old -= 1;
                self.shear[to] = self.shear[old];
            } else {
                new -= 1;
                self.shear[to] = DVec3::ZERO;
            }
            self.pairs[to] = if stays { self.pairs[old] } else { born[new] };
            if rich {
                self.more[to] = if stays { self.more[old] } else { More::default() };
            }
            if conserving {
                self.accounts[to] = if stays { self.accounts[old] } else { Account::default() };
            }
        }
    }

    /// Takes out the contacts with these numbers, which are sorted.
    pub fn remove(&mut self, parted: &[u32]) {
        remove(&mut self.pairs, parted);
        remove(&mut self.shear, parted);
        if !self.more.is_empty() {
            remove(&mut self.more, parted);
        }
        if !self.accounts.is_empty() {
            remove(&mut self.accounts, parted);
        }
    }
}

/// Resizes to `length`, with room for few more: doubling would leave half of the memory unused.
fn lengthen<T: Clone>(list: &mut Vec<T>, length: usize, filling: T) {
    if length > list.capacity() {
        list.reserve_exact(length + length / 16 - list.len());
    }
    list.resize(length, filling);
}

/// Takes out the entries with these numbers, which are sorted.
fn remove<T: Copy>(list: &mut Vec<T>, places: &[u32]) {
    let Some(&first) = places.first() else { return };
    let mut kept = first as usize;
    for (k, &place) in places.iter().enumerate() {
        let from = place as usize + 1;
        let to = places.get(k + 1).map_or(list.len(), |&next| next as usize);
        list.copy_within(from..to, kept);
        kept += to - from;
    }
    list.truncate(kept);
}
