//! The loop on a scripted drive, on the emulated drive, on a drive of another make, and in real time.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::*;
use crate::bench_file::BenchFile;
use crate::clock::MonotonicClock;
use crate::guard::Guard;
use crate::limits::Limits;
use crate::live_online::RowEstimator;
use crate::recording::MemoryRecorder;
use crate::testing::{
    Fault, LateClock, ScriptedDrive, Stalls, Tamper, Tampered, TestRun, Wave, constant, exact,
    gone, has, in_memory, near, timeout, within,
};
use crate::trip::TripKind;
use drivebench_emulator::{
    EmulatorConfig, ForeignBus, ForeignDrive, Guise, SoftDrive, VirtualClock,
};
use drivebench_identify::online::OnlineConfig;
use drivebench_link::{DriveProfile, LinkError, ProfiledLink};
use drivebench_model::sample::{Channel, Sample};

fn emulated(emulator_seed: u64, run_seed: u64) -> (RunSummary, MemoryRecorder, SnapshotCell) {
    emulated_with(&EmulatorConfig::embedded_default(), emulator_seed, run_seed)
}

fn emulated_with(
    config: &EmulatorConfig,
    emulator_seed: u64,
    run_seed: u64,
) -> (RunSummary, MemoryRecorder, SnapshotCell) {
    let bench = BenchFile::embedded_default();
    let (mut link, mut clock) = in_memory(config, emulator_seed);
    let guard = Guard::new(bench.limits(), &bench.nameplate().unwrap(), Some(11.4));
    let session = Session::new(Box::new(bench.program(run_seed).unwrap()), guard);
    let snapshots = SnapshotCell::default();
    let mut live = RowEstimator::new(OnlineConfig::default());
    let test = TestRun {
        motor: bench.nameplate(),
        estimator: Some(&mut live),
        snapshots: snapshots.clone(),
        ..TestRun::default()
    };
    let (summary, recorder) = test.run(session, &mut link, &mut clock);
    (summary, recorder, snapshots)
}

#[test]
fn the_embedded_bench_runs_to_its_end_in_virtual_time() {
    for seed in 0..5 {
        let (summary, recorder, snapshots) = emulated(seed, 1);
        assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
        assert_eq!(summary.timing.missed_cycles, 0);
        near(summary.timing.rate_achieved_hz, 100.0, 1e-6);
        assert!(summary.link.balances() && summary.link.lost() == 0);
        assert!(summary.stop_error.is_none());
        let run = recorder.run("r").unwrap();
        let largest =
            |channel| run.points(channel).map(|(_, value)| f64::abs(value)).fold(0.0, f64::max);
        // The whole speed range, and below the drive's own current limit: the voltage is never clipped.
        within(largest(Channel::Speed), 220.0..);
        within(largest(Channel::Current), 5.7..11.0);
        near(largest(Channel::VoltageCmd), 97.0, 1.0);
        let latest = snapshots.latest();
        assert_eq!((latest.phase, latest.outcome), (Some(Phase::Done), Some("done")));
        assert_eq!(latest.trace.len(), 1200);
        // The specimen differs from the nameplate, but a free run does not drift.
        let trace = latest.trace.iter();
        let errors = trace.map(|point| (point.speed_rad_s - point.model_speed_rad_s).abs());
        within(errors.fold(0.0, f64::max), ..80.0);
    }
}

#[test]
fn one_seed_gives_the_same_bytes_and_another_seed_others() {
    let (one, again, other) = (emulated(1, 1).1, emulated(1, 1).1, emulated(2, 1).1);
    assert_eq!(one.samples, again.samples);
    assert_eq!(one.events, again.events);
    assert_ne!(one.samples, other.samples);
    assert_ne!(one.samples, emulated(1, 2).1.samples);
}

#[test]
fn live_estimates_are_accurate() {
    let plain = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    for seed in 1..=3 {
        let (summary, _, _) = emulated_with(&plain, seed, 1);
        assert_eq!(summary.estimates.len(), 5);
        let truth = SoftDrive::new(&plain, seed).truth().clone();
        for (key, value, share) in [
            ("resistance_ohm", truth.resistance_ohm, 0.05),
            ("back_emf_v_s_per_rad", truth.back_emf_v_s_per_rad, 0.02),
            ("inertia_kg_m2", truth.inertia_kg_m2, 0.05),
        ] {
            let found = ParameterEstimate::find(&summary.estimates, key).unwrap().value.unwrap();
            assert!((found / value - 1.0).abs() < share, "{key}: {found}, true {value}");
        }
    }
}

/// A run at 10 V for 2 s on a scripted drive.
struct Scripted<'a> {
    drive: ScriptedDrive,
    /// Length of one stall of the host after half a second.
    stall_s: f64,
    test: TestRun<'a>,
}

impl Scripted<'_> {
    fn new(drive: ScriptedDrive) -> Self {
        Self {
            drive,
            stall_s: 0.0,
            test: TestRun {
                motor: BenchFile::embedded_default().nameplate(),
                ..TestRun::default()
            },
        }
    }

    fn run(mut self) -> (RunSummary, String, ScriptedDrive) {
        let bench = BenchFile::embedded_default();
        let guard = Guard::new(bench.limits(), &bench.nameplate().unwrap(), None);
        let session = Session::new(constant(2.0, Demand::Voltage(10.0)), guard);
        let mut left_s = self.stall_s;
        let late_s = |now_s| {
            if now_s >= 0.5 { std::mem::take(&mut left_s) } else { 0.0 }
        };
        let mut clock = LateClock { clock: VirtualClock::new(), late_s };
        let (summary, recorder) = self.test.run(session, &mut self.drive, &mut clock);
        (summary, recorder.events, self.drive)
    }
}

#[test]
fn missed_deadlines_are_counted_and_recorded_and_not_caught_up() {
    let mut scripted = Scripted::new(ScriptedDrive::new(0.01));
    scripted.stall_s = 0.043;
    let (summary, events, drive) = scripted.run();
    assert_eq!(summary.outcome, Outcome::Done);
    assert_eq!(summary.timing.missed_cycles, 4);
    near(summary.timing.lateness_max_s, 0.003, 1e-9);
    has(events.lines().find(|line| line.contains("deadline_lost")).unwrap(), "\"cycles\":4");
    assert_eq!(summary.timing.cycles, drive.demands.len() as u64);
}

#[test]
fn a_host_that_stood_still_ends_at_stop() {
    let mut scripted = Scripted::new(ScriptedDrive::new(0.01));
    scripted.stall_s = 5.0;
    let (summary, _, drive) = scripted.run();
    let Outcome::LinkLost { reason } = &summary.outcome else { panic!("{summary:?}") };
    has(reason, "host");
    assert_eq!(summary.outcome.exit_status(), 3);
    // Stop is sent before anything else.
    let last_on = drive.demands.iter().rposition(|demand| demand.energises()).unwrap();
    assert!(drive.demands[last_on + 1..].iter().all(|demand| *demand == Demand::Stop));
    assert!(drive.stops >= 1);
}

#[test]
fn an_interrupt_and_intents_of_the_screen_reach_the_session() {
    let mut scripted = Scripted::new(ScriptedDrive::new(0.01));
    scripted.test.interrupted = true;
    let (summary, _, drive) = scripted.run();
    assert_eq!(summary.outcome, Outcome::Interrupted);
    assert_eq!(summary.outcome.exit_status(), 130);
    assert!(drive.stops >= 1);
    let mut scripted = Scripted::new(ScriptedDrive::new(0.01));
    scripted.test.intents = vec![Intent::Mark("begin".to_owned()), Intent::Stop];
    let (summary, events, _) = scripted.run();
    assert_eq!(summary.outcome, Outcome::Stopped);
    has(events, "\"text\":\"begin\"");
}

#[test]
fn a_lost_link_ends_the_run_and_is_in_the_manifest() {
    let drive = ScriptedDrive::new(0.01).with(60, u64::MAX, Fault::Gone);
    let (summary, _, drive) = Scripted::new(drive).run();
    let mut manifest = Manifest::default();
    summary.describe(&mut manifest);
    has(manifest.outcome.unwrap(), "unplugged");
    assert_eq!(manifest.link_statistics["aborted"], 1);
    assert!(drive.stops >= 1);
}

#[test]
fn a_run_that_cannot_begin_ends_with_the_reason() {
    let silent = ScriptedDrive::new(0.01).with(0, u64::MAX, Fault::Timeout);
    let (summary, _, _) = Scripted::new(silent).run();
    assert!(matches!(summary.outcome, Outcome::LinkLost { .. }));
    for (fault, words) in
        [(Fault::TripWith(3), "fault"), (Fault::Missing(Channel::Current), "current")]
    {
        let drive = ScriptedDrive::new(0.01).with(0, u64::MAX, fault);
        let (summary, _, drive) = Scripted::new(drive).run();
        let Outcome::NotStarted { reason } = &summary.outcome else {
            panic!("{words}: {:?}", summary.outcome);
        };
        has(reason, words);
        assert_eq!(summary.outcome.exit_status(), 3);
        assert!(drive.demands.iter().all(|demand| !demand.energises()));
        let mut notices = summary.notices.iter();
        assert!(words == "fault" || notices.any(|notice| notice.text.contains(words)));
    }
}

#[test]
fn a_panic_on_the_way_still_ends_at_zero_output() {
    let mut drive = ScriptedDrive::new(0.01);
    let guard = Guard::new(Limits::zk_22fc(), &Nameplate::zk_22fc(), None);
    let session = Session::new(constant(2.0, Demand::Voltage(10.0)), guard);
    let late_s = |now_s| {
        assert!(now_s < 0.3, "boom");
        0.0
    };
    let mut clock = LateClock { clock: VirtualClock::new(), late_s };
    let run = AssertUnwindSafe(|| TestRun::default().run(session, &mut drive, &mut clock).0.rows);
    assert!(catch_unwind(run).is_err());
    assert!(drive.demands.last().unwrap().energises());
    assert_eq!(drive.stops, 1);
}

#[test]
fn in_real_time_every_deadline_is_either_kept_or_counted() {
    let mut clock = MonotonicClock::start();
    let begin_s = clock.now_s();
    let bench = BenchFile::embedded_default();
    let limits = Limits {
        // A loaded test machine may stall for longer than a bench is allowed to.
        link_silence_s: 20.0,
        ..bench.limits()
    };
    let guard = Guard::new(limits, &bench.nameplate().unwrap(), None);
    let session = Session::new(constant(0.3, Demand::Voltage(5.0)), guard);
    let (summary, _) = TestRun::at(200.0).run(session, &mut ScriptedDrive::new(0.005), &mut clock);
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
    let deadlines = summary.timing.cycles + summary.timing.missed_cycles;
    let passed = whole((clock.now_s() - begin_s) / 0.005) as u64 + 1;
    assert!(deadlines <= passed, "no cycle runs ahead of its deadline");
    assert!(deadlines + 2 >= whole(summary.duration_s / 0.005) as u64);
    within(summary.timing.rate_achieved_hz, ..=201.0);
}

/// The notices of a run on a drive that fails from an exchange on, and of which the last stop ends like this.
fn last_notices(
    from: u64,
    fault: Fault,
    stop_fails: Option<fn(String) -> LinkError>,
) -> Vec<Notice> {
    let mut drive = ScriptedDrive::new(0.01).with(from, u64::MAX, fault);
    drive.stop_fails = stop_fails;
    let (summary, _, _) = Scripted::new(drive).run();
    assert!(matches!(summary.outcome, Outcome::LinkLost { .. }));
    assert_eq!(summary.stop_error.is_some(), stop_fails.is_some());
    summary.notices
}

fn unconfirmed_stop(link: String) -> LinkError {
    LinkError::Sequence {
        link,
        command: "stop",
        step: 1,
        steps: 1,
        reason: "the drive still reports that it runs".to_owned(),
    }
}

fn errors_with<'a>(notices: &'a [Notice], words: &str) -> Vec<&'a str> {
    let errors = notices.iter().filter(|n| n.level == Level::Error);
    errors.map(|notice| notice.text.as_str()).filter(|text| text.contains(words)).collect()
}

#[test]
fn the_last_notice_of_a_stop_is_not_more_than_confirmed() {
    type Failing = Option<fn(String) -> LinkError>;
    // A watchdog is named only for a drive that ran and does not answer.
    let watchdog = last_notices(60, Fault::Gone, Some(gone));
    assert_eq!(errors_with(&watchdog, "NOT confirmed").len(), 1);
    assert_eq!(errors_with(&watchdog, "no watchdog is known").len(), 1);
    for fault in [Fault::Gone, Fault::IgnoresStop] {
        let notices = last_notices(60, fault, None);
        assert_eq!(errors_with(&notices, "confirmed").len(), 0, "{notices:?}");
        let mut warnings = notices.iter().map(|notice| notice.text.as_str());
        assert!(warnings.any(|text| text.starts_with("the drive confirmed its stop only")));
    }
    // Our own drive, over every link with numbered commands.
    let unstopped = |name: String| {
        let mut running = Sample::at(0.0);
        running.state = Some(DriveState::Running);
        drivebench_link::stop_confirmed(&name, || Ok(running.clone())).unwrap_err()
    };
    let cases: [(u64, Fault, Failing, &str); 3] = [
        (60, Fault::IgnoresStop, Some(unconfirmed_stop), "still reports that it runs"),
        (60, Fault::IgnoresStop, Some(unstopped), "still runs after 5 requests to stop"),
        (0, Fault::Timeout, Some(gone), "never reported that it runs"),
    ];
    for (from, fault, stop_fails, why) in cases {
        let notices = last_notices(from, fault, stop_fails);
        let unconfirmed = errors_with(&notices, "NOT confirmed");
        assert_eq!(unconfirmed.len(), 1, "{notices:?}");
        has(unconfirmed[0], why);
        assert!(errors_with(&notices, "watchdog").is_empty());
    }
}

/// Answers up to an exchange; then each one takes its whole timeout and 20 ms more, as under load.
struct Held {
    clock: VirtualClock,
    dead_from: u64,
    left_s: f64,
}

impl Tamper<ScriptedDrive> for Held {
    fn exchange(
        &mut self,
        drive: &mut ScriptedDrive,
        command: Command,
    ) -> Result<Sample, LinkError> {
        let answer = drive.exchange(command);
        if command.seq < self.dead_from {
            return answer;
        }
        self.clock.set_time_s(self.clock.time_s() + self.left_s + 0.02);
        Err(timeout(drive.name(), "a dead drive"))
    }

    fn bound(&mut self, left_s: f64) {
        self.left_s = left_s;
    }
}

#[test]
fn a_silent_link_is_never_called_a_stalled_host() {
    let motor = Nameplate::zk_22fc();
    for dead_from in 60..70 {
        let mut clock = VirtualClock::new();
        let by = Held { clock: clock.clone(), dead_from, left_s: f64::INFINITY };
        let link = ScriptedDrive::new(0.01);
        let guard = Guard::new(Limits::for_motor(&motor, 100.0), &motor, None);
        let session = Session::new(constant(4.0, Demand::Voltage(5.0)), guard);
        let (summary, _) = TestRun::default().run(session, &mut Tampered { link, by }, &mut clock);
        let Outcome::LinkLost { reason } = &summary.outcome else {
            panic!("{dead_from}: {:?}", summary.outcome);
        };
        assert!(reason.starts_with("link silent"), "{dead_from}: {reason}");
    }
}

const STALLED_LIMIT_A: f64 = 11.0;
/// Shorter than the allowed silence and the drive's watchdog.
const STALLS: Stalls = Stalls { share: 0.15, longest_s: 0.2 };

/// A square wave of voltage at 50 Hz on a drive whose own limit is three times the bench's current.
fn stalled(seed: u64, has_period: bool) -> Outcome {
    let motor = Nameplate::zk_22fc();
    let limits = Limits {
        current_a: STALLED_LIMIT_A,
        link_silence_s: 0.45,
        slew_v_per_s: 200.0,
        ..Limits::for_motor(&motor, 50.0)
    };
    // The bound is as accurate as the nameplate and the measured current: both are exact here.
    let mut config = exact("zk-22fc-plain");
    config.limits.current_limit_a = 33.0;
    config.noise.current_a = 0.0;
    let (mut link, mut clock) = STALLS.at(&config, seed);
    let mut guard = Guard::new(limits, &motor, Some(33.0));
    if has_period {
        guard = guard.with_period(0.02);
    }
    let program = Wave {
        duration_s: 6.0,
        demand: |time_s| {
            let up = (time_s / 0.5).floor() % 2.0 == 0.0;
            Demand::Voltage(if up { 40.0 } else { -40.0 })
        },
    };
    TestRun::at(50.0).run(Session::new(Box::new(program), guard), &mut link, &mut clock).0.outcome
}

/// Currents beyond the limit that ended the runs, A.
fn excess_currents_a(has_period: bool) -> Vec<f64> {
    let beyond = |seed| match stalled(seed, has_period) {
        Outcome::Tripped(trip) if trip.kind == TripKind::OverCurrent => Some(trip.value.abs()),
        other => {
            assert_eq!(other, Outcome::Done);
            None
        }
    };
    (0..60).filter_map(beyond).collect()
}

#[test]
fn an_unobserved_shaft_is_not_braked_beyond_the_limit() {
    // A speed is one period old without stalls too: the limit is exceeded by a little now and then.
    let with = excess_currents_a(true);
    assert!(with.len() < 4, "{with:?}");
    assert!(with.iter().copied().fold(0.0, f64::max) < 1.02 * STALLED_LIMIT_A, "{with:?}");
    // Without the age of a speed the same stalls drive far more current through the winding.
    let without = excess_currents_a(false);
    let far = without.iter().filter(|amps| **amps > 1.1 * STALLED_LIMIT_A);
    assert!(far.count() > 15, "{without:?}");
}

/// The text of a servo amplifier's profile, one place of it changed.
fn changed(name: &str, from: &str, to: &str) -> DriveProfile {
    let text = DriveProfile::text(name).unwrap();
    assert!(text.contains(from), "{from}");
    DriveProfile::parse(name, &text.replacen(from, to, 1)).unwrap()
}

/// A servo amplifier that reports local control and torque off.
fn reporting() -> DriveProfile {
    let states = "[state]\n\
         remote = { signal = \"enabled\", mask = 0x02, equals = 0x02 }\n\
         sto = { signal = \"enabled\", mask = 0x04, equals = 0x04 }\n";
    changed("epulse50-dc", "[state]\n", states)
}

struct Changed {
    at: u64,
    change: fn(&mut ForeignDrive),
}

type ForeignLink = ProfiledLink<ForeignBus>;

impl Tamper<ForeignLink> for Changed {
    fn exchange(&mut self, link: &mut ForeignLink, command: Command) -> Result<Sample, LinkError> {
        if command.seq == self.at {
            (self.change)(link.bus_mut().drive_mut());
        }
        link.exchange(command)
    }
}

/// A run on a drive of another make at 20 Hz, which changes at an exchange.
fn foreign(
    profile: &DriveProfile,
    demand: Demand,
    at: u64,
    change: fn(&mut ForeignDrive),
) -> (RunSummary, String, ForeignLink) {
    let guise = Guise::of(profile).unwrap();
    let mut clock = VirtualClock::new();
    let drive = ForeignDrive::new(&guise, &exact("zk-22fc-plain"), 1);
    let bus = ForeignBus::new(drive, &guise, clock.clone());
    let mut link = Tampered {
        link: ProfiledLink::new(std::sync::Arc::clone(&guise.map), bus),
        by: Changed { at, change },
    };
    link.identify().unwrap();
    let motor = Nameplate::zk_22fc();
    let limits = Limits { link_silence_s: 0.4, ..Limits::for_motor(&motor, 20.0) };
    let session = Session::new(constant(4.0, demand), Guard::new(limits, &motor, None));
    let (summary, recorder) = TestRun::at(20.0).run(session, &mut link, &mut clock);
    (summary, recorder.events, link.link)
}

const SLOW: Demand = Demand::Speed(30.0);

#[test]
fn a_foreign_drive_gets_the_times_of_its_profile() {
    let roboteq = "scale = 0.1\nunit = \"%\"\nquantity = \"duty\"\nlimits = [-100, 100]";
    let voltage = "scale = 0.12\nunit = \"V\"\nquantity = \"voltage\"\nlimits = [-120, 120]";
    let slow = |command: &str| {
        let from = format!("{command} = [\n");
        changed("epulse50-dc", &from, &format!("{from}  {{ delay_ms = 1600 }},\n"))
    };
    let mute = changed("roboteq-dc", roboteq, voltage);
    let volts = Demand::Voltage(8.0);
    for (name, profile, demand, confirmed) in [
        ("undisturbed", reporting(), SLOW, true),
        ("takes long to run", slow("enable"), SLOW, true),
        ("takes long to stop", slow("stop"), SLOW, true),
        ("without a report of its state", mute, volts, false),
    ] {
        let (summary, events, link) = foreign(&profile, demand, u64::MAX, |_| {});
        let notices = &summary.notices;
        assert_eq!(summary.outcome, Outcome::Done, "{name}: {notices:?}");
        assert_eq!(link.confirms_stop(), confirmed, "{name}");
        has(events, &format!("\"stop_confirmed\":{confirmed}"));
        let starts = notices.iter().any(|one| one.text.starts_with("stop unconfirmed"));
        assert_eq!(starts, !confirmed, "{name}: {notices:?}");
        let is_silent = notices.iter().all(|one| !one.text.contains("confirmed"));
        assert_eq!(is_silent, confirmed, "{name}: {notices:?}");
    }
}

#[test]
fn keypad_and_torque_off_end_a_run_with_their_own_reason() {
    type Case = (fn(&mut ForeignDrive), &'static str);
    let keypad = "local control: the drive is under local control";
    let torque_off = "torque off: safe torque off (STO) is active";
    let cases: [Case; 2] = [
        (|drive| drive.take_local(true), keypad),
        (|drive| drive.switch_torque_off(true), torque_off),
    ];
    for (change, words) in cases {
        let (summary, _, link) = foreign(&reporting(), SLOW, 60, change);
        let Outcome::Tripped(trip) = &summary.outcome else {
            panic!("{:?}", summary.outcome);
        };
        assert!(trip.reason.starts_with(words), "{}", trip.reason);
        assert_eq!(summary.stop_error, None);
        let drive = link.bus().drive();
        assert_eq!(drive.last_written("speed_ref"), Some(0));
        assert_eq!(drive.last_written("enable_word"), Some(0));
    }
}

#[test]
fn torque_off_before_the_start_is_refused() {
    let (summary, _, link) = foreign(&reporting(), SLOW, 1, |drive| drive.switch_torque_off(true));
    let Outcome::NotStarted { reason } = &summary.outcome else {
        panic!("{:?}", summary.outcome);
    };
    has(reason, "safe torque off (STO) is active");
    assert_ne!(link.bus().drive().last_written("enable_word"), Some(1));
}

#[test]
fn a_refusal_ends_the_run_and_a_busy_drive_after_silence() {
    type Case = (&'static str, fn(&mut ForeignDrive), [&'static str; 2]);
    let illegal = ["profile epulse50-dc:", "exception 0x02"];
    let busy = ["requests refused", "exception 0x06"];
    let cases: [Case; 2] = [
        ("refused", |drive| drive.refuse(Some(2)), illegal),
        ("busy", |drive| drive.refuse(Some(6)), busy),
    ];
    for (name, change, words) in cases {
        let (summary, events, _) = foreign(&reporting(), SLOW, 60, change);
        let Outcome::LinkLost { reason } = &summary.outcome else {
            panic!("{name}: {:?}", summary.outcome);
        };
        for words in words {
            has(reason, words);
        }
        assert_eq!(events.contains("refused_by_drive"), name == "refused");
    }
}

#[test]
fn unconfirmed_times_of_a_stop_are_not_reported() {
    type Failing = Option<fn(String) -> LinkError>;
    let unanswered = |link: String| timeout(drivebench_link::LinkName(link), "stop");
    let cases: [(Option<Fault>, Failing, &str, bool, bool); 5] = [
        (None, None, "the end of the sequence", true, true),
        (Some(Fault::TripWith(3)), None, "drive fault", true, true),
        // No request reached a closed link; a drive that does not answer may have received it.
        (Some(Fault::Gone), Some(gone), "the loss of the link", false, false),
        (Some(Fault::Timeout), Some(unanswered), "link silent", true, false),
        // A drive that answers without stopping received the request, and its link is not lost.
        (Some(Fault::IgnoresStop), Some(unconfirmed_stop), "the end of the sequence", true, false),
    ];
    for (fault, stop_fails, cause, is_sent, is_confirmed) in cases {
        let mut drive = ScriptedDrive::new(0.01);
        let is_whole = fault.is_none();
        if let Some(fault) = fault {
            drive = drive.with(60, u64::MAX, fault);
        }
        drive.stop_fails = stop_fails;
        let (summary, events, _) = Scripted::new(drive).run();
        let Some(stop) = &summary.stop else {
            panic!("{cause}: {summary:?}");
        };
        assert_eq!(stop.cause, cause);
        if !is_whole {
            let last = summary.last_seconds.unwrap();
            assert!(last.from_row < last.to_row, "{last:?}");
        }
        assert_eq!(stop.sent_after_ms.is_some(), is_sent, "{stop:?}");
        assert_eq!(stop.confirmed_after_ms.is_some(), is_confirmed, "{stop:?}");
        assert!(stop.attempts >= 1);
        has(&events, "\"event\":\"stop\"");
        let mut manifest = Manifest::default();
        summary.describe(&mut manifest);
        assert_eq!(manifest.stop["attempts"], stop.attempts);
        assert_eq!(manifest.trip.is_null(), is_whole);
    }
}
