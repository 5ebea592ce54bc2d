//! The budget of the water: what must balance, looked at every [`EVERY`] steps with the velocities and pressures that go
//! together, apart from the solver that found them.

use crate::fluid;
use crate::grains::Loads;
use crate::pores::Pull;
use crate::pores::mesh::{Carried, FREE, Mesh};
use glam::DVec3;
use porograin_geometry::Repair;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Steps between two audits.
pub const EVERY: u64 = 100;
/// What is left over in a pore may be this part of the largest flux through any; an implicit step solved to its
/// default residual leaves some 10⁻³ while the pressures are small beside those of the load.
pub const FLUX: f64 = 0.05;
/// The forces of the water on grains and walls may sum to this part of their sum of sizes.
pub const FORCE: f64 = 1e-9;
/// The power that enters and the power dissipated may differ by this part of the larger.
pub const POWER: f64 = 0.05;
/// The water unaccounted for may be this part of all water.
pub const MASS: f64 = 1e-3;

/// One look at what must balance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Audit {
    /// What is left over in the worst node, over the largest flux through any [-].
    pub flux: f64,
    /// The sum of the forces on grains and walls over the sum of their sizes [-].
    pub force: f64,
    /// The difference of the power that enters with grains, walls, held pressures and a macroscopic gradient and the power
    /// dissipated in the throats, over the larger of its parts [-].
    pub power: f64,
    /// Water that appears per second, over all water [1/s].
    pub appearing: f64,
}

impl Audit {
    /// Of velocities that carry `carried` out of the nodes [m³/s], and the pressures that go with them [Pa]; `pull` has
    /// put what it makes flow into the sources of `carried`. `water` is the volume of water in the pores [m³].
    pub fn of(
        mesh: &Mesh,
        carried: &Carried,
        pressure: &[f64],
        pull: &Pull,
        grains: usize,
        water: f64,
    ) -> Audit {
        let mut out = vec![0.0; mesh.nodes()];
        let mut through = vec![0.0; mesh.nodes()];
        let (mut dissipated, mut given, mut pulled) = (0.0, 0.0, 0.0);
        for (link, (&[i, j], &g)) in mesh.links.iter().zip(&mesh.conductance).enumerate() {
            let [i, j] = [i as usize, j as usize];
            let (between, pull) = (pressure[i] - pressure[j], pull.drop(link));
            let flux = g * (between + pull);
            dissipated += flux * (between + pull);
            given += g * pull * between;
            pulled += flux * pull;
            for (node, sign) in [(i, 1.0), (j, -1.0)] {
                out[node] += sign * g * between;
                through[node] += flux.abs();
            }
        }
        let (mut worst, mut largest, mut appearing) = (0.0f64, 0.0f64, 0.0);
        // Power: on the solids, and through the held nodes.
        let (mut solids, mut held) = (-given, 0.0);
        for node in 0..mesh.nodes() {
            let left = carried.node[node] + out[node];
            solids += pressure[node] * carried.node[node];
            if mesh.held[node] == FREE {
                worst = worst.max(left.abs());
                appearing += left;
                largest = largest.max(0.5 * (through[node] + carried.node[node].abs()));
            } else {
                held += pressure[node] * left;
            }
        }
        let mut loads = Loads::default();
        loads.clear(grains);
        mesh.add_loads(pressure, &mut loads);
        let all = || loads.force.iter().chain(&loads.wall);
        let (sum, sizes) = (all().sum::<DVec3>().length(), all().map(|force| force.length()).sum::<f64>());
        let part = |x: f64, of: f64| if of > 0.0 { x / of } else { 0.0 };
        Audit {
            flux: part(worst, largest),
            force: part(sum, sizes),
            power: part(
                (dissipated + solids - held - pulled).abs(),
                dissipated.max(solids.abs()).max(held.abs()).max(pulled.abs()),
            ),
            appearing: appearing / water,
        }
    }
}

/// The worst of all audits of a run, and what was done to the meshes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// Steps with water.
    pub steps: u64,
    /// Iterations of their solves.
    pub iterations: u64,
    /// Audits, one every 100 steps.
    pub audits: u64,
    /// Worst [`Audit::flux`].
    pub flux: f64,
    /// Worst [`Audit::force`].
    pub force: f64,
    /// Worst [`Audit::power`].
    pub power: f64,
    /// Water that appeared (negative: vanished), over all water.
    pub mass_drift: f64,
    /// Work of a macroscopic gradient on water and grains [J].
    #[serde(default)]
    pub gradient_work: f64,
    /// Pores of the last mesh merged into a neighbour because their radical centres coincide.
    pub merged: usize,
    /// Throats of the last mesh that overlapping grains close.
    pub closed: usize,
    /// Throats of the last mesh outside the range that their conductance is calibrated for.
    #[serde(default)]
    pub clamped: usize,
    /// Meshes made because water came in or a face changed its rule.
    pub meshes_for_rules: u64,
    /// Meshes made because a pore had deformed too much.
    pub meshes_for_strain: u64,
    /// Of these, triangulations built afresh because too much had changed.
    #[serde(default)]
    pub rebuilt: u64,
    /// Flips by which the others followed the grains.
    #[serde(default)]
    pub flips: u64,
    /// Holes refilled where flips did not help.
    #[serde(default)]
    pub holes: u64,
}

impl Budget {
    /// Takes in a step of length `dt` [s].
    ///
    /// # Errors
    /// What does not balance any more.
    pub fn add(
        &mut self,
        report: &fluid::Report,
        mesh: &Mesh,
        new: Option<Cause>,
        dt: f64,
    ) -> Result<(), Unbalanced> {
        self.steps += 1;
        self.iterations += report.iterations as u64;
        self.gradient_work += report.gradient_power * dt;
        match new {
            Some(Cause::Rules) => self.meshes_for_rules += 1,
            Some(Cause::Strain(repair)) => {
                self.meshes_for_strain += 1;
                self.rebuilt += u64::from(repair.rebuilt);
                self.flips += repair.flips as u64;
                self.holes += repair.holes as u64;
            }
            None => {}
        }
        if new.is_some() || self.steps == 1 {
            self.merged = mesh.census.merged;
            self.closed = mesh.census.closed;
            self.clamped = mesh.census.clamped;
        }
        let Some(audit) = report.audit else { return Ok(()) };
        self.audits += 1;
        self.flux = self.flux.max(audit.flux);
        self.force = self.force.max(audit.force);
        self.power = self.power.max(audit.power);
        self.mass_drift += audit.appearing * dt * EVERY as f64;
        let checks = [
            ("flux left over in a pore", audit.flux, FLUX),
            ("sum of the water's forces", audit.force, FORCE),
            ("difference of power and dissipation", audit.power, POWER),
            ("water unaccounted for", self.mass_drift.abs(), MASS),
        ];
        match checks.into_iter().find(|&(_, value, limit)| value > limit || value.is_nan()) {
            Some((what, value, limit)) => Err(Unbalanced { what, value, limit }),
            None => Ok(()),
        }
    }
}

/// Why a mesh was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Water came in, or a face changed its rule.
    Rules,
    /// A pore had deformed too much; how the triangulation followed.
    Strain(Repair),
}

/// A balance that is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unbalanced {
    /// Which.
    pub what: &'static str,
    /// How much, relative.
    pub value: f64,
    /// What is tolerated.
    pub limit: f64,
}

impl fmt::Display for Unbalanced {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Unbalanced { what, value, limit } = self;
        write!(
            f,
            "the budget of the water is off: the {what} is {value:.1e} of the whole, more than {limit:.0e}; a smaller \
             residual of the pressure solve may help"
        )
    }
}
