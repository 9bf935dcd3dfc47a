//! Resistance and back-EMF constant from steady states, by linear regression over constant levels of the voltage:
//! `u = R i + Ke w + c`, for a sampling period that is too long for the transients. `c` is the offset of a sensor; with levels of
//! one direction it is collinear with the current of the friction, and the resistance is not observable.

use nalgebra::{DMatrix, DVector};

use super::noise::roughness;
use super::verdict::{NOT_OBSERVABLE, SETTLED};
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::{extent, finite, mean};
use drivebench_model::plant::{MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Means over the last half of one level of at least four samples, and the variance of the mean current.
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
    let noises = [roughness(&scenario.current_a), roughness(&scenario.speed_rad_s)];
    let times = &scenario.sample_time_s;
    let events = &scenario.events;
    let changes: Vec<usize> = (0..events.len())
        .filter(|k| *k == 0 || (events[*k].1 - events[k - 1].1).abs() > 0.0)
        .collect();
    let level = |(index, event): (usize, &usize)| {
        let from_s = events[*event].0;
        let next = changes.get(index + 1);
        let to_s = next.map_or(f64::INFINITY, |next| events[*next].0);
        let begin = times.partition_point(|time| *time <= from_s);
        let end = times.partition_point(|time| *time < to_s);
        // A standstill has no information on the resistance.
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
            let change = (mean(&last) - mean(&third)).abs();
            // After six time constants 0.2 % of the span remains. By noise, three standard deviations of the difference of both
            // halves' means (twice that of the mean of both), but at most 2 % of the span.
            let by_noise = 2.0 * 3.0 * noise / count.sqrt();
            let is_steady = change <= (0.002 * span).max(by_noise.min(0.02 * span));
            (is_steady, mean(&both), noise * noise / count)
        };
        let current = part(&scenario.current_a, spans[0], noises[0]);
        let speed = part(&scenario.speed_rad_s, spans[1], noises[1]);
        (current.0 && speed.0).then_some(Level {
            voltage_v: events[*event].1,
            current_a: current.1,
            speed_rad_s: speed.1,
            noise_a2: current.2,
        })
    };
    changes.iter().enumerate().filter_map(level).collect()
}

/// Replaces a resistance or a back-EMF constant that is not settled by that from steady states, where its deviation is smaller.
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
        let better = found.iter().find(|other| {
            let std = parameter.value.and(parameter.std).unwrap_or(f64::INFINITY);
            other.key == parameter.key && other.std.is_some_and(|other| other < std)
        });
        if let Some(better) = better {
            *parameter = better.clone();
        }
    }
}

fn estimates(levels: &[Level]) -> Vec<ParameterEstimate> {
    // Three levels for each unknown, so that the residual has degrees of freedom.
    if levels.len() < 9 {
        return Vec::new();
    }
    let column = |of: fn(&Level) -> f64| levels.iter().map(of).collect::<Vec<f64>>();
    let cells = [column(|own| own.current_a), column(|own| own.speed_rad_s), column(|_| 1.0)];
    let matrix = DMatrix::from_fn(levels.len(), 3, |row, column| cells[column][row]);
    let right = DVector::from_vec(column(|own| own.voltage_v));
    let blocks: Vec<usize> = (0..levels.len()).collect();
    let Some(solution) = least_squares::solve(&matrix, &right, &blocks) else { return Vec::new() };
    let (bread, _) = least_squares::inverse_where_determined(&matrix);
    let noise: f64 = levels.iter().map(|own| own.noise_a2).sum();
    // Errors in variables: the part of the current that the other columns do not explain has to have ten times the power of its
    // noise, which attenuates the resistance.
    let is_observable = 1.0 / bread[(0, 0)] > 10.0 * noise;
    let of = |(index, key): (usize, MotorKey)| {
        let value = solution.x[index];
        let std = solution.covariance[(index, index)].sqrt();
        let relative = std / value;
        let reason = match key {
            MotorKey::Resistance => Some(format!(
                "from {} steady states, because the transients are too fast: the resistance includes the drop of the \
                 brushes",
                levels.len()
            )),
            _ => (relative > SETTLED).then(|| format!("from {} steady states", levels.len())),
        };
        let is_sound = is_observable && value > 0.0 && relative < NOT_OBSERVABLE;
        let doubt = reason.map(|reason| (Reason::MethodBiased, reason));
        is_sound.then(|| ParameterEstimate::found(key.key(), key.unit(), value, std, doubt))
    };
    KEYS.into_iter().enumerate().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_found, brushed, record, steps};

    #[test]
    fn an_offset_does_not_bend_the_estimates_from_held_levels() {
        let mut scenario = record(&brushed(), steps(1.0, 20.0, 12.0 / 70.0, 0.5), 0.02, 20.0, 4);
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
        let quick = record(&brushed(), steps(0.3, 10.0, 12.0 / 70.0, 0.04), 0.002, 10.0, 4);
        assert!(estimates(&levels(&quick)).is_empty());
        let mut one_way = steps(1.0, 20.0, 12.0 / 70.0, 0.5);
        for step in &mut one_way {
            step.1 = step.1.abs();
        }
        let found = estimates(&levels(&record(&brushed(), one_way, 0.02, 20.0, 4)));
        assert!(ParameterEstimate::find(&found, "resistance_ohm").is_none(), "{found:?}");
    }
}
