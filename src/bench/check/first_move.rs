//! The first move: a small pulse one way and back, under the guard, and what it says about signs and nameplate.

use super::direction::{self, Known};
use super::plausible;
use super::pulse::{Kind, Leg, Size};
use super::still::Still;
use super::watchdog::AT_ZERO_HELP;
use super::{CheckOptions, Checker, Reached};
use crate::bench::bench_file::Brake;
use crate::bench::clock::SUSPENDED_S;
use crate::bench::guard::{Guard, Trip};
use crate::bench::limits::{Limits, Nameplate};
use crate::bench::plausibility::PLAUSIBILITY;
use crate::drive::register_map::{Quantity, RegisterMap};
use crate::drive::{DriveProfile, LinkError};
use crate::sample::{Channel, Demand, DriveState, Sample};

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

const DIRECTION: &str = "direction";

/// What the pulse is made for and judged by.
#[derive(Clone, Copy)]
pub struct FirstMove<'a> {
    pub plate: &'a Nameplate,
    pub profile: &'a DriveProfile,
    /// Whether the user has asked to stop.
    pub stopped: &'a (dyn Fn() -> bool + Send + Sync),
}

/// Why a pulse ended before its end.
enum Cut {
    Trip(Trip),
    Stopped,
    /// The drive took a speed for quite another.
    Astray,
    /// Something moved before anything was asked.
    Moved(String),
    Lost(LinkError),
}

impl From<LinkError> for Cut {
    fn from(error: LinkError) -> Self {
        Self::Lost(error)
    }
}

impl Checker<'_> {
    pub(super) fn first_move(
        &mut self,
        limits: &Limits,
        options: CheckOptions<'_>,
    ) -> Result<bool, LinkError> {
        let Some(first) = options.first_move else {
            let text = "not tried: the motor is not known, and what finds it begins with steps that are as small";
            return Ok(self.note(DIRECTION, true, text.to_owned(), ""));
        };
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
    ) -> Result<bool, LinkError> {
        let floor = |channel| {
            let floors = &self.report.noise;
            let floor = floors.iter().find(|floor| floor.channel == channel);
            floor.map_or((0.0, 0.0), |floor| (floor.mean, floor.std))
        };
        let known = Known {
            plate: first.plate,
            size: Size::of(
                first.plate,
                limits,
                self.link.zero(),
                floor(Channel::Speed).1,
                self.period_s,
            ),
            current: floor(Channel::Current),
            speed: floor(Channel::Speed),
            signed_current: has_signed_current(first.profile.registers.as_deref()),
            set_point: commanded(first.profile.registers.as_deref(), self.zero),
        };
        let still = self.still(limits);
        let one_way = limits.quadrants < 4;
        let mut mover = Mover::new(self, limits, first, known.size, still);
        let (legs, cut) = mover.both_ways(one_way);
        if let Some(Cut::Lost(error)) = cut {
            return Err(error);
        }
        let gives_speed = self.report.signals.contains(&Channel::Speed);
        let lost_speed = legs
            .iter()
            .any(|leg| gives_speed && leg.points.iter().all(|p| p.speed_rad_s.is_none()));
        let (figures, refusal) = direction::judge(&known, &legs);
        let (ratios, implausible) = plausible::judge(&known, &legs);
        let way = if one_way {
            "one way, as the converter goes no other"
        } else {
            "one way and back"
        };
        let figures = format!("pulse {way}: {figures}");
        let waivers = options.waivers;
        match (cut, refusal) {
            (Some(Cut::Stopped), _) => Ok(self.note(
                DIRECTION,
                false,
                "stopped by the user".to_owned(),
                "start again when the shaft may turn",
            )),
            (Some(Cut::Moved(text)), _) => {
                let text = format!("the shaft moved at zero reference: {text}");
                Ok(self.note(DIRECTION, false, text, AT_ZERO_HELP))
            }
            (Some(Cut::Astray), _) => {
                let why = plausible::astray(&known, &legs).unwrap_or_default();
                Ok(self.note(
                    DIRECTION,
                    false,
                    format!("{why} ({figures})"),
                    "the pulse was stopped at once: compare word_order, scale, unit and address of the set-point with the drive's manual",
                ))
            }
            (Some(Cut::Trip(trip)), _) => {
                let why = implausible.map_or_else(String::new, |text| format!("; {text}"));
                let text = format!("{}{why} ({figures})", trip.reason);
                Ok(self.note(
                    DIRECTION,
                    false,
                    text,
                    "the pulse was stopped at once: check limits, load and the drive's profile",
                ))
            }
            (None, _) if lost_speed => {
                let text =
                    format!("the drive told its speed at rest, and none while it ran ({figures})");
                Ok(self.note(
                    DIRECTION,
                    false,
                    text,
                    "look at `invalid` and `valid` of the speed in the drive's profile, and at the encoder",
                ))
            }
            (_, Some((reason, help))) => {
                let text = format!("{reason} ({figures})");
                Ok(self.note(DIRECTION, false, text, help))
            }
            (_, None) => {
                let passed = implausible.is_none();
                let text = implausible.unwrap_or(ratios);
                Ok(self.note(DIRECTION, true, figures, "")
                    && self.note_or_waive(
                        PLAUSIBILITY,
                        passed,
                        waivers.plausibility,
                        text,
                        "correct [motor] or the units of the drive's profile; `--escalate` finds a motor whose nameplate is in doubt; --waive-plausibility goes on",
                    ))
            }
        }
    }
}

/// Whether the drive's current tells driving from braking.
fn has_signed_current(map: Option<&RegisterMap>) -> bool {
    map.and_then(|map| map.of_channel(Channel::Current))
        .is_none_or(crate::drive::register_map::Signal::is_signed)
}

/// The set-point that carries what is commanded.
fn commanded(map: Option<&RegisterMap>, zero: Demand) -> Option<&str> {
    let quantity = match Kind::of(zero) {
        Kind::Voltage => Quantity::Voltage,
        Kind::Current => Quantity::Current,
        Kind::Speed => Quantity::Speed,
    };
    Some(&map?.demand(quantity)?.name)
}

/// The pulse under way.
struct Mover<'c, 'a, 'f> {
    checker: &'c mut Checker<'a>,
    guard: Guard,
    size: Size,
    still: Still,
    brake: Option<Brake>,
    /// Mean of the speed at rest, and the most beside it, rad/s.
    rest: (f64, f64),
    first: FirstMove<'f>,
    next_s: f64,
    /// For how long the computer had been suspended before.
    slept_s: f64,
}

impl<'c, 'a, 'f> Mover<'c, 'a, 'f> {
    fn new(
        checker: &'c mut Checker<'a>,
        limits: &Limits,
        first: FirstMove<'f>,
        size: Size,
        still: Still,
    ) -> Self {
        let plate = first.plate;
        let own = Limits {
            current_a: limits
                .current_a
                .min(CURRENT_IN_RATED * plate.rated_current_a + size.hold_a.abs()),
            speed_rad_s: limits
                .speed_rad_s
                .min(SPEED_IN_RATED * plate.rated_speed_rad_s),
            ..limits.clone()
        };
        let limit_a = checker.report.identity.current_limit_a;
        let noise = &checker.report.noise;
        let floor = noise.iter().find(|floor| floor.channel == Channel::Speed);
        let (mean, std) = floor.map_or((0.0, 0.0), |floor| (floor.mean, floor.std));
        let share = (REST_SHARE * limits.speed_rad_s).min(0.5 * size.goal_rad_s);
        Self {
            guard: Guard::new(own, plate, limit_a)
                .with_period(checker.period_s)
                .with_enable_time(checker.times().enable_s),
            size,
            still,
            brake: limits.load.brake(),
            rest: (mean, share.max(REST_NOISE * std)),
            first,
            next_s: checker.clock.now_s(),
            slept_s: checker.clock.slept_s(),
            checker,
        }
    }

    /// Each way of the pulse as far as it came, and why it was cut short.
    fn both_ways(&mut self, one_way: bool) -> (Vec<Leg>, Option<Cut>) {
        let mut legs = Vec::new();
        let result = self.all(one_way, &mut legs);
        if result.is_err() {
            // Whatever it was: zero output, and whoever asked for the checks makes sure of it.
            let _ = self.checker.exchange(Demand::Stop);
        }
        (legs, result.err())
    }

    fn all(&mut self, one_way: bool, legs: &mut Vec<Leg>) -> Result<(), Cut> {
        // With the torque that holds a load from the first cycle on: the drive opens its brake when it runs.
        let zero = self.checker.zero;
        let runs = |state| state == DriveState::Running;
        match self.checker.until_still(zero, &mut self.still, runs)? {
            Reached::Yes => {}
            Reached::Never => return Err(Cut::Trip(self.never_runs())),
            Reached::Moved(text) => return Err(Cut::Moved(text)),
        }
        let sample = self.checker.answer(zero)?;
        self.next_s = self.checker.clock.now_s();
        self.guard.begin(self.next_s, &sample);
        self.guard.shape(self.next_s, zero);
        if let Some(brake) = self.brake {
            self.hold_for(brake.release_s + self.rise_of_hold_s())?;
        }
        // Up before down, where something pulls.
        let up = if self.size.hold_a < 0.0 { -1.0 } else { 1.0 };
        let ways: &[f64] = if one_way { &[1.0] } else { &[up, -up] };
        for &direction in ways {
            // What is left of the way before must not pass for this one.
            self.come_to_rest()?;
            legs.push(Leg::new(direction));
            self.one_way(legs)?;
        }
        self.come_to_rest()?;
        if let Some(brake) = self.brake {
            self.hold_for(brake.apply_s)?;
        }
        if !self
            .checker
            .until(Demand::Disable, |state| state != DriveState::Running)?
        {
            return Err(Cut::Trip(self.never_stops()));
        }
        Ok(())
    }

    fn one_way(&mut self, legs: &mut [Leg]) -> Result<(), Cut> {
        let Some(leg) = legs.last_mut() else {
            return Ok(());
        };
        let begin_s = self.next_s;
        while let Some(asked) = leg.asked(&self.size, self.next_s - begin_s) {
            let demand = self.size.kind.demand(self.size.hold + asked);
            let (sample, trip) = self.step(demand)?;
            if let Some(sample) = &sample {
                leg.push(&self.size, asked, sample);
            }
            if let Some(trip) = trip {
                return Err(Cut::Trip(trip));
            }
            if leg.is_astray(&self.size) {
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
            let speed = sample
                .as_ref()
                .and_then(|sample| sample.get(Channel::Speed));
            // A lost reply shows no rest. Of a drive without a speed there is nothing to wait for but the time.
            rests = match (&sample, speed) {
                (None, _) => 0,
                (Some(_), Some(speed)) if (speed - self.rest.0).abs() > self.rest.1 => 0,
                _ => rests + 1,
            };
            let waited_s = self.next_s - begin_s;
            if waited_s > REST_S {
                return Err(Cut::Trip(Trip::unrested(
                    self.next_s,
                    speed.unwrap_or(0.0),
                    waited_s,
                )));
            }
        }
        Ok(())
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
        self.size.hold.abs() / self.guard.limits().slew_v_per_s
    }

    fn hold(&mut self) -> Result<Option<Sample>, Cut> {
        match self.step(self.size.kind.demand(self.size.hold))? {
            (_, Some(trip)) => Err(Cut::Trip(trip)),
            (sample, None) => Ok(sample),
        }
    }

    /// One cycle under the guard. A lost reply is nothing but that, until the guard says otherwise.
    fn step(&mut self, wanted: Demand) -> Result<(Option<Sample>, Option<Trip>), Cut> {
        if (self.first.stopped)() {
            return Err(Cut::Stopped);
        }
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
        if let Some(trip) = self.guard.tick(now_s) {
            return Err(Cut::Trip(trip.clone()));
        }
        let shaped = self.guard.shape(now_s, wanted);
        match self.checker.exchange(shaped.demand) {
            Ok(sample) => {
                let now_s = self.checker.clock.now_s();
                let trip = self.guard.watch(now_s, &sample, true).cloned();
                Ok((Some(sample), trip))
            }
            Err(error) if error.is_transient() => Ok((None, None)),
            Err(error) => Err(Cut::Lost(error)),
        }
    }

    fn never_runs(&self) -> Trip {
        let patience_s = self.checker.times().enable_s;
        Trip::not_running(self.next_s, DriveState::Disabled, patience_s, patience_s)
    }

    fn never_stops(&self) -> Trip {
        let patience_s = self.checker.times().stop_s;
        Trip::unstopped(self.next_s, patience_s)
    }
}
