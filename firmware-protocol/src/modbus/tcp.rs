//! TCP framing (MODBUS Messaging on TCP/IP V1.0b): transaction, protocol 0, length, unit, PDU.

use super::pdu::{MAX_PDU, RegisterBank, respond};
use crate::bytes::Bytes;

/// Bytes before the PDU.
pub const HEADER: usize = 7;
/// Longest frame, bytes.
pub const MAX_FRAME: usize = HEADER + MAX_PDU;

/// A request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TcpFrame {
    /// Number that the answer repeats.
    pub transaction: u16,
    /// The addressed unit.
    pub unit: u8,
    pdu: Bytes<MAX_PDU>,
}

impl TcpFrame {
    /// The request.
    pub fn pdu(&self) -> &[u8] {
        &self.pdu
    }

    /// Executes the request and frames the answer.
    pub fn answer(&self, bank: &mut impl RegisterBank) -> Bytes<MAX_FRAME> {
        encode_frame(self.transaction, self.unit, &respond(bank, self.pdu()))
    }
}

/// Frames a PDU. One that is longer than [`MAX_PDU`] is cut.
pub fn encode_frame(transaction: u16, unit: u8, pdu: &[u8]) -> Bytes<MAX_FRAME> {
    let pdu = &pdu[..pdu.len().min(MAX_PDU)];
    let length = u16::try_from(1 + pdu.len()).unwrap_or(u16::MAX);
    let ([t1, t0], [l1, l0]) = (transaction.to_be_bytes(), length.to_be_bytes());
    let mut frame = Bytes::of(&[t1, t0, 0, 0, l1, l0, unit]);
    frame.extend(pdu);
    frame
}

/// The peer does not use Modbus TCP; no further frame can be found, so the connection must be closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TcpError {
    /// The protocol identifier is not 0.
    Protocol(u16),
    /// The length is not 2..=254.
    Length(u16),
}

/// Finds requests in the bytes of a connection, however they are split or merged.
#[derive(Clone, Debug)]
pub struct TcpReceiver {
    buffer: [u8; MAX_FRAME],
    end: usize,
    broken: Option<TcpError>,
}

impl Default for TcpReceiver {
    fn default() -> Self {
        Self::new()
    }
}

impl TcpReceiver {
    /// A receiver for a new connection.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME], end: 0, broken: None }
    }

    /// Takes one byte; gives the request that it completes.
    ///
    /// # Errors
    /// The header is wrong; every later byte repeats the error.
    pub fn push(&mut self, byte: u8) -> Result<Option<TcpFrame>, TcpError> {
        if let Some(error) = self.broken {
            return Err(error);
        }
        self.buffer[self.end] = byte;
        self.end += 1;
        self.check().inspect_err(|error| self.broken = Some(*error))
    }

    fn check(&mut self) -> Result<Option<TcpFrame>, TcpError> {
        let [t1, t0, p1, p0, l1, l0, unit, pdu @ ..] = &self.buffer;
        let protocol = u16::from_be_bytes([*p1, *p0]);
        if self.end >= 4 && protocol != 0 {
            return Err(TcpError::Protocol(protocol));
        }
        if self.end < 6 {
            return Ok(None);
        }
        let length = u16::from_be_bytes([*l1, *l0]);
        if !(2..=254).contains(&length) {
            return Err(TcpError::Length(length));
        }
        let length = usize::from(length);
        if self.end < 6 + length {
            return Ok(None);
        }
        self.end = 0;
        Ok(Some(TcpFrame {
            transaction: u16::from_be_bytes([*t1, *t0]),
            unit: *unit,
            pdu: Bytes::of(&pdu[..length - 1]),
        }))
    }
}
