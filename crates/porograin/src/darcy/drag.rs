//! The drag on grains that move against the mean of those around them.
//!
//! A grain that moves at `v_p` where the grains move at `v_s` feels `beta/(1 - n) V_p (v_s - v_p)` beside its share of the
//! pressure gradient, `beta = n²/M` with the mobility M (Goodarzi 8-9): corner by corner, for its part there, so that the
//! forces around a corner sum to zero. It is taken at the end of the kick, `beta -> beta/(1 + kick beta/((1 - n) rho))`,
//! and so sets no limit to the time step.

use super::grid::Grid;
use super::passes::{Field, Four};

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

    /// The field of the drag and this pull of the pressures. `carried` are the sums of volume times velocity of the grains around
    /// each corner.
    pub fn around(&self, pull: &[Vec<f64>; 3], carried: &[Four], field: &mut Vec<Field>) {
        field.clear();
        let [x, y, z] = pull;
        let pull = x.iter().zip(y).zip(z);
        field.extend(self.0.iter().zip(carried).zip(pull).map(|(([r, per_volume], v), ((x, y), z))| Field {
            pull: [*x, *y, *z, *r],
            drag: [per_volume * v[0], per_volume * v[1], per_volume * v[2], 0.0],
        }));
    }
}
