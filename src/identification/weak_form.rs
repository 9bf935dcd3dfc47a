//! Weak form: both balances averaged over windows with a smooth test function, nothing differentiated.
//!
//! DISCOVERY.md 2.9. With `psi(s) = (1 - s^2)^4` on a window of half length `H`, integration by parts turns a derivative
//! into one of the test function: `<f'> = -<psi_s f>/H`. Linear in the parameters, no starting values, and the only
//! method for runs that carry torque and motion but no voltage. The price: the signals must be sampled several times
//! per time constant (at 10 ms the armature circuit is not), and an effect's shape parameters stay as they are given.
//!
//! Voltage: `<u> = R <i> + L <i'> + Ke <w> + effects`. Torque: `Kt <i> = J <w'> + Mc <sgn w> + effects`.

use nalgebra::{DMatrix, DVector};

use super::output_error::{BLOCK_S, FitError};
use super::verdict::judge;
use crate::numerics::least_squares;
use crate::plant::{Balance, Input, Instant, Model, MotorKey, Scenario, Slot};
use crate::sample::{ParameterEstimate, Verdict};

/// Half length of the windows, s: the armature circuit is faster than the shaft.
const VOLTAGE_HALF_S: f64 = 0.012;
const TORQUE_HALF_S: f64 = 0.03;
/// Samples that a half window has at least.
const FEWEST_HALF: usize = 4;
/// Speeds below this share of the largest count as standstill, where friction is not determined.
const DEAD_ZONE: f64 = 0.01;

/// Estimates of one balance with its residual.
#[derive(Clone, Debug)]
pub struct Balanced {
    pub equation: Balance,
    pub parameters: Vec<ParameterEstimate>,
    /// Middle of each window, s, and what the balance misses there, V or N.m.
    pub residual: Vec<(f64, f64)>,
    /// Root mean square of the left-hand side, V or N.m: what the residual is compared with.
    pub level: f64,
    pub windows_dropped: usize,
}

/// Fits both balances (the torque balance alone where there is no voltage).
pub fn fit(model: &Model, scenario: &Scenario) -> Result<Vec<Balanced>, FitError> {
    let mut balances = Vec::new();
    let mut model = model.clone();
    if scenario.input == Input::Voltage {
        let voltage = balance(&model, scenario, Balance::Voltage)?;
        for estimate in &voltage.parameters {
            if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
                model.motor.set(key, value);
            }
        }
        balances.push(voltage);
    }
    balances.push(balance(&model, scenario, Balance::Torque)?);
    Ok(balances)
}

/// One unknown of a balance: how it is judged and what stands beside it in the sum.
struct Unknown {
    slot: Slot,
    fixed: Option<f64>,
}

fn balance(model: &Model, scenario: &Scenario, equation: Balance) -> Result<Balanced, FitError> {
    let unknowns = unknowns(model, scenario, equation);
    let half = half_window(scenario, equation);
    let dead_zone = DEAD_ZONE * largest(&scenario.speed_rad_s);
    let signals = Signals::new(model, scenario, equation);
    let free: Vec<usize> = (0..unknowns.len())
        .filter(|index| unknowns[*index].fixed.is_none())
        .collect();
    let (mut rows, mut right, mut times) = (Vec::new(), Vec::new(), Vec::new());
    let mut dropped = 0;
    for begin in (0..scenario.samples().saturating_sub(2 * half)).step_by(half) {
        let window = Window::new(scenario, begin, begin + 2 * half);
        let resting = equation == Balance::Torque
            && scenario.speed_rad_s[begin..=begin + 2 * half]
                .iter()
                .any(|speed| speed.abs() <= dead_zone);
        let mut cells: Vec<f64> = unknowns
            .iter()
            .map(|unknown| signals.regressor(unknown, &window))
            .collect();
        let mut left = window.mean(&signals.left);
        if resting || !left.is_finite() || cells.iter().any(|cell| !cell.is_finite()) {
            dropped += 1;
            continue;
        }
        for (cell, unknown) in cells.iter().zip(&unknowns) {
            left -= unknown.fixed.unwrap_or(0.0) * cell;
        }
        cells = free.iter().map(|index| cells[*index]).collect();
        rows.push(cells);
        right.push(left);
        times.push(window.middle_s);
    }
    let matrix = DMatrix::from_fn(rows.len(), free.len(), |row, column| rows[row][column]);
    let right = DVector::from_vec(right);
    let begin_s = scenario.sample_time_s[0];
    let blocks: Vec<usize> = times
        .iter()
        .map(|time_s| ((time_s - begin_s) / BLOCK_S) as usize)
        .collect();
    let solution = least_squares::solve(&matrix, &right, &blocks);
    let period_s = (scenario.sample_time_s[scenario.samples() - 1] - begin_s)
        / (scenario.samples() - 1) as f64;
    let parameters = unknowns
        .iter()
        .enumerate()
        .map(
            |(index, unknown)| match (&solution, free.iter().position(|other| *other == index)) {
                (_, None) => fixed(unknown),
                (Some(solution), Some(place)) => {
                    let std = solution.covariance[(place, place)].max(0.0).sqrt();
                    judge(&unknown.slot, solution.x[place], Some(std), period_s)
                }
                (None, Some(_)) => {
                    let reason = format!(
                        "{} usable windows: the shaft hardly moves in this run",
                        rows.len()
                    );
                    ParameterEstimate::not_observable(
                        &unknown.slot.key(),
                        unknown.slot.unit(),
                        reason,
                    )
                }
            },
        )
        .collect();
    let residual = solution.map_or_else(Vec::new, |solution| {
        times
            .iter()
            .copied()
            .zip(solution.residual.iter().copied())
            .collect()
    });
    let level = right.norm() / (right.len().max(1) as f64).sqrt();
    Ok(Balanced {
        equation,
        parameters,
        residual,
        level,
        windows_dropped: dropped,
    })
}

fn fixed(unknown: &Unknown) -> ParameterEstimate {
    ParameterEstimate {
        key: unknown.slot.key(),
        value: unknown.fixed,
        std: Some(0.0),
        unit: unknown.slot.unit(),
        verdict: Verdict::Fixed,
        reason: None,
    }
}

/// The parameters that enter a balance linearly: the motor's, and every effect's coefficients.
fn unknowns(model: &Model, scenario: &Scenario, equation: Balance) -> Vec<Unknown> {
    let keys: &[MotorKey] = match equation {
        Balance::Voltage => &[
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::BackEmf,
        ],
        Balance::Torque => &[MotorKey::Inertia, MotorKey::LoadTorque],
    };
    let motor = keys.iter().map(|key| Slot::Motor(*key));
    let effects = model.slots().into_iter().filter(|slot| match slot {
        Slot::Effect { index, spec, .. } => {
            let enters = model.effects[*index].effect.card().balance == equation;
            enters
                && spec.is_coefficient()
                && (equation == Balance::Torque || scenario.input == Input::Voltage)
        }
        Slot::Motor(_) => false,
    });
    motor
        .chain(effects)
        .map(|slot| {
            let fixed = model
                .fixed
                .contains(&slot.key())
                .then(|| model.get(&slot))
                .flatten();
            Unknown { slot, fixed }
        })
        .collect()
}

/// Signals of one balance at the samples.
struct Signals<'a> {
    model: &'a Model,
    scenario: &'a Scenario,
    /// Left-hand side: voltage, or motor torque.
    left: Vec<f64>,
    sign: Vec<f64>,
}

impl<'a> Signals<'a> {
    fn new(model: &'a Model, scenario: &'a Scenario, equation: Balance) -> Self {
        let left = match equation {
            Balance::Voltage => held_means(scenario),
            Balance::Torque => match scenario.input {
                Input::Torque => held_values(scenario),
                Input::Voltage | Input::Current => {
                    let kt = model.motor.torque_constant().unwrap_or(f64::NAN);
                    scenario
                        .current_a
                        .iter()
                        .map(|current| kt * current)
                        .collect()
                }
            },
        };
        let sign = scenario
            .speed_rad_s
            .iter()
            .map(|speed| speed.signum())
            .collect();
        Self {
            model,
            scenario,
            left,
            sign,
        }
    }

    /// Average of what one unit of the unknown contributes.
    fn regressor(&self, unknown: &Unknown, window: &Window) -> f64 {
        let scenario = self.scenario;
        match unknown.slot {
            Slot::Motor(MotorKey::Resistance) => window.mean(&scenario.current_a),
            Slot::Motor(MotorKey::Inductance) => window.mean_rate(&scenario.current_a),
            Slot::Motor(MotorKey::BackEmf) => window.mean(&scenario.speed_rad_s),
            Slot::Motor(MotorKey::Inertia) => window.mean_rate(&scenario.speed_rad_s),
            Slot::Motor(MotorKey::LoadTorque) => window.mean(&self.sign),
            Slot::Motor(MotorKey::TorqueConstant) => f64::NAN,
            Slot::Effect {
                index, parameter, ..
            } => window.mean_of(|sample| self.effect(index, parameter, sample)),
        }
    }

    /// What the effect's coefficient adds per unit at one sample.
    fn effect(&self, index: usize, parameter: usize, sample: usize) -> f64 {
        let active = &self.model.effects[index];
        let mut values = active.values_or_guess();
        for (other, spec) in active.effect.parameters().iter().enumerate() {
            if spec.is_coefficient() {
                values[other] = if other == parameter { 1.0 } else { 0.0 };
            }
        }
        let terms = active.effect.terms(&values);
        let at = Instant {
            time_s: self.scenario.sample_time_s[sample],
            voltage_v: self.left[sample],
            current_a: self.scenario.current_a[sample],
            speed_rad_s: self.scenario.speed_rad_s[sample],
            angle_rad: 0.0,
        };
        let own = vec![0.0; terms.states()];
        let resistance = self
            .model
            .motor
            .get(MotorKey::Resistance)
            .unwrap_or(f64::NAN);
        match active.effect.card().balance {
            Balance::Voltage => terms.voltage_v(&at, &own, resistance),
            Balance::Torque => {
                terms.torque_n_m(&at, &own) + self.sign[sample] * terms.friction_n_m(&at)
            }
        }
    }
}

/// Quadrature weights of one window: trapezoid in true time, times the test function and its first derivative.
struct Window {
    begin: usize,
    middle_s: f64,
    weights: Vec<f64>,
    rates: Vec<f64>,
}

impl Window {
    fn new(scenario: &Scenario, begin: usize, end: usize) -> Self {
        let times = &scenario.sample_time_s;
        let (middle_s, half_s) = (
            0.5 * (times[begin] + times[end]),
            0.5 * (times[end] - times[begin]),
        );
        let (mut weights, mut rates, mut total) = (Vec::new(), Vec::new(), 0.0);
        for sample in begin..=end {
            let before = times[sample.saturating_sub(1).max(begin)];
            let after = times[(sample + 1).min(end)];
            let s = (times[sample] - middle_s) / half_s;
            let q = 1.0 - s * s;
            let share = 0.5 * (after - before);
            total += share * q.powi(4);
            weights.push(share * q.powi(4));
            // -psi_s / H
            rates.push(share * 8.0 * s * q.powi(3) / half_s);
        }
        for weight in weights.iter_mut().chain(&mut rates) {
            *weight /= total;
        }
        Self {
            begin,
            middle_s,
            weights,
            rates,
        }
    }

    fn mean(&self, values: &[f64]) -> f64 {
        self.weights
            .iter()
            .zip(&values[self.begin..])
            .map(|(weight, value)| weight * value)
            .sum()
    }

    fn mean_rate(&self, values: &[f64]) -> f64 {
        self.rates
            .iter()
            .zip(&values[self.begin..])
            .map(|(weight, value)| weight * value)
            .sum()
    }

    fn mean_of(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.weights
            .iter()
            .enumerate()
            .map(|(offset, weight)| weight * value(self.begin + offset))
            .sum()
    }
}

fn half_window(scenario: &Scenario, equation: Balance) -> usize {
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let half_s = match equation {
        Balance::Voltage => VOLTAGE_HALF_S,
        Balance::Torque => TORQUE_HALF_S,
    };
    ((half_s / period_s).round() as usize).max(FEWEST_HALF)
}

fn largest(values: &[f64]) -> f64 {
    values
        .iter()
        .filter(|value| value.is_finite())
        .fold(0.0, |most, value| f64::max(most, value.abs()))
}

/// The held input at every sample.
fn held_values(scenario: &Scenario) -> Vec<f64> {
    let events = &scenario.events;
    scenario
        .sample_time_s
        .iter()
        .map(|time_s| events[events.partition_point(|event| event.0 <= *time_s).max(1) - 1].1)
        .collect()
}

/// Mean of the held input over half a period either side of each sample: what a trapezoid rule must be given for a
/// signal that steps, else the input seems half a sample late (DISCOVERY.md 2.9).
fn held_means(scenario: &Scenario) -> Vec<f64> {
    let (times, events) = (&scenario.sample_time_s, &scenario.events);
    let last = times.len() - 1;
    (0..=last)
        .map(|sample| {
            let from_s = 0.5 * (times[sample] + times[sample.saturating_sub(1)]);
            let to_s = 0.5 * (times[sample] + times[(sample + 1).min(last)]);
            let first = events.partition_point(|event| event.0 <= from_s).max(1) - 1;
            let mut sum = 0.0;
            for (index, event) in events
                .iter()
                .enumerate()
                .skip(first)
                .take_while(|(_, event)| event.0 < to_s)
            {
                let next_s = events.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
                sum += event.1 * (next_s - event.0.max(from_s));
            }
            sum / (to_s - from_s)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Motor, Plant, State};
    use crate::sample::Channel;

    fn scenario(input: Input, events: Vec<(f64, f64)>, period_s: f64, until_s: f64) -> Scenario {
        let samples = (until_s / period_s) as usize;
        Scenario {
            name: "r".into(),
            input,
            input_channel: if input == Input::Voltage {
                Channel::Voltage
            } else {
                Channel::Torque
            },
            events,
            sample_time_s: (0..samples).map(|k| k as f64 * period_s).collect(),
            current_a: vec![f64::NAN; samples],
            speed_rad_s: vec![f64::NAN; samples],
            angle: vec![],
            scored: 0..samples,
        }
    }

    fn value(balances: &[Balanced], key: &str) -> f64 {
        balances
            .iter()
            .flat_map(|b| &b.parameters)
            .find(|p| p.key == key)
            .unwrap()
            .value
            .unwrap()
    }

    #[test]
    fn a_voltage_run_gives_every_parameter() {
        let truth = Model::baseline(Motor::zk_22fc())
            .with_effect("quadratic_load")
            .unwrap();
        let mut true_values = truth.clone();
        true_values.effects[0].values = vec![Some(2e-6)];
        let events = vec![
            (0.0, 0.0),
            (0.3, 50.0),
            (0.9, 80.0),
            (1.5, -60.0),
            (2.3, 30.0),
            (3.0, -90.0),
            (4.0, 40.0),
        ];
        let mut run = scenario(Input::Voltage, events, 0.001, 5.0);
        let out = Plant::new(&true_values, Input::Voltage)
            .unwrap()
            .simulate(&run, State::default());
        (run.current_a, run.speed_rad_s) = (out.current_a, out.speed_rad_s);
        let found = fit(&truth, &run).unwrap();
        for (key, expected) in [
            ("resistance_ohm", 1.1),
            ("inductance_h", 0.0099),
            ("back_emf_v_s_per_rad", 0.3538),
            ("inertia_kg_m2", 0.0045),
            ("load_torque_n_m", 0.455),
            ("quadratic_load.quadratic_n_m_s2_per_rad2", 2e-6),
        ] {
            let ratio = value(&found, key) / expected;
            assert!((ratio - 1.0).abs() < 0.01, "{key} {ratio}");
        }
    }

    #[test]
    fn a_linear_axis_under_force_gives_mass_and_friction() {
        // The character of a linear axis: 95 kg, tens of newtons, tenths of a metre per second.
        let motor = Motor::new("axis")
            .with(MotorKey::Inertia, 95.0)
            .with(MotorKey::LoadTorque, 20.0);
        let model = Model::baseline(motor)
            .with_effect("viscous_friction")
            .unwrap()
            .with_effect("constant_load")
            .unwrap();
        let mut truth = model.clone();
        truth.effects[0].values = vec![Some(200.0)];
        truth.effects[1].values = vec![Some(-3.0)];
        let events: Vec<(f64, f64)> = (0..600)
            .map(|k| {
                let t = f64::from(k) * 0.02;
                (t, 60.0 * (1.1 * t).sin() + 25.0 * (4.3 * t).sin())
            })
            .collect();
        let mut run = scenario(Input::Torque, events, 0.001, 12.0);
        run.speed_rad_s = Plant::new(&truth, Input::Torque)
            .unwrap()
            .simulate(&run, State::default())
            .speed_rad_s;
        let found = fit(&model, &run).unwrap();
        for (key, expected) in [
            ("inertia_kg_m2", 95.0),
            ("load_torque_n_m", 20.0),
            ("viscous_friction.viscous_n_m_s_per_rad", 200.0),
            ("constant_load.constant_n_m", -3.0),
        ] {
            let ratio = value(&found, key) / expected;
            assert!((ratio - 1.0).abs() < 0.02, "{key} {ratio}");
        }
        assert_eq!(found.len(), 1);
    }

    #[test]
    fn a_shaft_at_rest_gives_no_inertia() {
        let mut run = scenario(Input::Voltage, vec![(0.0, 0.5)], 0.001, 2.0);
        run.current_a = (0..2000)
            .map(|k| 0.45 * (1.0 - (-f64::from(k) / 9.0).exp()))
            .collect();
        run.speed_rad_s = vec![0.0; 2000];
        let found = fit(&Model::baseline(Motor::zk_22fc()), &run).unwrap();
        let inertia = found[1]
            .parameters
            .iter()
            .find(|p| p.key == "inertia_kg_m2")
            .unwrap();
        assert_eq!(
            (inertia.value, inertia.verdict),
            (None, Verdict::NotObservable)
        );
    }
}
