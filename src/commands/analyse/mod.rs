//! `analyse`: many runs, each analysed by itself, as one table: a row a run.
//!
//! ```text
//! RUNS -> inputs: sorted paths -> shard -> workers (a run each) -> rows in order -> stdout
//!                                              '- no further ahead than a window -'-> table.rs: journal -> FILE
//! ```
//!
//! Memory: some 700 bytes for each written row (path and offset); no worker runs further ahead of the last written row than
//! the window. Parquet is made of the whole table at the end.

mod inputs;
mod row;
mod table;

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use row::{Columns, Status, cell};
use serde::Serialize;
use serde_json::{Map, Value};
use table::{Table, header_of, line_of};

use crate::commands::arguments::{MapArguments, shard};
use crate::runtime::{Failure, REFUSED, Terminal, USAGE, read_model};
use drivebench_bench::recording::ColumnKind;
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
read is a row with the reason. After a kill at any time, --resume continues.
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
    /// Block I of N of the runs: the tables of all blocks, joined in order, are the table of all runs
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(u64, u64)>,
    /// Runs at once; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// Model file whose parameters are identified in every run; without it the five-parameter baseline
    #[arg(long, value_name = "MODEL.toml")]
    model: Option<PathBuf>,
    /// Method, one of the schemes that `identify --help` lists
    #[arg(long, value_name = "S")]
    scheme: Option<String>,
    /// Diagnose each run too: name its missing effects; takes some forty times as long
    #[arg(long)]
    diagnose: bool,
    #[command(flatten)]
    map: MapArguments,
    /// Print JSON: the counts with --out, else a line for each row
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let _endable = terminal.endable()?;
    let shown = terminal.progress("analyse");
    let sum = analyse(arguments, terminal)?;
    drop(shown);
    if arguments.out.is_some() {
        terminal.result(&sum, arguments.json, Analysed::text)?;
    }
    sum.failure().map_or(Ok(()), Err)
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
struct Analysed {
    runs: usize,
    ok: usize,
    not_identified: usize,
    unread: usize,
    /// Rows of an earlier analysis that are still valid, among these.
    kept: usize,
    /// Rows of runs that were not named, of other options and of other versions, which are not in the table any more.
    left_out: usize,
    output: Option<String>,
}

impl Analysed {
    fn count(&mut self, status: Status) {
        *match status {
            Status::Ok => &mut self.ok,
            Status::NotIdentified => &mut self.not_identified,
            Status::Unread => &mut self.unread,
        } += 1;
    }

    fn text(&self) -> String {
        let mut text = format!(
            "{}: {} runs, {} ok, {} not identified, {} unread",
            self.output.as_deref().unwrap_or_default(),
            self.runs,
            self.ok,
            self.not_identified,
            self.unread
        );
        for (count, what) in [
            (self.kept, "rows kept from an earlier analysis"),
            (self.left_out, "rows of other runs, options or versions left out"),
        ] {
            if count > 0 {
                let _ = write!(text, "; {count} {what}");
            }
        }
        text
    }

    /// The failure of runs that could not be read, if any.
    fn failure(&self) -> Option<Failure> {
        let (unread, runs) = (self.unread, self.runs);
        let status = if unread == runs { USAGE } else { REFUSED };
        let headline = format!("{unread} of {runs} runs could not be read");
        let help = "the column `reason` of each row has why";
        (unread > 0).then(|| Failure::with_help(status, headline, help))
    }
}

/// The checksum of all that a row depends on besides its run and the program's version: options, and the model file's text.
fn checksum_of(arguments: &Arguments) -> String {
    let options = format!("{:?} {:?} {}", arguments.map, arguments.scheme, arguments.diagnose);
    let model = arguments.model.as_ref().and_then(|path| std::fs::read(path).ok());
    format!("{:016x}", fnv_1a(fnv_1a(EMPTY, options.bytes()), model.unwrap_or_default()))
}

/// Block `part` of `of`: the tables of all blocks, joined in order, are the table of all runs.
fn block<T>(mut runs: Vec<T>, (part, of): (u64, u64)) -> Vec<T> {
    let count = runs.len() as u128;
    let bound = |part: u64| {
        usize::try_from(u128::from(part) * count / u128::from(of)).unwrap_or(usize::MAX)
    };
    runs.truncate(bound(part));
    runs.split_off(bound(part - 1))
}

/// Analyses the runs; one that cannot be read is a row that gives the reason.
fn analyse(arguments: &Arguments, terminal: &Terminal) -> Result<Analysed, Failure> {
    let model = match &arguments.model {
        Some(path) => read_model(path)?.model,
        None => Model::baseline(Motor::new("fitted")),
    };
    if let Some(id) = &arguments.scheme {
        scheme::find(id)?;
    }
    let columns = Columns::of(model);
    let mut runs = inputs::runs(&arguments.runs)?;
    let mut named = HashSet::with_capacity(runs.len());
    for run in &runs {
        if !named.insert(row::name(run)) {
            let headline = format!("{}: two runs have this name in the table", row::name(run));
            let help = "rename one: line breaks and invalid characters are replaced in the table";
            return Err(Failure::usage(headline, help));
        }
    }
    if let Some(shard) = arguments.shard {
        runs = block(runs, shard);
    }
    let checksum = checksum_of(arguments);
    let all = columns.all();
    let table = arguments
        .out
        .as_deref()
        .map(|path| Table::open(path, all.clone(), &checksum, arguments.resume, &named, terminal));
    drop(named);
    let sink = Sink { table: table.transpose()?, columns: all, is_json: arguments.json, terminal };
    if sink.table.is_none() && !sink.is_json {
        terminal.line(header_of(&sink.columns).trim_end())?;
    }
    let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let jobs = arguments.jobs.map_or_else(cores, NonZeroUsize::get);
    // A pool that exists already is kept; rows do not depend on it.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
    terminal.stage("analyses the runs", runs.len());
    let analysis = Analysis {
        arguments,
        checksum,
        columns,
        runs,
        // Rows that may wait for one before them.
        window: 8 * jobs,
        order: Mutex::new(Order {
            begun: 0,
            written: 0,
            waiting: BTreeMap::new(),
            failure: None,
            sink,
            sum: Analysed::default(),
        }),
        written: Condvar::new(),
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(analysis.runs.len()) {
            scope.spawn(|| analysis.work());
        }
    });
    let Analysis { runs, order, .. } = analysis;
    let order = order.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some(failure) = order.failure {
        return Err(failure);
    }
    let mut sum = Analysed { runs: runs.len(), ..order.sum };
    if let Some(table) = order.sink.table {
        sum.left_out = table.finish(&runs)?;
        sum.output = arguments.out.as_ref().map(|path| path.display().to_string());
    }
    Ok(sum)
}

struct Sink<'a> {
    table: Option<Table>,
    columns: Vec<(String, ColumnKind)>,
    /// Without a table: one JSON object a line, and not CSV.
    is_json: bool,
    terminal: &'a Terminal,
}

impl Sink<'_> {
    fn put(&mut self, row: &[Value], status: Status) -> Result<(), Failure> {
        if let Some(table) = &mut self.table {
            return table.put(row, status);
        }
        if !self.is_json {
            let texts: Vec<String> = row.iter().map(cell).collect();
            return self.terminal.line(line_of(&texts).trim_end());
        }
        let names = self.columns.iter().map(|(name, _)| name.clone());
        let row: Map<_, _> = names.zip(row.iter().cloned()).collect();
        self.terminal.line(&Value::Object(row).to_string())
    }
}

/// Which runs are begun, which are written, and what waits between.
struct Order<'a> {
    begun: usize,
    written: usize,
    /// Rows that wait for those before them; without cells where the table has them already.
    waiting: BTreeMap<usize, (Option<Vec<Value>>, Status)>,
    failure: Option<Failure>,
    sink: Sink<'a>,
    sum: Analysed,
}

impl Order<'_> {
    /// Writes the rows that are next in order, as far as they are ready.
    fn write(&mut self) {
        while let Some((cells, status)) = self.waiting.remove(&self.written) {
            match cells.map(|cells| self.sink.put(&cells, status)) {
                Some(Ok(())) => {}
                Some(Err(failure)) => {
                    self.failure.get_or_insert(failure);
                    return;
                }
                None => self.sum.kept += 1,
            }
            self.sum.count(status);
            self.written += 1;
        }
        self.sink.terminal.at(self.written);
    }
}

/// What the workers share.
struct Analysis<'a> {
    arguments: &'a Arguments,
    /// By [`checksum_of`].
    checksum: String,
    columns: Columns,
    runs: Vec<PathBuf>,
    window: usize,
    order: Mutex<Order<'a>>,
    written: Condvar,
}

impl<'a> Analysis<'a> {
    fn order(&self) -> MutexGuard<'_, Order<'a>> {
        self.order.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Analyses one run after the other until none is left, or a row cannot be written.
    fn work(&self) {
        loop {
            let mut order = self.order();
            while order.begun >= order.written + self.window && order.failure.is_none() {
                order = self.written.wait(order).unwrap_or_else(PoisonError::into_inner);
            }
            let (index, is_over) = (order.begun, order.failure.is_some());
            let Some(run) = self.runs.get(index).filter(|_| !is_over) else {
                return;
            };
            order.begun += 1;
            drop(order);
            let content = row::content(run);
            let kept = {
                let table = &self.order().sink.table;
                table.as_ref().and_then(|table| table.kept(&row::name(run), &content))
            };
            let ready = if let Some(status) = kept {
                (None, status)
            } else {
                let (cells, status) = row::row(run, &content, self);
                (Some(cells), status)
            };
            let mut order = self.order();
            order.waiting.insert(index, ready);
            order.write();
            drop(order);
            self.written.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_in_order_are_the_whole() {
        for (count, of) in [(0, 3), (1, 3), (10, 3), (3, 3), (7, 1)] {
            let whole: Vec<usize> = (0..count).collect();
            let parts = (1..=of).flat_map(|part| block(whole.clone(), (part, of)));
            assert_eq!(parts.collect::<Vec<_>>(), whole, "{count} in {of}");
        }
    }
}
