//! Riccati recursions, run to their steady gain: Kalman filter and linear-quadratic state feedback (Astrom and Wittenmark,
//! *Computer-Controlled Systems*, chapter 11), both in the symmetric (Joseph) form.

use nalgebra::{SMatrix, SVector};

#[derive(Clone, Debug)]
pub struct Steady<const N: usize> {
    pub gain: SVector<f64, N>,
    /// Covariance `P` of the state's error, or the matrix `S` of the cost to go `x' S x`.
    pub matrix: SMatrix<f64, N, N>,
    /// Largest change of the gain in each iteration, relative to its size.
    pub changes: Vec<f64>,
}

/// Kalman filter for one measured quantity `y = c x + v` (Paper B, eq. (10)): `P- = G P G' + Q`, `K = P- c' / (c P- c' + r)`,
/// until the relative change of `K` is below `tolerance`. `None` where it does not converge.
pub fn filter<const N: usize>(
    g: &SMatrix<f64, N, N>,
    process: &SMatrix<f64, N, N>,
    c: &SVector<f64, N>,
    noise: f64,
    tolerance: f64,
) -> Option<Steady<N>> {
    let mut p = SMatrix::<f64, N, N>::identity();
    let mut gain = SVector::<f64, N>::zeros();
    iterate(&mut gain, tolerance, || {
        let before = g * p * g.transpose() + process;
        let pc = before * c;
        let k = pc / (c.dot(&pc) + noise);
        let keep = SMatrix::<f64, N, N>::identity() - k * c.transpose();
        p = keep * before * keep.transpose() + k * k.transpose() * noise;
        (k, p)
    })
}

/// Optimal feedback `u = -gain' x` of one input for the cost `sum of x' V x + w u^2`: dynamic programming backward to the
/// steady gain. `None` where it does not converge.
pub fn feedback<const N: usize>(
    g: &SMatrix<f64, N, N>,
    h: &SVector<f64, N>,
    state_weight: &SMatrix<f64, N, N>,
    input_weight: f64,
    tolerance: f64,
) -> Option<Steady<N>> {
    let mut s = *state_weight;
    let mut gain = SVector::<f64, N>::zeros();
    iterate(&mut gain, tolerance, || {
        let sh = s * h;
        let k = (g.transpose() * sh) / (h.dot(&sh) + input_weight);
        let closed = g - h * k.transpose();
        s = closed.transpose() * s * closed + k * k.transpose() * input_weight + state_weight;
        (k, s)
    })
}

fn iterate<const N: usize>(
    gain: &mut SVector<f64, N>,
    tolerance: f64,
    mut next: impl FnMut() -> (SVector<f64, N>, SMatrix<f64, N, N>),
) -> Option<Steady<N>> {
    let mut changes = Vec::new();
    let mut last = SMatrix::<f64, N, N>::zeros();
    for _ in 0..20_000 {
        let (k, matrix) = next();
        if !(k.iter().all(|x| x.is_finite()) && matrix.iter().all(|x| x.is_finite())) {
            return None;
        }
        // A mode that the gain does not reach may grow while the gain is constant.
        let grows = (matrix - last).amax() > 1e-3 * matrix.amax();
        last = matrix;
        let change = (k - *gain).norm() / k.norm().max(f64::MIN_POSITIVE);
        *gain = k;
        changes.push(change);
        if change < tolerance && !grows {
            return Some(Steady { gain: k, matrix, changes });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn a_scalar_filter_is_the_root_of_its_equation() {
        // P- = g^2 P- r / (P- + r) + q, that is P-^2 + P- (r - g^2 r - q) - q r = 0.
        let (g, q, r) = (0.95_f64, 0.3, 2.0);
        let b = r - g * g * r - q;
        let p = 0.5 * (-b + (b * b + 4.0 * q * r).sqrt());
        let one = SMatrix::<f64, 1, 1>::new;
        let found = filter(&one(g), &one(q), &one(1.0), r, 1e-14).unwrap();
        assert!((found.gain[0] - p / (p + r)).abs() < 1e-12);
    }

    #[test]
    fn the_feedback_costs_less_than_any_gain_near_it() {
        let g = Matrix2::new(1.0, 0.1, 0.0, 0.9);
        let h = Vector2::new(0.005, 0.1);
        let weight = Matrix2::new(1.0, 0.0, 0.0, 0.1);
        let found = feedback(&g, &h, &weight, 0.5, 1e-13).unwrap();
        let cost = |k: Vector2<f64>| {
            let (mut x, mut sum) = (Vector2::new(1.0, -0.3), 0.0);
            for _ in 0..2000 {
                let u = -k.dot(&x);
                sum += x.dot(&(weight * x)) + 0.5 * u * u;
                x = g * x + h * u;
            }
            sum
        };
        let best = cost(found.gain);
        for (a, b) in [(0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05)] {
            assert!(cost(found.gain + Vector2::new(a, b)) > best);
        }
        let x = Vector2::new(1.0, -0.3);
        assert!((x.dot(&(found.matrix * x)) - best).abs() < 1e-9 * best);
        // An unstable mode that the input does not reach.
        let g = Matrix2::new(1.2, 0.0, 0.0, 0.9);
        let h = Vector2::new(0.0, 1.0);
        assert!(feedback(&g, &h, &Matrix2::identity(), 1.0, 1e-12).is_none());
    }
}
