//! Waiting of a Modbus link: in real time for a port, in virtual time by setting the clock forward.
//!
//! ```text
//! Waiting::until(instant, future) --real--> runtime: port and timer
//!                                 '-virtual-> poll, jump to the next arrival or to the instant, poll again
//! ```
//!
//! Virtual time belongs to a thread: it does not advance during computations, and every clock of this crate reads it.

use std::cell::Cell;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::time::Instant;

use tokio::runtime::Runtime;

thread_local! {
    static NOW: Cell<Option<Instant>> = const { Cell::new(None) };
    /// When the line brings something next, as far as its port has announced it.
    static NEXT: Cell<Option<Instant>> = const { Cell::new(None) };
}

/// The time of this thread.
#[expect(clippy::disallowed_methods, reason = "this file owns the clock of the line")]
pub(super) fn now() -> Instant {
    NOW.get().unwrap_or_else(Instant::now)
}

/// On a thread in virtual time: sets it forward.
pub(super) fn skip_to(at: Instant) -> bool {
    let Some(now) = NOW.get() else { return false };
    NOW.set(Some(now.max(at)));
    #[cfg(test)]
    alarm::ring(now.max(at));
    true
}

/// The line has nothing now, and something at this instant.
pub(super) fn expect_at(at: Option<Instant>) {
    NEXT.set(at);
}

/// As long as it lives the time of this thread is virtual.
pub(super) struct InVirtualTime {
    before: Option<Instant>,
}

impl InVirtualTime {
    pub(super) fn at(now: Instant) -> Self {
        Self { before: NOW.replace(Some(now)) }
    }
}

impl Drop for InVirtualTime {
    fn drop(&mut self) {
        NOW.set(self.before);
    }
}

pub(super) enum Waiting {
    Real(Runtime),
    Virtual,
}

/// Marks a future that is to be polled again.
struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Release);
    }
}

impl Waiting {
    /// Waits for the future, but not beyond this instant: `None`.
    pub(super) fn until<F: Future>(&self, at: Instant, future: F) -> Option<F::Output> {
        match self {
            Self::Real(runtime) => {
                runtime.block_on(async { tokio::time::timeout_at(at.into(), future).await.ok() })
            }
            Self::Virtual => jump(at, future),
        }
    }

    /// Carries out what needs no time.
    pub(super) fn at_once<F: Future>(&self, future: F) -> Option<F::Output> {
        match self {
            Self::Real(runtime) => Some(runtime.block_on(future)),
            Self::Virtual => jump(now(), future),
        }
    }
}

fn jump<F: Future>(until: Instant, future: F) -> Option<F::Output> {
    let woken = Arc::new(Woken(AtomicBool::new(false)));
    let waker = Waker::from(Arc::clone(&woken));
    let mut context = Context::from_waker(&waker);
    let mut future = pin!(future);
    loop {
        NEXT.set(None);
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return Some(output);
        }
        if woken.0.swap(false, Ordering::AcqRel) {
            continue;
        }
        match NEXT.get() {
            Some(next) if next <= until => drop(skip_to(next)),
            _ => {
                skip_to(until);
                return None;
            }
        }
    }
}

/// A flag that is raised at an instant of virtual time, for tests of an interruption.
#[cfg(test)]
pub(super) mod alarm {
    use std::cell::RefCell;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Instant;

    thread_local! {
        static SET: RefCell<Vec<(Instant, Arc<AtomicBool>)>> = const { RefCell::new(Vec::new()) };
    }

    pub(crate) fn set(at: Instant, flag: Arc<AtomicBool>) {
        SET.with_borrow_mut(|set| set.push((at, flag)));
    }

    pub(super) fn ring(now: Instant) {
        SET.with_borrow_mut(|set| {
            set.retain(|(at, flag)| {
                let is_due = *at <= now;
                if is_due {
                    flag.store(true, Ordering::Release);
                }
                !is_due
            });
        });
    }
}
