//! Every fault in every way of running with ten seeds, in virtual time, against an independent drive (the witness).
//!
//! ```text
//! witness (tests/witness: codec, motor, log, faults) <- bytes -> line in memory -> [ link, checks, session, runner ]
//!        '-- verdict, by its own log
//! ```
//!
//! Faults of a process (a signal that kills it, a file that cannot be written) have their trials in real time.

mod endurance;
mod hidden;
#[path = "../../../../tests/witness/mod.rs"]
mod witness;

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use super::bench_file::BenchFile;
use super::check::{CheckError, CheckOptions, check};
use super::clock::Clock;
use super::guard::Guard;
use super::live_online::RowEstimator;
use super::mechanics::DriveFacts;
use super::runner::{Bench, RunOptions, RunSummary, run};
use super::session::{Intent, Outcome, Session};
use super::snapshot::{SnapshotCell, Target};
use super::speed::Design;
use super::testing::{speed_design, speed_session};
use crate::describe::layout;
use crate::recording::{MemoryRecorder, Record};
use drivebench_identify::online::OnlineConfig;
use drivebench_link::virtual_line::{FarEnd, LineTime, on_a_line};
use drivebench_link::{DriveLink, DriveProfile};
use drivebench_model::plant::Model;
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use witness::codec::{self, Request};
use witness::drive::{BENCH, Drive, PROFILE};
use witness::fault::{Act, Class, FAULTS, Fault, Host, Subject, Way};
use witness::trials;

/// The witness on the line, and the signals and keys that reach the program.
struct Surroundings {
    drive: Drive,
    host: Option<Host>,
    interrupted: Arc<AtomicBool>,
    intents: Option<Sender<Intent>>,
    /// When the host's fault was injected, s.
    done_s: Option<f64>,
    is_repeated: bool,
    /// The process is suspended at its next wait.
    suspends: bool,
    /// End of the last reply before the fault, s: from then on the line is silent to the host.
    replied_s: f64,
    /// Times of the commands, and whether each switches the output off.
    commands: Vec<(f64, bool)>,
}

impl FarEnd for Surroundings {
    fn receive(&mut self, now_s: f64, bytes: &[u8]) -> Vec<(f64, Vec<u8>)> {
        let sent = self.drive.hear(now_s, bytes);
        if let (false, Some((at_s, _))) = (self.drive.is_faulty(), sent.last()) {
            self.replied_s = *at_s;
        }
        let request = codec::request(bytes).and_then(Result::ok);
        if let Some((_, Request::Write { address, values, .. }, _)) = request {
            for (at, word) in (address..).zip(values) {
                // The control word of the witness's map, and its set-point.
                let is_off = match at {
                    200 => word & 0x02 == 0,
                    201 => word == 0,
                    _ => continue,
                };
                self.commands.push((now_s, is_off));
            }
        }
        self.advance(now_s);
        sent
    }
}

impl Surroundings {
    fn new(
        drive: Drive,
        host: Option<Host>,
        interrupted: &Arc<AtomicBool>,
        intents: Option<Sender<Intent>>,
    ) -> Self {
        Self {
            drive,
            host,
            interrupted: Arc::clone(interrupted),
            intents,
            done_s: None,
            is_repeated: false,
            suspends: false,
            replied_s: 0.0,
            commands: Vec::new(),
        }
    }

    fn advance(&mut self, now_s: f64) {
        self.drive.advance(now_s);
        let Some(host) = self.host else {
            return;
        };
        if let Some(done_s) = self.done_s {
            if host == Host::InterruptTwice
                && now_s >= done_s + 0.05
                && !std::mem::replace(&mut self.is_repeated, true)
            {
                self.interrupted.store(true, Ordering::Release);
            }
            return;
        }
        if self.drive.from_s.is_none_or(|from_s| now_s < from_s) {
            return;
        }
        self.done_s = Some(now_s);
        match host {
            Host::Interrupt
            | Host::InterruptTwice
            | Host::Terminate
            | Host::HangUp
            | Host::Quit
            | Host::User1 => self.interrupted.store(true, Ordering::Release),
            Host::StopKey => self.send(Intent::Stop),
            Host::InterruptKey => self.send(Intent::Quit),
            Host::CloseTerminal => {
                self.send(Intent::Quit);
                self.intents = None;
            }
            Host::Suspend => self.suspends = true,
            Host::Kill | Host::CloseOutput | Host::QuitKey | Host::FolderGone | Host::DiskFull => {}
        }
    }

    fn send(&self, intent: Intent) {
        if let Some(intents) = &self.intents {
            let _ = intents.send(intent);
        }
    }
}

/// The bench's clock is that of the line.
struct LineClock(LineTime, Arc<Mutex<Surroundings>>);

impl Clock for LineClock {
    fn now_s(&self) -> f64 {
        self.0.now_s()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        self.0.skip_to_s(until_s);
        let mut there = self.1.lock().unwrap();
        let now_s = self.0.now_s();
        there.advance(now_s);
        if std::mem::take(&mut there.suspends) {
            drop(there);
            self.0.skip_to_s(now_s + 1.0);
        }
    }

    fn is_real(&self) -> bool {
        true
    }
}

struct Trial {
    status: i32,
    output: String,
    estimates: Vec<ParameterEstimate>,
    /// Of each run.
    records: Vec<Run>,
    surroundings: Surroundings,
}

/// Whether it can be injected without a process.
fn is_virtual(fault: &Fault) -> bool {
    !matches!(
        fault.act,
        Act::Host(
            Host::Kill | Host::CloseOutput | Host::QuitKey | Host::FolderGone | Host::DiskFull
        )
    )
}

/// The order of work of a command: checks, then one run or, for `commission`, three.
fn work(
    way: Way,
    bench: &BenchFile,
    profile: &DriveProfile,
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    (interrupted, intents): (&AtomicBool, &Receiver<Intent>),
    trial: &mut Trial,
) {
    let nameplate = bench.nameplate().unwrap();
    let stopped = || interrupted.load(Ordering::Acquire);
    let first_move = CheckOptions::first_move(bench.link.rate_hz, &nameplate, profile);
    let options = CheckOptions { stopped: &stopped, ..first_move };
    let report = match check(link, clock, &bench.limits(), options) {
        Ok(report) => report,
        Err(error) => {
            trial.print(3, &error.to_string());
            return;
        }
    };
    if let Some(item) = report.refusal() {
        trial.print(3, &format!("{}: {}", item.name, item.text));
        return;
    }
    let runs = if way == Way::Commission { 3 } else { 1 };
    let mut last_seq = report.last_seq;
    for run_seed in 1..=runs {
        let guard = Guard::new(bench.limits(), &nameplate, None).with_period(bench.period_s());
        let session = match way {
            Way::Speed | Way::SpeedScreen => {
                // A delay of one cycle, and the nameplate's model.
                let (model, limits) = (Model::baseline(nameplate.motor()), bench.limits());
                let design = speed_design(bench, &model, (&nameplate, &limits), 1.0);
                speed_session(bench, &Design { noise_rad_s: 0.05, ..design }, guard)
            }
            _ => Session::new(Box::new(bench.program(run_seed).unwrap()), guard),
        };
        let session = session
            .after_seq(last_seq)
            .with_rest(&report.rest)
            .with_watchdog(report.identity.watchdog_s);
        let sent = link.statistics().sent;
        let mut recorder = MemoryRecorder::new(layout(&[Channel::VoltageCmd], &report.signals));
        let summary = one_run(session, bench, link, clock, &mut recorder, (interrupted, intents));
        last_seq += summary.link.sent - sent + 1;
        trial.records.extend(recorder.run("trial").ok().map(|mut run| {
            // As the manifest has it.
            for channel in &report.signals {
                run.set_origin(*channel, Origin::Measured);
            }
            run
        }));
        trial.add(&summary);
        if summary.outcome != Outcome::Done {
            return;
        }
    }
}

fn one_run(
    session: Session,
    bench: &BenchFile,
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    recorder: &mut dyn Record,
    (interrupted, intents): (&AtomicBool, &Receiver<Intent>),
) -> RunSummary {
    let config = OnlineConfig::from_model(&Model::baseline(bench.motor.motor()));
    let bench_of_run = Bench {
        link,
        clock,
        recorder,
        estimator: Some(&mut RowEstimator::new(config)),
        intents,
        interrupted,
        snapshots: &SnapshotCell::default(),
    };
    let options = RunOptions {
        name: "trial".to_owned(),
        target: Target::Hardware,
        rate_hz: bench.link.rate_hz,
        motor: bench.nameplate(),
        auto_start: true,
    };
    run(session, bench_of_run, &options)
}

impl Trial {
    fn print(&mut self, status: i32, text: &str) {
        self.status = status;
        let _ = writeln!(self.output, "{text}");
    }

    fn add(&mut self, summary: &RunSummary) {
        let (status, text) = match &summary.outcome {
            Outcome::Done => (0, "done"),
            Outcome::Stopped | Outcome::Interrupted => (130, "stopped"),
            Outcome::Tripped(trip) => (4, trip.reason.as_str()),
            Outcome::LinkLost { reason } | Outcome::NotStarted { reason } => (3, reason.as_str()),
        };
        self.print(status, text);
        if let Some(error) = &summary.stop_error {
            let status = if status == 0 { 3 } else { status };
            self.print(status, &format!("the stop is not confirmed: {error}"));
        }
        for notice in &summary.notices {
            let _ = writeln!(self.output, "{}", notice.text);
        }
        self.estimates.extend_from_slice(&summary.estimates);
    }
}

fn trial(fault: &Fault, way: Way, seed: u64) -> Trial {
    trial_of(BENCH, Drive::new(fault.act, seed), fault.host(), way)
}

/// The profile of the independent drive, and a bench with it.
fn of_the_witness(bench: &str) -> (DriveProfile, BenchFile) {
    let profile = DriveProfile::parse("drive.toml", PROFILE).unwrap();
    let mut bench = BenchFile::parse("bench.toml", bench).unwrap();
    bench.drive_facts = DriveFacts::of(&profile);
    (profile, bench)
}

fn trial_of(bench: &str, drive: Drive, host: Option<Host>, way: Way) -> Trial {
    let (profile, bench) = of_the_witness(bench);
    let interrupted = Arc::new(AtomicBool::new(false));
    let (sender, intents) = channel();
    let there = Surroundings::new(drive, host, &interrupted, Some(sender));
    let there = Arc::new(Mutex::new(there));
    let mut trial = Trial {
        status: -9,
        output: String::new(),
        estimates: Vec::new(),
        records: Vec::new(),
        surroundings: Surroundings::new(Drive::new(Act::Nothing, 0), None, &interrupted, None),
    };
    let ends = (&*interrupted, &intents);
    on_a_line(&profile, Arc::clone(&there), |link, time| {
        let mut clock = LineClock(time, Arc::clone(&there));
        work(way, &bench, &profile, link, &mut clock, ends, &mut trial);
        let end_s = time.now_s();
        there.lock().unwrap().drive.advance(end_s + 0.7);
    });
    std::mem::swap(&mut trial.surroundings, &mut there.lock().unwrap());
    trial
}

fn wrong(fault: &Fault, way: Way, seed: u64) -> Vec<String> {
    let trial = trial(fault, way, seed);
    let there = &trial.surroundings;
    let mut wrong = trials::wrong(fault, &there.drive, there.done_s, trial.status);
    wrong.extend(fault.untold(&trial.output));
    if fault.class == Class::GoesOn && matches!(way, Way::Run | Way::RunScreen) {
        // Of some thousand parameters all are within 4.5 standard deviations.
        let (_, off) = trials::hold_against_truth(4.5, |key| {
            let found = trial.estimates.iter().find(|estimate| estimate.key == key);
            found.map_or(("not told", None, None), |found| {
                (found.verdict.name(), found.value, found.std)
            })
        });
        wrong.extend(off);
    }
    if !wrong.is_empty() {
        wrong.push(format!("output: {}", trial.output.trim().replace('\n', " | ")));
    }
    wrong
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// These faults in every way, on every core. A seed determines the time of a fault, the affected replies, and the sensors' noise.
fn expect(subject: Subject) {
    let cases: Vec<(trials::Case, u64)> = (trials::cases(subject).into_iter())
        .filter(|(fault, _)| is_virtual(fault))
        .flat_map(|case| (0..10).map(move |seed| (case, seed)))
        .collect();
    let done = trials::at_once(cores(), &cases, |&((fault, way), seed)| {
        let wrong = wrong(fault, way, seed).join("\n  ");
        (!wrong.is_empty()).then(|| format!("{fault} x {way:?}, seed {seed}:\n  {wrong}"))
    });
    let mut failed: Vec<String> = done.into_iter().flatten().collect();
    failed.sort();
    let (count, all, texts) = (failed.len(), cases.len(), failed.join("\n"));
    assert!(count == 0, "{count} of {all} trials failed:\n{texts}");
}

#[test]
fn a_disturbed_line_bends_no_result() {
    expect(Subject::Line);
}

#[test]
fn every_way_out_ends_at_zero() {
    expect(Subject::Host);
}

#[test]
fn whatever_the_drive_does_it_ends_at_zero() {
    expect(Subject::Drive);
}

/// From the first instant at which the fault shows until a stop is on the line, and the allowed time, s; and the fault.
fn stop_latency(seed: u64) -> (&'static str, f64, f64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // The link is connected, and the fault has a first observable instant.
    let is_live = |fault: &&Fault| {
        let is_dead = matches!(fault.act, Act::PowerLost(_) | Act::Dead(_) | Act::Unplugged);
        fault.class == Class::Cut(0.0) && !is_dead
    };
    let faults: Vec<&'static Fault> = FAULTS.iter().filter(is_live).collect();
    let fault = faults[random.random_range(0..faults.len())];
    // At 80 Hz the line is busy for half of a cycle.
    let rate_hz: f64 = random.random_range(25.0..80.0);
    let bench = BENCH.replace("rate_hz = 50.0", &format!("rate_hz = {rate_hz:.2}"));
    let trial = trial_of(&bench, Drive::new(fault.act, seed), None, Way::Run);
    let Trial { surroundings, output, .. } = trial;
    let shows_s = surroundings.drive.seen_s();
    let mut shows_s = shows_s.unwrap_or_else(|| panic!("{fault}, seed {seed}: {output}"));
    if matches!(fault.act, Act::Mute | Act::Busy(_)) {
        // A reply that was under way when the drive fell silent still comes.
        shows_s = shows_s.max(surroundings.replied_s);
    }
    let commands = &surroundings.commands;
    let last_on = commands.iter().rposition(|(_, is_off)| !is_off).unwrap_or(0);
    let stop_s = commands[last_on..].iter().find(|(_, is_off)| *is_off);
    let latency_s = stop_s.map(|(stop_s, _)| (stop_s - shows_s).max(0.0));
    (fault.name, latency_s.unwrap_or(f64::INFINITY), (3.0 / rate_hz).max(0.1) + 1.0 / rate_hz)
}

#[test]
fn a_stop_is_on_a_live_line_in_time_in_1000_trials() {
    let seeds: Vec<u64> = (0..1000).collect();
    let done = trials::at_once(cores(), &seeds, |seed| (*seed, stop_latency(*seed)));
    // Trials over the latency in steps of 10 ms.
    let mut counts = std::collections::BTreeMap::new();
    let (mut worst, mut wrong) = (0.0_f64, Vec::new());
    for (seed, (fault, latency_s, allowed_s)) in &done {
        if latency_s > allowed_s {
            wrong.push(format!("{fault}, seed {seed}: {latency_s:.4} s, allowed {allowed_s:.4} s"));
        }
        worst = worst.max(latency_s / allowed_s);
        *counts
            .entry(10 * drivebench_model::numerics::count::whole(100.0 * latency_s))
            .or_insert(0_u64) += 1;
    }
    println!("worst {:.0} % of the allowed time; from ms: trials {counts:?}", 100.0 * worst);
    assert!(wrong.is_empty(), "{} of 1000: {wrong:#?}", wrong.len());
}
