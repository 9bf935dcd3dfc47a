//! The session: one bench run from standstill to standstill, as a pure state machine.
//!
//! ```text
//! connecting -> safe -> armed -> running -> ramp_down -> stopping -> done | stopped
//!                         |         |           |           ^
//!                         +---------+-----------+-- trip ---+-----> tripped | link_lost
//! ```
//!
//! A session ends for good: whoever wants to go on begins a new one, at `connecting` with zero output. So nothing re-arms,
//! and no set-point survives a reconnect. Every input that is not a sample or a cycle becomes an event with its number.

mod actions;
mod word;

pub use actions::{Action, Input, Intent, Level, Lost, Notice, Outcome, Phase};

use self::word::{DriveWord, StopRequest};
use serde_json::{Value, json};

use super::check::WATCHDOG;
use super::guard::{Causes, Guard};
use super::mechanics::Brake;
use super::pilot::{OpenLoop, Pilot, PilotNews, Program};
use super::plausibility::PLAUSIBILITY;
use super::speed::SpeedReport;
use super::trip::{Trip, TripKind};
use crate::drive::{CommandTimes, LinkError};
use crate::recording::Event;
use crate::sample::{Channel, Command, Demand, DriveState, Sample};

/// A drive that is to stop and says nothing at all is given up after this, s.
const STOP_SILENCE_S: f64 = 1.0;
/// After the output has reached zero the shaft is given this long to come to rest under braking, s.
const COME_TO_REST_S: f64 = 2.0;
/// Longest wait for the first valid reply, s.
const FIRST_REPLY_S: f64 = 3.0;

const TOLD_NOTHING: &str = "stop unconfirmed: the drive took it, and does not tell whether its output is off; see that the shaft stands still";

/// The order of a brake that holds a load: torque, then release; rest, then the brake, then the output off.
///
/// The drive works the brake (or a relay on its "running" output): no register of ours does. What the session can keep is
/// the order and the times: it holds the load by torque while the brake opens, and again until it has closed. After a trip
/// the drive's own stop acts, and with it its brake.
#[derive(Clone, Copy, Debug)]
struct BrakeOrder {
    brake: Brake,
    /// Since when the drive runs with the holding torque, s.
    held_since_s: Option<f64>,
    /// Since when the shaft rests under it at the end, s.
    resting_since_s: Option<f64>,
}

impl BrakeOrder {
    const fn new(brake: Brake) -> Self {
        Self {
            brake,
            held_since_s: None,
            resting_since_s: None,
        }
    }
}

/// One bench session over one program, or one closed loop.
pub struct Session {
    pilot: Box<dyn Pilot>,
    guard: Guard,
    phase: Phase,
    seq: u64,
    inputs: u64,
    begun_s: Option<f64>,
    reset_wanted: bool,
    /// Host time at which the program began.
    started_s: Option<f64>,
    ramp_since_s: f64,
    stopping_since_s: f64,
    /// What the session will end with, once it has stopped.
    ending: Option<Outcome>,
    word: DriveWord,
    drive: Option<Sample>,
    segment: Option<usize>,
    shaping: Causes,
    shaped_cycles: u64,
    /// Magnitudes at which the program has reached what it was for.
    goals: Vec<(Channel, f64)>,
    /// Segment with whose first command a burst capture is to start, once.
    burst_at: Option<usize>,
    /// Order and times of a load's brake, where there is one.
    brake: Option<BrakeOrder>,
    /// What the user waived, to be said once.
    waived: Vec<String>,
    /// It has been said what is not watched.
    told_unwatched: bool,
    /// Of the step that is taken, and what it has come to so far.
    now_s: f64,
    actions: Vec<Action>,
}

impl Session {
    pub fn new(program: Box<dyn Program>, guard: Guard) -> Self {
        Self::holding(program, guard, 0.0)
    }

    /// A session whose program comes on top of what holds a load at rest, in the quantity that it commands.
    pub fn holding(program: Box<dyn Program>, guard: Guard, hold: f64) -> Self {
        Self::with_pilot(Box::new(OpenLoop { program, hold }), guard)
    }

    /// A session whose demands answer to samples.
    pub fn with_pilot(pilot: Box<dyn Pilot>, guard: Guard) -> Self {
        Self {
            pilot,
            guard,
            phase: Phase::Connecting,
            seq: 0,
            inputs: 0,
            begun_s: None,
            reset_wanted: false,
            started_s: None,
            ramp_since_s: 0.0,
            stopping_since_s: 0.0,
            ending: None,
            word: DriveWord::default(),
            drive: None,
            segment: None,
            shaping: Causes::default(),
            shaped_cycles: 0,
            goals: Vec::new(),
            burst_at: None,
            brake: None,
            waived: Vec::new(),
            told_unwatched: false,
            now_s: 0.0,
            actions: Vec::new(),
        }
    }

    /// Keeps the order of a load's brake: torque, then release; rest, then the brake, then the output off.
    #[must_use]
    pub fn with_brake(mut self, brake: Option<Brake>) -> Self {
        self.brake = brake.map(BrakeOrder::new);
        self
    }

    /// Says in log and notices which checks the user waived, and goes on without them.
    #[must_use]
    pub fn with_waivers(mut self, waived: Vec<String>) -> Self {
        if waived.iter().any(|check| check == PLAUSIBILITY) {
            self.guard.waive_plausibility();
        }
        self.word.is_unwatched = waived.iter().any(|check| check == WATCHDOG);
        self.waived = waived;
        self
    }

    /// The guard learns from the readings of the checks how noisy the sensors are.
    #[must_use]
    pub fn with_rest(mut self, rest: &[Sample]) -> Self {
        self.guard.learn(rest);
        self
    }

    /// For a drive that does not tell whether its output is off: a stop that it took is not said to be confirmed.
    #[must_use]
    pub const fn telling_stop(mut self, tells: bool) -> Self {
        self.word.tells_stop = tells;
        self
    }

    /// For a drive that stops by itself after so long without a command, s.
    #[must_use]
    pub const fn with_watchdog(mut self, watchdog_s: Option<f64>) -> Self {
        self.word.watchdog_s = watchdog_s;
        self
    }

    /// `None` where nothing is known of a watchdog, or the user waived it.
    pub fn watchdog_s(&self) -> Option<f64> {
        let is_on = |time_s: &f64| *time_s > 0.0 && !self.word.is_unwatched;
        self.word.watchdog_s.filter(is_on)
    }

    /// What it ends with, or has ended with: of a stop that the drive did not confirm, what it was stopped for.
    pub const fn ending(&self) -> Option<&Outcome> {
        self.ending.as_ref()
    }

    /// Whether it is over, by the drive's own word.
    pub fn has_stopped(&self) -> bool {
        self.phase.is_final() && self.word.tells_stop && self.word.stop == StopRequest::Sent
    }

    /// For a drive that may take so long to run and to stop.
    #[must_use]
    pub fn with_command_times(mut self, times: CommandTimes) -> Self {
        self.guard = self.guard.with_enable_time(times.enable_s);
        self.word.stop_time_s = times.stop_s;
        self
    }

    /// Has the drive start a burst capture with the first command of this segment.
    #[must_use]
    pub const fn with_burst_at(mut self, segment: Option<usize>) -> Self {
        self.burst_at = segment;
        self
    }

    /// Ends the program, as done and by the usual ramp down, with the first sample in which one of these quantities
    /// reaches its magnitude: an exploration needs no more than that.
    #[must_use]
    pub fn until(mut self, goals: Vec<(Channel, f64)>) -> Self {
        self.goals = goals;
        self
    }

    /// Continues the sequence numbers of what was exchanged before, so that no late reply can be taken for a new one.
    #[must_use]
    pub const fn after_seq(mut self, seq: u64) -> Self {
        self.seq = seq;
        self
    }

    pub const fn phase(&self) -> Phase {
        self.phase
    }

    pub const fn guard(&self) -> &Guard {
        &self.guard
    }

    /// Of the time since the last step so much was spent waiting for the link.
    pub fn waited_for_link(&mut self, now_s: f64, waited_s: f64) {
        self.guard.waited_for_link(now_s, waited_s);
    }

    pub const fn last_sample(&self) -> Option<&Sample> {
        self.drive.as_ref()
    }

    /// Time within the program and its whole length, s.
    pub fn progress_s(&self, now_s: f64) -> (f64, f64) {
        let total_s = self.pilot.duration_s();
        let elapsed_s = match (self.phase, self.started_s) {
            (_, None) => 0.0,
            (Phase::Running, Some(start_s)) => now_s - start_s,
            (_, Some(start_s)) => self.ramp_since_s.max(start_s) - start_s,
        };
        (elapsed_s.clamp(0.0, total_s), total_s)
    }

    pub fn segment_name(&self) -> Option<&str> {
        self.segment.map(|index| self.pilot.segment_name(index))
    }

    /// The speed reference that holds now, rad/s: none without a loop, zero once the loop is open.
    pub fn reference_rad_s(&self) -> Option<f64> {
        let reference = self.pilot.reference_rad_s();
        match self.phase {
            Phase::Running => reference,
            Phase::RampDown => reference.map(|_| 0.0),
            _ => None,
        }
    }

    /// How the loop went, if there is one.
    pub fn report(&self) -> Option<SpeedReport> {
        self.pilot.report()
    }

    /// Takes one input and appends what is to be done. Each `Cycle` sends one command, unless it only waits for a drive that
    /// was told to stop and gives no sample.
    pub fn step(&mut self, now_s: f64, input: Input, actions: &mut Vec<Action>) {
        self.now_s = now_s;
        self.inputs += 1;
        for check in std::mem::take(&mut self.waived) {
            self.event("waived", json!({ "check": check }));
            self.notice(Level::Warning, format!("waived: {check}"));
        }
        let was = self.phase;
        if let Input::Lost(Lost::Busy(said)) = &input {
            self.guard.refused(said);
        }
        // Before anything is asked of the guard's clock: the time of a sleep is no silence of link or program.
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
                // An exchange is given no more than what is left of the silence.
                self.stop_at_once(was);
            }
            Input::Silence => self.stop_at_once(was),
            Input::Missed(cycles) => {
                self.event("deadline_lost", json!({ "cycles": cycles }));
            }
            Input::Intent(intent) => self.intent(&intent),
            // At once, and nothing else before it.
            Input::Suspended(_) if !self.phase.is_final() => {
                self.send(Demand::Stop);
            }
            Input::Suspended(_) | Input::OtherMaster(_) => {}
        }
        actions.append(&mut self.actions);
    }

    /// Where the output was on until now: a stop goes out with what has brought it about, not in the next cycle.
    fn stop_at_once(&mut self, was: Phase) {
        if was.is_energised() && self.phase == Phase::Stopping {
            self.send(Demand::Stop);
        }
    }

    fn cycle(&mut self) {
        if self.phase == Phase::Armed && self.may_run() && self.is_brake_open() {
            self.started_s = Some(self.now_s);
            self.pilot.begin(self.now_s, self.drive.as_ref());
            self.guard.set_slew(self.pilot.slew_v_per_s());
            self.enter(Phase::Running);
        }
        if self.phase == Phase::Running && self.elapsed_s() >= self.pilot.duration_s() {
            self.end(Outcome::Done);
        }
        let waited_s = self.now_s - *self.begun_s.get_or_insert(self.now_s);
        if self.phase == Phase::Connecting && self.drive.is_none() && waited_s > FIRST_REPLY_S {
            self.lose(&format!("no valid reply within {FIRST_REPLY_S} s"));
            self.finish(false);
        }
        if self.phase == Phase::Stopping {
            self.finish_if_late();
        }
        let asks = || {
            let (watchdog_s, since_s) = (self.watchdog_s(), self.stopping_since_s);
            self.word.asks_to_stop(self.now_s, since_s, watchdog_s)
        };
        if self.phase == Phase::Stopping && !asks() {
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
        if self.phase == Phase::Running {
            self.pilot.sent(&command);
            while let Some(news) = self.pilot.news() {
                let (name, level, reason) = match news {
                    PilotNews::Gains(reason) => ("gains", Level::Info, reason),
                    PilotNews::Watch(reason) => ("watch", Level::Warning, reason),
                };
                self.notice(level, format!("{name}: {reason}"));
                self.event(name, json!({ "reason": reason }));
            }
        }
        if self.phase != Phase::RampDown {
            return;
        }
        if !self.is_ramped_down() {
            // What rested and moves again has to rest anew before its brake counts as shut.
            if let Some(order) = self.brake.as_mut() {
                order.resting_since_s = None;
            }
        } else if self.is_brake_shut() {
            if !self.is_at_rest() {
                let speed = self.drive.as_ref().and_then(|s| s.get(Channel::Speed));
                let shaft = speed.map_or_else(
                    || "is not known to stand still".to_owned(),
                    |speed| format!("still turns at {speed:.1} rad/s"),
                );
                let text = format!(
                    "the shaft {shaft} and the ramp down is over: the output goes off all the same; see that it comes to rest"
                );
                self.notice(Level::Warning, text);
            }
            self.stop_now();
        }
    }

    /// What the drive should do now, before the guard has had its say.
    fn wanted(&mut self) -> Result<Demand, Trip> {
        Ok(match self.phase {
            Phase::Connecting
            | Phase::Safe
            | Phase::Done
            | Phase::Stopped
            | Phase::Tripped
            | Phase::LinkLost => {
                let found_running = self.phase == Phase::Connecting
                    && self.drive_state() == Some(DriveState::Running);
                if std::mem::take(&mut self.reset_wanted) {
                    Demand::ResetFault
                } else if found_running {
                    Demand::Stop
                } else {
                    Demand::Disable
                }
            }
            Phase::Armed | Phase::RampDown => self.pilot.zero(),
            Phase::Running => return self.pilot.demand(self.now_s, self.elapsed_s()),
            Phase::Stopping => Demand::Stop,
        })
    }

    fn send(&mut self, wanted: Demand) -> Command {
        let shaped = self.guard.shape(self.now_s, wanted);
        // The guard answers `Stop` to everything after a trip; in the final phases reading is all that is left to do.
        let demand = if self.phase.is_final() && !wanted.energises() {
            wanted
        } else {
            shaped.demand
        };
        self.note_shaping(wanted, demand, shaped.causes);
        self.seq += 1;
        let command = Command {
            seq: self.seq,
            demand,
        };
        if demand == Demand::Stop {
            self.word.told_s = self.now_s;
        }
        if demand == Demand::Stop && self.word.stop == StopRequest::NotSent {
            self.word.stop = StopRequest::Sent;
        }
        self.guard.sent(&command);
        self.actions.push(Action::Send(command));
        command
    }

    fn sample(&mut self, sample: Sample) {
        let armed = self.phase.is_energised();
        self.guard.follow(self.reference_rad_s());
        let trip = self.guard.watch(self.now_s, &sample, armed).cloned();
        if trip.is_none() && self.phase == Phase::Running {
            let proven = self.guard.plausibility().has_seen_direction();
            let elapsed_s = self.elapsed_s();
            self.pilot.sample(self.now_s, elapsed_s, &sample, proven);
            self.tell_unwatched();
        }
        if self.phase.is_recorded() {
            self.actions.push(Action::Row(Box::new(sample.clone())));
        }
        let state = sample.state;
        self.word.heard_s = self.now_s;
        self.word.sampled_s = self.now_s;
        self.word.has_run |= state.map_or(armed, |state| state == DriveState::Running);
        let reached = self.goals.iter().copied().find_map(|(channel, level)| {
            let value = sample.get(channel)?;
            (value.abs() >= level).then_some((channel, value, level))
        });
        self.drive = Some(sample);
        if let Some(trip) = trip {
            self.trip(&trip);
            // At once, not in the next cycle.
            self.send(Demand::Stop);
            return;
        }
        if let Some((channel, value, level)) = reached
            && self.phase == Phase::Running
        {
            let detail = json!({ "channel": channel.name(), "value": value, "level": level });
            self.event("reached", detail);
            self.end(Outcome::Done);
        }
        match (self.phase, state) {
            (Phase::Connecting, Some(DriveState::Running | DriveState::Fault))
            | (Phase::Stopping, Some(DriveState::Running)) => {}
            (Phase::Connecting, _) => self.enter(Phase::Safe),
            (Phase::Safe, Some(DriveState::Fault)) => {
                self.notice(Level::Warning, "the drive is in fault");
                self.enter(Phase::Connecting);
            }
            (Phase::Stopping, _) if self.word.stop == StopRequest::Sent => self.finish(true),
            _ => {}
        }
    }

    /// Says once what the drive does not give enough of to be watched.
    fn tell_unwatched(&mut self) {
        if self.told_unwatched {
            return;
        }
        self.told_unwatched = true;
        if let Some(text) = self.guard.plausibility().unwatched() {
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
            self.word.heard_s = self.now_s;
        }
        self.event(kind, json!({ "message": message }));
        if matches!(lost, Lost::Refused(_)) && self.phase.is_energised() {
            self.notice(Level::Error, message.clone());
            self.lose(message);
            self.stop_now();
        }
        if matches!(lost, Lost::Gone(_)) && !self.phase.is_final() {
            self.lose(message);
            self.finish(false);
        }
    }

    fn may_run(&self) -> bool {
        let runs = matches!(self.drive_state(), None | Some(DriveState::Running));
        runs && self.is_at_rest()
    }

    fn is_at_rest(&self) -> bool {
        let speed = self.drive.as_ref().and_then(|s| s.get(Channel::Speed));
        speed.is_some_and(|speed| speed.abs() <= self.guard.rest_rad_s())
    }

    fn is_ramped_down(&self) -> bool {
        let waited_s = self.now_s - self.ramp_since_s;
        let longest_s = self.guard.ramp_down_s() + COME_TO_REST_S;
        waited_s > longest_s || (self.shaping == Causes::default() && self.is_at_rest())
    }

    fn drive_state(&self) -> Option<DriveState> {
        self.drive.as_ref().and_then(|sample| sample.state)
    }

    fn elapsed_s(&self) -> f64 {
        self.started_s.map_or(0.0, |start_s| self.now_s - start_s)
    }

    fn intent(&mut self, intent: &Intent) {
        let detail = match intent {
            Intent::Mark(text) => json!({ "intent": intent.name(), "text": text }),
            _ => json!({ "intent": intent.name() }),
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
            Intent::ResetFault if self.phase.is_energised() => {
                Err("a fault is reset only with the output off".to_owned())
            }
            Intent::ResetFault => {
                self.reset_wanted = true;
                Ok(())
            }
            Intent::Mark(_) => Ok(()),
        };
        if let Err(reason) = refused {
            let detail = json!({ "intent": intent.name(), "reason": reason });
            self.event("refused", detail);
            self.notice(Level::Warning, reason);
        }
    }

    /// Output on at zero, if motor and drive are at rest and what is limited can be watched.
    fn arm(&mut self) -> Result<(), String> {
        if self.phase != Phase::Safe {
            return Err(format!(
                "cannot start: the session is {}",
                self.phase.name()
            ));
        }
        let sample = self.drive.as_ref();
        let sample = sample.ok_or("cannot start: no valid sample yet")?;
        if let Some(hindrance) = sample.hindrance {
            return Err(format!("cannot start: {}", hindrance.sentence()));
        }
        let rest = self.guard.check_rest(sample);
        rest.map_err(|error| format!("cannot start: {error}"))?;
        let needs_angle = self.guard.limits().travel_rad.is_some();
        for (channel, needed) in [
            (Channel::Current, true),
            (Channel::Speed, true),
            (Channel::Angle, needs_angle),
        ] {
            if needed && !self.guard.has_seen(channel) {
                return Err(format!(
                    "cannot start: the drive gives no {}, so its limit cannot be watched",
                    channel.name()
                ));
            }
        }
        self.guard.begin(self.now_s, sample);
        self.enter(Phase::Armed);
        Ok(())
    }

    /// First request: ramp down. Second request: zero output at once.
    fn stop(&mut self, outcome: Outcome) {
        match self.phase {
            Phase::Connecting | Phase::Safe | Phase::RampDown => {
                self.ending = Some(outcome);
                self.stop_now();
            }
            Phase::Armed | Phase::Running => self.end(outcome),
            // The program is over and the output going to zero: whoever asks to stop now must not see a next run begin.
            Phase::Stopping if matches!(self.ending, Some(Outcome::Done)) => {
                self.ending = Some(outcome);
            }
            _ => {}
        }
    }

    /// Whether the load may move: the drive has held it for as long as the brake takes to open.
    fn is_brake_open(&mut self) -> bool {
        let runs = self.drive_state() != Some(DriveState::Disabled) && !self.shaping.any();
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.resting_since_s = None;
        if !runs {
            order.held_since_s = None;
            return false;
        }
        let begins = order.held_since_s.is_none();
        let since_s = *order.held_since_s.get_or_insert(self.now_s);
        let release_s = order.brake.release_s;
        if begins {
            let detail = json!({ "brake": "releases", "seconds": release_s });
            self.event("brake", detail);
        }
        self.now_s - since_s >= release_s
    }

    /// Whether the output may go off: the shaft has rested for as long as the brake takes to close.
    fn is_brake_shut(&mut self) -> bool {
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.held_since_s = None;
        let begins = order.resting_since_s.is_none();
        let since_s = *order.resting_since_s.get_or_insert(self.now_s);
        let apply_s = order.brake.apply_s;
        if begins {
            let detail = json!({ "brake": "applies", "seconds": apply_s });
            self.event("brake", detail);
        }
        self.now_s - since_s >= apply_s
    }

    fn end(&mut self, outcome: Outcome) {
        self.ending = Some(outcome);
        // A motor that coasts has no output to ramp down: zero volts switched on would short its winding at full back-EMF.
        if self.guard.is_output_off() && !self.is_at_rest() {
            self.stop_now();
            return;
        }
        self.ramp_since_s = self.now_s;
        self.guard.begin_stop(self.now_s);
        self.enter(Phase::RampDown);
    }

    fn trip(&mut self, trip: &Trip) {
        let detail = json!({ "trip": trip });
        self.event("trip", detail);
        if self.phase.is_final() {
            return;
        }
        self.notice(Level::Error, trip.reason.clone());
        // What made it stop is the reason, not what else is found while it stops.
        let has_reason = matches!(self.ending, Some(Outcome::LinkLost { .. }));
        if trip.kind.is_link() {
            self.lose(&trip.reason);
        } else if self.phase != Phase::Stopping || !has_reason {
            self.ending = Some(Outcome::Tripped(trip.clone()));
        }
        // A drive that gives no sample while it is told to stop is given no more time for it.
        let is_unheard = matches!(trip.kind, TripKind::LinkSilence | TripKind::Refused);
        if !(is_unheard && self.phase == Phase::Stopping) {
            self.stop_now();
        }
    }

    /// A lost link is how the session ends, unless a trip or a person had ended it before.
    fn lose(&mut self, reason: &str) {
        if matches!(self.ending, None | Some(Outcome::Done)) {
            self.ending = Some(Outcome::LinkLost {
                reason: reason.to_owned(),
            });
        }
    }

    fn stop_now(&mut self) {
        self.stopping_since_s = self.now_s;
        self.word.stop = StopRequest::NotSent;
        if self.ramp_since_s <= self.started_s.unwrap_or(self.now_s) {
            self.ramp_since_s = self.now_s;
        }
        self.enter(Phase::Stopping);
    }

    fn finish_if_late(&mut self) {
        let waited_s = self.now_s - self.stopping_since_s;
        let unheard_s = waited_s.min(self.now_s - self.word.heard_s);
        if waited_s > self.word.stop_time_s || unheard_s > STOP_SILENCE_S {
            self.finish(false);
        }
    }

    fn finish(&mut self, confirmed: bool) {
        let mut outcome = self.ending.clone().unwrap_or(Outcome::Stopped);
        if !confirmed && outcome == Outcome::Done {
            outcome = Outcome::LinkLost {
                reason: "the drive did not confirm that its output is off".to_owned(),
            };
        }
        let phase = match &outcome {
            Outcome::Done => Phase::Done,
            Outcome::Stopped | Outcome::Interrupted | Outcome::NotStarted { .. } => Phase::Stopped,
            Outcome::Tripped(_) => Phase::Tripped,
            Outcome::LinkLost { .. } => Phase::LinkLost,
        };
        if !confirmed {
            self.word.stop = StopRequest::Unconfirmed;
        }
        if confirmed && !self.word.tells_stop {
            self.notice(Level::Warning, TOLD_NOTHING);
        }
        self.enter(phase);
        self.event("finished",
            json!({ "outcome": outcome.name(), "stop_confirmed": confirmed && self.word.tells_stop }));
        self.actions.push(Action::Finished(outcome));
    }

    /// What is to be said after the link's own last stop, where that failed or the session ended without the drive's word.
    pub fn last_word(&self, failed: Option<&LinkError>) -> Option<Notice> {
        // A drive that had stopped by its own word may have been switched on by what was under way.
        if self.word.stop != StopRequest::Unconfirmed && failed.is_none() {
            return None;
        }
        let answers = match failed {
            Some(error @ LinkError::Exception { .. }) => format!(" (it answers: {error})"),
            _ => String::new(),
        };
        let not = |why: &str| format!("stop NOT confirmed by the drive{answers}{why}");
        let (level, text) = match failed {
            None if self.word.tells_stop => (
                Level::Warning,
                "the drive confirmed its stop only when it was told once more, after the run"
                    .to_owned(),
            ),
            None => (Level::Warning, TOLD_NOTHING.to_owned()),
            // It answers, or was not seen to run: no watchdog has acted.
            Some(
                error @ (LinkError::Refused { .. }
                | LinkError::Sequence { .. }
                | LinkError::Unstopped { .. }),
            ) => {
                let why = format!(": {error}; see that the shaft stands still");
                (Level::Error, not(&why))
            }
            Some(_) if !self.word.has_run => {
                let why = ", which was not seen to run; see that the shaft stands still";
                (Level::Error, not(why))
            }
            Some(_) if self.word.is_unwatched => (
                Level::Error,
                not(", whose watchdog was waived: the motor may still turn"),
            ),
            Some(_) => {
                let acts = |time_s| {
                    format!(
                        "; its watchdog stops the motor {time_s} s after the last word from here"
                    )
                };
                let unknown =
                    || "; no watchdog is known to stop it: see that the shaft stands still";
                let why = self.watchdog_s().map_or_else(|| unknown().to_owned(), acts);
                (Level::Error, not(&why))
            }
        };
        Some(Notice { level, text })
    }

    fn enter(&mut self, phase: Phase) {
        if phase != self.phase {
            let detail = json!({ "from": self.phase, "to": phase });
            self.phase = phase;
            self.event("phase", detail);
        }
    }

    fn note_segment(&mut self) {
        if self.phase != Phase::Running {
            return;
        }
        let index = self.pilot.segment_at(self.elapsed_s());
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

    /// One event when shaping begins or changes its cause, one when it ends: nothing silent, and no flood.
    fn note_shaping(&mut self, wanted: Demand, sent: Demand, causes: Causes) {
        if causes == self.shaping {
            self.shaped_cycles += u64::from(causes.any());
            return;
        }
        if causes.any() {
            let (wanted, sent) = (demand_json(wanted), demand_json(sent));
            let detail = json!({ "causes": causes, "wanted": wanted, "sent": sent });
            self.event("shaped", detail);
        } else {
            let cycles = self.shaped_cycles;
            self.event("shaped_end", json!({ "cycles": cycles }));
        }
        self.shaped_cycles = if causes.any() {
            self.shaped_cycles + 1
        } else {
            0
        };
        self.shaping = causes;
    }

    /// In host time: who knows the samples' time axis moves it there.
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
