//! The first move: a small pulse one way and back, under the guard.

use super::judge::{self, Known};
use super::pulse::{Leg, Size};
use super::rest::{AT_ZERO_HELP, Still};
use super::{CheckError, CheckOptions, Checker, commanded, floor};
use crate::clock::SUSPENDED_S;
use crate::guard::Guard;
use crate::limits::{Limits, Nameplate};
use crate::mechanics::Brake;
use crate::plausibility::PLAUSIBILITY;
use crate::trip::Trip;
use drivebench_control::Actuator;
use drivebench_identify::belief::Settings;
use drivebench_link::DriveProfile;
use drivebench_link::register_map::{DeviceKind, Quantity, RegisterMap, Signal};
use drivebench_model::sample::{Channel, Demand, DriveState, Sample};

const DIRECTION: &str = "direction";

/// Motor and drive of the pulse.
#[derive(Clone, Copy)]
pub struct FirstMove<'a> {
    pub nameplate: &'a Nameplate,
    pub profile: &'a DriveProfile,
    /// No pulse is made: only the checks before it are wanted.
    pub is_withheld: bool,
}

/// Why a pulse was aborted.
enum Abort {
    Trip(Trip),
    /// The speed is far from its set-point.
    WrongSpeed,
    /// The shaft moved at zero reference.
    Moved(String),
    /// The link fails, or the user stops.
    Error(CheckError),
}

impl From<CheckError> for Abort {
    fn from(error: CheckError) -> Self {
        Self::Error(error)
    }
}

impl Checker<'_> {
    pub(super) fn first_move(
        &mut self,
        limits: &Limits,
        options: CheckOptions<'_>,
    ) -> Result<bool, CheckError> {
        let Some(first) = options.first_move else {
            let text = "not tried: the motor is not known, and the escalation begins with equally small steps";
            return Ok(self.note(DIRECTION, true, text, ""));
        };
        if first.is_withheld {
            let text = "not tried: only the checks before the first move are wanted";
            return Ok(self.note(DIRECTION, true, text, ""));
        }
        if options.waivers.direction {
            self.report.waived.push(PLAUSIBILITY);
            let text = "no pulse was made, so signs and nameplate are not proven".to_owned();
            return Ok(self.note_or_waive(DIRECTION, false, true, text, ""));
        }
        let identity = &self.report.identity;
        if !identity.is_emulator && !options.hardware_confirmed {
            let text = "a small pulse would turn the shaft of real hardware";
            let help = "pass --hardware if the shaft may turn a little now, or --waive-direction";
            return Ok(self.note(DIRECTION, false, text, help));
        }
        self.pulse(limits, options, first)
    }

    fn pulse(
        &mut self,
        limits: &Limits,
        options: CheckOptions<'_>,
        first: FirstMove<'_>,
    ) -> Result<bool, CheckError> {
        let noise = &self.report.noise;
        let speed = floor(noise, Channel::Speed);
        let map = first.profile.registers.as_deref();
        let current = map.and_then(|map| map.of_channel(Channel::Current));
        let known = Known {
            nameplate: first.nameplate,
            size: Size::of(first.nameplate, limits, self.link.zero(), speed.1, self.period_s),
            current: floor(noise, Channel::Current),
            speed,
            noise_v: floor(noise, Channel::Voltage).1,
            signed_current: current.is_none_or(Signal::is_signed),
            set_point: set_point(map, self.zero),
            is_field_oriented: map.is_some_and(|map| map.device.kind == DeviceKind::Bldc),
            by_flux_linkage: self.report.identity.motor.and_then(|stated| {
                stated.back_emf_v_s_per_rad.filter(|_| map.is_some_and(has_pole_pairs_in_both))
            }),
        };
        let still = self.still(limits);
        let one_way = limits.quadrants < 4;
        let (legs, abort) = PulseRun::new(self, limits, known, still).pulse(one_way);
        if let Some(Abort::Error(error)) = abort {
            return Err(error);
        }
        let gives_speed = self.report.signals.contains(&Channel::Speed);
        let has_no_speed = |leg: &Leg| leg.points.iter().all(|point| point.speed_rad_s.is_none());
        let lost_speed = gives_speed && legs.iter().any(has_no_speed);
        let (figures, refusal) = judge::direction(&known, &legs);
        let (ratios, implausible) = judge::plausibility(&known, &legs);
        let way = if one_way {
            "one way, as the converter has one direction"
        } else {
            "one way and back"
        };
        let figures = format!("pulse {way}: {figures}");
        let (text, help) = match (abort, refusal) {
            (Some(Abort::Moved(text)), _) => {
                (format!("the shaft moved at zero reference: {text}"), AT_ZERO_HELP)
            }
            (Some(Abort::WrongSpeed), _) => {
                let last = legs.last();
                let why = last.and_then(|leg| judge::wrong_speed(&known, leg)).unwrap_or_default();
                let help = "the pulse was stopped at once: compare word_order, scale, unit and address of the set-point with the drive's manual";
                (format!("{why} ({figures})"), help)
            }
            (Some(Abort::Trip(trip)), _) => {
                let why = implausible.map_or_else(String::new, |(text, _)| format!("; {text}"));
                let help =
                    "the pulse was stopped at once: check limits, load and the drive's profile";
                (format!("{}{why} ({figures})", trip.reason), help)
            }
            (None, _) if lost_speed => (
                format!("the drive reported a speed at rest, and none while it ran ({figures})"),
                "look at `invalid` and `valid` of the speed in the drive's profile, and at the encoder",
            ),
            (_, Some((reason, help))) => (format!("{reason} ({figures})"), help),
            (_, None) => {
                let passed = implausible.is_none();
                let (text, help) = implausible.unwrap_or((ratios, ""));
                let waived = options.waivers.plausibility;
                return Ok(self.note(DIRECTION, true, figures, "")
                    && self.note_or_waive(PLAUSIBILITY, passed, waived, text, help));
            }
        };
        Ok(self.note(DIRECTION, false, text, help))
    }
}

/// Speed and stored back-EMF constant are scaled by one signal, the one divided and the other multiplied.
fn has_pole_pairs_in_both(map: &RegisterMap) -> bool {
    let divides = |name: &String| {
        let speed = map.of_channel(Channel::Speed);
        speed.is_some_and(|speed| speed.numbers.scale_by.contains(&format!("/{name}")))
    };
    let constant = map.of_quantity(Quantity::MotorBackEmf);
    constant.is_some_and(|constant| constant.numbers.scale_by.iter().any(divides))
}

fn set_point(map: Option<&RegisterMap>, zero: Demand) -> Option<&str> {
    let quantity = match commanded(zero) {
        Actuator::Voltage => Quantity::Voltage,
        Actuator::Current => Quantity::Current,
        Actuator::Speed => Quantity::Speed,
    };
    Some(&map?.demand(quantity)?.name)
}

struct PulseRun<'c, 'a> {
    checker: &'c mut Checker<'a>,
    guard: Guard,
    known: Known<'c>,
    still: Still,
    brake: Option<Brake>,
    /// Mean of the speed at rest, and the largest deviation from it that counts as rest, rad/s.
    rest: (f64, f64),
    next_s: f64,
    sent: Demand,
    /// Time in suspension before the pulse, s.
    slept_s: f64,
}

impl<'c, 'a> PulseRun<'c, 'a> {
    fn new(checker: &'c mut Checker<'a>, limits: &Limits, known: Known<'c>, still: Still) -> Self {
        let Known { nameplate, size, .. } = known;
        let of_pulse = Limits {
            current_a: limits.current_a.min(1.5 * nameplate.rated_current_a + size.hold_a.abs()),
            speed_rad_s: limits.speed_rad_s.min(0.25 * nameplate.rated_speed_rad_s),
            ..limits.clone()
        };
        let limit_a = checker.report.identity.current_limit_a;
        let (mean, std) = floor(&checker.report.noise, Channel::Speed);
        let share = (Settings::REST * limits.speed_rad_s).min(0.5 * size.goal_rad_s);
        Self {
            guard: Guard::new(of_pulse, nameplate, limit_a)
                .with_period(checker.period_s)
                .with_enable_time(checker.times().enable_s),
            known,
            still,
            sent: checker.zero,
            brake: limits.load.brake(),
            rest: (mean, share.max(Settings::SIGMAS * std)),
            next_s: checker.clock.now_s(),
            slept_s: checker.clock.slept_s(),
            checker,
        }
    }

    /// Each direction as far as it came, and why the pulse was aborted.
    fn pulse(&mut self, one_way: bool) -> (Vec<Leg>, Option<Abort>) {
        let mut legs = Vec::new();
        let result = self.all(one_way, &mut legs);
        if result.is_err() {
            // The caller of the checks confirms the stop.
            let _ = self.checker.exchange(Demand::Stop);
        }
        (legs, result.err())
    }

    fn all(&mut self, one_way: bool, legs: &mut Vec<Leg>) -> Result<(), Abort> {
        let sample = self.checker.answer(Demand::Disable)?;
        self.next_s = self.checker.clock.now_s();
        self.guard.begin(self.next_s, &sample);
        self.enable()?;
        if let Some(brake) = self.brake {
            // The slew limit delays the holding torque.
            let rise_s = self.known.size.hold.abs() / self.guard.limits().slew_v_per_s;
            self.hold_for(brake.release_s + rise_s)?;
        }
        // A load is lifted before it is lowered.
        let up = if self.known.size.hold_a < 0.0 { -1.0 } else { 1.0 };
        let ways: &[f64] = if one_way { &[1.0] } else { &[up, -up] };
        self.there_and_back(ways, legs)?;
        let is_settled = |leg: &Leg| judge::is_settled(&self.known, leg);
        // One way only, a repetition would leave the travel limits.
        let may_repeat = !one_way || self.known.size.goal_rad.is_none();
        if may_repeat && !legs.iter().all(is_settled) {
            legs.retain(is_settled);
            self.there_and_back(ways, legs)?;
            let at = |leg: &Leg| ways.iter().position(|way| way * leg.direction > 0.0);
            legs.sort_by_key(at);
        }
        self.come_to_rest()?;
        if let Some(brake) = self.brake {
            self.hold_for(brake.apply_s)?;
        }
        let mut has_reported = false;
        let has_stopped = |state| {
            has_reported = true;
            state != DriveState::Running
        };
        if self.checker.until(Demand::Disable, has_stopped)? {
            return Ok(());
        }
        let waited_s = self.checker.times().stop_s;
        Err(Abort::Trip(Trip::unstopped(self.next_s, waited_s, has_reported)))
    }

    /// Output on with the torque that holds a load, under the guard from the first cycle on: the drive opens its brake
    /// when it runs.
    fn enable(&mut self) -> Result<(), Abort> {
        let enable_s = self.checker.times().enable_s;
        let until_s = self.next_s + enable_s;
        while self.next_s < until_s {
            let (sample, trip) = self.step(self.checker.zero)?;
            if let Some(text) = sample.as_ref().and_then(|sample| self.still.moved(sample)) {
                return Err(Abort::Moved(text));
            }
            if let Some(trip) = trip {
                return Err(Abort::Trip(trip));
            }
            if sample.is_some_and(|sample| sample.state == Some(DriveState::Running)) {
                return Ok(());
            }
        }
        Err(Abort::Trip(Trip::not_running(self.next_s, DriveState::Disabled, enable_s, enable_s)))
    }

    /// Each of these directions from rest; a leg that exists already is kept.
    fn there_and_back(&mut self, ways: &[f64], legs: &mut Vec<Leg>) -> Result<(), Abort> {
        let there: Vec<f64> = legs.iter().map(|leg| leg.direction).collect();
        for &direction in ways {
            self.come_to_rest()?;
            let mut leg = Leg::new(direction);
            let moved = self.one_way(&mut leg);
            if moved.is_err() || !there.contains(&direction) {
                legs.push(leg);
            }
            moved?;
        }
        Ok(())
    }

    fn one_way(&mut self, leg: &mut Leg) -> Result<(), Abort> {
        let size = self.known.size;
        let begin_s = self.next_s;
        while let Some(demand) = leg.demand(&size, self.next_s - begin_s) {
            let (sample, trip) = self.step(size.kind.demand(size.hold + demand))?;
            if let Some(sample) = &sample {
                leg.push(&size, demand, self.sent, sample);
            }
            if let Some(trip) = trip {
                return Err(Abort::Trip(trip));
            }
            if leg.misses_set_point(&size) {
                return Err(Abort::WrongSpeed);
            }
        }
        Ok(())
    }

    /// Three samples in a row at rest, within 8 s.
    fn come_to_rest(&mut self) -> Result<(), Abort> {
        let begin_s = self.next_s;
        let mut rests = 0;
        while rests < 3 {
            let sample = self.hold()?;
            let speed = sample.as_ref().and_then(|s| s.get(Channel::Speed));
            let waited_s = self.next_s - begin_s;
            // A current may have an offset, so it is waited for no longer than 2 s.
            let brakes = waited_s < 2.0 && sample.as_ref().is_some_and(|s| self.brakes(s));
            // A lost reply is no evidence of rest. Without a measured speed only the time counts.
            rests = match (&sample, speed) {
                (None, _) => 0,
                (Some(_), Some(speed)) if (speed - self.rest.0).abs() > self.rest.1 => 0,
                _ if brakes => 0,
                _ => rests + 1,
            };
            if waited_s > 8.0 {
                let speed = speed.unwrap_or(0.0);
                return Err(Abort::Trip(Trip::not_at_rest(self.next_s, speed, waited_s)));
            }
        }
        Ok(())
    }

    /// The holding voltage still brakes the shaft: that current flows in the direction of the next pulse, and would count as
    /// its own.
    fn brakes(&self, sample: &Sample) -> bool {
        let Known { size, current, .. } = self.known;
        let flows = |amps: f64| (amps - current.0 - size.hold_a).abs() > self.known.flowed_a();
        let turns = |speed: f64| (speed - self.rest.0).abs() > self.known.moved_rad_s();
        size.kind == Actuator::Voltage
            && (sample.get(Channel::Current).is_some_and(flows)
                || sample.get(Channel::Speed).is_some_and(turns))
    }

    fn hold_for(&mut self, seconds: f64) -> Result<(), Abort> {
        let until_s = self.next_s + seconds;
        while self.next_s < until_s {
            self.hold()?;
        }
        Ok(())
    }

    fn hold(&mut self) -> Result<Option<Sample>, Abort> {
        match self.step(self.known.size.kind.demand(self.known.size.hold))? {
            (_, Some(trip)) => Err(Abort::Trip(trip)),
            (sample, None) => Ok(sample),
        }
    }

    /// One cycle under the guard, which limits the silence after lost replies.
    fn step(&mut self, wanted: Demand) -> Result<(Option<Sample>, Option<Trip>), Abort> {
        let clock = &mut self.checker.clock;
        let slept_s = clock.slept_s() - self.slept_s;
        if slept_s > SUSPENDED_S
            && let Some(trip) = self.guard.slept(clock.now_s(), slept_s)
        {
            return Err(Abort::Trip(trip.clone()));
        }
        self.next_s = (self.next_s + self.checker.period_s).max(clock.now_s());
        clock.sleep_until_s(self.next_s);
        let now_s = clock.now_s();
        // A late cycle is followed by a whole one.
        self.next_s = self.next_s.max(now_s);
        if let Some(trip) = self.guard.tick(now_s) {
            return Err(Abort::Trip(trip.clone()));
        }
        self.sent = self.guard.shape(now_s, wanted).demand;
        let Some(sample) = self.checker.sample(self.sent)? else {
            return Ok((None, None));
        };
        let trip = self.guard.watch(self.checker.clock.now_s(), &sample, true).cloned();
        Ok((Some(sample), trip))
    }
}
