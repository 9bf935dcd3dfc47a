//! Effects of a model that a scheme has no place for: what it cannot carry it says.

use super::Identified;
use crate::identification::balance::why_no_regressor;
use crate::plant::{ActiveEffect, Model, MotorKey};
use crate::sample::ParameterEstimate;

/// Why a scheme that knows the motor alone carries no effect.
#[expect(
    clippy::unnecessary_wraps,
    reason = "one of the answers that a scheme may give"
)]
pub(super) fn motor_alone(_: &ActiveEffect) -> Option<&'static str> {
    Some("this scheme knows the motor's own parameters only")
}

/// Why a scheme over balances carries an effect of `model`, or not.
pub(super) fn of_balances(
    model: &Model,
    electrical: bool,
) -> impl Fn(&ActiveEffect) -> Option<&'static str> {
    move |active| why_no_regressor(active, &model.motor, electrical)
}

impl Identified {
    /// Says which effects of `model` were left out and why; `why` gives the reason, `None` for one that was carried.
    #[must_use]
    pub(super) fn leaving_out(
        mut self,
        model: &Model,
        why: impl Fn(&ActiveEffect) -> Option<&'static str>,
    ) -> Self {
        for active in &model.effects {
            let id = active.id();
            let Some(reason) = why(active) else {
                self.notes.extend(guessed(active));
                continue;
            };
            self.notes.push(format!(
                "{id} is left out: {reason}; what it does goes into the other parameters. \
                 The output-error fit carries it"
            ));
            for (spec, value) in active.effect.parameters().iter().zip(&active.values) {
                let key = format!("{id}.{}", spec.key);
                self.parameters.retain(|parameter| parameter.key != key);
                if value.is_none() {
                    self.parameters
                        .push(ParameterEstimate::not_observable(&key, spec.unit, reason));
                }
            }
        }
        self
    }
}

/// A value that gives an effect its form, which a linear scheme takes as it is, and which the model does not give.
fn guessed(active: &ActiveEffect) -> Vec<String> {
    let specs = active.effect.parameters().iter();
    specs
        .zip(&active.values)
        .filter(|(spec, value)| !spec.is_coefficient() && value.is_none())
        .map(|(spec, _)| {
            format!(
                "{}.{} is not given and this scheme cannot find it: {} {} is taken; the output-error fit finds it",
                active.id(),
                spec.key,
                spec.guess(),
                spec.unit
            )
        })
        .collect()
}

/// Coefficients of an effect that enters both balances come once from each: brought together by their variances.
pub(super) fn once_each(parameters: Vec<ParameterEstimate>) -> Vec<ParameterEstimate> {
    let mut merged: Vec<ParameterEstimate> = Vec::with_capacity(parameters.len());
    for next in parameters {
        let twin = merged.iter_mut().find(|earlier| earlier.key == next.key);
        let Some(earlier) = twin.filter(|_| MotorKey::from_key(&next.key).is_none()) else {
            merged.push(next);
            continue;
        };
        let weight = |p: &ParameterEstimate| p.std.filter(|std| *std > 0.0).map(|std| std.powi(-2));
        match (
            earlier.value.zip(weight(earlier)),
            next.value.zip(weight(&next)),
        ) {
            (Some((a, wa)), Some((b, wb))) => {
                let (value, std) = ((wa * a + wb * b) / (wa + wb), (wa + wb).sqrt().recip());
                // Balances that disagree: the spread is the better measure.
                let spread = (a - b).abs() / 2.0;
                if wb > wa {
                    *earlier = next;
                }
                (earlier.value, earlier.std) = (Some(value), Some(std.max(spread)));
            }
            (None, Some(_)) => *earlier = next,
            _ => {}
        }
    }
    merged
}
