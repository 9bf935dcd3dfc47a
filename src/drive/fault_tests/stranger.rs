//! A drive that the host knows nothing of, with the witness's checksum and framing, and seventeen ways in which a line or a drive
//! goes wrong, done to the bytes of some of its replies.

use std::time::{Duration, Instant};

use firmware_protocol::registers::TELEMETRY_WORDS;
use firmware_protocol::stream::{CaptureStatus, Decoder, ErrorCode, Message, Refusal};
use firmware_protocol::{Control, DriveCommand, State, Status, Telemetry};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};

use super::codec;
use crate::drive::fake::stream_frame;
use crate::drive::virtual_line::Device;
use crate::drive::waiting::now;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Language {
    Rtu,
    Stream,
}

pub(super) struct Stranger {
    language: Language,
    /// Which faults, and how many replies in a thousand have one.
    faults: Vec<Fault>,
    per_mille: usize,
    times: Times,
    dice: Dice,
    held: Held,
    /// A drive answers one request after the other: nothing overtakes a reply that is late.
    busy_until: Instant,
    decoder: Decoder,
    line: Vec<u8>,
    /// Requests that were understood: every value that is read is made of this number.
    pub(super) heard: u32,
    /// Replies that were tampered with, and what was done to the last one.
    pub(super) tampered: u64,
    pub(super) last_fault: Option<Fault>,
}

/// What the register at address `index` holds for the request with this number.
#[expect(clippy::cast_possible_truncation, reason = "any sixteen bits will do")]
fn register(heard: u32, index: usize) -> u16 {
    (heard
        .wrapping_mul(2_654_435_761)
        .wrapping_add(index as u32 * 40_503)
        >> 9) as u16
}

/// The current for the request with this number, A.
pub(super) fn current_a(heard: u32) -> f64 {
    f64::from(heard % 2903) * 0.01
}

impl Stranger {
    pub(super) fn new(
        language: Language,
        faults: &[Fault],
        per_mille: usize,
        times: Times,
        seed: u64,
    ) -> Self {
        Self {
            language,
            faults: faults.to_vec(),
            per_mille,
            times,
            dice: Dice(ChaCha8Rng::seed_from_u64(seed)),
            held: Held::default(),
            busy_until: now(),
            decoder: Decoder::new(),
            line: Vec::new(),
            heard: 0,
            tampered: 0,
            last_fault: None,
        }
    }

    /// What was meant by the reply to the last read, of these registers.
    pub(super) fn meant(&self, first: u16, count: u16) -> Vec<u16> {
        let indices = (usize::from(first)..).take(count.into());
        indices.map(|index| register(self.heard, index)).collect()
    }

    fn answer(&mut self, reply: Reply) -> Vec<(Duration, Vec<u8>)> {
        let faulty = self.per_mille > 0 && self.dice.below(1000) < self.per_mille;
        self.last_fault = faulty.then(|| self.faults[self.dice.below(self.faults.len())]);
        self.tampered += u64::from(faulty);
        let mut out = inflict(
            self.last_fault,
            reply,
            &mut self.held,
            self.times,
            &mut self.dice,
        );
        let heard_at = now();
        let busy = self.busy_until.saturating_duration_since(heard_at);
        for (delay, _) in &mut out {
            *delay = busy.max(*delay);
        }
        if self.last_fault == Some(Fault::Late)
            && let Some((delay, _)) = out.last()
        {
            self.busy_until = heard_at + *delay;
        }
        out
    }

    fn hear_rtu(&mut self, byte: u8) -> Vec<(Duration, Vec<u8>)> {
        self.line.push(byte);
        let Some(asked) = codec::request(&self.line) else {
            return Vec::new();
        };
        assert!(asked.is_ok(), "the host sends whole frames");
        let request = std::mem::take(&mut self.line);
        let code = request[1];
        let is_asked = matches!(code, 3 | 4 | 6 | 8 | 23);
        assert!(is_asked, "function {code} is not asked here");
        let word = |at: usize| u16::from_be_bytes([request[at], request[at + 1]]);
        let content = match request[1] {
            6 | 8 => request[2..6].to_vec(),
            23 => {
                self.heard += 1;
                let control = match word(13) {
                    3 => Control::Voltage(1.0),
                    _ => Control::Stop,
                };
                let seq = word(11);
                let words = telemetry(DriveCommand { seq, control }, self.heard).to_registers();
                counted(&words)
            }
            _ => {
                self.heard += 1;
                counted(&self.meant(word(2), word(4)))
            }
        };
        let honest = frame(1, request[1], &content);
        let mut other_request = content.clone();
        let other_code = match (request[1], self.dice.below(2)) {
            // A count that is not the one asked for.
            (23 | 3 | 4, 0) => {
                other_request[0] += 2;
                other_request.extend([0, 0]);
                request[1]
            }
            (3, _) => 4,
            (8, _) => {
                other_request[3] ^= 1;
                8
            }
            (_, _) => 3,
        };
        self.answer(Reply {
            other_unit: frame(2, request[1], &content),
            other_request: frame(1, other_code, &other_request),
            refusal: frame(1, request[1] | 0x80, &[2]),
            busy: frame(1, request[1] | 0x80, &[6]),
            honest,
            request,
        })
    }

    fn hear_stream(&mut self, byte: u8) -> Vec<(Duration, Vec<u8>)> {
        self.line.push(byte);
        let Some(question) = self.decoder.push(byte) else {
            return Vec::new();
        };
        let request = std::mem::take(&mut self.line);
        let Ok(question) = question else {
            return Vec::new();
        };
        let Message::Command(command) = question.message else {
            panic!("{question:?} is not asked here");
        };
        self.heard += 1;
        let told = telemetry(command, self.heard);
        let seq = question.seq;
        let say = |seq, message| stream_frame(seq, told.time_us, message);
        let refused = |code| {
            let kind = question.message.kind().code();
            say(seq, Message::Error(Refusal { kind, code }))
        };
        self.answer(Reply {
            other_unit: say(seq, Message::CaptureStatus(CaptureStatus::default())),
            other_request: say(seq.wrapping_sub(1), Message::Telemetry(told)),
            refusal: refused(ErrorCode::OutOfRange),
            busy: refused(ErrorCode::DeviceFailure),
            honest: say(seq, Message::Telemetry(told)),
            request,
        })
    }
}

impl Device for Stranger {
    fn hear(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)> {
        bytes
            .iter()
            .flat_map(|byte| match self.language {
                Language::Rtu => self.hear_rtu(*byte),
                Language::Stream => self.hear_stream(*byte),
            })
            .collect()
    }
}

fn telemetry(command: DriveCommand, heard: u32) -> Telemetry {
    Telemetry {
        status: Status::new(match command.control {
            Control::Voltage(_) => State::Running,
            _ => State::Ready,
        }),
        seq: command.seq,
        time_us: heard.wrapping_mul(1000),
        applied_us: heard.wrapping_mul(1000).wrapping_sub(100),
        current_a: current_a(heard),
        ..Telemetry::default()
    }
}

/// Registers behind their count of bytes.
fn counted(words: &[u16]) -> Vec<u8> {
    let mut content = vec![u8::try_from(2 * words.len()).unwrap()];
    content.extend(words.iter().flat_map(|word| word.to_be_bytes()));
    content
}

fn frame(unit: u8, code: u8, content: &[u8]) -> Vec<u8> {
    codec::framed(&[&[unit, code], content].concat())
}

const _: () = assert!(TELEMETRY_WORDS == 16, "one request reads the telemetry");

/// The faults of a line and of a device behind it, as lists of field failures number them (1 to 17).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    ByteLost,
    ByteInserted,
    BitsFlipped,
    Doubled,
    Late,
    LateTwoDeep,
    OtherUnit,
    OtherRequest,
    Refused,
    Busy,
    CutOff,
    GarbageBetween,
    Babble,
    InChunks,
    OwnEcho,
    WrongBaud,
    Silent,
}

impl Fault {
    pub(super) const ALL: [Self; 17] = [
        Self::ByteLost,
        Self::ByteInserted,
        Self::BitsFlipped,
        Self::Doubled,
        Self::Late,
        Self::LateTwoDeep,
        Self::OtherUnit,
        Self::OtherRequest,
        Self::Refused,
        Self::Busy,
        Self::CutOff,
        Self::GarbageBetween,
        Self::Babble,
        Self::InChunks,
        Self::OwnEcho,
        Self::WrongBaud,
        Self::Silent,
    ];
}

/// Random numbers of a run.
pub(super) struct Dice(pub(super) ChaCha8Rng);

impl Dice {
    pub(super) fn below(&mut self, bound: usize) -> usize {
        (self.0.next_u32() as usize) % bound.max(1)
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.0.fill_bytes(&mut bytes);
        bytes
    }
}

/// What a faulty reply is made of: the language knows how to write the frames.
pub(super) struct Reply {
    pub(super) request: Vec<u8>,
    pub(super) honest: Vec<u8>,
    /// The same content under another unit's name, or of another kind.
    pub(super) other_unit: Vec<u8>,
    /// A whole reply to another request: function, length or number differ.
    pub(super) other_request: Vec<u8>,
    /// Refusals: for good, and for now.
    pub(super) refusal: Vec<u8>,
    pub(super) busy: Vec<u8>,
}

/// Times of the line that the faults must straddle.
#[derive(Clone, Copy)]
pub(super) struct Times {
    pub(super) turnaround: Duration,
    /// After this nobody waits for the reply any more.
    pub(super) deadline: Duration,
}

/// Late replies that are held back until something else is asked.
#[derive(Default)]
pub(super) struct Held(Vec<Vec<u8>>);

/// What comes back for one request, and when.
pub(super) fn inflict(
    fault: Option<Fault>,
    reply: Reply,
    held: &mut Held,
    times: Times,
    dice: &mut Dice,
) -> Vec<(Duration, Vec<u8>)> {
    let soon = times.turnaround;
    let mut out: Vec<_> = held.0.drain(..).map(|late| (soon, late)).collect();
    let mut honest = reply.honest;
    let length = honest.len();
    let Some(fault) = fault else {
        out.push((soon, honest));
        return out;
    };
    match fault {
        Fault::ByteLost => {
            honest.remove(dice.below(length));
        }
        Fault::ByteInserted => {
            let byte = dice.bytes(1)[0];
            honest.insert(dice.below(length + 1), byte);
        }
        Fault::BitsFlipped => {
            for _ in 0..=dice.below(3) {
                honest[dice.below(length)] ^= 1 << dice.below(8);
            }
        }
        Fault::CutOff => honest.truncate(dice.below(length)),
        _ => {}
    }
    match fault {
        Fault::ByteLost | Fault::ByteInserted | Fault::BitsFlipped | Fault::CutOff => {
            out.push((soon, honest));
        }
        Fault::Doubled => {
            // At once, in the gap, or long after.
            let again = soon + Duration::from_micros([0, 300, 2500, 9000][dice.below(4)]);
            out.extend([(soon, honest.clone()), (again, honest)]);
        }
        Fault::Late if dice.below(2) == 0 => held.0.push(honest),
        Fault::Late => {
            let after = Duration::from_micros(dice.below(20_000) as u64);
            out.push((times.deadline + after, honest));
        }
        // The copy makes the next request find two of them.
        Fault::LateTwoDeep => held.0.extend([honest.clone(), honest]),
        Fault::OtherUnit => out.push((soon, reply.other_unit)),
        Fault::OtherRequest => out.push((soon, reply.other_request)),
        Fault::Refused => out.push((soon, reply.refusal)),
        Fault::Busy => out.push((soon, reply.busy)),
        Fault::GarbageBetween => {
            let count = [3, 40, 1500, 1 << 16][dice.below(4)];
            let garbage = dice.bytes(count);
            // Before the reply it must not be taken for it, behind it not for the next.
            let before = dice.below(2) == 0;
            out.push((soon, honest));
            out.insert(if before { 0 } else { out.len() }, (soon, garbage));
        }
        Fault::Babble => {
            let mut at = soon;
            while at < times.deadline {
                out.push((at, dice.bytes(24)));
                at += Duration::from_millis(2);
            }
        }
        Fault::InChunks => {
            let rest = honest.split_off(dice.below(length));
            let later = soon + Duration::from_millis(16);
            out.extend([(soon, honest), (later, rest)]);
        }
        Fault::OwnEcho => out.extend([(Duration::ZERO, reply.request), (soon, honest)]),
        Fault::WrongBaud => out.push((soon, dice.bytes(length))),
        Fault::Silent => {}
    }
    out
}
