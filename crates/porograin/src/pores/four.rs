//! Four numbers at once. Left to itself the compiler takes the loops over the pushes of a pore apart into pairs that lie far from each
//! other, and spends more time on moving them about than on arithmetic.

/// Four numbers.
pub trait Four: Copy {
    /// `65536 high + low`.
    fn whole(high: &[i32; 4], low: &[u16; 4]) -> Self;
    /// From memory.
    fn load(from: &[f64; 4]) -> Self;
    /// From two places in memory.
    fn pair(a: &[f64; 2], b: &[f64; 2]) -> Self;
    /// All the same.
    fn splat(value: f64) -> Self;
    /// Three of one kind, and the last of another.
    fn three_and(three: f64, last: f64) -> Self;
    /// The product.
    fn times(self, other: Self) -> Self;
    /// `self + a b`.
    fn add_product(self, a: Self, b: Self) -> Self;
    /// To memory.
    fn store(self, to: &mut [f64; 4]);
    /// The first two are added in one place in memory.
    fn add_low(self, to: &mut [f64; 2]);
    /// The last two are added in one place in memory.
    fn add_high(self, to: &mut [f64; 2]);
    /// The sum of the first with the third and the second with the fourth.
    fn sum(self) -> f64;
}

/// On any processor.
impl Four for [f64; 4] {
    #[inline(always)]
    fn whole(high: &[i32; 4], low: &[u16; 4]) -> Self {
        let one = |k: usize| f64::from(high[k]) * 65536.0 + f64::from(low[k]);
        [one(0), one(1), one(2), one(3)]
    }

    #[inline(always)]
    fn load(from: &[f64; 4]) -> Self {
        *from
    }

    #[inline(always)]
    fn pair(a: &[f64; 2], b: &[f64; 2]) -> Self {
        [a[0], a[1], b[0], b[1]]
    }

    #[inline(always)]
    fn splat(value: f64) -> Self {
        [value; 4]
    }

    #[inline(always)]
    fn three_and(three: f64, last: f64) -> Self {
        [three, three, three, last]
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        [self[0] * other[0], self[1] * other[1], self[2] * other[2], self[3] * other[3]]
    }

    #[inline(always)]
    fn add_product(self, a: Self, b: Self) -> Self {
        let one = |k: usize| self[k] + a[k] * b[k];
        [one(0), one(1), one(2), one(3)]
    }

    #[inline(always)]
    fn store(self, to: &mut [f64; 4]) {
        *to = self;
    }

    #[inline(always)]
    fn add_low(self, to: &mut [f64; 2]) {
        *to = [to[0] + self[0], to[1] + self[1]];
    }

    #[inline(always)]
    fn add_high(self, to: &mut [f64; 2]) {
        *to = [to[0] + self[2], to[1] + self[3]];
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        (self[0] + self[2]) + (self[1] + self[3])
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::Avx;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Four;
    use std::arch::x86_64::{
        __m256d, _mm_add_pd, _mm_add_sd, _mm_cvtepu16_epi32, _mm_cvtsd_f64, _mm_loadl_epi64, _mm_loadu_pd,
        _mm_loadu_si128, _mm_storeu_pd, _mm_unpackhi_pd, _mm256_blend_pd, _mm256_castpd128_pd256,
        _mm256_castpd256_pd128, _mm256_cvtepi32_pd, _mm256_extractf128_pd, _mm256_fmadd_pd,
        _mm256_insertf128_pd, _mm256_loadu_pd, _mm256_mul_pd, _mm256_set1_pd, _mm256_storeu_pd,
    };

    /// A register of AVX2 with FMA. To be used only inside functions that [`Avx::available`] guards.
    #[derive(Clone, Copy)]
    pub struct Avx(__m256d);

    impl Avx {
        /// Whether this processor can.
        pub fn available() -> bool {
            is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
        }
    }

    // SAFETY of all: the processor has the features (see `Avx`); references are valid for as many entries as are read or written.
    impl Four for Avx {
        #[inline(always)]
        fn whole(high: &[i32; 4], low: &[u16; 4]) -> Avx {
            unsafe {
                let high = _mm256_cvtepi32_pd(_mm_loadu_si128(high.as_ptr().cast()));
                let low = _mm256_cvtepi32_pd(_mm_cvtepu16_epi32(_mm_loadl_epi64(low.as_ptr().cast())));
                Avx(_mm256_fmadd_pd(high, _mm256_set1_pd(65536.0), low))
            }
        }

        #[inline(always)]
        fn load(from: &[f64; 4]) -> Avx {
            Avx(unsafe { _mm256_loadu_pd(from.as_ptr()) })
        }

        #[inline(always)]
        fn pair(a: &[f64; 2], b: &[f64; 2]) -> Avx {
            unsafe {
                let low = _mm256_castpd128_pd256(_mm_loadu_pd(a.as_ptr()));
                Avx(_mm256_insertf128_pd::<1>(low, _mm_loadu_pd(b.as_ptr())))
            }
        }

        #[inline(always)]
        fn splat(value: f64) -> Avx {
            Avx(unsafe { _mm256_set1_pd(value) })
        }

        #[inline(always)]
        fn three_and(three: f64, last: f64) -> Avx {
            Avx(unsafe { _mm256_blend_pd::<8>(_mm256_set1_pd(three), _mm256_set1_pd(last)) })
        }

        #[inline(always)]
        fn times(self, other: Avx) -> Avx {
            Avx(unsafe { _mm256_mul_pd(self.0, other.0) })
        }

        #[inline(always)]
        fn add_product(self, a: Avx, b: Avx) -> Avx {
            Avx(unsafe { _mm256_fmadd_pd(a.0, b.0, self.0) })
        }

        #[inline(always)]
        fn store(self, to: &mut [f64; 4]) {
            unsafe { _mm256_storeu_pd(to.as_mut_ptr(), self.0) }
        }

        #[inline(always)]
        fn add_low(self, to: &mut [f64; 2]) {
            unsafe {
                let sum = _mm_add_pd(_mm_loadu_pd(to.as_ptr()), _mm256_castpd256_pd128(self.0));
                _mm_storeu_pd(to.as_mut_ptr(), sum);
            }
        }

        #[inline(always)]
        fn add_high(self, to: &mut [f64; 2]) {
            unsafe {
                let sum = _mm_add_pd(_mm_loadu_pd(to.as_ptr()), _mm256_extractf128_pd::<1>(self.0));
                _mm_storeu_pd(to.as_mut_ptr(), sum);
            }
        }

        #[inline(always)]
        fn sum(self) -> f64 {
            unsafe {
                let two = _mm_add_pd(_mm256_castpd256_pd128(self.0), _mm256_extractf128_pd::<1>(self.0));
                _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
            }
        }
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    /// Everything at once, to be done with either.
    #[inline(always)]
    fn all<F: Four>() -> ([f64; 4], [f64; 2], f64) {
        let whole = F::whole(&[3, -3, i32::MAX, i32::MIN], &[1, 2, u16::MAX, 0]);
        let more = F::pair(&[0.5, 0.25], &[-1.0, 2.0]).times(F::three_and(2.0, 3.0));
        let (mut one, mut two) = ([0.0; 4], [16.0, 32.0]);
        more.add_product(whole, F::splat(0.5)).store(&mut one);
        let numbers = F::load(&[1.0, 2.0, 4.0, 8.0]);
        numbers.add_low(&mut two);
        numbers.times(F::splat(100.0)).add_high(&mut two);
        (one, two, whole.sum())
    }

    #[target_feature(enable = "avx2,fma")]
    fn all_avx() -> ([f64; 4], [f64; 2], f64) {
        all::<Avx>()
    }

    #[test]
    fn both_do_the_same() {
        let (one, two, sum) = all::<[f64; 4]>();
        let high = f64::from(i32::MAX) * 65536.0 + 65535.0;
        assert_eq!(one, [98305.5, -98302.5, 0.5 * high - 2.0, f64::from(i32::MIN) * 32768.0 + 6.0]);
        assert_eq!((two, sum), ([417.0, 834.0], 2.0));
        if Avx::available() {
            // SAFETY: the processor has the features, as just asked.
            assert_eq!(unsafe { all_avx() }, (one, two, sum));
        }
    }
}
