//! Eight numbers at once. Left to itself the compiler vectorises the loops of the triangular solves across the wrong index and
//! spends most of their time on transpositions, so they are written in terms of this.

/// Numbers in a register.
pub const LANES: usize = 8;
/// Eight numbers in memory.
pub type Lanes = [f32; LANES];
/// Eight numbers in half precision, as bits.
pub type Halves = [u16; LANES];

/// Eight numbers in single precision.
pub trait Eight: Copy {
    /// From memory.
    fn load(from: &Lanes) -> Self;
    /// From half precision.
    fn widen(from: &Halves) -> Self;
    /// All the same.
    fn splat(value: f32) -> Self;
    /// `self + a b`.
    fn add_product(self, a: Self, b: Self) -> Self;
    /// To memory.
    fn store(self, to: &mut Lanes);
}

/// Half to single precision, for numbers that are not negative and below 65536.
#[inline(always)]
fn wide(half: u16) -> f32 {
    let shift = f32::from_bits((127 + 112) << 23);
    f32::from_bits(u32::from(half) << 13) * shift
}

/// The half precision number nearest to one between 0 and 65504, ties away from zero. Anything below 0 becomes 0.
pub fn narrow(value: f64) -> u16 {
    let shift = f32::from_bits((127 - 112) << 23);
    let bits = (value.max(0.0) as f32 * shift).to_bits();
    ((bits + (1 << 12)) >> 13) as u16
}

/// On any processor.
impl Eight for Lanes {
    #[inline(always)]
    fn load(from: &Lanes) -> Lanes {
        *from
    }

    #[inline(always)]
    fn widen(from: &Halves) -> Lanes {
        from.map(wide)
    }

    #[inline(always)]
    fn splat(value: f32) -> Lanes {
        [value; LANES]
    }

    #[inline(always)]
    fn add_product(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|lane| self[lane] + a[lane] * b[lane])
    }

    #[inline(always)]
    fn store(self, to: &mut Lanes) {
        *to = self;
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::Avx;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Eight, Halves, Lanes};
    use std::arch::x86_64::{
        __m256, _mm_loadu_si128, _mm256_cvtph_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_set1_ps,
        _mm256_storeu_ps,
    };

    /// A register of AVX2 with FMA and F16C. To be used only inside functions that [`Avx::available`] guards.
    #[derive(Clone, Copy)]
    pub struct Avx(__m256);

    impl Avx {
        /// Whether this processor can.
        pub fn available() -> bool {
            is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("f16c")
        }
    }

    // SAFETY of all: the processor has the features (see `Avx`); references are valid for their eight entries.
    impl Eight for Avx {
        #[inline(always)]
        fn load(from: &Lanes) -> Avx {
            Avx(unsafe { _mm256_loadu_ps(from.as_ptr()) })
        }

        #[inline(always)]
        fn widen(from: &Halves) -> Avx {
            Avx(unsafe { _mm256_cvtph_ps(_mm_loadu_si128(from.as_ptr().cast())) })
        }

        #[inline(always)]
        fn splat(value: f32) -> Avx {
            Avx(unsafe { _mm256_set1_ps(value) })
        }

        #[inline(always)]
        fn add_product(self, a: Avx, b: Avx) -> Avx {
            Avx(unsafe { _mm256_fmadd_ps(a.0, b.0, self.0) })
        }

        #[inline(always)]
        fn store(self, to: &mut Lanes) {
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_hold_eleven_bits_and_widen_alike_everywhere() {
        assert_eq!([0.0, 1.0, 0.5, -3e-9].map(narrow), [0, 0x3c00, 0x3800, 0]);
        for k in 0..4000 {
            let value = (-0.004 * f64::from(k)).exp();
            let half = [narrow(value); LANES];
            let back = <Lanes as Eight>::widen(&half);
            // Below 2^-14 the last place stays at 2^-24.
            let bound = (value * 2f64.powi(-11)).max(2f64.powi(-25));
            assert!((f64::from(back[0]) - value).abs() <= bound, "{value} {}", back[0]);
            #[cfg(target_arch = "x86_64")]
            if Avx::available() {
                let mut there = [0.0; LANES];
                Avx::widen(&half).store(&mut there);
                assert_eq!(there, back);
            }
        }
    }
}
