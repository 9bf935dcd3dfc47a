//! What the paper does not show: error of each scheme against signal-to-noise, the noise on the sensors.

use rayon::prelude::*;
use serde::Serialize;

use super::machine::motor;
use super::sampling::Curve;
use super::schemes::{Errors, Record, errors, record, taking_part};
use super::signal::SignalToNoise;
use super::{PERIOD_S, TA_S, TM_S};
use crate::numerics::statistics::median;
use crate::plant::Motor;

/// Ratios of power.
const RATIOS: [f64; 6] = [10.0, 100.0, 1e3, 1e4, 1e5, 1e6];
const SAMPLES: usize = 3000;
const SEEDS: u64 = 5;
const LONG_SAMPLES: usize = 20_000;
const LONG_SEEDS: u64 = 7;

/// Medians over the seeds.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseSweep {
    pub electrical_time_constant_s: f64,
    pub mechanical_time_constant_s: f64,
    pub period_s: f64,
    pub samples: usize,
    pub seeds: u64,
    /// Of power, on speed and current alike.
    pub signal_to_noise: Vec<f64>,
    pub curves: Vec<Curve>,
    pub long: Long,
}

/// Schemes 1 on a long record at the worst ratio: what the number of samples mends, and what it does not.
#[derive(Clone, Debug, Serialize)]
pub struct Long {
    pub signal_to_noise: f64,
    pub samples: usize,
    pub seeds: u64,
    pub curves: Vec<Curve>,
}

pub(super) fn noise() -> NoiseSweep {
    let motor = motor(TA_S, TM_S);
    let curves = medians_of(&motor, &RATIOS, SAMPLES, SEEDS, |_| true);
    let long = medians_of(&motor, &RATIOS[..1], LONG_SAMPLES, LONG_SEEDS, |id| {
        id.starts_with('1')
    });
    NoiseSweep {
        electrical_time_constant_s: TA_S,
        mechanical_time_constant_s: TM_S,
        period_s: PERIOD_S,
        samples: SAMPLES,
        seeds: SEEDS,
        signal_to_noise: RATIOS.into(),
        curves,
        long: Long {
            signal_to_noise: RATIOS[0],
            samples: LONG_SAMPLES,
            seeds: LONG_SEEDS,
            curves: long,
        },
    }
}

/// For each scheme asked for, the medians over the seeds at each ratio.
fn medians_of(
    motor: &Motor,
    ratios: &[f64],
    samples: usize,
    seeds: u64,
    asked: impl Fn(&str) -> bool,
) -> Vec<Curve> {
    let record_of = |ratio: f64, seed: u64| {
        let ratio = SignalToNoise::power(ratio);
        record(motor, PERIOD_S, samples, seed, Some(ratio))
    };
    let records: Vec<Vec<Record>> = ratios
        .par_iter()
        .map(|ratio| (0..seeds).map(|seed| record_of(*ratio, seed)).collect())
        .collect();
    taking_part()
        .filter(|scheme| asked(scheme.id()))
        .map(|scheme| {
            let over_seeds = |records: &Vec<Record>| {
                let found: Vec<_> = records
                    .par_iter()
                    .map(|record| errors(scheme, record))
                    .collect();
                medians(&found)
            };
            Curve {
                scheme: scheme.id(),
                errors: records.par_iter().map(over_seeds).collect(),
            }
        })
        .collect()
}

/// Median of each error; none where fewer than half of the seeds tell it.
fn medians(seeds: &[Errors]) -> Errors {
    let mut out = [None; Errors::COUNT];
    for (which, median_of) in out.iter_mut().enumerate() {
        let told: Vec<f64> = seeds.iter().filter_map(|e| e.to_array()[which]).collect();
        *median_of = (2 * told.len() > seeds.len()).then(|| median(&told));
    }
    Errors::from_array(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_squares_is_biased_by_sensor_noise_and_instruments_are_not() {
        let sweep = noise();
        let curve = |curves: &[Curve], id: &str| {
            let found = curves.iter().find(|curve| curve.scheme == id);
            found.unwrap().errors.clone()
        };
        let ta = |errors: &Errors| errors.electrical_time_constant.unwrap();
        let tm = |errors: &Errors| errors.mechanical_time_constant.unwrap();
        let (printed, free) = (curve(&sweep.curves, "1"), curve(&sweep.curves, "1-iv"));
        assert!(
            ta(&printed[0]) < -75.0 && tm(&printed[0]).abs() > 50.0,
            "{printed:?}"
        );
        let last = printed.len() - 1;
        // With a clean speed the printed form is left with its own error of the period.
        assert!(ta(&printed[last]).abs() < 3.0 && (5.0..15.0).contains(&tm(&printed[last])));
        for id in ["1-iv", "output-error"] {
            for errors in curve(&sweep.curves, id) {
                assert!(
                    ta(&errors).abs() < 4.0 && tm(&errors).abs() < 4.0,
                    "{id} {errors:?}"
                );
            }
        }
        assert!(ta(&free[last]).abs() < 0.1);
        // Many samples make the bias no smaller; the other one shrinks.
        let (printed, free) = (
            curve(&sweep.long.curves, "1")[0],
            curve(&sweep.long.curves, "1-iv")[0],
        );
        assert!(
            ta(&printed).abs() > 10.0 * ta(&free).abs(),
            "{printed:?} {free:?}"
        );
        assert!(
            tm(&printed).abs() > 10.0 * tm(&free).abs(),
            "{printed:?} {free:?}"
        );
    }
}
