//! The two ways in which a run observes a model: the free run of what a voltage drives, and the balance of torques of what
//! a torque or a current drives. Whoever fits and judges models asks here, and does not see which it is.

use super::compare::{Comparison, compare};
use super::evidence::Evidence;
use super::fitted::Fitted;
use super::joint::answer::{Inference, infer};
use super::location::ErrorOf;
use super::mechanical::{Balance, with_events_of};
use super::progress::Progress;
use super::score::Score;
use crate::identification::output_error::{self, FitError};
use crate::numerics::levenberg_marquardt::Options;
use crate::plant::{Effect, Input, Model, Scenario, State};

/// A model on the confirming run, with its events and its start where they are in it.
pub(super) struct Confirming {
    pub(super) score: Score,
    pub(super) model: Model,
    pub(super) start: State,
}

/// The runs and how models are held against them.
pub(super) struct Bench {
    pub(super) evidence: Evidence,
    balance: Option<Balance>,
    /// The model as it was given, before it was refitted.
    given: Model,
    /// Which part of long runs is searched.
    searched: Option<String>,
}

impl Bench {
    /// With the refitted baseline.
    pub(super) fn new(model: &Model, evidence: Evidence) -> Result<(Self, Fitted), FitError> {
        let (mut evidence, searched) = evidence.shortened();
        if evidence.training.input == Input::Voltage {
            let (evidence, fit) = evidence.with_baseline(model)?;
            let bench = Self {
                evidence,
                balance: None,
                given: model.clone(),
                searched,
            };
            return Ok((bench, Fitted::from(&fit)));
        }
        let (balance, fit) = Balance::with_baseline(model, &evidence)?;
        evidence.noise.source = balance.scale.source;
        let fit = balance.fitted(&fit, &evidence);
        let bench = Self {
            evidence,
            balance: Some(balance),
            given: model.clone(),
            searched,
        };
        Ok((bench, fit))
    }

    /// What the runs say together of these effects beside the baseline.
    pub(super) fn ask(
        &self,
        baseline: &Fitted,
        asked: &[&'static dyn Effect],
        progress: Progress<'_>,
    ) -> Result<Inference, FitError> {
        let mut inference = infer(baseline, &self.given, asked, &self.evidence, progress)?;
        if self.fits_at_once() {
            agree(self, baseline, &mut inference)?;
        }
        Ok(inference)
    }

    /// Fits what is free in `start` to the training run alone.
    pub(super) fn fit(&self, start: &Model) -> Result<Fitted, FitError> {
        self.fit_with(start, Options::default())
    }

    /// The same for a rung that others follow: its error counts, not how well each parameter is known.
    pub(super) fn fit_in_passing(&self, start: &Model) -> Result<Fitted, FitError> {
        let options = Options {
            one_of_many: false,
            ..Options::thrifty()
        };
        self.fit_with(start, options)
    }

    /// What is free in `start` as it is, with its error on the training run.
    pub(super) fn as_it_is(&self, start: &Model) -> Result<Fitted, FitError> {
        let options = Options {
            most_iterations: 0,
            ..Options::thrifty()
        };
        self.fit_with(start, options)
    }

    fn fit_with(&self, start: &Model, options: Options) -> Result<Fitted, FitError> {
        let training = &self.evidence.training;
        match &self.balance {
            None => {
                let start = std::slice::from_ref(start);
                let fit = output_error::fit_with(start, training, &self.evidence.noise, options)?;
                Ok(Fitted::from(&fit))
            }
            Some(balance) => {
                let fit = balance.sides.fit(start);
                let fit = fit.ok_or_else(|| FitError::CannotSimulate {
                    run: training.name.clone(),
                })?;
                Ok(balance.fitted(&fit, &self.evidence))
            }
        }
    }

    /// Whether a fit costs no simulation.
    pub(super) const fn fits_at_once(&self) -> bool {
        self.balance.is_some()
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
        let noise = &self.evidence.noise;
        let cannot = || FitError::CannotSimulate {
            run: run.name.clone(),
        };
        match &self.balance {
            None => {
                let predicted = output_error::predict(model, run, noise)?;
                Ok(Confirming {
                    score: Score::of(&predicted.model, run, noise)?,
                    start: predicted.start,
                    model: predicted.model,
                })
            }
            Some(balance) => {
                let rows = balance.sides.confirm.as_ref().ok_or_else(cannot)?;
                let model = with_events_of(model, rows);
                let mut speeds = run.speed_rad_s.iter().filter(|speed| speed.is_finite());
                Ok(Confirming {
                    score: balance.score(&model, rows),
                    start: State::at(0.0, speeds.next().copied().unwrap_or(0.0)),
                    model,
                })
            }
        }
    }

    /// A fitted model beside the runs.
    pub(super) fn compared(&self, fit: &Fitted) -> Result<Comparison, FitError> {
        match &self.balance {
            None => compare(&fit.model, &self.evidence, ErrorOf::Structure),
            Some(balance) => Ok(balance.compare(&fit.model, &self.evidence)),
        }
    }

    /// What these runs cannot answer, and what errors are of.
    pub(super) fn limits(&self) -> Vec<String> {
        let mut limits = self.evidence.unjudged();
        limits.extend(self.searched.clone());
        limits.extend(self.balance.as_ref().map(|balance| {
            format!(
                "errors are those of the balance of torques ({})",
                balance.sides.training.sentence
            )
        }));
        limits
    }
}

/// The baseline's effects and these of the named ones, as the joint fit has them. What was given stays, needed or not.
pub(super) fn beside(
    baseline: &Model,
    inference: &Inference,
    kept: &[&'static str],
) -> Result<Model, FitError> {
    let is_asked = |id: &&'static str| {
        inference
            .of(id)
            .is_some_and(|found| found.why_not.is_none())
    };
    let given = baseline.effect_ids().into_iter().filter(is_asked);
    let ids: Vec<&'static str> = given.chain(kept.iter().copied()).collect();
    let mut start = inference
        .with_effects(&ids)
        .ok_or_else(|| FitError::CannotSimulate {
            run: "the fit run".to_owned(),
        })?;
    let unasked = baseline
        .effects
        .iter()
        .filter(|active| !start.has(active.id()));
    let unasked: Vec<_> = unasked.cloned().collect();
    start.effects.extend(unasked);
    Ok(start)
}

/// Standard deviations below which a size in the balance of torques may as well be zero.
const A_SIZE_SIGMAS: f64 = 2.0;

/// Holds what is named against the balance of torques, where a fit costs next to nothing: what explains most comes first,
/// and what the fit with all of it does not tell from zero is not named.
fn agree(bench: &Bench, baseline: &Fitted, inference: &mut Inference) -> Result<(), FitError> {
    let mut left = inference.named.clone();
    let mut order: Vec<&'static str> = Vec::new();
    while !left.is_empty() {
        let mut best = (0, f64::INFINITY);
        for (place, id) in left.iter().enumerate() {
            let kept: Vec<&'static str> = order.iter().copied().chain([*id]).collect();
            let fit = bench.fit(&beside(&baseline.model, inference, &kept)?)?;
            if fit.nrms < best.1 {
                best = (place, fit.nrms);
            }
        }
        order.push(left.remove(best.0));
    }
    while !order.is_empty() {
        let fit = bench.fit(&beside(&baseline.model, inference, &order)?)?;
        let told = |id: &str| fit.is_told_from_zero(id, A_SIZE_SIGMAS) == Some(true);
        let is_zero = |id: &&'static str| !told(id);
        let Some(place) = order.iter().rposition(is_zero) else {
            break;
        };
        inference.doubt(order.remove(place));
    }
    inference.confusable.retain(|pair| order.contains(&pair[0]));
    inference.named = order;
    Ok(())
}
