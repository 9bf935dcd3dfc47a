//! Recorded runs for tests: a model simulated under given voltages, sampled with the noise of a bench.
#![expect(clippy::missing_panics_doc, reason = "a wrong argument has to stop a test")]

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::{ActiveEffect, Input, Model, Motor, MotorKey, Plant, Scenario, State};
use crate::numerics::count::whole;
use crate::sample::{Channel, Origin, Run};

/// Standard deviations of the sensors: 30 mA and 0.15 rad/s.
pub const CURRENT_NOISE_A: f64 = 0.03;
pub const SPEED_NOISE_RAD_S: f64 = 0.15;

/// `model` under `events` (time and voltage, held), sampled every `period_s` for `duration_s`.
pub fn record(
    model: &Model,
    events: Vec<(f64, f64)>,
    period_s: f64,
    duration_s: f64,
    seed: u64,
) -> Scenario {
    let samples = whole(duration_s / period_s);
    let times = (0..samples).map(|k| k as f64 * period_s).collect();
    let mut scenario = Scenario::planned(
        format!("record {seed}"),
        Input::Voltage,
        Channel::VoltageCmd,
        events,
        times,
    );
    let out = Plant::new(model, Input::Voltage)
        .expect("tests give complete models")
        .simulate(&scenario, State::default());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut noisy = |values: &[f64], sigma: f64| -> Vec<f64> {
        let noise = Normal::new(0.0, sigma).expect("a positive deviation");
        values.iter().map(|value| value + noise.sample(&mut rng)).collect()
    };
    scenario.current_a = noisy(&out.current_a, CURRENT_NOISE_A);
    scenario.speed_rad_s = noisy(&out.speed_rad_s, SPEED_NOISE_RAD_S);
    scenario
}

/// A run with every voltage, current, speed and time multiplied by these, with its own scales.
pub fn scaled(run: &Scenario, [voltage, current, speed, time]: [f64; 4]) -> Scenario {
    let by = |values: &[f64], factor: f64| values.iter().map(|value| value * factor).collect();
    let events = run.events.iter().map(|(at_s, volts)| (at_s * time, volts * voltage)).collect();
    let times = by(&run.sample_time_s, time);
    let mut scaled = Scenario {
        current_a: by(&run.current_a, current),
        speed_rad_s: by(&run.speed_rad_s, speed),
        ..Scenario::planned(run.name.clone(), run.input, run.input_channel, events, times)
    };
    scaled.find_scales();
    scaled
}

/// The model with an effect of these values.
#[must_use]
pub fn with(model: &Model, id: &str, values: &[f64]) -> Model {
    let mut model = model.with_effect(id).expect("it is in the catalogue");
    let last = model.effects.len() - 1;
    model.effects[last] = ActiveEffect::with(model.effects[last].effect, values);
    model
}

/// A zero-order hold from its instants and levels: `(time, value)`.
pub fn held<const N: usize>(times: [f64; N], levels: [f64; N]) -> Vec<(f64, f64)> {
    times.into_iter().zip(levels).collect()
}

pub fn motor(name: &str, values: &[f64; 5]) -> Motor {
    use MotorKey::{BackEmf, Inductance, Inertia, LoadTorque, Resistance};
    let values = [Resistance, Inductance, BackEmf, Inertia, LoadTorque].into_iter().zip(values);
    values.fold(Motor::new(name), |motor, (key, value)| motor.with(key, *value))
}

pub fn run_of(
    name: &str,
    times: Vec<f64>,
    columns: impl IntoIterator<Item = (Channel, Vec<f64>, Origin)>,
) -> Run {
    let mut run = Run::new(name, times).expect("stamps grow");
    for (channel, cells, origin) in columns {
        run.set_column(channel, cells, origin).expect("as many cells as rows");
    }
    run
}

/// A record with its voltage in every row, without the lost rows.
pub fn with_rows_lost(scenario: &Scenario, lost: impl Fn(usize) -> bool) -> Run {
    let kept = || (0..scenario.samples()).filter(|row| !lost(*row));
    let pick = |values: &[f64]| -> Vec<f64> { kept().map(|row| values[row]).collect() };
    let times = pick(&scenario.sample_time_s);
    let volts = times.iter().map(|time_s| scenario.input_at(*time_s));
    let (volts, current, speed) =
        (volts.collect(), pick(&scenario.current_a), pick(&scenario.speed_rad_s));
    let columns = [
        (Channel::Voltage, volts, Origin::Unknown),
        (Channel::Current, current, Origin::Measured),
        (Channel::Speed, speed, Origin::Measured),
    ];
    run_of("lossy", times, columns)
}

/// Steps both ways of the motor of paper A with a fan on its shaft, from rest; `shift` makes another run of it.
pub fn with_a_fan(shift: usize) -> Scenario {
    let truth = with(&Model::baseline(Motor::zk_22fc()), "quadratic_load", &[4e-6]);
    let levels = [30.0, 90.0, 50.0, 3.0, -4.0, -40.0, -90.0, 60.0, -60.0, 20.0];
    let mut events = vec![(0.0, 0.0)];
    for step in 0..levels.len() {
        let level = levels[(step + 3 * shift) % levels.len()];
        let begin_s = 0.5 + 0.5 * step as f64;
        events.push((begin_s, level));
        events.push((begin_s + 0.25, level + 5.0));
    }
    record(&truth, events, 0.005, 5.5, 7 + shift as u64)
}
