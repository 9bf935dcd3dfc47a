//! Sanity of the data, judged before anything is identified from them.
//!
//! ```text
//! Run -> mask                                  cells that are no measurement: codes, repeats, a telemetry that froze
//! Run, Scenario, Model -> Table -+-> record    single wild rows, a counter that overflows; nothing changes, or the shaft does
//!                                |             not turn; one signal has lost its sign
//!                                +-> stretches one signal is frozen, clipped, or a command
//!                                +-> columns   two columns swapped, a sign reversed  <- both equations, quickly
//!                                +-> scale     r/min for rad/s, mA for A, ms for s: by name and factor
//! Vec<Finding>: `refuses` -> nothing may be identified; else a caution that stands beside the result
//! ```
//!
//! A record is refused only on evidence in numbers. Both balances are homogeneous in each unit, so a wrong unit shows
//! only against something else: the angle, a torque, a nameplate, or a size that no motor has.

mod columns;
mod mask;
mod record;
mod scale;
mod sensor;
#[cfg(test)]
mod sensor_tests;
mod stretches;
mod table;
#[cfg(test)]
mod tests;

pub use mask::mask;
pub use scale::of_header;

use serde::Serialize;

use self::table::Table;
use super::claims::lower;
use drivebench_model::plant::{Model, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Run, Side, Verdict};

/// What sort of trouble a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Nothing changes: one operating point.
    Steady,
    /// The shaft does not turn.
    Standstill,
    /// The terminals are open while a voltage is stated.
    OpenCircuit,
    /// Single values that no machine can have shown.
    Outlier,
    /// A counter that overflows to the other sign.
    Overflow,
    /// A signal does not move although it must.
    Frozen,
    /// A signal is cut off at a limit.
    Clipped,
    /// A signal shows its size without its direction.
    Unsigned,
    Swapped,
    Reversed,
    Unit,
    /// A size that hardly any motor has.
    Magnitude,
}

/// One thing that is wrong, or may be.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub kind: Kind,
    /// Nothing may be identified from these data; else a caution.
    pub refuses: bool,
    /// What is seen, with its numbers.
    pub sentence: String,
    /// What to do about it.
    pub help: String,
    /// Parameters that cannot be called settled while this stands.
    #[serde(serialize_with = "keys")]
    pub doubts: Vec<MotorKey>,
}

fn keys<S: serde::Serializer>(doubts: &[MotorKey], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(doubts.iter().map(|key| key.key()))
}

impl Finding {
    fn refusal(kind: Kind, sentence: impl Into<String>, help: impl Into<String>) -> Self {
        Self {
            kind,
            refuses: true,
            sentence: sentence.into(),
            help: help.into(),
            doubts: MotorKey::ALL.to_vec(),
        }
    }

    fn caution(
        kind: Kind,
        doubts: &[MotorKey],
        sentence: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self {
            kind,
            refuses: false,
            sentence: sentence.into(),
            help: help.into(),
            doubts: doubts.to_vec(),
        }
    }
}

/// A parameter that a caution touches is not settled while the caution stands.
pub fn doubt(parameters: &mut [ParameterEstimate], findings: &[Finding]) {
    for parameter in parameters {
        let doubts = |it: &&Finding| it.doubts.iter().any(|key| key.key() == parameter.key);
        let finding = findings.iter().find(doubts);
        if let Some(finding) = finding {
            lower(parameter, Verdict::Searching, &finding.sentence);
        }
    }
}

/// Everything that is wrong with the data, what forbids identification first.
///
/// `model`: a nameplate or an earlier model, as far as there is one; its values are what units are judged by.
pub fn examine(run: &Run, scenario: &Scenario, model: &Model) -> Vec<Finding> {
    let mut table = Table::new(scenario);
    // A supply current enters no balance of the armature, and has no direction.
    if run.side(Channel::Current) == Some(Side::Supply) {
        table.current_a.fill(f64::NAN);
    }
    // One wild value bends every range and balance below.
    if let Some(wild) = record::overflow(&table).or_else(|| record::outlier(&table)) {
        return vec![wild];
    }
    let mut findings = record::still(&table);
    // A record in which nothing moves has no balance to check.
    if findings.iter().any(|finding| finding.refuses) {
        return findings;
    }
    let columns = columns::check(&table);
    // A column in another's place looks cut off or frozen for what it is taken for: that comes first.
    if let Some(exchanged) = columns.as_ref().and_then(|found| found.exchanged.clone()) {
        findings.push(exchanged);
    } else {
        findings.extend(record::contradicted(&table));
        findings.extend(scale::against_angle(run));
        if !findings.iter().any(|finding| finding.refuses) {
            findings.extend(columns.and_then(|found| found.impossible));
            findings.extend(scale::against_model(run, &table, model));
        }
    }
    findings.sort_by_key(|finding| !finding.refuses);
    // What mends two findings is said once.
    let mut said: Vec<String> = Vec::new();
    for finding in &mut findings {
        if said.contains(&finding.help) {
            finding.help.clear();
        } else {
            said.push(finding.help.clone());
        }
    }
    findings
}
