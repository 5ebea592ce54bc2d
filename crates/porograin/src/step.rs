//! The whole time step on one page.

use crate::boundary::Domain;
use crate::contact::{self, Surroundings};
use crate::fluid;
use crate::grains::Loads;
use crate::gravity;
use crate::membrane;
use crate::model::Model;
use crate::motion;
use crate::stability::{self, Limit};
use crate::state::State;
use crate::timers::Timers;
use crate::trouble::Trouble;
use crate::walls::glue;
use glam::{DMat3, DVec3};
use porograin_geometry::{Neighbours, Period};
use std::fmt;

/// Scratch of a run: dropping it between any two steps changes no bit of the result.
///
/// It follows one state through its steps. To go on with another state, or after moving grains or changing who touches whom
/// by hand, start from `Work::default()`.
#[derive(Debug, Default)]
pub struct Work {
    /// Near pairs.
    pub neighbours: Neighbours,
    /// Pairs about to touch.
    pub contacts: contact::Scratch,
    /// Loads of the last step.
    pub loads: Loads,
    /// The water's.
    pub fluid: fluid::Scratch,
    /// How far grains went in the last step.
    pub moved: motion::Moved,
    /// Wall time by phase.
    pub timers: Timers,
}

/// What a step did.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Length of the step [s].
    pub dt: f64,
    /// The stability limit, at the steps that looked at it.
    pub limit: Option<Limit>,
    /// Number of contacts at the beginning of the step.
    pub contacts: usize,
    /// What the water did.
    pub water: Option<fluid::Report>,
    /// The volumetric strain of a pore that called for a new mesh in this step.
    pub remeshed: Option<f64>,
}

/// Moves the state by one time step.
pub fn step(state: &mut State, model: &Model, work: &mut Work) -> Result<Report, StepError> {
    let Work { neighbours, contacts, loads, fluid: water, moved, timers } = work;
    timers.start();

    // Who is near whom.
    let remeshed = fluid::follow(state, model, water)?;
    timers.lap("mesh");
    let State { grains, domain, contacts: touching, .. } = state;
    let rebuilt =
        neighbours.refresh(&domain.cell, &grains.position, &grains.radius, model.contact.reach(grains));
    if rebuilt {
        roomy(domain, neighbours)?;
    }
    let surroundings = Surroundings::new(grains, domain, &model.faces, &model.walls, &model.contact);
    contact::follow(touching, &surroundings, neighbours, rebuilt, contacts);
    timers.lap("neighbours");

    // What acts on each grain. Every line only adds to `loads`.
    loads.clear(grains.len());
    loads.virial = model.cell.holds_stress().then_some(DMat3::ZERO);
    gravity::add(loads, grains, model.gravity);
    fluid::lift(loads, grains, model);
    fluid::shear(loads, grains, domain, water);
    contact::add(loads, touching, &surroundings, state.dt, contacts);
    membrane::add(loads, state, model).map_err(StepError::Membrane)?;
    fluid::pull(loads, state, model, water);
    timers.lap("contact");
    let (dt, limit) = stability::time_step(state, model);
    timers.lap("time step");
    let flow = fluid::advance(loads, state, model, dt, water)?;
    timers.lap("pressure");
    fluid::add(loads, state, water);
    timers.lap("fluid");

    // Move.
    glue::bear(loads, state, model);
    motion::advance(state, model, loads, water.felt(loads), dt, moved);
    neighbours.moved_at_most(&moved.furthest);
    let report = Report { dt, limit, contacts: state.contacts.len(), water: flow, remeshed };
    let report = if moved.inside { report } else { inside(state, report)? };
    timers.lap("motion");
    Ok(report)
}

/// Refuses a periodic cell so small that a grain could touch two images of another, or its own.
fn roomy(domain: &Domain, neighbours: &Neighbours) -> Result<(), StepError> {
    match Period::of(&domain.cell).map(|period| period.height()) {
        Some(height) if height < neighbours.room() => {
            Err(StepError::Crowded { height, room: neighbours.room() })
        }
        _ => Ok(()),
    }
}

/// Refuses a state with a grain whose centre has left the box, or is nowhere at all, naming the first.
fn inside(state: &State, report: Report) -> Result<Report, StepError> {
    let (mut lower, mut upper) = (state.domain.cell.origin, state.domain.cell.upper());
    for axis in (0..3).filter(|&axis| state.domain.cell.periodic[axis]) {
        (lower[axis], upper[axis]) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    // A comparison with NaN is false, so one test finds both.
    let sound = |x: &DVec3| lower.cmple(*x).all() && x.cmple(upper).all();
    let Some(k) = state.grains.position.iter().position(|x| !sound(x)) else { return Ok(report) };
    let (grain, time, x) = (state.grains.id[k], state.time, state.grains.position[k]);
    if !(x.is_finite() && state.domain.cell.edges.is_finite()) {
        return Err(StepError::NotFinite { grain, time });
    }
    let beyond = [lower.x - x.x, x.x - upper.x, lower.y - x.y, x.y - upper.y, lower.z - x.z, x.z - upper.z];
    let face = (0..6).max_by(|&a, &b| beyond[a].total_cmp(&beyond[b])).unwrap_or(0);
    Err(StepError::Outside { trouble: Trouble::Outside { grain, face, time }, report: Box::new(report) })
}

/// Why a step could not be done. Grains are named by their [id](crate::Grains::id).
#[derive(Clone, Debug, PartialEq)]
pub enum StepError {
    /// A grain has no position any more.
    NotFinite {
        /// The first such grain.
        grain: u32,
        /// [s]
        time: f64,
    },
    /// The centre of a grain has left the box. The step is whole, and whoever can do without that grain may go on.
    Outside {
        /// Which grain, where and when.
        trouble: Trouble,
        /// What the step did.
        report: Box<Report>,
    },
    /// The periodic cell is so small that a grain could touch two images of another, or its own.
    Crowded {
        /// Distance of its lattice planes [m].
        height: f64,
        /// What it takes [m].
        room: f64,
    },
    /// The outer grains cannot be found.
    Membrane(String),
    /// The water cannot be computed.
    Fluid(String),
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            StepError::NotFinite { grain, time } => write!(
                f,
                "the position of grain {grain} is not a number any more at t = {time:.6e} s: the time step is too long, \
                 or grains overlapped deeply at the start"
            ),
            StepError::Outside { trouble, .. } => trouble.fmt(f),
            StepError::Crowded { height, room } => write!(
                f,
                "the periodic cell is {height:.4e} m across, but a grain sees one image of each neighbour only if it is at \
                 least {room:.4e} m, twice the largest diameter and some room to move: make the cell larger or the grains \
                 smaller"
            ),
            StepError::Fluid(why) | StepError::Membrane(why) => f.write_str(why),
        }
    }
}

impl std::error::Error for StepError {}
