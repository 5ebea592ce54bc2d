//! Grains from a CSV file: one line `x,y,z,r` per grain [m], or `x,y,z,r,vx,vy,vz` with its velocity [m/s]; lines that
//! start with `#` and a line of names are skipped.

use crate::case::{BYTE_ORDER_MARK, CaseError, Place, reason};
use glam::DVec3;
use porograin_geometry::{Cell, Period};

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
    let mut offset = 0;
    for (k, line) in text.split_inclusive('\n').enumerate() {
        let start = offset;
        offset += line.len();
        let content = line.trim();
        let first = spheres.radius.is_empty();
        if content.is_empty() || content.starts_with('#') || (first && is_heading(content)) {
            continue;
        }
        let fault = |from: usize, length: usize, sentence: String| CaseError {
            sentence,
            hint: None,
            place: Some(Box::new(Place::in_file(name, text, start + from..start + from + length))),
        };
        let mut values = [0.0_f64; 7];
        let mut count = 0;
        let mut column = 0;
        for field in line.trim_end().split(',') {
            let word = field.trim();
            let from = column + field.find(word).unwrap_or(0);
            column += field.len() + 1;
            if count < values.len() {
                values[count] = word
                    .parse()
                    .map_err(|_| fault(from, word.len(), format!("expected a number, found `{word}`")))?;
                if !values[count].is_finite() {
                    return Err(fault(from, word.len(), format!("`{word}` is not a finite number")));
                }
                if count == 3 && values[3] <= 0.0 {
                    return Err(fault(
                        from,
                        word.len(),
                        format!("the radius of a grain must be greater than 0, not {word}"),
                    ));
                }
            }
            count += 1;
        }
        if count != 4 && count != 7 {
            let numbers = if count == 1 { "number" } else { "numbers" };
            return Err(fault(
                0,
                line.trim_end().len(),
                format!("a grain is 4 numbers x,y,z,r, or 7 with vx,vy,vz, this line has {count} {numbers}"),
            ));
        }
        spheres.position.push(DVec3::new(values[0], values[1], values[2]));
        spheres.radius.push(values[3]);
        spheres.velocity.push(DVec3::new(values[4], values[5], values[6]));
        spheres.line.push(k + 1);
    }
    if spheres.radius.is_empty() {
        return Err(CaseError::new(format!("the grain file {name} holds no grain")));
    }
    match swallowed(&spheres.position, &spheres.radius) {
        Some((i, j)) => Err(spheres.swallowing(name, text, i, j, "the centre")),
        None => Ok(spheres),
    }
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
            Some((i, j)) => {
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

fn is_heading(line: &str) -> bool {
    let names: Vec<String> = line.split(',').map(|w| w.trim().to_lowercase()).collect();
    names == ["x", "y", "z", "r"] || names == ["x", "y", "z", "r", "vx", "vy", "vz"]
}

/// The first pair, in order of x, of which one holds the centre of the other.
fn swallowed(position: &[DVec3], radius: &[f64]) -> Option<(usize, usize)> {
    let mut order: Vec<usize> = (0..radius.len()).collect();
    order.sort_by(|&a, &b| position[a].x.total_cmp(&position[b].x).then(a.cmp(&b)));
    let widest = radius.iter().copied().fold(0.0, f64::max);
    for (k, &i) in order.iter().enumerate() {
        for &j in &order[k + 1..] {
            let apart = position[j] - position[i];
            if apart.x > widest {
                break;
            }
            if apart.length() < radius[i].max(radius[j]) {
                return Some((i.min(j), i.max(j)));
            }
        }
    }
    None
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
