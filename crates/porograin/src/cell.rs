//! The periodic cell in motion: what drives it, how it carries the grains, when its lattice is chosen anew.
//!
//! With `E` the period vectors as columns and `L` the velocity gradient in the middle of a step,
//! `E(t+dt) = (1 + dt D) E(t)`, `D = L (1 - L dt/2)⁻¹` (the midpoint rule; exact for a simple shear). An image a shift `s`
//! away at `t+dt` moves at `G s`, `G = L (1 + L dt/2)⁻¹`, during that step: `G s dt` is what the shift changes by. When `L` changes, so
//! do the velocities that go with a place, by `(D - G_before)(x - x_0)`, x_0 the low corner: grains that follow the cell keep
//! following it, and `sum m (v - G (x - x_0))` stays zero if it was.

use crate::boundary::{Domain, Signal};
use crate::grains::Grains;
use crate::measure;
use crate::model::Model;
use crate::motion;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::Period;
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
    /// Components of the stress that are held [Pa], compression positive: the force along a on what lies further along b.
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

/// The velocity gradient of the cell in the middle of the coming step.
pub fn rate(state: &State, model: &Model, dt: f64) -> DMat3 {
    let rule = &model.cell;
    let time = state.time - model.stage_start;
    let mut rate = DMat3::ZERO;
    for (row, column, signal) in rule.gradient.given() {
        rate.col_mut(column)[row] = signal.at(time + 0.5 * dt);
    }
    let mut held = rule.stress.given().peekable();
    let Some(period) = held.peek().and_then(|_| Period::of(&state.domain.cell)) else { return rate };
    let stress = measure::contact_stress(state, model);
    let volume = state.domain.cell.volume();
    let mass = rule.mass.unwrap_or_else(|| state.grains.mass.iter().sum());
    for (row, column, signal) in held {
        let (asked, found) = (signal.at(time), stress.col(column)[row]);
        let before = state.domain.rate.col(column)[row];
        let push = volume * (found - asked);
        let sign = f64::from(before > 0.0) - f64::from(before < 0.0);
        let across = period.across(column);
        let change =
            motion::kick(state, dt) / (mass * across * across) * (push - model.damping * push.abs() * sign);
        let limit = rule.rate.unwrap_or_else(|| {
            INERTIAL_NUMBER * motion::inertial_rate(&state.grains, asked.abs().max(found.abs()))
        });
        rate.col_mut(column)[row] = (before + change).clamp(-limit, limit);
    }
    rate
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
        shape(domain);
    }
    wrap(domain, grains);
}

/// Chooses shorter period vectors of the same lattice when two of them lean too much.
fn shape(domain: &mut Domain) {
    let cell = &mut domain.cell;
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
        // The same displacement in the new periods: n_a e_a + n_b e_b = (n_a + times n_b) e_a + n_b (e_b - times e_a).
        for crossed in &mut domain.crossed {
            crossed[a] += times as i32 * crossed[b];
        }
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
