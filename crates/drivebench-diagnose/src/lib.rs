//! Comparison of a model with measurements, location of its error, identification of missing effects.
//!
//! ```text
//! Evidence (fit run, hold-out, confirm run, noise floor)
//!    |-> compare      error per signal, noise floor, whiteness and independence of the residual
//!    |-> traces       every signal, measured and simulated, over the time of its run
//!    |-> versus       two models on one run: the better, and whether the difference is significant
//!    |-> location     which equation fails, over which speeds, currents, angles, times, and its error as a curve
//!    |-> fingerprint  R and Ke of each run: is the hold-out of the same motor?
//!    |-> joint        posterior over sets of effects: which are named, their probability and size
//!    |-> ladder       named effects join the model one by one, each rung judged on the hold-out (by a free run, or by the
//!    |                balance of torques: mechanical); add or remove one effect: refused if the runs do not show it
//!    |-> diagnose     the decision: verdict, candidates, and its confirmation on an independent run
//!    |-> next_experiment  the most informative next run
//!    '-> limits       limits of these runs, and why
//! ```
//!
//! An effect is named by its posterior probability from all runs, and its error is that of data that the fit has not
//! used. A finding is a code with numbers; the program makes the sentences.

mod candidates;
mod compare;
mod diagnose;
mod evidence;
mod fingerprint;
mod floor;
mod joint;
mod ladder;
mod lags;
mod limits;
mod location;
mod mechanical;
pub mod next_experiment;
mod progress;
mod reached;
mod residual;
mod score;
mod traces;
mod trivial;
mod versus;
mod vetoes;
mod winding_drop;
mod work;

pub use candidates::{Candidate, CandidateFinding, Status};
pub use compare::{Comparison, ProcessingError, SignalComparison, Signals, Where, compare};
pub use diagnose::{
    Answer, CONFIRMED_SIGMAS, Confirmation, ConfirmationFinding, Diagnosis, DiagnosisVerdict,
    diagnose, diagnose_with,
};
pub use evidence::{Evidence, HoldoutFrom, shared_samples};
pub use fingerprint::{Fingerprint, Kinship, MotorMatch, Value, fingerprint, matches};
pub use joint::answer::{Onset, RunOf, Unknown, UnknownKind};
pub use joint::expected_information::InformationBasis;
pub use ladder::{
    AddResult, AlongFinding, ChangeFinding, Refusal, Rung, add, fitted_baseline, known_along,
    remove,
};
pub use limits::{Limit, LongRun, RepeatUnknown, SearchedPart, SetAside, Unjudged, WhyOpen};
pub use location::{
    AxisFinding, AxisMap, AxisReason, CurvePoint, EffectCurve, EquationBalance, EquationState,
    ErrorForm, ErrorMap, ErrorOf, FailureLocation, Located, MapCell, MapDigits, MapError,
    MeasuredMap, Off, OwnChange, RankedEffect, Undecided, axis_map, effect_curve, error_curve,
    locate, provisional_ranking, torque_map,
};
pub use next_experiment::{
    ExperimentLimits, FasterRun, Hidden, HiddenReason, NextExperiment, Recipe, Recommendation,
    next_experiment, recommend,
};
pub use progress::{Event, Progress, Stage, silent};
pub use reached::{Peak, Reached};
pub use residual::{Light, ResidualLights, SignalLights};
pub use score::{Fitted, Score, SignalScore};
pub use traces::{Part, Quantity, RecordedChannels, RunTraces, SignalTrace, Traces, WorstPlace};
pub use trivial::TrivialPrediction;
pub use versus::{Better, SignalVersus, Versus, VersusFinding, versus};
pub use vetoes::{VetoReason, WhyUnexplained};
pub use winding_drop::WindingDrop;

#[cfg(test)]
mod event_tests;
#[cfg(test)]
mod kit;
#[cfg(test)]
mod scale_tests;
#[cfg(test)]
mod tests;
