//! Residual of a fitted model over the noise, and the wider intervals: sandwich covariance of a misspecified model (White 1982,
//! Econometrica 50) with correlated residuals.
//!
//! Noise averages out over the samples; the error of a misspecified model repeats at every step of a run.
//! With `m` the residual over its weight, `c` the correlation of neighbouring residuals, and `n` samples of which at most `D`
//! are independent in the correlated share, signal by signal,
//!
//! ```text
//! cov = (J'J)^-1 (sum over the signals of m^2 (1 - c + c n/D) J_s'J_s) (J'J)^-1
//! ```
//!
//! With a correct model m is one, c zero, and this is (J'J)^-1. The bias of a missing effect (omitted-variable bias) is not in the
//! residual: viscous friction is nearly absorbed by a wrong back-EMF constant. The effects that are missing most often are
//! therefore added one by one, and the largest change of a parameter by one of them is added to its deviation.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::noise::{FloorSource, roughness};
use super::output_error::{Fit, FitError, FreeRun};
use super::verdict::{SETTLED_BELOW_RATIO, settled_below};
use super::weak_form::Balanced;
use drivebench_model::numerics::least_squares::inverse_where_determined;
use drivebench_model::numerics::statistics::{BAND_99, largest};
use drivebench_model::plant::effect::{BiasedFit, CATALOGUE};
use drivebench_model::plant::{Balance, Model, Motor, MotorKey, Scenario, Slot, typical_size};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Verdict};

/// Ratio to the noise up to which a residual counts as noise, if the noise is known exactly.
const NOISE_RATIO: f64 = 1.1;

/// Source of the noise to which a residual is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseFrom {
    Standstill,
    /// From the second differences of the signal: an upper bound, since they also contain some of the signal.
    Roughness,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    pub signal: &'static str,
    /// Root mean square of the residual over the noise; `None` where the noise is not known.
    pub times_noise: Option<f64>,
    pub noise_from: NoiseFrom,
    /// Autocorrelation of the residual at lag one, zero where it is not significant.
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

/// Residuals of a fitted model, signal by signal.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Misfit(pub Vec<Left>);

impl Misfit {
    /// `3.1 times the noise of current_a, 1.0 times the noise of speed_rad_s`; `None` where no noise is known.
    pub fn text(&self) -> Option<String> {
        let all: Vec<String> = self.0.iter().filter_map(Left::text).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    /// The same of the signal with the largest residual, where that is more than noise.
    pub(super) fn worst_text(&self) -> Option<String> {
        let worst = self.0.iter().filter(|left| !left.is_noise).max_by(|a, b| {
            let times = |left: &Left| left.times_noise.unwrap_or(0.0);
            times(a).total_cmp(&times(b))
        });
        worst?.text()
    }

    /// Of a fit to the free run, with the standard deviation of each free parameter that follows.
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
            let selected: Vec<usize> =
                (0..rows.len()).filter(|row| rows[*row].1 == (channel == Channel::Speed)).collect();
            if selected.is_empty() {
                continue;
            }
            let residual: Vec<f64> = selected.iter().map(|row| minimum.residual[*row]).collect();
            let jacobian = minimum.jacobian.select_rows(&selected);
            let squares: f64 = residual.iter().map(|value| value * value).sum();
            let share = unknowns as f64 * selected.len() as f64 / rows.len() as f64;
            let power = squares / (selected.len() as f64 - share).max(1.0);
            let (noise, noise_from) = if fit.noise.source == FloorSource::None {
                (roughness(values), NoiseFrom::Roughness)
            } else {
                (level, NoiseFrom::Standstill)
            };
            // A noise below the resolution of 24 bits is the rounding of a computation.
            let is_resolved = noise > 6e-8 * largest(values);
            let times = Some(power.sqrt() * level / noise).filter(|_| is_resolved);
            let common_share = common_share(&residual);
            shares.push((jacobian.tr_mul(&jacobian) * power, lasting(&residual)));
            all.push(Left {
                signal: channel.key(),
                times_noise: times,
                noise_from,
                common_share,
                is_noise: times.is_some_and(|times| times <= fit.noise.tolerance(NOISE_RATIO)),
            });
        }
        // An effect that is missing in one signal also biases the residual of the other.
        let is_noise = all.iter().all(|left| left.is_noise);
        let mut meat = DMatrix::zeros(unknowns, unknowns);
        for (share, lasting) in shares {
            meat += share * if is_noise { 1.0 } else { lasting };
        }
        let (bread, _) = inverse_where_determined(&minimum.jacobian);
        let mut variances = (&bread * meat * &bread).diagonal();
        // Of a long record a form shows long before the residual exceeds the noise by more than the noise is known.
        if let Some(change) = change_by_a_form(fit, scenario, &bread) {
            variances += change.component_mul(&change);
        }
        let free = fit.free.iter().zip(problem.slopes(&minimum.x)).zip(variances.iter());
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
                is_noise: times <= NOISE_RATIO,
            })
        };
        Self(balances.iter().filter_map(left).collect())
    }

    /// Unsettles all values where a residual is several times the noise.
    pub(super) fn unsettle(&self, parameters: &mut [ParameterEstimate]) {
        let most = self.0.iter().filter(|left| !left.is_noise).filter_map(|left| left.times_noise);
        let is_missed = most.fold(0.0, f64::max) > SETTLED_BELOW_RATIO;
        if let Some(residual) = self.worst_text().filter(|_| is_missed) {
            for parameter in parameters {
                parameter.unsettle(Reason::ModelMisses, format!("the residual is {residual}"));
            }
        }
    }

    /// Sets each standard deviation to the larger one of `deviations`, with a reason where the value is no longer settled, or is
    /// not settled although the search has `converged`.
    pub(super) fn widen(
        &self,
        parameters: &mut [ParameterEstimate],
        deviations: &[(String, f64)],
        converged: bool,
    ) {
        for parameter in parameters {
            let wider = deviations.iter().find(|deviation| deviation.0 == parameter.key);
            let (Some((_, wider)), Some((value, Some(std)))) = (wider, parameter.carried()) else {
                continue;
            };
            if *wider <= std {
                continue;
            }
            parameter.std = Some(*wider);
            let relative = wider / value.abs().max(f64::MIN_POSITIVE);
            let (percent, is_wide) = (100.0 * relative, relative > settled_below(&parameter.key));
            if is_wide && parameter.verdict == Verdict::Searching {
                let reason = format!("relative uncertainty {percent:.1} %");
                parameter.set(Verdict::Searching, Reason::Uncertain, reason);
            }
            if let Some(residual) = self.worst_text().filter(|_| is_wide && converged) {
                let reason = format!("the residual is {residual}: uncertain by {percent:.1} %");
                parameter.set(Verdict::Searching, Reason::ModelMisses, reason);
            }
        }
    }
}

/// Bayesian model averaging over effects that a balance of torques may lack. `with_form` fits the balance over `rows` rows with one
/// of them in addition.
///
/// Of two models, without the form and with it, the variance of a value grows by `p change^2`. The Bayesian information criterion
/// (Schwarz) gives the probability of the form, `p / (1 - p) = exp(z^2 / 2) / sqrt(rows)` for a coefficient of `z` standard
/// deviations (Hoeting, Madigan, Raftery and Volinsky, *Statistical Science* 14, 1999).
pub fn widen_by_forms_of_torque(
    parameters: &mut [ParameterEstimate],
    rows: usize,
    with_form: impl Fn(&'static str) -> Option<Vec<ParameterEstimate>>,
) {
    let mut largest: Vec<Option<(f64, f64, &str)>> = vec![None; parameters.len()];
    for form in forms_that_bias(BiasedFit::TorqueBalance) {
        let Some(with) = with_form(form) else { continue };
        let is_form = |found: &&ParameterEstimate| !parameters.iter().any(|p| p.key == found.key);
        let coefficient = with.iter().find(is_form).and_then(ParameterEstimate::carried);
        let Some((size, Some(std))) = coefficient.filter(|found| found.1 > Some(0.0)) else {
            continue;
        };
        let odds = (0.5 * (size / std).powi(2)).exp() / (rows as f64).sqrt();
        let probability = 1.0 - 1.0 / (1.0 + odds);
        for (parameter, largest) in parameters.iter().zip(&mut largest) {
            let other = with.iter().find(|found| found.key == parameter.key);
            let other = other.and_then(ParameterEstimate::carried);
            if let (Some((value, _)), Some((other, _))) = (parameter.carried(), other) {
                let change = (other - value).abs();
                let variance = probability * change * change;
                if largest.is_none_or(|largest| largest.0 < variance) {
                    *largest = Some((variance, change, form));
                }
            }
        }
    }
    for (parameter, largest) in parameters.iter_mut().zip(largest) {
        let (Some((variance, change, form)), Some((value, Some(std)))) =
            (largest, parameter.carried())
        else {
            continue;
        };
        let wider = std.hypot(variance.sqrt());
        parameter.std = Some(wider);
        let value = value.abs().max(f64::MIN_POSITIVE);
        let settled = settled_below(&parameter.key) * value;
        if wider > settled && (std <= settled || variance > std * std) {
            let percent = 100.0 * change / value;
            let reason = format!("{form}, if present, changes it by {percent:.1} %");
            parameter.set(Verdict::Searching, Reason::ModelMisses, reason);
        }
    }
}

/// Widens the inertia of a run that a current drives by the error of its samples. Where the voltage, which is not recorded, steps at
/// the samples, the mean of the current over a period `T` exceeds them by `T^2 v'/(12 L)` (Euler-Maclaurin formula), and by `T v'/(2 R)`
/// at most; with `v' = Ke w'` that is a torque in proportion to the acceleration. Unchanged where the armature is not known.
pub fn widen_by_sampled_current(
    parameters: &mut [ParameterEstimate],
    motor: &Motor,
    scenario: &Scenario,
) {
    let value = |key| motor.get(key).filter(|value| *value > 0.0);
    let period_s = scenario.mean_period_s();
    let of_one = [
        value(MotorKey::Inductance).map(|l| period_s * period_s / (12.0 * l)),
        value(MotorKey::Resistance).map(|r| period_s / (2.0 * r)),
    ];
    let of_one = of_one.into_iter().flatten().reduce(f64::min);
    let constants = value(MotorKey::BackEmf).zip(motor.torque_constant());
    let (Channel::Current, Some((of_one, (ke, kt)))) =
        (scenario.input_channel, of_one.zip(constants))
    else {
        return;
    };
    let own = parameters.iter_mut().find(|own| own.key == MotorKey::Inertia.key());
    let Some((inertia, (value, Some(std)))) = own.and_then(|own| own.carried().map(|c| (own, c)))
    else {
        return;
    };
    let sampling = ke * kt * of_one;
    let wider = std.hypot(sampling);
    inertia.std = Some(wider);
    let settled = settled_below(&inertia.key) * value.abs();
    if wider > settled && std <= settled {
        let percent = 100.0 * sampling / value.abs().max(f64::MIN_POSITIVE);
        let reason =
            format!("what the current is between its samples changes it by {percent:.1} %");
        inertia.set(Verdict::Searching, Reason::SampledTooSlowly, reason);
    }
}

/// The effects that are missing most often and bias the parameters of a fit by more than they leave in its residual.
fn forms_that_bias(fit: BiasedFit) -> impl Iterator<Item = &'static str> {
    let cards = CATALOGUE.iter().map(|effect| effect.card());
    cards.filter(move |card| card.biases.contains(&fit)).map(|card| card.id)
}

/// Largest change of each coordinate by a form that is added to the model, of those that explain more of the residual than
/// chance; `None` without one.
fn change_by_a_form(fit: &Fit, scenario: &Scenario, bread: &DMatrix<f64>) -> Option<DVector<f64>> {
    let minimum = &fit.minimum;
    let at = |model: &Model| {
        let problem = FreeRun::new(model, scenario, fit.noise).ok()?;
        problem.residuals(&minimum.x).ok().map(DVector::from_vec)
    };
    let base = at(&fit.model)?;
    let residual = DVector::from_column_slice(&minimum.residual);
    // The square of three standard deviations.
    let chance = 9.0 * minimum.cost / residual.len() as f64;
    let explained = forms_that_bias(BiasedFit::FreeRun).filter_map(|id| {
        let mut model = fit.model.with_effect(id).ok()?;
        let last = model.effects.len() - 1;
        let is_of_form = |slot: &Slot| matches!(slot, Slot::Effect { index, .. } if *index == last);
        let slots: Vec<Slot> = model.slots().into_iter().filter(is_of_form).collect();
        let effect = model.effects[last].effect;
        // Difference over a twentieth of the typical size, or of a period for a delay.
        let size = if effect.parameters().first()?.is_coefficient() {
            0.05 * typical_size(effect, 0, &model, scenario)
        } else {
            0.05 * scenario.mean_period_s()
        };
        model.set(slots.first()?, size);
        // Fixed, so that the coordinates stay those of the fit.
        model.fixed.extend(slots.iter().map(Slot::key));
        let column = (at(&model)? - &base) / size;
        // The part of the column that the fitted parameters do not explain (Frisch, Waugh and Lovell).
        let projection = bread * minimum.jacobian.tr_mul(&column);
        let partial = &column - &minimum.jacobian * &projection;
        let (power, score) = (partial.norm_squared(), partial.dot(&residual));
        // A form that is nearly collinear with the parameters is not observable.
        (power > 1e-5 * column.norm_squared())
            .then(|| (score * score / power, projection * (score / power)))
    });
    let significant = explained.filter(|(gain, _)| *gain > chance);
    significant.map(|(_, change)| change.abs()).reduce(|a, b| a.sup(&b))
}

/// Factor of the variances for correlated residuals: `1 - c + c n/D`.
pub(super) fn lasting(residual: &[f64]) -> f64 {
    let common = common_share(residual);
    // D = 20: with it and the forms above the intervals cover the parameters of a motor that is emulated with a delayed speed,
    // viscous friction, winding heating or an offset of the current.
    1.0 - common + common * f64::max(residual.len() as f64 / 20.0, 1.0)
}

/// Autocorrelation at lag one, zero where it is not significant.
fn common_share(residual: &[f64]) -> f64 {
    let power: f64 = residual.iter().map(|value| value * value).sum();
    let products: f64 = residual.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let (share, chance) = (products / power, BAND_99 / (residual.len() as f64).sqrt());
    if share > chance { share } else { 0.0 }
}

#[cfg(test)]
mod tests;
