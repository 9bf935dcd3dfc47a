//! Residual of each balance, window by window.
//!
//! With `e` the measurement less the model, restarted at the begin of the window, and `psi = (1 - s^2)^4` over it:
//! `v = -(L <e_i'> + R <e_i> + Ke <e_w>)` is the missing voltage, `m = Kt <e_i> - J <e_w'>` the missing torque, both
//! counted as losses like the terms of the catalogue. Where both move, but in opposite directions, the difference of their
//! known friction is taken out: a delayed reversal of the model is no missing torque. The derivative
//! falls on `psi`, which vanishes at both ends.

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};

use super::EquationBalance;
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error::{self, FitError};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Balance, Input, Model, MotorKey, Plant, Scenario};
use drivebench_model::signal;

/// Thresholds of the windows and of the errors of their balances.
struct Settings {
    /// Length of a window, in times of response.
    window_responses: f64,
    /// Speeds within this many standard deviations of the noise count as standstill, where friction is not determined.
    dead_zone_sigmas: f64,
    /// Or below this share of the largest speed.
    dead_zone_share: f64,
    /// The same where the noise is not known.
    dead_zone_share_without_noise: f64,
    /// Share of a window at standstill above which it has no torque balance: static friction is undetermined.
    longest_rest_share: f64,
    /// A balance within this multiple of the noise does not fail.
    largest_nres: f64,
    /// Without a known noise: share of the drive below which an error is rounding.
    arithmetic_share: f64,
    /// Passes of reweighting that bring least squares to least absolute values.
    passes: usize,
    /// Share of the mean absolute error within which an error counts as a square (Huber): else a window of zero error would weigh
    /// as much as all others together.
    soft_share: f64,
    /// Windows that each parameter needs.
    windows_each: f64,
}

const SETTINGS: Settings = Settings {
    window_responses: 1.2,
    dead_zone_sigmas: 4.0,
    dead_zone_share: 0.002,
    dead_zone_share_without_noise: 0.01,
    longest_rest_share: 0.1,
    largest_nres: 1.15,
    arithmetic_share: 1e-4,
    passes: 12,
    soft_share: 0.05,
    windows_each: 3.0,
};

/// Samples that half a window has at least.
pub(super) const FEWEST_HALF: usize = 3;

/// One window. What is not known is NaN.
pub(super) struct Window {
    begin: usize,
    pub time_s: f64,
    /// Error of voltage and torque equation, V and N.m, and its standard deviation by noise.
    lacks: [f64; 2],
    floor: [f64; 2],
    pub speed_rad_s: f64,
    /// Mean sign of the motion: what friction is multiplied with.
    pub direction: f64,
    pub current_a: f64,
    /// Mean of the input (V, A or N.m), and mean rate of it: its steps, weighted.
    input: f64,
    pub input_rate: f64,
    acceleration_rad_s2: f64,
    current_rate_a_s: f64,
}

impl Window {
    pub(super) const fn error(&self, equation: Balance) -> f64 {
        self.lacks[equation as usize]
    }

    pub(super) const fn floor(&self, equation: Balance) -> f64 {
        self.floor[equation as usize]
    }

    /// Square of the error beyond the noise.
    pub(super) fn beyond(&self, equation: Balance) -> f64 {
        self.error(equation).powi(2) - self.floor(equation).powi(2)
    }

    /// Columns of the equation's own parameters, [`own_keys`] of them. Losses: a resistance that is 1 ohm too low in the
    /// model leaves `+i`; an inertia that is too low, `+dw/dt`.
    pub(super) const fn own(&self, equation: Balance) -> [f64; 3] {
        match equation {
            Balance::Voltage => [self.current_a, self.current_rate_a_s, self.speed_rad_s],
            Balance::Torque => [self.acceleration_rad_s2, self.direction, 0.0],
        }
    }
}

/// The motor's parameters in each equation.
pub(super) const fn own_keys(equation: Balance) -> &'static [MotorKey] {
    match equation {
        Balance::Voltage => &[MotorKey::Resistance, MotorKey::Inductance, MotorKey::BackEmf],
        Balance::Torque => &[MotorKey::Inertia, MotorKey::LoadTorque],
    }
}

/// All windows of a run, with the run and its model.
pub(super) struct Windows<'a> {
    pub each: Vec<Window>,
    pub scenario: &'a Scenario,
    half: usize,
    pub period_s: f64,
    pub dead_zone_rad_s: f64,
    /// Torque per ampere, or one where the torque itself is the input.
    torque_constant: f64,
}

/// Weights of one window: the test function and its derivative by differences; both over the sum of the first.
pub(super) struct Weights {
    pub mean: Vec<f64>,
    rate: Vec<f64>,
}

/// Standard deviation of a weighted sum of first-order noise of deviation one: the autocorrelation at a lag is the memory to the
/// power of it.
fn deviation(weights: &[f64], memory: f64) -> f64 {
    let (mut before, mut variance) = (0.0, 0.0);
    for weight in weights {
        variance += weight * (weight + 2.0 * memory * before);
        before = weight + memory * before;
    }
    variance.max(0.0).sqrt()
}

fn psi(s: f64) -> f64 {
    let q = (1.0 - s * s).max(0.0);
    (q * q) * (q * q)
}

/// Middle and half of the length of a window, s.
fn middle_and_half_s(times: &[f64]) -> (f64, f64) {
    let (first, last) = (times[0], times[times.len() - 1]);
    (0.5 * (first + last), 0.5 * (last - first))
}

impl Weights {
    fn over(times: &[f64]) -> Self {
        let last = times.len() - 1;
        let (middle_s, half_s) = middle_and_half_s(times);
        let (mut mean, mut rate) = (Vec::with_capacity(last + 1), Vec::with_capacity(last + 1));
        let (mut total, mut before) = (0.0, 0.0);
        for k in 0..=last {
            let share = 0.5 * (times[(k + 1).min(last)] - times[k.saturating_sub(1)]);
            let value = share * psi((times[k] - middle_s) / half_s);
            // Summed by parts, so that a constant has no rate whatever the stamps are.
            let next_s = times.get(k + 1).map(|next_s| 0.5 * (times[k] + next_s));
            let after = next_s.map_or(0.0, |next_s| psi((next_s - middle_s) / half_s));
            mean.push(value);
            rate.push(before - after);
            before = after;
            total += value;
        }
        for weight in mean.iter_mut().chain(&mut rate) {
            *weight /= total;
        }
        Self { mean, rate }
    }
}

fn dot(weights: &[f64], values: &[f64]) -> f64 {
    weights.iter().zip(values).map(|(w, v)| w * v).sum()
}

impl<'a> Windows<'a> {
    pub(super) fn new(
        model: &Model,
        scenario: &'a Scenario,
        noise: &NoiseFloor,
        fewest_half: usize,
    ) -> Result<Self, FitError> {
        Self::up_to(f64::INFINITY, model, scenario, noise, fewest_half)
    }

    /// Windows no longer than `most_s`.
    pub(super) fn up_to(
        most_s: f64,
        model: &Model,
        scenario: &'a Scenario,
        noise: &NoiseFloor,
        fewest_half: usize,
    ) -> Result<Self, FitError> {
        let times = &scenario.sample_time_s;
        let period_s = scenario.mean_period_s();
        let window_s = scenario.scales.responses(SETTINGS.window_responses).min(most_s);
        let half = whole((0.5 * window_s / period_s).round()).max(fewest_half);
        let prediction = output_error::predict(model, scenario, noise)?;
        let model = &prediction.model;
        let fastest = largest(scenario.speed_rad_s.iter().copied());
        let known =
            |level: f64| (noise.source != FloorSource::None && level.is_finite()).then_some(level);
        let by_noise = known(noise.speed_rad_s).map(|level| SETTINGS.dead_zone_sigmas * level);
        let dead_zone_rad_s = by_noise
            .unwrap_or(SETTINGS.dead_zone_share_without_noise * fastest)
            .max(SETTINGS.dead_zone_share * fastest);
        let torque_constant = match scenario.input {
            Input::Torque => 1.0,
            _ => model.motor.torque_constant().unwrap_or(f64::NAN),
        };
        let mut found =
            Self { each: Vec::new(), scenario, half, period_s, dead_zone_rad_s, torque_constant };
        let mut plant = Plant::new(model, scenario.input)?;
        let levels = [noise.current_a, noise.speed_rad_s].map(|level| known(level).unwrap_or(0.0));
        // Half of the windows begin in the middle of the others.
        for first in [0, half] {
            let ahead = plant.predict_ahead(scenario, prediction.start, 2 * half, first);
            let begins = (first..scenario.samples().saturating_sub(2 * half)).step_by(2 * half);
            for begin in begins.filter(|begin| scenario.scored.contains(begin)) {
                let range = begin..=begin + 2 * half;
                let predicted = [&ahead.current_a[range.clone()], &ahead.speed_rad_s[range]];
                let events = signal::holding_since(&scenario.events, times[begin]);
                let window = found.window(begin, model, predicted, levels, noise.memory, events);
                found.each.push(window);
            }
        }
        found.each.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(found)
    }

    fn window(
        &self,
        begin: usize,
        model: &Model,
        [current, speed]: [&[f64]; 2],
        [current_noise, speed_noise]: [f64; 2],
        [current_memory, speed_memory]: [f64; 2],
        events: &[(f64, f64)],
    ) -> Window {
        let range = begin..begin + current.len();
        let times = &self.scenario.sample_time_s[range.clone()];
        let measured_i = &self.scenario.current_a[range.clone()];
        let measured_w = &self.scenario.speed_rad_s[range];
        let value = |key| model.motor.get(key).unwrap_or(f64::NAN);
        let (resistance, inductance) = (value(MotorKey::Resistance), value(MotorKey::Inductance));
        let (back_emf, inertia) = (value(MotorKey::BackEmf), value(MotorKey::Inertia));
        let load = model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0);
        let weights = Weights::over(times);
        // Mean of the error of a signal, and of its rate.
        let error = |measured: &[f64], predicted: &[f64]| {
            let pairs = measured.iter().zip(predicted);
            let errors: Vec<f64> = pairs.map(|(own, other)| own - other).collect();
            [dot(&weights.mean, &errors), dot(&weights.rate, &errors)]
        };
        let ([e_i, e_i_rate], [e_w, e_w_rate]) =
            (error(measured_i, current), error(measured_w, speed));
        let (mut opposite, mut direction, mut at_rest) = (0.0, 0.0, 0.0);
        for ((own, other), mean) in measured_w.iter().zip(speed).zip(&weights.mean) {
            if own.abs() > self.dead_zone_rad_s {
                direction += mean * own.signum();
                opposite += if own * other < 0.0 { 2.0 * mean * own.signum() } else { 0.0 };
            } else if own.abs() <= self.dead_zone_rad_s {
                at_rest += mean;
            }
        }
        // Under a current or a torque there is no error of the current.
        let by_voltage = self.scenario.input == Input::Voltage;
        let if_driven = |torque: f64| if by_voltage { torque } else { 0.0 };
        let torque = if_driven(self.torque_constant * e_i) - inertia * e_w_rate - load * opposite;
        let voltage = -(inductance * e_i_rate + resistance * e_i + back_emf * e_w);
        let of = |noise: f64, memory: f64| {
            [&weights.mean, &weights.rate].map(|own| noise * deviation(own, memory))
        };
        let [current_mean, current_rate] = of(current_noise, current_memory);
        let [speed_mean, speed_rate] = of(speed_noise, speed_memory);
        let torque_floor =
            (inertia * speed_rate).hypot(if_driven(self.torque_constant * current_mean));
        let voltage_floor = (resistance * current_mean)
            .hypot(back_emf * speed_mean)
            .hypot(inductance * current_rate);
        let (input, input_rate) = input_over(events, times);
        let is_resting = at_rest > SETTINGS.longest_rest_share;
        Window {
            begin,
            time_s: middle_and_half_s(times).0,
            lacks: [voltage, if is_resting { f64::NAN } else { torque }],
            floor: [voltage_floor, torque_floor],
            speed_rad_s: dot(&weights.mean, measured_w),
            direction,
            current_a: dot(&weights.mean, measured_i),
            input,
            input_rate,
            acceleration_rad_s2: dot(&weights.rate, measured_w),
            current_rate_a_s: dot(&weights.rate, measured_i),
        }
    }

    /// Takes the errors of another run of the same excitation out of this one's, window by window since their first
    /// commands; a window without its counterpart is not known.
    pub(super) fn subtract(&mut self, other: &Windows<'_>) {
        let begins_later_s = other.scenario.events[0].0 - self.scenario.events[0].0;
        let near_s = 0.5 * self.length_s();
        for window in &mut self.each {
            let time_s = window.time_s + begins_later_s;
            let apart_s = |there: &&Window| (there.time_s - time_s).abs();
            let after = other.each.partition_point(|there| there.time_s < time_s);
            let around = other.each[after.saturating_sub(1)..].iter().take(2);
            let nearest = around.min_by(|a, b| apart_s(a).total_cmp(&apart_s(b)));
            let Some(there) = nearest.filter(|there| apart_s(there) < near_s) else {
                window.lacks = [f64::NAN; 2];
                continue;
            };
            for k in 0..2 {
                window.lacks[k] -= there.lacks[k];
                window.floor[k] = window.floor[k].hypot(there.floor[k]);
            }
        }
    }

    pub(super) fn length_s(&self) -> f64 {
        2.0 * self.half as f64 * self.period_s
    }

    pub(super) const fn samples_of(&self, window: &Window) -> RangeInclusive<usize> {
        window.begin..=window.begin + 2 * self.half
    }

    pub(super) fn weights_of(&self, window: &Window) -> Weights {
        Weights::over(&self.scenario.sample_time_s[self.samples_of(window)])
    }

    /// Angle of the shaft at every sample; the end values hold beyond those of the angle.
    pub(super) fn angle_at_samples(&self) -> Option<Vec<f64>> {
        let points = self.scenario.shaft_angle();
        let at = |time_s: &f64| signal::line_with_ends(&points, *time_s);
        (points.len() > 1).then(|| self.scenario.sample_time_s.iter().map(at).collect())
    }

    /// Windows whose error is known.
    pub(super) fn of(&self, equation: Balance) -> impl Iterator<Item = &Window> {
        self.each.iter().filter(move |window| window.error(equation).is_finite())
    }

    /// Which signal is missing, if without it the run has neither balance.
    pub(super) fn missing_signal(&self) -> Option<&'static str> {
        let has = |values: &[f64]| values.iter().any(|value| value.is_finite());
        if !has(&self.scenario.speed_rad_s) {
            return Some("speed");
        }
        let needs_current = self.scenario.input == Input::Voltage;
        (needs_current && !has(&self.scenario.current_a)).then_some("current")
    }

    /// Squared error beyond the noise and windows while the shaft turned backward, and forward.
    pub(super) fn by_direction(&self, equation: Balance) -> [(f64, usize); 2] {
        let mut sides = [(0.0, 0); 2];
        for window in self.of(equation) {
            if window.speed_rad_s.abs() > self.dead_zone_rad_s {
                let (beyond, windows) = &mut sides[usize::from(window.speed_rad_s > 0.0)];
                *beyond += window.beyond(equation);
                *windows += 1;
            }
        }
        sides.map(|(beyond, windows)| (f64::max(beyond, 0.0), windows))
    }

    /// The error of one equation over the whole run.
    pub(super) fn balance(&self, equation: Balance, noise: &NoiseFloor) -> EquationBalance {
        let (mut windows, mut power, mut floor, mut drive) = (0_usize, 0.0, 0.0, 0.0);
        for window in self.of(equation) {
            let own_drive = match (equation, self.scenario.input) {
                (Balance::Torque, Input::Voltage) => self.torque_constant * window.current_a,
                (Balance::Torque, _) => self.torque_constant * window.input,
                (Balance::Voltage, _) => window.input,
            };
            windows += 1;
            power += window.error(equation).powi(2);
            floor += window.floor(equation).powi(2);
            drive += own_drive * own_drive;
        }
        let n = windows as f64;
        let rms = (power / n).sqrt();
        let relative = rms / (drive / n).sqrt().max(f64::MIN_POSITIVE);
        let nres = (floor > 0.0).then(|| (power / floor).sqrt());
        let sides = self.by_direction(equation);
        let forward_share = |[back, forward]: [f64; 2]| {
            let whole = forward + back;
            (whole > 0.0).then(|| forward / whole)
        };
        let is_above_noise = nres.is_none_or(|nres| nres > noise.tolerance(SETTINGS.largest_nres));
        EquationBalance {
            equation: equation.key(),
            unit: equation.unit(),
            nres,
            rms,
            relative,
            forward_share_of_error: forward_share(sides.map(|(beyond, _)| beyond)),
            forward_share_of_time: forward_share(sides.map(|(_, windows)| windows as f64)),
            windows,
            fails: relative > SETTINGS.arithmetic_share && is_above_noise,
            ..EquationBalance::default()
        }
    }
}

/// Weighted mean of the held input, and of its rate: the sum of its steps, each with the test function where it falls.
fn input_over(events: &[(f64, f64)], times: &[f64]) -> (f64, f64) {
    let (middle_s, half_s) = middle_and_half_s(times);
    let s = |time_s: f64| ((time_s - middle_s) / half_s).clamp(-1.0, 1.0);
    // Integral of (1 - s^2)^4 from zero, and over the whole window.
    let area = |s: f64| {
        let q = s * s;
        s * (1.0 + q * (-4.0 / 3.0 + q * (6.0 / 5.0 + q * (-4.0 / 7.0 + q / 9.0))))
    };
    let whole = 2.0 * area(1.0);
    let (mut mean, mut rate) = (0.0, 0.0);
    for (index, event) in events.iter().enumerate() {
        if event.0 >= times[times.len() - 1] {
            break;
        }
        let next_s = events.get(index + 1).map_or(f64::INFINITY, |next| next.0);
        mean += event.1 * (area(s(next_s)) - area(s(event.0))) / whole;
        if index > 0 {
            rate += (event.1 - events[index - 1].1) * psi(s(event.0)) / (whole * half_s);
        }
    }
    (mean, rate)
}

impl Windows<'_> {
    /// Takes those changes of the motor's own parameters out of a balance's error that explain most of it, by least absolute
    /// values: a fault in a part of the run then stays there, where least squares would spread it over all of it.
    /// `None` where the run does not determine them.
    pub(super) fn fit_own(&mut self, equation: Balance) -> Option<Vec<f64>> {
        let k = own_keys(equation).len();
        let used: Vec<&Window> = self.of(equation).collect();
        let n = used.len() as f64;
        let columns = DMatrix::from_fn(used.len(), k, |row, at| used[row].own(equation)[at]);
        let errors = DVector::from_fn(used.len(), |row, _| used[row].error(equation));
        let (mut weighted, mut change) = (columns.clone(), DVector::zeros(k));
        for _ in 0..SETTINGS.passes {
            let (inverse, _) = least_squares::inverse_of_normal(&weighted.tr_mul(&columns));
            change = inverse * weighted.tr_mul(&errors);
            let left = &errors - &columns * &change;
            let scale = left.lp_norm(1) / n;
            if !(scale > 0.0 && n >= SETTINGS.windows_each * k as f64) {
                return None;
            }
            for (row, window) in used.iter().enumerate() {
                // Huber: absolute values beyond the noise, squares within.
                let soft = window.floor(equation).max(SETTINGS.soft_share * scale);
                weighted.set_row(row, &(columns.row(row) / left[row].abs().max(soft)));
            }
        }
        let changes: Vec<f64> = change.iter().copied().collect();
        self.take_out(equation, &changes);
        Some(changes)
    }

    /// Takes the changes out of the balance's error.
    pub(super) fn take_out(&mut self, equation: Balance, changes: &[f64]) {
        for window in &mut self.each {
            let row = window.own(equation);
            let explained: f64 = row.iter().zip(changes).map(|(value, by)| value * by).sum();
            window.lacks[equation as usize] -= explained;
        }
    }
}
