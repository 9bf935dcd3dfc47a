//! The run that makes most undetected effects detectable, by the criterion of the diagnosis.

use rayon::prelude::*;

use super::plan::{COUNT, Planned, planned};
use super::{ExperimentLimits, Hidden, HiddenReason, MenuEntry, NextExperiment, Recommendation};
use crate::joint::answer::eligible;
use crate::joint::expected_information::{DETECTS, ExpectedInformation};
use crate::{Candidate, Diagnosis, DiagnosisVerdict, Evidence, Status};
use drivebench_model::plant::{ActiveEffect, Effect, Model, Scenario, effect, typical_size};

/// Precision from which on an effect is expected to show: twice that of detection, since no repetition of a run in hand
/// doubles the information.
const EXPECTED: f64 = 2.0 * DETECTS;
/// Factor by which limits are widened to test whether they are binding.
const WIDENED: f64 = 2.0;

/// A run of the menu and what it would show of each effect that the runs in hand do not, in their order.
struct Tried {
    plan: Planned,
    information: Vec<f64>,
}

impl Tried {
    fn shows_effect(&self, place: usize) -> bool {
        self.information[place] >= EXPECTED
    }

    fn count(&self) -> usize {
        (0..self.information.len()).filter(|k| self.shows_effect(*k)).count()
    }

    fn total(&self) -> f64 {
        self.information.iter().map(|own| (1.0 + own).ln()).sum()
    }

    fn largest(&self) -> f64 {
        self.information.iter().copied().fold(0.0, f64::max)
    }
}

/// The undetected effects for which a menu is evaluated.
struct Undetected<'a> {
    model: &'a Model,
    effects: Vec<&'static str>,
    /// The model with each of them at its typical size, with which the run keeps its limits too.
    with: Vec<Model>,
    information: ExpectedInformation,
    /// The fitted runs after the first: runs of a menu, where they were recommended.
    made: &'a [Scenario],
}

impl Undetected<'_> {
    /// The menu within some limits, best first.
    fn tried(&self, limits: &ExperimentLimits) -> Vec<Tried> {
        self.menu(limits).0
    }

    /// The same, and whether the menu could be evaluated: a run of it was simulated, or all that the limits allow were made
    /// already.
    fn menu(&self, limits: &ExperimentLimits) -> (Vec<Tried>, bool) {
        let models: Vec<&Model> = std::iter::once(self.model).chain(&self.with).collect();
        let plans = (0..COUNT).into_par_iter();
        let plans: Vec<Planned> =
            plans.filter_map(|index| planned(index, &models, limits)).collect();
        let allowed = plans.len();
        let is_open = |plan: &Planned| !self.made.iter().any(|run| plan.is_repeated_by(run));
        let open: Vec<Planned> = plans.into_iter().filter(is_open).collect();
        let all_made = allowed > 0 && open.is_empty();
        let tried = open.into_par_iter().filter_map(|plan| {
            let run = plan.measured(self.model)?;
            let all = self.information.with_run(&run, plan.stands_for())?;
            let of = |id: &&'static str| {
                let own = all.iter().find(|own| own.0 == *id);
                own.map_or(0.0, |own| own.1)
            };
            let information = self.effects.iter().map(of).collect();
            Some(Tried { plan, information })
        });
        let mut tried: Vec<Tried> = tried.collect();
        tried.sort_by(|a, b| b.count().cmp(&a.count()).then(b.total().total_cmp(&a.total())));
        let is_known = all_made || !tried.is_empty();
        (tried, is_known)
    }

    /// The effects that the best run of a menu does not show, each with the reason.
    fn hidden(&self, tried: &[Tried], limits: &ExperimentLimits) -> Vec<Hidden> {
        let best = tried.first();
        let places = 0..self.effects.len();
        let left: Vec<usize> =
            places.filter(|place| !best.is_some_and(|best| best.shows_effect(*place))).collect();
        let shows = |tried: &[Tried], place: usize| tried.iter().any(|own| own.shows_effect(place));
        let alone: Vec<usize> = left.iter().copied().filter(|p| !shows(tried, *p)).collect();
        // Binding limits are computed only where no run is left: each needs a menu.
        let widened: Vec<(HiddenReason, Vec<Tried>)> = if best.is_some_and(|best| best.count() > 0)
        {
            Vec::new()
        } else {
            let widened = widened(limits).into_iter();
            widened.map(|(reason, limits)| (reason, self.tried(&limits))).collect()
        };
        let reason = |place: usize| {
            if !alone.contains(&place) {
                return HiddenReason::AnotherRun;
            }
            let binding = widened.iter().find(|(_, tried)| shows(tried, place));
            binding.map_or(HiddenReason::Excitation, |(reason, _)| *reason)
        };
        let hidden = left
            .into_iter()
            .map(|place| Hidden { effect: self.effects[place], reason: reason(place) });
        hidden.collect()
    }
}

/// The limits, some of them widened, with the reason for which they stand.
fn widened(limits: &ExperimentLimits) -> Vec<(HiddenReason, ExperimentLimits)> {
    let mut all = Vec::new();
    if limits.slew_v_per_s.is_finite() {
        let reason = HiddenReason::Slew { v_per_s: limits.slew_v_per_s };
        all.push((reason, ExperimentLimits { slew_v_per_s: f64::INFINITY, ..*limits }));
    }
    if let Some(travel_rad) = limits.travel_rad {
        let reason = HiddenReason::Travel { rad: travel_rad };
        all.push((reason, ExperimentLimits { travel_rad: None, ..*limits }));
    }
    let more = ExperimentLimits {
        voltage_v: WIDENED * limits.voltage_v,
        current_a: WIDENED * limits.current_a,
        speed_rad_s: WIDENED * limits.speed_rad_s,
        rms_current_a: WIDENED * limits.rms_current_a,
        duration_s: WIDENED * limits.duration_s,
        ..*limits
    };
    let ExperimentLimits { voltage_v, current_a, speed_rad_s, duration_s, .. } = *limits;
    let reason = HiddenReason::Limits { voltage_v, current_a, speed_rad_s, duration_s };
    all.push((reason, more));
    all
}

/// The run that shows most of the effects that these runs would not, besides the estimated model. `None` where
/// all were shown, or where a run cannot be evaluated: much is not explained, no run of the menu could be
/// simulated, or the model has an effect of a single run.
pub(super) fn reveal(
    diagnosis: &Diagnosis,
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Option<NextExperiment> {
    let basis = diagnosis.information_basis?;
    if matches!(diagnosis.verdict, DiagnosisVerdict::Unexplained | DiagnosisVerdict::NotFitted) {
        return None;
    }
    let model = &diagnosis.model.model;
    let has_of_one_run = (model.effects.iter()).any(|active| active.effect.goes_on_over_runs());
    if has_of_one_run {
        return None;
    }
    // Of what is left open these runs showed something, and each form of a coupling costs a simulation of every run and plan.
    let is_undetected = |one: &&Candidate| one.status == Status::NotExcited && !one.is_open;
    let undetected = diagnosis.candidates.iter().filter(is_undetected);
    let undetected: Vec<&'static str> = undetected.map(|one| one.effect).collect();
    if undetected.is_empty() {
        return None;
    }
    let missing: Vec<&'static dyn Effect> = eligible(model, None)
        .into_iter()
        .filter(|effect| undetected.contains(&effect.card().id))
        .collect();
    let with = undetected.iter();
    let question = Undetected {
        model,
        with: with.filter_map(|id| with_typical(model, id, evidence)).collect(),
        effects: undetected,
        information: ExpectedInformation::new(model, &missing, evidence, basis),
        made: evidence.parts.get(1..).unwrap_or_default(),
    };
    let (tried, is_known) = question.menu(limits);
    if !is_known {
        return None;
    }
    let hidden = question.hidden(&tried, limits);
    let menu = tried.iter().map(|tried| MenuEntry {
        program: tried.plan.recipe.id,
        expected_separation: tried.largest(),
        needed: EXPECTED,
    });
    let menu = menu.collect();
    let best = tried.first().filter(|best| best.count() > 0);
    let nothing = || NextExperiment {
        finding: Recommendation::ShowsNothingMore,
        bench: None,
        pair: None,
        pairs: Vec::new(),
        reveals: Vec::new(),
        hidden: hidden.clone(),
        expected_separation: tried.first().map_or(0.0, Tried::largest),
        menu,
        peaks: None,
        recipe: None,
    };
    let Some(best) = best else {
        return Some(nothing());
    };
    let places = (0..question.effects.len()).filter(|place| best.shows_effect(*place));
    let places: Vec<usize> = places.collect();
    let reveals: Vec<&'static str> = places.iter().map(|place| question.effects[*place]).collect();
    let weakest = places.iter().map(|place| best.information[*place]);
    Some(NextExperiment {
        finding: Recommendation::Shows,
        expected_separation: weakest.fold(f64::INFINITY, f64::min),
        peaks: Some(best.plan.peaks),
        recipe: Some(best.plan.recipe.clone()),
        reveals,
        ..nothing()
    })
}

/// The model with the effect at its typical size, its shapes at their guesses.
fn with_typical(model: &Model, id: &str, evidence: &Evidence) -> Option<Model> {
    let effect = effect::find(id)?;
    let typical = |index| typical_size(effect, index, model, &evidence.training);
    let values: Vec<f64> = (0..effect.parameters().len()).map(typical).collect();
    let mut model = model.clone();
    model.effects.push(ActiveEffect::with(effect, &values));
    model.require_complete().ok()?;
    Some(model)
}
