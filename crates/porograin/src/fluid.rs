//! The water: it follows the grains, feels how they move, and loads them.

use crate::boundary::{Domain, Slip, Water};
use crate::budget::{self, Audit};
use crate::cell;
use crate::darcy::{self, GridState};
use crate::grains::{Grains, Loads};
use crate::model::{Flow, FluidModel, Model, TimeStep};
use crate::motion::{Velocities, pistons};
use crate::permeability;
use crate::pores::carry::{Former, former_nodes};
use crate::pores::mesh::{BLOCKED, Carried, Mesh, Walls};
use crate::pores::shear::{self, Film};
use crate::pores::store::{self, Store};
use crate::pores::{
    Coupling, Detached, Memory, Places, PoreState, Pores, Pull, Recipe, Room, Stepping, System, geometric,
    viscous,
};
use crate::stability;
use crate::state::State;
use crate::step::StepError;
use glam::{DMat3, DVec3};
use porograin_geometry::Repair;
use porograin_geometry::throat::{Packing, radical_centres};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

pub(crate) mod coarse;
mod implicit;
mod imposed;
use implicit::Foreseen;
pub use implicit::PAYS;
use imposed::{imposed, inflow, no_value, points};

/// What a restart needs of the water, by the choice of [`Flow`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Fluid {
    /// Pore by pore.
    Pores(PoreState),
    /// On a grid coarser than the grains.
    Darcy(GridState),
}

/// Explicit steps start from so much of the way from the line through the last two pressures to the parabola through the last three. The
/// parabola foresees best, but what the last solves have left over it passes on 4.4 times as large, this 3.7 times.
const BEND: f64 = 0.7;
/// Steps between two looks at how much the pores have deformed.
const LOOK_EVERY: u64 = 10;
/// Nodes that are worth a thread.
const SHARE: usize = 4096;

/// What the water keeps between steps to be fast; dropping it changes no bit.
#[derive(Debug, Default)]
pub struct Scratch {
    made: Option<Made>,
    carried: Carried,
    /// What comes in through each face with an inflow, at the last step [m³/s].
    entering: [f64; 6],
    /// The macroscopic gradient in the last step.
    pull: Pull,
    /// Velocities of the grains beside the flow of a periodic cell.
    velocities: Velocities,
    implicit: Foreseen,
    room: Room,
    /// Of the grid.
    pub darcy: darcy::Scratch,
}

/// A mesh and its factorised system, and what they were made of.
#[derive(Debug)]
struct Made {
    at_step: u64,
    recipe: Recipe,
    mesh: Mesh,
    films: Vec<Film>,
    /// How its triangulation came from the last one.
    repair: Repair,
    system: System,
}

impl Scratch {
    /// What local damping knows of `loads`, see [`motion::advance`](crate::motion::advance).
    pub fn felt<'a>(&'a self, loads: &'a Loads) -> &'a Loads {
        self.implicit.felt().unwrap_or(loads)
    }

    /// The mesh in use, once there is one.
    pub fn mesh(&self) -> Option<&Mesh> {
        self.made.as_ref().map(|made| &made.mesh)
    }

    /// How the triangulation of the mesh in use came from the one before.
    pub fn repair(&self) -> Repair {
        self.made.as_ref().map(|made| made.repair).unwrap_or_default()
    }

    /// Mean excess pressure at 13 heights along an axis [Pa], while there is water.
    pub fn profile(&self, state: &State, axis: usize) -> Option<[f64; 13]> {
        match state.fluid.as_ref()? {
            Fluid::Pores(water) => {
                let beside = water.beside(&state.grains, &state.domain);
                Some(permeability::profile(beside.packing(), self.mesh()?, &water.pressure, axis))
            }
            Fluid::Darcy(water) => Some(self.darcy.grid()?.profile(&water.pressure, axis)),
        }
    }

    /// Water that left through each face in the last step [m³/s]: through throats, given to pores at a face with a pressure or
    /// pushed out of them by grains; less what came in through a face with an inflow.
    pub fn outflow(&self, state: &State) -> Option<[f64; 6]> {
        let (mesh, water) = (self.mesh()?, state.pores()?);
        let into = permeability::fluxes(mesh, &water.pressure);
        let mut out: [f64; 6] = std::array::from_fn(|face| -into[face] - self.entering[face]);
        for (&held, rate) in mesh.held.iter().zip(&self.moved(state, mesh, water).node) {
            if let Some(out) = out.get_mut(held as usize) {
                *out -= rate;
            }
        }
        Some(out)
    }

    /// What the motion that the pressures fit carries out of the nodes.
    fn moved(&self, state: &State, mesh: &Mesh, water: &PoreState) -> Cow<'_, Carried> {
        match (&water.implicit, &water.store) {
            (None, _) => Cow::Borrowed(&self.carried),
            (Some(_), Some(_)) => Cow::Borrowed(self.implicit.last()),
            // The velocities after an implicit step are those that the pressures fit.
            (Some(_), None) => {
                let source = self.implicit.last().source.clone();
                let mut moved = Carried { source, ..Carried::default() };
                let State { grains, domain, .. } = state;
                mesh.carried(&grains.velocity, &grains.spin, &domain.wall_velocity, &mut moved);
                Cow::Owned(moved)
            }
        }
    }

    /// Flux through each link of the mesh, and what comes into each node through walls, in the last step [m³/s].
    pub fn flows(&self, state: &State) -> Option<(Vec<f64>, Vec<f64>)> {
        let (mesh, water) = (self.mesh()?, state.pores()?);
        let flux = self.pull.fluxes(mesh, &water.pressure);
        let moved = self.moved(state, mesh, water);
        let mut entering = vec![0.0; mesh.nodes()];
        for (&[i, j], &flux) in mesh.links.iter().zip(&flux) {
            entering[i as usize] += flux;
            entering[j as usize] -= flux;
        }
        for (node, entering) in entering.iter_mut().enumerate() {
            let source = moved.source.get(node).copied().unwrap_or(0.0);
            // Free nodes keep but what comes in through faces with an inflow; the gradient's sources come from no wall.
            *entering += moved.node.get(node).copied().unwrap_or(0.0) + source;
        }
        Some((flux, entering))
    }

    /// The macroscopic gradient of the pressure in the last step [Pa/m].
    pub fn gradient(&self) -> DVec3 {
        self.pull.gradient
    }

    /// Whether only differences of the pressures are known: the water is incompressible and no pressure is given.
    pub fn free_level(&self, state: &State) -> bool {
        match &state.fluid {
            Some(Fluid::Pores(_)) => self.made.as_ref().is_some_and(|made| made.system.free_level()),
            Some(Fluid::Darcy(_)) => self.darcy.free_level(),
            None => false,
        }
    }

    /// What the set-up of the pressure solve made, once there is one.
    pub fn setup(&self) -> Option<porograin_linear::Setup> {
        self.made.as_ref().map(|made| made.system.setup())
    }
}

/// What the water did in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Iterations of the pressure solve.
    pub iterations: usize,
    /// Relative residual of the pressure solve.
    pub residual: f64,
    /// Whether the step was implicit.
    pub implicit: bool,
    /// Power of a macroscopic gradient on water and grains [W].
    pub gradient_power: f64,
    /// What must balance, at the steps that look at it.
    pub audit: Option<Audit>,
}

/// Sees to it that the mesh belongs to the grains: makes the first one, makes a new one when a pore has deformed
/// too much or the faces have changed their rules, and makes the last one again after a restart.
///
/// # Errors
/// [`StepError::Fluid`] if the grains cannot be meshed or some pores are cut off from all open faces.
pub fn follow(state: &mut State, model: &Model, scratch: &mut Scratch) -> Result<Option<f64>, StepError> {
    let Some(fluid) = &model.fluid else {
        state.fluid = None;
        scratch.made = None;
        return Ok(None);
    };
    let pores = match &fluid.flow {
        Flow::Pores(pores) => pores,
        Flow::Darcy(settings) => {
            scratch.made = None;
            coarse::follow(state, model, fluid, settings, &mut scratch.darcy)?;
            return Ok(None);
        }
    };
    let recipe = recipe(model, fluid, pores);
    if state.pores().is_none_or(|water| water.recipe != recipe) {
        renew(state, &recipe, model, pores, scratch)?;
    }
    make(state, &recipe, pores, scratch, false)?;
    let (Some(made), Some(water)) = (&scratch.made, state.pores()) else { return Ok(None) };
    if state.step % LOOK_EVERY != 0 || state.step == water.made_at_step {
        return Ok(None);
    }
    let (strain, _) = made.mesh.strain(water.beside(&state.grains, &state.domain).packing());
    if strain <= pores.remesh.strain {
        return Ok(None);
    }
    renew(state, &recipe, model, pores, scratch)?;
    Ok(Some(strain))
}

/// What the mesh of this model is made of, besides grains.
fn recipe(model: &Model, fluid: &FluidModel, pores: &Pores) -> Recipe {
    let open = std::array::from_fn(|f| matches!(model.faces[f].water, Water::Pressure(_)));
    let slip = std::array::from_fn(|f| if open[f] { Slip::Symmetry } else { model.faces[f].slip });
    Recipe {
        walls: Walls { open, slip },
        conductance: pores.conductance,
        coupling: pores.coupling,
        viscosity: fluid.viscosity,
        bulk_modulus: fluid.bulk_modulus,
        places: Places::new(&pores.point, &pores.blocked),
        shear_forces: pores.shear_forces,
    }
}

/// A new mesh where the grains are now, with the pressures of the last one.
fn renew(
    state: &mut State,
    recipe: &Recipe,
    model: &Model,
    pores: &Pores,
    scratch: &mut Scratch,
) -> Result<(), StepError> {
    let former = former(state, scratch)?;
    // The longest step there may be: over shorter ones compressible water damps less.
    let longest = || match model.time_step {
        TimeStep::Fixed(dt) => dt,
        TimeStep::Automatic { .. } => stability::limit(state, model).seconds,
    };
    let empty = |interval| Store { surplus: Vec::new(), void: 0.0, interval };
    let store = recipe.bulk_modulus.map(|_| empty(longest()));
    state.fluid = Some(Fluid::Pores(PoreState {
        recipe: recipe.clone(),
        made_at_step: state.step,
        mesh_position: state.grains.position.clone(),
        mesh_cell: state.domain.cell,
        mesh_crossed: state.domain.crossed.clone(),
        viscous_rate: 0.0,
        shear_rate: 0.0,
        implicit: None,
        store,
        pressure: Vec::new(),
        before: Default::default(),
    }));
    make(state, recipe, pores, scratch, true)?;
    let Some(made) = &mut scratch.made else { return Ok(()) };
    let (pistons, inertia) = (pistons(model, &state.grains), cell::inertia(state, model));
    let rate = viscous::rate(&made.mesh, &mut made.system, &state.grains, &pistons, &inertia)
        .map_err(|error| cannot_solve(error, &made.mesh, &state.grains))?;
    let shear_rate = shear::rate(&made.films, &state.grains, &state.domain);
    let implicit = match pores.step {
        Stepping::Explicit => false,
        Stepping::Implicit => true,
        // The implicit operator is symmetric only for reciprocal coupling.
        Stepping::Auto if pores.coupling == Coupling::Geometric => false,
        Stepping::Auto => implicit::pays(state, model, rate, shear_rate),
    };
    let State { grains, domain, fluid: Some(Fluid::Pores(water)), .. } = state else { return Ok(()) };
    water.viscous_rate = rate;
    water.shear_rate = shear_rate;
    water.implicit = implicit.then(Memory::default);
    water.pressure = vec![0.0; made.mesh.nodes()];
    water.before.fill(water.pressure.clone());
    if let Some((mesh, old)) = &former {
        let now = Packing { cell: &domain.cell, position: &grains.position, radius: &grains.radius };
        let then = Packing { cell: &old.mesh_cell, position: &old.mesh_position, radius: &grains.radius };
        let nodes = former_nodes(then, mesh, now, &made.mesh);
        let carry = |from: &[f64]| nodes.iter().map(|&node| from[node as usize]).collect();
        water.pressure = carry(&old.pressure);
        water.before = [carry(&old.before[0]), carry(&old.before[1])];
    }
    for (node, _) in made.mesh.held.iter().enumerate().filter(|(_, held)| **held == BLOCKED) {
        water.pressure[node] = 0.0;
        water.before.iter_mut().for_each(|before| before[node] = 0.0);
    }
    if let Some(store) = &mut water.store {
        let known =
            former.and_then(|(_, old)| old.store.filter(|_| old.recipe.bulk_modulus == recipe.bulk_modulus));
        // The next explicit solve answers the motion that brought the grains here.
        let pending = if implicit {
            0.0
        } else {
            let mut moved = Carried::default();
            made.mesh.carried(&grains.velocity, &grains.spin, &domain.wall_velocity, &mut moved);
            state.dt * moved.pore.iter().sum::<f64>()
        };
        *store = Store {
            interval: store.interval,
            ..Store::new(
                &made.mesh,
                made.system.capacity(),
                &mut water.pressure,
                known.map(|k| k.total()),
                pending,
            )
        };
    }
    Ok(())
}

/// The mesh that the pressures belong to, and these; nothing if there are none.
fn former(state: &mut State, scratch: &Scratch) -> Result<Option<(Former, PoreState)>, StepError> {
    let Some(Fluid::Pores(old)) = state.fluid.take() else { return Ok(None) };
    let current = |m: &&Made| m.at_step == old.made_at_step && m.recipe == old.recipe;
    let former = match scratch.made.as_ref().filter(current) {
        Some(made) => Former { triangulation: made.mesh.triangulation.clone(), node: made.mesh.node.clone() },
        None => {
            let packing =
                Packing { cell: &old.mesh_cell, position: &old.mesh_position, radius: &state.grains.radius };
            let recipe = &old.recipe;
            let mut mesh = Mesh::new(packing, &recipe.walls, recipe.conductance, recipe.viscosity)
                .map_err(|error| StepError::Fluid(format!("the pores cannot be meshed: {error}")))?;
            // Which nodes are held rules their numbers.
            recipe.places.apply(packing, &mut mesh);
            Former { triangulation: mesh.triangulation, node: mesh.node }
        }
    };
    Ok(Some((former, old)))
}

/// Makes the mesh that the state asks for, unless it is there already and need not be made `afresh`.
fn make(
    state: &State,
    recipe: &Recipe,
    pores: &Pores,
    scratch: &mut Scratch,
    afresh: bool,
) -> Result<(), StepError> {
    let Some(water) = state.pores() else { return Ok(()) };
    let current = |m: &Made| m.at_step == water.made_at_step && m.recipe == *recipe;
    if !afresh && scratch.made.as_ref().is_some_and(current) {
        return Ok(());
    }
    let packing =
        Packing { cell: &water.mesh_cell, position: &water.mesh_position, radius: &state.grains.radius };
    // From the last one, if there is one: repaired or built at once, the bits are the same.
    let mut triangulation = scratch.made.take().map(|made| made.mesh.triangulation).unwrap_or_default();
    let repair = triangulation
        .repair(packing.cell, packing.position, packing.radius)
        .map_err(|error| StepError::Fluid(format!("the pores cannot be meshed: {error}")))?;
    let mut mesh =
        Mesh::from_triangulation(packing, triangulation, &recipe.walls, recipe.conductance, recipe.viscosity);
    if recipe.coupling == Coupling::Geometric {
        geometric::couple(&mut mesh, packing, &recipe.walls, recipe.conductance);
    }
    recipe.places.apply(packing, &mut mesh);
    let films = if recipe.shear_forces {
        let centres = radical_centres(packing, &mesh.triangulation);
        shear::films(packing, &mesh.triangulation, &centres, &recipe.walls, recipe.viscosity)
    } else {
        Vec::new()
    };
    let (method, residual) = (pores.solver.method(), pores.residual);
    let system = match (recipe.bulk_modulus, &water.store) {
        (Some(bulk_modulus), Some(store)) => {
            let capacity = store::capacity(&mesh, bulk_modulus);
            System::storing(&mesh, method, residual, EXPECTED_SOLVES, capacity, store.interval)
        }
        _ => System::new(&mesh, method, residual, EXPECTED_SOLVES),
    }
    .map_err(|error| cannot_solve(error, &mesh, &state.grains))?;
    scratch.made =
        Some(Made { at_step: water.made_at_step, recipe: recipe.clone(), mesh, films, repair, system });
    Ok(())
}

/// A mesh of a packing near rest serves this many steps at least.
pub(crate) const EXPECTED_SOLVES: usize = 1000;

fn cannot_solve(error: porograin_linear::Error, mesh: &Mesh, grains: &Grains) -> StepError {
    StepError::Fluid(match error {
        porograin_linear::Error::Singular { .. } => {
            Detached::of(mesh, |grain| grains.id[grain as usize]).to_string()
        }
        error => format!("the pressures cannot be found: {error}"),
    })
}

/// Solves for the pressures that the motion of grains and walls calls for: the motion before the step, or, in an
/// implicit step, the one that `loads` and these pressures lead to.
///
/// # Errors
/// [`StepError::Fluid`] if the solve fails.
pub fn advance(
    loads: &Loads,
    state: &mut State,
    model: &Model,
    dt: f64,
    scratch: &mut Scratch,
) -> Result<Option<Report>, StepError> {
    let Scratch { made, carried, entering, pull, velocities, implicit: foreseen, darcy, .. } = scratch;
    foreseen.clear();
    if state.grid().is_some() {
        return coarse::advance(loads, state, model, dt, darcy);
    }
    let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &model.fluid else { return Ok(None) };
    let Some(Made { mesh, system, .. }) = made else { return Ok(None) };
    if state.pores().is_some_and(|water| water.implicit.is_some()) {
        foreseen.foresee(loads, state, model, mesh, dt);
    }
    // Explicit steps answer the motion of the step before, implicit ones that of this step.
    let last = state.dt;
    let State { grains, domain, fluid: Some(Fluid::Pores(water)), .. } = state else { return Ok(None) };
    let implicit = water.implicit.is_some();
    let interval = if implicit { dt } else { last };
    // Pressures vary smoothly from step to step: start from where they were heading.
    // Implicit steps are too long for more than a straight line.
    let bend = if implicit { 0.0 } else { BEND };
    let [before, earlier] = &mut water.before;
    // The new start takes the place of the oldest pressures, then the three change places.
    earlier.par_iter_mut().zip(before.par_iter()).zip(&water.pressure).with_min_len(SHARE).for_each(
        |((earlier, before), now)| {
            *earlier = 2.0 * now - before + bend * (now - 2.0 * before + *earlier);
        },
    );
    std::mem::swap(before, earlier);
    std::mem::swap(&mut water.pressure, before);
    let time = state.time - model.stage_start;
    mesh.hold(|face, x| imposed(&model.faces[face].water, x, time), &mut water.pressure)
        .map_err(|place| no_value(place, time))?;
    let sources = if implicit { foreseen.sources() } else { &mut carried.source };
    *entering = inflow(mesh, &model.faces, time, sources).map_err(|place| no_value(place, time))?;
    points(mesh, &pores.point, time, &mut water.pressure, sources).map_err(|place| no_value(place, time))?;
    pull.add_sources(mesh, sources);
    let pressure = &mut water.pressure;
    let failed = |error| cannot_solve(error, mesh, grains);
    if let Some(store) = &mut water.store {
        if interval == 0.0 {
            // Nothing has moved yet: what the nodes hold says their pressure.
            return Ok(Some(Report { implicit, ..Report::default() }));
        }
        store.give(interval, sources);
        if implicit {
            system.set_interval(mesh, interval).map_err(failed)?;
        } else {
            system.step_over(mesh, interval, &mut store.interval).map_err(failed)?;
        }
    }
    let info = match &mut water.implicit {
        None => {
            let closed = water.store.is_none() && mesh.unknowns == mesh.nodes();
            carry(mesh, grains, domain, closed, velocities, carried);
            system.solve(mesh, &carried.node, pressure)
        }
        Some(memory) => foreseen.solve(system, mesh, grains, pores.implicit_residual, memory, pressure),
    }
    .map_err(failed)?;
    let look = state.step.is_multiple_of(budget::EVERY);
    let mut gradient_power = 0.0;
    let audit = (look || water.store.is_some() || !pull.is_none()).then(|| {
        let (velocities, carried) =
            if implicit { foreseen.carried(mesh, grains, pressure) } else { (&*velocities, carried) };
        gradient_power = pull.power(mesh, pressure, velocities);
        if let Some(store) = &mut water.store {
            store.take(mesh, system.capacity(), pressure, interval, carried);
        }
        let void = mesh.void.iter().sum();
        look.then(|| Audit::of(mesh, carried, pressure, pull, grains.len(), void))
    });
    let audit = audit.flatten();
    Ok(Some(Report { iterations: info.iterations, residual: info.residual, implicit, gradient_power, audit }))
}

/// What the motion before the step carries out of the nodes.
fn carry(
    mesh: &Mesh,
    grains: &Grains,
    domain: &Domain,
    closed: bool,
    velocities: &mut Velocities,
    carried: &mut Carried,
) {
    if mesh.images.is_none() {
        return mesh.carried(&grains.velocity, &grains.spin, &domain.wall_velocity, carried);
    }
    velocities.grain.clear();
    let peculiar = |(&x, &v): (&DVec3, &DVec3)| domain.peculiar(x, v);
    velocities.grain.extend(grains.position.iter().zip(&grains.velocity).map(peculiar));
    velocities.spin.clone_from(&grains.spin);
    velocities.wall = domain.wall_velocity;
    velocities.cell = domain.rate;
    if closed && domain.cell.periodic == [true; 3] {
        // Water came into a cell that was still changing its volume: it stops.
        let trace = domain.rate.x_axis.x + domain.rate.y_axis.y + domain.rate.z_axis.z;
        velocities.cell -= DMat3::from_diagonal(DVec3::splat(trace / 3.0));
    }
    mesh.carried_with_cell(velocities, carried);
}

/// Adds buoyancy, `-rho_f g V`.
pub fn lift(loads: &mut Loads, grains: &Grains, model: &Model) {
    let Some(fluid) = &model.fluid else { return };
    let lift = -fluid.density * model.gravity;
    if lift != DVec3::ZERO {
        for (force, &radius) in loads.force.iter_mut().zip(&grains.radius) {
            *force += lift * grains.shape.volume(radius);
        }
    }
}

/// Adds the drag of the water between grains that slide past each other, where the case asks for it.
pub fn shear(loads: &mut Loads, grains: &Grains, domain: &Domain, scratch: &Scratch) {
    if let Some(made) = &scratch.made {
        shear::add(loads, &made.films, grains, domain);
    }
}

/// Adds what a macroscopic gradient of the pressure does to grains and walls, where the case asks for one.
pub fn pull(loads: &mut Loads, state: &State, model: &Model, scratch: &mut Scratch) {
    let Scratch { made: Some(Made { mesh, .. }), pull, .. } = scratch else { return };
    if let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &model.fluid {
        let time = state.time - model.stage_start;
        *pull = Pull::new(mesh, pores.gradient.each_ref().map(|signal| signal.at(time)).into());
        pull.add_loads(mesh, loads);
    }
}

/// Adds what the pressures do to grains and walls.
///
/// At an open face the water outside pushes back with the same pressure: such a wall feels the grains only.
pub fn add(loads: &mut Loads, state: &State, scratch: &mut Scratch) {
    if let Some(water) = state.grid() {
        darcy::add(loads, water, &state.grains, &mut scratch.darcy);
    }
    if let (Some(made), Some(water)) = (&scratch.made, state.pores()) {
        push(loads, &made.mesh, &water.pressure, &mut scratch.room);
    }
}

/// The push of given pressures.
fn push(loads: &mut Loads, mesh: &Mesh, pressure: &[f64], room: &mut Room) {
    let walls = loads.wall;
    mesh.add_loads_in(room, pressure, loads);
    for face in 0..6 {
        if mesh.open[face] {
            loads.wall[face] = walls[face];
        }
    }
}
