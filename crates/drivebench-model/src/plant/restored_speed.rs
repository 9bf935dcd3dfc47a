//! Inverse filtering of a speed behind the known lag of its sensor, for balances that have no model of the sensor: `w + T dw/dt` by
//! central differences, earlier by the delay.
//!
//! ```text
//! measured   w ____/----      restored   w ___/----      left out where the restored speed is not that of the angle: an
//!               ,-'                         |             observer follows another law near standstill (that of VESC holds
//!             -'                          --'             at most three times the present speed)
//! ```

use crate::numerics::statistics::{largest, median_step};
use crate::sample::{Channel, Run, Sensors, SpeedLag};
use crate::signal::{self, Point};

/// Intervals between readings, in periods, over which no balance may extend.
pub(super) const LONGEST_PERIODS: f64 = 1.5;

pub(super) struct Restored {
    pub(super) run: Run,
    /// Standard deviation of the speed by the resolution of its sensor, which vanishes at rest, rad/s.
    pub(super) rounding_rad_s: f64,
    /// First and last instants of what was left out or is missing, s: no balance may extend over them.
    pub(super) gaps_s: Vec<f64>,
}

/// `None` where the speed has no known lag.
pub(super) fn restored(run: &Run) -> Option<Restored> {
    let lag = run.sensors().speed;
    let column = run.column(Channel::Speed)?;
    let rows: Vec<usize> = (0..column.len()).filter(|row| column[*row].is_finite()).collect();
    if lag.total_s() <= 0.0 || rows.len() < 3 {
        return None;
    }
    let speed: Vec<Point> = rows.iter().map(|row| (run.time_s()[*row], column[*row])).collect();
    let period_s = median_step(&speed.iter().map(|point| point.0).collect::<Vec<f64>>());
    let last = speed.len() - 1;
    let slope = |from: Point, to: Point| (to.1 - from.1) / (to.0 - from.0);
    // Of the parabola through three readings, at other distances where one between them is missing.
    let value = |at: usize| {
        let (before, after) = (speed[at.saturating_sub(1)], speed[(at + 1).min(last)]);
        let [back_s, ahead_s] = [speed[at].0 - before.0, after.0 - speed[at].0];
        let rate = if back_s > 0.0 && ahead_s > 0.0 {
            let (behind, next) = (slope(before, speed[at]), slope(speed[at], after));
            (ahead_s * behind + back_s * next) / (back_s + ahead_s)
        } else {
            slope(before, after)
        };
        speed[at].1 + lag.filter_s * rate
    };
    let mut inverse: Vec<Point> =
        (0..=last).map(|at| (speed[at].0 - lag.delay_s, value(at))).collect();
    let fastest = largest(speed.iter().map(|point| point.1));
    let lost = match run.column(Channel::Angle) {
        Some(angle) => {
            let angle: Vec<f64> = rows.iter().map(|row| angle[*row]).collect();
            differs_from_angle(&inverse, &angle, 0.02 * fastest)
        }
        // A filter of less than two periods is restored within a sample.
        None if lag.filter_s > 2.0 * period_s => near_reversals(&speed, lag.filter_s),
        None => vec![false; last + 1],
    };
    let mut gaps_s = Vec::new();
    for gap in (0..=last).collect::<Vec<usize>>().chunk_by(|one, next| lost[*one] == lost[*next]) {
        if let [first, .., end] | [first @ end] = gap
            && lost[*first]
        {
            gaps_s.extend([inverse[*first].0, inverse[*end].0]);
            inverse[*first..=*end].iter_mut().for_each(|point| point.1 = f64::NAN);
        }
    }
    let holes = speed.windows(2).filter(|pair| pair[1].0 - pair[0].0 > LONGEST_PERIODS * period_s);
    gaps_s.extend(holes.flat_map(|pair| [pair[0].0, pair[1].0]));
    let mut cells = vec![f64::NAN; column.len()];
    for row in rows {
        cells[row] = signal::line_with_ends(&inverse, run.time_s()[row]);
    }
    let mut without = run.clone();
    without.set_sensors(Sensors { speed: SpeedLag::default(), ..run.sensors() });
    without.set_column(Channel::Speed, cells, run.origin(Channel::Speed)).ok()?;
    // The difference of two rounded readings over two periods, times the filter's time constant.
    let readings: Vec<f64> = speed.iter().map(|point| point.1).collect();
    let quantum = smallest_step(&readings);
    let gain = 1.0_f64.hypot(lag.filter_s / (f64::sqrt(2.0) * period_s));
    let rounding_rad_s = if quantum.is_finite() { gain * quantum / 12_f64.sqrt() } else { 0.0 };
    Some(Restored { run: without, rounding_rad_s, gaps_s })
}

/// Samples within a window of five whose mean speed is another than the slope of the angle by more than `most` and by more than a count.
fn differs_from_angle(speed: &[Point], angle: &[f64], most: f64) -> Vec<bool> {
    let count = smallest_step(angle);
    let mut differs = vec![false; speed.len()];
    for (first, window) in speed.windows(5).enumerate() {
        let end = first + 4;
        let seconds = speed[end].0 - speed[first].0;
        let areas =
            window.windows(2).map(|pair| 0.5 * (pair[1].0 - pair[0].0) * (pair[0].1 + pair[1].1));
        let difference = (areas.sum::<f64>() - (angle[end] - angle[first])) / seconds;
        if difference.abs() > most.max(count / seconds) {
            differs[first..=end].fill(true);
        }
    }
    differs
}

/// Samples that are no farther than `within_s` from a change of the sign of the speed.
fn near_reversals(speed: &[Point], within_s: f64) -> Vec<bool> {
    let turns = speed
        .windows(2)
        .filter(|pair| pair[0].1 * pair[1].1 <= 0.0 && (pair[1].1 - pair[0].1).abs() > 0.0);
    let turns_s: Vec<f64> = turns.map(|pair| pair[1].0).collect();
    let is_near = |point: &Point| {
        let next = turns_s.partition_point(|turn_s| *turn_s < point.0 - within_s);
        turns_s.get(next).is_some_and(|turn_s| *turn_s <= point.0 + within_s)
    };
    speed.iter().map(is_near).collect()
}

/// Smallest change from a reading to the next, but for rounding in the file; infinite where nothing changes.
fn smallest_step(readings: &[f64]) -> f64 {
    let least = 1e-9 * largest(readings.iter().copied());
    let steps = readings.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    steps.filter(|step| *step > least).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::run_of;
    use crate::sample::Origin;

    /// A triangle of speed, behind a filter of 66 ms that is held to three times the speed, with an angle of counts.
    fn run(has_angle: bool) -> (Run, Vec<f64>) {
        let (step_s, filter_s) = (1e-4, 0.066);
        let (mut filtered, mut angle) = (0.0_f64, 0.0_f64);
        let (mut times, mut speeds, mut angles, mut truth) = (vec![], vec![], vec![], vec![]);
        for step in 0..40_000_u32 {
            let time_s = f64::from(step) * step_s;
            let phase = (time_s / 0.4).rem_euclid(2.0);
            let speed = 400.0 * (1.0 - (phase - 1.0).abs()) - 200.0;
            filtered += step_s / filter_s * (speed - filtered);
            filtered = filtered.clamp(-3.0 * speed.abs(), 3.0 * speed.abs());
            angle += step_s * speed;
            if step % 100 == 0 {
                times.push(time_s);
                speeds.push((filtered / 0.015).round() * 0.015);
                angles.push((angle / 0.15).round() * 0.15);
                truth.push(speed);
            }
        }
        let mut columns = vec![(Channel::Speed, speeds, Origin::Measured)];
        if has_angle {
            columns.push((Channel::Angle, angles, Origin::Measured));
        }
        let mut run = run_of("r", times, columns);
        run.set_sensors(Sensors {
            speed: SpeedLag { delay_s: 0.0, filter_s },
            ..Sensors::default()
        });
        (run, truth)
    }

    #[test]
    fn what_is_restored_is_the_speed_and_the_rest_is_left_out() {
        for (has_angle, within, least) in [(true, 6.0, 0.6), (false, 6.0, 0.5)] {
            let (run, truth) = run(has_angle);
            let found = restored(&run).unwrap();
            let speeds = found.run.column(Channel::Speed).unwrap();
            // Not the kinks of the triangle, of 1000 rad/s2.
            let is_straight = |row: usize| {
                let phase = (run.time_s()[row] / 0.4).fract();
                row > 20 && (0.05..0.95).contains(&phase)
            };
            let rows: Vec<usize> = (0..truth.len()).filter(|row| is_straight(*row)).collect();
            let kept = rows.iter().filter(|row| speeds[**row].is_finite());
            let worst =
                kept.clone().map(|row| (speeds[*row] - truth[*row]).abs()).fold(0.0, f64::max);
            assert!(worst < within, "{has_angle}: {worst}");
            assert!(kept.count() as f64 > least * rows.len() as f64, "{has_angle}");
            assert!((0.01..0.3).contains(&found.rounding_rad_s), "{}", found.rounding_rad_s);
        }
    }

    #[test]
    fn without_a_lag_nothing_is_restored() {
        let (mut run, _) = run(true);
        run.set_sensors(Sensors::default());
        assert!(restored(&run).is_none());
    }
}
