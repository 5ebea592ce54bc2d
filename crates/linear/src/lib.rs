//! Solves `A x = b` for the sparse symmetric positive definite matrices of pore networks: the graph Laplacian of
//! the throats' conductances plus a nonnegative diagonal (pores held at a pressure, compressibility).
//!
//! Every method is a preconditioner of the same conjugate gradient loop, so they share one stopping rule and one
//! kind of answer: [`Method::Cholesky`] (nested dissection, supernodal factor), [`Method::ConjugateGradients`]
//! (multigrid) and [`Method::GaussSeidel`] (the baseline of Catalano's thesis).
//!
//! ```
//! use porograin_linear::{FIXED, Matrix, Params, Solver};
//! // Three pores in a row between two held pressures: 1 at the left end, 0 at the right end.
//! let throats = [[0, FIXED], [0, 1], [1, 2], [2, FIXED]];
//! let matrix = Matrix::new(3, &throats, &[1.0; 4], &[0.0; 3])?;
//! let mut solver = Solver::new(&matrix, &Params::default(), None)?;
//! let mut pressure = [0.0; 3];
//! solver.solve(&matrix, &[1.0, 0.0, 0.0], &mut pressure)?;
//! assert!((pressure[0] - 0.75).abs() < 1e-7);
//! # Ok::<(), porograin_linear::Error>(())
//! ```

mod aggregate;
mod cholesky;
mod clusters;
mod conjugate_gradients;
mod eight;
mod error;
mod finest;
mod fours;
mod gauss_seidel;
mod matrix;
mod multigrid;
mod order;
mod packed;
mod solver;
mod vector;

pub use conjugate_gradients::{Operator, Preconditioner, Work, conjugate_gradients};
pub use error::Error;
pub use matrix::{Components, FIXED, Matrix, components};
pub use solver::{Info, Method, Params, Setup, Solver};
pub use vector::Sums;
