//! Windows, their quadrature, and the signals that they average.

use super::{FEWEST_HALF, TORQUE_HALF_S, VOLTAGE_HALF_S};
use crate::plant::{Balance, Scenario};

/// Quadrature weights of one window: trapezoid in true time, times the test function and its first derivative.
pub(super) struct Window {
    begin: usize,
    pub(super) middle_s: f64,
    pub(super) weights: Vec<f64>,
    pub(super) rates: Vec<f64>,
}

impl Window {
    pub(super) fn new(scenario: &Scenario, begin: usize, end: usize) -> Self {
        let times = &scenario.sample_time_s;
        let (middle_s, half_s) = (
            0.5 * (times[begin] + times[end]),
            0.5 * (times[end] - times[begin]),
        );
        let (mut weights, mut rates, mut total) = (Vec::new(), Vec::new(), 0.0);
        for sample in begin..=end {
            let before = times[sample.saturating_sub(1).max(begin)];
            let after = times[(sample + 1).min(end)];
            let s = (times[sample] - middle_s) / half_s;
            let q = 1.0 - s * s;
            let share = 0.5 * (after - before);
            total += share * q.powi(4);
            weights.push(share * q.powi(4));
            // -psi_s / H
            rates.push(share * 8.0 * s * q.powi(3) / half_s);
        }
        for weight in weights.iter_mut().chain(&mut rates) {
            *weight /= total;
        }
        Self {
            begin,
            middle_s,
            weights,
            rates,
        }
    }

    pub(super) fn mean(&self, values: &[f64]) -> f64 {
        self.weights
            .iter()
            .zip(&values[self.begin..])
            .map(|(weight, value)| weight * value)
            .sum()
    }

    pub(super) fn mean_rate(&self, values: &[f64]) -> f64 {
        self.rates
            .iter()
            .zip(&values[self.begin..])
            .map(|(weight, value)| weight * value)
            .sum()
    }

    pub(super) fn mean_of(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.weights
            .iter()
            .enumerate()
            .map(|(offset, weight)| weight * value(self.begin + offset))
            .sum()
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a positive count of samples"
)]
pub(super) fn half_window(scenario: &Scenario, equation: Balance) -> usize {
    let period_s = mean_period_s(scenario);
    let half_s = match equation {
        Balance::Voltage => VOLTAGE_HALF_S,
        Balance::Torque => TORQUE_HALF_S,
    };
    ((half_s / period_s).round() as usize).max(FEWEST_HALF)
}

pub(super) fn mean_period_s(scenario: &Scenario) -> f64 {
    let times = &scenario.sample_time_s;
    (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64
}

/// Linear interpolation; NaN outside the points.
pub(super) fn interpolated(points: &[(f64, f64)], time_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < time_s);
    match (after.checked_sub(1), points.get(after)) {
        (Some(before), Some(after)) => {
            let before = points[before];
            before.1 + (after.1 - before.1) * (time_s - before.0) / (after.0 - before.0)
        }
        (None, Some(first)) if first.0 <= time_s => first.1,
        _ => f64::NAN,
    }
}

/// The held input at every sample.
pub(super) fn held_values(scenario: &Scenario) -> Vec<f64> {
    let events = &scenario.events;
    scenario
        .sample_time_s
        .iter()
        .map(|time_s| events[events.partition_point(|event| event.0 <= *time_s).max(1) - 1].1)
        .collect()
}

/// Mean of the held input over half a period either side of each sample: what a trapezoid rule must be given for a
/// signal that steps, else the input seems half a sample late (DISCOVERY.md 2.9).
pub(super) fn held_means(scenario: &Scenario) -> Vec<f64> {
    (0..scenario.sample_time_s.len())
        .map(|sample| held_mean(scenario, sample))
        .collect()
}

/// The same at one sample.
pub(super) fn held_mean(scenario: &Scenario, sample: usize) -> f64 {
    let (times, events) = (&scenario.sample_time_s, &scenario.events);
    let last = times.len() - 1;
    let from_s = 0.5 * (times[sample] + times[sample.saturating_sub(1)]);
    let to_s = 0.5 * (times[sample] + times[(sample + 1).min(last)]);
    let first = events.partition_point(|event| event.0 <= from_s).max(1) - 1;
    let mut sum = 0.0;
    for (index, event) in events
        .iter()
        .enumerate()
        .skip(first)
        .take_while(|(_, event)| event.0 < to_s)
    {
        let next_s = events.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
        sum += event.1 * (next_s - event.0.max(from_s));
    }
    sum / (to_s - from_s)
}

/// Every second sample; the input stays as it was.
pub(super) fn thinned(scenario: &Scenario) -> Scenario {
    let every_second = |values: &[f64]| values.iter().copied().step_by(2).collect::<Vec<f64>>();
    let mut thin = scenario.clone();
    thin.sample_time_s = every_second(&scenario.sample_time_s);
    thin.current_a = every_second(&scenario.current_a);
    thin.speed_rad_s = every_second(&scenario.speed_rad_s);
    thin.time_half_width_s = every_second(&scenario.time_half_width_s);
    thin.scored = 0..thin.sample_time_s.len();
    thin
}
