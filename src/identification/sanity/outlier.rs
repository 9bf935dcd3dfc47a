//! Single values that no machine can have shown: one row far off between two that agree.

use super::table::Table;
use super::{Finding, Kind};

/// A current may jump; one that comes back within a row by this many times the usual range did not.
const CURRENT_RANGES: f64 = 3.0;
/// The inertia forbids a speed this share of its range for one row, where rows are close enough to see it.
const SPEED_RANGES: f64 = 0.5;
const CLOSE_S: f64 = 0.02;
/// Share of the range by which the two neighbours may differ.
const NEIGHBOURS: f64 = 0.1;
/// Share of the rows left out at each end of what counts as the usual range, and up to which values are single.
const TAIL: f64 = 0.01;

pub(super) fn check(table: &Table) -> Option<Finding> {
    let pairs = table.time_s.windows(2);
    let close = pairs.clone().filter(|pair| pair[1] - pair[0] <= CLOSE_S);
    let close = 2 * close.count() > pairs.count();
    let speed = if close { SPEED_RANGES } else { CURRENT_RANGES };
    one("speed_rad_s", &table.time_s, &table.speed_rad_s, speed)
        .or_else(|| one("current_a", &table.time_s, &table.current_a, CURRENT_RANGES))
}

fn one(key: &str, time_s: &[f64], values: &[f64], ranges: f64) -> Option<Finding> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    if sorted.len() < 100 {
        return None;
    }
    sorted.sort_by(f64::total_cmp);
    let tail = (TAIL * sorted.len() as f64).ceil();
    let tail = crate::numerics::count::whole(tail);
    let range = sorted[sorted.len() - 1 - tail] - sorted[tail];
    let spikes: Vec<usize> = (1..values.len().saturating_sub(1))
        .filter(|&row| {
            let (before, at, after) = (values[row - 1], values[row], values[row + 1]);
            let nearest = (at - before).abs().min((at - after).abs());
            range > 0.0 && (before - after).abs() <= NEIGHBOURS * range && nearest > ranges * range
        })
        .collect();
    let first = *spikes.first()?;
    // Many of them are no accident but what the signal is.
    if spikes.len() > tail {
        return None;
    }
    Some(Finding::refusal(
        Kind::Outlier,
        format!(
            "{key} reads {:.4} at {:.4} s between {:.4} and {:.4} ({} such {} of {}): no machine moves like that",
            values[first],
            time_s[first],
            values[first - 1],
            values[first + 1],
            spikes.len(),
            if spikes.len() == 1 { "row" } else { "rows" },
            values.len()
        ),
        "leave the cell empty: an empty cell is a missing value; look for noise on the line or a torn transmission",
    ))
}
