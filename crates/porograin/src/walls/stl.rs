//! STL files, binary and in words.
//!
//! Binary: 80 bytes of anything, the number of triangles in 4, then for each its normal and three corners as 12 numbers of
//! 4 bytes, and 2 bytes of anything, all little-endian. In words: `solid`, then `facet normal x y z`, `outer loop`, three times
//! `vertex x y z`, `endloop`, `endfacet`, then `endsolid`. Normals are not read: the corners say the same.

use glam::DVec3;
use std::fmt;

/// What is wrong with an STL file, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StlError {
    /// Of one in words: line, from 1.
    Line(usize, String),
    /// Of a binary one: byte, from 0.
    Byte(usize, String),
}

impl fmt::Display for StlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StlError::Line(line, what) => write!(f, "line {line}: {what}"),
            StlError::Byte(byte, what) => write!(f, "byte {byte}: {what}"),
        }
    }
}

impl std::error::Error for StlError {}

/// Where the triangles of a binary file begin, and how long each is.
const HEAD: usize = 84;
const RECORD: usize = 50;

/// The corners of all triangles.
///
/// # Errors
/// When the bytes are no STL file, or stop short, or hold something that is not a number.
pub fn read(bytes: &[u8]) -> Result<Vec<[DVec3; 3]>, StlError> {
    let told = bytes.get(80..HEAD).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    // The length tells: binary files may begin with the word `solid` too.
    let fits = told.is_some_and(|n| bytes.len() as u64 == HEAD as u64 + RECORD as u64 * u64::from(n));
    if !fits
        && let Ok(text) = std::str::from_utf8(bytes)
        && text.trim_start().starts_with("solid")
    {
        return read_words(text);
    }
    match told {
        None => Err(StlError::Byte(
            bytes.len(),
            format!("the file ends within its head of {HEAD} bytes, and does not begin with `solid`"),
        )),
        Some(n) if !fits => {
            let needed = HEAD as u64 + RECORD as u64 * u64::from(n);
            let place = bytes.len().min(needed.min(usize::MAX as u64) as usize);
            let ends = if (bytes.len() as u64) < needed { "ends" } else { "goes on" };
            Err(StlError::Byte(
                place,
                format!("the file {ends} here, but its {n} triangles take {needed} bytes in all"),
            ))
        }
        Some(_) => read_binary(bytes),
    }
}

fn read_binary(bytes: &[u8]) -> Result<Vec<[DVec3; 3]>, StlError> {
    let number = |at: usize| -> Result<f64, StlError> {
        let value = f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if value.is_finite() {
            Ok(f64::from(value))
        } else {
            Err(StlError::Byte(at, format!("{value} is no coordinate")))
        }
    };
    let corner = |at: usize| Ok(DVec3::new(number(at)?, number(at + 4)?, number(at + 8)?));
    (HEAD..bytes.len())
        .step_by(RECORD)
        .map(|at| Ok([corner(at + 12)?, corner(at + 24)?, corner(at + 36)?]))
        .collect()
}

fn read_words(text: &str) -> Result<Vec<[DVec3; 3]>, StlError> {
    let mut triangles = Vec::new();
    let mut corners: Vec<DVec3> = Vec::new();
    let mut last = 0;
    let mut ended = false;
    for (k, line) in text.lines().enumerate() {
        let wrong = |what: String| StlError::Line(k + 1, what);
        let mut words = line.split_whitespace();
        let Some(word) = words.next() else { continue };
        last = k + 1;
        match word.to_ascii_lowercase().as_str() {
            "solid" => ended = false,
            "endsolid" => ended = true,
            "facet" | "outer" | "endloop" => {}
            "vertex" => {
                let numbers: Vec<f64> = words
                    .map(|word| match word.parse::<f64>() {
                        Ok(number) if number.is_finite() => Ok(number),
                        _ => Err(wrong(format!("`{word}` is no coordinate"))),
                    })
                    .collect::<Result<_, _>>()?;
                let [x, y, z] = numbers[..] else {
                    return Err(wrong(format!("a vertex has 3 coordinates, not {}", numbers.len())));
                };
                corners.push(DVec3::new(x, y, z));
            }
            "endfacet" => {
                let Ok(three) = <[DVec3; 3]>::try_from(std::mem::take(&mut corners)) else {
                    return Err(wrong("a facet must have 3 vertices".into()));
                };
                triangles.push(three);
            }
            other => return Err(wrong(format!("`{other}` does not belong into an STL file"))),
        }
    }
    if !ended {
        return Err(StlError::Line(last, "the file ends here, but there is no `endsolid`".into()));
    }
    Ok(triangles)
}
