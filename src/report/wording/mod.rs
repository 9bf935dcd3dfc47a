//! Sentences about findings. The crates give codes with numbers; here, and only here, they become text.
//!
//! ```text
//! finding (enum with numbers) --> diagnosis, candidate, location, residual, ... --> sentence: card, page, screen
//!                             '-> json: its own form, with the sentence for the code
//! ```

pub mod candidate;
pub mod change;
pub mod columns;
pub mod diagnosis;
pub mod drift;
pub mod json;
pub mod limits;
pub mod location;
pub mod nameplate;
pub mod next_run;
pub mod probe;
pub mod record;
pub mod residual;
pub mod sanity;
pub mod versus;

use drivebench_bench::column_proposal as proposals;
use drivebench_diagnose as diagnose;
use drivebench_identify::balance::Derivation;
use drivebench_identify::noise::FloorSource;
use drivebench_identify::{drift as drifts, nameplate as plates, sanity as faults};

/// The unit of a multiple of the noise; without a noise floor, of the baseline's residual.
pub const fn times(source: FloorSource) -> &'static str {
    match source {
        FloorSource::Standstill | FloorSource::Repeat => "times the noise floor",
        FloorSource::None => "times the baseline's residual",
    }
}

/// The unit of an error that is given as a multiple.
pub const fn unit(source: FloorSource) -> &'static str {
    match source {
        FloorSource::Standstill | FloorSource::Repeat => "the noise floor",
        FloorSource::None => "the baseline's residual",
    }
}

/// The effects of a model, for a sentence.
pub fn effects<T: AsRef<str>>(ids: &[T]) -> String {
    match ids {
        [] => "no effect beyond the baseline".to_owned(),
        ids => ids.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(", "),
    }
}

/// Names of a list that are given.
const MOST_NAMES: usize = 4;

/// Names in one line, the rest of them counted; `None` without one.
pub(super) fn listed(names: impl Iterator<Item = String>) -> Option<String> {
    let names: Vec<String> = names.collect();
    let (given, rest) = names.split_at(names.len().min(MOST_NAMES));
    let given = given.join(", ");
    let text = if rest.is_empty() { given } else { format!("{given} and {} more", rest.len()) };
    (!names.is_empty()).then_some(text)
}

/// The codes of all findings in JSON, by what they are of.
pub const CODES: &[(&str, &[&str])] = &[
    ("diagnosis", diagnose::Answer::CODES),
    ("diagnosis: reason_code; comparison: not_fitted_code", diagnose::TrivialPrediction::CODES),
    ("candidate", diagnose::CandidateFinding::CODES),
    ("candidate: not_named", diagnose::VetoReason::CODES),
    ("unknown", diagnose::UnknownKind::CODES),
    ("confirm", diagnose::ConfirmationFinding::CODES),
    ("limit_codes", diagnose::Limit::CODES),
    ("where, repeat_follows", diagnose::ErrorForm::CODES),
    ("balance", diagnose::EquationState::CODES),
    ("undecided_code", diagnose::Undecided::CODES),
    ("axis_map", diagnose::AxisFinding::CODES),
    ("processing", Derivation::CODES),
    ("comparison of two models", diagnose::VersusFinding::CODES),
    ("effect added or removed", diagnose::ChangeFinding::CODES),
    ("next_experiment", diagnose::Recommendation::CODES),
    ("next_experiment: hidden", diagnose::HiddenReason::CODES),
    ("probe", drivebench_link::ProbeFinding::CODES),
    ("drift", drifts::DriftFinding::CODES),
    ("drift: possible_cause_code", drifts::DriftCause::CODES),
    ("drift: caution_codes", drifts::DriftCaution::CODES),
    ("drift: not_compared", drifts::NotCarried::CODES),
    ("nameplate", plates::NameplateFinding::CODES),
    ("nameplate: rows", plates::RowFinding::CODES),
    ("nameplate: cause_codes", plates::NameplateCause::CODES),
    ("nameplate: doubt_code", plates::NameplateDoubt::CODES),
    ("parameters: reason_code", drivebench_model::sample::Reason::CODES),
    ("findings: a signal", faults::SignalFault::CODES),
    ("findings: the assignment of columns", faults::ColumnFault::CODES),
    ("findings: a unit", faults::UnitFault::CODES),
    ("map: reasons", proposals::Reason::CODES),
    ("map: doubts of a column", proposals::Doubt::CODES),
    ("map: missing", proposals::Missing::CODES),
    ("map: unused", proposals::Unused::CODES),
];
