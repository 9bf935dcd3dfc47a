//! The live screen on this thread, the work on another.

use std::io::Write as _;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::thread;
use std::time::Duration;

use super::failure::{Failure, INTERNAL, INTERRUPTED};
use super::interrupt;
use super::live::Strings;
use crate::bench::Intent;
use crate::tui::{Exit, ShowOptions, WorkerCell, show};
use crate::workflow::ProgressCell;

/// How long a worker that was left by force is given, in looks of 100 ms.
const LAST_LOOKS: u32 = 50;

/// Does the work while the screen shows it; returns when the screen is left and the work is over, with how it was left.
pub(super) fn watch<T: Send + 'static>(
    strings: Strings,
    intents: Sender<Intent>,
    progress: Option<ProgressCell>,
    work: impl FnOnce(&Strings) -> Result<T, Failure> + Send + 'static,
) -> Result<(T, Exit), Failure> {
    let hang_up = interrupt::flag()?;
    let worker = WorkerCell::default();
    let options = ShowOptions {
        snapshots: strings.snapshots.clone(),
        workflow: progress,
        intents,
        worker: worker.clone(),
        stop_requested: Arc::clone(&strings.stop_requested),
        hang_up,
    };
    let thread = thread::Builder::new()
        .name("bench".to_owned())
        .spawn(move || {
            let _finish = worker.finish_on_drop();
            work(&strings)
        })
        .map_err(|error| Failure::new(INTERNAL, format!("cannot start a thread: {error}")))?;
    let shown = show(&options);
    if let Err(error) = &shown {
        // The worker has been told to stop; its result is worth more than this.
        let _ = writeln!(std::io::stderr(), "the screen has failed: {error}");
    }
    if matches!(shown, Ok(Exit::Forced)) {
        for _ in 0..LAST_LOOKS {
            if thread.is_finished() {
                break;
            }
            thread::sleep(Duration::from_millis(100));
        }
        if !thread.is_finished() {
            return Err(Failure::with_help(
                INTERRUPTED,
                "left by force: the bench did not confirm that it has stopped",
                "see that the motor stands still; the drive's watchdog stops it",
            ));
        }
    }
    let done = thread.join().map_err(|_| {
        Failure::new(
            INTERNAL,
            "the bench has panicked; the drive was told to stop",
        )
    })?;
    Ok((done?, shown.unwrap_or(Exit::Finished)))
}
