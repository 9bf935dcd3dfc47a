//! The reproduction as pictures, tables and sentences.
//!
//! ```text
//! PaperA -> paper_a, PaperB -> paper_b (both: comparison, every regulator on the same cases) --\
//! Discovery -> discovery (with mysteries), calibration     LineStudy -> lines ------------------+-> Section -> Reproduction
//! ```

mod calibration;
mod discovery;
mod lines;
mod paper_a;
mod paper_b;

use std::fmt::{Display, Write as _};

use super::loops::{Case, Comparison};
use crate::control::TrialPoint;
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::Section;
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

/// Columns beside an axis; what is not there is an empty cell.
fn csv<N: Display, V: AsRef<[f64]>>(axis: &str, at: &[f64], columns: &[(N, V)]) -> String {
    let mut out = axis.to_owned();
    for (name, _) in columns {
        let _ = write!(out, ",{name}");
    }
    for (row, at) in at.iter().enumerate() {
        let _ = write!(out, "\n{at}");
        for (_, values) in columns {
            out.push(',');
            let value = values.as_ref().get(row);
            if let Some(value) = value.filter(|value| value.is_finite()) {
                let _ = write!(out, "{value}");
            }
        }
    }
    out.push('\n');
    out
}

/// Values inside the frame; the line is cut elsewhere.
fn inside(values: &[f64], frame: &std::ops::RangeInclusive<f64>) -> Vec<f64> {
    let keep = |value: &f64| {
        if frame.contains(value) {
            *value
        } else {
            f64::NAN
        }
    };
    values.iter().map(keep).collect()
}

/// Lines over one axis: label, style, values.
fn panel<'a, V: AsRef<[f64]>>(
    title: impl Into<String>,
    unit: &str,
    at: &[f64],
    lines: impl IntoIterator<Item = (&'a str, Style, V)>,
) -> Panel {
    let lines = lines.into_iter();
    lines
        .map(|(label, style, values)| Series::sampled(label, style, at, values.as_ref()))
        .fold(Panel::new(title, unit), Panel::with)
}

/// Panels one under the other.
fn stacked(panels: impl IntoIterator<Item = Panel>) -> PanelPlot {
    let panels = panels.into_iter();
    panels.fold(PanelPlot::default(), PanelPlot::with)
}

/// One column of a trace.
fn of(trace: &[TrialPoint], column: fn(&TrialPoint) -> f64) -> Vec<f64> {
    trace.iter().map(column).collect()
}

fn times(trace: &[TrialPoint]) -> Vec<f64> {
    of(trace, |point| point.time_s)
}

fn references(trace: &[TrialPoint]) -> Vec<f64> {
    of(trace, |point| point.reference_rad_s)
}

fn speeds(trace: &[TrialPoint]) -> Vec<f64> {
    of(trace, |point| point.speed_rad_s)
}

fn outputs(trace: &[TrialPoint]) -> Vec<f64> {
    of(trace, |point| point.output_v)
}
