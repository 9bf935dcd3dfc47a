//! The narrowest range of a variable that holds most of the error.

use super::Equation;
use super::balance::Window;

const BINS: usize = 24;
/// Share of the error that follows the variable which a region must hold.
const MOST: f64 = 0.8;

/// A range with what lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Region {
    pub from: f64,
    pub to: f64,
    /// Share of the squared error beyond the noise.
    pub share_of_error: f64,
    pub share_of_time: f64,
    /// The range is one of sizes: it stands for both signs.
    pub of_size: bool,
    /// It begins at the lowest value, ends at the highest.
    pub from_lowest: bool,
    pub to_highest: bool,
}

/// One window along the variable.
pub(super) struct Point<'a> {
    pub at: f64,
    /// What the variable explains of the error.
    pub fitted: f64,
    pub window: &'a Window,
}

/// The narrower (in time) of the regions along the variable and along its size.
pub(super) fn narrowest(points: &[Point<'_>], equation: Equation) -> Option<Region> {
    let both_signs = points.iter().any(|p| p.at > 0.0) && points.iter().any(|p| p.at < 0.0);
    let plain = along(points, equation, false);
    if !both_signs {
        return plain;
    }
    // A range on one side only must be clearly narrower to be preferred: most faults do not know a sign.
    let of_size = along(points, equation, true);
    match (plain, of_size) {
        (Some(plain), Some(size)) => Some(if plain.share_of_time < 0.7 * size.share_of_time {
            plain
        } else {
            size
        }),
        (plain, size) => plain.or(size),
    }
}

fn along(points: &[Point<'_>], equation: Equation, of_size: bool) -> Option<Region> {
    let key = |point: &Point<'_>| if of_size { point.at.abs() } else { point.at };
    let mut sorted: Vec<&Point<'_>> = points.iter().collect();
    sorted.sort_by(|a, b| key(a).total_cmp(&key(b)));
    let last = sorted.len().checked_sub(1)?;
    if last < 3 * BINS || key(sorted[0]) >= key(sorted[last]) {
        return None;
    }
    // Bins of equal population: where the run spent much time the picture is sharp.
    let first_of = |bin: usize| bin * sorted.len() / BINS;
    let edge = |bin: usize| key(sorted[first_of(bin).min(last)]);
    let sum = |bin: usize, value: &dyn Fn(&Point<'_>) -> f64| -> f64 {
        sorted[first_of(bin)..first_of(bin + 1)]
            .iter()
            .map(|point| value(point))
            .sum()
    };
    let follows: Vec<f64> = (0..BINS)
        .map(|bin| sum(bin, &|p| p.fitted * p.fitted))
        .collect();
    let beyond: Vec<f64> = (0..BINS)
        .map(|bin| {
            sum(bin, &|p| {
                p.window.error(equation).powi(2) - p.window.floor(equation).powi(2)
            })
            .max(0.0)
        })
        .collect();
    let total: f64 = follows.iter().sum();
    let (first, end) = (0..BINS)
        .flat_map(|first| (first..BINS).map(move |end| (first, end)))
        .filter(|(first, end)| follows[*first..=*end].iter().sum::<f64>() >= MOST * total)
        .min_by(|a, b| {
            // Fewest windows; among equals the one that holds more.
            let held = |(first, end): &(usize, usize)| follows[*first..=*end].iter().sum::<f64>();
            (a.1 - a.0)
                .cmp(&(b.1 - b.0))
                .then(held(b).total_cmp(&held(a)))
        })?;
    let whole: f64 = beyond.iter().sum();
    let inside = first_of(end + 1) - first_of(first);
    Some(Region {
        from: edge(first),
        to: edge(end + 1),
        share_of_error: if whole > 0.0 {
            beyond[first..=end].iter().sum::<f64>() / whole
        } else {
            0.0
        },
        share_of_time: inside as f64 / sorted.len() as f64,
        of_size,
        from_lowest: first == 0,
        to_highest: end + 1 == BINS,
    })
}
