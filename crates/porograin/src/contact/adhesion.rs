//! Bonds that resist tension and shear until they break (Catalano §2.1.2).

use super::Touch;
use serde::{Deserialize, Serialize};

/// A bond over the section `pi R²` of the smaller grain. It breaks for good when the tension exceeds `tension pi R²` or
/// the shear force `F_n tan(phi) + cohesion pi R²`; until then the springs pull too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Adhesion {
    /// Tensile strength [Pa].
    pub tension: f64,
    /// Cohesive shear strength [Pa].
    pub cohesion: f64,
    /// Whether grains that meet later are bonded too, or only those that touch when the adhesion begins.
    #[serde(default)]
    pub renew: bool,
}

/// What became of the bond of a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Bond {
    /// The contact is younger than the adhesion.
    #[default]
    None,
    /// It holds.
    Whole,
    /// It held once.
    Broken,
}

impl Adhesion {
    /// Greatest tension and cohesive shear force [N].
    #[inline]
    pub(super) fn strength(&self, touch: &Touch) -> [f64; 2] {
        let radius = touch.radius[0].min(touch.radius[1]);
        let section = std::f64::consts::PI * radius * radius;
        [self.tension * section, self.cohesion * section]
    }
}
