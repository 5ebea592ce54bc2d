//! What is held at a stress or a force: what is asked of it, what it is, and how far the two are apart.

use crate::boundary::{FACE_NAMES, Solid};
use crate::cell::COMPONENTS;
use crate::measure;
use crate::model::Model;
use crate::state::State;
use crate::walls::motion;
use glam::DMat3;
use std::fmt;
use std::sync::Arc;

/// What is held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Servo {
    /// The stress on the wall at a face.
    Face(usize),
    /// The force on a wall that the case adds, by its name.
    Wall(Arc<str>),
    /// A component of the stress of the periodic cell, in the order of [`COMPONENTS`].
    Cell(usize),
    /// The mean stress of growing grains.
    Growth,
}

impl fmt::Display for Servo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Servo::Face(face) => write!(f, "the stress on the {} wall", FACE_NAMES[*face]),
            Servo::Wall(name) => write!(f, "the force on the wall `{name}`"),
            Servo::Cell(component) => write!(f, "the stress {} of the cell", COMPONENTS[*component]),
            Servo::Growth => f.write_str("the stress of the growing grains"),
        }
    }
}

/// How a servo stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Which.
    pub servo: Servo,
    /// What is asked, [Pa], of a wall that the case adds [N].
    pub asked: f64,
    /// What it is, in the same unit.
    pub found: f64,
    /// Their difference, as a part of what is asked [-]. A shear stress and a stress of zero count as a part of the mean stress of the
    /// sample where that is more: they would be off by any number otherwise.
    pub error: f64,
}

impl Held {
    /// All servos, as they stand after a step. `growth` is the stress that grains grow to [Pa], `water` the share of the water in the
    /// stress of a periodic cell times its volume ([`crate::Loads::cell`]) [J].
    pub fn all(state: &State, model: &Model, growth: Option<f64>, water: DMat3) -> Vec<Held> {
        let (t, mut all) = (state.time - model.stage_start, Vec::new());
        let mut held = |servo, found: f64, asked: f64, size: f64| {
            let error = (found - asked).abs() / size.max(asked.abs()).max(f64::MIN_POSITIVE);
            all.push(Held { servo, asked, found, error });
        };
        let contacts = || measure::contact_stress(state, model) + water * state.domain.cell.volume().recip();
        let mean = |stress: DMat3| (stress.x_axis.x + stress.y_axis.y + stress.z_axis.z).abs() / 3.0;
        let of_zero = |asked: f64| if asked == 0.0 { mean(contacts()) } else { 0.0 };
        let stresses = measure::wall_stress(&state.domain);
        for (k, face) in model.faces.iter().enumerate() {
            if let Solid::Servo { stress, .. } = &face.solid {
                let asked = stress.at(t);
                held(Servo::Face(k), stresses[k], asked, of_zero(asked));
            }
        }
        for (wall, place) in model.walls.iter().zip(&state.domain.walls) {
            if let (Some(asked), Some((_, along))) = (motion::asked(wall, t), motion::servoed(wall, state)) {
                held(Servo::Wall(wall.name.clone()), -place.force.dot(along), asked, 0.0);
            }
        }
        if let Some(asked) = growth {
            held(Servo::Growth, measure::mean_stress(state, model), asked, 0.0);
        }
        if model.cell.holds_stress() {
            let stress = contacts();
            for (row, column, signal) in model.cell.stress.given() {
                let asked = signal.at(t);
                let size = if row != column || asked == 0.0 { mean(stress) } else { 0.0 };
                held(Servo::Cell(3 * row + column), stress.col(column)[row], asked, size);
            }
        }
        all
    }

    /// The one that is furthest off.
    pub fn worst(all: Vec<Held>) -> Option<Held> {
        all.into_iter().max_by(|a, b| a.error.total_cmp(&b.error))
    }
}
