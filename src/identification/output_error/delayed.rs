//! Output-error fit where the host stamped samples and commands: by how much the input came later than its stamps say is
//! one more unknown of the record, with what is known of it beforehand.
//!
//! Gauss-Newton by blocks: the parameters at a delay, then the delay along what they cannot follow, `g - J (J'J)^-1 J'g`.
//! What is left unknown of it enters every parameter's interval along `(J'J)^-1 J'g`.

use nalgebra::DVector;

use super::covariance::BLOCK_S;
use super::{Fit, FitError, FreeRun, estimates, fit};
use crate::identification::noise::NoiseFloor;
use crate::numerics::least_squares::inverse_where_determined;
use crate::numerics::levenberg_marquardt::Problem as _;
use crate::plant::{Model, Scenario};

/// Rounds at most, and the step in standard deviations at which they end.
const MOST_ROUNDS: usize = 6;
const SMALL_STEP: f64 = 0.1;
/// Share of what is known beforehand that the derivative is taken over.
const DIFFERENCE: f64 = 0.02;

/// As [`fit`]; the same where the drive stamped everything itself.
pub fn fit_delayed(
    starts: &[Model],
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Fit, FitError> {
    let Some((mean_s, prior_s)) = scenario.input_delay_s() else {
        return fit(starts, scenario, noise);
    };
    let mut delay_s = mean_s;
    let mut found = fit(starts, &scenario.with_input_delayed(delay_s), noise)?;
    for round in 0..MOST_ROUNDS {
        let here = scenario.with_input_delayed(delay_s);
        let x = &found.minimum.x;
        let residual_at = |delay_s: f64| -> Result<DVector<f64>, FitError> {
            let there = scenario.with_input_delayed(delay_s);
            let problem = FreeRun::new(&found.model, &there, *noise)?;
            let mut out = vec![0.0; problem.residual_len()];
            if problem.residual(x, &mut out) {
                Ok(DVector::from_vec(out))
            } else {
                Err(FitError::CannotSimulate {
                    run: scenario.name.clone(),
                })
            }
        };
        let half_s = DIFFERENCE * prior_s;
        let gradient =
            (residual_at(delay_s + half_s)? - residual_at(delay_s - half_s)?) / (2.0 * half_s);
        let jacobian = &found.minimum.jacobian;
        let (bread, _) = inverse_where_determined(jacobian);
        let along = bread * jacobian.tr_mul(&gradient);
        let own = &gradient - jacobian * &along;
        let residual = DVector::from_column_slice(&found.minimum.residual);
        let problem = FreeRun::new(&found.model, &here, *noise)?;
        let left = (found.interval_factor * found.nrms.max(1.0)).powi(2);
        let information = own.norm_squared() / left + prior_s.powi(-2);
        let pull = own.dot(&residual) / left + (delay_s - mean_s) / prior_s.powi(2);
        let white_s = information.sqrt().recip();
        let step_s = -pull / information;
        if step_s.abs() > SMALL_STEP * white_s && round + 1 < MOST_ROUNDS {
            delay_s += step_s.clamp(-prior_s, prior_s);
            let next = scenario.with_input_delayed(delay_s);
            found = fit(std::slice::from_ref(&found.model), &next, noise)?;
            continue;
        }
        // What neighbouring samples err by together, as the parameters' own intervals have it.
        let mut blocks: Vec<f64> = Vec::new();
        let mut last = None;
        for (row, (sample, _)) in problem.rows().iter().enumerate() {
            let block = (here.sample_time_s[*sample] / BLOCK_S).floor();
            if last != Some(block) {
                blocks.push(0.0);
                last = Some(block);
            }
            if let Some(score) = blocks.last_mut() {
                *score += own[row] * residual[row];
            }
        }
        let scores: f64 = blocks.iter().map(|score| score * score).sum();
        let clustered_s = found.interval_factor * scores.sqrt() / (left * information);
        let std_s = white_s.max(clustered_s).min(prior_s);
        let shared: Vec<f64> = along.iter().map(|share| share * std_s).collect();
        found.parameters = estimates(
            &problem,
            &found.minimum,
            &here,
            found.interval_factor,
            &shared,
        );
        break;
    }
    Ok(found)
}
