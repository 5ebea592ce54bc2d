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

/// Of a hundred grains that fly two knock into each other: the blow, spread over all, is not rest.
#[test]
fn a_blow_in_a_cloud_is_not_rest() {
    let mut position: Vec<DVec3> =
        (0..98).map(|k| DVec3::new(0.05 + 0.021 * f64::from(k), 1.0, 1.0)).collect();
    position.extend([DVec3::new(1.0, 0.5, 0.5), DVec3::new(1.019, 0.5, 0.5)]);
    let (mut state, mut model) = (state_of(2.2, position, 0.01), dry_model());
    model.gravity = DVec3::new(0.0, 0.0, -9.81);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    assert_eq!(state.contacts.len(), 1);
    // Two resultants of the contact force, and the weights of the others.
    let found = unbalanced(&state, &model, &work.loads);
    assert!(found > 2.0, "{found}");
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

#[test]
fn directions_and_profiles_of_a_pressed_cloud() {
    let (state, model, _) = pressed();
    let found = directions(&state, &model);
    let mean: f64 = found.contacts.iter().sum::<f64>() / CLASSES as f64;
    assert!((mean - 1.0).abs() < 1e-12 && found.contacts.iter().all(|c| (0.4..1.8).contains(c)), "{found:?}");
    // The densities weigh the mean forces back to 1.
    let normal: f64 = (0..CLASSES).map(|k| found.contacts[k] * found.normal[k]).sum::<f64>() / CLASSES as f64;
    assert!((normal - 1.0).abs() < 1e-12, "{normal}");
    assert!(found.tangential.iter().all(|&t| t < 10f64.to_radians().tan() * 2.5 && t > 0.0), "{found:?}");
    // Layers hold all of the solid, exactly.
    let profile = profile(&state);
    let solid = profile.solid.iter().sum::<f64>() / LAYERS as f64;
    assert!((solid + porosity(&state) - 1.0).abs() < 1e-12, "{solid}");
    assert!((0.4..0.8).contains(&profile.solid[5]) && profile.solid[0] < profile.solid[5], "{profile:?}");
}

/// A sphere across the middle of two layers, and what a column of touching ones does to `directions`.
#[test]
fn a_profile_by_hand() {
    let mut state = state_of(1.2, vec![DVec3::new(0.5, 0.5, 0.63)], 0.05);
    state.grains.velocity[0] = DVec3::X;
    let found = profile(&state);
    // The plane at 0.6 lies 0.03 below the centre: a cap of height 0.02, pi h² (3 r - h)/3.
    let cap = std::f64::consts::PI * 0.02 * 0.02 * (0.15 - 0.02) / 3.0;
    let layer = 0.1 * 1.2 * 1.2;
    assert!((found.solid[5] * layer - cap).abs() < 1e-15);
    assert!((found.solid[6] * layer - (crate::grains::sphere_volume(0.05) - cap)).abs() < 1e-15);
    assert_eq!(found.velocity[6], DVec3::X);
    assert_eq!(found.velocity[0], DVec3::ZERO);
}

/// An affine displacement is found around every grain that has a tetrahedron of grains; power cells hold all of the void.
#[test]
fn an_affine_displacement_has_its_gradient_at_every_grain() {
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(0.04));
    let grains = packing::cloud(&domain.cell, 300, 0.2, 3, 0.7, 2600.0).unwrap();
    let gradient = DMat3::from_cols_array(&[0.01, -0.02, 0.003, 0.004, 0.02, -0.01, 0.03, 0.0, -0.015]);
    let state = State { domain, grains, ..state_of(1.0, vec![], 0.1) };
    let from: Vec<DVec3> = places(&state).iter().map(|&x| x - gradient * x).collect();
    let found = local(&state, &displacement(&state, &from)).unwrap();
    let strained = found.gradient;
    let zero = strained.iter().filter(|&&g| g == DMat3::ZERO).count();
    assert!(zero < 15, "{zero} grains without a tetrahedron of grains");
    for g in strained.into_iter().filter(|&g| g != DMat3::ZERO) {
        assert!((g - gradient).to_cols_array().iter().all(|d| d.abs() < 1e-10), "{g}");
    }
    let volume = |k: usize| crate::grains::sphere_volume(state.grains.radius[k]) / (1.0 - found.porosity[k]);
    let sum: f64 = (0..300).map(volume).sum();
    assert!((sum / state.domain.cell.volume() - 1.0).abs() < 1e-10, "{sum}");
    // Triaxial: two thirds of axial less radial.
    let triaxial = DMat3::from_diagonal(DVec3::new(0.01, 0.01, -0.05));
    assert!((strain_deviator(triaxial) - 0.04).abs() < 1e-15);
}

/// In a sheared periodic cell every grain has the gradient of the cell, images and changed periods notwithstanding: `u = x - F⁻¹ x`.
#[test]
fn an_affine_motion_of_a_periodic_cell_has_its_gradient_at_every_grain() {
    let edges = DMat3::from_diagonal(DVec3::new(0.04, 0.05, 0.03));
    let cell = porograin_geometry::Cell::periodic(DVec3::splat(0.01), edges);
    let grains = packing::cloud(&cell, 200, 0.2, 3, 0.7, 2600.0).unwrap();
    let mut state = State { domain: Domain::of(cell), grains, ..state_of(1.0, vec![], 0.1) };
    // The stage begins with grains that have crossed the cell already.
    state.domain.crossed = (0..200).map(|k| [k % 3, 1, -(k % 2)]).collect();
    let from = places(&state);
    let (dt, mut deformed) = (1e-3, DMat3::IDENTITY);
    state.domain.rate = DMat3::from_cols_array(&[0.1, 0.0, 0.0, 0.0, -0.2, 0.3, 1.0, 0.0, 0.05]);
    for _ in 0..1500 {
        let rate = state.domain.rate;
        let stretch = DMat3::IDENTITY + dt * rate * (DMat3::IDENTITY - 0.5 * dt * rate).inverse();
        let origin = state.domain.cell.origin;
        state.grains.position.iter_mut().for_each(|x| *x = origin + stretch * (*x - origin));
        crate::cell::advance(&mut state.domain, &mut state.grains, dt);
        deformed = stretch * deformed;
    }
    let leaning = deformed * edges;
    assert!((leaning - state.domain.cell.edges).z_axis.length() > 0.02, "the periods have not been changed");
    let gradient = DMat3::IDENTITY - deformed.inverse();
    let found = local(&state, &displacement(&state, &from)).unwrap();
    for g in &found.gradient {
        assert!((*g - gradient).to_cols_array().iter().all(|d| d.abs() < 1e-8), "{g} {gradient}");
    }
    let volume = |k: usize| crate::grains::sphere_volume(state.grains.radius[k]) / (1.0 - found.porosity[k]);
    let sum: f64 = (0..200).map(volume).sum();
    assert!((sum / state.domain.cell.volume() - 1.0).abs() < 1e-10, "{sum}");
}

/// Regions that tile the box share its grains among them, images across periods included.
#[test]
fn porosities_of_regions_that_tile_the_box_add_up() {
    let [low, middle, high] = [0.0, 0.017, 0.04];
    for periodic in [[false; 3], [true, true, false], [true; 3]] {
        let cell = porograin_geometry::Cell {
            periodic,
            ..porograin_geometry::Cell::walled(DVec3::ZERO, DVec3::splat(high))
        };
        let grains = packing::cloud(&cell, 300, 0.2, 3, 0.7, 2600.0).unwrap();
        let state = State { domain: Domain::of(cell), grains, ..state_of(1.0, vec![], 0.1) };
        let mut solid = 0.0;
        for k in 0..8 {
            let part = |axis: usize| if k >> axis & 1 == 0 { [low, middle] } else { [middle, high] };
            let of = |end: usize| [0, 1, 2].map(|axis| part(axis)[end]);
            let region = Region::Box { lower: of(0), upper: of(1) };
            solid += (1.0 - region_porosity(&state, &region)) * region.volume();
        }
        assert!((solid / state.grains.volume() - 1.0).abs() < 1e-12, "{periodic:?} {solid}");
        // A bar cut in two, and a ball in the middle of it.
        let bar = |from: f64, to: f64| Region::Cylinder {
            point: [0.02, 0.02, from],
            axis: [0.0, 0.0, 1.0],
            radius: 0.012,
            length: to - from,
        };
        let solid = |region: Region| (1.0 - region_porosity(&state, &region)) * region.volume();
        let whole = solid(bar(low, high));
        assert!((solid(bar(low, middle)) + solid(bar(middle, high)) - whole).abs() < 1e-6 * whole);
        let ball = Region::Sphere { centre: [0.02; 3], radius: 0.012 };
        assert!(solid(ball) < solid(bar(0.008, 0.032)));
    }
}
