//! The reproduction as pictures, tables and sentences.
//!
//! ```text
//! PaperA -> paper_a, PaperB -> paper_b (both: comparison, every regulator on the same cases) --\
//! Study -> study (with mysteries and calibration)            LineStudy -> section ----------------+-> Section -> Reproduction
//! ```

mod paper_a;
mod paper_b;
mod study;

use super::loops::{Case, Comparison};
use crate::control::TrialPoint;
use crate::report::plot::{Panel, Style};
use crate::report::reproduce::{Figure, Section};
use crate::text::number::{fixed, significant};

/// What the paper leaves open, and what was chosen.
fn choices(chosen: &[String]) -> Section {
    Section {
        paragraphs: chosen.to_vec(),
        ..Section::new("What the paper leaves open, and what was chosen")
    }
}

/// Every regulator on the same cases, as one table.
fn comparison(found: &Comparison) -> Section {
    let [low, high] = found.levels_rad_s;
    let rows = Case::ALL
        .into_iter()
        .flat_map(|case| found.rows.iter().filter(move |row| row.case == case));
    Section::new("Every regulator on the same cases")
        .say(format!(
            "Bench: {}; T = {:.0} ms, {:.0} cycles of delay, sensors with noise. Steps: {low:.0} to {high:.0} rad/s and back, each held {} s; where the inertia jumps, the regulators are told nothing and the steps from the second one after the jump count. Start and brake: standstill to {:.0} rad/s and back, in the current limit. Load: {} N.m at {:.0} rad/s.",
            found.bench,
            1e3 * found.period_s,
            found.delay_cycles,
            found.half_period_s,
            found.start_rad_s,
            found.load_n_m,
            0.5 * (low + high)
        ))
        .say("Overshoot and settling (5 % of the step), both from the speed at the instant of the step: the worst of the steps that count. IAE: integral of the absolute error, mean of those steps; under load over both changes together. Dip and recovery (to 0.5 % of the speed): the worse of load on and load off. Effort: root mean square of the output's change from cycle to cycle.")
        .table(
            "controllers",
            format!(
                "`pi` is fixed, tuned for the inertia that the model has. `paper-b` has the back-EMF of the reference fed forward, which the paper does not have, W = {}, mu = {} and {} of K3; its design knows no delay, so behind one it must be a slow one.",
                found.paper_b.voltage_cost, found.paper_b.filter_share, found.paper_b.compensation
            ),
            rows,
            &[
                ("case", &|row| row.case.name().to_owned()),
                ("controller", &|row| row.controller.name().to_owned()),
                ("overshoot, %", &|row| or_dash(row.overshoot_percent, |v| fixed(v, 1))),
                ("settling, s", &|row| or_dash(row.settling_s, seconds)),
                ("IAE, rad", &|row| significant(row.absolute_error_rad, 3)),
                ("dip, rad/s", &|row| or_dash(row.dip_rad_s, |v| fixed(v, 2))),
                ("recovery, s", &|row| or_dash(row.recovery_s, seconds)),
                ("effort, V", &|row| significant(row.effort_v, 3)),
            ],
        )
}

/// What is not there is a dash.
fn or_dash<T>(value: Option<T>, show: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), show)
}

/// A number that may not be there.
fn number(value: Option<f64>, digits: usize) -> String {
    or_dash(value, |value| significant(value, digits))
}

/// A time that may never come.
fn seconds(time_s: Option<f64>) -> String {
    time_s.map_or_else(|| "never".to_owned(), |s| fixed(s, 3))
}

fn yes(is_so: bool) -> String {
    if is_so { "yes" } else { "no" }.to_owned()
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
