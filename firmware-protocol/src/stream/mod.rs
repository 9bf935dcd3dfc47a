//! The native stream: messages in COBS frames, each with sequence number, drive time and checksum.
//!
//! ```text
//!   Frame { seq, time_us, Message } -> bytes -> CRC-16 -> COBS -> 0        encode()
//!   byte -> up to the next 0 -> COBS -> CRC-16 -> Frame                    Decoder::push()
//! ```
//!
//! An answer repeats the number of its request, so that a late one is recognised.

mod capture;
mod cobs;
mod message;
mod payload;

pub use capture::{CAPTURE_BLOCK_SAMPLES, CaptureBlock, CaptureStatus};
pub use message::{ErrorCode, Frame, Message, MessageType, Refusal};

use crc::{CRC_16_IBM_3740, Crc};

use crate::bytes::Bytes;
use crate::registers::PROTOCOL_VERSION;
use payload::{Plain, Reader};

/// Type, version, sequence number, drive time.
pub const HEADER: usize = 8;
/// Longest payload, bytes: a full capture block of 12 bytes (three i32) a sample, behind index and count.
pub const MAX_PAYLOAD: usize = 3 + CAPTURE_BLOCK_SAMPLES * 12;
/// Longest frame before COBS, checksum included.
const MAX_PLAIN: usize = HEADER + MAX_PAYLOAD + 2;
/// Longest frame on the wire, delimiter included.
pub const MAX_FRAME: usize = MAX_PLAIN + MAX_PLAIN.div_ceil(254) + 1;

const CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// The checksum over header and payload; it is sent high byte first.
pub fn crc16(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// Encodes one frame with its delimiter.
pub fn encode(frame: &Frame) -> Bytes<MAX_FRAME> {
    let mut plain = Plain::of(&[frame.message.kind().code(), VERSION]);
    plain.extend(&frame.seq.to_be_bytes());
    plain.extend(&frame.time_us.to_be_bytes());
    frame.message.encode_payload(&mut plain);
    plain.extend(&crc16(&plain).to_be_bytes());
    cobs::encode(&plain)
}

/// The version byte of every frame.
pub const VERSION: u8 = {
    assert!(PROTOCOL_VERSION < 256, "the version byte holds it");
    PROTOCOL_VERSION.to_be_bytes()[1]
};

/// Why bytes between two delimiters are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than any message.
    TooLong,
    /// Shorter than header and checksum.
    TooShort,
    /// Not COBS: a code byte points past the end.
    Cobs,
    /// The checksum does not fit.
    Crc,
    /// The checksum fits, the version differs.
    Version(u8),
    /// The checksum fits, the type does not exist; to be answered with [`ErrorCode::UnknownMessage`].
    UnknownType {
        /// Type byte.
        kind: u8,
        /// Number of the question.
        seq: u16,
    },
    /// The checksum fits, the payload does not; to be answered with [`ErrorCode::BadPayload`].
    Payload {
        /// Type byte.
        kind: u8,
        /// Number of the question.
        seq: u16,
    },
}

/// Finds messages in the bytes of a line; after any damage it is right again at the next delimiter.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME],
    /// Bytes since the delimiter; one more than the buffer holds when too long.
    length: usize,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder that takes the first byte as the beginning of a frame.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME], length: 0 }
    }

    /// Takes one byte; gives the frame, or the damage, that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame, FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                Some(slot) => {
                    *slot = byte;
                    self.length += 1;
                }
                None => self.length = MAX_FRAME + 1,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        // Two delimiters in a row are legal: an idle line may be filled with them.
        (length > 0).then(|| self.finish(length))
    }

    fn finish(&mut self, length: usize) -> Result<Frame, FrameError> {
        let coded = self.buffer.get_mut(..length).ok_or(FrameError::TooLong)?;
        let plain = cobs::decode(coded).ok_or(FrameError::Cobs)?;
        decode_plain(plain)
    }
}

fn decode_plain(plain: &[u8]) -> Result<Frame, FrameError> {
    let (body, crc) = plain.split_last_chunk::<2>().ok_or(FrameError::TooShort)?;
    let (header, payload) = body.split_first_chunk::<HEADER>().ok_or(FrameError::TooShort)?;
    if crc16(body) != u16::from_be_bytes(*crc) {
        return Err(FrameError::Crc);
    }
    let [kind, version, s1, s0, t3, t2, t1, t0] = *header;
    if version != VERSION {
        return Err(FrameError::Version(version));
    }
    let seq = u16::from_be_bytes([s1, s0]);
    let time_us = u32::from_be_bytes([t3, t2, t1, t0]);
    let known = MessageType::from_code(kind).ok_or(FrameError::UnknownType { kind, seq })?;
    let mut reader = Reader::new(payload, time_us);
    let message = Message::decode_payload(known, seq, &mut reader)
        .filter(|_| reader.is_used_up())
        .ok_or(FrameError::Payload { kind, seq })?;
    Ok(Frame::answer(seq, time_us, message))
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// Decodes a frame with a right checksum around any content.
    fn receive(body: &[u8]) -> Result<Frame, FrameError> {
        let mut plain = Vec::from(body);
        plain.extend(crc16(body).to_be_bytes());
        push_all(&mut Decoder::new(), &cobs::encode::<MAX_FRAME>(&plain))
    }

    fn push_all(decoder: &mut Decoder, bytes: &[u8]) -> Result<Frame, FrameError> {
        bytes.iter().find_map(|byte| decoder.push(*byte)).expect("the bytes end with a delimiter")
    }

    #[test]
    fn a_right_checksum_around_wrong_content_is_named() {
        let hello = [1, VERSION, 0, 9, 0, 0, 0, 0];
        assert_eq!(receive(&hello), Ok(Frame::ask(9, Message::Hello)));
        let payload = |kind| Err(FrameError::Payload { kind, seq: 9 });
        let one_too_many = [&hello[..], &[0]].concat();
        assert_eq!(receive(&one_too_many), payload(1));
        assert_eq!(receive(&hello[..7]), Err(FrameError::TooShort));
        let mut other = hello;
        other[1] = VERSION + 1;
        assert_eq!(receive(&other), Err(FrameError::Version(VERSION + 1)));
        other = hello;
        other[0] = 0x55;
        let unknown = FrameError::UnknownType { kind: 0x55, seq: 9 };
        assert_eq!(receive(&other), Err(unknown));
        let command = [2, VERSION, 0, 9, 0, 0, 0, 0];
        for wrong in [&[0, 3, 0, 0, 0][..], &[0, 6, 0, 0, 0, 0], &[0, 3, 0x80, 0, 0, 0]] {
            assert_eq!(receive(&[&command[..], wrong].concat()), payload(2));
        }
        let telemetry = [0x82, VERSION, 0, 9, 0, 0, 0, 0];
        assert_eq!(receive(&telemetry), payload(0x82));
        // More samples than a block has, with enough bytes for them.
        let mut block = Vec::from([0x87, VERSION, 0, 9, 0, 0, 0, 0, 0, 0, 33]);
        block.resize(MAX_PLAIN - 2, 1);
        assert_eq!(receive(&block), payload(0x87));
    }

    #[test]
    fn an_endless_frame_is_one_damage() {
        let mut decoder = Decoder::new();
        for _ in 0..10_000 {
            assert_eq!(decoder.push(1), None);
        }
        assert_eq!(decoder.push(0), Some(Err(FrameError::TooLong)));
        assert_eq!(decoder.push(0), None, "an idle line may be zeros");
        let hello = Frame::ask(3, Message::Hello);
        assert_eq!(push_all(&mut decoder, &encode(&hello)), Ok(hello));
    }

    #[test]
    fn the_longest_frame_fills_the_room_and_no_more() {
        let mut longest = Vec::from([0x87, VERSION, 1, 1, 1, 1, 1, 1, 1, 1, 32]);
        longest.resize(HEADER + MAX_PAYLOAD, 1);
        let Ok(frame) = receive(&longest) else {
            panic!("a full block is a message");
        };
        let length = encode(&frame).len();
        assert!(length <= MAX_FRAME && length + 1 >= MAX_FRAME, "{length}");
    }
}
