//! The drive's word: what it tells of its state, how long that is waited for, and how often a drive that is to stop is told so.

use crate::drive::CommandTimes;

/// A drive that is to stop and gives no sample is told so in every cycle for as long as its watchdog takes, or for this where
/// none is known of, s; then once in so many times that. What goes out may keep its watchdog from acting: the pauses are longer.
const ASKED_S: f64 = 1.0;
const BEAT: f64 = 1.5;

/// What the drive tells of its state, and how long that is waited for.
pub(super) struct DriveWord {
    /// Whether the drive tells that its output is off.
    pub(super) tells_stop: bool,
    /// Longest wait for its word that it has stopped, s.
    pub(super) stop_time_s: f64,
    /// When it was heard last, s, and when it gave its last sample.
    pub(super) heard_s: f64,
    pub(super) sampled_s: f64,
    /// When it was told to stop last, s.
    pub(super) told_s: f64,
    /// It was seen to run, or does not tell whether it does.
    pub(super) has_run: bool,
    /// Of its watchdog, s.
    pub(super) watchdog_s: Option<f64>,
    /// The user waived its watchdog: nothing is known of what it does when nobody talks to it.
    pub(super) is_unwatched: bool,
    pub(super) stop: StopRequest,
}

/// How far the stop with which a session ends has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopRequest {
    /// A state that answers anything before it says nothing of the stop.
    NotSent,
    Sent,
    /// The session ended without the drive's word that the output is off.
    Unconfirmed,
}

impl Default for DriveWord {
    fn default() -> Self {
        Self {
            tells_stop: true,
            stop_time_s: CommandTimes::default().stop_s,
            heard_s: 0.0,
            sampled_s: 0.0,
            told_s: 0.0,
            has_run: false,
            watchdog_s: None,
            is_unwatched: false,
            stop: StopRequest::NotSent,
        }
    }
}

impl DriveWord {
    /// Whether a drive that has been told to stop since then is told so in this cycle too. One that gives samples is: they show
    /// when it has stopped.
    pub(super) fn asks_to_stop(&self, now_s: f64, since_s: f64, watchdog_s: Option<f64>) -> bool {
        let asked_s = watchdog_s.unwrap_or(ASKED_S);
        self.stop == StopRequest::NotSent
            || now_s - since_s.max(self.sampled_s) <= asked_s
            || now_s - self.told_s >= BEAT * asked_s
    }
}
