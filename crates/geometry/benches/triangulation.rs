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

fn write(folder: &str, sample: &Sample) {
    let mut text = format!("{}\n", sample.position.len());
    for (p, r) in sample.position.iter().zip(&sample.radius) {
        text += &format!("{:?} {:?} {:?} {r:?}\n", p.x, p.y, p.z);
    }
    let name = format!("{folder}/{}-{}.txt", sample.name.replace(' ', "-"), sample.position.len());
    std::fs::write(&name, text).expect("the folder can be written");
}
