//! Porosity of parts of the box: how much of a region the grains fill.
//!
//! Overlaps of spheres with boxes (Strobl et al. 2016, by corners) and with spheres (lenses) are closed forms. Of a sphere and a
//! cylinder there is none without elliptic integrals: the sphere is cut across the axis, the lens of two discs is a closed form, and
//! the slices are summed by a rule of [`POINTS`] points between the heights at which the discs begin to meet or to cover each other,
//! good to 1e-6 of the grain.

use crate::darcy::transfer::{Pieces, Transfer};
use crate::grains::{Shape, sphere_volume};
use crate::state::State;
use glam::DVec3;
use serde::Deserialize;
use std::f64::consts::PI;

/// Slices between two heights where the overlap of discs changes its kind.
const POINTS: usize = 32;

/// A part of space that stays where it is [m].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub enum Region {
    /// Between two corners.
    Box {
        /// The low one.
        lower: [f64; 3],
        /// The high one.
        upper: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Its middle.
        centre: [f64; 3],
        /// [m]
        radius: f64,
    },
    /// A round bar.
    Cylinder {
        /// On the axis, where the bar begins.
        point: [f64; 3],
        /// Along the axis, of any length.
        axis: [f64; 3],
        /// [m]
        radius: f64,
        /// Along the axis [m].
        length: f64,
    },
}

impl Region {
    /// [m³]
    pub fn volume(&self) -> f64 {
        match *self {
            Region::Box { lower, upper } => (DVec3::from(upper) - DVec3::from(lower)).element_product(),
            Region::Sphere { radius, .. } => sphere_volume(radius),
            Region::Cylinder { radius, length, .. } => PI * radius * radius * length,
        }
    }

    /// The corners of the least box around it [m].
    pub fn around(&self) -> [DVec3; 2] {
        match *self {
            Region::Box { lower, upper } => [lower, upper].map(DVec3::from),
            Region::Sphere { centre, radius } => [-radius, radius].map(|r| DVec3::from(centre) + r),
            Region::Cylinder { point, axis, radius, length } => {
                let (point, axis) = (DVec3::from(point), DVec3::from(axis).normalize());
                let out = radius * (1.0 - axis * axis).max(DVec3::ZERO).map(f64::sqrt);
                let end = point + length * axis;
                [point.min(end) - out, point.max(end) + out]
            }
        }
    }

    /// The volume it shares with a sphere [m³].
    pub fn overlap(&self, at: DVec3, r: f64) -> f64 {
        match *self {
            Region::Box { lower, upper } => {
                let planes: [[f64; 2]; 3] = std::array::from_fn(|axis| [lower[axis], upper[axis]]);
                let mut pieces = Pieces::default();
                pieces.cut(
                    Transfer::Overlap,
                    Shape::Sphere,
                    at.to_array(),
                    r,
                    planes.each_ref().map(|p| &p[..]),
                );
                let [x, y, z] = pieces.first.map(|first| 1_usize.checked_sub(first));
                let ([nx, ny, nz], Some((x, (y, z)))) = (pieces.count, x.zip(y.zip(z))) else { return 0.0 };
                if x < nx && y < ny && z < nz { pieces.volume[(z * ny + y) * nx + x] } else { 0.0 }
            }
            Region::Sphere { centre, radius } => lens(DVec3::from(centre).distance(at), radius, r),
            Region::Cylinder { point, axis, radius, length } => {
                let axis = DVec3::from(axis).normalize();
                let from = at - DVec3::from(point);
                let along = from.dot(axis);
                let off = (from - along * axis).length();
                let heights = [(-along).clamp(-r, r), (length - along).clamp(-r, r)];
                bar(heights, off, radius, r)
            }
        }
    }
}

/// Void part of a region [-]; images of grains across periods count, overlaps count twice as solid.
pub fn region_porosity(state: &State, region: &Region) -> f64 {
    let cell = &state.domain.cell;
    let shifts = |axis: usize| if cell.periodic[axis] { -1..=1_i8 } else { 0..=0 };
    let [low, high] = region.around();
    let mut solid = 0.0;
    for (&x, &r) in state.grains.position.iter().zip(&state.grains.radius) {
        for a in shifts(0) {
            for b in shifts(1) {
                for c in shifts(2) {
                    let x = x + cell.shift([a, b, c]);
                    if (x + r).cmpgt(low).all() && (x - r).cmplt(high).all() {
                        solid += region.overlap(x, r);
                    }
                }
            }
        }
    }
    1.0 - solid / region.volume()
}

/// Volume shared by two spheres at a distance [m³].
fn lens(distance: f64, a: f64, b: f64) -> f64 {
    let (d, sum, difference) = (distance, a + b, a - b);
    if d >= sum {
        0.0
    } else if d <= difference.abs() {
        sphere_volume(a.min(b))
    } else {
        PI * (sum - d).powi(2) * (d * d + 2.0 * d * sum - 3.0 * difference * difference) / (12.0 * d)
    }
}

/// Area shared by two discs at a distance [m²].
fn discs(distance: f64, a: f64, b: f64) -> f64 {
    let d = distance;
    if d >= a + b {
        return 0.0;
    }
    if d <= (a - b).abs() {
        return PI * a.min(b).powi(2);
    }
    // Half the chord through the two points that both circles share, by Heron's product: no digits are lost on wide discs.
    let chord = ((a + b - d) * (d + a - b) * (d - a + b) * (d + a + b)).max(0.0).sqrt() / (2.0 * d);
    let half = |a: f64, b: f64| {
        let from = (d * d + (a - b) * (a + b)) / (2.0 * d);
        a * a * chord.atan2(from) - from * chord
    };
    half(a, b) + half(b, a)
}

/// Volume of a sphere of radius `r` between two heights from its centre and within `radius` of an axis that passes at the
/// distance `off` [m³].
fn bar([low, high]: [f64; 2], off: f64, radius: f64, r: f64) -> f64 {
    if high <= low || off >= radius + r {
        return 0.0;
    }
    if off + r <= radius {
        let below = |z: f64| PI * (r * r * z - z * z * z / 3.0);
        return below(high) - below(low);
    }
    // Slices at the heights r sin(angle) have the radius r cos(angle).
    let [from, to] = [low, high].map(|z| (z / r).asin());
    let mut breaks = vec![from, 0.0_f64.clamp(from, to), to];
    for section in [(radius - off).abs(), radius + off] {
        if section < r {
            let angle = (section / r).acos();
            breaks.extend([-angle, angle].into_iter().filter(|&angle| from < angle && angle < to));
        }
    }
    breaks.sort_by(f64::total_cmp);
    let piece = |ends: &[f64]| {
        let point = |k: usize| {
            // Slow at both ends, where roots begin.
            let u = (k as f64 + 0.5) / POINTS as f64;
            let (t, slope) = (u * u * u * (10.0 - 15.0 * u + 6.0 * u * u), 30.0 * (u * (1.0 - u)).powi(2));
            let section = r * (ends[0] + t * (ends[1] - ends[0])).cos();
            slope * section * discs(off, radius, section)
        };
        (0..POINTS).map(point).sum::<f64>() * (ends[1] - ends[0]) / POINTS as f64
    };
    breaks.windows(2).map(piece).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance * expected.abs().max(1.0), "{found} {expected}");
    }

    #[test]
    fn overlaps_of_a_ball_with_bars_are_those_of_closed_forms() {
        let bar = |point: [f64; 3], axis: [f64; 3], radius: f64, length: f64| Region::Cylinder {
            point,
            axis,
            radius,
            length,
        };
        let r = 0.7;
        let whole = sphere_volume(r);
        // A bar through the middle leaves a napkin ring.
        let through = bar([0.0, 0.0, -1.0], [0.0, 0.0, 2.0], 0.4, 2.0);
        let ring = (r * r - 0.16_f64).powf(1.5);
        close(through.overlap(DVec3::ZERO, r), 4.0 / 3.0 * PI * (r.powi(3) - ring), 1e-6 * whole);
        // Viviani's: a bar half as wide that touches the middle and the surface.
        let viviani = bar([0.5 * r, 0.0, -1.0], [0.0, 0.0, 1.0], 0.5 * r, 2.0);
        close(viviani.overlap(DVec3::ZERO, r), (2.0 * PI / 3.0 - 8.0 / 9.0) * r.powi(3), 1e-6 * whole);
        // A wide bar is a half space to a ball at its side: half of it inside, and 27/32 of the other side at half a radius.
        let wide = |off: f64| bar([-1e5 - off, 0.0, -1.0], [0.0, 0.0, 1.0], 1e5, 2.0).overlap(DVec3::ZERO, r);
        close(wide(0.0), 0.5 * whole, 1e-5 * whole);
        close(wide(-0.5 * r), 27.0 / 32.0 * whole, 1e-5 * whole);
        // Its ends: the cap beyond half a radius is 5/32.
        close(
            bar([0.0, 0.0, 0.5 * r], [0.0, 0.0, 1.0], 1.0, 2.0).overlap(DVec3::ZERO, r),
            5.0 / 32.0 * whole,
            1e-12,
        );
        // Turned it is the same.
        let turn = glam::DQuat::from_rotation_x(0.8);
        let turned =
            bar((turn * DVec3::new(0.3, 0.0, -0.2)).to_array(), (turn * DVec3::Z).to_array(), 0.5, 0.6);
        close(
            turned.overlap(DVec3::ZERO, r),
            bar([0.3, 0.0, -0.2], [0.0, 0.0, 1.0], 0.5, 0.6).overlap(DVec3::ZERO, r),
            1e-12,
        );
        // Two bars that tile one: lengths add up.
        let parts = [(-0.2, 0.25), (0.05, 0.35)]
            .map(|(z, length)| bar([0.3, 0.0, z], [0.0, 0.0, 1.0], 0.5, length).overlap(DVec3::ZERO, r));
        close(
            parts[0] + parts[1],
            bar([0.3, 0.0, -0.2], [0.0, 0.0, 1.0], 0.5, 0.6).overlap(DVec3::ZERO, r),
            1e-6,
        );
    }

    #[test]
    fn overlaps_of_a_ball_with_balls_and_boxes_are_closed_forms() {
        let ball = Region::Sphere { centre: [0.0; 3], radius: 1.0 };
        // Equal balls a radius apart share 5/16 of one.
        close(ball.overlap(DVec3::X, 1.0), 5.0 / 16.0 * sphere_volume(1.0), 1e-14);
        close(ball.overlap(DVec3::X, 0.0), 0.0, 1e-14);
        close(ball.overlap(0.2 * DVec3::X, 0.5), sphere_volume(0.5), 1e-14);
        close(ball.overlap(0.2 * DVec3::X, 2.0), sphere_volume(1.0), 1e-14);
        assert_eq!(ball.overlap(2.0 * DVec3::X, 0.9), 0.0);
        // A corner, an edge and a face of a box through the middle of a ball; a slab across it.
        let cuboid = Region::Box { lower: [0.0; 3], upper: [1.0; 3] };
        let whole = sphere_volume(0.3);
        for (x, part) in [
            ([0.0, 0.0, 0.0], 0.125),
            ([0.5, 1.0, 0.0], 0.25),
            ([0.5, 0.5, 1.0], 0.5),
            ([0.5, 0.5, 0.5], 1.0),
            ([-0.15, 0.5, 0.5], 5.0 / 32.0),
            ([-0.4, 0.5, 0.5], 0.0),
            ([1.4, 0.5, 0.5], 0.0),
        ] {
            close(cuboid.overlap(x.into(), 0.3), part * whole, 1e-12);
        }
        // A box within the ball is full.
        close(cuboid.overlap(DVec3::splat(0.5), 1.0), 1.0, 1e-12);
    }
}
