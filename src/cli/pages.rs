//! Fills in the report pages of recorded runs that a diagnosis or a comparison was made of.

use std::path::{Path, PathBuf};

use super::data::About;
use super::failure::Failure;
use super::output;
use crate::app::pages::context;
use crate::diagnosis::{Comparison, Diagnosis, ErrorOf, Evidence, Rung, Score, compare};
use crate::identification::output_error;
use crate::plant::{Input, Model};
use crate::recording::LoadedRun;
use crate::report::{CommissionReport, ComparisonReport, ConfirmRun, Context};

/// The page of a diagnosis of recorded runs.
pub(super) fn diagnosis(
    about: &About,
    run: &LoadedRun,
    evidence: &Evidence,
    found: &Diagnosis,
) -> Result<String, Failure> {
    let context = of_data(about, run);
    let is_electrical = evidence.training.input == Input::Voltage;
    let mut evidence = evidence.clone();
    if is_electrical {
        // Without a floor of its own the first fit gave the scale.
        evidence.noise = found.baseline.noise;
    }
    let added = !found.effects.is_empty();
    let before = compare(&found.baseline.model, &evidence, ErrorOf::Structure)?;
    let after = compare(&found.model.model, &evidence, ErrorOf::Structure)?;
    let shown = evidence.confirm.as_ref().unwrap_or(&evidence.holdout);
    let simulated = |model: &Model| -> Result<_, Failure> {
        if !is_electrical {
            return Ok(None);
        }
        Ok(Some(
            output_error::predict(model, shown, &evidence.noise)?.trajectory,
        ))
    };
    let (line_before, line_after) = (
        simulated(&found.baseline.model)?,
        simulated(&found.model.model)?,
    );
    let rung = |model: &Model| -> Result<Option<Rung>, Failure> {
        let Some(run) = evidence.confirm.as_ref().filter(|_| is_electrical) else {
            return Ok(None);
        };
        Ok(Some(Rung {
            effects: model.effect_ids(),
            holdout_rmse: Score::of(model, run, &evidence.noise)?.nrms,
        }))
    };
    let confirm = rung(&found.baseline.model)?
        .zip(rung(&found.model.model)?)
        .map(|(before, after)| [before, after]);
    let report = CommissionReport {
        kind: "Diagnosis",
        title: &about.title,
        context: &context,
        nameplate: None,
        parameters_before: &found.baseline.parameters,
        parameters_after: &found.model.parameters,
        before: &before,
        after: added.then_some(&after),
        diagnosis: found,
        ladder: &found.ladder,
        confirm: confirm.as_ref(),
        series: line_before.as_ref().map(|before| ConfirmRun {
            scenario: shown,
            before,
            after: line_after.as_ref().filter(|_| added),
            noise: &evidence.noise,
        }),
        truth: &[],
    };
    Ok(report.html())
}

/// The page of a comparison.
pub(super) fn comparison(about: &About, run: &LoadedRun, comparison: &Comparison) -> String {
    let context = of_data(about, run);
    let report = ComparisonReport {
        title: &about.title,
        context: &context,
        comparison,
        holdout_objected: about.holdout_objected,
        parameters: &[],
    };
    report.html()
}

/// Writes a page where none is yet.
pub(super) fn write(path: &Path, html: &str) -> Result<(), Failure> {
    output::file(path, html)?;
    output::message(&format!("page written to {}", path.display()));
    Ok(())
}

/// The runs that were used, with what is to be known of them.
fn of_data(about: &About, run: &LoadedRun) -> Context {
    let folders: Vec<&Path> = about.runs.iter().map(PathBuf::as_path).collect();
    let manifest = run.manifest.clone().unwrap_or_default();
    Context {
        notes: run.run.notes.clone(),
        rows_dropped: run.run.rows_dropped,
        ..context(&manifest, &folders)
    }
}
