//! A drive with a register map of its own as a link: what the profile says, carried out.
//!
//! ```text
//! Demand -> decide: enable | set-point | stop | reset -> Sequence (steps with deadlines) -> writes -> [ RegisterBus ]
//! Sample <- units, validity, state <- Readings <-------------------------------------------- reads <-'
//! ```
//!
//! Enabling is never repeated by itself: after a fault, a stop or a failed step somebody has to ask for zero first.

mod connect;
mod halt;
mod points;
mod readings;
mod sequence;
mod state;

use std::sync::Arc;

use self::points::Points;
use self::readings::Readings;
use self::sequence::{Next, Sequence};
use super::command_times::CommandTimes;
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use super::patience::Patience;
use super::register_bus::RegisterBus;
use super::register_map::{Quantity, RegisterMap, Step};
use super::tally::RoundTrips;
use super::transaction::{CutIn, LineCounts};
use crate::sample::{Applied, Command, Demand, DriveState, Sample};

/// Set-points that read back otherwise so often in a row are ignored by the drive.
const MISMATCHES: u32 = 3;
/// Bytes of a read request and of a reply beside its registers, RTU.
const READ_BYTES: usize = 8;
const REPLY_BYTES: usize = 5;

/// What the link is about.
#[derive(Clone, Debug, PartialEq)]
enum Mode {
    Off,
    Enabling(Sequence),
    On,
    /// Stopping, and then coasting where stopping failed.
    Stopping(Sequence),
    Resetting(Sequence),
}

/// What is wanted of one exchange.
enum Wanted<'a> {
    Rest,
    Reset,
    Run(Option<(&'a str, f64)>),
}

/// A drive behind a register map.
pub struct ProfiledLink<B> {
    map: Arc<RegisterMap>,
    bus: B,
    readings: Readings,
    points: Points,
    mode: Mode,
    /// Something ended the last run: zero has to be asked for before the next.
    latched: bool,
    field_lost: bool,
    was_reset: bool,
    /// When its enable command was carried out, s, until the drive has reported that it runs.
    unseen_since_s: Option<f64>,
    watchdog_s: Option<f64>,
    last_exchange_s: Option<f64>,
    /// When something went out that the drive's watchdog counts, s.
    kicked_s: f64,
    patience: Patience,
}

impl<B: RegisterBus> ProfiledLink<B> {
    pub fn new(map: Arc<RegisterMap>, bus: B) -> Self {
        Self {
            readings: Readings::new(Arc::clone(&map)),
            points: Points::new(Arc::clone(&map)),
            watchdog_s: map.watchdog.default_s.filter(|time| *time > 0.0),
            map,
            bus,
            mode: Mode::Off,
            latched: false,
            field_lost: false,
            was_reset: false,
            unseen_since_s: None,
            last_exchange_s: None,
            kicked_s: f64::NEG_INFINITY,
            patience: Patience::default(),
        }
    }

    /// The bus: a test looks at the far end through it.
    pub const fn bus(&self) -> &B {
        &self.bus
    }

    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus
    }

    pub fn map(&self) -> &RegisterMap {
        &self.map
    }

    /// Readings that were no value: invalid code, out of the valid range, not a number.
    pub const fn rejected(&self) -> u64 {
        self.readings.rejected
    }

    /// The last reading of a signal in the profile's unit.
    pub fn reading(&self, signal: &str) -> Option<f64> {
        self.readings.get(signal).and_then(|reading| reading.value)
    }

    /// One exchange that enables the drive and holds a set-point, named and in units of the profile: for those that the
    /// bench cannot command in SI, such as an output frequency. `None`: enable only.
    pub fn run_at(
        &mut self,
        reference: Option<(&str, f64)>,
        seq: u64,
    ) -> Result<Sample, LinkError> {
        if let Some((name, _)) = reference
            && self.map.set_point(name).is_none()
        {
            return Err(self.refused(format!("the profile has no setpoint {name:?}")));
        }
        self.cycle(&Wanted::Run(reference), seq)
    }

    /// A drive that is busy keeps what it was told last, and is asked again after a pause; a stop does not wait.
    fn cycle(&mut self, wanted: &Wanted<'_>, seq: u64) -> Result<Sample, LinkError> {
        if matches!(wanted, Wanted::Run(_)) {
            self.patience.check(self.bus.now_s())?;
        }
        let result = self.exchanges(wanted, seq);
        self.patience.note(self.bus.now_s(), &result);
        result
    }

    fn exchanges(&mut self, wanted: &Wanted<'_>, seq: u64) -> Result<Sample, LinkError> {
        let began_s = self.bus.now_s();
        let was_off = self.mode == Mode::Off;
        let period_s = self.last_exchange_s.map_or(0.0, |last_s| began_s - last_s);
        self.last_exchange_s = Some(began_s);
        self.points.limited = false;
        if matches!(wanted, Wanted::Run(_)) {
            self.lapse(began_s)?;
        }
        self.decide(wanted, began_s);
        self.advance()?;
        let mut applied_s = None;
        if self.mode == Mode::On {
            if let Wanted::Run(Some((name, value))) = wanted {
                self.points
                    .put(&mut self.bus, &self.readings, name, *value)?;
                applied_s = Some(self.bus.now_s());
            }
            self.points.refresh(&mut self.bus, period_s)?;
            if self.points.kicked_s > self.kicked_s {
                self.kicked_s = self.points.kicked_s;
            }
        }
        let reading_s = self.bus.now_s();
        self.readings.read_fast(&mut self.bus)?;
        let first = self.readings.fast().len() as f64;
        let read_s = self.bus.now_s();
        // Nothing that can wait may make a refresh late.
        let request_s = (read_s - reading_s) / first.max(1.0);
        let due_s = self.points.next_due_s().filter(|_| self.mode == Mode::On);
        if due_s.is_none_or(|due_s| due_s - read_s > 2.0 * request_s) {
            self.readings.read_slow(&mut self.bus)?;
        }
        if self.map.watchdog.kicked_by == super::KickedBy::Any {
            self.kicked_s = read_s;
        }
        self.advance()?;
        self.supervise()?;
        if let (true, Wanted::Run(_), Some(hindrance)) = (was_off, wanted, self.hindrance()) {
            return Err(self.refused(hindrance.sentence().to_owned()));
        }
        // Without a clock in the drive: the middle of the first request.
        let time_s = reading_s + 0.5 * request_s;
        let mut sample = self.sample(time_s, began_s);
        sample.seq = Some(seq);
        sample.applied = applied_s.map(|applied_s| Applied {
            seq,
            time_s: applied_s.min(time_s),
        });
        Ok(sample)
    }

    /// Silence that was longer than the drive's watchdog: an old set-point must not come back with the next write.
    fn lapse(&mut self, now_s: f64) -> Result<(), LinkError> {
        let silence_s = now_s - self.kicked_s;
        let Some(watchdog_s) = self.watchdog_s.filter(|limit_s| silence_s > *limit_s) else {
            return Ok(());
        };
        if self.mode != Mode::On {
            return Ok(());
        }
        self.latched = true;
        self.begin_stop(now_s);
        self.advance()?;
        Err(LinkError::Sequence {
            link: self.name().0,
            command: "run",
            step: 1,
            steps: 1,
            reason: format!(
                "nothing that the drive's watchdog of {watchdog_s} s counts went out for {silence_s:.3} s: the drive was told to stop before anything else"
            ),
        })
    }

    fn decide(&mut self, wanted: &Wanted<'_>, now_s: f64) {
        let is_reset = matches!(wanted, Wanted::Reset);
        let first_reset = is_reset && !std::mem::replace(&mut self.was_reset, is_reset);
        self.was_reset = is_reset;
        match (wanted, &self.mode) {
            (Wanted::Run(_), Mode::Off)
                if !self.latched
                    && self.state() != DriveState::Fault
                    && self.hindrance().is_none() =>
            {
                let enable = Sequence::new("enable", &self.map.commands.enable, now_s);
                self.mode = Mode::Enabling(enable.preceded(self.all_to_zero()));
            }
            (Wanted::Run(_), _) | (_, Mode::Stopping(_) | Mode::Resetting(_)) => {}
            (_, Mode::On | Mode::Enabling(_)) => self.begin_stop(now_s),
            (_, Mode::Off) => {
                self.latched = false;
                let runs = self.told("running") == Some(true);
                if runs {
                    self.begin_stop(now_s);
                } else if first_reset || (is_reset && self.state() == DriveState::Fault) {
                    self.field_lost = false;
                    self.mode =
                        Mode::Resetting(Sequence::new("reset", &self.map.commands.reset, now_s));
                }
            }
        }
    }

    /// Every reference at zero, before the enable command.
    fn all_to_zero(&self) -> Vec<Step> {
        let references = self
            .map
            .set_points
            .iter()
            .filter(|p| !p.is_word() && !p.nvm);
        references
            .map(|point| Step::Write {
                set_point: point.name.clone(),
                value: 0.0,
                mask: None,
            })
            .collect()
    }

    fn begin_stop(&mut self, now_s: f64) {
        self.points.release();
        self.mode = Mode::Stopping(Sequence::new("stop", &self.map.commands.stop, now_s));
    }

    /// Carries the command under way as far as it goes now.
    fn advance(&mut self) -> Result<(), LinkError> {
        loop {
            let now_s = self.bus.now_s();
            let faulty = self.told("fault") == Some(true);
            self.points.is_urgent = matches!(self.mode, Mode::Stopping(_));
            let readings = &self.readings;
            let status = |name: &str| {
                let reading = readings.get(name)?;
                Some((reading.pattern?, reading.read_s))
            };
            let (Mode::Enabling(sequence) | Mode::Stopping(sequence) | Mode::Resetting(sequence)) =
                &mut self.mode
            else {
                return Ok(());
            };
            match sequence.next(now_s, status) {
                Next::Wait => {
                    // A drive in fault has its output off, whatever its stop command waits for.
                    if faulty && matches!(self.mode, Mode::Stopping(_)) {
                        self.mode = Mode::Off;
                    }
                    return Ok(());
                }
                Next::Write {
                    set_point,
                    value,
                    mask,
                } => {
                    self.points
                        .write(&mut self.bus, &self.readings, &set_point, value, mask)?;
                    let now_s = self.bus.now_s();
                    self.kicked_s = now_s;
                    sequence.written(now_s);
                }
                Next::Done => {
                    self.mode = match &self.mode {
                        Mode::Enabling(_) => {
                            self.unseen_since_s = Some(now_s);
                            Mode::On
                        }
                        _ => Mode::Off,
                    };
                    return Ok(());
                }
                Next::Failed { step, reason } => {
                    let (command, steps) = (sequence.command, sequence.steps());
                    let error = LinkError::Sequence {
                        link: self.bus.name().0,
                        command,
                        step,
                        steps,
                        reason: reason + &self.in_fault_text(now_s),
                    };
                    self.latched = true;
                    self.mode = match &self.mode {
                        Mode::Enabling(_) => {
                            self.points.release();
                            Mode::Stopping(Sequence::new("stop", &self.map.commands.stop, now_s))
                        }
                        Mode::Stopping(sequence) if sequence.command == "stop" => {
                            Mode::Stopping(Sequence::new("coast", &self.map.commands.coast, now_s))
                        }
                        _ => Mode::Off,
                    };
                    // The way down is begun at once; what it reports matters less than why.
                    let _ = self.advance();
                    return Err(error);
                }
            }
        }
    }

    /// What ends a run from the drive's side.
    fn supervise(&mut self) -> Result<(), LinkError> {
        let now_s = self.bus.now_s();
        if let (Some(least_a), Some(field)) = (
            self.map.field_min_a,
            self.map.of_quantity(Quantity::FieldCurrent),
        ) {
            let weak = self
                .reading(&field.name)
                .is_none_or(|amperes| amperes < least_a);
            if weak && self.mode == Mode::On {
                self.field_lost = true;
                self.latched = true;
                self.begin_stop(now_s);
                return self.advance();
            }
        }
        // Somebody else has it: no set-point goes out any more, and what it was told last is taken back.
        if self.hindrance().is_some() && matches!(self.mode, Mode::On | Mode::Enabling(_)) {
            self.latched = true;
            self.begin_stop(now_s);
            // The sample says why; how the stop goes matters less.
            let _ = self.advance();
            return Ok(());
        }
        if self.mode == Mode::On {
            if self.points.mismatches() >= MISMATCHES {
                let reason = self.points.mismatch_text();
                self.latched = true;
                self.begin_stop(now_s);
                // As above: the reason counts.
                let _ = self.advance();
                return Err(LinkError::Sequence {
                    link: self.name().0,
                    command: "run",
                    step: 1,
                    steps: 1,
                    reason,
                });
            }
            let runs = self.runs_since_enabled();
            if runs == Some(true) {
                self.unseen_since_s = None;
            }
            // Perhaps it runs and the profile looks for it at the wrong place: it gets its stop command.
            if self.unseen_since_s.is_some()
                && self.state() != DriveState::Fault
                && runs == Some(false)
            {
                let error = self.never_ran();
                self.latched = true;
                self.begin_stop(now_s);
                // As above: the reason counts.
                let _ = self.advance();
                return Err(error);
            }
            // It stopped by itself: a fault, its watchdog, somebody at its keypad.
            if self.state() == DriveState::Fault || runs == Some(false) {
                self.latched = true;
                self.points.release();
                self.mode = Mode::Off;
                self.points.zero(&mut self.bus, &self.readings)?;
                // The code of a fault is often polled slowly, and is wanted now.
                self.readings.read_now(&mut self.bus, Quantity::FaultCode)?;
            }
        }
        Ok(())
    }

    fn refused(&self, reason: String) -> LinkError {
        LinkError::Refused {
            link: self.bus.name().0,
            reason,
        }
    }
}

impl<B: RegisterBus> DriveLink for ProfiledLink<B> {
    fn name(&self) -> LinkName {
        self.bus.name()
    }

    /// Reads first; only a drive that is what the profile says, and does not run, gets its watchdog written.
    fn identify(&mut self) -> Result<Identity, LinkError> {
        let mut identity = self.recognise()?;
        let time_s = self.supervision()?;
        self.watchdog_s = time_s.filter(|time_s| *time_s > 0.0);
        identity.watchdog_s = self.watchdog_s;
        Ok(identity)
    }

    fn recognise(&mut self) -> Result<Identity, LinkError> {
        self.readings.read_all(&mut self.bus)?;
        self.check_identity()?;
        let (mut vendor, mut product, mut firmware) =
            (String::new(), self.map.device.name.clone(), String::new());
        if self.map.functions.contains(&43) {
            vendor = self.bus.object(0)?.unwrap_or_default();
            product = self.bus.object(1)?.unwrap_or(product);
            firmware = self.bus.object(2)?.unwrap_or_default();
        }
        let limit = |quantity| {
            let signal = self.map.of_quantity(quantity)?;
            self.reading(&signal.name)
        };
        Ok(Identity {
            vendor,
            product,
            serial_number: String::new(),
            firmware,
            protocol_version: 0,
            is_emulator: self.bus.is_emulated(),
            watchdog_s: self.watchdog_s,
            current_limit_a: limit(Quantity::CurrentLimit),
            voltage_limit_v: limit(Quantity::VoltageLimit),
        })
    }

    fn found(&self) -> Option<Sample> {
        let now_s = self.bus.now_s();
        Some(self.sample(now_s, now_s))
    }

    fn compare_set_points(&mut self) -> Result<Option<Result<String, String>>, LinkError> {
        self.points.compare(&mut self.bus, &self.readings)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        let (quantity, value) = match command.demand {
            Demand::Disable | Demand::Stop => return self.cycle(&Wanted::Rest, command.seq),
            Demand::ResetFault => return self.cycle(&Wanted::Reset, command.seq),
            Demand::Voltage(volts) => (Quantity::Voltage, volts),
            Demand::Current(amperes) => (Quantity::Current, amperes),
            Demand::Speed(speed) => (Quantity::Speed, speed),
        };
        let map = Arc::clone(&self.map);
        let Some((point, si)) = map.demand(quantity).and_then(|p| Some((p, p.si?))) else {
            let what = match quantity {
                Quantity::Voltage => "voltage",
                Quantity::Current => "current",
                _ => "speed",
            };
            return Err(self.refused(format!(
                "{} takes no {what} command that its profile could give in SI",
                self.map.device.name
            )));
        };
        if !value.is_finite() {
            return Err(self.refused(format!("the set-point {value} is not a number")));
        }
        self.cycle(&Wanted::Run(Some((&point.name, value / si))), command.seq)
    }

    /// Stops, and looks whether the drive says so; where it does not, coasts.
    fn stop(&mut self) -> Result<(), LinkError> {
        self.bus.bound(f64::INFINITY);
        self.points.release();
        self.mode = Mode::Off;
        self.latched = false;
        let mut last = None;
        for command in ["stop", "stop", "coast"] {
            if command == "coast" && self.map.commands.coast.is_empty() {
                continue;
            }
            let result = self.carry_out(command).and_then(|()| self.rests());
            match result {
                Ok(true) => return Ok(()),
                Ok(false) => {}
                Err(error @ LinkError::Gone { .. }) => return Err(error),
                Err(error) => last = Some(error),
            }
        }
        Err(last.unwrap_or_else(|| LinkError::Sequence {
            link: self.name().0,
            command: "stop",
            step: 1,
            steps: 1,
            reason: "the drive still reports that it runs".to_owned(),
        }))
    }

    /// A reference that somebody left in the drive must not come back with the next command (auto-resume).
    fn bring_to_rest(&mut self) -> Result<(), LinkError> {
        self.points.is_urgent = true;
        let zeroed = self.points.zero(&mut self.bus, &self.readings);
        if !matches!(zeroed, Err(LinkError::Gone { .. })) {
            // A drive that takes no reference now may well take a stop.
            self.stop()?;
        }
        zeroed
    }

    fn confirms_stop(&self) -> bool {
        self.map.state("running").is_some()
    }

    fn command_times(&self) -> CommandTimes {
        CommandTimes::of(&self.map.commands)
    }

    fn close(&mut self) {
        self.bus.close();
    }

    fn statistics(&self) -> LinkStatistics {
        self.bus.statistics()
    }

    fn line(&self) -> Option<LineCounts> {
        self.bus.line()
    }

    fn bound(&mut self, left_s: f64) {
        self.bus.bound(left_s);
    }

    fn cut_in(&mut self) -> Option<&mut CutIn> {
        self.bus.cut_in()
    }

    /// Fast signals and one set-point.
    fn shortest_cycle_s(&self) -> Option<f64> {
        let mut cycle_s = self.bus.wire_s(READ_BYTES, READ_BYTES)?;
        for block in self.readings.fast() {
            let reply = REPLY_BYTES + 2 * usize::from(block.count);
            cycle_s += self.bus.wire_s(READ_BYTES, reply)?;
        }
        Some(cycle_s)
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        self.bus.round_trips()
    }

    fn zero(&self) -> Demand {
        let able = |quantity| self.map.demand(quantity).is_some();
        if able(Quantity::Speed) && !able(Quantity::Voltage) {
            Demand::Speed(0.0)
        } else if able(Quantity::Current) && !able(Quantity::Voltage) {
            Demand::Current(0.0)
        } else {
            Demand::Voltage(0.0)
        }
    }
}
