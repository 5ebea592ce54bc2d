//! The linear elastic-frictional law of Cundall & Strack (Catalano 4.1-4.2).

use super::{ContactLaw, Stiffness, Touch};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// `k_n = 2 E R_i R_j/(R_i + R_j)`, `k_t = a k_n`, Coulomb friction; a wall takes the radius of the grain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Linear {
    /// Contact modulus E [Pa].
    pub young: f64,
    /// `a = k_t / k_n` [-].
    pub stiffness_ratio: f64,
    /// Friction angle between grains [degrees].
    pub friction: f64,
}

impl ContactLaw for Linear {
    /// `F = F_s - k_n d n`; the shear force grows by `k_t v_t dt` and is cut at `k_n d tan(phi)`. No tension.
    #[inline(always)]
    fn load(&self, touch: &Touch, shear: &mut DVec3, dt: f64) -> DVec3 {
        let stiffness = self.stiffness(touch);
        let pressing = stiffness.normal * touch.overlap;
        let sliding = touch.velocity - touch.velocity.dot(touch.normal) * touch.normal;
        let trial = *shear + stiffness.shear * dt * sliding;
        let (cap, size) = (touch.friction * pressing, trial.length_squared());
        *shear = trial * if size > cap * cap { cap / size.sqrt() } else { 1.0 };
        *shear - pressing * touch.normal
    }

    #[inline(always)]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        let [a, b] = touch.radius;
        let normal = 2.0 * self.young * a * b / (a + b);
        Stiffness { normal, shear: self.stiffness_ratio * normal }
    }

    fn energy(&self, touch: &Touch, shear: DVec3) -> f64 {
        let stiffness = self.stiffness(touch);
        let pressing = 0.5 * stiffness.normal * touch.overlap * touch.overlap;
        // Without a tangential spring there is no shear force.
        if stiffness.shear > 0.0 {
            pressing + 0.5 * shear.length_squared() / stiffness.shear
        } else {
            pressing
        }
    }

    fn friction(&self) -> f64 {
        self.friction
    }
}
