//! A line in the spectrum of the torque error: a shaker, a belt, a mains hum that turns the shaft.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};

use super::weak_balance::error_over_noise;
use super::{AxisMap, FOLLOWS_SHARE, explain};
use crate::identification::weak_form::Regression;
use crate::numerics::count::whole;
use crate::plant::{Balance, Scenario};
use crate::text::number::significant;

/// Windows of a run that are looked at: enough to resolve a line to a part in a thousand of the highest frequency.
const MOST_WINDOWS: usize = 2000;
/// Share of a line's explained variance that the next may have for it to be a line of its own.
const ALONE: f64 = 0.5;
/// Frequencies per resolved line.
const OVERSAMPLING: f64 = 4.0;

/// The frequency at which a sine and a cosine explain most of the torque error.
pub(super) fn strongest(regression: &Regression, scenario: &Scenario) -> Option<AxisMap> {
    let windows = regression.right.len().min(MOST_WINDOWS);
    if regression.equation != Balance::Torque || windows < 40 {
        return None;
    }
    let base = regression.matrix.rows(0, windows).into_owned();
    let right = DVector::from_fn(windows, |row, _| regression.right[row]);
    let times = &regression.time_s[..windows];
    let blocks = &regression.blocks[..windows];
    let begin_s = scenario.begin_s();
    let length_s = times[windows - 1] - times[0];
    let stride_s = shortest_stride(times)?;
    let step_hz = 1.0 / (OVERSAMPLING * length_s);
    let highest_hz = 0.5 / stride_s;
    let lowest_hz = 2.0 / length_s;
    let wave = |frequency_hz: f64| {
        DMatrix::from_fn(windows, 2, |row, column| {
            let phase = TAU * frequency_hz * (times[row] - begin_s);
            if column == 0 {
                phase.sin()
            } else {
                phase.cos()
            }
        })
    };
    let gain = |frequency_hz: f64| {
        explain(&base, &right, &wave(frequency_hz), blocks)
            .map_or(f64::NEG_INFINITY, |found| found.r2)
    };
    let tried = whole(((highest_hz - lowest_hz) / step_hz).max(1.0));
    let spectrum: Vec<(f64, f64)> = (0..tried)
        .map(|place| lowest_hz + place as f64 * step_hz)
        .map(|frequency_hz| (frequency_hz, gain(frequency_hz)))
        .collect();
    let strongest = |points: &mut dyn Iterator<Item = &(f64, f64)>| {
        points.copied().max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let best = strongest(&mut spectrum.iter())?;
    // An error that goes with the excitation has many lines, and none is its cause.
    let apart = |point: &&(f64, f64)| (point.0 - best.0).abs() > 2.0 / length_s;
    let second = strongest(&mut spectrum.iter().filter(apart)).map_or(0.0, |point| point.1);
    let frequency_hz = refined(best.0, step_hz, gain);
    // What the window takes from a wave of this frequency is given back to its amplitude.
    let seen = attenuation(regression, scenario, frequency_hz);
    let found = explain(&base, &right, &wave(frequency_hz), blocks)?;
    let amplitude = found.coefficients.norm() / seen;
    let along = &found.coefficients / found.coefficients.norm();
    let variance = (along.transpose() * &found.covariance * &along)[(0, 0)];
    // The best of many frequencies explains something of any noise: as many columns more as that is worth.
    let spare = (windows - base.ncols()) as f64;
    let chance = 2.0 * (tried as f64).ln().max(0.0);
    let r2 = 1.0 - (1.0 - found.r2) * spare / (spare - chance);
    let sentence = if r2 < FOLLOWS_SHARE || second > ALONE * r2 {
        "no single line stands out in the spectrum of the torque error".to_owned()
    } else {
        format!(
            "{:.0} % of the torque error is a line at {} Hz with an amplitude of {} N.m",
            100.0 * r2,
            significant(frequency_hz, 3),
            significant(amplitude, 3)
        )
    };
    Some(AxisMap {
        equation: "torque",
        axis: "frequency_hz",
        r2,
        knots: vec![frequency_hz],
        values: vec![amplitude],
        std: vec![variance.max(0.0).sqrt() / seen],
        method: "weak_form",
        error_over_noise: error_over_noise(regression),
        sentence,
    })
}

/// Golden section around the best frequency of the grid.
fn refined(at_hz: f64, step_hz: f64, gain: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let (mut low, mut high) = (at_hz - step_hz, at_hz + step_hz);
    for _ in 0..16 {
        let width = high - low;
        let (left, right) = (high - GOLDEN * width, low + GOLDEN * width);
        if gain(left) > gain(right) {
            high = right;
        } else {
            low = left;
        }
    }
    0.5 * (low + high)
}

/// Amplitude that is left of a wave when windows average it.
fn attenuation(regression: &Regression, scenario: &Scenario, frequency_hz: f64) -> f64 {
    let times = &scenario.sample_time_s;
    let phase = |sample: usize| TAU * frequency_hz * times[sample];
    let (sines, cosines) = (
        regression.means(|sample| phase(sample).sin()),
        regression.means(|sample| phase(sample).cos()),
    );
    let power = (sines.norm_squared() + cosines.norm_squared()) / sines.len() as f64;
    power.sqrt().max(f64::MIN_POSITIVE)
}

fn shortest_stride(times: &[f64]) -> Option<f64> {
    let mut strides: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    strides.sort_by(f64::total_cmp);
    strides
        .get(strides.len() / 2)
        .copied()
        .filter(|stride| *stride > 0.0)
}
