//! Inverse-dynamics feed-forward with preview (computed torque; Tomizuka 1975 for the preview): the output of a planned
//! motion at the instant at which the output acts.
//!
//! ```text
//! reference, previewed --> plan (within the current limit) --> i* = (J dw/dt + T(w, theta) + T_f sgn(w))/Kt
//!                                   |                          --> R (i + lead (i* - i)) + Ke w + du(i*)
//!                                   \--> the planned speed at the age of this sample --> controller
//! ```
//!
//! An output acts a dead time after its sample, and the winding's current follows later still: the reference is previewed and
//! the angle predicted so far. The effects' terms are evaluated at planned speeds, which carry no noise. Behind a current
//! command the output is the torque over Kt. A measured map replaces the model's friction or cogging wherever it has a value.
//! Any controller can be wrapped; for one with a model of its own, which would take the planned acceleration for a load, only
//! friction and effects are fed forward.

use std::collections::VecDeque;

use super::{Actuator, Adapted, LoopTiming, Measured, NextStep, SpeedController};
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::{
    Balance, Instant, MappedTorque, Model, MotorKey, ShaftAngle, Terms, TorqueMap,
};

/// Effects of a model in the actuator's unit.
pub struct FeedForward {
    effects: Vec<MemorylessEffect>,
    maps: Vec<TorqueMap>,
    motor: Instant,
    friction_n_m: f64,
    inertia_kg_m2: f64,
    amperes_per_torque: f64,
    actuator: Actuator,
    winding: Winding,
    /// Of the plan, N.m: 95 % of the current limit; the rest is the controller's.
    torque_limit_n_m: f64,
    period_s: f64,
    /// From the sample to the instant at which its output begins to act, s.
    acts_after_s: f64,
    /// Age of the speed of a sample, s.
    measurement_age_s: f64,
}

/// A memoryless effect of which the model has every value.
struct MemorylessEffect {
    id: &'static str,
    terms: Box<dyn Terms>,
    needs_angle: bool,
    /// The map that replaces it where that has a value.
    mapped: Option<MappedTorque>,
}

/// First-order lag of the current behind an output, sampled, and its inverse.
#[derive(Clone, Copy)]
struct Winding {
    /// Share of a difference that remains after a period.
    decay: f64,
    /// Factor on a difference with which the current covers it in time.
    lead: f64,
    /// From the begin of an output to the instant at which its current is the planned one, s.
    ahead_s: f64,
}

impl Winding {
    /// A voltage that is held for a period drives the current to its goal at the end of it, or within the winding's time
    /// constant where that is longer.
    fn of_voltage(time_constant_s: f64, period_s: f64) -> Self {
        let decay_over = |time_s: f64| (-time_s / time_constant_s).exp();
        let decay = decay_over(period_s);
        let reached = 1.0 - decay_over(period_s.max(time_constant_s));
        // A ramp of the current is followed without a lag.
        Self { decay, lead: 1.0 / reached, ahead_s: period_s * reached / (1.0 - decay) }
    }
}

/// A planned motion at the instant at which an output has its effect.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    speed_rad_s: f64,
    acceleration_rad_s2: f64,
    /// Where it is measured.
    angle_rad: Option<f64>,
}

impl Motion {
    /// Without acceleration.
    const fn steady(speed_rad_s: f64, angle_rad: Option<f64>) -> Self {
        Self { speed_rad_s, acceleration_rad_s2: 0.0, angle_rad }
    }
}

impl FeedForward {
    /// Friction of the motor and the memoryless effects of the model, an effect of the angle while one is measured. `None`
    /// where the model lacks a value of the motor, and behind a speed command: there the drive's own loop holds the speed.
    /// An effect with states, with the time of a run or its supply as input, on the path of the signals, or without a value
    /// is left out. Of `maps` one of each torque.
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
                Winding::of_voltage(electrical_s, timing.period_s)
            }
            // Controlled by the drive: the mean over the period is the command.
            Actuator::Current => Winding { decay: 0.0, lead: 1.0, ahead_s: 0.5 * timing.period_s },
            Actuator::Speed => return None,
        };
        let drops_voltage = actuator == Actuator::Voltage;
        let effects = model.effects.iter().filter_map(|active| {
            let card = active.effect.card();
            let has_output = drops_voltage || card.enters.includes(Balance::Torque);
            Some(MemorylessEffect {
                id: active.id(),
                terms: active.terms_of_the_instant().filter(|_| has_output)?,
                needs_angle: card.needs_angle,
                mapped: (maps.iter().map(|map| map.torque)).find(|torque| torque.holds(active)),
            })
        });
        let speed_delay_s = model.known_path().speed_delay_s;
        Some(Self {
            effects: effects.collect(),
            maps: maps.to_vec(),
            motor: Instant::of(&model.motor),
            friction_n_m: value(MotorKey::LoadTorque)?,
            inertia_kg_m2: value(MotorKey::Inertia)?,
            amperes_per_torque: 1.0 / kt,
            actuator,
            winding,
            torque_limit_n_m: 0.95 * current_limit_a * kt,
            period_s: timing.period_s,
            acts_after_s: (timing.delay_s - speed_delay_s).max(0.0),
            measurement_age_s: speed_delay_s + timing.filter_s,
        })
    }

    fn sentence(&self, is_planned: bool) -> String {
        let while_measured =
            |needs_angle| ["", " while the drive gives its angle"][usize::from(needs_angle)];
        let name = |effect: &MemorylessEffect| {
            format!(", {}{}", effect.id, while_measured(effect.needs_angle))
        };
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
            "Coulomb friction{names}{motion} {verb} fed forward, {ahead_ms:.1} ms ahead of the sample"
        )
    }

    /// From a sample to the instant at which the current of its output has come, s.
    fn ahead_s(&self) -> f64 {
        self.acts_after_s + self.winding.ahead_s
    }

    /// Current of a motion, A, and the voltage that effects drop there.
    fn requirement(&self, motion: &Motion) -> (f64, f64) {
        let Motion { speed_rad_s, acceleration_rad_s2, angle_rad } = *motion;
        // The mean over a period in which the speed passes zero.
        let turn_rad_s = 0.5 * self.period_s * acceleration_rad_s2.abs();
        let sign = (speed_rad_s / turn_rad_s.max(0.1)).clamp(-1.0, 1.0);
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
        let active = || {
            self.effects.iter().filter(|effect| {
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
        let instant = at(motion_n_m * self.amperes_per_torque);
        let torque_n_m = active()
            .map(|effect| effect.terms.sums(&instant, &[]))
            .fold(motion_n_m, |torque, sums| torque + sums.torque_n_m + sums.friction_n_m * sign);
        let current_a = torque_n_m * self.amperes_per_torque;
        let instant = at(current_a);
        let drop_v: f64 = match self.actuator {
            Actuator::Voltage => active().map(|effect| effect.terms.voltage_v(&instant, &[])).sum(),
            _ => 0.0,
        };
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        (finite(current_a), finite(drop_v))
    }

    /// Output per current through the winding.
    fn in_unit(&self, current_a: f64) -> f64 {
        match self.actuator {
            Actuator::Voltage => self.motor.resistance_ohm * current_a,
            _ => current_a,
        }
    }

    /// The speed a period after `from` on the way to `to`, within the current limit.
    fn next_speed(&self, from: f64, to: f64) -> f64 {
        let (resisting_a, _) = self.requirement(&Motion::steady(from, None));
        let resisting_n_m = resisting_a / self.amperes_per_torque;
        let gain = |torque_n_m: f64| self.period_s * torque_n_m / self.inertia_kg_m2;
        let up = gain(self.torque_limit_n_m - resisting_n_m).max(0.0);
        from + (to - from).clamp(gain(-self.torque_limit_n_m - resisting_n_m).min(0.0), up)
    }
}

pub struct Compensated {
    inner: Box<dyn SpeedController>,
    forward: FeedForward,
    /// The controller regulates about the plan, all of which is fed forward.
    is_planned: bool,
    /// The reference at the next end of the plan, where it is previewed.
    previewed_rad_s: Option<f64>,
    /// Planned speeds, one a period, the latest first, half a period after the current of this output.
    plan: VecDeque<f64>,
    forward_output: f64,
    /// Its part that accelerates.
    accelerating: f64,
    wanted: f64,
    /// Current by the feed-forward when the next output begins, A.
    current_a: f64,
}

impl Compensated {
    pub fn new(mut inner: Box<dyn SpeedController>, forward: FeedForward) -> Self {
        let is_planned = inner.follow_plan();
        Self {
            inner,
            forward,
            is_planned,
            previewed_rad_s: None,
            plan: VecDeque::from(vec![0.0]),
            forward_output: 0.0,
            accelerating: 0.0,
            wanted: 0.0,
            current_a: 0.0,
        }
    }

    /// The planned speed so long before the latest.
    fn planned(&self, before_s: f64) -> f64 {
        let periods = before_s / self.forward.period_s;
        let last = self.plan.len() - 1;
        let at = |index: usize| self.plan[index.min(last)];
        let index = whole(periods.floor());
        at(index) + periods.fract() * (at(index + 1) - at(index))
    }

    /// From the speed of a sample to the latest planned one, s.
    fn plan_ahead_s(&self) -> f64 {
        let forward = &self.forward;
        forward.ahead_s() + 0.5 * forward.period_s + forward.measurement_age_s
    }

    fn extend_plan(&mut self, reference_rad_s: f64) {
        let target = self.previewed_rad_s.take().unwrap_or(reference_rad_s);
        let next =
            if self.is_planned { self.forward.next_speed(self.plan[0], target) } else { target };
        self.plan.truncate(160);
        self.plan.push_front(next);
    }

    fn evaluate(&mut self, now: &Measured) {
        let forward = &self.forward;
        let speed_rad_s = 0.5 * (self.plan[0] + self.planned(forward.period_s));
        let speed_change = self.plan[0] - self.planned(forward.period_s);
        let ahead_s = forward.ahead_s() + forward.measurement_age_s;
        // From the measured speed to the planned one.
        let angle_rad =
            now.angle_rad.map(|angle| angle + 0.5 * ahead_s * (now.speed_rad_s + speed_rad_s));
        let mut motion = Motion::steady(speed_rad_s, angle_rad);
        let (mut back_emf_v, mut accelerating_a) = (0.0, 0.0);
        if self.is_planned {
            motion.acceleration_rad_s2 = speed_change / forward.period_s;
            let torque_n_m = forward.inertia_kg_m2 * motion.acceleration_rad_s2;
            accelerating_a = torque_n_m * forward.amperes_per_torque;
            if forward.actuator == Actuator::Voltage {
                // In the middle of the period for which the output holds.
                let middle = self.planned(forward.winding.ahead_s);
                back_emf_v = forward.motor.back_emf_v_s_per_rad * middle;
            }
        }
        let (goal_a, drop_v) = forward.requirement(&motion);
        let Winding { decay, lead, .. } = forward.winding;
        let driving_a = self.current_a + lead * (goal_a - self.current_a);
        self.current_a = decay * self.current_a + (1.0 - decay) * driving_a;
        self.forward_output = forward.in_unit(driving_a) + drop_v + back_emf_v;
        self.accelerating = forward.in_unit(accelerating_a);
    }
}

impl SpeedController for Compensated {
    fn preview(&mut self, reference_rad_s: &dyn Fn(f64) -> f64) {
        self.previewed_rad_s = Some(reference_rad_s(self.preview_s()));
    }

    fn preview_s(&self) -> f64 {
        self.forward.ahead_s() + 0.5 * self.forward.period_s
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.extend_plan(reference_rad_s);
        self.evaluate(now);
        let reference =
            if self.is_planned { self.planned(self.plan_ahead_s()) } else { reference_rad_s };
        self.wanted = self.forward_output + self.inner.step(reference, now, period_s);
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        let short = self.wanted - output;
        if self.plan.len() > 1 && self.is_planned && short * self.accelerating > 0.0 {
            // A limit reduced the acceleration: the plan goes on from the speed that is reached.
            let kept = (1.0 - short / self.accelerating).max(0.0);
            self.plan[0] = self.plan[1] + kept * (self.plan[0] - self.plan[1]);
        }
        self.inner.fed_forward(self.forward_output);
        self.inner.applied(output - self.forward_output);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.plan = VecDeque::from(vec![now.speed_rad_s]);
        self.previewed_rad_s = None;
        self.current_a =
            self.forward.requirement(&Motion::steady(now.speed_rad_s, now.angle_rad)).0;
        self.evaluate(now);
        self.inner.reset(now, output - self.forward_output);
    }

    fn explain(&self) -> Vec<String> {
        let mut lines = self.inner.explain();
        lines.push(self.forward.sentence(self.is_planned));
        lines
    }

    fn gain_change(&mut self) -> Option<String> {
        self.inner.gain_change()
    }

    fn adapted(&self) -> Option<Adapted> {
        self.inner.adapted()
    }

    fn can_reduce_gain(&self) -> bool {
        self.inner.can_reduce_gain()
    }

    fn set_gain_share(&mut self, share: f64, mut next: NextStep) {
        if self.is_planned {
            // The plan is extended by a period before that step.
            let ahead_s = (self.plan_ahead_s() - self.forward.period_s).max(0.0);
            next.reference_rad_s = self.planned(ahead_s);
        }
        self.inner.set_gain_share(share, next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Fixed, assert_close, limiter, machine, pi_gains, with};
    use crate::{AntiWindup, Holding, Pi, Trial, TrialPoint};
    use drivebench_model::plant::{MapBin, MappedValue, Motor};

    const TIMING: LoopTiming = LoopTiming { period_s: 0.01, delay_s: 0.02, filter_s: 0.0 };

    fn plain() -> Model {
        Model::baseline(Motor::zk_22fc())
    }

    fn model(id: &str, values: &[f64]) -> Model {
        with(&plain(), id, values)
    }

    fn forward(model: &Model, actuator: Actuator) -> FeedForward {
        FeedForward::new(model, &[], actuator, &TIMING, 10.0).unwrap()
    }

    fn voltage(id: &str, values: &[f64]) -> FeedForward {
        forward(&model(id, values), Actuator::Voltage)
    }

    fn output(forward: &FeedForward, motion: &Motion) -> f64 {
        let (current_a, drop_v) = forward.requirement(motion);
        forward.in_unit(current_a) + drop_v
    }

    fn at(forward: &FeedForward, speed_rad_s: f64, angle_rad: Option<f64>) -> f64 {
        output(forward, &Motion::steady(speed_rad_s, angle_rad))
    }

    #[test]
    fn effects_need_the_output_of_their_equations() {
        use Actuator::{Current, Voltage};
        let ohm_per_torque = 1.1 / 0.3538;
        let fan_n_m = 0.455 + 2e-6 * 200.0 * 200.0;
        let fan = ("quadratic_load", 2e-6);
        let drop = ("voltage_drop", 1.5);
        for ((id, value), actuator, speed, expected, tolerance) in [
            (fan, Voltage, 200.0, ohm_per_torque * fan_n_m, 1e-9),
            (fan, Voltage, -200.0, -ohm_per_torque * fan_n_m, 1e-9),
            (fan, Voltage, 0.0, 0.0, 1e-12),
            (drop, Voltage, 200.0, ohm_per_torque * 0.455 + 1.5, 0.02),
            // Behind a current command the torque over Kt, and no voltage.
            (fan, Current, 200.0, fan_n_m / 0.3538, 1e-9),
            (drop, Current, 200.0, 0.455 / 0.3538, 1e-9),
        ] {
            let forward = forward(&model(id, &[value]), actuator);
            assert_close(at(&forward, speed, None), expected, tolerance);
        }
        let of_speed =
            FeedForward::new(&model(fan.0, &[fan.1]), &[], Actuator::Speed, &TIMING, 10.0);
        assert!(of_speed.is_none());
    }

    #[test]
    fn acceleration_needs_torque_and_friction_reverses() {
        let plain = forward(&plain(), Actuator::Current);
        // Zero is passed in the middle of the period: as long one way as the other.
        for (speed_rad_s, friction) in [(20.0, 1.0), (-20.0, -1.0), (0.0, 0.0), (0.25, 0.5)] {
            let motion = Motion { speed_rad_s, acceleration_rad_s2: 100.0, angle_rad: None };
            assert_close(output(&plain, &motion), (0.45 + friction * 0.455) / 0.3538, 1e-9);
        }
    }

    #[test]
    fn effects_with_states_or_without_values_are_left_out() {
        let friction = 1.1 / 0.3538 * 0.455;
        for (id, values) in [
            ("load_step", &[0.3, 1.0][..]),
            ("field_change", &[1e-3]),
            ("supply_sag", &[0.4]),
            ("inertia_change", &[1.0, 2.0]),
            ("inductance_saturation", &[0.01]),
            ("winding_heating", &[1e-4, 60.0]),
            ("lagged_load", &[2e-6, 0.3]),
            ("speed_delay", &[0.002]),
        ] {
            let left_out = voltage(id, values);
            let sentence = left_out.sentence(false);
            assert!(sentence.starts_with("Coulomb friction is fed forward, "), "{sentence}");
            assert_close(at(&left_out, 200.0, Some(1.0)), friction, 1e-9);
        }
        let mut unknown = model("quadratic_load", &[2e-6]);
        unknown.effects[0].values = vec![None];
        assert_close(at(&forward(&unknown, Actuator::Voltage), 200.0, None), friction, 1e-9);
        let cogging = voltage("cogging", &[0.0, 0.1, 7.0]);
        assert!(cogging.sentence(false).contains("cogging while"));
        assert_close(at(&cogging, 200.0, None), friction, 1e-9);
        assert_close((at(&cogging, 200.0, Some(0.0)) - friction).abs(), 1.1 / 0.3538 * 0.1, 1e-9);
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
    fn a_map_replaces_the_model_where_it_has_a_value() {
        // Beyond 50 rad/s nothing was measured.
        let friction =
            |speed: f64| (speed.abs() < 50.0).then(|| 0.3 * speed.signum() + 0.002 * speed);
        let cogging = |angle: f64| Some(0.1 * (7.0 * angle).cos());
        let maps = [map(MappedTorque::Friction, friction), map(MappedTorque::Cogging, cogging)];
        let mapped = with(&model("quadratic_load", &[2e-6]), "cogging", &[0.0, 0.5, 3.0]);
        let forward = FeedForward::new(&mapped, &maps, Actuator::Current, &TIMING, 10.0).unwrap();
        let torque = |speed, angle| 0.3538 * at(&forward, speed, angle);
        let measured = |speed: f64| 0.3 * speed.signum() + 0.002 * speed;
        for speed in [-42.5, -7.5, 20.0, 33.0] {
            assert_close(torque(speed, None), measured(speed), 1e-9);
        }
        assert_close(torque(80.0, None), 0.455 + 2e-6 * 80.0 * 80.0, 1e-9);
        let middle = std::f64::consts::TAU * 10.5 / 72.0;
        let wave = cogging(middle).unwrap();
        assert_close(torque(20.0, Some(middle)), measured(20.0) + wave, 1e-9);
        assert_close(torque(0.0, Some(middle)), wave, 1e-9);
        // Half way up the change of sign: half the friction of the slowest bin.
        assert_close(torque(0.05, None), 0.5 * measured(2.5), 1e-9);
        let sentence = forward.sentence(false);
        assert!(sentence.contains("the measured friction in 20 of 40 bins"), "{sentence}");
    }

    /// The motor of the model behind a line whose delay is that of the timing.
    fn followed(
        inner: impl SpeedController + 'static,
        reference: impl Fn(f64) -> f64,
        seconds: f64,
    ) -> Vec<TrialPoint> {
        let mut controller =
            Compensated::new(Box::new(inner), forward(&plain(), Actuator::Voltage));
        let trial = Trial::new(machine(0.0), limiter(&TIMING), 0.0045, reference);
        trial.run(&mut controller, seconds)
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
    fn feed_forward_alone_reverses_a_known_motor_without_lag() {
        let alone = Fixed { follows_plan: true, ..Fixed::default() };
        let references = alone.references.clone();
        let trace = followed(alone, reversals, 2.0);
        // A speed that is 10 ms late would be 1 rad/s off.
        assert!(rms(&trace[40..]) < 0.6, "{}", rms(&trace[40..]));
        let references = references.lock().unwrap();
        let apart = trace[40..].iter().zip(&references[40..]);
        let apart = apart.map(|(point, planned)| (point.speed_rad_s - planned).abs());
        assert!(apart.fold(0.0, f64::max) < 1.5);
    }

    #[test]
    fn a_step_beyond_the_current_limit_is_planned_within_it() {
        let pi = Pi::new(pi_gains(0.4, 0.05), AntiWindup::Hold, Holding::default());
        let trace = followed(pi, |time_s| if time_s < 0.5 { 0.0 } else { 100.0 }, 1.2);
        let most = trace.iter().map(|point| point.speed_rad_s).fold(0.0, f64::max);
        assert!(most < 104.0, "{most}");
        assert!(rms(&trace[100..]) < 0.5, "{}", rms(&trace[100..]));
        assert!(trace.iter().all(|point| point.current_a.abs() < 11.0));
    }

    #[test]
    fn a_controller_that_follows_no_plan_keeps_its_reference() {
        let alone = Fixed::default();
        let references = alone.references.clone();
        let mut compensated =
            Compensated::new(Box::new(alone), forward(&plain(), Actuator::Voltage));
        let mut output = 0.0;
        for n in 0..50_u32 {
            let reference = 20.0 + 0.1 * f64::from(n);
            output = compensated.step(reference, &Measured::at(0.0), 0.01);
            compensated.applied(output);
            assert_close(*references.lock().unwrap().last().unwrap(), reference, 1e-12);
        }
        // Friction only, no acceleration and no back-EMF.
        assert_close(output, 1.1 / 0.3538 * 0.455, 1e-6);
    }
}
