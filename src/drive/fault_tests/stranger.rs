//! A drive that the host knows nothing of: its own checksum and framing, and a fault for some of its replies.

use std::time::{Duration, Instant};

use firmware_protocol::registers::TELEMETRY_WORDS;
use firmware_protocol::stream::{CaptureStatus, Decoder, ErrorCode, Message, Refusal};
use firmware_protocol::{Control, DriveCommand, State, Status, Telemetry};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::fault::{Dice, Fault, Held, Reply, Times, inflict};
use crate::drive::fake::stream_frame;
use crate::drive::guard::now;
use crate::drive::virtual_line::Device;

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
        let needed = match self.line.get(1) {
            None => return Vec::new(),
            Some(3 | 4 | 6 | 8) => 8,
            Some(23) => self
                .line
                .get(10)
                .map_or(usize::MAX, |n| 13 + usize::from(*n)),
            Some(code) => panic!("function {code} is not asked here"),
        };
        if self.line.len() < needed {
            return Vec::new();
        }
        let request = std::mem::take(&mut self.line);
        assert_eq!(crc(&request), 0, "the host sends whole frames");
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
    let mut frame = vec![unit, code];
    frame.extend_from_slice(content);
    let crc = crc(&frame);
    frame.extend(crc.to_le_bytes());
    frame
}

/// The checksum of Modbus, bit by bit (MODBUS over Serial Line V1.02, 6.2.2); 0 over a whole frame.
fn crc(bytes: &[u8]) -> u16 {
    let mut crc = 0xFFFF_u16;
    for byte in bytes {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                (crc >> 1) ^ 0xA001
            } else {
                crc >> 1
            };
        }
    }
    crc
}

const _: () = assert!(TELEMETRY_WORDS == 16, "one request reads the telemetry");
