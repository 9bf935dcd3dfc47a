//! The signals side by side at the sample times, the activity of each, and both balances over short windows.
//!
//! Both balances over short windows are quick: good enough to recognise the columns, not to identify. Each integral is by the
//! trapezoid, so that every column is treated alike in any role.

use std::ops::Range;

use super::sensor::Sensor;
use crate::belief::Settings;
use crate::window_sums::{Sums, WINDOW_RESPONSES, trapezoid, windows};
use drivebench_model::numerics::count;
use drivebench_model::numerics::least_squares::fit_normal;
use drivebench_model::numerics::statistics::{extent, finite, largest, mean, median_step};
use drivebench_model::plant::{Input, MotorKey, RunScales, Scenario};
use drivebench_model::signal;

/// Voltage (as held), current and speed at each sample; NaN where missing. Without a voltage the first is all NaN.
pub(super) struct Table {
    pub(super) time_s: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    /// What drives the shaft, whatever its unit: voltage, current or torque.
    pub(super) input: Vec<f64>,
    /// Instants at which a commanded current steps; empty where the drive does not control it.
    pub(super) current_steps_s: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    pub(super) speed_rad_s: Vec<f64>,
    /// Sensors of current and speed.
    pub(super) current: Sensor,
    pub(super) speed: Sensor,
    /// Short stretches of rows over which both balances are taken.
    pub(super) windows: Vec<Range<usize>>,
    /// Column that gave the voltage.
    pub(super) voltage_key: &'static str,
}

impl Table {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let input = |time_s: &f64| signal::held(&scenario.events, *time_s).unwrap_or(f64::NAN);
        let rows = whole_rows(scenario);
        let of = |values: &[f64]| -> Vec<f64> { rows.iter().map(|row| values[*row]).collect() };
        let time_s = of(&scenario.sample_time_s);
        let (current_a, speed_rad_s) = (of(&scenario.current_a), of(&scenario.speed_rad_s));
        Self {
            windows: spread_windows(&time_s, &scenario.scales),
            voltage_v: match scenario.input {
                Input::Voltage => time_s.iter().map(input).collect(),
                Input::Current | Input::Torque => vec![f64::NAN; time_s.len()],
            },
            input: time_s.iter().map(input).collect(),
            current_steps_s: scenario.current_steps_s.clone(),
            current: Sensor::of(&current_a),
            speed: Sensor::of(&speed_rad_s),
            time_s,
            current_a,
            speed_rad_s,
            voltage_key: scenario.input_channel.key(),
        }
    }

    /// Voltage, current and speed.
    pub(super) fn columns(&self) -> [&[f64]; 3] {
        [&self.voltage_v, &self.current_a, &self.speed_rad_s]
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.time_s.first().zip(self.time_s.last()).map_or(0.0, |(first, last)| last - first)
    }

    pub(super) fn voltage_is_of_a_supply(&self) -> bool {
        is_of_a_supply(&self.voltage_v)
    }

    pub(super) fn period_s(&self) -> f64 {
        median_step(&self.time_s)
    }
}

/// Whether a voltage only sags: that of a supply, from which the winding's voltage does not follow. A battery that sags below
/// 0.7 of its largest voltage is empty, and an excitation that changes by less excites hardly anything.
pub fn is_of_a_supply(voltage_v: &[f64]) -> bool {
    let voltage = Activity::of(voltage_v);
    let least = voltage.least.abs().min(voltage.most.abs());
    voltage.is_there()
        && voltage.least * voltage.most > 0.0
        && least > 0.7 * voltage.largest()
        && !voltage.is_constant()
}

/// Rows in which each signal that is measured has a value; all, where such rows are fewer than 100 or 2 %: a signal that is
/// sampled more slowly than the rest has a value in one of some ten.
fn whole_rows(scenario: &Scenario) -> Vec<usize> {
    let mut measured = vec![&scenario.current_a, &scenario.speed_rad_s];
    measured.retain(|values| values.iter().any(|value| value.is_finite()));
    let all = 0..scenario.samples();
    let is_whole = |row: &usize| measured.iter().all(|values| values[*row].is_finite());
    let whole: Vec<usize> = all.clone().filter(is_whole).collect();
    if whole.len() < usize::max(100, count::whole(0.02 * all.len() as f64)) {
        all.collect()
    } else {
        whole
    }
}

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

/// Largest deviation of the mean of a part of white noise, in its standard deviations, for 16 parts of a record.
const STRAY: f64 = 5.0;

impl Activity {
    pub(super) fn of(values: &[f64]) -> Self {
        let present = finite(values);
        let count = present.len();
        let n = count.max(1) as f64;
        let mean = present.iter().sum::<f64>() / n;
        let (least, most) = extent(&present);
        let deviation: f64 = present.iter().map(|v| (v - mean).powi(2)).sum();
        let difference: f64 = present.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        let noise = (0.5 * difference / n).sqrt();
        let part = (count / 16).max(4);
        let parts = present.chunks_exact(part);
        let stray = largest(parts.map(|chunk| chunk.iter().sum::<f64>() / part as f64 - mean));
        // Von Neumann's ratio of both sums of squares is 2 for white noise, less for anything with a memory.
        let is_coloured = difference < 1.5 * deviation;
        let changes = count > 1 && most > least;
        let moves = changes && (is_coloured || stray > STRAY * noise / (part as f64).sqrt());
        Self { count, least, most, mean, noise, moves }
    }

    pub(super) fn is_there(&self) -> bool {
        self.count > 0
    }

    pub(super) fn is_constant(&self) -> bool {
        self.count > 0 && self.most <= self.least
    }

    pub(super) const fn extent(&self) -> [f64; 2] {
        [self.least, self.most]
    }

    pub(super) fn range(&self) -> f64 {
        self.most - self.least
    }

    pub(super) fn largest(&self) -> f64 {
        self.most.abs().max(self.least.abs())
    }

    /// Zero within the noise.
    pub(super) fn is_zero(&self) -> bool {
        !self.moves && self.mean.abs() <= STRAY * self.noise / (self.count.max(1) as f64).sqrt()
    }
}

pub(super) fn span(values: &[f64]) -> f64 {
    let (least, most) = extent(finite(values));
    most - least
}

/// Pearson's correlation coefficient over the rows that have both; zero where one does not vary.
pub(super) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs = a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
    let (a, b): (Vec<f64>, Vec<f64>) = pairs.unzip();
    let (mean_a, mean_b) = (mean(&a), mean(&b));
    let [mut aa, mut bb, mut ab] = [0.0; 3];
    for (a, b) in a.iter().zip(&b) {
        aa += (a - mean_a).powi(2);
        bb += (b - mean_b).powi(2);
        ab += (a - mean_a) * (b - mean_b);
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// 100 to 3,000 windows, evenly spread over a long record.
fn spread_windows(time_s: &[f64], scales: &RunScales) -> Vec<Range<usize>> {
    // Where columns are exchanged the time of response is not that of a motor.
    let window_s = scales.responses(WINDOW_RESPONSES).min(scales.length_s / 100.0);
    let windows = windows(time_s, window_s);
    let stride = windows.len().div_ceil(3000).max(1);
    windows.into_iter().step_by(stride).collect()
}

/// Which columns serve as voltage, current and speed.
#[derive(Clone, Copy)]
pub(super) struct Roles<'a> {
    pub(super) time_s: &'a [f64],
    pub(super) windows: &'a [Range<usize>],
    pub(super) voltage: &'a [f64],
    pub(super) current: &'a [f64],
    pub(super) speed: &'a [f64],
    /// Factors of current and speed: one, or minus one where a sign is tried.
    pub(super) signs: [f64; 2],
}

impl<'a> Roles<'a> {
    pub(super) fn of(table: &'a Table) -> Self {
        Self {
            time_s: &table.time_s,
            windows: &table.windows,
            voltage: &table.voltage_v,
            current: &table.current_a,
            speed: &table.speed_rad_s,
            signs: [1.0; 2],
        }
    }

    /// The same over these windows alone.
    pub(super) const fn over(self, windows: &'a [Range<usize>]) -> Self {
        Self { windows, ..self }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Coefficient {
    pub value: f64,
    pub std: f64,
}

/// Five standard deviations make a sign certain.
impl Coefficient {
    pub fn is_negative(&self) -> bool {
        self.value < -5.0 * self.std
    }

    pub fn is_positive(&self) -> bool {
        self.value > 5.0 * self.std
    }
}

/// Both balances under one assignment of the columns.
#[derive(Clone, Copy, Debug)]
pub struct Balances {
    pub resistance: Coefficient,
    pub inductance: Coefficient,
    pub back_emf: Coefficient,
    /// Root mean square of the residual over that of the voltage.
    pub voltage_error: f64,
    /// Inertia over the torque constant.
    pub inertia: Coefficient,
    /// Root mean square of the residual over that of the current.
    pub torque_error: f64,
}

impl Balances {
    pub(super) fn of(roles: &Roles<'_>) -> Option<Self> {
        let sums = sums(roles);
        let voltage = sums.iter().map(|s| ([s.current, s.current_step, s.angle], s.voltage));
        let ([resistance, inductance, back_emf], voltage_error) = fitted(voltage)?;
        let turning = sums.iter().filter(|s| s.direction != 0.0);
        let torque = |s: &Sums| ([s.speed_step, s.direction * s.length_s, s.angle], s.current);
        let ([inertia, ..], torque_error) = fitted(turning.map(torque))?;
        Some(Self { resistance, inductance, back_emf, voltage_error, inertia, torque_error })
    }

    /// Shares of voltage and current that stay unexplained.
    pub const fn left(&self) -> [f64; 2] {
        [self.voltage_error, self.torque_error]
    }

    /// Both errors as one number.
    pub fn error(&self) -> f64 {
        self.voltage_error.hypot(self.torque_error)
    }

    /// Every coefficient has its physical sign, for certain.
    pub fn is_physical(&self) -> bool {
        self.resistance.is_positive()
            && self.back_emf.is_positive()
            && self.inertia.is_positive()
            && !self.inductance.is_negative()
    }

    /// The first coefficient that has the wrong sign for certain.
    pub fn impossible(&self) -> Option<(MotorKey, f64)> {
        let mut signed = [
            (MotorKey::Resistance, self.resistance),
            (MotorKey::BackEmf, self.back_emf),
            (MotorKey::Inertia, self.inertia),
        ]
        .into_iter();
        let (key, coefficient) = signed.find(|(_, coefficient)| coefficient.is_negative())?;
        Some((key, coefficient.value))
    }
}

/// Both balances of columns that stand side by side, each as it is, over windows of the run of the reference; `None` where they do
/// not determine a coefficient.
pub fn balances(time_s: &[f64], [voltage, current, speed]: [&[f64]; 3]) -> Option<Balances> {
    let windows = spread_windows(time_s, &RunScales::REFERENCE);
    let signs = [1.0; 2];
    Balances::of(&Roles { time_s, windows: &windows, voltage, current, speed, signs })
}

/// Coefficients of a linear regression and its relative error; `None` where the rows do not determine one.
fn fitted<const N: usize>(
    rows: impl Iterator<Item = ([f64; N], f64)>,
) -> Option<([Coefficient; N], f64)> {
    // Smallest share of a regressor that is independent of the others (tolerance).
    let fit = fit_normal(&rows.collect::<Vec<_>>(), 1e-4)?;
    let coefficient = |index| Coefficient { value: fit.x[index], std: fit.std[index] };
    Some((std::array::from_fn(coefficient), fit.error))
}

/// Residual of `u = R i + L di/dt`: root mean square over that of the voltage.
pub(super) fn voltage_at_rest(roles: &Roles<'_>) -> Option<f64> {
    let sums = sums(roles).into_iter();
    fitted(sums.map(|s| ([s.current, s.current_step], s.voltage))).map(|found| found.1)
}

/// Back-EMF constant from voltage and speed alone, neglecting the drop R i.
pub(super) fn back_emf_without_current(roles: &Roles<'_>) -> Option<Coefficient> {
    let turning = sums(roles).into_iter().filter(|s| s.direction != 0.0);
    let rows = turning.map(|s| ([s.angle, s.direction * s.length_s], s.voltage));
    fitted(rows).map(|([back_emf, _], _)| back_emf)
}

fn sums(roles: &Roles<'_>) -> Vec<Sums> {
    // Speeds below this have no direction.
    let zone = Settings::CLEAR * largest(roles.speed);
    let [current, speed] = roles.signs;
    let signed = |window: &Range<usize>| {
        let voltage = trapezoid(roles.time_s, roles.voltage, window);
        let sums = Sums::over(window, roles.time_s, voltage, [roles.current, roles.speed], zone);
        Sums {
            current: current * sums.current,
            current_step: current * sums.current_step,
            angle: speed * sums.angle,
            speed_step: speed * sums.speed_step,
            direction: speed * sums.direction,
            ..sums
        }
    };
    roles.windows.iter().map(signed).collect()
}
