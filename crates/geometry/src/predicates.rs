//! Exact orientation and power tests; ties are broken by an infinitesimal change of the metric.
//!
//! Both tests look at a pore from a *query* grain `e`. Each vertex of the pore is a row `(d, l)`: for a grain at `x`
//! with weight `w = r²`, `d = x - e` and `l = |d|² - w + w_e`; for a wall with outward normal `n`, `d = n` and
//! `l = 2 times the distance of e from the wall` (the limit of a sphere of infinite radius, which is why every row may
//! be scaled by a positive number). With the four determinants
//! `O_k = (-1)^k det(d of the three other rows, in order)`, which are the barycentric coordinates of `e`:
//!
//! - `O_k` has the sign of the side of facet `k` on which the query lies (positive: inside);
//! - the query is in *conflict* with the pore (below its lifted hyperplane) when `G = sum_k O_k l_k > 0`.
//!
//! Coordinates are whole numbers (see [`Frame`](crate::triangulation::frame::Frame)), so differences are exact in
//! `f64` and the exact stage is plain integer arithmetic.
//!
//! # Ties
//! The heights `|x|² - w` are replaced by `|x|² + sum_m eps_m q_m(x) - w + delta_i` with infinitesimals
//! `eps_1 >> eps_2 >> ... >> delta_n >> ... >> delta_0` and quadratic forms `q_m` spanning all of them: a power diagram in
//! an infinitesimally distorted metric. It does not know the numbering of the grains, adds only an affine function
//! under translation (so it is the same in every period), and cuts a cubic lattice into Kuhn's six tetrahedra. Five
//! rows that tie in all six forms contain two grains at the same place (Veronese embedding), which the `delta` separate:
//! the one with the higher index is hidden. In a partly periodic cell the forms that mix a periodic with a walled axis come
//! last: pores with walls are settled by the others, so the mixed ones are only met where they are translation invariant.

use crate::triangulation::lattice::Lattice;

/// A vertex of a pore seen from the query, in floating point (`d` exact, `l` rounded).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Row {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub l: f64,
    /// `|d|² + |w - w_e|`, of a wall `|d|² + l`: bounds `|d|²` and `l`.
    pub t: f64,
}

/// The row of a grain at the exact distance `d`, `dw = w - w_e`.
#[inline(always)]
pub(crate) fn grain_row(d: [f64; 3], dw: f64) -> Row {
    let s = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    Row { x: d[0], y: d[1], z: d[2], l: s - dw, t: s + dw.abs() }
}

/// The unit roundoff of `f64`.
const U: f64 = f64::EPSILON / 2.0;

/// `|error of a 3x3 determinant| <= ORIENTATION X Y Z`, X, Y, Z the largest entries of the columns: six
/// products, each rounded at most 5 times (product, difference, product, two sums), and 5 roundings of the bound: `6 * 10 u` is ample.
const ORIENTATION: f64 = 60.0 * U;

/// `|error of G| <= POWER X Y Z T`, T the largest `t`: 24 products, each rounded at most 14 times (product, difference,
/// product, two sums; four roundings in `l` relative to `t`, one in `t`; product and three sums), and the roundings of the bound itself: `24 * 14 u` plus ten
/// percent.
const POWER: f64 = 370.0 * U;

#[inline(always)]
fn max3(a: f64, b: f64, c: f64) -> f64 {
    let m = if a > b { a } else { b };
    if m > c { m } else { c }
}

/// `det(a, b, c)` of the `d` parts with a bound of its error.
#[inline(always)]
pub(crate) fn determinant(a: &Row, b: &Row, c: &Row) -> (f64, f64) {
    let value = a.x * (b.y * c.z - b.z * c.y) - a.y * (b.x * c.z - b.z * c.x) + a.z * (b.x * c.y - b.y * c.x);
    let bound = max3(a.x.abs(), b.x.abs(), c.x.abs())
        * max3(a.y.abs(), b.y.abs(), c.y.abs())
        * max3(a.z.abs(), b.z.abs(), c.z.abs());
    (value, ORIENTATION * bound)
}

/// `G` with a bound of its error.
#[inline(always)]
pub(crate) fn power(r: [&Row; 4]) -> (f64, f64) {
    let [a, b, c, d] = r;
    let ab = a.x * b.y - b.x * a.y;
    let ac = a.x * c.y - c.x * a.y;
    let ad = a.x * d.y - d.x * a.y;
    let bc = b.x * c.y - c.x * b.y;
    let bd = b.x * d.y - d.x * b.y;
    let cd = c.x * d.y - d.x * c.y;
    let abc = bc * a.z - ac * b.z + ab * c.z;
    let abd = bd * a.z - ad * b.z + ab * d.z;
    let acd = cd * a.z - ad * c.z + ac * d.z;
    let bcd = cd * b.z - bd * c.z + bc * d.z;
    let value = (bcd * a.l - acd * b.l) + (abd * c.l - abc * d.l);
    let max4 = |p: f64, q: f64, r: f64, s: f64| {
        let (m, n) = (if p > q { p } else { q }, if r > s { r } else { s });
        if m > n { m } else { n }
    };
    let bound = max4(a.x.abs(), b.x.abs(), c.x.abs(), d.x.abs())
        * max4(a.y.abs(), b.y.abs(), c.y.abs(), d.y.abs())
        * max4(a.z.abs(), b.z.abs(), c.z.abs(), d.z.abs())
        * max4(a.t, b.t, c.t, d.t);
    (value, POWER * bound)
}

/// `G` with the values of a quadratic form in the place of `l`, and a bound of its error.
fn power_of_form(r: &[Row; 4], form: &[i64; 6]) -> (f64, f64) {
    let f = form.map(|c| c as f64);
    let row = |r: &Row| Row {
        l: (f[0] * r.x * r.x + f[1] * r.y * r.y + f[2] * r.z * r.z)
            + (f[3] * r.x * r.y + f[4] * r.y * r.z + f[5] * r.z * r.x),
        ..*r
    };
    power([&row(&r[0]), &row(&r[1]), &row(&r[2]), &row(&r[3])])
}

/// The power sphere of a pore: centre (absolute) and power, so that a grain at `x` conflicts when
/// `|x - centre|² - w < power`; the power is not a number where the centre is too inaccurate to use.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sphere {
    pub centre: [f64; 3],
    pub power: f64,
}

/// The power test by cached spheres: a fast filter in front of [`power`].
///
/// A centre is accepted if its error per component is below `eps h`, `eps = 2^-26` and `h` a typical distance of
/// neighbours. With the centre wrong by `e` and the power chosen so that the newest vertex `q` lies on the sphere, the
/// test value of `x` is wrong by `2 (x - q)·e`, at most `2 sqrt(3) eps h (|x - c| + |q - c|)`. Both distances are
/// at most `sqrt(L)`, `L = |x - c|² + |power| + w_max` and `2 h sqrt(L) <= L + h²`, so that `2 sqrt(3) eps (L + h²)` bounds
/// it; rounding errors are `10 u L`, nine digits below.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Filter {
    accuracy: f64,
    /// `w_max + h²`.
    floor: f64,
}

impl Filter {
    const EPSILON: f64 = 1.0 / (1u64 << 26) as f64;

    /// For grains at a typical distance, with the largest weight.
    pub fn new(distance: f64, largest: f64) -> Self {
        Filter { accuracy: Self::EPSILON * distance, floor: largest + distance * distance }
    }

    /// The power sphere of the query and three rows, and whether the four are surely positively oriented.
    #[inline(always)]
    pub fn shape(&self, a: &Row, b: &Row, c: &Row, query: [f64; 4]) -> (Sphere, bool) {
        let bc = [b.y * c.z - b.z * c.y, b.z * c.x - b.x * c.z, b.x * c.y - b.y * c.x];
        let ca = [c.y * a.z - c.z * a.y, c.z * a.x - c.x * a.z, c.x * a.y - c.y * a.x];
        let ab = [a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x];
        let half = 0.5 / (a.x * bc[0] + a.y * bc[1] + a.z * bc[2]);
        // The centre from the query solves 2 d·centre = l for the three rows.
        let x = (a.l * bc[0] + b.l * ca[0] + c.l * ab[0]) * half;
        let y = (a.l * bc[1] + b.l * ca[1] + c.l * ab[1]) * half;
        let z = (a.l * bc[2] + b.l * ca[2] + c.l * ab[2]) * half;
        let square = x * x + y * y + z * z;
        let t = max3(a.t, b.t, c.t);
        // With all |d| and |l| below s and t: a component of the numerator has 6 products rounded at most 9 times, the
        // determinant an error of 60 u s³ (see above), so that 120 u (t + (|x| + |y| + |z|) s) s² |half| bounds that of the quotient; its
        // rounding is far less, and adding the query, whose coordinates are below 2^52, costs 1/2. As s² <= t for every row,
        // the bracket is at most 3/2 (t + x² + y² + z²).
        let error = (180.0 * U) * (t + square) * t * half.abs() + 0.5;
        let accurate = error < self.accuracy;
        let sphere = Sphere {
            centre: [query[0] + x, query[1] + y, query[2] + z],
            power: if accurate { square - query[3] } else { f64::NAN },
        };
        // The determinant is off by 120 u s³ |half| < accuracy / sqrt(t) of itself.
        (sphere, accurate && half > 0.0 && t > self.accuracy * self.accuracy)
    }

    /// The power sphere of the query and three rows.
    #[inline(always)]
    pub fn sphere(&self, a: &Row, b: &Row, c: &Row, query: [f64; 4]) -> Sphere {
        self.shape(a, b, c, query).0
    }

    /// `|x - centre|² - w - power` with a bound of its error, at the nearest image of the grain.
    #[inline(always)]
    pub fn power(&self, sphere: &Sphere, x: [f64; 4], lattice: &Lattice) -> (f64, f64) {
        let c = &sphere.centre;
        self.power_at(sphere, lattice.nearest([x[0] - c[0], x[1] - c[1], x[2] - c[2]]), x)
    }

    /// The same for a grain at `d` from the centre.
    #[inline(always)]
    pub fn power_at(&self, sphere: &Sphere, d: [f64; 3], x: [f64; 4]) -> (f64, f64) {
        let s = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        (s - (x[3] + sphere.power), (4.0 * Self::EPSILON) * (s + sphere.power.abs() + self.floor))
    }
}

/// A row in whole numbers: `|d| < 2^53`, `|l| < 2^122`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExactRow {
    pub d: [i64; 3],
    pub l: i128,
    /// The index of the grain; `None` for a wall.
    pub grain: Option<u32>,
}

/// The query of the exact stage.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExactQuery {
    /// Absolute coordinates, not negative along walled axes.
    pub place: [i64; 3],
    pub grain: u32,
}

/// The quadratic forms of the perturbation, as coefficients of `xx, yy, zz, xy, yz, zx`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Forms([[i64; 6]; 6]);

impl Forms {
    /// The forms for a cell with the given periodic axes.
    pub fn new(periodic: [bool; 3]) -> Self {
        // -(xy + yz + zx) first: it alone settles cubic lattices (Kuhn), and all axes are equal.
        let mut forms = [
            [0, 0, 0, -1, -1, -1],
            [1, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0],
            [0, 0, 0, 1, 0, 0],
            [0, 0, 0, 0, 1, 0],
        ];
        let crosses = [(0, 1), (1, 2), (2, 0)];
        if let Some(pure) = crosses.iter().position(|&(i, j)| periodic[i] == periodic[j])
            && periodic != [periodic[0]; 3]
        {
            // One axis differs: the cross term of the two others first, the two mixed ones last.
            forms[0] = [0; 6];
            forms[0][3 + pure] = -1;
            for (row, mixed) in [(pure + 1) % 3, (pure + 2) % 3].into_iter().enumerate() {
                forms[4 + row] = [0; 6];
                forms[4 + row][3 + mixed] = -1;
            }
        }
        Forms(forms)
    }
}

/// Whole numbers of the exact stage are written in base `2^61`: digits and sums of eight of their products fit machine
/// words, so that nothing is carried before the end.
const BASE: u32 = 61;
const DIGIT: i128 = (1 << BASE) - 1;

/// A whole number below `2^163`: all digits but the last are not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wide([i64; 3]);

impl Wide {
    /// `low + 2^61 high`, both below `2^117`.
    #[inline(always)]
    fn new(low: i128, high: i128) -> Self {
        let high = high + (low >> BASE);
        Wide([(low & DIGIT) as i64, (high & DIGIT) as i64, (high >> BASE) as i64])
    }

    fn sign(self) -> i32 {
        let [low, mid, high] = self.0;
        if high == 0 { i32::from(low | mid != 0) } else { high.signum() as i32 }
    }
}

/// `a.x b.y - b.x a.y`, below `2^107`.
#[inline(always)]
fn minor(a: &[i64; 3], b: &[i64; 3]) -> i128 {
    i128::from(a[0]) * i128::from(b[1]) - i128::from(b[0]) * i128::from(a[1])
}

/// `det(a, b, c)` from the minors `bc`, `ac`, `ab` of the first two columns and `a.z`, `-b.z`, `c.z`.
#[inline(always)]
fn expanded(minors: [i128; 3], z: [i64; 3]) -> Wide {
    let (mut low, mut high) = (0i128, 0i128);
    for k in 0..3 {
        let z = i128::from(z[k]);
        low += i128::from((minors[k] & DIGIT) as i64) * z;
        high += i128::from((minors[k] >> BASE) as i64) * z;
    }
    Wide::new(low, high)
}

/// `det(a, b, c)`.
fn cubic(a: &[i64; 3], b: &[i64; 3], c: &[i64; 3]) -> Wide {
    expanded([minor(b, c), minor(a, c), minor(a, b)], [a[2], -b[2], c[2]])
}

/// A sum of up to four products, its digits carried only when the sign is asked for.
#[derive(Default)]
struct Sum([i128; 4]);

impl Sum {
    /// Adds `sign * o * l`, `|o| < 2^163`, `|l| < 2^123`.
    #[inline(always)]
    fn add(&mut self, sign: i128, o: Wide, l: i128) {
        let l = sign * l;
        let (low, high) = (i128::from((l & DIGIT) as i64), i128::from((l >> BASE) as i64));
        let [a, b, c] = [i128::from(o.0[0]), i128::from(o.0[1]), i128::from(o.0[2])];
        self.0[0] += a * low;
        self.0[1] += a * high + b * low;
        self.0[2] += b * high + c * low;
        self.0[3] += c * high;
    }

    fn sign(&self) -> i32 {
        let (mut carry, mut any) = (0i128, 0i128);
        for digit in &self.0[..3] {
            let s = digit + carry;
            any |= s & DIGIT;
            carry = s >> BASE;
        }
        let top = self.0[3] + carry;
        if top != 0 { top.signum() as i32 } else { i32::from(any != 0) }
    }
}

impl Sum {
    /// The sum rounded to a floating-point number (a few roundings).
    fn value(&self) -> f64 {
        let sign = self.sign();
        let (mut carry, mut value) = (0i128, 0.0);
        for (k, digit) in self.0.iter().enumerate() {
            let s = i128::from(sign) * digit + carry;
            carry = s >> BASE;
            value += (s & DIGIT) as f64 * 2f64.powi((BASE * k as u32) as i32);
        }
        f64::from(sign) * (value + carry as f64 * 2f64.powi(4 * BASE as i32))
    }
}

/// The centre of the power sphere of the query and three rows, from the query: exact up to a few roundings.
pub(crate) fn centre_exact(rows: [&ExactRow; 3]) -> [f64; 3] {
    let [a, b, c] = rows;
    let mut determinant = Sum::default();
    determinant.add(1, cubic(&a.d, &b.d, &c.d), 2);
    let determinant = determinant.value();
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| {
        let mut sum = Sum::default();
        for (row, p, q) in [(a, b, c), (b, c, a), (c, a, b)] {
            let minor = i128::from(p.d[i]) * i128::from(q.d[j]) - i128::from(p.d[j]) * i128::from(q.d[i]);
            sum.add(1, Wide::new(minor, 0), row.l);
        }
        sum.value() / determinant
    })
}

/// The sign of the barycentric coordinate `O_k` of the query.
#[cold]
pub(crate) fn side_exact(k: usize, others: [&[i64; 3]; 3]) -> i32 {
    let sign = cubic(others[0], others[1], others[2]).sign();
    if k % 2 == 0 { sign } else { -sign }
}

/// Whether the query is in conflict with a positively oriented pore, ties broken as the module says; `float` are the same rows.
#[cold]
pub(crate) fn conflict_exact(
    rows: &[ExactRow; 4],
    float: &[Row; 4],
    query: &ExactQuery,
    forms: &Forms,
) -> bool {
    let [a, b, c, d] = [&rows[0].d, &rows[1].d, &rows[2].d, &rows[3].d];
    let (ab, ac, ad) = (minor(a, b), minor(a, c), minor(a, d));
    let (bc, bd, cd) = (minor(b, c), minor(b, d), minor(c, d));
    let o = [
        expanded([cd, bd, bc], [b[2], -c[2], d[2]]),
        expanded([cd, ad, ac], [a[2], -c[2], d[2]]),
        expanded([bd, ad, ab], [a[2], -b[2], d[2]]),
        expanded([bc, ac, ab], [a[2], -b[2], c[2]]),
    ];
    let sign = |k: usize| if k % 2 == 0 { 1 } else { -1 };
    let mut sum = Sum::default();
    for k in 0..4 {
        sum.add(sign(k), o[k], rows[k].l);
    }
    match sum.sign() {
        0 => {}
        sign => return sign > 0,
    }
    // Without a wall the sums are translation invariant: coordinates relative to the query do.
    let walled = rows.iter().any(|r| r.grain.is_none());
    let e = if walled { query.place.map(i128::from) } else { [0; 3] };
    for form in &forms.0 {
        if !walled {
            // Rarely a tie too: `|q(d)| <= |d|²`, with no more roundings than `l`.
            let (value, bound) = power_of_form(float, form);
            if value.abs() > bound {
                return value > 0.0;
            }
        }
        let mut sum = Sum::default();
        for k in (0..4).filter(|&k| rows[k].grain.is_some()) {
            let [x, y, z] = rows[k].d.map(i128::from);
            // q(e + d) - q(e), term by term.
            let terms = [
                x * (x + 2 * e[0]),
                y * (y + 2 * e[1]),
                z * (z + 2 * e[2]),
                x * (y + e[1]) + e[0] * y,
                y * (z + e[2]) + e[1] * z,
                z * (x + e[0]) + e[2] * x,
            ];
            // Coefficients are 0 and ±1.
            let mut value = 0i128;
            for (&c, t) in form.iter().zip(terms) {
                value += if c > 0 { t } else { 0 } - if c < 0 { t } else { 0 };
            }
            sum.add(sign(k), o[k], value);
        }
        match sum.sign() {
            0 => {}
            sign => return sign > 0,
        }
    }
    // The query coincides with a grain of the same weight: the one with the higher index is hidden.
    rows.iter().any(|r| r.d == [0; 3] && r.grain.is_some_and(|g| g > query.grain))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laplace(rows: &[Vec<i128>]) -> i128 {
        if rows.len() == 1 {
            return rows[0][0];
        }
        (0..rows.len())
            .map(|c| {
                let minor: Vec<Vec<i128>> = rows[1..]
                    .iter()
                    .map(|r| r.iter().enumerate().filter(|(k, _)| *k != c).map(|(_, v)| *v).collect())
                    .collect();
                (if c % 2 == 0 { 1 } else { -1 }) * rows[0][c] * laplace(&minor)
            })
            .sum()
    }

    struct Dice(u64);
    impl Dice {
        fn roll(&mut self, bits: u32) -> i64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> (64 - bits)) as i64 - (1 << (bits - 1))
        }
    }

    /// The sums of products agree with a Laplace expansion where that fits 128 bits, also after scaling rows to full width.
    #[test]
    fn wide_sums_agree_with_laplace_expansion() {
        let mut dice = Dice(7);
        let mut signs = [0; 3];
        for trial in 0..20_000 {
            let bits = 2 + trial % 18;
            let rows: Vec<[i64; 4]> = (0..4)
                .map(|_| [dice.roll(bits), dice.roll(bits), dice.roll(bits), dice.roll(2 * bits)])
                .collect();
            let wide: Vec<Vec<i128>> =
                rows.iter().map(|r| r.iter().map(|&v| i128::from(v)).collect()).collect();
            // D = -G, see the module documentation.
            let expected = -(laplace(&wide).signum() as i32);
            for shift in [0, 52 - bits] {
                let exact: Vec<ExactRow> = rows
                    .iter()
                    .map(|r| ExactRow {
                        d: [r[0] << shift, r[1] << shift, r[2] << shift],
                        l: i128::from(r[3]) << (2 * shift),
                        grain: Some(0),
                    })
                    .collect();
                let mut sum = Sum::default();
                for k in 0..4 {
                    let rest: Vec<&[i64; 3]> = (0..4).filter(|&j| j != k).map(|j| &exact[j].d).collect();
                    let o = cubic(rest[0], rest[1], rest[2]);
                    assert_eq!(
                        side_exact(k, [rest[0], rest[1], rest[2]]),
                        o.sign() * if k % 2 == 0 { 1 } else { -1 }
                    );
                    sum.add(if k % 2 == 0 { 1 } else { -1 }, o, exact[k].l);
                }
                assert_eq!(sum.sign(), expected);
            }
            signs[(expected + 1) as usize] += 1;
            let float: Vec<Row> = rows
                .iter()
                .map(|r| Row {
                    x: r[0] as f64,
                    y: r[1] as f64,
                    z: r[2] as f64,
                    l: r[3] as f64,
                    t: (r[3] as f64).abs(),
                })
                .collect();
            let (value, bound) = power([&float[0], &float[1], &float[2], &float[3]]);
            if value.abs() > bound {
                assert_eq!(value.signum() as i32, expected);
            }
        }
        assert!(signs.iter().all(|&s| s > 20), "the trial must meet both signs and ties: {signs:?}");
    }
}
