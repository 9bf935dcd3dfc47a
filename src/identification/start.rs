//! Starting values for a fit when the model file gives none: two small regressions on integrals of the signals.
//!
//! Over a window from a to b: `int u = R int i + L (i_b - i_a) + Ke int w` and
//! `Kt int i = J (w_b - w_a) + Mc int sgn w`; the voltage is integrated exactly, current and speed by the trapezoid.
//! Coarse sampling biases the result by some per cent, which a starting value may be.

use nalgebra::{DMatrix, DVector};

use super::output_error::FitError;
use super::weak_form;
use crate::numerics::statistics::median;
use crate::plant::{Input, Model, ModelError, MotorKey, Scenario};

/// Length of a window, s, and samples it has at least.
const WINDOW_S: f64 = 0.03;
/// Periods, and at least a window's length, that may pass between two samples of a window.
const LONGEST_STEP: f64 = 3.0;
const FEWEST_SAMPLES: usize = 3;

/// Fills in the motor values that `model` leaves out; what the user gave stays as it is.
pub fn complete(model: &Model, scenario: &Scenario) -> Result<Model, FitError> {
    let mut model = model.clone();
    if model.require_complete().is_ok() {
        return Ok(model);
    }
    if scenario.input != Input::Voltage {
        return mechanical(model, scenario);
    }
    let sums = integrals(scenario);
    let electrical: Vec<[f64; 4]> = sums
        .iter()
        .map(|s| [s.current, s.current_step, s.angle, s.voltage])
        .collect();
    let [resistance, inductance, back_emf] = positive(solve(&electrical), [1.0, 1e-3, 0.1]);
    set(&mut model, MotorKey::Resistance, resistance);
    set(&mut model, MotorKey::Inductance, inductance);
    set(&mut model, MotorKey::BackEmf, back_emf);
    let kt = model.motor.torque_constant().unwrap_or(back_emf);
    let mechanical: Vec<[f64; 3]> = sums
        .iter()
        .filter(|s| s.direction != 0.0)
        .map(|s| [s.speed_step, s.direction * s.length_s, kt * s.current])
        .collect();
    let [inertia, load] = positive(solve(&mechanical), [1e-3, 1e-2]);
    set(&mut model, MotorKey::Inertia, inertia);
    set(&mut model, MotorKey::LoadTorque, load);
    for slot in model.slots() {
        if model.get(&slot).is_none() && model.fixed.contains(&slot.key()) {
            return Err(ModelError::Unset { key: slot.key() }.into());
        }
    }
    Ok(model)
}

/// Without a voltage the weak form of the torque balance gives the start.
fn mechanical(mut model: Model, scenario: &Scenario) -> Result<Model, FitError> {
    for balance in weak_form::fit(&model, scenario)? {
        for estimate in balance.parameters {
            if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
                set(&mut model, key, value);
            }
        }
    }
    Ok(model)
}

fn set(model: &mut Model, key: MotorKey, value: f64) {
    if model.motor.get(key).is_none() {
        model.motor.set(key, value);
    }
}

/// Values that physics allows: where noise or poor excitation gives none, a modest default.
fn positive<const N: usize>(found: Option<[f64; N]>, otherwise: [f64; N]) -> [f64; N] {
    let found = found.unwrap_or(otherwise);
    std::array::from_fn(|index| {
        if found[index] > 0.0 {
            found[index]
        } else {
            otherwise[index]
        }
    })
}

struct Integrals {
    length_s: f64,
    voltage: f64,
    current: f64,
    current_step: f64,
    /// Integral of the speed.
    angle: f64,
    speed_step: f64,
    /// Sign of the speed where it is the same over the whole window and clear of noise, else zero.
    direction: f64,
}

fn integrals(scenario: &Scenario) -> Vec<Integrals> {
    let times = &scenario.sample_time_s;
    let current = &between(times, &scenario.current_a);
    let speed = &between(times, &scenario.speed_rad_s);
    let dead_zone = 0.01
        * speed
            .iter()
            .copied()
            .filter(|w| w.is_finite())
            .fold(0.0, |most, w| f64::max(most, w.abs()));
    let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let longest_s = WINDOW_S.max(LONGEST_STEP * median(&steps));
    let mut windows = Vec::new();
    let mut begin = 0;
    while begin + FEWEST_SAMPLES <= times.len() {
        let mut end = begin + FEWEST_SAMPLES - 1;
        while end + 1 < times.len() && times[end] - times[begin] < WINDOW_S {
            end += 1;
        }
        // Nothing is integrated over a pause: nobody knows what the signals did, and its one window would outweigh all.
        if let Some(row) = (begin..end).rfind(|row| times[row + 1] - times[*row] > longest_s) {
            begin = row + 1;
            continue;
        }
        let trapezoid = |values: &[f64]| -> f64 {
            (begin..end)
                .map(|k| 0.5 * (values[k] + values[k + 1]) * (times[k + 1] - times[k]))
                .sum()
        };
        let all =
            |test: fn(f64, f64) -> bool| speed[begin..=end].iter().all(|w| test(*w, dead_zone));
        windows.push(Integrals {
            length_s: times[end] - times[begin],
            voltage: held_integral(&scenario.events, times[begin], times[end]),
            current: trapezoid(current),
            current_step: current[end] - current[begin],
            angle: trapezoid(speed),
            speed_step: speed[end] - speed[begin],
            direction: f64::from(
                i8::from(all(|w, zone| w > zone)) - i8::from(all(|w, zone| w < -zone)),
            ),
        });
        begin = end;
        if end + 1 >= times.len() {
            break;
        }
    }
    windows.retain(|w| w.voltage.is_finite() && w.current.is_finite() && w.angle.is_finite());
    windows
}

/// Missing cells on the straight line between their neighbours: current and speed may come on rows of their own.
fn between(times: &[f64], values: &[f64]) -> Vec<f64> {
    let points: Vec<(f64, f64)> = times
        .iter()
        .zip(values)
        .filter(|(_, value)| value.is_finite())
        .map(|(time, value)| (*time, *value))
        .collect();
    times
        .iter()
        .zip(values)
        .map(|(time, value)| {
            if value.is_finite() {
                return *value;
            }
            let after = points.partition_point(|point| point.0 < *time);
            match (after.checked_sub(1), points.get(after)) {
                (Some(before), Some(after)) => {
                    let before = points[before];
                    before.1 + (after.1 - before.1) * (time - before.0) / (after.0 - before.0)
                }
                _ => f64::NAN,
            }
        })
        .collect()
}

/// Integral of a held signal between two instants.
fn held_integral(events: &[(f64, f64)], from_s: f64, to_s: f64) -> f64 {
    let first = events
        .partition_point(|event| event.0 <= from_s)
        .saturating_sub(1);
    let mut total = 0.0;
    for (index, &(at_s, value)) in events.iter().enumerate().skip(first) {
        if at_s >= to_s {
            break;
        }
        let next_s = events.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
        total += value * (next_s - at_s.max(from_s));
    }
    total
}

/// Least squares of rows `[regressors.., right-hand side]` with columns scaled to one.
fn solve<const M: usize, const N: usize>(rows: &[[f64; M]]) -> Option<[f64; N]> {
    if rows.len() < N {
        return None;
    }
    let mut matrix = DMatrix::from_fn(rows.len(), N, |row, column| rows[row][column]);
    let right = DVector::from_iterator(rows.len(), rows.iter().map(|row| row[N]));
    let norms: Vec<f64> = matrix
        .column_iter()
        .map(|column| column.norm().max(f64::MIN_POSITIVE))
        .collect();
    for (mut column, norm) in matrix.column_iter_mut().zip(&norms) {
        column /= *norm;
    }
    let solution = matrix.svd(true, true).solve(&right, 1e-9).ok()?;
    Some(std::array::from_fn(|index| solution[index] / norms[index]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::count::whole;
    use crate::plant::{Motor, Plant, State};
    use crate::sample::Channel;

    #[test]
    fn starting_values_come_within_a_factor_that_the_fit_can_bridge() {
        let truth = Model::baseline(Motor::zk_22fc());
        for period_s in [0.001, 0.01] {
            let samples = whole(4.0 / period_s);
            let mut scenario = Scenario {
                name: "r".into(),
                input: Input::Voltage,
                input_channel: Channel::Voltage,
                events: vec![
                    (0.0, 0.0),
                    (0.3, 20.0),
                    (0.8, -25.0),
                    (1.5, 60.0),
                    (2.2, -10.0),
                    (3.0, 35.0),
                ],
                sample_time_s: (0..samples).map(|k| k as f64 * period_s).collect(),
                current_a: vec![],
                speed_rad_s: vec![],
                angle: vec![],
                time_half_width_s: vec![],
                unknown_input: vec![],
                scored: 0..samples,
            };
            let out = Plant::new(&truth, Input::Voltage)
                .unwrap()
                .simulate(&scenario, State::default());
            (scenario.current_a, scenario.speed_rad_s) = (out.current_a, out.speed_rad_s);
            let found = complete(&Model::baseline(Motor::new("?")), &scenario).unwrap();
            for slot in truth.slots() {
                let ratio = found.get(&slot).unwrap() / truth.get(&slot).unwrap();
                assert!(
                    (0.5..2.0).contains(&ratio),
                    "{period_s} {} {ratio}",
                    slot.key()
                );
            }
        }
    }

    #[test]
    fn current_and_speed_on_rows_of_their_own_give_a_start_too() {
        let truth = Model::baseline(Motor::zk_22fc());
        let events = vec![
            (0.0, 0.0),
            (0.3, 20.0),
            (0.8, -25.0),
            (1.5, 60.0),
            (2.2, -10.0),
        ];
        let mut scenario = crate::plant::testing::record(&truth, events, 0.005, 3.0, 1);
        for row in 0..scenario.samples() {
            let missing = if row.is_multiple_of(2) {
                &mut scenario.current_a
            } else {
                &mut scenario.speed_rad_s
            };
            missing[row] = f64::NAN;
        }
        let found = complete(&Model::baseline(Motor::new("?")), &scenario).unwrap();
        for slot in truth.slots() {
            let ratio = found.get(&slot).unwrap() / truth.get(&slot).unwrap();
            assert!((0.5..2.0).contains(&ratio), "{} {ratio}", slot.key());
        }
    }

    #[test]
    fn what_the_user_gave_is_kept() {
        let motor = Motor::zk_22fc().with(MotorKey::Resistance, 3.0);
        let model = Model::baseline(motor);
        let scenario = Scenario {
            name: "r".into(),
            input: Input::Voltage,
            input_channel: Channel::Voltage,
            events: vec![(0.0, 0.0)],
            sample_time_s: vec![0.0; 20],
            current_a: vec![0.0; 20],
            speed_rad_s: vec![0.0; 20],
            angle: vec![],
            time_half_width_s: vec![],
            unknown_input: vec![],
            scored: 0..20,
        };
        let mut partial = model.clone();
        partial.motor.clear(MotorKey::Inertia);
        let completed = complete(&partial, &scenario).unwrap();
        assert_eq!(completed.motor.get(MotorKey::Resistance), Some(3.0));
        assert!(completed.motor.get(MotorKey::Inertia).unwrap() > 0.0);
    }
}
