//! Typical size of an effect, which would matter in a run: where fits start and in which unit they step.

use super::effect::{Effect, Instant, ShaftAngle};
use super::model::Model;
use super::scenario::{Input, Scenario};

/// Share of the run's largest voltage or torque that an effect of typical size reaches.
const SHARE: f64 = 0.03;
/// Of the largest torque what accelerates, for a change of the inertia.
const OF_TORQUE: f64 = 0.5;
/// Samples that are looked at.
const LOOKS: usize = 500;

/// The size of one coefficient at which the effect reaches three per cent of the largest voltage (torque) of the run: a
/// milliwatt motor and a mill have drags of very different size. Shape parameters have their own.
pub fn typical_size(
    effect: &dyn Effect,
    parameter: usize,
    model: &Model,
    scenario: &Scenario,
) -> f64 {
    let specs = effect.parameters();
    if !specs[parameter].is_coefficient() {
        return specs[parameter].guess();
    }
    let values: Vec<f64> = specs
        .iter()
        .enumerate()
        .map(
            |(index, spec)| match (spec.is_coefficient(), index == parameter) {
                // Nearly proportional there; a large size may saturate.
                (true, true) => spec.scale,
                (true, false) => 0.0,
                (false, _) => spec.guess(),
            },
        )
        .collect();
    let terms = effect.terms(&values);
    let (times, events) = (&scenario.sample_time_s, &scenario.events);
    let duration_s = times[times.len() - 1] - times[0];
    let finite =
        |values: &[f64]| -> Vec<f64> { values.iter().copied().filter(|v| v.is_finite()).collect() };
    let currents = finite(&scenario.current_a);
    let mean_square = currents.iter().map(|i| i * i).sum::<f64>() / currents.len().max(1) as f64;
    // States of effects gather what the current leaves behind: by the end of the run as much as this.
    let own = vec![mean_square * duration_s; terms.states()];
    let supply_v = scenario.supply_v();
    let stride = times.len().div_ceil(LOOKS);
    let largest_input = events
        .iter()
        .fold(0.0, |most, event| f64::max(most, event.1.abs()));
    let largest_current = currents.iter().fold(0.0, |most, i| f64::max(most, i.abs()));
    let largest_torque = match scenario.input {
        Input::Torque => largest_input,
        Input::Voltage | Input::Current => {
            model.motor.torque_constant().unwrap_or(1.0) * largest_current
        }
    };
    let reached = (0..times.len())
        .step_by(stride)
        .fold(0.0_f64, |most, sample| {
            let input = scenario.input_at(times[sample]);
            let by_torque = scenario.input == Input::Torque;
            let motor = Instant::of(&model.motor);
            let at = Instant {
                time_s: times[sample] - scenario.begin_s(),
                // A given torque is the current of a motor with a torque constant of one.
                current_a: if by_torque {
                    input
                } else {
                    scenario.current_a[sample]
                },
                torque_n_m_per_a: if by_torque {
                    1.0
                } else {
                    motor.torque_n_m_per_a
                },
                speed_rad_s: scenario.speed_rad_s[sample],
                voltage_v: input,
                supply_v,
                // Any angles will do, as long as they are many.
                angle: ShaftAngle::at(sample as f64),
                ..motor
            };
            let voltage = terms.voltage_v(&at, &own).abs() / largest_input;
            let torque = terms.torque_n_m(&at, &own).abs() + terms.friction_n_m(&at).abs();
            // Comparisons that drop NaN, as of a sample without a speed.
            most.max(voltage)
                .max(torque / largest_torque)
                .max(terms.current_rate_gain(&at).abs())
                .max(OF_TORQUE * terms.inertia_gain(&at).abs())
        });
    let largest_speed = finite(&scenario.speed_rad_s)
        .iter()
        .fold(0.0_f64, |most, w| most.max(w.abs()));
    let path = terms.path();
    let reached = reached
        .max(path.current_offset_a.abs() / largest_current)
        .max(path.speed_offset_rad_s.abs() / largest_speed);
    let size = SHARE * specs[parameter].scale / reached;
    if size.is_finite() && size > 0.0 {
        size
    } else {
        specs[parameter].scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Motor, effect};
    use crate::sample::Channel;

    #[test]
    fn it_goes_with_the_motor_and_with_what_the_run_reached() {
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
        // A shaft that never turned says nothing about drag.
        let still = typical_size(drag, 0, &model, &scenario(8.0, 0.0));
        assert!((still - drag.parameters()[0].scale).abs() < 1e-18);
    }
}
