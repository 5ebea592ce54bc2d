//! The longest stable time step of the solid phase, and what sets it.
//!
//! Leapfrog is stable for `dt < 2/omega_max`, `omega_max²` the largest eigenvalue of `M⁻¹ K`. `K` is a sum over contacts
//! of `k (a_i - a_j)²` terms. With `(a_i - a_j)² <= (1 + s) a_i² + (1 + 1/s) a_j²` for any `s > 0` the grains come apart:
//! `omega_max²` is at most the largest eigenvalue of one grain's own 6 x 6 stiffness with each contact counted `1 + s`
//! times. We take `s = sqrt(m_i/m_j)` (exact for twins, and 0 against a fixed wall).
//! In the variables `(u, rho theta)`, `rho² = J/m`, that stiffness is `[A C; Cᵀ B]` with
//! `A = sum k_n nn + k_t (1 - nn)`, `B = sum k_t (l/rho)² (1 - nn)` and `C = sum k_t (l/rho) [n]x`, whose norm is that of
//! the vector `sum k_t (l/rho) n`; so the bound needs two symmetric 3 x 3 eigenvalues per grain and does not depend
//! on the choice of axes.
//!
//! A periodic cell that holds a stress moves with the grains: a component `L_ab` of its velocity gradient stretches a contact by
//! `b_b` along `a`, against the inertia `W l_b²` (see [`cell`](crate::cell)). With a third share for it in every contact, chosen as is
//! best, its own `omega² = sum over the held components of sum (k_n n_a² + k_t (1 - n_a²)) b_b² / (W l_b²)` adds to that of the grains.

use crate::cell;
use crate::contact::{ContactLaw, Contacts, Law, Laws, Memory, Stiffness, Surroundings, Touch};
use crate::grains::Grains;
use crate::model::{Model, RENEW_EVERY, TimeStep};
use crate::state::State;
use crate::walls;
use glam::DVec3;
use porograin_geometry::triangulation::wall;
use rayon::prelude::*;
use std::ops::Range;

/// The longest stable time step and its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// [s]
    pub seconds: f64,
    /// What vibrates fastest.
    pub cause: Cause,
}

/// What limits the time step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The contacts of the grain of this [id](Grains::id).
    Grain(u32),
    /// A grain in free flight, as stiff as it would be on contact.
    Flight(u32),
    /// The piston at this face.
    Piston(usize),
    /// The servoed wall of this number in the case.
    Wall(usize),
    /// The periodic cell that holds a stress.
    Cell,
    /// The viscous damping by the water in the pores.
    Water,
    /// Nothing: there are no grains.
    Nothing,
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Cause::Grain(id) => write!(f, "the contacts of grain {id}"),
            Cause::Flight(id) => write!(f, "grain {id}, were it to meet the largest grain"),
            Cause::Piston(face) => write!(f, "the piston at the {} face", crate::boundary::FACE_NAMES[*face]),
            Cause::Wall(k) => write!(f, "the servo of wall {}", k + 1),
            Cause::Cell => write!(f, "the inertia of the periodic cell under its held stress"),
            Cause::Water => write!(f, "the viscosity of the water in the pores"),
            Cause::Nothing => write!(f, "nothing"),
        }
    }
}

/// Whether this is a step at which the stability limit is looked at again: the first of a stage or of a new mesh of
/// the pores, and every [`RENEW_EVERY`]-th. A function of the state alone, so that a resumed run renews at the same steps.
pub fn due(state: &State, model: &Model) -> bool {
    state.step.is_multiple_of(RENEW_EVERY)
        || state.time == model.stage_start
        || state.dt == 0.0
        || state.pores().is_some_and(|water| water.made_at_step == state.step)
}

/// The length of the coming step [s], and the limit if it was renewed.
pub fn time_step(state: &State, model: &Model) -> (f64, Option<Limit>) {
    match model.time_step {
        TimeStep::Fixed(dt) => (dt, None),
        TimeStep::Automatic { safety } if due(state, model) => {
            let limit = with_water(limit(state, model), state, model);
            (safety * limit.seconds, Some(limit))
        }
        TimeStep::Automatic { .. } => (state.dt, None),
    }
}

/// The limit of the contacts, less what the water takes of it in explicit steps.
pub fn with_water(contacts: Limit, state: &State, model: &Model) -> Limit {
    match state.pores() {
        Some(water) if water.implicit.is_none() => {
            explicit(contacts, water.viscous_rate + water.shear_rate, model.damping)
        }
        Some(water) if water.shear_rate > 0.0 => explicit(contacts, water.shear_rate, model.damping),
        _ => contacts,
    }
}

/// What water that damps the grains at the rate `lambda` [1/s] leaves to an explicit step of the limit `2/omega` of the
/// contacts: the positive root of `2 lambda dt + omega² dt² = 4` (`physics` §3b). Where the drag rules, local damping `D` adds
/// its part of it, always against the motion: `lambda (1 + D)`.
pub fn explicit(contacts: Limit, lambda: f64, damping: f64) -> Limit {
    let lambda = lambda * (1.0 + damping);
    let omega = 2.0 / contacts.seconds;
    let seconds = 4.0 / (lambda + (lambda * lambda + 4.0 * omega * omega).sqrt());
    // Of the four parts of the limit, the larger share names the cause.
    let cause = if 2.0 * lambda * seconds > 2.0 { Cause::Water } else { contacts.cause };
    Limit { seconds, cause }
}

/// How a grain is held by its contacts: the blocks `A`, `B` and the vector of `C`, each over the grain's mass.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    isotropic: [f64; 2],
    along: [[f64; 6]; 2],
    across: DVec3,
    contacts: u32,
}

impl Held {
    /// A contact on the side its normal `n` points away from, `lever` and `gyration` from the centre [m].
    fn add(&mut self, n: DVec3, share: f64, stiffness: &Stiffness, lever: f64, gyration: f64) {
        let squares = [n.x * n.x, n.y * n.y, n.z * n.z, n.y * n.z, n.x * n.z, n.x * n.y];
        let (normal, shear, lever) = (share * stiffness.normal, share * stiffness.shear, lever / gyration);
        let per_inertia = share / (gyration * gyration);
        let (roll, twist) = (per_inertia * stiffness.roll, per_inertia * stiffness.twist);
        let across = shear * lever * lever + roll;
        for (sum, part) in self.along.iter_mut().zip([normal - shear, twist - across]) {
            for (s, q) in sum.iter_mut().zip(squares) {
                *s += part * q;
            }
        }
        self.isotropic[0] += shear;
        self.isotropic[1] += across;
        self.across += shear * lever * n;
        self.contacts += 1;
    }

    /// Upper bound of the largest eigenvalue of `[A C; Cᵀ B]`, from those of the symmetric parts of `A` and `B`.
    fn bound(&self, largest: fn([f64; 6]) -> f64) -> f64 {
        let a = self.isotropic[0] + largest(self.along[0]);
        let b = self.isotropic[1] + largest(self.along[1]);
        0.5 * (a + b) + (0.25 * (a - b) * (a - b) + self.across.length_squared()).sqrt()
    }
}

/// The limit for the contacts as they are. A grain is never taken to be freer than if it were held
/// from three sides by twins as stiff as its contact with the largest grain, so that grains in flight, and
/// contacts that form before the next look, are provided for.
pub fn limit(state: &State, model: &Model) -> Limit {
    let grains = &state.grains;
    let surroundings = Surroundings::new(grains, &state.domain, &model.faces, &model.walls, &model.contact);
    let motion = Motion {
        pistons: crate::motion::pistons(model, grains),
        servoed: model.walls.iter().map(|wall| walls::motion::servoed(wall, state)).collect(),
        largest: grains.radius.iter().fold(0.0, |a: f64, &r| a.max(r)),
        fastest: grains.velocity.iter().fold(0.0, |a: f64, v| a.max(v.length_squared())).sqrt(),
    };
    let part = grains.len().div_ceil(PARTS).max(1);
    let look = |k: usize| {
        let range = k * part..((k + 1) * part).min(grains.len());
        let seen = Seen::new(state, model);
        if range.is_empty() { seen } else { seen.look(range, &surroundings, &state.contacts, &motion) }
    };
    let parts: Vec<Seen> = (0..PARTS).into_par_iter().map(look).collect();
    let mut all = Seen::new(state, model);
    parts.iter().for_each(|seen| all.take_in(seen));
    for (face, piston) in all.piston.iter().enumerate() {
        claim(&mut all.worst, pace(piston[0], piston[1]), Cause::Piston(face));
    }
    for (wall, pushed) in all.pushed.iter().enumerate() {
        claim(&mut all.worst, pace(pushed[0], pushed[1]), Cause::Wall(wall));
    }
    let (worst, cell) = (all.worst, all.cell);
    let own = pace(cell.squared, cell.rate);
    // Springs add as squares, dampers as they are.
    let both = if cell.rate == 0.0 { worst.0.hypot(own) } else { worst.0 + own };
    Limit { seconds: 1.0 / both, cause: if own > worst.0 { Cause::Cell } else { worst.1 } }
}

/// What holds a grain takes more memory than the grain: so many parts of the grains are looked at by turns.
const PARTS: usize = 8;

/// What moves beside the grains, and how the grains do.
struct Motion {
    /// Masses of pistons [kg].
    pistons: [Option<f64>; 6],
    /// Masses of servoed walls that the case adds [kg], and where to they move.
    servoed: Vec<Option<(f64, DVec3)>>,
    /// Largest radius [m].
    largest: f64,
    /// Greatest speed [m/s].
    fastest: f64,
}

/// What was seen of some grains and of the contacts of which they are the first.
struct Seen {
    /// The fastest pace [1/s] and its cause.
    worst: (f64, Cause),
    /// Springs and dampers of pistons, over their mass.
    piston: [[f64; 2]; 6],
    /// Those of the walls that the case adds.
    pushed: Vec<[f64; 2]>,
    cell: Stretched,
}

/// Keeps the faster pace and its cause; of two the first.
fn claim(worst: &mut (f64, Cause), pace: f64, cause: Cause) {
    if pace > worst.0 {
        *worst = (pace, cause);
    }
}

impl Seen {
    fn new(state: &State, model: &Model) -> Self {
        let pushed = vec![[0.0; 2]; model.walls.len()];
        Seen {
            worst: (0.0, Cause::Nothing),
            piston: [[0.0; 2]; 6],
            pushed,
            cell: Stretched::new(state, model),
        }
    }

    fn take_in(&mut self, other: &Seen) {
        claim(&mut self.worst, other.worst.0, other.worst.1);
        let ours = self.piston.iter_mut().chain(&mut self.pushed).flatten();
        ours.zip(other.piston.iter().chain(&other.pushed).flatten()).for_each(|(sum, part)| *sum += part);
        self.cell.squared += other.cell.squared;
        self.cell.rate += other.cell.rate;
    }

    fn look(
        mut self,
        range: Range<usize>,
        surroundings: &Surroundings,
        contacts: &Contacts,
        motion: &Motion,
    ) -> Self {
        let (grains, laws) = (surroundings.grains, surroundings.laws);
        let (start, n) = (range.start, range.len());
        // Behind the springs of all grains, where there are any, their dampers.
        let mut held = vec![Held::default(); if laws.is_plain() { n } else { 2 * n }];
        for pair in contacts.pairs() {
            let [i, j] = pair.map(|k| k as usize);
            if i >= range.end {
                break;
            }
            // Contacts with the grains before count for the second only.
            let (own, other) = (i >= start, range.contains(&j));
            if !(own || other) {
                continue;
            }
            let touch = surroundings.touch(pair);
            let stiffness = surroundings.law(pair).stiffness(&touch);
            let levers = touch.levers();
            let mut hold = |k: usize, side: usize, other: f64| {
                let share = (1.0 + (grains.mass[k] / other).sqrt()) / grains.mass[k];
                let normal = if side == 0 { touch.normal } else { -touch.normal };
                let gyration = 0.4_f64.sqrt() * grains.radius[k];
                held[k - start].add(normal, share, &stiffness, levers[side], gyration);
                if let Some(held) = held.get_mut(n + k - start) {
                    held.add(normal, share, &stiffness.dampers(), levers[side], gyration);
                }
            };
            if other {
                hold(j, 1, grains.mass[i]);
            }
            if !own {
                continue;
            }
            self.cell.add(pair, &touch, &stiffness);
            match wall(pair[1]) {
                None => hold(i, 0, grains.mass[j]),
                Some(6..) => {
                    let wall = walls::find(surroundings.walls, pair[1]).0;
                    hold(i, 0, motion.servoed[wall].map_or(f64::INFINITY, |(mass, _)| mass));
                    if let Some((mass, along)) = motion.servoed[wall] {
                        let share = (1.0 + (mass / grains.mass[i]).sqrt()) / mass;
                        let cosine = along.dot(touch.normal);
                        let part =
                            |normal: f64, shear: f64| share * (shear + (normal - shear) * cosine * cosine);
                        self.pushed[wall][0] += part(stiffness.normal, stiffness.shear);
                        self.pushed[wall][1] += part(stiffness.normal_damper, stiffness.shear_damper);
                    }
                }
                Some(face) => {
                    hold(i, 0, motion.pistons[face].unwrap_or(f64::INFINITY));
                    if let Some(mass) = motion.pistons[face] {
                        let share = (1.0 + (mass / grains.mass[i]).sqrt()) / mass;
                        self.piston[face][0] += share * stiffness.normal;
                        self.piston[face][1] += share * stiffness.normal_damper;
                    }
                }
            }
        }
        let mut flight = Flight { laws, largest: motion.largest, fastest: motion.fastest, last: None };
        for k in range {
            claim(&mut self.worst, flight.pace(grains, k), Cause::Flight(grains.id[k]));
            let (springs, dampers) = (&held[k - start], held.get(n + k - start));
            let paced = |largest: fn([f64; 6]) -> f64| {
                pace(springs.bound(largest), dampers.map_or(0.0, |dampers| dampers.bound(largest)))
            };
            // Few grains are anywhere near the worst: the others are told by a bound that costs less.
            if springs.contacts > 0 && paced(above_eigenvalues) > self.worst.0 {
                claim(&mut self.worst, paced(largest_eigenvalue), Cause::Grain(grains.id[k]));
            }
        }
        self
    }
}

/// How the components of a periodic cell that hold a stress are held by the contacts.
struct Stretched {
    /// Row, column and the inverse of the inertia `W l²` [1/(kg m²)].
    components: Vec<(usize, usize, f64)>,
    /// Bound of the squared frequency [1/s²].
    squared: f64,
    /// Bound of the damping rate [1/s].
    rate: f64,
}

impl Stretched {
    fn new(state: &State, model: &Model) -> Self {
        let inertia = cell::inertia(state, model);
        let all = (0..9).map(|k| (k / 3, k % 3, inertia.col(k % 3)[k / 3]));
        let components =
            all.filter(|held| held.2 > 0.0).map(|(a, b, inertia)| (a, b, 1.0 / inertia)).collect();
        Stretched { components, squared: 0.0, rate: 0.0 }
    }

    fn add(&mut self, pair: [u32; 2], touch: &Touch, stiffness: &Stiffness) {
        let [near, far] = touch.levers();
        let length = if wall(pair[1]).is_some() { near } else { near + far };
        for &(a, b, mobility) in &self.components {
            let (along, arm) = (touch.normal[a].powi(2), (length * touch.normal[b]).powi(2));
            let part = |normal: f64, shear: f64| mobility * arm * (normal * along + shear * (1.0 - along));
            self.squared += part(stiffness.normal, stiffness.shear);
            self.rate += part(stiffness.normal_damper, stiffness.shear_damper);
        }
    }
}

/// The inverse of the longest stable step of an oscillator with this squared frequency and damping rate `c/m`, the damper
/// fed with the velocity of half a step ago: the positive root of `2 rate dt + squared dt² = 4` [1/s].
fn pace(squared: f64, rate: f64) -> f64 {
    0.25 * (rate + (rate * rate + 4.0 * squared).sqrt())
}

/// Grains between three pairs of hands, each as stiff as their contact with the largest grain.
struct Flight<'a> {
    laws: &'a Laws,
    /// Largest radius [m].
    largest: f64,
    /// Greatest speed [m/s].
    fastest: f64,
    /// Radius, mass and pace of the grain before, often the same.
    last: Option<[f64; 3]>,
}

/// Least overlap, in terms of the smaller radius, at which the stiffness of contacts to come is taken: there are springs
/// that are soft where grains just meet.
const MEETING: f64 = 1e-3;

impl Flight<'_> {
    fn pace(&mut self, grains: &Grains, k: usize) -> f64 {
        let (radius, mass) = (grains.radius[k], grains.mass[k]);
        if let Some([r, m, pace]) = self.last
            && r == radius
            && m == mass
        {
            return pace;
        }
        let pace = self.laws.iter().map(|law| self.under(law, radius, mass)).fold(0.0, f64::max);
        self.last = Some([radius, mass, pace]);
        pace
    }

    fn under(&self, law: &Law, radius: f64, mass: f64) -> f64 {
        let at = |overlap: f64| Touch::prospective([radius, self.largest], overlap, mass);
        // Two grains at the greatest speed meet head on; the energy `~ d^(5/2)` of the spring of Hertz says how deep.
        let least = MEETING * radius.min(self.largest);
        let energy = 0.5 * mass * (2.0 * self.fastest).powi(2);
        let known = law.energy(&at(least), &Memory::default());
        let stiffness = law.stiffness(&at(least * (energy / known).max(1.0).powf(0.4)));
        let worst = |normal: f64, shear: f64, turning: f64| {
            2.0 * (normal + 2.0 * shear).max(5.0 * shear + turning) / mass
        };
        let turning = 2.5 * (2.0 * stiffness.roll + stiffness.twist) / (radius * radius);
        pace(
            worst(stiffness.normal, stiffness.shear, turning),
            worst(stiffness.normal_damper, stiffness.shear_damper, 0.0),
        )
    }
}

/// Mean of the eigenvalues of a symmetric 3 x 3 matrix `[xx, yy, zz, yz, xz, xy]`, and how far they may be from it:
/// they are `mean + 2 size cos(..)`.
fn spread([xx, yy, zz, yz, xz, xy]: [f64; 6]) -> (f64, f64) {
    let mean = (xx + yy + zz) / 3.0;
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    (mean, ((a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0).sqrt())
}

/// An upper bound of them.
fn above_eigenvalues(matrix: [f64; 6]) -> f64 {
    let (mean, size) = spread(matrix);
    mean + 2.0 * size
}

/// The largest of them, by the trigonometric formula.
fn largest_eigenvalue(matrix: [f64; 6]) -> f64 {
    let (mean, size) = spread(matrix);
    if size <= 1e-14 * mean.abs() {
        return mean;
    }
    let [xx, yy, zz, yz, xz, xy] = matrix;
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    let angle = (0.5 * determinant / (size * size * size)).clamp(-1.0, 1.0).acos() / 3.0;
    mean + 2.0 * size * angle.cos()
}

#[cfg(test)]
mod tests;
