//! The decision: which effects are missing, whether they are sufficient, and whether an independent run confirms it.

use serde::{Deserialize, Serialize};

use super::candidates::{Candidate, CandidateFinding, Status, candidates};
use super::evidence::{Evidence, HoldoutFrom};
use super::floor::{Floor, Repeatability, SUFFICIENT_SHARE};
use super::joint::Noise;
use super::joint::answer::{Inference, Unknown, eligible};
use super::joint::expected_information::InformationBasis;
use super::joint::free_run::likelier;
use super::ladder::{Bench, Rung, Standing, climb};
use super::lags::share_among_lags;
use super::limits::Limit;
use super::location::{
    AxisMap, EffectCurve, FailureLocation, axis_map, effect_curve, error_curve, with_candidate,
};
use super::next_experiment::NextExperiment;
use super::progress::{Event, Progress, Stage, silent};
use super::score::{Fitted, Score, by_key, cannot_simulate};
use super::trivial::{self, TrivialPrediction};
use super::vetoes::{self, VetoReason};
use super::winding_drop::{self, WindingDrop};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error::{self, FitError};
use drivebench_model::findings;
use drivebench_model::plant::effect::{self, CATALOGUE, TermKind};
use drivebench_model::plant::{ActiveEffect, Effect, Input, Model, MotorKey, Scenario, State};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Largest share of the explainable error for unknown parts and the disturbance together, besides the named effects.
const HALF_SHARE: f64 = 0.5;
/// Least increase of the confirming run's log-likelihood by the named effects, in its standard deviations.
pub const CONFIRMED_SIGMAS: f64 = 3.0;
/// Error that needs no explanation, in units of a floor that is known.
const AT_MOST_NOISE: f64 = 1.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiagnosisVerdict {
    Effect,
    Ambiguous,
    None,
    Unexplained,
    /// The fitted model predicts the hold-out no better than a trivial prediction: nothing is named, bounded or ruled out.
    NotFitted,
}

findings! {
    /// The kinds of an answer, by how far it is confirmed.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Answer {
        Found = "effect_found",
        /// The confirming run contradicts it.
        NotConfirmed = "effect_not_confirmed",
        /// Much of the error is still unexplained.
        InPart = "effect_not_sufficient",
        Ambiguous = "ambiguous",
        /// Effects are there, and the error was no more than noise without them.
        NoErrorLeft = "no_error_left",
        NothingMissing = "nothing_missing",
        /// Some effects are not detectable in these runs, or not ruled out.
        NothingThatShows = "nothing_missing_that_shows",
        NothingFound = "nothing_found",
        Unexplained = "unexplained",
        NotFitted = "not_fitted",
    }
}

impl Answer {
    /// Whether it holds without reservation.
    pub const fn is_whole(self) -> bool {
        matches!(self, Self::Found | Self::NothingMissing)
    }
}

/// The answer; `diagnose --json` prints it with its sentences.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub verdict: DiagnosisVerdict,
    /// What predicts the hold-out as well as the model does, where that is why nothing is concluded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<TrivialPrediction>,
    /// Of the motor, with every effect of the answer besides them.
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    pub effect: Option<&'static str>,
    pub effects: Vec<&'static str>,
    pub sufficient: bool,
    pub noise_floor_from: FloorSource,
    /// The sensors' noise, which is one where it is known: the unit of the errors.
    pub sensor_floor: Option<f64>,
    /// Difference between two runs of the same excitation under the model with all named effects, in the same unit.
    pub repeat_floor: Option<f64>,
    /// Whether that is little more than the sensors' noise; null without a repeated run.
    pub repeats: Option<bool>,
    /// The variables on which it depends where it is more; the largest share first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub repeat_follows: Vec<FailureLocation>,
    pub holdout_from: HoldoutFrom,
    /// Of the whole accepted set, on the hold-out.
    pub explained_percent: f64,
    pub holdout_before: f64,
    pub holdout_after: f64,
    pub candidates: Vec<Candidate>,
    /// Error that no effect explains, by the variable on which it depends.
    pub unknown: Vec<Unknown>,
    /// A drop that the voltage balance of a controlled current names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub winding_drop: Option<WindingDrop>,
    /// Pairs that these runs do not distinguish, the one in the answer first.
    pub confusable: Vec<[&'static str; 2]>,
    pub ladder: Vec<Rung>,
    /// The error as a curve over each axis, where no effect explains it; the largest share first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub axis_map: Vec<AxisMap>,
    /// The answer on the confirming run, where there is one.
    pub confirm: Option<Confirmation>,
    /// What these runs cannot judge, and why.
    pub limits: Vec<Limit>,
    /// What no run distinguishes from the named effects.
    pub equivalences: Vec<&'static str>,
    /// The most informative next run; filled in where the bench is known ([`recommend`](super::recommend)).
    pub next_experiment: Option<NextExperiment>,
    /// Whether the search ended by its budget of work before a set of effects stood: what it did not find may be there.
    pub search_was_cut: bool,
    /// Effects of the baseline that are not needed besides the others.
    #[serde(skip)]
    pub superfluous: Vec<&'static str>,
    /// Effects added to the model since, each with a candidate that these runs do not distinguish from it.
    #[serde(skip)]
    pub added_rivals: Vec<[&'static str; 2]>,
    /// The refitted baseline and the model with every accepted effect.
    #[serde(skip)]
    pub baseline: Fitted,
    #[serde(skip)]
    pub model: Fitted,
    /// Noise of the runs, for the planning of the next run; none in an answer that was not computed from runs.
    #[serde(skip)]
    pub information_basis: Option<InformationBasis>,
    /// For each confusable pair the model with its second effect in the place of the first, where a fit begins.
    #[serde(skip)]
    pub rivals: Vec<Model>,
}

impl Diagnosis {
    /// Error of the baseline and of the answer on a run that neither fitted nor selected.
    pub fn rungs_on(&self, run: &Scenario, noise: &NoiseFloor) -> Result<[Rung; 2], FitError> {
        let rung = |model: &Model| -> Result<Rung, FitError> {
            Ok(Rung {
                effects: model.effect_ids(),
                holdout_rmse: Score::of(model, run, noise)?.nrms,
            })
        };
        Ok([rung(&self.baseline.model)?, rung(&self.model.model)?])
    }

    pub fn answer(&self) -> Answer {
        match self.verdict {
            DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous if self.has_no_error() => {
                Answer::NoErrorLeft
            }
            DiagnosisVerdict::Effect if self.is_refuted() => Answer::NotConfirmed,
            DiagnosisVerdict::Effect if self.sufficient => Answer::Found,
            DiagnosisVerdict::Effect => Answer::InPart,
            DiagnosisVerdict::Ambiguous => Answer::Ambiguous,
            DiagnosisVerdict::None if !self.sufficient => Answer::NothingFound,
            DiagnosisVerdict::None if self.is_all_judged() => Answer::NothingMissing,
            DiagnosisVerdict::None => Answer::NothingThatShows,
            DiagnosisVerdict::Unexplained => Answer::Unexplained,
            DiagnosisVerdict::NotFitted => Answer::NotFitted,
        }
    }

    /// Whether the model as it was given leaves no more than the noise, on every run that it is judged by.
    pub fn has_no_error(&self) -> bool {
        let confirm = self.confirm.as_ref().and_then(|run| run.error_before);
        let is_noise = |error: f64| error <= AT_MOST_NOISE;
        self.noise_floor_from != FloorSource::None
            && self.winding_drop.is_none()
            && is_noise(self.holdout_before)
            && confirm.is_none_or(is_noise)
    }

    /// Adds a drop by the voltage balance to the answer of the torques.
    fn name_drop(&mut self, drop: WindingDrop) {
        let parameters = drop.add_to(&mut self.model.model);
        let id = winding_drop::ID;
        if self.verdict == DiagnosisVerdict::None {
            self.verdict = DiagnosisVerdict::Effect;
        }
        // A run without a voltage confirms no drop.
        if let Some(confirm) = &mut self.confirm {
            let holds = drop.confirm_z.map(|z| z >= CONFIRMED_SIGMAS);
            confirm.confirmed = confirm.confirmed.zip(holds).map(|(torques, drop)| torques && drop);
        }
        self.effect.get_or_insert(id);
        self.effects.push(id);
        self.limits.retain(|limit| !matches!(limit, Limit::ConstantDrop { .. }));
        if let Some(own) = self.candidates.iter_mut().find(|own| own.effect == id) {
            own.probability = drop.probability;
            own.status = Status::of(drop.probability, true);
            own.parameters.clone_from(&parameters);
            own.finding = CandidateFinding::Named {
                floor: self.noise_floor_from,
                holdout_from: self.holdout_from,
            };
        }
        self.model.parameters.extend(parameters);
        self.winding_drop = Some(drop);
    }

    /// Whether every effect is ruled out.
    pub fn is_all_judged(&self) -> bool {
        self.candidates.iter().all(|own| own.status == Status::RuledOut && own.as_good_as.is_none())
    }

    /// Marks the candidates that these runs do not distinguish from effects added to the model since: `pairs` of
    /// an effect of the model and its rival.
    pub fn mark_rivals(&mut self, pairs: &[[&'static str; 2]]) {
        for candidate in &mut self.candidates {
            let of_pair = |pair: &&[&'static str; 2]| pair[1] == candidate.effect;
            if let Some([taken, _]) = pairs.iter().find(of_pair) {
                candidate.is_as_good_as(taken);
            }
        }
        let is_rival =
            |pair: &&[&'static str; 2]| self.candidates.iter().any(|own| own.effect == pair[1]);
        self.added_rivals.extend(pairs.iter().filter(is_rival));
    }

    /// The curve of an effect on a run, the error without it beside what it does at its size: of one in the baseline, a
    /// named one, or any candidate that has a size. Of what has none, and without an effect, the error of the baseline along
    /// the axis that it follows most.
    pub fn curve_of(
        &self,
        id: Option<&str>,
        run: &Scenario,
        noise: &NoiseFloor,
    ) -> Result<Option<EffectCurve>, FitError> {
        let with_effect = id.and_then(|id| {
            if self.model.model.has(id) {
                return Some((id, self.model.model.clone()));
            }
            let candidate = self.candidates.iter().find(|candidate| candidate.effect == id)?;
            let value = |key: &str| {
                let key = format!("{id}.{key}");
                candidate.parameters.iter().find(|own| own.key == key)?.value
            };
            let with = with_candidate(&self.baseline.model, id, value)?;
            Some((id, with))
        });
        match with_effect {
            Some((id, model)) => effect_curve(&model, id, run, noise),
            None => error_curve(&self.baseline.model, run, noise),
        }
    }

    /// Whether the confirming run contradicts the answer.
    pub fn is_refuted(&self) -> bool {
        let confirm = self.confirm.as_ref();
        confirm.is_some_and(|confirm| confirm.confirmed == Some(false))
    }
}

/// [`diagnose_with`] without reports of progress.
pub fn diagnose(model: &Model, evidence: Evidence) -> Result<Diagnosis, FitError> {
    diagnose_with(model, evidence, &silent)
}

/// Refits `model` as the baseline and searches for what it misses. Where the host stamped commands and samples, the offsets of
/// these stamps in each run are estimated with the effects that were found, and the search is repeated with them: an inductance or a
/// filter of the baseline absorbs part of an offset, and the error of a missing effect makes one.
pub fn diagnose_with(
    model: &Model,
    evidence: Evidence,
    progress: Progress<'_>,
) -> Result<Diagnosis, FitError> {
    let several = (evidence.parts.len() > 1).then(|| evidence.clone());
    let training = &evidence.training;
    let has_offset = training.input == Input::Voltage && training.is_stamped_by_host();
    let again = has_offset.then(|| evidence.clone());
    let (mut model, mut begun) = (model.clone(), begin(model, evidence, None, progress)?);
    if let Some(evidence) = again
        && let Some((delayed, better)) = with_offset(&model, &begun, &evidence)?
    {
        begun = begin(&delayed, evidence, Some(&better), progress)?;
        model = delayed;
    }
    let Begun { bench, baseline, eligible, inference } = begun;
    // Only the inference shows which effects cannot be fitted to concatenated runs.
    let found = inference.to_be_fitted();
    let several = several.filter(|_| bench.evidence.parts.len() > 1);
    let Some(several) = several.filter(|all| all.fitted_with(&found).1.is_some()) else {
        return Ok(Conclusion::of(bench, &baseline, inference, progress)?.answer());
    };
    // All runs without the effects of a single one, or the first run alone: whichever predicts the hold-out better.
    let eligible_of_all = eligible.iter().filter(|effect| !effect.goes_on_over_runs());
    let eligible_of_all: Vec<&'static dyn Effect> = eligible_of_all.copied().collect();
    let of_all = bench.infer(&baseline, &eligible_of_all, progress)?;
    let all = Conclusion::of(bench, &baseline, of_all, progress)?;
    let (bench, baseline) = Bench::for_fits_of(&found, &model, several, None)?;
    let inference = bench.infer(&baseline, &eligible, progress)?;
    let first = Conclusion::of(bench, &baseline, inference, progress)?;
    let better = if all.held_out_by(&first)? < first.held_out_by(&first)? { all } else { first };
    Ok(better.answer())
}

/// The refitted baseline with the inference about it.
struct Begun {
    bench: Bench,
    baseline: Fitted,
    eligible: Vec<&'static dyn Effect>,
    inference: Inference,
}

fn begin(
    model: &Model,
    evidence: Evidence,
    better: Option<&Model>,
    progress: Progress<'_>,
) -> Result<Begun, FitError> {
    progress(Event::Begun { stage: Stage::Baseline, of: 0 });
    let (bench, baseline) = Bench::for_fits_of(&[], model, evidence, better)?;
    progress(Event::Begun { stage: Stage::Screen, of: CATALOGUE.len() });
    let eligible = eligible(&baseline.model, None);
    let inference = bench.infer(&baseline, &eligible, progress)?;
    Ok(Begun { bench, baseline, eligible, inference })
}

/// `model` with the offset of the stamps that fits best with the effects that were found, and the model with these; `None` where the
/// offsets of all runs are those of the search already. A delay of the commands within the uncertainty of the stamps is this offset.
fn with_offset(
    model: &Model,
    Begun { bench, baseline, inference, .. }: &Begun,
    evidence: &Evidence,
) -> Result<Option<(Model, Model)>, FitError> {
    let Some((_, prior_s)) = evidence.training.input_delay_s() else {
        return Ok(None);
    };
    let id = TermKind::LateCommand.id();
    let before_s = baseline.model.input_delay_s.unwrap_or(0.0);
    let ids = [&baseline.model.effect_ids()[..], &inference.named].concat();
    let mut found = inference.with_effects(&ids).unwrap_or_else(|| baseline.model.clone());
    let is_new = |active: &&ActiveEffect| active.id() == id && !model.has(id);
    let late_s = found.effects.iter().find(is_new).map(|active| active.values_or_guess()[0]);
    let in_all_s = late_s.map(|late_s| before_s + late_s);
    if let Some(offset_s) = in_all_s.filter(|offset_s| *offset_s <= 2.0 * prior_s) {
        found = found.without_effect(id)?;
        found.input_delay_s = Some(offset_s);
    }
    let fit = output_error::fit_delayed(&[found], &evidence.training, &evidence.noise)?;
    let after_s = fit.model.input_delay_s.unwrap_or(before_s);
    let (_, offsets) = evidence.clone().aligned(&fit.model);
    let offset_s = |of: &[(String, f64)], run: &str| {
        of.iter().find(|own| own.0 == run).map_or(0.0, |own| own.1)
    };
    let moved = offsets
        .iter()
        .chain(&bench.offsets)
        .map(|(run, _)| offset_s(&offsets, run) - offset_s(&bench.offsets, run));
    // A twentieth of what is known of it beforehand is within the errors of an inductance or a filter.
    let changes = |offset_s: f64| offset_s.abs() > 0.05 * prior_s;
    let is_other = changes(after_s - before_s) || moved.into_iter().any(changes);
    Ok(is_other.then(|| (Model { input_delay_s: Some(after_s), ..model.clone() }, fit.model)))
}

/// A ladder of which no effect is vetoed, with its runs and its inference.
struct Conclusion {
    bench: Bench,
    inference: Inference,
    rungs: Vec<Standing>,
}

impl Conclusion {
    fn of(
        bench: Bench,
        baseline: &Fitted,
        mut inference: Inference,
        progress: Progress<'_>,
    ) -> Result<Self, FitError> {
        for veto in vetoes::surplus(&inference) {
            inference.veto(veto);
        }
        if bench.fits_at_once() {
            // What is always there comes first: an event near the begin of a run explains it too.
            inference.named.sort_by_key(|id| vetoes::happens_once(id));
        }
        progress(Event::Begun { stage: Stage::Refit, of: inference.named.len() });
        let climbed = |inference: &mut Inference, mut known: Vec<Standing>| loop {
            match climb(&bench, baseline, inference, std::mem::take(&mut known), progress)? {
                Ok(rungs) => return Ok::<_, FitError>(rungs),
                Err(veto) => inference.veto(veto),
            }
        };
        let mut rungs = climbed(&mut inference, vec![])?;
        if !rungs[0].score.nrms.is_finite() {
            return Err(nothing_judged(&bench.evidence.holdout));
        }
        let mut moved = Vec::new();
        while let Some(veto) = vetoes::first(&bench, &inference, &inference.named, &rungs) {
            let before = inference.named.clone();
            // What lowers no error before another effect may lower it after that.
            let is_first = matches!(veto.reason, VetoReason::NotLower { .. })
                && before.last() != Some(&veto.effect)
                && !moved.contains(&veto.effect);
            if is_first {
                moved.push(veto.effect);
                inference.named.retain(|id| *id != veto.effect);
                inference.named.push(veto.effect);
            } else {
                inference.veto(veto);
            }
            let known = passed(rungs, &before, &inference.named);
            rungs = climbed(&mut inference, known)?;
        }
        if let Some(last) = rungs.pop() {
            let mut last = last.with_deviations(&bench, &inference);
            share_among_lags(&bench, &mut inference, &mut last);
            rungs.push(last);
        }
        Ok(Self { bench, inference, rungs })
    }

    /// The held-out error of the whole model, in the units of `other`.
    fn held_out_by(&self, other: &Self) -> Result<f64, FitError> {
        let last = &self.rungs[self.rungs.len() - 1];
        Ok(other.bench.held_out(&last.fit.model)?.nrms)
    }

    fn answer(&self) -> Diagnosis {
        answer(&self.bench, &self.inference, &self.rungs)
    }
}

/// The rungs that the ladders of the effects `before` and `now` share, without the baseline and without the last of either,
/// which is fitted to convergence.
fn passed(rungs: Vec<Standing>, before: &[&'static str], now: &[&'static str]) -> Vec<Standing> {
    let same = before.iter().zip(now).take_while(|(a, b)| a == b).count();
    let in_passing = same.min(now.len().saturating_sub(1));
    rungs.into_iter().skip(1).take(in_passing).collect()
}

/// The error of a hold-out of which no signal is measured.
fn nothing_judged(run: &Scenario) -> FitError {
    let run = run.name.clone();
    FitError::NothingMeasured { run }
}

fn answer(bench: &Bench, inference: &Inference, rungs: &[Standing]) -> Diagnosis {
    let evidence = &bench.evidence;
    let (base, best) = (&rungs[0], &rungs[rungs.len() - 1]);
    let floor = inference.floor(evidence);
    let repeatability = Repeatability::of(&best.fit.model, evidence, inference.noise);
    let in_motion = repeatability.in_motion();
    let verdict = verdict(bench, inference, [&base.score, &best.score], in_motion);
    let axis_map = if verdict == DiagnosisVerdict::Unexplained {
        // The maps do not change the verdict.
        axis_map(&best.fit.model, &evidence.training, &evidence.noise).unwrap_or_default()
    } else {
        Vec::new()
    };
    let eta = floor.explained(base.score.nrms, best.score.nrms);
    let settled = floor.is_reached(best.score.nrms);
    let reported = bench.as_reported(&best.fit);
    let named = &inference.named;
    let judged = |reported: Fitted, rung: &Standing| {
        reported.judged_by_error(rung.score.nrms, floor.expected())
    };
    let baseline = bench.as_reported(&bench.with_deviations(base.fit.clone(), inference));
    let model = judged(reported, best).judged_with(&inference.confusable);
    let baseline = judged(baseline, base);
    let candidates = candidates(evidence, floor, inference, (rungs, &model));
    let is_excited = |candidate: &Candidate| candidate.status != Status::NotExcited;
    let excited = candidates.iter().any(is_excited);
    let mut diagnosis = Diagnosis {
        verdict,
        reason: None,
        parameters: of_motor(&model),
        effect: named.first().copied(),
        effects: named.clone(),
        sufficient: match verdict {
            // Without a floor, or without excitation, it is not known whether an effect is missing.
            DiagnosisVerdict::None => evidence.noise.source != FloorSource::None && excited,
            DiagnosisVerdict::Unexplained => false,
            _ => eta >= SUFFICIENT_SHARE || settled || leaves_white_noise(bench, inference),
        },
        noise_floor_from: evidence.noise.source,
        search_was_cut: inference.is_cut(),
        sensor_floor: (evidence.noise.source == FloorSource::Standstill).then_some(1.0),
        repeat_floor: repeatability.floor,
        repeats: repeatability.repeats(),
        repeat_follows: repeatability.follows,
        holdout_from: evidence.holdout_from,
        explained_percent: if named.is_empty() { 0.0 } else { 100.0 * eta },
        holdout_before: base.score.nrms,
        holdout_after: best.score.nrms,
        candidates,
        unknown: inference.unknown.clone(),
        winding_drop: None,
        confusable: inference.confusable.clone(),
        axis_map,
        ladder: rungs.iter().map(Standing::rung).collect(),
        confirm: None,
        limits: bench
            .limits()
            .into_iter()
            .chain(inference.lost_rows(floor))
            .chain(inference.why_open().map(Limit::NothingRuledOut))
            .chain(repeatability.why_not.map(Limit::RepeatUnknown))
            .collect(),
        equivalences: (named.iter())
            .filter_map(|id| effect::find(id))
            .flat_map(|effect| effect.card().equivalences)
            .copied()
            .collect(),
        next_experiment: None,
        superfluous: inference.superfluous.clone(),
        added_rivals: Vec::new(),
        baseline,
        model,
        information_basis: Some(InformationBasis::new(
            inference.noise,
            inference.excess(),
            State::at(base.fit.start.current_a, base.fit.start.speed_rad_s),
        )),
        rivals: rivals(inference, &base.fit.model.effect_ids()),
    };
    if let Some(reason) = trivial::as_good(&best.score, evidence, bench.torques()) {
        return not_fitted(diagnosis, reason, base);
    }
    diagnosis.confirm = confirmed(bench, &diagnosis, inference.noise, in_motion);
    if let Some(drop) = WindingDrop::find(&base.fit.model, evidence) {
        diagnosis.name_drop(drop);
    }
    diagnosis.sufficient &= !(verdict == DiagnosisVerdict::None && diagnosis.is_refuted());
    diagnosis
}

/// The motor's parameters of a fit.
fn of_motor(fit: &Fitted) -> Vec<ParameterEstimate> {
    let own = fit.parameters.iter();
    own.filter(|own| MotorKey::from_key(&own.key).is_some()).cloned().collect()
}

/// The answer where the fitted model beats no trivial prediction: without names, bounds and locations, which would describe a
/// model that predicts nothing.
fn not_fitted(diagnosis: Diagnosis, reason: TrivialPrediction, base: &Standing) -> Diagnosis {
    let unknown = |own: &ParameterEstimate| match own.verdict {
        Verdict::Fixed => own.clone(),
        _ => ParameterEstimate::not_observable(
            &own.key,
            own.unit,
            Reason::ModelMisses,
            "the model predicts the hold-out no better than a trivial prediction",
        ),
    };
    // The baseline is the model too, so that every output gives the same.
    let fit = Fitted {
        parameters: base.fit.parameters.iter().map(unknown).collect(),
        ..base.fit.clone()
    };
    Diagnosis {
        verdict: DiagnosisVerdict::NotFitted,
        reason: Some(reason),
        parameters: of_motor(&fit),
        effect: None,
        effects: Vec::new(),
        sufficient: false,
        repeat_floor: None,
        repeats: None,
        repeat_follows: Vec::new(),
        explained_percent: 0.0,
        holdout_after: diagnosis.holdout_before,
        candidates: Vec::new(),
        unknown: Vec::new(),
        confusable: Vec::new(),
        ladder: vec![base.rung()],
        axis_map: Vec::new(),
        equivalences: Vec::new(),
        baseline: fit.clone(),
        model: fit,
        information_basis: None,
        rivals: Vec::new(),
        superfluous: Vec::new(),
        ..diagnosis
    }
}

/// Models with the second effect of each confusable pair in the place of the first.
fn rivals(inference: &Inference, given: &[&'static str]) -> Vec<Model> {
    let models = inference.confusable.iter().filter_map(|[first, second]| {
        let others = inference.named.iter().filter(|id| *id != first && *id != second);
        let with = given.iter().chain(others).copied().chain([*second]);
        inference.with_effects(&with.collect::<Vec<&'static str>>())
    });
    models.collect()
}

/// Whether all that a balance without a floor leaves is noise, which is estimated with the effects: nothing else has a structure
/// where the rest is white.
fn leaves_white_noise(bench: &Bench, inference: &Inference) -> bool {
    let is_known = bench.evidence.noise.source != FloorSource::None;
    let is_white = inference.is_nearly_white() && inference.unknown.is_empty();
    bench.fits_at_once() && !is_known && is_white
}

fn verdict(
    bench: &Bench,
    inference: &Inference,
    [base, best]: [&Score; 2],
    in_motion: f64,
) -> DiagnosisVerdict {
    let evidence = &bench.evidence;
    let is_known = evidence.noise.source != FloorSource::None;
    let floor = inference.floor(evidence);
    // Of a search that was cut the model is not that of the best set: only the sensors' noise needs no explanation.
    let left = base.nrms / in_motion;
    let at_floor = if inference.is_cut() {
        evidence.noise.is_at(AT_MOST_NOISE, left)
    } else {
        floor.is_reached(left)
    };
    let Some(first) = inference.named.first() else {
        return if inference.unknown.is_empty() && (at_floor || !is_known) {
            DiagnosisVerdict::None
        } else {
            DiagnosisVerdict::Unexplained
        };
    };
    let above = |nrms: f64| nrms * nrms - floor.highest().powi(2);
    let unknown: f64 = inference.unknown.iter().map(|part| part.share_of_error).sum();
    let explainable = above(base.nrms).max(0.0);
    let unexplained = inference.disturbance_error.powi(2) + unknown * explainable;
    // A phase error makes a free run's error large though nothing is missing: then white innovations and a share of the
    // error that the named effects explain are sufficient.
    let has_phase_error_only = !bench.fits_at_once()
        && inference.is_nearly_white()
        && unexplained <= HALF_SHARE * explainable
        && floor.is_explained_in_part(base.nrms, best.nrms);
    let is_sufficient = has_phase_error_only || leaves_white_noise(bench, inference) || at_floor;
    if !is_sufficient && above(best.nrms) > HALF_SHARE * explainable {
        DiagnosisVerdict::Unexplained
    } else if inference.confusable.iter().any(|pair| pair[0] == *first) {
        DiagnosisVerdict::Ambiguous
    } else {
        DiagnosisVerdict::Effect
    }
}

/// The answer on an independent run: neither fitted, nor used for selection or for the noise.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Confirmation {
    /// Whether the answer holds there: the named effects raise the likelihood and explain a good part of its error; where
    /// nothing is missing the error is at the floor; where something unexplained is missing it is above. Null where the
    /// answer claims nothing, or the run cannot be judged.
    pub confirmed: Option<bool>,
    /// Error without and with the named effects, in units of the noise.
    pub error_before: Option<f64>,
    pub error_after: Option<f64>,
    /// Increase of the log-likelihood by the named effects in its standard deviations; null where none is named.
    pub z: Option<f64>,
    pub explained_percent: Option<f64>,
    #[serde(rename = "code")]
    pub finding: ConfirmationFinding,
}

findings! {
    /// What the confirming run shows.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub enum ConfirmationFinding {
        /// Of the named effects; whether the error that they leave is no more than noise.
        Effects { explains_it: bool } = "effects_judged_there",
        NoNoiseFloor = "no_noise_floor",
        AtTheFloorToo = "error_at_the_floor_there_too",
        MissingThere = "something_missing_there",
        ExplainedThere = "explained_to_the_noise_there",
        UnexplainedToo = "unexplained_there_too",
        #[default]
        NothingConcluded = "nothing_concluded",
        /// It cannot be judged, with the message.
        NotJudged(String) = "confirming_run_not_judged",
    }
}

/// What the confirming run shows of an answer, `noise` being that of both models; none without such a run.
/// `in_motion`: how much noisier the sensors are in motion than at rest.
fn confirmed(
    bench: &Bench,
    diagnosis: &Diagnosis,
    noise: Noise,
    in_motion: f64,
) -> Option<Confirmation> {
    let evidence = &bench.evidence;
    let run = evidence.confirm.as_ref()?;
    let is_known = evidence.noise.source != FloorSource::None;
    let repeated = || -> Result<Confirmation, FitError> {
        let before = bench.confirming(&diagnosis.baseline.model, run)?;
        let after = bench.confirming(&diagnosis.model.model, run)?;
        let models = [&before.model, &after.model];
        let found = likelier(models, [before.start, after.start], run, noise, is_known);
        let (z, unpredicted) = found.ok_or_else(|| cannot_simulate(run))?;
        let unpredicted = unpredicted.in_noise(&evidence.noise);
        let floor = Floor::new(evidence, unpredicted.unwrap_or_default());
        let [before, after] = [before.score.nrms, after.score.nrms];
        if !(before.is_finite() && after.is_finite()) {
            return Err(nothing_judged(run));
        }
        let share = floor.explained(before, after);
        // Without a floor the share of an error contains the noise of the rows.
        let is_share_known = !bench.fits_at_once() || is_known;
        let explains = !is_share_known || floor.is_explained_in_part(before, after);
        let holds = z >= CONFIRMED_SIGMAS && explains;
        let at_the_floor = floor.is_reached(before / in_motion);
        let explains_it = floor.is_reached(after / in_motion) || !is_known;
        let (confirmed, finding) = match diagnosis.verdict {
            DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous => {
                (Some(holds), ConfirmationFinding::Effects { explains_it })
            }
            DiagnosisVerdict::None if !is_known => (None, ConfirmationFinding::NoNoiseFloor),
            DiagnosisVerdict::None if at_the_floor => {
                (Some(true), ConfirmationFinding::AtTheFloorToo)
            }
            DiagnosisVerdict::None => (Some(false), ConfirmationFinding::MissingThere),
            DiagnosisVerdict::Unexplained if at_the_floor => {
                (Some(false), ConfirmationFinding::ExplainedThere)
            }
            DiagnosisVerdict::Unexplained => (Some(true), ConfirmationFinding::UnexplainedToo),
            DiagnosisVerdict::NotFitted => (None, ConfirmationFinding::NothingConcluded),
        };
        let named = matches!(finding, ConfirmationFinding::Effects { .. });
        Ok(Confirmation {
            confirmed,
            error_before: Some(before),
            error_after: Some(if named { after } else { before }),
            z: named.then_some(z),
            explained_percent: named.then_some(100.0 * share),
            finding,
        })
    };
    let refused = |error: FitError| Confirmation {
        finding: ConfirmationFinding::NotJudged(error.to_string()),
        ..Confirmation::default()
    };
    Some(repeated().unwrap_or_else(refused))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{evidence, nameplate, record, truth};
    use drivebench_model::plant::Scenario;

    fn third(diagnosis: &Diagnosis) -> &Confirmation {
        diagnosis.confirm.as_ref().unwrap()
    }

    #[test]
    fn a_named_effect_is_confirmed_only_by_a_run_with_it() {
        let fan = truth("quadratic_load", &[2e-6]);
        let data = evidence(&fan, 1);
        let there = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(there.effects, ["quadratic_load"]);
        let found = third(&there);
        assert_eq!(found.confirmed, Some(true), "{found:?}");
        assert!(found.z.unwrap() > CONFIRMED_SIGMAS && found.explained_percent.unwrap() > 90.0);
        assert!(found.error_after.unwrap() < 1.15 && found.error_before.unwrap() > 1.5);

        // The third run without the fan: the same answer, which does not depend on that run, and no confirmation.
        let mut off = data;
        off.confirm = Some(record(&nameplate(), 2, 77));
        let elsewhere = diagnose(&nameplate(), off).unwrap();
        assert_eq!(elsewhere.effects, there.effects);
        assert!((elsewhere.holdout_after - there.holdout_after).abs() < 1e-12);
        let found = third(&elsewhere);
        assert_eq!(found.confirmed, Some(false), "{found:?}");
        assert!(found.error_after.unwrap() > found.error_before.unwrap());

        // Of an error that is below the noise nothing is explained.
        let below = Diagnosis {
            holdout_before: 0.95,
            holdout_after: 0.72,
            explained_percent: 0.0,
            ..there
        };
        // A confirming run with a larger error has one to explain.
        assert_eq!(below.answer(), Answer::Found);
        let below = Diagnosis { confirm: None, ..below };
        assert_eq!(below.answer(), Answer::NoErrorLeft);
    }

    #[test]
    fn a_complete_model_is_confirmed_only_by_an_error_at_the_floor() {
        let mut data = evidence(&nameplate(), 2);
        let nothing = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(nothing.verdict, DiagnosisVerdict::None);
        assert_eq!(third(&nothing).confirmed, Some(true));
        assert_eq!(third(&nothing).z, None);
        data.confirm = Some(record(&truth("voltage_drop", &[1.2]), 2, 78));
        let hidden = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(hidden.verdict, DiagnosisVerdict::None);
        assert_eq!(third(&hidden).confirmed, Some(false));
        // A contradicted answer is not called sufficient.
        assert!(!hidden.sufficient && nothing.sufficient);
        assert_eq!(nothing.answer(), Answer::NothingMissing);
        assert_eq!(hidden.answer(), Answer::NothingFound);
        assert_eq!(third(&hidden).finding, ConfirmationFinding::MissingThere);
        data.confirm = None;
        assert_eq!(diagnose(&nameplate(), data).unwrap().confirm, None);
    }

    #[test]
    fn the_noise_floor_does_not_use_the_confirming_run() {
        let data = evidence(&nameplate(), 3);
        let mut loud = record(&nameplate(), 2, 79);
        for (k, speed) in loud.speed_rad_s.iter_mut().enumerate() {
            *speed += if k % 2 == 0 { 3.0 } else { -3.0 };
        }
        let noise = |confirm: Option<Scenario>| {
            Evidence::new(data.training.clone(), Some(data.holdout.clone()), confirm).noise
        };
        assert_eq!(noise(Some(loud)), noise(None));
    }
}
