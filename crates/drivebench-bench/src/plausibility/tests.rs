//! Sensor and actuator faults through session and runner, in virtual time, and healthy drives without a false alarm.

use crate::bench_file::BenchFile;
use crate::guard::Guard;
use crate::limits::{Limits, Nameplate};
use crate::pilot::Pilot;
use crate::session::{Outcome, Session};
use crate::testing::{Tamper, Tampered, TestRun, Wave, in_memory};
use crate::trip::TripKind;
use drivebench_emulator::{EmulatorConfig, MemoryLink, VirtualClock, mystery};
use drivebench_link::{DriveLink, LinkError};
use drivebench_model::numerics::count::whole;
use drivebench_model::sample::{Channel, Command, Demand, Sample};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum SignalFault {
    #[default]
    Nothing,
    /// These signals are frozen.
    Stays(&'static [Channel]),
    Times(Channel, f64),
    Swapped(Channel, Channel),
    /// The drive keeps its last set-point.
    Ignores {
        reports_voltage: bool,
    },
    SetPointTimes(f64),
}

const FROZEN: SignalFault = SignalFault::Stays(&[Channel::Speed, Channel::Angle]);
const REVERSED: SignalFault = SignalFault::Times(Channel::Speed, -1.0);
const CURRENT_ZERO: SignalFault = SignalFault::Times(Channel::Current, 0.0);

#[derive(Clone, Copy, Default)]
struct Traits {
    fault: SignalFault,
    from_s: f64,
    /// Exchanges between two readings of the sensors.
    stale: u64,
    coarse: bool,
    unsigned: bool,
    /// Neither stamps nor a measured voltage.
    foreign: bool,
}

struct Broken {
    traits: Traits,
    clock: VirtualClock,
    kept: Option<Sample>,
    ignoring: Option<Demand>,
    exchanges: u64,
    /// Last demand that went to the drive.
    last: Demand,
}

impl Broken {
    fn with_fault(&mut self, mut sample: Sample) -> Sample {
        let raw = |sample: &Sample, channel| sample.get(channel).unwrap();
        if self.traits.stale > 1 {
            if self.exchanges.is_multiple_of(self.traits.stale) || self.kept.is_none() {
                self.kept = Some(sample.clone());
            }
            let kept = self.kept.as_ref().unwrap();
            for channel in [Channel::Speed, Channel::Current, Channel::Angle] {
                sample.set(channel, raw(kept, channel));
            }
        }
        if self.clock.time_s() >= self.traits.from_s {
            let still = self.kept.get_or_insert_with(|| sample.clone()).clone();
            match self.traits.fault {
                SignalFault::Nothing
                | SignalFault::Ignores { reports_voltage: true }
                | SignalFault::SetPointTimes(_) => {}
                SignalFault::Stays(channels) => {
                    for channel in channels {
                        sample.set(*channel, raw(&still, *channel));
                    }
                }
                SignalFault::Times(channel, factor) => {
                    sample.set(channel, factor * raw(&sample, channel));
                    if channel == Channel::Speed {
                        sample.set(Channel::Angle, f64::NAN);
                    }
                }
                SignalFault::Swapped(one, other) => {
                    let values = [raw(&sample, one), raw(&sample, other)];
                    sample.set(one, values[1]);
                    sample.set(other, values[0]);
                }
                SignalFault::Ignores { reports_voltage: false } => {
                    sample.set(Channel::Voltage, f64::NAN);
                }
            }
        }
        if self.traits.coarse {
            for (channel, step) in
                [(Channel::Voltage, 0.1), (Channel::Current, 0.01), (Channel::Speed, 0.104_719_755)]
            {
                if let Some(value) = sample.get(channel) {
                    sample.set(channel, step * (value / step).round());
                }
            }
        }
        if self.traits.unsigned
            && let Some(amps) = sample.get(Channel::Current)
        {
            sample.set(Channel::Current, amps.abs());
        }
        if self.traits.foreign {
            sample.applied = None;
            sample.set(Channel::Voltage, f64::NAN);
        }
        sample
    }
}

impl Tamper<MemoryLink> for Broken {
    fn exchange(&mut self, link: &mut MemoryLink, command: Command) -> Result<Sample, LinkError> {
        self.exchanges += 1;
        let mut command = command;
        let broken = self.clock.time_s() >= self.traits.from_s;
        if let (true, Demand::Voltage(volts)) = (broken, command.demand) {
            match self.traits.fault {
                SignalFault::Ignores { .. } => {
                    let before = Demand::Voltage(self.last.voltage_v().unwrap_or(0.0));
                    command.demand = *self.ignoring.get_or_insert(before);
                }
                SignalFault::SetPointTimes(factor) => {
                    command.demand = Demand::Voltage(factor * volts);
                }
                _ => {}
            }
        }
        self.last = command.demand;
        Ok(self.with_fault(link.exchange(command)?))
    }
}

struct Trial {
    traits: Traits,
    rate_hz: f64,
    waived: bool,
    config: EmulatorConfig,
    nameplate: Nameplate,
    limits: Limits,
    seed: u64,
}

impl Trial {
    fn new(fault: SignalFault, from_s: f64, seed: u64) -> Self {
        let bench = BenchFile::embedded_default();
        Self {
            traits: Traits { fault, from_s, stale: 1, ..Traits::default() },
            rate_hz: 100.0,
            waived: false,
            config: EmulatorConfig::embedded("zk-22fc-plain").unwrap(),
            nameplate: bench.nameplate().unwrap(),
            limits: bench.limits(),
            seed,
        }
    }

    /// A drive on a slow line, with the watchdog and the allowed silence of that line.
    fn slow(fault: SignalFault, from_s: f64, seed: u64, rate_hz: f64) -> Self {
        let mut trial = Self::new(fault, from_s, seed);
        trial.rate_hz = rate_hz;
        trial.traits.coarse = true;
        trial.config.watchdog_ms = 1000;
        trial.limits.link_silence_s = 0.6;
        trial
    }

    fn run(self, program: Box<dyn Pilot>) -> Outcome {
        let (link, mut clock) = in_memory(&self.config, self.seed);
        let by = Broken {
            traits: self.traits,
            clock: clock.clone(),
            kept: None,
            ignoring: None,
            exchanges: 0,
            last: Demand::Disable,
        };
        let mut link = Tampered { link, by };
        let guard = Guard::new(self.limits, &self.nameplate, Some(11.4));
        let mut session = Session::new(program, guard.with_period(1.0 / self.rate_hz));
        if self.waived {
            session = session.with_waivers(vec!["plausibility".to_owned()]);
        }
        let (summary, _) = TestRun::at(self.rate_hz).run(session, &mut link, &mut clock);
        let last = link.by.last;
        assert!(matches!(last, Demand::Stop | Demand::Disable), "{last:?}");
        summary.outcome
    }

    /// On the embedded sequence.
    fn outcome(self) -> Outcome {
        let program = embedded_program(self.seed);
        self.run(program)
    }
}

/// A trip of the fault detection, not of a limit.
const fn is_fault_detection(kind: TripKind) -> bool {
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

/// The embedded motor begins to turn at 0.53 s, runs at 95 V until 1.6 s and is back at rest at 2.3 s.
#[test]
fn a_broken_signal_ends_a_run_in_time_with_its_name() {
    use SignalFault::{Ignores, SetPointTimes, Stays, Swapped, Times};
    use TripKind::{
        AngleImplausible, CurrentImplausible, CurrentReversed, CurrentStuck, EncoderFrozen,
        EncoderReversed, OverCurrent, OverSpeed, SetPointIgnored, SignalsSwapped, SpeedImplausible,
        VoltageImplausible,
    };
    // Host time of the fault, and the latest at which it has to be found.
    const REST: (f64, f64) = (0.0, 0.75);
    const START: (f64, f64) = (0.0, 1.0);
    const FAST: (f64, f64) = (1.2, 1.4);
    const BACK: (f64, f64) = (2.0, 2.2);
    const IGNORES: &[(f64, f64)] = &[START, (1.2, 1.85), (2.0, 2.5)];
    type Case = (SignalFault, &'static [(f64, f64)], &'static [TripKind]);
    let cases: [Case; 16] = [
        (FROZEN, &[REST, FAST, BACK], &[EncoderFrozen]),
        (REVERSED, &[REST, FAST, BACK], &[EncoderReversed]),
        // From rest a third or three times the speed is observable from some 60 rad/s on, after 0.8 s.
        (Times(Channel::Speed, 0.3), &[START, FAST], &[SpeedImplausible, OverSpeed]),
        (Times(Channel::Speed, 3.0), &[START, FAST], &[SpeedImplausible, OverSpeed]),
        (CURRENT_ZERO, &[REST, FAST, BACK], &[CurrentStuck]),
        (Stays(&[Channel::Current]), &[REST, FAST, BACK], &[CurrentStuck]),
        // At a steady 1.3 A it is not observable, and hardly while braking; at the latest at the next acceleration.
        (Times(Channel::Current, -1.0), &[REST, (1.2, 3.6), BACK], &[CurrentReversed]),
        // Three times as much exceeds the current limit first; a third of it is observable only over many rows.
        (
            Times(Channel::Current, 3.0),
            &[REST, BACK],
            &[CurrentImplausible, OverCurrent, SignalsSwapped],
        ),
        (Times(Channel::Current, 0.3), &[(0.0, 4.0)], &[CurrentImplausible]),
        (Ignores { reports_voltage: true }, IGNORES, &[SetPointIgnored]),
        (Ignores { reports_voltage: false }, IGNORES, &[SetPointIgnored]),
        (SetPointTimes(0.3), &[START], &[SetPointIgnored]),
        (Times(Channel::Voltage, 0.3), &[START], &[VoltageImplausible]),
        (Swapped(Channel::Current, Channel::Speed), &[REST], &[SignalsSwapped]),
        (Swapped(Channel::Voltage, Channel::Current), &[REST, FAST], &[SignalsSwapped]),
        (Stays(&[Channel::Angle]), &[START, (1.2, 1.45)], &[AngleImplausible]),
    ];
    for (fault, times, kinds) in cases {
        for &(from_s, latest_s) in times {
            for seed in 1..=10 {
                let about = format!("{fault:?} from {from_s} s, seed {seed}");
                let outcome = Trial::new(fault, from_s, seed).outcome();
                let Outcome::Tripped(trip) = &outcome else {
                    panic!("{about}: {outcome:?}");
                };
                assert!(kinds.contains(&trip.kind), "{about}: {trip:?}");
                assert!(trip.at_s <= latest_s, "{about}: {trip:?}");
                assert_eq!(outcome.exit_status(), 4);
            }
        }
    }
}

#[test]
fn a_waiver_covers_a_scale_and_no_broken_signal() {
    for (fault, expected) in [
        (SignalFault::Times(Channel::Speed, 0.3), None),
        (SignalFault::Times(Channel::Current, 0.3), None),
        (FROZEN, Some(TripKind::EncoderFrozen)),
        (REVERSED, Some(TripKind::EncoderReversed)),
        (CURRENT_ZERO, Some(TripKind::CurrentStuck)),
        (SignalFault::Ignores { reports_voltage: true }, Some(TripKind::SetPointIgnored)),
    ] {
        let mut trial = Trial::new(fault, 0.0, 1);
        trial.waived = true;
        let found = match trial.outcome() {
            Outcome::Tripped(trip) => Some(trip.kind),
            _ => None,
        };
        assert_eq!(found, expected, "{fault:?}");
    }
}

/// A false alarm of a healthy drive.
fn false_alarm(trial: Trial, program: Box<dyn Pilot>, about: &str) -> Option<String> {
    match trial.run(program) {
        Outcome::Tripped(trip) if is_fault_detection(trip.kind) => {
            Some(format!("{about}: {}", trip.reason))
        }
        _ => None,
    }
}

fn embedded_program(seed: u64) -> Box<dyn Pilot> {
    Box::new(BenchFile::embedded_default().program(seed).unwrap())
}

#[test]
fn a_motor_with_any_hidden_effect_causes_no_false_alarm() {
    let mut false_alarms = Vec::new();
    for name in ["hidden", "plain", "viscous", "fan", "brushes", "warming", "changing"] {
        for seed in 1..=3 {
            let mut trial = Trial::new(SignalFault::Nothing, 0.0, seed);
            trial.config = EmulatorConfig::embedded(&format!("zk-22fc-{name}")).unwrap();
            trial.config.tolerance = 0.1 * seed as f64;
            let about = format!("{name}, seed {seed}");
            false_alarms.extend(false_alarm(trial, embedded_program(seed), &about));
        }
    }
    for seed in 1..=40 {
        let mut trial = Trial::new(SignalFault::Nothing, 0.0, seed);
        trial.config = mystery::draw(seed).config;
        trial.config.tolerance = 0.3;
        let about = format!("mystery {seed}: {:?}", trial.config.hidden);
        false_alarms.extend(false_alarm(trial, embedded_program(seed), &about));
    }
    assert_eq!(false_alarms, Vec::<String>::new());
}

/// Up, down and back, with time to settle.
fn slow_steps() -> Box<dyn Pilot> {
    Box::new(Wave {
        duration_s: 12.0,
        demand: |time_s| {
            let levels = [0.0, 20.0, 60.0, 30.0, 0.0, -40.0, -80.0, 10.0];
            Demand::Voltage(levels[whole((time_s / 1.5).floor()).min(levels.len() - 1)])
        },
    })
}

#[test]
fn a_slow_coarse_and_stale_drive_causes_no_false_alarm() {
    let mut false_alarms = Vec::new();
    let slow = [(20.0, 2), (20.0, 3), (10.0, 1), (10.0, 2), (8.0, 1), (8.0, 3)];
    for (rate_hz, stale) in [(50.0, 1), (50.0, 4), (33.0, 3)].into_iter().chain(slow) {
        for seed in 1..=3 {
            for foreign in [false, true] {
                let mut trial = Trial::slow(SignalFault::Nothing, 0.0, seed, rate_hz);
                trial.config.tolerance = 0.3;
                // Samples with stale values have no stamps.
                trial.traits.stale = if foreign { stale } else { 1 };
                (trial.traits.unsigned, trial.traits.foreign) = (seed == 2, foreign);
                let about = format!("{rate_hz} Hz, stale {stale}, foreign {foreign}, seed {seed}");
                false_alarms.extend(false_alarm(trial, slow_steps(), &about));
            }
        }
    }
    assert_eq!(false_alarms, Vec::<String>::new());
}

#[test]
fn a_slow_drives_encoder_fault_is_found_in_five_cycles() {
    for (fault, kind) in [
        (FROZEN, TripKind::EncoderFrozen),
        (REVERSED, TripKind::EncoderReversed),
        (SignalFault::Times(Channel::Speed, 0.3), TripKind::SpeedImplausible),
    ] {
        for rate_hz in [8.0, 20.0, 50.0] {
            let mut trial = Trial::slow(fault, 3.5, 1, rate_hz);
            trial.traits.foreign = true;
            let outcome = trial.run(slow_steps());
            let Outcome::Tripped(trip) = &outcome else {
                panic!("{fault:?} {rate_hz} Hz: {outcome:?}");
            };
            assert_eq!(trip.kind, kind, "{rate_hz} Hz: {}", trip.reason);
            // A speed that is frozen at a constant level is detected when the voltage changes, at 4.5 s.
            let frozen = kind == TripKind::EncoderFrozen;
            let from_s = if frozen { 4.6 } else { 3.5 };
            let latest_s = from_s + (7.0 / rate_hz).max(0.3) + 0.1;
            assert!(trip.at_s <= latest_s, "{fault:?} {rate_hz} Hz: {trip:?}");
        }
    }
}
