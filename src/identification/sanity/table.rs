//! The signals side by side at the sample times, and what can be said of one of them alone.

use std::ops::Range;

use crate::plant::{Input, Scenario};

/// Voltage (as held), current and speed at each sample; NaN where missing. Without a voltage the first is all NaN.
pub(super) struct Table {
    pub(super) time_s: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    pub(super) speed_rad_s: Vec<f64>,
    /// Short stretches of rows over which both balances are looked at.
    pub(super) windows: Vec<Range<usize>>,
    /// Column that gave the voltage.
    pub(super) voltage_key: &'static str,
}

impl Table {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let mut held = Held::new(&scenario.events);
        let voltage_v = scenario
            .sample_time_s
            .iter()
            .map(|time_s| match scenario.input {
                Input::Voltage => held.at(*time_s),
                Input::Current | Input::Torque => f64::NAN,
            })
            .collect();
        Self {
            windows: windows(&scenario.sample_time_s),
            time_s: scenario.sample_time_s.clone(),
            voltage_v,
            current_a: scenario.current_a.clone(),
            speed_rad_s: scenario.speed_rad_s.clone(),
            voltage_key: scenario.input_channel.key(),
        }
    }

    pub(super) fn duration_s(&self) -> f64 {
        match (self.time_s.first(), self.time_s.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }

    /// Median distance of the samples, s.
    pub(super) fn period_s(&self) -> f64 {
        period_s(&self.time_s)
    }
}

fn period_s(times: &[f64]) -> f64 {
    let gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    crate::numerics::statistics::median(&gaps)
}

/// Length of a window, s, samples it has at least, and windows that are looked at.
const WINDOW_S: f64 = 0.03;
const FEWEST_SAMPLES: usize = 3;
const MOST_WINDOWS: usize = 3000;

/// Periods of a record, and at least a window's length, that may pass between two rows of a window: nothing is integrated
/// over a pause, where nobody knows what the signals did, and whose one window would outweigh all others.
const LONGEST_STEP: f64 = 3.0;

/// First and last row of each window; a long record is looked at in places, evenly.
fn windows(times: &[f64]) -> Vec<Range<usize>> {
    let mut windows = Vec::new();
    let longest_s = WINDOW_S.max(LONGEST_STEP * period_s(times));
    let mut begin = 0;
    while begin + FEWEST_SAMPLES <= times.len() {
        let mut end = begin + FEWEST_SAMPLES - 1;
        while end + 1 < times.len() && times[end] - times[begin] < WINDOW_S {
            end += 1;
        }
        let pause = (begin..end).rfind(|row| times[row + 1] - times[*row] > longest_s);
        if let Some(row) = pause {
            begin = row + 1;
            continue;
        }
        windows.push(begin..end);
        begin = end;
    }
    let stride = windows.len().div_ceil(MOST_WINDOWS).max(1);
    windows.into_iter().step_by(stride).collect()
}

/// A held signal read at times that only grow.
struct Held<'a> {
    events: &'a [(f64, f64)],
    next: usize,
}

impl<'a> Held<'a> {
    const fn new(events: &'a [(f64, f64)]) -> Self {
        Self { events, next: 0 }
    }

    fn at(&mut self, time_s: f64) -> f64 {
        while self
            .events
            .get(self.next)
            .is_some_and(|event| event.0 <= time_s)
        {
            self.next += 1;
        }
        self.next
            .checked_sub(1)
            .map_or(f64::NAN, |held| self.events[held].1)
    }
}

/// One signal by itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Activity {
    pub(super) count: usize,
    pub(super) least: f64,
    pub(super) most: f64,
    pub(super) mean: f64,
    /// Standard deviation that white noise of the same differences would have.
    pub(super) noise: f64,
    /// Whether it changes by more than its noise.
    pub(super) moves: bool,
}

/// Parts of a record whose means are compared.
const PARTS: usize = 16;
/// Standard deviations by which the mean of a part of white noise does not stray, in any of the parts.
const STRAY: f64 = 5.0;
/// Squared differences over squared deviations (von Neumann): 2 for white noise, less for anything with a memory.
const WHITE: f64 = 1.5;

impl Activity {
    pub(super) fn of(values: &[f64]) -> Self {
        let present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        let count = present.len();
        let n = count.max(1) as f64;
        let mean = present.iter().sum::<f64>() / n;
        let least = present.iter().copied().fold(f64::INFINITY, f64::min);
        let most = present.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let deviation: f64 = present.iter().map(|v| (v - mean).powi(2)).sum();
        let difference: f64 = present.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        let noise = (0.5 * difference / n).sqrt();
        let part = (count / PARTS).max(4);
        let stray = present
            .chunks(part)
            .filter(|chunk| chunk.len() == part)
            .map(|chunk| (chunk.iter().sum::<f64>() / part as f64 - mean).abs())
            .fold(0.0, f64::max);
        let changes = count > 1 && most > least;
        let moves = changes
            && (difference < WHITE * deviation || stray > STRAY * noise / (part as f64).sqrt());
        Self {
            count,
            least,
            most,
            mean,
            noise,
            moves,
        }
    }

    pub(super) fn is_there(&self) -> bool {
        self.count > 0
    }

    /// The same value in every cell.
    pub(super) fn is_constant(&self) -> bool {
        self.count > 0 && self.most <= self.least
    }

    pub(super) fn range(&self) -> f64 {
        self.most - self.least
    }

    pub(super) fn largest(&self) -> f64 {
        self.most.abs().max(self.least.abs())
    }

    /// Zero but for noise.
    pub(super) fn is_zero(&self) -> bool {
        !self.moves && self.mean.abs() <= STRAY * self.noise / (self.count.max(1) as f64).sqrt()
    }
}

/// Correlation coefficient over the rows where both are there; zero where one does not vary.
pub(super) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs = || {
        a.iter()
            .zip(b)
            .filter(|(a, b)| a.is_finite() && b.is_finite())
    };
    let n = pairs().count().max(1) as f64;
    let mean_a = pairs().map(|(a, _)| a).sum::<f64>() / n;
    let mean_b = pairs().map(|(_, b)| b).sum::<f64>() / n;
    let [mut aa, mut bb, mut ab] = [0.0; 3];
    for (a, b) in pairs() {
        aa += (a - mean_a).powi(2);
        bb += (b - mean_b).powi(2);
        ab += (a - mean_a) * (b - mean_b);
    }
    if aa > 0.0 && bb > 0.0 {
        ab / (aa * bb).sqrt()
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_window_spans_a_pause_and_slow_rows_are_none() {
        let times: Vec<f64> = (0..1000)
            .filter(|row| !(400..800).contains(row))
            .map(|row| 1e-3 * f64::from(row))
            .collect();
        let found = windows(&times);
        let length_s = |window: &Range<usize>| times[window.end] - times[window.start];
        assert!(found.len() >= 18 && found.iter().all(|window| length_s(window) < 0.05));
        let slow: Vec<f64> = (0..100).map(|row| 0.1 * f64::from(row)).collect();
        assert!(windows(&slow).len() > 40);
    }
}
