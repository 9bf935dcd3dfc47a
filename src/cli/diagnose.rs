//! `diagnose`: which physical effect is missing.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::failure::Failure;
use super::next_experiment::NextArguments;
use super::output;
use super::sanity_report::Judging;
use crate::diagnosis::{Candidate, Diagnosis, Status, diagnose};
use crate::sample::ParameterEstimate;

/// Name the physical effect that a model is missing, judged on data the fit has not seen
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench diagnose runs/a --model model.toml --holdout runs/b"
)]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Go on adding effects until the error is at the noise floor or nothing more pays
    #[arg(long)]
    until_floor: bool,
    #[command(flatten)]
    evidence: EvidenceArguments,
    #[command(flatten)]
    next: NextArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::Refits,
    )?;
    let place = arguments.next.place(&prepared)?;
    let original = &prepared.model.file.model;
    let mut diagnosis = diagnose(original, prepared.evidence.clone(), arguments.until_floor)?;
    place.recommend(&mut diagnosis, original, &prepared.evidence)?;
    arguments.next.write(&diagnosis)?;
    let mut value = serde_json::to_value(&diagnosis).unwrap_or_default();
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    output::result(&value, arguments.json, |_| text(&diagnosis))
}

pub(super) fn text(diagnosis: &Diagnosis) -> String {
    let mut text = format!("{}\n", diagnosis.sentence);
    if !diagnosis.sufficient && diagnosis.effect.is_some() {
        let _ = writeln!(
            text,
            "this is not all: much of the error is still unexplained"
        );
    }
    for candidate in &diagnosis.candidates {
        let _ = writeln!(
            text,
            "{:>2} {:<12} {}",
            candidate.rank,
            status(candidate.status),
            candidate.evidence
        );
        if matches!(candidate.status, Status::Supported | Status::Possible) {
            let _ = writeln!(text, "   {:<12} {}", "", sizes(candidate));
        }
    }
    for sentence in &diagnosis.equivalences {
        let _ = writeln!(text, "note: {sentence}");
    }
    if let Some(next) = &diagnosis.next_experiment {
        let _ = writeln!(text, "next: {}", next.sentence);
    }
    text
}

const fn status(status: Status) -> &'static str {
    match status {
        Status::Supported => "supported",
        Status::Possible => "possible",
        Status::RuledOut => "ruled out",
        Status::NotExcited => "not excited",
    }
}

fn sizes(candidate: &Candidate) -> String {
    candidate
        .parameters
        .iter()
        .map(parameter_text)
        .collect::<Vec<_>>()
        .join(", ")
}

/// `key = value +- std unit`, or why there is no value.
pub(super) fn parameter_text(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    match (parameter.value, parameter.std) {
        (Some(value), Some(std)) => format!("{key} = {value:.4e} +- {std:.1e} {}", parameter.unit),
        (Some(value), None) => format!(
            "{key} = {value:.4e} {} (uncertainty unknown)",
            parameter.unit
        ),
        (None, _) => format!(
            "{key}: {}",
            parameter.reason.as_deref().unwrap_or("not observable")
        ),
    }
}
