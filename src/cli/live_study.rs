//! `reproduce discovery --live`: the program itself, started as a person would, on mystery drives in real time.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use serde_json::Value;

use super::failure::{Failure, INTERNAL};
use super::{output, progress};
use crate::bench::EMBEDDED_DEFAULT;
use crate::recording::open_run;
use crate::workflow::reproduce::discovery::{Heard, LiveAnswer, LiveLink};

/// Runs of each mystery: one to fit, one held out.
const RUN_SEEDS: [u64; 2] = [1, 2];

/// Runs `drives` mysteries over each link, the first with `seed`; their runs are kept in `folder`. `None` where it was
/// interrupted.
pub(super) fn live_study(
    drives: u64,
    seed: u64,
    folder: &Path,
    interrupted: &AtomicBool,
) -> Result<Option<Vec<LiveAnswer>>, Failure> {
    let program = std::env::current_exe()
        .map_err(|error| Failure::new(INTERNAL, format!("cannot find this program: {error}")))?;
    let mysteries: Vec<(LiveLink, u64)> = LiveLink::ALL
        .into_iter()
        .flat_map(|link| (seed..seed + drives).map(move |seed| (link, seed)))
        .collect();
    for link in LiveLink::ALL {
        let path = bench_path(folder, link);
        fs::write(&path, bench_text(link)).map_err(|error| {
            Failure::new(
                INTERNAL,
                format!("{}: cannot write: {error}", path.display()),
            )
        })?;
    }
    progress::stage("runs mystery drives", mysteries.len());
    let next = AtomicUsize::new(0);
    let answers = Mutex::new(Vec::new());
    // Most of the time a drive is waited for, but its clock must not.
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while !interrupted.load(Ordering::Acquire) {
                    let place = next.fetch_add(1, Ordering::AcqRel);
                    let Some(&(link, seed)) = mysteries.get(place) else {
                        break;
                    };
                    let place_of = Place {
                        program: &program,
                        folder,
                        link,
                        seed,
                    };
                    let answer = match place_of.hear() {
                        Ok(heard) => LiveAnswer::of(link, seed, &heard),
                        Err(reason) => LiveAnswer::failed(link, seed, reason),
                    };
                    output::message(&format!(
                        "{} {seed}: hidden {}, answer {}",
                        link.protocol(),
                        answer.hidden,
                        answer.column()
                    ));
                    if let Ok(mut answers) = answers.lock() {
                        answers.push((place, answer));
                        progress::at(answers.len());
                    }
                }
            });
        }
    });
    let mut answers = answers.into_inner().unwrap_or_default();
    answers.sort_by_key(|(place, _)| *place);
    let whole = answers.len() == mysteries.len() && !interrupted.load(Ordering::Acquire);
    Ok(whole.then(|| answers.into_iter().map(|(_, answer)| answer).collect()))
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
    folder: &'a Path,
    link: LiveLink,
    seed: u64,
}

impl Place<'_> {
    /// `run` twice, `diagnose`, and `add` for every name.
    fn hear(&self) -> Result<Heard, String> {
        let runs = self
            .folder
            .join(format!("{}-{}", self.link.protocol(), self.seed));
        let mut folders = Vec::new();
        for run_seed in RUN_SEEDS {
            let bench = bench_path(self.folder, self.link);
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
        let done = command
            .stdin(Stdio::null())
            .output()
            .map_err(|error| format!("{}: {error}", self.program.display()))?;
        let stderr = String::from_utf8_lossy(&done.stderr);
        let error = || {
            let mut lines = stderr.lines().filter(|line| line.starts_with("error"));
            lines.next_back().unwrap_or("no result").to_owned()
        };
        let value = serde_json::from_slice(&done.stdout).map_err(|_| error())?;
        Ok((done.status.success(), value))
    }
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
