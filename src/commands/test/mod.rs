//! `test`: a suite of bench tests: which cases, on which bench, how many at once, with a verdict for people and for machines.
//!
//! ```text
//! SUITE.toml -> Suite -> cases x repeats -> [ case.rs: a process for each step ] -> SuiteOutcome -> lines, JUnit, metrics, JSON
//!                                                own_drive.rs: a software drive in a process of its own
//! ```
//!
//! In virtual time as many cases run at once as the machine has cores; over a line they run one after the other, but for cases
//! with a drive of their own, which mostly wait. `baseline`: earlier runs and results, and what has drifted since.

pub(crate) mod baseline;
mod case;
pub(crate) mod golden;
mod own_drive;
mod process;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

use baseline::Baseline;
use case::Bench;
use clap::CommandFactory as _;
use process::Watch;

use crate::commands::arguments::shard;
use crate::runtime::{Failure, INTERRUPTED, Terminal, opening, output, read_text, signals};
use crate::workflow::suite::{
    Action, Case, CaseOutcome, Need, Suite, SuiteOutcome, Verb, Verdict, junit, open_metrics,
};
use drivebench_bench::Port;
use drivebench_bench::recording::{RunFolder, utc_stamp};

/// Run a suite of bench tests, on the software drive or a real one: cases of steps, limits, a verdict for each
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench test bench-configs/suites/acceptance.toml                        the software drive, in virtual time
  drivebench test suite.toml --junit junit.xml --json > result.json           for a CI job
  drivebench test suite.toml --filter smoke --port /dev/ttyUSB0 --hardware    the same cases on the bench
  drivebench test suite.toml --baseline suites/MARCH/result.json              what has drifted since then
  drivebench test suite.toml --shard 2/4                                      the second quarter, on one of four machines

Each step is a command of this program, with the options that its --help has. The motor is stopped by the guard of that
command, also where a step fails or runs out of its time, and else by the drive's watchdog: no step has to do it.
Exit status: 0 all passed or skipped; 1 a limit was not kept; else that of the steps that ended their cases.")]
pub(super) struct Arguments {
    /// The suite
    suite: PathBuf,
    /// Instead of the ports that the suite names: a serial port, tcp:HOST:PORT, sim: or emulator
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// The drive is real, its shaft is free and may turn; without it a person at the terminal has to confirm it
    #[arg(long)]
    hardware: bool,
    /// Where the folder of this suite is made, with the evidence of each case that did not pass
    #[arg(long, value_name = "DIR", default_value = "suites")]
    out: PathBuf,
    /// Cases with this word in their name, or as a tag; may be repeated
    #[arg(long, value_name = "WORD")]
    filter: Vec<String>,
    /// Part I of N of the cases
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(u64, u64)>,
    /// Keep the folders of the cases that passed too
    #[arg(long)]
    keep: bool,
    /// Write JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write the figures as OpenMetrics text
    #[arg(long, value_name = "FILE")]
    metrics: Option<PathBuf>,
    /// Compare what the steps that identify find with an earlier run of the same machine, or with result.json of an earlier
    /// suite, and name what has drifted; may be repeated
    #[arg(long, value_name = "RUN")]
    baseline: Vec<PathBuf>,
    /// Compare also where the baseline is of another machine, or of an unknown one
    #[arg(long, requires = "baseline")]
    any_machine: bool,
    /// List the cases and do nothing
    #[arg(long)]
    list: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let name = arguments.suite.display().to_string();
    let suite = Suite::parse(&name, &read_text(&arguments.suite)?, options_of)?;
    if arguments.list {
        return list(&suite, arguments, terminal);
    }
    let outcome = carry_out(&suite, arguments, terminal)?;
    terminal.result(&outcome, arguments.json, text)?;
    match outcome.exit_status() {
        0 => Ok(()),
        status => {
            let headline = format!(
                "{} of {} cases did not pass",
                outcome.failed + outcome.errors,
                outcome.cases.len()
            );
            let help = "each names its folder, with the output of every step";
            Err(Failure::with_help(status, headline, help))
        }
    }
}

fn list(suite: &Suite, arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let cases = selected(suite, &arguments.filter)?;
    let rows: Vec<serde_json::Value> = cases
        .iter()
        .map(|case| serde_json::json!({ "name": case.name, "tags": case.tags, "repeat": case.repeat, "steps": case.steps.len() }))
        .collect();
    terminal.result(&rows, arguments.json, |_| {
        let line = |case: &&Case| {
            let times = if case.repeat > 1 { format!(" x{}", case.repeat) } else { String::new() };
            format!("{}{times}  [{}]", case.name, case.tags.join(", "))
        };
        cases.iter().map(line).collect::<Vec<_>>().join("\n")
    })
}

/// The verdict in a few lines: each case was printed on stderr when it ended.
fn text(outcome: &SuiteOutcome) -> String {
    let mut lines = vec![format!(
        "{}: {} passed, {} failed, {} errors, {} skipped in {:.1} s",
        outcome.suite,
        outcome.passed,
        outcome.failed,
        outcome.errors,
        outcome.skipped,
        outcome.took_s
    )];
    if !outcome.confusion.is_empty() {
        lines.push("hidden effect, and how many diagnoses named which effect for it:".to_owned());
    }
    let width = outcome.confusion.rows.iter().map(String::len).max();
    for (hidden, named) in outcome.confusion.named() {
        let named: Vec<_> = named.iter().map(|(name, count)| format!("{name} {count}")).collect();
        let named = named.join(", ");
        lines.push(format!("  {hidden:<0$}  {named}", width.unwrap_or(0)));
    }
    let wrong = outcome.cases.iter().filter_map(|case| match &case.verdict {
        Verdict::Failed(reason) | Verdict::Error(reason) => {
            Some(format!("{}: {reason}", case.name))
        }
        Verdict::Passed | Verdict::Skipped(_) => None,
    });
    let wrong: Vec<String> = wrong.collect();
    lines.extend(wrong.iter().take(20).flat_map(|line| output::fitted(line)));
    if wrong.len() > 20 {
        lines.push(format!("and {} more", wrong.len() - 20));
    }
    lines.extend(baseline::lines(outcome).iter().flat_map(|line| output::fitted(line)));
    lines.join("\n")
}

/// Long names of the options of the command that a verb is.
fn options_of(verb: Verb) -> Vec<String> {
    super::Arguments::command()
        .find_subcommand(verb.command())
        .into_iter()
        .flat_map(clap::Command::get_arguments)
        .filter_map(|option| option.get_long().map(str::to_owned))
        .collect()
}

/// One case with one of its seeds.
struct Job<'a> {
    case: &'a Case,
    seed: u64,
    port: String,
}

/// The requested cases, each as often as it repeats.
fn jobs<'a>(suite: &'a Suite, arguments: &Arguments) -> Result<Vec<Job<'a>>, Failure> {
    let mut jobs = Vec::new();
    for case in selected(suite, &arguments.filter)? {
        let port = arguments.port.as_ref().or(case.port.as_ref()).map_or("sim:", String::as_str);
        if Port::parse(port).is_none() {
            let headline = format!("case {:?}: {port:?} is not a port", case.name);
            return Err(Failure::usage(
                headline,
                "a serial port, tcp:HOST:PORT, sim:, sim:rtu or emulator",
            ));
        }
        for repeat in 0..case.repeat {
            jobs.push(Job { case, seed: case.seed.wrapping_add(repeat), port: port.to_owned() });
        }
    }
    if let Some((part, of)) = arguments.shard {
        let mut number = 0;
        jobs.retain(|_| {
            number += 1;
            (number - 1) % of == part - 1
        });
    }
    Ok(jobs)
}

/// Cases with one of the words in their name or as a tag; all where there is none.
fn selected<'a>(suite: &'a Suite, filter: &[String]) -> Result<Vec<&'a Case>, Failure> {
    let has = |case: &Case, word: &String| {
        case.tags.contains(word) || case.name.to_lowercase().contains(&word.to_lowercase())
    };
    let is_selected = |case: &&Case| filter.is_empty() || filter.iter().any(|word| has(case, word));
    let cases: Vec<&Case> = suite.cases.iter().filter(is_selected).collect();
    if cases.is_empty() {
        let headline = format!(
            "no case of {:?} has {} in its name or its tags",
            suite.name,
            filter.join(" or ")
        );
        return Err(Failure::usage(headline, "drivebench test SUITE.toml --list shows all"));
    }
    Ok(cases)
}

/// Fails where the suite cannot begin; the results of the cases are in the outcome.
fn carry_out(
    suite: &Suite,
    arguments: &Arguments,
    terminal: &Terminal,
) -> Result<SuiteOutcome, Failure> {
    let jobs = jobs(suite, arguments)?;
    output::refuse_existing(&arguments.junit, "--junit")?;
    output::refuse_existing(&arguments.metrics, "--metrics")?;
    let is_real = |job: &Job<'_>| !Port::parse(&job.port).is_some_and(|port| port.is_emulated());
    let real: Vec<&Job<'_>> = jobs.iter().filter(|job| is_real(job)).collect();
    let mut risks: Vec<String> = real.iter().filter_map(|job| risk(job.case)).collect();
    risks.dedup();
    // Also printed where no confirmation is needed.
    for line in risks {
        terminal.message(&line);
    }
    if !arguments.hardware && !real.is_empty() {
        consent(real.len())?;
    }
    let baseline = Baseline::read(&arguments.baseline, arguments.any_machine)?;
    let program = std::env::current_exe()
        .map_err(|error| Failure::internal(format!("cannot find this program itself: {error}")))?;
    let stop = signals::flag()?;
    let began = opening::now();
    let watch = Watch::start();
    let folder = RunFolder::create(&arguments.out, &utc_stamp(began), &suite.name)?;
    let folder = folder.path();
    let home = arguments.suite.parent().unwrap_or(Path::new(""));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let total = jobs.len();
    let mut outcomes: Vec<Option<CaseOutcome>> = vec![None; total];
    let (in_memory, on_a_line): (Vec<_>, Vec<_>) = jobs
        .iter()
        .enumerate()
        .partition(|(_, job)| Port::parse(&job.port).is_some_and(|port| port.is_virtual()));
    let (by_themselves, on_a_line): (Vec<_>, Vec<_>) =
        on_a_line.into_iter().partition(|(_, job)| job.case.has_own_drive());
    // Real time first and alone: other work would make its cycles late. Cases with a drive of their own mostly wait.
    for (part, at_once) in [(by_themselves, 3), (on_a_line, 1), (in_memory, cores)] {
        let done = Mutex::new(&mut outcomes);
        each(part, at_once, |(index, job)| {
            let bench = Bench {
                program: &program,
                home,
                port: job.port.clone(),
                hardware: is_real(job),
                threads: (cores / at_once).max(1),
                stop: &stop,
                baseline: baseline.as_ref(),
            };
            let own = folder.join(format!("{:04}", index + 1));
            let outcome = match unfit(job, &bench) {
                Some(reason) => CaseOutcome::skipped(job.case, job.seed, reason),
                None => case::carry_out(&bench, job.case, job.seed, &own),
            };
            terminal.message(&line(&outcome, job.case.repeat));
            if outcome.verdict == Verdict::Passed && !arguments.keep {
                // A folder that cannot be removed does no harm.
                let _ = fs::remove_dir_all(own);
            }
            lock(&done)[index] = Some(outcome);
        });
    }
    let mut cases: Vec<CaseOutcome> = outcomes.into_iter().flatten().collect();
    if !arguments.keep {
        for case in cases.iter_mut().filter(|case| case.verdict == Verdict::Passed) {
            case.evidence = None;
        }
    }
    let machine = format!("{} {}", std::env::consts::OS, std::env::consts::ARCH);
    let outcome = SuiteOutcome::of(&suite.name, began.to_string(), machine, watch.took_s(), cases);
    write_results(&outcome, arguments, folder, terminal)?;
    if stop.load(Ordering::Acquire) {
        let headline = format!("interrupted after {} of {total} cases", outcome.cases.len());
        return Err(Failure::new(INTERRUPTED, headline));
    }
    Ok(outcome)
}

/// Why a case is not done on this bench.
fn unfit(job: &Job<'_>, bench: &Bench<'_>) -> Option<String> {
    if bench.stop.load(Ordering::Acquire) {
        return Some("interrupted".to_owned());
    }
    let case = job.case;
    let has_fault = case.steps.iter().any(|step| matches!(step.action, Action::Fault(_)));
    let wants_emulator = case.needs.contains(&Need::Emulator)
        || case.emulator.is_some()
        || has_fault
        || case.has_own_drive();
    if bench.hardware && wants_emulator {
        return Some("it sets up the software drive, and this one is real".to_owned());
    }
    if bench.baseline.is_none() && case.needs.contains(&Need::Baseline) {
        return Some("it compares with an earlier run, and there is no --baseline".to_owned());
    }
    let is_in_memory = Port::parse(&job.port).is_some_and(|port| port.is_virtual());
    let wants_line = case.needs.contains(&Need::Line) || case.has_own_drive();
    (is_in_memory && wants_line)
        .then(|| "it needs a line in real time, and sim: is a drive in memory".to_owned())
}

/// Waived checks and fault resets of a case.
fn risk(case: &Case) -> Option<String> {
    let mut names: Vec<&str> = Vec::new();
    for step in &case.steps {
        let Action::Command { options, .. } = &step.action else {
            continue;
        };
        for (key, value) in options {
            let is_risk = key.starts_with("waive") || key.replace('-', "_") == "reset_fault";
            if is_risk && *value == toml::Value::Boolean(true) && !names.contains(&key.as_str()) {
                names.push(key);
            }
        }
    }
    let names = names.join(", ");
    (!names.is_empty()).then(|| {
        format!(
            "case {:?} sets {names}: checks that keep a real motor safe are waived, or a fault is reset",
            case.name
        )
    })
}

/// A person confirms that the shaft may turn.
fn consent(cases: usize) -> Result<(), Failure> {
    let question = format!(
        "{cases} cases move a real motor, one after the other without a further question. Is the shaft free and nobody near it? Type yes: "
    );
    if output::ask(&question).is_some_and(|answer| answer.trim() == "yes") {
        return Ok(());
    }
    let headline =
        "the port is no software drive, and nobody has confirmed that its motor may turn";
    Err(Failure::link(
        headline,
        "clear the shaft, then give --hardware; --port sim: runs the suite without a drive",
    ))
}

fn write_results(
    outcome: &SuiteOutcome,
    arguments: &Arguments,
    folder: &Path,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let json = serde_json::to_string_pretty(outcome)?;
    let mut files = vec![(folder.join("result.json"), json)];
    if !outcome.confusion.is_empty() {
        files.push((folder.join("confusion.csv"), outcome.confusion.csv()));
    }
    if let Some(path) = &arguments.junit {
        files.push((path.clone(), junit::document(outcome)));
    }
    if let Some(path) = &arguments.metrics {
        files.push((path.clone(), open_metrics::text(outcome)));
    }
    for (path, text) in files {
        terminal.file(&path, &text)?;
    }
    Ok(())
}

/// One line for a case, and beneath it why it did not pass.
fn line(outcome: &CaseOutcome, repeats: u64) -> String {
    let seed = if repeats > 1 { format!(", seed {}", outcome.seed) } else { String::new() };
    let (verdict, reason) = match &outcome.verdict {
        Verdict::Passed => ("PASSED", None),
        Verdict::Failed(reason) => ("FAILED", Some(reason)),
        Verdict::Error(reason) => ("ERROR", Some(reason)),
        Verdict::Skipped(reason) => ("skipped", Some(reason)),
    };
    let mut line = format!("{verdict:<8}{:>7.1} s  {}{seed}", outcome.took_s, outcome.name);
    let evidence = outcome.evidence.as_ref().filter(|_| reason.is_some());
    for text in reason.into_iter().chain(evidence) {
        line.push_str("\n                   ");
        line.push_str(text);
    }
    line
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Works on each in their order, `at_once` at a time.
fn each<T: Send>(
    all: impl IntoIterator<Item = T, IntoIter: Send>,
    at_once: usize,
    work: impl Fn(T) + Sync,
) {
    let all = Mutex::new(all.into_iter());
    // A lock in the head of the loop would be held during the work.
    let next = || lock(&all).next();
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                while let Some(one) = next() {
                    work(one);
                }
            });
        }
    });
}

#[cfg(test)]
mod tests {
    use std::sync::Condvar;
    use std::time::Duration;

    use super::*;

    #[test]
    fn work_runs_as_parallel_as_allowed() {
        let (begun, changed) = (Mutex::new(Vec::new()), Condvar::new());
        each(0..2, 2, |one| {
            lock(&begun).push(one);
            changed.notify_all();
            // Each waits for the other: the timeout ends only a failing test.
            let waited = changed
                .wait_timeout_while(lock(&begun), Duration::from_secs(60), |all| all.len() < 2)
                .unwrap();
            assert!(!waited.1.timed_out(), "one after the other");
        });
        each(2..9, 1, |one| lock(&begun).push(one));
        assert_eq!(begun.into_inner().unwrap()[2..], [2, 3, 4, 5, 6, 7, 8]);
    }
}
