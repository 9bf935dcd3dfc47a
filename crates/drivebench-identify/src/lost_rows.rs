//! Missing rows of a record: their count, position and treatment.

use drivebench_model::plant::Scenario;
use drivebench_model::sample::{Channel, Run};

#[derive(Clone, Debug, PartialEq)]
pub struct LostRows {
    pub run: String,
    pub input: Channel,
    pub lost: usize,
    pub of: usize,
    /// Begin and end of the longest time without, s.
    pub longest_s: [f64; 2],
    /// Time in which the neighbouring rows do not determine the input, s, and its share of the run.
    pub estimated_s: f64,
    pub estimated_share: f64,
    /// Holes after which a simulation restarts from the measurement.
    pub restarts: usize,
}

/// `None` for a complete record.
pub fn find(run: &Run, scenario: &Scenario) -> Option<LostRows> {
    let holes = || scenario.unknown_input.iter().filter(|hole| hole.lost_rows > 0);
    let longest = holes().max_by_key(|hole| hole.lost_rows)?;
    let lost: usize = holes().map(|hole| hole.lost_rows).sum();
    let estimated = holes().filter(|hole| hole.variance > 0.0);
    let estimated_s: f64 = estimated.map(|hole| hole.to_s - hole.from_s).sum();
    let length_s = scenario.sample_time_s[scenario.samples() - 1] - scenario.begin_s();
    Some(LostRows {
        run: run.name.clone(),
        input: scenario.input_channel,
        lost,
        of: lost + run.points(scenario.input_channel).count(),
        longest_s: [longest.from_s, longest.to_s],
        estimated_s,
        estimated_share: estimated_s / length_s,
        restarts: holes().filter(|hole| hole.restart.is_some()).count(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::NoiseFloor;
    use crate::testing::{KEYS, PAPER, identify, of, paper, record};
    use crate::{output_error, sanity, start};
    use drivebench_model::plant::Model;
    use drivebench_model::plant::testing::with_rows_lost;

    /// Steps of some volts every 10 ms on a slow sine, as a record of 1 kHz without the rows that `lost` selects.
    fn run(lost: impl Fn(usize) -> bool) -> Run {
        let mut state = 1_u32;
        let events: Vec<(f64, f64)> = (0..6000)
            .scan(0.0, |dither, row: u32| {
                if row.is_multiple_of(10) {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    *dither = if state >> 31 == 0 { 8.0 } else { -8.0 };
                }
                let time_s = 1e-3 * f64::from(row);
                let sine = 60.0 * (1.3 * (time_s - 0.3)).sin();
                let volts = (20.0 * (sine + *dither)).round() / 20.0;
                Some((time_s, if row < 300 { 0.0 } else { volts }))
            })
            .collect();
        with_rows_lost(&record(&paper(), events, 1e-3, 6.0, 5), lost)
    }

    /// One row in ten is lost, and there is a long hole.
    fn lossy() -> (Run, Scenario) {
        let is_lost = |row: usize| {
            (1..5990).contains(&row) && (row * 7919) % 101 < 10 || (3000..3400).contains(&row)
        };
        let run = run(is_lost);
        let scenario = Scenario::from_run(&run).unwrap();
        (run, scenario)
    }

    #[test]
    fn the_loss_has_count_and_share_and_exchanges_no_columns() {
        let whole = run(|_| false);
        assert_eq!(find(&whole, &Scenario::from_run(&whole).unwrap()), None);
        let (lossy, scenario) = lossy();
        let found = find(&lossy, &scenario).unwrap();
        assert_eq!((found.lost, found.of, found.restarts), (6000 - lossy.rows(), 6000, 1));
        let [from_s, to_s] = found.longest_s;
        assert!((from_s - 3.0).abs() < 1e-3 && (to_s - 3.4).abs() < 1e-3, "{found:?}");
        let findings = sanity::examine(&lossy, &scenario, &Model::default());
        assert!(!findings.iter().any(|found| found.refuses), "{findings:?}");
    }

    #[test]
    fn a_motor_is_found_through_lost_rows() {
        let (_, scenario) = lossy();
        let noise = NoiseFloor::from_standstill(&scenario).unwrap();
        let begin = start::complete(&Model::default(), &scenario).unwrap();
        let fit = output_error::fit(&[begin], &scenario, &noise).unwrap();
        assert!(fit.nrms < 1.1, "{}", fit.nrms);
        for (parameter, truth) in fit.parameters.iter().zip(PAPER) {
            let (value, std) = (parameter.value.unwrap(), parameter.std.unwrap());
            let covers = (value - truth).abs() < 3.5 * std && std < 0.01 * truth;
            assert!(covers, "{parameter:?}: {truth}");
        }
    }

    #[test]
    fn schemes_that_go_row_by_row_use_the_estimated_voltage() {
        let (lossy, _) = lossy();
        for id in ["3", "ekf", "weak-form"] {
            let found = identify(id, &lossy, &Model::default()).unwrap();
            for (key, truth) in KEYS.into_iter().zip(PAPER).take(4) {
                let parameter = of(&found.parameters, key.key());
                let off = (parameter.value.unwrap() - truth).abs();
                let covers = off < 4.0 * parameter.std.unwrap();
                assert!(covers, "{id} {parameter:?}: {truth}");
            }
        }
    }
}
