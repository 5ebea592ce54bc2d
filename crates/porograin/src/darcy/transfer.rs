//! Which part of each grain lies where: exact overlap volumes of spheres and discs with boxes, or a smooth kernel.

use crate::grains::Shape;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// How the volume of a grain is shared among the cells it reaches into.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub enum Transfer {
    /// Exactly where it is: the overlap of sphere, or disc, and cell.
    #[default]
    Overlap,
    /// Smeared over the product of `(1 + cos(pi s/b))/(2 b)` along the axes: shares change smoothly as grains move.
    Kernel {
        /// The half-width b over the radius of the grain [-].
        width: f64,
    },
}

/// The pieces into which planes cut one grain. Pieces along an axis are numbered from the slab in front of the
/// first plane; what reaches beyond the outermost plane given stays in the outermost piece.
#[derive(Clone, Debug, Default)]
pub struct Pieces {
    /// Number of the first piece along each axis.
    pub first: [usize; 3],
    /// Number of pieces along each axis.
    pub count: [usize; 3],
    /// Volumes [m³], x fastest.
    pub volume: Vec<f64>,
    corners: [Vec<f64>; 3],
}

impl Pieces {
    /// Cuts a grain at `centre` [m] by planes (rising coordinates [m], along each axis). The volumes sum to that of the
    /// grain.
    pub fn cut(
        &mut self,
        transfer: Transfer,
        shape: Shape,
        centre: [f64; 3],
        radius: f64,
        planes: [&[f64]; 3],
    ) {
        let reach = match transfer {
            Transfer::Overlap => radius,
            Transfer::Kernel { width } => width * radius,
        };
        for axis in 0..3 {
            let at = centre[axis];
            let first = planes[axis].partition_point(|&plane| plane <= at - reach);
            let last = planes[axis].partition_point(|&plane| plane < at + reach);
            let corners = &mut self.corners[axis];
            corners.clear();
            corners.push(f64::NEG_INFINITY);
            corners.extend(planes[axis][first..last.max(first)].iter().map(|plane| (plane - at) / reach));
            self.first[axis] = first;
            self.count[axis] = corners.len();
        }
        let whole = shape.volume(radius);
        let [nx, ny, nz] = self.count;
        self.volume.clear();
        if nx * ny * nz == 1 {
            self.volume.push(whole);
            return;
        }
        let [x, y, z] = &self.corners;
        for &c in z {
            for &b in y {
                for &a in x {
                    self.volume.push(whole * beyond(transfer, shape, [a, b, c]));
                }
            }
        }
        // Beyond one corner less beyond the next leaves the piece between them.
        let stride = [1, nx, nx * ny];
        for axis in 0..3 {
            for k in 0..self.volume.len() {
                if (k / stride[axis]) % self.count[axis] + 1 < self.count[axis] {
                    self.volume[k] -= self.volume[k + stride[axis]];
                }
            }
        }
        self.sweep(DUST * whole);
    }

    /// Gives pieces smaller than `least`, which are nothing but rounding, to the largest one.
    fn sweep(&mut self, least: f64) {
        let largest =
            (0..self.volume.len()).max_by(|&a, &b| self.volume[a].total_cmp(&self.volume[b])).unwrap_or(0);
        let mut dust = 0.0;
        for volume in self.volume.iter_mut().filter(|volume| **volume < least) {
            dust += *volume;
            *volume = 0.0;
        }
        self.volume[largest] += dust;
    }
}

/// Pieces below this part of the grain are what rounding left.
const DUST: f64 = 1e-12;

/// Part of a grain of reach 1 around the origin that lies beyond the corner, `x > a, y > b, z > c`.
fn beyond(transfer: Transfer, shape: Shape, corner: [f64; 3]) -> f64 {
    match (transfer, shape) {
        (Transfer::Kernel { .. }, _) => corner.map(tail).iter().product(),
        (Transfer::Overlap, Shape::Sphere) => ball_beyond(corner) / (4.0 / 3.0 * PI),
        // A disc lies in x and z and is never cut across y.
        (Transfer::Overlap, Shape::Disc { .. }) => disc_beyond([corner[0], corner[2]]) / PI,
    }
}

/// Integral of the kernel from `s` on.
fn tail(s: f64) -> f64 {
    let s = s.clamp(-1.0, 1.0);
    0.5 * (1.0 - s - (PI * s).sin() / PI)
}

/// Volume of the unit ball beyond a corner. A corner coordinate behind the centre leaves twice the half ball less the
/// mirror image of what is cut away.
fn ball_beyond(corner: [f64; 3]) -> f64 {
    if let Some(axis) = corner.iter().position(|&c| c < 0.0) {
        let (mut middle, mut mirrored) = (corner, corner);
        middle[axis] = 0.0;
        mirrored[axis] = -corner[axis];
        return 2.0 * ball_beyond(middle) - ball_beyond(mirrored);
    }
    ball_corner(corner)
}

/// Volume of the unit ball within `x > a, y > b, z > c` for a corner with no negative coordinate.
///
/// By the divergence theorem `3 V = A - a A_x - b A_y - c A_z`, A the spherical triangle and A_x the part of the plane x = a.
/// By Gauss-Bonnet `A = sum of angles - pi - a phi_a - b phi_b - c phi_c`, phi_a the angle that the arc in the plane
/// x = a takes of its circle, and `cos(angle) = a b/sqrt((1 - a²)(1 - b²))` where the planes x = a and y = b meet.
fn ball_corner(corner: [f64; 3]) -> f64 {
    let square = corner.map(|c| c * c);
    if square[0] + square[1] + square[2] >= 1.0 {
        return 0.0;
    }
    // One plane alone, and the common case: a quarter of a cap.
    if corner.iter().filter(|&&c| c == 0.0).count() >= 2 {
        let a = corner[0] + corner[1] + corner[2];
        return PI / 12.0 * (1.0 - a) * (1.0 - a) * (2.0 + a);
    }
    let mut three_volumes = -PI;
    for axis in 0..3 {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        let (a, b, c) = (corner[axis], corner[next], corner[last]);
        let (rest_a, rest_b) = (1.0 - square[axis], 1.0 - square[next]);
        let (angle, area) = circle_corner(rest_a, b, c);
        three_volumes += (a * b / (rest_a * rest_b).sqrt()).min(1.0).acos() - a * angle - a * area;
    }
    (three_volumes / 3.0).max(0.0)
}

/// Angle of the arc, and area, of a circle of squared radius `square` within `x > b, y > c`, a corner inside it with no
/// negative coordinate.
fn circle_corner(square: f64, b: f64, c: f64) -> (f64, f64) {
    let (beyond_b, beyond_c) = ((square - b * b).max(0.0).sqrt(), (square - c * c).max(0.0).sqrt());
    let angle = (beyond_b.atan2(b) - c.atan2(beyond_c)).max(0.0);
    (angle, 0.5 * (square * angle - b * (beyond_b - c) - c * (beyond_c - b)))
}

/// Area of the unit disc beyond a corner.
fn disc_beyond(corner: [f64; 2]) -> f64 {
    if let Some(axis) = corner.iter().position(|&c| c < 0.0) {
        let (mut middle, mut mirrored) = (corner, corner);
        middle[axis] = 0.0;
        mirrored[axis] = -corner[axis];
        return 2.0 * disc_beyond(middle) - disc_beyond(mirrored);
    }
    let [b, c] = corner;
    if b * b + c * c >= 1.0 { 0.0 } else { circle_corner(1.0, b, c).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Section areas of the ball, each in closed form by another route, summed by Simpson's rule.
    fn by_sections([a, b, c]: [f64; 3]) -> f64 {
        let n = 20_000;
        let (from, to) = (c.max(-1.0), 1.0);
        let area = |z: f64| {
            let radius = (1.0 - z * z).max(0.0).sqrt();
            if radius == 0.0 { 0.0 } else { radius * radius * disc_beyond([a / radius, b / radius]) }
        };
        let h = (to - from) / n as f64;
        (0..=n)
            .map(|k| {
                let weight = if k == 0 || k == n {
                    1.0
                } else if k % 2 == 1 {
                    4.0
                } else {
                    2.0
                };
                weight * area(from + h * k as f64) * h / 3.0
            })
            .sum()
    }

    fn disc_by_chords([a, b]: [f64; 2]) -> f64 {
        let n = 400_000;
        let from = a.max(-1.0);
        let h = (1.0 - from) / n as f64;
        (0..n)
            .map(|k| {
                let x = from + h * (k as f64 + 0.5);
                let top = (1.0 - x * x).max(0.0).sqrt();
                (top - b.max(-top)).max(0.0) * h
            })
            .sum()
    }

    #[test]
    fn parts_of_balls_and_discs_agree_with_quadrature() {
        for corner in [
            [0.1, 0.2, 0.3],
            [-0.1, 0.2, 0.3],
            [-0.4, -0.2, 0.3],
            [-0.4, -0.5, -0.6],
            [0.5, 0.5, 0.5],
            [0.7, 0.7, 0.7],
            [f64::NEG_INFINITY, -0.3, 0.8],
            [f64::NEG_INFINITY, f64::NEG_INFINITY, 0.4],
        ] {
            let (exact, sum) = (ball_beyond(corner), by_sections(corner));
            assert!((exact - sum).abs() < 2e-6, "{corner:?} {exact} {sum}");
            let plane = [corner[1], corner[2]];
            assert!((disc_beyond(plane) - disc_by_chords(plane)).abs() < 1e-6, "{plane:?}");
        }
        // A cap of height h is pi h²(3 - h)/3; an eighth of the ball.
        let cap = ball_beyond([f64::NEG_INFINITY, 0.25, f64::NEG_INFINITY]);
        assert!((cap - PI * 0.75f64.powi(2) * 2.25 / 3.0).abs() < 1e-14);
        assert!((ball_beyond([0.0; 3]) - PI / 6.0).abs() < 1e-15);
    }

    #[test]
    fn pieces_sum_to_the_grain_wherever_it_is() {
        let planes: Vec<f64> = (1..12).map(|k| 0.31 * f64::from(k)).collect();
        let mut pieces = Pieces::default();
        for shape in [Shape::Sphere, Shape::Disc { thickness: 0.7 }] {
            for transfer in [Transfer::Overlap, Transfer::Kernel { width: 1.5 }] {
                for (k, radius) in [0.1, 0.2, 0.5, 1.1].into_iter().enumerate() {
                    let x = 0.37 * k as f64;
                    let centre = [x + 0.3, 1.3 - x, 3.05];
                    let y: &[f64] = if shape == Shape::Sphere { &planes } else { &[] };
                    pieces.cut(transfer, shape, centre, radius, [&planes, y, &planes]);
                    let (sum, whole) = (pieces.volume.iter().sum::<f64>(), shape.volume(radius));
                    assert!((sum / whole - 1.0).abs() < 1e-13, "{shape:?} {transfer:?} {radius}");
                    assert!(pieces.volume.iter().all(|&v| v == 0.0 || v >= DUST * whole));
                    assert!(pieces.volume.len() > 1);
                }
            }
        }
    }
}
