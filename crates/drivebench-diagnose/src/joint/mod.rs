//! Spike-and-slab variable selection (George and McCulloch, Variable selection via Gibbs sampling, J. Am. Stat. Assoc. 88, 1993)
//! over a model that is linearised along a Kalman filter and refined by Gauss-Newton: the posterior over all sets of effects.
//!
//! ```text
//! model, run --(kalman: filter; run)--> innovations, gains
//!                 |-> columns   what each effect at its slab would add to the whitened innovations: a regression
//!                 |             (nuisances: what is in beside them; tangent: forward sensitivities, eight side by side; screening:
//!                 |             the few forms that get a column; whitened: their storage and products)
//!                 |-> noise     disturbance and sensors by marginal likelihood, every effect in under its slab
//!                 '-> select    posterior over the sets of effects and forms
//! eligible: which effects a run can judge, and which of its rows count
//! process_noise: terms of the effects at an instant, and errors of their forms
//! events:   what happens in one run, at a moment of its own
//! solution: the model at the linear solution of a set --> prediction_error: its refit
//! refits:   what refits refute of a set;  stepwise: far from the data, effects that join one by one
//! search:   all of these in rounds, linearised anew, until set and noise stand;  leftover: what the set leaves
//! free_run: error of a free run that no model predicts, excess over white noise, likelihood ratio
//! expected_information: of each effect with a run more
//! detectability: how sharply runs show an effect, and one that happens once whenever it came
//! rivals:   confounded effects
//! marginal: probability, bound and detectable size of one effect;  answer: of all, and of unknown curves
//! ```

pub(super) mod answer;
mod columns;
mod detectability;
pub(super) mod eligible;
pub(super) mod events;
pub(super) mod expected_information;
pub(super) mod free_run;
mod kalman;
mod leftover;
pub(super) mod marginal;
mod noise;
mod nuisances;
mod prediction_error;
mod process_noise;
mod refits;
mod regression;
mod rivals;
mod run;
mod screening;
mod search;
mod select;
mod solution;
mod stepwise;
mod tangent;
mod whitened;

pub(super) use kalman::Noise;
