//! Records for the tests of this room.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal, Uniform};

use crate::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State};
use crate::sample::{Channel, Origin, Run};

pub(super) const CURRENT_NOISE_A: f64 = 0.03;
pub(super) const SPEED_NOISE_RAD_S: f64 = 0.15;

/// R, L, Ke, J, Mc.
pub(super) type Truth = [f64; 5];

pub(super) const PAPER: Truth = [1.1, 0.0099, 0.3538, 0.0045, 0.455];
/// L/R 1 ms, R J/Ke^2 8 ms.
pub(super) const SMALL: Truth = [2.0, 0.002, 0.05, 1e-5, 0.01];
/// L/R 20 ms, R J/Ke^2 167 ms.
pub(super) const LARGE: Truth = [0.3, 0.006, 1.2, 0.8, 4.0];

pub(super) fn motor(truth: &Truth) -> Motor {
    Motor::new("truth")
        .with(MotorKey::Resistance, truth[0])
        .with(MotorKey::Inductance, truth[1])
        .with(MotorKey::BackEmf, truth[2])
        .with(MotorKey::Inertia, truth[3])
        .with(MotorKey::LoadTorque, truth[4])
}

/// Voltage steps at odd instants in both directions after a rest; the full scale is 70.
pub(super) fn steps(seconds: f64, scale: f64, hold_s: f64) -> Vec<(f64, f64)> {
    let levels = [
        20.0, 35.0, 15.0, 60.0, 30.0, 45.0, 25.0, -30.0, -50.0, -20.0, 10.0, 70.0,
    ];
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = 0.5037;
    for step in 0_u8.. {
        if at_s > seconds {
            break;
        }
        events.push((at_s, scale * levels[usize::from(step) % levels.len()]));
        at_s += hold_s * (1.0 + 0.38 * f64::from(step % 3));
    }
    events
}

pub(super) fn every(period_s: f64, seconds: f64) -> Vec<f64> {
    (0..u32::MAX)
        .map(|k| f64::from(k) * period_s)
        .take_while(|time_s| *time_s < seconds - 0.5 * period_s)
        .collect()
}

/// Stamps 0 to 3 ms late.
pub(super) fn jittered(period_s: f64, seconds: f64, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let late = Uniform::new(0.0, 0.3 * period_s).unwrap();
    every(period_s, seconds)
        .into_iter()
        .map(|time_s| time_s + late.sample(&mut random))
        .collect()
}

/// What the motor does, without noise.
#[derive(Clone)]
pub(super) struct Record {
    pub(super) events: Vec<(f64, f64)>,
    pub(super) times: Vec<f64>,
    pub(super) current: Vec<f64>,
    pub(super) speed: Vec<f64>,
}

impl Record {
    pub(super) fn of(model: &Model, events: Vec<(f64, f64)>, times: Vec<f64>) -> Self {
        let scenario = Scenario {
            name: "r".into(),
            input: Input::Voltage,
            input_channel: Channel::VoltageCmd,
            events: events.clone(),
            unknown_input: vec![],
            scored: 0..times.len(),
            sample_time_s: times.clone(),
            current_a: vec![],
            speed_rad_s: vec![],
            angle: vec![],
            time_half_width_s: vec![],
        };
        let out = Plant::new(model, Input::Voltage)
            .unwrap()
            .simulate(&scenario, State::default());
        Self {
            events,
            times,
            current: out.current_a,
            speed: out.speed_rad_s,
        }
    }

    /// The run of a seed: noise of the given sizes, then the registers' 1 mA and 0.01 rad/s; commands on rows of their own.
    pub(super) fn run(&self, noise: [f64; 2], seed: u64) -> Run {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut noisy = |value: f64, sigma: f64, quantum: f64| {
            if sigma > 0.0 {
                let error = Normal::new(0.0, sigma).unwrap().sample(&mut random);
                ((value + error) / quantum).round() * quantum
            } else {
                value
            }
        };
        let mut rows: Vec<(f64, [f64; 3])> = self
            .events
            .iter()
            .map(|(time_s, volts)| (*time_s, [*volts, f64::NAN, f64::NAN]))
            .collect();
        for (k, time_s) in self.times.iter().enumerate() {
            let current = noisy(self.current[k], noise[0], 1e-3);
            let speed = noisy(self.speed[k], noise[1], 0.01);
            match rows[..self.events.len()]
                .iter_mut()
                .find(|row| row.0.total_cmp(time_s).is_eq())
            {
                Some(row) => (row.1[1], row.1[2]) = (current, speed),
                None => rows.push((*time_s, [f64::NAN, current, speed])),
            }
        }
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut run = Run::new("r", rows.iter().map(|row| row.0).collect()).unwrap();
        for (k, (channel, origin)) in [
            (Channel::VoltageCmd, Origin::Commanded),
            (Channel::Current, Origin::Measured),
            (Channel::Speed, Origin::Measured),
        ]
        .into_iter()
        .enumerate()
        {
            let cells = rows.iter().map(|row| row.1[k]).collect();
            run.set_column(channel, cells, origin).unwrap();
        }
        run
    }
}
