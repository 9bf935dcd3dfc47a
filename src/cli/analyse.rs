//! `analyse`: many runs as one table, a row each.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use super::arguments::{MapArguments, shard};
use super::failure::Failure;
use super::{output, progress, signals};
use crate::app::analyse::{Analysed, AnalysisRequest, Form, analyse, analysis_of};

/// Analyse many runs, each by itself, into one table: a row a run, with its parameters, their intervals and verdicts
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench analyse runs --out fleet.csv                     every run below the folder
  drivebench analyse runs --out fleet.csv --resume            only what is new or was changed
  drivebench analyse 'runs/2026-*' --out fleet.parquet        a pattern, as columns
  drivebench analyse runs --shard 3/8 --out part-3.csv        the third of eight blocks, on one of eight machines

The columns do not depend on the runs; docs/suites.md lists them, with queries in DuckDB and Polars. A run that cannot be
read is a row that says why. Killed at any time, --resume goes on where it was.
Exit status: 0 every run was read; 1 some could not be; 2 none.")]
pub(super) struct Arguments {
    /// Run folders, folders of runs, CSV files, or quoted patterns with *, ? and **
    #[arg(required = true, value_name = "RUNS")]
    runs: Vec<PathBuf>,
    /// Table to write, .csv or .parquet; without it CSV on standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Keep the rows of FILE that this version found with the same options in runs that have not changed since
    #[arg(long, requires = "out")]
    resume: bool,
    /// Block I of N of the runs: the tables of all blocks behind each other are that of the whole
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(u64, u64)>,
    /// Runs at once; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// Model file whose parameters are sought in every run; without it the five-parameter baseline
    #[arg(long, value_name = "MODEL.toml")]
    model: Option<PathBuf>,
    /// Method, one of the schemes that `identify --help` lists
    #[arg(long, value_name = "S")]
    scheme: Option<String>,
    /// Name the effects that each run asks for, too; some forty times as long
    #[arg(long)]
    diagnose: bool,
    #[command(flatten)]
    map: MapArguments,
    /// Print JSON: the sums of --out, else each row as a line of its own
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    let shown = progress::begin("analyse");
    let words = format!(
        "{:?} {:?} {}",
        arguments.map, arguments.scheme, arguments.diagnose
    );
    let model = arguments.model.as_deref();
    let sum = analyse(&AnalysisRequest {
        runs: &arguments.runs,
        model,
        scheme: arguments.scheme.as_deref(),
        diagnose: arguments.diagnose,
        out: arguments.out.as_deref(),
        form: if arguments.json {
            Form::JsonLines
        } else {
            Form::Csv
        },
        resume: arguments.resume,
        shard: arguments.shard,
        jobs: arguments.jobs,
        load: &|path| arguments.map.load(path),
        analysis: analysis_of(&words, model),
    })?;
    drop(shown);
    if arguments.out.is_some() {
        output::result(&sum, arguments.json, Analysed::text)?;
    }
    sum.failure().map_or(Ok(()), Err)
}
