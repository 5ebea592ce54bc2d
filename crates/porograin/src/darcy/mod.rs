//! Coarse water: Darcy's law on a grid of cells larger than the grains (Goodarzi et al. 2013, `physics` §5).

pub mod corners;
pub mod drag;
pub mod grid;
mod multigrid;
pub mod passes;
pub mod permeability;
pub mod pressure;
mod stencil;
pub mod transfer;
#[cfg(target_arch = "x86_64")]
mod wide;

pub use grid::{Census, Grid};
pub use permeability::{Drag, Permeability};
pub use pressure::{Flows, System, Terms};
pub use transfer::Transfer;

use passes::{Field, Four, Moving, Pull};

use crate::boundary::{Domain, Face, Water};
use crate::grains::{Grains, Loads, Shape};
use glam::DVec3;
use porograin_geometry::Cell;
use porograin_linear::{Error, Info};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of the coarse flow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Darcy {
    /// How many cells there are.
    pub cells: Cells,
    /// What the planes between the cells follow.
    pub faces: Follow,
    /// How a grain is shared among the cells it reaches into.
    pub transfer: Transfer,
    /// How a cell conducts.
    pub permeability: Permeability,
    /// What resists the flow.
    pub drag: Drag,
    /// The grains are distributed anew as soon as one has moved by this part of the mean diameter [-].
    pub renew: f64,
    /// Residual of the pressure solve, relative to all flows of grains and water between cells.
    pub residual: f64,
}

impl Default for Darcy {
    fn default() -> Self {
        Darcy {
            cells: Cells::Grains(8.0),
            faces: Follow::Walls,
            transfer: Transfer::default(),
            permeability: Permeability::default(),
            drag: Drag::default(),
            renew: 0.02,
            residual: 1e-6,
        }
    }
}

/// How many cells there are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cells {
    /// Along x, y, z.
    Count([usize; 3]),
    /// As many, near cubes, as leave this many grains to each on average.
    Grains(f64),
    /// Near cubes with edges of this length [m].
    Size(f64),
}

/// What the planes between the cells follow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Follow {
    /// The walls: cells of one size fill the box.
    #[default]
    Walls,
    /// The grains: every plane moves with the grains around it, and at a face with an imposed pressure the grid ends
    /// where the grains end.
    Grains,
}

/// What a restart needs of the water: the grid is made again from the grains as they were when it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridState {
    /// The settings it was made with.
    pub settings: Darcy,
    /// Viscosity it was made with [Pa s].
    pub viscosity: f64,
    /// The step at which it was made.
    pub made_at_step: u64,
    /// Grain centres when it was made [m].
    pub grid_position: Vec<DVec3>,
    /// The box when it was made.
    pub grid_cell: Cell,
    /// Planes between the cells [m].
    pub planes: [Vec<f64>; 3],
    /// Part of the mobility that the inertia of the water left in each cell then; empty: all.
    pub slowed: Vec<f64>,
    /// Excess pressure of each cell and wall face [Pa].
    pub pressure: Vec<f64>,
    /// By how much that of each cell changed in the last step [Pa].
    pub change: Vec<f64>,
}

/// What is kept between steps to be fast.
#[derive(Debug, Default)]
pub struct Scratch {
    made: Option<(u64, Grid)>,
    system: Option<System>,
    /// Whether the system belongs to the grid in use.
    fits: bool,
    /// What all other forces and the pressures so far make of the velocities, where threads need it.
    velocity: Vec<Four>,
    /// Force of the pressures of the state on each grain; empty until known.
    pulled: Vec<Pull>,
    /// Sum of volume times velocity of the grains around each corner.
    carried: Vec<Four>,
    /// Pull of the pressures and drag around each corner.
    field: Vec<Field>,
    imposed: Vec<f64>,
    /// What the last step did to the water.
    pub flows: Flows,
}

impl Scratch {
    /// The grid in use, once there is one.
    pub fn grid(&self) -> Option<&Grid> {
        self.made.as_ref().map(|(_, grid)| grid)
    }

    /// Whether nothing holds the level of the pressures: their mean stays what it is.
    pub fn free_level(&self) -> bool {
        self.system.as_ref().is_some_and(System::free_level)
    }

    /// Force of the pressures of the state on each wall [N].
    pub fn wall_force(&self, state: &GridState, open: &[bool; 6]) -> [DVec3; 6] {
        self.grid().map_or([DVec3::ZERO; 6], |grid| pressure::wall_force(grid, &state.pressure, open))
    }
}

/// What the grid sees of the rest.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a> {
    /// The grains.
    pub grains: &'a Grains,
    /// The box.
    pub domain: &'a Domain,
    /// Rules of the faces.
    pub faces: &'a [Face; 6],
    /// Steps done.
    pub step: u64,
    /// Viscosity [Pa s] and density [kg/m³] of the water.
    pub fluid: [f64; 2],
}

/// The mean slowing of a cell may be off by this part before the grid is made anew.
const SLOWING: f64 = 0.01;
/// Planes that follow the grains never come closer than this part of the spacing they would have had.
const CLOSEST: f64 = 0.2;
/// Steps between two looks at how far the grains have moved.
const LOOK_EVERY: u64 = 10;

/// Sees to it that the grid belongs to the grains: makes the first one, makes it anew when grains or walls have
/// moved, and makes the last one again after a restart.
///
/// # Errors
/// One sentence, when planes that follow the grains meet.
pub fn follow(
    water: &mut Option<GridState>,
    settings: &Darcy,
    around: &Around,
    scratch: &mut Scratch,
) -> Result<(), String> {
    let known = water.as_ref().is_some_and(|w| {
        w.settings == *settings
            && w.viscosity == around.fluid[0]
            && w.grid_position.len() == around.grains.len()
    });
    if !known {
        let planes = first_planes(settings, around);
        renew(water, settings, planes, Vec::new(), around, scratch);
        return Ok(());
    }
    let Some(state) = water else { return Ok(()) };
    make(state, around.grains, scratch);
    let Some((_, grid)) = &scratch.made else { return Ok(()) };
    if !around.step.is_multiple_of(LOOK_EVERY) || around.step == state.made_at_step {
        return Ok(());
    }
    let slowed = match settings.drag {
        Drag::Darcy => Vec::new(),
        Drag::Ergun => slowing(grid, state, around.fluid[1]),
    };
    let before = |cell: usize| state.slowed.get(cell).copied().unwrap_or(1.0);
    let changed = slowed.iter().enumerate().any(|(cell, now)| (now / before(cell) - 1.0).abs() > SLOWING);
    if changed || moved(state, settings, around) {
        let planes = next_planes(grid, state, settings, around)?;
        renew(water, settings, planes, slowed, around, scratch);
    }
    Ok(())
}

/// Whether the faces have moved, or a grain against them, by more than the part of a diameter that is allowed.
fn moved(state: &GridState, settings: &Darcy, around: &Around) -> bool {
    let (cell, old) = (&around.domain.cell, &state.grid_cell);
    let grains = around.grains;
    let mean = 2.0 * grains.radius.iter().sum::<f64>() / grains.len().max(1) as f64;
    let reach = settings.renew * mean;
    let shifted = (cell.origin - old.origin).abs().max((cell.upper() - old.upper()).abs());
    if shifted.max_element() > reach {
        return true;
    }
    let scale = (cell.upper() - cell.origin) / (old.upper() - old.origin);
    (grains.position.par_iter().with_min_len(4096))
        .zip(&state.grid_position)
        .any(|(now, then)| (*now - cell.origin - (*then - old.origin) * scale).length() > reach)
}

/// Distributes the grains from where they are now; pressures stay with their cells.
fn renew(
    water: &mut Option<GridState>,
    settings: &Darcy,
    planes: [Vec<f64>; 3],
    slowed: Vec<f64>,
    around: &Around,
    scratch: &mut Scratch,
) {
    let count = |planes: &[Vec<f64>; 3]| [0, 1, 2].map(|axis| planes[axis].len());
    let kept = water.take().filter(|old| count(&old.planes) == count(&planes));
    let mut state = GridState {
        settings: settings.clone(),
        viscosity: around.fluid[0],
        made_at_step: around.step,
        grid_position: around.grains.position.clone(),
        grid_cell: around.domain.cell,
        planes,
        slowed,
        pressure: Vec::new(),
        change: Vec::new(),
    };
    scratch.made = None;
    make(&state, around.grains, scratch);
    if let Some((_, grid)) = &scratch.made {
        (state.pressure, state.change) = match kept {
            Some(old) => (old.pressure, old.change),
            None => (vec![0.0; grid.nodes()], vec![0.0; grid.census.cells]),
        };
    }
    *water = Some(state);
}

/// Makes the grid that the state asks for, unless it is there already.
fn make(state: &GridState, grains: &Grains, scratch: &mut Scratch) {
    if scratch.made.as_ref().is_some_and(|(at, _)| *at == state.made_at_step) {
        return;
    }
    let then = Grains { position: state.grid_position.clone(), ..grains.clone() };
    let plan = grid::Plan {
        planes: state.planes.clone(),
        transfer: state.settings.transfer,
        permeability: state.settings.permeability,
        viscosity: state.viscosity,
        slowed: &state.slowed,
    };
    scratch.made = Some((state.made_at_step, Grid::new(&then, &plan)));
    scratch.fits = false;
    scratch.pulled.clear();
}

/// Number of cells along each axis in a box of this size [m].
pub fn counts(cells: Cells, size: DVec3, grains: &Grains) -> [usize; 3] {
    let flat = matches!(grains.shape, Shape::Disc { .. });
    let edge = match cells {
        Cells::Count(count) => return count,
        Cells::Size(edge) => edge,
        Cells::Grains(each) => {
            let share = each / grains.len().max(1) as f64;
            if flat { (size.x * size.z * share).sqrt() } else { (size.element_product() * share).cbrt() }
        }
    };
    std::array::from_fn(
        |axis| {
            if flat && axis == 1 { 1 } else { (size[axis] / edge).round().max(1.0) as usize }
        },
    )
}

/// Planes at equal distances, between the walls or where the grains end.
fn first_planes(settings: &Darcy, around: &Around) -> [Vec<f64>; 3] {
    let cell = &around.domain.cell;
    let (mut low, mut high) = (cell.origin, cell.upper());
    if settings.faces == Follow::Grains {
        let (start, end) = extent(around.grains);
        for axis in 0..3 {
            if is_open(&around.faces[2 * axis]) {
                low[axis] = low[axis].max(start[axis]);
            }
            if is_open(&around.faces[2 * axis + 1]) {
                high[axis] = high[axis].min(end[axis]);
            }
        }
    }
    let count = counts(settings.cells, high - low, around.grains);
    std::array::from_fn(|axis| {
        let n = count[axis];
        (0..=n).map(|k| low[axis] + (high[axis] - low[axis]) * (k as f64 / n as f64)).collect()
    })
}

/// Where the grains begin and end [m].
fn extent(grains: &Grains) -> (DVec3, DVec3) {
    let all = grains.position.iter().zip(&grains.radius);
    all.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (&x, &r)| {
        (low.min(x - r), high.max(x + r))
    })
}

fn is_open(face: &Face) -> bool {
    matches!(face.water, Water::Pressure(_))
}

/// The planes where walls or grains have taken them.
fn next_planes(
    grid: &Grid,
    state: &GridState,
    settings: &Darcy,
    around: &Around,
) -> Result<[Vec<f64>; 3], String> {
    let (cell, old) = (&around.domain.cell, &state.grid_cell);
    let (low, high) = (cell.origin, cell.upper());
    let mut planes = state.planes.clone();
    for axis in 0..3 {
        let last = planes[axis].len() - 1;
        match settings.faces {
            Follow::Walls => {
                let scale = (high[axis] - low[axis]) / (old.upper()[axis] - old.origin[axis]);
                for plane in &mut planes[axis] {
                    *plane = low[axis] + (*plane - old.origin[axis]) * scale;
                }
                planes[axis][last] = high[axis];
            }
            Follow::Grains => {
                let shift = plane_shifts(grid, axis, |k| {
                    around.grains.position[k][axis] - state.grid_position[k][axis]
                });
                for (plane, shift) in planes[axis].iter_mut().zip(shift) {
                    *plane = (*plane + shift).clamp(low[axis], high[axis]);
                }
                if !is_open(&around.faces[2 * axis]) {
                    planes[axis][0] = low[axis];
                }
                if !is_open(&around.faces[2 * axis + 1]) {
                    planes[axis][last] = high[axis];
                }
                let spacing = (planes[axis][last] - planes[axis][0]) / last as f64;
                if planes[axis].windows(2).any(|pair| pair[1] - pair[0] < CLOSEST * spacing) {
                    return Err(format!(
                        "two planes of the grid that follow the grains along {} have nearly met: use fewer cells, or \
                         faces = \"walls\"",
                        ["x", "y", "z"][axis]
                    ));
                }
            }
        }
    }
    Ok(planes)
}

/// Mean over each plane of the displacement of the grains around it.
fn plane_shifts(grid: &Grid, axis: usize, shift: impl Fn(usize) -> f64) -> Vec<f64> {
    let grains = grid.corners.grains();
    let shifts: Vec<DVec3> = (0..grains).map(|k| DVec3::splat(shift(k))).collect();
    let (force, pulled) = (vec![DVec3::ZERO; grains], vec![Pull::default(); grains]);
    let moving = Moving { velocity: &shifts, mass: &vec![1.0; grains], kick: 0.0 };
    let (mut value, mut carried) = (Vec::new(), Vec::new());
    grid.corners.sums(&moving.under(&force, &pulled), &mut value, &mut carried);
    let mut sum = vec![[0.0; 2]; grid.planes[axis].len()];
    let [nx, ny, _] = grid.corners.count;
    for (corner, (carried, solid)) in carried.iter().zip(&grid.corners.solid).enumerate() {
        let at = [corner % nx, corner / nx % ny, corner / nx / ny][axis];
        sum[at][0] += carried[0];
        sum[at][1] += solid;
    }
    sum.iter().map(|[sum, solid]| if *solid > 0.0 { sum / solid } else { 0.0 }).collect()
}

/// Part of the viscous mobility that Ergun's quadratic term leaves in each cell, under the pressures of the state.
fn slowing(grid: &Grid, state: &GridState, density: f64) -> Vec<f64> {
    let cells = grid.census.cells;
    let mut square = vec![0.0; cells];
    for axis in 0..3 {
        let mut mean = vec![0.0; cells];
        for link in grid.links(axis) {
            let ends = grid.ends[link].map(|end| end as usize);
            let drop = state.pressure[ends[0]] - state.pressure[ends[1]];
            let inside = || ends.into_iter().filter(|&end| end < cells);
            let distance: f64 = inside().map(|cell| 0.5 * grid.size(cell)[axis]).sum();
            for cell in inside() {
                mean[cell] += 0.5 * drop / distance;
            }
        }
        square.iter_mut().zip(mean).for_each(|(sum, mean)| *sum += mean * mean);
    }
    (0..cells)
        .map(|cell| {
            let viscous =
                grid.mobility[cell].element_product().cbrt() / state.slowed.get(cell).copied().unwrap_or(1.0);
            let (n, d) = (grid.porosity[cell], grid.diameter[cell]);
            permeability::slowed(viscous, n, d, density, square[cell].sqrt())
        })
        .collect()
}

/// Takes from the rules of the faces what they impose at the middle of each wall face of the grid, `time` [s] after the
/// stage began.
///
/// # Errors
/// The first place where a formula has no value.
pub fn impose(faces: &[Face; 6], time: f64, scratch: &mut Scratch) -> Result<(), DVec3> {
    let Scratch { made: Some((_, grid)), imposed, .. } = scratch else { return Ok(()) };
    imposed.clear();
    let same = faces.each_ref().map(|face| match &face.water {
        Water::Pressure(signal) | Water::Inflow(signal) if signal.varies_in_space() => None,
        Water::Pressure(signal) | Water::Inflow(signal) => Some(signal.at(time)),
        Water::Sealed => Some(0.0),
    });
    for (w, &face) in grid.wall_face.iter().enumerate() {
        let face = face as usize;
        let value = match (same[face], &faces[face].water) {
            (None, Water::Pressure(signal) | Water::Inflow(signal)) => {
                signal.field(grid.wall_centre(w), time)
            }
            (value, _) => value.unwrap_or(0.0),
        };
        if !value.is_finite() {
            return Err(grid.wall_centre(w));
        }
        imposed.push(value);
    }
    Ok(())
}

/// Solves for the pressures at the end of the step.
///
/// `loads` are those of everything but the pressures, `wall_velocity` is what the walls would do under these and the
/// pressures so far. What the faces impose was told by [`impose`].
///
/// # Errors
/// Those of the solver.
pub fn advance(
    state: &mut GridState,
    around: &Around,
    terms: Terms,
    loads: &Loads,
    wall_velocity: [DVec3; 6],
    scratch: &mut Scratch,
) -> Result<Info, Error> {
    let Scratch { made, system, fits, velocity, pulled, carried, field, imposed, flows } = scratch;
    let Some((_, grid)) = made else { return Err(Error::Memory) };
    let moving = moving(around.grains, terms.kick);
    if pulled.len() != around.grains.len() {
        *pulled = pressure::force(grid, &state.pressure).1;
    }
    grid.corners.sums(&moving.under(&loads.force, pulled), velocity, carried);
    if !*fits || system.as_ref().is_some_and(|system| system.terms != terms) {
        *system = None;
    }
    let system = system.get_or_insert_with(|| System::new(grid, terms));
    *fits = true;
    let outside = pressure::Outside { carried, wall_velocity, imposed };
    let (info, done) = system.advance(grid, &outside, &mut state.pressure, &mut state.change)?;
    *flows = done;
    system.field(grid, &outside, &state.pressure, field);
    Ok(info)
}

/// Permeability of the grid between the two faces across an axis, all others sealed and the grains at rest [m²].
///
/// # Errors
/// What keeps the grid from being made or solved, as a sentence.
pub fn permeability_along(settings: &Darcy, around: &Around, axis: usize) -> Result<f64, String> {
    let (mut water, mut scratch) = (None, Scratch::default());
    follow(&mut water, settings, around, &mut scratch)?;
    let (Some(water), Some((_, grid))) = (&mut water, &scratch.made) else { return Ok(0.0) };
    let terms = Terms {
        kick: 0.0,
        interval: 1.0,
        bulk_modulus: None,
        open: std::array::from_fn(|face| face / 2 == axis),
        pistons: [0.0; 6],
        residual: settings.residual,
    };
    let drop = 1.0;
    let imposed: Vec<f64> =
        grid.wall_face.iter().map(|&face| if face as usize == 2 * axis { drop } else { 0.0 }).collect();
    let carried = vec![[0.0; 4]; grid.corners.len()];
    let outside = pressure::Outside { carried: &carried, wall_velocity: [DVec3::ZERO; 6], imposed: &imposed };
    let (_, flows) = System::new(grid, terms)
        .advance(grid, &outside, &mut water.pressure, &mut water.change)
        .map_err(|error| error.to_string())?;
    let planes = &grid.planes[axis];
    let length = planes[planes.len() - 1] - planes[0];
    let section: f64 = grid
        .wall_link
        .iter()
        .zip(&grid.wall_face)
        .filter(|(_, face)| **face as usize == 2 * axis)
        .map(|(&link, _)| grid.area[link as usize])
        .sum();
    Ok(flows.outflow[2 * axis + 1] * around.fluid[0] * length / (section * drop))
}

/// Adds the forces of the pressures on grains and walls, and the drag of grains that move against the mean of their
/// cell: together Goodarzi's (8), `[beta/(1 - n) (v - v_p) - grad p] V_p` with `v = v_s + w/n`, v_s the mean velocity of
/// the grains, as `beta w/n = -n grad p`.
pub fn add(loads: &mut Loads, state: &GridState, grains: &Grains, scratch: &mut Scratch) {
    let Scratch { made: Some((_, grid)), system: Some(system), pulled, field, .. } = scratch else {
        return;
    };
    let walls = pressure::wall_force(grid, &state.pressure, &system.terms.open);
    for (sum, force) in loads.wall.iter_mut().zip(walls) {
        *sum += force;
    }
    grid.corners.load(field, &moving(grains, system.terms.kick), pulled, &mut loads.force);
}

fn moving(grains: &Grains, kick: f64) -> Moving<'_> {
    Moving { velocity: &grains.velocity, mass: &grains.mass, kick }
}
