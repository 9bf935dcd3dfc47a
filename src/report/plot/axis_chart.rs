//! A curve with its uncertainty along one axis: what an equation lacks over speed, current, angle or time.

use std::fmt::Write;

use super::axis::{Domain, Scale, labels, ticks};
use super::draw::{line, px, rectangle, text};
use crate::report::escape::escape;
use crate::sample::TWO_SIDED_95;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 24.0;
const HEAD: f64 = 26.0;
const PANEL: f64 = 210.0;
const FOOT: f64 = 44.0;

/// A curve over one axis; values that are not finite are left out.
#[derive(Clone, Debug)]
pub struct AxisChart<'a> {
    pub title: String,
    pub axis: &'a str,
    /// Rising.
    pub knots: &'a [f64],
    pub values: &'a [f64],
    /// Standard deviation of each value; may be shorter.
    pub std: &'a [f64],
}

impl AxisChart<'_> {
    /// Empty where there are not two points.
    pub fn svg(&self, description: &str) -> String {
        let points: Vec<(f64, f64, f64)> = self
            .knots
            .iter()
            .zip(self.values)
            .enumerate()
            .filter(|(_, (knot, value))| knot.is_finite() && value.is_finite())
            .map(|(place, (knot, value))| {
                let std = self.std.get(place).copied().filter(|std| std.is_finite());
                (*knot, *value, TWO_SIDED_95 * std.unwrap_or(0.0))
            })
            .collect();
        let across = Domain::of(points.iter().map(|point| point.0));
        let upwards = Domain::of(
            points
                .iter()
                .flat_map(|(_, value, half)| [value - half, value + half])
                .chain([0.0]),
        );
        let (Some(across), Some(upwards), true) = (across, upwards, points.len() > 1) else {
            return String::new();
        };
        let base = HEAD + PANEL;
        let x = Scale {
            domain: across,
            from_px: LEFT,
            to_px: WIDTH - RIGHT,
        };
        let y = Scale {
            domain: upwards.padded(0.05),
            from_px: base,
            to_px: HEAD,
        };
        let mut out = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
            px(WIDTH),
            px(base + FOOT),
            escape(description)
        );
        text(&mut out, "title", LEFT, HEAD - 9.0, &self.title);
        let at = ticks(y.domain, 6);
        for (label, tick) in labels(&at).iter().zip(&at) {
            let class = if *tick == 0.0 { "grid zero" } else { "grid" };
            line(
                &mut out,
                class,
                (x.from_px, y.px(*tick)),
                (x.to_px, y.px(*tick)),
            );
            text(&mut out, "tick end", LEFT - 7.0, y.px(*tick) + 4.0, label);
        }
        let at = ticks(x.domain, 10);
        for (label, tick) in labels(&at).iter().zip(&at) {
            line(&mut out, "grid", (x.px(*tick), HEAD), (x.px(*tick), base));
            text(&mut out, "tick middle", x.px(*tick), base + 16.0, label);
        }
        rectangle(&mut out, "frame", LEFT, HEAD, x.to_px - LEFT, PANEL);
        let mut band = String::new();
        let corners = points
            .iter()
            .map(|(knot, value, half)| (*knot, value + half))
            .chain(
                points
                    .iter()
                    .rev()
                    .map(|(knot, value, half)| (*knot, value - half)),
            );
        for (letter, (knot, value)) in std::iter::once('M')
            .chain(std::iter::repeat('L'))
            .zip(corners)
        {
            let _ = write!(band, "{letter}{} {}", px(x.px(knot)), px(y.px(value)));
        }
        let _ = write!(out, "<path class=\"spread\" d=\"{band}Z\"/>");
        let mut path = String::new();
        let mut dots = String::new();
        for (letter, (knot, value, _)) in std::iter::once('M')
            .chain(std::iter::repeat('L'))
            .zip(&points)
        {
            let (at, level) = (px(x.px(*knot)), px(y.px(*value)));
            let _ = write!(path, "{letter}{at} {level}");
            let _ = write!(
                dots,
                "<circle class=\"knot\" cx=\"{at}\" cy=\"{level}\" r=\"3\"/>"
            );
        }
        let _ = write!(out, "<path class=\"series after\" d=\"{path}\"/>{dots}");
        text(
            &mut out,
            "unit middle",
            0.5 * (x.from_px + x.to_px),
            base + 34.0,
            self.axis,
        );
        out.push_str("</svg>");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(values: &[f64], std: &[f64]) -> String {
        AxisChart {
            title: "what <it> lacks".into(),
            axis: "speed, rad/s",
            knots: &[-100.0, 0.0, 100.0],
            values,
            std,
        }
        .svg("curve")
    }

    #[test]
    fn knots_stand_at_their_place_and_a_missing_one_is_left_out() {
        let svg = chart(&[0.1, 0.0, -0.1], &[0.01, 0.01, 0.01]);
        assert_eq!(svg.matches("class=\"knot\"").count(), 3);
        assert!(
            svg.contains("cx=\"66\"") && svg.contains("cx=\"876\""),
            "{svg}"
        );
        assert!(svg.contains("what &lt;it&gt; lacks"));
        let svg = chart(&[0.1, f64::NAN, -0.1], &[f64::NAN]);
        assert_eq!(svg.matches("class=\"knot\"").count(), 2);
        assert!(!svg.contains("NaN"));
        assert_eq!(chart(&[f64::NAN, 0.1, f64::INFINITY], &[]), "");
    }
}
