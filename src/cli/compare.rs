//! `compare`: the model as given beside the measurement.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::failure::{Failure, REFUSED, USAGE};
use super::sanity_report::Judging;
use super::{output, pages, progress, signals};
use crate::diagnosis::{Comparison, ErrorOf, ResidualLights, SignalComparison, compare};
use crate::text::number::{fixed, percent, significant};

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
    /// Write the page: figures, lights, where the model fails; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    html: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.html {
        output::refuse_existing(path, "--html")?;
    }
    let _endable = signals::endable()?;
    let shown = progress::begin("compare");
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::AsGiven,
    )?;
    let mut model = prepared.model.file.model;
    let mut evidence = prepared.evidence;
    if prepared.model.from == "baseline" {
        progress::stage("fits the baseline", 0);
        let (with_scale, fit) = evidence.with_baseline(&model)?;
        (evidence, model) = (with_scale, fit.model);
    }
    model.require_complete()?;
    progress::stage("compares", 0);
    let comparison = compare(&model, &evidence, ErrorOf::Model)?;
    drop(shown);
    if let Some(path) = &arguments.html {
        let page = pages::comparison(&prepared.about, &prepared.run, &comparison);
        pages::write(path, &page)?;
    }
    let mut value = serde_json::to_value(&comparison).unwrap_or_default();
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    value["model"] = prepared.model.from.into();
    value["undecided"] = comparison.undecided().into();
    output::result(&value, arguments.json, |_| {
        text(&comparison) + &map(&comparison)
    })?;
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

/// The comparison as a small table, the hold-out first; then one line of lights, then sentences.
pub(super) fn text(comparison: &Comparison) -> String {
    let signals = &comparison.signals;
    let speed = signals.speed_name();
    let width = speed.len().max(SIGNAL);
    let mut text = format!(
        "{:<width$}  held-out fit   held-out rmse   noise floor   times floor | training fit   one-step rmse\n",
        "signal"
    );
    let mut row = |name: &str,
                   unit: &str,
                   fits: [f64; 2],
                   rmse: f64,
                   floor: Option<f64>,
                   one_step: Option<f64>| {
        let known = |value: Option<f64>, otherwise: &str| {
            value.map_or_else(|| otherwise.to_owned(), |value| significant(value, 3))
        };
        let _ = writeln!(
            text,
            "{name:<width$} {:>13}  {:>8} {unit:<5} {:>13} {:>13} | {:>12} {:>15}",
            percent(fits[0]),
            significant(rmse, 3),
            known(floor, "unknown"),
            floor.map_or_else(|| "unknown".to_owned(), |floor| fixed(rmse / floor, 2)),
            percent(fits[1]),
            known(one_step, "-")
        );
    };
    for (name, unit, signal) in [
        (speed.as_str(), "rad/s", signals.speed_rad_s),
        ("current", "A", signals.current_a),
    ] {
        let Some(signal) = signal else { continue };
        let fits = [signal.holdout.fit_percent, signal.fit_percent];
        let one_step = Some(signal.one_step_rmse);
        row(
            name,
            unit,
            fits,
            signal.holdout.rmse,
            signal.noise_floor,
            one_step,
        );
    }
    if let Some(torque) = &signals.torque_n_m {
        let fits = [torque.holdout.fit_percent, torque.fit_percent];
        row(
            "torque",
            "N.m",
            fits,
            torque.holdout.rmse,
            torque.noise_floor,
            None,
        );
        for error in &torque.processing {
            let _ = writeln!(
                text,
                "relative torque error {:.2} % held out, {:.2} % in training: {}",
                error.holdout_relative_error_percent, error.relative_error_percent, error.sentence
            );
        }
    }
    let _ = writeln!(text, "residual {}", lights(&comparison.residual));
    if comparison.locations.is_empty() && comparison.balances.iter().all(|b| !b.fails) {
        if !comparison.balances.is_empty() {
            text.push_str("where    nowhere: no equation fails beyond its noise\n");
        }
    } else {
        if let Some(sentence) = comparison.undecided() {
            let _ = writeln!(text, "where    {sentence}");
        }
        for location in comparison.locations.iter().take(MOST_PLACES) {
            let _ = writeln!(text, "where    {}", location.sentence);
        }
    }
    for balance in &comparison.balances {
        // What it follows stands above.
        let told = balance.sentence.split("; ").next().unwrap_or_default();
        let _ = writeln!(text, "balance  {told}");
    }
    for limit in &comparison.limits {
        let _ = writeln!(text, "note     {limit}");
    }
    text
}

/// Width of a signal's name.
const SIGNAL: usize = 8;
/// Sentences about places that are shown; all are in the JSON.
const MOST_PLACES: usize = 3;

/// One line: whether only noise is left, then each correlation in multiples of its 99 % band, `!` where it is outside.
fn lights(residual: &ResidualLights) -> String {
    if !residual.enough_samples {
        return "too few samples to say whether only noise is left".to_owned();
    }
    let mut line = match (residual.white, residual.independent_of_input) {
        (true, true) => "white and independent of the input, as noise is".to_owned(),
        (true, false) => "white, but it goes with the input".to_owned(),
        (false, true) => "not white, but independent of the input".to_owned(),
        (false, false) => "not white, and it goes with the input".to_owned(),
    };
    line.push_str(" (times the 99 % band:");
    for (name, signal) in residual.named() {
        let _ = write!(line, " {name}");
        for (light, value) in signal.named() {
            let mark = if value.passes { "" } else { "!" };
            let _ = write!(line, " {light} {:.1}{mark}", value.largest_over_band);
        }
        line.push(';');
    }
    line.pop();
    line.push(')');
    line
}

/// The map of the equation that fails worst, ten shades from nothing to its largest error, a dot where the run never was.
fn map(comparison: &Comparison) -> String {
    let (Some(map), Some(worst)) = (
        &comparison.map,
        comparison.balances.first().filter(|balance| balance.fails),
    ) else {
        return String::new();
    };
    let cells = if worst.equation == "torque" {
        &map.torque_rms_n_m
    } else {
        &map.voltage_rms_v
    };
    let largest = cells
        .iter()
        .flatten()
        .flatten()
        .fold(0.0, |most: f64, value| most.max(*value));
    if largest <= 0.0 {
        return String::new();
    }
    let mut text = format!(
        "\n{} error over speed and current: 9 is {} {}, a dot where the run never was\n",
        worst.equation,
        significant(largest, 3),
        worst.unit
    );
    for (row, values) in cells.iter().enumerate().rev() {
        let middle = 0.5 * (map.speed_edges_rad_s[row] + map.speed_edges_rad_s[row + 1]);
        let _ = write!(text, "{middle:>8.0} rad/s  ");
        for value in values {
            let mark = value.map_or_else(
                || ".".to_owned(),
                |value| format!("{:.0}", 9.0 * value / largest),
            );
            let _ = write!(text, " {mark}");
        }
        text.push('\n');
    }
    let edges = &map.current_edges_a;
    let _ = writeln!(
        text,
        "                 {:<12.1}{:>12.1} A",
        edges[0],
        edges[edges.len() - 1]
    );
    text
}
