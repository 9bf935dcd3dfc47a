//! Preparation of the signals: even time grids in parts without gaps, the low pass, central differences.
//!
//! With even stamps the values are not changed. Otherwise a natural cubic spline interpolates them: linear interpolation would
//! lose the curvature, and with it the acceleration.

use super::super::speed_from_angle;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::filter::{Butterworth, spline};
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{Input, Scenario};
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::signal;

#[derive(Clone, Debug, PartialEq)]
pub struct Processing {
    pub motion: Motion,
    pub order: usize,
    pub rate_hz: f64,
    pub cut_off_hz: f64,
    /// One row in this many enters each fit.
    pub decimation: usize,
    /// Parts of the run without gaps.
    pub parts: usize,
    pub interpolated: bool,
    /// Whether noise requires a lower cut-off than a tenth of the rate.
    pub lowered: bool,
    /// Below this the shaft may be at rest, rad/s.
    pub dead_zone_rad_s: f64,
    /// Standard deviation of noise in the filtered acceleration, rad/s2.
    pub acceleration_noise: f64,
}

impl Processing {
    pub(super) fn choose(gridded: &Gridded) -> Self {
        let parts = &gridded.parts;
        let samples: usize = parts.iter().map(Part::samples).sum();
        let rate_hz = samples as f64
            / parts.iter().map(|part| part.period_s * part.samples() as f64).sum::<f64>();
        let noise = noise(parts);
        // Differentiations that lead to the speed; one more leads to the acceleration.
        let of_speed = u16::from(gridded.motion == Motion::Angle);
        // The choice of the reference processing (100 Hz at 1 kHz): low enough for central differences, high enough for the
        // motion.
        let first_hz = 0.1 * rate_hz;
        let mut best = (f64::INFINITY, first_hz);
        let mut cut_off_hz = first_hz;
        while cut_off_hz >= 0.05 * first_hz {
            let error = noise_of(1 + of_speed, noise, cut_off_hz, rate_hz).powi(2);
            let power = acceleration_power(gridded, cut_off_hz, rate_hz);
            let share = error / (power - error).max(f64::MIN_POSITIVE);
            if share < best.0 {
                best = (share, cut_off_hz);
            }
            if share <= 1e-3 {
                break;
            }
            cut_off_hz *= 0.8;
        }
        let cut_off_hz = best.1;
        let speeds =
            parts.iter().flat_map(|part| filtered_speed(gridded.motion, part, cut_off_hz, rate_hz));
        let fastest = statistics::largest(speeds);
        let deviation = noise_of(of_speed, noise, cut_off_hz, rate_hz);
        Self {
            motion: gridded.motion,
            order: 4,
            rate_hz,
            cut_off_hz,
            decimation: whole(rate_hz / (2.0 * cut_off_hz) + 1e-6).max(1),
            parts: parts.len(),
            interpolated: gridded.interpolated,
            lowered: cut_off_hz < 0.999 * first_hz,
            dead_zone_rad_s: (4.0 * deviation).max(1e-3 * fastest),
            acceleration_noise: noise_of(1 + of_speed, noise, cut_off_hz, rate_hz),
        }
    }

    pub(super) fn at_half_cut_off(&self) -> Self {
        Self { cut_off_hz: 0.5 * self.cut_off_hz, decimation: 2 * self.decimation, ..self.clone() }
    }

    /// Samples over which the filter reaches.
    pub(super) fn reach(&self, period_s: f64) -> usize {
        whole((1.0 / (self.cut_off_hz * period_s)).ceil())
    }

    /// What was done, for the reader.
    pub fn sentence(&self) -> String {
        self.sentence_with(&format!(
            "one row in {} (the new Nyquist frequency is the cut-off), mean over all {} offsets",
            self.decimation, self.decimation
        ))
    }

    /// The same with another choice of rows.
    pub fn sentence_with(&self, rows: &str) -> String {
        let speed = match self.motion {
            Motion::Speed => "measured speed",
            Motion::Angle => "speed and acceleration as central differences of the filtered angle",
        };
        let why = if self.lowered {
            "lowered until noise is 0.1 % of the acceleration's power, or least"
        } else {
            "a tenth of the sampling rate"
        };
        let carried = if self.interpolated {
            "; values interpolated to an even grid by a spline"
        } else {
            ""
        };
        let parts = if self.parts > 1 {
            format!("; {} parts between gaps", self.parts)
        } else {
            String::new()
        };
        format!(
            "inverse dynamics: {speed}; both sides of the balance through a zero-phase Butterworth low pass of order {} \
             at {:.3} Hz ({why}; rate {:.1} Hz); {rows}{carried}{parts}",
            self.order, self.cut_off_hz, self.rate_hz
        )
    }
}

/// The filter for a part; `None` where the cut-off reaches half of its rate.
pub(super) fn filter(cut_off_hz: f64, period_s: f64) -> Option<Butterworth> {
    // Order 4: with both passes the gain falls by 48 dB per octave.
    Butterworth::low_pass(4, cut_off_hz * period_s)
}

/// Central difference; one-sided at the ends.
pub(super) fn rate(values: &[f64], period_s: f64) -> Vec<f64> {
    let last = values.len() - 1;
    (0..=last)
        .map(|k| {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(last));
            (values[after] - values[before]) / ((after - before).max(1) as f64 * period_s)
        })
        .collect()
}

/// Mean over the two periods of a central difference, by Simpson's rule: all terms of a balance need the same attenuation as its
/// central difference (6 % at a tenth of the rate).
pub(super) fn spanned(values: &[f64]) -> Vec<f64> {
    let last = values.len() - 1;
    (0..=last)
        .map(|k| {
            let (before, after) = (values[k.saturating_sub(1)], values[(k + 1).min(last)]);
            (before + 4.0 * values[k] + after) / 6.0
        })
        .collect()
}

fn filtered_speed(motion: Motion, part: &Part, cut_off_hz: f64, rate_hz: f64) -> Vec<f64> {
    let Some(filter) = filter(cut_off_hz, 1.0 / rate_hz) else { return Vec::new() };
    let filtered = filter.zero_phase(&part.motion);
    match motion {
        Motion::Speed => filtered,
        Motion::Angle => rate(&filtered, part.period_s),
    }
}

/// Mean square of the filtered acceleration, the ends left out.
fn acceleration_power(gridded: &Gridded, cut_off_hz: f64, rate_hz: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    for part in &gridded.parts {
        let speed = filtered_speed(gridded.motion, part, cut_off_hz, rate_hz);
        if speed.is_empty() {
            continue;
        }
        let skipped = whole(rate_hz / cut_off_hz).min(speed.len() / 4);
        let inside = &rate(&speed, part.period_s)[skipped..speed.len() - skipped];
        sum += inside.iter().map(|a| a * a).sum::<f64>();
        count += inside.len();
    }
    sum / count.max(1) as f64
}

/// Standard deviation of the noise in the angle or speed: from fourth differences, robust against steps and outliers, and at least
/// the resolution over sqrt(12).
fn noise(parts: &[Part]) -> f64 {
    let mut differences = Vec::new();
    let (mut finest, mut largest) = (f64::INFINITY, 0.0);
    for part in parts {
        let values = part.motion.windows(5);
        differences.extend(values.map(|v| v[0] - 4.0 * v[1] + 6.0 * v[2] - 4.0 * v[3] + v[4]));
        largest = part.motion.iter().map(|v| v.abs()).fold(largest, f64::max);
        let steps = part.motion.windows(2).map(|v| (v[1] - v[0]).abs());
        finest = steps.filter(|step| *step > 1e-12 * largest).fold(finest, f64::min);
    }
    let roughness = statistics::robust_deviation(&differences) / 70f64.sqrt();
    let quantum = finest / 12f64.sqrt();
    roughness.max(if quantum.is_finite() { quantum } else { 0.0 })
}

/// White noise of deviation `sigma` through the low pass and so many differentiations: integral of its spectrum up to the
/// cut-off.
fn noise_of(derivatives: u16, sigma: f64, cut_off_hz: f64, rate_hz: f64) -> f64 {
    let power = f64::from(2 * derivatives);
    let omega = std::f64::consts::TAU * cut_off_hz;
    sigma * (2.0 * cut_off_hz / rate_hz * omega.powf(power) / (power + 1.0)).sqrt()
}

/// Whether a stamp is within 2 % of a period from its place on an even grid.
fn is_even(stamp_s: f64, grid_s: f64, period_s: f64) -> bool {
    (stamp_s - grid_s).abs() < 0.02 * period_s
}

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

/// What is measured beside the angle, and whether the speed was derived from it: the processing filters the angle before it
/// differentiates it.
pub(super) struct Measured {
    speed: Points,
    speed_is_derived: bool,
    /// Torque or current.
    driving: Points,
}

impl Measured {
    pub(super) fn of_run(run: &Run, input: Input) -> Self {
        let driving = match input {
            Input::Torque => Channel::Torque,
            Input::Voltage | Input::Current => Channel::Current,
        };
        Self {
            speed: run.points(Channel::Speed).collect(),
            speed_is_derived: run.origin(Channel::Speed) == Origin::Derived,
            driving: run.points(driving).collect(),
        }
    }

    pub(super) fn of_scenario(scenario: &Scenario) -> Self {
        let times = || scenario.sample_time_s.iter().copied();
        let of = |values: &[f64]| finite(times().zip(values.iter().copied()));
        Self {
            speed: of(&scenario.speed_rad_s),
            speed_is_derived: speed_from_angle::span(scenario).is_some(),
            driving: match scenario.input {
                Input::Torque => finite(scenario.events.iter().copied()),
                Input::Voltage | Input::Current => of(&scenario.current_a),
            },
        }
    }
}

fn finite(points: impl Iterator<Item = (f64, f64)>) -> Points {
    points.filter(|point| point.1.is_finite()).collect()
}

/// `None`: neither speed nor angle is measured, or no stretch is long enough.
pub(super) fn gridded(measured: &Measured, scenario: &Scenario) -> Option<Gridded> {
    let times = &scenario.sample_time_s;
    let (first_s, last_s) = (*times.first()?, *times.last()?);
    let points = |points: &[(f64, f64)]| within(points.iter().copied(), first_s, last_s);
    let speed = points(&measured.speed);
    let (angle, shaft) = (points(&scenario.angle), points(&scenario.shaft_angle()));
    // A speed that this program derived from the angle is filtered already, by another filter.
    let derived = speed.is_empty() || measured.speed_is_derived;
    let (motion, moving) =
        if derived && !angle.is_empty() { (Motion::Angle, angle) } else { (Motion::Speed, speed) };
    let driving = points(&measured.driving);
    let (current, torque) = match scenario.input {
        Input::Torque => (Vec::new(), driving),
        Input::Voltage | Input::Current => (driving, Vec::new()),
    };
    let mut gridded = Gridded { motion, parts: Vec::new(), interpolated: false };
    let needed: Vec<&Points> =
        [&moving, &current, &torque].into_iter().filter(|points| !points.is_empty()).collect();
    if needed.is_empty() {
        return None;
    }
    let period_s = statistics::largest(needed.iter().map(|points| median_gap(points)));
    for (from_s, to_s) in stretches(&needed, period_s) {
        let inside = |points: &Points| within(points.iter().copied(), from_s, to_s);
        let moving = inside(&moving);
        let grid = even(&moving, period_s).unwrap_or_else(|| over(from_s, to_s, period_s));
        // Shorter parts consist of the transients of the filter.
        if grid.len() < 60 {
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

fn within(points: impl Iterator<Item = (f64, f64)>, from_s: f64, to_s: f64) -> Points {
    points.filter(|point| point.0 >= from_s && point.0 <= to_s).collect()
}

fn median_gap(points: &[(f64, f64)]) -> f64 {
    let times: Vec<f64> = points.iter().map(|point| point.0).collect();
    let median = statistics::median_step(&times);
    if median.is_finite() { median } else { 0.0 }
}

/// Where every signal that is needed is there without a gap.
fn stretches(needed: &[&Points], period_s: f64) -> Vec<(f64, f64)> {
    let ends = |points: &&Points| Some((points.first()?.0, points.last()?.0));
    let spans: Vec<(f64, f64)> = needed.iter().filter_map(ends).collect();
    let begin_s = spans.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
    let end_s = spans.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let gaps = needed.iter().flat_map(|points| points.windows(2).map(|w| (w[0].0, w[1].0)));
    let mut gaps: Vec<(f64, f64)> = gaps.filter(|gap| gap.1 - gap.0 > 5.0 * period_s).collect();
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
    let mean_s = (last.0 - first.0) / (points.len() - 1).max(1) as f64;
    let grid = |k: usize| first.0 + mean_s * k as f64;
    let is_grid = mean_s > 0.9 * period_s
        && points.iter().enumerate().all(|(k, point)| is_even(point.0, grid(k), mean_s));
    is_grid.then(|| (0..points.len()).map(grid).collect())
}

fn over(from_s: f64, to_s: f64, period_s: f64) -> Vec<f64> {
    let samples = whole((to_s - from_s) / period_s) + 1;
    (0..samples).map(|k| from_s + period_s * k as f64).collect()
}

/// The values at the instants of the grid, and whether they had to be carried there.
fn on(grid: &[f64], points: &[(f64, f64)], curved: bool) -> (Vec<f64>, bool) {
    if points.len() < 2 {
        return (vec![f64::NAN; grid.len()], false);
    }
    let period_s = grid[1] - grid[0];
    let stands = points.len() == grid.len()
        && points.iter().zip(grid).all(|(point, at)| is_even(point.0, *at, period_s));
    if stands {
        (points.iter().map(|point| point.1).collect(), false)
    } else if curved {
        (spline(points, grid), true)
    } else {
        (grid.iter().map(|at| signal::line_with_ends(points, *at)).collect(), true)
    }
}
