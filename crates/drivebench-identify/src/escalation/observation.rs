//! Observations of a stage: noise, peaks and motion, the winding at rest, and the turning motor by the output-error fit.

use serde::Serialize;

use super::{Bounds, KNOWN, relative};
use crate::belief;
use crate::noise::NoiseFloor;
use crate::{output_error, start};
use drivebench_model::numerics::statistics::{finite, largest, mean, mean_step, variance};
use drivebench_model::plant::{Model, Motor, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Run, Verdict};
use drivebench_model::signal::{held, pieces};
use drivebench_model::text::number::with_std;

/// Samples of which the mean is taken that counts as motion.
const AVERAGED: usize = 12;

#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    pub(super) noise_a: f64,
    pub(super) offset_a: f64,
    pub(super) motion_rad_s: f64,
    /// Commanded voltage of the largest magnitude, V, with its sign.
    pub(super) peak_v: f64,
    /// Farthest current and speed from their values at rest (medians of three samples), with their signs.
    pub(super) peak_current_a: f64,
    pub(super) peak_speed_rad_s: f64,
    /// Farthest mean of the speed over a dozen samples, rad/s: what decides whether the shaft turns.
    pub(super) mean_speed_rad_s: f64,
    /// Time for which at least nine tenths of the peak voltage were commanded, s.
    pub(super) peak_time_s: f64,
    /// Mean current while they were, A.
    pub(super) current_at_peak_a: f64,
    /// Mean measured voltage while they were, V, where the drive measures it.
    pub(super) measured_at_peak_v: Option<f64>,
    /// Samples before the shaft left its rest.
    pub(super) at_rest: usize,
    pub(super) break_away_current_a: f64,
    /// Means of voltage and current over the samples of that mean speed.
    pub(super) voltage_of_motion_v: f64,
    current_of_motion_a: f64,
}

impl Observation {
    pub(super) fn of(scenario: &Scenario, run: &Run, bounds: &Bounds) -> Self {
        let rest = scenario.leading_standstill();
        let rest_of = |values: &[f64]| finite(&values[rest.clone()]);
        let (current, speed) = (rest_of(&scenario.current_a), rest_of(&scenario.speed_rad_s));
        let noise = |values: &[f64], least: f64| match values.len() {
            0..5 => least,
            _ => variance(values).sqrt().max(least),
        };
        let offset = |values: &[f64]| if values.is_empty() { 0.0 } else { mean(values) };
        // A simulated or coarse sensor shows no noise.
        let noise_a = noise(&current, 1e-4 * bounds.rated_current_a);
        let noise_rad_s = noise(&speed, 1e-4 * bounds.speed_limit_rad_s);
        let (offset_a, offset_rad_s) = (offset(&current), offset(&speed));
        // The mean at rest is known from finitely many samples as well.
        let spread = (1.0 / AVERAGED as f64 + 1.0 / speed.len().max(1) as f64).sqrt();
        let motion_rad_s = (belief::Settings::CLEAR_STD * noise_rad_s * spread)
            .max(5e-4 * bounds.speed_limit_rad_s);
        let amps = medians(&scenario.current_a, offset_a);
        let speeds = medians(&scenario.speed_rad_s, offset_rad_s);
        let farthest = |values: &[f64]| {
            let further = |most: (usize, f64), next: (usize, f64)| {
                let is_further = next.1.abs() > most.1.abs();
                if is_further { next } else { most }
            };
            values.iter().copied().enumerate().fold((0, 0.0), further)
        };
        let peak_speed_rad_s = farthest(&speeds).1;
        let volts: Vec<f64> = scenario.events.iter().map(|event| event.1).collect();
        let peak_v = farthest(&volts).1;
        let volts = at_samples(&scenario.events, scenario);
        let on_top: Vec<usize> = (0..volts.len())
            .filter(|at| volts[*at] * peak_v.signum() >= 0.9 * peak_v.abs() && peak_v != 0.0)
            .collect();
        let top_mean = |values: &[f64]| {
            let selected = on_top.iter().filter_map(|at| values.get(*at).copied());
            let found = finite(&selected.collect::<Vec<f64>>());
            (!found.is_empty()).then(|| mean(&found))
        };
        let slow = means(&speeds);
        // Rest until the mean exceeds 0.6 of the threshold of motion, less the samples of that mean.
        let at_rest = slow.iter().position(|speed| speed.abs() > 0.6 * motion_rad_s);
        let at_rest = at_rest.map_or(speeds.len(), |at| at.saturating_sub(AVERAGED));
        let (at_mean, mean_speed_rad_s) = farthest(&slow);
        // Empty where the drive measures none.
        let points: Vec<(f64, f64)> = run.points(Channel::Voltage).collect();
        let measured = if points.is_empty() { Vec::new() } else { at_samples(&points, scenario) };
        Self {
            noise_a,
            offset_a,
            motion_rad_s,
            peak_v,
            peak_current_a: farthest(&amps).1,
            peak_speed_rad_s,
            mean_speed_rad_s,
            peak_time_s: on_top.len() as f64 * bounds.period_s,
            current_at_peak_a: top_mean(&amps).unwrap_or(0.0),
            measured_at_peak_v: top_mean(&measured),
            break_away_current_a: largest(&amps[..at_rest]),
            at_rest,
            voltage_of_motion_v: means(&volts).get(at_mean).copied().unwrap_or(0.0),
            current_of_motion_a: means(&amps).get(at_mean).copied().unwrap_or(0.0),
        }
    }

    /// `Ke = (u - R i)/w` where the mean speed was greatest, and its standard deviation, V.s/rad. Without a resistance the
    /// drop across it is left out, and counts as uncertainty.
    pub(super) fn back_emf(&self, rest: Option<RestWinding>) -> (f64, f64) {
        let (u, i) = (self.voltage_of_motion_v.abs(), self.current_of_motion_a.abs());
        let w = self.mean_speed_rad_s.abs().max(f64::MIN_POSITIVE);
        let speed_share = self.motion_rad_s / belief::Settings::CLEAR_STD / w;
        match rest {
            Some(rest) => {
                let value = ((u - rest.resistance_ohm * i) / w).max(0.1 * u / w);
                let std_v = (rest.resistance_ohm * self.noise_a).hypot(rest.std_ohm * i);
                (value, (std_v / w).hypot(speed_share * value))
            }
            None => (u / w, speed_share.max(0.2) * u / w),
        }
    }

    pub(super) fn moves(&self) -> bool {
        self.mean_speed_rad_s.abs() > self.motion_rad_s
    }

    pub(super) fn text(&self) -> String {
        let Self { peak_v, peak_current_a, mean_speed_rad_s, .. } = self;
        format!("{peak_v:.3} V, {peak_current_a:.3} A, {mean_speed_rad_s:.2} rad/s")
    }
}

/// Medians of three neighbours, without the offset, as a filter of single outliers.
fn medians(values: &[f64], offset: f64) -> Vec<f64> {
    (0..values.len())
        .map(|at| {
            let mut three = finite(&values[at.saturating_sub(1)..(at + 2).min(values.len())]);
            three.sort_by(f64::total_cmp);
            three.get(three.len() / 2).map_or(0.0, |value| value - offset)
        })
        .collect()
}

/// Means over the last dozen samples; the first ones over what there is.
fn means(values: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    (0..values.len())
        .map(|at| {
            sum += values[at];
            if at >= AVERAGED {
                sum -= values[at - AVERAGED];
            }
            sum / AVERAGED as f64
        })
        .collect()
}

/// The values that were held at the scenario's samples.
fn at_samples(points: &[(f64, f64)], scenario: &Scenario) -> Vec<f64> {
    scenario.sample_time_s.iter().map(|time_s| held(points, *time_s).unwrap_or(0.0)).collect()
}

// The winding of a shaft at rest: `u = R i + L di/dt`, nothing else.
//
// The current is proportional to the voltage behind a first-order lag L/R. The lag is searched on a grid, the
// conductance is then linear: the noise sits on the current alone, so there is no errors-in-variables bias.

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RestWinding {
    pub resistance_ohm: f64,
    /// Standard deviation, ohm; the lag that is not known is part of it.
    pub std_ohm: f64,
    /// L/R that fits best, s; roughly known from a ramp.
    pub time_constant_s: f64,
}

impl RestWinding {
    pub fn relative(&self) -> f64 {
        self.std_ohm / self.resistance_ohm
    }

    /// Three standard deviations below, never less than half.
    pub fn lowest_ohm(&self) -> f64 {
        (self.resistance_ohm - 3.0 * self.std_ohm).max(0.5 * self.resistance_ohm)
    }

    pub fn highest_ohm(&self) -> f64 {
        self.resistance_ohm + 3.0 * self.std_ohm
    }
}

pub(super) fn at_rest(scenario: &Scenario, observation: &Observation) -> Option<RestWinding> {
    let rows: Vec<usize> = (0..observation.at_rest.min(scenario.samples()))
        .filter(|at| scenario.current_a[*at].is_finite())
        .collect();
    if rows.len() < 15 {
        return None;
    }
    let amps = rows.iter().map(|at| scenario.current_a[*at]);
    let amps: Vec<f64> = amps.map(|current_a| current_a - observation.offset_a).collect();
    // 45 time constants from 0.1 ms to 0.2 s: from none to slower than any small machine.
    let ratio = (0.2_f64 / 1e-4).powf(1.0 / 44.0);
    let fits: Vec<(f64, f64, f64, f64)> = (0..45)
        .filter_map(|step| {
            let constant_s = 1e-4 * ratio.powi(step);
            let lagged = lagged(scenario, &rows, constant_s);
            let power: f64 = lagged.iter().map(|y| y * y).sum();
            if power <= 0.0 {
                return None;
            }
            let pairs = || lagged.iter().zip(&amps);
            let conductance = pairs().map(|(y, i)| y * i).sum::<f64>() / power;
            let squares: f64 = pairs().map(|(y, i)| (i - conductance * y).powi(2)).sum();
            Some((squares, constant_s, conductance, power))
        })
        .collect();
    let best = fits.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let degrees = (rows.len() - 2) as f64;
    let noise_a = (best.0 / degrees).sqrt().max(observation.noise_a);
    // The offset is a mean over at least 30 rows before the voltage: its error bends every row the same way.
    let sum: f64 = lagged(scenario, &rows, best.1).iter().sum();
    let offset = noise_a / 30_f64.sqrt() * sum / best.3;
    let std = (noise_a / best.3.sqrt()).hypot(offset);
    let conductance = best.2;
    if conductance < 5.0 * std {
        return None;
    }
    // The change of the resistance over the lags within the confidence region is part of its uncertainty.
    let spread = fits.iter().filter(|fit| fit.0 - best.0 < 4.0 * noise_a * noise_a && fit.2 > 0.0);
    let spread = spread.map(|fit| (fit.2 - conductance).abs()).fold(0.0, f64::max);
    let resistance_ohm = 1.0 / conductance;
    Some(RestWinding {
        resistance_ohm,
        std_ohm: resistance_ohm * std.hypot(0.5 * spread) / conductance,
        time_constant_s: best.1,
    })
}

/// The held voltage behind a first-order lag, at the rows: exact between events.
fn lagged(scenario: &Scenario, rows: &[usize], constant_s: f64) -> Vec<f64> {
    let (mut now_s, mut lag_v) = (scenario.sample_time_s[0], 0.0);
    let read = rows.iter().map(|row| {
        let until_s = scenario.sample_time_s[*row];
        for (length_s, volts) in pieces(&scenario.events, now_s, until_s) {
            lag_v += (volts - lag_v) * -(-length_s / constant_s).exp_m1();
        }
        now_s = until_s;
        lag_v
    });
    read.collect()
}

// The turning motor: five parameters by the output-error fit, and what follows from them for the next stage.

/// The motor estimated from one round of turning.
#[derive(Clone, Debug)]
pub(super) struct Turned {
    /// The fitted motor. An inductance or inertia that is not observable has the value of the fit; its verdict is in the
    /// parameters.
    pub(super) motor: Motor,
    pub(super) parameters: Vec<ParameterEstimate>,
    period_s: f64,
}

/// Keys that the next stage needs.
const NEEDED: [MotorKey; 2] = [MotorKey::Resistance, MotorKey::BackEmf];

pub(super) fn turned(scenario: &Scenario, rest: Option<RestWinding>) -> Result<Turned, String> {
    let noise =
        NoiseFloor::from_standstill(scenario).unwrap_or_else(|| NoiseFloor::from_spread(scenario));
    let unknown = Model::baseline(Motor::new("unknown"));
    let mut starts = vec![start::complete(&unknown, scenario).map_err(|error| error.to_string())?];
    if let Some(rest) = rest {
        let inductance_h = rest.resistance_ohm * rest.time_constant_s;
        let motor = Motor::new("unknown")
            .with(MotorKey::Resistance, rest.resistance_ohm)
            .with(MotorKey::Inductance, inductance_h);
        let partial = Model::baseline(motor);
        starts.extend(start::complete(&partial, scenario));
    }
    let fit = output_error::fit(&starts, scenario, &noise).map_err(|error| error.to_string())?;
    Ok(Turned {
        motor: fit.model.motor,
        parameters: fit.parameters,
        period_s: mean_step(&scenario.sample_time_s),
    })
}

impl Turned {
    /// Largest relative standard deviation of R and Ke, and of J where it leaves a trace between two samples; infinite where
    /// one is open.
    pub(super) fn worst(&self) -> f64 {
        let inertia_shows = self.mechanical_s().is_none_or(|constant_s| constant_s > self.period_s);
        NEEDED
            .into_iter()
            .chain(inertia_shows.then_some(MotorKey::Inertia))
            .map(|key| relative(&self.parameters, key).unwrap_or(f64::INFINITY))
            .fold(0.0, f64::max)
    }

    pub(super) fn mechanical_s(&self) -> Option<f64> {
        (self.motor.mechanical_time_constant_s()).filter(|constant_s| constant_s.is_finite())
    }

    /// Friction as the current that overcomes it, A.
    pub(super) fn friction_a(&self) -> Option<f64> {
        let friction = self.motor.get(MotorKey::LoadTorque)?;
        let share = relative(&self.parameters, MotorKey::LoadTorque)?;
        (share < 0.5).then_some(friction / self.motor.torque_constant()?)
    }

    /// The resistance as the turning motor shows it; `None` where it is hardly known.
    pub(super) fn resistance(&self) -> Option<RestWinding> {
        let share = relative(&self.parameters, MotorKey::Resistance)?;
        let resistance_ohm = self.motor.get(MotorKey::Resistance)?;
        (share < KNOWN).then_some(RestWinding {
            resistance_ohm,
            std_ohm: share * resistance_ohm,
            time_constant_s: self.motor.electrical_time_constant_s()?,
        })
    }

    /// Voltage that turns the unloaded shaft at this speed, V, with the back-EMF at its lower bound.
    pub(super) fn voltage_at(&self, speed_rad_s: f64) -> Option<f64> {
        let share = relative(&self.parameters, MotorKey::BackEmf)?;
        let value = self.motor.get(MotorKey::BackEmf)?;
        let friction_v = self.friction_a().unwrap_or(0.0) * self.motor.get(MotorKey::Resistance)?;
        (share < 0.3).then_some(value * (1.0 - 3.0 * share).max(0.5) * speed_rad_s + friction_v)
    }

    pub(super) fn text(&self) -> String {
        let of = |key: MotorKey| {
            let found = ParameterEstimate::find(&self.parameters, key.key());
            match found.and_then(|p| Some((p.value?, p.std?))) {
                Some((value, std)) => format!("{} {}", with_std(value, std), key.unit()),
                None => "unknown".to_owned(),
            }
        };
        let [r, l, ke, j, mc] = crate::belief::KEYS.map(of);
        format!("R {r}, L {l}, Ke {ke}, J {j}, Mc {mc}")
    }

    pub(super) fn worst_text(&self) -> String {
        let counts = |key: MotorKey| NEEDED.contains(&key) || key == MotorKey::Inertia;
        let worst = self.parameters.iter().find(|p| {
            MotorKey::from_key(&p.key).is_some_and(counts) && p.verdict != Verdict::Settled
        });
        let Some(p) = worst else { return "the estimates did not settle".to_owned() };
        format!("{}: {}", p.key, p.reason.as_deref().unwrap_or("not settled"))
    }
}
