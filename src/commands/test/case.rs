//! One case of a suite, with one seed: its steps one after the other in a folder of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use serde_json::Value;

use super::baseline::{self, Baseline};
use super::own_drive::{DriveOrder, OwnDrive};
use super::process::{self, Done, End, Watch, error_message};
use crate::runtime::{INTERRUPTED, REFUSED, opening, output, read_text};
use crate::workflow::suite::{
    Action, Answered, CASE, Case, CaseOutcome, ChangedFile, Check, Limit, SignalLimit, Step,
    StepOutcome, Verb, Verdict, answered, figure, find, is_written, reference,
};
use drivebench_bench::BenchFile;
use drivebench_bench::recording::{ReadOptions, open_run};
use drivebench_model::sample::Channel;

pub(super) struct Bench<'a> {
    pub(super) program: &'a Path,
    /// Folder of the suite file; paths in it count from there.
    pub(super) home: &'a Path,
    pub(super) port: String,
    pub(super) hardware: bool,
    /// Threads that one command may use.
    pub(super) threads: usize,
    pub(super) stop: &'a AtomicBool,
    pub(super) baseline: Option<&'a Baseline>,
}

struct StepResult {
    result: Value,
    /// The run that it recorded or analysed.
    run: Option<PathBuf>,
}

struct Ended {
    verdict: Verdict,
    status: Option<u8>,
}

impl Ended {
    fn failed(reason: String) -> Self {
        Self { verdict: Verdict::Failed(reason), status: None }
    }

    fn error(reason: String) -> Self {
        Self { verdict: Verdict::Error(reason), status: None }
    }
}

struct Progress<'a> {
    bench: &'a Bench<'a>,
    case: &'a Case,
    seed: u64,
    folder: &'a Path,
    results: BTreeMap<String, StepResult>,
    last: Option<String>,
    /// Name of the last command with a run.
    last_with_run: Option<String>,
    /// Keys of the emulator's file that faults have changed.
    changed: toml::Table,
    outcomes: Vec<StepOutcome>,
    /// The drive in a process of its own, with the keys that it was started with.
    drive: Option<(OwnDrive, toml::Table)>,
    answers: Vec<Answered>,
}

/// Carries a case out. `folder` is made for it.
pub(super) fn carry_out(bench: &Bench<'_>, case: &Case, seed: u64, folder: &Path) -> CaseOutcome {
    let watch = Watch::start();
    let mut progress = Progress {
        bench,
        case,
        seed,
        folder,
        results: BTreeMap::new(),
        last: None,
        last_with_run: None,
        changed: toml::Table::new(),
        outcomes: Vec::new(),
        drive: None,
        answers: Vec::new(),
    };
    let made = fs::create_dir_all(folder)
        .map_err(|error| Ended::error(format!("cannot create {}: {error}", folder.display())));
    let ended = made.and_then(|()| case.steps.iter().try_for_each(|step| progress.step(step)));
    let (verdict, status) = match ended {
        Ok(()) => (Verdict::Passed, None),
        Err(ended) => (ended.verdict, ended.status),
    };
    // The end of the drive counts to the time of the case.
    progress.drive = None;
    CaseOutcome {
        name: case.name.clone(),
        seed,
        tags: case.tags.clone(),
        verdict,
        took_s: watch.took_s(),
        status,
        evidence: Some(folder.display().to_string()),
        steps: progress.outcomes,
        answers: progress.answers,
    }
}

impl Progress<'_> {
    fn step(&mut self, step: &Step) -> Result<(), Ended> {
        match &step.action {
            Action::Fault(keys) => {
                merge(&mut self.changed, keys);
                Ok(())
            }
            Action::File(file) => self.make(file),
            Action::Command { verb, options, statuses } => {
                self.command(step, *verb, options, statuses)
            }
            Action::Assert { of, limits, signals } => {
                self.assert(step, of.as_deref(), limits, signals)
            }
        }
    }

    fn command(
        &mut self,
        step: &Step,
        verb: Verb,
        options: &[(String, toml::Value)],
        statuses: &[u8],
    ) -> Result<(), Ended> {
        if self.case.has_own_drive() && verb.has_link() {
            self.start_drive()?;
        }
        let arguments = self.arguments(verb, options, &self.port())?;
        let number = self.outcomes.len() + 1;
        let file = |ending: &str| self.folder.join(format!("{number:02}-{}.{ending}", step.name));
        let (stdout, stderr) = (file("json"), file("txt"));
        let command = self.command_of(&arguments);
        let timeout_s = step.timeout_s.unwrap_or(self.case.timeout_s);
        let before = runs_in(&self.folder.join("runs"));
        let done = process::finish(command, &stdout, &stderr, timeout_s, self.bench.stop)
            .map_err(|error| Ended::error(format!("{}: {error}", step.name)))?;
        let shown: Vec<String> = arguments.iter().map(|text| output::quoted_word(text)).collect();
        let status = match done.end {
            End::Status(status) => Some(status),
            End::Terminated(status) => status,
            End::Killed => None,
        };
        self.outcomes.push(StepOutcome {
            name: step.name.clone(),
            command: format!("drivebench {}", shown.join(" ")),
            status,
            took_s: done.took_s,
            checks: Vec::new(),
            identified: None,
        });
        let error = error_message(&stderr);
        self.judge_end(step, &done, statuses, timeout_s, error.as_deref())?;
        let run = if verb.is_live() {
            newest(&self.folder.join("runs"), &before)
        } else if verb.has_run() {
            self.run_about(options)?
        } else {
            None
        };
        self.keep(step, verb, &stdout, &done, error, run);
        if let Some(result) = self.results.get_mut(&step.name)
            && let Value::Object(figures) = &mut result.result
        {
            // The line for programs is under `error`; a sentence that was folded is one line again.
            let messages: String = fs::read_to_string(&stderr)
                .unwrap_or_default()
                .split_inclusive('\n')
                .filter(|line| !line.starts_with("{\"error\""))
                .collect();
            figures.insert("said".to_owned(), messages.replace("\n  ", " ").into());
        }
        if verb == Verb::Identify {
            self.compare_with_baseline(step, options, timeout_s)?;
        }
        Ok(())
    }

    /// Keeps what a step found with the machine that it was found on, and, where there is a baseline, what has drifted since.
    fn compare_with_baseline(
        &mut self,
        step: &Step,
        options: &[(String, toml::Value)],
        timeout_s: f64,
    ) -> Result<(), Ended> {
        let Some(StepResult { result, run }) = self.results.get(&step.name) else {
            return Ok(());
        };
        let (number, mut earlier) = (self.outcomes.len(), 0);
        let identify = |run: &Path| {
            earlier += 1;
            let same = options.iter().filter(|(key, _)| key != "run").cloned();
            let run = toml::Value::String(run.display().to_string());
            let options: Vec<_> = same.chain([("run".to_owned(), run)]).collect();
            let arguments = self
                .arguments(Verb::Identify, &options, &self.bench.port)
                .map_err(|_| "its command cannot be built".to_owned())?;
            let name = format!("{number:02}-{}-baseline-{earlier}", step.name);
            let files = ["json", "txt"].map(|ending| self.folder.join(format!("{name}.{ending}")));
            baseline::identified(self.command_of(&arguments), files, timeout_s, self.bench.stop)
        };
        let names = (self.case.name.as_str(), step.name.as_str());
        let found = baseline::found(self.bench.baseline, names, result, run.as_deref(), identify);
        let found = found.map_err(|reason| Ended::error(format!("{}: {reason}", step.name)))?;
        if let (Some(drift), Some(Value::Object(figures))) =
            (&found.drift, self.results.get_mut(&step.name).map(|result| &mut result.result))
        {
            let own = baseline::figures(drift).into_iter();
            figures.extend(own.map(|(key, figure)| (key.to_owned(), figure)));
        }
        if let Some(outcome) = self.outcomes.last_mut() {
            outcome.identified = Some(found);
        }
        Ok(())
    }

    fn command_of(&self, arguments: &[String]) -> Command {
        let mut command = Command::new(self.bench.program);
        command.args(arguments).env("RAYON_NUM_THREADS", self.bench.threads.to_string());
        command
    }

    /// Starts a drive in a process of its own with the present keys, unless it runs already.
    fn start_drive(&mut self) -> Result<(), Ended> {
        let is_running = self
            .drive
            .as_mut()
            .is_some_and(|(drive, keys)| *keys == self.changed && !drive.is_gone());
        if is_running {
            return Ok(());
        }
        // The next drive takes the same port.
        self.drive = None;
        let bench = match self.bench_path()? {
            None => BenchFile::embedded_default(),
            Some(path) => opening::bench_file(&path)
                .map_err(|failure| Ended::error(failure.headline().to_owned()))?,
        };
        let order = DriveOrder {
            program: self.bench.program,
            folder: self.folder,
            name: format!("drive-{}", self.outcomes.len() + 1),
            emulator: self.emulator()?.unwrap_or(bench.emulator.config),
            profile: bench.drive.profile,
            protocol: bench.link.protocol,
            seed: self.seed,
            stop: self.bench.stop,
        };
        let drive = OwnDrive::start(&order)
            .map_err(|error| Ended::error(format!("software drive: {error}")))?;
        self.drive = Some((drive, self.changed.clone()));
        Ok(())
    }

    fn port(&self) -> String {
        match &self.drive {
            Some((drive, _)) => drive.port(),
            None => self.bench.port.clone(),
        }
    }

    /// Whether a command ended with an expected status.
    fn judge_end(
        &self,
        step: &Step,
        done: &Done,
        statuses: &[u8],
        timeout_s: f64,
        error: Option<&str>,
    ) -> Result<(), Ended> {
        let name = &step.name;
        let status = match done.end {
            End::Status(status) if statuses.contains(&status) => return Ok(()),
            End::Status(status) => status,
            _ if self.bench.stop.load(std::sync::atomic::Ordering::Acquire) => {
                return Err(Ended {
                    verdict: Verdict::Error(format!("{name}: interrupted")),
                    status: Some(INTERRUPTED),
                });
            }
            End::Terminated(status) => {
                let how = end_text(status, error);
                return Err(Ended::error(format!("{name}: not done in {timeout_s} s; {how}")));
            }
            End::Killed => {
                let reason = format!(
                    "{name}: ended by a signal, or killed as it did not end in {timeout_s} s; only the drive's watchdog stops the motor then"
                );
                return Err(Ended::error(reason));
            }
        };
        let wanted: Vec<String> = statuses.iter().map(u8::to_string).collect();
        let message = error.map_or_else(String::new, |error| format!(": {error}"));
        let reason =
            format!("{name}: exit status {status}, has to be {}{message}", wanted.join(" or "));
        // An unexpected trip, or a missing one, fails the case; what prevents a judgement is an error.
        let is_finding = status == REFUSED || status == 0 || statuses != [0];
        Err(Ended {
            verdict: if is_finding { Verdict::Failed(reason) } else { Verdict::Error(reason) },
            status: Some(status),
        })
    }

    /// Keeps the result of a command for the steps that follow. `run`: the new one of a live command, or the one that another
    /// analysed.
    fn keep(
        &mut self,
        step: &Step,
        verb: Verb,
        stdout: &Path,
        done: &Done,
        error: Option<String>,
        run: Option<PathBuf>,
    ) {
        let text = fs::read_to_string(stdout).ok().filter(|text| !text.is_empty());
        // Where it was killed, there is only what its run has kept.
        let of_run = run.as_ref().filter(|_| verb.is_live());
        let text = text.or_else(|| fs::read_to_string(of_run?.join("result.json")).ok());
        let text = text.unwrap_or_default();
        let mut result: Value = serde_json::from_str(&text).unwrap_or_default();
        if result.is_null() {
            result = Value::Object(serde_json::Map::new());
        }
        if let (Value::Object(figures), End::Status(status)) = (&mut result, done.end) {
            figures.insert("exit_status".to_owned(), status.into());
            figures.insert("took_s".to_owned(), done.took_s.into());
            figures.insert("error".to_owned(), error.into());
        }
        self.answers.extend(answered(&result));
        let recorded = match verb {
            Verb::Commission => result.pointer("/runs/0/folder"),
            _ => result.get("folder"),
        };
        let run = recorded.and_then(Value::as_str).map(PathBuf::from).or(run);
        self.results.insert(step.name.clone(), StepResult { result, run });
        self.last = Some(step.name.clone());
        if verb.has_run() {
            self.last_with_run.clone_from(&self.last);
        }
    }

    fn last_run(&self) -> Option<&Path> {
        let last = self.last_with_run.as_ref()?;
        self.results.get(last)?.run.as_deref()
    }

    /// The run that a command analyses: the one that it is given, else that of the last command.
    fn run_about(&self, options: &[(String, toml::Value)]) -> Result<Option<PathBuf>, Ended> {
        let given = options.iter().find(|(key, _)| key == "run");
        match given.and_then(|(_, run)| run.as_str()) {
            Some(given) => Ok(Some(PathBuf::from(self.resolved(given)?))),
            None => Ok(self.last_run().map(Path::to_owned)),
        }
    }

    fn arguments(
        &self,
        verb: Verb,
        options: &[(String, toml::Value)],
        port: &str,
    ) -> Result<Vec<String>, Ended> {
        let mut arguments = vec![verb.command().to_owned()];
        let option =
            |key: &str| options.iter().find(|(name, _)| name == key).map(|(_, value)| value);
        let given = |key: &str| option(key).and_then(toml::Value::as_str);
        if verb.is_live() || verb == Verb::Plan {
            if let Some(bench) = self.bench_path()? {
                arguments.push(bench.display().to_string());
            }
        } else if let Some(effect) = given("effect") {
            arguments.push(effect.to_owned());
        }
        if verb == Verb::Probe {
            arguments.extend(["--port".to_owned(), port.to_owned()]);
        }
        if !verb.is_live() && verb.has_run() {
            let run = self.run_about(options)?;
            let run = run.ok_or_else(|| {
                Ended::error(format!("{}: no earlier step has recorded a run", verb.command()))
            })?;
            if verb == Verb::Add {
                arguments.push("--run".to_owned());
            }
            arguments.push(run.display().to_string());
        }
        if verb.is_live() {
            arguments.extend(["--port".to_owned(), port.to_owned()]);
            arguments.extend(["--out".to_owned(), self.folder.join("runs").display().to_string()]);
            if self.bench.hardware {
                arguments.push("--hardware".to_owned());
            } else if self.drive.is_none() {
                if let Some(emulator) = self.emulator()? {
                    arguments.extend(["--emulator".to_owned(), emulator]);
                }
                arguments.extend(["--seed".to_owned(), self.seed.to_string()]);
            }
        }
        for (key, value) in options {
            if matches!(key.as_str(), "run" | "effect") {
                continue;
            }
            let name = format!("--{}", key.replace('_', "-"));
            match value {
                toml::Value::Boolean(true) => arguments.push(name),
                toml::Value::Boolean(false) => {}
                toml::Value::String(text) if is_written(key) => {
                    arguments.extend([name, self.folder.join(text).display().to_string()]);
                }
                toml::Value::String(text) => arguments.extend([name, self.resolved(text)?]),
                other => arguments.extend([name, other.to_string()]),
            }
        }
        if verb == Verb::Connect {
            arguments.push("--check".to_owned());
        }
        arguments.push("--json".to_owned());
        Ok(arguments)
    }

    /// An argument with the folder of the step that it refers to.
    fn resolved(&self, text: &str) -> Result<String, Ended> {
        let Some((name, rest)) = reference(text) else {
            return Ok(text.to_owned());
        };
        if name == CASE {
            return Ok(format!("{}{rest}", self.folder.display()));
        }
        let run = self.results.get(name).and_then(|result| result.run.as_ref());
        let run = run.ok_or_else(|| Ended::error(format!("@{name}: that step recorded no run")))?;
        Ok(format!("{}{rest}", run.display()))
    }

    fn bench_path(&self) -> Result<Option<PathBuf>, Ended> {
        let Some(bench) = &self.case.bench else {
            return Ok(None);
        };
        Ok(Some(match reference(bench) {
            Some(_) => PathBuf::from(self.resolved(bench)?),
            None => self.bench.home.join(bench),
        }))
    }

    /// Writes a copy of a file with some keys changed.
    fn make(&self, file: &ChangedFile) -> Result<(), Ended> {
        let wrong = |error: &dyn std::fmt::Display| Ended::error(format!("file: {error}"));
        let path = self.bench.home.join(&file.of);
        let text = read_text(&path).map_err(|failure| wrong(&failure.headline()))?;
        let mut table: toml::Table = text.parse().map_err(|error| wrong(&error))?;
        let mut keys = toml::Value::Table(file.set.clone());
        set_folder(&mut keys, self.folder);
        if let toml::Value::Table(keys) = &keys {
            merge(&mut table, keys);
        }
        let text = toml::to_string(&table).map_err(|error| wrong(&error))?;
        fs::write(self.folder.join(&file.name), text).map_err(|error| wrong(&error))
    }

    /// The emulator's name or file, with the changes by faults.
    fn emulator(&self) -> Result<Option<String>, Ended> {
        let named = self.case.emulator.as_ref();
        let named = match (named.map(|name| self.bench.home.join(name)), named) {
            (Some(path), _) if path.is_file() => Some(path.display().to_string()),
            (_, named) => named.cloned(),
        };
        if self.changed.is_empty() {
            return Ok(named);
        }
        let wrong = |error: &dyn std::fmt::Display| Ended::error(format!("fault: {error}"));
        let base = match &named {
            Some(name) => {
                opening::emulator_config(name).map_err(|failure| wrong(&failure.headline()))?
            }
            None => drivebench_emulator::EmulatorConfig::embedded_default(),
        };
        let mut table = toml::Table::try_from(&base).map_err(|error| wrong(&error))?;
        merge(&mut table, &self.changed);
        let text = toml::to_string(&table).map_err(|error| wrong(&error))?;
        let path = self.folder.join(format!("emulator-{}.toml", self.outcomes.len() + 1));
        fs::write(&path, text).map_err(|error| wrong(&error))?;
        Ok(Some(path.display().to_string()))
    }

    fn assert(
        &mut self,
        step: &Step,
        of: Option<&str>,
        limits: &[(String, Limit)],
        signals: &[SignalLimit],
    ) -> Result<(), Ended> {
        let name = of.or(self.last.as_deref());
        let result = name
            .and_then(|name| self.results.get(name))
            .ok_or_else(|| Ended::error("assert: no earlier step has a result".to_owned()))?;
        let of_drift = limits.iter().any(|(key, _)| key.starts_with("drift"));
        if of_drift && self.bench.baseline.is_none() {
            let reason = "drift: nothing to compare with; give --baseline RUN, an earlier run of this machine";
            return Err(Ended::error(reason.to_owned()));
        }
        let mut checks: Vec<Check> = limits
            .iter()
            .map(|(key, limit)| {
                let found = find(&result.result, key);
                Check {
                    key: key.clone(),
                    value: found.as_ref().and_then(figure),
                    failure: limit.fails(found.as_ref()),
                }
            })
            .collect();
        for signal in signals {
            checks.push(signal_check(signal, result.run.as_deref()).map_err(Ended::error)?);
        }
        let failures: Vec<String> = checks
            .iter()
            .filter_map(|check| Some(format!("{}: {}", check.key, check.failure.as_ref()?)))
            .collect();
        self.outcomes.push(StepOutcome {
            name: step.name.clone(),
            command: String::new(),
            status: None,
            took_s: 0.0,
            checks,
            identified: None,
        });
        if failures.is_empty() { Ok(()) } else { Err(Ended::failed(failures.join("; "))) }
    }
}

/// The folders in a folder of runs; the link to the newest is none.
fn runs_in(runs: &Path) -> BTreeSet<PathBuf> {
    let entries = fs::read_dir(runs).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|path| path.is_dir() && !path.is_symlink()).collect()
}

/// The newest run that was not there `before`.
fn newest(runs: &Path, before: &BTreeSet<PathBuf>) -> Option<PathBuf> {
    let mut runs = runs_in(runs);
    runs.retain(|run| !before.contains(run));
    runs.pop_last()
}

fn signal_check(signal: &SignalLimit, run: Option<&Path>) -> Result<Check, String> {
    let run = run.ok_or("signal: no run was recorded")?;
    let loaded = open_run(run, ReadOptions::default()).map_err(|error| error.to_string())?;
    let channel = Channel::from_key(&signal.channel)
        .ok_or_else(|| format!("signal: there is no channel {:?}", signal.channel))?;
    let begin_s = loaded.run.time_s().first().copied().unwrap_or(0.0);
    let points = loaded.run.points(channel);
    Ok(Check {
        key: format!("{} at {} s", signal.channel, signal.at_s),
        value: None,
        failure: signal.fails(points.map(|(time_s, value)| (time_s - begin_s, value))),
    })
}

/// Replaces references to the case by its folder.
fn set_folder(value: &mut toml::Value, folder: &Path) {
    match value {
        toml::Value::String(text) => {
            if let Some((CASE, rest)) = reference(text) {
                *text = format!("{}{rest}", folder.display());
            }
        }
        toml::Value::Array(values) => values.iter_mut().for_each(|own| set_folder(own, folder)),
        toml::Value::Table(table) => table.iter_mut().for_each(|(_, own)| set_folder(own, folder)),
        _ => {}
    }
}

/// Puts the keys of `changes` over those of `table`, table by table.
fn merge(table: &mut toml::Table, changes: &toml::Table) {
    for (key, change) in changes {
        match (table.get_mut(key), change) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(change)) => merge(inner, change),
            _ => drop(table.insert(key.clone(), change.clone())),
        }
    }
}

/// How a command ended that was terminated. Only a command that was interrupted reports how it left its motor.
fn end_text(status: Option<u8>, message: Option<&str>) -> String {
    let ended = match status {
        Some(status) => format!("terminated, it ended with exit status {status}"),
        None => "terminated, it ended without an exit status".to_owned(),
    };
    let message_text = message.map_or_else(String::new, |message| format!(": {message}"));
    if status == Some(INTERRUPTED) && message.is_some() {
        return format!("{ended}{message_text}");
    }
    format!("{ended}{message_text}; how it left the motor is not known")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::LINK;

    #[test]
    fn only_an_interrupted_command_reports_how_it_left_its_motor() {
        let message = "stopped before the end; the drive confirmed zero output";
        for (status, message, expected) in [
            (Some(INTERRUPTED), Some(message), message),
            (Some(INTERRUPTED), None, "how it left the motor is not known"),
            (Some(LINK), Some("link lost"), "link lost; how it left the motor is not known"),
            (Some(0), None, "how it left the motor is not known"),
            (None, None, "how it left the motor is not known"),
        ] {
            let text = end_text(status, message);
            assert!(text.ends_with(expected), "{status:?} {message:?}: {text}");
        }
    }
}
