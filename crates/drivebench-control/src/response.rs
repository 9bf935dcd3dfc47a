//! Figures of a response to a step of the reference.

use serde::Serialize;

/// Share of the step within which a response has settled.
pub const SETTLED_SHARE: f64 = 0.05;

/// Times from the step on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Response {
    /// Beyond the new speed, per cent of the step.
    pub overshoot_percent: f64,
    /// From 10 to 90 % of the step, s; `None` if it was not reached.
    pub rise_s: Option<f64>,
    /// After which the speed stays within 5 % of the step about the new speed, s; `None` if it never does.
    pub settling_s: Option<f64>,
    /// Integral of the absolute error, rad.
    pub absolute_error_rad: f64,
}

/// Figures of `trace`, time and speed, from the instant of the step on; it goes `from` one speed `to` another.
pub fn response(trace: &[(f64, f64)], from: f64, to: f64) -> Response {
    let step = to - from;
    let begin_s = trace.first().map_or(0.0, |point| point.0);
    // Progress is 0 before and 1 after, whichever way it goes.
    let progress = |speed: f64| (speed - from) / step;
    let peak = trace.iter().map(|point| progress(point.1)).fold(0.0, f64::max);
    let first_at =
        |share: f64| Some(trace.iter().find(|point| progress(point.1) >= share)?.0 - begin_s);
    // NaN is outside.
    let within = |point: &(f64, f64)| (progress(point.1) - 1.0).abs() <= SETTLED_SHARE;
    let outside = trace.iter().rposition(|point| !within(point));
    let settled = trace.get(outside.map_or(0, |last| last + 1));
    let absolute_error_rad =
        trace.windows(2).map(|pair| (to - pair[0].1).abs() * (pair[1].0 - pair[0].0)).sum();
    Response {
        overshoot_percent: 100.0 * (peak - 1.0).max(0.0),
        rise_s: first_at(0.1).zip(first_at(0.9)).map(|(low, high)| high - low),
        settling_s: settled.map(|point| point.0 - begin_s),
        absolute_error_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_close;

    fn trace(speed: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        (0..=4000).map(|n| f64::from(n) * 0.001).map(|t| (t, speed(t))).collect()
    }

    #[test]
    fn a_lag_rises_in_2_2_and_settles_in_3_time_constants() {
        for (from, to) in [(0.0, 1.0), (20.0, -30.0)] {
            let found = response(&trace(|t| to + (from - to) * (-t / 0.1).exp()), from, to);
            assert!(found.overshoot_percent < 1e-12);
            assert_close(found.rise_s.unwrap(), 0.1 * 9.0_f64.ln(), 2e-3);
            assert_close(found.settling_s.unwrap(), 0.1 * 20.0_f64.ln(), 2e-3);
            assert_close(found.absolute_error_rad, 0.1 * (to - from).abs(), 1e-2);
        }
    }

    #[test]
    fn a_damping_of_one_over_root_two_overshoots_by_4_3_percent() {
        let speed = |t: f64| 1.0 - (-5.0 * t).exp() * ((5.0 * t).cos() + (5.0 * t).sin());
        let found = response(&trace(speed), 0.0, 1.0);
        assert_close(found.overshoot_percent, 100.0 * (-std::f64::consts::PI).exp(), 1e-3);
    }

    #[test]
    fn a_trace_outside_of_the_band_has_no_settling_time() {
        let found = response(&trace(|t| 0.5 * t.min(1.0)), 0.0, 1.0);
        assert_eq!((found.settling_s, found.rise_s), (None, None));
        for (trace, from, to) in
            [(&[][..], 0.0, 1.0), (&[(0.0, f64::NAN)], 0.0, 1.0), (&[(0.0, 2.0)], 2.0, 2.0)]
        {
            assert_eq!(response(trace, from, to).settling_s, None, "{trace:?}");
        }
    }
}
