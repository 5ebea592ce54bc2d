//! Grains that come in while the simulation goes on: dry pluviation, filling of a hopper.
//!
//! Grains appear at random places that touch nothing, at steps that look at the time step anew, when all neighbours are found anew
//! anyway. Those that find no room wait until others have fallen. Everything follows from the number of the step and of the grain,
//! so that a resumed run gives the same bits.

use crate::grains::{Grains, sphere_volume};
use crate::model::{Model, RENEW_EVERY};
use crate::packing::Grading;
use crate::state::State;
use glam::DVec3;
use porograin_geometry::Period;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::RngCore;
use serde::{Deserialize, Serialize};

/// Places tried for one grain at one time.
const TRIES: usize = 100;
/// Unless the case says where, grains appear below the top in a layer so many of their largest radii high.
const LAYER: f64 = 6.0;
/// The golden section: its multiples, without the whole part, fill the interval from 0 to 1 evenly, however many there are.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// A grain that touches so many others rests on them.
const SUPPORTS: u32 = 3;

/// Grains that a stage lets fall, until there are enough.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Rain {
    /// Enough are so many.
    pub count: Option<usize>,
    /// Enough is so much [kg].
    pub mass: Option<f64>,
    /// Enough is a bed whose surface is so high [m].
    pub height: Option<f64>,
    /// How many per second.
    pub rate: Option<f64>,
    /// How many at once; the next when all conditions of the stage hold.
    pub layer: Option<usize>,
    /// Mean radius, of a log-normal grading the median [m]; left out with a sieve table.
    pub radius: Option<f64>,
    /// How the sizes are distributed; all equal where nothing is said.
    pub grading: Option<Grading>,
    /// Low and high corner of where they appear [m]; left out: a layer below the top.
    pub within: Option<[[f64; 3]; 2]>,
    /// Velocity with which they appear [m/s].
    #[serde(default)]
    pub velocity: [f64; 3],
    /// The same number gives the same rain.
    #[serde(default)]
    pub seed: u64,
}

/// What the grains that fall are made of: a part of them, by number, has this density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Of all, from 0 to 1.
    pub part: f64,
    /// [kg/m³]
    pub density: f64,
}

/// How far a rain has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fallen {
    /// Grains that have fallen.
    pub count: usize,
    /// Their mass [kg].
    pub mass: f64,
    /// With layers: how many may have fallen by now.
    pub due: usize,
    /// Whether there are enough.
    pub enough: bool,
}

impl Rain {
    /// The radius [m] below which the part `u` of the grains lies, by number.
    pub fn size(&self, u: f64) -> f64 {
        let scale = self.radius.unwrap_or(1.0);
        self.grading.as_ref().map_or(scale, |grading| scale * grading.radius(u))
    }

    /// Radius of the largest grain there may be [m].
    pub fn largest(&self) -> f64 {
        self.size(1.0)
    }

    /// Size of the grain of this number: a series without chance, which keeps to the grading at every length.
    fn size_of(&self, number: usize) -> f64 {
        self.size((0.5 + GOLDEN * number as f64).fract())
    }

    /// As many grains as it takes, estimated for a bed that is 60 % solid over a box of this base [m²] and floor [m], `density` in
    /// kg/m³; at rest in one place.
    pub fn sample(&self, base: f64, floor: f64, density: f64) -> Grains {
        let mut radii = Vec::new();
        let (mut volume, mut fallen) = (0.0, Fallen::default());
        while !self.suffices(&fallen)
            && self.height.is_none_or(|height| volume < 0.6 * base * (height - floor))
        {
            let r = self.size_of(fallen.count);
            volume += sphere_volume(r);
            fallen.count += 1;
            fallen.mass = density * volume;
            radii.push(r);
        }
        Grains::at_rest(vec![DVec3::ZERO; radii.len()], radii, density)
    }

    /// The low and the high corner of where grains appear [m].
    fn region(&self, state: &State) -> [DVec3; 2] {
        let cell = &state.domain.cell;
        let (lower, upper) = (cell.origin, cell.upper());
        match self.within {
            Some(corners) => corners.map(DVec3::from_array),
            None => [lower.with_z((upper.z - LAYER * self.largest()).max(lower.z)), upper],
        }
    }

    /// Takes note of the grains being at rest: the next layer is due when the last is down.
    pub fn rests(&self, fallen: &mut Fallen) {
        if let Some(layer) = self.layer
            && fallen.count == fallen.due
            && !fallen.enough
        {
            fallen.due += layer;
        }
    }

    /// Lets the grains fall that are due `t` seconds after the stage began; `kinds` is what they are made of. Returns how
    /// many fell.
    pub fn fall(
        &self,
        state: &mut State,
        model: &Model,
        t: f64,
        fallen: &mut Fallen,
        kinds: &[Kind],
    ) -> usize {
        if !state.step.is_multiple_of(RENEW_EVERY) {
            return 0;
        }
        fallen.due = match (self.layer, self.rate) {
            (Some(layer), _) => fallen.due.max(layer),
            (None, Some(rate)) => (rate * t).floor() as usize + 1,
            (None, None) => 0,
        };
        let grown = self.height.is_some_and(|height| surface(state) >= height);
        fallen.enough |= grown || self.suffices(fallen);
        let before = fallen.count;
        if fallen.enough || fallen.due <= before {
            return 0;
        }
        let [low, high] = self.region(state);
        let period = Period::of(&state.domain.cell);
        let nearest = |x: DVec3| x + period.as_ref().map_or(DVec3::ZERO, |period| period.nearest(x));
        let heights = low.z - self.largest()..high.z + self.largest();
        let around = state.grains.position.iter().zip(&state.grains.radius);
        let mut near: Vec<(DVec3, f64)> = around
            .filter(|(x, r)| x.z + **r > heights.start && x.z - **r < heights.end)
            .map(|(&x, &r)| (x, r))
            .collect();
        let mut random =
            Pcg64::new(u128::from(self.seed) << 64 | u128::from(state.step), 0x5851_f42d_4c95_7f2d);
        let mut uniform = || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let cell = state.domain.cell;
        let (lower, upper) = (cell.origin, cell.upper());
        while fallen.count < fallen.due && !self.suffices(fallen) {
            let r = self.size_of(fallen.count);
            // Walls keep a radius away.
            let edge = DVec3::from_array(cell.periodic.map(|periodic| if periodic { 0.0 } else { r }));
            let from = low.max(lower + edge);
            let room = high.min(upper - edge) - from;
            if room.min_element() < 0.0 {
                break;
            }
            let place = (0..TRIES).find_map(|_| {
                let x = from + room * DVec3::new(uniform(), uniform(), uniform());
                let apart = |(y, other): &(DVec3, f64)| nearest(x - *y).length() > r + other;
                (near.iter().all(apart) && is_clear(state, model, x, r)).then_some(x)
            });
            let Some(x) = place else { break };
            near.push((x, r));
            let material = choose(kinds, uniform());
            let mass = kinds[material].density * state.grains.shape.volume(r);
            append(&mut state.grains, x, r, DVec3::from(self.velocity), mass, material);
            fallen.count += 1;
            fallen.mass += mass;
        }
        fallen.enough = self.suffices(fallen);
        fallen.count - before
    }

    /// Whether there are enough by number or mass.
    fn suffices(&self, fallen: &Fallen) -> bool {
        self.count.is_some_and(|count| fallen.count >= count)
            || self.mass.is_some_and(|mass| fallen.mass >= mass)
    }
}

/// The highest point of all grains that rest on others [m]; the bottom where none does.
pub fn surface(state: &State) -> f64 {
    let grains = &state.grains;
    let mut supports = vec![0; grains.len()];
    for pair in state.contacts.pairs() {
        for k in pair {
            if let Some(count) = supports.get_mut(k as usize) {
                *count += 1;
            }
        }
    }
    let resting = (0..grains.len()).filter(|&k| supports[k] >= SUPPORTS);
    resting.map(|k| grains.position[k].z + grains.radius[k]).fold(state.domain.cell.origin.z, f64::max)
}

/// Whether a grain there would touch none of the walls that the case adds.
fn is_clear(state: &State, model: &Model, x: DVec3, radius: f64) -> bool {
    let walls = model.walls.iter().zip(&state.domain.walls).filter(|(wall, _)| wall.present);
    walls.into_iter().all(|(wall, place)| wall.shape.depth(place.back(x), radius).is_none())
}

/// The kind at this part of all.
fn choose(kinds: &[Kind], part: f64) -> usize {
    let mut sum = 0.0;
    let found = kinds.iter().position(|kind| {
        sum += kind.part;
        part < sum
    });
    found.unwrap_or(kinds.len() - 1)
}

/// One more grain, with the number after the highest.
fn append(grains: &mut Grains, x: DVec3, r: f64, velocity: DVec3, mass: f64, material: usize) {
    let next = grains.id.iter().max().map_or(0, |&id| id + 1);
    grains.position.push(x);
    grains.velocity.push(velocity);
    grains.spin.push(DVec3::ZERO);
    grains.radius.push(r);
    grains.mass.push(mass);
    grains.material.push(material as u16);
    grains.id.push(next);
}
