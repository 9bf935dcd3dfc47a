//! Trivial predictions of a held-out run: a constant, and for a speed under a voltage a first-order lag.
//!
//! A fit that does not beat them has no predictive power, and nothing can be concluded from its residual: neither that
//! an effect is present nor that it is not. Forecasts are scored against such benchmarks (Hyndman and Koehler 2006,
//! "Another look at measures of forecast accuracy").

use super::evidence::Evidence;
use super::score::Score;
use drivebench_identify::first_order::FirstOrder;
use drivebench_model::findings;
use drivebench_model::numerics::statistics::{finite, mean, variance};
use drivebench_model::plant::Scenario;

/// A signal with less than this many times its noise about its mean is constant: no model can beat the mean.
const MOVES_RATIO: f64 = 2.0;
/// Largest ratio of the model's error to that of a lag: the lag is fitted to the speed alone, the model to the current
/// too, so that its error of the speed may be larger.
const LAG_RATIO: f64 = 1.25;
/// Share of the error of the best constant that a model has to stay below: above it less than a fifth of the variance is
/// explained, as by chance with a wrong input.
const CONSTANT_RATIO: f64 = 0.9;
/// Readings below which nothing is compared.
const FEWEST: usize = 8;

findings! {
    /// A prediction that is as good as the fitted model, with the error of both in the unit of the signal.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum TrivialPrediction {
        Mean { signal: &'static str, unit: &'static str, error: f64, own: f64 } = "mean_is_as_good",
        LastValue { signal: &'static str, unit: &'static str, error: f64, own: f64 } = "last_value_is_as_good",
        Lag { error: f64, own: f64, gain_rad_s_per_v: f64, time_constant_s: f64 } = "first_order_lag_is_as_good",
    }
}

/// What predicts a signal of the held-out run as well as the fitted model does; `None` where the model is better
/// than each. `score` is the model's on the hold-out; `torques` are those of the rows of a balance, fitted and held out.
pub(super) fn as_good(
    score: &Score,
    evidence: &Evidence,
    torques: Option<[&[f64]; 2]>,
) -> Option<TrivialPrediction> {
    if let Some([fitted, held_out]) = torques {
        return constant("torque", "N.m", score.torque?.rmse, fitted, held_out, 0.0);
    }
    let (fitted, held_out) = (&evidence.training, &evidence.holdout);
    let of = |name, unit, own: Option<f64>, pick: fn(&Scenario) -> &Vec<f64>, level: f64| {
        let part = |run: &Scenario| pick(run)[run.scored.clone()].to_vec();
        let is_known = evidence.noise.samples > 0 && level.is_finite();
        let level = if is_known { level } else { 0.0 };
        constant(name, unit, own?, &part(fitted), &part(held_out), level)
    };
    let speed = score.speed.map(|own| own.rmse);
    let current = score.current.map(|own| own.rmse);
    of("speed", "rad/s", speed, |run| &run.speed_rad_s, evidence.noise.speed_rad_s)
        .or_else(|| of("current", "A", current, |run| &run.current_a, evidence.noise.current_a))
        .or_else(|| lag(speed?, fitted, held_out))
}

/// Whether the mean of the held-out part, the best constant that there is, or the last value of the fitted part predicts the
/// held-out part as well.
fn constant(
    signal: &'static str,
    unit: &'static str,
    own: f64,
    fitted: &[f64],
    held_out: &[f64],
    noise: f64,
) -> Option<TrivialPrediction> {
    let (fitted, held_out) = (finite(fitted), finite(held_out));
    if held_out.len() < FEWEST || variance(&held_out).sqrt() < MOVES_RATIO * noise {
        return None;
    }
    let error = |value: f64| {
        let squares = held_out.iter().map(|own| (own - value) * (own - value));
        mean(&squares.collect::<Vec<f64>>()).sqrt()
    };
    let is_as_good = |error: f64| own.is_nan() || own >= CONSTANT_RATIO * error;
    let [mean, last] = [mean(&held_out), *fitted.last()?].map(error);
    if is_as_good(mean) {
        return Some(TrivialPrediction::Mean { signal, unit, error: mean, own });
    }
    is_as_good(last).then_some(TrivialPrediction::LastValue { signal, unit, error: last, own })
}

/// Whether a first-order lag of the voltage, fitted by least squares, predicts the held-out speed clearly better.
fn lag(own: f64, fitted: &Scenario, held_out: &Scenario) -> Option<TrivialPrediction> {
    let lag = FirstOrder::plain(fitted)?;
    let error = lag.left_of(held_out);
    (own > LAG_RATIO * error).then_some(TrivialPrediction::Lag {
        error,
        own,
        gain_rad_s_per_v: lag.gain_rad_s_per_v,
        time_constant_s: lag.time_constant_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{evidence, nameplate};
    use drivebench_model::plant::{Model, MotorKey};

    fn found(model: &Model) -> Option<TrivialPrediction> {
        let evidence = evidence(&nameplate(), 1);
        let score = Score::of(model, &evidence.holdout, &evidence.noise).unwrap();
        as_good(&score, &evidence, None)
    }

    #[test]
    fn the_true_model_beats_every_trivial_prediction() {
        assert_eq!(found(&nameplate()), None);
    }

    #[test]
    fn a_model_without_predictive_power_does_not_beat_a_constant_or_a_lag() {
        let mut heavy = nameplate();
        heavy.motor.set(MotorKey::Inertia, 10.0);
        let of = found(&heavy).unwrap();
        assert!(matches!(of, TrivialPrediction::Mean { signal: "speed", .. }), "{of:?}");
        let mut light = nameplate();
        let load = light.motor.get(MotorKey::LoadTorque).unwrap();
        light.motor.set(MotorKey::LoadTorque, 6.0 * load);
        let of = found(&light).unwrap();
        assert!(!matches!(of, TrivialPrediction::LastValue { .. }), "{of:?}");
    }

    #[test]
    fn a_balance_is_compared_with_the_mean_of_its_torque() {
        let held_out: Vec<f64> = (0..40).map(|k| f64::from(k % 7)).collect();
        let is_found = |own| constant("torque", "N.m", own, &held_out, &held_out, 0.0).is_some();
        assert!(is_found(2.5) && is_found(f64::NAN) && !is_found(0.5));
        // A signal of noise alone is not compared.
        assert_eq!(constant("torque", "N.m", 2.5, &held_out, &held_out, 2.0), None);
        assert_eq!(constant("torque", "N.m", 2.5, &held_out, &held_out[..3], 0.0), None);
    }
}
