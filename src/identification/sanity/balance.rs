//! Both balances over short windows, quickly: good enough to tell which column is which, not to identify.
//!
//! `int u = R int i + L (i_b - i_a) + Ke int w` and `int i = (J/Kt) (w_b - w_a) + (Mc/Kt) int sgn w + (B/Kt) int w`,
//! each integral by the trapezoid, so that every column is treated alike whatever it is taken for.

use std::ops::Range;

use nalgebra::{SMatrix, SVector};

use super::table::Table;

/// Speeds below this share of the largest have no direction.
const DEAD_ZONE: f64 = 0.05;
/// Share of a regressor that the others must leave to it: below, its coefficient is not determined.
const LEAST_OWN: f64 = 1e-4;

/// Which columns serve as voltage, current and speed.
#[derive(Clone, Copy)]
pub(super) struct Roles<'a> {
    pub(super) time_s: &'a [f64],
    pub(super) windows: &'a [Range<usize>],
    pub(super) voltage: &'a [f64],
    pub(super) current: &'a [f64],
    pub(super) speed: &'a [f64],
    /// Factors of current and speed: one, or minus one where a sign is tried.
    pub(super) current_sign: f64,
    pub(super) speed_sign: f64,
}

impl<'a> Roles<'a> {
    pub(super) fn of(table: &'a Table) -> Self {
        Self {
            time_s: &table.time_s,
            windows: &table.windows,
            voltage: &table.voltage_v,
            current: &table.current_a,
            speed: &table.speed_rad_s,
            current_sign: 1.0,
            speed_sign: 1.0,
        }
    }
}

/// A coefficient and its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coefficient {
    pub(super) value: f64,
    pub(super) std: f64,
}

/// Standard deviations that make a sign certain.
const CERTAIN: f64 = 5.0;

impl Coefficient {
    pub(super) fn is_negative(&self) -> bool {
        self.value < -CERTAIN * self.std
    }

    pub(super) fn is_positive(&self) -> bool {
        self.value > CERTAIN * self.std
    }
}

/// What both balances say under one assignment of the columns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Balances {
    pub(super) resistance: Coefficient,
    pub(super) inductance: Coefficient,
    pub(super) back_emf: Coefficient,
    /// Root mean square of what is left over that of the voltage.
    pub(super) voltage_error: f64,
    /// Inertia over the torque constant.
    pub(super) inertia: Coefficient,
    /// Root mean square of what is left over that of the current.
    pub(super) torque_error: f64,
}

impl Balances {
    pub(super) fn of(roles: &Roles<'_>) -> Option<Self> {
        let sums = sums(roles);
        let rows: Vec<_> = sums
            .iter()
            .map(|s| ([s.current, s.current_step, s.angle], s.voltage))
            .collect();
        let electrical = fit(&rows)?;
        let rows: Vec<_> = sums
            .iter()
            .filter(|s| s.direction != 0.0)
            .map(|s| ([s.speed_step, s.direction * s.length_s, s.angle], s.current))
            .collect();
        let mechanical = fit(&rows)?;
        Some(Self {
            resistance: electrical.coefficient(0),
            inductance: electrical.coefficient(1),
            back_emf: electrical.coefficient(2),
            voltage_error: electrical.error,
            inertia: mechanical.coefficient(0),
            torque_error: mechanical.error,
        })
    }

    /// Both errors as one number.
    pub(super) fn error(&self) -> f64 {
        self.voltage_error.hypot(self.torque_error)
    }

    /// Every coefficient has the sign that physics wants, for certain.
    pub(super) fn is_physical(&self) -> bool {
        self.resistance.is_positive()
            && self.back_emf.is_positive()
            && self.inertia.is_positive()
            && !self.inductance.is_negative()
    }

    /// The first coefficient that has the wrong sign for certain.
    pub(super) fn impossible(&self) -> Option<(&'static str, f64)> {
        [
            ("a resistance", self.resistance),
            ("a back-EMF constant", self.back_emf),
            ("an inertia", self.inertia),
        ]
        .into_iter()
        .find(|(_, coefficient)| coefficient.is_negative())
        .map(|(name, coefficient)| (name, coefficient.value))
    }
}

/// What resistance and inductance alone leave of the voltage: root mean square over that of the voltage.
pub(super) fn voltage_at_rest(roles: &Roles<'_>) -> Option<f64> {
    let rows: Vec<_> = sums(roles)
        .iter()
        .map(|s| ([s.current, s.current_step], s.voltage))
        .collect();
    fit(&rows).map(|fit| fit.error)
}

/// Back-EMF constant from voltage and speed alone: what a running motor without a current shows, roughly.
pub(super) fn back_emf_without_current(roles: &Roles<'_>) -> Option<Coefficient> {
    let rows: Vec<_> = sums(roles)
        .iter()
        .filter(|s| s.direction != 0.0)
        .map(|s| ([s.angle, s.direction * s.length_s], s.voltage))
        .collect();
    fit(&rows).map(|fit| fit.coefficient(0))
}

/// Integrals over one window.
struct Sums {
    length_s: f64,
    voltage: f64,
    current: f64,
    current_step: f64,
    /// Integral of the speed.
    angle: f64,
    speed_step: f64,
    /// Sign of the speed where it is the same over the window, else zero.
    direction: f64,
}

fn sums(roles: &Roles<'_>) -> Vec<Sums> {
    let times = roles.time_s;
    let largest = roles
        .speed
        .iter()
        .filter(|w| w.is_finite())
        .fold(0.0, |most, w| f64::max(most, w.abs()));
    let zone = DEAD_ZONE * largest;
    let mut sums = Vec::new();
    for window in roles.windows {
        let (begin, end) = (window.start, window.end);
        let trapezoid = |values: &[f64], sign: f64| -> f64 {
            (begin..end)
                .map(|k| 0.5 * sign * (values[k] + values[k + 1]) * (times[k + 1] - times[k]))
                .sum()
        };
        let speeds = &roles.speed[begin..=end];
        let ahead = speeds.iter().all(|w| *w > zone);
        let astern = speeds.iter().all(|w| *w < -zone);
        sums.push(Sums {
            length_s: times[end] - times[begin],
            voltage: trapezoid(roles.voltage, 1.0),
            current: trapezoid(roles.current, roles.current_sign),
            current_step: roles.current_sign * (roles.current[end] - roles.current[begin]),
            angle: trapezoid(roles.speed, roles.speed_sign),
            speed_step: roles.speed_sign * (roles.speed[end] - roles.speed[begin]),
            direction: roles.speed_sign * f64::from(i8::from(ahead) - i8::from(astern)),
        });
    }
    sums
}

struct Fit<const N: usize> {
    x: [f64; N],
    std: [f64; N],
    error: f64,
}

impl<const N: usize> Fit<N> {
    const fn coefficient(&self, index: usize) -> Coefficient {
        Coefficient {
            value: self.x[index],
            std: self.std[index],
        }
    }
}

/// Least squares by normal equations of scaled columns: a few coefficients, no precision wanted. Rows with a missing
/// value are left out; `None` where a coefficient is not determined.
fn fit<const N: usize>(rows: &[([f64; N], f64)]) -> Option<Fit<N>> {
    let good = || {
        rows.iter()
            .filter(|(x, y)| y.is_finite() && x.iter().all(|x| x.is_finite()))
    };
    let count = good().count();
    if count < 4 * N {
        return None;
    }
    let mut scale = [0.0_f64; N];
    let mut level = 0.0;
    for (x, y) in good() {
        for (scale, x) in scale.iter_mut().zip(x) {
            *scale += x * x;
        }
        level += y * y;
    }
    let scale = scale.map(f64::sqrt);
    if level <= 0.0 || scale.iter().any(|scale| *scale <= 0.0) {
        return None;
    }
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    for (x, y) in good() {
        let x = SVector::<f64, N>::from_fn(|index, _| x[index] / scale[index]);
        normal += x * x.transpose();
        right += x * *y;
    }
    let inverse = normal.try_inverse()?;
    // The inverse's diagonal is one over the share of a column that the others do not explain.
    if (0..N).any(|k| !(inverse[(k, k)] > 0.0 && inverse[(k, k)] < 1.0 / LEAST_OWN)) {
        return None;
    }
    let solution = inverse * right;
    let left: f64 = good()
        .map(|(x, y)| {
            let sum: f64 = (0..N).map(|k| solution[k] * x[k] / scale[k]).sum();
            (y - sum).powi(2)
        })
        .sum();
    let variance = left / (count - N) as f64;
    Some(Fit {
        x: std::array::from_fn(|k| solution[k] / scale[k]),
        std: std::array::from_fn(|k| (variance * inverse[(k, k)]).sqrt() / scale[k]),
        error: (left / level).sqrt(),
    })
}
