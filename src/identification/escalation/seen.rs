//! What a stage shows before anything is fitted: noise, peaks, and whether the shaft left its rest.

use super::{Bounds, RestWinding};
use crate::numerics::statistics::{mean, variance};
use crate::plant::Scenario;
use crate::sample::{Channel, Run};

/// Noise that is assumed at least, in rated currents and speed limits: a simulated or coarse sensor shows none.
const LEAST_NOISE: f64 = 1e-4;
/// A mean speed counts as motion from so many of its standard deviations on, and from this share of the speed limit.
const MOTION_NOISE: f64 = 8.0;
const MOTION_SHARE: f64 = 5e-4;
/// Samples of which the mean is taken.
const MEAN_OF: usize = 12;

/// The plain sight of one stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    pub(super) noise_a: f64,
    pub(super) offset_a: f64,
    /// Speed that counts as motion, rad/s.
    pub(super) motion_rad_s: f64,
    /// Commanded voltage of the largest magnitude, V, with its sign.
    pub(super) peak_v: f64,
    /// Farthest current and speed from their values at rest (medians of three samples), with their signs.
    pub(super) peak_current_a: f64,
    pub(super) peak_speed_rad_s: f64,
    /// Farthest mean of the speed over a dozen samples, rad/s: what decides whether the shaft turns.
    pub(super) mean_speed_rad_s: f64,
    /// Time for which at least nine tenths of the peak voltage were asked for, s.
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

impl Seen {
    pub(super) fn of(scenario: &Scenario, run: &Run, bounds: &Bounds) -> Self {
        let rest = scenario.leading_standstill();
        let rest_of = |values: &[f64]| -> Vec<f64> {
            values[rest.clone()]
                .iter()
                .copied()
                .filter(|value| value.is_finite())
                .collect()
        };
        let (current, speed) = (rest_of(&scenario.current_a), rest_of(&scenario.speed_rad_s));
        let noise = |values: &[f64], least: f64| {
            if values.len() < 5 {
                least
            } else {
                variance(values).sqrt().max(least)
            }
        };
        let offset = |values: &[f64]| if values.is_empty() { 0.0 } else { mean(values) };
        let noise_a = noise(&current, LEAST_NOISE * bounds.rated_current_a);
        let noise_rad_s = noise(&speed, LEAST_NOISE * bounds.speed_limit_rad_s);
        let (offset_a, offset_rad_s) = (offset(&current), offset(&speed));
        // The mean at rest is known from finitely many samples as well.
        let spread = (1.0 / MEAN_OF as f64 + 1.0 / speed.len().max(1) as f64).sqrt();
        let motion_rad_s =
            (MOTION_NOISE * noise_rad_s * spread).max(MOTION_SHARE * bounds.speed_limit_rad_s);
        let amps = medians(&scenario.current_a, offset_a);
        let speeds = medians(&scenario.speed_rad_s, offset_rad_s);
        let farthest = |values: &[f64]| {
            values
                .iter()
                .copied()
                .enumerate()
                .fold((0, 0.0_f64), |most, (at, value)| {
                    if value.abs() > most.1.abs() {
                        (at, value)
                    } else {
                        most
                    }
                })
        };
        let peak_speed_rad_s = farthest(&speeds).1;
        let peak_v = scenario.events.iter().fold(0.0_f64, |most, event| {
            if event.1.abs() > most.abs() {
                event.1
            } else {
                most
            }
        });
        let volts: Vec<f64> = scenario
            .sample_time_s
            .iter()
            .map(|time_s| held(&scenario.events, *time_s))
            .collect();
        let on_top: Vec<usize> = (0..volts.len())
            .filter(|at| volts[*at] * peak_v.signum() >= 0.9 * peak_v.abs() && peak_v != 0.0)
            .collect();
        let step_s = bounds.period_s;
        let top_mean = |values: &[f64]| {
            let found: Vec<f64> = on_top
                .iter()
                .filter_map(|at| values.get(*at).copied().filter(|value| value.is_finite()))
                .collect();
            (!found.is_empty()).then(|| mean(&found))
        };
        let slow = means(&speeds);
        // What comes before half of what counts as motion, with the samples of that mean, is rest for sure.
        let at_rest = slow
            .iter()
            .position(|speed| speed.abs() > 0.6 * motion_rad_s)
            .map_or(speeds.len(), |at| at.saturating_sub(MEAN_OF));
        let (at_mean, mean_speed_rad_s) = farthest(&slow);
        let break_away_current_a = amps[..at_rest]
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()));
        let measured: Vec<f64> = measured_voltage(run, scenario);
        Self {
            noise_a,
            offset_a,
            motion_rad_s,
            peak_v,
            peak_current_a: farthest(&amps).1,
            peak_speed_rad_s,
            mean_speed_rad_s,
            peak_time_s: on_top.len() as f64 * step_s,
            current_at_peak_a: top_mean(&amps).unwrap_or(0.0),
            measured_at_peak_v: top_mean(&measured),
            at_rest,
            break_away_current_a,
            voltage_of_motion_v: means(&volts).get(at_mean).copied().unwrap_or(0.0),
            current_of_motion_a: means(&amps).get(at_mean).copied().unwrap_or(0.0),
        }
    }

    /// `Ke = (u - R i)/w` where the mean speed was greatest, and its standard deviation, V.s/rad. Without a resistance the
    /// drop across it is left out, and counts as uncertainty.
    pub(super) fn back_emf(&self, rest: Option<RestWinding>) -> (f64, f64) {
        let (u, i, w) = (
            self.voltage_of_motion_v.abs(),
            self.current_of_motion_a.abs(),
            self.mean_speed_rad_s.abs().max(f64::MIN_POSITIVE),
        );
        let speed_share = self.motion_rad_s / MOTION_NOISE / w;
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
        format!(
            "{:.3} V, {:.3} A, {:.2} rad/s",
            self.peak_v, self.peak_current_a, self.mean_speed_rad_s
        )
    }
}

/// The value that is held at `time_s`; the command that is applied at the instant of a sample came before it.
fn held(events: &[(f64, f64)], time_s: f64) -> f64 {
    events
        .partition_point(|event| event.0 <= time_s)
        .checked_sub(1)
        .map_or(0.0, |at| events[at].1)
}

/// Medians of three neighbours, without the offset: one wild sample is none.
fn medians(values: &[f64], offset: f64) -> Vec<f64> {
    (0..values.len())
        .map(|at| {
            let mut three: Vec<f64> = values[at.saturating_sub(1)..(at + 2).min(values.len())]
                .iter()
                .copied()
                .filter(|value| value.is_finite())
                .collect();
            three.sort_by(f64::total_cmp);
            three
                .get(three.len() / 2)
                .map_or(0.0, |value| value - offset)
        })
        .collect()
}

/// Means over the last dozen samples; the first ones over what there is.
fn means(values: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    (0..values.len())
        .map(|at| {
            sum += values[at];
            if at >= MEAN_OF {
                sum -= values[at - MEAN_OF];
            }
            sum / MEAN_OF as f64
        })
        .collect()
}

/// Measured voltage at the scenario's samples; empty where the drive measures none.
fn measured_voltage(run: &Run, scenario: &Scenario) -> Vec<f64> {
    let points: Vec<(f64, f64)> = run.points(Channel::Voltage).collect();
    if points.is_empty() {
        return Vec::new();
    }
    scenario
        .sample_time_s
        .iter()
        .map(|time_s| held(&points, *time_s))
        .collect()
}
