//! Panels stacked over one time axis.

use std::ops::RangeInclusive;

use super::axis::{Domain, labels, ticks};
use super::chart::{Along, LEFT, Scale, Svg, WIDTH, polyline, px, width};
use super::decimate::{Pieces, decimate, held, pieces};
use super::{Plot, detail};
use crate::report::html::escape;
use drivebench_model::text::number::significant;

/// Room for a second unit on the right, above each panel, between panels, and below the last one, px.
const HEAD: f64 = 24.0;
const GAP: f64 = 12.0;
/// Ticks along a value axis at most.
const VALUE_TICKS: usize = 6;

/// What a line stands for; each has a colour, a width and a dash pattern of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    Measured,
    Command,
    Before,
    After,
}

impl Style {
    pub(super) const fn class(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Command => "command",
            Self::Before => "before",
            Self::After => "after",
        }
    }
}

#[derive(Clone, Debug)]
struct Series {
    label: String,
    style: Style,
    pieces: Pieces,
}

impl Series {
    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.pieces.iter().flatten().copied()
    }
}

#[derive(Clone, Debug)]
pub struct Panel {
    title: String,
    unit: String,
    height: f64,
    series: Vec<Series>,
    /// A shaded range of values over the whole time: label, from, to.
    band: Option<(String, f64, f64)>,
    second: Option<(&'static str, f64)>,
    frame: RangeInclusive<f64>,
}

impl Panel {
    pub fn new(title: impl Into<String>, unit: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            unit: unit.into(),
            height: 150.0,
            series: Vec::new(),
            band: None,
            second: None,
            frame: f64::NEG_INFINITY..=f64::INFINITY,
        }
    }

    #[must_use]
    pub const fn with_height(mut self, height: f64) -> Self {
        self.height = height;
        self
    }

    /// The line is cut where it leaves this range; for lines that are still to come.
    #[must_use]
    pub const fn within(mut self, frame: RangeInclusive<f64>) -> Self {
        self.frame = frame;
        self
    }

    /// Sampled values; NaN and longer intervals are gaps.
    #[must_use]
    pub fn sampled(
        self,
        label: impl Into<String>,
        style: Style,
        time_s: &[f64],
        values: &[f64],
    ) -> Self {
        let points = time_s.iter().copied().zip(values.iter().copied());
        let in_frame = |(time_s, value)| match value {
            value if self.frame.contains(&value) => (time_s, value),
            _ => (time_s, f64::NAN),
        };
        let pieces = pieces(points.map(in_frame));
        self.with(label, style, pieces)
    }

    /// A command, held from each event to the next.
    #[must_use]
    pub fn held(self, label: impl Into<String>, events: &[(f64, f64)], end_s: f64) -> Self {
        self.with(label, Style::Command, held(events, end_s))
    }

    fn with(mut self, label: impl Into<String>, style: Style, pieces: Pieces) -> Self {
        self.series.push(Series { label: label.into(), style, pieces });
        self
    }

    /// A band about zero; left out where its half-width is not finite.
    #[must_use]
    pub fn with_band(mut self, label: &str, half_width: f64) -> Self {
        self.band = half_width.is_finite().then_some((label.to_owned(), -half_width, half_width));
        self
    }

    /// The same axis in a second unit, on the right: value times `factor`.
    #[must_use]
    pub const fn with_second_unit(mut self, unit: &'static str, factor: f64) -> Self {
        self.second = Some((unit, factor));
        self
    }

    fn is_empty(&self) -> bool {
        self.series.iter().all(|series| series.pieces.is_empty())
    }

    fn values(&self) -> Option<Domain> {
        let band = self.band.iter().flat_map(|(_, from, to)| [*from, *to]);
        Domain::of(self.series.iter().flat_map(Series::points).map(|point| point.1).chain(band))
    }

    fn draw(&self, svg: &mut Svg, x: &Scale, time_ticks: &[f64], top: f64) {
        let Some(values) = self.values() else { return };
        let (upper, lower) = (top + HEAD, top + HEAD + self.height);
        let y = Scale::new(Along::Linear, values.padded(0.05), lower, upper);
        let second = self.second.map_or(0.0, |(_, factor)| factor);
        svg.write(format_args!(
            "<g class=\"panel\" data-y=\"{} {}\" data-unit=\"{}\" data-second=\"{second}\">",
            px(lower),
            px(upper),
            escape(&self.unit)
        ));
        svg.frame(x, upper, lower);
        svg.write(format_args!("<g class=\"axes\">"));
        svg.grid_across(x, time_ticks, upper, lower);
        let at = ticks(y.domain, VALUE_TICKS);
        svg.axis_upwards(x, &y, &at, &labels(&at));
        if let Some((_, factor)) = self.second {
            let second = ticks(y.domain.scaled(factor), VALUE_TICKS);
            for (label, tick) in labels(&second).iter().zip(&second) {
                let at = y.px(tick / factor);
                svg.line("mark", (x.to_px, at), (x.to_px + 4.0, at));
                svg.text("tick", x.to_px + 7.0, at + 4.0, label);
            }
        }
        svg.write(format_args!("</g>"));
        svg.open_clipped("lines", x, upper, lower);
        if let Some((_, from, to)) = self.band {
            let (a, b) = (y.px(to), y.px(from));
            svg.write(format_args!("<g data-band=\"{from:e} {to:e}\">"));
            svg.rectangle("band", x.from_px, a, x.to_px - x.from_px, b - a);
            svg.write(format_args!("</g>"));
        }
        for series in &self.series {
            svg.write(format_args!(
                "<path class=\"series {}\" data-label=\"{}\" d=\"{}\"/>",
                series.style.class(),
                escape(&series.label),
                path(series, x, &y)
            ));
        }
        svg.write(format_args!("</svg>"));
        self.heading(svg, x, top + HEAD - 8.0);
        svg.write(format_args!("</g>"));
    }

    /// Name and unit on the left, legend on the right of the same line.
    fn heading(&self, svg: &mut Svg, x: &Scale, base: f64) {
        const SAMPLE: f64 = 26.0;
        let title = format!("{}, {}", self.title, self.unit);
        svg.text("title", x.from_px, base, &title);
        let mut right = x.to_px;
        if let Some((unit, _)) = self.second {
            svg.text("unit", x.to_px + 7.0, base, unit);
        }
        if let Some((label, ..)) = &self.band {
            svg.text("legend end", right, base, label);
            right -= width(label);
            svg.rectangle("band", right - SAMPLE - 5.0, base - 9.0, SAMPLE, 10.0);
            right -= SAMPLE + 18.0;
        }
        for (line, series) in self.series.iter().enumerate().rev() {
            svg.write(format_args!("<g class=\"entry\" data-line=\"{line}\">"));
            right = svg.legend_entry(right, base, series.style.class(), &series.label);
            svg.write(format_args!("</g>"));
        }
    }
}

fn path(series: &Series, x: &Scale, y: &Scale) -> String {
    let mut path = String::new();
    for piece in decimate(&series.pieces, x.domain.from, x.domain.to, 776) {
        path += &polyline(piece.iter().map(|point| (x.px(point.0), y.px(point.1))));
        if piece.len() == 1 {
            // A lone value between two gaps: a line of no length with round ends is a dot.
            path += "h0";
        }
    }
    path
}

/// Panels one under the other over `axis`, its name and unit (which may be empty); panels without any value are left out.
/// The description is for screen readers; the plot is empty where there is no panel. Of the points behind it at most
/// about `most_points` are kept for zooming in.
pub fn stacked(
    description: &str,
    axis: (&str, &str),
    panels: &[Panel],
    most_points: usize,
) -> Plot {
    let panels = || panels.iter().filter(|panel| !panel.is_empty());
    let points = panels().flat_map(|panel| &panel.series).flat_map(Series::points);
    let Some(time) = Domain::of(points.map(|point| point.0)) else {
        return Plot::default();
    };
    let x = Scale::new(Along::Linear, time, LEFT, WIDTH - 58.0);
    let time_ticks = ticks(time, 12);
    let (mut svg, mut top) = (Svg::default(), 0.0);
    for panel in panels() {
        panel.draw(&mut svg, &x, &time_ticks, top);
        top += HEAD + panel.height + GAP;
    }
    let base = top - GAP;
    svg.write(format_args!("<g class=\"axis\">"));
    svg.labels_across(&x, &time_ticks, base);
    svg.write(format_args!("</g>"));
    let (name, unit) = axis;
    let separator = if unit.is_empty() { "" } else { ", " };
    svg.unit_across(&x, base + 33.0, &format!("{name}{separator}{unit}"));
    let more = format!(
        " data-x=\"{} {} {} {}\" data-x-unit=\"{unit}\"",
        time.from,
        time.to,
        px(x.from_px),
        px(x.to_px)
    );
    let lines = panels().flat_map(|panel| &panel.series);
    let lines: Vec<&Pieces> = lines.map(|series| &series.pieces).collect();
    let (points, width) = detail::encode(&lines, time.from, time.to, most_points);
    Plot {
        points,
        thinned: width.map(|width| format!("{} {unit}", significant(width, 2))),
        svg: svg.close("plot panels", base + 40.0, description, &more),
    }
}

pub const TIME: (&str, &str) = ("time", "s");

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(values: &[f64]) -> String {
        let time_s: Vec<f64> = (0..values.len()).map(|k| 0.01 * k as f64).collect();
        let panel = Panel::new("speed", "rad/s").with_second_unit("r/min", 9.549_296_585_513_72);
        let panel = panel.sampled("measured <1>", Style::Measured, &time_s, values);
        stacked("a \"plot\"", TIME, &[panel], 1000).svg
    }

    #[test]
    fn missing_and_absurd_values_never_reach_the_picture() {
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        let svg = plot(&[1.0, nan, 2.0, infinite, -infinite, 3.0, 3.0, 4.0]);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(svg.matches('M').count() > 4, "gaps are drawn as gaps");
        assert_eq!(plot(&[f64::NAN; 5]), "", "a panel without values is left out");
    }

    #[test]
    fn labels_are_escaped() {
        let svg = plot(&[1.0, 2.0]);
        assert!(svg.contains("measured &lt;1&gt;") && svg.contains("a &quot;plot&quot;"));
    }

    #[test]
    fn a_long_run_makes_a_bounded_picture() {
        let sign = |k: i32| if k % 2 == 0 { 1.0 } else { -1.0 };
        let values: Vec<f64> = (0..200_000).map(|k| f64::from(k % 977) * sign(k)).collect();
        assert!(plot(&values).len() < 60_000);
    }
}
