//! One conversation on one link: bytes of the host in, answers of the drive out.

use firmware_protocol::modbus::{Exception, RtuReceiver, TcpReceiver, respond, rtu, tcp};
use firmware_protocol::registers::{COMMAND_ADDRESS, COMMAND_WORDS};
use firmware_protocol::{Control, DriveCommand, stream};

use super::drive::answer_stream;
use super::{ForeignDrive, SoftDrive};
use drivebench_link::Protocol;

/// The drive's address on a bus.
pub const UNIT: u8 = 1;

/// The peer speaks something else: the connection is to be closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unframeable;

/// What answers: the drive in its own language or in the guise of another.
pub(super) trait Answering: Send {
    /// The motor and what drives it, whatever the guise.
    fn soft(&self) -> &SoftDrive;

    fn advance_to(&mut self, time_s: f64);

    /// The PDU that answers a request over Modbus.
    fn modbus(&mut self, request: &[u8]) -> Vec<u8>;

    /// `None`: it is silent.
    fn stream(&mut self, received: &Received) -> Option<stream::Frame>;

    /// What comes next is asked over the connection of this number.
    fn asked_by(&mut self, session: u64);

    /// Since its last start, s, as long as it ran; `None` where it never did.
    fn ran_s(&self) -> Option<f64>;

    /// Without power nobody hears anything.
    fn is_powered(&self) -> bool;

    /// The request with which another master might command it.
    fn foreign_write(&self) -> Vec<u8>;
}

/// What a stream decoder hands out.
pub(super) type Received = Result<stream::Frame, stream::FrameError>;

impl Answering for SoftDrive {
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

    /// It answers all alike.
    fn asked_by(&mut self, _: u64) {}

    fn ran_s(&self) -> Option<f64> {
        Self::ran_s(self)
    }

    fn is_powered(&self) -> bool {
        Self::is_powered(self)
    }

    fn foreign_write(&self) -> Vec<u8> {
        let words = DriveCommand::new(0, Control::Stop).to_registers();
        let words = words.into_iter().flat_map(u16::to_be_bytes);
        let [high, low] = COMMAND_ADDRESS.to_be_bytes();
        let head = [16, high, low, 0, COMMAND_COUNT, 2 * COMMAND_COUNT];
        head.into_iter().chain(words).collect()
    }
}

/// Registers of a command, as the one byte that counts them.
const COMMAND_COUNT: u8 = {
    assert!(COMMAND_WORDS < 64, "a byte counts their bytes too");
    COMMAND_WORDS.to_le_bytes()[0]
};

impl Answering for ForeignDrive {
    fn soft(&self) -> &SoftDrive {
        Self::soft(self)
    }

    fn advance_to(&mut self, time_s: f64) {
        Self::advance_to(self, time_s);
    }

    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        self.answer(request)
    }

    /// No other make speaks our stream.
    fn stream(&mut self, _: &Received) -> Option<stream::Frame> {
        None
    }

    /// It answers all alike.
    fn asked_by(&mut self, _: u64) {}

    fn ran_s(&self) -> Option<f64> {
        Self::ran_s(self)
    }

    fn is_powered(&self) -> bool {
        Self::is_powered(self)
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.first_command()
    }
}

/// The receiving state of one session.
pub(super) enum Dialogue {
    ModbusRtu(Box<RtuReceiver>),
    ModbusTcp(Box<TcpReceiver>, u8),
    Stream(Box<stream::Decoder>),
}

impl Dialogue {
    pub(super) fn new(kind: Protocol, unit: u8) -> Self {
        match kind {
            Protocol::ModbusRtu => Self::ModbusRtu(Box::new(RtuReceiver::new(unit))),
            Protocol::ModbusTcp => Self::ModbusTcp(Box::default(), unit),
            Protocol::Stream => Self::Stream(Box::default()),
        }
    }

    /// Takes one byte at the drive's present time and appends what it makes the drive answer. `may_command`: whether this
    /// host's commands are taken now; asked with each of them.
    pub(super) fn push(
        &mut self,
        byte: u8,
        drive: &mut dyn Answering,
        may_command: &mut dyn FnMut() -> bool,
        answers: &mut Vec<Vec<u8>>,
    ) -> Result<(), Unframeable> {
        match self {
            Self::ModbusRtu(receiver) => {
                receiver.push(byte);
                answer_rtu(receiver, drive, answers);
            }
            Self::ModbusTcp(receiver, unit) => {
                // 0 and 255: the device itself, whatever stands behind it.
                if let Some(request) = receiver.push(byte).map_err(|_| Unframeable)?
                    && [0, *unit, 255].contains(&request.unit)
                {
                    let pdu = request.pdu();
                    let writes = pdu.first().is_some_and(|code| WRITES.contains(code));
                    let response = if writes && !may_command() {
                        vec![pdu[0] | 0x80, Exception::Busy.code()]
                    } else {
                        drive.modbus(pdu)
                    };
                    let (transaction, unit) = (request.transaction, request.unit);
                    if !response.is_empty() {
                        answers.push(tcp::encode_frame(transaction, unit, &response).to_vec());
                    }
                }
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
    pub(super) fn idle(&mut self, drive: &mut dyn Answering, answers: &mut Vec<Vec<u8>>) {
        if let Self::ModbusRtu(receiver) = self {
            receiver.idle();
            answer_rtu(receiver, drive, answers);
        }
    }
}

/// Function codes that change something in the drive: a host that is not in command is told that it is busy.
const WRITES: [u8; 6] = [5, 6, 15, 16, 22, 23];

fn is_command(received: &Received) -> bool {
    matches!(received, Ok(frame) if matches!(frame.message, stream::Message::Command(_)))
}

fn answer_rtu(receiver: &mut RtuReceiver, drive: &mut dyn Answering, answers: &mut Vec<Vec<u8>>) {
    while let Some(request) = receiver.take_frame() {
        let response = drive.modbus(request.pdu());
        if !request.is_broadcast() && !response.is_empty() {
            answers.push(rtu::encode_frame(request.unit, &response).to_vec());
        }
    }
}

#[cfg(test)]
mod tests {
    use firmware_protocol::Telemetry;
    use firmware_protocol::stream::{Frame, Message};
    use proptest::prelude::*;

    use super::*;
    use crate::EmulatorConfig;

    fn say(kind: Protocol, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 1);
        let mut answers = Vec::new();
        // Who speaks something else is not listened to any further.
        let _ = listen(
            &mut Dialogue::new(kind, UNIT),
            bytes,
            &mut drive,
            &mut answers,
        );
        answers
    }

    /// Takes these bytes, and then the silence after them.
    fn listen(
        dialogue: &mut Dialogue,
        bytes: &[u8],
        drive: &mut SoftDrive,
        answers: &mut Vec<Vec<u8>>,
    ) -> Result<(), Unframeable> {
        let mut bytes = bytes.iter();
        let heard = bytes.try_for_each(|byte| dialogue.push(*byte, drive, &mut || true, answers));
        dialogue.idle(drive, answers);
        heard
    }

    fn rtu_frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        rtu::encode_frame(unit, pdu).to_vec()
    }

    #[test]
    fn names_of_links_are_read_back() {
        for kind in Protocol::ALL {
            assert_eq!(Protocol::named(kind.name()), Some(kind));
        }
        assert_eq!(Protocol::named("modbus"), None);
    }

    #[test]
    fn rtu_answers_its_own_unit_only_and_is_silent_on_broadcast_and_damage() {
        let read = [3, 0, 0, 0, 16];
        assert_eq!(say(Protocol::ModbusRtu, &rtu_frame(1, &read))[0].len(), 37);
        assert!(say(Protocol::ModbusRtu, &rtu_frame(2, &read)).is_empty());
        assert!(say(Protocol::ModbusRtu, &rtu_frame(0, &read)).is_empty());
        let mut damaged = rtu_frame(1, &read);
        damaged[3] ^= 1;
        assert!(say(Protocol::ModbusRtu, &damaged).is_empty());
    }

    #[test]
    fn exceptions_are_exact() {
        let cases: [(&[u8], [u8; 2]); 6] = [
            (&[7], [0x87, 1]),
            (&[3, 0, 16, 0, 1], [0x83, 2]),
            (&[3, 0, 0, 0, 0], [0x83, 3]),
            (&[3, 0, 0, 0, 126], [0x83, 3]),
            (&[6, 0, 0, 0, 1], [0x86, 2]),
            (&[6, 0, 33, 0, 9], [0x86, 3]),
        ];
        for (request, expected) in cases {
            let answers = say(Protocol::ModbusRtu, &rtu_frame(1, request));
            assert_eq!(answers, [rtu_frame(1, &expected)], "{request:?}");
        }
    }

    #[test]
    fn tcp_repeats_the_transaction_and_gives_up_on_another_protocol() {
        let frame = tcp::encode_frame(0x1234, 1, &[3, 0, 0, 0, 2]);
        let answers = say(Protocol::ModbusTcp, &frame);
        assert_eq!(answers[0][..9], [0x12, 0x34, 0, 0, 0, 7, 1, 3, 4]);
        assert!(say(Protocol::ModbusTcp, b"GET / HTTP/1.1\r\n\r\n").is_empty());
    }

    #[test]
    fn the_stream_answers_a_command_with_the_sample_after_it() {
        let command = DriveCommand::new(700, Control::Voltage(9.0));
        let question = stream::encode(&Frame::command(command));
        let answers = say(Protocol::Stream, &question);
        let mut decoder = stream::Decoder::new();
        let mut frames = answers[0].iter().filter_map(|byte| decoder.push(*byte));
        let answer = frames.next().unwrap().unwrap();
        assert_eq!(answer.seq, 700);
        let Message::Telemetry(Telemetry {
            seq, voltage_cmd_v, ..
        }) = answer.message
        else {
            panic!("{answer:?}");
        };
        assert_eq!(seq, 700);
        assert!((voltage_cmd_v - 9.0).abs() < 1e-9);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Whatever comes in, the drive neither panics nor becomes deaf: after a silence it answers the next request.
        #[test]
        fn noise_never_makes_the_drive_deaf(noise in prop::collection::vec(any::<u8>(), 0..400)) {
            let mut drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 1);
            let hello = stream::encode(&Frame::ask(7, Message::Hello));
            for (kind, request) in [
                (Protocol::ModbusRtu, rtu_frame(1, &[3, 0, 0, 0, 16])),
                // An empty frame ends whatever the noise began.
                (Protocol::Stream, [&[0][..], &hello].concat()),
            ] {
                let mut dialogue = Dialogue::new(kind, UNIT);
                let mut answers = Vec::new();
                prop_assert!(listen(&mut dialogue, &noise, &mut drive, &mut answers).is_ok());
                answers.clear();
                prop_assert!(listen(&mut dialogue, &request, &mut drive, &mut answers).is_ok());
                prop_assert_eq!(answers.last().map(|answer| answer.len() >= 37), Some(true));
            }
            // A wrong header ends the connection; anything else is served.
            let mut dialogue = Dialogue::new(Protocol::ModbusTcp, UNIT);
            let _ = listen(&mut dialogue, &noise, &mut drive, &mut Vec::new());
        }
    }
}
