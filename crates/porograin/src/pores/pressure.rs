//! The pressures: `G p = -Sᵀ (v, spin) + G_D p_D` (Catalano 4.4 corrected), free nodes on the left, held ones on
//! the right.

use super::mesh::Mesh;
use porograin_linear::{Error, FIXED, Info, Matrix, Method, Params, Solver};

/// Gauss-Seidel gives up after so many sweeps; their number grows with that of the grains.
const MOST_SWEEPS: usize = 100_000;

/// The linear system of a mesh.
pub struct System {
    pub(super) matrix: Matrix,
    pub(super) solver: Solver,
    pub(super) rhs: Vec<f64>,
    pub(super) free: Vec<f64>,
    /// No face holds a pressure: one node is held at zero for the solve, then the mean is taken out.
    pinned: bool,
    pub(super) unknown: Vec<u32>,
    /// What the preconditioner was made for: implicit steps of this kick, or zero for `G` itself [s].
    pub(super) prepared_for: f64,
}

impl System {
    /// Assembles and prepares the solve.
    ///
    /// # Errors
    /// [`Error::Singular`] if some pores are cut off from all others, [`Error::Memory`].
    pub fn new(mesh: &Mesh, method: Method, residual: f64, expected_solves: usize) -> Result<System, Error> {
        let pinned = mesh.unknowns == mesh.nodes();
        let mut unknown = mesh.unknown.clone();
        if pinned && !unknown.is_empty() {
            unknown[0] = FIXED;
            unknown[1..].iter_mut().for_each(|u| *u -= 1);
        }
        let unknowns = mesh.unknowns - usize::from(pinned && !unknown.is_empty());
        let ends: Vec<[u32; 2]> = mesh.links.iter().map(|link| link.map(|n| unknown[n as usize])).collect();
        let matrix = Matrix::new(unknowns, &ends, &mesh.conductance, &vec![0.0; unknowns])?;
        let mut position = vec![glam::DVec3::ZERO; unknowns];
        for (pore, &node) in mesh.node.iter().enumerate() {
            if let Some(place) = position.get_mut(unknown[node as usize] as usize) {
                *place = mesh.centre[pore];
            }
        }
        let mut params = Params { method, tolerance: residual, expected_solves, ..Params::default() };
        if method == Method::GaussSeidel {
            params.max_iterations = MOST_SWEEPS;
        }
        let solver = Solver::new(&matrix, &params, Some(&position))?;
        Ok(System {
            matrix,
            solver,
            rhs: vec![0.0; unknowns],
            free: vec![0.0; unknowns],
            pinned,
            unknown,
            prepared_for: 0.0,
        })
    }

    /// Solves for the pressures of the nodes.
    ///
    /// `carried` is the volume carried out of each node [m³/s]; `pressure` (length nodes) holds the imposed
    /// pressures of held nodes and the start of free ones, and receives the solution [Pa].
    ///
    /// # Errors
    /// Those of the solver.
    pub fn solve(&mut self, mesh: &Mesh, carried: &[f64], pressure: &mut [f64]) -> Result<Info, Error> {
        self.gather(mesh, carried, pressure);
        let info = self.solver.solve(&self.matrix, &self.rhs, &mut self.free)?;
        self.scatter(mesh, pressure);
        Ok(info)
    }

    /// The right-hand side `-carried + G_D p_D` and the start of a solve from the pressures of all nodes.
    pub(super) fn gather(&mut self, mesh: &Mesh, carried: &[f64], pressure: &[f64]) {
        let level = if self.pinned { pressure.first().copied().unwrap_or(0.0) } else { 0.0 };
        for (node, &unknown) in self.unknown.iter().enumerate() {
            if unknown != FIXED {
                self.rhs[unknown as usize] = -carried[node];
                self.free[unknown as usize] = pressure[node] - level;
            }
        }
        if !self.pinned {
            for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance) {
                let [u, v] = [self.unknown[i as usize], self.unknown[j as usize]];
                if u == FIXED && v != FIXED {
                    self.rhs[v as usize] += g * pressure[i as usize];
                } else if v == FIXED && u != FIXED {
                    self.rhs[u as usize] += g * pressure[j as usize];
                }
            }
        }
    }

    /// The solution, back to the nodes.
    pub(super) fn scatter(&self, mesh: &Mesh, pressure: &mut [f64]) {
        for (node, &unknown) in self.unknown.iter().enumerate() {
            if unknown != FIXED {
                pressure[node] = self.free[unknown as usize];
            }
        }
        if self.pinned {
            self.take_out_mean(mesh, pressure);
        }
    }

    fn take_out_mean(&self, mesh: &Mesh, pressure: &mut [f64]) {
        if let Some(first) = pressure.first_mut() {
            *first = 0.0;
        }
        let (mut sum, mut volume) = (0.0, 0.0);
        for (pore, &node) in mesh.node.iter().enumerate() {
            sum += mesh.volume[pore] * pressure[node as usize];
            volume += mesh.volume[pore];
        }
        pressure.iter_mut().for_each(|p| *p -= sum / volume);
    }

    /// Bytes, entries and seconds of the set-up.
    pub fn setup(&self) -> porograin_linear::Setup {
        self.solver.setup()
    }
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("System")
            .field("unknowns", &self.rhs.len())
            .field("pinned", &self.pinned)
            .finish_non_exhaustive()
    }
}
