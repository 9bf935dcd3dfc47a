//! The table of an analysis as a file: rows are appended to a journal as they are found, and put in order at the end.
//!
//! ```text
//! rows -> FILE.part (append only, one write a row) -- all there --> sorted by run -> FILE.new -> FILE
//!              '-- killed --> --resume: rows of FILE.part and FILE that are still true are kept
//! ```
//!
//! Only the position of each row is in memory. Rows of another program, other columns or other options are not overwritten.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{BufRead, BufReader, BufWriter, Read, Seek as _, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::row::{self, Status, cell};
use crate::runtime::{Failure, Terminal, output, parquet, require_parquet};
use drivebench_bench::recording::ColumnKind;

/// Position of a row in its file, and checksum of its run.
#[derive(Clone, Debug)]
struct RowLocation {
    /// Number of the file.
    source: usize,
    offset: u64,
    length: usize,
    status: Status,
    content: String,
}

/// The table as it grows.
pub(super) struct Table {
    path: PathBuf,
    columns: Vec<(String, ColumnKind)>,
    journal: File,
    /// End of the journal.
    end: u64,
    /// The journal, and the table of an earlier analysis.
    sources: Vec<File>,
    rows: HashMap<String, RowLocation>,
    /// Rows of other options or versions, of runs that are analysed anew.
    replaced: usize,
    terminal: Terminal,
}

impl Table {
    /// Opens the journal of the table at `path`. With `resume` earlier rows of the same `analysis` are kept;
    /// those of another have to be of runs that are `named` now.
    pub(super) fn open(
        path: &Path,
        columns: Vec<(String, ColumnKind)>,
        analysis: &str,
        resume: bool,
        named: &HashSet<String>,
        terminal: &Terminal,
    ) -> Result<Self, Failure> {
        let is_parquet = is_parquet(path)?;
        let part = with_suffix(path, "part");
        if !resume {
            output::refuse_existing([path], "--out")?;
            if part.exists() {
                return Err(Failure::usage(
                    format!("{}: rows of an unfinished analysis", part.display()),
                    "continue it with --resume, or move the file away",
                ));
            }
        }
        if is_parquet && path.exists() {
            let headline = format!("{}: a Parquet file cannot be continued", path.display());
            let help =
                "write the table as CSV, which can: DuckDB, Polars and pandas read it as well";
            return Err(Failure::usage(headline, help));
        }
        let header = header_of(&columns);
        if resume {
            refuse_other(path, &header, false)?;
            refuse_other(&part, &header, true)?;
        }
        let cannot = |error: std::io::Error| output::cannot_write(&part, &error);
        let mut options = OpenOptions::new();
        let mut journal =
            options.read(true).append(true).create(true).open(&part).map_err(cannot)?;
        if let Err(TryLockError::WouldBlock) = journal.try_lock() {
            return Err(Failure::usage(
                format!("{}: another analysis writes it", part.display()),
                "wait for its end, or give another name to --out",
            ));
        }
        let mut known = EarlierRows { analysis, rows: HashMap::new(), others: Vec::new() };
        let mut sources = vec![journal.try_clone().map_err(cannot)?];
        if resume && path.exists() {
            let mut table = File::open(path).map_err(|error| output::cannot_read(path, &error))?;
            known.read(&mut table, 1, &header).map_err(cannot)?;
            sources.push(table);
        }
        // A row that was incomplete when the program was killed is cut.
        let end = known.read(&mut journal, 0, &header).map_err(cannot)?;
        let lost = known.others.iter().flatten().filter(|run| !named.contains(*run)).count();
        if lost > 0 {
            if end == 0 {
                let _ = fs::remove_file(&part);
            }
            let headline = format!(
                "{}: {lost} rows of other options or versions, of runs that are not named now, would be lost",
                path.display()
            );
            let help = "name those runs too, or give another name to --out";
            return Err(Failure::usage(headline, help));
        }
        journal.set_len(end).map_err(cannot)?;
        let mut table = Self {
            path: path.to_owned(),
            columns,
            journal,
            end,
            sources,
            rows: known.rows,
            replaced: known.others.len(),
            terminal: terminal.clone(),
        };
        if table.end == 0 {
            table.append(&header)?;
        }
        Ok(table)
    }

    /// Status of the kept row of a run whose content has not changed.
    pub(super) fn kept(&self, run: &str, content: &str) -> Option<Status> {
        let place = self.rows.get(run)?;
        (place.content == content).then_some(place.status)
    }

    pub(super) fn put(&mut self, row: &[Value], status: Status) -> Result<(), Failure> {
        let texts: Vec<String> = row.iter().map(cell).collect();
        let line = line_of(&texts);
        let place = RowLocation {
            source: 0,
            offset: self.end,
            length: line.len(),
            status,
            content: texts.last().cloned().unwrap_or_default(),
        };
        self.append(&line)?;
        self.rows.insert(texts[0].clone(), place);
        Ok(())
    }

    fn append(&mut self, line: &str) -> Result<(), Failure> {
        let _whole = self.terminal.writing();
        self.journal
            .write_all(line.as_bytes())
            .map_err(|error| output::cannot_write(&with_suffix(&self.path, "part"), &error))?;
        self.end += line.len() as u64;
        Ok(())
    }

    /// Replaces the table atomically with the rows of these runs in this order, and removes the journal. Returns the number of
    /// rows of other runs, options and versions, which are left out.
    pub(super) fn finish(mut self, runs: &[PathBuf]) -> Result<usize, Failure> {
        let new = with_suffix(&self.path, "new");
        let path = self.path.clone();
        let terminal = self.terminal.clone();
        let cannot = |error: std::io::Error| output::cannot_write(&path, &error);
        let _whole = terminal.writing();
        self.assemble(&new, runs).map_err(cannot)?;
        if is_parquet(&self.path)? {
            let kinds: HashMap<&str, ColumnKind> =
                self.columns.iter().map(|(name, kind)| (name.as_str(), *kind)).collect();
            let kind = |name: &str| kinds.get(name).copied().unwrap_or(ColumnKind::Word);
            let csv = File::open(&new).map_err(cannot)?;
            let columns = parquet(BufReader::new(csv), kind).map_err(Failure::internal)?;
            fs::write(&new, columns).map_err(cannot)?;
        }
        File::open(&new).and_then(|file| file.sync_all()).map_err(cannot)?;
        fs::rename(&new, &self.path).map_err(cannot)?;
        fs::remove_file(with_suffix(&self.path, "part")).map_err(cannot)?;
        Ok(self.replaced + self.rows.len().saturating_sub(runs.len()))
    }

    fn assemble(&mut self, new: &Path, runs: &[PathBuf]) -> std::io::Result<()> {
        let mut out = BufWriter::new(File::create(new)?);
        out.write_all(header_of(&self.columns).as_bytes())?;
        let mut line = Vec::new();
        for run in runs {
            let place = self.rows.get(&row::name(run));
            let none = || std::io::Error::other(format!("no row of {}", run.display()));
            let place = place.ok_or_else(none)?;
            let source = &mut self.sources[place.source];
            source.seek(SeekFrom::Start(place.offset))?;
            line.resize(place.length, 0);
            source.read_exact(&mut line)?;
            out.write_all(&line)?;
        }
        out.flush()
    }
}

/// Whether the name is that of Parquet; any other has to be of CSV.
fn is_parquet(path: &Path) -> Result<bool, Failure> {
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("csv") => Ok(false),
        Some("parquet") => require_parquet().map(|()| true),
        _ => {
            let headline = format!("--out {}: its format is not known", path.display());
            Err(Failure::usage(headline, "allowed: a name that ends with .csv or .parquet"))
        }
    }
}

fn with_suffix(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

pub(super) fn header_of(columns: &[(String, ColumnKind)]) -> String {
    line_of(&columns.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>())
}

/// One line of a CSV.
pub(super) fn line_of<T: AsRef<[u8]>>(cells: &[T]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Cannot fail: it writes to memory, and there is no row before it whose length could differ.
    let _ = writer.write_record(cells);
    let bytes = writer.into_inner().unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Refuses a file whose columns are not exactly those of this table. A journal may end within its header, where the program
/// was killed.
fn refuse_other(path: &Path, header: &str, may_be_cut: bool) -> Result<(), Failure> {
    if !path.exists() {
        return Ok(());
    }
    let mut first = Vec::new();
    let read = File::open(path).and_then(|file| {
        let mut start = BufReader::new(file).take(header.len() as u64);
        start.read_until(b'\n', &mut first)
    });
    read.map_err(|error| output::cannot_read(path, &error))?;
    let is_ours = first == header.as_bytes();
    if is_ours || may_be_cut && header.as_bytes().starts_with(&first) {
        return Ok(());
    }
    let headline = format!("{}: not a table of this analysis: its columns differ", path.display());
    let help = "another --model or another version has other columns; give another name to --out";
    Err(Failure::usage(headline, help))
}

struct EarlierRows<'a> {
    analysis: &'a str,
    rows: HashMap<String, RowLocation>,
    /// The runs of rows that are of another analysis; `None` where a row names none.
    others: Vec<Option<String>>,
}

impl EarlierRows<'_> {
    /// Takes over the rows of a file; returns the end of its last whole row.
    fn read(&mut self, file: &mut File, source: usize, header: &str) -> std::io::Result<u64> {
        file.rewind()?;
        let mut lines = BufReader::new(&*file);
        let mut line = Vec::new();
        let (mut offset, mut is_first) = (0, true);
        loop {
            line.clear();
            let length = lines.read_until(b'\n', &mut line)?;
            if line.last() != Some(&b'\n') || (is_first && line != header.as_bytes()) {
                return Ok(offset);
            }
            if !std::mem::take(&mut is_first) {
                let mut record = csv::StringRecord::new();
                let mut reader =
                    csv::ReaderBuilder::new().has_headers(false).from_reader(&line[..]);
                let is_read = reader.read_record(&mut record).unwrap_or(false);
                let taken = is_read.then(|| self.take(&record, (source, offset, length)));
                if taken.is_none_or(|taken| taken.is_none()) {
                    self.others.push(record.get(0).map(str::to_owned));
                }
            }
            offset += length as u64;
        }
    }

    /// Takes over a row of this analysis: run and status stand first, program, analysis and content last.
    fn take(
        &mut self,
        record: &csv::StringRecord,
        (source, offset, length): (usize, u64, usize),
    ) -> Option<()> {
        let from_end = |back: usize| record.len().checked_sub(back).and_then(|at| record.get(at));
        let status = Status::named(record.get(1)?)?;
        let is_own = from_end(3)? == env!("CARGO_PKG_VERSION") && from_end(2)? == self.analysis;
        let place = is_own.then(|| RowLocation {
            source,
            offset,
            length,
            status,
            content: from_end(1).unwrap_or_default().to_owned(),
        })?;
        self.rows.insert(record.get(0)?.to_owned(), place);
        Some(())
    }
}
