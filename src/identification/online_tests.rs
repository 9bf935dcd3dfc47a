//! On-line identification against the simulated motor of paper A.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};

use super::*;
use crate::plant::{Input, Motor, Plant, Scenario, State};
use crate::sample::Verdict;

/// R, L, Ke, J, Mc of `Motor::zk_22fc`.
const TRUTH: [f64; 5] = [1.1, 0.0099, 0.3538, 0.0045, 0.455];

/// Voltage steps that hold 60 to 110 ms and jump at odd instants between samples, after 0.3 s at rest.
fn steps(seconds: f64) -> Vec<(f64, f64)> {
    let levels = [
        20.0, 35.0, 15.0, 60.0, 30.0, 45.0, 25.0, -30.0, -50.0, -20.0, 10.0, 70.0,
    ];
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = 0.3037;
    for step in 0.. {
        if at_s > seconds {
            break;
        }
        events.push((at_s, levels[step % levels.len()]));
        at_s += 0.0613 + 0.0471 * (step % 3) as f64 / 2.0;
    }
    events
}

struct Bench {
    events: Vec<(f64, f64)>,
    times: Vec<f64>,
    current: Vec<f64>,
    speed: Vec<f64>,
}

impl Bench {
    fn new(events: Vec<(f64, f64)>, times: Vec<f64>) -> Self {
        let scenario = Scenario {
            name: "r".into(),
            input: Input::Voltage,
            input_channel: Channel::VoltageCmd,
            events: events.clone(),
            scored: 0..times.len(),
            sample_time_s: times.clone(),
            current_a: vec![],
            speed_rad_s: vec![],
            angle: vec![],
        };
        let out = Plant::new(&Model::baseline(Motor::zk_22fc()), Input::Voltage)
            .unwrap()
            .simulate(&scenario, State::default());
        Self {
            events,
            times,
            current: out.current_a,
            speed: out.speed_rad_s,
        }
    }

    fn regular(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Self {
        let rows = (seconds / period_s).round() as usize;
        Self::new(events, (0..rows).map(|k| k as f64 * period_s).collect())
    }

    /// Bench noise, then the quantisation of registers: 1 mA and 0.01 rad/s.
    fn noisy(&self, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut add = |values: &[f64], sigma: f64, quantum: f64| -> Vec<f64> {
            let normal = Normal::new(0.0, sigma).unwrap();
            values
                .iter()
                .map(|x| ((x + normal.sample(&mut random)) / quantum).round() * quantum)
                .collect()
        };
        let current = add(&self.current, 0.03, 1e-3);
        (current, add(&self.speed, 0.15, 0.01))
    }

    /// Feeds everything in the order of time, commands as rows of their own.
    fn feed(&self, online: &mut Online, current: &[f64], speed: &[f64]) {
        let mut events = self.events.iter().peekable();
        for (k, &time_s) in self.times.iter().enumerate() {
            while let Some(&&(at_s, volts)) = events.peek().filter(|event| event.0 <= time_s) {
                online.push(&Sample::at(at_s).with(Channel::VoltageCmd, volts));
                events.next();
            }
            let sample = Sample::at(time_s)
                .with(Channel::Current, current[k])
                .with(Channel::Speed, speed[k]);
            online.push(&sample);
        }
    }

    fn run(&self, config: OnlineConfig) -> Online {
        let mut online = Online::new(config);
        self.feed(&mut online, &self.current, &self.speed);
        online
    }
}

fn errors(estimates: &[ParameterEstimate], truth: &[f64]) -> Vec<f64> {
    estimates
        .iter()
        .zip(truth)
        .map(|(e, t)| e.value.map_or(f64::NAN, |v| v / t - 1.0))
        .collect()
}

#[test]
fn without_noise_every_parameter_is_found_at_1_and_10_ms() {
    for period_s in [0.001, 0.002, 0.005, 0.01, 0.02] {
        let online = Bench::regular(steps(6.0), period_s, 6.0).run(OnlineConfig::default());
        let found = errors(&online.estimates(), &TRUTH);
        let scheme_2 = errors(&online.scheme_2(), &TRUTH[3..]);
        println!(
            "{period_s} {found:.4?} scheme 2 {scheme_2:.4?} {:?}",
            online.excitation()
        );
    }
}

fn seeds(period_s: f64, seconds: f64, config: OnlineConfig) {
    let bench = Bench::regular(steps(seconds), period_s, seconds);
    let mut sum = [0.0; 7];
    let mut squares = [0.0; 7];
    let mut covered = [0; 7];
    let mut std_sum = [0.0; 7];
    let truth: Vec<f64> = TRUTH.iter().chain(&TRUTH[3..]).copied().collect();
    for seed in 0..40 {
        let (current, speed) = bench.noisy(seed);
        let mut online = Online::new(config);
        bench.feed(&mut online, &current, &speed);
        let mut estimates = online.estimates();
        estimates.extend(online.scheme_2());
        for (j, estimate) in estimates.iter().enumerate() {
            let (value, std) = (
                estimate.value.unwrap_or(f64::NAN),
                estimate.std.unwrap_or(f64::NAN),
            );
            let error = value / truth[j] - 1.0;
            sum[j] += error / 40.0;
            squares[j] += error * error / 40.0;
            std_sum[j] += std / truth[j] / 40.0;
            covered[j] += u32::from((value - truth[j]).abs() < 1.96 * std);
        }
    }
    let spread: Vec<f64> = (0..7)
        .map(|j| (squares[j] - sum[j] * sum[j]).sqrt())
        .collect();
    println!(
        "T {period_s} bias {sum:.4?}\n  spread {spread:.4?}\n  std    {std_sum:.4?}\n  covered {covered:?}"
    );
}

#[test]
fn with_bench_noise() {
    for period_s in [0.001, 0.01] {
        seeds(period_s, 6.0, OnlineConfig::default());
    }
}
