//! The linear elastic law of Cundall & Strack (Catalano 4.1-4.2).

use super::{Adhesion, Capillary, Extras, Restitution, Rolling, Spring, Stiffness, Touch};
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
    /// Viscous damping, given as the coefficient of restitution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restitution: Option<Restitution>,
    /// Bonds with a strength.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adhesion: Option<Adhesion>,
    /// Resistance to rolling and twisting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rolling: Option<Rolling>,
    /// Liquid bridges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capillary: Option<Capillary>,
}

impl Linear {
    /// Springs and friction only: modulus [Pa], `k_t / k_n`, angle [degrees].
    pub const fn new(young: f64, stiffness_ratio: f64, friction: f64) -> Self {
        Linear {
            young,
            stiffness_ratio,
            friction,
            restitution: None,
            adhesion: None,
            rolling: None,
            capillary: None,
        }
    }
}

impl Spring for Linear {
    #[inline(always)]
    fn force(&self, touch: &Touch) -> f64 {
        self.stiffness(touch).normal * touch.overlap
    }

    #[inline(always)]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        let [a, b] = touch.radius;
        let normal = 2.0 * self.young * a * b / (a + b);
        Stiffness { normal, shear: self.stiffness_ratio * normal, ..Stiffness::default() }
    }

    #[inline(always)]
    fn energy(&self, touch: &Touch) -> f64 {
        0.5 * self.force(touch) * touch.overlap
    }

    fn extras(&self) -> Extras {
        Extras {
            restitution: self.restitution.map(|r| r.linear()),
            adhesion: self.adhesion,
            rolling: self.rolling,
            capillary: self.capillary,
        }
    }
}
