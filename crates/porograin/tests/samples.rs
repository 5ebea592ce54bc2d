//! Preparation of samples: compaction to a porosity, rain, growth; the example `19-pluviation`.
//!
//! With `PICTURE=1` in the environment its picture is drawn anew.

use glam::DVec3;
use porograin::case::Case;

use porograin::measure;
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::packing::Grading;
use porograin::run::{RunError, Simulation};
use std::path::Path;

fn case(text: &str) -> Case {
    Case::from_text("case.toml", text, Path::new("."), &[]).unwrap()
}

/// A cloud compacted by pistons from five sides.
fn compacting(porosity: f64, steps: u64) -> Case {
    case(&format!(
        r#"
        title = "compaction to a porosity"
        [domain]
        size = [0.02, 0.02, 0.02]
        [grains]
        packing = {{ cloud = {{ count = 300, spread = 0.2, seed = 3, porosity = 0.7 }} }}
        density = 2600.0
        [contact.linear]
        young = 1e6
        stiffness-ratio = 0.5
        friction = 30.0
        [face.all]
        solid = {{ servo = {{ stress = 1000.0 }} }}
        [[stage]]
        name = "compact"
        compact = {{ porosity = {porosity} }}
        until = {{ unbalanced = 2e-2, stress-error = 0.05, max-steps = {steps} }}
        "#
    ))
}

fn run(simulation: &mut Simulation) -> Result<(), RunError> {
    while simulation.advance()?.is_some() {}
    Ok(())
}

/// With its own friction the sample rests looser; friction is lowered until it is at 0.44, and is back then.
#[test]
fn a_sample_is_compacted_to_a_porosity() {
    let case = compacting(0.44, 100_000);
    let mut whole = Simulation::new(&case).unwrap();
    let mut stopped = None;
    while whole.advance().unwrap().is_some() {
        // Half way, friction lowered: to be gone on with.
        if stopped.is_none() && whole.progress.compaction.friction < 0.5 {
            stopped = Some((whole.state.clone(), whole.progress.clone()));
        }
    }
    let porosity = measure::porosity(&whole.state);
    assert!((porosity - 0.44).abs() < 2e-3, "{porosity}");
    let compaction = whole.progress.compaction;
    assert!(compaction.reached && compaction.friction == 1.0 && compaction.lowest < 0.5, "{compaction:?}");
    let friction = whole.model().contact.all.friction();
    assert!((friction - 30.0).abs() < 1e-12, "{friction}");
    // Everything a restart needs is there: the same bits.
    let (state, progress) = stopped.unwrap();
    let mut resumed = Simulation::resume(&case, state, progress);
    run(&mut resumed).unwrap();
    assert_eq!(resumed.state, whole.state);
    assert_eq!(resumed.progress, whole.progress);
}

#[test]
fn a_porosity_out_of_reach_is_told() {
    let mut simulation = Simulation::new(&compacting(0.2, 100_000)).unwrap();
    let told = run(&mut simulation).unwrap_err().to_string();
    assert!(told.contains("the porosity is 0.") && told.contains("asked 0.2"), "{told}");
    assert!(simulation.state.step < 30_000, "it goes on in vain: step {}", simulation.state.step);
    assert!(told.contains("with the friction between grains down to"), "{told}");
}

/// Runs a case to its end, looking at every step, and again from the middle: the same bits.
fn run_and_resume(case: &Case, middle: u64, mut look: impl FnMut(&Simulation)) -> Simulation {
    let mut whole = Simulation::new(case).unwrap();
    let mut stopped = None;
    while whole.advance().unwrap().is_some() {
        look(&whole);
        if whole.state.step == middle {
            stopped = Some((whole.state.clone(), whole.progress.clone()));
        }
    }
    let (state, progress) = stopped.unwrap();
    let mut resumed = Simulation::resume(case, state, progress);
    run(&mut resumed).unwrap();
    assert_eq!(resumed.state, whole.state);
    assert_eq!(resumed.progress, whole.progress);
    whole
}

/// Grains fall into a box with a slanting plate in it: `domain` and `rain` are lines of the case.
fn raining(domain: &str, rain: &str) -> Case {
    raining_for(100_000, domain, rain)
}

fn raining_for(steps: u64, domain: &str, rain: &str) -> Case {
    case(&format!(
        r#"
        title = "rain"
        gravity = [0.0, 0.0, -9.81]
        [domain]
        size = [0.01, 0.01, 0.03]
        {domain}
        [grains]
        packing = "empty"
        density = 2600.0
        [contact.linear]
        young = 2e5
        stiffness-ratio = 0.5
        friction = 20.0
        [[stage]]
        name = "rain"
        rain = {{ {rain} }}
        until = {{ unbalanced = 0.05, max-steps = {steps} }}
        [[watch]]
        measures = ["energy-budget"]
        every = {{ steps = 1000 }}
        "#
    ))
}

const PLATE: &str = r#"
    [[wall]]
    name = "plate"
    shape = { rectangle = { corner = [0.0, 0.0, 0.02], edges = [[0.01, 0.0, 0.006], [0.0, 0.01, 0.0]] } }
"#;

#[test]
fn grains_rain_and_settle() {
    let rain = "count = 120, rate = 1000.0, radius = 1e-3, grading = { normal = { deviation = 0.1 } }, velocity = [0.0, 0.0, -0.1]";
    let (mut count, mut before) = (0, 0.0);
    let whole = run_and_resume(&raining("", rain), 2050, |now| {
        let (state, grains) = (&now.state, &now.state.grains);
        for k in count..grains.len() {
            // One step after they appeared they have hardly moved: they touch neither a grain nor a wall.
            let (x, r) = (grains.position[k], grains.radius[k]);
            assert!((0..k).all(|j| x.distance(grains.position[j]) > (r + grains.radius[j]) * 0.99));
            assert!(x.z + r < 0.03 && x.x > 0.99 * r && x.x < 0.01 - 0.99 * r);
            assert!((grains.velocity[k].z + 0.1).abs() < 0.01, "{}", grains.velocity[k]);
            // They come at the rate asked for, or later; none before its time.
            assert!(k as f64 <= 1000.0 * before, "grain {k} at {before} s");
        }
        (count, before) = (grains.len(), state.time);
    });
    let grains = &whole.state.grains;
    assert_eq!((grains.len(), whole.progress.fallen.count), (120, 120));
    assert!((0..120).all(|id| grains.id.contains(&id)));
    // They rest on each other: 120 grains fill 5 mm of the box, a loose packing of them less than 11 mm.
    let top = porograin::rain::surface(&whole.state);
    assert!(top < 0.011 && grains.position.iter().all(|x| x.z < top), "{top}");
    let mean = grains.radius.iter().sum::<f64>() / 120.0;
    assert!((mean - 1e-3).abs() < 3e-6, "{mean}");
    let grading = Grading::Normal { deviation: 0.1 };
    assert!(grading.difference(&grains.radius) < 0.02, "{}", grading.difference(&grains.radius));
    let mass: f64 = grains.mass.iter().sum();
    assert!((whole.progress.fallen.mass / mass - 1.0).abs() < 1e-12);
    // The books open with the kinetic energy of all that came.
    let start = whole.progress.ledger.unwrap().start.unwrap();
    assert!((start / (0.5 * mass * 0.01) - 1.0).abs() < 1e-12, "{start}");
}

/// In layers, of two materials, beside a plate and across a period: the next layer waits until the last rests; the rain ends with
/// the grain that makes up the mass.
#[test]
fn grains_rain_in_layers_beside_walls_and_across_periods() {
    let rain = "mass = 7e-4, layer = 30, radius = 1e-3, within = [[0.0, 0.0, 0.018], [0.01, 0.01, 0.03]]";
    let materials = r#"
        [material.glass]
        part = 0.7
        density = 2500.0
        [material.steel]
        part = 0.3
        density = 7800.0
    "#;
    let domain = format!(r#"periodic = "xy"{materials}"#);
    // A plate that ends within a period is refused: a walled box for it.
    for (walled, domain) in [(false, domain), (true, PLATE.to_owned())] {
        let mut layers = Vec::new();
        let (mut count, mut rested) = (0, 0);
        let whole = run_and_resume(&raining(&domain, rain), 2050, |now| {
            let (state, grains) = (&now.state, &now.state.grains);
            if grains.len() > count {
                // Looked at every 50 steps, acted upon every 100.
                let late = state.step - rested;
                assert!(count % 30 != 0 || late <= 101, "a layer falls on one that rested {late} steps ago");
                layers.push(grains.len() - count);
            }
            for k in count..grains.len() {
                let (x, r) = (grains.position[k], grains.radius[k]);
                assert!(x.z > 0.018, "{x}");
                let nearest = |mut d: DVec3| {
                    if !walled {
                        d -= DVec3::new(0.01 * (d.x / 0.01).round(), 0.01 * (d.y / 0.01).round(), 0.0);
                    }
                    d.length()
                };
                assert!((0..k).all(|j| nearest(x - grains.position[j]) > 1.99 * r));
                let normal = DVec3::new(-0.006, 0.0, 0.01).normalize();
                let from_plate = (x - DVec3::new(0.0, 0.0, 0.02)).dot(normal).abs();
                assert!(!walled || from_plate > 0.99 * r, "{from_plate}");
            }
            count = grains.len();
            if state.step % 50 == 0 && measure::unbalanced(state, now.model(), &now.work().loads) <= 0.05 {
                rested = state.step;
            }
        });
        let grains = &whole.state.grains;
        let (mass, fallen) = (grains.mass.iter().sum::<f64>(), whole.progress.fallen);
        assert!((fallen.mass / mass - 1.0).abs() < 1e-12 && fallen.enough);
        assert!((7e-4..7e-4 + 3.3e-5).contains(&mass), "{mass}");
        assert!(layers.iter().rev().skip(1).all(|&n| n == 30), "{layers:?}");
        if !walled {
            let steel = grains.material.iter().filter(|&&m| m == 1).count() as f64 / grains.len() as f64;
            assert!((steel - 0.3).abs() < 0.15, "{steel}");
            let volume = porograin::grains::sphere_volume(1e-3);
            let dense =
                |k: usize| grains.mass[k] / volume - [2500.0, 7800.0][usize::from(grains.material[k])];
            assert!((0..grains.len()).all(|k| dense(k).abs() < 1e-6));
        }
    }
}

/// A bed is filled to a height; and what finds no room is told.
#[test]
fn grains_rain_until_the_bed_is_high_enough() {
    let rain = "height = 8e-3, rate = 200.0, radius = 1e-3";
    let mut simulation = Simulation::new(&raining("", rain)).unwrap();
    run(&mut simulation).unwrap();
    let top = porograin::rain::surface(&simulation.state);
    // The 14 grains that were in flight when it was high enough add 1.1 mm, and one may stand on another.
    assert!(top > 7e-3 && top < 1.11e-2, "{top}");

    let mut small = Simulation::new(&raining(
        "",
        "count = 3, rate = 1e4, radius = 1e-3, within = [[0.0, 0.0, 0.0], [0.9e-3, 0.01, 0.01]]",
    ));
    let told = run(small.as_mut().unwrap()).unwrap_err().to_string();
    assert!(told.contains("no grain finds room to fall"), "{told}");
    let text = "count = 1000, rate = 1e6, radius = 1e-3";
    let told = run(&mut Simulation::new(&raining_for(3000, "", text)).unwrap());
    let told = told.unwrap_err().to_string();
    assert!(told.contains("not enough grains have found room to fall: "), "{told}");
}

fn growing(grow: &str, until: &str) -> Case {
    case(&format!(
        r#"
        title = "growth"
        [domain]
        size = [0.01, 0.01, 0.01]
        [grains]
        packing = {{ cloud = {{ count = 150, spread = 0.2, seed = 3, porosity = 0.7 }} }}
        density = 2600.0
        [contact.linear]
        young = 1e6
        stiffness-ratio = 0.5
        friction = 0.0
        [[stage]]
        name = "grow"
        grow = {{ {grow} }}
        until = {{ {until}, max-steps = 100000 }}
        "#
    ))
}

#[test]
fn grains_grow_to_a_porosity() {
    let case = growing("porosity = 0.45, rate = 20.0", "unbalanced = 0.05");
    let before = Simulation::new(&case).unwrap().state;
    let whole = run_and_resume(&case, 150, |_| {});
    assert!((measure::porosity(&whole.state) - 0.45).abs() < 1e-9);
    let grown = whole.progress.grown.unwrap();
    assert!((grown - (0.55_f64 / 0.3).cbrt()).abs() < 1e-9, "{grown}");
    for k in 0..150 {
        let (old, new) = (&before.grains, &whole.state.grains);
        assert!((new.radius[k] / old.radius[k] - grown).abs() < 1e-9);
        assert!((new.mass[k] / old.mass[k] - grown.powi(3)).abs() < 1e-8);
    }
}

/// The stress is met at rest, and on the walls as in the contacts.
#[test]
fn grains_grow_to_a_stress() {
    let case = growing("stress = 1e3, rate = 20.0", "unbalanced = 0.01, stress-error = 0.01");
    let whole = run_and_resume(&case, 3333, |_| {});
    let stress = measure::mean_stress(&whole.state, whole.model());
    assert!((stress / 1e3 - 1.0).abs() < 0.01, "{stress}");
    let walls = measure::wall_stress(&whole.state.domain);
    assert!((walls.iter().sum::<f64>() / 6e3 - 1.0).abs() < 0.02, "{walls:?}");
    let (porosity, grown) = (measure::porosity(&whole.state), whole.progress.grown.unwrap());
    assert!((grown - ((1.0 - porosity) / 0.3).cbrt()).abs() < 1e-9, "{grown} {porosity}");
    assert!((0.35..0.45).contains(&porosity), "{porosity}");
    assert!(measure::coordination(&whole.state) > 4.0);
    // Walls that could not carry it: the sample fills up before.
    let told = run(&mut Simulation::new(&growing(
        "porosity = 0.2, rate = 0.01",
        "unbalanced = 0.05, max-time = 0.01",
    ))
    .unwrap());
    let told = told.unwrap_err().to_string();
    assert!(
        told.contains("the grains have grown to a porosity of 0.") && told.contains("asked 0.2"),
        "{told}"
    );
}

/// Porosity of the core of `19-pluviation` when grains fall from `height` mm, `rate` per second for `time` s.
fn pluviated([height, rate, time]: [f64; 3], seed: u32) -> f64 {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/19-pluviation");
    let set = [
        format!("stage.rain.rain.within=[[0.0,0.0,{}],[0.01,0.01,{}]]", 1e-3 * height, 1e-3 * height + 6e-3),
        format!("stage.rain.rain.rate={rate:?}"),
        format!("stage.rain.until.time={time:?}"),
        format!("stage.rain.rain.seed={seed}"),
    ];
    let case = Case::from_file(&folder.join("case.toml"), &set).unwrap();
    let mut simulation = Simulation::new(&case).unwrap();
    run(&mut simulation).unwrap();
    assert_eq!(simulation.state.grains.len(), 200);
    measure::region_porosity(&simulation.state, &case.regions()[0])
}

const HEIGHTS: [[f64; 3]; 4] =
    [[16.0, 400.0, 0.65], [24.0, 400.0, 0.65], [40.0, 400.0, 0.65], [63.0, 400.0, 0.65]];
const RATES: [[f64; 3]; 4] =
    [[40.0, 150.0, 1.5], [40.0, 400.0, 0.65], [40.0, 1600.0, 0.4], [40.0, 6400.0, 0.4]];

/// The numbers of the README.
#[test]
fn a_bed_is_denser_the_higher_and_the_slower_it_rains() {
    let mean = |case: [f64; 3], seeds: u32| {
        (1..=seeds).map(|seed| pluviated(case, seed)).sum::<f64>() / f64::from(seeds)
    };
    let [low, high, slow, fast] = [HEIGHTS[0], HEIGHTS[3], RATES[0], RATES[3]].map(|case| mean(case, 2));
    // Two seeds of those of the README, whose means scatter by 0.003.
    for (found, expected) in [(low, 0.379), (high, 0.370), (slow, 0.372), (fast, 0.387)] {
        assert!((found - expected).abs() < 0.004, "{found} {expected}");
    }
    assert!(low - high > 0.004, "from low {low}, from high {high}");
    assert!(fast - slow > 0.01, "fast {fast}, slow {slow}");
    if std::env::var_os("PICTURE").is_none() {
        return;
    }
    let chart = |title: &str, x: Axis, points: Vec<[f64; 2]>| Chart {
        title: title.into(),
        x,
        y: Axis { label: "porosity [-]".into(), range: Some([0.365, 0.395]), ..Axis::default() },
        series: [Mark::Dots, Mark::Line]
            .map(|mark| Series { name: String::new(), points: points.clone(), mark, colour: 0 })
            .into(),
    };
    let axis =
        |label: &str, range: [f64; 2]| Axis { label: label.into(), range: Some(range), ..Axis::default() };
    let heights = HEIGHTS.map(|case| [case[0], mean(case, 3)]).to_vec();
    let rates = RATES.map(|case| [case[1], mean(case, 3)]).to_vec();
    println!("{heights:?}\n{rates:?}");
    let charts = [
        chart("400 grains per second", axis("from a height of [mm]", [0.0, 70.0]), heights),
        chart("from 40 mm", Axis { logarithmic: true, ..axis("grains per second", [1e2, 1e4]) }, rates),
    ];
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/19-pluviation/pluviation.svg");
    std::fs::write(file, svg(&charts)).unwrap();
}
