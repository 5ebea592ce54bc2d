//! On which parts of the walls that the case adds grains have a foot.

use super::{Contacts, Memory, Surroundings};
use crate::walls::{Place, is_part};
use glam::DVec3;
use porograin_geometry::triangulation::FIRST_WALL;
use porograin_geometry::{Cell, Neighbours};

/// How far apart two feet may be, over the radius, for the one to be where the other has gone.
const FOLLOWED: f64 = 0.1;

/// Grains near walls; dropping it changes no bit.
#[derive(Debug, Default)]
pub struct Near {
    /// Sorted by grain, then wall.
    list: Vec<Pair>,
    /// Triangles of meshes near the grains of the list.
    triangles: Vec<u32>,
    /// Where the walls were when the list was made, and which were there.
    places: Vec<(Place, bool)>,
    skin: f64,
    feet: Vec<u32>,
    now: Vec<u32>,
}

/// A grain near a wall.
#[derive(Debug)]
struct Pair {
    grain: u32,
    wall: u32,
    triangles: [u32; 2],
}

impl Near {
    /// Brings the contacts with parts of walls up to date: a contact lives as long as the grain has a foot on that part, and is
    /// born where a foot is nearer than the radius. One that goes on where another ended remembers what that one knew.
    ///
    /// The result depends on where grains and walls are and on `contacts` alone.
    pub fn follow(
        &mut self,
        contacts: &mut Contacts,
        surroundings: &Surroundings,
        near: &Neighbours,
        renew: bool,
    ) {
        if surroundings.walls.is_empty() {
            return;
        }
        if renew || !self.holds(surroundings, near.skin()) {
            self.find(contacts, surroundings, near.skin());
        }
        for &grain in &near.strays {
            let range = [0, 1].map(|next| self.list.partition_point(|pair| pair.grain < grain + next));
            let now = self.near(surroundings, grain);
            self.list.splice(range[0]..range[1], now);
        }
        // From the back, so that what is still to come stays where it is.
        let mut end = self.list.len();
        while end > 0 {
            let grain = self.list[end - 1].grain;
            let start = self.list[..end].partition_point(|pair| pair.grain < grain);
            self.feet.clear();
            for pair in &self.list[start..end] {
                let (wall, before) = (&surroundings.walls[pair.wall as usize], self.feet.len());
                let place = &surroundings.domain.walls[pair.wall as usize];
                let centre = place.back(surroundings.grains.position[grain as usize]);
                let [from, to] = pair.triangles.map(|k| k as usize);
                wall.shape.feet(centre, &self.triangles[from..to], &mut self.feet);
                self.feet[before..].iter_mut().for_each(|part| *part += wall.first);
            }
            self.update(contacts, surroundings, grain);
            end = start;
        }
    }

    /// Brings the contacts of one grain up to date with the parts it has `feet` on, sorted.
    fn update(&mut self, contacts: &mut Contacts, surroundings: &Surroundings, grain: u32) {
        let (rich, conserving) = (contacts.rich, contacts.conserving);
        let row = contacts.row(grain);
        let start = row.pairs.partition_point(|pair| *pair < [grain, FIRST_WALL + 6]);
        let known = row.pairs[start..].iter().take_while(|pair| pair[0] == grain).count();
        let old = &row.pairs[start..start + known];
        self.now.clear();
        let stays = |part: u32| old.iter().any(|pair| pair[1] == part);
        self.now.extend(self.feet.iter().filter(|&&part| stays(part) || surroundings.touches([grain, part])));
        if self.now.len() == known && self.now.iter().zip(old).all(|(part, pair)| *part == pair[1]) {
            return;
        }
        let mut before: Vec<(u32, Memory)> =
            (start..start + known).map(|k| (row.pairs[k][1], row.memory(k))).collect();
        let branch = |part: u32| surroundings.near([grain, part]).branch;
        let allowed = FOLLOWED * surroundings.grains.radius[grain as usize];
        let mut memories = Vec::with_capacity(self.now.len());
        for &part in &self.now {
            let heir = before.iter().position(|(old, _)| *old == part).or_else(|| {
                let wall = |part: u32| crate::walls::find(surroundings.walls, part).0;
                let mut ended = before
                    .iter()
                    .enumerate()
                    .filter(|(_, (old, _))| !self.now.contains(old) && wall(*old) == wall(part));
                ended.find(|(_, (old, _))| branch(*old).distance(branch(part)) < allowed).map(|(k, _)| k)
            });
            memories.push(heir.map_or(Memory::default(), |k| before.swap_remove(k).1));
        }
        let range = start..start + known;
        row.pairs.splice(range.clone(), self.now.iter().map(|&part| [grain, part]));
        row.shear.splice(range.clone(), memories.iter().map(|memory| memory.shear));
        if rich {
            row.more.splice(range.clone(), memories.iter().map(|memory| memory.more));
        }
        if conserving {
            row.accounts.splice(range, memories.iter().map(|memory| memory.account));
        }
    }

    /// Whether no wall has moved so far that the list might lack a grain.
    fn holds(&self, surroundings: &Surroundings, skin: f64) -> bool {
        let Surroundings { walls, domain, .. } = surroundings;
        let still = |k: usize| {
            let (wall, now, (before, present)) = (&walls[k], &domain.walls[k], &self.places[k]);
            let centre = wall.shape.centre();
            let extent = wall.shape.extent().min(furthest(&domain.cell, now.forth(centre)));
            wall.present == *present && now.moved(before, centre, extent) <= 0.5 * skin
        };
        skin == self.skin && self.places.len() == walls.len() && (0..walls.len()).all(still)
    }

    /// The pairs of one grain with walls near it.
    fn near(&mut self, surroundings: &Surroundings, grain: u32) -> Vec<Pair> {
        let Surroundings { walls, domain, grains, .. } = surroundings;
        let (x, radius) = (grains.position[grain as usize], grains.radius[grain as usize]);
        // By the time they are found anew the grain has moved by less than the skin, the wall by half of it.
        let reach = radius + 1.5 * self.skin;
        let mut found = Vec::new();
        for (k, (wall, place)) in walls.iter().zip(&domain.walls).enumerate().filter(|w| w.1.0.present) {
            let from = self.triangles.len() as u32;
            if wall.shape.near(place.back(x), reach, &mut self.triangles) {
                found.push(Pair { grain, wall: k as u32, triangles: [from, self.triangles.len() as u32] });
            }
        }
        found
    }

    /// Makes the list anew, and ends the contacts with walls that are not there.
    fn find(&mut self, contacts: &mut Contacts, surroundings: &Surroundings, skin: f64) {
        let Surroundings { walls, domain, grains, .. } = surroundings;
        self.skin = skin;
        self.places.clear();
        self.places.extend(walls.iter().zip(&domain.walls).map(|(wall, place)| (*place, wall.present)));
        self.list.clear();
        self.triangles.clear();
        for i in 0..grains.len() as u32 {
            let now = self.near(surroundings, i);
            self.list.extend(now);
        }
        let gone = |pair: &[u32; 2]| is_part(pair[1]) && !walls[crate::walls::find(walls, pair[1]).0].present;
        for row in &mut contacts.rows {
            let ended: Vec<u32> =
                (0..row.pairs.len()).filter(|&k| gone(&row.pairs[k])).map(|k| k as u32).collect();
            row.remove(&ended);
        }
    }
}

/// Distance of the furthest corner of the cell from a place [m].
fn furthest(cell: &Cell, place: DVec3) -> f64 {
    let corner = |k: u8| {
        let part = |axis: u8| f64::from(k >> axis & 1);
        cell.origin + cell.edges * DVec3::new(part(0), part(1), part(2))
    };
    (0..8).map(|k| corner(k).distance(place)).fold(0.0, f64::max)
}
