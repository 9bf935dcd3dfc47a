//! Expected information of a planned run (Bayesian experimental design: Chaloner and Verdinelli, Statistical Science 10, 1995): the
//! linear problem of the diagnosis with a simulated record added.

use super::columns::linearise;
use super::detectability::{UNDETECTABLE_SLABS, posterior_sd_slabs};
use super::eligible::{prepared, starts};
use super::events::Hypothesis;
use super::kalman::Noise;
use super::run::LinearisedRun;
use super::select::{Reduced, Set};
use super::solution::{linearised_runs, present};
use crate::evidence::Evidence;
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::{Effect, Model, Scenario, State};

/// Noise estimated by a diagnosis, from which the expected information of the next run is computed.
#[derive(Clone, Copy, Debug)]
pub struct InformationBasis {
    noise: Noise,
    excess: f64,
    /// Initial state of the first run.
    start: State,
}

impl InformationBasis {
    pub(crate) const fn new(noise: Noise, excess: f64, start: State) -> Self {
        Self { noise, excess, start }
    }
}

/// Squared size of a slab, in standard deviations, from which on an effect is detectable.
pub(crate) const DETECTS: f64 = 1.0 / (UNDETECTABLE_SLABS * UNDETECTABLE_SLABS);

/// The recorded runs and the hypothesis about which they are linearised.
pub(crate) struct ExpectedInformation {
    hypothesis: Hypothesis,
    eligible: Vec<&'static dyn Effect>,
    runs: Vec<Scenario>,
    starts: Vec<State>,
    basis: InformationBasis,
}

impl ExpectedInformation {
    /// For the `eligible` effects, in addition to those of `model`.
    pub(crate) fn new(
        model: &Model,
        eligible: &[&'static dyn Effect],
        evidence: &Evidence,
        basis: InformationBasis,
    ) -> Self {
        let known = evidence.noise.source != FloorSource::None;
        let (in_hand, held_out) = evidence.recorded_runs();
        let runs: Vec<Scenario> = in_hand.iter().map(|run| prepared(run, known)).collect();
        let own = model.effects.iter().map(|active| active.effect);
        let missing = eligible.iter().copied().filter(|effect| !model.has(effect.card().id));
        Self {
            hypothesis: Hypothesis::of(model),
            eligible: own.chain(missing).collect(),
            starts: starts(&runs, held_out, basis.start),
            runs,
            basis,
        }
    }

    /// For each eligible effect the squared size of a slab in standard deviations with the run `new` added, each row of which is
    /// the mean of `rows_per_row` rows of the planned record; `None` where the model cannot be linearised.
    pub(crate) fn with_run(
        &self,
        new: &Scenario,
        rows_per_row: f64,
    ) -> Option<Vec<(&'static str, f64)>> {
        let scenarios: Vec<&Scenario> = self.runs.iter().collect();
        let noise = self.basis.noise;
        let mut runs = linearised_runs(&self.hypothesis, &scenarios, &self.starts, noise, None)?;
        let finer = Noise {
            current_a: noise.current_a / rows_per_row.sqrt(),
            speed_rad_s: noise.speed_rad_s / rows_per_row.sqrt(),
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

/// Information about each effect, given a set: that of the least detectable among its likeliest forms.
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
        // A form within 3 nats may be the likeliest after the run.
        let least = most - 3.0;
        let forms = forms.filter(|(_, log)| log.total_cmp(&least).is_ge());
        let squares = forms.map(|(form, _)| {
            let spread = posterior_sd_slabs(reduced, set, excess, [k, form]);
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
