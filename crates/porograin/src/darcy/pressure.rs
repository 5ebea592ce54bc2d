//! The pressures: water in each cell is stored, carried by the grains, or flows, all at the end of the step.
//!
//! With `v⁺ = v* + k M⁻¹ S p⁺`, v* what all other forces make of the velocities and k the length of the kick, the balance
//! of every cell is `(G + C/dt + k B) (p⁺ - p) = Q - Sᵀ (v* + k M⁻¹ S p) - G p`: generation by the volumetric strain
//! and dissipation (Goodarzi 3-7) in one backward Euler step with `C = n V/K_f`. `B = Sᵀ M⁻¹ S` makes the drag implicit, so
//! that the water sets no limit to the time step; it is replaced by the sum of each of its rows, link by link, which
//! keeps the pattern of the grid, is exact for a uniform gradient, and touches nothing but the change of pressure
//! within the step.
//!
//! The node of a wall has one link only and is eliminated.

use super::drag::Resistance;
use super::grid::{Grid, Run};
use super::multigrid::{Held, Multigrid};
use super::passes::{Field, Four, Moving, Pull};
use super::stencil::Stencil;
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_linear::{Error, Info, Method, Params, Work, conjugate_gradients};

/// What a system is made for, besides its grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms {
    /// By how much a force changes velocities, times mass [s].
    pub kick: f64,
    /// Over which the water is stored [s].
    pub interval: f64,
    /// Bulk modulus of the water [Pa]; `None`: incompressible.
    pub bulk_modulus: Option<f64>,
    /// Whether the pressure is imposed at each face.
    pub open: [bool; 6],
    /// What a force adds to the velocity of each wall by the end of the kick [m/s per N]; 0 unless a piston.
    pub pistons: [f64; 6],
    /// Residual of the solve, relative to all flows of grains and water between cells.
    pub residual: f64,
}

/// What comes from outside in one step.
pub struct Outside<'a> {
    /// Sum of volume times velocity of the grains around each corner [m⁴/s], before the water's force changes.
    pub carried: &'a [Four],
    /// The velocity of each wall then [m/s].
    pub wall_velocity: [DVec3; 6],
    /// By wall node: the pressure where it is imposed [Pa], elsewhere the inflow per area [m/s].
    pub imposed: &'a [f64],
}

/// What a step did to the water.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flows {
    /// Water that leaves through each face [m³/s].
    pub outflow: [f64; 6],
    /// Water stored by compression [m³/s].
    pub stored: f64,
    /// Volume the walls sweep, outwards [m³/s]: minus the sum of all outflows and of what is stored.
    pub swept: f64,
}

/// The linear system of a grid.
pub struct System {
    /// What it was made for.
    pub terms: Terms,
    stencil: Stencil,
    multigrid: Multigrid,
    work: Work,
    rows: Rows,
    resistance: Resistance,
    /// Nothing holds the level of the pressure: its mean stays what it is.
    level_is_free: bool,
    rhs: Vec<f64>,
    /// Through each link before pressures change.
    flux: Vec<f64>,
    /// Pull of the pressures around each corner.
    pull: [Vec<f64>; 3],
}

/// What the rows of the system are made of [m³/(Pa s)].
struct Rows {
    /// Storage of each cell over the interval.
    storage: Vec<f64>,
    /// `g + k B` of each link.
    stiffened: Vec<f64>,
    /// The wall nodes.
    walls: Vec<Wall>,
    /// What each row sums to: storage and what holds the level of the pressure.
    excess: Vec<f64>,
}

/// A wall node and its link.
struct Wall {
    link: u32,
    /// The cell at the inner end of the link.
    cell: u32,
    face: u8,
    open: bool,
    /// [m²]
    area: f64,
    /// `g + k B` of the link.
    g: f64,
    /// What a piston gives here.
    give: f64,
    /// Part of a flow into the node that goes on to its cell: `g/(g + give)`.
    passed: f64,
}

impl Rows {
    fn new(grid: &Grid, terms: &Terms) -> Rows {
        let storage: Vec<f64> = (0..grid.census.cells)
            .map(|cell| {
                let compliance = terms.bulk_modulus.map_or(0.0, |modulus| grid.porosity[cell] / modulus);
                compliance * grid.volume(cell) / terms.interval
            })
            .collect();
        let mut stiffened = grid.conductance.clone();
        if terms.kick > 0.0 {
            add_inertia(grid, terms.kick, &mut stiffened);
        }
        let nodes = || grid.wall_face.iter().zip(&grid.wall_link);
        let mut swept = [0.0; 6];
        nodes().for_each(|(&face, &link)| swept[face as usize] += grid.area[link as usize]);
        let wall = |(&face, &link): (&u8, &u32)| {
            let (k, area, g) = (face as usize, grid.area[link as usize], stiffened[link as usize]);
            let open = terms.open[k];
            let give = if open { 0.0 } else { terms.pistons[k] * area * swept[k] };
            let [low, high] = grid.ends[link as usize];
            Wall { link, cell: low.min(high), face, open, area, g, give, passed: g / (g + give) }
        };
        let walls: Vec<Wall> = nodes().map(wall).collect();
        let mut excess = storage.clone();
        for wall in &walls {
            excess[wall.cell as usize] += wall.held().excess();
        }
        Rows { storage, stiffened, walls, excess }
    }
}

impl System {
    /// Assembles and prepares the solve.
    pub fn new(grid: &Grid, terms: Terms) -> System {
        let rows = Rows::new(grid, &terms);
        let held: Vec<Held> = rows.walls.iter().map(Wall::held).collect();
        System {
            terms,
            stencil: Stencil::new(grid, &rows.stiffened, &rows.excess),
            multigrid: Multigrid::new(grid, &rows.stiffened, &held, &rows.storage),
            work: Work::default(),
            resistance: Resistance::new(grid, terms.kick),
            level_is_free: rows.excess.iter().all(|&e| e == 0.0),
            rhs: vec![0.0; grid.census.cells],
            flux: vec![0.0; grid.ends.len()],
            pull: Default::default(),
            rows,
        }
    }

    /// Whether only differences of the pressures are known.
    pub fn free_level(&self) -> bool {
        self.level_is_free
    }

    /// Takes the pressures of all nodes [Pa] one step further. `change` is by how much those of the cells changed in the last
    /// step, then in this one: where the solve starts.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn advance(
        &mut self,
        grid: &Grid,
        outside: &Outside,
        pressure: &mut [f64],
        change: &mut [f64],
    ) -> Result<(Info, Flows), Error> {
        let cells = grid.census.cells;
        let size = self.flow(grid, outside.carried, pressure);
        self.rhs.fill(0.0);
        grid.gather(&self.flux, &mut self.rhs);
        let inwards = std::array::from_fn(|face| -outside.wall_velocity[face].dot(NORMALS[face]));
        // What a wall node cannot keep goes to its cell; what a held one changes by drags its cell along.
        for (w, wall) in self.rows.walls.iter().enumerate() {
            self.rhs[wall.cell as usize] += if wall.open {
                wall.g * (outside.imposed[w] - pressure[cells + w])
            } else {
                wall.passed * wall.excess(outside.imposed[w], &inwards, &self.flux)
            };
        }
        if self.level_is_free {
            let mean = self.rhs.iter().sum::<f64>() / cells as f64;
            self.rhs.iter_mut().for_each(|rhs| *rhs -= mean);
        }
        let params = Params {
            method: Method::ConjugateGradients,
            tolerance: self.terms.residual,
            floor: f64::sqrt(size),
            ..Params::default()
        };
        let System { stencil, multigrid, work, rhs, .. } = self;
        let info = conjugate_gradients(stencil, multigrid, rhs, change, &params, work)?;
        // What the solve leaves over, all cells together, is none: the level takes it up, or where it is free keeps its mean.
        let shift = if self.level_is_free {
            let volume: f64 = (0..cells).map(|cell| grid.volume(cell)).sum();
            -change.iter().enumerate().map(|(cell, d)| d * grid.volume(cell)).sum::<f64>() / volume
        } else {
            let taken: f64 =
                self.rows.excess.iter().zip(&*change).map(|(excess, change)| excess * change).sum();
            (self.rhs.iter().sum::<f64>() - taken) / self.rows.excess.iter().sum::<f64>()
        };
        change.iter_mut().for_each(|change| *change += shift);
        Ok((info, self.finish(outside, &inwards, pressure, change)))
    }

    /// The flow through each link under the pressures so far, and the square of the size of all.
    fn flow(&mut self, grid: &Grid, carried: &[Four], pressure: &[f64]) -> f64 {
        let mut size = 0.0;
        for (axis, runs) in grid.runs.iter().enumerate() {
            let across = grid.across(axis);
            for &Run { link, corner, ends, len } in runs {
                let around = across.map(|step| &carried[corner + step..][..len]);
                let [low, high] = ends.map(|end| &pressure[end..][..len]);
                let (hold, conductance) = (&grid.hold[link..][..len], &grid.conductance[link..][..len]);
                for (k, flux) in self.flux[link..][..len].iter_mut().enumerate() {
                    // `Sᵀ v`: the volume of solid and water together that moving grains carry along.
                    let [a, b, c, d] = around.map(|around| around[k][axis]);
                    let carried = hold[k] * ((a + b) + (c + d));
                    let flow = conductance[k] * (low[k] - high[k]);
                    size += carried * carried + flow * flow;
                    *flux = carried + flow;
                }
            }
        }
        size
    }

    /// The pull of the pressures and the drag around each corner.
    pub fn field(&mut self, grid: &Grid, outside: &Outside, pressure: &[f64], field: &mut Vec<Field>) {
        pull(grid, pressure, &mut self.pull);
        self.resistance.around(&self.pull, outside.carried, field);
    }

    /// Changes the pressures and sums up the flows.
    fn finish(&self, outside: &Outside, inwards: &[f64; 6], pressure: &mut [f64], change: &[f64]) -> Flows {
        let cells = change.len();
        let mut flows = Flows::default();
        for (cell, (&change, &storage)) in change.iter().zip(&self.rows.storage).enumerate() {
            pressure[cell] += change;
            flows.stored += storage * change;
        }
        for (w, wall) in self.rows.walls.iter().enumerate() {
            let (face, imposed) = (wall.face as usize, outside.imposed[w]);
            let outwards = -inwards[face];
            let by_cell = wall.g * change[wall.cell as usize];
            let pressure = &mut pressure[cells + w];
            if wall.open {
                let along = wall.along(&self.flux);
                flows.outflow[face] +=
                    along + by_cell - wall.g * (imposed - *pressure) - wall.area * outwards;
                flows.swept += wall.area * outwards;
                *pressure = imposed;
            } else {
                let change = (wall.excess(imposed, inwards, &self.flux) + by_cell) / (wall.g + wall.give);
                *pressure += change;
                flows.outflow[face] -= wall.area * imposed;
                // A piston gives way to the change of pressure.
                flows.swept += wall.area * outwards + wall.give * change;
            }
        }
        flows
    }
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("System").field("terms", &self.terms).finish_non_exhaustive()
    }
}

impl Wall {
    /// What holds the level of the pressure of its cell.
    fn held(&self) -> Held {
        let give = if self.open { f64::INFINITY } else { self.give };
        Held { cell: self.cell as usize, axis: usize::from(self.face) / 2, g: self.g, give }
    }

    /// What flows along the link towards the node.
    fn along(&self, flux: &[f64]) -> f64 {
        let flux = flux[self.link as usize];
        if self.face.is_multiple_of(2) { -flux } else { flux }
    }

    /// Net flux into the node from outside and from its link, before pressures change [m³/s]. `inwards` is the velocity of each
    /// wall.
    fn excess(&self, imposed: f64, inwards: &[f64; 6], flux: &[f64]) -> f64 {
        self.area * (imposed + inwards[self.face as usize]) + self.along(flux)
    }
}

/// Force of the pressures [Pa] per volume of the grains around each corner, component by component.
fn pull(grid: &Grid, pressure: &[f64], pull: &mut [Vec<f64>; 3]) {
    for (axis, sums) in pull.iter_mut().enumerate() {
        sums.clear();
        sums.resize(grid.corners.len(), 0.0);
        let across = grid.across(axis);
        for &Run { link, corner, ends, len } in &grid.runs[axis] {
            let [low, high] = ends.map(|end| &pressure[end..][..len]);
            let hold = &grid.hold[link..][..len];
            for step in across {
                for (k, sum) in sums[corner + step..][..len].iter_mut().enumerate() {
                    *sum += hold[k] * (low[k] - high[k]);
                }
            }
        }
    }
}

/// `S p`: the force of the pressures [Pa] on each grain [N], and the same as it serves to foresee.
pub fn force(grid: &Grid, pressure: &[f64]) -> (Vec<DVec3>, Vec<Pull>) {
    let mut sums = Default::default();
    pull(grid, pressure, &mut sums);
    let of = |k: usize| Field { pull: [sums[0][k], sums[1][k], sums[2][k], 0.0], ..Field::default() };
    let field: Vec<Field> = (0..grid.corners.len()).map(of).collect();
    let grains = grid.corners.grains();
    let (mut pulled, mut force) = (vec![Pull::default(); grains], vec![DVec3::ZERO; grains]);
    let moving = Moving { velocity: &vec![DVec3::ZERO; grains], mass: &vec![1.0; grains], kick: 0.0 };
    grid.corners.load(&field, &moving, &mut pulled, &mut force);
    (force, pulled)
}

/// Force of the pressures [Pa] on each wall [N]; at an open face the water outside pushes back.
pub fn wall_force(grid: &Grid, pressure: &[f64], open: &[bool; 6]) -> [DVec3; 6] {
    let mut force = [DVec3::ZERO; 6];
    for (w, &face) in grid.wall_face.iter().enumerate() {
        let face = face as usize;
        if !open[face] {
            let area = grid.area[grid.wall_link[w] as usize];
            force[face] += area * pressure[grid.census.cells + w] * NORMALS[face];
        }
    }
    force
}

/// Adds `k` times the row sums of `Sᵀ M⁻¹ S` over the links along each axis, every grain as light as the lightest.
///
/// It is at least `k Sᵀ M⁻¹ S`, and so much at least that pressures and drag together never turn a motion round: with
/// `x_v` the parts of the grains around corner v, `s_v` their sum, density rho, the pressures take at most `sum of rho/k x_v x_vᵀ/s_v`
/// and the drag `sum of r_v (diag(x_v) - x_v x_vᵀ/s_v)`, `r_v <= rho/k`, of what the kick would turn, `sum of rho/k diag(x_v)`.
fn add_inertia(grid: &Grid, kick: f64, conductance: &mut [f64]) {
    for axis in 0..3 {
        let across = grid.across(axis);
        let mut hold = vec![0.0; grid.corners.len()];
        grid.each_link(axis, |link, corner| {
            across.iter().for_each(|step| hold[corner + step] += grid.hold[link])
        });
        let give = |corner: usize| grid.corners.solid[corner] * hold[corner];
        grid.each_link(axis, |link, corner| {
            let sum: f64 = across.iter().map(|step| give(corner + step)).sum();
            conductance[link] += kick / grid.density * grid.hold[link] * sum;
        });
    }
}
