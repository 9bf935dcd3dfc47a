//! The one clock of a run. Everything else is given the time.

use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use drivebench_emulator::VirtualClock;

/// A computer that was suspended was so for longer, and readings of its two clocks do not differ by as much, s.
pub(super) const SUSPENDED_S: f64 = 0.1;

/// Host time since the begin of the run, and waiting for an instant of it.
pub trait Clock: Send {
    fn now_s(&self) -> f64;

    /// Returns at `until_s`, or at once if it has passed.
    fn sleep_until_s(&mut self, until_s: f64);

    /// For how long the computer was suspended since this clock was started, s: time that `now_s` does not count.
    fn slept_s(&self) -> f64 {
        0.0
    }

    /// Whether time passes by itself. A virtual clock stands while the program computes.
    fn is_real(&self) -> bool;
}

/// `CLOCK_MONOTONIC`: steps of the wall clock do not move it.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin: Instant,
    /// What the computer had been suspended for when it was started, s.
    slept_before_s: f64,
}

impl MonotonicClock {
    #[expect(clippy::disallowed_methods, reason = "this file owns the clock of a bench run")]
    pub fn start() -> Self {
        Self {
            origin: Instant::now(),
            // The largest is the truest.
            slept_before_s: suspended_s().max(suspended_s()).max(suspended_s()).max(0.0),
        }
    }

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

    fn slept_s(&self) -> f64 {
        suspended_s() - self.slept_before_s
    }

    fn is_real(&self) -> bool {
        true
    }
}

/// For how long the computer was suspended since it was switched on, s: what `CLOCK_BOOTTIME` counts and
/// `CLOCK_MONOTONIC` does not. Never too much: whatever holds the program up between the two readings makes it less.
fn suspended_s() -> f64 {
    let seconds = |id| {
        let time = clock_gettime(id);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    };
    let since_boot_s = seconds(ClockId::Boottime);
    since_boot_s - seconds(ClockId::Monotonic)
}

/// Virtual time advances only by waiting: a run takes no time and is the same each time.
impl Clock for VirtualClock {
    fn now_s(&self) -> f64 {
        self.time_s() - self.slept_s()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        self.set_time_s(self.time_s().max(until_s + self.slept_s()));
    }

    fn slept_s(&self) -> f64 {
        Self::slept_s(self)
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
    fn a_suspended_computer_counts_no_time_but_knows_of_it() {
        let mut clock = VirtualClock::default();
        clock.sleep_until_s(2.0);
        clock.suspend_s(30.0);
        assert!((clock.now_s() - 2.0).abs() < 1e-9 && (clock.time_s() - 32.0).abs() < 1e-9);
        assert!((Clock::slept_s(&clock) - 30.0).abs() < 1e-9);
        clock.sleep_until_s(3.0);
        assert!((clock.time_s() - 33.0).abs() < 1e-9);
        // Nobody closes the lid of this one.
        let real = MonotonicClock::start();
        assert!(real.slept_s() < 0.01, "{}", real.slept_s());
    }

    #[test]
    fn waiting_never_ends_early() {
        let mut clock = MonotonicClock::start();
        let until_s = clock.now_s() + 0.002;
        clock.sleep_until_s(until_s);
        assert!(clock.now_s() >= until_s);
    }
}
