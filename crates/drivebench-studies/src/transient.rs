//! Figure 4, the transient that Table 1 is identified from, and Table 1: scheme 2 after N samples. The paper shows the
//! transient as a measured curve only, so it is recorded here on an emulated ZK-22FC.

use rayon::prelude::*;
use serde::Serialize;

use super::figure_3;
use super::machine::{random, simulated, stamps, value, white, with_noise};
use drivebench::identification::recursive::{CurrentIntegral, Scheme2};
use drivebench::numerics::statistics::{mean, variance};
use drivebench::plant::{Input, Motor, MotorKey, Scenario, State, Trajectory};
use drivebench::sample::Channel;

/// The start and its record.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Start {
    /// The full 110 V would draw 75 A on a motor of 5.7 A; 25 V draws some three times rated.
    pub voltage_v: f64,
    /// A third of L/R = 9 ms; fifty samples cover the transient of a motor with TM = 40 ms.
    pub period_s: f64,
    #[serde(skip)]
    samples: usize,
    /// Standard deviations of the emulated sensors.
    speed_noise_rad_s: f64,
    current_noise_a: f64,
    /// Points of the curve between two samples.
    #[serde(skip)]
    fine: usize,
}

pub(super) const START: Start = Start {
    voltage_v: 25.0,
    period_s: 0.003,
    samples: 51,
    speed_noise_rad_s: 0.15,
    current_noise_a: 0.03,
    fine: 10,
};

/// A start under a constant voltage.
#[derive(Clone, Debug, Serialize)]
pub struct Figure4 {
    pub motor: String,
    #[serde(flatten)]
    pub settings: Start,
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
    let record = noisy(&start(&motor, START.period_s, START.samples), 1);
    let fine_period_s = START.period_s / START.fine as f64;
    let points = (START.samples - 1) * START.fine + 1;
    let fine = start(&motor, fine_period_s, points);
    Figure4 {
        motor: motor.name.clone(),
        settings: START,
        time_s: stamps(START.period_s, START.samples),
        current_a: record.current_a,
        speed_rad_s: record.speed_rad_s,
        fine: Fine {
            time_s: stamps(fine_period_s, points),
            current_a: fine.current_a,
            speed_rad_s: fine.speed_rad_s,
        },
    }
}

/// The start from rest without noise, true stiction at its beginning.
fn start(motor: &Motor, period_s: f64, samples: usize) -> Trajectory {
    let events = vec![(0.0, START.voltage_v)];
    let times = stamps(period_s, samples);
    let scenario = Scenario::planned("start", Input::Voltage, Channel::Voltage, events, times);
    simulated(motor, &scenario, State::default())
}

/// The same with the noise of its sensors.
fn noisy(clean: &Trajectory, seed: u64) -> Trajectory {
    let samples = clean.speed_rad_s.len();
    let noise = |purpose| white(&mut random(seed, purpose), samples);
    Trajectory {
        current_a: with_noise(&clean.current_a, &noise(1), START.current_noise_a),
        speed_rad_s: with_noise(&clean.speed_rad_s, &noise(2), START.speed_noise_rad_s),
    }
}

/// Paper A, Table 1: N, J in 1e-6 kg.m2, Mc in N.m.
const PRINTED: [(usize, f64, f64); 6] = [
    (8, 3654.0, 0.4380),
    (10, 4650.0, 0.4644),
    (20, 4483.0, 0.4630),
    (30, 4500.0, 0.4549),
    (40, 4508.0, 0.4552),
    (50, 4536.0, 0.4149),
];
/// Periods to compare with that of the table, s; the last is half of L/R.
const PERIODS_S: [f64; 5] = [0.001, 0.002, 0.003, 0.004, 0.004_5];
const SEEDS: u64 = 200;

/// J and Mc.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Values {
    pub inertia_kg_m2: f64,
    pub load_torque_n_m: f64,
}

/// One quantity over the seeds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OverSeeds {
    pub mean: f64,
    pub std: f64,
    /// Of the mean, per cent of the truth.
    pub error_percent: f64,
    /// Share of all seeds whose 95 % interval holds the truth, per cent; a seed without an estimate does not.
    pub coverage_percent: f64,
    /// Share of the seeds that give an estimate at all, per cent.
    pub told_percent: f64,
}

/// The same transient after N steps from sample to sample.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Row {
    pub period_s: f64,
    pub n: usize,
    /// As printed, from the paper's own measured transient.
    pub paper: Values,
    /// Noise-free, with the printed left rectangle.
    pub rectangle: Values,
    /// Noise-free, with the trapezoid.
    pub trapezoid: Values,
    /// With the noise of the sensors, trapezoid.
    pub inertia_with_noise: OverSeeds,
    pub load_torque_with_noise: OverSeeds,
}

#[derive(Clone, Debug, Serialize)]
pub struct Table1 {
    /// What the emulated motor really has.
    pub truth: Values,
    /// The paper's.
    pub catalogue_inertia_kg_m2: f64,
    pub period_s: f64,
    pub electrical_time_constant_s: f64,
    /// That of Figure 3: for Table 1 the paper gives none.
    pub forgetting: f64,
    pub seeds: u64,
    pub rows: Vec<Row>,
    /// What the period does: N = 20 and 50 of the same start.
    pub by_period: Vec<Row>,
}

pub(super) fn table_1() -> Table1 {
    let motor = Motor::zk_22fc();
    let truth = truth(&motor);
    Table1 {
        truth,
        catalogue_inertia_kg_m2: 0.004_25,
        period_s: START.period_s,
        electrical_time_constant_s: motor.electrical_time_constant_s().unwrap_or(f64::NAN),
        forgetting: figure_3::SETTINGS.forgetting,
        seeds: SEEDS,
        rows: rows(&motor, START.period_s),
        by_period: (PERIODS_S.iter().flat_map(|period_s| rows(&motor, *period_s)))
            .filter(|row| row.n == 20 || row.n == 50)
            .collect(),
    }
}

fn truth(motor: &Motor) -> Values {
    Values {
        inertia_kg_m2: value(motor, MotorKey::Inertia),
        load_torque_n_m: value(motor, MotorKey::LoadTorque),
    }
}

fn rows(motor: &Motor, period_s: f64) -> Vec<Row> {
    let clean = start(motor, period_s, START.samples);
    let truth = truth(motor);
    let silent = |integral| at_each_n(motor, period_s, &clean, integral);
    let rectangle = silent(CurrentIntegral::Rectangle);
    let trapezoid = silent(CurrentIntegral::Trapezoid);
    let noisy = |seed| {
        let record = noisy(&clean, seed);
        at_each_n(motor, period_s, &record, CurrentIntegral::Trapezoid)
    };
    let noisy: Vec<Vec<Estimates>> = (0..SEEDS).into_par_iter().map(noisy).collect();
    let over_seeds = |row: usize, which: usize, truth: f64| {
        OverSeeds::of(truth, noisy.iter().map(|seed| seed[row][which]))
    };
    let values =
        |inertia_kg_m2: f64, load_torque_n_m: f64| Values { inertia_kg_m2, load_torque_n_m };
    let of = |estimates: &Estimates| values(estimates[0].0, estimates[1].0);
    let rows = PRINTED.iter().enumerate().map(|(row, printed)| Row {
        period_s,
        n: printed.0,
        paper: values(printed.1 * 1e-6, printed.2),
        rectangle: of(&rectangle[row]),
        trapezoid: of(&trapezoid[row]),
        inertia_with_noise: over_seeds(row, 0, truth.inertia_kg_m2),
        load_torque_with_noise: over_seeds(row, 1, truth.load_torque_n_m),
    });
    rows.collect()
}

/// Value and standard deviation of J and of Mc; NaN where the scheme gives none.
type Estimates = [(f64, f64); 2];

/// The estimates after each N of the table: N steps from one sample to the next, from the start of the voltage on.
fn at_each_n(
    motor: &Motor,
    period_s: f64,
    record: &Trajectory,
    integral: CurrentIntegral,
) -> Vec<Estimates> {
    let mut scheme = Scheme2::new(integral, figure_3::SETTINGS.forgetting, 0.0);
    scheme.set_speed_noise(START.speed_noise_rad_s);
    let torque = Some((value(motor, MotorKey::BackEmf), 0.0));
    let mut found = Vec::new();
    for (k, time_s) in stamps(period_s, START.samples).into_iter().enumerate() {
        scheme.push(time_s, record.current_a[k], record.speed_rad_s[k]);
        if PRINTED.iter().any(|printed| printed.0 == k) {
            let estimates = scheme.estimates(torque);
            let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
            found.push([0, 1].map(|which| {
                let own = &estimates[which];
                (or_nan(own.value), or_nan(own.std))
            }));
        }
    }
    found
}

impl OverSeeds {
    fn of(truth: f64, estimates: impl Iterator<Item = (f64, f64)>) -> Self {
        let all: Vec<(f64, f64)> = estimates.collect();
        let finite: Vec<f64> = all.iter().map(|e| e.0).filter(|v| v.is_finite()).collect();
        let holds = |(value, std): &&(f64, f64)| (value - truth).abs() <= 1.96 * std;
        let covered = all.iter().filter(holds).count();
        let centre = mean(&finite);
        let percent = |count: usize| 100.0 * count as f64 / all.len().max(1) as f64;
        Self {
            mean: centre,
            std: variance(&finite).sqrt(),
            error_percent: 100.0 * (centre / truth - 1.0),
            coverage_percent: percent(covered),
            told_percent: percent(finite.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transient_starts_at_rest_peaks_and_settles() {
        let figure = figure_4();
        let peak = figure.current_a.iter().copied().fold(0.0, f64::max);
        assert!((10.0..25.0).contains(&peak), "{peak}");
        let motor = Motor::zk_22fc();
        let ke = value(&motor, MotorKey::BackEmf);
        let settled = (START.voltage_v - 1.1 * 0.455 / ke) / ke;
        let last = figure.speed_rad_s[START.samples - 1];
        assert!((last / settled - 1.0).abs() < 0.04, "{last} {settled}");
        // Sampled curve and fine curve are one motor.
        let clean = start(&motor, START.period_s, START.samples);
        for (k, speed) in clean.speed_rad_s.iter().enumerate() {
            assert!((speed - figure.fine.speed_rad_s[START.fine * k]).abs() < 1e-9);
        }
    }
}
