//! Spike-and-slab variable selection (George and McCulloch, Variable selection via Gibbs sampling, J. Am. Stat. Assoc. 88, 1993)
//! over a model that is linearised along a Kalman filter and refined by Gauss-Newton: the posterior over all sets of effects.
//!
//! ```text
//! model, run --(follow: Kalman filter)--> innovations, gains
//!                 |-> columns   what each effect at its slab would add to the whitened innovations: Gram matrix
//!                 |             (nuisances: what is in beside them; tangent: eight side by side, and slopes; forms: the few worth a
//!                 |             column; whitened: their storage)
//!                 |-> noise     disturbance and sensors by marginal likelihood, every effect in under its slab
//!                 '-> select    posterior over the sets of effects and forms
//! eligible: which effects a run can judge, and which of its rows count
//! acting:   what effects do at an instant
//! events:   what happens in one run, at a moment of its own
//! solution: the model at the linear solution of a set --> prediction_error: its refit
//! refits:   what refits refute of a set;  approach: far from the data, effects that join one by one
//! search:   all of these in rounds, linearised anew, until set and noise stand
//! free_run: what a model leaves of a run: error that none can foretell, excess over white noise, likelihood ratio
//! expected_information: what the same problem with a run more would show of each effect
//! detectability: how sharply runs show an effect, and one that happens once whenever it came
//! rivals:   what these runs do not tell apart
//! marginal: probability, bound and detectable size of one effect;  answer: of all, and what follows an axis and is none of them
//! ```

mod acting;
pub(super) mod answer;
mod approach;
mod columns;
mod detectability;
pub(super) mod eligible;
pub(super) mod events;
pub(super) mod expected_information;
mod follow;
mod forms;
pub(super) mod free_run;
pub(super) mod marginal;
mod noise;
mod nuisances;
mod prediction_error;
mod refits;
mod rivals;
mod search;
mod select;
mod solution;
mod tangent;
mod whitened;

pub(super) use follow::Noise;
