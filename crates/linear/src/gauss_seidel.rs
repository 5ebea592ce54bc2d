//! The thesis' baseline.

use crate::conjugate_gradients::check_input;
use crate::{Error, Info, Matrix, Params};

/// Successive over-relaxation in the order of the nodes until `‖b - A x‖ ≤ tolerance max(‖b‖, floor)`, the
/// residual looked at every tenth sweep.
pub fn gauss_seidel(
    matrix: &Matrix,
    relaxation: f64,
    b: &[f64],
    x: &mut [f64],
    params: &Params,
) -> Result<Info, Error> {
    let n = matrix.nodes();
    check_input(n, b, x)?;
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>().sqrt();
    let scale = norm(&mut b.iter().copied()).max(params.floor);
    if scale == 0.0 {
        x.fill(0.0);
    }
    let mut iterations = 0;
    loop {
        let residual =
            norm(&mut (0..n).map(|i| b[i] - matrix.diagonal()[i] * x[i] - neighbours(matrix, i, x)));
        if residual <= params.tolerance * scale {
            let residual = if scale > 0.0 { residual / scale } else { 0.0 };
            return Ok(Info { method: params.method, iterations, residual });
        }
        if iterations >= params.max_iterations || !residual.is_finite() {
            return Err(Error::NotConverged { iterations, residual: residual / scale });
        }
        for _ in 0..10 {
            for i in 0..n {
                let settled = (b[i] - neighbours(matrix, i, x)) / matrix.diagonal()[i];
                x[i] += relaxation * (settled - x[i]);
            }
        }
        iterations += 10;
    }
}

/// `sum_j A_ij x_j` off the diagonal.
#[inline]
fn neighbours(matrix: &Matrix, i: usize, x: &[f64]) -> f64 {
    let (columns, values) = matrix.row(i);
    columns.iter().zip(values).map(|(&j, a)| a * x[j as usize]).sum()
}
