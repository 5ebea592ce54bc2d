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

/// Room for the sums of the chunks of a vector, up to three at a time.
pub type Sums = Vec<[f64; 3]>;

fn total(sums: &Sums) -> [f64; 3] {
    sums.iter().fold([0.0; 3], |s, c| [s[0] + c[0], s[1] + c[1], s[2] + c[2]])
}

/// Adds up `f(range)` over the chunks of `0..n`.
fn reduce(n: usize, sums: &mut Sums, f: impl Fn(std::ops::Range<usize>) -> [f64; 3] + Sync) -> [f64; 3] {
    sums.resize(n.div_ceil(CHUNK), [0.0; 3]);
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
        [interleaved(a.len(), |k| a[k] * b[k]), 0.0, 0.0]
    })[0]
}

/// `[p · q, r · q, q · q]`.
pub fn three_dots(p: &[f64], r: &[f64], q: &[f64], sums: &mut Sums) -> [f64; 3] {
    reduce(q.len(), sums, |range| chunk_dots(&p[range.clone()], &r[range.clone()], &q[range]))
}

/// `[p · q, r · q, q · q]` of one chunk.
#[inline(always)]
pub fn chunk_dots(p: &[f64], r: &[f64], q: &[f64]) -> [f64; 3] {
    [chunk_dot(p, q), chunk_dot(r, q), chunk_dot(q, q)]
}

/// `y[i] = f(i)`, adding up `sum(range, y)` while a chunk is at hand.
pub fn each_and_sum(
    y: &mut [f64],
    sums: &mut Sums,
    f: impl Fn(usize) -> f64 + Sync,
    sum: impl Fn(std::ops::Range<usize>, &[f64]) -> [f64; 3] + Sync,
) -> [f64; 3] {
    chunks_and_sum(y, sums, |c, y| {
        let start = c * CHUNK;
        y.iter_mut().enumerate().for_each(|(k, y)| *y = f(start + k));
        sum(start..start + y.len(), y)
    })
}

/// Adds up `f(c, y)` over the chunks of `y`.
pub fn chunks_and_sum(
    y: &mut [f64],
    sums: &mut Sums,
    f: impl Fn(usize, &mut [f64]) -> [f64; 3] + Sync,
) -> [f64; 3] {
    sums.resize(y.len().div_ceil(CHUNK), [0.0; 3]);
    let chunk = |(c, (s, y)): (usize, (&mut [f64; 3], &mut [f64]))| *s = f(c, y);
    if alone(y.len()) {
        sums.iter_mut().zip(y.chunks_mut(CHUNK)).enumerate().for_each(chunk);
    } else {
        sums.par_iter_mut().zip(y.par_chunks_mut(CHUNK)).enumerate().for_each(chunk);
    }
    total(sums)
}

/// `a · b` of one chunk.
#[inline(always)]
pub fn chunk_dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    interleaved(n, |k| a[k] * b[k])
}

/// `r = b - r`, returning `[r · r, b · b]`.
pub fn residual(b: &[f64], r: &mut [f64], sums: &mut Sums) -> [f64; 2] {
    sums.resize(b.len().div_ceil(CHUNK), [0.0; 3]);
    let chunk = |(b, r): (&[f64], &mut [f64])| {
        r.iter_mut().zip(b).for_each(|(r, b)| *r = b - *r);
        [chunk_dot(r, r), chunk_dot(b, b), 0.0]
    };
    if alone(b.len()) {
        sums.iter_mut().zip(b.chunks(CHUNK).zip(r.chunks_mut(CHUNK))).for_each(|(s, c)| *s = chunk(c));
    } else {
        sums.par_iter_mut()
            .zip(b.par_chunks(CHUNK).zip(r.par_chunks_mut(CHUNK)))
            .for_each(|(s, c)| *s = chunk(c));
    }
    let [rr, bb, _] = total(sums);
    [rr, bb]
}

/// `x += alpha p` and `r -= alpha q`, returning `r · r`.
pub fn advance(alpha: f64, p: &[f64], q: &[f64], x: &mut [f64], r: &mut [f64], sums: &mut Sums) -> f64 {
    sums.resize(x.len().div_ceil(CHUNK), [0.0; 3]);
    let chunk = |p: &[f64], q: &[f64], x: &mut [f64], r: &mut [f64]| {
        x.iter_mut().zip(p).for_each(|(x, p)| *x += alpha * p);
        r.iter_mut().zip(q).for_each(|(r, q)| *r -= alpha * q);
        [interleaved(r.len(), |k| r[k] * r[k]), 0.0, 0.0]
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

/// `x += alpha p`.
pub fn add(alpha: f64, p: &[f64], x: &mut [f64]) {
    pairwise(p, x, |p, x| *x += alpha * p);
}

/// `p = z + beta p`.
pub fn direction(beta: f64, z: &[f64], p: &mut [f64]) {
    pairwise(z, p, |z, p| *p = z + beta * *p);
}

/// Calls `f` with each entry of `from` and of `to`.
fn pairwise(from: &[f64], to: &mut [f64], f: impl Fn(f64, &mut f64) + Sync) {
    let chunk =
        |(to, from): (&mut [f64], &[f64])| to.iter_mut().zip(from).for_each(|(to, &from)| f(from, to));
    if alone(to.len()) {
        chunk((to, from));
    } else {
        to.par_chunks_mut(CHUNK).zip(from.par_chunks(CHUNK)).for_each(chunk);
    }
}

/// The power of two that brings `size` between one and two, for a copy in single precision, which has few exponents; nothing if it is
/// zero or infinite.
pub fn power_below(size: f64) -> Option<f64> {
    (size > 0.0 && size.is_finite()).then(|| size.log2().floor().exp2().recip())
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
            let [ac, bc, cc] = three_dots(&a, &b, &c, &mut sums);
            close(ac, plain(&a, &c));
            close(bc, plain(&b, &c));
            close(cc, plain(&c, &c));
            let mut r = c.clone();
            let [rr, bb] = residual(&b, &mut r, &mut sums);
            assert!((0..n).all(|i| r[i] == b[i] - c[i]));
            close(rr, plain(&r, &r));
            close(bb, plain(&b, &b));
            let (mut x, mut s) = (a.clone(), b.clone());
            let ss = advance(0.5, &b, &c, &mut x, &mut s, &mut sums);
            assert!((0..n).all(|i| x[i] == a[i] + 0.5 * b[i] && s[i] == b[i] - 0.5 * c[i]));
            close(ss, plain(&s, &s));
            direction(2.0, &a, &mut x);
            assert!((0..n).all(|i| x[i] == a[i] + 2.0 * (a[i] + 0.5 * b[i])));
            let before = x.clone();
            add(0.5, &c, &mut x);
            assert!((0..n).all(|i| x[i] == before[i] + 0.5 * c[i]));
        }
    }
}
