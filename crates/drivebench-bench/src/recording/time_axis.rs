//! Order of the stamps of a file: a strictly increasing time from stamps that roll over, repeat, stand out of order, or were
//! set back.
//!
//! ```text
//! stamp after the last one ------------------------------------------> kept
//! far ahead: held until the next row shows a gap (kept) or one wild stamp (left out)
//! back by nearly the range of a counter -> unwrapped
//! back otherwise: held for at most eight rows
//!     the time comes back ---------------> left out: rows that repeat earlier ones exactly, single rows out of order
//!     it goes on in usual steps ---------> the clock was set back: one usual step after the last row
//!     else -----------------------------> refused
//! ```
//!
//! The memory is bounded: the steps of 16 rows, stamp and checksum of 16,384 rows, at most eight rows.

use std::collections::VecDeque;

use drivebench_model::numerics::statistics::{median, median_step};
use drivebench_model::text::number::with_digits;

/// Steps whose median is the usual one.
const STEPS: usize = 16;
/// Steps up to so many usual ones are usual too: rows may be lost.
const USUAL: f64 = 8.0;
/// Falls of the time after which rows are no longer searched for repeats.
const SEARCHES: usize = 1000;
/// Rows whose stamps are kept.
const ROWS: usize = 1 << 14;

/// A counter that begins again.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Counter {
    pub range_s: f64,
    pub least_s: f64,
    /// `16 bits`, `a day`.
    pub name: &'static str,
}

impl Counter {
    /// Counters of so many bits and units of a clock, in a column of which one count is `count_s`.
    pub(super) fn all(count_s: f64) -> Vec<Self> {
        let count_s = count_s.abs();
        let bits = [(16, "16 bits"), (24, "24 bits"), (31, "31 bits"), (32, "32 bits")];
        let counts = bits.into_iter().flat_map(|(bits, name)| {
            let range_s = f64::from(bits).exp2() * count_s;
            // With and without a sign.
            [0.0, -0.5 * range_s].map(|least_s| Self { range_s, least_s, name })
        });
        let clocks = [
            (32_f64.exp2() * 1e-6, "32 bits of microseconds"),
            (16_f64.exp2() * 1e-3, "16 bits of milliseconds"),
            (32_f64.exp2() * 1e-3, "32 bits of milliseconds"),
            (1.0, "a second"),
            (60.0, "a minute"),
            (3600.0, "an hour"),
            (86_400.0, "a day"),
        ];
        let clocks = clocks.into_iter().map(|(range_s, name)| Self { range_s, least_s: 0.0, name });
        counts.chain(clocks).collect()
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Stamp {
    /// As in the file, s.
    pub time_s: f64,
    /// Checksum of the row with its stamp.
    pub checksum: u64,
    /// Line and number of the row in the file.
    pub line: usize,
    pub row: usize,
}

/// A fall of the time that cannot be mended.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fall {
    pub time_s: f64,
    pub before_s: f64,
    pub line: usize,
    pub row: usize,
    /// Rows before it that are in order.
    pub in_order: usize,
}

/// Something that happened to the stamps, with the line where it happened first.
#[derive(Clone, Debug, Default, PartialEq)]
struct Count {
    rows: usize,
    line: usize,
}

impl Count {
    fn add(&mut self, line: usize) {
        if self.rows == 0 {
            self.line = line;
        }
        self.rows += 1;
    }
}

/// Orders rows of the kind `T`.
#[derive(Default)]
pub(super) struct TimeAxis<T> {
    /// Added to the stamps of the file.
    shift_s: f64,
    /// Of the last row that was kept.
    last: Option<Stamp>,
    kept: usize,
    steps: [f64; STEPS],
    /// Mean of the last steps, from so many rows to the next so many.
    mean_s: f64,
    block_s: f64,
    /// Stamps and checksums of the last rows, the oldest overwritten.
    past: Vec<(f64, u64)>,
    read: usize,
    held: VecDeque<(Stamp, T)>,
    /// The held row stands far ahead.
    is_ahead: bool,
    ready: VecDeque<(f64, T)>,
    /// While rows repeat earlier ones: the place in `past` of the next.
    repeats_at: Option<usize>,
    falls: usize,
    first_fall: Option<Fall>,
    same: usize,
    backwards: usize,
    repeats: Count,
    rollovers: Vec<(Counter, Count)>,
    /// Seconds and line.
    set_backs: Vec<(f64, usize)>,
}

impl<T> TimeAxis<T> {
    pub(super) fn left_out(&self) -> usize {
        self.same + self.backwards + self.repeats.rows
    }

    /// The next row in order, with its time.
    pub(super) fn pop(&mut self) -> Option<(f64, T)> {
        self.ready.pop_front()
    }

    /// The time of a row that is at once the next in order, and is kept; else it must be pushed.
    pub(super) fn next_in_order(&mut self, stamp: Stamp) -> Option<f64> {
        let time_s = stamp.time_s + self.shift_s;
        let is_plain = self.held.is_empty() && self.ready.is_empty();
        let is_next = is_plain && self.last.is_none_or(|last| self.is_next(time_s - last.time_s));
        is_next.then(|| {
            self.remember(stamp);
            self.repeats_at = None;
            self.keep(stamp);
            time_s
        })
    }

    /// Takes the next row of the file, which is not at once the next in order. `counters` that may have begun again.
    pub(super) fn push(
        &mut self,
        stamp: Stamp,
        row: T,
        counters: impl Fn() -> Vec<Counter>,
    ) -> Result<(), Fall> {
        if let Some(at) = self.repeats_at.take()
            && self.past.get(at % ROWS).is_some_and(|entry| entry.1 == stamp.checksum)
        {
            self.repeats_at = Some(at + 1);
            self.repeats.add(stamp.line);
            return Ok(());
        }
        self.remember(stamp);
        self.place(stamp, row, &counters)
    }

    /// The rows that are still held.
    pub(super) fn finish(&mut self) -> Result<(), Fall> {
        if self.is_ahead {
            self.release();
        }
        self.leave_out_held();
        // Then the column is no time.
        let most = 0.1 * self.kept as f64;
        match self.first_fall.take() {
            Some(fall) if self.backwards as f64 > most => Err(fall),
            _ => Ok(()),
        }
    }

    /// All stamps so far in their order; `None` where there were too many.
    pub(super) fn stamps(&self) -> Option<Vec<f64>> {
        let all = || self.past.iter().map(|(time_s, _)| *time_s).collect();
        (self.read == self.past.len()).then(all)
    }

    /// What was done to the stamps, in sentences; `column` is that of the time.
    pub(super) fn sentences(&self, column: &str) -> Vec<String> {
        let (same, backwards) = (self.same, self.backwards);
        let mut sentences = Vec::new();
        let all = same + backwards;
        if all > 0 {
            sentences.push(format!(
                "{all} rows whose time is not after that of the row before were left out: {same} repeat it, {backwards} go back"
            ));
        }
        if self.repeats.rows > 0 {
            let Count { rows, line } = self.repeats;
            sentences.push(format!(
                "{rows} rows repeat earlier rows exactly (from line {line} on) and were left out"
            ));
        }
        for (Counter { range_s, name, .. }, Count { rows, line }) in &self.rollovers {
            let times = if *rows == 1 { "once".to_owned() } else { format!("{rows} times") };
            sentences.push(format!(
                "column {column:?} begins again {times}, first in line {line}, as a counter of {name} does: {range_s} s were added each time"
            ));
        }
        for (seconds, line) in &self.set_backs {
            sentences.push(format!(
                "the clock was set back by {} s in line {line}: the rows go on one usual step ({} s) after the row before",
                with_digits(*seconds, 6),
                with_digits(self.usual_step(), 6)
            ));
        }
        sentences
    }

    /// Whether a step needs no thought: one of more than 64 usual ones may be a wild stamp.
    fn is_next(&self, step_s: f64) -> bool {
        step_s > 0.0 && (self.kept <= STEPS || step_s <= 64.0 * self.mean_s)
    }

    fn remember(&mut self, stamp: Stamp) {
        let entry = (stamp.time_s, stamp.checksum);
        match self.past.get_mut(self.read % ROWS) {
            Some(place) => *place = entry,
            None => self.past.push(entry),
        }
        self.read += 1;
    }

    /// The row is kept: it is the last one now, with its time on the axis.
    fn keep(&mut self, stamp: Stamp) {
        let time_s = stamp.time_s + self.shift_s;
        if let Some(last) = self.last {
            self.steps[(self.kept - 1) % STEPS] = time_s - last.time_s;
        }
        if self.kept.is_multiple_of(STEPS) {
            self.mean_s = (time_s - self.block_s) / STEPS as f64;
            self.block_s = time_s;
        }
        self.last = Some(Stamp { time_s, ..stamp });
        self.kept += 1;
    }

    /// The usual step; that of the first rows where they are few, and of the held ones where there is no other.
    fn usual_step(&self) -> f64 {
        match self.kept.saturating_sub(1) {
            0 => {
                let held: Vec<f64> = self.held.iter().map(|(stamp, _)| stamp.time_s).collect();
                median_step(&held)
            }
            count if count < STEPS => median(&self.steps[..count]),
            _ => median(&self.steps),
        }
    }

    fn place(
        &mut self,
        stamp: Stamp,
        row: T,
        counters: &impl Fn() -> Vec<Counter>,
    ) -> Result<(), Fall> {
        let Some(last) = self.last else {
            self.put(stamp, row);
            return Ok(());
        };
        let time_s = stamp.time_s + self.shift_s;
        if let Some(before) = self.held.back().map(|(stamp, _)| *stamp) {
            if self.is_ahead {
                if stamp.time_s > before.time_s || time_s <= last.time_s {
                    self.release();
                } else {
                    self.leave_out_held();
                }
                return self.place(stamp, row, counters);
            }
            if let Some(at) = self.repeated(before, stamp) {
                self.leave_out_held();
                self.repeats.add(stamp.line);
                self.repeats_at = Some(at + 2);
                return Ok(());
            }
            if time_s > last.time_s {
                self.leave_out_held();
                return self.place(stamp, row, counters);
            }
            self.held.push_back((stamp, row));
            // A few rows may stand out of order one behind the other.
            return if self.held.len() < 8 { Ok(()) } else { self.set_back(last) };
        }
        let step_s = time_s - last.time_s;
        if step_s > 0.0 {
            self.is_ahead = !self.is_next(step_s);
            if self.is_ahead {
                self.held.push_back((stamp, row));
            } else {
                self.put(stamp, row);
            }
        } else if step_s < 0.0 {
            if self.roll_over(last, stamp, counters()) {
                self.put(stamp, row);
                return Ok(());
            }
            self.falls += 1;
            self.held.push_back((stamp, row));
        } else {
            self.same += 1;
        }
        Ok(())
    }

    fn put(&mut self, stamp: Stamp, row: T) {
        self.keep(stamp);
        self.ready.push_back((stamp.time_s + self.shift_s, row));
    }

    /// A counter began again: near its end before, near its beginning now.
    fn roll_over(&mut self, last: Stamp, stamp: Stamp, counters: Vec<Counter>) -> bool {
        let near_s = USUAL * self.usual_step();
        // As in the file.
        let before_s = last.time_s - self.shift_s;
        let is_it = |counter: &Counter| {
            let Counter { range_s, least_s, .. } = counter;
            let step_s = stamp.time_s + range_s - before_s;
            step_s > 0.0
                // Within few steps, of which a counter counts many.
                && step_s <= near_s.min(range_s / 8.0)
                && stamp.time_s >= least_s - 1e-9 * range_s
                && before_s < least_s + range_s * (1.0 + 1e-9)
        };
        let Some(counter) = counters.into_iter().find(is_it) else { return false };
        self.shift_s += counter.range_s;
        let known = self.rollovers.iter().position(|(known, _)| *known == counter);
        let place = known.unwrap_or_else(|| {
            self.rollovers.push((counter, Count::default()));
            self.rollovers.len() - 1
        });
        self.rollovers[place].1.add(stamp.line);
        true
    }

    /// The place in the past of two rows that are repeated one behind the other.
    fn repeated(&self, before: Stamp, stamp: Stamp) -> Option<usize> {
        if self.falls > SEARCHES {
            return None;
        }
        // The held rows and this one stand in the past themselves.
        let older = self.read - self.past.len()..self.read - self.held.len() - 1;
        let checksum = |at: usize| self.past[at % ROWS].1;
        let found = older.clone().zip(older.skip(1)).find(|(at, next)| {
            checksum(*at) == before.checksum && checksum(*next) == stamp.checksum
        });
        found.map(|(at, _)| at)
    }

    /// The held rows are left out; those that stand in the file already as repeats.
    fn leave_out_held(&mut self) {
        while let Some((stamp, _)) = self.held.pop_front() {
            let is_searched = self.falls <= SEARCHES && !self.is_ahead;
            // It stands in the past itself.
            let same = |entry: &&(f64, u64)| entry.1 == stamp.checksum;
            if is_searched && self.past.iter().filter(same).count() > 1 {
                self.repeats.add(stamp.line);
            } else {
                self.backwards += 1;
                if let Some(last) = self.last.filter(|_| !self.is_ahead) {
                    let fall = self.fall(stamp, last);
                    self.first_fall.get_or_insert(fall);
                }
            }
        }
        self.is_ahead = false;
    }

    /// The held rows are in order behind the last one.
    fn release(&mut self) {
        self.is_ahead = false;
        while let Some((stamp, row)) = self.held.pop_front() {
            let last_s = self.last.map_or(f64::NEG_INFINITY, |last| last.time_s);
            if stamp.time_s + self.shift_s > last_s {
                self.put(stamp, row);
            } else {
                self.same += 1;
            }
        }
    }

    /// The clock was set back if the time goes on in usual steps.
    fn set_back(&mut self, last: Stamp) -> Result<(), Fall> {
        let usual_s = self.usual_step();
        let first = self.held[0].0;
        let stamps = self.held.iter().map(|(stamp, _)| stamp.time_s);
        let mut steps = stamps.clone().zip(stamps.skip(1)).map(|(before, next)| next - before);
        let goes_on = usual_s > 0.0 && steps.all(|step| (0.0..=USUAL * usual_s).contains(&step));
        if !goes_on || self.set_backs.len() >= 3 {
            return Err(self.fall(first, last));
        }
        self.set_backs.push((last.time_s - (first.time_s + self.shift_s), first.line));
        self.shift_s = last.time_s + usual_s - first.time_s;
        self.release();
        Ok(())
    }

    /// With both times as in the file.
    fn fall(&self, stamp: Stamp, last: Stamp) -> Fall {
        let Stamp { time_s, line, row, .. } = stamp;
        Fall { time_s, before_s: last.time_s - self.shift_s, line, row, in_order: self.kept }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use super::*;
    use proptest::prelude::*;

    /// Rows with these stamps in a column of counts of 1 ms; the checksum of a row is that of its stamp. Returns the times
    /// of the kept rows, and the sentences.
    fn ordered(stamps: &[f64]) -> Result<(Vec<f64>, Vec<String>), Fall> {
        let mut axis = TimeAxis::default();
        let mut times = Vec::new();
        for (place, time_s) in stamps.iter().enumerate() {
            let (line, row) = (place + 2, place + 1);
            let stamp = Stamp { time_s: *time_s, checksum: time_s.to_bits(), line, row };
            match axis.next_in_order(stamp) {
                Some(time_s) => times.push(time_s),
                None => axis.push(stamp, (), || Counter::all(1e-3))?,
            }
            times.extend(std::iter::from_fn(|| axis.pop()).map(|(time_s, ())| time_s));
        }
        axis.finish()?;
        times.extend(std::iter::from_fn(|| axis.pop()).map(|(time_s, ())| time_s));
        assert!(times.len() + axis.left_out() == stamps.len(), "{stamps:?}");
        Ok((times, axis.sentences("t")))
    }

    /// Stamps of a range of counts of 2 ms.
    fn counts(range: Range<u32>) -> Vec<f64> {
        range.map(|count| f64::from(count) * 2e-3).collect()
    }

    /// Those of ranges one behind the other.
    fn in_turn<const N: usize>(ranges: [Range<u32>; N]) -> Vec<f64> {
        ranges.map(counts).concat()
    }

    #[test]
    fn stamps_are_put_in_order_where_that_is_certain() {
        let wrapped = |range_s: f64, least_s: f64| {
            let counter = |time_s: f64| (time_s + range_s - least_s).rem_euclid(range_s) + least_s;
            let begin_s = least_s + range_s - 0.05;
            counts(0..100).iter().map(|time_s| counter(begin_s + time_s)).collect::<Vec<_>>()
        };
        let even = |stamps: Vec<f64>| (stamps, 100, "");
        let begins = "begins again once";
        let ahead = [counts(0..50), vec![65_535.0], counts(50..99)].concat();
        let back = [counts(0..99), vec![0.001]].concat();
        let mut set_back = in_turn([1000..1050, 1045..1095]);
        set_back[50..].iter_mut().for_each(|time_s| *time_s += 1e-3);
        for (name, (stamps, rows, part)) in [
            ("in order", even(counts(0..100))),
            ("a gap", even(in_turn([0..50, 5000..5050]))),
            ("16 bits", (wrapped(65.536, 0.0), 100, "a counter of 16 bits")),
            ("16 bits with a sign", (wrapped(65.536, -32.768), 100, "a counter of 16 bits")),
            ("32 bits", (wrapped(4_294_967.296, 0.0), 100, "a counter of 32 bits")),
            ("microseconds", (wrapped(4_294.967_296, 0.0), 100, "32 bits of microseconds")),
            ("a second", (wrapped(1.0, 0.0), 100, "a counter of a second")),
            ("a day", (wrapped(86_400.0, 0.0), 100, begins)),
            ("a rotated file", (in_turn([0..400, 200..500]), 500, "200 rows repeat earlier rows")),
            ("one row out of order", (in_turn([0..50, 40..41, 50..99]), 99, "1 rows repeat")),
            ("one stamp far ahead", (ahead, 99, "1 go back")),
            ("the last row back", (back, 99, "0 repeat it, 1 go back")),
            ("set back", (in_turn([1000..1050, 500..550]), 100, "set back by 1.098 s in line 52")),
            ("set back by four rows", (set_back, 96, "0 repeat it, 4 go back")),
        ] {
            let (times, sentences) =
                ordered(&stamps).unwrap_or_else(|fall| panic!("{name}: {fall:?}"));
            assert_eq!(times.len(), rows, "{name}: {sentences:?}");
            assert!(sentences.join("; ").contains(part), "{name}: {sentences:?}");
            assert_eq!(sentences.is_empty(), part.is_empty(), "{name}: {sentences:?}");
            let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
            let is_usual = |step: f64| (step - 2e-3).abs() < 1e-6;
            let unusual = steps.filter(|step| !is_usual(*step)).count();
            assert!(
                unusual <= usize::from(["a gap", "set back by four rows"].contains(&name)),
                "{name}: {unusual}"
            );
        }
    }

    #[test]
    fn other_falls_are_refused_where_they_begin() {
        let set_backs = in_turn([9, 7, 5, 3, 1].map(|begin| begin * 1000..begin * 1000 + 50));
        let reversed: Vec<f64> = counts(0..100).into_iter().rev().collect();
        let pairs: Vec<f64> =
            counts(0..100).chunks(2).flat_map(|pair| [pair[1], pair[0]]).collect();
        let wild = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 20);
        for (name, stamps, row, in_order) in [
            ("reversed", reversed, 2, 1),
            ("every second out of order", pairs, 2, 1),
            ("set back four times", set_backs, 201, 200),
            ("no time", (1..100).map(wild).collect(), 9, 1),
        ] {
            let fall = ordered(&stamps).unwrap_err();
            assert!(fall.time_s < fall.before_s, "{name}: {fall:?}");
            assert_eq!(fall.row, row, "{name}: {fall:?}");
            assert!(fall.in_order >= in_order, "{name}: {fall:?}");
        }
    }

    proptest! {
        #[test]
        fn the_time_always_increases(stamps in prop::collection::vec(-1e3..1e3_f64, 0..80)) {
            if let Ok((times, _)) = ordered(&stamps) {
                prop_assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
    }
}
