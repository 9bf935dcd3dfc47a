//! What the readings of a drive show of its profile.

use drivebench_link::{ProbeFinding, ProbeReport};

pub fn probe(report: &ProbeReport) -> String {
    let text = after_name(report);
    match report.finding {
        ProbeFinding::OtherIdentity { .. } | ProbeFinding::NoRegister => {
            format!("{}: {text}", report.profile)
        }
        _ => text,
    }
}

/// The same without the name of the profile.
pub fn after_name(report: &ProbeReport) -> String {
    match &report.finding {
        ProbeFinding::OtherIdentity { check, found } => format!("{check} (found {found})"),
        ProbeFinding::NoRegister => {
            "the drive has none of the registers of this built-in profile".to_owned()
        }
        ProbeFinding::Runs => {
            "the drive reports that it runs, so its readings cannot be judged at rest; or its status word is read wrongly"
                .to_owned()
        }
        ProbeFinding::NothingJudged => {
            "no reading can be judged, so nothing shows that the profile fits".to_owned()
        }
        ProbeFinding::AtRest { judged } => {
            format!("{judged} of {judged} readings that can be judged are those of a drive at rest")
        }
        ProbeFinding::NotAtRest { judged, wrong } => format!(
            "{} of {judged} readings that can be judged are not those of a drive at rest: {}",
            wrong.len(),
            wrong.join(", ")
        ),
    }
}
