//! Broken signals through the session and the runner, in virtual time, and what must not be taken for broken.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;

use crate::bench::bench_file::BenchFile;
use crate::bench::guard::{Guard, Trip, TripKind};
use crate::bench::limits::{Limits, Nameplate};
use crate::bench::program::Program;
use crate::bench::runner::{Bench, RunOptions, run};
use crate::bench::session::{Outcome, Session};
use crate::bench::snapshot::{SnapshotCell, Target};
use crate::bench::testing::Wave;
use crate::drive::{CommandTimes, DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use crate::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock, mystery};
use crate::recording::{Layout, MemoryRecorder};
use crate::sample::{Channel, Command, Demand, Sample};

/// What is wrong on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wrong {
    Nothing,
    /// Speed and angle stay as they are.
    Frozen,
    Reversed,
    SpeedTimes(f64),
    /// The current reads the same from then on.
    CurrentStays,
    CurrentZero,
    CurrentTimes(f64),
    /// The drive goes on with the set-point of before, and tells it where it tells a voltage.
    Deaf {
        tells: bool,
    },
    SetPointTimes(f64),
    VoltageTimes(f64),
    SwappedCurrentSpeed,
    SwappedVoltageCurrent,
    /// The angle stays, the speed does not.
    AngleStays,
}

/// A link on which something goes wrong from an instant on, and whose values may be coarse, late and without a sign.
struct Broken {
    link: MemoryLink,
    clock: VirtualClock,
    wrong: Wrong,
    from_s: f64,
    /// Sensors are read once in so many exchanges, the command acts so many later.
    stale: u64,
    coarse: bool,
    unsigned: bool,
    /// Neither stamps nor a measured voltage.
    foreign: bool,
    held: Option<Sample>,
    deaf: Option<Demand>,
    exchanges: u64,
    /// Last demand that went to the drive.
    last: Demand,
}

impl Broken {
    fn spoil(&mut self, mut sample: Sample) -> Sample {
        let raw = |sample: &Sample, channel| sample.get(channel).unwrap();
        if self.stale > 1 {
            if self.exchanges.is_multiple_of(self.stale) || self.held.is_none() {
                self.held = Some(sample.clone());
            }
            let held = self.held.as_ref().unwrap();
            for channel in [Channel::Speed, Channel::Current, Channel::Angle] {
                sample.set(channel, raw(held, channel));
            }
        }
        let (volts, amps, speed) = (
            raw(&sample, Channel::Voltage),
            raw(&sample, Channel::Current),
            raw(&sample, Channel::Speed),
        );
        if self.clock.time_s() >= self.from_s {
            let still = self.held.get_or_insert_with(|| sample.clone()).clone();
            match self.wrong {
                Wrong::Nothing | Wrong::Deaf { tells: true } | Wrong::SetPointTimes(_) => {}
                Wrong::Frozen => {
                    for channel in [Channel::Speed, Channel::Angle] {
                        sample.set(channel, raw(&still, channel));
                    }
                }
                Wrong::AngleStays => sample.set(Channel::Angle, raw(&still, Channel::Angle)),
                Wrong::Reversed => {
                    sample.set(Channel::Speed, -speed);
                    sample.set(Channel::Angle, f64::NAN);
                }
                Wrong::SpeedTimes(factor) => {
                    sample.set(Channel::Speed, factor * speed);
                    sample.set(Channel::Angle, f64::NAN);
                }
                Wrong::CurrentStays => sample.set(Channel::Current, raw(&still, Channel::Current)),
                Wrong::CurrentZero => sample.set(Channel::Current, 0.0),
                Wrong::CurrentTimes(factor) => sample.set(Channel::Current, factor * amps),
                Wrong::Deaf { tells: false } => sample.set(Channel::Voltage, f64::NAN),
                Wrong::VoltageTimes(factor) => sample.set(Channel::Voltage, factor * volts),
                Wrong::SwappedCurrentSpeed => {
                    sample.set(Channel::Current, speed);
                    sample.set(Channel::Speed, amps);
                }
                Wrong::SwappedVoltageCurrent => {
                    sample.set(Channel::Voltage, amps);
                    sample.set(Channel::Current, volts);
                }
            }
        }
        if self.coarse {
            for (channel, step) in [
                (Channel::Voltage, 0.1),
                (Channel::Current, 0.01),
                (Channel::Speed, 0.104_719_755),
            ] {
                if let Some(value) = sample.get(channel) {
                    sample.set(channel, step * (value / step).round());
                }
            }
        }
        if self.unsigned
            && let Some(amps) = sample.get(Channel::Current)
        {
            sample.set(Channel::Current, amps.abs());
        }
        if self.foreign {
            sample.applied = None;
            sample.set(Channel::Voltage, f64::NAN);
        }
        sample
    }
}

impl DriveLink for Broken {
    fn name(&self) -> LinkName {
        self.link.name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.link.identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.exchanges += 1;
        let mut command = command;
        let broken = self.clock.time_s() >= self.from_s;
        if let (true, Demand::Voltage(volts)) = (broken, command.demand) {
            match self.wrong {
                Wrong::Deaf { .. } => {
                    let volts = match self.last {
                        Demand::Voltage(volts) => volts,
                        _ => 0.0,
                    };
                    command.demand = *self.deaf.get_or_insert(Demand::Voltage(volts));
                }
                Wrong::SetPointTimes(factor) => command.demand = Demand::Voltage(factor * volts),
                _ => {}
            }
        }
        self.last = command.demand;
        let sample = self.link.exchange(command)?;
        Ok(self.spoil(sample))
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.link.stop()
    }

    fn command_times(&self) -> CommandTimes {
        self.link.command_times()
    }

    fn statistics(&self) -> LinkStatistics {
        self.link.statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }
}

/// One run.
#[expect(
    clippy::struct_excessive_bools,
    reason = "what is odd about a drive, each for itself"
)]
struct Trial {
    wrong: Wrong,
    from_s: f64,
    rate_hz: f64,
    stale: u64,
    coarse: bool,
    unsigned: bool,
    foreign: bool,
    waived: bool,
    config: EmulatorConfig,
    plate: Nameplate,
    limits: Limits,
    seed: u64,
}

impl Trial {
    fn new(wrong: Wrong, from_s: f64, seed: u64) -> Self {
        let bench = BenchFile::embedded_default();
        Self {
            wrong,
            from_s,
            rate_hz: 100.0,
            stale: 1,
            coarse: false,
            unsigned: false,
            foreign: false,
            waived: false,
            config: EmulatorConfig::embedded("zk-22fc-plain").unwrap(),
            plate: bench.nameplate().unwrap(),
            limits: bench.limits(),
            seed,
        }
    }

    fn of(self, program: Box<dyn Program>) -> Outcome {
        let mut clock = VirtualClock::new();
        let drive = SoftDrive::new(&self.config, self.seed);
        let mut link = Broken {
            link: MemoryLink::new(drive, clock.clone(), Latency::default()),
            clock: clock.clone(),
            wrong: self.wrong,
            from_s: self.from_s,
            stale: self.stale,
            coarse: self.coarse,
            unsigned: self.unsigned,
            foreign: self.foreign,
            held: None,
            deaf: None,
            exchanges: 0,
            last: Demand::Disable,
        };
        let guard = Guard::new(self.limits.clone(), &self.plate, Some(11.4))
            .with_period(1.0 / self.rate_hz);
        let mut session = Session::new(program, guard);
        if self.waived {
            session = session.with_waivers(vec!["plausibility".to_owned()]);
        }
        let mut recorder = MemoryRecorder::new(Layout::of_drive(&[
            Channel::VoltageCmd,
            Channel::Voltage,
            Channel::Current,
            Channel::Speed,
        ]));
        let (_keep, intents) = channel();
        let summary = run(
            session,
            Bench {
                link: &mut link,
                clock: &mut clock,
                recorder: &mut recorder,
                estimator: None,
                intents: &intents,
                interrupted: &AtomicBool::new(false),
                snapshots: &SnapshotCell::default(),
            },
            &RunOptions {
                name: "trial".to_owned(),
                target: Target::Sim,
                rate_hz: self.rate_hz,
                motor: None,
                auto_start: true,
            },
        );
        assert!(
            matches!(link.last, Demand::Stop | Demand::Disable),
            "{:?}",
            link.last
        );
        summary.outcome
    }

    fn embedded(self) -> Outcome {
        let program = BenchFile::embedded_default().program(self.seed).unwrap();
        self.of(Box::new(program))
    }
}

/// Whether the watch has spoken.
const fn is_doubt(kind: TripKind) -> bool {
    matches!(
        kind,
        TripKind::EncoderFrozen
            | TripKind::EncoderReversed
            | TripKind::SpeedImplausible
            | TripKind::ShaftHeld
            | TripKind::AngleImplausible
            | TripKind::CurrentStuck
            | TripKind::CurrentReversed
            | TripKind::CurrentImplausible
            | TripKind::OpenCircuit
            | TripKind::SetPointIgnored
            | TripKind::VoltageImplausible
            | TripKind::SignalsSwapped
    )
}

/// Ten seeds with this fault from each instant on; `(from, latest)`: the host times between which it has to be found. The
/// motor begins to turn at 0.53 s, runs at 95 V until 1.6 s and is back at rest at 2.3 s.
#[track_caller]
fn found(wrong: Wrong, times: &[(f64, f64)], kinds: &[TripKind]) {
    for &(from_s, latest_s) in times {
        for seed in 1..=10 {
            let outcome = Trial::new(wrong, from_s, seed).embedded();
            let Outcome::Tripped(trip) = &outcome else {
                panic!("{wrong:?} from {from_s} s, seed {seed}: {outcome:?}");
            };
            assert!(
                kinds.contains(&trip.kind),
                "{wrong:?} from {from_s} s, seed {seed}: {trip:?}"
            );
            assert!(
                trip.at_s <= latest_s,
                "{wrong:?} from {from_s} s, seed {seed}: {trip:?}"
            );
            assert_eq!(outcome.exit_status(), 4);
        }
    }
}

#[test]
fn a_frozen_or_reversed_encoder_ends_a_run() {
    found(
        Wrong::Frozen,
        &[(0.0, 0.75), (1.2, 1.4), (2.0, 2.2)],
        &[TripKind::EncoderFrozen],
    );
    found(
        Wrong::Reversed,
        &[(0.0, 0.75), (1.2, 1.4), (2.0, 2.2)],
        &[TripKind::EncoderReversed],
    );
}

#[test]
fn an_encoder_that_reads_a_third_or_three_times_the_speed_ends_a_run() {
    // From rest it shows from some 60 rad/s on, that is from 0.8 s.
    let kinds = [TripKind::SpeedImplausible, TripKind::OverSpeed];
    found(Wrong::SpeedTimes(0.3), &[(0.0, 1.0), (1.2, 1.4)], &kinds);
    found(Wrong::SpeedTimes(3.0), &[(0.0, 1.0), (1.2, 1.4)], &kinds);
}

#[test]
fn a_current_that_stays_or_has_the_wrong_sign_ends_a_run() {
    let kinds = [TripKind::CurrentStuck];
    found(
        Wrong::CurrentZero,
        &[(0.0, 0.75), (1.2, 1.4), (2.0, 2.2)],
        &kinds,
    );
    found(
        Wrong::CurrentStays,
        &[(0.0, 0.75), (1.2, 1.4), (2.0, 2.2)],
        &kinds,
    );
    // At a steady 1.3 A nothing shows, and little while it is only braked; it shows at the latest when it accelerates again.
    let times = [(0.0, 0.75), (1.2, 3.6), (2.0, 2.2)];
    found(
        Wrong::CurrentTimes(-1.0),
        &times,
        &[TripKind::CurrentReversed],
    );
}

#[test]
fn a_current_of_a_wrong_scale_ends_a_run_once_both_balances_have_seen_enough() {
    // Three times as much is beyond the current limit first; a third of it shows in no single row.
    let kinds = [
        TripKind::CurrentImplausible,
        TripKind::OverCurrent,
        TripKind::SignalsSwapped,
    ];
    found(Wrong::CurrentTimes(3.0), &[(0.0, 0.75), (2.0, 2.2)], &kinds);
    found(
        Wrong::CurrentTimes(0.3),
        &[(0.0, 4.0)],
        &[TripKind::CurrentImplausible],
    );
}

#[test]
fn a_drive_that_does_not_do_what_it_is_asked_ends_a_run_with_a_measured_voltage_or_without() {
    let kinds = [TripKind::SetPointIgnored];
    let times = [(0.0, 1.0), (1.2, 1.85), (2.0, 2.5)];
    found(Wrong::Deaf { tells: true }, &times, &kinds);
    found(Wrong::Deaf { tells: false }, &times, &kinds);
    found(Wrong::SetPointTimes(0.3), &[(0.0, 1.0)], &kinds);
    found(
        Wrong::VoltageTimes(0.3),
        &[(0.0, 1.0)],
        &[TripKind::VoltageImplausible],
    );
}

#[test]
fn signals_in_each_other_s_place_are_named_as_such() {
    let kinds = [TripKind::SignalsSwapped];
    found(Wrong::SwappedCurrentSpeed, &[(0.0, 0.75)], &kinds);
    found(
        Wrong::SwappedVoltageCurrent,
        &[(0.0, 0.75), (1.2, 1.4)],
        &kinds,
    );
    found(
        Wrong::AngleStays,
        &[(0.0, 1.0), (1.2, 1.45)],
        &[TripKind::AngleImplausible],
    );
}

#[test]
fn waived_a_scale_is_no_matter_and_a_broken_signal_still_is() {
    let waived = |wrong| {
        let mut trial = Trial::new(wrong, 0.0, 1);
        trial.waived = true;
        match trial.embedded() {
            Outcome::Tripped(trip) => Some(trip.kind),
            _ => None,
        }
    };
    assert_eq!(waived(Wrong::SpeedTimes(0.3)), None);
    assert_eq!(waived(Wrong::CurrentTimes(0.3)), None);
    assert_eq!(waived(Wrong::Frozen), Some(TripKind::EncoderFrozen));
    assert_eq!(waived(Wrong::Reversed), Some(TripKind::EncoderReversed));
    assert_eq!(waived(Wrong::CurrentZero), Some(TripKind::CurrentStuck));
    assert_eq!(
        waived(Wrong::Deaf { tells: true }),
        Some(TripKind::SetPointIgnored)
    );
}

/// What the watch says of a healthy drive, if anything.
fn said(trial: Trial, program: Box<dyn Program>, about: &str) -> Option<String> {
    match trial.of(program) {
        Outcome::Tripped(trip) if is_doubt(trip.kind) => Some(format!("{about}: {}", trip.reason)),
        _ => None,
    }
}

fn embedded_program(seed: u64) -> Box<dyn Program> {
    Box::new(BenchFile::embedded_default().program(seed).unwrap())
}

#[test]
fn a_healthy_motor_with_any_hidden_effect_is_believed() {
    let mut false_alarms = Vec::new();
    for name in [
        "hidden", "plain", "viscous", "fan", "brushes", "warming", "changing",
    ] {
        for seed in 1..=3 {
            let mut trial = Trial::new(Wrong::Nothing, 0.0, seed);
            trial.config = EmulatorConfig::embedded(&format!("zk-22fc-{name}")).unwrap();
            trial.config.tolerance = 0.1 * seed as f64;
            let about = format!("{name}, seed {seed}");
            false_alarms.extend(said(trial, embedded_program(seed), &about));
        }
    }
    for seed in 1..=40 {
        let mut trial = Trial::new(Wrong::Nothing, 0.0, seed);
        trial.config = mystery::draw(seed).config;
        trial.config.tolerance = 0.3;
        let about = format!("mystery {seed}: {:?}", trial.config.hidden);
        false_alarms.extend(said(trial, embedded_program(seed), &about));
    }
    assert_eq!(false_alarms, Vec::<String>::new());
}

/// Up, down and back, with time to settle.
fn slow_steps() -> Box<dyn Program> {
    Box::new(Wave {
        duration_s: 12.0,
        demand: |time_s| {
            let levels = [0.0, 20.0, 60.0, 30.0, 0.0, -40.0, -80.0, 10.0];
            let level = (time_s / 1.5).floor();
            let index = levels
                .iter()
                .enumerate()
                .filter(|(n, _)| *n as f64 <= level)
                .count()
                - 1;
            Demand::Voltage(levels[index])
        },
    })
}

#[test]
fn a_slow_coarse_and_stale_drive_is_believed() {
    let mut false_alarms = Vec::new();
    for (rate_hz, stale) in [
        (50.0, 1),
        (50.0, 4),
        (33.0, 3),
        (20.0, 2),
        (20.0, 3),
        (10.0, 1),
        (10.0, 2),
        (8.0, 1),
        (8.0, 3),
    ] {
        for seed in 1..=3 {
            for foreign in [false, true] {
                let mut trial = Trial::new(Wrong::Nothing, 0.0, seed);
                trial.config.tolerance = 0.3;
                trial.config.watchdog_ms = 1000;
                trial.limits.link_silence_s = 0.6;
                // Its samples are not stamped where its values are older than they say.
                (trial.rate_hz, trial.stale) = (rate_hz, if foreign { stale } else { 1 });
                (trial.coarse, trial.unsigned, trial.foreign) = (true, seed == 2, foreign);
                let about = format!("{rate_hz} Hz, stale {stale}, foreign {foreign}, seed {seed}");
                false_alarms.extend(said(trial, slow_steps(), &about));
            }
        }
    }
    assert_eq!(false_alarms, Vec::<String>::new());
}

#[test]
fn on_a_slow_drive_a_broken_encoder_is_found_within_five_cycles_too() {
    for (wrong, kind) in [
        (Wrong::Frozen, TripKind::EncoderFrozen),
        (Wrong::Reversed, TripKind::EncoderReversed),
        (Wrong::SpeedTimes(0.3), TripKind::SpeedImplausible),
    ] {
        for rate_hz in [8.0, 20.0, 50.0] {
            let mut trial = Trial::new(wrong, 3.5, 1);
            trial.config.watchdog_ms = 1000;
            trial.limits.link_silence_s = 0.6;
            (trial.rate_hz, trial.coarse, trial.foreign) = (rate_hz, true, true);
            let outcome = trial.of(slow_steps());
            let Outcome::Tripped(Trip {
                kind: found,
                at_s,
                reason,
                ..
            }) = &outcome
            else {
                panic!("{wrong:?} {rate_hz} Hz: {outcome:?}");
            };
            assert_eq!(*found, kind, "{rate_hz} Hz: {reason}");
            // A speed that froze on a plateau shows when the voltage leaves it, at 4.5 s.
            let from_s = if kind == TripKind::EncoderFrozen {
                4.6
            } else {
                3.5
            };
            let latest_s = from_s + (7.0 / rate_hz).max(0.3) + 0.1;
            assert!(*at_s <= latest_s, "{wrong:?} {rate_hz} Hz: {at_s} {reason}");
        }
    }
}
