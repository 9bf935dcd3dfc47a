//! What each equation lacks, window by window.
//!
//! With `e` the measurement less the model, restarted at the begin of the window, and `psi = (1 - s^2)^4` over it:
//! `v = -(L <e_i'> + R <e_i> + Ke <e_w>)` is the missing voltage, `m = Kt <e_i> - J <e_w'>` the missing torque, both
//! counted as losses like the terms of the catalogue. Where both move, but in opposite directions, the difference of their
//! known friction is taken out: a reversal that the model makes a moment too late is no missing torque. The derivative falls on `psi`, which vanishes at both ends.

use super::{ARITHMETIC, Equation, EquationBalance, LARGEST_NRES};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::{self, FitError};
use crate::numerics::count::whole;
use crate::plant::{Input, Model, MotorKey, Plant, Scenario};

/// Length of a window, s, and samples that half of it has at least.
const WINDOW_S: f64 = 0.048;
const FEWEST_HALF: usize = 3;
/// Speeds within this many standard deviations of the noise count as standstill, where friction is not determined...
const DEAD_DEVIATIONS: f64 = 4.0;
/// ...and, whatever the noise, those below this share of the largest.
const DEAD_SHARE: f64 = 0.002;
/// Share of a window at standstill above which it says nothing of the torque: friction takes what it must.
const LONGEST_REST: f64 = 0.1;

/// One window. What is not known is NaN.
pub(super) struct Window {
    pub begin: usize,
    pub time_s: f64,
    /// What the equations lack, and the standard deviation that noise alone gives to it.
    pub torque_n_m: f64,
    pub voltage_v: f64,
    pub torque_floor_n_m: f64,
    pub voltage_floor_v: f64,
    pub speed_rad_s: f64,
    /// Mean sign of the motion: what friction is multiplied with.
    pub direction: f64,
    pub current_a: f64,
    /// Mean of the input: V, A or N.m.
    pub input: f64,
    pub acceleration_rad_s2: f64,
    pub current_rate_a_s: f64,
    /// Mean rate of the input: its steps, weighted; V/s.
    pub input_rate: f64,
}

impl Window {
    pub(super) const fn error(&self, equation: Equation) -> f64 {
        match equation {
            Equation::Torque => self.torque_n_m,
            Equation::Voltage => self.voltage_v,
        }
    }

    pub(super) const fn floor(&self, equation: Equation) -> f64 {
        match equation {
            Equation::Torque => self.torque_floor_n_m,
            Equation::Voltage => self.voltage_floor_v,
        }
    }
}

/// All windows of a run, with what they were taken from.
pub(super) struct Windows<'a> {
    pub each: Vec<Window>,
    pub scenario: &'a Scenario,
    pub half: usize,
    pub dead_zone_rad_s: f64,
    /// Torque per ampere, or one where the torque itself is the input.
    pub torque_constant: f64,
}

/// Weights of one window: the test function and what stands for its derivative; both over the sum of the first.
#[derive(Default)]
pub(super) struct Weights {
    pub mean: Vec<f64>,
    pub rate: Vec<f64>,
}

fn psi(s: f64) -> f64 {
    let q = (1.0 - s * s).max(0.0);
    (q * q) * (q * q)
}

impl Weights {
    pub(super) fn fill(&mut self, times: &[f64]) {
        let last = times.len() - 1;
        let (middle_s, half_s) = (
            0.5 * (times[0] + times[last]),
            0.5 * (times[last] - times[0]),
        );
        self.mean.clear();
        self.rate.clear();
        let (mut total, mut before) = (0.0, 0.0);
        for k in 0..=last {
            let share = 0.5 * (times[(k + 1).min(last)] - times[k.saturating_sub(1)]);
            let value = share * psi((times[k] - middle_s) / half_s);
            // Summed by parts, so that a constant has no rate whatever the stamps are.
            let after = if k == last {
                0.0
            } else {
                psi((0.5 * (times[k] + times[k + 1]) - middle_s) / half_s)
            };
            self.mean.push(value);
            self.rate.push(before - after);
            before = after;
            total += value;
        }
        for weight in self.mean.iter_mut().chain(&mut self.rate) {
            *weight /= total;
        }
    }
}

fn dot(weights: &[f64], values: &[f64]) -> f64 {
    weights.iter().zip(values).map(|(w, v)| w * v).sum()
}

fn norm(weights: &[f64]) -> f64 {
    dot(weights, weights).sqrt()
}

impl<'a> Windows<'a> {
    pub(super) fn new(
        model: &Model,
        scenario: &'a Scenario,
        noise: &NoiseFloor,
    ) -> Result<Self, FitError> {
        let times = &scenario.sample_time_s;
        let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
        let half = whole((0.5 * WINDOW_S / period_s).round()).max(FEWEST_HALF);
        let prediction = output_error::predict(model, scenario, noise)?;
        let model = &prediction.model;
        let fastest = scenario
            .speed_rad_s
            .iter()
            .filter(|w| w.is_finite())
            .fold(0.0, |most: f64, w| most.max(w.abs()));
        let known =
            |level: f64| (noise.source != FloorSource::None && level.is_finite()).then_some(level);
        let dead_zone_rad_s = known(noise.speed_rad_s)
            .map_or(0.01 * fastest, |level| DEAD_DEVIATIONS * level)
            .max(DEAD_SHARE * fastest);
        let torque_constant = match scenario.input {
            Input::Torque => 1.0,
            _ => model.motor.torque_constant().unwrap_or(f64::NAN),
        };
        let mut found = Self {
            each: Vec::new(),
            scenario,
            half,
            dead_zone_rad_s,
            torque_constant,
        };
        let mut plant = Plant::new(model, scenario.input)?;
        let mut weights = Weights::default();
        let constants = Constants {
            resistance: model.motor.get(MotorKey::Resistance).unwrap_or(f64::NAN),
            inductance: model.motor.get(MotorKey::Inductance).unwrap_or(f64::NAN),
            back_emf: model.motor.get(MotorKey::BackEmf).unwrap_or(f64::NAN),
            load: model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0),
            inertia: model.motor.get(MotorKey::Inertia).unwrap_or(f64::NAN),
            torque: torque_constant,
            current_noise: known(noise.current_a).unwrap_or(0.0),
            speed_noise: known(noise.speed_rad_s).unwrap_or(0.0),
        };
        // Half of the windows begin in the middle of the others.
        for first in [0, half] {
            let ahead = plant.predict_ahead_from(scenario, prediction.start, 2 * half, first);
            let mut event = 0;
            for begin in (first..scenario.samples().saturating_sub(2 * half)).step_by(2 * half) {
                if !scenario.scored.contains(&begin) {
                    continue;
                }
                let range = begin..=begin + 2 * half;
                weights.fill(&times[range.clone()]);
                while event + 1 < scenario.events.len()
                    && scenario.events[event + 1].0 <= times[begin]
                {
                    event += 1;
                }
                found.each.push(window(
                    scenario,
                    begin,
                    &weights,
                    [&ahead.current_a[range.clone()], &ahead.speed_rad_s[range]],
                    &constants,
                    &scenario.events[event..],
                    dead_zone_rad_s,
                ));
            }
        }
        found.each.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(found)
    }

    /// Takes the errors of another run of the same excitation out of this one's, window by window since their first
    /// commands; what has no window there is not known.
    pub(super) fn subtract(&mut self, other: &Windows<'_>) {
        let begins_later_s = other.scenario.events[0].0 - self.scenario.events[0].0;
        let near_s = 0.5 * self.length_s();
        for window in &mut self.each {
            let time_s = window.time_s + begins_later_s;
            let after = other.each.partition_point(|there| there.time_s < time_s);
            let around = [after.checked_sub(1), Some(after)];
            let around = around.into_iter().flatten();
            let nearest = around
                .filter_map(|index| other.each.get(index))
                .min_by(|a, b| {
                    let (a, b) = (a.time_s - time_s, b.time_s - time_s);
                    a.abs().total_cmp(&b.abs())
                })
                .filter(|there| (there.time_s - time_s).abs() < near_s);
            let Some(there) = nearest else {
                (window.torque_n_m, window.voltage_v) = (f64::NAN, f64::NAN);
                continue;
            };
            window.torque_n_m -= there.torque_n_m;
            window.voltage_v -= there.voltage_v;
            window.torque_floor_n_m = window.torque_floor_n_m.hypot(there.torque_floor_n_m);
            window.voltage_floor_v = window.voltage_floor_v.hypot(there.voltage_floor_v);
        }
    }

    pub(super) fn length_s(&self) -> f64 {
        let times = &self.scenario.sample_time_s;
        let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
        2.0 * self.half as f64 * period_s
    }

    /// Windows whose error is known.
    pub(super) fn of(&self, equation: Equation) -> impl Iterator<Item = &Window> {
        self.each
            .iter()
            .filter(move |window| window.error(equation).is_finite())
    }

    pub(super) fn usable(&self, equation: Equation) -> usize {
        self.of(equation).count()
    }

    /// Says which signal is missing, if without it neither balance can be asked.
    pub(super) fn too_few_signals(&self, notes: &mut Vec<String>) -> bool {
        let has = |values: &[f64]| values.iter().any(|value| value.is_finite());
        let missing = if !has(&self.scenario.speed_rad_s) {
            "speed"
        } else if self.scenario.input == Input::Voltage && !has(&self.scenario.current_a) {
            "current"
        } else {
            return false;
        };
        notes.push(format!(
            "no {missing} was measured: what the voltage equation and what the torque equation lacks cannot be told apart"
        ));
        true
    }

    /// The error of one equation over the whole run.
    pub(super) fn balance(&self, equation: Equation, noise: &NoiseFloor) -> EquationBalance {
        let mut sums = Sums::default();
        for window in self.of(equation) {
            let (error, floor) = (window.error(equation), window.floor(equation));
            let drive = match (equation, self.scenario.input) {
                (Equation::Torque, Input::Voltage) => self.torque_constant * window.current_a,
                (Equation::Torque, _) => self.torque_constant * window.input,
                (Equation::Voltage, _) => window.input,
            };
            sums.windows += 1;
            sums.power += error * error;
            sums.noise += floor * floor;
            sums.drive += drive * drive;
            if window.speed_rad_s.abs() > self.dead_zone_rad_s {
                let forward = usize::from(window.speed_rad_s > 0.0);
                sums.turning[forward] += 1;
                sums.turning_power[forward] += error * error - floor * floor;
            }
        }
        let n = sums.windows as f64;
        let rms = (sums.power / n).sqrt();
        let relative = rms / (sums.drive / n).sqrt().max(f64::MIN_POSITIVE);
        let nres = (sums.noise > 0.0).then(|| (sums.power / sums.noise).sqrt());
        let [reverse, forward] = sums.turning_power.map(|power| power.max(0.0));
        let [turned_back, turned] = sums.turning.map(|count| count as f64);
        let whole_power = forward + reverse;
        let fails =
            relative > ARITHMETIC && nres.is_none_or(|nres| nres > noise.tolerance(LARGEST_NRES));
        EquationBalance {
            equation: equation.name(),
            unit: equation.unit(),
            nres,
            nres_refitted: None,
            own_changes: Vec::new(),
            rms,
            relative,
            share_of_error: None,
            forward_share_of_error: (whole_power > 0.0).then(|| forward / whole_power),
            forward_share_of_time: (turned + turned_back > 0.0)
                .then(|| turned / (turned + turned_back)),
            windows: sums.windows,
            refitted: false,
            fails,
            sentence: String::new(),
        }
    }
}

#[derive(Default)]
struct Sums {
    windows: usize,
    power: f64,
    noise: f64,
    drive: f64,
    /// Backward, forward.
    turning: [usize; 2],
    turning_power: [f64; 2],
}

struct Constants {
    resistance: f64,
    inductance: f64,
    back_emf: f64,
    inertia: f64,
    load: f64,
    /// Of the torque, N.m/A.
    torque: f64,
    current_noise: f64,
    speed_noise: f64,
}

fn window(
    scenario: &Scenario,
    begin: usize,
    weights: &Weights,
    [current, speed]: [&[f64]; 2],
    constants: &Constants,
    events: &[(f64, f64)],
    dead_zone_rad_s: f64,
) -> Window {
    let end = begin + current.len();
    let times = &scenario.sample_time_s[begin..end];
    let (measured_i, measured_w) = (
        &scenario.current_a[begin..end],
        &scenario.speed_rad_s[begin..end],
    );
    let c = constants;
    let (mut e_i, mut e_i_rate, mut e_w, mut e_w_rate) = (0.0, 0.0, 0.0, 0.0);
    let (mut opposite, mut direction) = (0.0, 0.0);
    for k in 0..times.len() {
        let (error_i, error_w) = (measured_i[k] - current[k], measured_w[k] - speed[k]);
        e_i += weights.mean[k] * error_i;
        e_i_rate += weights.rate[k] * error_i;
        e_w += weights.mean[k] * error_w;
        e_w_rate += weights.rate[k] * error_w;
        if measured_w[k].abs() > dead_zone_rad_s {
            direction += weights.mean[k] * measured_w[k].signum();
            if measured_w[k] * speed[k] < 0.0 {
                opposite += weights.mean[k] * 2.0 * measured_w[k].signum();
            }
        }
    }
    let (mean, rate) = (norm(&weights.mean), norm(&weights.rate));
    let at_rest: f64 = weights
        .mean
        .iter()
        .zip(measured_w)
        .filter(|(_, w)| w.abs() <= dead_zone_rad_s)
        .map(|(weight, _)| weight)
        .sum();
    // Under a current or a torque there is no error of the current.
    let torque = if scenario.input == Input::Voltage {
        c.torque * e_i
    } else {
        0.0
    };
    let (input, input_rate) = input_over(events, times);
    Window {
        begin,
        time_s: 0.5 * (times[0] + times[times.len() - 1]),
        torque_n_m: if at_rest > LONGEST_REST {
            f64::NAN
        } else {
            torque - c.inertia * e_w_rate - c.load * opposite
        },
        voltage_v: -(c.inductance * e_i_rate + c.resistance * e_i + c.back_emf * e_w),
        torque_floor_n_m: (c.inertia * c.speed_noise * rate).hypot(
            if scenario.input == Input::Voltage {
                c.torque * c.current_noise * mean
            } else {
                0.0
            },
        ),
        voltage_floor_v: (c.resistance * c.current_noise * mean)
            .hypot(c.back_emf * c.speed_noise * mean)
            .hypot(c.inductance * c.current_noise * rate),
        speed_rad_s: dot(&weights.mean, measured_w),
        direction,
        current_a: dot(&weights.mean, measured_i),
        input,
        acceleration_rad_s2: dot(&weights.rate, measured_w),
        current_rate_a_s: dot(&weights.rate, measured_i),
        input_rate,
    }
}

/// Weighted mean of the held input, and of its rate: the sum of its steps, each with the test function where it falls.
fn input_over(events: &[(f64, f64)], times: &[f64]) -> (f64, f64) {
    let last = times.len() - 1;
    let (middle_s, half_s) = (
        0.5 * (times[0] + times[last]),
        0.5 * (times[last] - times[0]),
    );
    let s = |time_s: f64| ((time_s - middle_s) / half_s).clamp(-1.0, 1.0);
    // Integral of (1 - s^2)^4 from zero, and over the whole window.
    let area = |s: f64| {
        let q = s * s;
        s * (1.0 + q * (-4.0 / 3.0 + q * (6.0 / 5.0 + q * (-4.0 / 7.0 + q / 9.0))))
    };
    let whole = 2.0 * area(1.0);
    let (mut mean, mut rate) = (0.0, 0.0);
    for (index, event) in events.iter().enumerate() {
        if event.0 >= times[last] {
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
