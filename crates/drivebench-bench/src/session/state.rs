//! State of a session, of its drive and of a load's brake.

use super::{Outcome, Phase};
use crate::guard::Causes;
use crate::mechanics::Brake;
use drivebench_link::CommandTimes;
use drivebench_model::sample::{DriveState, Sample};

pub(super) enum State {
    /// Since the first cycle, s.
    Connecting(Option<f64>),
    Safe,
    Armed,
    /// The program runs since then, s.
    Running(f64),
    RampDown {
        since_s: f64,
        ending: Outcome,
    },
    Stopping {
        since_s: f64,
        /// When the last stop went out, s; `None`: none has, and the drive's state confirms none.
        requested_s: Option<f64>,
        ending: Outcome,
    },
    Over {
        phase: Phase,
        /// The drive reported that its output is off, or took the stop where it reports nothing.
        is_confirmed: bool,
        ending: Outcome,
    },
}

impl State {
    pub(super) const fn phase(&self) -> Phase {
        match self {
            Self::Connecting(_) => Phase::Connecting,
            Self::Safe => Phase::Safe,
            Self::Armed => Phase::Armed,
            Self::Running(_) => Phase::Running,
            Self::RampDown { .. } => Phase::RampDown,
            Self::Stopping { .. } => Phase::Stopping,
            Self::Over { phase, .. } => *phase,
        }
    }

    pub(super) const fn ending(&self) -> Option<&Outcome> {
        match self {
            Self::RampDown { ending, .. }
            | Self::Stopping { ending, .. }
            | Self::Over { ending, .. } => Some(ending),
            Self::Connecting(_) | Self::Safe | Self::Armed | Self::Running(_) => None,
        }
    }

    /// Whether the stop is confirmed; `None`: not over yet.
    pub(super) const fn confirmed(&self) -> Option<bool> {
        match self {
            Self::Over { is_confirmed, .. } => Some(*is_confirmed),
            _ => None,
        }
    }
}

/// The drive's own stop where commands no longer arrive.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Watchdog {
    Unknown,
    /// After this time without a command, s.
    After(f64),
    Waived,
}

pub(super) struct Drive {
    /// It reports whether its output is off.
    pub(super) reports_stop: bool,
    /// Longest wait for its report that it has stopped, s.
    pub(super) stop_time_s: f64,
    pub(super) watchdog: Watchdog,
    pub(super) sample: Option<Sample>,
    /// When the last sample came, and the last reply of any kind, s.
    pub(super) sampled_s: f64,
    pub(super) replied_s: f64,
    /// It reported that it runs, or does not report whether it does.
    pub(super) has_run: bool,
}

impl Default for Drive {
    fn default() -> Self {
        Self {
            reports_stop: true,
            stop_time_s: CommandTimes::default().stop_s,
            watchdog: Watchdog::Unknown,
            sample: None,
            sampled_s: 0.0,
            replied_s: 0.0,
            has_run: false,
        }
    }
}

impl Drive {
    pub(super) fn watchdog_s(&self) -> Option<f64> {
        match self.watchdog {
            Watchdog::After(time_s) if time_s > 0.0 => Some(time_s),
            _ => None,
        }
    }

    pub(super) fn state(&self) -> Option<DriveState> {
        self.sample.as_ref().and_then(|sample| sample.state)
    }

    /// Whether the stop that began at `since_s` is repeated in this cycle: always while samples arrive, which confirm it.
    pub(super) fn repeats_stop(&self, now_s: f64, since_s: f64, requested_s: Option<f64>) -> bool {
        // Without a sample, in every cycle for the time of the watchdog, then once in 1.5 of that time: each request may reset the
        // watchdog, so that the pauses are longer.
        let repeat_s = self.watchdog_s().unwrap_or(1.0);
        now_s - since_s.max(self.sampled_s) <= repeat_s
            || requested_s.is_none_or(|last_s| now_s - last_s >= 1.5 * repeat_s)
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum BrakeMotion {
    Release,
    Apply,
}

/// The order of a brake that holds a load: torque, then release; rest, then the brake, then the output off.
///
/// The drive, or a relay on its "running" output, operates the brake; the session keeps order and times: it holds the load
/// by torque while the brake opens, and again until it has closed. After a trip the drive's own stop acts, with its brake.
pub(super) struct BrakeOrder {
    pub(super) brake: Brake,
    /// The present motion, and its begin, s.
    pub(super) motion: Option<(BrakeMotion, f64)>,
}

/// Why the demands differ from the wanted ones, and for how many cycles.
pub(super) type Shaping = Option<(Causes, u64)>;
