//! What a contact took in and neither stores nor lost, and the force that gives it back.
//!
//! Leapfrog knows the forces at the steps alone. A force `F` does the work of half the motion before it and half the motion after it,
//! and summed over the steps that differs from what springs store and slip takes: by much where a contact opens or closes within a
//! step, by little where it turns. An account adds up the difference `a`, contact by contact, and a force `E = -a w/w²`, `|E| <= k |w|`,
//! on the first of the pair, which takes part in the motion of the next step as it did in that of the last, brings it back to nothing;
//! `w` is the way of the second against the first at the contact point in the last step, `k` the stiffness of the normal spring. The force
//! is of the order of what the springs change by in a step, so it vanishes with the step, and at rest. A contact that has parted
//! lives on until its account is settled, mostly for two to six steps.

use super::{ContactLaw, Law, Memory, More, Near, PairLoad, Touch};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The largest force of an account, over `k |w|`: a contact that closes or opens head on within a step needs at most an eighth.
const MOST: f64 = 1.0;
/// The surplus over `k w²` below which the account of a parted pair is written off; closing or opening makes up to an eighth.
const NOTHING: f64 = 1e-8;
/// Part of the reach by which a parted pair may be apart before its account is closed as it is.
const FAR: f64 = 0.1;

/// The account of one contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Account {
    /// What was taken in less what is stored and what was lost [J], at the time of the last force.
    pub surplus: f64,
    /// The force of the account, on the first of the pair [N].
    pub force: DVec3,
    /// The last force on the first of the pair, without dampers [N].
    load: DVec3,
    /// And its moment besides [N m].
    moment: DVec3,
    /// The branch at that time [m].
    branch: DVec3,
    /// Power of these in the motion that led there [W].
    power: f64,
    /// Time of that motion [s]; 0 before the first.
    last: f64,
}

impl Account {
    /// The account after a step of the length `last` [s] that led to `touch`; `before` is what the contact remembered, turned with it, `now`
    /// what it remembers and its load under `law`, `None` where it has parted.
    pub(super) fn settle(
        law: &Law,
        near: &Near,
        touch: &Touch,
        before: &Memory,
        now: Option<(&Memory, &PairLoad)>,
        last: f64,
    ) -> Account {
        let (old, normal) = (&before.account, touch.normal);
        let way = -last * touch.velocity.dot(normal);
        let fresh = old.last == 0.0;
        let branch = if fresh { near.branch - last * near.velocity } else { old.branch };
        let overlap = near.reach - branch.length();
        let at = |overlap: f64| Touch { overlap, ..*touch };
        let pressing = now.map_or(0.0, |(now, load)| match law.extras().restitution {
            Some(_) => law.pressing(touch, now),
            None => -load.force.dot(normal),
        });
        let mut account = Account { branch: near.branch, last, ..Account::default() };
        // A contact of which nothing is known, yet was one before the step, begins with nothing.
        if !fresh || !law.holds(&at(overlap), before) {
            let (shear, moment) = across(before, normal);
            let lost = shear.dot(touch.velocity) + moment.dot(touch.spin);
            // What a bond or a bridge takes in while it snaps is lost.
            let springs = if before.more.snapped(&now.map_or_else(More::default, |(now, _)| now.more)) {
                -0.5 * old.pressing() * way
            } else {
                let stored = |overlap: f64| law.pressed(&at(overlap), &before.more);
                0.5 * pressing * way - (stored(touch.overlap) - stored(overlap))
            };
            account.surplus = old.rest(near, touch, overlap, last) + springs - 0.5 * last * lost;
            let way = last * touch.velocity;
            let square = way.length_squared();
            let stiffness = law.stiffness(&at(touch.overlap.max(square.sqrt()))).normal;
            let small = account.surplus.abs() <= NOTHING * stiffness * square;
            if now.is_none() && (small || -touch.overlap > FAR * near.reach) {
                return Account::default();
            }
            if square > 0.0 {
                let most = MOST * stiffness;
                account.force = (-account.surplus / square).max(-most).min(most) * way;
                account.surplus += 0.5 * account.force.dot(way);
            }
        }
        let (shear, moment) = now.map_or_else(Default::default, |(now, _)| across(now, normal));
        account.load = shear - pressing * normal + account.force;
        account.moment = moment;
        account.power = account.load.dot(touch.velocity) + moment.dot(touch.spin);
        account
    }

    /// By what the pair pressed at the time of the last force [N].
    fn pressing(&self) -> f64 {
        -self.load.dot(self.branch.normalize_or_zero())
    }

    /// The surplus once the last force has taken part in the motion after it as well, which led to `near` in the time `last`;
    /// `overlap` is what it was at the time of the force.
    fn rest(&self, near: &Near, touch: &Touch, overlap: f64, last: f64) -> f64 {
        if self.last == 0.0 {
            return 0.0;
        }
        // The velocity at the contact point where it was then.
        let levers = near.radius.map(|radius| radius - 0.5 * overlap);
        let roll = levers[0] * near.spin[0] + levers[1] * near.spin[1];
        let normal = self.branch.normalize();
        let mut velocity = near.velocity - roll.cross(normal);
        if near.swing != DVec3::ZERO {
            let foot = near.branch - self.branch + near.radius[1] * (touch.normal - normal);
            velocity -= last * near.swing + near.spin[1].cross(foot);
        }
        let power = self.load.dot(velocity) + self.moment.dot(touch.spin);
        let kick = 0.5 * (self.last + last);
        self.surplus + 0.5 * kick * (self.power + power) - 0.5 * self.last * self.power
    }
}

/// The tangential force [N] and the moments [N m] on the first of the pair.
fn across(memory: &Memory, normal: DVec3) -> (DVec3, DVec3) {
    (memory.shear, memory.more.roll + memory.more.twist * normal)
}
