//! The loads of many contacts at once: gathered into columns, computed side by side, handed back in order.
//!
//! The law itself stays scalar mathematics. What makes the compiler compute several contacts in one vector is that the loop over
//! a batch reads and writes columns and has no branch. There is no fused multiply-add and no approximation, so wider vectors
//! give the same bits.

use super::{ContactLaw, Memory, Near, turn};
use glam::DVec3;

/// Contacts in a batch: its columns fit in the first cache.
pub(super) const BATCH: usize = 32;

type Column = [f64; BATCH];

/// A batch of contacts in columns, in and out; aligned, so that no vector lies across two lines of the cache.
#[repr(align(64))]
pub(super) struct Batch {
    branch: [Column; 3],
    velocity: [Column; 3],
    spin: [[Column; 3]; 2],
    radius: [Column; 2],
    reach: Column,
    friction: Column,
    /// Shear force on the first, before and after [N].
    shear: [Column; 3],
    /// Force on the first [N].
    force: [Column; 3],
    /// `n x F` [N].
    turning: [Column; 3],
    levers: [Column; 2],
    overlap: Column,
}

/// The result for one contact.
pub(super) struct Lane {
    pub overlap: f64,
    pub shear: DVec3,
    pub force: DVec3,
    pub turning: DVec3,
    pub levers: [f64; 2],
}

impl Batch {
    pub fn new() -> Self {
        let (one, three) = ([0.0; BATCH], [[0.0; BATCH]; 3]);
        Batch {
            branch: three,
            velocity: three,
            spin: [three; 2],
            radius: [one; 2],
            reach: one,
            friction: one,
            shear: three,
            force: three,
            turning: three,
            levers: [one; 2],
            overlap: one,
        }
    }

    /// Puts a contact into lane `l`.
    #[inline(always)]
    pub fn put(&mut self, l: usize, near: &Near, shear: DVec3) {
        let set = |columns: &mut [Column; 3], v: DVec3| {
            (columns[0][l], columns[1][l], columns[2][l]) = (v.x, v.y, v.z);
        };
        set(&mut self.branch, near.branch);
        set(&mut self.velocity, near.velocity);
        set(&mut self.spin[0], near.spin[0]);
        set(&mut self.spin[1], near.spin[1]);
        set(&mut self.shear, shear);
        (self.radius[0][l], self.radius[1][l]) = (near.radius[0], near.radius[1]);
        (self.reach[l], self.friction[l]) = (near.reach, near.friction);
    }

    /// Computes all lanes; those beyond the contacts put in hold leftovers, which nobody reads.
    #[inline(always)]
    pub fn compute<L: ContactLaw>(&mut self, law: &L, last: f64) {
        for l in 0..BATCH {
            let get = |columns: &[Column; 3]| DVec3::new(columns[0][l], columns[1][l], columns[2][l]);
            let near = Near {
                branch: get(&self.branch),
                reach: self.reach[l],
                radius: [self.radius[0][l], self.radius[1][l]],
                velocity: get(&self.velocity),
                spin: [get(&self.spin[0]), get(&self.spin[1])],
                friction: self.friction[l],
                swing: DVec3::ZERO,
                // Plain laws have no dampers.
                mass: 0.0,
            };
            let touch = near.touch();
            let mut memory = Memory::from(turn(get(&self.shear), touch.normal, touch.twist * last));
            let force = law.load(&touch, &mut memory, last).force;
            let (turning, shear) = (touch.normal.cross(force), memory.shear);
            (self.shear[0][l], self.shear[1][l], self.shear[2][l]) = (shear.x, shear.y, shear.z);
            (self.force[0][l], self.force[1][l], self.force[2][l]) = (force.x, force.y, force.z);
            (self.turning[0][l], self.turning[1][l], self.turning[2][l]) = (turning.x, turning.y, turning.z);
            [self.levers[0][l], self.levers[1][l]] = touch.levers();
            self.overlap[l] = touch.overlap;
        }
    }

    /// The branch of lane `l` [m].
    #[inline(always)]
    pub fn branch(&self, l: usize) -> DVec3 {
        DVec3::new(self.branch[0][l], self.branch[1][l], self.branch[2][l])
    }

    /// What was computed in lane `l`.
    #[inline(always)]
    pub fn lane(&self, l: usize) -> Lane {
        let get = |columns: &[Column; 3]| DVec3::new(columns[0][l], columns[1][l], columns[2][l]);
        Lane {
            overlap: self.overlap[l],
            shear: get(&self.shear),
            force: get(&self.force),
            turning: get(&self.turning),
            levers: [self.levers[0][l], self.levers[1][l]],
        }
    }
}
