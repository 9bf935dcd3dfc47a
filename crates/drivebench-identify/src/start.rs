//! Starting values of a fit: two regressions on integrals of the signals (integral-equation method); without a current the
//! first-order lag of the speed. The integral of the voltage is exact; the bias of the others by coarse sampling does not matter.

use super::first_order::FirstOrder;
use super::output_error::FitError;
use super::weak_form;
use super::window_sums::{Sums, WINDOW_RESPONSES, windows};
use drivebench_model::numerics::least_squares::solve_rows;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Model, ModelError, MotorKey, Scenario};
use drivebench_model::signal;

/// Resistance, inductance and back-EMF constant, in ohm, H and V.s/rad, where the record gives none.
const DEFAULTS: [f64; 3] = [1.0, 1e-3, 0.1];

/// Fills in the motor values that `model` leaves out; what the user gave stays as it is.
pub fn complete(model: &Model, scenario: &Scenario) -> Result<Model, FitError> {
    let mut model = model.clone();
    if model.require_complete().is_ok() {
        return Ok(model);
    }
    if scenario.input != Input::Voltage {
        return Ok(mechanical(model, scenario));
    }
    if !scenario.current_a.iter().any(|current| current.is_finite()) {
        without_current(&mut model, scenario);
        return checked(model);
    }
    let sums = integrals(scenario);
    let electrical: Vec<[f64; 4]> =
        (sums.iter()).map(|s| [s.current, s.current_step, s.angle, s.voltage]).collect();
    let [resistance, inductance, back_emf] = positive(solve_rows(&electrical), DEFAULTS);
    set(&mut model, MotorKey::Resistance, resistance);
    set(&mut model, MotorKey::Inductance, inductance);
    set(&mut model, MotorKey::BackEmf, back_emf);
    let kt = model.motor.torque_constant().unwrap_or(back_emf);
    let mechanical: Vec<[f64; 3]> = (sums.iter().filter(|s| s.direction != 0.0))
        .map(|s| [s.speed_step, s.direction * s.length_s, kt * s.current])
        .collect();
    let [inertia, load] = positive(solve_rows(&mechanical), [1e-3, 1e-2]);
    set(&mut model, MotorKey::Inertia, inertia);
    set(&mut model, MotorKey::LoadTorque, load);
    checked(model)
}

/// A fixed value has to be given.
fn checked(model: Model) -> Result<Model, FitError> {
    for slot in model.slots() {
        if model.get(&slot).is_none() && model.fixed.contains(&slot.key()) {
            return Err(ModelError::Unset { key: slot.key() }.into());
        }
    }
    Ok(model)
}

/// Voltage and speed determine gain, time constant and friction voltage; a resistance that is not given is only a scale.
fn without_current(model: &mut Model, scenario: &Scenario) {
    let [resistance_ohm, inductance_h, back_emf] = DEFAULTS;
    let resistance_ohm = set(model, MotorKey::Resistance, resistance_ohm);
    set(model, MotorKey::Inductance, inductance_h * resistance_ohm);
    let lag = FirstOrder::with_dead_time(scenario).filter(|lag| lag.gain_rad_s_per_v > 0.0);
    let back_emf = lag.map_or(back_emf, |lag| lag.gain_rad_s_per_v.recip());
    let back_emf = set(model, MotorKey::BackEmf, back_emf);
    let per_volt = model.motor.torque_constant().unwrap_or(back_emf) / resistance_ohm;
    let (time_constant_s, friction_v) =
        lag.map_or((0.1, 0.0), |lag| (lag.time_constant_s, lag.friction_v));
    let inertia = time_constant_s * back_emf * per_volt;
    set(model, MotorKey::Inertia, inertia);
    set(model, MotorKey::LoadTorque, friction_v * per_volt);
}

/// Without a voltage the weak form of the torque balance gives the start.
fn mechanical(mut model: Model, scenario: &Scenario) -> Model {
    for balance in weak_form::fit(&model, scenario) {
        for estimate in balance.parameters {
            if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
                set(&mut model, key, value);
            }
        }
    }
    model
}

/// Sets a value that is not given; returns the value of the model.
fn set(model: &mut Model, key: MotorKey, value: f64) -> f64 {
    let given = model.motor.get(key);
    if given.is_none() {
        model.motor.set(key, value);
    }
    given.unwrap_or(value)
}

/// The positive ones of the values; a default for the others, where noise or poor excitation gives none.
fn positive<const N: usize>(found: Option<[f64; N]>, otherwise: [f64; N]) -> [f64; N] {
    let found = found.unwrap_or(otherwise);
    std::array::from_fn(|k| if found[k] > 0.0 { found[k] } else { otherwise[k] })
}

fn integrals(scenario: &Scenario) -> Vec<Sums> {
    let times = &scenario.sample_time_s;
    let current = between(times, &scenario.current_a);
    let speed = between(times, &scenario.speed_rad_s);
    let dead_zone_rad_s = 0.01 * largest(&speed);
    let window_s = scenario.scales.responses(WINDOW_RESPONSES);
    let windows = windows(times, window_s).into_iter().map(|window| {
        let voltage = signal::integral(&scenario.events, times[window.start], times[window.end]);
        Sums::over(&window, times, voltage, [&current, &speed], dead_zone_rad_s)
    });
    windows
        .filter(|w| w.voltage.is_finite() && w.current.is_finite() && w.angle.is_finite())
        .collect()
}

/// Missing cells by linear interpolation: current and speed may have separate rows.
fn between(times: &[f64], values: &[f64]) -> Vec<f64> {
    let cells = times.iter().copied().zip(values.iter().copied());
    let points: Vec<(f64, f64)> = cells.clone().filter(|cell| cell.1.is_finite()).collect();
    let filled = |(time_s, value): (f64, f64)| {
        if value.is_finite() { value } else { signal::line(&points, time_s) }
    };
    cells.map(filled).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    /// Within the factor that a fit can bridge.
    #[track_caller]
    fn starts_near(scenario: &Scenario) {
        let found = complete(&unknown(), scenario).unwrap();
        for key in KEYS {
            let ratio = found.motor.get(key).unwrap() / paper().motor.get(key).unwrap();
            assert!((0.5..2.0).contains(&ratio), "{key:?} {ratio}");
        }
    }

    #[test]
    fn starting_values_come_within_a_factor_that_the_fit_can_bridge() {
        let events = held([0.0, 0.3, 0.8, 1.5, 2.2, 3.0], [0.0, 20.0, -25.0, 60.0, -10.0, 35.0]);
        for period_s in [0.001, 0.01] {
            starts_near(&simulated(&paper(), Input::Voltage, events.clone(), every(period_s, 4.0)));
        }
        // Current and speed on rows of their own.
        let mut apart = record(&paper(), events, 0.005, 3.0, 1);
        for row in 0..apart.samples() {
            let columns = [&mut apart.current_a, &mut apart.speed_rad_s];
            columns[row % 2][row] = f64::NAN;
        }
        starts_near(&apart);
    }

    #[test]
    fn without_a_current_the_lag_gives_the_start() {
        let events = held([0.0, 0.5, 2.0, 3.5], [0.0, 20.0, 60.0, 40.0]);
        let mut scenario = record(&paper(), events, 0.01, 5.0, 1);
        scenario.current_a.fill(f64::NAN);
        let mut model = unknown();
        model.motor.set(MotorKey::Resistance, 1.1);
        let found = complete(&model, &scenario).unwrap();
        assert_eq!(found.motor.get(MotorKey::Resistance), Some(1.1));
        for key in [MotorKey::BackEmf, MotorKey::Inertia, MotorKey::LoadTorque] {
            let ratio = found.motor.get(key).unwrap() / paper().motor.get(key).unwrap();
            assert!((0.7..1.4).contains(&ratio), "{key:?} {ratio}");
        }
    }
}
