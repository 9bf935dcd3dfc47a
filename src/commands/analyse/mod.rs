//! `analyse`: many runs as one table, a row each.
//!
//! Many runs, each analysed by itself, as one table: a row a run.
//!
//! ```text
//! RUNS -> inputs: sorted paths -> shard -> workers (a run each) -> rows in order -> stdout
//!                                              '- no further ahead than WINDOW -'-> table.rs: journal -> FILE
//! ```
//!
//! Of a run whose row is written its path and the place of its row are in memory, some 700 bytes; no worker runs further
//! ahead of the last written row than the window. Parquet is made of the whole table at the end.

mod inputs;
mod row;
mod table;

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use row::{Cell, Columns, Status};
use serde::Serialize;
use serde_json::{Map, Value};
use table::{Table, line_of};

use crate::commands::arguments::{MapArguments, shard};
use crate::runtime::failure::{Failure, REFUSED, USAGE};
use crate::runtime::files::read_model;
use crate::runtime::{output, progress, signals};
use drivebench_bench::recording::{ColumnKind, LoadedRun};
use drivebench_identify::scheme;
use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};
use drivebench_model::plant::{Model, Motor};

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
    let words = format!("{:?} {:?} {}", arguments.map, arguments.scheme, arguments.diagnose);
    let model = arguments.model.as_deref();
    let sum = analyse(&AnalysisRequest {
        runs: &arguments.runs,
        model,
        scheme: arguments.scheme.as_deref(),
        diagnose: arguments.diagnose,
        out: arguments.out.as_deref(),
        form: if arguments.json { Form::JsonLines } else { Form::Csv },
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

/// Rows that may wait for one before them, for each worker.
const WINDOW: usize = 8;

/// How rows are written where there is no file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    Csv,
    /// One JSON object a line.
    JsonLines,
}

/// What is asked of an analysis of many runs.
pub(crate) struct AnalysisRequest<'a> {
    /// Paths, folders of runs and patterns.
    pub(crate) runs: &'a [PathBuf],
    /// Without it the five-parameter baseline.
    pub(crate) model: Option<&'a Path>,
    pub(crate) scheme: Option<&'a str>,
    pub(crate) diagnose: bool,
    /// A CSV or Parquet file; without it standard output.
    pub(crate) out: Option<&'a Path>,
    pub(crate) form: Form,
    pub(crate) resume: bool,
    /// Part `0` of `1`, counted from 1.
    pub(crate) shard: Option<(u64, u64)>,
    /// Runs at once; without it one for each core.
    pub(crate) jobs: Option<NonZeroUsize>,
    /// How a run is read.
    pub(crate) load: &'a (dyn Fn(&Path) -> Result<LoadedRun, Failure> + Sync),
    /// All that a row depends on beside its run and the program's version, as a checksum.
    pub(crate) analysis: String,
}

/// How many runs came out how.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Analysed {
    pub(crate) runs: usize,
    pub(crate) ok: usize,
    pub(crate) not_identified: usize,
    pub(crate) unread: usize,
    /// Rows of an earlier time that are still true, among these.
    pub(crate) kept: usize,
    /// Rows of runs that were not named, of other options and of other versions, which are not in the table any more.
    pub(crate) left_out: usize,
    pub(crate) output: Option<String>,
}

impl Analysed {
    fn count(&mut self, status: Status) {
        *match status {
            Status::Ok => &mut self.ok,
            Status::NotIdentified => &mut self.not_identified,
            Status::Unread => &mut self.unread,
        } += 1;
    }

    /// The sums in one line.
    pub(crate) fn text(&self) -> String {
        let mut text = format!(
            "{}: {} runs, {} ok, {} not identified, {} unread",
            self.output.as_deref().unwrap_or_default(),
            self.runs,
            self.ok,
            self.not_identified,
            self.unread
        );
        for (count, what) in [
            (self.kept, "rows kept from before"),
            (self.left_out, "rows of other runs, options or versions left out"),
        ] {
            if count > 0 {
                let _ = write!(text, "; {count} {what}");
            }
        }
        text
    }

    /// The failure of runs that could not be read, if any.
    pub(crate) fn failure(&self) -> Option<Failure> {
        let (unread, runs) = (self.unread, self.runs);
        let status = if unread == runs { USAGE } else { REFUSED };
        let headline = format!("{unread} of {runs} runs could not be read");
        let help = "each says why in the column `reason` of its row";
        (unread > 0).then(|| Failure::with_help(status, headline, help))
    }
}

/// The checksum of what the rows depend on: words of the command line, and the model file's text.
pub(crate) fn analysis_of(words: &str, model: Option<&Path>) -> String {
    let text = model.and_then(|path| std::fs::read(path).ok()).unwrap_or_default();
    format!("{:016x}", fnv_1a(fnv_1a(EMPTY, words.bytes()), text))
}

/// Part `part` of `of` of the runs: a block, so that the tables of the parts behind each other are the table of the whole.
fn block<T>(mut runs: Vec<T>, (part, of): (u64, u64)) -> Vec<T> {
    let count = runs.len() as u128;
    let bound = |part: u64| {
        usize::try_from(u128::from(part) * count / u128::from(of)).unwrap_or(usize::MAX)
    };
    runs.truncate(bound(part));
    runs.split_off(bound(part - 1))
}

/// Analyses the runs; one that cannot be read is a row that says so.
pub(crate) fn analyse(request: &AnalysisRequest<'_>) -> Result<Analysed, Failure> {
    let model = match request.model {
        Some(path) => read_model(path)?.model,
        None => Model::baseline(Motor::new("fitted")),
    };
    if let Some(id) = request.scheme {
        scheme::find(id)?;
    }
    let columns = Columns::of(model);
    let mut runs = inputs::runs(request.runs)?;
    let mut named = HashSet::with_capacity(runs.len());
    for run in &runs {
        if !named.insert(row::name(run)) {
            let headline = format!("{}: two runs have this name in the table", row::name(run));
            let help = "rename one: a line break, and a letter that is none, are shown as another";
            return Err(Failure::usage(headline, help));
        }
    }
    if let Some(shard) = request.shard {
        runs = block(runs, shard);
    }
    let all = columns.all();
    let table = request
        .out
        .map(|path| Table::open(path, all.clone(), &request.analysis, request.resume, &named));
    drop(named);
    let sink = Sink { table: table.transpose()?, columns: all, form: request.form };
    if sink.table.is_none() && request.form == Form::Csv {
        let names: Vec<&str> = sink.columns.iter().map(|(name, _)| name.as_str()).collect();
        output::line(line_of(&names).trim_end())?;
    }
    let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let jobs = request.jobs.map_or_else(cores, NonZeroUsize::get);
    // Where somebody has asked before, the threads within a run are as they are; rows do not depend on them.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
    let window = WINDOW * jobs;
    progress::stage("analyses the runs", runs.len());
    let line = Mutex::new(Line {
        begun: 0,
        written: 0,
        waiting: BTreeMap::new(),
        ended: None,
        sink,
        sum: Analysed::default(),
    });
    let written = Condvar::new();
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(runs.len()) {
            scope.spawn(|| work(&runs, request, &columns, window, &line, &written));
        }
    });
    let line = line.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some(failure) = line.ended {
        return Err(failure);
    }
    let mut sum = Analysed { runs: runs.len(), ..line.sum };
    if let Some(table) = line.sink.table {
        sum.left_out = table.finish(&runs)?;
        sum.output = request.out.map(|path| path.display().to_string());
    }
    Ok(sum)
}

/// Where rows go.
struct Sink {
    table: Option<Table>,
    columns: Vec<(String, ColumnKind)>,
    form: Form,
}

impl Sink {
    fn put(&mut self, cells: &[Cell], status: Status) -> Result<(), Failure> {
        if let Some(table) = &mut self.table {
            return table.put(cells, status);
        }
        match self.form {
            Form::Csv => {
                let texts: Vec<String> = cells.iter().map(Cell::text).collect();
                output::line(line_of(&texts).trim_end())
            }
            Form::JsonLines => {
                let named = self
                    .columns
                    .iter()
                    .zip(cells)
                    .map(|((name, _), cell)| (name.clone(), cell.json()));
                output::line(&Value::Object(named.collect::<Map<_, _>>()).to_string())
            }
        }
    }
}

/// A row that waits for those before it.
enum Ready {
    New(Vec<Cell>, Status),
    /// It stands in the table already.
    Kept(Status),
}

/// Which runs are begun, which are written, and what waits between.
struct Line {
    begun: usize,
    written: usize,
    waiting: BTreeMap<usize, Ready>,
    ended: Option<Failure>,
    sink: Sink,
    sum: Analysed,
}

impl Line {
    /// Writes what is next in order, as far as it is there.
    fn write(&mut self) {
        while let Some(ready) = self.waiting.remove(&self.written) {
            let (status, put) = match ready {
                Ready::New(cells, status) => (status, self.sink.put(&cells, status)),
                Ready::Kept(status) => {
                    self.sum.kept += 1;
                    (status, Ok(()))
                }
            };
            if let Err(failure) = put {
                self.ended = self.ended.take().or(Some(failure));
                return;
            }
            self.sum.count(status);
            self.written += 1;
        }
        progress::at(self.written);
    }
}

fn work(
    runs: &[PathBuf],
    request: &AnalysisRequest<'_>,
    columns: &Columns,
    window: usize,
    line: &Mutex<Line>,
    written: &Condvar,
) {
    let lock = || -> MutexGuard<'_, Line> { line.lock().unwrap_or_else(PoisonError::into_inner) };
    loop {
        let mut next = lock();
        while next.begun >= next.written + window && next.ended.is_none() {
            next = written.wait(next).unwrap_or_else(PoisonError::into_inner);
        }
        let (index, is_over) = (next.begun, next.ended.is_some());
        let Some(run) = runs.get(index).filter(|_| !is_over) else {
            return;
        };
        next.begun += 1;
        drop(next);
        let content = row::content(run);
        let kept =
            lock().sink.table.as_ref().and_then(|table| table.kept(&row::name(run), &content));
        let ready = kept.map_or_else(
            || {
                let (cells, status) = row::row(run, &content, request, columns);
                Ready::New(cells, status)
            },
            Ready::Kept,
        );
        let mut line = lock();
        line.waiting.insert(index, ready);
        line.write();
        drop(line);
        written.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_behind_each_other_are_the_whole() {
        for (count, of) in [(0, 3), (1, 3), (10, 3), (3, 3), (7, 1)] {
            let whole: Vec<usize> = (0..count).collect();
            let parts = (1..=of).flat_map(|part| block(whole.clone(), (part, of)));
            assert_eq!(parts.collect::<Vec<_>>(), whole, "{count} in {of}");
        }
    }
}
