//! Endurance: hours of runs over a line with one faulty reply in a hundred, in virtual time. No value is wrong, no run hangs,
//! memory and handles do not grow, and every cycle is a sample, a lost one, or a gap.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};

use super::witness::drive::{BENCH, Drive};
use super::witness::fault::Act;
use super::{
    BenchFile, CheckError, CheckOptions, DriveProfile, Guard, LineClock, Outcome, RunSummary,
    Session, Surroundings, check, of_the_witness, on_a_line, one_run,
};
use crate::describe::layout;
use crate::recording::{CommandRow, Event, Record, RecorderStatus, Row, RowOrder};
use drivebench_model::sample::{Channel, Sample};

/// Ten minutes a run, within the time limit.
fn bench() -> String {
    let (head, _) = BENCH.split_once("[[sequence]]").unwrap();
    let head = head.replace("[limits]\n", "[limits]\ntime_s = 700.0\n");
    let levels = "40.0, -40.0, 60.0, -60.0, 30.0, -30.0, 50.0, -50.0, 35.0, -35.0";
    format!(
        "{head}[[sequence]]\nstandstill = {{ seconds = 0.6 }}\n[[sequence]]\nsteps = {{ levels_v = [{levels}], hold_s = 60.0 }}\n"
    )
}

/// Keeps no row; compares every sample with the truth.
struct Comparison {
    order: RowOrder,
    there: Arc<Mutex<Surroundings>>,
    samples: u64,
    lost: u64,
    wrong: Vec<String>,
}

impl Record for Comparison {
    fn command(&mut self, command: &CommandRow) {
        self.order.command(*command);
    }

    fn row(&mut self, sample: &Sample) -> &[Row] {
        self.samples += 1;
        let truth_rad = {
            let mut there = self.there.lock().unwrap();
            // The witness's logs would fill the memory.
            let old = there.drive.log.len().saturating_sub(1000);
            there.drive.log.drain(..old);
            there.commands.clear();
            there.drive.angle_rad()
        };
        let angle_rad = sample.get(Channel::Angle).unwrap_or(f64::NAN);
        // Largest turn between the reading and the next request that reaches the witness; a value of the cycle before is off
        // by more than twice as much at the speeds of this run.
        if (angle_rad - truth_rad).abs() >= 0.9 || angle_rad.is_nan() {
            let time_s = sample.time_s;
            self.wrong.push(format!("{time_s} s: {angle_rad} rad, true {truth_rad}"));
        }
        self.order.sample(sample)
    }

    fn flush(&mut self) -> &[Row] {
        self.order.finish()
    }

    fn event(&mut self, event: Event) {
        self.lost += u64::from(event.event == "reply_lost");
    }

    fn status(&self) -> RecorderStatus {
        RecorderStatus::default()
    }
}

/// Resident memory, pages, and open files of this process.
fn resources() -> (u64, usize) {
    let text = std::fs::read_to_string("/proc/self/statm").expect("procfs has them");
    let pages = text.split(' ').nth(1).and_then(|word| word.parse().ok());
    let files = std::fs::read_dir("/proc/self/fd").expect("procfs has them");
    (pages.expect("pages are a number"), files.count())
}

#[derive(Debug, Default)]
struct Account {
    runs: u64,
    done: u64,
    cycles: u64,
    missed: u64,
    samples: u64,
    lost: u64,
}

fn checked_run(
    bench: &BenchFile,
    profile: &DriveProfile,
    link: &mut dyn drivebench_link::DriveLink,
    clock: &mut LineClock,
    comparison: &mut Comparison,
    last_seq: u64,
) -> RunSummary {
    let nameplate = bench.nameplate().unwrap();
    let first_move = CheckOptions::first_move(bench.link.rate_hz, &nameplate, profile);
    let options = CheckOptions { reset_fault: true, ..first_move };
    // A reply that is lost on the way ends the checks, as it must; they are made again.
    let mut checked = check(link, clock, &bench.limits(), options);
    while let Err(CheckError::Link(error)) = &checked {
        assert!(error.is_transient(), "{error}");
        checked = check(link, clock, &bench.limits(), options);
    }
    let report = checked.unwrap();
    assert!(report.refusal().is_none(), "{:?}", report.refusal());
    comparison.order = RowOrder::new(layout(&[Channel::VoltageCmd], &report.signals));
    let guard = Guard::new(bench.limits(), &nameplate, None).with_period(bench.period_s());
    let session = Session::new(Box::new(bench.program(1).unwrap()), guard)
        .after_seq(last_seq.max(report.last_seq))
        .with_rest(&report.rest);
    let (_sender, intents) = channel();
    one_run(session, bench, link, clock, comparison, (&AtomicBool::new(false), &intents))
}

/// Runs, one after the other, until so many seconds have passed; `after_run` gets the account of each.
fn soak(seconds: f64, mut after_run: impl FnMut(&Account, f64)) -> Account {
    let (profile, bench) = of_the_witness(&bench());
    let interrupted = Arc::new(AtomicBool::new(false));
    // Of a thousand replies ten are late by 30 ms, lost, doubled, damaged, cut short, split, another unit's or among garbage.
    let drive = Drive::new(Act::RoughLine(0.03, 10), 1);
    let there = Surroundings::new(drive, None, &interrupted, None);
    let there = Arc::new(Mutex::new(there));
    let mut account = Account::default();
    let mut comparison = Comparison {
        order: RowOrder::new(layout(&[Channel::VoltageCmd], &[])),
        there: Arc::clone(&there),
        samples: 0,
        lost: 0,
        wrong: Vec::new(),
    };
    on_a_line(&profile, Arc::clone(&there), |link, time| {
        let mut clock = LineClock(time, there);
        let mut last_seq = 0;
        while time.now_s() < seconds {
            let (samples, lost) = (comparison.samples, comparison.lost);
            let summary =
                checked_run(&bench, &profile, link, &mut clock, &mut comparison, last_seq);
            last_seq += summary.timing.cycles + 100;
            let ended = matches!(summary.outcome, Outcome::Done | Outcome::LinkLost { .. });
            assert!(ended, "{:?}: {:?}", summary.outcome, summary.notices);
            assert_eq!(summary.stop_error, None);
            let stop = summary.stop.as_ref().unwrap();
            assert!(stop.confirmed_after_ms.is_some(), "{stop:?}");
            assert!(summary.link.balances(), "{:?}", summary.link);
            let timing = summary.timing;
            // Every deadline of the run was a cycle or is counted as missed, and every cycle a sample or a lost one.
            let due = summary.duration_s * bench.link.rate_hz;
            let deadlines = (timing.cycles + timing.missed_cycles) as f64;
            assert!((deadlines - due).abs() <= 30.0, "{deadlines} of {due}");
            let recorded = comparison.samples - samples + comparison.lost - lost;
            // Some cycles are before the drive is found at rest, or after its last reply.
            let range = timing.cycles.saturating_sub(5)..=timing.cycles + 1;
            assert!(range.contains(&recorded), "{recorded} of {} cycles", timing.cycles);
            assert_eq!(comparison.wrong, [""; 0]);
            account.runs += 1;
            account.done += u64::from(summary.outcome == Outcome::Done);
            account.cycles += timing.cycles;
            account.missed += timing.missed_cycles;
            (account.samples, account.lost) = (comparison.samples, comparison.lost);
            after_run(&account, time.now_s());
        }
    });
    account
}

#[test]
fn a_quarter_of_an_hour_over_a_poor_line_brings_no_wrong_value() {
    let account = soak(900.0, |_, _| {});
    assert!(account.samples > 40_000, "{account:?}");
    assert!(account.lost > 20, "the line is not poor: {account:?}");
}

/// Alone in its process: `cargo test --lib endurance -- --ignored --nocapture`.
#[test]
#[ignore = "24 h of virtual time take minutes"]
fn a_day_over_a_poor_line_gives_no_wrong_value() {
    let mut first = None;
    let account = soak(86_400.0, |account, now_s| {
        if now_s > 3600.0 && first.is_none() {
            first = Some(resources());
        }
        if account.runs.is_multiple_of(24) {
            println!("{:.1} h: {account:?}, {:?}", now_s / 3600.0, resources());
        }
    });
    let (first, last) = (first.unwrap(), resources());
    println!("{account:?}: pages and files {first:?} after an hour, {last:?} at the end");
    assert!(last.0 <= first.0 + 512, "{first:?}, {last:?}");
    assert_eq!(last.1, first.1, "files are left open");
}
