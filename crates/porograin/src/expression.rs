//! Numbers given as formulas of place and time, such as `150*cos(pi*x/2)*sin(2*pi*t)`: compiled once to a short
//! program for a stack of fixed depth, evaluated without allocation.

use glam::DVec3;
use std::fmt;
use std::str::FromStr;

/// Intermediate results that a formula may need at once.
const DEPTH: usize = 32;

/// A formula of x, y, z [m] and t [s]. Two are equal if they are written alike.
#[derive(Clone)]
pub struct Expression {
    text: String,
    program: Vec<Op>,
}

/// What is wrong with a formula, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExpressionError {
    /// One sentence.
    pub sentence: String,
    /// First byte of what is wrong.
    pub start: usize,
    /// Number of bytes, 1 or more.
    pub length: usize,
}

/// One instruction of the program.
#[derive(Clone, Copy, Debug)]
enum Op {
    Number(f64),
    /// 0, 1, 2: x, y, z; 3: t.
    Variable(usize),
    Negate,
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    One(OfOne),
    Two(OfTwo),
}

const VARIABLES: [&str; 4] = ["x", "y", "z", "t"];
const CONSTANTS: [(&str, f64); 2] = [("pi", std::f64::consts::PI), ("e", std::f64::consts::E)];
type OfOne = fn(f64) -> f64;
type OfTwo = fn(f64, f64) -> f64;
const OF_ONE: [(&str, OfOne); 15] = [
    ("sin", f64::sin),
    ("cos", f64::cos),
    ("tan", f64::tan),
    ("asin", f64::asin),
    ("acos", f64::acos),
    ("atan", f64::atan),
    ("sinh", f64::sinh),
    ("cosh", f64::cosh),
    ("tanh", f64::tanh),
    ("exp", f64::exp),
    ("log", f64::ln),
    ("log10", f64::log10),
    ("sqrt", f64::sqrt),
    ("abs", f64::abs),
    ("step", |x| if x >= 0.0 { 1.0 } else { 0.0 }),
];
const OF_TWO: [(&str, OfTwo); 3] = [("min", f64::min), ("max", f64::max), ("atan2", f64::atan2)];

/// Every name a formula may use.
pub fn names() -> impl Iterator<Item = &'static str> {
    let constants = CONSTANTS.into_iter().map(|c| c.0);
    let functions = OF_ONE.into_iter().map(|f| f.0).chain(OF_TWO.into_iter().map(|f| f.0));
    VARIABLES.into_iter().chain(constants).chain(functions)
}

impl Expression {
    /// The value at `x` [m] and `t` [s].
    pub fn at(&self, x: DVec3, t: f64) -> f64 {
        let mut stack = [0.0; DEPTH];
        let mut top = 0;
        for &op in &self.program {
            match op {
                Op::Number(value) => {
                    stack[top] = value;
                    top += 1;
                }
                Op::Variable(k) => {
                    stack[top] = if k < 3 { x[k] } else { t };
                    top += 1;
                }
                Op::Negate => stack[top - 1] = -stack[top - 1],
                Op::One(function) => stack[top - 1] = function(stack[top - 1]),
                Op::Add | Op::Subtract | Op::Multiply | Op::Divide | Op::Power | Op::Two(_) => {
                    top -= 1;
                    let (a, b) = (stack[top - 1], stack[top]);
                    stack[top - 1] = match op {
                        Op::Add => a + b,
                        Op::Subtract => a - b,
                        Op::Multiply => a * b,
                        Op::Divide => a / b,
                        Op::Two(function) => function(a, b),
                        _ => a.powf(b),
                    };
                }
            }
        }
        stack[0]
    }

    /// Whether it depends on x, y or z.
    pub fn varies_in_space(&self) -> bool {
        self.program.iter().any(|op| matches!(op, Op::Variable(k) if *k < 3))
    }
}

impl fmt::Debug for Expression {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        fmt::Debug::fmt(&self.text, f)
    }
}

impl PartialEq for Expression {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}

/// Between the sentence of an error and where in the formula it is: serde carries nothing but text.
const AT: &str = " | formula ";

impl fmt::Display for ExpressionError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}{AT}{} {}", self.sentence, self.start, self.length)
    }
}

impl ExpressionError {
    /// An error again, of its text.
    pub fn read(text: &str) -> Option<Self> {
        let (sentence, place) = text.rsplit_once(AT)?;
        let (start, length) = place.split_once(' ')?;
        Some(ExpressionError {
            sentence: sentence.into(),
            start: start.parse().ok()?,
            length: length.parse().ok()?,
        })
    }
}

impl std::error::Error for ExpressionError {}

impl FromStr for Expression {
    type Err = ExpressionError;

    fn from_str(text: &str) -> Result<Self, ExpressionError> {
        let mut compiler = Compiler { text, place: 0, program: Vec::new(), depth: 0, nesting: 0 };
        compiler.sum()?;
        match compiler.next_byte() {
            None => Ok(Expression { text: text.to_owned(), program: compiler.program }),
            Some(b')') => Err(compiler.here("there is no `(` to this `)`")),
            Some(_) => Err(compiler.here("an operator such as + or * is missing here")),
        }
    }
}

/// Recursive descent: sum, product, sign, power, atom, each binding tighter than the one before.
struct Compiler<'a> {
    text: &'a str,
    place: usize,
    program: Vec<Op>,
    depth: usize,
    /// How deep the descent is; formulas are short, the stack of the machine is not endless.
    nesting: usize,
}

impl Compiler<'_> {
    /// The next byte that is not blank, without taking it.
    fn next_byte(&mut self) -> Option<u8> {
        let rest = &self.text[self.place..];
        self.place += rest.len() - rest.trim_start().len();
        self.text.as_bytes().get(self.place).copied()
    }

    fn take(&mut self, byte: u8) -> bool {
        let there = self.next_byte() == Some(byte);
        self.place += usize::from(there);
        there
    }

    fn here(&self, sentence: &str) -> ExpressionError {
        let length = self.text[self.place..].chars().next().map_or(1, char::len_utf8);
        ExpressionError { sentence: sentence.into(), start: self.place, length }
    }

    fn push(&mut self, op: Op, consumed: usize) -> Result<(), ExpressionError> {
        self.depth = self.depth + 1 - consumed;
        if self.depth > DEPTH {
            return Err(self.here(&format!("the formula needs more than {DEPTH} intermediate results")));
        }
        self.program.push(op);
        Ok(())
    }

    fn sum(&mut self) -> Result<(), ExpressionError> {
        self.product()?;
        loop {
            let op = match self.next_byte() {
                Some(b'+') => Op::Add,
                Some(b'-') => Op::Subtract,
                _ => return Ok(()),
            };
            self.place += 1;
            self.product()?;
            self.push(op, 2)?;
        }
    }

    fn product(&mut self) -> Result<(), ExpressionError> {
        self.sign()?;
        loop {
            let op = match self.next_byte() {
                Some(b'*') => Op::Multiply,
                Some(b'/') => Op::Divide,
                _ => return Ok(()),
            };
            self.place += 1;
            self.sign()?;
            self.push(op, 2)?;
        }
    }

    /// A sign binds looser than a power: -x^2 is -(x^2).
    fn sign(&mut self) -> Result<(), ExpressionError> {
        self.nesting += 1;
        if self.nesting > 4 * DEPTH {
            return Err(self.here("the formula is nested too deeply"));
        }
        let negative = self.take(b'-');
        if negative || self.take(b'+') {
            self.sign()?;
        } else {
            self.power()?;
        }
        self.nesting -= 1;
        if negative { self.push(Op::Negate, 1) } else { Ok(()) }
    }

    /// Powers pile up from the right: 2^3^2 is 2^(3^2).
    fn power(&mut self) -> Result<(), ExpressionError> {
        self.atom()?;
        if self.take(b'^') {
            self.sign()?;
            self.push(Op::Power, 2)?;
        }
        Ok(())
    }

    fn atom(&mut self) -> Result<(), ExpressionError> {
        match self.next_byte() {
            Some(b'(') => {
                self.place += 1;
                self.sum()?;
                self.close()
            }
            Some(b'0'..=b'9' | b'.') => self.number(),
            Some(c) if c.is_ascii_alphabetic() => self.name(),
            _ => Err(self.here("a number, a name or `(` is missing here")),
        }
    }

    fn close(&mut self) -> Result<(), ExpressionError> {
        if self.take(b')') { Ok(()) } else { Err(self.here("a `)` is missing here")) }
    }

    fn number(&mut self) -> Result<(), ExpressionError> {
        let (start, bytes) = (self.place, self.text.as_bytes());
        let digits = |mut k: usize| {
            while bytes.get(k).is_some_and(|c| c.is_ascii_digit() || *c == b'.') {
                k += 1;
            }
            k
        };
        let mut end = digits(start);
        if matches!(bytes.get(end), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
            let power = digits(end + 1 + sign);
            if power > end + 1 + sign {
                end = power;
            }
        }
        self.place = end;
        match self.text[start..end].parse() {
            Ok(value) => self.push(Op::Number(value), 0),
            Err(_) => Err(ExpressionError {
                sentence: format!("`{}` is not a number", &self.text[start..end]),
                start,
                length: end - start,
            }),
        }
    }

    fn name(&mut self) -> Result<(), ExpressionError> {
        let start = self.place;
        let rest = &self.text[start..];
        let length = rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(rest.len());
        let word = &rest[..length];
        self.place += length;
        let wrong = |sentence: String| Err(ExpressionError { sentence, start, length });
        if let Some(k) = VARIABLES.iter().position(|v| *v == word) {
            return self.push(Op::Variable(k), 0);
        }
        if let Some((_, value)) = CONSTANTS.iter().find(|c| c.0 == word) {
            return self.push(Op::Number(*value), 0);
        }
        let one = OF_ONE.iter().find(|f| f.0 == word).map(|f| (1, Op::One(f.1)));
        let two = OF_TWO.iter().find(|f| f.0 == word).map(|f| (2, Op::Two(f.1)));
        let Some((count, op)) = one.or(two) else {
            let known: Vec<&str> = names().collect();
            return wrong(format!("`{word}` is not known in a formula, which may use {}", known.join(", ")));
        };
        if !self.take(b'(') {
            return wrong(format!("`{word}` is a function: write {word}(…)"));
        }
        for k in 0..count {
            if k > 0 && !self.take(b',') {
                return wrong(format!("`{word}` takes {count} numbers, separated by commas"));
            }
            self.sum()?;
        }
        if self.next_byte() == Some(b',') {
            let numbers = if count == 1 { "one number" } else { "2 numbers" };
            return wrong(format!("`{word}` takes {numbers}"));
        }
        self.close()?;
        self.push(op, count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> f64 {
        text.parse::<Expression>().unwrap().at(DVec3::new(0.3, -1.7, 2.5), 0.4)
    }

    #[test]
    fn formulas_have_the_values_of_mathematics() {
        let (x, y, z, t) = (0.3_f64, -1.7_f64, 2.5_f64, 0.4_f64);
        let pi = std::f64::consts::PI;
        for (text, expected) in [
            ("1 + 2*3 - 4/8", 6.5),
            ("2^3^2", 512.0),
            ("-x^2", -x * x),
            ("2^-1", 0.5),
            ("1 - 2 - 3", -4.0),
            ("8/4/2", 1.0),
            ("1.5e-3*2E3 + .5", 3.5),
            ("150*cos(pi*x/2)*sin(2*pi*t)", 150.0 * (pi * x / 2.0).cos() * (2.0 * pi * t).sin()),
            ("min(t/0.1, 1) * max(y, -1)", -1.0),
            ("atan2(y, x)", y.atan2(x)),
            ("step(z - 2.5) + step(t - 0.5)", 1.0),
            ("- ( x + ( y ) ) * --z", -(x + y) * z),
            ("e^(x+1)/exp(1)", x.exp()),
            ("log(sqrt(exp(2))) + log10(100) + abs(y)", 1.0 + 2.0 + 1.7),
            ("sinh(x)^2 - cosh(x)^2 + tanh(0) + asin(0) + acos(1) + atan(0) + tan(0)", -1.0),
        ] {
            assert!(
                (value(text) - expected).abs() < 1e-14 * expected.abs().max(1.0),
                "{text}: {}",
                value(text)
            );
        }
    }

    #[test]
    fn what_is_wrong_is_pointed_at() {
        for (text, start, length) in [
            ("", 0, 1),
            ("1 +", 3, 1),
            ("sin(x", 5, 1),
            ("2*(x + 1))", 9, 1),
            ("3 x", 2, 1),
            ("2*foo(x)", 2, 3),
            ("sin", 0, 3),
            ("min(x)", 0, 3),
            ("sin(x, y)", 0, 3),
            ("1.2.3", 0, 5),
            ("x + ü", 4, 2),
        ] {
            let error = text.parse::<Expression>().unwrap_err();
            assert_eq!((error.start, error.length), (start, length), "{text}: {error}");
        }
        let deep = format!("{}1{}", "(".repeat(5000), ")".repeat(5000));
        assert!(deep.parse::<Expression>().is_err());
        let wide = format!("{}1{}", "1+(".repeat(40), ")".repeat(40));
        assert!(wide.parse::<Expression>().is_err(), "the stack must not overflow");
    }

    #[test]
    fn it_is_known_whether_a_formula_varies_in_space() {
        assert!("t*sin(z)".parse::<Expression>().unwrap().varies_in_space());
        assert!(!"t*exp(-t)".parse::<Expression>().unwrap().varies_in_space());
    }
}
