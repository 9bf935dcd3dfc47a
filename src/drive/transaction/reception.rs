//! What came since the last request went out: which bytes answer it, when their first came, and what the rest was.
//! Pure: bytes and their times go in.

use std::io::{self, ErrorKind};
use std::time::Instant;

use serde::Serialize;

use crate::drive::link::LinkError;
use crate::drive::reply::{Code, Expected, FrameKind, search};

/// Bytes kept while a reply is awaited; a line that babbles beyond loses its oldest.
const LONGEST_WAIT_BYTES: usize = 1024;

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
    /// Whole frames among them, requests of others as well, that answer nothing that was asked.
    pub foreign_frames: u64,
    /// Those of the foreign ones that came while nothing was outstanding: replies to nobody.
    pub unasked_frames: u64,
    /// Those of the foreign ones that write to the drive that we command.
    pub foreign_writes: u64,
    /// Questions that were asked again.
    pub retries: u64,
    /// Time spent in silences and probes that kept old replies away, ms.
    pub resync_ms: u64,
    /// The line returns our own requests (two-wire RS-485 without echo suppression).
    pub echoes: bool,
}

/// What is there when the time is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::drive) enum Leftover {
    Nothing,
    /// Whole frames that answer something asked before.
    Stale,
    /// Whole frames that answer nothing that was asked.
    Foreign,
    /// This many bytes that make no frame.
    Damaged(usize),
}

impl Leftover {
    /// Why there is no reply: what came instead tells the class.
    pub(in crate::drive) fn error(
        self,
        link: &str,
        request: impl Into<String>,
        deadline: std::time::Duration,
    ) -> LinkError {
        let (link, request) = (link.to_owned(), request.into());
        match self {
            Self::Nothing => LinkError::Timeout {
                link,
                deadline_ms: u64::try_from(deadline.as_millis()).unwrap_or(u64::MAX),
                request,
            },
            Self::Stale => {
                LinkError::Stale(link, format!("only late answers came after {request}"))
            }
            Self::Foreign => LinkError::Mismatch(
                link,
                format!("only frames that do not answer {request} came"),
            ),
            Self::Damaged(bytes) => LinkError::Corrupt(
                link,
                format!("{bytes} bytes without a valid frame came in reply to {request}"),
            ),
        }
    }
}

/// An old reply that came beside the one that was waited for, or instead of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::drive) struct Heard {
    pub(in crate::drive) code: Code,
    /// It came behind the accepted reply.
    pub(in crate::drive) behind: bool,
}

/// The bytes of one line.
#[derive(Debug)]
pub(in crate::drive) struct Reception {
    pub(in crate::drive) kind: FrameKind,
    pub(in crate::drive) expected: Expected,
    received: Vec<u8>,
    /// Ends of the pieces in which that came, and when.
    pieces: Vec<(usize, Instant)>,
    /// The accepted reply.
    pub(in crate::drive) reply: Vec<u8>,
    /// First byte of the request out, and first byte of its reply in.
    pub(in crate::drive) asked: Option<Instant>,
    pub(in crate::drive) answered: Option<Instant>,
    pub(in crate::drive) last_activity: Instant,
    pub(in crate::drive) line: LineCounts,
    /// What was wrong since the last look.
    anomaly: bool,
    /// Old replies since the last look, in order.
    heard: Vec<Heard>,
}

impl Reception {
    pub(in crate::drive) fn new(kind: FrameKind, now: Instant) -> Self {
        Self {
            kind,
            expected: Expected::default(),
            received: Vec::with_capacity(2 * LONGEST_WAIT_BYTES),
            pieces: Vec::new(),
            reply: Vec::new(),
            asked: None,
            answered: None,
            last_activity: now,
            line: LineCounts::default(),
            anomaly: false,
            heard: Vec::new(),
        }
    }

    /// So many bytes of the request have gone out.
    pub(in crate::drive) fn sent(&mut self, count: usize, at: Instant) {
        self.line.bytes_sent += count as u64;
        self.asked.get_or_insert(at);
        self.last_activity = at;
    }

    pub(in crate::drive) fn push(&mut self, bytes: &[u8], at: Instant) {
        self.line.bytes_received += bytes.len() as u64;
        self.last_activity = at;
        self.received.extend_from_slice(bytes);
        self.pieces.push((self.received.len(), at));
    }

    /// Ends the exchange: what is left of it answers nothing any more.
    pub(in crate::drive) fn retire(&mut self) {
        // Anomalies of an exchange are judged where it ends; what is dropped here was one of it.
        let was_wrong = self.anomaly;
        self.drop_received(false);
        self.anomaly = was_wrong;
        self.expected.retire();
        self.reply.clear();
        self.asked = None;
        self.answered = None;
    }

    /// Drops what came while nothing was outstanding; returns how many bytes that were.
    pub(in crate::drive) fn drop_strays(&mut self) -> usize {
        self.drop_received(true)
    }

    fn drop_received(&mut self, unasked: bool) -> usize {
        let count = self.received.len();
        if count > 0 {
            let received = std::mem::take(&mut self.received);
            let foreign = self.count(&received[..count.min(LONGEST_WAIT_BYTES)], false);
            self.line.unasked_frames += if unasked { foreign } else { 0 };
            self.received = received;
            self.received.clear();
            self.pieces.clear();
            self.drop_bytes(count);
        }
        count
    }

    /// Counts the frames in bytes that are dropped; returns the foreign ones.
    fn count(&mut self, bytes: &[u8], behind: bool) -> u64 {
        let mut rest = bytes;
        let mut foreign = 0;
        loop {
            let search = search(self.kind, &self.expected, rest).unwrap_or_default();
            self.line.stale_frames += search.old.len() as u64;
            foreign += search.foreign as u64;
            self.line.foreign_writes += search.foreign_writes as u64;
            let old = search.old.into_iter();
            self.heard.extend(old.map(|code| Heard { code, behind }));
            // A second reply to the request that has been answered.
            let Some((begin, end)) = search.reply else {
                break;
            };
            self.line.stale_frames += 1;
            if let Some(code) = Code::of(self.kind, &rest[begin..end]) {
                self.heard.push(Heard { code, behind });
            }
            rest = &rest[end..];
        }
        self.line.foreign_frames += foreign;
        foreign
    }

    fn drop_bytes(&mut self, count: usize) {
        self.line.bytes_dropped += count as u64;
        self.anomaly |= count > 0;
    }

    /// Whether anything was wrong since the last call.
    pub(in crate::drive) fn take_anomaly(&mut self) -> bool {
        std::mem::take(&mut self.anomaly)
    }

    /// Old replies since the last call.
    pub(in crate::drive) fn take_heard(&mut self) -> Vec<Heard> {
        std::mem::take(&mut self.heard)
    }

    /// Moves the reply out of what was received, if it is there.
    pub(in crate::drive) fn accept(&mut self) -> io::Result<bool> {
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
            self.line.stale_frames += found.old.len() as u64;
            self.line.foreign_frames += found.foreign as u64;
            self.line.foreign_writes += found.foreign_writes as u64;
            self.line.bytes_accepted += (end - begin) as u64;
            let old = found.old.into_iter();
            let behind = false;
            self.heard.extend(old.map(|code| Heard { code, behind }));
            let first = self.pieces.iter().find(|(piece, _)| *piece > begin);
            self.answered = first.map(|(_, at)| *at);
            self.reply.clear();
            self.reply.extend_from_slice(&self.received[begin..end]);
            // What follows the reply answers nothing.
            let behind = self.received.split_off(end);
            self.drop_bytes(begin - echo + behind.len());
            self.line.bytes_dropped += echo as u64;
            self.received.clear();
            self.pieces.clear();
            if !behind.is_empty() {
                self.count(&behind, true);
            }
            return Ok(true);
        }
        if self.received.len() > LONGEST_WAIT_BYTES && self.kind == FrameKind::Rtu {
            let excess = self.received.len() - LONGEST_WAIT_BYTES;
            self.received.drain(..excess);
            self.pieces.retain_mut(|(end, _)| {
                *end = end.saturating_sub(excess);
                *end > 0
            });
            self.drop_bytes(excess);
        }
        Ok(false)
    }

    /// Judges what came instead of a reply.
    pub(in crate::drive) fn leftover(&self) -> Leftover {
        let (request, received) = (&self.expected.request, &self.received);
        let search = search(self.kind, &self.expected, received).unwrap_or_default();
        match (received.len(), search.foreign, search.old.len()) {
            (0, ..) => Leftover::Nothing,
            (bytes, ..) if bytes == request.len() && received == request => Leftover::Nothing,
            (bytes, 0, 0) => Leftover::Damaged(bytes),
            (_, 0, _) => Leftover::Stale,
            _ => Leftover::Foreign,
        }
    }
}
