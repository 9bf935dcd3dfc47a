//! Rational transfer function: poles and zeros with their standard deviations, from the spectral lines of a record and not from
//! smoothed points, which would widen a sharp resonance.
//!
//! `Y = (B(s) e^(-s T) U + C(s)) / A(s)`: common poles of all outputs, and a transient `C` for each stretch of the record. Started
//! by the iteration of Sanathanan and Koerner 1963, refined by the weighted nonlinear least squares of Pintelon and
//! Schoukens 2012, "System Identification: A Frequency Domain Approach", sections 9.8 and 9.11.

use drivebench_model::numerics::least_squares::scaled_to_one;
use nalgebra::{Complex, DMatrix, DVector};

use drivebench_model::numerics::levenberg_marquardt::{Options, Problem, minimise};
use drivebench_model::numerics::statistics::largest;

/// Lines of one stretch, all of one plant.
pub(super) struct Lines {
    pub(super) frequency_hz: Vec<f64>,
    pub(super) input: Vec<Complex<f64>>,
    /// For each output what was measured and the deviation of its noise, per line.
    pub(super) outputs: Vec<(Vec<Complex<f64>>, Vec<f64>)>,
}

/// A root of the denominator, or of the numerator of an output: a pair that swings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    pub(super) frequency_hz: f64,
    pub(super) damping_ratio: f64,
    pub(super) frequency_std_hz: f64,
    pub(super) damping_std: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Rational {
    /// Of the denominator.
    pub(super) poles: Vec<Pair>,
    /// Of the numerator of each output.
    pub(super) zeros: Vec<Vec<Pair>>,
}

/// The model with the order of the smallest BIC; `None` where no order has a minimum.
pub(super) fn fit(stretches: &[Lines], period_s: f64) -> Option<Rational> {
    let task = Task::new(stretches, period_s)?;
    let best = (2..=6).filter_map(|order| task.of_order(order)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, found)| found)
}

/// One line of one output, ready for a fit.
struct Row {
    stretch: usize,
    output: usize,
    /// `j w` over the unit of frequency.
    s: Complex<f64>,
    input: Complex<f64>,
    measured: Complex<f64>,
    /// Over the deviation of a real or imaginary part.
    weight: f64,
}

struct Task {
    rows: Vec<Row>,
    stretches: usize,
    outputs: usize,
    /// rad/s.
    unit: f64,
    period: f64,
}

/// Ranges of the coefficients of each polynomial in the parameter vector.
#[derive(Clone, Copy)]
struct Layout {
    order: usize,
    outputs: usize,
}

impl Layout {
    /// `a0 .. a(n-1)`; the leading one is 1.
    const fn denominator(self) -> std::ops::Range<usize> {
        0..self.order
    }

    /// `b0 .. b(n-1)` of an output.
    const fn numerator(self, output: usize) -> std::ops::Range<usize> {
        let from = self.order * (1 + output);
        from..from + self.order
    }

    /// `c0 .. cn` of an output in a stretch.
    const fn transient(self, stretch: usize, output: usize) -> std::ops::Range<usize> {
        let size = self.order + 1;
        let from = self.order * (1 + self.outputs) + size * (stretch * self.outputs + output);
        from..from + size
    }

    /// The dead time is the last.
    const fn size(self, stretches: usize) -> usize {
        self.transient(stretches, 0).start + 1
    }
}

fn powers(s: Complex<f64>) -> impl Iterator<Item = Complex<f64>> {
    std::iter::successors(Some(Complex::new(1.0, 0.0)), move |power| Some(power * s))
}

/// Coefficients from the lowest, real.
fn value(coefficients: &[f64], s: Complex<f64>) -> Complex<f64> {
    coefficients.iter().zip(powers(s)).map(|(coefficient, power)| power * *coefficient).sum()
}

/// The same with a leading 1 behind them.
fn monic(coefficients: &[f64], s: Complex<f64>) -> Complex<f64> {
    let leading = powers(s).nth(coefficients.len()).unwrap_or_default();
    value(coefficients, s) + leading
}

impl Task {
    fn new(stretches: &[Lines], period_s: f64) -> Option<Self> {
        let all = || stretches.iter().flat_map(|lines| lines.frequency_hz.iter());
        let count = all().count();
        if count == 0 {
            return None;
        }
        let unit = (all().map(|hertz| hertz.ln()).sum::<f64>() / count as f64).exp();
        let unit = std::f64::consts::TAU * unit;
        let outputs = stretches[0].outputs.len();
        let mut rows = Vec::new();
        for (stretch, lines) in stretches.iter().enumerate() {
            for (output, (measured, deviation)) in lines.outputs.iter().enumerate() {
                for line in 0..lines.frequency_hz.len() {
                    let w = std::f64::consts::TAU * lines.frequency_hz[line] / unit;
                    let weight = std::f64::consts::SQRT_2 / deviation[line];
                    if weight.is_finite() {
                        rows.push(Row {
                            stretch,
                            output,
                            s: Complex::new(0.0, w),
                            input: lines.input[line],
                            measured: measured[line],
                            weight,
                        });
                    }
                }
            }
        }
        Some(Self { rows, stretches: stretches.len(), outputs, unit, period: period_s * unit })
    }

    /// Bayesian information criterion, the noise's size unknown, and the model.
    fn of_order(&self, order: usize) -> Option<(f64, Rational)> {
        let layout = Layout { order, outputs: self.outputs };
        let size = layout.size(self.stretches);
        let count = 2 * self.rows.len();
        if count < 4 * size {
            return None;
        }
        let starts = [0.0, 1.0, 2.0].map(|periods| self.start(layout, periods * self.period));
        let (_, start) = starts.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let scale: Vec<f64> = start.iter().map(|value| value.abs().max(1e-9)).collect();
        let model = Model { task: self, layout, scale };
        let x: Vec<f64> = start.iter().zip(&model.scale).map(|(v, s)| v / s).collect();
        let options = Options { most_iterations: 60, one_of_many: true, ..Options::default() };
        let minimum = minimise(&model, &x, options)?;
        let (n, k) = (count as f64, size as f64);
        let score = n * (minimum.cost / n).ln() + k * n.ln();
        let parameters = model.parameters(&minimum.x);
        let excess = (minimum.cost / (n - k)).max(1.0);
        let inverse = (minimum.jacobian.tr_mul(&minimum.jacobian)).try_inverse()?;
        let covariance = DMatrix::from_fn(size, size, |a, b| {
            inverse[(a, b)] * excess * model.scale[a] * model.scale[b]
        });
        let pairs = |range: std::ops::Range<usize>, is_monic: bool| {
            let coefficients = &parameters[range.clone()];
            let own = covariance.view((range.start, range.start), (range.len(), range.len()));
            pairs(coefficients, is_monic, &own.into_owned(), self.unit)
        };
        let found = Rational {
            poles: pairs(layout.denominator(), true),
            zeros: (0..self.outputs).map(|output| pairs(layout.numerator(output), false)).collect(),
        };
        score.is_finite().then_some((score, found))
    }

    /// Sanathanan-Koerner iteration at a given dead time: linear after multiplication by the denominator, with that of the previous
    /// round as the weight. Returns the cost too.
    fn start(&self, layout: Layout, dead_time: f64) -> Option<(f64, Vec<f64>)> {
        let unknowns = layout.size(self.stretches) - 1;
        let mut found = vec![0.0; unknowns + 1];
        found[unknowns] = dead_time;
        for round in 0..8 {
            let mut matrix = DMatrix::zeros(2 * self.rows.len(), unknowns);
            let mut right = DVector::zeros(2 * self.rows.len());
            for (number, row) in self.rows.iter().enumerate() {
                let late = (-row.s * dead_time).exp();
                let before = if round == 0 {
                    // As steep as the denominator: else the highest lines would decide alone.
                    (1.0 + row.s.norm()).powi(i32::try_from(layout.order).unwrap_or(0))
                } else {
                    monic(&found[layout.denominator()], row.s).norm()
                };
                let weight = row.weight / before;
                let mut put = |range: std::ops::Range<usize>, times: Complex<f64>| {
                    for (column, power) in range.zip(powers(row.s)) {
                        let term = power * times * weight;
                        matrix[(2 * number, column)] = term.re;
                        matrix[(2 * number + 1, column)] = term.im;
                    }
                };
                put(layout.denominator(), -row.measured);
                put(layout.numerator(row.output), row.input * late);
                put(layout.transient(row.stretch, row.output), Complex::new(1.0, 0.0));
                let leading = powers(row.s).nth(layout.order).unwrap_or_default();
                let known = row.measured * leading * weight;
                right[2 * number] = known.re;
                right[2 * number + 1] = known.im;
            }
            let scales = scaled_to_one(&mut matrix);
            let factors = matrix.qr();
            let mut projected = right.clone();
            factors.q_tr_mul(&mut projected);
            let triangle = factors.r();
            let solved =
                triangle.solve_upper_triangular(&projected.rows(0, unknowns).into_owned())?;
            for ((value, solved), scale) in found.iter_mut().zip(solved.iter()).zip(&scales) {
                *value = solved / scale;
            }
        }
        let errors = self.rows.iter().map(|row| Self::error(layout, &found, row));
        let cost = errors.map(|error| error.norm_sqr()).sum();
        found.iter().all(|value| value.is_finite()).then_some((cost, found))
    }

    /// Weighted error of the model at a line.
    fn error(layout: Layout, parameters: &[f64], row: &Row) -> Complex<f64> {
        let late = (-row.s * parameters[parameters.len() - 1]).exp();
        let numerator = value(&parameters[layout.numerator(row.output)], row.s) * late * row.input;
        let transient = layout.transient(row.stretch, row.output);
        let transient = value(&parameters[transient], row.s);
        let denominator = monic(&parameters[layout.denominator()], row.s);
        (row.measured - (numerator + transient) / denominator) * row.weight
    }
}

/// The weighted nonlinear least squares; parameters in units of their start.
struct Model<'a> {
    task: &'a Task,
    layout: Layout,
    scale: Vec<f64>,
}

impl Model<'_> {
    fn parameters(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.scale).map(|(x, scale)| x * scale).collect()
    }
}

impl Problem for Model<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let parameters = self.parameters(x);
        for (row, out) in self.task.rows.iter().zip(out.chunks_exact_mut(2)) {
            let error = Task::error(self.layout, &parameters, row);
            (out[0], out[1]) = (error.re, error.im);
        }
        out.iter().all(|value| value.is_finite())
    }

    fn residual_len(&self) -> usize {
        2 * self.task.rows.len()
    }

    fn difference_step(&self, _: usize) -> f64 {
        1e-6
    }

    fn clamp(&self, x: &mut [f64]) {
        // A longer dead time would be the phase of poles.
        if let (Some(last), Some(scale)) = (x.last_mut(), self.scale.last()) {
            *last = last.clamp(-self.task.period / scale, 8.0 * self.task.period / scale);
        }
    }

    fn slopes(&self, x: &[f64]) -> Vec<Option<Vec<f64>>> {
        let parameters = self.parameters(x);
        let mut slopes = vec![vec![0.0; self.residual_len()]; x.len()];
        let last = x.len() - 1;
        for (number, row) in self.task.rows.iter().enumerate() {
            let late = (-row.s * parameters[last]).exp();
            let denominator = monic(&parameters[self.layout.denominator()], row.s);
            let driven = late * row.input;
            let numerator = value(&parameters[self.layout.numerator(row.output)], row.s) * driven;
            let transient = self.layout.transient(row.stretch, row.output);
            let whole = numerator + value(&parameters[transient.clone()], row.s);
            let mut put = |range: std::ops::Range<usize>, times: Complex<f64>| {
                for (column, power) in range.zip(powers(row.s)) {
                    let slope = power * times * row.weight * self.scale[column];
                    slopes[column][2 * number] = slope.re;
                    slopes[column][2 * number + 1] = slope.im;
                }
            };
            let of_denominator = whole / (denominator * denominator);
            put(self.layout.denominator(), of_denominator);
            put(self.layout.numerator(row.output), -driven / denominator);
            put(transient, -Complex::new(1.0, 0.0) / denominator);
            put(last..last + 1, row.s * numerator / denominator);
        }
        slopes.into_iter().map(Some).collect()
    }
}

/// The complex pairs among the roots of a polynomial with real coefficients, the lowest first, with the deviations that
/// follow from its covariance: `dp/dc_k = -p^k / P'(p)`.
fn pairs(coefficients: &[f64], is_monic: bool, covariance: &DMatrix<f64>, unit: f64) -> Vec<Pair> {
    let mut all = coefficients.to_vec();
    if is_monic {
        all.push(1.0);
    }
    // A negligible leading coefficient would be a root at infinity.
    let largest = largest(&all);
    while all.len() > 1 && all.last().is_some_and(|last| last.abs() < 1e-9 * largest) {
        all.pop();
    }
    let degree = all.len().saturating_sub(1);
    if degree < 2 {
        return Vec::new();
    }
    let leading = all[degree];
    let companion = DMatrix::from_fn(degree, degree, |row, column| {
        if column + 1 == degree {
            -all[row] / leading
        } else {
            f64::from(u8::from(row == column + 1))
        }
    });
    let slopes: Vec<f64> = (1..=degree).map(|k| k as f64 * all[k]).collect();
    let roots = companion.complex_eigenvalues();
    let mut found: Vec<Pair> = roots
        .iter()
        .filter(|root| root.im > 1e-9 * root.norm())
        .map(|root| {
            let size = root.norm();
            let damping_ratio = -root.re / size;
            let derivative = value(&slopes, *root);
            let variance = |gradient: &dyn Fn(Complex<f64>) -> f64| {
                let root_slopes = powers(*root).map(|power| -power / derivative);
                let gradient = root_slopes.take(coefficients.len()).map(gradient);
                let gradient = DVector::from_vec(gradient.collect());
                (gradient.transpose() * covariance * &gradient)[(0, 0)].max(0.0)
            };
            let longer = |by: Complex<f64>| (root.conj() * by).re / size;
            let damped = |by: Complex<f64>| (-by.re - damping_ratio * longer(by)) / size;
            let hertz = unit / std::f64::consts::TAU;
            Pair {
                frequency_hz: size * hertz,
                damping_ratio,
                frequency_std_hz: variance(&longer).sqrt() * hertz,
                damping_std: variance(&damped).sqrt(),
            }
        })
        .collect();
    found.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    found
}
