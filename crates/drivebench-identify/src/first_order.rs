//! First-order lag with dead time from voltage to speed (FOPDT model), all that is identifiable of a motor without a current.
//!
//! ```text
//! T w' = g (u(t - d) - u_c sgn u) - w        g = 1/Ke, T = R J/(Ke Kt), u_c = R Mc/Kt
//! ```
//!
//! Separable least squares: the gains are linear, time constant and dead time are searched on a grid and refined by
//! Levenberg-Marquardt. The plain lag, without dead time and friction, is also the reference prediction of a model.

use nalgebra::DVector;

use super::misfit::lasting;
use super::verdict::SETTLED;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares::{clustered, inverse_where_determined};
use drivebench_model::numerics::levenberg_marquardt::{self, Options, Problem};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason};

/// Fewest speeds of a fit.
const FEWEST: usize = 8;

/// Speed below which the shaft counts as at rest, rad/s: 2 % of the largest.
fn rest_rad_s(run: &Scenario) -> f64 {
    0.02 * largest(&run.speed_rad_s)
}

/// A lag with its dead time and the voltage of the friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    pub gain_rad_s_per_v: f64,
    pub time_constant_s: f64,
    pub dead_time_s: f64,
    pub friction_v: f64,
    /// Root mean square of the residual, rad/s.
    pub left_rad_s: f64,
}

/// Responses of a lag of unit gain at one sample, to the voltage, to its sign and to the initial speed, and the measured speed.
struct Row {
    voltage: f64,
    direction: f64,
    free: f64,
    speed: f64,
}

impl FirstOrder {
    /// The plain lag fitted to the scored speeds of `run`.
    pub fn plain(run: &Scenario) -> Option<Self> {
        Self::on_grid(run, &[0.0], false)
    }

    /// With dead time and friction.
    pub fn with_dead_time(run: &Scenario) -> Option<Self> {
        Self::refined(run).map(|found| found.0)
    }

    fn refined(run: &Scenario) -> Option<(Self, [f64; 4])> {
        // In sampling periods: a reading that is late by up to some exchanges.
        let dead_times = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0];
        Refined::of(&Self::on_grid(run, &dead_times, true)?, run)
    }

    fn on_grid(run: &Scenario, dead_times: &[f64], frictions: bool) -> Option<Self> {
        if run.input != Input::Voltage || run.samples() < FEWEST {
            return None;
        }
        let period_s = run.mean_period_s();
        let ratio = (run.samples() - 1) as f64;
        // Time constants from the sampling period to the length of the run, in geometric progression.
        let tried = dead_times.iter().flat_map(|periods| {
            let dead_time_s = periods * period_s;
            let late = delayed(run, dead_time_s);
            (0..40).filter_map(move |k| {
                let time_constant_s = period_s * ratio.powf(f64::from(k) / 39.0);
                Self::fitted(&late, dead_time_s, time_constant_s, frictions)
            })
        });
        tried.min_by(|a, b| a.left_rad_s.total_cmp(&b.left_rad_s))
    }

    /// The gains by least squares; `late` has the dead time in its input.
    fn fitted(
        late: &Scenario,
        dead_time_s: f64,
        time_constant_s: f64,
        frictions: bool,
    ) -> Option<Self> {
        let rows = known(late, time_constant_s);
        let sum = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>();
        let [voltages, directions, both] = moments(&rows);
        let by_voltage = sum(|row| row.voltage * (row.speed - row.free));
        let mut found = Self {
            gain_rad_s_per_v: by_voltage / voltages,
            time_constant_s,
            dead_time_s,
            friction_v: 0.0,
            left_rad_s: 0.0,
        };
        if frictions {
            // Cramer's rule for the two normal equations.
            let by_direction = sum(|row| row.direction * (row.speed - row.free));
            let determinant = voltages * directions - both * both;
            let gain = (directions * by_voltage - both * by_direction) / determinant;
            let friction_v = -(voltages * by_direction - both * by_voltage) / determinant / gain;
            if !is_of_one_level(&rows) && friction_v > 0.0 && gain > 0.0 {
                (found.gain_rad_s_per_v, found.friction_v) = (gain, friction_v);
            }
        }
        found.left_rad_s = found.root_mean_square(&rows);
        let is_sound = rows.len() >= FEWEST && found.gain_rad_s_per_v.is_finite();
        is_sound.then_some(found)
    }

    fn error(&self, row: &Row) -> f64 {
        let driven = row.voltage - self.friction_v * row.direction;
        row.free + self.gain_rad_s_per_v * driven - row.speed
    }

    fn root_mean_square(&self, rows: &[Row]) -> f64 {
        let squares: f64 = rows.iter().map(|row| self.error(row).powi(2)).sum();
        (squares / f64::max(rows.len() as f64, 1.0)).sqrt()
    }

    /// Root mean square of the residual over the scored speeds of another run, rad/s.
    pub fn left_of(&self, run: &Scenario) -> f64 {
        let late = delayed(run, self.dead_time_s);
        self.root_mean_square(&known(&late, self.time_constant_s))
    }

    /// Whether an estimate is one of a lag.
    pub fn is_key(key: &str) -> bool {
        key.starts_with("first_order.")
    }

    /// The lag as estimates, for a run that has no current; empty without a fit.
    pub fn estimates(run: &Scenario) -> Vec<ParameterEstimate> {
        let Some((found, deviations)) = Self::refined(run) else { return Vec::new() };
        let all = [
            ("gain_rad_s_per_v", "rad/s/V", found.gain_rad_s_per_v),
            ("time_constant_s", "s", found.time_constant_s),
            ("dead_time_s", "s", found.dead_time_s),
            ("friction_v", "V", found.friction_v),
        ];
        let late = delayed(run, found.dead_time_s);
        let has_one_level = is_of_one_level(&known(&late, found.time_constant_s));
        let of = |((key, unit, value), std): ((&str, &'static str, f64), f64)| {
            let relative = std / value.abs();
            let doubt = if has_one_level && unit == "rad/s/V" {
                let reason =
                    "the voltage has one level: friction lowers the gain, and is contained in it";
                Some((Reason::NotExcited, reason.to_owned()))
            } else {
                (relative > SETTLED)
                    .then(|| format!("relative uncertainty {:.1} %", 100.0 * relative))
                    .map(|reason| (Reason::Uncertain, reason))
            };
            let key = format!("first_order.{key}");
            let found = ParameterEstimate::found(key, unit, value, std, doubt);
            (value > 0.0 && std.is_finite()).then_some(found)
        };
        all.into_iter().zip(deviations).filter_map(of).collect()
    }
}

/// Sums of the squares of voltage and direction, and of their product.
fn moments(rows: &[Row]) -> [f64; 3] {
    let sum = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>();
    [
        sum(|row| row.voltage * row.voltage),
        sum(|row| row.direction * row.direction),
        sum(|row| row.voltage * row.direction),
    ]
}

/// Whether the columns of voltage and friction are collinear: the voltage has one level, of either sign.
fn is_of_one_level(rows: &[Row]) -> bool {
    let [voltages, directions, both] = moments(rows);
    voltages * directions - both * both <= 1e-3 * voltages * directions
}

/// The run with a delayed input; before its first value the input is zero where the shaft is at rest, else the first value.
fn delayed(run: &Scenario, dead_time_s: f64) -> Scenario {
    let mut late = run.clone();
    if dead_time_s > 0.0 {
        let mut speeds = run.speed_rad_s.iter().filter(|speed| speed.is_finite());
        let is_at_rest = speeds.next().is_none_or(|first| first.abs() <= rest_rad_s(run));
        let before = if is_at_rest { 0.0 } else { run.events[0].1 };
        for event in &mut late.events {
            event.0 += dead_time_s;
        }
        late.events.insert(0, (run.begin_s(), before));
    }
    late
}

/// The scored rows that have a speed.
fn known(late: &Scenario, time_constant_s: f64) -> Vec<Row> {
    let scored = late.scored.clone();
    let mut rows = response(late, time_constant_s);
    rows.truncate(scored.end);
    rows.drain(..scored.start);
    rows.retain(|row| row.speed.is_finite() && row.voltage.is_finite());
    rows
}

fn response(run: &Scenario, time_constant_s: f64) -> Vec<Row> {
    let mut first = run.speed_rad_s.iter().copied().find(|speed| speed.is_finite()).unwrap_or(0.0);
    let rest_rad_s = rest_rad_s(run);
    let mut begin_s = run.sample_time_s[0];
    let (mut voltage, mut direction, mut now_s, mut event) = (0.0, 0.0, begin_s, 0);
    let mut last_sign = 0.0;
    let events = &run.events;
    let mut restarts = (run.unknown_input.iter())
        .filter_map(|hole| hole.restart.map(|[_, speed]| (hole.to_s, speed)));
    let mut restart = restarts.next();
    let samples = run.sample_time_s.iter().zip(&run.speed_rad_s);
    samples
        .map(|(time_s, speed)| {
            while let Some((at_s, speed)) = restart.filter(|restart| restart.0 <= *time_s) {
                (voltage, direction, last_sign) = (0.0, 0.0, 0.0);
                (begin_s, now_s, first) = (at_s, at_s, if speed.is_finite() { speed } else { 0.0 });
                restart = restarts.next();
            }
            while now_s < *time_s {
                while event + 1 < events.len() && events[event + 1].0 <= now_s {
                    event += 1;
                }
                let next_s = events.get(event + 1).map_or(*time_s, |next| next.0.min(*time_s));
                let decay = (-(next_s - now_s) / time_constant_s).exp();
                let volts = events[event].1;
                let sign = if volts == 0.0 { last_sign } else { volts.signum() };
                voltage = decay * voltage + (1.0 - decay) * volts;
                direction = decay * direction + (1.0 - decay) * sign;
                now_s = next_s;
            }
            if speed.is_finite() {
                last_sign = if speed.abs() > rest_rad_s { speed.signum() } else { 0.0 };
            }
            Row {
                voltage,
                direction,
                free: first * (-(time_s - begin_s) / time_constant_s).exp(),
                speed: *speed,
            }
        })
        .collect()
}

/// Refinement of a lag from the grid, with gain, logarithm of the time constant, dead time and friction as unknowns.
struct Refined<'a> {
    run: &'a Scenario,
    scale: [f64; 4],
    frictions: bool,
    rows: usize,
}

impl<'a> Refined<'a> {
    /// The lag with the deviations of gain, time constant, dead time and friction.
    fn of(coarse: &FirstOrder, run: &'a Scenario) -> Option<(FirstOrder, [f64; 4])> {
        let period_s = run.mean_period_s();
        let problem = Self {
            run,
            scale: [coarse.gain_rad_s_per_v, 1.0, period_s, coarse.friction_v],
            frictions: coarse.friction_v > 0.0,
            rows: known(run, coarse.time_constant_s).len(),
        };
        let dead_time = coarse.dead_time_s / period_s;
        let mut start = vec![1.0, coarse.time_constant_s.ln(), dead_time];
        start.extend(problem.frictions.then_some(1.0));
        let minimum = levenberg_marquardt::minimise(&problem, &start, Options::default())?;
        let mut found = problem.at(&minimum.x);
        found.left_rad_s = (minimum.cost / problem.rows as f64).sqrt();
        let (bread, determined) = inverse_where_determined(&minimum.jacobian);
        let known = (run.scored.clone()).filter(|sample| run.speed_rad_s[*sample].is_finite());
        let block_s = run.scales.block_s();
        let blocks: Vec<usize> = known
            .map(|sample| whole((run.sample_time_s[sample] - run.begin_s()).max(0.0) / block_s))
            .collect();
        let residual = DVector::from_column_slice(&minimum.residual);
        // A misfit along the whole run widens the intervals as for any other model.
        let power = minimum.cost / problem.rows as f64 * lasting(&minimum.residual);
        let misfit = bread.diagonal() * power;
        let covariance = clustered(&minimum.jacobian, &residual, &blocks, bread, &determined);
        let mut deviations = [f64::NAN; 4];
        for (index, variance) in covariance.diagonal().iter().enumerate() {
            deviations[index] = variance.max(misfit[index]).sqrt() * problem.scale[index].abs();
        }
        deviations[1] *= found.time_constant_s;
        Some((found, deviations))
    }

    fn at(&self, x: &[f64]) -> FirstOrder {
        FirstOrder {
            gain_rad_s_per_v: x[0] * self.scale[0],
            time_constant_s: x[1].exp(),
            dead_time_s: x[2] * self.scale[2],
            friction_v: x.get(3).map_or(0.0, |x| x * self.scale[3]),
            left_rad_s: 0.0,
        }
    }
}

impl Problem for Refined<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let lag = self.at(x);
        let late = delayed(self.run, lag.dead_time_s);
        let rows = known(&late, lag.time_constant_s);
        for (cell, row) in out.iter_mut().zip(&rows) {
            *cell = lag.error(row);
        }
        rows.len() == self.rows && out.iter().all(|value| value.is_finite())
    }

    fn residual_len(&self) -> usize {
        self.rows
    }

    fn difference_step(&self, _: usize) -> f64 {
        1e-3
    }

    fn clamp(&self, x: &mut [f64]) {
        x[2] = x[2].max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    /// A lag of 2.4 rad/s/V and 0.12 s behind 60 ms and 0.4 V, under one step out of rest each, 20 Hz.
    fn steps_of(levels: &[f64]) -> Scenario {
        let one = |volts: &f64| {
            let times = every(0.05, 3.0);
            let events = vec![(0.0, *volts)];
            let mut run = simulated(&paper(), Input::Voltage, events, times);
            let speed = |time_s: &f64| {
                let gone = (-(time_s - 0.06).max(0.0) / 0.12).exp();
                2.4 * (volts - 0.4) * (1.0 - gone)
            };
            run.speed_rad_s = run.sample_time_s.iter().map(speed).collect();
            run.current_a.fill(f64::NAN);
            run
        };
        let mut runs = levels.iter().map(one);
        let first = runs.next().unwrap();
        runs.fold(first, |all, next| all.followed_by(&next))
    }

    #[test]
    fn several_steps_give_gain_time_constant_dead_time_and_friction() {
        let found = FirstOrder::with_dead_time(&steps_of(&[4.0, 8.0, 6.0])).unwrap();
        assert_near(found.gain_rad_s_per_v, 2.4, 0.02);
        assert_near(found.time_constant_s, 0.12, 0.05);
        assert_near(found.dead_time_s, 0.06, 0.1);
        assert_near(found.friction_v, 0.4, 0.1);
        assert!(found.left_of(&steps_of(&[10.0])) < 0.1, "{found:?}");
        // One step does not separate friction from the gain.
        let found = FirstOrder::estimates(&steps_of(&[8.0]));
        let gain = of(&found, "first_order.gain_rad_s_per_v");
        assert_near(gain.value.unwrap(), 2.4 * 7.6 / 8.0, 0.02);
        assert!(ParameterEstimate::find(&found, "first_order.friction_v").is_none());
    }

    #[test]
    fn a_lasting_misfit_widens_the_interval_more_than_noise_does() {
        let gain = |error: &dyn Fn(usize, f64) -> f64| {
            let mut run = steps_of(&[4.0, 8.0, 6.0]);
            for (row, speed) in run.speed_rad_s.iter_mut().enumerate() {
                *speed += error(row, *speed);
            }
            let left_rad_s = FirstOrder::with_dead_time(&run).unwrap().left_rad_s;
            let found = FirstOrder::estimates(&run);
            (of(&found, "first_order.gain_rad_s_per_v").std.unwrap(), left_rad_s)
        };
        // A speed sensor with a gain that falls with the speed, and one with an alternating error.
        let (bent, left_rad_s) = gain(&|_, speed| -4e-3 * speed * speed);
        let (noisy, of_noise) = gain(&|row, _| [left_rad_s, -left_rad_s][row % 2]);
        assert_near(of_noise, left_rad_s, 0.1);
        assert!(bent > 2.0 * noisy, "{bent} {noisy}");
    }
}
