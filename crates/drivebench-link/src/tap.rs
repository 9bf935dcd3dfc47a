//! Wire tap: every frame of a link into a capture file for Wireshark.
//!
//! ```text
//! link --TappedPort--> Tap (Received: where a frame ends; Conversation: how it is wrapped)
//!                       '--bounded queue--> thread --> FILE (pcap, nanoseconds)
//! ```
//!
//! The link never waits for the file: frames beyond the queue are dropped and counted, and a failed write is reported once at the
//! end. Link types: Modbus RTU 147 (user 0), our own stream 148 (user 1), Modbus TCP as IP packets (101).

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::task::{Context, Poll};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use firmware_protocol::modbus::{request_len, response_len};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::framing::{FrameKind, rtu_frame_len};
use super::reply_filter::Port;
use super::waiting::now;

/// Frames that wait for the disk; at 1 kHz some seconds.
const QUEUE: usize = 8192;

enum Message {
    Bytes(Vec<u8>),
    End,
}

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

    /// Of a serial line, in pieces as they come where only the language itself separates its frames.
    pub(super) fn of(&self, kind: FrameKind) -> Tap {
        // LINKTYPE_USER0 of pcap, for private use, and the next ones.
        match kind {
            FrameKind::Rtu | FrameKind::Tcp => self.tap(147, Splitting::Rtu, None),
            FrameKind::Stream => self.tap(148, Splitting::Zeros, None),
            FrameKind::Vesc => self.tap(149, Splitting::None, None),
            FrameKind::Dynamixel => self.tap(150, Splitting::None, None),
            FrameKind::Lines => self.tap(151, Splitting::None, None),
        }
    }

    pub(super) fn tcp(&self, ours: SocketAddr, peer: SocketAddr) -> Tap {
        // LINKTYPE_RAW: IP packets.
        self.tap(101, Splitting::None, Some(Conversation::new(ours, peer)))
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
            Ok(()) if lost > 0 => {
                Err(format!("{path}: {lost} frames are not in the capture: the disk was too slow"))
            }
            Ok(()) => Ok(()),
        }
    }

    fn end(&mut self) -> io::Result<()> {
        let Some(writer) = self.writer.take() else { return Ok(()) };
        // A writer that has failed takes nothing more; its result holds the reason.
        let _ = self.sender.send(Message::End);
        writer.join().unwrap_or_else(|_| Err(io::Error::other("the writer broke off")))
    }
}

impl Drop for TapFile {
    fn drop(&mut self) {
        // The result is that of `finish`.
        let _ = self.end();
    }
}

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
            Some(conversation) => record_bytes(at, &conversation.packet(frame, is_sent)),
            None => record_bytes(at, frame),
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
        for (rest, is_sent) in [(self.sent.rest(), true), (self.received.rest(), false)] {
            if let Some(rest) = rest {
                self.record(&rest, is_sent);
            }
        }
    }
}

/// Writes until the end; flushes whenever the queue is empty, so that a killed program leaves its frames in the file.
fn write(file: File, messages: &Receiver<Message>) -> io::Result<()> {
    let mut file = BufWriter::new(file);
    loop {
        let message = match messages.try_recv() {
            Err(TryRecvError::Empty) => {
                file.flush()?;
                messages.recv().ok()
            }
            message => message.ok(),
        };
        match message {
            Some(Message::Bytes(bytes)) => file.write_all(&bytes)?,
            Some(Message::End) | None => return file.flush(),
        }
    }
}

pub(super) struct TappedPort<P> {
    port: P,
    tap: Tap,
}

impl<P> TappedPort<P> {
    pub(super) fn new(port: P, tap: Tap) -> Self {
        Self { port, tap }
    }
}

impl AsyncRead for TappedPort<Box<dyn Port>> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let this = &mut *self;
        let result = Pin::new(&mut this.port).poll_read(cx, buffer);
        let new = &buffer.filled()[before..];
        if !new.is_empty() {
            this.tap.received(new);
        }
        result
    }
}

impl AsyncWrite for TappedPort<Box<dyn Port>> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        let result = Pin::new(&mut this.port).poll_write(cx, bytes);
        if let Poll::Ready(Ok(count)) = result {
            this.tap.sent(&bytes[..count]);
        }
        result
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

/// Bytes that make no frame are written as a record of this length at the latest.
const MOST: usize = 1024;

/// What separates frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Splitting {
    /// Length by function code, and checksum.
    Rtu,
    /// A zero after each.
    Zeros,
    /// Nothing: pieces as they come.
    None,
}

/// Bytes of one direction that are no whole frame yet.
struct Received {
    splitting: Splitting,
    bytes: Vec<u8>,
}

impl Received {
    const fn new(splitting: Splitting) -> Self {
        Self { splitting, bytes: Vec::new() }
    }

    fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn frame(&mut self) -> Option<Vec<u8>> {
        let whole = match self.splitting {
            Splitting::Rtu => rtu_length(&self.bytes),
            Splitting::Zeros => self.bytes.iter().position(|b| *b == 0).map(|at| at + 1),
            Splitting::None => (!self.bytes.is_empty()).then_some(self.bytes.len()),
        };
        let too_long = (self.bytes.len() > MOST).then_some(MOST);
        let length = whole.or(too_long)?;
        let rest = self.bytes.split_off(length);
        Some(std::mem::replace(&mut self.bytes, rest))
    }

    fn rest(&mut self) -> Option<Vec<u8>> {
        (!self.bytes.is_empty()).then(|| std::mem::take(&mut self.bytes))
    }
}

/// Length of a frame with a right checksum at the start: a request (an echo too) or a reply.
fn rtu_length(bytes: &[u8]) -> Option<usize> {
    rtu_frame_len(bytes, request_len).or_else(|| rtu_frame_len(bytes, response_len))
}

/// Longest frame of the file, bytes.
const LONGEST: u32 = 65_535;
/// Protocol number of TCP in IP (RFC 9293).
const TCP: u8 = 6;

fn file_header(link_type: u32) -> Vec<u8> {
    // Magic number of stamps in nanoseconds, version 2.4, no correction of the time zone, longest frame, link type.
    let words = [0xA1B2_3C4D, 2 | 4 << 16, 0, 0, LONGEST, link_type];
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// A record: time since 1970, length twice, bytes.
fn record_bytes(at: Duration, bytes: &[u8]) -> Vec<u8> {
    let seconds = u32::try_from(at.as_secs()).unwrap_or(u32::MAX);
    let length = u32::try_from(bytes.len()).unwrap_or(LONGEST);
    let head = [seconds, at.subsec_nanos(), length, length].into_iter().flat_map(u32::to_le_bytes);
    head.chain(bytes.iter().copied()).collect()
}

/// A TCP connection, of which only the data are known: addresses are real, sequence numbers count from 1.
struct Conversation {
    ours: SocketAddr,
    peer: SocketAddr,
    sent: u32,
    received: u32,
}

impl Conversation {
    const fn new(ours: SocketAddr, peer: SocketAddr) -> Self {
        Self { ours, peer, sent: 1, received: 1 }
    }

    fn packet(&mut self, data: &[u8], is_sent: bool) -> Vec<u8> {
        let length = u32::try_from(data.len()).unwrap_or(LONGEST);
        let (from, to, sequence, acknowledged) = if is_sent {
            (self.ours, self.peer, &mut self.sent, self.received)
        } else {
            (self.peer, self.ours, &mut self.received, self.sent)
        };
        let first = *sequence;
        *sequence = first.wrapping_add(length);
        let mut segment = Vec::with_capacity(20 + data.len());
        segment.extend(from.port().to_be_bytes());
        segment.extend(to.port().to_be_bytes());
        segment.extend(first.to_be_bytes());
        segment.extend(acknowledged.to_be_bytes());
        // Header of five words, flags PSH and ACK, window of 65535, checksum to come, nothing urgent.
        segment.extend([5 << 4, 0x18, 0xFF, 0xFF, 0, 0, 0, 0]);
        segment.extend_from_slice(data);
        match (from.ip(), to.ip()) {
            (IpAddr::V4(from), IpAddr::V4(to)) => ip4(from.octets(), to.octets(), &mut segment),
            (from, to) => {
                let sixteen = |ip| match ip {
                    IpAddr::V4(ip) => ip.to_ipv6_mapped().octets(),
                    IpAddr::V6(ip) => ip.octets(),
                };
                ip6(&sixteen(from), &sixteen(to), &mut segment)
            }
        }
    }
}

fn ip4(from: [u8; 4], to: [u8; 4], segment: &mut [u8]) -> Vec<u8> {
    let length = u16::try_from(segment.len()).unwrap_or(u16::MAX);
    let pseudo = [&from[..], &to, &[0, TCP], &length.to_be_bytes()].concat();
    seal(&pseudo, segment);
    let total = length.saturating_add(20).to_be_bytes();
    // Version 4, header of five words, no fragments, 64 hops.
    let mut packet = vec![0x45, 0, total[0], total[1], 0, 0, 0x40, 0, 64, TCP, 0, 0];
    packet.extend_from_slice(&from);
    packet.extend_from_slice(&to);
    let sum = checksum(&packet).to_be_bytes();
    packet[10..12].copy_from_slice(&sum);
    packet.extend_from_slice(segment);
    packet
}

fn ip6(from: &[u8; 16], to: &[u8; 16], segment: &mut [u8]) -> Vec<u8> {
    let length = u16::try_from(segment.len()).unwrap_or(u16::MAX).to_be_bytes();
    let pseudo = [&from[..], to, &[0, 0], &length, &[0, 0, 0, TCP]].concat();
    seal(&pseudo, segment);
    let mut packet = vec![0x60, 0, 0, 0, length[0], length[1], TCP, 64];
    packet.extend_from_slice(from);
    packet.extend_from_slice(to);
    packet.extend_from_slice(segment);
    packet
}

fn seal(pseudo_header: &[u8], segment: &mut [u8]) {
    let sum = checksum(&[pseudo_header, segment].concat()).to_be_bytes();
    segment[16..18].copy_from_slice(&sum);
}

/// The Internet checksum (RFC 1071).
fn checksum(bytes: &[u8]) -> u16 {
    let mut sum: u32 = bytes
        .chunks(2)
        .map(|word| u32::from(word[0]) << 8 | u32::from(word.get(1).copied().unwrap_or(0)))
        .sum();
    while sum > 0xFFFF {
        sum = (sum >> 16) + (sum & 0xFFFF);
    }
    !u16::try_from(sum).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_reported_and_delays_no_link() {
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
        let mut tap = file.of(FrameKind::Stream);
        for _ in 0..2 * QUEUE {
            tap.sent(&[1, 2, 0]);
        }
        let error = file.finish().unwrap_err();
        assert!(error.starts_with("full.pcap: the capture is not complete"), "{error}");
    }

    fn split(splitting: Splitting, pieces: &[&[u8]]) -> Vec<Vec<u8>> {
        let mut received = Received::new(splitting);
        let mut frames = Vec::new();
        for piece in pieces {
            received.push(piece);
            frames.extend(std::iter::from_fn(|| received.frame()));
        }
        frames.extend(received.rest());
        frames
    }

    #[test]
    fn frames_end_by_length_and_checksum_or_zero() {
        let reply = [1, 3, 2, 0, 7, 0xF9, 0x86];
        let twice = [reply, reply].concat();
        let frames = split(Splitting::Rtu, &[&twice[..9], &twice[9..], &[5]]);
        assert_eq!(frames, [&reply[..], &reply, &[5]]);
        let frames = split(Splitting::Zeros, &[&[1, 0, 2], &[0, 3]]);
        assert_eq!(frames, [&[1, 0][..], &[2, 0], &[3]]);
        let frames = split(Splitting::None, &[&[1], &[2, 3]]);
        assert_eq!(frames, [&[1][..], &[2, 3]]);
        // Bytes without an end do not fill the memory.
        let frames = split(Splitting::Zeros, &[&[7; 10 * MOST]]);
        assert!(frames.iter().all(|frame| frame.len() <= MOST));
        assert_eq!(frames.concat().len(), 10 * MOST);
    }

    /// A sum over everything that includes its own checksum is 0 (RFC 1071).
    #[test]
    fn packets_have_right_checksums_and_sequence_numbers() {
        let conversation = |ours: &str, peer: &str| {
            let [ours, peer] = [ours, peer].map(|text| text.parse().unwrap());
            Conversation::new(ours, peer)
        };
        let mut v4 = conversation("10.0.0.1:40000", "10.0.0.2:502");
        let packet = v4.packet(&[1, 2, 3], true);
        assert_eq!(packet.len(), 43);
        assert_eq!(checksum(&packet[..20]), 0);
        let pseudo = [&packet[12..20], &[0, 6, 0, 23], &packet[20..]].concat();
        assert_eq!(checksum(&pseudo), 0);
        let answer = v4.packet(&[9], false);
        assert_eq!(answer[20..22], 502_u16.to_be_bytes());
        let acknowledged = 4_u32.to_be_bytes();
        assert_eq!(answer[28..32], acknowledged, "three bytes");
        let packet = conversation("[::1]:40000", "[::1]:502").packet(&[1, 2, 3, 4], true);
        assert_eq!(packet.len(), 64);
        let pseudo = [&packet[8..40], &[0, 0, 0, 24, 0, 0, 0, 6], &packet[40..]].concat();
        assert_eq!(checksum(&pseudo), 0);
    }
}
