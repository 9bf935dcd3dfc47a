//! Spectral radius of a linear map that is given as code.

use nalgebra::DMatrix;

/// Largest absolute value of an eigenvalue of the map by which `step` changes a state of `size` numbers in place; infinite
/// where the map is not finite. `step` must be linear.
pub fn radius(size: usize, mut step: impl FnMut(&mut [f64])) -> f64 {
    let mut matrix = DMatrix::zeros(size, size);
    let mut state = vec![0.0; size];
    for column in 0..size {
        state.fill(0.0);
        state[column] = 1.0;
        step(&mut state);
        matrix.column_mut(column).copy_from_slice(&state);
    }
    if matrix.iter().any(|cell: &f64| !cell.is_finite()) {
        return f64::INFINITY;
    }
    let eigenvalues = matrix.complex_eigenvalues();
    eigenvalues.iter().map(|value| value.norm()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_has_its_scale_and_a_delay_line_is_dead_beat() {
        let rotation = radius(2, |x| {
            let [a, b] = [0.6 * x[0] - 0.8 * x[1], 0.8 * x[0] + 0.6 * x[1]];
            x.copy_from_slice(&[0.9 * a, 0.9 * b]);
        });
        assert!((rotation - 0.9).abs() < 1e-12, "{rotation}");
        let delay = radius(4, |x| {
            x.rotate_right(1);
            x[0] = 0.0;
        });
        assert!(delay < 1e-3, "{delay}");
        assert!(radius(1, |x| x[0] *= f64::NAN).is_infinite());
    }
}
