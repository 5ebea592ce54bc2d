//! How well a cell conducts, by its porosity and the diameter of its grains.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The choice of permeability of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub enum Permeability {
    /// Kozeny-Carman, `d² n³/(C (1 - n)²)` (Goodarzi 15), with its constant C: 150 after Ergun, 180 after Carman.
    KozenyCarman(f64),
    /// The same everywhere and always, along x, y, z [m²].
    Given([f64; 3]),
}

impl Default for Permeability {
    fn default() -> Self {
        Permeability::KozenyCarman(150.0)
    }
}

impl Permeability {
    /// Permeability along each axis [m²] of a cell of porosity `n` with grains of mean diameter `d` [m].
    pub fn of(self, n: f64, d: f64) -> DVec3 {
        match self {
            Permeability::KozenyCarman(constant) => {
                DVec3::splat(d * d * n.powi(3) / (constant * (1.0 - n).powi(2)))
            }
            Permeability::Given(along) => DVec3::from_array(along),
        }
    }
}

/// What resists the flow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Drag {
    /// Viscosity alone: Darcy's law.
    #[default]
    Darcy,
    /// Viscosity and inertia: Ergun's law (Goodarzi 9), `-grad p = w/M + 1.75 rho_f (1 - n)/(n³ d) w²`, w the superficial
    /// velocity and M the mobility.
    Ergun,
}

/// The part of the mobility `m` [m²/(Pa s)] that Ergun's quadratic term leaves under a pressure gradient of size
/// `gradient` [Pa/m]: `2/(1 + sqrt(1 + 4 E m² |grad p|))` with `E = 1.75 rho_f (1 - n)/(n³ d)`.
pub fn slowed(m: f64, n: f64, d: f64, density: f64, gradient: f64) -> f64 {
    let inertia = 1.75 * density * (1.0 - n) / (n.powi(3) * d);
    2.0 / (1.0 + (1.0 + 4.0 * inertia * m * m * gradient).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_column_of_the_paper_conducts_as_it_says() {
        // k = 1.00e-3 m/s at porosity 0.2121 (Goodarzi 15).
        let k = Permeability::default().of(0.2121, 1e-3).x * 1000.0 * 9.80665 / 1.004e-3;
        assert!((k / 1.00e-3 - 1.0).abs() < 2e-3, "{k}");
    }

    #[test]
    fn the_slowed_flow_satisfies_ergun() {
        let (n, d, density, viscosity) = (0.4_f64, 1e-3, 1000.0, 1e-3);
        let m = Permeability::default().of(n, d).x / viscosity;
        for gradient in [1.0, 1e3, 1e5] {
            let w = m * gradient * slowed(m, n, d, density, gradient);
            let ergun = 150.0 * viscosity * (1.0 - n).powi(2) / (n.powi(3) * d * d) * w
                + 1.75 * density * (1.0 - n) / (n.powi(3) * d) * w * w;
            assert!((ergun / gradient - 1.0).abs() < 1e-12, "{gradient}");
        }
    }
}
