//! Residual of a fitted model beside the noise, and how much wider it makes the intervals: the sandwich covariance of a
//! misspecified model (White 1982, Econometrica 50) with correlated residuals.
//!
//! Noise averages out over the samples; what a model lacks does the same wrong at every step of a run, however many there are.
//! With `m` the residual over its weight, `c` the share of its power that neighbouring samples have in common, and `n`
//! samples of which no more than `D` carry new information on that share, signal by signal,
//!
//! ```text
//! cov = (J'J)^-1 (sum over the signals of m^2 (1 - c + c n/D) J_s'J_s) (J'J)^-1
//! ```
//!
//! Where noise is all that is left m is one, c zero, and this is (J'J)^-1. What a parameter imitates is not in the residual:
//! friction that grows with the speed leaves little beside a wrong back-EMF constant. The forms that are missing most often are
//! therefore let in one by one, and the most that one of them moves a parameter by is added. The blocks of the fit's own
//! covariance hold what is alike within a quarter of a second, and the scores that they sum are zero where the fit has taken
//! an error for a parameter.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::noise::{FloorSource, roughness};
use super::output_error::{Fit, FitError, FreeRun};
use super::verdict::settled_below;
use super::weak_form::Balanced;
use drivebench_model::numerics::least_squares::inverse_where_determined;
use drivebench_model::numerics::levenberg_marquardt::Problem as _;
use drivebench_model::numerics::statistics::{BAND_99, largest};
use drivebench_model::plant::effect::{BiasedFit, CATALOGUE};
use drivebench_model::plant::{Balance, Model, Scenario, Slot, typical_size};
use drivebench_model::sample::{Channel, ParameterEstimate, Verdict};

/// `D`: ways in which a missing effect can show. Twenty and the form below hold the true values of a motor emulated with a
/// speed that comes late, viscous friction, a winding that warms up or an offset of the current.
const WAYS: f64 = 20.0;
/// Multiple of the noise up to which what is left counts as noise, as far as the noise itself is known.
const NEAR_ONE: f64 = 1.1;

/// Where the noise comes from that a residual is held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseFrom {
    Standstill,
    /// From the second differences of the signal: at most this, since they also hold some of the signal.
    Roughness,
}

/// What the model leaves of one signal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    pub signal: &'static str,
    /// Root mean square of the residual over the noise; `None` where nothing shows the noise.
    pub times_noise: Option<f64>,
    pub noise_from: NoiseFrom,
    /// Share of the residual's power that neighbouring samples have in common.
    pub common_share: f64,
    #[serde(skip)]
    is_noise: bool,
}

impl Left {
    /// `3.1 times the noise of current_a`.
    pub fn text(&self) -> Option<String> {
        let times = self.times_noise?;
        let times =
            if times < 1000.0 { format!("{times:.1}") } else { "more than 1000".to_owned() };
        Some(format!("{times} times the noise of {}", self.signal))
    }
}

/// What a fitted model leaves, signal by signal.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Misfit(pub Vec<Left>);

impl Misfit {
    /// `3.1 times the noise of current_a, 1.0 times the noise of speed_rad_s`; `None` where no noise is known.
    pub fn text(&self) -> Option<String> {
        let all: Vec<String> = self.0.iter().filter_map(Left::text).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    /// The same of the signal of which most is left, where that is more than noise.
    pub(super) fn worst_text(&self) -> Option<String> {
        let above = self.0.iter().filter(|left| !left.is_noise);
        let worst = above.max_by(|a, b| {
            let times = |left: &Left| left.times_noise.unwrap_or(0.0);
            times(a).total_cmp(&times(b))
        });
        worst?.text()
    }

    /// Of a fit to the free run, with the deviation that it leaves to each free parameter.
    pub(super) fn of_fit(
        fit: &Fit,
        scenario: &Scenario,
    ) -> Result<(Self, Vec<(String, f64)>), FitError> {
        let problem = FreeRun::new(&fit.model, scenario, fit.noise)?;
        let (minimum, rows) = (&fit.minimum, problem.rows());
        let unknowns = minimum.jacobian.ncols();
        let mut all = Vec::new();
        let mut shares = Vec::new();
        let (current, speed) = (&scenario.current_a, &scenario.speed_rad_s);
        for (channel, values, level) in [
            (Channel::Current, current, fit.noise.current_a),
            (Channel::Speed, speed, fit.noise.speed_rad_s),
        ] {
            let own: Vec<usize> =
                (0..rows.len()).filter(|row| rows[*row].1 == (channel == Channel::Speed)).collect();
            if own.is_empty() {
                continue;
            }
            let residual: Vec<f64> = own.iter().map(|row| minimum.residual[*row]).collect();
            let jacobian = minimum.jacobian.select_rows(&own);
            let squares: f64 = residual.iter().map(|value| value * value).sum();
            let share = unknowns as f64 * own.len() as f64 / rows.len() as f64;
            let power = squares / (own.len() as f64 - share).max(1.0);
            let (noise, noise_from) = if fit.noise.source == FloorSource::None {
                (roughness(values), NoiseFrom::Roughness)
            } else {
                (level, NoiseFrom::Standstill)
            };
            // A noise that no sensor of 24 bits resolves is the rounding of a computation.
            let is_resolved = noise > 6e-8 * largest(values);
            let times = Some(power.sqrt() * level / noise).filter(|_| is_resolved);
            let common_share = common_share(&residual);
            shares.push((jacobian.tr_mul(&jacobian) * power, lasting(&residual)));
            all.push(Left {
                signal: channel.key(),
                times_noise: times,
                noise_from,
                common_share,
                is_noise: times.is_some_and(|times| times <= fit.noise.tolerance(NEAR_ONE)),
            });
        }
        // What is missing shows in one signal and bends the other's residual as well.
        let is_noise = all.iter().all(|left| left.is_noise);
        let mut meat = DMatrix::zeros(unknowns, unknowns);
        for (own, lasting) in shares {
            meat += own * if is_noise { 1.0 } else { lasting };
        }
        let (bread, _) = inverse_where_determined(&minimum.jacobian);
        let mut variances = (&bread * meat * &bread).diagonal();
        if !is_noise && let Some(moved) = moved_by_a_form(fit, scenario, &bread) {
            variances += moved.component_mul(&moved);
        }
        let slopes = problem.slopes(&minimum.x);
        let free = fit.free.iter().zip(slopes).zip(variances.iter());
        let deviations =
            free.map(|((slot, slope), variance)| (slot.key(), slope.abs() * variance.sqrt()));
        Ok((Self(all), deviations.collect()))
    }

    /// Of balances over windows; the windows overlap by half.
    pub(super) fn of_balances(balances: &[Balanced]) -> Self {
        let left = |balance: &Balanced| {
            let squares: f64 = balance.residual.iter().map(|value| value * value).sum();
            let power = squares / f64::max(balance.residual.len() as f64, 1.0);
            let times = power.sqrt() / balance.noise_floor?;
            Some(Left {
                signal: match balance.equation {
                    Balance::Voltage => Channel::Voltage.key(),
                    Balance::Torque => Channel::Torque.key(),
                },
                times_noise: Some(times),
                noise_from: NoiseFrom::Standstill,
                common_share: common_share(&balance.residual),
                is_noise: times <= NEAR_ONE,
            })
        };
        Self(balances.iter().filter_map(left).collect())
    }

    /// Widens each value to the deviation that the residual leaves to it, with a reason where that unsettles it, or is all that
    /// keeps it open: the search has `converged`.
    pub(super) fn widen(
        &self,
        parameters: &mut [ParameterEstimate],
        deviations: &[(String, f64)],
        converged: bool,
    ) {
        for parameter in parameters {
            let own = deviations.iter().find(|own| own.0 == parameter.key);
            let (Some(own), Some((value, Some(std)))) = (own, parameter.carried()) else {
                continue;
            };
            let narrow = settled_below(&parameter.key);
            let wide = own.1 / value.abs().max(f64::MIN_POSITIVE);
            if own.1 <= std {
                continue;
            }
            parameter.std = Some(own.1);
            if wide > narrow && parameter.verdict == Verdict::Searching {
                parameter.reason = Some(format!("relative uncertainty {:.1} %", 100.0 * wide));
            }
            if let Some(left) = self.worst_text().filter(|_| wide > narrow && converged) {
                let percent = 100.0 * wide;
                let reason = format!("the model leaves {left}: uncertain by {percent:.1} %");
                parameter.verdict = Verdict::Searching;
                parameter.reason = Some(reason);
            }
        }
    }
}

/// Widens what a balance of torques gave by the forms that it may lack. `beside` fits the balance with one of them as well,
/// over so many `rows`.
///
/// Two models, without the form and with it, are averaged: the variance of a value grows by `p moved^2`. Schwarz's criterion
/// gives the form's probability, `p / (1 - p) = exp(z^2 / 2) / sqrt(rows)` for a coefficient of `z` deviations (Hoeting,
/// Madigan, Raftery and Volinsky, Bayesian Model Averaging, Statistical Science 14, 1999).
pub fn widen_by_forms_of_torque(
    parameters: &mut [ParameterEstimate],
    rows: usize,
    beside: impl Fn(&'static str) -> Option<Vec<ParameterEstimate>>,
) {
    let mut most: Vec<Option<(f64, f64, &str)>> = vec![None; parameters.len()];
    for form in forms_that_bias(BiasedFit::TorqueBalance) {
        let Some(with) = beside(form) else {
            continue;
        };
        let is_own = |found: &&ParameterEstimate| !parameters.iter().any(|p| p.key == found.key);
        let own = with.iter().find(is_own).and_then(ParameterEstimate::carried);
        let Some((size, Some(std))) = own.filter(|own| own.1 > Some(0.0)) else {
            continue;
        };
        let odds = (0.5 * (size / std).powi(2)).exp() / (rows as f64).sqrt();
        let share = 1.0 - 1.0 / (1.0 + odds);
        for (parameter, most) in parameters.iter().zip(&mut most) {
            let other = with
                .iter()
                .find(|found| found.key == parameter.key)
                .and_then(ParameterEstimate::carried);
            if let (Some((value, _)), Some((other, _))) = (parameter.carried(), other) {
                let moved = (other - value).abs();
                let grown = share * moved * moved;
                if most.is_none_or(|most| most.0 < grown) {
                    *most = Some((grown, moved, form));
                }
            }
        }
    }
    for (parameter, most) in parameters.iter_mut().zip(most) {
        let (Some((grown, moved, form)), Some((value, Some(std)))) = (most, parameter.carried())
        else {
            continue;
        };
        let wide = std.hypot(grown.sqrt());
        parameter.std = Some(wide);
        let value = value.abs().max(f64::MIN_POSITIVE);
        let narrow = settled_below(&parameter.key) * value;
        if wide > narrow && (std <= narrow || grown > std * std) {
            let percent = 100.0 * moved / value;
            parameter.verdict = Verdict::Searching;
            parameter.reason = Some(format!("{form}, if it acts, moves it by {percent:.1} %"));
        }
    }
}

/// What is missing most often, and bends the parameters of a fit by more than it leaves: each is let in alone.
fn forms_that_bias(fit: BiasedFit) -> impl Iterator<Item = &'static str> {
    let cards = CATALOGUE.iter().map(|effect| effect.card());
    let own = cards.filter(move |card| card.biases.contains(&fit));
    own.map(|card| card.id)
}

/// How far each coordinate moves where a form is let in beside it, of those that explain more of the residual than chance would;
/// `None` where none does.
fn moved_by_a_form(fit: &Fit, scenario: &Scenario, bread: &DMatrix<f64>) -> Option<DVector<f64>> {
    let minimum = &fit.minimum;
    let at = |model: &Model| {
        let problem = FreeRun::new(model, scenario, fit.noise).ok()?;
        let mut out = vec![0.0; problem.residual_len()];
        let is_known = problem.residual(&minimum.x, &mut out);
        is_known.then(|| DVector::from_vec(out))
    };
    let base = at(&fit.model)?;
    let residual = DVector::from_column_slice(&minimum.residual);
    // Three deviations of chance.
    let chance = 9.0 * minimum.cost / residual.len() as f64;
    let explained = forms_that_bias(BiasedFit::FreeRun).filter_map(|id| {
        let mut model = fit.model.with_effect(id).ok()?;
        let place = model.effects.len() - 1;
        let is_own = |slot: &Slot| matches!(slot, Slot::Effect { index, .. } if *index == place);
        let own: Vec<Slot> = model.slots().into_iter().filter(is_own).collect();
        let effect = model.effects[place].effect;
        // The derivative is taken over a twentieth of its typical size, or of a period where it is a delay.
        let is_coefficient = effect.parameters().first()?.is_coefficient();
        let size = if is_coefficient {
            typical_size(effect, 0, &model, scenario)
        } else {
            scenario.mean_period_s()
        };
        let size = 0.05 * size;
        model.set(own.first()?, size);
        // Fixed, so that the coordinates stay those of the fit.
        model.fixed.extend(own.iter().map(Slot::key));
        let column = (at(&model)? - &base) / size;
        let along = bread * minimum.jacobian.tr_mul(&column);
        let own = &column - &minimum.jacobian * &along;
        let (power, score) = (own.norm_squared(), own.dot(&residual));
        // Of a form that the parameters imitate nearly wholly the record holds nothing.
        (power > 1e-5 * column.norm_squared())
            .then(|| (score * score / power, along * (score / power)))
    });
    let sure = explained.filter(|(gain, _)| *gain > chance);
    let sizes = sure.map(|(_, moved)| moved.abs());
    sizes.reduce(|a, b| a.sup(&b))
}

/// Factor by which what a residual has in common from sample to sample raises variances: `1 - c + c n/D`.
pub(super) fn lasting(residual: &[f64]) -> f64 {
    let common = common_share(residual);
    1.0 - common + common * f64::max(residual.len() as f64 / WAYS, 1.0)
}

/// Correlation of neighbouring residuals, where it is no chance.
fn common_share(residual: &[f64]) -> f64 {
    let power: f64 = residual.iter().map(|value| value * value).sum();
    let products: f64 = residual.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let (share, chance) = (products / power, BAND_99 / (residual.len() as f64).sqrt());
    if share > chance { share } else { 0.0 }
}

#[cfg(test)]
mod tests;
