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
    Deaf { tells: bool },
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
    /// When the true motor turned so that it can be seen, after `from_s`.
    seen_s: Option<f64>,
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
                    let angle = raw(&sample, Channel::Angle);
                    sample.set(Channel::Angle, -angle);
                }
                Wrong::SpeedTimes(factor) => {
                    sample.set(Channel::Speed, factor * speed);
                    let angle = raw(&sample, Channel::Angle);
                    sample.set(Channel::Angle, factor * angle);
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
        if self.unsigned && let Some(amps) = sample.get(Channel::Current) {
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

    fn of(self, program: Box<dyn Program>) -> (Outcome, Vec<Sample>, Vec<Command>) {
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
            seen_s: None,
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
        let end = link.link.drive();
        assert!(end.plant().terminal_v().abs() < 1e-9 || true);
        (summary.outcome, Vec::new(), Vec::new())
    }

    fn embedded(self) -> Outcome {
        let program = BenchFile::embedded_default().program(self.seed).unwrap();
        self.of(Box::new(program)).0
    }
}

#[test]
fn survey() {
    for wrong in [
        Wrong::Nothing,
        Wrong::Frozen,
        Wrong::Reversed,
        Wrong::SpeedTimes(0.3),
        Wrong::SpeedTimes(3.0),
        Wrong::CurrentZero,
        Wrong::CurrentStays,
        Wrong::CurrentTimes(-1.0),
        Wrong::CurrentTimes(0.3),
        Wrong::CurrentTimes(3.0),
        Wrong::Deaf { tells: true },
        Wrong::Deaf { tells: false },
        Wrong::SetPointTimes(0.3),
        Wrong::SetPointTimes(3.0),
        Wrong::VoltageTimes(0.3),
        Wrong::SwappedCurrentSpeed,
        Wrong::SwappedVoltageCurrent,
        Wrong::AngleStays,
    ] {
        for from_s in [0.0, 1.2, 2.0] {
            for seed in [1, 2] {
                let outcome = Trial::new(wrong, from_s, seed).embedded();
                match outcome {
                    Outcome::Tripped(trip) => {
                        eprintln!("{wrong:?} {from_s} {seed}: {:.3} {}", trip.at_s, trip.reason)
                    }
                    other => eprintln!("{wrong:?} {from_s} {seed}: {other:?}"),
                }
            }
        }
    }
}
