//! Local polynomial method: the frequency response at one frequency, its variance and its coherence from the few spectral
//! lines around it (Pintelon, Schoukens, Vandersteen, Barbe 2010, "Estimation of nonparametric noise and FRF models for
//! multivariable systems", Mech. Syst. Signal Process. 24).
//!
//! Over so few lines response and transient (leakage) are smooth: `Y = (g0 + g1 r + g2 r^2) U + t0 + t1 r + t2 r^2`. The residual
//! is noise, so that every point has its own interval without averaging or windowing.

use nalgebra::{Complex, DMatrix, Matrix2};

/// Coefficients of both polynomials, of order 2.
const UNKNOWNS: usize = 2 * 3;
/// Lines on either side; with them a point has five degrees of freedom for its noise.
pub(super) const SIDE: usize = 5;
/// Lines of a point.
pub(super) const LINES: usize = 2 * SIDE + 1;
pub(super) const FREEDOM: usize = LINES - UNKNOWNS;

/// Transforms of the input and of both outputs at one line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) input: Complex<f64>,
    /// Current, speed.
    pub(super) outputs: [Complex<f64>; 2],
}

/// Response of current and speed to the input at one frequency.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    pub(super) response: [Complex<f64>; 2],
    /// Of the two responses' errors, `E e e^H`.
    pub(super) covariance: Matrix2<Complex<f64>>,
    /// Noise of a line, variance.
    pub(super) noise: [f64; 2],
    /// Power of a line that the input explains.
    pub(super) explained: [f64; 2],
}

/// From lines at equal distances, the frequency `offset` of them beside the middle one. `None` where they do not separate
/// response and transient: without an input, or one whose spectrum is as smooth as a transient's.
pub(super) fn local(lines: &[Line; LINES], offset: f64) -> Option<Local> {
    let size = (lines.iter().map(|line| line.input.norm_sqr()).sum::<f64>() / LINES as f64).sqrt();
    if !(size.is_finite() && size > 0.0) {
        return None;
    }
    let at = |row: usize| (row as f64 - SIDE as f64 - offset) / SIDE as f64;
    let regressors = DMatrix::from_fn(LINES, UNKNOWNS, |row, column| {
        let power = i32::try_from(column % (UNKNOWNS / 2)).unwrap_or(0);
        let base =
            if column < UNKNOWNS / 2 { lines[row].input / size } else { Complex::new(1.0, 0.0) };
        base * at(row).powi(power)
    });
    let right = DMatrix::from_fn(LINES, 2, |row, output| lines[row].outputs[output]);
    let factors = regressors.clone().svd(true, true);
    let values = &factors.singular_values;
    if values.min() < 1e-7 * values.max() {
        return None;
    }
    let found = factors.solve(&right, 0.0).ok()?;
    let residual = &right - &regressors * &found;
    let sums = residual.adjoint() * &residual / Complex::new(FREEDOM as f64, 0.0);
    let v = factors.v_t.as_ref()?;
    let bread: f64 = (0..UNKNOWNS).map(|k| v[(k, 0)].norm_sqr() / values[k].powi(2)).sum();
    let share = bread / size.powi(2);
    // Less the variance of the response, which is large for an input that is nearly as smooth as a transient.
    let explained = |output: usize| {
        let by_chance = sums[(output, output)].re * bread;
        (found[(0, output)].norm_sqr() - by_chance).max(0.0)
    };
    Some(Local {
        response: [0, 1].map(|output| found[(0, output)] / size),
        // `sums` holds conj(a) b; the errors' covariance is a conj(b).
        covariance: Matrix2::from_fn(|a, b| sums[(b, a)] * share),
        noise: [0, 1].map(|output| sums[(output, output)].re),
        explained: [0, 1].map(explained),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A gain that bends a little, a transient, and noise of this deviation.
    fn lines(rng: &mut ChaCha8Rng, noise: f64) -> [Line; LINES] {
        let mut of = |size: f64| {
            let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
            Complex::new(normal(), normal()) * (size * std::f64::consts::FRAC_1_SQRT_2)
        };
        std::array::from_fn(|row| {
            let r = row as f64 - SIDE as f64;
            let input = of(3.0);
            let gain = Complex::new(2.0, -1.0) + Complex::new(0.01, 0.02) * r;
            let transient = Complex::new(0.3, 0.1) - Complex::new(0.02, 0.0) * r;
            let clean = gain * input + transient;
            Line { input, outputs: [clean + of(noise), clean * 0.5] }
        })
    }

    #[test]
    fn response_is_exact_without_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let found = local(&lines(&mut rng, 0.0), 0.0).unwrap();
        assert!((found.response[0] - Complex::new(2.0, -1.0)).norm() < 1e-10);
        assert!((found.response[1] - Complex::new(1.0, -0.5)).norm() < 1e-10);
        assert!(found.noise[0] < 1e-18);
        let beside = local(&lines(&mut rng, 0.0), 0.5).unwrap();
        let expected = Complex::new(2.0, -1.0) + Complex::new(0.01, 0.02) * 0.5;
        assert!((beside.response[0] - expected).norm() < 1e-10);
    }

    #[test]
    fn variance_is_that_of_the_errors() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut square, mut variance, mut noise) = (0.0, 0.0, 0.0);
        let rounds = 4000;
        for _ in 0..rounds {
            let found = local(&lines(&mut rng, 0.2), 0.0).unwrap();
            square += (found.response[0] - Complex::new(2.0, -1.0)).norm_sqr();
            variance += found.covariance[(0, 0)].re;
            noise += found.noise[0];
        }
        let noise = (noise / f64::from(rounds)).sqrt();
        assert!((noise - 0.2).abs() < 0.005, "{noise}");
        let ratio = square / variance;
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
    }

    #[test]
    fn without_an_input_there_is_no_response() {
        let none = Complex::new(0.0, 0.0);
        let line = Line { input: none, outputs: [Complex::new(1.0, 0.0); 2] };
        assert!(local(&[line; LINES], 0.0).is_none());
        let steady = Line { input: Complex::new(1.0, 0.0), ..line };
        // As smooth as a transient.
        assert!(local(&[steady; LINES], 0.0).is_none());
    }
}
