//! Wide registers for the passes over grains: four double numbers at a time.

use super::corners::Share;
use super::passes::Four;
use glam::DVec3;
use std::arch::x86_64::{
    __m256d, _mm_cvtepu16_epi32, _mm_loadu_si128, _mm_srli_si128, _mm256_cvtepi32_pd, _mm256_loadu_pd,
    _mm256_maskload_pd, _mm256_setr_epi64x, _mm256_storeu_pd,
};

/// Whether the processor can do what the functions in wide registers need. The others give the same bits.
pub fn wide() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

/// The parts of a grain in double precision.
#[inline]
#[target_feature(enable = "avx2")]
pub fn parts(share: &Share) -> [f64; 8] {
    let mut out = [0.0; 8];
    // SAFETY: there are eight numbers, and room for as many.
    unsafe {
        let eight = _mm_loadu_si128(share.part.as_ptr().cast());
        let (low, high) = (_mm_cvtepu16_epi32(eight), _mm_cvtepu16_epi32(_mm_srli_si128::<8>(eight)));
        _mm256_storeu_pd(out.as_mut_ptr(), _mm256_cvtepi32_pd(low));
        _mm256_storeu_pd(out.as_mut_ptr().add(4), _mm256_cvtepi32_pd(high));
    }
    out
}

/// Three numbers and a zero.
#[inline]
#[target_feature(enable = "avx2")]
pub fn load_three(from: &DVec3) -> __m256d {
    // SAFETY: what the mask leaves out, beyond z, is not touched.
    unsafe { _mm256_maskload_pd(std::ptr::from_ref(from).cast(), _mm256_setr_epi64x(-1, -1, -1, 0)) }
}

/// Four numbers.
#[inline]
#[target_feature(enable = "avx2")]
pub fn load(from: &Four) -> __m256d {
    // SAFETY: there are four numbers.
    unsafe { _mm256_loadu_pd(from.as_ptr()) }
}

/// Puts four numbers back.
#[inline]
#[target_feature(enable = "avx2")]
pub fn store(to: &mut Four, values: __m256d) {
    // SAFETY: there is room for four numbers.
    unsafe { _mm256_storeu_pd(to.as_mut_ptr(), values) }
}
