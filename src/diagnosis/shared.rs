//! Whether two runs are one: a hold-out that has been fitted tests nothing.

use crate::plant::Scenario;

/// Samples below which equal ones may be chance.
const FEWEST: usize = 20;
/// Times that differ by less are one, s: stamps carry rounding.
const SAME_TIME_S: f64 = 1e-6;

/// Share of `other`'s moving samples that are also in `run`, number by number, at the same time or at the same time
/// after the beginning. Two measurements of one motion differ in their noise.
pub fn shared_samples(run: &Scenario, other: &Scenario) -> f64 {
    let begins_s = other.sample_time_s[0] - run.sample_time_s[0];
    f64::max(shared(run, other, 0.0), shared(run, other, begins_s))
}

fn shared(run: &Scenario, other: &Scenario, later_s: f64) -> f64 {
    let (mut equal, mut compared, mut at) = (0_usize, 0_usize, 0);
    let mut before = [0.0; 2];
    for (sample, time_s) in other.sample_time_s.iter().enumerate() {
        let values = [other.current_a[sample], other.speed_rad_s[sample]];
        // A sensor that repeats itself, as at rest, says nothing of where the data come from.
        let moves = values
            .iter()
            .zip(&before)
            .any(|(value, before)| value.is_finite() && (value - before).abs() > 0.0);
        before = values;
        if !moves {
            continue;
        }
        compared += 1;
        let sought_s = time_s - later_s;
        while run
            .sample_time_s
            .get(at)
            .is_some_and(|there_s| *there_s < sought_s - SAME_TIME_S)
        {
            at += 1;
        }
        let Some(there_s) = run.sample_time_s.get(at) else {
            continue;
        };
        if (there_s - sought_s).abs() > SAME_TIME_S {
            continue;
        }
        let there = [run.current_a[at], run.speed_rad_s[at]];
        let mut pairs = values
            .iter()
            .zip(&there)
            .filter(|(value, there)| value.is_finite() && there.is_finite())
            .peekable();
        #[expect(clippy::float_cmp, reason = "the very same number is what is sought")]
        if pairs.peek().is_some() && pairs.all(|(value, there)| value == there) {
            equal += 1;
        }
    }
    if compared < FEWEST {
        0.0
    } else {
        equal as f64 / compared as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Model, Motor, testing};

    fn run(seed: u64) -> Scenario {
        let truth = Model::baseline(Motor::zk_22fc());
        testing::record(&truth, vec![(0.0, 0.0), (0.4, 40.0)], 1e-3, 2.0, seed)
    }

    #[test]
    fn a_copy_a_part_and_a_later_copy_are_the_same_run_and_a_repetition_is_not() {
        let (first, repeated) = (run(1), run(2));
        let mut part = first.clone();
        part.sample_time_s.drain(..500);
        part.current_a.drain(..500);
        part.speed_rad_s.drain(..500);
        let mut later = first.clone();
        for time_s in &mut later.sample_time_s {
            *time_s += 7.0;
        }
        for other in [&first, &part, &later] {
            assert!(shared_samples(&first, other) > 0.99);
        }
        assert!(shared_samples(&first, &repeated) < 0.01);
    }

    #[test]
    fn a_sensor_that_shows_only_zero_proves_nothing() {
        let mut still = run(1);
        still.current_a.fill(0.0);
        still.speed_rad_s.fill(0.0);
        assert!(shared_samples(&still, &still).abs() < 1e-12);
    }
}
