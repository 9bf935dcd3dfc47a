//! The bus of cells over a line, in whatever language: each turn proven as the drive's profile allows.
//!
//! ```text
//! in step? (proof.rs) -> turn -> reply -> the time that replies usually take, and the gap
//!                                                  -> nothing else came? -> value
//! ```
//!
//! A copy of an earlier reply that comes in the place of the true one is followed by it: so a value is handed on only
//! when the time of the true one is over. The gap is waited for behind the reply instead of before the next request.
//! Where every reply carries the number of its request none of this is needed.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::cell_bus::{CellBus, CellTable, CellsRead, Put, ReadRequest, Span};
use super::exchange::{Exchange, NoData, Query, over_an_exchange};
use super::framing::{FrameKind, Grammar, Turn};
use super::link::{LinkError, Result};
use super::link_core::Answer;
use super::proof::Method;
use super::register_map::{PollRate, ReadBlock, RegisterMap, Resync, plan_reads};
use super::timing::wait_until;
use super::waiting::now;

/// Round trips from which the usual time of a reply is estimated.
const ROUND_TRIPS: usize = 32;

/// How the turns of a drive become requests.
pub(super) trait Language: Send {
    /// Carries out one turn; who calls has listened. The cells that were read.
    fn call(
        &mut self,
        exchange: &mut Exchange,
        turn: Turn<'_>,
        query: Query<'_>,
    ) -> Result<Answer<Vec<u16>>>;

    /// A turn as it goes out, with what distinguishes its reply from those of the turns before it.
    fn prepared<'a>(&mut self, _kind: FrameKind, turn: Turn<'a>) -> Turn<'a> {
        turn
    }

    /// Bytes of a turn on the line, and of its reply.
    fn bytes(&self, kind: FrameKind, turn: Turn<'_>) -> (usize, usize) {
        kind.bytes(turn)
    }

    /// Answers of a turn beyond its first, each with a time of its own.
    fn more_answers(&self, _turn: Turn<'_>) -> u32 {
        0
    }

    /// Carries out one request of the proof.
    fn probe(&mut self, exchange: &mut Exchange, pdu: [u8; 5]) -> Result<()>;

    /// An object of its device identification; `None` where it has none.
    fn object(&mut self, _exchange: &mut Exchange, _object: u8) -> Result<Option<String>> {
        Ok(None)
    }

    /// The texts of its device identification.
    fn names(&mut self, _exchange: &mut Exchange) -> Result<Names> {
        Ok(Names::new())
    }
}

/// Objects of the device identification, by number.
pub(super) type Names = BTreeMap<u8, String>;

/// A language whose frames are made here, in framing/.
pub(super) struct Framed {
    unit: u8,
    /// Of a language of lines.
    grammar: Option<Arc<Grammar>>,
    /// Turns so far: each has another number.
    turns: u32,
    /// Reads so far: each has another length than those before it, where that is all that names its reply.
    reads: u16,
    /// Lengths whose reply is missing, and since when.
    missing: Vec<(u16, Instant)>,
}

/// For how long the length of a read without a reply names no other: longer than a reply is late on a line that still works.
const LATEST: Duration = Duration::from_millis(500);

impl Framed {
    pub(super) const fn new(unit: u8, grammar: Option<Arc<Grammar>>) -> Self {
        Self { unit, grammar, turns: 0, reads: 0, missing: Vec::new() }
    }
}

impl Language for Framed {
    fn prepared<'a>(&mut self, kind: FrameKind, turn: Turn<'a>) -> Turn<'a> {
        self.missing.retain(|(_, since)| now() < *since + LATEST);
        let next = |number: u16| (number + 1) % kind.lengths();
        let mut longer = turn;
        for _ in 0..kind.lengths() {
            self.reads = next(self.reads);
            longer = turn.lengthened(self.reads);
            if !self.missing.iter().any(|(length, _)| *length == longer.length()) {
                break;
            }
        }
        longer
    }

    fn call(
        &mut self,
        exchange: &mut Exchange,
        turn: Turn<'_>,
        query: Query<'_>,
    ) -> Result<Answer<Vec<u16>>> {
        let kind = exchange.kind;
        self.turns = kind.number(turn, self.turns);
        let filter = exchange.filter.clone();
        let grammar = self.grammar.as_deref();
        let request = if let Some(grammar) = &self.grammar {
            let (request, awaited) = grammar.turn(turn, self.turns);
            filter.expect_lines(awaited);
            request
        } else {
            [filter.delimiter(), &kind.request(self.unit, turn, self.turns)].concat()
        };
        let reply = async {
            let reply = filter.ask(&request).await.map_err(NoData::Transport)?;
            grammar.map_or_else(|| kind.cells(&reply, turn), |grammar| grammar.cells(&reply, turn))
        };
        let answer = exchange.call(query, reply, Ok);
        if answer.is_err() && kind.lengths() > 1 {
            self.missing.push((turn.length(), now()));
        }
        answer
    }

    fn bytes(&self, kind: FrameKind, turn: Turn<'_>) -> (usize, usize) {
        self.grammar.as_ref().map_or_else(|| kind.bytes(turn), |grammar| grammar.bytes(turn))
    }

    fn more_answers(&self, turn: Turn<'_>) -> u32 {
        self.grammar.as_ref().map_or(0, |grammar| grammar.answers(turn) - 1)
    }

    fn probe(&mut self, exchange: &mut Exchange, pdu: [u8; 5]) -> Result<()> {
        let [_, a, b, c, d] = pdu;
        let (address, count) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let turn = Turn::read(ReadRequest { table: CellTable::Bytes, address, count });
        let (request, reply) = exchange.kind.bytes(turn);
        let allowed = exchange.core.timing.hurried(request, reply);
        let query = Query::plain(pdu, "the probe", allowed, turn.requested());
        self.call(exchange, turn, Query { is_probe: true, ..query }).map(drop)
    }
}

/// A drive on a line, whose replies are matched with their requests by a method that it supports.
pub(super) struct LineBus<L> {
    language: L,
    exchange: Exchange,
    emulated: bool,
    /// The unit answers no probe.
    silence_proves: bool,
    /// Of the latest reads, and how much longer than their wire time they took.
    round_trips: VecDeque<(Duration, Duration)>,
}

impl<L: Language> LineBus<L> {
    pub(super) fn new(language: L, mut exchange: Exchange, map: &RegisterMap) -> Self {
        let is_exact =
            |block: &ReadBlock| map.exact_reads.contains(&(block.read.address, block.read.count));
        // Cells that can be read in any number up to the whole, for the length code.
        let blocks = plan_reads(map, PollRate::Fast).into_iter();
        let place = blocks.filter(|block| !is_exact(block)).max_by_key(|block| block.read.count);
        let method = match map.resync {
            Resync::Fc08 => Method::Nonce,
            Resync::Length => Method::Length,
            Resync::Tid | Resync::None => Method::Silence,
        };
        exchange.proof.set_policy(method, place.map(|block| (block.read, block.read.count)));
        Self {
            language,
            exchange,
            silence_proves: method == Method::Silence,
            emulated: false,
            round_trips: VecDeque::with_capacity(ROUND_TRIPS),
        }
    }

    /// Whether the far end is the software drive of this process.
    #[must_use]
    pub(super) const fn emulated(mut self, emulated: bool) -> Self {
        self.emulated = emulated;
        self
    }

    fn in_step(&mut self, turn: Turn<'_>) -> Result<()> {
        let Self { language, exchange, .. } = self;
        exchange.in_step(&turn.pdu(), |exchange, pdu| language.probe(exchange, pdu))
    }

    fn call(&mut self, turn: Turn<'_>, allowed: Duration) -> Result<Answer<Vec<u16>>> {
        let what = turn.text();
        let query = Query::plain(turn.pdu(), &what, allowed, turn.requested());
        self.language.call(&mut self.exchange, turn, query)
    }

    fn bytes(&self, turn: Turn<'_>) -> (usize, usize) {
        self.language.bytes(self.exchange.kind, turn)
    }

    /// A turn whose reply is accepted only if no second one comes within the usual time of a reply.
    fn alone(&mut self, turn: Turn<'_>) -> Result<CellsRead> {
        let turn = self.language.prepared(self.exchange.kind, turn);
        self.in_step(turn)?;
        let (request, reply) = self.bytes(turn);
        let wire = self.exchange.core.timing.wire(request, reply);
        let sent = now();
        let stale_frames = |bus: &Self| bus.exchange.filter.inner().reception.line.stale_frames;
        let before = stale_frames(self);
        let usual = self.longest(|(took, _)| *took);
        if self.exchange.core.bound.ends_before(sent + usual) {
            // Its reply would arrive outside an exchange and put the line in doubt.
            return Err(self.exchange.unproven());
        }
        let answer = self.call(turn, self.allowed(turn, request, reply))?;
        let mut answer = CellsRead { cells: answer.value, span: answer.span, written: answer.span };
        if let Some(put) = turn.put.filter(|_| self.exchange.kind.writes_apart()) {
            // The drive had the write while the rest of the request was on its way.
            let rest = request.saturating_sub(self.bytes(Turn::write(put)).0);
            let timing = &self.exchange.core.timing;
            let written_s = answer.span.asked_s - timing.wire(rest, 0).as_secs_f64();
            let written_s = written_s.max(self.exchange.core.host_s(sent));
            answer.written = Span::new(written_s, written_s);
        }
        if self.exchange.kind.is_numbered() {
            return Ok(answer);
        }
        let took = now().saturating_duration_since(sent);
        self.remember(took, wire);
        if took < usual {
            wait_until(sent + usual);
        }
        if !self.exchange.proof.is_doubtful() {
            self.exchange.listen_out()?;
        }
        if self.exchange.proof.is_doubtful() {
            let name = self.exchange.core.name.clone();
            let what = turn.text();
            return Err(if stale_frames(self) > before {
                LinkError::Stale(name, format!("another reply came with that to {what}"))
            } else {
                LinkError::Corrupt(name, format!("other bytes came with the reply to {what}"))
            });
        }
        Ok(answer)
    }

    /// Time of one exchange: a bounded one belongs to a cycle.
    fn allowed(&self, turn: Turn<'_>, request_bytes: usize, reply_bytes: usize) -> Duration {
        let core = &self.exchange.core;
        let one = if core.bound.is_set() {
            core.timing.hurried(request_bytes, reply_bytes)
        } else {
            core.timing.allowed(request_bytes, reply_bytes)
        };
        one + core.timing.answers(self.language.more_answers(turn))
    }

    /// Updates the usual time of a reply; a silence that is the only proof keeps its length.
    fn remember(&mut self, took: Duration, wire: Duration) {
        if self.round_trips.len() == ROUND_TRIPS {
            self.round_trips.pop_front();
        }
        let lag = took.saturating_sub(wire);
        self.round_trips.push_back((took, lag));
        if self.round_trips.len() == ROUND_TRIPS && !self.silence_proves {
            let lag = self.longest(|(_, lag)| *lag);
            let timing = &mut self.exchange.core.timing;
            timing.measured(lag);
            self.exchange.proof.set_quiet(timing.quiet());
        }
    }

    /// Longest of the latest round trips except the two longest, which a busy host may have delayed.
    fn longest(&self, of: impl Fn(&(Duration, Duration)) -> Duration) -> Duration {
        let mut longest: Vec<Duration> = self.round_trips.iter().map(of).collect();
        longest.sort_unstable_by(|a, b| b.cmp(a));
        longest.get(2).copied().unwrap_or_default()
    }
}

impl<L: Language> CellBus for LineBus<L> {
    over_an_exchange!();

    fn now_s(&self) -> f64 {
        self.exchange.core.host_s(now())
    }

    fn pause_until_s(&mut self, time_s: f64) {
        if let Ok(since) = Duration::try_from_secs_f64(time_s) {
            wait_until(self.exchange.core.epoch + since);
        }
    }

    fn read(&mut self, read: ReadRequest) -> Result<CellsRead> {
        let mut attempt = 1;
        loop {
            match self.alone(Turn::read(read)) {
                Err(error) if self.exchange.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    fn write(&mut self, put: Put<'_>) -> Result<Span> {
        let turn = Turn::write(put);
        self.in_step(turn)?;
        let (request, reply) = self.bytes(turn);
        Ok(self.call(turn, self.allowed(turn, request, reply))?.span)
    }

    fn write_at_once(&mut self, put: Put<'_>) -> Result<Span> {
        self.exchange.listen()?;
        let turn = Turn::write(put);
        let (request, reply) = self.bytes(turn);
        let timing = &self.exchange.core.timing;
        let mut allowed = timing.allowed(request, reply);
        if self.exchange.proof.is_doubtful() {
            // On a line in doubt the reply is awaited no longer than usual.
            allowed = allowed.min(timing.brief(request, reply));
        }
        allowed += timing.answers(self.language.more_answers(turn));
        // What stops a drive has its own short time, whatever is left of that for reading.
        let bound = std::mem::take(&mut self.exchange.core.bound);
        let result = self.call(turn, allowed);
        self.exchange.core.bound = bound;
        Ok(result?.span)
    }

    fn read_write(&mut self, put: Put<'_>, read: ReadRequest) -> Result<CellsRead> {
        self.alone(Turn { put: Some(put), read: Some(read), skipped: 0 })
    }

    fn object(&mut self, object: u8) -> Result<Option<String>> {
        self.language.object(&mut self.exchange, object)
    }

    fn is_emulated(&self) -> bool {
        self.emulated
    }

    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        self.exchange.core.timing.shortest_cycle_s(request_bytes, reply_bytes)
    }
}
