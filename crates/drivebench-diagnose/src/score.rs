//! A fitted model, and the error of a model on a run: of its free run or of its balance of torques, in SI and in units of the
//! noise.

use serde::{Serialize, Serializer, ser::SerializeMap};

use drivebench_identify::balance::TorqueRows;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::{self, Fit, FitError};
use drivebench_identify::verdict::SETTLED_BELOW_RATIO;
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{Input, Model, ParameterSpec, Scenario, State, effect};
use drivebench_model::sample::{ParameterEstimate, Reason};

/// Figures of one signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalScore {
    /// `100 (1 - |e| / |y - mean y|)`, not clipped.
    pub fit_percent: f64,
    pub rmse: f64,
    #[serde(skip)]
    pub samples: usize,
}

impl SignalScore {
    pub(super) const UNKNOWN: Self = Self { fit_percent: f64::NAN, rmse: f64::NAN, samples: 0 };
}

/// Residuals of a free run over the scored samples, or of a balance of torques over its rows.
#[derive(Clone, Debug)]
pub struct Score {
    pub current: Option<SignalScore>,
    pub speed: Option<SignalScore>,
    /// Of a run that is driven by a torque or a current, instead of the two above.
    pub torque: Option<SignalScore>,
    /// Root of the mean over the signals of `(rmse / noise)^2`. A signal whose noise is not known has figures of its own and
    /// no part in this.
    pub nrms: f64,
    /// Time and residual of the current, A, the speed, rad/s, and the torque, N.m; empty where it is not judged.
    pub(super) current_residual: Vec<(f64, f64)>,
    pub(super) speed_residual: Vec<(f64, f64)>,
    pub(super) torque_residual: Vec<(f64, f64)>,
}

impl Score {
    /// Simulates a complete model over the scenario; only the initial state is fitted, where the run starts in motion.
    pub fn of(model: &Model, scenario: &Scenario, noise: &NoiseFloor) -> Result<Self, FitError> {
        let trajectory = output_error::predict(model, scenario, noise)?.trajectory;
        let scored = &scenario.scored;
        let judged = |simulated: &[f64], measured: &[f64], counts: bool| {
            // A dead sensor has nothing to compare with.
            if !counts || !varies(measured) {
                return (None, Vec::new());
            }
            let residual: Vec<f64> = scored.clone().map(|k| simulated[k] - measured[k]).collect();
            let score = signal_score(&residual, &measured[scored.clone()]);
            let times = &scenario.sample_time_s[scored.clone()];
            (score, finite_points(times, &residual))
        };
        let by_voltage = scenario.input == Input::Voltage;
        let (current, current_residual) =
            judged(&trajectory.current_a, &scenario.current_a, by_voltage);
        let (speed, speed_residual) = judged(&trajectory.speed_rad_s, &scenario.speed_rad_s, true);
        let rms = [current, speed].map(|signal| signal.map(|signal| signal.rmse));
        // Not zero, the error of a perfect model, where no signal can be judged.
        let nrms = in_noise(rms, noise).unwrap_or(f64::NAN);
        Ok(Self {
            current,
            speed,
            torque: None,
            nrms,
            current_residual,
            speed_residual,
            torque_residual: Vec::new(),
        })
    }

    /// Of a balance of torques with this sum of its terms; `unit_n_m` is the noise of a row.
    pub(super) fn of_balance(rows: &TorqueRows, predicted: &[f64], unit_n_m: f64) -> Self {
        let residual = rows.residual(predicted);
        let torque = signal_score(&residual, &rows.weighted(rows.left.iter().copied()));
        Self {
            current: None,
            speed: None,
            torque,
            nrms: torque.map_or(f64::NAN, |torque| torque.rmse / unit_n_m),
            current_residual: Vec::new(),
            speed_residual: Vec::new(),
            torque_residual: finite_points(&rows.time_s, &residual),
        }
    }

    /// Readings that are judged: of the signal that has most of them.
    pub(super) fn samples(&self) -> usize {
        let signals = [self.current, self.speed, self.torque].into_iter().flatten();
        signals.map(|own| own.samples).max().unwrap_or(0)
    }

    /// Sum of the squares of a free run's errors in units of the noise, of the signals whose noise is known.
    pub(super) fn deviance(&self, noise: &NoiseFloor) -> f64 {
        let current = self.current.map(|own| (own, noise.current_a));
        let speed = self.speed.map(|own| (own, noise.speed_rad_s));
        let judged = [current, speed].into_iter().flatten();
        judged
            .filter(|(_, level)| level.is_finite())
            .map(|(own, level)| own.samples as f64 * (own.rmse / level).powi(2))
            .sum()
    }
}

/// Whether a signal ever changes.
pub(super) fn varies(values: &[f64]) -> bool {
    let mut present = values.iter().filter(|value| value.is_finite());
    #[expect(clippy::float_cmp, reason = "exactly constant")]
    present.next().is_some_and(|first| present.any(|value| value != first))
}

pub(super) fn signal_score(residual: &[f64], measured: &[f64]) -> Option<SignalScore> {
    let pairs = residual.iter().copied().zip(measured.iter().copied());
    let known = pairs.filter(|(error, value)| error.is_finite() && value.is_finite());
    let pairs: Vec<(f64, f64)> = known.collect();
    if pairs.is_empty() {
        return None;
    }
    let samples = pairs.len();
    let mean = pairs.iter().map(|pair| pair.1).sum::<f64>() / samples as f64;
    let spread: f64 = pairs.iter().map(|pair| (pair.1 - mean).powi(2)).sum();
    let squares: f64 = pairs.iter().map(|pair| pair.0 * pair.0).sum();
    let fit_percent = 100.0 * (1.0 - (squares / spread.max(f64::MIN_POSITIVE)).sqrt());
    Some(SignalScore { fit_percent, rmse: (squares / samples as f64).sqrt(), samples })
}

fn finite_points(time_s: &[f64], values: &[f64]) -> Vec<(f64, f64)> {
    let points = time_s.iter().copied().zip(values.iter().copied());
    points.filter(|(_, value)| value.is_finite()).collect()
}

/// A fitted model with its parameters' estimates, by whatever method.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub model: Model,
    /// Every parameter of the model, in the order of its slots.
    pub parameters: Vec<ParameterEstimate>,
    /// Training error in units of the noise.
    pub nrms: f64,
    pub noise: NoiseFloor,
    /// Factor of the standard deviations above, because more than noise is left in the residual.
    pub interval_factor: f64,
    /// State at the begin of the training run.
    pub start: State,
}

impl Fitted {
    /// The same with its values unsettled where its error `nrms` is several times the noise `floor`, which is zero where none is
    /// known.
    pub(super) fn judged_by_error(&self, nrms: f64, floor: f64) -> Self {
        let mut judged = self.clone();
        if floor > 0.0 && nrms > SETTLED_BELOW_RATIO * floor {
            for own in &mut judged.parameters {
                let times = nrms / floor;
                let reason =
                    format!("the model leaves {times:.1} times the noise of the held-out run");
                own.unsettle(Reason::ModelMisses, reason);
            }
        }
        judged
    }

    /// The same with the values of effects that runs do not distinguish from others, the second of each pair, unsettled: valid only if
    /// the others are not present.
    pub(super) fn judged_with(mut self, confusable: &[[&'static str; 2]]) -> Self {
        for [id, rival] in confusable {
            let is_own = |key: &str| {
                let rest = key.strip_prefix(id);
                rest.is_some_and(|rest| rest.starts_with('.'))
            };
            for own in self.parameters.iter_mut().filter(|own| is_own(&own.key)) {
                let reason = format!("these runs do not distinguish {id} from {rival}");
                own.unsettle(Reason::Ambiguous, reason);
            }
        }
        self
    }

    /// Whether a coefficient of an effect lies `sigmas` of its standard deviations from zero; of an effect without
    /// coefficients any parameter. A slope over the current up to a boundary vanishes with the boundary too. `None` where no value is
    /// known.
    pub(super) fn is_significant(&self, id: &str, sigmas: f64) -> Option<bool> {
        let effect = effect::find(id)?;
        let (specs, card) = (effect.parameters(), effect.card());
        let of = |spec: &ParameterSpec| {
            let key = format!("{id}.{}", spec.key);
            let own = self.parameters.iter().find(|own| own.key == key)?;
            let (value, std) = own.value.zip(own.std)?;
            Some(value != 0.0 && value.abs() >= sigmas * std)
        };
        let has_coefficients = specs.iter().any(ParameterSpec::is_coefficient);
        let sizes = specs.iter().filter(|spec| !has_coefficients || spec.is_coefficient());
        let significant = sizes.filter_map(of).reduce(|one, another| one || another)?;
        let is_over_current = matches!(card.curve, Some((_, Axis::Current)));
        let boundary = card.limit.filter(|_| is_over_current);
        let vanishes = boundary.is_some_and(|limit| of(&specs[limit.parameter]) == Some(false));
        Some(significant && !vanishes)
    }
}

impl From<Fit> for Fitted {
    fn from(fit: Fit) -> Self {
        Self {
            model: fit.model,
            parameters: fit.parameters,
            nrms: fit.nrms,
            noise: fit.noise,
            interval_factor: fit.interval_factor,
            start: fit.start,
        }
    }
}

pub(super) fn cannot_simulate(run: &Scenario) -> FitError {
    let run = run.name.clone();
    FitError::CannotSimulate { run }
}

/// Root mean squares of current, A, and speed, rad/s, combined in units of the noise; none where neither is known.
pub(super) fn in_noise(rms: [Option<f64>; 2], noise: &NoiseFloor) -> Option<f64> {
    let levels = [noise.current_a, noise.speed_rad_s];
    let squares: Vec<f64> = (rms.into_iter().zip(levels))
        .filter(|(_, level)| level.is_finite())
        .filter_map(|(rms, level)| Some((rms? / level).powi(2)))
        .collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

/// Parameters as a JSON object by their key.
pub(super) fn by_key<S: Serializer>(
    parameters: &[ParameterEstimate],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(parameters.len()))?;
    for parameter in parameters {
        let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
        map.serialize_entry(key, parameter)?;
    }
    map.end()
}

/// The parameters of one effect.
pub(super) fn parameters_of(id: &str, all: &[ParameterEstimate]) -> Vec<ParameterEstimate> {
    let prefix = format!("{id}.");
    all.iter().filter(|own| own.key.starts_with(&prefix)).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{held, nameplate, record, truth};
    use drivebench_model::plant::testing;
    use drivebench_model::sample::Verdict;

    #[test]
    fn the_error_of_a_fit_is_that_of_its_score_however_often_each_signal_was_sampled() {
        let fan = truth("quadratic_load", &[3e-6]);
        let mut run = testing::record(&fan, held(&[60.0, -90.0, 30.0], 1.1), 2e-3, 4.0, 3);
        for row in (200..run.samples()).filter(|row| row % 5 > 0) {
            run.current_a[row] = f64::NAN;
        }
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let fit = output_error::fit(&[nameplate()], &run, &noise).unwrap();
        let score = Score::of(&fit.model, &run, &noise).unwrap().nrms;
        assert!((fit.nrms / score - 1.0).abs() < 1e-9, "{} {score}", fit.nrms);
        let weighing_samples = (fit.minimum.cost / fit.minimum.residual.len() as f64).sqrt();
        assert!((weighing_samples / score - 1.0).abs() > 0.05);
        // A signal that is not judged does not count.
        let unjudged = NoiseFloor { current_a: f64::INFINITY, ..noise };
        let score = Score::of(&fit.model, &run, &unjudged).unwrap();
        let alone = score.speed.unwrap().samples as f64 * score.nrms.powi(2);
        assert!((score.deviance(&unjudged) / alone - 1.0).abs() < 1e-9);
    }

    #[test]
    fn coefficients_decide_significance_before_shapes() {
        let run = record(&nameplate(), 0, 7);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let fit = output_error::fit(&[nameplate()], &run, &noise).unwrap();
        let mut fit = Fitted::from(fit);
        let estimate = |&(key, value, std): &(&str, f64, Option<f64>)| ParameterEstimate {
            key: key.to_owned(),
            value: Some(value),
            std,
            unit: "",
            verdict: Verdict::Settled,
            reason: None,
            code: None,
        };
        let stribeck: &[(&str, f64, Option<f64>)] = &[
            ("stribeck_friction.stribeck_n_m", 5e-3, Some(2.2e-2)),
            ("stribeck_friction.speed_rad_s", 33.0, Some(3.0)),
        ];
        let wave: &[_] =
            &[("cogging.sin_n_m", 1e-3, Some(2e-2)), ("cogging.cos_n_m", -5e-2, Some(2e-2))];
        let none: &[_] = &[("voltage_drop.drop_v", 0.0, Some(0.0))];
        let coupling: &[_] = &[("elastic_coupling.frequency_hz", 20.0, Some(0.1))];
        let unknown: &[_] = &[("cogging.sin_n_m", 1.0, None)];
        let slope = |boundary_a, std_a| {
            [
                ("discontinuous_conduction.extra_ohm", 0.63, Some(0.2)),
                ("discontinuous_conduction.boundary_a", boundary_a, Some(std_a)),
            ]
        };
        for (values, id, sigmas, significant) in [
            // A speed of 33 +- 3 rad/s is no coefficient.
            (stribeck, "stribeck_friction", 1.0, Some(false)),
            (wave, "cogging", 2.0, Some(true)),
            (wave, "cogging", 3.0, Some(false)),
            // Zero is not significant, however small its deviation.
            (none, "voltage_drop", 1.0, Some(false)),
            // A coupling has no coefficient.
            (coupling, "elastic_coupling", 1.0, Some(true)),
            (unknown, "cogging", 1.0, None),
            // Of no voltage without a boundary.
            (&slope(7e-4, 0.096), "discontinuous_conduction", 1.0, Some(false)),
            (&slope(0.3, 0.05), "discontinuous_conduction", 1.0, Some(true)),
            (wave, "voltage_drop", 1.0, None),
        ] {
            fit.parameters = values.iter().map(estimate).collect();
            assert_eq!(fit.is_significant(id, sigmas), significant, "{id} {sigmas}");
        }
    }
}
