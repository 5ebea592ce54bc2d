//! Wall time by phase of the step.

use std::time::{Duration, Instant};

/// Where the time of the steps went, under the names that [`step`](crate::step::step) gives its phases.
#[derive(Clone, Debug, Default)]
pub struct Timers {
    phases: Vec<(&'static str, Duration)>,
    since: Option<Instant>,
}

impl Timers {
    /// Starts the clock.
    pub fn start(&mut self) {
        self.since = Some(Instant::now());
    }

    /// Books the time since the last call to `phase`.
    pub fn lap(&mut self, phase: &'static str) {
        let now = Instant::now();
        let spent = self.since.map_or(Duration::ZERO, |since| now - since);
        self.since = Some(now);
        match self.phases.iter_mut().find(|entry| entry.0 == phase) {
            Some(entry) => entry.1 += spent,
            None => self.phases.push((phase, spent)),
        }
    }

    /// Phases in order of their first appearance, with the time spent in each.
    pub fn phases(&self) -> &[(&'static str, Duration)] {
        &self.phases
    }
}
