//! The budget of the energy kept a second time, from what anyone can see of the states: places, velocities, the shear forces of the
//! contacts, the forces on the walls. Nothing in it is defined as the rest, so the rest is what leapfrog loses.

use glam::{DMat3, DVec3};
use porograin::case::Case;
use porograin::ledger::Ledger;
use porograin::run::Simulation;
use porograin::{Model, State, measure};
use porograin_geometry::cell::NORMALS;
use porograin_geometry::triangulation::wall;
use std::collections::HashMap;
use std::path::Path;

const YOUNG: f64 = 1e6;
const RATIO: f64 = 0.5;
const DAMPING: f64 = 0.2;

/// Everything since the stage began [J].
#[derive(Debug, Default)]
struct Books {
    walls: f64,
    cell: f64,
    friction: f64,
    damping: f64,
    kinetic: f64,
    elastic: f64,
    /// What springs take in before they touch and give back after they have parted: the steps know of no time in between.
    crossings: f64,
    /// The shear force of each contact in the last step [N].
    shear: HashMap<[u32; 2], DVec3>,
}

/// A pair at one instant.
struct Pair {
    first: usize,
    second: Result<usize, usize>,
    /// From the first to the nearest image of the second, or to the wall.
    branch: DVec3,
    overlap: f64,
    radius: [f64; 2],
}

impl Pair {
    fn of(state: &State, pair: [u32; 2]) -> Self {
        let (cell, grains) = (&state.domain.cell, &state.grains);
        let first = pair[0] as usize;
        let (at, radius) = (grains.position[first], grains.radius[first]);
        if let Some(face) = wall(pair[1]) {
            let branch = (cell.wall_position(face) - at[face / 2]).abs() * NORMALS[face];
            let overlap = radius - branch.length();
            return Pair { first, second: Err(face), branch, overlap, radius: [radius; 2] };
        }
        let second = pair[1] as usize;
        let (branch, radius) = (grains.position[second] - at, [radius, grains.radius[second]]);
        let steps = |k: usize| DVec3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64) - DVec3::ONE;
        let images = (0..27).map(|k| branch + cell.edges * steps(k)).filter(|_| state.domain.is_periodic());
        let shorter = |a: DVec3, b: DVec3| if b.length() < a.length() { b } else { a };
        let branch = images.fold(branch, shorter);
        Pair { first, second: Ok(second), branch, overlap: radius[0] + radius[1] - branch.length(), radius }
    }

    /// Stiffness of the normal spring.
    fn stiffness(&self) -> f64 {
        let [a, b] = self.radius;
        2.0 * YOUNG * a * b / (a + b)
    }

    /// How fast the second slides along the first, by the velocities of `state`.
    fn sliding(&self, state: &State) -> DVec3 {
        let normal = self.branch.normalize();
        let beside = |k: usize| state.domain.peculiar(state.grains.position[k], state.grains.velocity[k]);
        let turning =
            |k: usize, radius: f64| (radius - 0.5 * self.overlap) * state.grains.spin[k].cross(normal);
        let first = beside(self.first) + turning(self.first, self.radius[0]);
        let rate = match self.second {
            Err(face) => state.domain.wall_velocity[face] - first,
            Ok(j) => beside(j) + state.domain.gradient * self.branch - turning(j, self.radius[1]) - first,
        };
        rate - rate.dot(normal) * normal
    }

    /// A shear force turned with the pair in the last step of `state`.
    fn turned(&self, force: DVec3, state: &State) -> DVec3 {
        let (normal, spin) = (self.branch.normalize(), &state.grains.spin);
        let turning = 0.5 * (spin[self.first] + self.second.map_or(DVec3::ZERO, |j| spin[j]));
        let across = force - force.dot(normal) * normal;
        let across = across + state.dt * turning.dot(normal) * normal.cross(across);
        across.normalize_or_zero() * force.length()
    }
}

impl Books {
    /// A step.
    fn add(&mut self, earlier: &State, before: &State, after: &State, model: &Model) {
        let kick = 0.5 * (before.dt + after.dt);
        // Walls: their force by their way.
        for face in 0..6 {
            let way = 0.5 * kick * (before.domain.wall_velocity[face] + after.domain.wall_velocity[face]);
            self.walls -= after.domain.wall_force[face].dot(way);
        }
        // Cell: the stress by the strain, that of the motion of the grains included.
        let now = State { contacts: after.contacts.clone(), ..before.clone() };
        let mut virial = measure::contact_stress(&now, model) * now.domain.cell.volume();
        for (pair, memory) in now.contacts.iter() {
            let branch = Pair::of(before, pair).branch;
            let force = memory.account.force;
            virial -= DMat3::from_cols(force * branch.x, force * branch.y, force * branch.z);
        }
        let strain = 0.5 * kick * (before.domain.rate + after.domain.rate);
        self.cell -= (0..3).map(|b| virial.col(b).dot(strain.col(b))).sum::<f64>();
        let strain = after.dt * after.domain.rate;
        self.kinetic = 0.0;
        for k in 0..after.grains.len() {
            let beside = |s: &State| s.domain.peculiar(s.grains.position[k], s.grains.velocity[k]);
            let (mass, inertia) = (after.grains.mass[k], after.grains.inertia(k));
            // The force has made it `pushed`; since then the cell has slowed it as it slows everything that moves on in it.
            let (slow, fast, spin) = (beside(before), beside(after), after.grains.spin[k]);
            let pushed = fast + strain * fast;
            self.cell -= mass * fast.midpoint(pushed).dot(strain * fast.midpoint(pushed));
            self.kinetic += 0.5 * mass * fast.length_squared() + 0.5 * inertia * spin.length_squared();
            for (weight, old, new) in [(mass, slow, pushed), (inertia, before.grains.spin[k], spin)] {
                // Local damping, from what it has let through.
                for axis in 0..3 {
                    let (kept, sign) = (weight * (new[axis] - old[axis]), old[axis].signum());
                    let felt = (kept / (1.0 - DAMPING * sign * kept.signum())).abs();
                    let damped = if old[axis] == 0.0 { 0.0 } else { DAMPING * felt * sign };
                    self.damping += damped * 0.5 * (old[axis] + new[axis]);
                }
            }
        }
        // Contacts: the slip by the mean of the forces at its ends; what is stored half a step after the force.
        self.elastic = 0.0;
        let mut shear = HashMap::new();
        for (pair, memory) in after.contacts.iter() {
            let force = memory.shear;
            let (here, next) = (Pair::of(before, pair), Pair::of(after, pair));
            let (normal, tangent) = (here.stiffness(), RATIO * here.stiffness());
            let past = Pair::of(earlier, pair);
            let ahead = |past: f64, next: f64| {
                0.25 * ((after.dt / before.dt - 1.0) * past + (before.dt / after.dt + 1.0) * next)
            };
            let way = ahead(here.overlap - past.overlap, next.overlap - here.overlap);
            self.elastic += normal * here.overlap.max(0.0) * (0.5 * here.overlap + way);
            self.elastic += 0.5 * force.length_squared() / tangent;
            let way = [before, after].map(|state| state.dt * force.dot(here.sliding(state)));
            self.elastic += ahead(way[0], way[1]);
            self.crossings -= 0.5 * normal * here.overlap * past.overlap.min(0.0);
            self.crossings += 0.5 * normal * here.overlap * next.overlap.min(0.0);
            let had = here.turned(self.shear.remove(&pair).unwrap_or_default(), before);
            let slip = before.dt * here.sliding(before) - (force - had) / tangent;
            self.friction += 0.5 * (had + force).dot(slip);
            shear.insert(pair, force);
        }
        // What a contact stored across is lost when it parts.
        for (pair, force) in std::mem::replace(&mut self.shear, shear) {
            let here = Pair::of(before, pair);
            self.friction += 0.5 * force.length_squared() / (RATIO * here.stiffness());
            self.friction += 0.5 * before.dt * here.turned(force, before).dot(here.sliding(before));
        }
    }

    fn energy(&self) -> f64 {
        self.kinetic + self.elastic
    }
}

/// The end of a stage, all as parts of the work that came in.
#[derive(Debug)]
struct Close {
    /// What is left over in these books.
    rest: f64,
    /// What crossings explain of it.
    crossings: f64,
    /// The ledger's loss by integration.
    loss: f64,
    /// By how much the other columns differ: walls, cell, friction, damping, energy.
    apart: [f64; 5],
}

/// Runs a case with both.
fn stages(case: &Case) -> Vec<Close> {
    let mut simulation = Simulation::new(case).unwrap();
    let (mut ends, mut books, mut start) = (Vec::new(), Books::default(), None);
    let mut before = simulation.state.clone();
    loop {
        let earlier = std::mem::replace(&mut before, simulation.state.clone());
        if simulation.advance().unwrap().is_none() {
            return ends;
        }
        books.add(&earlier, &before, &simulation.state, simulation.model());
        let Some((energy, first)) = start else {
            // The first step of a stage says what is there half a step later.
            let ledger = simulation.progress.ledger.unwrap();
            books = Books {
                shear: books.shear,
                kinetic: books.kinetic,
                elastic: books.elastic,
                ..Books::default()
            };
            start = Some((books.energy(), ledger));
            continue;
        };
        if simulation.progress.began.is_none() {
            let last: Ledger = simulation.progress.ledger.unwrap();
            let Books { walls, cell, friction, damping, crossings, .. } = books;
            let input = walls.abs() + cell.abs();
            let rest = energy + walls + cell - friction - damping - books.energy();
            let both = [
                (walls, last.walls - first.walls),
                (cell, last.cell - first.cell),
                (friction, last.friction - first.friction),
                (damping, last.damping - first.damping),
                (books.energy() - energy, last.kinetic + last.elastic - first.kinetic - first.elastic),
            ];
            let apart = both.map(|(a, b)| (a - b) / input);
            let loss = (last.integration - first.integration) / input;
            ends.push(Close { rest: rest / input, crossings: crossings / input, loss, apart });
            (books, start) = (Books { shear: books.shear, ..Books::default() }, None);
        }
    }
}

/// Grains pressed from a cloud, then loaded and unloaded in an oedometer.
fn pressed(safety: f64, seed: u32, conserving: bool) -> Case {
    let text = format!(
        r#"
        title = "pressed"
        conserve-energy = {conserving}
        time-step = {{ automatic = {{ safety = {safety} }} }}
        [domain]
        size = [0.0139, 0.0139, 0.0139]
        [grains]
        packing = {{ cloud = {{ count = 100, spread = 0.2, seed = {seed}, porosity = 0.7 }} }}
        density = 2600.0
        [contact.linear]
        young = {YOUNG}
        stiffness-ratio = {RATIO}
        friction = 30.0
        [face.all]
        friction = 20.0
        [[stage]]
        name = "press"
        face.all.solid = {{ servo = {{ stress = 1000.0 }} }}
        until = {{ unbalanced = 1e-2, stress-error = 0.02, max-steps = 2000000 }}
        [[stage]]
        name = "load"
        face.top.solid = {{ servo = {{ stress = {{ ramp = {{ from = 1e3, to = 10e3, end = 0.03 }} }} }} }}
        until = {{ time = 0.035 }}
        [[stage]]
        name = "unload"
        face.top.solid = {{ servo = {{ stress = {{ ramp = {{ from = 10e3, to = 1e3, end = 0.03 }} }} }} }}
        until = {{ time = 0.035 }}
        [[watch]]
        measures = ["energy-budget"]
        every = {{ steps = 1000 }}
        "#
    );
    Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap()
}

/// Grains in a periodic cell, pressed and sheared.
fn sheared(safety: f64, seed: u32, conserving: bool) -> Case {
    let text = format!(
        r#"
        title = "sheared"
        conserve-energy = {conserving}
        time-step = {{ automatic = {{ safety = {safety} }} }}
        [domain]
        size = [0.0083, 0.0083, 0.0083]
        periodic = "xyz"
        [grains]
        packing = {{ cloud = {{ count = 100, spread = 0.2, seed = {seed}, porosity = 0.7 }} }}
        density = 2600.0
        [contact.linear]
        young = {YOUNG}
        stiffness-ratio = {RATIO}
        friction = 30.0
        [[stage]]
        name = "press"
        cell = {{ stress = {{ xx = 1000.0, yy = 1000.0, zz = 1000.0 }} }}
        until = {{ unbalanced = 1e-2, stress-error = 0.02, max-steps = 2000000 }}
        [[stage]]
        name = "shear"
        cell = {{ gradient = {{ xz = 1.0 }}, stress = {{ zz = 1000.0 }} }}
        until = {{ time = 0.1 }}
        [[watch]]
        measures = ["energy-budget"]
        every = {{ steps = 1000 }}
        "#
    );
    Case::from_text("case.toml", &text, Path::new("."), &[]).unwrap()
}

/// At the default step both books agree to a millionth of the work in every column; what leapfrog loses is not that small,
/// and falls with the square of the step.
#[test]
fn books_kept_twice_agree_to_a_millionth_and_tell_what_the_steps_lose() {
    let runs = [0.8, 0.4].map(|safety| {
        let both = |seed| [stages(&pressed(safety, seed, false)), stages(&sheared(safety, seed, false))];
        [1, 2].map(both)
    });
    for close in runs.iter().flatten().flatten().flatten() {
        assert!(close.apart.iter().all(|apart| apart.abs() < 1e-6), "{close:?}");
        assert!((close.rest - close.loss).abs() < 1e-6, "{close:?}");
    }
    // Compaction from a cloud, by pistons and by a cell: grains collide.
    for kind in 0..2 {
        let mean = |k: usize| runs[k].each_ref().map(|run| run[kind][0].rest).iter().sum::<f64>() / 2.0;
        let [coarse, fine] = [mean(0), mean(1)];
        assert!(coarse > 1e-3 && coarse < 8e-3, "{coarse:e}");
        assert!(coarse / fine > 2.5 && coarse / fine < 6.5, "{coarse:e}, {fine:e}");
        for run in runs.iter().flatten() {
            let Close { rest, crossings, .. } = run[kind][0];
            assert!((crossings / rest - 1.0).abs() < 0.15, "{rest:e} {crossings:e}");
        }
    }
    // Grains that stay together: oedometer, and shear.
    for [pressed, sheared] in &runs[0] {
        assert!(pressed[1..].iter().all(|close| close.rest.abs() < 2e-4), "{pressed:?}");
        assert!(sheared[1].rest.abs() < 1e-3, "{sheared:?}");
    }
}

/// Contacts that conserve the energy lose a millionth of the work and no more, at the default step: by both books.
#[test]
fn nothing_is_lost_where_contacts_conserve_the_energy() {
    for seed in [1, 2] {
        let runs = [stages(&pressed(0.8, seed, true)), stages(&sheared(0.8, seed, true))];
        for close in runs.iter().flatten() {
            assert!(close.rest.abs() < 1e-6 && close.loss.abs() < 1e-6, "{close:?}");
            assert!(close.apart.iter().all(|apart| apart.abs() < 1e-6), "{close:?}");
        }
    }
}
