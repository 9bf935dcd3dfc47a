//! The pictures that are no course over time: bars, a curve with its band, curves over ratios, a map, reliability.

use super::axis::{Domain, labels, ticks};
use super::chart::{Along, FOOT, HEAD, LEFT, RIGHT, Scale, Svg, WIDTH, polyline, px, width};
use super::panels::Style;
use drivebench_model::sample::TWO_SIDED_95;
use drivebench_model::text::number::significant;

/// Horizontal bars from zero with a goal line that they ought to reach: the ladder of models and the noise floor. A value
/// that is not finite has no bar and says so.
pub fn bars(
    description: &str,
    axis: &str,
    bars: &[(String, f64)],
    goal: Option<(&str, f64)>,
) -> String {
    const ROW: f64 = 46.0;
    const LEFT: f64 = 16.0;
    // Values stand behind their bars.
    const RIGHT: f64 = 76.0;
    let goal = goal.filter(|goal| goal.1.is_finite());
    let shown = bars.iter().map(|bar| bar.1.max(0.0));
    let Some(values) = Domain::of(shown.chain(goal.map(|goal| goal.1)).chain([0.0])) else {
        return String::new();
    };
    let base = HEAD + ROW * bars.len() as f64;
    let domain = Domain {
        from: 0.0,
        ..values
    };
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
        let end = if value.is_finite() {
            x.px(value.clamp(0.0, domain.to))
        } else {
            LEFT
        };
        svg.rectangle(class, LEFT, top + 21.0, end - LEFT, 17.0);
        svg.text("value", end + 6.0, top + 34.0, &significant(*value, 3));
    }
    if let Some((label, value)) = goal {
        let at = x.px(value);
        svg.line("goal", (at, HEAD - 6.0), (at, base));
        // Beside the line, on the side where there is room.
        let left = (at - 4.0).min(WIDTH - width(label)).max(LEFT);
        svg.text("goal-label", left, HEAD - 11.0, label);
    }
    svg.close("plot", base + FOOT, description, "")
}

/// Values along one axis with their 95 % intervals: what an equation lacks over speed, current, angle or time; and a line
/// drawn through them, the effect that is to explain it.
#[derive(Clone, Debug)]
pub struct AxisChart<'a> {
    pub title: String,
    pub axis: &'a str,
    pub sets: Vec<PointSet<'a>>,
    /// Its label and points, all finite; may be empty.
    pub line: (&'a str, &'a [(f64, f64)]),
}

/// Points of one kind.
#[derive(Clone, Debug)]
pub struct PointSet<'a> {
    /// In the legend; empty: none.
    pub label: &'a str,
    pub style: Style,
    /// Place on the axis, rising; value; its standard deviation. What is not finite is left out, a deviation taken for none.
    pub points: Vec<(f64, f64, f64)>,
    /// Joined by a curve with a band about it, not points with intervals of their own.
    pub is_joined: bool,
}

/// Share of the axis over which a line is drawn without a point of it.
const WIDEST_GAP: f64 = 0.1;

impl AxisChart<'_> {
    /// Empty where there are not two points.
    pub fn svg(&self, description: &str) -> String {
        let known = |set: &PointSet<'_>| -> Vec<(f64, f64, f64)> {
            let points = set.points.iter().copied();
            let known = points.filter(|(place, value, _)| place.is_finite() && value.is_finite());
            known
                .map(|(place, value, std)| {
                    let std = if std.is_finite() { std } else { 0.0 };
                    (place, value, TWO_SIDED_95 * std)
                })
                .collect()
        };
        let sets: Vec<_> = self.sets.iter().map(|set| (set, known(set))).collect();
        let (label, line) = self.line;
        let all = || sets.iter().flat_map(|(_, points)| points);
        let edges = all().flat_map(|(_, value, half)| [value - half, value + half]);
        let across = all().map(|point| point.0);
        let across = Domain::of(across.chain(line.iter().map(|point| point.0)));
        let upwards = edges.chain(line.iter().map(|point| point.1)).chain([0.0]);
        let (Some(across), Some(upwards), true) = (across, Domain::of(upwards), all().count() > 1)
        else {
            return String::new();
        };
        let base = HEAD + 210.0;
        let x = Scale::across(Along::Linear, across);
        let y = Scale::new(Along::Linear, upwards.padded(0.05), base, HEAD);
        let mut svg = Svg::default();
        svg.text("title", LEFT, HEAD - 9.0, &self.title);
        let at = ticks(y.domain, 6);
        svg.axis_upwards(&x, &y, &at, &labels(&at));
        let at = ticks(x.domain, 10);
        svg.axis_across(&x, &at, HEAD, base);
        svg.frame(&x, HEAD, base);
        let place = |place: f64, value: f64| (x.px(place), y.px(value));
        let mut right = x.to_px;
        if !line.is_empty() {
            right = svg.legend_entry(right, HEAD - 9.0, "command", label);
        }
        for (set, points) in &sets {
            let class = set.style.class();
            if set.is_joined {
                let above = points.iter().map(|(at, v, half)| place(*at, v + half));
                let below = points.iter().map(|(at, v, half)| place(*at, v - half));
                svg.path("spread", &(polyline(above.chain(below.rev())) + "Z"));
                let curve = points.iter().map(|(at, value, _)| place(*at, *value));
                svg.path(&format!("series {class}"), &polyline(curve));
            } else {
                for (at, value, half) in points.iter().filter(|point| point.2 > 0.0) {
                    let ends = (place(*at, value - half), place(*at, value + half));
                    svg.line(&format!("interval {class}"), ends.0, ends.1);
                }
            }
            for (at, value, _) in points {
                svg.dot(class, place(*at, *value), 3);
            }
            if !set.label.is_empty() && !points.is_empty() {
                let key = right - width(set.label) - 18.0;
                right = svg.legend_entry(right, HEAD - 9.0, class, set.label);
                svg.dot(class, (key, HEAD - 13.0), 3);
            }
        }
        // Where the run never was the line says nothing.
        let widest = WIDEST_GAP * (across.to - across.from);
        let pieces = line.chunk_by(|a, b| b.0 - a.0 <= widest);
        let path: String = pieces
            .map(|piece| polyline(piece.iter().map(|(at, value)| place(*at, *value))) + "h0")
            .collect();
        svg.path("series command", &path);
        svg.unit_across(&x, base + 34.0, self.axis);
        svg.close("plot", base + FOOT, description, "")
    }
}

/// A grid of cells: the darker, the larger; the value stands in each, so that grey paper says the same.
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
        let known = self.values.iter().flatten().flatten().copied();
        let largest = known.fold(0.0, f64::max);
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

/// How errors grow with a ratio: curves over a logarithmic axis, both ways. One legend serves all panels.
#[derive(Clone, Debug)]
pub struct CurveChart {
    pub axis: String,
    /// One to a curve, the same in all panels.
    pub labels: Vec<String>,
    pub panels: Vec<CurvePanel>,
    /// Powers of ten that the value axes show; smaller and larger values are drawn at the edge.
    pub decades: (i32, i32),
}

/// Curves of one quantity; a curve without values stays in the legend of the others.
#[derive(Clone, Debug)]
pub struct CurvePanel {
    pub title: String,
    /// One curve per label of the chart: `(x, y)`, both positive; what is not finite is a gap.
    pub curves: Vec<Vec<(f64, f64)>>,
}

impl CurveChart {
    pub fn svg(&self, description: &str) -> String {
        const PANEL: f64 = 190.0;
        let curves = self.panels.iter().flat_map(|panel| &panel.curves);
        let drawn = (curves.flatten()).filter(|(x, y)| x.is_finite() && *x > 0.0 && y.is_finite());
        let (from, to) = drawn.fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), point| {
            (from.min(point.0.log10()), to.max(point.0.log10()))
        });
        if from >= to {
            return String::new();
        }
        let x = Scale::across(Along::Log, Domain { from, to });
        let mut svg = Svg::default();
        let mut top = self.legend(&mut svg);
        for panel in &self.panels {
            self.panel(&mut svg, panel, &x, top + HEAD, top + HEAD + PANEL - 14.0);
            top += HEAD + PANEL;
        }
        for tick in powers(&x) {
            svg.text("tick middle", x.px(tick), top + 16.0, &plain(tick));
        }
        svg.unit_across(&x, top + 34.0, &self.axis);
        svg.close("plot", top + FOOT, description, "")
    }

    /// Draws the legend in rows and returns the height it takes.
    fn legend(&self, svg: &mut Svg) -> f64 {
        const ROW: f64 = 20.0;
        const SAMPLE: f64 = 34.0;
        let (mut at, mut base) = (LEFT, ROW - 5.0);
        for (index, label) in self.labels.iter().enumerate() {
            let needed = SAMPLE + 8.0 + width(label) + 20.0;
            if at + needed > WIDTH - RIGHT && at > LEFT {
                (at, base) = (LEFT, base + ROW);
            }
            let class = format!("key {}", class(index));
            svg.line(&class, (at, base - 4.0), (at + SAMPLE, base - 4.0));
            mark(svg, index, (at + 0.5 * SAMPLE, base - 4.0));
            svg.text("legend", at + SAMPLE + 8.0, base, label);
            at += needed;
        }
        base + 8.0
    }

    fn panel(&self, svg: &mut Svg, panel: &CurvePanel, x: &Scale, upper: f64, lower: f64) {
        let (from, to) = (f64::from(self.decades.0), f64::from(self.decades.1));
        let y = Scale::new(Along::Log, Domain { from, to }, lower, upper);
        svg.write(format_args!("<g class=\"panel\">"));
        svg.frame(x, upper, lower);
        svg.grid_across(x, &powers(x), upper, lower);
        let at = powers(&y);
        svg.axis_upwards(
            x,
            &y,
            &at,
            &at.iter().map(|tick| plain(*tick)).collect::<Vec<_>>(),
        );
        svg.text("title", x.from_px, upper - 8.0, &panel.title);
        for (index, curve) in panel.curves.iter().enumerate() {
            let is_drawn =
                |(at, value): &(f64, f64)| at.is_finite() && value.is_finite() && *at > 0.0;
            let place = |(at, value): &(f64, f64)| (x.px(*at), y.px(value.max(f64::MIN_POSITIVE)));
            let pieces = curve.split(|point| !is_drawn(point));
            let path: String = pieces
                .map(|piece| polyline(piece.iter().map(place)))
                .collect();
            if !path.is_empty() {
                svg.path(&format!("series {}", class(index)), &path);
            }
            let points = curve.iter().filter(|point| is_drawn(point));
            points.for_each(|point| mark(svg, index, place(point)));
        }
        svg.write(format_args!("</g>"));
    }
}

/// One of the ten kinds of lines that the style sheet tells apart; more curves begin again.
fn class(index: usize) -> String {
    format!("k{}", index % 10)
}

/// A small shape of its own for each kind: square, diamond, triangle, cross, plus.
fn mark(svg: &mut Svg, index: usize, (x, y): (f64, f64)) {
    let shape = match index % 5 {
        0 => "m-3 -3h6v6h-6z",
        1 => "m0 -4l4 4l-4 4l-4 -4z",
        2 => "m0 -4l4 7h-8z",
        3 => "m-3 -3l6 6m0 -6l-6 6",
        _ => "m-4 0h8m-4 -4v8",
    };
    let filled = if index < 5 { " filled" } else { "" };
    let class = format!("dot {}{filled}", class(index));
    svg.path(&class, &(polyline([(x, y)]) + shape));
}

/// Powers of ten, and 2 and 5 times them where there are few.
pub(super) fn powers(scale: &Scale) -> Vec<f64> {
    let Domain { from, to } = scale.domain;
    let few = to - from < 4.0;
    let factors: &[f64] = if few { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let all = (-30..=30).flat_map(|power| factors.iter().map(move |f| f * 10f64.powi(power)));
    all.filter(|tick| (from - 1e-9..=to + 1e-9).contains(&tick.log10()))
        .collect()
}

/// A tick without an exponent where it is short.
pub(super) fn plain(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// Claims of about one probability, and the share of them that came true with its bounds.
#[derive(Clone, Copy, Debug)]
pub struct Claims {
    pub given: f64,
    pub share: f64,
    pub low: f64,
    pub high: f64,
    pub count: usize,
}

/// Given probabilities against how often they came true, both in log odds: what is nearly certain gets as much room as a
/// toss-up. Empty where nothing was claimed.
pub fn reliability(description: &str, title: &str, across: &str, claims: &[Claims]) -> String {
    // What lies beyond the first and the last is drawn there.
    const TICKS: [f64; 9] = [0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999];
    const BASE: f64 = HEAD + 380.0;
    if claims.is_empty() {
        return String::new();
    }
    let [from, to] = [TICKS[0], TICKS[8]].map(|edge| Along::Odds.place(edge));
    let x = Scale::across(Along::Odds, Domain { from, to });
    let y = Scale::new(Along::Odds, x.domain, BASE, HEAD);
    let mut svg = Svg::default();
    svg.text("title", LEFT, HEAD - 9.0, title);
    for tick in TICKS {
        let label = tick.to_string();
        svg.line("grid", (x.px(tick), HEAD), (x.px(tick), BASE));
        svg.line("grid", (x.from_px, y.px(tick)), (x.to_px, y.px(tick)));
        svg.text("tick middle", x.px(tick), BASE + 16.0, &label);
        svg.text("tick end", LEFT - 7.0, y.px(tick) + 4.0, &label);
    }
    svg.frame(&x, HEAD, BASE);
    svg.line("goal", (x.from_px, BASE), (x.to_px, HEAD));
    for found in claims {
        let (at, share) = (x.px(found.given), y.px(found.share));
        let ends = [y.px(found.low), y.px(found.high)];
        svg.line("key after", (at, ends[0]), (at, ends[1]));
        for end in ends {
            svg.line("key after", (at - 5.0, end), (at + 5.0, end));
        }
        svg.dot("after", (at, share), 4);
        // Beside the diagonal, not on it, where the frame leaves room.
        let place = (at - x.from_px) / (x.to_px - x.from_px);
        let is_left = place > 0.9 || (place > 0.1 && found.share > found.given);
        let (class, beside) = if is_left {
            ("value end", at - 9.0)
        } else {
            ("value", at + 9.0)
        };
        let level = share.clamp(HEAD + 14.0, BASE - 6.0);
        svg.text(class, beside, level, &format!("of {}", found.count));
    }
    svg.unit_across(&x, BASE + 34.0, across);
    svg.close("plot", BASE + FOOT, description, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What stands between two texts, wherever the first one occurs.
    fn between<'a>(svg: &'a str, before: &'a str, after: char) -> impl Iterator<Item = &'a str> {
        let rest = svg.split(before).skip(1);
        rest.map(move |rest| rest.split(after).next().unwrap_or_default())
    }

    #[test]
    fn a_bar_ends_at_its_value_and_a_missing_one_has_no_length() {
        let ladder =
            [("a", 4.0), ("b", 2.0), ("c", f64::NAN)].map(|(name, v)| (name.to_owned(), v));
        let svg = bars("ladder", "error", &ladder, Some(("floor", 1.0)));
        let lengths: Vec<f64> = between(&svg, " width=\"", '"')
            .map(|px| px.parse().unwrap())
            .collect();
        assert!(
            (lengths[0] / lengths[1] - 2.0).abs() < 0.01 && lengths[2].abs() < 1e-9,
            "{lengths:?}"
        );
        assert!(!svg.contains("NaN") && svg.contains(">n/a<"));
    }

    #[test]
    fn knots_stand_at_their_place_and_a_missing_one_is_left_out() {
        let chart = |values: &[f64], std: &[f64]| {
            let (title, axis) = ("what <it> lacks".to_owned(), "speed, rad/s");
            let stds = std.iter().copied().chain(std::iter::repeat(f64::NAN));
            let points = [-100.0, 0.0, 100.0].into_iter().zip(values).zip(stds);
            let points = points.map(|((knot, value), std)| (knot, *value, std));
            let sets = vec![PointSet {
                label: "",
                style: Style::After,
                points: points.collect(),
                is_joined: true,
            }];
            AxisChart {
                title,
                axis,
                sets,
                line: ("", &[]),
            }
            .svg("curve")
        };
        let svg = chart(&[0.1, 0.0, -0.1], &[0.01, 0.01, 0.01]);
        assert_eq!(svg.matches("class=\"knot").count(), 3);
        assert!(
            svg.contains("cx=\"66\"") && svg.contains("cx=\"876\""),
            "{svg}"
        );
        assert!(svg.contains("what &lt;it&gt; lacks"));
        let svg = chart(&[0.1, f64::NAN, -0.1], &[f64::NAN]);
        assert_eq!(svg.matches("class=\"knot").count(), 2);
        assert!(!svg.contains("NaN"));
        assert_eq!(chart(&[f64::NAN, 0.1, f64::INFINITY], &[]), "");
    }

    #[test]
    fn a_cell_stands_at_its_edges_and_an_unknown_one_is_left_out() {
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
        assert!(
            svg.contains("fill-opacity=\"0.65\" x=\"66\" y=\"26\""),
            "{svg}"
        );
        assert!(svg.contains("in 5 windows"));
        assert_eq!(chart(&[vec![None, None], vec![None, None]]), "");
    }

    fn curve(points: Vec<(f64, f64)>) -> String {
        let (title, curves) = ("error, %".to_owned(), vec![points]);
        let chart = CurveChart {
            axis: "T/Ta".into(),
            labels: vec!["a <b>".into()],
            panels: vec![CurvePanel { title, curves }],
            decades: (-3, 3),
        };
        chart.svg("errors")
    }

    #[test]
    fn a_gap_cuts_the_curve_and_nothing_absurd_reaches_the_picture() {
        let (gap, end) = ((0.1, f64::NAN), (2.0, f64::INFINITY));
        let svg = curve(vec![
            (0.01, 1.0),
            gap,
            (1.0, 10.0),
            end,
            (3.0, 0.0),
            (-1.0, 5.0),
        ]);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let path = between(&svg, "class=\"series k0\" d=\"", '"')
            .next()
            .unwrap();
        assert_eq!(path.matches('M').count(), 3);
        assert!(svg.contains("a &lt;b&gt;"));
        assert_eq!(curve(vec![(1.0, f64::NAN)]), "");
    }

    #[test]
    fn a_decade_has_the_same_height_everywhere() {
        let svg = curve(vec![(1.0, 0.1), (10.0, 1.0), (100.0, 10.0)]);
        let path = between(&svg, "class=\"series k0\" d=\"", '"')
            .next()
            .unwrap();
        let points = path.split(['M', 'L']).filter(|point| !point.is_empty());
        let heights: Vec<f64> = points
            .map(|point| point.split(' ').nth(1).unwrap().parse().unwrap())
            .collect();
        let bend = heights[0] - 2.0 * heights[1] + heights[2];
        assert!(bend.abs() < 0.3 && heights[0] > heights[1], "{heights:?}");
    }

    #[test]
    fn claims_that_came_true_as_given_lie_on_the_diagonal_and_extremes_in_the_frame() {
        let claims = [0.5, 0.0, 1.0].map(|given| Claims {
            given,
            share: given,
            low: 0.5 * given,
            high: 0.5 + 0.5 * given,
            count: 12,
        });
        let svg = reliability("reliability", "true <of>", "given", &claims);
        assert!(svg.contains("cx=\"471\" cy=\"216\""), "{svg}");
        assert!(svg.contains("cx=\"66\" cy=\"406\"") && svg.contains("cx=\"876\" cy=\"26\""));
        assert!(svg.contains("true &lt;of&gt;") && !svg.contains("NaN"));
        assert_eq!(reliability("reliability", "true <of>", "given", &[]), "");
    }
}
