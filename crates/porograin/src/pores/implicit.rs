//! The implicit step: pressures found together with the velocities they lead to (`physics` §3b).
//!
//! The loads without the pressures would give the velocities `v*` in the middle of the step; the pressures make them
//! `v = v* + k M⁻¹ S p`, k the time for which loads act on velocities, and must fit the flow that `v` calls for,
//! `G p = -Sᵀ v`. So `(G + k Sᵀ M⁻¹ S) p = -Sᵀ v*`: symmetric, positive, and damped without a limit on the step.
//! The operator is only ever applied; `G + 0.2 k diag(Sᵀ M⁻¹ S)` serves as preconditioner. The walls stay out of that
//! diagonal, for they join far nodes.

use super::mesh::{Carried, Mesh};
use super::patch;
use super::pressure::System;
use crate::grains::{Grains, Loads};
use crate::motion::Velocities;
use glam::DMat3;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::triangulation::wall;
use porograin_linear::{Error, Info, Matrix, Operator};
use serde::{Deserialize, Serialize};

/// Relative residual of an implicit step, unless the case says otherwise.
pub const RESIDUAL: f64 = 1e-4;
/// Right-hand sides below this part of the largest since the mesh was made count as that: what is left to find in
/// them is the noise of a sample at rest.
const FLOOR: f64 = 1e-3;
/// What the preconditioner takes of the diagonal of `Sᵀ M⁻¹ S`: with all of it the smooth modes, for which `S` all but
/// cancels, would be far too stiff.
const DIAGONAL: f64 = 0.2;
/// What implicit steps keep from one to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    /// The time for which loads act on velocities that the preconditioner was made for [s].
    pub prepared_for: f64,
    /// The largest right-hand side since the mesh was made [m³/s].
    pub largest: f64,
}

/// How easily things move: `k M⁻¹`.
#[derive(Clone, Copy, Debug)]
pub struct Mobility<'a> {
    /// The grains.
    pub grains: &'a Grains,
    /// The time for which loads act on velocities [s].
    pub kick: f64,
    /// Velocity of each wall along its normal per force [m/s per N]; zero unless it is a sealed piston.
    pub wall: [f64; 6],
    /// Velocity gradient of the cell per push on it [1/s per J]; zero but for components whose stress is held.
    pub cell: DMat3,
}

impl Mobility<'_> {
    /// Adds `k M⁻¹ loads` to the velocities.
    pub fn push(&self, loads: &Loads, velocities: &mut Velocities) {
        let Velocities { grain, spin, wall, cell } = velocities;
        for (i, (velocity, spin)) in grain.iter_mut().zip(spin).enumerate() {
            *velocity += self.kick / self.grains.mass[i] * loads.force[i];
            *spin += self.kick / self.grains.inertia(i) * loads.torque[i];
        }
        for face in 0..6 {
            wall[face] += self.wall[face] * loads.wall[face].dot(NORMALS[face]) * NORMALS[face];
        }
        for column in 0..3 {
            *cell.col_mut(column) += self.cell.col(column) * loads.cell.col(column);
        }
    }
}

/// What the operator needs room for.
#[derive(Debug, Default)]
pub struct Room {
    pressure: Vec<f64>,
    loads: Loads,
    velocities: Velocities,
    carried: Carried,
    /// Of the patches.
    pub patches: patch::Room,
}

impl Room {
    /// Adds `k M⁻¹ S p` of the held pressures alone to the velocities.
    pub fn push_held(&mut self, mesh: &Mesh, mobility: &Mobility, pressure: &[f64], out: &mut Velocities) {
        self.push(mesh, mobility, pressure, |node| node >= mesh.unknowns, out);
    }

    /// Adds `k M⁻¹ S p` of the free pressures alone to the velocities.
    pub fn push_free(&mut self, mesh: &Mesh, mobility: &Mobility, pressure: &[f64], out: &mut Velocities) {
        self.push(mesh, mobility, pressure, |node| node < mesh.unknowns, out);
    }

    fn push(
        &mut self,
        mesh: &Mesh,
        mobility: &Mobility,
        pressure: &[f64],
        of: impl Fn(usize) -> bool,
        out: &mut Velocities,
    ) {
        self.pressure.clear();
        self.pressure.extend(pressure.iter().enumerate().map(|(node, &p)| if of(node) { p } else { 0.0 }));
        if self.pressure.iter().any(|&p| p != 0.0) {
            self.loads.clear(out.grain.len());
            mesh.add_loads_in(&mut self.patches, &self.pressure, &mut self.loads);
            mobility.push(&self.loads, out);
        }
    }
}

/// Makes the preconditioner for steps with this kick [s], unless it is there, and sets the relative residual to solve
/// to. A preconditioner for kicks half or twice as long still serves.
///
/// # Errors
/// Those of the solver.
pub fn prepare(
    system: &mut System,
    mesh: &Mesh,
    grains: &Grains,
    memory: &mut Memory,
    kick: f64,
    residual: f64,
) -> Result<(), Error> {
    if !(0.5 * memory.prepared_for..=2.0 * memory.prepared_for).contains(&kick) {
        memory.prepared_for = kick;
    }
    if system.prepared_for == memory.prepared_for {
        return Ok(());
    }
    system.prepared_for = memory.prepared_for;
    system.set_residual(residual);
    // Loads act on velocities for as long as the step is, or nearly so.
    let stored = system.stored(memory.prepared_for);
    let mut extra = vec![0.0; system.rhs.len()];
    for (pore, vertices) in mesh.triangulation.pores.iter().enumerate() {
        let Some(sum) = extra.get_mut(mesh.node[pore] as usize) else { continue };
        for (&vertex, push) in vertices.iter().zip(mesh.push.of(pore)) {
            if wall(vertex).is_none() {
                let i = vertex as usize;
                *sum += push.force().length_squared() / grains.mass[i]
                    + push.torque().length_squared() / grains.inertia(i);
            }
        }
    }
    extra.iter_mut().zip(stored).for_each(|(e, stored)| *e = *e * DIAGONAL * memory.prepared_for + stored);
    let mut shifted = system.matrix.clone();
    shifted.refresh(&mesh.conductance, &extra)?;
    system.solver.refresh(&shifted)
}

/// Solves for the pressures of the nodes. `carried` is what moves out of each node with the velocities foreseen,
/// those that the held pressures add included, less sources [m³/s]; `pressure` holds held values and the start, and
/// receives the solution [Pa].
///
/// # Errors
/// Those of the solver.
pub fn solve(
    system: &mut System,
    mesh: &Mesh,
    mobility: &Mobility,
    memory: &mut Memory,
    carried: &[f64],
    pressure: &mut [f64],
    room: &mut Room,
) -> Result<Info, Error> {
    system.begin(carried, pressure);
    let System { matrix, solver, rhs, .. } = &mut *system;
    let size = rhs.iter().map(|b| b * b).sum::<f64>().sqrt();
    memory.largest = memory.largest.max(size);
    solver.params_mut().floor = FLOOR * memory.largest;
    let mut operator = Step { mesh, matrix, mobility, room };
    let info = solver.solve_operator(&mut operator, rhs, &mut pressure[..rhs.len()])?;
    system.end(mesh, pressure);
    Ok(info)
}

/// `G + k Sᵀ M⁻¹ S`.
struct Step<'a> {
    mesh: &'a Mesh,
    matrix: &'a Matrix,
    mobility: &'a Mobility<'a>,
    room: &'a mut Room,
}

impl Operator for Step<'_> {
    fn nodes(&self) -> usize {
        self.matrix.nodes()
    }

    fn apply(&mut self, x: &[f64], y: &mut [f64]) {
        let Room { pressure, loads, velocities, carried, patches } = &mut *self.room;
        pressure.clear();
        pressure.extend_from_slice(x);
        pressure.resize(self.mesh.nodes(), 0.0);
        let n = self.mobility.grains.len();
        loads.clear(n);
        self.mesh.add_loads_in(patches, pressure, loads);
        velocities.clear(n);
        self.mobility.push(loads, velocities);
        self.mesh.carried_with_cell(velocities, carried);
        let mut matrix = self.matrix;
        matrix.apply(x, y);
        y.iter_mut().zip(&carried.node).for_each(|(y, carried)| *y += carried);
    }
}
