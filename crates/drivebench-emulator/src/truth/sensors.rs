//! Sensors of the true machine: delay, filters, noise, offsets and quantisation.

use std::collections::VecDeque;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::Path;

/// Generator words kept for each tick; the four normal numbers of a tick use eight, seldom a few more.
const WORDS_PER_TICK: u128 = 64;

/// Standard deviation of the white Gaussian noise of each sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseConfig {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub bus_v: f64,
}

/// Smallest step of each sensor; 0: as fine as the registers carry.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QuantisationConfig {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
}

/// Electrical and mechanical quantities at one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
    pub bus_v: f64,
}

/// The sensors of one drive. Noise is a function of seed and tick only: it does not depend on how often is read.
#[derive(Clone, Debug)]
pub struct Sensors {
    noise: NoiseConfig,
    quantisation: QuantisationConfig,
    rng: ChaCha8Rng,
    path: Path,
    tick_s: f64,
    /// True speeds, the latest last, back to the one that is shown.
    past_rad_s: VecDeque<f64>,
    /// Behind delay and filters; `None` before the first tick.
    filtered: Option<SensorState>,
}

#[derive(Clone, Copy, Debug)]
struct SensorState {
    delayed_rad_s: f64,
    current_a: f64,
    filtered_a: f64,
    filtered_rad_s: f64,
}

impl Sensors {
    pub fn new(noise: NoiseConfig, quantisation: QuantisationConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Tolerances are drawn from stream 1, random loads from 3, mysteries from 4.
        rng.set_stream(2);
        Self {
            noise,
            quantisation,
            rng,
            path: Path::default(),
            tick_s: 0.0,
            past_rad_s: VecDeque::new(),
            filtered: None,
        }
    }

    /// The same sensors behind delay, filters and offsets, which follow the machine every `tick_s`.
    #[must_use]
    pub const fn behind(mut self, path: Path, tick_s: f64) -> Self {
        (self.path, self.tick_s) = (path, tick_s);
        self
    }

    /// A tick has passed and the machine is at `current_a` and `speed_rad_s`.
    pub fn follow(&mut self, current_a: f64, speed_rad_s: f64) {
        let delayed_rad_s = self.delayed(speed_rad_s);
        let before = self.filtered.unwrap_or(SensorState {
            delayed_rad_s,
            current_a,
            filtered_a: current_a,
            filtered_rad_s: delayed_rad_s,
        });
        let filter = |output: f64, from: f64, to: f64, time_constant_s: f64| {
            if time_constant_s <= 0.0 {
                return to;
            }
            // Towards the mean of the tick: exact to the second order of the tick.
            let kept = (-self.tick_s / time_constant_s).exp();
            kept * output + (1.0 - kept) * 0.5 * (from + to)
        };
        let Path { current_filter_s, speed_filter_s, .. } = self.path;
        let (from_a, from_rad_s) = (before.current_a, before.delayed_rad_s);
        let last_rad_s = before.filtered_rad_s;
        self.filtered = Some(SensorState {
            delayed_rad_s,
            current_a,
            filtered_a: filter(before.filtered_a, from_a, current_a, current_filter_s),
            filtered_rad_s: filter(last_rad_s, from_rad_s, delayed_rad_s, speed_filter_s),
        });
    }

    /// The speed one delay ago, between two ticks on a straight line; before the first tick it was as then.
    fn delayed(&mut self, speed_rad_s: f64) -> f64 {
        if self.path.speed_delay_s <= 0.0 {
            return speed_rad_s;
        }
        let ticks = self.path.speed_delay_s / self.tick_s;
        let (whole, part) = (ticks.floor(), ticks.fract());
        self.past_rad_s.push_back(speed_rad_s);
        // The two values about the wanted instant are the oldest ones.
        while self.past_rad_s.len() as f64 > whole + 2.0 {
            self.past_rad_s.pop_front();
        }
        let oldest = self.past_rad_s[0];
        if (self.past_rad_s.len() as f64) < whole + 2.0 {
            return oldest;
        }
        oldest + (1.0 - part) * (self.past_rad_s[1] - oldest)
    }

    /// What is read at `tick` when `truth` is the case.
    pub fn read(&mut self, tick: u64, truth: Reading) -> Reading {
        self.rng.set_word_pos(u128::from(tick) * WORDS_PER_TICK);
        let mut noisy = |value: f64, std: f64| {
            let normal: f64 = self.rng.sample(StandardNormal);
            value + std * normal
        };
        let voltage_v = noisy(truth.voltage_v, self.noise.voltage_v);
        let (current_a, speed_rad_s) =
            self.filtered.map_or((truth.current_a, truth.speed_rad_s), |before| {
                (before.filtered_a, before.filtered_rad_s)
            });
        let current_a = noisy(current_a + self.path.current_offset_a, self.noise.current_a);
        let speed_rad_s = noisy(speed_rad_s + self.path.speed_offset_rad_s, self.noise.speed_rad_s);
        let bus_v = noisy(truth.bus_v, self.noise.bus_v);
        Reading {
            voltage_v: quantised(voltage_v, self.quantisation.voltage_v),
            current_a: quantised(current_a, self.quantisation.current_a),
            speed_rad_s: quantised(speed_rad_s, self.quantisation.speed_rad_s),
            angle_rad: quantised(truth.angle_rad, self.quantisation.angle_rad),
            bus_v,
        }
    }
}

fn quantised(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensors(seed: u64) -> Sensors {
        let noise = NoiseConfig { voltage_v: 0.02, current_a: 0.03, speed_rad_s: 0.15, bus_v: 0.1 };
        Sensors::new(noise, QuantisationConfig::default(), seed)
    }

    #[test]
    fn noise_is_white_and_has_the_stated_size() {
        let mut sensors = sensors(5);
        let speeds: Vec<f64> =
            (0..20_000).map(|tick| sensors.read(tick, Reading::default()).speed_rad_s).collect();
        let n = speeds.len() as f64;
        let mean = speeds.iter().sum::<f64>() / n;
        let variance = speeds.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        let lag_one =
            speeds.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum::<f64>() / n;
        // Four standard errors of each statistic.
        assert!(mean.abs() < 4.0 * 0.15 / n.sqrt());
        assert!((variance / 0.0225 - 1.0).abs() < 4.0 * (2.0 / n).sqrt());
        assert!((lag_one / variance).abs() < 4.0 / n.sqrt());
    }

    #[test]
    fn noise_depends_on_seed_and_tick_and_on_nothing_else() {
        let mut often = sensors(5);
        for tick in 0..100 {
            often.read(tick, Reading::default());
        }
        let late = often.read(77, Reading::default());
        assert_eq!(late, sensors(5).read(77, Reading::default()));
        assert_ne!(late, sensors(6).read(77, Reading::default()));
    }

    #[test]
    fn a_sensor_reads_multiples_of_its_step() {
        let step = QuantisationConfig { current_a: 0.25, ..QuantisationConfig::default() };
        let truth = Reading { current_a: 1.13, speed_rad_s: 1.13, ..Reading::default() };
        let read = Sensors::new(NoiseConfig::default(), step, 0).read(0, truth);
        assert!((read.current_a - 1.25).abs() < 1e-12);
        assert!((read.speed_rad_s - 1.13).abs() < 1e-12);
    }
}
