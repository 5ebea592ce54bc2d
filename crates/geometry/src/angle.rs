//! The angle of a vector in the plane.

/// `atan(t) / t` as a polynomial in `t²`: the interpolant in the Chebyshev points of `t² <= tan²(π/8)`, off by at most
/// `4e-18`.
const ARCTANGENT: [f64; 12] = [
    1.0,
    -0.3333333333333312,
    0.19999999999940893,
    -0.14285714279250245,
    0.11111110744919658,
    -0.09090896809064027,
    0.07692045330902225,
    -0.06662951813629191,
    0.05846878297330872,
    -0.05035102456601552,
    0.03796525745386593,
    -0.017805397205419446,
];

/// The angle of `(x, y)` from the x axis, in `[-π, π]`; zero for the zero vector.
///
/// Within `2^-51` of `f64::atan2` and several times faster, as it is inlined and free of branches; and the same on every
/// machine, which the library function is not.
#[inline(always)]
pub(crate) fn angle(y: f64, x: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, SQRT_2};
    let (a, b) = (x.abs(), y.abs());
    let steep = b > a;
    let (small, large) = if steep { (a, b) } else { (b, a) };
    // Beyond π/8 seen from the diagonal: atan(s/l) = π/4 + atan((s - l)/(s + l)).
    let beyond = small > (SQRT_2 - 1.0) * large;
    let over = if beyond { small - large } else { small };
    let under = if beyond { small + large } else { large };
    let from = if beyond { FRAC_PI_4 } else { 0.0 };
    let t = over / under.max(f64::MIN_POSITIVE);
    let c = ARCTANGENT;
    let z = t * t;
    let (z2, z4) = (z * z, (z * z) * (z * z));
    // Pairs of pairs: a shorter chain than Horner's.
    let quarter = |k: usize| (c[k] + c[k + 1] * z) + (c[k + 2] + c[k + 3] * z) * z2;
    let polynomial = quarter(0) + (quarter(4) + quarter(8) * z4) * z4;
    let angle = from + t * polynomial;
    let angle = if steep { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_library() {
        for k in 0..200_000 {
            let phi = (k as f64 / 100_000.0 - 1.0) * std::f64::consts::PI;
            let size = 10f64.powi(k % 200 - 100);
            let (y, x) = (size * phi.sin(), size * phi.cos());
            let (ours, theirs) = (angle(y, x), y.atan2(x));
            assert!((ours - theirs).abs() <= 2f64.powi(-51) * theirs.abs(), "{ours} {theirs}");
        }
        for (y, x) in
            [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (1e-300, 1e-300), (1e-200, -1e200)]
        {
            assert!((angle(y, x) - f64::atan2(y, x)).abs() <= 2f64.powi(-51), "{y} {x}");
        }
    }
}
