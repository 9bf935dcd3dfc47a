//! The first move: a small pulse one way and back, under the guard, and what was seen in it.

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
use drivebench_link::DriveProfile;
use drivebench_link::register_map::{Quantity, RegisterMap};
use drivebench_model::sample::{Channel, Demand, DriveState, Sample};

/// Speed limit of the pulse, in rated speeds, and its current limit in rated currents.
const SPEED_IN_RATED: f64 = 0.25;
const CURRENT_IN_RATED: f64 = 1.5;
/// Share of the bench's speed limit, and standard deviations at rest, within which the shaft counts as at rest afterwards.
const REST_SHARE: f64 = 0.01;
const REST_NOISE: f64 = 3.0;
/// Samples in a row that have to show it.
const REST_SAMPLES: u32 = 3;
/// Longest wait for rest, s.
const REST_S: f64 = 8.0;
/// Longest that a current is waited for at rest, s: it may have an offset.
const BRAKED_S: f64 = 2.0;

const DIRECTION: &str = "direction";

/// What the pulse is made for and judged by.
#[derive(Clone, Copy)]
pub struct FirstMove<'a> {
    pub plate: &'a Nameplate,
    pub profile: &'a DriveProfile,
    /// It is not made: only the checks before it are asked for.
    pub is_withheld: bool,
}

/// Why a pulse ended before its end.
enum Cut {
    Trip(Trip),
    /// The drive took a speed for quite another.
    Astray,
    /// Something moved before anything was asked.
    Moved(String),
    /// The drive does not answer, or a person wants to end.
    Ended(CheckError),
}

impl From<CheckError> for Cut {
    fn from(error: CheckError) -> Self {
        Self::Ended(error)
    }
}

impl Checker<'_> {
    pub(super) fn first_move(
        &mut self,
        limits: &Limits,
        options: CheckOptions<'_>,
    ) -> Result<bool, CheckError> {
        let Some(first) = options.first_move else {
            let text = "not tried: the motor is not known, and what finds it begins with steps that are as small";
            return Ok(self.note(DIRECTION, true, text.to_owned(), ""));
        };
        if first.is_withheld {
            let text = "not tried: only the checks before the first move were asked for";
            return Ok(self.note(DIRECTION, true, text, ""));
        }
        if options.waivers.direction {
            self.report.waived.push(PLAUSIBILITY);
            let text = "no pulse was made, so signs and nameplate are not proven".to_owned();
            return Ok(self.note_or_waive(DIRECTION, false, true, text, ""));
        }
        let identity = &self.report.identity;
        if !identity.is_emulator && !options.hardware_said {
            let text = "a small pulse would turn the shaft of real hardware".to_owned();
            return Ok(self.note(
                DIRECTION,
                false,
                text,
                "pass --hardware if the shaft may turn a little now, or --waive-direction",
            ));
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
        let zero = self.link.zero();
        let known = Known {
            plate: first.plate,
            size: Size::of(first.plate, limits, zero, speed.1, self.period_s),
            current: floor(noise, Channel::Current),
            speed,
            noise_v: floor(noise, Channel::Voltage).1,
            signed_current: has_signed_current(first.profile.registers.as_deref()),
            set_point: set_point(first.profile.registers.as_deref(), self.zero),
        };
        let still = self.still(limits);
        let one_way = limits.quadrants < 4;
        let mut mover = Mover::new(self, limits, known, still);
        let (legs, cut) = mover.whole(one_way);
        if let Some(Cut::Ended(error)) = cut {
            return Err(error);
        }
        let gives_speed = self.report.signals.contains(&Channel::Speed);
        let is_blind = |leg: &Leg| leg.points.iter().all(|point| point.speed_rad_s.is_none());
        let lost_speed = gives_speed && legs.iter().any(is_blind);
        let (figures, refusal) = judge::direction(&known, &legs);
        let (ratios, implausible) = judge::plausibility(&known, &legs);
        let way =
            if one_way { "one way, as the converter goes no other" } else { "one way and back" };
        let figures = format!("pulse {way}: {figures}");
        let (text, help) = match (cut, refusal) {
            (Some(Cut::Moved(text)), _) => {
                (format!("the shaft moved at zero reference: {text}"), AT_ZERO_HELP)
            }
            (Some(Cut::Astray), _) => {
                let why = judge::astray(&known, &legs).unwrap_or_default();
                let help = "the pulse was stopped at once: compare word_order, scale, unit and address of the set-point with the drive's manual";
                (format!("{why} ({figures})"), help)
            }
            (Some(Cut::Trip(trip)), _) => {
                let why = implausible.map_or_else(String::new, |(text, _)| format!("; {text}"));
                let help =
                    "the pulse was stopped at once: check limits, load and the drive's profile";
                (format!("{}{why} ({figures})", trip.reason), help)
            }
            (None, _) if lost_speed => (
                format!("the drive told its speed at rest, and none while it ran ({figures})"),
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

/// Whether the drive's current tells driving from braking.
fn has_signed_current(map: Option<&RegisterMap>) -> bool {
    map.and_then(|map| map.of_channel(Channel::Current))
        .is_none_or(drivebench_link::register_map::Signal::is_signed)
}

/// The set-point that carries what is commanded.
fn set_point(map: Option<&RegisterMap>, zero: Demand) -> Option<&str> {
    let quantity = match commanded(zero) {
        Actuator::Voltage => Quantity::Voltage,
        Actuator::Current => Quantity::Current,
        Actuator::Speed => Quantity::Speed,
    };
    Some(&map?.demand(quantity)?.name)
}

/// The pulse under way.
struct Mover<'c, 'a> {
    checker: &'c mut Checker<'a>,
    guard: Guard,
    known: Known<'c>,
    still: Still,
    brake: Option<Brake>,
    /// Mean of the speed at rest, and the most beside it, rad/s.
    rest: (f64, f64),
    next_s: f64,
    /// What left last.
    sent: Demand,
    /// For how long the computer had been suspended before.
    slept_s: f64,
}

impl<'c, 'a> Mover<'c, 'a> {
    fn new(checker: &'c mut Checker<'a>, limits: &Limits, known: Known<'c>, still: Still) -> Self {
        let Known { plate, size, .. } = known;
        let own = Limits {
            current_a: limits
                .current_a
                .min(CURRENT_IN_RATED * plate.rated_current_a + size.hold_a.abs()),
            speed_rad_s: limits.speed_rad_s.min(SPEED_IN_RATED * plate.rated_speed_rad_s),
            ..limits.clone()
        };
        let limit_a = checker.report.identity.current_limit_a;
        let (mean, std) = floor(&checker.report.noise, Channel::Speed);
        let share = (REST_SHARE * limits.speed_rad_s).min(0.5 * size.goal_rad_s);
        Self {
            guard: Guard::new(own, plate, limit_a)
                .with_period(checker.period_s)
                .with_enable_time(checker.times().enable_s),
            known,
            still,
            sent: checker.zero,
            brake: limits.load.brake(),
            rest: (mean, share.max(REST_NOISE * std)),
            next_s: checker.clock.now_s(),
            slept_s: checker.clock.slept_s(),
            checker,
        }
    }

    /// Each way of the pulse as far as it came, and why it was cut short.
    fn whole(&mut self, one_way: bool) -> (Vec<Leg>, Option<Cut>) {
        let mut legs = Vec::new();
        let result = self.all(one_way, &mut legs);
        if result.is_err() {
            // Whatever it was: zero output, and whoever asked for the checks makes sure of it.
            let _ = self.checker.exchange(Demand::Stop);
        }
        (legs, result.err())
    }

    fn all(&mut self, one_way: bool, legs: &mut Vec<Leg>) -> Result<(), Cut> {
        let sample = self.checker.answer(Demand::Disable)?;
        self.next_s = self.checker.clock.now_s();
        self.guard.begin(self.next_s, &sample);
        self.enable()?;
        if let Some(brake) = self.brake {
            self.hold_for(brake.release_s + self.rise_of_hold_s())?;
        }
        // Up before down, where something pulls.
        let up = if self.known.size.hold_a < 0.0 { -1.0 } else { 1.0 };
        let ways: &[f64] = if one_way { &[1.0] } else { &[up, -up] };
        self.there_and_back(ways, legs)?;
        let is_settled = |leg: &Leg| judge::is_settled(&self.known, leg);
        // The other way brings the shaft back: only so does it stay within its travel.
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
        let mut is_heard = false;
        let stands = |state| {
            is_heard = true;
            state != DriveState::Running
        };
        if self.checker.until(Demand::Disable, stands)? {
            return Ok(());
        }
        let waited_s = self.checker.times().stop_s;
        Err(Cut::Trip(Trip::unstopped(self.next_s, waited_s, is_heard)))
    }

    /// Output on with the torque that holds a load, under the guard from the first cycle on: the drive opens its brake
    /// when it runs.
    fn enable(&mut self) -> Result<(), Cut> {
        let enable_s = self.checker.times().enable_s;
        let until_s = self.next_s + enable_s;
        while self.next_s < until_s {
            let (sample, trip) = self.step(self.checker.zero)?;
            if let Some(text) = sample.as_ref().and_then(|sample| self.still.moved(sample)) {
                return Err(Cut::Moved(text));
            }
            if let Some(trip) = trip {
                return Err(Cut::Trip(trip));
            }
            if sample.is_some_and(|sample| sample.state == Some(DriveState::Running)) {
                return Ok(());
            }
        }
        let state = DriveState::Disabled;
        let trip = Trip::not_running(self.next_s, state, enable_s, enable_s);
        Err(Cut::Trip(trip))
    }

    /// Each of these ways from rest. A leg that is there already stays.
    fn there_and_back(&mut self, ways: &[f64], legs: &mut Vec<Leg>) -> Result<(), Cut> {
        let there: Vec<f64> = legs.iter().map(|leg| leg.direction).collect();
        for &direction in ways {
            // What is left of the way before must not pass for this one.
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

    fn one_way(&mut self, leg: &mut Leg) -> Result<(), Cut> {
        let begin_s = self.next_s;
        while let Some(asked) = leg.asked(&self.known.size, self.next_s - begin_s) {
            let demand = self.known.size.kind.demand(self.known.size.hold + asked);
            let (sample, trip) = self.step(demand)?;
            if let Some(sample) = &sample {
                leg.push(&self.known.size, asked, self.sent, sample);
            }
            if let Some(trip) = trip {
                return Err(Cut::Trip(trip));
            }
            if leg.is_astray(&self.known.size) {
                return Err(Cut::Astray);
            }
        }
        Ok(())
    }

    fn come_to_rest(&mut self) -> Result<(), Cut> {
        let begin_s = self.next_s;
        let mut rests = 0;
        while rests < REST_SAMPLES {
            let sample = self.hold()?;
            let speed = sample.as_ref().and_then(|s| s.get(Channel::Speed));
            let waited_s = self.next_s - begin_s;
            let brakes = waited_s < BRAKED_S && sample.as_ref().is_some_and(|s| self.brakes(s));
            // A lost reply shows no rest. Of a drive without a speed there is nothing to wait for but the time.
            rests = match (&sample, speed) {
                (None, _) => 0,
                (Some(_), Some(speed)) if (speed - self.rest.0).abs() > self.rest.1 => 0,
                _ if brakes => 0,
                _ => rests + 1,
            };
            if waited_s > REST_S {
                let speed = speed.unwrap_or(0.0);
                return Err(Cut::Trip(Trip::unrested(self.next_s, speed, waited_s)));
            }
        }
        Ok(())
    }

    /// The voltage that holds a load still brakes what is left of the speed: that current goes the next way, and would pass
    /// for the one of its pulse.
    fn brakes(&self, sample: &Sample) -> bool {
        let Known { size, current, .. } = self.known;
        let flows = |amps: f64| (amps - current.0 - size.hold_a).abs() > self.known.flowed_a();
        let turns = |speed: f64| (speed - self.rest.0).abs() > self.known.moved_rad_s();
        let is_left = sample.get(Channel::Current).is_some_and(flows)
            || sample.get(Channel::Speed).is_some_and(turns);
        size.kind == Actuator::Voltage && is_left
    }

    fn hold_for(&mut self, seconds: f64) -> Result<(), Cut> {
        let until_s = self.next_s + seconds;
        while self.next_s < until_s {
            self.hold()?;
        }
        Ok(())
    }

    /// Time in which the slew limit lets the holding torque rise, s.
    fn rise_of_hold_s(&self) -> f64 {
        self.known.size.hold.abs() / self.guard.limits().slew_v_per_s
    }

    fn hold(&mut self) -> Result<Option<Sample>, Cut> {
        match self.step(self.known.size.kind.demand(self.known.size.hold))? {
            (_, Some(trip)) => Err(Cut::Trip(trip)),
            (sample, None) => Ok(sample),
        }
    }

    /// One cycle under the guard. A lost reply is nothing but that, until the guard says otherwise.
    fn step(&mut self, wanted: Demand) -> Result<(Option<Sample>, Option<Trip>), Cut> {
        let clock = &mut self.checker.clock;
        let slept_s = clock.slept_s() - self.slept_s;
        if slept_s > SUSPENDED_S
            && let Some(trip) = self.guard.slept(clock.now_s(), slept_s)
        {
            return Err(Cut::Trip(trip.clone()));
        }
        self.next_s = (self.next_s + self.checker.period_s).max(clock.now_s());
        clock.sleep_until_s(self.next_s);
        let now_s = clock.now_s();
        // After a late cycle comes a whole one.
        self.next_s = self.next_s.max(now_s);
        if let Some(trip) = self.guard.tick(now_s) {
            return Err(Cut::Trip(trip.clone()));
        }
        self.sent = self.guard.shape(now_s, wanted).demand;
        let Some(sample) = self.checker.sample(self.sent)? else {
            return Ok((None, None));
        };
        let now_s = self.checker.clock.now_s();
        let trip = self.guard.watch(now_s, &sample, true).cloned();
        Ok((Some(sample), trip))
    }
}
