//! The pulse of the first move: its size for a motor, the demand at each instant, and the samples.

use super::commanded;
use crate::limits::{Limits, Nameplate};
use drivebench_control::Actuator;
use drivebench_identify::belief::Plate;
use drivebench_model::sample::{Channel, Demand, Sample};

/// What holds a load at rest, in the unit of the quantity and as current.
pub(super) fn hold(kind: Actuator, nameplate: &Nameplate, limits: &Limits) -> (f64, f64) {
    let hold_a = limits.load.hold_a();
    let hold = match kind {
        Actuator::Voltage => nameplate.resistance_ohm * hold_a,
        Actuator::Current => hold_a,
        Actuator::Speed => 0.0,
    };
    (hold, hold_a)
}

/// The pulse of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Size {
    pub(super) kind: Actuator,
    /// Largest demand, in the unit of the quantity.
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
    pub(super) plate: Plate,
}

impl Size {
    /// `noise_rad_s`: standard deviation of the speed at rest.
    pub(super) fn of(
        nameplate: &Nameplate,
        limits: &Limits,
        zero: Demand,
        noise_rad_s: f64,
        period_s: f64,
    ) -> Self {
        let kind = commanded(zero);
        let plate = nameplate.plate();
        let ke = plate.back_emf_v_s_per_rad;
        // Current beyond the nameplate's friction.
        let share_a = 0.3 * nameplate.rated_current_a;
        let (hold, hold_a) = hold(kind, nameplate, limits);
        // Enough to overcome the friction, but not beyond the rated current.
        let goal_a = (nameplate.load_torque_n_m / ke + share_a)
            .min(nameplate.rated_current_a)
            .max(share_a)
            .min(0.5 * limits.current_a);
        // 3 % of the rated speed, and with a noisy sensor 8 standard deviations, but never above 10 %.
        let goal_rad_s = (0.03 * nameplate.rated_speed_rad_s)
            .max(8.0 * noise_rad_s)
            .min(0.1 * nameplate.rated_speed_rad_s)
            .min(0.5 * limits.speed_rad_s);
        let top = match kind {
            Actuator::Voltage => (2.0 * plate.steady_v(goal_a, goal_rad_s))
                .min(0.25 * nameplate.rated_voltage_v)
                .min(0.5 * limits.voltage_v),
            Actuator::Current => goal_a,
            Actuator::Speed => 2.0 * goal_rad_s,
        };
        let rise_s = (12.0 * period_s).max(0.6);
        // The inertia may be twice that of the nameplate, and the shaft may still turn the other way at first: four run-ups
        // beyond the rise, at most 5 s.
        let run_up_s = nameplate.inertia_kg_m2 * goal_rad_s / (ke * share_a);
        let wait_s = (4.0 * run_up_s).clamp(0.5 * rise_s, (0.5 * rise_s).max(5.0));
        Self {
            kind,
            top,
            rise_s,
            longest_s: rise_s + wait_s,
            period_s,
            goal_rad_s,
            goal_a,
            goal_rad: limits.travel_rad.map(|travel| 0.5 * travel),
            hold,
            hold_a,
            plate,
        }
    }

    /// Speed by the voltage equation, rad/s.
    pub(super) fn by_voltage_rad_s(&self, point: &Point) -> Option<f64> {
        Some(self.plate.steady_rad_s(point.voltage_v?, point.current_a?))
    }

    fn is_at_goal(&self, point: &Point) -> bool {
        point.speed_rad_s.is_some_and(|w| w.abs() >= self.goal_rad_s)
    }

    /// What a cycle adds to the demand while it rises.
    pub(super) fn step(&self) -> f64 {
        self.top * self.period_s / self.rise_s
    }

    /// The voltage equation gives twice the goal in this direction, and the encoder less than a tenth of it.
    fn is_encoder_frozen(&self, point: &Point, direction: f64) -> bool {
        let stands = |w: f64| w.abs() < 0.1 * self.goal_rad_s;
        let turns = |w: f64| w * direction > 2.0 * self.goal_rad_s;
        point.speed_rad_s.is_some_and(stands) && self.by_voltage_rad_s(point).is_some_and(turns)
    }
}

/// One instant of a pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) time_s: f64,
    /// Beyond what holds the load.
    pub(super) demand: f64,
    pub(super) voltage_v: Option<f64>,
    pub(super) current_a: Option<f64>,
    pub(super) speed_rad_s: Option<f64>,
    pub(super) angle_rad: Option<f64>,
    /// The first after a pause, of which the drive's output is not known: it is not evaluated.
    pub(super) is_after_pause: bool,
}

/// One direction of a pulse.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Leg {
    /// 1 or -1.
    pub(super) direction: f64,
    pub(super) points: Vec<Point>,
    /// Longest pause between two samples, s.
    pub(super) pause_s: Option<f64>,
    held_at: Option<f64>,
    /// Rises by a cycle with each reply and not during a pause, so that no step follows a pause.
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

    /// The demand `time_s` after the start; `None`: the pulse is over.
    pub(super) fn demand(&self, size: &Size, time_s: f64) -> Option<f64> {
        let arrives = |point: &Point| !point.is_after_pause && size.is_at_goal(point);
        let is_frozen = |point: &Point| size.is_encoder_frozen(point, self.direction);
        // Two samples: one may be a spike.
        let arrived = self
            .points
            .last_chunk::<2>()
            .is_some_and(|latest| latest.iter().all(arrives) || latest.iter().all(is_frozen));
        let first = self.points.first().and_then(|point| point.angle_rad);
        let last = self.points.last().and_then(|point| point.angle_rad);
        let travelled = first.zip(last).map_or(0.0, |(a, b)| (b - a).abs());
        let at_window = size.goal_rad.is_some_and(|goal| travelled >= goal);
        let waited = time_s > 2.0 * size.longest_s || self.risen_s > size.longest_s;
        if arrived || at_window || waited {
            return None;
        }
        let rising = size.top * (self.risen_s / size.rise_s).clamp(0.0, 1.0);
        Some(self.direction * self.held_at.map_or(rising, |held| held.min(rising)))
    }

    /// The last speed is more than three times its set-point, and beyond the goal.
    pub(super) fn misses_set_point(&self, size: &Size) -> bool {
        let is_far = |point: &Point| {
            let most_rad_s = (3.0 * point.demand.abs()).max(size.goal_rad_s);
            point.speed_rad_s.is_some_and(|w| w.abs() > most_rad_s)
        };
        size.kind == Actuator::Speed && self.points.last().is_some_and(is_far)
    }

    /// Takes the reply to `demand`; `sent`: the demand with the hold, within the limits of the guard.
    pub(super) fn push(&mut self, size: &Size, demand: f64, sent: Demand, sample: &Sample) {
        let current_a = sample.get(Channel::Current);
        let beyond_hold = current_a.map_or(0.0, |amps| (amps - size.hold_a).abs());
        if beyond_hold >= size.goal_a && self.held_at.is_none() {
            self.held_at = Some(demand.abs());
        }
        let since_s = self.last_s.map_or(0.0, |last_s| sample.time_s - last_s);
        // More than one lost reply.
        let pause_s = (since_s > 2.5 * size.period_s).then_some(since_s);
        self.pause_s = self.pause_s.into_iter().chain(pause_s).reduce(f64::max);
        self.last_s = Some(sample.time_s);
        let point = Point {
            time_s: sample.time_s,
            demand,
            voltage_v: sample.get(Channel::Voltage).or(sent.voltage_v()),
            current_a,
            speed_rad_s: sample.get(Channel::Speed),
            angle_rad: sample.get(Channel::Angle),
            is_after_pause: pause_s.is_some(),
        };
        // At the goal the demand is held until two samples confirm it.
        if !size.is_at_goal(&point) {
            self.risen_s += size.period_s;
        }
        self.points.push(point);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::near;

    fn size(zero: Demand) -> Size {
        Size::of(&Nameplate::zk_22fc(), &Limits::zk_22fc(), zero, 0.15, 0.01)
    }

    fn voltage_size() -> Size {
        size(Demand::Voltage(0.0))
    }

    fn reply(current_a: f64, speed_rad_s: f64) -> Sample {
        Sample::at(0.0).with(Channel::Current, current_a).with(Channel::Speed, speed_rad_s)
    }

    #[test]
    fn the_pulse_of_the_paper_motor_overcomes_its_friction() {
        let size = voltage_size();
        // 0.455 N.m of friction are 1.29 A, and 0.3 rated currents beyond it.
        near(size.goal_a, 3.0, 0.01);
        near(size.goal_rad_s, 8.796, 1e-9);
        near(size.top, 12.8, 0.1);
    }

    #[test]
    fn a_speed_far_from_its_set_point_is_no_overshoot() {
        let size = size(Demand::Speed(0.0));
        let mut leg = Leg::new(1.0);
        for (demand, speed, misses, what) in [
            (0.5, 4.0, false, "a jerk at the start"),
            (9.0, 14.0, false, "an overshoot"),
            (1.0, -20.0, true, "a wrong speed"),
        ] {
            leg.push(&size, demand, Demand::Speed(demand), &reply(3.0, speed));
            assert_eq!(leg.misses_set_point(&size), misses, "{what}");
        }
    }

    /// A reply at that time, s, to the demand of the pulse.
    fn follow(leg: &mut Leg, size: &Size, at_s: f64, current_a: f64, speed_rad_s: f64) -> f64 {
        let demand = leg.demand(size, at_s).unwrap();
        let mut reply = reply(current_a, speed_rad_s);
        reply.time_s = at_s;
        leg.push(size, demand, Demand::Voltage(demand), &reply);
        demand
    }

    #[test]
    fn the_pulse_rises_holds_and_ends_in_both_directions() {
        let size = voltage_size();
        let mut leg = Leg::new(-1.0);
        for cycle in 0..10 {
            let at_s = 0.01 * f64::from(cycle);
            near(follow(&mut leg, &size, at_s, 0.0, 0.0), -size.top * at_s / size.rise_s, 1e-9);
        }
        let early = follow(&mut leg, &size, 0.1, -3.1, 0.0);
        assert_eq!(leg.demand(&size, 0.5), Some(early), "no further");
        assert_eq!(leg.demand(&size, 2.0 * size.longest_s + 0.01), None);
        follow(&mut leg, &size, 0.11, -1.0, 9.0);
        assert!(leg.demand(&size, 0.5).is_some(), "one sample may be a spike");
        follow(&mut leg, &size, 0.12, -1.0, 9.0);
        assert_eq!(leg.demand(&size, 0.5), None);
    }

    #[test]
    fn no_step_follows_a_pause_of_the_host() {
        let size = voltage_size();
        let mut leg = Leg::new(1.0);
        for (cycle, at_s) in [0.0, 0.01, 0.21, 0.22, 0.42].into_iter().enumerate() {
            near(follow(&mut leg, &size, at_s, 0.5, 0.0), size.step() * cycle as f64, 1e-9);
        }
        near(leg.pause_s.unwrap(), 0.2, 1e-9);
        let marked: Vec<bool> = leg.points.iter().map(|p| p.is_after_pause).collect();
        assert_eq!(marked, [false, false, true, false, true]);
        // At the goal the demand stays, until two samples without a pause before them confirm it.
        let top = follow(&mut leg, &size, 0.43, 1.4, 9.0);
        for at_s in [0.63, 0.64, 0.65] {
            assert_eq!(Some(follow(&mut leg, &size, at_s, 1.4, 9.5)), Some(top), "{at_s} s");
        }
        assert_eq!(leg.demand(&size, 0.66), None);
    }

    #[test]
    fn the_sent_voltage_replaces_one_that_is_not_measured() {
        let size = voltage_size();
        let mut leg = Leg::new(1.0);
        for reply in [reply(1.0, 0.0), reply(1.0, 0.0).with(Channel::Voltage, 2.4)] {
            leg.push(&size, 4.0, Demand::Voltage(2.5), &reply);
        }
        let volts: Vec<_> = leg.points.iter().map(|point| point.voltage_v).collect();
        assert_eq!(volts, [Some(2.5), Some(2.4)]);
    }
}
