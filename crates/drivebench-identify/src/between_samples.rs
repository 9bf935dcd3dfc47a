//! Weights of the rows of a torque balance for what a current is between its samples.
//!
//! The trapezoidal rule takes half the sum of two samples as the mean of the interval between them. Where the voltage steps, the
//! current jumps and decays within a few periods, and the mean of that interval is uncertain by the change `d` between its samples.
//! A row has the variance `s^2 + sum (k w d)^2`, `s` its noise, `w` the weight of the interval and `k` the torque constant, and is
//! divided by its deviation over `s` (weighted least squares: Aitken, Proc. R. Soc. Edinburgh 55, 1936). On four motors with 1 to 5
//! samples in a time constant the inertia was .5 to 22 % too small, with 5 to 7 times its stated deviation, and 1.3 to 14 times the
//! noise was left; with the weights it is within .8 deviations (1.7 of the fastest), and .9 to 1.07 times the noise is left.

use drivebench_model::signal::Window;

/// A second difference beyond this many standard deviations of its noise is a corner of the current.
const CORNER_DEVIATIONS: f64 = 4.0;

/// Change of the current over each interval between two samples that has a corner at one of its ends, A; else zero.
pub(super) fn changes_at_corners(current_a: &[f64], noise_a: f64) -> Vec<f64> {
    let changes: Vec<f64> = current_a.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // The variance of a second difference is six times that of a sample.
    let least = CORNER_DEVIATIONS * 6.0_f64.sqrt() * noise_a;
    let is_corner = |pair: &[f64]| {
        // Half of the larger difference: a decay with two periods in a time constant has .4 of it.
        let share = 0.5 * pair[0].abs().max(pair[1].abs());
        (pair[1] - pair[0]).abs() > least.max(share)
    };
    let corners: Vec<bool> = changes.windows(2).map(is_corner).collect();
    let has_corner = |interval: usize| {
        let begins = interval.checked_sub(1).and_then(|corner| corners.get(corner));
        begins.is_some_and(|is| *is) || corners.get(interval).is_some_and(|is| *is)
    };
    let at_corner = |(interval, change): (usize, &f64)| {
        if has_corner(interval) { *change } else { 0.0 }
    };
    changes.iter().enumerate().map(at_corner).collect()
}

/// Weights of the rows over these windows; `noise`: standard deviations of a current, A, and of a speed, rad/s. The noise of the
/// speed counts by the current per acceleration that the rows show.
pub(super) fn weights(
    windows: &[Window],
    current_a: &[f64],
    speed_rad_s: &[f64],
    noise: [f64; 2],
) -> Vec<f64> {
    let changes = changes_at_corners(current_a, noise[0]);
    let (mut products, mut squares) = (0.0, f64::MIN_POSITIVE);
    for window in windows {
        let rate = window.mean_rate(speed_rad_s);
        products += rate * window.mean(current_a);
        squares += rate * rate;
    }
    let weight = |window: &Window| {
        let of_corner = |(interval, share): (usize, f64)| (share * changes[interval]).powi(2);
        let corners: f64 = window.intervals().map(of_corner).sum();
        let (gain, rate_gain) = window.gains();
        let noise_a = (noise[0] * gain).hypot(noise[1] * rate_gain * products / squares);
        if corners > 0.0 { noise_a / noise_a.hypot(corners.sqrt()) } else { 1.0 }
    };
    windows.iter().map(weight).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_corners_count() {
        let current: Vec<f64> =
            (0..40).map(|k| if k < 10 { 0.0 } else { (-f64::from(k - 10) / 10.0).exp() }).collect();
        let corners = |current: &[f64], noise_a: f64| -> Vec<usize> {
            let changes = changes_at_corners(current, noise_a);
            (0..changes.len()).filter(|k| changes[*k] != 0.0).collect()
        };
        // The jump, and the first interval of the decay; none of the rest of it.
        assert_eq!(corners(&current, 0.0), [9, 10]);
        assert!(corners(&current, 0.2).is_empty());
        let mut holed = current.clone();
        holed[20] = f64::NAN;
        assert_eq!(corners(&holed, 0.0), [9, 10]);
        assert!(changes_at_corners(&[], 0.0).is_empty() && corners(&[1.0], 0.0).is_empty());
    }

    #[test]
    fn a_row_over_a_corner_counts_by_its_deviation() {
        let times: Vec<f64> = (0..9).map(f64::from).collect();
        let windows = [Window::new(&times, 0, 4), Window::new(&times, 4, 8)];
        let at_rest = [0.0; 9];
        let flat = weights(&windows, &at_rest, &at_rest, [0.1, 0.0]);
        assert!(flat.iter().all(|weight| (weight - 1.0).abs() < 1e-15), "{flat:?}");
        let mut current = [0.0; 9];
        current[2..].fill(3.0);
        let squares: f64 = (windows[0].intervals())
            .filter(|own| [1, 2].contains(&own.0))
            .map(|(interval, share)| (share * [0.0, 3.0, 0.0][interval]).powi(2))
            .sum();
        let (gain, _) = windows[0].gains();
        let expected = 1.0 / (1.0 + squares / (0.1 * gain).powi(2)).sqrt();
        let found = weights(&windows, &current, &at_rest, [0.1, 0.0]);
        assert!((found[0] - expected).abs() < 1e-12, "{found:?}");
        let noiseless = weights(&windows, &current, &at_rest, [0.0; 2]);
        assert_eq!((found[1].to_bits(), noiseless[0].to_bits()), (1_f64.to_bits(), 0));
        let shares: f64 = windows[0].intervals().map(|own| own.1).sum();
        assert!((shares - 1.0).abs() < 1e-12);
    }
}
