//! After a run that lost its drive: the rig opens its link anew, for as long as that may help.

use std::path::Path;
use std::time::Instant;

use super::output;
use super::rig::Rig;
use super::strings::Strings;
use crate::bench::{ReopenBench, ReopenOptions, Reopened, RunSummary, reopen};
use crate::drive::{Anchor, DriveLink, DriveProfile, LinkError, TapFile, Target, open_tapped};
use crate::recording::Recorder;

/// Beside the time in which the drive's own watchdog stops it, s: a plug pulled and put back.
const PATIENCE_S: f64 = 10.0;

/// How a link is opened once more.
type Open = dyn Fn(&DriveProfile, Option<&TapFile>) -> Result<Box<dyn DriveLink>, LinkError> + Send;

/// What it takes to open a link again.
pub struct Reopener {
    link: String,
    limit_s: Option<f64>,
    open: Box<Open>,
}

impl Reopener {
    /// To be made when the link has just been opened.
    pub(crate) fn of(target: &Target, epoch: Instant, limit_s: Option<f64>) -> Self {
        let anchor = Anchor::of(Path::new("/"), target);
        Self {
            link: anchor.target().to_string(),
            limit_s,
            open: Box::new(move |profile, tap| {
                if let Some(reason) = anchor.stranger(Path::new("/")) {
                    return Err(LinkError::Identity(anchor.target().to_string(), reason));
                }
                open_tapped(anchor.target(), profile, epoch, tap)
            }),
        }
    }

    /// Over a link that is opened by `open`, for at most `limit_s`; `None`: as long as seems right.
    pub fn with(
        link: &str,
        limit_s: Option<f64>,
        open: impl Fn() -> Result<Box<dyn DriveLink>, LinkError> + Send + 'static,
    ) -> Self {
        Self {
            link: link.to_owned(),
            limit_s,
            open: Box::new(move |_, _| open()),
        }
    }
}

impl Rig {
    /// Looks for the drive again, brings it to rest and says what was found; the run stays lost.
    pub(crate) fn get_back(
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
        let link = reopener.link.as_str();
        if self.headless {
            let time = limit_s.map_or_else(String::new, |limit_s| format!(" for {limit_s:.1} s"));
            output::message(&format!(
                "link lost: looking for {link} again{time}; Ctrl-C ends that"
            ));
        }
        let options = ReopenOptions {
            link,
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
            &mut || (reopener.open)(profile, tap),
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
        let blind_s = registers.map_or(0.0, |map| map.watchdog.keys.boot_delay_s);
        let blind = if blind_s > 0.0 && reopened.identity.is_some() {
            format!("; if it was switched off, its watchdog is blind for {blind_s} s")
        } else {
            String::new()
        };
        format!("{}{blind}", reopened.text)
    }
}
