//! The one clock of a run. Everything else is given the time.

use std::time::{Duration, Instant};

use crate::emulator::VirtualClock;

/// Host time since the begin of the run, and waiting for an instant of it.
pub trait Clock: Send {
    fn now_s(&self) -> f64;

    /// Returns at `until_s`, or at once if it has passed.
    fn sleep_until_s(&mut self, until_s: f64);

    /// Whether time passes by itself. A virtual clock stands while the program computes.
    fn is_real(&self) -> bool;
}

/// `CLOCK_MONOTONIC`: steps of the wall clock do not move it.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin: Instant,
}

impl MonotonicClock {
    #[expect(
        clippy::disallowed_methods,
        reason = "this file owns the clock of a bench run"
    )]
    pub fn start() -> Self {
        Self {
            origin: Instant::now(),
        }
    }
}

impl MonotonicClock {
    /// The instant that its zero stands for, so that a link can stamp in the same time.
    pub const fn origin(&self) -> Instant {
        self.origin
    }
}

impl Clock for MonotonicClock {
    fn now_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        let left_s = until_s - self.now_s();
        if left_s > 0.0 {
            std::thread::sleep(Duration::from_secs_f64(left_s));
        }
    }

    fn is_real(&self) -> bool {
        true
    }
}

/// Virtual time advances only by waiting: a run takes no time and is the same each time.
impl Clock for VirtualClock {
    fn now_s(&self) -> f64 {
        self.time_s()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        self.set_time_s(self.time_s().max(until_s));
    }

    fn is_real(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_only_goes_forward() {
        let mut clock = VirtualClock::default();
        clock.sleep_until_s(2.0);
        clock.sleep_until_s(1.0);
        assert!((clock.now_s() - 2.0).abs() < f64::EPSILON);
    }

    #[test]
    fn waiting_never_ends_early() {
        let mut clock = MonotonicClock::start();
        let until_s = clock.now_s() + 0.002;
        clock.sleep_until_s(until_s);
        assert!(clock.now_s() >= until_s);
    }
}
