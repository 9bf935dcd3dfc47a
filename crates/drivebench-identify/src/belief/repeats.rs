//! Runs of readings that are equal to the bit, and how many of them a working sensor gives by chance.
//!
//! The share `p` of repeats is taken at rest: it follows from noise, resolution and the rate at which the drive reads the
//! sensor. A run of `n` repeats has the probability `p^n`.

use super::Settings;

/// The readings of one sensor.
#[derive(Clone, Debug, Default)]
pub struct Repeats {
    last: Option<u64>,
    /// Length of the present run.
    run: usize,
    since_s: f64,
    /// Of it the repeats since the shaft was last at rest.
    moving_run: usize,
    /// Of it those at rest; they count once another reading shows that the sensor works.
    resting_run: usize,
    /// At rest: readings, repeats, and the longest run.
    rest: usize,
    rest_same: usize,
    rest_longest: usize,
}

impl Repeats {
    /// A new start keeps the share of repeats at rest.
    pub const fn begin(&mut self) {
        (self.run, self.moving_run, self.resting_run) = (0, 0, 0);
    }

    pub fn push(&mut self, time_s: f64, value: f64, at_rest: bool) {
        let bits = value.to_bits();
        let Some(before) = self.last.replace(bits) else {
            self.since_s = time_s;
            return;
        };
        if before == bits {
            self.run += 1;
            self.moving_run = if at_rest { 0 } else { self.moving_run + 1 };
            self.resting_run += usize::from(at_rest);
        } else {
            self.rest += self.resting_run + usize::from(at_rest);
            self.rest_same += self.resting_run;
            self.rest_longest = self.rest_longest.max(self.resting_run);
            self.begin();
            self.since_s = time_s;
        }
    }

    pub const fn run(&self) -> usize {
        self.run
    }

    pub const fn since_s(&self) -> f64 {
        self.since_s
    }

    /// Share of repeats at rest by Laplace's rule of succession, once it is known.
    fn share(&self) -> Option<f64> {
        let known = self.rest >= 3 && self.rest_same < self.rest;
        known.then(|| (self.rest_same + 1) as f64 / (self.rest + 2) as f64)
    }

    /// Least length of a run that is not by chance; `None`: no noise at rest.
    pub fn needed(&self) -> Option<f64> {
        let by_chance = 1e-9_f64.ln() / self.share()?.ln();
        let fewest = Settings::FEWEST_REPEATS.max(3 * self.rest_longest);
        Some(by_chance.max(fewest as f64))
    }

    /// A longer run than chance gives a sensor that was noisy at rest.
    pub fn is_stuck(&self) -> bool {
        let enough = self.needed().is_some_and(|n| self.run as f64 >= n);
        enough && self.moving_run >= Settings::FEWEST_REPEATS
    }

    /// As `is_stuck`, of a sensor with electrical noise: one that only follows the vibration of a shaft repeats more often at rest.
    pub fn is_silent(&self) -> bool {
        self.is_stuck() && self.share().is_some_and(|share| share <= 0.35)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor that was read at rest with these readings, then gives another one `repeats` times more.
    fn after(rest: &[f64], repeats: usize) -> Repeats {
        let mut sensor = Repeats::default();
        for (n, value) in rest.iter().enumerate() {
            sensor.push(n as f64, *value, true);
        }
        // The first of them is no repeat.
        for n in 0..=repeats {
            sensor.push(n as f64, 7.0, false);
        }
        sensor
    }

    #[test]
    fn a_sensor_that_freezes_at_rest_is_found() {
        let mut sensor = after(&[0.1, -0.2, 0.05, 0.3, -0.1], 0);
        for n in 0..40 {
            sensor.push(f64::from(n), 0.2, true);
        }
        assert!(!sensor.is_stuck(), "at rest the reading need not change");
        for n in 0..9 {
            sensor.push(f64::from(n), 0.2, false);
        }
        assert!(sensor.is_silent());
    }

    #[test]
    fn a_noisy_sensor_is_stuck_after_a_dozen_and_a_quiet_one_never() {
        let noisy = [0.1, -0.2, 0.05, 0.3, -0.1];
        assert!(!after(&noisy, 7).is_stuck());
        assert!(after(&noisy, 12).is_silent());
        assert!(!after(&[0.0; 50], 10_000).is_stuck());
    }

    #[test]
    fn a_sensor_read_every_fourth_cycle_needs_more_repeats() {
        let slow: Vec<f64> = (0..60).map(|n: u32| f64::from(n / 4)).collect();
        assert!(!after(&slow, 40).is_stuck());
        assert!(after(&slow, 90).is_stuck());
        assert!(!after(&slow, 90).is_silent(), "the shaft may have vibrated at rest");
    }
}
