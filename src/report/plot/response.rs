//! Panels over one logarithmic axis of frequency: curves with the band of their intervals, what is not carried as faint dots,
//! and the modes as lines across.

use super::axis::{Domain, labels, ticks};
use super::chart::{Along, FOOT, HEAD, LEFT, Scale, Svg, polyline, width};
use super::charts::{plain, powers};
use super::panels::Style;

/// Height of a panel and room between two, px.
const PANEL: f64 = 150.0;
const GAP: f64 = 12.0;

/// Panels one under the other.
#[derive(Clone, Debug)]
pub struct ResponseChart {
    pub axis: String,
    pub panels: Vec<ResponsePanel>,
    /// Name and frequency.
    pub modes: Vec<(String, f64)>,
}

/// One quantity over frequency.
#[derive(Clone, Debug)]
pub struct ResponsePanel {
    pub title: String,
    pub curves: Vec<ResponseCurve>,
    /// What the axis shows at least.
    pub shows: Option<(f64, f64)>,
}

#[derive(Clone, Debug)]
pub struct ResponseCurve {
    pub label: String,
    pub style: Style,
    pub points: Vec<ResponsePlace>,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug)]
pub struct ResponsePlace {
    pub frequency_hz: f64,
    pub value: f64,
    pub low: f64,
    pub high: f64,
    /// Else it is a faint dot, and the curve has a gap.
    pub is_carried: bool,
}

impl ResponsePlace {
    fn is_known(&self) -> bool {
        let all = [self.frequency_hz, self.value, self.low, self.high];
        all.into_iter().all(f64::is_finite) && self.frequency_hz > 0.0
    }
}

impl ResponseChart {
    /// Empty where nothing is carried.
    pub fn svg(&self, description: &str) -> String {
        let curves = self.panels.iter().flat_map(|panel| &panel.curves);
        let points = curves.flat_map(|curve| &curve.points);
        let known = points.filter(|point| point.is_known());
        let Some(across) = Domain::of(known.map(|point| point.frequency_hz.log10())) else {
            return String::new();
        };
        let x = Scale::across(Along::Log, across);
        let (mut svg, mut top) = (Svg::default(), 0.0);
        for panel in &self.panels {
            // Named once, in the first panel.
            if self.panel(&mut svg, panel, &x, top + HEAD, top <= 0.0) {
                top += HEAD + PANEL + GAP;
            }
        }
        if top <= 0.0 {
            return String::new();
        }
        let base = top - GAP;
        for tick in powers(&x) {
            svg.text("tick middle", x.px(tick), base + 16.0, &plain(tick));
        }
        svg.unit_across(&x, base + 34.0, &self.axis);
        svg.close("plot", base + FOOT, description, "")
    }

    /// Whether there was anything to draw.
    fn panel(
        &self,
        svg: &mut Svg,
        panel: &ResponsePanel,
        x: &Scale,
        upper: f64,
        names: bool,
    ) -> bool {
        let carried = panel.curves.iter().flat_map(|curve| &curve.points);
        let carried = carried.filter(|point| point.is_known() && point.is_carried);
        let edges = carried.flat_map(|point| [point.low, point.high]);
        let least = panel.shows.into_iter().flat_map(|(low, high)| [low, high]);
        let Some(values) = Domain::of(edges.chain(least)) else {
            return false;
        };
        let lower = upper + PANEL;
        let y = Scale::new(Along::Linear, values.padded(0.05), lower, upper);
        svg.write(format_args!("<g class=\"panel\">"));
        svg.frame(x, upper, lower);
        svg.grid_across(x, &powers(x), upper, lower);
        let at = ticks(y.domain, 6);
        svg.axis_upwards(x, &y, &at, &labels(&at));
        svg.text("title", LEFT, upper - 8.0, &panel.title);
        let mut right = x.to_px;
        for curve in panel.curves.iter().rev() {
            right = svg.legend_entry(right, upper - 8.0, curve.style.class(), &curve.label);
        }
        svg.open_clipped("lines", x, upper, lower);
        for curve in &panel.curves {
            curve.draw(svg, x, &y);
        }
        for (row, (name, frequency_hz)) in self.modes.iter().enumerate() {
            let at = x.px(*frequency_hz);
            svg.line("divider", (at, upper), (at, lower));
            if !names {
                continue;
            }
            // Beside the line, on the side where there is room, each in a row of its own.
            let left = if at + width(name) + 8.0 < x.to_px {
                at + 4.0
            } else {
                at - width(name) - 4.0
            };
            svg.text("tick", left, upper + 13.0 + 14.0 * row as f64, name);
        }
        svg.write(format_args!("</svg></g>"));
        true
    }
}

impl ResponseCurve {
    fn draw(&self, svg: &mut Svg, x: &Scale, y: &Scale) {
        let known: Vec<&ResponsePlace> = self.points.iter().filter(|own| own.is_known()).collect();
        let class = self.style.class();
        let place = |own: &ResponsePlace, value: f64| (x.px(own.frequency_hz), y.px(value));
        for piece in known.chunk_by(|a, b| a.is_carried == b.is_carried) {
            if !piece[0].is_carried {
                for own in piece {
                    svg.dot("faint", place(own, own.value), 1);
                }
                continue;
            }
            let above = piece.iter().map(|own| place(own, own.high));
            let below = piece.iter().rev().map(|own| place(own, own.low));
            svg.path("spread", &(polyline(above.chain(below)) + "Z"));
            let line = polyline(piece.iter().map(|own| place(own, own.value)));
            // A point between two gaps: no length and round ends make a dot.
            svg.path(&format!("series {class}"), &(line + "h0"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(is_carried: fn(usize) -> bool) -> ResponseChart {
        let points = (0..30).map(|k| ResponsePlace {
            frequency_hz: 0.5 * 1.2_f64.powi(k),
            value: f64::from(k),
            low: f64::from(k) - 1.0,
            high: if k == 3 { f64::NAN } else { f64::from(k) + 1.0 },
            is_carried: is_carried(usize::try_from(k).unwrap()),
        });
        let curve = ResponseCurve {
            label: "measured <1>".to_owned(),
            style: Style::Measured,
            points: points.collect(),
        };
        let panel = ResponsePanel {
            title: "magnitude, dB".to_owned(),
            curves: vec![curve],
            shows: None,
        };
        ResponseChart {
            axis: "frequency, Hz".to_owned(),
            panels: vec![panel],
            modes: vec![("resonance".to_owned(), 5.0)],
        }
    }

    #[test]
    fn what_is_not_carried_is_a_gap_of_faint_dots_and_nothing_absurd_is_drawn() {
        let svg = chart(|k| !(10..20).contains(&k)).svg("response");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("class=\"knot faint\"").count(), 10);
        assert_eq!(svg.matches("class=\"spread\"").count(), 2);
        assert!(svg.contains("measured &lt;1&gt;") && svg.contains(">resonance</text>"));
        assert_eq!(chart(|_| false).svg("response"), "");
    }
}
