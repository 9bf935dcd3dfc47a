//! Scheme 1 of paper A: voltage and speed give L/R, TM, Ke, and with a known resistance J and Mc.
//!
//! ```text
//! (voltage of an interval, speed at its end, direction) -> rows -> recursive least squares -> Coefficients
//! |                                     | Form::Printed, eq. (17)
//! |                                     v Form::Exact, eq. (13)
//! +--> instrumental variables ------> Dynamics --(R, Kt)--> Scheme1Values
//! (auxiliary model, batch)            estimates: deviation, verdict
//! ```
//!
//! What each is good for: the printed form needs T << L/R and T << TM; the exact form needs neither. Both are least
//! squares on a measured speed, so noise of the sensor biases them, the more the faster the sampling. The instrumental
//! variables are free of that bias over a whole run; over a short memory (some tens of samples) they scatter too much.

mod estimates;
mod instrumental;

use std::f64::consts::PI;

use nalgebra::{SMatrix, SVector};
use thiserror::Error;

use drivebench_model::numerics::recursive_least_squares::RecursiveLeastSquares;

pub(crate) use estimates::{Claim, Doubt, all_unknown, estimates};
pub use instrumental::{Instrumental, InstrumentalError, Series, instrumental_variables};

// Rows of eq. (13) and (17) from consecutive samples, in differences.
//
// `w_k - 2 w_{k-1} + w_{k-2} = -p (w_{k-1} - w_{k-2}) - q w_{k-2} + c (u_{k-1} + u_{k-2}) + b3 sgn(-w) + d (u_{k-1} - u_{k-2})`
// with `p = 2 - a1`, `q = 1 - a1 - a2`, `c = (b1 + b2)/2`, `d = (b1 - b2)/2`: the same regression, but with the
// coefficients that carry the motor.

/// One sample: the speed at its instant and the mean voltage of the interval that ends there.
#[derive(Clone, Copy, Debug)]
struct Reading {
    voltage_v: f64,
    speed_rad_s: f64,
    /// Sign of the motion, zero where it has none.
    direction: i8,
}

impl Reading {
    const MISSING: Self = Self { voltage_v: f64::NAN, speed_rad_s: f64::NAN, direction: 0 };
}

#[derive(Clone, Copy, Debug)]
struct Row {
    regressor: [f64; 5],
    value: f64,
}

impl Row {
    /// The row that ends at the last of three samples, where the motion keeps its direction.
    fn signed(samples: &[Reading; 3]) -> Option<Self> {
        let sign = samples[2].direction;
        let keeps = sign != 0 && samples.iter().all(|sample| sample.direction == sign);
        keeps.then(|| Self::unsigned(samples)).flatten()
    }

    /// The row whatever the direction, signed by the last sample; `None` where a value is missing.
    fn unsigned([earlier, before, now]: &[Reading; 3]) -> Option<Self> {
        let (u1, u2) = (now.voltage_v, before.voltage_v);
        let (w0, w1, w2) = (now.speed_rad_s, before.speed_rad_s, earlier.speed_rad_s);
        let built = Self {
            regressor: [w2 - w1, -w2, u1 + u2, -f64::from(now.direction), u1 - u2],
            value: (w0 - w1) - (w1 - w2),
        };
        (built.value.is_finite() && built.regressor.iter().all(|x| x.is_finite())).then_some(built)
    }
}

// Inverse: from the coefficients of the difference equation to the motor.

/// Form of the regression and of its inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Paper A, eq. (17): one coefficient for both voltages, and an inverse that holds for T << L/R, TM.
    Printed,
    /// Paper A, eq. (13) with both voltage coefficients free, and the poles from the roots: no assumption on T.
    Exact,
}

impl Form {
    const fn coefficients(self) -> usize {
        match self {
            Self::Printed => 4,
            Self::Exact => 5,
        }
    }
}

/// Coefficients of `w_k = a1 w_{k-1} + a2 w_{k-2} + b1 u_{k-1} + b2 u_{k-2} + b3 sgn(-w_{k-1})`, kept as the differences
/// that carry the motor: near one and minus one, `a1` and `a2` themselves would lose them to rounding.
///
/// With `Form::Printed` both voltages share `b1` of eq. (17), and [`Self::load`] is its `b2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// `p = 2 - a1` (alpha in eq. (17)).
    pub p: f64,
    /// `q = 1 - a1 - a2` (alpha gamma in eq. (17)).
    pub q: f64,
    /// `(b1 + b2)/2`, rad/(V.s).
    pub voltage: f64,
    /// Coefficient of `sgn(-w)`, rad/s.
    pub load: f64,
    /// `(b1 - b2)/2`, rad/(V.s); zero in eq. (17).
    pub voltage_step: f64,
}

impl Coefficients {
    pub fn a1(&self) -> f64 {
        2.0 - self.p
    }

    pub fn a2(&self) -> f64 {
        self.p - self.q - 1.0
    }

    /// Those of a motor at a period, the voltage held: what eq. (13) has for it, without any assumption on the period.
    pub fn of_motor(motor: &Dynamics, period_s: f64) -> Self {
        let half = -0.5 * period_s / motor.ta_s;
        let square = half * half - period_s * period_s / (motor.ta_s * motor.tm_s);
        let root = square.abs().sqrt();
        // cosh and sinh(x)/x of the half distance of the poles, or cos and sin(x)/x of half their angle.
        let (even, odd) = if root < 1e-6 {
            (1.0, 1.0)
        } else if square > 0.0 {
            (root.cosh(), root.sinh() / root)
        } else {
            (root.cos(), root.sin() / root)
        };
        let decay = half.exp();
        let p = 2.0 - 2.0 * decay * even;
        let q = p - 1.0 + decay * decay;
        let first_step = 1.0 - decay * (even - half * odd);
        Self {
            p,
            q,
            voltage: 0.5 * q / motor.ke,
            load: motor.load_v * q / motor.ke,
            voltage_step: (first_step - 0.5 * q) / motor.ke,
        }
    }

    const fn from_array([p, q, voltage, load, voltage_step]: [f64; 5]) -> Self {
        Self { p, q, voltage, load, voltage_step }
    }

    const fn to_array(self) -> [f64; 5] {
        [self.p, self.q, self.voltage, self.load, self.voltage_step]
    }
}

/// What voltage and speed determine without the resistance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    /// L/R, s.
    pub ta_s: f64,
    /// R J/(Ke Kt), s.
    pub tm_s: f64,
    /// Back-EMF constant, V.s/rad.
    pub ke: f64,
    /// Voltage that the load torque takes, R Mc/Kt, V.
    pub load_v: f64,
}

/// Parameters of the motor once the resistance is known: those of [`Dynamics`], inertia (kg.m2) and load torque (N.m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scheme1Values {
    pub ta_s: f64,
    pub tm_s: f64,
    pub ke: f64,
    pub inertia: f64,
    pub load_torque: f64,
}

/// Why coefficients belong to no motor.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Scheme1Rejection {
    #[error(
        "{rows} usable rows, at least {needed} are needed (the speed keeps its sign over three samples)"
    )]
    TooFewRows { rows: u64, needed: u64 },
    #[error(
        "{what} = {value:.3e} must be above 0: the speed does not follow the voltage as a motor does"
    )]
    NotPositive { what: &'static str, value: f64 },
    #[error("-a2 = {product:.4} must lie between 0 and 1: no positive L/R gives it")]
    Product { product: f64 },
    #[error(
        "the poles are z = {first:.4} and {second:.4}: both must lie between 0 and 1 (a negative or growing one belongs to noise, not to a motor)"
    )]
    Roots { first: f64, second: f64 },
    #[error("resistance {value} ohm is not allowed (expected > 0)")]
    Resistance { value: f64 },
}

impl Scheme1Rejection {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::TooFewRows { .. } => "record longer, with the motor turning",
            Self::NotPositive { .. } | Self::Product { .. } | Self::Roots { .. } => {
                "excite with steps of voltage; with a noisy speed use scheme 1-iv or output-error"
            }
            Self::Resistance { .. } => "give resistance_ohm in the model file",
        }
    }
}

impl Dynamics {
    /// Paper A below eq. (17), or the exact inverse of eq. (13).
    pub fn from_coefficients(
        form: Form,
        coefficients: &Coefficients,
        period_s: f64,
    ) -> Result<Self, Scheme1Rejection> {
        match form {
            Form::Printed => printed(coefficients, period_s),
            Form::Exact => exact(coefficients, period_s),
        }
    }

    /// The parameters that need the resistance; without a torque constant it is the back-EMF constant (SI).
    pub fn values(
        &self,
        resistance_ohm: f64,
        torque_n_m_per_a: Option<f64>,
    ) -> Result<Scheme1Values, Scheme1Rejection> {
        if !(resistance_ohm > 0.0 && resistance_ohm.is_finite()) {
            return Err(Scheme1Rejection::Resistance { value: resistance_ohm });
        }
        let kt = torque_n_m_per_a.unwrap_or(self.ke);
        Ok(Scheme1Values {
            ta_s: self.ta_s,
            tm_s: self.tm_s,
            ke: self.ke,
            inertia: self.tm_s * self.ke * kt / resistance_ohm,
            load_torque: self.load_v * kt / resistance_ohm,
        })
    }

    const fn to_array(self) -> [f64; 4] {
        [self.ta_s, self.tm_s, self.ke, self.load_v]
    }

    const fn from_array([ta_s, tm_s, ke, load_v]: [f64; 4]) -> Self {
        Self { ta_s, tm_s, ke, load_v }
    }
}

fn positive(what: &'static str, value: f64) -> Result<f64, Scheme1Rejection> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(Scheme1Rejection::NotPositive { what, value })
    }
}

/// `Ta = T/(2-a1)`, `TM = T (2-a1)/(1-a1-a2)`, `Ke = (1-a1-a2)/(2 b1)`, `Mc = 2 b2 J/((3-a1+a2) T)`.
fn printed(c: &Coefficients, period_s: f64) -> Result<Dynamics, Scheme1Rejection> {
    let p = positive("2 - a1", c.p)?;
    let q = positive("1 - a1 - a2", c.q)?;
    let ke = q / (2.0 * positive("b1", c.voltage)?);
    let tm_s = period_s * p / q;
    let divisor = positive("3 - a1 + a2", 2.0 * p - q)?;
    Ok(Dynamics {
        ta_s: period_s / p,
        tm_s,
        ke,
        load_v: 2.0 * c.load * tm_s * ke / (divisor * period_s),
    })
}

/// `1/Ta = -ln(-a2)/T`, `1/(Ta TM) = s1 s2`, `Ke = (1-a1-a2)/(b1+b2)`, `R Mc/Kt = Ke b3/(1-a1-a2)`.
fn exact(c: &Coefficients, period_s: f64) -> Result<Dynamics, Scheme1Rejection> {
    // With z = 1 + d the poles solve d^2 + p d + q = 0; logarithms of 1 + d keep their digits near z = 1.
    let q = positive("1 - a1 - a2", c.q)?;
    let ke = q / (2.0 * positive("b1 + b2", c.voltage)?);
    let product = 1.0 + (q - c.p);
    if !(product > 0.0 && product < 1.0) {
        return Err(Scheme1Rejection::Product { product });
    }
    let decay = -(q - c.p).ln_1p();
    let square = c.p * c.p - 4.0 * q;
    // T^2 s1 s2.
    let both = if square >= 0.0 {
        let far = -0.5 * (c.p + square.sqrt().copysign(c.p));
        let (first, second) = (1.0 + far, 1.0 + q / far);
        let inside = |z: f64| z > 0.0 && z < 1.0;
        if !(inside(first) && inside(second)) {
            return Err(Scheme1Rejection::Roots { first, second });
        }
        far.ln_1p() * (q / far).ln_1p()
    } else {
        let angle = (0.5 * (-square).sqrt()).atan2(1.0 - 0.5 * c.p);
        let angle = unfolded(c, decay, angle);
        0.25 * decay * decay + angle * angle
    };
    Ok(Dynamics {
        ta_s: period_s / decay,
        tm_s: period_s * decay / both,
        ke,
        load_v: ke * c.load / q,
    })
}

/// The angle of the pole pair, or `2 pi` minus it where the pair lies above the Nyquist angle: both have the same `a1`
/// and `a2`, but the share of `b1` in `b1 + b2` separates them (it is the first step of the response over `q`).
fn unfolded(c: &Coefficients, decay: f64, angle: f64) -> f64 {
    let response = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        1.0 - (-0.5 * decay).exp() * (cos + 0.5 * decay / angle * sin)
    };
    let share = 0.5 * (1.0 + c.voltage_step / c.voltage);
    let miss = |angle: f64| (response(angle) / c.q - share).abs();
    let above = 2.0 * PI - angle;
    // Noise alone must not choose the pair above Nyquist.
    let clearly_better = miss(above) < 0.1 * miss(angle);
    if clearly_better { above } else { angle }
}

/// Covariance of (Ta, TM, Ke, load voltage) from that of the coefficients, to first order; NaN where a neighbouring
/// coefficient belongs to no motor.
fn propagate(
    form: Form,
    coefficients: &Coefficients,
    covariance: &[[f64; 5]; 5],
    period_s: f64,
) -> [[f64; 4]; 4] {
    let at = coefficients.to_array();
    let map = |values: [f64; 5]| {
        Dynamics::from_coefficients(form, &Coefficients::from_array(values), period_s)
            .map_or([f64::NAN; 4], Dynamics::to_array)
    };
    let columns: [[f64; 4]; 5] = std::array::from_fn(|j| {
        if covariance[j][j] == 0.0 {
            return [0.0; 4];
        }
        let step = 1e-6 * at[j].abs().max(1e-9);
        let moved = |by: f64| {
            let mut there = at;
            there[j] += by;
            map(there)
        };
        let (up, down) = (moved(step), moved(-step));
        std::array::from_fn(|i| (up[i] - down[i]) / (2.0 * step))
    });
    let cell = |i: usize, k: usize| {
        let along = |a: usize| -> f64 { (0..5).map(|b| covariance[a][b] * columns[b][k]).sum() };
        (0..5).map(|a| columns[a][i] * along(a)).sum()
    };
    std::array::from_fn(|i| std::array::from_fn(|k| cell(i, k)))
}

// Scheme 1 sample by sample.

/// The estimator; feed it with [`Self::push`], once per period.
#[derive(Clone, Debug)]
pub struct Scheme1 {
    period_s: f64,
    /// The last two samples, the earlier one first.
    last: [Reading; 2],
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
        // The coefficients are of the order of one: a prior that leaves no trace (speeds of 1 rad/s and more).
        fn blank<const N: usize>(forgetting: f64) -> RecursiveLeastSquares<N> {
            RecursiveLeastSquares::new([0.0; N], [1.0; N], 1e10, forgetting)
        }
        Self {
            period_s,
            last: [Reading::MISSING; 2],
            estimator: match form {
                Form::Printed => Estimator::Printed(blank(forgetting)),
                Form::Exact => Estimator::Exact(blank(forgetting)),
            },
        }
    }

    /// Takes the sample that ends an interval and returns the innovation of the row, rad/s.
    ///
    /// `voltage_v`: mean of the voltage applied over the period that ends at this sample (`u_{k-1}` of the paper when
    /// this is sample `k`; at the first sample it does not matter). `direction`: sign of the true motion at this sample, zero at rest
    /// or where it is not known; from a dead zone, the instrument or a model, never the sign of a noisy speed. A row
    /// needs the same sign at three samples; others are left out. A value that is not finite breaks the chain of samples.
    pub fn push(&mut self, voltage_v: f64, speed_rad_s: f64, direction: i8) -> Option<f64> {
        let now = Reading { voltage_v, speed_rad_s, direction };
        let [earlier, before] = self.last;
        self.last = [before, now];
        let row = Row::signed(&[earlier, before, now])?;
        let [a, b, c, d, _] = row.regressor;
        match &mut self.estimator {
            Estimator::Printed(estimator) => estimator.update(&[a, b, c, d], row.value),
            Estimator::Exact(estimator) => estimator.update(&row.regressor, row.value),
        }
    }

    pub const fn form(&self) -> Form {
        match self.estimator {
            Estimator::Printed(_) => Form::Printed,
            Estimator::Exact(_) => Form::Exact,
        }
    }

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
    /// before the noise is known. Noise of the speed sensor biases beyond it.
    pub fn covariance(&self) -> Option<[[f64; 5]; 5]> {
        let size = self.form().coefficients();
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

    /// What needs no resistance.
    pub fn dynamics(&self) -> Result<Dynamics, Scheme1Rejection> {
        let needed = self.form().coefficients() as u64 + 1;
        let rows = self.rows();
        if rows < needed {
            return Err(Scheme1Rejection::TooFewRows { rows, needed });
        }
        Dynamics::from_coefficients(self.form(), &self.coefficients(), self.period_s)
    }

    /// Covariance of (Ta, TM, Ke, load voltage), see [`Self::covariance`].
    pub fn dynamics_covariance(&self) -> Option<[[f64; 4]; 4]> {
        let covariance = self.covariance()?;
        let (form, coefficients) = (self.form(), self.coefficients());
        Some(propagate(form, &coefficients, &covariance, self.period_s))
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

// Bias-compensated least squares: the normal equations less the expected contribution of the sensor's noise.
//
// White noise of variance `s2` on the speed adds `s2` times a known matrix per row to the normal equations (bias
// compensation; Soderstrom, *Errors-in-Variables Methods in System Identification* (2018), chapter 5). It serves to judge
// an estimate, not to replace it: a small error of the assumed variance spoils it when the noise is large.

/// Standard deviation of the speed sensor's noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// Measured, rad/s, as at standstill.
    Known(f64),
    /// The largest variance that the residual of the fit admits.
    FromResidual,
}

/// Bias-compensated least squares in the exact form; `None` where the result is no motor.
pub fn noise_free(series: &Series<'_>, direction: &[i8], noise: Noise) -> Option<(Dynamics, f64)> {
    const N: usize = 5;
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
        let Some(row) = Row::signed(&[reading(k - 2), reading(k - 1), reading(k)]) else {
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
    // Covariance of `(w2 - w1, -w2)` for white noise of variance one, and with `w0 - 2 w1 + w2`.
    for (i, (regressors, with_value)) in
        [([2.0, -1.0], 3.0), ([-1.0, 1.0], -1.0)].iter().enumerate()
    {
        right[i] -= count * sigma * sigma * with_value;
        for (j, regressor) in regressors.iter().enumerate() {
            normal[(i, j)] -= count * sigma * sigma * regressor;
        }
    }
    let theta = normal.try_inverse()? * right;
    let coefficients = Coefficients::from_array(theta.into());
    Some((Dynamics::from_coefficients(Form::Exact, &coefficients, series.period_s).ok()?, sigma))
}

#[cfg(test)]
mod tests;
