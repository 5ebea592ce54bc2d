//! Vector kernels whose sums do not depend on the number of threads: each chunk of [`CHUNK`] entries is summed on its
//! own and the chunk sums are added in order.

use rayon::prelude::*;

/// Entries per chunk.
pub const CHUNK: usize = 4096;
/// Shorter vectors stay on the calling thread: handing out the work would cost more than the work.
const ALONE: usize = 1 << 13;

/// Whether the calling thread works on `n` numbers alone.
pub fn alone(n: usize) -> bool {
    n < ALONE || rayon::current_num_threads() == 1
}

/// `y[i] = f(i)`.
pub fn each<T: Send>(y: &mut [T], f: impl Fn(usize) -> T + Sync) {
    by_part(y, CHUNK, |start, y| y.iter_mut().enumerate().for_each(|(k, y)| *y = f(start + k)));
}

/// Scratch for the sums of the chunks.
pub type Sums = Vec<[f64; 2]>;

fn total(sums: &Sums) -> [f64; 2] {
    sums.iter().fold([0.0; 2], |s, c| [s[0] + c[0], s[1] + c[1]])
}

/// Adds up `f(range)` over the chunks of `0..n`.
fn reduce(n: usize, sums: &mut Sums, f: impl Fn(std::ops::Range<usize>) -> [f64; 2] + Sync) -> [f64; 2] {
    sums.resize(n.div_ceil(CHUNK), [0.0; 2]);
    let chunk = |c: usize| f(c * CHUNK..n.min((c + 1) * CHUNK));
    if alone(n) {
        sums.iter_mut().enumerate().for_each(|(c, s)| *s = chunk(c));
    } else {
        sums.par_iter_mut().enumerate().for_each(|(c, s)| *s = chunk(c));
    }
    total(sums)
}

/// Sum of `f(k)` over `0..n` in eight interleaved partial sums, which the compiler turns into vector registers.
#[inline(always)]
fn interleaved(n: usize, f: impl Fn(usize) -> f64) -> f64 {
    let mut part = [0.0f64; 8];
    let whole = n - n % 8;
    let mut k = 0;
    while k < whole {
        for lane in 0..8 {
            part[lane] += f(k + lane);
        }
        k += 8;
    }
    for k in whole..n {
        part[k % 8] += f(k);
    }
    part.iter().sum()
}

/// `a · b`.
pub fn dot(a: &[f64], b: &[f64], sums: &mut Sums) -> f64 {
    reduce(a.len(), sums, |range| {
        let (a, b) = (&a[range.clone()], &b[range]);
        [interleaved(a.len(), |k| a[k] * b[k]), 0.0]
    })[0]
}

/// `[z · r, z · q]`.
pub fn dots(z: &[f64], r: &[f64], q: &[f64], sums: &mut Sums) -> [f64; 2] {
    reduce(z.len(), sums, |range| {
        let (z, r, q) = (&z[range.clone()], &r[range.clone()], &q[range]);
        [interleaved(z.len(), |k| z[k] * r[k]), interleaved(z.len(), |k| z[k] * q[k])]
    })
}

/// `y = f(range)` by chunks, adding up `sum(range, y)` while the chunk is at hand.
pub fn each_and_sum(
    y: &mut [f64],
    sums: &mut Sums,
    f: impl Fn(usize) -> f64 + Sync,
    sum: impl Fn(std::ops::Range<usize>, &[f64]) -> f64 + Sync,
) -> f64 {
    sums.resize(y.len().div_ceil(CHUNK), [0.0; 2]);
    let chunk = |(c, (s, y)): (usize, (&mut [f64; 2], &mut [f64]))| {
        let start = c * CHUNK;
        y.iter_mut().enumerate().for_each(|(k, y)| *y = f(start + k));
        *s = [sum(start..start + y.len(), y), 0.0];
    };
    if alone(y.len()) {
        sums.iter_mut().zip(y.chunks_mut(CHUNK)).enumerate().for_each(chunk);
    } else {
        sums.par_iter_mut().zip(y.par_chunks_mut(CHUNK)).enumerate().for_each(chunk);
    }
    total(sums)[0]
}

/// `a · b` of one chunk.
#[inline(always)]
pub fn chunk_dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    interleaved(n, |k| a[k] * b[k])
}

/// `r = b - r`, returning `r · r`.
pub fn residual(b: &[f64], r: &mut [f64], sums: &mut Sums) -> f64 {
    sums.resize(b.len().div_ceil(CHUNK), [0.0; 2]);
    let chunk = |(b, r): (&[f64], &mut [f64])| {
        r.iter_mut().zip(b).for_each(|(r, b)| *r = b - *r);
        [interleaved(r.len(), |k| r[k] * r[k]), 0.0]
    };
    if alone(b.len()) {
        sums.iter_mut().zip(b.chunks(CHUNK).zip(r.chunks_mut(CHUNK))).for_each(|(s, c)| *s = chunk(c));
    } else {
        sums.par_iter_mut()
            .zip(b.par_chunks(CHUNK).zip(r.par_chunks_mut(CHUNK)))
            .for_each(|(s, c)| *s = chunk(c));
    }
    total(sums)[0]
}

/// `x += alpha p` and `r -= alpha q`, returning `r · r`.
pub fn advance(alpha: f64, p: &[f64], q: &[f64], x: &mut [f64], r: &mut [f64], sums: &mut Sums) -> f64 {
    sums.resize(x.len().div_ceil(CHUNK), [0.0; 2]);
    let chunk = |p: &[f64], q: &[f64], x: &mut [f64], r: &mut [f64]| {
        x.iter_mut().zip(p).for_each(|(x, p)| *x += alpha * p);
        r.iter_mut().zip(q).for_each(|(r, q)| *r -= alpha * q);
        [interleaved(r.len(), |k| r[k] * r[k]), 0.0]
    };
    if alone(x.len()) {
        let parts = p.chunks(CHUNK).zip(q.chunks(CHUNK)).zip(x.chunks_mut(CHUNK)).zip(r.chunks_mut(CHUNK));
        sums.iter_mut().zip(parts).for_each(|(s, (((p, q), x), r))| *s = chunk(p, q, x, r));
    } else {
        let parts = p
            .par_chunks(CHUNK)
            .zip(q.par_chunks(CHUNK))
            .zip(x.par_chunks_mut(CHUNK))
            .zip(r.par_chunks_mut(CHUNK));
        sums.par_iter_mut().zip(parts).for_each(|(s, (((p, q), x), r))| *s = chunk(p, q, x, r));
    }
    total(sums)[0]
}

/// `p = z + beta p`.
pub fn direction(beta: f64, z: &[f64], p: &mut [f64]) {
    let step = |(p, z): (&mut [f64], &[f64])| p.iter_mut().zip(z).for_each(|(p, z)| *p = z + beta * *p);
    if alone(p.len()) {
        step((p, z));
    } else {
        p.par_chunks_mut(CHUNK).zip(z.par_chunks(CHUNK)).for_each(step);
    }
}

/// The power of two that brings the largest entry between one and two, for a copy in single precision, which has few
/// exponents; nothing if all entries are zero or one is infinite.
pub fn power_below(r: &[f64]) -> Option<f64> {
    let larger = |a: f64, b: f64| if a > b { a } else { b };
    let chunk = |r: &[f64]| {
        let mut most = [0.0f64; 8];
        let (whole, last) = r.as_chunks::<8>();
        for r in whole {
            for lane in 0..8 {
                most[lane] = larger(r[lane].abs(), most[lane]);
            }
        }
        most.iter().fold(last.iter().fold(0.0, |most, r| larger(r.abs(), most)), |a, &b| larger(a, b))
    };
    let largest =
        if alone(r.len()) { chunk(r) } else { r.par_chunks(CHUNK).map(chunk).reduce(|| 0.0, larger) };
    (largest > 0.0 && largest.is_finite()).then(|| largest.log2().floor().exp2().recip())
}

/// Calls `f(first, part)` on the parts of `y`, `length` entries each (the last one shorter).
pub fn by_part<T: Send>(y: &mut [T], length: usize, f: impl Fn(usize, &mut [T]) + Sync) {
    if alone(y.len()) {
        y.chunks_mut(length).enumerate().for_each(|(k, y)| f(k * length, y));
    } else {
        y.par_chunks_mut(length).enumerate().for_each(|(k, y)| f(k * length, y));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_compute_what_they_say() {
        for n in [0, 1, 7, 5000, 70_000] {
            let v = |s: f64| (0..n).map(|i| ((i as f64 + s) * 0.37).sin()).collect::<Vec<f64>>();
            let (a, b, c) = (v(0.0), v(1.0), v(2.0));
            let plain = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            let close = |x: f64, y: f64| assert!((x - y).abs() <= 1e-12 * n as f64, "{x} {y}");
            let mut sums = Sums::new();
            close(dot(&a, &b, &mut sums), plain(&a, &b));
            let [ab, ac] = dots(&a, &b, &c, &mut sums);
            close(ab, plain(&a, &b));
            close(ac, plain(&a, &c));
            let mut r = c.clone();
            let rr = residual(&b, &mut r, &mut sums);
            assert!((0..n).all(|i| r[i] == b[i] - c[i]));
            close(rr, plain(&r, &r));
            let (mut x, mut s) = (a.clone(), b.clone());
            let ss = advance(0.5, &b, &c, &mut x, &mut s, &mut sums);
            assert!((0..n).all(|i| x[i] == a[i] + 0.5 * b[i] && s[i] == b[i] - 0.5 * c[i]));
            close(ss, plain(&s, &s));
            direction(2.0, &a, &mut x);
            assert!((0..n).all(|i| x[i] == a[i] + 2.0 * (a[i] + 0.5 * b[i])));
        }
    }
}
