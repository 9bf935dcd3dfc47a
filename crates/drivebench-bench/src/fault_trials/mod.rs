//! Every fault in every way of running with ten seeds, in virtual time, against a drive that this program does not know.
//!
//! ```text
//! witness (tests/witness: codec, motor, log, faults) <- bytes -> line in memory -> [ link, checks, session, runner ]
//!        '-- judge: what was wrong, by its own log
//! ```
//!
//! What only happens to a process (a signal that kills it, a file that cannot be written) has its trials in real time.

mod endurance;
mod hidden;
#[path = "../../../../tests/witness/mod.rs"]
mod witness;

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use super::bench_file::BenchFile;
use super::check::{CheckOptions, CheckReport, FirstMove, Waivers, check};
use super::clock::Clock;
use super::guard::Guard;
use super::live_online::RowEstimator;
use super::mechanics::DriveFacts;
use super::runner::{Bench, RunOptions, RunSummary, run};
use super::session::{Intent, Outcome, Session};
use super::snapshot::{SnapshotCell, Target};
use super::speed::{Design, PilotSettings, SpeedPilot, timing};
use crate::describe::layout;
use crate::recording::MemoryRecorder;
use drivebench_control::Actuator;
use drivebench_identify::online::OnlineConfig;
use drivebench_link::virtual_line::{FarEnd, LineTime, on_a_line};
use drivebench_link::{DriveLink, DriveProfile};
use drivebench_model::plant::Model;
use drivebench_model::sample::{Origin, ParameterEstimate, Run};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use witness::codec::{self, Request};
use witness::drive::{BENCH, Drive, PROFILE};
use witness::fault::{Act, Class, FAULTS, Fault, Host, Subject, Way};
use witness::trials;

/// Seeds of each trial: when the fault comes, which replies it hits, what the sensors' noise is.
const SEEDS: u64 = 10;
/// Between two signals of a person, s.
const AGAIN_S: f64 = 0.05;
/// For so long the process does nothing when it is stopped, s.
const STOPPED_S: f64 = 1.0;
/// The drive is watched for so long after the end, s.
const AFTER_S: f64 = 0.7;
/// The control word of the witness's map, its bit with which the output is on, and its set-point.
const CONTROL_WORD: u16 = 200;
const RUN_BIT: u16 = 0x02;
const SET_POINT: u16 = 201;
/// Standard deviations within which a parameter has to be, of some thousand.
const SIGMAS: f64 = 4.5;

/// The witness on the line, and what reaches the program by other ways than the line.
struct Surroundings {
    drive: Drive,
    host: Option<Host>,
    interrupted: Arc<AtomicBool>,
    intents: Option<Sender<Intent>>,
    /// When it was done, s.
    done_s: Option<f64>,
    again: bool,
    /// The process is stopped from its next wait on.
    stops: bool,
    /// When the last reply was there to which no fault had come yet, s: from then on the line is silent to the host.
    replied_s: f64,
    /// When it was told what: whether the output is to be zero.
    told: Vec<(f64, bool)>,
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
                let is_off = match at {
                    CONTROL_WORD => word & RUN_BIT == 0,
                    SET_POINT => word == 0,
                    _ => continue,
                };
                self.told.push((now_s, is_off));
            }
        }
        self.look(now_s);
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
            again: false,
            stops: false,
            replied_s: 0.0,
            told: Vec::new(),
        }
    }

    fn look(&mut self, now_s: f64) {
        self.drive.advance(now_s);
        let Some(host) = self.host else {
            return;
        };
        if let Some(done_s) = self.done_s {
            if host == Host::InterruptTwice
                && now_s >= done_s + AGAIN_S
                && !std::mem::replace(&mut self.again, true)
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
            Host::StopKey => self.tell(Intent::Stop),
            Host::InterruptKey => self.tell(Intent::Quit),
            Host::CloseTerminal => {
                self.tell(Intent::Quit);
                self.intents = None;
            }
            Host::Suspend => self.stops = true,
            Host::Kill | Host::CloseOutput | Host::QuitKey | Host::FolderGone | Host::DiskFull => {}
        }
    }

    fn tell(&self, intent: Intent) {
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
        there.look(now_s);
        if std::mem::take(&mut there.stops) {
            drop(there);
            self.0.skip_to_s(now_s + STOPPED_S);
        }
    }

    fn is_real(&self) -> bool {
        true
    }
}

struct Trial {
    status: i32,
    said: String,
    estimates: Vec<ParameterEstimate>,
    /// What was recorded, run by run.
    records: Vec<Run>,
    drive: Surroundings,
}

/// Whether it can be done without a process.
fn is_virtual(fault: &Fault) -> bool {
    !matches!(
        fault.act,
        Act::Host(
            Host::Kill | Host::CloseOutput | Host::QuitKey | Host::FolderGone | Host::DiskFull
        )
    )
}

/// Loop of the bench file for a delay of one cycle, as `speed` makes it of the nameplate.
fn speed_session(bench: &BenchFile, guard: Guard) -> Session {
    let (motor, limits) = (bench.nameplate().unwrap(), bench.limits());
    let section = bench.speed.as_ref().unwrap();
    let model = Model::baseline(motor.motor());
    let period_s = bench.period_s();
    let reference = bench.reference(section).unwrap();
    let design = Design {
        model: &model,
        fitted: &[],
        motor: &motor,
        limits: &limits,
        section,
        maps: &[],
        actuator: Actuator::Voltage,
        timing: timing(&model, period_s, period_s),
        noise_rad_s: 0.05,
        peak_reference_rad_s: reference.peak_rad_s(),
    };
    let settings = PilotSettings {
        slew_v_per_s: section.slew_v_per_s(&motor, &limits, period_s),
        silence_s: limits.link_silence_s,
        hold: 0.0,
    };
    let regulator = design.regulator().unwrap();
    let pilot = SpeedPilot::new(regulator, reference, settings);
    Session::with_pilot(Box::new(pilot), guard)
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
    let plate = bench.nameplate().unwrap();
    let stopped = || interrupted.load(Ordering::Acquire);
    let options = CheckOptions {
        rate_hz: bench.link.rate_hz,
        hardware_allowed: true,
        hardware_said: true,
        waivers: Waivers::default(),
        first_move: Some(FirstMove { plate: &plate, profile, is_withheld: false }),
        stopped: &stopped,
        reset_fault: false,
    };
    let report = match check(link, clock, &bench.limits(), options) {
        Ok(report) => report,
        Err(error) => {
            trial.say(3, &error.to_string());
            return;
        }
    };
    if let Some(item) = report.refusal() {
        trial.say(3, &format!("{}: {}", item.name, item.text));
        return;
    }
    let runs = if way == Way::Commission { 3 } else { 1 };
    let mut last_seq = report.last_seq;
    for run_seed in 1..=runs {
        let guard = Guard::new(bench.limits(), &plate, None).with_period(bench.period_s());
        let session = match way {
            Way::Speed | Way::SpeedScreen => speed_session(bench, guard),
            _ => Session::new(Box::new(bench.program(run_seed).unwrap()), guard),
        };
        let sent = link.statistics().sent;
        let watchdog_s = report.identity.watchdog_s;
        let session = session.after_seq(last_seq).with_rest(&report.rest);
        let session = session.with_watchdog(watchdog_s);
        let (summary, record) =
            one_run(session, bench, &report, link, clock, (interrupted, intents));
        last_seq += summary.link.sent - sent + 1;
        trial.records.extend(record);
        trial.note(&summary);
        if summary.outcome != Outcome::Done {
            return;
        }
    }
}

fn one_run(
    session: Session,
    bench: &BenchFile,
    report: &CheckReport,
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    (interrupted, intents): (&AtomicBool, &Receiver<Intent>),
) -> (RunSummary, Option<Run>) {
    let mut recorder = MemoryRecorder::new(layout(&report.signals));
    let config = OnlineConfig::from_model(&Model::baseline(bench.motor.motor()));
    let mut online = RowEstimator::new(config);
    let summary = run(
        session,
        Bench {
            link,
            clock,
            recorder: &mut recorder,
            estimator: Some(&mut online),
            intents,
            interrupted,
            snapshots: &SnapshotCell::default(),
        },
        &RunOptions {
            name: "trial".to_owned(),
            target: Target::Hardware,
            rate_hz: bench.link.rate_hz,
            motor: bench.nameplate(),
            auto_start: true,
        },
    );
    let record = recorder.run("trial").ok().map(|mut run| {
        // As the manifest has it.
        for channel in &report.signals {
            run.set_origin(*channel, Origin::Measured);
        }
        run
    });
    (summary, record)
}

impl Trial {
    fn say(&mut self, status: i32, text: &str) {
        self.status = status;
        let _ = writeln!(self.said, "{text}");
    }

    fn note(&mut self, summary: &RunSummary) {
        let (status, text) = match &summary.outcome {
            Outcome::Done => (0, "done"),
            Outcome::Stopped | Outcome::Interrupted => (130, "stopped"),
            Outcome::Tripped(trip) => (4, trip.reason.as_str()),
            Outcome::LinkLost { reason } | Outcome::NotStarted { reason } => (3, reason.as_str()),
        };
        self.say(status, text);
        if let Some(error) = &summary.stop_error {
            let status = if status == 0 { 3 } else { status };
            self.say(status, &format!("the stop is not confirmed: {error}"));
        }
        for notice in &summary.notices {
            let _ = writeln!(self.said, "{}", notice.text);
        }
        self.estimates.extend_from_slice(&summary.estimates);
    }
}

fn trial(fault: &Fault, way: Way, seed: u64) -> Trial {
    trial_of(BENCH, Drive::new(fault.act, seed), fault.host(), way)
}

fn trial_of(bench: &str, drive: Drive, host: Option<Host>, way: Way) -> Trial {
    let profile = DriveProfile::parse("drive.toml", PROFILE).unwrap();
    let mut bench = BenchFile::parse("bench.toml", bench).unwrap();
    bench.drive_facts = DriveFacts::of(&profile);
    let interrupted = Arc::new(AtomicBool::new(false));
    let (sender, intents) = channel();
    let there = Surroundings::new(drive, host, &interrupted, Some(sender));
    let there = Arc::new(Mutex::new(there));
    let mut trial = Trial {
        status: -9,
        said: String::new(),
        estimates: Vec::new(),
        records: Vec::new(),
        drive: Surroundings::new(Drive::new(Act::Nothing, 0), None, &interrupted, None),
    };
    let ends = (&*interrupted, &intents);
    on_a_line(&profile, Arc::clone(&there), |link, time| {
        let mut clock = LineClock(time, Arc::clone(&there));
        work(way, &bench, &profile, link, &mut clock, ends, &mut trial);
        let end_s = time.now_s();
        there.lock().unwrap().drive.advance(end_s + AFTER_S);
    });
    std::mem::swap(&mut trial.drive, &mut there.lock().unwrap());
    trial
}

fn wrong(fault: &Fault, way: Way, seed: u64) -> Vec<String> {
    let trial = trial(fault, way, seed);
    let there = &trial.drive;
    let mut wrong = trials::wrong(fault, &there.drive, there.done_s, trial.status);
    wrong.extend(fault.untold(&trial.said));
    if fault.class == Class::GoesOn && matches!(way, Way::Run | Way::RunScreen) {
        let (_, off) = trials::hold_against_truth(SIGMAS, |key| {
            let mut estimates = trial.estimates.iter();
            let found = estimates.find(|estimate| estimate.key == key);
            found.map_or(("not told", None, None), |found| {
                (found.verdict.name(), found.value, found.std)
            })
        });
        wrong.extend(off);
    }
    if !wrong.is_empty() {
        wrong.push(format!("said: {}", trial.said.trim().replace('\n', " | ")));
    }
    wrong
}

/// All seeds of these faults in every way, on every core.
fn expect(subject: Subject) {
    let cases = trials::cases(subject).into_iter();
    let cases = cases.filter(|(fault, _)| is_virtual(fault));
    let cases: Vec<(trials::Case, u64)> =
        cases.flat_map(|case| (0..SEEDS).map(move |seed| (case, seed))).collect();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let done = trials::at_once(cores, &cases, |&((fault, way), seed)| {
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

/// Trials of the stop; rates of the run, Hz: at 80 Hz the line is busy for half of a cycle.
const STOPS: u64 = 1000;
const RATES_HZ: std::ops::Range<f64> = 25.0..80.0;
/// Buckets of the histogram, ms.
const BUCKET_MS: f64 = 10.0;

/// From when the fault could be seen until a stop was on the line, and what is allowed, s; and the fault.
fn stop_latency(seed: u64) -> (&'static str, f64, f64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // The link lives, and the fault has a first instant at which it can be seen.
    let is_live = |fault: &&Fault| {
        let is_dead = matches!(fault.act, Act::PowerLost(_) | Act::Dead(_) | Act::Unplugged);
        fault.class == Class::Cut(0.0) && !is_dead
    };
    let faults: Vec<&'static Fault> = FAULTS.iter().filter(is_live).collect();
    let fault = faults[random.random_range(0..faults.len())];
    let rate_hz = random.random_range(RATES_HZ);
    let bench = BENCH.replace("rate_hz = 50.0", &format!("rate_hz = {rate_hz:.2}"));
    let trial = trial_of(&bench, Drive::new(fault.act, seed), None, Way::Run);
    let seen_s = trial.drive.drive.seen_s();
    let mut seen_s = seen_s.unwrap_or_else(|| panic!("{fault}, seed {seed}: {}", trial.said));
    if matches!(fault.act, Act::Mute | Act::Busy(_)) {
        // A reply that was under way when the drive fell silent still comes.
        seen_s = seen_s.max(trial.drive.replied_s);
    }
    let told = &trial.drive.told;
    let on = told.iter().rposition(|(_, is_off)| !is_off).unwrap_or(0);
    // From here on it was told nothing else.
    let stop_s = told[on..].iter().find(|(_, is_off)| *is_off);
    let latency_s = stop_s.map(|(stop_s, _)| (stop_s - seen_s).max(0.0));
    let allowed_s = (3.0 / rate_hz).max(0.1) + 1.0 / rate_hz;
    (fault.name, latency_s.unwrap_or(f64::INFINITY), allowed_s)
}

#[test]
fn a_stop_is_on_a_live_line_in_time_in_1000_trials() {
    let seeds: Vec<u64> = (0..STOPS).collect();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let done = trials::at_once(cores, &seeds, |seed| (*seed, stop_latency(*seed)));
    let mut counts = std::collections::BTreeMap::new();
    let (mut worst, mut wrong) = (0.0_f64, Vec::new());
    for (seed, (fault, latency_s, allowed_s)) in &done {
        if latency_s > allowed_s {
            wrong.push(format!("{fault}, seed {seed}: {latency_s:.4} s, allowed {allowed_s:.4} s"));
        }
        worst = worst.max(latency_s / allowed_s);
        let bucket = crate::timing::whole(1e3 * latency_s / BUCKET_MS);
        *counts.entry(bucket).or_insert(0_u64) += 1;
    }
    let mut text = format!("worst {:.0} % of what is allowed; ms, trials:", 100.0 * worst);
    for (bucket, count) in counts {
        let _ = write!(
            text,
            " {:.0}-{:.0} {count},",
            BUCKET_MS * bucket as f64,
            BUCKET_MS * (bucket + 1) as f64
        );
    }
    println!("{text}");
    assert!(wrong.is_empty(), "{} of {STOPS}: {wrong:#?}", wrong.len());
}
