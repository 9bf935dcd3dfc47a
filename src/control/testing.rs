//! What the tests of this part share.

/// Equal to `tolerance`, relative to the larger of both where that is above one.
#[track_caller]
pub(crate) fn assert_close(found: f64, expected: f64, tolerance: f64) {
    let scale = found.abs().max(expected.abs());
    let within = tolerance * if scale > 1.0 { scale } else { 1.0 };
    assert!(
        (found - expected).abs() <= within,
        "{found} is not {expected} within {tolerance}"
    );
}
