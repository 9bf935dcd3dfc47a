//! Figure 4: the transient from which Table 1 is identified. The paper shows it as a measured curve only, so it is
//! recorded here on an emulated ZK-22FC.

use serde::Serialize;

use crate::plant::{Input, Model, Motor, Plant, Scenario, State, Trajectory};
use crate::sample::Channel;

use super::signal::{random, white, with_noise};

/// Voltage of the start: the full 110 V would draw 75 A on a motor of 5.7 A; 25 V draws some three times rated.
pub(super) const VOLTAGE_V: f64 = 25.0;
/// A third of L/R = 9 ms; fifty samples cover the transient of a motor with TM = 40 ms.
pub(super) const PERIOD_S: f64 = 0.003;
pub(super) const SAMPLES: usize = 51;
/// Standard deviations of the emulated sensors.
pub(super) const SPEED_NOISE_RAD_S: f64 = 0.15;
pub(super) const CURRENT_NOISE_A: f64 = 0.03;
const SHOWN_SEED: u64 = 1;
/// Points of the curve between two samples.
const FINE: usize = 10;

/// A start under a constant voltage.
#[derive(Clone, Debug, Serialize)]
pub struct Figure4 {
    pub motor: String,
    pub voltage_v: f64,
    pub period_s: f64,
    pub speed_noise_rad_s: f64,
    pub current_noise_a: f64,
    pub time_s: Vec<f64>,
    pub current_a: Vec<f64>,
    pub speed_rad_s: Vec<f64>,
    /// The emulated motor between the samples.
    #[serde(skip)]
    pub fine: Fine,
}

#[derive(Clone, Debug, Default)]
pub struct Fine {
    pub time_s: Vec<f64>,
    pub current_a: Vec<f64>,
    pub speed_rad_s: Vec<f64>,
}

pub(super) fn figure_4() -> Figure4 {
    let motor = Motor::zk_22fc();
    let record = noisy(&start(&motor, PERIOD_S, SAMPLES), SHOWN_SEED);
    let fine_period_s = PERIOD_S / FINE as f64;
    let points = (SAMPLES - 1) * FINE + 1;
    let fine = start(&motor, fine_period_s, points);
    Figure4 {
        motor: motor.name.clone(),
        voltage_v: VOLTAGE_V,
        period_s: PERIOD_S,
        speed_noise_rad_s: SPEED_NOISE_RAD_S,
        current_noise_a: CURRENT_NOISE_A,
        time_s: stamps(PERIOD_S, SAMPLES),
        current_a: record.current_a,
        speed_rad_s: record.speed_rad_s,
        fine: Fine {
            time_s: stamps(fine_period_s, points),
            current_a: fine.current_a,
            speed_rad_s: fine.speed_rad_s,
        },
    }
}

pub(super) fn stamps(period_s: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|k| period_s * k as f64).collect()
}

/// The start from rest without noise, true stiction at its beginning.
pub(super) fn start(motor: &Motor, period_s: f64, samples: usize) -> Trajectory {
    let scenario = Scenario {
        name: "start".to_owned(),
        input: Input::Voltage,
        input_channel: Channel::Voltage,
        events: vec![(0.0, VOLTAGE_V)],
        sample_time_s: stamps(period_s, samples),
        current_a: vec![],
        speed_rad_s: vec![],
        angle: vec![],
        time_half_width_s: vec![],
        unknown_input: vec![],
        scored: 0..samples,
    };
    Plant::new(&Model::baseline(motor.clone()), Input::Voltage)
        .expect("the motor of the paper is complete")
        .simulate(&scenario, State::default())
}

/// The same with the noise of its sensors.
pub(super) fn noisy(clean: &Trajectory, seed: u64) -> Trajectory {
    let samples = clean.speed_rad_s.len();
    let noise = |purpose| white(&mut random(seed, purpose), samples);
    Trajectory {
        current_a: with_noise(&clean.current_a, &noise(1), CURRENT_NOISE_A),
        speed_rad_s: with_noise(&clean.speed_rad_s, &noise(2), SPEED_NOISE_RAD_S),
    }
}

#[cfg(test)]
mod tests {
    use super::super::machine::value;
    use super::*;
    use crate::plant::MotorKey;

    #[test]
    fn the_transient_starts_at_rest_peaks_and_settles() {
        let figure = figure_4();
        let peak = figure.current_a.iter().copied().fold(0.0, f64::max);
        assert!((10.0..25.0).contains(&peak), "{peak}");
        let motor = Motor::zk_22fc();
        let ke = value(&motor, MotorKey::BackEmf);
        let settled = (VOLTAGE_V - 1.1 * 0.455 / ke) / ke;
        let last = figure.speed_rad_s[SAMPLES - 1];
        assert!((last / settled - 1.0).abs() < 0.04, "{last} {settled}");
        // Sampled curve and fine curve are one motor.
        let clean = start(&motor, PERIOD_S, SAMPLES);
        for (k, speed) in clean.speed_rad_s.iter().enumerate() {
            assert!((speed - figure.fine.speed_rad_s[FINE * k]).abs() < 1e-9);
        }
    }
}
