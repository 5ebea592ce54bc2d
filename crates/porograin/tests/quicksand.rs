//! The bed of `examples/22-quicksand` against what follows from its grains before any water flows, and the numbers of its README. With
//! `PICTURE=1` in the environment its picture is drawn anew.

mod chance;

use chance::Known;
use porograin::case::Case;
use porograin::measure::{Region, region_porosity};
use porograin::output::chart::{Axis, Chart, Mark, Series, svg};
use porograin::run::Simulation;
use std::path::PathBuf;

/// Inflow at the end of the ramp [m/s], and how long it takes [s].
const RAMP: [f64; 2] = [3.2e-3, 1.6];
/// Edge of the cells [m], how many there are upwards, and how many of these the bed fills.
const EDGE: f64 = 2e-3;
const LAYERS: usize = 10;
const FULL: usize = 4;
/// [Pa s]
const VISCOSITY: f64 = 0.01;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/22-quicksand")
}

/// What the settled bed foretells, inflows in m/s.
#[derive(Debug)]
struct Foretold {
    /// Submerged weight per area [Pa].
    weight: f64,
    /// Part of it of the grains whose centre is within a diameter of the bottom.
    lowest: f64,
    /// Void part of the bed, twice as high as its centre.
    porosity: f64,
    /// Void part of the layers.
    layers: Vec<f64>,
    /// Inflow that floats a bed with that porosity all over.
    uniform: f64,
    /// With the porosities of its layers, the surface sharp.
    sharp: f64,
    /// With those of the layers of the grid.
    smeared: f64,
    /// With those of the cells: if no water crosses from column to column, and if the pressure is the same all over each layer. The truth
    /// lies between: links cut conduct less, nodes joined conduct more (Rayleigh).
    columns: f64,
    isobaric: f64,
    /// What the space above the bed takes of the pressure, over the weight and per inflow [s/m].
    above: f64,
}

/// `d² n³/(150 (1 - n)²)/mu` [m²/(Pa s)].
fn mobility(n: f64, d: f64) -> f64 {
    d * d * n.powi(3) / (150.0 * (1.0 - n).powi(2)) / VISCOSITY
}

impl Foretold {
    /// Of grains at rest.
    fn new(simulation: &Simulation, across: usize) -> Foretold {
        let state = &simulation.state;
        let grains = &state.grains;
        let weight = 9.81 * (grains.mass.iter().sum::<f64>() - 1000.0 * grains.volume()) / 1e-4;
        let [squares, cubes] = [2, 3].map(|k| grains.radius.iter().map(|r| r.powi(k)).sum::<f64>());
        let d = 2.0 * cubes / squares;
        let near = grains.position.iter().zip(&grains.mass).filter(|(x, _)| x.z < 1e-3);
        let width = 0.01 / across as f64;
        let porosity_of = |x: usize, y: usize, z: usize| {
            let lower = [x as f64 * width, y as f64 * width, z as f64 * EDGE];
            let upper = [lower[0] + width, lower[1] + width, lower[2] + EDGE];
            region_porosity(state, &Region::Box { lower, upper }).min(0.95)
        };
        let places = |z: usize| (0..across * across).map(move |k| (k % across, k / across, z));
        let cells: Vec<Vec<f64>> =
            (0..LAYERS).map(|z| places(z).map(|(x, y, z)| porosity_of(x, y, z)).collect()).collect();
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
        let layers: Vec<f64> = cells.iter().map(|layer| mean(layer)).collect();
        let resistance = |n: &f64| EDGE / mobility(*n, d);
        let series = |layers: &[f64]| layers.iter().map(resistance).sum::<f64>();
        let height = 2.0 * grains.position.iter().map(|x| x.z).sum::<f64>() / grains.len() as f64;
        let porosity = 1.0 - grains.volume() / 1e-4 / height;
        // The rest on top, packed like what is below.
        let packed = mean(&layers[..FULL]);
        let rest: f64 = layers[FULL..LAYERS].iter().filter(|n| **n < 0.9).map(|n| EDGE * (1.0 - n)).sum();
        let sharp = series(&layers[..FULL]) + rest / (1.0 - packed) / mobility(packed, d);
        let conduct = |layer: &Vec<f64>| mean(&layer.iter().map(|n| mobility(*n, d)).collect::<Vec<_>>());
        let isobaric: f64 = cells.iter().map(|layer| EDGE / conduct(layer)).sum();
        let column = |k: usize| 1.0 / series(&cells.iter().map(|layer| layer[k]).collect::<Vec<_>>());
        let columns = (0..across * across).map(column).sum::<f64>() / (across * across) as f64;
        Foretold {
            weight,
            lowest: near.map(|(_, m)| m).sum::<f64>() / grains.mass.iter().sum::<f64>(),
            porosity,
            uniform: weight * mobility(porosity, d) / height,
            sharp: weight / sharp,
            smeared: weight / series(&layers),
            columns: weight * columns,
            isobaric: weight / isobaric,
            above: series(&layers[FULL + 1..]) / weight,
            layers,
        }
    }

    /// By how much the centre of the bed has risen at an inflow, if it begins to at `critical` (Kynch 1952): layers of grains move at
    /// `U - F(n)`, `F` the flux past them that carries them, `n³/(1 - n)` times what makes it `critical` in the bed; above the lowest layers, which have
    /// spread, they move all together.
    fn rise(&self, critical: f64, inflow: f64) -> f64 {
        let (count, steps) = (200, 4000);
        let carrying = |n: f64| n.powi(3) / (1.0 - n);
        let thick = 1.0 / count as f64;
        let mut top: Vec<f64> = (1..=count).map(|k| k as f64 * thick).collect();
        // Heights in those of the bed.
        let height = 1.0 / self.height();
        let dt = RAMP[1] * inflow / RAMP[0] / steps as f64;
        for step in 0..steps {
            let now = inflow * step as f64 / steps as f64;
            if now < critical {
                continue;
            }
            let mut below = 0.0;
            for z in &mut top {
                let n = 1.0 - (1.0 - self.porosity) * thick / (*z - below);
                below = *z;
                *z += dt * height * (now - critical * carrying(n) / carrying(self.porosity));
            }
        }
        let mean: f64 = top.iter().sum::<f64>() / count as f64 - 0.5 * top[count - 1] * thick;
        2.0 * mean - 1.0
    }

    /// Relative change of the conductivity by the strain of the bed: `dk/k = (3/n + 2/(1 - n)) dn`, `dn` is `1 - n` times the strain.
    fn sensitivity(&self) -> f64 {
        let n = self.porosity;
        3.0 * (1.0 - n) / n + 2.0
    }

    fn height(&self) -> f64 {
        self.weight / (9.81 * 1650.0 * (1.0 - self.porosity))
    }
}

/// The bed at one moment.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Inflow [m/s].
    inflow: f64,
    /// Excess pressure at the bottom over the submerged weight per area.
    carried: f64,
    /// Push of water and grains on the bottom over the submerged weight.
    bottom: f64,
    /// Height of the centre of the grains over that at the beginning of the inflow, less 1.
    rise: f64,
}

/// The settled bed on cells so many across, and the bed every 20 ms of the inflow.
fn run(across: usize) -> (Foretold, Vec<Seen>) {
    let cells = format!("fluid.flow.darcy.cells.count=[{across}, {across}, {LAYERS}]");
    let case = Case::from_file(&folder().join("case.toml"), &[cells]).unwrap();
    let mut simulation = Simulation::new(&case).unwrap();
    while simulation.stage().is_some_and(|stage| stage.name == "settle") {
        simulation.advance().unwrap();
    }
    let foretold = Foretold::new(&simulation, across);
    let centre = |simulation: &Simulation| {
        let grains = &simulation.state.grains;
        grains.position.iter().map(|x| x.z).sum::<f64>() / grains.len() as f64
    };
    let (start, from) = (simulation.state.time, centre(&simulation));
    let (mut next, mut seen) = (0.0, Vec::new());
    loop {
        let time = simulation.state.time - start;
        if time >= next {
            next += 0.02;
            seen.push(Seen {
                inflow: RAMP[0] * time / RAMP[1],
                carried: simulation.profile().unwrap()[0] / foretold.weight,
                bottom: -simulation.state.domain.wall_force[4].z / (1e-4 * foretold.weight),
                rise: centre(&simulation) / from - 1.0,
            });
        }
        if simulation.advance().unwrap().is_none() {
            return (foretold, seen);
        }
    }
}

/// Mean of a number over some of what was seen.
fn mean(seen: &[Seen], among: impl Fn(&Seen) -> bool, of: impl Fn(&Seen) -> f64) -> f64 {
    let some: Vec<f64> = seen.iter().filter(|s| among(s)).map(of).collect();
    assert!(some.len() > 5, "{}", some.len());
    some.iter().sum::<f64>() / some.len() as f64
}

/// The inflow whose pressure would carry the bed, while it carries from one part of it to another.
fn critical(seen: &[Seen], from: f64, to: f64) -> f64 {
    1.0 / mean(seen, |s| s.carried > from && s.carried < to, |s| s.carried / s.inflow)
}

#[test]
fn the_water_carries_the_bed_from_the_critical_gradient_on() {
    let (foretold, seen) = run(5);
    println!("void parts of the layers {:.3?}\n{foretold:?}", foretold.layers);
    let [early, late] = [critical(&seen, 0.2, 0.5), critical(&seen, 0.5, 0.8)];
    let all = critical(&seen, 0.2, 0.8);
    let floating = |s: &Seen| s.inflow > 1.2 * all;
    let [carried, bottom] = [mean(&seen, floating, |s| s.carried), mean(&seen, floating, |s| s.bottom)];
    let at = |inflow: f64| seen.iter().find(|s| s.inflow >= inflow).unwrap();
    println!(
        "critical inflow {all:.4e} m/s ({early:.4e}, {late:.4e}); carried {carried:.4}, bottom {bottom:.5}"
    );
    if std::env::var_os("PICTURE").is_some() {
        picture(&foretold, &seen);
    }
    let rise = at(0.85 * all).rise;
    println!("rise before {rise:.4}");
    // The same straight line below and above, between what the porosities of the cells leave possible, and what the bed has changed of them since.
    let play = foretold.sensitivity() * rise.abs();
    for found in [early, late, all] {
        let [least, most] = [foretold.columns * (1.0 - play), foretold.isobaric * (1.0 + play)];
        assert!(found > least && found < most, "{found:e} {foretold:?} {play}");
    }
    // What makes it more than the mean porosity says is most of all the surface, smeared over a cell.
    let [uniform, surface] = [all - foretold.uniform, foretold.smeared - foretold.sharp];
    assert!(surface > 0.5 * uniform && foretold.sharp > foretold.uniform, "{all:e} {foretold:?}");
    // Then the bed floats; of its lowest grains, around which the cells are not denser than above, some may stay.
    assert!(carried < 1.0 && carried > 1.0 - foretold.lowest, "{carried} {}", foretold.lowest);
    // Water and grains push with the weight, with what the space above takes of the pressure, and with what the ramp gives the bed of speed.
    let [most, inertia] = [foretold.above * RAMP[0], RAMP[0] / RAMP[1] / 9.81 * 2650.0 / 1650.0];
    println!("above {most:.5}, inertia {inertia:.5}");
    let known = |mean, deviation| Known { mean, deviation, samples: 16 };
    let push = known(1.0015, 0.00032);
    push.holds("push on the bottom over the weight", &[bottom]);
    assert!(push.mean > 1.0 && push.mean < 1.0 + most + inertia, "{most} {inertia}");
    // Before, springs give some of the height back, and grains move closer or apart.
    known(0.06e-3, 1.43e-3).holds("rise before", &[rise]);
    for (inflow, over) in [(2.75e-3, known(1.075, 0.056)), (3.1e-3, known(1.020, 0.042))] {
        let found = at(inflow);
        let [least, most] =
            [foretold.isobaric, foretold.columns].map(|from| foretold.rise(from, found.inflow));
        println!("rise at {inflow:e}: {:.4}, foretold {least:.4} to {most:.4}", found.rise);
        assert!(found.rise > least, "{found:?} {least} {most}");
        over.holds("rise over the more of those foretold", &[found.rise / most]);
    }
}

#[test]
fn on_cells_as_wide_as_the_bed_the_critical_gradient_is_that_of_its_layers() {
    let (foretold, seen) = run(1);
    let found = critical(&seen, 0.2, 0.8);
    println!("critical inflow {found:.4e} m/s, layers {:.4e}", foretold.smeared);
    // One column: the bounds meet, but for what the bed has changed of its porosity since.
    let at = seen.iter().find(|s| s.inflow >= 0.5 * found).unwrap();
    let over = found / foretold.smeared - foretold.sensitivity() * at.rise;
    println!("rise {:.4}, over that foretold {over:.4}", at.rise);
    Known { mean: 1.0075, deviation: 0.0041, samples: 16 }.holds("over that foretold", &[over]);
}

fn picture(foretold: &Foretold, seen: &[Seen]) {
    let axis =
        |label: &str, range: [f64; 2]| Axis { label: label.into(), range: Some(range), ..Axis::default() };
    let line = |name: &str, colour: usize, points: Vec<[f64; 2]>| Series {
        name: name.into(),
        points,
        mark: Mark::Line,
        colour,
    };
    let found = |of: &dyn Fn(&Seen) -> f64| seen.iter().map(|s| [1e3 * s.inflow, of(s)]).collect();
    let straight = |critical: f64| vec![[0.0, 0.0], [1e3 * critical, 1.0], [1e3 * RAMP[0], 1.0]];
    let risen = |critical: f64| {
        let inflows = (0..=32).map(|k| RAMP[0] * k as f64 / 32.0);
        inflows.map(|inflow| [1e3 * inflow, 100.0 * foretold.rise(critical, inflow)]).collect()
    };
    let charts = [
        Chart {
            title: "Part of the submerged weight that the water carries".into(),
            x: axis("inflow [mm/s]", [0.0, 3.2]),
            y: axis("pressure below / weight", [0.0, 1.1]),
            series: vec![
                line("found", 0, found(&|s| s.carried)),
                line("mean porosity", 2, straight(foretold.uniform)),
                line("cells, columns apart", 1, straight(foretold.columns)),
                line("cells, layers of one pressure", 3, straight(foretold.isobaric)),
            ],
        },
        Chart {
            title: "Rise of the centre of the bed".into(),
            x: axis("inflow [mm/s]", [0.0, 3.2]),
            y: axis("rise [%]", [-0.5, 6.0]),
            series: vec![
                line("found", 0, found(&|s| 100.0 * s.rise)),
                line("Kynch, columns apart", 1, risen(foretold.columns)),
                line("Kynch, layers of one pressure", 3, risen(foretold.isobaric)),
            ],
        },
    ];
    std::fs::write(folder().join("quicksand.svg"), svg(&charts)).unwrap();
}
