//! Runs for the benchmarks.

use drivebench::numerics::count::whole;
use drivebench::plant::{Input, Model, Motor, Plant, Scenario, State};
use drivebench::sample::Channel;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// The run that most benchmarks use: a baseline motor.
pub(crate) fn run_of_12_s() -> Scenario {
    record(&Model::baseline(Motor::zk_22fc()), 1)
}

/// 12 s at 1 kHz: steps of voltage with reversals, creeping and rest, a new level every 40 ms; current and speed as
/// `truth` gives them, with noise.
pub(crate) fn record(truth: &Model, seed: u64) -> Scenario {
    const PERIOD_S: f64 = 1e-3;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let samples = whole(12.0 / PERIOD_S);
    let mut level_v = 0.0;
    let events = (0..samples)
        .map(|k| {
            if k >= 200 && k % 40 == 0 {
                level_v = if k % 1000 < 120 { 0.0 } else { random.random_range(-40.0..40.0) };
            }
            (k as f64 * PERIOD_S, level_v)
        })
        .collect();
    let times = (0..samples).map(|k| k as f64 * PERIOD_S).collect();
    let mut scenario =
        Scenario::planned("12 s", Input::Voltage, Channel::VoltageCmd, events, times);
    let truth = Plant::new(truth, Input::Voltage)
        .expect("a complete model")
        .simulate(&scenario, State::default());
    let mut noisy = |values: &[f64], size: f64| -> Vec<f64> {
        values.iter().map(|value| value + size * random.random_range(-1.7..1.7)).collect()
    };
    scenario.current_a = noisy(&truth.current_a, 0.03);
    scenario.speed_rad_s = noisy(&truth.speed_rad_s, 0.15);
    scenario
}
