//! Report of a probe: findings and verdict.

use serde::Serialize;

use crate::link::Identity;
use crate::modbus::RawCounters;
use crate::profile::DriveProfile;
use crate::register_map::{Candidate, Hypothesis};

/// What the readings say about the profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProbeVerdict {
    /// Every reading that can be judged is one of a drive at rest.
    Plausible,
    /// At least one is not, or is refused.
    Implausible,
    /// None can be judged: nothing speaks for the profile.
    Unjudged,
    /// The drive is another one than the profile's: a check of its identity failed.
    WrongDrive,
}

/// Everything that was found.
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
    /// What our own map says of itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identity: Option<Identity>,
    /// The profile's checks of identity.
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

/// One check of a drive's identity.
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
    /// What it means to the bench; for whoever needs the drive's own limits.
    #[serde(skip)]
    pub quantity: Option<crate::register_map::Quantity>,
}

/// A state of the drive as its status bits tell it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProbedState {
    pub name: String,
    /// Null: the status word was not read.
    pub holds: Option<bool>,
}

impl ProbeReport {
    /// An empty report of this profile.
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

    /// Draws the verdict from what was found.
    pub(super) fn judge(&mut self) {
        let failed = self.checks.iter().find(|check| !check.passed);
        let holds = |name| {
            let state = self.states.iter().find(|state| state.name == name);
            state.is_some_and(|state| state.holds == Some(true))
        };
        let signals = || self.signals.iter();
        let wrong = signals().filter(|signal| signal.plausible == Some(false));
        let wrong: Vec<&str> = wrong.map(|signal| signal.name.as_str()).collect();
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

    fn signal(name: &str, plausible: Option<bool>, confirms: bool) -> ProbedSignal {
        ProbedSignal {
            name: name.to_owned(),
            plausible,
            confirms,
            ..ProbedSignal::default()
        }
    }

    fn judged(signals: Vec<ProbedSignal>, running: Option<bool>) -> ProbeReport {
        let mut report = ProbeReport::of(&DriveProfile::named("siemens-v20").unwrap());
        report.signals = signals;
        report.states.push(ProbedState {
            name: "running".to_owned(),
            holds: running,
        });
        report.judge();
        report
    }

    #[test]
    fn the_verdict_names_what_does_not_fit() {
        let report = judged(
            vec![
                signal("bus", Some(false), false),
                signal("speed", Some(true), false),
            ],
            Some(false),
        );
        assert_eq!(report.verdict, ProbeVerdict::Implausible);
        assert!(report.sentence.starts_with("1 of 2") && report.sentence.ends_with(": bus"));
    }

    #[test]
    fn zeros_alone_confirm_nothing_and_that_is_said() {
        let zeros = judged(vec![signal("speed", Some(true), false)], Some(false));
        assert_eq!(zeros.verdict, ProbeVerdict::Plausible);
        assert!(
            zeros.remarks[0].contains("about zero"),
            "{:?}",
            zeros.remarks
        );
        let bus = judged(vec![signal("bus", Some(true), true)], None);
        assert!(bus.remarks.is_empty(), "{:?}", bus.remarks);
        let nothing = judged(vec![signal("speed", None, false)], Some(false));
        assert_eq!(nothing.verdict, ProbeVerdict::Unjudged);
    }

    #[test]
    fn an_unknown_built_in_profile_is_another_drive() {
        let mut report = judged(vec![signal("bus", Some(false), false)], None);
        report.is_unknown_everywhere = true;
        report.judge();
        assert_eq!(report.verdict, ProbeVerdict::WrongDrive);
        // A profile in the making may have its addresses wrong.
        report.is_built_in = false;
        report.judge();
        assert_eq!(report.verdict, ProbeVerdict::Implausible);
    }

    #[test]
    fn a_running_drive_or_failed_check_is_no_rest() {
        let running = judged(vec![signal("bus", Some(true), true)], Some(true));
        assert_eq!(running.verdict, ProbeVerdict::Implausible);
        let mut report = judged(vec![signal("bus", Some(true), true)], Some(true));
        report.checks.push(ProbedCheck {
            what: "type code 0x0001".to_owned(),
            passed: false,
            found: "0x0007".to_owned(),
        });
        report.judge();
        assert_eq!(report.verdict, ProbeVerdict::WrongDrive);
        assert!(report.sentence.contains("0x0007"), "{}", report.sentence);
    }
}
