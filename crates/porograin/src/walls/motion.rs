//! Where walls are, and how they move.

use super::Wall;
use crate::boundary::Signal;
use crate::grains::Push;
use crate::model::Model;
use crate::motion::{inertial_rate, kick, piston_mass};
use crate::state::State;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Inertial number at which a pushed wall may deform the sample, unless its speed is given.
const INERTIAL_NUMBER: f64 = 0.01;

/// How a wall moves.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Motion {
    /// It stays where it is.
    Fixed,
    /// It moves without turning.
    Moving {
        /// Of all of it [m/s].
        velocity: [Signal; 3],
    },
    /// It turns about an axis that stays where it is.
    Rotating {
        /// On the axis [m].
        point: [f64; 3],
        /// Along it, of any length; the wall turns about it as a right-handed screw does.
        axis: [f64; 3],
        /// How fast [rad/s].
        rate: Signal,
    },
    /// A rigid body with inertia that moves along one direction.
    Servo {
        /// The direction in which it is pushed, of any length.
        along: [f64; 3],
        /// How hard.
        load: Servoed,
        /// What a stress acts on [m²]; by default the area of the wall across the direction, if it has one.
        area: Option<f64>,
        /// [kg]; by default a tenth of the mass of the grains.
        mass: Option<f64>,
        /// It never moves faster than this [m/s]; by default the speed at which a sample as large as the box deforms at
        /// the inertial number 0.01.
        speed: Option<f64>,
    },
}

/// How hard a wall is pushed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Servoed {
    /// [N]
    Force(Signal),
    /// Over the area [Pa].
    Stress(Signal),
}

/// Where a wall is now, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// How it has turned since the beginning.
    pub turn: DQuat,
    /// Where what was at the origin is now, [m].
    pub shift: DVec3,
    /// Velocity of its centre in the middle of the last step [m/s].
    pub velocity: DVec3,
    /// Its angular velocity then [rad/s].
    pub spin: DVec3,
    /// Force of the grains on it at the last step [N].
    pub force: DVec3,
    /// Their moment about its centre [N m].
    pub moment: DVec3,
}

impl Default for Place {
    /// At rest where the case puts it.
    fn default() -> Self {
        let zero = DVec3::ZERO;
        Place { turn: DQuat::IDENTITY, shift: zero, velocity: zero, spin: zero, force: zero, moment: zero }
    }
}

impl Place {
    /// Where the point of the wall that was at `x` is now [m].
    #[inline]
    pub fn forth(&self, x: DVec3) -> DVec3 {
        self.turn * x + self.shift
    }

    /// Where the point of space `x` would be if the wall were where the case puts it [m].
    #[inline]
    pub fn back(&self, x: DVec3) -> DVec3 {
        self.turn.conjugate() * (x - self.shift)
    }

    /// How far any point within `extent` of `centre` has moved since the place was `before`, at most [m].
    pub fn moved(&self, before: &Place, centre: DVec3, extent: f64) -> f64 {
        let turned = (self.turn * before.turn.conjugate()).normalize();
        // Twice the sine of half the angle times the distance: a chord.
        let chord = 2.0 * turned.xyz().length();
        let moved = self.forth(centre).distance(before.forth(centre));
        if chord == 0.0 { moved } else { moved + chord * extent }
    }
}

/// Moves all walls by one step of length `dt` [s]; `loads` are those of the grains on them.
pub fn advance(state: &mut State, model: &Model, loads: &[Push], dt: f64) {
    for (k, wall) in model.walls.iter().enumerate() {
        let load = loads.get(k).copied().unwrap_or_default();
        let centre = state.domain.walls[k].forth(wall.shape.centre());
        let (velocity, spin) = velocities(wall, state, model, k, centre, load, dt);
        let place = &mut state.domain.walls[k];
        (place.force, place.moment) = (load.force, load.moment);
        (place.velocity, place.spin) = (velocity, spin);
        if let Motion::Rotating { point, axis, rate } = &wall.motion {
            let point = DVec3::from_array(*point);
            let angle = dt * rate.at(state.time - model.stage_start + 0.5 * dt);
            let turn = DQuat::from_axis_angle(DVec3::from_array(*axis).normalize(), angle);
            place.turn = (turn * place.turn).normalize();
            place.shift = point + turn * (place.shift - point);
        } else {
            place.shift += dt * velocity;
        }
    }
}

/// Velocity of the centre and spin of a wall in the coming step.
fn velocities(
    wall: &Wall,
    state: &State,
    model: &Model,
    k: usize,
    centre: DVec3,
    load: Push,
    dt: f64,
) -> (DVec3, DVec3) {
    let time = state.time - model.stage_start;
    match &wall.motion {
        Motion::Fixed => (DVec3::ZERO, DVec3::ZERO),
        Motion::Moving { velocity } => {
            (DVec3::from_array(velocity.each_ref().map(|v| v.at(time + 0.5 * dt))), DVec3::ZERO)
        }
        Motion::Rotating { point, axis, rate } => {
            let spin = rate.at(time + 0.5 * dt) * DVec3::from_array(*axis).normalize();
            (spin.cross(centre - DVec3::from_array(*point)), spin)
        }
        Motion::Servo { along, mass, speed, .. } => {
            let along = DVec3::from_array(*along).normalize();
            let (push, known) = (asked(wall, time).unwrap_or(0.0), load.force.dot(along));
            let limit = speed.unwrap_or_else(|| default_speed(state, push.abs().max(known.abs())));
            let before = state.domain.walls[k].velocity.dot(along);
            let sign = f64::from(before > 0.0) - f64::from(before < 0.0);
            let net = push + known;
            let body = piston_mass(*mass, &state.grains) + state.domain.glue.mass(6 + k, &state.grains);
            let mobility = kick(state, dt) / body;
            let after = before + mobility * (net - model.damping * net.abs() * sign);
            (after.clamp(-limit, limit) * along, DVec3::ZERO)
        }
    }
}

/// The speed at which a sample as large as the box deforms at the inertial number 0.01 under a force [N] on its mean cross
/// section [m/s].
fn default_speed(state: &State, force: f64) -> f64 {
    let length = state.domain.cell.volume().cbrt();
    INERTIAL_NUMBER * length * inertial_rate(&state.grains, force / (length * length))
}

/// The force with which a servoed wall is pushed at a time of the stage [N].
pub fn asked(wall: &Wall, time: f64) -> Option<f64> {
    let Motion::Servo { load, .. } = &wall.motion else { return None };
    Some(match load {
        Servoed::Force(force) => force.at(time),
        Servoed::Stress(stress) => stress.at(time) * area(wall).unwrap_or(0.0),
    })
}

/// What a stress on a wall that is pushed acts on [m²], where the case or its shape says so.
pub fn area(wall: &Wall) -> Option<f64> {
    let Motion::Servo { along, area, .. } = &wall.motion else { return None };
    area.or_else(|| wall.shape.area_across(DVec3::from_array(*along)))
}

/// Mass of a wall that is pushed [kg], and the direction in which it moves.
pub fn servoed(wall: &Wall, state: &State) -> Option<(f64, DVec3)> {
    match &wall.motion {
        Motion::Servo { along, mass, .. } => {
            Some((piston_mass(*mass, &state.grains), DVec3::from_array(*along).normalize()))
        }
        _ => None,
    }
}
