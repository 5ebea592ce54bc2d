//! What can go wrong, each with one sentence.

use std::fmt;

/// Why a matrix was refused or a system not solved.
#[derive(Clone, Debug, PartialEq)]
pub enum Error {
    /// An array has the wrong length.
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length it should have.
        expected: usize,
    },
    /// A throat names a node that does not exist.
    Node {
        /// Index of the throat.
        throat: usize,
        /// The node it names.
        node: u32,
    },
    /// An input value is not finite, or negative where that is not allowed.
    Value {
        /// Which array.
        what: &'static str,
        /// Index in that array.
        index: usize,
        /// The value found.
        value: f64,
    },
    /// The matrix is not the one the solver was made for: its pattern differs.
    Pattern,
    /// The factorisation met a pivot that is not positive, or the iteration a direction of no energy (`node` is
    /// then unknown).
    NotPositive {
        /// The node whose pivot failed.
        node: Option<u32>,
    },
    /// A connected set of nodes has nothing on its diagonal beyond its throats: its level is undetermined.
    Singular {
        /// The nodes of one such set, in increasing order.
        nodes: Vec<u32>,
    },
    /// The residual did not reach the tolerance.
    NotConverged {
        /// Iterations spent.
        iterations: usize,
        /// `‖b - A x‖ / max(‖b‖, floor)` where it stopped.
        residual: f64,
    },
    /// The factor does not fit in memory or in the index type.
    Memory,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Length { what, found, expected } => {
                write!(f, "the {what} array has {found} entries where {expected} are needed")
            }
            Error::Node { throat, node } => {
                write!(f, "throat {throat} names node {node}, which does not exist")
            }
            Error::Value { what, index, value } => {
                write!(f, "entry {index} of the {what} array is {value}: it must be finite")?;
                if *value < 0.0 { write!(f, " and not negative") } else { Ok(()) }
            }
            Error::Pattern => {
                write!(f, "the matrix has another pattern than the one the solver was made for")
            }
            Error::NotPositive { node: Some(node) } => {
                write!(f, "the matrix is not positive definite: the pivot of node {node} is not positive")
            }
            Error::NotPositive { node: None } => {
                write!(f, "the matrix or the preconditioner is not positive definite")
            }
            Error::Singular { nodes } => write!(
                f,
                "{} connected nodes (the first is {}) have no held pressure and no compressibility, so their \
                 pressure is undetermined",
                nodes.len(),
                nodes.first().copied().unwrap_or(0)
            ),
            Error::NotConverged { iterations, residual } => {
                write!(f, "the residual is still {residual:.3e} after {iterations} iterations")
            }
            Error::Memory => write!(f, "the Cholesky factor does not fit in memory; use conjugate gradients"),
        }
    }
}

impl std::error::Error for Error {}
