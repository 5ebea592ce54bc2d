//! Resistance to rolling and twisting: springs with a cap, as friction has (Iwashita & Oda 1998; Ai et al. 2011, type C).

use super::{Stiffness, Touch};
use serde::{Deserialize, Serialize};

/// Moments of springs `k_r = a k_t r²`, `k_w = b k_t r²` with `r = 2 R_i R_j / (R_i + R_j)`, that give way at `eta F_n r`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Rolling {
    /// Greatest rolling moment over `F_n r` [-].
    pub friction: f64,
    /// Rolling stiffness over `k_t r²` [-].
    #[serde(default = "one")]
    pub stiffness: f64,
    /// Greatest twisting moment over `F_n r` [-].
    #[serde(default)]
    pub twist_friction: f64,
    /// Twisting stiffness over `k_t r²` [-].
    #[serde(default = "one")]
    pub twist_stiffness: f64,
}

fn one() -> f64 {
    1.0
}

impl Rolling {
    /// Stiffnesses against rolling and twisting [N m/rad] of a contact with this shear stiffness.
    #[inline]
    pub(super) fn stiffnesses(&self, touch: &Touch, springs: &Stiffness) -> [f64; 2] {
        let square = springs.shear * radius(touch) * radius(touch);
        // A moment that may not grow at all has no spring.
        let spring = |share: f64, cap: f64| if cap > 0.0 { share * square } else { 0.0 };
        [spring(self.stiffness, self.friction), spring(self.twist_stiffness, self.twist_friction)]
    }

    /// Greatest moments of rolling and twisting under the pressing force [N m].
    #[inline]
    pub(super) fn caps(&self, touch: &Touch, pressing: f64) -> [f64; 2] {
        let moment = pressing * radius(touch);
        [self.friction * moment, self.twist_friction * moment]
    }
}

/// `2 R_i R_j / (R_i + R_j)` [m].
#[inline]
fn radius(touch: &Touch) -> f64 {
    let [a, b] = touch.radius;
    2.0 * a * b / (a + b)
}
