//! What faces impose on the water: pressures that vary from place to place, and flow.

use glam::DVec3;
use porograin::boundary::{Face, Signal, Water};
use porograin::contact::{Contacts, Law, Linear};
use porograin::permeability::fluxes;
use porograin::pores::mesh::{FREE, WallFace};
use porograin::pores::{Conductance, Pores, Stepping};
use porograin::{Domain, Flow, FluidModel, Grains, Loads, Model, State, TimeStep, Work, fluid, step};
use porograin_geometry::cell::NORMALS;

/// Loose grains at rest on a shaken lattice in a box of 5 x 4 x 6 cm, all walls fixed.
fn sample(faces: [Face; 6], step: Stepping) -> (State, Model) {
    let mut seed = 11u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let (mut x, mut radius) = (Vec::new(), Vec::new());
    for k in 0..120 {
        let place = DVec3::new((k % 5) as f64, (k / 5 % 4) as f64, (k / 20) as f64) + 0.5;
        x.push(0.01 * (place + 0.15 * DVec3::new(random(), random(), random())));
        radius.push(0.004 + 0.001 * random());
    }
    let state = State {
        time: 0.0,
        step: 0,
        dt: 0.0,
        domain: Domain::walled(DVec3::ZERO, DVec3::new(0.05, 0.04, 0.06)),
        grains: Grains::at_rest(x, radius, 2600.0),
        contacts: Contacts::default(),
        fluid: None,
    };
    let pores =
        Pores { step, residual: 1e-10, conductance: Conductance::hydraulic_radius(), ..Pores::default() };
    let model = Model {
        time_step: TimeStep::Automatic { safety: 0.8 },
        gravity: DVec3::ZERO,
        contact: Law::Linear(Linear::new(15e6, 0.5, 30.0)).into(),
        damping: 0.0,
        faces,
        walls: Vec::new(),
        cell: Default::default(),
        fluid: Some(FluidModel {
            viscosity: 1e-3,
            density: 1000.0,
            bulk_modulus: None,
            flow: Flow::Pores(pores),
        }),
        stage_start: 0.0,
    };
    (state, model)
}

fn formula(text: &str) -> Signal {
    Signal::Expression(text.parse().unwrap())
}

#[test]
fn what_comes_in_through_one_face_leaves_through_the_others() {
    let mut faces: [Face; 6] = Default::default();
    faces[0].water = Water::Inflow(formula("2e-3*(1 + z/0.06)*cos(t)"));
    faces[5].water = Water::Pressure(Signal::Constant(3.0));
    faces[3].water = Water::Inflow(Signal::Constant(-1e-3));
    let (mut state, model) = sample(faces, Stepping::Explicit);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let mesh = work.fluid.mesh().unwrap();
    let area = |face: u8| mesh.wall_faces.iter().filter(|s| s.face == face).map(|s| s.area).sum::<f64>();
    for (face, expected) in [(0, 0.04 * 0.06), (1, 0.04 * 0.06), (2, 0.05 * 0.06), (4, 0.05 * 0.04)] {
        assert!((area(face) / expected - 1.0).abs() < 1e-12, "face {face}: {}", area(face));
    }
    let out = -fluxes(mesh, &state.pores().unwrap().pressure)[5];
    // Pores along an edge whose pressure is held give away at once what they are given: it is no flux of a throat.
    let free = |s: &&WallFace| mesh.held[mesh.node[s.pore as usize] as usize] == FREE;
    // The mean of 1 + z/H over the face is 3/2, for pores sampled at their centres to a per cent or so.
    let given: f64 = (mesh.wall_faces.iter().filter(|s| s.face == 0))
        .map(|s| s.area * 2e-3 * (1.0 + mesh.centre[s.pore as usize].z / 0.06))
        .sum();
    assert!((given / (3e-3 * 0.04 * 0.06) - 1.0).abs() < 0.02, "{given}");
    let rate = |s: &WallFace| match s.face {
        0 => s.area * 2e-3 * (1.0 + mesh.centre[s.pore as usize].z / 0.06),
        3 => -1e-3 * s.area,
        _ => 0.0,
    };
    let expected: f64 = mesh.wall_faces.iter().filter(free).map(rate).sum();
    assert!((out / expected - 1.0).abs() < 1e-7, "{out} {expected}");
}

#[test]
fn no_inflow_is_a_sealed_face() {
    let water = |rule: Water| {
        let mut faces: [Face; 6] = Default::default();
        faces[4].water = rule;
        faces[5].water = Water::Pressure(formula("100*x/0.05"));
        let (mut state, model) = sample(faces, Stepping::Explicit);
        let mut work = Work::default();
        step(&mut state, &model, &mut work).unwrap();
        (state.pores().unwrap().pressure.clone(), state.domain.wall_force[4])
    };
    assert_eq!(water(Water::Sealed), water(Water::Inflow(Signal::Constant(0.0))));
}

#[test]
fn each_pore_of_a_face_has_its_own_pressure_and_the_forces_balance() {
    let text = "1000*cos(pi*x/0.05)*sin(t + 1) + 2e4*y - 1e6*z^2";
    let pressure = |x: DVec3| {
        1000.0 * (std::f64::consts::PI * x.x / 0.05).cos() * 1.0_f64.sin() + 2e4 * x.y - 1e6 * x.z * x.z
    };
    let mut faces: [Face; 6] = Default::default();
    for face in [1, 4, 5] {
        faces[face].water = Water::Pressure(formula(text));
    }
    let (mut state, model) = sample(faces, Stepping::Explicit);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    let mesh = work.fluid.mesh().unwrap().clone();
    let found = &state.pores().unwrap().pressure;
    let mut seen = 0;
    for (pore, vertices) in mesh.triangulation.pores.iter().enumerate() {
        let node = mesh.node[pore] as usize;
        if vertices.iter().any(|&v| matches!(porograin_geometry::triangulation::wall(v), Some(1 | 4 | 5))) {
            seen += 1;
            let expected = pressure(mesh.centre[pore]);
            assert!(
                (found[node] - expected).abs() < 1e-9 * 1000.0,
                "pore {pore}: {} {expected}",
                found[node]
            );
        }
    }
    assert!(seen > 100);
    // Grains and closed walls carry together what the water outside presses on the open faces.
    let mut loads = Loads::default();
    loads.clear(state.grains.len());
    fluid::add(&mut loads, &state, &mut work.fluid);
    let mut outside = DVec3::ZERO;
    let mut scale = 0.0;
    for side in mesh.wall_faces.iter().filter(|s| [1, 4, 5].contains(&s.face)) {
        let push = side.area * found[mesh.node[side.pore as usize] as usize];
        outside -= push * NORMALS[side.face as usize];
        scale += push.abs();
    }
    for face in [1, 4, 5] {
        assert_eq!(loads.wall[face], DVec3::ZERO);
    }
    let inside = loads.force.iter().sum::<DVec3>() + loads.wall.iter().sum::<DVec3>();
    assert!(
        (inside - outside).length() < 1e-12 * scale && outside.length() > 0.01 * scale,
        "{inside} {outside}"
    );
}

#[test]
fn a_formula_without_a_value_stops_the_run() {
    let mut faces: [Face; 6] = Default::default();
    faces[5].water = Water::Pressure(formula("1/t"));
    let (mut state, model) = sample(faces, Stepping::Explicit);
    let error = step(&mut state, &model, &mut Work::default()).unwrap_err();
    assert!(error.to_string().contains("has no value 0 s after the stage began"), "{error}");
}
