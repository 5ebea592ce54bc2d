//! The porograin command: reads arguments, calls the library, prints. No physics here.

mod arguments;
mod bar;
mod bench;
mod check;
mod examples;
mod export;
mod permeability;
mod plot;
mod run;

use arguments::{Arguments, Command};
use clap::Parser;
use std::process::ExitCode;

/// Why a command failed: one sentence for the user, and who is to blame.
pub enum Failure {
    /// The input is wrong: exit code 2.
    Input(String),
    /// The run failed: exit code 1.
    Run(String),
}

fn main() -> ExitCode {
    let Arguments { command } = Arguments::parse();
    let json = command.json();
    let outcome = match command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Resume(arguments) => run::resume(&arguments),
        Command::Check(arguments) => check::check(&arguments),
        Command::Plot(arguments) => plot::plot(&arguments),
        Command::Export(arguments) => export::export(&arguments),
        Command::List => examples::list(),
        Command::New { example, folder } => examples::new(&example, folder),
        Command::Permeability(arguments) => permeability::permeability(&arguments),
        Command::Bench(arguments) => bench::bench(&arguments),
    };
    let (code, object) = match outcome {
        Ok(object) => (0, object),
        Err(failure) => {
            let (code, sentence) = match failure {
                Failure::Input(sentence) => (2, sentence),
                Failure::Run(sentence) => (1, sentence),
            };
            eprintln!("error: {sentence}");
            let first = sentence.lines().next().unwrap_or_default();
            (code, Some(serde_json::json!({ "error": first })))
        }
    };
    if json && let Some(object) = object {
        println!("{object:#}");
    }
    ExitCode::from(code)
}

/// What a command gives back: the object for `--json`, if it has one.
pub type Outcome = Result<Option<serde_json::Value>, Failure>;

/// Makes the thread pool; by default one thread per core.
pub fn threads(count: Option<usize>) -> Result<(), Failure> {
    let Some(count) = count else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| Failure::Run(format!("cannot start {count} threads: {e}")))
}
