//! One-dimensional consolidation against Terzaghi's theory, with the sample's own modulus and permeability.
//!
//! Nothing is fitted. A dry copy of the sample is loaded: the slope of the grains' displacements away from the walls
//! is the modulus of the bulk; rattlers, which drift, are left out of it. A steady flow through the same pores, its
//! pressure gradient taken away from the walls as well, gives the permeability of the bulk, and the planes where that
//! gradient would reach the pressures of the faces are the ends of the drainage path: pores held at an open face's pressure
//! drain at once and store nothing, so the path is shorter than the box, by up to a third of a grain at each open face.
//! What the top settles beyond the strain of the bulk between those planes is the give of the layers at the walls, and
//! comes at once.

use crate::boundary::{Signal, Solid, Water};
use crate::darcy;
use crate::fluid;
use crate::measure;
use crate::model::{Flow, FluidModel, Model};
use crate::permeability::{self, Problem};
use crate::state::State;
use crate::step::{StepError, Work, step};
use glam::DVec3;
use porograin_geometry::throat::Packing;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

const BOTTOM: usize = 4;
const TOP: usize = 5;
/// Local damping of the dry test; a quasi-static test does not depend on it.
const DRY_DAMPING: f64 = 0.2;
/// Steps of the dry test, per layer of grains, over which the load is put on. A wave crosses a layer in some five
/// steps, so it crosses the sample some sixty times: put on at once the load would overshoot, and grains would slide
/// that in the wet sample, loaded as the water gives way, do not.
const DRY_RAMP: f64 = 300.0;
/// Steps between two looks at whether the dry test has come to rest.
const DRY_LOOK: usize = 200;
/// The dry test is at rest when its settlement changes by less than this part between two looks, twice.
const DRY_REST: f64 = 1e-4;
/// ... and fails after this many steps.
const DRY_MOST: usize = 100_000;
/// Layers next to a wall are ordered by it and give more; the bulk begins this many diameters away.
const MARGIN: f64 = 1.5;
/// Records are taken at `T_v = FIRST RATIO^k`.
const FIRST: f64 = 1e-4;
const RATIO: f64 = 1.12;
/// A load that rises is seen by the theory as this many equal ones, one after the other.
const PARTS: usize = 50;
/// Theory and simulation are compared from here on; before, the discrete pores still see the load as a jump.
pub const COMPARE_FROM: f64 = 0.05;

/// What is measured of a sample before its load is put on, and how it consolidates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Consolidation {
    /// When the load was put on [s].
    pub start: f64,
    /// Added stress on the top [Pa].
    pub load: f64,
    /// How it is put on: the share that comes at each time after `start` [s].
    pub parts: Vec<[f64; 2]>,
    /// Height of the sample then [m].
    pub height: f64,
    /// Intrinsic permeability of the bulk along the height, every grain held [m²].
    pub permeability: f64,
    /// The same without the rattlers [m²]: as long as they swim with the water they do not hold it up.
    pub permeability_without_rattlers: f64,
    /// Oedometric modulus of the bulk of a dry copy under the same load, away from the walls [Pa].
    pub modulus: f64,
    /// How far the top of the dry copy came down [m].
    pub dry_settlement: f64,
    /// Viscosity of the water [Pa s].
    pub viscosity: f64,
    /// How far inside the bottom and the top face a steady flow in the bulk would reach their pressure [m].
    pub held: [f64; 2],
    /// Whether bottom and top are open.
    pub open: [bool; 2],
    /// What was seen since.
    pub records: Vec<Record>,
    next: f64,
}

/// What was seen at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Since the load was put on [s].
    pub time: f64,
    /// Of the top [m].
    pub settlement: f64,
    /// Mean excess pressure at 13 heights [Pa].
    pub profile: [f64; 13],
}

/// Why a stage cannot be compared with Terzaghi's theory.
#[derive(Clone, Debug, PartialEq)]
pub enum ConsolidationError {
    /// Its boundary conditions are others.
    Unsuitable(&'static str),
    /// The dry test failed.
    Dry(StepError),
    /// The dry test did not come to rest.
    Restless,
    /// The permeability could not be measured.
    Permeability(String),
}

impl std::fmt::Display for ConsolidationError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            ConsolidationError::Unsuitable(why) => {
                write!(f, "the stage cannot be compared with Terzaghi's theory: {why}")
            }
            ConsolidationError::Dry(error) => write!(f, "the dry oedometer test failed: {error}"),
            ConsolidationError::Restless => {
                write!(
                    f,
                    "the dry oedometer test did not come to rest in {DRY_MOST} steps: is the friction zero?"
                )
            }
            ConsolidationError::Permeability(why) => write!(f, "the permeability cannot be measured: {why}"),
        }
    }
}

impl std::error::Error for ConsolidationError {}

impl Consolidation {
    /// Measures the sample at the beginning of the stage that loads it.
    ///
    /// # Errors
    /// [`ConsolidationError`].
    pub fn begin(state: &State, model: &Model) -> Result<Self, ConsolidationError> {
        let unsuitable = |why| Err(ConsolidationError::Unsuitable(why));
        let Some(fluid) = &model.fluid else { return unsuitable("it is dry") };
        let Solid::Servo { stress, .. } = &model.faces[TOP].solid else {
            return unsuitable("its top face is not a servo");
        };
        let open = [BOTTOM, TOP].map(|face| matches!(model.faces[face].water, Water::Pressure(_)));
        if open == [false; 2] {
            return unsuitable("neither the top nor the bottom face has a water pressure");
        }
        let carried = state.domain.wall_force[TOP].z / state.domain.area(TOP);
        let (first, target, start, end) = match stress {
            Signal::Constant(stress) => (*stress, *stress, 0.0, 0.0),
            Signal::Ramp { from, to, start, end } => (*from, *to, *start, *end),
            _ => return unsuitable("the stress on its top is neither a number nor a ramp"),
        };
        let load = target - carried;
        if load <= 0.0 {
            return unsuitable("the top servo asks for no more stress than there is");
        }
        let parts = parts(((first - carried) / load).clamp(0.0, 1.0), start, end);
        let cell = &state.domain.cell;
        let height = (cell.upper() - cell.origin).z;
        let (low, high) = bulk(state);
        if high - low < mean_diameter(state) {
            return unsuitable(
                "the sample is less than four grains high: no part of it is away from the walls",
            );
        }
        let (dry_settlement, strain) = dry_test(state, model, target, load)?;
        let modulus = load / strain;
        let all = vec![true; state.grains.len()];
        let (permeability, held) = measure_flow(state, model, fluid, load, open, &all)?;
        let carrying = measure::carrying(state);
        let (permeability_without_rattlers, _) = measure_flow(state, model, fluid, load, open, &carrying)?;
        Ok(Consolidation {
            start: state.time,
            load,
            parts,
            height,
            permeability,
            permeability_without_rattlers,
            modulus,
            dry_settlement,
            viscosity: fluid.viscosity,
            held,
            open,
            records: Vec::new(),
            next: FIRST,
        })
    }

    /// Coefficient of consolidation `kappa E / mu` [m²/s].
    pub fn coefficient(&self) -> f64 {
        self.permeability * self.modulus / self.viscosity
    }

    /// Oedometric modulus of box and walls together, load over the strain of the box [Pa].
    pub fn box_modulus(&self) -> f64 {
        self.load * self.height / self.dry_settlement
    }

    /// Part of the settlement that comes at once: that of the layers at the walls, whose pores are drained.
    pub fn immediate(&self) -> f64 {
        let free = self.height - self.held[0] - self.held[1];
        1.0 - self.load / self.modulus * free / self.dry_settlement
    }

    /// Drainage path [m]: half the height of the free pores if both ends drain, all of it otherwise.
    pub fn path(&self) -> f64 {
        let free = self.height - self.held[0] - self.held[1];
        if self.open == [true; 2] { 0.5 * free } else { free }
    }

    /// Drainage path of the whole box [m], for comparison.
    pub fn box_path(&self) -> f64 {
        if self.open == [true; 2] { 0.5 * self.height } else { self.height }
    }

    /// Dimensionless time `C_v t / path²` for a path [m].
    pub fn dimensionless(&self, time: f64, path: f64) -> f64 {
        self.coefficient() * time / (path * path)
    }

    /// Takes a record if one is due.
    pub fn watch(&mut self, state: &State, water: &fluid::Scratch) {
        let time = state.time - self.start;
        if self.dimensionless(time, self.path()) < self.next {
            return;
        }
        while self.next <= self.dimensionless(time, self.path()) {
            self.next *= RATIO;
        }
        let cell = &state.domain.cell;
        let Some(profile) = water.profile(state, 2) else { return };
        self.records.push(Record { time, settlement: self.height - (cell.upper() - cell.origin).z, profile });
    }

    /// Pressure over load that theory expects at height `z` [m] above the bottom, `time` [s] after `start`.
    pub fn theory(&self, z: f64, time: f64) -> f64 {
        self.theory_with(1.0, z, time)
    }

    /// [`theory`](Self::theory) of a sample that is `faster` times as permeable.
    fn theory_with(&self, faster: f64, z: f64, time: f64) -> f64 {
        // Distance from an open end, at most the path.
        let path = self.path();
        let depth = if self.open[0] { z - self.held[0] } else { self.height - self.held[1] - z };
        if depth <= 0.0 || depth >= 2.0 * path {
            return 0.0;
        }
        superposed(&self.parts, time, |time| pressure(depth / path, faster * self.dimensionless(time, path)))
    }

    /// The comparison so far; `None` before the first record after [`COMPARE_FROM`].
    pub fn compare(&self) -> Option<Comparison> {
        let immediate = self.immediate();
        let points: Vec<Point> = self
            .records
            .iter()
            .map(|record| {
                let tv = self.dimensionless(record.time, self.path());
                Point {
                    tv,
                    time: record.time,
                    middle: record.profile[6] / self.load,
                    middle_theory: self.theory(0.5 * self.height, record.time),
                    settlement: record.settlement / self.dry_settlement,
                    settlement_theory: superposed(&self.parts, record.time, |time| {
                        immediate + (1.0 - immediate) * settlement(self.dimensionless(time, self.path()))
                    }),
                }
            })
            .collect();
        let late = || points.iter().filter(|p| p.tv > COMPARE_FROM);
        late().next()?;
        let worst = |error: &dyn Fn(&Point) -> f64| late().map(error).fold(0.0, f64::max);
        Some(Comparison {
            max_error: worst(&|p| (p.middle - p.middle_theory).abs()),
            max_settlement_error: worst(&|p| (p.settlement - p.settlement_theory).abs()),
            max_error_box_path: worst(&|p| {
                let path = self.box_path();
                let from_end = if self.open == [true; 2] { path } else { 0.5 * self.height };
                let theory = superposed(&self.parts, p.time, |time| {
                    let tv = self.dimensionless(time, path) * self.box_modulus() / self.modulus;
                    pressure(from_end / path, tv)
                });
                (p.middle - theory).abs()
            }),
            max_error_without_rattlers: worst(&|p| {
                let faster = self.permeability_without_rattlers / self.permeability;
                (p.middle - self.theory_with(faster, 0.5 * self.height, p.time)).abs()
            }),
            first_pressure: points
                .iter()
                .take_while(|p| p.tv < COMPARE_FROM)
                .map(|p| p.middle)
                .fold(0.0, f64::max),
            points,
        })
    }
}

/// A load of which the share `sudden` comes at once and the rest rises from `start` to `end` [s]: (time, share).
fn parts(sudden: f64, start: f64, end: f64) -> Vec<[f64; 2]> {
    let share = (1.0 - sudden) / PARTS as f64;
    let rising = (0..PARTS).map(|k| [start + (end - start) * (k as f64 + 0.5) / PARTS as f64, share]);
    let mut parts = vec![[0.0, sudden]];
    parts.extend(rising.filter(|_| share > 0.0));
    parts
}

/// What the whole load has done by `time` [s], `response` being what a load put on at once has done by then.
fn superposed(parts: &[[f64; 2]], time: f64, response: impl Fn(f64) -> f64) -> f64 {
    let come = parts.iter().filter(|[at, _]| *at <= time);
    come.map(|[at, share]| share * response(time - at)).sum()
}

/// Simulation against theory.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Largest difference of the mid-height pressure over the load for `T_v > 0.05` [-].
    pub max_error: f64,
    /// Largest difference of the degree of settlement for `T_v > 0.05` [-].
    pub max_settlement_error: f64,
    /// `max_error` had path and modulus been those of the box, walls and held pores included [-].
    pub max_error_box_path: f64,
    /// `max_error` had the permeability been that without rattlers [-]: the water of a small load carries them along, that
    /// of a larger one presses them against their cages on the way, and then they hold it up.
    pub max_error_without_rattlers: f64,
    /// Largest mid-height pressure over the load for `T_v < 0.05` [-]; theory: 1.
    pub first_pressure: f64,
    /// Every record.
    pub points: Vec<Point>,
}

/// One record against theory; all dimensionless but the time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// `C_v t / path²`.
    pub tv: f64,
    /// [s]
    pub time: f64,
    /// Mid-height pressure over load.
    pub middle: f64,
    /// What theory expects.
    pub middle_theory: f64,
    /// Settlement over that of the dry test.
    pub settlement: f64,
    /// What theory expects.
    pub settlement_theory: f64,
}

/// `p/p0` at depth `x` (in drainage paths) below the open end, `physics` §3.
pub fn pressure(x: f64, tv: f64) -> f64 {
    if tv <= 0.0 {
        return 1.0;
    }
    series(tv, |k, decay| 4.0 / ((2.0 * k + 1.0) * PI) * ((2.0 * k + 1.0) * 0.5 * PI * x).sin() * decay)
}

/// Degree of settlement U (M 2.25 corrected).
pub fn settlement(tv: f64) -> f64 {
    if tv <= 0.0 {
        return 0.0;
    }
    1.0 - series(tv, |k, decay| 8.0 / ((2.0 * k + 1.0) * PI).powi(2) * decay)
}

/// Sum over k of the terms, until they have decayed below rounding.
fn series(tv: f64, term: impl Fn(f64, f64) -> f64) -> f64 {
    let mut sum = 0.0;
    for k in 0..100_000 {
        let k = f64::from(k);
        let decay = (-(2.0 * k + 1.0).powi(2) * PI * PI * tv / 4.0).exp();
        sum += term(k, decay);
        if decay < 1e-17 {
            break;
        }
    }
    sum
}

/// Permeability of the bulk along the height [m²], and how far inside bottom and top the pressure of a steady flow in the
/// bulk reaches theirs [m]; only the grains that `stay` are there.
fn measure_flow(
    state: &State,
    model: &Model,
    fluid: &FluidModel,
    drop: f64,
    open: [bool; 2],
    stay: &[bool],
) -> Result<(f64, [f64; 2]), ConsolidationError> {
    let pores = match &fluid.flow {
        Flow::Pores(pores) => pores,
        Flow::Darcy(settings) => {
            let around = fluid::coarse::around(state, model, fluid);
            let permeability =
                darcy::permeability_along(settings, &around, 2).map_err(ConsolidationError::Permeability)?;
            return Ok((permeability, [0.0; 2]));
        }
    };
    let problem = Problem {
        axis: 2,
        drop,
        sides: model.faces[0].slip,
        viscosity: fluid.viscosity,
        conductance: pores.conductance,
        coupling: pores.coupling,
        solver: pores.solver,
        residual: pores.residual,
    };
    let cell = &state.domain.cell;
    let kept: Vec<usize> = (0..stay.len()).filter(|&i| stay[i]).collect();
    let position: Vec<DVec3> = kept.iter().map(|&i| state.grains.position[i]).collect();
    let radius: Vec<f64> = kept.iter().map(|&i| state.grains.radius[i]).collect();
    let flow = permeability::measure(cell, &position, &radius, &problem)
        .map_err(|error| ConsolidationError::Permeability(error.to_string()))?;
    let (low, high) = bulk(state);
    let (mesh, height) = (&flow.mesh, (cell.upper() - cell.origin).z);
    let packing = Packing { cell, position: &position, radius: &radius };
    let inner = (0..mesh.volume.len()).filter_map(|pore| {
        let corners: [Option<DVec3>; 4] =
            std::array::from_fn(|k| packing.point(&mesh.triangulation, pore, k));
        let z = corners.iter().try_fold(0.0, |sum, corner| Some(sum + 0.25 * (*corner)?.z))?;
        let pressure = flow.pressure[mesh.node[pore] as usize];
        (low..high).contains(&z).then_some((mesh.volume[pore], z, pressure))
    });
    let Line { z, value, slope } = line(inner);
    let reaches = |pressure: f64| z + (pressure - value) / slope;
    let (bottom, top) = (reaches(drop) - cell.origin.z, cell.upper().z - reaches(0.0));
    let held = [if open[0] { bottom } else { 0.0 }, if open[1] { top } else { 0.0 }];
    Ok((flow.permeability * (height - bottom - top) / height, held))
}

/// Loads a dry copy of the sample slowly by `load`, up to `target` [Pa]: settlement of the top [m], strain of the bulk [-].
fn dry_test(state: &State, model: &Model, target: f64, load: f64) -> Result<(f64, f64), ConsolidationError> {
    let mut copy = state.clone();
    let mut dry = Model { fluid: None, damping: DRY_DAMPING, ..model.clone() };
    let mut work = Work::default();
    let height = |s: &State| (s.domain.cell.upper() - s.domain.cell.origin).z;
    let layers = height(state) / mean_diameter(state);
    let ramp = (DRY_RAMP * layers).ceil() as usize;
    for k in 1..=ramp {
        if let Solid::Servo { stress, .. } = &mut dry.faces[TOP].solid {
            *stress = Signal::Constant(target - load * (1.0 - k as f64 / ramp as f64));
        }
        step(&mut copy, &dry, &mut work).map_err(ConsolidationError::Dry)?;
    }
    let (mut last, mut quiet) = (0.0, 0);
    for _ in 0..DRY_MOST / DRY_LOOK {
        for _ in 0..DRY_LOOK {
            step(&mut copy, &dry, &mut work).map_err(ConsolidationError::Dry)?;
        }
        let now = height(state) - height(&copy);
        quiet = if (now - last).abs() < DRY_REST * now.abs() { quiet + 1 } else { 0 };
        if quiet == 2 {
            return Ok((now, bulk_strain(state, &copy)));
        }
        last = now;
    }
    Err(ConsolidationError::Restless)
}

fn mean_diameter(state: &State) -> f64 {
    2.0 * state.grains.radius.iter().sum::<f64>() / state.grains.len() as f64
}

/// The heights between which walls have no say [m].
fn bulk(state: &State) -> (f64, f64) {
    let margin = MARGIN * mean_diameter(state);
    (state.domain.cell.origin.z + margin, state.domain.cell.upper().z - margin)
}

/// Vertical strain between two states, compression positive: least-squares slope of the grains' displacements
/// against their heights, over grains more than [`MARGIN`] mean diameters away from top and bottom. Rattlers have no
/// say: in a dry sample without weight they drift about in their cages, as far as the others move.
fn bulk_strain(before: &State, after: &State) -> f64 {
    let grains = &before.grains;
    let (low, high) = bulk(before);
    let (then, now) = (measure::carrying(before), measure::carrying(after));
    let inner =
        (0..grains.len()).filter(|&i| then[i] && now[i] && (low..high).contains(&grains.position[i].z));
    -line(inner.map(|i| {
        let z = grains.position[i].z;
        (1.0, z, after.grains.position[i].z - z)
    }))
    .slope
}

/// The straight line `value + slope (. - z)` through the centre of some points.
struct Line {
    z: f64,
    value: f64,
    slope: f64,
}

/// Least squares through points (weight, z, value).
fn line(points: impl Iterator<Item = (f64, f64, f64)>) -> Line {
    let [mut weight, mut z, mut value, mut zz, mut zv] = [0.0; 5];
    for (w, x, y) in points {
        weight += w;
        z += w * x;
        value += w * y;
        zz += w * x * x;
        zv += w * x * y;
    }
    let slope = (zv - z * value / weight) / (zz - z * z / weight);
    Line { z: z / weight, value: value / weight, slope }
}

#[cfg(test)]
mod tests {
    use super::{bulk_strain, line, parts, pressure, settlement, superposed};
    use crate::boundary::Domain;
    use crate::contact::Contacts;
    use crate::grains::Grains;
    use crate::state::State;
    use glam::DVec3;

    #[test]
    fn terzaghi_has_its_textbook_values() {
        assert!((settlement(0.1) - 0.357).abs() < 1e-3);
        assert!((settlement(0.197) - 0.5).abs() < 1e-3);
        assert!((settlement(0.848) - 0.9).abs() < 1e-3);
        assert!((pressure(1.0, 1e-4) - 1.0).abs() < 1e-9);
        assert!((pressure(1.0, 0.5) - 0.3709).abs() < 2e-3);
        assert!(pressure(0.0, 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_load_that_rises_does_what_the_mean_of_its_past_does() {
        assert_eq!(superposed(&parts(1.0, 0.0, 0.0), 0.1, settlement), settlement(0.1));
        // At first U = sqrt(4 T/pi), whose mean over a ramp is two thirds of its last value.
        let rising = superposed(&parts(0.0, 0.0, 0.01), 0.01, settlement);
        assert!((rising / settlement(0.01) - 2.0 / 3.0).abs() < 1e-3, "{rising}");
        let half = superposed(&parts(0.5, 0.02, 0.03), 0.02, settlement);
        assert!((half - 0.5 * settlement(0.02)).abs() < 1e-15, "{half}");
    }

    #[test]
    fn a_line_goes_through_its_points() {
        let found = line([(1.0, 0.0, 3.0), (2.0, 1.0, 5.0), (0.5, 4.0, 11.0)].into_iter());
        assert!((found.slope - 2.0).abs() < 1e-14 && (found.value - 2.0 * found.z - 3.0).abs() < 1e-14);
    }

    #[test]
    fn settlement_is_what_the_pressure_has_given_up() {
        for tv in [0.01, 0.1, 0.7] {
            let n = 2000;
            let mean: f64 = (0..n).map(|i| pressure((i as f64 + 0.5) / n as f64, tv)).sum::<f64>() / n as f64;
            assert!((1.0 - mean - settlement(tv)).abs() < 1e-6, "{tv}");
        }
    }

    #[test]
    fn rattlers_have_no_say_in_the_strain_of_the_bulk() {
        let place = |k: usize| DVec3::new((k % 4) as f64, (k / 4 % 4) as f64, (k / 16) as f64) + 0.5;
        let mut position: Vec<DVec3> = (0..128).map(place).collect();
        let touching = |&[i, j]: &[u32; 2]| {
            let apart = place(i as usize).distance(place(j as usize));
            i < j && apart < 1.01
        };
        let pairs: Vec<[u32; 2]> =
            (0..128).flat_map(|i| (0..128).map(move |j| [i, j])).filter(touching).collect();
        position.push(DVec3::new(2.0, 2.0, 5.0));
        let mut radius = vec![0.5; 128];
        radius.push(0.2);
        let mut before = State {
            time: 0.0,
            step: 0,
            dt: 0.0,
            domain: Domain::walled(DVec3::ZERO, DVec3::new(4.0, 4.0, 8.0)),
            grains: Grains::at_rest(position, radius, 2600.0),
            contacts: Contacts::new(pairs.iter().map(|&pair| (pair, DVec3::ZERO))),
            fluid: None,
        };
        let mut after = before.clone();
        for x in &mut after.grains.position {
            x.z *= 1.0 - 1e-3;
        }
        assert!((bulk_strain(&before, &after) - 1e-3).abs() < 1e-13);
        after.grains.position[128].z += 0.2;
        assert!((bulk_strain(&before, &after) - 1e-3).abs() < 1e-13);
        // A grain that is held has its say.
        let more = [[16, 128], [17, 128], [20, 128]];
        before.contacts = Contacts::new(pairs.into_iter().chain(more).map(|pair| (pair, DVec3::ZERO)));
        after.contacts = before.contacts.clone();
        assert!((bulk_strain(&before, &after) - 1e-3).abs() > 1e-5);
    }
}
