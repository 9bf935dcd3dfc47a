//! Feed-forward of what the model knows: the output that its effects cost at this speed and angle, given before the error
//! has to ask for it.
//!
//! `u_ff = (R/Kt) (T(w, theta) + T_f sgn(w)) + du(i)` with the effects' own terms at the reference speed, so that no noise
//! comes in; the angle is the measured one. Behind a current command it is the torque over Kt. Any controller can be
//! wrapped in it.

use super::{Actuator, Measured, SpeedController};
use crate::plant::{Enters, Instant, Model, MotorKey, ShaftAngle, Terms};

/// Speed at which the friction's full size is given, rad/s: at rest its sign is not known.
const SIGN_SPEED_RAD_S: f64 = 2.0;

/// Effects of a model in the actuator's unit.
pub struct FeedForward {
    terms: Vec<Box<dyn Terms>>,
    ids: Vec<&'static str>,
    motor: Instant,
    /// Coulomb torque that is given forward, N.m.
    friction_n_m: f64,
    /// Actuator's unit per torque.
    per_torque: f64,
    amperes_per_torque: f64,
    drops_voltage: bool,
}

impl FeedForward {
    /// Friction of the motor and those effects of the model that `wanted` names, or all that have terms where it is `None`.
    /// `None` where the model lacks a value of the motor, and behind a speed command: there the drive's own loop holds the
    /// speed. Effects with states of their own, or that lie on the path of the signals, cannot be given forward and are
    /// left out.
    pub fn new(model: &Model, actuator: Actuator, wanted: Option<&[&str]>) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let kt = model.motor.torque_constant()?;
        let per_torque = match actuator {
            Actuator::Voltage => value(MotorKey::Resistance)? / kt,
            Actuator::Current => 1.0 / kt,
            Actuator::Speed => return None,
        };
        let (mut terms, mut ids) = (Vec::new(), Vec::new());
        for active in &model.effects {
            let is_wanted = wanted.is_none_or(|wanted| wanted.contains(&active.id()));
            let own = active.effect.terms(&active.values_or_guess());
            let has_terms = active.effect.card().enters != Enters::Path && own.states() == 0;
            if is_wanted && has_terms {
                terms.push(own);
                ids.push(active.id());
            }
        }
        Some(Self {
            terms,
            ids,
            motor: Instant::of(&model.motor),
            friction_n_m: value(MotorKey::LoadTorque)?,
            per_torque,
            amperes_per_torque: 1.0 / kt,
            drops_voltage: actuator == Actuator::Voltage,
        })
    }

    /// Effects that are given forward, beside the Coulomb friction.
    pub fn effects(&self) -> &[&'static str] {
        &self.ids
    }

    /// The output for a speed and an angle.
    pub fn output(&self, speed_rad_s: f64, angle_rad: f64) -> f64 {
        let sign = (speed_rad_s / SIGN_SPEED_RAD_S).clamp(-1.0, 1.0);
        let mut at = Instant {
            speed_rad_s,
            angle: ShaftAngle::at(angle_rad),
            current_a: self.friction_n_m * sign * self.amperes_per_torque,
            ..self.motor
        };
        let torque_at = |at: &Instant| {
            let sums = self.terms.iter().map(|terms| terms.sums(at, &[]));
            sums.fold(self.friction_n_m * sign, |torque, sums| {
                torque + sums.torque_n_m + sums.friction_n_m * sign
            })
        };
        let torque_n_m = torque_at(&at);
        // The current that this torque takes is the one at which a voltage drop is counted.
        at.current_a = torque_n_m * self.amperes_per_torque;
        let drops = self.terms.iter().map(|terms| terms.voltage_v(&at, &[]));
        let drop_v: f64 = if self.drops_voltage { drops.sum() } else { 0.0 };
        let output = self.per_torque * torque_n_m + drop_v;
        if output.is_finite() { output } else { 0.0 }
    }
}

/// A controller with feed-forward beside it. What is given forward is not for the controller to hold.
pub struct Compensated {
    inner: Box<dyn SpeedController>,
    forward: FeedForward,
    given: f64,
}

impl Compensated {
    pub const fn new(inner: Box<dyn SpeedController>, forward: FeedForward) -> Self {
        Self {
            inner,
            forward,
            given: 0.0,
        }
    }
}

impl SpeedController for Compensated {
    fn id(&self) -> &'static str {
        self.inner.id()
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.given = self
            .forward
            .output(reference_rad_s, now.angle_rad.unwrap_or(0.0));
        self.given + self.inner.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        self.inner.applied(output - self.given);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.given = self
            .forward
            .output(now.speed_rad_s, now.angle_rad.unwrap_or(0.0));
        self.inner.reset(now, output - self.given);
    }

    fn explain(&self) -> Vec<String> {
        let mut lines = self.inner.explain();
        let effects = self.forward.effects();
        lines.push(if effects.is_empty() {
            "Coulomb friction is given forward".to_owned()
        } else {
            format!("Coulomb friction, {} are given forward", effects.join(", "))
        });
        lines
    }

    fn news(&mut self) -> Option<String> {
        self.inner.news()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::testing::assert_close;
    use crate::plant::Motor;

    fn model(id: &str, values: &[f64]) -> Model {
        let mut model = Model::baseline(Motor::zk_22fc()).with_effect(id).unwrap();
        model.effects[0].values = values.iter().copied().map(Some).collect();
        model
    }

    fn voltage(model: &Model, wanted: Option<&[&str]>) -> Option<FeedForward> {
        FeedForward::new(model, Actuator::Voltage, wanted)
    }

    #[test]
    fn friction_fan_and_drop_cost_what_their_equations_say() {
        let ohm_per_torque = 1.1 / 0.3538;
        let fan = voltage(&model("quadratic_load", &[2e-6]), None).unwrap();
        let expected = ohm_per_torque * (0.455 + 2e-6 * 200.0 * 200.0);
        assert_close(fan.output(200.0, 0.0), expected, 1e-9);
        assert_close(fan.output(-200.0, 0.0), -expected, 1e-9);
        let drop = voltage(&model("voltage_drop", &[1.5]), None).unwrap();
        assert_close(drop.output(200.0, 0.0), ohm_per_torque * 0.455 + 1.5, 0.02);
    }

    #[test]
    fn behind_a_current_it_is_the_torque_and_behind_a_speed_nothing() {
        let fan = model("quadratic_load", &[2e-6]);
        let amperes = FeedForward::new(&fan, Actuator::Current, None).unwrap();
        let expected = (0.455 + 2e-6 * 200.0 * 200.0) / 0.3538;
        assert_close(amperes.output(200.0, 0.0), expected, 1e-9);
        let drop = model("voltage_drop", &[1.5]);
        let amperes = FeedForward::new(&drop, Actuator::Current, None).unwrap();
        assert_close(amperes.output(200.0, 0.0), 0.455 / 0.3538, 1e-9);
        assert!(FeedForward::new(&fan, Actuator::Speed, None).is_none());
    }

    #[test]
    fn at_rest_nothing_is_given_and_what_was_not_asked_for_is_left_out() {
        let all = voltage(&model("quadratic_load", &[2e-6]), None).unwrap();
        assert_close(all.output(0.0, 1.0), 0.0, 1e-12);
        let none = voltage(&model("quadratic_load", &[2e-6]), Some(&[])).unwrap();
        assert!(none.effects().is_empty());
        assert_close(none.output(200.0, 0.0), 1.1 / 0.3538 * 0.455, 1e-9);
        let late = voltage(&model("speed_delay", &[0.002]), None).unwrap();
        assert!(late.effects().is_empty());
    }
}
