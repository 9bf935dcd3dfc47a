//! Feed-forward of what the model knows: the output that its effects cost at this speed and angle, given before the error
//! has to ask for it.
//!
//! `u_ff = (R/Kt) (T(w, theta) + T_f sgn(w)) + du(i)` with the effects' own terms at the reference speed, so that no noise
//! comes in; the angle is the measured one. Behind a current command it is the torque over Kt. Any controller can be
//! wrapped in it.

use super::{Actuator, Adapted, Measured, SpeedController};
use crate::plant::{Balance, Instant, Model, MotorKey, ShaftAngle, Terms};

/// Speed at which the friction's full size is given, rad/s: at rest its sign is not known.
const SIGN_SPEED_RAD_S: f64 = 2.0;

/// Effects of a model in the actuator's unit.
pub struct FeedForward {
    effects: Vec<Known>,
    motor: Instant,
    /// Coulomb torque that is given forward, N.m.
    friction_n_m: f64,
    /// Actuator's unit per torque.
    per_torque: f64,
    amperes_per_torque: f64,
    drops_voltage: bool,
}

/// An effect of which the model gives every value, and which the instant alone decides.
struct Known {
    id: &'static str,
    terms: Box<dyn Terms>,
    needs_angle: bool,
}

impl FeedForward {
    /// Friction of the motor and those effects of the model that are known at every instant, an effect of the angle while
    /// one is measured. `None` where the model lacks a value of the motor, and behind a speed command: there the drive's
    /// own loop holds the speed. What has states of its own, depends on the time of a run or on its supply, lies on the
    /// path of the signals, or has no value yet, cannot be given forward and is left out.
    pub fn new(model: &Model, actuator: Actuator) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let kt = model.motor.torque_constant()?;
        let per_torque = match actuator {
            Actuator::Voltage => value(MotorKey::Resistance)? / kt,
            Actuator::Current => 1.0 / kt,
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
            })
        });
        Some(Self {
            effects: effects.collect(),
            motor: Instant::of(&model.motor),
            friction_n_m: value(MotorKey::LoadTorque)?,
            per_torque,
            amperes_per_torque: 1.0 / kt,
            drops_voltage,
        })
    }

    /// What is given forward, in a sentence.
    fn sentence(&self) -> String {
        let name = |effect: &Known| {
            let while_measured =
                ["", " while the drive gives its angle"][usize::from(effect.needs_angle)];
            format!(", {}{while_measured}", effect.id)
        };
        let names: String = self.effects.iter().map(name).collect();
        let verb = if names.is_empty() { "is" } else { "are" };
        format!("Coulomb friction{names} {verb} given forward")
    }

    /// The output for a speed and an angle, where one is measured.
    pub fn output(&self, speed_rad_s: f64, angle_rad: Option<f64>) -> f64 {
        let sign = (speed_rad_s / SIGN_SPEED_RAD_S).clamp(-1.0, 1.0);
        let at = |current_a: f64| Instant {
            voltage_v: self.motor.resistance_ohm * current_a
                + self.motor.back_emf_v_s_per_rad * speed_rad_s,
            current_a,
            speed_rad_s,
            angle: ShaftAngle::at(angle_rad.unwrap_or(0.0)),
            ..self.motor
        };
        let given = || {
            let effects = self.effects.iter();
            effects.filter(|effect| angle_rad.is_some() || !effect.needs_angle)
        };
        let friction_n_m = self.friction_n_m * sign;
        let here = at(friction_n_m * self.amperes_per_torque);
        let sums = given().map(|effect| effect.terms.sums(&here, &[]));
        let torque_n_m = sums.fold(friction_n_m, |torque, sums| {
            torque + sums.torque_n_m + sums.friction_n_m * sign
        });
        // The current that this torque takes is the one at which a voltage drop is counted.
        let here = at(torque_n_m * self.amperes_per_torque);
        let drops = given().map(|effect| effect.terms.voltage_v(&here, &[]));
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
        self.given = self.forward.output(reference_rad_s, now.angle_rad);
        self.given + self.inner.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        self.inner.applied(output - self.given);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.given = self.forward.output(now.speed_rad_s, now.angle_rad);
        self.inner.reset(now, output - self.given);
    }

    fn explain(&self) -> Vec<String> {
        let mut lines = self.inner.explain();
        lines.push(self.forward.sentence());
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
        (self.inner).soften(share, reference_rad_s, speed_rad_s, period_s);
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

    fn voltage(id: &str, values: &[f64]) -> FeedForward {
        FeedForward::new(&model(id, values), Actuator::Voltage).unwrap()
    }

    #[test]
    fn friction_fan_and_drop_cost_what_their_equations_say() {
        let ohm_per_torque = 1.1 / 0.3538;
        let fan = voltage("quadratic_load", &[2e-6]);
        let expected = ohm_per_torque * (0.455 + 2e-6 * 200.0 * 200.0);
        assert_close(fan.output(200.0, None), expected, 1e-9);
        assert_close(fan.output(-200.0, None), -expected, 1e-9);
        let drop = voltage("voltage_drop", &[1.5]);
        assert_close(drop.output(200.0, None), ohm_per_torque * 0.455 + 1.5, 0.02);
    }

    #[test]
    fn behind_a_current_it_is_the_torque_and_behind_a_speed_nothing() {
        let fan = model("quadratic_load", &[2e-6]);
        let amperes = FeedForward::new(&fan, Actuator::Current).unwrap();
        let expected = (0.455 + 2e-6 * 200.0 * 200.0) / 0.3538;
        assert_close(amperes.output(200.0, None), expected, 1e-9);
        let drop = model("voltage_drop", &[1.5]);
        let amperes = FeedForward::new(&drop, Actuator::Current).unwrap();
        assert_close(amperes.output(200.0, None), 0.455 / 0.3538, 1e-9);
        assert!(FeedForward::new(&fan, Actuator::Speed).is_none());
    }

    #[test]
    fn at_rest_nothing_is_given() {
        let fan = voltage("quadratic_load", &[2e-6]);
        assert_close(fan.output(0.0, None), 0.0, 1e-12);
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
            assert_eq!(left_out.sentence(), "Coulomb friction is given forward");
            assert_close(left_out.output(200.0, Some(1.0)), friction, 1e-9);
        }
        let mut unknown = model("quadratic_load", &[2e-6]);
        unknown.effects[0].values = vec![None];
        let left_out = FeedForward::new(&unknown, Actuator::Voltage).unwrap();
        assert_close(left_out.output(200.0, None), friction, 1e-9);
        let cogging = voltage("cogging", &[0.0, 0.1, 7.0]);
        assert!(cogging.sentence().contains("cogging while"));
        assert_close(cogging.output(200.0, None), friction, 1e-9);
        let wave = cogging.output(200.0, Some(0.0)) - friction;
        assert_close(wave.abs(), 1.1 / 0.3538 * 0.1, 1e-9);
    }
}
