//! Inertia and load while the loop runs: recursive least squares (scheme 2 of paper A) with change detection.
//!
//! `w_k - w_{k-1} = (Kt/J) int i - (Mc/J) sgn(w) T`, the current as a trapezoid. Rows without a clear direction of rotation
//! are left out, and the covariance is reset when the prediction errors of successive rows add up: the load has changed.
//!
//! Behind a coupling the motor's speed is not that of the whole inertia: there both sides of the equation are means over
//! periods of the torsional oscillation, in which it cancels. A torque step twists the shaft, which the detector would take
//! for another load: it is off there, and only the forgetting factor follows a changed load.

use drivebench_model::numerics::change_watch::ChangeWatch;
use drivebench_model::numerics::recursive_least_squares::{RecursiveLeastSquares, RowNoise};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Load {
    /// Kt/J, rad/s^2 per A.
    pub(super) acceleration_per_a: f64,
    pub(super) std: f64,
    /// Coulomb torque over the inertia, rad/s^2.
    pub(super) friction_rad_s2: f64,
    pub(super) settled: bool,
}

/// Accumulates a row: charge and time since the mean at which the last one ended.
#[derive(Clone, Copy, Debug, Default)]
struct RowMean {
    charge: f64,
    time_s: f64,
    /// Integrals of charge, time and speed, and their length.
    sums: [f64; 3],
    length_s: f64,
    /// Mean speed that the row begins with.
    from_rad_s: Option<f64>,
}

/// From one mean to the next: charge, time and change of speed.
struct Row {
    charge: f64,
    time_s: f64,
    speed_change: f64,
}

impl RowMean {
    fn push(&mut self, speed_rad_s: f64, period_s: f64, span_s: f64) -> Option<Row> {
        let now = [self.charge, self.time_s, speed_rad_s];
        for (sum, now) in self.sums.iter_mut().zip(now) {
            *sum += period_s * now;
        }
        let is_first = self.length_s == 0.0;
        self.length_s += period_s;
        // Half a period: cycles do not divide a span exactly.
        if self.length_s + 0.5 * period_s < span_s {
            return None;
        }
        // One sample is its own mean, to the bit.
        let [charge, time_s, speed] =
            if is_first { now } else { self.sums.map(|sum| sum / self.length_s) };
        let from = self.from_rad_s.replace(speed);
        self.charge -= charge;
        self.time_s -= time_s;
        (self.sums, self.length_s) = ([0.0; 3], 0.0);
        from.map(|from| Row { charge, time_s, speed_change: speed - from })
    }
}

#[derive(Clone, Debug)]
pub(super) struct LoadEstimator {
    estimator: RecursiveLeastSquares<2>,
    scale: [f64; 2],
    forgetting: f64,
    /// Over which rows are means; 0: a row from each sample to the next.
    span_s: f64,
    row: RowMean,
    last: Option<(f64, f64)>,
    continues: bool,
    change: ChangeWatch,
    detects_change: bool,
    /// Changes of the load so far.
    pub(super) jumps: u32,
}

impl LoadEstimator {
    /// Starts from the model: `acceleration_per_a` is Kt/J, `friction_rad_s2` Mc/J, `noise_rad_s` the standard deviation
    /// of a speed sample.
    pub(super) fn new(
        acceleration_per_a: f64,
        friction_rad_s2: f64,
        forgetting: f64,
        noise_rad_s: f64,
    ) -> Self {
        let start = [acceleration_per_a, friction_rad_s2];
        let scale = [acceleration_per_a, friction_rad_s2.max(acceleration_per_a)];
        Self {
            estimator: unknown(start, scale, forgetting),
            scale,
            forgetting,
            span_s: 0.0,
            row: RowMean::default(),
            last: None,
            continues: false,
            change: ChangeWatch::new(0.25, 2.0 * noise_rad_s * noise_rad_s),
            detects_change: true,
            jumps: 0,
        }
    }

    /// Without change detection: the forgetting factor follows a changed load, as in paper A.
    #[must_use]
    pub(super) const fn without_change_detection(mut self) -> Self {
        self.detects_change = false;
        self
    }

    /// Behind a coupling with this period of its oscillation.
    #[must_use]
    pub(super) const fn with_torsion_period(mut self, period_s: f64) -> Self {
        // Of more periods the twist would count less against the change of the mean speed, but rows would be fewer.
        self.span_s = 2.0 * period_s;
        self.without_change_detection()
    }

    /// One sample; `current_a` is `None` where it is missing. Returns whether the estimate was updated.
    pub(super) fn push(&mut self, current_a: Option<f64>, speed_rad_s: f64, period_s: f64) -> bool {
        let now = current_a.filter(|amps| amps.is_finite()).map(|current| (current, speed_rad_s));
        let (Some((current, speed)), Some((last_current, last_speed))) = (now, self.last) else {
            self.last = now;
            self.begin(speed_rad_s, period_s);
            return false;
        };
        self.last = now;
        // Below 2 rad/s the direction is noise.
        let is_moving = last_speed.abs().min(speed.abs()) > 2.0 && last_speed * speed > 0.0;
        if !is_moving {
            self.begin(speed, period_s);
            return false;
        }
        self.row.charge += 0.5 * (current + last_current) * period_s;
        self.row.time_s += period_s;
        let Some(row) = self.row.push(speed, period_s, self.span_s) else { return false };
        let regressor = [row.charge, -speed.signum() * row.time_s];
        let noise = RowNoise { carry: 1.0, continues: self.continues };
        self.continues = true;
        if self.detects_change {
            self.detect_change(&regressor, row.speed_change);
        }
        self.estimator.update_row(&regressor, row.speed_change, noise).is_some()
    }

    /// This sample has no predecessor.
    fn begin(&mut self, speed_rad_s: f64, period_s: f64) {
        self.row = RowMean::default();
        let row = self.row.push(speed_rad_s, period_s, self.span_s);
        debug_assert!(row.is_none(), "a row needs two means");
        self.interrupt();
    }

    const fn interrupt(&mut self) {
        self.continues = false;
        self.change.interrupt();
    }

    /// Resets the covariance when the prediction errors of several rows show another load.
    fn detect_change(&mut self, regressor: &[f64; 2], speed_change: f64) {
        let known = self.estimator.parameters();
        let predicted = known[0] * regressor[0] + known[1] * regressor[1];
        // An estimate that has not settled mispredicts under any load.
        if self.change.take(predicted, speed_change, self.load().settled) {
            self.estimator = unknown(known, self.scale, self.forgetting);
            self.interrupt();
            self.jumps += 1;
        }
    }

    pub(super) fn load(&self) -> Load {
        let [value, friction] = self.estimator.parameters();
        let std = self.estimator.standard_deviations().map_or(f64::INFINITY, |stds| stds[0]);
        Load {
            acceleration_per_a: value,
            std,
            friction_rad_s2: friction.max(0.0),
            settled: self.estimator.rows() >= 8 && value > 0.0 && std < 0.05 * value,
        }
    }
}

/// Nothing is known but the size of the parameters.
fn unknown(start: [f64; 2], scale: [f64; 2], forgetting: f64) -> RecursiveLeastSquares<2> {
    // Prior variance over the size, in noise variances.
    RecursiveLeastSquares::new(start, scale, 1e8, forgetting)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LinearPlant;
    use crate::testing::{assert_close, elastic};
    use drivebench_model::numerics::count::whole;
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    /// A shaft under a square wave of current; returns the estimate after each row.
    fn follow(
        estimator: &mut LoadEstimator,
        gain: impl Fn(f64) -> f64,
        current: impl Fn(f64) -> f64,
        seconds: f64,
    ) -> Vec<(f64, Load)> {
        let (period_s, friction) = (0.01, 20.0);
        // A new record: its first sample has no predecessor.
        estimator.push(None, 100.0, period_s);
        let mut speed = 100.0;
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let rows = u32::try_from(whole(seconds / period_s)).unwrap();
        (0..rows)
            .map(|n| {
                let t = f64::from(n) * period_s;
                let error = 0.3 * random.random_range(-0.5..0.5);
                estimator.push(Some(current(t)), speed + error, period_s);
                let amps = 0.5 * (current(t) + current(t + period_s));
                speed += period_s * (gain(t) * amps - friction * speed.signum());
                (t, estimator.load())
            })
            .collect()
    }

    fn square(t: f64) -> f64 {
        if (t / 0.4).floor() % 2.0 == 0.0 { 4.0 } else { -3.0 }
    }

    #[test]
    fn inertia_is_found_and_followed_over_a_jump_either_way() {
        for ratio in [0.25, 4.0] {
            let mut estimator = LoadEstimator::new(20.0, 20.0, 0.96, 0.15);
            let gain = |t| if t < 4.0 { 15.0 } else { 15.0 / ratio };
            let found = follow(&mut estimator, gain, square, 6.0);
            let before = found[395].1;
            assert!(before.settled);
            assert_close(before.acceleration_per_a / 15.0, 1.0, 0.05);
            let after = found.last().unwrap().1;
            assert!(after.settled);
            assert_close(after.acceleration_per_a * ratio / 15.0, 1.0, 0.05);
            // Detected as a jump, not followed by forgetting.
            assert!(estimator.jumps >= 1);
            let soon = found.iter().find(|(t, _)| *t >= 4.8).unwrap().1;
            assert_close(soon.acceleration_per_a * ratio / 15.0, 1.0, 0.2);
        }
    }

    #[test]
    fn behind_a_coupling_the_whole_inertia_is_found() {
        // Kt/J of motor and load together is half of the motor's alone.
        let whole = 0.3538 / 0.0045;
        let plant = LinearPlant::current(&elastic(0.5, 0.02), 0.0, 0.002).unwrap();
        let (phi, gamma) = plant.held_over(0.002);
        let mut estimator =
            LoadEstimator::new(1.5 * whole, 0.0, 0.96, 0.02).with_torsion_period(1.0 / 22.0);
        let mut x = nalgebra::Vector4::new(0.0, 100.0, 100.0, 0.0);
        for n in 0..1500 {
            estimator.push(Some(x[0]), x[1], 0.002);
            // Steps of the current over some periods of the oscillation.
            let amps = if (n / 150) % 2 == 0 { 1.5 } else { -1.5 };
            x = phi * x + gamma * amps;
        }
        let found = estimator.load();
        assert!(found.settled);
        assert_close(found.acceleration_per_a / whole, 1.0, 0.1);
    }

    #[test]
    fn a_minute_at_constant_speed_changes_nothing() {
        let mut estimator = LoadEstimator::new(20.0, 20.0, 0.96, 0.15);
        follow(&mut estimator, |_| 15.0, square, 4.0);
        let before = estimator.load();
        follow(&mut estimator, |_| 15.0, |_| 20.0 / 15.0, 60.0);
        let drift = estimator.load().acceleration_per_a / before.acceleration_per_a - 1.0;
        assert!(drift.abs() < 0.05, "{drift}");
        assert_eq!(estimator.jumps, 0);
    }

    #[test]
    fn missing_currents_and_standstill_update_nothing() {
        let mut estimator = LoadEstimator::new(20.0, 20.0, 0.96, 0.15);
        for n in 0..100 {
            assert!(!estimator.push(None, 50.0 + f64::from(n), 0.01));
            assert!(!estimator.push(Some(f64::NAN), 50.0, 0.01));
        }
        for _ in 0..100 {
            assert!(!estimator.push(Some(3.0), 0.4, 0.01));
        }
        assert!(!estimator.load().settled);
    }
}
