//! The wire tap: every frame of a link into a capture file that Wireshark opens.
//!
//! ```text
//! link --sent, received--> Tap (frames.rs: where a frame ends; packet.rs: how it is wrapped)
//!                           '--bounded queue--> thread --> FILE (pcap, nanoseconds)
//! ```
//!
//! The link never waits for the file: what the queue cannot take is counted and lost, and a file that fails is told
//! once at the end. Link types: Modbus RTU 147 (user 0), our own stream 148 (user 1), Modbus TCP as IP packets (101).

mod frames;
mod packet;
mod port;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::guard::now;
use frames::{Received, Splitting};
use packet::{Conversation, file_header, record};

pub(super) use port::TappedPort;

/// Frames that wait for the disk; at 1 kHz some seconds.
const QUEUE: usize = 8192;

/// Link types of the file (the first two are Wireshark's for private use).
const RTU: u32 = 147;
const STREAM: u32 = 148;
const IP: u32 = 101;

enum Message {
    Bytes(Vec<u8>),
    End,
}

/// The capture file of one link.
pub struct TapFile {
    path: PathBuf,
    sender: SyncSender<Message>,
    writer: Option<JoinHandle<io::Result<()>>>,
    lost: Arc<AtomicU64>,
    /// The file has its header: it gets one, however many links are tapped.
    is_begun: AtomicBool,
    /// Wall clock at a moment of the monotonic one.
    wall: Duration,
    origin: Instant,
}

impl TapFile {
    /// A new file; `wall` is the present time, for the stamps.
    ///
    /// # Errors
    /// The file exists already, or cannot be made.
    pub fn create(path: &Path, wall: SystemTime) -> io::Result<Self> {
        let file = File::create_new(path)?;
        let (sender, receiver) = sync_channel(QUEUE);
        let writer = std::thread::Builder::new()
            .name("tap".to_owned())
            .spawn(move || write(file, &receiver))?;
        Ok(Self {
            path: path.to_owned(),
            sender,
            writer: Some(writer),
            lost: Arc::default(),
            is_begun: AtomicBool::new(false),
            wall: wall.duration_since(UNIX_EPOCH).unwrap_or_default(),
            origin: now(),
        })
    }

    pub(super) fn rtu(&self) -> Tap {
        self.tap(RTU, Splitting::Rtu, None)
    }

    pub(super) fn stream(&self) -> Tap {
        self.tap(STREAM, Splitting::Zeros, None)
    }

    pub(super) fn tcp(&self, ours: SocketAddr, peer: SocketAddr) -> Tap {
        self.tap(IP, Splitting::None, Some(Conversation::new(ours, peer)))
    }

    fn tap(&self, link_type: u32, splitting: Splitting, conversation: Option<Conversation>) -> Tap {
        let tap = Tap {
            sender: self.sender.clone(),
            lost: Arc::clone(&self.lost),
            wall: self.wall,
            origin: self.origin,
            sent: Received::new(splitting),
            received: Received::new(splitting),
            conversation,
        };
        // A port that is opened again, as in a scan, goes on with the same file.
        if !self.is_begun.swap(true, Ordering::Relaxed) {
            tap.queue(file_header(link_type));
        }
        tap
    }

    /// Everything into the file; what went wrong, in words.
    pub fn finish(mut self) -> Result<(), String> {
        let result = self.end();
        let path = self.path.display();
        let lost = self.lost.load(Ordering::Relaxed);
        match result {
            Err(error) => Err(format!("{path}: the capture is not complete: {error}")),
            Ok(()) if lost > 0 => Err(format!(
                "{path}: {lost} frames are not in the capture: the disk was too slow"
            )),
            Ok(()) => Ok(()),
        }
    }

    fn end(&mut self) -> io::Result<()> {
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        // A writer that has failed hears nothing more, and its result says why.
        let _ = self.sender.send(Message::End);
        writer
            .join()
            .unwrap_or_else(|_| Err(io::Error::other("the writer broke off")))
    }
}

impl Drop for TapFile {
    fn drop(&mut self) {
        // Whoever wants to know what went wrong asks `finish`.
        let _ = self.end();
    }
}

/// One link's end of a capture.
pub(super) struct Tap {
    sender: SyncSender<Message>,
    lost: Arc<AtomicU64>,
    wall: Duration,
    origin: Instant,
    sent: Received,
    received: Received,
    conversation: Option<Conversation>,
}

impl Tap {
    /// Bytes that have gone out.
    pub(super) fn sent(&mut self, bytes: &[u8]) {
        // What was left of a reply when the next request goes out makes no frame any more.
        if let Some(rest) = self.received.rest() {
            self.record(&rest, false);
        }
        self.sent.push(bytes);
        while let Some(frame) = self.sent.frame() {
            self.record(&frame, true);
        }
    }

    /// Bytes that have come in, in any pieces.
    pub(super) fn received(&mut self, bytes: &[u8]) {
        if let Some(rest) = self.sent.rest() {
            self.record(&rest, true);
        }
        self.received.push(bytes);
        while let Some(frame) = self.received.frame() {
            self.record(&frame, false);
        }
    }

    fn record(&mut self, frame: &[u8], is_sent: bool) {
        let at = self.wall + now().saturating_duration_since(self.origin);
        let bytes = match &mut self.conversation {
            Some(conversation) => record(at, &conversation.packet(frame, is_sent)),
            None => record(at, frame),
        };
        self.queue(bytes);
    }

    fn queue(&self, bytes: Vec<u8>) {
        if self.sender.try_send(Message::Bytes(bytes)).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        for is_sent in [true, false] {
            let side = if is_sent {
                &mut self.sent
            } else {
                &mut self.received
            };
            if let Some(rest) = side.rest() {
                self.record(&rest, is_sent);
            }
        }
    }
}

/// Writes until the end; flushed whenever nothing waits, so that a killed program leaves what it has seen.
fn write(file: File, messages: &Receiver<Message>) -> io::Result<()> {
    let mut file = BufWriter::new(file);
    loop {
        let message = match messages.try_recv() {
            Ok(message) => message,
            Err(TryRecvError::Empty) => {
                file.flush()?;
                match messages.recv() {
                    Ok(message) => message,
                    Err(_) => return Ok(()),
                }
            }
            Err(TryRecvError::Disconnected) => return file.flush(),
        };
        match message {
            Message::Bytes(bytes) => file.write_all(&bytes)?,
            Message::End => return file.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn records(bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut at = 24;
        let mut found = Vec::new();
        while at < bytes.len() {
            let length = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap()) as usize;
            found.push(bytes[at + 16..at + 16 + length].to_vec());
            at += 16 + length;
        }
        found
    }

    #[test]
    fn a_capture_holds_each_frame_once_and_names_its_link_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("line.pcap");
        let file = TapFile::create(&path, UNIX_EPOCH + Duration::from_secs(9)).unwrap();
        let request = [1, 3, 0, 0, 0, 1, 0x84, 0x0A];
        let reply = [1, 3, 2, 0, 7, 0xF9, 0x86];
        let mut tap = file.rtu();
        tap.sent(&request);
        tap.received(&reply[..3]);
        tap.received(&reply[3..]);
        // Rubbish is kept as it came.
        tap.received(&[0xFF, 0xFE]);
        tap.sent(&request);
        drop(tap);
        assert_eq!(file.finish(), Ok(()));
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes[..4], 0xA1B2_3C4D_u32.to_le_bytes());
        assert_eq!(bytes[20..24], 147_u32.to_le_bytes());
        assert_eq!(bytes[24..28], 9_u32.to_le_bytes());
        assert_eq!(
            records(&bytes),
            [&request[..], &reply, &[0xFF, 0xFE], &request]
        );
        assert!(TapFile::create(&path, UNIX_EPOCH).is_err(), "overwritten");
    }

    #[test]
    fn a_full_disk_is_told_and_stops_nobody() {
        // The device takes nothing: every write fails as on a full disk.
        let full = File::options().write(true).open("/dev/full").unwrap();
        let (sender, receiver) = sync_channel(QUEUE);
        let writer = std::thread::spawn(move || write(full, &receiver));
        let file = TapFile {
            path: "full.pcap".into(),
            sender,
            writer: Some(writer),
            lost: Arc::default(),
            is_begun: AtomicBool::new(false),
            wall: Duration::ZERO,
            origin: now(),
        };
        let mut tap = file.stream();
        for _ in 0..2 * QUEUE {
            tap.sent(&[1, 2, 0]);
        }
        let told = file.finish().unwrap_err();
        assert!(
            told.starts_with("full.pcap: the capture is not complete"),
            "{told}"
        );
    }
}
