//! The one clock of a run; everything else takes the time as an argument.

use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use drivebench_emulator::VirtualClock;

/// A difference of the two clocks above this is a suspension, s.
pub(super) const SUSPENDED_S: f64 = 0.1;

/// Host time since the begin of the run, and waiting for an instant of it.
pub trait Clock: Send {
    fn now_s(&self) -> f64;

    /// Returns at `until_s`, or at once if it has passed.
    fn sleep_until_s(&mut self, until_s: f64);

    /// Time in suspension since the start of this clock, s, which `now_s` does not count.
    fn slept_s(&self) -> f64 {
        0.0
    }

    /// Whether time passes by itself; a virtual clock advances only by waiting.
    fn is_real(&self) -> bool;
}

/// `CLOCK_MONOTONIC`: steps of the wall clock do not move it.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin: Instant,
    /// Time in suspension before the start, s.
    slept_before_s: f64,
}

impl MonotonicClock {
    #[expect(clippy::disallowed_methods, reason = "this file owns the clock of a bench run")]
    pub fn start() -> Self {
        Self {
            origin: Instant::now(),
            // The largest is the most accurate.
            slept_before_s: suspended_s().max(suspended_s()).max(suspended_s()).max(0.0),
        }
    }

    /// The instant of its zero, so that a link can stamp in the same time.
    pub const fn origin(&self) -> Instant {
        self.origin
    }
}

impl Clock for MonotonicClock {
    fn now_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        let remaining_s = until_s - self.now_s();
        if remaining_s > 0.0 {
            std::thread::sleep(Duration::from_secs_f64(remaining_s));
        }
    }

    fn slept_s(&self) -> f64 {
        suspended_s() - self.slept_before_s
    }

    fn is_real(&self) -> bool {
        true
    }
}

/// Time in suspension since boot, s: `CLOCK_BOOTTIME` counts it and `CLOCK_MONOTONIC` does not. A delay between the two readings
/// makes it smaller, never larger.
fn suspended_s() -> f64 {
    let seconds = |id| {
        let time = clock_gettime(id);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    };
    seconds(ClockId::Boottime) - seconds(ClockId::Monotonic)
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
    fn virtual_time_only_advances_and_leaves_suspension_out() {
        let mut clock = VirtualClock::default();
        clock.sleep_until_s(2.0);
        clock.sleep_until_s(1.0);
        clock.suspend_s(30.0);
        assert!((clock.now_s() - 2.0).abs() < 1e-9 && (clock.time_s() - 32.0).abs() < 1e-9);
        assert!((Clock::slept_s(&clock) - 30.0).abs() < 1e-9);
        clock.sleep_until_s(3.0);
        assert!((clock.time_s() - 33.0).abs() < 1e-9);
    }

    #[test]
    fn a_wait_does_not_end_early_and_is_no_suspension() {
        let mut clock = MonotonicClock::start();
        let until_s = clock.now_s() + 0.002;
        clock.sleep_until_s(until_s);
        assert!(clock.now_s() >= until_s);
        assert!(clock.slept_s() < 0.01, "{}", clock.slept_s());
    }
}
