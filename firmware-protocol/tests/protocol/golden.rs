//! The golden vectors in `vectors/`: written from the code, read back and checked without it where that is possible.

use std::fmt::Write as _;

use firmware_protocol::modbus::{RtuReceiver, TcpReceiver, rtu};
use firmware_protocol::stream::{
    self, CaptureBlock, CaptureStatus, ErrorCode, Frame, Message, MessageType, Refusal,
};
use firmware_protocol::{
    CaptureControl, CaptureSample, CaptureState, Control, DriveCommand, Status,
};

use crate::support::{
    Bank, UNIT, assert_fresh, committed, decode, hex, identity, response, rtu_frame, serve,
    stream_frame, tcp_frame, telemetry, unhex,
};

/// What each request shows, and its PDU; they run one after another against one drive.
fn dialogue() -> impl Iterator<Item = (&'static str, &'static str)> {
    let lines = |mark| {
        let text = include_str!("dialogue.txt");
        text.lines().skip(1).filter_map(move |line| line.strip_prefix(mark))
    };
    lines("# ").zip(lines("> "))
}

/// Frames over RTU that nobody answers.
const UNANSWERED: &[(&str, &str)] = &[
    ("wrong checksum: silence", "01 03 00 00 00 10 44 07"),
    ("another unit: silence", "02 03 00 00 00 10 44 35"),
    ("half a request: silence", "01 03 00 00"),
];
/// Command 9: voltage 1.000 V.
const BROADCAST: &str = "10 00 20 00 04 08 00 09 00 03 00 00 03 e8";

#[test]
fn the_modbus_vectors_are_fresh() {
    let mut rtu_text = header("Modbus RTU, unit 1. `>` request, `<` response, `<` alone: silence.");
    let mut tcp_text = header("Modbus TCP, unit 1. `>` request, `<` response.");
    let (mut rtu_bank, mut tcp_bank) = (Bank::new(), Bank::new());
    let mut rtu_dialogue = |text: &mut String, shows: &str, request: &str| {
        let request = unhex(request);
        let said = response(&mut rtu_bank, &request);
        let frames = [request, said].map(|pdu| hex(&rtu_frame(UNIT, &pdu)));
        exchange(text, shows, &frames);
    };
    for (number, (shows, request)) in (1..).zip(dialogue()) {
        rtu_dialogue(&mut rtu_text, shows, request);
        let request = unhex(request);
        let said = response(&mut tcp_bank, &request);
        let frames = [request, said].map(|pdu| hex(&tcp_frame(number, UNIT, &pdu)));
        exchange(&mut tcp_text, shows, &frames);
    }
    for (shows, frame) in UNANSWERED {
        exchange(&mut rtu_text, shows, &[(*frame).to_owned(), String::new()]);
    }
    // Executed by the same bank, and what would be the answer is not sent.
    rtu_dialogue(&mut String::new(), "", BROADCAST);
    let frame = hex(&rtu_frame(rtu::BROADCAST, &unhex(BROADCAST)));
    let shows = "a broadcast is executed, in silence";
    exchange(&mut rtu_text, shows, &[frame, String::new()]);
    let shows = "so the command block is the broadcast's";
    rtu_dialogue(&mut rtu_text, shows, "03 00 20 00 04");
    assert_fresh("vectors/modbus-rtu.txt", &rtu_text);
    assert_fresh("vectors/modbus-tcp.txt", &tcp_text);
}

fn header(what: &str) -> String {
    format!("# {what}\n# The lines are one dialogue with one drive, in this order.\n")
}

fn exchange(text: &mut String, shows: &str, [request, response]: &[String; 2]) {
    let response = format!("< {response}");
    let response = response.trim_end();
    writeln!(text, "\n# {shows}\n> {request}\n{response}").expect("a string takes it");
}

/// Requests and responses of a committed file.
fn exchanges(name: &str) -> Vec<(Vec<u8>, Vec<u8>)> {
    let text = committed(name);
    let side = |mark: char| {
        let lines = text.lines().filter_map(move |line| line.strip_prefix(mark));
        lines.map(unhex).collect::<Vec<_>>()
    };
    side('>').into_iter().zip(side('<')).collect()
}

#[test]
fn the_receivers_answer_the_committed_dialogues() {
    let exchanges_rtu = exchanges("vectors/modbus-rtu.txt");
    assert_eq!(exchanges_rtu.len(), dialogue().count() + UNANSWERED.len() + 2);
    let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
    for (request, response) in exchanges_rtu {
        let said = serve(&mut receiver, &mut bank, &request, true).concat();
        assert_eq!(said, hex(&response), "to {}", hex(&request));
    }
    let (mut receiver, mut bank) = (TcpReceiver::new(), Bank::new());
    for (request, response) in exchanges("vectors/modbus-tcp.txt") {
        let frame = request
            .iter()
            .find_map(|byte| receiver.push(*byte).expect("the header is right"))
            .expect("a whole request");
        assert_eq!(hex(&frame.answer(&mut bank)), hex(&response), "to {}", hex(&request));
    }
}

/// One frame of every message type; the values are whole steps, so they survive exactly.
fn frames() -> Vec<(&'static str, Frame)> {
    let command = |seq, control| Frame::command(DriveCommand { seq, control });
    let ask = Frame::ask;
    let answer = |seq, message| Frame::answer(seq, 1_000_000, message);
    let complete =
        CaptureStatus { state: CaptureState::Complete, count: 2000, first_time_us: 500_000 };
    let refusal = Refusal { kind: MessageType::Command.code(), code: ErrorCode::NotSupported };
    let sample =
        |voltage_v, current_a, speed_rad_s| CaptureSample { voltage_v, current_a, speed_rad_s };
    let samples = [sample(24.0, -2.5, 60.0), sample(f64::NAN, 0.0, -0.5)];
    let block = CaptureBlock::new(1998, &samples);
    let mut stopped = telemetry();
    stopped.status = Status(0);
    let running = "telemetry (24 V, -1.25 A, 60.5 rad/s, -1234.5678 rad, 48.2 V, 31.4 C)";
    let arm = Message::CaptureArm(CaptureControl::Arm);
    let two_samples = "capture: two samples, the second without voltage";
    let status = Message::CaptureStatus(complete);
    vec![
        ("hello", ask(1, Message::Hello)),
        ("identity", answer(1, Message::Identity(identity()))),
        ("command: disable", command(2, Control::Disable)),
        ("command: voltage 12 V", command(3, Control::Voltage(12.0))),
        ("command: current -0.5 A", command(4, Control::Current(-0.5))),
        ("command: speed 100 rad/s", command(5, Control::Speed(100.0))),
        (running, Frame::telemetry(5, telemetry())),
        ("telemetry, disabled", Frame::telemetry(6, stopped)),
        ("telemetry request", ask(6, Message::TelemetryRequest)),
        ("watchdog 100 ms", ask(7, Message::SetWatchdog(100))),
        ("capture: arm", ask(8, arm)),
        ("capture: how far?", ask(9, Message::CaptureStatusRequest)),
        ("capture: complete, 2000 samples from 500000 us", answer(9, status)),
        ("capture: samples from 1998 on", ask(10, Message::CaptureRequest(1998))),
        (two_samples, answer(10, Message::CaptureBlock(block))),
        ("refused: command, not supported", answer(11, Message::Error(refusal))),
    ]
}

#[test]
fn the_stream_vectors_are_fresh_and_read_back() {
    let mut text = "# Native stream: one frame a line, delimiter included.\n".to_owned();
    let mut kinds = std::collections::BTreeSet::new();
    for (shows, frame) in frames() {
        let bytes = hex(&stream_frame(&frame));
        writeln!(text, "\n# {shows}\n{bytes}").expect("a string takes it");
        kinds.insert(frame.message.kind().code());
    }
    assert_fresh("vectors/stream.txt", &text);
    assert_eq!(kinds.len(), MessageType::ALL.len(), "a type has no vector");

    let committed = committed("vectors/stream.txt");
    let lines = committed.lines().filter(|line| !line.starts_with('#'));
    let decoded = decode(&lines.flat_map(unhex).collect::<Vec<u8>>());
    assert_eq!(decoded.len(), frames().len());
    for ((shows, wanted), got) in frames().iter().zip(decoded) {
        // NaN is not equal to itself; its text is.
        let got = format!("{:?}", got.unwrap());
        assert_eq!(got, format!("{wanted:?}"), "{shows}");
    }
}

#[test]
fn the_hello_frame_is_what_one_gets_by_hand() {
    // 01 01 00 01 00 00 00 00 and the CRC-16/IBM-3740 of it, stuffed by hand.
    let crc = stream::crc16(&[1, 1, 0, 1, 0, 0, 0, 0]).to_be_bytes();
    let by_hand = [3, 1, 1, 2, 1, 1, 1, 1, 3, crc[0], crc[1], 0];
    assert_eq!(stream_frame(&Frame::ask(1, Message::Hello)), by_hand);
    assert_eq!(stream::crc16(b"123456789"), 0x29B1, "published check value");
}
