//! Signs that a run has gone wrong, each noticed and told: what, where, when, and why most likely.

use crate::boundary::FACE_NAMES;
use crate::contact::Surroundings;
use crate::model::{Model, TimeStep};
use crate::servo::{Held, Servo};
use crate::stability::{self, Limit};
use crate::state::State;
use crate::walls;
use porograin_geometry::triangulation::wall;
use serde::Deserialize;
use std::fmt;
use std::sync::Arc;

/// Part by which a servo may be off at the end of a stage, as in [`Held::error`].
const SERVO_ERROR: f64 = 0.1;

/// What to do about a sign of trouble.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// Nothing.
    Ignore,
    /// Say so, once in a stage, and go on.
    Warn,
    /// Say so and stop the run.
    Stop,
}

/// What to do about each sign of trouble.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct On {
    /// The centre of a grain leaves the box.
    pub outside: Action,
    /// Two grains, or a grain and a wall, overlap by half the smaller radius.
    pub deep_overlap: Action,
    /// A fixed time step is longer than the stability limit.
    pub long_step: Action,
    /// A servo, wall or cell, is more than 10 % off its stress when its stage ends.
    pub servo: Action,
}

impl Default for On {
    fn default() -> Self {
        On { outside: Action::Stop, deep_overlap: Action::Warn, long_step: Action::Warn, servo: Action::Warn }
    }
}

/// A sign of trouble. Grains are named by their [id](crate::Grains::id), times are in s.
#[derive(Clone, Debug, PartialEq)]
pub enum Trouble {
    /// The centre of a grain is outside the box.
    Outside {
        /// The first such grain.
        grain: u32,
        /// The face it passed.
        face: usize,
        /// When.
        time: f64,
    },
    /// A contact overlaps by half the smaller radius or more.
    DeepOverlap {
        /// The first of the pair.
        grain: u32,
        /// The second, or the wall.
        other: Other,
        /// Overlap over the smaller radius [-].
        part: f64,
        /// When.
        time: f64,
    },
    /// The time step is longer than the stability limit.
    LongStep {
        /// The step.
        step: f64,
        /// What would be stable.
        limit: Limit,
        /// When.
        time: f64,
    },
    /// A servo did not reach its stress or force.
    Servo {
        /// How it stands.
        held: Held,
        /// When.
        time: f64,
    },
}

/// Number of kinds of trouble.
pub const KINDS: usize = 4;

/// What a grain overlaps with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Other {
    /// Another grain.
    Grain(u32),
    /// The wall at a face.
    Wall(usize),
    /// A wall that the case adds, by name.
    Named(Arc<str>),
}

impl Trouble {
    /// Its kind, as a number less than [`KINDS`].
    pub fn kind(&self) -> usize {
        match self {
            Trouble::Outside { .. } => 0,
            Trouble::DeepOverlap { .. } => 1,
            Trouble::LongStep { .. } => 2,
            Trouble::Servo { .. } => 3,
        }
    }

    /// What is to be done about it.
    pub fn action(&self, on: &On) -> Action {
        match self {
            Trouble::Outside { .. } => on.outside,
            Trouble::DeepOverlap { .. } => on.deep_overlap,
            Trouble::LongStep { .. } => on.long_step,
            Trouble::Servo { .. } => on.servo,
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Trouble::Outside { grain, face, time } => write!(
                f,
                "the centre of grain {grain} passed through the {} face at t = {time:.6e} s: the wall or the grain moves \
                 too fast for the contact stiffness, the time step is too long, or grains overlapped deeply at the start",
                FACE_NAMES[*face]
            ),
            Trouble::DeepOverlap { grain, other, part, time } => {
                write!(f, "grain {grain} overlaps ")?;
                match other {
                    Other::Grain(id) => write!(f, "grain {id}")?,
                    Other::Wall(face) => write!(f, "the {} wall", FACE_NAMES[*face])?,
                    Other::Named(name) => write!(f, "the wall `{name}`")?,
                }
                write!(
                    f,
                    " by {:.0} % of the smaller radius at t = {time:.6e} s: the contacts are too soft for the stress or the \
                     speed, or the grains overlapped at the start",
                    100.0 * part
                )
            }
            Trouble::LongStep { step, limit, time } => write!(
                f,
                "the time step of {step:.3e} s is longer than the stability limit of {:.3e} s at t = {time:.6e} s, set by {}: \
                 take a shorter one, or time-step = {{ automatic = {{}} }}",
                limit.seconds, limit.cause
            ),
            Trouble::Servo { held: Held { servo, asked, found, .. }, time } => {
                let (unit, drive, what) = match servo {
                    Servo::Face(_) => ("Pa", "speed of the wall", "stress"),
                    Servo::Wall(_) => ("N", "speed of the wall", "force"),
                    Servo::Cell(_) => ("Pa", "rate of the cell", "stress"),
                    Servo::Growth => ("Pa", "rate of the growth", "stress"),
                };
                // Without the sign of a zero.
                let found = found + 0.0;
                write!(f, "{servo} is {found:.3e} {unit} at t = {time:.6e} s, asked {asked:.3e} {unit}: ")?;
                if found == 0.0 {
                    f.write_str("nothing touches it, ")?;
                }
                write!(
                    f,
                    "the stage was too short or the {drive} too small, the grains cannot carry that {what}, or they flow so \
                     fast that it fluctuates"
                )
            }
        }
    }
}

/// What can be seen in passing over the contacts: deep overlaps, and a fixed time step that is too long.
pub fn look(state: &State, model: &Model, found: &mut Vec<Trouble>) {
    let (grains, time) = (&state.grains, state.time);
    let around = Surroundings::new(grains, &state.domain, &model.faces, &model.walls, &model.contact);
    let deep = state.contacts.pairs().find_map(|pair| {
        let touch = around.near(pair).touch();
        let part = touch.overlap / touch.radius[0].min(touch.radius[1]);
        (part >= 0.5).then(|| Trouble::DeepOverlap {
            grain: grains.id[pair[0] as usize],
            other: match wall(pair[1]) {
                Some(6..) => Other::Named(model.walls[walls::find(&model.walls, pair[1]).0].name.clone()),
                Some(face) => Other::Wall(face),
                None => Other::Grain(grains.id[pair[1] as usize]),
            },
            part,
            time,
        })
    });
    found.extend(deep);
    if let TimeStep::Fixed(step) = model.time_step {
        let limit = stability::with_water(stability::limit(state, model), state, model);
        if step > limit.seconds {
            found.push(Trouble::LongStep { step, limit, time });
        }
    }
}

/// The servo that is furthest off, if that is too far.
pub fn servo(held: Vec<Held>, time: f64) -> Option<Trouble> {
    let held = Held::worst(held).filter(|held| held.error > SERVO_ERROR)?;
    Some(Trouble::Servo { held, time })
}
