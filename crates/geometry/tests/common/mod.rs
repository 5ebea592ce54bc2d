//! Clouds of grains and independent exact checks shared by the tests.
#![allow(dead_code)] // each test file uses its part

use glam::DVec3;
use porograin_geometry::triangulation::{FACET, NONE, Vertex, wall};
use porograin_geometry::{Cell, Triangulation};
use std::collections::{BTreeMap, BTreeSet};

pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
    /// A multiple of 2^-20 in [0, 1].
    pub fn unit(&mut self) -> f64 {
        self.below((1 << 20) + 1) as f64 / (1u64 << 20) as f64
    }
    pub fn point(&mut self) -> DVec3 {
        DVec3::new(self.unit(), self.unit(), self.unit())
    }
    pub fn shuffle(&mut self, n: usize) -> Vec<usize> {
        let mut p: Vec<usize> = (0..n).collect();
        for k in (1..n).rev() {
            p.swap(k, self.below(k as u64 + 1) as usize);
        }
        p
    }
}

/// Multiples of this length are whole numbers for the brute force.
pub const STEP: f64 = 1.0 / (1u64 << 20) as f64;

/// Determinant by Laplace expansion in 128 bits; overflow panics in the test profile.
pub fn determinant(m: &[&[i128]]) -> i128 {
    fn minor(m: &[&[i128]], row: usize, columns: u32) -> i128 {
        if row == m.len() {
            return 1;
        }
        let (mut sum, mut sign) = (0, 1);
        for c in (0..m.len()).filter(|c| columns & (1 << c) != 0) {
            if m[row][c] != 0 {
                sum += sign * m[row][c] * minor(m, row + 1, columns & !(1 << c));
            }
            sign = -sign;
        }
        sum
    }
    minor(m, 0, (1 << m.len()) - 1)
}

/// Homogeneous lifted rows `[x, y, z, |x|² - r², 1]`, of a wall `[n, 2 w·n, 0]`, relative to an origin (whole steps).
pub fn lifted(cell: &Cell, x: &[DVec3], r: &[f64], v: Vertex, origin: [i128; 3]) -> [i128; 5] {
    let whole = |c: f64| {
        let s = c / STEP;
        assert_eq!(s, s.round());
        s as i128
    };
    match wall(v) {
        None => {
            let p = x[v as usize].to_array();
            let p: Vec<i128> = (0..3).map(|k| whole(p[k]) - origin[k]).collect();
            let w = whole(r[v as usize]);
            [p[0], p[1], p[2], p[0] * p[0] + p[1] * p[1] + p[2] * p[2] - w * w, 1]
        }
        Some(face) => {
            let n = if face % 2 == 0 { -1 } else { 1 };
            let mut row = [0; 5];
            row[face / 2] = n;
            row[3] = 2 * n * (whole(cell.wall_position(face)) - origin[face / 2]);
            row
        }
    }
}

/// Orientation of four homogeneous rows, positive for a well-formed pore.
pub fn orientation(rows: [[i128; 5]; 4]) -> i128 {
    let rows = rows.map(|r| [r[0], r[1], r[2], r[4]]);
    -determinant(&[&rows[0], &rows[1], &rows[2], &rows[3]])
}

/// Checks that no sphere and no wall cuts into the power sphere of any pore: exact, against all grains.
pub fn empty_spheres(cell: &Cell, x: &[DVec3], r: &[f64], t: &Triangulation) {
    for pore in &t.pores {
        let first = x[pore[0] as usize].to_array();
        let origin = first.map(|c| (c / STEP) as i128);
        let rows = pore.map(|v| lifted(cell, x, r, v, origin));
        assert!(orientation(rows) > 0, "pore {pore:?} is not positively oriented");
        let grains = 0..x.len() as u32;
        for v in grains.chain((0..6).map(|f| porograin_geometry::triangulation::FIRST_WALL + f)) {
            if pore.contains(&v) {
                continue;
            }
            let e = lifted(cell, x, r, v, origin);
            let d = determinant(&[&rows[0], &rows[1], &rows[2], &rows[3], &e]);
            // Columns x, y, z, h, 1: negative when the query lies below the lifted hyperplane.
            assert!(d >= 0, "vertex {v} lies in the power sphere of {pore:?}");
        }
    }
}

/// Checks that the pores form a complex that covers the box once.
pub fn complex(n: usize, t: &Triangulation) {
    let mut facets: BTreeMap<[Vertex; 3], Vec<(u32, usize)>> = BTreeMap::new();
    let (mut edges, mut used) = (BTreeSet::new(), BTreeSet::new());
    for (p, pore) in (0..).zip(&t.pores) {
        for k in 0..4 {
            let mut key = FACET[k].map(|j| pore[j]);
            key.sort_unstable();
            facets.entry(key).or_default().push((p, k));
            for j in 0..k {
                edges.insert([pore[j].min(pore[k]), pore[j].max(pore[k])]);
            }
            used.insert(pore[k]);
        }
    }
    for (key, sides) in &facets {
        let walls = key.iter().filter(|v| wall(**v).is_some()).count();
        assert_eq!(sides.len(), if walls == 3 { 1 } else { 2 }, "facet {key:?}");
        for (i, &(p, k)) in sides.iter().enumerate() {
            let other = if walls == 3 { NONE } else { sides[1 - i].0 };
            assert_eq!(t.neighbours[p as usize][k], other, "facet {key:?}");
        }
    }
    if n > 0 {
        // A ball whose boundary is the octahedron of the six walls.
        let euler = used.len() as i64 - edges.len() as i64 + facets.len() as i64 - t.pores.len() as i64;
        assert_eq!(euler, 1, "Euler characteristic of a ball");
        assert_eq!(facets.values().filter(|s| s.len() == 1).count(), 8);
        assert!((0..6).all(|f| used.contains(&(porograin_geometry::triangulation::FIRST_WALL + f))));
    }
    let hidden: BTreeSet<u32> = t.hidden.iter().copied().collect();
    assert_eq!(hidden.len(), t.hidden.len());
    for g in 0..n as u32 {
        assert!(used.contains(&g) != hidden.contains(&g), "grain {g} is either used or hidden");
    }
    assert_eq!(t.pores.len(), t.neighbours.len());
    assert!(t.pores.windows(2).all(|p| p[0] < p[1]), "pores come in order");
}
