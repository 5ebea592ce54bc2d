//! Contacts: who touches whom, the memory of each contact, and the laws.

mod linear;
pub use linear::Linear;

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

/// The choice of contact law; matched once per step, not per pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Linear springs with Coulomb friction.
    Linear(Linear),
}
