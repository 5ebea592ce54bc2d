//! Where the energy of the grains comes from and where it goes, added up step by step.
//!
//! With velocities at half steps a force acts over `F·(v⁻ + v⁺)/2 · kick`, exactly what the kinetic energy changes by. The force
//! of a contact at time t so takes half of what moves before t and half of what moves after it; summed over the
//! steps that is the trapezoid `(F(t-dt) + F(t))/2 · du` of each contact. Of the tangential part what is not stored is friction,
//! `(S0 + S1)/2 · du - d(S²/2k)`, for a linear spring `(S0 + S1)/2 · slip`. The other parts are added up each by its own
//! law. What the contacts took in and neither store nor lost is the error of the time integration; with it the sum
//! closes to round-off at any step, and what then is left over, `error`, is an error of the sums.
//!
//! In a periodic cell all velocities are those beside its flow, and the cell does the work that a contact gets from its branch being
//! stretched.

use crate::contact::{ContactLaw, Law, Memory, More, PairLoad, Surroundings, Touch};
use crate::grains::{Grains, Loads};
use crate::measure;
use crate::model::Model;
use crate::motion;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::triangulation::wall;
use serde::{Deserialize, Serialize};

/// Work and losses since a stage began [J].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    /// Kinetic and elastic energy at the beginning; `None` before the first step.
    pub start: Option<f64>,
    /// Work of all walls on the grains.
    pub walls: f64,
    /// Work of the periodic cell, which stretches the sample against its stress, that of the motion of the grains beside its flow
    /// included.
    pub cell: f64,
    /// Work of the membrane.
    pub membrane: f64,
    /// Work of gravity.
    pub gravity: f64,
    /// Work of the water on the grains, buoyancy included; with water this is what no other force did.
    pub water: f64,
    /// Lost in contacts that slide, roll or twist, and with bonds and bridges that break.
    pub friction: f64,
    /// Lost in the dampers of contacts.
    pub viscous: f64,
    /// Taken away by Cundall's local damping.
    pub damping: f64,
    /// What the contacts took in, and neither store nor lost: the error of the time integration, where contacts open or close
    /// within a step and normals turn. It goes with the square of the step; `docs/energy.md` tells how large it is.
    pub integration: f64,
    /// Kinetic energy, half a step after the forces; in a periodic cell that of the motion beside its flow.
    pub kinetic: f64,
    /// Elastic energy, half a step after the forces; with what [accounts](crate::contact::Account) hold.
    pub elastic: f64,
}

/// What a step starts from.
#[derive(Clone, Debug)]
pub struct Before(State);

impl Before {
    /// The state before a step; `None` where no ledger is kept: with glued grains.
    pub fn of(state: &State) -> Option<Self> {
        // The water is large and has no part in this.
        state.domain.glue.is_empty().then(|| {
            let State { time, step, dt, domain, grains, contacts, .. } = state;
            let (domain, grains, contacts) = (domain.clone(), grains.clone(), contacts.clone());
            Before(State { time: *time, step: *step, dt: *dt, domain, grains, contacts, fluid: None })
        })
    }
}

/// One contact at the time of its force.
struct Moment<'a> {
    law: &'a Law,
    /// With the velocities before and after the force.
    touch: [Touch; 2],
    /// What it remembered before, turned, and remembers now; `None` where it has parted.
    memory: [Option<Memory>; 2],
    /// What the cell adds to the velocity of the second against the first, in the mean of before and after.
    carried: DVec3,
    /// The overlap at the time of the last force [m].
    earlier: f64,
}

/// What one contact adds to the ledger [J].
#[derive(Default)]
struct Share {
    walls: f64,
    cell: f64,
    friction: f64,
    viscous: f64,
    /// Work on the two bodies, as they move beside the flow of the cell.
    work: f64,
    /// Energy stored at the time of the force.
    stored: f64,
    /// What springs take up in the half step before and from then to the time of the velocities.
    halves: [f64; 2],
}

impl Ledger {
    /// Takes in a step: from `before` to `after` under `loads`.
    pub fn add(&mut self, before: &Before, after: &State, model: &Model, loads: &Loads) {
        let Before(before) = before;
        let (last, dt) = (before.dt, after.dt);
        let kick = 0.5 * (last + dt);
        let first = self.start.is_none();

        let motion = Motion::of(before, after);

        let mut sum = Share::default();
        contacts(before, after, model, &motion, |moment, ends| {
            let share = moment.share(last, kick, ends);
            sum.walls += share.walls;
            sum.cell += share.cell;
            sum.friction += share.friction;
            sum.viscous += share.viscous;
            sum.work += share.work;
            sum.stored += share.stored;
            sum.halves[0] += share.halves[0];
            sum.halves[1] += share.halves[1];
        });
        if first {
            let kinetic = measure::kinetic_energy_at(&before.grains, &motion.beside[0]);
            self.elastic = sum.stored - sum.halves[0];
            self.start = Some(kinetic + self.elastic);
            sum.friction = 0.0;
        }
        self.friction += sum.friction;
        self.walls += sum.walls;
        self.viscous += sum.viscous;

        let (old, new) = (&before.grains, &after.grains);
        let mut press = vec![DVec3::ZERO; if model.membrane.is_some() { new.len() } else { 0 }];
        if let Some(membrane) = &model.membrane {
            let stress = membrane.stress.at(before.time - model.stage_start);
            after.domain.skin.press(stress, old, &mut press);
        }
        let (mut all, mut gravity, mut membrane, mut damping) = (0.0, 0.0, 0.0, 0.0);
        for k in 0..new.len() {
            let [slow, fast] = [motion.beside[0][k], motion.beside[1][k]];
            let moved = 0.5 * kick * (slow + fast);
            let turned = 0.5 * kick * (old.spin[k] + new.spin[k]);
            let (force, torque) = (loads.force[k], loads.torque[k]);
            all += force.dot(moved) + torque.dot(turned);
            gravity += new.mass[k] * model.gravity.dot(moved);
            membrane += press.get(k).map_or(0.0, |force| force.dot(moved));
            // What was felt besides the water of an implicit step is not told here; local damping is off with water.
            let drag = |load: DVec3, rate: DVec3| load - motion::damped(load, load, rate, model.damping);
            damping += drag(force, slow).dot(moved) + drag(torque, old.spin[k]).dot(turned);
        }
        self.gravity += gravity;
        self.membrane += membrane;
        self.damping += damping;
        if model.fluid.is_some() {
            self.water += all - gravity - membrane - sum.work;
        }
        // As the cell moves on, so does the flow that the grains are seen beside.
        self.kinetic = measure::kinetic_energy_at(new, &motion.beside[2]);
        self.cell += sum.cell + self.kinetic - measure::kinetic_energy_at(new, &motion.beside[1]);
        let stored = sum.stored + sum.halves[1];
        // What walls and cell do goes into the grains as well; the rest of the work on both bodies comes out of the contacts.
        let taken = sum.walls + sum.cell - sum.work - sum.viscous;
        self.integration += taken + self.elastic - stored - sum.friction;
        self.elastic = stored;
    }

    /// What came in: work of walls, cell, membrane, gravity and water, each by its size, and what was there [J].
    pub fn input(&self) -> f64 {
        let works = [self.walls, self.cell, self.membrane, self.gravity, self.water];
        works.iter().fold(self.start.unwrap_or(0.0), |sum, work| sum + work.abs())
    }

    /// What came in less what is there, what was lost, and the error of the time integration [J]: round-off, unless something
    /// moved the grains besides the loads.
    pub fn error(&self) -> f64 {
        let Ledger { walls, cell, membrane, gravity, water, .. } = self;
        let came = self.start.unwrap_or(0.0) + walls + cell + membrane + gravity + water;
        came - self.friction - self.viscous - self.damping - self.integration - self.kinetic - self.elastic
    }
}

/// How the grains of a step move beside the flow of the cell; in a walled box there is none.
struct Motion {
    /// Before the force, after it, and at the end, when the cell has moved on as well [m/s].
    beside: [Vec<DVec3>; 3],
    /// Velocities after the force, before grains that leave the cell are taken back into it [m/s].
    velocity: Vec<DVec3>,
    /// Velocity gradient of places as they are at the time of the force, in the half steps before and after it [1/s].
    gradient: [DMat3; 2],
}

impl Motion {
    fn of(before: &State, after: &State) -> Self {
        let (old, new, dt) = (&before.grains, &after.grains, after.dt);
        let (rate, origin) = (after.domain.rate, before.domain.cell.origin);
        let half = 0.5 * dt * rate;
        let gradient = [before.domain.gradient, rate * (DMat3::IDENTITY - half).inverse()];
        // As the motion has it, to the last bit: the damping looks at signs.
        let boost = gradient[1] - gradient[0];
        let carried: Vec<DVec3> =
            old.velocity.iter().zip(&old.position).map(|(v, x)| v + boost * (x - origin)).collect();
        let velocity: Vec<DVec3> = (0..new.len())
            .map(|k| {
                // Taken back by a shift s a grain has lost G s of its velocity: what the positions tell is (1 - G dt) s.
                let lost = old.position[k] + dt * new.velocity[k] - new.position[k];
                if lost.length_squared() < new.radius[k] * new.radius[k] {
                    return new.velocity[k];
                }
                let images = after.domain.gradient;
                new.velocity[k] + images * ((DMat3::IDENTITY - dt * images).inverse() * lost)
            })
            .collect();
        let beside = |velocity: &[DVec3], gradient: DMat3| -> Vec<DVec3> {
            velocity.iter().zip(&old.position).map(|(v, x)| v - gradient * (x - origin)).collect()
        };
        let ends = new.position.iter().zip(&new.velocity);
        let beside = [
            beside(&carried, gradient[0] + boost),
            beside(&velocity, gradient[1]),
            ends.map(|(&x, &v)| after.domain.peculiar(x, v)).collect(),
        ];
        Motion { beside, velocity, gradient }
    }
}

/// Calls `take` with every contact of a step, those that part in it included, and the velocities and spins of its first grain
/// before and after; the latter `None` unless the second is a wall.
fn contacts(
    before: &State,
    after: &State,
    model: &Model,
    motion: &Motion,
    mut take: impl FnMut(&Moment, Option<[(DVec3, DVec3); 2]>),
) {
    // The places of before with the velocities of after.
    let mut moved = Grains { position: before.grains.position.clone(), ..after.grains.clone() };
    moved.radius.clone_from(&before.grains.radius);
    moved.velocity.clone_from(&motion.velocity);
    let mut domain = before.domain.clone();
    domain.wall_velocity = after.domain.wall_velocity;
    domain.gradient = motion.gradient[1];
    for (place, new) in domain.walls.iter_mut().zip(&after.domain.walls) {
        (place.velocity, place.spin) = (new.velocity, new.spin);
    }
    let flow = 0.5 * (motion.gradient[0] + motion.gradient[1]);
    let around =
        |grains, domain| Surroundings::new(grains, domain, &model.faces, &model.walls, &model.contact);
    let (old, new) = (around(&before.grains, &before.domain), around(&moved, &domain));
    let (mut was, mut is) = (before.contacts.iter().peekable(), after.contacts.iter().peekable());
    let next = |was: Option<&([u32; 2], Memory)>, is: Option<&([u32; 2], Memory)>| {
        was.into_iter().chain(is).map(|(pair, _)| *pair).min()
    };
    while let Some(pair) = next(was.peek(), is.peek()) {
        let touch = [old.touch(pair), new.touch(pair)];
        let past = was.next_if(|contact| contact.0 == pair).map(|(_, mut memory)| {
            memory.turn(touch[0].normal, touch[0].twist * before.dt);
            memory
        });
        let now = is.next_if(|contact| contact.0 == pair).map(|(_, memory)| memory);
        let i = pair[0] as usize;
        let ends = wall(pair[1])
            .map(|_| [&before.grains, &moved].map(|grains| (grains.velocity[i], grains.spin[i])));
        let along = match ends {
            None => touch[0].levers().iter().sum::<f64>() * touch[0].normal,
            Some(_) => before.domain.cell.origin - before.grains.position[i],
        };
        let earlier = match ends {
            None => {
                let near = old.near(pair);
                near.reach - (near.branch - before.dt * near.velocity).length()
            }
            Some(_) => touch[0].overlap + before.dt * touch[0].velocity.dot(touch[0].normal),
        };
        let memory = [past, now];
        take(&Moment { law: old.law(pair), touch, memory, carried: flow * along, earlier }, ends);
    }
}

impl Moment<'_> {
    fn share(&self, last: f64, kick: f64, ends: Option<[(DVec3, DVec3); 2]>) -> Share {
        let [before, after] = &self.touch;
        let normal = before.normal;
        let mut share = Share::default();
        // The tangential force and the moments of a memory.
        let held = |memory: &Memory| (memory.shear, memory.more.roll + memory.more.twist * normal);
        let stored = |touch: &Touch, memory: &Memory| {
            self.law.energy(touch, memory) - self.law.energy(touch, &bare(memory))
        };
        let (shear, moment) = self.memory[1].as_ref().map_or_else(Default::default, held);
        if let Some(memory) = self.memory[1] {
            let load = |touch: &Touch| {
                let holds = self.law.holds(touch, &memory);
                let load =
                    if holds { self.law.load(touch, &mut memory.clone(), 0.0) } else { PairLoad::default() };
                PairLoad { force: load.force + memory.account.force, ..load }
            };
            let all = load(before);
            // What is remembered may be beyond what a contact at rest could hold: the friction cone is that of all forces.
            let spring = shear - self.law.pressing(before, &memory) * normal + memory.account.force;
            let damper = all.force - spring;
            let moved = 0.5 * kick * (before.velocity + after.velocity);
            let turned = 0.5 * kick * (before.spin + after.spin);
            share.viscous = damper.dot(moved);
            share.work = -all.force.dot(moved) - all.moment.dot(turned);
            share.cell = kick * all.force.dot(self.carried);
            share.work += share.cell;
            if let Some([(v0, w0), (v1, w1)]) = ends {
                let lever = before.levers()[0] * normal;
                let point = 0.5 * kick * (v0 + v1) + (0.5 * kick * (w0 + w1)).cross(lever);
                let spun = 0.5 * kick * (w0 + w1);
                share.walls = all.force.dot(point + moved) + all.moment.dot(spun + turned);
                share.work += share.walls;
            }
            let takes = |touch: &Touch| spring.dot(touch.velocity) + moment.dot(touch.spin);
            let all = 0.5 * kick * (takes(before) + takes(after));
            share.halves[0] = 0.5 * last * takes(before);
            share.halves[1] = all - share.halves[0];
            share.stored = self.law.energy(before, &memory) + memory.account.surplus;
            share.friction -= stored(before, &memory);
        }
        if let Some(memory) = self.memory[0] {
            share.friction += stored(&Touch { overlap: self.earlier, ..*before }, &memory);
            let (shear, moment) = held(&memory);
            share.friction += 0.5 * last * (shear.dot(before.velocity) + moment.dot(before.spin));
        }
        let [past, now] = self.memory.map(Option::unwrap_or_default);
        if past.more.snapped(&now.more) {
            let earlier = Touch { overlap: self.earlier, ..*before };
            let pressing = self.law.pressing(&earlier, &past) - past.account.force.dot(normal);
            let way = -last * before.velocity.dot(normal);
            share.friction += 0.5 * (pressing + self.law.pressing(before, &now)) * way;
            share.friction += self.law.pressed(&earlier, &past.more) - self.law.pressed(before, &now.more);
        }
        share.friction += 0.5 * last * (shear.dot(before.velocity) + moment.dot(before.spin));
        share
    }
}

/// A memory without its tangential force and moments.
fn bare(memory: &Memory) -> Memory {
    let more = More { roll: DVec3::ZERO, twist: 0.0, ..memory.more };
    Memory { shear: DVec3::ZERO, more, ..*memory }
}
