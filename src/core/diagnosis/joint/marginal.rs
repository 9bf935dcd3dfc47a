//! Marginal posterior of one effect: its inclusion probability, and what bounds its size where it is not named.

use crate::plant::Effect;

/// Probability from which on an effect is named.
pub(super) const NAMED_PROBABILITY: f64 = 0.5;
/// The same for two together that cannot be told apart.
pub(super) const TOGETHER_PROBABILITY: f64 = 0.9;

/// One effect.
#[derive(Clone)]
pub(in crate::diagnosis) struct Inferred {
    pub(in crate::diagnosis) effect: &'static dyn Effect,
    /// Whether the model had it before.
    pub(in crate::diagnosis) given: bool,
    /// That it is there, beside all others that may be.
    pub(in crate::diagnosis) probability: f64,
    /// Whether these runs would show it at its slab, and why it is not eligible.
    pub(in crate::diagnosis) excited: bool,
    pub(in crate::diagnosis) why_not: Option<&'static str>,
    /// Its size is below this with 95 %, in the unit of its first parameter; an amplitude where it has sine and cosine.
    pub(in crate::diagnosis) upper_bound: Option<f64>,
    /// A size that would have been named in 95 of 100 such records.
    pub(in crate::diagnosis) detectable: Option<f64>,
    /// Log of the odds given the rest of the best set.
    pub(in crate::diagnosis) log_odds: f64,
}

impl Inferred {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }
}
