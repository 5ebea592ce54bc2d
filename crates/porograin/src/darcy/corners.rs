//! Which part of each grain lies around which corner of the cells, and sums over them.
//!
//! The region around a corner reaches to the centres of the cells that meet there, and to the wall. A grain no larger than
//! a cell lies around at most two corners along each axis: its eight parts are one row, and what larger grains have
//! beyond these is kept apart.

use super::transfer::{Pieces, Transfer};
use crate::grains::{Grains, Shape};
use glam::DVec3;
use rayon::prelude::*;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256d, _mm_add_pd, _mm_cvtsd_f64, _mm_loadu_pd, _mm_loadu_ps, _mm_storeu_pd, _mm_storeu_ps,
    _mm256_add_pd, _mm256_broadcast_sd, _mm256_castpd256_pd128, _mm256_cvtpd_ps, _mm256_cvtps_pd,
    _mm256_extractf128_pd, _mm256_fmadd_pd, _mm256_fnmadd_pd, _mm256_loadu_pd, _mm256_maskload_pd,
    _mm256_permute4x64_pd, _mm256_set1_pd, _mm256_setr_epi64x, _mm256_setzero_pd, _mm256_storeu_pd,
};

/// Parts of a grain around the corners of one cell, x fastest, then y. They are weights, so that single precision does: what
/// must balance does so because all sums take them as they are.
type Eight = [f32; 8];
/// The lowest corner of a grain, its parts there, and corner and volume of what is beyond.
type Row = (u32, Eight, Vec<(u32, f64)>);

/// Parts of the volume of grains around corners.
#[derive(Clone, Debug, Default)]
pub struct Corners {
    /// Corners along each axis; discs have one along y.
    pub count: [usize; 3],
    /// Volume of grains around each corner [m³].
    pub solid: Vec<f64>,
    /// What leads from a corner to the next along each axis; 0 where there is none.
    pub stride: [usize; 3],
    /// The lowest of the eight corners around each grain.
    first: Vec<u32>,
    /// The eight parts of each grain [m³].
    part: Vec<Eight>,
    /// Grain, corner and volume of what is beyond these.
    beyond: Vec<(u32, u32, f64)>,
    /// The same by corner: the grains around each in rising order, those of `beyond` last.
    starts: Vec<u32>,
    grain: Vec<u32>,
    volume: Vec<f64>,
}

/// Grains handed to a thread at once.
const BLOCK: usize = 512;
/// Corners handed to a thread at once.
const CORNERS: usize = 64;

impl Corners {
    /// Cuts every grain at the centres of the cells between the planes.
    pub fn new(grains: &Grains, transfer: Transfer, planes: &[Vec<f64>; 3]) -> Corners {
        let flat = matches!(grains.shape, Shape::Disc { .. });
        let centres: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            let between = if flat && axis == 1 { &[] } else { planes[axis].as_slice() };
            between.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
        });
        let centres = centres.each_ref().map(Vec::as_slice);
        let count = centres.map(|centres| centres.len() + 1);
        let step = |axis: usize, stride: usize| if count[axis] > 1 { stride } else { 0 };
        let stride = [step(0, 1), step(1, count[0]), step(2, count[0] * count[1])];
        let rows: Vec<Row> = (0..grains.len())
            .into_par_iter()
            .with_min_len(BLOCK)
            .map_init(Pieces::default, |pieces, k| {
                pieces.cut(transfer, grains.shape, grains.position[k].to_array(), grains.radius[k], centres);
                row(pieces, count, stride)
            })
            .collect();
        let mut corners = Corners { count, stride, ..Corners::default() };
        for (k, (first, part, more)) in rows.into_iter().enumerate() {
            corners.first.push(first);
            corners.part.push(part);
            corners.beyond.extend(more.into_iter().map(|(corner, volume)| (k as u32, corner, volume)));
        }
        corners.turn();
        corners
    }

    /// Number of corners.
    pub fn len(&self) -> usize {
        self.count.iter().product()
    }

    /// Whether there is no corner.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Lists the parts by corner.
    fn turn(&mut self) {
        let mut around: Vec<Vec<(u32, f64)>> = vec![Vec::new(); self.len()];
        let offsets = self.offsets();
        for k in 0..self.grains() {
            for (offset, &volume) in offsets.iter().zip(&self.part[k]) {
                if volume != 0.0 {
                    around[self.first[k] as usize + offset].push((k as u32, f64::from(volume)));
                }
            }
        }
        for &(k, corner, volume) in &self.beyond {
            around[corner as usize].push((k, volume));
        }
        self.starts = vec![0];
        for list in around {
            self.solid.push(list.iter().map(|(_, volume)| volume).sum());
            self.grain.extend(list.iter().map(|(k, _)| k));
            self.volume.extend(list.iter().map(|(_, volume)| volume));
            self.starts.push(self.grain.len() as u32);
        }
    }

    /// From the lowest of eight corners to each of them.
    fn offsets(&self) -> [usize; 8] {
        let [x, y, z] = self.stride;
        std::array::from_fn(|c| (c & 1) * x + (c >> 1 & 1) * y + (c >> 2) * z)
    }

    /// Number of grains.
    pub fn grains(&self) -> usize {
        self.first.len()
    }

    /// Volume of a grain around all corners [m³].
    pub fn volume(&self, k: usize) -> f64 {
        let more = self.beyond.iter().filter(|(grain, ..)| *grain as usize == k).map(|(.., volume)| *volume);
        self.part[k].iter().map(|&part| f64::from(part)).chain(more).sum()
    }

    /// `sum of V_k v_k` over the grains around each corner, V_k the part of each there. Every sum adds its grains in one order,
    /// whether they are scattered (one thread) or gathered; for gathering the `v_k` are kept in `value`.
    pub fn sums(&self, foreseen: &Foreseen, value: &mut Vec<Four>, sums: &mut Vec<Four>) {
        sums.clear();
        sums.resize(self.len(), [0.0; 4]);
        if rayon::current_num_threads() == 1 {
            self.scatter(foreseen, sums);
            for &(k, corner, volume) in &self.beyond {
                add(&mut sums[corner as usize], volume, foreseen.of(k as usize));
            }
        } else {
            value.resize(self.grains(), [0.0; 4]);
            let blocks = value.par_chunks_mut(BLOCK).enumerate();
            blocks.for_each(|(block, value)| foreseen.put(block * BLOCK, value));
            let blocks = sums.par_chunks_mut(CORNERS).enumerate();
            blocks.for_each(|(block, sums)| self.gather(block * CORNERS, value, sums));
        }
    }

    fn scatter(&self, foreseen: &Foreseen, sums: &mut [Four]) {
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.scatter_wide(foreseen, sums) };
        }
        let rows = self.rows();
        for k in 0..self.grains() {
            let v = foreseen.of(k);
            for (row, part) in rows.iter().zip(self.part[k].as_chunks::<2>().0) {
                for (sum, &part) in sums[self.first[k] as usize + row..][..2].iter_mut().zip(part) {
                    add(sum, f64::from(part), v);
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn scatter_wide(&self, foreseen: &Foreseen, sums: &mut [Four]) {
        let rows = self.rows();
        for (k, (&first, part)) in self.first.iter().zip(&self.part).enumerate() {
            let (v, part) = (foreseen.of_wide(k), doubled(part));
            for (row, part) in rows.iter().zip(part.as_chunks::<2>().0) {
                for (sum, part) in sums[first as usize + row..][..2].iter_mut().zip(part) {
                    store(sum, _mm256_fmadd_pd(_mm256_broadcast_sd(part), v, load(sum)));
                }
            }
        }
    }

    /// The sums from corner `start` on.
    fn gather(&self, start: usize, value: &[Four], sums: &mut [Four]) {
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.gather_wide(start, value, sums) };
        }
        for (corner, sum) in sums.iter_mut().enumerate() {
            let around = self.around(start + corner);
            for (&k, &volume) in self.grain[around.clone()].iter().zip(&self.volume[around]) {
                add(sum, volume, value[k as usize]);
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn gather_wide(&self, start: usize, value: &[Four], sums: &mut [Four]) {
        for (corner, sum) in sums.iter_mut().enumerate() {
            let around = self.around(start + corner);
            let mut all = load(sum);
            for (&k, volume) in self.grain[around.clone()].iter().zip(&self.volume[around]) {
                all = _mm256_fmadd_pd(_mm256_broadcast_sd(volume), load(&value[k as usize]), all);
            }
            store(sum, all);
        }
    }

    /// Where the grains around a corner are listed.
    fn around(&self, corner: usize) -> std::ops::Range<usize> {
        self.starts[corner] as usize..self.starts[corner + 1] as usize
    }

    /// From the lowest corner to the first of each pair along x.
    fn rows(&self) -> [usize; 4] {
        let [_, y, z] = self.stride;
        [0, y, z, y + z]
    }

    /// Sums the field over the corners around each grain, each by the part of the grain there: the pull of the pressures takes
    /// the place of `pulled`, pull and drag together are added to `force`. The drag is that at the velocities [`Foreseen`]
    /// from `force` and `pulled` as they come in.
    pub fn load(&self, field: &[Field], moving: &Moving, pulled: &mut [Pull], force: &mut [DVec3]) {
        let foreseen = moving.under(force, pulled);
        let beyond: Vec<Four> = self.beyond.iter().map(|&(k, ..)| foreseen.of(k as usize)).collect();
        (pulled.par_chunks_mut(BLOCK), force.par_chunks_mut(BLOCK)).into_par_iter().enumerate().for_each(
            |(block, (pulled, force))| self.load_block(block * BLOCK, field, moving, pulled, force),
        );
        for (&(k, corner, volume), v) in self.beyond.iter().zip(beyond) {
            let (k, Field { pull, drag }) = (k as usize, field[corner as usize]);
            let more = |lane: usize| volume * (pull[lane] + (drag[lane] - pull[3] * v[lane]));
            force[k] += DVec3::new(more(0), more(1), more(2));
            for lane in 0..3 {
                pulled[k][lane] += (volume * pull[lane]) as f32;
            }
        }
    }

    fn load_block(
        &self,
        start: usize,
        field: &[Field],
        moving: &Moving,
        pulled: &mut [Pull],
        force: &mut [DVec3],
    ) {
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.load_wide(start, field, moving, pulled, force) };
        }
        let rows = self.rows();
        let parts = self.first[start..].iter().zip(&self.part[start..]);
        for (k, ((&first, part), (pulled, force))) in parts.zip(pulled.iter_mut().zip(force)).enumerate() {
            // By turns, so that sums do not wait for each other.
            let mut sums = [Field::default(); 2];
            for (row, part) in rows.iter().zip(part.as_chunks::<2>().0) {
                for ((field, &part), sum) in
                    field[first as usize + row..][..2].iter().zip(part).zip(&mut sums)
                {
                    add(&mut sum.pull, f64::from(part), field.pull);
                    add(&mut sum.drag, f64::from(part), field.drag);
                }
            }
            let [a, b] = sums;
            let v = moving.of(start + k, *force, *pulled);
            let resistance = a.pull[3] + b.pull[3];
            let pull: Four = std::array::from_fn(|lane| a.pull[lane] + b.pull[lane]);
            let total =
                |lane: usize| pull[lane] + (-resistance).mul_add(v[lane], a.drag[lane] + b.drag[lane]);
            *force += DVec3::new(total(0), total(1), total(2));
            *pulled = pull.map(|pull| pull as f32);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn load_wide(
        &self,
        start: usize,
        field: &[Field],
        moving: &Moving,
        pulled: &mut [Pull],
        force: &mut [DVec3],
    ) {
        let rows = self.rows();
        let parts = self.first[start..].iter().zip(&self.part[start..]);
        for (k, ((&first, part), (pulled, force))) in parts.zip(pulled.iter_mut().zip(force)).enumerate() {
            let (mut pull, mut drag) = ([_mm256_setzero_pd(); 2], [_mm256_setzero_pd(); 2]);
            let part = doubled(part);
            for (row, part) in rows.iter().zip(part.as_chunks::<2>().0) {
                let pair = &field[first as usize + row..][..2];
                for side in 0..2 {
                    let (part, field) = (_mm256_broadcast_sd(&part[side]), &pair[side]);
                    pull[side] = _mm256_fmadd_pd(part, load(&field.pull), pull[side]);
                    drag[side] = _mm256_fmadd_pd(part, load(&field.drag), drag[side]);
                }
            }
            let (pull, drag) = (_mm256_add_pd(pull[0], pull[1]), _mm256_add_pd(drag[0], drag[1]));
            let (resistance, v) =
                (_mm256_permute4x64_pd::<0xff>(pull), moving.of_wide(start + k, force, pulled));
            let total = _mm256_add_pd(pull, _mm256_fnmadd_pd(resistance, v, drag));
            // SAFETY: there is room for four single numbers, and for two double ones from x on.
            unsafe {
                _mm_storeu_ps(pulled.as_mut_ptr(), _mm256_cvtpd_ps(pull));
                let xy = std::ptr::from_mut(force).cast();
                _mm_storeu_pd(xy, _mm_add_pd(_mm_loadu_pd(xy), _mm256_castpd256_pd128(total)));
            }
            force.z += _mm_cvtsd_f64(_mm256_extractf128_pd::<1>(total));
        }
    }
}

/// Three numbers and a spare one.
pub type Four = [f64; 4];

/// What there is around a corner, per volume of grain.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub struct Field {
    /// Pull of the pressures [N/m³], and the resistance r to motion against the other grains [kg/(m³ s)].
    pub pull: Four,
    /// r times the mean velocity of the grains [N/m³].
    pub drag: Four,
}

/// The pull of the pressures on a grain [N] and a spare number. It only serves to foresee, so that single precision does.
pub type Pull = [f32; 4];

/// Grains, and how long a force acts on them.
#[derive(Clone, Copy, Debug)]
pub struct Moving<'a> {
    /// [m/s]
    pub velocity: &'a [DVec3],
    /// [kg]
    pub mass: &'a [f64],
    /// [s]
    pub kick: f64,
}

impl<'a> Moving<'a> {
    /// The same under forces [N].
    pub fn under(self, force: &'a [DVec3], pulled: &'a [Pull]) -> Foreseen<'a> {
        Foreseen { moving: self, force, pulled }
    }

    /// `v + kick/m (force + pulled)`.
    #[inline(always)]
    fn of(&self, k: usize, force: DVec3, [x, y, z, _]: Pull) -> Four {
        let (v, by) = (self.velocity[k], self.kick / self.mass[k]);
        let [x, y, z] = [x, y, z].map(f64::from);
        [by.mul_add(force.x + x, v.x), by.mul_add(force.y + y, v.y), by.mul_add(force.z + z, v.z), 0.0]
    }

    /// The same, to the bit.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn of_wide(&self, k: usize, force: &DVec3, pulled: &Pull) -> __m256d {
        let by = _mm256_set1_pd(self.kick / self.mass[k]);
        // SAFETY: there are four single numbers.
        let pulled = _mm256_cvtps_pd(unsafe { _mm_loadu_ps(pulled.as_ptr()) });
        _mm256_fmadd_pd(by, _mm256_add_pd(load_three(force), pulled), load_three(&self.velocity[k]))
    }
}

/// What the forces so far would make of the velocities.
#[derive(Clone, Copy, Debug)]
pub struct Foreseen<'a> {
    moving: Moving<'a>,
    force: &'a [DVec3],
    pulled: &'a [Pull],
}

impl Foreseen<'_> {
    #[inline(always)]
    fn of(&self, k: usize) -> Four {
        self.moving.of(k, self.force[k], self.pulled[k])
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn of_wide(&self, k: usize) -> __m256d {
        self.moving.of_wide(k, &self.force[k], &self.pulled[k])
    }

    /// Writes the velocities from grain `start` on.
    fn put(&self, start: usize, value: &mut [Four]) {
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.put_wide(start, value) };
        }
        value.iter_mut().enumerate().for_each(|(k, value)| *value = self.of(start + k));
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn put_wide(&self, start: usize, value: &mut [Four]) {
        for (k, value) in value.iter_mut().enumerate() {
            store(value, self.of_wide(start + k));
        }
    }
}

/// Whether the processor can do what the functions in wide registers need. The others give the same bits.
#[cfg(target_arch = "x86_64")]
fn wide() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

/// The parts of a grain in double precision.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
fn doubled(part: &Eight) -> [f64; 8] {
    let mut out = [0.0; 8];
    // SAFETY: there are eight numbers, and room for as many.
    unsafe {
        for half in [0, 4] {
            let four = _mm256_cvtps_pd(_mm_loadu_ps(part.as_ptr().add(half)));
            _mm256_storeu_pd(out.as_mut_ptr().add(half), four);
        }
    }
    out
}

/// Three numbers and a zero.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
fn load_three(from: &DVec3) -> __m256d {
    // SAFETY: what the mask leaves out, beyond z, is not touched.
    unsafe { _mm256_maskload_pd(std::ptr::from_ref(from).cast(), _mm256_setr_epi64x(-1, -1, -1, 0)) }
}

#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
fn load(from: &Four) -> __m256d {
    // SAFETY: there are four numbers.
    unsafe { _mm256_loadu_pd(from.as_ptr()) }
}

#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
fn store(to: &mut Four, values: __m256d) {
    // SAFETY: there is room for four numbers.
    unsafe { _mm256_storeu_pd(to.as_mut_ptr(), values) }
}

#[inline]
fn add(sum: &mut Four, part: f64, value: Four) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum = part.mul_add(value, *sum);
    }
}

/// The pieces of a grain as the row of its eight corners, and the pieces beyond.
fn row(pieces: &Pieces, count: [usize; 3], stride: [usize; 3]) -> Row {
    let lowest: [usize; 3] =
        std::array::from_fn(|axis| pieces.first[axis].min(count[axis].saturating_sub(2)));
    let number = |at: [usize; 3]| at[0] * stride[0] + at[1] * stride[1] + at[2] * stride[2];
    let (mut part, mut more) = ([0.0; 8], Vec::new());
    let [nx, ny, _] = pieces.count;
    for (i, &volume) in pieces.volume.iter().enumerate().filter(|(_, volume)| **volume != 0.0) {
        let piece = [i % nx, i / nx % ny, i / nx / ny];
        let at: [usize; 3] = std::array::from_fn(|axis| pieces.first[axis] + piece[axis]);
        let near: [usize; 3] = std::array::from_fn(|axis| at[axis] - lowest[axis]);
        if near.iter().all(|&step| step < 2) {
            part[near[0] + 2 * near[1] + 4 * near[2]] = volume as f32;
        } else {
            more.push((number(at) as u32, volume));
        }
    }
    (number(lowest) as u32, part, more)
}
