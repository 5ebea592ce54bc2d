//! The linear elastic-frictional law of Cundall & Strack (Catalano 4.1-4.2).

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
