//! The porograin command: reads arguments, calls the library, prints. No physics here.

/// A line on standard error; nobody may be listening any more, and that is no reason to stop a run.
macro_rules! say {
    ($($part:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($part)*);
    }};
}

/// The beginning of a line on standard error.
macro_rules! say_part {
    ($($part:tt)*) => {{
        use std::io::Write as _;
        let _ = write!(std::io::stderr(), $($part)*);
    }};
}

mod arguments;
mod bar;
mod bench;
mod check;
mod examples;
mod export;
mod memory;
mod permeability;
mod plot;
mod run;

use arguments::{Arguments, Command};
use clap::Parser;
use std::io::Write as _;
use std::process::ExitCode;

/// Why a command failed: one sentence for the user, and who is to blame.
pub enum Failure {
    /// The input is wrong: exit code 2.
    Input(String),
    /// The run failed: exit code 1.
    Run(String),
}

fn main() -> ExitCode {
    let Arguments { command } = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return misread(&error),
    };
    // What `bench dry` tells of memory is what the system has given out by then.
    if !matches!(&command, Command::Bench(bench) if matches!(bench.what, arguments::What::Dry)) {
        memory::keep();
    }
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
            say!("error: {sentence}");
            let first = sentence.lines().next().unwrap_or_default();
            (code, Some(serde_json::json!({ "error": first })))
        }
    };
    if json && let Some(object) = object {
        return match print(&object) {
            Ok(()) => ExitCode::from(code),
            Err(error) => {
                say!("error: cannot write to standard output: {error}");
                ExitCode::from(1)
            }
        };
    }
    ExitCode::from(code)
}

/// One JSON object on standard output.
fn print(object: &serde_json::Value) -> std::io::Result<()> {
    let mut out = std::io::stdout();
    writeln!(out, "{object:#}")?;
    out.flush()
}

/// Arguments that make no sense, or a call for help.
fn misread(error: &clap::Error) -> ExitCode {
    let code = error.exit_code();
    let _ = error.print();
    if code != 0 && std::env::args_os().any(|word| word == "--json") {
        let text = error.to_string();
        let first = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
        let _ = print(&serde_json::json!({ "error": first }));
    }
    ExitCode::from(if code == 0 { 0 } else { 2 })
}

/// A path as it can be pasted into a shell.
pub fn quoted(path: &std::path::Path) -> String {
    let shown = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "/._-+,:@%".contains(c);
    if !shown.is_empty() && shown.chars().all(plain) {
        shown
    } else {
        format!("'{}'", shown.replace('\'', r"'\''"))
    }
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
