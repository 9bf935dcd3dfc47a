//! `compare`: predicted and measured signals of one model, or the errors of two models on the same run.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::commands::arguments::{EvidenceArguments, MoreRuns, run_path};
use crate::commands::evidence::{Judging, Prepared, was_fitted_on};
use crate::commands::{pages, view};
use crate::report::wording::{effects, json, location, versus as words};
use crate::report::{Document, SignalFigures, Table, Tone};
use crate::runtime::{Failure, Form, ProgressLine, REFUSED, Terminal, USAGE, output, read_model};
use drivebench_diagnose::{
    Comparison, HoldoutFrom, SignalVersus, Undecided, Versus, compare, versus,
};
use drivebench_model::text::number::{fit, significant};

/// Compare a model with a run: fit, error, noise floor, and where it fails
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench compare runs/a --model model.toml --holdout runs/b --min-fit 90\n  drivebench compare runs/a --model before.toml --model after.toml --holdout runs/b     which is better\n  drivebench compare runs/a --holdout runs/b --screen     measured and model over time, on the screen"
)]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(value_parser = run_path())]
    run: PathBuf,
    #[command(flatten)]
    more: MoreRuns,
    /// Model file; without it the run folder's, else a fitted baseline. Two of them are compared with each other
    #[arg(long, value_parser = run_path())]
    model: Vec<PathBuf>,
    /// Exit with status 1 when a held-out fit is below this, in per cent
    #[arg(long, value_name = "P")]
    min_fit: Option<f64>,
    #[command(flatten)]
    evidence: EvidenceArguments,
    /// Write the page: figures, lights, where the model fails; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    html: Option<PathBuf>,
    /// Show it on the screen: measured and model over time, where the model fails
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    #[command(flatten)]
    form: Form,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    arguments.more.refuse()?;
    output::refuse_existing(&arguments.html, "--html")?;
    if arguments.screen {
        view::needs_terminal("--screen", "leave --screen out: the result is printed as text")?;
    }
    let mut endable = Some(terminal.endable()?);
    let shown = terminal.progress("compare");
    let model = match arguments.model.as_slice() {
        [_, _] if arguments.screen => {
            let help = "--screen shows one model with the run";
            return Err(Failure::usage("two models are given with --screen", help));
        }
        [first, second] => return both(arguments, first, second, terminal, shown),
        [_, _, _, ..] => {
            let help = "give two models, and compare the better with the third";
            return Err(Failure::usage("more than two models are given", help));
        }
        models => models.first().map(PathBuf::as_path),
    };
    let (evidence, run) = (&arguments.evidence, &arguments.run);
    let judging = Judging::of(model);
    let mut prepared = evidence.prepare(run, model, judging, arguments.screen, terminal)?;
    let from = prepared.model.from.clone();
    let judged = prepared.judge_as_diagnose(model.is_some(), terminal)?;
    terminal.stage("compares", 0);
    let model = &prepared.model.file.model;
    let comparison = compare(model, &prepared.evidence, judged.error_of)?;
    drop(shown);
    if arguments.screen {
        // Meanwhile the screen uses the terminal and handles the signals.
        drop(endable.take());
        view::show(&prepared, judged.error_of, terminal)?;
        endable = Some(terminal.endable()?);
    }
    let _endable = endable;
    let is_whole = arguments.html.is_some() || (arguments.form.full && !arguments.form.json);
    let mut document = pages::comparison(&prepared, &comparison, is_whole)?;
    pages::write(&mut document, arguments.html.as_deref(), terminal)?;
    document.go_on(evidence.diagnose(run, arguments.model.first().map(PathBuf::as_path)));
    let mut value = prepared.result(&json::comparison(&comparison));
    value["model"] = from.into();
    value["refitted"] = judged.refitted.into();
    let undecided = comparison.undecided();
    value["undecided"] = undecided.as_ref().map(location::undecided).into();
    value["undecided_code"] = undecided.as_ref().map(Undecided::code).into();
    terminal.document(&value, arguments.form, &document)?;
    check_fit(&comparison, arguments.min_fit)
}

fn both(
    arguments: &Arguments,
    first: &Path,
    second: &Path,
    terminal: &Terminal,
    shown: ProgressLine,
) -> Result<(), Failure> {
    if arguments.min_fit.is_some() || arguments.html.is_some() {
        let headline = "--min-fit and --html need one model, and two are given";
        return Err(Failure::usage(headline, "leave one --model out"));
    }
    let judging = Judging::AsGiven;
    let prepared =
        (arguments.evidence).prepare(&arguments.run, Some(first), judging, false, terminal)?;
    let result = VersusResult::of(&prepared, second, &arguments.run, terminal)?;
    drop(shown);
    terminal.document(&result, arguments.form, &result.document())
}

fn check_fit(comparison: &Comparison, min_fit: Option<f64>) -> Result<(), Failure> {
    let Some(least) = min_fit else { return Ok(()) };
    if !least.is_finite() {
        return Err(Failure::new(USAGE, format!("--min-fit {least} is not a number of per cent")));
    }
    let figures = SignalFigures::all(&comparison.signals);
    if figures.is_empty() {
        return Err(Failure::new(REFUSED, "no signal is in both runs: there is no fit to judge"));
    }
    for figure in figures {
        let found = figure.holdout.fit_percent;
        if found.is_nan() || found < least {
            let (name, found) = (figure.signal, fit(found));
            let headline = format!("held-out {name} fit {found} is below {least} %");
            return Err(Failure::new(REFUSED, headline));
        }
    }
    Ok(())
}

#[derive(Serialize)]
pub(crate) struct VersusResult {
    models: [ModelOf; 2],
    #[serde(flatten, serialize_with = "json::of_both")]
    found: Versus,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct ModelOf {
    file: String,
    effects: Vec<&'static str>,
}

impl VersusResult {
    /// The prepared model and another, both without a refit, on the same hold-out.
    pub(crate) fn of(
        prepared: &Prepared,
        second: &Path,
        run: &Path,
        terminal: &Terminal,
    ) -> Result<Self, Failure> {
        let other = read_model(second)?;
        let first = &prepared.model.file.model;
        first.require_complete()?;
        other.model.require_complete()?;
        let mut notes = prepared.run.run.notes.clone();
        let holdout = prepared.about.runs.get(1).map(PathBuf::as_path);
        let holdout = holdout.filter(|_| prepared.evidence.holdout_from == HoldoutFrom::Run);
        let fitted = was_fitted_on(&other.history.fitted_on, run, holdout);
        let fitted = fitted.map(|sentence| format!("B: {sentence}"));
        terminal.warn(fitted.as_slice());
        notes.extend(fitted);
        terminal.stage("compares", 0);
        let found = versus([first, &other.model], &prepared.evidence)?;
        let of = |file: String, effects| ModelOf { file, effects };
        Ok(Self {
            models: [
                of(prepared.model.from.clone(), first.effect_ids()),
                of(second.display().to_string(), other.model.effect_ids()),
            ],
            found,
            notes,
        })
    }

    pub(crate) fn document(&self) -> Document {
        let mut document = Document::of(Tone::Plain, "", words::versus(&self.found));
        for (name, model) in ["A", "B"].into_iter().zip(&self.models) {
            let effects = effects(&model.effects);
            document.say(name, [format!("{}: {effects}", model.file)], 1);
        }
        let signals = &self.found.signals;
        let error = |model: usize| {
            move |signal: &&SignalVersus| {
                format!("{} {}", significant(signal.rmse[model], 3), signal.unit)
            }
        };
        let table = Table::of(signals)
            .column("signal", |own| own.signal)
            .column("A error", error(0))
            .column("B error", error(1))
            .column("A fit", |own| fit(own.fit_percent[0]))
            .column("B fit", |own| fit(own.fit_percent[1]));
        document.table_on_card("held out", table, &[], signals.len());
        document.say("note", self.notes.iter().map(String::as_str), 1);
        document
    }
}
