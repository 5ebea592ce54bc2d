//! Patches: pores of neighbouring numbers, with room of their own for the motion of their vertices and for what they do to them.
//!
//! What a pore pushes and what it gives to the water when its vertices move take 192 bytes, read twice in every step; nothing else
//! shall keep the memory waiting. Within a patch grains and walls are the same, near each other, and named by two bytes.
//! Several threads take patches; each vertex adds up what they did to it in their order, whoever worked them out.

use super::coupling::Push;
use crate::grains::Loads;
use glam::DVec3;
use porograin_geometry::triangulation::{Vertex, wall};
use rayon::prelude::*;
use std::ops::Range;

/// Pores of a patch; four times as many vertices have to be told apart by two bytes.
const SIZE: usize = 2048;
/// How many pores ahead the pushes are asked for.
const AHEAD: usize = 8;
/// Grains whose loads a thread adds up at once.
const SHARE: usize = 512;

/// Room for what patches do to their vertices.
pub type Room = Vec<[f64; 6]>;

/// The pores of a mesh in patches.
#[derive(Clone, Debug)]
pub struct Patches {
    /// The vertices of each patch, one patch after the other: grains, and walls as if they were the grains after the last one.
    vertices: Vec<u32>,
    /// Those of each patch.
    ranges: Vec<Range<usize>>,
    /// The four vertices of each pore, counted from the first of its patch.
    places: Vec<[u16; 4]>,
    /// Where each vertex is among `vertices`, in rising order.
    of: Vec<u32>,
    /// The first of each vertex in `of`; length grains + 7.
    starts: Vec<u32>,
}

impl Patches {
    /// Of pores with these vertices between `grains` grains.
    pub fn new(pores: &[[Vertex; 4]], grains: usize) -> Patches {
        let number = |&vertex: &Vertex| wall(vertex).map_or(vertex, |face| (grains + face) as u32);
        let mut patches = Patches {
            vertices: Vec::new(),
            ranges: Vec::new(),
            places: Vec::with_capacity(pores.len()),
            of: Vec::new(),
            starts: vec![0; grains + 7],
        };
        let mut place = vec![0u16; grains + 6];
        for pores in pores.chunks(SIZE) {
            let mut vertices: Vec<u32> = pores.iter().flatten().map(number).collect();
            vertices.sort_unstable();
            vertices.dedup();
            for (k, &vertex) in vertices.iter().enumerate() {
                place[vertex as usize] = k as u16;
                patches.starts[vertex as usize + 1] += 1;
            }
            let of_pore = |pore: &[Vertex; 4]| pore.each_ref().map(|vertex| place[number(vertex) as usize]);
            patches.places.extend(pores.iter().map(of_pore));
            let first = patches.vertices.len();
            patches.vertices.extend(vertices);
            patches.ranges.push(first..patches.vertices.len());
        }
        for vertex in 0..grains + 6 {
            patches.starts[vertex + 1] += patches.starts[vertex];
        }
        let mut cursor = patches.starts.clone();
        patches.of = vec![0; patches.vertices.len()];
        for (at, &vertex) in patches.vertices.iter().enumerate() {
            let cursor = &mut cursor[vertex as usize];
            patches.of[*cursor as usize] = at as u32;
            *cursor += 1;
        }
        patches
    }

    /// The volume that moving grains and walls carry out of each pore [m³/s], where `rates` is that of each vertex of each pore per
    /// velocity and spin.
    pub fn carried(
        &self,
        rates: &[[Push; 4]],
        velocity: &[DVec3],
        spin: &[DVec3],
        wall_velocity: &[DVec3; 6],
        out: &mut [f64],
    ) {
        let motion = |&vertex: &u32| {
            let grain = vertex as usize;
            match (velocity.get(grain), spin.get(grain)) {
                (Some(v), Some(w)) => [v.x, v.y, v.z, w.x, w.y, w.z],
                _ => {
                    let v = wall_velocity[grain - velocity.len()];
                    [v.x, v.y, v.z, 0.0, 0.0, 0.0]
                }
            }
        };
        let patch = |room: &mut Room, (k, (range, out)): (usize, (&Range<usize>, &mut [f64]))| {
            room.clear();
            room.extend(self.vertices[range.clone()].iter().map(motion));
            let first = k * SIZE;
            let pores = self.places[first..].iter().zip(&rates[first..]).zip(out);
            for (pore, ((places, rates_here), out)) in pores.enumerate() {
                fetch(rates, first + pore + AHEAD);
                let mut sum = [0.0; 6];
                for (&place, Push(rate)) in places.iter().zip(rates_here) {
                    let motion = &room[place as usize];
                    for m in 0..6 {
                        sum[m] += rate[m] * motion[m];
                    }
                }
                *out = ((sum[0] + sum[2]) + sum[4]) + ((sum[1] + sum[3]) + sum[5]);
            }
        };
        let patches = self.ranges.par_iter().zip(out.par_chunks_mut(SIZE)).enumerate();
        patches.for_each_init(Room::new, patch);
    }

    /// Adds what the pressures of the pores' nodes [Pa] do to grains and walls.
    pub fn load(
        &self,
        push: &[[Push; 4]],
        node: &[u32],
        pressure: &[f64],
        room: &mut Room,
        loads: &mut Loads,
    ) {
        room.resize(self.vertices.len(), [0.0; 6]);
        let patch = |(k, sums): (usize, &mut [[f64; 6]])| {
            sums.fill([0.0; 6]);
            let first = k * SIZE;
            let last = self.places.len().min(first + SIZE);
            let pores = self.places[first..last].iter().zip(&push[first..last]).zip(&node[first..last]);
            for (pore, ((places, here), &node)) in pores.enumerate() {
                fetch(push, first + pore + AHEAD);
                let p = pressure[node as usize];
                for (&place, Push(push)) in places.iter().zip(here) {
                    let sum = &mut sums[place as usize];
                    for m in 0..6 {
                        sum[m] += p * push[m];
                    }
                }
            }
        };
        let mut rest = &mut room[..];
        let split = |range: &Range<usize>| rest.split_off_mut(..range.len()).unwrap_or_default();
        let sums: Vec<&mut [[f64; 6]]> = self.ranges.iter().map(split).collect();
        sums.into_par_iter().enumerate().for_each(patch);

        let grains = loads.force.len();
        let of = |vertex: usize| {
            let range = self.starts[vertex] as usize..self.starts[vertex + 1] as usize;
            self.of[range].iter().map(|&at| &room[at as usize])
        };
        let both = loads.force.par_iter_mut().zip(&mut loads.torque).with_min_len(SHARE).enumerate();
        both.for_each(|(grain, (force, torque))| {
            for &[fx, fy, fz, tx, ty, tz] in of(grain) {
                *force += DVec3::new(fx, fy, fz);
                *torque += DVec3::new(tx, ty, tz);
            }
        });
        for (face, load) in loads.wall.iter_mut().enumerate() {
            for &[fx, fy, fz, ..] in of(grains + face) {
                *load += DVec3::new(fx, fy, fz);
            }
        }
    }
}

/// Asks for the pushes of a pore that will be read soon, if there is one.
#[inline(always)]
fn fetch(pushes: &[[Push; 4]], pore: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(pushes) = pushes.get(pore) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        for line in 0..3 {
            // SAFETY: a hint that reads nothing; the address lies within the 192 bytes of the pushes.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(pushes).cast::<i8>().add(64 * line)) };
        }
    }
}
