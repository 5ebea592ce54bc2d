//! One solver for every method: set-up apart from solve, the pattern's share of the set-up apart from the values'.

use crate::cholesky::Cholesky;
use crate::gauss_seidel::gauss_seidel;
use crate::multigrid::Multigrid;
use crate::vector::Sums;
use crate::{Error, Matrix, Operator, Preconditioner, Work, components, conjugate_gradients};
use glam::DVec3;
use std::time::Instant;

/// How to solve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Whatever the number of nodes and of expected solves makes cheapest.
    #[default]
    Auto,
    /// Conjugate gradients on a Cholesky factor: one iteration.
    Cholesky,
    /// Conjugate gradients on a multigrid cycle.
    ConjugateGradients,
    /// Over-relaxed Gauss-Seidel sweeps, for comparison with the thesis.
    GaussSeidel,
}

impl Method {
    /// What [`Method::Auto`] stands for with so many nodes and so many solves expected before the pattern changes; others stand for
    /// themselves.
    pub fn for_size(self, nodes: usize, expected_solves: usize) -> Method {
        match self {
            Method::Auto if nodes <= AUTO_CHOLESKY && expected_solves >= AUTO_SOLVES => Method::Cholesky,
            Method::Auto => Method::ConjugateGradients,
            method => method,
        }
    }
}

/// As case files and the command line spell it.
impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Method::Auto => "auto",
            Method::Cholesky => "cholesky",
            Method::ConjugateGradients => "cg",
            Method::GaussSeidel => "gauss-seidel",
        })
    }
}

/// Choices of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// How to solve.
    pub method: Method,
    /// Stop at `‖b - A x‖ ≤ tolerance max(‖b‖, floor)` (Euclidean norms).
    pub tolerance: f64,
    /// The size of right-hand side below which nothing matters, in its unit.
    pub floor: f64,
    /// Give up after this many iterations (sweeps for Gauss-Seidel).
    pub max_iterations: usize,
    /// Solves expected before the pattern changes; weighs the set-up in [`Method::Auto`].
    pub expected_solves: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            method: Method::Auto,
            tolerance: 1e-8,
            floor: 0.0,
            max_iterations: 1000,
            expected_solves: 100,
        }
    }
}

/// What a solve did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Info {
    /// The method used; never [`Method::Auto`] from a [`Solver`].
    pub method: Method,
    /// Iterations; zero if the start was good enough.
    pub iterations: usize,
    /// The residual `‖b - A x‖ / max(‖b‖, floor)`.
    pub residual: f64,
}

/// What the set-up made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// The method chosen.
    pub method: Method,
    /// Entries of the factor, or of all levels of the multigrid.
    pub entries: usize,
    /// Bytes held beside the matrix.
    pub bytes: usize,
    /// Wall-clock seconds the last `new` or `refresh` took.
    pub seconds: f64,
}

/// Largest number of nodes [`Method::Auto`] factors. At 690 nodes pressures took 0.37 s with a factor of the matrix and 0.43 s with multigrid,
/// whose network of clusters is factored, at 2000 2.62 and 2.60 s, at 5300 16.3 and 15.2 s; in implicit steps 0.42 and 0.40, 1.69 and 1.54, 7.9 and 6.5 s.
const AUTO_CHOLESKY: usize = 2_000;
/// Fewer expected solves than this do not repay a factorisation: at 190 000 nodes it takes some 3 s, a multigrid solve to 1e-10 with
/// its set-up 0.3 s.
const AUTO_SOLVES: usize = 100;

/// Over-relaxation of [`Method::GaussSeidel`].
const RELAXATION: f64 = 1.9;

enum Machine {
    Cholesky(Box<Cholesky>),
    Multigrid(Box<Multigrid>),
    GaussSeidel,
}

/// A prepared solve of matrices of one pattern.
pub struct Solver {
    params: Params,
    nodes: usize,
    entries: usize,
    machine: Machine,
    /// Positions of the nodes for the next multigrid, which orders its elimination anew; empty where there is none to order.
    positions: Vec<DVec3>,
    work: Work,
    seconds: f64,
}

impl Solver {
    /// Prepares for `matrix`. Positions of the nodes (length n), where known, order the elimination.
    ///
    /// # Errors
    /// [`Error::Singular`] if a connected set of nodes has no row sum above zero; [`Error::NotPositive`];
    /// [`Error::Memory`]; [`Error::Length`].
    pub fn new(matrix: &Matrix, params: &Params, positions: Option<&[DVec3]>) -> Result<Solver, Error> {
        let clock = Instant::now();
        let n = matrix.nodes();
        if let Some(positions) = positions
            && positions.len() != n
        {
            return Err(Error::Length { what: "positions", found: positions.len(), expected: n });
        }
        refuse_singular(matrix)?;
        let method = params.method.for_size(n, params.expected_solves);
        // To order the elimination in multigrid, where that will pay.
        let positions =
            positions.filter(|_| method == Method::Cholesky || params.expected_solves >= AUTO_SOLVES);
        let machine = match method {
            Method::Cholesky => Machine::Cholesky(Box::new(Cholesky::new(matrix, positions)?)),
            Method::GaussSeidel => Machine::GaussSeidel,
            _ => Machine::Multigrid(Box::new(Multigrid::new(matrix, positions))),
        };
        Ok(Solver {
            positions: match positions {
                Some(positions) if method == Method::ConjugateGradients => positions.to_vec(),
                _ => Vec::new(),
            },
            params: Params { method, ..*params },
            nodes: n,
            entries: matrix.columns().len(),
            machine,
            work: Work::default(),
            seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// Prepares for new values on the same pattern.
    ///
    /// # Errors
    /// As [`Solver::new`], and [`Error::Pattern`].
    pub fn refresh(&mut self, matrix: &Matrix) -> Result<(), Error> {
        let clock = Instant::now();
        self.expect(matrix)?;
        refuse_singular(matrix)?;
        match &mut self.machine {
            Machine::Cholesky(cholesky) => cholesky.refresh(matrix)?,
            Machine::Multigrid(multigrid) => {
                **multigrid =
                    Multigrid::new(matrix, (!self.positions.is_empty()).then_some(&*self.positions));
            }
            Machine::GaussSeidel => {}
        }
        self.seconds = clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// Solves `matrix x = b`, starting from `x`. The matrix may have moved away from the one of the last refresh:
    /// the answer is as exact, for some more iterations.
    ///
    /// # Errors
    /// As [`conjugate_gradients`], and [`Error::Pattern`].
    pub fn solve(&mut self, matrix: &Matrix, b: &[f64], x: &mut [f64]) -> Result<Info, Error> {
        self.expect(matrix)?;
        match self.machine {
            Machine::GaussSeidel => gauss_seidel(matrix, RELAXATION, b, x, &self.params),
            _ => self.solve_operator(&mut &*matrix, b, x),
        }
    }

    /// Solves with an operator near the matrix of the last refresh, that matrix serving as preconditioner.
    ///
    /// # Errors
    /// As [`conjugate_gradients`].
    pub fn solve_operator(
        &mut self,
        operator: &mut impl Operator,
        b: &[f64],
        x: &mut [f64],
    ) -> Result<Info, Error> {
        let Solver { params, machine, work, .. } = self;
        conjugate_gradients(operator, machine, b, x, params, work)
    }

    /// What the set-up made.
    pub fn setup(&self) -> Setup {
        let (entries, bytes) = match &self.machine {
            Machine::Cholesky(cholesky) => (cholesky.entries(), cholesky.bytes()),
            Machine::Multigrid(multigrid) => (multigrid.entries(), multigrid.bytes()),
            Machine::GaussSeidel => (0, 0),
        };
        Setup { method: self.params.method, entries, bytes, seconds: self.seconds }
    }

    /// The parameters; the tolerance, the floor and the iteration limit may be changed between solves.
    pub fn params_mut(&mut self) -> &mut Params {
        &mut self.params
    }

    fn expect(&self, matrix: &Matrix) -> Result<(), Error> {
        if matrix.nodes() == self.nodes && matrix.columns().len() == self.entries {
            Ok(())
        } else {
            Err(Error::Pattern)
        }
    }
}

/// One application approximates the inverse of the matrix of the last refresh.
impl Preconditioner for Solver {
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], sums: &mut Sums) -> f64 {
        self.machine.apply(r, size, z, sums)
    }
}

impl Preconditioner for Machine {
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], sums: &mut Sums) -> f64 {
        match self {
            Machine::Cholesky(cholesky) => cholesky.apply(r, size, z, sums),
            Machine::Multigrid(multigrid) => multigrid.apply(r, size, z, sums),
            Machine::GaussSeidel => {
                z.copy_from_slice(r);
                size * size
            }
        }
    }
}

fn refuse_singular(matrix: &Matrix) -> Result<(), Error> {
    let found = components(matrix);
    match found.anchored.iter().position(|held| !held) {
        None => Ok(()),
        Some(label) => {
            let nodes =
                (0..matrix.nodes() as u32).filter(|&i| found.of[i as usize] == label as u32).collect();
            Err(Error::Singular { nodes })
        }
    }
}
