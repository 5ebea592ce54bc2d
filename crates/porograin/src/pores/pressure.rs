//! The pressures: `G p = -Sᵀ (v, spin) + G_D p_D` (Catalano 4.4 corrected), free nodes on the left, held ones on
//! the right.

use super::mesh::{BLOCKED, FREE, Mesh};
use porograin_linear::{Error, FIXED, Info, Matrix, Method, Params, Solver};
use rayon::prelude::*;

/// Gauss-Seidel gives up after so many sweeps; their number grows with that of the grains.
const MOST_SWEEPS: usize = 100_000;
/// Unknowns that are worth a thread.
const SHARE: usize = 4096;

/// The linear system of a mesh.
pub struct System {
    pub(super) matrix: Matrix,
    pub(super) solver: Solver,
    /// The right-hand side; as long as there are unknowns, the first nodes of the mesh.
    pub(super) rhs: Vec<f64>,
    /// Nothing holds a pressure: the last free node is held at zero for the solve, then the mean is taken out.
    pinned: Option<usize>,
    /// The throats to nodes whose pressure is given: the unknown, the node and the conductance [m³/(Pa s)].
    held: Vec<(u32, u32, f64)>,
    /// `V_f / K_f` of each node [m³/Pa]; empty where the water is incompressible.
    pub(super) capacity: Vec<f64>,
    /// The interval of the storage in the matrix [s].
    interval: f64,
    /// What the preconditioner was made for: implicit steps of this kick, or zero for `G` itself [s].
    pub(super) prepared_for: f64,
}

impl System {
    /// Assembles and prepares the solve.
    ///
    /// # Errors
    /// [`Error::Singular`] if some pores are cut off from all others, [`Error::Memory`].
    pub fn new(mesh: &Mesh, method: Method, residual: f64, expected_solves: usize) -> Result<System, Error> {
        System::storing(mesh, method, residual, expected_solves, Vec::new(), f64::INFINITY)
    }

    /// The same of compressible water: `capacity` is `V_f / K_f` of each node [m³/Pa] and `interval` the length of the steps
    /// to prepare for [s]. The matrix is `G + C / interval`.
    ///
    /// # Errors
    /// Those of [`System::new`].
    pub fn storing(
        mesh: &Mesh,
        method: Method,
        residual: f64,
        expected_solves: usize,
        capacity: Vec<f64>,
        interval: f64,
    ) -> Result<System, Error> {
        let closed = mesh.held.iter().all(|held| matches!(*held, FREE | BLOCKED));
        let pinned = mesh.unknowns.checked_sub(1).filter(|_| closed && capacity.is_empty());
        let unknowns = pinned.unwrap_or(mesh.unknowns);
        let end = |node: u32| if (node as usize) < unknowns { node } else { FIXED };
        let ends: Vec<[u32; 2]> = mesh.links.iter().map(|link| link.map(end)).collect();
        let stored = stored(&capacity, unknowns, interval);
        let matrix = Matrix::new(unknowns, &ends, &mesh.conductance, &stored)?;
        let mut position = vec![glam::DVec3::ZERO; unknowns];
        for (pore, &node) in mesh.node.iter().enumerate() {
            if let Some(place) = position.get_mut(node as usize) {
                *place = mesh.centre[pore];
            }
        }
        let mut held = Vec::new();
        // A pinned level is zero.
        for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance).filter(|_| pinned.is_none()) {
            match [i, j].map(end) {
                [FIXED, FIXED] => {}
                [FIXED, v] => held.push((v, i, g)),
                [u, FIXED] => held.push((u, j, g)),
                _ => {}
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
            pinned,
            held,
            capacity,
            interval,
            prepared_for: 0.0,
        })
    }

    /// `V_f / K_f` of each node [m³/Pa]; empty where the water is incompressible.
    pub fn capacity(&self) -> &[f64] {
        &self.capacity
    }

    /// What storage over `interval` [s] adds to the diagonal of the matrix [m³/(Pa s)].
    pub(super) fn stored(&self, interval: f64) -> Vec<f64> {
        stored(&self.capacity, self.rhs.len(), interval)
    }

    /// Sets the length of the step to solve for [s]; compressible water only. The preconditioner serves steps half or twice as
    /// long as those it was `prepared` for, and is made again for others.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn step_over(&mut self, mesh: &Mesh, interval: f64, prepared: &mut f64) -> Result<(), Error> {
        if !(0.5 * *prepared..=2.0 * *prepared).contains(&interval) {
            *prepared = interval;
            let stored = self.stored(interval);
            self.matrix.refresh(&mesh.conductance, &stored)?;
            self.interval = interval;
            return self.solver.refresh(&self.matrix);
        }
        self.set_interval(mesh, interval)
    }

    /// Sets the length of the step in the matrix, not in the preconditioner [s]; nothing where the water is incompressible.
    ///
    /// # Errors
    /// Those of the matrix.
    pub fn set_interval(&mut self, mesh: &Mesh, interval: f64) -> Result<(), Error> {
        if interval == self.interval || self.capacity.is_empty() {
            return Ok(());
        }
        let stored = self.stored(interval);
        self.interval = interval;
        self.matrix.refresh(&mesh.conductance, &stored)
    }

    /// Solves for the pressures of the nodes.
    ///
    /// `carried` is the volume carried out of each node [m³/s]; `pressure` (length nodes) holds the imposed
    /// pressures of held nodes and the start of free ones, and receives the solution [Pa].
    ///
    /// # Errors
    /// Those of the solver.
    pub fn solve(&mut self, mesh: &Mesh, carried: &[f64], pressure: &mut [f64]) -> Result<Info, Error> {
        self.begin(carried, pressure);
        let info = self.solver.solve(&self.matrix, &self.rhs, &mut pressure[..self.rhs.len()])?;
        self.end(mesh, pressure);
        Ok(info)
    }

    /// Makes the right-hand side `-carried + G_D p_D`, and a start of the pressures.
    pub(super) fn begin(&mut self, carried: &[f64], pressure: &mut [f64]) {
        if let Some(pinned) = self.pinned {
            let level = pressure[pinned];
            pressure[..=pinned].iter_mut().for_each(|p| *p -= level);
        }
        let both = self.rhs.par_iter_mut().zip(carried).with_min_len(SHARE);
        both.for_each(|(rhs, carried)| *rhs = -carried);
        for &(unknown, node, g) in &self.held {
            self.rhs[unknown as usize] += g * pressure[node as usize];
        }
    }

    /// Gives the pressures found a level where nothing else does.
    pub(super) fn end(&self, mesh: &Mesh, pressure: &mut [f64]) {
        if self.pinned.is_some() {
            take_out_mean(mesh, pressure);
        }
    }

    /// Whether the level of the pressures is free: their mean is then set to zero.
    pub fn free_level(&self) -> bool {
        self.pinned.is_some()
    }

    /// Sets the relative residual at which solves stop.
    pub fn set_residual(&mut self, residual: f64) {
        self.solver.params_mut().tolerance = residual;
    }

    /// Bytes, entries and seconds of the set-up.
    pub fn setup(&self) -> porograin_linear::Setup {
        self.solver.setup()
    }
}

/// Makes the mean over the volume of the free nodes zero.
fn take_out_mean(mesh: &Mesh, pressure: &mut [f64]) {
    let (mut sum, mut volume) = (0.0, 0.0);
    for (pore, &node) in mesh.node.iter().enumerate() {
        if mesh.held[node as usize] == FREE {
            sum += mesh.volume[pore] * pressure[node as usize];
            volume += mesh.volume[pore];
        }
    }
    for (pressure, held) in pressure.iter_mut().zip(&mesh.held) {
        if *held == FREE {
            *pressure -= sum / volume;
        }
    }
}

/// What storage adds to the diagonal of each unknown [m³/(Pa s)].
fn stored(capacity: &[f64], unknowns: usize, interval: f64) -> Vec<f64> {
    let mut stored: Vec<f64> = capacity.iter().take(unknowns).map(|capacity| capacity / interval).collect();
    stored.resize(unknowns, 0.0);
    stored
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("System")
            .field("unknowns", &self.rhs.len())
            .field("pinned", &self.pinned)
            .finish_non_exhaustive()
    }
}
