//! Whole-number coordinates: positions are snapped once to a grid of `2^-50` of the cell and exact from there on.

use super::TriangulationError;
use crate::Cell;
use glam::DVec3;

/// Bits of a coordinate: the longest extent of the cell is at most `2^BITS` grid steps.
const BITS: i32 = 50;
/// Largest radius in grid steps: its square must leave room in the 128-bit rows of the exact stage.
const LARGEST_RADIUS: f64 = (1u64 << 60) as f64;

/// The map from metres to grid steps, a translation and a scaling by a power of two.
///
/// The scale depends on the cell only, so scaling everything by a power of two changes no bit of the coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    origin: DVec3,
    /// Two factors: their product may overflow where the scaled coordinate does not.
    scale: [f64; 2],
    /// Extent of the box, grid steps.
    pub size: [f64; 3],
}

/// `2^k` for `-1022 <= k <= 1023`.
fn power_of_two(k: i32) -> f64 {
    f64::from_bits(((k + 1023) as u64) << 52)
}

/// The nearest whole number, halves to even. (`f64::round` is a library call on plain x86-64: 4 % of the whole.)
#[inline]
fn whole(x: f64) -> f64 {
    const BIG: f64 = (3u64 << 51) as f64;
    // Beyond 2^51 the box is left, or half a step no longer matters.
    if x.abs() < (1u64 << 51) as f64 { (x + BIG) - BIG } else { x.trunc() }
}

impl Frame {
    pub fn new(cell: &Cell) -> Result<Self, TriangulationError> {
        let upper = cell.upper();
        let size = upper - cell.origin;
        if !(cell.origin.is_finite() && size.is_finite() && cell.edges.is_finite()) {
            return Err(TriangulationError::Cell("it is not finite"));
        }
        for axis in 0..3 {
            for other in 0..3 {
                let edge = cell.edges.col(axis)[other];
                if axis == other && edge < f64::MIN_POSITIVE {
                    return Err(TriangulationError::Cell("an edge is not positive"));
                }
                if axis != other && edge != 0.0 {
                    return Err(TriangulationError::Cell(
                        "the faces across a walled axis are not normal to it",
                    ));
                }
            }
        }
        let longest = size.max_element();
        if longest < f64::MIN_POSITIVE {
            return Err(TriangulationError::Cell("an edge is not positive"));
        }
        let exponent = (longest.to_bits() >> 52) as i32 - 1022; // longest < 2^exponent
        let shift = BITS - exponent;
        let scale = [power_of_two(shift / 2), power_of_two(shift - shift / 2)];
        let mut frame = Frame { origin: cell.origin, scale, size: [0.0; 3] };
        frame.size = frame.snap(upper);
        if frame.size.iter().any(|&s| s < 1.0) {
            return Err(TriangulationError::Cell("one edge is more than 2^50 times shorter than another"));
        }
        Ok(frame)
    }

    /// The nearest grid point; rounding is monotone, so a grain inside the box stays inside.
    pub fn snap(&self, x: DVec3) -> [f64; 3] {
        let step = |c: f64| whole(c * self.scale[0] * self.scale[1]);
        let d = x - self.origin;
        [step(d.x), step(d.y), step(d.z)]
    }

    /// Coordinates and weight `r²` of a grain, whole numbers.
    pub fn point(&self, grain: usize, x: DVec3, r: f64) -> Result<[f64; 4], TriangulationError> {
        if !x.is_finite() {
            return Err(TriangulationError::Position { grain });
        }
        let radius = r * self.scale[0] * self.scale[1];
        if !(0.0..=LARGEST_RADIUS).contains(&radius) {
            return Err(TriangulationError::Radius { grain });
        }
        let [x, y, z] = self.snap(x);
        Ok([x, y, z, whole(radius * radius)])
    }
}
