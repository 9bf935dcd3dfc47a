//! The test kit: the real binary run to its end, a folder for the files of a test, and readers of what a run leaves.
//!
//! ```text
//! process.rs   the binary as a process that is watched and ended, the emulator among them; a machine that stands still
//! terminal.rs  the binary in a pseudo-terminal: the screen as a person sees it, keys as a person presses them
//! lab.rs       a bench file and its drive in a process of its own, for runs in real time
//! motor_log.rs a record of a motor as a foreign program would write it, with noise
//! ```
#![allow(dead_code, reason = "each test binary uses its part")]
#![allow(unused_imports, reason = "each test file uses its part")]

pub(crate) mod lab;
pub(crate) mod motor_log;
pub(crate) mod process;
pub(crate) mod terminal;

/// What nearly every test uses.
pub(crate) mod prelude {
    pub(crate) use std::fmt::Write as _;
    pub(crate) use std::fs;
    pub(crate) use std::path::{Path, PathBuf};

    pub(crate) use nix::sys::signal::Signal;
    pub(crate) use serde_json::{Value, json};

    pub(crate) use super::process::{
        Emulator, Process, at_once, in_real_time, unless_it_stood_still, wait_for,
    };
    pub(crate) use super::terminal::Session;
    pub(crate) use super::{
        BENCH, BINARY, Desk, Done, HIDDEN, MODEL, PLAIN, Recorded, Runs, call, capture, cases,
        column, drivebench, expect_near, has, json_of, lacks, line, number, only_folder, parameter,
        points, read_json, recorded, refusal, refusals, roboteq_of_120_v, word,
    };
}

use std::ffi::OsStr;
use std::ops::Deref;
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;

use prelude::*;
use tempfile::TempDir;

/// The default bench, its drive, and the same drive that hides nothing.
pub(crate) const BENCH: &str = include_str!("../../bench-configs/benches/zk-22fc-emulated.toml");
pub(crate) const HIDDEN: &str = include_str!("../../bench-configs/emulators/zk-22fc-hidden.toml");
pub(crate) const PLAIN: &str = include_str!("../../bench-configs/emulators/zk-22fc-plain.toml");

/// Model file of the motor of paper A.
pub(crate) const MODEL: &str = "[motor]
name = \"ZK-22FC\"
resistance_ohm = 1.1
inductance_h = 0.0099
back_emf_v_s_per_rad = 0.3538
inertia_kg_m2 = 0.0045
load_torque_n_m = 0.455
";

/// Profile of a controller whose supply is known: one raw unit, a thousandth of 120 V, is 0.12 V, so that it takes voltages.
pub(crate) fn roboteq_of_120_v() -> String {
    let text = include_str!("../../bench-configs/drives/roboteq-dc.toml");
    let from = "scale = 0.1\nunit = \"%\"\nquantity = \"duty\"\nlimits = [-100, 100]";
    let to = "scale = 0.12\nunit = \"V\"\nquantity = \"voltage\"\nlimits = [-120, 120]";
    has(text, &[from]);
    text.replace(from, to)
}

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
        fs::write(&path, text).expect("written");
        path
    }

    /// Model file of the motor that `motor_log` records.
    pub(crate) fn nameplate(&self) -> PathBuf {
        self.put("nameplate.toml", MODEL)
    }

    /// Runs the program to its end in this folder, as a person does: paths are relative.
    pub(crate) fn call(&self, text: &str) -> Done {
        let mut command = command(text.split_whitespace());
        Done::of(&command.current_dir(self.folder()).output().expect("the program can be started"))
    }

    /// The folder of the runs.
    pub(crate) fn out(&self) -> PathBuf {
        self.path("runs")
    }

    /// The only run.
    #[track_caller]
    pub(crate) fn run(&self) -> PathBuf {
        only_folder(&self.out())
    }

    /// A file of the only run.
    #[track_caller]
    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.run().join(name)).expect("the run has the file")
    }

    #[track_caller]
    pub(crate) fn manifest(&self) -> Value {
        read_json(self.run().join("manifest.json"))
    }

    /// `command` in virtual time, in which no machine stands still: `{}` in the options are the paths.
    pub(crate) fn simulate(&self, command: &str, options: &str, paths: &[&Path]) -> Done {
        let mut arguments = line(&format!("{command} --port sim: --json --out"), &[]);
        arguments.push(self.out());
        arguments.extend(line(options, paths));
        drivebench(arguments)
    }

    /// Runs a command on a file of this text.
    pub(crate) fn on(&self, command: &str, text: &str) -> Done {
        let file = self.put("log.csv", text);
        call(command, &[&file])
    }
}

pub(crate) const BINARY: &str = env!("CARGO_BIN_EXE_drivebench");

/// What a finished command left behind.
#[derive(Default)]
pub(crate) struct Done {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Done {
    pub(crate) fn of(output: &Output) -> Self {
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        Self {
            // A process ended by a signal has no status of its own.
            status: output.status.code().unwrap_or(-1),
            stdout: text(&output.stdout),
            // A sentence that was folded at the edge of the terminal is one line again.
            stderr: text(&output.stderr).replace("\n  ", " "),
        }
    }

    /// The command ended with this status and an error that says all of it.
    #[track_caller]
    pub(crate) fn fails(self, status: i32, parts: &[&str]) -> Self {
        let done = self.expect(status);
        has(&done.error(), parts);
        done
    }

    #[track_caller]
    pub(crate) fn expect(self, status: i32) -> Self {
        assert_eq!(self.status, status, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
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
    Done::of(&command(arguments).output().expect("the program can be started"))
}

/// The folder of a run, which goes with it.
pub(crate) struct Recorded {
    run: PathBuf,
    _desk: Desk,
}

impl Deref for Recorded {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.run
    }
}

/// A run in virtual time; `{}` in the options are the paths.
#[track_caller]
pub(crate) fn recorded(options: &str, paths: &[&Path]) -> Recorded {
    let desk = Desk::new();
    desk.simulate("run --headless", options, paths).expect(0);
    Recorded { run: desk.run(), _desk: desk }
}

/// Two runs of one emulated motor, for fit and hold-out; made once, the tests only read them.
pub(crate) struct Runs {
    pub(crate) fit: Recorded,
    pub(crate) holdout: Recorded,
    /// The five-parameter model that `run` wrote.
    pub(crate) model: PathBuf,
}

impl Runs {
    fn of(emulator: &str) -> Self {
        let [fit, holdout] = [1, 2].map(|seed| {
            let options = format!("--emulator {emulator} --seed 7 --run-seed {seed}");
            recorded(&options, &[])
        });
        let model = fit.join("model.toml");
        Self { fit, holdout, model }
    }

    /// Stribeck friction is hidden in it.
    pub(crate) fn hidden() -> &'static Self {
        static RUNS: LazyLock<Runs> = LazyLock::new(|| Runs::of("zk-22fc-hidden"));
        &RUNS
    }

    /// The five-parameter model is the truth.
    pub(crate) fn plain() -> &'static Self {
        static RUNS: LazyLock<Runs> = LazyLock::new(|| Runs::of("zk-22fc-plain"));
        &RUNS
    }
}

/// Each part stands in the text.
#[track_caller]
pub(crate) fn has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

/// No part stands in the text.
#[track_caller]
pub(crate) fn lacks(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(!text.contains(part), "{part:?} is in {text}");
    }
}

/// The value is there and within this share of the truth.
#[track_caller]
pub(crate) fn expect_near(name: &str, value: Option<f64>, truth: f64, share: f64) {
    let near = value.is_some_and(|value| (value / truth - 1.0).abs() < share);
    assert!(near, "{name}: {value:?}, not {truth}");
}

/// Arguments from one line; paths are put in as `{}` in order, so that they may hold spaces.
pub(crate) fn line(text: &str, paths: &[&Path]) -> Vec<PathBuf> {
    let mut paths = paths.iter();
    text.split_whitespace()
        .map(|word| match word {
            "{}" => paths.next().map(|p| p.to_path_buf()).expect("a path for each {}"),
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

/// A table of commands that are refused, one a line: `command => part of its error & another part`. Nothing is printed.
#[track_caller]
pub(crate) fn refusals(table: &str, paths: &[&Path]) {
    for row in table.lines().map(str::trim).filter(|row| !row.is_empty()) {
        let (text, parts) = row.split_once(" => ").unwrap_or((row, ""));
        let done = call(text, paths);
        assert_eq!(done.status, 2, "{row}: {}", done.stderr);
        assert_eq!(done.stdout, "", "{row}");
        let error = done.error();
        for part in parts.split(" & ") {
            assert!(error.contains(part.trim()), "{row}: {error}");
        }
    }
}

/// The cells of a table, of which each row has a line.
#[track_caller]
pub(crate) fn cases<const CELLS: usize>(table: &str) -> impl Iterator<Item = [&str; CELLS]> {
    table.lines().filter(|row| !row.is_empty()).map(|row| {
        let cells: Vec<&str> = row.split(" | ").collect();
        cells.try_into().unwrap_or_else(|_| panic!("{row}"))
    })
}

/// The only folder inside `out`.
#[track_caller]
pub(crate) fn only_folder(out: &Path) -> PathBuf {
    let found: Vec<PathBuf> = fs::read_dir(out)
        .expect("the folder of runs is there")
        .map(|entry| entry.expect("an entry can be read").path())
        // `latest` is a link to one of them.
        .filter(|path| !path.is_symlink())
        .collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

pub(crate) fn read_json(path: impl AsRef<Path>) -> Value {
    let text = fs::read_to_string(path).expect("the file is there");
    serde_json::from_str(&text).expect("JSON")
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

/// Link type and records of a capture file.
pub(crate) fn capture(file: &Path) -> (u32, Vec<Vec<u8>>) {
    let bytes = fs::read(file).expect("the capture is there");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    assert_eq!(word(0), 0xA1B2_3C4D);
    let (mut at, mut found) = (24, Vec::new());
    while at < bytes.len() {
        let length = word(at + 8) as usize;
        found.push(bytes[at + 16..at + 16 + length].to_vec());
        at += 16 + length;
    }
    (word(20), found)
}

/// Time and value of each row in which the column has a number; torn and empty cells are left out.
pub(crate) fn points(csv: &str, name: &str) -> Vec<(f64, f64)> {
    let mut rows = csv.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let names = rows.next().unwrap_or_default();
    let place = names.iter().position(|cell| *cell == name);
    rows.filter_map(|row| Some((row[0].parse().ok()?, row.get(place?)?.parse().ok()?))).collect()
}

/// The numbers of one column.
pub(crate) fn column(csv: &str, name: &str) -> Vec<f64> {
    points(csv, name).into_iter().map(|point| point.1).collect()
}
