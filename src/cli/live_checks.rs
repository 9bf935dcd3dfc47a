//! The checks before the first energising, as the command line allows them.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use clap::Args;

use super::failure::{Failure, INTERRUPTED, LINK, USAGE};
use super::live::{Rig, Strings};
use super::output;
use crate::bench::{CheckOptions, CheckReport, FirstMove, RATE_CHECK, Waivers, check};

/// Checks that may be gone without, each by its own word. What is waived stands in the manifest, the log and the messages.
#[derive(Args, Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "the words of the command line")]
pub(super) struct Waive {
    /// Go on although the drive's watchdog is not proven: if this computer or the cable fails, perhaps nothing stops the
    /// motor; the waiver is recorded
    #[arg(long)]
    waive_watchdog: bool,
    /// Make no pulse before the first run: directions and nameplate stay unproven; the waiver is recorded
    #[arg(long)]
    waive_direction: bool,
    /// Go on although the pulse does not fit the nameplate; the waiver is recorded
    #[arg(long)]
    waive_plausibility: bool,
}

impl Waive {
    pub(super) const fn waivers(self) -> Waivers {
        Waivers {
            watchdog: self.waive_watchdog,
            direction: self.waive_direction,
            plausibility: self.waive_plausibility,
        }
    }
}

/// What the user has allowed on the command line.
pub(super) struct Consent {
    /// Real hardware may be there.
    pub(super) hardware: bool,
    /// Real hardware may move, in so many words.
    pub(super) hardware_said: bool,
    pub(super) waivers: Waivers,
    /// Once: taken back when it has been done.
    pub(super) reset_fault: bool,
}

impl Rig {
    /// Identity, limits, link probe, watchdog proof, direction pulse; the refusal is the first check that failed.
    pub(super) fn check(&mut self, strings: &Strings) -> Result<CheckReport, Failure> {
        if self.escalates && self.bench.load.vertical {
            return Err(Failure::with_help(
                USAGE,
                "the small steps that find an unknown motor would let a vertical load fall",
                "give the motor's data in [motor], or take the load off",
            ));
        }
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
        )?;
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
        if self.is_headless() {
            for name in &report.waived {
                output::message(&format!("waived: {name}"));
            }
        }
        self.last_seq = report.last_seq;
        self.check = Some(report.clone());
        Ok(report)
    }
}
