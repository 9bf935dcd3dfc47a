//! Interpolation of rows where a signal is missing, for methods that average over neighbouring rows.

use drivebench_model::numerics::filter::spline;
use drivebench_model::numerics::statistics;
use drivebench_model::plant::Scenario;

/// The scenario with complete rows. Where most rows are complete the others are left out; where the signals have separate rows a
/// natural spline interpolates each. Gaps longer than five periods stay. `None`: every row is complete.
pub fn bridged(scenario: &Scenario) -> Option<Scenario> {
    let mut signals = vec![&scenario.current_a, &scenario.speed_rad_s];
    signals.retain(|values| values.iter().any(|value| value.is_finite()));
    let is_whole = |k: usize| signals.iter().all(|values| values[k].is_finite());
    let whole: Vec<bool> = (0..scenario.samples()).map(is_whole).collect();
    let count = whole.iter().filter(|whole| **whole).count();
    if count == whole.len() {
        None
    } else if 2 * count >= whole.len() {
        Some(without_torn_rows(scenario, &whole))
    } else {
        Some(interpolated(scenario))
    }
}

/// Leaves out incomplete rows between complete ones that are at most five periods apart.
fn without_torn_rows(scenario: &Scenario, whole: &[bool]) -> Scenario {
    let times = &scenario.sample_time_s;
    let kept: Vec<usize> = (0..whole.len()).filter(|k| whole[*k]).collect();
    let longest_s = longest_gap_s(kept.iter().map(|k| times[*k]));
    let (mut keep, mut last) = (Vec::with_capacity(whole.len()), None);
    for &row in &kept {
        let from = last.map_or(0, |last: usize| last + 1);
        if last.is_none_or(|last| times[row] - times[last] > longest_s) {
            keep.extend(from..row);
        }
        keep.push(row);
        last = Some(row);
    }
    let pick = |values: &[f64]| keep.iter().map(|k| values[*k]).collect::<Vec<f64>>();
    let where_given =
        |values: &[f64]| keep.iter().filter_map(|k| values.get(*k).copied()).collect();
    let index = |row: usize| keep.partition_point(|k| *k < row);
    Scenario {
        sample_time_s: pick(times),
        current_a: pick(&scenario.current_a),
        speed_rad_s: pick(&scenario.speed_rad_s),
        voltage_v: where_given(&scenario.voltage_v),
        time_half_width_s: where_given(&scenario.time_half_width_s),
        scored: index(scenario.scored.start)..index(scenario.scored.end),
        ..scenario.clone()
    }
}

fn interpolated(scenario: &Scenario) -> Scenario {
    let times = &scenario.sample_time_s;
    let mut bridged = scenario.clone();
    for values in [&mut bridged.current_a, &mut bridged.speed_rad_s] {
        let present: Vec<usize> = (0..times.len()).filter(|k| values[*k].is_finite()).collect();
        let longest_s = longest_gap_s(present.iter().map(|k| times[*k]));
        let mut begin = 0;
        for end in 1..=present.len() {
            let next = present.get(end);
            if next.is_some_and(|row| times[*row] - times[present[end - 1]] <= longest_s) {
                continue;
            }
            let points: Vec<(f64, f64)> =
                (present[begin..end].iter()).map(|row| (times[*row], values[*row])).collect();
            // Linear interpolation would bias the mean of a curved signal.
            let rows = present[begin]..=present[end - 1];
            let read = spline(&points, &times[rows.clone()]);
            values[rows].copy_from_slice(&read);
            begin = end;
        }
    }
    bridged
}

/// Longest gap that is interpolated: five median periods of a signal.
fn longest_gap_s(times: impl Iterator<Item = f64>) -> f64 {
    5.0 * statistics::median_step(&times.collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::plant::testing::record;
    use drivebench_model::plant::{Model, Motor};

    fn run() -> Scenario {
        record(&Model::baseline(Motor::zk_22fc()), vec![(0.0, 0.0), (0.1, 30.0)], 0.002, 0.6, 3)
    }

    #[test]
    fn torn_rows_go_long_gaps_stay_and_the_scored_rows_follow() {
        let mut scenario = run();
        assert!(bridged(&scenario).is_none());
        // A signal that is nowhere tears no row.
        scenario.current_a.fill(f64::NAN);
        assert!(bridged(&scenario).is_none());
        let mut scenario = run();
        for k in (5..100).step_by(10) {
            scenario.current_a[k] = f64::NAN;
        }
        scenario.speed_rad_s[150..200].fill(f64::NAN);
        scenario.scored = 100..300;
        let whole = bridged(&scenario).unwrap();
        assert_eq!(whole.samples(), 290);
        assert_eq!(whole.scored, 90..290);
        assert_eq!(whole.speed_rad_s.iter().filter(|w| w.is_nan()).count(), 50);
        assert!(whole.sample_time_s.windows(2).all(|t| t[1] > t[0]));
    }

    #[test]
    fn signals_on_rows_of_their_own_are_brought_together() {
        let full = run();
        let mut apart = full.clone();
        for k in 0..full.samples() {
            [&mut apart.current_a, &mut apart.speed_rad_s][k % 2][k] = f64::NAN;
        }
        let together = bridged(&apart).unwrap();
        for k in 1..full.samples() - 1 {
            // The noise of one reading and of its neighbours is 0.15 rad/s each.
            let within = if k % 2 == 0 { 1e-9 } else { 1.2 };
            let off = (together.speed_rad_s[k] - full.speed_rad_s[k]).abs();
            assert!(off < within, "{k} {off}");
            assert!(together.current_a[k].is_finite());
        }
    }
}
