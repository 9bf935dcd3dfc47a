//! Pictures without a time axis: bars, curves with their intervals, a map.

use super::axis::{Domain, labels, plain, powers, ticks};
use super::chart::{Along, FOOT, HEAD, LEFT, Scale, Svg, WIDTH, polyline, px, width};
use super::panels::Style;
use drivebench_model::sample::TWO_SIDED_95;
use drivebench_model::text::number::significant;

/// Horizontal bars from zero with a goal line: the ladder of models and the noise floor. A value that is not finite has no
/// bar.
pub fn bars(
    description: &str,
    axis: &str,
    bars: &[(String, f64)],
    goal: Option<(&str, f64)>,
) -> String {
    const ROW: f64 = 46.0;
    const LEFT: f64 = 16.0;
    // Values are printed after their bars.
    const RIGHT: f64 = 76.0;
    let goal = goal.filter(|goal| goal.1.is_finite());
    let shown = bars.iter().map(|bar| bar.1.max(0.0));
    let Some(values) = Domain::of(shown.chain(goal.map(|goal| goal.1)).chain([0.0])) else {
        return String::new();
    };
    let base = HEAD + ROW * bars.len() as f64;
    let domain = Domain { from: 0.0, ..values };
    let x = Scale::new(Along::Linear, domain, LEFT, WIDTH - RIGHT);
    let mut svg = Svg::default();
    let at = ticks(domain, 10);
    svg.axis_across(&x, &at, HEAD, base);
    svg.unit_across(&x, base + 34.0, axis);
    for (row, (label, value)) in bars.iter().enumerate() {
        let top = HEAD + ROW * row as f64;
        svg.text("legend", LEFT + 2.0, top + 15.0, label);
        let is_last = row + 1 == bars.len();
        let class = if is_last { "bar last" } else { "bar" };
        let end = if value.is_finite() { x.px(value.clamp(0.0, domain.to)) } else { LEFT };
        svg.rectangle(class, LEFT, top + 21.0, end - LEFT, 17.0);
        svg.text("value", end + 6.0, top + 34.0, &significant(*value, 3));
    }
    if let Some((label, value)) = goal {
        let at = x.px(value);
        svg.line("goal", (at, HEAD - 6.0), (at, base));
        // Beside the line, on the side where there is room.
        svg.text("goal-label", (at - 4.0).min(WIDTH - width(label)).max(LEFT), HEAD - 11.0, label);
    }
    svg.close("plot", base + FOOT, description, "")
}

/// Curves with their 95 % intervals over one axis, in panels one under the other: the error of an equation over speed,
/// current, angle or time; a frequency response.
#[derive(Clone, Debug, Default)]
pub struct AxisChart {
    /// The variable with its unit.
    pub axis: String,
    pub unit: &'static str,
    pub is_logarithmic: bool,
    pub panels: Vec<AxisPanel>,
    /// Names and places on the axis that a line marks in all panels.
    pub marks: Vec<(String, f64)>,
}

#[derive(Clone, Debug, Default)]
pub struct AxisPanel {
    pub title: String,
    pub height: f64,
    /// Values that the axis contains at least.
    pub holds: Vec<f64>,
    pub sets: Vec<PointSet>,
    /// Drawn through the points: its label, and points that are all finite; may be empty.
    pub line: (String, Vec<(f64, f64)>),
}

#[derive(Clone, Debug)]
pub struct PointSet {
    /// In the legend; empty: none.
    pub label: String,
    pub style: Style,
    pub drawn: Drawn,
    /// Places on the axis are rising.
    pub points: Vec<Place>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drawn {
    Apart,
    /// Joined by a curve within a band, a dot at each.
    Knots,
    /// The same without dots; what is not finite is a gap.
    Curve,
    /// As faint dots, which move no axis.
    Faint,
}

#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub at: f64,
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

impl Place {
    /// With a standard deviation; one that is not finite counts as none.
    pub fn new(at: f64, value: f64, std: f64) -> Self {
        let half = if std.is_finite() { TWO_SIDED_95 * std } else { 0.0 };
        Self { at, value, low: value - half, high: value + half }
    }

    pub fn is_known(&self) -> bool {
        [self.at, self.value, self.low, self.high].into_iter().all(f64::is_finite)
    }
}

impl PointSet {
    pub fn known(&self) -> impl Iterator<Item = &Place> + Clone {
        self.points.iter().filter(|point| point.is_known())
    }
}

impl AxisPanel {
    /// The range of the values; none where there are not two points.
    pub fn values(&self) -> Option<Domain> {
        let sets = self.sets.iter().filter(|set| set.drawn != Drawn::Faint);
        let known = sets.flat_map(PointSet::known);
        let ends = known.clone().flat_map(|point| [point.low, point.high]);
        let line = self.line.1.iter().map(|point| point.1);
        Domain::of(ends.chain(line).chain(self.holds.iter().copied())).filter(|_| known.count() > 1)
    }
}

impl AxisChart {
    fn shown(&self) -> impl Iterator<Item = (&AxisPanel, Domain)> {
        self.panels.iter().filter_map(|panel| Some((panel, panel.values()?)))
    }

    /// The range of all panels, in exponents where the axis is logarithmic.
    pub fn across(&self) -> Option<Domain> {
        let sets = || self.shown().flat_map(|(panel, _)| &panel.sets);
        let points = sets().flat_map(PointSet::known).map(|point| point.at);
        let lines = self.shown().flat_map(|(panel, _)| &panel.line.1);
        Domain::of(points.chain(lines.map(|point| point.0)).map(|at| self.along().place(at)))
    }

    const fn along(&self) -> Along {
        if self.is_logarithmic { Along::Log } else { Along::Linear }
    }

    /// Empty where no panel has two points.
    pub fn svg(&self, description: &str) -> String {
        const GAP: f64 = 12.0;
        let Some(across) = self.across() else {
            return String::new();
        };
        let x = Scale::across(self.along(), across);
        let at = if self.is_logarithmic { powers(across) } else { ticks(across, 10) };
        let (mut svg, mut upper, mut base) = (Svg::default(), HEAD, HEAD);
        let last = self.shown().count() - 1;
        for (place, (panel, values)) in self.shown().enumerate() {
            base = upper + panel.height;
            let y = Scale::new(Along::Linear, values.padded(0.05), base, upper);
            svg.text("title", LEFT, upper - 9.0, &panel.title);
            let values = ticks(y.domain, 6);
            svg.axis_upwards(&x, &y, &values, &labels(&values));
            if place == last && !self.is_logarithmic {
                svg.axis_across(&x, &at, upper, base);
            } else {
                svg.grid_across(&x, &at, upper, base);
            }
            svg.frame(&x, upper, base);
            panel.draw(&mut svg, &x, &y, upper);
            self.draw_marks(&mut svg, &x, (upper, base), place == 0);
            upper = base + GAP + HEAD;
        }
        for tick in at.iter().filter(|_| self.is_logarithmic) {
            svg.text("tick middle", x.px(*tick), base + 16.0, &plain(*tick));
        }
        svg.unit_across(&x, base + 34.0, &self.axis);
        svg.close("plot", base + FOOT, description, "")
    }

    /// The places that are marked, with their names in the first panel.
    fn draw_marks(&self, svg: &mut Svg, x: &Scale, (upper, base): (f64, f64), named: bool) {
        for (row, (name, place)) in self.marks.iter().enumerate() {
            let at = x.px(*place);
            svg.line("divider", (at, upper), (at, base));
            // Beside the line, on the side where there is room, each in a row of its own.
            let left =
                if at + width(name) + 8.0 < x.to_px { at + 4.0 } else { at - width(name) - 4.0 };
            if named {
                svg.text("tick", left, upper + 13.0 + 14.0 * row as f64, name);
            }
        }
    }
}

impl AxisPanel {
    fn draw(&self, svg: &mut Svg, x: &Scale, y: &Scale, upper: f64) {
        let level = upper - 9.0;
        let mut right = x.to_px;
        let (label, line) = &self.line;
        if !line.is_empty() {
            right = svg.legend_entry(right, level, "command", label);
        }
        for set in &self.sets {
            set.draw(svg, x, y);
            if !set.label.is_empty() && set.known().count() > 0 {
                let class = set.style.class();
                let key = right - width(&set.label) - 18.0;
                right = svg.legend_entry(right, level, class, &set.label);
                if set.drawn == Drawn::Apart {
                    svg.dot(class, (key, level - 4.0), 3);
                }
            }
        }
        // Where there is no data the line is not drawn.
        let widest = 0.1 * (x.domain.to - x.domain.from);
        let pieces = line.chunk_by(|a, b| b.0 - a.0 <= widest);
        let place = |(at, value): &(f64, f64)| (x.px(*at), y.px(*value));
        let path: String = pieces.map(|piece| polyline(piece.iter().map(place)) + "h0").collect();
        svg.path("series command", &path);
    }
}

impl PointSet {
    fn draw(&self, svg: &mut Svg, x: &Scale, y: &Scale) {
        let class = self.style.class();
        let place = |point: &Place, value: f64| (x.px(point.at), y.px(value));
        let known: Vec<&Place> = self.known().collect();
        match self.drawn {
            Drawn::Faint => {
                let Domain { from, to } = y.domain;
                let inside = known.iter().filter(|own| (from..=to).contains(&own.value));
                return inside.for_each(|own| svg.dot("faint", place(own, own.value), 1));
            }
            Drawn::Apart => {
                for own in known.iter().filter(|own| own.high > own.low) {
                    let ends = (place(own, own.low), place(own, own.high));
                    svg.line(&format!("interval {class}"), ends.0, ends.1);
                }
            }
            Drawn::Knots => draw_curve(svg, class, &known, place, ""),
            Drawn::Curve => {
                let pieces = self.points.split(|own| !own.is_known());
                for piece in pieces.filter(|piece| !piece.is_empty()) {
                    let piece: Vec<&Place> = piece.iter().collect();
                    // A point between two gaps: no length and round ends make a dot.
                    draw_curve(svg, class, &piece, place, "h0");
                }
                return;
            }
        }
        for own in &known {
            svg.dot(class, place(own, own.value), 3);
        }
    }
}

fn draw_curve(
    svg: &mut Svg,
    class: &str,
    points: &[&Place],
    place: impl Fn(&Place, f64) -> (f64, f64),
    end: &str,
) {
    let above = points.iter().map(|own| place(own, own.high));
    let below = points.iter().rev().map(|own| place(own, own.low));
    svg.path("spread", &(polyline(above.chain(below)) + "Z"));
    let curve = polyline(points.iter().map(|own| place(own, own.value)));
    svg.path(&format!("series {class}"), &(curve + end));
}

/// A grid of cells: the darker, the larger; each has its value in it, for print in grey.
#[derive(Clone, Debug)]
pub struct MapChart<'a> {
    pub title: String,
    /// Name and unit of the variable along the picture, and its edges.
    pub across: (&'static str, &'a [f64]),
    /// The same for the variable upwards.
    pub upwards: (&'static str, &'a [f64]),
    /// A row for each interval upwards, from the lowest; `None` where nothing is known.
    pub values: &'a [Vec<Option<f64>>],
    /// Shown when a cell is pointed at.
    pub counts: &'a [Vec<usize>],
}

impl MapChart<'_> {
    /// Empty where there is no cell with a value.
    pub fn svg(&self, description: &str) -> String {
        let ((across, columns), (upwards, rows)) = (self.across, self.upwards);
        let largest = self.values.iter().flatten().flatten().copied().fold(0.0, f64::max);
        let domain = |edges: &[f64]| Domain::of(edges.iter().copied());
        let (Some(x), Some(y), true) = (domain(columns), domain(rows), largest > 0.0) else {
            return String::new();
        };
        let base = HEAD + 26.0 * self.values.len() as f64;
        let x = Scale::across(Along::Linear, x);
        let y = Scale::new(Along::Linear, y, base, HEAD);
        let mut svg = Svg::default();
        svg.text("title", LEFT, HEAD - 9.0, &self.title);
        for (row, values) in self.values.iter().enumerate() {
            let (bottom, top) = (y.px(rows[row]), y.px(rows[row + 1]));
            for (column, value) in values.iter().enumerate() {
                let (from, to) = (x.px(columns[column]), x.px(columns[column + 1]));
                let Some(value) = value else { continue };
                svg.write(format_args!(
                    "<g><title>{} in {} windows</title><rect class=\"cell\" fill-opacity=\"{:.2}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
                    significant(*value, 3),
                    self.counts[row][column],
                    0.05 + 0.6 * value / largest,
                    px(from),
                    px(top),
                    px(to - from),
                    px(bottom - top)
                ));
                let (middle, level) = (0.5 * (from + to), 0.5 * (top + bottom) + 4.0);
                svg.text("tick middle", middle, level, &significant(*value, 2));
                svg.write(format_args!("</g>"));
            }
        }
        svg.frame(&x, HEAD, base);
        svg.labels_across(&x, &ticks(x.domain, 10), base);
        let at = ticks(y.domain, 8);
        for (label, tick) in labels(&at).iter().zip(&at) {
            svg.text("tick end", LEFT - 7.0, y.px(*tick) + 4.0, label);
        }
        svg.unit_across(&x, base + 34.0, across);
        svg.text("unit end", x.to_px, HEAD - 9.0, upwards);
        svg.close("plot", base + FOOT, description, "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text between two others, wherever the first one occurs.
    fn between<'a>(svg: &'a str, before: &'a str, after: char) -> impl Iterator<Item = &'a str> {
        let rest = svg.split(before).skip(1);
        rest.map(move |rest| rest.split(after).next().unwrap_or_default())
    }

    #[test]
    fn a_bar_ends_at_its_value_and_a_missing_one_has_no_length() {
        let ladder =
            [("a", 4.0), ("b", 2.0), ("c", f64::NAN)].map(|(name, v)| (name.to_owned(), v));
        let svg = bars("ladder", "error", &ladder, Some(("floor", 1.0)));
        let lengths: Vec<f64> =
            between(&svg, " width=\"", '"').map(|px| px.parse().unwrap()).collect();
        assert!(
            (lengths[0] / lengths[1] - 2.0).abs() < 0.01 && lengths[2].abs() < 1e-9,
            "{lengths:?}"
        );
        assert!(!svg.contains("NaN") && svg.contains(">n/a<"));
    }

    #[test]
    fn knots_are_at_their_axis_value_and_a_missing_one_is_left_out() {
        let chart = |values: &[f64], std: &[f64]| {
            let stds = std.iter().copied().chain(std::iter::repeat(f64::NAN));
            let points = [-100.0, 0.0, 100.0].into_iter().zip(values).zip(stds);
            let points = points.map(|((knot, value), std)| Place::new(knot, *value, std));
            let set = PointSet {
                label: String::new(),
                style: Style::After,
                drawn: Drawn::Knots,
                points: points.collect(),
            };
            AxisChart {
                axis: "speed, rad/s".to_owned(),
                panels: vec![AxisPanel {
                    title: "what <it> lacks".to_owned(),
                    height: 210.0,
                    holds: vec![0.0],
                    sets: vec![set],
                    ..AxisPanel::default()
                }],
                ..AxisChart::default()
            }
            .svg("curve")
        };
        let svg = chart(&[0.1, 0.0, -0.1], &[0.01, 0.01, 0.01]);
        assert_eq!(svg.matches("class=\"knot").count(), 3);
        assert!(svg.contains("cx=\"66\"") && svg.contains("cx=\"876\""), "{svg}");
        assert!(svg.contains("what &lt;it&gt; lacks"));
        let svg = chart(&[0.1, f64::NAN, -0.1], &[f64::NAN]);
        assert_eq!(svg.matches("class=\"knot").count(), 2);
        assert!(!svg.contains("NaN"));
        assert_eq!(chart(&[f64::NAN, 0.1, f64::INFINITY], &[]), "");
    }

    #[test]
    fn a_curve_over_frequency_has_gaps_faint_dots_and_modes() {
        let chart = |is_carried: fn(i32) -> bool| {
            let set = |label: &str, drawn, shows: bool| {
                let place = |k: i32| Place {
                    at: 0.5 * 1.2_f64.powi(k),
                    value: if is_carried(k) == shows { f64::from(k) } else { f64::NAN },
                    low: f64::from(k) - 1.0,
                    high: if k == 3 { f64::NAN } else { f64::from(k) + 1.0 },
                };
                PointSet {
                    label: label.to_owned(),
                    style: Style::Measured,
                    drawn,
                    points: (0..30).map(place).collect(),
                }
            };
            let sets = vec![set("measured <1>", Drawn::Curve, true), set("", Drawn::Faint, false)];
            let panel = AxisPanel {
                title: "magnitude, dB".to_owned(),
                height: 150.0,
                sets,
                ..AxisPanel::default()
            };
            AxisChart {
                axis: "frequency, Hz".to_owned(),
                unit: "Hz",
                is_logarithmic: true,
                panels: vec![panel],
                marks: vec![("resonance".to_owned(), 5.0)],
            }
            .svg("response")
        };
        let svg = chart(|k| !(10..20).contains(&k));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("class=\"knot faint\"").count(), 10);
        // One of three pieces is cut in two by the point whose interval is not known.
        assert_eq!(svg.matches("class=\"spread\"").count(), 3);
        assert!(svg.contains("measured &lt;1&gt;") && svg.contains(">resonance</text>"));
        assert_eq!(chart(|_| false), "");
    }

    #[test]
    fn a_cell_is_at_its_edges_and_an_unknown_one_is_left_out() {
        let chart = |values: &[Vec<Option<f64>>]| {
            MapChart {
                title: "t".into(),
                across: ("current, A", &[0.0, 1.0, 2.0]),
                upwards: ("speed, rad/s", &[0.0, 10.0, 20.0]),
                values,
                counts: &[vec![3, 0], vec![5, 7]],
            }
            .svg("map")
        };
        let svg = chart(&[vec![Some(0.5), None], vec![Some(1.0), Some(0.25)]]);
        assert_eq!(svg.matches("class=\"cell\"").count(), 3);
        // The largest is the darkest, and lies in the upper row at the left.
        assert!(svg.contains("fill-opacity=\"0.65\" x=\"66\" y=\"26\""), "{svg}");
        assert!(svg.contains("in 5 windows"));
        assert_eq!(chart(&[vec![None, None], vec![None, None]]), "");
    }
}
