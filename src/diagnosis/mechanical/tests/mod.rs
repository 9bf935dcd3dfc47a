//! Tests that a simulation cannot cheat (DISCOVERY.md, rule 6), on a simulated messy record and on real ones.

mod real;
mod simulated;

use super::diagnose::diagnose_with;
use super::*;
use crate::diagnosis::candidates::{Candidate, Status};
use crate::diagnosis::diagnose::{Diagnosis, DiagnosisVerdict};
use crate::diagnosis::evidence::Evidence;
use crate::plant::{Effect, Instant, Model, Scenario, effect};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn with_effects(mut model: Model, ids: &[&str]) -> Model {
    for id in ids {
        model = model.with_effect(id).unwrap();
    }
    model
}

/// The record as if the machine had this effect as well: the torque that it takes is added to the motor's.
fn dosed(scenario: &Scenario, effect: &'static dyn Effect, values: &[f64]) -> Scenario {
    let terms = effect.terms(values);
    let mut dosed = scenario.clone();
    let speeds: Vec<(f64, f64)> = scenario
        .sample_time_s
        .iter()
        .copied()
        .zip(scenario.speed_rad_s.iter().copied())
        .filter(|point| point.1.is_finite())
        .collect();
    for event in &mut dosed.events {
        let nearest = speeds.partition_point(|point| point.0 < event.0);
        let speed_rad_s = speeds[nearest.min(speeds.len() - 1)].1;
        let at = Instant {
            speed_rad_s,
            ..Instant::default()
        };
        event.1 += terms.torque_n_m(&at, &[]) + speed_rad_s.signum() * terms.friction_n_m(&at);
    }
    dosed
}

/// Size and standard deviation of the effect's first coefficient, fitted beside the model.
fn size(model: &Model, evidence: &Evidence, effect: &'static dyn Effect) -> (f64, f64) {
    let result = add(effect, model, evidence).unwrap();
    let first = &result.parameters[0];
    (first.value.unwrap(), first.std.unwrap())
}

/// Placebos: what no machine has, and what belongs to another moment.
fn placebos(count: usize, seed: u64) -> Vec<Extra> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut placebos = vec![Extra {
        id: "placebo: sin 3.7 w",
        values: Box::new(|at| at.iter().map(|at| (3.7 * at.speed_rad_s).sin()).collect()),
    }];
    while placebos.len() < count {
        let kind = placebos.len() % 4;
        let seed: u64 = rng.random();
        // At least a tenth of the record away.
        let shift: f64 = rng.random_range(0.1..0.9);
        let order: f64 = rng.random_range(1.0..20.0);
        let shifted = move |at: &[Instant], term: fn(&Instant) -> f64| -> Vec<f64> {
            let by = crate::numerics::count::whole(shift * at.len() as f64);
            (0..at.len())
                .map(|k| term(&at[(k + by) % at.len()]))
                .collect()
        };
        placebos.push(match kind {
            0 => Extra {
                id: "placebo: shuffled angle",
                values: Box::new(move |at| {
                    let mut angles: Vec<f64> = at.iter().map(|at| at.angle_rad).collect();
                    angles.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
                    angles.iter().map(|angle| (order * angle).sin()).collect()
                }),
            },
            1 => Extra {
                id: "placebo: shifted w",
                values: Box::new(move |at| shifted(at, |at| at.speed_rad_s)),
            },
            2 => Extra {
                id: "placebo: shifted w |w|",
                values: Box::new(move |at| shifted(at, |at| at.speed_rad_s * at.speed_rad_s.abs())),
            },
            // Less its mean: that is a constant load, which a record may well miss.
            _ => Extra {
                id: "placebo: shifted |w| less its mean",
                values: Box::new(move |at| {
                    let sizes = shifted(at, |at| at.speed_rad_s.abs());
                    let mean = crate::numerics::statistics::mean(&sizes);
                    sizes.iter().map(|size| size - mean).collect()
                }),
            },
        });
    }
    placebos
}

/// How many of the placebos are supported.
fn supported(candidates: &[Candidate]) -> usize {
    let is_supported = |candidate: &&Candidate| candidate.status == Status::Supported;
    for candidate in candidates.iter().filter(is_supported) {
        eprintln!("{}: {}", candidate.effect, candidate.evidence);
    }
    candidates.iter().filter(is_supported).count()
}

/// Every setting turned by a fifth either way.
fn turned() -> Vec<Settings> {
    let usual = Settings::default();
    [0.8, 1.2]
        .into_iter()
        .flat_map(|factor| {
            [
                Settings {
                    filter: factor,
                    ..usual
                },
                Settings {
                    block: factor,
                    ..usual
                },
                Settings {
                    significant: 3.0 * factor,
                    ..usual
                },
            ]
        })
        .collect()
}

fn status(diagnosis: &Diagnosis, id: &str) -> Status {
    let found = diagnosis
        .candidates
        .iter()
        .find(|candidate| candidate.effect == id);
    found
        .expect("every effect of the catalogue is judged")
        .status
}
