//! Watchers: which measures go into the history, and when.

use crate::boundary::Water;
use crate::darcy::Grid;
use crate::fluid;
use crate::grains::Loads;
use crate::ledger::Ledger;
use crate::measure::{self, CoarseFlow, PoreFlow, Site, Walk};
use crate::model::Model;
use crate::pores::{Beside, Mesh};
use crate::progress::Began;
use crate::state::State;
use crate::step::Report;
use crate::walls::Place;
use glam::DVec3;
use porograin_geometry::throat::Packing;
use serde::{Deserialize, Serialize};

/// When to do something again and again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Every {
    /// Each time so many simulated seconds have passed.
    Seconds(f64),
    /// Each time so many steps are done.
    Steps(u64),
}

impl Every {
    /// The number of the interval that `time` and `step` are in: something is due when it changes.
    pub fn interval(&self, time: f64, step: u64) -> u64 {
        match *self {
            // Times are sums of steps: one part in 10⁹ keeps a sum that falls just short in the interval it is meant for.
            Every::Seconds(seconds) => (time / seconds * (1.0 + 1e-9)) as u64,
            Every::Steps(steps) => step / steps.max(1),
        }
    }
}

/// Some measures, and when to write them into the history.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Watch {
    /// What to measure.
    pub measures: Vec<Measure>,
    /// When.
    pub every: Every,
}

/// What can be watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Void part of the box.
    Porosity,
    /// Void part of each region that the case names.
    Regions,
    /// Diameters that a tenth, 30, 50, 60 and 90 % of the mass are finer than.
    Grading,
    /// Lengths of the box.
    Size,
    /// How far the top face has come down since the stage began.
    Settlement,
    /// Height of the highest point of all grains.
    Surface,
    /// Mean resultant on a grain over mean contact force (Catalano 2.16).
    Unbalanced,
    /// Normal stress on each face, grains and water together.
    FaceStress,
    /// Force on each face, grains and water together.
    FaceForce,
    /// Force of the grains on each wall that the case adds, and its moment about the wall's centre.
    WallForce,
    /// Area of the membrane and volume inside it.
    Membrane,
    /// Mean stress carried by the contacts.
    Stress,
    /// All nine components of it.
    StressTensor,
    /// The velocity gradient of the periodic cell, summed over time.
    CellStrain,
    /// Mean and deviator of the stress carried by the contacts.
    Deviator,
    /// Shortening of the box and its loss of volume since the stage began.
    Compression,
    /// Fabric tensor of the contacts between grains.
    Fabric,
    /// Number of contacts, mean number per grain, grains that carry nothing.
    Contacts,
    /// Directions of contacts and forces.
    Directions,
    /// Solid fraction and velocity in layers from bottom to top.
    Profile,
    /// Kinetic energy of the grains.
    KineticEnergy,
    /// Energy stored in the contacts.
    ElasticEnergy,
    /// Work and losses since the stage began, and what does not balance.
    EnergyBudget,
    /// Largest speed of a grain.
    Speed,
    /// Length of the step.
    TimeStep,
    /// Mean, least and greatest excess pressure of the pores, or of the cells of a grid.
    Pressure,
    /// Mean excess pressure at 13 heights between bottom and top.
    PressureProfile,
    /// Water that leaves through each face.
    Outflow,
    /// Water that flows past the grains, per area of the sample.
    Discharge,
    /// Share of the water in the stress of a periodic cell.
    WaterStress,
    /// Mean excess pressure at 13 places between left and right.
    PressureProfileX,
    /// Mean excess pressure at 13 places between front and back.
    PressureProfileY,
}

/// The names that some measures have a column for each of.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Names {
    /// Of the walls that the case adds.
    pub walls: Vec<String>,
    /// Of its regions.
    pub regions: Vec<String>,
}

/// Heights at which profiles are taken, both ends included.
pub const PROFILE_POINTS: usize = 13;

impl Measure {
    /// All of them.
    pub const ALL: [Measure; 32] = [
        Measure::Porosity,
        Measure::Regions,
        Measure::Grading,
        Measure::Size,
        Measure::Settlement,
        Measure::Surface,
        Measure::Unbalanced,
        Measure::FaceStress,
        Measure::FaceForce,
        Measure::WallForce,
        Measure::Membrane,
        Measure::Stress,
        Measure::StressTensor,
        Measure::CellStrain,
        Measure::Deviator,
        Measure::Compression,
        Measure::Fabric,
        Measure::Contacts,
        Measure::Directions,
        Measure::Profile,
        Measure::KineticEnergy,
        Measure::ElasticEnergy,
        Measure::EnergyBudget,
        Measure::Speed,
        Measure::TimeStep,
        Measure::Pressure,
        Measure::PressureProfile,
        Measure::Outflow,
        Measure::Discharge,
        Measure::WaterStress,
        Measure::PressureProfileX,
        Measure::PressureProfileY,
    ];

    /// Its name in case files.
    pub fn name(self) -> String {
        let camel = format!("{self:?}");
        let mut name = String::new();
        for (k, c) in camel.chars().enumerate() {
            if k > 0 && c.is_uppercase() {
                name.push('-');
            }
            name.extend(c.to_lowercase());
        }
        name
    }

    /// What it is, in one line.
    pub fn describe(self) -> &'static str {
        match self {
            Measure::Porosity => "void part of the box",
            Measure::Regions => "void part of each [[region]]",
            Measure::Grading => "diameters that 10, 30, 50, 60 and 90 % of the mass are finer than",
            Measure::Size => "lengths of the box",
            Measure::Settlement => "how far the top face has come down since the stage began",
            Measure::Surface => "height of the highest point of all grains",
            Measure::Unbalanced => "mean resultant on a grain over mean contact force",
            Measure::FaceForce => "force on each face, grains and water together",
            Measure::FaceStress => {
                "normal stress on each face, grains and water together, compression positive"
            }
            Measure::Membrane => "area of the membrane and volume inside it",
            Measure::WallForce => {
                "force of the grains on each wall that the case adds, and its moment about the wall's centre"
            }
            Measure::Stress => "mean stress carried by the contacts along x, y, z, compression positive",
            Measure::StressTensor => {
                "mean stress carried by the contacts: force along the first letter on what lies further along the second"
            }
            Measure::CellStrain => {
                "velocity gradient of the periodic cell summed over time, extension positive"
            }
            Measure::Deviator => "mean and deviator sqrt(3/2 s:s) of the stress carried by the contacts",
            Measure::Compression => {
                "shortening along x, y, z and loss of volume since the stage began, compression positive"
            }
            Measure::Fabric => "fabric tensor of the contacts between grains, a third each when isotropic",
            Measure::Contacts => "number of contacts, mean number per grain, grains that carry nothing",
            Measure::Directions => {
                "contacts between grains by angle to the vertical, in ten classes from horizontal to vertical: density, mean normal \
                 and tangential force"
            }
            Measure::Profile => "solid fraction and mean velocity in twelve layers from bottom to top",
            Measure::KineticEnergy => "kinetic energy of the grains, turning included",
            Measure::ElasticEnergy => "energy stored in the contacts",
            Measure::EnergyBudget => {
                "since the stage began: work of walls, periodic cell, membrane, gravity and water, losses by friction, dampers, \
                 local damping and time integration, and what does not balance (not with glue)"
            }
            Measure::Speed => "largest speed of a grain",
            Measure::TimeStep => "length of the step",
            Measure::Pressure => {
                "mean, least and greatest excess pressure of the pores, or of the cells of a grid"
            }
            Measure::PressureProfile => "mean excess pressure at 13 heights, bottom to top",
            Measure::Outflow => "water leaving through each face",
            Measure::Discharge => "flux of the water past the grains per area of the sample, along x, y, z",
            Measure::WaterStress => {
                "share of the water in the stress of a periodic cell, compression positive: what the pores press on it"
            }
            Measure::PressureProfileX => "mean excess pressure at 13 places, left to right",
            Measure::PressureProfileY => "mean excess pressure at 13 places, front to back",
        }
    }

    /// Whether it is empty in a dry stage.
    pub fn needs_water(self) -> bool {
        use Measure::{
            Discharge, Outflow, Pressure, PressureProfile, PressureProfileX, PressureProfileY, WaterStress,
        };
        matches!(
            self,
            Pressure
                | PressureProfile
                | PressureProfileX
                | PressureProfileY
                | Outflow
                | Discharge
                | WaterStress
        )
    }

    /// Heads of its columns, with units.
    pub fn columns(self, names: &Names) -> Vec<String> {
        let faces = |name: &str, unit: &str| -> Vec<String> {
            crate::boundary::FACE_NAMES.iter().map(|face| format!("{name}_{face} [{unit}]")).collect()
        };
        let list = |names: &[&str]| names.iter().map(|&n| n.to_owned()).collect();
        match self {
            Measure::Porosity => list(&["porosity [-]"]),
            Measure::Regions => names.regions.iter().map(|name| format!("porosity_{name} [-]")).collect(),
            Measure::Grading => measure::PASSING.map(|part| format!("d{:.0} [m]", 100.0 * part)).to_vec(),
            Measure::Size => list(&["size_x [m]", "size_y [m]", "size_z [m]"]),
            Measure::Settlement => list(&["settlement [m]"]),
            Measure::Surface => list(&["surface [m]"]),
            Measure::Unbalanced => list(&["unbalanced [-]"]),
            Measure::FaceStress => faces("stress", "Pa"),
            Measure::FaceForce => {
                let of = |face: &&str| ["x", "y", "z"].map(|c| format!("force_{face}_{c} [N]"));
                crate::boundary::FACE_NAMES.iter().flat_map(of).collect()
            }
            Measure::Membrane => list(&["membrane_area [m2]", "membrane_volume [m3]"]),
            Measure::WallForce => {
                let of = |wall: &String| {
                    let name = |kind: &str, unit: &str| {
                        ["x", "y", "z"].map(|c| format!("{kind}_{c}_{wall} [{unit}]"))
                    };
                    [name("force", "N"), name("moment", "N m")].concat()
                };
                names.walls.iter().flat_map(of).collect()
            }
            Measure::Deviator => list(&["mean_stress [Pa]", "deviator [Pa]"]),
            Measure::Compression => list(&[
                "compression_x [-]",
                "compression_y [-]",
                "compression_z [-]",
                "compression_volume [-]",
            ]),
            Measure::Fabric => crate::cell::COMPONENTS.map(|c| format!("fabric_{c} [-]")).to_vec(),
            Measure::Contacts => list(&["contacts [-]", "coordination [-]", "rattlers [-]"]),
            Measure::Stress => list(&["stress_xx [Pa]", "stress_yy [Pa]", "stress_zz [Pa]"]),
            Measure::StressTensor => {
                crate::cell::COMPONENTS.map(|c| format!("stress_tensor_{c} [Pa]")).to_vec()
            }
            Measure::CellStrain => crate::cell::COMPONENTS.map(|c| format!("strain_{c} [-]")).to_vec(),
            Measure::Directions => ["contacts", "normal", "tangential"]
                .iter()
                .flat_map(|kind| (0..measure::CLASSES).map(move |k| format!("{kind}_{k} [-]")))
                .collect(),
            Measure::Profile => {
                let solid = (0..measure::LAYERS).map(|k| format!("solid_{k} [-]"));
                let along =
                    |c: &'static str| (0..measure::LAYERS).map(move |k| format!("velocity_{c}_{k} [m/s]"));
                solid.chain(["x", "y", "z"].into_iter().flat_map(along)).collect()
            }
            Measure::KineticEnergy => list(&["kinetic_energy [J]"]),
            Measure::ElasticEnergy => list(&["elastic_energy [J]"]),
            Measure::EnergyBudget => list(&[
                "wall_work [J]",
                "cell_work [J]",
                "membrane_work [J]",
                "gravity_work [J]",
                "water_work [J]",
                "friction_loss [J]",
                "viscous_loss [J]",
                "damping_loss [J]",
                "integration_loss [J]",
                "energy_error [J]",
            ]),
            Measure::Speed => list(&["speed_max [m/s]"]),
            Measure::TimeStep => list(&["dt [s]"]),
            Measure::Pressure => list(&["pressure_mean [Pa]", "pressure_min [Pa]", "pressure_max [Pa]"]),
            Measure::PressureProfile => (0..PROFILE_POINTS).map(|k| format!("pressure_{k} [Pa]")).collect(),
            Measure::Outflow => faces("outflow", "m3/s"),
            Measure::Discharge => list(&["discharge_x [m/s]", "discharge_y [m/s]", "discharge_z [m/s]"]),
            Measure::WaterStress => {
                crate::cell::COMPONENTS.map(|c| format!("water_stress_{c} [Pa]")).to_vec()
            }
            Measure::PressureProfileX => {
                (0..PROFILE_POINTS).map(|k| format!("pressure_x_{k} [Pa]")).collect()
            }
            Measure::PressureProfileY => {
                (0..PROFILE_POINTS).map(|k| format!("pressure_y_{k} [Pa]")).collect()
            }
        }
    }
}

/// One instant of a run, just after a step.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Name of the stage.
    pub stage: &'a str,
    /// The state.
    pub state: &'a State,
    /// What the step read.
    pub model: &'a Model,
    /// How the stage began.
    pub began: &'a Began,
    /// Where the grains were when the stage began, in order of their id [m].
    pub places: &'a [DVec3],
    /// Work and losses of the stage, where the case watches them.
    pub ledger: Option<&'a Ledger>,
    /// The regions that the case names, in its order.
    pub regions: &'a [measure::Region],
    /// Loads of the step.
    pub loads: &'a Loads,
    /// What the water was computed with.
    pub water: &'a fluid::Scratch,
    /// What the step did.
    pub report: &'a Report,
}

impl Snapshot<'_> {
    /// The pores and the pressure of each node [Pa], in a stage with pores.
    pub fn pores(&self) -> Option<(&Mesh, &[f64])> {
        Some((self.water.mesh()?, &self.state.pores()?.pressure))
    }

    /// What a macroscopic gradient adds to the pressure at a place [Pa].
    pub fn macroscopic(&self, x: DVec3) -> f64 {
        self.water.gradient().dot(x - self.state.domain.cell.origin)
    }

    /// The grains beside the pores, in a stage with pores.
    pub fn beside(&self) -> Option<Beside<'_>> {
        Some(self.state.pores()?.beside(&self.state.grains, &self.state.domain))
    }

    /// The pores with their grains where they are now.
    pub fn site<'b>(&'b self, beside: &'b Beside) -> Option<Site<'b>> {
        let (mesh, water) = (self.water.mesh()?, self.state.pores()?);
        let then = Packing {
            cell: &water.mesh_cell,
            position: &water.mesh_position,
            radius: &self.state.grains.radius,
        };
        Some(Site::moved(beside.packing(), then, mesh))
    }

    /// What flows through them.
    pub fn pore_flow(&self, site: &Site) -> Option<PoreFlow> {
        let (flux, entering) = self.water.flows(self.state)?;
        let open = self.model.faces.each_ref().map(|face| !matches!(face.water, Water::Sealed));
        Some(PoreFlow::new(site, &flux, &entering, open))
    }

    /// How grains and walls move beside the pores, where each grain is named in the period that the pores know it in.
    pub fn walk<'b>(&self, beside: &Beside, velocity: &'b mut Vec<DVec3>) -> Walk<'b> {
        let State { grains, domain, .. } = self.state;
        let image = |((&v, &x), &now): ((&DVec3, &DVec3), &DVec3)| v + domain.gradient * (now - x);
        velocity.clear();
        velocity.extend(grains.velocity.iter().zip(&grains.position).zip(beside.position.iter()).map(image));
        Walk { grain: velocity, wall: domain.wall_velocity, gradient: domain.gradient }
    }

    /// What flows through the grid, in a stage with coarse water.
    pub fn coarse_flow(&self) -> Option<CoarseFlow<'_>> {
        let State { grains, domain, .. } = self.state;
        Some(CoarseFlow::new(self.water.darcy.grid()?, self.state.grid()?, grains, &domain.cell))
    }

    /// The grid and the pressure of each cell and wall face [Pa], in a stage with coarse water.
    pub fn grid(&self) -> Option<(&Grid, &[f64])> {
        Some((self.water.darcy.grid()?, &self.state.grid()?.pressure))
    }
}

impl Measure {
    /// Its values now, one per column; `None` when there is nothing to measure.
    pub fn evaluate(self, now: &Snapshot) -> Option<Vec<f64>> {
        let State { domain, grains, contacts, .. } = now.state;
        Some(match self {
            Measure::Porosity => vec![measure::porosity(now.state)],
            Measure::Regions => {
                now.regions.iter().map(|region| measure::region_porosity(now.state, region)).collect()
            }
            Measure::Grading => measure::PASSING.map(|part| measure::diameter(grains, part)).to_vec(),
            Measure::Size => {
                // Of periods that lean, how far each goes along its own axis.
                let edges = domain.cell.edges;
                vec![edges.x_axis.x, edges.y_axis.y, edges.z_axis.z]
            }
            Measure::Settlement => vec![now.began.settlement(now.state)],
            Measure::Surface => {
                let tops = grains.position.iter().zip(&grains.radius).map(|(x, r)| x.z + r);
                vec![tops.fold(f64::NEG_INFINITY, f64::max)]
            }
            Measure::Unbalanced => vec![measure::unbalanced(now.state, now.model, now.loads)],
            Measure::FaceStress => measure::wall_stress(domain).to_vec(),
            Measure::FaceForce => domain.wall_force.iter().flat_map(|force| force.to_array()).collect(),
            Measure::Membrane if domain.skin.made_at_step.is_none() => return None,
            Measure::Membrane => domain.skin.area_and_volume(grains).to_vec(),
            Measure::WallForce => {
                let of = |place: &Place| [place.force.to_array(), place.moment.to_array()].concat();
                domain.walls.iter().flat_map(of).collect()
            }
            Measure::Deviator => measure::invariants(measure::contact_stress(now.state, now.model)).to_vec(),
            Measure::Compression => measure::compression(now.began.edges, domain.cell.edges).to_vec(),
            Measure::Fabric => measure::fabric(now.state, now.model).transpose().to_cols_array().to_vec(),
            Measure::Contacts => {
                let rattlers = measure::rattlers(now.state) as f64;
                vec![contacts.len() as f64, measure::coordination(now.state), rattlers]
            }
            Measure::Stress => {
                let s = measure::contact_stress(now.state, now.model);
                vec![s.x_axis.x, s.y_axis.y, s.z_axis.z]
            }
            Measure::StressTensor => {
                measure::contact_stress(now.state, now.model).transpose().to_cols_array().to_vec()
            }
            Measure::CellStrain => domain.strain.transpose().to_cols_array().to_vec(),
            Measure::Directions => {
                let found = measure::directions(now.state, now.model);
                [found.contacts, found.normal, found.tangential].concat()
            }
            Measure::Profile => {
                let found = measure::profile(now.state);
                let along = |axis: usize| found.velocity.map(|v| v[axis]);
                [found.solid, along(0), along(1), along(2)].concat()
            }
            Measure::KineticEnergy => vec![measure::kinetic_energy_beside(now.state)],
            Measure::ElasticEnergy => vec![measure::elastic_energy(now.state, now.model)],
            Measure::EnergyBudget => {
                // It stands still from the step on in which grains were glued.
                let ledger = now.ledger.filter(|ledger| ledger.start.is_some() && domain.glue.is_empty())?;
                let Ledger { walls, cell, membrane, gravity, water, .. } = *ledger;
                let Ledger { friction, viscous, damping, integration, .. } = *ledger;
                let error = ledger.error();
                vec![walls, cell, membrane, gravity, water, friction, viscous, damping, integration, error]
            }
            Measure::Speed => vec![grains.velocity.iter().map(|v| v.length()).fold(0.0, f64::max)],
            Measure::TimeStep => vec![now.report.dt],
            Measure::Pressure => {
                if let Some((grid, pressure)) = now.grid() {
                    return Some(grid.mean_least_greatest(pressure).to_vec());
                }
                let (mesh, pressure) = now.pores()?;
                let (mut sum, mut volume) = (0.0, 0.0);
                for (v, &node) in mesh.volume.iter().zip(&mesh.node) {
                    sum += v * pressure[node as usize];
                    volume += v;
                }
                let least = pressure.iter().copied().fold(f64::INFINITY, f64::min);
                let greatest = pressure.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                vec![sum / volume, least, greatest]
            }
            Measure::PressureProfile => now.water.profile(now.state, 2)?.to_vec(),
            Measure::PressureProfileX => now.water.profile(now.state, 0)?.to_vec(),
            Measure::PressureProfileY => now.water.profile(now.state, 1)?.to_vec(),
            Measure::Discharge => {
                if let Some(flow) = now.coarse_flow() {
                    return Some(flow.discharge().to_array().to_vec());
                }
                let beside = now.beside()?;
                let site = now.site(&beside)?;
                now.pore_flow(&site)?.discharge(&site).to_array().to_vec()
            }
            Measure::WaterStress => {
                let (mesh, pressure) = now.pores().filter(|_| domain.is_periodic())?;
                let stress = mesh.stretching(pressure) * domain.cell.volume().recip();
                stress.transpose().to_cols_array().to_vec()
            }
            Measure::Outflow => {
                if now.grid().is_some() {
                    return Some(now.water.darcy.flows.outflow.to_vec());
                }
                now.water.outflow(now.state)?.to_vec()
            }
        })
    }
}
