//! The membrane: a closed surface whose forces balance, are the gradient of its volume, and give the sample its stress.

use glam::{DMat3, DVec3};
use porograin::contact::{Contacts, Law, Linear};
use porograin::membrane::{self, Membrane};
use porograin::{Domain, Face, Grains, Loads, Model, Signal, State, TimeStep, Work, measure, packing, step};

const STRESS: f64 = 200.0;

fn model() -> Model {
    Model {
        time_step: TimeStep::Automatic { safety: 0.5 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(1e6, 0.5, 30.0)).into(),
        damping: 0.3,
        faces: std::array::from_fn(|_| Face::default()),
        walls: Vec::new(),
        membrane: Some(Membrane { stress: Signal::Constant(STRESS), probe: None, renew: 200 }),
        cell: Default::default(),
        fluid: None,
        stage_start: 0.0,
    }
}

fn state(grains: Grains) -> State {
    let domain = Domain::walled(DVec3::ZERO, DVec3::ONE);
    State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None }
}

/// A round lump of a random cloud, amid a larger box.
fn lump() -> Grains {
    let cell = Domain::walled(DVec3::splat(0.2), DVec3::splat(0.8)).cell;
    let cloud = packing::cloud(&cell, 300, 0.3, 3, 0.62, 1000.0).unwrap();
    let keep = |k: &usize| cloud.position[*k].distance(DVec3::splat(0.5)) < 0.27;
    let kept: Vec<usize> = (0..cloud.len()).filter(keep).collect();
    let (position, radius) = kept.iter().map(|&k| (cloud.position[k], cloud.radius[k])).unzip();
    Grains::at_rest(position, radius, 1000.0)
}

fn forces(state: &mut State, model: &Model) -> Loads {
    let mut loads = Loads::default();
    loads.clear(state.grains.len());
    membrane::add(&mut loads, state, model).unwrap();
    loads
}

#[test]
fn forces_and_moments_vanish_and_are_the_gradient_of_the_volume() {
    let (mut now, model) = (state(lump()), model());
    let loads = forces(&mut now, &model);
    let outer = loads.force.iter().filter(|f| f.length() > 0.0).count();
    assert!(outer > 60 && outer < now.grains.len(), "{outer} of {}", now.grains.len());
    let each: f64 = loads.force.iter().map(|f| f.length()).sum();
    let total: DVec3 = loads.force.iter().sum();
    let moment: DVec3 = now.grains.position.iter().zip(&loads.force).map(|(x, f)| x.cross(*f)).sum();
    assert!(total.length() < 1e-13 * each && moment.length() < 1e-13 * each, "{total} {moment}");
    for k in (0..now.grains.len()).step_by(7) {
        for axis in 0..3 {
            let mut volume = |shift: f64| {
                now.grains.position[k][axis] += shift;
                let [_, volume] = now.domain.skin.area_and_volume(&now.grains);
                now.grains.position[k][axis] -= shift;
                volume
            };
            let gradient = (volume(1e-4) - volume(-1e-4)) / 2e-4;
            assert!((loads.force[k][axis] + STRESS * gradient).abs() < 1e-9 * STRESS, "grain {k}");
        }
    }
}

/// Around a cubic lattice the membrane is a cube, and not one triangle of it is inside.
#[test]
fn the_membrane_of_a_cubic_lattice_is_a_cube() {
    let mut position = Vec::new();
    for k in 0..125 {
        position
            .push(DVec3::splat(0.3) + 0.1 * DVec3::new((k % 5) as f64, (k / 5 % 5) as f64, (k / 25) as f64));
    }
    let (mut now, model) = (state(Grains::at_rest(position, vec![0.05; 125], 1000.0)), model());
    let loads = forces(&mut now, &model);
    let [area, volume] = now.domain.skin.area_and_volume(&now.grains);
    assert!((area - 6.0 * 0.16).abs() < 1e-12 && (volume - 0.064).abs() < 1e-12, "{area} {volume}");
    // A side carries the stress over its area.
    let side = |k: &usize| now.grains.position[*k].x > 0.69;
    let force: f64 = (0..125).filter(side).map(|k| loads.force[k].x).sum();
    assert!((force + STRESS * 0.16).abs() < 1e-10, "{force}");
}

/// At rest the contacts of the sample carry the stress of the membrane: the virial of all forces vanishes, so `sum F (x) branch` is the
/// stress times the volume inside.
#[test]
fn a_sample_at_rest_has_the_stress_of_its_membrane() {
    let (mut now, model) = (state(lump()), model());
    let mut work = Work::default();
    let mut twin = None;
    for k in 0..20_000 {
        if k == 1000 {
            twin = Some(now.clone());
        }
        step(&mut now, &model, &mut work).unwrap();
        if let Some(twin) = &mut twin
            && k < 1500
        {
            step(twin, &model, &mut Work::default()).unwrap();
            assert!(k % 100 > 0 || *twin == now, "the scratch counts");
        }
        if k % 500 == 0 && k > 0 && measure::unbalanced(&now, &model, &work.loads) < 2e-4 {
            break;
        }
    }
    assert!(twin.is_some() && now.step > 1500, "{}", now.step);
    let inside = measure::contact_stress(&now, &model);
    let off = inside - DMat3::from_diagonal(DVec3::splat(STRESS));
    let worst = off.to_cols_array().iter().fold(0.0, |a: f64, x| a.max(x.abs()));
    assert!(worst < 0.01 * STRESS, "{inside}");
    assert!(measure::coordination(&now) > 3.0);
}
