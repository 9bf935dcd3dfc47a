//! The winding of a shaft at rest: `u = R i + L di/dt`, nothing else.
//!
//! The current is proportional to the voltage behind a first-order lag L/R. The lag is searched on a grid, the
//! conductance is then linear: the noise sits on the current alone, so there is no errors-in-variables bias.

use serde::Serialize;

use super::Seen;
use crate::plant::Scenario;

/// Time constants that are tried, s: from none to slower than any small machine.
const SHORTEST_S: f64 = 1e-4;
const LONGEST_S: f64 = 0.2;
const STEPS: u32 = 45;
/// Samples and significance below which nothing is claimed.
const FEWEST: usize = 15;
const SIGNIFICANCE: f64 = 5.0;
/// Rows of the standstill that the offset of the current is at least the mean of.
const OFFSET_ROWS: usize = 30;

/// Resistance of a winding at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RestWinding {
    pub resistance_ohm: f64,
    /// Standard deviation, ohm; the lag that is not known is part of it.
    pub std_ohm: f64,
    /// L/R that fits best, s; a ramp tells it only roughly.
    pub time_constant_s: f64,
}

impl RestWinding {
    pub fn relative(&self) -> f64 {
        self.std_ohm / self.resistance_ohm
    }

    /// Three standard deviations below, never less than half.
    pub fn lowest_ohm(&self) -> f64 {
        (self.resistance_ohm - 3.0 * self.std_ohm).max(0.5 * self.resistance_ohm)
    }

    pub fn highest_ohm(&self) -> f64 {
        self.resistance_ohm + 3.0 * self.std_ohm
    }
}

pub(super) fn at_rest(scenario: &Scenario, seen: &Seen) -> Option<RestWinding> {
    let rows: Vec<usize> = (0..seen.at_rest.min(scenario.samples()))
        .filter(|at| scenario.current_a[*at].is_finite())
        .collect();
    if rows.len() < FEWEST {
        return None;
    }
    let amps: Vec<f64> = rows
        .iter()
        .map(|at| scenario.current_a[*at] - seen.offset_a)
        .collect();
    let ratio = (LONGEST_S / SHORTEST_S).powf(1.0 / f64::from(STEPS - 1));
    let fits: Vec<(f64, f64, f64, f64)> = (0..STEPS)
        .filter_map(|step| {
            let constant_s = SHORTEST_S * ratio.powi(i32::try_from(step).ok()?);
            let lagged = lagged(scenario, &rows, constant_s);
            let power: f64 = lagged.iter().map(|y| y * y).sum();
            if power <= 0.0 {
                return None;
            }
            let conductance = lagged.iter().zip(&amps).map(|(y, i)| y * i).sum::<f64>() / power;
            let squares: f64 = lagged
                .iter()
                .zip(&amps)
                .map(|(y, i)| (i - conductance * y).powi(2))
                .sum();
            Some((squares, constant_s, conductance, power))
        })
        .collect();
    let best = fits.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let degrees = (rows.len() - 2) as f64;
    let noise_a = (best.0 / degrees).sqrt().max(seen.noise_a);
    // The offset is a mean over the rows before the voltage: its error bends every row the same way.
    let sum: f64 = lagged(scenario, &rows, best.1).iter().sum();
    let offset = noise_a / (OFFSET_ROWS as f64).sqrt() * sum / best.3;
    let std = (noise_a / best.3.sqrt()).hypot(offset);
    let conductance = best.2;
    if conductance < SIGNIFICANCE * std {
        return None;
    }
    // Lags that the data allow as well move the resistance: that is part of its uncertainty.
    let spread = fits
        .iter()
        .filter(|fit| fit.0 - best.0 < 4.0 * noise_a * noise_a && fit.2 > 0.0)
        .map(|fit| (fit.2 - conductance).abs())
        .fold(0.0, f64::max);
    let resistance_ohm = 1.0 / conductance;
    Some(RestWinding {
        resistance_ohm,
        std_ohm: resistance_ohm * std.hypot(0.5 * spread) / conductance,
        time_constant_s: best.1,
    })
}

/// The held voltage behind a first-order lag, at the rows: exact between events.
fn lagged(scenario: &Scenario, rows: &[usize], constant_s: f64) -> Vec<f64> {
    let mut events = scenario.events.iter().copied().peekable();
    let begin_s = scenario.sample_time_s[0];
    let (mut now_s, mut held_v, mut lag_v) = (begin_s, 0.0, 0.0);
    let mut values = Vec::with_capacity(rows.len());
    for &row in rows {
        let until_s = scenario.sample_time_s[row];
        while let Some(&(at_s, volts)) = events.peek() {
            if at_s > until_s {
                break;
            }
            if at_s > now_s {
                lag_v += (held_v - lag_v) * -(-(at_s - now_s) / constant_s).exp_m1();
                now_s = at_s;
            }
            held_v = volts;
            events.next();
        }
        lag_v += (held_v - lag_v) * -(-(until_s - now_s) / constant_s).exp_m1();
        now_s = until_s;
        values.push(lag_v);
    }
    values
}
