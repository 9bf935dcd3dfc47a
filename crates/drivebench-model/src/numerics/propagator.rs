//! Variation of constants over one interval: `x(t) = Phi x(0) + Gamma g` for `dx/dt = A x + g` with constant `g` (zero-order
//! hold; Astrom and Wittenmark, *Computer-Controlled Systems*, section 2.3).

pub type M2 = [[f64; 2]; 2];

/// `Phi = exp(A t)` and `Gamma = integral of exp(A s) ds from 0 to t`, in closed form: by Cayley-Hamilton both are
/// `c I + s (A - m I)` with `c`, `s` from the eigenvalues of `A` and `m` their mean (Moler and Van Loan 2003, method 8).
#[derive(Clone, Copy, Debug, Default)]
pub struct Propagator {
    pub phi: M2,
    pub gamma: M2,
}

/// `A` with the quantities that its exponential over any interval needs.
#[derive(Clone, Copy, Debug)]
pub struct LinearPart {
    a: M2,
    /// Mean of the eigenvalues, and the square of their half distance (negative for a complex pair).
    mean: f64,
    square: f64,
    determinant: f64,
    /// Bound of the absolute values of the eigenvalues.
    size: f64,
    real: Option<RealEigenvalues>,
}

#[derive(Clone, Copy, Debug)]
struct RealEigenvalues {
    each: [f64; 2],
    inverse: [f64; 2],
    over_distance: f64,
}

impl LinearPart {
    #[inline]
    pub fn new(a: &M2) -> Self {
        let mean = 0.5 * (a[0][0] + a[1][1]);
        let half = 0.5 * (a[0][0] - a[1][1]);
        let square = half * half + a[0][1] * a[1][0];
        let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        let real = (square > 1e-6 * mean * mean && square > 0.0).then(|| {
            let q = square.sqrt();
            // The smaller eigenvalue from the product of both: no cancellation when they are far apart.
            let each = if mean < 0.0 {
                let far = mean - q;
                [determinant / far, far]
            } else {
                [mean + q, mean - q]
            };
            RealEigenvalues { each, inverse: each.map(|rate| 1.0 / rate), over_distance: 0.5 / q }
        });
        Self { a: *a, mean, square, determinant, size: mean.abs() + square.abs().sqrt(), real }
    }

    fn is_short(&self, t: f64) -> bool {
        self.size * t < 1e-3
    }

    #[inline]
    pub fn over(&self, t: f64) -> Propagator {
        if self.is_short(t) {
            return taylor(&self.a, t);
        }
        match &self.real {
            Some(real) => self.assemble(real, real.each.map(|rate| (rate * t).exp_m1()), t),
            None => self.oscillating(t),
        }
    }

    pub fn over_both(&self, t: f64) -> (Propagator, Propagator) {
        match &self.real {
            Some(real) if !self.is_short(0.5 * t) => {
                // exp(x) - 1 = h (h + 2) with h = exp(x/2) - 1: one exponential serves both.
                let half = real.each.map(|rate| (0.5 * rate * t).exp_m1());
                let whole = half.map(|h| h * (h + 2.0));
                let over = |expm1, t| self.assemble(real, expm1, t);
                (over(whole, t), over(half, 0.5 * t))
            }
            _ => (self.over(t), self.over(0.5 * t)),
        }
    }

    /// From `exp(rate t) - 1` of both eigenvalues.
    fn assemble(&self, real: &RealEigenvalues, expm1: [f64; 2], t: f64) -> Propagator {
        let integral = |k: usize| match real.each[k] {
            0.0 => t,
            _ => expm1[k] * real.inverse[k],
        };
        let combined = |constant: f64, [one, two]: [f64; 2]| {
            let sum = constant + 0.5 * (one + two);
            combine(&self.a, self.mean, sum, (one - two) * real.over_distance)
        };
        Propagator { phi: combined(1.0, expm1), gamma: combined(0.0, [integral(0), integral(1)]) }
    }

    /// Complex or nearly equal eigenvalues.
    fn oscillating(&self, t: f64) -> Propagator {
        let (a, d, determinant) = (&self.a, self.square, self.determinant);
        let decay = (self.mean * t).exp();
        let (c, s) = if d < 0.0 && (-d).sqrt() * t > 1e-4 {
            let w = (-d).sqrt();
            ((w * t).cos(), (w * t).sin() / w)
        } else {
            // cosh and sinh of a small argument, to fourth order.
            let z = d * t * t;
            (1.0 + z / 2.0 + z * z / 24.0, t * (1.0 + z / 6.0 + z * z / 120.0))
        };
        let phi = combine(a, self.mean, decay * c, decay * s);
        // Gamma = A^-1 (Phi - I); the determinant is m^2 - d > 0 here.
        let p = [[phi[0][0] - 1.0, phi[0][1]], [phi[1][0], phi[1][1] - 1.0]];
        let inverse = [
            [a[1][1] / determinant, -a[0][1] / determinant],
            [-a[1][0] / determinant, a[0][0] / determinant],
        ];
        Propagator { phi, gamma: multiply(&inverse, &p) }
    }
}

impl Propagator {
    /// State after the interval under a constant forcing `g`.
    #[inline]
    pub fn apply(&self, x: [f64; 2], g: [f64; 2]) -> [f64; 2] {
        let (p, q) = (&self.phi, &self.gamma);
        [
            p[0][0] * x[0] + p[0][1] * x[1] + q[0][0] * g[0] + q[0][1] * g[1],
            p[1][0] * x[0] + p[1][1] * x[1] + q[1][0] * g[0] + q[1][1] * g[1],
        ]
    }

    /// This interval followed by another one, the forcing constant over both.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        let mut gamma = multiply(&next.phi, &self.gamma);
        for (line, added) in gamma.iter_mut().zip(&next.gamma) {
            for (cell, added) in line.iter_mut().zip(added) {
                *cell += added;
            }
        }
        Self { phi: multiply(&next.phi, &self.phi), gamma }
    }
}

/// `c I + s (A - m I)`.
fn combine(a: &M2, m: f64, c: f64, s: f64) -> M2 {
    [[c + s * (a[0][0] - m), s * a[0][1]], [s * a[1][0], c + s * (a[1][1] - m)]]
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
fn taylor(a: &M2, t: f64) -> Propagator {
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
    Propagator { phi, gamma }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Independent formulation: many small fourth-order Runge-Kutta steps.
    fn reference(a: &M2, t: f64, x: [f64; 2], g: [f64; 2]) -> [f64; 2] {
        let h = t / 20_000.0;
        let rate = |x: [f64; 2]| [0, 1].map(|n| a[n][0] * x[0] + a[n][1] * x[1] + g[n]);
        let along = |x: [f64; 2], k: [f64; 2], s: f64| [x[0] + s * k[0], x[1] + s * k[1]];
        (0..20_000).fold(x, |x, _| {
            let k1 = rate(x);
            let k2 = rate(along(x, k1, h / 2.0));
            let k3 = rate(along(x, k2, h / 2.0));
            let k4 = rate(along(x, k3, h));
            [0, 1].map(|n| x[n] + h / 6.0 * (k1[n] + 2.0 * k2[n] + 2.0 * k3[n] + k4[n]))
        })
    }

    #[test]
    fn all_kinds_of_eigenvalues_agree_with_small_steps() {
        // A motor with its poles real, a pair (small inertia) and equal (`TM = 4 Ta`), and with viscous friction.
        let motor = |j: f64, b: f64| -> M2 {
            let (r, l, k) = (1.1, 0.0099, 0.3538);
            [[-r / l, -k / l], [k / j, -b / j]]
        };
        let cases: [M2; 10] = [
            motor(0.0045, 0.0),
            motor(0.0005, 0.0),
            motor(4.0 * 0.0099 * 0.3538 * 0.3538 / (1.1 * 1.1), 0.0),
            motor(0.0045, 0.02),
            [[-111.0, -35.7], [78.6, 0.0]],
            [[-20.0, -35.7], [78.6, 0.0]],
            [[-2.0, -1.0], [1.0, 0.0]],
            [[0.0, 0.0], [1.0, 0.0]],
            [[-500.0, -1.0], [1.0, 0.0]],
            [[-3.0, 0.0], [0.0, -3.0]],
        ];
        for a in &cases {
            let linear = LinearPart::new(a);
            for t in [1e-6, 1e-4, 1e-3, 0.02, 0.3] {
                let (x, g) = ([1.5, -0.7], [300.0, -4.0]);
                let steps = reference(a, t, x, g);
                let (both, twice) = (linear.over_both(t).0, linear.over_both(2.0 * t).1);
                let parts = linear.over(0.3 * t).then(&linear.over(0.7 * t));
                for (way, found) in [linear.over(t), both, twice, parts].iter().enumerate() {
                    let exact = found.apply(x, g);
                    let is_near =
                        |n: usize| (exact[n] - steps[n]).abs() < 1e-8 * steps[n].abs().max(1e-3);
                    assert!(is_near(0) && is_near(1), "{way} {a:?} {t} {exact:?} {steps:?}");
                }
            }
        }
    }

    #[test]
    fn a_very_stiff_circuit_stays_finite_and_settles() {
        let stiff = LinearPart::new(&[[-1e7, -1e5], [80.0, 0.0]]);
        let x = stiff.over(0.01).apply([0.0, 0.0], [1e7, 0.0]);
        assert!(x[0].is_finite() && (x[0] - 1.0).abs() < 0.02, "{x:?}");
    }
}
