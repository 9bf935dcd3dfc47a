//! Typical size of an effect that matters in a run: start and unit of the steps of a fit.

use super::effect::{Effect, Instant, ShaftAngle};
use super::model::Model;
use super::motor::MotorKey;
use super::scenario::{Input, Scenario};
use crate::numerics::statistics::largest;

/// The size of one coefficient at which the effect reaches three per cent of the largest voltage (torque) of the run, because
/// the friction of a milliwatt motor and of a mill differ by many decades. A shape parameter has that of its card.
pub fn typical_size(
    effect: &dyn Effect,
    parameter: usize,
    model: &Model,
    scenario: &Scenario,
) -> f64 {
    let specs = effect.parameters();
    if !specs[parameter].is_coefficient() {
        return specs[parameter].in_run(&scenario.scales).guess;
    }
    let values = specs.iter().enumerate().map(|(index, spec)| {
        // At its scale an effect is nearly proportional to its size. The guess of a coefficient is its scale.
        let is_other = spec.is_coefficient() && index != parameter;
        if is_other { 0.0 } else { spec.in_run(&scenario.scales).guess }
    });
    let terms = effect.terms(&values.collect::<Vec<f64>>());
    let times = &scenario.sample_time_s;
    let mut own = vec![0.0; terms.states()];
    // 500 samples are enough.
    let stride = times.len().div_ceil(500);
    let largest_input = largest(scenario.events.iter().map(|event| event.1));
    let measured_a = largest(scenario.current_a.iter().filter(|current_a| current_a.is_finite()));
    // Without a current its scale is that of the model's resistance: the stall current.
    let resistance = model.motor.get(MotorKey::Resistance).filter(|_| measured_a <= 0.0);
    let largest_current = resistance.map_or(measured_a, |own| largest_input / own);
    let back_emf = model.motor.get(MotorKey::BackEmf).unwrap_or(0.0);
    let largest_torque = match scenario.input {
        Input::Torque => largest_input,
        Input::Voltage | Input::Current => {
            model.motor.torque_constant().unwrap_or(1.0) * largest_current
        }
    };
    let mut motor = Instant::of(&model.motor).in_run(scenario);
    // A given torque is the current of a motor with a torque constant of one.
    let by_torque = scenario.input == Input::Torque;
    if by_torque {
        motor.torque_n_m_per_a = 1.0;
    }
    let mut reached = 0.0_f64;
    for sample in (0..times.len()).step_by(stride) {
        let input = scenario.input_at(times[sample]);
        let speed_rad_s = scenario.speed_rad_s[sample];
        let at = Instant {
            time_s: times[sample] - scenario.begin_s(),
            current_a: match resistance {
                _ if by_torque => input,
                Some(resistance) => (input - back_emf * speed_rad_s) / resistance,
                None => scenario.current_a[sample],
            },
            speed_rad_s,
            voltage_v: input,
            // Angles that are spread over the turn.
            angle: ShaftAngle::at(sample as f64),
            ..motor
        };
        let last_s = times[sample.saturating_sub(stride)];
        let mut next = own.clone();
        terms.advance(&at, &mut next, times[sample] - last_s);
        if next.iter().all(|state| state.is_finite()) {
            own = next;
        }
        let voltage = terms.voltage_v(&at, &own).abs() / largest_input;
        let torque = terms.torque_n_m(&at, &own).abs() + terms.friction_n_m(&at).abs();
        // `max` ignores NaN, as of a sample without a speed. Half of the largest torque accelerates.
        reached = reached
            .max(voltage)
            .max(torque / largest_torque)
            .max(terms.current_rate_gain(&at).abs())
            .max(0.5 * terms.inertia_gain(&at).abs());
    }
    let path = terms.path();
    let reached = reached
        .max(path.current_offset_a.abs() / largest_current)
        .max(path.speed_offset_rad_s.abs() / largest(&scenario.speed_rad_s));
    let size = 0.03 * specs[parameter].scale / reached;
    if size.is_finite() && size > 0.0 {
        size
    } else {
        specs[parameter].in_run(&scenario.scales).scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Motor, effect};
    use crate::sample::Channel;

    #[test]
    fn it_is_in_proportion_to_torque_and_speed_of_the_run() {
        let scenario = |current: f64, speed: f64| {
            let (events, times) = (vec![(0.0, 10.0)], vec![0.0, 1.0]);
            let mut run = Scenario::planned("r", Input::Voltage, Channel::Voltage, events, times);
            (run.current_a, run.speed_rad_s) = (vec![0.0, current], vec![f64::NAN, speed]);
            run
        };
        let model = Model::baseline(Motor::zk_22fc());
        let drag = effect::find("viscous_friction").unwrap();
        let size = typical_size(drag, 0, &model, &scenario(8.0, 250.0));
        assert!((size - 0.03 * 0.3538 * 8.0 / 250.0).abs() < 1e-12);
        let small = typical_size(drag, 0, &model, &scenario(0.008, 2500.0));
        assert!((size / small - 1e4).abs() < 1e-6);
        // Without a current that of the stall at the resistance of the model counts.
        let mut unmeasured = scenario(8.0, 250.0);
        unmeasured.current_a.fill(f64::NAN);
        let of_stall = typical_size(drag, 0, &model, &unmeasured);
        assert!((of_stall - 0.03 * 0.3538 * (10.0 / 1.1) / 250.0).abs() < 1e-9, "{of_stall}");
        // Drag is not observable on a shaft at rest.
        let still = typical_size(drag, 0, &model, &scenario(8.0, 0.0));
        assert!((still - drag.parameters()[0].scale).abs() < 1e-18);
    }
}
