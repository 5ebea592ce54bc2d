//! Grains from a CSV file: one line `x,y,z,r` per grain [m], or `x,y,z,r,vx,vy,vz` with its velocity [m/s]; lines that
//! start with `#` and a line of names are skipped.

use crate::case::{BYTE_ORDER_MARK, CaseError, Place, reason};
use glam::DVec3;
use porograin_geometry::neighbours::swallowed;
use porograin_geometry::{Cell, Period};
use std::ops::Range;

/// Radii below this part of the box are taken for a mistake: their volumes would vanish in the rounding of that of the box.
const SMALLEST: f64 = 5e-10;
/// Grains may overlap their own image by this part of their diameter: rounding of a lattice that touches.
const TOUCHING: f64 = 1e-6;

/// Centres and radii [m], in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spheres {
    /// Centres [m].
    pub position: Vec<DVec3>,
    /// Radii [m].
    pub radius: Vec<f64>,
    /// Velocities [m/s], zero where the file has none.
    pub velocity: Vec<DVec3>,
    /// Line of each grain in the file, from 1.
    pub line: Vec<usize>,
}

/// The text of the grain file at `path`.
///
/// # Errors
/// When it cannot be read.
pub fn read(path: &std::path::Path) -> Result<String, CaseError> {
    let text = std::fs::read_to_string(path).map_err(|e| {
        CaseError::new(format!("cannot read the grain file {}: {}", path.display(), reason(&e)))
    })?;
    Ok(text.trim_start_matches(BYTE_ORDER_MARK).to_owned())
}

/// Reads the text of a file called `name`.
///
/// # Errors
/// A line that is not four or seven finite numbers with a positive radius, no grain at all, or a grain whose centre lies
/// inside another one.
pub fn spheres(name: &str, text: &str) -> Result<Spheres, CaseError> {
    let mut spheres = Spheres::default();
    for row in rows(name, text, &["x,y,z,r", "x,y,z,r,vx,vy,vz"])? {
        let &[x, y, z, radius, ref rest @ ..] = &row.values[..] else { return Err(row.miscounted(GRAIN)) };
        let velocity = match *rest {
            [] => DVec3::ZERO,
            [vx, vy, vz] => DVec3::new(vx, vy, vz),
            _ => return Err(row.miscounted(GRAIN)),
        };
        if radius <= 0.0 {
            let word = row.words[3].clone();
            let sentence =
                format!("the radius of a grain must be greater than 0, not {}", &text[word.clone()]);
            return Err(row.fault(word, sentence));
        }
        spheres.position.push(DVec3::new(x, y, z));
        spheres.radius.push(radius);
        spheres.velocity.push(velocity);
        spheres.line.push(row.line);
    }
    if spheres.radius.is_empty() {
        return Err(CaseError::new(format!("the grain file {name} holds no grain")));
    }
    match swallowed(&spheres.position, &spheres.radius) {
        Some([i, j]) => Err(spheres.swallowing(name, text, i, j, "the centre")),
        None => Ok(spheres),
    }
}

/// What a line of a grain file holds.
const GRAIN: &str = "a grain is 4 numbers x,y,z,r, or 7 with vx,vy,vz";

/// Reads places [m] from the text of a file called `name`, one line `x,y,z` each.
///
/// # Errors
/// A line that is not three finite numbers, or no place at all.
pub fn places(name: &str, text: &str) -> Result<Vec<DVec3>, CaseError> {
    let mut places = Vec::new();
    for row in rows(name, text, &["x,y,z"])? {
        let [x, y, z] = row.values[..] else { return Err(row.miscounted("a place is 3 numbers x,y,z")) };
        places.push(DVec3::new(x, y, z));
    }
    if places.is_empty() {
        return Err(CaseError::new(format!("the file {name} holds no place")));
    }
    Ok(places)
}

/// A line of finite numbers.
struct Row<'a> {
    name: &'a str,
    text: &'a str,
    values: Vec<f64>,
    /// Where each number stands in the text.
    words: Vec<Range<usize>>,
    /// Where the line stands in the text.
    whole: Range<usize>,
    /// Its number, from 1.
    line: usize,
}

impl Row<'_> {
    fn fault(&self, place: Range<usize>, sentence: String) -> CaseError {
        CaseError { sentence, hint: None, place: Some(Box::new(Place::in_file(self.name, self.text, place))) }
    }

    fn miscounted(&self, what: &str) -> CaseError {
        let numbers = if self.values.len() == 1 { "number" } else { "numbers" };
        let sentence = format!("{what}, this line has {} {numbers}", self.values.len());
        self.fault(self.whole.clone(), sentence)
    }
}

/// The lines of numbers of a text; empty ones, those that start with `#` and a first one with these `heads` are skipped.
fn rows<'a>(name: &'a str, text: &'a str, heads: &[&str]) -> Result<Vec<Row<'a>>, CaseError> {
    let mut rows = Vec::new();
    let mut offset = 0;
    for (k, line) in text.split_inclusive('\n').enumerate() {
        let start = offset;
        offset += line.len();
        let content: String = line.chars().filter(|c| !c.is_whitespace()).collect();
        let is_heading = rows.is_empty() && heads.contains(&content.to_lowercase().as_str());
        if content.is_empty() || content.starts_with('#') || is_heading {
            continue;
        }
        let (values, words) = (Vec::new(), Vec::new());
        let whole = start..start + line.trim_end().len();
        let mut row = Row { name, text, values, words, whole, line: k + 1 };
        let mut column = start;
        for field in line.trim_end().split(',') {
            let word = field.trim();
            let from = column + field.find(word).unwrap_or(0);
            column += field.len() + 1;
            let place = from..from + word.len();
            let value: f64 = word
                .parse()
                .map_err(|_| row.fault(place.clone(), format!("expected a number, found `{word}`")))?;
            if !value.is_finite() {
                return Err(row.fault(place, format!("`{word}` is not a finite number")));
            }
            row.values.push(value);
            row.words.push(place);
        }
        rows.push(row);
    }
    Ok(rows)
}

impl Spheres {
    /// Refuses the first grain whose centre is outside the box or that is bigger than the box.
    ///
    /// # Errors
    /// Names the line of that grain in the file called `name`.
    pub fn within(&self, name: &str, text: &str, lower: DVec3, upper: DVec3) -> Result<(), CaseError> {
        let size = upper - lower;
        for i in 0..self.radius.len() {
            let (x, r) = (self.position[i], self.radius[i]);
            if 2.0 * r > size.min_element() {
                let sentence = format!(
                    "the grain, {} m across, is bigger than the box, {} m",
                    2.0 * r,
                    size.min_element()
                );
                return Err(self.fault(name, text, i, sentence));
            }
            if r < SMALLEST * size.min_element() {
                let sentence = format!(
                    "the grain, {:e} m across, is less than a billionth of the box, {} m: is its unit right?",
                    2.0 * r,
                    size.min_element()
                );
                return Err(self.fault(name, text, i, sentence));
            }
            for (axis, word) in ["x", "y", "z"].into_iter().enumerate() {
                if !(lower[axis]..=upper[axis]).contains(&x[axis]) {
                    let sentence = format!(
                        "the grain's centre is outside the box: {word} = {} m is not between {} m and {} m",
                        x[axis], lower[axis], upper[axis]
                    );
                    return Err(self.fault(name, text, i, sentence));
                }
            }
        }
        Ok(())
    }

    /// Refuses the first grain that overlaps its own image in a periodic cell, or holds the centre of an image of another.
    ///
    /// # Errors
    /// Names the line of that grain in the file called `name`.
    pub fn within_period(&self, name: &str, text: &str, cell: &Cell) -> Result<(), CaseError> {
        let Some(period) = Period::of(cell) else { return Ok(()) };
        let widest = self.radius.iter().copied().fold(0.0, f64::max);
        // Images whose cells come as near to this one as the widest diameter.
        let reach = [0, 1, 2].map(|axis| (2.0 * widest / period.across(axis)).floor().min(100.0) as i32 + 1);
        let range = |axis: usize| -reach[axis]..=reach[axis];
        let shifts = range(0).flat_map(|a| range(1).flat_map(move |b| range(2).map(move |c| [a, b, c])));
        let shifts: Vec<DVec3> = shifts
            .filter(|&shift| shift != [0; 3])
            .map(|shift| period.shift(DVec3::from(shift.map(f64::from))))
            .collect();
        let nearest = shifts.iter().map(|shift| shift.length()).fold(f64::INFINITY, f64::min);
        if let Some(k) = self.radius.iter().position(|r| 2.0 * r > nearest * (1.0 + TOUCHING)) {
            let sentence = format!(
                "the grain, {} m across, overlaps its own image {nearest} m away",
                2.0 * self.radius[k]
            );
            return Err(self.fault(name, text, k, sentence));
        }
        let inside: Vec<DVec3> = self.position.iter().map(|&x| x - period.shift(period.beyond(x))).collect();
        let (mut position, mut radius) = (inside.clone(), self.radius.clone());
        let mut source: Vec<usize> = (0..inside.len()).collect();
        for &shift in &shifts {
            for (k, &x) in inside.iter().enumerate() {
                let place = period.coordinates(x + shift);
                let near = |axis: usize| {
                    let margin = widest / period.across(axis);
                    (-margin..=1.0 + margin).contains(&place[axis])
                };
                if (0..3).all(near) {
                    position.push(x + shift);
                    radius.push(self.radius[k]);
                    source.push(k);
                }
            }
        }
        match swallowed(&position, &radius) {
            Some([i, j]) => {
                let (i, j) = (source[i].min(source[j]), source[i].max(source[j]));
                Err(self.swallowing(name, text, i, j, "the centre of an image"))
            }
            None => Ok(()),
        }
    }

    fn swallowing(&self, name: &str, text: &str, i: usize, j: usize, what: &str) -> CaseError {
        let (a, b) = (self.line[i], self.line[j]);
        let sentence =
            format!("the grains of lines {a} and {b} overlap so deeply that one holds {what} of the other");
        let mut error = self.fault(name, text, j, sentence);
        error.hint = Some(format!("line {a} is {}", text.lines().nth(a - 1).unwrap_or("").trim()));
        error
    }

    fn fault(&self, name: &str, text: &str, grain: usize, sentence: String) -> CaseError {
        let start: usize = text.split_inclusive('\n').take(self.line[grain] - 1).map(str::len).sum();
        let width = text[start..].lines().next().unwrap_or("").trim_end().len();
        CaseError {
            sentence,
            hint: None,
            place: Some(Box::new(Place::in_file(name, text, start..start + width))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_in_order() {
        let read = spheres("g.csv", "# made by hand\nx,y,z,r\n0,0,0,1\n 3 , 0,0 , 0.5\n\n").unwrap();
        assert_eq!(read.position, [DVec3::ZERO, DVec3::new(3.0, 0.0, 0.0)]);
        assert_eq!(read.radius, [1.0, 0.5]);
        assert_eq!(read.line, [3, 4]);
        assert_eq!(read.velocity, [DVec3::ZERO; 2]);
        let line = places("p.csv", "x, y, z\n1,2,3\n\n# none\n-1,0,5e-1\n").unwrap();
        assert_eq!(line, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.0, 0.5)]);
        let error = places("p.csv", "1,2,3\n1,2\n").unwrap_err();
        assert!(error.sentence.starts_with("a place is 3 numbers x,y,z, this line has 2"), "{error}");
        let moving = spheres("g.csv", "x,y,z,r,vx,vy,vz\n0,0,0,1,-2,0.5,3\n").unwrap();
        assert_eq!((moving.radius[0], moving.velocity[0]), (1.0, DVec3::new(-2.0, 0.5, 3.0)));
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, sentence, column) in [
            (
                "0,0,0,1\n1,2,3",
                "a grain is 4 numbers x,y,z,r, or 7 with vx,vy,vz, this line has 3 numbers",
                1,
            ),
            ("0,0,0,1\n1,2, x,4", "expected a number, found `x`", 6),
            ("0,0,0,1\n1,nan,0,4", "`nan` is not a finite number", 3),
            ("0,0,0,1\n1,2,3,-1", "the radius of a grain must be greater than 0, not -1", 7),
        ] {
            let error = spheres("g.csv", text).unwrap_err();
            let place = error.place.unwrap();
            assert_eq!((error.sentence.as_str(), place.line, place.column), (sentence, Some(2), column));
        }
        assert_eq!(spheres("g.csv", "# x\n").unwrap_err().sentence, "the grain file g.csv holds no grain");
    }

    #[test]
    fn a_swallowed_centre_is_refused_and_a_plain_overlap_is_not() {
        assert!(spheres("g.csv", "0,0,0,1\n1.5,0,0,1\n").is_ok());
        let error = spheres("g.csv", "0,0,0,1\n5,0,0,1\n0.5,0,0,0.2\n").unwrap_err();
        assert!(error.sentence.starts_with("the grains of lines 1 and 3 overlap"), "{error}");
    }
}
