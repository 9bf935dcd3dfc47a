//! Machines with known parameters and their runs, for the tests of this crate.

use super::{Candidate, Diagnosis, Evidence};
use drivebench_model::plant::{ActiveEffect, Model, Motor, Scenario, effect, testing};

pub(super) fn nameplate() -> Model {
    Model::baseline(Motor::zk_22fc())
}

/// An effect of the catalogue with these values.
pub(super) fn active(id: &str, values: &[f64]) -> ActiveEffect {
    ActiveEffect::with(effect::find(id).unwrap(), values)
}

/// The model with more effects.
pub(super) fn with(mut model: Model, effects: &[(&str, &[f64])]) -> Model {
    let more = effects.iter().map(|(id, values)| active(id, values));
    model.effects.extend(more);
    model
}

pub(super) fn truth(id: &str, values: &[f64]) -> Model {
    with(nameplate(), &[(id, values)])
}

/// Levels of the voltage, held from these times on, after a rest.
pub(super) fn held(levels_v: &[f64], hold_s: f64) -> Vec<(f64, f64)> {
    let held = levels_v.iter().enumerate().map(|(k, level_v)| (0.5 + hold_s * k as f64, *level_v));
    std::iter::once((0.0, 0.0)).chain(held).collect()
}

/// Staircase both ways with slow passages through zero; `shift` makes another run of it.
pub(super) fn record(model: &Model, shift: usize, seed: u64) -> Scenario {
    let levels =
        [0.0, 30.0, 60.0, 90.0, 40.0, 3.0, -3.0, -40.0, -90.0, -50.0, 4.0, 0.0, 70.0, -70.0, 20.0];
    let mut events = vec![(0.0, 0.0)];
    for step in 1..levels.len() {
        let level = levels[1 + (step + 3 * shift) % (levels.len() - 1)];
        let (begin_s, more) = (0.5 * step as f64, if step % 2 == 0 { 5.0 } else { -5.0 });
        events.extend([(begin_s, level), (begin_s + 0.25, level + more)]);
    }
    testing::record(model, events, 0.004, 7.5, seed)
}

/// Fit run, hold-out and confirming run of a machine.
pub(super) fn evidence(truth: &Model, seed: u64) -> Evidence {
    let run = |shift: usize| record(truth, shift, 10 * seed + shift as u64);
    Evidence::new(run(0), Some(run(1)), Some(run(2)))
}

/// The candidate of an effect.
pub(super) fn candidate<'a>(diagnosis: &'a Diagnosis, id: &str) -> &'a Candidate {
    diagnosis.candidates.iter().find(|candidate| candidate.effect == id).unwrap()
}

/// The names of an answer in alphabetical order.
pub(super) fn names(diagnosis: &Diagnosis) -> Vec<&'static str> {
    let mut names = diagnosis.effects.clone();
    names.sort_unstable();
    names
}
