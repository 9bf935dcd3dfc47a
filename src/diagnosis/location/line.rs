//! A line in the spectrum of what an equation lacks: a shaker, a belt, a gear that turns by itself.
//!
//! The windows stand at nearly equal distances; where one was dropped there is a zero, which spreads a line but does not
//! move it. The highest peak of the periodogram is then refined in true time.

use std::f64::consts::TAU;

use super::Equation;
use super::balance::Windows;
use crate::numerics::count::whole;

/// Periods that a line has within the run at least: what is slower is a drift.
const FEWEST_PERIODS: f64 = 4.0;
/// Steps of refinement to either side of the peak, each a fraction of the resolution.
const REFINEMENT: i32 = 12;

/// Frequency of the strongest line, Hz.
pub(super) fn strongest(windows: &Windows<'_>, equation: Equation) -> Option<f64> {
    let stride_s = 0.5 * windows.length_s();
    let begin_s = windows.of(equation).next()?.time_s;
    let end_s = windows.of(equation).last()?.time_s;
    let length = whole(((end_s - begin_s) / stride_s).round()) + 1;
    if length < 64 || stride_s <= 0.0 {
        return None;
    }
    let size = length.next_power_of_two() * 2;
    let mut real = vec![0.0; size];
    let mut imaginary = vec![0.0; size];
    for window in windows.of(equation) {
        let place = whole(((window.time_s - begin_s) / stride_s).round());
        real[place.min(length - 1)] = window.error(equation);
    }
    transform(&mut real, &mut imaginary);
    let resolution_hz = 1.0 / (size as f64 * stride_s);
    let lowest = whole(FEWEST_PERIODS / (end_s - begin_s) / resolution_hz) + 1;
    let peak = (lowest..size / 2).max_by(|a, b| {
        let power = |k: usize| real[k].powi(2) + imaginary[k].powi(2);
        power(*a).total_cmp(&power(*b))
    })?;
    let power_at = |frequency_hz: f64| {
        let (mut c, mut s) = (0.0, 0.0);
        for window in windows.of(equation) {
            let (sin, cos) = (TAU * frequency_hz * window.time_s).sin_cos();
            c += cos * window.error(equation);
            s += sin * window.error(equation);
        }
        c * c + s * s
    };
    (-REFINEMENT..=REFINEMENT)
        .map(|step| (peak as f64 + f64::from(step) / f64::from(REFINEMENT)) * resolution_hz)
        .max_by(|a, b| power_at(*a).total_cmp(&power_at(*b)))
}

/// Fast Fourier transform in place; the length is a power of two (Cooley and Tukey 1965).
fn transform(real: &mut [f64], imaginary: &mut [f64]) {
    let n = real.len();
    let mut other = 0;
    for at in 1..n {
        let mut bit = n >> 1;
        while other & bit != 0 {
            other ^= bit;
            bit >>= 1;
        }
        other |= bit;
        if at < other {
            real.swap(at, other);
            imaginary.swap(at, other);
        }
    }
    let mut length = 2;
    while length <= n {
        let step = -TAU / length as f64;
        for start in (0..n).step_by(length) {
            for k in 0..length / 2 {
                let (sin, cos) = (step * k as f64).sin_cos();
                let (a, b) = (start + k, start + k + length / 2);
                let (re, im) = (
                    real[b] * cos - imaginary[b] * sin,
                    real[b] * sin + imaginary[b] * cos,
                );
                (real[b], imaginary[b]) = (real[a] - re, imaginary[a] - im);
                real[a] += re;
                imaginary[a] += im;
            }
        }
        length *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_of_a_wave_has_its_power_in_one_place() {
        let n = 64;
        let mut real: Vec<f64> = (0..n)
            .map(|k| (TAU * 5.0 * k as f64 / n as f64).cos())
            .collect();
        let mut imaginary = vec![0.0; n];
        transform(&mut real, &mut imaginary);
        for k in 0..n {
            let expected = if k == 5 || k == n - 5 { 32.0 } else { 0.0 };
            assert!(
                (real[k] - expected).abs() < 1e-9 && imaginary[k].abs() < 1e-9,
                "{k}"
            );
        }
    }
}
