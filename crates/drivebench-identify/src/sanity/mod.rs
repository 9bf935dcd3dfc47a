//! Plausibility of the data, judged before anything is identified from them.
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
mod fault;
mod mask;
mod record;
mod scale;
mod sensor;
mod stretches;
mod table;
#[cfg(test)]
mod tests;

pub use columns::EXPLAINS;
pub use fault::{
    Basis, ColumnFault, Evidence, Fault, Level, Mapping, Masked, SignalFault, UnitFault,
};
pub use mask::mask;
pub use scale::{
    ColumnUnit, LONGEST_ARMATURE_S, any_unit, is_unit, of_header, speed_over_angle, unit_of,
    unit_of_stamps,
};
pub use table::{Balances, Coefficient, balances, is_of_a_supply};

use serde::Serialize;

use self::table::Table;
use drivebench_model::plant::{Model, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, Side};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Nothing changes: one operating point.
    Steady,
    Standstill,
    /// The terminals are open while a voltage is stated.
    OpenCircuit,
    /// Outliers: single values that are physically impossible.
    Outlier,
    /// A counter that overflows to the other sign.
    Overflow,
    /// A signal does not move although it must.
    Frozen,
    /// A signal is cut off at a limit.
    Clipped,
    /// A signal without its sign.
    Unsigned,
    Swapped,
    Reversed,
    Unit,
    /// A value outside the usual range of motors.
    Magnitude,
}

/// A fault, or a suspected one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub kind: Kind,
    /// Nothing may be identified from these data; else a caution.
    pub refuses: bool,
    #[serde(rename = "code")]
    pub fault: Fault,
    /// Parameters that must not be settled under this caution.
    #[serde(serialize_with = "keys")]
    pub doubts: Vec<MotorKey>,
}

fn keys<S: serde::Serializer>(doubts: &[MotorKey], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(doubts.iter().map(|key| key.key()))
}

impl Finding {
    fn refusal(kind: Kind, fault: Fault) -> Self {
        Self::of_all(kind, true, fault)
    }

    /// A refusal, or a caution for every parameter.
    fn of_all(kind: Kind, refuses: bool, fault: Fault) -> Self {
        Self { refuses, ..Self::caution(kind, &MotorKey::ALL, fault) }
    }

    fn caution(kind: Kind, doubts: &[MotorKey], fault: Fault) -> Self {
        Self { kind, refuses: false, fault, doubts: doubts.to_vec() }
    }
}

/// Distance of rows from one to the next of which no shaft stops and runs again, s.
const CLOSE_S: f64 = 0.02;

/// A parameter that a caution touches is not settled while the caution stands; the reason is the `sentence` of its fault.
pub fn doubt(
    parameters: &mut [ParameterEstimate],
    findings: &[Finding],
    sentence: impl Fn(&Fault) -> String,
) {
    for parameter in parameters {
        let doubts = |it: &&Finding| it.doubts.iter().any(|key| key.key() == parameter.key);
        if let Some(finding) = findings.iter().find(doubts) {
            parameter.unsettle(Reason::FaultyData, sentence(&finding.fault));
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
    // One outlier distorts every range and balance below.
    if let Some(wild) = record::overflow(&table).or_else(|| record::outlier(&table)) {
        return vec![wild];
    }
    let mut findings = record::still(&table);
    // A record in which nothing moves has no balance to check.
    if findings.iter().any(|finding| finding.refuses) {
        return findings;
    }
    let columns = columns::check(&table);
    // An exchanged column appears cut off or frozen as the signal that it is mapped to: the exchange comes first.
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
    findings
}
