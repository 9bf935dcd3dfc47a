//! `compare`: the model as given beside the measurement.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::arguments::EvidenceArguments;
use super::failure::{Failure, REFUSED, USAGE};
use super::output::{self, lines};
use super::{progress, signals};
use crate::app::evidence::Judging;
use crate::app::{pages, screen};
use crate::diagnosis::{Comparison, ErrorOf, MapCell, MapDigits, ResidualLights, compare};
use crate::report::SignalFigures;
use crate::text::number::{percent, significant};

/// Compare a model with a run: fit, error, noise floor, and where it fails
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench compare runs/a --model model.toml --holdout runs/b --min-fit 90
  drivebench compare runs/a --holdout runs/b --screen     the same on the screen, measured and model over time"
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
    /// See it on the screen: measured and model over time, where the model fails
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.html {
        output::refuse_existing(path, "--html")?;
    }
    if arguments.screen {
        screen::needs_terminal(
            "--screen",
            "leave --screen out: the result is printed as text",
        )?;
    }
    let mut endable = Some(signals::endable()?);
    let shown = progress::begin("compare");
    let model = arguments.model.as_deref();
    let judging = Judging::AsGiven;
    let (evidence, run) = (&arguments.evidence, &arguments.run);
    let mut prepared = if arguments.screen {
        evidence.prepare_for_screen(run, model, judging)?
    } else {
        evidence.prepare(run, model, judging)?
    };
    prepared.fit_where_incomplete()?;
    progress::stage("compares", 0);
    let model = &prepared.model.file.model;
    let comparison = compare(model, &prepared.evidence, ErrorOf::Model)?;
    drop(shown);
    if arguments.screen {
        // Meanwhile the screen owns the terminal and hears the signals.
        drop(endable.take());
        screen::show(&prepared, model.clone())?;
        endable = Some(signals::endable()?);
    }
    let _endable = endable;
    if let Some(path) = &arguments.html {
        pages::write(path, &pages::comparison(&prepared, &comparison))?;
    }
    let mut value = prepared.result(&comparison);
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
        let headline = format!("--min-fit {least} is not a number of per cent");
        return Err(Failure::new(USAGE, headline));
    }
    let figures = SignalFigures::all(&comparison.signals);
    if figures.is_empty() {
        let headline = "no signal stands in both runs: there is no fit to judge";
        return Err(Failure::new(REFUSED, headline));
    }
    for own in figures {
        let found = own.holdout.fit_percent;
        if found.is_nan() || found < least {
            let (name, found) = (own.signal, percent(found));
            let headline = format!("held-out {name} fit {found} is below {least} %");
            return Err(Failure::new(REFUSED, headline));
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
    for own in SignalFigures::all(signals) {
        let or = |text: Option<String>, word: &str| text.unwrap_or(word.to_owned());
        let digits = |value| significant(value, 3);
        let (name, unit, rmse) = (&own.name, own.unit, digits(own.holdout.rmse));
        let (fit, held_fit) = (percent(own.fit_percent), percent(own.holdout.fit_percent));
        let times = or(own.times_noise(), "unknown");
        let floor = or(own.noise_floor.map(digits), "unknown");
        let one_step = or(own.one_step_rmse.map(digits), "-");
        let _ = writeln!(
            text,
            "{name:<width$} {held_fit:>13}  {rmse:>8} {unit:<5} {floor:>13} {times:>13} | {fit:>12} {one_step:>15}"
        );
    }
    for error in signals
        .torque_n_m
        .iter()
        .flat_map(|torque| &torque.processing)
    {
        let _ = writeln!(
            text,
            "relative torque error {:.2} % held out, {:.2} % in training: {}",
            error.holdout_relative_error_percent, error.relative_error_percent, error.sentence
        );
    }
    let _ = writeln!(text, "residual {}", lights(&comparison.residual));
    if comparison.locations.is_empty() && comparison.balances.iter().all(|b| !b.fails) {
        if comparison.balances.iter().any(|b| b.nres.is_none()) {
            text.push_str("where    not known: the errors follow nothing that was asked, and no noise is known\n");
        } else if !comparison.balances.is_empty() {
            text.push_str("where    nowhere: no equation fails beyond its noise\n");
        }
    } else {
        lines(&mut text, "where    ", comparison.undecided());
        let places = comparison.locations.iter().take(MOST_PLACES);
        lines(&mut text, "where    ", places.map(|place| &place.sentence));
    }
    // What it follows stands above.
    let balances = comparison.balances.iter();
    let balances = balances.map(|b| b.sentence.split("; ").next().unwrap_or_default());
    lines(&mut text, "balance  ", balances);
    lines(&mut text, "note     ", &comparison.limits);
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
        (true, Some(true)) => "white and independent of the input, as noise is".to_owned(),
        (true, Some(false)) => "white, but it goes with the input".to_owned(),
        (false, Some(true)) => "not white, but independent of the input".to_owned(),
        (false, Some(false)) => "not white, and it goes with the input".to_owned(),
        (white, None) => {
            let white = if white { "white" } else { "not white" };
            format!(
                "{white}; whether it goes with the input this input, which never changes, does not tell"
            )
        }
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

/// The map of the equation that fails worst, ten sizes from nothing to its largest error, a dot where the run never was.
fn map(comparison: &Comparison) -> String {
    let Some((map, worst)) = comparison.map.as_ref().zip(comparison.failing()) else {
        return String::new();
    };
    let MapDigits { largest, rows } = map.digits(worst.equation);
    if largest <= 0.0 {
        return String::new();
    }
    let (equation, nine, unit) = (worst.equation, significant(largest, 3), worst.unit);
    let mut text = format!(
        "\n{equation} error over speed and current: 9 is {nine} {unit} too low in the model, i as much too high, shades both ways, a dot: never there\n"
    );
    for (middle, digits) in rows {
        let _ = write!(text, "{middle:>8.0} rad/s  ");
        for digit in digits {
            let _ = write!(text, " {}", digit.map_or('.', MapCell::glyph));
        }
        text.push('\n');
    }
    let edges = &map.current_edges_a;
    let (from, to) = (edges[0], edges[edges.len() - 1]);
    let _ = writeln!(text, "                 {from:<12.1}{to:>12.1} A");
    text
}
