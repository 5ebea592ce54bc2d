//! Contacts that keep accounts lose no energy to the time integration, at the default step.

use glam::{DQuat, DVec3};
use porograin::contact::{Contacts, HertzMindlin, Law, Laws, Linear};
use porograin::{Domain, Face, Grains, Model, State, TimeStep, Work, measure, step};

fn laws() -> [Law; 2] {
    let hertz = HertzMindlin::new(1e7, 0.3, 30.0);
    [Law::Linear(Linear::new(1e6, 0.5, 30.0)), Law::HertzMindlin(hertz)]
}

fn model(law: Law, conserving: bool, safety: f64) -> Model {
    Model {
        time_step: TimeStep::Automatic { safety },
        gravity: DVec3::ZERO,
        contact: Laws { conserving, ..law.into() },
        damping: 0.0,
        faces: std::array::from_fn(|_| Face { friction: 30.0, ..Face::default() }),
        walls: Vec::new(),
        membrane: None,
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn state(grains: Grains) -> State {
    State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::splat(-2.0), DVec3::splat(2.0)),
        grains,
        contacts: Contacts::default(),
        fluid: None,
    }
}

/// Two unequal grains about to meet after this part of a step, `aside` from head on.
fn pair(phase: f64, speed: f64, aside: f64) -> State {
    let apart = (0.25_f64.powi(2) - aside * aside).sqrt() + speed * phase;
    let mut grains =
        Grains::at_rest(vec![DVec3::ZERO, DVec3::new(apart, aside, 0.0)], vec![0.1, 0.15], 1000.0);
    grains.velocity[0].x = speed;
    state(grains)
}

/// Steps until the pair has met and is free of each other.
fn collide(state: &mut State, model: &Model) {
    let mut work = Work::default();
    let mut met = false;
    while !met || !state.contacts.is_empty() {
        step(state, model, &mut work).unwrap();
        met |= !state.contacts.is_empty();
        assert!(state.step < 1000, "{:?}", state.contacts);
    }
}

/// Whatever the part of a step at which they meet: at the default step a collision without losses changes the kinetic energy by up
/// to a tenth, with accounts by less than a ten-millionth.
#[test]
fn a_head_on_collision_keeps_the_energy_at_the_default_step() {
    for law in laws() {
        let worst = |conserving: bool| {
            let model = model(law.clone(), conserving, 0.8);
            let errors = (0..200).map(|k| {
                let mut state = pair(2e-3 * f64::from(k) / 200.0, 0.2, 0.0);
                let [before, momentum] = [measure::kinetic_energy(&state.grains), 0.2 * state.grains.mass[0]];
                collide(&mut state, &model);
                let Grains { mass, velocity, .. } = &state.grains;
                assert!(
                    (mass[0] * velocity[0].x + mass[1] * velocity[1].x - momentum).abs() < 1e-14 * momentum
                );
                assert!(velocity[1].x > velocity[0].x);
                (measure::kinetic_energy(&state.grains) / before - 1.0).abs()
            });
            errors.fold(0.0, f64::max)
        };
        let [plain, kept] = [worst(false), worst(true)];
        assert!(plain > 5e-3 && kept < 1e-7, "{law:?}: {plain:e} {kept:e}");
    }
}

/// With finer steps the forces of the accounts vanish: grains go where they go without.
#[test]
fn the_motion_is_the_same_in_the_limit_of_small_steps() {
    for law in laws() {
        let apart = |safety: f64| {
            let [plain, kept] = [false, true].map(|conserving| {
                let mut state = pair(1e-3, 0.2, 0.1);
                collide(&mut state, &model(law.clone(), conserving, safety));
                state.grains
            });
            plain.velocity[1].distance(kept.velocity[1]) + 0.15 * plain.spin[1].distance(kept.spin[1])
        };
        let errors = [0.4, 0.1, 0.025].map(apart);
        assert!(errors[0] < 2e-2 && errors[1] < errors[0] / 4.0 && errors[2] < errors[1] / 4.0, "{errors:?}");
    }
}

#[test]
fn a_turned_pair_does_the_same() {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0);
    for law in laws() {
        let model = model(law, true, 0.8);
        let mut straight = pair(1e-3, 0.2, 0.1);
        let mut turned = straight.clone();
        turned.grains.position.iter_mut().chain(&mut turned.grains.velocity).for_each(|v| *v = turn * *v);
        collide(&mut straight, &model);
        collide(&mut turned, &model);
        assert_eq!(straight.step, turned.step);
        for (a, b) in straight.grains.velocity.iter().zip(&turned.grains.velocity) {
            assert!((turn * *a).distance(*b) < 1e-12, "{a} {b}");
        }
        for (a, b) in straight.grains.spin.iter().zip(&turned.grains.spin) {
            assert!((turn * *a).distance(*b) < 1e-11, "{a} {b}");
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_without_scratch() {
    let run = |threads: usize, drop_every: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let at = |k: usize| {
            let place = DVec3::new((k % 13) as f64, (k / 13 % 13) as f64, (k / 169) as f64);
            0.2 * place - DVec3::splat(1.2)
        };
        let mut grains =
            Grains::at_rest((0..13 * 13 * 8).map(at).collect(), vec![0.098; 13 * 13 * 8], 1000.0);
        grains
            .velocity
            .iter_mut()
            .zip(&grains.position)
            .for_each(|(v, x)| *v = -0.3 * *x + 0.1 * x.cross(DVec3::X));
        let (mut state, mut work, mut owing) = (state(grains), Work::default(), 0);
        let model = model(laws()[0].clone(), true, 0.8);
        pool.install(|| {
            for k in 1..=100 {
                step(&mut state, &model, &mut work).unwrap();
                if k % drop_every == 0 {
                    work = Work::default();
                }
                let accounts = state.contacts.iter().filter(|(_, memory)| memory.account.surplus != 0.0);
                owing = owing.max(accounts.count());
            }
        });
        (state, owing)
    };
    let (one, owing) = run(1, u64::MAX);
    assert!(owing > 500, "{owing}");
    assert!(run(3, u64::MAX).0 == one && run(1, 7).0 == one);
}

#[test]
fn contacts_that_are_there_already_begin_with_nothing() {
    for law in laws() {
        let mut state = pair(1e-3, 0.2, 0.1);
        let mut work = Work::default();
        while state.contacts.is_empty() {
            step(&mut state, &model(law.clone(), false, 0.1), &mut work).unwrap();
        }
        for _ in 0..5 {
            step(&mut state, &model(law.clone(), false, 0.1), &mut work).unwrap();
        }
        let now = |state: &State| state.contacts.iter().next().unwrap().1.account;
        step(&mut state, &model(law.clone(), true, 0.1), &mut work).unwrap();
        assert!(now(&state).surplus == 0.0 && now(&state).force == DVec3::ZERO, "{:?}", now(&state));
        step(&mut state, &model(law.clone(), true, 0.1), &mut work).unwrap();
        assert!(now(&state).surplus != 0.0);
    }
}
