//! The real binary as the tests of the command line use it: run, read the JSON, check the two lines of an error.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

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
#[allow(dead_code, reason = "not every test file makes runs in real time")]
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

/// The only folder inside `out`.
#[allow(dead_code, reason = "not every test file makes runs")]
#[track_caller]
pub(crate) fn only_folder(out: &Path) -> PathBuf {
    let found: Vec<PathBuf> = std::fs::read_dir(out)
        .expect("the folder of runs is there")
        .map(|entry| entry.expect("an entry can be read").path())
        .collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}
