//! Counts and indices from quotients of times.

/// The whole part of a quotient as a count; NaN and everything negative give none, what is too large the largest.
#[inline]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates and turns NaN to zero, as documented"
)]
pub const fn whole(quotient: f64) -> usize {
    quotient as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_count_is_nothing_and_never_wraps() {
        assert_eq!([0.999, 1.0, 41.7].map(whole), [0, 1, 41]);
        assert_eq!([-3.0, f64::NAN, f64::NEG_INFINITY].map(whole), [0, 0, 0]);
        assert_eq!(whole(f64::INFINITY), usize::MAX);
    }
}
