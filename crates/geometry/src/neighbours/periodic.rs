//! The near pairs of a cell that is periodic along some axes, sheared or not.

use super::{Neighbours, most};
use crate::cell::Cell;
use crate::period::Period;
use crate::triangulation::FIRST_WALL;
use glam::{DMat3, DVec3};

impl Neighbours {
    /// How far a grain or a wall has moved at most since the list was built, besides following the deformation of the lattice,
    /// and what that deformation adds to how much closer a pair may be [m].
    ///
    /// With `F` the deformation since the list was built and `u_k = x_k - F X_k` what grain k did besides, the images of
    /// a pair that were `b` apart are now `F b + u_j - u_i` apart: no closer than `(1 - |F - 1|) |b| - |u_i| - |u_j|`.
    pub(super) fn strained(
        &self,
        cell: &Cell,
        old: &Cell,
        period: &Period,
        position: &[DVec3],
    ) -> (f64, f64) {
        let change = deformation(old, cell);
        let difference = change - DMat3::IDENTITY;
        let strain = difference.to_cols_array().iter().map(|d| d * d).sum::<f64>().sqrt();
        let walls = (0..6).filter(|face| !cell.periodic[face / 2]).map(|face| {
            let moved = (cell.wall_position(face) - old.wall_position(face)).abs();
            moved + strain * cell.edges.col(face / 2).length()
        });
        let grains = most(position, &self.position, |now, then| {
            let mut moved = now - cell.origin - change * (then - old.origin);
            if moved.length_squared() > self.skin * self.skin {
                // It may have been wrapped.
                moved += period.nearest(moved);
            }
            moved.length_squared()
        });
        (walls.fold(grains.sqrt(), f64::max), strain * 0.5 * self.room())
    }

    /// Lists every pair closer than the skin; `size` is the longest distance of such a pair [m].
    pub(super) fn build_periodic(&mut self, cell: &Cell, period: &Period, size: f64) {
        let Neighbours { pairs, skin, position, radius, slices, .. } = self;
        slices.fill(cell, position, size);
        pairs.clear();
        for i in 0..position.len() {
            let (own, room, first) = (position[i], radius[i] + *skin, pairs.len());
            slices.around(own, |j| {
                if j as usize > i {
                    let branch = position[j as usize] - own;
                    let within = room + radius[j as usize];
                    if (branch + period.nearest(branch)).length_squared() < within * within {
                        pairs.push([i as u32, j]);
                    }
                }
            });
            pairs[first..].sort_unstable();
            for face in (0..6).filter(|face| !cell.periodic[face / 2]) {
                let gap = (cell.wall_position(face) - own[face / 2]).abs() - radius[i];
                if gap < *skin {
                    pairs.push([i as u32, FIRST_WALL + face as u32]);
                }
            }
        }
    }
}

/// The map of the lattice then to the lattice now; along walled axes nothing is stretched.
fn deformation(old: &Cell, new: &Cell) -> DMat3 {
    let basis = |cell: &Cell| {
        let mut edges = cell.edges;
        for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
            *edges.col_mut(axis) = DVec3::AXES[axis];
        }
        edges
    };
    if old.edges == new.edges { DMat3::IDENTITY } else { basis(new) * basis(old).inverse() }
}

/// Grains sorted into slices of the cell along its three edges, each at least as thick as a pair is long.
#[derive(Clone, Debug, Default)]
pub(super) struct Slices {
    count: [usize; 3],
    periodic: [bool; 3],
    lower: DVec3,
    /// Takes a point to its coordinates in slices.
    per_slice: DMat3,
    start: Vec<u32>,
    items: Vec<u32>,
    place: Vec<u32>,
}

impl Slices {
    fn fill(&mut self, cell: &Cell, position: &[DVec3], size: f64) {
        let inverse = cell.edges.inverse();
        let thick: [f64; 3] = std::array::from_fn(|axis| inverse.row(axis).length().recip());
        let mut size = size;
        loop {
            self.count = thick.map(|t| (t / size).clamp(1.0, 1024.0) as usize);
            // Never many more parcels than grains: a large empty cell would cost memory for nothing.
            if self.count.iter().product::<usize>() <= 2 * position.len() + 8 {
                break;
            }
            size *= 1.25;
        }
        let [nx, ny, nz] = self.count;
        self.lower = cell.origin;
        self.periodic = cell.periodic;
        self.per_slice = DMat3::from_diagonal(DVec3::new(nx as f64, ny as f64, nz as f64)) * inverse;
        let parcels = nx * ny * nz;
        self.start.clear();
        self.start.resize(parcels + 1, 0);
        self.place.clear();
        for &x in position {
            let [a, b, c] = self.slice(x);
            let place = (c * ny + b) * nx + a;
            self.place.push(place as u32);
            self.start[place + 1] += 1;
        }
        for parcel in 0..parcels {
            self.start[parcel + 1] += self.start[parcel];
        }
        self.items.clear();
        self.items.resize(position.len(), 0);
        for (k, &place) in self.place.iter().enumerate() {
            let slot = &mut self.start[place as usize];
            self.items[*slot as usize] = k as u32;
            *slot += 1;
        }
        self.start.copy_within(0..parcels, 1);
        self.start[0] = 0;
    }

    /// The slice along each edge that holds a point, or its image inside the cell.
    fn slice(&self, x: DVec3) -> [usize; 3] {
        let place = (self.per_slice * (x - self.lower)).floor();
        std::array::from_fn(|axis| {
            let (place, count) = (place[axis], self.count[axis] as f64);
            let within = if self.periodic[axis] { place - count * (place / count).floor() } else { place };
            within.clamp(0.0, count - 1.0) as usize
        })
    }

    /// Calls `visit` once with every grain of the parcels around a point.
    fn around(&self, x: DVec3, mut visit: impl FnMut(u32)) {
        let at = self.slice(x);
        // The slices next to this one along an axis, none twice.
        let near: [([usize; 3], usize); 3] = std::array::from_fn(|axis| {
            let (k, n) = (at[axis], self.count[axis]);
            match (n, self.periodic[axis]) {
                (1, _) => ([0; 3], 1),
                (2, _) => ([0, 1, 0], 2),
                (_, true) => ([(k + n - 1) % n, k, (k + 1) % n], 3),
                (_, false) if k == 0 => ([0, 1, 0], 2),
                (_, false) if k == n - 1 => ([k - 1, k, 0], 2),
                (_, false) => ([k - 1, k, k + 1], 3),
            }
        });
        for &c in &near[2].0[..near[2].1] {
            for &b in &near[1].0[..near[1].1] {
                for &a in &near[0].0[..near[0].1] {
                    let parcel = (c * self.count[1] + b) * self.count[0] + a;
                    let (from, to) = (self.start[parcel] as usize, self.start[parcel + 1] as usize);
                    self.items[from..to].iter().for_each(|&j| visit(j));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fixed sequence of numbers in [0, 1).
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    /// All pairs of images within `reach`, by trying every image; a pair found twice is listed twice.
    fn touching(cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) -> Vec<[u32; 2]> {
        let mut found = Vec::new();
        let range = |axis: usize| if cell.periodic[axis] { -2..=2 } else { 0..=0 };
        for i in 0..position.len() {
            for j in i + 1..position.len() {
                for (a, b, c) in
                    range(0).flat_map(|a| range(1).flat_map(move |b| range(2).map(move |c| (a, b, c))))
                {
                    let shift = cell.edges * DVec3::new(a as f64, b as f64, c as f64);
                    if (position[j] + shift).distance(position[i]) < radius[i] + radius[j] + reach {
                        found.push([i as u32, j as u32]);
                    }
                }
            }
            for face in (0..6).filter(|f| !cell.periodic[f / 2]) {
                if (cell.wall_position(face) - position[i][face / 2]).abs() < radius[i] + reach {
                    found.push([i as u32, FIRST_WALL + face as u32]);
                }
            }
        }
        found
    }

    fn cells() -> Vec<Cell> {
        let origin = DVec3::new(0.3, -0.2, 5.0);
        let sheared = DMat3::from_cols(
            DVec3::new(1.0, 0.0, 0.0),
            DVec3::new(0.45, 0.9, 0.0),
            DVec3::new(-0.3, 0.4, 0.8),
        );
        let flat = DMat3::from_cols(DVec3::new(0.9, 0.2, 0.0), DVec3::new(-0.3, 1.1, 0.0), 0.5 * DVec3::Z);
        let small = DMat3::from_diagonal(DVec3::new(0.27, 0.4, 0.6));
        let all = [true; 3];
        [
            (sheared, all),
            (flat, [true, true, false]),
            (small, all),
            (DMat3::IDENTITY, [false, true, false]),
            (DMat3::from_diagonal(DVec3::new(3.0, 0.3, 0.3)), [true, false, true]),
        ]
        .map(|(edges, periodic)| Cell { origin, edges, periodic })
        .to_vec()
    }

    fn cloud(cell: &Cell, n: usize, next: &mut impl FnMut() -> f64) -> (Vec<DVec3>, Vec<f64>) {
        let position =
            (0..n).map(|_| cell.origin + cell.edges * DVec3::new(next(), next(), next())).collect();
        (position, (0..n).map(|_| 0.02 + 0.04 * next()).collect())
    }

    #[test]
    fn lists_exactly_the_images_within_the_skin() {
        for (seed, cell) in cells().into_iter().enumerate() {
            let mut next = numbers(seed as u64 + 3);
            let (position, radius) = cloud(&cell, 150, &mut next);
            let mut near = Neighbours::default();
            assert!(near.refresh(&cell, &position, &radius, 0.0));
            assert!(Period::of(&cell).unwrap().height() > near.room(), "{seed}");
            assert_eq!(near.pairs, touching(&cell, &position, &radius, near.skin), "{seed}");
            assert!(!near.refresh(&cell, &position, &radius, 0.0));
        }
    }

    /// Grains wander, are wrapped, and the lattice is strained: the list is renewed in time, and not all the time.
    #[test]
    fn stays_a_superset_while_grains_move_and_the_lattice_deforms() {
        for (seed, mut cell) in cells().into_iter().enumerate() {
            let mut next = numbers(seed as u64 + 30);
            let (mut position, radius) = cloud(&cell, 100, &mut next);
            let mut near = Neighbours::default();
            let mut strain = 2e-3 * DMat3::from_cols_array(&std::array::from_fn(|_| next() - 0.4));
            for axis in 0..3 {
                if !cell.periodic[axis] {
                    *strain.col_mut(axis) = DVec3::ZERO;
                    strain.col_mut((axis + 1) % 3)[axis] = 0.0;
                    strain.col_mut((axis + 2) % 3)[axis] = 0.0;
                }
            }
            let mut rebuilt = 0;
            for _ in 0..120 {
                rebuilt += near.refresh(&cell, &position, &radius, 0.001) as u32;
                let gap = near.gaps();
                for pair in touching(&cell, &position, &radius, 0.001) {
                    assert!(near.pairs.binary_search(&pair).is_ok(), "{seed} {pair:?}");
                    assert!(gap(pair) < 0.001 + near.closer(), "{seed} {pair:?}");
                }
                drop(gap);
                cell.edges = cell.edges + strain * cell.edges;
                for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
                    cell.origin[axis] -= 1e-4;
                }
                let period = Period::of(&cell).unwrap();
                for x in &mut position {
                    *x += strain * (*x - cell.origin) + 5e-4 * (DVec3::new(next(), next(), next()) - 0.5);
                    *x -= period.shift(period.beyond(*x));
                }
            }
            assert!((4..40).contains(&rebuilt), "{seed} {rebuilt}");
        }
    }
}
