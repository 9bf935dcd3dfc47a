//! The signals that ask for an end. While nothing is energised there is nothing to put down, so the program ends at once,
//! and tidily; work that must end in its own way asks for a flag.
//!
//! ```text
//! signal -> thread -> a file that is being written is finished -> the progress line is wiped -> exit 130
//! ```

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::failure::{Failure, INTERNAL, INTERRUPTED};
use super::progress;

/// Parts of the program that may be ended at any moment; a signal at another time is for those who asked for it.
static AT_ONCE: AtomicUsize = AtomicUsize::new(0);
static WRITING: Mutex<()> = Mutex::new(());
static WATCH: Once = Once::new();

/// Signals that ask for an end.
const ENDINGS: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];

/// Longest time that a write may take before it is left.
const LOOKS: u32 = 200;
const LOOK: Duration = Duration::from_millis(10);

/// While it lives a signal ends the program at once with status 130.
pub(super) struct Endable(());

impl Drop for Endable {
    fn drop(&mut self) {
        AT_ONCE.fetch_sub(1, Ordering::AcqRel);
    }
}

/// From here on a signal ends the program at once.
pub(super) fn endable() -> Result<Endable, Failure> {
    let mut watched = Ok(());
    WATCH.call_once(|| watched = watch());
    watched
        .map_err(|error| Failure::new(INTERNAL, format!("cannot watch for signals: {error}")))?;
    AT_ONCE.fetch_add(1, Ordering::AcqRel);
    Ok(Endable(()))
}

/// Raised by the first signal that asks for an end, for work that has to put something down first.
pub(super) fn flag() -> Result<Arc<AtomicBool>, Failure> {
    let raised = Arc::new(AtomicBool::new(false));
    for signal in ENDINGS {
        signal_hook::flag::register(signal, Arc::clone(&raised)).map_err(|error| {
            Failure::new(
                INTERNAL,
                format!("cannot watch for signal {signal}: {error}"),
            )
        })?;
    }
    Ok(raised)
}

fn watch() -> std::io::Result<()> {
    let mut signals = Signals::new(ENDINGS)?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            for _ in signals.forever() {
                if AT_ONCE.load(Ordering::Acquire) > 0 {
                    end();
                }
            }
        })?;
    Ok(())
}

fn end() -> ! {
    let mut whole = WRITING.try_lock();
    for _ in 0..LOOKS {
        if whole.is_ok() {
            break;
        }
        std::thread::sleep(LOOK);
        whole = WRITING.try_lock();
    }
    Failure::with_help(
        INTERRUPTED,
        "interrupted: there is no answer",
        "start the command again; nothing was left half done",
    )
    .print();
    // Nobody draws the line again: its lock is held to the end.
    progress::above(|| std::process::exit(i32::from(INTERRUPTED)))
}

/// Held while something is written that is of no use in part.
pub(super) fn writing() -> MutexGuard<'static, ()> {
    WRITING.lock().unwrap_or_else(PoisonError::into_inner)
}
