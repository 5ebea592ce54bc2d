//! Checkpoints: everything a run needs to go on as if it had never stopped.
//!
//! A file is `magic, version, checksum of the rest, hash of the case, compressed bytes`; all numbers little-endian.

use crate::output::folder::Written;
use crate::progress::Progress;
use crate::state::State;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;

const MAGIC: [u8; 8] = *b"porogran";
/// Grows whenever [`Checkpoint`] or anything inside it changes.
pub const VERSION: u32 = 15;
/// Fast, and already half the size: most of the bytes are digits of coordinates, which no level compresses.
const COMPRESSION: i32 = 1;
const HEADER: usize = 8 + 4 + 4 + 4;

/// The content of a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The simulation.
    pub state: State,
    /// Where in the case the run stands.
    pub progress: Progress,
    /// How much of the files beside it belongs to the run up to here.
    pub written: Written,
}

/// A checkpoint that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RestartError {
    /// It cannot be read or written.
    File(String),
    /// It is no checkpoint of this program.
    NotACheckpoint,
    /// It was written by another version of the program.
    Version(u32),
    /// Its bytes are not those that were written.
    Corrupted,
    /// It belongs to another case.
    OtherCase,
}

impl fmt::Display for RestartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RestartError::File(reason) => write!(f, "{reason}"),
            RestartError::NotACheckpoint => write!(f, "it is not a porograin checkpoint"),
            RestartError::Version(version) => {
                write!(f, "it has version {version} of the format, this program reads version {VERSION}")
            }
            RestartError::Corrupted => write!(f, "it is damaged: its checksum does not match"),
            RestartError::OtherCase => write!(f, "case.toml beside it was changed after it was written"),
        }
    }
}

impl std::error::Error for RestartError {}

/// Checksum of the text of a case.
pub fn case_hash(text: &str) -> u32 {
    crc32fast::hash(text.as_bytes())
}

impl Checkpoint {
    /// The bytes of the file.
    ///
    /// # Errors
    /// None in practice: only what the compressor may report.
    pub fn to_bytes(&self, case_text: &str) -> Result<Vec<u8>, RestartError> {
        let failed = |e: &dyn fmt::Display| RestartError::File(format!("it cannot be packed: {e}"));
        let plain = postcard::to_stdvec(self).map_err(|e| failed(&e))?;
        let packed = zstd::bulk::compress(&plain, COMPRESSION).map_err(|e| failed(&e))?;
        let mut rest = case_hash(case_text).to_le_bytes().to_vec();
        rest.extend((plain.len() as u64).to_le_bytes());
        rest.extend(packed);
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(crc32fast::hash(&rest).to_le_bytes());
        bytes.extend(rest);
        Ok(bytes)
    }

    /// Reads the bytes of a file that belongs to the case `case_text`.
    ///
    /// # Errors
    /// Everything but exactly what [`to_bytes`](Self::to_bytes) wrote for the same case.
    pub fn from_bytes(bytes: &[u8], case_text: &str) -> Result<Self, RestartError> {
        let number = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        if bytes.get(..8) != Some(&MAGIC) {
            return Err(RestartError::NotACheckpoint);
        }
        match number(8) {
            Some(VERSION) => {}
            Some(other) => return Err(RestartError::Version(other)),
            None => return Err(RestartError::Corrupted),
        }
        let rest = bytes.get(16..).ok_or(RestartError::Corrupted)?;
        if number(12) != Some(crc32fast::hash(rest)) || rest.len() < HEADER - 16 + 8 {
            return Err(RestartError::Corrupted);
        }
        if number(16) != Some(case_hash(case_text)) {
            return Err(RestartError::OtherCase);
        }
        let length = rest[4..12].iter().rev().fold(0, |n, &b| n << 8 | usize::from(b));
        let plain = zstd::bulk::decompress(&rest[12..], length).map_err(|_| RestartError::Corrupted)?;
        postcard::from_bytes(&plain).map_err(|_| RestartError::Corrupted)
    }

    /// Writes the checkpoint at once: the file at `path` is always a whole one.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, case_text: &str) -> Result<(), RestartError> {
        super::replace(path, &self.to_bytes(case_text)?).map_err(|e| RestartError::File(e.to_string()))
    }

    /// Reads the checkpoint at `path`.
    ///
    /// # Errors
    /// See [`from_bytes`](Self::from_bytes).
    pub fn read(path: &Path, case_text: &str) -> Result<Self, RestartError> {
        let bytes = std::fs::read(path).map_err(|e| RestartError::File(crate::case::reason(&e)))?;
        Self::from_bytes(&bytes, case_text)
    }
}
