//! One request and its reply on a line, in whatever language: gap, silence, proof, deadline, statistics.
//!
//! ```text
//! Query -> listen (gap, strays) -> in_step (proof.rs: silence, probes) -> call (bytes out, reply or deadline) -> Answer
//! ```
//!
//! This file owns the clock of the exchanges. How a request becomes bytes is the caller's: modbus.rs uses tokio-modbus.

use std::future::Future;
use std::io::{self, ErrorKind};
use std::time::{Duration, Instant};

use super::exceptions::Requested;
use super::framing::FrameKind;
use super::link::{LinkError, Result};
use super::link_core::{Answer, LinkCore, READ_ATTEMPTS};
use super::proof::{DEADLINE_SILENCES, End, Method, Policy, Proof, Step};
use super::reply_filter::{Port, ReplyFilter};
use super::timing::{LineTiming, wait_until};
use super::transaction::{Bound, LineCounts, never_silent, out_of_step};
use super::unexpected::Unexpected;
use super::waiting::{Waiting, now};

/// A line with its port, and the state of what was exchanged over it.
pub(super) struct Exchange {
    pub(super) core: LinkCore,
    pub(super) filter: ReplyFilter,
    // Behind the port: what uses the runtime that waits is dropped before it.
    waiting: Waiting,
    pub(super) kind: FrameKind,
    pub(super) proof: Proof,
    retries: u64,
    resync: Duration,
    /// Probes for resynchronisation, and the number of disturbances that caused them.
    pub(super) probes: u64,
    pub(super) resynchronisations: u64,
    /// Duration of the last exchange that got a reply.
    pub(super) last_round_trip: Duration,
    /// Whom a request went to, for the error of one without a reply: ` of unit 7 at 9600 8N1`.
    pub(super) addressee: String,
}

/// A request as the proof and the errors take it.
#[derive(Clone, Copy)]
pub(super) struct Query<'a> {
    /// Function and the four bytes behind it.
    pub(super) pdu: [u8; 5],
    pub(super) what: &'a str,
    pub(super) allowed: Duration,
    /// Interrupted when a stop is requested.
    pub(super) is_probe: bool,
    /// Its reply carries its own number.
    pub(super) is_numbered: bool,
    /// For the help of an exception.
    pub(super) requested: Requested,
}

impl<'a> Query<'a> {
    pub(super) const fn plain(
        pdu: [u8; 5],
        what: &'a str,
        allowed: Duration,
        requested: Requested,
    ) -> Self {
        Self { pdu, what, allowed, is_probe: false, is_numbered: false, requested }
    }
}

pub(super) enum NoData {
    /// The drive refused it, with this code and its name.
    Refused {
        code: u8,
        name: &'static str,
    },
    /// Frames of another version of our own protocol.
    Version(u8),
    /// A reply that is not the one to this request.
    Mismatch(String),
    Transport(io::Error),
}

impl Exchange {
    /// Over a port that was opened within the runtime that waits for it.
    pub(super) fn new(
        name: String,
        waiting: Waiting,
        port: Box<dyn Port>,
        kind: FrameKind,
        timing: LineTiming,
        epoch: Instant,
    ) -> Self {
        let policy = match kind {
            FrameKind::Rtu => Policy::Fixed(Method::Nonce),
            FrameKind::Dynamixel => Policy::Fixed(Method::Length),
            kind if kind.is_numbered() => Policy::Numbered,
            _ => Policy::Fixed(Method::Silence),
        };
        Self {
            proof: Proof::new(policy, timing.quiet(), now()).always_apart(),
            core: LinkCore::new(name, timing, epoch),
            filter: ReplyFilter::new(port, kind),
            waiting,
            kind,
            retries: 0,
            resync: Duration::ZERO,
            probes: 0,
            resynchronisations: 0,
            last_round_trip: Duration::ZERO,
            addressee: String::new(),
        }
    }

    /// Until the bound of the exchange is over.
    pub(super) fn may_retry(&mut self, error: &LinkError, attempt: usize) -> bool {
        let may = error.is_transient()
            && !matches!(error, LinkError::Unproven { .. })
            && attempt < READ_ATTEMPTS
            && !self.core.bound.is_over(now());
        self.retries += u64::from(may);
        may
    }

    /// Waits for the gap before a request; bytes received meanwhile answer nothing.
    pub(super) fn listen(&mut self) -> Result<()> {
        self.core.live()?;
        let strays = self.after_gap();
        self.judge(strays)?;
        self.drop_rest().map(drop)
    }

    /// Drops what is left, and returns how many bytes of it disturb.
    fn drop_rest(&mut self) -> Result<usize> {
        let rest = self.filter.inner().reception.drop_rest();
        self.judge(Ok(rest))
    }

    fn after_gap(&mut self) -> io::Result<usize> {
        let last = self.filter.inner().reception.last_activity;
        wait_until(last + self.core.timing.gap());
        self.waiting.at_once(self.filter.begin()).unwrap_or(Ok(0))
    }

    /// The same, and waits for the end of a copy of the last reply that is still coming.
    pub(super) fn listen_out(&mut self) -> Result<()> {
        self.core.live()?;
        let until = now() + self.core.timing.quiet();
        loop {
            let strays = self.after_gap();
            self.judge(strays)?;
            let is_over = now() >= until || self.core.bound.is_over(now());
            if is_over || !self.filter.inner().reception.is_copying() {
                return self.drop_rest().map(drop);
            }
            let step = self.core.timing.gap().max(Duration::from_millis(1));
            let came = self.waiting.until(now() + step, self.filter.listen());
            self.judge(came.unwrap_or(Ok(0)))?;
        }
    }

    /// Handles bytes received while no request was outstanding.
    fn judge(&mut self, strays: io::Result<usize>) -> Result<usize> {
        let count = strays.map_err(|error| self.lost(&error))?;
        if count > 0 {
            let old = self.filter.inner().reception.take_old_replies();
            self.proof.disturbed(&old, now());
        }
        Ok(count)
    }

    /// Silence up to this instant, or until something comes (false); an error where the exchange must not take so long.
    fn keep_silent(&mut self, until: Instant) -> Result<bool> {
        loop {
            let now = now();
            if now >= until {
                return Ok(true);
            }
            if self.core.bound.is_over(now) {
                return Err(self.unproven());
            }
            let look = self.core.bound.next_look(now, until);
            let came = self.waiting.until(look, self.filter.listen());
            // Also what looks like the beginning of a copy: it may be that of a late reply.
            if self.judge(came.unwrap_or(Ok(0)))? + self.drop_rest()? > 0 {
                return Ok(false);
            }
        }
    }

    /// Waits until the line has been silent for so long that nothing old comes any more.
    pub(super) fn wait_for_quiet(&mut self) -> Result<()> {
        let quiet = self.core.timing.quiet();
        let deadline = now() + DEADLINE_SILENCES * quiet;
        while !self.keep_silent(now() + quiet)? {
            if now() >= deadline {
                return Err(never_silent(&self.core.name));
            }
        }
        Ok(())
    }

    /// Synchronises the line before a request, so that the next reply cannot be that to an earlier one. A bounded exchange sends at
    /// most a few probes, and the next exchange continues. `probe` sends one and waits for its reply.
    pub(super) fn in_step(
        &mut self,
        pdu: &[u8],
        probe: impl FnMut(&mut Self, [u8; 5]) -> Result<()>,
    ) -> Result<()> {
        let begun = now();
        let result = self.synchronise(pdu, probe);
        self.resync += now().saturating_duration_since(begun);
        result
    }

    fn synchronise(
        &mut self,
        pdu: &[u8],
        mut probe: impl FnMut(&mut Self, [u8; 5]) -> Result<()>,
    ) -> Result<()> {
        self.listen()?;
        let (mut probes, mut begun) = (0, false);
        let mut failed = None;
        loop {
            let is_late = |bound: &Bound| {
                // Most probes of one bounded exchange.
                bound.is_set() && (probes == 3 || bound.is_over(now()))
            };
            match self.proof.next(pdu, now()) {
                Step::Go => return Ok(()),
                Step::Silence(until) => drop(self.keep_silent(until)?),
                Step::Probe(_) if is_late(&self.core.bound) => return Err(self.unproven()),
                Step::Probe(pdu) => {
                    let is_new = self.proof.is_disturbed() && !std::mem::replace(&mut begun, true);
                    self.resynchronisations += u64::from(is_new);
                    self.probes += 1;
                    probes += 1;
                    self.listen()?;
                    match probe(self, pdu) {
                        Err(error @ LinkError::Gone { .. }) => return Err(error),
                        // How it ended is known to the proof.
                        probed => {
                            failed = probed.err();
                            self.listen_out()?;
                        }
                    }
                }
                Step::NeverSilent => return Err(never_silent(&self.core.name)),
                Step::GiveUp => return Err(unprobed(&self.core.name, failed)),
            }
        }
    }

    /// One request and its reply, booked in the statistics; who calls has listened. `reply` sends the request and ends with what
    /// came; `check` turns that into a value or says what is wrong with it.
    pub(super) fn call<R, T>(
        &mut self,
        query: Query<'_>,
        reply: impl Future<Output = Result<R, NoData>>,
        check: impl FnOnce(R) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        let sent = now();
        let deadline = self.core.bound.earlier(sent + query.allowed);
        // With less time left no request goes out.
        if deadline < sent + Duration::from_millis(1) {
            return Err(self.unproven());
        }
        // What came before the request has been judged.
        self.filter.inner().reception.take_anomaly();
        self.proof.sent(&query.pdu, query.is_probe, sent);
        let reply = {
            let bound = &self.core.bound;
            let mut reply = std::pin::pin!(reply);
            loop {
                let look = if query.is_probe { bound.next_look(now(), deadline) } else { deadline };
                match self.waiting.until(look, reply.as_mut()) {
                    None if look < deadline && !bound.is_over(look) => {}
                    reply => break reply,
                }
            }
        };
        let received = now();
        let waited = received.saturating_duration_since(sent);
        let what = query.what;
        let result = match reply {
            Some(Ok(reply)) => check(reply).map_err(|reason| self.mismatch(reason)),
            Some(Err(NoData::Refused { code, name })) => Err(LinkError::Exception {
                link: self.core.name.clone(),
                request: what.to_owned(),
                code,
                name,
                requested: query.requested,
            }),
            Some(Err(NoData::Version(found))) => Err(LinkError::Version {
                link: self.core.name.clone(),
                found: found.into(),
                expected: firmware_protocol::PROTOCOL_VERSION,
            }),
            Some(Err(NoData::Mismatch(reason))) => Err(self.mismatch(reason)),
            Some(Err(NoData::Transport(error))) => Err(self.broken(&error, what)),
            // No reply in time: what came instead tells the class.
            None => {
                let left = self.filter.inner().reception.leftover();
                let what = format!("{what}{}", self.addressee);
                Err(left.error(&self.core.name, what, waited.min(deadline - sent)))
            }
        };
        let end = End::of(&result);
        if end != End::Missing {
            self.last_round_trip = waited;
        }
        let (asked, answered) = {
            let reception = &mut self.filter.inner().reception;
            self.core.is_unsent = reception.asked.is_none();
            if end == End::Missing {
                reception.retire();
            }
            self.proof.settle(end, reception, query.is_numbered, received);
            let asked = reception.asked.unwrap_or(sent);
            let answered = reception.answered.unwrap_or(received);
            let lengths = (reception.expected.request.len(), reception.reply.len());
            self.core.timing.acted(lengths, (asked, answered, received))
        };
        let core = &mut self.core;
        core.tally.settle(&result, waited.as_secs_f64());
        result.map(|value| Answer {
            value,
            span: core.span(asked, answered),
            complete_s: core.host_s(received),
        })
    }

    /// Closes the port: every later call fails.
    pub(super) fn close(&mut self) {
        self.core.gone = true;
        self.filter.close();
    }

    fn lost(&mut self, error: &io::Error) -> LinkError {
        self.close();
        self.core.gone(error)
    }

    fn broken(&mut self, error: &io::Error, request: &str) -> LinkError {
        if self.filter.inner().reception.is_rtu_over_tcp() {
            self.close();
            let (link, request) = (self.core.name.clone(), request.to_owned());
            return LinkError::Unexpected { link, request, what: Unexpected::RtuFrames };
        }
        if error.kind() == ErrorKind::InvalidData {
            LinkError::Corrupt(self.core.name.clone(), error.to_string())
        } else {
            self.lost(error)
        }
    }

    pub(super) fn mismatch(&self, reason: String) -> LinkError {
        LinkError::Mismatch(self.core.name.clone(), reason)
    }

    /// Deadline of the exchange, or a stop request, before the line was synchronised.
    pub(super) fn unproven(&self) -> LinkError {
        LinkError::Unproven(
            self.core.name.clone(),
            "the line is not proven to be in step yet, and the time of this exchange is over"
                .to_owned(),
        )
    }

    pub(super) fn line_counts(&self) -> LineCounts {
        LineCounts {
            retries: self.retries,
            resync_ms: u64::try_from(self.resync.as_millis()).unwrap_or(u64::MAX),
            ..self.filter.inner().reception.line
        }
    }
}

/// Methods that a link and a bus of cells delegate to their exchange.
macro_rules! over_an_exchange {
    () => {
        fn name(&self) -> crate::link::LinkName {
            crate::link::LinkName(self.exchange.core.name.clone())
        }

        fn statistics(&self) -> crate::link::LinkStatistics {
            self.exchange.core.tally.statistics
        }

        fn round_trips(&self) -> Option<&crate::link::RoundTrips> {
            Some(&self.exchange.core.tally.round_trips)
        }

        fn line(&self) -> Option<crate::transaction::LineCounts> {
            Some(self.exchange.line_counts())
        }

        fn bound(&mut self, left_s: f64) {
            self.exchange.core.bound.set(left_s, crate::waiting::now());
        }

        fn stop_request(&mut self) -> Option<&mut crate::transaction::StopRequest> {
            Some(&mut self.exchange.core.bound.stop_request)
        }

        fn close(&mut self) {
            self.exchange.close();
        }
    };
}

pub(super) use over_an_exchange;

/// Why the line could not be proven. Where the probes got nothing, a refusal or damage, that is what is wrong with it.
fn unprobed(name: &str, last: Option<LinkError>) -> LinkError {
    match last {
        Some(
            error @ (LinkError::Timeout { .. }
            | LinkError::Exception { .. }
            | LinkError::Unexpected { .. }
            | LinkError::Corrupt { .. }),
        ) => error,
        _ => out_of_step(name),
    }
}
