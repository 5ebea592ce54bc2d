//! The history: measures against time, one row per instant, as CSV.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// A table that grows row by row.
#[derive(Debug)]
pub struct Table {
    file: File,
    length: u64,
}

impl Table {
    /// Starts a table with a line of heads.
    pub fn create(path: &Path, heads: &[String]) -> io::Result<Self> {
        let mut table = Table { file: File::create(path)?, length: 0 };
        table.line(&heads.join(","))?;
        Ok(table)
    }

    /// Opens a table and forgets what was written after its first `length` bytes.
    pub fn reopen(path: &Path, length: u64) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).open(path)?;
        if file.metadata()?.len() < length {
            return Err(io::Error::other("it is shorter than the checkpoint says"));
        }
        file.set_len(length)?;
        let mut table = Table { file, length };
        io::Seek::seek(&mut table.file, io::SeekFrom::End(0))?;
        Ok(table)
    }

    /// Adds a row; a cell that is `None` stays empty. Numbers are written so that reading gives back the same bits.
    pub fn row(&mut self, label: &str, cells: &[Option<f64>]) -> io::Result<()> {
        let mut line = quoted(label);
        for cell in cells {
            line.push(',');
            if let Some(value) = cell {
                line.push_str(&number(*value));
            }
        }
        self.line(&line)
    }

    /// Bytes written so far.
    pub fn length(&self) -> u64 {
        self.length
    }

    fn line(&mut self, line: &str) -> io::Result<()> {
        self.file.write_all(line.as_bytes())?;
        self.file.write_all(b"\n")?;
        self.length += line.len() as u64 + 1;
        Ok(())
    }
}

/// The shortest text that reads back as the same number.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e7).contains(&size) { format!("{value}") } else { format!("{value:e}") }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_back_the_same() {
        for value in [0.0, -0.0, 1.0 / 3.0, 6.02e23, -1.5e-9, 123456.789, f64::MIN_POSITIVE] {
            let read: f64 = number(value).parse().unwrap();
            assert_eq!(read.to_bits(), value.to_bits(), "{}", number(value));
        }
    }
}
