//! `export`: a model and its gains for other tools.

use std::path::PathBuf;

use super::arguments::run_path;
use super::failure::Failure;
use super::output;
use crate::app::export::{ExportRequest, export};
use crate::report::export::Target;

/// Write a model, with the gains of its regulator, as JSON, C, Python, MATLAB/Octave or Modelica
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench export --model model.toml --to c --output motor.h
  drivebench tune --model model.toml --json > gains.json
  drivebench export --model model.toml --to python --gains gains.json --limit-v 110 --output motor.py")]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long, value_parser = run_path())]
    model: PathBuf,
    /// Format
    #[arg(long, value_enum)]
    to: Format,
    /// Gains of this model, as `tune --json` prints them
    #[arg(long, value_name = "GAINS.json", requires = "limit_v")]
    gains: Option<PathBuf>,
    /// Largest voltage that the regulator may give, V
    #[arg(long, value_name = "V", requires = "gains")]
    limit_v: Option<f64>,
    /// Write here instead of to stdout; never overwritten. Its name is that of the model in the file
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    /// The model file's tables, every effect with its law
    Json,
    /// One header: C99, no heap, a step function
    C,
    /// A class on numpy
    Python,
    /// A function file for MATLAB and GNU Octave
    Matlab,
    /// A model with an input of the voltage
    Modelica,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.output {
        output::refuse_existing(path, "--output")?;
    }
    let stem = arguments.output.as_ref().and_then(|path| path.file_stem());
    let name = stem.map(|stem| stem.to_string_lossy());
    let (text, title) = export(&ExportRequest {
        model: &arguments.model,
        target: match arguments.to {
            Format::Json => None,
            Format::C => Some(Target::C),
            Format::Python => Some(Target::Python),
            Format::Matlab => Some(Target::Matlab),
            Format::Modelica => Some(Target::Modelica),
        },
        gains: arguments.gains.as_deref().zip(arguments.limit_v),
        name: name.as_deref(),
    })?;
    let Some(path) = &arguments.output else {
        return output::line(text.trim_end());
    };
    output::file(path, &text)?;
    output::line(&format!("{}: {title}", path.display()))
}
