//! The identified model as a file.

use std::path::Path;

use super::Answer;
use crate::cli::failure::{Failure, USAGE};
use crate::cli::model_output;
use crate::identification::scheme::Identified;
use crate::plant::ModelFile;

pub(super) fn model(path: &Path, mut file: ModelFile, answer: &Answer) -> Result<(), Failure> {
    model_output::refuse_existing(path)?;
    let parameters = answer.parameters();
    let start = answer.runs.first().map(|run| &run.found.model);
    file.model = Identified::new("", start.unwrap_or(&file.model), parameters.clone()).model;
    file.history.fitted_on = answer
        .runs
        .iter()
        .map(|run| run.loaded.run.name.clone())
        .collect();
    file.history.fitted = model_output::fitted(&parameters);
    std::fs::write(path, file.to_toml()).map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "check the folder",
        )
    })
}
