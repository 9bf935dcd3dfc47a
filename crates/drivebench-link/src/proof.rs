//! Synchronisation of requests and replies. RTU has no transaction number, so a reply that fits may be that to an earlier
//! request: late or repeated. Pure: its inputs are requests, replies and times.
//!
//! ```text
//!         late reply or timeout                      ambiguous reply, or a policy that proves after every disturbance
//! InStep -----------------------> Disturbed -------------------------------------------------------> Doubtful
//!    ^                                |                                                                  |
//!    +--- probe answered alone -------+--- before a request that an older reply fits --------------------+
//!
//! proof: silence -> probe, up to 6 times -> in step | given up
//! reply whose code (function and length) only one request since then could have got -> all before that one are over
//! ```
//!
//! A unit answers in order. Therefore a reply that fits only one request belongs to it, whatever else was received, and no older
//! reply follows.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::cell_bus::{CellTable, MOST_READ, ReadRequest};
use super::framing::Code;
use super::link::{LinkError, Result};
use super::transaction::{OldReply, Reception};

/// Time without a silence, in silences, after which the line is given up.
pub(super) const DEADLINE_SILENCES: u32 = 4;

struct Settings {
    /// Requests that are kept since the last proof.
    requests: usize,
    /// Reads without an old reply after which none is expected any more.
    clean_reads: u32,
    /// Time without an old reply, in longest delays of one, after which no silence is kept for it any more: the silence would cost
    /// more than the repeated request, and an old reply is detected all the same.
    clean_delays: u32,
}

const SETTINGS: Settings = Settings { requests: 32, clean_reads: 32, clean_delays: 100 };

/// How the reply to a probe is distinguished from all earlier ones. In the order of trial: a read has no side effect, but after
/// function code 08 some servers do not answer the next request (libmodbus 3.1 takes its data for a request), so it is last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    /// A read of another number of registers than any request since the last proof.
    Length,
    /// A read of the other table: every reply carries the other function code.
    OtherTable,
    /// Function code 08 with a number that the unit echoes.
    Nonce,
    /// Nothing came for a while: weaker, for units that answer no probe.
    Silence,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Policy {
    /// Every reply carries the number of its request (TCP): no proof is needed.
    Numbered,
    /// As the drive's profile states. Every disturbance has to be followed by a proof.
    Fixed(Method),
    /// By trial, with a silence of this length as the last means; only for replies that could be exchanged.
    Trial(Duration),
}

/// Step before a request may be sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Go,
    /// Nothing may come before this instant.
    Silence(Instant),
    /// Send this PDU and wait for its reply only.
    Probe([u8; 5]),
    NeverSilent,
    /// No probe was answered alone; the next call starts again.
    GiveUp,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Data,
    Refused,
    Missing,
}

impl End {
    pub(super) const fn of<T>(result: &Result<T>) -> Self {
        match result {
            Ok(_) => Self::Data,
            Err(LinkError::Exception { .. }) => Self::Refused,
            Err(_) => Self::Missing,
        }
    }
}

/// Synchronisation of requests and replies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sync {
    /// Nothing was wrong since the last proof.
    InStep,
    /// A late reply or a timeout since then: reads that no older reply fits may go out.
    Disturbed,
    /// The next reply may be an old one: nothing goes out before a proof. True: something was wrong since the last.
    Doubtful(bool),
}

#[derive(Clone, Copy, Debug)]
enum Wait {
    None,
    /// Until the line is quiet, since this instant.
    Quiet(Instant),
    /// Until this instant, as the proof itself.
    Proof(Instant),
}

#[derive(Debug)]
struct Probing {
    method: Method,
    /// Probes since a request may have gone out.
    count: usize,
    /// Probes in a row without any reply.
    unanswered: usize,
    nonce: u16,
    /// Registers that were read, of which a probe may read more or fewer; and the most that may be read.
    place: Option<(ReadRequest, u16)>,
}

/// Silence between reads with equal replies, on lines with late replies.
#[derive(Debug, Default)]
struct Spacing {
    /// On every line: the reads are rare.
    always: bool,
    /// Requests that ended within the last silence.
    ended: Vec<(Code, Instant)>,
    clean_reads: u32,
    /// Until when the silences are kept if nothing more is wrong, and the longest delay of an old reply.
    delayed: Option<(Instant, Duration)>,
}

/// A request since the line was last proven to be in step.
#[derive(Clone, Copy, Debug)]
struct SentRequest {
    head: [u8; 5],
    code: Code,
    at: Instant,
    /// It got data in reply; else a refusal may still come late.
    is_answered: bool,
    probe: Option<Method>,
}

impl SentRequest {
    /// Whether the reply to this could be taken for the one to another request with this code.
    fn looks_like(&self, code: Code, head: [u8; 5]) -> bool {
        // Their replies repeat the request.
        let is_echoed = matches!(head[0], 5 | 6 | 8 | 15 | 16);
        self.code == code && self.head != head && !is_echoed
    }
}

/// State of the synchronisation.
#[derive(Debug)]
pub(super) struct Proof {
    policy: Policy,
    /// Silence after which no late reply can come.
    quiet: Duration,
    sync: Sync,
    wait: Wait,
    probing: Probing,
    spacing: Spacing,
    requests: VecDeque<SentRequest>,
    /// The last request without a reply: its own may come when a probe has been answered already.
    missing: Option<(Code, Instant)>,
    /// The line was in step at least once: everything before the first of the requests is over.
    pub(super) is_proven: bool,
    /// The unit has answered at least once.
    pub(super) has_answered: bool,
    /// The last reply can belong to no other request.
    pub(super) is_unambiguous: bool,
    /// Number of late replies, foreign frames and time-outs, and the time of the last.
    pub(super) anomalies: u64,
    disturbed_at: Instant,
}

impl Proof {
    pub(super) fn new(policy: Policy, quiet: Duration, now: Instant) -> Self {
        let [.., high, low] = std::process::id().to_be_bytes();
        let (method, is_fixed) = match policy {
            Policy::Fixed(method) => (method, true),
            _ => (Method::Length, false),
        };
        Self {
            policy,
            quiet,
            // By trial the first replies are proved later; otherwise a reply to the previous master may still come.
            sync: if is_fixed { Sync::Doubtful(false) } else { Sync::InStep },
            wait: Wait::None,
            probing: Probing {
                method,
                count: 0,
                unanswered: 0,
                nonce: u16::from_be_bytes([high, low]),
                place: None,
            },
            spacing: Spacing::default(),
            requests: VecDeque::with_capacity(SETTINGS.requests),
            missing: None,
            is_proven: false,
            has_answered: is_fixed,
            is_unambiguous: false,
            anomalies: 0,
            disturbed_at: now,
        }
    }

    /// For a link with rare reads: those with equal replies are always separated by a silence.
    pub(super) const fn always_apart(mut self) -> Self {
        self.spacing.always = true;
        self
    }

    /// Another way of proving, and registers for the length code that can be read in any number up to this.
    pub(super) fn set_policy(&mut self, method: Method, place: Option<(ReadRequest, u16)>) {
        if self.policy != Policy::Numbered {
            self.policy = Policy::Fixed(method);
        }
        self.probing.method = method;
        self.probing.place = place;
        self.spacing.always = false;
    }

    /// Silence after which nothing old comes any more, as it was measured.
    pub(super) const fn set_quiet(&mut self, quiet: Duration) {
        self.quiet = quiet;
    }

    /// The next requests go to another unit of the line.
    pub(super) const fn forget_unit(&mut self) {
        self.has_answered = false;
        self.probing.place = None;
        self.probing.method = Method::Length;
    }

    /// The line has to be proven before the next request.
    pub(super) fn doubt(&mut self) {
        if self.policy != Policy::Numbered {
            self.sync = Sync::Doubtful(self.is_disturbed());
        }
    }

    /// Nothing goes out before a proof.
    pub(super) const fn is_doubtful(&self) -> bool {
        matches!(self.sync, Sync::Doubtful(_))
    }

    /// Something was wrong since the last proof.
    pub(super) const fn is_disturbed(&self) -> bool {
        matches!(self.sync, Sync::Disturbed | Sync::Doubtful(true))
    }

    /// A read that was answered: a probe may read the same place.
    pub(super) fn readable(&mut self, read: ReadRequest) {
        self.probing.place = Some((read, MOST_READ.min(u16::MAX - read.address)));
    }

    /// Whether a reply to another request since the last proof could be taken for the one to this.
    pub(super) fn could_confuse(&self, pdu: &[u8]) -> bool {
        let (head, code) = (head(pdu), Code::answering(pdu));
        let mut requests = self.requests.iter();
        self.policy != Policy::Numbered && requests.any(|other| other.looks_like(code, head))
    }

    /// Step before this request.
    pub(super) fn next(&mut self, pdu: &[u8], now: Instant) -> Step {
        if self.policy == Policy::Numbered {
            return Step::Go;
        }
        let quiet_at = self.disturbed_at + self.quiet;
        let is_read = matches!(pdu.first(), Some(3 | 4 | 43));
        let needs_proof = match self.sync {
            Sync::InStep => false,
            Sync::Disturbed => !is_read || self.could_confuse(pdu),
            Sync::Doubtful(_) => true,
        };
        if self.sync != Sync::InStep && now < quiet_at {
            return self.silence(quiet_at, now);
        }
        if !needs_proof {
            self.probing.count = 0;
            if let Some(until) = self.apart_until(Code::answering(pdu), now).filter(|_| is_read) {
                return self.silence(until, now);
            }
            self.wait = Wait::None;
            return Step::Go;
        }
        if !self.has_answered {
            // No reply yet from this unit; the proof after the first one finds late replies.
            self.sync = Sync::InStep;
            self.wait = Wait::None;
            return Step::Go;
        }
        if let (Method::Silence, Policy::Trial(longest)) = (self.probing.method, self.policy) {
            let until = match self.wait {
                Wait::Proof(until) => until,
                Wait::None | Wait::Quiet(_) => now + longest,
            };
            if now < until {
                self.wait = Wait::Proof(until);
                return Step::Silence(until);
            }
        }
        self.wait = Wait::None;
        // Probes of one resynchronisation.
        if self.probing.count == 6 {
            self.probing.count = 0;
            self.doubt();
            return Step::GiveUp;
        }
        self.probing.count += 1;
        let Some(probe) = self.probe(pdu) else {
            let is_fixed = matches!(self.policy, Policy::Fixed(_));
            if is_fixed || self.probing.method == Method::Silence {
                self.requests.clear();
                self.in_step(Method::Silence);
            } else {
                self.probing.next_method();
            }
            return self.next(pdu, now);
        };
        Step::Probe(probe)
    }

    fn silence(&mut self, until: Instant, now: Instant) -> Step {
        let since = match self.wait {
            Wait::Quiet(since) => since,
            Wait::None | Wait::Proof(_) => now,
        };
        let limit = match self.policy {
            Policy::Trial(longest) => longest.max(DEADLINE_SILENCES * self.quiet),
            _ => DEADLINE_SILENCES * self.quiet,
        };
        if now.saturating_duration_since(since) > limit {
            self.wait = Wait::None;
            return Step::NeverSilent;
        }
        self.wait = Wait::Quiet(since);
        Step::Silence(until)
    }

    /// End of the silence that separates this read from an earlier one with an equal reply.
    fn apart_until(&mut self, code: Code, now: Instant) -> Option<Instant> {
        let (quiet, spacing) = (self.quiet, &mut self.spacing);
        spacing.delayed = spacing.delayed.filter(|(until, _)| now < *until);
        let is_clean = spacing.clean_reads >= SETTINGS.clean_reads && spacing.delayed.is_none();
        if matches!(self.policy, Policy::Trial(_)) || (is_clean && !spacing.always) {
            spacing.ended.clear();
            return None;
        }
        spacing.ended.retain(|(_, ended)| now < *ended + quiet);
        let mut alike = spacing.ended.iter().filter(|(other, _)| *other == code);
        alike.next_back().map(|(_, ended)| *ended + quiet)
    }

    /// Bytes came while no request was outstanding.
    pub(super) fn disturbed(&mut self, old: &[OldReply], now: Instant) {
        if self.policy == Policy::Numbered {
            self.anomalies += 1;
            return;
        }
        self.anomaly(old, now);
        if matches!(self.policy, Policy::Fixed(_)) || !self.is_proven {
            self.doubt();
        }
    }

    fn anomaly(&mut self, old: &[OldReply], now: Instant) {
        self.anomalies += 1;
        self.sync = match self.sync {
            Sync::InStep | Sync::Disturbed => Sync::Disturbed,
            Sync::Doubtful(_) => Sync::Doubtful(true),
        };
        self.disturbed_at = now;
        self.end_silent_proof();
        self.has_answered |= !old.is_empty();
        let before = self.spacing.delayed.map(|(_, longest)| longest);
        if let Some(longest) = old.iter().map(|old| self.delay(old.code, now)).chain(before).max() {
            let stretch = SETTINGS.clean_delays * longest;
            // At least 2 s, because one second proves little; at most 30 s.
            let until = now + stretch.clamp(Duration::from_secs(2), Duration::from_secs(30));
            self.spacing.delayed = Some((until, longest));
        }
    }

    const fn end_silent_proof(&mut self) {
        if let Wait::Proof(_) = self.wait {
            self.wait = Wait::None;
        }
    }

    /// Longest possible delay of this late reply after its request.
    fn delay(&self, code: Code, now: Instant) -> Duration {
        let alike = || self.requests.iter().filter(|request| request.code == code);
        let unanswered = alike().find(|request| !request.is_answered);
        let missing = self.missing.filter(|(missing, _)| *missing == code);
        let at = unanswered.map(|request| request.at);
        let at = at.or(missing.map(|(_, at)| at));
        let at = at.or(alike().next_back().map(|request| request.at));
        at.map_or(self.quiet, |at| now.saturating_duration_since(at))
    }

    pub(super) fn sent(&mut self, pdu: &[u8], is_probe: bool, now: Instant) {
        if self.policy == Policy::Numbered {
            return;
        }
        if self.requests.len() >= SETTINGS.requests {
            self.requests.pop_front();
        }
        self.requests.push_back(SentRequest {
            head: head(pdu),
            code: Code::answering(pdu),
            at: now,
            is_answered: false,
            probe: is_probe.then_some(self.probing.method),
        });
    }

    /// End of an exchange: judges what else came. `numbered`: the reply carries its own number.
    pub(super) fn settle(
        &mut self,
        end: End,
        reception: &mut Reception,
        numbered: bool,
        now: Instant,
    ) {
        // By trial there is no profile by which a reply comes once.
        let repeated = reception.take_repeated() && matches!(self.policy, Policy::Trial(_));
        let strays = reception.take_anomaly() || repeated;
        self.ended(end, &reception.take_old_replies(), strays, numbered, now);
    }

    /// End of an exchange. `strays`: more than the reply came. `numbered`: the reply carries its own number.
    fn ended(&mut self, end: End, old: &[OldReply], strays: bool, numbered: bool, now: Instant) {
        let was_proven = self.is_proven;
        self.has_answered |= end != End::Missing;
        self.is_unambiguous = self.policy == Policy::Numbered;
        let Some(last) = self.requests.back_mut() else {
            self.anomalies += u64::from(strays || end == End::Missing);
            return;
        };
        last.is_answered = end == End::Data;
        let last = *last;
        if !matches!(self.policy, Policy::Trial(_)) {
            // Where no read is ever kept apart, nothing else removes them.
            let quiet = self.quiet;
            self.spacing.ended.retain(|(_, ended)| now < *ended + quiet);
            self.spacing.ended.push((last.code, now));
        }
        if end == End::Missing {
            self.missing = Some((last.code, last.at));
        }
        if strays || end == End::Missing {
            self.anomaly(old, now);
            // Without any byte the time-out itself was a silence; a probe shows the rest.
            let is_probed = matches!(self.policy, Policy::Fixed(Method::Nonce | Method::Length));
            if !strays && old.is_empty() && is_probed {
                self.disturbed_at = last.at;
            }
        } else {
            self.spacing.clean_reads = self.spacing.clean_reads.saturating_add(1);
        }
        let others = self.requests.len() - 1;
        let mut others = self.requests.iter().take(others);
        let is_unique = match end {
            End::Data => others.all(|other| !other.looks_like(last.code, last.head)),
            // A refusal carries no length: it is only clear where no older request may still be refused.
            End::Refused => others.all(|other| other.is_answered || other.head[0] != last.head[0]),
            End::Missing => false,
        };
        if let Policy::Fixed(_) = self.policy {
            let proves = numbered || last.probe.is_some();
            if strays || end == End::Missing {
                self.doubt();
            } else if proves && is_unique {
                self.requests.clear();
                self.in_step(self.probing.method);
            }
            return;
        }
        // Older ones come before the reply, never behind it.
        let in_order = old.iter().all(|old| !old.behind || old.code == last.code);
        if !in_order {
            self.doubt();
        }
        match last.probe {
            Some(method) if is_unique && in_order => {
                self.over_before(&last);
                self.in_step(method);
            }
            Some(_) => {
                self.probe_failed(end, strays);
                self.late_probe(old);
            }
            None => {
                self.is_unambiguous = was_proven && is_unique && in_order;
                if self.is_unambiguous && end == End::Data {
                    self.over_before(&last);
                } else if strays && !was_proven {
                    self.doubt();
                }
                self.late_probe(old);
            }
        }
    }

    /// A late reply to a probe proves too that all earlier requests are over.
    fn late_probe(&mut self, old: &[OldReply]) {
        for code in old.iter().filter(|old| !old.behind).map(|old| old.code) {
            let mut alike = self.requests.iter().filter(|request| request.code == code);
            if let (Some(probe), None) = (alike.next().copied(), alike.next())
                && let Some(method) = probe.probe
            {
                self.over_before(&probe);
                let is_disturbed = self.is_disturbed();
                self.in_step(method);
                if is_disturbed {
                    self.sync = Sync::Disturbed;
                }
            }
        }
    }

    /// Everything before the first request that is equal to this one is over.
    fn over_before(&mut self, request: &SentRequest) {
        let same = |other: &SentRequest| other.head == request.head;
        if let Some(first) = self.requests.iter().position(same) {
            self.requests.drain(..first);
        }
    }

    fn in_step(&mut self, method: Method) {
        self.is_proven = true;
        self.sync = Sync::InStep;
        self.end_silent_proof();
        self.probing.unanswered = 0;
        if matches!(self.policy, Policy::Trial(_)) {
            self.probing.method = method;
        }
    }

    fn probe_failed(&mut self, end: End, strays: bool) {
        let nothing = end == End::Missing && !strays;
        let probing = &mut self.probing;
        probing.unanswered = if nothing { probing.unanswered + 1 } else { 0 };
        probing.next_method();
        self.doubt();
    }

    fn probe(&mut self, before: &[u8]) -> Option<[u8; 5]> {
        let spared = Code::answering(before);
        let alike = |read: &ReadRequest| {
            let code = Code::answering(&read.pdu());
            (code, self.requests.iter().filter(move |request| request.code == code))
        };
        let is_free = |read: &ReadRequest| {
            let (code, mut alike) = alike(read);
            code != spared && alike.next().is_none()
        };
        let place = self.probing.place;
        match self.probing.method {
            Method::Length => {
                let (place, most) = place?;
                let shorter = (1..place.count).rev();
                let counts = || shorter.clone().chain(place.count..=most);
                let reads = || counts().map(|count| ReadRequest { count, ..place });
                // By the profile a reply comes once: an answered request followed by silence is over.
                let is_over = |read: &ReadRequest| alike(read).1.all(|request| request.is_answered);
                let is_fixed = matches!(self.policy, Policy::Fixed(_));
                let over = || reads().filter(|_| is_fixed).find(is_over);
                reads().find(is_free).or_else(over).map(ReadRequest::pdu)
            }
            Method::OtherTable => {
                let place = place.map(|(place, _)| place);
                // A refusal carries no length: the table that is tried is not the one that has been refused.
                let input_refused = || {
                    self.requests.iter().any(|request| request.head[0] == 4 && !request.is_answered)
                };
                let table = match place.map(|place| place.table) {
                    Some(CellTable::Input) => CellTable::Holding,
                    None if input_refused() => CellTable::Holding,
                    _ => CellTable::Input,
                };
                let address = place.map_or(0, |place| place.address);
                let mut reads = (1..=4).map(|count| ReadRequest { table, address, count });
                reads.find(is_free).map(ReadRequest::pdu)
            }
            Method::Nonce => {
                let nonce = &mut self.probing.nonce;
                *nonce = nonce.wrapping_mul(25_173).wrapping_add(13_849);
                let [high, low] = nonce.to_be_bytes();
                Some([8, 0, 0, high, low])
            }
            Method::Silence => None,
        }
    }
}

impl Probing {
    const fn next_method(&mut self) {
        self.method = match self.method {
            Method::Length => Method::OtherTable,
            Method::OtherTable => Method::Nonce,
            // Probes without any reply after which silence has to prove the line.
            Method::Nonce | Method::Silence if self.unanswered >= 3 => Method::Silence,
            Method::Nonce | Method::Silence => Method::Length,
        };
    }
}

/// Bytes that distinguish requests: function code and the next four.
fn head(pdu: &[u8]) -> [u8; 5] {
    let mut head = [0; 5];
    for (to, from) in head.iter_mut().zip(pdu) {
        *to = *from;
    }
    head
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::waiting::now;

    const QUIET: Duration = Duration::from_millis(20);

    #[test]
    fn a_unit_that_refuses_one_table_is_proven_by_the_other() {
        let begun = now();
        for (refused, other) in [(4, 3), (3, 4)] {
            let read = [refused, 0, 0, 0, 1];
            let mut proof = Proof::new(Policy::Trial(5 * QUIET), QUIET, begun);
            proof.sent(&read, false, begun);
            proof.ended(End::Refused, &[], false, false, begun);
            proof.doubt();
            let later = begun + 2 * QUIET;
            let Step::Probe(probe) = proof.next(&read, later) else {
                panic!("a doubt is followed by a probe");
            };
            assert_eq!(probe[0], other);
            proof.sent(&probe, true, later);
            proof.ended(End::Refused, &[], false, false, later);
            assert_eq!(proof.next(&read, later), Step::Go);
        }
    }
    const MS: Duration = Duration::from_millis(1);

    fn read(address: u16, count: u16) -> [u8; 5] {
        ReadRequest::holding(address, count).pdu()
    }

    #[test]
    fn commands_without_reads_are_remembered_for_one_silence() {
        let mut at = now();
        let mut proof = Proof::new(Policy::Fixed(Method::Nonce), QUIET, at);
        let mut most = 0;
        for _ in 0..10_000 {
            at += MS;
            proof.sent(&read(0, 1), false, at);
            proof.ended(End::Data, &[], false, true, at);
            most = most.max(proof.spacing.ended.len());
        }
        assert!((1..=20).contains(&most), "{most}");
    }
}
