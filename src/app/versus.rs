//! Two models on one run, side by side, with what each of them is.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::evidence::{Prepared, was_fitted_on};
use super::failure::Failure;
use super::files::read_model;
use super::{output, progress};
use crate::report::card::COLUMNS;
use drivebench_diagnose::{HoldoutFrom, Versus, versus};
use drivebench_model::text::lines::wrapped;
use drivebench_model::text::number::{fit, significant};

#[derive(Serialize)]
pub(crate) struct VersusResult {
    /// Files of the models, and the effects in them.
    models: [ModelOf; 2],
    #[serde(flatten)]
    found: Versus,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct ModelOf {
    file: String,
    effects: Vec<&'static str>,
}

impl VersusResult {
    /// The prepared model and another, as they are, on the same hold-out.
    pub(crate) fn of(prepared: &Prepared, second: &Path, run: &Path) -> Result<Self, Failure> {
        let other = read_model(second)?;
        let first = &prepared.model.file.model;
        first.require_complete()?;
        other.model.require_complete()?;
        let mut notes = prepared.run.run.notes.clone();
        let holdout = prepared.about.runs.get(1).map(PathBuf::as_path);
        let holdout = holdout.filter(|_| prepared.evidence.holdout_from == HoldoutFrom::Run);
        let fitted = was_fitted_on(&other.history.fitted_on, run, holdout);
        let fitted = fitted.map(|sentence| format!("B: {sentence}"));
        output::warn(fitted.as_slice());
        notes.extend(fitted);
        progress::stage("compares", 0);
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

    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        for (name, model) in ["A", "B"].into_iter().zip(&self.models) {
            let effects = match model.effects.as_slice() {
                [] => "no effect beyond the baseline".to_owned(),
                effects => effects.join(", "),
            };
            let _ = writeln!(text, "{name}  {}: {effects}", model.file);
        }
        let _ = writeln!(
            text,
            "\n{:<12} {:>16} {:>16} {:>12} {:>12}",
            "held out", "A error", "B error", "A fit", "B fit"
        );
        for own in &self.found.signals {
            let error = |value: f64| format!("{} {}", significant(value, 3), own.unit);
            let [first, second] = own.rmse.map(error);
            let [first_fit, second_fit] = own.fit_percent.map(fit);
            let _ = writeln!(
                text,
                "{:<12} {first:>16} {second:>16} {first_fit:>12} {second_fit:>12}",
                own.signal
            );
        }
        let sentence = wrapped(&self.found.sentence, COLUMNS).join("\n");
        let _ = writeln!(text, "\n{sentence}");
        text
    }
}
