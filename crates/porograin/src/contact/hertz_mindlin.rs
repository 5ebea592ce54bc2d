//! Elastic spheres: Hertz along the normal, Mindlin across it (Catalano 2.10-2.11).

use super::{Capillary, Extras, Restitution, Rolling, Spring, Stiffness, Touch};
use serde::{Deserialize, Serialize};

/// `F_n = 4/3 E* sqrt(R*) d^(3/2)`, `k_n = 2 E* sqrt(R* d)`, `k_t = 8 G* sqrt(R* d)`, Coulomb friction.
///
/// `R* = R_i R_j / (R_i + R_j)`, `E* = E / (2 (1 - nu²))`, `G* = G / (2 (2 - nu))`, `G = E / (2 (1 + nu))`: both grains of
/// the same stuff. A wall takes the radius of the grain. While a contact unloads its shear force falls with `k_t`,
/// so that no closed path gives energy (Thornton, Cummins & Cleary 2013).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct HertzMindlin {
    /// Young's modulus of the grains [Pa].
    pub young: f64,
    /// Their Poisson's ratio [-].
    pub poisson: f64,
    /// Friction angle between grains [degrees].
    pub friction: f64,
    /// Viscous damping, given as the coefficient of restitution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restitution: Option<Restitution>,
    /// Resistance to rolling and twisting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rolling: Option<Rolling>,
    /// Liquid bridges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capillary: Option<Capillary>,
}

impl HertzMindlin {
    /// Springs and friction only: modulus [Pa], Poisson's ratio, angle [degrees].
    pub const fn new(young: f64, poisson: f64, friction: f64) -> Self {
        HertzMindlin { young, poisson, friction, restitution: None, rolling: None, capillary: None }
    }

    /// `2 E*` and `8 G*` [Pa].
    #[inline(always)]
    fn moduli(&self) -> [f64; 2] {
        let nu = self.poisson;
        [self.young / (1.0 - nu * nu), 2.0 * self.young / ((1.0 + nu) * (2.0 - nu))]
    }

    /// Radius of the circle of contact, `sqrt(R* d)` [m].
    #[inline(always)]
    fn circle(touch: &Touch) -> f64 {
        let [a, b] = touch.radius;
        (a * b / (a + b) * touch.overlap.max(0.0)).sqrt()
    }
}

impl Spring for HertzMindlin {
    #[inline(always)]
    fn force(&self, touch: &Touch) -> f64 {
        2.0 / 3.0 * self.moduli()[0] * Self::circle(touch) * touch.overlap
    }

    #[inline(always)]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        let ([normal, shear], circle) = (self.moduli(), Self::circle(touch));
        Stiffness { normal: normal * circle, shear: shear * circle, ..Stiffness::default() }
    }

    /// `k_t` goes with the root of the overlap; the overlap of a step ago is `d + v_n dt`.
    #[inline(always)]
    fn unloaded(&self, touch: &Touch, dt: f64) -> f64 {
        let before = touch.overlap + touch.velocity.dot(touch.normal) * dt;
        if before > touch.overlap { (touch.overlap.max(0.0) / before).sqrt() } else { 1.0 }
    }

    #[inline(always)]
    fn energy(&self, touch: &Touch) -> f64 {
        0.4 * self.force(touch) * touch.overlap
    }

    fn extras(&self) -> Extras {
        Extras {
            restitution: self.restitution.map(|r| r.hertz()),
            adhesion: None,
            rolling: self.rolling,
            capillary: self.capillary,
        }
    }
}
