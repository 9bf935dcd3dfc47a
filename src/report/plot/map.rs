//! A grid of cells: the darker, the larger; the value stands in each, so that grey paper says the same.

use std::fmt::Write;

use super::axis::{Domain, Scale, labels, ticks};
use super::draw::{px, rectangle, text};
use crate::report::escape::escape;
use crate::text::number::significant;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 16.0;
const HEAD: f64 = 24.0;
const FOOT: f64 = 42.0;
const ROW: f64 = 26.0;

/// Values over two variables; `None` where nothing is known.
#[derive(Clone, Debug)]
pub struct MapChart<'a> {
    pub title: String,
    /// Name and unit of the variable along the picture, and its edges.
    pub across: (&'static str, &'a [f64]),
    /// The same for the variable upwards.
    pub upwards: (&'static str, &'a [f64]),
    /// A row for each interval upwards, from the lowest.
    pub values: &'a [Vec<Option<f64>>],
    /// Shown when a cell is pointed at.
    pub counts: &'a [Vec<usize>],
}

impl MapChart<'_> {
    /// Empty where there is no cell with a value.
    pub fn svg(&self, description: &str) -> String {
        let known = || self.values.iter().flatten().flatten().copied();
        let largest = known().fold(0.0, f64::max);
        let (Some(x), Some(y)) = (domain(self.across.1), domain(self.upwards.1)) else {
            return String::new();
        };
        if largest <= 0.0 {
            return String::new();
        }
        let height = HEAD + ROW * self.values.len() as f64 + FOOT;
        let x = Scale {
            domain: x,
            from_px: LEFT,
            to_px: WIDTH - RIGHT,
        };
        let y = Scale {
            domain: y,
            from_px: height - FOOT,
            to_px: HEAD,
        };
        let mut out = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
            px(WIDTH),
            px(height),
            escape(description)
        );
        text(&mut out, "title", LEFT, HEAD - 9.0, &self.title);
        for (row, values) in self.values.iter().enumerate() {
            let (bottom, top) = (y.px(self.upwards.1[row]), y.px(self.upwards.1[row + 1]));
            for (column, value) in values.iter().enumerate() {
                let (from, to) = (x.px(self.across.1[column]), x.px(self.across.1[column + 1]));
                let Some(value) = value else { continue };
                let count = self.counts[row][column];
                let _ = write!(
                    out,
                    "<g><title>{} in {count} windows</title><rect class=\"cell\" fill-opacity=\"{:.2}\" x=\"{}\" y=\"{}\" \
                     width=\"{}\" height=\"{}\"/>",
                    significant(*value, 3),
                    0.05 + 0.6 * value / largest,
                    px(from),
                    px(top),
                    px(to - from),
                    px(bottom - top)
                );
                let middle = 0.5 * (from + to);
                text(
                    &mut out,
                    "tick middle",
                    middle,
                    0.5 * (top + bottom) + 4.0,
                    &significant(*value, 2),
                );
                out.push_str("</g>");
            }
        }
        rectangle(
            &mut out,
            "frame",
            x.from_px,
            y.to_px,
            x.to_px - x.from_px,
            y.from_px - y.to_px,
        );
        let at = ticks(x.domain, 10);
        for (label, tick) in labels(&at).iter().zip(&at) {
            text(
                &mut out,
                "tick middle",
                x.px(*tick),
                y.from_px + 16.0,
                label,
            );
        }
        let at = ticks(y.domain, 8);
        for (label, tick) in labels(&at).iter().zip(&at) {
            text(&mut out, "tick end", LEFT - 6.0, y.px(*tick) + 4.0, label);
        }
        text(
            &mut out,
            "unit middle",
            0.5 * (x.from_px + x.to_px),
            y.from_px + 34.0,
            self.across.0,
        );
        text(
            &mut out,
            "unit end",
            WIDTH - RIGHT,
            HEAD - 9.0,
            self.upwards.0,
        );
        out.push_str("</svg>");
        out
    }
}

fn domain(edges: &[f64]) -> Option<Domain> {
    Domain::of(edges.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

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
            svg.contains("fill-opacity=\"0.65\" x=\"66\" y=\"24\""),
            "{svg}"
        );
        assert!(svg.contains("in 5 windows"));
        assert_eq!(chart(&[vec![None, None], vec![None, None]]), "");
    }
}
