//! Two models on one run, side by side, with what each of them is.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::evidence::{Prepared, was_fitted_on};
use super::failure::Failure;
use super::files::read_model;
use super::{output, progress};
use crate::report::{Document, Table, Tone};
use drivebench_diagnose::{HoldoutFrom, SignalVersus, Versus, versus};
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

    pub(crate) fn document(&self) -> Document {
        let mut document = Document::of(Tone::Plain, "", &self.found.sentence);
        for (name, model) in ["A", "B"].into_iter().zip(&self.models) {
            let effects = match model.effects.as_slice() {
                [] => "no effect beyond the baseline".to_owned(),
                effects => effects.join(", "),
            };
            document.say(name, [format!("{}: {effects}", model.file)], 1);
        }
        let signals = &self.found.signals;
        let error = |place: usize| {
            move |own: &&SignalVersus| format!("{} {}", significant(own.rmse[place], 3), own.unit)
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
