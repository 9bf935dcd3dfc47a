//! `export`: a model and its gains for other tools.

use std::path::PathBuf;

use super::arguments::{MapArguments, run_path};
use super::failure::Failure;
use super::output;
use crate::app::export::{ExportRequest, export, require_parquet, run_as_parquet};
use crate::report::export::Target;

/// Write a model, with the gains of its regulator, as JSON, C, Python, MATLAB/Octave or Modelica; or a run as Parquet
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench export --model model.toml --to c --output motor.h
  drivebench tune --model model.toml --json > gains.json
  drivebench export --model model.toml --to python --gains gains.json --limit-v 110 --output motor.py
  drivebench export --run runs/latest --to parquet --output run.parquet")]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long, value_parser = run_path(), required_unless_present = "run")]
    model: Option<PathBuf>,
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(long, value_parser = run_path(), conflicts_with_all = ["model", "gains"], requires = "output")]
    run: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
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

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
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
    /// The run as columns, for pandas and others; in programs that were built with the feature of this name
    Parquet,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.output {
        output::refuse_existing(path, "--output")?;
    }
    let model = match (&arguments.model, arguments.to) {
        (Some(model), format) if format != Format::Parquet => model,
        _ => return run(arguments),
    };
    let stem = arguments.output.as_ref().and_then(|path| path.file_stem());
    let name = stem.map(|stem| stem.to_string_lossy());
    let (text, title) = export(&ExportRequest {
        model,
        target: arguments.to.target(),
        gains: arguments.gains.as_deref().zip(arguments.limit_v),
        name: name.as_deref(),
    })?;
    let Some(path) = &arguments.output else {
        return output::line(text.trim_end());
    };
    output::file(path, &text)?;
    output::text(&format!("{}: {title}", path.display()))
}

impl Format {
    /// The language of a model; none for JSON and of a run.
    const fn target(self) -> Option<Target> {
        match self {
            Self::C => Some(Target::C),
            Self::Python => Some(Target::Python),
            Self::Matlab => Some(Target::Matlab),
            Self::Modelica => Some(Target::Modelica),
            Self::Json | Self::Parquet => None,
        }
    }
}

/// The run, where both run and format are of one.
fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (Some(run), Some(path), Format::Parquet) =
        (&arguments.run, &arguments.output, arguments.to)
    else {
        let headline = "a run is written as parquet, and a model as anything else";
        let help = "give --run RUN --to parquet, or --model MODEL.toml with another format";
        return Err(Failure::usage(headline, help));
    };
    require_parquet()?;
    let loaded = arguments.map.load(run)?;
    let folder = (run.is_dir() && !arguments.map.is_given()).then_some(run.as_path());
    output::file(path, &run_as_parquet(&loaded, folder)?)?;
    let rows = loaded.run.rows();
    output::text(&format!("{}: {rows} rows", path.display()))
}
