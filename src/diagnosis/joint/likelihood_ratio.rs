//! Likelihood ratio of two complete models on a run that neither was fitted to.

use super::asked::prepared;
use super::columns::Around;
use super::excess::excess;
use super::follow::Noise;
use super::free_run::unseen;
use crate::plant::{Model, Scenario, State};

/// How much likelier the second model makes the run, in standard deviations: the root of twice the log of the ratio of the
/// likelihoods of all innovations, over the excess of what the second leaves; negative where it is less likely. `start` is
/// where each sets out. Beside it root mean squares of current, A, and speed, rad/s, that the holes of the run make. `None`
/// where a model cannot be followed on the run.
pub(in crate::diagnosis) fn likelier(
    models: [&Model; 2],
    starts: [State; 2],
    run: &Scenario,
    noise: Noise,
    noise_is_known: bool,
) -> Option<(f64, [f64; 2])> {
    let run = prepared(run, noise_is_known);
    let [worse, better] = [0, 1].map(|k| Around::new(models[k], &run, starts[k], noise));
    let (worse, better) = (worse?, better?);
    let white = better.followed.white.clone();
    let widened = excess(&[(&better, white)]);
    let ratio = (log_likelihood(&better) - log_likelihood(&worse)) / widened;
    ratio.is_finite().then(|| {
        let z = ratio.signum() * (2.0 * ratio.abs()).sqrt();
        (z, unseen(&better))
    })
}

/// Log likelihood of the innovations but for what every model shares.
fn log_likelihood(run: &Around<'_>) -> f64 {
    let updates = run.follower.updates.iter();
    updates
        .zip(&run.followed.white)
        .map(|(update, white)| {
            [update.current[4], update.speed[4]]
                .into_iter()
                .zip(white)
                .filter(|(over_sd, _)| *over_sd > 0.0)
                .map(|(over_sd, white)| over_sd.ln() - 0.5 * white * white)
                .sum::<f64>()
        })
        .sum()
}
