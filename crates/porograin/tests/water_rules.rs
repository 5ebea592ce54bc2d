//! What faces impose on the water: pressures that vary from place to place, and flow.

use glam::DVec3;
use porograin::boundary::{Face, Signal, Water};
use porograin::contact::{Contacts, Law, Linear};
use porograin::permeability::fluxes;
use porograin::pores::mesh::{BLOCKED, FREE, WallFace};
use porograin::pores::{Block, Conductance, Point, PointWater, Pores, Stepping};
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
        membrane: None,
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

/// The box shrinks by a moving wall while water comes in along edges: what leaves through the faces is what came in and what
/// the void has lost, to round-off.
#[test]
fn what_leaves_through_the_faces_is_what_comes_in_and_what_the_void_loses() {
    for (stepping, bulk_modulus) in
        [(Stepping::Explicit, None), (Stepping::Implicit, None), (Stepping::Implicit, Some(1e5))]
    {
        let mut faces: [Face; 6] = Default::default();
        // Along its edge with the top it gives to pores that the top holds.
        faces[0].water = Water::Inflow(Signal::Constant(2e-3));
        faces[5].water = Water::Pressure(Signal::Constant(3.0));
        faces[3].water = Water::Pressure(Signal::Constant(0.0));
        faces[4].solid = porograin::Solid::Moving { velocity: [0.0, 0.0, 1e-3].map(Signal::Constant) };
        let (mut state, mut model) = sample(faces, stepping);
        if let Some(FluidModel { bulk_modulus: modulus, flow: Flow::Pores(pores), .. }) = &mut model.fluid {
            *modulus = bulk_modulus;
            pores.implicit_residual = 1e-11;
            pores
                .point
                .push(Point { at: [0.025, 0.02, 0.03], water: PointWater::Source(formula("1e-6*(1 + x)")) });
        }
        let mut work = Work::default();
        for _ in 0..3 {
            step(&mut state, &model, &mut work).unwrap();
        }
        // An explicit step answers the motion of the step before: a wall at constant velocity does the same in both.
        let before = state.pores().unwrap().store.as_ref().map(|store| store.surplus.iter().sum::<f64>());
        step(&mut state, &model, &mut work).unwrap();
        let after = state.pores().unwrap().store.as_ref().map(|store| store.surplus.iter().sum::<f64>());
        let stored = before.zip(after).map_or(0.0, |(a, b)| (b - a) / state.dt);
        let given =
            2e-3 * 0.04 * (state.domain.cell.upper().z - state.domain.cell.origin.z + 1e-3 * state.dt);
        let source = 1e-6 * (1.0 + 0.025);
        let lost = 1e-3 * 0.05 * 0.04;
        let out = work.fluid.outflow(&state).unwrap();
        let expected = source + lost - stored;
        // The face with the inflow lets that out, negatively; its area is that of the mesh.
        assert!((out[0] / -given - 1.0).abs() < 1e-4, "{} {given}", out[0]);
        assert_eq!((out[1], out[2], out[4]), (0.0, 0.0, 0.0));
        let sum: f64 = out.iter().sum();
        assert!((sum / expected - 1.0).abs() < 1e-7, "{stepping:?} {bulk_modulus:?}: {sum} {expected}");
    }
}

fn with_places(points: Vec<Point>, blocked: Vec<Block>, faces: [Face; 6]) -> (State, Work) {
    let (mut state, mut model) = sample(faces, Stepping::Explicit);
    if let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &mut model.fluid {
        (pores.point, pores.blocked) = (points, blocked);
    }
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    (state, work)
}

#[test]
fn points_hold_pressures_and_give_water() {
    let point = |at, water| Point { at, water };
    let (low, high) = ([0.012, 0.01, 0.01], [0.04, 0.03, 0.05]);
    // Two points at given pressures in a sealed box: what flows between them ...
    let held = vec![
        point(low, PointWater::Pressure(Signal::Constant(5.0))),
        point(high, PointWater::Pressure(Signal::Constant(-1.0))),
    ];
    let (state, work) = with_places(held, Vec::new(), Default::default());
    let (mesh, pressure) = (work.fluid.mesh().unwrap(), state.pores().unwrap().pressure.clone());
    assert_eq!([0, 1].map(|k| pressure[mesh.points[k] as usize]), [5.0, -1.0]);
    let out = porograin::permeability::outflow(mesh, &pressure);
    let [from, to] = [0, 1].map(|k| out[mesh.points[k] as usize]);
    assert!(from > 0.0 && (from + to).abs() < 1e-8 * from, "{from} {to}");
    // ... given as a source at one, makes the same difference of pressure.
    let given = vec![
        point(low, PointWater::Source(Signal::Constant(from))),
        point(high, PointWater::Pressure(Signal::Constant(-1.0))),
    ];
    let (state, work) = with_places(given, Vec::new(), Default::default());
    let found = state.pores().unwrap().pressure[work.fluid.mesh().unwrap().points[0] as usize];
    assert!((found - 5.0).abs() < 1e-6, "{found}");
}

#[test]
fn blocked_regions_let_no_water_through() {
    let mut faces: [Face; 6] = Default::default();
    for (face, pressure) in [(4, 2.0), (5, 0.0)] {
        faces[face].water = Water::Pressure(Signal::Constant(pressure));
    }
    let flow = |blocked: Vec<Block>| {
        let (state, work) = with_places(Vec::new(), blocked, faces.clone());
        let mesh = work.fluid.mesh().unwrap().clone();
        let (pressure, out) = (state.pores().unwrap().pressure.clone(), work.fluid.outflow(&state).unwrap());
        (out[4] + out[5], out[5], mesh, pressure)
    };
    let (_, free, ..) = flow(Vec::new());
    // Half of the section.
    let (left_over, half, mesh, _) = flow(vec![Block { from: [0.0, 0.0, 0.02], to: [0.025, 0.04, 0.03] }]);
    assert!(left_over.abs() < 1e-8 * free, "{left_over}");
    assert!(half > 0.2 * free && half < 0.9 * free, "{half} {free}");
    assert!(mesh.census.blocked > 20, "{}", mesh.census.blocked);
    // All of it: still water at the pressure of its face on either side.
    let (_, none, mesh, pressure) = flow(vec![Block { from: [0.0, 0.0, 0.016], to: [0.05, 0.04, 0.034] }]);
    assert!(none.abs() < 1e-9 * free, "{none}");
    for (node, p) in pressure.iter().enumerate().filter(|(node, _)| mesh.held[*node] == FREE) {
        assert!(p.abs() < 1e-9 || (p - 2.0).abs() < 1e-9, "node {node}: {p}");
    }
    // A cavity cut off inside a block is named.
    let shell = |from, to| Block { from, to };
    let walls = vec![
        shell([0.0, 0.0, 0.0], [0.05, 0.04, 0.02]),
        shell([0.0, 0.0, 0.04], [0.05, 0.04, 0.055]),
        shell([0.0, 0.0, 0.02], [0.015, 0.04, 0.04]),
        shell([0.035, 0.0, 0.02], [0.05, 0.04, 0.04]),
    ];
    let (mut state, mut model) = sample(faces.clone(), Stepping::Explicit);
    if let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &mut model.fluid {
        pores.blocked = walls;
    }
    let error = step(&mut state, &model, &mut Work::default()).unwrap_err().to_string();
    assert!(error.contains("are cut off from every place with an imposed pressure, in one place"), "{error}");
}

/// Pores inside a knot of overlapping grains are no use to the water: all such knots are told, the grains by their ids.
#[test]
fn all_sets_of_pores_that_are_cut_off_are_told_by_their_grains() {
    // Four large grains around each of two places touch so closely that no throat between them is open.
    let knot = |middle: DVec3| {
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
        corners.map(|c| middle + 0.004 * DVec3::from_array(c))
    };
    let knots = [knot(DVec3::new(0.012, 0.02, 0.015)), knot(DVec3::new(0.036, 0.02, 0.045))];
    let sealed = |top: Water| {
        let mut faces: [Face; 6] = Default::default();
        faces[5].water = top;
        let (mut state, model) = sample(faces, Stepping::Explicit);
        let x: Vec<DVec3> = knots.iter().flatten().copied().collect();
        // The triangle of three has the circumradius 6.53 mm: just closed.
        state.grains = Grains::at_rest(x, vec![0.0066; 8], 2600.0);
        step(&mut state, &model, &mut Work::default()).unwrap_err().to_string()
    };
    let said = sealed(Water::Pressure(Signal::Constant(0.0)));
    let expected = "2 pores are cut off from every place with an imposed pressure, in 2 places, between the grains 0, 1, 2, 3; \
                    between 4, 5, 6, 7:";
    assert!(said.starts_with(expected), "{said}");
    // Where no pressure is given, from all others.
    let said = sealed(Water::Sealed);
    assert!(said.starts_with("2 pores are cut off from all others, in 2 places"), "{said}");
}

#[test]
fn blocked_pores_in_a_sealed_box_leave_the_level_free() {
    let block = vec![Block { from: [0.0, 0.0, 0.0], to: [0.05, 0.04, 0.02] }];
    let (mut state, mut model) = sample(Default::default(), Stepping::Explicit);
    if let Some(FluidModel { flow: Flow::Pores(pores), .. }) = &mut model.fluid {
        pores.blocked = block;
    }
    // A grain in the open part moves: the water around it, whose mean pressure is zero.
    let moving = (0..120).find(|&k| state.grains.position[k].z > 0.035).unwrap();
    state.grains.velocity[moving] = DVec3::new(1e-3, 0.0, 0.0);
    let mut work = Work::default();
    step(&mut state, &model, &mut work).unwrap();
    assert!(work.fluid.free_level(&state));
    let (mesh, pressure) = (work.fluid.mesh().unwrap(), &state.pores().unwrap().pressure);
    let largest = pressure.iter().fold(0.0f64, |a, p| a.max(p.abs()));
    let sum: f64 = mesh.volume.iter().zip(&mesh.node).map(|(v, &n)| v * pressure[n as usize]).sum();
    assert!(largest > 0.0 && sum.abs() < 1e-12 * largest * 1.2e-4, "{sum} {largest}");
    let blocked = mesh.held.iter().zip(pressure).filter(|(held, _)| **held == BLOCKED);
    assert!(blocked.clone().count() > 20 && blocked.clone().all(|(_, p)| *p == 0.0));
}

/// Every way to write a number, for pressure and flux, on every face: what the pores there get is its value there and then.
#[test]
fn each_rule_takes_each_kind_of_number_on_each_face() {
    use porograin::case::Case;
    type Value = fn(DVec3, f64) -> f64;
    let kinds: [(&str, Value); 6] = [
        ("2.5", |_, _| 2.5),
        ("{ ramp = { from = 1.0, to = 5.0, start = 0.1, end = 0.5 } }", |_, _| 3.0),
        ("{ sine = { mean = 1.0, amplitude = 2.0, period = 0.8, start = 0.1 } }", |_, _| 3.0),
        ("{ table = [[0.0, 0.0], [0.2, 4.0], [0.4, 2.0]] }", |_, _| 3.0),
        ("\"3*cos(10*t)\"", |_, t| 3.0 * (10.0 * t).cos()),
        ("\"100*(x + 2*y - z)*sin(t) + 1\"", |x, t| 100.0 * (x.x + 2.0 * x.y - x.z) * t.sin() + 1.0),
    ];
    let time = 0.3;
    for face in 0..6 {
        for (kind, value) in kinds {
            for rule in ["pressure", "inflow"] {
                let (name, other) =
                    (porograin::boundary::FACE_NAMES[face], porograin::boundary::FACE_NAMES[face ^ 1]);
                let text = format!(
                    "title = \"t\"\n[domain]\nsize = [1, 1, 1]\n[grains]\npacking = {{ lattice = {{ count = [1, 1, 1], radius = \
                     0.1 }} }}\ndensity = 1\n[contact.linear]\nyoung = 1\nstiffness-ratio = 1\nfriction = 1\n[face]\n\
                     {name}.water.{rule} = {kind}\n{other}.water.pressure = 0.5\n[[stage]]\nname = \"s\"\nuntil.steps = 1"
                );
                let case = Case::from_text("t.toml", &text, std::path::Path::new(""), &[]).unwrap();
                let mut faces: [Face; 6] = Default::default();
                case.face.apply(&mut faces);
                let (mut state, mut model) = sample(faces, Stepping::Explicit);
                model.stage_start = -time;
                let mut work = Work::default();
                step(&mut state, &model, &mut work).unwrap();
                let mesh = work.fluid.mesh().unwrap();
                let at = |pore: u32| value(mesh.centre[pore as usize], time);
                let told = format!("{name} {rule} = {kind}");
                let sides: Vec<&WallFace> =
                    mesh.wall_faces.iter().filter(|side| side.face as usize == face).collect();
                if rule == "pressure" {
                    let pressure = &state.pores().unwrap().pressure;
                    for side in sides {
                        let found = pressure[mesh.node[side.pore as usize] as usize];
                        assert!((found - at(side.pore)).abs() < 1e-12, "{told}: {found}");
                    }
                    continue;
                }
                let given: f64 = sides.iter().map(|side| side.area * at(side.pore)).sum();
                let out = work.fluid.outflow(&state).unwrap();
                assert!((out[face] + given).abs() < 1e-12 * given.abs(), "{told}: {out:?} {given}");
                assert!((out[face ^ 1] - given).abs() < 1e-7 * given.abs(), "{told}: {out:?} {given}");
            }
        }
    }
}

/// Points take the same kinds of numbers.
#[test]
fn points_take_signals_and_formulas() {
    let signals = [
        (Signal::Table(vec![[-1.0, 0.0], [1.0, 6.0]]), 3.0),
        (formula("100*x + 200*y - 30*z + exp(t)"), 100.0 * 0.012 + 200.0 * 0.01 - 30.0 * 0.01 + 1.0),
    ];
    for (signal, value) in signals {
        let held = Point { at: [0.012, 0.01, 0.01], water: PointWater::Pressure(signal.clone()) };
        let other = Point { at: [0.04, 0.03, 0.05], water: PointWater::Pressure(Signal::Constant(0.0)) };
        let (state, work) = with_places(vec![held, other.clone()], Vec::new(), Default::default());
        let pressure = &state.pores().unwrap().pressure;
        assert!((pressure[work.fluid.mesh().unwrap().points[0] as usize] - value).abs() < 1e-12);
        let source = Point { at: [0.012, 0.01, 0.01], water: PointWater::Source(signal) };
        let (state, work) = with_places(vec![source, other], Vec::new(), Default::default());
        let mesh = work.fluid.mesh().unwrap();
        let out = porograin::permeability::outflow(mesh, &state.pores().unwrap().pressure);
        assert!((out[mesh.points[0] as usize] / value - 1.0).abs() < 1e-7);
    }
}
