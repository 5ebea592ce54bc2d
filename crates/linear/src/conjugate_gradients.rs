//! Flexible preconditioned conjugate gradients (Notay 2000): any preconditioner that is nearly symmetric positive
//! serves, be it a stale or single-precision factor or a multigrid cycle.

use crate::vector::{self, Sums};
use crate::{Error, Info, Params};

/// A symmetric positive definite operator that may exist only as its product.
pub trait Operator {
    /// Number of unknowns n.
    fn nodes(&self) -> usize;
    /// `y = A x`; both of length n, every entry of `y` written.
    fn apply(&mut self, x: &[f64], y: &mut [f64]);

    /// `r = b - A x`, returning `[r · r, b · b]`; `sums` is room for sums over chunks.
    fn residual(&mut self, b: &[f64], x: &[f64], r: &mut [f64], sums: &mut Sums) -> [f64; 2] {
        self.apply(x, r);
        vector::residual(b, r, sums)
    }

    /// `q = A p`, returning `[p · q, r · q, q · q]`; `sums` is room for sums over chunks.
    fn apply_dots(&mut self, p: &[f64], r: &[f64], q: &mut [f64], sums: &mut Sums) -> [f64; 3] {
        self.apply(p, q);
        vector::three_dots(p, r, q, sums)
    }
}

/// An approximate inverse of an operator, symmetric positive definite up to rounding.
pub trait Preconditioner {
    /// `z = M⁻¹ r`, returning `z · r`; both of length n, every entry of `z` written. `size` is the norm of `r`; `sums` is room
    /// for sums over chunks.
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], sums: &mut Sums) -> f64;
}

/// Scratch vectors; kept between solves so that a settled solve allocates nothing.
#[derive(Clone, Debug, Default)]
pub struct Work {
    r: Vec<f64>,
    z: Vec<f64>,
    p: Vec<f64>,
    q: Vec<f64>,
    sums: Sums,
}

/// The residual kept by recurrence drifts from the true one; after this many corrections without gain, give up.
const RESTARTS: usize = 4;

/// From this tolerance on the residual kept by recurrence counts: over the iterations it takes, rounding moves it by `‖A‖ ‖x‖`
/// times 10⁻¹⁶ each, far below. Tighter, the residual is computed again before success is declared.
const LOOSE: f64 = 1e-7;

/// The norm of the next residual is known from products with this one before it is computed, unless it is smaller by more than this.
const FORESEEN: f64 = 1e-6;

/// Solves `A x = b` from the start in `x` until `‖b - A x‖ ≤ tolerance max(‖b‖, floor)` (Euclidean norms).
///
/// A start that already satisfies this costs one product and no iteration.
///
/// # Errors
/// [`Error::Length`]; [`Error::Value`] if `b` or `x` is not finite; [`Error::NotPositive`];
/// [`Error::NotConverged`], with the last iterate in `x`.
pub fn conjugate_gradients(
    operator: &mut impl Operator,
    preconditioner: &mut impl Preconditioner,
    b: &[f64],
    x: &mut [f64],
    params: &Params,
    work: &mut Work,
) -> Result<Info, Error> {
    let n = operator.nodes();
    check_lengths(n, b, x)?;
    let Work { r, z, p, q, sums } = work;
    for v in [&mut *r, z, p, q] {
        v.resize(n, 0.0);
    }

    let mut iterations = 0;
    let mut last = f64::INFINITY;
    let mut restarts = 0;
    loop {
        let [mut rr, bb] = operator.residual(b, x, r, sums);
        let (mut norm, scale) = (rr.sqrt(), bb.sqrt().max(params.floor));
        if !norm.is_finite() || !bb.is_finite() || !scale.is_finite() {
            check_finite(b, x)?;
            return Err(Error::NotPositive { node: None });
        }
        if scale == 0.0 {
            x.fill(0.0);
            return Ok(Info { method: params.method, iterations: 0, residual: 0.0 });
        }
        let target = params.tolerance * scale;
        if norm <= target {
            return Ok(Info { method: params.method, iterations, residual: norm / scale });
        }
        restarts += usize::from(norm > 0.5 * last);
        if iterations >= params.max_iterations || restarts > RESTARTS {
            return Err(Error::NotConverged { iterations, residual: norm / scale });
        }
        last = norm;

        let mut rz = preconditioner.apply(r, norm, p, sums);
        while norm > target && iterations < params.max_iterations {
            let [pq, rq, qq] = operator.apply_dots(p, r, q, sums);
            if !(rz > 0.0 && pq > 0.0) {
                return Err(Error::NotPositive { node: None });
            }
            let alpha = rz / pq;
            iterations += 1;
            // `‖r - a q‖`: where that is small enough already, nobody needs the residual itself. `a = r·q / q·q` leaves the least of it,
            // some ten percent less than `alpha`, which leaves the least error in energy.
            let left = |a: f64| (rr - 2.0 * a * rq + a * a * qq).max(0.0).sqrt();
            let last_step = if left(alpha) <= target { alpha } else { rq / qq };
            let next = left(last_step);
            if next <= target && target >= FORESEEN * norm {
                vector::add(last_step, p, x);
                if params.tolerance >= LOOSE && iterations <= RESTARTS {
                    return Ok(Info { method: params.method, iterations, residual: next / scale });
                }
                break;
            }
            rr = vector::advance(alpha, p, q, x, r, sums);
            norm = rr.sqrt();
            if norm <= target {
                break;
            }
            let zr = preconditioner.apply(r, norm, z, sums);
            // z·(r - r_old) = -alpha z·q: Polak-Ribière, which forgives an inexact preconditioner.
            let beta = -alpha * vector::dot(z, q, sums) / rz;
            rz = zr;
            vector::direction(beta, z, p);
        }
    }
}

fn check_lengths(n: usize, b: &[f64], x: &[f64]) -> Result<(), Error> {
    for (what, found) in [("right-hand side", b.len()), ("solution", x.len())] {
        if found != n {
            return Err(Error::Length { what, found, expected: n });
        }
    }
    Ok(())
}

fn check_finite(b: &[f64], x: &[f64]) -> Result<(), Error> {
    for (what, array) in [("right-hand side", b), ("start", x)] {
        if let Some(index) = array.iter().position(|v| !v.is_finite()) {
            return Err(Error::Value { what, index, value: array[index] });
        }
    }
    Ok(())
}

/// Refuses a right-hand side or a start of the wrong length or with an entry that is not finite.
pub fn check_input(n: usize, b: &[f64], x: &[f64]) -> Result<(), Error> {
    check_lengths(n, b, x)?;
    check_finite(b, x)
}
