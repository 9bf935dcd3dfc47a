//! Runs, models and texts from files, and the files that commands write: models with their history, and the record of a
//! run: its files, what ended it early, and what could not be kept of it.

use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::report::wording::{record, sanity as words, times};
use crate::report::{EarlyEnd, Tone};
use crate::runtime::failure::{Failure, INTERNAL, INTERRUPTED, LINK, TRIP, USAGE};
use crate::runtime::output::{self, Terminal};
use drivebench_bench::recording::{
    self, ColumnKind, Kept, KeptLogs, LATEST, LoadedRun, Manifest, ReadOptions, RecordingError,
    RunFile, RunFolder, open_run, run_from_memory, write_run,
};
use drivebench_bench::{BenchFile, OnlineResult, Outcome, RunSummary};
use drivebench_diagnose::{Fitted, Rung};
use drivebench_identify::noise::FloorSource;
use drivebench_identify::{sanity, speed_from_angle, speed_lag, temperature};
use drivebench_model::numerics::statistics::median;
use drivebench_model::plant::{FileHistory, FittedValue, ModelFile, MotorKey, Scenario, effect};
use drivebench_model::sample::{Channel, ParameterEstimate, Run, Sensors, SpeedLag};

/// Opens a run, prints its warnings, and derives the speed from the angle where there is none.
pub(crate) fn load(
    path: &Path,
    options: ReadOptions<'_>,
    terminal: &Terminal,
) -> Result<LoadedRun, Failure> {
    complete(open_run(path, options)?, terminal)
}

/// Marks values that cannot be measurements as missing, derives the speed from the angle where there is none, and prints the
/// warnings of a run. A recorded run folder is not changed: its recorder leaves missing values empty.
pub(crate) fn complete(mut loaded: LoadedRun, terminal: &Terminal) -> Result<LoadedRun, Failure> {
    let before = loaded.run.notes.len();
    if loaded.manifest.is_none() {
        for masked in sanity::mask(&mut loaded.run) {
            let reason = words::masked(&masked);
            loaded.run.notes.push(format!("{}: {reason}", loaded.run.name));
        }
    }
    loaded.run = speed_from_angle::complete(&loaded.run)
        .map_err(|error| Failure::new(USAGE, error.to_string()))?;
    loaded.warnings.extend_from_slice(&loaded.run.notes[before..]);
    if let Some(dialect) = &loaded.dialect {
        terminal.message(dialect);
    }
    terminal.warn(&loaded.warnings);
    if let Some(manifest) = loaded.manifest.as_ref().filter(|own| !own.carried.is_empty()) {
        let known = known_sensors(&loaded.run, manifest);
        loaded.run = known.0;
        let name = loaded.run.name.clone();
        loaded.run.notes.extend(known.1.into_iter().map(|text| format!("{name}: {text}")));
    }
    Ok(loaded)
}

/// A run of a drive with a profile, with what is known of its sensors and its ramp, and sentences on it: measured against the angle,
/// else stated by the profile and supported by the record.
fn known_sensors(run: &Run, manifest: &Manifest) -> (Run, Vec<String>) {
    let mut texts = Vec::new();
    let mut run = run.clone();
    let averages_current = manifest.averages_current;
    let found = speed_lag::by_angle(&run);
    let stated = SpeedLag { delay_s: 0.0, filter_s: manifest.speed_filter_s.unwrap_or(0.0) };
    let speed = found.map_or(stated, |found| found.lag);
    run.set_sensors(Sensors { speed, averages_current, ..Sensors::default() });
    if speed.total_s() > 0.0 {
        let without = Sensors { averages_current, ..Sensors::default() };
        if found.is_none() && speed_lag::is_supported(&run, without) == Some(false) {
            texts.push(record::no_speed_lag(speed));
            run.set_sensors(without);
        } else {
            texts.push(record::speed_lag(speed, found.as_ref()));
        }
    }
    let supply_v: Vec<f64> = run.points(Channel::Bus).map(|point| point.1).collect();
    if let (Some(ramp_per_s), false) = (manifest.duty_ramp_per_s, supply_v.is_empty()) {
        let without = run.sensors();
        let ramp_v_per_s = ramp_per_s * median(&supply_v);
        run.set_sensors(Sensors { ramp_v_per_s, ..without });
        let is_supported = speed_lag::is_supported(&run, without) != Some(false);
        if !is_supported {
            run.set_sensors(without);
        }
        texts.push(record::ramp(ramp_v_per_s, is_supported));
    }
    (run, texts)
}

pub(crate) fn read_model(path: &Path) -> Result<ModelFile, Failure> {
    Ok(ModelFile::parse(&path.display().to_string(), &read_text(path)?)?)
}

/// The command of a speed loop with this model; with a bench file where its runs are not of the embedded bench.
pub(crate) fn speed_command(history: &FileHistory, model: &Path, options: &str) -> String {
    let is_another = history.is_of_another_bench(&BenchFile::embedded_default().name);
    let bench = if is_another { " BENCH.toml" } else { "" };
    let model = output::quoted(model);
    format!("drivebench speed{bench} --model {model}{options}")
}

pub(crate) fn read_text(path: &Path) -> Result<String, Failure> {
    let cannot = |error| format!("{}: cannot read: {error}", path.display());
    recording::read_text(path).map_err(|error| Failure::usage(cannot(error), read_help(path)))
}

/// The names in a folder, sorted; of an empty path those in the present folder.
pub(crate) fn names_in(folder: &Path) -> Vec<String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Help for a path that cannot be read as a text file.
fn read_help(path: &Path) -> String {
    let model = RunFolder::existing(path).file(RunFile::Model);
    if model.is_file() {
        format!("this is a run; its model is {}", model.display())
    } else if path.is_dir() {
        "this is a folder; give a file in it".to_owned()
    } else {
        "check the path".to_owned()
    }
}

/// The estimates of a JSON object of parameters, as in `identify --json` and `result.json`.
pub(crate) fn estimates(parameters: &Value) -> Vec<ParameterEstimate> {
    let read = |(key, row): (&String, &Value)| {
        let unit = match MotorKey::from_key(key) {
            Some(key) => key.unit(),
            None if key == temperature::KEY => MotorKey::Resistance.unit(),
            None => unit_of_effect(key).unwrap_or_default(),
        };
        Some(ParameterEstimate {
            key: key.clone(),
            value: row["value"].as_f64(),
            std: row["std"].as_f64(),
            unit,
            verdict: serde_json::from_value(row["verdict"].clone()).ok()?,
            reason: row["reason"].as_str().map(str::to_owned),
            code: None,
        })
    };
    parameters.as_object().into_iter().flatten().filter_map(read).collect()
}

fn unit_of_effect(key: &str) -> Option<&'static str> {
    let (id, key) = key.split_once('.')?;
    effect::find(id)?.parameters().iter().find(|spec| spec.key == key).map(|spec| spec.unit)
}

/// The model of a fit as a file: what it was fitted on, and its rungs after those of the model before it.
pub(crate) fn model_file(
    fit: &Fitted,
    before: &FileHistory,
    fitted_on: Option<String>,
    ladder: &[Rung],
    floor: FloorSource,
) -> ModelFile {
    let mut history = FileHistory {
        fitted_on: fitted_on.into_iter().collect(),
        fitted: FittedValue::all(&fit.parameters),
        ..before.clone()
    };
    for rung in ladder.iter().map(|rung| rung_text(rung, floor)) {
        if history.ladder.last() != Some(&rung) {
            history.ladder.push(rung);
        }
    }
    ModelFile { model: fit.model.clone(), history }
}

/// One line of a model file's ladder.
fn rung_text(rung: &Rung, floor: FloorSource) -> String {
    let effects = match rung.effects.as_slice() {
        [] => "baseline".to_owned(),
        effects => effects.join(" + "),
    };
    let (error, times) = (rung.holdout_rmse, times(floor));
    format!("{effects}: held-out error {error:.2} {times}")
}

/// A run that was recorded, to its end or not.
pub(crate) struct Recorded {
    pub folder: RunFolder,
    pub summary: RunSummary,
    /// The result of the on-line estimators, with which `replay` compares its own.
    pub(crate) online: OnlineResult,
    pub(crate) manifest: Manifest,
    /// File of the burst that the drive recorded.
    capture: Option<PathBuf>,
    /// `None` when the rows are not needed any more.
    logs: Option<KeptLogs>,
    /// Why the record on the disk is incomplete.
    incomplete: Option<String>,
    /// The folder to which samples and events were saved then.
    rescued: Option<String>,
    terminal: Terminal,
}

/// `result.json`: the result of a command, and that of the on-line estimators.
#[derive(Serialize)]
struct KeptResult<'a, T> {
    #[serde(flatten)]
    result: &'a T,
    online: &'a OnlineResult,
}

/// Folder and summary, as a part of the result of a command.
impl Serialize for Recorded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Part<'a> {
            folder: String,
            #[serde(flatten)]
            summary: &'a RunSummary,
        }
        let folder = self.folder.path().display().to_string();
        Part { folder, summary: &self.summary }.serialize(serializer)
    }
}

impl Recorded {
    pub(crate) fn new(
        kept: Kept,
        manifest: Manifest,
        summary: RunSummary,
        online: OnlineResult,
        terminal: Terminal,
    ) -> Self {
        let mut recorded = Self {
            folder: kept.folder,
            summary,
            online,
            manifest,
            capture: None,
            logs: Some(kept.logs),
            incomplete: None,
            rescued: None,
            terminal,
        };
        if let Some(error) = &kept.error {
            recorded.note(&error.to_string());
            recorded.rescue();
        }
        recorded.link_latest();
        recorded
    }

    /// Writes the record to the folder for temporary files, which is often on another disk.
    fn rescue(&mut self) {
        let logs = self.logs.as_ref();
        let other = std::env::temp_dir();
        let rescued = logs.and_then(|logs| logs.rescue(&self.folder, &other, &self.manifest));
        self.terminal.message(&match rescued {
            Some(Ok(folder)) => {
                let folder = folder.path().display().to_string();
                let text = format!("samples and events are in {folder}");
                self.rescued = Some(folder);
                text
            }
            Some(Err(error)) => format!("the copy to another folder failed too: {error}"),
            None => "the record in memory is incomplete too: the missing rows are lost".to_owned(),
        });
    }

    /// Links `latest` to the newest run.
    fn link_latest(&self) {
        if !self.folder.path().is_dir() {
            return;
        }
        if let Err(error) = self.folder.link_latest() {
            let folder = self.folder.path().display();
            self.terminal.message_once(LATEST, &format!("no link `{LATEST}` to {folder}: {error}"));
        }
    }

    /// The run read back from the disk; where that record is damaged or deleted, from the file that is still open and from
    /// memory.
    pub(crate) fn load(&self) -> Result<LoadedRun, Failure> {
        let path = self.folder.path();
        let from_disk = match &self.incomplete {
            None => load(path, ReadOptions::default(), &self.terminal),
            Some(reason) => Err(Failure::internal(reason.clone())),
        };
        from_disk.or_else(|failure| {
            let Some(samples) = self.logs.as_ref().and_then(KeptLogs::samples) else {
                return Err(failure);
            };
            let (folder, reason) = (path.display(), failure.headline());
            self.terminal.message(&format!("{folder}: {reason}; what was recorded is used"));
            complete(run_from_memory(path, &samples, &self.manifest)?, &self.terminal)
        })
    }

    /// The burst as it is kept on the disk, with its path.
    pub(crate) fn burst(&self) -> Option<(&Path, Result<Scenario, Failure>)> {
        let path = self.capture.as_deref()?;
        let burst = load(path, ReadOptions::default(), &self.terminal)
            .and_then(|loaded| Ok(Scenario::from_run(&loaded.run)?));
        Some((path, burst))
    }

    /// The rows are not needed any more.
    pub(crate) fn forget(&mut self) {
        self.logs = None;
    }

    /// Writes `result.json`; a failure is reported and does not end the command.
    pub(crate) fn write_result<T: Serialize>(&mut self, result: &T) {
        let kept = KeptResult { result, online: &self.online };
        match serde_json::to_string_pretty(&kept) {
            Ok(text) => drop(self.write(RunFile::Result, &text)),
            Err(error) => self.note(&format!("the result has no JSON form: {error}")),
        }
    }

    /// Writes one file of the folder; a failure is reported and does not end the command.
    pub(crate) fn write(
        &mut self,
        file: RunFile,
        content: &(impl AsRef<[u8]> + ?Sized),
    ) -> Option<PathBuf> {
        self.kept(self.folder.write(file, content))
    }

    /// Writes the burst that the drive recorded to the run folder, as a run for every command.
    pub(crate) fn keep_capture(&mut self, name: &str) {
        let Some(capture) = &self.summary.capture else {
            return;
        };
        let run = match capture.run(name) {
            Ok(run) => run,
            Err(error) => return self.terminal.message(&format!("burst not used: {error}")),
        };
        let (rows, rate_hz) = (run.rows(), 1.0 / capture.period_s);
        self.capture = self.kept(self.folder.write_capture(&write_run(&run)));
        if let Some(path) = &self.capture {
            let path = path.display();
            self.terminal
                .message(&format!("burst capture: {rows} samples at {rate_hz:.0} Hz in {path}"));
        }
    }

    pub(crate) fn keep_parquet(&mut self) {
        let recorded = self.logs.as_ref().and_then(KeptLogs::samples);
        let columns = recorded
            .map_or_else(|| std::fs::read(self.folder.samples()), Ok)
            .map_err(|error| error.to_string())
            .and_then(|table| samples_as_parquet(&table));
        match columns {
            Ok(columns) => drop(self.write(RunFile::Parquet, &columns)),
            Err(error) => self.note(&format!("no {}: {error}", RunFile::Parquet.name())),
        }
    }

    fn kept(&mut self, written: Result<PathBuf, RecordingError>) -> Option<PathBuf> {
        written.map_err(|error| self.note(&error.to_string())).ok()
    }

    /// Reports and keeps the first reason.
    fn note(&mut self, reason: &str) {
        if self.incomplete.is_none() {
            self.terminal.message(&format!("warning: the record is incomplete: {reason}"));
            self.incomplete = Some(reason.to_owned());
        }
    }

    /// The failure of a record that could not be kept, for a command whose result is printed.
    pub(crate) fn record_failure(&self) -> Option<Failure> {
        let reason = self.incomplete.as_ref()?;
        let folder = self.folder.path().display();
        let headline = format!("the record could not be kept: {reason}");
        let help = match &self.rescued {
            Some(rescued) => {
                format!("the result is printed, and samples and events are in {rescued}")
            }
            None => format!(
                "the result is computed from memory and printed; check {folder}, free disk space, and repeat the run"
            ),
        };
        Some(Failure::with_help(INTERNAL, headline, help))
    }

    /// The failure that ended the run early, else that of its record, if any.
    pub(crate) fn failure(&self) -> Option<Failure> {
        self.run_failure().or_else(|| self.record_failure())
    }

    /// The failure that ended the run early, if any.
    pub(crate) fn run_failure(&self) -> Option<Failure> {
        let mut kept = match &self.incomplete {
            None => format!("the record is kept in {}", self.folder.path().display()),
            Some(reason) => format!("the record could not be kept: {reason}"),
        };
        if let Some(reopened) = &self.summary.reopened {
            kept = format!("{}; {kept}", reopened.text);
        }
        let summary = &self.summary;
        let (status, headline, _) = early_end(&summary.outcome, summary.stop_error.as_deref())?;
        Some(Failure::with_help(status, headline, kept))
    }
}

/// Exit status, headline and lead of the page of a run that was not completed, or whose drive did not confirm its stop.
pub(crate) fn early_end(
    outcome: &Outcome,
    stop_error: Option<&str>,
) -> Option<(u8, String, EarlyEnd)> {
    let unstopped = stop_error.map(|error| format!("the last stop was not confirmed: {error}"));
    let by_hand = "it was ended by hand";
    let (status, tone, title, reason) = match outcome {
        Outcome::Done if unstopped.is_none() => return None,
        Outcome::Done => (LINK, Tone::Bad, "Stop not confirmed", "the sequence was completed"),
        Outcome::Stopped => (INTERRUPTED, Tone::Attention, "Stopped", by_hand),
        Outcome::Interrupted => (INTERRUPTED, Tone::Attention, "Interrupted", by_hand),
        Outcome::Tripped(trip) => (TRIP, Tone::Bad, "Safety trip", trip.reason.as_str()),
        Outcome::LinkLost { reason } => (LINK, Tone::Bad, "Link lost", reason.as_str()),
        Outcome::NotStarted { reason } => (LINK, Tone::Attention, "Not started", reason.as_str()),
    };
    let headline = || format!("{}: {reason}", title.to_lowercase());
    let (status, headline) = match (outcome, &unstopped) {
        // Who ended the run must not believe that the motor has stopped.
        (Outcome::Done | Outcome::Stopped | Outcome::Interrupted, Some(unstopped)) => {
            (LINK, unstopped.clone())
        }
        (Outcome::Stopped | Outcome::Interrupted, None) => {
            (status, "stopped before the end of the sequence".to_owned())
        }
        (Outcome::Tripped(_), Some(unstopped)) => (status, format!("{}; {unstopped}", headline())),
        _ => (status, headline()),
    };
    let page = EarlyEnd {
        tone: if unstopped.is_some() { Tone::Bad } else { tone },
        title,
        reason: unstopped.map_or_else(|| reason.to_owned(), |why| format!("{reason}; {why}")),
    };
    Some((status, headline, page))
}

pub(crate) fn samples_as_parquet(table: &[u8]) -> Result<Vec<u8>, String> {
    parquet(table, ColumnKind::of_samples)
}

#[cfg(feature = "parquet")]
pub(crate) fn parquet(
    table: impl std::io::Read,
    kind: impl Fn(&str) -> ColumnKind,
) -> Result<Vec<u8>, String> {
    drivebench_bench::recording::parquet(table, kind).map_err(|error| error.to_string())
}

#[cfg(not(feature = "parquet"))]
pub(crate) fn parquet(
    _table: impl std::io::Read,
    _kind: impl Fn(&str) -> ColumnKind,
) -> Result<Vec<u8>, String> {
    require_parquet().map(|()| Vec::new()).map_err(|failure| failure.headline().to_owned())
}

/// Refuses Parquet where this program was built without it; checked before the work.
pub(crate) fn require_parquet() -> Result<(), Failure> {
    cfg!(feature = "parquet").then_some(()).ok_or_else(|| Failure::usage(
        "this program was built without Parquet",
        "pandas, Polars and DuckDB read the CSV as it is; or install with `cargo install --path . --features parquet`",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_a_confirmed_stop_never_ends_as_stopped() {
        let lost = Outcome::LinkLost { reason: "gone".to_owned() };
        for (outcome, sure, unsure) in [
            (Outcome::Done, None, LINK),
            (Outcome::Stopped, Some(INTERRUPTED), LINK),
            (Outcome::Interrupted, Some(INTERRUPTED), LINK),
            (lost, Some(LINK), LINK),
        ] {
            let confirmed = early_end(&outcome, None);
            assert_eq!(confirmed.map(|end| end.0), sure, "{outcome:?}");
            let (status, headline, _) = early_end(&outcome, Some("no reply")).unwrap();
            assert_eq!(status, unsure, "{outcome:?}");
            let is_named = headline.contains("not confirmed") || headline.contains("lost");
            assert!(is_named, "{outcome:?}: {headline}");
        }
    }
}
