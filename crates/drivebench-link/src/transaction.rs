//! The transaction layer of every link over a line, without a port and without a clock.
//!
//! ```text
//! request --> proof.rs      synchronisation: silence until .. | probe with .. | in step
//!    |        Bound         deadline, and interruption by a stop
//!    v
//! bytes   --> Reception     the reply and the time of its first byte
//!                |          stale, foreign, damaged: counted
//!                '--> proof.rs
//! ```
//!
//! exchange.rs executes the steps. Pure: its inputs are bytes and times.

use std::io::{self, ErrorKind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use firmware_protocol::modbus::response_len;
use serde::Serialize;

use super::framing::{Code, Expected, FrameKind, Search, begins_with_rtu, rtu_frame_len, search};
use super::link_error::LinkError;
use super::unexpected::Unexpected;

/// Request to stop: one of its flags was raised since the last [`StopRequest::lower`].
///
/// Silences, probes and retries of a bounded exchange are given up then, so that the stop goes out next.
#[derive(Clone, Debug, Default)]
pub struct StopRequest(Vec<(Arc<AtomicBool>, bool)>);

impl StopRequest {
    /// Watches flags that others raise: those of the signals, that of the screen's stop keys.
    pub fn watching(flags: impl IntoIterator<Item = Arc<AtomicBool>>) -> Self {
        Self(flags.into_iter().map(|flag| (flag, false)).collect())
    }

    /// Flags raised by now are handled and no longer interrupt.
    pub fn lower(&mut self) {
        for (flag, is_handled) in &mut self.0 {
            *is_handled = flag.load(Ordering::Acquire);
        }
    }

    fn is_raised(&self) -> bool {
        self.0.iter().any(|(flag, is_handled)| !is_handled && flag.load(Ordering::Acquire))
    }
}

/// The bound of the exchange under way; none until one is set.
#[derive(Clone, Debug, Default)]
pub(super) struct Bound {
    until: Option<Instant>,
    pub(super) stop_request: StopRequest,
}

impl Bound {
    /// Sets the time left from `now` on, s; not finite: unbounded.
    pub(super) fn set(&mut self, left_s: f64, now: Instant) {
        let left = Duration::try_from_secs_f64(left_s.max(0.0)).ok();
        self.until = left.and_then(|left| now.checked_add(left));
    }

    pub(super) const fn is_set(&self) -> bool {
        self.until.is_some()
    }

    /// Whether everything that can wait is given up.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        let wanted = self.stop_request.is_raised();
        self.until.is_some_and(|until| wanted || now >= until)
    }

    pub(super) fn ends_before(&self, at: Instant) -> bool {
        self.until.is_some_and(|until| until < at)
    }

    /// `at`, or where the exchange has to end.
    pub(super) fn earlier(&self, at: Instant) -> Instant {
        self.until.map_or(at, |until| at.min(until))
    }

    /// Where a wait until `at` looks up next.
    pub(super) fn next_look(&self, now: Instant, at: Instant) -> Instant {
        let at = self.earlier(at);
        if !self.is_set() || self.stop_request.0.is_empty() {
            at
        } else {
            // A wait under way checks so often whether a stop is wanted.
            at.min(now + Duration::from_millis(4))
        }
    }
}

/// Bytes kept while a reply is awaited; on a line that sends more the oldest are dropped.
const LONGEST_WAIT_BYTES: usize = 1024;

/// What the line carried: `bytes_received` are those of accepted replies and those dropped, nothing else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LineCounts {
    pub bytes_sent: u64,
    pub bytes_received: u64,
    pub bytes_accepted: u64,
    /// Bytes that belonged to no accepted reply.
    pub bytes_dropped: u64,
    /// Complete frames among them that answer an earlier request: late or repeated.
    pub stale_frames: u64,
    /// Complete frames among them that answer no request of ours, also requests of other masters.
    pub foreign_frames: u64,
    /// Those of the foreign ones that came while no request was outstanding.
    pub unasked_frames: u64,
    /// Those of the foreign ones that write to the drive that we command.
    pub foreign_writes: u64,
    /// Requests that were repeated.
    pub retries: u64,
    /// Time spent in silences and probes that kept old replies away, ms.
    pub resync_ms: u64,
    /// Whole replies with a few bytes directly before or behind them that belong to no frame (bias, termination, turnaround).
    pub stray_replies: u64,
    /// The line returns our own requests (two-wire RS-485 without echo suppression).
    pub echoes: bool,
}

/// Stray bytes around a reply that are no loss of synchronisation: fewer than any frame has.
const MOST_STRAYS: usize = 4;

/// Content of the line at the deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Leftover {
    Nothing,
    /// Complete frames that answer earlier requests.
    Stale,
    /// Complete frames that answer no request of ours, or something else that has a name.
    Unexpected(Unexpected),
    /// This many bytes that make no frame.
    Damaged(usize),
}

impl Leftover {
    /// Error of a missing reply, classified by what came instead.
    pub(super) fn error(
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
            Self::Unexpected(what) => LinkError::Unexpected { link, request, what },
            Self::Damaged(bytes) => LinkError::Corrupt(
                link,
                format!("{bytes} bytes without a valid frame came in reply to {request}"),
            ),
        }
    }
}

/// A reply to an earlier request, received in addition to the awaited one or instead of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OldReply {
    pub(super) code: Code,
    /// It came behind the accepted reply.
    pub(super) behind: bool,
}

/// What came with the reply to the last request without a loss of synchronisation.
#[derive(Clone, Copy, Debug, Default)]
struct Extra {
    /// Stray bytes behind it.
    behind: usize,
    /// It had some, before or behind.
    has_strays: bool,
    is_repeated: bool,
}

#[derive(Debug)]
pub(super) struct Reception {
    pub(super) kind: FrameKind,
    pub(super) expected: Expected,
    received: Vec<u8>,
    /// Ends of the pieces in which that came, and when.
    pieces: Vec<(usize, Instant)>,
    pub(super) reply: Vec<u8>,
    /// First byte of the request out, and first byte of its reply in.
    pub(super) asked: Option<Instant>,
    pub(super) answered: Option<Instant>,
    pub(super) last_activity: Instant,
    pub(super) line: LineCounts,
    /// The reply before, while nothing has gone out since: a copy of it answers nothing.
    last_reply: Vec<u8>,
    extra: Extra,
    /// One byte came behind the last reply.
    has_one_behind: bool,
    /// A reply came twice since the last look.
    repeated: bool,
    /// What was wrong since the last look.
    anomaly: bool,
    /// Old replies since the last look, in order.
    old_replies: Vec<OldReply>,
}

impl Reception {
    pub(super) fn new(kind: FrameKind, now: Instant) -> Self {
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
            last_reply: Vec::new(),
            extra: Extra::default(),
            has_one_behind: false,
            repeated: false,
            anomaly: false,
            old_replies: Vec::new(),
        }
    }

    /// So many bytes of the request have gone out.
    pub(super) fn sent(&mut self, count: usize, at: Instant) {
        self.line.bytes_sent += count as u64;
        if self.asked.is_none() {
            self.extra = Extra::default();
        }
        self.asked.get_or_insert(at);
        self.last_activity = at;
    }

    pub(super) fn push(&mut self, bytes: &[u8], at: Instant) {
        self.line.bytes_received += bytes.len() as u64;
        self.last_activity = at;
        self.received.extend_from_slice(bytes);
        self.pieces.push((self.received.len(), at));
    }

    /// Ends the exchange: what is left of it answers nothing any more.
    pub(super) fn retire(&mut self) {
        let is_answered = !self.reply.is_empty();
        if !self.expected.request.is_empty() {
            std::mem::swap(&mut self.last_reply, &mut self.reply);
        }
        // Anomalies of an exchange are judged at its end.
        let was_wrong = self.anomaly;
        if !self.is_copying() {
            self.drop_received(false);
        }
        self.anomaly = was_wrong;
        self.expected.retire(is_answered);
        self.reply.clear();
        self.asked = None;
        self.answered = None;
    }

    /// Drops what came while nothing was outstanding; returns how many bytes of that disturb. A copy of the last reply that is still
    /// coming is kept.
    pub(super) fn drop_strays(&mut self) -> usize {
        if self.is_copying() { 0 } else { self.drop_rest() }
    }

    /// The same with a copy that has not come to its end.
    pub(super) fn drop_rest(&mut self) -> usize {
        let received = std::mem::take(&mut self.received);
        let last = std::mem::take(&mut self.last_reply);
        let is_harmless = self.is_harmless_after(&last, &received);
        (self.received, self.last_reply) = (received, last);
        if !is_harmless {
            return self.drop_received(true);
        }
        self.line.bytes_dropped += self.received.len() as u64;
        self.received.clear();
        self.pieces.clear();
        0
    }

    /// Whether what came behind the last reply is the beginning of a copy of it.
    pub(super) fn is_copying(&self) -> bool {
        let copy = &self.received;
        let is_part = !copy.is_empty() && copy.len() < self.last_reply.len();
        self.kind == FrameKind::Rtu && is_part && self.last_reply.starts_with(copy)
    }

    /// Whether bytes behind a reply are no loss of synchronisation, and counts them then: one copy of it, whose contents are those of
    /// the reply whichever of both is the older; or a few bytes none of which can begin another reply of the unit.
    fn is_harmless_after(&mut self, reply: &[u8], behind: &[u8]) -> bool {
        // The second half of the end of a line.
        if self.kind == FrameKind::Lines {
            return behind.iter().all(|byte| matches!(byte, b'\r' | b'\n'));
        }
        let Some(unit) = reply.first().filter(|_| self.kind == FrameKind::Rtu) else {
            return false;
        };
        let is_copy = !self.extra.is_repeated && !self.expected.may_be_late(reply);
        let rest = behind.strip_prefix(reply).filter(|_| is_copy);
        let strays = rest.unwrap_or(behind);
        if self.extra.behind + strays.len() > MOST_STRAYS || strays.contains(unit) {
            return false;
        }
        if rest.is_some() {
            (self.extra.is_repeated, self.repeated) = (true, true);
            // A reply that is a copy of its request may have been the echo: from now on one copy alone is no reply.
            self.expected.echoes |=
                !self.expected.is_echo_free && matches!(reply.get(1), Some(5 | 6 | 8));
            self.line.stale_frames += 1;
        }
        self.extra.behind += strays.len();
        self.count_strays(strays.len());
        true
    }

    fn count_strays(&mut self, count: usize) {
        if count > 0 && !std::mem::replace(&mut self.extra.has_strays, true) {
            self.line.stray_replies += 1;
        }
    }

    /// Whether a reply came twice since the last call.
    pub(super) fn take_repeated(&mut self) -> bool {
        std::mem::take(&mut self.repeated)
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
            foreign += search.foreign as u64;
            let reply = search.reply;
            self.book(search, behind);
            // A second reply to the request that has been answered.
            let Some((begin, end)) = reply else { return foreign };
            self.line.stale_frames += 1;
            if let Some(code) = Code::of(self.kind, &rest[begin..end]) {
                self.old_replies.push(OldReply { code, behind });
            }
            rest = &rest[end..];
        }
    }

    /// The frames other than the reply.
    fn book(&mut self, search: Search, behind: bool) {
        self.line.stale_frames += search.old.len() as u64;
        self.line.foreign_frames += search.foreign as u64;
        self.line.foreign_writes += search.foreign_writes as u64;
        self.old_replies.extend(search.old.into_iter().map(|code| OldReply { code, behind }));
    }

    fn drop_bytes(&mut self, count: usize) {
        self.line.bytes_dropped += count as u64;
        self.anomaly |= count > 0;
    }

    /// Whether anything was wrong since the last call.
    pub(super) fn take_anomaly(&mut self) -> bool {
        std::mem::take(&mut self.anomaly)
    }

    /// Old replies since the last call.
    pub(super) fn take_old_replies(&mut self) -> Vec<OldReply> {
        std::mem::take(&mut self.old_replies)
    }

    /// Moves the reply out of what was received, if it is there.
    pub(super) fn accept(&mut self) -> io::Result<bool> {
        let found = search(self.kind, &self.expected, &self.received).map_err(|_| {
            io::Error::new(ErrorKind::ConnectionAborted, "the peer does not use Modbus TCP")
        })?;
        if let Some((begin, end)) = found.reply {
            let has_one_behind = begin == 0 && self.received.len() == end + 1;
            let is_new = has_one_behind && !self.has_one_behind && self.kind == FrameKind::Rtu;
            if is_new && may_have_inserted_byte(&self.received) {
                return Ok(false);
            }
            self.has_one_behind = has_one_behind;
            let echo = usize::from(found.echo) * self.expected.request.len();
            // A reply that cannot be a copy of its request shows whether the line returns requests.
            let copies = matches!(self.expected.request.get(1), Some(5 | 6 | 8));
            if found.echo || (self.kind == FrameKind::Rtu && !copies) {
                self.expected.echoes = found.echo;
                self.expected.is_echo_free = !found.echo;
            }
            self.line.echoes |= found.echo;
            self.line.bytes_accepted += (end - begin) as u64;
            let is_alone = found.old.is_empty() && found.foreign == 0;
            self.book(found, false);
            self.answered = self.pieces.iter().find(|(piece, _)| *piece > begin).map(|(_, at)| *at);
            self.reply.clear();
            self.reply.extend_from_slice(&self.received[begin..end]);
            // What follows the reply answers nothing.
            let behind = self.received.split_off(end);
            let before = begin - echo;
            self.line.bytes_dropped += echo as u64;
            self.received.clear();
            self.pieces.clear();
            if self.kind == FrameKind::Rtu && is_alone && before <= MOST_STRAYS {
                self.count_strays(before);
                self.line.bytes_dropped += before as u64;
            } else {
                self.drop_bytes(before);
            }
            self.drop_behind_reply(behind);
            return Ok(true);
        }
        if self.received.len() > LONGEST_WAIT_BYTES && self.kind != FrameKind::Tcp {
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

    /// What came together with the reply, behind it.
    fn drop_behind_reply(&mut self, behind: Vec<u8>) {
        if behind.is_empty() {
            return;
        }
        let reply = std::mem::take(&mut self.reply);
        let is_harmless = self.is_harmless_after(&reply, &behind);
        let is_part = self.kind == FrameKind::Rtu && reply.starts_with(&behind);
        self.reply = reply;
        if is_harmless {
            self.line.bytes_dropped += behind.len() as u64;
        } else if is_part {
            // The copy is coming.
            self.pieces.push((behind.len(), self.last_activity));
            self.received = behind;
        } else {
            self.drop_bytes(behind.len());
            self.count(&behind, true);
        }
    }

    /// Judges what came instead of a reply.
    pub(super) fn leftover(&mut self) -> Leftover {
        let (request, received) = (&self.expected.request, &self.received);
        let Ok(search) = search(self.kind, &self.expected, received) else {
            return Leftover::Unexpected(Unexpected::Frame);
        };
        if !received.is_empty() && received == request {
            // What is no copy of its reply shows that the line returns requests; a copy alone is no reply from now on.
            if !matches!(request.get(1), Some(5 | 6 | 8)) && self.kind == FrameKind::Rtu {
                (self.expected.echoes, self.line.echoes) = (true, true);
                self.expected.is_echo_free = false;
            }
            return Leftover::Unexpected(Unexpected::Echo);
        }
        match (received.len(), search.unexpected, search.old.len()) {
            (0, ..) => Leftover::Nothing,
            (_, Some(what), _) => Leftover::Unexpected(what),
            (bytes, None, 0) => self.damaged(bytes),
            (_, None, _) => Leftover::Stale,
        }
    }

    /// Bytes without a whole frame.
    fn damaged(&self, bytes: usize) -> Leftover {
        let is_text = |byte: &u8| byte.is_ascii_hexdigit() || matches!(byte, b':' | b'\r' | b'\n');
        match (self.kind, self.received.as_slice()) {
            (FrameKind::Tcp, [_, _, 0, 0, high, low, ..]) => {
                let announced = 6 + usize::from(u16::from_be_bytes([*high, *low]));
                Leftover::Unexpected(Unexpected::Incomplete { announced, came: bytes })
            }
            (FrameKind::Rtu, text @ [b':', .., b'\n']) if text.iter().all(is_text) => {
                Leftover::Unexpected(Unexpected::Ascii)
            }
            _ => Leftover::Damaged(bytes),
        }
    }

    /// Whether the peer of a connection of Modbus TCP sent frames of RTU.
    pub(super) fn is_rtu_over_tcp(&self) -> bool {
        self.kind == FrameKind::Tcp && begins_with_rtu(&self.received)
    }
}

/// Whether a reply with one byte behind it is as well a frame into which one byte was inserted: a check sum of 16 bits fits one
/// of 65,536 such frames by chance (one of ten million replies of the trials with faults).
fn may_have_inserted_byte(received: &[u8]) -> bool {
    let (reply, rest) = (&received[..received.len() - 1], &received[1..]);
    let mut without = rest.to_vec();
    (0..reply.len()).any(|at| {
        let is_whole = rtu_frame_len(&without, response_len) == Some(without.len());
        let is_another = is_whole && without != reply;
        without[at] = received[at];
        is_another
    })
}

pub(super) fn never_silent(link: &str) -> LinkError {
    let message = "the line is never silent: something talks all the time".to_owned();
    LinkError::Corrupt(link.to_owned(), message)
}

pub(super) fn out_of_step(link: &str) -> LinkError {
    LinkError::Unexpected {
        link: link.to_owned(),
        request: "the probe".to_owned(),
        what: Unexpected::OutOfStep,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::waiting::now;

    #[test]
    fn a_flag_cuts_in_once_for_each_raise() {
        let flag = Arc::new(AtomicBool::new(false));
        let mut stop_request = StopRequest::watching([Arc::clone(&flag)]);
        assert!(!stop_request.is_raised());
        flag.store(true, Ordering::Release);
        assert!(stop_request.is_raised());
        stop_request.lower();
        assert!(!stop_request.is_raised());
        flag.store(false, Ordering::Release);
        stop_request.lower();
        flag.store(true, Ordering::Release);
        assert!(stop_request.is_raised());
    }

    #[test]
    fn a_bound_without_an_end_is_none() {
        let (mut bound, now) = (Bound::default(), now());
        bound.set(0.08, now);
        assert!(bound.is_set() && !bound.is_over(now + Duration::from_millis(79)));
        assert!(bound.is_over(now + Duration::from_millis(80)));
        assert!(bound.ends_before(now + Duration::from_millis(81)));
        assert!(!bound.ends_before(now + Duration::from_millis(80)));
        bound.set(f64::INFINITY, now);
        let late = now + Duration::from_secs(3600);
        assert!(!bound.is_set() && !bound.is_over(late) && !bound.ends_before(late));
    }

    /// What is left when no reply has come: each with its own name.
    #[test]
    fn what_came_instead_of_a_reply_is_named() {
        use Unexpected::{Ascii, Echo, Frame, Incomplete, Length, Transaction, Unit};
        let rtu = |unit, pdu: &[u8]| crate::scripted::frame(unit, pdu);
        let tcp = |transaction, unit, pdu: &[u8]| {
            firmware_protocol::modbus::tcp::encode_frame(transaction, unit, pdu).to_vec()
        };
        let (read, reply) = ([3, 0, 10, 0, 2], [3, 4, 0, 10, 0, 11]);
        let wide = [3, 8, 0, 0, 0, 10, 0, 0, 0, 11];
        let mut cut_off = tcp(7, 1, &reply);
        cut_off[5] += 1;
        let (on_rtu, on_tcp) = (FrameKind::Rtu, FrameKind::Tcp);
        let too_long = named(Length { found: 8, expected: 4 });
        let numbered = |found| named(Transaction { found, expected: 7 });
        for (name, kind, received, expected) in [
            ("nothing", on_rtu, vec![], Leftover::Nothing),
            ("another unit", on_rtu, rtu(9, &reply), Leftover::Unexpected(Unit(9))),
            ("unit 0", on_rtu, rtu(0, &reply), Leftover::Unexpected(Unit(0))),
            ("registers of 32 bits", on_rtu, rtu(1, &wide), too_long),
            ("one less", on_rtu, rtu(1, &[3, 2, 0, 10]), named(Length { found: 2, expected: 4 })),
            ("another function", on_rtu, rtu(1, &[4, 4, 0, 10, 0, 11]), named(Frame)),
            ("our own bytes", on_rtu, rtu(1, &read), named(Echo)),
            ("ascii", on_rtu, b":010302000AF0\r\n".to_vec(), named(Ascii)),
            ("garbage", on_rtu, vec![1, 2, 3], Leftover::Damaged(3)),
            ("an earlier request's", on_rtu, rtu(1, &[3, 6, 0, 1, 0, 2, 0, 3]), Leftover::Stale),
            ("another number", on_tcp, tcp(8, 1, &reply), numbered(8)),
            ("the number of an answered request", on_tcp, tcp(6, 1, &reply), numbered(6)),
            ("the number of a lost request", on_tcp, tcp(5, 1, &reply), Leftover::Stale),
            ("another unit", on_tcp, tcp(7, 255, &reply), Leftover::Unexpected(Unit(255))),
            ("another length", on_tcp, tcp(7, 1, &wide), too_long),
            ("cut off", on_tcp, cut_off, named(Incomplete { announced: 14, came: 13 })),
        ] {
            let now = now();
            let mut reception = Reception::new(kind, now);
            let request = |transaction, pdu: &[u8]| match kind {
                FrameKind::Tcp => tcp(transaction, 1, pdu),
                _ => rtu(1, pdu),
            };
            let earlier = [(request(5, &[3, 0, 0, 0, 3]), false), (request(6, &read), true)];
            reception.expected.earlier.extend(earlier);
            reception.expected.request = request(7, &read);
            reception.push(&received, now);
            assert!(matches!(reception.accept(), Ok(false)), "{name}: it is no reply");
            assert_eq!(reception.leftover(), expected, "{name}");
        }
    }

    /// On a line that returns requests the copy of a write is no acknowledgement. Where a read came without an echo, an
    /// acknowledgement that comes twice is no echo, and the next one alone is a reply.
    #[test]
    fn an_echo_alone_makes_later_copies_echoes() {
        let frame = crate::scripted::frame;
        let (read, write) = (frame(1, &[3, 0, 0, 0, 1]), frame(1, &[6, 0, 1, 0, 0]));
        let reply = frame(1, &[3, 2, 0, 7]);
        let echoing =
            [(&read, &read, 1, false), (&write, &write, 1, false), (&write, &write, 2, true)];
        let plain =
            [(&read, &reply, 1, true), (&write, &write, 2, true), (&write, &write, 1, true)];
        for line in [echoing, plain] {
            let now = now();
            let mut reception = Reception::new(FrameKind::Rtu, now);
            for (request, received, copies, is_reply) in line {
                reception.expected.request.clone_from(request);
                reception.push(&received.repeat(copies), now);
                assert_eq!(reception.accept().unwrap(), is_reply, "{request:?} {copies}");
                reception.leftover();
                reception.retire();
            }
        }
    }

    /// The check sum of the first 37 of these 38 bytes fits by chance; without the byte `d0` that of all others does.
    #[test]
    fn a_byte_inserted_into_a_reply_is_found_where_the_check_sum_fits_by_chance() {
        let now = now();
        let request = crate::scripted::frame(1, &[23, 0, 0, 0, 16, 0, 32, 0, 1, 2, 0, 7]);
        let received = [
            0x01, 0x17, 0x20, 0x01, 0x82, 0x00, 0x00, 0x3C, 0xB1, 0xF6, 0x73, 0xF6, 0xF8, 0xF6,
            0x73, 0xD0, 0xF6, 0xF8, 0x00, 0x63, 0x00, 0x5B, 0x00, 0x04, 0x00, 0x00, 0x00, 0x00,
            0x04, 0xAF, 0x80, 0x00, 0x00, 0x64, 0x00, 0x01, 0x6C, 0xAE,
        ];
        let without: Vec<u8> = [&received[..15], &received[16..]].concat();
        for (name, bytes, is_reply) in [
            ("inserted", received.to_vec(), false),
            ("whole", without.clone(), true),
            ("its last byte again", [&without[..], &[0xAE]].concat(), true),
            ("a zero behind", [&without[..], &[0]].concat(), true),
        ] {
            let mut reception = Reception::new(FrameKind::Rtu, now);
            reception.expected.request.clone_from(&request);
            reception.push(&bytes, now);
            assert_eq!(reception.accept().unwrap(), is_reply, "{name}");
            if !is_reply {
                assert_eq!(reception.leftover(), Leftover::Damaged(38));
            }
        }
    }

    /// Around a whole reply: what is dropped as harmless, and what may belong to another reply. Behind it, it comes with the reply, in
    /// two parts, or later.
    #[test]
    fn a_few_stray_bytes_and_a_copy_around_a_reply_are_harmless() {
        let frame = crate::scripted::frame;
        let request = frame(1, &[3, 0, 10, 0, 2]);
        let reply = frame(1, &[3, 4, 0, 10, 0, 11]);
        let other = frame(1, &[3, 4, 0, 99, 0, 99]);
        let copy_and_zero = [&reply[..], &[0]].concat();
        for (name, before, behind, is_harmless, strays, copies) in [
            ("nothing", &[][..], &[][..], true, 0, 0),
            ("zero in front", &[0], &[], true, 1, 0),
            ("end of a frame in front", &[1, 3, 4, 0], &[], true, 1, 0),
            ("five bytes in front", &[0; 5], &[], false, 0, 0),
            ("zeros behind", &[], &[0; 3], true, 1, 0),
            ("both", &[0], &[0xFF, 0xFF], true, 1, 0),
            ("five bytes behind", &[], &[0; 5], false, 0, 0),
            ("may begin a reply of the unit", &[], &[1, 3], false, 0, 0),
            ("in the middle too", &[], &[0xFF, 1, 3], false, 0, 0),
            ("a copy", &[], &reply, true, 0, 1),
            ("a copy and a zero", &[], &copy_and_zero, true, 1, 1),
            ("two copies", &[], &reply.repeat(2), false, 0, 0),
            ("another reply", &[], &other, false, 0, 0),
            ("a part of a copy that does not end", &[], &reply[..6], false, 0, 0),
        ] {
            for split in [behind.len(), behind.len() / 2, 0] {
                let now = now();
                let mut reception = Reception::new(FrameKind::Rtu, now);
                reception.sent(request.len(), now);
                reception.expected.request.clone_from(&request);
                let (with_it, later) = behind.split_at(split);
                reception.push(&[before, &reply, with_it].concat(), now);
                assert!(matches!(reception.accept(), Ok(true)), "{name}");
                let mut disturbs = reception.take_anomaly();
                reception.retire();
                reception.push(later, now);
                disturbs |= reception.drop_strays() > 0;
                let is_part =
                    !behind.is_empty() && behind.len() < reply.len() && reply.starts_with(behind);
                let is_whole = split == behind.len() || split == 0;
                assert!(!is_whole || reception.is_copying() == is_part, "{name}");
                disturbs |= reception.drop_rest() > 0;
                let context = format!("{name}, {split} bytes with it: {:?}", reception.line);
                assert_eq!(disturbs, !is_harmless, "{context}");
                if is_harmless {
                    assert_eq!(reception.line.stray_replies, strays, "{context}");
                    assert_eq!(reception.line.stale_frames, copies, "{context}");
                }
                let line = reception.line;
                let whole = line.bytes_accepted + line.bytes_dropped;
                assert_eq!(line.bytes_received, whole, "{context}");
            }
        }
    }

    const fn named(what: Unexpected) -> Leftover {
        Leftover::Unexpected(what)
    }
}
