//! What a torque over the angle does to current and speed, to first order: enough to tell which of many orders to try.
//!
//! A free run for each of some twenty orders, twice, would be most of the screen's work. Here the deviation from the
//! baseline follows the linear part `d/dt [i, w] = A [i, w] - [0, T/J]`, with the torque taken at what was measured, and
//! rests where the shaft rests.

use nalgebra::DVector;

use crate::identification::output_error::FreeRun;
use crate::plant::{Effect, Instant, Linear, Model, Scenario};

/// Multiple of the speed's noise below which the shaft counts as at rest.
const AT_REST: f64 = 4.0;

/// Change of the weighted residual by a coefficient of one, for each value of `values` (the effect's parameters);
/// `None` where the model has no electrical part or the effect is more than a torque.
pub(super) fn responses(
    effect: &dyn Effect,
    values: &[Vec<f64>],
    model: &Model,
    scenario: &Scenario,
    problem: &FreeRun<'_>,
) -> Option<Vec<DVector<f64>>> {
    let linear = Linear::of(model)?;
    let noise = problem.noise();
    let terms: Vec<_> = values.iter().map(|values| effect.terms(values)).collect();
    let simple = |terms: &Box<dyn crate::plant::Terms>| {
        terms.states() == 0 && terms.path().measures_directly() && terms.coupling().is_none()
    };
    if !terms.iter().all(simple) {
        return None;
    }
    let samples = scenario.samples();
    let angles = scenario.shaft_angle();
    let mut angle = angles.iter().peekable();
    let mut last_angle_rad = 0.0;
    let mut deviation = vec![[0.0; 2]; terms.len()];
    let mut out = vec![vec![[0.0; 2]; samples]; terms.len()];
    let mut step = linear.over(0.0);
    let mut step_s = f64::NAN;
    for sample in 0..samples {
        let time_s = scenario.sample_time_s[sample];
        while let Some(point) = angle.next_if(|point| point.0 <= time_s) {
            last_angle_rad = point.1;
        }
        if sample > 0 {
            let interval_s = time_s - scenario.sample_time_s[sample - 1];
            if (interval_s - step_s).abs() > 1e-9 * interval_s {
                step_s = interval_s;
                step = linear.over(step_s);
            }
        }
        let (current_a, speed_rad_s) = (scenario.current_a[sample], scenario.speed_rad_s[sample]);
        let rests = !(speed_rad_s.abs() > AT_REST * noise.speed_rad_s && current_a.is_finite());
        let at = Instant {
            time_s: time_s - scenario.begin_s(),
            current_a,
            speed_rad_s,
            // The torque acts over the interval that ends here: at its middle.
            angle_rad: last_angle_rad - 0.5 * speed_rad_s * step_s.max(0.0),
            ..Instant::of(&model.motor)
        };
        for ((terms, deviation), out) in terms.iter().zip(&mut deviation).zip(&mut out) {
            let torque_n_m = if rests {
                0.0
            } else {
                terms.torque_n_m(&at, &[])
            };
            *deviation = step.after(*deviation, torque_n_m);
            if rests {
                deviation[1] = 0.0;
            }
            out[sample] = *deviation;
        }
    }
    let weighted = |out: &Vec<[f64; 2]>| {
        DVector::from_iterator(
            problem.rows().len(),
            problem.rows().iter().map(|(sample, is_speed)| {
                if *is_speed {
                    out[*sample][1] / noise.speed_rad_s
                } else {
                    out[*sample][0] / noise.current_a
                }
            }),
        )
    };
    Some(out.iter().map(weighted).collect())
}
