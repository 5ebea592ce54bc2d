//! What a contact law is, and the choice of laws.

use super::friction::{Extras, Full, Spring};
use super::{HertzMindlin, Linear, Memory, More, Stiffness, Touch};
use crate::grains::Grains;
use glam::DVec3;
use porograin_geometry::triangulation::wall;
use serde::{Deserialize, Serialize};

/// What a touching pair does, as mathematics: a function of the [`Touch`] and of what the contact remembers.
pub trait ContactLaw: Send + Sync {
    /// The load on the first of the pair; the second gets the opposite, the force at the same point.
    ///
    /// `memory` holds forces and moments on the first, already turned with the pair; the law advances it by the
    /// motion of the last step, `dt` long [s].
    fn load(&self, touch: &Touch, memory: &mut Memory, dt: f64) -> PairLoad;

    /// Tangent stiffnesses and dampers, which set the stable time step.
    fn stiffness(&self, touch: &Touch) -> Stiffness;

    /// Energy stored in the contact [J].
    fn energy(&self, touch: &Touch, memory: &Memory) -> f64;

    /// Whether the pair is a contact at all.
    #[inline(always)]
    fn holds(&self, touch: &Touch, _memory: &Memory) -> bool {
        touch.overlap > 0.0
    }
}

/// What acts on the first of a pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairLoad {
    /// At the contact point [N].
    pub force: DVec3,
    /// A couple besides the moment of the force [N m].
    pub moment: DVec3,
}

/// The choice of contact law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Linear springs with Coulomb friction.
    Linear(Linear),
    /// Hertz-Mindlin springs with Coulomb friction.
    HertzMindlin(HertzMindlin),
}

/// Runs `$body` with `$law` bound to the law inside a [`Law`].
macro_rules! with_law {
    ($choice:expr, $law:ident => $body:expr) => {
        match $choice {
            $crate::contact::Law::Linear($law) => $body,
            $crate::contact::Law::HertzMindlin($law) => $body,
        }
    };
}

impl Law {
    /// Friction angle between two grains [degrees]; walls have their own.
    pub fn friction(&self) -> f64 {
        with_law!(self, law => law.friction)
    }

    /// Another friction angle [degrees].
    pub fn set_friction(&mut self, angle: f64) {
        with_law!(self, law => law.friction = angle)
    }

    /// Contact modulus [Pa].
    pub fn young(&self) -> f64 {
        with_law!(self, law => law.young)
    }

    /// Force by which a pair presses without its dampers [N]; 0 where it is no contact.
    pub(crate) fn pressing(&self, touch: &Touch, memory: &Memory) -> f64 {
        if !self.holds(touch, memory) {
            return 0.0;
        }
        let still = Touch { velocity: DVec3::ZERO, spin: DVec3::ZERO, ..*touch };
        -self.load(&still, &mut memory.clone(), 0.0).force.dot(touch.normal)
    }

    /// Energy that a contact stores along its normal, in the spring, the bond and the bridge [J]; 0 where it is none.
    pub(crate) fn pressed(&self, touch: &Touch, more: &More) -> f64 {
        with_law!(self, law => Full(law).pressed(touch, more))
    }

    /// What it has besides springs and friction.
    pub fn extras(&self) -> Extras {
        with_law!(self, law => law.extras())
    }
}

impl ContactLaw for Law {
    #[inline]
    fn load(&self, touch: &Touch, memory: &mut Memory, dt: f64) -> PairLoad {
        with_law!(self, law => Full(law).load(touch, memory, dt))
    }

    #[inline]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        with_law!(self, law => Full(law).stiffness(touch))
    }

    fn energy(&self, touch: &Touch, memory: &Memory) -> f64 {
        with_law!(self, law => Full(law).energy(touch, memory))
    }

    #[inline]
    fn holds(&self, touch: &Touch, memory: &Memory) -> bool {
        with_law!(self, law => Full(law).holds(touch, memory))
    }
}

/// The laws of all contacts: one for all, and others between grains of given materials.
#[derive(Clone, Debug, PartialEq)]
pub struct Laws {
    /// Of every pair that has no law of its own.
    pub all: Law,
    /// Laws of pairs of materials.
    pub pairs: Vec<PairLaw>,
    /// Whether contacts keep [accounts](super::Account), and so lose no energy to the time integration.
    pub conserving: bool,
}

/// The law between two materials.
#[derive(Clone, Debug, PartialEq)]
pub struct PairLaw {
    /// The [materials](crate::Grains::material), in either order; [`WALL`] stands for the walls.
    pub between: [u16; 2],
    /// What acts between them.
    pub law: Law,
}

/// The walls, as a material.
pub const WALL: u16 = u16::MAX;

impl From<Law> for Laws {
    fn from(all: Law) -> Self {
        Laws { all, pairs: Vec::new(), conserving: false }
    }
}

impl Laws {
    /// The law that a pair of grains, or a grain and a wall, has of its own.
    #[inline]
    pub fn own(&self, grains: &Grains, [first, second]: [u32; 2]) -> Option<&Law> {
        if self.pairs.is_empty() {
            return None;
        }
        let a = grains.material[first as usize];
        let b = if wall(second).is_some() { WALL } else { grains.material[second as usize] };
        let own = self.pairs.iter().find(|pair| pair.between == [a, b] || pair.between == [b, a]);
        own.map(|pair| &pair.law)
    }

    /// Another friction angle between grains of any material [degrees].
    pub fn set_friction(&mut self, angle: f64) {
        self.all.set_friction(angle);
        self.pairs.iter_mut().for_each(|pair| pair.law.set_friction(angle));
    }

    /// Multiplies every friction angle between grains.
    pub fn scale_friction(&mut self, factor: f64) {
        let laws = std::iter::once(&mut self.all).chain(self.pairs.iter_mut().map(|pair| &mut pair.law));
        laws.for_each(|law| law.set_friction(factor * law.friction()));
    }

    /// Whether one law of springs and friction is all there is, and no accounts are kept.
    pub fn is_plain(&self) -> bool {
        !self.conserving && self.pairs.is_empty() && self.all.extras().is_empty()
    }

    /// Whether some law bonds grains.
    pub fn is_adhesive(&self) -> bool {
        self.iter().any(|law| law.extras().adhesion.is_some())
    }

    /// All laws.
    pub fn iter(&self) -> impl Iterator<Item = &Law> {
        std::iter::once(&self.all).chain(self.pairs.iter().map(|pair| &pair.law))
    }

    /// The gap up to which some law acts between these grains [m].
    pub fn reach(&self, grains: &Grains) -> f64 {
        if self.is_plain() {
            return 0.0;
        }
        let largest = grains.radius.iter().fold(0.0, |a: f64, &r| a.max(r));
        self.iter().map(|law| with_law!(law, law => Full(law).reach(largest))).fold(0.0, f64::max)
    }
}
