//! After a run that lost its drive: the rig opens its link anew, for as long as that may help.

use std::path::Path;
use std::time::Instant;

use super::live::{Rig, Strings};
use super::output;
use crate::bench::{ReopenBench, ReopenOptions, Reopened, RunSummary, reopen};
use crate::drive::{Anchor, Target, open_tapped};
use crate::recording::Recorder;

/// Beside the time in which the drive's own watchdog stops it, s: a plug pulled and put back.
const PATIENCE_S: f64 = 10.0;
/// Longest time that may be asked for, s: a day.
const MOST_S: f64 = 86_400.0;

/// What it takes to open a link again.
pub(super) struct Reopener {
    anchor: Anchor,
    epoch: Instant,
    limit_s: Option<f64>,
}

impl Reopener {
    /// To be made when the link has just been opened.
    pub(super) fn of(target: &Target, epoch: Instant, limit_s: Option<f64>) -> Self {
        Self {
            anchor: Anchor::of(Path::new("/"), target),
            epoch,
            limit_s,
        }
    }
}

/// The time of `--reopen-s`.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| "expected a number of seconds".to_owned())?;
    if (0.0..=MOST_S).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(format!("allowed: 0 (off) to {MOST_S} s"))
    }
}

impl Rig {
    /// Looks for the drive again, brings it to rest and says what was found; the run stays lost.
    pub(super) fn get_back(
        &mut self,
        summary: &mut RunSummary,
        recorder: &mut Recorder,
        strings: &Strings,
    ) {
        let (Some(reopener), Some(check)) = (&self.reopener, &self.check) else {
            return;
        };
        // Beside a screen somebody sits who ends it.
        let default_s = self
            .headless
            .then(|| check.identity.watchdog_s.unwrap_or(0.0) + PATIENCE_S);
        let limit_s = reopener.limit_s.or(default_s);
        if limit_s == Some(0.0) {
            return;
        }
        self.link.close();
        let link = reopener.anchor.target().to_string();
        if self.headless {
            let time = limit_s.map_or_else(String::new, |limit_s| format!(" for {limit_s:.1} s"));
            output::message(&format!(
                "link lost: looking for {link} again{time}; Ctrl-C ends that"
            ));
        }
        let options = ReopenOptions {
            link: &link,
            before: &check.identity,
            end: summary.end,
            seq: self.last_seq,
            limit_s,
            seed: std::process::id().into(),
        };
        let (profile, tap) = (&self.profile, self.tap.file());
        let (reopened, link) = reopen(
            ReopenBench {
                clock: self.clock.as_mut(),
                recorder,
                interrupted: &strings.interrupted,
                intents: strings.intents(),
                snapshots: &strings.snapshots,
            },
            &options,
            &mut || {
                if let Some(reason) = reopener.anchor.stranger(Path::new("/")) {
                    return Err(crate::drive::LinkError::Identity {
                        link: reopener.anchor.target().to_string(),
                        reason,
                    });
                }
                open_tapped(reopener.anchor.target(), profile, reopener.epoch, tap)
            },
        );
        if let Some(link) = link {
            self.link = link;
            self.last_seq += 1;
        }
        if self.headless {
            output::message(&self.told(&reopened));
        }
        summary.reopened = Some(reopened);
    }

    /// What was found, with what the profile says of a drive that has just been switched on.
    fn told(&self, reopened: &Reopened) -> String {
        let registers = self.profile.registers.as_ref();
        let blind_s = registers.map_or(0.0, |map| map.watchdog.boot_delay_s);
        let blind = if blind_s > 0.0 && reopened.identity.is_some() {
            format!("; if it was switched off, its watchdog is blind for {blind_s} s")
        } else {
            String::new()
        };
        format!("{}{blind}", reopened.text)
    }
}
