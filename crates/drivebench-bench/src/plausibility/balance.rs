//! The balances of voltage and torque: their terms as ranges over some rows, and the factor by which the current is read,
//! from both at once.
//!
//! ```text
//! voltage   u    = r (R i + L di/dt) + k Ke w + d sign(i)      a current read s times as large: r = 1/s
//! torque    Kt i = j J dw/dt + m Mc sign(w)                    and j = s
//! ```
//!
//! Each alone proves nothing: a warm winding, a soft supply and brushes look like `r`, another inertia looks like `j`. A
//! current that is read wrong moves both, in opposite directions and by the same factor. Weighted least squares that
//! forget, with what the nameplate leaves open as prior.

use nalgebra::{SMatrix, SVector};

use super::history::{Range, Row, Scale};
use super::settings::SETTINGS;

/// The nameplate, as the balances need it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plate {
    pub(super) resistance: f64,
    pub(super) inductance: f64,
    pub(super) back_emf: f64,
    pub(super) inertia: f64,
    pub(super) friction: f64,
}

impl Plate {
    /// What the current takes of the voltage in a row, V.
    pub(super) fn current_v(&self, row: &Row) -> f64 {
        self.resistance * row.current_a + self.inductance * row.current_change_a / row.seconds
    }

    /// Error of the trapezoid between two samples, as a share of the change, for the winding and for the shaft.
    pub(super) fn quickness(&self, seconds: f64) -> f64 {
        (seconds * self.resistance / (6.0 * self.inductance)).min(0.5)
    }

    pub(super) fn slowness(&self, seconds: f64) -> f64 {
        let time_s = self.resistance * self.inertia / (self.back_emf * self.back_emf);
        (seconds / (3.0 * time_s)).min(0.5)
    }

    /// The terms of one of `n` rows, V; `None`: its voltage is not known.
    pub(super) fn terms(&self, row: &Row, n: f64) -> Option<Window> {
        let volts = row.volts?;
        let (current_v, speed_v) = (self.current_v(row), self.back_emf * row.speed_rad_s);
        let current_by = self.quickness(row.seconds) * self.resistance * row.current_change_a.abs();
        let speed_by = self.slowness(row.seconds) * self.back_emf * row.speed_change_rad_s.abs();
        Some(Window {
            volts,
            current: Range::around(current_v, current_by),
            speed: Range::around(speed_v, speed_by),
            mean_volts: volts.middle() / n,
            mean_current: current_v / n,
            mean_speed: speed_v / n,
        })
    }

    /// What a row's balance is in doubt because nobody looked within the cycle, V.
    pub(super) fn doubt_v(&self, row: &Row) -> f64 {
        self.quickness(row.seconds) * self.resistance * row.current_change_a.abs()
            + self.slowness(row.seconds) * self.back_emf * row.speed_change_rad_s.abs()
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
    /// What lies between the voltage and the two others, where they may be off by these factors, V; 0: they fit.
    pub(super) fn gap(&self, current: Range, speed: Range, drop_v: f64) -> f64 {
        let needed = self.current.times(current).plus(self.speed.times(speed));
        self.volts.gap(needed.wider(drop_v))
    }

    /// What is left of the balance with the speed times this factor, V.
    pub(super) fn misfit(&self, speed: f64) -> f64 {
        (self.mean_volts - self.mean_current - speed * self.mean_speed).abs()
    }

    /// With the terms of another row.
    pub(super) fn and(self, row: Self) -> Self {
        Self {
            volts: self.volts.hull(row.volts),
            current: self.current.hull(row.current),
            speed: self.speed.hull(row.speed),
            mean_volts: self.mean_volts + row.mean_volts,
            mean_current: self.mean_current + row.mean_current,
            mean_speed: self.mean_speed + row.mean_speed,
        }
    }

    /// The same with another reading in the place of a measured one.
    pub(super) fn with(&self, current: Range, speed: Range) -> Self {
        Self { current, speed, ..*self }
    }
}

pub(super) const fn negative(range: Range) -> Range {
    Range::new(-range.high, -range.low)
}

/// Weighted normal equations of `N` factors with a prior.
#[derive(Clone, Debug)]
struct Normal<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    right: SVector<f64, N>,
    square: f64,
    rows: f64,
    prior: [(f64, f64); N],
}

impl<const N: usize> Normal<N> {
    fn new(prior: [(f64, f64); N]) -> Self {
        Self { matrix: SMatrix::zeros(), right: SVector::zeros(), square: 0.0, rows: 0.0, prior }
    }

    fn add(&mut self, keep: f64, factors: [f64; N], value: f64, noise: f64) {
        let row = SVector::from(factors) / noise;
        let value = value / noise;
        self.matrix = self.matrix * keep + row * row.transpose();
        self.right = self.right * keep + row * value;
        self.square = self.square * keep + value * value;
        self.rows = self.rows * keep + 1.0;
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
        // Rows that fit worse than they should are worth less.
        let inflated = (misfit / self.rows.max(1.0)).max(1.0);
        Some((found[0], (inverse[(0, 0)] * inflated).max(0.0).sqrt()))
    }
}

/// Both balances over the last rows.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    voltage: Normal<3>,
    torque: Normal<2>,
}

impl Factor {
    pub(super) fn new(scale: &Scale) -> Self {
        Self {
            voltage: Normal::new([
                (1.0, SETTINGS.unknown_std),
                (1.0, SETTINGS.flux_std),
                (0.0, SETTINGS.drop_std * scale.volts),
            ]),
            torque: Normal::new([(1.0, SETTINGS.unknown_std), (1.0, SETTINGS.friction_std)]),
        }
    }

    /// Takes a row of which the voltage is known; the factor by which the current is read, once it is beyond doubt that
    /// it lies outside 0.5 to 2. Of a current that may have no sign, only what drives the shaft counts.
    pub(super) fn push(
        &mut self,
        row: &Row,
        is_signed: bool,
        plate: &Plate,
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
        let memory_s = SETTINGS.memory_s.max(SETTINGS.memory_rows * row.seconds);
        let keep = (-row.seconds / memory_s).exp();
        let current_v = sign * plate.current_v(row);
        let speed_v = plate.back_emf * row.speed_rad_s;
        let dynamic_v = plate.doubt_v(row);
        let floor_v = (SETTINGS.voltage_noise * scale.volts).hypot(0.5 * volts.width());
        let noise = floor_v.hypot(dynamic_v);
        let factors = [current_v, speed_v, sign * row.current_a.signum()];
        self.voltage.add(keep, factors, volts.middle(), noise);
        if row.speed_rad_s.abs() > SETTINGS.rest_speed * scale.rad_s {
            let acceleration = plate.inertia * row.speed_change_rad_s / row.seconds;
            let friction = plate.friction * row.speed_rad_s.signum();
            let floor = SETTINGS.torque_noise * plate.back_emf * scale.amps;
            let noise = floor.hypot(plate.slowness(row.seconds) * acceleration);
            let torque = sign * plate.back_emf * row.current_a;
            let factors = [acceleration, friction];
            self.torque.add(keep, factors, torque, noise);
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
