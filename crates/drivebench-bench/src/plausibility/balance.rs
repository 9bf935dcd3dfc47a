//! The balances of voltage and torque: their terms as ranges over some rows, and the factor by which the current is read,
//! from both at once.
//!
//! ```text
//! voltage   u    = r (R i + L di/dt) + k Ke w + d sign(i)      a current read s times as large: r = 1/s
//! torque    Kt i = j J dw/dt + m Mc sign(w)                    and j = s
//! ```
//!
//! Each alone proves nothing: a warm winding, a soft supply and brushes resemble `r`, another inertia resembles `j`. A current
//! of a wrong scale moves both, in opposite directions and by the same factor. Recursive weighted least squares with
//! exponential forgetting (Ljung, System Identification, 2nd ed. 1999, sec. 11.2) and the tolerances of the nameplate as prior.

use nalgebra::{SMatrix, SVector};

use super::history::{Range, Row, Scale};
use super::settings::SETTINGS;

/// The nameplate, as the balances need it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters {
    pub(super) resistance: f64,
    pub(super) inductance: f64,
    pub(super) back_emf: f64,
    pub(super) inertia: f64,
    pub(super) friction: f64,
}

impl Parameters {
    /// Voltage of the winding in a row, V.
    pub(super) fn current_v(&self, row: &Row) -> f64 {
        self.resistance * row.current_a + self.inductance * row.current_change_a / row.seconds
    }

    /// Error of the trapezoidal rule between two samples, as a share of the change, for the shaft.
    pub(super) fn mechanical_error(&self, seconds: f64) -> f64 {
        let time_s = self.resistance * self.inertia / (self.back_emf * self.back_emf);
        (seconds / (3.0 * time_s)).min(0.5)
    }

    /// The terms of one of `n` rows, V; `None`: its voltage is not known.
    pub(super) fn terms(&self, row: &Row, n: f64) -> Option<Window> {
        let volts = row.volts?;
        let (current_v, speed_v) = (self.current_v(row), self.back_emf * row.speed_rad_s);
        let (current_by, speed_by) = self.uncertainty_v(row);
        Some(Window {
            volts,
            current: Range::around(current_v, current_by),
            speed: Range::around(speed_v, speed_by),
            mean_volts: volts.middle() / n,
            mean_current: current_v / n,
            mean_speed: speed_v / n,
        })
    }

    /// Uncertainty of both terms by the change within the cycle, V.
    fn uncertainty_v(&self, row: &Row) -> (f64, f64) {
        let winding = (row.seconds * self.resistance / (6.0 * self.inductance)).min(0.5);
        let shaft = self.mechanical_error(row.seconds);
        (
            winding * self.resistance * row.current_change_a.abs(),
            shaft * self.back_emf * row.speed_change_rad_s.abs(),
        )
    }
}

/// The terms of the voltage balance over a window, V.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) volts: Range,
    pub(super) current: Range,
    pub(super) speed: Range,
    /// The means of the window's rows.
    pub(super) mean_volts: f64,
    pub(super) mean_current: f64,
    pub(super) mean_speed: f64,
}

impl Window {
    /// Residual of the balance where current and speed may be off by these factors, V; 0: they fit.
    pub(super) fn gap(&self, current: Range, speed: Range, drop_v: f64) -> f64 {
        self.volts.gap(self.current.times(current).plus(self.speed.times(speed)).wider(drop_v))
    }

    /// Residual of the balance with the speed times this factor, V.
    pub(super) fn misfit(&self, speed: f64) -> f64 {
        (self.mean_volts - self.mean_current - speed * self.mean_speed).abs()
    }

    /// With the terms of another row.
    pub(super) fn and(self, row: Self) -> Self {
        Self {
            volts: self.volts.union(row.volts),
            current: self.current.union(row.current),
            speed: self.speed.union(row.speed),
            mean_volts: self.mean_volts + row.mean_volts,
            mean_current: self.mean_current + row.mean_current,
            mean_speed: self.mean_speed + row.mean_speed,
        }
    }

    /// The same with other readings.
    pub(super) fn with(&self, current: Range, speed: Range) -> Self {
        Self { current, speed, ..*self }
    }
}

pub(super) const fn negative(range: Range) -> Range {
    Range::new(-range.high, -range.low)
}

/// Weighted normal equations of `N` factors with a prior.
#[derive(Clone, Debug)]
struct NormalEquations<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    right: SVector<f64, N>,
    square: f64,
    rows: f64,
    prior: [(f64, f64); N],
}

impl<const N: usize> NormalEquations<N> {
    fn new(prior: [(f64, f64); N]) -> Self {
        Self { matrix: SMatrix::zeros(), right: SVector::zeros(), square: 0.0, rows: 0.0, prior }
    }

    fn add(&mut self, forgetting: f64, factors: [f64; N], value: f64, noise: f64) {
        let row = SVector::from(factors) / noise;
        let value = value / noise;
        self.matrix = self.matrix * forgetting + row * row.transpose();
        self.right = self.right * forgetting + row * value;
        self.square = self.square * forgetting + value * value;
        self.rows = self.rows * forgetting + 1.0;
    }

    /// The first factor and its standard deviation.
    fn first(&self) -> Option<(f64, f64)> {
        let mut matrix = self.matrix;
        let mut right = self.right;
        for (index, (mean, std)) in self.prior.iter().enumerate() {
            let weight = 1.0 / (std * std);
            matrix[(index, index)] += weight;
            right[index] += weight * mean;
        }
        let inverse = matrix.try_inverse()?;
        let found = inverse * right;
        let misfit = self.square - 2.0 * found.dot(&self.right) + found.dot(&(self.matrix * found));
        // A misfit beyond the noise of the rows inflates the variance.
        Some((found[0], (inverse[(0, 0)] * (misfit / self.rows.max(1.0)).max(1.0)).max(0.0).sqrt()))
    }
}

/// Both balances over the last rows.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    voltage: NormalEquations<3>,
    torque: NormalEquations<2>,
}

impl Factor {
    pub(super) fn new(scale: &Scale) -> Self {
        Self {
            voltage: NormalEquations::new([
                (1.0, SETTINGS.unknown_std),
                (1.0, SETTINGS.flux_std),
                (0.0, SETTINGS.drop_std * scale.volts),
            ]),
            torque: NormalEquations::new([
                (1.0, SETTINGS.unknown_std),
                (1.0, SETTINGS.friction_std),
            ]),
        }
    }

    /// Takes a row of known voltage; returns the factor of the measured current, once it lies significantly outside 0.5 to 2.
    /// Of a current that may have no sign, only rows that drive the shaft count.
    pub(super) fn push(
        &mut self,
        row: &Row,
        is_signed: bool,
        nameplate: &Parameters,
        scale: &Scale,
    ) -> Option<f64> {
        let volts = row.volts?;
        let direction = volts.middle().signum();
        let is_driven =
            row.speed_rad_s * direction >= 0.0 && row.speed_change_rad_s * direction >= 0.0;
        let sign = if is_signed { 1.0 } else { direction };
        if !(is_signed || is_driven) {
            return None;
        }
        let forgetting =
            (-row.seconds / SETTINGS.memory_s.max(SETTINGS.memory_rows * row.seconds)).exp();
        let current_v = sign * nameplate.current_v(row);
        let speed_v = nameplate.back_emf * row.speed_rad_s;
        let (current_by, speed_by) = nameplate.uncertainty_v(row);
        let floor_v = (SETTINGS.voltage_noise * scale.volts).hypot(0.5 * volts.width());
        let noise = floor_v.hypot(current_by + speed_by);
        let factors = [current_v, speed_v, sign * row.current_a.signum()];
        self.voltage.add(forgetting, factors, volts.middle(), noise);
        if row.speed_rad_s.abs() > SETTINGS.rest_speed * scale.rad_s {
            let acceleration = nameplate.inertia * row.speed_change_rad_s / row.seconds;
            let friction = nameplate.friction * row.speed_rad_s.signum();
            let floor = SETTINGS.torque_noise * nameplate.back_emf * scale.amps;
            let noise = floor.hypot(nameplate.mechanical_error(row.seconds) * acceleration);
            let torque = sign * nameplate.back_emf * row.current_a;
            let factors = [acceleration, friction];
            self.torque.add(forgetting, factors, torque, noise);
        }
        let (r, r_std) = self.voltage.first()?;
        let (j, j_std) = self.torque.first()?;
        let (r_by, j_by) = (SETTINGS.sigmas * r_std, SETTINGS.sigmas * j_std);
        let large = r + r_by < SETTINGS.any_factor.low && j - j_by > SETTINGS.any_factor.high;
        let small = r - r_by > SETTINGS.any_factor.high && j + j_by < SETTINGS.any_factor.low;
        let reversed = r + r_by < 0.0 && j + j_by < 0.0;
        (large || small || reversed).then(|| (j / r).abs().sqrt().copysign(j))
    }
}
