//! From the coefficients of the difference equation back to the motor.

use std::f64::consts::PI;

use thiserror::Error;

/// Which regression, and with it which way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Paper A, eq. (17): one coefficient for both voltages, and an inverse that holds for T << L/R, TM.
    Printed,
    /// Paper A, eq. (13) with both voltage coefficients free, and the poles from the roots: no assumption on T.
    Exact,
}

impl Form {
    /// Least number of rows: one more than coefficients.
    pub(super) const fn fewest_rows(self) -> u64 {
        match self {
            Self::Printed => 5,
            Self::Exact => 6,
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

    /// Coefficients of `u_{k-1}` and `u_{k-2}`.
    pub fn b(&self) -> [f64; 2] {
        [
            self.voltage + self.voltage_step,
            self.voltage - self.voltage_step,
        ]
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

    pub(super) const fn from_array([p, q, voltage, load, voltage_step]: [f64; 5]) -> Self {
        Self {
            p,
            q,
            voltage,
            load,
            voltage_step,
        }
    }

    pub(super) const fn to_array(self) -> [f64; 5] {
        [self.p, self.q, self.voltage, self.load, self.voltage_step]
    }
}

/// What voltage and speed tell without the resistance.
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

/// Parameters of the motor once the resistance is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scheme1Values {
    /// L/R, s.
    pub ta_s: f64,
    /// R J/(Ke Kt), s.
    pub tm_s: f64,
    /// Back-EMF constant, V.s/rad.
    pub ke: f64,
    /// kg.m2.
    pub inertia: f64,
    /// Coulomb load torque, N.m.
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
    /// Paper A below eq. (17), or the exact inverse of eq. (13) after PHYSICS section 3.
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
            return Err(Scheme1Rejection::Resistance {
                value: resistance_ohm,
            });
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

    pub(super) const fn to_array(self) -> [f64; 4] {
        [self.ta_s, self.tm_s, self.ke, self.load_v]
    }

    pub(super) const fn from_array([ta_s, tm_s, ke, load_v]: [f64; 4]) -> Self {
        Self {
            ta_s,
            tm_s,
            ke,
            load_v,
        }
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
/// and `a2`, but the share of `b1` in `b1 + b2` tells them apart (it is the first step of the response over `q`).
fn unfolded(c: &Coefficients, decay: f64, angle: f64) -> f64 {
    let response = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        1.0 - (-0.5 * decay).exp() * (cos + 0.5 * decay / angle * sin)
    };
    let share = 0.5 * (1.0 + c.voltage_step / c.voltage);
    let miss = |angle: f64| (response(angle) / c.q - share).abs();
    let above = 2.0 * PI - angle;
    if miss(above) < CLEARLY_BETTER * miss(angle) {
        above
    } else {
        angle
    }
}

/// How much better the pair above Nyquist must fit: noise alone must not choose it.
const CLEARLY_BETTER: f64 = 0.1;

/// Covariance of (Ta, TM, Ke, load voltage) from that of the coefficients, to first order; NaN where a neighbouring
/// coefficient belongs to no motor.
pub(super) fn propagate(
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
        let (mut up, mut down) = (at, at);
        up[j] += step;
        down[j] -= step;
        let (up, down) = (map(up), map(down));
        std::array::from_fn(|i| (up[i] - down[i]) / (2.0 * step))
    });
    std::array::from_fn(|i| {
        std::array::from_fn(|k| {
            (0..5)
                .map(|a| {
                    let along: f64 = (0..5).map(|b| covariance[a][b] * columns[b][k]).sum();
                    columns[a][i] * along
                })
                .sum()
        })
    })
}
