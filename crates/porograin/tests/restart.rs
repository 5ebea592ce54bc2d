//! Whatever a case has in it besides pores: a checkpoint in the middle of a stage and another number of threads change no bit.

mod random;

use porograin::case::Case;
use porograin::output::folder::Written;
use porograin::output::restart::Checkpoint;
use porograin::run::Simulation;
use random::Random;
use std::fmt::Write;
use std::path::Path;

/// Runs a case through on one thread, and again on two, by way of the bytes of a checkpoint at step `middle`; returns the end.
fn same_bits(text: &str, middle: u64) -> Simulation {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/16-silo");
    let case = Case::from_text("case.toml", text, &folder, &[]).unwrap_or_else(|e| panic!("{e}"));
    let threads = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let whole = threads(1).install(|| {
        let mut whole = Simulation::new(&case).unwrap();
        while whole.advance().unwrap().is_some() {}
        whole
    });
    let resumed = threads(2).install(|| {
        let mut first = Simulation::new(&case).unwrap();
        while first.state.step < middle {
            first.advance().unwrap();
        }
        let Simulation { state, progress, .. } = first;
        assert!(progress.began.is_some(), "the checkpoint is in the middle of a stage");
        let written = Written::default();
        let bytes = Checkpoint { state, progress, written }.to_bytes(case.text()).unwrap();
        let Checkpoint { state, progress, .. } = Checkpoint::from_bytes(&bytes, case.text()).unwrap();
        let mut rest = Simulation::resume(&case, state, progress);
        while rest.advance().unwrap().is_some() {}
        rest
    });
    assert_eq!(whole.state, resumed.state);
    assert_eq!(whole.progress, resumed.progress);
    // More than one block of grains, so that threads share them.
    assert!(whole.state.grains.len() > 1024, "{}", whole.state.grains.len());
    whole
}

const CONTACT: &str = r#"
[contact.linear]
young = 5e5
stiffness-ratio = 0.3
friction = 26.565
restitution = 0.7
"#;

/// A mesh from a file, a tube, a disc, a turning plate and a pushed one; rain, glue, and another set of walls in the second stage.
#[test]
fn walls_of_any_shape_rain_and_glue() {
    let end = same_bits(
        &format!(
            r#"
title = "a silo with everything"
gravity = [0.0, 0.0, -9.81]
{CONTACT}
[domain]
size = [0.018, 0.018, 0.040]
origin = [-0.009, -0.009, -0.010]
[grains]
packing = {{ cloud = {{ count = 1000, radius = 0.5e-3, spread = 0.1, seed = 2, within = [[-0.0053, -0.0053, 0.0], [0.0053, 0.0053, 0.024]] }} }}
density = 2600.0
[[wall]]
name = "floor"
shape = {{ stl = {{ file = "floor.stl", scale = 1e-3 }} }}
friction = 26.565
[[wall]]
name = "silo"
shape = {{ cylinder = {{ point = [0.0, 0.0, 0.0], axis = [0.0, 0.0, 1.0], radius = 0.0075, length = 0.03 }} }}
friction = 26.565
[[wall]]
name = "lid"
shape = {{ disc = {{ centre = [0.0, 0.0, 0.0], normal = [0.0, 0.0, 1.0], radius = 0.0025 }} }}
[[wall]]
name = "stirrer"
shape = {{ rectangle = {{ corner = [-0.004, 0.006, 0.0245], edges = [[0.008, 0.0, 0.0], [0.0, 0.0, 0.003]] }} }}
motion = {{ rotating = {{ point = [0.0, 0.0, 0.0], axis = [0.0, 0.0, 1.0], rate = 20.0 }} }}
[[wall]]
name = "piston"
shape = {{ box = {{ lower = [-0.002, -0.002, 0.0285], upper = [0.002, 0.002, 0.0295] }} }}
motion = {{ servo = {{ along = [0.0, 0.0, -1.0], load = {{ force = 0.05 }}, speed = 0.5 }} }}
[[stage]]
name = "drop"
until = {{ steps = 600 }}
[[stage]]
name = "fill"
wall.floor.glue = true
rain = {{ count = 300, rate = 3e4, radius = 0.4e-3, within = [[-0.005, -0.005, 0.0245], [0.005, 0.005, 0.028]], velocity = [0.0, 0.0, -0.5] }}
until = {{ steps = 500 }}
[[stage]]
name = "run out"
wall.floor.glue = true
wall.lid.present = false
until = {{ steps = 300 }}
"#
        ),
        870,
    );
    let (fallen, glue) = (end.state.grains.len() - 1000, &end.state.domain.glue);
    assert!(fallen > 50 && !glue.is_empty(), "{fallen}");
    let walls = &end.state.domain.walls;
    assert!(walls[0].force != glam::DVec3::ZERO && walls[1].force != glam::DVec3::ZERO, "{walls:?}");
    assert!(walls[3].turn != glam::DQuat::IDENTITY && walls[4].shift.z < -1e-4, "{walls:?}");
}

#[test]
fn a_membrane_and_a_pressed_top() {
    let end = same_bits(
        &format!(
            r#"
title = "a sample in a membrane"
{CONTACT}
[domain]
size = [0.03, 0.03, 0.03]
[grains]
packing = {{ cloud = {{ count = 1100, radius = 0.5e-3, seed = 2, within = [[0.008, 0.008, 0.008], [0.0215, 0.0215, 0.0215]] }} }}
density = 2600.0
[membrane]
stress = 100.0
probe = 2e-3
renew = 130
[face.top]
solid = {{ servo = {{ stress = 20.0, speed = 1.0 }} }}
[[stage]]
name = "press"
until = {{ steps = 900 }}
[[stage]]
name = "press more"
membrane = {{ stress = 300.0, probe = 2e-3 }}
until = {{ steps = 500 }}
"#
        ),
        650,
    );
    let [_, volume] = end.state.domain.skin.area_and_volume(&end.state.grains);
    assert!(volume > 1e-7 && end.state.contacts.len() > 500, "{volume} {}", end.state.contacts.len());
}

/// A sheared cell that holds a stress, while its grains grow; friction is changed from one stage to the next.
#[test]
fn growth_in_a_sheared_cell_under_stress() {
    let end = same_bits(
        &format!(
            r#"
title = "growth in a sheared cell"
{CONTACT}
[domain]
size = [0.0125, 0.0125, 0.0125]
periodic = "xyz"
[grains]
packing = {{ cloud = {{ count = 1100, spread = 0.2, seed = 4, porosity = 0.6 }} }}
density = 2600.0
[cell]
gradient = {{ xz = 30.0 }}
stress = {{ zz = 100.0 }}
[[stage]]
name = "grow"
grow = {{ stress = 200.0, rate = 20.0 }}
until = {{ steps = 900, stress-error = 1e-9 }}
[[stage]]
name = "shear"
friction = 5.0
until = {{ steps = 500 }}
"#
        ),
        650,
    );
    let (strain, contacts) = (end.state.domain.strain.z_axis.x, end.state.contacts.len());
    assert!(strain > 1.0 && contacts > 50, "{strain} {contacts}");
}

/// Discs under a piston, dry, then with compressible water on a grid that is pushed in and slowed by inertia while the piston presses more.
#[test]
fn discs_in_coarse_water_under_a_piston() {
    let (mut text, mut random) = (String::from("x,y,z,r\n"), Random(6));
    for k in 0..1280 {
        let (row, along) = (k / 40, k % 40);
        let [x, z] = [1e-3 * (along as f64 + 0.5) + 5e-4 * (row % 2) as f64, 1e-3 * (row as f64 + 0.5)];
        let shake = 5e-5 * random.vector();
        let radius = 4.1e-4 + 5e-5 * random.next();
        writeln!(text, "{},0.005,{},{radius}", x + shake.x, z + shake.z).unwrap();
    }
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("discs.csv");
    std::fs::write(&file, text).unwrap();
    let end = same_bits(
        &format!(
            r#"
title = "discs in water"
gravity = [1.0, 0.0, -9.81]
{CONTACT}
[domain]
size = [0.041, 0.01, 0.0325]
discs = true
[grains]
packing = {{ file = {file:?} }}
density = 2600.0
[fluid]
viscosity = 0.01
bulk-modulus = 1e6
flow = {{ darcy = {{ drag = "ergun", renew = 0.005 }} }}
[face.top]
solid = {{ servo = {{ stress = 200.0, speed = 0.5 }} }}
water = {{ pressure = 0.0 }}
[[stage]]
name = "press"
fluid = false
until = {{ steps = 2000 }}
[[stage]]
name = "soak"
face.top.solid.servo.stress = {{ ramp = {{ from = 200.0, to = 600.0, end = 0.02 }} }}
face.bottom.water.inflow = {{ sine = {{ mean = 2e-3, amplitude = 2e-3, period = 0.01 }} }}
face.left.water.pressure = "20*z/0.03"
until = {{ steps = 900 }}
"#
        ),
        2430,
    );
    let (water, top) = (end.state.grid().unwrap(), end.state.domain.cell.upper().z);
    assert!(water.made_at_step > 2430 && end.state.contacts.len() > 1280, "{}", water.made_at_step);
    let [least, most] = [f64::min, f64::max].map(|f| water.pressure.iter().copied().fold(0.0, f));
    assert!(top < 0.0324 && most - least > 10.0, "{top} {least} {most}");
    // In the plane to the last bit.
    let grains = &end.state.grains;
    assert!(grains.position.iter().all(|x| x.y == 0.005) && grains.velocity.iter().all(|v| v.y == 0.0));
    assert!(grains.spin.iter().all(|w| w.x == 0.0 && w.z == 0.0) && grains.spin.iter().any(|w| w.y != 0.0));
    assert!(water.slowed.iter().any(|&part| part < 1.0), "inertia slows the water");
}
