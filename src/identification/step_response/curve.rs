//! The normalised step response `1/(r s^2 + s + 1)`: time in units of TM, `r = Ta/TM`.

/// Height at which all these curves nearly meet, and the largest ratio that a reading can tell: beyond, the response
/// oscillates for longer than any step is held.
pub(super) const MEETING: f64 = 0.73;
const LARGEST_RATIO: f64 = 10.0;

/// Height at time `x`.
pub(super) fn height(x: f64, r: f64) -> f64 {
    let discriminant = 1.0 - 4.0 * r;
    if r < 1e-9 {
        1.0 - (-x).exp()
    } else if discriminant.abs() < 1e-9 {
        1.0 - (1.0 + 2.0 * x) * (-2.0 * x).exp()
    } else if discriminant > 0.0 {
        let root = discriminant.sqrt();
        let (slow, fast) = ((1.0 - root) / (2.0 * r), (1.0 + root) / (2.0 * r));
        1.0 - (fast * (-slow * x).exp() - slow * (-fast * x).exp()) / (fast - slow)
    } else {
        let (damping, turning) = (1.0 / (2.0 * r), (-discriminant).sqrt() / (2.0 * r));
        let angle = turning * x;
        1.0 - (-damping * x).exp() * (angle.cos() + damping / turning * angle.sin())
    }
}

/// Time at which the curve first reaches [`MEETING`].
pub(super) fn meeting_time(r: f64) -> f64 {
    // The first rise is over before half a turn of the oscillation, and monotonic.
    let end = if r > 0.25 {
        std::f64::consts::PI * 2.0 * r / (4.0 * r - 1.0).sqrt()
    } else {
        20.0
    };
    bisect(0.0, end.min(20.0), |x| height(x, r) - MEETING)
}

/// Ratio of the curve whose height at half of TM is `half`; `None` for a height that none of them has.
pub(super) fn ratio(half: f64) -> Option<f64> {
    let within = half < height(0.5, 0.0) && half > height(0.5, LARGEST_RATIO);
    within.then(|| bisect(0.0, LARGEST_RATIO, |r| half - height(0.5, r)))
}

/// Root of a function that rises through zero.
fn bisect(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if f(middle) < 0.0 {
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
    fn the_curve_solves_its_differential_equation_in_every_regime() {
        for r in [0.0, 0.05, 0.2499, 0.25, 0.2501, 0.6, 3.0] {
            for x in [0.3, 1.0, 2.5] {
                let h = 1e-4;
                let [before, at, after] = [x - h, x, x + h].map(|x| height(x, r));
                let first = (after - before) / (2.0 * h);
                let second = (after - 2.0 * at + before) / (h * h);
                assert!((r * second + first + at - 1.0).abs() < 1e-5, "{r} {x}");
            }
        }
    }

    #[test]
    fn harriotts_rule_holds_and_the_chart_is_read_back() {
        // Harriott 1964: 73 % at 1.3 (T1 + T2) for all over-damped curves, within a few per cent.
        for r in [0.0, 0.1, 0.2, 0.25] {
            assert!((meeting_time(r) / 1.3 - 1.0).abs() < 0.03, "{r}");
        }
        for r in [0.02, 0.23, 0.25, 0.4, 1.5] {
            assert!((ratio(height(0.5, r)).unwrap() - r).abs() < 1e-6, "{r}");
            assert!((height(meeting_time(r), r) - MEETING).abs() < 1e-9);
        }
        assert_eq!(ratio(0.45), None);
        assert_eq!(ratio(f64::NAN), None);
    }
}
