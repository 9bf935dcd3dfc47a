//! Recorded runs for tests: a model simulated under given voltages, sampled with the noise of a bench.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::{Input, Model, Plant, Scenario, State};
use crate::numerics::count::whole;
use crate::sample::Channel;

/// Standard deviations of the sensors: 30 mA and 0.15 rad/s, as in DISCOVERY.md.
pub(crate) const CURRENT_NOISE_A: f64 = 0.03;
pub(crate) const SPEED_NOISE_RAD_S: f64 = 0.15;

/// `model` under `events` (time and voltage, held), sampled every `period_s` for `duration_s`.
pub(crate) fn record(
    model: &Model,
    events: Vec<(f64, f64)>,
    period_s: f64,
    duration_s: f64,
    seed: u64,
) -> Scenario {
    let samples = whole(duration_s / period_s);
    let mut scenario = Scenario {
        name: format!("record {seed}"),
        input: Input::Voltage,
        input_channel: Channel::VoltageCmd,
        events,
        sample_time_s: (0..samples).map(|k| k as f64 * period_s).collect(),
        current_a: vec![],
        speed_rad_s: vec![],
        angle: vec![],
        scored: 0..samples,
    };
    let out = Plant::new(model, Input::Voltage)
        .expect("tests give complete models")
        .simulate(&scenario, State::default());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut noisy = |values: &[f64], sigma: f64| -> Vec<f64> {
        let noise = Normal::new(0.0, sigma).expect("a positive deviation");
        values
            .iter()
            .map(|value| value + noise.sample(&mut rng))
            .collect()
    };
    scenario.current_a = noisy(&out.current_a, CURRENT_NOISE_A);
    scenario.speed_rad_s = noisy(&out.speed_rad_s, SPEED_NOISE_RAD_S);
    scenario
}
