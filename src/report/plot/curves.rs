//! Curves over a logarithmic axis, both ways: how errors grow with a ratio. One legend serves all panels.

use std::fmt::Write;

use super::draw::{line, px, rectangle, text, width};
use crate::report::escape::escape;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 24.0;
const PANEL: f64 = 190.0;
const HEAD: f64 = 26.0;
const FOOT: f64 = 44.0;
const LEGEND_ROW: f64 = 20.0;
/// Length of a curve's sample in the legend, px.
const SAMPLE: f64 = 34.0;
/// Kinds of lines that the style sheet tells apart; more curves begin again.
const KINDS: usize = 10;

/// Curves of one quantity; a curve without values stays in the legend of the others.
#[derive(Clone, Debug)]
pub struct CurvePanel {
    pub title: String,
    /// One curve per label of the chart: `(x, y)`, both positive; what is not finite is a gap.
    pub curves: Vec<Vec<(f64, f64)>>,
}

/// Panels over one logarithmic axis.
#[derive(Clone, Debug)]
pub struct CurveChart {
    pub axis: String,
    /// One to a curve, the same in all panels.
    pub labels: Vec<String>,
    pub panels: Vec<CurvePanel>,
    /// Powers of ten that the value axes show; smaller and larger values are drawn at the edge.
    pub decades: (i32, i32),
}

/// Maps positive values to pixels.
#[derive(Clone, Copy)]
struct LogScale {
    from: f64,
    to: f64,
    from_px: f64,
    to_px: f64,
}

impl LogScale {
    fn px(&self, value: f64) -> f64 {
        let share = (value.log10() - self.from) / (self.to - self.from);
        self.from_px + share.clamp(0.0, 1.0) * (self.to_px - self.from_px)
    }

    /// Powers of ten, and 2 and 5 times them where there are few.
    fn ticks(&self) -> Vec<f64> {
        let factors: &[f64] = if self.to - self.from < 4.0 {
            &[1.0, 2.0, 5.0]
        } else {
            &[1.0]
        };
        (-30..=30)
            .flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)))
            .filter(|tick| {
                let at = tick.log10();
                at >= self.from - 1e-9 && at <= self.to + 1e-9
            })
            .collect()
    }
}

impl CurveChart {
    pub fn svg(&self, description: &str) -> String {
        let all = || {
            self.panels
                .iter()
                .flat_map(|panel| panel.curves.iter().flatten())
        };
        let drawn = || all().filter(|(x, y)| x.is_finite() && *x > 0.0 && y.is_finite());
        let (from, to) = drawn().fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), point| {
            (from.min(point.0.log10()), to.max(point.0.log10()))
        });
        if from >= to {
            return String::new();
        }
        let x = LogScale {
            from,
            to,
            from_px: LEFT,
            to_px: WIDTH - RIGHT,
        };
        let mut body = String::new();
        let mut top = self.legend(&mut body);
        for panel in &self.panels {
            self.panel(&mut body, panel, x, top);
            top += HEAD + PANEL;
        }
        for tick in x.ticks() {
            text(
                &mut body,
                "tick middle",
                x.px(tick),
                top + 16.0,
                &plain(tick),
            );
        }
        let middle = 0.5 * (x.from_px + x.to_px);
        text(&mut body, "unit middle", middle, top + 34.0, &self.axis);
        format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">{body}</svg>",
            px(WIDTH),
            px(top + FOOT),
            escape(description)
        )
    }

    /// Draws the legend in rows and returns the height it takes.
    fn legend(&self, out: &mut String) -> f64 {
        let (mut at, mut base) = (LEFT, LEGEND_ROW - 5.0);
        for (index, label) in self.labels.iter().enumerate() {
            let needed = SAMPLE + 8.0 + width(label) + 20.0;
            if at + needed > WIDTH - RIGHT && at > LEFT {
                (at, base) = (LEFT, base + LEGEND_ROW);
            }
            let class = format!("key {}", class(index));
            line(out, &class, (at, base - 4.0), (at + SAMPLE, base - 4.0));
            mark(out, index, at + 0.5 * SAMPLE, base - 4.0);
            text(out, "legend", at + SAMPLE + 8.0, base, label);
            at += needed;
        }
        base + 8.0
    }

    fn panel(&self, out: &mut String, panel: &CurvePanel, x: LogScale, top: f64) {
        let (upper, lower) = (top + HEAD, top + HEAD + PANEL - 14.0);
        let y = LogScale {
            from: f64::from(self.decades.0),
            to: f64::from(self.decades.1),
            from_px: lower,
            to_px: upper,
        };
        out.push_str("<g class=\"panel\">");
        rectangle(
            out,
            "frame",
            x.from_px,
            upper,
            x.to_px - x.from_px,
            lower - upper,
        );
        for tick in x.ticks() {
            line(out, "grid", (x.px(tick), upper), (x.px(tick), lower));
        }
        for tick in y.ticks() {
            line(out, "grid", (x.from_px, y.px(tick)), (x.to_px, y.px(tick)));
            text(
                out,
                "tick end",
                x.from_px - 7.0,
                y.px(tick) + 4.0,
                &plain(tick),
            );
        }
        text(out, "title", x.from_px, upper - 8.0, &panel.title);
        for (index, curve) in panel.curves.iter().enumerate() {
            let mut path = String::new();
            let mut letter = 'M';
            let mut marks = String::new();
            for (at, value) in curve {
                if !(at.is_finite() && value.is_finite() && *at > 0.0) {
                    letter = 'M';
                    continue;
                }
                let (at, value) = (x.px(*at), y.px(value.max(f64::MIN_POSITIVE)));
                let _ = write!(path, "{letter}{} {}", px(at), px(value));
                mark(&mut marks, index, at, value);
                letter = 'L';
            }
            if !path.is_empty() {
                let _ = write!(
                    out,
                    "<path class=\"series {}\" d=\"{path}\"/>",
                    class(index)
                );
            }
            out.push_str(&marks);
        }
        out.push_str("</g>");
    }
}

fn class(index: usize) -> String {
    format!("k{}", index % KINDS)
}

/// A small shape of its own for each kind: square, diamond, triangle, cross, plus.
fn mark(out: &mut String, index: usize, x: f64, y: f64) {
    let shape = match index % 5 {
        0 => "m-3 -3h6v6h-6z",
        1 => "m0 -4l4 4l-4 4l-4 -4z",
        2 => "m0 -4l4 7h-8z",
        3 => "m-3 -3l6 6m0 -6l-6 6",
        _ => "m-4 0h8m-4 -4v8",
    };
    let filled = if index < 5 { " filled" } else { "" };
    let _ = write!(
        out,
        "<path class=\"dot {}{filled}\" d=\"M{} {}{shape}\"/>",
        class(index),
        px(x),
        px(y)
    );
}

/// A tick without an exponent where it is short.
fn plain(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> String {
        let panel = CurvePanel {
            title: "error, %".into(),
            curves: vec![points],
        };
        CurveChart {
            axis: "T/Ta".into(),
            labels: vec!["a <b>".into()],
            panels: vec![panel],
            decades: (-3, 3),
        }
        .svg("errors")
    }

    #[test]
    fn a_gap_cuts_the_curve_and_nothing_absurd_reaches_the_picture() {
        let svg = chart(vec![
            (0.01, 1.0),
            (0.1, f64::NAN),
            (1.0, 10.0),
            (2.0, f64::INFINITY),
            (3.0, 0.0),
            (-1.0, 5.0),
        ]);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let path = svg.split("class=\"series k0\" d=\"").nth(1).unwrap();
        assert_eq!(path.split('"').next().unwrap().matches('M').count(), 3);
        assert!(svg.contains("a &lt;b&gt;"));
        assert_eq!(chart(vec![(1.0, f64::NAN)]), "");
    }

    #[test]
    fn a_decade_has_the_same_height_everywhere() {
        let svg = chart(vec![(1.0, 0.1), (10.0, 1.0), (100.0, 10.0)]);
        let path = svg.split("class=\"series k0\" d=\"").nth(1).unwrap();
        let heights: Vec<f64> = path
            .split('"')
            .next()
            .unwrap()
            .split(['M', 'L'])
            .filter(|point| !point.is_empty())
            .map(|point| point.split(' ').nth(1).unwrap().parse().unwrap())
            .collect();
        assert!(
            (heights[0] - 2.0 * heights[1] + heights[2]).abs() < 0.3,
            "{heights:?}"
        );
        assert!(heights[0] > heights[1]);
    }
}
