//! A run's signals on even time grids, in parts without gaps: a filter needs them so.
//!
//! Where the stamps are even already the values are taken as they stand. Otherwise a natural cubic spline carries them
//! over: it keeps the curvature that a line between two stamps would cut off, and with it the acceleration.

use crate::numerics::filter::spline;
use crate::plant::{Input, Scenario};
use crate::sample::{Channel, Origin, Run};

/// Periods without a sample that end a part.
const LONGEST_GAP: f64 = 5.0;
/// Deviation from an even grid, in periods, up to which stamps count as even.
const EVEN: f64 = 0.02;
/// Samples below which a part is left out: the filter's ends would be all there is.
const FEWEST: usize = 60;

/// What tells the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    Speed,
    /// The speed is the central difference of the filtered angle.
    Angle,
}

/// A stretch without gaps on an even grid. NaN throughout where a signal is not in the run.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) begin_s: f64,
    pub(super) period_s: f64,
    /// Angle or speed.
    pub(super) motion: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    pub(super) torque_n_m: Vec<f64>,
    /// Measured angle for effects of position.
    pub(super) angle_rad: Vec<f64>,
}

impl Part {
    pub(super) fn samples(&self) -> usize {
        self.motion.len()
    }

    pub(super) fn time_s(&self, sample: usize) -> f64 {
        self.begin_s + self.period_s * sample as f64
    }

    /// Every second sample.
    pub(super) fn thinned(&self) -> Self {
        let every_second = |values: &[f64]| values.iter().copied().step_by(2).collect();
        Self {
            begin_s: self.begin_s,
            period_s: 2.0 * self.period_s,
            motion: every_second(&self.motion),
            current_a: every_second(&self.current_a),
            torque_n_m: every_second(&self.torque_n_m),
            angle_rad: every_second(&self.angle_rad),
        }
    }
}

/// The run on even grids, within the time span of the scenario.
pub(super) struct Gridded {
    pub(super) motion: Motion,
    pub(super) parts: Vec<Part>,
    /// Whether values had to be carried over to other instants.
    pub(super) interpolated: bool,
}

type Points = Vec<(f64, f64)>;

/// `None`: neither speed nor angle is measured, or no stretch is long enough.
pub(super) fn gridded(run: &Run, scenario: &Scenario) -> Option<Gridded> {
    let times = &scenario.sample_time_s;
    let (first_s, last_s) = (*times.first()?, *times.last()?);
    let points = |channel: Channel| -> Points {
        let within = |point: &(f64, f64)| point.0 >= first_s && point.0 <= last_s;
        run.points(channel).filter(within).collect()
    };
    let speed = points(Channel::Speed);
    let within = |angle: &[(f64, f64)]| -> Points {
        let within = |point: &&(f64, f64)| point.0 >= first_s && point.0 <= last_s;
        angle.iter().filter(within).copied().collect()
    };
    let (angle, shaft) = (within(&scenario.angle), within(&scenario.shaft_angle()));
    // A speed that this program derived from the angle is filtered already, by another filter.
    let derived = speed.is_empty() || run.origin(Channel::Speed) == Origin::Derived;
    let (motion, moving) = if derived && !angle.is_empty() {
        (Motion::Angle, angle)
    } else {
        (Motion::Speed, speed)
    };
    let (current, torque) = match scenario.input {
        Input::Torque => (Vec::new(), points(Channel::Torque)),
        Input::Voltage | Input::Current => (points(Channel::Current), Vec::new()),
    };
    let mut gridded = Gridded {
        motion,
        parts: Vec::new(),
        interpolated: false,
    };
    let needed: Vec<&Points> = [&moving, &current, &torque]
        .into_iter()
        .filter(|points| !points.is_empty())
        .collect();
    let period_s = needed
        .iter()
        .map(|points| median_gap(points))
        .fold(0.0, f64::max);
    for (from_s, to_s) in stretches(&needed, period_s) {
        let inside = |points: &Points| -> Points {
            let within = |point: &&(f64, f64)| point.0 >= from_s && point.0 <= to_s;
            points.iter().filter(within).copied().collect()
        };
        let moving = inside(&moving);
        let grid = even(&moving, period_s).unwrap_or_else(|| over(from_s, to_s, period_s));
        if grid.len() < FEWEST {
            continue;
        }
        let mut carried = |points: &Points, curved: bool| {
            let (values, moved) = on(&grid, points, curved);
            gridded.interpolated |= moved;
            values
        };
        gridded.parts.push(Part {
            begin_s: grid[0],
            period_s: (grid[grid.len() - 1] - grid[0]) / (grid.len() - 1) as f64,
            motion: carried(&moving, true),
            current_a: carried(&inside(&current), true),
            // A torque may step: no curve is drawn through it.
            torque_n_m: carried(&inside(&torque), false),
            angle_rad: carried(&inside(&shaft), true),
        });
    }
    (!gridded.parts.is_empty()).then_some(gridded)
}

fn median_gap(points: &[(f64, f64)]) -> f64 {
    let gaps: Vec<f64> = points.windows(2).map(|w| w[1].0 - w[0].0).collect();
    let median = crate::numerics::statistics::median(&gaps);
    if median.is_finite() { median } else { 0.0 }
}

/// Where every signal that is needed is there without a gap.
fn stretches(needed: &[&Points], period_s: f64) -> Vec<(f64, f64)> {
    let ends = |points: &&Points| Some((points.first()?.0, points.last()?.0));
    let spans: Vec<(f64, f64)> = needed.iter().filter_map(ends).collect();
    let begin_s = spans.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
    let end_s = spans.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let mut gaps: Vec<(f64, f64)> = needed
        .iter()
        .flat_map(|points| points.windows(2).map(|w| (w[0].0, w[1].0)))
        .filter(|gap| gap.1 - gap.0 > LONGEST_GAP * period_s)
        .collect();
    gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut stretches = Vec::new();
    let mut from_s = begin_s;
    for (last_s, next_s) in gaps {
        stretches.push((from_s, last_s.min(end_s)));
        from_s = from_s.max(next_s);
    }
    stretches.push((from_s, end_s));
    stretches.retain(|(from_s, to_s)| to_s > from_s);
    stretches
}

/// The stamps made exactly even, where they are so but for rounding and every needed signal can keep up.
fn even(points: &[(f64, f64)], period_s: f64) -> Option<Vec<f64>> {
    let (first, last) = (points.first()?, points.last()?);
    let own_s = (last.0 - first.0) / (points.len() - 1).max(1) as f64;
    let place = |k: usize| first.0 + own_s * k as f64;
    let fits = own_s > 0.9 * period_s
        && points
            .iter()
            .enumerate()
            .all(|(k, point)| (point.0 - place(k)).abs() < EVEN * own_s);
    fits.then(|| (0..points.len()).map(place).collect())
}

fn over(from_s: f64, to_s: f64, period_s: f64) -> Vec<f64> {
    let samples = crate::numerics::count::whole((to_s - from_s) / period_s) + 1;
    (0..samples).map(|k| from_s + period_s * k as f64).collect()
}

/// The values at the instants of the grid, and whether they had to be carried there.
fn on(grid: &[f64], points: &[(f64, f64)], curved: bool) -> (Vec<f64>, bool) {
    if points.len() < 2 {
        return (vec![f64::NAN; grid.len()], false);
    }
    let period_s = grid[1] - grid[0];
    let stands = points.len() == grid.len()
        && points
            .iter()
            .zip(grid)
            .all(|(point, at)| (point.0 - at).abs() < EVEN * period_s);
    if stands {
        (points.iter().map(|point| point.1).collect(), false)
    } else if curved {
        (spline(points, grid), true)
    } else {
        (grid.iter().map(|at| line(points, *at)).collect(), true)
    }
}

/// Linear interpolation; the end values hold beyond the ends.
fn line(points: &[(f64, f64)], at_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < at_s);
    match (after.checked_sub(1).map(|k| points[k]), points.get(after)) {
        (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (at_s - a.0) / (b.0 - a.0),
        (None, Some(only)) => only.1,
        (Some(only), None) => only.1,
        (None, None) => f64::NAN,
    }
}
