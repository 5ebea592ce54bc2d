//! The longest stable time step of the solid phase, and what sets it.
//!
//! Leapfrog is stable for `dt < 2/omega_max`, `omega_max²` the largest eigenvalue of `M⁻¹ K`. `K` is a sum over contacts
//! of `k (a_i - a_j)²` terms. With `(a_i - a_j)² <= (1 + s) a_i² + (1 + 1/s) a_j²` for any `s > 0` the grains come apart:
//! `omega_max²` is at most the largest eigenvalue of one grain's own 6 x 6 stiffness with each contact counted `1 + s`
//! times. We take `s = sqrt(m_i/m_j)` (exact for twins, and 0 against a fixed wall).
//! In the variables `(u, rho theta)`, `rho² = J/m`, that stiffness is `[A C; Cᵀ B]` with
//! `A = sum k_n nn + k_t (1 - nn)`, `B = sum k_t (l/rho)² (1 - nn)` and `C = sum k_t (l/rho) [n]x`, whose norm is that of
//! the vector `sum k_t (l/rho) n`; so the bound needs two symmetric 3 x 3 eigenvalues per grain and does not depend
//! on the choice of axes.

use crate::contact::{ContactLaw, Surroundings, Touch};
use crate::grains::Grains;
use crate::model::{Model, RENEW_EVERY, TimeStep};
use crate::state::State;
use glam::DVec3;
use porograin_geometry::triangulation::wall;

/// The longest stable time step and its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// [s]
    pub seconds: f64,
    /// What vibrates fastest.
    pub cause: Cause,
}

/// What limits the time step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The contacts of the grain of this [id](Grains::id).
    Grain(u32),
    /// A grain in free flight, as stiff as it would be on contact.
    Flight(u32),
    /// The piston at this face.
    Piston(usize),
    /// The viscous damping by the water in the pores.
    Water,
    /// Nothing: there are no grains.
    Nothing,
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Cause::Grain(id) => write!(f, "the contacts of grain {id}"),
            Cause::Flight(id) => write!(f, "grain {id}, were it to meet the largest grain"),
            Cause::Piston(face) => write!(f, "the piston at the {} face", crate::boundary::FACE_NAMES[*face]),
            Cause::Water => write!(f, "the viscosity of the water in the pores"),
            Cause::Nothing => write!(f, "nothing"),
        }
    }
}

/// Whether this is a step at which the stability limit is looked at again: the first of a stage or of a new mesh of
/// the pores, and every [`RENEW_EVERY`]-th. A function of the state alone, so that a resumed run renews at the same steps.
pub fn due(state: &State, model: &Model) -> bool {
    state.step.is_multiple_of(RENEW_EVERY)
        || state.time == model.stage_start
        || state.dt == 0.0
        || state.pores().is_some_and(|water| water.made_at_step == state.step)
}

/// The length of the coming step [s], and the limit if it was renewed.
pub fn time_step(state: &State, model: &Model, scratch: &mut Vec<Held>) -> (f64, Option<Limit>) {
    match model.time_step {
        TimeStep::Fixed(dt) => (dt, None),
        TimeStep::Automatic { safety } if due(state, model) => {
            let limit = with_water(limit(state, model, scratch), state);
            (safety * limit.seconds, Some(limit))
        }
        TimeStep::Automatic { .. } => (state.dt, None),
    }
}

/// The limit of the contacts, less what the water takes of it in explicit steps.
pub fn with_water(contacts: Limit, state: &State) -> Limit {
    match state.pores() {
        Some(water) if water.implicit.is_none() => explicit(contacts, water.viscous_rate),
        _ => contacts,
    }
}

/// What water that damps the grains at the rate `lambda` [1/s] leaves to an explicit step of the limit `2/omega` of the
/// contacts: the positive root of `2 lambda dt + omega² dt² = 4` (`physics` §3b).
pub fn explicit(contacts: Limit, lambda: f64) -> Limit {
    let omega = 2.0 / contacts.seconds;
    let seconds = 4.0 / (lambda + (lambda * lambda + 4.0 * omega * omega).sqrt());
    // Of the four parts of the limit, the larger share names the cause.
    let cause = if 2.0 * lambda * seconds > 2.0 { Cause::Water } else { contacts.cause };
    Limit { seconds, cause }
}

/// How a grain is held by its contacts: the blocks `A`, `B` and the vector of `C`, each over the grain's mass.
#[derive(Clone, Copy, Debug, Default)]
pub struct Held {
    isotropic: [f64; 2],
    along: [[f64; 6]; 2],
    across: DVec3,
    contacts: u32,
}

impl Held {
    fn add(&mut self, n: DVec3, normal: f64, shear: f64, lever: f64) {
        let squares = [n.x * n.x, n.y * n.y, n.z * n.z, n.y * n.z, n.x * n.z, n.x * n.y];
        for (sum, part) in self.along.iter_mut().zip([normal - shear, -shear * lever * lever]) {
            for (s, q) in sum.iter_mut().zip(squares) {
                *s += part * q;
            }
        }
        self.isotropic[0] += shear;
        self.isotropic[1] += shear * lever * lever;
        self.across += shear * lever * n;
        self.contacts += 1;
    }

    /// Upper bound of the largest eigenvalue of `[A C; Cᵀ B]`.
    fn bound(&self) -> f64 {
        let a = self.isotropic[0] + largest_eigenvalue(self.along[0]);
        let b = self.isotropic[1] + largest_eigenvalue(self.along[1]);
        0.5 * (a + b) + (0.25 * (a - b) * (a - b) + self.across.length_squared()).sqrt()
    }
}

/// The limit for the contacts as they are. A grain is never taken to be freer than if it were held
/// from three sides by twins as stiff as its contact with the largest grain, so that grains in flight, and
/// contacts that form before the next look, are provided for.
pub fn limit(state: &State, model: &Model, held: &mut Vec<Held>) -> Limit {
    let (grains, law) = (&state.grains, model.contact.as_law());
    let surroundings = Surroundings::new(grains, &state.domain, &model.faces, law.friction());
    held.clear();
    held.resize(grains.len(), Held::default());
    let pistons = crate::motion::pistons(model, grains);
    let mut piston = [0.0; 6];
    for &pair in &state.contacts.pairs {
        let touch = surroundings.touch(pair);
        let stiffness = law.stiffness(&touch);
        let levers = touch.levers();
        let i = pair[0] as usize;
        let mut hold = |k: usize, side: usize, other: f64| {
            let share = (1.0 + (grains.mass[k] / other).sqrt()) / grains.mass[k];
            let lever = levers[side] / (0.4_f64.sqrt() * grains.radius[k]);
            let sign = if side == 0 { 1.0 } else { -1.0 };
            held[k].add(sign * touch.normal, share * stiffness.normal, share * stiffness.shear, lever);
        };
        match wall(pair[1]) {
            None => {
                hold(i, 0, grains.mass[pair[1] as usize]);
                hold(pair[1] as usize, 1, grains.mass[i]);
            }
            Some(face) => {
                hold(i, 0, pistons[face].unwrap_or(f64::INFINITY));
                if let Some(mass) = pistons[face] {
                    piston[face] += (1.0 + (mass / grains.mass[i]).sqrt()) * stiffness.normal / mass;
                }
            }
        }
    }
    let mut worst = (0.0, Cause::Nothing);
    let largest = grains.radius.iter().fold(0.0, |a: f64, &r| a.max(r));
    for (k, held) in held.iter().enumerate() {
        let flight = in_flight(law, grains, k, largest);
        let bound = if held.contacts > 0 { held.bound() } else { 0.0 };
        if bound.max(flight) > worst.0 {
            let id = grains.id[k];
            worst = (bound.max(flight), if bound >= flight { Cause::Grain(id) } else { Cause::Flight(id) });
        }
    }
    for face in 0..6 {
        if piston[face] > worst.0 {
            worst = (piston[face], Cause::Piston(face));
        }
    }
    Limit { seconds: 2.0 / worst.0.sqrt(), cause: worst.1 }
}

/// Squared frequency of a grain between three pairs of hands, each as stiff as its contact with the largest grain.
fn in_flight(law: &dyn ContactLaw, grains: &Grains, k: usize, largest: f64) -> f64 {
    let stiffness = law.stiffness(&Touch::prospective([grains.radius[k], largest], 0.0));
    let (translation, rotation) = (stiffness.normal + 2.0 * stiffness.shear, 5.0 * stiffness.shear);
    2.0 * translation.max(rotation) / grains.mass[k]
}

/// Largest eigenvalue of a symmetric 3 x 3 matrix `[xx, yy, zz, yz, xz, xy]`, by the trigonometric formula.
fn largest_eigenvalue([xx, yy, zz, yz, xz, xy]: [f64; 6]) -> f64 {
    let mean = (xx + yy + zz) / 3.0;
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    let size = ((a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0).sqrt();
    if size <= 1e-14 * mean.abs() {
        return mean;
    }
    let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    let angle = (0.5 * determinant / (size * size * size)).clamp(-1.0, 1.0).acos() / 3.0;
    mean + 2.0 * size * angle.cos()
}

#[cfg(test)]
mod tests;
