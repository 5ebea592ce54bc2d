//! The pushes of all pores, packed: every step reads them twice, and nothing else in it moves as many bytes.
//!
//! A number takes six bytes instead of eight: a whole multiple, below 2⁴⁶, of a unit that the forces of a pore have in common, and
//! another one that its torques have. So it is off by 10⁻¹⁴ of the largest in the pore at most, like the sums it comes from.

use super::coupling::Push;
use super::four::Four;

/// Binary digits of the largest number of a pore.
const DIGITS: i32 = 46;
/// Units are no smaller than two to this.
const LEAST: i32 = -1000;

/// What the pressure of each pore does to each of its vertices.
#[derive(Clone, Debug, Default)]
pub struct Pushes(Vec<Packed>);

/// The four pushes of a pore: whole numbers, each taken apart into what is above 2¹⁶ and the rest.
#[derive(Clone, Copy, Debug)]
pub struct Packed {
    /// Three components of the force on each vertex and the first one of its torque; the other two of the torque, of two vertices
    /// at a time.
    high: [[i32; 4]; 6],
    low: [[u16; 4]; 6],
    /// The units of forces and torques are two to these.
    exponents: [i16; 2],
}

/// Where a component of the force, then the torque on a vertex is.
fn place(vertex: usize, component: usize) -> [usize; 2] {
    if component < 4 { [vertex, component] } else { [4 + vertex / 2, 2 * (vertex % 2) + component - 4] }
}

impl Pushes {
    /// Packs those of each pore.
    pub fn new(pushes: &[[Push; 4]]) -> Pushes {
        Pushes(pushes.iter().map(Packed::new).collect())
    }

    /// None yet, and room for so many pores.
    pub fn with_room(pores: usize) -> Pushes {
        Pushes(Vec::with_capacity(pores))
    }

    /// Packs those of the next pores.
    pub fn extend(&mut self, pushes: &[[Push; 4]]) {
        self.0.extend(pushes.iter().map(Packed::new));
    }

    /// Those of a pore.
    pub fn of(&self, pore: usize) -> [Push; 4] {
        let packed = &self.0[pore];
        let [force, torque] = packed.units();
        let number = |vertex: usize, component: usize| {
            let [row, column] = place(vertex, component);
            let whole = <[f64; 4]>::whole(&packed.high[row], &packed.low[row])[column];
            whole * if component < 3 { force } else { torque }
        };
        std::array::from_fn(|vertex| Push(std::array::from_fn(|component| number(vertex, component))))
    }

    /// Those of all pores.
    pub fn all(&self) -> &[Packed] {
        &self.0
    }
}

/// Pores that are packed at once.
const PILE: usize = 1 << 14;

/// Pushes that throats, in the order of their first pores, add to. Unpacked they would be the largest part of a mesh: a pile of pores is
/// there from when it is first added to until no throat of theirs is left.
pub struct Piles {
    piles: Vec<Vec<[Push; 4]>>,
    pores: usize,
    /// How many were taken.
    taken: usize,
}

impl Piles {
    /// For so many pores.
    pub fn new(pores: usize) -> Piles {
        Piles { piles: vec![Vec::new(); pores.div_ceil(PILE)], pores, taken: 0 }
    }

    /// Those of a pore that is not taken yet.
    #[inline]
    pub fn of(&mut self, pore: usize) -> &mut [Push; 4] {
        let (pile, place) = (pore / PILE, pore % PILE);
        if self.piles[pile].is_empty() {
            self.piles[pile] = vec![Default::default(); PILE.min(self.pores - pile * PILE)];
        }
        &mut self.piles[pile][place]
    }

    /// Takes the next pile, with its first pore, if the pores up to `done` are.
    pub fn next(&mut self, done: usize) -> Option<(usize, Vec<[Push; 4]>)> {
        let first = self.taken * PILE;
        if first >= self.pores || done < (first + PILE).min(self.pores) {
            return None;
        }
        self.of(first);
        self.taken += 1;
        Some((first, std::mem::take(&mut self.piles[self.taken - 1])))
    }
}

impl Packed {
    fn new(pushes: &[Push; 4]) -> Packed {
        let largest = |of: std::ops::Range<usize>| {
            pushes.iter().flat_map(|push| &push.0[of.clone()]).fold(0.0, largest)
        };
        let exponents = [0..3, 3..6].map(|of| (exponent(largest(of)) + 1 - DIGITS).max(LEAST) as i16);
        let mut packed = Packed { high: [[0; 4]; 6], low: [[0; 4]; 6], exponents };
        let [force, torque] = packed.units();
        for (vertex, Push(push)) in pushes.iter().enumerate() {
            for (component, number) in push.iter().enumerate() {
                let whole = (number / if component < 3 { force } else { torque }).round() as i64;
                let [row, column] = place(vertex, component);
                packed.high[row][column] = (whole >> 16) as i32;
                packed.low[row][column] = whole as u16;
            }
        }
        packed
    }

    /// Forces and the first components of torques of the four vertices, then the others, two vertices at a time; in terms of the
    /// [units](Self::units).
    #[inline(always)]
    pub fn row<F: Four>(&self, row: usize) -> F {
        F::whole(&self.high[row], &self.low[row])
    }

    /// The unit of the forces [m²] and of the torques [m³].
    #[inline(always)]
    pub fn units(&self) -> [f64; 2] {
        let unit = |exponent: i16| f64::from_bits(((1023 + i64::from(exponent)) as u64) << 52);
        [unit(self.exponents[0]), unit(self.exponents[1])]
    }
}

fn largest(a: f64, b: &f64) -> f64 {
    a.max(b.abs())
}

/// The power of two at or below a positive number.
fn exponent(number: f64) -> i32 {
    (number.to_bits() >> 52) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_keeps_fourteen_digits_of_the_largest() {
        let mut numbers = [0.0f64; 24];
        for scale in [1.0, 1e-9, 1e12] {
            for (k, number) in numbers.iter_mut().enumerate() {
                let torque = if k % 6 < 3 { 1.0 } else { 1e-4 };
                *number = (1.7 * k as f64).sin() * torque * scale;
            }
            // As large as a number can be beside a power of two.
            numbers[0] = -scale * (1.0 - f64::EPSILON);
            let pushes = std::array::from_fn(|k| Push(std::array::from_fn(|m| numbers[6 * k + m])));
            let found = Pushes::new(&[pushes, [Push::default(); 4]]);
            for (k, push) in found.of(0).iter().enumerate() {
                for m in 0..6 {
                    let largest = scale * if m < 3 { 1.0 } else { 1e-4 };
                    let error = (push.0[m] - numbers[6 * k + m]).abs();
                    assert!(error <= 2e-14 * largest, "{k} {m}: {error:e}");
                }
            }
            assert_eq!(found.of(1), [Push::default(); 4]);
        }
    }

    #[test]
    fn piles_hold_what_throats_add_until_it_is_packed() {
        let pores = 2 * PILE + 3;
        let throats = |first: usize| [first, first + 1, first + PILE, first + 2 * PILE];
        let push = |first: usize, second: usize| Push([(first + 2 * second) as f64; 6]);
        let mut whole = vec![[Push::default(); 4]; pores];
        let (mut piles, mut packed) = (Piles::new(pores), Pushes::with_room(pores));
        for first in 0..pores {
            if first % 1000 == 0 {
                while let Some((start, pile)) = piles.next(first) {
                    assert_eq!(start, packed.all().len());
                    packed.extend(&pile);
                }
                assert_eq!(packed.all().len(), first / PILE * PILE);
            }
            for second in throats(first).into_iter().filter(|&second| second < pores && first % 7 > 0) {
                for pore in [first, second] {
                    whole[pore][pore % 4] += push(first, second);
                    piles.of(pore)[pore % 4] += push(first, second);
                }
            }
        }
        while let Some((_, pile)) = piles.next(pores) {
            packed.extend(&pile);
        }
        assert_eq!(packed.all().len(), pores);
        let expected = Pushes::new(&whole);
        assert!((0..pores).all(|pore| packed.of(pore) == expected.of(pore)));
        assert!(Piles::new(0).next(0).is_none());
    }
}
