//! `compare`: the model as given beside the measurement.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::failure::{Failure, REFUSED, USAGE};
use super::output;
use super::sanity_report::Judging;
use crate::diagnosis::{Comparison, ErrorOf, SignalComparison, compare};

/// Compare a model with a run: fit, error, noise floor, and where it fails
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench compare runs/a --model model.toml --holdout runs/b --min-fit 90"
)]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Exit with status 1 when a held-out fit is below this, in per cent
    #[arg(long, value_name = "P")]
    min_fit: Option<f64>,
    #[command(flatten)]
    evidence: EvidenceArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::AsGiven,
    )?;
    let mut model = prepared.model.file.model;
    let mut evidence = prepared.evidence;
    if prepared.model.from == "baseline" {
        let (with_scale, fit) = evidence.with_baseline(&model)?;
        (evidence, model) = (with_scale, fit.model);
    }
    model.require_complete()?;
    let comparison = compare(&model, &evidence, ErrorOf::Model)?;
    let mut value = serde_json::to_value(&comparison).unwrap_or_default();
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    value["model"] = prepared.model.from.into();
    output::result(&value, arguments.json, |_| text(&comparison))?;
    check_fit(&comparison, arguments.min_fit)
}

fn check_fit(comparison: &Comparison, min_fit: Option<f64>) -> Result<(), Failure> {
    let Some(least) = min_fit else { return Ok(()) };
    if !least.is_finite() {
        return Err(Failure::new(
            USAGE,
            format!("--min-fit {least} is not a number of per cent"),
        ));
    }
    let signals = &comparison.signals;
    let fit = |signal: Option<SignalComparison>| signal.map(|signal| signal.holdout.fit_percent);
    let torque = signals.torque_n_m.as_ref();
    let fits = [
        ("speed", fit(signals.speed_rad_s)),
        ("current", fit(signals.current_a)),
        ("torque", torque.map(|torque| torque.holdout.fit_percent)),
    ];
    if fits.iter().all(|(_, fit)| fit.is_none()) {
        return Err(Failure::new(
            REFUSED,
            "no signal stands in both runs: there is no fit to judge",
        ));
    }
    for (name, fit) in fits {
        if let Some(found) = fit.filter(|found| *found < least) {
            return Err(Failure::new(
                REFUSED,
                format!("held-out {name} fit {found:.1} % is below {least} %"),
            ));
        }
    }
    Ok(())
}

/// The comparison as a small table, the hold-out first.
pub(super) fn text(comparison: &Comparison) -> String {
    let mut text = String::from(
        "signal   fit held-out   rmse held-out   noise floor   fit training   one-step rmse\n",
    );
    let mut row = |name: &str, unit: &str, signal: Option<SignalComparison>| {
        let Some(signal) = signal else { return };
        let floor = signal
            .noise_floor
            .map_or_else(|| "unknown".to_owned(), |floor| format!("{floor:.3}"));
        let _ = writeln!(
            text,
            "{name:<8} {:>10.2} % {:>9.3} {unit:<5} {floor:>12} {:>12.2} % {:>15.3}",
            signal.holdout.fit_percent,
            signal.holdout.rmse,
            signal.fit_percent,
            signal.one_step_rmse
        );
    };
    row("speed", "rad/s", comparison.signals.speed_rad_s);
    row("current", "A", comparison.signals.current_a);
    if let Some(torque) = &comparison.signals.torque_n_m {
        let floor = torque
            .noise_floor
            .map_or_else(|| "unknown".to_owned(), |floor| format!("{floor:.3}"));
        let _ = writeln!(
            text,
            "torque   {:>10.2} % {:>9.3} N.m   {floor:>12} {:>12.2} %",
            torque.holdout.fit_percent, torque.holdout.rmse, torque.fit_percent
        );
        for error in &torque.processing {
            let _ = writeln!(
                text,
                "relative torque error {:.2} % held out, {:.2} % in training: {}",
                error.holdout_relative_error_percent, error.relative_error_percent, error.sentence
            );
        }
    }
    let white = if comparison.residual.white {
        "white: nothing but noise is left"
    } else {
        "not white"
    };
    let _ = writeln!(text, "residual {white}");
    for balance in &comparison.balances {
        let _ = writeln!(text, "balance  {}", balance.sentence);
    }
    for location in comparison.locations.iter().take(3) {
        let _ = writeln!(text, "where    {}", location.sentence);
    }
    text
}
