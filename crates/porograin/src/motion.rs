//! Moving grains and walls: leapfrog, pistons, local damping.

use crate::boundary::{Domain, Signal, Solid};
use crate::cell;
use crate::grains::{Grains, Loads, Shape};
use crate::model::Model;
use crate::state::State;
use crate::walls;
use glam::{DMat3, DVec3};
use porograin_geometry::cell::NORMALS;
use porograin_geometry::neighbours::BLOCK;
use rayon::prelude::*;

/// Inertial number at which a piston may deform the sample, unless its speed is given (`0.01 (H/d) sqrt(stress/density)`, H the
/// height of the sample and d the mean diameter).
const PISTON_INERTIAL_NUMBER: f64 = 0.01;
/// Mass of a piston in terms of the mass of all grains, unless it is given.
const PISTON_MASS_SHARE: f64 = 0.1;

/// Velocities of everything that moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Velocities {
    /// Of the centres of the grains [m/s].
    pub grain: Vec<DVec3>,
    /// Of the grains [rad/s].
    pub spin: Vec<DVec3>,
    /// Of the walls [m/s].
    pub wall: [DVec3; 6],
    /// Velocity gradient of a periodic cell [1/s]; the velocities of the grains are then those beside its flow.
    pub cell: DMat3,
}

impl Default for Velocities {
    fn default() -> Self {
        // By hand: the default of a matrix is the identity.
        Velocities { grain: Vec::new(), spin: Vec::new(), wall: [DVec3::ZERO; 6], cell: DMat3::ZERO }
    }
}

impl Velocities {
    /// `n` grains and all walls at rest, keeping the memory.
    pub fn clear(&mut self, n: usize) {
        for list in [&mut self.grain, &mut self.spin] {
            list.clear();
            list.resize(n, DVec3::ZERO);
        }
        self.wall = [DVec3::ZERO; 6];
        self.cell = DMat3::ZERO;
    }
}

/// Moves everything by one step of length `dt` [s]: velocities from `t - last/2` to `t + dt/2`, then positions to
/// `t + dt` (physics §2). `last` is the length of the step before, zero when the velocities belong to `t` itself.
///
/// `loads` are all loads of the step. Local damping (Catalano 2.15) takes `D |F|` from every component that speeds a
/// grain, a spin or a piston up, and adds it where it slows down. Its `F` is `felt`, the loads known at time `t`: all
/// loads again, unless an implicit step finds some of them in its middle.
pub fn advance(state: &mut State, model: &Model, loads: &Loads, felt: &Loads, dt: f64, moved: &mut Moved) {
    let kick = kick(state, dt);
    state.domain.wall_force = loads.wall;
    let velocity = |face| wall_motion(face, state, model, loads.wall[face], felt.wall[face], dt).allowed();
    state.domain.wall_velocity = std::array::from_fn(velocity);
    let before = state.domain.walls.clone();
    walls::motion::advance(state, model, &loads.walls, dt);
    walls::glue::take_along(&state.domain, &before, &mut state.grains, dt);
    let rates = [model.damping, kick, dt];
    if !state.domain.is_periodic() {
        move_walls(&mut state.domain, dt);
        let cell = &state.domain.cell;
        let room = [cell.origin, cell.upper()];
        move_grains(&mut state.grains, loads, felt, rates, room, |_, velocity| velocity, moved);
    } else {
        let rate = cell::motion(state, model, loads, felt, dt).allowed();
        let State { domain, grains, .. } = state;
        let (before, origin) = (domain.gradient, domain.cell.origin);
        let boost = cell::carry(domain, grains, rate, dt);
        // What goes with a place is not slowed down.
        let stretch = before + boost;
        let peculiar = |x: DVec3, v: DVec3| v - stretch * (x - origin);
        // Who has left is told once the grains are back in the cell.
        let nowhere = [DVec3::NAN; 2];
        move_grains(grains, loads, felt, rates, nowhere, peculiar, moved);
        move_walls(domain, dt);
        cell::advance(domain, grains, dt);
    }
    state.time += dt;
    state.dt = dt;
    state.step += 1;
}

/// How the grains have moved in a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moved {
    /// The longest way of a grain in each [`BLOCK`] [m].
    pub furthest: Vec<f64>,
    /// Whether all centres are known to be within the box.
    pub inside: bool,
}

/// How long the loads of a step of length `dt` act on the velocities [s].
pub fn kick(state: &State, dt: f64) -> f64 {
    0.5 * (state.dt + dt)
}

/// The velocities that [`advance`] would give to the grains, beside the flow of a periodic cell, written to `out`; those
/// of the walls are left to [`wall_motion`], the cell's to [`cell::motion`].
pub fn foresee(state: &State, model: &Model, loads: &Loads, felt: &Loads, dt: f64, out: &mut Velocities) {
    let (grains, damping, kick) = (&state.grains, model.damping, kick(state, dt));
    out.grain.resize(grains.len(), DVec3::ZERO);
    out.spin.resize(grains.len(), DVec3::ZERO);
    (&mut out.grain, &mut out.spin).into_par_iter().with_min_len(BLOCK).enumerate().for_each(
        |(i, (velocity, spin))| {
            let (before, turning) =
                (state.domain.peculiar(grains.position[i], grains.velocity[i]), grains.spin[i]);
            let force = damped(loads.force[i], felt.force[i], before, damping);
            let torque = damped(loads.torque[i], felt.torque[i], turning, damping);
            *velocity = before + kick / grains.mass[i] * force;
            *spin = turning + kick / grains.inertia(i) * torque;
        },
    );
}

fn move_grains(
    grains: &mut Grains,
    loads: &Loads,
    felt: &Loads,
    [damping, kick, dt]: [f64; 3],
    [lower, upper]: [DVec3; 2],
    rate: impl Fn(DVec3, DVec3) -> DVec3 + Sync,
    moved: &mut Moved,
) {
    let gyration = grains.shape.gyration();
    // Discs stay in the plane of x and z and turn about y only.
    let (along, about) = match grains.shape {
        Shape::Sphere => (DVec3::ONE, DVec3::ONE),
        Shape::Disc { .. } => (DVec3::new(1.0, 0.0, 1.0), DVec3::Y),
    };
    let [lower, upper, along, about] = [lower, upper, along, about].map(|v| flat(&[v; 4]));
    let push = Pushed { damping, gyration, kick, dt, lower, upper, along, about };
    let Grains { position, velocity, spin, radius, mass, .. } = grains;
    let block = |k: usize, position: &mut [DVec3], velocity: &mut [DVec3], spin: &mut [DVec3]| {
        let range = k * BLOCK..k * BLOCK + position.len();
        let loads = [&loads.force, &loads.torque, &felt.force, &felt.torque].map(|list| &list[range.clone()]);
        push.run([position, velocity, spin], [&radius[range.clone()], &mass[range.clone()]], loads, &rate)
    };
    let Moved { furthest, inside } = moved;
    furthest.resize(position.len().div_ceil(BLOCK), 0.0);
    let parts = (
        position.par_chunks_mut(BLOCK),
        velocity.par_chunks_mut(BLOCK),
        spin.par_chunks_mut(BLOCK),
        furthest.par_iter_mut(),
    );
    *inside = parts
        .into_par_iter()
        .enumerate()
        .map(|(k, (position, velocity, spin, furthest))| {
            let inside;
            (*furthest, inside) = block(k, position, velocity, spin);
            inside
        })
        .reduce(|| true, |a, b| a && b);
}

/// How grains are moved, four at a time, so that wide vectors hold nothing idle; the bits are those of one at a time.
struct Pushed {
    damping: f64,
    gyration: f64,
    kick: f64,
    dt: f64,
    /// Corners of the box, and directions in which grains are free to move and to turn, once for each of four.
    lower: [f64; 12],
    upper: [f64; 12],
    along: [f64; 12],
    about: [f64; 12],
}

impl Pushed {
    /// `moved` are places, velocities and spins, `what` radii and masses, `loads` forces and torques and those that damping feels; returns
    /// the longest way [m] and whether all are within the box.
    fn run(
        &self,
        moved: [&mut [DVec3]; 3],
        what: [&[f64]; 2],
        loads: [&[DVec3]; 4],
        rate: &impl Fn(DVec3, DVec3) -> DVec3,
    ) -> (f64, bool) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.run_avx2(moved, what, loads, rate) };
        }
        self.run_fours(moved, what, loads, rate)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn run_avx2(
        &self,
        moved: [&mut [DVec3]; 3],
        what: [&[f64]; 2],
        loads: [&[DVec3]; 4],
        rate: &impl Fn(DVec3, DVec3) -> DVec3,
    ) -> (f64, bool) {
        self.run_fours(moved, what, loads, rate)
    }

    #[inline(always)]
    fn run_fours(
        &self,
        moved: [&mut [DVec3]; 3],
        what: [&[f64]; 2],
        loads: [&[DVec3]; 4],
        rate: &impl Fn(DVec3, DVec3) -> DVec3,
    ) -> (f64, bool) {
        let mut moved = moved.map(|list| list.as_chunks_mut::<4>());
        let (what, loads) = (what.map(|list| list.as_chunks::<4>()), loads.map(|list| list.as_chunks::<4>()));
        let (mut fastest, mut inside) = (0.0, true);
        let mut take = |(squared, within): (f64, bool)| {
            fastest = if squared > fastest { squared } else { fastest };
            inside &= within;
        };
        let [x, v, w] = &mut moved;
        for k in 0..x.0.len() {
            let (what, loads) = (what.map(|list| &list.0[k]), loads.map(|list| &list.0[k]));
            take(self.four([&mut x.0[k], &mut v.0[k], &mut w.0[k]], what, loads, rate));
        }
        if !x.1.is_empty() {
            let mut few = [filled(x.1), filled(v.1), filled(w.1)];
            let (what, loads) = (what.map(|list| filled(list.1)), loads.map(|list| filled(list.1)));
            take(self.four(few.each_mut(), what.each_ref(), loads.each_ref(), rate));
            moved.into_iter().zip(&few).for_each(|(list, few)| list.1.copy_from_slice(&few[..list.1.len()]));
        }
        (self.dt * f64::sqrt(fastest), inside)
    }

    /// Moves four grains; returns the largest square of their velocities, and whether all are within the box.
    #[inline(always)]
    fn four(
        &self,
        [position, velocity, spin]: [&mut [DVec3; 4]; 3],
        [radius, mass]: [&[f64; 4]; 2],
        [force, torque, felt, turned]: [&[DVec3; 4]; 4],
        rate: &impl Fn(DVec3, DVec3) -> DVec3,
    ) -> (f64, bool) {
        let (mut mobility, mut turning) = ([0.0; 4], [0.0; 4]);
        for g in 0..4 {
            mobility[g] = self.kick / mass[g];
            turning[g] = mobility[g] / (self.gyration * radius[g] * radius[g]);
        }
        let rates = std::array::from_fn(|g| rate(position[g], velocity[g]));
        let (mut x, mut v, mut w) = (flat(position), flat(velocity), flat(spin));
        let push = self.kicked(&flat(&rates), force, felt, &self.along, &mobility);
        let turn = self.kicked(&w, torque, turned, &self.about, &turning);
        let mut squares = [0.0; 12];
        let mut inside = true;
        for c in 0..12 {
            v[c] += push[c];
            w[c] += turn[c];
            x[c] += self.dt * v[c];
            squares[c] = v[c] * v[c];
            // A comparison with NaN is false, so one test finds both who left and who is nowhere.
            inside &= (self.lower[c] <= x[c]) & (x[c] <= self.upper[c]);
        }
        let mut fastest = 0.0;
        for g in 0..4 {
            let squared = squares[3 * g] + squares[3 * g + 1] + squares[3 * g + 2];
            fastest = if squared > fastest { squared } else { fastest };
        }
        (*position, *velocity, *spin) = (grouped(x), grouped(v), grouped(w));
        (fastest, inside)
    }

    /// What loads add to the rates of four grains.
    #[inline(always)]
    fn kicked(
        &self,
        rate: &[f64; 12],
        load: &[DVec3; 4],
        felt: &[DVec3; 4],
        free: &[f64; 12],
        mobility: &[f64; 4],
    ) -> [f64; 12] {
        let (load, felt, mut kick) = (flat(load), flat(felt), [0.0; 12]);
        for c in 0..12 {
            let load = against(load[c] * free[c], felt[c] * free[c], rate[c], self.damping);
            kick[c] = mobility[c / 3] * load;
        }
        kick
    }
}

/// Four in place of a few: the last again and again.
fn filled<T: Copy>(few: &[T]) -> [T; 4] {
    std::array::from_fn(|g| few[g.min(few.len() - 1)])
}

#[inline(always)]
fn flat(four: &[DVec3; 4]) -> [f64; 12] {
    std::array::from_fn(|c| four[c / 3][c % 3])
}

#[inline(always)]
fn grouped(flat: [f64; 12]) -> [DVec3; 4] {
    std::array::from_fn(|g| DVec3::new(flat[3 * g], flat[3 * g + 1], flat[3 * g + 2]))
}

/// The load less the local damping `D |felt| sign(v)`, per component.
#[inline(always)]
pub fn damped(load: DVec3, felt: DVec3, rate: DVec3, damping: f64) -> DVec3 {
    let part = |axis: usize| against(load[axis], felt[axis], rate[axis], damping);
    DVec3::new(part(0), part(1), part(2))
}

/// The same for one component.
#[inline(always)]
fn against(load: f64, felt: f64, rate: f64, damping: f64) -> f64 {
    // The sign of a velocity; nothing slows what is at rest.
    let size = if rate != 0.0 { damping * felt.abs() } else { 0.0 };
    load - size.copysign(rate)
}

/// What a push does to a wall.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WallMotion {
    /// Velocity in the middle of the step [m/s]; of a piston, had it no limit.
    pub velocity: DVec3,
    /// What a further force along the outward normal adds to that velocity [m/s per N]; 0 unless a piston.
    pub mobility: f64,
    /// No piston is faster than this [m/s].
    pub limit: f64,
}

impl WallMotion {
    /// The velocity, within the limit of a piston.
    pub fn allowed(&self) -> DVec3 {
        // A piston moves along one axis, so that this holds its speed.
        self.velocity.clamp(DVec3::splat(-self.limit), DVec3::splat(self.limit))
    }
}

/// How wall `face` moves in a step of length `dt` under the force `load` of grains and water; `felt` is the force
/// at the beginning of the step, see [`advance`].
pub fn wall_motion(
    face: usize,
    state: &State,
    model: &Model,
    load: DVec3,
    felt: DVec3,
    dt: f64,
) -> WallMotion {
    let (domain, grains) = (&state.domain, &state.grains);
    let time = state.time - model.stage_start;
    let decreed = |velocity| WallMotion { velocity, mobility: 0.0, limit: f64::INFINITY };
    match &model.faces[face].solid {
        Solid::Fixed => decreed(DVec3::ZERO),
        Solid::Moving { velocity } => {
            let part = |signal: &Signal| signal.at(time + 0.5 * dt);
            decreed(DVec3::new(part(&velocity[0]), part(&velocity[1]), part(&velocity[2])))
        }
        Solid::Servo { stress, mass, speed } => {
            let outward = NORMALS[face];
            let (area, asked) = (domain.area(face), stress.at(time));
            let known = felt.dot(outward);
            let all = Totals::of(grains);
            let limit = speed.unwrap_or_else(|| {
                let along = domain.cell.upper() - domain.cell.origin;
                let stress = asked.abs().max(known.abs() / area);
                PISTON_INERTIAL_NUMBER * along[face / 2] * all.inertial_rate(stress)
            });
            let before = domain.wall_velocity[face].dot(outward);
            let sign = f64::from(before > 0.0) - f64::from(before < 0.0);
            let drag = model.damping * (known - asked * area).abs() * sign;
            let mass = mass.unwrap_or(PISTON_MASS_SHARE * all.mass) + domain.glue.mass(face, grains);
            let mobility = kick(state, dt) / mass;
            let after = before + mobility * (load.dot(outward) - asked * area - drag);
            WallMotion { velocity: after * outward, mobility, limit }
        }
    }
}

fn move_walls(domain: &mut Domain, dt: f64) {
    let normal = |face: usize| domain.wall_velocity[face][face / 2];
    let lower = domain.cell.origin + dt * DVec3::new(normal(0), normal(2), normal(4));
    let upper = domain.cell.upper() + dt * DVec3::new(normal(1), normal(3), normal(5));
    domain.cell.origin = lower;
    for axis in (0..3).filter(|&axis| !domain.cell.periodic[axis]) {
        *domain.cell.edges.col_mut(axis) = (upper - lower)[axis] * DVec3::AXES[axis];
    }
}

/// Mass of a piston [kg]: as given, or a tenth of the mass of the grains.
pub fn piston_mass(given: Option<f64>, grains: &Grains) -> f64 {
    given.unwrap_or_else(|| PISTON_MASS_SHARE * Totals::of(grains).mass)
}

/// Mass of each wall that is a piston [kg], in face order.
pub fn pistons(model: &Model, grains: &Grains) -> [Option<f64>; 6] {
    std::array::from_fn(|face| match &model.faces[face].solid {
        Solid::Servo { mass, .. } => Some(piston_mass(*mass, grains)),
        _ => None,
    })
}

/// The rate of deformation whose inertial number is 1 under a stress [Pa]: `sqrt(stress/density)/d`, d the mean
/// diameter [1/s].
pub fn inertial_rate(grains: &Grains, stress: f64) -> f64 {
    Totals::of(grains).inertial_rate(stress)
}

/// Sums over all grains.
struct Totals {
    count: usize,
    /// [m]
    radius: f64,
    /// [kg]
    mass: f64,
    /// [m³]
    volume: f64,
}

impl Totals {
    fn of(grains: &Grains) -> Totals {
        let ((radii, few_radii), (masses, few_masses)) =
            (grains.radius.as_chunks::<8>(), grains.mass.as_chunks::<8>());
        let volume_of = |r| grains.shape.volume(r);
        // In eight interleaved parts: the order is fixed and the additions overlap.
        let (mut radius, mut mass, mut volume) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for (r, m) in radii.iter().zip(masses) {
            for k in 0..8 {
                radius[k] += r[k];
                mass[k] += m[k];
                volume[k] += volume_of(r[k]);
            }
        }
        let sum = |parts: [f64; 8], few: f64| parts.iter().sum::<f64>() + few;
        let radius = sum(radius, few_radii.iter().sum());
        let mass = sum(mass, few_masses.iter().sum());
        let volume = sum(volume, few_radii.iter().copied().map(volume_of).sum());
        Totals { count: grains.len(), radius, mass, volume }
    }

    fn inertial_rate(&self, stress: f64) -> f64 {
        let diameter = 2.0 * self.radius / self.count.max(1) as f64;
        (stress / (self.mass / self.volume)).sqrt() / diameter
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four at a time, and those that are left over, move as each would alone, to the last bit.
    #[test]
    fn grains_move_together_as_each_would_alone() {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let [lower, upper] = [DVec3::ZERO, DVec3::ONE];
        for (n, shape) in [
            (0_usize, Shape::Sphere),
            (1, Shape::Sphere),
            (2051, Shape::Sphere),
            (7, Shape::Disc { thickness: 0.2 }),
        ] {
            let mut vectors =
                || -> Vec<DVec3> { (0..n).map(|_| DVec3::new(next(), next(), next())).collect() };
            let (position, velocity, spin) = (vectors(), vectors(), vectors());
            let [force, torque, felt, turned] = [(); 4].map(|_| vectors());
            let radius = vectors().iter().map(|v| 0.1 + v.x).collect();
            let mut grains = Grains::shaped(shape, position, radius, 100.0);
            grains.velocity = velocity.iter().map(|v| v - DVec3::splat(0.5)).collect();
            grains.spin = spin.iter().map(|w| w - DVec3::splat(0.5)).collect();
            if n > 2 {
                // Nothing slows what is at rest.
                grains.velocity[1].y = 0.0;
            }
            let loads = Loads { force, torque, ..Loads::default() };
            let felt = Loads { force: felt, torque: turned, ..Loads::default() };
            let (damping, kick, dt, drift) = (0.3, 0.02, 0.01, DVec3::new(0.2, 0.0, -0.1));
            let (along, about) = match shape {
                Shape::Sphere => (DVec3::ONE, DVec3::ONE),
                Shape::Disc { .. } => (DVec3::new(1.0, 0.0, 1.0), DVec3::Y),
            };
            let mut alone = grains.clone();
            let (mut furthest, mut inside) = (vec![0.0_f64; n.div_ceil(BLOCK)], true);
            for k in 0..n {
                let (v, w) = (alone.velocity[k], alone.spin[k]);
                let mobility = kick / alone.mass[k];
                let turning = mobility / (shape.gyration() * alone.radius[k] * alone.radius[k]);
                alone.velocity[k] +=
                    mobility * damped(loads.force[k] * along, felt.force[k] * along, v - drift, damping);
                alone.spin[k] +=
                    turning * damped(loads.torque[k] * about, felt.torque[k] * about, w, damping);
                alone.position[k] += dt * alone.velocity[k];
                furthest[k / BLOCK] = furthest[k / BLOCK].max(dt * alone.velocity[k].length());
                inside &= lower.cmple(alone.position[k]).all() && alone.position[k].cmple(upper).all();
            }
            let room = [lower, upper];
            let (rates, mut moved) = ([damping, kick, dt], Moved::default());
            move_grains(&mut grains, &loads, &felt, rates, room, |_, v| v - drift, &mut moved);
            assert_eq!(grains, alone, "{n}");
            assert_eq!(moved, Moved { furthest, inside }, "{n}");
            // One that is nowhere is not inside, wherever it stands.
            for k in (0..n).take(6).chain(n.checked_sub(1)) {
                let mut lost = grains.clone();
                lost.position.iter_mut().for_each(|x| *x = DVec3::splat(0.5));
                lost.velocity.fill(DVec3::ZERO);
                let none =
                    Loads { force: vec![DVec3::ZERO; n], torque: vec![DVec3::ZERO; n], ..Loads::default() };
                let mut go = |lost: &mut Grains| {
                    move_grains(lost, &none, &none, rates, room, |_, v| v, &mut moved);
                    moved.inside
                };
                assert!(go(&mut lost));
                lost.position[k].z = f64::NAN;
                assert!(!go(&mut lost), "{k}");
            }
        }
    }
}
