//! From a case to what a simulation starts with: the state, the model of each stage, and when each stage ends.

use super::{Case, CaseError, Cloud, Packing, StageTable, StageWater, Until};
use crate::boundary::{Domain, Signal};
use crate::cell;
use crate::compaction::Compact;
use crate::contact::{Contacts, Laws};
use crate::grains::{Grains, Shape};
use crate::growth::Grow;
use crate::import::{self, Spheres};
use crate::model::Model;
use crate::packing::{self, Grading};
use crate::rain::{Kind, Rain};
use crate::state::State;
use crate::trouble::On;
use crate::walls::Place;
use crate::watch::Measure;
use glam::{DMat3, DVec3};
use porograin_geometry::{Cell, Period};

/// Local damping of a dry stage when the case does not say (Catalano 2.15).
const DRY_DAMPING: f64 = 0.2;

/// What a simulation of a case starts with.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The state at time 0.
    pub state: State,
    /// The stages in order.
    pub stages: Vec<Stage>,
}

/// One stage, complete.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Its name.
    pub name: String,
    /// What a step reads during it; `stage_start` is set when the stage begins.
    pub model: Model,
    /// Gravity [m/s²], a function of the time since the stage began.
    pub gravity: [Signal; 3],
    /// When it ends.
    pub until: Until,
    /// What to do about signs of trouble.
    pub on: On,
    /// Grains to let fall.
    pub rain: Option<Rain>,
    /// What they are made of.
    pub kinds: Vec<Kind>,
    /// What to grow the grains to.
    pub grow: Option<Grow>,
    /// The porosity to compact to.
    pub compact: Option<Compact>,
    /// Whether to compare it with Terzaghi's theory.
    pub consolidation: bool,
}

/// A vector of signals at the time `t` since the stage began.
pub fn at(signals: &[Signal; 3], t: f64) -> DVec3 {
    DVec3::from_array(signals.each_ref().map(|signal| signal.at(t)))
}

impl Case {
    /// The model of stage `k`, which begins at time `start`: the case with the overrides of the stage.
    pub fn model(&self, k: usize, start: f64) -> Model {
        let stage = &self.stage[k];
        let mut contact = Laws {
            all: stage.contact.clone().unwrap_or_else(|| self.contact.clone()),
            pairs: self.pair_laws(),
            conserving: stage.conserve_energy.unwrap_or(self.conserve_energy),
        };
        if let Some(angle) = stage.friction {
            contact.set_friction(angle);
        }
        let mut faces = Default::default();
        self.face.apply(&mut faces);
        stage.face.apply(&mut faces);
        let fluid = match &stage.fluid {
            Some(StageWater::Present(false)) => None,
            Some(StageWater::Present(true)) | None => self.fluid.clone(),
            Some(StageWater::Other(liquid)) => self.fluid.clone().map(|mut fluid| {
                fluid.viscosity = liquid.viscosity.unwrap_or(fluid.viscosity);
                fluid.density = liquid.density.unwrap_or(fluid.density);
                fluid.bulk_modulus = liquid.bulk_modulus.or(fluid.bulk_modulus);
                fluid.flow = liquid.flow.clone().unwrap_or(fluid.flow);
                fluid
            }),
        };
        let default_damping = if fluid.is_some() { 0.0 } else { DRY_DAMPING };
        Model {
            time_step: stage.time_step.unwrap_or(self.time_step),
            gravity: at(&self.gravity_of(k), 0.0),
            contact,
            damping: stage.damping.or(self.damping).unwrap_or(default_damping),
            faces,
            walls: self.walls_in(k),
            membrane: stage.membrane.clone().or_else(|| self.membrane.clone()),
            cell: stage.cell.clone().or_else(|| self.cell.clone()).unwrap_or_default(),
            fluid,
            stage_start: start,
        }
    }

    /// Gravity during stage `k`.
    pub(super) fn gravity_of(&self, k: usize) -> [Signal; 3] {
        self.stage[k].gravity.clone().unwrap_or_else(|| self.gravity.clone())
    }

    /// The low and the high corner of the box [m].
    pub fn corners(&self) -> (DVec3, DVec3) {
        let lower = DVec3::from_array(self.domain.origin);
        (lower, lower + DVec3::from_array(self.domain.size))
    }

    /// The box or the period at the start, its period vectors well chosen.
    pub fn cell(&self) -> Cell {
        let (lower, upper) = self.corners();
        let mut cell = Cell { periodic: self.domain.periodic.0, ..Cell::walled(lower, upper) };
        if let Some(periods) = self.domain.periods {
            cell.edges = DMat3::from_cols_array_2d(&periods);
            cell::shape(&mut cell, |_, _, _| ());
        }
        cell
    }

    /// Makes the grains and the stages.
    ///
    /// # Errors
    /// A grain file that cannot be read, grains outside the box, too big for it or deep inside each other.
    pub fn plan(&self) -> Result<Plan, CaseError> {
        let cell = self.cell();
        let mut grains = self.make_grains()?;
        self.assign_materials(&mut grains);
        let grains = packing::ordered(&cell, grains);
        self.roomy(&cell, &grains)?;
        self.clear_of_walls(&grains)?;
        let state = State {
            time: 0.0,
            step: 0,
            dt: 0.0,
            domain: Domain { walls: vec![Place::default(); self.wall.len()], ..Domain::of(cell) },
            grains,
            contacts: Contacts::default(),
            fluid: None,
        };
        Ok(Plan { state, stages: self.stages() })
    }

    /// The stages, complete.
    pub fn stages(&self) -> Vec<Stage> {
        let complete = |(k, stage): (usize, &StageTable)| Stage {
            name: stage.name.clone(),
            model: self.model(k, 0.0),
            gravity: self.gravity_of(k),
            until: stage.until.clone(),
            on: stage.on.unwrap_or(self.on),
            rain: stage.rain.clone(),
            kinds: self.kinds(),
            grow: stage.grow,
            compact: stage.compact,
            consolidation: stage.consolidation,
        };
        self.stage.iter().enumerate().map(complete).collect()
    }

    /// Whether some watch has this measure.
    pub fn watches(&self, measure: Measure) -> bool {
        self.watch.iter().any(|watch| watch.measures.contains(&measure))
    }

    /// The sizes asked for, where the grains are a cloud.
    pub fn grading(&self) -> Option<Grading> {
        match &self.grains.packing {
            Packing::Cloud(cloud) => Some(cloud.grading()),
            Packing::Lattice(_) | Packing::File(_) | Packing::Empty => None,
        }
    }

    fn shape(&self) -> Shape {
        if self.domain.discs { Shape::Disc { thickness: self.domain.size[1] } } else { Shape::Sphere }
    }

    fn make_grains(&self) -> Result<Grains, CaseError> {
        let density = self.grains.density;
        match &self.grains.packing {
            Packing::Lattice(lattice) => {
                let position = match lattice.arrangement {
                    Some(kind) => packing::lattice(kind, &self.cell(), lattice.radius).map_err(|misfit| {
                        let sentence = format!(
                            "the period of the cell along {} is no whole number of periods of the lattice, {:.6e} m: {} of \
                             them are {:.6e} m",
                            ["x", "y", "z"][misfit.axis],
                            misfit.period,
                            misfit.nearest,
                            misfit.nearest * misfit.period
                        );
                        self.source.fault(&format!("domain.size.{}", misfit.axis), sentence)
                    })?,
                    None => spread(lattice.count.unwrap_or_default(), &self.cell()),
                };
                if position.is_empty() {
                    let sentence = format!("no sphere of radius {} m fits into the box", lattice.radius);
                    return Err(self.source.fault("grains.packing.lattice.radius", sentence));
                }
                let radius = vec![lattice.radius; position.len()];
                Ok(Grains::shaped(self.shape(), position, radius, density))
            }
            Packing::Cloud(cloud) => self.make_cloud(cloud),
            Packing::Empty => Ok(Grains { shape: self.shape(), ..Grains::default() }),
            Packing::File(file) => {
                let path = self.whereabouts(file);
                let name = path.display().to_string();
                let text =
                    import::read(&path).map_err(|e| self.source.fault("grains.packing.file", e.sentence))?;
                let spheres = import::spheres(&name, &text)?;
                let spheres = self.placed(spheres, &name, &text)?;
                let grains = Grains::shaped(self.shape(), spheres.position, spheres.radius, density);
                Ok(Grains { velocity: spheres.velocity, ..grains })
            }
        }
    }

    /// Grains of a file checked against the domain; those of a cell given by its periods may stand in any image of it.
    fn placed(&self, mut spheres: Spheres, name: &str, text: &str) -> Result<Spheres, CaseError> {
        let (cell, (mut lower, mut upper)) = (self.cell(), self.corners());
        if self.domain.periods.is_none() {
            spheres.within(name, text, lower, upper)?;
            return Ok(spheres);
        }
        spheres.within_period(name, text, &cell)?;
        let extent = spheres.position.iter().fold(DVec3::ZERO, |most, x| most.max((*x - cell.origin).abs()));
        for axis in (0..3).filter(|&axis| cell.periodic[axis]) {
            lower[axis] -= extent[axis];
            upper[axis] += extent[axis];
        }
        spheres.within(name, text, lower, upper)?;
        if let Some(period) = Period::of(&cell) {
            spheres.position.iter_mut().for_each(|x| *x -= period.shift(period.beyond(*x)));
        }
        Ok(spheres)
    }

    /// The cell, or the part of it that a cloud fills.
    fn part_of_cell(&self, cloud: &Cloud) -> Cell {
        let (cell, (lower, upper)) = (self.cell(), self.corners());
        let Some([low, high]) = cloud.within.map(|corners| corners.map(DVec3::from_array)) else {
            return cell;
        };
        let whole = |axis: usize| low[axis] == lower[axis] && high[axis] == upper[axis];
        Cell { periodic: [0, 1, 2].map(|axis| cell.periodic[axis] && whole(axis)), ..Cell::walled(low, high) }
    }

    fn make_cloud(&self, cloud: &Cloud) -> Result<Grains, CaseError> {
        let Some(amount) = cloud.amount() else {
            return Err(self.source.fault("grains.packing.cloud", "the cloud has no count and no sizes"));
        };
        packing::graded_cloud(
            &self.part_of_cell(cloud),
            &cloud.grading(),
            amount,
            cloud.seed,
            self.grains.density,
        )
        .map_err(|e| self.source.fault("grains.packing.cloud", e.to_string()))
    }
}

/// Centres of a lattice spread evenly over the box: simple cubic, and leaning with a cell that leans.
fn spread([nx, ny, nz]: [usize; 3], cell: &Cell) -> Vec<DVec3> {
    let count = DVec3::new(nx as f64, ny as f64, nz as f64);
    let pitch = DMat3::from_cols(
        cell.edges.x_axis / count.x,
        cell.edges.y_axis / count.y,
        cell.edges.z_axis / count.z,
    );
    let mut position = Vec::with_capacity(nx * ny * nz);
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                position.push(cell.origin + pitch * (DVec3::new(x as f64, y as f64, z as f64) + 0.5));
            }
        }
    }
    position
}
