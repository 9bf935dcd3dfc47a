//! What a torque over the angle does to current and speed, to first order: enough to tell which of many orders to try.
//!
//! A free run for each of some twenty orders, twice, would be most of the screen's work. Here the deviation from the
//! baseline follows the linear part `d/dt [i, w] = A [i, w] - [0, T/J]`, with the torque taken at what was measured, and
//! rests where the shaft rests.

use crate::identification::output_error::FreeRun;
use crate::plant::{Effect, Instant, Linear, Model, Scenario, Terms};

/// Multiple of the speed's noise below which the shaft counts as at rest.
const AT_REST: f64 = 4.0;

/// Change of the weighted residual by a coefficient of one, for each value of `values` (the effect's parameters): told to
/// `each` row by row of the residual, so that no long column need be kept. `None` where the model has no electrical part
/// or the effect is more than a torque.
pub(super) fn responses(
    effect: &dyn Effect,
    values: &[Vec<f64>],
    model: &Model,
    scenario: &Scenario,
    problem: &FreeRun<'_>,
    mut each: impl FnMut(usize, &[f64]),
) -> Option<()> {
    let linear = Linear::of(model)?;
    let noise = problem.noise();
    // Where the speed's noise is not known only a shaft that does not move at all is at rest.
    let known_noise = if noise.speed_rad_s.is_finite() {
        noise.speed_rad_s
    } else {
        0.0
    };
    let terms: Vec<_> = values.iter().map(|values| effect.terms(values)).collect();
    let simple = |terms: &dyn Terms| {
        terms.states() == 0 && terms.path().measures_directly() && terms.coupling().is_none()
    };
    if !terms.iter().all(|terms| simple(terms.as_ref())) {
        return None;
    }
    let angles = scenario.shaft_angle();
    let mut angle = angles.iter().peekable();
    let (mut last_angle_s, mut last_angle_rad) = (f64::INFINITY, 0.0);
    // A cell that is missing says nothing: what was measured last holds, and before that the shaft is taken to rest.
    let (mut current_a, mut speed_rad_s) = (0.0, 0.0);
    let mut deviation = vec![[0.0; 2]; terms.len()];
    let mut weighted = vec![0.0; terms.len()];
    let mut rows = problem.rows().iter().enumerate().peekable();
    let mut step_s = 0.0;
    let mut step = linear.over(step_s);
    for sample in 0..scenario.samples() {
        let time_s = scenario.sample_time_s[sample];
        while let Some(point) = angle.next_if(|point| point.0 <= time_s) {
            (last_angle_s, last_angle_rad) = *point;
        }
        if sample > 0 {
            let interval_s = time_s - scenario.sample_time_s[sample - 1];
            if (interval_s - step_s).abs() > 1e-9 * interval_s {
                step_s = interval_s;
                step = linear.over(step_s);
            }
        }
        for (held, measured) in [
            (&mut current_a, scenario.current_a[sample]),
            (&mut speed_rad_s, scenario.speed_rad_s[sample]),
        ] {
            if measured.is_finite() {
                *held = measured;
            }
        }
        let rests = speed_rad_s.abs() <= AT_REST * known_noise;
        let at = Instant {
            time_s: time_s - scenario.begin_s(),
            current_a,
            speed_rad_s,
            // The torque acts over the interval that ends here: at its middle.
            angle_rad: last_angle_rad
                + speed_rad_s * ((time_s - last_angle_s).max(0.0) - 0.5 * step_s),
            ..Instant::of(&model.motor)
        };
        for (terms, deviation) in terms.iter().zip(&mut deviation) {
            let torque_n_m = if rests {
                0.0
            } else {
                terms.torque_n_m(&at, &[])
            };
            *deviation = step.after(*deviation, torque_n_m);
            if rests {
                deviation[1] = 0.0;
            }
        }
        while let Some((row, (_, is_speed))) = rows.next_if(|(_, row)| row.0 == sample) {
            for (weighted, deviation) in weighted.iter_mut().zip(&deviation) {
                *weighted = if *is_speed {
                    deviation[1] / noise.speed_rad_s
                } else {
                    deviation[0] / noise.current_a
                };
            }
            each(row, &weighted);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;

    use super::*;
    use crate::identification::noise::NoiseFloor;
    use crate::numerics::levenberg_marquardt::Problem;
    use crate::plant::{ActiveEffect, Motor, effect, testing};

    #[test]
    fn it_agrees_with_the_difference_of_two_free_runs() {
        let baseline = Model::baseline(Motor::zk_22fc());
        let events = vec![(0.0, 0.0), (0.4, 40.0), (1.5, -30.0), (2.6, 60.0)];
        let mut run = testing::record(&baseline, events, 0.001, 3.5, 4);
        run.angle = run.shaft_angle().into_owned();
        agrees(&baseline, &run);
    }

    #[test]
    fn cells_that_are_missing_are_no_rest() {
        // A drive that gives current and speed in turn: no row has both.
        let baseline = Model::baseline(Motor::zk_22fc());
        let events = vec![(0.0, 0.0), (0.4, 40.0), (1.5, -30.0), (2.6, 60.0)];
        let mut run = testing::record(&baseline, events, 0.001, 3.5, 4);
        for row in 0..run.samples() {
            if row.is_multiple_of(2) {
                run.current_a[row] = f64::NAN;
            } else {
                run.speed_rad_s[row] = f64::NAN;
            }
        }
        run.angle = run.shaft_angle().into_owned();
        agrees(&baseline, &run);
    }

    fn agrees(baseline: &Model, run: &Scenario) {
        let noise = NoiseFloor::from_standstill(run).unwrap();
        let cogging = effect::find("cogging").unwrap();
        let values = vec![1.0, 0.0, 3.0];
        let problem = FreeRun::new(baseline, run, noise).unwrap();
        let mut linear = DVector::zeros(problem.residual_len());
        responses(cogging, &[values], baseline, run, &problem, |row, each| {
            linear[row] = each[0];
        })
        .unwrap();
        let residual = |model: &Model| {
            let problem = FreeRun::new(model, run, noise).unwrap();
            let x = problem.start();
            let mut out = vec![0.0; problem.residual_len()];
            assert!(problem.residual(&x, &mut out));
            DVector::from_vec(out)
        };
        let mut with = baseline.clone();
        with.effects.push(ActiveEffect {
            effect: cogging,
            values: vec![Some(1e-3), Some(0.0), Some(3.0)],
        });
        let difference = (residual(&with) - residual(baseline)) / 1e-3;
        let angle = difference.dot(&linear) / (difference.norm() * linear.norm());
        let size = linear.norm() / difference.norm();
        assert!(angle > 0.9 && (size - 1.0).abs() < 0.3, "{angle} {size}");
    }
}
