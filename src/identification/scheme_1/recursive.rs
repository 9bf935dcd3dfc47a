//! Scheme 1 sample by sample.

use super::inverse::{Coefficients, Dynamics, Form, Scheme1Rejection, Scheme1Values, propagate};
use super::rows::{Reading, Rows};
use crate::numerics::recursive_least_squares::RecursiveLeastSquares;

/// The coefficients are of the order of one; a prior wide enough to leave no trace (speeds of 1 rad/s and more).
const PRIOR: f64 = 1e10;

/// The estimator; feed it with [`Self::push`], once per period.
#[derive(Clone, Debug)]
pub struct Scheme1 {
    period_s: f64,
    rows: Rows,
    estimator: Estimator,
}

#[derive(Clone, Debug)]
enum Estimator {
    Printed(RecursiveLeastSquares<4>),
    Exact(RecursiveLeastSquares<5>),
}

impl Scheme1 {
    /// `period_s`: the samples are equidistant. `forgetting`: factor per row, 1 for none.
    pub fn new(form: Form, period_s: f64, forgetting: f64) -> Self {
        let estimator = match form {
            Form::Printed => Estimator::Printed(RecursiveLeastSquares::new(
                [0.0; 4], [1.0; 4], PRIOR, forgetting,
            )),
            Form::Exact => Estimator::Exact(RecursiveLeastSquares::new(
                [0.0; 5], [1.0; 5], PRIOR, forgetting,
            )),
        };
        Self {
            period_s,
            rows: Rows::default(),
            estimator,
        }
    }

    /// Takes the sample that ends an interval and returns the innovation of the row, rad/s.
    ///
    /// `voltage_v`: mean of the voltage applied over the period that ends at this sample (`u_{k-1}` of the paper when
    /// this is sample `k`; at the first sample it does not matter). `direction`: sign of the true motion at this sample, zero at rest
    /// or where it is not known; from a dead zone, the instrument or a model, never the sign of a noisy speed. A row
    /// needs the same sign at three samples; others are left out. A value that is not finite breaks the chain of samples.
    pub fn push(&mut self, voltage_v: f64, speed_rad_s: f64, direction: i8) -> Option<f64> {
        let row = self.rows.push(Reading {
            voltage_v,
            speed_rad_s,
            direction,
        })?;
        let [a, b, c, d, e] = row.regressor;
        match &mut self.estimator {
            Estimator::Printed(estimator) => estimator.update(&[a, b, c, d], row.value),
            Estimator::Exact(estimator) => estimator.update(&[a, b, c, d, e], row.value),
        }
    }

    /// Which form this is.
    pub const fn form(&self) -> Form {
        match self.estimator {
            Estimator::Printed(_) => Form::Printed,
            Estimator::Exact(_) => Form::Exact,
        }
    }

    /// Rows taken so far.
    pub fn rows(&self) -> u64 {
        match &self.estimator {
            Estimator::Printed(estimator) => estimator.rows(),
            Estimator::Exact(estimator) => estimator.rows(),
        }
    }

    pub fn coefficients(&self) -> Coefficients {
        Coefficients::from_array(match &self.estimator {
            Estimator::Printed(estimator) => {
                let [p, q, voltage, load] = estimator.parameters();
                [p, q, voltage, load, 0.0]
            }
            Estimator::Exact(estimator) => estimator.parameters(),
        })
    }

    /// Covariance of the coefficients in the order of the fields of [`Coefficients`] for white equation errors; `None`
    /// before the noise is known. Noise of the speed sensor biases beyond what it says.
    pub fn covariance(&self) -> Option<[[f64; 5]; 5]> {
        let size = match self.form() {
            Form::Printed => 4,
            Form::Exact => 5,
        };
        let mut out = [[0.0; 5]; 5];
        for (row, line) in out.iter_mut().enumerate().take(size) {
            for (column, cell) in line.iter_mut().enumerate().take(size) {
                *cell = match &self.estimator {
                    Estimator::Printed(estimator) => estimator.covariance(row, column),
                    Estimator::Exact(estimator) => estimator.covariance(row, column),
                }?;
            }
        }
        Some(out)
    }

    /// Variance of the equation error, (rad/s)^2; `None` before it is known.
    pub fn noise_variance(&self) -> Option<f64> {
        match &self.estimator {
            Estimator::Printed(estimator) => estimator.noise_variance(),
            Estimator::Exact(estimator) => estimator.noise_variance(),
        }
    }

    /// What needs no resistance.
    pub fn dynamics(&self) -> Result<Dynamics, Scheme1Rejection> {
        let needed = self.form().fewest_rows();
        if self.rows() < needed {
            return Err(Scheme1Rejection::TooFewRows {
                rows: self.rows(),
                needed,
            });
        }
        Dynamics::from_coefficients(self.form(), &self.coefficients(), self.period_s)
    }

    /// Covariance of (Ta, TM, Ke, load voltage), see [`Self::covariance`].
    pub fn dynamics_covariance(&self) -> Option<[[f64; 4]; 4]> {
        let covariance = self.covariance()?;
        Some(propagate(
            self.form(),
            &self.coefficients(),
            &covariance,
            self.period_s,
        ))
    }

    /// The motor, the resistance known; without a torque constant (N.m/A) it is the back-EMF constant.
    pub fn parameters(
        &self,
        resistance_ohm: f64,
        torque_constant: Option<f64>,
    ) -> Result<Scheme1Values, Scheme1Rejection> {
        self.dynamics()?.values(resistance_ohm, torque_constant)
    }
}
