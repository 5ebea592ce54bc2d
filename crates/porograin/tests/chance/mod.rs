//! Numbers that differ from sample to sample. Grains that slide and part are chaotic: another order of sums, another number of a
//! grain, gives another sample with the same seed, as different as one of another seed. What a case says is the mean over samples.

/// What is known of a number: its mean over samples of the case and the standard deviation of one sample.
#[derive(Clone, Copy)]
pub struct Known {
    pub mean: f64,
    pub deviation: f64,
    /// How many samples both were found from: seeds 1 on, half of them with the grains numbered in another way.
    pub samples: usize,
}

impl Known {
    /// Asserts that the mean over some samples differs from what is known by at most three standard deviations of that difference.
    pub fn holds(&self, what: &str, found: &[f64]) {
        let (mean, allowed) = (found.iter().sum::<f64>() / found.len() as f64, self.allowed(found.len()));
        assert!(
            (mean - self.mean).abs() < allowed,
            "{what}: {mean:e}, expected {:e} within {allowed:e}; the samples have {found:?}",
            self.mean
        );
    }

    /// The variance of a mean over so many samples and of the known mean, added.
    fn allowed(&self, found: usize) -> f64 {
        3.0 * self.deviation * (1.0 / found as f64 + 1.0 / self.samples as f64).sqrt()
    }
}
