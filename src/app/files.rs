//! Runs, models and texts from files, and the files that commands write: models with their history, sealed truths.

use std::path::{Path, PathBuf};

use super::failure::{Failure, USAGE};
use super::output;
use crate::diagnosis::{Fitted, Rung};
use crate::emulator::mystery::Mystery;
use crate::identification::noise::FloorSource;
use crate::identification::speed_from_angle;
use crate::plant::{FileHistory, FittedValue, ModelFile};
use crate::recording::{ColumnMap, LoadedRun, open_run};
use crate::sample::ParameterEstimate;

/// Opens a run, prints its warnings, and derives the speed from the angle where there is none.
pub(crate) fn load(path: &Path, map: Option<&ColumnMap>) -> Result<LoadedRun, Failure> {
    complete(open_run(path, map)?)
}

/// Derives the speed from the angle where there is none, and prints the warnings of a run.
pub(crate) fn complete(mut loaded: LoadedRun) -> Result<LoadedRun, Failure> {
    let before = loaded.run.notes.len();
    let complete = speed_from_angle::complete(&loaded.run);
    loaded.run = complete.map_err(|error| Failure::new(USAGE, error.to_string()))?;
    let derived = &loaded.run.notes[before..];
    loaded.warnings.extend_from_slice(derived);
    if let Some(dialect) = &loaded.dialect {
        output::message(dialect);
    }
    output::warn(&loaded.warnings);
    Ok(loaded)
}

pub(crate) fn read_model(path: &Path) -> Result<ModelFile, Failure> {
    let name = path.display().to_string();
    let text = read_text(path)?;
    Ok(ModelFile::parse(&name, &text)?)
}

pub(crate) fn read_text(path: &Path) -> Result<String, Failure> {
    let cannot = |error| format!("{}: cannot read: {error}", path.display());
    std::fs::read_to_string(path).map_err(|error| Failure::usage(cannot(error), "check the path"))
}

/// The standard deviations that a model file keeps beside its values.
pub(crate) fn fitted(parameters: &[ParameterEstimate]) -> Vec<FittedValue> {
    let known = parameters.iter().filter_map(|p| {
        let std = p.std.filter(|std| *std > 0.0)?;
        let key = p.key.clone();
        Some(FittedValue { key, std })
    });
    known.collect()
}

/// The model of a fit as a file: what it was fitted on, and its rungs after those of the model before it.
pub(crate) fn model_file(
    fit: &Fitted,
    before: &FileHistory,
    fitted_on: Option<String>,
    ladder: &[Rung],
    floor: FloorSource,
) -> ModelFile {
    let mut history = FileHistory {
        fitted_on: fitted_on.into_iter().collect(),
        fitted: fitted(&fit.parameters),
        ..before.clone()
    };
    for rung in ladder.iter().map(|rung| rung_text(rung, floor)) {
        if history.ladder.last() != Some(&rung) {
            history.ladder.push(rung);
        }
    }
    let model = fit.model.clone();
    ModelFile { model, history }
}

/// One line of a model file's ladder.
fn rung_text(rung: &Rung, floor: FloorSource) -> String {
    let effects = match rung.effects.as_slice() {
        [] => "baseline".to_owned(),
        effects => effects.join(" + "),
    };
    let (error, times) = (rung.holdout_rmse, floor.times());
    format!("{effects}: held-out error {error:.2} {times}")
}

/// Writes the sealed truth and says where it is. The seed fixes every letter of it, so that the same mystery may be
/// drawn again, and another one finds its place taken.
pub(crate) fn seal(mystery: &Mystery, path: &Path) -> Result<(), Failure> {
    let text = mystery.truth.seal()?;
    let is_there = std::fs::read_to_string(path).is_ok_and(|there| there == text);
    if !is_there {
        output::refuse_existing(path, "--seal or --out")?;
        output::file(path, &text)?;
    }
    output::message(&format!("sealed truth in {}", path.display()));
    Ok(())
}

pub(crate) fn sealed_name(seed: u64) -> PathBuf {
    PathBuf::from(format!("mystery-{seed}.sealed.json"))
}
