//! Free-run error by the Lyapunov recursion of its covariance (disturbance of the load, unknown commands), long-run variance of the
//! innovations over that of white noise, and the likelihood-ratio test of two models.

use super::eligible::prepared;
use super::kalman::{Noise, Transition, Update, fix_speed, predicted_covariance, stationary};
use super::run::LinearisedRun;
use crate::score::in_noise;
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::plant::{Model, Scenario, State};

/// Root mean square error of current, A, and speed, rad/s, of a free run caused by the disturbance.
pub(super) fn disturbance_error(run: &LinearisedRun<'_>) -> [f64; 2] {
    propagated_rms(run, &run.noise, |_| [[0.0; 2]; 2])
}

/// Errors that no model predicts: root mean squares of current and speed, or of both in units of the noise.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Unpredicted<T> {
    /// By the unknown voltage in the holes of the record.
    pub(crate) lost_rows: T,
    /// By the random errors of the host's stamps.
    pub(crate) stamps: T,
}

impl Unpredicted<[f64; 2]> {
    /// In units of the noise; `None` where that of neither signal is known.
    pub(crate) fn in_noise(self, noise: &NoiseFloor) -> Option<Unpredicted<f64>> {
        let of = |rms: [f64; 2]| in_noise(rms.map(Some), noise);
        Some(Unpredicted { lost_rows: of(self.lost_rows)?, stamps: of(self.stamps)? })
    }
}

/// The same, caused by holes of the record and by stamps, A and rad/s.
pub(super) fn unpredicted(run: &LinearisedRun<'_>) -> Unpredicted<[f64; 2]> {
    let calm = Noise { disturbance_n_m: 0.0, input: 0.0, ..run.noise };
    let of_commands = propagated_rms(run, &calm, |transition| [[0.0; 2], transition.edges]);
    let own = &run.filtered.stamp_variance;
    let count = own.len().max(1) as f64;
    let of_samples = [0, 1].map(|signal| {
        let sum: f64 = own.iter().map(|variance| variance[signal]).sum();
        run.noise.stamps * (sum / count).sqrt()
    });
    Unpredicted {
        lost_rows: propagated_rms(run, &calm, |transition| [transition.unobserved, [0.0; 2]]),
        stamps: [0, 1].map(|signal| of_commands[signal].hypot(of_samples[signal])),
    }
}

/// The same for a run outside the diagnosis; `None` where the model cannot be simulated on it.
pub(crate) fn unpredicted_in(
    run: &Scenario,
    model: &Model,
    noise: Noise,
    noise_is_known: bool,
) -> Option<Unpredicted<[f64; 2]>> {
    let run = prepared(run, noise_is_known);
    LinearisedRun::new(model, &run, State::default(), noise).map(|run| unpredicted(&run))
}

/// Root mean square deviation of a free run by a disturbance and the variances added per transition, of one unknown voltage and at edges (A. Gelb, *Applied Optimal
/// Estimation*, §4.1: covariance propagation without updates).
fn propagated_rms(
    run: &LinearisedRun<'_>,
    noise: &Noise,
    added: impl Fn(&Transition) -> [[f64; 2]; 2],
) -> [f64; 2] {
    // A balance of torques is no free run: nothing adds up from row to row.
    if run.dynamics.balanced_kg_m2.is_some() {
        return [0.0; 2];
    }
    let mut p = stationary(noise);
    let mut squares = [0.0; 2];
    for (transition, decay) in run.gains.transitions.iter().zip(&run.gains.decays) {
        let [added_variance, edges] = added(transition);
        let covariance = (added_variance[0] * added_variance[1]).sqrt();
        let transition = Transition {
            form: [0.0; 3],
            added_variance,
            unobserved: added_variance,
            edges,
            covariance: if transition.restarts { 0.0 } else { covariance },
            ..*transition
        };
        if transition.restarts {
            p[0] = [0.0; 4];
            for row in &mut p {
                row[0] = 0.0;
            }
            fix_speed(&mut p);
        }
        p = predicted_covariance(&p, &transition, &run.dynamics, noise, *decay);
        if transition.direction == 0.0 {
            fix_speed(&mut p);
        }
        squares[0] += p[0][0];
        squares[1] += p[1][1];
    }
    let count = run.gains.transitions.len().max(1) as f64;
    squares.map(|square: f64| (square / count).sqrt())
}

/// Long-run variance of the standardised innovations of `runs`, the larger of the two signals, at least that of white noise, 1: the
/// sum of the autocovariances up to the first insignificant lag (cf. Geyer, Statistical Science 7, 1992).
pub(super) fn excess(runs: &[(&LinearisedRun<'_>, Vec<[f64; 2]>)]) -> f64 {
    let mut worst: f64 = 1.0;
    for signal in 0..2 {
        // Lag 0 and 40 further ones.
        let mut sums = [0.0; 41];
        let mut count = 0.0;
        for (run, left) in runs {
            let updates = run.gains.updates.iter().zip(left);
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
            // Two standard deviations of the autocovariance of white noise.
            let least = 2.0 * sums[0] / f64::sqrt(count);
            let significant = sums[1..].iter().take_while(|sum| **sum > least);
            worst = worst.max((sums[0] + 2.0 * significant.sum::<f64>()) / count);
        }
    }
    worst
}

/// Signed root of the likelihood-ratio statistic of the second model against the first, in standard deviations: the statistic is
/// twice the log likelihood ratio over the excess of the second model; negative where the second is less likely. `starts` are the
/// initial states. Also the root mean squares of current, A, and speed, rad/s, caused by the holes of the run. `None` where a model
/// cannot be simulated on the run.
pub(crate) fn likelier(
    models: [&Model; 2],
    starts: [State; 2],
    run: &Scenario,
    noise: Noise,
    noise_is_known: bool,
) -> Option<(f64, Unpredicted<[f64; 2]>)> {
    let run = prepared(run, noise_is_known);
    let [worse, better] = [0, 1].map(|k| LinearisedRun::new(models[k], &run, starts[k], noise));
    let (worse, better) = (worse?, better?);
    let excess = excess(&[(&better, better.filtered.white.clone())]);
    let log_ratio = (log_likelihood(&better) - log_likelihood(&worse)) / excess;
    let z = log_ratio.signum() * (2.0 * log_ratio.abs()).sqrt();
    log_ratio.is_finite().then(|| (z, unpredicted(&better)))
}

/// Log likelihood of the innovations, without the constant `-ln(2 pi)/2` per reading.
fn log_likelihood(run: &LinearisedRun<'_>) -> f64 {
    let of_sample = |(update, white): (&Update, &[f64; 2])| {
        let signals = [update.current[4], update.speed[4]].into_iter().zip(white);
        let measured = signals.filter(|(over_sd, _)| *over_sd > 0.0);
        let logs = measured.map(|(over_sd, white)| over_sd.ln() - 0.5 * white * white);
        logs.sum::<f64>()
    };
    let updates = run.gains.updates.iter();
    updates.zip(&run.filtered.white).map(of_sample).sum()
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
        for (found, truth) in unpredicted(&run).lost_rows.into_iter().zip(truth) {
            assert!((found / truth - 1.0).abs() < 0.1, "{found}, not {truth}");
        }
        assert!(unpredicted(&whole).lost_rows.iter().all(|rms| *rms <= 0.0));
        // A disturbance of the load does not depend on holes.
        let difference = disturbance_error(&run)[0] / disturbance_error(&whole)[0] - 1.0;
        assert!(difference.abs() < 1e-9, "{difference}");
    }
}
