//! Runs, models and texts from files.

use std::path::Path;

use super::failure::{Failure, USAGE};
use super::output;
use crate::identification::speed_from_angle;
use crate::plant::ModelFile;
use crate::recording::{ColumnMap, LoadedRun, open_run};

/// Opens a run, prints its warnings, and derives the speed from the angle where there is none.
pub(crate) fn load(path: &Path, map: Option<&ColumnMap>) -> Result<LoadedRun, Failure> {
    complete(open_run(path, map)?)
}

/// Derives the speed from the angle where there is none, and prints the warnings of a run.
pub(crate) fn complete(mut loaded: LoadedRun) -> Result<LoadedRun, Failure> {
    let before = loaded.run.notes.len();
    loaded.run = speed_from_angle::complete(&loaded.run)
        .map_err(|error| Failure::new(USAGE, error.to_string()))?;
    loaded
        .warnings
        .extend_from_slice(&loaded.run.notes[before..]);
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
    std::fs::read_to_string(path).map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot read: {error}", path.display()),
            "check the path",
        )
    })
}
