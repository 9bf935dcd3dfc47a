//! A sensor of a wrong scale, by the ratios of what was found to a nameplate: one factor moves several parameters, each by a
//! power of its own. The torque constant is that of the back-EMF, so that a wrong speed is also an error of the torques.

use std::f64::consts::{PI, TAU};

use drivebench_model::plant::MotorKey;
use drivebench_model::units::rpm_from_rad_s;

/// The parameters of a nameplate, in the order of its rows.
pub const KEYS: [MotorKey; 5] = [
    MotorKey::Resistance,
    MotorKey::Inductance,
    MotorKey::BackEmf,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

/// A sensor that reads `c` times the true value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scaled {
    Speed,
    Current,
    Voltage,
}

impl Scaled {
    pub const ALL: [Self; 3] = [Self::Speed, Self::Current, Self::Voltage];

    /// Powers of `c` by which R, L, Ke, J and Mc are found too large.
    const fn powers(self) -> [i32; 5] {
        match self {
            Self::Speed => [0, 0, -1, -2, -1],
            Self::Current => [-1, -1, 0, 1, 1],
            Self::Voltage => [1, 1, 1, 1, 1],
        }
    }

    /// The factor by the parameter that is known best.
    pub fn factor(self, ratio: impl Fn(MotorKey) -> Option<f64>) -> Option<f64> {
        let reference = if self == Self::Current { 0 } else { 2 };
        Some(ratio(KEYS[reference])?.powf(1.0 / f64::from(self.powers()[reference])))
    }

    /// Whether the factor explains every known ratio within its tolerance, a logarithm; and how many of them it moves.
    pub fn explains(
        self,
        factor: f64,
        ratio: impl Fn(MotorKey) -> Option<f64>,
        tolerance: impl Fn(MotorKey) -> f64,
    ) -> Option<usize> {
        let mut moved = 0;
        for (key, power) in KEYS.into_iter().zip(self.powers()) {
            let Some(found) = ratio(key) else { continue };
            if (found.ln() - f64::from(power) * factor.ln()).abs() > tolerance(key) {
                return None;
            }
            moved += usize::from(power != 0);
        }
        Some(moved)
    }
}

pub const DEGREES: f64 = 180.0 / PI;

/// Units that are taken for rad/s: `column = factor * true value`.
pub fn speed_units() -> [(f64, &'static str); 4] {
    [(rpm_from_rad_s(1.0), "r/min"), (DEGREES, "deg/s"), (1.0 / TAU, "turns/s"), (1e3, "mrad/s")]
}

/// The known factor that is nearest to a ratio, within a logarithm.
pub fn nearest<T: Copy>(ratio: f64, known: &[(f64, T)], within: f64) -> Option<(f64, T)> {
    let distance = |one: &(f64, T)| (ratio / one.0).ln().abs();
    let near = known.iter().filter(|one| distance(one) < within);
    near.min_by(|a, b| distance(a).total_cmp(&distance(b))).copied()
}
