//! The motor's own parameters in each balance: what a wrong value leaves there.

use nalgebra::{DMatrix, DVector};

use super::Equation;
use super::balance::{Window, Windows};
use crate::plant::MotorKey;

/// Passes of reweighting that bring least squares to least absolute values.
const PASSES: usize = 12;

/// Share of the mean absolute error within which an error counts as a square: without it one window of no error would weigh
/// as much as all others together.
const SOFT: f64 = 0.05;
/// Windows that each parameter needs.
const WINDOWS_EACH: f64 = 3.0;
/// Damping of the scaled normal matrix: parameters that the run all but ties stay finite.
const TIED: f64 = 1e-9;

/// Columns of the equation's own parameters in one window. Losses: a resistance that is 1 ohm too low in the model
/// leaves `+i`; an inertia that is too low, `+dw/dt`.
pub(super) const fn columns(window: &Window, equation: Equation) -> [f64; 3] {
    match equation {
        Equation::Voltage => [
            window.current_a,
            window.current_rate_a_s,
            window.speed_rad_s,
        ],
        Equation::Torque => [window.acceleration_rad_s2, window.direction, 0.0],
    }
}

/// Number of columns that are in use.
pub(super) const fn count(equation: Equation) -> usize {
    match equation {
        Equation::Voltage => 3,
        Equation::Torque => 2,
    }
}

/// Changes of the motor's own parameters that would explain most of a balance's error, by least absolute values: a
/// fault that is confined to a part of the run then stays there, where least squares would smear it over all of it.
/// `None` where the run does not determine them.
pub(super) fn changes(windows: &Windows<'_>, equation: Equation) -> Option<Vec<f64>> {
    let k = count(equation);
    let mut change: DVector<f64> = DVector::zeros(k);
    let mut scale = f64::INFINITY;
    for pass in 0..PASSES {
        let mut normal: DMatrix<f64> = DMatrix::zeros(k, k);
        let mut right: DVector<f64> = DVector::zeros(k);
        let (mut size, mut n) = (0.0, 0.0);
        for window in windows.of(equation) {
            let row = columns(window, equation);
            let error = window.error(equation);
            let left = error - (0..k).map(|at| row[at] * change[at]).sum::<f64>();
            // Huber: absolute values beyond the noise, squares within.
            let soft = window.floor(equation).max(SOFT * scale.min(f64::MAX));
            let weight = if pass == 0 {
                1.0
            } else {
                1.0 / left.abs().max(soft).max(f64::MIN_POSITIVE)
            };
            for at in 0..k {
                right[at] += weight * row[at] * error;
                for other in 0..k {
                    normal[(at, other)] += weight * row[at] * row[other];
                }
            }
            size += left.abs();
            n += 1.0;
        }
        scale = size / f64::max(n, 1.0);
        if scale <= 0.0 || n < WINDOWS_EACH * k as f64 {
            return None;
        }
        let units: Vec<f64> = (0..k).map(|at| normal[(at, at)].sqrt()).collect();
        if units.iter().any(|unit| !(unit.is_finite() && *unit > 0.0)) {
            return None;
        }
        for at in 0..k {
            right[at] /= units[at];
            for other in 0..k {
                normal[(at, other)] /= units[at] * units[other];
            }
            normal[(at, at)] += TIED;
        }
        let solved = normal.cholesky()?.solve(&right);
        change = DVector::from_fn(k, |at, _| solved[at] / units[at]);
    }
    Some(change.iter().copied().collect())
}

/// Takes the changes out of the balance's error.
pub(super) fn take_out(windows: &mut Windows<'_>, equation: Equation, changes: &[f64]) {
    for window in &mut windows.each {
        let row = columns(window, equation);
        let explained: f64 = row.iter().zip(changes).map(|(value, by)| value * by).sum();
        match equation {
            Equation::Torque => window.torque_n_m -= explained,
            Equation::Voltage => window.voltage_v -= explained,
        }
    }
}

/// The keys of the columns.
pub(super) const fn keys(equation: Equation) -> &'static [MotorKey] {
    match equation {
        Equation::Voltage => &[
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::BackEmf,
        ],
        Equation::Torque => &[MotorKey::Inertia, MotorKey::LoadTorque],
    }
}
