//! What a step costs: the model of Catalano (5.17-5.19), refitted to this code.
//!
//! `T = T_DEM(N) + T_F(N) + T_LS(N) + (T_TRG(N) + T_G(N) + T_LTL(N)) / P_R`, with N grains and a new mesh every `P_R` steps. One thread of
//! the 2-core machine of `benches/NOTES.md`, 2026-11-26, random packings with 6 pores per grain.

use crate::contact::Laws;
use porograin_linear::Method;

/// A step with hardly any grains [s], and contacts and motion, neighbours made anew now and then, per grain (5.18) [s].
const DRY: [f64; 2] = [5.0e-5, 0.55e-7];
/// The latter under a law that has more than springs and friction, and where contacts conserve the energy [s].
const EACH: [f64; 2] = [2.0e-7, 2.5e-7];
/// Volumes carried and forces of the water, per grain (5.3, 5.15) [s].
const FORCES: f64 = 1.1e-7;
/// Triangulation, per grain (5.2) [s].
const TRIANGULATION: f64 = 2.9e-6;
/// Conductances and coefficients of the coupling, per grain (5.3) [s].
const CONDUCTANCE: f64 = 7.2e-6;
/// Factorisation [s]: this times the square of the number of grains (5.11).
const FACTOR: f64 = 4.0e-9;
/// Solution with a factor [s]: this times the power 1.8 of the number of grains (5.12).
const FACTOR_SOLVE: f64 = 2.0e-10;
/// Set-up of the multigrid and its matrix, per grain [s].
const MULTIGRID: f64 = 4.0e-6;
/// An iteration with it [s]: this times the power 1.3 of the number of grains (caches).
const MULTIGRID_ITERATION: f64 = 9.0e-9;
/// Iterations per step: with a factor, with multigrid; each so many times that in an implicit step.
const ITERATIONS: [f64; 2] = [1.0, 2.0];
const IMPLICIT: f64 = 4.0;
/// Water on a grid: the passes over the grains, per grain, and flows and solve, per cell [s].
const COARSE: [f64; 2] = [1.2e-8, 4.5e-8];

/// Seconds of a dry step of `grains` grains under these laws.
pub fn dry(grains: f64, laws: &Laws) -> f64 {
    let each = match (laws.is_plain(), laws.conserving) {
        (true, _) => DRY[1],
        (false, conserving) => EACH[usize::from(conserving)],
    };
    DRY[0] + each * grains
}

/// Seconds that the water of `grains` grains and `pores` pores adds to a step, with a new mesh every `period` steps.
pub fn pores(grains: f64, pores: f64, method: Method, implicit: bool, period: usize) -> f64 {
    let (set_up, solve, iterations) = match method.for_size(pores as usize, period) {
        Method::Cholesky => (FACTOR * grains.powi(2), FACTOR_SOLVE * grains.powf(1.8), ITERATIONS[0]),
        // Nobody simulates with Gauss-Seidel; it costs no less than this.
        _ => (MULTIGRID * grains, MULTIGRID_ITERATION * grains.powf(1.3), ITERATIONS[1]),
    };
    let times = if implicit { IMPLICIT } else { 1.0 };
    let mesh = (TRIANGULATION + CONDUCTANCE) * grains + set_up;
    times * (FORCES * grains + iterations * solve) + mesh / period as f64
}

/// Seconds that water on a grid of `cells` cells adds to a step.
pub fn coarse(grains: f64, cells: f64) -> f64 {
    COARSE[0] * grains + COARSE[1] * cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::{Law, Linear};

    /// Steps as measured on one thread (`benches/NOTES.md`): `bench dry`; `bench coupled` to 1e-3; implicit ones of example 01, small and large; a damped law and contacts that conserve the energy at the same 5000 grains; what the
    /// water adds in `bench coarse` and in example 21 on its grid.
    #[test]
    fn the_model_gives_what_was_measured() {
        let plain = Laws::from(Law::Linear(Linear::new(1e6, 0.5, 30.0)));
        let damped = Linear { restitution: Some(0.9.into()), ..Linear::new(1e6, 0.5, 30.0) };
        let conserving = Laws { conserving: true, ..plain.clone() };
        let wet = |grains, implicit| {
            dry(grains, &plain) + pores(grains, 6.0 * grains, Method::Auto, implicit, 1000)
        };
        for (model, measured) in [
            (dry(5000.0, &plain), 0.275e-3),
            (dry(20_000.0, &plain), 1.21e-3),
            (dry(5000.0, &Law::Linear(damped).into()), 1.00e-3),
            (dry(5000.0, &conserving), 1.29e-3),
            (wet(5000.0, false), 1.87e-3),
            (wet(20_000.0, false), 10.1e-3),
            (wet(1000.0, true), 1.08e-3),
            (wet(5000.0, true), 7.3e-3),
            (coarse(20_000.0, 2744.0), 0.36e-3),
            (coarse(5000.0, 729.0), 0.125e-3),
        ] {
            assert!((1.0 / 1.5..1.5).contains(&(model / measured)), "{model} for {measured}");
        }
    }

    #[test]
    fn new_meshes_cost_by_their_frequency() {
        let with = |period| pores(1e4, 6e4, Method::ConjugateGradients, false, period);
        let mesh = (TRIANGULATION + CONDUCTANCE + MULTIGRID) * 1e4;
        assert!((with(100) - with(usize::MAX) - mesh / 100.0).abs() < 1e-9 * mesh);
    }
}
