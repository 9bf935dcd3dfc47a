//! The mysteries of `reproduce discovery`: the program itself, started as a person would, in virtual time.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;
use serde_json::Value;

use super::failure::{Failure, INTERNAL};
use super::{output, progress};
use crate::workflow::reproduce::study::MysteryAnswer;

/// Commissions `count` mystery drives, the first with `seed`. `None` where it was interrupted: a part of a study would not be
/// the study.
pub(super) fn commission(
    count: u64,
    seed: u64,
    interrupted: &AtomicBool,
) -> Result<Option<Vec<MysteryAnswer>>, Failure> {
    let internal = |what: &str, error: &std::io::Error| {
        Failure::new(INTERNAL, format!("cannot {what}: {error}"))
    };
    let program = std::env::current_exe().map_err(|error| internal("find this program", &error))?;
    let place = std::env::temp_dir().join(format!("drivebench-mysteries-{}", std::process::id()));
    std::fs::create_dir_all(&place)
        .map_err(|error| internal("make a folder for the runs", &error))?;
    let seeds: Vec<u64> = (seed..seed.saturating_add(count)).collect();
    progress::stage("commissions mystery drives", seeds.len());
    let done = AtomicUsize::new(0);
    let answers: Vec<Option<MysteryAnswer>> = seeds
        .into_par_iter()
        .with_max_len(1)
        .map(|seed| {
            if interrupted.load(Ordering::Acquire) {
                return None;
            }
            let answer = match said(&program, &place.join(seed.to_string()), seed) {
                Ok(said) => MysteryAnswer::of(seed, &said),
                Err(reason) => MysteryAnswer::failed(seed, reason),
            };
            output::message(&format!(
                "mystery {seed}: hidden {}, answer {}",
                answer.hidden,
                answer.column()
            ));
            progress::at(1 + done.fetch_add(1, Ordering::AcqRel));
            Some(answer)
        })
        .collect();
    // What stays of it is the system's to clear.
    let _ = std::fs::remove_dir_all(&place);
    // A signal ends the programs that were started, too: what they said of that is no answer.
    let is_whole = !interrupted.load(Ordering::Acquire);
    Ok(answers
        .into_iter()
        .collect::<Option<Vec<_>>>()
        .filter(|_| is_whole))
}

/// What the program prints of one mystery; an error is its last line.
fn said(program: &Path, runs: &Path, seed: u64) -> Result<Value, String> {
    let done = Command::new(program)
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
