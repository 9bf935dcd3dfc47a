//! Between the Modbus client and the port: hands on the reply to the one outstanding request and nothing else.
//!
//! ```text
//! tokio-modbus <--only the reply-- [ Guard ] <--everything-- port
//!                                     | strays, foreign frames, echo, silence, hang-up
//! ```
//!
//! This file owns the clock of the line's silence.

use std::fmt;
use std::future::poll_fn;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::reply::{Echo, Expected, FrameKind, search};

/// Anything that carries bytes.
pub(super) trait Port: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Port for T {}

/// Bytes kept while a reply is awaited; a line that babbles beyond loses its oldest.
const LONGEST_WAIT_BYTES: usize = 1024;

/// The guard; clones share it.
#[derive(Clone)]
pub(super) struct Guard(Arc<Mutex<Inner>>);

struct Inner {
    port: Box<dyn Port>,
    kind: FrameKind,
    expected: Expected,
    received: Vec<u8>,
    /// The accepted reply, and how much of it the client has taken.
    reply: Vec<u8>,
    taken: usize,
    last_activity: Instant,
    line: LineCounts,
    /// What was wrong since the last look.
    anomaly: bool,
}

/// What the line carried: `bytes_received` are those of accepted replies and those dropped, nothing else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LineCounts {
    pub bytes_sent: u64,
    pub bytes_received: u64,
    /// Bytes of replies that were taken.
    pub bytes_accepted: u64,
    /// Bytes that belonged to no accepted reply.
    pub bytes_dropped: u64,
    /// Whole frames among them that answer something asked before: late, or twice.
    pub stale_frames: u64,
    /// Whole frames among them that answer nothing that was asked.
    pub foreign_frames: u64,
    /// The line returns our own requests (two-wire RS-485 without echo suppression).
    pub echoes: bool,
}

/// What is there when the time is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Leftover {
    Nothing,
    /// Whole frames that answer something asked before.
    Stale,
    /// Whole frames that answer nothing that was asked.
    Foreign,
    /// This many bytes that make no frame.
    Damaged(usize),
}

impl Guard {
    pub(super) fn new(port: Box<dyn Port>, kind: FrameKind) -> Self {
        Self(Arc::new(Mutex::new(Inner {
            port,
            kind,
            expected: Expected::default(),
            received: Vec::new(),
            reply: Vec::new(),
            taken: 0,
            last_activity: now(),
            line: LineCounts::default(),
            anomaly: false,
        })))
    }

    /// Reads away whatever lies on the line and ends the last exchange. Returns the bytes that nobody asked for.
    pub(super) async fn begin(&self) -> io::Result<usize> {
        // The reactor has to look at the port once, else bytes that came meanwhile do not show.
        tokio::task::yield_now().await;
        poll_fn(|cx| {
            let mut inner = self.inner();
            inner.retire();
            Poll::Ready(inner.discard(cx))
        })
        .await
    }

    /// What the reply to the next request must carry to be its own.
    pub(super) fn expect(&self, echo: Echo) {
        self.inner().expected.echo = Some(echo);
    }

    /// Waits until the line was silent for `quiet`; false when it never was before `deadline`.
    pub(super) async fn silence(&self, quiet: Duration, deadline: Instant) -> io::Result<bool> {
        loop {
            // When the time is over this is looked at once more: nothing new must not count as something.
            let byte = poll_fn(|cx| match self.inner().discard(cx) {
                Ok(0) => Poll::Pending,
                result => Poll::Ready(result),
            });
            match tokio::time::timeout(quiet, byte).await {
                Err(_) => return Ok(true),
                Ok(Err(error)) => return Err(error),
                Ok(Ok(_)) if now() >= deadline => return Ok(false),
                Ok(Ok(_)) => {}
            }
        }
    }

    /// Lets go of the port: a device that was unplugged keeps its number for as long as somebody holds it.
    pub(super) fn close(&self) {
        self.inner().port = Box::new(tokio::io::empty());
    }

    /// When the line last carried something.
    pub(super) fn last_activity(&self) -> Instant {
        self.inner().last_activity
    }

    pub(super) fn line(&self) -> LineCounts {
        self.inner().line
    }

    /// Whether anything was wrong since the last call.
    pub(super) fn take_anomaly(&self) -> bool {
        std::mem::take(&mut self.inner().anomaly)
    }

    /// Judges what came instead of a reply.
    pub(super) fn leftover(&self) -> Leftover {
        let inner = self.inner();
        let (request, received) = (&inner.expected.request, &inner.received);
        let search = search(inner.kind, &inner.expected, received).unwrap_or_default();
        match (received.len(), search.foreign, search.stale) {
            (0, ..) => Leftover::Nothing,
            (bytes, ..) if bytes == request.len() && received == request => Leftover::Nothing,
            (bytes, 0, 0) => Leftover::Damaged(bytes),
            (_, 0, _) => Leftover::Stale,
            _ => Leftover::Foreign,
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        // One thread uses it; a panic of that thread has ended the link.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// Ends the exchange: what is left of it answers nothing any more.
    fn retire(&mut self) {
        let left = std::mem::take(&mut self.received);
        self.count(&left);
        // Anomalies of an exchange are judged where it ends; what is dropped here was one of it.
        self.line.bytes_dropped += left.len() as u64;
        self.expected.retire();
        self.reply.clear();
        self.taken = 0;
    }

    /// Reads until nothing is there; drops it.
    fn discard(&mut self, cx: &mut Context<'_>) -> io::Result<usize> {
        let mut dropped = 0;
        let mut bytes = [0; 512];
        let mut strays = Vec::new();
        // A line that babbles faster than it is read must not hold us here.
        while dropped < 1 << 16 {
            match self.read_port(cx, &mut bytes) {
                Poll::Ready(Ok(count)) => {
                    dropped += count;
                    let room = LONGEST_WAIT_BYTES.saturating_sub(strays.len());
                    strays.extend_from_slice(&bytes[..count.min(room)]);
                }
                Poll::Ready(Err(error)) => return Err(error),
                Poll::Pending => break,
            }
        }
        self.count(&strays);
        self.drop_bytes(dropped);
        Ok(dropped)
    }

    /// Counts the frames in bytes that are dropped.
    fn count(&mut self, bytes: &[u8]) {
        let search = search(self.kind, &self.expected, bytes).unwrap_or_default();
        self.line.stale_frames += search.stale as u64 + u64::from(search.reply.is_some());
        self.line.foreign_frames += search.foreign as u64;
    }

    fn drop_bytes(&mut self, count: usize) {
        self.line.bytes_dropped += count as u64;
        self.anomaly |= count > 0;
    }

    /// Reads from the port; an end of file is an error, so that nobody asks a port that is gone again and again.
    fn read_port(&mut self, cx: &mut Context<'_>, bytes: &mut [u8]) -> Poll<io::Result<usize>> {
        let mut buffer = ReadBuf::new(bytes);
        match Pin::new(&mut self.port).poll_read(cx, &mut buffer) {
            Poll::Ready(Ok(())) if buffer.filled().is_empty() => Poll::Ready(Err(io::Error::new(
                ErrorKind::BrokenPipe,
                "the other end closed",
            ))),
            Poll::Ready(Ok(())) => {
                let count = buffer.filled().len();
                self.line.bytes_received += count as u64;
                self.last_activity = now();
                Poll::Ready(Ok(count))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => Poll::Pending,
        }
    }

    /// Moves the reply out of what was received, if it is there.
    fn accept(&mut self) -> io::Result<()> {
        let found = search(self.kind, &self.expected, &self.received).map_err(|_| {
            io::Error::new(
                ErrorKind::ConnectionAborted,
                "the peer speaks no Modbus TCP",
            )
        })?;
        if let Some((begin, end)) = found.reply {
            let echo = if found.echo {
                self.expected.request.len()
            } else {
                0
            };
            // A reply that cannot be a copy of its request shows whether the line returns requests.
            let copies = matches!(self.expected.request.get(1), Some(5 | 6 | 8));
            if found.echo || (self.kind == FrameKind::Rtu && !copies) {
                self.expected.echoes = found.echo;
            }
            self.line.echoes |= found.echo;
            self.line.stale_frames += found.stale as u64;
            self.line.foreign_frames += found.foreign as u64;
            self.line.bytes_accepted += (end - begin) as u64;
            // What follows the reply answers nothing.
            let behind = self.received.split_off(end);
            self.drop_bytes(begin - echo + behind.len());
            self.line.bytes_dropped += echo as u64;
            self.reply.clear();
            self.reply.extend_from_slice(&self.received[begin..end]);
            self.taken = 0;
            self.received.clear();
            self.count(&behind);
        } else if self.received.len() > LONGEST_WAIT_BYTES && self.kind == FrameKind::Rtu {
            let excess = self.received.len() - LONGEST_WAIT_BYTES;
            self.received.drain(..excess);
            self.drop_bytes(excess);
        }
        Ok(())
    }
}

impl AsyncRead for Guard {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut inner = self.inner();
        loop {
            if inner.taken < inner.reply.len() {
                let count = buffer.remaining().min(inner.reply.len() - inner.taken);
                buffer.put_slice(&inner.reply[inner.taken..inner.taken + count]);
                inner.taken += count;
                return Poll::Ready(Ok(()));
            }
            let mut bytes = [0; 512];
            match inner.read_port(cx, &mut bytes) {
                Poll::Ready(Ok(count)) => {
                    inner.received.extend_from_slice(&bytes[..count]);
                    inner.accept()?;
                }
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => return Poll::Pending,
            }
        }
    }
}

impl AsyncWrite for Guard {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let mut inner = self.inner();
        match Pin::new(&mut inner.port).poll_write(cx, bytes) {
            Poll::Ready(Ok(count)) => {
                inner.expected.request.extend_from_slice(&bytes[..count]);
                inner.line.bytes_sent += count as u64;
                inner.last_activity = now();
                Poll::Ready(Ok(count))
            }
            other => other,
        }
    }

    /// The kernel has the bytes already. Flushing a serial port would block the thread past any deadline.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner().port).poll_shutdown(cx)
    }
}

/// The Modbus client wants it for its own messages.
impl fmt::Debug for Guard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Guard").finish_non_exhaustive()
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "this file owns the clock of the line's silence"
)]
pub(super) fn now() -> Instant {
    // The runtime's clock is the system's; a test that pauses the one pauses the other.
    tokio::time::Instant::now().into_std()
}
