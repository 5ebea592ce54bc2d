//! Who is near whom: pairs of grains, and of grains and walls, closer than a skin.

mod periodic;

use crate::cell::Cell;
use crate::period::Period;
use crate::triangulation::{FIRST_WALL, wall};
use glam::{DVec3, IVec3};
use rayon::prelude::*;

/// Part of the mean radius by which a pair may be apart and still be listed, unless set otherwise.
const SKIN: f64 = 0.15;
/// Round-off of places in terms of the skin: far above that of the coordinates of any sample that fits into memory.
const ROUND_OFF: f64 = 1e-6;
/// Grains handed to a thread at once.
const CHUNK: usize = 8192;

/// The near pairs: every pair whose surfaces are closer than the skin, and none twice.
///
/// The list is a superset of the touching pairs and stays one until some surface has moved by half the skin; only
/// then is it built anew, by a cell list, in time linear in the number of grains. How large the skin is and when the
/// list was built are therefore of no consequence for what is computed from the touching pairs.
///
/// Where the cell is periodic a pair stands for a grain and the nearest image of the other. That is all there is as long
/// as the lattice planes are further apart than [`room`](Self::room) says.
#[derive(Clone, Debug, Default)]
pub struct Neighbours {
    /// Pairs `(i, j)`, `i < j`, or `(i, FIRST_WALL + face)`, sorted.
    pub pairs: Vec<[u32; 2]>,
    /// Largest gap of a listed pair when the list was built [m].
    skin: f64,
    /// See [`closer`](Self::closer) [m].
    closer: f64,
    /// Centres, radii and box when the list was built.
    position: Vec<DVec3>,
    radius: Vec<f64>,
    cell: Option<Cell>,
    grid: Grid,
    /// The grains in the slices of a periodic cell.
    slices: periodic::Slices,
}

impl Neighbours {
    /// Makes the list valid for these grains, building it anew only if it has to be; returns whether it was.
    ///
    /// `position` and `radius` [m] hold one entry per grain, `reach` [m] is the gap up to which a law acts.
    pub fn refresh(&mut self, cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) -> bool {
        self.closer = self.approached(cell, position, radius);
        if self.closer <= self.skin - reach {
            return false;
        }
        self.build(cell, position, radius, reach);
        self.closer = 0.0;
        true
    }

    /// The least distance of the lattice planes of a periodic cell for pairs with the nearest image to be all there are:
    /// twice the longest distance of a listed pair [m].
    pub fn room(&self) -> f64 {
        let largest = self.radius.iter().fold(0.0, |a: f64, &r| a.max(r));
        2.0 * (2.0 * largest + self.skin)
    }

    /// Largest gap of a listed pair when the list was built [m]; a law that reaches as far as `reach` lets grains move by half
    /// the rest before the next is built.
    pub fn skin(&self) -> f64 {
        self.skin
    }

    /// How much closer the surfaces of any pair may be now than when the list was built [m].
    pub fn closer(&self) -> f64 {
        self.closer
    }

    /// The gap of a listed pair when the list was built [m].
    pub fn gaps(&self) -> impl Fn([u32; 2]) -> f64 + '_ {
        let period = self.cell.as_ref().and_then(Period::of);
        move |[i, j]| {
            let (i, j) = (i as usize, j as usize);
            match (wall(j as u32), &self.cell) {
                (Some(face), Some(cell)) => {
                    (cell.wall_position(face) - self.position[i][face / 2]).abs() - self.radius[i]
                }
                _ => {
                    let branch = self.position[j] - self.position[i];
                    let shift = period.as_ref().map_or(DVec3::ZERO, |period| period.nearest(branch));
                    (branch + shift).length() - self.radius[i] - self.radius[j]
                }
            }
        }
    }

    /// How much closer the surfaces of any pair may have come since the list was built [m]; without a list of these grains
    /// there is no telling.
    fn approached(&self, cell: &Cell, position: &[DVec3], radius: &[f64]) -> f64 {
        let Some(old) = &self.cell else { return f64::INFINITY };
        if position.len() != self.position.len() || cell.periodic != old.periodic {
            return f64::INFINITY;
        }
        let grown = most(radius, &self.radius, |now, then| now - then);
        let (moved, strained) = match Period::of(cell) {
            Some(period) => self.strained(cell, old, &period, position),
            None => {
                let lower = (cell.origin - old.origin).abs().max_element();
                let upper = (cell.upper() - old.upper()).abs().max_element();
                let moved = most(position, &self.position, |now, then| (now - then).length_squared()).sqrt();
                (moved.max(lower).max(upper), 0.0)
            }
        };
        2.0 * (moved + grown) + strained + ROUND_OFF * self.skin
    }

    fn build(&mut self, cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) {
        let n = position.len();
        let mean = radius.iter().sum::<f64>() / n.max(1) as f64;
        let largest = radius.iter().fold(0.0, |a: f64, &r| a.max(r));
        self.skin = SKIN * mean + reach;
        self.cell = Some(*cell);
        self.position.clear();
        self.position.extend_from_slice(position);
        self.radius.clear();
        self.radius.extend_from_slice(radius);
        if let Some(period) = Period::of(cell) {
            return self.build_periodic(cell, &period, 2.0 * largest + self.skin);
        }
        self.grid.fill(cell, position, 2.0 * largest + self.skin);

        self.pairs.clear();
        let mut near: Vec<u32> = Vec::new();
        for i in 0..n {
            let (own, room) = (position[i], radius[i] + self.skin);
            let mut count = 0;
            for run in self.grid.around(own) {
                if near.len() < count + run.len() {
                    near.resize(2 * (count + run.len()), 0);
                }
                // No branch: whether a grain is near is anybody's guess, and every second guess would be wrong.
                for &j in run {
                    let within = room + radius[j as usize];
                    let listed = (position[j as usize] - own).length_squared() < within * within;
                    near[count] = j;
                    count += usize::from(listed & (j as usize > i));
                }
            }
            near[..count].sort_unstable();
            self.pairs.extend(near[..count].iter().map(|&j| [i as u32, j]));
            for face in 0..6 {
                if !cell.periodic[face / 2] {
                    let gap = (cell.wall_position(face) - own[face / 2]).abs() - radius[i];
                    // A grain whose centre passed through the wall is found as well.
                    if gap < self.skin {
                        self.pairs.push([i as u32, FIRST_WALL + face as u32]);
                    }
                }
            }
        }
    }
}

/// The largest of `of(now, then)`, or zero; what is not a number counts for nothing.
fn most<T: Copy + Sync>(now: &[T], then: &[T], of: impl Fn(T, T) -> f64 + Sync) -> f64 {
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let chunk = |(now, then): (&[T], &[T])| {
        // Four at a time, so that no comparison waits for the one before.
        let ((fours, rest), (olds, old)) = (now.as_chunks::<4>(), then.as_chunks::<4>());
        let mut most = [0.0; 4];
        for (now, then) in fours.iter().zip(olds) {
            for lane in 0..4 {
                most[lane] = larger(most[lane], of(now[lane], then[lane]));
            }
        }
        let rest = rest.iter().zip(old).map(|(&now, &then)| of(now, then));
        rest.chain(most).fold(0.0, larger)
    };
    now.par_chunks(CHUNK).zip(then.par_chunks(CHUNK)).map(chunk).reduce(|| 0.0, larger)
}

/// Grains sorted into cubes at least as large as the longest distance of a near pair.
///
/// `items` repeats no grain; [`around`](Grid::around) walks the 27 cubes about a point.
#[derive(Clone, Debug, Default)]
struct Grid {
    lower: DVec3,
    per_length: DVec3,
    count: IVec3,
    start: Vec<u32>,
    items: Vec<u32>,
    cube: Vec<u32>,
}

impl Grid {
    /// Sorts the grains into cubes of at least `size` [m].
    fn fill(&mut self, cell: &Cell, position: &[DVec3], size: f64) {
        let extent = cell.upper() - cell.origin;
        self.lower = cell.origin;
        let mut size = size.max(1e-6 * extent.max_element());
        loop {
            self.count = (extent / size).floor().as_ivec3().clamp(IVec3::ONE, IVec3::splat(1 << 20));
            // Never many more cubes than grains: a large empty box would cost memory for nothing.
            if self.count.as_dvec3().element_product() <= 2.0 * position.len() as f64 + 8.0 {
                break;
            }
            size *= 1.25;
        }
        self.per_length = self.count.as_dvec3() / extent;

        let cubes = (self.count.x * self.count.y * self.count.z) as usize;
        self.start.clear();
        self.start.resize(cubes + 1, 0);
        self.cube.clear();
        for &x in position {
            let cube = self.index(self.place(x));
            self.cube.push(cube as u32);
            self.start[cube + 1] += 1;
        }
        for cube in 0..cubes {
            self.start[cube + 1] += self.start[cube];
        }
        self.items.clear();
        self.items.resize(position.len(), 0);
        // Filling from the back leaves `start` where each cube begins once all are placed.
        for (k, &cube) in self.cube.iter().enumerate() {
            let slot = &mut self.start[cube as usize];
            self.items[*slot as usize] = k as u32;
            *slot += 1;
        }
        self.start.copy_within(0..cubes, 1);
        self.start[0] = 0;
    }

    #[inline]
    fn place(&self, x: DVec3) -> IVec3 {
        ((x - self.lower) * self.per_length).floor().as_ivec3().clamp(IVec3::ZERO, self.count - 1)
    }

    #[inline]
    fn index(&self, place: IVec3) -> usize {
        ((place.z * self.count.y + place.y) * self.count.x + place.x) as usize
    }

    /// The grains of the 27 cubes around a point. Three cubes in a row along x are one run of `items`.
    #[inline]
    fn around(&self, x: DVec3) -> impl Iterator<Item = &[u32]> {
        let low = (self.place(x) - 1).max(IVec3::ZERO);
        let high = (self.place(x) + 1).min(self.count - 1);
        (low.z..=high.z).flat_map(move |z| {
            (low.y..=high.y).map(move |y| {
                let from = self.start[self.index(IVec3::new(low.x, y, z))] as usize;
                let to = self.start[self.index(IVec3::new(high.x, y, z)) + 1] as usize;
                &self.items[from..to]
            })
        })
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

    fn cloud(n: usize, box_size: DVec3, seed: u64) -> (Vec<DVec3>, Vec<f64>) {
        let mut next = numbers(seed);
        let position = (0..n).map(|_| DVec3::new(next(), next(), next()) * box_size).collect();
        (position, (0..n).map(|_| 0.02 + 0.04 * next()).collect())
    }

    fn touching(cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) -> Vec<[u32; 2]> {
        let mut found = Vec::new();
        for i in 0..position.len() {
            for j in i + 1..position.len() {
                if position[i].distance(position[j]) < radius[i] + radius[j] + reach {
                    found.push([i as u32, j as u32]);
                }
            }
            for face in 0..6 {
                if (cell.wall_position(face) - position[i][face / 2]).abs() < radius[i] + reach {
                    found.push([i as u32, FIRST_WALL + face as u32]);
                }
            }
        }
        found
    }

    fn gap(cell: &Cell, position: &[DVec3], radius: &[f64], [i, j]: [u32; 2]) -> f64 {
        let i = i as usize;
        match wall(j) {
            Some(face) => (cell.wall_position(face) - position[i][face / 2]).abs() - radius[i],
            None => position[i].distance(position[j as usize]) - radius[i] - radius[j as usize],
        }
    }

    #[test]
    fn lists_exactly_the_pairs_within_the_skin_sorted() {
        for (seed, size) in
            [DVec3::ONE, DVec3::new(2.0, 0.11, 0.7), DVec3::splat(40.0)].into_iter().enumerate()
        {
            let (position, radius) = cloud(400, size, 1 + seed as u64);
            let cell = Cell::walled(DVec3::ZERO, size);
            let mut near = Neighbours::default();
            assert!(near.refresh(&cell, &position, &radius, 0.0));
            assert_eq!(near.pairs, touching(&cell, &position, &radius, near.skin));
            assert!(!near.refresh(&cell, &position, &radius, 0.0));
        }
    }

    #[test]
    fn stays_a_superset_while_grains_walls_and_radii_change() {
        let (mut position, mut radius) = cloud(300, DVec3::ONE, 5);
        let mut cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let mut near = Neighbours::default();
        let (mut next, mut rebuilt) = (numbers(9), 0);
        for _ in 0..200 {
            rebuilt += near.refresh(&cell, &position, &radius, 0.001) as u32;
            for pair in touching(&cell, &position, &radius, 0.001) {
                assert!(near.pairs.binary_search(&pair).is_ok(), "{pair:?}");
            }
            for (x, r) in position.iter_mut().zip(&mut radius) {
                *x += (DVec3::new(next(), next(), next()) - 0.5) * 0.002;
                *r *= 1.0 + 1e-3 * next();
            }
            cell = Cell::walled(cell.origin + DVec3::splat(1e-4), cell.upper() - DVec3::splat(1e-4));
        }
        assert!((10..150).contains(&rebuilt), "{rebuilt}");
        let listed = near.pairs.iter().map(|&p| gap(&cell, &position, &radius, p));
        assert!(listed.fold(0.0, f64::max) < 3.0 * near.skin);
    }

    #[test]
    fn one_grain_and_none() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let mut near = Neighbours::default();
        near.refresh(&cell, &[], &[], 0.0);
        assert!(near.pairs.is_empty());
        near.refresh(&cell, &[DVec3::splat(0.5)], &[0.5], 0.0);
        assert_eq!(near.pairs.len(), 6);
    }
}
