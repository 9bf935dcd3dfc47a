//! Resistance and back-EMF constant from steady states, by linear regression over levels of the voltage that were held until
//! nothing changed: `u = R i + Ke w + c`. Samples too far apart for the transients still show their ends. `c` takes an offset
//! of a sensor; with levels of one direction only it takes the friction's current too, and no resistance shows.

use nalgebra::{DMatrix, DVector};

use super::noise::roughness;
use super::verdict::{NOT_OBSERVABLE, SETTLED};
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::{extent, finite, mean};
use drivebench_model::plant::{MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Means over the last half of one level of at least four samples, and the variance of that of the current.
struct Level {
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    noise_a2: f64,
}

const KEYS: [MotorKey; 2] = [MotorKey::Resistance, MotorKey::BackEmf];

fn levels(scenario: &Scenario) -> Vec<Level> {
    let span = |values: &[f64]| {
        let (least, most) = extent(finite(values));
        most - least
    };
    let spans = [span(&scenario.current_a), span(&scenario.speed_rad_s)];
    let rough = [roughness(&scenario.current_a), roughness(&scenario.speed_rad_s)];
    let times = &scenario.sample_time_s;
    let events = &scenario.events;
    let changes: Vec<usize> = (0..events.len())
        .filter(|k| *k == 0 || (events[*k].1 - events[k - 1].1).abs() > 0.0)
        .collect();
    let one = |(place, event): (usize, &usize)| {
        let from_s = events[*event].0;
        let next = changes.get(place + 1);
        let to_s = next.map_or(f64::INFINITY, |next| events[*next].0);
        let begin = times.partition_point(|time| *time <= from_s);
        let end = times.partition_point(|time| *time < to_s);
        // A rest is one level of one current, whatever is recorded of it.
        if end < begin + 4 || events[*event].1.abs() <= 0.0 {
            return None;
        }
        let middle = begin.midpoint(end);
        let part = |values: &[f64], span: f64, noise: f64| {
            let quarter = middle.midpoint(end);
            let third = finite(&values[middle..quarter]);
            let last = finite(&values[quarter..end]);
            let both = [&third[..], &last[..]].concat();
            let count = both.len() as f64;
            let moved = (mean(&last) - mean(&third)).abs();
            // Two thousandths of the span are what six time constants leave; noise excuses three deviations, up to a fiftieth.
            // The two halves' means differ by twice the deviation of the mean of both.
            let chance = 2.0 * 3.0 * noise / count.sqrt();
            let settles = moved <= (0.002 * span).max(chance.min(0.02 * span));
            (settles, mean(&both), noise * noise / count)
        };
        let current = part(&scenario.current_a, spans[0], rough[0]);
        let speed = part(&scenario.speed_rad_s, spans[1], rough[1]);
        let settles = current.0 && speed.0;
        settles.then_some(Level {
            voltage_v: events[*event].1,
            current_a: current.1,
            speed_rad_s: speed.1,
            noise_a2: current.2,
        })
    };
    changes.iter().enumerate().filter_map(one).collect()
}

/// Puts the estimate from held levels in the place of a resistance or a back-EMF constant that the fit leaves open, or less sure.
pub(super) fn complete(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    let is_open = |own: &ParameterEstimate| {
        matches!(own.verdict, Verdict::NotObservable | Verdict::Searching)
            && KEYS.iter().any(|key| key.key() == own.key)
    };
    if !parameters.iter().any(is_open) {
        return;
    }
    let found = estimates(&levels(scenario));
    for parameter in parameters.iter_mut().filter(|own| is_open(own)) {
        let surer = found.iter().find(|own| {
            let std = parameter.value.and(parameter.std).unwrap_or(f64::INFINITY);
            own.key == parameter.key && own.std.is_some_and(|own| own < std)
        });
        if let Some(surer) = surer {
            *parameter = surer.clone();
        }
    }
}

fn estimates(levels: &[Level]) -> Vec<ParameterEstimate> {
    // Three levels for each unknown: of fewer the scatter about them is none.
    if levels.len() < 9 {
        return Vec::new();
    }
    let column = |of: fn(&Level) -> f64| levels.iter().map(of).collect::<Vec<f64>>();
    let cells = [column(|own| own.current_a), column(|own| own.speed_rad_s), column(|_| 1.0)];
    let matrix = DMatrix::from_fn(levels.len(), 3, |row, place| cells[place][row]);
    let right = DVector::from_vec(column(|own| own.voltage_v));
    let blocks: Vec<usize> = (0..levels.len()).collect();
    let Some(solution) = least_squares::solve(&matrix, &right, &blocks) else {
        return Vec::new();
    };
    let (bread, _) = least_squares::inverse_where_determined(&matrix);
    let noise: f64 = levels.iter().map(|own| own.noise_a2).sum();
    // What only the resistance explains has to be ten times its noise in power; less pulls it towards zero.
    let shows = 1.0 / bread[(0, 0)] > 10.0 * noise;
    let of = |(place, key): (usize, MotorKey)| {
        let value = solution.x[place];
        let std = solution.covariance[(place, place)].sqrt();
        let relative = std / value;
        let reason = match key {
            MotorKey::Resistance => Some(format!(
                "from {} levels that were held, since the transients do not show it: a drop of the brushes counts as \
                 resistance",
                levels.len()
            )),
            _ => {
                (relative > SETTLED).then(|| format!("from {} levels that were held", levels.len()))
            }
        };
        let is_sound = shows && value > 0.0 && relative < NOT_OBSERVABLE;
        is_sound.then(|| ParameterEstimate::found(key.key(), key.unit(), value, std, reason))
    };
    KEYS.into_iter().enumerate().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Truth, assert_found, motor, record, steps};
    use drivebench_model::plant::Model;

    const BRUSHED: Truth = [1.2, 6e-4, 0.05, 4e-5, 0.012];

    #[test]
    fn an_offset_does_not_bend_the_estimates_from_held_levels() {
        let model = Model::baseline(motor(&BRUSHED));
        let mut scenario = record(&model, steps(1.0, 20.0, 12.0 / 70.0, 0.5), 0.02, 20.0, 4);
        for offset_a in [0.0, 0.35] {
            for current in &mut scenario.current_a {
                *current += offset_a;
            }
            let found = estimates(&levels(&scenario));
            assert_found(&found, "resistance_ohm", 1.2, 0.05);
            assert_found(&found, "back_emf_v_s_per_rad", 0.05, 0.005);
        }
    }

    #[test]
    fn unsettled_levels_and_one_direction_give_no_resistance() {
        let model = Model::baseline(motor(&BRUSHED));
        let quick = record(&model, steps(0.3, 10.0, 12.0 / 70.0, 0.04), 0.002, 10.0, 4);
        assert!(estimates(&levels(&quick)).is_empty());
        let mut one_way = steps(1.0, 20.0, 12.0 / 70.0, 0.5);
        for step in &mut one_way {
            step.1 = step.1.abs();
        }
        let found = estimates(&levels(&record(&model, one_way, 0.02, 20.0, 4)));
        let resistance = ParameterEstimate::find(&found, "resistance_ohm");
        assert!(resistance.is_none(), "{found:?}");
    }
}
