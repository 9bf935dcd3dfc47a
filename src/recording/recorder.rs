//! The recorder of a run on disk: a thread of its own, so that a slow disk never delays a cycle.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::journal::{Durable, Journal};
use super::{
    CommandRow, Event, Layout, Manifest, Record, RecorderStatus, RecordingError, RunFolder,
};
use crate::sample::Sample;

enum Message {
    Sample(Sample),
    Command(CommandRow),
    Event(Event),
}

/// Writes a run folder. Rows travel over an unbounded channel: none is dropped, none waits for the disk.
///
/// Each row is one write call of a whole line; events are synced one by one, samples every so many rows. Dropped without
/// [`Recorder::finish`], everything is still written, but the manifest goes on saying that the run is not finished.
pub struct Recorder {
    folder: RunFolder,
    sender: Option<Sender<Message>>,
    writer: Option<JoinHandle<()>>,
    status: Arc<Mutex<RecorderStatus>>,
}

impl Recorder {
    /// Makes `samples.csv`, `events.jsonl` and a manifest that says `"finished": false`.
    ///
    /// `sync_every_rows`: rows between two syncs of the samples; the rows of about one second.
    pub fn create(
        folder: RunFolder,
        layout: Layout,
        manifest: &Manifest,
        sync_every_rows: usize,
    ) -> Result<Self, RecordingError> {
        let (samples, events) = folder.create_logs()?;
        let unfinished = Manifest {
            finished: false,
            rows: None,
            ..manifest.clone()
        };
        folder.write_manifest(&unfinished)?;
        let journal = Journal::new(layout, samples, events, sync_every_rows);
        let status = Arc::new(Mutex::new(journal.status()));
        let (sender, receiver) = channel();
        let shared = Arc::clone(&status);
        let writer = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || write_all(journal, &receiver, &shared))
            .map_err(|error| {
                RecordingError::io(folder.path(), "start the writer thread of", &error)
            })?;
        Ok(Self {
            folder,
            sender: Some(sender),
            writer: Some(writer),
            status,
        })
    }

    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Waits until everything is on the disk, then writes the manifest with the number of rows and `finished`. Returns
    /// the last status; an `error` in it was got over.
    ///
    /// # Errors
    /// What could not be written, if anything: then the manifest is left saying that the run is not finished.
    pub fn finish(mut self, manifest: &Manifest) -> Result<RecorderStatus, RecordingError> {
        self.close()?;
        let status = self.status();
        if status.bytes_waiting > 0 {
            return Err(RecordingError::Io {
                path: self.folder.samples().display().to_string(),
                doing: "write all rows",
                reason: status.error.unwrap_or_else(|| "unknown".into()),
            });
        }
        self.folder.write_manifest(&Manifest {
            finished: true,
            rows: Some(status.rows),
            ..manifest.clone()
        })?;
        Ok(status)
    }

    fn close(&mut self) -> Result<(), RecordingError> {
        // The thread ends when the channel is closed and empty.
        drop(self.sender.take());
        match self.writer.take().map(JoinHandle::join) {
            Some(Err(_)) => Err(RecordingError::WriterGone {
                path: self.folder.path().display().to_string(),
            }),
            _ => Ok(()),
        }
    }

    fn send(&self, message: Message) {
        let sent = match &self.sender {
            Some(sender) => sender.send(message).is_ok(),
            None => false,
        };
        if !sent {
            lock(&self.status)
                .error
                .get_or_insert_with(|| "the writer thread is gone".into());
        }
    }
}

impl Record for Recorder {
    fn row(&mut self, sample: &Sample) {
        self.send(Message::Sample(sample.clone()));
    }

    fn command(&mut self, command: &CommandRow) {
        self.send(Message::Command(*command));
    }

    fn event(&mut self, event: Event) {
        self.send(Message::Event(event));
    }

    fn status(&self) -> RecorderStatus {
        lock(&self.status).clone()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Nobody is left to tell; the manifest still says that the run is not finished.
        let _ = self.close();
    }
}

fn write_all<S: Durable>(
    mut journal: Journal<S>,
    receiver: &Receiver<Message>,
    status: &Mutex<RecorderStatus>,
) {
    for message in receiver {
        match message {
            Message::Sample(sample) => journal.row(&sample),
            Message::Command(command) => journal.command(command),
            Message::Event(event) => journal.event(&event),
        }
        *lock(status) = journal.status();
    }
    journal.finish();
    *lock(status) = journal.status();
}

/// A status is whole after every assignment, so a panic elsewhere cannot have broken it.
fn lock(status: &Mutex<RecorderStatus>) -> std::sync::MutexGuard<'_, RecorderStatus> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
#[path = "recorder_tests.rs"]
mod tests;
