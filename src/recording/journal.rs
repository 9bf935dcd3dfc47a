//! What the recorders have in common: rows and events as whole lines, kept in memory while they cannot be written.

use std::fs::File;
use std::io::{self, Write};

use serde_json::{Map, Value};

use super::{CommandRow, Layout, Row, RowOrder};
use crate::sample::Sample;

/// Something that happened and is no sample: a key, a re-arm, a lost deadline, a trip. Replay needs every one.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// On the samples' time axis, s.
    pub time_s: f64,
    /// Sequence number of the exchange that it belongs to.
    pub seq: Option<u64>,
    /// Short name: `trip`, `key`, `deadline_lost`.
    pub event: String,
    pub details: Map<String, Value>,
}

impl Event {
    pub fn new(time_s: f64, seq: Option<u64>, event: impl Into<String>) -> Self {
        Self {
            time_s,
            seq,
            event: event.into(),
            details: Map::new(),
        }
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

/// Where a session puts what it sees. Nothing is ever refused: trouble shows in [`Record::status`].
pub trait Record {
    fn row(&mut self, sample: &Sample);
    fn command(&mut self, command: &CommandRow);
    fn event(&mut self, event: Event);
    fn status(&self) -> RecorderStatus;
}

/// How recording goes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Rows handed to the file, written or waiting.
    pub rows: usize,
    pub events: usize,
    /// Bytes that wait in memory because the file could not take them.
    pub bytes_waiting: usize,
    /// Samples left out because the drive had sampled nothing new.
    pub repeats: usize,
    /// Commands of which the drive never said when they were applied.
    pub unconfirmed: usize,
    /// The first trouble with the disk; it is over when no bytes wait.
    pub error: Option<String>,
}

/// A byte sink that can be made durable.
pub(super) trait Durable: Write {
    fn sync(&mut self) -> io::Result<()>;
}

impl Durable for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

impl Durable for Vec<u8> {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Lines into a sink: one write call each. What the sink does not take waits and goes first the next time.
pub(super) struct Lines<S> {
    pub(super) sink: S,
    waiting: Vec<u8>,
}

impl<S: Durable> Lines<S> {
    pub(super) fn new(sink: S) -> Self {
        Self {
            sink,
            waiting: Vec::new(),
        }
    }

    pub(super) fn push(&mut self, line: &str) -> io::Result<()> {
        self.waiting.extend_from_slice(line.as_bytes());
        self.drain()
    }

    pub(super) fn bytes_waiting(&self) -> usize {
        self.waiting.len()
    }

    fn drain(&mut self) -> io::Result<()> {
        let mut done = 0;
        let result = loop {
            if done == self.waiting.len() {
                break Ok(());
            }
            match self.sink.write(&self.waiting[done..]) {
                Ok(0) => break Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => done += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => break Err(error),
            }
        };
        self.waiting.drain(..done);
        result
    }
}

/// Puts rows in order, makes lines of them and writes them; the one path of the threaded and the in-memory recorder.
pub(super) struct Journal<S> {
    order: RowOrder,
    layout: Layout,
    samples: Lines<S>,
    events: Lines<S>,
    sync_every_rows: usize,
    unsynced_rows: usize,
    status: RecorderStatus,
    rows: Vec<Row>,
    line: String,
}

impl<S: Durable> Journal<S> {
    /// Writes the header at once. The samples are synced every `sync_every_rows` rows.
    pub(super) fn new(layout: Layout, samples: S, events: S, sync_every_rows: usize) -> Self {
        let mut journal = Self {
            order: RowOrder::new(layout.clone()),
            samples: Lines::new(samples),
            events: Lines::new(events),
            sync_every_rows: sync_every_rows.max(1),
            unsynced_rows: 0,
            status: RecorderStatus::default(),
            rows: Vec::new(),
            line: String::new(),
            layout,
        };
        let result = journal.samples.push(&journal.layout.header());
        journal.note(result);
        journal
    }

    pub(super) fn row(&mut self, sample: &Sample) {
        self.order.sample(sample, &mut self.rows);
        self.write_rows();
    }

    pub(super) fn command(&mut self, command: CommandRow) {
        self.order.command(command);
    }

    pub(super) fn event(&mut self, event: &Event) {
        self.status.events += 1;
        let result = self
            .events
            .push(&event.line())
            .and_then(|()| self.events.sink.sync());
        self.note(result);
    }

    /// Writes the commands that still wait, tries once more what could not be written, and syncs.
    pub(super) fn finish(&mut self) {
        self.order.finish(&mut self.rows);
        self.write_rows();
        for lines in [&mut self.samples, &mut self.events] {
            let result = lines.drain().and_then(|()| lines.sink.sync());
            if let Err(error) = result {
                self.status.error.get_or_insert_with(|| error.to_string());
            }
        }
    }

    pub(super) fn status(&self) -> RecorderStatus {
        RecorderStatus {
            bytes_waiting: self.samples.bytes_waiting() + self.events.bytes_waiting(),
            repeats: self.order.repeats(),
            unconfirmed: self.order.unconfirmed(),
            ..self.status.clone()
        }
    }

    pub(super) fn sinks(&self) -> (&S, &S) {
        (&self.samples.sink, &self.events.sink)
    }

    fn write_rows(&mut self) {
        let mut rows = std::mem::take(&mut self.rows);
        for row in rows.drain(..) {
            self.layout.format(&row, &mut self.line);
            let result = self.samples.push(&self.line);
            self.note(result);
            self.status.rows += 1;
            self.unsynced_rows += 1;
        }
        self.rows = rows;
        if self.unsynced_rows >= self.sync_every_rows {
            self.unsynced_rows = 0;
            let result = self.samples.sink.sync();
            self.note(result);
        }
    }

    fn note(&mut self, result: io::Result<()>) {
        if let Err(error) = result {
            self.status.error.get_or_insert_with(|| error.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Channel;

    /// A disk with so many bytes of room.
    #[derive(Default)]
    struct Disk {
        bytes: Vec<u8>,
        room: usize,
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
    }

    #[test]
    fn a_full_disk_loses_nothing_and_is_reported() {
        let layout = Layout::plain(&[Channel::Current]);
        let disk = |room| Disk {
            room,
            ..Disk::default()
        };
        let mut journal = Journal::new(layout.clone(), disk(30), disk(1000), 10);
        let mut expected = layout.header();
        for row in 0..20_u32 {
            let value = f64::from(row);
            journal.row(&Sample::at(value).with(Channel::Current, value));
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
