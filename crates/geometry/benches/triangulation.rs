//! Cost of the triangulation per grain: `cargo bench -p porograin-geometry --bench triangulation [-- SIZE …] [--only NAME] [--write FOLDER]`.
//!
//! `--write` leaves each sample as text (`n`, then `x y z r` lines) for the comparison in `benches/cgal`.

mod samples;

use glam::DVec3;
use porograin_geometry::{Cell, Triangulation};
use samples::{BODY, FACE, SIMPLE, Sample};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut sizes: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![32_000];
    }
    let option = |name: &str| arguments.iter().position(|a| a == name).and_then(|k| arguments.get(k + 1));
    let folder = option("--write");
    let only = option("--only").map_or("", String::as_str);
    println!("| sample | grains | pores | us per grain (shortest) | (median) |");
    println!("|---|---|---|---|---|");
    for &n in &sizes {
        let side = |basis: &[[f64; 3]]| (n as f64 / basis.len() as f64).cbrt().round() as usize;
        let all: [(&str, &dyn Fn() -> Sample); 5] = [
            ("random 20", &|| samples::random(n, 0.2)),
            ("random 0", &|| samples::random(n, 0.0)),
            ("simple cubic", &|| samples::lattice("simple cubic", side(SIMPLE), SIMPLE)),
            ("body-centred", &|| samples::lattice("body-centred", side(BODY), BODY)),
            ("face-centred", &|| samples::lattice("face-centred", side(FACE), FACE)),
        ];
        for (_, make) in all.into_iter().filter(|(name, _)| name.contains(only)) {
            let sample = samples::ordered(make());
            if let Some(folder) = folder {
                write(folder, &sample);
            }
            repair(&sample);
            let walled = report(&sample, "", [false; 3]);
            let periodic = report(&sample, ", periodic", [true; 3]);
            println!(
                "| {}: periodic over walled | {} | | {:.2} | |",
                sample.name,
                sample.position.len(),
                periodic / walled
            );
        }
    }
}

fn report(sample: &Sample, kind: &str, periodic: [bool; 3]) -> f64 {
    let n = sample.position.len();
    let cell = Cell { periodic, ..Cell::walled(DVec3::ZERO, DVec3::ONE) };
    let mut pores = 0;
    let runs = (400_000 / n).clamp(3, 15);
    let [shortest, median] = samples::time(runs, || {
        let t = Triangulation::new(&cell, &sample.position, &sample.radius).expect("a valid sample");
        pores = t.pores.len();
    });
    let each = |t: f64| 1e6 * t / n as f64;
    println!("| {}{kind} | {n} | {pores} | {:.2} | {:.2} |", sample.name, each(shortest), each(median));
    shortest
}

/// Cost of following a strain of one percent: uniaxial compression of the box, and the same with each grain off its
/// affine path by up to half a percent of the mean distance in every direction.
fn repair(sample: &Sample) {
    let n = sample.position.len();
    let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
    let strained = Cell::walled(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.99));
    let before = Triangulation::new(&cell, &sample.position, &sample.radius).expect("a valid sample");
    let distance = (n as f64).cbrt().recip();
    for (name, off) in [("1 % strain", 0.0), ("1 % strain, 0.1 % off", 1e-3), ("1 % strain, 0.5 % off", 5e-3)]
    {
        let mut state = 1u64;
        let mut dice = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let moved = |p: &DVec3| {
            let off = DVec3::new(dice(), dice(), dice()) * (off * distance);
            (*p * strained.upper() + off).clamp(DVec3::ZERO, strained.upper())
        };
        let position: Vec<DVec3> = sample.position.iter().map(moved).collect();
        let mut report = porograin_geometry::Repair::default();
        let mut copies = vec![before.clone(); (400_000 / n).clamp(3, 15)];
        let runs = copies.len();
        let [shortest, median] = samples::time(runs, || {
            if let Some(mut t) = copies.pop() {
                report = t.repair(&strained, &position, &sample.radius).expect("a valid sample");
            }
        });
        let [new, _] = samples::time(runs, || {
            Triangulation::new(&strained, &position, &sample.radius).expect("a valid sample");
        });
        let each = |t: f64| 1e6 * t / n as f64;
        println!(
            "| repair after {name}: {report:?}, {:.2} of a rebuild | {n} | | {:.2} | {:.2} |",
            shortest / new,
            each(shortest),
            each(median)
        );
    }
}

fn write(folder: &str, sample: &Sample) {
    let mut text = format!("{}\n", sample.position.len());
    for (p, r) in sample.position.iter().zip(&sample.radius) {
        text += &format!("{:?} {:?} {:?} {r:?}\n", p.x, p.y, p.z);
    }
    let name = format!("{folder}/{}-{}.txt", sample.name.replace(' ', "-"), sample.position.len());
    std::fs::write(&name, text).expect("the folder can be written");
}
