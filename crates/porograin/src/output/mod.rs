//! What a run leaves behind: tables, pictures, ParaView files, checkpoints.

pub mod chart;
pub mod curve;
pub mod folder;
pub mod frame;
pub mod plot;
pub mod report;
pub mod restart;
pub mod summary;
pub mod table;
pub mod vtk;

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Writes `bytes` to `path` at once: a reader, or a run killed in the middle, sees the old file or the new one.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".tmp");
    let mut file = File::create(&temporary)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&temporary, path)
}
