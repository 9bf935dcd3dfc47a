//! What the paper does not show: error of each scheme against signal-to-noise, the noise on the sensors.

use rayon::prelude::*;
use serde::Serialize;

use super::machine::motor;
use super::sampling::Curve;
use super::schemes::{Errors, errors, record, taking_part};
use super::signal::SignalToNoise;
use super::{PERIOD_S, TA_S, TM_S};
use crate::numerics::statistics::median;

/// Ratios of power.
const RATIOS: [f64; 6] = [10.0, 100.0, 1e3, 1e4, 1e5, 1e6];
const SAMPLES: usize = 3000;
const SEEDS: u64 = 5;

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
}

pub(super) fn noise() -> NoiseSweep {
    let motor = motor(TA_S, TM_S);
    let records: Vec<Vec<_>> = RATIOS
        .into_par_iter()
        .map(|ratio| {
            (0..SEEDS)
                .map(|seed| {
                    let ratio = SignalToNoise::power(ratio);
                    record(&motor, PERIOD_S, SAMPLES, seed, Some(ratio))
                })
                .collect()
        })
        .collect();
    let curves = taking_part().map(|scheme| Curve {
        scheme: scheme.id(),
        errors: records
            .par_iter()
            .map(|seeds| {
                let found: Vec<_> = seeds
                    .par_iter()
                    .map(|record| errors(scheme, record))
                    .collect();
                medians(&found)
            })
            .collect(),
    });
    NoiseSweep {
        electrical_time_constant_s: TA_S,
        mechanical_time_constant_s: TM_S,
        period_s: PERIOD_S,
        samples: SAMPLES,
        seeds: SEEDS,
        signal_to_noise: RATIOS.into(),
        curves: curves.collect(),
    }
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
    fn print_noise() {
        let sweep = noise();
        for curve in sweep.curves {
            for (ratio, errors) in sweep.signal_to_noise.iter().zip(&curve.errors) {
                println!("{ratio} {} {:.3?}", curve.scheme, errors.to_array());
            }
        }
    }
}
