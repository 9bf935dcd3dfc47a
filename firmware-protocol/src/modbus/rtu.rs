//! RTU framing (MODBUS over Serial Line V1.02): unit, PDU, CRC-16 low byte first.

use core::cell::Cell;

use crc::{CRC_16_MODBUS, Crc};

use super::length::{Length, request_len, response_len};
use super::pdu::{MAX_PDU, RegisterBank, respond};
use crate::bytes::Bytes;

/// Longest frame, bytes.
pub const MAX_FRAME: usize = MAX_PDU + 3;
/// Requests to this unit are executed by every slave and answered by none.
pub const BROADCAST: u8 = 0;

const CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_MODBUS);

/// The checksum; it is sent low byte first.
pub fn crc16(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// Frames a PDU. One that is longer than [`MAX_PDU`] is cut.
pub fn encode_frame(unit: u8, pdu: &[u8]) -> Bytes<MAX_FRAME> {
    let mut frame = Bytes::of(&[unit]);
    frame.extend(&pdu[..pdu.len().min(MAX_PDU)]);
    frame.extend(&crc16(&frame).to_le_bytes());
    frame
}

/// A request whose checksum is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RtuFrame {
    /// The addressed unit.
    pub unit: u8,
    pdu: Bytes<MAX_PDU>,
}

impl RtuFrame {
    /// The request.
    pub fn pdu(&self) -> &[u8] {
        &self.pdu
    }

    /// Whether it is a broadcast to all slaves.
    pub const fn is_broadcast(&self) -> bool {
        self.unit == BROADCAST
    }

    /// Executes the request and frames the answer; no bytes for a broadcast, which is silent.
    pub fn answer(&self, bank: &mut impl RegisterBank) -> Bytes<MAX_FRAME> {
        let response = respond(bank, self.pdu());
        if self.is_broadcast() || response.is_empty() {
            return Bytes::EMPTY;
        }
        encode_frame(self.unit, &response)
    }
}

/// Counters of the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RtuStatistics {
    /// Requests handed out.
    pub frames: u64,
    /// Whole frames for other units, passed over.
    pub foreign: u64,
    /// Bytes passed over in the search for a frame.
    pub skipped: u64,
    /// Bytes that checksums ran over: the receiver's work, at most a fixed multiple of the bytes that came.
    pub checked: u64,
}

/// Finds requests in the bytes of a line.
///
/// A frame ends at the length by its function code if the checksum fits; if it does not, the search continues at the
/// next byte. A frame of an unknown function code ends at a silent gap, which the caller reports with
/// [`RtuReceiver::idle`]. Memory is bounded, and so is the work per byte (one checksum of at most 256 bytes).
#[derive(Clone, Debug)]
pub struct RtuReceiver {
    unit: u8,
    buffer: [u8; 2 * MAX_FRAME],
    start: usize,
    end: usize,
    gap: bool,
    statistics: RtuStatistics,
    /// Counted where bytes are only looked at.
    checked: Cell<u64>,
}

impl RtuReceiver {
    /// A receiver for one unit.
    pub const fn new(unit: u8) -> Self {
        Self {
            unit,
            buffer: [0; 2 * MAX_FRAME],
            start: 0,
            end: 0,
            gap: false,
            statistics: RtuStatistics { frames: 0, foreign: 0, skipped: 0, checked: 0 },
            checked: Cell::new(0),
        }
    }

    /// Takes one byte; call [`RtuReceiver::take_frame`] afterwards, at the latest after [`MAX_FRAME`] bytes: older bytes
    /// may be dropped.
    pub fn push(&mut self, byte: u8) {
        if self.end == self.buffer.len() {
            // More than one longest frame unread: the caller never asked, the oldest goes.
            if self.end - self.start > MAX_FRAME {
                self.skip(self.end - self.start - MAX_FRAME);
            }
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        self.buffer[self.end] = byte;
        self.end += 1;
        self.gap = false;
    }

    /// The line was silent for 3.5 characters or more: what is there is all there will be, a begun frame is dropped.
    /// Behind an operating system's buffers (USB adapter, pty) silence is only certain after some 20 ms.
    /// Call [`RtuReceiver::take_frame`] until it returns `None`.
    pub const fn idle(&mut self) {
        self.gap = true;
    }

    /// The next request to this unit or to all; frames for other units are passed over.
    pub fn take_frame(&mut self) -> Option<RtuFrame> {
        while self.start < self.end {
            let bytes = &self.buffer[self.start..self.end];
            match self.judge(bytes) {
                Judgement::Wait => return None,
                Judgement::Skip => self.skip(1),
                Judgement::Foreign(length) => {
                    self.start += length;
                    self.statistics.foreign += 1;
                }
                Judgement::Frame(length) => {
                    let (unit, pdu) = (bytes[0], Bytes::of(&bytes[1..length - 2]));
                    self.start += length;
                    self.statistics.frames += 1;
                    return Some(RtuFrame { unit, pdu });
                }
            }
        }
        None
    }

    /// The counters so far.
    pub const fn statistics(&self) -> RtuStatistics {
        RtuStatistics { checked: self.checked.get(), ..self.statistics }
    }

    const fn skip(&mut self, bytes: usize) {
        self.start += bytes;
        self.statistics.skipped += bytes as u64;
    }

    /// What the bytes begin with.
    fn judge(&self, bytes: &[u8]) -> Judgement {
        let [unit, pdu @ ..] = bytes else {
            return Judgement::Wait;
        };
        let ours = *unit == self.unit || *unit == BROADCAST;
        match self.fit(bytes, request_len(pdu)) {
            Fit::Yes(length) if ours => return Judgement::Frame(length),
            Fit::Yes(length) => return Judgement::Foreign(length),
            Fit::Wait if ours => return Judgement::Wait,
            Fit::Wait | Fit::No => {}
        }
        if ours {
            return Judgement::Skip;
        }
        // On a shared bus the answers of the other slaves come by too.
        match self.fit(bytes, response_len(pdu)) {
            Fit::Yes(length) => Judgement::Foreign(length),
            Fit::Wait => Judgement::Wait,
            Fit::No if self.fit(bytes, request_len(pdu)) == Fit::Wait => Judgement::Wait,
            Fit::No => Judgement::Skip,
        }
    }

    fn fit(&self, bytes: &[u8], length: Length) -> Fit {
        let length = match length {
            Length::Known(pdu) if pdu > MAX_PDU => return Fit::No,
            Length::Known(pdu) => pdu + 3,
            Length::Unknown if self.gap => bytes.len().min(MAX_FRAME),
            Length::NeedMore | Length::Unknown => MAX_FRAME,
        };
        match bytes.get(..length) {
            Some(frame) if frame.len() >= 4 && self.check(frame) => Fit::Yes(length),
            None if !self.gap => Fit::Wait,
            _ => Fit::No,
        }
    }

    /// Whether the checksum fits.
    fn check(&self, frame: &[u8]) -> bool {
        self.checked.set(self.checked.get() + frame.len() as u64);
        crc16(frame) == 0
    }
}

enum Judgement {
    /// It may become a frame.
    Wait,
    /// No frame begins here.
    Skip,
    /// A frame of so many bytes for another unit.
    Foreign(usize),
    /// A request of so many bytes for this unit.
    Frame(usize),
}

#[derive(PartialEq)]
enum Fit {
    Yes(usize),
    Wait,
    No,
}
