//! Free-run error: the part of a free run that no model predicts (of a disturbance of the load, and of an unknown voltage), the
//! excess of innovations over white noise, and the likelihood ratio of two models.

use super::eligible::prepared;
use super::kalman::{Noise, Passage, Update, predicted, stationary, stop};
use super::run::LinearisedRun;
use drivebench_model::plant::{Model, Scenario, State};

/// Lags over which what is left may be correlated.
const EXCESS_LAGS: usize = 40;

/// Root mean squares of current, A, and speed, rad/s, of a free run that the disturbance makes: no model predicts it.
pub(super) fn disturbance_error(run: &LinearisedRun<'_>) -> [f64; 2] {
    carried(run, &run.noise, |_| [0.0; 2])
}

/// The same of the unknown voltage in the holes of its record.
pub(super) fn unobserved(run: &LinearisedRun<'_>) -> [f64; 2] {
    let calm = Noise { disturbance_n_m: 0.0, input: 0.0, ..run.noise };
    carried(run, &calm, |passage| passage.unobserved)
}

/// The same of a run that has no part in the answer; none where the model cannot be simulated on it.
pub(crate) fn unobserved_in(
    run: &Scenario,
    model: &Model,
    noise: Noise,
    noise_is_known: bool,
) -> Option<[f64; 2]> {
    let run = prepared(run, noise_is_known);
    LinearisedRun::new(model, &run, State::default(), noise).map(|run| unobserved(&run))
}

/// Deviation of a free run by a disturbance and by what comes `fresh` with each passage.
fn carried(
    run: &LinearisedRun<'_>,
    noise: &Noise,
    fresh: impl Fn(&Passage) -> [f64; 2],
) -> [f64; 2] {
    let mut p = stationary(noise);
    let mut squares = [0.0; 2];
    for (passage, forget) in run.follower.passages.iter().zip(&run.follower.forgets) {
        let fresh = fresh(passage);
        let covariance = (fresh[0] * fresh[1]).sqrt();
        let passage = Passage {
            form: [0.0; 3],
            fresh,
            unobserved: fresh,
            together: if passage.begins_again { 0.0 } else { covariance },
            ..*passage
        };
        if passage.begins_again {
            p[0] = [0.0; 4];
            for row in &mut p {
                row[0] = 0.0;
            }
            stop(&mut p);
        }
        p = predicted(&p, &passage, &run.dynamics, noise, *forget);
        if passage.direction == 0.0 {
            stop(&mut p);
        }
        squares[0] += p[0][0];
        squares[1] += p[1][1];
    }
    let count = run.follower.passages.len().max(1) as f64;
    squares.map(|square: f64| (square / count).sqrt())
}

/// Ratio of the variance of sums of what is left of the innovations of `runs` to that of white noise, in the worse of the two
/// signals; at least one.
pub(super) fn excess(runs: &[(&LinearisedRun<'_>, Vec<[f64; 2]>)]) -> f64 {
    let mut worst: f64 = 1.0;
    for signal in 0..2 {
        let mut sums = [0.0; EXCESS_LAGS + 1];
        let mut count = 0.0;
        for (run, left) in runs {
            let updates = run.follower.updates.iter().zip(left);
            let left: Vec<f64> = updates
                .filter(|(update, _)| [update.current, update.speed][signal][4] > 0.0)
                .map(|(_, left)| left[signal])
                .collect();
            count += left.len() as f64;
            for (lag, sum) in sums.iter_mut().enumerate().take(left.len()) {
                let products = left.iter().zip(&left[lag..]);
                *sum += products.map(|(a, b)| a * b).sum::<f64>();
            }
        }
        if count > 0.0 {
            // A correlation counts beyond two standard deviations of chance.
            let chance = 2.0 * sums[0] / f64::sqrt(count);
            let alike = sums[1..].iter().take_while(|sum| **sum > chance);
            worst = worst.max((sums[0] + 2.0 * alike.sum::<f64>()) / count);
        }
    }
    worst
}

/// Likelihood ratio test of the second model against the first, in standard deviations: the root of twice the log of the ratio of
/// the likelihoods of all innovations, over the excess of what the second leaves; negative where it is less likely. `starts` is
/// where each sets out. Beside it root mean squares of current, A, and speed, rad/s, that the holes of the run make. `None`
/// where a model cannot be simulated on the run.
pub(crate) fn likelier(
    models: [&Model; 2],
    starts: [State; 2],
    run: &Scenario,
    noise: Noise,
    noise_is_known: bool,
) -> Option<(f64, [f64; 2])> {
    let run = prepared(run, noise_is_known);
    let [worse, better] = [0, 1].map(|k| LinearisedRun::new(models[k], &run, starts[k], noise));
    let (worse, better) = (worse?, better?);
    let widened = excess(&[(&better, better.followed.white.clone())]);
    let ratio = (log_likelihood(&better) - log_likelihood(&worse)) / widened;
    let z = ratio.signum() * (2.0 * ratio.abs()).sqrt();
    ratio.is_finite().then(|| (z, unobserved(&better)))
}

/// Log likelihood of the innovations but for what every model shares.
fn log_likelihood(run: &LinearisedRun<'_>) -> f64 {
    let of_sample = |(update, white): (&Update, &[f64; 2])| {
        let signals = [update.current[4], update.speed[4]].into_iter().zip(white);
        let measured = signals.filter(|(over_sd, _)| *over_sd > 0.0);
        let logs = measured.map(|(over_sd, white)| over_sd.ln() - 0.5 * white * white);
        logs.sum::<f64>()
    };
    let updates = run.follower.updates.iter();
    updates.zip(&run.followed.white).map(of_sample).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::kalman::{QUIET, hole};
    use crate::kit::nameplate;
    use drivebench_model::plant::testing::record;

    #[test]
    fn the_error_by_a_hole_is_that_of_the_equations() {
        let model = nameplate();
        let [known, other] = [20.0, 23.0].map(|hidden_v| {
            let events = vec![(0.0, 20.0), (0.5, hidden_v), (0.51, 20.0)];
            record(&model, events, 1e-2, 1.0, 3)
        });
        let mut scenario = known.clone();
        scenario.unknown_input = vec![hole(0.5, 0.51, 9.0)];
        let of = |scenario| LinearisedRun::new(&model, scenario, State::default(), QUIET).unwrap();
        let (run, whole) = (of(&scenario), of(&known));
        let rms = |a: &[f64], b: &[f64]| {
            let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            (squares / a.len() as f64).sqrt()
        };
        // Both records have the same noise: they differ by the voltage.
        let current = rms(&known.current_a, &other.current_a);
        let truth = [current, rms(&known.speed_rad_s, &other.speed_rad_s)];
        for (found, truth) in unobserved(&run).into_iter().zip(truth) {
            assert!((found / truth - 1.0).abs() < 0.1, "{found}, not {truth}");
        }
        assert!(unobserved(&whole).iter().all(|rms| *rms <= 0.0));
        // A disturbance of the load does not depend on holes.
        let difference = disturbance_error(&run)[0] / disturbance_error(&whole)[0] - 1.0;
        assert!(difference.abs() < 1e-9, "{difference}");
    }
}
