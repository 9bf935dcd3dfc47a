//! Which built-in profile could the drive on this line be? Each is tried at its own baud rate, read-only.

use std::time::Duration;

use serde::Serialize;

use super::super::failure::{Failure, LINK, REFUSED, USAGE};
use super::super::output;
use super::super::reach::{self, Asking, FarEnd};
use super::super::wire::Tap;
use crate::drive::{
    DriveProfile, Framing, LinkError, ProbeDepth, ProbeReport, ProbeVerdict, Protocol, RawClient,
    RawSettings, Target, probe,
};

/// Between two openings of a port: what is under way at the old baud rate must be over, and our software drive needs a
/// moment for a fresh pseudo-terminal.
const SETTLING: Duration = Duration::from_millis(100);

/// Whether a profile may be the drive's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Fit {
    /// Its identity checks hold.
    Matches,
    /// Nothing speaks against it, and the profile has nothing by which the drive could be known.
    CannotBeTold,
    No,
    NoAnswer,
    NotTried,
}

impl Fit {
    pub(super) const fn text(self) -> &'static str {
        match self {
            Self::Matches => "matches",
            Self::CannotBeTold => "cannot be told",
            Self::No => "no",
            Self::NoAnswer => "no answer",
            Self::NotTried => "not tried",
        }
    }
}

/// One profile and what speaks for or against it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Tried {
    pub(super) profile: String,
    pub(super) fit: Fit,
    pub(super) reason: String,
}

/// All of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Survey {
    pub(super) link: String,
    /// Vendor, product and revision as the unit gives them (function code 43).
    pub(super) names: Vec<String>,
    pub(super) profiles: Vec<Tried>,
}

impl Survey {
    /// Success where a profile remains.
    pub(super) fn verdict(&self) -> Result<(), Failure> {
        let any = |fit| self.profiles.iter().any(|tried| tried.fit == fit);
        if any(Fit::Matches) || any(Fit::CannotBeTold) {
            return Ok(());
        }
        if any(Fit::No) {
            return Err(Failure::with_help(
                REFUSED,
                format!(
                    "{}: something answers, and no built-in profile fits it",
                    self.link
                ),
                "write a profile from its manual: docs/adding-a-drive.md; then probe with --drive FILE",
            ));
        }
        Err(Failure::with_help(
            LINK,
            format!(
                "{}: nothing answers with the settings of any built-in profile",
                self.link
            ),
            "check wiring and power; `drivebench doctor --port PORT --scan` tries baud rates, parities and units",
        ))
    }
}

pub(super) fn survey(port: &str, asking: &Asking, tap: &Tap) -> Result<Survey, Failure> {
    let profiles: Vec<DriveProfile> = DriveProfile::names()
        .filter_map(|name| DriveProfile::named(name).ok())
        .collect();
    let Some(first) = profiles.first().filter(|_| port != "emulator") else {
        return Err(Failure::with_help(
            USAGE,
            "--port emulator answers as the profile that is asked for",
            "name it with --drive; without --drive give a serial port or tcp:HOST:PORT",
        ));
    };
    let far_end = reach::far_end(port, first)?;
    let mut survey = Survey {
        link: far_end.target.to_string(),
        names: Vec::new(),
        profiles: Vec::new(),
    };
    // Profiles of one line are tried over one opening of the port.
    let mut lines: Vec<(RawSettings, Vec<&DriveProfile>)> = Vec::new();
    for profile in &profiles {
        if profile.link.protocol == Protocol::Stream {
            survey.profiles.push(Tried {
                profile: profile.name.clone(),
                fit: Fit::NotTried,
                reason: "its frames are no Modbus: ask for it with --drive".to_owned(),
            });
            continue;
        }
        let settings = asking.settings(profile);
        match lines.iter_mut().find(|(line, _)| *line == settings) {
            Some((_, of_line)) => of_line.push(profile),
            None => lines.push((settings, vec![profile])),
        }
    }
    for (settings, of_line) in lines {
        try_line(&far_end, &settings, &of_line, tap, &mut survey)?;
        std::thread::sleep(SETTLING);
    }
    survey.profiles.sort_by_key(|tried| match tried.fit {
        Fit::Matches => 0,
        Fit::CannotBeTold => 1,
        Fit::No => 2,
        Fit::NoAnswer => 3,
        Fit::NotTried => 4,
    });
    Ok(survey)
}

fn try_line(
    far_end: &FarEnd,
    settings: &RawSettings,
    profiles: &[&DriveProfile],
    tap: &Tap,
    survey: &mut Survey,
) -> Result<(), Failure> {
    let line = match far_end.target {
        Target::Serial { .. } => line_text(settings.baud, settings.framing, settings.unit),
        Target::Tcp { .. } => format!("unit {}", settings.unit),
    };
    output::message(&format!("asking at {line}"));
    let mut client = RawClient::open(&far_end.target, settings, tap.file())?;
    let mut is_dead = false;
    for profile in profiles {
        let tried = if is_dead {
            None
        } else {
            match probe(&mut client, profile, ProbeDepth::Readings) {
                Ok(report) => Some(fit(&report)),
                Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
                Err(_) => {
                    is_dead = !client.is_heard();
                    None
                }
            }
        };
        let (fit, reason) = tried.unwrap_or_else(|| (Fit::NoAnswer, format!("at {line}")));
        survey.profiles.push(Tried {
            profile: profile.name.clone(),
            fit,
            reason,
        });
    }
    if survey.names.is_empty() {
        survey.names = client.names()?;
    }
    Ok(())
}

fn line_text(baud: u32, framing: Framing, unit: u8) -> String {
    format!("{baud} {} unit {unit}", framing.name())
}

/// What a report says of its profile.
fn fit(report: &ProbeReport) -> (Fit, String) {
    let unread = report
        .signals
        .iter()
        .find(|signal| signal.raw.is_none() && signal.missing.is_some());
    if let Some(signal) = unread.filter(|_| report.verdict != ProbeVerdict::WrongDrive) {
        let why = signal.missing.as_deref().unwrap_or_default();
        let reason = format!(
            "{} register {} ({}): {why}",
            signal.table, signal.address, signal.name
        );
        return (Fit::No, reason);
    }
    match report.verdict {
        ProbeVerdict::WrongDrive | ProbeVerdict::Implausible => {
            // The profile's name stands in front of the line already.
            let named = report.sentence.split_once(": ");
            let reason = match named {
                Some((name, reason)) if name == report.profile => reason,
                _ => report.sentence.as_str(),
            };
            (Fit::No, reason.to_owned())
        }
        ProbeVerdict::Plausible if !report.checks.is_empty() => {
            let checks: Vec<&str> = report.checks.iter().map(|c| c.what.as_str()).collect();
            (Fit::Matches, checks.join("; "))
        }
        ProbeVerdict::Plausible => {
            let confirmed = report.signals.iter().filter(|s| s.confirms).count();
            (
                Fit::CannotBeTold,
                format!(
                    "every register answers and may be that of a drive at rest ({confirmed} with a value that an empty one would not have); the profile has no identity check"
                ),
            )
        }
    }
}
