//! A run that has been recorded: its result file, and what ended it early.

use serde::Serialize;

use super::failure::{Failure, INTERNAL, INTERRUPTED, LINK, TRIP};
use super::output;
use crate::bench::{OnlineResult, Outcome, RunSummary};
use crate::drive::Capture;
use crate::recording::{RunFile, RunFolder, write_run};

/// A run that was recorded, to its end or not.
pub(super) struct Recorded {
    pub(super) folder: RunFolder,
    pub(super) summary: RunSummary,
    /// What the on-line estimators said at the end; `replay` compares itself with it.
    pub(super) online: OnlineResult,
}

/// `result.json`: what a command has to say, and what the live estimators said.
#[derive(Serialize)]
struct KeptResult<'a, T> {
    #[serde(flatten)]
    result: &'a T,
    online: &'a OnlineResult,
}

impl Recorded {
    /// Writes `result.json`.
    pub(super) fn write_result<T: Serialize>(&self, result: &T) -> Result<(), Failure> {
        let kept = KeptResult {
            result,
            online: &self.online,
        };
        let text = serde_json::to_string_pretty(&kept).map_err(|error| {
            Failure::new(INTERNAL, format!("the result has no JSON form: {error}"))
        })?;
        self.folder.write(RunFile::Result, &text)?;
        Ok(())
    }

    /// The failure that ended the run early, if any.
    pub(super) fn failure(&self) -> Option<Failure> {
        let mut kept = format!("the record is kept in {}", self.folder.path().display());
        if let Some(reopened) = &self.summary.reopened {
            kept = format!("{}; {kept}", reopened.text);
        }
        match &self.summary.outcome {
            Outcome::Done => self.summary.stop_error.as_ref().map(|error| {
                Failure::with_help(
                    LINK,
                    format!("the last stop did not reach the drive: {error}"),
                    kept,
                )
            }),
            Outcome::Stopped | Outcome::Interrupted => Some(Failure::with_help(
                INTERRUPTED,
                "stopped before the end of the sequence",
                kept,
            )),
            Outcome::Tripped(trip) => Some(Failure::with_help(
                TRIP,
                format!("safety trip: {}", trip.reason),
                kept,
            )),
            Outcome::NotStarted { reason } => Some(Failure::with_help(
                LINK,
                format!("not started: {reason}"),
                kept,
            )),
            Outcome::LinkLost { reason } => Some(Failure::with_help(
                LINK,
                format!("link lost: {reason}"),
                kept,
            )),
        }
    }
}

/// Keeps what the drive recorded in a burst beside the samples, as a run that every command takes.
pub(super) fn keep_capture(
    folder: &RunFolder,
    name: &str,
    capture: &Capture,
) -> Result<(), Failure> {
    let run = capture
        .run(name)
        .map_err(|error| Failure::new(LINK, format!("burst capture: {error}")))?;
    let path = folder.write_capture(&write_run(&run))?;
    output::message(&format!(
        "burst capture: {} samples at {:.0} Hz in {}",
        run.rows(),
        1.0 / capture.period_s,
        path.display()
    ));
    Ok(())
}
