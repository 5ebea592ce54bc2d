//! Pictures a case asks for: columns of the history against each other.

use super::chart::{Axis, Chart, Mark, Series, svg};
use super::curve::Curve;
use crate::watch::{Measure, Names, Watch};
use serde::Deserialize;
use std::io;
use std::path::Path;

/// One chart of the history; charts with the same `file` stand side by side.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Plot {
    /// Name of the picture in the folder of the run, `.svg` at its end.
    pub file: String,
    /// Above the chart.
    #[serde(default)]
    pub title: String,
    /// Column along x: the head of the history without its unit.
    #[serde(default = "time")]
    pub x: String,
    /// Columns along y.
    #[serde(default)]
    pub y: Vec<String>,
    /// In place of columns over each other, [curves](super::curve) at the end of each stage.
    #[serde(default)]
    pub curves: Vec<String>,
    /// Stages that are drawn; all of them when empty.
    #[serde(default)]
    pub stage: Vec<String>,
    /// Whether x is logarithmic.
    #[serde(default)]
    pub log_x: bool,
    /// Whether y is logarithmic.
    #[serde(default)]
    pub log_y: bool,
}

fn time() -> String {
    "time".into()
}

/// Columns of every history.
pub const ALWAYS: [&str; 2] = ["step [-]", "time [s]"];

/// The names by which plots know the columns of these watches: heads without units.
pub fn columns(watches: &[Watch], names: &Names) -> Vec<String> {
    let mut measures: Vec<Measure> = watches.iter().flat_map(|w| w.measures.iter().copied()).collect();
    measures.sort();
    measures.dedup();
    let watched = measures.iter().flat_map(|m| m.columns(names));
    ALWAYS.into_iter().map(str::to_owned).chain(watched).map(|head| name(&head).to_owned()).collect()
}

/// A head without its unit.
fn name(head: &str) -> &str {
    head.split_once(" [").map_or(head, |parts| parts.0)
}

/// A history read back.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// Heads of the columns after the first, with units.
    pub heads: Vec<String>,
    /// Stage and cells of each row; empty cells are `None`.
    pub rows: Vec<(String, Vec<Option<f64>>)>,
}

impl History {
    /// Reads `history.csv`.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(path: &Path) -> io::Result<History> {
        Ok(History::from_text(&std::fs::read_to_string(path)?))
    }

    /// Reads the text of a history; what is no number is an empty cell.
    pub fn from_text(text: &str) -> History {
        let mut lines = text.lines();
        let heads = lines.next().unwrap_or_default().split(',').skip(1).map(str::to_owned).collect();
        let row = |line: &str| {
            let (stage, cells) = first_field(line);
            (stage, cells.split(',').map(|cell| cell.parse().ok()).collect())
        };
        History { heads, rows: lines.map(row).collect() }
    }

    /// Cells of the column `name`, the head without its unit, by row; `None` when there is no such column.
    pub fn column(&self, column: &str) -> Option<impl Iterator<Item = Option<f64>>> {
        let k = self.heads.iter().position(|head| name(head) == column)?;
        Some(self.rows.iter().map(move |row| row.1.get(k).copied().flatten()))
    }

    fn head(&self, column: &str) -> String {
        let head = self.heads.iter().find(|head| name(head) == column);
        head.map_or(column, String::as_str).replace(" [-]", "").replace('_', " ")
    }

    fn points(&self, plot: &Plot, y: &str) -> Vec<[f64; 2]> {
        let (Some(x), Some(y)) = (self.column(&plot.x), self.column(y)) else { return Vec::new() };
        (x.zip(y).zip(&self.rows))
            .filter(|(_, row)| plot.stage.is_empty() || plot.stage.contains(&row.0))
            .filter_map(|((x, y), _)| Some([x?, y?]))
            .collect()
    }
}

/// The first field of a line, quoted or not, and the rest.
fn first_field(line: &str) -> (String, &str) {
    let Some(quoted) = line.strip_prefix('"') else {
        let (first, rest) = line.split_once(',').unwrap_or((line, ""));
        return (first.to_owned(), rest);
    };
    let end = quoted.replace("\"\"", "  ").find('"').unwrap_or(quoted.len());
    let rest = quoted.get(end + 1..).unwrap_or_default();
    (quoted[..end].replace("\"\"", "\""), rest.strip_prefix(',').unwrap_or(rest))
}

/// The pictures with their names, drawn of one or several runs with the same columns.
pub fn draw(plots: &[Plot], runs: &[(String, History)]) -> Vec<(String, String)> {
    let mut files: Vec<&str> = Vec::new();
    for plot in plots {
        if !files.contains(&plot.file.as_str()) {
            files.push(&plot.file);
        }
    }
    let picture = |file: &str| {
        let charts: Vec<Chart> =
            plots.iter().filter(|plot| plot.file == file).map(|plot| chart(plot, runs)).collect();
        (file.to_owned(), svg(&charts))
    };
    files.into_iter().map(picture).collect()
}

fn chart(plot: &Plot, runs: &[(String, History)]) -> Chart {
    let head = |column: &str| runs.first().map_or(String::new(), |run| run.1.head(column));
    let mut series = Vec::new();
    let curves: Vec<Curve> = plot.curves.iter().filter_map(|name| Curve::named(name)).collect();
    if let Some(first) = curves.first() {
        for (run, history) in runs {
            for (curve, name) in curves.iter().zip(&plot.curves) {
                for (stage, points) in curve.at_ends(history, &plot.stage) {
                    let run = (runs.len() > 1).then_some(run.as_str());
                    let name = (curves.len() > 1).then(|| name.replace('_', " "));
                    let parts: Vec<&str> =
                        run.into_iter().chain(name.as_deref()).chain([stage.as_str()]).collect();
                    series.push(Series {
                        name: parts.join(": "),
                        points,
                        mark: Mark::Line,
                        colour: series.len(),
                    });
                }
            }
        }
        let heads: Vec<String> = curves.iter().flat_map(|c| &c.columns).map(|column| head(column)).collect();
        let values = match shared(&heads) {
            // The diameters of a grading share their unit only.
            unit if unit == "[m]" => "diameter [m]".into(),
            label => label,
        };
        let (x, y) = if first.upright { (values, first.place.into()) } else { (first.place.into(), values) };
        return Chart {
            title: plot.title.clone(),
            x: Axis { label: x, logarithmic: plot.log_x, range: None },
            y: Axis { label: y, logarithmic: plot.log_y, range: None },
            series,
        };
    }
    for (run, history) in runs {
        for column in &plot.y {
            let name = match (runs.len(), plot.y.len()) {
                (1, 1) => String::new(),
                (1, _) => head(column),
                (_, 1) => run.clone(),
                _ => format!("{run}: {}", head(column)),
            };
            let points = history.points(plot, column);
            series.push(Series { name, points, mark: Mark::Line, colour: series.len() });
        }
    }
    let heads: Vec<String> = plot.y.iter().map(|column| head(column)).collect();
    Chart {
        title: plot.title.clone(),
        x: Axis { label: head(&plot.x), logarithmic: plot.log_x, range: None },
        y: Axis { label: shared(&heads), logarithmic: plot.log_y, range: None },
        series,
    }
}

/// What heads such as `discharge x [m/s]` share: the words they begin with and the unit; where the units differ, all of them. The legend
/// says which is which.
fn shared(heads: &[String]) -> String {
    let unit = |head: &str| head.find(" [").map_or(String::new(), |at| head[at + 1..].to_owned());
    let Some((first, others)) = heads.split_first() else { return String::new() };
    if others.is_empty() || others.iter().any(|head| unit(head) != unit(first)) {
        return heads.join(", ");
    }
    let words = |head: &str| -> Vec<String> {
        let name = head.split(" [").next().unwrap_or_default();
        name.split(' ').map(str::to_owned).collect()
    };
    let mut label = words(first);
    for head in others {
        let same = label.iter().zip(&words(head)).take_while(|(a, b)| a == b).count();
        label.truncate(same);
    }
    label.push(unit(first));
    label.join(" ").trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(y: &[&str], stage: &[&str]) -> Plot {
        Plot {
            file: "a.svg".into(),
            title: "A".into(),
            x: "time".into(),
            y: y.iter().map(|&y| y.to_owned()).collect(),
            curves: Vec::new(),
            stage: stage.iter().map(|&s| s.to_owned()).collect(),
            log_x: false,
            log_y: false,
        }
    }

    const TEXT: &str = "stage,step [-],time [s],a [m],b_c [-]\n\
        one,1,0.5,2,\n\"two, \"\"or so\"\"\",2,1e0,3,7\n\"two, \"\"or so\"\"\",3,1.5,,8\n";

    #[test]
    fn columns_are_found_and_empty_cells_left_out() {
        let history = History::from_text(TEXT);
        assert_eq!(history.points(&plot(&[], &[]), "a"), [[0.5, 2.0], [1.0, 3.0]]);
        assert_eq!(history.points(&plot(&[], &["two, \"or so\""]), "a"), [[1.0, 3.0]]);
        assert_eq!(history.points(&plot(&[], &[]), "b_c"), [[1.0, 7.0], [1.5, 8.0]]);
        assert!(history.column("b").is_none());
    }

    #[test]
    fn charts_of_one_file_stand_side_by_side_and_runs_lie_over_each_other() {
        let runs = [("x".to_owned(), History::from_text(TEXT)), ("y".to_owned(), History::from_text(TEXT))];
        let plots =
            [plot(&["a"], &[]), plot(&["a", "b_c"], &[]), Plot { file: "b.svg".into(), ..plot(&["a"], &[]) }];
        let drawn = draw(&plots, &runs);
        let names: Vec<&str> = drawn.iter().map(|d| d.0.as_str()).collect();
        assert_eq!(names, ["a.svg", "b.svg"]);
        assert_eq!(drawn[0].1.matches("<polyline").count(), 2 + 4);
        assert!(drawn[0].1.contains(">y: b c<") && drawn[1].1.contains(">y<"), "{}", drawn[0].1);
    }

    /// A profile stands at the heights of its layers, once for each stage, as its last row has it.
    #[test]
    fn curves_are_drawn_at_the_end_of_each_stage() {
        let heads: String = (0..12).map(|k| format!(",solid_{k} [-]")).collect();
        let row = |stage: &str, step: usize, from: f64| {
            let cells: String = (0..12).map(|k| format!(",{}", from + f64::from(k))).collect();
            format!("{stage},{step},0.5{cells}\n")
        };
        let empty = ",".repeat(12);
        let text = format!(
            "stage,step [-],time [s]{heads}\n{}{}two,3,0.5{empty}\n{}",
            row("one", 1, 0.0),
            row("one", 2, 100.0),
            row("two", 4, 200.0)
        );
        let history = History::from_text(&text);
        let curve = Curve::named("solid").unwrap();
        let found = curve.at_ends(&history, &[]);
        assert_eq!(found.iter().map(|f| f.0.as_str()).collect::<Vec<_>>(), ["one", "two"]);
        assert_eq!((found[0].1[0], found[0].1[11]), ([100.0, 0.5 / 12.0], [111.0, 11.5 / 12.0]));
        assert_eq!(found[1].1[3], [203.0, 3.5 / 12.0]);
        assert_eq!(curve.at_ends(&history, &["two".into()]).len(), 1);
        let drawn =
            draw(&[Plot { curves: vec!["solid".into()], ..plot(&[], &[]) }], &[("x".into(), history)]);
        assert_eq!(drawn[0].1.matches("<polyline").count(), 2);
        assert!(
            drawn[0].1.contains(">one<") && drawn[0].1.contains(">height over that of the box [-]<"),
            "{}",
            drawn[0].1
        );
    }

    #[test]
    fn every_curve_has_columns_that_some_measure_writes() {
        let measures = Measure::ALL.to_vec();
        let every = crate::watch::Every::Steps(1);
        let all = columns(&[Watch { measures, every }], &Names::default());
        for name in super::super::curve::CURVES {
            let curve = Curve::named(name).unwrap();
            assert_eq!(curve.columns.len(), curve.places.len());
            assert!(curve.columns.iter().all(|column| all.contains(column)), "{name}");
        }
        assert!(Curve::named("porosity").is_none());
    }

    #[test]
    fn an_axis_names_what_its_columns_share() {
        let label = |heads: &[&str]| shared(&heads.iter().map(|&head| head.to_owned()).collect::<Vec<_>>());
        assert_eq!(label(&["water stress xx [Pa]", "water stress zz [Pa]"]), "water stress [Pa]");
        assert_eq!(label(&["porosity", "solid"]), "");
        assert_eq!(label(&["a [m]", "b [Pa]"]), "a [m], b [Pa]");
        assert_eq!(label(&["a b [m]"]), "a b [m]");
    }
}
