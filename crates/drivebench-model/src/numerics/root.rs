//! Root finding: the Illinois method and bisection.

/// The modified regula falsi of Illinois (Dowell and Jarratt 1971) between `low`, where the quantity `at_low` is positive, and
/// `high`, where `at_high` is negative. It ends in a bracket of 1e-9 of `span`; after `most` steps the upper end serves.
#[inline]
pub fn falling_through_zero(
    (mut low, mut at_low): (f64, f64),
    (mut high, mut at_high): (f64, f64),
    span: f64,
    most: usize,
    mut quantity: impl FnMut(f64) -> f64,
) -> f64 {
    let mut last_was_low = None;
    for _ in 0..most {
        let place = (low * at_high - high * at_low) / (at_high - at_low);
        let there = quantity(place);
        if there.abs() < 1e-12 || high - low < 1e-9 * span {
            return place;
        }
        let is_low = there > 0.0;
        // An end that stays twice in a row is weighted down, else the secant would creep.
        let weight = if last_was_low == Some(is_low) { 0.5 } else { 1.0 };
        if is_low {
            (low, at_low, at_high) = (place, there, at_high * weight);
        } else {
            (high, at_high, at_low) = (place, there, at_low * weight);
        }
        last_was_low = Some(is_low);
    }
    high
}

/// Where something that holds at `low` ceases to hold towards `high`, after so many halvings.
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
    fn the_zero_is_found_in_few_steps_however_bent_the_way() {
        let mut evaluations = 0;
        let bent = |t: f64| 0.3 - t.powi(9);
        let place = falling_through_zero((0.0, bent(0.0)), (1.0, bent(1.0)), 1.0, 30, |t| {
            evaluations += 1;
            bent(t)
        });
        assert!((place - 0.3_f64.powf(1.0 / 9.0)).abs() < 1e-9, "{place}");
        assert!(evaluations < 20, "{evaluations}");
        let line = falling_through_zero((0.0, 1.0), (4.0, -3.0), 4.0, 30, |t| 1.0 - t);
        assert!((line - 1.0).abs() < 1e-12);
        // A jump has no zero: the first place beyond it is as good.
        let jump = falling_through_zero((0.0, 1.0), (1.0, -1.0), 1.0, 60, |t| {
            if t < 0.7 { 1.0 } else { -1.0 }
        });
        assert!((jump - 0.7).abs() < 1e-6, "{jump}");
    }
}
