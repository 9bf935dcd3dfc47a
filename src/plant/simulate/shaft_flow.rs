//! Propagation of four linear states: `dx/dt = A x + g` over a step, `A` of an armature circuit and two inertias.
//!
//! The power series of the solution needs a few products with a sparse `A`; step lengths that repeat get matrices
//! (`x(t) = Phi x(0) + Gamma g`), made by the same series.

/// Current, speed of the motor, speed of the load, twist as a speed (natural frequency times twist).
pub(super) type X = [f64; 4];

/// Non-zero elements of `A`, rows named by what they drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sparse {
    /// Current from current and motor speed.
    pub(super) current: [f64; 2],
    /// Motor speed from current, motor speed, load speed and twist.
    pub(super) motor: X,
    /// Load speed from motor speed, load speed and twist.
    pub(super) load: [f64; 3],
    /// Twist from motor speed and load speed.
    pub(super) twist: [f64; 2],
}

impl Sparse {
    #[inline]
    fn times(&self, x: X) -> X {
        let (c, m, l, t) = (&self.current, &self.motor, &self.load, &self.twist);
        [
            c[0] * x[0] + c[1] * x[1],
            (m[0] * x[0] + m[1] * x[1]) + (m[2] * x[2] + m[3] * x[3]),
            l[0] * x[1] + l[1] * x[2] + l[2] * x[3],
            t[0] * x[1] + t[1] * x[2],
        ]
    }

    /// An upper bound of the rates that the series has to resolve.
    fn size(&self) -> f64 {
        let (c, m, l, t) = (&self.current, &self.motor, &self.load, &self.twist);
        // Products across the diagonal: independent of the units of the states.
        c[0].abs()
            + (c[1] * m[0]).abs().sqrt()
            + m[1].abs().max(l[1].abs())
            + ((m[3] * t[0]).abs() + (l[2] * t[1]).abs()).sqrt()
    }
}

/// Rates times step up to which the series is used as it is.
const LONGEST_SERIES: f64 = 1.0;
/// Terms of the series: at a product of one the rest is below 1e-16.
const MOST_TERMS: u32 = 18;

/// `Phi` and the first three columns of `Gamma` (nothing forces the twist), by columns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Matrices {
    phi: [X; 4],
    gamma: [X; 3],
}

impl Matrices {
    #[inline]
    pub(super) fn apply(&self, x: X, g: [f64; 3]) -> X {
        let mut out = [0.0; 4];
        for (row, cell) in out.iter_mut().enumerate() {
            let (p, q) = (&self.phi, &self.gamma);
            *cell = (p[0][row] * x[0] + p[1][row] * x[1])
                + (p[2][row] * x[2] + p[3][row] * x[3])
                + (q[0][row] * g[0] + q[1][row] * g[1] + q[2][row] * g[2]);
        }
        out
    }

    fn over(a: &Sparse, t: f64) -> Self {
        let halvings = (a.size() * t / LONGEST_SERIES).log2().ceil().max(0.0);
        let short = t / halvings.exp2();
        let mut all = Self::default();
        for column in 0..4 {
            let mut unit = [0.0; 4];
            unit[column] = 1.0;
            all.phi[column] = series(a, unit, [0.0; 3], short);
        }
        for column in 0..3 {
            let mut unit = [0.0; 3];
            unit[column] = 1.0;
            all.gamma[column] = series(a, [0.0; 4], unit, short);
        }
        let mut doublings = 0.0;
        while doublings < halvings {
            // Phi(2t) = Phi(t) Phi(t), Gamma(2t) = Phi(t) Gamma(t) + Gamma(t).
            let half = all;
            for column in 0..4 {
                all.phi[column] = half.apply(half.phi[column], [0.0; 3]);
            }
            for column in 0..3 {
                let mut unit = [0.0; 3];
                unit[column] = 1.0;
                all.gamma[column] = half.apply(half.gamma[column], unit);
            }
            doublings += 1.0;
        }
        all
    }
}

/// `x + sum of t^n/n! A^(n-1) (A x + g)`.
#[inline]
fn series(a: &Sparse, x: X, g: [f64; 3], t: f64) -> X {
    let mut out = x;
    let rate = a.times(x);
    let mut term = [rate[0] + g[0], rate[1] + g[1], rate[2] + g[2], rate[3]];
    for order in 1..=MOST_TERMS {
        let factor = t / f64::from(order);
        let mut largest_change = 0.0_f64;
        for (sum, part) in out.iter_mut().zip(&mut term) {
            *part *= factor;
            *sum += *part;
            largest_change = largest_change.max(part.abs() - 1e-17 * sum.abs());
        }
        if largest_change <= 0.0 {
            break;
        }
        term = a.times(term);
    }
    out
}

/// Matrices of one step length over the whole step and half of it.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    length_s: f64,
    whole: Matrices,
    half: Matrices,
}

/// Lengths that differ by less, relative, are one: stamps carry rounding.
const SAME_LENGTH: f64 = 1e-9;

fn same(one: f64, other: f64) -> bool {
    (one - other).abs() <= SAME_LENGTH * other
}

/// One linear mode with the matrices of its two latest repeated step lengths.
#[derive(Clone, Debug, Default)]
pub(super) struct Flow {
    a: Sparse,
    size: f64,
    with_half: bool,
    steps: [Step; 2],
    last: usize,
    /// Latest length that had no matrices.
    missed_s: f64,
}

impl Flow {
    pub(super) fn new(a: Sparse, with_half: bool) -> Self {
        Self {
            a,
            size: a.size(),
            with_half,
            ..Self::default()
        }
    }

    /// Forgets all lengths, so that a run does not depend on the one before.
    pub(super) fn clear(&mut self) {
        self.steps = [Step::default(); 2];
        self.missed_s = 0.0;
    }

    /// Makes a step of this length ready. A length that comes only once, as up to an event, gets no matrices.
    #[inline]
    pub(super) fn ready(&mut self, length_s: f64) {
        if same(self.steps[self.last].length_s, length_s) {
            return;
        }
        self.last = 1 - self.last;
        if !same(self.steps[self.last].length_s, length_s) {
            self.last = 1 - self.last;
            self.miss(length_s);
        }
    }

    #[inline(never)]
    fn miss(&mut self, length_s: f64) {
        if same(self.missed_s, length_s) {
            self.last = 1 - self.last;
            self.steps[self.last] = Step {
                length_s,
                whole: Matrices::over(&self.a, length_s),
                half: if self.with_half {
                    Matrices::over(&self.a, 0.5 * length_s)
                } else {
                    Matrices::default()
                },
            };
        }
        self.missed_s = length_s;
    }

    /// Time derivatives of the states.
    #[inline]
    pub(super) fn rates(&self, x: X, g: [f64; 3]) -> X {
        let rates = self.a.times(x);
        [rates[0] + g[0], rates[1] + g[1], rates[2] + g[2], rates[3]]
    }

    /// The state after `length_s`.
    #[inline]
    pub(super) fn whole(&self, x: X, g: [f64; 3], length_s: f64) -> X {
        let step = &self.steps[self.last];
        if same(step.length_s, length_s) {
            step.whole.apply(x, g)
        } else {
            self.once(x, g, length_s)
        }
    }

    /// The state after half of `length_s`.
    #[inline]
    pub(super) fn half(&self, x: X, g: [f64; 3], length_s: f64) -> X {
        let step = &self.steps[self.last];
        if same(step.length_s, length_s) {
            step.half.apply(x, g)
        } else {
            self.once(x, g, 0.5 * length_s)
        }
    }

    fn once(&self, x: X, g: [f64; 3], t: f64) -> X {
        if self.size * t <= LONGEST_SERIES {
            series(&self.a, x, g, t)
        } else {
            Matrices::over(&self.a, t).apply(x, g)
        }
    }
}
