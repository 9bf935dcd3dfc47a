//! What measurement noise does to a balance: the dead zone of the speed, the regressors' noise, the residual's floor.

use super::{DEAD_ZONE, System, WIDEST_DEAD_ZONE};
use crate::identification::noise::NoiseFloor;
use crate::numerics::statistics;
use crate::plant::{Balance, Model, MotorKey, Scenario, Slot};
use crate::sample::ParameterEstimate;

/// Measurement noise: standard deviations over the leading standstill, else from the roughness of the signals.
pub(super) struct Noise {
    current_a: f64,
    speed_rad_s: f64,
    pub(super) dead_zone_rad_s: f64,
    from_standstill: bool,
    /// Relative standard deviation of the noise power.
    pub(super) uncertainty: f64,
}

impl Noise {
    pub(super) fn of(scenario: &Scenario) -> Self {
        let floor = NoiseFloor::from_standstill(scenario);
        let or_roughness = |still: Option<f64>, values: &[f64]| {
            still
                .filter(|sigma| sigma.is_finite())
                .unwrap_or_else(|| roughness(values))
        };
        let speed_rad_s = or_roughness(floor.map(|f| f.speed_rad_s), &scenario.speed_rad_s);
        let largest = largest(&scenario.speed_rad_s);
        Self {
            current_a: or_roughness(floor.map(|f| f.current_a), &scenario.current_a),
            speed_rad_s,
            dead_zone_rad_s: (4.0 * speed_rad_s)
                .min(WIDEST_DEAD_ZONE * largest)
                .max(DEAD_ZONE * largest),
            from_standstill: floor.is_some(),
            // Of a variance from n samples; the roughness of a signal also holds some of the signal.
            uncertainty: floor.map_or(1.0, |f| (2.0 / f.samples as f64).sqrt()),
        }
    }

    /// Standard deviation that noise gives the regressor of one parameter in one window; `gain` and `rate_gain` are the
    /// norms of the window's weights.
    pub(super) fn spread(&self, slot: &Slot, gain: f64, rate_gain: f64) -> f64 {
        match slot {
            Slot::Motor(MotorKey::Resistance) => self.current_a * gain,
            Slot::Motor(MotorKey::Inductance) => self.current_a * rate_gain,
            Slot::Motor(MotorKey::BackEmf) => self.speed_rad_s * gain,
            Slot::Motor(MotorKey::Inertia) => self.speed_rad_s * rate_gain,
            Slot::Motor(_) | Slot::Effect { .. } => 0.0,
        }
    }

    /// DISCOVERY.md 2.9: `sV^2 = (R si k0)^2 + (Ke sw k0)^2 + (L si k1)^2`, `sM^2 = (Kt si k0)^2 + (J sw k1)^2`.
    pub(super) fn floor(
        &self,
        system: &System,
        parameters: &[ParameterEstimate],
        model: &Model,
    ) -> Option<f64> {
        let value = |key: MotorKey| {
            let found = parameters.iter().find(|p| p.key == key.key());
            found.and_then(|p| p.value).map(f64::abs)
        };
        let (mean, rate) = (system.gain, system.rate_gain);
        let shares = match system.equation {
            Balance::Voltage => [
                value(MotorKey::Resistance)? * self.current_a * mean,
                value(MotorKey::BackEmf)? * self.speed_rad_s * mean,
                value(MotorKey::Inductance)? * self.current_a * rate,
            ],
            Balance::Torque => [
                model.motor.torque_constant().unwrap_or(0.0) * self.current_a * mean,
                value(MotorKey::Inertia)? * self.speed_rad_s * rate,
                0.0,
            ],
        };
        let power: f64 = shares.iter().map(|share| share * share).sum();
        (self.from_standstill && power > 0.0).then(|| power.sqrt())
    }
}

/// Noise of a signal from its second differences, outliers and steps left aside; zero where there is no signal.
fn roughness(values: &[f64]) -> f64 {
    let differences: Vec<f64> = values
        .windows(3)
        .map(|v| v[0] - 2.0 * v[1] + v[2])
        .filter(|difference| difference.is_finite())
        .collect();
    if differences.is_empty() {
        return 0.0;
    }
    statistics::robust_deviation(&differences) / 6f64.sqrt()
}

/// Largest value but for one sample in two hundred: a single bad cell must not set the scale.
pub(super) fn largest(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values
        .iter()
        .filter(|value| value.is_finite())
        .map(|value| value.abs())
        .collect();
    sizes.sort_by(f64::total_cmp);
    let dropped = sizes.len() / 200;
    sizes.iter().rev().nth(dropped).copied().unwrap_or(0.0)
}
