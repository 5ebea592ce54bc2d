//! Orders in which grains that are close in space get numbers that are close.

use crate::Cell;
use glam::DVec3;

/// Bits per axis of a Hilbert key.
const BITS: u32 = 20;

/// The grains along a Hilbert curve through the cell: entry `k` is the index of the `k`-th grain of the curve.
///
/// Loops over neighbours are cache-friendly when grains are stored in this order. Positions outside the cell (or
/// not finite) are clamped to it; grains with equal keys keep their order. `O(n log n)`.
pub fn hilbert(cell: &Cell, position: &[DVec3]) -> Vec<u32> {
    let (low, high) = bounds(cell);
    sorted(position.iter().copied(), low, high)
}

/// Grains across a column, some.
const ACROSS: f64 = 33.0;

/// The grains in upright columns, one after the other: entry `k` is the index of the `k`-th grain. Each column is climbed layer by layer, a layer
/// row by row, a row along x.
///
/// A loop over neighbours of larger numbers finds them where it is itself, one row or one layer further on; both run
/// ahead steadily, and two layers of a column stay in the second cache (2 MB). Positions outside the cell (or not finite) are clamped to it.
/// `O(n log n)`.
pub fn columns(cell: &Cell, position: &[DVec3]) -> Vec<u32> {
    let (low, high) = bounds(cell);
    let extent = high - low;
    let spacing = (extent.element_product() / position.len().max(1) as f64).cbrt();
    let width = extent / (extent / (ACROSS * spacing)).round().max(DVec3::splat(2.0));
    // `as u32` saturates and sends NaN to zero.
    let key = |p: DVec3| {
        let at = (p - low).min(extent);
        [at.y / width.y, at.x / width.x, at.z / spacing, at.y / spacing, at.x / spacing * 1024.0]
            .map(|c| c as u32)
    };
    let mut order: Vec<([u32; 5], u32)> = position.iter().zip(0..).map(|(&p, i)| (key(p), i)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

/// Corners of the smallest box around a cell.
fn bounds(cell: &Cell) -> (DVec3, DVec3) {
    let (mut low, mut high) = (cell.origin, cell.origin);
    for corner in 1..8 {
        let bit = |k: u32| f64::from((corner >> k) & 1);
        let point = cell.origin + cell.edges * DVec3::new(bit(0), bit(1), bit(2));
        (low, high) = (low.min(point), high.max(point));
    }
    (low, high)
}

/// The points along a Hilbert curve through the cube at `low` that holds `high`.
pub(crate) fn sorted(points: impl Iterator<Item = DVec3>, low: DVec3, high: DVec3) -> Vec<u32> {
    let scale = f64::from((1u32 << BITS) - 1) / (high - low).max_element();
    // `as u32` saturates and sends NaN to zero.
    let key = |p: DVec3| curve_key(((p - low) * scale).to_array().map(|c| (c as u32).min((1 << BITS) - 1)));
    let mut order: Vec<(u64, u32)> = points.zip(0..).map(|(p, i)| (key(p), i)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

/// An insertion order of `0..n` (places along a curve) in rounds that grow up to eightfold from about `first`: each round holds one
/// place at random out of each few of the next, and runs along the curve. Also returns the length of the first round.
///
/// The randomness (fixed seed) bounds the expected cost for any input, the rounds keep the walks short (N. Amenta,
/// S. Choi, G. Rote, "Incremental constructions con BRIO", 2003).
pub(crate) fn rounds(n: usize, first: usize) -> (Vec<u32>, usize) {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut pick = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 32) as usize * below) >> 32
    };
    let mut order = vec![0; n];
    let mut end = n;
    let mut places: Vec<u32> = (0..n as u32).collect();
    while places.len() >= 2 * first {
        let growth = (places.len() / first).min(8);
        let mut earlier = Vec::with_capacity(places.len() / growth + 1);
        let mut at = end - (places.len() - places.len().div_ceil(growth));
        end = at;
        for block in places.chunks(growth) {
            let chosen = pick(block.len());
            for (k, &place) in block.iter().enumerate() {
                if k == chosen {
                    earlier.push(place);
                } else {
                    order[at] = place;
                    at += 1;
                }
            }
        }
        places = earlier;
    }
    order[..end].copy_from_slice(&places);
    (order, end)
}

/// Place of a lattice point on the Hilbert curve (J. Skilling, "Programming the Hilbert curve", AIP Conf. Proc.
/// 707, 381, 2004).
fn curve_key(mut x: [u32; 3]) -> u64 {
    let mut q = 1 << (BITS - 1);
    while q > 1 {
        let p = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[i]) & p;
                x[0] ^= t;
                x[i] ^= t;
            }
        }
        q >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut t = 0;
    q = 1 << (BITS - 1);
    while q > 1 {
        if x[2] & q != 0 {
            t ^= q - 1;
        }
        q >>= 1;
    }
    x.iter().map(|&c| spread(u64::from(c ^ t))).fold(0, |key, bits| (key << 1) | bits)
}

/// Puts two zero bits between the bits of a 21-bit number.
fn spread(mut x: u64) -> u64 {
    x = (x | (x << 32)) & 0x001f_0000_0000_ffff;
    x = (x | (x << 16)) & 0x001f_0000_ff00_00ff;
    x = (x | (x << 8)) & 0x100f_00f0_0f00_f00f;
    x = (x | (x << 4)) & 0x10c3_0c30_c30c_30c3;
    (x | (x << 2)) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_are_a_permutation() {
        for n in [0, 1, 2, 8, 9, 17, 64, 65, 1000] {
            for first in [4, 10] {
                let (mut order, length) = rounds(n, first);
                assert!(
                    length <= n && (n < first || (first..2 * first).contains(&length)),
                    "{n} {first} {length}"
                );
                order.sort_unstable();
                assert_eq!(order, (0..n as u32).collect::<Vec<_>>());
            }
        }
    }

    /// A lattice of 70 x 40 x 5 points: two columns either way, neighbours one apart within a row.
    #[test]
    fn columns_are_climbed_layer_by_layer_and_row_by_row() {
        let n = [70, 40, 5];
        let mut points: Vec<DVec3> = Vec::new();
        for k in 0..n[0] * n[1] * n[2] {
            // In no order.
            let k = k * 4999 % (n[0] * n[1] * n[2]);
            let place = [k % n[0], k / n[0] % n[1], k / (n[0] * n[1])];
            points.push(DVec3::from_array(place.map(|c| f64::from(c as u32) + 0.5)));
        }
        let cell = Cell::walled(DVec3::ZERO, DVec3::from_array(n.map(|c| f64::from(c as u32))));
        let order = columns(&cell, &points);
        let mut expected = Vec::new();
        for [y, x] in [[0, 0], [0, 35], [20, 0], [20, 35]] {
            for layer in 0..5 {
                for row in y..y + 20 {
                    for place in x..x + 35 {
                        expected.push(DVec3::new(f64::from(place), f64::from(row), f64::from(layer)) + 0.5);
                    }
                }
            }
        }
        assert!(order.iter().map(|&k| points[k as usize]).eq(expected));
        // One that is nowhere has a number as well.
        points[17] = DVec3::NAN;
        let mut all = columns(&cell, &points);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..points.len() as u32));
    }

    #[test]
    fn consecutive_points_of_the_curve_are_lattice_neighbours() {
        let m = 8u32;
        let step = f64::from((1u32 << BITS) / m);
        let unit = f64::from((1u32 << BITS) - 1);
        let points: Vec<DVec3> = (0..m * m * m)
            .map(|i| DVec3::new(f64::from(i % m), f64::from(i / m % m), f64::from(i / m / m)) * step)
            .collect();
        let order = hilbert(&Cell::walled(DVec3::ZERO, DVec3::splat(unit)), &points);
        let mut seen = order.clone();
        seen.sort_unstable();
        assert!(seen.iter().zip(0..).all(|(a, b)| *a == b));
        for pair in order.windows(2) {
            let d = (points[pair[0] as usize] - points[pair[1] as usize]).length();
            assert_eq!(d, step);
        }
    }
}
