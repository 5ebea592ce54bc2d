//! Growth of the grains, all by the same factor, to a given porosity or a given stress.
//!
//! Grown in place a sample is uniform and isotropic, since no wall moves. To reach a stress `p = sum f·l/(3V)` the radii follow it: a
//! factor `1 + e` on all radii adds `e l` to the overlap of a contact with the branch `l`, and if no grain gave way `dp/de = K` with
//! `K = sum k_n l²/(3V)`. Real grains give way, so that `K` is the stiffest answer there can be and `e = (target - p)/K`, or a part of
//! it, never goes too far (the idea of the internal compaction in the open-source code Yade, with the stiffness measured).

use crate::contact::{ContactLaw, Surroundings};
use crate::grains::Shape;
use crate::measure;
use crate::model::{Model, RENEW_EVERY};
use crate::packing;
use crate::state::State;
use porograin_geometry::triangulation::wall;
use serde::Deserialize;

/// The part of `(target - p)/K` by which the radii follow a stress each time.
const GAIN: f64 = 0.3;
/// Radii never change by more than this part of themselves at once, so that grains can give way before they are pressed hard.
const MOST: f64 = 1e-3;

/// What a stage is to grow its grains to: one of the two.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Grow {
    /// Void part of the box at which they stop [-].
    pub porosity: Option<f64>,
    /// Mean stress carried by the contacts that they keep up [Pa].
    pub stress: Option<f64>,
    /// The radii change no faster than by this part of themselves [1/s], nor by more than a thousandth at once.
    pub rate: f64,
}

impl Grow {
    /// Whether the porosity asked for is reached.
    pub fn is_dense(&self, state: &State) -> bool {
        self.porosity.is_none_or(|porosity| measure::porosity(state) <= porosity * (1.0 + 1e-9))
    }

    /// Lets all radii grow, at steps that look at the time step anew: to a porosity, the last time just so much that it is met; to a
    /// stress, or shrink, as it takes. Returns the factor, 1 where nothing grows.
    pub fn advance(&self, state: &mut State, model: &Model) -> f64 {
        if !state.step.is_multiple_of(RENEW_EVERY) || state.grains.is_empty() {
            return 1.0;
        }
        let most = (self.rate * state.dt * RENEW_EVERY as f64).min(MOST);
        let factor = match (self.porosity, self.stress) {
            (Some(porosity), _) if !self.is_dense(state) => {
                let left = (1.0 - porosity) / (1.0 - measure::porosity(state));
                let left = match state.grains.shape {
                    Shape::Sphere => left.cbrt(),
                    Shape::Disc { .. } => left.sqrt(),
                };
                left.min(1.0 + most)
            }
            (None, Some(stress)) => {
                let stiffness = stiffness(state, model);
                let missing = GAIN * (stress - measure::mean_stress(state, model)) / stiffness;
                // Without contacts there is no stiffness, and all is missing.
                1.0 + missing.clamp(-most, most)
            }
            _ => 1.0,
        };
        packing::grow(state, factor);
        factor
    }
}

/// `sum k_n l²/(3V)` over the contacts [Pa].
fn stiffness(state: &State, model: &Model) -> f64 {
    let around = Surroundings::new(&state.grains, &state.domain, &model.faces, &model.walls, &model.contact);
    let of = |pair: [u32; 2]| {
        let touch = around.touch(pair);
        let [near, far] = touch.levers();
        let length = if wall(pair[1]).is_some() { near } else { near + far };
        around.law(pair).stiffness(&touch).normal * length * length
    };
    state.contacts.pairs().map(of).fold(0.0, |sum, own| sum + own) / (3.0 * state.domain.cell.volume())
}
