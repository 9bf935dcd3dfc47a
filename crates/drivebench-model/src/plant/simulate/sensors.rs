//! Sensors of the simulated motion: delay, first-order filters and offsets, one after the other.

use std::collections::VecDeque;

use crate::plant::effect::Path;

/// One instant of the motion or of its reading.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reading {
    pub(super) time_s: f64,
    pub(super) current_a: f64,
    pub(super) speed_rad_s: f64,
}

/// Dead time and first-order filters, exact for motion that is linear between two sub-steps.
#[derive(Clone, Debug)]
pub(super) struct Sensors {
    path: Path,
    /// The motion of the last dead time.
    past: VecDeque<Reading>,
    /// The delayed motion, and the filters' outputs, at the latest instant.
    delayed: Reading,
    filtered: Reading,
    /// Integral of the filtered current since the last sample, A.s, and the time, s.
    since_sample: (f64, f64),
}

impl Sensors {
    /// Sensors in the steady state of `first`.
    pub(super) fn new(path: Path, first: Reading) -> Self {
        Self {
            path,
            past: VecDeque::from([first]),
            delayed: first,
            filtered: first,
            since_sample: (0.0, 0.0),
        }
    }

    pub(super) fn follow(&mut self, now: Reading) {
        let interval_s = now.time_s - self.delayed.time_s;
        if interval_s <= 0.0 {
            return;
        }
        let delayed = Reading { speed_rad_s: self.speed_before(now), ..now };
        let filtered = |of: fn(&Reading) -> f64, time_constant_s: f64| {
            let input = (of(&self.delayed), of(&delayed));
            filter(of(&self.filtered), input, interval_s, time_constant_s)
        };
        let before_a = self.filtered.current_a;
        self.filtered = Reading {
            time_s: now.time_s,
            current_a: filtered(|it| it.current_a, self.path.current_filter_s),
            speed_rad_s: filtered(|it| it.speed_rad_s, self.path.speed_filter_s),
        };
        self.delayed = delayed;
        let (integral, seconds) = &mut self.since_sample;
        *integral += 0.5 * interval_s * (before_a + self.filtered.current_a);
        *seconds += interval_s;
    }

    /// A sample was read.
    pub(super) const fn begin_mean(&mut self) {
        self.since_sample = (0.0, 0.0);
    }

    pub(super) fn read(&self) -> [f64; 2] {
        let (integral, seconds) = self.since_sample;
        let averages = self.path.averages_current && seconds > 0.0;
        let current_a = if averages { integral / seconds } else { self.filtered.current_a };
        [
            current_a + self.path.current_offset_a,
            self.filtered.speed_rad_s + self.path.speed_offset_rad_s,
        ]
    }

    /// Adds the correction of the motion to the states of delay and filters, so that the readings have the measured values at
    /// once: otherwise the same error would be corrected again at every sample. A change that is not finite is zero.
    pub(super) fn correct(&mut self, change_a: f64, change_rad_s: f64) {
        let past = self.past.iter_mut();
        for reading in past.chain([&mut self.delayed, &mut self.filtered]) {
            if change_a.is_finite() {
                reading.current_a += change_a;
            }
            if change_rad_s.is_finite() {
                reading.speed_rad_s += change_rad_s;
            }
        }
    }

    /// The speed one dead time before `now`, which is added to the past.
    fn speed_before(&mut self, now: Reading) -> f64 {
        if self.path.speed_delay_s <= 0.0 {
            return now.speed_rad_s;
        }
        self.past.push_back(now);
        let delayed_s = now.time_s - self.path.speed_delay_s;
        while self.past.len() > 2 && self.past[1].time_s <= delayed_s {
            self.past.pop_front();
        }
        let (before, after) = (self.past[0], self.past[1]);
        let share = ((delayed_s - before.time_s) / (after.time_s - before.time_s)).clamp(0.0, 1.0);
        before.speed_rad_s + share * (after.speed_rad_s - before.speed_rad_s)
    }
}

/// Output of a first-order filter after `interval_s`, its input on a straight line.
fn filter(output: f64, input: (f64, f64), interval_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s <= 0.0 {
        return input.1;
    }
    let slope = (input.1 - input.0) / interval_s;
    // Steady response to a ramp: the input less the velocity error.
    let lag = slope * time_constant_s;
    let decay = (-interval_s / time_constant_s).exp();
    input.1 - lag + (output - input.0 + lag) * decay
}

#[cfg(test)]
mod tests {
    use super::*;
    fn motion(time_s: f64) -> Reading {
        Reading {
            time_s,
            current_a: (9.0 * time_s).sin(),
            speed_rad_s: 40.0 * (7.0 * time_s).sin(),
        }
    }

    fn followed(path: Path, end_s: f64) -> [f64; 2] {
        let mut sensors = Sensors::new(path, motion(0.0));
        let mut time_s = 0.0;
        while time_s < end_s - 1e-9 {
            time_s += 5e-4;
            sensors.follow(motion(time_s));
        }
        sensors.read()
    }

    #[test]
    fn delays_offsets_and_filters_are_those_of_the_path() {
        let path = Path {
            speed_delay_s: 0.0123,
            current_offset_a: 0.2,
            speed_offset_rad_s: -1.0,
            ..Path::default()
        };
        let [current, speed] = followed(path, 0.4);
        assert!((current - motion(0.4).current_a - 0.2).abs() < 1e-9);
        assert!((speed + 1.0 - motion(0.4 - 0.0123).speed_rad_s).abs() < 2e-3);
        // Gain and phase of the first order.
        let tau = 3e-3;
        let path = Path { speed_filter_s: tau, current_filter_s: tau, ..Path::default() };
        let [current, speed] = followed(path, 1.0);
        let expected = |amplitude: f64, w: f64| {
            amplitude * (w - (w * tau).atan()).sin() / (1.0 + (w * tau).powi(2)).sqrt()
        };
        assert!((current - expected(1.0, 9.0)).abs() < 1e-5);
        assert!((speed - expected(40.0, 7.0)).abs() < 3e-4);
    }
}
