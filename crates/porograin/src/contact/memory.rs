//! The touching pairs and what each remembers from step to step.

use super::{Bond, Laws, turn};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The touching pairs and what each remembers; sorted by `(first, second)`.
///
/// A pair is `(i, j)` with `i < j` for two grains, or `(i, FIRST_WALL + face)` for a grain and a wall.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Contacts {
    /// The pairs.
    pub pairs: Vec<[u32; 2]>,
    /// Shear force on the first of each pair [N].
    pub shear: Vec<DVec3>,
    /// What some laws remember besides; `None` under a law that needs no more than the shear force.
    pub more: Option<Vec<More>>,
    /// Whether there was adhesion in the last step.
    pub adhesive: bool,
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

/// All that one contact remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    /// Shear force on the first of the pair [N].
    pub shear: DVec3,
    /// Under most laws unused.
    pub more: More,
}

impl From<DVec3> for Memory {
    /// A contact that remembers a shear force [N] and nothing else.
    fn from(shear: DVec3) -> Self {
        Memory { shear, more: More::default() }
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
    /// Number of touching pairs, those with walls included.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether nothing touches anything.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// What contact `k` remembers.
    pub fn memory(&self, k: usize) -> Memory {
        Memory { shear: self.shear[k], more: self.more.as_ref().map_or(More::default(), |more| more[k]) }
    }

    /// Starts or ends remembering more than the shear force; where adhesion begins it bonds what touches.
    pub(super) fn remember(&mut self, laws: &Laws) {
        if laws.is_plain() == self.more.is_some() {
            self.more = (!laws.is_plain()).then(|| vec![More::default(); self.pairs.len()]);
        }
        if laws.is_adhesive() != self.adhesive {
            self.adhesive = !self.adhesive;
            let bond = if self.adhesive { Bond::Whole } else { Bond::None };
            self.more.iter_mut().flatten().for_each(|more| more.bond = bond);
        }
    }
}
