//! The loop that owns the link: absolute deadlines, one exchange per cycle, zero output at the end whatever happens.
//!
//! ```text
//! wait for the deadline -> missed? -> intents, signals -> Cycle -> exchange -> Sample -> record, estimate, publish
//! ```
//!
//! The same code runs in real time and, with the virtual clock and the drive in memory, faster than that and the same to
//! the byte for each seed.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use serde::Serialize;
use serde_json::Value;

use super::clock::{Clock, SUSPENDED_S};
use super::limits::Nameplate;
use super::line_watch::{FOREIGN_WRITES, LineReport, LineWatch};
use super::live_online::{Excitation, RowEstimator};
use super::reopen::{Reopened, RunEnd};
use super::session::{Action, Input, Intent, Level, Lost, Notice, Outcome, Phase, Session};
use super::snapshot::{Publisher, Snapshot, SnapshotCell, Target};
use super::speed::SpeedReport;
use super::stop::{LastSeconds, Stop, StopWatch};
use super::timing::{Punctuality, Timing};
use super::trip::{Trip, TripKind};
use crate::recording::{CommandRow, Event, Manifest, Record, Row};
use drivebench_identify::online::Frozen;
use drivebench_link::{Burst, Capture, DriveLink, LineCounts, LinkError, LinkStatistics};
use drivebench_model::numerics::count::whole;
use drivebench_model::sample::{Command, Demand, DriveState, ParameterEstimate};

/// Longest wait for a drive to become safe by itself, s.
const CONNECT_TIME_S: f64 = 5.0;

/// Parts of a run, all of the calling thread.
pub struct Bench<'a> {
    pub link: &'a mut dyn DriveLink,
    pub clock: &'a mut dyn Clock,
    pub recorder: &'a mut dyn Record,
    pub estimator: Option<&'a mut RowEstimator>,
    /// From the screen; a screen that is gone sends nothing any more, and the run goes on.
    pub intents: &'a Receiver<Intent>,
    /// Set by Ctrl-C, SIGTERM and SIGHUP: once ramps down, a second time stops at once.
    pub interrupted: &'a AtomicBool,
    pub snapshots: &'a SnapshotCell,
}

#[derive(Clone, Debug)]
pub struct RunOptions {
    pub name: String,
    pub target: Target,
    pub rate_hz: f64,
    /// The motor of the model that is simulated beside the measurement; `None`: none is known yet.
    pub motor: Option<Nameplate>,
    /// Starts the program as soon as the session is safe, as a headless run does; else `Intent::Start` does.
    pub auto_start: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    pub outcome: Outcome,
    pub rows: u64,
    pub duration_s: f64,
    pub timing: Timing,
    pub link: LinkStatistics,
    /// Burst capture of the drive, if it was requested.
    #[serde(skip)]
    pub capture: Option<Capture>,
    /// `None` without a wire.
    pub wire: Option<Wire>,
    pub estimates: Vec<ParameterEstimate>,
    /// Persistence of excitation of each at the end, 0 to 1.
    pub excitation: Excitation,
    /// Time in which a limit of the drive froze the estimators.
    pub frozen: Frozen,
    #[serde(rename = "loop", skip_serializing_if = "Option::is_none")]
    pub speed: Option<SpeedReport>,
    pub notices: Vec<Notice>,
    /// Why zero output could not be confirmed at the very end, if it could not.
    pub stop_error: Option<String>,
    /// Where its output was on.
    pub stop: Option<Stop>,
    /// Of a trip.
    #[serde(rename = "trip", skip_serializing_if = "Option::is_none")]
    pub last_seconds: Option<LastSeconds>,
    pub recorder_error: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reopened: Option<Reopened>,
    #[serde(skip)]
    pub end: RunEnd,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Wire {
    #[serde(flatten)]
    pub line: LineCounts,
    pub round_trip_p50_s: Option<f64>,
    pub round_trip_p99_s: Option<f64>,
    pub round_trip_longest_s: f64,
    /// Upper bound of a bucket in us, and the round trips in it.
    pub round_trips_us: Vec<(f64, u64)>,
}

impl Wire {
    fn of(link: &dyn DriveLink) -> Option<Self> {
        let (line, trips) = (link.line()?, link.round_trips()?);
        Some(Self {
            line,
            round_trip_p50_s: trips.p50_s(),
            round_trip_p99_s: trips.p99_s(),
            round_trip_longest_s: trips.longest_s(),
            round_trips_us: trips.histogram_us(),
        })
    }
}

impl RunSummary {
    /// Whether the stop of the drive is not confirmed, in a run that the user did not end.
    pub const fn lost_its_drive(&self) -> bool {
        self.stop_error.is_some()
            && !matches!(self.outcome, Outcome::Stopped | Outcome::Interrupted)
    }

    pub fn describe(&self, manifest: &mut Manifest) {
        manifest.outcome = Some(match &self.outcome {
            Outcome::Done => "passed".to_owned(),
            Outcome::Stopped => "stopped".to_owned(),
            Outcome::Interrupted => "interrupted".to_owned(),
            Outcome::Tripped(trip) => format!("safety trip: {}", trip.reason),
            Outcome::LinkLost { reason } => format!("link lost: {reason}"),
            Outcome::NotStarted { reason } => format!("not started: {reason}"),
        });
        manifest.stop = serde_json::to_value(&self.stop).unwrap_or(Value::Null);
        manifest.trip = serde_json::to_value(self.last_seconds).unwrap_or(Value::Null);
        if let Some(reopened) = &self.reopened {
            manifest.reopened = serde_json::to_value(reopened).unwrap_or(Value::Null);
        }
        manifest.link_statistics = serde_json::to_value(self.link).unwrap_or(Value::Null);
        manifest.wire = serde_json::to_value(&self.wire).unwrap_or(Value::Null);
        manifest.period_asked_s = Some(1.0 / self.timing.rate_asked_hz);
        manifest.period_achieved_s =
            (self.timing.rate_achieved_hz > 0.0).then(|| 1.0 / self.timing.rate_achieved_hz);
        manifest.missed_cycles = Some(self.timing.missed_cycles);
        manifest.lateness_p50_s = Some(self.timing.lateness_p50_s);
        manifest.lateness_p99_s = Some(self.timing.lateness_p99_s);
    }
}

/// Runs a session to its end. On return, and after a panic, the drive has got a request to stop.
pub fn run(session: Session, bench: Bench<'_>, options: &RunOptions) -> RunSummary {
    let first = Snapshot {
        name: options.name.clone(),
        link: bench.link.name().0,
        target: options.target,
        ..Snapshot::default()
    };
    let times = bench.link.command_times();
    let mut runner = Runner {
        publisher: Publisher::new(bench.snapshots.clone(), first, options.motor.as_ref()),
        session: session
            .reporting_stop(bench.link.confirms_stop())
            .with_command_times(times.polled_every(1.0 / options.rate_hz)),
        link: StopOnDrop(bench.link),
        recorder: bench.recorder,
        estimator: bench.estimator,
        actions: Vec::new(),
        inputs: VecDeque::new(),
        punctuality: Punctuality::default(),
        demand: Demand::Disable,
        end: RunEnd::default(),
        notices: Vec::new(),
        outcome: None,
        not_started: None,
        burst_armed: false,
        slept_s: bench.clock.slept_s(),
        clock: bench.clock,
        options,
        record_messages: 0,
        watch: LineWatch::new(options.rate_hz),
        stop: StopWatch::default(),
    };
    runner.run_to_end(bench.intents, bench.interrupted)
}

/// Zero output also where the loop ends by a panic.
struct StopOnDrop<'a>(&'a mut dyn DriveLink);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // No error can be reported; the drive's watchdog remains.
            let _ = self.0.stop();
        }
    }
}

struct Runner<'a> {
    options: &'a RunOptions,
    clock: &'a mut dyn Clock,
    session: Session,
    link: StopOnDrop<'a>,
    recorder: &'a mut dyn Record,
    estimator: Option<&'a mut RowEstimator>,
    publisher: Publisher,
    actions: Vec<Action>,
    inputs: VecDeque<Input>,
    punctuality: Punctuality,
    /// The command in force.
    demand: Demand,
    end: RunEnd,
    notices: Vec<Notice>,
    outcome: Option<Outcome>,
    /// Why an automatic start was given up.
    not_started: Option<String>,
    burst_armed: bool,
    /// Time in suspension so far, s.
    slept_s: f64,
    record_messages: usize,
    watch: LineWatch,
    stop: StopWatch,
}

impl Runner<'_> {
    fn run_to_end(&mut self, intents: &Receiver<Intent>, interrupted: &AtomicBool) -> RunSummary {
        let period_s = 1.0 / self.options.rate_hz;
        let begin_s = self.clock.now_s();
        let mut cycle: u64 = 0;
        let mut start_pending = self.options.auto_start;
        while self.outcome.is_none() {
            let mut due_s = begin_s + cycle as f64 * period_s;
            self.await_cycle(due_s);
            let now_s = self.clock.now_s();
            let missed = whole((now_s - due_s) / period_s) as u64;
            if missed > 0 {
                cycle += missed;
                due_s = begin_s + cycle as f64 * period_s;
                self.punctuality.missed(missed);
                self.feed(Input::Missed(missed));
            }
            self.punctuality.cycle(now_s, now_s - due_s);
            if let Some(stop_request) = self.link.0.stop_request() {
                // Requests to stop are read now.
                stop_request.lower();
            }
            if interrupted.swap(false, Ordering::AcqRel) {
                self.feed(Input::Intent(Intent::Quit));
            }
            while let Ok(intent) = intents.try_recv() {
                self.feed(Input::Intent(intent));
            }
            if start_pending {
                start_pending = !self.try_start(now_s - begin_s);
            }
            self.feed(Input::Cycle);
            if now_s >= self.publisher.next_s {
                self.report_record(now_s);
                self.publish(now_s, None);
            }
            cycle += 1;
        }
        // Whatever the state of the session: the last command to the drive is zero output.
        let sent_s = self.clock.now_s();
        let stopped = self.link.0.stop();
        self.note_last_stop(sent_s, self.clock.now_s(), &stopped);
        if let Some(notice) = self.session.stop_notice(stopped.as_ref().err()) {
            self.notify(notice);
        }
        let stop_error = stopped.err().map(|error| error.to_string());
        follow(self.recorder.flush(), &mut self.stop, self.estimator.as_deref_mut());
        let now_s = self.clock.now_s();
        // A drive that did not confirm its stop gets no request for records.
        let capture = if stop_error.is_none() { self.fetch_burst() } else { None };
        let outcome = match (self.outcome.take(), self.not_started.take()) {
            (Some(Outcome::Stopped) | None, Some(reason)) => Outcome::NotStarted { reason },
            (outcome, _) => outcome.unwrap_or(Outcome::Stopped),
        };
        self.report_record(now_s);
        let stop = self.stop.stop(self.session.watchdog_s());
        self.report_stop(now_s, &outcome, stop.as_ref());
        let end = (outcome.name(), stop_error.clone(), stop.clone());
        self.publish(now_s, Some(end));
        let recorder = self.recorder.status();
        let (estimates, excitation, frozen) = self.estimated();
        RunSummary {
            rows: recorder.rows as u64,
            duration_s: now_s - begin_s,
            timing: self.punctuality.timing(self.options.rate_hz),
            link: self.link.0.statistics(),
            capture,
            wire: Wire::of(self.link.0),
            estimates,
            excitation,
            frozen,
            speed: self.session.report(),
            notices: std::mem::take(&mut self.notices),
            stop_error,
            stop,
            last_seconds: match &outcome {
                Outcome::Tripped(_) | Outcome::LinkLost { .. } => self.stop.last_seconds(),
                _ => None,
            },
            recorder_error: recorder.error,
            reopened: None,
            end: self.end,
            outcome,
        }
    }

    fn note_last_stop(&mut self, sent_s: f64, now_s: f64, stopped: &Result<(), LinkError>) {
        self.stop.requested(sent_s, self.link.0.has_sent_command());
        self.stop.answered(stopped);
        match stopped {
            // A drive that does not report its output has not confirmed that it is off.
            Ok(()) if self.link.0.confirms_stop() => self.stop.confirmed(now_s),
            Ok(()) => {}
            Err(_) => self.stop.withdraw(),
        }
    }

    /// In the record, and as a notice where the run did not go to its end.
    fn report_stop(&mut self, now_s: f64, outcome: &Outcome, stop: Option<&Stop>) {
        let Some(stop) = stop else { return };
        let detail = serde_json::to_value(stop).unwrap_or(Value::Null);
        self.recorder.event(self.event(now_s, "stop").with("stop", detail));
        // The notice of an unconfirmed one came with the link's last error.
        if *outcome != Outcome::Done && stop.confirmed_after_ms.is_some() {
            self.notify(Notice { level: Level::Info, text: stop.sentence() });
        }
    }

    /// Waits until the next cycle is due, or acts at the end of the allowed silence before.
    fn await_cycle(&mut self, due_s: f64) {
        if self.session.phase().is_energised() {
            let now_s = self.clock.now_s();
            let over_s = now_s + self.session.guard().silence_left_s(now_s);
            if over_s < due_s {
                self.clock.sleep_until_s(over_s);
                self.feed(Input::Silence);
            }
        }
        self.clock.sleep_until_s(due_s);
    }

    /// Starts as soon as the session is safe; ends the run where that is refused or takes too long. Returns whether it is
    /// decided.
    fn try_start(&mut self, waited_s: f64) -> bool {
        if self.session.phase() == Phase::Safe {
            let sample = self.session.last_sample();
            let rest = sample.map(|sample| self.session.guard().check_rest(sample));
            // A motion before this run may still end.
            let may_rest = matches!(rest, Some(Err(error)) if error.may_change());
            if waited_s <= CONNECT_TIME_S && may_rest {
                return false;
            }
            self.feed(Input::Intent(Intent::Start));
            if self.session.phase() != Phase::Safe {
                return true;
            }
            self.not_started = self.notices.last().map(|notice| notice.text.clone());
        } else if waited_s > CONNECT_TIME_S {
            let state = self.session.last_sample().and_then(|sample| sample.state);
            let state = state.map_or("unknown", DriveState::name);
            self.not_started = Some(format!(
                "the drive is in state {state:?} for {CONNECT_TIME_S} s, it must be disabled or ready"
            ));
        } else {
            return false;
        }
        self.feed(Input::Intent(Intent::Stop));
        true
    }

    /// One input and everything that follows from it.
    fn feed(&mut self, input: Input) {
        self.inputs.push_back(input);
        loop {
            // A suspension comes before all other inputs.
            let slept_s = self.clock.slept_s() - self.slept_s;
            if slept_s > SUSPENDED_S {
                self.slept_s += slept_s;
                self.inputs.push_front(Input::Suspended(slept_s));
            }
            let Some(input) = self.inputs.pop_front() else {
                break;
            };
            let mut actions = std::mem::take(&mut self.actions);
            let now_s = self.clock.now_s();
            self.session.step(now_s, input, &mut actions);
            let phase = self.session.phase();
            let offset_s = self.end.drive_minus_host_s;
            let session = &self.session;
            self.stop.phase(now_s, phase, offset_s, || cause(session));
            if self.session.has_stopped() {
                self.stop.confirmed(now_s);
            }
            for action in actions.drain(..) {
                self.act(action);
            }
            self.actions = actions;
        }
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Send(command) => self.exchange(command),
            Action::ArmBurst => self.arm_burst(),
            Action::Row(sample) => {
                let rows = self.recorder.row(&sample);
                follow(rows, &mut self.stop, self.estimator.as_deref_mut());
                self.publisher.sample(&sample, self.demand, self.session.reference_rad_s());
            }
            Action::Event(mut event) => {
                event.time_s += self.end.drive_minus_host_s;
                self.recorder.event(event);
            }
            Action::Notice(notice) => self.notify(notice),
            Action::Finished(outcome) => self.outcome = Some(outcome),
        }
    }

    fn exchange(&mut self, command: Command) {
        let sent_s = self.clock.now_s();
        self.demand = command.demand;
        let is_recorded = self.session.phase().is_recorded();
        let reference_rad_s = self.session.reference_rad_s();
        // A stop is not bounded by the remaining silence.
        let left_s = if command.demand.energises() {
            self.session.guard().silence_left_s(sent_s)
        } else {
            self.session.guard().limits().link_silence_s
        };
        self.link.0.bound(left_s);
        let answer = self.link.0.exchange(command);
        let now_s = self.clock.now_s();
        if command.demand == Demand::Stop {
            // A stop waits for no silence of the line: it goes out as soon as it is handed over.
            self.stop.requested(sent_s, self.link.0.has_sent_command());
            self.stop.answered(&answer);
        }
        if is_recorded && self.link.0.has_sent_command() {
            let row = CommandRow {
                command,
                time_s: sent_s + self.end.drive_minus_host_s,
                reference_rad_s,
            };
            self.recorder.command(&row);
        }
        let duration_s = now_s - sent_s;
        // Time of the link; the excess is a stall of the host.
        self.session.waited_for_link(now_s, duration_s.min(left_s));
        let answered = answer.is_ok();
        self.inputs.push_back(match answer {
            Ok(sample) => {
                // A host that stamps samples has one clock for both: the time of this exchange is no part of the offset.
                let host_s = (sample.time_half_width_s.and(sample.host_time_s)).map(|s| s - now_s);
                let offset_s = host_s.unwrap_or(sample.time_s - sent_s);
                if offset_s.is_finite() && !self.session.guard().is_of_a_restart(now_s, &sample) {
                    self.end.drive_minus_host_s = offset_s;
                }
                self.end.last_reply_s = now_s;
                Input::Sample(Box::new(sample))
            }
            Err(error) => Input::Lost(Lost::from(&error)),
        });
        self.watch_line(now_s, duration_s, answered);
    }

    /// Reports of the line become notices and events at once.
    fn watch_line(&mut self, now_s: f64, duration_s: f64, answered: bool) {
        let line = self.link.0.line().unwrap_or_default();
        let mut reports = self.watch.frames(now_s, line);
        if self.session.phase().is_energised() {
            reports.extend(self.watch.exchange(now_s, duration_s, answered, line));
        } else {
            self.watch.reset();
        }
        for LineReport { event, figure: (key, figure), notice } in reports {
            if event == FOREIGN_WRITES {
                self.inputs.push_back(Input::OtherMaster(line.foreign_writes));
            }
            self.recorder.event(self.event(now_s, event).with(key, figure));
            self.notify(notice);
        }
    }

    /// Errors of the record become notices at once, and stop nothing.
    fn report_record(&mut self, now_s: f64) {
        for text in self.recorder.status().messages.into_iter().skip(self.record_messages) {
            self.record_messages += 1;
            self.recorder.event(self.event(now_s, "record").with("message", text.as_str()));
            self.warn(text);
        }
    }

    /// A run goes on without its burst, with a warning.
    fn arm_burst(&mut self) {
        let armed = match self.link.0.burst() {
            Some(burst) => burst.arm().map_err(|error| error.to_string()),
            None => Err("the drive records no bursts".to_owned()),
        };
        match armed {
            Ok(()) => self.burst_armed = true,
            Err(reason) => self.warn(format!("no burst capture: {reason}")),
        }
    }

    /// Fetches the capture with the output off; the drive may still be recording.
    fn fetch_burst(&mut self) -> Option<Capture> {
        if !self.burst_armed {
            return None;
        }
        let mut reason = "the drive does not finish it".to_owned();
        for _ in 0..20 {
            match self.link.0.burst().map(Burst::fetch) {
                Some(Ok(Some(capture))) => return Some(capture),
                Some(Err(error)) if !error.is_transient() => {
                    reason = error.to_string();
                    break;
                }
                Some(Err(error)) => reason = error.to_string(),
                Some(Ok(None)) | None => {}
            }
            self.clock.sleep_until_s(self.clock.now_s() + 0.1);
        }
        self.warn(format!("the burst capture is lost: {reason}"));
        None
    }

    fn event(&self, now_s: f64, kind: &str) -> Event {
        let time_s = now_s + self.end.drive_minus_host_s;
        Event::new(time_s, None, kind).with("host_time_s", now_s)
    }

    fn warn(&mut self, text: String) {
        self.notify(Notice { level: Level::Warning, text });
    }

    fn notify(&mut self, notice: Notice) {
        self.publisher.notice(notice.clone());
        self.notices.push(notice);
    }

    /// Of the estimators, or nothing without them.
    fn estimated(&self) -> (Vec<ParameterEstimate>, Excitation, Frozen) {
        let Some(estimator) = &self.estimator else { return Default::default() };
        let online = estimator.online();
        (online.estimates(), estimator.excitation(), online.frozen())
    }

    /// `end`: of a run that is over.
    fn publish(&mut self, now_s: f64, end: Option<(&'static str, Option<String>, Option<Stop>)>) {
        let (estimates, excitation, frozen) = self.estimated();
        let innovation = self.estimator.as_ref().and_then(|one| one.online().innovation());
        self.publisher.innovation(innovation);
        let recorder = self.recorder.status();
        self.publisher.publish(now_s, &self.session, estimates, |snapshot| {
            snapshot.excitation = Arc::new(excitation);
            snapshot.frozen = frozen;
            snapshot.link_statistics = self.link.0.statistics();
            snapshot.timing = self.punctuality.timing(self.options.rate_hz);
            snapshot.rows = recorder.rows as u64;
            snapshot.recorder_error = recorder.error;
            if let Some((outcome, stop_error, stop)) = end {
                snapshot.outcome = Some(outcome);
                (snapshot.stop_error, snapshot.stop) = (stop_error, stop);
            }
        });
    }
}

fn follow(rows: &[Row], stop: &mut StopWatch, estimator: Option<&mut RowEstimator>) {
    stop.rows(rows.iter().map(|row| row.time_s));
    if let Some(estimator) = estimator {
        for row in rows {
            estimator.push(row);
        }
    }
}

fn cause(session: &Session) -> (&'static str, Option<TripKind>) {
    let of_trip = |trip: &Trip| (trip.kind.name(), Some(trip.kind));
    match (session.ending(), session.guard().tripped()) {
        (Some(Outcome::Done), _) => ("the end of the sequence", None),
        (Some(Outcome::Interrupted), _) => ("the interruption", None),
        (Some(Outcome::Tripped(trip)), _) => of_trip(trip),
        (Some(Outcome::LinkLost { .. }), Some(trip)) if trip.kind.is_link() => of_trip(trip),
        (Some(Outcome::LinkLost { .. }), _) => ("the loss of the link", None),
        (Some(Outcome::Stopped | Outcome::NotStarted { .. }) | None, _) => {
            ("the request to stop", None)
        }
    }
}

#[cfg(test)]
mod tests;
