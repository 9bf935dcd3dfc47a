//! Root finding: the Illinois method and bisection.

/// The Illinois method, a modified regula falsi (Dowell and Jarratt 1971), between `low`, where the function `at_low` is
/// positive, and `high`, where `at_high` is negative. It ends in a bracket of 1e-9 of `span`; after `most` steps it returns the
/// upper end.
#[inline]
pub fn illinois(
    (mut low, mut at_low): (f64, f64),
    (mut high, mut at_high): (f64, f64),
    span: f64,
    most: usize,
    mut function: impl FnMut(f64) -> f64,
) -> f64 {
    let mut last_was_low = None;
    for _ in 0..most {
        let secant = (low * at_high - high * at_low) / (at_high - at_low);
        let value = function(secant);
        if value.abs() < 1e-12 || high - low < 1e-9 * span {
            return secant;
        }
        let is_low = value > 0.0;
        // The value at an end that is kept twice is halved, else the other end would converge slowly.
        let weight = if last_was_low == Some(is_low) { 0.5 } else { 1.0 };
        if is_low {
            (low, at_low, at_high) = (secant, value, at_high * weight);
        } else {
            (high, at_high, at_low) = (secant, value, at_low * weight);
        }
        last_was_low = Some(is_low);
    }
    high
}

/// Bisection: where a condition that holds at `low` ceases to hold towards `high`, after so many halvings.
pub fn halved(mut low: f64, mut high: f64, times: usize, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..times {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zero_of_any_function_is_found_in_few_steps() {
        let mut evaluations = 0;
        let power = |t: f64| 0.3 - t.powi(9);
        let zero = illinois((0.0, power(0.0)), (1.0, power(1.0)), 1.0, 30, |t| {
            evaluations += 1;
            power(t)
        });
        assert!((zero - 0.3_f64.powf(1.0 / 9.0)).abs() < 1e-9, "{zero}");
        assert!(evaluations < 20, "{evaluations}");
        assert!((illinois((0.0, 1.0), (4.0, -3.0), 4.0, 30, |t| 1.0 - t) - 1.0).abs() < 1e-12);
        // A jump has no zero: the upper end of its bracket is returned.
        let jump = illinois((0.0, 1.0), (1.0, -1.0), 1.0, 60, |t| if t < 0.7 { 1.0 } else { -1.0 });
        assert!((jump - 0.7).abs() < 1e-6, "{jump}");
    }
}
