//! The cost of the step without water.

use super::{BenchError, DENSITY, timed};
use crate::awake::awake;
use crate::boundary::{Domain, Face, Signal, Solid};
use crate::contact::{Contacts, HertzMindlin, Law, Linear};
use crate::grains::Grains;
use crate::import::Spheres;
use crate::measure;
use crate::model::{Model, TimeStep};
use crate::packing;
use crate::state::State;
use crate::step::{StepError, Work, step};
use glam::DVec3;
use porograin_geometry::{Cell, Neighbours};
use rayon::prelude::*;
use serde::Serialize;
use std::time::Instant;

/// The cost of the dry step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DryBench {
    /// Number of grains.
    pub grains: usize,
    /// Number of contacts, those with walls included, at the end.
    pub contacts: usize,
    /// Steps timed.
    pub steps: usize,
    /// Median time of a step over the number of contacts [ns].
    pub ns_per_contact_step: f64,
    /// Number of grains over the median time of a step [1/s].
    pub grain_steps_per_second: f64,
    /// Median time of a step [s].
    pub seconds_per_step: f64,
    /// Mean time of a step, new lists of neighbours included, over the number of contacts [ns].
    pub mean_ns_per_contact_step: f64,
    /// Shortest time of a new list of neighbours, per grain [ns].
    pub rebuild_ns_per_grain: f64,
    /// Memory of the process at rest in the steps, less what it had before the grains, per grain; where the system tells.
    pub bytes_per_grain: Option<f64>,
    /// With several threads: how many times faster than on one.
    pub speed_up: Option<SpeedUp>,
    /// Share of each phase, by the names of the step's page.
    pub phases: Vec<(&'static str, f64)>,
}

/// What several threads gain, measured in turns with one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SpeedUp {
    /// Number of threads.
    pub threads: usize,
    /// Of the step.
    pub step: f64,
    /// Of a loop that shares nothing: what the machine gives.
    pub ideal: f64,
}

/// The linear law of the benchmarks.
pub fn linear() -> Law {
    Law::Linear(Linear::new(15e6, 0.5, 30.0))
}

/// Elastic spheres that are about as stiff as those of [`linear`] in the packings of the benchmark.
pub fn hertz_mindlin() -> Law {
    Law::HertzMindlin(HertzMindlin::new(1e9, 0.2, 30.0))
}

/// The model of the dry benchmark: walls fixed and frictionless, E = 15 MPa, k_t/k_n = 0.5, 30° between grains,
/// damping 0.2.
pub fn dry_model() -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: linear().into(),
        damping: 0.2,
        faces: std::array::from_fn(|_| Face::default()),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

/// Plane strain at constant volume: the walls left and right approach each other at this rate [1/s], bottom and top withdraw.
pub fn flow(model: &mut Model, cell: &Cell, rate: f64) {
    let speed = 0.5 * rate * (cell.upper() - cell.origin);
    for (face, velocity) in
        [(0, speed.x * DVec3::X), (1, -speed.x * DVec3::X), (4, -speed.z * DVec3::Z), (5, speed.z * DVec3::Z)]
    {
        model.faces[face].solid = Solid::Moving { velocity: velocity.to_array().map(Signal::Constant) };
    }
}

/// The grains at rest in their box.
pub(super) fn at_rest(position: Vec<DVec3>, radius: Vec<f64>, domain: Domain) -> State {
    let grains = crate::packing::ordered(&domain.cell, Grains::at_rest(position, radius, DENSITY));
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
}

/// Runs a packing (centres and radii [m], in any order) in its box for `steps` timed steps, once it is at rest between fixed walls and
/// after a tenth as many steps to warm up.
///
/// # Errors
/// Whatever stops a step; deeply overlapping grains, most likely.
pub fn dry(
    position: Vec<DVec3>,
    radius: Vec<f64>,
    domain: Domain,
    model: &Model,
    steps: usize,
) -> Result<DryBench, StepError> {
    // Code and stacks come into memory with the first steps, whatever the number of grains.
    let few = (position.iter().copied().take(2).collect(), radius.iter().copied().take(2).collect());
    rayon::scope(|_| hold(&mut at_rest(few.0, few.1, domain.clone()), model, 2))?;
    let before = resident();
    // Once inside the pool: entering it anew for every loop of every step would cost more than the loops.
    let mut state = at_rest(position, radius, domain);
    let mut bench = awake(|| {
        settle(&mut state)?;
        hold(&mut state, model, steps)
    })?;
    bench.speed_up = speed_up(&mut state, model, steps)?;
    // The grains given, 32 bytes each, are gone by the time the steps are done.
    let grains = bench.grains as f64;
    bench.bytes_per_grain =
        bench.bytes_per_grain.zip(before).map(|(now, before)| (now - before) / grains + 32.0);
    Ok(bench)
}

/// Lets a packing come to rest: places alone do not tell of the friction that held its grains where they are.
fn settle(state: &mut State) -> Result<(), StepError> {
    let (model, mut work) = (Model { damping: 0.7, ..dry_model() }, Work::default());
    for k in 1..=SETTLING {
        step(state, &model, &mut work)?;
        if k % 20 == 0 && measure::unbalanced(state, &model, &work.loads) < AT_REST {
            break;
        }
    }
    Ok(())
}

/// Steps to come to rest in, at most.
const SETTLING: usize = 300;
/// Unbalanced force of a packing at rest.
const AT_REST: f64 = 1e-3;

/// Times the dry step of a state.
pub(super) fn hold(state: &mut State, model: &Model, steps: usize) -> Result<DryBench, StepError> {
    let timed = timed(state, model, steps)?;
    let grains = &state.grains;
    let bytes_per_grain = resident();
    // A list is made anew as soon as the number of grains has changed.
    let (cell, mut near, mut rebuild) = (&state.domain.cell, Neighbours::default(), f64::INFINITY);
    for _ in 0..REBUILDS {
        near.refresh(cell, &grains.position[1..], &grains.radius[1..], 0.0);
        let start = Instant::now();
        near.refresh(cell, &grains.position, &grains.radius, 0.0);
        rebuild = rebuild.min(start.elapsed().as_secs_f64());
    }
    Ok(DryBench {
        grains: grains.len(),
        contacts: state.contacts.len(),
        steps: timed.steps,
        ns_per_contact_step: 1e9 * timed.seconds_per_step / state.contacts.len().max(1) as f64,
        grain_steps_per_second: grains.len() as f64 / timed.seconds_per_step,
        seconds_per_step: timed.seconds_per_step,
        mean_ns_per_contact_step: 1e9 * timed.mean / state.contacts.len().max(1) as f64,
        rebuild_ns_per_grain: 1e9 * rebuild / grains.len() as f64,
        bytes_per_grain,
        speed_up: None,
        phases: timed.phases,
    })
}

/// Turns of one thread and of all.
const TURNS: usize = 7;

/// Times a few steps, and a loop that shares nothing, in turns on one thread and on all of this pool; the medians compared.
pub(super) fn speed_up(state: &mut State, model: &Model, steps: usize) -> Result<Option<SpeedUp>, StepError> {
    let threads = rayon::current_num_threads();
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let (true, Ok(one), Ok(all)) = (threads > 1, pool(1), pool(threads)) else { return Ok(None) };
    let mut work = Work::default();
    let steps = (steps / (4 * TURNS)).max(2);
    let loops = 2000 * state.grains.len().min(10_000);
    let mut times = [const { [const { Vec::new() }; 2] }; 2];
    for _ in 0..TURNS {
        for (k, pool) in [&one, &all].into_iter().enumerate() {
            let spent = pool.install(|| {
                awake(|| {
                    // Once more than counted: the caches of the other thread are cold.
                    step(state, model, &mut work)?;
                    let start = Instant::now();
                    for _ in 0..steps {
                        step(state, model, &mut work)?;
                    }
                    Ok(start.elapsed().as_secs_f64())
                })
            });
            times[k][0].push(spent?);
            let start = Instant::now();
            pool.install(|| {
                let turn = |k: usize| (0..64).fold(k as f64, |x, _| x * 0.5 + 1.0);
                std::hint::black_box(
                    (0..loops / 64).into_par_iter().with_min_len(1024).map(turn).sum::<f64>(),
                );
            });
            times[k][1].push(start.elapsed().as_secs_f64());
        }
    }
    let median = |times: &mut Vec<f64>| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    let [mut single, mut several] = times;
    let mut gain = |k: usize| median(&mut single[k]) / median(&mut several[k]);
    Ok(Some(SpeedUp { threads, step: gain(0), ideal: gain(1) }))
}

/// New lists of neighbours timed.
const REBUILDS: usize = 5;

/// Memory of this process [bytes], where the system tells.
fn resident() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix(" kB")?.parse().ok().map(|kilobytes: f64| 1024.0 * kilobytes)
}

/// Steps over which a cloud grows, and over which it then comes to rest.
const GROWTH: [usize; 2] = [500, 300];
/// Solid part of the box a cloud grows to: a little less than grains of one size fill at random.
const SOLID: f64 = 0.63;

/// A dense packing of `count` grains of 1 mm mean radius or so: a cloud whose grains grow, strongly damped and without friction.
///
/// # Errors
/// When there is no room for the cloud, or a step fails.
pub fn grown(count: usize) -> Result<(Cell, Spheres), BenchError> {
    rayon::scope(|_| {
        let size = 1e-3 * (4.0 / 3.0 * std::f64::consts::PI * count as f64 / SOLID).cbrt();
        let domain = Domain::walled(DVec3::ZERO, DVec3::splat(size));
        let grains = packing::cloud(&domain.cell, count, 0.2, 7, 0.75, DENSITY)?;
        let mut state =
            State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None };
        let mut model = Model { damping: 0.7, ..dry_model() };
        model.contact.set_friction(0.0);
        let factor = (SOLID / 0.25).powf(1.0 / (3.0 * GROWTH[0] as f64));
        let mut work = Work::default();
        for k in 0..GROWTH[0] + GROWTH[1] {
            if k < GROWTH[0] {
                packing::grow(&mut state, factor);
            }
            step(&mut state, &model, &mut work)?;
        }
        let State { grains, domain, .. } = state;
        let line = (1..=count).collect();
        Ok((
            domain.cell,
            Spheres { position: grains.position, radius: grains.radius, velocity: grains.velocity, line },
        ))
    })
}
