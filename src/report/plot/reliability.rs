//! Given probabilities against how often they came true, both in log odds: what is nearly certain gets as much room as a
//! toss-up.

use std::fmt::Write;

use super::draw::{line, px, rectangle, text};
use crate::report::escape::escape;

const WIDTH: f64 = 900.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 24.0;
const HEAD: f64 = 26.0;
const PANEL: f64 = 380.0;
const FOOT: f64 = 44.0;
/// Half the length of a bar's end, px.
const END: f64 = 5.0;
/// The probabilities at the edges; what lies beyond is drawn there.
const EDGES: (f64, f64) = (0.001, 0.999);
const TICKS: [f64; 9] = [0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999];

/// Claims of about one probability, and the share of them that came true with its bounds.
#[derive(Clone, Copy, Debug)]
pub struct Claims {
    pub given: f64,
    pub share: f64,
    pub low: f64,
    pub high: f64,
    pub count: usize,
}

/// How far given probabilities can be believed.
#[derive(Clone, Debug)]
pub struct ReliabilityChart {
    pub title: String,
    pub across: String,
    pub claims: Vec<Claims>,
}

/// Place of a probability between the edges, 0 to 1.
fn place(probability: f64) -> f64 {
    let log_odds = |p: f64| (p / (1.0 - p)).ln();
    let (low, high) = (log_odds(EDGES.0), log_odds(EDGES.1));
    (log_odds(probability.clamp(EDGES.0, EDGES.1)) - low) / (high - low)
}

impl ReliabilityChart {
    /// Empty where nothing was claimed.
    pub fn svg(&self, description: &str) -> String {
        if self.claims.is_empty() {
            return String::new();
        }
        let base = HEAD + PANEL;
        let x = |p: f64| LEFT + place(p) * (WIDTH - RIGHT - LEFT);
        let y = |p: f64| base - place(p) * PANEL;
        let mut out = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
            px(WIDTH),
            px(base + FOOT),
            escape(description)
        );
        text(&mut out, "title", LEFT, HEAD - 9.0, &self.title);
        for tick in TICKS {
            let label = format!("{tick}");
            line(&mut out, "grid", (x(tick), HEAD), (x(tick), base));
            line(&mut out, "grid", (LEFT, y(tick)), (WIDTH - RIGHT, y(tick)));
            text(&mut out, "tick middle", x(tick), base + 16.0, &label);
            text(&mut out, "tick end", LEFT - 7.0, y(tick) + 4.0, &label);
        }
        rectangle(&mut out, "frame", LEFT, HEAD, WIDTH - RIGHT - LEFT, PANEL);
        let (from, to) = (x(EDGES.0), x(EDGES.1));
        line(&mut out, "goal", (from, y(EDGES.0)), (to, y(EDGES.1)));
        for claims in &self.claims {
            let at = x(claims.given);
            let (low, high) = (y(claims.low), y(claims.high));
            line(&mut out, "key after", (at, low), (at, high));
            for end in [low, high] {
                line(&mut out, "key after", (at - END, end), (at + END, end));
            }
            let share = y(claims.share);
            let _ = write!(
                out,
                "<circle class=\"knot\" cx=\"{}\" cy=\"{}\" r=\"4\"/>",
                px(at),
                px(share)
            );
            // Beside the diagonal, not on it, where the frame leaves room.
            let across = place(claims.given);
            let is_left = across > 0.9 || (across > 0.1 && claims.share > claims.given);
            let (class, beside) = if is_left {
                ("value end", at - 9.0)
            } else {
                ("value", at + 9.0)
            };
            let label = format!("of {}", claims.count);
            let level = share.clamp(HEAD + 14.0, base - 6.0);
            text(&mut out, class, beside, level, &label);
        }
        let middle = 0.5 * (LEFT + WIDTH - RIGHT);
        text(&mut out, "unit middle", middle, base + 34.0, &self.across);
        out.push_str("</svg>");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claims(given: f64, share: f64) -> Claims {
        Claims {
            given,
            share,
            low: 0.5 * share,
            high: 0.5 + 0.5 * share,
            count: 12,
        }
    }

    #[test]
    fn claims_that_came_true_as_given_lie_on_the_diagonal_and_extremes_in_the_frame() {
        let chart = ReliabilityChart {
            title: "true <of>".into(),
            across: "given".into(),
            claims: vec![claims(0.5, 0.5), claims(0.0, 0.0), claims(1.0, 1.0)],
        };
        let svg = chart.svg("reliability");
        let middle = format!(
            "cx=\"{}\" cy=\"{}\"",
            px(0.5 * (LEFT + WIDTH - RIGHT)),
            px(HEAD + 0.5 * PANEL)
        );
        assert!(svg.contains(&middle), "{svg}");
        assert!(svg.contains("cx=\"66\" cy=\"406\"") && svg.contains("cx=\"876\" cy=\"26\""));
        assert!(svg.contains("true &lt;of&gt;") && !svg.contains("NaN"));
        let none = ReliabilityChart {
            claims: vec![],
            ..chart
        };
        assert_eq!(none.svg("reliability"), "");
    }
}
