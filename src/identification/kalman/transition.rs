//! Current and speed over one interval of held voltage and unchanged direction, in closed form.
//!
//! `L di/dt = u - R i - Ke w`, `J dw/dt = Kt i - B w - (s Mc + TL)`: linear, so `x(h) = Phi x + G b` with the matrix
//! exponential of a 2 by 2 matrix. Nothing is assumed about the interval against L/R.

/// R, L, Ke, Kt, J and what friction adds per speed, SI units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Physics {
    pub(super) r: f64,
    pub(super) l: f64,
    pub(super) ke: f64,
    pub(super) kt: f64,
    pub(super) j: f64,
    pub(super) b: f64,
}

/// Phi and its integral G over a time h.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) phi: [[f64; 2]; 2],
    pub(super) gain: [[f64; 2]; 2],
}

/// Eigenvalues closer than this share of their mean are taken through the series of sinh(x)/x.
const NEAR: f64 = 1e-4;

impl Physics {
    /// The shaft turns.
    pub(super) fn turning(&self, h: f64) -> Step {
        let (a11, a12) = (-self.r / self.l, -self.ke / self.l);
        let (a21, a22) = (self.kt / self.j, -self.b / self.j);
        let (mean, half) = (0.5 * (a11 + a22), 0.5 * (a11 - a22));
        // exp(A h) = exp(mean h) (c I + s (A - mean I)), c = cosh(d h), s = sinh(d h)/d, d^2 = square.
        let square = half * half + a12 * a21;
        let (c, s) = hyperbolic(square, mean, h);
        let phi = [[c + s * half, s * a12], [s * a21, c - s * half]];
        // G = A^-1 (Phi - I); the determinant is positive for every motor.
        let determinant = a11 * a22 - a12 * a21;
        let (p11, p22) = (phi[0][0] - 1.0, phi[1][1] - 1.0);
        let gain = [
            [
                (a22 * p11 - a12 * phi[1][0]) / determinant,
                (a22 * phi[0][1] - a12 * p22) / determinant,
            ],
            [
                (a11 * phi[1][0] - a21 * p11) / determinant,
                (a11 * p22 - a21 * phi[0][1]) / determinant,
            ],
        ];
        Step { phi, gain }
    }

    /// The shaft stands: only the winding lives.
    pub(super) fn at_rest(&self, h: f64) -> Step {
        let lost = -(-h * self.r / self.l).exp_m1();
        Step {
            phi: [[1.0 - lost, 0.0], [0.0, 0.0]],
            gain: [[lost * self.l / self.r, 0.0], [0.0, 0.0]],
        }
    }

    /// Right-hand side of the state equation for a voltage and a torque against positive speed.
    pub(super) fn forcing(&self, voltage_v: f64, torque_n_m: f64) -> [f64; 2] {
        [voltage_v / self.l, -torque_n_m / self.j]
    }
}

/// `exp(mean h) cosh(d h)` and `exp(mean h) sinh(d h)/d` for `d^2 = square`, which may be negative.
fn hyperbolic(square: f64, mean: f64, h: f64) -> (f64, f64) {
    let x2 = square * h * h;
    if x2.abs() < NEAR {
        let decay = (mean * h).exp();
        let c = 1.0 + x2 * (0.5 + x2 * (1.0 / 24.0 + x2 / 720.0));
        let s = h * (1.0 + x2 * (1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 / 5040.0)));
        (decay * c, decay * s)
    } else if square > 0.0 {
        let d = square.sqrt();
        // Each exponent by itself: the product of a large and a small one would overflow.
        let (slow, fast) = (((mean + d) * h).exp(), ((mean - d) * h).exp());
        (0.5 * (slow + fast), 0.5 * (slow - fast) / d)
    } else {
        let d = (-square).sqrt();
        let decay = (mean * h).exp();
        let (sine, cosine) = (d * h).sin_cos();
        (decay * cosine, decay * sine / d)
    }
}

impl Step {
    pub(super) fn apply(&self, x: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        let (phi, g) = (&self.phi, &self.gain);
        [
            phi[0][0] * x[0] + phi[0][1] * x[1] + g[0][0] * b[0] + g[0][1] * b[1],
            phi[1][0] * x[0] + phi[1][1] * x[1] + g[1][0] * b[0] + g[1][1] * b[1],
        ]
    }
}

impl Step {
    /// This step and another one after it. The gain is that of a forcing which holds over both.
    pub(super) fn then(&self, next: &Self) -> Self {
        let product = |a: &[[f64; 2]; 2], k: usize, m: usize| {
            next.phi[k][0] * a[0][m] + next.phi[k][1] * a[1][m]
        };
        let phi = [0, 1].map(|k| [0, 1].map(|m| product(&self.phi, k, m)));
        let gain = [0, 1].map(|k| [0, 1].map(|m| product(&self.gain, k, m) + next.gain[k][m]));
        Self { phi, gain }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn runge_kutta(p: &Physics, x: [f64; 2], b: [f64; 2], h: f64) -> [f64; 2] {
        let f = |x: [f64; 2]| {
            [
                -(p.r * x[0] + p.ke * x[1]) / p.l + b[0],
                (p.kt * x[0] - p.b * x[1]) / p.j + b[1],
            ]
        };
        let steps = 20_000;
        let d = h / f64::from(steps);
        let add = |x: [f64; 2], k: [f64; 2], c: f64| [x[0] + c * k[0], x[1] + c * k[1]];
        (0..steps).fold(x, |x, _| {
            let k1 = f(x);
            let k2 = f(add(x, k1, 0.5 * d));
            let k3 = f(add(x, k2, 0.5 * d));
            let k4 = f(add(x, k3, d));
            [0, 1].map(|j| x[j] + d / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]))
        })
    }

    #[test]
    fn the_closed_form_is_the_integral_of_the_equations() {
        let base = Physics {
            r: 1.1,
            l: 0.0099,
            ke: 0.3538,
            kt: 0.3538,
            j: 0.0045,
            b: 0.0,
        };
        // Real poles, a complex pair (small inertia), nearly equal poles (TM = 4 Ta), viscous friction.
        let equal = 4.0 * 0.0099 * 0.3538 * 0.3538 / (1.1 * 1.1);
        for p in [
            base,
            Physics { j: 0.0005, ..base },
            Physics { j: equal, ..base },
            Physics { b: 0.02, ..base },
        ] {
            for h in [1e-4, 1e-3, 0.01, 0.05] {
                let (x, b) = ([3.0, -20.0], p.forcing(30.0, 0.4));
                let exact = p.turning(h).apply(x, b);
                let fine = runge_kutta(&p, x, b, h);
                for j in 0..2 {
                    let error = (exact[j] - fine[j]).abs() / (1.0 + fine[j].abs());
                    assert!(error < 1e-9, "{p:?} {h} {exact:?} {fine:?}");
                }
            }
        }
    }

    #[test]
    fn two_steps_make_the_whole() {
        let p = Physics {
            r: 1.1,
            l: 0.0099,
            ke: 0.3538,
            kt: 0.4,
            j: 0.0045,
            b: 0.001,
        };
        let (whole, parts) = (p.turning(0.01), p.turning(0.003).then(&p.turning(0.007)));
        for k in 0..2 {
            for m in 0..2 {
                assert!((whole.phi[k][m] - parts.phi[k][m]).abs() < 1e-12);
                assert!((whole.gain[k][m] - parts.gain[k][m]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn many_time_constants_end_in_the_steady_state() {
        let p = Physics {
            r: 1.1,
            l: 1e-6,
            ke: 0.35,
            kt: 0.35,
            j: 1e-4,
            b: 0.0,
        };
        let x = p.turning(2.0).apply([5.0, 0.0], p.forcing(10.0, 0.35));
        assert!((x[0] - 1.0).abs() < 1e-9, "{x:?}");
        assert!((x[1] - (10.0 - 1.1) / 0.35).abs() < 1e-7, "{x:?}");
        let held = p.at_rest(1.0).apply([5.0, 0.0], p.forcing(10.0, 0.35));
        assert!((held[0] - 10.0 / 1.1).abs() < 1e-9 && held[1].abs() < 1e-300);
    }
}
