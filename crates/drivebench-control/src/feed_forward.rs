//! Feed-forward of what the model knows: the output that a planned motion costs at the instant at which the output acts.
//!
//! ```text
//! reference, known in advance --> plan (what the current limit carries) --> i* = (J dw/dt + T(w, theta) + T_f sgn(w))/Kt
//!                                   |                                        --> R (i + lead (i* - i)) + Ke w + du(i*)
//!                                   \--> the speed that this sample should show --> controller
//! ```
//!
//! An output acts a dead time after its sample, and the winding's current follows later still: the reference is read so far
//! ahead, and the angle is predicted as far. The effects' terms stand at planned speeds, so that no noise comes in. Behind
//! a current command it is the torque over Kt. A measured map takes the place of the model's friction or cogging wherever it
//! has a value. Any controller can be wrapped in it; one with a model of its own that would
//! take the planned acceleration for a load is given friction and effects only.

use std::collections::VecDeque;

use super::{Actuator, Adapted, LoopTiming, Measured, SpeedController};
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::{
    Balance, Instant, MappedTorque, Model, MotorKey, ShaftAngle, Terms, TorqueMap,
};

/// Least half width of the speeds about zero over which friction changes its sign, rad/s.
const SIGN_SPEED_RAD_S: f64 = 0.1;
/// Share of the current limit that the plan may take; the rest is the controller's.
const PLANNED_SHARE: f64 = 0.95;
/// Planned speeds that are kept, in periods.
const KEPT: usize = 160;

/// Effects of a model in the actuator's unit.
pub struct FeedForward {
    effects: Vec<Known>,
    maps: Vec<TorqueMap>,
    motor: Instant,
    /// Coulomb torque that is given forward, N.m.
    friction_n_m: f64,
    inertia_kg_m2: f64,
    amperes_per_torque: f64,
    actuator: Actuator,
    winding: Winding,
    /// Torque that may be planned, N.m.
    torque_limit_n_m: f64,
    period_s: f64,
    /// From the sample to the instant at which its output begins to act, s.
    acts_after_s: f64,
    /// Age of the speed that a sample shows, s.
    shown_late_s: f64,
}

/// An effect of which the model gives every value, and which the instant alone decides.
struct Known {
    id: &'static str,
    terms: Box<dyn Terms>,
    needs_angle: bool,
    /// The map that takes its place where that has a value.
    mapped: Option<MappedTorque>,
}

/// How the current follows an output, from one period to the next.
#[derive(Clone, Copy)]
struct Winding {
    /// Share of a difference that is left after a period.
    left: f64,
    /// What is given of a difference so that the current comes over it in time.
    lead: f64,
    /// From the begin of an output to the instant at which its current is the one that was asked for, s.
    ahead_s: f64,
}

impl Winding {
    /// A voltage that is held for a period drives the current to its goal at the end of it, and where the winding is slower
    /// than that, within its time constant.
    fn behind_voltage(time_constant_s: f64, period_s: f64) -> Self {
        let left_after = |time_s: f64| (-time_s / time_constant_s).exp();
        let left = left_after(period_s);
        let reached = 1.0 - left_after(period_s.max(time_constant_s));
        Self {
            left,
            lead: 1.0 / reached,
            // With it a current that rises evenly is followed without a lag.
            ahead_s: period_s * reached / (1.0 - left),
        }
    }

    /// The drive's own loop holds it: the mean over the period is the command.
    const fn behind_current(period_s: f64) -> Self {
        Self { left: 0.0, lead: 1.0, ahead_s: 0.5 * period_s }
    }
}

/// A planned motion at the instant at which an output has its effect.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    pub speed_rad_s: f64,
    pub acceleration_rad_s2: f64,
    /// Where it is measured.
    pub angle_rad: Option<f64>,
}

impl Motion {
    /// Without acceleration.
    pub const fn steady(speed_rad_s: f64, angle_rad: Option<f64>) -> Self {
        Self { speed_rad_s, acceleration_rad_s2: 0.0, angle_rad }
    }
}

impl FeedForward {
    /// Friction of the motor and those effects of the model that are known at every instant, an effect of the angle while
    /// one is measured. `None` where the model lacks a value of the motor, and behind a speed command: there the drive's
    /// own loop holds the speed. What has states of its own, depends on the time of a run or on its supply, lies on the
    /// path of the signals, or has no value yet, cannot be given forward and is left out. Of `maps` one of each torque.
    pub fn new(
        model: &Model,
        maps: &[TorqueMap],
        actuator: Actuator,
        timing: &LoopTiming,
        current_limit_a: f64,
    ) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let kt = model.motor.torque_constant()?;
        let winding = match actuator {
            Actuator::Voltage => {
                let electrical_s = value(MotorKey::Inductance)? / value(MotorKey::Resistance)?;
                Winding::behind_voltage(electrical_s, timing.period_s)
            }
            Actuator::Current => Winding::behind_current(timing.period_s),
            Actuator::Speed => return None,
        };
        let drops_voltage = actuator == Actuator::Voltage;
        let effects = model.effects.iter().filter_map(|active| {
            let card = active.effect.card();
            let costs = drops_voltage || card.enters.includes(Balance::Torque);
            Some(Known {
                id: active.id(),
                terms: active.terms_of_the_instant().filter(|_| costs)?,
                needs_angle: card.needs_angle,
                mapped: (maps.iter().map(|map| map.torque)).find(|torque| torque.holds(active)),
            })
        });
        let shown_late_s = model.known_path().speed_delay_s;
        Some(Self {
            effects: effects.collect(),
            maps: maps.to_vec(),
            motor: Instant::of(&model.motor),
            friction_n_m: value(MotorKey::LoadTorque)?,
            inertia_kg_m2: value(MotorKey::Inertia)?,
            amperes_per_torque: 1.0 / kt,
            actuator,
            winding,
            torque_limit_n_m: PLANNED_SHARE * current_limit_a * kt,
            period_s: timing.period_s,
            acts_after_s: (timing.delay_s - shown_late_s).max(0.0),
            shown_late_s: shown_late_s + timing.filter_s,
        })
    }

    /// What is given forward, in a sentence.
    fn sentence(&self, is_planned: bool) -> String {
        let while_measured =
            |needs_angle| ["", " while the drive gives its angle"][usize::from(needs_angle)];
        let name =
            |effect: &Known| format!(", {}{}", effect.id, while_measured(effect.needs_angle));
        let map = |map: &TorqueMap| {
            let (torque, known, bins) = (map.torque, map.known(), map.bins.len());
            let name = torque.name();
            let when = while_measured(torque == MappedTorque::Cogging);
            format!(", the measured {name} in {known} of {bins} bins{when}")
        };
        let names: String =
            (self.effects.iter().map(name)).chain(self.maps.iter().map(map)).collect();
        let motion = match (is_planned, self.actuator) {
            (false, _) => "",
            (true, Actuator::Voltage) => ", back-EMF and acceleration of the reference",
            (true, _) => ", acceleration of the reference",
        };
        let verb = if names.is_empty() && motion.is_empty() { "is" } else { "are" };
        let ahead_ms = 1e3 * self.ahead_s();
        format!(
            "Coulomb friction{names}{motion} {verb} given forward, {ahead_ms:.1} ms ahead of the sample"
        )
    }

    /// From a sample to the instant at which the current of its output is there, s.
    fn ahead_s(&self) -> f64 {
        self.acts_after_s + self.winding.ahead_s
    }

    /// The current that a motion takes, A, and the voltage that effects drop there.
    fn cost(&self, motion: &Motion) -> (f64, f64) {
        let Motion { speed_rad_s, acceleration_rad_s2, angle_rad } = *motion;
        // The mean over a period in which the speed passes zero.
        let turn_rad_s = 0.5 * self.period_s * acceleration_rad_s2.abs();
        let sign = (speed_rad_s / turn_rad_s.max(SIGN_SPEED_RAD_S)).clamp(-1.0, 1.0);
        let at = |current_a: f64| Instant {
            voltage_v: self.motor.resistance_ohm * current_a
                + self.motor.back_emf_v_s_per_rad * speed_rad_s,
            current_a,
            speed_rad_s,
            angle: ShaftAngle::at(angle_rad.unwrap_or(0.0)),
            ..self.motor
        };
        let mapped = |torque| {
            let map = self.maps.iter().find(|map| map.torque == torque)?;
            match torque {
                MappedTorque::Friction => Some(map.at(speed_rad_s)? * sign.abs()),
                MappedTorque::Cogging => map.at(angle_rad?),
            }
        };
        let friction_n_m = mapped(MappedTorque::Friction);
        let cogging_n_m = mapped(MappedTorque::Cogging);
        let given = || {
            let effects = self.effects.iter();
            effects.filter(|effect| {
                let is_in_a_map = match effect.mapped {
                    Some(MappedTorque::Friction) => friction_n_m.is_some(),
                    Some(MappedTorque::Cogging) => cogging_n_m.is_some(),
                    None => false,
                };
                !is_in_a_map && (angle_rad.is_some() || !effect.needs_angle)
            })
        };
        let motion_n_m = friction_n_m.unwrap_or(self.friction_n_m * sign)
            + cogging_n_m.unwrap_or(0.0)
            + self.inertia_kg_m2 * acceleration_rad_s2;
        let here = at(motion_n_m * self.amperes_per_torque);
        let sums = given().map(|effect| effect.terms.sums(&here, &[]));
        let torque_n_m = sums
            .fold(motion_n_m, |torque, sums| torque + sums.torque_n_m + sums.friction_n_m * sign);
        let current_a = torque_n_m * self.amperes_per_torque;
        // The current that this torque takes is the one at which a voltage drop is counted.
        let here = at(current_a);
        let drops = given().map(|effect| effect.terms.voltage_v(&here, &[]));
        let drop_v: f64 = match self.actuator {
            Actuator::Voltage => drops.sum(),
            _ => 0.0,
        };
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        (finite(current_a), finite(drop_v))
    }

    /// The output that holds a motion, without what the back-EMF takes.
    pub fn output(&self, motion: &Motion) -> f64 {
        let (current_a, drop_v) = self.cost(motion);
        self.in_unit(current_a) + drop_v
    }

    /// Output per current through the winding.
    fn in_unit(&self, current_a: f64) -> f64 {
        match self.actuator {
            Actuator::Voltage => self.motor.resistance_ohm * current_a,
            _ => current_a,
        }
    }

    /// The speed a period after `from`, on the way to `to`, as the current limit carries it.
    fn towards(&self, from: f64, to: f64) -> f64 {
        let (resisting_a, _) = self.cost(&Motion::steady(from, None));
        let resisting_n_m = resisting_a / self.amperes_per_torque;
        let gain = |torque_n_m: f64| self.period_s * torque_n_m / self.inertia_kg_m2;
        let up = gain(self.torque_limit_n_m - resisting_n_m).max(0.0);
        let down = gain(-self.torque_limit_n_m - resisting_n_m).min(0.0);
        from + (to - from).clamp(down, up)
    }
}

/// A controller with feed-forward beside it. What is given forward is not for the controller to hold.
pub struct Compensated {
    inner: Box<dyn SpeedController>,
    forward: FeedForward,
    /// The controller regulates about the plan, of which everything is given forward.
    is_planned: bool,
    /// The reference where the plan ends next, if it was foreseen.
    foreseen_rad_s: Option<f64>,
    /// Planned speeds, one a period, the furthest first; that one lies half a period beyond the current of this output.
    plan: VecDeque<f64>,
    given: f64,
    /// Share of it that accelerates.
    pushes: f64,
    wanted: f64,
    /// Current that what was given has driven when the next output begins, A.
    current_a: f64,
}

impl Compensated {
    pub fn new(mut inner: Box<dyn SpeedController>, forward: FeedForward) -> Self {
        let is_planned = inner.follow_plan();
        Self {
            inner,
            forward,
            is_planned,
            foreseen_rad_s: None,
            plan: VecDeque::from(vec![0.0]),
            given: 0.0,
            pushes: 0.0,
            wanted: 0.0,
            current_a: 0.0,
        }
    }

    /// The planned speed so long before the end of the plan.
    fn planned(&self, before_s: f64) -> f64 {
        let periods = before_s / self.forward.period_s;
        let last = self.plan.len() - 1;
        let at = |index: usize| self.plan[index.min(last)];
        let index = whole(periods.floor());
        at(index) + periods.fract() * (at(index + 1) - at(index))
    }

    /// From the end of the plan back to what a sample shows, s.
    fn shown_before_s(&self) -> f64 {
        let forward = &self.forward;
        forward.ahead_s() + 0.5 * forward.period_s + forward.shown_late_s
    }

    fn extend_plan(&mut self, reference_rad_s: f64) {
        let target = self.foreseen_rad_s.take().unwrap_or(reference_rad_s);
        let next =
            if self.is_planned { self.forward.towards(self.plan[0], target) } else { target };
        self.plan.truncate(KEPT);
        self.plan.push_front(next);
    }

    /// What is given forward in this cycle.
    fn give(&mut self, now: &Measured) {
        let forward = &self.forward;
        let speed_rad_s = 0.5 * (self.plan[0] + self.planned(forward.period_s));
        let gained = self.plan[0] - self.planned(forward.period_s);
        let ahead_s = forward.ahead_s() + forward.shown_late_s;
        let angle_rad = now.angle_rad.map(|angle| {
            // The measured speed at its begin, the planned one at its end.
            angle + 0.5 * ahead_s * (now.speed_rad_s + speed_rad_s)
        });
        let mut motion = Motion::steady(speed_rad_s, angle_rad);
        let mut back_emf_v = 0.0;
        let mut pushing_a = 0.0;
        if self.is_planned {
            motion.acceleration_rad_s2 = gained / forward.period_s;
            let torque_n_m = forward.inertia_kg_m2 * motion.acceleration_rad_s2;
            pushing_a = torque_n_m * forward.amperes_per_torque;
            if forward.actuator == Actuator::Voltage {
                // Half way through the period for which the output holds.
                let middle = self.planned(forward.winding.ahead_s);
                back_emf_v = forward.motor.back_emf_v_s_per_rad * middle;
            }
        }
        let (goal_a, drop_v) = forward.cost(&motion);
        let Winding { left, lead, .. } = forward.winding;
        let driving_a = self.current_a + lead * (goal_a - self.current_a);
        self.current_a = left * self.current_a + (1.0 - left) * driving_a;
        self.given = forward.in_unit(driving_a) + drop_v + back_emf_v;
        self.pushes = forward.in_unit(pushing_a);
    }
}

impl SpeedController for Compensated {
    fn id(&self) -> &'static str {
        self.inner.id()
    }

    fn foresee(&mut self, reference_rad_s: &dyn Fn(f64) -> f64) {
        self.foreseen_rad_s = Some(reference_rad_s(self.leads_s()));
    }

    fn leads_s(&self) -> f64 {
        self.forward.ahead_s() + 0.5 * self.forward.period_s
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.extend_plan(reference_rad_s);
        self.give(now);
        let reference =
            if self.is_planned { self.planned(self.shown_before_s()) } else { reference_rad_s };
        self.wanted = self.given + self.inner.step(reference, now, period_s);
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        let short = self.wanted - output;
        if self.plan.len() > 1 && self.is_planned && short * self.pushes > 0.0 {
            // A limit took of the push: the plan goes on from where what is left of it leads.
            let kept = (1.0 - short / self.pushes).max(0.0);
            self.plan[0] = self.plan[1] + kept * (self.plan[0] - self.plan[1]);
        }
        self.inner.beside(self.given);
        self.inner.applied(output - self.given);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.plan = VecDeque::from(vec![now.speed_rad_s]);
        self.foreseen_rad_s = None;
        let still = Motion::steady(now.speed_rad_s, now.angle_rad);
        self.current_a = self.forward.cost(&still).0;
        self.give(now);
        self.inner.reset(now, output - self.given);
    }

    fn explain(&self) -> Vec<String> {
        let mut lines = self.inner.explain();
        lines.push(self.forward.sentence(self.is_planned));
        lines
    }

    fn news(&mut self) -> Option<String> {
        self.inner.news()
    }

    fn adapted(&self) -> Option<Adapted> {
        self.inner.adapted()
    }

    fn softens(&self) -> bool {
        self.inner.softens()
    }

    fn soften(&mut self, share: f64, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) {
        let reference = if self.is_planned {
            // The plan goes on by a period before the step that this is for.
            self.planned((self.shown_before_s() - self.forward.period_s).max(0.0))
        } else {
            reference_rad_s
        };
        (self.inner).soften(share, reference, speed_rad_s, period_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_close;
    use crate::{
        AntiWindup, Course, CurrentLimit, Holding, Limiter, Pi, PiGains, TrialMachine, TrialPoint,
        trial,
    };
    use drivebench_model::plant::{MapBin, MappedValue, Motor};

    const TIMING: LoopTiming = LoopTiming { period_s: 0.01, delay_s: 0.02, filter_s: 0.0 };
    const LIMIT_A: f64 = 10.0;

    fn model(id: &str, values: &[f64]) -> Model {
        let mut model = Model::baseline(Motor::zk_22fc()).with_effect(id).unwrap();
        model.effects[0].values = values.iter().copied().map(Some).collect();
        model
    }

    fn forward(model: &Model, actuator: Actuator) -> FeedForward {
        FeedForward::new(model, &[], actuator, &TIMING, LIMIT_A).unwrap()
    }

    fn voltage(id: &str, values: &[f64]) -> FeedForward {
        forward(&model(id, values), Actuator::Voltage)
    }

    fn at(forward: &FeedForward, speed_rad_s: f64, angle_rad: Option<f64>) -> f64 {
        forward.output(&Motion::steady(speed_rad_s, angle_rad))
    }

    #[test]
    fn friction_fan_and_drop_cost_what_their_equations_say() {
        let ohm_per_torque = 1.1 / 0.3538;
        let fan = voltage("quadratic_load", &[2e-6]);
        let expected = ohm_per_torque * (0.455 + 2e-6 * 200.0 * 200.0);
        assert_close(at(&fan, 200.0, None), expected, 1e-9);
        assert_close(at(&fan, -200.0, None), -expected, 1e-9);
        let drop = voltage("voltage_drop", &[1.5]);
        assert_close(at(&drop, 200.0, None), ohm_per_torque * 0.455 + 1.5, 0.02);
    }

    #[test]
    fn an_acceleration_costs_the_torque_of_the_inertia_and_friction_turns_over_with_the_speed() {
        let plain = forward(&Model::baseline(Motor::zk_22fc()), Actuator::Current);
        let current_a = |speed_rad_s| {
            plain.output(&Motion { speed_rad_s, acceleration_rad_s2: 100.0, angle_rad: None })
        };
        assert_close(current_a(20.0), (0.455 + 0.45) / 0.3538, 1e-9);
        assert_close(current_a(-20.0), (0.45 - 0.455) / 0.3538, 1e-9);
        // Zero is passed in the middle of the period: as long one way as the other.
        assert_close(current_a(0.0), 0.45 / 0.3538, 1e-9);
        assert_close(current_a(0.25), (0.45 + 0.5 * 0.455) / 0.3538, 1e-9);
    }

    #[test]
    fn behind_a_current_it_is_the_torque_and_behind_a_speed_nothing() {
        let fan = model("quadratic_load", &[2e-6]);
        let amperes = forward(&fan, Actuator::Current);
        let expected = (0.455 + 2e-6 * 200.0 * 200.0) / 0.3538;
        assert_close(at(&amperes, 200.0, None), expected, 1e-9);
        let drop = model("voltage_drop", &[1.5]);
        let amperes = forward(&drop, Actuator::Current);
        assert_close(at(&amperes, 200.0, None), 0.455 / 0.3538, 1e-9);
        assert!(FeedForward::new(&fan, &[], Actuator::Speed, &TIMING, LIMIT_A).is_none());
    }

    #[test]
    fn at_rest_nothing_is_given() {
        let fan = voltage("quadratic_load", &[2e-6]);
        assert_close(at(&fan, 0.0, None), 0.0, 1e-12);
    }

    #[test]
    fn what_is_not_known_at_every_instant_is_neither_given_nor_said_to_be() {
        let friction = 1.1 / 0.3538 * 0.455;
        for (id, values) in [
            ("load_step", &[0.3, 1.0][..]),
            ("field_change", &[1e-3]),
            ("supply_sag", &[0.4]),
            ("inertia_change", &[1.0, 2.0]),
            ("inductance_saturation", &[0.01]),
            ("winding_heating", &[1e-4, 60.0]),
            ("speed_delay", &[0.002]),
        ] {
            let left_out = voltage(id, values);
            let said = left_out.sentence(false);
            assert!(said.starts_with("Coulomb friction is given forward, "), "{said}");
            assert_close(at(&left_out, 200.0, Some(1.0)), friction, 1e-9);
        }
        let mut unknown = model("quadratic_load", &[2e-6]);
        unknown.effects[0].values = vec![None];
        let left_out = forward(&unknown, Actuator::Voltage);
        assert_close(at(&left_out, 200.0, None), friction, 1e-9);
        let cogging = voltage("cogging", &[0.0, 0.1, 7.0]);
        assert!(cogging.sentence(false).contains("cogging while"));
        assert_close(at(&cogging, 200.0, None), friction, 1e-9);
        let wave = at(&cogging, 200.0, Some(0.0)) - friction;
        assert_close(wave.abs(), 1.1 / 0.3538 * 0.1, 1e-9);
    }

    /// 40 bins to 100 rad/s either way, or 72 of a turn, with these torques at their middles.
    fn map(torque: MappedTorque, value_n_m: impl Fn(f64) -> Option<f64>) -> TorqueMap {
        let (first, width, count) = match torque {
            MappedTorque::Friction => (-100.0, 5.0, 40),
            MappedTorque::Cogging => (0.0, std::f64::consts::TAU / 72.0, 72),
        };
        let bin = |index: u32| {
            let from = first + width * f64::from(index);
            let value = value_n_m(from + 0.5 * width);
            MapBin {
                from,
                to: from + width,
                windows: 9,
                torque: value.map(|torque_n_m| MappedValue {
                    torque_n_m,
                    low_n_m: torque_n_m,
                    high_n_m: torque_n_m,
                }),
            }
        };
        TorqueMap { torque, bins: (0..count).map(bin).collect() }
    }

    #[test]
    fn a_map_takes_the_place_of_what_it_measured_and_leaves_the_rest_to_the_model() {
        // Beyond 50 rad/s nothing was measured.
        let friction =
            |speed: f64| (speed.abs() < 50.0).then(|| 0.3 * speed.signum() + 0.002 * speed);
        let cogging = |angle: f64| Some(0.1 * (7.0 * angle).cos());
        let maps = [map(MappedTorque::Friction, friction), map(MappedTorque::Cogging, cogging)];
        let mut given = model("quadratic_load", &[2e-6]);
        let other = Model::baseline(Motor::zk_22fc()).with_effect("cogging").unwrap();
        given.effects.extend(other.effects);
        given.effects[1].values = vec![Some(0.0), Some(0.5), Some(3.0)];
        let forward = FeedForward::new(&given, &maps, Actuator::Current, &TIMING, LIMIT_A).unwrap();
        let torque = |speed, angle| 0.3538 * at(&forward, speed, angle);
        let own = |speed: f64| 0.3 * speed.signum() + 0.002 * speed;
        for speed in [-42.5, -7.5, 20.0, 33.0] {
            assert_close(torque(speed, None), own(speed), 1e-9);
        }
        let model_n_m = 0.455 + 2e-6 * 80.0 * 80.0;
        assert_close(torque(80.0, None), model_n_m, 1e-9);
        let middle = std::f64::consts::TAU * 10.5 / 72.0;
        let wave = cogging(middle).unwrap();
        assert_close(torque(20.0, Some(middle)), own(20.0) + wave, 1e-9);
        assert_close(torque(0.0, Some(middle)), wave, 1e-9);
        // Half way up the change of sign: half the friction of the slowest bin.
        assert_close(torque(0.05, None), 0.5 * own(2.5), 1e-9);
        let said = forward.sentence(false);
        assert!(said.contains("the measured friction in 20 of 40 bins"), "{said}");
    }

    /// Records what it is asked and gives nothing: what is fed forward is all that moves the motor.
    struct Still {
        plans: bool,
        asked: std::sync::Arc<std::sync::Mutex<Vec<f64>>>,
    }

    impl SpeedController for Still {
        fn id(&self) -> &'static str {
            "still"
        }
        fn follow_plan(&mut self) -> bool {
            self.plans
        }
        fn step(&mut self, reference_rad_s: f64, _: &Measured, _: f64) -> f64 {
            self.asked.lock().unwrap().push(reference_rad_s);
            0.0
        }
        fn applied(&mut self, _: f64) {}
        fn reset(&mut self, _: &Measured, _: f64) {}
        fn explain(&self) -> Vec<String> {
            Vec::new()
        }
    }

    /// The controller with its feed-forward in the loop of a trial, which foresees the reference.
    struct Foreseeing<'a> {
        inner: Compensated,
        reference_rad_s: &'a (dyn Fn(f64) -> f64 + Sync),
        time_s: f64,
    }

    impl SpeedController for Foreseeing<'_> {
        fn id(&self) -> &'static str {
            self.inner.id()
        }
        fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
            let (reference, time_s) = (self.reference_rad_s, self.time_s);
            self.inner.foresee(&|ahead_s| reference(time_s + ahead_s));
            self.time_s += period_s;
            self.inner.step(reference_rad_s, now, period_s)
        }
        fn applied(&mut self, output: f64) {
            self.inner.applied(output);
        }
        fn reset(&mut self, now: &Measured, output: f64) {
            self.inner.reset(now, output);
        }
        fn explain(&self) -> Vec<String> {
            self.inner.explain()
        }
    }

    /// The motor of the model behind a line whose delay is that of the timing.
    fn followed(
        inner: impl SpeedController + 'static,
        reference: &(dyn Fn(f64) -> f64 + Sync),
        cycles: usize,
    ) -> Vec<TrialPoint> {
        let machine = TrialMachine {
            resistance_ohm: 1.1,
            inductance_h: 0.0099,
            back_emf_v_s_per_rad: 0.3538,
            torque_n_m_per_a: 0.3538,
            friction_n_m: 0.455,
            viscous_n_m_s_per_rad: 0.0,
            coupling: None,
            drive_current_limit_a: 11.4,
            period_s: TIMING.period_s,
            delay_periods: 2,
            speed_noise_rad_s: 0.0,
            current_noise_a: 0.0,
        };
        let course =
            Course { reference_rad_s: reference, inertia_kg_m2: &|_| 0.0045, load_n_m: &|_| 0.0 };
        let limiter = Limiter {
            output: 110.0,
            current: Some(CurrentLimit {
                current_a: LIMIT_A,
                resistance_ohm: 1.1,
                back_emf_v_s_per_rad: 0.3538,
                ahead_s: TIMING.dead_time_s(),
            }),
        };
        let plain = forward(&Model::baseline(Motor::zk_22fc()), Actuator::Voltage);
        let mut controller = Foreseeing {
            inner: Compensated::new(Box::new(inner), plain),
            reference_rad_s: reference,
            time_s: 0.0,
        };
        trial(&machine, &course, &mut controller, &limiter, cycles, 1)
    }

    /// Up to 20 rad/s, back and forth between 20 and -20 in 0.4 s.
    fn reversals(time_s: f64) -> f64 {
        let phase = ((time_s - 0.2) / 0.4).rem_euclid(2.0);
        if time_s < 0.0 { 0.0 } else { 40.0 * (phase - 1.0).abs() - 20.0 }
    }

    fn rms(trace: &[TrialPoint]) -> f64 {
        let squares = trace.iter().map(|p| (p.reference_rad_s - p.speed_rad_s).powi(2));
        (squares.sum::<f64>() / trace.len() as f64).sqrt()
    }

    #[test]
    fn what_is_given_forward_alone_reverses_a_known_motor_without_lag_over_a_line_with_delay() {
        let asked = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
        let still = Still { plans: true, asked: asked.clone() };
        let trace = followed(still, &reversals, 200);
        // A speed that is 10 ms late would be 1 rad/s off.
        assert!(rms(&trace[40..]) < 0.6, "{}", rms(&trace[40..]));
        let asked = asked.lock().unwrap();
        let apart = trace[40..].iter().zip(&asked[40..]);
        let apart = apart.map(|(point, asked)| (point.speed_rad_s - asked).abs());
        assert!(apart.fold(0.0, f64::max) < 1.5);
    }

    #[test]
    fn a_step_beyond_the_current_limit_is_planned_within_it_and_does_not_overshoot() {
        let gains = PiGains {
            proportional: 0.4,
            integral_time_s: 0.05,
            reference_filter_s: 0.0,
            notch: None,
        };
        let pi = Pi::new(gains, AntiWindup::Hold, Holding::default());
        let step = |time_s: f64| if time_s < 0.5 { 0.0 } else { 100.0 };
        let trace = followed(pi, &step, 120);
        let most = trace.iter().map(|point| point.speed_rad_s).fold(0.0, f64::max);
        assert!(most < 104.0, "{most}");
        let settled = &trace[100..];
        assert!(rms(settled) < 0.5, "{}", rms(settled));
        assert!(trace.iter().all(|point| point.current_a.abs() < 11.0));
    }

    #[test]
    fn a_controller_with_a_model_of_its_own_keeps_its_reference_and_is_given_friction_only() {
        let asked = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
        let still = Still { plans: false, asked: asked.clone() };
        let plain = forward(&Model::baseline(Motor::zk_22fc()), Actuator::Voltage);
        let mut compensated = Compensated::new(Box::new(still), plain);
        let friction_v = 1.1 / 0.3538 * 0.455;
        let now = Measured::at(0.0);
        let mut output = 0.0;
        for n in 0..50_u32 {
            let reference = 20.0 + 0.1 * f64::from(n);
            output = compensated.step(reference, &now, 0.01);
            compensated.applied(output);
            assert_close(*asked.lock().unwrap().last().unwrap(), reference, 1e-12);
        }
        assert_close(output, friction_v, 1e-6);
    }
}
