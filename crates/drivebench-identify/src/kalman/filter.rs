//! Extended Kalman filter (Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, chapter 8) over current, speed, ln R,
//! ln L, ln Ke, ln J, Coulomb torque and load torque.
//!
//! ```text
//!            +--- |w| above its noise, same sign -> Turning(s): predict, test, update
//! Unknown ---+
//!  (state =  +--- a run of samples at zero ------> AtRest: only the winding is predicted; nothing on friction
//!  the sample)
//!      ^--------- reversal, start, stop, gap, late voltage: the interval is not used, the parameters stay
//! ```
//!
//! Between such breaks the model is linear in its state and exact (`physics`); its derivatives by the parameters are
//! central differences of the exact solution. Friction enters only with a certain sign, so that there is no chatter
//! at zero speed, and its level is not updated at rest.

use super::physics::{KnownEffects, Offsets, Physics};
use super::signals::{HeldVoltage, Sensor};
use crate::recursive::steady_period;
use drivebench_model::numerics::propagator::Propagator;

/// Number of states.
pub(super) const N: usize = 8;
/// Current, A.
pub(super) const I: usize = 0;
/// Speed, rad/s.
pub(super) const W: usize = 1;
/// Logarithms of resistance, inductance, back-EMF constant, inertia.
pub(super) const R: usize = 2;
pub(super) const L: usize = 3;
pub(super) const KE: usize = 4;
pub(super) const J: usize = 5;
/// Coulomb torque, always against the motion, N.m.
pub(super) const MC: usize = 6;
/// Load torque of the process, positive against positive speed, N.m.
pub(super) const TL: usize = 7;

/// State and covariance: eight numbers, fixed size, no allocation.
///
/// The covariance stays symmetric because both halves are written from one value, and positive because the update is in
/// Joseph's form (Bucy and Joseph, *Filtering for Stochastic Processes*, 1968): `P = (I - K h)P(I - K h)' + K r K'`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Belief {
    pub(super) x: [f64; N],
    pub(super) p: [[f64; N]; N],
}

impl Belief {
    /// Resets one state to this variance, without correlation with the others.
    pub(super) fn reset(&mut self, state: usize, variance: f64) {
        for other in 0..N {
            self.p[state][other] = 0.0;
            self.p[other][state] = 0.0;
        }
        self.p[state][state] = variance;
    }

    /// Time update: `rows` are the derivatives of the new current and speed to every state; the others stay.
    pub(super) fn propagate(&mut self, mean: [f64; 2], rows: &[[f64; N]; 2]) {
        let fp: [[f64; N]; 2] = std::array::from_fn(|k| {
            std::array::from_fn(|column| (0..N).map(|m| rows[k][m] * self.p[m][column]).sum())
        });
        let inner = |k: usize, m: usize| -> f64 { (0..N).map(|n| fp[k][n] * rows[m][n]).sum() };
        let (p00, p01, p11) = (inner(0, 0), inner(0, 1), inner(1, 1));
        for (k, row) in fp.iter().enumerate() {
            for (column, value) in row.iter().enumerate().skip(2) {
                self.p[k][column] = *value;
                self.p[column][k] = *value;
            }
        }
        self.p[0][0] = p00;
        self.p[0][1] = p01;
        self.p[1][0] = p01;
        self.p[1][1] = p11;
        self.x[I] = mean[0];
        self.x[W] = mean[1];
    }

    /// Adds `q g g'` for the states I, W, TL.
    pub(super) fn disturb(&mut self, g: [f64; 3], q: f64) {
        for (k, gk) in [I, W, TL].into_iter().zip(g) {
            for (m, gm) in [I, W, TL].into_iter().zip(g) {
                self.p[k][m] += q * gk * gm;
            }
        }
    }

    /// Measurement of one state with noise variance `r`; `limit` bounds the step of each state.
    pub(super) fn measure(&mut self, state: usize, innovation: f64, r: f64, limit: &[f64; N]) {
        let variance = self.p[state][state] + r;
        if variance <= 0.0 {
            return;
        }
        let gain: [f64; N] = std::array::from_fn(|k| self.p[k][state] / variance);
        let row = self.p[state];
        // (I - K h) P, then (..)(I - K h)' + K r K'.
        let left: [[f64; N]; N] =
            std::array::from_fn(|k| std::array::from_fn(|m| self.p[k][m] - gain[k] * row[m]));
        for k in 0..N {
            for m in 0..=k {
                let value = left[k][m] - left[k][state] * gain[m] + r * gain[k] * gain[m];
                self.p[k][m] = value;
                self.p[m][k] = value;
            }
        }
        for k in 0..N {
            self.x[k] += (gain[k] * innovation).clamp(-limit[k], limit[k]);
        }
    }

    pub(super) fn is_sound(&self) -> bool {
        self.x.iter().all(|x| x.is_finite())
            && (0..N).all(|k| self.p[k][k].is_finite() && self.p[k][k] >= 0.0)
    }
}

/// Speed that ends a rest, in standard deviations of its noise.
const MOTION: f64 = 3.0;
/// Nodes of the two-point Gauss-Legendre rule on the unit interval.
const GAUSS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Mode {
    #[default]
    Unknown,
    Turning(f64),
    AtRest,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Source {
    /// Predicted from the voltage.
    #[default]
    Voltage,
    /// Measured; linear between samples.
    Current,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) used: u64,
    pub(super) breaks: u64,
    pub(super) outliers: u64,
    pub(super) reopened: u32,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Filter {
    pub(super) belief: Belief,
    pub(super) prior: [f64; N],
    pub(super) torque_n_m_per_a: Option<f64>,
    pub(super) effects: KnownEffects,
    /// Random walk of the load torque, N.m/sqrt(s).
    pub(super) load_rate: f64,
    /// Standard deviation of the voltage, as a share of it: keeps the current near its measurement.
    pub(super) voltage_share: f64,
    pub(super) source: Source,
    pub(super) sensors: [Sensor; 2],
    pub(super) voltage: HeldVoltage,
    pub(super) mode: Mode,
    pub(super) now_s: f64,
    pub(super) period_s: f64,
    /// Sensors and voltage are followed, nothing is predicted: the parameters are not known yet.
    pub(super) asleep: bool,
    pub(super) tally: Tally,
    /// Normalised innovations squared of the rows used, their number, and the logarithm of their likelihood.
    pub(super) log_likelihood: f64,
    /// Parameters about which the model is linearised, where that is not the present estimate: derivatives that follow a
    /// noisy estimate make directions observable that the data do not (Huang, Mourikis and Roumeliotis, Int. J. Robotics
    /// Research 29 (2010) 502).
    pub(super) reference: Option<[f64; N]>,
    /// Additional forgetting of the first rows, which are linearised about a poor start: now, and at a start.
    pub(super) early: f64,
    early_loss: f64,
    /// Only the load is tracked: the noise is that of the rest, where there was one.
    pub(super) fixed_noise: bool,
    /// Sign of the last measured speed where it was certain.
    last_sign: f64,
    zeros: u32,
    zero_sum: f64,
    streak: [u32; 2],
}

impl Filter {
    /// `x` and the variances of its parameters; current and speed come from the samples.
    pub(super) fn new(x: [f64; N], variance: [f64; N], torque_n_m_per_a: Option<f64>) -> Self {
        let mut filter = Self {
            torque_n_m_per_a,
            now_s: f64::NAN,
            period_s: f64::NAN,
            early_loss: 0.05,
            ..Self::default()
        };
        (filter.belief.x[I], filter.belief.x[W]) = (x[I], x[W]);
        filter.restart(x, variance);
        filter
    }

    /// Restarts with other parameters; sensors and voltage stay.
    pub(super) fn restart(&mut self, x: [f64; N], variance: [f64; N]) {
        let (current, speed) = (self.belief.x[I], self.belief.x[W]);
        self.belief = Belief { x, ..Belief::default() };
        (self.belief.x[I], self.belief.x[W]) = (current, speed);
        for (state, value) in variance.iter().enumerate().skip(R) {
            self.belief.p[state][state] = *value;
        }
        self.prior = variance;
        self.early = self.early_loss;
        self.stop();
    }

    /// The parameters are known and nothing depends on the sign of the speed.
    fn is_signless(&self) -> bool {
        self.belief.x[MC] == 0.0 && self.prior[MC] <= 0.0 && self.effects.is_empty()
    }

    /// Fixes the parameters: only the load torque is estimated.
    pub(super) fn freeze(&mut self) {
        (self.early, self.early_loss) = (0.0, 0.0);
        self.fixed_noise = true;
    }

    pub(super) fn physics(&self) -> Physics {
        self.physics_at(&self.belief.x)
    }

    fn physics_at(&self, x: &[f64; N]) -> Physics {
        let ke = x[KE].exp();
        Physics {
            r: x[R].exp(),
            l: x[L].exp(),
            ke,
            kt: self.torque_n_m_per_a.unwrap_or(ke),
            j: x[J].exp(),
            b: 0.0,
        }
    }

    /// Speed below which its sign is not certain, rad/s.
    pub(super) fn zone_rad_s(&self) -> f64 {
        let sensor = &self.sensors[1];
        (4.0 * sensor.variance().sqrt()).max(0.005 * sensor.largest)
    }

    /// One sample later than the last; what is missing or not finite is `None`. False: it could not be used.
    pub(super) fn push(&mut self, time_s: f64, measured: [Option<f64>; 2]) -> bool {
        let length_s = time_s - self.now_s;
        let first = self.now_s.is_nan();
        if !time_s.is_finite() || (!first && length_s <= 0.0) {
            return false;
        }
        for (sensor, value) in self.sensors.iter_mut().zip(measured) {
            if let Some(value) = value {
                sensor.take(value, !self.voltage.energised);
            }
        }
        if !first {
            self.period_s = steady_period(self.period_s, length_s);
        }
        let powered = self.source == Source::Current || self.voltage.at(self.now_s).is_some();
        // A longer gap between samples ends the prediction.
        let follows = powered && !self.asleep && !first && !self.voltage.torn && length_s <= 0.25;
        let used = match self.mode {
            Mode::Turning(s) if follows => self.turn(length_s, s, measured),
            Mode::AtRest if follows => self.rest(length_s, measured),
            _ => {
                if !first {
                    self.walk(length_s);
                }
                false
            }
        };
        if used {
            self.tally.used += 1;
            self.last_sign = 0.0;
        } else {
            self.set_to_sample(measured);
        }
        self.now_s = time_s;
        self.voltage.advance(time_s);
        if !self.belief.is_sound() {
            let x = self.belief.x.map(|x| if x.is_finite() { x } else { 0.0 });
            self.restart(x, self.prior);
        }
        used
    }

    /// Root mean square of the recent innovations over the noise at rest: current (or torque), speed; `None` without a rest.
    pub(super) fn consistency(&self) -> [Option<f64>; 2] {
        (self.sensors).map(|sensor| sensor.consistency().map(|(ratio, _)| ratio))
    }

    fn turn(&mut self, length_s: f64, s: f64, measured: [Option<f64>; 2]) -> bool {
        let before = self.belief;
        match self.source {
            Source::Voltage => self.predict(length_s, s),
            Source::Current => {
                let Some(current) = measured[0] else {
                    self.walk(length_s);
                    return false;
                };
                self.predict_from_current(length_s, s, current);
            }
        }
        let zone = self.zone_rad_s();
        let certain = self.is_signless()
            || (s * self.belief.x[W] > zone
                && measured[1].is_none_or(|speed| s * speed > 0.25 * zone));
        if !certain {
            self.belief = before;
            self.walk(length_s);
            return false;
        }
        self.update(measured)
    }

    fn rest(&mut self, length_s: f64, measured: [Option<f64>; 2]) -> bool {
        let noise = self.sensors[1].variance().sqrt();
        if self.source == Source::Current
            && let Some(current) = measured[0]
        {
            // Nothing predicts a current that is the input: it is what was measured.
            self.belief.x[I] = current;
        }
        let before = self.belief;
        let moves = measured[1].is_some_and(|speed| speed.abs() > MOTION * noise);
        if !moves && self.source == Source::Voltage {
            self.predict(length_s, 0.0);
        }
        if moves || self.may_break_away(before.x[I]) || self.may_break_away(self.belief.x[I]) {
            self.belief = before;
            self.walk(length_s);
            return false;
        }
        self.walk(length_s);
        self.update([measured[0], None])
    }

    /// Whether the torque is so near to the friction level that the motor may already move with a speed below its noise.
    fn may_break_away(&self, current_a: f64) -> bool {
        let level = self.belief.x[MC] - self.belief.p[MC][MC].sqrt();
        let torque = self.physics().kt * current_a - self.belief.x[TL];
        let noise = self.physics().kt * self.sensors[0].variance().sqrt();
        torque.abs() > (0.8 * level).max(MOTION * noise)
    }

    /// The load torque is a random walk.
    fn walk(&mut self, length_s: f64) {
        self.belief.p[TL][TL] += self.load_rate.powi(2) * length_s;
    }

    fn predict(&mut self, length_s: f64, s: f64) {
        let mut physics = self.physics();
        let x = self.belief.x;
        let volts = self.voltage.at(self.now_s).unwrap_or(0.0);
        let at = physics.instant(self.now_s, volts, [x[I], x[W]]);
        let offsets = self.effects.linearise(&mut physics, &at, s);
        let (mean, mut step) = self.solve(&physics, &x, length_s, s, offsets);
        let mut about = x;
        if let Some(reference) = &self.reference {
            about[R..=MC].copy_from_slice(&reference[R..=MC]);
            physics = Physics { b: physics.b, ..self.physics_at(&about) };
            step = self.solve(&physics, &about, length_s, s, offsets).1;
        }
        let mut rows = [[0.0; N]; 2];
        for (k, row) in rows.iter_mut().enumerate() {
            [row[I], row[W]] = step.phi[k];
            if s != 0.0 {
                row[TL] = -step.gamma[k][1] / physics.j;
                row[MC] = s * row[TL];
            }
        }
        for state in R..=J {
            if self.belief.p[state][state] <= 0.0 {
                continue;
            }
            let shifted = |by: f64| {
                let mut x = about;
                x[state] += by;
                let mut shifted = self.physics_at(&x);
                shifted.b = physics.b;
                self.solve(&shifted, &x, length_s, s, offsets).0
            };
            let step = 1e-5;
            let (up, down) = (shifted(step), shifted(-step));
            for k in 0..2 {
                rows[k][state] = (up[k] - down[k]) / (2.0 * step);
            }
        }
        self.belief.propagate(mean, &rows);
        if self.voltage_share > 0.0 {
            let sigma = self.voltage_share * at.voltage_v / physics.l;
            let g = [step.gamma[0][0] * sigma, step.gamma[1][0] * sigma, 0.0];
            self.belief.disturb(g, 1.0);
        }
        if self.load_rate > 0.0 && s != 0.0 {
            // Integral over the interval by Gauss's two points, exact for the double integrator that dominates.
            for node in GAUSS {
                let late = physics.turning(node * length_s);
                let [current, speed] = [0, 1].map(|k| -late.gamma[k][1] / physics.j);
                let q = 0.5 * length_s * self.load_rate.powi(2);
                self.belief.disturb([current, speed, 1.0], q);
            }
        }
    }

    /// Current and speed at the end of the interval, with transition and gain of the whole.
    fn solve(
        &self,
        physics: &Physics,
        x: &[f64; N],
        length_s: f64,
        s: f64,
        offsets: Offsets,
    ) -> ([f64; 2], Propagator) {
        let torque = s * x[MC] + x[TL] + offsets.torque_n_m;
        let mut state = [x[I], x[W]];
        let mut whole: Option<Propagator> = None;
        for (h, volts) in self.voltage.between(self.now_s, self.now_s + length_s) {
            let step = if s == 0.0 { physics.at_rest(h) } else { physics.turning(h) };
            state = step.apply(state, physics.forcing(volts - offsets.voltage_v, torque));
            whole = Some(whole.map_or(step, |before| before.then(&step)));
        }
        (state, whole.unwrap_or_else(|| physics.at_rest(0.0)))
    }

    /// Without a voltage: the measured current, linear over the interval, drives the shaft.
    fn predict_from_current(&mut self, length_s: f64, s: f64, current_a: f64) {
        let mut physics = self.physics();
        let x = self.belief.x;
        let at = physics.instant(self.now_s, 0.0, [x[I], x[W]]);
        let offsets = self.effects.linearise(&mut physics, &at, s);
        let rate = physics.b / physics.j;
        let kept = (-rate * length_s).exp();
        let share = if rate.abs() * length_s < 1e-9 {
            length_s
        } else {
            -(-rate * length_s).exp_m1() / rate
        };
        let gain = share / physics.j;
        let torque = 0.5 * physics.kt * (x[I] + current_a) - s * x[MC] - x[TL] - offsets.torque_n_m;
        let speed = kept * x[W] + gain * torque;
        let half = 0.5 * physics.kt * gain;
        let mut row = [0.0; N];
        (row[I], row[W], row[TL]) = (half, kept, -gain);
        (row[MC], row[J]) = (-s * gain, -gain * torque);
        let noise = self.sensors[0].variance();
        self.belief.propagate([current_a, speed], &[[0.0; N], row]);
        // The noise of the current at the end of the interval is the error of its state and enters the speed.
        self.belief.disturb([1.0, half, 0.0], noise);
        let q = 0.5 * length_s * self.load_rate.powi(2);
        for node in GAUSS {
            self.belief.disturb([0.0, -node * gain, 1.0], q);
        }
    }

    /// False after three outliers in succession: the interval ends.
    fn update(&mut self, measured: [Option<f64>; 2]) -> bool {
        if self.early > 1e-5 {
            self.scale(1.0 / (1.0 - self.early));
            self.early *= 1.0 - 1.0 / 60.0;
        }
        let mut limit = [f64::INFINITY; N];
        // Largest change of a logarithm in one update.
        limit[R..=J].fill(0.4);
        for (channel, value) in measured.into_iter().enumerate() {
            let Some(value) = value else { continue };
            if channel == I && self.source == Source::Current {
                continue;
            }
            let innovation = value - self.belief.x[channel];
            let own = self.belief.p[channel][channel];
            let noise = self.sensors[channel].variance();
            let square = innovation * innovation / (own + noise);
            self.sensors[channel].innovate(innovation, own, self.fixed_noise);
            // Beyond five standard deviations it is an outlier.
            self.log_likelihood -= 0.5 * (square.min(25.0) + (own + noise).ln());
            if square > 25.0 {
                self.tally.outliers += 1;
                self.streak[channel] += 1;
                if self.streak[channel] >= 3 {
                    // A change of the motor: the covariance is increased.
                    self.tally.reopened += 1;
                    self.streak = [0; 2];
                    self.scale(16.0);
                    self.early = self.early_loss;
                    return false;
                }
                continue;
            }
            self.streak[channel] = 0;
            self.belief.measure(channel, innovation, noise, &limit);
        }
        true
    }

    /// Multiplies the covariance, no parameter beyond its prior.
    fn scale(&mut self, factor: f64) {
        let p = &mut self.belief.p;
        let root: [f64; N] = std::array::from_fn(|k| {
            let most = if k < R { factor } else { self.prior[k] / p[k][k].max(f64::MIN_POSITIVE) };
            most.clamp(1.0, factor).sqrt()
        });
        for k in 0..N {
            for m in 0..N {
                p[k][m] *= root[k] * root[m];
            }
        }
    }

    /// Sets the state to the sample; the parameters stay.
    fn set_to_sample(&mut self, measured: [Option<f64>; 2]) {
        if self.mode != Mode::Unknown {
            self.tally.breaks += 1;
        }
        self.stop();
        let [current, speed] = measured;
        let [electrical, mechanical] = self.sensors.map(|sensor| sensor.variance());
        let Some(speed) = speed else { return };
        self.belief.x[I] = current.unwrap_or(0.0);
        let [amps, rad_s] = self.sensors.map(|sensor| sensor.largest);
        let unknown = amps.max(1e-3 * rad_s).powi(2);
        self.belief.reset(I, current.map_or(unknown, |_| electrical));
        self.belief.x[W] = speed;
        self.belief.reset(W, mechanical);
        if self.is_signless() {
            self.mode = Mode::Turning(1.0);
            return;
        }
        if !self.voltage.energised && self.sensors[1].at_rest().is_none() {
            // Too early to separate noise from motion.
            return;
        }
        let zone = self.zone_rad_s();
        let clear = speed.abs() > 2.0 * zone;
        let sign = if clear { speed.signum() } else { 0.0 };
        let before = std::mem::replace(&mut self.last_sign, sign);
        // Selection bias: the first sample outside the zone was selected by its noise. The state begins with the one after it, and so
        // far outside that noise does not decide whether the next interval is used; else the friction would be biased upwards.
        if before != 0.0 && before * speed > zone {
            self.mode = Mode::Turning(before);
        }
        if speed.abs() > zone {
            (self.zeros, self.zero_sum) = (0, 0.0);
            return;
        }
        self.zeros = self.zeros.saturating_add(1);
        self.zero_sum += speed;
        let rows = f64::from(self.zeros);
        if self.zeros >= 8 {
            let mean = self.zero_sum / rows;
            let still = mean.abs() < MOTION * (mechanical / rows).sqrt() + 1e-9;
            (self.zeros, self.zero_sum) = (0, 0.0);
            if still && !self.may_break_away(self.belief.x[I]) {
                self.belief.x[W] = 0.0;
                self.belief.reset(W, 0.0);
                self.mode = Mode::AtRest;
            }
        }
    }

    fn stop(&mut self) {
        self.mode = Mode::Unknown;
        for sensor in &mut self.sensors {
            sensor.interrupt();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// State that is measured, the exponent of its variance, and the row of the transition.
    type Step = (usize, f64, [f64; 8]);

    fn stays_a_covariance(steps: &[Step]) {
        let mut belief = Belief::default();
        for k in 0..N {
            belief.p[k][k] = 10f64.powi(2 - i32::try_from(k).unwrap());
        }
        // Rounding is relative to the largest covariance that was ever there.
        let mut largest = 0.0_f64;
        for &(state, exponent, row) in steps {
            let mut rows = [row, row];
            rows[1][0] = -row[1];
            rows[1][5] = 0.3;
            belief.propagate([0.0; 2], &rows);
            largest = largest.max((0..N).map(|k| belief.p[k][k]).sum());
            belief.measure(state, 0.1, 10f64.powf(exponent), &[f64::INFINITY; N]);
            let matrix = nalgebra::SMatrix::<f64, N, N>::from_fn(|k, m| belief.p[k][m]);
            assert!((matrix - matrix.transpose()).abs().max() <= 0.0, "{steps:?}");
            let least = matrix.symmetric_eigenvalues().min();
            largest = largest.max(matrix.trace());
            assert!(least > -1e-12 * largest, "{least}: {steps:?}");
            assert!(belief.is_sound(), "{steps:?}");
        }
    }

    proptest! {
        /// Whatever is measured in whatever order, the covariance stays symmetric and positive.
        #[test]
        fn the_covariance_stays_a_covariance(
            steps in proptest::collection::vec((0_usize..2, -12.0_f64..0.0, proptest::array::uniform8(-1.0_f64..1.0)), 1..60)
        ) {
            stays_a_covariance(&steps);
        }
    }

    /// The first state measured again and again to within rounding: exponent of the variance, and row of the transition.
    #[test]
    fn exact_measurements_leave_a_covariance() {
        let exact = "
            -9.84959923808012 0 0.6498282457740475 0.36535465203622514 0 0 0 -0.6146985420640368 0
            0 0 0 0 0 0 0 0 0
            -11.152524996315796 0 0 0 0 0 0 0 0
            -7.298617336386235 0 0 -0.6694019176699177 0 0.43463208908924844 0.7272135990873053 0 0.831386915694731
            -10.637086854260895 0 0 -0.9817424449096158 0.12911603457840634 0 0 0.1164539435940945 0
            -3.976335582792265 0 0 -0.9693254529006124 0.8398391064418861 0 0 0 0
            0 0 -0.34890811457044507 0 0 -0.01834971454734436 0 0.8380916321393926 0
            -11.818393939306539 -0.181031790014829 -0.6349074128610116 0 0 0 -0.3354378406319712 0 0
            -10.328526594979467 0 -0.2692963702886399 0 -0.7722475097652199 -0.7379901476209655 0 0 0
            -3.3973759272466286 0.464360379481644 0.49585350774443754 0.03405929562766462 0 0 -0.26810619373274647 0 0.651651305568091
            0 0 0 0 0 -0.6846213969486289 -0.7961510884901556 0 0
            -10.166096319216177 0 0.9410099934169983 0.841405741719135 0 0 0 0 0
            -9.927568085394332 0 0.9985462916157941 0 0 0 0 0 0";
        let steps = exact.trim().lines().map(|line| {
            let numbers: Vec<f64> = line.split_whitespace().map(|n| n.parse().unwrap()).collect();
            (0, numbers[0], numbers[1..].try_into().unwrap())
        });
        stays_a_covariance(&steps.collect::<Vec<Step>>());
    }

    #[test]
    fn two_measurements_of_one_state_average_by_their_variances() {
        let mut belief = Belief::default();
        belief.p[I][I] = 1e12;
        for (value, variance) in [(1.0, 1.0), (3.0, 3.0)] {
            belief.measure(I, value - belief.x[I], variance, &[f64::INFINITY; N]);
        }
        assert!((belief.x[I] - 1.5).abs() < 1e-9, "{}", belief.x[I]);
        assert!((belief.p[I][I] - 0.75).abs() < 1e-9);
    }
}
