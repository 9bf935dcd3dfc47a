//! The guard: every command and every sample passes through it. Time is an argument.
//!
//! ```text
//! wanted demand -> shape (slew, voltage, winding) -> demand to the drive      every change of a demand is reported
//! sample        -> watch (limits, signals, clocks, drive state, plausibility) -> Trip
//!                                                                             latched for good
//! ```
//!
//! After a trip `shape` returns zero output for every demand. It is a second line behind the drive's own limits and watchdog,
//! not a safety function: a host at 100 Hz measures a current of 9 ms time constant too late. So the voltage across the
//! winding is bounded before it is applied: `abs(u - Ke w) <= limit R`, unless the drive limits the current.

mod shape;

pub use shape::{Causes, Shaped};

use shape::{Braking, Shaper};
use thiserror::Error;

use super::limits::{Limits, Nameplate};
use super::plausibility::Plausibility;
use super::trip::{Trip, TripKind};
use drivebench_link::CommandTimes;
use drivebench_model::sample::{Channel, Demand, DriveState, Hindrance, Sample};

#[derive(Clone, Debug, Error, PartialEq)]
pub enum RestError {
    #[error("not at rest: {name} {value:.3} {unit}, at most {limit:.3} {unit} is allowed")]
    Moving { name: &'static str, value: f64, limit: f64, unit: &'static str },
    #[error("the drive is in state {state:?}, it must be disabled or ready")]
    State { state: &'static str },
    #[error("not known to be at rest: the last sample has no {name}")]
    Unread { name: &'static str },
}

impl RestError {
    /// Whether the next sample may be at rest.
    pub const fn may_change(&self) -> bool {
        matches!(self, Self::Moving { .. } | Self::Unread { .. })
    }
}

/// Signals of which the loss ends a run, if the drive gives them at all.
const WATCHED: [Channel; 4] = [Channel::Current, Channel::Speed, Channel::Angle, Channel::Bus];

#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    shaper: Shaper,
    trip: Option<Trip>,
    /// Which of the watched signals a sample ever had.
    given: [bool; WATCHED.len()],
    last_sample: Option<Stamps>,
    last_valid_s: Option<f64>,
    /// Message of the last exception since the last valid reply.
    refusal: Option<String>,
    last_step_s: Option<f64>,
    counts: Counts,
    /// Time that the drive may take from the command to run until it reports that it does, s.
    enable_time_s: f64,
    pub(super) plausibility: Plausibility,
    /// Longest time of braking at the bound of the winding, s.
    braking_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Stamps {
    host_s: f64,
    sample_s: f64,
}

/// Counted from the begin of a run on.
#[derive(Clone, Debug, Default)]
struct Counts {
    /// Samples in a row without each of the watched signals, and without a newer drive time.
    missing: [u32; WATCHED.len()],
    stuck_clock: u32,
    /// Since when the output is on, so that the drive should run, and for how long it was on before, s.
    on_since_s: Option<f64>,
    on_total_s: f64,
    has_run: bool,
    not_running_since_s: Option<f64>,
    angle_origin_rad: Option<f64>,
}

impl Guard {
    /// A guard with `limits`. `drive_current_limit_a` is the drive's own limit as read back, if it has one.
    pub fn new(limits: Limits, motor: &Nameplate, drive_current_limit_a: Option<f64>) -> Self {
        // A drive that lets through more than the bench may draw does not protect the bench's limit.
        let drive_limits = drive_current_limit_a.is_some_and(|amps| amps <= limits.current_a);
        let winding_v = (!drive_limits).then_some(limits.current_a * motor.resistance_ohm);
        let mut shaper = Shaper::new(&limits, motor.back_emf_v_s_per_rad, winding_v);
        shaper.braking = limits.braking_w.map(|watts| Braking::new(watts, motor));
        shaper.load_v =
            motor.resistance_ohm * motor.load_torque_n_m.abs() / motor.back_emf_v_s_per_rad;
        let plausibility = Plausibility::of(&limits, motor, drive_current_limit_a);
        let torque = motor.back_emf_v_s_per_rad * limits.current_a;
        let braking_s =
            winding_v.map_or(0.0, |_| motor.inertia_kg_m2 * limits.speed_rad_s / torque);
        Self { braking_s, ..Self::with_shaper(limits, shaper, plausibility) }
    }

    /// A guard for an unknown motor: `winding_v` bounds the voltage across the winding, as far as the resistance is known at
    /// all, around a back-EMF of which the constant may be 0; without it the program itself has to approach the limit.
    pub fn for_unknown_motor(
        limits: Limits,
        winding_v: Option<f64>,
        back_emf_v_s_per_rad: f64,
    ) -> Self {
        let shaper = Shaper::new(&limits, back_emf_v_s_per_rad, winding_v);
        let plausibility = Plausibility::of_unknown(&limits);
        Self::with_shaper(limits, shaper, plausibility)
    }

    /// For one output in `period_s`: a shaft without a measured speed for longer may have followed the voltage, and the
    /// winding's bound holds over all speeds that it may have reached.
    #[must_use]
    pub fn with_period(mut self, period_s: f64) -> Self {
        self.shaper.fresh_s = shape::FRESH_PERIODS * period_s;
        self
    }

    /// For a drive that may take so long from the command to run until it reports that it does.
    #[must_use]
    pub const fn with_enable_time(mut self, enable_time_s: f64) -> Self {
        self.enable_time_s = enable_time_s;
        self
    }

    fn with_shaper(limits: Limits, shaper: Shaper, plausibility: Plausibility) -> Self {
        Self {
            plausibility,
            braking_s: 0.0,
            shaper,
            limits,
            trip: None,
            given: [false; WATCHED.len()],
            last_sample: None,
            last_valid_s: None,
            refusal: None,
            last_step_s: None,
            counts: Counts::default(),
            enable_time_s: CommandTimes::default().enable_s,
        }
    }

    /// Longest time in which a ramp down from full speed brings the output to zero, s: that of the slew limit plus that of
    /// braking by the supply or the current limit, whichever is longer. The shaft may turn for longer.
    pub fn ramp_down_s(&self) -> f64 {
        let coast_s = self.shaper.coast_s(self.limits.speed_rad_s);
        let longest_coast_s = 60.0;
        self.shaper.ramp_s(self.limits.voltage_v) + coast_s.max(self.braking_s).min(longest_coast_s)
    }

    /// Whether the last command left the output off: the motor stands or coasts.
    pub const fn is_output_off(&self) -> bool {
        self.shaper.is_off()
    }

    /// From here on the output goes down, with the bench's slew limit, and never up again.
    pub fn begin_stop(&mut self, now_s: f64) {
        self.set_slew(None);
        self.shaper.stop_by(now_s + self.ramp_down_s());
    }

    pub const fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Another slew limit from now on, as while a loop is closed; `None`: that of the limits.
    pub fn set_slew(&mut self, v_per_s: Option<f64>) {
        self.shaper.set_slew(v_per_s.unwrap_or(self.limits.slew_v_per_s));
    }

    pub const fn tripped(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    /// Whether samples ever had `channel`: a limit on a signal that the drive does not give cannot be watched.
    pub fn is_given(&self, channel: Channel) -> bool {
        let mut all = WATCHED.into_iter().zip(self.given);
        all.any(|(watched, is_given)| watched == channel && is_given)
    }

    /// Begins a run: counts time and travel from here. Call it when the output is about to be switched on.
    pub fn begin(&mut self, now_s: f64, sample: &Sample) {
        self.counts = Counts { angle_origin_rad: sample.get(Channel::Angle), ..Counts::default() };
        self.last_valid_s = Some(now_s);
        self.shaper.rest(now_s);
        self.plausibility.begin();
    }

    /// To be called first in every step: ends the run when the host or the link was silent for too long.
    pub fn tick(&mut self, now_s: f64) -> Option<&Trip> {
        let limit_s = self.limits.link_silence_s;
        if let Some(last_s) = self.last_step_s {
            let gap_s = now_s - last_s;
            if !gap_s.is_finite() || gap_s < 0.0 {
                return self.trip(TripKind::ClockStuck, last_s, (gap_s, 0.0), "host time ran back");
            }
            if gap_s > limit_s {
                self.last_step_s = Some(now_s);
                return self.trip(TripKind::HostGap, now_s, (gap_s, limit_s), "no step was taken");
            }
        }
        self.last_step_s = Some(now_s);
        if self.trip.is_some() {
            return None;
        }
        let silent_s = self.last_valid_s.map_or(0.0, |last_s| now_s - last_s);
        // An exchange that was given all of the remaining silence ends within 1 us of its end.
        if silent_s > limit_s - 1e-6 {
            let times_s = (silent_s, limit_s);
            return match self.refusal.take() {
                Some(message) => self.latch(Trip::refused(now_s, times_s, &message)),
                None => self.trip(TripKind::LinkSilence, now_s, times_s, "no valid reply"),
            };
        }
        let since_s = self.counts.on_since_s;
        let on_s = self.counts.on_total_s + since_s.map_or(0.0, |since_s| now_s - since_s);
        if on_s > self.limits.time_s {
            return self.trip(TripKind::TimeLimit, now_s, (on_s, self.limits.time_s), "output on");
        }
        None
    }

    fn trip(
        &mut self,
        kind: TripKind,
        at_s: f64,
        times_s: (f64, f64),
        what: &str,
    ) -> Option<&Trip> {
        self.latch(Trip::after(kind, at_s, times_s, what))
    }

    /// The computer was suspended for so long: ends the run; the time is no silence of link or host.
    pub fn slept(&mut self, now_s: f64, slept_s: f64) -> Option<&Trip> {
        self.last_step_s = Some(now_s);
        self.last_valid_s = self.last_valid_s.map(|_| now_s);
        let reason = format!(
            "this computer was suspended for {slept_s:.1} s, and the motor ran unsupervised meanwhile"
        );
        self.latch(Trip { reason, ..Trip::new(TripKind::Suspended, now_s, (slept_s, 0.0), "") })
    }

    /// The drive answers with an exception: the reason of a trip, should no valid reply follow in time.
    pub fn refused(&mut self, message: &str) {
        self.refusal = Some(message.to_owned());
    }

    /// Time since the last step that was spent waiting for the link: no stall of the host.
    pub fn waited_for_link(&mut self, now_s: f64, waited_s: f64) {
        let last_s = self.last_step_s.map(|last_s| last_s + waited_s.max(0.0));
        self.last_step_s = last_s.map(|last_s| last_s.min(now_s));
    }

    /// Remaining silence that is allowed to the link, s: all of it after a trip.
    pub fn silence_left_s(&self, now_s: f64) -> f64 {
        let limit_s = self.limits.link_silence_s;
        match self.last_valid_s {
            Some(last_s) if self.trip.is_none() => (last_s + limit_s - now_s).clamp(0.0, limit_s),
            _ => limit_s,
        }
    }

    /// One valid reply. With `armed` false (output off) it only registers the signals and the time of the reply.
    pub fn watch(&mut self, now_s: f64, sample: &Sample, armed: bool) -> Option<&Trip> {
        self.last_valid_s = Some(now_s);
        self.refusal = None;
        self.shaper.reply(now_s);
        let is_newer = (self.last_sample).is_none_or(|last| sample.time_s > last.sample_s);
        for (given, channel) in self.given.iter_mut().zip(WATCHED) {
            *given |= sample.get(channel).is_some();
        }
        // A repeated reading has no information on the present speed.
        if let Some(speed) = sample.get(Channel::Speed).filter(|_| is_newer) {
            self.shaper.measured(now_s, speed);
        }
        // From the first angle on: the sample with which a run began may have lacked it.
        if armed && self.counts.angle_origin_rad.is_none() {
            self.counts.angle_origin_rad = sample.get(Channel::Angle);
        }
        let implausible = self.plausibility.check(now_s, sample, armed);
        let found = if armed && self.trip.is_none() {
            // The field first: a drive that detects its loss too reports no more than a fault.
            self.field(now_s, sample)
                .or_else(|| self.drive_state(now_s, sample))
                .or_else(|| {
                    let beyond = self.beyond_limit(now_s, sample)?;
                    // A wrong signal is often beyond a limit before it is implausible.
                    Some(self.plausibility.explained(beyond))
                })
                .or_else(|| self.lost_signal(now_s, sample))
                .or_else(|| self.switched_on_again(now_s, sample))
                .or_else(|| self.stuck_clock(now_s, sample.time_s, is_newer))
                .or(implausible)
        } else {
            None
        };
        if sample.time_s.is_finite() {
            self.last_sample = Some(Stamps { host_s: now_s, sample_s: sample.time_s });
        }
        found.and_then(|trip| self.latch(trip))
    }

    /// Frames of another master write to the drive, which no longer follows these commands.
    pub fn other_master(&mut self, now_s: f64, frames: u64) -> Option<&Trip> {
        let what = format!(
            "{frames} frames on the line write to this drive and are not of this host; its set-points are no longer the commanded ones; disconnect the other master, or take its write access"
        );
        self.latch(Trip::new(TripKind::OtherMaster, now_s, (frames as f64, 0.0), what))
    }

    /// Latches a trip, unless one is latched already: the first cause is reported.
    pub fn latch(&mut self, trip: Trip) -> Option<&Trip> {
        if self.trip.is_some() {
            return None;
        }
        self.switch(trip.at_s, false);
        Some(self.trip.insert(trip))
    }

    /// The demand to be sent: as requested, or within the limits, or zero output after a trip.
    pub fn shape(&mut self, now_s: f64, wanted: Demand) -> Shaped {
        if self.trip.is_some() {
            self.shaper.rest(now_s);
            return Shaped::unchanged(Demand::Stop);
        }
        let is_plausible = self.plausibility.speed_is_plausible();
        let shaped = self.shaper.shape(now_s, wanted, &self.limits, is_plausible);
        self.switch(now_s, shaped.demand.energises());
        shaped
    }

    /// Whether the motor stands still and the drive is off and without a fault.
    pub fn check_rest(&self, sample: &Sample) -> Result<(), RestError> {
        if let Some(state @ (DriveState::Running | DriveState::Fault)) = sample.state {
            return Err(RestError::State { state: state.name() });
        }
        for (channel, limit) in
            [(Channel::Speed, self.rest_rad_s()), (Channel::Current, 0.02 * self.limits.current_a)]
        {
            let (name, unit) = (channel.name(), channel.unit());
            match sample.get(channel) {
                Some(value) if value.abs() <= limit => {}
                Some(value) => {
                    return Err(RestError::Moving { name, value, limit, unit });
                }
                None if self.is_given(channel) => return Err(RestError::Unread { name }),
                None => {}
            }
        }
        Ok(())
    }

    /// Speed below which the shaft counts as at rest, rad/s.
    pub const fn rest_rad_s(&self) -> f64 {
        self.shaper.rest_rad_s
    }

    /// Keeps the time for which the output was on, and since when the drive should run.
    fn switch(&mut self, now_s: f64, on: bool) {
        let counts = &mut self.counts;
        if on && counts.on_since_s.is_none() {
            counts.on_since_s = Some(now_s);
            (counts.has_run, counts.not_running_since_s) = (false, None);
        } else if !on && let Some(since_s) = counts.on_since_s.take() {
            counts.on_total_s += now_s - since_s;
        }
    }

    fn beyond_limit(&self, now_s: f64, sample: &Sample) -> Option<Trip> {
        use TripKind::{BusHigh, BusLow, OverCurrent, OverSpeed, OverVoltage, Travel};
        type Breaks = fn(f64, f64) -> bool;
        let limits = &self.limits;
        let read = |channel| sample.get(channel);
        let angle = read(Channel::Angle).zip(self.counts.angle_origin_rad);
        let travel = angle.map(|(angle, origin)| angle - origin);
        // For ripple, noise and calibration of the drive.
        let voltage_v = 1.1 * limits.voltage_v;
        let above = |value: f64, limit: f64| value > limit;
        let below = |value: f64, limit: f64| value < limit;
        let beyond = |value: f64, limit: f64| value.abs() > limit;
        let window = limits.travel_rad;
        let (amps, speed) = (Some(limits.current_a), Some(limits.speed_rad_s));
        // A value instead of the channel's, the limit, and the comparison.
        let rows: [(_, _, _, _, Breaks); 6] = [
            (OverCurrent, Channel::Current, None, amps, beyond),
            (OverSpeed, Channel::Speed, None, speed, beyond),
            (OverVoltage, Channel::Voltage, None, Some(voltage_v), beyond),
            (Travel, Channel::Angle, Some(travel), window, beyond),
            (BusHigh, Channel::Bus, None, limits.bus_max_v, above),
            (BusLow, Channel::Bus, None, limits.bus_min_v, below),
        ];
        rows.into_iter().find_map(|(kind, channel, instead, limit, breaks)| {
            let value = instead.unwrap_or(read(channel))?;
            let limit = limit.filter(|limit| breaks(value, *limit))?;
            let (name, unit) = (channel.name(), channel.unit());
            let what = format!("{name} {value:.4} {unit}, limit {limit:.4} {unit}");
            Some(Trip::new(kind, now_s, (value, limit), what))
        })
    }

    fn field(&self, now_s: f64, sample: &Sample) -> Option<Trip> {
        let least_a = self.limits.field_min_a?;
        // Without a reading the drive's state decides: its link counts a field that cannot be read as lost.
        let unread = sample.field_a.is_none() && sample.state == Some(DriveState::Fault);
        let weak = sample.field_a.is_some_and(|amperes| amperes < least_a);
        let found = sample.field_a.map(|amperes| format!("{amperes:.3} A"));
        let found = found.unwrap_or_else(|| "cannot be read".to_owned());
        let what = format!(
            "field current {found}, at least {least_a:.3} A (limits.field_min_a of the drive's profile)"
        );
        let figures = (sample.field_a.unwrap_or(0.0), least_a);
        (weak || unread).then(|| Trip::new(TripKind::FieldLost, now_s, figures, what))
    }

    fn drive_state(&mut self, now_s: f64, sample: &Sample) -> Option<Trip> {
        if sample.state == Some(DriveState::Fault) || sample.fault.is_some_and(|code| code != 0) {
            return Some(Trip::drive_fault(now_s, sample.fault, sample.fault_text.as_deref()));
        }
        if let Some(hindrance) = sample.hindrance {
            let kind = match hindrance {
                Hindrance::LocalControl => TripKind::LocalControl,
                Hindrance::TorqueOff => TripKind::TorqueOff,
            };
            return Some(Trip::new(kind, now_s, (0.0, 0.0), hindrance.sentence()));
        }
        let state = sample.state?;
        if state == DriveState::Running {
            self.counts.has_run = true;
            self.counts.not_running_since_s = None;
            return None;
        }
        let wanted_since_s = self.counts.on_since_s?;
        let (since_s, limit_s) = if self.counts.has_run {
            let since_s = *self.counts.not_running_since_s.get_or_insert(now_s);
            // The first reply with another state may be a status word of before, which is late by less than 50 ms; the second is not.
            (since_s, 0.05)
        } else {
            (wanted_since_s, self.enable_time_s)
        };
        let waited_s = now_s - since_s;
        (waited_s > limit_s).then(|| Trip::not_running(now_s, state, waited_s, limit_s))
    }

    fn lost_signal(&mut self, now_s: f64, sample: &Sample) -> Option<Trip> {
        for (index, channel) in WATCHED.into_iter().enumerate() {
            if !self.given[index] || !self.is_limited(channel) {
                continue;
            }
            let missing = &mut self.counts.missing[index];
            *missing = sample.get(channel).map_or(*missing + 1, |_| 0);
            let what = format!("no {}", channel.name());
            let trip = Self::too_often(TripKind::SignalMissing, now_s, *missing, &what);
            if trip.is_some() {
                return trip;
            }
        }
        None
    }

    const fn is_limited(&self, channel: Channel) -> bool {
        match channel {
            Channel::Angle => self.limits.travel_rad.is_some(),
            Channel::Bus => self.limits.bus_min_v.is_some() || self.limits.bus_max_v.is_some(),
            _ => true,
        }
    }

    /// Increments of the drive's and of the host's time since the last sample, and their allowed difference, s, where they
    /// differ by more.
    fn restart(&self, now_s: f64, sample: &Sample) -> Option<(f64, f64, f64)> {
        let last = self.last_sample?;
        let (drive_s, host_s) = (sample.time_s - last.sample_s, now_s - last.host_s);
        // Clocks that differ by more over two samples: the drive was off in between. One that was on all the time never runs back.
        let restart_s = 0.1;
        let most_s =
            if drive_s < 0.0 { restart_s } else { self.limits.link_silence_s.max(restart_s) };
        ((drive_s - host_s).abs() > most_s).then_some((drive_s, host_s, most_s))
    }

    /// Whether the drive's time began anew with this sample, or before: its clock is not to be used.
    pub fn is_of_a_restart(&self, now_s: f64, sample: &Sample) -> bool {
        let tripped = self.tripped().map(|trip| trip.kind);
        tripped == Some(TripKind::Restarted) || self.restart(now_s, sample).is_some()
    }

    /// A drive whose time jumps was off in between, and lost its commands. After a power-up its counter may be back or ahead.
    fn switched_on_again(&self, now_s: f64, sample: &Sample) -> Option<Trip> {
        let (drive_s, host_s, most_s) = self.restart(now_s, sample)?;
        let what = format!(
            "the drive's time went by {drive_s:.3} s while {host_s:.3} s passed here: it was switched off and on again"
        );
        Some(Trip::new(TripKind::Restarted, now_s, ((drive_s - host_s).abs(), most_s), what))
    }

    fn stuck_clock(&mut self, now_s: f64, drive_s: f64, advanced: bool) -> Option<Trip> {
        let stuck = &mut self.counts.stuck_clock;
        *stuck = if advanced { 0 } else { *stuck + 1 };
        let what = format!("drive time stays at {drive_s:.3} s");
        Self::too_often(TripKind::ClockStuck, now_s, *stuck, &what)
    }

    /// A condition in too many successive samples; `None`: not yet.
    fn too_often(kind: TripKind, now_s: f64, times: u32, what: &str) -> Option<Trip> {
        // One bad reply, or two, are of the line; three in a row are of the drive.
        let most = 2;
        let what = format!("{what} in {times} samples running, {most} allowed");
        (times > most).then(|| Trip::new(kind, now_s, (times.into(), most.into()), what))
    }
}

#[cfg(test)]
mod tests;
