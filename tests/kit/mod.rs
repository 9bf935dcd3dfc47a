//! The test kit: the real binary run to its end, a folder for the files of a test, and readers of what a run leaves.
//!
//! ```text
//! process.rs   the binary as a process that is watched and ended, the emulator among them
//! terminal.rs  the binary in a pseudo-terminal: the screen as a person sees it, keys as a person presses them
//! motor_log.rs a record of a motor as a foreign program would write it, with noise
//! ```
#![allow(dead_code, reason = "each test binary uses its part")]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

pub(crate) mod motor_log;
pub(crate) mod process;
pub(crate) mod terminal;

/// The default bench, its drive, and the same drive that hides nothing.
pub(crate) const BENCH: &str = include_str!("../../bench-configs/benches/zk-22fc-emulated.toml");
pub(crate) const HIDDEN: &str = include_str!("../../bench-configs/emulators/zk-22fc-hidden.toml");
pub(crate) const PLAIN: &str = include_str!("../../bench-configs/emulators/zk-22fc-plain.toml");

/// A folder for the files of one test, gone with them when it is dropped.
pub(crate) struct Desk(TempDir);

impl Desk {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    pub(crate) fn folder(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder().join(name)
    }

    pub(crate) fn put(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).expect("written");
        path
    }

    /// Model file of the motor that `motor_log` records.
    pub(crate) fn nameplate(&self) -> PathBuf {
        self.put("nameplate.toml", &motor_log::nameplate())
    }

    /// Runs a command on a file of this text.
    pub(crate) fn on(&self, command: &str, text: &str) -> Done {
        let file = self.put("log.csv", text);
        call(command, &[&file])
    }
}

pub(crate) const BINARY: &str = env!("CARGO_BIN_EXE_drivebench");

/// What a finished command left behind.
pub(crate) struct Done {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Done {
    pub(crate) fn of(output: &Output) -> Self {
        Self {
            // A process ended by a signal has no status of its own.
            status: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    #[track_caller]
    pub(crate) fn expect(self, status: i32) -> Self {
        assert_eq!(
            self.status, status,
            "stdout:\n{}\nstderr:\n{}",
            self.stdout, self.stderr
        );
        self
    }

    /// The one document on stdout; anything beside it is an error.
    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        for word in ["NaN", "inf", "Infinity"] {
            let bare = format!(": {word}");
            assert!(!self.stdout.contains(&bare), "{word} in {}", self.stdout);
        }
        let parsed = serde_json::from_str(&self.stdout);
        parsed.unwrap_or_else(|error| {
            let seen = format!(
                "stdout is not one JSON document: {error}\n{}\n{}",
                self.stdout, self.stderr
            );
            assert!(seen.is_empty(), "{seen}");
            Value::Null
        })
    }

    /// The error's headline; exactly one `error:` line, and the `help:` line after it is the last one.
    #[track_caller]
    pub(crate) fn error(&self) -> String {
        let lines: Vec<&str> = self.stderr.lines().collect();
        let headlines = lines.iter().filter(|l| l.starts_with("error: ")).count();
        assert_eq!(headlines, 1, "{}", self.stderr);
        assert!(lines.len() >= 2, "{}", self.stderr);
        let [headline, help] = [lines[lines.len() - 2], lines[lines.len() - 1]];
        assert!(headline.starts_with("error: "), "{}", self.stderr);
        assert!(help.len() > "help: ".len(), "{}", self.stderr);
        assert!(help.starts_with("help: "), "{}", self.stderr);
        format!("{headline}\n{help}")
    }
}

pub(crate) fn command<I: IntoIterator<Item = S>, S: AsRef<OsStr>>(arguments: I) -> Command {
    let mut command = Command::new(BINARY);
    command.args(arguments);
    command.stdin(Stdio::null());
    command
}

/// Runs the program to its end.
pub(crate) fn drivebench<I: IntoIterator<Item = S>, S: AsRef<OsStr>>(arguments: I) -> Done {
    Done::of(
        &command(arguments)
            .output()
            .expect("the program can be started"),
    )
}

const ATTEMPTS: u32 = 3;

/// What the program says of a machine that stood still for longer than the silence that host or drive allows.
const STOOD_STILL: [&str; 3] = [
    "link silent",
    "host stood still",
    "no command came within the watchdog time",
];

/// A command in real time, with what it left behind. Where the machine stands still it ends as it must, at zero output:
/// that says nothing of what is tested, so it is told and tried again.
pub(crate) fn in_real_time<T>(mut attempt: impl FnMut() -> (Done, T)) -> (Done, T) {
    for number in 1..ATTEMPTS {
        let (done, left) = attempt();
        if done.status == 0 || !STOOD_STILL.iter().any(|words| done.stderr.contains(words)) {
            return (done, left);
        }
        // Past the capture of the test harness, which keeps the output of a test that passes to itself.
        let told = format!("attempt {number} of {ATTEMPTS}: {}\n", done.stderr);
        let _ = std::io::Write::write_all(&mut std::io::stderr(), told.as_bytes());
    }
    attempt()
}

/// Each part stands in the text.
#[track_caller]
pub(crate) fn has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

/// Arguments from one line; paths are put in as `{}` in order, so that they may hold spaces.
pub(crate) fn line(text: &str, paths: &[&Path]) -> Vec<PathBuf> {
    let mut paths = paths.iter();
    text.split_whitespace()
        .map(|word| match word {
            "{}" => paths
                .next()
                .map(|p| p.to_path_buf())
                .expect("a path for each {}"),
            _ => PathBuf::from(word),
        })
        .collect()
}

/// Runs the program to its end; `{}` in the text are the paths.
pub(crate) fn call(text: &str, paths: &[&Path]) -> Done {
    drivebench(line(text, paths))
}

/// What a command that succeeds answers with `--json`.
#[track_caller]
pub(crate) fn json_of(text: &str, paths: &[&Path]) -> Value {
    call(text, paths).expect(0).json()
}

/// The error of a command that is not understood, or whose files are not.
#[track_caller]
pub(crate) fn refusal(text: &str, paths: &[&Path]) -> String {
    call(text, paths).expect(2).error()
}

/// The only folder inside `out`.
#[track_caller]
pub(crate) fn only_folder(out: &Path) -> PathBuf {
    let found: Vec<PathBuf> = std::fs::read_dir(out)
        .expect("the folder of runs is there")
        .map(|entry| entry.expect("an entry can be read").path())
        .collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

pub(crate) fn read_json(path: impl AsRef<Path>) -> Value {
    let text = std::fs::read_to_string(path).expect("the file is there");
    serde_json::from_str(&text).expect("JSON")
}

/// That of the only run inside `out`.
#[track_caller]
pub(crate) fn manifest(out: &Path) -> Value {
    read_json(only_folder(out).join("manifest.json"))
}

#[track_caller]
pub(crate) fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    assert!(found.is_some(), "no number at {pointer} in {value:#}");
    found.unwrap_or_default()
}

#[track_caller]
pub(crate) fn word<'a>(value: &'a Value, pointer: &str) -> &'a str {
    let found = value.pointer(pointer).and_then(Value::as_str);
    assert!(found.is_some(), "no text at {pointer} in {value:#}");
    found.unwrap_or_default()
}

/// Value of a parameter that was identified.
pub(crate) fn parameter(found: &Value, key: &str) -> Option<f64> {
    found["parameters"][key]["value"].as_f64()
}

/// The numbers of one column; torn and empty cells are left out.
pub(crate) fn column(csv: &str, name: &str) -> Vec<f64> {
    let mut lines = csv.lines();
    let names = lines.next().unwrap_or_default();
    let place = names.split(',').position(|cell| cell == name);
    let cells = lines.filter_map(|row| row.split(',').nth(place?)?.parse().ok());
    cells.collect()
}

/// The record of the newest run inside `out` shows a speed beyond this.
pub(crate) fn turns(out: &Path, faster_than_rad_s: f64) -> bool {
    let samples = || {
        let runs = std::fs::read_dir(out).ok()?;
        let newest = runs.filter_map(|run| Some(run.ok()?.path())).max()?;
        std::fs::read_to_string(newest.join("samples.csv")).ok()
    };
    let is_fast = |speed: &f64| *speed > faster_than_rad_s;
    samples().is_some_and(|text| column(&text, "speed_rad_s").iter().any(is_fast))
}
