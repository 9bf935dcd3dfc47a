//! The pulse of the first move: how far it goes for a motor, what to ask at each instant, and what was measured.

use super::commanded;
use crate::limits::{Limits, Nameplate};
use drivebench_control::Actuator;
use drivebench_model::sample::{Channel, Demand, Sample};

/// A pulse ends with this share of the rated speed.
const SPEED_SHARE: f64 = 0.03;
/// Even with a noisy sensor it goes no further than this.
const SPEED_SHARE_MOST: f64 = 0.1;
/// What it may draw beyond the friction of the nameplate, in rated currents.
const CURRENT_SHARE: f64 = 0.3;
/// Share of the rated voltage that is never exceeded.
const VOLTAGE_SHARE: f64 = 0.25;
/// Share of the bench's own limits that is never exceeded.
const LIMIT_SHARE: f64 = 0.5;
/// Standard deviations of the speed at rest that the goal lies above at least.
const NOISE_FACTOR: f64 = 8.0;
/// Shortest rise, s, and cycles that it has at least.
const RISE_S: f64 = 0.6;
const RISE_CYCLES: f64 = 12.0;
/// Run-ups of the nameplate's inertia beyond the rise: it may be twice as heavy, and still turn the other way at first.
const RUN_UPS: f64 = 4.0;
/// Longest that a heavy shaft is given beyond the rise, s.
const LONGEST_WAIT_S: f64 = 5.0;
/// A speed by voltage and current of so many times the goal ends the pulse where the encoder shows nothing.
const UNSEEN_FACTOR: f64 = 2.0;
/// Share of the goal up to which an encoder shows nothing.
const SEEN_SHARE: f64 = 0.1;
/// A speed of so many times what is asked, and beyond the goal, is not what was asked.
const ASTRAY_FACTOR: f64 = 3.0;
/// Samples in a row that have to show the goal.
const SAMPLES_AT_GOAL: usize = 2;
/// One lost reply is none of it: samples further apart than so many cycles have a pause between them.
const PAUSE_CYCLES: f64 = 2.5;
/// A pulse of which the cycles come late, or not at all, ends after so many times its length.
const LATE_FACTOR: f64 = 2.0;

/// What holds a load at rest, in the unit of the quantity and as current.
pub(super) fn hold(kind: Actuator, plate: &Nameplate, limits: &Limits) -> (f64, f64) {
    let hold_a = limits.load.hold_a();
    let hold = match kind {
        Actuator::Voltage => plate.resistance_ohm * hold_a,
        Actuator::Current => hold_a,
        Actuator::Speed => 0.0,
    };
    (hold, hold_a)
}

/// The pulse of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Size {
    pub(super) kind: Actuator,
    /// Most that is asked, in the unit of the quantity.
    pub(super) top: f64,
    pub(super) rise_s: f64,
    pub(super) longest_s: f64,
    period_s: f64,
    pub(super) goal_rad_s: f64,
    /// At this current the demand rises no further.
    pub(super) goal_a: f64,
    /// Half the travel that the bench allows, rad.
    pub(super) goal_rad: Option<f64>,
    /// What holds a load at rest: in the unit of the quantity, and as current.
    pub(super) hold: f64,
    pub(super) hold_a: f64,
    /// Of the nameplate.
    resistance_ohm: f64,
    back_emf_v_s_per_rad: f64,
}

impl Size {
    /// `noise_rad_s`: of the speed at rest.
    pub(super) fn of(
        plate: &Nameplate,
        limits: &Limits,
        zero: Demand,
        noise_rad_s: f64,
        period_s: f64,
    ) -> Self {
        let kind = commanded(zero);
        let (r, ke) = (plate.resistance_ohm, plate.back_emf_v_s_per_rad);
        let share_a = CURRENT_SHARE * plate.rated_current_a;
        let (hold, hold_a) = hold(kind, plate, limits);
        // As far as it takes to overcome the friction, but not beyond the rated current.
        let goal_a = (plate.load_torque_n_m / ke + share_a)
            .min(plate.rated_current_a)
            .max(share_a)
            .min(LIMIT_SHARE * limits.current_a);
        let goal_rad_s = (SPEED_SHARE * plate.rated_speed_rad_s)
            .max(NOISE_FACTOR * noise_rad_s)
            .min(SPEED_SHARE_MOST * plate.rated_speed_rad_s)
            .min(LIMIT_SHARE * limits.speed_rad_s);
        let top = match kind {
            Actuator::Voltage => (2.0 * (r * goal_a + ke * goal_rad_s))
                .min(VOLTAGE_SHARE * plate.rated_voltage_v)
                .min(LIMIT_SHARE * limits.voltage_v),
            Actuator::Current => goal_a,
            Actuator::Speed => 2.0 * goal_rad_s,
        };
        let rise_s = RISE_S.max(RISE_CYCLES * period_s);
        let torque_n_m = ke * share_a;
        let run_up_s = plate.inertia_kg_m2 * goal_rad_s / torque_n_m;
        Self {
            kind,
            top,
            rise_s,
            longest_s: rise_s
                + (RUN_UPS * run_up_s).clamp(0.5 * rise_s, LONGEST_WAIT_S.max(0.5 * rise_s)),
            period_s,
            goal_rad_s,
            goal_a,
            goal_rad: limits.travel_rad.map(|travel| 0.5 * travel),
            hold,
            hold_a,
            resistance_ohm: r,
            back_emf_v_s_per_rad: ke,
        }
    }

    /// Speed by voltage and current, `(u - R i)/Ke`, rad/s.
    pub(super) fn by_voltage_rad_s(&self, point: &Point) -> Option<f64> {
        let emf_v = point.voltage_v? - self.resistance_ohm * point.current_a?;
        Some(emf_v / self.back_emf_v_s_per_rad)
    }

    fn is_at_goal(&self, point: &Point) -> bool {
        let at_goal = |w: f64| w.abs() >= self.goal_rad_s;
        point.speed_rad_s.is_some_and(at_goal)
    }

    /// What a cycle adds to the demand while it rises.
    pub(super) fn step(&self) -> f64 {
        self.top * self.period_s / self.rise_s
    }

    /// It turns in this direction by voltage and current, and the encoder does not see it.
    fn is_unseen(&self, point: &Point, direction: f64) -> bool {
        let stands = |w: f64| w.abs() < SEEN_SHARE * self.goal_rad_s;
        let turns = |w: f64| w * direction > UNSEEN_FACTOR * self.goal_rad_s;
        point.speed_rad_s.is_some_and(stands) && self.by_voltage_rad_s(point).is_some_and(turns)
    }
}

/// One instant of a pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// What was asked beyond what holds the load.
    pub(super) asked: f64,
    pub(super) voltage_v: Option<f64>,
    pub(super) current_a: Option<f64>,
    pub(super) speed_rad_s: Option<f64>,
    pub(super) angle_rad: Option<f64>,
    /// The first after a pause. What the drive did meanwhile is not known, so it is no measurement.
    pub(super) is_after_pause: bool,
}

/// One way of a pulse.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Leg {
    /// 1 or -1.
    pub(super) direction: f64,
    pub(super) points: Vec<Point>,
    /// Longest pause between two samples, s.
    pub(super) pause_s: Option<f64>,
    held_at: Option<f64>,
    /// How far the demand has risen: a cycle for each reply, and none for a pause, in which the drive goes on with what it
    /// has. So no pause is followed by a step.
    risen_s: f64,
    last_s: Option<f64>,
}

impl Leg {
    pub(super) const fn new(direction: f64) -> Self {
        Self {
            direction,
            points: Vec::new(),
            pause_s: None,
            held_at: None,
            risen_s: 0.0,
            last_s: None,
        }
    }

    /// What to ask `time_s` after its begin; `None`: it is over.
    pub(super) fn asked(&self, size: &Size, time_s: f64) -> Option<f64> {
        let arrives = |point: &Point| !point.is_after_pause && size.is_at_goal(point);
        let is_unseen = |point: &Point| size.is_unseen(point, self.direction);
        let latest = self.points.last_chunk::<SAMPLES_AT_GOAL>();
        let arrived =
            latest.is_some_and(|latest| latest.iter().all(arrives) || latest.iter().all(is_unseen));
        let first = self.points.first().and_then(|point| point.angle_rad);
        let last = self.points.last().and_then(|point| point.angle_rad);
        let travelled = first.zip(last).map_or(0.0, |(a, b)| (b - a).abs());
        let at_window = size.goal_rad.is_some_and(|goal| travelled >= goal);
        let waited = time_s > LATE_FACTOR * size.longest_s || self.risen_s > size.longest_s;
        if arrived || at_window || waited {
            return None;
        }
        let rising = size.top * (self.risen_s / size.rise_s).clamp(0.0, 1.0);
        Some(self.direction * self.held_at.map_or(rising, |held| held.min(rising)))
    }

    /// The drive was asked for a speed, and its last sample shows quite another.
    pub(super) fn is_astray(&self, size: &Size) -> bool {
        let is_far = |point: &Point| {
            let most_rad_s = (ASTRAY_FACTOR * point.asked.abs()).max(size.goal_rad_s);
            point.speed_rad_s.is_some_and(|w| w.abs() > most_rad_s)
        };
        size.kind == Actuator::Speed && self.points.last().is_some_and(is_far)
    }

    /// One reply to what was asked; `sent`: what the guard let through of it, with what holds the load.
    pub(super) fn push(&mut self, size: &Size, asked: f64, sent: Demand, sample: &Sample) {
        let current_a = sample.get(Channel::Current);
        let beyond_hold = current_a.map_or(0.0, |amps| (amps - size.hold_a).abs());
        if beyond_hold >= size.goal_a && self.held_at.is_none() {
            self.held_at = Some(asked.abs());
        }
        let since_s = self.last_s.map_or(0.0, |last_s| sample.time_s - last_s);
        let pause_s = (since_s > PAUSE_CYCLES * size.period_s).then_some(since_s);
        self.pause_s = self.pause_s.into_iter().chain(pause_s).reduce(f64::max);
        self.last_s = Some(sample.time_s);
        let point = Point {
            asked,
            voltage_v: sample.get(Channel::Voltage).or(sent.voltage_v()),
            current_a,
            speed_rad_s: sample.get(Channel::Speed),
            angle_rad: sample.get(Channel::Angle),
            is_after_pause: pause_s.is_some(),
        };
        // At the goal it waits for the samples that have to show it.
        if !size.is_at_goal(&point) {
            self.risen_s += size.period_s;
        }
        self.points.push(point);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(zero: Demand) -> Size {
        let plate = Nameplate::zk_22fc();
        Size::of(&plate, &Limits::for_motor(&plate, 100.0), zero, 0.15, 0.01)
    }

    fn reply(current_a: f64, speed_rad_s: f64) -> Sample {
        Sample::at(0.0).with(Channel::Current, current_a).with(Channel::Speed, speed_rad_s)
    }

    fn sent(volts: f64) -> Demand {
        Demand::Voltage(volts)
    }

    #[test]
    fn the_pulse_of_the_paper_motor_overcomes_its_friction() {
        let size = size(Demand::Voltage(0.0));
        // 0.455 N.m of friction are 1.29 A, and 0.3 rated currents beyond it.
        assert!((size.goal_a - 3.0).abs() < 0.01, "{size:?}");
        assert!((size.goal_rad_s - 8.796).abs() < 1e-9);
        assert!((size.top - 12.8).abs() < 0.1, "{size:?}");
    }

    #[test]
    fn a_speed_far_from_its_set_point_is_no_overshoot() {
        let size = size(Demand::Speed(0.0));
        let mut leg = Leg::new(1.0);
        leg.push(&size, 0.5, sent(0.5), &reply(3.0, 4.0));
        assert!(!leg.is_astray(&size), "a start may jerk");
        leg.push(&size, 9.0, sent(9.0), &reply(3.0, 14.0));
        assert!(!leg.is_astray(&size), "an overshoot");
        leg.push(&size, 1.0, sent(1.0), &reply(3.0, -20.0));
        assert!(leg.is_astray(&size));
    }

    /// A reply at that time, s, to what the pulse asks.
    fn follow(leg: &mut Leg, size: &Size, at_s: f64, current_a: f64, speed_rad_s: f64) -> f64 {
        let asked = leg.asked(size, at_s).unwrap();
        let mut reply = reply(current_a, speed_rad_s);
        reply.time_s = at_s;
        leg.push(size, asked, sent(asked), &reply);
        asked
    }

    #[test]
    fn the_pulse_rises_holds_and_ends_in_both_directions() {
        let size = size(Demand::Voltage(0.0));
        let mut leg = Leg::new(-1.0);
        for cycle in 0..10 {
            let at_s = 0.01 * f64::from(cycle);
            let asked = follow(&mut leg, &size, at_s, 0.0, 0.0);
            assert!((asked + size.top * at_s / size.rise_s).abs() < 1e-9);
        }
        let early = follow(&mut leg, &size, 0.1, -3.1, 0.0);
        assert_eq!(leg.asked(&size, 0.5), Some(early), "no further");
        let last_s = LATE_FACTOR * size.longest_s;
        assert_eq!(leg.asked(&size, last_s + 0.01), None);
        follow(&mut leg, &size, 0.11, -1.0, 9.0);
        assert!(leg.asked(&size, 0.5).is_some(), "one sample may be a spike");
        follow(&mut leg, &size, 0.12, -1.0, 9.0);
        assert_eq!(leg.asked(&size, 0.5), None);
    }

    #[test]
    fn no_step_follows_a_pause_of_the_host() {
        let size = size(Demand::Voltage(0.0));
        let mut leg = Leg::new(1.0);
        for (cycle, at_s) in [0.0, 0.01, 0.21, 0.22, 0.42].into_iter().enumerate() {
            let asked = follow(&mut leg, &size, at_s, 0.5, 0.0);
            assert!((asked - size.step() * cycle as f64).abs() < 1e-9, "{at_s}");
        }
        assert!((leg.pause_s.unwrap() - 0.2).abs() < 1e-9);
        let marked: Vec<bool> = leg.points.iter().map(|p| p.is_after_pause).collect();
        assert_eq!(marked, [false, false, true, false, true]);
        // At the goal the demand stays, until two samples without a pause before them have shown it.
        let top = follow(&mut leg, &size, 0.43, 1.4, 9.0);
        assert_eq!(leg.asked(&size, 0.44), Some(top));
        follow(&mut leg, &size, 0.63, 1.4, 9.5);
        assert_eq!(leg.asked(&size, 0.64), Some(top));
        follow(&mut leg, &size, 0.64, 1.4, 9.5);
        assert_eq!(leg.asked(&size, 0.65), Some(top));
        follow(&mut leg, &size, 0.65, 1.4, 9.5);
        assert_eq!(leg.asked(&size, 0.66), None);
    }

    #[test]
    fn without_a_measured_voltage_the_one_counts_that_left() {
        let size = size(Demand::Voltage(0.0));
        let mut leg = Leg::new(1.0);
        leg.push(&size, 4.0, sent(2.5), &reply(1.0, 0.0));
        let measured = reply(1.0, 0.0).with(Channel::Voltage, 2.4);
        leg.push(&size, 4.0, sent(2.5), &measured);
        let volts: Vec<_> = leg.points.iter().map(|point| point.voltage_v).collect();
        assert_eq!(volts, [Some(2.5), Some(2.4)]);
    }
}
