//! Weak form (modulating functions, Shinbrot 1957): both balances averaged over windows with a smooth test function, without
//! differentiation.
//!
//! With `psi(s) = (1 - s^2)^4` on a window of half length `H`, integration by parts turns a derivative of the signal
//! into one of the test function: `<f'> = -<(dpsi/ds) f>/H`. Linear in the parameters, no starting values, and the only
//! method for runs with torque and motion but no voltage. The signals must be sampled several times per time constant (at
//! 10 ms the armature circuit is not), and the shape parameters of effects stay as given.
//!
//! Where a commanded current steps and brakes within a few rows, `psi = 1` between two steps: `<T> = J (w2 - w1)/H + ..`.
//!
//! The quadrature error is estimated by Richardson extrapolation: the same fit with every second sample changes each value; a
//! third of the change is the error of a quadrature of second order, all of it that of first order. The current has a corner at
//! each step of the voltage, so the change over 1.5 is added to the uncertainty. Noise in a regressor attenuates its coefficient
//! (errors in variables): the bias is computed from the noise and subtracted, and its uncertainty is added. The uncertainty of
//! a torque constant from the same run enters all values of the torque balance.
//!
//! Voltage: `<u> = R <i> + L <i'> + Ke <w> + effects`. Torque: `Kt <i> = J <w'> + Mc <sgn w> + effects`.

use nalgebra::{DMatrix, DVector};

use super::balance::{
    Column, Derivation, Method, Signals, TorqueRows, Unknown, scored_s, set_motor, unknowns,
    why_no_regressor,
};
use super::between_samples;
use super::noise::{NoiseFloor, roughness};
use super::verdict::judge;
use super::winding_balance;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::largest_but_outliers;
use drivebench_model::numerics::{least_squares, statistics};
use drivebench_model::plant::{
    Balance, Input, Instant, Model, MotorKey, REVERSAL_SHARE, Scenario, ShaftAngle, Slot,
};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason};
use drivebench_model::signal::{self, Window};

/// Half length of the windows of the torque balance, in times of response.
const TORQUE_HALF_RESPONSES: f64 = 0.75;
/// Fewest samples of a half window.
const FEWEST_HALF: usize = 4;
/// Change by leaving out every second sample over the error at the full rate: between first order (1) and second (3).
const SAMPLING_ORDER: f64 = 1.5;
/// Least ratio, in power, of the part of a regressor that the others do not explain to its noise.
const LEAST_SIGNAL: f64 = 4.0;

#[derive(Clone, Debug)]
pub struct Balanced {
    pub equation: Balance,
    pub parameters: Vec<ParameterEstimate>,
    /// Residual in each window, V or N.m.
    pub residual: Vec<f64>,
    /// Root mean square of the residual by measurement noise alone, V or N.m; `None` without a standstill.
    pub noise_floor: Option<f64>,
}

/// Fits both balances (the torque balance alone where there is no voltage); the torque balance with the torque constant of the
/// voltage balance.
pub fn fit(model: &Model, scenario: &Scenario) -> Vec<Balanced> {
    let mut balances = Vec::new();
    let mut model = model.clone();
    let mut torque_deviation = 0.0;
    if scenario.input == Input::Voltage {
        let voltage = balance(&model, scenario, Balance::Voltage, 0.0);
        torque_deviation = set_motor(&mut model, &voltage.parameters);
        balances.push(voltage);
    }
    if let Some(winding) = winding_balance::fit(&model, scenario) {
        torque_deviation = set_motor(&mut model, &winding.parameters);
        balances.push(Balanced {
            equation: Balance::Voltage,
            parameters: winding.parameters,
            residual: Vec::new(),
            noise_floor: None,
        });
    }
    balances.push(balance(&model, scenario, Balance::Torque, torque_deviation));
    balances
}

/// Why a balance has too few windows to be solved.
fn why_too_few(windows: usize, model: &Model, scenario: &Scenario, equation: Balance) -> String {
    let by_current = scenario.input != Input::Torque;
    if equation == Balance::Torque && by_current && model.motor.torque_constant().is_none() {
        "no torque constant turns current into torque: give back_emf_v_s_per_rad or torque_n_m_per_a"
            .to_owned()
    } else {
        format!("{windows} usable windows: the shaft hardly moves in this run")
    }
}

/// `left_deviation`: relative standard deviation of a factor of the left-hand side.
fn balance(model: &Model, scenario: &Scenario, equation: Balance, left_deviation: f64) -> Balanced {
    let half = half_window(scenario, equation);
    let noise = Noise::of(scenario);
    let system = System::new(model, scenario, equation, half, &noise);
    let begin_s = scenario.sample_time_s[0];
    let block_s = scenario.scales.block_s();
    let solution = system.solve(begin_s, block_s);
    // The same windows in time with half of the samples.
    let (thin, thin_half) = (thinned(scenario), (half / 2).max(2));
    let coarse = System::new(model, &thin, equation, thin_half, &noise).solve(begin_s, block_s);
    let period_s = statistics::mean_step(&scenario.sample_time_s);
    let errors = (solution.as_ref()).map(|it| (it, system.errors(it, coarse.as_ref(), &noise)));
    let mut columns = 0..;
    let estimate = |unknown: &Unknown| {
        let column = (unknown.fixed.is_none()).then(|| columns.next()).flatten();
        let Some(((solution, errors), column)) = errors.as_ref().zip(column) else {
            return unknown.unsolved(&why_too_few(system.windows.len(), model, scenario, equation));
        };
        let value = solution.x[column] + errors[column].attenuation;
        // NaN where it is not determined.
        let variance = solution.covariance[(column, column)] + (left_deviation * value).powi(2);
        estimate(unknown, value, variance, &errors[column], period_s)
    };
    let parameters: Vec<ParameterEstimate> = system.unknowns.iter().map(estimate).collect();
    let noise_floor = noise.floor(&system, &parameters, model);
    let residual =
        solution.map_or_else(Vec::new, |solution| solution.residual.iter().copied().collect());
    Balanced { equation, parameters, residual, noise_floor }
}

/// Errors of one value that the covariance does not contain.
struct Errors {
    /// Quadrature error by coarse sampling.
    sampling: f64,
    /// Bias by noise in the regressors, with the opposite sign: the correction.
    attenuation: f64,
    /// Uncertainty of that correction.
    noise: f64,
    /// Power of the part of the regressor that the others do not explain over that of its noise.
    signal: f64,
}

fn estimate(
    unknown: &Unknown,
    value: f64,
    variance: f64,
    errors: &Errors,
    period_s: f64,
) -> ParameterEstimate {
    if errors.signal < LEAST_SIGNAL {
        let reason = format!(
            "the part that only this parameter explains is {:.1} times its noise, at least {} is needed: \
             the run does not excite it",
            errors.signal, LEAST_SIGNAL
        );
        let (key, unit) = (unknown.slot.key(), unknown.slot.unit());
        return ParameterEstimate::not_observable(&key, unit, Reason::NotExcited, reason);
    }
    let systematic = errors.sampling.powi(2) + errors.noise.powi(2);
    let std = (variance + systematic).sqrt();
    let mut judged = judge(&unknown.slot, value, Some(std), period_s);
    if let Some(reason) = judged.reason.as_mut()
        && errors.sampling.powi(2) > variance
    {
        let change = format!(
            "; half of the samples change it by {:.1} %: sample faster, or use the output-error fit",
            100.0 * SAMPLING_ORDER * errors.sampling / value.abs().max(f64::MIN_POSITIVE)
        );
        reason.push_str(&change);
    }
    judged
}

/// The linear system of one balance: one row per usable window.
struct System {
    equation: Balance,
    unknowns: Vec<Unknown>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    windows: Vec<Window>,
    /// Standard deviations of a mean and of a mean rate under white noise of unit variance.
    gain: f64,
    rate_gain: f64,
}

impl System {
    fn new(
        model: &Model,
        scenario: &Scenario,
        equation: Balance,
        half: usize,
        noise: &Noise,
    ) -> Self {
        let electrical = scenario.input == Input::Voltage;
        let unknowns = unknowns(model, scenario, equation, |active| {
            why_no_regressor(active, &model.motor, electrical).is_none()
        });
        let (lefts, angle) = (left(model, scenario, equation), angles(scenario));
        let voltages = match equation {
            Balance::Voltage => lefts.clone(),
            Balance::Torque => scenario.held_means(),
        };
        let at = |sample: usize| Instant {
            time_s: scenario.sample_time_s[sample] - scenario.begin_s(),
            voltage_v: voltages[sample],
            current_a: scenario.current_a[sample],
            speed_rad_s: scenario.speed_rad_s[sample],
            angle: ShaftAngle::at(angle[sample]),
            ..Instant::of(&model.motor).in_run(scenario)
        };
        let signals = Signals {
            model,
            equation,
            current_a: &scenario.current_a,
            speed_rad_s: &scenario.speed_rad_s,
            at: &at,
        };
        let columns: Vec<Column> =
            (unknowns.iter()).map(|unknown| signals.column(&unknown.slot)).collect();
        let is_free = |index: &usize| unknowns[*index].fixed.is_none();
        let free: Vec<usize> = (0..unknowns.len()).filter(is_free).collect();
        let (mut rows, mut right, mut windows) = (Vec::new(), Vec::new(), Vec::new());
        let (mut gain, mut rate_gain) = (0.0, 0.0);
        let longest_s = half as f64 * statistics::mean_step(&scenario.sample_time_s);
        let (all, speeds) = (&scenario.sample_time_s, &scenario.speed_rad_s);
        let per_unit = torque_per_unit(model, scenario);
        let spans = spans(scenario, all, speeds, (half, noise.dead_zone_rad_s), None);
        for (begin, end) in spans.windows {
            // No window with a gap of half of its length.
            let times = &all[begin..=end];
            if times.windows(2).any(|pair| pair[1] - pair[0] > longest_s) {
                continue;
            }
            let (window, driving) = window(scenario, all, (begin, end), spans.most_s);
            let mut speeds = speeds[begin..=end].iter();
            let is_at_rest = equation == Balance::Torque
                && speeds.any(|speed| speed.abs() <= noise.dead_zone_rad_s);
            let cell = |column: &Column| match column {
                Column::Values(values) => window.mean(values),
                Column::Rate(values) => window.mean_rate(values),
            };
            let cells: Vec<f64> = columns.iter().map(cell).collect();
            let mut left = driving.map_or_else(|| window.mean(&lefts), |mean| per_unit * mean);
            if is_at_rest || !left.is_finite() || cells.iter().any(|cell| !cell.is_finite()) {
                continue;
            }
            for (cell, unknown) in cells.iter().zip(&unknowns) {
                left -= unknown.fixed.unwrap_or(0.0) * cell;
            }
            rows.push(free.iter().map(|index| cells[*index]).collect::<Vec<f64>>());
            right.push(left);
            let gains = window.gains();
            (gain, rate_gain) = (f64::max(gain, gains.0), f64::max(rate_gain, gains.1));
            windows.push(window);
        }
        let mut matrix = DMatrix::from_fn(rows.len(), free.len(), |r, c| rows[r][c]);
        if equation == Balance::Torque && scenario.input_channel == Channel::Current {
            let (currents, noise) = (&scenario.current_a, [noise.current_a, noise.speed_rad_s]);
            let weights = between_samples::weights(&windows, currents, speeds, noise);
            for (row, weight) in weights.iter().enumerate() {
                matrix.row_mut(row).scale_mut(*weight);
                right[row] *= weight;
            }
        }
        Self {
            equation,
            matrix,
            right: DVector::from_vec(right),
            unknowns,
            windows,
            gain,
            rate_gain,
        }
    }

    fn solve(&self, begin_s: f64, block_s: f64) -> Option<least_squares::Solution> {
        let block = |window: &Window| whole((window.middle_s - begin_s) / block_s);
        let blocks: Vec<usize> = self.windows.iter().map(block).collect();
        least_squares::solve(&self.matrix, &self.right, &blocks)
    }

    fn errors(
        &self,
        solution: &least_squares::Solution,
        coarse: Option<&least_squares::Solution>,
        noise: &Noise,
    ) -> Vec<Errors> {
        let (bread, _) = least_squares::inverse_where_determined(&self.matrix);
        // Power of the part of a column that the others do not explain.
        let partial = |column: usize| 1.0 / bread[(column, column)].max(f64::MIN_POSITIVE);
        let free = self.unknowns.iter().filter(|it| it.fixed.is_none());
        let power: Vec<f64> = free
            .map(|unknown| {
                let spread = noise.spread(&unknown.slot, self.gain, self.rate_gain);
                self.windows.len() as f64 * spread * spread
            })
            .collect();
        // Noise in one regressor biases every coefficient that is correlated with it. A coefficient that is lost in noise may have any
        // value up to that which explains the whole left-hand side.
        let is_lost = |other: usize| partial(other) < LEAST_SIGNAL * power[other];
        let bias = |column: usize, other: usize| {
            let slope = bread[(column, other)];
            let bias = if is_lost(other) {
                let most = self.right.norm() / self.matrix.column(other).norm();
                slope * partial(other) * most
            } else {
                slope * power[other] * solution.x[other]
            };
            if bias.is_finite() { bias } else { 0.0 }
        };
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        let columns = || 0..power.len();
        let errors = |column: usize| {
            let change = coarse.map_or(0.0, |coarse| (coarse.x[column] - solution.x[column]).abs());
            let uncertainty = |other: usize| {
                let share = if is_lost(other) { 1.0 } else { noise.uncertainty };
                share * bias(column, other).abs()
            };
            // The partial column is a sum of regressors, and its noise that of each with its coefficient.
            let noise_power = |other: usize| {
                finite((bread[(column, other)] * partial(column)).powi(2) * power[other])
            };
            let known = columns().filter(|other| !is_lost(*other));
            Errors {
                sampling: finite(change / SAMPLING_ORDER),
                attenuation: known.map(|other| bias(column, other)).sum(),
                noise: columns().map(uncertainty).sum(),
                signal: partial(column)
                    / columns().map(noise_power).sum::<f64>().max(f64::MIN_POSITIVE),
            }
        };
        columns().map(errors).collect()
    }
}

/// Windows, by their first and last samples.
struct Spans {
    windows: Vec<(usize, usize)>,
    /// Whether they are integrals of different lengths: the longest, s.
    most_s: Option<f64>,
}

/// Windows half a window apart; where a commanded current steps, between two steps and on one side of standstill: the time that the
/// drive takes for a step is not known, nor where between two samples the friction changes its sign. A shaft that is braked within a few
/// rows is in none of these: where they have less than half of the share of braking, integrals over as many rows as there are, unless
/// `between_steps` states whether they are integrals.
fn spans(
    scenario: &Scenario,
    times: &[f64],
    speeds: &[f64],
    (half, dead_zone): (usize, f64),
    between_steps: Option<bool>,
) -> Spans {
    let smooth = |(begin, end): &(usize, usize)| {
        let begins =
            (*begin..=*end).step_by(half).take_while(move |begin| begin + 2 * half <= *end);
        begins.map(|begin| (begin, begin + 2 * half)).collect::<Vec<_>>()
    };
    if scenario.current_steps_s.is_empty() && between_steps != Some(true) {
        let windows = smooth(&(0, times.len().saturating_sub(1)));
        return Spans { windows, most_s: None };
    }
    let period_s = statistics::median_step(times);
    let stretches = |margins: [f64; 2]| {
        let goes_on = |sample: usize| {
            let (from_s, to_s) = (times[sample - 1], times[sample]);
            let [from_s, to_s] = [from_s - margins[0] * period_s, to_s + margins[1] * period_s];
            let next = scenario.current_steps_s.partition_point(|step_s| *step_s < from_s);
            let [before, after] = [speeds[sample - 1], speeds[sample]];
            before.abs().min(after.abs()) > dead_zone
                && before * after > 0.0
                && times[sample] - times[sample - 1] <= half as f64 * period_s
                && scenario.current_steps_s.get(next).is_none_or(|step_s| *step_s > to_s)
        };
        let samples: Vec<usize> = (0..times.len()).collect();
        let parts = samples.chunk_by(|_, sample| goes_on(*sample));
        parts.map(|part| (part[0], part[part.len() - 1])).collect::<Vec<_>>()
    };
    let braking_share = |windows: &[(usize, usize)]| {
        let energy_j = |(begin, end): &(usize, usize)| {
            speeds[*begin] * signal::integral(&scenario.events, times[*begin], times[*end])
        };
        let energies = windows.iter().map(energy_j);
        let whole: f64 = energies.clone().map(f64::abs).sum();
        energies.map(|energy| (-energy).max(0.0)).sum::<f64>() / whole.max(f64::MIN_POSITIVE)
    };
    let windows: Vec<_> = stretches([1.0; 2]).iter().flat_map(smooth).collect();
    // On five records of 20 Hz any margin from .1 to .9 of a period gives the same values; without one the inertia is up to 1 % too large.
    let pieces = |(begin, end): &(usize, usize)| {
        let end = *end;
        let begins = (*begin..end).step_by(2 * half);
        begins.map(move |begin| (begin, end.min(begin + 2 * half))).collect::<Vec<_>>()
    };
    let integrals: Vec<_> = stretches([0.5, 0.0]).iter().flat_map(pieces).collect();
    let misses_braking = || 2.0 * braking_share(&windows) < braking_share(&integrals);
    if between_steps.unwrap_or_else(misses_braking) {
        return Spans { windows: integrals, most_s: Some(2.0 * half as f64 * period_s) };
    }
    Spans { windows, most_s: None }
}

/// The window over a span; of an integral also that of the input, both divided by its longest length `most_s`.
fn window(
    scenario: &Scenario,
    times: &[f64],
    (begin, end): (usize, usize),
    most_s: Option<f64>,
) -> (Window, Option<f64>) {
    most_s.map_or_else(
        || (Window::new(times, begin, end), None),
        |most_s| {
            let impulse = signal::integral(&scenario.events, times[begin], times[end]);
            (Window::integral(times, begin, end, most_s), Some(impulse / most_s))
        },
    )
}

/// Angle of the shaft at every sample, measured or the integral of the speed; NaN where there is none.
fn angles(scenario: &Scenario) -> Vec<f64> {
    let shaft = scenario.shaft_angle();
    scenario.sample_time_s.iter().map(|time_s| signal::line(&shaft, *time_s)).collect()
}

/// Left-hand side of a balance at the samples: voltage, or motor torque.
fn left(model: &Model, scenario: &Scenario, equation: Balance) -> Vec<f64> {
    match (equation, scenario.input) {
        (Balance::Voltage, _) => scenario.held_means(),
        (Balance::Torque, Input::Torque) => {
            scenario.sample_time_s.iter().map(|time_s| scenario.input_at(*time_s)).collect()
        }
        (Balance::Torque, Input::Voltage | Input::Current) => {
            let kt = torque_per_unit(model, scenario);
            scenario.current_a.iter().map(|current| kt * current).collect()
        }
    }
}

/// Torque per unit of what drives the run: of a current the torque constant.
fn torque_per_unit(model: &Model, scenario: &Scenario) -> f64 {
    match scenario.input {
        Input::Torque => 1.0,
        Input::Voltage | Input::Current => model.motor.torque_constant().unwrap_or(f64::NAN),
    }
}

fn half_window(scenario: &Scenario, equation: Balance) -> usize {
    let period_s = statistics::mean_step(&scenario.sample_time_s);
    // The armature circuit is faster than the shaft.
    let responses = match equation {
        Balance::Voltage => 0.3,
        Balance::Torque => TORQUE_HALF_RESPONSES,
    };
    let half_s = scenario.scales.responses(responses);
    whole((half_s / period_s).round()).max(FEWEST_HALF)
}

/// Every second sample; the input stays as it was.
fn thinned(scenario: &Scenario) -> Scenario {
    let every_second = |values: &[f64]| values.iter().copied().step_by(2).collect::<Vec<f64>>();
    let mut thin = scenario.clone();
    thin.sample_time_s = every_second(&scenario.sample_time_s);
    thin.current_a = every_second(&scenario.current_a);
    thin.speed_rad_s = every_second(&scenario.speed_rad_s);
    thin.time_half_width_s = every_second(&scenario.time_half_width_s);
    thin.scored = 0..thin.sample_time_s.len();
    thin
}

/// Measurement noise: standard deviations over the leading standstill, else from the roughness of the signals.
struct Noise {
    current_a: f64,
    speed_rad_s: f64,
    /// Speed below which the shaft may stick, so that the friction is not determined, rad/s.
    dead_zone_rad_s: f64,
    from_standstill: bool,
    /// Relative standard deviation of the noise power.
    uncertainty: f64,
}

impl Noise {
    fn of(scenario: &Scenario) -> Self {
        let floor = NoiseFloor::from_standstill(scenario);
        let or_roughness = |still: Option<f64>, values: &[f64]| {
            still.filter(|sigma| sigma.is_finite()).unwrap_or_else(|| roughness(values))
        };
        let speed_rad_s = or_roughness(floor.map(|f| f.speed_rad_s), &scenario.speed_rad_s);
        let largest = largest_but_outliers(&scenario.speed_rad_s);
        Self {
            current_a: or_roughness(floor.map(|f| f.current_a), &scenario.current_a),
            speed_rad_s,
            dead_zone_rad_s: (4.0 * speed_rad_s).min(0.1 * largest).max(0.01 * largest),
            from_standstill: floor.is_some(),
            // Of a variance from n samples; all of it for a roughness, which also contains some of the signal.
            uncertainty: floor.map_or(1.0, |f| (2.0 / f.samples as f64).sqrt()),
        }
    }

    /// Standard deviation by noise of the regressor of one parameter in one window; `gain` and `rate_gain` are the norms of the
    /// weights.
    fn spread(&self, slot: &Slot, gain: f64, rate_gain: f64) -> f64 {
        match slot {
            Slot::Motor(MotorKey::Resistance) => self.current_a * gain,
            Slot::Motor(MotorKey::Inductance) => self.current_a * rate_gain,
            Slot::Motor(MotorKey::BackEmf) => self.speed_rad_s * gain,
            Slot::Motor(MotorKey::Inertia) => self.speed_rad_s * rate_gain,
            Slot::Motor(_) | Slot::Effect { .. } => 0.0,
        }
    }

    /// `sV^2 = (R si k0)^2 + (Ke sw k0)^2 + (L si k1)^2`, `sM^2 = (Kt si k0)^2 + (J sw k1)^2`.
    fn floor(
        &self,
        system: &System,
        parameters: &[ParameterEstimate],
        model: &Model,
    ) -> Option<f64> {
        let value = |key: MotorKey| Some(ParameterEstimate::value_of(parameters, key.key())?.abs());
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

/// Rows of the torque balance over the scored part of `scenario`, for any terms. `None` without a window: the run has no torque
/// (or no torque constant for its current), or the shaft hardly moves.
///
/// Windows of 60 ms that overlap by half, test function `(1 - s^2)^4`, trapezoidal rule on the true stamps (or integrals between the
/// steps of a commanded current); windows with a speed within the dead zone are left out. A held torque (a reading is put halfway to
/// its neighbours) has at each sample its mean over
/// half a period on either side, else it would be delayed by half a sample. On the EMPS axis, at 1 kHz, that is the difference
/// between a relative error of 3.40 % (2.04 % with friction that differs by direction) and one of 3.17 % (1.63 %).
///
/// `between_steps`: whether the rows are such integrals, as those of another run with which these are compared; by itself where `None`.
pub fn torque_rows(
    model: &Model,
    scenario: &Scenario,
    between_steps: Option<bool>,
) -> Option<TorqueRows> {
    let noise = Noise::of(scenario);
    let (at, left) = samples(model, scenario);
    let times: Vec<f64> = at.iter().map(|at| at.time_s + scenario.begin_s()).collect();
    if times.len() < 2 * FEWEST_HALF {
        return None;
    }
    let period_s = statistics::median_step(&times);
    let half_s = scenario.scales.responses(TORQUE_HALF_RESPONSES);
    let half = whole((half_s / period_s).round()).max(FEWEST_HALF);
    let nominal_s = 2.0 * half as f64 * period_s;
    let (scored_from_s, scored_to_s) = scored_s(scenario)?;
    // Windows over the samples that have a speed.
    let speeds: Vec<f64> = at.iter().map(|at| at.speed_rad_s).collect();
    let slow_rad_s = REVERSAL_SHARE * largest_but_outliers(&speeds);
    let dead_zone_rad_s = noise.dead_zone_rad_s.max(slow_rad_s);
    let (mut windows, mut inertia, mut lefts) = (Vec::new(), Vec::new(), Vec::new());
    let (mut used, mut gain, mut rate_gain) = (Vec::new(), 0.0, 0.0);
    let per_unit = torque_per_unit(model, scenario);
    let spans = spans(scenario, &times, &speeds, (half, dead_zone_rad_s), between_steps);
    for (begin, end) in spans.windows {
        let is_at_rest = (speeds[begin..=end].iter()).any(|speed| speed.abs() <= dead_zone_rad_s);
        // A longer one contains a hole in the data.
        let is_complete = times[end] - times[begin] <= 2.0 * nominal_s;
        let scored = times[begin] >= scored_from_s && times[end] <= scored_to_s;
        if is_at_rest || !is_complete || !scored {
            continue;
        }
        let (window, driving) = window(scenario, &times, (begin, end), spans.most_s);
        let mean = driving.map_or_else(|| window.mean(&left), |mean| per_unit * mean);
        let rate = window.mean_rate(&speeds);
        if !(rate.is_finite() && mean.is_finite()) {
            continue;
        }
        let gains = window.gains();
        (gain, rate_gain) = (f64::max(gain, gains.0), f64::max(rate_gain, gains.1));
        inertia.push(rate);
        lefts.push(mean);
        used.extend(driving.map(|_| (begin, end)));
        windows.push(window);
    }
    if windows.is_empty() {
        return None;
    }
    let time_s = windows.iter().map(|window| window.middle_s).collect();
    let is_sampled = scenario.input_channel == Channel::Current;
    let weights = if is_sampled {
        let currents: Vec<f64> = at.iter().map(|at| at.current_a).collect();
        let noise = [noise.current_a, noise.speed_rad_s];
        between_samples::weights(&windows, &currents, &speeds, noise)
    } else {
        Vec::new()
    };
    let averaging = move |values: &[f64]| -> Vec<f64> {
        windows.iter().map(|window| window.mean(values)).collect()
    };
    Some(TorqueRows {
        method: Method::WeakForm,
        derivation: if used.is_empty() {
            Derivation::WeakForm { window_s: nominal_s, dead_zone_rad_s }
        } else {
            Derivation::BetweenSteps { most_s: nominal_s, dead_zone_rad_s }
        },
        begin_s: scenario.begin_s(),
        scales: scenario.scales,
        time_s,
        left: lefts,
        spans: used,
        inertia,
        gain,
        rate_gain,
        span_s: nominal_s,
        at,
        weights,
        averaging: Box::new(averaging),
    })
}

/// Instants of the samples that have a speed, and the motor's torque there.
fn samples(model: &Model, scenario: &Scenario) -> (Vec<Instant>, Vec<f64>) {
    let angles = scenario.shaft_angle();
    let angle_at = |time_s: f64| match (angles.first(), angles.last()) {
        (Some(first), Some(last)) => {
            signal::line_across(&angles, time_s.clamp(first.0, last.0), f64::INFINITY)
        }
        _ => f64::NAN,
    };
    let commanded_s: Vec<f64> = scenario.events.iter().map(|event| event.0).collect();
    let step_s = statistics::median_step(&commanded_s);
    let longest_gap_s = if step_s.is_finite() { 5.0 * step_s } else { 0.0 };
    let kt = torque_per_unit(model, scenario);
    let constants = Instant::of(&model.motor).in_run(scenario);
    let (mut at, mut left) = (Vec::new(), Vec::new());
    for (sample, &time_s) in scenario.sample_time_s.iter().enumerate() {
        let speed_rad_s = scenario.speed_rad_s[sample];
        if !speed_rad_s.is_finite() {
            continue;
        }
        let (current_a, torque_n_m, torque_n_m_per_a) = if scenario.input == Input::Torque {
            // In a hole of the torque its value is not known.
            let is_known = signal::line_across(&scenario.events, time_s, longest_gap_s).is_finite();
            let torque = if is_known { scenario.held_mean(sample) } else { f64::NAN };
            (torque, torque, 1.0)
        } else {
            let current = scenario.current_a[sample];
            (current, kt * current, kt)
        };
        at.push(Instant {
            time_s: time_s - scenario.begin_s(),
            voltage_v: f64::NAN,
            current_a,
            speed_rad_s,
            // Beyond the ends of the angle its nearest value.
            angle: ShaftAngle::at(angle_at(time_s)),
            torque_n_m_per_a,
            ..constants
        });
        left.push(torque_n_m);
    }
    (at, left)
}

#[cfg(test)]
mod tests;
