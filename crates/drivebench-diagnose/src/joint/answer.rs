//! Posterior of each effect of the catalogue, and of what none of them explains.

use super::acting::constants;
use super::columns::{Candidate, LinearisedRun};
use super::detectability::{
    BOUND_SIGMAS, UNDETECTABLE_SLABS, detectable, moments, shortest_detectable, size_in,
    spread_slabs, whenever,
};
use super::eligible::{prepared, starts, why_not};
use super::events::Event;
use super::follow::Noise;
use super::marginal::{Inferred, NAMED_PROBABILITY, TOGETHER_PROBABILITY};
use super::prediction_error::estimate;
use super::refits::at_limit;
use super::rivals::{confusable, share_among_events, share_at_limit};
use super::search::{self, SearchResult};
use super::select::Set;
use super::solution::{self, Happened};
use crate::evidence::{Evidence, HoldoutFrom};
use crate::floor::{Floor, MOST_UNOBSERVED_RATIO};
use crate::progress::Progress;
use crate::score::{Fitted, Score, cannot_simulate, in_noise};
use crate::vetoes::Veto;
use crate::work::Work;
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error::FitError;
use drivebench_identify::verdict::judge;
use drivebench_model::numerics::statistics::{self, largest};
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::{ActiveEffect, Effect, Input, Model, MotorKey, Scenario, State};
use drivebench_model::sample::Verdict;
use serde::Serialize;

/// Plausible sets that bounds are taken over.
const SETS: usize = 12;
/// How many times as large as white noise what a set leaves of the innovations may be and still count as white.
const NEARLY_WHITE: f64 = 1.3;

/// Share of the error from which on what follows an axis is a part of the answer.
const LEAST_PART_SHARE: f64 = 0.03;

/// A run that speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunOf {
    Fit,
    Holdout,
    /// One that was made after the first, and is fitted with it.
    Later,
    /// Both, where one run was split.
    Whole,
}

/// When something that happens once did so in one run, and how large it was there: in the unit of its first parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Onset {
    pub run: RunOf,
    /// Of a later run which of them it is, the first being one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub number: Option<usize>,
    /// Since the run's first command.
    pub time_s: f64,
    pub interval_95_s: [f64; 2],
    pub size: f64,
    pub size_std: f64,
}

/// A part of the error that follows something and that no effect of the catalogue explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unknown {
    pub equation: &'static str,
    pub follows: &'static str,
    pub probability: f64,
    /// Of the error that the baseline leaves.
    pub share_of_error: f64,
    pub sentence: String,
}

/// Excess of what the best set leaves over white noise beyond which it refutes nothing: eight ninths of it are then the model's,
/// not the noise's.
const MOST_BELIEVED_EXCESS: f64 = 9.0;

/// What a run is, and where it is in what is fitted.
#[derive(Clone, Copy)]
struct Place {
    of: RunOf,
    /// Of a later run.
    number: Option<usize>,
    /// When it begins there, s after the first command.
    begins_s: f64,
    /// When what is fitted of it ends, s after its own first command; zero where it has no part in it.
    fitted_s: f64,
    /// When the last run ends there, s after the first command.
    ends_s: f64,
}

/// Everything that the runs say together.
pub(crate) struct Inference {
    /// Every eligible effect.
    pub(crate) effects: Vec<Inferred>,
    pub(crate) unknown: Vec<Unknown>,
    /// What is more likely there than not, what explains most first.
    pub(crate) named: Vec<&'static str>,
    /// Effects of the baseline that are not needed beside the others.
    pub(crate) superfluous: Vec<&'static str>,
    /// Pairs of which these runs want one and cannot say which; the likelier first.
    pub(crate) confusable: Vec<[&'static str; 2]>,
    /// Error, in units of the noise, that the disturbance of the load makes on the hold-out whatever is named.
    pub(crate) disturbance_error: f64,
    /// The same of what was commanded in the holes of its record.
    pub(crate) unobserved: f64,
    /// What is random in the runs beside it.
    pub(crate) noise: Noise,
    /// What is not named for a reason of its own.
    vetoes: Vec<Veto>,
    runs: Vec<Place>,
    found: SearchResult,
}

/// Error, in units of the noise, from which on it is worth a word that lost rows make it.
const WORTH_SAYING_FLOORS: f64 = 0.3;

impl Inference {
    /// The floor of the hold-out.
    pub(crate) const fn floor<'a>(&self, evidence: &'a Evidence) -> Floor<'a> {
        Floor::new(evidence, self.unobserved)
    }

    /// What lost rows make of the hold-out's error and what is allowed for it, where that is worth a word.
    pub(crate) fn lost_rows(&self, floor: Floor<'_>) -> Option<String> {
        (self.unobserved >= WORTH_SAYING_FLOORS).then(|| {
            format!(
                "nobody knows what was commanded in the rows that the hold-out lacks: that alone makes about {:.1} times the \
                 noise of its error, and up to {:.1} is allowed for; an error below {:.1} times the noise may be all theirs",
                self.unobserved,
                MOST_UNOBSERVED_RATIO * self.unobserved,
                floor.highest()
            )
        })
    }

    /// What is said of an effect; none where it was not eligible.
    pub(crate) fn of(&self, id: &str) -> Option<&Inferred> {
        self.effects.iter().find(|inferred| inferred.id() == id)
    }

    /// Whether an effect was eligible and these runs can judge it.
    pub(crate) fn is_eligible(&self, id: &str) -> bool {
        self.of(id).is_some_and(|found| found.why_not.is_none())
    }

    /// What the model had and does not need any more, as the end of a sentence.
    pub(crate) fn superfluous_in_words(&self) -> String {
        let words = self.superfluous.iter();
        words.fold(String::new(), |words, id| {
            words + "; " + id + " is superfluous now"
        })
    }

    /// When an effect that happens once did so, in each of the runs that speak where it did.
    pub(crate) fn onsets(&self, id: &str) -> Vec<Onset> {
        let own = self.found.happened.iter();
        let mut own: Vec<_> = own.filter(|own| own.event.id() == id).collect();
        own.sort_by_key(|own| own.event.run);
        let onset = |own: &Happened| Onset {
            run: self.runs[own.event.run].of,
            number: self.runs[own.event.run].number,
            time_s: own.moment.time_s,
            interval_95_s: own.moment.interval_s,
            size: own.event.values[own.event.effect.size_index()],
            size_std: own.deviation,
        };
        own.into_iter().map(onset).collect()
    }

    /// What a fit has to hold: what is named, and what may be in its place.
    pub(crate) fn to_be_fitted(&self) -> Vec<&'static str> {
        let rivals = self.confusable.iter().map(|pair| pair[1]);
        self.named.iter().copied().chain(rivals).collect()
    }

    /// Whether an effect is more likely there than not, or these runs cannot tell it from one that is.
    pub(crate) fn names(&self, id: &str) -> bool {
        let found = self.of(id);
        let likely = found.is_some_and(|found| found.probability > NAMED_PROBABILITY);
        likely && self.veto_of(id).is_none()
            || self.named.contains(&id)
            || self.confusable.iter().any(|pair| pair[1] == id)
    }

    /// How many times as large as white noise what the best set leaves of the innovations is.
    pub(crate) const fn excess(&self) -> f64 {
        self.found.excess
    }

    /// Whether the set leaves little more than white noise of the innovations: the drift of the free run may then be left aside.
    pub(crate) fn is_nearly_white(&self) -> bool {
        self.found.excess < NEARLY_WHITE
    }

    /// Whether the search was ended by its budget.
    pub(crate) const fn is_cut(&self) -> bool {
        self.found.is_cut
    }

    /// Why nothing is ruled out, where no linear solution of the search is believed.
    pub(crate) fn why_open(&self) -> Option<&'static str> {
        let cut = "the search was ended by its budget of work before a set of effects stood";
        let far = "the best model leaves several times the noise, so that bounds by it do not hold";
        let is_far = self.found.excess > MOST_BELIEVED_EXCESS;
        self.is_cut().then_some(cut).or(is_far.then_some(far))
    }

    /// Keeps an effect from being named; its probability stays what it is.
    pub(crate) fn veto(&mut self, veto: Veto) {
        self.named.retain(|named| *named != veto.effect);
        self.confusable.retain(|pair| pair[0] != veto.effect);
        self.vetoes.push(veto);
    }

    /// Why an effect is not named whatever its probability is.
    pub(crate) fn veto_of(&self, id: &str) -> Option<&str> {
        let own = self.vetoes.iter().find(|veto| veto.effect == id)?;
        Some(&own.reason)
    }

    /// The model with these effects alone, where a fit begins: those of the best set as they are there, the others in their
    /// likeliest form.
    pub(crate) fn with_effects(&self, ids: &[&'static str]) -> Option<Model> {
        let SearchResult {
            hypothesis,
            reduced,
            posterior,
            happened,
            ..
        } = &self.found;
        let linear = &reduced.linear;
        let mut missing: Vec<&str> = ids.to_vec();
        let candidates = linear.candidates.iter().zip(&posterior.forms);
        let set: Set = candidates
            .map(|(candidate, form)| {
                let place = missing.iter().position(|id| *id == candidate.id)?;
                missing.swap_remove(place);
                Some(if candidate.in_model { 0 } else { *form })
            })
            .collect();
        let there = solution::at_solution(hypothesis, reduced, &set)?;
        let mut model = there.model;
        let mut known: Vec<&Event> = happened.iter().map(|happened| &happened.event).collect();
        known.sort_by_key(|event| event.run);
        for event in known.into_iter().chain(&there.events) {
            if ids.contains(&event.id()) && !model.has(event.id()) {
                model.effects.push(in_fitted(event, self.runs[event.run]));
            }
        }
        (missing.is_empty() && ids.iter().all(|id| model.has(id))).then_some(model)
    }
}

/// Time behind the end of a run at which what begins there does nothing in it, s.
const BEHIND_S: f64 = 1.0;

/// An event as the runs that are fitted have it: what happened only in what is held out comes after their end.
fn in_fitted(event: &Event, run: Place) -> ActiveEffect {
    let mut event = event.clone();
    let is_behind = run.begins_s + run.fitted_s < run.ends_s;
    match run.of {
        // Where no other run is behind it, what is held out of it is its own end.
        RunOf::Whole if is_behind && event.time_s() > run.fitted_s => {
            event.put_at(run.ends_s + BEHIND_S);
        }
        RunOf::Fit | RunOf::Whole => {}
        RunOf::Later => event.put_at(run.begins_s + event.time_s()),
        RunOf::Holdout => event.put_at(run.ends_s + BEHIND_S),
    }
    event.active()
}

/// The effects of the catalogue, and those of a model or beside it that are in none.
pub(crate) fn eligible(
    model: &Model,
    beside: Option<&'static dyn Effect>,
) -> Vec<&'static dyn Effect> {
    let mut eligible = CATALOGUE.to_vec();
    let of_model = model.effects.iter().map(|active| active.effect);
    for effect in of_model.chain(beside) {
        let is_known = |known: &&'static dyn Effect| known.card().id == effect.card().id;
        if !eligible.iter().any(is_known) {
            eligible.push(effect);
        }
    }
    eligible
}

/// Weighs all sets of the eligible effects on the fit run and the hold-out together, from `baseline` on, which was
/// fitted from `before`.
pub(crate) fn infer(
    baseline: &Fitted,
    before: &Model,
    eligible: &[&'static dyn Effect],
    evidence: &Evidence,
    progress: Progress<'_>,
) -> Result<Inference, FitError> {
    let known = evidence.noise.source != FloorSource::None;
    let (speaking, held_out) = evidence.speaking();
    let runs: Vec<Scenario> = speaking.iter().map(|run| prepared(run, known)).collect();
    let scenarios: Vec<&Scenario> = runs.iter().collect();
    let first = State::at(baseline.start.current_a, baseline.start.speed_rad_s);
    let starts = starts(&runs, held_out, first);
    let noise = beginning(&evidence.noise, &baseline.model, &runs[0]);
    let mut model = baseline.model.clone();
    // A balance may ask for an inertia that no shaft has.
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
    let found = search::search(models, eligible, together, noise, progress);
    let found = found.ok_or_else(|| cannot_simulate(&evidence.training))?;
    let inferred = |effect: &&'static dyn Effect| Inferred {
        given: given.contains(&effect.card().id),
        why_not: why_not(*effect, &runs[0]),
        ..inferred(*effect, &found)
    };
    let mut effects: Vec<Inferred> = eligible.iter().map(inferred).collect();
    effects.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
    // Of two that these runs cannot tell apart the likelier stands for both.
    let rivals = confusable(&found);
    share_among_events(&mut effects, &rivals);
    let mut confusable: Vec<_> = rivals.into_iter().map(|rival| rival.pair).collect();
    if let Some(pair) = at_limit(&found.hypothesis.model) {
        share_at_limit(pair, &mut effects, &mut confusable);
    }
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
    // What these runs do not show they need, or do not need, to no avail.
    let is_gone = |id: &&'static str| {
        let mut own = effects.iter().filter(|own| own.id() == *id);
        own.any(|own| own.excited) && !found.hypothesis.has(id)
    };
    let superfluous = given.into_iter().filter(is_gone).collect();
    confusable.retain(|pair| named.contains(&pair[0]));
    let candidates = &found.reduced.linear.candidates;
    let unknown = unknown_parts(
        candidates,
        &found.posterior.probability,
        &found.unknown_share,
    );
    Ok(Inference {
        confusable,
        effects,
        unknown,
        named,
        disturbance_error: in_noise(found.disturbance_error.map(Some), &evidence.noise)
            .unwrap_or(0.0),
        unobserved: in_noise(found.unobserved.map(Some), &evidence.noise).unwrap_or(0.0),
        noise: found.noise,
        superfluous,
        vetoes: Vec::new(),
        runs: runs_of(evidence, runs.len()),
        found,
    })
}

/// What each of so many runs is.
fn runs_of(evidence: &Evidence, count: usize) -> Vec<Place> {
    let length_s = |run: &Scenario| run.sample_time_s[run.samples() - 1] - run.begin_s();
    let begins_s = evidence.begins_s();
    let of = |place: usize| {
        let of = match (evidence.holdout_from, begins_s.get(place)) {
            (HoldoutFrom::Split, _) if place == 0 => RunOf::Whole,
            (HoldoutFrom::Run, _) if place == 0 => RunOf::Fit,
            (_, Some(_)) => RunOf::Later,
            (_, None) => RunOf::Holdout,
        };
        let own = match of {
            RunOf::Fit | RunOf::Whole => Some(evidence.first_run()),
            RunOf::Later => evidence.parts.get(place),
            RunOf::Holdout => None,
        };
        Place {
            of,
            number: (of == RunOf::Later).then_some(place),
            begins_s: begins_s.get(place).copied().unwrap_or(0.0),
            fitted_s: own.map_or(0.0, length_s),
            ends_s: length_s(&evidence.training),
        }
    };
    (0..count).map(of).collect()
}

/// The parts of the error that are unknown and no part too small to be one: what only bends the innovations, and takes
/// nothing from the error of a free run, explains none of it.
fn unknown_parts(candidates: &[Candidate], probability: &[f64], shares: &[f64]) -> Vec<Unknown> {
    let parts = candidates.iter().zip(probability).zip(shares);
    let counts = |candidate: &Candidate, p: f64, share: f64| {
        candidate.is_unknown() && p > NAMED_PROBABILITY && share > LEAST_PART_SHARE
    };
    let parts = parts.filter(|((candidate, p), share)| counts(candidate, **p, **share));
    let unknown = |((candidate, probability), share): ((&Candidate, &f64), &f64)| {
        let (equation, follows, axis) = match candidate.id {
            "torque over angle" => ("torque", "angle_rad", "the angle of the shaft"),
            "voltage over current" => ("voltage", "current_a", "the current"),
            _ => ("torque", "speed_rad_s", "the speed"),
        };
        let percent = 100.0 * share;
        Unknown {
            equation,
            follows,
            probability: *probability,
            share_of_error: *share,
            sentence: format!(
                "{percent:.0} % of the error: an unknown {equation} that follows {axis}"
            ),
        }
    };
    parts.map(unknown).collect()
}

/// Growth of the error of a free run from which on a model is right only where it is led along the run.
const LED_ONLY_RATIO: f64 = 1.1;

/// The same fit with values and deviations from its prediction errors: a disturbance of the load, which a free run takes for the
/// motor's, counts as what it is. Where those values do not foretell a free run, as where the form of an effect differs from
/// its equation, the fit's own stay, each uncertain by how far it is from the other beside. As it was where the model cannot
/// be followed on the run; times of events stay.
pub(crate) fn refined(fit: Fitted, run: &Scenario, noise: Noise) -> Fitted {
    led(fit, run, noise, true).0
}

/// The same of a fit whose values stay in any case: each is uncertain by how far it is from that of its prediction errors
/// beside.
pub(crate) fn with_deviations(fit: Fitted, run: &Scenario, noise: Noise) -> Fitted {
    led(fit, run, noise, false).0
}

/// What of a fit is from its prediction errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Led {
    Values,
    /// The deviations of values that stayed.
    Deviations,
    Neither,
}

/// [`refined`] where it `may_move`, else [`with_deviations`]; and which of it it came to.
pub(crate) fn led(mut fit: Fitted, run: &Scenario, noise: Noise, may_move: bool) -> (Fitted, Led) {
    let start = State::at(fit.start.current_a, fit.start.speed_rad_s);
    let model = fit.model.clone();
    let estimated = LinearisedRun::new(&model, run, start, noise).and_then(|run| estimate(&run));
    let Some(estimated) = estimated else {
        return (fit, Led::Neither);
    };
    let led = may_move.then(|| Score::of(&estimated.model, run, &fit.noise));
    let led = led
        .and_then(Result::ok)
        .filter(|score| score.nrms < LED_ONLY_RATIO * fit.nrms);
    let kept = led.as_ref().map_or(&model, |_| &estimated.model);
    let period_s = run.mean_period_s();
    let mut of = match (&led, estimated.deviations.is_empty()) {
        (_, true) => Led::Neither,
        (Some(_), false) => Led::Values,
        (None, false) => Led::Deviations,
    };
    let mut is_known = false;
    for (slot, deviation) in &estimated.deviations {
        let key = slot.key();
        let value = kept.get(slot).unwrap_or(f64::NAN);
        let apart = estimated.model.get(slot).unwrap_or(f64::NAN) - value;
        let deviation = deviation.map(|deviation| deviation.hypot(apart));
        let mut judged = judge(slot, value, deviation, period_s);
        if !estimated.converged && judged.verdict == Verdict::Settled {
            judged.verdict = Verdict::Searching;
            judged.reason = Some("the fit had not converged".to_owned());
        }
        let mut parameters = fit.parameters.iter_mut();
        if let Some(parameter) = parameters.find(|own| own.key == key) {
            is_known |= judged.std.is_some();
            *parameter = judged;
        }
    }
    // Deviations that no slope tells are none.
    if !is_known {
        of = Led::Neither;
    }
    let led = Fitted {
        model: kept.clone(),
        interval_factor: estimated.factor,
        nrms: led.map_or(fit.nrms, |score| score.nrms),
        ..fit
    };
    (led, of)
}

/// By how much sensors may differ from what they show at rest, and where that is not known.
const KNOWN_AT_REST_LOG_SIGMA: f64 = 0.1;
const NOT_KNOWN_LOG_SIGMA: f64 = 2.0;
/// The same of a speed that alone tells of its noise: running, it may be another than at rest.
const ALONE_LOG_SIGMA: f64 = 0.7;

/// Noise to begin with: the sensors' as they are known, a disturbance of a per cent.
fn beginning(floor: &NoiseFloor, model: &Model, run: &Scenario) -> Noise {
    let largest_input = largest(run.events.iter().map(|event| event.1));
    let current = match run.input {
        Input::Voltage => largest(run.current_a.iter().copied()),
        _ => largest_input,
    };
    let torque = constants(model, run).torque_n_m_per_a * current;
    let mut noise = Noise {
        current_a: floor.current_a,
        speed_rad_s: floor.speed_rad_s,
        disturbance_n_m: (0.004 * torque).max(f64::MIN_POSITIVE),
        correlation_s: 0.5,
        input: (1e-4 * largest_input).max(f64::MIN_POSITIVE),
        sensors: KNOWN_AT_REST_LOG_SIGMA,
    };
    if run.input != Input::Voltage {
        noise.current_a = f64::INFINITY;
        noise.input = (1e-3 * torque).max(f64::MIN_POSITIVE);
        noise.sensors = ALONE_LOG_SIGMA;
        if floor.source == FloorSource::None {
            noise.speed_rad_s = roughness(&run.speed_rad_s).max(f64::MIN_POSITIVE);
            noise.sensors = NOT_KNOWN_LOG_SIGMA;
        }
    }
    noise
}

/// Noise of a signal from its second differences, outliers and steps left aside.
fn roughness(values: &[f64]) -> f64 {
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let bends = known.windows(3).map(|v| v[0] - 2.0 * v[1] + v[2]);
    statistics::robust_deviation(&bends.collect::<Vec<_>>()) / 6f64.sqrt()
}

fn inferred(effect: &'static dyn Effect, found: &SearchResult) -> Inferred {
    let reduced = &found.reduced;
    let id = effect.card().id;
    let mut out = Inferred {
        effect,
        given: false,
        probability: 0.0,
        excited: false,
        why_not: None,
        upper_bound: None,
        detectable: None,
        log_odds: f64::NEG_INFINITY,
    };
    let mut absent = 1.0;
    for (k, candidate) in reduced.linear.candidates.iter().enumerate() {
        if candidate.id != id {
            continue;
        }
        // What is not a number stays none.
        absent *= 1.0 - found.posterior.probability[k];
        out.log_odds = out.log_odds.max(found.posterior.log_factor[k]);
        let form = found.posterior.forms[k];
        let variant = &candidate.variants[form];
        let best = &found.posterior.best;
        let spread = spread_slabs(reduced, best, found.excess, [k, form]);
        let excited = spread.is_some_and(|spread| spread < UNDETECTABLE_SLABS);
        out.excited |= excited;
        if variant.mean > 0.0 || !excited {
            if excited {
                out.detectable = shortest_detectable(reduced, best, k);
            }
            continue;
        }
        let mut bound: f64 = 0.0;
        for (set, _) in found.posterior.sets.iter().take(SETS) {
            let mut with = reduced.cleared(set, k);
            with[k] = Some(form);
            if let Some((size, sd)) = size_in(reduced, &with, k) {
                bound = bound.max(size + BOUND_SIGMAS * sd);
            }
        }
        if candidate.is_event() && !candidate.in_model {
            bound = bound.max(whenever(&moments(reduced, best, found.excess, k)));
        }
        out.upper_bound = Some(out.upper_bound.map_or(bound, |b| b.max(bound)));
        // Injected at one moment an event would say nothing of all the others at which it might have come.
        if candidate.is_event() {
            continue;
        }
        let mut with = reduced.cleared(best, k);
        with[k] = Some(form);
        let sd = size_in(reduced, &with, k).map(|(_, sd)| sd);
        let detectable = sd.and_then(|sd| detectable(reduced, &with, k, sd));
        out.detectable = match (out.detectable, detectable) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (a, b) => a.or(b),
        };
    }
    let weighed = (1.0 - absent).clamp(0.0, 1.0);
    out.probability = if found.is_cut {
        half_believed(weighed, effect.card().share_beforehand)
    } else {
        weighed
    };
    out
}

/// Probability of an effect by its weight among the sets where no set stood: the weight counts half, the other half is what was
/// believed beforehand. Of 61 effects to which such searches gave a weight of 0.5 or more, on 15 of 730 emulated machines, 30 were
/// there.
const fn half_believed(weighed: f64, beforehand: f64) -> f64 {
    0.5 * (weighed + beforehand)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, truth};
    use drivebench_identify::output_error;
    use drivebench_model::plant::{effect, testing};

    #[test]
    fn a_search_that_was_cut_is_certain_of_nothing() {
        let [there, absent] = [1.0, 0.0].map(|weighed| half_believed(weighed, 0.1));
        // It still names; what it names is not certain, and neither is what it does not.
        assert!(there > NAMED_PROBABILITY && there < TOGETHER_PROBABILITY);
        assert!(absent > 0.0 && absent < 0.1);
        assert!((half_believed(0.2, 0.2) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn an_event_of_what_is_held_out_comes_behind_everything_that_is_fitted() {
        let run = |seed| {
            let events = vec![(0.0, 0.0), (0.4, 40.0)];
            testing::record(&nameplate(), events, 0.01, 5.0, seed)
        };
        let time_s = |evidence: &Evidence, run: usize, at_s: f64| {
            let step = effect::find("load_step").unwrap();
            let event = Event {
                run,
                effect: step,
                values: vec![0.1, at_s],
            };
            let count = evidence.speaking().0.len();
            in_fitted(&event, runs_of(evidence, count)[run]).values_or_guess()[1]
        };
        let split = Evidence::new(run(1), None, None);
        assert!((time_s(&split, 0, 4.0) - 4.0).abs() < 1e-9);
        let several = split.with_run(run(2));
        let length_s = several.training.sample_time_s[several.training.samples() - 1];
        assert!((time_s(&several, 0, 2.0) - 2.0).abs() < 1e-9);
        assert!(time_s(&several, 0, 4.0) > length_s);
        let begins_s = several.begins_s()[1];
        assert!((time_s(&several, 1, 4.0) - begins_s - 4.0).abs() < 1e-9);
        let held_out = Evidence::new(run(1), Some(run(3)), None).with_run(run(2));
        let places = runs_of(&held_out.clone().with_run(run(4)), 4);
        let numbers: Vec<Option<usize>> = places.iter().map(|place| place.number).collect();
        assert_eq!(numbers, [None, Some(1), Some(2), None]);
        assert!((time_s(&held_out, 0, 4.0) - 4.0).abs() < 1e-9);
        assert!(time_s(&held_out, 2, 2.0) > length_s);
    }

    #[test]
    fn what_takes_nothing_from_the_error_is_no_part_of_it() {
        let candidate = |id| Candidate {
            id,
            ..Candidate::default()
        };
        let candidates = ["voltage over current", "torque over speed"].map(candidate);
        let parts = unknown_parts(&candidates, &[1.0, 1.0], &[0.0, 0.4]);
        let equations: Vec<&str> = parts.iter().map(|part| part.equation).collect();
        assert_eq!(equations, ["torque"]);
    }

    #[test]
    fn beside_gaps_of_the_current_of_another_form_the_interval_holds_the_resistance() {
        // The load line bends over where the catalogue's has a corner.
        let bent = "equation = \"voltage\"\nparameters = [\"r\"]\nexpression = \"2*r*tanh(i/2)\"";
        let (bent, _) = effect::define("custom", &bent.parse().unwrap()).unwrap();
        let mut machine = nameplate();
        machine.effects.push(ActiveEffect::with(bent, &[1.4]));
        // Ramps of 150 V/s between levels that hold: currents of some amperes.
        let volts = |at_s: f64| {
            let phase_s = at_s % 2.0;
            let rising = 150.0 * phase_s.min(0.5) - 150.0 * (phase_s - 1.0).clamp(0.0, 0.5);
            if at_s % 4.0 < 2.0 { rising } else { -rising }
        };
        let times = (0..700_u16).map(|step| 0.01 * f64::from(step));
        let events = times.map(|at_s| (at_s, volts((at_s - 0.5).max(0.0))));
        let run = testing::record(&machine, events.collect(), 0.01, 7.0, 7);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let start = truth("discontinuous_conduction", &[1.4, 2.0]);
        let free = Fitted::from(output_error::fit(&[start], &run, &noise).unwrap());
        let along = beginning(&noise, &free.model, &run);
        let (led, of) = super::led(free.clone(), &run, along, true);
        // The values stay, since the form is another; and what cannot be followed vouches for nothing.
        assert_eq!(of, Led::Deviations);
        let mut empty = free.clone();
        empty.model.motor = drivebench_model::plant::Motor::new("none");
        assert_eq!(super::led(empty, &run, along, true).1, Led::Neither);
        let own = testing::record(&nameplate(), run.events.clone(), 0.01, 7.0, 8);
        let right = output_error::fit(&[nameplate()], &own, &noise).unwrap();
        let of = super::led(Fitted::from(right), &own, along, true).1;
        assert_eq!(of, Led::Values);
        let key = MotorKey::Resistance;
        let off = |fit: &Fitted| {
            let own = fit.parameters.iter().find(|p| p.key == key.key()).unwrap();
            let known = machine.motor.get(key).unwrap();
            ((own.value.unwrap() - known).abs(), own.std.unwrap())
        };
        let ((off_ohm, std_ohm), (free_ohm, free_std_ohm)) = (off(&led), off(&free));
        assert!(off_ohm < 2.0 * std_ohm, "{off_ohm} +- {std_ohm}");
        assert!(
            free_ohm > 4.0 * free_std_ohm,
            "{free_ohm} +- {free_std_ohm}"
        );
        // What foretells a free run is not given away for it.
        assert!(
            led.nrms < LED_ONLY_RATIO * free.nrms,
            "{} {}",
            led.nrms,
            free.nrms
        );
    }
}
