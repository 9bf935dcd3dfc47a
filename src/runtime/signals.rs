//! The signals that ask for an end. While nothing is energised there is nothing to put down, so the program ends at once,
//! and tidily; work that must end in its own way asks for a flag, and a run on a live drive is told of every one.
//!
//! ```text
//! signal -> thread -> work may be left? a file that is being written is finished -> the progress line is wiped -> exit 130
//!                  '-> a run: the output ramps down, the drive confirms its stop -> exit 130
//! ```

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use nix::sys::signal::{SigSet, Signal};
use signal_hook::consts::{
    SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPIPE, SIGPROF, SIGQUIT, SIGTERM, SIGTSTP, SIGTTIN, SIGTTOU,
    SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};
use signal_hook::iterator::Signals;

use crate::runtime::controls::Ends;
use crate::runtime::failure::{Failure, INTERRUPTED};
use crate::runtime::progress;

/// Parts of the program that may be ended at any moment; a signal at another time is for those who asked for it.
static AT_ONCE: AtomicUsize = AtomicUsize::new(0);
static WRITING: Mutex<()> = Mutex::new(());
static WATCH: Once = Once::new();

/// Signals that ask for an end.
const ENDINGS: [i32; 7] = [SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM];
/// What would end or halt the program in the middle of a run without a word, and a pipe that nobody reads any more.
const LIVE: [i32; 6] = [SIGPIPE, SIGTSTP, SIGVTALRM, SIGPROF, SIGXCPU, SIGIO];
/// The same where there is more of it: a supply that fails, and a fault of the stack that nothing raises any more.
#[cfg(target_os = "linux")]
const OF_SYSTEM: [i32; 2] = [nix::libc::SIGPWR, nix::libc::SIGSTKFLT];
#[cfg(not(target_os = "linux"))]
const OF_SYSTEM: [i32; 0] = [];

/// Longest time that a write may take before it is left.
const LOOKS: u32 = 200;
const LOOK: Duration = Duration::from_millis(10);

/// While it lives a signal ends the program at once with status 130.
pub struct Endable(());

impl Drop for Endable {
    fn drop(&mut self) {
        AT_ONCE.fetch_sub(1, Ordering::AcqRel);
    }
}

/// From here on a signal ends the program at once.
pub fn endable() -> Result<Endable, Failure> {
    let mut watched = Ok(());
    WATCH.call_once(|| {
        watched = spawn(&ENDINGS, |_| {
            if is_endable() {
                end();
            }
        });
    });
    watched?;
    Ok(leavable())
}

/// From here on whoever owns the end may leave without waiting for this thread. Signals are theirs.
pub(crate) fn leavable() -> Endable {
    AT_ONCE.fetch_add(1, Ordering::AcqRel);
    Endable(())
}

/// Whether the work may be left where it is: nothing is energised, and nothing is half written.
pub(crate) fn is_endable() -> bool {
    AT_ONCE.load(Ordering::Acquire) > 0
}

/// Raised by the first signal that asks for an end, for work that has to put something down first.
pub fn flag() -> Result<Arc<AtomicBool>, Failure> {
    let raised = Arc::new(AtomicBool::new(false));
    for signal in ENDINGS {
        register(signal, Arc::clone(&raised))?;
    }
    Ok(raised)
}

/// Tells a run on a live drive of every signal that would otherwise end, or halt, the program with its motor on.
pub(crate) fn pull(ends: Ends) -> Result<(), Failure> {
    // A file that may not grow any more is an error of the write and no reason to die, a terminal that somebody else has is
    // none to halt.
    for signal in [SIGXFSZ, SIGTTIN, SIGTTOU] {
        register(signal, Arc::default())?;
    }
    speak_from_background()?;
    let all = [&ENDINGS[..], &LIVE, &OF_SYSTEM].concat();
    spawn(&all, move |signal| match signal {
        SIGHUP | SIGPIPE => ends.hang_up(),
        _ => ends.interrupt(),
    })
}

/// From here on this thread, and each that it begins, may write to a terminal that another program has. The kernel lets
/// only those who block its signals: a write under a mere handler would begin again for ever.
fn speak_from_background() -> Result<(), Failure> {
    let halting = SigSet::from_iter([Signal::SIGTTIN, Signal::SIGTTOU]);
    halting.thread_block().map_err(cannot_watch)
}

/// A thread that is told of these signals for as long as the program runs.
fn spawn(signals: &[i32], told: impl Fn(i32) + Send + 'static) -> Result<(), Failure> {
    let mut signals = Signals::new(signals).map_err(cannot_watch)?;
    let thread = std::thread::Builder::new().name("signals".to_owned());
    let watching = thread.spawn(move || signals.forever().for_each(told));
    watching.map(drop).map_err(cannot_watch)
}

fn register(signal: i32, flag: Arc<AtomicBool>) -> Result<(), Failure> {
    let registered = signal_hook::flag::register(signal, flag);
    registered.map(drop).map_err(cannot_watch)
}

fn cannot_watch(error: impl Display) -> Failure {
    Failure::internal(format!("cannot watch for signals: {error}"))
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
    let help = if whole.is_ok() {
        "start the command again; nothing was left half done"
    } else {
        "start the command again; a file was still being written: see whether it is whole"
    };
    Failure::with_help(INTERRUPTED, "interrupted: there is no answer", help).print();
    // Nobody draws the line again: its lock is held to the end.
    progress::above(|| std::process::exit(i32::from(INTERRUPTED)))
}

/// Held while something is written that is of no use in part.
pub fn writing() -> MutexGuard<'static, ()> {
    WRITING.lock().unwrap_or_else(PoisonError::into_inner)
}
