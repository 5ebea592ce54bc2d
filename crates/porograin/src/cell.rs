//! The periodic cell in motion: what drives it, how it carries the grains, when its lattice is chosen anew.
//!
//! With `E` the period vectors as columns and `L` the velocity gradient in the middle of a step,
//! `E(t+dt) = (1 + dt D) E(t)`, `D = L (1 - L dt/2)⁻¹` (the midpoint rule; exact for a simple shear). An image a shift `s`
//! away at `t+dt` moves at `G s`, `G = L (1 + L dt/2)⁻¹`, during that step: `G s dt` is what the shift changes by. When `L` changes, so
//! do the velocities that go with a place, by `(D - G_before)(x - x_0)`, x_0 the low corner: grains that follow the cell keep
//! following it, and `sum m (v - G (x - x_0))` stays zero if it was.

use crate::boundary::{Domain, Signal};
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::motion;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::{Cell, Period};
use rayon::prelude::*;
use serde::Deserialize;

/// Inertial number at which a held stress may deform the cell, unless its rate is given.
const INERTIAL_NUMBER: f64 = 0.01;
/// Two period vectors lean towards each other by more than this part of the shorter one: time for another choice. More
/// than one half, so that a cell sheared back and forth does not choose all the time.
const LEAN: f64 = 0.6;

/// What drives the periodic cell: each component of its velocity gradient is given, or moves until its stress is as
/// asked; what is named nowhere stays at rest.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct CellRule {
    /// Components `L_ab` = d v_a / d x_b of the velocity gradient that are given [1/s].
    pub gradient: Components,
    /// Components of the stress that are held [Pa], grains and water together, compression positive: the force along a on
    /// what lies further along b.
    pub stress: Components,
    /// Inertia of the held components [kg], by default the mass of the grains.
    pub mass: Option<f64>,
    /// No held component deforms faster than this [1/s]; by default at the inertial number 0.01.
    pub rate: Option<f64>,
}

/// Signals for the components of a tensor; the first letter is the row.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct Components {
    pub xx: Option<Signal>,
    pub xy: Option<Signal>,
    pub xz: Option<Signal>,
    pub yx: Option<Signal>,
    pub yy: Option<Signal>,
    pub yz: Option<Signal>,
    pub zx: Option<Signal>,
    pub zy: Option<Signal>,
    pub zz: Option<Signal>,
}

/// Names of the components of a tensor, row by row.
pub const COMPONENTS: [&str; 9] = ["xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"];

impl Components {
    /// The components given, with row and column.
    pub fn given(&self) -> impl Iterator<Item = (usize, usize, &Signal)> {
        let Components { xx, xy, xz, yx, yy, yz, zx, zy, zz } = self;
        let all = [xx, xy, xz, yx, yy, yz, zx, zy, zz].into_iter().enumerate();
        all.filter_map(|(k, signal)| Some((k / 3, k % 3, signal.as_ref()?)))
    }
}

impl CellRule {
    /// Whether the stress of the contacts drives the cell.
    pub fn holds_stress(&self) -> bool {
        self.stress.given().next().is_some()
    }
}

/// What a push does to the cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellMotion {
    /// Velocity gradient in the middle of the coming step [1/s]; of held components, had they no limit.
    pub rate: DMat3,
    /// What a further push on a held component [J] adds to it [1/s per J]; 0 for the others.
    pub mobility: DMat3,
    /// No held component is faster than this [1/s].
    pub limit: DMat3,
}

impl Default for CellMotion {
    fn default() -> Self {
        let limit = DMat3::from_cols(DVec3::INFINITY, DVec3::INFINITY, DVec3::INFINITY);
        CellMotion { rate: DMat3::ZERO, mobility: DMat3::ZERO, limit }
    }
}

impl CellMotion {
    /// The velocity gradient, within the limits.
    pub fn allowed(&self) -> DMat3 {
        let mut rate = self.rate;
        for column in 0..3 {
            let limit = self.limit.col(column);
            *rate.col_mut(column) = rate.col(column).clamp(-limit, limit);
        }
        rate
    }
}

/// How the cell moves in a step of length `dt` under the contacts and the water of `loads`; of the water, `felt` has what it does
/// at the beginning of the step, see [`motion::advance`].
pub fn motion(state: &State, model: &Model, loads: &Loads, felt: &Loads, dt: f64) -> CellMotion {
    let rule = &model.cell;
    let time = state.time - model.stage_start;
    let mut moved = CellMotion::default();
    for (row, column, signal) in rule.gradient.given() {
        moved.rate.col_mut(column)[row] = signal.at(time + 0.5 * dt);
    }
    let Some(virial) = loads.virial else { return moved };
    let (volume, inertia) = (state.domain.cell.volume(), inertia(state, model));
    for (row, column, signal) in rule.stress.given() {
        let (asked, found) = (signal.at(time), virial.col(column)[row] / volume);
        let before = state.domain.rate.col(column)[row];
        let push = volume * (found - asked) + loads.cell.col(column)[row];
        let known = volume * (found - asked) + felt.cell.col(column)[row];
        let sign = f64::from(before > 0.0) - f64::from(before < 0.0);
        let mobility = motion::kick(state, dt) / inertia.col(column)[row];
        moved.mobility.col_mut(column)[row] = mobility;
        moved.rate.col_mut(column)[row] = before + mobility * (push - model.damping * known.abs() * sign);
        moved.limit.col_mut(column)[row] = rule.rate.unwrap_or_else(|| {
            INERTIAL_NUMBER * motion::inertial_rate(&state.grains, asked.abs().max(found.abs()))
        });
    }
    moved
}

/// Inertia of each held component of the cell, the other ones zero [kg m²]: its kinetic energy is half of that times the
/// square of the rate.
pub fn inertia(state: &State, model: &Model) -> DMat3 {
    let mut inertia = DMat3::ZERO;
    let Some(period) = Period::of(&state.domain.cell) else { return inertia };
    for (row, column, _) in model.cell.stress.given() {
        let mass = model.cell.mass.unwrap_or_else(|| state.grains.mass.iter().sum());
        inertia.col_mut(column)[row] = mass * period.across(column) * period.across(column);
    }
    inertia
}

/// Gives the velocity gradient of the coming step to the cell, and to the grains what goes with their place;
/// returns by how much the gradient they feel has changed [1/s].
pub fn carry(domain: &mut Domain, grains: &mut Grains, rate: DMat3, dt: f64) -> DMat3 {
    let half = 0.5 * dt * rate;
    let boost = rate * (DMat3::IDENTITY - half).inverse() - domain.gradient;
    if boost != DMat3::ZERO {
        let origin = domain.cell.origin;
        for (x, v) in grains.position.iter().zip(&mut grains.velocity) {
            *v += boost * (*x - origin);
        }
    }
    domain.rate = rate;
    domain.gradient = rate * (DMat3::IDENTITY + half).inverse();
    boost
}

/// Deforms the cell by one step, after the grains have moved, and takes back what has left it.
pub fn advance(domain: &mut Domain, grains: &mut Grains, dt: f64) {
    if domain.rate != DMat3::ZERO {
        let stretch = domain.rate * (DMat3::IDENTITY - 0.5 * dt * domain.rate).inverse();
        domain.cell.edges += dt * stretch * domain.cell.edges;
        domain.strain += dt * domain.rate;
        let Domain { cell, reference, crossed, .. } = domain;
        shape(cell, |a, b, times| {
            let step = times * reference.col(a);
            *reference.col_mut(b) -= step;
            // The same displacement in the new periods: n_a e_a + n_b e_b = (n_a + times n_b) e_a + n_b (e_b - times e_a).
            for crossed in &mut *crossed {
                crossed[a] += times as i32 * crossed[b];
            }
        });
    }
    wrap(domain, grains);
}

/// Chooses shorter period vectors of the same lattice when two of them lean too much; `each` is told of every time that
/// `times` the vector a was taken off the vector b: of a, b and `times`.
pub(crate) fn shape(cell: &mut Cell, mut each: impl FnMut(usize, usize, f64)) {
    loop {
        let lean = |a: usize, b: usize| {
            let (short, long) = (cell.edges.col(a), cell.edges.col(b));
            short.dot(long) / short.length_squared()
        };
        let pairs =
            (0..9).map(|k| (k / 3, k % 3)).filter(|(a, b)| a != b && cell.periodic[*a] && cell.periodic[*b]);
        let Some((a, b)) = pairs.into_iter().find(|&(a, b)| lean(a, b).abs() > LEAN) else { return };
        let times = lean(a, b).round();
        let step = times * cell.edges.col(a);
        *cell.edges.col_mut(b) -= step;
        each(a, b, times);
    }
}

/// Takes the grains that have left the cell through a periodic side back by whole periods.
fn wrap(domain: &mut Domain, grains: &mut Grains) {
    let Some(period) = Period::of(&domain.cell) else { return };
    domain.crossed.resize(grains.len(), [0; 3]);
    let gradient = domain.gradient;
    (&mut grains.position, &mut grains.velocity, &mut domain.crossed)
        .into_par_iter()
        .with_min_len(1024)
        .for_each(|(position, velocity, crossed)| {
            let beyond = period.beyond(*position);
            if beyond != DVec3::ZERO && beyond.is_finite() {
                let shift = period.shift(beyond);
                *position -= shift;
                *velocity -= gradient * shift;
                for axis in 0..3 {
                    crossed[axis] += beyond[axis] as i32;
                }
            }
        });
}
