use super::*;
use crate::boundary::Solid;
use crate::boundary::{Domain, Face, Signal};
use crate::contact::{Contacts, Law, Linear};
use crate::step::{Work, step};

const LAW: Linear = Linear::new(1e6, 0.5, 60.0);

fn model(safety: f64) -> Model {
    Model {
        time_step: TimeStep::Automatic { safety },
        gravity: DVec3::ZERO,
        contact: Law::Linear(LAW).into(),
        damping: 0.0,
        faces: std::array::from_fn(|_| Face { friction: 60.0, ..Face::default() }),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn state(position: Vec<DVec3>, radius: Vec<f64>, upper: DVec3) -> State {
    State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, upper),
        grains: Grains::at_rest(position, radius, 2000.0),
        contacts: Contacts::default(),
        fluid: None,
    }
}

/// A block of cubic lattice, squeezed and jittered, pressed by its walls; radii differ by `spread`.
fn block(spread: f64) -> State {
    let (mut position, mut radius) = (Vec::new(), Vec::new());
    for k in 0..216 {
        let place = DVec3::new((k % 6) as f64, (k / 6 % 6) as f64, (k / 36) as f64);
        let noise = (k as f64 * 2.3).sin();
        position.push(0.97 * (2.0 * place + 1.0) + 0.01 * noise);
        radius.push(1.0 + spread * (k as f64 * 7.7).sin() + 0.02);
    }
    state(position, radius, DVec3::splat(0.97 * 12.0))
}

/// Largest eigenvalue of `M⁻¹ K` by power iteration on the linearised contacts, walls fixed.
fn largest(state: &State, model: &Model) -> f64 {
    let (grains, law) = (&state.grains, &model.contact.all);
    let around = Surroundings::new(grains, &state.domain, &model.faces, &model.walls, &model.contact);
    let n = grains.len();
    let mut shape: Vec<(DVec3, DVec3)> = (0..n)
        .map(|k| {
            let a = DVec3::new((k as f64 * 1.1).sin(), (k as f64 * 2.7).cos(), (k as f64 * 3.1).sin());
            (a, DVec3::new(a.z, a.x, a.y) / grains.radius[k])
        })
        .collect();
    let mut value = 0.0;
    for _ in 0..2000 {
        let mut next = vec![(DVec3::ZERO, DVec3::ZERO); n];
        for pair in state.contacts.pairs() {
            let touch = around.touch(pair);
            let (k, n, levers) = (law.stiffness(&touch), touch.normal, touch.levers());
            let i = pair[0] as usize;
            let mut gap = -shape[i].0 - levers[0] * shape[i].1.cross(n);
            let second = wall(pair[1]).is_none().then_some(pair[1] as usize);
            if let Some(j) = second {
                gap += shape[j].0 - levers[1] * shape[j].1.cross(n);
            }
            let force = k.normal * gap.dot(n) * n + k.shear * (gap - gap.dot(n) * n);
            next[i].0 -= force / grains.mass[i];
            next[i].1 -= levers[0] * n.cross(force) / grains.inertia(i);
            if let Some(j) = second {
                next[j].0 += force / grains.mass[j];
                next[j].1 -= levers[1] * n.cross(force) / grains.inertia(j);
            }
        }
        let size = |s: &[(DVec3, DVec3)]| -> f64 {
            (0..n)
                .map(|k| {
                    grains.mass[k] * s[k].0.length_squared() + grains.inertia(k) * s[k].1.length_squared()
                })
                .sum()
        };
        value = size(&next).sqrt();
        shape = next.into_iter().map(|(a, b)| (a / value, b / value)).collect();
    }
    value
}

#[test]
fn the_bound_holds_and_is_sharp() {
    for (spread, sharp) in [(0.0, 1.12), (0.05, 1.3)] {
        let (mut state, model) = (block(spread), model(1e-6));
        step(&mut state, &model, &mut Work::default()).unwrap();
        assert!(state.contacts.len() > 600);
        let exact = 2.0 / largest(&state, &model).sqrt();
        let bound = limit(&state, &model).seconds;
        assert!(bound <= exact && exact < sharp * bound, "{bound} {exact} {}", exact / bound);
    }
}

/// The frequency that the bound is compared with is the one at which leapfrog breaks down.
#[test]
fn just_below_the_limit_is_stable_and_just_above_is_not() {
    let growth = |safety: f64| {
        // Six walls squeeze one grain: it swings about the middle.
        let mut state = state(vec![DVec3::splat(0.95)], vec![1.0], DVec3::splat(1.9));
        let mut model = model(1e-6);
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        model.time_step = TimeStep::Fixed(safety * 2.0 / largest(&state, &model).sqrt());
        state.grains.spin[0] = DVec3::new(0.0, 0.0, 1e-3);
        let mut most = 0.0_f64;
        for _ in 0..400 {
            if step(&mut state, &model, &mut work).is_err() {
                return f64::INFINITY;
            }
            most = most.max(state.grains.spin[0].length());
        }
        most
    };
    assert!(growth(0.98) < 1e-2, "{}", growth(0.98));
    assert!(growth(1.05) > 1.0, "{}", growth(1.05));
}

/// Dampers shorten the step: the limit of the springs alone is too long for a strongly damped grain between six walls.
#[test]
fn dampers_shorten_the_stable_step() {
    let mut state = state(vec![DVec3::splat(0.95)], vec![1.0], DVec3::splat(1.9));
    let mut model = model(0.5);
    step(&mut state, &model, &mut Work::default()).unwrap();
    let springs = limit(&state, &model).seconds;
    model.contact = Law::Linear(Linear { restitution: Some(0.1.into()), ..LAW }).into();
    let damped = limit(&state, &model).seconds;
    let swing = |dt: f64| {
        let (mut state, mut model) = (state.clone(), model.clone());
        model.time_step = TimeStep::Fixed(dt);
        state.grains.velocity[0] = DVec3::new(1e-3, 0.0, 0.0);
        let mut work = Work::default();
        for _ in 0..300 {
            if step(&mut state, &model, &mut work).is_err() {
                return f64::INFINITY;
            }
        }
        state.grains.velocity[0].length()
    };
    assert!(swing(damped) < 1e-3, "{}", swing(damped));
    assert!(swing(springs) > 1e-2, "{} {damped} {springs}", swing(springs));
}

#[test]
fn grains_in_flight_and_light_pistons_set_the_limit() {
    let mut model = model(0.5);
    let mut flying = state(vec![DVec3::splat(2.0), DVec3::splat(7.0)], vec![1.0, 0.5], DVec3::splat(10.0));
    flying.grains.id = vec![40, 41];
    let alone = limit(&flying, &model);
    assert_eq!(alone.cause, Cause::Flight(41));
    assert!(alone.seconds.is_finite());

    let mut pressed = block(0.0);
    model.faces[5].solid = Solid::Servo { stress: Signal::Constant(0.0), mass: Some(1.0), speed: None };
    step(&mut pressed, &model, &mut Work::default()).unwrap();
    assert_eq!(limit(&pressed, &model).cause, Cause::Piston(5));
}

#[test]
fn eigenvalue_of_known_matrices() {
    assert!((largest_eigenvalue([1.0, 5.0, 3.0, 0.0, 0.0, 0.0]) - 5.0).abs() < 1e-14);
    assert!((largest_eigenvalue([2.0, 2.0, 2.0, 0.0, 0.0, 0.0]) - 2.0).abs() < 1e-14);
    // 1 + n n with |n|² = 14: eigenvalues 1, 1, 15.
    assert!((largest_eigenvalue([2.0, 5.0, 10.0, 6.0, 3.0, 2.0]) - 15.0).abs() < 1e-12);
}

/// A cubic lattice that is squeezed as one: the held cell is an oscillator of its own.
#[test]
fn a_light_cell_limits_the_step() {
    let (n, d) = (4, 0.99);
    let place = |k: usize| DVec3::new((k % n) as f64, (k / n % n) as f64, (k / n / n) as f64);
    let position: Vec<DVec3> = (0..n * n * n).map(|k| d * (place(k) + 0.5)).collect();
    let mut state = state(position, vec![0.5; n * n * n], DVec3::ONE);
    state.domain =
        Domain::of(porograin_geometry::Cell::periodic(DVec3::ZERO, glam::DMat3::IDENTITY * (n as f64 * d)));
    let touch = Touch::prospective([0.5, 0.5], 1.0 - d, 1.0);
    let stiffness = Law::Linear(LAW).stiffness(&touch).normal;
    let stress = stiffness * (1.0 - d) / (d * d);
    let held = |mass: Option<f64>| {
        let mut model = model(1.0);
        model.cell.stress.zz = Some(Signal::Constant(0.9 * stress));
        (model.cell.mass, model.cell.rate) = (mass, Some(1e6));
        model
    };
    step(&mut state, &held(None), &mut Work::default()).unwrap();
    state.dt = 0.0;
    let heavy = limit(&state, &held(None));
    let light = held(Some(1e-4 * state.grains.mass[0]));
    let found = limit(&state, &light);
    assert!(heavy.cause != Cause::Cell && found.cause == Cause::Cell, "{heavy:?} {found:?}");
    // Every contact along z, as long as d, is a spring of the cell.
    let spring = (n * n * n) as f64 * stiffness * d * d;
    let omega = (spring / (1e-4 * state.grains.mass[0])).sqrt() / (n as f64 * d);
    assert!((0.98..=1.0).contains(&(0.5 * omega * found.seconds)), "{}", 0.5 * omega * found.seconds);
    // It swings about its rest below the limit, and ever wider above.
    let reached = |dt: f64| {
        let (mut state, mut work) = (state.clone(), Work::default());
        let model = Model { time_step: TimeStep::Fixed(dt), ..light.clone() };
        let mut widest = 0.0f64;
        for _ in 0..200 {
            if step(&mut state, &model, &mut work).is_err() {
                return f64::INFINITY;
            }
            widest = widest.max(state.domain.strain.z_axis.z.abs());
        }
        widest
    };
    let below = reached(0.95 * found.seconds);
    assert!(below < 0.05, "{below}");
    let above = reached(1.1 * found.seconds);
    assert!(above > 0.5, "{above}");
}
