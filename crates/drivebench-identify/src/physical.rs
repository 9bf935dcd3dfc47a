//! Physical bounds of a parameter from the extreme voltage, current, speed and acceleration of a record, by which the result of a
//! diverged fit is refused.

use super::verdict;
use drivebench_model::numerics::statistics::{extent, finite, largest_but_outliers, mean};
use drivebench_model::plant::{Input, LEAST_TIME_CONSTANT, Motor, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};
use drivebench_model::text::number::significant;

/// Factor of a bound for the terms that it neglects: a back-EMF in addition to the voltage, an overhauling load, noise in an
/// extreme.
const MARGIN: f64 = 4.0;
/// Share of the largest voltage or torque of the record that a sensor resolves.
const RESOLUTION: f64 = 1e-3;

struct Extents {
    /// Largest voltage, V, current, A, and torque, N.m; not a number where the record does not have it.
    voltage_v: f64,
    current_a: f64,
    torque_n_m: f64,
    current_rms_a: f64,
    speed_rad_s: f64,
    speed_rms_rad_s: f64,
    /// From the least to the largest speed, rad/s.
    span_rad_s: f64,
    period_s: f64,
    length_s: f64,
}

impl Extents {
    fn of(scenario: &Scenario, motor: &Motor) -> Self {
        let inputs: Vec<f64> = scenario.events.iter().map(|event| event.1).collect();
        let input = |kind: Input| {
            if scenario.input == kind { largest_but_outliers(&inputs) } else { f64::NAN }
        };
        let rms = |values: &[f64]| {
            let squares: Vec<f64> = finite(values).iter().map(|value| value * value).collect();
            mean(&squares).sqrt()
        };
        let measured_a = largest_but_outliers(&scenario.current_a);
        let voltage_v = input(Input::Voltage);
        // Without a measured current the stall current.
        let stall_a = voltage_v / motor.get(MotorKey::Resistance).unwrap_or(f64::NAN);
        let current_a = match scenario.input {
            Input::Current => input(Input::Current),
            _ if measured_a > 0.0 => measured_a,
            _ => MARGIN * stall_a,
        };
        let torque_n_m = match scenario.input {
            Input::Torque => input(Input::Torque),
            _ => current_a * motor.torque_constant().unwrap_or(f64::NAN),
        };
        let times = &scenario.sample_time_s;
        let (least, most) = extent(finite(&scenario.speed_rad_s));
        Self {
            voltage_v,
            current_a,
            torque_n_m,
            current_rms_a: rms(&scenario.current_a),
            speed_rad_s: largest_but_outliers(&scenario.speed_rad_s),
            speed_rms_rad_s: rms(&scenario.speed_rad_s),
            span_rad_s: most - least,
            period_s: scenario.mean_period_s(),
            length_s: times[times.len() - 1] - times[0],
        }
    }

    /// Lower and upper bound and their reason; NaN without a bound.
    fn range(&self, key: MotorKey, motor: &Motor) -> (f64, f64, String) {
        let resistance_ohm = motor.get(MotorKey::Resistance).unwrap_or(f64::NAN);
        let three = |value| significant(value, 3);
        let [volts, torque, seconds] = [self.voltage_v, self.torque_n_m, self.length_s].map(three);
        match key {
            MotorKey::Resistance => (
                RESOLUTION * self.voltage_v / self.current_a,
                MARGIN * self.voltage_v / self.current_rms_a,
                format!("up to {volts} V drove {} A (rms)", three(self.current_rms_a)),
            ),
            MotorKey::Inductance => (
                // Twice the bound of the fit: a smaller value is at that bound.
                2.0 * LEAST_TIME_CONSTANT * self.period_s * resistance_ohm,
                self.length_s * resistance_ohm,
                format!(
                    "L/R is between the sampling period of {} ms and the length of the run, {seconds} s",
                    three(1e3 * self.period_s)
                ),
            ),
            MotorKey::BackEmf => (
                RESOLUTION * self.voltage_v / self.speed_rad_s,
                MARGIN * self.voltage_v / self.speed_rms_rad_s,
                format!(
                    "up to {volts} V turned the shaft at {} rad/s (rms)",
                    three(self.speed_rms_rad_s)
                ),
            ),
            MotorKey::Inertia => {
                let per_rate = self.torque_n_m / self.span_rad_s;
                (
                    RESOLUTION * per_rate * self.period_s,
                    MARGIN * per_rate * self.length_s,
                    format!(
                        "up to {torque} N.m changed the speed by {} rad/s within {seconds} s",
                        three(self.span_rad_s)
                    ),
                )
            }
            MotorKey::LoadTorque => {
                (f64::NAN, self.torque_n_m, format!("up to {torque} N.m turned the shaft"))
            }
            MotorKey::TorqueConstant => (f64::NAN, f64::NAN, String::new()),
        }
    }

    /// The same of an effect's size, by its unit.
    fn of_effect(&self, unit: &str) -> (f64, String) {
        let (most, margin, what) = match unit {
            "V" => (self.voltage_v, 1.0, "voltage is"),
            "A" => (self.current_a, 1.0, "current is"),
            "N.m" => (self.torque_n_m, MARGIN, "motor gives"),
            _ => (f64::NAN, 1.0, ""),
        };
        (margin * most, format!("the {what} {} {unit} at most", significant(most, 3)))
    }
}

/// Whether the record is compatible with a motor of these values.
pub fn allows(motor: &Motor, scenario: &Scenario) -> bool {
    let found = |key: MotorKey| {
        let value = motor.get(key)?;
        let (key, unit) = (key.key(), key.unit());
        Some(ParameterEstimate::found(key, unit, value, 0.0, None))
    };
    let mut values: Vec<ParameterEstimate> = MotorKey::ALL.into_iter().filter_map(found).collect();
    refuse(&mut values, motor, scenario);
    values.iter().all(|own| own.value.is_some())
}

/// Refuses the values outside their bounds, with the reason. `motor` has the estimated values.
pub fn refuse(parameters: &mut [ParameterEstimate], motor: &Motor, scenario: &Scenario) {
    let extents = Extents::of(scenario, motor);
    for parameter in parameters.iter_mut() {
        let is_given = parameter.verdict == Verdict::Fixed;
        let Some(value) = parameter.value.filter(|_| !is_given) else { continue };
        let of_effect = || {
            let (most, why) = extents.of_effect(parameter.unit);
            (-most, most, why)
        };
        let key = MotorKey::from_key(&parameter.key);
        let (least, most, why) = key.map_or_else(of_effect, |key| extents.range(key, motor));
        // A negative value has a reason of its own.
        let is_small = value < least && (value > 0.0 || least < 0.0);
        if is_small || value > most {
            let bound = if is_small { "at least" } else { "at most" };
            let limit = if is_small { least } else { most };
            let reason = format!(
                "the fit ended at {} {}, and this record allows {} {bound}: {why}",
                significant(value, 3),
                parameter.unit,
                significant(limit, 2)
            );
            verdict::refuse(parameter, Reason::Impossible, reason);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    /// These values, R, L, Ke, J, Mc, after the check against a record of the motor of paper A.
    fn left(values: &Truth) -> Vec<ParameterEstimate> {
        let scenario = record(&paper(), steps(0.3, 4.0, 1.0, 0.2), 0.002, 4.0, 1);
        let of_motor = KEYS.iter().zip(values).map(|(key, value)| (key.key(), key.unit(), *value));
        let effects =
            [("voltage_offset.offset_v", "V", -350.0), ("current_offset.offset_a", "A", 0.2)];
        let all = of_motor.chain(effects);
        let mut found: Vec<ParameterEstimate> = all
            .map(|(key, unit, value)| ParameterEstimate::found(key, unit, value, 0.01, None))
            .collect();
        refuse(&mut found, &motor(values), &scenario);
        found
    }

    #[test]
    fn values_that_no_motor_has_are_refused_with_their_reason() {
        for factor in [1.0, 0.3, 3.0] {
            let found = left(&PAPER.map(|value| factor * value));
            let has_all = found[..5].iter().all(|own| own.value.is_some());
            assert!(has_all && found[6].value.is_some(), "{found:?}");
        }
        for (place, value, reason) in [
            (0, 45_500.0, "V drove"),
            (0, 1e-4, "V drove"),
            (1, 30.0, "L/R"),
            (2, 40.0, "turned the shaft at"),
            (3, 5237.0, "changed the speed"),
            (4, 900.0, "turned the shaft"),
        ] {
            let mut values = PAPER;
            values[place] = value;
            let found = left(&values);
            assert_eq!(found[place].verdict, Verdict::NotObservable, "{found:?}");
            assert_says(&found[place], &[reason, "allows"]);
        }
        assert_says(&left(&PAPER)[5], &["-350 V", "at most"]);
    }
}
