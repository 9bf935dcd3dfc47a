//! Frames of our own stream (firmware-protocol/SPEC.md, 6): a turn over the addresses of our own map is one message.
//!
//! ```text
//! request: message, number, check sum in COBS, 00          reply: the same, with the number of its request
//! ```
//!
//! Only the zero behind it marks a frame, so what stands before one is a part of it.

use firmware_protocol::registers::{CAPTURE_STATE, COMMAND_ADDRESS, IDENTITY_ADDRESS};
use firmware_protocol::stream::{
    CaptureStatus, Decoder, ErrorCode, Frame, FrameError, MAX_FRAME, Message, encode,
};
use firmware_protocol::{
    CaptureControl, CaptureSample, Control, DriveCommand, Identity, Telemetry,
};

use super::{Code, Expected, Search, Turn};
use crate::burst::WINDOW_ADDRESS;
use crate::exchange::NoData;
use crate::unexpected::Unexpected;

/// What a turn of the link to our own drive is on the stream.
fn message(turn: Turn<'_>) -> Message {
    match (turn.put.map(|put| (put.address, put.cells)), turn.read.map(|read| read.address)) {
        (Some((COMMAND_ADDRESS, &[seq, control, high, low])), _) => {
            // The drive refuses a command without a set-point.
            let none = DriveCommand::new(seq, Control::Voltage(f64::NAN));
            let command = DriveCommand::from_registers(&[seq, control, high, low]);
            Message::Command(command.unwrap_or(none))
        }
        (Some((WINDOW_ADDRESS, &[index])), _) => Message::CaptureRequest(index),
        (Some((_, &[control])), _) => {
            Message::CaptureArm(CaptureControl::from_code(control).unwrap_or(CaptureControl::Abort))
        }
        (_, Some(IDENTITY_ADDRESS)) => Message::Hello,
        (_, Some(address)) if address == CAPTURE_STATE.address => Message::CaptureStatusRequest,
        _ => Message::TelemetryRequest,
    }
}

/// The number of a turn after that of the one before it: a command has its own.
pub(super) fn number(turn: Turn<'_>, last: u32) -> u32 {
    match message(turn) {
        Message::Command(command) => command.seq.into(),
        _ => last.wrapping_add(1),
    }
}

pub(super) fn request(turn: Turn<'_>, number: u32) -> Vec<u8> {
    let [.., high, low] = number.to_be_bytes();
    let number = u16::from_be_bytes([high, low]);
    let message = message(turn);
    // Half of all numbers away from the commands around it: no late answer has the number of one.
    let is_command = matches!(message, Message::Command(_));
    let number = if is_command { number } else { number ^ 0x8000 };
    encode(&Frame::ask(number, message)).to_vec()
}

pub(super) fn bytes(turn: Turn<'_>) -> (usize, usize) {
    let reply = match message(turn) {
        Message::Hello => Message::Identity(Identity::default()),
        Message::Command(_) | Message::TelemetryRequest => Message::Telemetry(Telemetry::default()),
        Message::CaptureRequest(_) => return (request(turn, 0).len(), MAX_FRAME),
        _ => Message::CaptureStatus(CaptureStatus::default()),
    };
    (request(turn, 0).len(), encode(&Frame::ask(0, reply)).len())
}

/// The frames that end in these bytes, and where each begins and ends.
fn frames(bytes: &[u8]) -> impl Iterator<Item = (usize, usize, Result<Frame, FrameError>)> {
    let (mut decoder, mut begin) = (Decoder::new(), 0);
    bytes.iter().enumerate().filter_map(move |(at, byte)| {
        let frame = decoder.push(*byte);
        let began = begin;
        if *byte == 0 {
            begin = at + 1;
        }
        frame.map(|frame| (began, at + 1, frame))
    })
}

fn frame(bytes: &[u8]) -> Option<Frame> {
    frames(bytes).find_map(|(_, _, frame)| frame.ok())
}

pub(super) fn code_of(bytes: &[u8]) -> Option<Code> {
    let function = frame(bytes)?.message.kind().code();
    Some(Code { function, length: bytes.len() })
}

fn answers(request: &Message, answer: &Message) -> bool {
    match (request, answer) {
        (Message::CaptureRequest(index), Message::CaptureBlock(block)) => {
            block.index == *index && !block.samples().is_empty()
        }
        (Message::Hello, Message::Identity(_))
        | (Message::Command(_) | Message::TelemetryRequest, Message::Telemetry(_))
        | (Message::CaptureArm(_) | Message::CaptureStatusRequest, Message::CaptureStatus(_))
        | (_, Message::Error(_)) => true,
        _ => false,
    }
}

pub(super) fn search(expected: &Expected, received: &[u8]) -> Search {
    let mut found = Search::default();
    // A reply comes in pieces, and each is looked through.
    if !received.contains(&0) {
        return found;
    }
    let request = frame(&expected.request);
    for (begin, end, frame) in frames(received) {
        match (&request, frame) {
            (Some(request), Ok(frame)) if frame.seq == request.seq => {
                if answers(&request.message, &frame.message) {
                    found.reply = Some((begin, end));
                    return found;
                }
                found.foreign(Unexpected::Frame);
            }
            (_, Ok(_)) => found.old.extend(code_of(&received[begin..end])),
            // No frame of another version shows its number.
            (Some(_), Err(FrameError::Version(_))) => {
                found.reply = Some((begin, end));
                return found;
            }
            (_, Err(_)) => {}
        }
    }
    found
}

/// The cells of a reply. Telemetry and captured samples have finer steps than their registers: their cells are the bytes of the
/// frame, for [`telemetry`] and [`samples`].
pub(super) fn cells(reply: &[u8]) -> Result<Vec<u16>, NoData> {
    match frames(reply).next() {
        Some((_, _, Ok(frame))) => match frame.message {
            Message::Error(refusal) => Err(refused(refusal.code)),
            Message::Identity(identity) => Ok(identity.to_registers().to_vec()),
            Message::CaptureStatus(CaptureStatus { state, count, first_time_us }) => {
                let [a, b, c, d] = first_time_us.to_be_bytes();
                let (high, low) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
                Ok(vec![state.code(), count, high, low])
            }
            _ => Ok(reply.iter().map(|byte| u16::from(*byte)).collect()),
        },
        Some((_, _, Err(FrameError::Version(found)))) => Err(NoData::Version(found)),
        _ => Err(NoData::Mismatch("the reply is no frame".to_owned())),
    }
}

const fn refused(code: ErrorCode) -> NoData {
    let name = match code {
        ErrorCode::UnknownMessage => "unknown message",
        ErrorCode::BadPayload => "bad payload",
        ErrorCode::OutOfRange => "out of range",
        ErrorCode::NotSupported => "not supported",
        ErrorCode::DeviceFailure => "device failure",
    };
    NoData::Refused { code: code.code(), name }
}

fn carried(cells: &[u16]) -> Option<Message> {
    let bytes: Vec<u8> = cells.iter().map(|cell| cell.to_be_bytes()[1]).collect();
    Some(frame(&bytes)?.message)
}

pub(super) fn telemetry(cells: &[u16]) -> Option<Telemetry> {
    match carried(cells)? {
        Message::Telemetry(telemetry) => Some(telemetry),
        _ => None,
    }
}

pub(super) fn samples(cells: &[u16]) -> Vec<CaptureSample> {
    match carried(cells) {
        Some(Message::CaptureBlock(block)) => block.samples().to_vec(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use firmware_protocol::stream::{CaptureBlock, Refusal};

    use super::*;
    use crate::cell_bus::{Put, ReadRequest};
    use crate::framing::FrameKind;

    const TELEMETRY: ReadRequest = ReadRequest::holding(0, 16);

    fn write(address: u16, cells: &[u16]) -> Turn<'_> {
        Turn { read: Some(TELEMETRY), ..Turn::write(Put { function: 16, address, cells }) }
    }

    fn bytes_of(seq: u16, message: &Message) -> Vec<u8> {
        encode(&Frame::answer(seq, 77, *message)).to_vec()
    }

    fn outstanding(request: Vec<u8>) -> Expected {
        Expected { request, ..Expected::default() }
    }

    #[test]
    fn each_turn_is_its_message_and_has_its_lengths() {
        let control = Control::Voltage(-1.5);
        let command = DriveCommand::new(9, control).to_registers();
        let plain = |address, count| Turn::read(ReadRequest::holding(address, count));
        let arm = Message::CaptureArm(CaptureControl::Arm);
        for (turn, expected, lengths) in [
            (write(32, &command), Message::Command(DriveCommand::new(9, control)), (18, 52)),
            (plain(0, 16), Message::TelemetryRequest, (12, 52)),
            (plain(64, 17), Message::Hello, (12, 46)),
            (plain(129, 4), Message::CaptureStatusRequest, (12, 20)),
            (write(128, &[1]), arm, (14, 20)),
            (write(133, &[80]), Message::CaptureRequest(80), (14, MAX_FRAME)),
        ] {
            assert_eq!((message(turn), bytes(turn)), (expected, lengths));
        }
        // The drive refuses what has no set-point, and does not switch off.
        let none = DriveCommand::new(9, Control::Current(f64::NAN)).to_registers();
        let sent = request(write(32, &none), 9);
        assert!(matches!(frames(&sent).next(), Some((_, _, Err(FrameError::Payload { .. })))));
    }

    #[test]
    fn the_number_of_a_question_is_far_from_those_of_commands() {
        let kind = FrameKind::Stream;
        let seq_of = |turn, number| frame(&request(turn, number)).unwrap().seq;
        let command = DriveCommand::new(65_535, Control::Stop).to_registers();
        let (command, question) = (write(32, &command), Turn::read(TELEMETRY));
        let number = kind.number(command, 7);
        assert_eq!(seq_of(command, number), 65_535);
        let number = kind.number(question, number);
        assert_eq!(seq_of(question, number), 0x8000);
        assert_eq!(seq_of(question, kind.number(question, number)), 0x8001);
    }

    #[test]
    fn only_the_answer_with_the_number_of_its_request_is_taken() {
        let command = DriveCommand::new(7, Control::Stop).to_registers();
        let expected = outstanding([&[0][..], &request(write(32, &command), 7)].concat());
        let answer = |seq| bytes_of(seq, &Message::Telemetry(Telemetry::default()));
        let refusal = Message::Error(Refusal { kind: 2, code: ErrorCode::NotSupported });
        let mut damaged = answer(7);
        damaged[12] ^= 4;
        for (received, reply, old, foreign) in [
            (answer(7), Some((0, 52)), 0, 0),
            (bytes_of(7, &refusal), Some((0, 14)), 0, 0),
            ([answer(6), answer(7)].concat(), Some((52, 104)), 1, 0),
            ([&[0, 0][..], &answer(7)].concat(), Some((2, 54)), 0, 0),
            ([&damaged[..], &answer(7)].concat(), Some((52, 104)), 0, 0),
            ([&answer(6)[..51], &answer(7)].concat(), None, 0, 0),
            (answer(7)[..51].to_vec(), None, 0, 0),
            (expected.request.clone(), None, 0, 1),
            (bytes_of(7, &Message::Identity(Identity::default())), None, 0, 1),
        ] {
            let found = super::super::search(FrameKind::Stream, &expected, &received).unwrap();
            let context = format!("{received:02x?}");
            let found = (found.reply, found.old.len(), found.foreign);
            assert_eq!(found, (reply, old, foreign), "{context}");
        }
        assert_eq!(search(&Expected::default(), &answer(7)).old.len(), 1);
    }

    #[test]
    fn samples_keep_their_finer_steps_and_belong_to_their_index() {
        let sample = CaptureSample { voltage_v: 1.25, current_a: 0.000_12, speed_rad_s: 0.5 };
        let block = |index, samples: &[CaptureSample]| {
            bytes_of(3, &Message::CaptureBlock(CaptureBlock::new(index, samples)))
        };
        let expected = outstanding(request(write(133, &[80]), 3 ^ 0x8000));
        for (block, is_taken) in
            [(block(80, &[sample]), true), (block(40, &[sample]), false), (block(80, &[]), false)]
        {
            assert_eq!(search(&expected, &block).reply.is_some(), is_taken);
        }
        let Ok(cells) = cells(&block(80, &[sample])) else { panic!("a block has cells") };
        assert!((samples(&cells)[0].current_a - 0.000_12).abs() < 1e-9);
        assert_eq!(telemetry(&cells), None);
    }
}
