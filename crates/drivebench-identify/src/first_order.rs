//! First-order lag with dead time of the speed behind the voltage: what voltage and speed alone determine of any motor.
//!
//! ```text
//! T w' = g (u(t - d) - u_c sgn u) - w        g = 1/Ke, T = R J/(Ke Kt), u_c = R Mc/Kt
//! ```
//!
//! The gains are linear, time constant and dead time are looked for on a grid and refined. The plain lag, without dead time
//! and friction, is also a trivial prediction that a model has to beat.

use nalgebra::DVector;

use super::misfit::lasting;
use super::output_error::BLOCK_S;
use super::verdict::SETTLED;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares::{clustered, inverse_where_determined};
use drivebench_model::numerics::levenberg_marquardt::{self, Options, Problem};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Scenario};
use drivebench_model::sample::ParameterEstimate;

/// Readings below which nothing is fitted.
const FEWEST: usize = 8;
/// Share of the largest speed below which a shaft without a voltage has no direction.
const RESTS: f64 = 0.02;

/// A lag with its dead time and the voltage that friction takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    pub gain_rad_s_per_v: f64,
    pub time_constant_s: f64,
    pub dead_time_s: f64,
    pub friction_v: f64,
    /// Root mean square that it leaves of the speeds that it was fitted to, rad/s.
    pub left_rad_s: f64,
}

/// For each sample what a lag of gain one makes of voltage and direction, what is left there of the first speed, and the
/// measured speed.
struct Row {
    voltage: f64,
    direction: f64,
    free: f64,
    speed: f64,
}

impl FirstOrder {
    /// The plain lag nearest to the scored speeds of `run`.
    pub fn plain(run: &Scenario) -> Option<Self> {
        Self::on_grid(run, &[0.0], false)
    }

    /// With dead time and friction.
    pub fn with_dead_time(run: &Scenario) -> Option<Self> {
        Self::refined(run).map(|found| found.0)
    }

    fn refined(run: &Scenario) -> Option<(Self, [f64; 4])> {
        // In sample intervals: a reading that comes a few exchanges late.
        let dead_times = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0];
        Refined::of(&Self::on_grid(run, &dead_times, true)?, run)
    }

    fn on_grid(run: &Scenario, dead_times: &[f64], frictions: bool) -> Option<Self> {
        if run.input != Input::Voltage || run.samples() < FEWEST {
            return None;
        }
        let period_s = run.mean_period_s();
        let ratio = (run.samples() - 1) as f64;
        // Time constants from the sample interval to the length of the run, evenly in their logarithm.
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
        let voltages = sum(|row| row.voltage * row.voltage);
        let moved = sum(|row| row.voltage * (row.speed - row.free));
        let mut found = Self {
            gain_rad_s_per_v: moved / voltages,
            time_constant_s,
            dead_time_s,
            friction_v: 0.0,
            left_rad_s: 0.0,
        };
        if frictions {
            let directions = sum(|row| row.direction * row.direction);
            let both = sum(|row| row.voltage * row.direction);
            let turned = sum(|row| row.direction * (row.speed - row.free));
            let apart = voltages * directions - both * both;
            let gain = (directions * moved - both * turned) / apart;
            let friction_v = -(voltages * turned - both * moved) / apart / gain;
            // Where the columns lie along each other, all levels of the voltage are one.
            if apart > 1e-3 * voltages * directions && friction_v > 0.0 && gain > 0.0 {
                (found.gain_rad_s_per_v, found.friction_v) = (gain, friction_v);
            }
        }
        found.left_rad_s = found.root_mean_square(&rows);
        let is_sound = rows.len() >= FEWEST && found.gain_rad_s_per_v.is_finite();
        is_sound.then_some(found)
    }

    fn missed(&self, row: &Row) -> f64 {
        let driven = row.voltage - self.friction_v * row.direction;
        row.free + self.gain_rad_s_per_v * driven - row.speed
    }

    fn root_mean_square(&self, rows: &[Row]) -> f64 {
        let squares: f64 = rows.iter().map(|row| self.missed(row).powi(2)).sum();
        (squares / f64::max(rows.len() as f64, 1.0)).sqrt()
    }

    /// Root mean square that it leaves of the scored speeds of another run, rad/s.
    pub fn left_of(&self, run: &Scenario) -> f64 {
        let late = delayed(run, self.dead_time_s);
        self.root_mean_square(&known(&late, self.time_constant_s))
    }

    /// Whether an estimate is one of a lag.
    pub fn is_key(key: &str) -> bool {
        key.starts_with("first_order.")
    }

    /// The lag as estimates, for a run that has no current; empty where no lag follows the speed.
    pub fn estimates(run: &Scenario) -> Vec<ParameterEstimate> {
        let Some((found, deviations)) = Self::refined(run) else {
            return Vec::new();
        };
        let all = [
            ("gain_rad_s_per_v", "rad/s/V", found.gain_rad_s_per_v),
            ("time_constant_s", "s", found.time_constant_s),
            ("dead_time_s", "s", found.dead_time_s),
            ("friction_v", "V", found.friction_v),
        ];
        let of = |((key, unit, value), std): ((&str, &'static str, f64), f64)| {
            let key = format!("first_order.{key}");
            let relative = std / value.abs();
            let doubt = (relative > SETTLED)
                .then(|| format!("relative uncertainty {:.1} %", 100.0 * relative));
            let found = ParameterEstimate::found(key, unit, value, std, doubt);
            (value > 0.0 && std.is_finite()).then_some(found)
        };
        all.into_iter().zip(deviations).filter_map(of).collect()
    }
}

/// The run with all of its input later; before that a shaft that is at rest had none.
fn delayed(run: &Scenario, dead_time_s: f64) -> Scenario {
    let mut late = run.clone();
    if dead_time_s > 0.0 {
        let mut speeds = run.speed_rad_s.iter().filter(|speed| speed.is_finite());
        let rests =
            speeds.next().is_none_or(|first| first.abs() <= RESTS * largest(&run.speed_rad_s));
        let before = if rests { 0.0 } else { run.events[0].1 };
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
    let mut speeds = run.speed_rad_s.iter().copied();
    let mut first = speeds.find(|speed| speed.is_finite()).unwrap_or(0.0);
    let rests = RESTS * largest(&run.speed_rad_s);
    let mut begin_s = run.sample_time_s[0];
    let (mut voltage, mut direction, mut now_s, mut event) = (0.0, 0.0, begin_s, 0);
    let mut turning = 0.0;
    let events = &run.events;
    let mut restarts = (run.unknown_input.iter())
        .filter_map(|hole| hole.restart.map(|[_, speed]| (hole.to_s, speed)));
    let mut restart = restarts.next();
    let samples = run.sample_time_s.iter().zip(&run.speed_rad_s);
    samples
        .map(|(time_s, speed)| {
            while let Some((at_s, speed)) = restart.filter(|restart| restart.0 <= *time_s) {
                (voltage, direction, turning) = (0.0, 0.0, 0.0);
                (begin_s, now_s, first) = (at_s, at_s, if speed.is_finite() { speed } else { 0.0 });
                restart = restarts.next();
            }
            while now_s < *time_s {
                while event + 1 < events.len() && events[event + 1].0 <= now_s {
                    event += 1;
                }
                let next_s = events.get(event + 1).map_or(*time_s, |next| next.0.min(*time_s));
                let keeps = (-(next_s - now_s) / time_constant_s).exp();
                let volts = events[event].1;
                let sign = if volts == 0.0 { turning } else { volts.signum() };
                voltage = keeps * voltage + (1.0 - keeps) * volts;
                direction = keeps * direction + (1.0 - keeps) * sign;
                now_s = next_s;
            }
            if speed.is_finite() {
                let turns = speed.abs() > rests;
                turning = if turns { speed.signum() } else { 0.0 };
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

/// A lag near one from the grid: gain, friction, dead time and logarithm of the time constant as unknowns.
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
        let blocks: Vec<usize> = known
            .map(|sample| whole((run.sample_time_s[sample] - run.begin_s()).max(0.0) / BLOCK_S))
            .collect();
        let residual = DVector::from_column_slice(&minimum.residual);
        // The lag has no other form than its own: what it leaves along the whole run counts like any model's misfit.
        let power = minimum.cost / problem.rows as f64 * lasting(&minimum.residual);
        let misfit = bread.diagonal() * power;
        let covariance = clustered(&minimum.jacobian, &residual, &blocks, bread, &determined);
        let mut deviations = [f64::NAN; 4];
        for (place, blocks) in covariance.diagonal().iter().enumerate() {
            deviations[place] = blocks.max(misfit[place]).sqrt() * problem.scale[place].abs();
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
            *cell = lag.missed(row);
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
            let own = of(&found, "first_order.gain_rad_s_per_v");
            (own.std.unwrap(), left_rad_s)
        };
        // A speed that reads too little the faster it is, and one that errs to either side in turn.
        let (bent, left_rad_s) = gain(&|_, speed| -4e-3 * speed * speed);
        let (noisy, of_noise) = gain(&|row, _| [left_rad_s, -left_rad_s][row % 2]);
        assert_near(of_noise, left_rad_s, 0.1);
        assert!(bent > 2.0 * noisy, "{bent} {noisy}");
    }
}
