//! Several effects at once: one linear Gaussian model of what the runs' innovations hold, one posterior over all sets.
//!
//! ```text
//! model, run --(follow: Kalman filter)--> innovations, gains
//!                 |-> columns   what each effect at its slab would add to the whitened innovations: Gram matrix
//!                 |             (nuisances: what is always in beside them; tangent: eight side by side; forms: the few worth a column; whitened: their storage)
//!                 |-> noise     disturbance and sensors by marginal likelihood, every effect in under its slab
//!                 '-> select    posterior over the sets of effects and forms
//! acting: what effects do at an instant; slopes: what is free in a model, along a run
//! events: what happens in one run, at a moment of its own
//! approach: far from the data, effects that join one by one
//! search: refit of the best set (prediction_error), linearised anew, until set and noise stand (refits: what they refute)
//!         (excess: by how much what is left is more than white noise)
//! asked:  which effects a run can be asked about, and what of it is fit to be asked
//! free_run: error that no model can foretell, of a load that wanders and of rows that were lost
//! likelihood_ratio: two models on a run that had no part in any of this
//! answer: probability, bound and detectable size of each effect; what follows an axis and is none of them
//! ```

mod acting;
pub(super) mod answer;
mod approach;
pub(super) mod asked;
mod columns;
pub(super) mod events;
mod excess;
mod follow;
mod forms;
pub(super) mod free_run;
pub(super) mod likelihood_ratio;
mod noise;
mod nuisances;
mod prediction_error;
mod refits;
mod search;
mod select;
mod slopes;
mod tangent;
mod unknown;
mod whitened;

pub(super) use follow::Noise;
