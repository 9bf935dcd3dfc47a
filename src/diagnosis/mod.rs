//! Compare the model with the measurement, see where it fails, name the missing effect, add it.
//!
//! ```text
//! Evidence (fit run, hold-out, confirm run, noise floor)
//!    |-> bench      how a run observes a model: free run under a voltage, balance of torques under a torque or a current
//!    |-> compare    free-run fit and error per signal, beside the floor; residual lights
//!    |-> location   which equation fails, and over which speeds, currents, angles, times
//!    |-> fingerprint  R and Ke of each run: is the hold-out of the same motor?
//!    |-> diagnose   joint: every set of effects weighed at once -> ladder of what is named, judged on the hold-out
//!    |                 -> confirmation: the same on a run that had no part in the answer
//!    |-> next_experiment  the run that tells what these runs cannot
//!    '-> ladder     add or remove one effect: before and after, refused if the runs do not ask for it
//! ```
//!
//! A name is given for what all runs together make likely beside everything else, and its error is told on data that the
//! fit has not seen.

mod axis_map;
mod bench;
mod candidates;
mod compare;
mod confirmation;
mod describe;
mod diagnose;
mod evidence;
mod explained;
mod family;
mod fingerprint;
mod fitted;
mod joint;
mod ladder;
mod location;
pub mod mechanical;
pub mod next_experiment;
mod progress;
mod reached;
mod repeatability;
mod residual;
mod score;
mod shapes;
mod shared;

pub use axis_map::{AxisMap, axis_map};
pub use candidates::{Candidate, Onset, RunOf, Status};
pub use compare::{Comparison, SignalComparison, compare};
pub use confirmation::Confirmation;
pub use diagnose::{Diagnosis, DiagnosisVerdict, Unknown, diagnose, diagnose_with};
pub use evidence::{Evidence, HoldoutFrom, TRAINING_SHARE};
pub use fingerprint::{Fingerprint, Kinship, MotorMatch, Value, fingerprint, matches};
pub use fitted::Fitted;
pub use ladder::{AddResult, Rung, add, remove};
pub use location::{
    EquationBalance, ErrorMap, ErrorOf, FailureLocation, Located, OwnChange, locate,
};
pub use next_experiment::{
    ExperimentLimits, NextExperiment, Recipe, equivalences, next_experiment, recommend,
};
pub use progress::{Event, Progress, Stage, silent};
pub use reached::{Peak, Reached};
pub use residual::{LAGS, Light, ResidualLights, SignalLights};
pub use score::{Score, SignalScore};
pub use shared::shared_samples;

#[cfg(test)]
mod event_tests;
#[cfg(test)]
mod tests;
