//! Exact propagation of the linear part over one interval: `x(t) = Phi x(0) + Gamma g` for `dx/dt = A x + g`.

/// A two-by-two matrix, row by row.
pub(crate) type M2 = [[f64; 2]; 2];

/// `Phi = exp(A t)` and `Gamma = integral of exp(A s) ds from 0 to t`, in closed form from the eigenvalues of `A`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Propagator {
    pub(super) interval_s: f64,
    phi: M2,
    gamma: M2,
}

impl Propagator {
    pub(crate) fn new(a: &M2, t: f64) -> Self {
        // m: mean of the eigenvalues; d: square of their half distance.
        let m = 0.5 * (a[0][0] + a[1][1]);
        let half = 0.5 * (a[0][0] - a[1][1]);
        let d = half * half + a[0][1] * a[1][0];
        let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        let size = (m.abs() + d.abs().sqrt()) * t;
        let (phi, gamma) = if size < 1e-3 {
            taylor(a, t)
        } else if d > 1e-6 * m * m {
            let q = d.sqrt();
            // The smaller eigenvalue from the product of both: no cancellation when they are far apart.
            let (l1, l2) = if m < 0.0 {
                let far = m - q;
                (determinant / far, far)
            } else {
                (m + q, m - q)
            };
            let (e1, e2) = ((l1 * t).exp(), (l2 * t).exp());
            let (f1, f2) = (integral_of_exp(l1, t), integral_of_exp(l2, t));
            (
                combine(a, m, 0.5 * (e1 + e2), (e1 - e2) / (2.0 * q)),
                combine(a, m, 0.5 * (f1 + f2), (f1 - f2) / (2.0 * q)),
            )
        } else {
            let decay = (m * t).exp();
            let (c, s) = if d < 0.0 && (-d).sqrt() * t > 1e-4 {
                let w = (-d).sqrt();
                ((w * t).cos(), (w * t).sin() / w)
            } else {
                // cosh and sinh of a small argument, to fourth order.
                let z = d * t * t;
                (
                    1.0 + z / 2.0 + z * z / 24.0,
                    t * (1.0 + z / 6.0 + z * z / 120.0),
                )
            };
            let phi = combine(a, m, decay * c, decay * s);
            // Gamma = A^-1 (Phi - I); the determinant is m^2 - d > 0 here.
            let p = [[phi[0][0] - 1.0, phi[0][1]], [phi[1][0], phi[1][1] - 1.0]];
            let inverse = [
                [a[1][1] / determinant, -a[0][1] / determinant],
                [-a[1][0] / determinant, a[0][0] / determinant],
            ];
            (phi, multiply(&inverse, &p))
        };
        Self {
            interval_s: t,
            phi,
            gamma,
        }
    }

    /// State after the interval under a constant forcing `g`.
    #[inline]
    pub(crate) fn apply(&self, x: [f64; 2], g: [f64; 2]) -> [f64; 2] {
        let (p, q) = (&self.phi, &self.gamma);
        [
            p[0][0] * x[0] + p[0][1] * x[1] + q[0][0] * g[0] + q[0][1] * g[1],
            p[1][0] * x[0] + p[1][1] * x[1] + q[1][0] * g[0] + q[1][1] * g[1],
        ]
    }
}

/// `c I + s (A - m I)`.
fn combine(a: &M2, m: f64, c: f64, s: f64) -> M2 {
    [
        [c + s * (a[0][0] - m), s * a[0][1]],
        [s * a[1][0], c + s * (a[1][1] - m)],
    ]
}

fn integral_of_exp(rate: f64, t: f64) -> f64 {
    if rate == 0.0 {
        t
    } else {
        (rate * t).exp_m1() / rate
    }
}

fn multiply(a: &M2, b: &M2) -> M2 {
    let mut out = [[0.0; 2]; 2];
    for (row, line) in out.iter_mut().enumerate() {
        for (column, cell) in line.iter_mut().enumerate() {
            *cell = a[row][0] * b[0][column] + a[row][1] * b[1][column];
        }
    }
    out
}

/// Power series for a short interval, where differences of exponentials would cancel; the remainder is below 1e-17.
fn taylor(a: &M2, t: f64) -> (M2, M2) {
    let identity = [[1.0, 0.0], [0.0, 1.0]];
    let (mut phi, mut gamma) = (identity, [[t, 0.0], [0.0, t]]);
    let mut term = identity;
    for order in 1..=5 {
        let next = multiply(&term, a);
        for row in 0..2 {
            for column in 0..2 {
                term[row][column] = next[row][column] * t / f64::from(order);
                phi[row][column] += term[row][column];
                gamma[row][column] += term[row][column] * t / f64::from(order + 1);
            }
        }
    }
    (phi, gamma)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Independent formulation: many small fourth-order Runge-Kutta steps.
    fn reference(a: &M2, t: f64, x: [f64; 2], g: [f64; 2]) -> [f64; 2] {
        let steps = 20_000;
        let h = t / f64::from(steps);
        let f = |x: [f64; 2]| {
            [
                a[0][0] * x[0] + a[0][1] * x[1] + g[0],
                a[1][0] * x[0] + a[1][1] * x[1] + g[1],
            ]
        };
        let along = |x: [f64; 2], k: [f64; 2], s: f64| [x[0] + s * k[0], x[1] + s * k[1]];
        (0..steps).fold(x, |x, _| {
            let k1 = f(x);
            let k2 = f(along(x, k1, h / 2.0));
            let k3 = f(along(x, k2, h / 2.0));
            let k4 = f(along(x, k3, h));
            [0, 1].map(|n| x[n] + h / 6.0 * (k1[n] + 2.0 * k2[n] + 2.0 * k3[n] + k4[n]))
        })
    }

    #[test]
    fn agrees_with_small_steps_for_real_complex_double_and_nilpotent_eigenvalues() {
        let cases: [M2; 6] = [
            [[-111.0, -35.7], [78.6, 0.0]],
            [[-20.0, -35.7], [78.6, 0.0]],
            [[-2.0, -1.0], [1.0, 0.0]],
            [[0.0, 0.0], [1.0, 0.0]],
            [[-500.0, -1.0], [1.0, 0.0]],
            [[-3.0, 0.0], [0.0, -3.0]],
        ];
        for a in &cases {
            for t in [1e-6, 1e-4, 1e-3, 0.02, 0.3] {
                let exact = Propagator::new(a, t).apply([1.5, -0.7], [300.0, -4.0]);
                let small_steps = reference(a, t, [1.5, -0.7], [300.0, -4.0]);
                for n in 0..2 {
                    let scale = small_steps[n].abs().max(1e-3);
                    assert!(
                        (exact[n] - small_steps[n]).abs() < 1e-8 * scale,
                        "{a:?} {t} {exact:?} {small_steps:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_very_stiff_circuit_stays_finite_and_settles() {
        let x = Propagator::new(&[[-1e7, -1e5], [80.0, 0.0]], 0.01).apply([0.0, 0.0], [1e7, 0.0]);
        assert!(x[0].is_finite() && (x[0] - 1.0).abs() < 0.02, "{x:?}");
    }
}
