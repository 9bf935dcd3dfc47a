//! The recorder of virtual time: the same lines as on disk, in memory.

use std::io::{Sink, sink};

use super::journal::{Journal, Lines};
use super::{
    CommandRow, Event, Layout, ReadOptions, Record, RecorderStatus, RecordingError, read_csv,
};
use crate::sample::{Run, Sample};

/// Records into memory; with the same input it gives the same bytes as [`super::Recorder`] writes.
pub struct MemoryRecorder {
    journal: Journal<Sink>,
}

impl MemoryRecorder {
    pub fn new(layout: Layout) -> Self {
        let lines = || Lines::new(sink(), usize::MAX);
        Self {
            journal: Journal::new(layout, lines(), lines(), usize::MAX),
        }
    }

    /// Writes the commands that still wait for their instant; to be called once at the end.
    pub fn finish(&mut self) {
        self.journal.finish();
    }

    /// The text of `samples.csv` so far.
    pub fn samples_csv(&self) -> String {
        text(self.journal.texts().0)
    }

    /// The text of `events.jsonl` so far.
    pub fn events_jsonl(&self) -> String {
        text(self.journal.texts().1)
    }

    /// The run as it would be read from disk.
    pub fn run(&self, name: &str) -> Result<Run, RecordingError> {
        let bytes = self.journal.texts().0.unwrap_or_default();
        read_csv(bytes, name, ReadOptions::default()).map(|(run, _)| run)
    }
}

fn text(bytes: Option<&[u8]>) -> String {
    String::from_utf8_lossy(bytes.unwrap_or_default()).into_owned()
}

impl Record for MemoryRecorder {
    fn row(&mut self, sample: &Sample) {
        self.journal.row(sample);
    }

    fn command(&mut self, command: &CommandRow) {
        self.journal.command(*command);
    }

    fn event(&mut self, event: Event) {
        self.journal.event(&event);
    }

    fn status(&self) -> RecorderStatus {
        self.journal.status()
    }
}
