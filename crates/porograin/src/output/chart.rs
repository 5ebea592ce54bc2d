//! Line charts as SVG: axes, a legend, lines and dots.

use std::fmt::Write as _;

/// Side of the plotting area of one chart and the room around it [px].
const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 340.0;
const LEFT: f64 = 74.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 58.0;
/// Colours that stay apart for colour-blind readers (Okabe & Ito 2008), dark ones first.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#333333"];

/// One chart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chart {
    /// Above the chart.
    pub title: String,
    /// Below.
    pub x: Axis,
    /// At the left.
    pub y: Axis,
    /// What is drawn.
    pub series: Vec<Series>,
}

/// An axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// What it shows, with the unit.
    pub label: String,
    /// Whether it is logarithmic.
    pub logarithmic: bool,
    /// Its ends; by default those of the data.
    pub range: Option<[f64; 2]>,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// In the legend; an empty name is left out of it.
    pub name: String,
    /// Points, in data units.
    pub points: Vec<[f64; 2]>,
    /// How it is drawn.
    pub mark: Mark,
    /// Number of its colour; curves that belong together share one.
    pub colour: usize,
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// Dots.
    Dots,
}

/// The charts side by side, as the text of an SVG file.
pub fn svg(charts: &[Chart]) -> String {
    let (width, height) = (LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM);
    let all = width * charts.len() as f64;
    let mut out = String::new();
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{all}\" height=\"{height}\" viewBox=\"0 0 {all} {height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n\
         <rect width=\"{all}\" height=\"{height}\" fill=\"white\"/>"
    );
    for (k, chart) in charts.iter().enumerate() {
        let _ = writeln!(out, "<g transform=\"translate({},{TOP})\">", k as f64 * width + LEFT);
        chart.draw(&mut out, k);
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

impl Chart {
    fn draw(&self, out: &mut String, number: usize) {
        let x = Scale::new(&self.x, self.series.iter().flat_map(|s| s.points.iter().map(|p| p[0])), WIDTH);
        let y = Scale::new(&self.y, self.series.iter().flat_map(|s| s.points.iter().map(|p| p[1])), HEIGHT);
        for (value, text) in x.ticks() {
            let at = x.place(value);
            let _ = writeln!(
                out,
                "<path d=\"M{at:.1} 0V{HEIGHT}\" stroke=\"#e4e4e4\"/><text x=\"{at:.1}\" y=\"{}\" \
                 text-anchor=\"middle\">{text}</text>",
                HEIGHT + 18.0
            );
        }
        for (value, text) in y.ticks() {
            let at = HEIGHT - y.place(value);
            let _ = writeln!(
                out,
                "<path d=\"M0 {at:.1}H{WIDTH}\" stroke=\"#e4e4e4\"/><text x=\"-8\" y=\"{:.1}\" \
                 text-anchor=\"end\">{text}</text>",
                at + 4.0
            );
        }
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"-16\" text-anchor=\"middle\" font-size=\"14\">{}</text>\n\
             <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\n\
             <text transform=\"translate(-52,{}) rotate(-90)\" text-anchor=\"middle\">{}</text>\n\
             <clipPath id=\"area{number}\"><rect x=\"-4\" y=\"-4\" width=\"{}\" height=\"{}\"/></clipPath>\n\
             <g clip-path=\"url(#area{number})\">",
            WIDTH / 2.0,
            escaped(&self.title),
            WIDTH / 2.0,
            HEIGHT + 42.0,
            escaped(&self.x.label),
            HEIGHT / 2.0,
            escaped(&self.y.label),
            WIDTH + 8.0,
            HEIGHT + 8.0
        );
        for series in &self.series {
            let colour = COLOURS[series.colour % COLOURS.len()];
            let points = series.points.iter().filter(|p| x.shows(p[0]) && y.shows(p[1]));
            let placed: Vec<String> =
                points.map(|p| format!("{:.2},{:.2}", x.place(p[0]), HEIGHT - y.place(p[1]))).collect();
            match series.mark {
                Mark::Line => {
                    let _ = writeln!(
                        out,
                        "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\"/>",
                        placed.join(" ")
                    );
                }
                Mark::Dots => {
                    for (cx, cy) in placed.iter().filter_map(|p| p.split_once(',')) {
                        let _ = writeln!(out, "<circle cx=\"{cx}\" cy=\"{cy}\" r=\"3\" fill=\"{colour}\"/>");
                    }
                }
            }
        }
        let _ = writeln!(
            out,
            "</g>\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"none\" stroke=\"#333\"/>"
        );
        self.legend(out, &x, &y);
    }

    /// The legend, in the corner that hides the fewest points.
    fn legend(&self, out: &mut String, x: &Scale, y: &Scale) {
        let named: Vec<&Series> = self.series.iter().filter(|s| !s.name.is_empty()).collect();
        let Some(longest) = named.iter().map(|s| s.name.chars().count()).max() else { return };
        let (width, height) = (44.0 + 7.4 * longest as f64, 10.0 + 17.0 * named.len() as f64);
        let hidden = |left: f64, top: f64| {
            let inside = |p: &&[f64; 2]| {
                let (px, py) = (x.place(p[0]), HEIGHT - y.place(p[1]));
                (left - 4.0..left + width + 4.0).contains(&px)
                    && (top - 4.0..top + height + 4.0).contains(&py)
            };
            self.series.iter().flat_map(|s| s.points.iter()).filter(inside).count()
        };
        let (right, low) = (WIDTH - width - 8.0, HEIGHT - height - 8.0);
        let corners = [[right, 8.0], [8.0, 8.0], [8.0, low], [right, low]];
        let Some([left, top]) = corners.into_iter().min_by_key(|c| hidden(c[0], c[1])) else { return };
        let _ = writeln!(
            out,
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"white\" \
             fill-opacity=\"0.85\" stroke=\"#bbb\"/>"
        );
        for (k, series) in named.iter().enumerate() {
            let (at, line) = (left + 8.0, top + 13.0 + 17.0 * k as f64);
            let colour = COLOURS[series.colour % COLOURS.len()];
            let _ = match series.mark {
                Mark::Line => {
                    writeln!(out, "<path d=\"M{at} {line}h22\" stroke=\"{colour}\" stroke-width=\"1.6\"/>")
                }
                Mark::Dots => {
                    writeln!(out, "<circle cx=\"{}\" cy=\"{line}\" r=\"3\" fill=\"{colour}\"/>", at + 11.0)
                }
            };
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{}\">{}</text>",
                at + 30.0,
                line + 4.0,
                escaped(&series.name)
            );
        }
    }
}

/// From data to pixels.
struct Scale {
    from: f64,
    to: f64,
    logarithmic: bool,
    length: f64,
}

impl Scale {
    fn new(axis: &Axis, data: impl Iterator<Item = f64>, length: f64) -> Self {
        let logarithmic = axis.logarithmic;
        let usable = data.filter(|v| v.is_finite() && (!logarithmic || *v > 0.0));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        let [low, high] = axis.range.unwrap_or([low, high]);
        let (mut from, mut to) = if logarithmic { (low.log10(), high.log10()) } else { (low, high) };
        if !(from.is_finite() && to.is_finite()) {
            (from, to) = (0.0, 1.0);
        }
        if to - from <= 1e-12 * (from.abs() + to.abs()) {
            (from, to) = (from - 0.5, to + 0.5);
        }
        if axis.range.is_none() && !logarithmic {
            let room = 0.04 * (to - from);
            (from, to) = (from - room, to + room);
        }
        Scale { from, to, logarithmic, length }
    }

    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.logarithmic || value > 0.0)
    }

    fn place(&self, value: f64) -> f64 {
        let value = if self.logarithmic { value.log10() } else { value };
        self.length * (value - self.from) / (self.to - self.from)
    }

    /// Round values between the ends, with their text.
    fn ticks(&self) -> Vec<(f64, String)> {
        if self.logarithmic {
            let (first, last) = ((self.from - 1e-9).ceil() as i32, (self.to + 1e-9).floor() as i32);
            let every = ((last - first) / 7 + 1).max(1);
            let power = |k: i32| format!("10<tspan dy=\"-5\" font-size=\"9\">{k}</tspan>");
            if last <= first {
                // Less than two powers of ten: what lies between them too, all of it or 1, 2 and 5.
                let all = |digits: &[u8]| -> Vec<(f64, String)> {
                    let at = |k: i32, digit: u8| (f64::from(digit) * 10f64.powi(k), k, digit);
                    let inside = |(value, ..): &(f64, i32, u8)| {
                        (self.from - 1e-9..=self.to + 1e-9).contains(&value.log10())
                    };
                    let text = |k: i32, digit: u8| {
                        if digit == 1 { power(k) } else { format!("{digit}·{}", power(k)) }
                    };
                    (first - 1..=last + 1)
                        .flat_map(|k| digits.iter().map(move |&digit| at(k, digit)))
                        .filter(inside)
                        .map(|(value, k, digit)| (value, text(k, digit)))
                        .collect()
                };
                let (fine, coarse) = (all(&[1, 2, 3, 4, 5, 6, 7, 8, 9]), all(&[1, 2, 5]));
                return if fine.len() > 6 { coarse } else { fine };
            }
            let whole = (first..=last).filter(|k| (k - first) % every == 0);
            return whole.map(|k| (10f64.powi(k), power(k))).collect();
        }
        let rough = (self.to - self.from) / 5.0;
        let power = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough).unwrap_or(power);
        let (first, last) = ((self.from / step).ceil() as i64, (self.to / step).floor() as i64);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let text = |value: f64| {
            if !(1e-4..1e5).contains(&step) { format!("{value:.1e}") } else { format!("{value:.digits$}") }
        };
        (first..=last).map(|k| k as f64 * step).map(|value| (value, text(value))).collect()
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let scale = Scale::new(&Axis { range: Some([0.0, 1.0]), ..Axis::default() }, [].into_iter(), 100.0);
        let text: Vec<String> = scale.ticks().into_iter().map(|t| t.1).collect();
        assert_eq!(text, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        let axis = Axis { logarithmic: true, range: Some([1e-3, 1.0]), ..Axis::default() };
        let scale = Scale::new(&axis, [].into_iter(), 100.0);
        assert_eq!(scale.ticks().len(), 4);
        // Within less than two powers of ten a logarithmic axis has ticks between them.
        let within = |range: [f64; 2]| -> Vec<f64> {
            let axis = Axis { logarithmic: true, range: Some(range), ..Axis::default() };
            Scale::new(&axis, [].into_iter(), 100.0)
                .ticks()
                .into_iter()
                .map(|t| t.0 * 1e6)
                .map(f64::round)
                .collect()
        };
        assert_eq!(within([1.9e-3, 4.2e-3]), [2000.0, 3000.0, 4000.0]);
        assert_eq!(within([0.4e-3, 4e-3]), [500.0, 1000.0, 2000.0]);
        assert!((scale.place(1e-3), (scale.place(1.0) - 100.0).abs() < 1e-9) == (0.0, true));
    }

    #[test]
    fn no_data_is_no_panic() {
        let empty = Chart { series: vec![], ..Chart::default() };
        let flat = Series { name: "a<b".into(), points: vec![[0.0, 1.0]], mark: Mark::Dots, colour: 9 };
        let text = svg(&[empty, Chart { series: vec![flat], ..Chart::default() }]);
        assert!(text.contains("a&lt;b") && !text.contains("NaN"), "{text}");
    }
}
