//! Scheme 1 without the bias of sensor noise: refined instrumental variables over a whole run.
//!
//! The instruments are the rows of an auxiliary model that is simulated from the voltage alone (true stick-slip), so no
//! noise of the speed is in them; sign and usable rows come from that model too. Rows and instruments are filtered by
//! `1/A(z)` of the last estimate, which makes the noise of the speed nearly white and the estimate nearly efficient
//! (Young, *Recursive Estimation and Time-Series Analysis* (2011), chapter 7; Soderstrom and Stoica, *Instrumental
//! Variable Methods for System Identification* (1983)). Within a chain of consecutive rows the filter starts from zero, so
//! the filtered equation stays exact.

use nalgebra::{SMatrix, SVector};
use thiserror::Error;

use super::inverse::{Coefficients, Dynamics, Form, Scheme1Rejection, propagate};
use super::recursive::Scheme1;
use super::rows::{self, Reading};
use crate::numerics::count::whole;
use crate::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State};
use crate::sample::Channel;

type M5 = SMatrix<f64, 5, 5>;
type M4 = SMatrix<f64, 4, 4>;
type V4 = SVector<f64, 4>;
type V5 = SVector<f64, 5>;

/// Rounds without a Newton step, ended early by this relative change, and all together.
const PLAIN_ROUNDS: usize = 6;
const NEAR: f64 = 1e-3;
const MOST_ROUNDS: usize = 16;
/// The slope of a round is taken anew after so many.
const SLOPE_ROUNDS: usize = 6;
/// The end: a step of less than this share of the standard deviation, or of the value.
const CONVERGED_DEVIATIONS: f64 = 0.1;
const CONVERGED: f64 = 1e-6;
/// Share of the auxiliary model's largest speed below which it counts as standing.
const DEAD_ZONE: f64 = 0.02;
/// Smallest singular value of the scaled normal matrix that counts as excited.
const LEAST_EXCITATION: f64 = 1e-10;
const FEWEST_ROWS: usize = 30;
/// Clusters of the covariance, at least.
const CLUSTERS: usize = 20;

/// Equidistant samples.
#[derive(Clone, Copy, Debug)]
pub struct Series<'a> {
    pub period_s: f64,
    /// `voltage_v[k]`: mean voltage applied over the period that ends at sample `k`; the first is not used.
    pub voltage_v: &'a [f64],
    /// Measured speed, NaN where missing.
    pub speed_rad_s: &'a [f64],
}

/// What the instrumental variables found.
#[derive(Clone, Copy, Debug)]
pub struct Instrumental {
    pub dynamics: Dynamics,
    /// Sandwich covariance of (Ta, TM, Ke, load voltage), clustered over stretches longer than the time constants.
    pub covariance: [[f64; 4]; 4],
    pub coefficients: Coefficients,
    /// In the order of the fields of [`Coefficients`].
    pub coefficient_covariance: [[f64; 5]; 5],
    pub rows: usize,
    pub rounds: usize,
    pub converged: bool,
    /// Root mean square of the filtered residual, rad/s: the sensor's noise where that is all there is.
    pub residual_rad_s: f64,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum InstrumentalError {
    #[error("{rows} rows of three samples in one direction, at least {FEWEST_ROWS} are needed")]
    TooFewRows { rows: usize },
    #[error(
        "the run does not excite speed, voltage and load apart (smallest singular value {least:.1e}, at least {LEAST_EXCITATION:.0e} is needed)"
    )]
    NotExcited { least: f64 },
    #[error("the instrumental variables find no motor: {0}")]
    Rejected(#[from] Scheme1Rejection),
    #[error("voltage has {voltages} values, speed {speeds}; both are needed once per sample")]
    Length { voltages: usize, speeds: usize },
}

/// Estimates from one record. `start`: a first model, such as a nameplate's; without it, or where it leads nowhere, least
/// squares on rows signed by `direction` (one per sample, from a dead zone) give one.
pub fn instrumental_variables(
    series: &Series<'_>,
    direction: &[i8],
    start: Option<Dynamics>,
) -> Result<Instrumental, InstrumentalError> {
    let (voltages, speeds) = (series.voltage_v.len(), series.speed_rad_s.len());
    if voltages != speeds {
        return Err(InstrumentalError::Length { voltages, speeds });
    }
    let starts = start.into_iter().chain(first_models(series, direction));
    let mut failure = InstrumentalError::TooFewRows { rows: 0 };
    let mut best: Option<Instrumental> = None;
    for start in starts {
        match refine(series, start) {
            Ok(found) if found.converged => return Ok(found),
            Ok(found) => best = best.or(Some(found)),
            Err(error) => failure = error,
        }
    }
    best.ok_or(failure)
}

/// First models from the data: least squares in both forms, then a rough one with the static gain.
fn first_models(series: &Series<'_>, direction: &[i8]) -> Vec<Dynamics> {
    let mut models = Vec::new();
    for form in [Form::Exact, Form::Printed] {
        let mut scheme = Scheme1::new(form, series.period_s, 1.0);
        for (k, (&volts, &speed)) in series.voltage_v.iter().zip(series.speed_rad_s).enumerate() {
            scheme.push(volts, speed, direction.get(k).copied().unwrap_or(0));
        }
        models.extend(scheme.dynamics());
    }
    let ke = root_mean_square(series.voltage_v) / root_mean_square(series.speed_rad_s);
    if ke.is_finite() && ke > 0.0 {
        models.push(Dynamics {
            ta_s: 2.0 * series.period_s,
            tm_s: 10.0 * series.period_s,
            ke,
            load_v: 0.0,
        });
    }
    models
}

/// One round: the estimate with the instruments, the filter and the rows of `model`.
struct Round {
    dynamics: Dynamics,
    coefficients: Coefficients,
    pairs: Vec<Pair>,
    solution: Solution,
}

impl Round {
    fn of(series: &Series<'_>, model: &Dynamics) -> Result<Self, InstrumentalError> {
        let pairs = pairs(series, &auxiliary(series, model), model);
        let solution = Solution::of(&pairs)?;
        let coefficients = Coefficients::from_array(solution.theta.into());
        Ok(Self {
            dynamics: Dynamics::from_coefficients(Form::Exact, &coefficients, series.period_s)?,
            coefficients,
            pairs,
            solution,
        })
    }

    fn covariance(&self, period_s: f64) -> [[f64; 5]; 5] {
        let spread = self
            .solution
            .covariance(&self.pairs, &self.dynamics, period_s);
        std::array::from_fn(|i| std::array::from_fn(|j| spread[(i, j)]))
    }
}

/// Plain rounds towards the fixed point, then Newton steps on it: it is slow to approach where the auxiliary model stands
/// in the corrections at reversals.
fn refine(series: &Series<'_>, start: Dynamics) -> Result<Instrumental, InstrumentalError> {
    let sizes = |model: &Dynamics| {
        let mut sizes = model.to_array();
        sizes[3] = root_mean_square(series.voltage_v);
        sizes
    };
    let mut model = start;
    let mut rounds = 0;
    let mut slope_gain = None;
    for _ in 0..PLAIN_ROUNDS {
        rounds += 1;
        let found = Round::of(series, &model)?.dynamics;
        let (before, after, sizes) = (model.to_array(), found.to_array(), sizes(&found));
        model = found;
        if (0..4).all(|j| (after[j] - before[j]).abs() <= NEAR * sizes[j].abs()) {
            break;
        }
    }
    loop {
        rounds += 1;
        let round = Round::of(series, &model)?;
        let (at, sizes) = (model.to_array(), sizes(&model));
        let coefficient_covariance = round.covariance(series.period_s);
        let of_one_round = propagate(
            Form::Exact,
            &round.coefficients,
            &coefficient_covariance,
            series.period_s,
        );
        let gain = match slope_gain {
            Some(gain) if rounds % SLOPE_ROUNDS != 0 => gain,
            _ => gain(series, &at, &sizes, &of_one_round)?,
        };
        slope_gain = Some(gain);
        let one = M4::from_fn(|i, j| of_one_round[i][j]);
        let covariance = gain * one * gain.transpose();
        let ahead = V4::from(round.dynamics.to_array()) - V4::from(at);
        let step = gain * ahead;
        let newton = Dynamics::from_array((V4::from(at) + step).into());
        let sound = newton.ta_s > 0.0 && newton.tm_s > 0.0 && newton.ke > 0.0;
        model = if sound { newton } else { round.dynamics };
        let converged = sound
            && (0..4).all(|j| {
                step[j].abs()
                    <= (CONVERGED_DEVIATIONS * covariance[(j, j)].max(0.0).sqrt())
                        .max(CONVERGED * sizes[j].abs())
            });
        if converged || rounds >= MOST_ROUNDS {
            return Ok(Instrumental {
                dynamics: model,
                covariance: std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)])),
                coefficients: round.coefficients,
                coefficient_covariance,
                rows: round.pairs.len(),
                rounds,
                converged,
                residual_rad_s: round.solution.residual_rad_s,
            });
        }
    }
}

fn root_mean_square(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|value| value.is_finite());
    let count = finite.clone().count().max(1) as f64;
    (finite.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// The rounds end where `x = F(x) + e`; an error `e` of one round then moves the end by `(I - F')^-1 e`, which is returned.
/// `F'` by differences over one standard deviation; where a neighbour belongs to no motor it counts as zero.
fn gain(
    series: &Series<'_>,
    at: &[f64; 4],
    sizes: &[f64; 4],
    of_one_round: &[[f64; 4]; 4],
) -> Result<M4, InstrumentalError> {
    let mut slope = M4::zeros();
    for j in 0..4 {
        let size = sizes[j].abs();
        let step = of_one_round[j][j]
            .max(0.0)
            .sqrt()
            .clamp(1e-6 * size, 0.05 * size);
        let moved = |by: f64| {
            let mut there = *at;
            there[j] += by;
            Round::of(series, &Dynamics::from_array(there)).map(|round| round.dynamics.to_array())
        };
        if let (Ok(up), Ok(down)) = (moved(step), moved(-step)) {
            for i in 0..4 {
                slope[(i, j)] = (up[i] - down[i]) / (2.0 * step);
            }
        }
    }
    (M4::identity() - slope)
        .try_inverse()
        .ok_or(InstrumentalError::NotExcited { least: 0.0 })
}

/// Free run of the model from the voltage: speed and direction at each sample.
fn auxiliary(series: &Series<'_>, model: &Dynamics) -> Vec<Reading> {
    let samples = series.voltage_v.len();
    let time = |k: usize| k as f64 * series.period_s;
    // The resistance cancels in the speed: one ohm serves.
    let motor = Motor::new("auxiliary")
        .with(MotorKey::Resistance, 1.0)
        .with(MotorKey::Inductance, model.ta_s)
        .with(MotorKey::BackEmf, model.ke)
        .with(MotorKey::Inertia, model.tm_s * model.ke * model.ke)
        .with(MotorKey::LoadTorque, (model.load_v * model.ke).max(0.0));
    let scenario = Scenario {
        name: String::new(),
        input: Input::Voltage,
        input_channel: Channel::Voltage,
        events: (1..samples)
            .map(|k| (time(k - 1), series.voltage_v[k]))
            .collect(),
        sample_time_s: (0..samples).map(time).collect(),
        current_a: Vec::new(),
        speed_rad_s: Vec::new(),
        angle: Vec::new(),
        scored: 0..samples,
    };
    let start = series.speed_rad_s.first().copied().unwrap_or(0.0);
    let start = if start.is_finite() { start } else { 0.0 };
    let speed = Plant::new(&Model::baseline(motor), Input::Voltage)
        .map(|mut plant| plant.simulate(&scenario, State::at(0.0, start)).speed_rad_s)
        .unwrap_or_default();
    let zone = DEAD_ZONE * speed.iter().fold(0.0, |most, w| f64::max(most, w.abs()));
    speed
        .iter()
        .zip(series.voltage_v)
        .map(|(&speed_rad_s, &voltage_v)| Reading {
            voltage_v,
            speed_rad_s,
            direction: i8::from(speed_rad_s > zone) - i8::from(speed_rad_s < -zone),
        })
        .collect()
}

/// A filtered row of the measurement and its instrument.
struct Pair {
    sample: usize,
    instrument: V5,
    regressor: V5,
    value: f64,
}

/// Rows and instruments, both filtered by `1/A(z)` of the model from the begin of each chain of samples.
///
/// A row over a reversal or a standstill is no equation, but the filter must not start afresh behind it: such a row is
/// corrected by what the auxiliary model lacks there, `A x - B u - b3 s`, and only passes through the filter.
fn pairs(series: &Series<'_>, auxiliary: &[Reading], model: &Dynamics) -> Vec<Pair> {
    let coefficients = Coefficients::of_motor(model, series.period_s);
    let theta = coefficients.to_array();
    let measured = |k: usize| Reading {
        speed_rad_s: series.speed_rad_s[k],
        ..auxiliary[k]
    };
    let mut out = Vec::with_capacity(auxiliary.len());
    let mut memory = [[0.0; 11]; 2];
    for k in 2..auxiliary.len() {
        let last = [&auxiliary[k - 2], &auxiliary[k - 1], &auxiliary[k]];
        let instrument = rows::whatever_direction(last[0], last[1], last[2]);
        let row = rows::whatever_direction(&measured(k - 2), &measured(k - 1), &measured(k));
        let Some((instrument, mut row)) = instrument.zip(row) else {
            memory = [[0.0; 11]; 2];
            continue;
        };
        let usable = rows::row(last[0], last[1], last[2]).is_some();
        if !usable {
            let explained: f64 = instrument
                .regressor
                .iter()
                .zip(theta)
                .map(|(x, t)| x * t)
                .sum();
            row.value -= instrument.value - explained;
        }
        let now: [f64; 11] = std::array::from_fn(|j| {
            let raw = match j {
                0..5 => instrument.regressor[j],
                5..10 => row.regressor[j - 5],
                _ => row.value,
            };
            raw + coefficients.a1() * memory[0][j] + coefficients.a2() * memory[1][j]
        });
        memory = [now, memory[0]];
        if usable {
            out.push(Pair {
                sample: k,
                instrument: V5::from_fn(|j, _| now[j]),
                regressor: V5::from_fn(|j, _| now[j + 5]),
                value: now[10],
            });
        }
    }
    out
}

struct Solution {
    theta: V5,
    /// Inverse of the sum of instrument times regressor.
    inverse: M5,
    residual_rad_s: f64,
}

impl Solution {
    fn of(pairs: &[Pair]) -> Result<Self, InstrumentalError> {
        let rows = pairs.len();
        if rows < FEWEST_ROWS {
            return Err(InstrumentalError::TooFewRows { rows });
        }
        let length = |of: &dyn Fn(&Pair, usize) -> f64| {
            V5::from_fn(|j, _| {
                let squares: f64 = pairs.iter().map(|pair| of(pair, j).powi(2)).sum();
                squares.sqrt().max(f64::MIN_POSITIVE)
            })
        };
        let norms = length(&|pair, j| pair.regressor[j]);
        let sizes = length(&|pair, j| pair.instrument[j]);
        let (mut normal, mut right) = (M5::zeros(), V5::zeros());
        for pair in pairs {
            let z = pair.instrument.component_div(&sizes);
            let x = pair.regressor.component_div(&norms);
            normal += z * x.transpose();
            right += z * pair.value;
        }
        let least = normal.singular_values().min();
        let inverse = normal
            .try_inverse()
            .filter(|_| least > LEAST_EXCITATION)
            .ok_or(InstrumentalError::NotExcited { least })?;
        let theta = (inverse * right).component_div(&norms);
        let inverse = M5::from_fn(|i, j| inverse[(i, j)] / (norms[i] * sizes[j]));
        let squares: f64 = pairs.iter().map(|pair| pair.error(&theta).powi(2)).sum();
        Ok(Self {
            theta,
            inverse,
            residual_rad_s: (squares / (rows - 5) as f64).sqrt(),
        })
    }

    /// Sandwich covariance of the coefficients; the scores are summed over stretches of several time constants, because
    /// the filtered errors of a chain share the error of its first samples.
    fn covariance(&self, pairs: &[Pair], model: &Dynamics, period_s: f64) -> M5 {
        let stretch = whole((4.0 * (model.ta_s + model.tm_s) / period_s).clamp(20.0, 1e6))
            .min((pairs.len() / CLUSTERS).max(1));
        let mut meat = M5::zeros();
        let mut clusters = 0usize;
        for cluster in pairs.chunk_by(|a, b| a.sample / stretch == b.sample / stretch) {
            let score = cluster.iter().fold(V5::zeros(), |sum, pair| {
                sum + pair.instrument * pair.error(&self.theta)
            });
            meat += score * score.transpose();
            clusters += 1;
        }
        let correction = clusters as f64 / (clusters as f64 - 5.0).max(1.0);
        self.inverse * meat * self.inverse.transpose() * correction
    }
}

impl Pair {
    fn error(&self, theta: &V5) -> f64 {
        self.value - self.regressor.dot(theta)
    }
}
