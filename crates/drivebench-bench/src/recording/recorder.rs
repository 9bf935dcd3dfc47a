//! The recorder of a run on disk: a separate thread, so that a slow disk never delays a cycle.

use std::fs::{File, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::{FileExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::journal::{Capacity, Durable, Journal, Lines};
use super::{
    CommandRow, Event, Layout, Manifest, Record, RecorderStatus, RecordingError, Row, RowOrder,
    RunFolder,
};
use drivebench_model::sample::Sample;

enum Message {
    Rows(Vec<Row>),
    Event(Event),
}

/// Writes a run folder. Rows go through an unbounded channel: none is dropped, none waits for the disk.
///
/// Each write call contains the whole lines of rows that came together; events are synced one by one, samples at intervals. At
/// least once a second the folder is checked: one that is gone is created again with the whole record. Dropped without
/// [`Recorder::finish`], everything is still written, but the manifest stays at `"finished": false`.
pub struct Recorder {
    folder: RunFolder,
    order: RowOrder,
    sender: Option<Sender<Message>>,
    writer: Option<JoinHandle<Writer>>,
    status: Arc<Mutex<RecorderStatus>>,
}

pub struct KeptLogs(Option<Journal<Log>>);

impl KeptLogs {
    /// The text of `samples.csv`, from the open file and the memory; `None` where it is not complete.
    pub fn samples(&self) -> Option<Vec<u8>> {
        let [samples, _] = self.0.as_ref()?.texts();
        samples
    }

    /// Creates the run folder in another place, for a disk that fails; `None` where the logs are not complete. It has the
    /// permissions of the run's folder; where that is gone, those of its owner alone.
    pub fn rescue(
        &self,
        folder: &RunFolder,
        root: &Path,
        manifest: &Manifest,
    ) -> Option<Result<RunFolder, RecordingError>> {
        let [samples, events] = self.0.as_ref()?.texts();
        let (samples, events) = (samples?, events?);
        let found = std::fs::metadata(folder.path()).ok().filter(std::fs::Metadata::is_dir);
        let permissions =
            found.map_or_else(|| Permissions::from_mode(0o700), |found| found.permissions());
        let write = || {
            let folder = RunFolder::create(root, &manifest.stamp, &manifest.name)?;
            std::fs::set_permissions(folder.path(), permissions).map_err(|error| {
                RecordingError::io(folder.path(), "set the permissions of", &error)
            })?;
            let (mut to_samples, mut to_events) = folder.create_logs()?;
            to_samples
                .write_all(&samples)
                .and_then(|()| to_events.write_all(&events))
                .and_then(|()| to_samples.sync_data())
                .and_then(|()| to_events.sync_data())
                .map_err(|error| RecordingError::io(folder.path(), "write", &error))?;
            folder.write_manifest(manifest)?;
            Ok(folder)
        };
        Some(write())
    }
}

pub struct Kept {
    /// Another one than at the start, where that is gone.
    pub folder: RunFolder,
    pub status: RecorderStatus,
    pub logs: KeptLogs,
    /// Why the record on the disk is not complete; its manifest stays at `"finished": false`.
    pub error: Option<RecordingError>,
}

impl Recorder {
    /// Creates `samples.csv`, `events.jsonl` and a manifest with `"finished": false`.
    ///
    /// `sync_every_rows`: rows between two syncs of the samples; the rows of about one second.
    pub fn create(
        folder: RunFolder,
        layout: Layout,
        manifest: &Manifest,
        sync_every_rows: usize,
    ) -> Result<Self, RecordingError> {
        let (samples, events) = folder.create_logs()?;
        let logs = [Log(Ok(samples)), Log(Ok(events))];
        let mut writer = Writer::new(folder, layout, manifest, sync_every_rows, logs);
        writer.folder.write_manifest(&writer.unfinished)?;
        let identity = FolderIdentity::of(&writer.folder)
            .map_err(|error| RecordingError::io(writer.folder.path(), "look at", &error))?;
        writer.identity = Some(identity);
        Self::start(writer)
    }

    /// For the continuation of a run whose `folder` cannot be created for now: the record is kept in memory, and the folder is
    /// created as soon as possible.
    pub fn without_disk(
        folder: RunFolder,
        layout: Layout,
        manifest: &Manifest,
        sync_every_rows: usize,
        reason: &RecordingError,
    ) -> Result<Self, RecordingError> {
        let reason = reason.to_string();
        let logs = [Log(Err(reason.clone())), Log(Err(reason.clone()))];
        let mut writer = Writer::new(folder, layout, manifest, sync_every_rows, logs);
        writer.gone = Some(reason);
        Self::start(writer)
    }

    fn start(writer: Writer) -> Result<Self, RecordingError> {
        let folder = writer.folder.clone();
        let order = RowOrder::new(writer.journal.layout().clone());
        let status = Arc::new(Mutex::new(writer.journal.status()));
        let (sender, receiver) = channel();
        let shared = Arc::clone(&status);
        let writer = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || writer.write_all(&receiver, &shared))
            .map_err(|error| {
                RecordingError::io(folder.path(), "start the writer thread of", &error)
            })?;
        Ok(Self { folder, order, sender: Some(sender), writer: Some(writer), status })
    }

    /// The folder at the start.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Waits until everything is on the disk, then writes the manifest with the number of rows and `finished`. An `error` in the
    /// returned status was recovered from; the error beside it was not.
    pub fn finish(mut self, manifest: &Manifest) -> Kept {
        let Some(Ok(mut writer)) = self.close() else {
            return Kept {
                folder: self.folder.clone(),
                status: self.status(),
                logs: KeptLogs(None),
                error: Some(RecordingError::WriterGone {
                    path: self.folder.path().display().to_string(),
                }),
            };
        };
        let error = writer.close(manifest).err();
        Kept {
            folder: writer.folder,
            status: writer.journal.status(),
            logs: KeptLogs(Some(writer.journal)),
            error,
        }
    }

    /// Writes the commands that still wait. The thread ends when the channel is closed and empty.
    fn close(&mut self) -> Option<std::thread::Result<Writer>> {
        if self.sender.is_some() {
            self.flush();
        }
        drop(self.sender.take());
        self.writer.take().map(JoinHandle::join)
    }

    fn send(&self, message: Message) {
        let sender = self.sender.as_ref();
        let sent = sender.is_some_and(|sender| sender.send(message).is_ok());
        let mut status = lock(&self.status);
        if !sent && status.error.is_none() {
            let text = "the writer thread of the record is gone: nothing is recorded any more";
            status.error = Some(text.to_owned());
            status.messages.push(text.to_owned());
        }
    }
}

impl Record for Recorder {
    fn command(&mut self, command: &CommandRow) {
        self.order.command(*command);
    }

    fn row(&mut self, sample: &Sample) -> &[Row] {
        let rows = self.order.sample(sample).to_vec();
        self.send(Message::Rows(rows));
        self.order.rows()
    }

    fn flush(&mut self) -> &[Row] {
        let rows = self.order.finish().to_vec();
        self.send(Message::Rows(rows));
        self.order.rows()
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
        // The manifest stays at `"finished": false`.
        let _ = self.close();
    }
}

/// Device and inode of the folder and of its two logs. A deleted or renamed folder leaves the logs open, and what is written to
/// them is lost.
#[derive(Debug, PartialEq, Eq)]
struct FolderIdentity([(u64, u64); 3]);

impl FolderIdentity {
    fn of(folder: &RunFolder) -> io::Result<Self> {
        let number = |path: &Path| {
            let found = std::fs::metadata(path)?;
            Ok::<_, io::Error>((found.dev(), found.ino()))
        };
        Ok(Self([number(folder.path())?, number(&folder.samples())?, number(&folder.events())?]))
    }
}

/// A log of the folder, as long as there is one.
#[derive(Debug)]
struct Log(Result<File, String>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.0 {
            Ok(file) => file.write(bytes),
            Err(reason) => Err(io::Error::other(reason.clone())),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Durable for Log {
    fn sync(&mut self) -> io::Result<()> {
        self.0.as_ref().map_or(Ok(()), File::sync_data)
    }

    fn read_at(&self, at: u64, into: &mut [u8]) -> io::Result<usize> {
        self.0.as_ref().map_or(Ok(0), |file| file.read_at(into, at))
    }
}

struct Writer {
    journal: Journal<Log>,
    folder: RunFolder,
    /// `None` before there was one.
    identity: Option<FolderIdentity>,
    /// Why the folder, which is gone, cannot be created again.
    gone: Option<String>,
    /// Checks to skip before the next trial, and those skipped before the last one: each trial copies the whole log.
    checks_to_skip: u32,
    checks_skipped: u32,
    unfinished: Manifest,
    /// Rows and events between two checks of the folder.
    check_every: usize,
}

impl Writer {
    fn new(
        folder: RunFolder,
        layout: Layout,
        manifest: &Manifest,
        sync_every_rows: usize,
        [samples, events]: [Log; 2],
    ) -> Self {
        Self {
            journal: Journal::new(
                layout,
                Lines::new(samples, Capacity::SAMPLES),
                Lines::new(events, Capacity::EVENTS),
                sync_every_rows,
            ),
            folder,
            identity: None,
            gone: None,
            checks_to_skip: 0,
            checks_skipped: 0,
            unfinished: Manifest { finished: false, rows: None, ..manifest.clone() },
            check_every: sync_every_rows.max(1),
        }
    }

    fn write_all(mut self, receiver: &Receiver<Message>, status: &Mutex<RecorderStatus>) -> Self {
        let mut unchecked = 0;
        loop {
            match receiver.recv_timeout(Duration::from_millis(500)) {
                Ok(Message::Rows(rows)) => {
                    self.journal.rows(&rows);
                    unchecked += rows.len();
                }
                Ok(Message::Event(event)) => {
                    self.journal.event(&event);
                    unchecked += 1;
                }
                Err(RecvTimeoutError::Timeout) => unchecked = self.check_every + 1,
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if unchecked > self.check_every {
                unchecked = 0;
                self.check_folder();
            }
            *lock(status) = self.journal.status();
        }
        self.journal.finish();
        self.checks_to_skip = 0;
        self.check_folder();
        *lock(status) = self.journal.status();
        self
    }

    /// Creates the folder again if it is gone.
    fn check_folder(&mut self) {
        use io::ErrorKind::{NotADirectory, NotFound};
        let is_same = match FolderIdentity::of(&self.folder) {
            Ok(identity) => self.identity.as_ref() == Some(&identity),
            // After another error it may still exist: a write shows it.
            Err(error) => !matches!(error.kind(), NotFound | NotADirectory),
        };
        if is_same && self.gone.is_none() {
            self.journal.retry();
        } else {
            self.create_again();
        }
    }

    fn create_again(&mut self) {
        if self.checks_to_skip > 0 {
            self.checks_to_skip -= 1;
            return;
        }
        let old = self.folder.path().display().to_string();
        let lost = self.journal.status().rows_lost;
        let what = match self.identity {
            Some(_) => "was deleted or renamed",
            None => "could not be made",
        };
        match self.recreate() {
            Ok(()) => {
                let new = self.folder.path().display();
                let lost = self.journal.status().rows_lost - lost;
                let rest = match lost {
                    0 => String::new(),
                    lost => {
                        format!(", without {lost} rows, which could not be read from the old file")
                    }
                };
                (self.gone, self.checks_skipped) = (None, 0);
                self.journal
                    .report(format!("{old} {what}; the record is made again in {new}{rest}"));
            }
            Err(error) => {
                // Up to a minute while nothing comes.
                self.checks_skipped = (2 * self.checks_skipped).clamp(1, 120);
                self.checks_to_skip = self.checks_skipped;
                let reason = error.to_string();
                if self.gone.as_ref() != Some(&reason) {
                    self.journal.report(format!(
                        "{old} {what}, and the record cannot be made again: {reason}; the run goes on, and is kept in memory"
                    ));
                    self.gone = Some(reason);
                }
            }
        }
    }

    fn recreate(&mut self) -> Result<(), RecordingError> {
        let folder = self.folder.again()?;
        match self.move_to(&folder) {
            Ok(identity) => {
                (self.identity, self.folder) = (Some(identity), folder);
                Ok(())
            }
            Err(error) => {
                // An incomplete copy of the record.
                let _ = std::fs::remove_dir_all(folder.path());
                Err(error)
            }
        }
    }

    fn move_to(&mut self, folder: &RunFolder) -> Result<FolderIdentity, RecordingError> {
        let (samples, events) = folder.create_logs()?;
        folder.write_manifest(&self.unfinished)?;
        let failed = |doing| move |error| RecordingError::io(folder.path(), doing, &error);
        let identity = FolderIdentity::of(folder).map_err(failed("look at"))?;
        self.journal
            .move_to(Log(Ok(samples)), Log(Ok(events)))
            .map_err(failed("move the record to"))?;
        Ok(identity)
    }

    fn close(&mut self, manifest: &Manifest) -> Result<(), RecordingError> {
        let status = self.journal.status();
        let failed = |reason: String| RecordingError::Io {
            path: self.folder.samples().display().to_string(),
            doing: "write all rows",
            reason,
        };
        if let Some(reason) = &self.gone {
            return Err(failed(reason.clone()));
        }
        if status.bytes_waiting > 0 {
            return Err(failed(status.error.unwrap_or_else(|| "unknown".into())));
        }
        if status.rows_lost + status.events_lost > 0 {
            let (rows, events) = (status.rows_lost, status.events_lost);
            return Err(failed(format!("{rows} rows and {events} events are lost")));
        }
        if let Some(reason) = self.journal.sync_error() {
            return Err(failed(reason.to_owned()));
        }
        let rows = Some(status.rows);
        self.folder.write_manifest(&Manifest { finished: true, rows, ..manifest.clone() })?;
        Ok(())
    }
}

/// A status is whole after every assignment, so a panic elsewhere cannot have broken it.
fn lock(status: &Mutex<RecorderStatus>) -> std::sync::MutexGuard<'_, RecorderStatus> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
#[path = "recorder_tests.rs"]
mod tests;
