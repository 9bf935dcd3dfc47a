//! Link to a drive with a register map of its own: executes the commands of its profile.
//!
//! ```text
//! Demand -> decide: enable | set-point | stop | reset -> Sequence (steps with deadlines) -> writes -> [ CellBus ]
//! Sample <- units, validity, state <- Readings <-------------------------------------------- reads <-'
//! ```
//!
//! Enabling is never repeated automatically: after a fault, a stop or a failed step zero must be commanded first.

/// Bus and readings as a `FarEnd`, borrowed separately from the set-points.
macro_rules! far_end {
    ($link:ident) => {
        crate::profiled::points::FarEnd { bus: &mut $link.bus, readings: &$link.readings }
    };
}

mod points;
mod readings;
mod sequence;
mod state;

use std::sync::Arc;

use self::points::{PATIENCE_S, Points, is_accepted};
use self::readings::{Clock, Joined, Readings};
use self::sequence::{Next, Sequence};
use super::budget::cycle_frames;
use super::cell_bus::{CellBus, Put, Span};
use super::command_times::CommandTimes;
use super::exceptions::BusyPauses;
use super::link::{
    DriveLink, Identity, LinkError, LinkName, LinkStatistics, Result, RoundTrips, StatedMotor,
};
use super::polling_backoff::PollingBackoff;
use super::register_map::{IdentityCheck, Quantity, RegisterMap, Step, Write};
use super::settings::KickedBy;
use super::transaction::{LineCounts, StopRequest};
use drivebench_model::sample::{Applied, Command, Demand, DriveState, Sample};

#[derive(Clone, Debug, PartialEq)]
enum Mode {
    Off,
    Enabling(Sequence),
    On,
    /// Stopping, and then coasting where stopping failed.
    Stopping(Sequence),
    Resetting(Sequence),
}

enum Wanted<'a> {
    Rest,
    Reset,
    Run(Option<(&'a str, f64)>),
}

/// A drive behind a register map.
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent facts, each set and cleared by its own event"
)]
pub struct ProfiledLink<B> {
    map: Arc<RegisterMap>,
    bus: B,
    readings: Readings,
    points: Points,
    mode: Mode,
    /// The last run was ended: zero must be commanded before the next.
    latched: bool,
    field_lost: bool,
    was_reset: bool,
    /// When its enable command was carried out, s, until the drive has reported that it runs.
    unseen_since_s: Option<f64>,
    watchdog_s: Option<f64>,
    last_exchange_s: Option<f64>,
    /// Time of the last write that restarts the drive's watchdog, s.
    kicked_s: f64,
    /// The set-point of the last command was not sent.
    is_unsent: bool,
    polling_backoff: PollingBackoff,
    /// The drive's own clock, if the profile maps it.
    clock: Option<Clock>,
    /// Time since which the fault condition has held, s.
    in_fault_since_s: Option<f64>,
}

impl<B: CellBus> ProfiledLink<B> {
    pub fn new(map: Arc<RegisterMap>, bus: B) -> Self {
        Self {
            readings: Readings::new(Arc::clone(&map)),
            points: Points::new(Arc::clone(&map)),
            watchdog_s: map.watchdog.default_s().filter(|time| *time > 0.0),
            clock: Clock::of(&map),
            in_fault_since_s: None,
            map,
            bus,
            mode: Mode::Off,
            latched: false,
            field_lost: false,
            was_reset: false,
            unseen_since_s: None,
            last_exchange_s: None,
            kicked_s: f64::NEG_INFINITY,
            is_unsent: false,
            polling_backoff: PollingBackoff::default(),
        }
    }

    /// The bus, for tests that examine the drive.
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
    pub fn run_at(&mut self, reference: Option<(&str, f64)>, seq: u64) -> Result<Sample> {
        if let Some((name, _)) = reference
            && self.map.set_point(name).is_none()
        {
            return Err(self.refused(format!("the profile has no setpoint {name:?}")));
        }
        self.cycle(&Wanted::Run(reference), seq)
    }

    /// A drive that is busy keeps its last command, and is polled again after a pause; a stop does not wait.
    fn cycle(&mut self, wanted: &Wanted<'_>, seq: u64) -> Result<Sample> {
        // A drive that does not run yet, or any more, holds zero and nothing else.
        self.is_unsent = matches!(wanted, Wanted::Run(Some((_, value))) if self.mode == Mode::On || *value != 0.0);
        if matches!(wanted, Wanted::Run(_)) {
            self.polling_backoff.check(self.bus.now_s())?;
        }
        self.points.has_written = false;
        let result = self.exchanges(wanted, seq);
        if !matches!(wanted, Wanted::Run(_)) {
            // A drive at rest already gets no further write.
            self.is_unsent = !was_sent(&result) && !self.points.has_written;
        }
        self.polling_backoff.note(self.bus.now_s(), &result);
        result
    }

    fn exchanges(&mut self, wanted: &Wanted<'_>, seq: u64) -> Result<Sample> {
        let began_s = self.bus.now_s();
        let was_off = self.mode == Mode::Off;
        let period_s = self.last_exchange_s.map_or(0.0, |last_s| began_s - last_s);
        self.last_exchange_s = Some(began_s);
        self.points.begin();
        let mut lapsed = None;
        if matches!(wanted, Wanted::Run(_)) {
            self.lapse(began_s)?;
        } else if self.has_lapsed(began_s).is_some() {
            // A drive that resumes with the next command shows that its watchdog has expired only before that.
            self.readings.read_fast(&mut self.bus, None)?;
            lapsed = self.is_in_fault().then(|| self.sample(began_s, began_s));
        }
        self.decide(wanted, began_s);
        // After a refused write the state is read all the same: a fault or the keypad may be the reason.
        let mut refused = None;
        held_back(&mut refused, self.advance())?;
        let mut put_s = None;
        if self.mode == Mode::On {
            if let Some(reason) = self.points.watch(&mut self.bus)? {
                return Err(self.ended(reason));
            }
            self.points.carried = None;
            self.points.may_join(self.readings.joinable().is_some());
            if let Wanted::Run(Some((name, value))) = wanted {
                let points = &mut self.points;
                let put = points.put(&mut far_end!(self), name, *value);
                // A write that was acknowledged acts, whatever becomes of its read-back.
                self.is_unsent = !was_sent(&put) && !points.has_written;
                let is_taken =
                    put.is_ok() && points.mismatches() == 0 && points.acting(0.0).is_none();
                put_s = is_taken.then(|| (self.bus.now_s(), points.carried));
                held_back(&mut refused, put)?;
            }
            held_back(&mut refused, self.points.refresh(&mut self.bus, period_s))?;
            if self.points.kicked_s > self.kicked_s {
                self.kicked_s = self.points.kicked_s;
            }
        }
        let reading_s = self.bus.now_s();
        let joined = self.points.take_joined();
        self.is_unsent |= joined.is_some();
        let (span, both) = match self.readings.read_fast(&mut self.bus, joined.as_ref()) {
            Err(error @ LinkError::Exception { .. }) if joined.is_some() => {
                (self.is_unsent, put_s) = (false, None);
                let written = Err(error);
                match joined.as_ref().filter(|_| is_accepted(&written)) {
                    Some(Joined { at, cells }) => {
                        self.points.accepted(&mut self.bus, *at, cells)?;
                    }
                    None => held_back(&mut refused, written)?,
                }
                self.readings.read_fast(&mut self.bus, None)?
            }
            read => {
                if joined.is_some() && was_sent(&read) {
                    self.is_unsent = false;
                }
                read?
            }
        };
        if let (Some(joined), Some(span)) = (joined, both) {
            let now_s = self.bus.now_s();
            self.points.joined_carried(joined, span, now_s);
            self.kicked_s = now_s;
            put_s = put_s.map(|(asked_s, _)| (asked_s, Some(span)));
        }
        let first = self.readings.fast().len() as f64;
        let read_s = self.bus.now_s();
        // Nothing that can wait may make a refresh late.
        let request_s = (read_s - reading_s) / first.max(1.0);
        let due_s = self.points.next_due_s().filter(|_| self.mode == Mode::On);
        if due_s.is_none_or(|due_s| due_s - read_s > 2.0 * request_s) {
            // Reads for which the exchange has no time left follow later.
            let read = self.readings.read_slow(&mut self.bus);
            if !matches!(read, Err(LinkError::Unproven { .. })) {
                read?;
            }
        }
        if self.map.watchdog.keys.kicked_by == KickedBy::Any {
            self.kicked_s = read_s;
        }
        held_back(&mut refused, self.advance())?;
        self.supervise()?;
        let has_cause = self.state() == DriveState::Fault || self.hindrance().is_some();
        if let Some(error) = refused.filter(|_| !has_cause) {
            return Err(error);
        }
        if let (true, Wanted::Run(_), Some(hindrance)) = (was_off, wanted, self.hindrance()) {
            return Err(self.refused(hindrance.sentence().to_owned()));
        }
        let (time_s, half_width_s) = self.stamp(span);
        let mut sample = self.sample(time_s, began_s);
        if let Some(before) = lapsed {
            (sample.state, sample.fault, sample.fault_text) =
                (before.state, before.fault, before.fault_text);
        }
        sample.time_half_width_s = half_width_s;
        sample.seq = Some(seq);
        sample.applied = put_s.map(|(asked_s, carried)| {
            // What was not written again is what the drive has had since before.
            let applied_s = self.on_time_axis(carried.map_or(asked_s, Span::middle_s));
            Applied { seq, time_s: applied_s.min(time_s) }
        });
        Ok(sample)
    }

    /// When the fast signals were sampled, on the time axis of the samples: by the drive's own clock, else between the first
    /// request out and the last reply in. Several blocks are of several instants, all of which the half-width covers.
    fn stamp(&mut self, span: Option<Span>) -> (f64, Option<f64>) {
        let now_s = self.bus.now_s();
        let span = span.unwrap_or(Span::new(now_s, now_s));
        let Some(clock) = &mut self.clock else {
            return (span.middle_s(), Some(span.half_width_s()));
        };
        let time_s = clock.follow(&self.readings);
        let others = if self.readings.fast().len() > 1 { 2.0 } else { 0.0 };
        let others_s = others * span.half_width_s();
        (time_s, Some(clock.half_width_s() + others_s))
    }

    /// A host time on the time axis of the samples, s.
    fn on_time_axis(&self, host_s: f64) -> f64 {
        let clock = self.clock.as_ref();
        clock.map_or(host_s, |clock| clock.of_host_s(host_s))
    }

    /// Ends a run: sends the stop, and zero must be commanded before the next run.
    fn give_up(&mut self) -> Result<()> {
        self.latched = true;
        self.begin_stop();
        self.advance()
    }

    /// The same, reporting the reason rather than the result of the stop.
    fn ended(&mut self, reason: String) -> LinkError {
        let _ = self.give_up();
        self.broken_off("run", (1, 1), reason)
    }

    /// A command that its drive did not follow: at which step of how many, and why.
    fn broken_off(
        &self,
        command: &'static str,
        (step, steps): (usize, usize),
        reason: String,
    ) -> LinkError {
        let link = self.bus.name().0;
        LinkError::Sequence { link, command, step, steps, reason }
    }

    /// The time of the drive's watchdog, s, where a drive that runs has got nothing that it counts for longer.
    fn has_lapsed(&self, now_s: f64) -> Option<f64> {
        let silence_s = now_s - self.kicked_s;
        self.watchdog_s.filter(|limit_s| silence_s > *limit_s && self.mode == Mode::On)
    }

    /// Silence longer than the drive's watchdog: an old set-point must not act again with the next write.
    fn lapse(&mut self, now_s: f64) -> Result<()> {
        let Some(watchdog_s) = self.has_lapsed(now_s) else { return Ok(()) };
        let silence_s = now_s - self.kicked_s;
        // A drive that its watchdog has stopped may refuse the words of a stop.
        gone(self.give_up())?;
        let reason = format!(
            "for {silence_s:.3} s the link sent nothing that restarts the drive's watchdog of {watchdog_s} s, so it sent a stop before any other command"
        );
        Err(self.broken_off("run", (1, 1), reason))
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
            (_, Mode::On | Mode::Enabling(_)) => self.begin_stop(),
            (_, Mode::Off) => {
                self.latched = false;
                let runs = self.reported("running") == Some(true);
                if runs {
                    self.begin_stop();
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
        let references = self.map.set_points.iter().filter(|p| p.is_reference());
        references
            .map(|point| {
                Step::Write(Write { set_point: point.name.clone(), value: 0.0, mask: None })
            })
            .collect()
    }

    fn begin_stop(&mut self) {
        self.points.release();
        self.mode = self.stopping("stop");
    }

    /// The command that is to stop the drive, from its beginning.
    fn stopping(&self, command: &'static str) -> Mode {
        Mode::Stopping(Sequence::new(command, self.way_down(command), self.bus.now_s()))
    }

    fn way_down(&self, command: &str) -> &[Step] {
        match command {
            "coast" => &self.map.commands.coast,
            _ => &self.map.commands.stop,
        }
    }

    /// Carries the command under way as far as it goes now.
    fn advance(&mut self) -> Result<()> {
        self.points.is_urgent = matches!(self.mode, Mode::Stopping(_));
        let Some((next, sequence, unacknowledged)) = self.go_on()? else { return Ok(()) };
        match next {
            // Writes without acknowledgement are repeated before the stop is over.
            Next::Done if sequence.is_unacknowledged() => {}
            Next::Done => {
                self.mode = match &self.mode {
                    Mode::Enabling(_) => {
                        self.unseen_since_s = Some(self.bus.now_s());
                        Mode::On
                    }
                    // Only the refused writes show that it did not stop.
                    Mode::Stopping(_)
                        if sequence.is_denied && !self.confirms_stop() && !self.is_in_fault() =>
                    {
                        self.stopping("stop")
                    }
                    _ => Mode::Off,
                };
            }
            Next::Failed { step, reason } => return Err(self.failed(&sequence, step, reason)),
            Next::Wait | Next::Write(_) => {}
        }
        unacknowledged.map_or(Ok(()), Err)
    }

    /// The same without its end: what is next, where the command is, and the first write of a stop that was not acknowledged.
    fn go_on(&mut self) -> Result<Option<(Next, Sequence, Option<LinkError>)>> {
        let mode = self.mode.clone();
        let (Mode::Enabling(mut sequence)
        | Mode::Stopping(mut sequence)
        | Mode::Resetting(mut sequence)) = mode
        else {
            return Ok(None);
        };
        if self.points.is_urgent {
            let descended = self.descend(&mut sequence);
            self.mode = Mode::Stopping(sequence.clone());
            let (next, unacknowledged) = descended?;
            return Ok(Some((next, sequence, unacknowledged)));
        }
        loop {
            let readings = &self.readings;
            let next = sequence.next(self.bus.now_s(), |name| readings.status(name));
            let written = match &next {
                Next::Write(write) => self.points.carry(&mut far_end!(self), write),
                _ => Ok(()),
            };
            let now_s = self.bus.now_s();
            let mut given_up = None;
            match &written {
                Ok(()) if matches!(next, Next::Write(_)) => {
                    self.kicked_s = now_s;
                    match self.points.acting(now_s) {
                        None => sequence.go_on(now_s),
                        Some((acting_s, text)) if acting_s > PATIENCE_S => given_up = Some(text),
                        Some(_) => return Ok(Some((Next::Wait, sequence, None))),
                    }
                }
                Err(error @ LinkError::Exception { .. }) => {
                    let since_s = sequence.refused(now_s, error.to_string());
                    // A drive that refuses a step of its enable command for so long, because it is busy, will not take it.
                    given_up = (since_s > PATIENCE_S).then(|| error.to_string());
                }
                _ => {}
            }
            match &mut self.mode {
                Mode::Enabling(at) | Mode::Resetting(at) => *at = sequence.clone(),
                _ => {}
            }
            if let Some(reason) = given_up {
                let step = sequence.step();
                return Err(self.failed(&sequence, step, reason));
            }
            written?;
            if !matches!(next, Next::Write(_)) {
                return Ok(Some((next, sequence, None)));
            }
        }
    }

    /// A command that its drive does not follow: the way down is begun at once.
    fn failed(&mut self, sequence: &Sequence, step: usize, reason: String) -> LinkError {
        // A fault explains it, and its code is in the report.
        if self.reported("fault") == Some(true) {
            let _ = self.readings.read_now(&mut self.bus, Quantity::FaultCode);
        }
        let reason = reason + &self.in_fault_text(self.bus.now_s());
        let error = self.broken_off(sequence.command, (step, sequence.steps()), reason);
        self.latched = true;
        let can_coast = !self.map.commands.coast.is_empty();
        match &self.mode {
            Mode::Enabling(_) => self.begin_stop(),
            Mode::Stopping(stop) if stop.command == "stop" && can_coast => {
                self.mode = self.stopping("coast");
            }
            // What has not stopped gets its stop command until it has.
            Mode::Stopping(_) if self.reported("running") != Some(false) => self.begin_stop(),
            _ => self.mode = Mode::Off,
        }
        // The reason is reported, not the result of the stop.
        let _ = self.advance();
        error
    }

    /// End of a run by the drive. The sample reports the first cause, not a consequence such as refused writes of a drive in fault.
    fn supervise(&mut self) -> Result<()> {
        let now_s = self.bus.now_s();
        let in_fault = self.is_in_fault();
        let since_s = in_fault.then(|| self.in_fault_since_s.unwrap_or(now_s));
        if in_fault && std::mem::replace(&mut self.in_fault_since_s, since_s).is_none() {
            // The code of a fault is often polled slowly, and is wanted now. A lost one comes with the slow signals.
            gone(self.readings.read_now(&mut self.bus, Quantity::FaultCode))?;
        }
        self.in_fault_since_s = since_s;
        if let (Some(least_a), Some(field)) =
            (self.map.field_min_a, self.map.of_quantity(Quantity::FieldCurrent))
        {
            let weak = self.reading(&field.name).is_none_or(|amperes| amperes < least_a);
            if weak && self.mode == Mode::On {
                self.field_lost = true;
                return gone(self.give_up());
            }
        }
        // Another master has control: no more set-points, and the last command is withdrawn.
        if self.hindrance().is_some() && matches!(self.mode, Mode::On | Mode::Enabling(_)) {
            return gone(self.give_up());
        }
        if self.mode != Mode::On {
            return Ok(());
        }
        // Set-points that read back otherwise so often in a row are ignored by the drive.
        if self.points.mismatches() >= 3 {
            let reason = self.points.mismatch_text();
            return Err(self.ended(reason));
        }
        let enabled_s = self.unseen_since_s.unwrap_or(f64::NEG_INFINITY);
        let runs = self.state_since("running", enabled_s);
        if runs == Some(true) {
            self.unseen_since_s = None;
        }
        let in_fault = self.state() == DriveState::Fault;
        // It may run although the profile's status does not show it: send the stop.
        if self.unseen_since_s.is_some() && !in_fault && runs == Some(false) {
            let error = self.never_ran();
            let _ = self.give_up();
            return Err(error);
        }
        // It stopped by a fault, its watchdog or its keypad. Reference and run command must be cleared before it can run again.
        if in_fault || runs == Some(false) {
            self.latched = true;
            self.points.release();
            self.points.is_urgent = true;
            gone(self.points.zero(&mut far_end!(self)))?;
            return gone(self.give_up());
        }
        Ok(())
    }

    /// Stops and checks the status; coasts if the drive does not confirm.
    fn stop_or_coast(&mut self) -> Result<()> {
        self.bus.bound(f64::INFINITY);
        // If this fails, the next exchange continues with the stop, whatever its command.
        self.latched = true;
        self.begin_stop();
        let (mut first, mut runs) = (None, false);
        for command in ["stop", "stop", "coast"] {
            if command == "coast" && self.map.commands.coast.is_empty() {
                continue;
            }
            let carried = self.carry_out(command);
            // A drive that reports that it does not run may have refused a word of the stop, as one in fault does.
            let refused = matches!(carried, Err(LinkError::Exception { .. }));
            let result = match carried {
                Err(error) if !(refused && self.confirms_stop()) => Err(error),
                carried => self.rests().map(|rests| (rests, carried.err())),
            };
            match result {
                Ok((true, _)) => {
                    self.mode = Mode::Off;
                    self.latched = false;
                    return Ok(());
                }
                Ok((false, error)) => {
                    runs = true;
                    first = first.or(error);
                }
                Err(error @ LinkError::Gone { .. }) => return Err(error),
                Err(error) => first = first.or(Some(error)),
            }
        }
        match first {
            Some(error) if !runs => Err(error),
            first => {
                let before =
                    first.map(|error| format!("; before that {error}")).unwrap_or_default();
                let reason = format!("the drive still reports that it runs{before}");
                Err(self.broken_off("stop", (1, 1), reason))
            }
        }
    }

    fn check_identity(&mut self) -> Result<()> {
        for check in self.map.identity.clone() {
            let wrong = match check {
                IdentityCheck::Object { object, contains } => {
                    let found = self.bus.object(object)?;
                    let fits = found.as_ref().is_some_and(|text| text.contains(&contains));
                    (!fits).then(|| {
                        format!("identification object {object} is {found:?} (expected {contains:?} in it)")
                    })
                }
                IdentityCheck::Signal { signal, mask, test } => {
                    let reading = self.readings.get(&signal).unwrap_or_default();
                    let fits = test.passes(reading.pattern, mask, reading.value);
                    (!fits)
                        .then(|| format!("{signal} is {:?} (expected {test:?})", reading.pattern))
                }
            };
            if let Some(reason) = wrong {
                let message = format!("this is not {}: {reason}", self.map.device.name);
                return Err(LinkError::Identity(self.name().0, message));
            }
        }
        Ok(())
    }

    /// Writes the time of the watchdog as in the profile and reads it back. A drive that runs under another master is not written: its
    /// watchdog would stop it after this host has disconnected.
    fn supervision(&mut self) -> Result<Option<f64>> {
        let runs = self.state() == DriveState::Running;
        let watchdog = &self.map.watchdog;
        let set_s = watchdog.set_s().filter(|_| !runs);
        let Some((location, unit_s)) = watchdog.time else { return Ok(watchdog.default_s()) };
        if let Some(set_s) = set_s {
            let cells = location.layout.encode(set_s / unit_s).ok_or_else(|| {
                self.refused(format!("watchdog time {set_s} s does not fit its register"))
            })?;
            let function = self.map.write_function(cells.len());
            self.bus.write(Put { function, address: location.address, cells: &cells })?;
        }
        let cells = self.bus.read(location.request())?.cells;
        let raw = location.layout.pattern(&cells).unwrap_or_default();
        let time_s = location.layout.number(raw) * unit_s;
        if let Some(set_s) = set_s
            && (time_s - set_s).abs() > 0.5 * unit_s
        {
            let message = format!("the watchdog was set to {set_s} s and reads back as {time_s} s");
            return Err(LinkError::Identity(self.name().0, message));
        }
        Ok(Some(time_s))
    }

    fn refused(&self, reason: String) -> LinkError {
        LinkError::Refused(self.bus.name().0, reason)
    }
}

/// Whether a request with this result may have been sent.
const fn was_sent<T>(result: &Result<T>) -> bool {
    !matches!(
        result,
        Err(LinkError::Unproven { .. } | LinkError::Refused { .. } | LinkError::Gone { .. })
    )
}

/// Keeps the first refusal until the state of the drive is read.
fn held_back(first: &mut Option<LinkError>, result: Result<()>) -> Result<()> {
    match result {
        Err(error @ LinkError::Exception { .. }) => {
            first.get_or_insert(error);
            Ok(())
        }
        result => result,
    }
}

/// During a stop only a lost link is an error: the cause is reported already.
fn gone(result: Result<()>) -> Result<()> {
    match result {
        Err(error @ LinkError::Gone { .. }) => Err(error),
        _ => Ok(()),
    }
}

impl<B: CellBus> DriveLink for ProfiledLink<B> {
    fn name(&self) -> LinkName {
        self.bus.name()
    }

    /// Reads first; the watchdog is written only if the identity matches the profile and the drive does not run.
    fn identify(&mut self) -> Result<Identity> {
        let mut identity = self.recognise()?;
        let time_s = self.supervision()?;
        self.watchdog_s = time_s.filter(|time_s| *time_s > 0.0);
        identity.watchdog_s = self.watchdog_s;
        Ok(identity)
    }

    fn recognise(&mut self) -> Result<Identity> {
        let mut pauses = BusyPauses::default();
        while let Err(error) = self.readings.read_all(&mut self.bus) {
            let pause = pauses.next(&error).ok_or(error)?;
            self.bus.pause_until_s(self.bus.now_s() + pause.as_secs_f64());
        }
        self.check_identity()?;
        self.outlast_watchdog()?;
        let (mut vendor, mut product, mut firmware) =
            (String::new(), self.map.device.name.clone(), String::new());
        if self.map.functions.contains(&43) {
            vendor = self.bus.object(0)?.unwrap_or_default();
            product = self.bus.object(1)?.unwrap_or(product);
            firmware = self.bus.object(2)?.unwrap_or_default();
        }
        let value = |quantity| self.reading(&self.map.of_quantity(quantity)?.name);
        let stored = |quantity| {
            let signal = self.map.of_quantity(quantity)?;
            Some(signal.location.layout.number(self.readings.get(&signal.name)?.pattern?))
        };
        Ok(Identity {
            vendor,
            product,
            serial_number: String::new(),
            firmware,
            protocol_version: 0,
            is_emulator: self.bus.is_emulated(),
            watchdog_s: self.watchdog_s,
            current_limit_a: value(Quantity::CurrentLimit),
            voltage_limit_v: value(Quantity::VoltageLimit),
            motor: StatedMotor::of(value, stored),
        })
    }

    fn found(&self) -> Option<Sample> {
        let now_s = self.bus.now_s();
        Some(self.sample(self.on_time_axis(now_s), now_s))
    }

    fn compare_set_points(&mut self) -> Result<Option<Result<String, String>>> {
        self.points.begin();
        self.points.compare(&mut far_end!(self))
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        let (quantity, value) = match command.demand {
            Demand::Disable | Demand::Stop => return self.cycle(&Wanted::Rest, command.seq),
            Demand::ResetFault => return self.cycle(&Wanted::Reset, command.seq),
            Demand::Voltage(volts) => (Quantity::Voltage, volts),
            Demand::Current(amperes) => (Quantity::Current, amperes),
            Demand::Speed(speed) => (Quantity::Speed, speed),
        };
        self.is_unsent = true;
        let map = Arc::clone(&self.map);
        let unit = |point| Some((point, self.readings.demand_si(point)?));
        let Some((point, si)) = map.demand(quantity).and_then(unit) else {
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

    fn stop(&mut self) -> Result<()> {
        self.points.has_written = false;
        let stopped = self.stop_or_coast();
        self.is_unsent = !was_sent(&stopped) && !self.points.has_written;
        stopped
    }

    /// A reference left in the drive must not act with the next command (auto-resume).
    fn bring_to_rest(&mut self) -> Result<()> {
        self.points.begin();
        self.points.is_urgent = true;
        let zeroed = self.points.zero(&mut far_end!(self));
        if !matches!(zeroed, Err(LinkError::Gone { .. })) {
            // A drive that refuses a reference may accept a stop.
            self.stop()?;
        }
        // One in fault takes none, and its output is off; its enable command begins with all references at zero.
        let is_off = self.is_in_fault() && self.reported("running") == Some(false);
        if is_off && matches!(zeroed, Err(LinkError::Exception { .. })) { Ok(()) } else { zeroed }
    }

    fn has_sent_command(&self) -> bool {
        !self.is_unsent
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

    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        self.bus.stop_request()
    }

    /// Fast signals and one set-point.
    fn shortest_cycle_s(&self) -> Option<f64> {
        let frames = cycle_frames(&self.map).into_iter();
        frames.map(|(request, reply)| self.bus.wire_s(request, reply)).sum()
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
