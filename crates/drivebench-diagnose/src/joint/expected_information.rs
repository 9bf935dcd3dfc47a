//! Expected information of a run that is still to be made (Bayesian design of experiments: Chaloner and Verdinelli, Statistical
//! Science 10, 1995): the same linear problem as that of the answer, with a record as the model expects it.

use super::columns::linearise;
use super::detectability::{UNDETECTABLE_SLABS, spread_slabs};
use super::eligible::{prepared, starts};
use super::events::Hypothesis;
use super::kalman::Noise;
use super::run::LinearisedRun;
use super::select::{Reduced, Set};
use super::solution::{linearised_runs, present};
use crate::evidence::Evidence;
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::{Effect, Model, Scenario, State};

/// The noise that a diagnosis found in its runs, on which the expected information of the next one rests.
#[derive(Clone, Copy, Debug)]
pub struct InformationBasis {
    noise: Noise,
    excess: f64,
    /// What the run that is fitted first begins with.
    start: State,
}

impl InformationBasis {
    pub(crate) const fn new(noise: Noise, excess: f64, start: State) -> Self {
        Self { noise, excess, start }
    }
}

/// Squared size of a slab, in standard deviations, from which on an effect shows.
pub(crate) const DETECTS: f64 = 1.0 / (UNDETECTABLE_SLABS * UNDETECTABLE_SLABS);

/// The runs in hand around a model.
pub(crate) struct ExpectedInformation {
    hypothesis: Hypothesis,
    eligible: Vec<&'static dyn Effect>,
    runs: Vec<Scenario>,
    starts: Vec<State>,
    basis: InformationBasis,
}

impl ExpectedInformation {
    /// Of the `eligible` effects, beside everything that `model` has.
    pub(crate) fn new(
        model: &Model,
        eligible: &[&'static dyn Effect],
        evidence: &Evidence,
        basis: InformationBasis,
    ) -> Self {
        let known = evidence.noise.source != FloorSource::None;
        let (in_hand, held_out) = evidence.speaking();
        let runs: Vec<Scenario> = in_hand.iter().map(|run| prepared(run, known)).collect();
        let own = model.effects.iter().map(|active| active.effect);
        let missing = eligible.iter().copied();
        let missing = missing.filter(|effect| !model.has(effect.card().id));
        Self {
            hypothesis: Hypothesis::of(model),
            eligible: own.chain(missing).collect(),
            starts: starts(&runs, held_out, basis.start),
            runs,
            basis,
        }
    }

    /// For each eligible effect the squared size of a slab in standard deviations, with `new` behind the runs in
    /// hand, of which a row stands for so many; none where the model cannot be followed.
    pub(crate) fn with_run(
        &self,
        new: &Scenario,
        stands_for: f64,
    ) -> Option<Vec<(&'static str, f64)>> {
        let scenarios: Vec<&Scenario> = self.runs.iter().collect();
        let noise = self.basis.noise;
        let mut runs = linearised_runs(&self.hypothesis, &scenarios, &self.starts, noise, None)?;
        let finer = Noise {
            current_a: noise.current_a / stands_for.sqrt(),
            speed_rad_s: noise.speed_rad_s / stands_for.sqrt(),
            ..noise
        };
        let model = &self.hypothesis.model;
        runs.push(LinearisedRun::new(model, new, State::default(), finer)?);
        let linear = linearise(&self.hypothesis, &self.eligible, &runs, false)?;
        let set = present(&linear);
        let reduced = Reduced::new(linear, self.basis.excess, true)?;
        Some(information_of(&reduced, &set, self.basis.excess))
    }
}

/// Of each effect beside a set, in the form that shows least of those that may be the likeliest.
fn information_of(reduced: &Reduced, set: &Set, excess: f64) -> Vec<(&'static str, f64)> {
    let linear = &reduced.linear;
    let mut all: Vec<(&'static str, f64)> = Vec::new();
    for (k, candidate) in linear.candidates.iter().enumerate() {
        if candidate.in_model || candidate.is_unknown() {
            continue;
        }
        let others = reduced.columns(&reduced.cleared(set, k));
        let logs = reduced.conditional(&others, k);
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let forms = logs.iter().enumerate();
        // Within 3 nats of the likeliest a form may be it once the run is made.
        let least = most - 3.0;
        let forms = forms.filter(|(_, log)| log.total_cmp(&least).is_ge());
        let squares = forms.map(|(form, _)| {
            let spread = spread_slabs(reduced, set, excess, [k, form]);
            spread.map_or(0.0, |spread| spread.powi(-2))
        });
        let square = squares.fold(f64::INFINITY, f64::min);
        match all.iter_mut().find(|own| own.0 == candidate.id) {
            Some(own) => own.1 = own.1.max(square),
            None => all.push((candidate.id, square)),
        }
    }
    all
}
