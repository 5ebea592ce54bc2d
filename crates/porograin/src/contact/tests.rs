//! The battery every contact law has to pass.

use super::memory::ROW;
use super::*;
use crate::boundary::{Domain, Face, Solid};
use crate::grains::{Grains, Loads};
use glam::{DMat3, DQuat, DVec3};
use porograin_geometry::Neighbours;
use porograin_geometry::triangulation::FIRST_WALL;
use std::collections::{BTreeMap, BTreeSet};

/// One of each law, stiff enough in shear and with enough friction for every term to count.
fn laws() -> Vec<Law> {
    let (linear, hertz) = (Linear::new(1e6, 0.6, 35.0), HertzMindlin::new(5e6, 0.3, 35.0));
    let choices = vec![Law::Linear(linear), Law::HertzMindlin(hertz)];
    for law in &choices {
        // A new law does not compile until it is listed here and above.
        match law {
            Law::Linear(_) | Law::HertzMindlin(_) => (),
        }
    }
    choices
}

/// The same with all they can have besides that does not pull.
fn rich_laws() -> Vec<Law> {
    let mut laws = laws();
    for law in &mut laws {
        match law {
            Law::Linear(law) => (law.restitution, law.rolling) = (Some(0.5.into()), Some(ROLLING)),
            Law::HertzMindlin(law) => (law.restitution, law.rolling) = (Some(0.5.into()), Some(ROLLING)),
        }
    }
    laws
}

/// The same with all that pulls.
fn sticky_laws() -> Vec<Law> {
    let mut laws = laws();
    for law in &mut laws {
        match law {
            Law::Linear(law) => {
                law.adhesion = Some(ADHESION);
                (law.rolling, law.capillary) = (Some(ROLLING), Some(BRIDGE));
            }
            Law::HertzMindlin(law) => (law.rolling, law.capillary) = (Some(ROLLING), Some(BRIDGE)),
        }
    }
    laws
}

const ROLLING: Rolling = Rolling { friction: 0.3, stiffness: 0.8, twist_friction: 0.2, twist_stiffness: 0.6 };
const ADHESION: Adhesion = Adhesion { tension: 2e4, cohesion: 1e4, renew: false };
const BRIDGE: Capillary = Capillary { volume: 1e-6, surface_tension: 100.0, contact_angle: 20.0 };

fn all_laws() -> Vec<Law> {
    [laws(), rich_laws(), sticky_laws()].concat()
}

struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5) * 2.0
    }
}

fn domain() -> Domain {
    Domain::walled(DVec3::splat(-1.0), DVec3::splat(1.0))
}

fn faces() -> [Face; 6] {
    std::array::from_fn(|_| Face { solid: Solid::Fixed, friction: 20.0, ..Face::default() })
}

/// Two grains of different size, or one grain at a wall, overlapping by 2 %.
fn pair(second_is_wall: bool) -> (Grains, [u32; 2]) {
    let direction = DVec3::new(0.6, -0.48, 0.64);
    let (a, b) = (0.1, 0.07);
    if second_is_wall {
        let grains = Grains::at_rest(vec![DVec3::new(0.2, -0.1, 0.902)], vec![a], 1000.0);
        (grains, [0, porograin_geometry::triangulation::FIRST_WALL + 5])
    } else {
        let centres = vec![DVec3::new(0.1, 0.2, 0.3), DVec3::new(0.1, 0.2, 0.3) + 0.98 * (a + b) * direction];
        (Grains::at_rest(centres, vec![a, b], 1000.0), [0, 1])
    }
}

/// Force and torque on every grain, and energy, after the grains and spins moved by `change` in one step.
fn moved(law: &Law, wall: bool, shear: DVec3, change: &[(DVec3, DVec3)]) -> (Loads, f64) {
    let (mut grains, pair) = pair(wall);
    for (k, (shift, turn)) in change.iter().enumerate() {
        grains.position[k] += *shift;
        grains.velocity[k] = *shift;
        grains.spin[k] = *turn;
    }
    let mut contacts = Contacts::new([(pair, shear)]);
    let (faces, domain, laws) = (faces(), domain(), Laws::from(law.clone()));
    let around = Surroundings::new(&grains, &domain, &faces, &[], &laws);
    let mut loads = Loads::default();
    loads.clear(grains.len());
    add(&mut loads, &mut contacts, &around, 1.0, &mut Scratch::default());
    let energy = law.energy(&around.touch(pair), &contacts.rows[0].memory(0));
    (loads, energy)
}

#[test]
fn loads_are_minus_the_gradient_of_the_energy() {
    for law in [laws(), sticky_laws()].concat() {
        for wall in [false, true] {
            let (grains, pair) = pair(wall);
            let (faces, domain, laws) = (faces(), domain(), Laws::from(law.clone()));
            let touch = Surroundings::new(&grains, &domain, &faces, &[], &laws).touch(pair);
            let pressing = law.load(&touch, &mut Memory::default(), 0.0).force.length();
            let none = vec![(DVec3::ZERO, DVec3::ZERO); grains.len()];
            // A shear force well inside the friction cone; where `k_t` depends on the overlap, the shear spring is held by
            // the normal one and has an energy across the normal only.
            for shear in [DVec3::ZERO, 0.1 * pressing * touch.normal.any_orthonormal_vector()] {
                let whole = shear == DVec3::ZERO || matches!(law, Law::Linear(_));
                let (loads, _) = moved(&law, wall, shear, &none);
                let h = 1e-7;
                for k in 0..grains.len() {
                    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                        for spin in [false, true] {
                            let mut axis = axis;
                            if !spin && !whole {
                                axis -= axis.dot(touch.normal) * touch.normal;
                            }
                            let at = |s: f64| {
                                let mut change = none.clone();
                                *(if spin { &mut change[k].1 } else { &mut change[k].0 }) = s * axis;
                                moved(&law, wall, shear, &change).1
                            };
                            let gradient = (at(h) - at(-h)) / (2.0 * h);
                            let (load, scale) = if spin {
                                (loads.torque[k].dot(axis), 0.1 * pressing)
                            } else {
                                (loads.force[k].dot(axis), pressing)
                            };
                            assert!(
                                (load + gradient).abs() < 1e-5 * scale,
                                "{law:?} {load} {gradient} {k} {axis} {spin} {wall}"
                            );
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn turned_with_the_frame_the_load_turns_along() {
    let mut next = Numbers(3);
    for law in all_laws() {
        for _ in 0..100 {
            let turn = DQuat::from_scaled_axis(3.0 * next.vector());
            let normal = next.vector().normalize();
            let touch = Touch {
                normal,
                overlap: 1e-3,
                radius: [0.1, 0.2],
                velocity: 0.1 * next.vector(),
                spin: next.vector(),
                twist: 0.3,
                friction: 0.4,
                mass: 2.0,
            };
            let across = |v: DVec3| v.cross(normal);
            let more =
                More { roll: across(next.vector()), twist: next.next(), bond: Bond::Whole, bridge: true };
            let start = Memory { shear: across(next.vector()), more, ..Memory::default() };
            let mut there = start;
            there.shear = turn * start.shear;
            there.more.roll = turn * start.more.roll;
            let mut here = start;
            let load = law.load(&touch, &mut here, 1e-4);
            let (normal, velocity) = (turn * touch.normal, turn * touch.velocity);
            let turned = Touch { normal, velocity, spin: turn * touch.spin, ..touch };
            let same = law.load(&turned, &mut there, 1e-4);
            assert!((turn * load.force - same.force).length() < 1e-12 * load.force.length());
            assert!((turn * load.moment - same.moment).length() <= 1e-12 * load.moment.length());
            assert!((turn * here.shear - there.shear).length() < 1e-12 * here.shear.length().max(1e-3));
            assert!((turn * here.more.roll - there.more.roll).length() <= 1e-12 * here.more.roll.length());
        }
    }
}

#[test]
fn the_shear_force_stays_in_the_friction_cone_and_nothing_pulls() {
    let mut next = Numbers(4);
    for law in [laws(), rich_laws()].concat() {
        let (mut memory, mut slid) = (Memory::default(), 0);
        let mut touch = Touch::prospective([0.1, 0.15], 1e-3, 2.0);
        touch.friction = 0.4;
        for _ in 0..1000 {
            touch.overlap = 1e-3 * next.next();
            touch.velocity = next.vector();
            memory.turn(touch.normal, 0.0);
            let force = law.load(&touch, &mut memory, 1e-4).force;
            let pressing = -force.dot(touch.normal);
            let shear = force + pressing * touch.normal;
            assert!(pressing >= 0.0 && shear.length() <= 0.4 * pressing * (1.0 + 1e-12));
            assert!(shear.dot(touch.normal).abs() <= 1e-12 * pressing);
            slid += (shear.length() > 0.399 * pressing) as u32;
        }
        assert!((100..1000).contains(&slid), "{slid}");
    }
}

/// Work put in less energy stored, along closed loops of the relative position, pressing and sliding.
#[test]
fn closed_loops_never_give_energy() {
    let mut next = Numbers(5);
    for law in [laws(), sticky_laws()].concat() {
        let mut rubbed = 0;
        for _ in 0..40 {
            let (a, b, phase) = (next.vector(), next.vector(), 6.0 * next.next());
            let path = |t: f64| {
                let angle = std::f64::consts::TAU * t;
                2e-4 * (a * angle.sin() + b * ((2.0 * angle + phase).sin() - phase.sin()))
            };
            let start = DVec3::new(0.1 + 0.1 - 8e-4, 0.0, 0.0);
            let touch_at = |x: DVec3, velocity: DVec3| Touch {
                normal: x.normalize(),
                overlap: 0.2 - x.length(),
                velocity,
                friction: 0.4,
                ..Touch::prospective([0.1, 0.1], 0.0, 1.0)
            };
            let (mut memory, steps, mut lost) = (Memory::default(), 10_000, 0.0);
            let mut force = law.load(&touch_at(start, DVec3::ZERO), &mut memory, 0.0).force;
            let begin = law.energy(&touch_at(start, DVec3::ZERO), &memory);
            let (mut work, mut size, mut worst) = (0.0, 0.0_f64, 0.0_f64);
            for k in 1..=steps {
                let (x0, x1) = (path((k - 1) as f64 / steps as f64), path(k as f64 / steps as f64));
                let touch = touch_at(start + x1, x1 - x0);
                memory.turn(touch.normal, 0.0);
                let now = law.load(&touch, &mut memory, 1.0).force;
                // The force on the second is minus `now`; holding it takes `now`.
                work += 0.5 * (force + now).dot(x1 - x0);
                force = now;
                let balance = work - (law.energy(&touch, &memory) - begin);
                worst = worst.min(balance - lost);
                lost = balance;
                size = size.max(work.abs());
            }
            // A loop that never slides gives back everything but the error of finite steps.
            assert!(lost > -1e-6 * size && worst > -1e-6 * size, "{lost} {worst} {size}");
            rubbed += (lost > 1e-3 * size) as u32;
        }
        // Unloading a sheared contact of Hertz and Mindlin costs energy even where nothing slides.
        let most = if matches!(law, Law::Linear(_)) { 30 } else { 41 };
        assert!((10..most).contains(&rubbed), "{rubbed}");
    }
}

/// A loaded pair that turns as one rigid body keeps its shear force in the turning frame.
#[test]
fn the_memory_turns_with_a_rigidly_turning_pair() {
    let laws = Laws::from(laws()[0].clone());
    let axis = DVec3::new(0.5, 0.7, -0.3);
    let error = |steps: usize| {
        let (mut grains, pair) = pair(false);
        let (faces, domain) = (faces(), domain());
        let centre = grains.position[0];
        let arm = grains.position[1] - centre;
        let start = 100.0 * arm.normalize().any_orthonormal_vector();
        let mut contacts = Contacts::new([(pair, start)]);
        let mut loads = Loads::default();
        for k in 1..=steps {
            let at = |k: usize| centre + DQuat::from_scaled_axis(axis * k as f64 / steps as f64) * arm;
            grains.velocity[1] = (at(k) - at(k - 1)) * steps as f64;
            grains.position[1] = at(k);
            grains.spin = vec![axis; 2];
            loads.clear(2);
            let around = Surroundings::new(&grains, &domain, &faces, &[], &laws);
            add(&mut loads, &mut contacts, &around, 1.0 / steps as f64, &mut Scratch::default());
        }
        let expected = DQuat::from_scaled_axis(axis) * start;
        (contacts.rows[0].shear[0] - expected).length() / start.length()
    };
    let (coarse, fine) = (error(2000), error(4000));
    assert!(fine < 0.02 && fine < 0.6 * coarse, "{coarse} {fine}");
}

/// A dense random cluster with spins; with `walls` some grains press on walls.
fn cluster(n: usize, walls: bool, seed: u64) -> (Grains, Contacts, Neighbours) {
    let mut next = Numbers(seed);
    let reach = if walls { 0.97 } else { 0.7 };
    let position = (0..n).map(|_| reach * next.vector()).collect();
    let radius = (0..n).map(|_| 0.05 + 0.06 * next.next()).collect();
    let mut grains = Grains::at_rest(position, radius, 1000.0);
    grains.velocity.iter_mut().for_each(|v| *v = next.vector());
    grains.spin.iter_mut().for_each(|w| *w = 10.0 * next.vector());
    let mut near = Neighbours::default();
    near.refresh(&domain().cell, &grains.position, &grains.radius, 0.0);
    (grains, Contacts::default(), near)
}

fn loads_of(law: &Law, grains: &Grains, contacts: &mut Contacts, near: &Neighbours) -> Loads {
    let (faces, domain, mut scratch) = (faces(), domain(), Scratch::default());
    let laws = Laws::from(law.clone());
    let around = Surroundings::new(grains, &domain, &faces, &[], &laws);
    follow(contacts, &around, near, true, &mut scratch);
    let mut loads = Loads::default();
    loads.clear(grains.len());
    add(&mut loads, contacts, &around, 1e-4, &mut scratch);
    loads
}

#[test]
fn forces_and_moments_balance() {
    for law in all_laws() {
        let (grains, mut contacts, near) = cluster(1500, true, 7);
        let loads = loads_of(&law, &grains, &mut contacts, &near);
        let size: f64 = loads.force.iter().map(|f| f.length()).sum();
        let sum = loads.force.iter().sum::<DVec3>() + loads.wall.iter().sum::<DVec3>();
        assert!(loads.wall[3].y > 1e-3 * size / 6.0 && loads.wall[2].y < 0.0);
        assert!(sum.length() < 1e-13 * size, "{sum} of {size}");

        let (grains, mut contacts, near) = cluster(1500, false, 8);
        let loads = loads_of(&law, &grains, &mut contacts, &near);
        let moments =
            || (0..grains.len()).map(|k| grains.position[k].cross(loads.force[k]) + loads.torque[k]);
        let size: f64 = moments().map(|m| m.length()).sum();
        let sum: DVec3 = moments().sum();
        assert!(sum.length() < 1e-13 * size, "{sum} of {size}");
    }
}

#[test]
fn a_common_velocity_and_a_turned_frame_change_nothing() {
    for law in all_laws() {
        let (grains, mut contacts, near) = cluster(300, false, 9);
        let loads = loads_of(&law, &grains, &mut contacts, &near);
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.3, -0.8, 0.5)));
        let mut other = grains.clone();
        other.position.iter_mut().for_each(|x| *x = turn * *x * 0.999_999_999_999);
        other.position.iter_mut().for_each(|x| *x /= 0.999_999_999_999);
        other.velocity.iter_mut().for_each(|v| *v = turn * *v + DVec3::new(3.0, -2.0, 1.0));
        other.spin.iter_mut().for_each(|w| *w = turn * *w);
        let mut near = Neighbours::default();
        near.refresh(&domain().cell, &other.position, &other.radius, 0.0);
        // Turned corners may reach the walls of the box, which is not part of this test.
        near.pairs.retain(|pair| porograin_geometry::triangulation::wall(pair[1]).is_none());
        let same = loads_of(&law, &other, &mut Contacts::default(), &near);
        let size = loads.force.iter().map(|f| f.length()).fold(0.0, f64::max);
        for k in 0..grains.len() {
            assert!((turn * loads.force[k] - same.force[k]).length() < 1e-11 * size);
            assert!((turn * loads.torque[k] - same.torque[k]).length() < 1e-11 * size);
        }
    }
}

/// Who stays keeps what it remembers, whoever comes and goes; as a map would do it.
#[test]
fn contacts_remember_while_others_come_and_go() {
    let mut next = Numbers(5);
    let mut contacts = Contacts::default();
    contacts.remember(&rich_laws()[0].clone().into());
    contacts.cover(3 * ROW);
    let mut known = BTreeMap::new();
    for round in 0..200 {
        let mut number = |below: usize| (next.next() * below as f64) as u32;
        let pairs = (0..40).map(|_| [number(3 * ROW), number(5)]).filter(|pair| !known.contains_key(pair));
        let born: Vec<[u32; 2]> = pairs.collect::<BTreeSet<_>>().into_iter().collect();
        contacts.insert(&born);
        known.extend(born.iter().map(|&pair| (pair, Memory::default())));
        for row in &mut contacts.rows {
            let parted: Vec<u32> = (0..row.pairs.len() as u32).filter(|_| number(100) < round / 4).collect();
            parted.iter().for_each(|&k| _ = known.remove(&row.pairs[k as usize]));
            row.remove(&parted);
        }
        assert!(contacts.iter().eq(known.iter().map(|(pair, memory)| (*pair, *memory))), "{round}");
        assert_eq!(contacts.len(), known.len());
        let mut told = f64::from(round);
        for row in &mut contacts.rows {
            for k in 0..row.pairs.len() {
                told += 1.0;
                (row.shear[k].y, row.more[k].twist) = (told, 2.0 * told);
                known.insert(row.pairs[k], row.memory(k));
            }
        }
    }
    assert!(known.len() > 20, "{}", known.len());
}

#[test]
fn pairs_enter_and_leave_in_order() {
    let [all_move, few_move] = [false, true].map(pairs_that_come_and_go);
    assert!(all_move[0] > 50 && all_move[1] > 50, "{all_move:?}");
    // The pairs of the few are found one by one.
    assert!(few_move[0] > 3 && few_move[1] > 3 && few_move[2] > 20 && few_move[3] == 1, "{few_move:?}");
}

/// How many pairs come and go, how often grains get new pairs, and how often the list is made.
fn pairs_that_come_and_go(few: bool) -> [usize; 4] {
    let laws = Laws::from(rich_laws()[0].clone());
    let (mut grains, mut contacts, _) = cluster(1200, true, 11);
    if few {
        grains.velocity.iter_mut().enumerate().for_each(|(k, v)| *v *= if k % 500 == 7 { 1.0 } else { 0.01 });
    }
    let (faces, domain, mut scratch) = (faces(), domain(), Scratch::default());
    let mut near = Neighbours::default();
    let [mut entered, mut left, mut strays, mut lists] = [0; 4];
    for _ in 0..60 {
        let before: Vec<_> = contacts.pairs().collect();
        let rebuilt = near.refresh(&domain.cell, &grains.position, &grains.radius, 0.0);
        (strays, lists) = (strays + near.strays.len(), lists + usize::from(rebuilt));
        let around = Surroundings::new(&grains, &domain, &faces, &[], &laws);
        follow(&mut contacts, &around, &near, rebuilt, &mut scratch);
        let mut loads = Loads::default();
        loads.clear(grains.len());
        add(&mut loads, &mut contacts, &around, 1e-4, &mut scratch);
        let others = |i: u32| (i + 1..grains.len() as u32).chain((0..6).map(|face| FIRST_WALL + face));
        let pairs = (0..grains.len() as u32).flat_map(|i| others(i).map(move |j| [i, j]));
        let all: Vec<_> = pairs.filter(|&pair| around.near(pair).touch().overlap > 0.0).collect();
        assert!(contacts.pairs().eq(all.iter().copied()));
        for row in &contacts.rows {
            assert_eq!([row.shear.len(), row.more.len()], [row.pairs.len(); 2]);
        }
        entered += all.iter().filter(|pair| before.binary_search(pair).is_err()).count();
        left += before.iter().filter(|pair| all.binary_search(pair).is_err()).count();
        for k in 0..grains.len() {
            grains.position[k] += 1e-3 * grains.velocity[k];
        }
    }
    [entered, left, strays, lists]
}

#[test]
fn laws_survive_a_round_trip_through_toml() {
    for law in all_laws() {
        let text = toml_edit::ser::to_string(&law).unwrap();
        assert_eq!(toml_edit::de::from_str::<Law>(&text).unwrap(), law, "{text}");
    }
}

/// Two grains head on, integrated with small steps by the law alone: coefficient of restitution and duration.
fn collision(law: &Law, radius: [f64; 2], mass: f64, speed: f64, dt: f64) -> (f64, f64) {
    let (mut overlap, mut approach, mut time) = (0.0, speed, 0.0);
    loop {
        // Half a step of the velocity, so that position and velocity belong to the same time.
        let touch = Touch { velocity: -approach * DVec3::X, ..Touch::prospective(radius, overlap, mass) };
        let pressing = -law.load(&touch, &mut Memory::default(), dt).force.x;
        if time > 0.0 && pressing <= 0.0 {
            return (-approach / speed, time);
        }
        let middle = overlap + 0.5 * dt * approach;
        let rate = approach - 0.5 * dt * pressing / mass;
        let touch = Touch { velocity: -rate * DVec3::X, ..Touch::prospective(radius, middle, mass) };
        let pressing = -law.load(&touch, &mut Memory::default(), dt).force.x;
        overlap += dt * rate;
        approach -= dt * pressing / mass;
        time += dt;
    }
}

#[test]
fn grains_bounce_with_the_coefficient_asked_for() {
    for coefficient in [0.05, 0.3, 0.6, 0.9, 1.0] {
        for mut law in laws() {
            match &mut law {
                Law::Linear(law) => law.restitution = Some(coefficient.into()),
                Law::HertzMindlin(law) => law.restitution = Some(coefficient.into()),
            }
            for (mass, speed) in [(2.0, 0.1), (0.3, 1.0)] {
                let (measured, _) = collision(&law, [0.1, 0.2], mass, speed, 2e-6);
                assert!((measured - coefficient).abs() < 2e-3, "{law:?}: {measured}");
            }
        }
    }
}

#[test]
fn elastic_spheres_touch_for_the_time_of_hertz() {
    // Landau & Lifshitz, Theory of Elasticity, §9, problem 1; 2.87 to three digits.
    let law = HertzMindlin::new(5e6, 0.3, 0.0);
    let ([a, b], mass, speed): ([f64; 2], f64, f64) = ([0.1, 0.2], 0.7, 0.3);
    let (radius, modulus) = (a * b / (a + b), 5e6 / (2.0 * (1.0 - 0.09)));
    let expected = 2.868 * (mass * mass / (radius * modulus * modulus * speed)).powf(0.2);
    let (_, time) = collision(&Law::HertzMindlin(law), [a, b], mass, speed, 1e-6);
    assert!((time / expected - 1.0).abs() < 1e-3, "{time} {expected}");
}

#[test]
fn the_tangents_are_those_of_catalano() {
    // Equal spheres: C 2.10 and 2.11.
    let (young, nu, radius, overlap) = (7e6, 0.2, 0.05, 3e-4);
    let law = Law::HertzMindlin(HertzMindlin::new(young, nu, 30.0));
    let touch = Touch::prospective([radius; 2], overlap, 1.0);
    let stiffness = law.stiffness(&touch);
    let shear_modulus = young / (2.0 * (1.0 + nu));
    let pressing = -law.load(&touch, &mut Memory::default(), 0.0).force.x;
    let normal = shear_modulus * (2.0 * radius * overlap).sqrt() / (1.0 - nu);
    let shear = 2.0 * (3.0 * shear_modulus.powi(2) * (1.0 - nu) * radius * pressing).cbrt() / (2.0 - nu);
    assert!((stiffness.normal / normal - 1.0).abs() < 1e-12);
    assert!((stiffness.shear / shear - 1.0).abs() < 1e-12);
}

/// The force along a straight opening of a pair from `overlap` [m] until it no longer holds: gaps and tensions.
fn opening(law: &Law, overlap: f64, steps: usize, memory: &mut Memory) -> Vec<[f64; 2]> {
    let mut path = Vec::new();
    for k in 0.. {
        let touch = Touch::prospective([0.1, 0.1], overlap * (1.0 - k as f64 / steps as f64), 1.0);
        let force = law.load(&touch, memory, 0.0).force.x;
        if !law.holds(&touch, memory) {
            assert_eq!(force, 0.0);
            return path;
        }
        path.push([-touch.overlap, force]);
    }
    unreachable!()
}

#[test]
fn bonds_pull_up_to_their_strength_and_break_for_good() {
    let adhesion = Adhesion { tension: 3e4, cohesion: 2e4, renew: true };
    let law = Linear { adhesion: Some(adhesion), ..Linear::new(1e6, 0.5, 30.0) };
    let law = Law::Linear(law);
    let section = std::f64::consts::PI * 0.01;
    let mut memory = Memory::default();
    let path = opening(&law, 1e-3, 1000, &mut memory);
    let [gap, tension] = path[path.len() - 1];
    assert!((tension / (3e4 * section) - 1.0).abs() < 1e-3, "{tension}");
    assert!((gap / (tension / 1e5) - 1.0).abs() < 1e-9, "{gap}");
    assert_eq!(memory.more.bond, Bond::Broken);
    // Pressed again it is a contact like any other, and parts where the grains do.
    assert!(opening(&law, 1e-3, 1000, &mut memory).iter().all(|&[gap, force]| gap < 0.0 && force < 0.0));

    // Sheared under pressure it holds `F_n tan(phi) + cohesion`, afterwards `F_n tan(phi)`.
    let (mut memory, mut most) = (Memory::default(), 0.0_f64);
    let mut touch = Touch { friction: 0.4, velocity: DVec3::Y, ..Touch::prospective([0.1, 0.1], 1e-3, 1.0) };
    for _ in 0..20_000 {
        most = most.max(law.load(&touch, &mut memory, 1e-6).force.y);
    }
    assert!((most / (0.4 * 100.0 + 2e4 * section) - 1.0).abs() < 1e-3, "{most}");
    touch.velocity = DVec3::ZERO;
    assert!((law.load(&touch, &mut memory, 0.0).force.y / 40.0 - 1.0).abs() < 1e-12);

    // Grains that meet later are bonded only where the law renews.
    let adhesion = Some(Adhesion { renew: false, ..adhesion });
    let law = Law::Linear(Linear { adhesion, ..Linear::new(1e6, 0.5, 30.0) });
    assert!(opening(&law, 1e-3, 1000, &mut Memory::default()).iter().all(|&[gap, _]| gap < 0.0));
}

#[test]
fn bridges_form_on_touch_and_break_at_the_length_of_willett() {
    let bridge = Capillary { volume: 8e-9, surface_tension: 0.07, contact_angle: 30.0 };
    let law = Law::Linear(Linear { capillary: Some(bridge), ..Linear::new(1e6, 0.5, 30.0) });
    // Coming nearer there is no bridge.
    let mut memory = Memory::default();
    let touch = |overlap: f64| Touch::prospective([0.1, 0.1], overlap, 1.0);
    assert!(
        law.load(&touch(-1e-4), &mut memory, 0.0) == PairLoad::default()
            && !law.holds(&touch(-1e-4), &memory)
    );

    let path =
        opening(&law, 1e-9, 1, &mut Memory { more: More { bridge: true, ..More::default() }, ..memory });
    let most = std::f64::consts::TAU * 0.1 * 0.07 * 30.0_f64.to_radians().cos();
    assert!((path[0][1] / most - 1.0).abs() < 0.02 && path.len() > 1000);
    let [gap, _] = path[path.len() - 1];
    // V^(1/3) = 2 mm.
    let length = (1.0 + std::f64::consts::PI / 12.0) * (2e-3 + 4e-6 / 1.0);
    assert!((gap / length - 1.0).abs() < 1e-5, "{gap} {length}");
    // Half way the reduced gap is 1.25e-3 sqrt(0.1 / 8e-9).
    let [gap, force] = path[path.len() / 2];
    let x = gap * (0.1_f64 / 8e-9).sqrt();
    assert!((force * (1.0 + 1.05 * x + 2.5 * x * x) / most - 1.0).abs() < 1e-12);
    // The work of opening is the energy the bridge gives back.
    let work: f64 = path.windows(2).map(|w| 0.5 * (w[0][1] + w[1][1]) * (w[1][0] - w[0][0])).sum();
    let wet = Memory { more: More { bridge: true, ..More::default() }, ..Memory::default() };
    let energy = law.energy(&touch(0.0), &wet);
    assert!((work / -energy - 1.0).abs() < 1e-3, "{work} {energy}");
}

#[test]
fn moments_grow_and_give_way() {
    let law = Law::Linear(Linear { rolling: Some(ROLLING), ..Linear::new(1e6, 0.5, 30.0) });
    let spin = DVec3::new(0.7, 2.0, -1.0);
    let touch = Touch { spin, ..Touch::prospective([0.1, 0.1], 1e-3, 1.0) };
    let mut memory = Memory::default();
    // k_t r² = 0.5 1e5 0.01 = 500 N m/rad, F_n r = 100 N 0.1 m.
    let moment = law.load(&touch, &mut memory, 1e-4).moment;
    let expected = 500.0 * 1e-4 * DVec3::new(0.6 * 0.7, 0.8 * 2.0, -0.8);
    assert!((moment - expected).length() < 1e-12, "{moment}");
    for _ in 0..1000 {
        law.load(&touch, &mut memory, 1e-4);
    }
    let moment = law.load(&touch, &mut memory, 1e-4).moment;
    assert!(
        (moment.x - 0.2 * 10.0).abs() < 1e-12 && (moment.with_x(0.0).length() - 0.3 * 10.0).abs() < 1e-12
    );
    assert!((law.stiffness(&touch).roll / 400.0 - 1.0).abs() < 1e-12);
}
