//! The ladder of models: each rung a fitted model with its error on the hold-out; one up with an effect more, one down with
//! an effect less.
//!
//! A model is judged in one of two ways: by its free run where a voltage drives, or by the balance of torques where
//! a torque or a current does. [`Bench`] is the common interface of both.

use std::borrow::Cow;

use rayon::prelude::*;
use serde::Serialize;

use super::compare::{Comparison, compare};
use super::evidence::Evidence;
use super::joint::answer::{Inference, Led, eligible, infer, led, refined, with_deviations};
use super::limits::{Limit, SetAside};
use super::location::ErrorOf;
use super::mechanical::{self, Balance, with_events_of};
use super::progress::{Event, Progress, silent};
use super::score::{Fitted, Score, by_key, cannot_simulate, parameters_of};
use super::trivial::{self, TrivialPrediction};
use super::vetoes::{self, Veto, VetoReason};
use super::winding_drop::{self, WindingDrop};
use super::work::iterations_of;
use drivebench_identify::claims::without_current;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::{self, FitError};
use drivebench_identify::scheme::Identified;
use drivebench_identify::winding_balance;
use drivebench_model::findings;
use drivebench_model::numerics::levenberg_marquardt::Options;
use drivebench_model::plant::{Effect, Input, Model, MotorKey, Plant, Scenario, State, effect};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Standard deviations below which a size is not significant: in a free run, before which the names have been weighed
/// already, and in the balance of torques, which decides on them.
pub(super) const SIGNIFICANT_SIGMAS: f64 = 1.0;
const BALANCE_SIGNIFICANT_SIGMAS: f64 = 2.0;
/// Ratio of the held-out errors from which on parameters from prediction errors do not predict another run.
pub(super) const AS_GOOD: f64 = 1.02;
/// The same of a torque balance without a lag and with it, from which on the lag is named. Where a torque drives, a lag also absorbs
/// errors of the inertia and of the instants of the torque: of machines without one (four foreign fans, a geared arm, two real
/// servos) the ratio is 1.00 to 1.16, of twelve with one 1.26 to 6.
const WORTH_A_LAG: f64 = 1.3;

/// A named lag of a torque balance.
struct Lag {
    /// The effect and its limit without a lag.
    pair: [&'static str; 2],
    /// Whether the model has its limit too.
    has_limit: bool,
    /// Ratio of the held-out errors with the limit in its place and with the lag.
    worth: f64,
}

impl Lag {
    fn is_needless(&self) -> bool {
        self.worth <= if self.has_limit { WORTH_A_LAG } else { AS_GOOD }
    }
}

/// A model on the confirming run, with the events and the initial state of that run.
pub(super) struct Confirming {
    pub(super) score: Score,
    pub(super) model: Model,
    pub(super) start: State,
}

/// The runs, and the criterion by which models are judged.
pub(super) struct Bench {
    pub(super) evidence: Evidence,
    balance: Option<Balance>,
    /// The model as it was given, before it was refitted, and a better one from which a search may start.
    given: Model,
    better: Option<Model>,
    /// Which runs are set aside.
    aside: Option<SetAside>,
    /// Which part of long runs is searched.
    searched: Option<Limit>,
    /// By how much the input of a run was moved, s.
    pub(super) offsets: Vec<(String, f64)>,
}

impl Bench {
    /// With the refitted baseline, by which the inputs of the other runs are moved.
    pub(super) fn new(model: &Model, evidence: Evidence) -> Result<(Self, Fitted), FitError> {
        Self::for_fits_of(&[], model, evidence, None)
    }

    /// The same for fits of these effects besides those of the model; the inputs of the other runs are moved by `better`, a model that
    /// was fitted to the training run.
    pub(super) fn for_fits_of(
        beside: &[&'static str],
        model: &Model,
        evidence: Evidence,
        better: Option<&Model>,
    ) -> Result<(Self, Fitted), FitError> {
        let effects = [&model.effect_ids()[..], beside].concat();
        let alone = match evidence.fitted_with(&effects) {
            (Cow::Owned(alone), aside) => Some((alone, aside)),
            (Cow::Borrowed(_), _) => None,
        };
        let (evidence, aside) = alone.unwrap_or((evidence, None));
        let (mut evidence, searched) = evidence.shortened();
        let mut offsets = Vec::new();
        let (balance, fit) = if evidence.training.input == Input::Voltage {
            let (with_floor, fit) = evidence.with_baseline(model)?;
            (evidence, offsets) = with_floor.aligned(better.unwrap_or(&fit.model));
            (None, Fitted::from(fit))
        } else {
            let (balance, fit) = Balance::new(model, &evidence)?;
            evidence.noise.source = balance.source;
            let fit = fit.ok_or_else(|| cannot_simulate(&evidence.training))?;
            let fit = balance.fitted(fit, &evidence);
            (Some(balance), fit)
        };
        let (given, better) = (model.clone(), better.cloned());
        Ok((Self { evidence, balance, given, better, aside, searched, offsets }, fit))
    }

    /// Joint inference of these effects besides the baseline from all runs.
    pub(super) fn infer(
        &self,
        baseline: &Fitted,
        eligible: &[&'static dyn Effect],
        progress: Progress<'_>,
    ) -> Result<Inference, FitError> {
        let mut needless: Vec<&'static str> = Vec::new();
        loop {
            let (before, evidence) = (self.better.as_ref().unwrap_or(&self.given), &self.evidence);
            let mut inference = infer(baseline, before, eligible, &needless, evidence, progress)?;
            if !self.fits_at_once() {
                return Ok(inference);
            }
            let lags = self.lags(baseline, &inference)?;
            if let Some(lag) = lags.iter().find(|lag| lag.is_needless()) {
                needless.push(lag.pair[0]);
                continue;
            }
            let open = lags.iter().filter(|lag| lag.worth < WORTH_A_LAG);
            open.for_each(|lag| inference.share_with_limit(lag.pair));
            self.select(baseline, &mut inference)?;
            return Ok(inference);
        }
    }

    /// The named effects that have a simpler one as their limit, with the ratio of the errors of both.
    fn lags(&self, baseline: &Fitted, inference: &Inference) -> Result<Vec<Lag>, FitError> {
        let with = beside(&baseline.model, inference, &inference.named)?;
        let held_out = |model: &Model| Some(self.held_out(&self.fit(model).ok()?.model).ok()?.nrms);
        let mut lags = Vec::new();
        let new = inference.named.iter().copied().filter(|id| !baseline.model.has(id));
        for id in new {
            let Some(limit) = effect::find(id).and_then(|effect| effect.card().limit) else {
                continue;
            };
            let mut plain = with.without_effect(id)?;
            let has_limit = plain.has(limit.simpler);
            if !has_limit {
                plain = plain.with_effect(limit.simpler)?;
            }
            if let Some((plain, lagged)) = held_out(&plain).zip(held_out(&with)) {
                lags.push(Lag { pair: [id, limit.simpler], has_limit, worth: plain / lagged });
            }
        }
        Ok(lags)
    }

    /// Orders the named effects by forward selection in the balance of torques, where a fit is cheap, then removes those
    /// that are not significant (backward elimination).
    fn select(&self, baseline: &Fitted, inference: &mut Inference) -> Result<(), FitError> {
        let mut left = inference.named.clone();
        let mut order: Vec<&'static str> = Vec::new();
        while !left.is_empty() {
            let mut best = (0, f64::INFINITY);
            for (place, id) in left.iter().enumerate() {
                let kept: Vec<&'static str> = order.iter().copied().chain([*id]).collect();
                let fit = self.fit(&beside(&baseline.model, inference, &kept)?)?;
                if fit.nrms < best.1 {
                    best = (place, fit.nrms);
                }
            }
            order.push(left.remove(best.0));
        }
        // The posterior of a model that leaves white noise has weighed the names already.
        let is_weighed = inference.is_nearly_white();
        let least_sigmas =
            [BALANCE_SIGNIFICANT_SIGMAS, SIGNIFICANT_SIGMAS][usize::from(is_weighed)];
        while !order.is_empty() {
            let fit = self.fit(&beside(&baseline.model, inference, &order)?)?;
            let is_significant = |id: &str| fit.is_significant(id, least_sigmas);
            let Some(last) = order.iter().rposition(|id| is_significant(id) != Some(true)) else {
                break;
            };
            let reason = VetoReason::SizeMayBeZeroInBalance;
            inference.veto(Veto { effect: order.remove(last), reason });
        }
        inference.confusable.retain(|pair| order.contains(&pair[0]));
        inference.named = order;
        Ok(())
    }

    /// Fits what is free in `start` to the training run alone.
    pub(super) fn fit(&self, start: &Model) -> Result<Fitted, FitError> {
        self.fit_with(start, None, Options::default())
    }

    /// The same; a free run also from the inductance of another model, see [`other_inductance`].
    fn fit_with(
        &self,
        start: &Model,
        baseline: Option<&Model>,
        options: Options,
    ) -> Result<Fitted, FitError> {
        let Evidence { training, noise, .. } = &self.evidence;
        let Some(balance) = &self.balance else {
            let options = Options {
                most_iterations: affordable(start, training, options.most_iterations),
                ..options
            };
            let other = baseline.and_then(|other| other_inductance(start, other, training));
            let starts: Vec<Model> = std::iter::once(start.clone()).chain(other).collect();
            return Ok(output_error::fit_with(&starts, training, noise, options)?.into());
        };
        let fit = mechanical::fit(start, &balance.sides.training);
        let fit = fit.ok_or_else(|| cannot_simulate(training))?;
        Ok(balance.fitted(fit, &self.evidence))
    }

    /// Whether a fit costs no simulation.
    pub(super) const fn fits_at_once(&self) -> bool {
        self.balance.is_some()
    }

    /// Units of the errors of current, speed and torque; not finite where there is none.
    pub(super) fn levels(&self) -> [f64; 3] {
        let noise = &self.evidence.noise;
        self.balance.as_ref().map_or([noise.current_a, noise.speed_rad_s, f64::NAN], |balance| {
            [f64::NAN, f64::NAN, balance.unit_n_m]
        })
    }

    /// Torques of the rows of a balance, fitted and held out.
    pub(super) fn torques(&self) -> Option<[&[f64]; 2]> {
        let sides = &self.balance.as_ref()?.sides;
        Some([&sides.training.left, &sides.holdout.left])
    }

    /// A complete model on the hold-out.
    pub(super) fn held_out(&self, model: &Model) -> Result<Score, FitError> {
        let Evidence { holdout, noise, .. } = &self.evidence;
        match &self.balance {
            None => Score::of(model, holdout, noise),
            Some(balance) => Ok(balance.score(model, &balance.sides.holdout)),
        }
    }

    /// A complete model on the confirming run.
    pub(super) fn confirming(&self, model: &Model, run: &Scenario) -> Result<Confirming, FitError> {
        let Some(balance) = &self.balance else {
            let noise = &self.evidence.noise;
            let predicted = output_error::predict(model, run, noise)?;
            return Ok(Confirming {
                score: Score::of(&predicted.model, run, noise)?,
                start: predicted.start,
                model: predicted.model,
            });
        };
        let rows = balance.sides.confirm.as_ref().ok_or_else(|| cannot_simulate(run))?;
        let model = with_events_of(model, rows);
        Ok(Confirming {
            score: balance.score(&model, rows),
            start: mechanical::start_of(run),
            model,
        })
    }

    /// Comparison of a fitted model with the runs.
    fn compared(&self, fit: &Fitted) -> Result<Comparison, FitError> {
        let (model, evidence) = (&fit.model, &self.evidence);
        match &self.balance {
            None => compare(model, evidence, ErrorOf::Structure),
            Some(balance) => Ok(balance.compare(model, evidence, ErrorOf::Structure, true)),
        }
    }

    /// With the deviations of the answer where the model lacks a named effect.
    pub(super) fn with_deviations(&self, fit: Fitted, inference: &Inference) -> Fitted {
        if self.fits_at_once() || fit.model.effects.is_empty() || inference.named.is_empty() {
            return fit;
        }
        with_deviations(fit, &self.evidence.training, inference.noise)
    }

    /// The fit as it is reported, not as vetoes judge it: a balance of torques with the uncertainty by the forms that it may
    /// lack, a run of voltage and speed alone without the values that need a current.
    pub(super) fn as_reported(&self, fit: &Fitted) -> Fitted {
        if let Some(balance) = &self.balance {
            let rows = &balance.sides.training;
            return mechanical::averaged_over_forms(fit, rows, &self.evidence.training);
        }
        let mut reported = fit.clone();
        without_current(&mut reported.parameters, &self.evidence.training);
        reported
    }

    /// Limits of these runs, and the derivation of a balance.
    pub(super) fn limits(&self) -> Vec<Limit> {
        let mut limits: Vec<Limit> = self.aside.iter().cloned().map(Limit::RunsSetAside).collect();
        limits.extend(self.evidence.unjudged());
        limits.extend(self.searched.clone());
        let known = self.evidence.training.input_delay_s();
        limits.extend(
            self.given
                .input_delay_s
                .zip(known)
                .map(|(offset_s, (_, known_s))| Limit::StampsOffset { offset_s, known_s }),
        );
        let of_runs = self.offsets.iter().cloned();
        limits.extend(of_runs.map(|(run, offset_s)| Limit::OffsetOfRun { run, offset_s }));
        limits.extend(self.balance.as_ref().map(|balance| Limit::TorqueBalance {
            derivation: balance.sides.training.derivation.clone(),
        }));
        let winding = winding_balance::fit(&Model::default(), &self.evidence.training);
        limits.extend(winding.map(|winding| Limit::ConstantDrop {
            drop_v: winding.drop_v.0,
            std_v: winding.drop_v.1,
        }));
        limits
    }
}

/// `model` fitted to the run as [`diagnose`](super::diagnose()) and `identify` fit it, by its free run under a voltage and else by
/// the balance of torques, and the evidence with the scale of its errors.
pub fn fitted_baseline(model: &Model, evidence: Evidence) -> Result<(Evidence, Model), FitError> {
    if evidence.training.input == Input::Voltage {
        let (evidence, fit) = evidence.with_baseline(model)?;
        return Ok((evidence, fit.model));
    }
    let (_, fit) = Balance::new(model, &evidence)?;
    let fit = fit.ok_or_else(|| cannot_simulate(&evidence.training))?;
    Ok((evidence, fit.model))
}

/// Iterations of `most` that a fit of a free run may take, with derivatives by differences.
pub(super) fn affordable(model: &Model, run: &Scenario, most: usize) -> usize {
    let Ok(mut plant) = Plant::new(model, run.input) else {
        return most;
    };
    plant.simulate(run, State::default());
    iterations_of(plant.work() * (model.free_slots().len() as u64 + 1), most)
}

/// `start` with the inductance of `other` where its own has no effect on the samples, since the current settles between them: of a
/// model that lacks a filter the inductance stands for it, and no gradient leads there.
fn other_inductance(start: &Model, other: &Model, run: &Scenario) -> Option<Model> {
    let [own_s, other_s] =
        [start, other].map(|model| model.motor.electrical_time_constant_s().unwrap_or(0.0));
    let period_s = run.mean_period_s();
    let inductance_h = other.motor.get(MotorKey::Inductance)?;
    let mut moved = start.clone();
    moved.motor.set(MotorKey::Inductance, inductance_h);
    (own_s < 0.25 * period_s && other_s > 2.0 * own_s).then_some(moved)
}

/// The effects of the baseline, needed or not, and these of the named ones, with the values of the joint fit.
fn beside(
    baseline: &Model,
    inference: &Inference,
    kept: &[&'static str],
) -> Result<Model, FitError> {
    let given = baseline.effect_ids().into_iter().filter(|id| inference.is_eligible(id));
    let ids: Vec<&'static str> = given.chain(kept.iter().copied()).collect();
    let start = inference.with_effects(&ids);
    let mut start =
        start.ok_or_else(|| FitError::CannotSimulate { run: "the fit run".to_owned() })?;
    let unasked = baseline.effects.iter();
    let unasked: Vec<_> = unasked.filter(|active| !start.has(active.id())).collect();
    start.effects.extend(unasked.into_iter().cloned());
    Ok(start)
}

/// A model on the ladder, fitted to the fit run alone, and its score on the hold-out.
pub(super) struct Standing {
    pub(super) fit: Fitted,
    pub(super) score: Score,
    /// The values are the free run's, since those of its prediction errors do not predict the hold-out.
    keeps_free_run: bool,
}

impl Standing {
    fn of(fit: Fitted, bench: &Bench) -> Result<Self, FitError> {
        let score = bench.held_out(&fit.model)?;
        Ok(Self { fit, score, keeps_free_run: false })
    }

    /// With the parameters from prediction errors (Ljung 1999), unless they do not predict the hold-out; an effect's
    /// size is reported from these. A balance of torques has no free run that could drift.
    fn refined_fit(fit: Fitted, bench: &Bench, inference: &Inference) -> Result<Self, FitError> {
        let free = Self::of(fit, bench)?;
        if bench.fits_at_once() {
            return Ok(free);
        }
        let led = refined(free.fit.clone(), &bench.evidence.training, inference.noise);
        let led = Self::of(led, bench)?;
        let keeps_free_run = led.score.nrms > AS_GOOD * free.score.nrms;
        let kept = if keeps_free_run { free } else { led };
        Ok(Self { keeps_free_run, ..kept })
    }

    /// Widens the deviations of values of the free run by their distance from those of the prediction errors. What
    /// was decided by the earlier deviations stays.
    pub(super) fn with_deviations(mut self, bench: &Bench, inference: &Inference) -> Self {
        if self.keeps_free_run {
            self.fit = with_deviations(self.fit, &bench.evidence.training, inference.noise);
        }
        self
    }

    pub(super) fn rung(&self) -> Rung {
        Rung { effects: self.fit.model.effect_ids(), holdout_rmse: self.score.nrms }
    }
}

/// The baseline and one named effect more on each rung, what explains most first; the parameters of the last are
/// reported. `known` are the rungs after the baseline that an earlier ladder shares with this one. Else the veto of the
/// first effect with which the free run diverges.
pub(super) fn climb(
    bench: &Bench,
    baseline: &Fitted,
    inference: &Inference,
    known: Vec<Standing>,
    progress: Progress<'_>,
) -> Result<Result<Vec<Standing>, Veto>, FitError> {
    let last = inference.named.len();
    let on_rung = |place: usize, fit: Fitted| {
        if place < last || inference.is_cut() {
            Standing::of(fit, bench)
        } else {
            Standing::refined_fit(fit, bench, inference)
        }
    };
    // Only the error of a rung below the last counts, not the accuracy of its parameters. Where the budget is spent, all
    // rungs together take no longer than one refit.
    let most = Options::thrifty().most_iterations;
    let of_lower_rung = Options {
        most_iterations: if inference.is_cut() { most / last.max(1) } else { most },
        one_of_many: false,
        ..Options::thrifty()
    };
    let unfitted = Options { most_iterations: 0, ..Options::thrifty() };
    let climbed: Vec<Result<Standing, FitError>> = (known.len()..last)
        .into_par_iter()
        .with_max_len(1)
        .map(|place| {
            let start = beside(&baseline.model, inference, &inference.named[..=place])?;
            let is_last = place + 1 == last && !inference.is_cut();
            let options = if is_last { Options::default() } else { of_lower_rung };
            let fitted = bench.fit_with(&start, Some(&baseline.model), options);
            // Where much else is missing the fit of a free run may fail: then the values of the joint fit.
            let standing = fitted.and_then(|fit| on_rung(place + 1, fit));
            standing.or_else(|_| on_rung(place + 1, bench.fit_with(&start, None, unfitted)?))
        })
        .collect();
    let mut rungs = vec![on_rung(0, baseline.clone())?];
    let all = known.into_iter().map(Ok).chain(climbed);
    for (effect, rung) in inference.named.iter().zip(all) {
        let rung = match rung {
            Err(FitError::CannotSimulate { .. }) => {
                return Ok(Err(Veto { effect, reason: VetoReason::Diverges }));
            }
            rung => rung?,
        };
        let (error, holdout) = (rung.fit.nrms, rung.score.nrms);
        progress(Event::Refitted { effect, error });
        progress(Event::Accepted { effect, holdout });
        rungs.push(rung);
    }
    Ok(Ok(rungs))
}

/// One model on the ladder and its held-out error in units of the noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rung {
    pub effects: Vec<&'static str>,
    pub holdout_rmse: f64,
}

/// What adding or removing an effect did; `add --json` prints it with its sentence.
#[derive(Clone, Debug, Serialize)]
pub struct AddResult {
    pub effect: &'static str,
    pub accepted: bool,
    /// Accepted by the user although the runs do not show it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub forced: bool,
    #[serde(rename = "code")]
    pub finding: ChangeFinding,
    /// Name of the effect, which need not be in the catalogue.
    #[serde(skip)]
    pub name: &'static str,
    /// Posterior probability that the effect is present, jointly with all others.
    #[serde(skip)]
    pub probability: f64,
    /// Effects of the model that are not needed besides the others.
    #[serde(skip)]
    pub superfluous: Vec<&'static str>,
    /// What kept it from being added whatever its probability is.
    #[serde(skip)]
    pub refused: Option<Refusal>,
    #[serde(skip)]
    pub aside: Option<SetAside>,
    pub before: Comparison,
    pub after: Comparison,
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    pub ladder: Vec<Rung>,
    /// Errors on the confirming run, where there is one.
    pub confirm: Option<[Rung; 2]>,
    /// What a drop does to the voltage, where that of a controlled current shows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub winding_drop: Option<WindingDrop>,
    #[serde(skip)]
    pub fit: Fitted,
}

findings! {
    /// What the runs show of an effect that is added or removed.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum ChangeFinding {
        NotJudged { why: &'static str } = "cannot_be_judged",
        /// It is present; the effects from which these runs do not distinguish it.
        There { rivals: Vec<&'static str> } = "is_there",
        /// It is not present besides the named effects; whether it would be detectable.
        NotThere { beside: Vec<&'static str>, would_show: bool } = "is_not_there",
        Needed = "is_needed",
        Superfluous = "is_superfluous",
        /// The removed effect is not shown by these runs, and not detectable in them.
        NotShown = "would_not_show",
    }
}

/// What keeps an effect from being added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    Veto(VetoReason),
    Trivial(TrivialPrediction),
}

impl AddResult {
    /// Whether the model that was refused is one with the effect.
    pub fn can_be_forced(&self) -> bool {
        self.fit.model.has(self.effect)
    }

    /// Accepts a refused change; an effect that is not eligible in these runs is not in the model and stays refused.
    pub fn force(&mut self) {
        if !self.accepted && self.can_be_forced() {
            (self.accepted, self.forced) = (true, true);
        }
    }
}

/// Refits `model` with `effect` added; refused, with the reason, where the runs do not show it besides all others.
pub fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    let id = effect.card().id;
    let (bench, before) = Bench::for_fits_of(&[id], model, evidence, None)?;
    let eligible = eligible(&before.model, Some(effect));
    let inference = bench.infer(&before, &eligible, &silent)?;
    // Where it is not eligible the answer is the model as it was.
    let after = if inference.is_eligible(id) {
        let start = beside(&before.model, &inference, &[id])?;
        bench.fit_with(&start, Some(&before.model), Options::default())?
    } else {
        before.clone()
    };
    let mut result = change(effect, &bench, &inference, [before, after], true)?;
    let drop = (id == winding_drop::ID).then(|| WindingDrop::find(model, &bench.evidence));
    if let Some(drop) = drop.flatten() {
        result.parameters = drop.add_to(&mut result.fit.model);
        result.fit.parameters.extend(result.parameters.iter().cloned());
        (result.accepted, result.refused) = (true, None);
        result.probability = drop.probability;
        result.finding = ChangeFinding::There { rivals: Vec::new() };
        result.winding_drop = Some(drop);
    }
    Ok(result)
}

/// Refits `model` without `effect`; refused where the runs show it.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    let (bench, before) = Bench::new(model, evidence)?;
    let inference = bench.infer(&before, &eligible(&before.model, None), &silent)?;
    let without = before.model.without_effect(effect.card().id)?;
    let after = bench.fit(&without)?;
    change(effect, &bench, &inference, [before, after], false)
}

fn change(
    effect: &'static dyn Effect,
    bench: &Bench,
    inference: &Inference,
    [before, after]: [Fitted; 2],
    adding: bool,
) -> Result<AddResult, FitError> {
    let id = effect.card().id;
    let refined_standing = |fit| {
        let standing = Standing::refined_fit(fit, bench, inference)?;
        Ok::<_, FitError>(standing.with_deviations(bench, inference))
    };
    let after = refined_standing(after)?;
    // The model before has the effect that is taken out, and gives its size.
    let before = if adding { Standing::of(before, bench)? } else { refined_standing(before)? };
    let mut rungs = vec![before, after];
    // Beside others that the runs show too, one alone need not lower the error.
    let is_alone = adding && inference.named == [id];
    let veto = is_alone.then(|| vetoes::first(bench, inference, &[id], &rungs));
    let refused = veto.flatten().map(|veto| Refusal::Veto(veto.reason)).or_else(|| {
        let as_good =
            |last: &Standing| trivial::as_good(&last.score, &bench.evidence, bench.torques());
        rungs.last().filter(|_| is_alone).and_then(as_good).map(Refusal::Trivial)
    });
    let (after, before) = (rungs.remove(1), rungs.remove(0));
    let confirm = match &bench.evidence.confirm {
        Some(run) => {
            let on = |standing: &Standing| -> Result<Rung, FitError> {
                let score = bench.confirming(&standing.fit.model, run)?.score;
                Ok(Rung { holdout_rmse: score.nrms, ..standing.rung() })
            };
            Some([on(&before)?, on(&after)?])
        }
        None => None,
    };
    let sides = [bench.compared(&before.fit)?, bench.compared(&after.fit)?];
    let [compared_before, compared_after] = sides;
    let fit = bench.as_reported(&after.fit);
    let reported = if adding { fit.clone() } else { bench.as_reported(&before.fit) };
    Ok(AddResult {
        effect: id,
        accepted: inference.names(id) == adding && refused.is_none(),
        forced: false,
        finding: finding(id, inference, adding),
        name: effect.card().name,
        probability: inference.of(id).map_or(0.0, |found| found.probability),
        superfluous: inference.superfluous.clone(),
        refused,
        aside: bench.aside.clone(),
        before: compared_before,
        after: compared_after,
        parameters: parameters_of(id, &reported.parameters),
        ladder: vec![before.rung(), after.rung()],
        confirm,
        winding_drop: None,
        fit,
    })
}

/// Parameters of a model with effects that was fitted to the free run of one record: values and deviations
/// as [`add`] and `diagnose` give them, from the prediction errors along the run. The free run's own deviations count what
/// neighbouring samples err by together, but no error of an effect's form or of the time stamps: that of a
/// brush drop is then ten times too small. Unchanged for a model without effects, and for runs without a voltage.
#[must_use]
pub fn known_along(run: &Scenario, mut found: Identified) -> (Identified, Option<AlongFinding>) {
    if run.input != Input::Voltage || found.model.effects.is_empty() {
        return (found, None);
    }
    let finding = match along(run, &found.model) {
        Ok((_, Led::Neither)) => AlongFinding::NotFollowed,
        Ok((led, of)) => {
            // A choice from a grid is not fitted here.
            for own in led.parameters.into_iter().filter(|own| own.verdict != Verdict::Fixed) {
                let mut known = found.parameters.iter_mut();
                if let Some(known) = known.find(|known| known.key == own.key) {
                    *known = own;
                }
            }
            found.model = led.model;
            if matches!(of, Led::Values) {
                AlongFinding::PredictionErrors
            } else {
                AlongFinding::FreeRun
            }
        }
        Err(error) => AlongFinding::Failed(error.to_string()),
    };
    (found, Some(finding))
}

findings! {
    /// What the values and deviations of a model with effects are from.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum AlongFinding {
        PredictionErrors = "values_from_prediction_errors",
        /// The values from prediction errors do not predict the run.
        FreeRun = "values_from_free_run",
        NotFollowed = "model_not_followed",
        /// The same, with the message of a fit that failed.
        Failed(String) = "fit_along_run_failed",
    }
}

/// The fit refined by its prediction errors, and whether values or deviations came from them.
fn along(run: &Scenario, model: &Model) -> Result<(Fitted, Led), FitError> {
    let noise = NoiseFloor::from_standstill(run).unwrap_or_else(|| NoiseFloor::from_spread(run));
    let evidence = Evidence::of_one(run, noise);
    let (evidence, fit) = evidence.with_baseline(model)?;
    let fit = Fitted::from(fit);
    let own: Vec<&'static dyn Effect> = model.effects.iter().map(|active| active.effect).collect();
    let (searched, _) = evidence.shortened();
    let noise = infer(&fit, model, &own, &[], &searched, &silent)?.noise;
    Ok(led(fit, run, noise, true))
}

/// What the runs show of an effect that is added, or else removed.
fn finding(id: &'static str, inference: &Inference, adding: bool) -> ChangeFinding {
    let found = inference.of(id);
    if let Some(why) = found.and_then(|found| found.why_not) {
        return ChangeFinding::NotJudged { why };
    }
    let would_show = found.is_some_and(|found| found.excited);
    match (inference.names(id), adding) {
        (true, true) => {
            let pairs = inference.confusable.iter().filter(|pair| pair.contains(&id));
            let rivals = pairs.map(|pair| if pair[0] == id { pair[1] } else { pair[0] });
            ChangeFinding::There { rivals: rivals.collect() }
        }
        (false, true) => {
            let others = inference.named.iter().copied().filter(|named| *named != id);
            ChangeFinding::NotThere { beside: others.collect(), would_show }
        }
        (true, false) => ChangeFinding::Needed,
        (false, false) if would_show => ChangeFinding::Superfluous,
        (false, false) => ChangeFinding::NotShown,
    }
}
