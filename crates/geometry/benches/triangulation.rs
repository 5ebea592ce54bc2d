//! Costs of the geometry per grain, against its aims: triangulation, periodic cells, repair, throat geometry, memory, threads.
//!
//! `cargo bench -p porograin-geometry --bench triangulation -- [SIZE …] [--only NAME] [--cgal] [--write FOLDER | --read FOLDER]`
//!
//! Times are processor times of one thread but for the speed-ups of two. `--cgal` compiles and runs CGAL's triangulation on the same
//! points (Debian: g++, libcgal-dev). `--write` leaves each sample as text (`n`, then `x y z r` lines), `--read` takes it from
//! there (a million grains take a minute to make).

mod cgal;
mod heap;
mod samples;

use cgal::Cgal;
use glam::DVec3;
use porograin_geometry::throat::{Packing, Throat, pore_volume, radical_centres, shapes, throats};
use porograin_geometry::{Cell, Repair, Triangulation};
use rayon::prelude::*;
use samples::{BODY, FACE, SIMPLE, Sample};
use std::time::Instant;

#[global_allocator]
static HEAP: heap::Counting = heap::Counting;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut sizes: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![32_000];
    }
    let option = |name: &str| arguments.iter().position(|a| a == name).and_then(|k| arguments.get(k + 1));
    let cgal = arguments.iter().any(|a| a == "--cgal").then(Cgal::new);
    let only = option("--only").map_or("", String::as_str);
    println!("| sample | grains | quantity | shortest | median | aim |");
    println!("|---|---|---|---|---|---|");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    let two = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("two threads");
    for &n in &sizes {
        let side = |basis: &[[f64; 3]]| (n as f64 / basis.len() as f64).cbrt().round() as usize;
        let all: [(&str, &dyn Fn() -> Sample); 5] = [
            ("random ±20 %", &|| samples::random(n, 0.2)),
            ("random ±0 %", &|| samples::random(n, 0.0)),
            ("simple cubic", &|| samples::lattice(side(SIMPLE), SIMPLE)),
            ("body-centred", &|| samples::lattice(side(BODY), BODY)),
            ("face-centred", &|| samples::lattice(side(FACE), FACE)),
        ];
        for (name, make) in all.into_iter().filter(|(name, _)| name.contains(only)) {
            let sample = match option("--read") {
                Some(folder) => samples::read(folder, name, n).unwrap_or_else(|| samples::ordered(make())),
                None => samples::ordered(make()),
            };
            if let Some(folder) = option("--write") {
                samples::write(folder, name, n, &sample);
            }
            let bench =
                Bench { name, sample: &sample, random: name.starts_with("random"), cgal: cgal.as_ref() };
            // In a pool of one thread, so that whatever could run on two does not.
            one.install(|| {
                bench.triangulation();
                bench.repair();
                bench.throats();
                bench.memory();
            });
            bench.threads(&one, &two);
        }
    }
}

struct Bench<'a> {
    name: &'a str,
    sample: &'a Sample,
    random: bool,
    cgal: Option<&'a Cgal>,
}

impl Bench<'_> {
    fn cell(&self, periodic: [bool; 3]) -> Cell {
        Cell { periodic, ..Cell::walled(DVec3::ZERO, DVec3::ONE) }
    }

    fn runs(&self) -> usize {
        (400_000 / self.sample.position.len()).clamp(3, 15)
    }

    fn line(&self, quantity: &str, [shortest, median]: [f64; 2], aim: &str) {
        println!(
            "| {} | {} | {quantity} | {shortest:.2} | {median:.2} | {aim} |",
            self.name,
            self.sample.position.len()
        );
    }

    /// Microseconds per grain.
    fn each(&self, times: [f64; 2]) -> [f64; 2] {
        times.map(|t| 1e6 * t / self.sample.position.len() as f64)
    }

    fn triangulate(&self, periodic: [bool; 3]) -> Triangulation {
        Triangulation::new(&self.cell(periodic), &self.sample.position, &self.sample.radius)
            .expect("a valid sample")
    }

    fn triangulation(&self) {
        let pair = samples::time_both(
            self.runs(),
            || drop(self.triangulate([false; 3])),
            || drop(self.triangulate([true; 3])),
        );
        let aim = match (self.random, self.sample.position.len()) {
            (true, ..100_000) => "3",
            (true, _) => "4",
            (false, _) => "12",
        };
        self.line("triangulation, µs per grain", self.each(pair[0]), aim);
        if let Some(cgal) = self.cgal {
            let (ours, theirs) = (self.each(pair[0]), cgal.time(self.name, self.sample));
            self.line("CGAL on the same points, µs per grain", theirs, "");
            self.line("this crate over CGAL", [0, 1].map(|k| ours[k] / theirs[k]), "1");
        }
        self.line("the same periodic, µs per grain", self.each(pair[1]), "");
        self.line("periodic over walled", [0, 1].map(|k| pair[1][k] / pair[0][k]), "1.3");
    }

    /// Cost of following a strain of one percent: uniaxial compression of the box, and the same with each grain off its
    /// affine path by up to half a percent of the mean distance in every direction.
    fn repair(&self) {
        let n = self.sample.position.len();
        let strained = Cell::walled(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.99));
        let before = self.triangulate([false; 3]);
        let distance = (n as f64).cbrt().recip();
        for (name, off) in [("1 %", 0.0), ("1 %, 0.1 % off", 1e-3), ("1 %, 0.5 % off", 5e-3)] {
            let mut dice = samples::dice(1);
            let mut dice = || 2.0 * dice() - 1.0;
            let moved = |p: &DVec3| {
                let off = DVec3::new(dice(), dice(), dice()) * (off * distance);
                (*p * strained.upper() + off).clamp(DVec3::ZERO, strained.upper())
            };
            let position: Vec<DVec3> = self.sample.position.iter().map(moved).collect();
            let radius = &self.sample.radius;
            let mut report = Repair::default();
            let mut copies = vec![before.clone(); self.runs()];
            let pair = samples::time_both(
                self.runs(),
                || {
                    if let Some(mut t) = copies.pop() {
                        report = t.repair(&strained, &position, radius).expect("a valid sample");
                    }
                },
                || drop(Triangulation::new(&strained, &position, radius).expect("a valid sample")),
            );
            let what = if report.rebuilt { "rebuilt".into() } else { format!("{} flips", report.flips) };
            self.line(&format!("repair after {name} ({what}), µs per grain"), self.each(pair[0]), "");
            self.line("repair over rebuild", [0, 1].map(|k| pair[0][k] / pair[1][k]), "0.33");
        }
    }

    fn throats(&self) {
        let cell = self.cell([false; 3]);
        let packing = self.packing(&cell);
        let mesh = self.triangulate([false; 3]);
        let times = samples::time(self.runs(), || drop(measured(packing, &mesh)));
        self.line("throats, void, surfaces, areas, pore volumes, µs per grain", self.each(times), "3");
    }

    fn packing<'b>(&'b self, cell: &'b Cell) -> Packing<'b> {
        Packing { cell, position: &self.sample.position, radius: &self.sample.radius }
    }

    fn memory(&self) {
        let cell = self.cell([false; 3]);
        let n = self.sample.position.len() as f64;
        let before = heap::restart();
        let mesh = self.triangulate([false; 3]);
        let each = |bytes: usize| (bytes - before) as f64 / n;
        self.line(
            "bytes per grain while triangulating, then kept",
            [heap::most(), heap::now()].map(each),
            "",
        );
        let all = measured(self.packing(&cell), &mesh);
        let both = [heap::most(), heap::now()].map(each);
        self.line("bytes per grain in all, with throat geometry; kept", both, "1500");
        drop(all);
    }

    /// Wall times of one and two threads, alternating, with a loop that shares nothing as a yardstick.
    fn threads(&self, one: &rayon::ThreadPool, two: &rayon::ThreadPool) {
        let cell = self.cell([false; 3]);
        let packing = self.packing(&cell);
        let mesh = self.triangulate([false; 3]);
        let loops = 64 * self.sample.position.len();
        let ideal = || {
            let angle = |k: usize| (k as f64).atan2(1e6);
            (0..loops).into_par_iter().with_min_len(4096).map(angle).sum::<f64>()
        };
        let speed_up = |work: &(dyn Fn() + Sync)| {
            let wall = |pool: &rayon::ThreadPool| {
                let start = Instant::now();
                pool.install(work);
                start.elapsed().as_secs_f64()
            };
            let mut times = [Vec::new(), Vec::new()];
            for _ in 0..self.runs() {
                times[0].push(wall(one));
                times[1].push(wall(two));
            }
            times.iter_mut().for_each(|t| t.sort_by(f64::total_cmp));
            [0, times[0].len() / 2].map(|k| times[0][k] / times[1][k])
        };
        let ideal = speed_up(&|| {
            std::hint::black_box(ideal());
        });
        let all = [
            ("triangulation", speed_up(&|| drop(self.triangulate([false; 3])))),
            ("throat geometry", speed_up(&|| drop(measured(packing, &mesh)))),
        ];
        self.line("two threads: speed-up of a loop that shares nothing", ideal, "");
        for (name, speed_up) in all {
            self.line(&format!("two threads: speed-up of the {name}"), speed_up, "");
            let aim = if name == "throat geometry" { "0.85" } else { "" };
            self.line("of that of the loop", [0, 1].map(|k| speed_up[k] / ideal[k]), aim);
        }
    }
}

/// What a flow model keeps of a throat: area, area of the fluid, void volume, wetted surfaces.
type Kept = ([f64; 3], [f64; 3]);

fn measured(packing: Packing, mesh: &Triangulation) -> (Vec<Throat>, Vec<Kept>, Vec<f64>) {
    let centres = radical_centres(packing, mesh);
    let throats = throats(mesh);
    let kept = shapes(packing, mesh, &centres, &throats, |_, s| ([s.area, s.fluid_area, s.void], s.surface));
    let volumes = (0..mesh.pores.len()).into_par_iter().with_min_len(256);
    (throats, kept, volumes.map(|pore| pore_volume(packing, mesh, pore)).collect())
}
