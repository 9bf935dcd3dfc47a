//! What the studies show: the figures, grids and values that the layouts need beside the studies' own JSON.
//!
//! ```text
//! PaperA, PaperB (both: every regulator on the same cases), Study, LineStudy -> Findings --(layouts/*.md)--> FiguresAndTables
//! ```

mod lines;
mod paper_a;
mod paper_b;
mod study;

use drivebench::control::TrialPoint;
use drivebench::report::plot::{Panel, Style};
use drivebench::text::number::fixed;
use serde_json::{Value, json};

use crate::loops::{Case, Comparison};
use crate::page::{Figure, with};

/// Every regulator on the same cases, case by case.
const COMPARISON: &str = include_str!("../layouts/comparison.md");

fn compared(found: &Comparison) -> Value {
    let of_case = |case| found.rows.iter().filter(move |row| row.case == case);
    let rows = Case::ALL.into_iter().flat_map(of_case).map(|row| {
        let [settling, recovery] = [row.settling_s, row.recovery_s].map(|time_s| match time_s {
            None => "-".to_owned(),
            Some(None) => "never".to_owned(),
            Some(Some(time_s)) => fixed(time_s, 3),
        });
        with(row, json!({"settling": settling, "recovery": recovery}))
    });
    let [low, high] = found.levels_rad_s;
    json!({
        "comparison": found,
        "compared": rows.collect::<Vec<_>>(),
        "load_speed_rad_s": 0.5 * (low + high),
    })
}

/// What a trace has at each of its instants.
type Quantity = fn(&TrialPoint) -> f64;
const TIME: Quantity = |point| point.time_s;
const REFERENCE: Quantity = |point| point.reference_rad_s;
const SPEED: Quantity = |point| point.speed_rad_s;
const OUTPUT: Quantity = |point| point.output_v;

fn of(trace: &[TrialPoint], quantity: Quantity) -> Vec<f64> {
    trace.iter().map(quantity).collect()
}

fn speed_panel(name: impl Into<String>, height: f64) -> Panel {
    Panel::new(name, "rad/s").with_height(height)
}

/// A panel for each trial, all over the same instants, with the same lines in it.
fn trials<'a>(
    trials: impl IntoIterator<Item = (&'a str, &'a [TrialPoint])>,
    height: f64,
    lines: &[(&str, Style, Quantity)],
) -> Figure {
    let mut trials = trials.into_iter().peekable();
    let first = trials.peek().map_or(&[][..], |(_, trace)| trace);
    let mut figure = Figure::over_time(of(first, TIME));
    for (name, trace) in trials {
        figure = figure.panel(speed_panel(format!("{name}: speed"), height));
        for (label, style, quantity) in lines {
            figure = figure.line(label, *style, &of(trace, *quantity));
        }
    }
    figure
}
