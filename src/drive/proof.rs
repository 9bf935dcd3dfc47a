//! Proof that a line is in step. RTU has no transaction number, so a reply that fits may be that to a request
//! before it: late, or a second time. Pure: what was asked and answered goes in, with the times.
//!
//! ```text
//! in doubt -> silence -> probe, up to 6 times -> in step | out of step
//! reply whose code (function and length) only one request since then could have got -> all before that one are over
//! ```
//!
//! A unit answers in order. So a reply that only one request can have got is that request's, whatever lies around it, and
//! nothing older comes behind it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::link::LinkError;
use super::register_bus::{MOST_READ, ReadRequest, RegisterTable};
use super::reply::Code;
use super::transaction::{Heard, Reception};

/// Probes of one resynchronisation.
const PROBES: usize = 6;
/// Requests remembered since the last proof.
const REMEMBERED: usize = 32;
/// A line that talks for so many times the silence that is waited for is given up.
pub(super) const PATIENCE: u32 = 4;
/// Clean reads after which it is known that a line brings no old replies.
const KNOWN_AFTER: u32 = 32;
/// A clean stretch so many times longer than the longest delay that was seen ends the silences that are kept for it: where
/// a delay comes back less often than once in a hundred of its own length, waiting for it costs more than asking again,
/// and what comes beside a reply is noticed all the same.
const STRETCH_IN_DELAYS: u32 = 100;
/// Shortest and longest of these stretches: one good second proves little, and a bus that was in order for half a minute
/// is in order.
const SHORTEST_STRETCH: Duration = Duration::from_secs(2);
const LONGEST_STRETCH: Duration = Duration::from_secs(30);

/// What makes a probe unmistakable. The order is that of trial: a read can harm nobody, but function code 08 makes some
/// servers deaf (libmodbus 3.1 takes its data for the next request), so it comes last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    /// A read of so many registers as no request since the last proof has asked for.
    Length,
    /// A read of the other table: whatever is answered carries the other function code.
    OtherTable,
    /// Function code 08 with a number that comes back.
    Nonce,
    /// Nothing came for a while: weaker, for units that answer no probe.
    Silence,
}

/// How a line is proven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Policy {
    /// Every reply carries the number of its request (TCP): there is nothing to prove.
    Numbered,
    /// As the drive's profile says. Anything unexpected is a doubt.
    Fixed(Method),
    /// By trial, with a silence of so long as the last means. A doubt is what could be confused.
    Trial(Duration),
}

/// What is to be done before a request may go out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// In step: the request may go out.
    Go,
    /// Nothing may come before this instant.
    Silence(Instant),
    /// This PDU is asked, and no more than a reply to it is waited for.
    Probe([u8; 5]),
    /// The line is never silent.
    Restless,
    /// No probe came back alone; the next call begins anew.
    GiveUp,
}

/// How an exchange ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Data,
    Refused,
    Missing,
}

impl End {
    pub(super) const fn of<T>(result: &Result<T, LinkError>) -> Self {
        match result {
            Ok(_) => Self::Data,
            Err(LinkError::Exception { .. }) => Self::Refused,
            Err(_) => Self::Missing,
        }
    }
}

/// A request that went out since the line was last proven to be in step.
#[derive(Clone, Copy, Debug)]
struct Asked {
    head: [u8; 5],
    code: Code,
    at: Instant,
    /// It got data in reply; else a refusal may still come late.
    is_answered: bool,
    probe: Option<Method>,
}

impl Asked {
    /// Whether the reply to this could be taken for the one to another request with this code.
    fn looks_like(&self, code: Code, head: [u8; 5]) -> bool {
        // These send back what they were asked.
        let is_echoed = matches!(head[0], 5 | 6 | 8 | 15 | 16);
        self.code == code && self.head != head && !is_echoed
    }
}

/// Whether the line is in step, and what shows it.
#[derive(Debug)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent facts, each set and cleared by its own event"
)]
pub(super) struct Proof {
    policy: Policy,
    quiet: Duration,
    /// Reads that look alike are kept apart by silence on every line: they are rare.
    always_apart: bool,
    asked: VecDeque<Asked>,
    /// Everything before the first of them is over.
    pub(super) proven: bool,
    /// What comes next may be old.
    pub(super) suspect: bool,
    /// Something was wrong since the last proof.
    pub(super) dirty: bool,
    /// Times that something was wrong.
    pub(super) anomalies: u64,
    disturbed: Instant,
    restless: Option<Instant>,
    tried: usize,
    method: Method,
    /// The way of proving that has worked.
    worked: Option<Method>,
    /// Probes in a row after which nothing came.
    silent: usize,
    hushed: Option<Instant>,
    nonce: u16,
    /// Registers that have been read, of which a probe may read more or fewer; and the most that may be asked for.
    place: Option<(ReadRequest, u16)>,
    /// The unit has ever answered.
    pub(super) heard: bool,
    /// The last answer cannot be that to another request.
    pub(super) vouched: bool,
    /// Requests that ended within the last silence.
    recent: Vec<(Code, Instant)>,
    clean_reads: u32,
    /// The last request that got no reply: its own may come when a probe has been answered already.
    missing: Option<(Code, Instant)>,
    /// Until when reads that look alike are kept apart if nothing more is wrong, and the longest delay seen.
    wary: Option<(Instant, Duration)>,
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
            always_apart: false,
            asked: VecDeque::with_capacity(REMEMBERED),
            proven: false,
            // A reply to whoever used the line before us may be under way; by trial the first answers are proven later.
            suspect: is_fixed,
            dirty: false,
            anomalies: 0,
            disturbed: now,
            restless: None,
            tried: 0,
            method,
            worked: None,
            silent: 0,
            hushed: None,
            nonce: u16::from_be_bytes([high, low]),
            place: None,
            heard: is_fixed,
            vouched: false,
            recent: Vec::new(),
            clean_reads: 0,
            missing: None,
            wary: None,
        }
    }

    /// For a link whose plain reads are rare: those that look alike are always kept apart.
    pub(super) const fn always_apart(mut self) -> Self {
        self.always_apart = true;
        self
    }

    /// Another way of proving, and registers for the length code that can be read in any number up to this.
    pub(super) fn set_policy(&mut self, method: Method, place: Option<(ReadRequest, u16)>) {
        if self.policy != Policy::Numbered {
            self.policy = Policy::Fixed(method);
        }
        self.method = method;
        self.always_apart = false;
        self.place = place;
    }

    /// Silence after which nothing old comes any more, as it was measured.
    pub(super) const fn set_quiet(&mut self, quiet: Duration) {
        self.quiet = quiet;
    }

    /// From here on another unit of the line is asked.
    pub(super) fn forget_unit(&mut self) {
        self.heard = false;
        self.place = None;
        self.worked = None;
        self.method = Method::Length;
    }

    /// The line is to be proven before anything else is asked.
    pub(super) fn doubt(&mut self) {
        self.suspect = self.policy != Policy::Numbered;
    }

    /// A read that was answered: a probe may ask for the same place.
    pub(super) fn known(&mut self, read: ReadRequest) {
        self.place = Some((read, MOST_READ.min(u16::MAX - read.address)));
    }

    /// Whether a reply to another request since the last proof could be taken for the one to this.
    pub(super) fn could_confuse(&self, pdu: &[u8]) -> bool {
        let (head, code) = (head(pdu), Code::answering(pdu));
        let mut asked = self.asked.iter();
        self.policy != Policy::Numbered && asked.any(|other| other.looks_like(code, head))
    }

    /// What is to be done before this request.
    pub(super) fn next(&mut self, pdu: &[u8], now: Instant) -> Step {
        if self.policy == Policy::Numbered {
            return Step::Go;
        }
        let calm = self.disturbed + self.quiet;
        let is_read = matches!(pdu.first(), Some(3 | 4 | 43));
        let needs_proof = self.suspect || (self.dirty && (!is_read || self.could_confuse(pdu)));
        if (needs_proof || self.dirty) && now < calm {
            return self.silence(calm, now);
        }
        if !needs_proof {
            self.tried = 0;
            return match self.apart(Code::answering(pdu), now) {
                Some(until) if is_read => self.silence(until, now),
                _ => {
                    self.restless = None;
                    Step::Go
                }
            };
        }
        self.restless = None;
        if !self.heard {
            // Nobody is known to be there; what may still come is found by the proof after the first answer.
            self.suspect = false;
            self.dirty = false;
            return Step::Go;
        }
        if self.method == Method::Silence
            && let Policy::Trial(longest) = self.policy
        {
            let until = *self.hushed.get_or_insert(now + longest);
            if now < until {
                return Step::Silence(until);
            }
        }
        self.hushed = None;
        if self.tried == PROBES {
            self.tried = 0;
            self.suspect = true;
            return Step::GiveUp;
        }
        self.tried += 1;
        let Some(probe) = self.probe(pdu) else {
            if self.method == Method::Silence || matches!(self.policy, Policy::Fixed(_)) {
                self.asked.clear();
                self.in_step(Method::Silence);
            } else {
                self.method = self.after(self.method);
            }
            return self.next(pdu, now);
        };
        Step::Probe(probe)
    }

    fn silence(&mut self, until: Instant, now: Instant) -> Step {
        let since = *self.restless.get_or_insert(now);
        let patience = match self.policy {
            Policy::Trial(longest) => longest.max(PATIENCE * self.quiet),
            _ => PATIENCE * self.quiet,
        };
        if now.saturating_duration_since(since) > patience {
            self.restless = None;
            return Step::Restless;
        }
        Step::Silence(until)
    }

    /// Until when this read is kept apart from one before it that looks alike.
    fn apart(&mut self, code: Code, now: Instant) -> Option<Instant> {
        if self.wary.is_some_and(|(until, _)| now >= until) {
            self.wary = None;
        }
        let quiet = self.quiet;
        let is_known = self.clean_reads >= KNOWN_AFTER && self.wary.is_none();
        if matches!(self.policy, Policy::Trial(_)) || (is_known && !self.always_apart) {
            self.recent.clear();
            return None;
        }
        self.recent.retain(|(_, ended)| now < *ended + quiet);
        let mut alike = self.recent.iter().filter(|(other, _)| *other == code);
        alike.next_back().map(|(_, ended)| *ended + quiet)
    }

    /// Something came, or was found, while nothing was outstanding.
    pub(super) fn disturbed(&mut self, heard: &[Heard], now: Instant) {
        if self.policy == Policy::Numbered {
            self.anomalies += 1;
            return;
        }
        self.wrong(heard, now);
        let is_fixed = matches!(self.policy, Policy::Fixed(_));
        self.suspect |= is_fixed || !self.proven;
    }

    fn wrong(&mut self, heard: &[Heard], now: Instant) {
        self.anomalies += 1;
        self.dirty = true;
        self.disturbed = now;
        self.hushed = None;
        self.heard |= !heard.is_empty();
        let longest = self.wary.map_or(Duration::ZERO, |(_, longest)| longest);
        let delays = heard.iter().map(|heard| self.delay(heard.code, now));
        let delay = delays.fold(longest, Duration::max);
        if self.wary.is_some() || !heard.is_empty() {
            let stretch = STRETCH_IN_DELAYS * delay;
            let until = now + stretch.clamp(SHORTEST_STRETCH, LONGEST_STRETCH);
            self.wary = Some((until, delay));
        }
    }

    /// How long after its request this old reply came at the most.
    fn delay(&self, code: Code, now: Instant) -> Duration {
        let mut asked = self.asked.iter().filter(|asked| asked.code == code);
        let first = asked.find(|asked| !asked.is_answered);
        let last = self.asked.iter().rev().find(|asked| asked.code == code);
        let missing = self.missing.filter(|(missing, _)| *missing == code);
        let at = first.map(|asked| asked.at).or(missing.map(|(_, at)| at));
        let at = at.or(last.map(|asked| asked.at));
        at.map_or(self.quiet, |at| now.saturating_duration_since(at))
    }

    /// A request goes out.
    pub(super) fn asked(&mut self, pdu: &[u8], is_probe: bool, now: Instant) {
        if self.policy == Policy::Numbered {
            return;
        }
        if self.asked.len() >= REMEMBERED {
            self.asked.pop_front();
        }
        self.asked.push_back(Asked {
            head: head(pdu),
            code: Code::answering(pdu),
            at: now,
            is_answered: false,
            probe: is_probe.then_some(self.method),
        });
    }

    /// The exchange is over: judges what came beside the reply. `numbered`: the reply carries its own number.
    pub(super) fn settle(
        &mut self,
        end: End,
        reception: &mut Reception,
        numbered: bool,
        now: Instant,
    ) {
        let strays = reception.take_anomaly();
        self.ended(end, &reception.take_heard(), strays, numbered, now);
    }

    /// The exchange is over. `strays`: something beside the reply came. `numbered`: the reply carries its own number.
    fn ended(&mut self, end: End, heard: &[Heard], strays: bool, numbered: bool, now: Instant) {
        let was_proven = self.proven;
        self.heard |= end != End::Missing;
        self.vouched = self.policy == Policy::Numbered;
        let Some(last) = self.asked.back_mut() else {
            self.anomalies += u64::from(strays || end == End::Missing);
            return;
        };
        last.is_answered = end == End::Data;
        let last = *last;
        if !matches!(self.policy, Policy::Trial(_)) {
            // A loop that never asks whether reads are to be kept apart would keep them all.
            let quiet = self.quiet;
            self.recent.retain(|(_, ended)| now < *ended + quiet);
            self.recent.push((last.code, now));
        }
        if end == End::Missing {
            self.missing = Some((last.code, last.at));
        }
        if strays || end == End::Missing {
            self.wrong(heard, now);
            // Where nothing came at all the wait for it was silence already, and a probe will tell.
            let is_probed = matches!(self.policy, Policy::Fixed(Method::Nonce | Method::Length));
            if !strays && heard.is_empty() && is_probed {
                self.disturbed = last.at;
            }
        } else {
            self.clean_reads = self.clean_reads.saturating_add(1);
        }
        let others = self.asked.len() - 1;
        let mut others = self.asked.iter().take(others);
        let is_unique = match end {
            End::Data => others.all(|other| !other.looks_like(last.code, last.head)),
            // A refusal carries no length: it is only clear where no older request may still be refused.
            End::Refused => others.all(|other| other.is_answered || other.head[0] != last.head[0]),
            End::Missing => false,
        };
        if let Policy::Fixed(_) = self.policy {
            let proves = numbered || last.probe.is_some();
            if strays || end == End::Missing {
                self.suspect = true;
            } else if proves && is_unique {
                self.asked.clear();
                self.in_step(self.method);
            }
            return;
        }
        // Older ones come before the reply, never behind it.
        let in_order = heard
            .iter()
            .all(|heard| !heard.behind || heard.code == last.code);
        self.suspect |= !in_order;
        match last.probe {
            Some(method) if is_unique && in_order => {
                self.over_before(&last);
                self.in_step(method);
            }
            Some(_) => {
                self.probe_failed(end, strays);
                self.late_probe(heard);
            }
            None => {
                self.vouched = was_proven && is_unique && in_order;
                if self.vouched && end == End::Data {
                    self.over_before(&last);
                } else if strays && !was_proven {
                    self.suspect = true;
                }
                self.late_probe(heard);
            }
        }
    }

    /// A probe that is answered too late proves as well that all before it are over.
    fn late_probe(&mut self, heard: &[Heard]) {
        for code in heard.iter().filter(|h| !h.behind).map(|h| h.code) {
            let mut alike = self.asked.iter().filter(|asked| asked.code == code);
            if let (Some(probe), None) = (alike.next().copied(), alike.next())
                && let Some(method) = probe.probe
            {
                self.over_before(&probe);
                let dirty = self.dirty;
                self.in_step(method);
                self.dirty = dirty;
            }
        }
    }

    /// Everything that was asked before the first asking of this is over.
    fn over_before(&mut self, asked: &Asked) {
        let same = |other: &Asked| other.head == asked.head;
        if let Some(first) = self.asked.iter().position(same) {
            self.asked.drain(..first);
        }
    }

    fn in_step(&mut self, method: Method) {
        self.proven = true;
        self.suspect = false;
        self.dirty = false;
        self.silent = 0;
        self.hushed = None;
        if matches!(self.policy, Policy::Trial(_)) {
            self.method = method;
            self.worked = Some(method);
        }
    }

    fn probe_failed(&mut self, end: End, strays: bool) {
        let nothing = end == End::Missing && !strays;
        self.silent = if nothing { self.silent + 1 } else { 0 };
        self.method = self.after(self.method);
        self.suspect = true;
    }

    const fn after(&self, method: Method) -> Method {
        match method {
            Method::Length => Method::OtherTable,
            Method::OtherTable => Method::Nonce,
            Method::Nonce | Method::Silence if self.silent >= 3 => Method::Silence,
            Method::Nonce | Method::Silence => Method::Length,
        }
    }

    fn probe(&mut self, before: &[u8]) -> Option<[u8; 5]> {
        let spared = Code::answering(before);
        let is_free = |read: &ReadRequest| {
            let code = Code::answering(&read.pdu());
            code != spared && self.asked.iter().all(|asked| asked.code != code)
        };
        match self.method {
            Method::Length => {
                let (place, most) = self.place?;
                let shorter = (1..place.count).rev();
                let counts = || shorter.clone().chain(place.count..=most);
                let reads = || counts().map(|count| ReadRequest { count, ..place });
                // As the profile has it a reply comes once: what has been answered, and silent since, is over.
                let is_over = |read: &ReadRequest| {
                    let code = Code::answering(&read.pdu());
                    let mut alike = self.asked.iter().filter(|asked| asked.code == code);
                    alike.all(|asked| asked.is_answered)
                };
                let is_told = matches!(self.policy, Policy::Fixed(_));
                let over = || reads().filter(|_| is_told).find(is_over);
                reads().find(is_free).or_else(over).map(ReadRequest::pdu)
            }
            Method::OtherTable => {
                let place = self.place.map(|(place, _)| place);
                // A refusal carries no length: the table that is tried is not the one that has been refused.
                let input_refused = || {
                    let mut asked = self.asked.iter();
                    asked.any(|asked| asked.head[0] == 4 && !asked.is_answered)
                };
                let table = match place.map(|place| place.table) {
                    Some(RegisterTable::Input) => RegisterTable::Holding,
                    None if input_refused() => RegisterTable::Holding,
                    _ => RegisterTable::Input,
                };
                let address = place.map_or(0, |place| place.address);
                let mut reads = (1..=4).map(|count| ReadRequest {
                    table,
                    address,
                    count,
                });
                reads.find(is_free).map(ReadRequest::pdu)
            }
            Method::Nonce => {
                self.nonce = self.nonce.wrapping_mul(25_173).wrapping_add(13_849);
                let [high, low] = self.nonce.to_be_bytes();
                Some([8, 0, 0, high, low])
            }
            Method::Silence => None,
        }
    }
}

/// What tells requests apart: function, and the four bytes behind it where there are so many.
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
    use crate::drive::waiting::now;

    const QUIET: Duration = Duration::from_millis(20);

    #[test]
    fn a_unit_that_refuses_one_table_is_proven_by_the_other() {
        let begun = now();
        for (refused, other) in [(4, 3), (3, 4)] {
            let read = [refused, 0, 0, 0, 1];
            let mut proof = Proof::new(Policy::Trial(5 * QUIET), QUIET, begun);
            proof.asked(&read, false, begun);
            proof.ended(End::Refused, &[], false, false, begun);
            proof.doubt();
            let later = begun + 2 * QUIET;
            let Step::Probe(probe) = proof.next(&read, later) else {
                panic!("a doubt is followed by a probe");
            };
            assert_eq!(probe[0], other);
            proof.asked(&probe, true, later);
            proof.ended(End::Refused, &[], false, false, later);
            assert_eq!(proof.next(&read, later), Step::Go);
        }
    }
    const MS: Duration = Duration::from_millis(1);

    fn read(address: u16, count: u16) -> [u8; 5] {
        ReadRequest::holding(address, count).pdu()
    }

    fn late(pdu: &[u8]) -> [Heard; 1] {
        [Heard {
            code: Code::answering(pdu),
            behind: false,
        }]
    }

    /// Goes on until a probe is to be asked.
    fn probe(proof: &mut Proof, pdu: &[u8], at: &mut Instant) -> [u8; 5] {
        loop {
            match proof.next(pdu, *at) {
                Step::Probe(probe) => return probe,
                Step::Silence(until) => *at = until,
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn a_unit_that_is_one_reply_behind_is_proven_by_the_code_of_a_probe() {
        let mut at = now();
        let mut proof = Proof::new(Policy::Trial(50 * MS), QUIET, at);
        let (first, wanted) = (read(10, 1), read(20, 1));
        proof.known(ReadRequest::holding(10, 1));
        // Its reply comes with the next request, which it fits as well.
        for pdu in [&first, &wanted] {
            proof.asked(pdu, false, at);
            let is_first = *pdu == first;
            let end = if is_first { End::Missing } else { End::Data };
            proof.ended(end, &[], false, false, at);
        }
        assert!(!proof.vouched, "it may be the reply to the first");
        let one = probe(&mut proof, &wanted, &mut at);
        proof.asked(&one, true, at);
        proof.ended(End::Missing, &late(&wanted), true, false, at);
        let two = probe(&mut proof, &wanted, &mut at);
        assert!(one != two && Code::answering(&two) != Code::answering(&wanted));
        proof.asked(&two, true, at);
        proof.ended(End::Missing, &late(&one), true, false, at);
        // Everything before the first probe is over, and only the wanted read can get such a reply now.
        at += QUIET;
        assert_eq!(proof.next(&wanted, at), Step::Go);
        proof.asked(&wanted, false, at);
        proof.ended(End::Data, &late(&two), true, false, at);
        assert!(proof.vouched);
    }

    #[test]
    fn the_silence_for_an_old_reply_ends_after_a_clean_stretch() {
        let mut at = now();
        let mut proof = Proof::new(Policy::Fixed(Method::Nonce), QUIET, at);
        proof.set_policy(Method::Nonce, None);
        let nonce = probe(&mut proof, &read(0, 1), &mut at);
        let clean = |proof: &mut Proof, pdu: &[u8], is_probe, at| {
            proof.asked(pdu, is_probe, at);
            proof.ended(End::Data, &[], false, false, at);
        };
        clean(&mut proof, &nonce, true, at);
        let is_apart = |proof: &mut Proof, at| proof.next(&read(2, 1), at) != Step::Go;
        for _ in 0..KNOWN_AFTER {
            clean(&mut proof, &read(1, 1), false, at);
        }
        assert!(!is_apart(&mut proof, at), "nothing old ever came");
        proof.asked(&read(1, 1), false, at);
        proof.ended(End::Missing, &late(&read(1, 1)), true, false, at + 70 * MS);
        at += 70 * MS;
        let nonce = probe(&mut proof, &read(1, 1), &mut at);
        clean(&mut proof, &nonce, true, at);
        for seconds in [1, 3, 6] {
            let later = at + Duration::from_secs(seconds);
            clean(&mut proof, &read(1, 1), false, later);
            assert!(is_apart(&mut proof, later + MS), "{seconds}");
        }
        let later = at + Duration::from_secs(8);
        clean(&mut proof, &read(1, 1), false, later);
        assert!(!is_apart(&mut proof, later + MS));
    }

    #[test]
    fn a_loop_that_asks_nothing_before_its_commands_remembers_no_more_than_a_silence_of_them() {
        let mut at = now();
        let mut proof = Proof::new(Policy::Fixed(Method::Nonce), QUIET, at);
        let mut most = 0;
        for _ in 0..10_000 {
            at += MS;
            proof.asked(&read(0, 1), false, at);
            proof.ended(End::Data, &[], false, true, at);
            most = most.max(proof.recent.len());
        }
        assert!((1..=20).contains(&most), "{most}");
    }
}
