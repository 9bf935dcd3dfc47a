//! Test fixtures of the bench: the paper's motor, scripted drives and links, one way to run a session, and assertions that
//! show their values.

use std::collections::VecDeque;
use std::fmt::{Debug, Display};
use std::ops::RangeBounds;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::RngCore;

use super::bench_file::BenchFile;
use super::check::{CheckOptions, FirstMove, Waivers};
use super::clock::Clock;
use super::describe::layout;
use super::guard::Guard;
use super::limits::{Limits, Nameplate};
use super::live_online::RowEstimator;
use super::pilot::Pilot;
use super::runner::{Bench, RunOptions, RunSummary, run};
use super::session::{Action, Input, Intent, Lost, Outcome, Session};
use super::snapshot::{SnapshotCell, Target};
use super::speed::{Design, PilotSettings, SpeedPilot, timing};
use super::trip::{Trip, TripKind};
use crate::recording::{Layout, MemoryRecorder};
use drivebench_control::Actuator;
use drivebench_emulator::truth::MotorTruth;
use drivebench_emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use drivebench_link::{
    CommandTimes, DriveLink, DriveProfile, Identity, LinkError, LinkName, LinkStatistics,
    Requested, exception_name,
};
use drivebench_model::plant::Model;
use drivebench_model::sample::{Applied, Channel, Command, Demand, DriveState, Sample};

/// Signals that a drive with the usual sensors gives.
pub(super) const SIGNALS: [Channel; 3] = [Channel::Voltage, Channel::Current, Channel::Speed];

#[track_caller]
pub(super) fn has(text: impl Display, words: &str) {
    let text = text.to_string();
    assert!(text.contains(words), "{words:?} is not in: {text}");
}

#[track_caller]
pub(super) fn near(value: f64, expected: f64, most: f64) {
    assert!((value - expected).abs() < most, "{value}, expected {expected} +- {most}");
}

#[track_caller]
pub(super) fn within(value: f64, range: impl RangeBounds<f64> + Debug) {
    assert!(range.contains(&value), "{value} is not in {range:?}");
}

/// The cases of a table, one in each line, and their cells.
pub(super) fn cases<const N: usize>(table: &str) -> impl Iterator<Item = [&str; N]> {
    table.lines().skip(1).map(|line| {
        let cells: Vec<&str> = line.split('|').map(|cell| cell.trim_matches(' ')).collect();
        cells.try_into().unwrap_or_else(|_| panic!("{line}"))
    })
}

impl Nameplate {
    pub(super) fn zk_22fc() -> Self {
        BenchFile::embedded_default().nameplate().unwrap()
    }
}

impl Limits {
    /// Those of the paper's motor at 100 Hz.
    pub(super) fn zk_22fc() -> Self {
        Self::for_motor(&Nameplate::zk_22fc(), 100.0)
    }
}

impl<'a> CheckOptions<'a> {
    /// Of a real drive, with the first move.
    pub(super) fn first_move(
        rate_hz: f64,
        nameplate: &'a Nameplate,
        profile: &'a DriveProfile,
    ) -> Self {
        Self {
            rate_hz,
            hardware_allowed: true,
            hardware_confirmed: true,
            waivers: Waivers::default(),
            first_move: Some(FirstMove { nameplate, profile, is_withheld: false }),
            stopped: &|| false,
            reset_fault: false,
        }
    }
}

pub(super) struct Wave<F: Fn(f64) -> Demand + Send> {
    pub(super) duration_s: f64,
    pub(super) demand: F,
}

impl<F: Fn(f64) -> Demand + Send> Pilot for Wave<F> {
    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn segment_at(&self, time_s: f64) -> usize {
        usize::from(time_s >= 0.5 * self.duration_s)
    }

    fn segment_name(&self, index: usize) -> &str {
        ["first half", "second half"][index]
    }

    fn zero(&self) -> Demand {
        match (self.demand)(0.0) {
            Demand::Current(_) => Demand::Current(0.0),
            Demand::Speed(_) => Demand::Speed(0.0),
            _ => Demand::Voltage(0.0),
        }
    }

    fn demand(&mut self, _now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        Ok((self.demand)(elapsed_s))
    }
}

pub(super) fn constant(duration_s: f64, demand: Demand) -> Box<dyn Pilot> {
    Box::new(Wave { duration_s, demand: move |_| demand })
}

/// The loop of a bench file on a model, with so many cycles of delay.
pub(super) fn speed_design<'a>(
    bench: &'a BenchFile,
    model: &'a Model,
    (motor, limits): (&'a Nameplate, &'a Limits),
    delay_cycles: f64,
) -> Design<'a> {
    let section = bench.speed.as_ref().unwrap();
    let period_s = bench.period_s();
    Design {
        model,
        fitted: &[],
        motor,
        limits,
        section,
        maps: &[],
        actuator: section.actuator.unwrap_or(Actuator::Voltage),
        timing: timing(model, period_s, delay_cycles * period_s),
        noise_rad_s: 0.15,
        peak_reference_rad_s: bench.reference(section).unwrap().peak_rad_s(),
    }
}

pub(super) fn speed_session(bench: &BenchFile, design: &Design<'_>, guard: Guard) -> Session {
    let settings = PilotSettings {
        slew_v_per_s: design.section.slew_v_per_s(design.motor, design.limits, bench.period_s()),
        silence_s: design.limits.link_silence_s,
        hold: 0.0,
    };
    let reference = bench.reference(design.section).unwrap();
    let pilot = SpeedPilot::new(design.regulator().unwrap(), reference, settings);
    Session::new(Box::new(pilot), guard)
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Fault {
    Timeout,
    Gone,
    Set(Channel, f64),
    Missing(Channel),
    TripWith(u16),
    LeavesRunning,
    NeverRuns,
    ClockStops,
    IgnoresStop,
    /// Every request, with this exception.
    Refuses(u8),
}

/// A drive with a first-order shaft and the current that goes with it: no physics, only states, stamps and faults.
#[derive(Default)]
pub(super) struct ScriptedDrive {
    pub(super) period_s: f64,
    pub(super) faults: VecDeque<(u64, u64, Fault)>,
    pub(super) demands: Vec<Demand>,
    pub(super) watchdog_s: Option<f64>,
    pub(super) stops: u32,
    pub(super) is_emulator: bool,
    pub(super) serial_number: &'static str,
    pub(super) confirms_stop: bool,
    pub(super) requests: Arc<Mutex<Vec<String>>>,
    pub(super) shortest_cycle_s: Option<f64>,
    pub(super) times: CommandTimes,
    /// Error of a stop outside a run; `None`: it is confirmed.
    pub(super) stop_fails: Option<fn(String) -> LinkError>,
    /// Last bound of the time of an exchange, s.
    pub(super) bound_s: f64,
    state: DriveState,
    time_s: f64,
    voltage_v: f64,
    speed_rad_s: f64,
    angle_rad: f64,
    statistics: LinkStatistics,
    /// The last request was not sent.
    is_unsent: bool,
}

impl ScriptedDrive {
    pub(super) fn new(period_s: f64) -> Self {
        Self {
            period_s,
            watchdog_s: Some(0.2),
            is_emulator: true,
            confirms_stop: true,
            ..Self::default()
        }
    }

    /// The fault holds for exchanges `from..to`.
    pub(super) fn with(mut self, from: u64, to: u64, fault: Fault) -> Self {
        self.faults.push_back((from, to, fault));
        self
    }

    /// Of the present exchange.
    fn faults_now(&self) -> Vec<Fault> {
        let now = self.statistics.sent;
        (self.faults.iter())
            .filter(|(from, to, _)| (*from..*to).contains(&now))
            .map(|(_, _, fault)| fault.clone())
            .collect()
    }

    fn note(&self, what: &str) {
        self.requests.lock().unwrap().push(what.to_owned());
    }
}

impl DriveLink for ScriptedDrive {
    fn name(&self) -> LinkName {
        LinkName("script:".to_owned())
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.note("identify");
        Ok(Identity {
            vendor: "drivebench".to_owned(),
            product: "script".to_owned(),
            serial_number: self.serial_number.to_owned(),
            is_emulator: self.is_emulator,
            watchdog_s: self.watchdog_s,
            ..Identity::default()
        })
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.note(&format!("{:?}", command.demand));
        self.demands.push(command.demand);
        let faults = self.faults_now();
        let has = |wanted| faults.contains(&wanted);
        self.statistics.sent += 1;
        self.is_unsent = has(Fault::Gone);
        if !has(Fault::ClockStops) {
            self.time_s += self.period_s;
        }
        if has(Fault::Timeout) {
            self.statistics.timeout += 1;
            return Err(timeout(self.name(), "test"));
        }
        if has(Fault::Gone) {
            self.statistics.aborted += 1;
            return Err(gone(self.name().0));
        }
        let refused = faults.iter().find_map(|fault| match fault {
            Fault::Refuses(code) => Some(*code),
            _ => None,
        });
        if let Some(code) = refused {
            self.statistics.exception += 1;
            return Err(refusal(self.name().0, code));
        }
        self.statistics.ok += 1;
        self.voltage_v = command.demand.voltage_v().unwrap_or(0.0);
        let follows_command = !has(Fault::NeverRuns) && !has(Fault::LeavesRunning);
        let ignores_stop = has(Fault::IgnoresStop) && self.state == DriveState::Running;
        self.state = if command.demand.energises() && follows_command || ignores_stop {
            DriveState::Running
        } else {
            DriveState::Disabled
        };
        let before_rad_s = self.speed_rad_s;
        self.speed_rad_s += 0.2 * (self.voltage_v / 0.3538 - self.speed_rad_s);
        self.angle_rad += 0.5 * (before_rad_s + self.speed_rad_s) * self.period_s;
        let current_a = 0.1 + (self.voltage_v - 0.3538 * self.speed_rad_s) / 1.1;
        let mut sample = Sample::at(self.time_s)
            .with(Channel::Current, current_a)
            .with(Channel::Speed, self.speed_rad_s)
            .with(Channel::Voltage, self.voltage_v)
            .with(Channel::Bus, 140.0)
            .with(Channel::Angle, self.angle_rad);
        sample.seq = Some(command.seq);
        sample.state = Some(self.state);
        sample.applied =
            Some(Applied { seq: command.seq, time_s: self.time_s - 0.3 * self.period_s });
        for fault in faults {
            match fault {
                Fault::Set(channel, value) => sample.set(channel, value),
                Fault::Missing(channel) => sample.set(channel, f64::NAN),
                Fault::TripWith(code) => {
                    (sample.state, sample.fault) = (Some(DriveState::Fault), Some(code));
                }
                _ => {}
            }
        }
        Ok(sample)
    }

    fn bound(&mut self, left_s: f64) {
        self.bound_s = left_s;
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.note("stop");
        self.stops += 1;
        self.is_unsent = false;
        if let Some(error) = self.stop_fails {
            let error = error(self.name().0);
            self.is_unsent = matches!(error, LinkError::Gone { .. });
            return Err(error);
        }
        self.state = DriveState::Disabled;
        self.voltage_v = 0.0;
        Ok(())
    }

    fn has_sent_command(&self) -> bool {
        !self.is_unsent
    }

    fn confirms_stop(&self) -> bool {
        self.confirms_stop
    }

    fn command_times(&self) -> CommandTimes {
        self.times
    }

    fn statistics(&self) -> LinkStatistics {
        self.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.shortest_cycle_s
    }
}

pub(super) fn gone(link: String) -> LinkError {
    LinkError::Gone(link, "unplugged".to_owned())
}

pub(super) fn refusal(link: String, code: u8) -> LinkError {
    LinkError::Exception {
        link,
        request: "the command".to_owned(),
        code,
        name: exception_name(code),
        requested: Requested::default(),
    }
}

pub(super) fn timeout(link: LinkName, request: &str) -> LinkError {
    LinkError::Timeout { link: link.0, deadline_ms: 5, request: request.to_owned() }
}

pub(super) trait Tamper<L: DriveLink>: Send {
    fn exchange(&mut self, link: &mut L, command: Command) -> Result<Sample, LinkError>;

    fn bound(&mut self, _left_s: f64) {}
}

pub(super) struct Tampered<L, T> {
    pub(super) link: L,
    pub(super) by: T,
}

impl<L: DriveLink, T: Tamper<L>> DriveLink for Tampered<L, T> {
    fn name(&self) -> LinkName {
        self.link.name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.link.identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.by.exchange(&mut self.link, command)
    }

    fn bound(&mut self, left_s: f64) {
        self.by.bound(left_s);
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.link.stop()
    }

    fn confirms_stop(&self) -> bool {
        self.link.confirms_stop()
    }

    fn command_times(&self) -> CommandTimes {
        self.link.command_times()
    }

    fn statistics(&self) -> LinkStatistics {
        self.link.statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.link.shortest_cycle_s()
    }
}

#[derive(Clone, Copy)]
pub(super) struct Stalls {
    /// Part of the cycles that are followed by one.
    pub(super) share: f64,
    pub(super) longest_s: f64,
}

impl Stalls {
    fn length_s(self, rng: &mut ChaCha8Rng) -> f64 {
        let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX);
        if uniform() < self.share { self.longest_s * uniform() } else { 0.0 }
    }

    /// A host with stalls, and a drive in memory that does not answer during stalls of its own.
    pub(super) fn at(self, config: &EmulatorConfig, seed: u64) -> (impl DriveLink, impl Clock) {
        let (link, clock) = in_memory(config, seed);
        let stalled = StalledDrive {
            clock: clock.clone(),
            stalls: self,
            rng: ChaCha8Rng::seed_from_u64(seed),
            until_s: 0.0,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 1_000_000);
        let late_s = move |_| self.length_s(&mut rng);
        (Tampered { link, by: stalled }, LateClock { clock, late_s })
    }
}

/// During a stall requests are lost and the output is held.
struct StalledDrive {
    clock: VirtualClock,
    stalls: Stalls,
    rng: ChaCha8Rng,
    until_s: f64,
}

impl Tamper<MemoryLink> for StalledDrive {
    fn exchange(&mut self, link: &mut MemoryLink, command: Command) -> Result<Sample, LinkError> {
        let now_s = self.clock.time_s();
        if now_s < self.until_s {
            return Err(timeout(link.name(), "a stalled drive"));
        }
        let sample = link.exchange(command);
        self.until_s = now_s + self.stalls.length_s(&mut self.rng);
        sample
    }
}

/// A clock of the host whose waits end late, by a function of the time, s.
pub(super) struct LateClock<F> {
    pub(super) clock: VirtualClock,
    pub(super) late_s: F,
}

impl<F: FnMut(f64) -> f64 + Send> Clock for LateClock<F> {
    fn now_s(&self) -> f64 {
        self.clock.time_s()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        let now_s = self.clock.time_s().max(until_s);
        self.clock.set_time_s(now_s + (self.late_s)(now_s));
    }

    fn is_real(&self) -> bool {
        false
    }
}

/// The emulator without tolerance, so that its motor is the nameplate's.
pub(super) fn exact(name: &str) -> EmulatorConfig {
    EmulatorConfig { tolerance: 0.0, ..EmulatorConfig::embedded(name).unwrap() }
}

/// A random motor: R and L/R over the whole range, the rest consistent with them.
pub(super) fn random_motor(seed: u64) -> EmulatorConfig {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut log = |from: f64, to: f64| from * (to / from).powf(rng.random::<f64>());
    let electrical_s = log(0.3e-3, 50e-3);
    // Rated power in the winding as a share; a current of which the drive's resolution of 10 mA is 2 % at most.
    let (resistance, rated_v, loss, rated_a) = loop {
        let (resistance, rated_v, loss) = (log(0.1, 20.0), log(12.0, 220.0), log(0.02, 0.3));
        let rated_a = loss * rated_v / resistance;
        if (0.5..60.0).contains(&rated_a) {
            break (resistance, rated_v, loss, rated_a);
        }
    };
    let rated_rad_s = log(60.0, 500.0);
    let back_emf = (1.0 - loss) * rated_v / rated_rad_s;
    let mechanical_s = log(8e-3, 0.5);
    let friction = log(0.01, 0.3);
    let mut config = exact("zk-22fc-plain");
    config.motor.resistance_ohm = resistance;
    config.motor.inductance_h = resistance * electrical_s;
    config.motor.back_emf_v_s_per_rad = back_emf;
    config.motor.inertia_kg_m2 = mechanical_s * back_emf * back_emf / resistance;
    config.motor.load_torque_n_m = friction * rated_a * back_emf;
    config.motor.rated_voltage_v = rated_v;
    config.motor.rated_current_a = rated_a;
    config.motor.rated_speed_rad_s = rated_rad_s;
    // The largest that the registers allow: the drive does not limit.
    config.limits.current_limit_a = 650.0;
    config.limits.bus_v = 2.0 * rated_v;
    config.limits.speed_limit_rad_s = 1300.0;
    config.noise.current_a = 0.005 * rated_a;
    config.noise.speed_rad_s = 0.0005 * rated_rad_s;
    config.quantisation.current_a = 0.0;
    config
}

pub(super) fn nameplate_of(truth: MotorTruth) -> Nameplate {
    Nameplate {
        name: truth.name,
        rated_voltage_v: truth.rated_voltage_v,
        rated_current_a: truth.rated_current_a,
        rated_speed_rad_s: truth.rated_speed_rad_s,
        resistance_ohm: truth.resistance_ohm,
        inductance_h: truth.inductance_h,
        back_emf_v_s_per_rad: truth.back_emf_v_s_per_rad,
        inertia_kg_m2: truth.inertia_kg_m2,
        load_torque_n_m: truth.load_torque_n_m,
    }
}

/// An emulated drive in memory with the clock of its line.
pub(super) fn in_memory(config: &EmulatorConfig, seed: u64) -> (MemoryLink, VirtualClock) {
    let clock = VirtualClock::new();
    let drive = SoftDrive::new(config, seed);
    let link = MemoryLink::new(drive, clock.clone(), Latency::default());
    (link, clock)
}

/// One run of a session to its end, by default without a user and in virtual time.
pub(super) struct TestRun<'a> {
    pub(super) rate_hz: f64,
    pub(super) layout: Layout,
    pub(super) motor: Option<Nameplate>,
    pub(super) estimator: Option<&'a mut RowEstimator>,
    /// Before it begins.
    pub(super) intents: Vec<Intent>,
    pub(super) interrupted: bool,
    pub(super) snapshots: SnapshotCell,
}

impl Default for TestRun<'_> {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            layout: layout(&[Channel::VoltageCmd], &SIGNALS),
            motor: None,
            estimator: None,
            intents: Vec::new(),
            interrupted: false,
            snapshots: SnapshotCell::default(),
        }
    }
}

impl TestRun<'_> {
    pub(super) fn at(rate_hz: f64) -> Self {
        Self { rate_hz, ..Self::default() }
    }

    pub(super) fn run(
        self,
        session: Session,
        link: &mut dyn DriveLink,
        clock: &mut dyn Clock,
    ) -> (RunSummary, MemoryRecorder) {
        let mut recorder = MemoryRecorder::new(self.layout);
        let (sender, intents) = channel();
        for intent in self.intents {
            sender.send(intent).unwrap();
        }
        let bench = Bench {
            link,
            clock,
            recorder: &mut recorder,
            estimator: self.estimator,
            intents: &intents,
            interrupted: &AtomicBool::new(self.interrupted),
            snapshots: &self.snapshots,
        };
        let options = RunOptions {
            name: "test".to_owned(),
            target: Target::Sim,
            rate_hz: self.rate_hz,
            motor: self.motor,
            auto_start: true,
        };
        let summary = run(session, bench, &options);
        (summary, recorder)
    }
}

/// A session on a link, fed cycle by cycle; `fault` may change a reply or lose it, by the number of the exchange.
pub(super) struct SessionRig<L, F> {
    pub(super) session: Session,
    pub(super) link: L,
    pub(super) now_s: f64,
    clock: VirtualClock,
    period_s: f64,
    fault: F,
    pub(super) sent: Vec<Command>,
    pub(super) log: Vec<Action>,
}

#[expect(clippy::unnecessary_wraps, reason = "as the others, which lose some")]
pub(super) fn no_fault(_: usize, sample: Sample) -> Option<Sample> {
    Some(sample)
}

impl<L: DriveLink, F: FnMut(usize, Sample) -> Option<Sample>> SessionRig<L, F> {
    /// In cycles of 10 ms; the clock is the link's.
    pub(super) fn new(session: Session, (link, clock): (L, VirtualClock), fault: F) -> Self {
        Self {
            session,
            link,
            now_s: 0.0,
            clock,
            period_s: 0.01,
            fault,
            sent: Vec::new(),
            log: Vec::new(),
        }
    }

    pub(super) fn every(self, period_s: f64) -> Self {
        Self { period_s, ..self }
    }

    pub(super) fn feed(&mut self, input: Input) {
        let mut actions = Vec::new();
        self.session.step(self.now_s, input, &mut actions);
        for action in actions {
            self.log.push(action.clone());
            if let Action::Send(command) = action {
                self.sent.push(command);
                let reply = match self.link.exchange(command) {
                    Ok(sample) => match (self.fault)(self.sent.len(), sample) {
                        Some(sample) => Input::Sample(Box::new(sample)),
                        None => Input::Lost(Lost::Transient("spoilt".to_owned())),
                    },
                    Err(error) => Input::Lost(Lost::from(&error)),
                };
                self.feed(reply);
            }
        }
    }

    pub(super) fn ask(&mut self, intent: Intent) {
        self.feed(Input::Intent(intent));
    }

    pub(super) fn cycles(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now_s += self.period_s;
            self.clock.set_time_s(self.now_s);
            self.feed(Input::Cycle);
        }
    }

    /// Starts after three cycles, and runs for so many.
    pub(super) fn started(mut self, cycles: u32) -> Self {
        self.cycles(3);
        self.ask(Intent::Start);
        self.cycles(cycles);
        self
    }

    pub(super) fn outcome(&self) -> Option<&Outcome> {
        self.log.iter().find_map(|action| match action {
            Action::Finished(outcome) => Some(outcome),
            _ => None,
        })
    }

    #[track_caller]
    pub(super) fn trip(&self) -> (TripKind, String) {
        match self.outcome() {
            Some(Outcome::Tripped(trip)) => (trip.kind, trip.reason.clone()),
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn volts(&self) -> Vec<f64> {
        let volts = |command: &Command| match command.demand {
            Demand::Voltage(volts) => volts,
            _ => f64::NAN,
        };
        self.sent.iter().map(volts).collect()
    }

    /// Commands with the output on among those from here on.
    pub(super) fn energised_from(&self, from: usize) -> usize {
        self.sent[from..].iter().filter(|command| command.demand.energises()).count()
    }

    /// Recorded values of a channel, with their times.
    pub(super) fn recorded(&self, channel: Channel) -> impl Iterator<Item = (f64, f64)> {
        self.log.iter().filter_map(move |action| match action {
            Action::Row(sample) => Some((sample.time_s, sample.get(channel)?)),
            _ => None,
        })
    }

    pub(super) fn largest(&self, channel: Channel) -> f64 {
        self.recorded(channel).map(|(_, value)| value.abs()).fold(0.0, f64::max)
    }
}
