//! Permeability of a packing: steady flow between two opposite faces of a box, or through a periodic cell.

mod periodic;
pub use periodic::{Flow, PeriodicOutcome, PeriodicProblem, measure_periodic};

use crate::boundary::Slip;
use crate::grains::{Loads, sphere_volume};
use crate::pores::mesh::{Mesh, Walls};
use crate::pores::{Conductance, Coupling, Detached, Solver, System, geometric};
use glam::DVec3;
use porograin_geometry::throat::Packing;
use porograin_geometry::{Cell, Triangulation, TriangulationError};
use std::fmt;
use std::time::Instant;

/// Inflow and outflow agree to this part before a solution counts as one.
const BALANCE: f64 = 1e-11;
/// Rounding ends the refinement long before.
const MAX_REFINEMENTS: usize = 5;
/// The first solve goes so far: it tells how much flows, and with that how far to go.
const ROUGH: f64 = 1e-4;
/// A refinement gains two digits at least.
const LOOSEST: f64 = 1e-2;

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Problem {
    /// The axis of the flow, 0, 1 or 2.
    pub axis: usize,
    /// Pressure at the low face less that at the high face, which is at zero [Pa].
    pub drop: f64,
    /// Whether the water sticks to the four walls along the flow.
    pub sides: Slip,
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

/// Wall-clock seconds of the three parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Triangulation.
    pub triangulation: f64,
    /// Throat geometry, conductances and coupling.
    pub conductance: f64,
    /// Set-up and solution of the linear system.
    pub solve: f64,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Intrinsic permeability `Q mu H / (A drop)` [m²].
    pub permeability: f64,
    /// Flux in through the low face [m³/s].
    pub inflow: f64,
    /// Flux out through the high face [m³/s].
    pub outflow: f64,
    /// Void volume over the box [-].
    pub porosity: f64,
    /// Mean pressure at 13 heights from the low to the high face [Pa].
    pub pressure_profile: [f64; 13],
    /// Fluid force and torque on each grain [N, N m]; on each wall, where the open faces take the pressure of
    /// the water outside as well, so that nothing is left on them.
    pub loads: Loads,
    /// Sum of the forces on the grains [N]; with those on the walls it equals `drop` times the section.
    pub force_sum: DVec3,
    /// Relative residual of the pressure solve.
    pub residual: f64,
    /// Iterations of the pressure solve.
    pub iterations: usize,
    /// Pressure of each node [Pa].
    pub pressure: Vec<f64>,
    /// The pores.
    pub mesh: Mesh,
    /// Wall-clock seconds.
    pub seconds: Seconds,
}

/// Why a permeability could not be measured.
#[derive(Debug)]
pub enum PermeabilityError {
    /// The grains cannot be triangulated.
    Triangulation(TriangulationError),
    /// Some pores are cut off.
    Detached(Detached),
    /// The pressures cannot be found.
    Solve(porograin_linear::Error),
}

impl PermeabilityError {
    fn solve(error: porograin_linear::Error, mesh: &Mesh) -> Self {
        match error {
            porograin_linear::Error::Singular { .. } => {
                PermeabilityError::Detached(Detached::of(mesh, |grain| grain))
            }
            error => PermeabilityError::Solve(error),
        }
    }
}

impl fmt::Display for PermeabilityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PermeabilityError::Triangulation(error) => error.fmt(f),
            PermeabilityError::Detached(pores) => pores.fmt(f),
            PermeabilityError::Solve(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for PermeabilityError {}

/// Solves the steady flow between the two faces across `problem.axis`.
///
/// # Errors
/// [`PermeabilityError`].
pub fn measure(
    cell: &Cell,
    position: &[DVec3],
    radius: &[f64],
    problem: &Problem,
) -> Result<Outcome, PermeabilityError> {
    let packing = Packing { cell, position, radius };
    let (low, high) = (2 * problem.axis, 2 * problem.axis + 1);
    let mut walls = Walls { open: [false; 6], slip: [problem.sides; 6] };
    for face in [low, high] {
        walls.open[face] = true;
        walls.slip[face] = Slip::Symmetry;
    }
    let (mesh, mut seconds) =
        meshed(packing, &walls, problem.conductance, problem.coupling, problem.viscosity)?;

    let clock = Instant::now();
    let size = cell.upper() - cell.origin;
    let height = size[problem.axis];
    let mut pressure = vec![0.0; mesh.nodes()];
    // A line from face to face: what is left to find is local, and takes as many iterations in a large sample as in a small one.
    for (&node, centre) in mesh.node.iter().zip(&mesh.centre) {
        let along = (centre - cell.origin)[problem.axis] / height;
        pressure[node as usize] = problem.drop * (1.0 - along.clamp(0.0, 1.0));
    }
    let mut held = [0.0; 6];
    held[low] = problem.drop;
    mesh.hold_faces(&held, &mut pressure);
    let mut system = System::new(&mesh, problem.solver.method(), problem.residual.max(ROUGH), 1)
        .map_err(|error| PermeabilityError::solve(error, &mesh))?;
    let zero = vec![0.0; mesh.nodes()];
    let mut info = system.solve(&mesh, &zero, &mut pressure).map_err(PermeabilityError::Solve)?;
    // The residual is relative to the largest conductances at the open faces; where radical centres nearly coincide
    // those exceed the flow by orders of magnitude. Solve for the imbalance itself until what flows in flows out.
    let mut flow = fluxes(&mesh, &pressure);
    for _ in 0..MAX_REFINEMENTS {
        let imbalance = (flow[low] + flow[high]).abs() / flow[low].abs();
        if imbalance <= BALANCE && info.residual <= problem.residual {
            break;
        }
        let mut correction = vec![0.0; mesh.nodes()];
        // What the imbalance may keep of itself: a digit less than it may, for its sum may fall slower than its norm.
        let keep = (0.1 * BALANCE / imbalance).min(problem.residual / info.residual);
        system.set_residual(keep.clamp(f64::EPSILON, LOOSEST));
        let rest = outflow(&mesh, &pressure);
        let refined = system.solve(&mesh, &rest, &mut correction).map_err(PermeabilityError::Solve)?;
        info.iterations += refined.iterations;
        info.residual *= refined.residual;
        pressure.iter_mut().zip(&correction).for_each(|(p, c)| *p += c);
        flow = fluxes(&mesh, &pressure);
    }
    seconds.solve = clock.elapsed().as_secs_f64();

    let section = cell.volume() / height;
    let mut loads = Loads::default();
    loads.clear(position.len());
    mesh.add_loads(&pressure, &mut loads);
    for face in [low, high] {
        loads.wall[face] = DVec3::ZERO;
    }
    let solid: f64 = radius.iter().map(|&r| sphere_volume(r)).sum();
    Ok(Outcome {
        permeability: flow[low] * problem.viscosity * height / (section * problem.drop),
        inflow: flow[low],
        outflow: -flow[high],
        porosity: 1.0 - solid / cell.volume(),
        pressure_profile: profile(packing, &mesh, &pressure, problem.axis),
        force_sum: loads.force.iter().sum(),
        residual: info.residual,
        iterations: info.iterations,
        loads,
        pressure,
        mesh,
        seconds,
    })
}

/// Makes the pores, with the seconds it took.
fn meshed(
    packing: Packing,
    walls: &Walls,
    conductance: Conductance,
    coupling: Coupling,
    viscosity: f64,
) -> Result<(Mesh, Seconds), PermeabilityError> {
    let mut seconds = Seconds::default();
    let clock = Instant::now();
    let triangulation = Triangulation::new(packing.cell, packing.position, packing.radius)
        .map_err(PermeabilityError::Triangulation)?;
    seconds.triangulation = clock.elapsed().as_secs_f64();
    let clock = Instant::now();
    let mut mesh = Mesh::from_triangulation(packing, triangulation, walls, conductance, viscosity);
    if coupling == Coupling::Geometric {
        geometric::couple(&mut mesh, packing, walls, conductance);
    }
    seconds.conductance = clock.elapsed().as_secs_f64();
    Ok((mesh, seconds))
}

/// Net flux out of each node through its throats [m³/s].
pub fn outflow(mesh: &Mesh, pressure: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; mesh.nodes()];
    for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance) {
        let flux = g * (pressure[i as usize] - pressure[j as usize]);
        out[i as usize] += flux;
        out[j as usize] -= flux;
    }
    out
}

/// Flux into the sample through each face whose pressure is imposed [m³/s].
pub fn fluxes(mesh: &Mesh, pressure: &[f64]) -> [f64; 6] {
    let mut flow = [0.0; 6];
    for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance) {
        let (i, j) = (i as usize, j as usize);
        let flux = g * (pressure[i] - pressure[j]);
        // Points and blocked pores hold nodes too, but are no faces.
        for (node, flux) in [(i, flux), (j, -flux)] {
            if let Some(flow) = flow.get_mut(mesh.held[node] as usize) {
                *flow += flux;
            }
        }
    }
    flow
}

/// Mean pressure at 13 heights `k/12`: over the pores cut by the plane, each weighted by its mean section. Along a periodic axis
/// the planes lie along the other two period vectors, and the last is the image of the first.
pub fn profile(packing: Packing, mesh: &Mesh, pressure: &[f64], axis: usize) -> [f64; 13] {
    let periodic = packing.cell.periodic[axis];
    let inverse = packing.cell.edges.inverse();
    let along = |x: DVec3| if periodic { (inverse * (x - packing.cell.origin))[axis] } else { x[axis] };
    let (from, to) =
        if periodic { (0.0, 1.0) } else { (packing.cell.origin[axis], packing.cell.upper()[axis]) };
    let mut sum = [[0.0; 2]; 13];
    for (pore, vertices) in mesh.triangulation.pores.iter().enumerate() {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..4 {
            let at = match (
                packing.point(&mesh.triangulation, pore, k),
                porograin_geometry::triangulation::wall(vertices[k]),
            ) {
                (Some(x), _) => along(x),
                (None, Some(face)) if face / 2 == axis => packing.cell.wall_position(face),
                _ => continue,
            };
            low = low.min(at);
            high = high.max(at);
        }
        if high <= low {
            continue;
        }
        let weight = mesh.volume[pore] / (high - low);
        for (k, [p, w]) in sum.iter_mut().enumerate() {
            let at = height(k, from, to);
            // Of a pore that is met again a period later, each image counts.
            let images = if periodic { (at - low).floor() - (at - high).ceil() + 1.0 } else { 1.0 };
            if images > 0.0 && (periodic || (low <= at && at <= high)) {
                *p += images * weight * pressure[mesh.node[pore] as usize];
                *w += images * weight;
            }
        }
    }
    sum.map(|[p, w]| p / w)
}

/// Height `k` of 13; the last is `to` to the last bit, so that the topmost pores reach it.
fn height(k: usize, from: f64, to: f64) -> f64 {
    let part = k as f64 / 12.0;
    from * (1.0 - part) + to * part
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_ends_of_a_profile_are_the_faces() {
        for to in [0.006, 0.1, 0.7, 1.1] {
            assert_eq!([super::height(0, -0.3, to), super::height(12, -0.3, to)], [-0.3, to]);
        }
    }
}
