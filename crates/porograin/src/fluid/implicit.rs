//! Implicit steps: the velocities to come and the pressures that go with them, found together.

use crate::cell::{self, CellMotion};
use crate::grains::{Grains, Loads};
use crate::model::{Model, TimeStep};
use crate::motion::{self, Velocities, WallMotion};
use crate::pores::implicit::{Memory, Mobility, Room, prepare, solve};
use crate::pores::mesh::{Carried, Mesh};
use crate::pores::pressure::System;
use crate::stability;
use crate::state::State;
use porograin_geometry::cell::NORMALS;
use porograin_linear::{Error, Info};

/// Implicit steps pay when they may be this many times as long as explicit ones: each costs some more iterations.
pub const PAYS: f64 = 3.0;

/// Whether steps should be implicit where the pressures damp the grains at `rate` [1/s]; what damps at `always` limits steps of
/// either kind.
pub fn pays(state: &State, model: &Model, rate: f64, always: f64) -> bool {
    let contacts = stability::limit(state, model);
    let explicit = stability::explicit(contacts, rate + always, model.damping).seconds;
    match model.time_step {
        TimeStep::Automatic { .. } => {
            stability::explicit(contacts, always, model.damping).seconds > PAYS * explicit
        }
        TimeStep::Fixed(dt) => dt > explicit,
    }
}

/// What the next step would do without the pressures; scratch of the step.
#[derive(Debug, Default)]
pub struct Foreseen {
    velocities: Velocities,
    walls: [WallMotion; 6],
    cell: CellMotion,
    /// Walls on which the pressures act: sealed pistons.
    pushed: [bool; 6],
    kick: f64,
    felt: Loads,
    damped: bool,
    carried: Carried,
    room: Room,
}

impl Foreseen {
    /// Forgets the last step.
    pub fn clear(&mut self) {
        self.damped = false;
    }

    /// The loads that local damping knows of, when they are others than those of the step.
    pub fn felt(&self) -> Option<&Loads> {
        self.damped.then_some(&self.felt)
    }

    /// Foresees the step. Local damping acts on all loads together, with the pressures of the last step: on the others
    /// alone it would hold up grains that the water carries.
    pub fn foresee(&mut self, loads: &Loads, state: &State, model: &Model, mesh: &Mesh, dt: f64) {
        if model.damping > 0.0
            && let Some(water) = state.pores()
        {
            self.felt.clone_from(loads);
            super::push(&mut self.felt, mesh, &water.pressure, &mut self.room.patches);
            self.damped = true;
        }
        let felt = if self.damped { &self.felt } else { loads };
        self.kick = motion::kick(state, dt);
        for face in 0..6 {
            let moved = motion::wall_motion(face, state, model, loads.wall[face], felt.wall[face], dt);
            self.walls[face] = moved;
            self.velocities.wall[face] = moved.velocity;
            self.pushed[face] = moved.mobility > 0.0 && !mesh.open[face];
        }
        self.cell = cell::motion(state, model, loads, felt, dt);
        self.velocities.cell = self.cell.rate;
        motion::foresee(state, model, loads, felt, dt, &mut self.velocities);
    }

    /// What was last found to move out of the nodes.
    pub fn last(&self) -> &Carried {
        &self.carried
    }

    /// What is given into each node from outside [m³/s].
    pub fn sources(&mut self) -> &mut Vec<f64> {
        &mut self.carried.source
    }

    /// Solves for the pressures; `pressure` holds the held ones and a start.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn solve(
        &mut self,
        system: &mut System,
        mesh: &Mesh,
        grains: &Grains,
        residual: f64,
        memory: &mut Memory,
        pressure: &mut [f64],
    ) -> Result<Info, Error> {
        prepare(system, mesh, grains, memory, self.kick, residual)?;
        let Foreseen { velocities, walls, cell, pushed, kick, carried, room, .. } = self;
        let mut mobility = Mobility { grains, kick: *kick, wall: [0.0; 6], cell: cell.mobility };
        for face in (0..6).filter(|&face| pushed[face]) {
            mobility.wall[face] = walls[face].mobility;
        }
        room.push_held(mesh, &mobility, pressure, velocities);
        loop {
            mesh.carried_with_cell(velocities, carried);
            let info = solve(system, mesh, &mobility, memory, &carried.node, pressure, room)?;
            // A piston that would pass its limit moves by decree, at the limit.
            let mut load = Default::default();
            mesh.add_wall_loads(pressure, &mut load);
            let mut again = false;
            for face in 0..6 {
                let further = mobility.wall[face] * load[face].dot(NORMALS[face]);
                let speed = walls[face].velocity.dot(NORMALS[face]) + further;
                if mobility.wall[face] > 0.0 && speed.abs() > walls[face].limit {
                    velocities.wall[face] = walls[face].limit.copysign(speed) * NORMALS[face];
                    mobility.wall[face] = 0.0;
                    again = true;
                }
            }
            // So does a component of the cell.
            let push = mesh.stretching(pressure);
            for (column, row) in (0..9).map(|k| (k / 3, k % 3)) {
                let mobility = &mut mobility.cell.col_mut(column)[row];
                let (limit, foreseen) = (cell.limit.col(column)[row], cell.rate.col(column)[row]);
                let rate = foreseen + *mobility * push.col(column)[row];
                if *mobility > 0.0 && rate.abs() > limit {
                    velocities.cell.col_mut(column)[row] = limit.copysign(rate);
                    (*mobility, cell.mobility.col_mut(column)[row]) = (0.0, 0.0);
                    again = true;
                }
            }
            if !again {
                return Ok(info);
            }
        }
    }

    /// The velocities that the pressures just found lead to, and what moves out of the nodes with them.
    pub fn carried(&mut self, mesh: &Mesh, grains: &Grains, pressure: &[f64]) -> (&Velocities, &mut Carried) {
        let Foreseen { velocities, walls, cell, pushed, kick, carried, room, .. } = self;
        let mut mobility = Mobility { grains, kick: *kick, wall: [0.0; 6], cell: cell.mobility };
        let held = |face: usize| velocities.wall[face].length() >= walls[face].limit;
        for face in (0..6).filter(|&face| pushed[face] && !held(face)) {
            mobility.wall[face] = walls[face].mobility;
        }
        room.push_free(mesh, &mobility, pressure, velocities);
        mesh.carried_with_cell(velocities, carried);
        (velocities, carried)
    }
}
