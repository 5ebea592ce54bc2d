//! CGAL on the same points in the same run: `regular.cpp`, compiled here. A yardstick for development, never a dependency.

use crate::samples::{self, Sample};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// The compiled program and where samples are left for it.
pub struct Cgal {
    folder: PathBuf,
    program: PathBuf,
}

impl Cgal {
    /// Compiles the program (Debian: g++ and libcgal-dev).
    pub fn new() -> Self {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
        let program = folder.join("regular");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/cgal/regular.cpp");
        let mut compiler = Command::new("g++");
        compiler.args(["-O3", "-DNDEBUG", "-frounding-math", source, "-o"]).arg(&program);
        let done = compiler.args(["-lgmp", "-lmpfr"]).status();
        let done = done.is_ok_and(|status| status.success());
        assert!(done, "--cgal needs g++ and CGAL's headers (Debian: g++ libcgal-dev)");
        Cgal { folder, program }
    }

    /// Shortest and median processor time of the triangulation, microseconds per grain.
    pub fn time(&self, name: &str, sample: &Sample) -> [f64; 2] {
        let folder = self.folder.to_str().expect("a folder with a plain name");
        samples::write(folder, name, sample.position.len(), sample);
        let file = samples::file(folder, name, sample.position.len());
        let output =
            Command::new(&self.program).arg(&file).stderr(Stdio::inherit()).output().expect("CGAL runs");
        let text = String::from_utf8_lossy(&output.stdout);
        let line = text.lines().last().unwrap_or_default();
        let column = |k: usize| line.split('|').nth(k).and_then(|c| c.trim().parse().ok());
        std::fs::remove_file(&file).expect("the sample was just written");
        [4, 5].map(|k| column(k).expect("a row of CGAL's table"))
    }
}
