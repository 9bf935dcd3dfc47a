//! Result of a diagnosis: posterior of each effect of the catalogue and of unknown functions.

use super::eligible::{prepared, starts, why_not};
use super::events::Event;
use super::free_run::Unpredicted;
use super::kalman::Noise;
use super::marginal::{Inferred, NAMED_PROBABILITY, TOGETHER_PROBABILITY, shrunk_to_prior};
use super::noise::initial_noise;
use super::nuisances::column_of;
pub(crate) use super::prediction_error::{Led, led, refined, with_deviations};
use super::refits::not_distinguished;
use super::regression::Candidate;
use super::rivals::{confusable, share_among_events, share_at_limit, share_without_current};
use super::search::{self, SearchResult};
use super::select::Set;
use super::solution::{FittedEvent, at_solution};
use crate::evidence::{Evidence, HoldoutFrom};
use crate::floor::{Floor, MOST_UNOBSERVED_RATIO};
use crate::limits::{Limit, WhyOpen};
use crate::progress::Progress;
use crate::score::{Fitted, cannot_simulate, in_noise};
use crate::vetoes::{Veto, VetoReason};
use crate::work::Work;
use drivebench_identify::claims::lacks_current;
use drivebench_identify::noise::FloorSource;
use drivebench_identify::output_error::FitError;
use drivebench_model::findings;
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::{
    ActiveEffect, Effect, Enters, Input, Instant, Model, MotorKey, ParameterSpec, Scenario, State,
};
use nalgebra::DVector;
use serde::Serialize;

/// Part of a run in the diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunOf {
    Fit,
    Holdout,
    /// A later run, fitted together with the first.
    Later,
    /// Fit and hold-out of one run that was split.
    Whole,
}

/// Time and size of an event in one run, the size in the unit of its first parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Onset {
    pub run: RunOf,
    /// Number of a later run, from one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub number: Option<usize>,
    /// Since the run's first command.
    pub time_s: f64,
    pub interval_95_s: [f64; 2],
    pub size: f64,
    pub size_std: f64,
}

/// A part of the error that is a smooth function of a variable and that no effect of the catalogue explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unknown {
    pub equation: &'static str,
    pub follows: &'static str,
    pub probability: f64,
    /// Share of the error of the baseline.
    pub share_of_error: f64,
    #[serde(rename = "code")]
    pub kind: UnknownKind,
}

findings! {
    /// What an unknown part is and what it follows.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum UnknownKind {
        TorqueOverAngle = "unknown_torque_over_angle",
        VoltageOverCurrent = "unknown_voltage_over_current",
        TorqueOverSpeed = "unknown_torque_over_speed",
        TorqueOverPastSpeed = "unknown_torque_over_past_speed",
    }
}

/// Kind of a run and its position in the fitted record, where the runs are put one after the other.
#[derive(Clone, Copy)]
struct RunPosition {
    of: RunOf,
    /// Number of a later run.
    number: Option<usize>,
    /// Begin in the fitted record, s after its first command.
    begins_s: f64,
    /// End of its fitted part, s after its own first command; zero if it is not fitted.
    fitted_s: f64,
    /// End of the fitted record, s after its first command.
    ends_s: f64,
}

/// Posterior of all runs together.
pub(crate) struct Inference {
    /// Every eligible effect.
    pub(crate) effects: Vec<Inferred>,
    pub(crate) unknown: Vec<Unknown>,
    /// Effects that are named, the most probable first.
    pub(crate) named: Vec<&'static str>,
    /// Effects of the baseline that the best set lacks although the runs would show them.
    pub(crate) superfluous: Vec<&'static str>,
    /// Confounded pairs: the runs support one without distinguishing which; the more probable first.
    pub(crate) confusable: Vec<[&'static str; 2]>,
    /// Error, in units of the noise, that the disturbance of the load causes on the hold-out.
    pub(crate) disturbance_error: f64,
    /// The same, caused by the holes of its record and the random errors of its stamps.
    pub(crate) unpredicted: Unpredicted<f64>,
    /// Noise model of the runs.
    pub(crate) noise: Noise,
    /// Effects that are not named for another reason than their probability.
    vetoes: Vec<Veto>,
    runs: Vec<RunPosition>,
    found: SearchResult,
}

impl Inference {
    /// The floor of the hold-out.
    pub(crate) const fn floor<'a>(&self, evidence: &'a Evidence) -> Floor<'a> {
        Floor::new(evidence, self.unpredicted)
    }

    /// Error of the hold-out by lost rows and its allowance, if it exceeds 0.3 of the noise.
    pub(crate) fn lost_rows(&self, floor: Floor<'_>) -> Option<Limit> {
        (self.unpredicted.lost_rows >= 0.3).then(|| Limit::LostRows {
            expected: self.unpredicted.lost_rows,
            most: MOST_UNOBSERVED_RATIO * self.unpredicted.lost_rows,
            highest: floor.highest(),
        })
    }

    /// The result of an effect; none where it was not eligible.
    pub(crate) fn of(&self, id: &str) -> Option<&Inferred> {
        self.effects.iter().find(|inferred| inferred.id() == id)
    }

    /// Whether an effect was eligible and these runs can judge it.
    pub(crate) fn is_eligible(&self, id: &str) -> bool {
        self.of(id).is_some_and(|found| found.why_not.is_none())
    }

    /// Time and size of an event in each run that has it.
    pub(crate) fn onsets(&self, id: &str) -> Vec<Onset> {
        let mut own: Vec<&FittedEvent> =
            self.found.fitted_events.iter().filter(|own| own.event.id() == id).collect();
        own.sort_by_key(|own| own.event.run);
        let onset = |own: &FittedEvent| Onset {
            run: self.runs[own.event.run].of,
            number: self.runs[own.event.run].number,
            time_s: own.event_time.time_s,
            interval_95_s: own.event_time.interval_s,
            size: own.event.values[own.event.effect.size_index()],
            size_std: own.deviation,
        };
        own.into_iter().map(onset).collect()
    }

    /// Effects to fit: the named ones and those confounded with them.
    pub(crate) fn to_be_fitted(&self) -> Vec<&'static str> {
        let rivals = self.confusable.iter().map(|pair| pair[1]);
        self.named.iter().copied().chain(rivals).collect()
    }

    /// Whether an effect is more probable than not, or confounded with one that is.
    pub(crate) fn names(&self, id: &str) -> bool {
        let found = self.of(id);
        let likely = found.is_some_and(|found| found.probability > NAMED_PROBABILITY);
        likely && self.veto_of(id).is_none()
            || self.named.contains(&id)
            || self.confusable.iter().any(|pair| pair[1] == id)
    }

    /// Long-run variance of the residuals of the best set over that of white noise.
    pub(crate) const fn excess(&self) -> f64 {
        self.found.excess
    }

    /// Whether the residuals are nearly white: the drift of the free run is then not judged.
    pub(crate) fn is_nearly_white(&self) -> bool {
        self.found.excess < 1.3
    }

    /// Whether the search was ended by its budget.
    pub(crate) const fn is_cut(&self) -> bool {
        self.found.is_cut
    }

    /// Why no effect is ruled out, if the linear solution does not hold.
    pub(crate) fn why_open(&self) -> Option<WhyOpen> {
        // Eight ninths of the residual variance are then model error.
        let is_far = self.found.excess > 9.0;
        let is_past = |unknown: &Unknown| unknown.kind == UnknownKind::TorqueOverPastSpeed;
        let depends_on_past = self.unknown.iter().any(is_past);
        let reasons = [
            (self.is_cut(), WhyOpen::SearchCut),
            (is_far, WhyOpen::FarFromNoise),
            (depends_on_past, WhyOpen::DependsOnPast),
        ];
        reasons.into_iter().find_map(|(holds, why)| holds.then_some(why))
    }

    /// Leaves a named effect and the simpler one that is its limit undistinguished.
    pub(crate) fn share_with_limit(&mut self, [limited, simpler]: [&'static str; 2]) {
        share_at_limit([simpler, limited], &mut self.effects, &mut self.confusable);
    }

    /// Excludes an effect from the named ones. Its posterior is no longer that of a confirmed model; of a search that was cut it is the
    /// mean with the prior already.
    pub(crate) fn veto(&mut self, veto: Veto) {
        let is_halved = self.is_cut();
        let own = self.effects.iter_mut().find(|own| own.id() == veto.effect);
        if let Some(own) = own.filter(|own| !is_halved && own.probability > NAMED_PROBABILITY) {
            own.probability = shrunk_to_prior(own.probability, own.effect.card().share_beforehand);
        }
        // Of a lag that is too short for its kind the others are no more refuted than itself.
        if matches!(veto.reason, VetoReason::ShortLag { .. }) {
            let is_lag = |own: &&mut Inferred| own.effect.card().enters == Enters::Path;
            self.effects.iter_mut().filter(is_lag).for_each(Inferred::leave_open);
        }
        self.named.retain(|named| *named != veto.effect);
        self.confusable.retain(|pair| pair[0] != veto.effect);
        self.vetoes.push(veto);
    }

    /// Why an effect is not named whatever its probability is.
    pub(crate) fn veto_of(&self, id: &str) -> Option<VetoReason> {
        let own = self.vetoes.iter().find(|veto| veto.effect == id)?;
        Some(own.reason)
    }

    /// Initial model of a fit with these effects alone: those of the best set with their values, the others in their likeliest
    /// form.
    pub(crate) fn with_effects(&self, ids: &[&'static str]) -> Option<Model> {
        let SearchResult { hypothesis, reduced, posterior, fitted_events, .. } = &self.found;
        let linear = &reduced.linear;
        let mut missing: Vec<&str> = ids.to_vec();
        let candidates = linear.candidates.iter().zip(&posterior.forms);
        let set: Set = candidates
            .map(|(candidate, form)| {
                let index = missing.iter().position(|id| *id == candidate.id)?;
                missing.swap_remove(index);
                Some(if candidate.in_model { 0 } else { *form })
            })
            .collect();
        let there = at_solution(hypothesis, reduced, &set)?;
        let mut model = there.model;
        let mut known: Vec<&Event> =
            fitted_events.iter().map(|fitted_events| &fitted_events.event).collect();
        known.sort_by_key(|event| event.run);
        for event in known.into_iter().chain(&there.events) {
            if ids.contains(&event.id()) && !model.has(event.id()) {
                model.effects.push(in_fitted_runs(event, self.runs[event.run]));
            }
        }
        (missing.is_empty() && ids.iter().all(|id| model.has(id))).then_some(model)
    }
}

/// An event at its time in the fitted record; one of the hold-out is put 1 s after its end.
fn in_fitted_runs(event: &Event, run: RunPosition) -> ActiveEffect {
    let mut event = event.clone();
    let is_behind = run.begins_s + run.fitted_s < run.ends_s;
    let time_s = event.time_s();
    match run.of {
        // The held-out part is the end of the run, and no further run follows.
        RunOf::Whole if is_behind && time_s > run.fitted_s => event.put_at(run.ends_s + 1.0),
        RunOf::Fit | RunOf::Whole => {}
        RunOf::Later => event.put_at(run.begins_s + time_s),
        RunOf::Holdout => event.put_at(run.ends_s + 1.0),
    }
    event.active()
}

/// The effects of the catalogue, those of the model and a `further` one.
pub(crate) fn eligible(
    model: &Model,
    further: Option<&'static dyn Effect>,
) -> Vec<&'static dyn Effect> {
    let mut eligible = CATALOGUE.to_vec();
    let of_model = model.effects.iter().map(|active| active.effect);
    for effect in of_model.chain(further) {
        let is_known = |known: &&'static dyn Effect| known.card().id == effect.card().id;
        if !eligible.iter().any(is_known) {
            eligible.push(effect);
        }
    }
    eligible
}

/// Why a lag that predicts no better than its limit is not judged.
const NEEDLESS_LAG: &str = "without its lag it predicts the hold-out as well: this run distinguishes no lag of the load from an error of the inertia";

/// Posterior of the sets of eligible effects but the `needless` ones on fit run and hold-out together, searched from `baseline`,
/// which was fitted from `before`.
pub(crate) fn infer(
    baseline: &Fitted,
    before: &Model,
    eligible: &[&'static dyn Effect],
    needless: &[&'static str],
    evidence: &Evidence,
    progress: Progress<'_>,
) -> Result<Inference, FitError> {
    let known = evidence.noise.source != FloorSource::None;
    let (recorded_runs, held_out) = evidence.recorded_runs();
    let runs: Vec<Scenario> = recorded_runs.iter().map(|run| prepared(run, known)).collect();
    let scenarios: Vec<&Scenario> = runs.iter().collect();
    let first = State::at(baseline.start.current_a, baseline.start.speed_rad_s);
    let starts = starts(&runs, held_out, first);
    let noise = initial_noise(&evidence.noise, &baseline.model, &runs[0]);
    let mut model = baseline.model.clone();
    // The torque balance may give a negative inertia.
    let inertia = model.motor.get(MotorKey::Inertia);
    if let Some(inertia) = inertia.filter(|inertia| *inertia <= 0.0) {
        let positive = inertia.abs().max(f64::MIN_POSITIVE);
        model.motor.set(MotorKey::Inertia, positive);
    }
    let given = model.effect_ids();
    let models = [&model, before];
    let work = Work::default();
    let together = search::Runs {
        scenarios: &scenarios,
        starts: &starts,
        held_out,
        has_floor: known,
        work: &work,
    };
    let is_needless = |effect: &dyn Effect| needless.contains(&effect.card().id);
    let mut searched = eligible.to_vec();
    searched.retain(|effect| !is_needless(*effect));
    let found = search::search(models, &searched, together, noise, progress)
        .ok_or_else(|| cannot_simulate(&evidence.training))?;
    let inferred = |effect: &&'static dyn Effect| Inferred {
        given: given.contains(&effect.card().id),
        why_not: why_not(*effect, &runs[0])
            .or_else(|| is_needless(*effect).then_some(NEEDLESS_LAG)),
        ..Inferred::of(*effect, &found)
    };
    let mut effects: Vec<Inferred> = eligible.iter().map(inferred).collect();
    effects.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
    // The more probable of a confounded pair stands for both.
    let rivals = confusable(&found);
    share_among_events(&mut effects, &rivals);
    let mut confusable: Vec<_> = rivals.into_iter().map(|rival| rival.pair).collect();
    if let Some(pair) = not_distinguished(&found.hypothesis.model, &runs[0]) {
        share_at_limit(pair, &mut effects, &mut confusable);
    }
    let by_voltage = runs[0].input == Input::Voltage;
    if lacks_current(&runs[0]) {
        share_without_current(&mut effects, &mut confusable);
    }
    let hides_inductance = by_voltage && !is_inductance_known(&found, &runs[0]);
    // The phase of an angle that is the integral of a measured speed drifts, and a wave with it.
    let hides_angle = !by_voltage && evidence.training.angle.is_empty();
    let is_hidden = |own: &&mut Inferred| {
        let is_unknown = hides_inductance && changes_inductance(own.effect)
            || hides_angle && own.effect.card().needs_angle;
        own.probability < NAMED_PROBABILITY && is_unknown
    };
    effects.iter_mut().filter(is_hidden).for_each(Inferred::leave_open);
    let probability = |id: &str| {
        let own = effects.iter().find(|own| own.id() == id);
        own.map_or(0.0, |own| own.probability)
    };
    let together = |id: &str| -> f64 {
        let pairs = confusable.iter().filter(|pair| pair[0] == id);
        probability(id) + pairs.map(|pair| probability(pair[1])).sum::<f64>()
    };
    let is_named = |own: &&Inferred| {
        let alone = own.probability > NAMED_PROBABILITY;
        !own.given && (alone || together(own.id()) > TOGETHER_PROBABILITY)
    };
    let named: Vec<&'static str> = effects.iter().filter(is_named).map(Inferred::id).collect();
    // An effect that is not detectable is neither needed nor superfluous.
    let is_gone = |id: &&'static str| {
        let mut own = effects.iter().filter(|own| own.id() == *id);
        own.any(|own| own.excited) && !found.hypothesis.has(id)
    };
    let superfluous = given.into_iter().filter(is_gone).collect();
    confusable.retain(|pair| named.contains(&pair[0]));
    let (candidates, posterior) = (&found.reduced.linear.candidates, &found.posterior);
    let unknown = unknown_parts(candidates, &posterior.probability, &found.unknown_share);
    let in_noise = |rms: [f64; 2]| in_noise(rms.map(Some), &evidence.noise).unwrap_or(0.0);
    Ok(Inference {
        confusable,
        effects,
        unknown,
        named,
        disturbance_error: in_noise(found.disturbance_error),
        unpredicted: found.unpredicted.in_noise(&evidence.noise).unwrap_or_default(),
        noise: found.noise,
        superfluous,
        vetoes: Vec::new(),
        runs: runs_of(evidence, runs.len()),
        found,
    })
}

/// Positions of the first `count` runs.
fn runs_of(evidence: &Evidence, count: usize) -> Vec<RunPosition> {
    let length_s = |run: &Scenario| run.sample_time_s[run.samples() - 1] - run.begin_s();
    let begins_s = &evidence.begins_s;
    let position = |number: usize| {
        let of = match (evidence.holdout_from, begins_s.get(number)) {
            (HoldoutFrom::Split, _) if number == 0 => RunOf::Whole,
            (HoldoutFrom::Run, _) if number == 0 => RunOf::Fit,
            (_, Some(_)) => RunOf::Later,
            (_, None) => RunOf::Holdout,
        };
        let own = match of {
            RunOf::Fit | RunOf::Whole => Some(evidence.first_run()),
            RunOf::Later => evidence.parts.get(number),
            RunOf::Holdout => None,
        };
        RunPosition {
            of,
            number: (of == RunOf::Later).then_some(number),
            begins_s: begins_s.get(number).copied().unwrap_or(0.0),
            fitted_s: own.map_or(0.0, length_s),
            ends_s: length_s(&evidence.training),
        }
    };
    (0..count).map(position).collect()
}

/// Relative deviation above which a parameter is not known: an effect that takes it to zero then hardly shows.
const KNOWN_DEVIATION: f64 = 0.1;

/// Whether the runs determine the inductance beside all effects.
fn is_inductance_known(found: &SearchResult, scenario: &Scenario) -> bool {
    let (reduced, linear) = (&found.reduced, &found.reduced.linear);
    let m = linear.nuisances.len();
    let column = column_of(MotorKey::Inductance, &found.hypothesis.model, scenario);
    // One that is fixed is known.
    let Some(column) = column else {
        return true;
    };
    let chosen = reduced.columns(&found.posterior.best).into_iter().map(|own| m + own);
    let columns: Vec<usize> = (0..m).chain(chosen).collect();
    let mut unit = DVector::zeros(columns.len());
    unit[column] = 1.0;
    let variance = linear.factor(&columns).map(|factor| factor.solve(&unit)[column]);
    variance.is_some_and(|variance| (found.excess * variance).sqrt() < KNOWN_DEVIATION)
}

fn changes_inductance(effect: &dyn Effect) -> bool {
    let guesses: Vec<f64> = effect.parameters().iter().map(ParameterSpec::guess).collect();
    let at = Instant { current_a: 1.0, ..Instant::default() };
    effect.terms(&guesses).current_rate_gain(&at) != 0.0
}

/// The unknown functions that are probable and explain more than 3 % of the error of a free run; one that changes only the
/// innovations explains none of it.
fn unknown_parts(candidates: &[Candidate], probability: &[f64], shares: &[f64]) -> Vec<Unknown> {
    let parts = candidates.iter().zip(probability).zip(shares);
    parts
        .filter(|((own, p), share)| own.is_unknown() && **p > NAMED_PROBABILITY && **share > 0.03)
        .map(|((candidate, probability), share)| {
            let (equation, follows, kind) = match candidate.id {
                "torque over angle" => ("torque", "angle_rad", UnknownKind::TorqueOverAngle),
                "voltage over current" => ("voltage", "current_a", UnknownKind::VoltageOverCurrent),
                "torque over past speed" => {
                    ("torque", "past_speed_rad_s", UnknownKind::TorqueOverPastSpeed)
                }
                _ => ("torque", "speed_rad_s", UnknownKind::TorqueOverSpeed),
            };
            Unknown { equation, follows, probability: *probability, share_of_error: *share, kind }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::nameplate;
    use drivebench_model::plant::{effect, testing};

    #[test]
    fn an_event_of_what_is_held_out_comes_behind_all_that_is_fitted() {
        let run = |seed| {
            let events = vec![(0.0, 0.0), (0.4, 40.0)];
            testing::record(&nameplate(), events, 0.01, 5.0, seed)
        };
        let split = Evidence::new(run(1), None, None);
        let several = split.clone().with_run(run(2));
        let held_out = Evidence::new(run(1), Some(run(3)), None).with_run(run(2));
        let (begins_s, behind_s) = (several.begins_s[1], f64::INFINITY);
        for (evidence, number, at_s, expected_s) in [
            (&split, 0, 4.0, 4.0),
            (&several, 0, 2.0, 2.0),
            (&several, 0, 4.0, behind_s),
            (&several, 1, 4.0, begins_s + 4.0),
            (&held_out, 0, 4.0, 4.0),
            (&held_out, 2, 2.0, behind_s),
        ] {
            let event = Event {
                run: number,
                effect: effect::find("load_step").unwrap(),
                values: vec![0.1, at_s],
            };
            let place = runs_of(evidence, evidence.recorded_runs().0.len())[number];
            let found_s = in_fitted_runs(&event, place).values_or_guess()[1];
            let ends_s = evidence.training.sample_time_s[evidence.training.samples() - 1];
            let is_right = if expected_s < behind_s {
                (found_s - expected_s).abs() < 1e-9
            } else {
                found_s > ends_s
            };
            assert!(is_right, "{number} {at_s}: {found_s}");
        }
        let places = runs_of(&held_out.with_run(run(4)), 4);
        let numbers: Vec<Option<usize>> = places.iter().map(|place| place.number).collect();
        assert_eq!(numbers, [None, Some(1), Some(2), None]);
    }

    #[test]
    fn a_curve_without_a_share_of_the_error_is_no_part_of_it() {
        let candidate = |id| Candidate { id, ..Candidate::default() };
        let candidates = ["voltage over current", "torque over speed"].map(candidate);
        let parts = unknown_parts(&candidates, &[1.0, 1.0], &[0.0, 0.4]);
        let equations: Vec<&str> = parts.iter().map(|part| part.equation).collect();
        assert_eq!(equations, ["torque"]);
    }
}
