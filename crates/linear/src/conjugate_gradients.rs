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

    /// `r = b - A x`, returning `r · r`; `sums` is room for sums over chunks.
    fn residual(&mut self, b: &[f64], x: &[f64], r: &mut [f64], sums: &mut Vec<[f64; 2]>) -> f64 {
        self.apply(x, r);
        vector::residual(b, r, sums)
    }

    /// `q = A p`, returning `p · q`; `sums` is room for sums over chunks.
    fn apply_dot(&mut self, p: &[f64], q: &mut [f64], sums: &mut Vec<[f64; 2]>) -> f64 {
        self.apply(p, q);
        vector::dot(p, q, sums)
    }
}

/// An approximate inverse of an operator, symmetric positive definite up to rounding.
pub trait Preconditioner {
    /// `z = M⁻¹ r`; both of length n, every entry of `z` written.
    fn apply(&mut self, r: &[f64], z: &mut [f64]);
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

    let size = vector::dot(b, b, sums).sqrt();
    let scale = size.max(params.floor);
    if !size.is_finite() {
        check_finite(b, x)?;
    }
    if scale == 0.0 {
        x.fill(0.0);
        return Ok(Info { method: params.method, iterations: 0, residual: 0.0 });
    }
    let target = params.tolerance * scale;
    let mut iterations = 0;
    let mut last = f64::INFINITY;
    let mut restarts = 0;
    loop {
        let mut norm = operator.residual(b, x, r, sums).sqrt();
        if !norm.is_finite() || !scale.is_finite() {
            check_finite(b, x)?;
            return Err(Error::NotPositive { node: None });
        }
        if norm <= target {
            return Ok(Info { method: params.method, iterations, residual: norm / scale });
        }
        restarts += usize::from(norm > 0.5 * last);
        if iterations >= params.max_iterations || restarts > RESTARTS {
            return Err(Error::NotConverged { iterations, residual: norm / scale });
        }
        last = norm;

        preconditioner.apply(r, p);
        let mut rz = vector::dot(p, r, sums);
        while norm > target && iterations < params.max_iterations {
            let pq = operator.apply_dot(p, q, sums);
            if !(rz > 0.0 && pq > 0.0) {
                return Err(Error::NotPositive { node: None });
            }
            let alpha = rz / pq;
            norm = vector::advance(alpha, p, q, x, r, sums).sqrt();
            iterations += 1;
            if norm <= target {
                if params.tolerance >= LOOSE && iterations <= RESTARTS {
                    return Ok(Info { method: params.method, iterations, residual: norm / scale });
                }
                break;
            }
            preconditioner.apply(r, z);
            let [zr, zq] = vector::dots(z, r, q, sums);
            // z·(r - r_old) = -alpha z·q: Polak-Ribière, which forgives an inexact preconditioner.
            let beta = -alpha * zq / rz;
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
