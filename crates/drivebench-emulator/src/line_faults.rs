//! Fault injection on the line between drive and host: faults of replies, and senders without a request.
//!
//! Works between codec and port, in virtual time as behind a pseudo-terminal or TCP.

use std::collections::BTreeSet;

use firmware_protocol::modbus::{rtu, tcp};
use firmware_protocol::stream;
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::SoftDrive;
use super::codec::{Received, Responder};
use super::fault::{FaultEntry, FaultKind, TimedFault};
use drivebench_link::Protocol;

/// Bytes of a request that are kept: those of the longest frame of Modbus.
const LONGEST_REQUEST: usize = 260;

pub(super) struct LineFaults {
    protocol: Protocol,
    unit: u8,
    faults: Vec<TimedFault>,
    rng: ChaCha8Rng,
    /// Bytes of the host since the last reply or silence: the request.
    request: Vec<u8>,
    held: Vec<Vec<u8>>,
    /// A drive answers one request after the other: no reply overtakes one that is late, which arrives then, s.
    late_until_s: f64,
}

/// Bytes, and when they arrive, s.
pub(super) type Timed = (f64, Vec<u8>);

impl LineFaults {
    pub(super) fn new(faults: &[FaultEntry], protocol: Protocol, unit: u8, seed: u64) -> Self {
        let of_line = faults.iter().filter(|fault| fault.kind.needs_line());
        Self {
            protocol,
            unit,
            faults: of_line.copied().map(TimedFault::new).collect(),
            // A constant that separates it from the noise of the same seed.
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x51B0_7A1F_95C3_E26D),
            request: Vec::new(),
            held: Vec::new(),
            late_until_s: 0.0,
        }
    }

    /// The drive, reached through this line.
    pub(super) fn before<'a>(
        &'a mut self,
        drive: &'a mut dyn Responder,
        now_s: f64,
    ) -> FaultyLine<'a> {
        FaultyLine { drive, faults: self, now_s }
    }

    pub(super) fn host_byte(&mut self, byte: u8) {
        if !self.faults.is_empty() && self.request.len() < LONGEST_REQUEST {
            self.request.push(byte);
        }
    }

    /// The host is silent: its request is over, answered or not.
    pub(super) fn silence(&mut self) {
        self.request.clear();
    }

    fn is_active(&mut self, kind: FaultKind, now_s: f64, ran_s: Option<f64>) -> bool {
        let mut of_kind = self.faults.iter_mut().filter(|f| f.entry.kind == kind);
        of_kind.any(|fault| fault.is_active(now_s, ran_s))
    }

    /// The exception with which a request is refused.
    fn refusal(&mut self, now_s: f64, ran_s: Option<f64>) -> Option<u8> {
        let refuses = |fault: &&mut TimedFault| fault.entry.kind == FaultKind::Exception;
        self.faults.iter_mut().filter(refuses).find_map(|fault| {
            fault.hits(now_s, ran_s, &mut self.rng).then(|| fault.entry.code.unwrap_or(4))
        })
    }

    /// Bytes that arrive instead of an answer due at `due_s`; the request ended at `now_s`.
    pub(super) fn reply(
        &mut self,
        answer: Vec<u8>,
        now_s: f64,
        due_s: f64,
        ran_s: Option<f64>,
    ) -> Vec<Timed> {
        if self.faults.is_empty() {
            return vec![(due_s, answer)];
        }
        let due_s = due_s.max(self.late_until_s);
        let request = std::mem::take(&mut self.request);
        let mut out: Vec<Timed> = self.held.drain(..).map(|late| (due_s, late)).collect();
        let of_reply = |fault: &&mut TimedFault| is_of_reply(fault.entry.kind);
        let hit = self.faults.iter_mut().filter(of_reply).find_map(|fault| {
            let hits = fault.hits(now_s, ran_s, &mut self.rng);
            hits.then_some(fault.entry)
        });
        match hit {
            None => out.push((due_s, answer)),
            Some(entry) => self.apply(entry, answer, &request, (now_s, due_s), &mut out),
        }
        out
    }

    fn apply(
        &mut self,
        entry: FaultEntry,
        mut answer: Vec<u8>,
        request: &[u8],
        (now_s, due_s): (f64, f64),
        out: &mut Vec<Timed>,
    ) {
        let length = answer.len().max(1);
        match entry.kind {
            FaultKind::ByteDropped => {
                answer.remove(self.below(length));
            }
            FaultKind::ByteInserted => {
                let byte = self.bytes(1)[0];
                answer.insert(self.below(length + 1), byte);
            }
            FaultKind::BitFlipped => {
                let bits: BTreeSet<usize> =
                    (0..=self.below(3)).map(|_| self.below(8 * length)).collect();
                for bit in bits {
                    answer[bit / 8] ^= 1 << (bit % 8);
                }
            }
            FaultKind::Truncated => answer.truncate(self.below(length)),
            FaultKind::WrongBaud => answer = self.bytes(length),
            FaultKind::WrongUnit => answer = self.refit(&answer, |unit, _| *unit ^= 2),
            FaultKind::WrongRequest => {
                let by_function = self.below(2) == 0;
                answer = self.refit(&answer, |_, pdu| spoil(pdu, by_function));
            }
            FaultKind::DoubledReply => {
                let delays_s = [0.0, 0.000_3, 0.002_5, 0.009];
                let again_s = due_s + delays_s[self.below(delays_s.len())];
                out.push((again_s, answer.clone()));
            }
            FaultKind::Garbage => {
                let lengths = [3, 40, 1500, 1 << 16];
                let count = lengths[self.below(lengths.len())];
                let burst = self.bytes(count);
                if self.below(2) == 0 {
                    out.push((due_s, burst));
                } else {
                    answer.extend(burst);
                }
            }
            FaultKind::SplitReply => {
                let rest = answer.split_off(1 + self.below(length - 1));
                out.push((due_s, answer));
                // Time between the two parts, s.
                self.late_until_s = due_s + 0.016;
                out.push((self.late_until_s, rest));
                return;
            }
            FaultKind::Echo => out.push((now_s, request.to_vec())),
            FaultKind::LateReply => {
                let late_s = 1e-3 * entry.late_ms.unwrap_or(30.0);
                self.late_until_s = due_s + late_s;
                out.push((self.late_until_s, answer));
                return;
            }
            FaultKind::HeldReply => return self.held.push(answer),
            FaultKind::HeldTwice => return self.held.extend([answer.clone(), answer]),
            FaultKind::Silence => return,
            _ => {}
        }
        out.push((due_s, answer));
    }

    /// A frame with another unit or content, and a check sum that fits; the stream's frames stay as they are.
    fn refit(&self, frame: &[u8], change: impl FnOnce(&mut u8, &mut Vec<u8>)) -> Vec<u8> {
        match (self.protocol, frame) {
            (Protocol::ModbusRtu | Protocol::ModbusRtuOverTcp, [unit, pdu @ .., _, _]) => {
                let (mut unit, mut pdu) = (*unit, pdu.to_vec());
                change(&mut unit, &mut pdu);
                rtu::encode_frame(unit, &pdu).to_vec()
            }
            (Protocol::ModbusTcp, [high, low, _, _, _, _, unit, pdu @ ..]) => {
                let (mut unit, mut pdu) = (*unit, pdu.to_vec());
                change(&mut unit, &mut pdu);
                tcp::encode_frame(u16::from_be_bytes([*high, *low]), unit, &pdu).to_vec()
            }
            _ => frame.to_vec(),
        }
    }

    /// Bytes of senders without a request until `ahead_s`. The writes of a second master take effect in order of time: until `now_s`.
    pub(super) fn unrequested(
        &mut self,
        now_s: f64,
        ahead_s: f64,
        drive: &mut dyn Responder,
    ) -> Vec<Timed> {
        let mut out = Vec::new();
        if self.faults.is_empty() {
            return out;
        }
        let mut faults = std::mem::take(&mut self.faults);
        for fault in &mut faults {
            let kind = fault.entry.kind;
            let (until_s, period_s) = match kind {
                FaultKind::Babble => (ahead_s, 0.002),
                FaultKind::ForeignFrames => (ahead_s, 0.05),
                FaultKind::SecondMaster => (now_s, 0.05),
                _ => continue,
            };
            if !fault.is_active(now_s, drive.ran_s()) {
                continue;
            }
            fault.next_s = fault.next_s.max(now_s);
            while fault.next_s <= until_s {
                let at_s = fault.next_s;
                // Time of a reply to another master, s, and the unit that it addresses.
                let (reply_s, foreign_unit) = (at_s + 0.005, 7);
                fault.next_s += period_s;
                match kind {
                    FaultKind::Babble => out.push((at_s, self.bytes(24))),
                    FaultKind::ForeignFrames => {
                        let request = rtu::encode_frame(foreign_unit, &[3, 0, 16, 0, 2]);
                        let reply = rtu::encode_frame(foreign_unit, &[3, 4, 0, 1, 0, 2]);
                        out.push((at_s, request.to_vec()));
                        out.push((reply_s, reply.to_vec()));
                    }
                    _ => {
                        let write = drive.foreign_write();
                        let reply = drive.modbus(&write);
                        out.push((at_s, rtu::encode_frame(self.unit, &write).to_vec()));
                        out.push((reply_s, rtu::encode_frame(self.unit, &reply).to_vec()));
                    }
                }
            }
        }
        self.faults = faults;
        out
    }

    fn below(&mut self, bound: usize) -> usize {
        self.rng.random_range(0..bound.max(1))
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.rng.fill_bytes(&mut bytes);
        bytes
    }
}

/// Whether a fault changes a reply; the others block the request or send without one.
const fn is_of_reply(kind: FaultKind) -> bool {
    !matches!(
        kind,
        FaultKind::Exception
            | FaultKind::BlackHole
            | FaultKind::Babble
            | FaultKind::ForeignFrames
            | FaultKind::SecondMaster
            | FaultKind::PowerLost
    )
}

/// Changes the function code, or adds two registers to the requested ones.
fn spoil(pdu: &mut Vec<u8>, by_function: bool) {
    match pdu.as_mut_slice() {
        [function, ..] if by_function => *function = if *function == 3 { 4 } else { 3 },
        [3 | 4 | 23, count, ..] => {
            *count = count.wrapping_add(2);
            pdu.extend([0, 0]);
        }
        // The echoed value differs then.
        [_, .., last] => *last ^= 1,
        _ => {}
    }
}

/// The drive behind a line that may block requests.
pub(super) struct FaultyLine<'a> {
    drive: &'a mut dyn Responder,
    faults: &'a mut LineFaults,
    now_s: f64,
}

impl FaultyLine<'_> {
    fn is_blocked(&mut self) -> bool {
        let ran_s = self.drive.ran_s();
        let hole = FaultKind::BlackHole;
        !self.drive.is_powered() || self.faults.is_active(hole, self.now_s, ran_s)
    }
}

impl Responder for FaultyLine<'_> {
    fn soft(&self) -> &SoftDrive {
        self.drive.soft()
    }

    fn advance_to(&mut self, time_s: f64) {
        self.drive.advance_to(time_s);
    }

    /// Empty if the request does not reach the drive.
    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        if self.is_blocked() {
            return Vec::new();
        }
        match (request, self.faults.refusal(self.now_s, self.drive.ran_s())) {
            ([function, ..], Some(code)) => vec![function | 0x80, code],
            _ => self.drive.modbus(request),
        }
    }

    fn stream(&mut self, received: &Received) -> Option<stream::Frame> {
        if self.is_blocked() { None } else { self.drive.stream(received) }
    }

    fn packet(&mut self, body: &[u8], may_command: &mut dyn FnMut() -> bool) -> Option<Vec<u8>> {
        if self.is_blocked() { None } else { self.drive.packet(body, may_command) }
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.drive.foreign_write()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(kind: &str) -> LineFaults {
        let fault = toml::from_str(&format!("kind = {kind:?}")).unwrap();
        LineFaults::new(&[fault], Protocol::ModbusRtu, 1, 7)
    }

    #[test]
    fn an_echo_is_the_request_without_older_bytes() {
        let mut line = line("echo");
        (0..100_000).for_each(|_| line.host_byte(9));
        assert_eq!(line.request.len(), LONGEST_REQUEST);
        line.silence();
        (1..=3).for_each(|byte| line.host_byte(byte));
        assert_eq!(line.reply(vec![4], 0.0, 0.1, None), [(0.0, vec![1, 2, 3]), (0.1, vec![4])]);
    }
}
