//! Liquid bridges between grains (Willett, Adams, Johnson & Seville, Langmuir 16, 2000).

use super::Touch;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A bridge forms when grains touch, pulls with `2 pi R gamma cos(theta) / (1 + 1.05 x + 2.5 x²)`, `x = D sqrt(R/V)`, at the gap
/// `D` (fully while they touch), and breaks at `D = (1 + theta/2) (V^(1/3) + V^(2/3)/(10 R))`. `R = 2 R_i R_j / (R_i + R_j)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Capillary {
    /// Volume V of a bridge [m³].
    pub volume: f64,
    /// Surface tension gamma [N/m].
    pub surface_tension: f64,
    /// Contact angle theta [degrees].
    #[serde(default)]
    pub contact_angle: f64,
}

impl Capillary {
    /// Pull of the bridge [N]; a pair that presses has no gap.
    #[inline]
    pub(super) fn pull(&self, touch: &Touch) -> f64 {
        let x = (-touch.overlap).max(0.0) * self.per_gap(touch);
        self.most(touch) / (1.0 + 1.05 * x + 2.5 * x * x)
    }

    /// The gap at which the bridge breaks [m].
    #[inline]
    pub(super) fn rupture(&self, touch: &Touch) -> f64 {
        let length = self.volume.cbrt();
        let slenderness = 1.0 + 0.1 * length / radius(touch);
        (1.0 + 0.5 * self.contact_angle.to_radians()) * length * slenderness
    }

    /// Work of the pull from here to the rupture, with a minus [J].
    pub(super) fn energy(&self, touch: &Touch) -> f64 {
        // The integral of 1/(1 + b x + a x²) is 2/q atan((2 a x + b)/q), q² = 4 a - b².
        let (a, b) = (2.5, 1.05_f64);
        let q = (4.0 * a - b * b).sqrt();
        let integral = |x: f64| 2.0 / q * ((2.0 * a * x + b) / q).atan();
        let (per_gap, gap) = (self.per_gap(touch), (-touch.overlap).max(0.0));
        let open = integral(self.rupture(touch) * per_gap) - integral(gap * per_gap);
        -self.most(touch) * (open / per_gap + touch.overlap.max(0.0))
    }

    /// `sqrt(R/V)` [1/m].
    #[inline]
    fn per_gap(&self, touch: &Touch) -> f64 {
        (radius(touch) / self.volume).sqrt()
    }

    /// Pull at contact [N].
    #[inline]
    fn most(&self, touch: &Touch) -> f64 {
        2.0 * PI * radius(touch) * self.surface_tension * self.contact_angle.to_radians().cos()
    }
}

/// Radius of equal spheres with the same gap profile [m].
#[inline]
fn radius(touch: &Touch) -> f64 {
    let [a, b] = touch.radius;
    2.0 * a * b / (a + b)
}
