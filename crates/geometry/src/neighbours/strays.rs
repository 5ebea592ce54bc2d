//! Grains that have gone further than all others: their pairs are found anew, without a new list.

use super::{BLOCK, Neighbours};
use crate::triangulation::FIRST_WALL;
use glam::DVec3;
use rayon::prelude::*;

/// Part of the room to come closer by which a grain may move before its pairs are found anew, at first and at most: two may have moved.
const LEASH: [f64; 2] = [1.0 / 32.0, 0.49];
/// Few are so many, and one more of every so many.
const FEW: [usize; 2] = [8, 2048];

impl Neighbours {
    /// A new list of so many grains, of which two may come closer by `room` [m].
    pub(super) fn settle(&mut self, grains: usize, room: f64) {
        self.ways.clear();
        self.ways.resize(grains.div_ceil(BLOCK), 0.0);
        self.leash = LEASH[0] * room;
        self.later.clear();
        self.gone.clear();
    }

    /// Finds the pairs of the few grains anew that have gone beyond the leash; where they are not few the leash becomes longer, up
    /// to half the `room` for two to come closer [m]. Returns how far any grain may be from where its pairs were found [m].
    ///
    /// A pair that was not listed had a gap of a skin or more when the later of the two was looked at, and the ways of both since then
    /// are all that it can have become less by.
    pub(super) fn keep_within_leash(&mut self, position: &[DVec3], room: f64) -> f64 {
        let few = FEW[0] + position.len() / FEW[1];
        loop {
            let (leash, old) = (self.leash, &self.position);
            let way = |k: usize| position[k].distance_squared(old[k]);
            let block = |b: usize| b * BLOCK..position.len().min((b + 1) * BLOCK);
            self.ways
                .par_iter_mut()
                .enumerate()
                .with_min_len(8)
                .filter(|(_, way)| **way > leash)
                .for_each(|(b, furthest)| *furthest = block(b).map(way).fold(0.0, f64::max).sqrt());
            let beyond = (0..self.ways.len()).filter(|&b| self.ways[b] > leash);
            self.strays.clear();
            self.strays.extend(
                beyond.flat_map(block).filter(|&k| way(k) > leash * leash).map(|k| k as u32).take(few + 1),
            );
            if self.strays.len() <= few && self.gone.len() <= few && self.later.len() <= self.pairs.len() / 4
            {
                break;
            }
            if leash >= LEASH[1] * room {
                self.strays.clear();
                return self.ways.iter().copied().fold(0.0, f64::max);
            }
            self.leash = (2.0 * leash).min(LEASH[1] * room);
        }
        for k in 0..self.strays.len() {
            self.find(self.strays[k], position);
        }
        self.ways.iter_mut().for_each(|way| *way = way.min(self.leash));
        self.ways.iter().copied().fold(0.0, f64::max)
    }

    /// Adds the near pairs of a grain where it is now.
    fn find(&mut self, grain: u32, position: &[DVec3]) {
        let i = grain as usize;
        let own = position[i];
        self.position[i] = own;
        if self.grid.index(self.grid.place(own)) != self.grid.cube[i] as usize && !self.gone.contains(&grain)
        {
            self.gone.push(grain);
        }
        let room = self.radius[i] + self.skin;
        for &other in self.grid.around(own).chain([&self.gone[..]]).flatten() {
            let j = other as usize;
            let within = room + self.radius[j];
            if j != i && self.position[j].distance_squared(own) < within * within {
                self.later.push([grain.min(other), grain.max(other)]);
            }
        }
        let Some(cell) = &self.cell else { return };
        for face in 0..6 {
            if (cell.wall_position(face) - own[face / 2]).abs() - self.radius[i] < self.skin {
                self.later.push([grain, FIRST_WALL + face as u32]);
            }
        }
    }
}
