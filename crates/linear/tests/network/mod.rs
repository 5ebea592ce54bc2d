//! Matrices like those of pore networks, without a triangulation: nodes thrown at random, about four neighbours each
//! among the nearest, log-normal conductances over 2.4 decades, a few outliers.

use glam::DVec3;
use porograin_linear::FIXED;

pub struct Network {
    pub positions: Vec<DVec3>,
    pub ends: Vec<[u32; 2]>,
    pub conductance: Vec<f64>,
    pub extra: Vec<f64>,
}

/// A 64-bit permuted congruence; the tests need the same numbers everywhere, not good ones.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58476d1ce4e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d049bb133111eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A diamond lattice (four neighbours each) of about `count` nodes in a cube, numbered along it in blocks, with a tenth of its
/// throats rewired to a second-nearest node; the bottom and the top are held.
pub fn network(count: usize, seed: u64) -> Network {
    let mut random = Random(seed);
    let side = ((count as f64 / 8.0).cbrt().round() as usize).max(1);
    let cell = [[0, 0, 0], [0, 2, 2], [2, 0, 2], [2, 2, 0], [1, 1, 1], [1, 3, 3], [3, 1, 3], [3, 3, 1]];
    let period = 4 * side as i64;
    let number = |p: [i64; 3]| -> u32 {
        let block = p.map(|c| c / 4);
        let place = cell.iter().position(|s| (0..3).all(|k| s[k] == p[k] % 4)).unwrap();
        (((block[2] * side as i64 + block[1]) * side as i64 + block[0]) * 8 + place as i64) as u32
    };
    let steps = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]];
    let nodes = 8 * side * side * side;
    let mut positions = vec![DVec3::ZERO; nodes];
    let mut ends = Vec::new();
    let mut conductance = Vec::new();
    for block in 0..side * side * side {
        let corner = [block % side, block / side % side, block / side / side];
        for (s, site) in cell.iter().enumerate() {
            let p: [i64; 3] = std::array::from_fn(|k| 4 * corner[k] as i64 + site[k]);
            let i = number(p);
            positions[i as usize] = DVec3::from_array(p.map(|c| c as f64 + 0.8 * (random.uniform() - 0.5)));
            for step in steps {
                // From the sites of the first sublattice forwards; the second one's steps are their opposites.
                if s >= 4 {
                    continue;
                }
                let mut q: [i64; 3] = std::array::from_fn(|k| p[k] + step[k]);
                if random.uniform() < 0.1 {
                    q = std::array::from_fn(|k| q[k] + 2 * step[(k + 1) % 3].signum() * i64::from(k != 0));
                }
                let outside = (0..3).find(|&k| q[k] < 0 || q[k] >= period);
                let j = match outside {
                    None => number(q),
                    Some(2) => FIXED,
                    Some(_) => continue,
                };
                ends.push([i, j]);
                let outlier = if random.uniform() < 3e-4 { 1e5 } else { 1.0 };
                conductance.push(1e-9 * outlier * (0.9 * random.normal()).exp());
            }
        }
    }
    // A node the rewiring left alone hangs on its neighbour in number.
    let mut seen = vec![false; nodes];
    for pair in &ends {
        for &i in pair {
            if i != FIXED {
                seen[i as usize] = true;
            }
        }
    }
    for i in (0..nodes).filter(|&i| !seen[i]) {
        ends.push([i as u32, if i > 0 { i as u32 - 1 } else { FIXED }]);
        conductance.push(1e-9);
    }
    Network { positions, ends, conductance, extra: vec![1e-14; nodes] }
}
