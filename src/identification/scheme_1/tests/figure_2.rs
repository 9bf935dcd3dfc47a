//! Noise as equation error, as paper A's Figure 2 must have had it.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use super::*;

/// Ta and TM over their true values, sample by sample.
type Tracks = (Vec<f64>, Vec<f64>);

/// Paper A's Figure 2: eq. (17) itself with noise as equation error, TM doubled at sample 900.
fn figure_2(seed: u64, power_ratio: f64) -> Tracks {
    let (mut ta, mut tm) = (Vec::new(), Vec::new());
    figure_2_rows(seed, power_ratio, |scheme| {
        let found = scheme.dynamics().ok();
        ta.push(found.map_or(f64::NAN, |d| d.ta_s / SLOW.ta_s));
        tm.push(found.map_or(f64::NAN, |d| d.tm_s / SLOW.tm_s));
    });
    (ta, tm)
}

/// Ta and TM just before the jump, with the deviations claimed.
fn figure_2_end(seed: u64) -> ([f64; 2], [f64; 2]) {
    let (mut end, mut sample) = (([f64::NAN; 2], [f64::NAN; 2]), 0);
    figure_2_rows(seed, 100.0, |scheme| {
        sample += 1;
        if sample == 890 {
            let spread = scheme.dynamics_covariance().unwrap();
            let found = scheme.dynamics().unwrap();
            end = (
                [found.ta_s, found.tm_s],
                [spread[0][0].sqrt(), spread[1][1].sqrt()],
            );
        }
    });
    end
}

fn figure_2_rows(seed: u64, power_ratio: f64, mut see: impl FnMut(&Scheme1)) {
    let (period_s, samples) = (0.02, 1800);
    let volts = binary(samples, 10, 60.0, 25.0, seed);
    let coefficients = |tm_s: f64| {
        let (alpha, gamma) = (period_s / SLOW.ta_s, period_s / tm_s);
        Coefficients {
            p: alpha,
            q: alpha * gamma,
            voltage: alpha * gamma / (2.0 * KE),
            load: SLOW.load_v / KE * gamma / 2.0 * (2.0 * alpha - alpha * gamma),
            voltage_step: 0.0,
        }
    };
    let respond = |sigma: f64, drive: f64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 5);
        let mut w = vec![drive * 165.0; 2];
        for k in 2..samples {
            let c = coefficients(if k < 900 { SLOW.tm_s } else { 2.0 * SLOW.tm_s });
            let noise: f64 = sigma * rng.sample::<f64, _>(StandardNormal);
            w.push(
                c.a1() * w[k - 1]
                    + c.a2() * w[k - 2]
                    + drive * (c.voltage * (volts[k] + volts[k - 1]) - c.load)
                    + noise,
            );
        }
        w
    };
    let sigma = (variance(&respond(0.0, 1.0)) / power_ratio / variance(&respond(1.0, 0.0))).sqrt();
    let mut scheme = Scheme1::new(Form::Printed, period_s, 0.97);
    for (volts, speed) in volts.iter().zip(respond(sigma, 1.0)) {
        scheme.push(*volts, speed, 1);
        see(&scheme);
    }
}

#[test]
fn a_doubled_mechanical_time_constant_is_followed_with_a_memory_of_33_samples() {
    let tracks: Vec<_> = (0..60_u64)
        .into_par_iter()
        .map(|seed| figure_2(seed, 10.0))
        .collect();
    let at = |k: usize, of: fn(&Tracks) -> &Vec<f64>| {
        median(
            &tracks
                .iter()
                .map(|track| of(track)[k])
                .collect::<Vec<f64>>(),
        )
    };
    for k in [600, 880, 1100, 1300, 1700] {
        let (ta, tm) = (at(k, |t| &t.0), at(k, |t| &t.1));
        let truth = if k < 900 { 1.0 } else { 2.0 };
        assert!((ta - 1.0).abs() < 0.15, "{k} {ta}");
        assert!((tm / truth - 1.0).abs() < 0.15, "{k} {tm}");
    }
}

#[test]
fn claimed_deviations_of_least_squares_are_those_of_repeated_trials_with_equation_error() {
    let ends: Vec<([f64; 2], [f64; 2])> = (0..200_u64).into_par_iter().map(figure_2_end).collect();
    for j in 0..2 {
        let found: Vec<f64> = ends.iter().map(|end| end.0[j]).collect();
        let claimed: Vec<f64> = ends.iter().map(|end| end.1[j]).collect();
        let ratio = median(&claimed) / robust_deviation(&found);
        assert!((0.75..1.33).contains(&ratio), "{j} {ratio}");
    }
}
