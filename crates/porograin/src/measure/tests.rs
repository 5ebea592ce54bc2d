use super::*;
use crate::bench::dry_model;
use crate::boundary::{Domain, Signal, Solid};
use crate::contact::Contacts;
use crate::packing;
use crate::step::{Work, step};
use glam::DMat3;

fn state_of(size: f64, position: Vec<DVec3>, radius: f64) -> State {
    let radii = vec![radius; position.len()];
    State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, DVec3::splat(size)),
        grains: crate::grains::Grains::at_rest(position, radii, 2600.0),
        contacts: Contacts::default(),
        fluid: None,
    }
}

/// A cloud pressed from all three sides, a little differently, until it rests.
fn pressed() -> (State, Model, Work) {
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(0.04));
    let grains = packing::cloud(&domain.cell, 300, 0.2, 3, 0.7, 2600.0).unwrap();
    let mut model = dry_model();
    let crate::contact::Law::Linear(linear) = &mut model.contact.all else { unreachable!() };
    linear.friction = 10.0;
    for face in [1, 3, 5] {
        let stress = Signal::Constant(4.5e3 + 500.0 * face as f64);
        model.faces[face].solid = Solid::Servo { stress, mass: None, speed: None };
    }
    let contacts = Contacts::default();
    let mut state = State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts, fluid: None };
    let mut work = Work::default();
    while state.step < 1000 || unbalanced(&state, &model, &work.loads) > 1e-5 {
        step(&mut state, &model, &mut work).unwrap();
        assert!(state.step < 30_000);
    }
    (state, model, work)
}

#[test]
fn at_rest_contacts_walls_and_grains_tell_one_stress() {
    let (state, model, work) = pressed();
    let (contacts, walls) = (contact_stress(&state, &model), wall_stress(&state.domain));
    for axis in 0..3 {
        let expected = 4.5e3 + 500.0 * (2 * axis + 1) as f64;
        assert!((walls[2 * axis + 1] / expected - 1.0).abs() < 1e-3, "{walls:?}");
        assert!((walls[2 * axis] / expected - 1.0).abs() < 1e-3, "{walls:?}");
        assert!((contacts.col(axis)[axis] / expected - 1.0).abs() < 1e-3, "{contacts}");
    }
    // The grains' own stresses, each over its volume, add up to the sample's.
    let grains = grain_stress(&state, &model);
    let sum: DMat3 =
        (0..grains.len()).map(|k| grains[k] * crate::grains::sphere_volume(state.grains.radius[k])).sum();
    let difference = sum * state.domain.cell.volume().recip() - contacts;
    assert!(difference.to_cols_array().iter().all(|d| d.abs() < 1e-9 * 5e3));
    let (porosity, coordination) = (porosity(&state), coordination(&state));
    assert!(
        (0.36..0.48).contains(&porosity) && (3.5..6.0).contains(&coordination),
        "{porosity} {coordination}"
    );
    assert!((1..60).contains(&rattlers(&state)), "{}", rattlers(&state));
    // One step moves the grains by nothing that shows, so the resultants of the contacts are those of the loads.
    let mut resultant = vec![DVec3::ZERO; state.grains.len()];
    for ([i, j], _, force) in contact_forces(&state, &model) {
        resultant[i as usize] += force;
        if (j as usize) < resultant.len() {
            resultant[j as usize] -= force;
        }
    }
    let typical = contact_forces(&state, &model).map(|c| c.2.length()).fold(0.0, f64::max);
    for k in 0..resultant.len() {
        assert!((resultant[k] - work.loads.force[k]).length() < 1e-3 * typical);
    }
}

/// A column of three grains pressed by 3 % of a diameter between bottom and top: all figures by hand.
#[test]
fn a_column_by_hand() {
    let (size, radius) = (0.2, 0.1 / 3.0 * 1.03);
    let centres = (0..3).map(|k| DVec3::new(0.1, 0.1, 0.2 / 3.0 * (k as f64 + 0.5))).collect();
    let mut state = state_of(size, centres, radius);
    let mut model = dry_model();
    model.damping = 0.0;
    model.time_step = crate::model::TimeStep::Fixed(1e-30);
    step(&mut state, &model, &mut Work::default()).unwrap();
    let (k, at_wall, between) = (15e6 * radius, radius - 0.1 / 3.0, 2.0 * radius - 0.2 / 3.0);
    let stress = contact_stress(&state, &model).z_axis.z;
    let levers = 2.0 * (radius - 0.5 * at_wall) * k * at_wall + 2.0 * (2.0 / 30.0) * k * between;
    assert!((stress * 0.008 / levers - 1.0).abs() < 1e-12);
    assert!((wall_stress(&state.domain)[4] * 0.04 / (k * at_wall) - 1.0).abs() < 1e-12);
    let energy = k * at_wall * at_wall + k * between * between;
    assert!((elastic_energy(&state, &model) / energy - 1.0).abs() < 1e-12);
    assert_eq!(coordination(&state), 2.0);
    assert_eq!(fabric(&state, &model), DMat3::from_diagonal(DVec3::Z));
    assert_eq!(rattlers(&state), 3);
    state.grains.velocity[0] = DVec3::X;
    state.grains.spin[1] = DVec3::Y;
    let kinetic = 0.5 * state.grains.mass[0] + 0.2 * state.grains.mass[1] * radius * radius;
    assert!((kinetic_energy(&state.grains) / kinetic - 1.0).abs() < 1e-12);
    let mut lower = state.domain.clone();
    lower.cell.edges.z_axis.z -= 0.01;
    lower.wall_force[5].z += 40.0;
    assert!((settlement(&state.domain, &lower, 5) - 0.01).abs() < 1e-15);
    assert!((oedometric_modulus(&state.domain, &lower, 5) / (40.0 / 0.04 / 0.05) - 1.0).abs() < 1e-9);
}

#[test]
fn invariants_and_compression_by_hand() {
    // Triaxial compression turned out of its axes and with an antisymmetric part that must not count.
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
    let [mean, deviator] =
        invariants(turn * DMat3::from_diagonal(DVec3::new(50e3, 50e3, 140e3)) * turn.transpose());
    assert!((mean - 80e3).abs() < 1e-6 && (deviator - 90e3).abs() < 1e-6, "{mean} {deviator}");
    let twisted = DMat3::from_cols(DVec3::new(0.0, 3.0, 0.0), DVec3::new(-3.0, 0.0, 0.0), DVec3::ZERO);
    assert_eq!(invariants(twisted), [0.0, 0.0]);
    let before = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 4.0));
    let now = DMat3::from_diagonal(DVec3::new(1.1, 2.0, 3.0));
    let found = compression(before, now);
    let expected = [-0.1, 0.0, 0.25, 1.0 - 1.1 * 0.75];
    assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-12), "{found:?}");
}

/// Four grains whose masses go as 1, 1, 2 and 4: diameters at the middle of each share, and straight lines.
#[test]
fn diameters_by_passing_mass() {
    let mut grains = state_of(1.0, vec![DVec3::splat(0.5); 4], 0.1).grains;
    grains.radius = vec![0.2, 0.05, 0.05, 0.1];
    grains.mass = vec![4.0, 1.0, 1.0, 2.0];
    for (part, expected) in
        [(0.01, 0.1), (0.1875, 0.1), (0.375, 0.2), (0.75, 0.4), (0.5625, 0.3), (0.99, 0.4)]
    {
        assert!((diameter(&grains, part) - expected).abs() < 1e-12, "{part} {}", diameter(&grains, part));
    }
}
