//! The permeability tensor of a periodic packing: steady flow under a macroscopic pressure gradient (Marzougui §2.6).

use super::{PermeabilityError, Seconds, meshed, outflow};
use crate::boundary::Slip;
use crate::grains::{Loads, sphere_volume};
use crate::pores::mesh::{Mesh, Walls};
use crate::pores::{Conductance, Coupling, Solver, System};
use glam::{DMat3, DVec3};
use porograin_geometry::throat::Packing;
use porograin_geometry::{Cell, Period};
use std::time::Instant;

/// What is left over in a pore may be this part of the largest flux through any before a solution counts as one.
const BALANCE: f64 = 1e-12;
/// Rounding ends the refinement long before.
const MAX_REFINEMENTS: usize = 4;

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodicProblem {
    /// How much the pressure falls along each axis in turn [Pa/m].
    pub slope: f64,
    /// Dynamic viscosity [Pa s].
    pub viscosity: f64,
    /// How a throat conducts.
    pub conductance: Conductance,
    /// How the forces on the grains are shared.
    pub coupling: Coupling,
    /// How to solve.
    pub solver: Solver,
    /// Relative residual of the solve.
    pub residual: f64,
}

/// The flow under one gradient.
#[derive(Clone, Debug)]
pub struct Flow {
    /// The macroscopic pressure gradient [Pa/m].
    pub gradient: DVec3,
    /// Flux per area of the whole section [m/s].
    pub mean_velocity: DVec3,
    /// Fluid force and torque on each grain [N, N m].
    pub loads: Loads,
    /// Sum of the forces on the grains [N]: `-gradient V`.
    pub force_sum: DVec3,
    /// What is left over in the worst node, over the largest flux through any [-].
    pub imbalance: f64,
    /// Relative residual of the pressure solve.
    pub residual: f64,
    /// Iterations of the pressure solve.
    pub iterations: usize,
    /// Pressure of each node [Pa]. Its level is free; it is fixed such that the pressure less
    /// `gradient·(place - low corner)` has the mean zero over the pores.
    pub pressure: Vec<f64>,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct PeriodicOutcome {
    /// `k` of `mean velocity = -(k / mu) gradient` [m²]: symmetric, positive definite.
    pub tensor: DMat3,
    /// Void volume over the cell [-].
    pub porosity: f64,
    /// The flows along x, y and z.
    pub flows: [Flow; 3],
    /// The grains, taken into the cell [m].
    pub position: Vec<DVec3>,
    /// The pores.
    pub mesh: Mesh,
    /// Wall-clock seconds.
    pub seconds: Seconds,
}

/// Solves the steady flow along x, y and z in a cell that is periodic along all its edges.
///
/// # Errors
/// [`PermeabilityError`].
pub fn measure_periodic(
    cell: &Cell,
    position: &[DVec3],
    radius: &[f64],
    problem: &PeriodicProblem,
) -> Result<PeriodicOutcome, PermeabilityError> {
    let inside = |x: &DVec3| Period::of(cell).map_or(*x, |period| *x - period.shift(period.beyond(*x)));
    let position: Vec<DVec3> = position.iter().map(inside).collect();
    let packing = Packing { cell, position: &position, radius };
    let walls = Walls { open: [false; 6], slip: [Slip::Symmetry; 6] };
    let (mesh, mut seconds) =
        meshed(packing, &walls, problem.conductance, problem.coupling, problem.viscosity)?;
    let clock = Instant::now();
    let mut system = System::new(&mesh, problem.solver.method(), problem.residual, 3)
        .map_err(|error| PermeabilityError::solve(error, &mesh))?;
    let mut flow =
        |axis: usize| flow(packing, &mesh, &mut system, DVec3::ZERO - problem.slope * DVec3::AXES[axis]);
    let flows = [flow(0)?, flow(1)?, flow(2)?];
    seconds.solve = clock.elapsed().as_secs_f64();
    let per_slope = problem.viscosity / problem.slope;
    let solid: f64 = radius.iter().map(|&r| sphere_volume(r)).sum();
    Ok(PeriodicOutcome {
        tensor: per_slope
            * DMat3::from_cols(flows[0].mean_velocity, flows[1].mean_velocity, flows[2].mean_velocity),
        porosity: 1.0 - solid / cell.volume(),
        flows,
        mesh,
        seconds,
        position,
    })
}

fn flow(
    packing: Packing,
    mesh: &Mesh,
    system: &mut System,
    gradient: DVec3,
) -> Result<Flow, PermeabilityError> {
    let mut source = Vec::new();
    mesh.add_gradient_sources(gradient, &mut source);
    let mut pressure = vec![0.0; mesh.nodes()];
    let mut carried: Vec<f64> = source.iter().map(|s| -s).collect();
    let mut info = system.solve(mesh, &carried, &mut pressure).map_err(PermeabilityError::Solve)?;
    let mut imbalance = left_over(mesh, &source, gradient, &pressure, &mut carried);
    for _ in 0..MAX_REFINEMENTS {
        if imbalance <= BALANCE {
            break;
        }
        let mut correction = vec![0.0; mesh.nodes()];
        let refined = system.solve(mesh, &carried, &mut correction).map_err(PermeabilityError::Solve)?;
        info.iterations += refined.iterations;
        pressure.iter_mut().zip(&correction).for_each(|(p, c)| *p += c);
        imbalance = left_over(mesh, &source, gradient, &pressure, &mut carried);
    }
    fix_level(packing.cell, mesh, gradient, &mut pressure);
    let mut loads = Loads::default();
    loads.clear(packing.position.len());
    mesh.add_loads(&pressure, &mut loads);
    mesh.add_gradient_loads(gradient, &mut loads);
    Ok(Flow {
        gradient,
        mean_velocity: mesh.crossing_flux(gradient, &pressure) / packing.cell.volume(),
        force_sum: loads.force.iter().sum(),
        loads,
        imbalance,
        residual: info.residual,
        iterations: info.iterations,
        pressure,
    })
}

/// Writes what is left over in each node to `left` [m³/s]; returns the worst over the largest flux through any.
fn left_over(mesh: &Mesh, source: &[f64], gradient: DVec3, pressure: &[f64], left: &mut Vec<f64>) -> f64 {
    *left = outflow(mesh, pressure);
    left.iter_mut().zip(source).for_each(|(out, source)| *out -= source);
    let mut through = vec![0.0; mesh.nodes()];
    for (&[i, j], flux) in mesh.links.iter().zip(mesh.link_fluxes(gradient, pressure)) {
        through[i as usize] += 0.5 * flux.abs();
        through[j as usize] += 0.5 * flux.abs();
    }
    let largest = |values: &[f64]| values.iter().fold(0.0, |worst: f64, v| worst.max(v.abs()));
    largest(left) / largest(&through)
}

/// Takes the mean over the pores of the pressure less its macroscopic part out.
fn fix_level(cell: &Cell, mesh: &Mesh, gradient: DVec3, pressure: &mut [f64]) {
    let local = mesh.pore_pressure(gradient, pressure);
    let (mut sum, mut volume) = (0.0, 0.0);
    for (pore, &p) in local.iter().enumerate() {
        sum += mesh.volume[pore] * (p - gradient.dot(mesh.centre[pore] - cell.origin));
        volume += mesh.volume[pore];
    }
    pressure.iter_mut().for_each(|p| *p -= sum / volume);
}
