//! What is wrong with a case, said in one sentence, with the place in the file.

use std::fmt;

/// A case that cannot be run: one sentence, and where to look.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseError {
    /// What is wrong, in one sentence.
    pub sentence: String,
    /// What would be right: the allowed keys, the allowed range.
    pub hint: Option<String>,
    /// Where it is wrong.
    pub place: Option<Box<Place>>,
}

/// A piece of a line of text.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// The file, or `--set`.
    pub source: String,
    /// Line number from 1; `None` when the source is not a file.
    pub line: Option<usize>,
    /// Column from 1, in characters.
    pub column: usize,
    /// The whole line.
    pub text: String,
    /// How many characters the caret underlines.
    pub width: usize,
}

impl CaseError {
    /// An error that has no place in a text.
    pub fn new(sentence: impl Into<String>) -> Self {
        CaseError { sentence: sentence.into(), hint: None, place: None }
    }

    /// The same error with a hint.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

impl Place {
    /// The first line of the bytes `range` of `text`, a file called `source`.
    pub fn in_file(source: &str, text: &str, range: std::ops::Range<usize>) -> Self {
        let start = floor_boundary(text, range.start);
        let line_start = text[..start].rfind('\n').map_or(0, |k| k + 1);
        let line_end = text[start..].find('\n').map_or(text.len(), |k| start + k);
        let end = floor_boundary(text, range.end).clamp(start, line_end);
        Place {
            source: source.to_owned(),
            line: Some(text[..line_start].matches('\n').count() + 1),
            column: text[line_start..start].chars().count() + 1,
            text: text[line_start..line_end].trim_end().to_owned(),
            width: text[start..end].chars().count().max(1),
        }
    }
}

fn floor_boundary(text: &str, index: usize) -> usize {
    (0..=index.min(text.len())).rev().find(|&k| text.is_char_boundary(k)).unwrap_or(0)
}

impl fmt::Display for CaseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.sentence)?;
        let Some(place) = &self.place else {
            return match &self.hint {
                Some(hint) => write!(f, "\n  = {hint}"),
                None => Ok(()),
            };
        };
        let number = place.line.map_or(String::new(), |n| n.to_string());
        let margin = " ".repeat(number.len().max(1));
        match place.line {
            Some(line) => writeln!(f, "\n{margin}--> {}:{line}:{}", place.source, place.column)?,
            None => writeln!(f, "\n{margin}--> {}", place.source)?,
        }
        writeln!(f, "{margin} |")?;
        writeln!(f, "{number:>width$} | {}", place.text, width = margin.len())?;
        // A tab of the line stays a tab in front of the caret, so that both line up in any terminal.
        let lead: String =
            place.text.chars().take(place.column - 1).map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
        write!(f, "{margin} | {lead}{}", "^".repeat(place.width))?;
        match &self.hint {
            Some(hint) => write!(f, " {hint}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for CaseError {}

/// The allowed word closest to `word`, if it is close enough to be a slip of the finger.
pub fn nearest<'a>(word: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    allowed
        .into_iter()
        .map(|candidate| (distance(word, candidate), candidate))
        .filter(|&(d, candidate)| d <= 1 + candidate.len() / 4)
        .min_by_key(|&(d, _)| d)
        .map(|(_, candidate)| candidate)
}

/// Insertions, deletions, replacements and swaps of neighbours that turn `a` into `b`.
fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            rows[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let change = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
                let mut best = change.min(rows[i - 1][j] + 1).min(rows[i][j - 1] + 1);
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    best = best.min(rows[i - 2][j - 2] + 1);
                }
                best
            };
        }
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn caret_stands_under_the_word() {
        let text = "a = 1\nyoùng = 15e6 # E\n";
        let start = text.find("15e6").unwrap();
        let error = CaseError {
            sentence: "no".into(),
            hint: Some("because".into()),
            place: Some(Box::new(Place::in_file("case.toml", text, start..start + 4))),
        };
        let shown = error.to_string();
        assert_eq!(shown, "no\n --> case.toml:2:9\n  |\n2 | yoùng = 15e6 # E\n  |         ^^^^ because");
    }

    #[test]
    fn slips_of_the_finger_are_recognised() {
        let allowed = ["young", "stiffness-ratio", "friction"];
        assert_eq!(nearest("yuong", allowed), Some("young"));
        assert_eq!(nearest("stifness_ratio", allowed), Some("stiffness-ratio"));
        assert_eq!(nearest("colour", allowed), None);
    }
}
