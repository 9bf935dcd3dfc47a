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
type V5 = SVector<f64, 5>;

const MOST_ROUNDS: usize = 30;
/// The rounds end when each coefficient changes by less than this share of its standard deviation, or of the largest
/// effect that any coefficient has.
const CONVERGED_DEVIATIONS: f64 = 0.01;
const CONVERGED: f64 = 1e-9;
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
    let size = |values: &[f64]| {
        let finite = values.iter().filter(|value| value.is_finite());
        (finite.clone().map(|v| v * v).sum::<f64>() / finite.count().max(1) as f64).sqrt()
    };
    let ke = size(series.voltage_v) / size(series.speed_rad_s);
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

fn refine(series: &Series<'_>, start: Dynamics) -> Result<Instrumental, InstrumentalError> {
    let mut model = start;
    let mut before: Option<V5> = None;
    let mut rounds = 0;
    loop {
        rounds += 1;
        let pairs = pairs(series, &auxiliary(series, &model), &model);
        let solution = Solution::of(&pairs)?;
        let coefficients = Coefficients::from_array(solution.theta.into());
        model = Dynamics::from_coefficients(Form::Exact, &coefficients, series.period_s)?;
        let spread = solution.covariance(&pairs, &model, series.period_s);
        let converged = before.is_some_and(|before| {
            let least = CONVERGED * solution.effect.iter().copied().fold(0.0, f64::max);
            (0..5).all(|j| {
                let change = (solution.theta[j] - before[j]).abs();
                change <= CONVERGED_DEVIATIONS * spread[(j, j)].max(0.0).sqrt()
                    || change * solution.norms[j] <= least
            })
        });
        before = Some(solution.theta);
        if converged || rounds >= MOST_ROUNDS {
            let covariance: [[f64; 5]; 5] =
                std::array::from_fn(|i| std::array::from_fn(|j| spread[(i, j)]));
            return Ok(Instrumental {
                dynamics: model,
                covariance: propagate(Form::Exact, &coefficients, &covariance, series.period_s),
                coefficients,
                rows: pairs.len(),
                rounds,
                converged,
                residual_rad_s: solution.residual_rad_s,
            });
        }
    }
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

/// Rows and instruments, both filtered by `1/A(z)` of the model from the begin of each chain of rows.
fn pairs(series: &Series<'_>, auxiliary: &[Reading], model: &Dynamics) -> Vec<Pair> {
    let [a1, a2] = poles(model, series.period_s);
    let measured = |k: usize| Reading {
        speed_rad_s: series.speed_rad_s[k],
        ..auxiliary[k]
    };
    let mut out = Vec::with_capacity(auxiliary.len());
    let mut memory = [[0.0; 11]; 2];
    for k in 2..auxiliary.len() {
        let instrument = rows::row(&auxiliary[k - 2], &auxiliary[k - 1], &auxiliary[k]);
        let row = rows::row(&measured(k - 2), &measured(k - 1), &measured(k));
        let Some((instrument, row)) = instrument.zip(row) else {
            memory = [[0.0; 11]; 2];
            continue;
        };
        let now: [f64; 11] = std::array::from_fn(|j| {
            let raw = match j {
                0..5 => instrument.regressor[j],
                5..10 => row.regressor[j - 5],
                _ => row.value,
            };
            raw + a1 * memory[0][j] + a2 * memory[1][j]
        });
        memory = [now, memory[0]];
        out.push(Pair {
            sample: k,
            instrument: V5::from_fn(|j, _| now[j]),
            regressor: V5::from_fn(|j, _| now[j + 5]),
            value: now[10],
        });
    }
    out
}

/// `a1` and `a2` of a motor at a period.
fn poles(model: &Dynamics, period_s: f64) -> [f64; 2] {
    let half = -0.5 * period_s / model.ta_s;
    let square = half * half - period_s * period_s / (model.ta_s * model.tm_s);
    let between = if square >= 0.0 {
        square.sqrt().cosh()
    } else {
        (-square).sqrt().cos()
    };
    [2.0 * half.exp() * between, -(2.0 * half).exp()]
}

struct Solution {
    theta: V5,
    /// Inverse of the sum of instrument times regressor.
    inverse: M5,
    /// Length of each column of regressors, and of its product with the coefficient.
    norms: V5,
    effect: V5,
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
            norms,
            effect: theta.component_mul(&norms).abs(),
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
