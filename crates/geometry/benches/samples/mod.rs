//! Samples for the benches: dense random packings by overlap removal, lattices.

use glam::DVec3;

/// Positions in the unit box (or the unit period) and radii.
pub struct Sample {
    pub position: Vec<DVec3>,
    pub radius: Vec<f64>,
}

/// Numbers in [0, 1).
pub fn dice(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// About `n` grains of radii `1 ± spread` at a solid fraction of 0.6, overlaps pushed apart 40 times; periodic.
pub fn random(n: usize, spread: f64) -> Sample {
    let mut dice = dice(5);
    let mut position: Vec<DVec3> = (0..n).map(|_| DVec3::new(dice(), dice(), dice())).collect();
    let mut radius: Vec<f64> = (0..n).map(|_| 1.0 + spread * (2.0 * dice() - 1.0)).collect();
    let solid: f64 = radius.iter().map(|r| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3)).sum();
    let scale = (0.6 / solid).cbrt();
    radius.iter_mut().for_each(|r| *r *= scale);
    let largest = radius.iter().copied().fold(0.0, f64::max);
    let m = ((1.0 / (2.0 * largest)) as usize).max(1);
    let sweeps = if m < 3 { 0 } else { 40 };
    let bin = |p: DVec3| (p * m as f64).to_array().map(|c| (c as usize).min(m - 1));
    for _ in 0..sweeps {
        // Sort into bins of one diameter.
        let cell = |p: DVec3| {
            let [i, j, k] = bin(p);
            (k * m + j) * m + i
        };
        let mut start = vec![0u32; m * m * m + 1];
        position.iter().for_each(|&p| start[cell(p) + 1] += 1);
        (0..m * m * m).for_each(|c| start[c + 1] += start[c]);
        let mut next = start.clone();
        let mut order = vec![0u32; n];
        for (i, &p) in position.iter().enumerate() {
            let c = cell(p);
            order[next[c] as usize] = i as u32;
            next[c] += 1;
        }
        // Grains in bin order: neighbours stay close in memory.
        position = order.iter().map(|&i| position[i as usize]).collect();
        radius = order.iter().map(|&i| radius[i as usize]).collect();
        let mut push = vec![DVec3::ZERO; n];
        for a in 0..n {
            let [i, j, k] = bin(position[a]);
            for c in 0..27 {
                let wrap = |q: usize, s: usize| (q + s + m - 1) % m;
                let b = (wrap(k, c / 9) * m + wrap(j, c / 3 % 3)) * m + wrap(i, c % 3);
                for b in start[b] as usize..start[b + 1] as usize {
                    let mut d = position[a] - position[b];
                    d -= d.round();
                    let (gap, length) = (radius[a] + radius[b], d.length());
                    if b != a && length < gap && length > 0.0 {
                        push[a] += d * (0.4 * (gap - length) / length);
                    }
                }
            }
        }
        for (p, d) in position.iter_mut().zip(&push) {
            *p += *d;
            *p -= p.floor();
        }
    }
    Sample { position, radius }
}

/// A lattice of `m³` cubes with the given basis, equal radii.
pub fn lattice(m: usize, basis: &[[f64; 3]]) -> Sample {
    let mut position = Vec::new();
    for (k, j, i) in
        (0..m).flat_map(|k| (0..m).flat_map(move |j| (0..m).map(move |i| (k as f64, j as f64, i as f64))))
    {
        for b in basis {
            position.push(DVec3::new(i + b[0] + 0.25, j + b[1] + 0.25, k + b[2] + 0.25) / m as f64);
        }
    }
    let radius = vec![0.25 / m as f64; position.len()];
    Sample { position, radius }
}

pub const SIMPLE: &[[f64; 3]] = &[[0.0; 3]];
pub const BODY: &[[f64; 3]] = &[[0.0; 3], [0.5; 3]];
pub const FACE: &[[f64; 3]] = &[[0.0; 3], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]];

/// The same grains along the Hilbert curve, as a simulation keeps them.
pub fn ordered(sample: Sample) -> Sample {
    let cell = porograin_geometry::Cell::walled(DVec3::ZERO, DVec3::ONE);
    let order = porograin_geometry::order::hilbert(&cell, &sample.position);
    Sample {
        position: order.iter().map(|&i| sample.position[i as usize]).collect(),
        radius: order.iter().map(|&i| sample.radius[i as usize]).collect(),
    }
}

/// Processor time of this thread [s].
#[cfg(target_os = "linux")]
pub fn processor_time() -> f64 {
    unsafe extern "C" {
        fn clock_gettime(clock: i32, time: *mut [i64; 2]) -> i32;
    }
    const THREAD: i32 = 3; // CLOCK_THREAD_CPUTIME_ID; /proc/thread-self/schedstat moves by ticks of 4 ms only
    let mut time = [0; 2];
    // SAFETY: a timespec is two 64-bit numbers on 64-bit Linux.
    unsafe { clock_gettime(THREAD, &mut time) };
    time[0] as f64 + 1e-9 * time[1] as f64
}

/// Wall time [s].
#[cfg(not(target_os = "linux"))]
pub fn processor_time() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// Processor time of a call [s].
fn once(work: &mut dyn FnMut()) -> f64 {
    let start = processor_time();
    work();
    processor_time() - start
}

fn shortest_and_median(mut times: Vec<f64>) -> [f64; 2] {
    times.sort_by(f64::total_cmp);
    [times[0], times[times.len() / 2]]
}

/// Shortest and median processor time of `runs` calls [s].
pub fn time(runs: usize, mut work: impl FnMut()) -> [f64; 2] {
    shortest_and_median((0..runs).map(|_| once(&mut work)).collect())
}

/// The same for two kinds of work, run in turns so that both see the same machine.
pub fn time_both(runs: usize, mut first: impl FnMut(), mut second: impl FnMut()) -> [[f64; 2]; 2] {
    let (one, two) = (0..runs).map(|_| (once(&mut first), once(&mut second))).unzip();
    [shortest_and_median(one), shortest_and_median(two)]
}

/// Where a sample is written.
pub fn file(folder: &str, name: &str, n: usize) -> String {
    format!("{folder}/{}-{n}.txt", name.replace(' ', "-"))
}

/// Writes a sample as text for others to read.
pub fn write(folder: &str, name: &str, n: usize, sample: &Sample) {
    let mut text = format!("{}\n", sample.position.len());
    for (p, r) in sample.position.iter().zip(&sample.radius) {
        text += &format!("{:?} {:?} {:?} {r:?}\n", p.x, p.y, p.z);
    }
    std::fs::write(file(folder, name, n), text).expect("the folder can be written");
}

/// A sample written before, if there is one.
pub fn read(folder: &str, name: &str, n: usize) -> Option<Sample> {
    let text = std::fs::read_to_string(file(folder, name, n)).ok()?;
    let numbers: Vec<f64> = text.split_whitespace().skip(1).filter_map(|c| c.parse().ok()).collect();
    let (lines, _) = numbers.as_chunks::<4>();
    Some(Sample {
        position: lines.iter().map(|l| DVec3::new(l[0], l[1], l[2])).collect(),
        radius: lines.iter().map(|l| l[3]).collect(),
    })
}
