//! Correlation tests of the residual: whiteness, and independence of the input.
//!
//! Correlations of the free-run residual `e` with itself and with the input `u` over lags, in multiples of their 99 % band
//! `2.58 / sqrt(n)` (Billings and Zhu, Int. J. Control 60, 1994). With `x'` for `x` less its mean:
//! whiteness `ee`; independence of the input `ue`, `(u2)'e`, `(u2)'(e2)'`, `e(eu)`; and the Ljung-Box test of whiteness.
//! A wrong model gives `ee` 18 to 42 times the band, a right one 0.6 to 1.4. The tests detect an error, not its cause.

use serde::Serialize;

use super::score::varies;
use drivebench_model::numerics::statistics::{
    self, BAND_99, COLOURED_BY_CHANCE, OUTSIDE_BY_CHANCE,
};

/// Largest lag of the correlations.
const LAGS: usize = statistics::WHITENESS_LAGS;
/// Samples below which no correlation is judged.
pub(super) const FEWEST_SAMPLES: usize = 4 * LAGS;
/// Multiple of the band above which a test fails whatever the number of lags; chance alone exceeds it once in 6,000
/// tests. Of a correlation with the input nothing else counts: where the input is slow, white noise that correlates by
/// chance with it at one lag does so at all of them.
const FAR_OUTSIDE: f64 = 1.75;

/// Test of one correlation over the lags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Light {
    /// Largest correlation over the band.
    pub largest_over_band: f64,
    /// Share of the lags outside the band.
    pub outside_99_percent: f64,
    pub passes: bool,
}

/// The tests of one signal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SignalLights {
    /// Autocorrelation of the residual, lags 1..25.
    pub rho_ee: Light,
    /// Cross-correlation of input and residual, lags 0..25, and the nonlinear ones.
    pub rho_ue: Light,
    pub rho_u2e: Light,
    pub rho_u2e2: Light,
    pub rho_e_eu: Light,
    /// Ljung-Box statistic over the lags, and the value that white noise exceeds in one case of ten thousand.
    pub ljung_box: f64,
    pub ljung_box_limit: f64,
}

impl SignalLights {
    /// Whether the residual is white: few lags outside their band, none far outside, and the Ljung-Box statistic within its
    /// limit.
    pub fn is_white(&self) -> bool {
        self.rho_ee.passes && self.ljung_box <= self.ljung_box_limit
    }

    /// The tests in the order of their fields.
    pub const fn each(&self) -> [Light; 5] {
        [self.rho_ee, self.rho_ue, self.rho_u2e, self.rho_u2e2, self.rho_e_eu]
    }
}

/// Whiteness of the residual and its independence of the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ResidualLights {
    /// Whether every signal is ([`SignalLights::is_white`]); false also where there are too few samples.
    pub white: bool,
    /// Whether every signal has samples enough for the verdict.
    pub enough_samples: bool,
    /// Share of the lags 1..25 whose autocorrelation lies outside the 99 % band, the worse of the signals.
    pub autocorrelation_outside_99_percent: f64,
    /// Whether every residual is independent of the input, linearly and in squares. Where the noise is coloured this is
    /// the only test that counts. Null where there are too few samples, or the input never changes.
    pub independent_of_input: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_rad_s: Option<SignalLights>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_a: Option<SignalLights>,
    /// Of runs without a voltage: the torque balance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_n_m: Option<SignalLights>,
}

impl ResidualLights {
    /// From the residuals of current and speed in order of time, each with the input at the same instants.
    pub fn of(current: &[(f64, f64)], speed: &[(f64, f64)]) -> Self {
        Self::of_signals([current, speed, &[]])
    }

    /// From the residual of the torque balance in order of time, each with the motor's torque.
    pub fn of_torque(torque: &[(f64, f64)]) -> Self {
        Self::of_signals([&[], &[], torque])
    }

    /// Whether no test fails.
    pub fn is_noise(&self) -> bool {
        self.white && self.independent_of_input != Some(false)
    }

    /// Each tested signal with its name and tests.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, SignalLights)> {
        [("speed", self.speed_rad_s), ("current", self.current_a), ("torque", self.torque_n_m)]
            .into_iter()
            .filter_map(|(name, lights)| Some((name, lights?)))
    }

    fn of_signals(residuals: [&[(f64, f64)]; 3]) -> Self {
        let [current_a, speed_rad_s, torque_n_m] = residuals.map(lights);
        // A signal that the run does not have is not tested.
        let measured = || residuals.into_iter().filter(|residual| !residual.is_empty());
        let enough_samples = measured().next().is_some()
            && measured().all(|residual| residual.len() >= FEWEST_SAMPLES);
        let each = || [current_a, speed_rad_s, torque_n_m].into_iter().flatten();
        let changes =
            |pairs: &[(f64, f64)]| varies(&pairs.iter().map(|pair| pair.1).collect::<Vec<_>>());
        let is_tested = enough_samples && measured().any(changes);
        let worst = each().map(|l| l.rho_ee.outside_99_percent).fold(0.0, f64::max);
        Self {
            white: enough_samples && each().all(|lights| lights.is_white()),
            enough_samples,
            autocorrelation_outside_99_percent: worst,
            independent_of_input: is_tested
                .then(|| each().all(|l| l.rho_ue.passes && l.rho_u2e.passes && l.rho_u2e2.passes)),
            speed_rad_s,
            current_a,
            torque_n_m,
        }
    }
}

/// Pairs `(residual, input)`; `None` where they are too few or do not vary.
fn lights(pairs: &[(f64, f64)]) -> Option<SignalLights> {
    let n = pairs.len();
    if n < FEWEST_SAMPLES {
        return None;
    }
    let e = centred(pairs.iter().map(|pair| pair.0));
    let u = centred(pairs.iter().map(|pair| pair.1));
    let u2 = centred(u.iter().map(|value| value * value));
    let e2 = centred(e.iter().map(|value| value * value));
    let eu = centred(e.iter().zip(&u).map(|(e, u)| e * u));
    if power(&e) <= 0.0 {
        return None;
    }
    let rho = correlations(&e, &e, 1);
    let ljung_box = statistics::ljung_box_statistic(&rho, n);
    let cross =
        |later: &[f64], earlier: &[f64], first| light(&correlations(later, earlier, first), n);
    Some(SignalLights {
        rho_ee: whiteness(&rho, n),
        rho_ue: cross(&e, &u, 0),
        rho_u2e: cross(&e, &u2, 0),
        rho_u2e2: cross(&e2, &u2, 0),
        // e(t) with e u one sample earlier and more.
        rho_e_eu: cross(&e, &eu, 1),
        ljung_box,
        ljung_box_limit: statistics::ljung_box_limit(LAGS, COLOURED_BY_CHANCE),
    })
}

fn light(correlations: &[f64], n: usize) -> Light {
    let band = BAND_99 / (n as f64).sqrt();
    let ratios: Vec<f64> = correlations.iter().map(|rho| rho.abs() / band).collect();
    let largest_over_band = ratios.iter().copied().fold(0.0, f64::max);
    let outside = ratios.iter().filter(|ratio| **ratio > 1.0).count() as f64;
    let outside_99_percent = outside / ratios.len() as f64;
    Light { largest_over_band, outside_99_percent, passes: largest_over_band <= FAR_OUTSIDE }
}

/// Of a residual with itself: its lags are independent, so that their number counts too.
fn whiteness(correlations: &[f64], n: usize) -> Light {
    let light = light(correlations, n);
    Light { passes: light.passes && light.outside_99_percent <= OUTSIDE_BY_CHANCE, ..light }
}

fn centred(values: impl Iterator<Item = f64> + Clone) -> Vec<f64> {
    let (count, sum) =
        values.clone().fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    values.map(|value| value - sum / count).collect()
}

fn power(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

/// Correlations of `later` with what `earlier` was `first..=LAGS` samples before; zero where one does not vary.
fn correlations(later: &[f64], earlier: &[f64], first: usize) -> Vec<f64> {
    let scale = (power(later) * power(earlier)).sqrt();
    (first..=LAGS)
        .map(|lag| {
            let sum: f64 = later[lag..].iter().zip(earlier).map(|(late, early)| late * early).sum();
            if scale > 0.0 { sum / scale } else { 0.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..n).map(|_| rng.sample(StandardNormal)).collect()
    }

    /// The tests of a residual of the current with the input.
    fn lights(residual: &[f64], input: &[f64]) -> ResidualLights {
        let pairs = residual.iter().copied().zip(input.iter().copied());
        ResidualLights::of(&pairs.collect::<Vec<_>>(), &[])
    }

    /// The residual with a fault, which may depend on the sample.
    fn with_fault(e: &[f64], fault: impl Fn(usize) -> f64) -> Vec<f64> {
        e.iter().enumerate().map(|(k, e)| e + fault(k)).collect()
    }

    #[test]
    fn noise_is_white_and_a_slow_sine_is_not() {
        let (e, u) = (noise(4, 5000), noise(5, 5000));
        let good = lights(&e, &u);
        assert!(good.white && good.independent_of_input == Some(true), "{good:?}");
        let one = good.current_a.unwrap();
        assert!(one.ljung_box < one.ljung_box_limit && good.speed_rad_s.is_none());
        let wave = with_fault(&e, |k| 0.6 * (k as f64 / 50.0).sin());
        let pairs = |e: Vec<f64>| e.into_iter().zip(u.iter().copied()).collect::<Vec<_>>();
        let both = ResidualLights::of(&pairs(e.clone()), &pairs(wave));
        assert!(!both.white && both.autocorrelation_outside_99_percent > 0.5);
        assert!(both.speed_rad_s.unwrap().rho_ee.largest_over_band > 3.0);
    }

    #[test]
    fn each_test_of_independence_detects_its_own_fault() {
        let (e, u) = (noise(6, 4000), noise(7, 4000));
        let with = |fault: &dyn Fn(usize) -> f64| {
            let found = lights(&with_fault(&e, fault), &u);
            (found, found.current_a.unwrap())
        };
        let (all, linear) = with(&|k| if k > 3 { 0.3 * u[k - 3] } else { 0.0 });
        assert!(!linear.rho_ue.passes && linear.rho_u2e.passes, "{linear:?}");
        assert_eq!(all.independent_of_input, Some(false));
        let (all, square) = with(&|k| 0.3 * u[k] * u[k]);
        assert!(!square.rho_u2e.passes && square.rho_ue.passes, "{square:?}");
        assert_eq!(all.independent_of_input, Some(false));
        // Noise whose variance grows with the input is white and uncorrelated with the input itself.
        let (all, size) = with(&|k| e[k] * u[k].abs());
        assert!(!size.rho_u2e2.passes && size.rho_ue.passes && all.white, "{size:?}");
        let mut fed_back = e.clone();
        for k in 1..4000 {
            fed_back[k] += 0.4 * fed_back[k - 1] * u[k - 1];
        }
        let bilinear = lights(&fed_back, &u).current_a.unwrap();
        assert!(!bilinear.rho_e_eu.passes && bilinear.rho_ee.passes, "{bilinear:?}");
    }

    #[test]
    fn a_right_model_rarely_fails_a_test() {
        // Steps longer than the largest lag: the correlations of all lags are alike.
        let levels = noise(8, 20);
        let steps: Vec<f64> = (0..4000).map(|k| levels[k / 200]).collect();
        let independent = |found: &ResidualLights| found.independent_of_input == Some(true);
        let count =
            |seeds: u64, alarm: &dyn Fn(u64) -> bool| (0..seeds).filter(|k| alarm(*k)).count();
        let alarms = count(100, &|k| !independent(&lights(&noise(2000 + k, 4000), &steps)));
        assert!(alarms <= 1, "white noise is independent of a slow input: {alarms} of 100");
        let alarms = count(60, &|k| {
            let found = lights(&noise(100 + k, 2000), &noise(900 + k, 2000));
            !(found.white && independent(&found))
        });
        assert!(alarms <= 2, "{alarms} of 60");
        let alarms = count(400, &|k| !lights(&noise(5000 + k, 1000), &[0.0; 1000]).white);
        assert!(alarms <= 1, "white noise is called so: {alarms} of 400");
    }

    #[test]
    fn one_strong_lag_is_not_white() {
        let (e, u) = (noise(21, 5000), noise(22, 5000));
        let echoed = with_fault(&e, |k| if k >= 5 { 0.14 * e[k - 5] } else { 0.0 });
        let found = lights(&echoed, &u);
        assert!(found.autocorrelation_outside_99_percent <= OUTSIDE_BY_CHANCE);
        assert!(!found.white && found.independent_of_input == Some(true), "{found:?}");
        let one = found.current_a.unwrap();
        assert!(!one.rho_ee.passes && one.ljung_box > one.ljung_box_limit);
    }

    #[test]
    fn too_few_samples_and_no_variation_are_no_verdict() {
        let short = ResidualLights::of(&[(0.0, 1.0); 40], &[]);
        assert!(!short.white && !short.enough_samples);
        let still = ResidualLights::of(&[(0.0, 1.0); 400], &[]);
        assert!(still.white && still.current_a.is_none(), "an exact model has no residual");
        let steady = lights(&noise(23, 400), &[1.0; 400]);
        assert!(steady.white && steady.independent_of_input.is_none());
    }
}
