//! Samples for the benches: dense random packings by overlap removal, lattices.
#![allow(dead_code)] // each bench uses its part

use glam::DVec3;

/// Positions in the unit box (or the unit period) and radii.
pub struct Sample {
    pub name: String,
    pub position: Vec<DVec3>,
    pub radius: Vec<f64>,
}

fn dice(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// About `n` grains of radii `1 ± spread` at a solid fraction of 0.6, overlaps pushed apart 40 times; periodic.
pub fn random(n: usize, spread: f64) -> Sample {
    let mut state = 5;
    let mut position: Vec<DVec3> =
        (0..n).map(|_| DVec3::new(dice(&mut state), dice(&mut state), dice(&mut state))).collect();
    let mut radius: Vec<f64> = (0..n).map(|_| 1.0 + spread * (2.0 * dice(&mut state) - 1.0)).collect();
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
    Sample { name: format!("random ±{:.0} %", spread * 100.0), position, radius }
}

/// A lattice of `m³` cubes with the given basis, equal radii.
pub fn lattice(name: &str, m: usize, basis: &[[f64; 3]]) -> Sample {
    let mut position = Vec::new();
    for (k, j, i) in
        (0..m).flat_map(|k| (0..m).flat_map(move |j| (0..m).map(move |i| (k as f64, j as f64, i as f64))))
    {
        for b in basis {
            position.push(DVec3::new(i + b[0] + 0.25, j + b[1] + 0.25, k + b[2] + 0.25) / m as f64);
        }
    }
    let radius = vec![0.25 / m as f64; position.len()];
    Sample { name: name.into(), position, radius }
}

pub const SIMPLE: &[[f64; 3]] = &[[0.0; 3]];
pub const BODY: &[[f64; 3]] = &[[0.0; 3], [0.5; 3]];
pub const FACE: &[[f64; 3]] = &[[0.0; 3], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]];

/// The same grains along the Hilbert curve, as a simulation keeps them.
pub fn ordered(sample: Sample) -> Sample {
    let cell = porograin_geometry::Cell::walled(DVec3::ZERO, DVec3::ONE);
    let order = porograin_geometry::order::hilbert(&cell, &sample.position);
    Sample {
        name: sample.name,
        position: order.iter().map(|&i| sample.position[i as usize]).collect(),
        radius: order.iter().map(|&i| sample.radius[i as usize]).collect(),
    }
}

/// Processor time of this thread [s]; wall time where the system does not tell.
pub fn processor_time() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = stat.and_then(|s| s.split(' ').next().and_then(|t| t.parse::<f64>().ok()));
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    nanoseconds
        .map_or_else(|| START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64(), |t| t * 1e-9)
}

/// Shortest and median processor time of `runs` calls [s].
pub fn time(runs: usize, mut work: impl FnMut()) -> [f64; 2] {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = processor_time();
            work();
            processor_time() - start
        })
        .collect();
    times.sort_by(f64::total_cmp);
    [times[0], times[runs / 2]]
}
