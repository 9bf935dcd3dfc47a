use super::*;
use std::f64::consts::TAU;

fn close(found: &[f64], expected: &[f64], within: f64) {
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() <= within * e.abs().max(1.0), "{f} {e}");
    }
}

#[test]
fn the_design_is_that_of_scipy() {
    // scipy 1.17.1: signal.butter(4, 0.2, output='sos') and signal.butter(3, 0.35, output='sos'); shares of Nyquist.
    let s4 = Butterworth::low_pass(4, 0.1).unwrap().sections;
    let s3 = Butterworth::low_pass(3, 0.175).unwrap().sections;
    for (section, a) in [
        (s4[0], [-1.048_599_576_362_611_7, 0.296_140_357_561_669_6]),
        (s4[1], [-1.320_913_430_819_426_4, 0.632_738_792_885_276_6]),
        (s3[0], [-0.240_078_759_080_116_06, 0.0]),
        (s3[1], [-0.628_141_785_141_078_9, 0.383_601_166_767_679_6]),
    ] {
        close(&section.a, &a, 1e-12);
    }
    let gain = s4[0].b[0] * s4[1].b[0];
    assert!((gain / 0.004_824_343_357_716_23 - 1.0).abs() < 1e-12);
}

#[test]
fn forwards_and_backwards_agree_with_scipy_up_to_the_ends() {
    let signal = |k: f64| (0.3 * k).sin() + 0.5 * (1.7 * k).cos() + 0.02 * k * k;
    let values: Vec<f64> = (0..40).map(|k| signal(f64::from(k))).collect();
    // scipy 1.17.1: signal.sosfiltfilt(sos, x) at these places.
    let four = [
        0.498_494_704_142_486_37,
        0.631_267_442_043_908_7,
        1.407_186_312_956_285_6,
        7.720_529_990_685_658,
        27.780_434_381_868_012,
        29.181_982_848_909_22,
    ];
    let three = [
        0.499_847_531_892_684_6,
        0.410_013_685_899_057_6,
        1.513_060_655_712_514_4,
        7.710_541_293_287_198,
        27.898_965_132_506_092,
        29.182_124_607_604_223,
    ];
    for (order, cut_off, expected) in [(4, 0.1, four), (3, 0.175, three)] {
        let filtered = Butterworth::low_pass(order, cut_off).unwrap().zero_phase(&values);
        close(&[0, 1, 5, 20, 38, 39].map(|k| filtered[k]), &expected, 1e-11);
    }
}

/// Amplitude and phase lag of a long filtered sine, by projection over its middle.
fn response(filtered: &[f64], share: f64) -> (f64, f64) {
    let (mut s, mut c) = (0.0, 0.0);
    for (k, value) in filtered.iter().enumerate().take(3000).skip(1000) {
        let (sin, cos) = (TAU * share * k as f64).sin_cos();
        (s, c) = (s + value * sin / 1000.0, c + value * cos / 1000.0);
    }
    (s.hypot(c), -c.atan2(s))
}

#[test]
fn gain_and_phase_at_the_cut_off_are_those_of_butterworth() {
    for order in 1..=6 {
        for share in [0.02, 0.05, 0.25] {
            let filter = Butterworth::low_pass(order, share).unwrap();
            let sine = (0..4000).map(|k| (TAU * share * f64::from(k)).sin());
            let sine: Vec<f64> = sine.collect();
            let (gain, lag) = response(&filter.forward(&sine), share);
            let off = (lag - order as f64 * PI / 4.0).rem_euclid(TAU);
            let is_first = (gain - 0.5f64.sqrt()).abs() < 1e-6 && off.min(TAU - off) < 1e-5;
            assert!(is_first, "{order} {share}: {gain} {lag}");
            let (gain, lag) = response(&filter.zero_phase(&sine), share);
            let is_second = (gain - 0.5).abs() < 1e-6 && lag.abs() < 1e-6;
            assert!(is_second, "{order} {share}: {gain} {lag}");
        }
    }
}

#[test]
fn lines_pass_and_wrong_cut_offs_are_refused() {
    let line: Vec<f64> = (0..60).map(|k| 3.0 - 0.5 * f64::from(k)).collect();
    let filter = Butterworth::low_pass(4, 0.1).unwrap();
    // The start of the first pass is exact for a constant; the reflected line ends in one that is not quite.
    for (found, expected) in filter.zero_phase(&line).iter().zip(&line) {
        assert!((found - expected).abs() < 0.03, "{found} {expected}");
    }
    assert!(filter.zero_phase(&[]).is_empty() && filter.forward(&[]).is_empty());
    close(&filter.zero_phase(&[2.0]), &[2.0], 1e-12);
    close(&filter.zero_phase(&[2.0; 5]), &[2.0; 5], 1e-12);
    for (order, cut_off) in [(4, 0.0), (4, -0.1), (4, 0.5), (4, f64::NAN), (0, 0.1)] {
        assert_eq!(Butterworth::low_pass(order, cut_off), None);
    }
    close(&decimated(&line, 30, 1), &[2.5, -12.5], 0.0);
    assert_eq!(decimated(&line, 0, 59).len(), 1);
    assert!(decimated(&line, 3, 99).is_empty());
}

#[test]
fn the_spline_is_that_of_scipy_and_keeps_its_points() {
    let times = [0.0, 0.9, 2.1, 2.8, 4.2, 5.0];
    let points = times.map(|t: f64| (t, t.sin()));
    // scipy 1.17.1: interpolate.CubicSpline(t, sin(t), bc_type='natural').
    let expected = [
        0.390_360_060_323_415_5,
        0.987_702_817_360_788_1,
        0.600_364_730_851_481_7,
        -0.166_161_708_541_201_77,
        -0.963_050_301_644_229_6,
    ];
    close(&spline(&points, &[0.4, 1.5, 2.5, 3.3, 4.9]), &expected, 1e-12);
    close(&spline(&points, &times), &times.map(f64::sin), 1e-14);
    close(&spline(&points[..2], &[0.45]), &[0.5 * 0.9f64.sin()], 1e-14);
    assert!(spline(&[], &[1.0])[0].is_nan());
}
