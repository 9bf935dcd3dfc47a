//! One case of a suite, with one seed: its steps one after the other in a folder of its own.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::Value;

use super::baseline::{self, Baseline};
use super::host::{self, STOOD_STILL_S, Stage};
use super::line::Line;
use super::own_drive::{self, DriveOrder, OwnDrive};
use super::process::{self, Done, End, Watch, error_said, monotonic_s};
use crate::app::failure::{INTERRUPTED, LINK, REFUSED, TRIP};
use crate::app::files::read_text;
use crate::app::{opening, output};
use crate::bench::BenchFile;
use crate::recording::open_run;
use crate::sample::Channel;
use crate::workflow::suite::{
    Act, Action, Answered, CASE, Case, CaseOutcome, ChangedFile, Check, HostAct, Limit,
    SignalLimit, Step, StepOutcome, Verb, Verdict, answered, figure, find, is_written, reference,
};

/// Attempts at a case in which this machine stood still.
pub(super) const ATTEMPTS: u32 = 4;
/// Keeps the other drive of a case apart from its own.
const ANOTHER: u64 = 1000;
/// Watchdog of a drive in the guise of another, of which the emulator's file says nothing, s.
const GUISE_WATCHDOG_S: f64 = 3.0;

/// What all cases of a suite have in common.
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

/// What an earlier step left.
struct Left {
    result: Value,
    /// The run that it recorded, or was about.
    run: Option<PathBuf>,
}

/// Why a case does not go on.
struct Ended {
    verdict: Verdict,
    status: Option<u8>,
}

impl Ended {
    fn failed(reason: String) -> Self {
        Self {
            verdict: Verdict::Failed(reason),
            status: None,
        }
    }

    fn error(reason: String) -> Self {
        Self {
            verdict: Verdict::Error(reason),
            status: None,
        }
    }
}

struct Progress<'a> {
    bench: &'a Bench<'a>,
    case: &'a Case,
    seed: u64,
    folder: &'a Path,
    left: BTreeMap<String, Left>,
    /// Name of the last command, and of the last one that was about a run.
    last: Option<String>,
    last_with_run: Option<String>,
    /// Keys of the emulator's file that faults have changed.
    changed: toml::Table,
    outcomes: Vec<StepOutcome>,
    /// The drive in a process of its own, with the keys that it was started with.
    drive: Option<(OwnDrive, toml::Table)>,
    /// Longest time for which this machine stood still around an act, s.
    stood_still_s: f64,
    /// A command lost its link, or tripped, before anything could be done to it, as one does that stood still itself.
    is_early: bool,
    answers: Vec<Answered>,
}

impl Progress<'_> {
    /// Why what did not pass says nothing.
    fn disturbance(&self) -> Option<String> {
        if self.stood_still_s > STOOD_STILL_S {
            let ms = self.stood_still_s * 1e3;
            return Some(format!("this machine stood still for {ms:.0} ms"));
        }
        let text = "the command ended before anything was done to it";
        self.is_early.then(|| text.to_owned())
    }
}

/// Carries a case out. `folder` is made for it. Where this machine stood still while something was done to a command, what
/// did not pass says nothing: it is tried again, and at last not judged.
pub(super) fn carry_out(bench: &Bench<'_>, case: &Case, seed: u64, folder: &Path) -> CaseOutcome {
    let mut attempts = 1;
    let mut set_aside = Vec::new();
    loop {
        let (mut outcome, disturbance) = attempt(bench, case, seed, folder);
        outcome.attempts = attempts;
        outcome.set_aside.clone_from(&set_aside);
        let disturbance = disturbance.filter(|_| outcome.verdict != Verdict::Passed);
        let Some(why) = disturbance.filter(|_| !bench.stop.load(Ordering::Acquire)) else {
            return outcome;
        };
        let (Verdict::Failed(reason) | Verdict::Error(reason) | Verdict::Skipped(reason)) =
            &outcome.verdict
        else {
            return outcome;
        };
        if attempts == ATTEMPTS {
            let text = format!("not judged: {why}, in the last of {attempts} attempts: {reason}");
            outcome.verdict = Verdict::Error(text);
            return outcome;
        }
        let kept = beside(folder, attempts);
        if let Err(error) = fs::rename(folder, &kept) {
            let text = format!("{reason}; {why}, and {}: {error}", kept.display());
            outcome.verdict = Verdict::Error(text);
            return outcome;
        }
        let said = format!(
            "attempt {attempts} of {ATTEMPTS}: {reason}; {why} ({})",
            kept.display()
        );
        output::message(&format!(
            "again   {:>7.1} s  {}: {said}",
            outcome.took_s, case.name
        ));
        set_aside.push(said);
        attempts += 1;
    }
}

/// Where the evidence of an attempt that is not the last is kept.
fn beside(folder: &Path, attempt: u32) -> PathBuf {
    let mut name = folder.as_os_str().to_owned();
    name.push(format!("-attempt-{attempt}"));
    PathBuf::from(name)
}

fn attempt(
    bench: &Bench<'_>,
    case: &Case,
    seed: u64,
    folder: &Path,
) -> (CaseOutcome, Option<String>) {
    let watch = Watch::start();
    let mut progress = Progress {
        bench,
        case,
        seed,
        folder,
        left: BTreeMap::new(),
        last: None,
        last_with_run: None,
        changed: toml::Table::new(),
        outcomes: Vec::new(),
        drive: None,
        stood_still_s: 0.0,
        is_early: false,
        answers: Vec::new(),
    };
    let made = fs::create_dir_all(folder)
        .map_err(|error| Ended::error(format!("cannot create {}: {error}", folder.display())));
    let ended = made.and_then(|()| case.steps.iter().try_for_each(|step| progress.step(step)));
    let (verdict, status) = match ended {
        Ok(()) => (Verdict::Passed, None),
        Err(ended) => (ended.verdict, ended.status),
    };
    // Ended and waited for before the time is told.
    progress.drive = None;
    let disturbance = progress.disturbance();
    let outcome = CaseOutcome {
        name: case.name.clone(),
        seed,
        tags: case.tags.clone(),
        verdict,
        took_s: watch.took_s(),
        attempts: 1,
        set_aside: Vec::new(),
        status,
        evidence: Some(folder.display().to_string()),
        steps: progress.outcomes,
        answers: progress.answers,
    };
    (outcome, disturbance)
}

impl<'a> Progress<'a> {
    fn step(&mut self, step: &Step) -> Result<(), Ended> {
        match &step.action {
            Action::Fault(keys) => {
                merge(&mut self.changed, keys);
                Ok(())
            }
            Action::File(file) => self.make(file),
            Action::Command {
                verb,
                options,
                statuses,
                host,
            } => self.command(step, *verb, options, statuses, *host),
            Action::Assert {
                of,
                limits,
                signals,
            } => self.assert(step, of.as_deref(), limits, signals),
        }
    }

    fn command(
        &mut self,
        step: &Step,
        verb: Verb,
        options: &[(String, toml::Value)],
        statuses: &[u8],
        host: Option<HostAct>,
    ) -> Result<(), Ended> {
        let has_own_drive = self.case.has_own_drive() && verb.has_link();
        let mut line = None;
        if has_own_drive {
            line = self.plug_in(host)?;
        }
        let port = self.port(host, line.as_ref());
        let has_screen = host.is_some_and(|host| host.act.has_screen());
        let words = self.words(verb, options, &port, has_screen)?;
        let number = self.outcomes.len() + 1;
        let file = |ending: &str| {
            self.folder
                .join(format!("{number:02}-{}.{ending}", step.name))
        };
        let (stdout, stderr) = (file("json"), file("txt"));
        let command = self.command_of(&words);
        let timeout_s = step.timeout_s.unwrap_or(self.case.timeout_s);
        let before = host::runs_in(&self.folder.join("runs"));
        let begin_s = monotonic_s();
        let cannot = |error| Ended::error(format!("{}: {error}", step.name));
        let mut host_said = None;
        let mut act_s = None;
        let done = if let Some(host) = host {
            let came = self.act_on(
                command,
                host,
                line.as_ref(),
                &words,
                [&stdout, &stderr],
                timeout_s,
            );
            let came = came?;
            self.stood_still_s = self.stood_still_s.max(came.stood_still_s);
            (host_said, act_s) = (Some(came.found), came.act_s);
            came.done
        } else {
            process::finish(command, &stdout, &stderr, timeout_s, self.bench.stop)
                .map_err(cannot)?
        };
        drop(line);
        let motor = self
            .drive
            .as_mut()
            .filter(|_| has_own_drive)
            .map(|(drive, _)| {
                let end_s = monotonic_s();
                host::motor(drive.rows_at_rest(), begin_s, act_s.unwrap_or(end_s))
            });
        let shown: Vec<String> = words.iter().map(|word| output::quoted_word(word)).collect();
        let status = match done.end {
            End::Status(status) => Some(status),
            End::Asked(status) => status,
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
        let error = error_said(&stderr);
        let is_late_machine = matches!(done.end, End::Status(LINK | TRIP));
        let is_early = host.is_some() && act_s.is_none();
        self.is_early = is_early && is_late_machine;
        self.judge_end(step, &done, statuses, timeout_s, error.as_deref())?;
        if is_early {
            let reason = format!("{}: it ended before anything was done to it", step.name);
            return Err(Ended::error(reason));
        }
        let run = if verb.is_live() {
            host::newest(&self.folder.join("runs"), &before)
        } else if verb.has_run() {
            self.run_about(options)?
        } else {
            None
        };
        self.keep(step, verb, &stdout, &done, error, run);
        if let Some(left) = self.left.get_mut(&step.name)
            && let Value::Object(figures) = &mut left.result
        {
            // What it says to programs is under `error`; a sentence that was folded is one line again.
            let said = fs::read_to_string(&stderr).unwrap_or_default();
            let said = said.split_inclusive('\n');
            let said = said.filter(|line| !line.starts_with("{\"error\""));
            let said = said.collect::<String>().replace("\n  ", " ");
            figures.insert("said".to_owned(), said.into());
            figures.extend(motor.map(|motor| ("motor".to_owned(), motor)));
            figures.extend(host_said.map(|said| ("host".to_owned(), said)));
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
        let Some(Left { result, run }) = self.left.get(&step.name) else {
            return Ok(());
        };
        let (number, mut earlier) = (self.outcomes.len(), 0);
        let identify = |run: &Path| {
            earlier += 1;
            let same = options.iter().filter(|(key, _)| key != "run").cloned();
            let run = toml::Value::String(run.display().to_string());
            let options: Vec<_> = same.chain([("run".to_owned(), run)]).collect();
            let words = self.words(Verb::Identify, &options, &self.bench.port, false);
            let words = words.map_err(|_| "its command cannot be put together".to_owned())?;
            let name = format!("{number:02}-{}-baseline-{earlier}", step.name);
            let files = ["json", "txt"].map(|ending| self.folder.join(format!("{name}.{ending}")));
            baseline::identified(self.command_of(&words), files, timeout_s, self.bench.stop)
        };
        let names = (self.case.name.as_str(), step.name.as_str());
        let found = baseline::found(self.bench.baseline, names, result, run.as_deref(), identify);
        let found = found.map_err(|reason| Ended::error(format!("{}: {reason}", step.name)))?;
        if let (Some(drift), Some(Value::Object(figures))) = (
            &found.drift,
            self.left.get_mut(&step.name).map(|left| &mut left.result),
        ) {
            let own = baseline::figures(drift).into_iter();
            figures.extend(own.map(|(key, figure)| (key.to_owned(), figure)));
        }
        if let Some(outcome) = self.outcomes.last_mut() {
            outcome.identified = Some(found);
        }
        Ok(())
    }

    /// This program with these words.
    fn command_of(&self, words: &[String]) -> Command {
        let mut command = Command::new(self.bench.program);
        command
            .args(words)
            .env("RAYON_NUM_THREADS", self.bench.threads.to_string());
        command
    }

    fn act_on(
        &mut self,
        mut command: Command,
        act: HostAct,
        line: Option<&Line>,
        words: &[String],
        files: [&Path; 2],
        timeout_s: f64,
    ) -> Result<host::Came, Ended> {
        let cannot = |error: io::Error| Ended::error(format!("host: {error}"));
        let order = self.order(self.seed.wrapping_add(ANOTHER), "other-drive")?;
        let mut other = || OwnDrive::start(&order);
        let runs = self.folder.join("runs");
        let before = host::runs_in(&runs);
        let gone = || Ended::error("the software drive is gone".to_owned());
        let (drive, _) = self.drive.as_mut().ok_or_else(gone)?;
        let port = PathBuf::from(drive.port());
        host::prepare(act.act, &mut command, &port, &runs).map_err(cannot)?;
        let mut second = Command::new(self.bench.program);
        // Its runs would be taken for those of the command.
        let elsewhere = self.folder.join("second-host").display().to_string();
        let runs_word = runs.display().to_string();
        let words = words
            .iter()
            .map(|word| if *word == runs_word { &elsewhere } else { word });
        second.args(words);
        let stage = Stage {
            act,
            drive,
            line,
            other: &mut other,
            second,
            runs: &runs,
            before: &before,
            folder: self.folder,
            timeout_s,
            stop: self.bench.stop,
        };
        host::run(stage, command, files).map_err(cannot)
    }

    /// A drive in a process of its own, with the keys as they are now; and the line before it, where that is to fail.
    fn plug_in(&mut self, host: Option<HostAct>) -> Result<Option<Line>, Ended> {
        let is_as_asked =
            |(drive, keys): &mut (OwnDrive, toml::Table)| *keys == self.changed && !drive.is_gone();
        let is_there = self.drive.as_mut().is_some_and(is_as_asked);
        let cannot = |error: io::Error| Ended::error(format!("software drive: {error}"));
        if !is_there {
            // One after the other under one name, which the next command is given.
            self.drive = None;
            let name = format!("drive-{}", self.outcomes.len() + 1);
            let order = self.order(self.seed, &name)?;
            let drive = OwnDrive::start(&order).map_err(cannot)?;
            self.drive = Some((drive, self.changed.clone()));
        }
        let on_line = host.is_some_and(|host| host.act.is_on_line());
        let drive = self.drive.as_ref().filter(|_| on_line);
        let line = drive.map(|(drive, _)| drive.behind_a_line(&own_drive::beside(self.folder)));
        line.transpose().map_err(cannot)
    }

    /// What a software drive of this case is started with.
    fn order(&self, seed: u64, name: &str) -> Result<DriveOrder<'a>, Ended> {
        let bench = match self.bench_path()? {
            None => BenchFile::embedded_default(),
            Some(path) => opening::bench_file(&path)
                .map_err(|failure| Ended::error(failure.headline().to_owned()))?,
        };
        let named = self.emulator()?;
        let named = named.unwrap_or_else(|| bench.emulator.config.clone());
        let is_own = bench.drive.profile.starts_with("own");
        let watchdog_s = opening::emulator_config(&named).map_or(GUISE_WATCHDOG_S, |config| {
            f64::from(config.watchdog_ms) * 1e-3
        });
        Ok(DriveOrder {
            program: self.bench.program,
            folder: self.folder,
            name: name.to_owned(),
            emulator: named,
            profile: bench.drive.profile,
            protocol: bench.link.protocol,
            seed,
            watchdog_s: if is_own { watchdog_s } else { GUISE_WATCHDOG_S },
            stop: self.bench.stop,
        })
    }

    /// Where a live command finds its drive.
    fn port(&self, host: Option<HostAct>, line: Option<&Line>) -> String {
        let own = self.drive.as_ref().filter(|_| self.case.has_own_drive());
        match (host.map(|host| host.act), line, own) {
            (Some(Act::PortAbsent), ..) => self.folder.join("absent.pty").display().to_string(),
            (_, Some(line), _) => line.port.clone(),
            (_, None, Some((drive, _))) => drive.port(),
            (_, None, None) => self.bench.port.clone(),
        }
    }

    /// Whether a command ended as it should.
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
            End::Asked(status) => {
                let how = asked_to_end(status, error);
                return Err(Ended::error(format!(
                    "{name}: not done in {timeout_s} s; {how}"
                )));
            }
            End::Killed => {
                let reason = format!(
                    "{name}: ended by a signal, or killed as it did not end in {timeout_s} s; only the drive's watchdog stops the motor then"
                );
                return Err(Ended::error(reason));
            }
        };
        let wanted: Vec<String> = statuses.iter().map(u8::to_string).collect();
        let said = error.map_or_else(String::new, |error| format!(": {error}"));
        let reason = format!(
            "{name}: exit status {status}, has to be {}{said}",
            wanted.join(" or ")
        );
        // A drive that trips, or does not, where the suite says otherwise is a finding; what stands in the way of a judgement
        // is an error.
        let is_finding = status == REFUSED || status == 0 || statuses != [0];
        Err(Ended {
            verdict: if is_finding {
                Verdict::Failed(reason)
            } else {
                Verdict::Error(reason)
            },
            status: Some(status),
        })
    }

    /// Keeps the result of a command for the steps that follow. `run`: the one that a live command began, of which an
    /// earlier step knows nothing, or the one that another is about.
    fn keep(
        &mut self,
        step: &Step,
        verb: Verb,
        stdout: &Path,
        done: &Done,
        error: Option<String>,
        run: Option<PathBuf>,
    ) {
        let text = fs::read_to_string(stdout)
            .ok()
            .filter(|text| !text.is_empty());
        // On a screen, and where it was killed, there is only what its run has kept.
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
        self.left.insert(step.name.clone(), Left { result, run });
        self.last = Some(step.name.clone());
        if verb.has_run() {
            self.last_with_run.clone_from(&self.last);
        }
    }

    fn last_run(&self) -> Option<&Path> {
        let last = self.last_with_run.as_ref()?;
        self.left.get(last)?.run.as_deref()
    }

    /// The run that a command which records none is about: the one that it is given, else that of the last command.
    fn run_about(&self, options: &[(String, toml::Value)]) -> Result<Option<PathBuf>, Ended> {
        let given = options.iter().find(|(key, _)| key == "run");
        match given.and_then(|(_, run)| run.as_str()) {
            Some(given) => Ok(Some(PathBuf::from(self.resolved(given)?))),
            None => Ok(self.last_run().map(Path::to_owned)),
        }
    }

    /// The words of a command.
    fn words(
        &self,
        verb: Verb,
        options: &[(String, toml::Value)],
        port: &str,
        has_screen: bool,
    ) -> Result<Vec<String>, Ended> {
        let mut words = vec![verb.command().to_owned()];
        let option = |key: &str| {
            options
                .iter()
                .find(|(name, _)| name == key)
                .map(|(_, value)| value)
        };
        let given = |key: &str| option(key).and_then(toml::Value::as_str);
        if verb.is_live() || verb == Verb::Plan {
            if let Some(bench) = self.bench_path()? {
                words.push(bench.display().to_string());
            }
        } else if let Some(effect) = given("effect") {
            words.push(effect.to_owned());
        }
        if verb == Verb::Probe {
            words.extend(["--port".to_owned(), port.to_owned()]);
        }
        if !verb.is_live() && verb.has_run() {
            let run = self.run_about(options)?;
            let run = run.ok_or_else(|| {
                Ended::error(format!(
                    "{}: no earlier step has recorded a run",
                    verb.command()
                ))
            })?;
            if verb == Verb::Add {
                words.push("--run".to_owned());
            }
            words.push(run.display().to_string());
        }
        if verb.is_live() {
            words.extend(["--port".to_owned(), port.to_owned()]);
            words.extend([
                "--out".to_owned(),
                self.folder.join("runs").display().to_string(),
            ]);
            if self.bench.hardware {
                words.push("--hardware".to_owned());
            } else if self.drive.is_none() {
                if let Some(emulator) = self.emulator()? {
                    words.extend(["--emulator".to_owned(), emulator]);
                }
                words.extend(["--seed".to_owned(), self.seed.to_string()]);
            }
        }
        for (key, value) in options {
            if matches!(key.as_str(), "run" | "effect") {
                continue;
            }
            let name = format!("--{}", key.replace('_', "-"));
            match value {
                toml::Value::Boolean(true) => words.push(name),
                toml::Value::Boolean(false) => {}
                toml::Value::String(text) if is_written(key) => {
                    words.extend([name, self.folder.join(text).display().to_string()]);
                }
                toml::Value::String(text) => words.extend([name, self.resolved(text)?]),
                other => words.extend([name, other.to_string()]),
            }
        }
        if verb == Verb::Connect {
            words.push("--check".to_owned());
        }
        if !has_screen {
            words.push("--json".to_owned());
        }
        Ok(words)
    }

    /// A word with the folder of the step that it refers to.
    fn resolved(&self, text: &str) -> Result<String, Ended> {
        let Some((name, rest)) = reference(text) else {
            return Ok(text.to_owned());
        };
        if name == CASE {
            return Ok(format!("{}{rest}", self.folder.display()));
        }
        let run = self.left.get(name).and_then(|left| left.run.as_ref());
        let run = run.ok_or_else(|| Ended::error(format!("@{name}: that step recorded no run")))?;
        Ok(format!("{}{rest}", run.display()))
    }

    /// The bench file of the case.
    fn bench_path(&self) -> Result<Option<PathBuf>, Ended> {
        let Some(bench) = &self.case.bench else {
            return Ok(None);
        };
        Ok(Some(match reference(bench) {
            Some(_) => PathBuf::from(self.resolved(bench)?),
            None => self.bench.home.join(bench),
        }))
    }

    /// Makes a file with other keys than those of the one that it is of.
    fn make(&self, file: &ChangedFile) -> Result<(), Ended> {
        let wrong = |error: &dyn std::fmt::Display| Ended::error(format!("file: {error}"));
        let path = self.bench.home.join(&file.of);
        let text = read_text(&path).map_err(|failure| wrong(&failure.headline()))?;
        let mut table: toml::Table = text.parse().map_err(|error| wrong(&error))?;
        let mut keys = toml::Value::Table(file.set.clone());
        lead_to(&mut keys, self.folder);
        if let toml::Value::Table(keys) = &keys {
            merge(&mut table, keys);
        }
        let text = toml::to_string(&table).map_err(|error| wrong(&error))?;
        fs::write(self.folder.join(&file.name), text).map_err(|error| wrong(&error))
    }

    /// The emulator's name or file, with what the faults changed in it.
    fn emulator(&self) -> Result<Option<String>, Ended> {
        let named = self.case.emulator.as_ref();
        let near = named.map(|name| self.bench.home.join(name));
        let named = match (near, named) {
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
            None => crate::emulator::EmulatorConfig::embedded_default(),
        };
        let mut table = toml::Table::try_from(&base).map_err(|error| wrong(&error))?;
        merge(&mut table, &self.changed);
        let text = toml::to_string(&table).map_err(|error| wrong(&error))?;
        let path = self
            .folder
            .join(format!("emulator-{}.toml", self.outcomes.len() + 1));
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
        let left = name.and_then(|name| self.left.get(name));
        let left =
            left.ok_or_else(|| Ended::error("assert: no earlier step has a result".to_owned()))?;
        let of_drift = limits.iter().any(|(key, _)| key.starts_with("drift"));
        if of_drift && self.bench.baseline.is_none() {
            let reason = "drift: nothing to compare with; give --baseline RUN, an earlier run of this machine";
            return Err(Ended::error(reason.to_owned()));
        }
        let mut checks: Vec<Check> = limits
            .iter()
            .map(|(key, limit)| {
                let found = find(&left.result, key);
                Check {
                    key: key.clone(),
                    value: found.as_ref().and_then(figure),
                    failure: limit.fails(found.as_ref()),
                }
            })
            .collect();
        for signal in signals {
            checks.push(signal_check(signal, left.run.as_deref()).map_err(Ended::error)?);
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
        if failures.is_empty() {
            Ok(())
        } else {
            Err(Ended::failed(failures.join("; ")))
        }
    }
}

fn signal_check(signal: &SignalLimit, run: Option<&Path>) -> Result<Check, String> {
    let run = run.ok_or("signal: no run was recorded")?;
    let loaded = open_run(run, None).map_err(|error| error.to_string())?;
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

/// Puts the folder of the case in the place of its name.
fn lead_to(value: &mut toml::Value, folder: &Path) {
    match value {
        toml::Value::String(text) => {
            if let Some((CASE, rest)) = reference(text) {
                *text = format!("{}{rest}", folder.display());
            }
        }
        toml::Value::Array(values) => values.iter_mut().for_each(|own| lead_to(own, folder)),
        toml::Value::Table(table) => table.iter_mut().for_each(|(_, own)| lead_to(own, folder)),
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

/// How a command ended that was asked to, and what is known of the motor: what the command says of it, if it is an end by
/// its guard.
fn asked_to_end(status: Option<u8>, said: Option<&str>) -> String {
    let ended = match status {
        Some(status) => format!("asked to end, it did with exit status {status}"),
        None => "asked to end, it was gone without a word".to_owned(),
    };
    match (status, said) {
        (Some(INTERRUPTED), Some(said)) => format!("{ended}: {said}"),
        (_, said) => {
            let said = said.map_or_else(String::new, |said| format!(": {said}"));
            format!("{ended}{said}; how it left the motor is not known")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_command_says_how_it_left_its_motor() {
        let words = "stopped before the end; the drive confirmed zero output";
        assert_eq!(
            asked_to_end(Some(INTERRUPTED), Some(words)),
            format!("asked to end, it did with exit status 130: {words}")
        );
        for (status, said) in [
            (Some(INTERRUPTED), None),
            (Some(LINK), Some("link lost")),
            (Some(0), None),
            (None, None),
        ] {
            let text = asked_to_end(status, said);
            assert!(
                text.ends_with("how it left the motor is not known"),
                "{text}"
            );
        }
    }
}
