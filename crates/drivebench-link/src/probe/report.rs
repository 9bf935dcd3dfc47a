//! Report of a probe: findings and verdict.

use serde::Serialize;

use crate::link::Identity;
use crate::modbus::RawCounters;
use crate::profile::DriveProfile;
use crate::register_map::{Candidate, Hypothesis};

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

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProbeReport {
    pub profile: String,
    /// Which drive the profile is of, how far it may be believed, and its source.
    pub provenance: String,
    pub verdict: ProbeVerdict,
    pub sentence: String,
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
            sentence: String::new(),
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
        let wrong: Vec<&str> = signals()
            .filter(|signal| signal.plausible == Some(false))
            .map(|signal| signal.name.as_str())
            .collect();
        let judged = signals().filter(|s| s.plausible.is_some()).count();
        let confirmed = signals().filter(|s| s.confirms).count();
        let profile = &self.profile;
        let (verdict, sentence) = if let Some(ProbedCheck { what, found, .. }) = failed {
            let sentence = format!("{profile}: {what} (found {found})");
            (ProbeVerdict::WrongDrive, sentence)
        } else if self.is_unknown_everywhere && self.is_built_in {
            let sentence =
                format!("{profile}: the drive has none of the registers of this built-in profile");
            (ProbeVerdict::WrongDrive, sentence)
        } else if holds("running") {
            let sentence = "the drive reports that it runs, so its readings cannot be judged at rest; or its status word is read wrongly";
            (ProbeVerdict::Implausible, sentence.to_owned())
        } else if judged == 0 {
            let sentence = "no reading can be judged, so nothing shows that the profile fits";
            (ProbeVerdict::Unjudged, sentence.to_owned())
        } else if wrong.is_empty() {
            let sentence = format!(
                "{judged} of {judged} readings that can be judged are those of a drive at rest"
            );
            (ProbeVerdict::Plausible, sentence)
        } else {
            let sentence = format!(
                "{} of {judged} readings that can be judged are not those of a drive at rest: {}",
                wrong.len(),
                wrong.join(", ")
            );
            (ProbeVerdict::Implausible, sentence)
        };
        (self.verdict, self.sentence) = (verdict, sentence);
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
            (&[wrong, zero], Some(false), none, Implausible, "1 of 2"),
            (&[zero], Some(false), none, Plausible, "1 of 1"),
            (&[bus], None, none, Plausible, "1 of 1"),
            (&[("speed", None, false)], Some(false), none, Unjudged, "no reading"),
            (&[wrong], None, unknown, WrongDrive, "has none of the registers"),
            (&[wrong], None, unknown_new, Implausible, "1 of 1"),
            (&[bus], Some(true), none, Implausible, "reports that it runs"),
            (&[bus], Some(true), failed, WrongDrive, "0x0007"),
        ];
        for (signals, running, change, verdict, part) in cases {
            let report = judged(signals, running, change);
            assert_eq!(report.verdict, verdict, "{}", report.sentence);
            assert!(report.sentence.contains(part), "{}", report.sentence);
            // Zeros alone confirm nothing.
            let warns = report.remarks.iter().any(|text| text.contains("about zero"));
            assert_eq!(warns, signals == [zero], "{:?}", report.remarks);
        }
    }
}
