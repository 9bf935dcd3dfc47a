//! Scheme 1 without the bias of sensor noise: refined instrumental variables over a whole run.
//!
//! The instruments are the rows of an auxiliary model that is simulated from the voltage alone (true stick-slip), so no
//! noise of the speed is in them; sign and usable rows come from that model too. Rows and instruments are filtered by
//! `1/A(z)` of the last estimate, which makes the noise of the speed nearly white and the estimate nearly efficient
//! (Young, *Recursive Estimation and Time-Series Analysis* (2011), chapter 7; Soderstrom and Stoica, *Instrumental
//! Variable Methods for System Identification* (1983)). Within a chain of consecutive rows the filter starts from zero, so
//! the filtered equation stays exact.

mod auxiliary;
mod solution;

use nalgebra::{SMatrix, SVector};
use thiserror::Error;

use self::auxiliary::{Auxiliary, first_models};
use self::solution::{Pair, Solution, pairs};
use super::inverse::{Coefficients, Dynamics, Form, Scheme1Rejection, propagate};

type M4 = SMatrix<f64, 4, 4>;
type V4 = SVector<f64, 4>;

/// Rounds without a Newton step, ended early by this relative change, and all together.
const PLAIN_ROUNDS: usize = 6;
const NEAR: f64 = 1e-3;
const MOST_ROUNDS: usize = 16;
/// The slope of a round is taken anew after so many.
const SLOPE_ROUNDS: usize = 6;
/// The end: a step of less than this share of the standard deviation, or of the value.
const CONVERGED_DEVIATIONS: f64 = 0.1;
const CONVERGED: f64 = 1e-6;
/// First models that are tried, and cuts of a step that makes the free run worse.
const STARTS: usize = 3;
const MOST_CUTS: usize = 5;
/// Error of the free run over the residual of the equations beyond which the model is not taken for the motor's.
const MOST_FREE_RUN: f64 = 1.3;
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
    /// In the order of the fields of [`Coefficients`]; the last follows from the others.
    pub coefficient_covariance: [[f64; 5]; 5],
    pub rows: usize,
    pub rounds: usize,
    pub converged: bool,
    /// Root mean square of the filtered residual, rad/s: the sensor's noise where that is all there is.
    pub residual_rad_s: f64,
    /// Root mean square error of the model's free run, rad/s: well above the residual, the model is wrong or lacks an effect.
    pub free_run_rad_s: f64,
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
    let mut failure = InstrumentalError::TooFewRows { rows: 0 };
    let mut best: Option<Instrumental> = None;
    for start in first_models(series, direction, start)
        .into_iter()
        .take(STARTS)
    {
        match refine(series, start) {
            Ok(found) if found.converged => return Ok(found),
            Ok(found) => {
                if best.is_none_or(|best| found.free_run_rad_s < best.free_run_rad_s) {
                    best = Some(found);
                }
            }
            Err(error) => failure = error,
        }
    }
    best.ok_or(failure)
}

/// One round: the estimate with the instruments, the filter and the rows of `model`.
struct Round {
    dynamics: Dynamics,
    coefficients: Coefficients,
    pairs: Vec<Pair>,
    solution: Solution,
}

impl Round {
    fn of(
        series: &Series<'_>,
        auxiliary: &Auxiliary,
        model: &Dynamics,
    ) -> Result<Self, InstrumentalError> {
        let pairs = pairs(series, &auxiliary.readings, model);
        let solution = Solution::of(&pairs)?;
        let tied = Coefficients::of_motor(model, series.period_s);
        let [p, q, voltage, load]: [f64; 4] = solution.theta.into();
        let coefficients = Coefficients {
            p,
            q,
            voltage,
            load,
            voltage_step: voltage * tied.voltage_step / tied.voltage,
        };
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
        let cell = |i: usize, j: usize| if i < 4 && j < 4 { spread[(i, j)] } else { 0.0 };
        std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j)))
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
    let mut auxiliary = Auxiliary::of(series, &model);
    for _ in 0..PLAIN_ROUNDS {
        rounds += 1;
        let found = Round::of(series, &auxiliary, &model)?.dynamics;
        let before = model.to_array();
        let Some(better) = descend(series, &model, &auxiliary, &found) else {
            break;
        };
        (model, auxiliary) = better;
        let (after, sizes) = (model.to_array(), sizes(&model));
        if (0..4).all(|j| (after[j] - before[j]).abs() <= NEAR * sizes[j].abs()) {
            break;
        }
    }
    loop {
        rounds += 1;
        let round = Round::of(series, &auxiliary, &model)?;
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
        let sound =
            newton.ta_s > 0.0 && newton.tm_s > 0.0 && newton.ke > 0.0 && newton.load_v.is_finite();
        model = if sound { newton } else { round.dynamics };
        auxiliary = Auxiliary::of(series, &model);
        let residual_rad_s = round.solution.residual_rad_s;
        let fits = auxiliary.error_rad_s
            <= MOST_FREE_RUN * residual_rad_s + NEAR * root_mean_square(series.speed_rad_s);
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
                converged: converged && fits,
                residual_rad_s,
                free_run_rad_s: auxiliary.error_rad_s,
            });
        }
    }
}

/// The part of the way to `towards` on which the free run does not get worse; `None` where each does.
fn descend(
    series: &Series<'_>,
    from: &Dynamics,
    auxiliary: &Auxiliary,
    towards: &Dynamics,
) -> Option<(Dynamics, Auxiliary)> {
    let (a, b) = (from.to_array(), towards.to_array());
    // What noise alone may do to the error of the free run.
    let most = auxiliary.error_rad_s * (1.0 + 10.0 / series.speed_rad_s.len().max(1) as f64);
    let mut share = 1.0;
    for _ in 0..MOST_CUTS {
        let between = Dynamics::from_array(std::array::from_fn(|j| {
            if j < 3 {
                a[j] * (b[j] / a[j]).powf(share)
            } else {
                a[j] + share * (b[j] - a[j])
            }
        }));
        let there = Auxiliary::of(series, &between);
        if there.error_rad_s <= most {
            return Some((between, there));
        }
        share *= 0.35;
    }
    None
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
            .max(1e-6 * size)
            .min(0.05 * size);
        let moved = |by: f64| {
            let mut there = *at;
            there[j] += by;
            let there = Dynamics::from_array(there);
            Round::of(series, &Auxiliary::of(series, &there), &there)
                .map(|round| round.dynamics.to_array())
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
