//! The entries of a matrix once more, for products: four of each row side by side, as many as most pores have throats. The rows then need no
//! loop whose end no processor foresees; what few rows have beyond four follows in a list.

use crate::vector::CHUNK;

/// Four entries of a row; where it has fewer, zeros of its own column.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Four {
    columns: [u32; 4],
    values: [f64; 4],
}

/// An entry of a row that has more than four.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Further {
    row: u32,
    column: u32,
    value: f64,
}

/// The entries off the diagonal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fours {
    fours: Vec<Four>,
    /// In rising order of rows.
    further: Vec<Further>,
    /// The first of each [`CHUNK`] of rows among `further`, and their number.
    starts: Vec<u32>,
}

impl Fours {
    /// Takes over the entries of all rows.
    pub fn refresh<'a>(&mut self, rows: impl Iterator<Item = (&'a [u32], &'a [f64])>) {
        self.fours.clear();
        self.further.clear();
        self.starts.clear();
        for (row, (columns, values)) in (0..).zip(rows) {
            if row as usize % CHUNK == 0 {
                self.starts.push(self.further.len() as u32);
            }
            let mut four = Four { columns: [row; 4], values: [0.0; 4] };
            for (k, (&column, &value)) in columns.iter().zip(values).enumerate() {
                match four.columns.get_mut(k) {
                    Some(place) => (*place, four.values[k]) = (column, value),
                    None => self.further.push(Further { row, column, value }),
                }
            }
            self.fours.push(four);
        }
        self.starts.push(self.further.len() as u32);
    }

    /// `y[i] = f(i, sum_j a_ij x_j)` for one chunk of rows, `f` being linear in the sum with the slope `sign`.
    #[inline(always)]
    pub fn chunk(&self, chunk: usize, x: &[f64], y: &mut [f64], sign: f64, f: impl Fn(usize, f64) -> f64) {
        let first = chunk * CHUNK;
        for (i, (y, four)) in (first..).zip(y.iter_mut().zip(&self.fours[first..])) {
            let [a, b, c, d] = four.columns;
            let (a, b) = (four.values[0] * x[a as usize], four.values[1] * x[b as usize]);
            let (c, d) = (four.values[2] * x[c as usize], four.values[3] * x[d as usize]);
            *y = f(i, (a + b) + (c + d));
        }
        for further in &self.further[self.starts[chunk] as usize..self.starts[chunk + 1] as usize] {
            y[further.row as usize - first] += sign * (further.value * x[further.column as usize]);
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.fours) + size_of_val(&*self.further)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Matrix, Operator};

    #[test]
    fn hubs_in_any_chunk_are_multiplied_whole() {
        // A chain of 9000 nodes, in which some are tied to up to six more.
        let n = 9000u32;
        let ties =
            [0, 4095, 4096, 8999].into_iter().flat_map(|hub| (1..=6).map(move |k| [hub, hub / 2 + 40 * k]));
        let ends: Vec<[u32; 2]> = (1..n).map(|i| [i - 1, i]).chain(ties).collect();
        let g: Vec<f64> = (0..ends.len()).map(|k| 1.0 + (k % 7) as f64).collect();
        let matrix = Matrix::new(n as usize, &ends, &g, &vec![0.5; n as usize]).unwrap();
        let x: Vec<f64> = (0..n).map(|i| f64::from(i * i % 101)).collect();
        let mut expected: Vec<f64> = x.iter().map(|x| 0.5 * x).collect();
        for (&[i, j], g) in ends.iter().zip(&g) {
            let flux = g * (x[i as usize] - x[j as usize]);
            expected[i as usize] += flux;
            expected[j as usize] -= flux;
        }
        let mut y = vec![0.0; n as usize];
        (&matrix).apply(&x, &mut y);
        assert_eq!(y, expected, "whole and half numbers add up exactly");
        let mut r = vec![0.0; n as usize];
        let (b, mut sums) = (vec![1.0; n as usize], Vec::new());
        let [rr, bb] = (&matrix).residual(&b, &x, &mut r, &mut sums);
        assert!((0..n as usize).all(|i| r[i] == 1.0 - expected[i]));
        assert_eq!(bb, 9000.0);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((rr / dot(&r, &r) - 1.0).abs() < 1e-14);
        let found = (&matrix).apply_dots(&x, &b, &mut r, &mut sums);
        for (found, expected) in found.into_iter().zip([dot(&x, &r), dot(&b, &r), dot(&r, &r)]) {
            assert!((found - expected).abs() < 1e-13 * dot(&r, &r), "{found} {expected}");
        }
        assert_eq!(r, expected);
    }
}
