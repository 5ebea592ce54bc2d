//! Patches: pores of neighbouring numbers, with room of their own for the motion of their vertices and for what they do to them.
//!
//! What a pore pushes and what it gives to the water when its vertices move take 148 [bytes](super::pushes), read twice in every step;
//! nothing else shall keep the memory waiting. Within a patch grains and walls are the same, near each other, and named by two bytes.
//! Several threads take patches; each vertex adds up what they did to it in their order, whoever worked them out.

#[cfg(target_arch = "x86_64")]
use super::four::Avx;
use super::four::Four;
use super::pushes::{Packed, Pushes};
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

/// Room for what the vertices of patches do, or what is done to them.
pub type Room = Vec<Six>;

/// Velocity and spin, or force and torque.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub struct Six {
    first: [f64; 4],
    last: [f64; 2],
}

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
        rates: &Pushes,
        velocity: &[DVec3],
        spin: &[DVec3],
        wall_velocity: &[DVec3; 6],
        out: &mut [f64],
    ) {
        let motion = |&vertex: &u32| {
            let grain = vertex as usize;
            match (velocity.get(grain), spin.get(grain)) {
                (Some(v), Some(w)) => Six { first: [v.x, v.y, v.z, w.x], last: [w.y, w.z] },
                _ => {
                    let v = wall_velocity[grain - velocity.len()];
                    Six { first: [v.x, v.y, v.z, 0.0], last: [0.0; 2] }
                }
            }
        };
        let patch = |room: &mut Room, (k, (range, out)): (usize, (&Range<usize>, &mut [f64]))| {
            room.clear();
            room.extend(self.vertices[range.clone()].iter().map(motion));
            carry(&self.places[k * SIZE..], &rates.all()[k * SIZE..], room, out);
        };
        let patches = self.ranges.par_iter().zip(out.par_chunks_mut(SIZE)).enumerate();
        patches.for_each_init(Room::new, patch);
    }

    /// Adds what the pressures of the pores' nodes [Pa] do to grains and walls.
    pub fn load(&self, push: &Pushes, node: &[u32], pressure: &[f64], room: &mut Room, loads: &mut Loads) {
        room.resize(self.vertices.len(), Six::default());
        let patch = |(k, sums): (usize, &mut [Six])| {
            sums.fill(Six::default());
            let pores = k * SIZE..self.places.len().min((k + 1) * SIZE);
            let pressure = node[pores.clone()].iter().map(|&node| pressure[node as usize]);
            press(&self.places[pores], &push.all()[k * SIZE..], pressure, sums);
        };
        let mut rest = &mut room[..];
        let split = |range: &Range<usize>| rest.split_off_mut(..range.len()).unwrap_or_default();
        let sums: Vec<&mut [Six]> = self.ranges.iter().map(split).collect();
        sums.into_par_iter().enumerate().for_each(patch);

        let grains = loads.force.len();
        let of = |vertex: usize| {
            let range = self.starts[vertex] as usize..self.starts[vertex + 1] as usize;
            self.of[range].iter().map(|&at| &room[at as usize])
        };
        let both = loads.force.par_iter_mut().zip(&mut loads.torque).with_min_len(SHARE).enumerate();
        both.for_each(|(grain, (force, torque))| {
            for &Six { first: [fx, fy, fz, tx], last: [ty, tz] } in of(grain) {
                *force += DVec3::new(fx, fy, fz);
                *torque += DVec3::new(tx, ty, tz);
            }
        });
        for (face, load) in loads.wall.iter_mut().enumerate() {
            for &Six { first: [fx, fy, fz, _], .. } in of(grains + face) {
                *load += DVec3::new(fx, fy, fz);
            }
        }
    }
}

/// The volumes carried out of the pores of a patch by what its vertices do.
#[inline(always)]
fn carry_with<F: Four>(places: &[[u16; 4]], rates: &[Packed], motion: &[Six], out: &mut [f64]) {
    for (pore, ((&[a, b, c, d], rate), out)) in places.iter().zip(rates).zip(out).enumerate() {
        fetch(rates, pore + AHEAD);
        let (a, b, c, d) =
            (&motion[a as usize], &motion[b as usize], &motion[c as usize], &motion[d as usize]);
        let first = rate.row::<F>(0).times(F::load(&a.first)).add_product(rate.row(1), F::load(&b.first));
        let first = first.add_product(rate.row(2), F::load(&c.first));
        let first = first.add_product(rate.row(3), F::load(&d.first));
        let last = rate.row::<F>(4).times(F::pair(&a.last, &b.last));
        let last = last.add_product(rate.row(5), F::pair(&c.last, &d.last));
        let [force, torque] = rate.units();
        *out = last.times(F::splat(torque)).add_product(first, F::three_and(force, torque)).sum();
    }
}

/// Adds what the pressures of the pores of a patch do to its vertices.
#[inline(always)]
fn press_with<F: Four>(
    places: &[[u16; 4]],
    pushes: &[Packed],
    pressure: impl Iterator<Item = f64>,
    sums: &mut [Six],
) {
    for (pore, ((&places, push), p)) in places.iter().zip(pushes).zip(pressure).enumerate() {
        fetch(pushes, pore + AHEAD);
        let [force, torque] = push.units();
        let (first, last) = (F::three_and(p * force, p * torque), F::splat(p * torque));
        for vertex in 0..4 {
            let sum = &mut sums[places[vertex] as usize].first;
            F::load(sum).add_product(push.row(vertex), first).store(sum);
        }
        // One after the other: a grain may be there twice, as an image of itself.
        for pair in 0..2 {
            let torques = push.row::<F>(4 + pair).times(last);
            torques.add_low(&mut sums[places[2 * pair] as usize].last);
            torques.add_high(&mut sums[places[2 * pair + 1] as usize].last);
        }
    }
}

fn carry(places: &[[u16; 4]], rates: &[Packed], motion: &[Six], out: &mut [f64]) {
    #[cfg(target_arch = "x86_64")]
    if Avx::available() {
        // SAFETY: the processor has the features, as just asked.
        return unsafe { carry_avx(places, rates, motion, out) };
    }
    carry_with::<[f64; 4]>(places, rates, motion, out);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn carry_avx(places: &[[u16; 4]], rates: &[Packed], motion: &[Six], out: &mut [f64]) {
    carry_with::<Avx>(places, rates, motion, out);
}

fn press(places: &[[u16; 4]], pushes: &[Packed], pressure: impl Iterator<Item = f64>, sums: &mut [Six]) {
    #[cfg(target_arch = "x86_64")]
    if Avx::available() {
        // SAFETY: the processor has the features, as just asked.
        return unsafe { press_avx(places, pushes, pressure, sums) };
    }
    press_with::<[f64; 4]>(places, pushes, pressure, sums);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn press_avx(places: &[[u16; 4]], pushes: &[Packed], pressure: impl Iterator<Item = f64>, sums: &mut [Six]) {
    press_with::<Avx>(places, pushes, pressure, sums);
}

/// Asks for the pushes of a pore that will be read soon, if there is one.
#[inline(always)]
fn fetch(pushes: &[Packed], pore: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(pushes) = pushes.get(pore) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        for line in 0..3 {
            // SAFETY: a hint that reads nothing; the address lies within the 148 bytes of the pushes.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(pushes).cast::<i8>().add(64 * line)) };
        }
    }
}
