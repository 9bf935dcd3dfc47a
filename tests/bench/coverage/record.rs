//! Seeded records for the coverage of intervals: random motors under random steps, as a serial line gives them.
//!
//! The truth is integrated by the emulator's Runge-Kutta machine, which shares no code with the fitters.

use std::f64::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use drivebench::emulator::truth::{MotorTruth, Plant, Terminals};
use drivebench::sample::{Channel, Origin, Run};

/// Step of the truth, s, and its largest share of the electrical time constant.
const TRUTH_STEP_S: f64 = 1e-4;
const STEP_SHARE: f64 = 0.1;
/// Time at rest before the first step, s.
const REST_S: f64 = 0.4;

/// How the samples come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sampling {
    /// Every 10 ms.
    Regular,
    /// Every 10 ms and 0 to 3 ms late, stamped as taken.
    Jittered,
    /// Every 10 ms, current and speed in the steps of registers: 10 mA and 1 r/min on the motor of paper A.
    Quantised,
    /// Every millisecond.
    Fast,
}

/// One motor under one excitation: what the sensors would read without noise.
pub(crate) struct Trajectory {
    /// R, L, Ke, J, Mc.
    pub(crate) truth: [f64; 5],
    sampling: Sampling,
    events: Vec<(f64, f64)>,
    times: Vec<f64>,
    current: Vec<f64>,
    speed: Vec<f64>,
    current_noise_a: f64,
    speed_noise_rad_s: f64,
}

impl Trajectory {
    /// L/R from 0.5 to 50 ms, R J/Ke^2 from 10 ms to 1 s and 1 to 50 times L/R, noise 0.3 to 3 times that of
    /// a usual servo drive, voltage steps at instants of their own.
    pub(crate) fn random(seed: u64, sampling: Sampling, seconds: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut log_uniform =
            |from: f64, to: f64| -> f64 { rng.random_range(from.ln()..to.ln()).exp() };
        let mut ta = log_uniform(0.5e-3, 50e-3);
        let tm = (ta * log_uniform(1.0, 50.0)).clamp(0.01, 1.0);
        ta = ta.clamp(tm / 50.0, tm);
        let resistance = log_uniform(0.2, 10.0);
        let back_emf = log_uniform(0.03, 1.5);
        let largest_v = back_emf * log_uniform(60.0, 350.0);
        let largest_a = largest_v / resistance;
        let load = back_emf * largest_a * log_uniform(0.008, 0.05);
        let noise = log_uniform(0.3, 3.0);
        let truth =
            [resistance, ta * resistance, back_emf, tm * back_emf * back_emf / resistance, load];
        let mut events = vec![(0.0, 0.0)];
        let mut at_s = REST_S + rng.random_range(0.0..0.01);
        let hold_s = (ta + tm).clamp(0.05, 0.4);
        while at_s < seconds {
            let level: f64 = rng.random_range(0.1..1.0);
            let sign = if rng.random::<f64>() < 0.6 { 1.0 } else { -1.0 };
            events.push((at_s, sign * level * largest_v));
            at_s += hold_s * rng.random_range(0.4..1.6);
        }
        let period_s = if sampling == Sampling::Fast { 0.001 } else { 0.01 };
        let times: Vec<f64> = (0..u32::MAX)
            .map(|k| f64::from(k) * period_s)
            .take_while(|time_s| *time_s < seconds - 0.5 * period_s)
            .map(|time_s| match sampling {
                Sampling::Jittered => time_s + rng.random_range(0.0..0.003),
                _ => time_s,
            })
            .collect();
        let (current, speed) = integrate(&truth, &events, &times);
        Self {
            truth,
            sampling,
            events,
            times,
            current,
            speed,
            // 30 mA and 0.15 rad/s on the motor of paper A at 80 V.
            current_noise_a: noise * 4.1e-4 * largest_a,
            speed_noise_rad_s: noise * 6.6e-4 * largest_v / back_emf,
        }
    }

    /// The end of a long hold: the motor turns at constant speed from the first sample to the last.
    pub(crate) fn steady(seed: u64, sampling: Sampling, seconds: f64) -> Self {
        let mut one = Self::random(seed, sampling, seconds);
        let [r, l, ke, j, _] = one.truth;
        let settled_s = 40.0 * (l / r + r * j / (ke * ke));
        let volts = one.events[1].1;
        let held = [(0.0, volts)];
        let times: Vec<f64> = one.times.iter().map(|time_s| time_s + settled_s).collect();
        (one.current, one.speed) = integrate(&one.truth, &held, &times);
        one.events = vec![(0.0, volts)];
        one.times.iter_mut().for_each(|time_s| *time_s += 1e-3);
        one
    }

    pub(crate) fn describe(&self) -> String {
        let [r, l, ke, j, _] = self.truth;
        format!(
            "Ta {:.2} ms TM {:.0} ms noise {:.3} A {:.3} rad/s",
            1e3 * l / r,
            1e3 * r * j / (ke * ke),
            self.current_noise_a,
            self.speed_noise_rad_s
        )
    }

    /// The record as the bench writes it: commands at their own stamps, noise and quantisation on the samples.
    pub(crate) fn run(&self, seed: u64) -> Run {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let quantised = self.sampling == Sampling::Quantised;
        let (current_step_a, speed_step_rad_s) = (
            // On the motor of paper A: 10 mA to 30 mA of noise, 1 r/min to 0.15 rad/s.
            self.current_noise_a / 3.0,
            self.speed_noise_rad_s * (TAU / 60.0) / 0.15,
        );
        let mut read = |value: f64, std: f64, step: f64| {
            let noisy = value + std * rng.sample::<f64, _>(StandardNormal);
            if quantised { (noisy / step).round() * step } else { noisy }
        };
        let mut rows: Vec<(f64, f64, f64, f64)> = Vec::new();
        for (k, &time_s) in self.times.iter().enumerate() {
            let i = read(self.current[k], self.current_noise_a, current_step_a);
            let w = read(self.speed[k], self.speed_noise_rad_s, speed_step_rad_s);
            rows.push((time_s, f64::NAN, i, w));
        }
        for &(time_s, volts) in &self.events {
            match rows.binary_search_by(|row| row.0.total_cmp(&time_s)) {
                Ok(at) => rows[at].1 = volts,
                Err(at) => rows.insert(at, (time_s, volts, f64::NAN, f64::NAN)),
            }
        }
        let mut run = Run::new("seeded", rows.iter().map(|row| row.0).collect()).unwrap();
        let column = |pick: fn(&(f64, f64, f64, f64)) -> f64| rows.iter().map(pick).collect();
        for (channel, origin, values) in [
            (Channel::VoltageCmd, Origin::Commanded, column(|r| r.1)),
            (Channel::Current, Origin::Measured, column(|r| r.2)),
            (Channel::Speed, Origin::Measured, column(|r| r.3)),
        ] {
            run.set_column(channel, values, origin).unwrap();
        }
        run
    }
}

/// Current and speed at `times` under held voltages, by the emulator's machine in fine steps.
fn integrate(truth: &[f64; 5], events: &[(f64, f64)], times: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let [resistance_ohm, inductance_h, back_emf_v_s_per_rad, inertia_kg_m2, load_torque_n_m] =
        *truth;
    let mut plant = Plant::new(
        MotorTruth {
            name: "random".to_owned(),
            rated_voltage_v: 1.0,
            rated_current_a: 1.0,
            rated_speed_rad_s: 1.0,
            resistance_ohm,
            inductance_h,
            back_emf_v_s_per_rad,
            torque_n_m_per_a: None,
            inertia_kg_m2,
            load_torque_n_m,
        },
        &[],
    );
    let longest_s = TRUTH_STEP_S.min(STEP_SHARE * inductance_h / resistance_ohm);
    let (mut now_s, mut volts, mut next) = (0.0, 0.0, 0);
    let (mut current, mut speed) = (Vec::new(), Vec::new());
    for &time_s in times {
        loop {
            while events.get(next).is_some_and(|event| event.0 <= now_s) {
                volts = events[next].1;
                next += 1;
            }
            let until_s = events.get(next).map_or(time_s, |event| event.0.min(time_s));
            let steps = ((until_s - now_s) / longest_s).ceil().max(0.0);
            let mut left = steps;
            while left > 0.0 {
                plant.advance(Terminals::Voltage(volts), (until_s - now_s) / steps);
                left -= 1.0;
            }
            now_s = until_s;
            if now_s >= time_s {
                break;
            }
        }
        current.push(plant.current_a());
        speed.push(plant.speed_rad_s());
    }
    (current, speed)
}
