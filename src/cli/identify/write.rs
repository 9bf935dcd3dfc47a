//! The identified model as a file.

use std::path::Path;

use super::Answer;
use crate::cli::failure::{Failure, USAGE};
use crate::identification::scheme::Identified;
use crate::plant::{FittedValue, ModelFile};

pub(super) fn model(path: &Path, mut file: ModelFile, answer: &Answer) -> Result<(), Failure> {
    if path.exists() {
        let headline = format!(
            "{}: exists already, and models are never overwritten",
            path.display()
        );
        return Err(Failure::with_help(
            USAGE,
            headline,
            "choose another name for --output",
        ));
    }
    let parameters = answer.parameters();
    let start = answer.runs.first().map(|run| &run.found.model);
    file.model = Identified::new("", start.unwrap_or(&file.model), parameters.clone()).model;
    file.history.fitted_on = answer
        .runs
        .iter()
        .map(|run| run.loaded.run.name.clone())
        .collect();
    file.history.fitted = parameters
        .iter()
        .filter_map(|p| {
            Some(FittedValue {
                key: p.key.clone(),
                std: p.std.filter(|std| *std > 0.0)?,
            })
        })
        .collect();
    std::fs::write(path, file.to_toml()).map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "check the folder",
        )
    })
}
