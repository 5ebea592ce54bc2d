//! Viscous damping of contacts, chosen by the coefficient of restitution.
//!
//! A damper `c = 2 zeta sqrt(k(d) m)` beside a spring of tangent stiffness `k(d)` makes grains bounce with a coefficient that
//! depends on `zeta` alone, whatever their mass, size and speed. Contacts do not pull, so a collision ends when the force
//! has come down to zero (Schwager & Pöschel 2007). For the linear spring that gives, with `zeta = sin(phi)`,
//! `e = exp(-(pi - 2 phi) tan(phi))`, and `e = exp(-2 psi / tanh(psi))` with `zeta = cosh(psi)` beyond critical damping. In
//! the variable `x ~ d^(5/4)` the spring of Hertz with its damper obeys the equation of the linear one with
//! `zeta sqrt(6/5)` (after Antypov & Elliott 2011).

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A coefficient of restitution, above 0 and at most 1, and the damping ratio that gives it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "f64", into = "f64")]
pub struct Restitution {
    coefficient: f64,
    ratio: f64,
}

impl From<f64> for Restitution {
    fn from(coefficient: f64) -> Self {
        // The coefficient falls as the damping grows: halve the interval that holds it.
        let (mut low, mut high) = (0.0, 1.0);
        while coefficient > 0.0 && bounce(high) > coefficient {
            high *= 2.0;
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            *(if bounce(middle) > coefficient { &mut low } else { &mut high }) = middle;
        }
        Restitution { coefficient, ratio: low }
    }
}

impl From<Restitution> for f64 {
    fn from(restitution: Restitution) -> f64 {
        restitution.coefficient
    }
}

impl Restitution {
    /// The coefficient [-].
    pub fn coefficient(self) -> f64 {
        self.coefficient
    }

    /// Damping ratio `zeta` of the linear spring [-].
    pub fn linear(self) -> f64 {
        self.ratio
    }

    /// Damping ratio `zeta` of the spring of Hertz [-].
    pub fn hertz(self) -> f64 {
        self.ratio / 1.2_f64.sqrt()
    }
}

/// Coefficient of restitution of a linear spring with the damping ratio `zeta`.
fn bounce(zeta: f64) -> f64 {
    if zeta < 1.0 {
        let phi = zeta.asin();
        (-(PI - 2.0 * phi) * phi.tan()).exp()
    } else {
        let psi = zeta.acosh();
        if psi > 0.0 { (-2.0 * psi / psi.tanh()).exp() } else { (-2.0_f64).exp() }
    }
}
