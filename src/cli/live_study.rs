//! `reproduce discovery --live`: the program itself, started as a person would, on mystery drives in real time.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use std::{fs, io};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use super::failure::{Failure, INTERNAL};
use super::live_record::LiveFolder;
use super::{output, progress};
use crate::bench::EMBEDDED_DEFAULT;
use crate::recording::open_run;
use crate::workflow::reproduce::discovery::{Heard, LiveAnswer, LiveLink};

/// Runs of each mystery: one to fit, one held out.
const RUN_SEEDS: [u64; 2] = [1, 2];
/// How often a command is looked after.
const LOOK: Duration = Duration::from_millis(20);

/// Runs `drives` mysteries over each link, the first with `seed`, in `folder`, but for those that an earlier start has
/// finished. Where it is interrupted, the answers so far.
pub(super) fn live_study(
    drives: u64,
    seed: u64,
    folder: &LiveFolder,
    interrupted: &AtomicBool,
) -> Result<Vec<LiveAnswer>, Failure> {
    let program = std::env::current_exe()
        .map_err(|error| Failure::new(INTERNAL, format!("cannot find this program: {error}")))?;
    let mysteries = mysteries(drives, seed);
    for link in LiveLink::ALL {
        let path = bench_path(folder.path(), link);
        fs::write(&path, bench_text(link)).map_err(|error| {
            Failure::new(
                INTERNAL,
                format!("{}: cannot write: {error}", path.display()),
            )
        })?;
    }
    let kept = |&(link, seed): &(LiveLink, u64)| folder.answer(link, seed);
    let found: Vec<Option<LiveAnswer>> = mysteries.iter().map(kept).collect();
    let kept = found.iter().flatten().count();
    if kept > 0 {
        output::message(&format!(
            "{kept} of {} mystery drives are finished already; the others follow",
            mysteries.len()
        ));
    }
    progress::stage("runs mystery drives", mysteries.len());
    progress::at(kept);
    let next = AtomicUsize::new(0);
    let found = Mutex::new(found);
    // What is not kept would be lost at the next interrupt.
    let not_kept = Mutex::new(None);
    // Most of the time a drive is waited for, but its clock must not.
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while !interrupted.load(Ordering::Acquire) && lock(&not_kept).is_none() {
                    let place = next.fetch_add(1, Ordering::AcqRel);
                    let Some(&(link, seed)) = mysteries.get(place) else {
                        break;
                    };
                    if lock(&found)[place].is_some() {
                        continue;
                    }
                    let place_of = Place {
                        program: &program,
                        folder,
                        link,
                        seed,
                        interrupted,
                    };
                    let answer = match place_of.hear() {
                        Ok(heard) => LiveAnswer::of(link, seed, &heard),
                        // The commands were ended too: that is no failure of theirs, and no answer.
                        Err(_) if interrupted.load(Ordering::Acquire) => break,
                        Err(reason) => LiveAnswer::failed(link, seed, reason),
                    };
                    if let Err(failure) = folder.keep(&answer) {
                        *lock(&not_kept) = Some(failure);
                    }
                    output::message(&format!(
                        "{} {seed}: hidden {}, answer {}",
                        link.protocol(),
                        answer.hidden,
                        answer.column()
                    ));
                    let mut found = lock(&found);
                    found[place] = Some(answer);
                    progress::at(found.iter().flatten().count());
                }
            });
        }
    });
    if let Some(failure) = lock(&not_kept).take() {
        return Err(failure);
    }
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(found.into_iter().flatten().collect())
}

/// Every drive of the study, in the order of the page.
pub(super) fn mysteries(drives: u64, seed: u64) -> Vec<(LiveLink, u64)> {
    let of = |link| (seed..seed.saturating_add(drives)).map(move |seed| (link, seed));
    LiveLink::ALL.into_iter().flat_map(of).collect()
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn bench_path(folder: &Path, link: LiveLink) -> PathBuf {
    folder.join(format!("{}.toml", link.protocol()))
}

/// The embedded bench over another link.
fn bench_text(link: LiveLink) -> String {
    let (rate_hz, baud) = link.pace();
    let line = |line: &str| match line.split_once(" = ") {
        Some(("protocol", _)) => format!("protocol = \"{}\"", link.protocol()),
        Some(("rate_hz", _)) => format!("rate_hz = {rate_hz:.1}"),
        Some(("baud", _)) => format!("baud = {baud}"),
        _ => line.to_owned(),
    };
    let lines: Vec<String> = EMBEDDED_DEFAULT.lines().map(line).collect();
    lines.join("\n") + "\n"
}

/// One mystery over one link.
struct Place<'a> {
    program: &'a Path,
    folder: &'a LiveFolder,
    link: LiveLink,
    seed: u64,
    interrupted: &'a AtomicBool,
}

impl Place<'_> {
    /// `run` twice, `diagnose`, and `add` for every name.
    fn hear(&self) -> Result<Heard, String> {
        let clear = self.folder.clear(self.link, self.seed);
        clear.map_err(|failure| failure.headline().to_owned())?;
        let runs = self.folder.drive(self.link, self.seed);
        let mut folders = Vec::new();
        for run_seed in RUN_SEEDS {
            let bench = bench_path(self.folder.path(), self.link);
            self.json(
                Command::new(self.program)
                    .arg("run")
                    .arg(&bench)
                    .args(["--headless", "--json", "--mystery", &self.seed.to_string()])
                    .args(["--run-seed", &run_seed.to_string(), "--out"])
                    .arg(&runs),
            )?;
            folders.push(newest_run(&runs)?);
        }
        let held_out = |command: &mut Command| {
            command.arg("--holdout").arg(&folders[1]).arg("--json");
        };
        let mut diagnose = Command::new(self.program);
        diagnose.arg("diagnose").arg(&folders[0]);
        held_out(&mut diagnose);
        let diagnosis = self.json(&mut diagnose)?;
        let mut last_add = None;
        let mut model: Option<PathBuf> = None;
        for (number, effect) in named(&diagnosis).iter().enumerate() {
            let written = runs.join(format!("model-{}.toml", number + 1));
            let mut add = Command::new(self.program);
            add.args(["add", effect, "--run"]).arg(&folders[0]);
            held_out(&mut add);
            add.arg("--output").arg(&written);
            if let Some(model) = &model {
                add.arg("--model").arg(model);
            }
            last_add = Some(self.answer(&mut add)?.1);
            if !written.is_file() {
                // Refused, and the diagnosis stands as it is.
                break;
            }
            model = Some(written);
        }
        Ok(Heard {
            diagnosis,
            last_add,
            rows_per_s: rows_per_s(&folders[0])?,
        })
    }

    /// What a command prints that must succeed.
    fn json(&self, command: &mut Command) -> Result<Value, String> {
        let (succeeded, value) = self.answer(command)?;
        let ended = || format!("a command ended with another status than 0: {command:?}");
        succeeded.then_some(value).ok_or_else(ended)
    }

    /// Starts the command and reads what it prints, and whether it succeeded; an error is its last line.
    fn answer(&self, command: &mut Command) -> Result<(bool, Value), String> {
        let done = self
            .output(command)
            .map_err(|error| format!("{}: {error}", self.program.display()))?;
        let stderr = String::from_utf8_lossy(&done.stderr);
        let error = || {
            let mut lines = stderr.lines().filter(|line| line.starts_with("error"));
            lines.next_back().unwrap_or("no result").to_owned()
        };
        let value = serde_json::from_slice(&done.stdout).map_err(|_| error())?;
        Ok((done.status.success(), value))
    }

    /// Runs the command to its end. Where the study is interrupted the command is too: it stops its motor in its own way.
    fn output(&self, command: &mut Command) -> io::Result<Output> {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        std::thread::scope(|scope| {
            let stdout = scope.spawn(|| read(stdout));
            let stderr = scope.spawn(|| read(stderr));
            let mut is_told = false;
            let status = loop {
                if let Some(status) = child.try_wait()? {
                    break status;
                }
                if self.interrupted.load(Ordering::Acquire) && !is_told {
                    is_told = true;
                    // Not waited for yet, so the number is still its own.
                    let id = i32::try_from(child.id()).map_err(io::Error::other)?;
                    kill(Pid::from_raw(id), Signal::SIGTERM)?;
                }
                std::thread::sleep(LOOK);
            };
            Ok(Output {
                status,
                stdout: stdout.join().unwrap_or_default(),
                stderr: stderr.join().unwrap_or_default(),
            })
        })
    }
}

/// Everything until the end; of a pipe that breaks what came before.
fn read(pipe: Option<impl io::Read>) -> Vec<u8> {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        let _ = pipe.read_to_end(&mut bytes);
    }
    bytes
}

/// Effects that are named with certainty; of a set that cannot be told apart none is added.
fn named(diagnosis: &Value) -> Vec<String> {
    if diagnosis["verdict"] != "effect" {
        return Vec::new();
    }
    let effects = diagnosis["effects"].as_array().into_iter().flatten();
    effects
        .filter_map(Value::as_str)
        .map(str::to_owned)
        .collect()
}

/// Run folders begin with their time, so that the last one is the newest.
fn newest_run(runs: &Path) -> Result<PathBuf, String> {
    let entries = fs::read_dir(runs).map_err(|error| format!("{}: {error}", runs.display()))?;
    let folders = entries.filter_map(Result::ok).map(|entry| entry.path());
    let newest = folders
        .filter(|path| path.join("samples.csv").is_file())
        .max();
    newest.ok_or_else(|| format!("{}: holds no run", runs.display()))
}

fn rows_per_s(run: &Path) -> Result<f64, String> {
    let loaded = open_run(run, None).map_err(|error| error.to_string())?;
    let times = loaded.run.time_s();
    match times {
        [first, .., last] => Ok((times.len() - 1) as f64 / (last - first)),
        _ => Err(format!("{}: has no rows", run.display())),
    }
}
