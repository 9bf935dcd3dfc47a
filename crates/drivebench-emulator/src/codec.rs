//! Codec of one connection: bytes of the host in, answers of the drive out.

use firmware_protocol::modbus::{Exception, RtuReceiver, TcpReceiver, respond, rtu, tcp};
use firmware_protocol::registers::{COMMAND_ADDRESS, COMMAND_WORDS};
use firmware_protocol::{Control, DriveCommand, stream};

use super::drive::answer_stream;
use super::foreign::PacketReceiver;
use super::{ForeignDrive, SoftDrive};
use drivebench_link::Protocol;

/// The drive's address on a bus.
pub const UNIT: u8 = 1;

/// The bytes belong to another protocol: the connection must be closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unframeable;

/// A drive that answers requests, under its own protocol or under the profile of another.
pub(super) trait Responder: Send {
    /// The motor and what drives it, whatever the profile.
    fn soft(&self) -> &SoftDrive;

    fn advance_to(&mut self, time_s: f64);

    /// The PDU that answers a request over Modbus.
    fn modbus(&mut self, request: &[u8]) -> Vec<u8>;

    /// What answers the body of a packet of its own language.
    fn packet(&mut self, _body: &[u8], _may_command: &mut dyn FnMut() -> bool) -> Option<Vec<u8>> {
        None
    }

    /// `None`: no answer; a drive of another make has no stream.
    fn stream(&mut self, _received: &Received) -> Option<stream::Frame> {
        None
    }

    /// The next request comes over the connection of this number.
    fn request_from(&mut self, _session: u64) {}

    /// Since its last start, s, as long as it ran; `None` where it never did.
    fn ran_s(&self) -> Option<f64> {
        self.soft().ran_s()
    }

    /// A drive without power receives nothing.
    fn is_powered(&self) -> bool {
        self.soft().is_powered()
    }

    /// The request with which another master might command it.
    fn foreign_write(&self) -> Vec<u8>;
}

/// What a stream decoder hands out.
pub(super) type Received = Result<stream::Frame, stream::FrameError>;

impl Responder for SoftDrive {
    fn soft(&self) -> &SoftDrive {
        self
    }

    fn advance_to(&mut self, time_s: f64) {
        Self::advance_to(self, time_s);
    }

    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        respond(self, request).to_vec()
    }

    fn stream(&mut self, received: &Received) -> Option<stream::Frame> {
        answer_stream(self, received)
    }

    fn foreign_write(&self) -> Vec<u8> {
        let words = DriveCommand::new(0, Control::Stop).to_registers();
        let words = words.into_iter().flat_map(u16::to_be_bytes);
        let [high, low] = COMMAND_ADDRESS.to_be_bytes();
        [16, high, low, 0, COMMAND_COUNT, 2 * COMMAND_COUNT].into_iter().chain(words).collect()
    }
}

/// Registers of a command, as the one byte that counts them.
const COMMAND_COUNT: u8 = {
    assert!(COMMAND_WORDS < 64, "a byte counts their bytes too");
    COMMAND_WORDS.to_le_bytes()[0]
};

impl Responder for ForeignDrive {
    fn soft(&self) -> &SoftDrive {
        Self::soft(self)
    }

    fn advance_to(&mut self, time_s: f64) {
        Self::advance_to(self, time_s);
    }

    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        self.answer(request)
    }

    fn packet(&mut self, body: &[u8], may_command: &mut dyn FnMut() -> bool) -> Option<Vec<u8>> {
        self.answer_packet(body, may_command)
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.first_command()
    }
}

/// The receiving state of one session.
pub(super) enum Codec {
    ModbusRtu(Box<RtuReceiver>),
    ModbusTcp(Box<TcpReceiver>, u8),
    Stream(Box<stream::Decoder>),
    Packets(PacketReceiver, Protocol),
}

impl Codec {
    pub(super) fn new(kind: Protocol, unit: u8) -> Self {
        match kind {
            Protocol::ModbusRtu | Protocol::ModbusRtuOverTcp => {
                Self::ModbusRtu(Box::new(RtuReceiver::new(unit)))
            }
            Protocol::ModbusTcp => Self::ModbusTcp(Box::default(), unit),
            Protocol::Stream => Self::Stream(Box::default()),
            Protocol::Vesc | Protocol::Dynamixel | Protocol::Lines => {
                Self::Packets(PacketReceiver::default(), kind)
            }
        }
    }

    /// Takes one byte at the drive's present time and appends what it makes the drive answer. `may_command`: whether this
    /// host's commands are accepted now; evaluated for each of them.
    pub(super) fn push(
        &mut self,
        byte: u8,
        drive: &mut dyn Responder,
        may_command: &mut dyn FnMut() -> bool,
        answers: &mut Vec<Vec<u8>>,
    ) -> Result<(), Unframeable> {
        match self {
            Self::ModbusRtu(receiver) => {
                receiver.push(byte);
                answer_rtu(receiver, drive, may_command, answers);
            }
            Self::ModbusTcp(receiver, unit) => {
                // 0 and 255: the device itself, whatever stands behind it.
                if let Some(request) = receiver.push(byte).map_err(|_| Unframeable)?
                    && [0, *unit, 255].contains(&request.unit)
                {
                    let response = answer(request.pdu(), drive, may_command);
                    let (transaction, unit) = (request.transaction, request.unit);
                    if !response.is_empty() {
                        answers.push(tcp::encode_frame(transaction, unit, &response).to_vec());
                    }
                }
            }
            Self::Packets(receiver, protocol) => {
                let body = receiver.push(*protocol, byte);
                answers.extend(body.and_then(|body| drive.packet(&body, may_command)));
            }
            Self::Stream(decoder) => {
                if let Some(received) = decoder.push(byte)
                    && (!is_command(&received) || may_command())
                    && let Some(answer) = drive.stream(&received)
                {
                    answers.push(stream::encode(&answer).to_vec());
                }
            }
        }
        Ok(())
    }

    /// The line has been silent for a frame gap.
    pub(super) fn idle(&mut self, drive: &mut dyn Responder, answers: &mut Vec<Vec<u8>>) {
        if let Self::ModbusRtu(receiver) = self {
            receiver.idle();
            answer_rtu(receiver, drive, &mut || true, answers);
        }
    }
}

/// Function codes that change something in the drive: a host that is not in command gets the exception "busy".
const WRITES: [u8; 6] = [5, 6, 15, 16, 22, 23];

fn answer(pdu: &[u8], drive: &mut dyn Responder, may_command: &mut dyn FnMut() -> bool) -> Vec<u8> {
    match pdu.first() {
        Some(code) if WRITES.contains(code) && !may_command() => {
            vec![code | 0x80, Exception::Busy.code()]
        }
        _ => drive.modbus(pdu),
    }
}

fn is_command(received: &Received) -> bool {
    matches!(received, Ok(frame) if matches!(frame.message, stream::Message::Command(_)))
}

fn answer_rtu(
    receiver: &mut RtuReceiver,
    drive: &mut dyn Responder,
    may_command: &mut dyn FnMut() -> bool,
    answers: &mut Vec<Vec<u8>>,
) {
    while let Some(request) = receiver.take_frame() {
        let response = answer(request.pdu(), drive, may_command);
        if !request.is_broadcast() && !response.is_empty() {
            answers.push(rtu::encode_frame(request.unit, &response).to_vec());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EmulatorConfig;

    #[test]
    fn other_units_broadcasts_and_damage_get_no_answer() {
        let mut drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 1);
        let frame = |unit| rtu::encode_frame(unit, &[6, 0, 73, 0, 100]).to_vec();
        let mut damaged = frame(UNIT);
        damaged[3] ^= 1;
        for (request, answers) in [(frame(2), 0), (damaged, 0), (frame(0), 0), (frame(UNIT), 1)] {
            let mut codec = Codec::new(Protocol::ModbusRtu, UNIT);
            let mut said = Vec::new();
            for byte in &request {
                codec.push(*byte, &mut drive, &mut || true, &mut said).unwrap();
            }
            codec.idle(&mut drive, &mut said);
            assert_eq!(said.len(), answers, "{request:?}");
        }
    }
}
