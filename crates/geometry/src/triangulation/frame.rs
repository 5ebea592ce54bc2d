//! Whole-number coordinates: positions are snapped once to a grid of about `2^-50` of the cell and exact from there on.

use super::TriangulationError;
use super::lattice::{Lattice, reduced};
use crate::Cell;
use glam::{DMat3, DVec3};

/// Extents in grid steps, at most `2^BITS` in a walled box ...
const BITS: i32 = 50;
/// ... and less with periods, so that all images the triangulation looks at stay below `2^52`.
const PERIODIC_BITS: i32 = 48;
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
    /// Position of the upper walls, grid steps (the lower ones are at zero); 0 along periodic axes.
    pub upper: [f64; 3],
    pub lattice: Lattice,
    /// Volume of the cell, grid steps cubed.
    pub volume: f64,
}

/// A grain in grid steps.
pub(crate) struct Placed {
    /// `[x, y, z, w]`, inside the first period.
    pub point: [f64; 4],
    /// Periods (of the reduced basis) that were taken away.
    pub periods: [i32; 3],
}

/// `2^k` for `-1022 <= k <= 1023`.
fn power_of_two(k: i32) -> f64 {
    f64::from_bits(((k + 1023) as u64) << 52)
}

/// The exponent `k` with `2^(k-1) <= x < 2^k`, for a normal number.
fn exponent(x: f64) -> i32 {
    (x.to_bits() >> 52) as i32 - 1022
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
        let fail = |reason| Err(TriangulationError::Cell(reason));
        if !(cell.origin.is_finite() && cell.upper().is_finite() && cell.edges.is_finite()) {
            return fail("it is not finite");
        }
        let periodic = cell.periodic;
        for axis in (0..3).filter(|&k| !periodic[k]) {
            if cell.edges.col(axis)[axis] < f64::MIN_POSITIVE {
                return fail("an edge is not positive");
            }
            if (0..3).any(|k| k != axis && (cell.edges.col(axis)[k] != 0.0 || cell.edges.col(k)[axis] != 0.0))
            {
                return fail("the faces across a walled axis are not normal to it");
            }
        }
        let largest = cell.edges.to_cols_array().iter().fold(0.0, |m: f64, c| m.max(c.abs()));
        if largest < f64::MIN_POSITIVE {
            return fail("an edge is zero");
        }
        // Reduce at unit size: squares must not overflow.
        let unit = exponent(largest);
        let to_unit = |v: DVec3| v * power_of_two(-unit / 2) * power_of_two(-unit - -unit / 2);
        let columns = [cell.edges.x_axis, cell.edges.y_axis, cell.edges.z_axis].map(to_unit);
        let (basis, change) = reduced(DMat3::from_cols(columns[0], columns[1], columns[2]), periodic);
        let basis = [basis.x_axis, basis.y_axis, basis.z_axis];
        let longest = basis.iter().map(|b| b.length()).fold(0.0, f64::max);
        let bits = if periodic == [false; 3] { BITS } else { PERIODIC_BITS };
        let fine = bits - exponent(longest);
        let shift = fine - unit;
        let scale = [power_of_two(shift / 2), power_of_two(shift - shift / 2)];
        let (mut upper, mut step) = ([0.0; 3], [[0.0; 3]; 3]);
        for axis in 0..3 {
            if periodic[axis] {
                step[axis] = (basis[axis] * power_of_two(fine)).to_array().map(whole);
            } else {
                // As the positions are mapped: by way of the difference of two coordinates.
                let extent = cell.upper()[axis] - cell.origin[axis];
                upper[axis] = whole(extent * scale[0] * scale[1]);
                if upper[axis] < 1.0 {
                    return fail("one edge is more than 2^48 times shorter than another");
                }
            }
        }
        let Some(lattice) = Lattice::new(step, change, periodic) else {
            return fail("its periods lie in one plane");
        };
        let mut volume = 1.0;
        let periods =
            (0..3).map(|j| if periodic[j] { DVec3::from_array(step[j]) } else { DVec3::AXES[j] * upper[j] });
        let columns: Vec<DVec3> = periods.collect();
        volume *= DMat3::from_cols(columns[0], columns[1], columns[2]).determinant().abs();
        Ok(Frame { origin: cell.origin, scale, upper, lattice, volume })
    }

    /// The nearest grid point in the first period; rounding is monotone, so a grain inside the box stays inside.
    ///
    /// # Errors
    /// Names the grain if it is not finite, has a bad radius, or lies beyond a wall or a million periods away.
    pub fn place(&self, grain: usize, x: DVec3, r: f64) -> Result<Placed, TriangulationError> {
        if !x.is_finite() {
            return Err(TriangulationError::Position { grain });
        }
        let radius = r * self.scale[0] * self.scale[1];
        if !(0.0..=LARGEST_RADIUS).contains(&radius) {
            return Err(TriangulationError::Radius { grain });
        }
        let d = x - self.origin;
        let step = |c: f64| c * self.scale[0] * self.scale[1];
        let mut place = [step(d.x), step(d.y), step(d.z)];
        let mut periods = [0; 3];
        if self.lattice.periodic != [false; 3] {
            let whole_periods = self.lattice.coordinates(place).map(f64::floor);
            if !whole_periods.iter().all(|k| k.abs() < 1e6) {
                return Err(TriangulationError::Far { grain });
            }
            if whole_periods != [0.0; 3] {
                place = self.lattice.moved(place, whole_periods.map(|k| -k));
                periods = whole_periods.map(|k| k as i32);
            }
        }
        let [x, y, z] = [whole(place[0]), whole(place[1]), whole(place[2])];
        for (axis, c) in [x, y, z].into_iter().enumerate().filter(|&(axis, _)| !self.lattice.periodic[axis]) {
            if !(0.0..=self.upper[axis]).contains(&c) {
                let face = 2 * axis + usize::from(c > 0.0);
                return Err(TriangulationError::Outside { grain, face });
            }
        }
        Ok(Placed { point: [x, y, z, whole(radius * radius)], periods })
    }
}
