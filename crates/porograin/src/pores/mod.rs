//! Water pore by pore: the pore-scale finite volume method (Catalano ch. 3; coupling of `physics` §3b).

pub mod carry;
pub mod conductance;
pub mod coupling;
pub mod detached;
mod four;
pub mod geometric;
pub mod images;
pub mod implicit;
pub mod mesh;
mod patch;
pub mod places;
pub mod pressure;
pub mod pull;
pub mod pushes;
pub mod shear;
pub mod store;
pub mod viscous;

pub use conductance::Conductance;
pub use detached::Detached;
pub use implicit::Memory;
pub use mesh::{Census, Mesh, Walls};
pub use patch::Room;
pub use places::{Block, Places, Point, PointWater};
pub use pressure::System;
pub use pull::Pull;
pub use store::Store;

use crate::boundary::{Domain, Signal};
use crate::grains::Grains;
use glam::{DMat3, DVec3};
use porograin_geometry::Cell;
use porograin_geometry::throat::Packing;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Settings of the pore-scale flow.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Pores {
    /// How a throat conducts.
    #[serde(deserialize_with = "conductance::read")]
    pub conductance: Conductance,
    /// How grains and water feel each other.
    pub coupling: Coupling,
    /// When to make a new mesh.
    pub remesh: Remesh,
    /// Relative residual of the pressure solve, `‖b - G p‖ / ‖b‖` of the volumes carried per second. Tight throats weigh
    /// most in it; the pressures are some twenty times closer than it says.
    pub residual: f64,
    /// How to solve for the pressures.
    pub solver: Solver,
    /// How the drag of the water enters a step.
    pub step: Stepping,
    /// Relative residual of the solve of an implicit step.
    pub implicit_residual: f64,
    /// Whether grains that slide past each other drag the water between them (Catalano 6.29-6.30).
    pub shear_forces: bool,
    /// Macroscopic gradient of the pressure along the periodic axes of the cell [Pa/m].
    pub gradient: [Signal; 3],
    /// Points with a pressure or a source.
    pub point: Vec<Point>,
    /// Regions that let no water through.
    pub blocked: Vec<Block>,
}

impl Default for Pores {
    fn default() -> Self {
        Pores {
            conductance: Conductance::default(),
            coupling: Coupling::Reciprocal,
            remesh: Remesh::default(),
            residual: 1e-3,
            solver: Solver::Auto,
            step: Stepping::Auto,
            implicit_residual: implicit::RESIDUAL,
            shear_forces: false,
            gradient: [0.0; 3].map(Signal::Constant),
            point: Vec::new(),
            blocked: Vec::new(),
        }
    }
}

/// How grains and water feel each other.
#[derive(Default, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coupling {
    /// Forces and volume rates from one set of coefficients: the water cannot give energy.
    #[default]
    Reciprocal,
    /// Volume rates of the tetrahedra, forces by wetted surface (Catalano), for comparison.
    Geometric,
}

/// When to make a new mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Remesh {
    /// As soon as the volume of any pore has changed by this much since the last mesh [-] (Catalano 5.13-5.14).
    pub strain: f64,
}

impl Default for Remesh {
    fn default() -> Self {
        Remesh { strain: 0.01 }
    }
}

/// How the drag of the water enters a step.
#[derive(Default, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stepping {
    /// Implicit where the water would shorten an explicit step much; chosen with each mesh.
    #[default]
    Auto,
    /// From the velocities before the step: cheap, but the water limits the step.
    Explicit,
    /// Together with the velocities after the step: the water does not limit the step.
    Implicit,
}

/// How to solve for the pressures.
#[derive(Default, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Solver {
    /// By size.
    #[default]
    Auto,
    /// Sparse factorisation.
    Cholesky,
    /// Preconditioned conjugate gradients.
    Cg,
    /// Over-relaxed Gauss-Seidel sweeps, the baseline of the thesis: slow.
    GaussSeidel,
}

impl Solver {
    /// The method of the linear solver.
    pub fn method(self) -> porograin_linear::Method {
        match self {
            Solver::Auto => porograin_linear::Method::Auto,
            Solver::Cholesky => porograin_linear::Method::Cholesky,
            Solver::Cg => porograin_linear::Method::ConjugateGradients,
            Solver::GaussSeidel => porograin_linear::Method::GaussSeidel,
        }
    }
}

/// What a mesh is made of, besides grains; a change of any of it calls for a new one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// What the walls are to the water.
    pub walls: Walls,
    /// How a throat conducts.
    pub conductance: Conductance,
    /// How grains and water feel each other.
    pub coupling: Coupling,
    /// [Pa s]
    pub viscosity: f64,
    /// Bulk modulus of the water [Pa]; `None`: incompressible.
    pub bulk_modulus: Option<f64>,
    /// Points and blocked regions.
    pub places: Places,
    /// Whether neighbours drag the water between them.
    pub shear_forces: bool,
}

/// Grains and cell as a mesh knows them.
#[derive(Clone, Debug)]
pub struct Beside<'a> {
    /// The cell.
    pub cell: Cell,
    /// Centres of the grains [m].
    pub position: Cow<'a, [DVec3]>,
    /// Radii of the grains [m].
    pub radius: &'a [f64],
}

impl Beside<'_> {
    /// The same for the geometry.
    pub fn packing(&self) -> Packing<'_> {
        Packing { cell: &self.cell, position: &self.position, radius: self.radius }
    }
}

/// What a restart needs of the water: the mesh is made again from the grains as they were when it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoreState {
    /// What the mesh was made of.
    pub recipe: Recipe,
    /// The step at which it was made.
    pub made_at_step: u64,
    /// Grain centres when it was made [m].
    pub mesh_position: Vec<DVec3>,
    /// The box when it was made.
    pub mesh_cell: Cell,
    /// How many periods each grain had been taken back by when it was made.
    pub mesh_crossed: Vec<[i32; 3]>,
    /// How fast the water damps the grains at most [1/s]: what it leaves of the time step.
    pub viscous_rate: f64,
    /// How fast the shear of the water between neighbours damps the grains at most [1/s]: it limits steps of any kind.
    pub shear_rate: f64,
    /// What an implicit step keeps; `None` while steps are explicit.
    pub implicit: Option<Memory>,
    /// What compressible water keeps; `None` where it is incompressible.
    pub store: Option<Store>,
    /// Excess pressure of each node [Pa].
    pub pressure: Vec<f64>,
    /// The same one and two steps before [Pa]: where the next solve starts from.
    pub before: [Vec<f64>; 2],
}

impl PoreState {
    /// The grains as they are now, each in the period in which the mesh knows it, with period vectors that lead to the
    /// images the mesh means.
    pub fn beside<'a>(&self, grains: &'a Grains, domain: &Domain) -> Beside<'a> {
        let cell = domain.cell;
        let mut beside = Beside { cell, position: Cow::Borrowed(&grains.position), radius: &grains.radius };
        if domain.is_periodic() {
            // Since the mesh was made the cell has deformed a little, and may have chosen other vectors of the same lattice.
            let basis = cell.edges.inverse() * self.mesh_cell.edges;
            let whole = DMat3::from_cols(basis.x_axis.round(), basis.y_axis.round(), basis.z_axis.round());
            beside.cell.edges = cell.edges * whole;
            let back = |(k, &now): (usize, &DVec3)| {
                let then = self.mesh_crossed.get(k).copied().unwrap_or_default();
                domain.unwrapped(k, now) - beside.cell.edges * DVec3::from(then.map(f64::from))
            };
            beside.position = grains.position.iter().enumerate().map(back).collect();
        }
        beside
    }

    /// How steps are made since the mesh was.
    pub fn stepping(&self) -> Stepping {
        if self.implicit.is_some() { Stepping::Implicit } else { Stepping::Explicit }
    }
}
