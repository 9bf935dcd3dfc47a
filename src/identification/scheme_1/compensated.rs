//! What sensor noise of a known size has made of a least-squares estimate: the same sums with its share taken out.
//!
//! White noise of variance `s2` on the speed adds `s2` times a known matrix per row to the normal equations (bias
//! compensation; Soderstrom, *Errors-in-Variables Methods in System Identification* (2018), chapter 5). It serves to judge
//! an estimate, not to replace it: a noise that is a little off ruins it when the noise share is large.

use nalgebra::{SMatrix, SVector};

use super::instrumental::Series;
use super::inverse::{Coefficients, Dynamics, Form};
use super::rows::{self, Reading};

/// Covariance of `(w2 - w1, -w2)` for white noise of variance one, and with `w0 - 2 w1 + w2`.
const REGRESSORS: [[f64; 2]; 2] = [[2.0, -1.0], [-1.0, 1.0]];
const WITH_VALUE: [f64; 2] = [3.0, -1.0];

/// Standard deviation of the speed sensor's noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// Measured, rad/s, as at standstill.
    Known(f64),
    /// The most that the residual of the fit leaves room for.
    FromResidual,
}

/// Least squares with the noise taken out; `None` where nothing is left that belongs to a motor.
pub fn noise_free(
    form: Form,
    series: &Series<'_>,
    direction: &[i8],
    noise: Noise,
) -> Option<(Dynamics, f64)> {
    match form {
        Form::Printed => solve::<4>(form, series, direction, noise),
        Form::Exact => solve::<5>(form, series, direction, noise),
    }
}

fn solve<const N: usize>(
    form: Form,
    series: &Series<'_>,
    direction: &[i8],
    noise: Noise,
) -> Option<(Dynamics, f64)> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    let (mut square, mut count) = (0.0, 0.0);
    let samples = series.voltage_v.len().min(direction.len());
    let reading = |k: usize| Reading {
        voltage_v: series.voltage_v[k],
        speed_rad_s: series.speed_rad_s[k],
        direction: direction[k],
    };
    for k in 2..samples {
        let Some(row) = rows::row(&reading(k - 2), &reading(k - 1), &reading(k)) else {
            continue;
        };
        let psi = SVector::<f64, N>::from_fn(|j, _| row.regressor[j]);
        normal += psi * psi.transpose();
        right += psi * row.value;
        square += row.value * row.value;
        count += 1.0;
    }
    let sigma = match noise {
        Noise::Known(sigma) => sigma,
        Noise::FromResidual => {
            let theta = normal.try_inverse()? * right;
            let residual = (square - theta.dot(&right)).max(0.0) / (count - N as f64).max(1.0);
            // The equation error of white noise is n_k - a1 n_{k-1} - a2 n_{k-2}.
            let (a1, a2) = (2.0 - theta[0], theta[0] - theta[1] - 1.0);
            (residual / (1.0 + a1 * a1 + a2 * a2)).sqrt()
        }
    };
    for i in 0..2 {
        right[i] -= count * sigma * sigma * WITH_VALUE[i];
        for j in 0..2 {
            normal[(i, j)] -= count * sigma * sigma * REGRESSORS[i][j];
        }
    }
    let theta = normal.try_inverse()? * right;
    let coefficients: [f64; 5] =
        std::array::from_fn(|j| theta.iter().copied().nth(j).unwrap_or(0.0));
    let coefficients = Coefficients::from_array(coefficients);
    let dynamics = Dynamics::from_coefficients(form, &coefficients, series.period_s).ok()?;
    Some((dynamics, sigma))
}
