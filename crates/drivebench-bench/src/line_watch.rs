//! Watch over the line's counters: late replies, frames of others, replies to nobody, a rate that was lost. Pure: counts and
//! times go in. Each is told when it begins, when it gets ten times worse, and when it ends.

use std::collections::VecDeque;

use super::session::{Level, Notice};
use drivebench_link::LineCounts;

/// Whole frames of others: from so many on somebody else is there, and not a damaged line.
const STRANGERS: u64 = 3;
/// Frames that write to the drive and are not ours: a request and its acknowledgement. One alone may be the
/// acknowledgement of a write of ours that was held back for very long.
const STRANGE_WRITES: u64 = 2;
pub(super) const FOREIGN_WRITES: &str = "foreign_writes";
/// A matter that grows by this factor is told again.
const WORSE: u64 = 10;
/// A matter that is not seen for so long is over, s.
const OVER_S: f64 = 10.0;
/// The achieved rate is that of so long, s, and of so many cycles at least.
const WINDOW_S: f64 = 1.0;
const WINDOW_CYCLES: f64 = 10.0;
/// Below this share of the asked rate it counts as lost, above that as regained.
const LOST_SHARE: f64 = 0.9;
const REGAINED_SHARE: f64 = 0.95;

/// Something to be told, with the event for the record.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct News {
    pub(super) event: &'static str,
    /// Frames, or achieved Hz.
    pub(super) figure: f64,
    pub(super) notice: Notice,
}

/// Frames of one kind.
#[derive(Clone, Copy, Debug, Default)]
struct Matter {
    events: [&'static str; 2],
    least: u64,
    text: &'static str,
    ended: &'static str,
    /// Counted before it began.
    before: u64,
    told: u64,
    seen: u64,
    seen_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Exchange {
    at_s: f64,
    took_s: f64,
    answered: bool,
    line: LineCounts,
}

/// What has been told of a line, and the last exchanges.
#[derive(Debug)]
pub(super) struct LineWatch {
    rate_hz: f64,
    matters: [Matter; 4],
    window: VecDeque<Exchange>,
    since_s: Option<f64>,
    /// The rate that was told as lost, Hz.
    lost_hz: Option<f64>,
}

impl LineWatch {
    pub(super) fn new(rate_hz: f64) -> Self {
        let matter =
            |events, least, text, ended| Matter { events, least, text, ended, ..Matter::default() };
        Self {
            rate_hz,
            matters: [
                matter(
                    ["stale_frames", "stale_frames_end"],
                    1,
                    "on the line came late or twice (stale): the drive or an adapter holds them back; none was taken for another",
                    "late or second replies",
                ),
                matter(
                    ["foreign_frames", "foreign_frames_end"],
                    STRANGERS,
                    "on the line answer nothing that was asked: two devices share the address, or a second master is on the bus?",
                    "frames of others",
                ),
                matter(
                    ["unasked_frames", "unasked_frames_end"],
                    STRANGERS,
                    "on the line are replies to nobody, while nothing was asked: is a second master on the bus?",
                    "replies to nobody",
                ),
                matter(
                    [FOREIGN_WRITES, "foreign_writes_end"],
                    STRANGE_WRITES,
                    "on the line write to this drive and are not ours: another master commands it",
                    "writes of another master",
                ),
            ],
            window: VecDeque::new(),
            since_s: None,
            lost_hz: None,
        }
    }

    /// Frames that the line has carried up to now.
    pub(super) fn frames(&mut self, now_s: f64, line: LineCounts) -> Vec<News> {
        let counts =
            [line.stale_frames, line.foreign_frames, line.unasked_frames, line.foreign_writes];
        let matters = self.matters.iter_mut().zip(counts);
        let news = matters.filter_map(|(matter, count)| matter.look(now_s, count));
        news.collect()
    }

    /// An exchange of a run that ended at `now_s`.
    pub(super) fn exchange(
        &mut self,
        now_s: f64,
        took_s: f64,
        answered: bool,
        line: LineCounts,
    ) -> Option<News> {
        let window_s = WINDOW_S.max(WINDOW_CYCLES / self.rate_hz);
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
            Some(_) if achieved_hz >= REGAINED_SHARE * self.rate_hz => {
                self.lost_hz = None;
                let text = format!("the rate is back at {achieved_hz:.1} Hz");
                (Level::Info, "rate_regained", text)
            }
            Some(lost_hz) if achieved_hz * WORSE as f64 > lost_hz => return None,
            None if achieved_hz >= LOST_SHARE * self.rate_hz => return None,
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
        Some(News { event, figure: achieved_hz, notice: Notice { level, text } })
    }

    /// No run is on: its rate is measured anew.
    pub(super) fn rest(&mut self) {
        self.window.clear();
        self.since_s = None;
        self.lost_hz = None;
    }

    /// Where the time of the window went.
    fn reason(&self, window_s: f64) -> String {
        let (Some(first), Some(last)) = (self.window.front(), self.window.back()) else {
            return format!("no exchange in {window_s:.1} s");
        };
        let count = self.window.len();
        let silent = self.window.iter().filter(|exchange| !exchange.answered);
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
            parts.push(format!("{retries} questions were asked again"));
        }
        let silent = silent.count();
        if silent > 0 {
            parts.push(format!("{silent} of {count} exchanges gave no sample"));
        }
        let mean_ms = 1e3 * taken_s / count as f64;
        parts.push(format!("an exchange takes {mean_ms:.1} ms"));
        parts.join(", ")
    }
}

impl Matter {
    fn look(&mut self, now_s: f64, count: u64) -> Option<News> {
        if count != self.seen {
            self.seen = count;
            self.seen_s = now_s;
        }
        let here = count - self.before;
        let begins = self.told == 0 && here >= self.least;
        let worse = self.told > 0 && here >= WORSE * self.told;
        let ends = self.told > 0 && now_s - self.seen_s > OVER_S;
        let (event, level, text) = if ends {
            self.before = count;
            self.told = 0;
            let text = format!("no more {} for {OVER_S} s; {here} in all", self.ended);
            (self.events[1], Level::Info, text)
        } else if begins || worse {
            self.told = here;
            let frames = if here == 1 { "frame" } else { "frames" };
            let text = format!("{here} {frames} {}", self.text);
            (self.events[0], Level::Warning, text)
        } else {
            return None;
        };
        Some(News { event, figure: here as f64, notice: Notice { level, text } })
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
        let mut told = Vec::new();
        for k in 0..3000_u32 {
            let now_s = f64::from(k) * 0.02;
            let stale = u64::from(k.clamp(100, 250) - 100);
            for news in watch.frames(now_s, line(stale, 0)) {
                told.push((k, news.event, news.figure));
            }
        }
        let events: Vec<_> = told.iter().map(|(k, event, _)| (*k, *event)).collect();
        let (stale, end) = ("stale_frames", "stale_frames_end");
        let expected = [(101, stale), (110, stale), (200, stale), (751, end)];
        assert_eq!(events, expected, "{told:?}");
    }

    #[test]
    fn a_lost_rate_is_reported_once_and_its_return() {
        let mut watch = LineWatch::new(50.0);
        let mut told = Vec::new();
        let (mut now_s, mut resync_ms) = (0.0, 0);
        while now_s < 9.0 {
            let slow = (3.0..6.0).contains(&now_s);
            now_s += if slow { 0.025 } else { 0.02 };
            resync_ms += if slow { 10 } else { 0 };
            told.extend(watch.exchange(now_s, 0.012, true, line(1, resync_ms)));
        }
        let events: Vec<_> = told.iter().map(|news| news.event).collect();
        assert_eq!(events, ["rate_lost", "rate_regained"], "{told:?}");
        let text = &told[0].notice.text;
        has(text, "of 50 Hz");
        has(text, "silences and probes");
        assert!((40.0..45.1).contains(&told[0].figure), "{told:?}");
    }
}
