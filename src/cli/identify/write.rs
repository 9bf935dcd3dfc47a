//! The identified model as a file.

use std::path::Path;

use super::Answer;
use crate::cli::failure::Failure;
use crate::cli::{model_output, output};
use crate::identification::scheme::Identified;
use crate::plant::ModelFile;

pub(super) fn model(path: &Path, mut file: ModelFile, answer: &Answer) -> Result<(), Failure> {
    output::refuse_existing(path, "--output")?;
    let mut parameters = answer.parameters();
    parameters.retain(super::is_told);
    // Onto the given model: what was not observable stays as it was given, or is left out.
    file.model = Identified::new("", &file.model, parameters.clone()).model;
    file.history.fitted_on = answer
        .runs
        .iter()
        .map(|run| run.loaded.run.name.clone())
        .collect();
    file.history.fitted = model_output::fitted(&parameters);
    output::file(path, &file.to_toml())
}
