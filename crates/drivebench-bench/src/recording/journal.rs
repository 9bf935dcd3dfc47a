//! The journal of a run: rows and events as whole lines, buffered in memory while they cannot be written; and the recorder of
//! virtual time, which keeps them in memory.

use std::io::{self, BufRead as _, BufReader, BufWriter, IntoInnerError, Read, Write};

use serde_json::{Map, Value};

use super::{CommandRow, Layout, ReadOptions, RecordingError, Row, RowOrder, read_csv};
use drivebench_model::sample::{Run, Sample};

/// An event of a run: a key, a lost deadline, a trip. Replay needs every one.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// On the samples' time axis, s.
    pub time_s: f64,
    /// Sequence number of its exchange.
    pub seq: Option<u64>,
    /// Short name: `trip`, `key`, `deadline_lost`.
    pub event: String,
    pub details: Map<String, Value>,
}

impl Event {
    pub fn new(time_s: f64, seq: Option<u64>, event: impl Into<String>) -> Self {
        Self { time_s, seq, event: event.into(), details: Map::new() }
    }

    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<Value>) -> Self {
        self.details.insert(key.to_owned(), value.into());
        self
    }

    /// One line of `events.jsonl` with its line feed.
    pub fn line(&self) -> String {
        let mut object = Map::new();
        object.insert("time_s".into(), self.time_s.into());
        object.insert("seq".into(), self.seq.into());
        object.insert("event".into(), self.event.clone().into());
        for (key, value) in &self.details {
            object.entry(key.clone()).or_insert_with(|| value.clone());
        }
        Value::Object(object).to_string() + "\n"
    }
}

/// Sink of a session. It never fails: errors are in [`Record::status`].
pub trait Record {
    fn command(&mut self, command: &CommandRow);
    /// The rows completed by this sample, as recorded.
    fn row(&mut self, sample: &Sample) -> &[Row];
    /// At the end, the rows of the commands that still wait.
    fn flush(&mut self) -> &[Row];
    fn event(&mut self, event: Event);
    fn status(&self) -> RecorderStatus;
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Rows handed to the file, written or waiting.
    pub rows: usize,
    pub events: usize,
    /// Bytes in memory because they could not be written.
    pub bytes_waiting: usize,
    /// Rows that neither the file nor the memory could keep.
    pub rows_lost: usize,
    pub events_lost: usize,
    /// The first error of the disk; it is over when no bytes wait.
    pub error: Option<String>,
    /// Errors and recoveries of the record in sentences, the newest last.
    pub messages: Vec<String>,
}

/// A byte sink that can be synced and read back.
pub(super) trait Durable: Write {
    fn sync(&mut self) -> io::Result<()>;

    /// Reads back from byte `at` on; 0 bytes at the end. An open file can be read after it was deleted or renamed.
    fn read_at(&self, at: u64, into: &mut [u8]) -> io::Result<usize>;
}

/// Reader of the first bytes of a sink.
struct ReadBack<'a, S> {
    sink: &'a S,
    at: u64,
    end: u64,
}

impl<S: Durable> Read for ReadBack<'_, S> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let most = into.len().min(usize::try_from(self.end - self.at).unwrap_or(usize::MAX));
        let count = self.sink.read_at(self.at, &mut into[..most])?;
        self.at += count as u64;
        Ok(count)
    }
}

/// Limits of a log in memory, bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Capacity {
    /// Of the written lines, the newest: a failing disk may not have made them durable.
    pub(super) written: usize,
    /// Of all lines; those beyond are lost.
    pub(super) all: usize,
}

impl Capacity {
    /// The last seconds of written samples at 1 kHz, and without a disk hours at 50 Hz, half an hour at 1 kHz.
    pub(super) const SAMPLES: Self = Self { written: 1 << 20, all: 256 << 20 };
    pub(super) const EVENTS: Self = Self { written: 1 << 18, all: 16 << 20 };
}

/// Write-ahead buffer: whole lines in each write call. Lines that the sink does not take are written first the next time. The
/// newest written lines are kept too; older ones are read back from the sink where needed.
#[derive(Debug)]
pub(super) struct Lines<S> {
    pub(super) sink: S,
    text: Vec<u8>,
    /// Written bytes of `text`.
    written: usize,
    /// Bytes and lines before `text`, only in the sink.
    earlier_bytes: u64,
    earlier_count: usize,
    room: Capacity,
    /// Lines neither in the sink nor in memory.
    lost: usize,
}

impl<S: Durable> Lines<S> {
    pub(super) fn new(sink: S, room: Capacity) -> Self {
        Self {
            sink,
            text: Vec::new(),
            written: 0,
            earlier_bytes: 0,
            earlier_count: 0,
            room,
            lost: 0,
        }
    }

    pub(super) fn push(&mut self, line: &str) -> io::Result<()> {
        self.keep(line);
        self.drain()
    }

    /// Buffers a line for the next `drain`.
    fn keep(&mut self, line: &str) {
        if self.text.len().saturating_add(line.len()) > self.room.written {
            self.drop_older();
        }
        if self.text.len().saturating_add(line.len()) > self.room.all {
            self.lost += 1;
        } else {
            self.text.extend_from_slice(line.as_bytes());
        }
    }

    /// Drops the older half of the written lines from memory.
    fn drop_older(&mut self) {
        let older = &self.text[..self.written.saturating_sub(self.room.written / 2)];
        let end = older.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
        self.earlier_bytes += end as u64;
        self.earlier_count += older[..end].split(|byte| *byte == b'\n').count() - 1;
        self.text.drain(..end);
        self.written -= end;
        if self.text.capacity() / 4 > self.room.written.max(self.text.len()) {
            self.text.shrink_to(self.room.written);
        }
    }

    pub(super) fn bytes_waiting(&self) -> usize {
        self.text.len() - self.written
    }

    fn before(&self) -> BufReader<ReadBack<'_, S>> {
        BufReader::new(ReadBack { sink: &self.sink, at: 0, end: self.earlier_bytes })
    }

    /// All lines so far; `None` where they are not complete.
    pub(super) fn whole(&self) -> Option<Vec<u8>> {
        let mut whole = Vec::new();
        self.before().read_to_end(&mut whole).ok()?;
        let is_whole = whole.len() as u64 == self.earlier_bytes && self.lost == 0;
        whole.extend_from_slice(&self.text);
        is_whole.then_some(whole)
    }

    /// A new sink with the lines of this one, after `head` where that is not the first.
    fn moved_to(&self, sink: S, head: &str) -> io::Result<Moved<S>> {
        let mut fresh = BufWriter::new(sink);
        let (mut back, mut line) = (self.before(), Vec::new());
        let (mut bytes, mut lines) = (0, 0);
        // From the first unreadable line on, all up to those in memory are lost.
        while back.read_until(b'\n', &mut line).is_ok() && line.ends_with(b"\n") {
            fresh.write_all(&line)?;
            bytes += line.len() as u64;
            lines += 1;
            line.clear();
        }
        let mut lost = self.earlier_count.saturating_sub(lines);
        if lines == 0 && lost > 0 && !head.is_empty() {
            fresh.write_all(head.as_bytes())?;
            bytes += head.len() as u64;
            (lines, lost) = (1, lost - 1);
        }
        let sink = fresh.into_inner().map_err(IntoInnerError::into_error)?;
        Ok(Moved { sink, bytes, lines, lost })
    }

    /// Continues in the new sink, first with the lines in memory.
    fn continue_in(&mut self, moved: Moved<S>) {
        self.sink = moved.sink;
        (self.earlier_bytes, self.earlier_count) = (moved.bytes, moved.lines);
        self.lost += moved.lost;
        self.written = 0;
    }

    fn drain(&mut self) -> io::Result<()> {
        while self.written < self.text.len() {
            match self.sink.write(&self.text[self.written..]) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => self.written += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// A new sink with the bytes and lines of another, and the number of its unreadable lines.
struct Moved<S> {
    sink: S,
    bytes: u64,
    lines: usize,
    lost: usize,
}

/// Rows and events as lines in two sinks.
pub(super) struct Journal<S> {
    layout: Layout,
    samples: Lines<S>,
    events: Lines<S>,
    sync_every_rows: usize,
    unsynced_rows: usize,
    /// The first failed sync. It cannot be repeated: the system may have dropped the data.
    sync_error: Option<String>,
    error: Option<String>,
    status: RecorderStatus,
}

impl<S: Durable> Journal<S> {
    /// Writes the header at once. The samples are synced every `sync_every_rows` rows.
    pub(super) fn new(
        layout: Layout,
        samples: Lines<S>,
        events: Lines<S>,
        sync_every_rows: usize,
    ) -> Self {
        let mut journal = Self {
            samples,
            events,
            sync_every_rows: sync_every_rows.max(1),
            unsynced_rows: 0,
            sync_error: None,
            error: None,
            status: RecorderStatus::default(),
            layout,
        };
        let result = journal.samples.push(&journal.layout.header());
        journal.note(result);
        journal
    }

    pub(super) fn event(&mut self, event: &Event) {
        self.status.events += 1;
        let lost = self.events.lost;
        let result = self.events.push(&event.line());
        self.note(result);
        if lost == 0 && self.events.lost > 0 {
            self.report_loss("events", self.events.room.all);
        }
        let result = self.events.sink.sync();
        self.note_sync(result);
    }

    pub(super) fn finish(&mut self) {
        self.retry();
        self.sync();
    }

    /// Writes the waiting lines again.
    pub(super) fn retry(&mut self) {
        if self.status().bytes_waiting > 0 {
            let result = self.samples.drain().and(self.events.drain());
            self.note(result);
        }
    }

    /// Continues in new sinks, with all lines of the old ones and of the memory. On an error nothing has changed.
    pub(super) fn move_to(&mut self, samples: S, events: S) -> io::Result<()> {
        let samples = self.samples.moved_to(samples, &self.layout.header())?;
        let events = self.events.moved_to(events, "")?;
        self.samples.continue_in(samples);
        self.events.continue_in(events);
        (self.sync_error, self.error) = (None, None);
        let result = self.samples.drain().and(self.events.drain());
        self.note(result);
        self.sync();
        Ok(())
    }

    pub(super) fn status(&self) -> RecorderStatus {
        RecorderStatus {
            bytes_waiting: self.samples.bytes_waiting() + self.events.bytes_waiting(),
            rows_lost: self.samples.lost,
            events_lost: self.events.lost,
            ..self.status.clone()
        }
    }

    pub(super) const fn layout(&self) -> &Layout {
        &self.layout
    }

    pub(super) fn sync_error(&self) -> Option<&str> {
        self.sync_error.as_deref()
    }

    /// Both logs; `None` where one is not complete.
    pub(super) fn texts(&self) -> [Option<Vec<u8>>; 2] {
        [self.samples.whole(), self.events.whole()]
    }

    /// Reports in the status; a disk with changing errors must not fill the memory.
    pub(super) fn report(&mut self, text: String) {
        self.status.error.get_or_insert_with(|| text.clone());
        if self.status.messages.len() < 20 {
            self.status.messages.push(text);
        }
    }

    fn report_loss(&mut self, of: &str, room: usize) {
        let most = room >> 20;
        self.report(format!(
            "{most} MiB of {of} wait in memory and there is no room for more: {of} are lost from here on"
        ));
    }

    pub(super) fn rows(&mut self, rows: &[Row]) {
        let lost = self.samples.lost;
        for row in rows {
            self.samples.keep(&self.layout.line(row));
        }
        // Rows that come together are written together.
        let result = self.samples.drain();
        self.note(result);
        if lost == 0 && self.samples.lost > 0 {
            self.report_loss("rows", self.samples.room.all);
        }
        self.status.rows += rows.len();
        self.unsynced_rows += rows.len();
        if self.unsynced_rows >= self.sync_every_rows {
            self.unsynced_rows = 0;
            let result = self.samples.sink.sync();
            self.note_sync(result);
        }
    }

    fn sync(&mut self) {
        let synced = self.samples.sink.sync();
        self.note_sync(synced);
        let result = self.events.sink.sync();
        self.note_sync(result);
    }

    fn note_sync(&mut self, result: io::Result<()>) {
        if let Err(error) = result
            && self.sync_error.is_none()
        {
            self.sync_error = Some(error.to_string());
            self.report(format!(
                "the disk does not confirm what was written: {error}; the run goes on"
            ));
        }
    }

    /// Reports the begin and the end of an error.
    fn note(&mut self, result: io::Result<()>) {
        match result {
            Err(error) => {
                let reason = error.to_string();
                if self.error.as_ref() != Some(&reason) {
                    self.report(format!(
                        "the record cannot be written: {reason}; the run goes on, and what is not written waits in memory"
                    ));
                    self.error = Some(reason);
                }
            }
            Ok(()) if self.error.is_some() && self.status().bytes_waiting == 0 => {
                self.error = None;
                let lost = match (self.samples.lost, self.events.lost) {
                    (0, 0) => ", and is whole so far".to_owned(),
                    (rows, events) => format!("; {rows} rows and {events} events are lost"),
                };
                self.report(format!("the record can be written again{lost}"));
            }
            Ok(()) => {}
        }
    }
}

/// Records into memory; with the same input it gives the same bytes as [`super::Recorder`] writes.
pub struct MemoryRecorder {
    order: RowOrder,
    layout: Layout,
    /// The text of `samples.csv` so far.
    pub samples: String,
    /// The text of `events.jsonl` so far.
    pub events: String,
    status: RecorderStatus,
}

impl MemoryRecorder {
    pub fn new(layout: Layout) -> Self {
        Self {
            order: RowOrder::new(layout.clone()),
            samples: layout.header(),
            layout,
            events: String::new(),
            status: RecorderStatus::default(),
        }
    }

    /// The run as it would be read from disk.
    pub fn run(&self, name: &str) -> Result<Run, RecordingError> {
        read_csv(self.samples.as_bytes(), name, ReadOptions::default()).map(|(run, _)| run)
    }

    fn keep(&mut self) -> &[Row] {
        let rows = self.order.rows();
        self.samples.extend(rows.iter().map(|row| self.layout.line(row)));
        self.status.rows += rows.len();
        rows
    }
}

impl Record for MemoryRecorder {
    fn command(&mut self, command: &CommandRow) {
        self.order.command(*command);
    }

    fn row(&mut self, sample: &Sample) -> &[Row] {
        self.order.sample(sample);
        self.keep()
    }

    fn flush(&mut self) -> &[Row] {
        self.order.finish();
        self.keep()
    }

    fn event(&mut self, event: Event) {
        self.events.push_str(&event.line());
        self.status.events += 1;
    }

    fn status(&self) -> RecorderStatus {
        self.status.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::sample::Channel;

    /// A disk with so many bytes of room.
    #[derive(Debug, Default)]
    struct Disk {
        bytes: Vec<u8>,
        room: usize,
        unreadable_from: Option<usize>,
    }

    fn disk(room: usize) -> Disk {
        Disk { room, ..Disk::default() }
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let count = bytes.len().min(self.room - self.bytes.len());
            if count == 0 {
                return Err(io::Error::from_raw_os_error(28)); // ENOSPC
            }
            self.bytes.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Durable for Disk {
        fn sync(&mut self) -> io::Result<()> {
            Ok(())
        }

        fn read_at(&self, at: u64, into: &mut [u8]) -> io::Result<usize> {
            let at = usize::try_from(at).unwrap();
            let readable = self.unreadable_from.unwrap_or(self.bytes.len());
            if at == readable && self.unreadable_from.is_some() {
                return Err(io::Error::from_raw_os_error(5)); // EIO
            }
            (&self.bytes[at..readable]).read(into)
        }
    }

    fn room(written: usize, all: usize) -> Capacity {
        Capacity { written, all }
    }

    fn of(value: f64) -> Row {
        let mut row = Row::at(value);
        row.set(Channel::Current, Some(value));
        row
    }

    #[test]
    fn a_full_disk_loses_nothing_and_is_reported() {
        let layout = Layout::plain(&[Channel::Current]);
        let lines = |space| Lines::new(disk(space), room(100, 100_000));
        let mut journal = Journal::new(layout.clone(), lines(30), lines(1000), 10);
        let mut expected = layout.header();
        for row in 0..20_u32 {
            journal.rows(&[of(f64::from(row))]);
            expected = format!("{expected}{row},{row}\n");
        }
        let status = journal.status();
        assert_eq!(status.rows, 20);
        assert_eq!(status.bytes_waiting, expected.len() - 30);
        assert!(status.error.unwrap().contains("No space left"));
        assert_eq!(journal.samples.sink.bytes, &expected.as_bytes()[..30]);

        journal.samples.sink.room = 10_000; // someone made room
        journal.finish();
        assert_eq!(journal.status().bytes_waiting, 0);
        assert_eq!(journal.samples.sink.bytes, expected.as_bytes());
        let messages = journal.status().messages;
        assert_eq!(messages.len(), 2, "{messages:?}");
        assert!(messages[0].contains("No space left"), "{messages:?}");
        assert!(messages[1].contains("written again"), "{messages:?}");
        assert_eq!(journal.samples.whole().unwrap(), expected.as_bytes());
    }

    #[test]
    fn a_new_sink_begins_with_the_readable_lines_of_the_old() {
        let layout = Layout::plain(&[Channel::Current]);
        let header = layout.header();
        let rows = |range: std::ops::Range<u32>| -> String {
            range.fold(String::new(), |all, row| all + &format!("{row},{row}\n"))
        };
        let all = header.clone() + &rows(0..100);
        let unreadable = |from: &str| Some(from.len());
        let ten = header.clone() + &rows(0..10);
        let cases = [
            (None, all.clone()),
            // From the middle of a row on.
            (unreadable(&(ten.clone() + "1")), ten),
            (Some(0), header.clone()),
        ];
        for (unreadable_from, first) in cases {
            let lines = || Lines::new(disk(10_000), room(54, 1000));
            let mut journal = Journal::new(layout.clone(), lines(), lines(), 10);
            for row in 0..100_u32 {
                journal.rows(&[of(f64::from(row))]);
            }
            journal.samples.sink.unreadable_from = unreadable_from;
            // A sink that does not take it changes nothing.
            let before = format!("{:?}", journal.samples);
            assert!(journal.move_to(disk(5), disk(5)).is_err());
            assert_eq!(format!("{:?}", journal.samples), before);
            journal.move_to(disk(10_000), disk(10_000)).unwrap();
            let text = String::from_utf8(journal.samples.sink.bytes.clone()).unwrap();
            assert!(text.starts_with(&first), "{text}");
            assert!(all.ends_with(&text[first.len()..]), "{text}");
            let lost = journal.status().rows_lost;
            assert_eq!(lost == 0, unreadable_from.is_none());
            assert_eq!(text.lines().count() + lost, 101);
            journal.rows(&[of(100.0)]);
            assert!(journal.samples.sink.bytes.ends_with(b"99,99\n100,100\n"));
        }
    }

    #[test]
    fn rows_that_neither_disk_nor_memory_holds_are_counted() {
        let layout = Layout::plain(&[Channel::Current]);
        let lines = |space, all| Lines::new(disk(space), room(60, all));
        let row = |journal: &mut Journal<Disk>, value: f64| journal.rows(&[of(value)]);
        // With room on the disk the memory drops older lines, and nothing is lost.
        let mut journal = Journal::new(layout.clone(), lines(10_000, 60), lines(0, 0), 10);
        (0..100_u32).for_each(|count| row(&mut journal, f64::from(count)));
        assert_eq!(journal.status().rows_lost, 0);
        assert!(journal.status().messages.is_empty());
        assert_eq!(journal.samples.whole().unwrap(), journal.samples.sink.bytes);
        assert!(journal.samples.text.len() <= 60, "{:?}", journal.samples);
        // On a full disk rows beyond the memory are lost, which is reported once.
        let mut journal = Journal::new(layout.clone(), lines(20, 60), lines(0, 0), 10);
        (0..100_u32).for_each(|count| row(&mut journal, f64::from(count)));
        let status = journal.status();
        assert!((80..100).contains(&status.rows_lost), "{status:?}");
        assert_eq!(status.messages.len(), 2, "{status:?}");
        assert!(status.messages[1].contains("rows are lost"), "{status:?}");
        journal.event(&Event::new(0.0, None, "mark"));
        journal.event(&Event::new(0.0, None, "mark"));
        let status = journal.status();
        assert_eq!(status.events_lost, 2);
        assert!(status.messages[2].contains("events are lost"), "{status:?}");
        // After the disk is emptied the lost rows stay lost.
        journal.samples.sink.room = 10_000;
        row(&mut journal, 0.5);
        let status = journal.status();
        assert!(status.messages[3].contains("rows and 2 events are lost"), "{status:?}");
        // On another disk: a header, the remaining rows, and the new ones.
        journal.move_to(disk(10_000), disk(10_000)).unwrap();
        row(&mut journal, 100.0);
        let text = String::from_utf8(journal.samples.sink.bytes.clone()).unwrap();
        assert!(text.starts_with(&layout.header()), "{text}");
        assert!(text.ends_with("\n100,100\n"), "{text}");
    }

    #[test]
    fn an_event_is_one_line_and_its_first_keys_cannot_be_replaced() {
        let event = Event::new(0.5, Some(3), "trip")
            .with("limit", "current")
            .with("value_a", 9.5)
            .with("event", "other");
        assert_eq!(
            event.line(),
            "{\"time_s\":0.5,\"seq\":3,\"event\":\"trip\",\"limit\":\"current\",\"value_a\":9.5}\n"
        );
        let odd = Event::new(f64::NAN, None, "a\nb").line();
        assert_eq!(odd, "{\"time_s\":null,\"seq\":null,\"event\":\"a\\nb\"}\n");
    }
}
