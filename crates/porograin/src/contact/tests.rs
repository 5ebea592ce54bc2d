//! The battery every contact law has to pass.

use super::*;
use crate::boundary::{Domain, Face, Solid};
use crate::grains::{Grains, Loads};
use glam::{DMat3, DQuat};
use porograin_geometry::Neighbours;

/// One of each law, stiff enough in shear and with enough friction for every term to count.
fn laws() -> Vec<Law> {
    let choices = vec![Law::Linear(Linear { young: 1e6, stiffness_ratio: 0.6, friction: 35.0 })];
    for law in &choices {
        // A new law does not compile until it is listed here and above.
        match law {
            Law::Linear(_) => (),
        }
    }
    choices
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
    let mut contacts = Contacts { pairs: vec![pair], shear: vec![shear] };
    let (faces, domain) = (faces(), domain());
    let around = Surroundings::new(&grains, &domain, &faces, law.as_law().friction());
    let mut loads = Loads::default();
    loads.clear(grains.len());
    add(&mut loads, &mut contacts, law, &around, 1.0, &mut Scratch::default());
    let energy = law.as_law().energy(&around.touch(pair), contacts.shear[0]);
    (loads, energy)
}

#[test]
fn loads_are_minus_the_gradient_of_the_energy() {
    for law in laws() {
        for wall in [false, true] {
            let (grains, pair) = pair(wall);
            let (faces, domain) = (faces(), domain());
            let touch = Surroundings::new(&grains, &domain, &faces, 0.0).touch(pair);
            // A shear force well inside the friction cone.
            let pressing = law.as_law().load(&touch, &mut DVec3::ZERO.clone(), 0.0).length();
            let shear = 0.1 * pressing * touch.normal.any_orthonormal_vector();
            let none = vec![(DVec3::ZERO, DVec3::ZERO); grains.len()];
            let (loads, _) = moved(&law, wall, shear, &none);
            let h = 1e-7;
            for k in 0..grains.len() {
                for axis in 0..3 {
                    for spin in [false, true] {
                        let at = |s: f64| {
                            let mut change = none.clone();
                            let part = if spin { &mut change[k].1 } else { &mut change[k].0 };
                            part[axis] = s;
                            moved(&law, wall, shear, &change).1
                        };
                        let gradient = (at(h) - at(-h)) / (2.0 * h);
                        let (load, scale) = if spin {
                            (loads.torque[k][axis], 0.1 * pressing)
                        } else {
                            (loads.force[k][axis], pressing)
                        };
                        assert!(
                            (load + gradient).abs() < 1e-5 * scale,
                            "{load} {gradient} {k} {axis} {spin} {wall}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn turned_with_the_frame_the_load_turns_along() {
    let mut next = Numbers(3);
    for law in laws() {
        let law = law.as_law();
        for _ in 0..100 {
            let turn = DQuat::from_scaled_axis(3.0 * next.vector());
            let normal = next.vector().normalize();
            let touch = Touch {
                normal,
                overlap: 1e-3,
                radius: [0.1, 0.2],
                velocity: next.vector(),
                twist: 0.3,
                friction: 0.4,
            };
            let start = next.vector().cross(normal);
            let (mut here, mut there) = (start, turn * start);
            let load = law.load(&touch, &mut here, 1e-4);
            let turned = Touch { normal: turn * touch.normal, velocity: turn * touch.velocity, ..touch };
            let same = law.load(&turned, &mut there, 1e-4);
            assert!((turn * load - same).length() < 1e-12 * load.length());
            assert!((turn * here - there).length() < 1e-12 * here.length().max(1e-3));
        }
    }
}

#[test]
fn the_shear_force_stays_in_the_friction_cone_and_nothing_pulls() {
    let mut next = Numbers(4);
    for law in laws() {
        let (law, mut shear, mut slid) = (law.as_law(), DVec3::ZERO, 0);
        let mut touch = Touch::prospective([0.1, 0.15], 1e-3);
        touch.friction = 0.4;
        for _ in 0..1000 {
            touch.overlap = 1e-3 * next.next();
            touch.velocity = next.vector();
            shear = turn(shear, touch.normal, 0.0);
            let force = law.load(&touch, &mut shear, 1e-4);
            let pressing = -force.dot(touch.normal);
            assert!(pressing >= 0.0 && shear.length() <= 0.4 * pressing * (1.0 + 1e-12));
            assert!(shear.dot(touch.normal).abs() <= 1e-12 * pressing);
            slid += (shear.length() > 0.399 * pressing) as u32;
        }
        assert!((100..950).contains(&slid), "{slid}");
    }
}

/// Work put in less energy stored, along closed loops of the relative position, pressing and sliding.
#[test]
fn closed_loops_never_give_energy() {
    let mut next = Numbers(5);
    for law in laws() {
        let (law, mut rubbed) = (law.as_law(), 0);
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
                ..Touch::prospective([0.1, 0.1], 0.0)
            };
            let (mut shear, steps, mut lost) = (DVec3::ZERO, 4000, 0.0);
            let mut force = law.load(&touch_at(start, DVec3::ZERO), &mut shear, 0.0);
            let begin = law.energy(&touch_at(start, DVec3::ZERO), shear);
            let (mut work, mut size, mut worst) = (0.0, 0.0_f64, 0.0_f64);
            for k in 1..=steps {
                let (x0, x1) = (path((k - 1) as f64 / steps as f64), path(k as f64 / steps as f64));
                let touch = touch_at(start + x1, x1 - x0);
                shear = turn(shear, touch.normal, 0.0);
                let now = law.load(&touch, &mut shear, 1.0);
                // The force on the second is minus `now`; holding it takes `now`.
                work += 0.5 * (force + now).dot(x1 - x0);
                force = now;
                let balance = work - (law.energy(&touch, shear) - begin);
                worst = worst.min(balance - lost);
                lost = balance;
                size = size.max(work.abs());
            }
            // A loop that never slides gives back everything but the error of 4000 finite steps.
            assert!(lost > -1e-6 * size && worst > -1e-6 * size, "{lost} {worst} {size}");
            rubbed += (lost > 1e-3 * size) as u32;
        }
        assert!((10..30).contains(&rubbed), "{rubbed}");
    }
}

/// A loaded pair that turns as one rigid body keeps its shear force in the turning frame.
#[test]
fn the_memory_turns_with_a_rigidly_turning_pair() {
    let law = &laws()[0];
    let axis = DVec3::new(0.5, 0.7, -0.3);
    let error = |steps: usize| {
        let (mut grains, pair) = pair(false);
        let (faces, domain) = (faces(), domain());
        let centre = grains.position[0];
        let arm = grains.position[1] - centre;
        let start = 100.0 * arm.normalize().any_orthonormal_vector();
        let mut contacts = Contacts { pairs: vec![pair], shear: vec![start] };
        let mut loads = Loads::default();
        for k in 1..=steps {
            let at = |k: usize| centre + DQuat::from_scaled_axis(axis * k as f64 / steps as f64) * arm;
            grains.velocity[1] = (at(k) - at(k - 1)) * steps as f64;
            grains.position[1] = at(k);
            grains.spin = vec![axis; 2];
            loads.clear(2);
            let around = Surroundings::new(&grains, &domain, &faces, law.as_law().friction());
            add(&mut loads, &mut contacts, law, &around, 1.0 / steps as f64, &mut Scratch::default());
        }
        let expected = DQuat::from_scaled_axis(axis) * start;
        (contacts.shear[0] - expected).length() / start.length()
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
    let around = Surroundings::new(grains, &domain, &faces, law.as_law().friction());
    follow(contacts, &around, &near.pairs, true, &mut scratch);
    let mut loads = Loads::default();
    loads.clear(grains.len());
    add(&mut loads, contacts, law, &around, 1e-4, &mut scratch);
    loads
}

#[test]
fn forces_and_moments_balance() {
    for law in laws() {
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
    for law in laws() {
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

#[test]
fn pairs_enter_and_leave_in_order() {
    let law = &laws()[0];
    let (mut grains, mut contacts, _) = cluster(400, true, 11);
    let (faces, domain, mut scratch) = (faces(), domain(), Scratch::default());
    let mut near = Neighbours::default();
    let (mut entered, mut left) = (0, 0);
    for _ in 0..60 {
        let before = contacts.pairs.clone();
        let rebuilt = near.refresh(&domain.cell, &grains.position, &grains.radius, 0.0);
        let around = Surroundings::new(&grains, &domain, &faces, 30.0);
        follow(&mut contacts, &around, &near.pairs, rebuilt, &mut scratch);
        let mut loads = Loads::default();
        loads.clear(grains.len());
        add(&mut loads, &mut contacts, law, &around, 1e-4, &mut scratch);
        let all: Vec<_> =
            near.pairs.iter().copied().filter(|&pair| around.touch(pair).overlap > 0.0).collect();
        assert_eq!(contacts.pairs, all);
        assert_eq!(contacts.shear.len(), all.len());
        entered += all.iter().filter(|pair| !before.contains(pair)).count();
        left += before.iter().filter(|pair| !all.contains(pair)).count();
        for k in 0..grains.len() {
            grains.position[k] += 1e-3 * grains.velocity[k];
        }
    }
    assert!(entered > 50 && left > 50, "{entered} {left}");
}
