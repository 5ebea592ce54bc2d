//! Moving grains and walls: leapfrog, pistons, local damping.

use crate::boundary::{Domain, Signal, Solid};
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::cell::NORMALS;
use rayon::prelude::*;

/// Inertial number at which a piston may deform the sample, unless its speed is given.
const PISTON_INERTIAL_NUMBER: f64 = 0.01;
/// Mass of a piston in terms of the mass of all grains, unless it is given.
const PISTON_MASS_SHARE: f64 = 0.1;
/// Grains handed to a thread at once.
const BLOCK: usize = 1024;

/// Moves everything by one step of length `dt` [s]: velocities from `t - last/2` to `t + dt/2`, then positions to
/// `t + dt` (physics §2). `last` is the length of the step before, zero when the velocities belong to `t` itself.
///
/// `loads` are all loads at time `t`. Local damping (Catalano 2.15) takes `D |F|` from every component of the total
/// load that speeds a grain, a spin or a piston up, and adds it where it slows down.
pub fn advance(state: &mut State, model: &Model, loads: &Loads, dt: f64) {
    let kick = 0.5 * (state.dt + dt);
    move_walls(&mut state.domain, &state.grains, model, loads, state.time - model.stage_start, kick, dt);
    move_grains(&mut state.grains, loads, model.damping, kick, dt);
    state.time += dt;
    state.dt = dt;
    state.step += 1;
}

fn move_grains(grains: &mut Grains, loads: &Loads, damping: f64, kick: f64, dt: f64) {
    let Grains { position, velocity, spin, radius, mass, .. } = grains;
    (position, velocity, spin, &*radius, &*mass, &loads.force, &loads.torque)
        .into_par_iter()
        .with_min_len(BLOCK)
        .for_each(|(position, velocity, spin, &radius, &mass, &force, &torque)| {
            let mobility = kick / mass;
            *velocity += mobility * damped(force, *velocity, damping);
            *spin += mobility / (0.4 * radius * radius) * damped(torque, *spin, damping);
            *position += dt * *velocity;
        });
}

/// The load less its local damping `D |F| sign(v)`, per component.
#[inline(always)]
fn damped(load: DVec3, rate: DVec3, damping: f64) -> DVec3 {
    let drag = |load: f64, rate: f64| {
        let sign = f64::from(rate > 0.0) - f64::from(rate < 0.0);
        load - damping * load.abs() * sign
    };
    DVec3::new(drag(load.x, rate.x), drag(load.y, rate.y), drag(load.z, rate.z))
}

/// `time` counts from the start of the stage.
fn move_walls(
    domain: &mut Domain,
    grains: &Grains,
    model: &Model,
    loads: &Loads,
    time: f64,
    kick: f64,
    dt: f64,
) {
    domain.wall_force = loads.wall;
    for (face, rule) in model.faces.iter().enumerate() {
        let outward = NORMALS[face];
        domain.wall_velocity[face] = match &rule.solid {
            Solid::Fixed => DVec3::ZERO,
            Solid::Moving { velocity } => {
                let part = |signal: &Signal| signal.at(time + 0.5 * dt);
                DVec3::new(part(&velocity[0]), part(&velocity[1]), part(&velocity[2]))
            }
            Solid::Servo { stress, mass, speed } => {
                let area = domain.area(face);
                let (asked, pushed) = (stress.at(time), loads.wall[face].dot(outward));
                let mass = piston_mass(*mass, grains);
                let limit = speed.unwrap_or_else(|| {
                    let along = domain.cell.upper() - domain.cell.origin;
                    piston_speed(grains, along[face / 2], asked.abs().max(pushed.abs() / area))
                });
                let before = domain.wall_velocity[face].dot(outward);
                let net = pushed - asked * area;
                let drag = model.damping * net.abs() * (f64::from(before > 0.0) - f64::from(before < 0.0));
                let after = (before + kick / mass * (net - drag)).clamp(-limit, limit);
                after * outward
            }
        };
    }
    let normal = |face: usize| domain.wall_velocity[face][face / 2];
    let lower = domain.cell.origin + dt * DVec3::new(normal(0), normal(2), normal(4));
    let upper = domain.cell.upper() + dt * DVec3::new(normal(1), normal(3), normal(5));
    domain.cell.origin = lower;
    domain.cell.edges = DMat3::from_diagonal(upper - lower);
}

/// Mass of a piston [kg]: as given, or a tenth of the mass of the grains.
pub fn piston_mass(given: Option<f64>, grains: &Grains) -> f64 {
    given.unwrap_or_else(|| PISTON_MASS_SHARE * sum(&grains.mass))
}

/// Mass of each wall that is a piston [kg], in face order.
pub fn pistons(model: &Model, grains: &Grains) -> [Option<f64>; 6] {
    std::array::from_fn(|face| match &model.faces[face].solid {
        Solid::Servo { mass, .. } => Some(piston_mass(*mass, grains)),
        _ => None,
    })
}

/// The speed at which a sample of this height [m] deforms at the inertial number 0.01 under a stress [Pa]:
/// `0.01 (H/d) sqrt(stress/density)`, d the mean diameter [m/s].
fn piston_speed(grains: &Grains, height: f64, stress: f64) -> f64 {
    let diameter = 2.0 * sum(&grains.radius) / grains.len().max(1) as f64;
    let density = sum(&grains.mass) / grains.volume();
    PISTON_INERTIAL_NUMBER * height / diameter * (stress / density).sqrt()
}

/// Sum in four interleaved parts: the order is fixed and the additions overlap.
fn sum(values: &[f64]) -> f64 {
    let (fours, rest) = values.as_chunks::<4>();
    let parts = fours.iter().fold([0.0; 4], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]);
    parts[0] + parts[1] + parts[2] + parts[3] + rest.iter().sum::<f64>()
}
