//! The session: one bench run from standstill to standstill, as a pure state machine.
//!
//! ```text
//! connecting -> safe -> armed -> running -> ramp_down -> stopping -> done | stopped
//!                         |         |           |           ^
//!                         +---------+-----------+-- trip ---+-----> tripped | link_lost
//! ```
//!
//! A session ends for good: the next one begins at `connecting` with zero output. So nothing re-arms, and no set-point survives
//! a reconnect. Every input that is not a sample or a cycle becomes an event with its number.

mod actions;
mod state;

pub use actions::{Action, Input, Intent, Level, Lost, Notice, Outcome, Phase};

use self::state::{BrakeMotion, BrakeOrder, Drive, Shaping, State, Watchdog};
use serde_json::{Value, json};

use super::check::WATCHDOG;
use super::guard::{Causes, Guard};
use super::mechanics::Brake;
use super::pilot::{Pilot, PilotEvent};
use super::plausibility::PLAUSIBILITY;
use super::speed::SpeedReport;
use super::trip::{Trip, TripKind};
use crate::recording::Event;
use drivebench_link::{CommandTimes, LinkError};
use drivebench_model::sample::{Channel, Command, Demand, DriveState, Sample};

const UNREPORTED: &str = "stop unconfirmed: the drive accepted it, and does not report whether its output is off; see that the shaft stands still";

/// One bench session over one program, or one closed loop.
pub struct Session {
    pilot: Box<dyn Pilot>,
    /// Voltage that holds a load at rest; the pilot's is added.
    hold_v: f64,
    guard: Guard,
    state: State,
    drive: Drive,
    /// For how long the program ran, once it is over, s.
    ran_s: f64,
    segment: Option<usize>,
    shaping: Shaping,
    /// Magnitudes at which the program has reached its purpose.
    goals: Vec<(Channel, f64)>,
    /// Segment with whose first command a burst capture is to start, once.
    burst_at: Option<usize>,
    /// Order and times of a load's brake, where there is one.
    brake: Option<BrakeOrder>,
    reset_wanted: bool,
    /// Checks that the user waived, before their notice.
    waived: Vec<String>,
    unwatched_reported: bool,
    seq: u64,
    inputs: u64,
    /// Time of the step that is taken, s, and its actions so far.
    now_s: f64,
    actions: Vec<Action>,
}

impl Session {
    pub fn new(pilot: Box<dyn Pilot>, guard: Guard) -> Self {
        Self {
            pilot,
            hold_v: 0.0,
            guard,
            state: State::Connecting(None),
            drive: Drive::default(),
            ran_s: 0.0,
            segment: None,
            shaping: None,
            goals: Vec::new(),
            burst_at: None,
            brake: None,
            reset_wanted: false,
            waived: Vec::new(),
            unwatched_reported: false,
            seq: 0,
            inputs: 0,
            now_s: 0.0,
            actions: Vec::new(),
        }
    }

    /// With a program that is added to the voltage which holds a load at rest.
    #[must_use]
    pub const fn holding(mut self, hold_v: f64) -> Self {
        self.hold_v = hold_v;
        self
    }

    #[must_use]
    pub fn with_brake(mut self, brake: Option<Brake>) -> Self {
        self.brake = brake.map(|brake| BrakeOrder { brake, motion: None });
        self
    }

    /// Without the checks that the user waived; log and notices name them.
    #[must_use]
    pub fn with_waivers(mut self, waived: Vec<String>) -> Self {
        if waived.iter().any(|check| check == PLAUSIBILITY) {
            self.guard.plausibility.waive();
        }
        if waived.iter().any(|check| check == WATCHDOG) {
            self.drive.watchdog = Watchdog::Waived;
        }
        self.waived = waived;
        self
    }

    /// Readings at rest, from which the guard estimates the noise of the sensors.
    #[must_use]
    pub fn with_rest(mut self, rest: &[Sample]) -> Self {
        self.guard.plausibility.estimate_noise(rest);
        self
    }

    /// Whether the drive reports that its output is off: else a stop that it took does not count as confirmed.
    #[must_use]
    pub const fn reporting_stop(mut self, reports: bool) -> Self {
        self.drive.reports_stop = reports;
        self
    }

    /// For a drive that stops by itself after so long without a command, s.
    #[must_use]
    pub fn with_watchdog(mut self, watchdog_s: Option<f64>) -> Self {
        if self.drive.watchdog != Watchdog::Waived {
            self.drive.watchdog = watchdog_s.map_or(Watchdog::Unknown, Watchdog::After);
        }
        self
    }

    /// The quantity that its demands fix, as a column of the record.
    pub fn command_channel(&self) -> Channel {
        match self.pilot.zero() {
            Demand::Current(_) => Channel::CurrentCmd,
            _ => Channel::VoltageCmd,
        }
    }

    /// `None` where no watchdog is known, or the user waived it.
    pub fn watchdog_s(&self) -> Option<f64> {
        self.drive.watchdog_s()
    }

    /// The outcome, also of a session that still stops; of a stop that the drive did not confirm, the cause of the stop.
    pub const fn ending(&self) -> Option<&Outcome> {
        self.state.ending()
    }

    /// Whether it is over and the drive reported that its output is off.
    pub const fn has_stopped(&self) -> bool {
        matches!(self.state.confirmed(), Some(true)) && self.drive.reports_stop
    }

    /// For the longest times that the drive takes to run and to stop.
    #[must_use]
    pub fn with_command_times(mut self, times: CommandTimes) -> Self {
        self.guard = self.guard.with_enable_time(times.enable_s);
        self.drive.stop_time_s = times.stop_s;
        self
    }

    /// Has the drive start a burst capture with the first command of this segment.
    #[must_use]
    pub const fn with_burst_at(mut self, segment: Option<usize>) -> Self {
        self.burst_at = segment;
        self
    }

    /// Ends the program, as done and by the usual ramp down, with the first sample in which one of these quantities reaches its
    /// magnitude.
    #[must_use]
    pub fn until(mut self, goals: Vec<(Channel, f64)>) -> Self {
        self.goals = goals;
        self
    }

    /// Continues the sequence numbers of earlier exchanges, so that no late reply can be taken for a new one.
    #[must_use]
    pub const fn after_seq(mut self, seq: u64) -> Self {
        self.seq = seq;
        self
    }

    pub const fn phase(&self) -> Phase {
        self.state.phase()
    }

    pub const fn guard(&self) -> &Guard {
        &self.guard
    }

    /// Time since the last step that was spent waiting for the link.
    pub fn waited_for_link(&mut self, now_s: f64, waited_s: f64) {
        self.guard.waited_for_link(now_s, waited_s);
    }

    pub const fn last_sample(&self) -> Option<&Sample> {
        self.drive.sample.as_ref()
    }

    /// Time within the program and its whole length, s.
    pub fn progress_s(&self, now_s: f64) -> (f64, f64) {
        let total_s = self.pilot.duration_s();
        (self.elapsed_s(now_s).clamp(0.0, total_s), total_s)
    }

    pub fn segment_name(&self) -> Option<&str> {
        self.segment.map(|index| self.pilot.segment_name(index))
    }

    /// The present speed reference, rad/s: none without a loop, zero once the loop is open.
    pub fn reference_rad_s(&self) -> Option<f64> {
        let reference = self.pilot.reference_rad_s();
        match self.state {
            State::Running(_) => reference,
            State::RampDown { .. } => reference.map(|_| 0.0),
            _ => None,
        }
    }

    pub fn report(&self) -> Option<SpeedReport> {
        self.pilot.report()
    }

    /// One input; appends its actions. Each `Cycle` sends one command, unless it only waits for a drive that has to stop and
    /// gives no sample.
    pub fn step(&mut self, now_s: f64, input: Input, actions: &mut Vec<Action>) {
        self.now_s = now_s;
        self.inputs += 1;
        for check in std::mem::take(&mut self.waived) {
            self.event("waived", json!({ "check": check }));
            self.notice(Level::Warning, format!("waived: {check}"));
        }
        let was = self.phase();
        if let Input::Lost(Lost::Busy(message)) = &input {
            self.guard.refused(message);
        }
        // Before the guard's clock advances: a suspension is no silence of link or program.
        let trip = match input {
            Input::Suspended(slept_s) => self.guard.slept(now_s, slept_s),
            Input::OtherMaster(frames) => self.guard.other_master(now_s, frames),
            _ => self.guard.tick(now_s),
        };
        if let Some(trip) = trip.cloned() {
            self.trip(&trip);
        }
        match input {
            Input::Cycle => self.cycle(),
            Input::Sample(sample) => self.sample(*sample),
            Input::Lost(lost) => {
                self.lost(&lost);
                // An exchange gets no more than the remaining silence.
                self.stop_at_once(was);
            }
            Input::Silence => self.stop_at_once(was),
            Input::Missed(cycles) => {
                self.event("deadline_lost", json!({ "cycles": cycles }));
            }
            Input::Intent(intent) => self.intent(&intent),
            // At once, and nothing else before it.
            Input::Suspended(_) if !self.phase().is_final() => {
                self.send(Demand::Stop);
            }
            Input::Suspended(_) | Input::OtherMaster(_) => {}
        }
        actions.append(&mut self.actions);
    }

    /// Where the output was on until now, a stop goes out with its cause, not in the next cycle.
    fn stop_at_once(&mut self, was: Phase) {
        if was.is_energised() && self.phase() == Phase::Stopping {
            self.send(Demand::Stop);
        }
    }

    fn cycle(&mut self) {
        let runs = matches!(self.drive.state(), None | Some(DriveState::Running));
        if self.phase() == Phase::Armed && runs && self.is_at_rest() && self.is_brake_open() {
            self.pilot.begin(self.now_s, self.drive.sample.as_ref());
            self.guard.set_slew(self.pilot.slew_v_per_s());
            self.enter(State::Running(self.now_s));
        }
        match &mut self.state {
            State::Running(since_s) if self.now_s - *since_s >= self.pilot.duration_s() => {
                self.end(Outcome::Done);
            }
            State::Connecting(since_s) => {
                let waited_s = self.now_s - *since_s.get_or_insert(self.now_s);
                let limit_s = 3.0;
                if self.drive.sample.is_none() && waited_s > limit_s {
                    self.lose(&format!("no valid reply within {limit_s} s"));
                }
            }
            State::Stopping { since_s, .. } => {
                let waited_s = self.now_s - *since_s;
                let silent_s = waited_s.min(self.now_s - self.drive.replied_s);
                if waited_s > self.drive.stop_time_s || silent_s > 1.0 {
                    self.finish(false);
                }
            }
            _ => {}
        }
        if let State::Stopping { since_s, requested_s, .. } = self.state
            && !self.drive.repeats_stop(self.now_s, since_s, requested_s)
        {
            return;
        }
        let wanted = self.wanted().unwrap_or_else(|trip| {
            if let Some(trip) = self.guard.latch(trip).cloned() {
                self.trip(&trip);
            }
            Demand::Stop
        });
        self.note_segment();
        let command = self.send(wanted);
        if self.phase() == Phase::Running {
            self.pilot.sent(&command);
            while let Some(next_event) = self.pilot.next_event() {
                let (name, level, reason) = match next_event {
                    PilotEvent::Gains(reason) => ("gains", Level::Info, reason),
                    PilotEvent::Watch(reason) => ("watch", Level::Warning, reason),
                };
                self.notice(level, format!("{name}: {reason}"));
                self.event(name, json!({ "reason": reason }));
            }
        }
        let State::RampDown { since_s, .. } = self.state else {
            return;
        };
        // A braked shaft comes to rest within 2 s after the output has reached zero.
        let longest_s = self.guard.ramp_down_s() + 2.0;
        let is_at_zero = self.shaping.is_none() && self.is_at_rest();
        if self.now_s - since_s <= longest_s && !is_at_zero {
            // A shaft that moves again has to rest anew before its brake counts as applied.
            if let Some(order) = self.brake.as_mut() {
                order.motion = None;
            }
        } else if self.brake_has_moved(BrakeMotion::Apply) {
            if !self.is_at_rest() {
                let shaft = self.speed_rad_s().map_or_else(
                    || "is not known to stand still".to_owned(),
                    |speed| format!("still turns at {speed:.1} rad/s"),
                );
                self.notice(Level::Warning, format!(
                    "the shaft {shaft} and the ramp down is over: the output goes off all the same; see that it comes to rest"
                ));
            }
            self.stop_now(None);
        }
    }

    /// The demand before the guard shapes it.
    fn wanted(&mut self) -> Result<Demand, Trip> {
        let demand = match self.state {
            State::Connecting(_) | State::Safe | State::Over { .. } => {
                let found_running = matches!(self.state, State::Connecting(_))
                    && self.drive.state() == Some(DriveState::Running);
                if std::mem::take(&mut self.reset_wanted) {
                    Demand::ResetFault
                } else if found_running {
                    Demand::Stop
                } else {
                    Demand::Disable
                }
            }
            State::Armed | State::RampDown { .. } => self.pilot.zero(),
            State::Running(since_s) => self.pilot.demand(self.now_s, self.now_s - since_s)?,
            State::Stopping { .. } => Demand::Stop,
        };
        Ok(match demand {
            Demand::Voltage(volts) => Demand::Voltage(volts + self.hold_v),
            other => other,
        })
    }

    fn send(&mut self, wanted: Demand) -> Command {
        let shaped = self.guard.shape(self.now_s, wanted);
        // After a trip the guard returns `Stop`; in the final phases only samples are read.
        let demand =
            if self.phase().is_final() && !wanted.energises() { wanted } else { shaped.demand };
        self.note_shaping(wanted, demand, shaped.causes);
        self.seq += 1;
        let command = Command { seq: self.seq, demand };
        if let (State::Stopping { requested_s, .. }, Demand::Stop) = (&mut self.state, demand) {
            *requested_s = Some(self.now_s);
        }
        self.guard.plausibility.sent(&command);
        self.actions.push(Action::Send(command));
        command
    }

    fn sample(&mut self, sample: Sample) {
        let armed = self.phase().is_energised();
        self.guard.plausibility.follow(self.reference_rad_s());
        let trip = self.guard.watch(self.now_s, &sample, armed).cloned();
        if let (None, State::Running(since_s)) = (&trip, &self.state) {
            let proven = self.guard.plausibility.has_proven_direction();
            self.pilot.sample(self.now_s, self.now_s - since_s, &sample, proven);
            self.report_unwatched();
        }
        if self.phase().is_recorded() {
            self.actions.push(Action::Row(Box::new(sample.clone())));
        }
        let state = sample.state;
        self.drive.replied_s = self.now_s;
        self.drive.sampled_s = self.now_s;
        self.drive.has_run |= state.map_or(armed, |state| state == DriveState::Running);
        let reached = self.goals.iter().copied().find_map(|(channel, level)| {
            let value = sample.get(channel)?;
            (value.abs() >= level).then_some((channel, value, level))
        });
        self.drive.sample = Some(sample);
        if let Some(trip) = trip {
            self.trip(&trip);
            // At once, not in the next cycle.
            self.send(Demand::Stop);
            return;
        }
        if let Some((channel, value, level)) = reached
            && self.phase() == Phase::Running
        {
            let detail = json!({ "channel": channel.name(), "value": value, "level": level });
            self.event("reached", detail);
            self.end(Outcome::Done);
        }
        match (&self.state, state) {
            (State::Connecting(_), Some(DriveState::Running | DriveState::Fault))
            | (State::Stopping { .. }, Some(DriveState::Running)) => {}
            (State::Connecting(_), _) => self.enter(State::Safe),
            (State::Safe, Some(DriveState::Fault)) => {
                self.notice(Level::Warning, "the drive is in fault");
                self.enter(State::Connecting(None));
            }
            (State::Stopping { requested_s, .. }, _) if requested_s.is_some() => self.finish(true),
            _ => {}
        }
    }

    fn report_unwatched(&mut self) {
        if std::mem::replace(&mut self.unwatched_reported, true) {
            return;
        }
        if let Some(text) = self.guard.plausibility.unwatched() {
            self.notice(Level::Info, format!("not watched: {text}"));
        }
    }

    fn lost(&mut self, lost: &Lost) {
        let (kind, message) = match lost {
            Lost::Transient(message) => ("reply_lost", message),
            Lost::Busy(message) => ("refused_for_now", message),
            Lost::Refused(message) => ("refused_by_drive", message),
            Lost::Gone(message) => ("link_gone", message),
        };
        if matches!(lost, Lost::Busy(_) | Lost::Refused(_)) {
            self.drive.replied_s = self.now_s;
        }
        self.event(kind, json!({ "message": message }));
        match lost {
            Lost::Refused(_) if self.phase().is_energised() => {
                self.notice(Level::Error, message.clone());
                self.stop_now(Some(self.ending_by_loss(message)));
            }
            Lost::Gone(_) if !self.phase().is_final() => self.lose(message),
            _ => {}
        }
    }

    fn speed_rad_s(&self) -> Option<f64> {
        self.drive.sample.as_ref()?.get(Channel::Speed)
    }

    fn is_at_rest(&self) -> bool {
        self.speed_rad_s().is_some_and(|speed| speed.abs() <= self.guard.rest_rad_s())
    }

    fn elapsed_s(&self, now_s: f64) -> f64 {
        match self.state {
            State::Running(since_s) => now_s - since_s,
            _ => self.ran_s,
        }
    }

    fn intent(&mut self, intent: &Intent) {
        let detail = match intent {
            Intent::Mark(text) => json!({ "intent": intent, "text": text }),
            _ => json!({ "intent": intent }),
        };
        self.event("intent", detail);
        let refused = match intent {
            Intent::Start => self.arm(),
            Intent::Stop => {
                self.stop(Outcome::Stopped);
                Ok(())
            }
            Intent::Quit => {
                self.stop(Outcome::Interrupted);
                Ok(())
            }
            Intent::ResetFault if self.phase().is_energised() => {
                Err("a fault is reset only with the output off".to_owned())
            }
            Intent::ResetFault => {
                self.reset_wanted = true;
                Ok(())
            }
            Intent::Mark(_) => Ok(()),
        };
        if let Err(reason) = refused {
            self.event("refused", json!({ "intent": intent, "reason": reason }));
            self.notice(Level::Warning, reason);
        }
    }

    /// Output on at zero, if motor and drive are at rest and every limited quantity can be watched.
    fn arm(&mut self) -> Result<(), String> {
        let phase = self.phase();
        if phase != Phase::Safe {
            return Err(format!("cannot start: the session is {}", phase.name()));
        }
        let sample = self.drive.sample.as_ref();
        let sample = sample.ok_or("cannot start: no valid sample yet")?;
        if let Some(hindrance) = sample.hindrance {
            return Err(format!("cannot start: {}", hindrance.sentence()));
        }
        self.guard.check_rest(sample).map_err(|error| format!("cannot start: {error}"))?;
        let needs_angle = self.guard.limits().travel_rad.is_some();
        for (channel, needed) in
            [(Channel::Current, true), (Channel::Speed, true), (Channel::Angle, needs_angle)]
        {
            if needed && !self.guard.is_given(channel) {
                return Err(format!(
                    "cannot start: the drive gives no {}, so its limit cannot be watched",
                    channel.name()
                ));
            }
        }
        self.guard.begin(self.now_s, sample);
        self.enter(State::Armed);
        Ok(())
    }

    /// First request: ramp down. Second request: zero output at once.
    fn stop(&mut self, outcome: Outcome) {
        match &mut self.state {
            State::Connecting(_) | State::Safe | State::RampDown { .. } => {
                self.stop_now(Some(outcome));
            }
            State::Armed | State::Running(_) => self.end(outcome),
            // The program is over and the output going to zero: this request must prevent a next run.
            State::Stopping { ending, .. } if *ending == Outcome::Done => *ending = outcome,
            State::Stopping { .. } | State::Over { .. } => {}
        }
    }

    /// Whether the load may move: the drive has held it while the brake opened.
    fn is_brake_open(&mut self) -> bool {
        if self.drive.state() == Some(DriveState::Disabled) || self.shaping.is_some() {
            // It opens again once the drive holds the load.
            if let Some(order) = self.brake.as_mut() {
                order.motion = None;
            }
            return self.brake.is_none();
        }
        self.brake_has_moved(BrakeMotion::Release)
    }

    /// Whether the brake has had its time for this motion, which begins with the first call.
    fn brake_has_moved(&mut self, motion: BrakeMotion) -> bool {
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        let (name, seconds) = match motion {
            BrakeMotion::Release => ("releases", order.brake.release_s),
            BrakeMotion::Apply => ("applies", order.brake.apply_s),
        };
        let begun = order.motion.filter(|(begun, _)| *begun == motion);
        let (_, since_s) = *order.motion.insert(begun.unwrap_or((motion, self.now_s)));
        if begun.is_none() {
            self.event("brake", json!({ "brake": name, "seconds": seconds }));
        }
        self.now_s - since_s >= seconds
    }

    fn end(&mut self, ending: Outcome) {
        // A coasting motor has no output to ramp down: zero volts would short its winding at full back-EMF.
        if self.guard.is_output_off() && !self.is_at_rest() {
            self.stop_now(Some(ending));
            return;
        }
        self.guard.begin_stop(self.now_s);
        self.enter(State::RampDown { since_s: self.now_s, ending });
    }

    fn trip(&mut self, trip: &Trip) {
        self.event("trip", json!({ "trip": trip }));
        if self.phase().is_final() {
            return;
        }
        self.notice(Level::Error, trip.reason.clone());
        let new = match &self.state {
            _ if trip.kind.is_link() => self.ending_by_loss(&trip.reason),
            // The first cause of the stop remains its reason.
            State::Stopping { ending: ending @ Outcome::LinkLost { .. }, .. } => ending.clone(),
            _ => Outcome::Tripped(trip.clone()),
        };
        // A drive without samples gets no more time to stop.
        let is_silent = matches!(trip.kind, TripKind::LinkSilence | TripKind::Refused);
        match &mut self.state {
            State::Stopping { ending, .. } if is_silent => *ending = new,
            _ => self.stop_now(Some(new)),
        }
    }

    /// A lost link ends the session, unless a trip or the user had ended it before.
    fn ending_by_loss(&self, reason: &str) -> Outcome {
        match self.ending() {
            None | Some(Outcome::Done) => Outcome::LinkLost { reason: reason.to_owned() },
            Some(ending) => ending.clone(),
        }
    }

    /// Over at once, without the drive's report.
    fn lose(&mut self, reason: &str) {
        self.finish_with(self.ending_by_loss(reason), false);
    }

    /// Output off; `None`: with the outcome of the ramp down.
    fn stop_now(&mut self, ending: Option<Outcome>) {
        let ending = ending.or_else(|| self.ending().cloned());
        self.enter(State::Stopping {
            since_s: self.now_s,
            requested_s: None,
            ending: ending.unwrap_or(Outcome::Stopped),
        });
    }

    fn finish(&mut self, is_confirmed: bool) {
        self.finish_with(self.ending().cloned().unwrap_or(Outcome::Stopped), is_confirmed);
    }

    fn finish_with(&mut self, ending: Outcome, is_confirmed: bool) {
        let outcome = if ending == Outcome::Done && !is_confirmed {
            Outcome::LinkLost {
                reason: "the drive did not confirm that its output is off".to_owned(),
            }
        } else {
            ending.clone()
        };
        let reports_stop = self.drive.reports_stop;
        if is_confirmed && !reports_stop {
            self.notice(Level::Warning, UNREPORTED);
        }
        self.enter(State::Over { phase: outcome.phase(), is_confirmed, ending });
        self.event(
            "finished",
            json!({ "outcome": outcome.name(), "stop_confirmed": is_confirmed && reports_stop }),
        );
        self.actions.push(Action::Finished(outcome));
    }

    /// The notice after the link's own last stop, where that failed or the session ended without the drive's report.
    pub fn stop_notice(&self, failed: Option<&LinkError>) -> Option<Notice> {
        const REST: &str = "see that the shaft stands still";
        let Some(error) = failed else {
            let text = if self.drive.reports_stop {
                "the drive confirmed its stop only at the last request, after the run"
            } else {
                UNREPORTED
            };
            return (self.state.confirmed() == Some(false))
                .then(|| Notice { level: Level::Warning, text: text.to_owned() });
        };
        // A drive that had reported its stop may have been switched on by a delayed command.
        let answer = match error {
            LinkError::Exception { .. } => format!(" (it answers: {error})"),
            _ => String::new(),
        };
        let why = match (error, self.drive.watchdog) {
            // It answers: no watchdog has acted.
            (
                LinkError::Refused { .. }
                | LinkError::Sequence { .. }
                | LinkError::Unstopped { .. },
                _,
            ) => format!(": {error}; {REST}"),
            _ if !self.drive.has_run => format!(", which never reported that it runs; {REST}"),
            (_, Watchdog::Waived) => {
                ", whose watchdog was waived: the motor may still turn".to_owned()
            }
            (_, Watchdog::After(time_s)) if time_s > 0.0 => {
                format!("; its watchdog stops the motor {time_s} s after the last command")
            }
            _ => format!("; no watchdog is known to stop it: {REST}"),
        };
        Some(Notice {
            level: Level::Error,
            text: format!("stop NOT confirmed by the drive{answer}{why}"),
        })
    }

    fn enter(&mut self, state: State) {
        if let State::Running(since_s) = self.state {
            self.ran_s = self.now_s - since_s;
        }
        let from = self.phase();
        self.state = state;
        let to = self.phase();
        if to != from {
            self.event("phase", json!({ "from": from, "to": to }));
        }
    }

    fn note_segment(&mut self) {
        let State::Running(since_s) = self.state else {
            return;
        };
        let index = self.pilot.segment_at(self.now_s - since_s);
        if self.segment != Some(index) {
            self.segment = Some(index);
            let detail = json!({ "index": index, "name": self.pilot.segment_name(index) });
            self.event("segment", detail);
            if self.burst_at == Some(index) {
                self.burst_at = None;
                self.actions.push(Action::ArmBurst);
                self.event("burst_armed", json!({ "segment": index }));
            }
        }
    }

    /// One event when shaping begins or changes its cause, one when it ends.
    fn note_shaping(&mut self, wanted: Demand, sent: Demand, causes: Causes) {
        let before = self.shaping;
        let cycles = before.map_or(0, |(_, cycles)| cycles);
        self.shaping = causes.any().then_some((causes, cycles + 1));
        if before.map_or_else(Causes::default, |(causes, _)| causes) == causes {
            return;
        }
        if causes.any() {
            let (wanted, sent) = (demand_json(wanted), demand_json(sent));
            self.event("shaped", json!({ "causes": causes, "wanted": wanted, "sent": sent }));
        } else {
            self.event("shaped_end", json!({ "cycles": cycles }));
        }
    }

    /// In host time: the runner moves it to the time axis of the samples.
    fn event(&mut self, kind: &str, detail: Value) {
        let event = Event::new(self.now_s, Some(self.seq), kind).with("host_time_s", self.now_s);
        let mut event = event.with("input", self.inputs);
        if let Value::Object(detail) = detail {
            event.details.extend(detail);
        }
        self.actions.push(Action::Event(event));
    }

    fn notice(&mut self, level: Level, text: impl Into<String>) {
        let text = text.into();
        self.actions.push(Action::Notice(Notice { level, text }));
    }
}

fn demand_json(demand: Demand) -> Value {
    match demand {
        Demand::Disable => json!({ "demand": "disable" }),
        Demand::Stop => json!({ "demand": "stop" }),
        Demand::ResetFault => json!({ "demand": "reset_fault" }),
        Demand::Voltage(volts) => json!({ "voltage_v": volts }),
        Demand::Current(amps) => json!({ "current_a": amps }),
        Demand::Speed(speed) => json!({ "speed_rad_s": speed }),
    }
}

#[cfg(test)]
mod tests;
