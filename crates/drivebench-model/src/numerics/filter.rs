//! Low-pass filtering of equidistant values: Butterworth as second-order sections (Oppenheim and Schafer, *Discrete-Time Signal
//! Processing*, chapters 6 and 7), forwards, or forwards and backwards (zero phase; Gustafsson, *IEEE Trans. Signal
//! Processing* 44, 1996); the natural cubic spline (de Boor, *A Practical Guide to Splines*, 1978).

use std::f64::consts::PI;

/// One second-order section `(b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2)`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

/// A digital Butterworth low pass: gain one at frequency zero, `1/sqrt(2)` at the cut-off, monotonic between.
#[derive(Clone, Debug, PartialEq)]
pub struct Butterworth {
    order: usize,
    sections: Vec<Section>,
}

impl Butterworth {
    /// Design by the bilinear transform with the cut-off pre-warped. `cut_off` is a share of the sampling rate;
    /// `None` unless `0 < cut_off < 0.5` and the order is 1 or more.
    pub fn low_pass(order: usize, cut_off: f64) -> Option<Self> {
        if order == 0 || !(cut_off > 0.0 && cut_off < 0.5) {
            return None;
        }
        // k: pre-warped cut-off; a pole pair of the prototype is s^2 + d s + 1.
        let k = (PI * cut_off).tan();
        let mut sections = Vec::with_capacity(order.div_ceil(2));
        if order % 2 == 1 {
            sections.push(Section {
                b: [k / (1.0 + k), k / (1.0 + k), 0.0],
                a: [(k - 1.0) / (k + 1.0), 0.0],
            });
        }
        // The best damped pair first: the sections after it then overshoot least.
        for pair in (0..order / 2).rev() {
            let d = 2.0 * (PI * (2 * pair + 1) as f64 / (2 * order) as f64).sin();
            let scale = 1.0 + d * k + k * k;
            let b0 = k * k / scale;
            sections.push(Section {
                b: [b0, 2.0 * b0, b0],
                a: [2.0 * (k * k - 1.0) / scale, (1.0 - d * k + k * k) / scale],
            });
        }
        Some(Self { order, sections })
    }

    /// One pass forwards from the steady state of the first value. The phase lags.
    pub fn forward(&self, values: &[f64]) -> Vec<f64> {
        let mut out = values.to_vec();
        let Some(&first) = values.first() else { return out };
        for section in &self.sections {
            let Section { b, a } = section;
            // Every section passes a constant unchanged, so that its steady state follows from the first value.
            let mut z = [(1.0 - b[0]) * first, (b[2] - a[1]) * first];
            for value in &mut out {
                let x = *value;
                let y = b[0] * x + z[0];
                z = [b[1] * x - a[0] * y + z[1], b[2] * x - a[1] * y];
                *value = y;
            }
        }
        out
    }

    /// Forwards and backwards: no phase shift, the gain squared. The ends are extended by their reflection in the end
    /// point over three times the filter's length, as `scipy.signal.sosfiltfilt` does, or over the whole of a shorter signal.
    pub fn zero_phase(&self, values: &[f64]) -> Vec<f64> {
        let Some(&last) = values.last() else { return Vec::new() };
        let first = values[0];
        let padding = (3 * (self.order + 1)).min(values.len() - 1);
        let mut padded = Vec::with_capacity(values.len() + 2 * padding);
        padded.extend(values[1..=padding].iter().rev().map(|v| 2.0 * first - v));
        padded.extend_from_slice(values);
        let tail = &values[values.len() - 1 - padding..values.len() - 1];
        padded.extend(tail.iter().rev().map(|v| 2.0 * last - v));
        let mut out = self.forward(&padded);
        out.reverse();
        out = self.forward(&out);
        out.reverse();
        out[padding..padding + values.len()].to_vec()
    }
}

/// Every `factor`-th value from `offset` on. The values must have been low-passed below half of the new rate.
pub fn decimated(values: &[f64], factor: usize, offset: usize) -> Vec<f64> {
    values.iter().skip(offset).step_by(factor.max(1)).copied().collect()
}

/// Natural cubic spline through `points` (abscissae strictly increasing) at the ascending abscissae `at`; beyond the ends the
/// end cubic is extrapolated. Two points give their line.
pub fn spline(points: &[(f64, f64)], at: &[f64]) -> Vec<f64> {
    let n = points.len();
    if n < 2 {
        return vec![points.first().map_or(f64::NAN, |point| point.1); at.len()];
    }
    let step = |k: usize| points[k + 1].0 - points[k].0;
    let slope = |k: usize| (points[k + 1].1 - points[k].1) / step(k);
    // Second derivatives m by the tridiagonal system, zero at the ends.
    let (mut m, mut upper) = (vec![0.0; n], vec![0.0; n]);
    for k in 1..n - 1 {
        let pivot = 2.0 * (step(k - 1) + step(k)) - step(k - 1) * upper[k - 1];
        upper[k] = step(k) / pivot;
        m[k] = (6.0 * (slope(k) - slope(k - 1)) - step(k - 1) * m[k - 1]) / pivot;
    }
    for k in (1..n - 1).rev() {
        m[k] -= upper[k] * m[k + 1];
    }
    let mut k = 0;
    at.iter()
        .map(|&x| {
            while k + 2 < n && points[k + 1].0 < x {
                k += 1;
            }
            let (h, right, left) = (step(k), points[k + 1].0 - x, x - points[k].0);
            (m[k] * right.powi(3) + m[k + 1] * left.powi(3)) / (6.0 * h)
                + (points[k].1 / h - m[k] * h / 6.0) * right
                + (points[k + 1].1 / h - m[k + 1] * h / 6.0) * left
        })
        .collect()
}

#[cfg(test)]
mod tests;
