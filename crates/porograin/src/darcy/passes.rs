//! The two passes over the grains in a step: sums of their velocities around the corners of the cells, and what pressures and
//! drag around the corners do to them.

use super::corners::{Corners, Share};
#[cfg(target_arch = "x86_64")]
use super::wide::{load, load_three, parts, store, wide};
use glam::DVec3;
use rayon::prelude::*;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256d, _mm_cvtsd_f64, _mm_loadu_ps, _mm_storeu_pd, _mm_storeu_ps, _mm256_add_pd, _mm256_broadcast_sd,
    _mm256_castpd256_pd128, _mm256_cvtpd_ps, _mm256_cvtps_pd, _mm256_extractf128_pd, _mm256_fmadd_pd,
    _mm256_fnmadd_pd, _mm256_mul_pd, _mm256_permute4x64_pd, _mm256_set1_pd, _mm256_setzero_pd,
};
use std::ops::Range;

/// Three numbers and a spare one.
pub type Four = [f64; 4];

/// What there is around a corner, per volume of grain; one line of the cache.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Field {
    /// Pull of the pressures [N/m³], and the resistance r to motion against the other grains [kg/(m³ s)].
    pub pull: Four,
    /// r times the mean velocity of the grains [N/m³].
    pub drag: Four,
}

/// The pull of the pressures on a grain [N] and a spare number. It only serves to foresee, so that single precision does.
pub type Pull = [f32; 4];

/// Grains handed to a thread at once.
const BLOCK: usize = 512;
/// Corners handed to a thread at once.
const CORNERS: usize = 64;

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

    /// Some of them.
    fn of(self, range: Range<usize>) -> Moving<'a> {
        Moving { velocity: &self.velocity[range.clone()], mass: &self.mass[range], ..self }
    }

    /// `v + kick/m (force + pulled)` of a grain.
    #[inline(always)]
    fn foresee(&self, k: usize, force: DVec3, [x, y, z, _]: Pull) -> Four {
        let (v, by) = (self.velocity[k], self.kick / self.mass[k]);
        let [x, y, z] = [x, y, z].map(f64::from);
        [by.mul_add(force.x + x, v.x), by.mul_add(force.y + y, v.y), by.mul_add(force.z + z, v.z), 0.0]
    }

    /// The same, to the bit.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn foresee_wide(&self, k: usize, force: &DVec3, pulled: &Pull) -> __m256d {
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

impl<'a> Foreseen<'a> {
    /// Of some of the grains.
    fn of(self, range: Range<usize>) -> Foreseen<'a> {
        let (force, pulled) = (&self.force[range.clone()], &self.pulled[range.clone()]);
        Foreseen { moving: self.moving.of(range), force, pulled }
    }

    /// The velocity of a grain, times what a part of 1 of it stands for.
    #[inline(always)]
    fn per_part(&self, k: usize, share: &Share) -> Four {
        let v = self.moving.foresee(k, self.force[k], self.pulled[k]);
        v.map(|v| f64::from(share.unit) * v)
    }

    /// The same, to the bit.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn per_part_wide(&self, k: usize, share: &Share) -> __m256d {
        let v = self.moving.foresee_wide(k, &self.force[k], &self.pulled[k]);
        _mm256_mul_pd(_mm256_set1_pd(f64::from(share.unit)), v)
    }

    /// Writes those of all grains.
    fn put(&self, share: &[Share], value: &mut [Four]) {
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.put_wide(share, value) };
        }
        let each = value.iter_mut().zip(share).enumerate();
        each.for_each(|(k, (value, share))| *value = self.per_part(k, share));
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn put_wide(self, share: &[Share], value: &mut [Four]) {
        let foreseen = self.of(0..share.len());
        for (k, (value, share)) in value.iter_mut().zip(share).enumerate() {
            store(value, foreseen.per_part_wide(k, share));
        }
    }
}

impl Corners {
    /// `sum of V_k v_k` over the grains around each corner, V_k the part of each there. Every sum adds its grains in one order,
    /// whether they are scattered (one thread) or gathered; for gathering the `v_k` are kept in `value`.
    pub fn sums(&self, foreseen: &Foreseen, value: &mut Vec<Four>, sums: &mut Vec<Four>) {
        sums.clear();
        sums.resize(self.len(), [0.0; 4]);
        if rayon::current_num_threads() == 1 {
            self.scatter(foreseen, sums);
            for &(k, corner, part) in &self.beyond {
                let v = foreseen.per_part(k as usize, &self.share[k as usize]);
                add(&mut sums[corner as usize], f64::from(part), v);
            }
        } else {
            value.resize(self.grains(), [0.0; 4]);
            (value.par_chunks_mut(BLOCK), self.share.par_chunks(BLOCK)).into_par_iter().enumerate().for_each(
                |(block, (value, share))| {
                    let start = block * BLOCK;
                    foreseen.of(start..start + share.len()).put(share, value);
                },
            );
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
        for (k, share) in self.share.iter().enumerate() {
            let v = foreseen.per_part(k, share);
            for (row, part) in rows.iter().zip(share.part.as_chunks::<2>().0) {
                for (sum, &part) in sums[share.first as usize + row..][..2].iter_mut().zip(part) {
                    add(sum, f64::from(part), v);
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn scatter_wide(&self, foreseen: &Foreseen, sums: &mut [Four]) {
        assert_eq!(sums.len(), self.len());
        let (rows, foreseen) = (self.rows(), foreseen.of(0..self.grains()));
        for (k, share) in self.share.iter().enumerate() {
            let (v, part) = (foreseen.per_part_wide(k, share), parts(share));
            for (row, part) in rows.iter().zip(part.as_chunks::<2>().0) {
                let from = share.first as usize + row;
                // SAFETY: no share reaches beyond the last corner (`Corners::new` sees to it). Checks take a quarter of the time.
                let pair = unsafe { sums.get_unchecked_mut(from..from + 2) };
                for (sum, part) in pair.iter_mut().zip(part) {
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
            for (&k, &part) in self.grain[around.clone()].iter().zip(&self.part[around]) {
                add(sum, f64::from(part), value[k as usize]);
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn gather_wide(&self, start: usize, value: &[Four], sums: &mut [Four]) {
        for (corner, sum) in sums.iter_mut().enumerate() {
            let around = self.around(start + corner);
            let mut all = load(sum);
            for (&k, &part) in self.grain[around.clone()].iter().zip(&self.part[around]) {
                all = _mm256_fmadd_pd(_mm256_set1_pd(f64::from(part)), load(&value[k as usize]), all);
            }
            store(sum, all);
        }
    }

    /// Where the grains around a corner are listed.
    fn around(&self, corner: usize) -> Range<usize> {
        self.starts[corner] as usize..self.starts[corner + 1] as usize
    }

    /// Sums the field over the corners around each grain, each by the part of the grain there: the pull of the pressures takes
    /// the place of `pulled`, pull and drag together are added to `force`. The drag is that at the velocities [`Foreseen`]
    /// from `force` and `pulled` as they come in.
    pub fn load(&self, field: &[Field], moving: &Moving, pulled: &mut [Pull], force: &mut [DVec3]) {
        let before = |&(k, ..): &(u32, u32, f32)| {
            let k = k as usize;
            moving.foresee(k, force[k], pulled[k])
        };
        let before: Vec<Four> = self.beyond.iter().map(before).collect();
        (pulled.par_chunks_mut(BLOCK), force.par_chunks_mut(BLOCK)).into_par_iter().enumerate().for_each(
            |(block, (pulled, force))| {
                let range = block * BLOCK..block * BLOCK + force.len();
                self.load_near(range, field, moving, pulled, force);
            },
        );
        for (&(k, corner, part), v) in self.beyond.iter().zip(before) {
            let (k, Field { pull, drag }) = (k as usize, field[corner as usize]);
            let volume = f64::from(part) * f64::from(self.share[k].unit);
            let more = |lane: usize| volume * (pull[lane] + (drag[lane] - pull[3] * v[lane]));
            force[k] += DVec3::new(more(0), more(1), more(2));
            for lane in 0..3 {
                pulled[k][lane] += (volume * pull[lane]) as f32;
            }
        }
    }

    /// What the eight corners of each of some grains do.
    fn load_near(
        &self,
        range: Range<usize>,
        field: &[Field],
        moving: &Moving,
        pulled: &mut [Pull],
        force: &mut [DVec3],
    ) {
        let (share, moving) = (&self.share[range.clone()], moving.of(range));
        #[cfg(target_arch = "x86_64")]
        if wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.load_wide(share, field, &moving, pulled, force) };
        }
        let rows = self.rows();
        for (k, (share, (pulled, force))) in share.iter().zip(pulled.iter_mut().zip(force)).enumerate() {
            // By turns, so that sums do not wait for each other.
            let mut sums = [Field::default(); 2];
            for (row, part) in rows.iter().zip(share.part.as_chunks::<2>().0) {
                let pair = &field[share.first as usize + row..][..2];
                for ((field, &part), sum) in pair.iter().zip(part).zip(&mut sums) {
                    add(&mut sum.pull, f64::from(part), field.pull);
                    add(&mut sum.drag, f64::from(part), field.drag);
                }
            }
            let ([a, b], unit) = (sums, f64::from(share.unit));
            let pull: Four = std::array::from_fn(|lane| unit * (a.pull[lane] + b.pull[lane]));
            let drag: Four = std::array::from_fn(|lane| unit * (a.drag[lane] + b.drag[lane]));
            let v = moving.foresee(k, *force, *pulled);
            let total = |lane: usize| pull[lane] + (-pull[3]).mul_add(v[lane], drag[lane]);
            *force += DVec3::new(total(0), total(1), total(2));
            *pulled = pull.map(|pull| pull as f32);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn load_wide(
        &self,
        share: &[Share],
        field: &[Field],
        moving: &Moving,
        pulled: &mut [Pull],
        force: &mut [DVec3],
    ) {
        assert_eq!(field.len(), self.len());
        let (rows, moving) = (self.rows(), moving.of(0..share.len()));
        let (pulled, force) = (&mut pulled[..share.len()], &mut force[..share.len()]);
        for k in 0..share.len() {
            let (share, pulled, force) = (&share[k], &mut pulled[k], &mut force[k]);
            let (before, v) = (load_three(force), moving.foresee_wide(k, force, pulled));
            let (mut pull, mut drag) = ([_mm256_setzero_pd(); 2], [_mm256_setzero_pd(); 2]);
            let part = parts(share);
            for (row, part) in rows.iter().zip(part.as_chunks::<2>().0) {
                let from = share.first as usize + row;
                // SAFETY: as in `scatter_wide`.
                let pair = unsafe { field.get_unchecked(from..from + 2) };
                for side in 0..2 {
                    let (part, field) = (_mm256_broadcast_sd(&part[side]), &pair[side]);
                    pull[side] = _mm256_fmadd_pd(part, load(&field.pull), pull[side]);
                    drag[side] = _mm256_fmadd_pd(part, load(&field.drag), drag[side]);
                }
            }
            let unit = _mm256_set1_pd(f64::from(share.unit));
            let pull = _mm256_mul_pd(unit, _mm256_add_pd(pull[0], pull[1]));
            let drag = _mm256_mul_pd(unit, _mm256_add_pd(drag[0], drag[1]));
            let resistance = _mm256_permute4x64_pd::<0xff>(pull);
            let total = _mm256_add_pd(pull, _mm256_fnmadd_pd(resistance, v, drag));
            let after = _mm256_add_pd(before, total);
            // SAFETY: there is room for four single numbers, and for two double ones from x on.
            unsafe {
                _mm_storeu_ps(pulled.as_mut_ptr(), _mm256_cvtpd_ps(pull));
                _mm_storeu_pd(std::ptr::from_mut(force).cast(), _mm256_castpd256_pd128(after));
            }
            force.z = _mm_cvtsd_f64(_mm256_extractf128_pd::<1>(after));
        }
    }
}

#[inline]
fn add(sum: &mut Four, part: f64, value: Four) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum = part.mul_add(value, *sum);
    }
}
