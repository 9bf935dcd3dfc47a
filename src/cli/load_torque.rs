//! `identify RUN --model M --load-torque FILE.csv`: the load torque over time.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;

use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::output;
use crate::identification::kalman::{
    LoadError, LoadOptions, LoadPoint, LoadTrace, load_torque_trace,
};
use crate::plant::Model;
use crate::sample::Run;

/// Tracks the load torque, writes it to `path` and prints a summary.
pub(super) fn execute(path: &Path, run: &Run, model: &Model, json: bool) -> Result<(), Failure> {
    if path.exists() {
        return Err(Failure::with_help(
            USAGE,
            format!(
                "{}: exists already, and records are never overwritten",
                path.display()
            ),
            "choose another name for --load-torque",
        ));
    }
    let trace = load_torque_trace(run, model, LoadOptions::default())?;
    output::file(path, &csv(&trace))?;
    let extreme = |better: fn(f64, f64) -> bool| {
        trace.points.iter().reduce(|a, b| {
            if better(b.load_torque_n_m, a.load_torque_n_m) {
                b
            } else {
                a
            }
        })
    };
    let point = |point: Option<&LoadPoint>| {
        point.map(|p| {
            json!({ "time_s": p.time_s, "load_torque_n_m": p.load_torque_n_m, "load_torque_std_n_m": p.std_n_m })
        })
    };
    let summary = json!({
        "output": path,
        "rows": trace.points.len(),
        "rows_followed": trace.rows_followed,
        "input": format!("{:?}", trace.input).to_lowercase(),
        "rate_n_m_per_sqrt_s": trace.rate_n_m_per_sqrt_s,
        "rate_from_data": trace.rate_from_data,
        "median_std_n_m": trace.median_std_n_m(),
        "least": point(extreme(|a, b| a < b)),
        "most": point(extreme(|a, b| a > b)),
        "innovation_over_noise": { "current": trace.consistency[0], "speed": trace.consistency[1] },
        "notes": trace.notes,
    });
    output::result(&summary, json, |_| text(&trace, path))
}

fn csv(trace: &LoadTrace) -> String {
    let mut csv = "time_s,load_torque_n_m,load_torque_std_n_m\n".to_owned();
    for point in &trace.points {
        let _ = writeln!(
            csv,
            "{},{},{}",
            point.time_s, point.load_torque_n_m, point.std_n_m
        );
    }
    csv
}

fn text(trace: &LoadTrace, path: &Path) -> String {
    let mut text = format!(
        "load torque at {} instants written to {}\nmedian standard deviation {:.2e} N.m; expected change {:.2e} N.m/sqrt(s){}; motor turning at {} rows\n",
        trace.points.len(),
        path.display(),
        trace.median_std_n_m(),
        trace.rate_n_m_per_sqrt_s,
        if trace.rate_from_data {
            ", found from the run"
        } else {
            ""
        },
        trace.rows_followed
    );
    for note in &trace.notes {
        let _ = writeln!(text, "{note}");
    }
    text
}

impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        let status = match error {
            LoadError::Incomplete { .. } | LoadError::Value { .. } => USAGE,
            LoadError::Scenario(_) | LoadError::NothingSeen { .. } => NOT_IDENTIFIABLE,
        };
        Self::with_help(status, error.to_string(), error.help())
    }
}
