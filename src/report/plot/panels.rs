//! Panels stacked over one time axis.

use std::fmt::Write;

use super::axis::{Domain, Scale, labels, ticks};
use super::decimate::{Pieces, decimate, held, pieces};
use super::draw::{line, px, rectangle, text, width};
use crate::report::escape::escape;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 58.0;
const HEAD: f64 = 24.0;
const GAP: f64 = 12.0;
const FOOT: f64 = 40.0;
/// Columns for decimation: one to a pixel between the margins.
const COLUMNS: usize = 776;
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
    const fn class(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Command => "command",
            Self::Before => "before",
            Self::After => "after",
        }
    }
}

/// One line, cut where values are missing.
#[derive(Clone, Debug)]
pub struct Series {
    label: String,
    style: Style,
    pieces: Pieces,
}

impl Series {
    /// Sampled values; NaN and longer intervals are gaps.
    pub fn sampled(label: impl Into<String>, style: Style, time_s: &[f64], values: &[f64]) -> Self {
        let points = time_s.iter().copied().zip(values.iter().copied());
        Self {
            label: label.into(),
            style,
            pieces: pieces(points),
        }
    }

    /// A command, held from each event to the next.
    pub fn held(label: impl Into<String>, style: Style, events: &[(f64, f64)], end_s: f64) -> Self {
        Self {
            label: label.into(),
            style,
            pieces: held(events, end_s),
        }
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.pieces.iter().flatten().copied()
    }
}

/// A shaded range of values over the whole time.
#[derive(Clone, Debug)]
pub struct Band {
    pub label: String,
    pub from: f64,
    pub to: f64,
}

/// One quantity over time.
#[derive(Clone, Debug)]
pub struct Panel {
    title: String,
    unit: String,
    height: f64,
    series: Vec<Series>,
    band: Option<Band>,
    /// Second unit on the right: `(name, factor)`.
    second: Option<(&'static str, f64)>,
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
        }
    }

    #[must_use]
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// A band; left out where its limits are not finite.
    #[must_use]
    pub fn with_band(mut self, band: Band) -> Self {
        self.band = (band.from.is_finite() && band.to.is_finite()).then_some(band);
        self
    }

    /// The same axis in a second unit, on the right: value times `factor`.
    #[must_use]
    pub const fn with_second_unit(mut self, unit: &'static str, factor: f64) -> Self {
        self.second = Some((unit, factor));
        self
    }

    #[must_use]
    pub const fn with_height(mut self, height: f64) -> Self {
        self.height = height;
        self
    }

    pub fn is_empty(&self) -> bool {
        self.series.iter().all(|series| series.pieces.is_empty())
    }

    fn values(&self) -> Option<Domain> {
        let band = self.band.iter().flat_map(|band| [band.from, band.to]);
        Domain::of(
            self.series
                .iter()
                .flat_map(Series::points)
                .map(|point| point.1)
                .chain(band),
        )
    }
}

/// Panels over one time axis; panels without any value are left out.
#[derive(Clone, Debug, Default)]
pub struct PanelPlot {
    panels: Vec<Panel>,
    /// Name and unit of what runs along the panels, where it is not the time.
    axis: Option<(&'static str, &'static str)>,
}

impl PanelPlot {
    #[must_use]
    pub fn with(mut self, panel: Panel) -> Self {
        if !panel.is_empty() {
            self.panels.push(panel);
        }
        self
    }

    /// Something else than the time runs along the panels; the unit may be empty.
    #[must_use]
    pub const fn with_axis(mut self, name: &'static str, unit: &'static str) -> Self {
        self.axis = Some((name, unit));
        self
    }

    pub fn is_empty(&self) -> bool {
        self.panels.is_empty()
    }

    /// The picture; `description` is read out where it cannot be seen.
    pub fn svg(&self, description: &str) -> String {
        let times = self.panels.iter().flat_map(|panel| &panel.series);
        let Some(time) = Domain::of(times.flat_map(Series::points).map(|point| point.0)) else {
            return String::new();
        };
        let x = Scale {
            domain: time,
            from_px: LEFT,
            to_px: WIDTH - RIGHT,
        };
        let height: f64 = self
            .panels
            .iter()
            .map(|panel| HEAD + panel.height + GAP)
            .sum::<f64>()
            + FOOT
            - GAP;
        let (name, unit) = self.axis.unwrap_or(("time", "s"));
        let mut out = format!(
            "<svg class=\"plot panels\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\" data-x=\"{} {} {} {}\" data-x-unit=\"{unit}\">",
            px(WIDTH),
            px(height),
            escape(description),
            time.from,
            time.to,
            px(x.from_px),
            px(x.to_px),
        );
        let time_ticks = ticks(time, 12);
        let mut top = 0.0;
        for panel in &self.panels {
            draw_panel(&mut out, panel, x, &time_ticks, top);
            top += HEAD + panel.height + GAP;
        }
        let base = top - GAP;
        for (label, tick) in labels(&time_ticks).iter().zip(&time_ticks) {
            text(&mut out, "tick middle", x.px(*tick), base + 16.0, label);
        }
        text(
            &mut out,
            "unit middle",
            0.5 * (x.from_px + x.to_px),
            base + 33.0,
            &if unit.is_empty() {
                name.to_owned()
            } else {
                format!("{name}, {unit}")
            },
        );
        out.push_str("</svg>");
        out
    }
}

fn draw_panel(out: &mut String, panel: &Panel, x: Scale, time_ticks: &[f64], top: f64) {
    let Some(values) = panel.values() else { return };
    let (upper, lower) = (top + HEAD, top + HEAD + panel.height);
    let y = Scale {
        domain: values.padded(0.05),
        from_px: lower,
        to_px: upper,
    };
    let _ = write!(
        out,
        "<g class=\"panel\" data-y=\"{:e} {:e} {} {}\" data-unit=\"{}\">",
        y.domain.from,
        y.domain.to,
        px(lower),
        px(upper),
        escape(&panel.unit)
    );
    rectangle(
        out,
        "frame",
        x.from_px,
        upper,
        x.to_px - x.from_px,
        panel.height,
    );
    for tick in time_ticks {
        line(out, "grid", (x.px(*tick), upper), (x.px(*tick), lower));
    }
    let value_ticks = ticks(y.domain, VALUE_TICKS);
    for (label, tick) in labels(&value_ticks).iter().zip(&value_ticks) {
        let class = if tick.abs() > 0.0 {
            "grid"
        } else {
            "grid zero"
        };
        line(out, class, (x.from_px, y.px(*tick)), (x.to_px, y.px(*tick)));
        text(out, "tick end", x.from_px - 7.0, y.px(*tick) + 4.0, label);
    }
    if let Some((_, factor)) = panel.second {
        let second = ticks(y.domain.scaled(factor), VALUE_TICKS);
        for (label, tick) in labels(&second).iter().zip(&second) {
            let at = y.px(tick / factor);
            line(out, "mark", (x.to_px, at), (x.to_px + 4.0, at));
            text(out, "tick", x.to_px + 7.0, at + 4.0, label);
        }
    }
    if let Some(band) = &panel.band {
        let (a, b) = (y.px(band.to), y.px(band.from));
        rectangle(out, "band", x.from_px, a, x.to_px - x.from_px, b - a);
    }
    for series in &panel.series {
        let path = path(series, x, y);
        let _ = write!(
            out,
            "<path class=\"series {}\" data-label=\"{}\" d=\"{path}\"/>",
            series.style.class(),
            escape(&series.label)
        );
    }
    heading(out, panel, x, top);
    out.push_str("</g>");
}

fn path(series: &Series, x: Scale, y: Scale) -> String {
    let mut path = String::new();
    for piece in decimate(&series.pieces, x.domain.from, x.domain.to, COLUMNS) {
        for (index, point) in piece.iter().enumerate() {
            let letter = if index == 0 { 'M' } else { 'L' };
            let _ = write!(path, "{letter}{} {}", px(x.px(point.0)), px(y.px(point.1)));
        }
        if piece.len() == 1 {
            // A lone value between two gaps: a line of no length with round ends is a dot.
            path.push_str("h0");
        }
    }
    path
}

/// Name and unit on the left, legend on the right of the same line.
fn heading(out: &mut String, panel: &Panel, x: Scale, top: f64) {
    const SAMPLE: f64 = 26.0;
    let base = top + HEAD - 8.0;
    let title = format!("{}, {}", panel.title, panel.unit);
    text(out, "title", x.from_px, base, &title);
    let mut right = x.to_px;
    if let Some((unit, _)) = panel.second {
        text(out, "unit", x.to_px + 7.0, base, unit);
    }
    if let Some(band) = &panel.band {
        text(out, "legend end", right, base, &band.label);
        right -= width(&band.label);
        rectangle(out, "band", right - SAMPLE - 5.0, base - 9.0, SAMPLE, 10.0);
        right -= SAMPLE + 18.0;
    }
    for series in panel.series.iter().rev() {
        text(out, "legend end", right, base, &series.label);
        right -= width(&series.label);
        let at = base - 4.0;
        let class = format!("key {}", series.style.class());
        line(out, &class, (right - SAMPLE - 5.0, at), (right - 5.0, at));
        right -= SAMPLE + 18.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(values: &[f64]) -> String {
        let time_s: Vec<f64> = (0..values.len()).map(|k| 0.01 * k as f64).collect();
        let panel = Panel::new("speed", "rad/s")
            .with(Series::sampled(
                "measured <1>",
                Style::Measured,
                &time_s,
                values,
            ))
            .with_second_unit("r/min", 9.549_296_585_513_72);
        PanelPlot::default().with(panel).svg("a \"plot\"")
    }

    #[test]
    fn missing_and_absurd_values_never_reach_the_picture() {
        let values = [
            1.0,
            f64::NAN,
            2.0,
            f64::INFINITY,
            f64::NEG_INFINITY,
            3.0,
            3.0,
            4.0,
        ];
        let svg = plot(&values);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(svg.matches('M').count() > 4, "gaps are drawn as gaps");
        assert_eq!(plot(&[f64::NAN; 5]), "");
    }

    #[test]
    fn labels_are_escaped() {
        let svg = plot(&[1.0, 2.0]);
        assert!(svg.contains("measured &lt;1&gt;") && svg.contains("a &quot;plot&quot;"));
    }

    #[test]
    fn a_long_run_makes_a_bounded_picture() {
        let values: Vec<f64> = (0..200_000)
            .map(|k| f64::from(k % 977) * if k % 2 == 0 { 1.0 } else { -1.0 })
            .collect();
        assert!(plot(&values).len() < 60_000);
    }

    #[test]
    fn a_panel_without_values_is_left_out() {
        let empty = Panel::new("current", "A").with(Series::sampled(
            "measured",
            Style::Measured,
            &[0.0],
            &[f64::NAN],
        ));
        assert!(PanelPlot::default().with(empty).is_empty());
    }
}
