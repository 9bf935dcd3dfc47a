//! Marginal posterior of one effect: its inclusion probability, and what bounds its size where it is not named.

use drivebench_model::plant::Effect;

/// Probability from which on an effect is named.
pub(super) const NAMED_PROBABILITY: f64 = 0.5;
/// The same for two together that cannot be told apart.
pub(super) const TOGETHER_PROBABILITY: f64 = 0.9;

/// One effect.
#[derive(Clone)]
pub(crate) struct Inferred {
    pub(crate) effect: &'static dyn Effect,
    /// Whether the model had it before.
    pub(crate) given: bool,
    /// That it is there, beside all others that may be.
    pub(crate) probability: f64,
    /// Whether these runs would show it at its slab, and why it is not eligible.
    pub(crate) excited: bool,
    pub(crate) why_not: Option<&'static str>,
    /// Its size is below this with 95 %, in the unit of its first parameter; an amplitude where it has sine and cosine.
    pub(crate) upper_bound: Option<f64>,
    /// A size that would have been named in 95 of 100 such records.
    pub(crate) detectable: Option<f64>,
    /// Log of the odds given the rest of the best set.
    pub(crate) log_odds: f64,
}

impl Inferred {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }
}
