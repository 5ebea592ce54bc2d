//! Progress on standard error: a bar on a terminal, a line now and then elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use porograin::run::View;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Between two lines when standard error is not a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);
/// Between two drawings of the bar.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Shows how far a run has come.
pub struct Bar {
    bar: Option<ProgressBar>,
    quiet: bool,
    stage: Option<usize>,
    shown: Instant,
}

impl Bar {
    /// A bar that shows nothing when `quiet`.
    pub fn new(quiet: bool) -> Self {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let style = ProgressStyle::with_template("{prefix:>24} [{bar:30}] {msg}");
            let bar = ProgressBar::new(1000);
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar
        });
        Bar { bar, quiet, stage: None, shown: Instant::now() }
    }

    /// Shows `view`, if it is time to.
    pub fn show(&mut self, view: &View) {
        if self.quiet {
            return;
        }
        for trouble in view.news {
            self.say(&format!("warning: in the stage `{}`, {trouble}", view.name));
        }
        let new = self.stage != Some(view.stage);
        let every = if self.bar.is_some() { DRAW_EVERY } else { LINE_EVERY };
        if !new && self.shown.elapsed() < every {
            return;
        }
        self.shown = Instant::now();
        self.stage = Some(view.stage);
        let left = match view.left {
            Some(left) => format!(", {} left", span(left)),
            None => view.standing().map_or(String::new(), |standing| format!(", {standing}")),
        };
        let water = if view.report.water.is_some_and(|water| water.implicit) { ", implicit" } else { "" };
        let View { step, time, report, .. } = view;
        let message = format!("step {step}, t = {time:.4e} s, {} contacts{water}{left}", report.contacts);
        let place = format!("{} ({}/{})", view.name, view.stage + 1, view.stages);
        match &self.bar {
            Some(bar) => {
                bar.set_prefix(place);
                bar.set_position((1000.0 * view.part.unwrap_or(0.0)) as u64);
                bar.set_message(message);
            }
            None => say!("{place}: {message}"),
        }
    }

    /// Says a line without spoiling the bar.
    fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| say!("{line}")),
            None => say!("{line}"),
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// A length of time as a person would say it.
pub fn span(duration: Duration) -> String {
    let seconds = duration.as_secs();
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        _ => format!("{} h {:02} min", seconds / 3600, seconds / 60 % 60),
    }
}
