//! Families of effects, as their cards state them: which take power, which are curves, and of which a model holds one.

use crate::plant::{Card, Effect, effect};

fn card(id: &str) -> Option<&'static Card> {
    effect::find(id).map(Effect::card)
}

/// Whether physics allows this effect no size below zero.
pub(super) fn takes_power(id: &str) -> bool {
    card(id).is_some_and(|card| card.takes_power)
}

/// Equation and axis of the curve that an effect is; `None` where it is more than a curve.
pub(super) fn curve_of(id: &str) -> Option<(&'static str, &'static str)> {
    let (balance, axis) = card(id)?.curve?;
    Some((balance.key(), axis.key()))
}

/// Currents from which on gaps, not brushes, bend the voltage, A: the drop of brushes has built up at a tenth of it.
pub(super) const LEAST_BOUNDARY_A: f64 = 0.9;

/// Whether two effects are of one family, so that a model with one of them does not get the other too.
pub(super) fn related(a: &str, b: &str) -> bool {
    let names = |a, b| card(a).is_some_and(|card| card.alternatives.contains(&b));
    names(a, b) || names(b, a)
}
