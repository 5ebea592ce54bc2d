//! What `porograin bench` measures, on a packing given by its centres and radii.

mod coarse;
mod coupled;
mod dry;
mod solvers;

pub use coarse::{CoarseBench, coarse};
pub use coupled::{BenchError, CoupledBench, coupled};
pub use dry::{DryBench, SpeedUp, dry, dry_model, flow, grown, hertz_mindlin, linear};
pub use solvers::{SizeBench, SolverBench, Thesis, growth, sizes, solvers};

use crate::fluid;
use crate::model::Model;
use crate::state::State;
use crate::step::{StepError, Work, step};
use std::time::Instant;

/// Density of the benchmarks' grains [kg/m³].
pub const DENSITY: f64 = 2600.0;

/// Steps before the clock starts, for so many timed ones.
fn warm_up(steps: usize) -> usize {
    (steps / 10).max(20)
}

/// Times `steps` steps after some to warm up: the median [s], the share of each phase, and what the water did.
fn timed(state: &mut State, model: &Model, steps: usize) -> Result<Timed, StepError> {
    let mut clock = Clock::warm(state, model, steps)?;
    clock.run(steps.max(1))?;
    Ok(clock.stop())
}

/// Times steps.
struct Clock<'a> {
    state: &'a mut State,
    model: &'a Model,
    work: Work,
    seconds: Vec<f64>,
    water: Vec<fluid::Report>,
}

impl<'a> Clock<'a> {
    /// Ready to time `steps` steps, after some to warm up.
    fn warm(state: &'a mut State, model: &'a Model, steps: usize) -> Result<Clock<'a>, StepError> {
        let mut work = Work::default();
        for _ in 0..warm_up(steps) {
            step(state, model, &mut work)?;
        }
        work.timers = Default::default();
        Ok(Clock { state, model, work, seconds: Vec::with_capacity(steps), water: Vec::new() })
    }

    /// Times so many steps more.
    fn run(&mut self, steps: usize) -> Result<(), StepError> {
        for _ in 0..steps {
            let start = Instant::now();
            self.water.extend(step(self.state, self.model, &mut self.work)?.water);
            self.seconds.push(start.elapsed().as_secs_f64());
        }
        Ok(())
    }

    fn stop(self) -> Timed {
        let Clock { work, mut seconds, water, .. } = self;
        let mean = seconds.iter().sum::<f64>() / seconds.len() as f64;
        seconds.sort_by(f64::total_cmp);
        let all: f64 = work.timers.phases().iter().map(|phase| phase.1.as_secs_f64()).sum();
        let phases =
            work.timers.phases().iter().map(|&(name, time)| (name, time.as_secs_f64() / all)).collect();
        Timed {
            seconds_per_step: seconds[seconds.len() / 2],
            mean,
            phases,
            steps: seconds.len(),
            water,
            work,
        }
    }
}

/// What [`Clock`] found.
struct Timed {
    seconds_per_step: f64,
    /// [s]
    mean: f64,
    phases: Vec<(&'static str, f64)>,
    steps: usize,
    /// What the water did in each.
    water: Vec<fluid::Report>,
    work: Work,
}
