//! Horizontal bars with a goal line: the ladder of models and the noise floor.

use super::axis::{Domain, Scale, labels, ticks};
use super::draw::{line, px, rectangle, text, width};
use crate::report::escape::escape;
use crate::text::number::significant;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 16.0;
const RIGHT: f64 = 76.0;
const ROW: f64 = 46.0;
const HEAD: f64 = 26.0;
const FOOT: f64 = 42.0;

/// One bar; a value that is not finite has none and says so.
#[derive(Clone, Debug)]
pub struct Bar {
    pub label: String,
    pub value: f64,
}

/// Bars from zero, and a goal that they ought to reach.
#[derive(Clone, Debug)]
pub struct BarChart {
    pub axis: String,
    pub bars: Vec<Bar>,
    /// `(label, value)` of the goal line.
    pub goal: Option<(String, f64)>,
}

impl BarChart {
    pub fn svg(&self, description: &str) -> String {
        let goal = self.goal.as_ref().filter(|goal| goal.1.is_finite());
        let shown = self.bars.iter().map(|bar| bar.value.max(0.0));
        let Some(values) = Domain::of(shown.chain(goal.map(|goal| goal.1)).chain([0.0])) else {
            return String::new();
        };
        let height = HEAD + ROW * self.bars.len() as f64 + FOOT;
        let base = height - FOOT;
        let x = Scale {
            domain: Domain {
                from: 0.0,
                to: values.to,
            },
            from_px: LEFT,
            to_px: WIDTH - RIGHT,
        };
        let mut out = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
            px(WIDTH),
            px(height),
            escape(description)
        );
        let at = ticks(x.domain, 10);
        for (label, tick) in labels(&at).iter().zip(&at) {
            line(&mut out, "grid", (x.px(*tick), HEAD), (x.px(*tick), base));
            text(&mut out, "tick middle", x.px(*tick), base + 16.0, label);
        }
        text(
            &mut out,
            "unit middle",
            0.5 * (x.from_px + x.to_px),
            base + 34.0,
            &self.axis,
        );
        for (row, bar) in self.bars.iter().enumerate() {
            let top = HEAD + ROW * row as f64;
            text(&mut out, "legend", x.from_px + 2.0, top + 15.0, &bar.label);
            let class = if row + 1 == self.bars.len() {
                "bar last"
            } else {
                "bar"
            };
            let end = if bar.value.is_finite() {
                x.px(bar.value.clamp(0.0, x.domain.to))
            } else {
                x.from_px
            };
            rectangle(
                &mut out,
                class,
                x.from_px,
                top + 21.0,
                end - x.from_px,
                17.0,
            );
            text(
                &mut out,
                "value",
                end + 6.0,
                top + 34.0,
                &significant(bar.value, 3),
            );
        }
        if let Some((label, value)) = goal {
            let at = x.px(*value);
            line(&mut out, "goal", (at, HEAD - 6.0), (at, base));
            // Beside the line, on the side where there is room.
            let left = (at - 4.0).min(x.to_px + RIGHT - width(label)).max(LEFT);
            text(&mut out, "goal-label", left, HEAD - 11.0, label);
        }
        out.push_str("</svg>");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_ends_at_its_value_and_a_missing_one_has_no_length() {
        let bar = |label: &str, value| Bar {
            label: label.to_owned(),
            value,
        };
        let chart = BarChart {
            axis: "error".into(),
            bars: vec![bar("a", 4.0), bar("b", 2.0), bar("c", f64::NAN)],
            goal: Some(("floor".into(), 1.0)),
        };
        let svg = chart.svg("ladder");
        let lengths: Vec<f64> = svg
            .split("<rect ")
            .skip(1)
            .map(|rect| {
                rect.split("width=\"")
                    .nth(1)
                    .unwrap()
                    .split('"')
                    .next()
                    .unwrap()
                    .parse()
                    .unwrap()
            })
            .collect();
        assert!(
            (lengths[0] / lengths[1] - 2.0).abs() < 0.01 && lengths[2].abs() < 1e-9,
            "{lengths:?}"
        );
        assert!(!svg.contains("NaN") && svg.contains(">n/a<"));
    }
}
