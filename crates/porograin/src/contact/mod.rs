//! Contacts: who touches whom, the memory of each contact, and the laws.

mod follow;
mod linear;
mod pass;
#[cfg(test)]
mod tests;
mod touch;
pub use follow::follow;
pub use linear::Linear;
pub use pass::{Scratch, add};
pub use touch::{Stiffness, Surroundings, Touch, turn};

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
}

/// The choice of contact law; matched once per step, not per pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Linear springs with Coulomb friction.
    Linear(Linear),
}

/// Runs `$body` with `$law` bound to the law inside a [`Law`]: compiled once per law, so that pair loops are
/// specialised and the choice is made outside them.
macro_rules! with_law {
    ($choice:expr, $law:ident => $body:expr) => {
        match $choice {
            $crate::contact::Law::Linear($law) => $body,
        }
    };
}
pub(crate) use with_law;

/// What a touching pair does, as mathematics: a function of the [`Touch`] and of the shear force it remembers.
pub trait ContactLaw: Send + Sync {
    /// The force on the first of the pair [N]; the second gets the opposite, at the same point.
    ///
    /// `shear` is the shear force on the first [N], already turned with the pair; the law advances it by the
    /// sliding of the last step, `dt` long [s].
    fn load(&self, touch: &Touch, shear: &mut DVec3, dt: f64) -> DVec3;

    /// Tangent stiffnesses, which set the stable time step.
    fn stiffness(&self, touch: &Touch) -> Stiffness;

    /// Energy stored in the contact [J].
    fn energy(&self, touch: &Touch, shear: DVec3) -> f64;

    /// Friction angle between two grains [degrees]; walls have their own.
    fn friction(&self) -> f64;

    /// The gap up to which the law acts [m].
    fn reach(&self) -> f64 {
        0.0
    }
}

impl Law {
    /// The law behind the choice, for whatever is not a hot loop.
    pub fn as_law(&self) -> &dyn ContactLaw {
        with_law!(self, law => law)
    }
}
