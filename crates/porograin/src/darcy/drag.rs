//! The drag on grains that move against the mean of those around them.
//!
//! A grain that moves at `v_p` where the grains move at `v_s` feels `beta/(1 - n) V_p (v_s - v_p)` beside its share of the
//! pressure gradient, `beta = n²/M` with the mobility M (Goodarzi 8-9): corner by corner, for its part there, so that the
//! forces around a corner sum to zero. It is taken at the end of the kick, `beta -> beta/(1 + kick beta/((1 - n) rho))`,
//! and so sets no limit to the time step.

use super::corners::{Field, Four};
use super::grid::Grid;

/// Resistance r around each corner [kg/(m³ s)], and over the volume of the grains there.
pub struct Resistance(Vec<[f64; 2]>);

impl Resistance {
    /// Under a kick of this length [s].
    pub fn new(grid: &Grid, kick: f64) -> Resistance {
        let of = |(&viscous, &solid): (&f64, &f64)| {
            let r = if solid > 0.0 { viscous / (1.0 + kick / grid.density * viscous) } else { 0.0 };
            [r, if solid > 0.0 { r / solid } else { 0.0 }]
        };
        Resistance(grid.resistance.iter().zip(&grid.corners.solid).map(of).collect())
    }

    /// None at all.
    pub fn none(grid: &Grid) -> Resistance {
        Resistance(vec![[0.0; 2]; grid.corners.len()])
    }

    /// The field of the drag and of a pull, whose components come one after the other. `carried` are the sums of volume times velocity
    /// of the grains around each corner.
    pub fn around(&self, carried: &[Four], pull: &[Vec<f64>; 3], field: &mut Vec<Field>) {
        field.clear();
        let [x, y, z] = pull;
        let pulls = x.iter().zip(y).zip(z);
        field.extend(self.0.iter().zip(carried).zip(pulls).map(
            |(([r, per_volume], [u, v, w, _]), ((&x, &y), &z))| Field {
                pull: [x, y, z, *r],
                drag: [per_volume * u, per_volume * v, per_volume * w, 0.0],
            },
        ));
    }
}
