//! What the rounding of a coarse sensor adds to the deviations of a fit.
//!
//! While a signal rests within one step of its sensor, all its samples have the same error of rounding, and so have those of every other
//! plateau with the same reading: the friction of a spindle follows from a current of a few steps, which the rounding moves with the
//! sign of the speed and leaves no residual. Noise averages the rounding out (dither: Widrow and Kollar, Quantization Noise, 2008,
//! chapter 19): what noise of `s` leaves of the error over a step `q` is `exp(-2 (pi s/q)^2)`.

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::noise::{NoiseFloor, roughness, rounding};
use drivebench_model::plant::Scenario;

/// Variance that the rounding which samples share adds to each coordinate of a fit with this Jacobian of residuals over the noise,
/// whose normal matrix has the inverse `bread`; a row is `(sample, is_speed)`.
pub(super) fn shared_variance(
    jacobian: &DMatrix<f64>,
    bread: &DMatrix<f64>,
    rows: &[(usize, bool)],
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> DVector<f64> {
    let mut variance = DVector::zeros(bread.ncols());
    let speeds = &scenario.speed_rad_s;
    for (values, level, of_speed) in
        [(&scenario.current_a, noise.current_a, false), (speeds, noise.speed_rad_s, true)]
    {
        let (error, quantum) = (rounding(values), 12f64.sqrt() * rounding(values));
        if error <= 0.0 || !level.is_finite() {
            continue;
        }
        let own = level.min(roughness(values)).powi(2) - error * error;
        let dither = own.max(0.0).sqrt() / quantum;
        let shared = error / level * (-2.0 * (PI * dither).powi(2)).exp();
        let own: Vec<(usize, usize)> = (rows.iter().enumerate())
            .filter(|(_, row)| row.1 == of_speed)
            .map(|(place, row)| (place, row.0))
            .collect();
        // Of each reading, whatever its sign, the sum over its plateaus.
        let mut sums = BTreeMap::<i64, DVector<f64>>::new();
        for plateau in own.chunk_by(|a, b| (values[a.1] - values[b.1]).abs() < error) {
            if plateau.len() < 2 {
                continue;
            }
            for (place, sample) in plateau {
                let steps = (values[*sample] / quantum).round();
                let sign = if steps == 0.0 { speeds[*sample] } else { steps };
                #[expect(clippy::cast_possible_truncation, reason = "a reading of a sensor")]
                let sum = sums.entry(steps.abs() as i64);
                let sum = sum.or_insert_with(|| DVector::zeros(bread.ncols()));
                if sign != 0.0 {
                    sum.axpy(sign.signum(), &jacobian.row(*place).transpose(), 1.0);
                }
            }
        }
        for sum in sums.values() {
            let change = bread * sum * shared;
            variance += change.component_mul(&change);
        }
    }
    variance
}

#[cfg(test)]
mod tests {
    use super::super::tests::record;
    use super::*;
    use crate::output_error::fit;
    use crate::testing::paper;
    use drivebench_model::plant::MotorKey;
    use drivebench_model::sample::ParameterEstimate;

    /// Friction of a motor whose current is read in steps of a third of that friction: its deviation holds the truth.
    #[test]
    fn friction_by_a_current_of_a_few_steps_is_as_uncertain_as_the_steps() {
        let truth = paper();
        let motor = &truth.motor;
        let kt = motor.torque_constant().unwrap();
        let friction = motor.get(MotorKey::LoadTorque).unwrap();
        let fitted = |quantum: f64, offset: f64| {
            let mut run = record(&truth, 0.002, 3);
            for current in &mut run.current_a {
                *current = quantum * ((*current / quantum + offset).round() - offset);
            }
            let noise = NoiseFloor::from_standstill(&run).unwrap();
            let found = fit(std::slice::from_ref(&truth), &run, &noise).unwrap();
            let own = ParameterEstimate::find(&found.parameters, MotorKey::LoadTorque.key());
            let (value, std) = own.and_then(ParameterEstimate::carried).unwrap();
            (value - friction, std.unwrap())
        };
        let (_, fine) = fitted(1e-3 * friction / kt, 0.0);
        for offset in [0.0, 0.2, 0.4] {
            let (error, std) = fitted(friction / kt / 3.0, offset);
            assert!(error.abs() < 2.5 * std && std > 3.0 * fine, "{error} {std} {fine}");
        }
    }
}
