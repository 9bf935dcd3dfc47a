//! Alarms of the line: late replies, foreign frames, unexpected frames, a lost rate. Counts and times are arguments. Each alarm
//! is reported at its start, at each tenfold increase, and at its end.

use std::collections::VecDeque;

use super::session::{Level, Notice};
use drivebench_link::LineCounts;

pub(super) const FOREIGN_WRITES: &str = "foreign_writes";
/// An alarm that grows by this factor is reported again.
const GROWTH: u64 = 10;
/// An alarm ends after this time without a new frame, s.
const QUIET_S: f64 = 10.0;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct LineReport {
    pub(super) event: &'static str,
    /// Frames, or achieved Hz, and the key of it in the event.
    pub(super) figure: (&'static str, f64),
    pub(super) notice: Notice,
}

#[derive(Clone, Copy, Debug, Default)]
struct Alarm {
    events: [&'static str; 2],
    /// Frames from which on it begins.
    least: u64,
    text: &'static str,
    ended: &'static str,
    /// Frames before its begin.
    before: u64,
    /// Frames at the last report; 0: no alarm.
    reported: u64,
    count: u64,
    /// Time of the last frame, s.
    count_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Exchange {
    at_s: f64,
    took_s: f64,
    answered: bool,
    line: LineCounts,
}

/// The alarms of a line, and the last exchanges.
#[derive(Debug)]
pub(super) struct LineWatch {
    rate_hz: f64,
    alarms: [Alarm; 5],
    window: VecDeque<Exchange>,
    since_s: Option<f64>,
    lost_hz: Option<f64>,
}

impl LineWatch {
    pub(super) fn new(rate_hz: f64) -> Self {
        let alarm =
            |events, least, text, ended| Alarm { events, least, text, ended, ..Alarm::default() };
        Self {
            rate_hz,
            alarms: [
                alarm(
                    ["stale_frames", "stale_frames_end"],
                    1,
                    "on the line came late or twice (stale): the drive or an adapter holds them back; none was taken for another",
                    "late or second replies",
                ),
                // Fewer may come from a damaged line.
                alarm(
                    ["foreign_frames", "foreign_frames_end"],
                    3,
                    "on the line answer no request of this host: two devices share the address, or a second master is on the bus?",
                    "foreign frames",
                ),
                alarm(
                    ["unasked_frames", "unasked_frames_end"],
                    3,
                    "on the line came without a request: is a second master on the bus?",
                    "frames without a request",
                ),
                // A request and its acknowledgement. One alone may be the late acknowledgement of a write of this host.
                alarm(
                    [FOREIGN_WRITES, "foreign_writes_end"],
                    2,
                    "on the line write to this drive and are not of this host: another master commands it",
                    "writes of another master",
                ),
                alarm(
                    ["stray_replies", "stray_replies_end"],
                    3,
                    "came with stray bytes around a whole reply (dropped): bias or termination of the line, or the turnaround of the adapter",
                    "replies with stray bytes",
                ),
            ],
            window: VecDeque::new(),
            since_s: None,
            lost_hz: None,
        }
    }

    /// Frames that the line has carried up to now.
    pub(super) fn frames(&mut self, now_s: f64, line: LineCounts) -> Vec<LineReport> {
        let counts = [
            line.stale_frames,
            line.foreign_frames,
            line.unasked_frames,
            line.foreign_writes,
            line.stray_replies,
        ];
        let alarms = self.alarms.iter_mut().zip(counts);
        alarms.filter_map(|(alarm, count)| alarm.update(now_s, count)).collect()
    }

    /// An exchange of a run that ended at `now_s`.
    pub(super) fn exchange(
        &mut self,
        now_s: f64,
        took_s: f64,
        answered: bool,
        line: LineCounts,
    ) -> Option<LineReport> {
        // The achieved rate is that of 1 s and of ten cycles at least.
        let window_s = (10.0 / self.rate_hz).max(1.0);
        let begun_s = *self.since_s.get_or_insert(now_s);
        self.window.push_back(Exchange { at_s: now_s, took_s, answered, line });
        while (self.window.front()).is_some_and(|first| now_s - first.at_s >= window_s) {
            self.window.pop_front();
        }
        if now_s - begun_s < window_s {
            return None;
        }
        let answered = self.window.iter().filter(|exchange| exchange.answered);
        let achieved_hz = answered.count() as f64 / window_s;
        let (level, event, text) = match self.lost_hz {
            Some(_) if achieved_hz >= 0.95 * self.rate_hz => {
                self.lost_hz = None;
                let text = format!("the rate is back at {achieved_hz:.1} Hz");
                (Level::Info, "rate_regained", text)
            }
            Some(lost_hz) if achieved_hz * GROWTH as f64 > lost_hz => return None,
            None if achieved_hz >= 0.9 * self.rate_hz => return None,
            _ => {
                self.lost_hz = Some(achieved_hz.max(f64::MIN_POSITIVE));
                let text = format!(
                    "{achieved_hz:.1} Hz were achieved of {} Hz: {}",
                    self.rate_hz,
                    self.reason(window_s)
                );
                (Level::Warning, "rate_lost", text)
            }
        };
        Some(LineReport {
            event,
            figure: ("achieved_hz", achieved_hz),
            notice: Notice { level, text },
        })
    }

    pub(super) fn reset(&mut self) {
        self.window.clear();
        self.since_s = None;
        self.lost_hz = None;
    }

    fn reason(&self, window_s: f64) -> String {
        let (Some(first), Some(last)) = (self.window.front(), self.window.back()) else {
            return format!("no exchange in {window_s:.1} s");
        };
        let count = self.window.len();
        let silent = self.window.iter().filter(|exchange| !exchange.answered).count();
        let taken_s: f64 = self.window.iter().map(|exchange| exchange.took_s).sum();
        let resync_ms = last.line.resync_ms - first.line.resync_ms;
        let retries = last.line.retries - first.line.retries;
        let mut parts = Vec::new();
        if resync_ms > 0 {
            parts.push(format!(
                "{resync_ms} ms went into silences and probes that keep old replies away"
            ));
        }
        if retries > 0 {
            parts.push(format!("{retries} requests were repeated"));
        }
        if silent > 0 {
            parts.push(format!("{silent} of {count} exchanges gave no sample"));
        }
        let mean_ms = 1e3 * taken_s / count as f64;
        parts.push(format!("an exchange takes {mean_ms:.1} ms"));
        parts.join(", ")
    }
}

impl Alarm {
    fn update(&mut self, now_s: f64, count: u64) -> Option<LineReport> {
        if count != self.count {
            (self.count, self.count_s) = (count, now_s);
        }
        let frames = count - self.before;
        let begins = self.reported == 0 && frames >= self.least;
        let grows = self.reported > 0 && frames >= GROWTH * self.reported;
        let ends = self.reported > 0 && now_s - self.count_s > QUIET_S;
        let (event, level, text) = if ends {
            (self.before, self.reported) = (count, 0);
            let text = format!("no more {} for {QUIET_S} s; {frames} in all", self.ended);
            (self.events[1], Level::Info, text)
        } else if begins || grows {
            self.reported = frames;
            let noun = if frames == 1 { "frame" } else { "frames" };
            (self.events[0], Level::Warning, format!("{frames} {noun} {}", self.text))
        } else {
            return None;
        };
        Some(LineReport {
            event,
            figure: ("frames", frames as f64),
            notice: Notice { level, text },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::has;

    fn line(stale_frames: u64, resync_ms: u64) -> LineCounts {
        LineCounts { stale_frames, resync_ms, ..LineCounts::default() }
    }

    #[test]
    fn a_line_problem_is_reported_at_begin_growth_and_end() {
        let mut watch = LineWatch::new(50.0);
        let mut reports = Vec::new();
        for k in 0..3000_u32 {
            let now_s = f64::from(k) * 0.02;
            let stale = u64::from(k.clamp(100, 250) - 100);
            for report in watch.frames(now_s, line(stale, 0)) {
                reports.push((k, report.event, report.figure));
            }
        }
        let events: Vec<_> = reports.iter().map(|(k, event, _)| (*k, *event)).collect();
        let (stale, end) = ("stale_frames", "stale_frames_end");
        assert_eq!(events, [(101, stale), (110, stale), (200, stale), (751, end)], "{reports:?}");
    }

    #[test]
    fn a_lost_rate_is_reported_once_and_its_return() {
        let mut watch = LineWatch::new(50.0);
        let mut reports = Vec::new();
        let (mut now_s, mut resync_ms) = (0.0, 0);
        while now_s < 9.0 {
            let slow = (3.0..6.0).contains(&now_s);
            now_s += if slow { 0.025 } else { 0.02 };
            resync_ms += if slow { 10 } else { 0 };
            reports.extend(watch.exchange(now_s, 0.012, true, line(1, resync_ms)));
        }
        let events: Vec<_> = reports.iter().map(|report| report.event).collect();
        assert_eq!(events, ["rate_lost", "rate_regained"], "{reports:?}");
        let text = &reports[0].notice.text;
        has(text, "of 50 Hz");
        has(text, "silences and probes");
        assert!((40.0..45.1).contains(&reports[0].figure.1), "{reports:?}");
    }
}
