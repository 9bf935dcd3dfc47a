//! Report of a probe: findings and verdict.

use serde::Serialize;

use crate::link::Identity;
use crate::modbus::RawCounters;
use crate::profile::DriveProfile;
use crate::register_map::{Candidate, Hypothesis};
use drivebench_model::findings;

/// Verdict of the readings on the profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProbeVerdict {
    /// Every reading that can be judged is one of a drive at rest.
    Plausible,
    /// At least one is not, or is refused.
    Implausible,
    /// None can be judged: no evidence for the profile.
    Unjudged,
    /// The drive is another one than the profile's: a check of its identity failed.
    WrongDrive,
}

findings! {
    /// What the verdict rests on.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum ProbeFinding {
        OtherIdentity { check: String, found: String } = "identity_check_failed",
        /// The drive has none of the registers of a built-in profile.
        NoRegister = "has_no_register_of_the_profile",
        /// The drive reports that it runs, or its status word is read wrongly.
        Runs = "drive_reports_that_it_runs",
        NothingJudged = "no_reading_can_be_judged",
        /// All of so many readings are those of a drive at rest.
        AtRest { judged: usize } = "readings_of_a_drive_at_rest",
        NotAtRest { judged: usize, wrong: Vec<String> } = "readings_of_no_drive_at_rest",
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProbeReport {
    pub profile: String,
    /// Which drive the profile is of, how far it may be believed, and its source.
    pub provenance: String,
    pub verdict: ProbeVerdict,
    #[serde(rename = "code")]
    pub finding: ProbeFinding,
    /// Vendor, product and revision as the unit gives them (function code 43).
    pub names: Vec<String>,
    /// Whether a number comes back (function code 08); null over the stream.
    pub answers_function_8: Option<bool>,
    /// Identity block of our own map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identity: Option<Identity>,
    pub checks: Vec<ProbedCheck>,
    pub signals: Vec<ProbedSignal>,
    pub states: Vec<ProbedState>,
    /// The watchdog's time as its register reads, s; null where the profile has none.
    pub watchdog_s: Option<f64>,
    /// Single changes of the whole profile that make more readings plausible.
    pub hypotheses: Vec<Hypothesis>,
    pub remarks: Vec<String>,
    /// The drive has none of the profile's registers (exception 0x02).
    pub is_unknown_everywhere: bool,
    /// The profile is one of ours, and no changed copy of it.
    #[serde(skip)]
    pub(super) is_built_in: bool,
    /// Requests by class; null over the stream.
    pub counters: Option<RawCounters>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProbedCheck {
    pub what: String,
    pub passed: bool,
    pub found: String,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ProbedSignal {
    pub name: String,
    pub unit: &'static str,
    /// `holding`, `input`, or `stream`.
    pub table: &'static str,
    /// On the wire, from 0.
    pub address: u16,
    /// Registers as they came; null where the drive refused them.
    pub raw: Option<Vec<u16>>,
    /// In `unit`; null where there is no value.
    pub value: Option<f64>,
    /// Why there is no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<String>,
    /// Null: it cannot be judged at rest.
    pub plausible: Option<bool>,
    /// What a drive at rest may read, in `unit`.
    pub expected: Option<[f64; 2]>,
    /// A value that no empty register would read.
    pub confirms: bool,
    /// Other ways of reading it, where this one does not fit.
    pub candidates: Vec<Candidate>,
    /// Meaning for the bench, for code that needs the drive's own limits.
    #[serde(skip)]
    pub quantity: Option<crate::register_map::Quantity>,
}

/// A state of the drive by its status bits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProbedState {
    pub name: String,
    /// Null: the status word was not read.
    pub holds: Option<bool>,
}

impl ProbeReport {
    pub(super) fn of(profile: &DriveProfile) -> Self {
        Self {
            profile: profile.name.clone(),
            provenance: profile.provenance(),
            verdict: ProbeVerdict::Plausible,
            finding: ProbeFinding::NothingJudged,
            names: Vec::new(),
            answers_function_8: None,
            identity: None,
            checks: Vec::new(),
            signals: Vec::new(),
            states: Vec::new(),
            watchdog_s: None,
            hypotheses: Vec::new(),
            remarks: Vec::new(),
            is_unknown_everywhere: false,
            is_built_in: DriveProfile::named(&profile.name)
                .is_ok_and(|ours| ours.registers == profile.registers),
            counters: None,
        }
    }

    /// A plausible value of a quantity, in the unit of its signal.
    pub fn value_of(&self, quantity: crate::register_map::Quantity) -> Option<f64> {
        let is_it = |signal: &&ProbedSignal| signal.quantity == Some(quantity);
        let signal = self.signals.iter().find(is_it)?;
        signal.value.filter(|_| signal.plausible != Some(false))
    }

    pub(super) fn judge(&mut self) {
        let failed = self.checks.iter().find(|check| !check.passed);
        let holds = |name| {
            let state = self.states.iter().find(|state| state.name == name);
            state.is_some_and(|state| state.holds == Some(true))
        };
        let signals = || self.signals.iter();
        let wrong = signals().filter(|signal| signal.plausible == Some(false));
        let wrong: Vec<String> = wrong.map(|signal| signal.name.clone()).collect();
        let judged = signals().filter(|s| s.plausible.is_some()).count();
        let confirmed = signals().filter(|s| s.confirms).count();
        let (verdict, finding) = if let Some(ProbedCheck { what, found, .. }) = failed {
            let finding = ProbeFinding::OtherIdentity { check: what.clone(), found: found.clone() };
            (ProbeVerdict::WrongDrive, finding)
        } else if self.is_unknown_everywhere && self.is_built_in {
            (ProbeVerdict::WrongDrive, ProbeFinding::NoRegister)
        } else if holds("running") {
            (ProbeVerdict::Implausible, ProbeFinding::Runs)
        } else if judged == 0 {
            (ProbeVerdict::Unjudged, ProbeFinding::NothingJudged)
        } else if wrong.is_empty() {
            (ProbeVerdict::Plausible, ProbeFinding::AtRest { judged })
        } else {
            (ProbeVerdict::Implausible, ProbeFinding::NotAtRest { judged, wrong })
        };
        (self.verdict, self.finding) = (verdict, finding);
        if verdict == ProbeVerdict::Plausible && confirmed == 0 {
            self.remarks.push(
                "every one of them is about zero, and so is a register that means something else: nothing confirms addresses and word order until the shaft turns"
                    .to_owned(),
            );
        }
        if holds("fault") {
            self.remarks.push("the drive reports a fault".to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A report with these signals, as name, plausible and confirms, judged after a change.
    fn judged(
        signals: &[(&str, Option<bool>, bool)],
        running: Option<bool>,
        change: fn(&mut ProbeReport),
    ) -> ProbeReport {
        let mut report = ProbeReport::of(&DriveProfile::named("siemens-v20").unwrap());
        let signals = signals.iter().map(|(name, plausible, confirms)| ProbedSignal {
            name: (*name).to_owned(),
            plausible: *plausible,
            confirms: *confirms,
            ..ProbedSignal::default()
        });
        report.signals = signals.collect();
        report.states.push(ProbedState { name: "running".to_owned(), holds: running });
        change(&mut report);
        report.judge();
        report
    }

    type Case<'a> = (
        &'a [(&'a str, Option<bool>, bool)],
        Option<bool>,
        fn(&mut ProbeReport),
        ProbeVerdict,
        &'a str,
    );

    #[test]
    fn the_verdict_follows_from_readings_states_and_checks() {
        use ProbeVerdict::{Implausible, Plausible, Unjudged, WrongDrive};
        let none = |_: &mut ProbeReport| {};
        let unknown = |report: &mut ProbeReport| report.is_unknown_everywhere = true;
        // A new profile may have its addresses wrong.
        let unknown_new = |report: &mut ProbeReport| {
            (report.is_unknown_everywhere, report.is_built_in) = (true, false);
        };
        let failed = |report: &mut ProbeReport| {
            report.checks.push(ProbedCheck {
                what: "type code 0x0001".to_owned(),
                passed: false,
                found: "0x0007".to_owned(),
            });
        };
        let (wrong, zero) = (("bus", Some(false), false), ("speed", Some(true), false));
        let bus = ("bus", Some(true), true);
        let cases: [Case<'_>; 8] = [
            (&[wrong, zero], Some(false), none, Implausible, "readings_of_no_drive_at_rest"),
            (&[zero], Some(false), none, Plausible, "readings_of_a_drive_at_rest"),
            (&[bus], None, none, Plausible, "readings_of_a_drive_at_rest"),
            (&[("speed", None, false)], Some(false), none, Unjudged, "no_reading_can_be_judged"),
            (&[wrong], None, unknown, WrongDrive, "has_no_register_of_the_profile"),
            (&[wrong], None, unknown_new, Implausible, "readings_of_no_drive_at_rest"),
            (&[bus], Some(true), none, Implausible, "drive_reports_that_it_runs"),
            (&[bus], Some(true), failed, WrongDrive, "identity_check_failed"),
        ];
        for (signals, running, change, verdict, code) in cases {
            let report = judged(signals, running, change);
            assert_eq!((report.verdict, report.finding.code()), (verdict, code), "{report:?}");
            // Zeros alone confirm nothing.
            let warns = report.remarks.iter().any(|text| text.contains("about zero"));
            assert_eq!(warns, signals == [zero], "{:?}", report.remarks);
        }
    }
}
