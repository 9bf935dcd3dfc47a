//! The pictures of the studies that no command draws: curves over a ratio on logarithmic axes, and the reliability diagram of
//! probabilities (`DeGroot` and Fienberg 1983).

use drivebench::report::plot::axis::{Domain, plain, powers};
use drivebench::report::plot::chart::{
    Along, FOOT, HEAD, LEFT, RIGHT, Scale, Svg, WIDTH, polyline, width,
};

/// How errors grow with a ratio: curves over a logarithmic axis, both ways. One legend serves all panels.
#[derive(Clone, Debug)]
pub(crate) struct CurveChart {
    pub(crate) axis: String,
    /// One to a curve, the same in all panels.
    pub(crate) labels: Vec<String>,
    pub(crate) panels: Vec<CurvePanel>,
    /// Powers of ten that the value axes show; smaller and larger values are drawn at the edge.
    pub(crate) decades: (i32, i32),
}

/// Curves of one quantity; a curve without values stays in the legend of the others.
#[derive(Clone, Debug)]
pub(crate) struct CurvePanel {
    pub(crate) title: String,
    /// One curve per label of the chart: `(x, y)`, both positive; what is not finite is a gap.
    pub(crate) curves: Vec<Vec<(f64, f64)>>,
}

impl CurveChart {
    pub(crate) fn svg(&self, description: &str) -> String {
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
        for tick in powers(x.domain) {
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
        svg.grid_across(x, &powers(x.domain), upper, lower);
        let at = powers(y.domain);
        svg.axis_upwards(x, &y, &at, &at.iter().map(|tick| plain(*tick)).collect::<Vec<_>>());
        svg.text("title", x.from_px, upper - 8.0, &panel.title);
        for (index, curve) in panel.curves.iter().enumerate() {
            let is_drawn =
                |(at, value): &(f64, f64)| at.is_finite() && value.is_finite() && *at > 0.0;
            let place = |(at, value): &(f64, f64)| (x.px(*at), y.px(value.max(f64::MIN_POSITIVE)));
            let pieces = curve.split(|point| !is_drawn(point));
            let path: String = pieces.map(|piece| polyline(piece.iter().map(place))).collect();
            if !path.is_empty() {
                svg.path(&format!("series {}", class(index)), &path);
            }
            let points = curve.iter().filter(|point| is_drawn(point));
            points.for_each(|point| mark(svg, index, place(point)));
        }
        svg.write(format_args!("</g>"));
    }
}

/// Class of one of the ten kinds of lines in the style sheet; more curves begin again.
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

/// Claims of about one probability, and the share of them that came true with its bounds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claims {
    pub(crate) given: f64,
    pub(crate) share: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) count: usize,
}

/// Given probabilities against how often they came true, both in log odds: what is nearly certain gets as much room as a
/// toss-up. Empty where nothing was claimed.
pub(crate) fn reliability(description: &str, title: &str, axis: &str, claims: &[Claims]) -> String {
    // What lies beyond the first and the last is drawn there.
    const TICKS: [f64; 9] = [0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999];
    const BASE: f64 = HEAD + 380.0;
    if claims.is_empty() {
        return String::new();
    }
    let odds = |share: f64| {
        (share.clamp(TICKS[0], TICKS[8]) / (1.0 - share.clamp(TICKS[0], TICKS[8]))).ln()
    };
    let x = Scale::across(Along::Linear, Domain { from: odds(TICKS[0]), to: odds(TICKS[8]) });
    let y = Scale::new(Along::Linear, x.domain, BASE, HEAD);
    let (across, up) = (|share: f64| x.px(odds(share)), |share: f64| y.px(odds(share)));
    let mut svg = Svg::default();
    svg.text("title", LEFT, HEAD - 9.0, title);
    for tick in TICKS {
        let label = tick.to_string();
        svg.line("grid", (across(tick), HEAD), (across(tick), BASE));
        svg.line("grid", (x.from_px, up(tick)), (x.to_px, up(tick)));
        svg.text("tick middle", across(tick), BASE + 16.0, &label);
        svg.text("tick end", LEFT - 7.0, up(tick) + 4.0, &label);
    }
    svg.frame(&x, HEAD, BASE);
    svg.line("goal", (x.from_px, BASE), (x.to_px, HEAD));
    for found in claims {
        let (at, share) = (across(found.given), up(found.share));
        let ends = [up(found.low), up(found.high)];
        svg.line("key after", (at, ends[0]), (at, ends[1]));
        for end in ends {
            svg.line("key after", (at - 5.0, end), (at + 5.0, end));
        }
        svg.dot("after", (at, share), 4);
        // Beside the diagonal, not on it, where the frame leaves room.
        let place = (at - x.from_px) / (x.to_px - x.from_px);
        let is_left = place > 0.9 || (place > 0.1 && found.share > found.given);
        let (class, beside) = if is_left { ("value end", at - 9.0) } else { ("value", at + 9.0) };
        let level = share.clamp(HEAD + 14.0, BASE - 6.0);
        svg.text(class, beside, level, &format!("of {}", found.count));
    }
    svg.unit_across(&x, BASE + 34.0, axis);
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
        let svg = curve(vec![(0.01, 1.0), gap, (1.0, 10.0), end, (3.0, 0.0), (-1.0, 5.0)]);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let path = between(&svg, "class=\"series k0\" d=\"", '"').next().unwrap();
        assert_eq!(path.matches('M').count(), 3);
        assert!(svg.contains("a &lt;b&gt;"));
        assert_eq!(curve(vec![(1.0, f64::NAN)]), "");
    }

    #[test]
    fn a_decade_has_the_same_height_everywhere() {
        let svg = curve(vec![(1.0, 0.1), (10.0, 1.0), (100.0, 10.0)]);
        let path = between(&svg, "class=\"series k0\" d=\"", '"').next().unwrap();
        let points = path.split(['M', 'L']).filter(|point| !point.is_empty());
        let heights: Vec<f64> =
            points.map(|point| point.split(' ').nth(1).unwrap().parse().unwrap()).collect();
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
