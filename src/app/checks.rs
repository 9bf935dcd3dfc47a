//! The checks before the first energising, as the command line allows them.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::failure::{Failure, INTERRUPTED, LINK, USAGE};
use super::rig::Rig;
use super::strings::Strings;
use crate::bench::{CheckOptions, CheckReport, FirstMove, RATE_CHECK, Waivers, check};

/// What the user has allowed on the command line.
pub(crate) struct Consent {
    /// Real hardware may be there.
    pub(crate) hardware: bool,
    /// Real hardware may move, in so many words.
    pub(crate) hardware_said: bool,
    pub(crate) waivers: Waivers,
    /// Once: taken back when it has been done.
    pub(crate) reset_fault: bool,
}

impl Rig {
    /// Identity, limits, link probe, watchdog proof, direction pulse; the refusal is the first check that failed.
    pub(crate) fn check(&mut self, strings: &Strings) -> Result<CheckReport, Failure> {
        if self.escalates && self.bench.load.vertical {
            return Err(Failure::with_help(
                USAGE,
                "the small steps that find an unknown motor would let a vertical load fall",
                "give the motor's data in [motor], or take the load off",
            ));
        }
        self.energises(strings, 0.0);
        let plate = self.bench.nameplate().filter(|_| !self.escalates);
        let interrupted = Arc::clone(&strings.interrupted);
        let requested = Arc::clone(&strings.stop_requested);
        let stopped =
            move || interrupted.load(Ordering::Acquire) || requested.load(Ordering::Acquire);
        let first_move = plate.as_ref().map(|plate| FirstMove {
            plate,
            profile: &self.profile,
            stopped: &stopped,
        });
        let options = CheckOptions {
            rate_hz: self.bench.link.rate_hz,
            hardware_allowed: self.consent.hardware,
            hardware_said: self.consent.hardware_said,
            waivers: self.consent.waivers,
            first_move,
            reset_fault: std::mem::take(&mut self.consent.reset_fault),
        };
        let report = check(
            self.link.as_mut(),
            self.clock.as_mut(),
            &self.bench.limits(),
            options,
        );
        self.rests();
        let report = report?;
        if strings.is_stopped() {
            return Err(Failure::new(
                INTERRUPTED,
                "interrupted in the checks; nothing is energised",
            ));
        }
        if let Some(item) = report.refusal() {
            let headline = format!("{}: {}", item.name, item.text);
            // Too much was asked, by arithmetic; what the link reaches is measured.
            let status = if item.name == RATE_CHECK { USAGE } else { LINK };
            return Err(match item.help {
                Some(help) => Failure::with_help(status, headline, help),
                None => Failure::new(status, headline),
            });
        }
        self.last_seq = report.last_seq;
        self.check = Some(report.clone());
        Ok(report)
    }
}
