//! How the loop goes on a scripted drive, on the software drive, and in real time.

mod foreign;
mod held;
mod last_word;
mod stalls;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Sender, channel};

use super::*;
use crate::bench::bench_file::BenchFile;
use crate::bench::clock::MonotonicClock;
use crate::bench::guard::Guard;
use crate::bench::live_online::{LiveOnline, replay};
use crate::bench::session::Phase;
use crate::bench::testing::{Fault, ScriptedDrive, Wave};
use crate::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use crate::identification::online::OnlineConfig;
use crate::recording::{CsvRows, Layout, MemoryRecorder, ReadOptions};
use crate::sample::Channel;

fn layout() -> Layout {
    Layout::of_drive(&[
        Channel::VoltageCmd,
        Channel::Voltage,
        Channel::Current,
        Channel::Speed,
    ])
}

fn options() -> RunOptions {
    RunOptions {
        name: "test".to_owned(),
        target: Target::Sim,
        rate_hz: 100.0,
        motor: BenchFile::embedded_default().nameplate(),
        auto_start: true,
    }
}

/// Carries a session out without an estimate, a screen or a user.
fn carry_out(
    session: Session,
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    rate_hz: f64,
) -> (RunSummary, MemoryRecorder) {
    let mut recorder = MemoryRecorder::new(layout());
    let (_keep, intents) = channel();
    let summary = run(
        session,
        Bench {
            link,
            clock,
            recorder: &mut recorder,
            estimator: None,
            intents: &intents,
            interrupted: &AtomicBool::new(false),
            snapshots: &SnapshotCell::default(),
        },
        &RunOptions {
            rate_hz,
            ..options()
        },
    );
    recorder.finish();
    (summary, recorder)
}

fn emulated(emulator_seed: u64, run_seed: u64) -> (RunSummary, MemoryRecorder, SnapshotCell) {
    emulated_with(&EmulatorConfig::embedded_default(), emulator_seed, run_seed)
}

fn emulated_with(
    config: &EmulatorConfig,
    emulator_seed: u64,
    run_seed: u64,
) -> (RunSummary, MemoryRecorder, SnapshotCell) {
    let bench = BenchFile::embedded_default();
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(config, emulator_seed);
    let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let guard = Guard::new(bench.limits(), &bench.nameplate().unwrap(), Some(11.4));
    let session = Session::new(Box::new(bench.program(run_seed).unwrap()), guard);
    let mut recorder = MemoryRecorder::new(layout());
    let snapshots = SnapshotCell::default();
    let mut live = LiveOnline::new(layout(), OnlineConfig::default());
    let (_keep, intents) = channel();
    let summary = run(
        session,
        Bench {
            link: &mut link,
            clock: &mut clock,
            recorder: &mut recorder,
            estimator: Some(&mut live),
            intents: &intents,
            interrupted: &AtomicBool::new(false),
            snapshots: &snapshots,
        },
        &options(),
    );
    recorder.finish();
    (summary, recorder, snapshots)
}

#[test]
fn the_embedded_bench_runs_to_its_end_in_virtual_time() {
    for seed in 0..5 {
        let (summary, recorder, snapshots) = emulated(seed, 1);
        assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
        assert_eq!(summary.timing.missed_cycles, 0);
        assert!((summary.timing.rate_achieved_hz - 100.0).abs() < 1e-6);
        assert!(summary.link.balances() && summary.link.lost() == 0);
        assert!(summary.stop_error.is_none());
        let run = recorder.run("r").unwrap();
        let largest = |channel| {
            let cells = run
                .points(channel)
                .map(|(_, value): (f64, f64)| value.abs());
            cells.fold(0.0_f64, f64::max)
        };
        // The whole speed range, and below the drive's own current limit: the voltage is never clipped.
        assert!(largest(Channel::Speed) > 220.0);
        assert!(largest(Channel::Current) > 5.7 && largest(Channel::Current) < 11.0);
        assert!((largest(Channel::VoltageCmd) - 97.0).abs() < 1.0);
        let latest = snapshots.latest();
        assert_eq!(
            (latest.phase, latest.outcome),
            (Some(Phase::Done), Some("done"))
        );
        assert_eq!(latest.trace.len(), 1200);
        let model_error = latest
            .trace
            .iter()
            .map(|point| (point.speed_rad_s - point.model_speed_rad_s).abs());
        // The specimen differs from the nameplate, but a free run does not run away.
        assert!(model_error.fold(0.0, f64::max) < 80.0);
    }
}

#[test]
fn one_seed_gives_the_same_bytes_and_another_seed_others() {
    let (one, again, other) = (emulated(1, 1).1, emulated(1, 1).1, emulated(2, 1).1);
    assert_eq!(one.samples_csv(), again.samples_csv());
    assert_eq!(one.events_jsonl(), again.events_jsonl());
    assert_ne!(one.samples_csv(), other.samples_csv());
    assert_ne!(one.samples_csv(), emulated(1, 2).1.samples_csv());
}

#[test]
fn the_live_estimates_are_near_the_truth_and_a_replay_gives_them_to_the_bit() {
    let plain = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    for seed in 1..=3 {
        let (summary, recorder, _) = emulated_with(&plain, seed, 1);
        let csv = recorder.samples_csv();
        let mut rows = CsvRows::new(csv.as_bytes(), "r", ReadOptions::default()).unwrap();
        let again = replay(|| rows.next_row(), OnlineConfig::default()).unwrap();
        let again = again.online().estimates();
        assert_eq!(summary.estimates.len(), 5);
        for (live, replayed) in summary.estimates.iter().zip(&again) {
            assert_eq!(
                live.value.map(f64::to_bits),
                replayed.value.map(f64::to_bits),
                "{}",
                live.key
            );
            assert_eq!(live.std.map(f64::to_bits), replayed.std.map(f64::to_bits));
        }
        let truth = SoftDrive::new(&plain, seed).truth().clone();
        for (key, value, share) in [
            ("resistance_ohm", truth.resistance_ohm, 0.05),
            ("back_emf_v_s_per_rad", truth.back_emf_v_s_per_rad, 0.02),
            ("inertia_kg_m2", truth.inertia_kg_m2, 0.05),
        ] {
            let found = summary.estimates.iter().find(|found| found.key == key);
            let found = found.and_then(|found| found.value).unwrap();
            assert!(
                (found / value - 1.0).abs() < share,
                "{key}: {found}, true {value}"
            );
        }
    }
}

/// Stalls once, by `stall_s`, when `at_s` has come.
#[expect(
    clippy::struct_field_names,
    reason = "the unit suffix is the rule of the house"
)]
struct StallingClock {
    now_s: f64,
    at_s: f64,
    stall_s: f64,
}

impl Clock for StallingClock {
    fn now_s(&self) -> f64 {
        self.now_s
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        self.now_s = self.now_s.max(until_s);
        if self.now_s >= self.at_s {
            self.now_s += std::mem::take(&mut self.stall_s);
        }
    }

    fn is_real(&self) -> bool {
        false
    }
}

struct Scripted {
    drive: ScriptedDrive,
    clock: StallingClock,
    recorder: MemoryRecorder,
    interrupted: AtomicBool,
}

impl Scripted {
    fn new(drive: ScriptedDrive, stall_s: f64) -> Self {
        Self {
            drive,
            clock: StallingClock {
                now_s: 0.0,
                at_s: 0.5,
                stall_s,
            },
            recorder: MemoryRecorder::new(layout()),
            interrupted: AtomicBool::new(false),
        }
    }

    fn run(
        &mut self,
        estimator: Option<&mut dyn LiveEstimator>,
        script: impl FnOnce(&Sender<Intent>),
    ) -> RunSummary {
        let bench = BenchFile::embedded_default();
        let guard = Guard::new(bench.limits(), &bench.nameplate().unwrap(), None);
        let program = Wave {
            duration_s: 2.0,
            demand: |_| Demand::Voltage(10.0),
        };
        let (sender, intents) = channel();
        script(&sender);
        run(
            Session::new(Box::new(program), guard),
            Bench {
                link: &mut self.drive,
                clock: &mut self.clock,
                recorder: &mut self.recorder,
                estimator: estimator.map(|estimator| estimator as &mut dyn LiveEstimator),
                intents: &intents,
                interrupted: &self.interrupted,
                snapshots: &SnapshotCell::default(),
            },
            &options(),
        )
    }
}

#[test]
fn missed_deadlines_are_counted_recorded_and_not_made_up_for() {
    let mut bench = Scripted::new(ScriptedDrive::new(0.01), 0.043);
    let summary = bench.run(None, |_| {});
    assert_eq!(summary.outcome, Outcome::Done);
    assert_eq!(summary.timing.missed_cycles, 4);
    assert!((summary.timing.lateness_max_s - 0.003).abs() < 1e-9);
    let events = bench.recorder.events_jsonl();
    let lost = events.lines().find(|line| line.contains("deadline_lost"));
    assert!(lost.unwrap().contains("\"cycles\":4"), "{lost:?}");
    let exchanges = bench.drive.demands.len() as u64;
    assert_eq!(summary.timing.cycles, exchanges);
}

#[test]
fn a_host_that_stood_still_ends_at_stop() {
    let mut bench = Scripted::new(ScriptedDrive::new(0.01), 5.0);
    let summary = bench.run(None, |_| {});
    assert!(
        matches!(summary.outcome, Outcome::LinkLost { .. }),
        "{summary:?}"
    );
    assert_eq!(summary.outcome.exit_status(), 3);
    let last_on = bench
        .drive
        .demands
        .iter()
        .rposition(|demand| demand.energises())
        .unwrap();
    assert!(
        bench.drive.demands[last_on + 1..]
            .iter()
            .all(|demand| *demand == Demand::Stop)
    );
    assert!(bench.drive.stops >= 1);
}

#[test]
fn an_interrupt_ends_with_130_after_a_ramp_down() {
    let mut bench = Scripted::new(ScriptedDrive::new(0.01), 0.0);
    bench.interrupted.store(true, Ordering::Release);
    let summary = bench.run(None, |_| {});
    assert_eq!(summary.outcome, Outcome::Interrupted);
    assert_eq!(summary.outcome.exit_status(), 130);
    assert!(bench.drive.stops >= 1);
}

#[test]
fn a_link_that_is_gone_ends_the_run_and_is_described_in_the_manifest() {
    let drive = ScriptedDrive::new(0.01).with(60, u64::MAX, Fault::Gone);
    let mut bench = Scripted::new(drive, 0.0);
    let summary = bench.run(None, |_| {});
    let mut manifest = Manifest::default();
    summary.describe(&mut manifest);
    assert!(manifest.outcome.unwrap().contains("unplugged"));
    assert_eq!(manifest.link_statistics["aborted"], 1);
    assert!(bench.drive.stops >= 1);
}

#[test]
fn a_drive_that_never_answers_or_stays_in_fault_does_not_hang_the_run() {
    let silent = ScriptedDrive::new(0.01).with(0, u64::MAX, Fault::Timeout);
    let summary = Scripted::new(silent, 0.0).run(None, |_| {});
    assert!(matches!(summary.outcome, Outcome::LinkLost { .. }));
    let faulty = ScriptedDrive::new(0.01).with(0, u64::MAX, Fault::TripWith(3));
    let mut bench = Scripted::new(faulty, 0.0);
    let summary = bench.run(None, |_| {});
    assert!(matches!(&summary.outcome, Outcome::NotStarted { reason } if reason.contains("fault")));
    assert!(bench.drive.demands.iter().all(|demand| !demand.energises()));
}

#[test]
fn a_run_that_cannot_be_armed_ends_with_the_reason() {
    let drive = ScriptedDrive::new(0.01).with(0, u64::MAX, Fault::Missing(Channel::Current));
    let summary = Scripted::new(drive, 0.0).run(None, |_| {});
    assert_eq!(summary.outcome.exit_status(), 3);
    assert!(
        matches!(&summary.outcome, Outcome::NotStarted { reason } if reason.contains("current"))
    );
    assert!(
        summary
            .notices
            .iter()
            .any(|notice| notice.text.contains("current"))
    );
}

struct Bomb(u32);

impl LiveEstimator for Bomb {
    fn command(&mut self, _: &CommandRow) {}

    fn push(&mut self, _: &Sample) {
        self.0 -= 1;
        assert!(self.0 > 0, "boom");
    }

    fn finish(&mut self) {}

    fn estimates(&self) -> Vec<ParameterEstimate> {
        Vec::new()
    }
}

#[test]
fn a_panic_on_the_way_still_ends_at_zero_output() {
    let mut bench = Scripted::new(ScriptedDrive::new(0.01), 0.0);
    let result = catch_unwind(AssertUnwindSafe(|| bench.run(Some(&mut Bomb(30)), |_| {})));
    assert!(result.is_err());
    assert!(bench.drive.demands.last().unwrap().energises());
    assert_eq!(bench.drive.stops, 1);
}

#[test]
fn intents_of_the_screen_reach_the_session() {
    let mut bench = Scripted::new(ScriptedDrive::new(0.01), 0.0);
    let summary = bench.run(None, |sender| {
        sender.send(Intent::Mark("begin".to_owned())).unwrap();
        sender.send(Intent::Stop).unwrap();
    });
    assert_eq!(summary.outcome, Outcome::Stopped);
    let events = bench.recorder.events_jsonl();
    assert!(events.contains("\"text\":\"begin\""), "{events}");
}

#[test]
fn in_real_time_every_deadline_is_either_kept_or_counted() {
    let mut clock = MonotonicClock::start();
    let begin_s = clock.now_s();
    let mut drive = ScriptedDrive::new(0.005);
    let bench = BenchFile::embedded_default();
    let limits = crate::bench::limits::Limits {
        // A loaded test machine may well stand still for longer than a bench may.
        link_silence_s: 20.0,
        ..bench.limits()
    };
    let program = Wave {
        duration_s: 0.3,
        demand: |_| Demand::Voltage(5.0),
    };
    let (_keep, intents) = channel();
    let summary = run(
        Session::new(
            Box::new(program),
            Guard::new(limits, &bench.nameplate().unwrap(), None),
        ),
        Bench {
            link: &mut drive,
            clock: &mut clock,
            recorder: &mut MemoryRecorder::new(layout()),
            estimator: None,
            intents: &intents,
            interrupted: &AtomicBool::new(false),
            snapshots: &SnapshotCell::default(),
        },
        &RunOptions {
            rate_hz: 200.0,
            ..options()
        },
    );
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
    let deadlines = summary.timing.cycles + summary.timing.missed_cycles;
    let passed = whole((clock.now_s() - begin_s) / 0.005) as u64 + 1;
    assert!(deadlines <= passed, "no cycle runs ahead of its deadline");
    assert!(deadlines + 2 >= whole(summary.duration_s / 0.005) as u64);
    assert!(summary.timing.rate_achieved_hz <= 201.0);
}
