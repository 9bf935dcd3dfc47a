//! Weak form: both balances averaged over windows with a smooth test function, nothing differentiated.
//!
//! DISCOVERY.md 2.9. With `psi(s) = (1 - s^2)^4` on a window of half length `H`, integration by parts turns a derivative
//! into one of the test function: `<f'> = -<psi_s f>/H`. Linear in the parameters, no starting values, and the only
//! method for runs that carry torque and motion but no voltage. The price: the signals must be sampled several times
//! per time constant (at 10 ms the armature circuit is not), and an effect's shape parameters stay as they are given.
//! What that costs is measured, not assumed: the same fit with every second sample left out moves each value, and for a
//! quadrature of second order a third of the move is the error at the full rate, of first order all of it; the current has
//! a corner at each step of the voltage, so the move over 1.5 is taken and added to the uncertainty. Noise in
//! a regressor pulls its value towards zero: the pull follows from the noise, is taken back, and what is not known of it
//! is added too. A torque constant found in the same run hands its uncertainty on to everything in the torque balance.
//!
//! Voltage: `<u> = R <i> + L <i'> + Ke <w> + effects`. Torque: `Kt <i> = J <w'> + Mc <sgn w> + effects`.

mod noise_share;
mod torque_rows;
mod window;

pub use self::torque_rows::torque_rows;

use nalgebra::{DMatrix, DVector};

use self::noise_share::Noise;
use self::window::{
    Window, half_window, held_means, held_values, interpolated, mean_period_s, thinned,
};
use super::output_error::{BLOCK_S, FitError};
use super::regressor::{PROPORTIONAL, why_no_regressor};
use super::verdict::judge;
use crate::numerics::least_squares;
use crate::plant::{Balance, Input, Instant, Model, MotorKey, Scenario, ShaftAngle, Slot};
use crate::sample::{ParameterEstimate, Verdict};

/// Half length of the windows, s: the armature circuit is faster than the shaft.
const VOLTAGE_HALF_S: f64 = 0.012;
const TORQUE_HALF_S: f64 = 0.03;
/// Samples that a half window has at least.
const FEWEST_HALF: usize = 4;
/// Speeds below this share of the largest count as standstill, where friction is not determined; so does what lies
/// within four standard deviations of the speed's noise, up to the second share.
const DEAD_ZONE: f64 = 0.01;
const WIDEST_DEAD_ZONE: f64 = 0.1;
/// Move by leaving out every second sample over the error at the full rate: between first order (1) and second (3).
const SAMPLING_ORDER: f64 = 1.5;
/// A regressor whose own part is less than this many times its noise (in power) carries no information.
const LEAST_SIGNAL: f64 = 4.0;

/// Estimates of one balance with its residual.
#[derive(Clone, Debug)]
pub struct Balanced {
    pub equation: Balance,
    pub parameters: Vec<ParameterEstimate>,
    /// What the balance misses in each window.
    pub residual: Vec<WindowResidual>,
    /// Root mean square that measurement noise alone would leave in the residual, V or N.m; `None` where the run has no
    /// standstill to tell the noise (DISCOVERY.md 2.9).
    pub noise_floor: Option<f64>,
    /// Root mean square of the left-hand side, V or N.m: what the residual is compared with.
    pub level: f64,
    pub windows_dropped: usize,
}

/// One window of a balance: where the machine was, and what is missing there. NaN where a signal is not measured.
#[derive(Clone, Copy, Debug)]
pub struct WindowResidual {
    /// Middle of the window.
    pub time_s: f64,
    /// V or N.m.
    pub residual: f64,
    pub speed_rad_s: f64,
    pub current_a: f64,
    pub angle_rad: f64,
}

/// Fits both balances (the torque balance alone where there is no voltage).
pub fn fit(model: &Model, scenario: &Scenario) -> Result<Vec<Balanced>, FitError> {
    Ok(fit_both(model, scenario).0)
}

/// The balances, and the model with what the voltage balance found, which the torque balance was fitted with.
fn fit_both(model: &Model, scenario: &Scenario) -> (Vec<Balanced>, Model) {
    let mut balances = Vec::new();
    let mut model = model.clone();
    let given = model.motor.get(MotorKey::TorqueConstant).is_some();
    // Relative standard deviation of the torque constant.
    let mut doubt_of_torque = 0.0;
    if scenario.input == Input::Voltage {
        let voltage = balance(&model, scenario, Balance::Voltage, 0.0);
        for estimate in &voltage.parameters {
            if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
                model.motor.set(key, value);
                if key == MotorKey::BackEmf && !given {
                    doubt_of_torque = estimate.std.unwrap_or(0.0) / value.abs();
                }
            }
        }
        balances.push(voltage);
    }
    balances.push(balance(&model, scenario, Balance::Torque, doubt_of_torque));
    (balances, model)
}

/// Both balances as linear systems, for those who try columns of their own in them.
pub fn regressions(model: &Model, scenario: &Scenario) -> Vec<Regression> {
    let (balances, model) = fit_both(model, scenario);
    balances
        .into_iter()
        .map(|balanced| {
            let equation = balanced.equation;
            let half = half_window(scenario, equation);
            let system = System::new(&model, scenario, equation, half, &Noise::of(scenario));
            Regression {
                blocks: system.blocks(scenario.sample_time_s[0]),
                matrix: system.matrix,
                right: system.right,
                time_s: system.windows.iter().map(|window| window.time_s).collect(),
                averages: system.averages,
                noise_floor: balanced.noise_floor,
                equation,
                model: model.clone(),
            }
        })
        .collect()
}

/// One balance as a linear system: a row for each usable window.
pub struct Regression {
    pub equation: Balance,
    /// What one unit of each free parameter contributes.
    pub matrix: DMatrix<f64>,
    /// Left-hand side, V or N.m.
    pub right: DVector<f64>,
    /// Block of time that each window belongs to, for clustered covariances.
    pub blocks: Vec<usize>,
    /// Middle of each window.
    pub time_s: Vec<f64>,
    /// As in [`Balanced`].
    pub noise_floor: Option<f64>,
    /// The model with the torque constant that the left-hand side was made with.
    pub model: Model,
    averages: Vec<Window>,
}

impl Regression {
    /// Average over each window of a value that every sample has.
    pub fn means(&self, value: impl Fn(usize) -> f64) -> DVector<f64> {
        let rows = self.averages.iter().map(|window| window.mean_of(&value));
        DVector::from_iterator(self.averages.len(), rows)
    }
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

/// One unknown of a balance: how it is judged and what stands beside it in the sum.
struct Unknown {
    slot: Slot,
    fixed: Option<f64>,
}

/// `doubt_of_left`: relative standard deviation of a factor of the left-hand side.
fn balance(model: &Model, scenario: &Scenario, equation: Balance, doubt_of_left: f64) -> Balanced {
    let half = half_window(scenario, equation);
    let noise = Noise::of(scenario);
    let system = System::new(model, scenario, equation, half, &noise);
    let begin_s = scenario.sample_time_s[0];
    let solution = system.solve(begin_s);
    // The same windows in time with half of the samples.
    let coarse = System::new(
        model,
        &thinned(scenario),
        equation,
        (half / 2).max(2),
        &noise,
    )
    .solve(begin_s);
    let period_s = (scenario.sample_time_s[scenario.samples() - 1] - begin_s)
        / (scenario.samples() - 1) as f64;
    let doubts = solution
        .as_ref()
        .map(|solution| system.doubts(solution, coarse.as_ref(), &noise));
    let mut place = 0;
    let mut parameters = Vec::with_capacity(system.unknowns.len());
    for unknown in &system.unknowns {
        if unknown.fixed.is_some() {
            parameters.push(fixed(unknown));
            continue;
        }
        parameters.push(match (&solution, &doubts) {
            (Some(solution), Some(doubts)) => {
                let value = solution.x[place] + doubts[place].pulled;
                // Not a number where it is undetermined.
                let variance =
                    solution.covariance[(place, place)] + (doubt_of_left * value).powi(2);
                estimate(unknown, value, variance, &doubts[place], period_s)
            }
            _ => ParameterEstimate::not_observable(
                &unknown.slot.key(),
                unknown.slot.unit(),
                why_too_few(system.windows.len(), model, scenario, equation),
            ),
        });
        place += 1;
    }
    let noise_floor = noise.floor(&system, &parameters, model);
    let residual = solution.map_or_else(Vec::new, |solution| {
        let residuals = system.windows.iter().zip(solution.residual.iter());
        residuals
            .map(|(window, residual)| WindowResidual {
                residual: *residual,
                ..*window
            })
            .collect()
    });
    Balanced {
        equation,
        parameters,
        residual,
        noise_floor,
        level: system.right.norm() / (system.right.len().max(1) as f64).sqrt(),
        windows_dropped: system.dropped,
    }
}

/// What the covariance does not know of one value.
struct Doubt {
    /// Error by coarse sampling.
    sampling: f64,
    /// Pull by noise in the regressors, taken back.
    pulled: f64,
    /// What is not known of the pull.
    noise: f64,
    /// Power of the regressor's own part over that of its noise.
    signal: f64,
}

fn estimate(
    unknown: &Unknown,
    value: f64,
    variance: f64,
    doubt: &Doubt,
    period_s: f64,
) -> ParameterEstimate {
    if doubt.signal < LEAST_SIGNAL {
        let reason = format!(
            "what only this parameter explains is {:.1} times its noise, at least {LEAST_SIGNAL} is needed: \
             the run does not excite it",
            doubt.signal
        );
        return ParameterEstimate::not_observable(&unknown.slot.key(), unknown.slot.unit(), reason);
    }
    let extra = doubt.sampling.powi(2) + doubt.noise.powi(2);
    let mut judged = judge(
        &unknown.slot,
        value,
        Some((variance + extra).sqrt()),
        period_s,
    );
    if let Some(reason) = judged.reason.as_mut()
        && doubt.sampling.powi(2) > variance
    {
        let moved = format!(
            "; half the samples move it by {:.1} %: sample faster, or use the output-error fit",
            100.0 * SAMPLING_ORDER * doubt.sampling / value.abs().max(f64::MIN_POSITIVE)
        );
        reason.push_str(&moved);
    }
    judged
}

/// The linear system of one balance: one row per usable window.
struct System {
    equation: Balance,
    unknowns: Vec<Unknown>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    windows: Vec<WindowResidual>,
    averages: Vec<Window>,
    dropped: usize,
    /// Norms of a window's weights, and of its weights for a rate: what noise makes of a mean.
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
        let unknowns = unknowns(model, scenario, equation);
        let signals = Signals::new(model, scenario, equation);
        let free: Vec<usize> = (0..unknowns.len())
            .filter(|index| unknowns[*index].fixed.is_none())
            .collect();
        let (mut rows, mut right, mut windows) = (Vec::new(), Vec::new(), Vec::new());
        let mut averages = Vec::new();
        let (mut dropped, mut gain, mut rate_gain) = (0, 0.0, 0.0);
        let longest_s = half as f64 * mean_period_s(scenario);
        for begin in (0..scenario.samples().saturating_sub(2 * half)).step_by(half) {
            let end = begin + 2 * half;
            // Half of the window in one step: it would be made of two ends.
            let times = &scenario.sample_time_s[begin..=end];
            if times.windows(2).any(|pair| pair[1] - pair[0] > longest_s) {
                dropped += 1;
                continue;
            }
            let window = Window::new(scenario, begin, end);
            let resting = equation == Balance::Torque
                && scenario.speed_rad_s[begin..=end]
                    .iter()
                    .any(|speed| speed.abs() <= noise.dead_zone_rad_s);
            let cells: Vec<f64> = unknowns
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
            rows.push(free.iter().map(|index| cells[*index]).collect::<Vec<f64>>());
            right.push(left);
            let norm = |weights: &[f64]| weights.iter().map(|w| w * w).sum::<f64>().sqrt();
            (gain, rate_gain) = (norm(&window.weights), norm(&window.rates));
            windows.push(WindowResidual {
                time_s: window.middle_s,
                residual: f64::NAN,
                speed_rad_s: window.mean(&scenario.speed_rad_s),
                current_a: window.mean(&scenario.current_a),
                angle_rad: window.mean(&signals.angle),
            });
            averages.push(window);
        }
        Self {
            equation,
            matrix: DMatrix::from_fn(rows.len(), free.len(), |r, c| rows[r][c]),
            right: DVector::from_vec(right),
            unknowns,
            windows,
            averages,
            dropped,
            gain,
            rate_gain,
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "blocks are counted from the begin of the run"
    )]
    fn blocks(&self, begin_s: f64) -> Vec<usize> {
        let block = |window: &WindowResidual| ((window.time_s - begin_s) / BLOCK_S) as usize;
        self.windows.iter().map(block).collect()
    }

    fn solve(&self, begin_s: f64) -> Option<least_squares::Solution> {
        least_squares::solve(&self.matrix, &self.right, &self.blocks(begin_s))
    }

    fn doubts(
        &self,
        solution: &least_squares::Solution,
        coarse: Option<&least_squares::Solution>,
        noise: &Noise,
    ) -> Vec<Doubt> {
        let (bread, _) = least_squares::inverse_where_determined(&self.matrix);
        let free: Vec<&Unknown> = self
            .unknowns
            .iter()
            .filter(|unknown| unknown.fixed.is_none())
            .collect();
        let own = |place: usize| 1.0 / bread[(place, place)].max(f64::MIN_POSITIVE);
        let power: Vec<f64> = free
            .iter()
            .map(|unknown| {
                let spread = noise.spread(&unknown.slot, self.gain, self.rate_gain);
                self.windows.len() as f64 * spread * spread
            })
            .collect();
        // Noise in one regressor pulls every value that shares its direction. Where a value is lost in noise, it may be
        // anything up to what would explain the whole left-hand side.
        let lost = |other: usize| own(other) < LEAST_SIGNAL * power[other];
        let pull = |place: usize, other: usize| {
            let slope = bread[(place, other)];
            if lost(other) {
                let most = self.right.norm() / self.matrix.column(other).norm();
                slope * own(other) * most
            } else {
                slope * power[other] * solution.x[other]
            }
        };
        let finite = |pull: f64| if pull.is_finite() { pull } else { 0.0 };
        (0..free.len())
            .map(|place| Doubt {
                sampling: coarse
                    .map(|coarse| (coarse.x[place] - solution.x[place]).abs() / SAMPLING_ORDER)
                    .filter(|moved| moved.is_finite())
                    .unwrap_or(0.0),
                pulled: (0..free.len())
                    .filter(|other| !lost(*other))
                    .map(|other| finite(pull(place, other)))
                    .sum(),
                noise: (0..free.len())
                    .map(|other| {
                        let share = if lost(other) { 1.0 } else { noise.uncertainty };
                        share * finite(pull(place, other)).abs()
                    })
                    .sum(),
                // The own part is a sum of regressors: the noise of each counts by its share in it.
                signal: own(place)
                    / (0..free.len())
                        .map(|other| {
                            finite((bread[(place, other)] * own(place)).powi(2) * power[other])
                        })
                        .sum::<f64>()
                        .max(f64::MIN_POSITIVE),
            })
            .collect()
    }
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
    let electrical = scenario.input == Input::Voltage;
    let effects = model.slots().into_iter().filter(|slot| match slot {
        Slot::Effect { index, spec, .. } => {
            let enters = model.effects[*index]
                .effect
                .card()
                .enters
                .includes(equation);
            enters
                && spec.is_coefficient()
                && why_no_regressor(&model.effects[*index], &model.motor, electrical).is_none()
                && (equation == Balance::Torque || electrical)
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
    /// Input at the samples: the voltage, where the run has one.
    voltage: Vec<f64>,
    sign: Vec<f64>,
    equation: Balance,
    /// Angle of the shaft at the samples, measured or the integral of the speed; NaN where there is none.
    angle: Vec<f64>,
    supply_v: f64,
}

/// Angle of the shaft at every sample, measured or the integral of the speed; NaN where there is none.
pub fn angles(scenario: &Scenario) -> Vec<f64> {
    let shaft = scenario.shaft_angle();
    let times = scenario.sample_time_s.iter();
    times.map(|time_s| interpolated(&shaft, *time_s)).collect()
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
            equation,
            voltage: match equation {
                Balance::Voltage => left.clone(),
                Balance::Torque => held_means(scenario),
            },
            left,
            sign,
            supply_v: scenario.supply_v(),
            angle: angles(scenario),
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

    /// What the effect's coefficient adds per unit, of a size so small that the effect is proportional to it, at one sample.
    fn effect(&self, index: usize, parameter: usize, sample: usize) -> f64 {
        let active = &self.model.effects[index];
        let mut values = active.values_or_guess();
        let size = PROPORTIONAL * active.effect.parameters()[parameter].scale;
        for (other, spec) in active.effect.parameters().iter().enumerate() {
            if spec.is_coefficient() {
                values[other] = if other == parameter { size } else { 0.0 };
            }
        }
        let terms = active.effect.terms(&values);
        let at = Instant {
            time_s: self.scenario.sample_time_s[sample] - self.scenario.begin_s(),
            voltage_v: self.voltage[sample],
            supply_v: self.supply_v,
            current_a: self.scenario.current_a[sample],
            speed_rad_s: self.scenario.speed_rad_s[sample],
            angle: ShaftAngle::at(self.angle[sample]),
            ..Instant::of(&self.model.motor)
        };
        let own = vec![0.0; terms.states()];
        let added = match self.equation {
            Balance::Voltage => terms.voltage_v(&at, &own),
            Balance::Torque => {
                terms.torque_n_m(&at, &own) + self.sign[sample] * terms.friction_n_m(&at)
            }
        };
        added / size
    }
}

#[cfg(test)]
mod tests;
