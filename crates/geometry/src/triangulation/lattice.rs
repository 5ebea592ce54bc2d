//! The periods of a cell in whole numbers: reduced basis, nearest image.

use glam::{DMat3, DVec3};

/// A reduced basis of the periods, in grid steps. Axes without a period have zero vectors and are never shifted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lattice {
    /// Vector `j` of the reduced basis, whole numbers.
    pub step: [[f64; 3]; 3],
    /// Rows of the inverse basis: `dual[j]·x` is coordinate `j` of `x` in periods.
    pub dual: [[f64; 3]; 3],
    /// Reduced vector `j` is `sum_i edges[i] * change[i][j]`.
    change: [[i64; 3]; 3],
    pub periodic: [bool; 3],
    /// A difference whose components are all below this is its own nearest image.
    safe: f64,
}

/// A shorter basis of the lattice of the periodic columns, and the whole-number matrix that makes it.
///
/// Pairwise (Gauss-Lagrange) steps and sums of all three, until no vector gets shorter.
pub(crate) fn reduced(edges: DMat3, periodic: [bool; 3]) -> (DMat3, [[i64; 3]; 3]) {
    let mut basis = [edges.x_axis, edges.y_axis, edges.z_axis];
    let mut change: [[i64; 3]; 3] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    let axes: Vec<usize> = (0..3).filter(|&k| periodic[k]).collect();
    // Each step shortens a vector by a millionth at least, so that round-off cannot make it run for ever.
    let shorter = |new: DVec3, old: DVec3| new.length_squared() < old.length_squared() * (1.0 - 1e-6);
    let mut improved = true;
    while improved {
        improved = false;
        for &i in &axes {
            let others: Vec<usize> = axes.iter().copied().filter(|&j| j != i).collect();
            let mut trials: Vec<[f64; 3]> = Vec::new();
            for &j in &others {
                let mut factors = [0.0; 3];
                factors[j] = -(basis[i].dot(basis[j]) / basis[j].length_squared()).round();
                trials.push(factors);
            }
            if let [j, k] = others[..] {
                for sign in 0..4 {
                    let mut factors = [0.0; 3];
                    factors[j] = if sign & 1 == 0 { 1.0 } else { -1.0 };
                    factors[k] = if sign & 2 == 0 { 1.0 } else { -1.0 };
                    trials.push(factors);
                }
            }
            for factors in trials {
                let new = basis[i] + (0..3).map(|j| basis[j] * factors[j]).sum::<DVec3>();
                if factors.iter().all(|f| f.abs() < 1e9) && shorter(new, basis[i]) {
                    basis[i] = new;
                    for row in &mut change {
                        row[i] = (0..3).fold(row[i], |sum, j| {
                            sum.saturating_add(row[j].saturating_mul(factors[j] as i64))
                        });
                    }
                    improved = true;
                }
            }
        }
    }
    (DMat3::from_cols(basis[0], basis[1], basis[2]), change)
}

impl Lattice {
    /// The lattice of the reduced basis `step` (whole numbers); `None` if its vectors are (nearly) dependent.
    pub fn new(step: [[f64; 3]; 3], change: [[i64; 3]; 3], periodic: [bool; 3]) -> Option<Self> {
        let mut basis = [DVec3::X, DVec3::Y, DVec3::Z];
        for j in (0..3).filter(|&j| periodic[j]) {
            basis[j] = DVec3::from_array(step[j]);
        }
        let lengths: f64 = basis.iter().map(|b| b.length()).product();
        let matrix = DMat3::from_cols(basis[0], basis[1], basis[2]);
        // A reduced basis spans at least 1/sqrt(2) of the box of its lengths.
        let volume = matrix.determinant().abs();
        if volume.is_nan() || volume <= 1e-3 * lengths {
            return None;
        }
        let inverse = matrix.inverse();
        let mut lattice =
            Lattice { step: [[0.0; 3]; 3], dual: [[0.0; 3]; 3], change, periodic, safe: f64::INFINITY };
        for j in (0..3).filter(|&j| periodic[j]) {
            lattice.step[j] = step[j];
            lattice.dual[j] = inverse.row(j).to_array();
            let sum: f64 = lattice.dual[j].iter().map(|c| c.abs()).sum();
            lattice.safe = lattice.safe.min(0.499 / sum);
        }
        Some(lattice)
    }

    /// A lattice without periods.
    pub fn none() -> Self {
        Lattice { safe: f64::INFINITY, ..Default::default() }
    }

    /// Distance of the lattice planes across axis `j`; infinite without a period.
    pub fn height(&self, j: usize) -> f64 {
        1.0 / DVec3::from_array(self.dual[j]).length()
    }

    /// The smallest distance of lattice planes.
    pub fn least_height(&self) -> f64 {
        (0..3).map(|j| self.height(j)).fold(f64::INFINITY, f64::min)
    }

    /// Coordinates in periods (zero along walled axes).
    pub fn coordinates(&self, x: [f64; 3]) -> [f64; 3] {
        let dot = |d: &[f64; 3]| d[0] * x[0] + d[1] * x[1] + d[2] * x[2];
        [dot(&self.dual[0]), dot(&self.dual[1]), dot(&self.dual[2])]
    }

    /// `x` moved by whole periods.
    #[inline]
    pub fn moved(&self, x: [f64; 3], by: [f64; 3]) -> [f64; 3] {
        let mut y = x;
        for j in 0..3 {
            for k in 0..3 {
                y[k] += by[j] * self.step[j][k];
            }
        }
        y
    }

    /// The nearest image of a difference (coordinates within half a period).
    #[inline(always)]
    pub fn nearest(&self, d: [f64; 3]) -> [f64; 3] {
        if self.is_nearest(d) { d } else { self.nearest_far(d) }
    }

    /// Whether a difference is surely its own nearest image.
    #[inline(always)]
    pub fn is_nearest(&self, d: [f64; 3]) -> bool {
        d[0].abs() < self.safe && d[1].abs() < self.safe && d[2].abs() < self.safe
    }

    /// Whether a difference is its own nearest image, and so are those with others like it.
    #[inline(always)]
    pub fn is_close(&self, d: [f64; 3]) -> bool {
        let half = 0.5 * self.safe;
        d[0].abs() < half && d[1].abs() < half && d[2].abs() < half
    }

    #[inline(never)]
    fn nearest_far(&self, d: [f64; 3]) -> [f64; 3] {
        self.moved(d, self.shift_to_nearest(d))
    }

    /// The periods to add to a difference to get its nearest image.
    pub fn shift_to_nearest(&self, d: [f64; 3]) -> [f64; 3] {
        const BIG: f64 = (3u64 << 51) as f64; // adding it rounds to whole numbers, halves to even
        let [a, b, c] = self.coordinates(d);
        [-((a + BIG) - BIG), -((b + BIG) - BIG), -((c + BIG) - BIG)]
    }

    /// Periods along the reduced basis as periods along the edges of the cell.
    pub fn along_edges(&self, k: [i32; 3]) -> [i64; 3] {
        [0, 1, 2].map(|i| {
            (0..3).map(|j| self.change[i][j].saturating_mul(i64::from(k[j]))).fold(0, i64::saturating_add)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reduction_undoes_a_change_of_basis() {
        let edges = DMat3::from_cols(
            DVec3::new(1.0, 0.0, 0.0),
            DVec3::new(0.25, 1.0, 0.0),
            DVec3::new(0.0, -0.5, 1.5),
        );
        let change = DMat3::from_cols(
            DVec3::new(1.0, 3.0, -2.0),
            DVec3::new(0.0, 1.0, 5.0),
            DVec3::new(0.0, 0.0, 1.0),
        );
        let long = edges * change;
        let (short, made) = reduced(long, [true; 3]);
        let lengths = |m: DMat3| {
            let mut l = [m.x_axis, m.y_axis, m.z_axis].map(|v| v.length());
            l.sort_by(f64::total_cmp);
            l
        };
        assert_eq!(lengths(short), lengths(reduced(edges, [true; 3]).0));
        let m = DMat3::from_cols_array_2d(&[0, 1, 2].map(|j| [0, 1, 2].map(|i| made[i][j] as f64)));
        assert_eq!(long * m, short);
        assert_eq!(m.determinant().abs(), 1.0);
    }

    #[test]
    fn nearest_images_are_within_half_a_period() {
        let step = [[8.0, 0.0, 0.0], [2.0, 10.0, 0.0], [0.0, -3.0, 12.0]];
        let lattice = Lattice::new(step, [[0; 3]; 3], [true; 3]).unwrap();
        for x in (-40..40).map(|i| f64::from(i) * 0.7) {
            let d = lattice.nearest([x, 3.0 * x, 17.0 - x]);
            assert!(lattice.coordinates(d).iter().all(|c| c.abs() <= 0.5 + 1e-12));
        }
    }
}
