//! The diagnosis of what a torque or a current drives, on simulated messy records and on real ones.

mod driven;
mod placebo;
mod real;
mod simulated;

use crate::diagnosis::AddResult;
use crate::diagnosis::candidates::Status;
use crate::diagnosis::diagnose::{Diagnosis, DiagnosisVerdict};
use crate::diagnosis::evidence::Evidence;
use crate::identification::output_error::FitError;
use crate::plant::{Effect, Instant, Model, Scenario, effect};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn diagnose(model: &Model, evidence: &Evidence) -> Result<Diagnosis, FitError> {
    crate::diagnosis::diagnose(model, evidence.clone())
}

fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: &Evidence,
) -> Result<AddResult, FitError> {
    crate::diagnosis::add(effect, model, evidence.clone())
}

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

/// Size and standard deviation of the effect's first coefficient, fitted beside the model; no deviation where it is held at
/// zero because it would drive the shaft.
fn size(model: &Model, evidence: &Evidence, effect: &'static dyn Effect) -> (f64, Option<f64>) {
    let result = add(effect, model, evidence).unwrap();
    let first = &result.parameters[0];
    (first.value.unwrap(), first.std)
}

/// Puts an effect of these values into a record in several sizes, and asserts that each is found by as much more.
fn doses_are_found(model: &Model, data: &Evidence, id: &str, values: &[f64]) {
    const DOSES: [f64; 3] = [2.0, 0.5, 0.0];
    assert!(!model.has(id), "{id} is in the model: nothing is tested");
    let effect = effect::find(id).unwrap();
    let unit = values[0];
    let mut largest: Option<f64> = None;
    let mut above = f64::INFINITY;
    for dose in DOSES {
        let mut values = values.to_vec();
        values[0] = dose * unit;
        let mut dosed_data = data.clone();
        for run in [&mut dosed_data.training, &mut dosed_data.holdout] {
            *run = dosed(run, effect, &values);
        }
        let (found, std) = size(model, &dosed_data, effect);
        let largest = *largest.get_or_insert(found);
        let expected = largest - (DOSES[0] - dose) * unit;
        eprintln!("{id} x {dose}: {found:.4e} +- {std:?}, expected {expected:.4e}");
        let Some(std) = std else {
            assert!(expected < 0.1 * unit, "{id} x {dose}: held at zero");
            continue;
        };
        assert!(
            (found - expected).abs() < 3.0 * std + 0.03 * unit,
            "{id} x {dose}: {found} +- {std}, {expected}"
        );
        assert!(found < above, "{id} x {dose}: {found} after {above}");
        above = found;
    }
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
