//! 95 % intervals cover the truth: counted over seeded records of random motors under random voltage steps.
//!
//! ```text
//! record (emulator's Runge-Kutta truth, own noise, jitter, quantisation) -> scheme -> value, std -> inside or outside?
//! ```
//!
//! `cargo test --release --test bench coverage -- --nocapture` prints the table.
#![expect(clippy::print_stdout, reason = "the table is its product")]

mod record;

use drivebench::identification::noise::NoiseFloor;
use drivebench::identification::online::{Online, OnlineConfig};
use drivebench::identification::{output_error, start, weak_form};
use drivebench::plant::{Model, Motor, MotorKey, Scenario};
use drivebench::sample::{ParameterEstimate, Run, Verdict};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use record::{Sampling, Trajectory};

use crate::{everything, tolerance};

const SECONDS: f64 = 5.0;
/// Motors, each with an excitation of its own.
const MOTORS: u64 = 80;
/// Not the numbers that the methods were developed with.
const FIRST_MOTOR: u64 = 500_000;

const LEAST: f64 = 0.90;
const MOST: f64 = 0.98;

const KEYS: [MotorKey; 5] = [
    MotorKey::Resistance,
    MotorKey::Inductance,
    MotorKey::BackEmf,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

/// Noise seeds of each motor.
fn seeds() -> u64 {
    if everything() { 5 } else { 2 }
}

type Scheme = fn(&Run, &Trajectory) -> Vec<ParameterEstimate>;

fn fit_output_error(run: &Run, _: &Trajectory) -> Vec<ParameterEstimate> {
    let scenario = Scenario::from_run(run).unwrap();
    let noise = NoiseFloor::from_standstill(&scenario)
        .unwrap_or_else(|| NoiseFloor::from_spread(&scenario));
    let model = start::complete(&Model::baseline(Motor::new("?")), &scenario).unwrap();
    output_error::fit(&[model], &scenario, &noise).unwrap().parameters
}

fn fit_weak_form(run: &Run, _: &Trajectory) -> Vec<ParameterEstimate> {
    let scenario = Scenario::from_run(run).unwrap();
    weak_form::fit(&Model::baseline(Motor::new("?")), &scenario)
        .into_iter()
        .flat_map(|balance| balance.parameters)
        .collect()
}

fn scheme_3(run: &Run, _: &Trajectory) -> Vec<ParameterEstimate> {
    online(run, OnlineConfig::default()).estimates()
}

fn scheme_2(run: &Run, trajectory: &Trajectory) -> Vec<ParameterEstimate> {
    let config =
        OnlineConfig { torque_n_m_per_a: Some(trajectory.truth[2]), ..OnlineConfig::default() };
    online(run, config).scheme_2()
}

fn online(run: &Run, config: OnlineConfig) -> Online {
    let mut online = Online::new(config);
    for sample in run.samples() {
        online.push(&sample);
    }
    online
}

fn alternating(motor: u64) -> Sampling {
    [Sampling::Regular, Sampling::Fast][usize::from(motor % 2 == 1)]
}

#[derive(Clone, Copy, Default)]
struct Count {
    valued: u32,
    covered: u32,
    settled: u32,
    settled_covered: u32,
    squares: f64,
}

impl Count {
    fn add(&mut self, estimate: &ParameterEstimate, truth: f64) {
        let (Some([low, high]), Some(value), Some(std)) =
            (estimate.interval_95(), estimate.value, estimate.std)
        else {
            return;
        };
        let inside = u32::from((low..=high).contains(&truth));
        self.valued += 1;
        self.covered += inside;
        self.squares += ((value - truth) / std).powi(2);
        if estimate.verdict == Verdict::Settled {
            self.settled += 1;
            self.settled_covered += inside;
        }
    }

    fn share(self) -> f64 {
        f64::from(self.covered) / f64::from(self.valued)
    }
}

/// Counts of one scheme on one kind of data, by parameter, with the table's line of each.
fn counts(name: &str, scheme: Scheme, sampling: Sampling) -> [Count; 5] {
    let trajectories: Vec<Trajectory> = (0..MOTORS)
        .into_par_iter()
        .map(|motor| Trajectory::random(FIRST_MOTOR + motor, sampling, SECONDS))
        .collect();
    let seeds = seeds();
    let found: Vec<(usize, Vec<ParameterEstimate>)> = (0..MOTORS * seeds)
        .into_par_iter()
        .map(|seed| {
            let index = usize::try_from(seed / seeds).unwrap();
            let trajectory = &trajectories[index];
            (index, scheme(&trajectory.run(seed), trajectory))
        })
        .collect();
    let mut counts = [Count::default(); 5];
    for (index, estimates) in &found {
        for (j, key) in KEYS.iter().enumerate() {
            if let Some(estimate) = estimates.iter().find(|e| e.key == key.key()) {
                counts[j].add(estimate, trajectories[*index].truth[j]);
            }
        }
    }
    for (count, key) in counts.iter().zip(&KEYS) {
        if count.valued > 0 {
            println!(
                "{name:12} {:9} {:22} of {:3}: valued {:3} covered {:5.1} %  settled {:3} covered {:5.1} %  rms z {:.2}",
                format!("{sampling:?}"),
                key.key(),
                found.len(),
                count.valued,
                100.0 * count.share(),
                count.settled,
                100.0 * f64::from(count.settled_covered) / f64::from(count.settled),
                (count.squares / f64::from(count.valued)).sqrt()
            );
        }
    }
    counts
}

/// `most`: what an interval may cover at most; one that bounds an error of quadrature instead of a random one may cover
/// all.
fn check(name: &str, scheme: Scheme, most: f64, keys: std::ops::Range<usize>) {
    let kinds = [Sampling::Regular, Sampling::Jittered, Sampling::Quantised, Sampling::Fast];
    let mut wrong = Vec::new();
    for sampling in kinds {
        let counts = counts(name, scheme, sampling);
        for j in keys.clone() {
            let count = counts[j];
            let share = count.share();
            let chance = |edge: f64| tolerance(edge, count.valued as usize);
            let allowed = LEAST - chance(LEAST)..=most + chance(most);
            if !allowed.contains(&share) {
                wrong.push(format!("{sampling:?} {} {share:.3}", KEYS[j].key()));
            }
            // A scheme must not pass by giving no value: L/R below the period may hide the inductance, nothing else.
            let least = if j == 1 { 0.4 } else { 0.9 };
            if f64::from(count.valued) < least * (MOTORS * seeds()) as f64 && most < 1.0 {
                wrong.push(format!("{sampling:?} {} valued {}", KEYS[j].key(), count.valued));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn output_error_covers() {
    check("output-error", fit_output_error, MOST, 0..5);
}

#[test]
fn scheme_3_covers() {
    check("scheme 3", scheme_3, MOST, 0..5);
}

#[test]
fn scheme_2_covers() {
    check("scheme 2", scheme_2, 1.0, 3..5);
}

#[test]
fn the_weak_form_covers() {
    check("weak-form", fit_weak_form, 1.0, 0..5);
}

#[test]
fn a_nameplate_far_off_changes_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut inside, mut all, mut wrong) = (0, 0, Vec::new());
    for motor in 0..MOTORS {
        let sampling = alternating(motor);
        let trajectory = Trajectory::random(FIRST_MOTOR + 1000 + motor, sampling, SECONDS);
        let mut nameplate = Motor::new("nameplate");
        for (key, truth) in KEYS.iter().zip(trajectory.truth) {
            nameplate.set(*key, truth * rng.random_range(0.3_f64.ln()..3_f64.ln()).exp());
        }
        let config = OnlineConfig::from_model(&Model::baseline(nameplate));
        assert!(config.start.is_some());
        let run = trajectory.run(motor);
        for (estimate, truth) in online(&run, config).estimates().iter().zip(trajectory.truth) {
            let Some([low, high]) = estimate.interval_95() else {
                continue;
            };
            all += 1;
            inside += i32::from((low..=high).contains(&truth));
            let z = (estimate.value.unwrap() - truth) / estimate.std.unwrap();
            if z.abs() > 5.0 {
                wrong.push(format!("{motor} {} z {z:.1}: {estimate:?}", trajectory.describe()));
            }
        }
    }
    let share = f64::from(inside) / f64::from(all);
    println!("nameplates off by 0.3 to 3: {all} values, covered {:.1} %", 100.0 * share);
    assert!(share > 0.88 && wrong.len() <= 2, "{share} {wrong:#?}");
    assert!(f64::from(all) > 4.0 * MOTORS as f64, "{all}");
}

#[test]
fn a_steady_state_settles_nothing_that_it_does_not_carry() {
    let schemes: [(&str, Scheme); 4] = [
        ("output-error", fit_output_error),
        ("scheme 3", scheme_3),
        ("scheme 2", scheme_2),
        ("weak-form", fit_weak_form),
    ];
    let claims: Vec<String> = (0..MOTORS)
        .into_par_iter()
        .flat_map_iter(|motor| {
            let sampling = alternating(motor);
            let trajectory = Trajectory::steady(FIRST_MOTOR + 2000 + motor, sampling, SECONDS);
            let run = trajectory.run(motor);
            schemes.into_iter().flat_map(move |(name, scheme)| {
                let about = format!("{name} {}", trajectory.describe());
                let first = if name == "scheme 2" { 3 } else { 0 };
                let truths = KEYS.into_iter().zip(trajectory.truth).skip(first);
                let found = scheme(&run, &trajectory).into_iter().zip(truths);
                found
                    .filter(|(estimate, (key, _))| {
                        *key != MotorKey::LoadTorque && estimate.verdict == Verdict::Settled
                    })
                    .map(|(estimate, (_, truth))| format!("{about} {estimate:?} {truth}"))
                    .collect::<Vec<String>>()
            })
        })
        .collect();
    assert!(claims.is_empty(), "{} {:#?}", claims.len(), &claims[..claims.len().min(12)]);
}
