//! Inputs of the filter: the voltage as applied, and the noise of each sensor, with whether the innovations agree with it.

use drivebench_model::signal;

/// Fewest innovations of a consistency test.
const FEWEST_TESTED: f64 = 30.0;

/// Noise variance: from the scatter at rest where there was one, then from the innovations (Mehra, *IEEE Trans. Automatic
/// Control* AC-15, 1970).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sensor {
    /// Differences of successive samples at rest: a slow drift does not enter (von Neumann 1941).
    differences: f64,
    squares: f64,
    last: Option<f64>,
    smallest_step: f64,
    pub(super) largest: f64,
    innovations: f64,
    innovation_squares: f64,
    test: Test,
}

/// Exponentially weighted sums over the normalised innovations.
#[derive(Clone, Copy, Debug, Default)]
struct Test {
    rows: f64,
    /// Squares over their expectation by the noise at rest.
    expected: f64,
    /// Squares over their expectation by the filter, and products of neighbours.
    squares: f64,
    products: f64,
    last: Option<f64>,
}

impl Sensor {
    /// Takes every sample; `at_rest` while nothing has been applied yet.
    pub(super) fn take(&mut self, value: f64, at_rest: bool) {
        self.largest = self.largest.max(value.abs());
        if let Some(last) = self.last {
            let step = (value - last).abs();
            if step > 1e-9 * self.largest
                && (self.smallest_step <= 0.0 || step < self.smallest_step)
            {
                self.smallest_step = step;
            }
            if at_rest {
                self.differences += 1.0;
                self.squares += 0.5 * step * step;
            }
        }
        self.last = Some(value);
    }

    /// Variance of one sample as the rest before the start shows it; never below the resolution.
    pub(super) fn at_rest(&self) -> Option<f64> {
        (self.differences >= 10.0).then(|| (self.squares / self.differences).max(self.least()))
    }

    /// Of the resolution; no sensor is better than a millionth of its largest value, which keeps the filter regular on
    /// noiseless data.
    fn least(&self) -> f64 {
        (self.smallest_step * self.smallest_step / 12.0).max((1e-6 * self.largest).powi(2))
    }

    pub(super) fn variance(&self) -> f64 {
        // The start and how many innovations it is worth; without samples at rest 1 % of the largest value.
        let (start, weight) = match self.at_rest() {
            Some(variance) => (variance, self.differences.min(200.0)),
            None => ((0.01 * self.largest).powi(2), 20.0),
        };
        ((weight * start + self.innovation_squares) / (weight + self.innovations))
            .max(self.least())
            .max(f64::MIN_POSITIVE)
    }

    /// One innovation, of which the filter itself explains the variance `own`. `fixed`: the noise stays that of the rest,
    /// where there was one.
    pub(super) fn innovate(&mut self, innovation: f64, own: f64, fixed: bool) {
        let noise = self.variance();
        let square = innovation * innovation;
        let reference = self.at_rest().unwrap_or(noise);
        let whole = own + noise;
        // An outlier is one row and counts as ten standard deviations at most.
        let expected = (square / (own + reference)).min(100.0);
        self.test.take(innovation / whole.sqrt(), expected);
        if fixed && self.at_rest().is_some() {
            return;
        }
        // While the parameters converge the innovation is not that of the sensor.
        let clipped = 9.0 * whole;
        if own < 0.5 * noise || square > clipped {
            self.innovations += 1.0;
            self.innovation_squares += square.min(clipped) - own;
            if self.innovations > 2000.0 {
                self.innovations *= 0.5;
                self.innovation_squares *= 0.5;
            }
        }
    }

    /// The next innovation does not follow the last one.
    pub(super) fn interrupt(&mut self) {
        self.test.last = None;
    }

    /// Root mean square of the recent innovations over its expectation by the noise at rest, and the bound that it exceeds by chance
    /// in one case of two hundred (normalised innovations squared). `None` without a rest.
    pub(super) fn consistency(&self) -> Option<(f64, f64)> {
        self.at_rest()?;
        (self.test.rows >= FEWEST_TESTED).then(|| {
            let scatter = 1.0 / (2.0 * self.test.rows) + 0.75 / self.differences;
            ((self.test.expected / self.test.rows).sqrt(), 1.0 + 2.6 * scatter.sqrt())
        })
    }

    /// Factor on a variance for AR(1)-correlated innovations: `(1 + rho)/(1 - rho)`, one where rho is not significant.
    pub(super) fn colour(&self) -> f64 {
        if self.test.rows < FEWEST_TESTED {
            return 1.0;
        }
        let rho = (self.test.products / self.test.squares.max(f64::MIN_POSITIVE)).min(0.99);
        if rho > 3.0 / self.test.rows.sqrt() { (1.0 + rho) / (1.0 - rho) } else { 1.0 }
    }
}

impl Test {
    fn take(&mut self, normalised: f64, expected: f64) {
        // A memory of 500 rows.
        let kept = 1.0 - 1.0 / 500.0;
        let normalised = normalised.clamp(-10.0, 10.0);
        self.rows = kept * self.rows + 1.0;
        self.expected = kept * self.expected + expected;
        self.squares = kept * self.squares + normalised * normalised;
        self.products = kept * self.products + normalised * self.last.unwrap_or(0.0);
        self.last = Some(normalised);
    }
}

/// Applied voltage as a zero-order hold of at most 16 changes, without allocation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeldVoltage {
    /// `(from, volts)` in the order of time; the first holds at the filter's present instant.
    pieces: [(f64, f64); 16],
    count: usize,
    /// The interval that comes is not known: too many changes in it, or one came too late.
    pub(super) torn: bool,
    pub(super) energised: bool,
}

impl HeldVoltage {
    /// The voltage that holds from `time_s` on; `now_s` is the instant up to which the filter has already gone.
    pub(super) fn apply(&mut self, time_s: f64, voltage_v: f64, now_s: f64) {
        if !(time_s.is_finite() && voltage_v.is_finite()) {
            return;
        }
        self.energised |= voltage_v != 0.0;
        let held = &self.pieces[..self.count];
        let at = held.partition_point(|piece| piece.0 < time_s);
        let known = at > 0 && held[at - 1].1.total_cmp(&voltage_v).is_eq();
        let same_time = held.get(at).is_some_and(|p| p.0.total_cmp(&time_s).is_eq());
        if same_time {
            self.pieces[at].1 = voltage_v;
            return;
        }
        // The same voltage once more changes nothing, unless another holds later.
        if known && at == self.count {
            return;
        }
        let full = self.count == self.pieces.len();
        self.torn |= full || (time_s < now_s && self.count > 0);
        self.count -= usize::from(full);
        let at = at.min(self.count);
        self.pieces.copy_within(at..self.count, at + 1);
        self.pieces[at] = (time_s, voltage_v);
        self.count += 1;
    }

    /// Voltage at an instant; `None` before the first command.
    pub(super) fn at(&self, time_s: f64) -> Option<f64> {
        signal::held(&self.pieces[..self.count], time_s)
    }

    /// `(length, volts)` of the pieces between two instants, of which the first is covered.
    pub(super) fn between(
        &self,
        from_s: f64,
        to_s: f64,
    ) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
        signal::pieces(&self.pieces[..self.count], from_s, to_s)
    }

    /// Removes the changes that ended before `now_s`.
    pub(super) fn advance(&mut self, now_s: f64) {
        let held = self.pieces[..self.count].partition_point(|piece| piece.0 <= now_s);
        if held > 1 {
            self.pieces.copy_within(held - 1..self.count, 0);
            self.count -= held - 1;
        }
        self.torn = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, Normal};

    fn noise(sigma: f64, rows: usize, seed: u64) -> Vec<f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, sigma).unwrap();
        (0..rows).map(|_| normal.sample(&mut random)).collect()
    }

    fn rested(samples: impl IntoIterator<Item = f64>) -> Sensor {
        let mut sensor = Sensor::default();
        samples.into_iter().for_each(|value| sensor.take(value, true));
        sensor
    }

    #[test]
    fn the_rest_gives_the_noise_without_drift_or_the_resolution() {
        let drifting = noise(0.15, 400, 1).into_iter().zip(0..);
        let drifting = rested(drifting.map(|(value, k)| value + 0.01 * f64::from(k)));
        let sigma = drifting.at_rest().unwrap().sqrt();
        assert!((sigma / 0.15 - 1.0).abs() < 0.1, "{sigma}");
        let mut still = rested([0.0; 40]);
        (1..11).for_each(|k| still.take(0.5 * f64::from(k), false));
        assert!((still.variance().sqrt() - 0.5 / 12f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn innovations_correct_the_noise_and_their_colour_widens() {
        let mut sensor = rested(noise(0.1, 200, 2));
        for innovation in noise(0.3, 3000, 3) {
            sensor.innovate(innovation, 1e-4, false);
        }
        let (ratio, allowed) = sensor.consistency().unwrap();
        let found = (ratio / 3.0 - 1.0).abs() < 0.15 && ratio > allowed;
        assert!(found, "{ratio} {allowed}");
        assert!((sensor.variance().sqrt() / 0.3 - 1.0).abs() < 0.1);
        assert!((sensor.colour() - 1.0).abs() < 1e-12);
        let mut sensor = rested(noise(0.1, 200, 4));
        let mut value = 0.0;
        for step in noise(0.06, 3000, 5) {
            value = 0.8 * value + step;
            sensor.innovate(value, 1e-6, false);
        }
        // rho = 0.8: (1 + 0.8)/(1 - 0.8) = 9.
        let colour = sensor.colour();
        assert!((6.0..13.0).contains(&colour), "{colour}");
    }

    #[test]
    fn pieces_cover_the_interval_in_any_order_of_the_changes() {
        let mut held = HeldVoltage::default();
        assert_eq!(held.at(1.0), None);
        for (time_s, volts) in [(0.0, 5.0), (2.0, 7.0), (1.0, 6.0), (f64::NAN, 9.0)] {
            held.apply(time_s, volts, 0.0);
        }
        let pieces: Vec<_> = held.between(0.5, 2.5).collect();
        assert_eq!(pieces, [(0.5, 5.0), (1.0, 6.0), (0.5, 7.0)]);
        held.advance(2.0);
        assert_eq!((held.at(1.5), held.at(2.0)), (None, Some(7.0)));
        assert!(!held.torn);
        // One that comes too late, or too many of them, tear the interval.
        held.apply(1.9, 6.0, 2.0);
        assert!(held.torn);
        held.advance(3.0);
        assert_eq!(held.at(3.0), Some(7.0));
        for k in 0..40 {
            held.apply(3.0 + 0.001 * f64::from(k), f64::from(k), 3.0);
        }
        assert!(held.torn);
        assert_eq!(held.at(4.0), Some(39.0));
    }
}
