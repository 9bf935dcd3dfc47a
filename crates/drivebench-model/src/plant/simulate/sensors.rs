//! Sensors of a motion: delay, first-order filters and offsets, one after the other.

use std::array::from_fn;
use std::collections::VecDeque;

use crate::plant::effect::Path;

/// One instant of `N` motions or of their readings.
#[derive(Clone, Copy, Debug)]
pub struct Reading<const N: usize> {
    pub time_s: f64,
    pub current_a: [f64; N],
    pub speed_rad_s: [f64; N],
}

/// What a current does besides the straight line between the ends of an interval: `c (e^(-t/tau) - 1 + (1 - e^(-h/tau)) t/h)`.
#[derive(Clone, Copy, Debug)]
pub struct Transient<const N: usize> {
    pub size_a: [f64; N],
    pub time_constant_s: f64,
}

impl<const N: usize> Transient<N> {
    fn integral(&self, k: usize, interval_s: f64) -> f64 {
        let share = 1.0 - (-interval_s / self.time_constant_s).exp();
        self.size_a[k] * (self.time_constant_s * share - interval_s + 0.5 * interval_s * share)
    }

    /// Output of a filter that was at zero.
    fn filtered(&self, k: usize, interval_s: f64, filter_s: f64) -> f64 {
        let own_s = self.time_constant_s;
        let decays = [filter_s, own_s].map(|constant_s| (-interval_s / constant_s).exp());
        // At equal time constants the limit of the quotient of differences.
        let of_decay = if (filter_s - own_s).abs() > 1e-3 * filter_s {
            own_s / (own_s - filter_s) * (decays[1] - decays[0])
        } else {
            interval_s / filter_s * decays[0]
        };
        let of_step = 1.0 - decays[0];
        let of_ramp = 1.0 - filter_s / interval_s * of_step;
        self.size_a[k] * (of_decay - of_step + (1.0 - decays[1]) * of_ramp)
    }
}

/// Dead time and first-order filters of `N` motions side by side, exact for a speed that is linear between two instants and a
/// current that is linear besides a [`Transient`].
#[derive(Clone, Debug)]
pub struct Sensors<const N: usize> {
    path: Path,
    /// The motion of the last dead time.
    past: VecDeque<Reading<N>>,
    /// The delayed motion, and the filters' outputs, at the latest instant.
    delayed: Reading<N>,
    filtered: Reading<N>,
    /// Integral of the filtered current since the last sample, A.s, and the time, s.
    since_sample: ([f64; N], f64),
}

impl<const N: usize> Sensors<N> {
    /// Sensors in the steady state of `first`.
    pub fn new(path: Path, first: Reading<N>) -> Self {
        Self {
            path,
            past: VecDeque::from([first]),
            delayed: first,
            filtered: first,
            since_sample: ([0.0; N], 0.0),
        }
    }

    pub fn follow(&mut self, now: Reading<N>) {
        self.follow_with(now, None);
    }

    /// The same with a current that settles within the interval.
    pub fn follow_with(&mut self, now: Reading<N>, transient: Option<Transient<N>>) {
        let interval_s = now.time_s - self.delayed.time_s;
        if interval_s <= 0.0 {
            return;
        }
        let delayed = Reading { speed_rad_s: self.speed_before(now), ..now };
        let Path { current_filter_s, speed_filter_s, .. } = self.path;
        let before = (self.delayed.current_a, self.filtered.current_a);
        let (last, from) = (&self.filtered.speed_rad_s, &self.delayed.speed_rad_s);
        let ends = [from, &delayed.speed_rad_s];
        self.filtered = Reading {
            time_s: now.time_s,
            current_a: self.filtered_current(&delayed.current_a, interval_s, transient.as_ref()),
            speed_rad_s: filtered(last, ends, interval_s, speed_filter_s),
        };
        self.delayed = delayed;
        // The integral of a filter's output is that of its input less its change in units of the time constant.
        let (integral, seconds) = &mut self.since_sample;
        for (k, integral) in integral.iter_mut().enumerate() {
            let settles = transient.as_ref().map_or(0.0, |own| own.integral(k, interval_s));
            *integral += 0.5 * interval_s * (before.0[k] + delayed.current_a[k]) + settles
                - current_filter_s * (self.filtered.current_a[k] - before.1[k]);
        }
        *seconds += interval_s;
    }

    fn filtered_current(
        &self,
        to: &[f64; N],
        interval_s: f64,
        transient: Option<&Transient<N>>,
    ) -> [f64; N] {
        let filter_s = self.path.current_filter_s;
        let mut out =
            filtered(&self.filtered.current_a, [&self.delayed.current_a, to], interval_s, filter_s);
        if let Some(transient) = transient.filter(|_| filter_s > 0.0) {
            for (k, out) in out.iter_mut().enumerate() {
                *out += transient.filtered(k, interval_s, filter_s);
            }
        }
        out
    }

    /// A sample was read.
    pub const fn begin_mean(&mut self) {
        self.since_sample = ([0.0; N], 0.0);
    }

    /// Current, A, and speed, rad/s, as read.
    pub fn read(&self) -> [[f64; N]; 2] {
        let (integral, seconds) = self.since_sample;
        let averages = self.path.averages_current && seconds > 0.0;
        let current_a =
            if averages { integral.map(|sum| sum / seconds) } else { self.filtered.current_a };
        [
            current_a.map(|current_a| current_a + self.path.current_offset_a),
            self.filtered.speed_rad_s.map(|speed| speed + self.path.speed_offset_rad_s),
        ]
    }

    /// Adds the correction of the motion to the states of delay and filters, so that the readings have the measured values at
    /// once: otherwise the same error would be corrected again at every sample. A change that is not finite is zero.
    pub fn correct(&mut self, change_a: &[f64; N], change_rad_s: &[f64; N]) {
        let finite = |change: &[f64; N]| change.map(|it| if it.is_finite() { it } else { 0.0 });
        let (change_a, change_rad_s) = (finite(change_a), finite(change_rad_s));
        for reading in self.past.iter_mut().chain([&mut self.delayed, &mut self.filtered]) {
            for k in 0..N {
                reading.current_a[k] += change_a[k];
                reading.speed_rad_s[k] += change_rad_s[k];
            }
        }
    }

    /// The speed one dead time before `now`, which is added to the past.
    fn speed_before(&mut self, now: Reading<N>) -> [f64; N] {
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
        from_fn(|k| before.speed_rad_s[k] + share * (after.speed_rad_s[k] - before.speed_rad_s[k]))
    }
}

/// Outputs of first-order filters after `interval_s`, their inputs on straight lines.
fn filtered<const N: usize>(
    output: &[f64; N],
    [from, to]: [&[f64; N]; 2],
    interval_s: f64,
    time_constant_s: f64,
) -> [f64; N] {
    if time_constant_s <= 0.0 {
        return *to;
    }
    let (lags, decay) = (time_constant_s / interval_s, (-interval_s / time_constant_s).exp());
    from_fn(|k| {
        // Steady response to a ramp: the input less the velocity error.
        let lag = (to[k] - from[k]) * lags;
        to[k] - lag + (output[k] - from[k] + lag) * decay
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    fn motion(time_s: f64) -> Reading<1> {
        Reading {
            time_s,
            current_a: [(9.0 * time_s).sin()],
            speed_rad_s: [40.0 * (7.0 * time_s).sin()],
        }
    }

    fn followed(path: Path, end_s: f64) -> [f64; 2] {
        let mut sensors = Sensors::new(path, motion(0.0));
        let mut time_s = 0.0;
        while time_s < end_s - 1e-9 {
            time_s += 5e-4;
            sensors.follow(motion(time_s));
        }
        sensors.read().map(|[value]| value)
    }

    /// A current that settles within a step of 10 ms, in short steps and in one with its transient.
    #[test]
    fn a_transient_is_filtered_and_averaged_as_in_short_steps() {
        let (own_s, interval_s) = (1.3e-4, 1e-2);
        let at = |time_s: f64| Reading {
            time_s,
            current_a: [0.4 + 3.0 * time_s - 1.2 * (-time_s / own_s).exp()],
            speed_rad_s: [0.0],
        };
        // The last filter has the time constant of the current.
        for current_filter_s in [0.0, 2e-3, own_s] {
            for averages_current in [false, true] {
                let path = Path { current_filter_s, averages_current, ..Path::default() };
                let mut short = Sensors::new(path, at(0.0));
                (1..=10_000).for_each(|k| short.follow(at(1e-6 * f64::from(k))));
                let mut long = Sensors::new(path, at(0.0));
                let transient = Transient { size_a: [-1.2], time_constant_s: own_s };
                long.follow_with(at(interval_s), Some(transient));
                let [[short], _] = short.read();
                let [[long], _] = long.read();
                assert!((short - long).abs() < 1e-6, "{path:?}: {short} {long}");
            }
        }
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
        assert!((current - motion(0.4).current_a[0] - 0.2).abs() < 1e-9);
        assert!((speed + 1.0 - motion(0.4 - 0.0123).speed_rad_s[0]).abs() < 2e-3);
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
