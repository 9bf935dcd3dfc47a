//! The two ways in which a run observes a model: the free run of what a voltage drives, and the balance of torques of what
//! a torque or a current drives. Whoever fits and judges models asks here, and does not see which it is.

use super::evidence::Evidence;
use super::fitted::Fitted;
use super::mechanical::Balance;
use super::score::Score;
use crate::identification::output_error::{self, FitError};
use crate::plant::{Input, Model, Scenario};

/// The runs and how models are held against them.
pub(super) struct Bench {
    pub(super) evidence: Evidence,
    balance: Option<Balance>,
}

impl Bench {
    /// With the refitted baseline.
    pub(super) fn new(model: &Model, mut evidence: Evidence) -> Result<(Self, Fitted), FitError> {
        if evidence.training.input == Input::Voltage {
            let (evidence, fit) = evidence.with_baseline(model)?;
            let balance = None;
            return Ok((Self { evidence, balance }, Fitted::from(&fit)));
        }
        let (balance, fit) = Balance::with_baseline(model, &evidence)?;
        evidence.noise.source = balance.scale.source;
        let fit = balance.fitted(&fit, &evidence);
        let balance = Some(balance);
        Ok((Self { evidence, balance }, fit))
    }

    /// Fits what is free in `start` to the training run alone.
    pub(super) fn fit(&self, start: &Model) -> Result<Fitted, FitError> {
        let training = &self.evidence.training;
        match &self.balance {
            None => {
                let start = std::slice::from_ref(start);
                let fit = output_error::fit(start, training, &self.evidence.noise)?;
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
            Some(balance) => Ok(balance.score(model, &balance.sides.holdout, noise)),
        }
    }

    /// A complete model on the confirming run.
    pub(super) fn confirming(&self, model: &Model, run: &Scenario) -> Result<Score, FitError> {
        let noise = &self.evidence.noise;
        match &self.balance {
            None => Score::of(model, run, noise),
            Some(balance) => match &balance.sides.confirm {
                Some(rows) => Ok(balance.score(model, rows, noise)),
                None => Err(FitError::CannotSimulate {
                    run: run.name.clone(),
                }),
            },
        }
    }

    /// What these runs cannot answer, and what errors are of.
    pub(super) fn limits(&self) -> Vec<String> {
        let mut limits = self.evidence.unjudged();
        limits.extend(self.balance.as_ref().map(|balance| {
            format!(
                "errors are those of the balance of torques ({})",
                balance.sides.training.sentence
            )
        }));
        limits
    }
}
