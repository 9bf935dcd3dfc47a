//! `export`: a model and its gains for other tools, the map of a torque, or a run as columns.

use std::path::{Path, PathBuf};

use super::arguments::{MapArguments, run_path};
use super::failure::Failure;
use super::output;
use crate::app::export::{ExportRequest, export, require_parquet, run_as_parquet, torque_map_of};
use crate::report::export::Target;
use drivebench_bench::recording::LoadedRun;
use drivebench_model::plant::MappedTorque;

/// Write a model, with the gains of its regulator, as JSON, C, Python, MATLAB/Octave or Modelica; friction or cogging as
/// runs show it, as CSV or C; or a run as Parquet
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench export --model model.toml --to c --output motor.h
  drivebench tune --model model.toml --json > gains.json
  drivebench export --model model.toml --to python --gains gains.json --limit-v 110 --output motor.py
  drivebench export --torque-map friction --run runs/a --run runs/b --model model.toml --to c --output friction.h
  drivebench export --run runs/latest --to parquet --output run.parquet")]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long, value_parser = run_path(), required_unless_present = "run")]
    model: Option<PathBuf>,
    /// Run folder, samples.csv, or any CSV with --map; of a torque map several
    #[arg(long, value_parser = run_path(), conflicts_with = "gains")]
    run: Vec<PathBuf>,
    /// friction (over the speed, both directions) or cogging (over a turn): measured from the torque balance of the runs
    /// with Kt and J of the model, whatever friction or cogging the model has; a bin without data is empty
    #[arg(long, value_name = "TORQUE", value_parser = mapped, requires = "run", requires = "model")]
    torque_map: Option<MappedTorque>,
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
    /// The torque map: a row for each bin, with its 95 % interval
    Csv,
    /// The run as columns, for pandas and others; in programs that were built with the feature of this name
    Parquet,
}

fn mapped(text: &str) -> Result<MappedTorque, String> {
    let all = MappedTorque::ALL.map(MappedTorque::name).join(", ");
    MappedTorque::from_name(text).ok_or_else(|| format!("expected one of {all}"))
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.output {
        output::refuse_existing(path, "--output")?;
    }
    let stem = arguments.output.as_ref().and_then(|path| path.file_stem());
    let name = stem.map(|stem| stem.to_string_lossy());
    let name = name.as_deref();
    let (runs, to) = (arguments.run.as_slice(), arguments.to);
    let (text, title) = match (&arguments.model, runs, arguments.torque_map) {
        (Some(model), [], None) if !matches!(to, Format::Csv | Format::Parquet) => {
            export(&ExportRequest {
                model,
                target: to.target(),
                gains: arguments.gains.as_deref().zip(arguments.limit_v),
                name,
            })?
        }
        (Some(model), [_, ..], Some(of)) if matches!(to, Format::C | Format::Csv) => {
            let loaded = runs.iter().map(|run| arguments.map.load(run));
            let loaded: Vec<LoadedRun> = loaded.collect::<Result<_, _>>()?;
            let name = name.unwrap_or(of.name());
            torque_map_of(of, model, &loaded, (to == Format::C).then_some(name))?
        }
        (None, [run], None) if to == Format::Parquet => return columns(arguments, run),
        _ => {
            let headline = "a run is written as parquet, a torque map as csv or c, and a model as anything else";
            let help = "give --run RUN --to parquet, --torque-map TORQUE --run RUN --model MODEL.toml --to csv, or --model MODEL.toml with another format";
            return Err(Failure::usage(headline, help));
        }
    };
    let Some(path) = &arguments.output else {
        return output::line(text.trim_end());
    };
    output::file(path, &text)?;
    output::text(&format!("{}: {title}", path.display()))
}

impl Format {
    /// The language of a model; none for JSON, of a torque map and of a run.
    const fn target(self) -> Option<Target> {
        match self {
            Self::C => Some(Target::C),
            Self::Python => Some(Target::Python),
            Self::Matlab => Some(Target::Matlab),
            Self::Modelica => Some(Target::Modelica),
            Self::Json | Self::Csv | Self::Parquet => None,
        }
    }
}

/// The run as columns.
fn columns(arguments: &Arguments, run: &Path) -> Result<(), Failure> {
    let Some(path) = &arguments.output else {
        let help = "add --output FILE: columns are not for a terminal";
        return Err(Failure::usage("--output is missing", help));
    };
    require_parquet()?;
    let loaded = arguments.map.load(run)?;
    let folder = (run.is_dir() && !arguments.map.is_given()).then_some(run);
    output::file(path, &run_as_parquet(&loaded, folder)?)?;
    let rows = loaded.run.rows();
    output::text(&format!("{}: {rows} rows", path.display()))
}
