//! Several effects at once: one linear Gaussian model of what the runs' innovations hold, one posterior over all sets.
//!
//! ```text
//! model, run --(follow: Kalman filter)--> innovations, gains
//!                 |-> columns   what each effect at its slab would add to the whitened innovations: Gram matrix
//!                 |             (nuisances: what is in beside them; tangent: eight side by side, and slopes; forms: the few worth a
//!                 |             column; whitened: their storage)
//!                 |-> noise     disturbance and sensors by marginal likelihood, every effect in under its slab
//!                 '-> select    posterior over the sets of effects and forms
//! asked:    which effects a run can be asked about, and what of it is fit to be asked
//! acting:   what effects do at an instant
//! events:   what happens in one run, at a moment of its own
//! solution: the model at the linear solution of a set --> prediction_error: its refit
//! refits:   what refits refute of a set;  approach: far from the data, effects that join one by one
//! search:   all of these in rounds, linearised anew, until set and noise stand
//! free_run: what a model leaves of a run: error that none can foretell, excess over white noise, likelihood ratio
//! foresight: what the same problem with a run more, as it is expected, would show
//! shown:    how sharply runs show an effect, and one that happens once whenever it came
//! rivals:   what these runs do not tell apart
//! answer:   probability, bound and detectable size of each effect; what follows an axis and is none of them
//! ```

mod acting;
pub(super) mod answer;
mod approach;
pub(super) mod asked;
mod columns;
pub(super) mod events;
mod follow;
pub(super) mod foresight;
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
mod shown;
mod solution;
mod tangent;
mod whitened;

pub(super) use follow::Noise;
