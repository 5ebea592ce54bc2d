//! Grain size distributions: their quantiles, how sizes are drawn, and how well a sample follows.

use serde::{Deserialize, Serialize};

/// Points at which means over a grading are taken.
const POINTS: usize = 20_000;
/// Radii that differ by this part are equal: rounding.
const SAME: f64 = 1e-9;
/// Normal and log-normal gradings end at so many deviations on either side.
const TAIL: f64 = 3.0;
/// The part of a normal distribution below `-TAIL` deviations.
const BELOW_TAIL: f64 = 1.349_898_031_630_094_6e-3;

/// How grain sizes are distributed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Grading {
    /// Radii uniform, by number, within `mean (1 ± spread)`.
    Uniform {
        /// At least 0 and less than 1.
        spread: f64,
    },
    /// Radii normal, by number, with the deviation as a part of the mean, cut at three deviations.
    Normal {
        /// At least 0 and less than 1/3.
        deviation: f64,
    },
    /// Radii log-normal, by number, about their median: `deviation` of the natural logarithm, cut at three deviations.
    LogNormal {
        /// At least 0.
        deviation: f64,
    },
    /// A sieve table: diameters [m] in rising order, and the part of the mass that passes, from 0 to 1; straight lines
    /// in between.
    Sieve(Vec<[f64; 2]>),
}

impl Grading {
    /// The radius below which the part `u` of the grains lies, by number: of a sieve table [m], else over the mean or median.
    pub fn radius(&self, u: f64) -> f64 {
        match self {
            Grading::Uniform { spread } => 1.0 + spread * (2.0 * u - 1.0),
            Grading::Normal { deviation } => 1.0 + deviation * cut_normal(u),
            Grading::LogNormal { deviation } => (deviation * cut_normal(u)).exp(),
            Grading::Sieve(table) => 0.5 * sieved(table, u),
        }
    }

    /// Whether its radii are in metres and not relative.
    pub fn is_absolute(&self) -> bool {
        matches!(self, Grading::Sieve(_))
    }

    /// `count` radii, in the unit of [`radius`](Self::radius). One is drawn from each of `count` equal parts of the
    /// distribution, so that even a small sample has its few large grains; of a uniform one each is drawn
    /// independently.
    pub fn draw(&self, count: usize, mut uniform: impl FnMut() -> f64) -> Vec<f64> {
        let part = |k: usize, u: f64| match self {
            Grading::Uniform { .. } => u,
            _ => (k as f64 + u) / count as f64,
        };
        (0..count).map(|k| self.radius(part(k, uniform()))).collect()
    }

    /// Mean of the cubed radius, by number.
    pub fn mean_cube(&self) -> f64 {
        self.points().map(|r| r * r * r).sum::<f64>() / POINTS as f64
    }

    /// The largest difference between the curves of passing mass of these radii and of the grading [-], each seen by
    /// shape alone unless the grading is absolute: relative ones are first brought to the same mean volume.
    pub fn difference(&self, radii: &[f64]) -> f64 {
        let mut sizes = radii.to_vec();
        sizes.sort_by(f64::total_cmp);
        let cubes = |sizes: &[f64]| sizes.iter().map(|r| r * r * r).sum::<f64>();
        let total = cubes(&sizes);
        if total == 0.0 {
            return 0.0;
        }
        let scale =
            if self.is_absolute() { 1.0 } else { (self.mean_cube() / (total / sizes.len() as f64)).cbrt() };
        let asked_total = self.mean_cube() * POINTS as f64;
        let (mut asked, mut passed, mut passing, mut worst) = (self.points().peekable(), 0.0, 0.0, 0.0_f64);
        let same = |a: &f64, b: &f64| *b <= a * (1.0 + SAME);
        for equal in sizes.chunk_by(same) {
            let (size, r) = (equal[0], equal[0] * scale);
            // Where both curves are stairs the middles of their steps count.
            let mut pass = |up_to: f64| {
                while let Some(next) = asked.next_if(|&next| next <= up_to) {
                    passed += next * next * next / asked_total;
                }
                passed
            };
            let mut asked_here = 0.5 * (pass(r * (1.0 - SAME)) + pass(r * (1.0 + SAME)));
            if let Grading::Sieve(table) = self {
                asked_here = sieve_passing(table, 2.0 * r);
            }
            let mass = equal.len() as f64 * size * size * size / total;
            worst = worst.max((passing + 0.5 * mass - asked_here).abs());
            passing += mass;
        }
        worst
    }

    /// Radii at equal distances by number.
    fn points(&self) -> impl Iterator<Item = f64> + '_ {
        (0..POINTS).map(|k| self.radius((k as f64 + 0.5) / POINTS as f64))
    }
}

/// The diameter [m] below which the part `u` of the grains lies, by number. Mass is spread evenly over the diameters of a
/// class from `a` to `b` that holds the part `w`: the class has `w/(b - a) (a⁻² - b⁻²)/2` grains, of diameters
/// `(a⁻² - u (a⁻² - b⁻²))^(-1/2)` (up to a common factor).
fn sieved(table: &[[f64; 2]], u: f64) -> f64 {
    let classes = table.windows(2).map(|pair| {
        let [[a, below], [b, above]] = [pair[0], pair[1]];
        let fall = (a * a).recip() - (b * b).recip();
        (a, fall, (above - below) / (b - a) * 0.5 * fall)
    });
    let all: f64 = classes.clone().map(|class| class.2).sum();
    let mut left = u * all;
    let mut diameter = table[0][0];
    for (a, fall, number) in classes.filter(|class| class.2 > 0.0) {
        let part = (left / number).min(1.0);
        diameter = ((a * a).recip() - part * fall).sqrt().recip();
        if left <= number {
            break;
        }
        left -= number;
    }
    diameter
}

/// The part of the mass finer than a diameter [m].
fn sieve_passing(table: &[[f64; 2]], diameter: f64) -> f64 {
    match table.partition_point(|sieve| sieve[0] <= diameter) {
        0 => 0.0,
        k if k == table.len() => 1.0,
        k => {
            let [[a, below], [b, above]] = [table[k - 1], table[k]];
            below + (above - below) * (diameter - a) / (b - a)
        }
    }
}

/// Quantile of the normal distribution cut at [`TAIL`] deviations.
fn cut_normal(u: f64) -> f64 {
    normal(BELOW_TAIL + u.clamp(0.0, 1.0) * (1.0 - 2.0 * BELOW_TAIL)).clamp(-TAIL, TAIL)
}

/// Quantile of the normal distribution, to 1.2e-9 of its value (P. J. Acklam's rational approximation).
fn normal(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969683028665376e1,
        2.209460984245205e2,
        -2.759285104469687e2,
        1.38357751867269e2,
        -3.066479806614716e1,
        2.506628277459239,
    ];
    const B: [f64; 6] = [
        -5.447609879822406e1,
        1.615858368580409e2,
        -1.556989798598866e2,
        6.680131188771972e1,
        -1.328068155288572e1,
        1.0,
    ];
    const C: [f64; 6] = [
        -7.784894002430293e-3,
        -3.223964580411365e-1,
        -2.400758277161838,
        -2.549732539343734,
        4.374664141464968,
        2.938163982698783,
    ];
    const D: [f64; 5] =
        [7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996, 3.754408661907416, 1.0];
    let value = |coefficients: &[f64], x: f64| coefficients.iter().fold(0.0, |sum, c| sum * x + c);
    let tail = |p: f64| {
        let q = (-2.0 * p.ln()).sqrt();
        value(&C, q) / value(&D, q)
    };
    const EDGE: f64 = 0.02425;
    if p < EDGE {
        tail(p)
    } else if p > 1.0 - EDGE {
        -tail(1.0 - p)
    } else {
        let (q, r) = (p - 0.5, (p - 0.5) * (p - 0.5));
        q * value(&A, r) / value(&B, r)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg64;
    use rand_pcg::rand_core::RngCore;

    fn uniform() -> impl FnMut() -> f64 {
        let mut random = Pcg64::new(3, 5);
        move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Quantiles of the normal distribution from tables.
    #[test]
    fn normal_quantiles() {
        for (p, x) in
            [(0.5, 0.0), (0.841344746068543, 1.0), (0.975, 1.959963984540054), (0.01, -2.326347874040841)]
        {
            assert!((normal(p) - x).abs() < 1e-8, "{p} {}", normal(p));
        }
        assert!((normal(BELOW_TAIL) + TAIL).abs() < 1e-8);
    }

    #[test]
    fn mean_cubes_are_those_of_closed_forms() {
        // Of 1 ± s: 1 + s². Of a normal one: 1 + 3 s², with the variance of the cut distribution.
        let uniform = Grading::Uniform { spread: 0.4 };
        assert!((uniform.mean_cube() - 1.16).abs() < 1e-6);
        let cut = 1.0
            - 2.0 * TAIL * (-0.5 * TAIL * TAIL).exp()
                / (std::f64::consts::TAU.sqrt() * (1.0 - 2.0 * BELOW_TAIL));
        let normal = Grading::Normal { deviation: 0.2 };
        assert!((normal.mean_cube() - (1.0 + 3.0 * 0.04 * cut)).abs() < 1e-6, "{}", normal.mean_cube());
        // Of a sieve class from a to b: mass over number, 2 (b - a)/(a⁻² - b⁻²), of the diameters.
        let sieve = Grading::Sieve(vec![[1.0, 0.0], [3.0, 1.0]]);
        let expected = 2.0 * 2.0 / (1.0 - 1.0 / 9.0) / 8.0;
        assert!((sieve.mean_cube() / expected - 1.0).abs() < 1e-6);
    }

    /// Passing masses of a sample at the sieves, against the table.
    #[test]
    fn a_sample_passes_the_sieves_as_the_table_says() {
        let table = vec![[0.5e-3, 0.0], [1e-3, 0.3], [1.5e-3, 0.3], [2e-3, 0.8], [4e-3, 1.0]];
        let grading = Grading::Sieve(table.clone());
        // Of 200 grains two are coarser than 2 mm, each a tenth of the mass.
        for count in [200, 20_000] {
            let radii = grading.draw(count, uniform());
            let total: f64 = radii.iter().map(|r| r.powi(3)).sum();
            let tolerance = if count == 200 { 0.1 } else { 3e-4 };
            for [sieve, passing] in &table {
                let passed: f64 =
                    radii.iter().filter(|&&r| 2.0 * r <= *sieve * (1.0 + 1e-12)).map(|r| r.powi(3)).sum();
                assert!((passed / total - passing).abs() < tolerance, "{count} {sieve} {}", passed / total);
            }
            assert!(!radii.iter().any(|r| (1.0001e-3..1.4999e-3).contains(&(2.0 * r))), "no mass, no grain");
            // Between the sieves too: one draw in each part leaves less than a grain too many or too few above any size, which
            // shifts the curve and the total it is divided by, each by less than the coarsest grain.
            let coarsest = radii.iter().fold(0.0, |a: f64, &r| a.max(r)).powi(3) / total;
            let difference = grading.difference(&radii);
            assert!(difference < 2.0 * coarsest && difference > 0.0, "{difference} {coarsest}");
            // Grains a tenth too large are noticed.
            let larger: Vec<f64> = radii.iter().map(|r| 1.1 * r).collect();
            assert!(grading.difference(&larger) > 0.1);
        }
    }

    #[test]
    fn equal_grains_have_the_grading_of_equal_grains() {
        for radius in [1.0, 0.1, 3.7e-3] {
            let difference = Grading::Uniform { spread: 0.0 }.difference(&[radius; 150]);
            assert!(difference < 1e-9, "{difference}");
        }
        let half = [[1.0; 100], [2.0; 100]].concat();
        // Of the mass one ninth is small: in the middle of its step 1/18, where nothing should pass, and of the large ones 5/9.
        let difference = Grading::Uniform { spread: 0.0 }.difference(&half);
        assert!((0.4..0.6).contains(&difference), "{difference}");
    }

    #[test]
    fn relative_gradings_are_compared_by_shape() {
        for grading in [
            Grading::Uniform { spread: 0.3 },
            Grading::Normal { deviation: 0.2 },
            Grading::LogNormal { deviation: 0.4 },
        ] {
            let radii: Vec<f64> = grading.draw(5000, uniform()).iter().map(|r| 7.0 * r).collect();
            let difference = grading.difference(&radii);
            assert!(difference < 0.03, "{grading:?} {difference}");
            assert!(Grading::Uniform { spread: 0.9 }.difference(&radii) > 0.1);
        }
    }
}
