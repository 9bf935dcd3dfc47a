//! The order of work of a study of the diagnosis: machines whose truth is known, then mystery drives commissioned by the
//! program itself, started as a person would, in virtual time.

use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;
use serde_json::Value;

use drivebench::runtime::{Failure, Terminal, signals};

use super::{Answer, MysteryAnswer, Outcome, RecordAnswer, Size, Study, files, records, run};
use crate::lines::{KINDS, line_study};

/// Name under which this binary is the program that commissions.
pub const PROGRAM: &str = "drivebench";

/// Records of each kind of line.
const LINE_RUNS: usize = 40;

/// Runs the study with its progress on stderr; a signal ends it after the sets that are under way. `folder`: where public
/// records of real machines are.
pub fn study(
    sets: u64,
    mysteries: u64,
    seed: u64,
    folder: Option<&Path>,
    terminal: &Terminal,
) -> Result<Study, Failure> {
    // Before the study, which takes long.
    let real = folder.map_or(Ok(Vec::new()), real_records)?;
    let size = Size { sets, seed, reduced: false };
    if size.sets == 0 && mysteries == 0 {
        return Err(Failure::usage(
            "--sets 0 --mysteries 0 leaves nothing to study",
            "give one of them a number of at least 1",
        ));
    }
    let interrupted = signals::flag()?;
    let ended = || {
        let headline =
            "interrupted: a part of the machines is not the study, so no page was written";
        let help = "start it again, with a smaller --sets where it takes too long";
        Failure::interrupted(headline).helped_by(Some(help))
    };
    terminal.message(&format!(
        "{} machines are excited and diagnosed, {mysteries} mystery drives are commissioned; Ctrl-C ends it",
        size.machines()
    ));
    terminal.stage("excites and diagnoses machines", size.machines());
    let mut found =
        run(size, &interrupted, |done, _, answer| report_answer(done, answer, terminal))
            .ok_or_else(ended)?;
    if size.sets > 0 {
        terminal.stage("identifies over every kind of line", KINDS);
        found.lines = Some(line_study(LINE_RUNS, size.seed, |done| terminal.at(done)));
    }
    if mysteries > 0 {
        let answers = commission(mysteries, size.seed, &interrupted, terminal)?;
        found.mysteries = answers.ok_or_else(ended)?;
    }
    found.records = real;
    Ok(found)
}

/// The diagnoses of the records in a folder.
fn real_records(folder: &Path) -> Result<Vec<RecordAnswer>, Failure> {
    let found = records(folder);
    if found.is_empty() {
        let (folder, files) = (folder.display(), files().collect::<Vec<_>>().join(", "));
        let headline = format!("--records {folder}: none of the records is there");
        let help = format!("put one of these files into it: {files}");
        return Err(Failure::usage(headline, help));
    }
    Ok(found)
}

/// How far it is, and every wrong name at once.
fn report_answer(done: usize, answer: &Answer, terminal: &Terminal) {
    if matches!(answer.outcome, Outcome::Wrong | Outcome::Failed) {
        let (group, excitation) = (answer.group.name(), &answer.excitation);
        let (hidden, sentence) = (&answer.class, &answer.sentence);
        terminal.message(&format!("{group} ({excitation}), hidden {hidden}: {sentence}"));
    }
    terminal.at(done);
}

/// Commissions `count` mystery drives, the first with `seed`. `None` where it was interrupted: a part of a study would not be
/// the study.
fn commission(
    count: u64,
    seed: u64,
    interrupted: &AtomicBool,
    terminal: &Terminal,
) -> Result<Option<Vec<MysteryAnswer>>, Failure> {
    let internal =
        |what: &str, error: std::io::Error| Failure::internal(format!("cannot {what}: {error}"));
    let program = std::env::current_exe().map_err(|error| internal("find this program", error))?;
    let place = std::env::temp_dir().join(format!("drivebench-mysteries-{}", std::process::id()));
    let made = std::fs::create_dir_all(&place);
    made.map_err(|error| internal("make a folder for the runs", error))?;
    let seeds: Vec<u64> = (seed..seed.saturating_add(count)).collect();
    terminal.stage("commissions mystery drives", seeds.len());
    let done = AtomicUsize::new(0);
    let one = |seed: u64| {
        if interrupted.load(Ordering::Acquire) {
            return None;
        }
        let answer = match printed(&program, &place.join(seed.to_string()), seed) {
            Ok(result) => MysteryAnswer::of(seed, &result),
            Err(reason) => MysteryAnswer::failed(seed, reason),
        };
        let (hidden, column) = (&answer.hidden, answer.column());
        terminal.message(&format!("mystery {seed}: hidden {hidden}, answer {column}"));
        terminal.at(1 + done.fetch_add(1, Ordering::AcqRel));
        Some(answer)
    };
    let answers: Option<Vec<MysteryAnswer>> =
        seeds.into_par_iter().with_max_len(1).map(one).collect();
    // A remainder is left to the system's cleaning of temporary files.
    let _ = std::fs::remove_dir_all(&place);
    // A signal ends the programs that were started, too: their output is no answer.
    let is_whole = !interrupted.load(Ordering::Acquire);
    Ok(answers.filter(|_| is_whole))
}

/// What the program prints of one mystery; an error is its last line.
fn printed(program: &Path, runs: &Path, seed: u64) -> Result<Value, String> {
    let done = Command::new(program)
        .arg0(PROGRAM)
        .args(["commission", "--headless", "--port", "sim:", "--json"])
        .args(["--mystery", &seed.to_string(), "--out"])
        .arg(runs)
        .stdin(Stdio::null())
        .output()
        .map_err(|error| format!("{}: {error}", program.display()))?;
    let _ = std::fs::remove_dir_all(runs);
    let stderr = String::from_utf8_lossy(&done.stderr);
    let error = || {
        let mut lines = stderr.lines().filter(|line| line.starts_with("error"));
        lines.next_back().unwrap_or("no result").to_owned()
    };
    serde_json::from_slice(&done.stdout).map_err(|_| error())
}
