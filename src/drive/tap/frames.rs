//! Where one frame ends and the next begins, in the bytes of one direction.

use firmware_protocol::modbus::{Length, request_len, response_len, rtu};

/// Bytes that make no frame are handed out at this length at the latest.
const MOST: usize = 1024;

/// What separates frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Splitting {
    /// Length by function code, and checksum.
    Rtu,
    /// A zero after each.
    Zeros,
    /// Nothing: pieces as they come.
    None,
}

/// Bytes of one direction that are no whole frame yet.
pub(super) struct Received {
    splitting: Splitting,
    bytes: Vec<u8>,
}

impl Received {
    pub(super) const fn new(splitting: Splitting) -> Self {
        Self {
            splitting,
            bytes: Vec::new(),
        }
    }

    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole frame.
    pub(super) fn frame(&mut self) -> Option<Vec<u8>> {
        let whole = match self.splitting {
            Splitting::Rtu => rtu_length(&self.bytes),
            Splitting::Zeros => self.bytes.iter().position(|b| *b == 0).map(|at| at + 1),
            Splitting::None => (!self.bytes.is_empty()).then_some(self.bytes.len()),
        };
        let too_long = (self.bytes.len() > MOST).then_some(MOST);
        let length = whole.or(too_long)?;
        let rest = self.bytes.split_off(length);
        Some(std::mem::replace(&mut self.bytes, rest))
    }

    /// What makes no frame.
    pub(super) fn rest(&mut self) -> Option<Vec<u8>> {
        (!self.bytes.is_empty()).then(|| std::mem::take(&mut self.bytes))
    }
}

/// Length of a frame with a right checksum at the start: a request (an echo too) or a reply.
fn rtu_length(bytes: &[u8]) -> Option<usize> {
    let pdu = bytes.get(1..)?;
    [request_len(pdu), response_len(pdu)]
        .into_iter()
        .find_map(|length| {
            let Length::Known(length) = length else {
                return None;
            };
            let (body, rest) = bytes.split_at_checked(length + 1)?;
            let crc = rest.first_chunk::<2>()?;
            (rtu::crc16(body) == u16::from_le_bytes(*crc)).then_some(length + 3)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(splitting: Splitting, pieces: &[&[u8]]) -> Vec<Vec<u8>> {
        let mut received = Received::new(splitting);
        let mut frames = Vec::new();
        for piece in pieces {
            received.push(piece);
            frames.extend(std::iter::from_fn(|| received.frame()));
        }
        frames.extend(received.rest());
        frames
    }

    #[test]
    fn frames_end_by_length_and_checksum_or_zero() {
        let reply = [1, 3, 2, 0, 7, 0xF9, 0x86];
        let twice = [reply, reply].concat();
        let frames = split(Splitting::Rtu, &[&twice[..9], &twice[9..], &[5]]);
        assert_eq!(frames, [&reply[..], &reply, &[5]]);
        assert_eq!(
            split(Splitting::Zeros, &[&[1, 0, 2], &[0, 3]]),
            [&[1, 0][..], &[2, 0], &[3]]
        );
        assert_eq!(
            split(Splitting::None, &[&[1], &[2, 3]]),
            [&[1][..], &[2, 3]]
        );
    }

    #[test]
    fn babble_does_not_fill_the_memory() {
        let frames = split(Splitting::Zeros, &[&[7; 10 * MOST]]);
        assert!(frames.iter().all(|frame| frame.len() <= MOST));
        assert_eq!(frames.concat().len(), 10 * MOST);
    }
}
