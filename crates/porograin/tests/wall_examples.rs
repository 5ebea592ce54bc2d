//! The examples `12-heap`, `14-inclined-flow` and `16-silo`: the numbers of their READMEs, and their pictures.
//!
//! With `PICTURE=1` in the environment the pictures are drawn anew.

use glam::DVec3;
use porograin::case::Case;
use porograin::measure;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::run::Simulation;
use std::path::PathBuf;

const GRAVITY: f64 = 9.81;

fn example(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name)
}

fn start(path: PathBuf) -> Simulation {
    Simulation::new(&Case::from_file(&path, &[]).unwrap()).unwrap()
}

fn draw(file: PathBuf, charts: &[Chart]) {
    if std::env::var_os("PICTURE").is_some() {
        std::fs::write(file, svg(charts)).unwrap();
    }
}

fn series(name: &str, points: Vec<[f64; 2]>, mark: Mark, colour: usize) -> Series {
    Series { name: name.into(), points, mark, colour }
}

fn axis(label: &str, range: [f64; 2]) -> Axis {
    Axis { label: label.into(), range: Some(range), ..Axis::default() }
}

/// Slope and constant of the line of least squares, and the part of the variance it explains.
fn line(points: &[[f64; 2]]) -> [f64; 3] {
    let n = points.len() as f64;
    let mean = |f: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p[0]), mean(&|p| p[1]));
    let xx = mean(&|p| (p[0] - x) * (p[0] - x));
    let xy = mean(&|p| (p[0] - x) * (p[1] - y));
    let yy = mean(&|p| (p[1] - y) * (p[1] - y));
    [xy / xx, y - xy / xx * x, xy * xy / (xx * yy)]
}

/// Grains run out of a round hole at a steady rate, that of Beverloo et al. (1961): `C rho sqrt(g) (D - k d)^(5/2)`.
#[test]
fn a_silo_runs_out_at_the_rate_of_beverloo() {
    let mut simulation = start(example("16-silo").join("case.toml"));
    let mut out: Vec<[f64; 2]> = Vec::new();
    let mut at_rest = None;
    while simulation.advance().unwrap().is_some() {
        let Simulation { state, progress, .. } = &simulation;
        if progress.stage == 1 && at_rest.is_none() {
            // What the walls carry, and the solid fraction between 2 and 8 diameters.
            let carried: f64 = state.domain.walls.iter().map(|place| place.force.z).sum();
            let weight = GRAVITY * state.grains.mass.iter().sum::<f64>();
            let inside = state
                .grains
                .position
                .iter()
                .zip(&state.grains.radius)
                .filter(|(x, _)| (2e-3..8e-3).contains(&x.z));
            let solid: f64 = inside.map(|(_, r)| porograin::grains::sphere_volume(*r)).sum();
            let floor = -state.domain.walls[0].force.z - state.domain.walls[2].force.z;
            at_rest = Some([
                -carried / weight,
                floor / weight,
                solid / (std::f64::consts::PI * 0.0075_f64.powi(2) * 6e-3),
            ]);
        }
        if progress.stage == 1 && state.step % 50 == 0 {
            let grains = &state.grains;
            let gone = grains.position.iter().zip(&grains.mass).filter(|(x, _)| x.z < 0.0).map(|(_, m)| m);
            out.push([state.time - progress.began.unwrap_or_default().time, gone.sum::<f64>()]);
        }
    }
    let [carried, floor, solid] = at_rest.unwrap();
    let steady: Vec<[f64; 2]> = out.iter().copied().filter(|p| (0.05..0.25).contains(&p[0])).collect();
    let [rate, from, straight] = line(&steady);
    let beverloo = 0.58 * 2600.0 * solid * GRAVITY.sqrt() * (5e-3_f64 - 1.4e-3).powf(2.5);
    println!(
        "silo: carried {carried} floor {floor} solid {solid} rate {rate} straight {straight} beverloo {beverloo}"
    );
    let fit = vec![[0.0, 1e3 * from], [0.3, 1e3 * (from + 0.3 * rate)]];
    draw(
        example("16-silo").join("rate.svg"),
        &[Chart {
            title: "what has run out".into(),
            x: axis("time since the lid went [s]", [0.0, 0.3]),
            y: axis("mass [g]", [0.0, 1.0]),
            series: vec![
                series("found", out.iter().map(|p| [p[0], 1e3 * p[1]]).collect(), Mark::Dots, 0),
                series("steady", fit, Mark::Line, 1),
            ],
        }],
    );
}

/// Down a rough plane every layer feels the same ratio of stresses, the tangent of the slope; the profile is that of Bagnold, and its
/// inertial number that of a sheared sample with the same ratio.
#[test]
fn an_inclined_flow_follows_the_friction_law_of_sheared_samples() {
    let tilt = 24_f64.to_radians();
    // Inertial number and stress ratio, solid fraction of samples sheared at four rates.
    let mut shear = start(example("14-inclined-flow").join("shear.toml"));
    let mut law: Vec<[f64; 3]> = Vec::new();
    let (mut sums, mut count) = ([0.0; 3], 0);
    let mut stage = 0;
    loop {
        let went = shear.advance().unwrap().is_some();
        let now = shear.progress.stage;
        if now != stage {
            if count > 0 {
                law.push(sums.map(|s| s / f64::from(count)));
            }
            (stage, sums, count) = (now, [0.0; 3], 0);
        }
        if !went {
            break;
        }
        let state = &shear.state;
        let (Some(stage), Some(began)) = (shear.stage(), shear.progress.began) else { continue };
        // The second half of each stage.
        let Some(length) = stage.until.time else { continue };
        if state.step % 20 == 0 && state.time - began.time > 0.5 * length {
            let stress = measure::contact_stress(state, shear.model());
            let rate = state.domain.rate.z_axis.x;
            let number = rate * 1e-3 / (stress.z_axis.z / 2600.0).sqrt();
            let found = [number, -stress.z_axis.x / stress.z_axis.z, 1.0 - measure::porosity(state)];
            (0..3).for_each(|k| sums[k] += found[k]);
            count += 1;
        }
    }
    for row in &law {
        println!("law: {row:?}");
    }

    let mut flow = start(example("14-inclined-flow").join("case.toml"));
    const BINS: usize = 20;
    let size = 0.5e-3;
    let mut bins = [[0.0; 3]; BINS];
    let (mut ratio, mut height, mut looks) = ([0.0; 2], 0.0, 0.0);
    while flow.advance().unwrap().is_some() {
        let state = &flow.state;
        if flow.progress.stage == 1 && state.step % 20 == 0 && state.time > 1.0 {
            let grains = &state.grains;
            for ((x, v), m) in grains.position.iter().zip(&grains.velocity).zip(&grains.mass) {
                let bin = (x.z / size) as usize;
                if bin < BINS {
                    (bins[bin][0] += m, bins[bin][1] += m * v.x);
                }
            }
            let mass: f64 = grains.mass.iter().sum();
            height +=
                2.0 * grains.position.iter().zip(&grains.mass).map(|(x, m)| x.z * m).sum::<f64>() / mass;
            let force = state.domain.wall_force[4];
            (ratio[0] += force.x, ratio[1] -= force.z);
            looks += 1.0;
        }
    }
    let state = &flow.state;
    let mass: f64 = state.grains.mass.iter().sum();
    let height = height / looks;
    let solid = state.grains.volume() / (6e-5 * height);
    let profile: Vec<[f64; 2]> = (0..BINS)
        .filter(|&k| bins[k][0] > 0.0 && (k as f64 + 1.0) * size < height)
        .map(|k| [(k as f64 + 0.5) * size, bins[k][1] / bins[k][0]])
        .collect();
    let bagnold = |z: f64| height.powf(1.5) - (height - z).powf(1.5);
    let bulk: Vec<[f64; 2]> = profile
        .iter()
        .filter(|p| p[0] > 2e-3 && p[0] < height - 1e-3)
        .map(|p| [bagnold(p[0]), p[1]])
        .collect();
    let [slope, from, straight] = line(&bulk);
    let number = 1.5 * slope * 1e-3 / (solid * GRAVITY * tilt.cos()).sqrt();
    println!(
        "flow: height {height} solid {solid} number {number} straight {straight} ratio {} tan {} weight {} {} glued {}",
        ratio[0] / ratio[1],
        tilt.tan(),
        ratio[1] / looks,
        mass * GRAVITY * tilt.cos(),
        state.domain.glue.grains.len()
    );
    for p in &profile {
        println!("{p:?}");
    }
    let _ = (from, DVec3::ZERO);
}

/// A tube full of grains is lifted: they come to rest in a heap with straight slopes.
#[test]
fn a_heap_has_an_angle_of_repose() {
    let mut simulation = start(example("12-heap").join("case.toml"));
    while simulation.advance().unwrap().is_some() {}
    let grains = &simulation.state.grains;
    let kinetic = measure::kinetic_energy(grains);
    // The surface: the highest grain in each ring.
    let mut top = [0.0_f64; 30];
    for (x, r) in grains.position.iter().zip(&grains.radius) {
        let ring = (x.truncate().length() / 1e-3) as usize;
        if ring < top.len() {
            top[ring] = top[ring].max(x.z + r);
        }
    }
    println!("heap: kinetic {kinetic} {top:?}");
}
