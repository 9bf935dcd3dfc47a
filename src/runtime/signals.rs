//! The signals that request an end. While nothing is energised the program ends at once; work that must end in its own way
//! reads a flag, and a run on a live drive handles every one.
//!
//! ```text
//! signal -> thread -> endable? a file that is being written is finished -> the progress line is wiped -> exit 130
//!                  '-> a run: the output ramps down, the drive confirms its stop -> exit 130
//! ```

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nix::sys::signal::{SigSet, Signal};
use signal_hook::consts::{
    SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPIPE, SIGPROF, SIGQUIT, SIGTERM, SIGTSTP, SIGTTIN, SIGTTOU,
    SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};
use signal_hook::iterator::Signals;

use crate::runtime::controls::Ends;
use crate::runtime::failure::{Failure, INTERRUPTED};
use crate::runtime::output::Terminal;

/// Signals that request an end.
const ENDINGS: [i32; 7] = [SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM];
/// Signals that would end or halt the program in the middle of a run, among them a pipe that nobody reads any more.
const LIVE: [i32; 6] = [SIGPIPE, SIGTSTP, SIGVTALRM, SIGPROF, SIGXCPU, SIGIO];
/// Those of Linux alone: a supply that fails, and a fault of the stack.
#[cfg(target_os = "linux")]
const OF_SYSTEM: &[i32] = &[nix::libc::SIGPWR, nix::libc::SIGSTKFLT];
#[cfg(not(target_os = "linux"))]
const OF_SYSTEM: &[i32] = &[];

/// Whether a signal may end the program at once.
#[derive(Debug, Default)]
pub(super) struct Interrupts {
    /// Parts of the program that may be ended at any moment.
    endable: AtomicUsize,
    writing: Mutex<()>,
    is_watched: AtomicBool,
}

/// While it lives a signal ends the program at once with status 130.
pub struct Endable(Terminal);

impl Drop for Endable {
    fn drop(&mut self) {
        self.0.interrupts().endable.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Terminal {
    /// From here on a signal ends the program at once.
    pub fn endable(&self) -> Result<Endable, Failure> {
        if !self.interrupts().is_watched.swap(true, Ordering::AcqRel) {
            let terminal = self.clone();
            spawn(&ENDINGS, move |_| {
                if terminal.is_endable() {
                    terminal.end();
                }
            })?;
        }
        Ok(self.leavable())
    }

    /// From here on whoever ends the program may leave without waiting for this thread; signals are not watched.
    pub(crate) fn leavable(&self) -> Endable {
        self.interrupts().endable.fetch_add(1, Ordering::AcqRel);
        Endable(self.clone())
    }

    /// Nothing is energised, and nothing is half written.
    pub(crate) fn is_endable(&self) -> bool {
        self.interrupts().endable.load(Ordering::Acquire) > 0
    }

    /// Held while something is written that is of no use in part.
    pub fn writing(&self) -> MutexGuard<'_, ()> {
        self.interrupts().writing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self) -> ! {
        // A write that takes more than two seconds is not waited for.
        let mut waits = 200;
        let mut whole = self.interrupts().writing.try_lock();
        while whole.is_err() && waits > 0 {
            std::thread::sleep(Duration::from_millis(10));
            whole = self.interrupts().writing.try_lock();
            waits -= 1;
        }
        let help = if whole.is_ok() {
            "start the command again; nothing was left half done"
        } else {
            "start the command again; a file was still being written: see whether it is whole"
        };
        self.failure(&Failure::with_help(INTERRUPTED, "interrupted: there is no result", help));
        // The lock is held to the end, so that the progress line is not drawn again.
        let mut messages = self.messages();
        messages.wipe();
        std::process::exit(i32::from(INTERRUPTED))
    }
}

/// Raised by the first of these signals, for work that has something to finish first.
pub fn flag() -> Result<Arc<AtomicBool>, Failure> {
    let raised = Arc::new(AtomicBool::new(false));
    for signal in ENDINGS {
        register(signal, Arc::clone(&raised))?;
    }
    Ok(raised)
}

/// Ends a run on a live drive by every signal that would otherwise end, or halt, the program with its motor on.
pub(crate) fn end_run_by_signals(ends: Ends) -> Result<(), Failure> {
    // A file at its size limit is an error of the write and must not end the program; a terminal that another program has must
    // not halt it.
    for signal in [SIGXFSZ, SIGTTIN, SIGTTOU] {
        register(signal, Arc::default())?;
    }
    // This thread, and each that it begins, may write to a terminal that another program has. The kernel lets only those who
    // block its signals: a write under a mere handler would begin again for ever.
    SigSet::from_iter([Signal::SIGTTIN, Signal::SIGTTOU]).thread_block().map_err(cannot_watch)?;
    let all = [&ENDINGS[..], &LIVE, OF_SYSTEM].concat();
    spawn(&all, move |signal| match signal {
        SIGHUP | SIGPIPE => ends.hang_up(),
        _ => ends.interrupt(),
    })
}

/// A thread that handles these signals for as long as the program runs.
fn spawn(signals: &[i32], handle: impl Fn(i32) + Send + 'static) -> Result<(), Failure> {
    let mut signals = Signals::new(signals).map_err(cannot_watch)?;
    let thread = std::thread::Builder::new().name("signals".to_owned());
    let watching = thread.spawn(move || signals.forever().for_each(handle));
    watching.map(drop).map_err(cannot_watch)
}

fn register(signal: i32, flag: Arc<AtomicBool>) -> Result<(), Failure> {
    signal_hook::flag::register(signal, flag).map(drop).map_err(cannot_watch)
}

fn cannot_watch(error: impl Display) -> Failure {
    Failure::internal(format!("cannot watch for signals: {error}"))
}
