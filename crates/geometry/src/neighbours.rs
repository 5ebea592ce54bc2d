//! Who is near whom: pairs of grains, and of grains and walls, closer than a skin.

mod periodic;
mod strays;

use crate::cell::Cell;
use crate::period::Period;
use crate::triangulation::{FIRST_WALL, wall};
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::ops::Range;

/// Part of the mean radius by which a pair may be apart and still be listed, at least and at most.
const SKIN: [f64; 2] = [0.15, 0.5];
/// A list that is good for fewer uses than the first calls for more skin, one that is good for more than the second for less.
const USES: [u32; 2] = [25, 250];
/// Round-off of places in terms of the skin: far above that of the coordinates of any sample that fits into memory.
const ROUND_OFF: f64 = 1e-6;
/// Grains handed to a thread at once.
const CHUNK: usize = 8192;
/// Consecutive grains whose ways are told [together](Neighbours::moved_at_most).
pub const BLOCK: usize = 1024;

/// The near pairs: every pair whose surfaces are closer than the skin.
///
/// The list is a superset of the touching pairs and stays one until some surface has moved by half the skin. Where those are few, they
/// are looked for each by itself (see [`later`](Self::later)); where they are many the list is built anew, by a cell list, in time
/// linear in the number of grains. How large the skin is and when the list was built are therefore of no consequence for what is
/// computed from the touching pairs.
///
/// Where the cell is periodic a pair stands for a grain and the nearest image of the other. That is all there is as long
/// as the lattice planes are further apart than [`room`](Self::room) says.
#[derive(Clone, Debug, Default)]
pub struct Neighbours {
    /// Pairs `(i, j)`, `i < j`, or `(i, FIRST_WALL + face)`, sorted, none twice.
    pub pairs: Vec<[u32; 2]>,
    /// Near pairs found since, of grains that had gone far, in no order; they may repeat those of the list and each other.
    pub later: Vec<[u32; 2]>,
    /// Grains whose pairs were found anew in the last use.
    pub strays: Vec<u32>,
    /// Largest gap of a listed pair when the list was built [m].
    skin: f64,
    /// See [`closer`](Self::closer) [m].
    closer: f64,
    /// Whether it was told how far grains have moved since the last use.
    told: bool,
    /// How far any grain of each [`BLOCK`] may be from where its pairs were found [m].
    ways: Vec<f64>,
    /// No grain is further from there than this [m].
    leash: f64,
    /// Grains whose pairs were found anew since the list was built, in other cubes than the grid has them in.
    gone: Vec<u32>,
    /// Uses of the list so far.
    uses: u32,
    /// Part of the mean radius that the skin is now.
    share: f64,
    /// Centres when the pairs of each grain were found, radii and box when the list was built.
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
        self.uses = self.uses.saturating_add(1);
        self.strays.clear();
        self.closer = self.approached(cell, position, radius, reach);
        if self.closer <= self.skin - reach {
            return false;
        }
        self.build(cell, position, radius, reach);
        true
    }

    /// Tells how far any grain of each [`BLOCK`] has moved at most since the last [`refresh`](Self::refresh) [m]: the next one need not look
    /// at all places. It is of no use in a periodic cell.
    pub fn moved_at_most(&mut self, ways: &[f64]) {
        self.told = ways.len() == self.ways.len();
        self.ways.iter_mut().zip(ways).for_each(|(sum, way)| *sum += way);
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

    /// How much closer the surfaces of any pair may be now than when it was found [m].
    pub fn closer(&self) -> f64 {
        self.closer
    }

    /// The gap of a near pair when it was found [m].
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

    /// How much closer the surfaces of any pair may have come since it was found [m]; without a list of these grains there is
    /// no telling.
    fn approached(&mut self, cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) -> f64 {
        let told = std::mem::take(&mut self.told);
        let Some(old) = self.cell else { return f64::INFINITY };
        if position.len() != self.position.len() || cell.periodic != old.periodic {
            return f64::INFINITY;
        }
        let grown = most(radius, &self.radius, |now, then| now - then);
        let (moved, strained) = match Period::of(cell) {
            Some(period) => self.strained(cell, &old, &period, position),
            None => {
                let lower = (cell.origin - old.origin).abs().max_element();
                let upper = (cell.upper() - old.upper()).abs().max_element();
                if !told {
                    self.ways.fill(f64::INFINITY);
                }
                let moved = self.keep_within_leash(position, self.skin - reach);
                (moved.max(lower).max(upper), 0.0)
            }
        };
        2.0 * (moved + grown) + strained + ROUND_OFF * self.skin
    }

    fn build(&mut self, cell: &Cell, position: &[DVec3], radius: &[f64], reach: f64) {
        let n = position.len();
        let mean = radius.iter().sum::<f64>() / n.max(1) as f64;
        let largest = radius.iter().fold(0.0, |a: f64, &r| a.max(r));
        if self.closer.is_finite() {
            self.share *= if self.uses < USES[0] { 1.5 } else { 1.0 };
            self.share /= if self.uses > USES[1] { 1.5 } else { 1.0 };
        }
        self.share = self.share.clamp(SKIN[0], SKIN[1]);
        let period = Period::of(cell);
        let room = |share: f64| 2.0 * (2.0 * largest + share * mean + reach);
        if period.as_ref().is_some_and(|period| period.height() < room(self.share)) {
            self.share = SKIN[0];
        }
        self.skin = self.share * mean + reach;
        (self.closer, self.uses) = (0.0, 0);
        self.settle(n, self.skin - reach);
        self.cell = Some(*cell);
        self.position.clear();
        self.position.extend_from_slice(position);
        self.radius.clear();
        self.radius.extend_from_slice(radius);
        if let Some(period) = period {
            return self.build_periodic(cell, &period, 2.0 * largest + self.skin);
        }
        self.grid.fill(cell, position, 2.0 * largest + self.skin);

        self.pairs.clear();
        let mut pairs = std::mem::take(&mut self.pairs);
        if rayon::current_num_threads() == 1 {
            self.list(cell, 0..n, &mut pairs);
        } else {
            let parts = n.div_ceil(CHUNK);
            let part = |k: usize| {
                let mut pairs = Vec::new();
                self.list(cell, k * CHUNK..((k + 1) * CHUNK).min(n), &mut pairs);
                pairs
            };
            let parts: Vec<_> = (0..parts).into_par_iter().map(part).collect();
            pairs.reserve(parts.iter().map(Vec::len).sum());
            parts.iter().for_each(|part| pairs.extend_from_slice(part));
        }
        self.pairs = pairs;
    }

    /// Adds the near pairs of which one of these grains is the first.
    fn list(&self, cell: &Cell, grains: Range<usize>, pairs: &mut Vec<[u32; 2]>) {
        let Neighbours { position, radius, skin, .. } = self;
        let mut near: Vec<u32> = Vec::new();
        for i in grains {
            let (own, room) = (position[i], radius[i] + skin);
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
            pairs.extend(near[..count].iter().map(|&j| [i as u32, j]));
            for face in 0..6 {
                if !cell.periodic[face / 2] {
                    let gap = (cell.wall_position(face) - own[face / 2]).abs() - radius[i];
                    // A grain whose centre passed through the wall is found as well.
                    if gap < *skin {
                        pairs.push([i as u32, FIRST_WALL + face as u32]);
                    }
                }
            }
        }
    }
}

/// The first pair of which one sphere holds the centre of the other, in time linear in their number where sizes do not differ much.
pub fn swallowed(position: &[DVec3], radius: &[f64]) -> Option<[usize; 2]> {
    let bound = |of: fn(DVec3, DVec3) -> DVec3| position.iter().copied().reduce(of);
    let (lower, upper) = (bound(DVec3::min)?, bound(DVec3::max)?);
    let mut grid = Grid::default();
    grid.fill(&Cell::walled(lower, upper), position, radius.iter().fold(0.0, |a, &r| a.max(r)));
    (0..position.len()).find_map(|i| {
        let holds = |&j: &usize| position[i].distance(position[j]) < radius[i].max(radius[j]);
        let later = grid.around(position[i]).flatten().map(|&j| j as usize).filter(|&j| j > i);
        later.filter(holds).min().map(|j| [i, j])
    })
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

    impl Neighbours {
        fn holds(&self, pair: [u32; 2]) -> bool {
            self.pairs.binary_search(&pair).is_ok() || self.later.contains(&pair)
        }
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
            let two = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
            let mut other = Neighbours::default();
            two.install(|| other.refresh(&cell, &position, &radius, 0.0));
            assert_eq!(other.pairs, near.pairs);
        }
    }

    /// Told how far grains move at most, the list is renewed in time without looking, and not much sooner.
    #[test]
    fn what_is_told_of_the_motion_is_as_good_as_looking() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let (mut position, radius) = cloud(300, DVec3::ONE, 15);
        let [mut told, mut looking] = [Neighbours::default(), Neighbours::default()];
        let (mut next, mut renewed) = (numbers(19), [0; 2]);
        for _ in 0..1000 {
            renewed[0] += told.refresh(&cell, &position, &radius, 0.001) as u32;
            renewed[1] += looking.refresh(&cell, &position, &radius, 0.001) as u32;
            for pair in touching(&cell, &position, &radius, 0.001) {
                assert!(told.holds(pair), "{pair:?}");
                assert!(told.gaps()(pair) < 0.001 + told.closer(), "{pair:?}");
            }
            let steps: Vec<DVec3> =
                position.iter().map(|_| (DVec3::new(next(), next(), next()) - 0.45) * 4e-4).collect();
            position.iter_mut().zip(&steps).for_each(|(x, step)| *x += *step);
            told.moved_at_most(&[steps.iter().map(|step| step.length()).fold(0.0, f64::max)]);
        }
        assert!(renewed[1] >= 3 && renewed[0] <= 2 * renewed[1], "{renewed:?}");
    }

    /// A few that fly through a crowd at rest leave its list as it is.
    #[test]
    fn strays_take_their_pairs_along() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let (mut position, radius) = cloud(3000, DVec3::ONE, 35);
        let [mut told, mut looking] = [Neighbours::default(), Neighbours::default()];
        let (mut next, mut found) = (numbers(39), 0);
        let fast = [3, 1500, 1510, 2999].map(|k| (k, 0.01 * (DVec3::new(next(), next(), next()) - 0.5)));
        for step in 0..80 {
            for near in [&mut told, &mut looking] {
                assert_eq!(near.refresh(&cell, &position, &radius, 0.001), step == 0);
            }
            for pair in touching(&cell, &position, &radius, 0.001) {
                for near in [&told, &looking] {
                    assert!(near.holds(pair) && near.gaps()(pair) < 0.001 + near.closer(), "{step} {pair:?}");
                }
            }
            found += told.strays.len();
            let mut ways = [1e-7; 3];
            position.iter_mut().for_each(|x| x.y += if x.y < 0.5 { 1e-7 } else { -1e-7 });
            for (k, way) in fast {
                // They turn back at walls.
                let fold = |x: f64| 1.0 - (x.rem_euclid(2.0) - 1.0).abs();
                let turned = |x: DVec3| DVec3::new(fold(x.x), fold(x.y), fold(x.z));
                let there = turned(position[k] + (1.0 + f64::from(step % 7)) * way);
                ways[k / BLOCK] = f64::max(ways[k / BLOCK], there.distance(position[k]) + 1e-7);
                position[k] = there;
            }
            told.moved_at_most(&ways);
        }
        assert!(found > 200, "{found}");
        assert!(told.closer() < 0.1 * told.skin, "{}", told.closer() / told.skin);
    }

    #[test]
    fn grains_that_move_fast_get_more_skin_and_lose_it_at_rest() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let (mut position, radius) = cloud(300, DVec3::ONE, 25);
        let mut near = Neighbours::default();
        let mut run = |steps: usize, way: f64| {
            for _ in 0..steps {
                near.refresh(&cell, &position, &radius, 0.0);
                position.iter_mut().for_each(|x| x.x += way);
            }
            near.skin()
        };
        let mean = radius.iter().sum::<f64>() / 300.0;
        let at_rest = run(10, 0.0);
        assert!((at_rest / mean - SKIN[0]).abs() < 1e-12);
        assert!((run(100, 1e-3) / mean - SKIN[1]).abs() < 1e-12);
        assert!((run(5000, 1e-5) / mean - SKIN[0]).abs() < 1e-12);
    }

    #[test]
    fn stays_a_superset_while_grains_walls_and_radii_change() {
        let (mut position, mut radius) = cloud(300, DVec3::ONE, 5);
        let mut cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let mut near = Neighbours::default();
        let (mut next, mut rebuilt) = (numbers(9), 0);
        for _ in 0..200 {
            rebuilt += near.refresh(&cell, &position, &radius, 0.001) as u32;
            let gap = near.gaps();
            for pair in touching(&cell, &position, &radius, 0.001) {
                assert!(near.holds(pair), "{pair:?}");
                // It has come no closer than any pair can have.
                assert!(gap(pair) < 0.001 + near.closer(), "{pair:?}");
            }
            drop(gap);
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
    fn who_swallows_whom_is_found_as_by_trying_all() {
        let mut seen = [0; 2];
        for seed in 0..20 {
            let (mut position, radius) = cloud(60 + 10 * seed, DVec3::new(1.0, 0.5, 0.7), 40 + seed as u64);
            if seed % 2 == 0 {
                position.iter_mut().for_each(|x| *x *= 4.0);
            }
            let holds = |i: usize, j: usize| position[i].distance(position[j]) < radius[i].max(radius[j]);
            let n = position.len();
            let first = (0..n).find_map(|i| (i + 1..n).find(|&j| holds(i, j)).map(|j| [i, j]));
            assert_eq!(swallowed(&position, &radius), first, "{seed}");
            seen[usize::from(first.is_some())] += 1;
        }
        assert!(seen[0] > 0 && seen[1] > 0, "{seen:?}");
        assert_eq!(swallowed(&[DVec3::ONE; 3], &[0.1; 3]), Some([0, 1]));
        assert_eq!(swallowed(&[], &[]), None);
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
