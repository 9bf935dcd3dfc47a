//! The factor by which the current is read, from both balances at once.
//!
//! ```text
//! voltage   u    = r (R i + L di/dt) + k Ke w + d sign(i)      a current read s times as large: r = 1/s
//! torque    Kt i = j J dw/dt + m Mc sign(w)                    and j = s
//! ```
//!
//! Each alone proves nothing: a warm winding, a soft supply and brushes resemble `r`, another inertia resembles `j`. A current
//! of a wrong scale moves both, in opposite directions and by the same factor. Weighted least squares with exponential
//! forgetting (Ljung, System Identification, 2nd ed. 1999, sec. 11.2) and the tolerances of the nameplate as prior, which is
//! not forgotten.

use super::{Plate, Row, Scale, Settings};
use nalgebra::{SMatrix, SVector};

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
pub struct Factor {
    voltage: NormalEquations<3>,
    torque: NormalEquations<2>,
    scale: Scale,
}

impl Factor {
    pub fn new(scale: Scale) -> Self {
        let drop = (0.0, 0.5 * Settings::DROP * scale.volts);
        // Factors of one, with their prior standard deviations.
        let [unknown, flux, friction] = [10.0, 0.5, 1.0].map(|std| (1.0, std));
        Self {
            voltage: NormalEquations::new([unknown, flux, drop]),
            torque: NormalEquations::new([unknown, friction]),
            scale,
        }
    }

    /// Takes a row of known voltage; returns the factor of the measured current, once it lies significantly outside 0.5 to 2.
    /// Of a current that may have no sign, only rows that drive the shaft count.
    pub fn push(&mut self, row: &Row, is_signed: bool, plate: &Plate) -> Option<f64> {
        let volts = row.volts?;
        let direction = volts.middle().signum();
        let is_driven =
            row.speed_rad_s * direction >= 0.0 && row.speed_change_rad_s * direction >= 0.0;
        let sign = if is_signed { 1.0 } else { direction };
        if !(is_signed || is_driven) {
            return None;
        }
        let memory_s = f64::max(0.25, 10.0 * row.seconds);
        let forgetting = (-row.seconds / memory_s).exp();
        let speed_v = plate.back_emf_v_s_per_rad * row.speed_rad_s;
        let (current_by, speed_by) = plate.uncertainty_v(row);
        let floor_v = (0.005 * self.scale.volts).hypot(0.5 * volts.width());
        let noise = floor_v.hypot(current_by + speed_by);
        let factors = [sign * plate.current_v(row), speed_v, sign * row.current_a.signum()];
        self.voltage.add(forgetting, factors, volts.middle(), noise);
        if row.speed_rad_s.abs() > Settings::REST * self.scale.rad_s {
            let acceleration = plate.inertia_kg_m2 * row.speed_change_rad_s / row.seconds;
            let friction = plate.friction_n_m * row.speed_rad_s.signum();
            let floor = 0.05 * plate.torque_n_m(self.scale.amps);
            let noise = floor.hypot(plate.mechanical_error(row.seconds) * acceleration);
            let torque = sign * plate.back_emf_v_s_per_rad * row.current_a;
            self.torque.add(forgetting, [acceleration, friction], torque, noise);
        }
        let ((r, r_std), (j, j_std)) = (self.voltage.first()?, self.torque.first()?);
        let (r_by, j_by) = (Settings::SIGMAS * r_std, Settings::SIGMAS * j_std);
        let any = Settings::ANY_FACTOR;
        let large = r + r_by < any.low && j - j_by > any.high;
        let small = r - r_by > any.high && j + j_by < any.low;
        let reversed = r + r_by < 0.0 && j + j_by < 0.0;
        (large || small || reversed).then(|| (j / r).abs().sqrt().copysign(j))
    }
}
