//! The C reference slave in `c/`: built by the system's compiler, it must say what the Rust codec says, byte for byte.

use std::io::{BufRead, BufReader, Write as _};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::LazyLock;

use firmware_protocol::modbus::{RtuReceiver, rtu};
use firmware_protocol::stream::{
    self, CaptureBlock, CaptureStatus, Decoder, ErrorCode, Frame, FrameError, Message, Refusal,
};
use firmware_protocol::{REGISTERS, registers};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use tempfile::TempDir;

use crate::c_compiler;
use crate::properties::{config, line, pdu};
use crate::support::{Bank, UNIT, file, hex, response, rtu_frame, serve, stream_frame};

/// Built once for all tests of this process.
static REPLAY: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let binary = c_compiler::build("test/replay.c", folder.path());
    (folder, binary)
});

fn replay() -> Command {
    Command::new(&REPLAY.1)
}

#[test]
fn the_c_slave_replays_the_golden_vectors() {
    for (protocol, name) in [
        ("rtu", "vectors/modbus-rtu.txt"),
        ("tcp", "vectors/modbus-tcp.txt"),
        ("stream", "vectors/stream.txt"),
    ] {
        let output = replay().arg(protocol).arg(file(name)).output();
        let output = output.expect("the program can be started");
        let said = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{protocol}: {said}\n{errors}");
        assert!(said.ends_with(" 0 wrong\n"), "{said}");
    }
}

#[test]
fn the_library_needs_four_functions_of_the_c_library() {
    let (folder, binary) = &*REPLAY;
    let object = folder.path().join("library.o");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    for source in ["drive_map.c", "drive_modbus.c", "drive_stream.c"] {
        let output = Command::new(&compiler)
            .args(["-std=c99", "-ffreestanding", "-O2", "-c"])
            .arg(format!("-I{}", file("include").display()))
            .arg(c_compiler::folder().join(source))
            .arg("-o")
            .arg(&object)
            .output()
            .expect("the compiler can be started");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let output = Command::new("nm").arg("-u").arg(&object).output();
        let output = output.expect("nm is there: binutils, with which Rust links");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        for name in text.lines().filter_map(|line| line.split_whitespace().last()) {
            let of_the_platform = name.starts_with("__stack_chk") || name.starts_with('_');
            assert!(
                name.starts_with("drive_")
                    || of_the_platform
                    || ["memcpy", "memmove", "memset", "strlen"].contains(&name),
                "{source} needs {name}"
            );
        }
    }
    assert!(binary.is_file());
}

/// The C slave in a process of its own; every line gets the answers up to a full stop.
struct Talk {
    child: Child,
    questions: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Talk {
    fn start(protocol: &str) -> Self {
        let mut command = replay();
        command.args(["talk", protocol]).stdin(Stdio::piped());
        let mut child = command.stdout(Stdio::piped()).spawn().expect("it starts");
        let questions = child.stdin.take().expect("it is a pipe");
        let answers = BufReader::new(child.stdout.take().expect("it is a pipe"));
        Self { child, questions, answers }
    }

    fn ask(&mut self, question: &str) -> Vec<String> {
        let asked = writeln!(self.questions, "{question}").and_then(|()| self.questions.flush());
        assert!(asked.is_ok(), "the C slave ended; its last words are on stderr");
        let mut said = Vec::new();
        loop {
            let mut line = String::new();
            let count = self.answers.read_line(&mut line).expect("text");
            assert!(count > 0, "the C slave ended at {question}");
            match line.trim_end() {
                "." => return said,
                answer => said.push(answer.trim_start_matches('<').trim().to_owned()),
            }
        }
    }
}

impl Drop for Talk {
    fn drop(&mut self) {
        // It ends by itself when its questions end; whether it has is of no interest any more.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What one line of a random dialogue is.
#[derive(Clone, Debug)]
enum Turn {
    Bytes(Vec<u8>),
    Silence,
}

fn compare(
    protocol: &str,
    turns: &impl Strategy<Value = Vec<Turn>>,
    reference: impl Fn(&[Turn]) -> Vec<Vec<String>>,
) {
    let result = TestRunner::new(config()).run(turns, |turns| {
        let mut talk = Talk::start(protocol);
        for (turn, wanted) in turns.iter().zip(reference(&turns)) {
            let said = match turn {
                Turn::Bytes(bytes) => talk.ask(&hex(bytes)),
                Turn::Silence => talk.ask("idle"),
            };
            prop_assert_eq!(said, wanted, "{:?}", turn);
        }
        Ok(())
    });
    let failure = result.err().map(|failure| failure.to_string());
    assert_eq!(failure, None);
}

/// Addresses and values where something happens.
fn pointed_pdu() -> impl Strategy<Value = Vec<u8>> {
    let address = prop::sample::select(
        &[0_u16, 7, 15, 31, 32, 33, 34, 35, 64, 73, 80, 128, 133, 134, 254][..],
    );
    let word = prop_oneof![0_u16..7, Just(0x8000), Just(200), any::<u16>()];
    prop_oneof![
        pdu(),
        (address.clone(), word.clone()).prop_map(|(address, value)| {
            let [a, b, v, w] = [address.to_be_bytes(), value.to_be_bytes()].concat()[..] else {
                return Vec::new();
            };
            vec![6, a, b, v, w]
        }),
        (address, prop::collection::vec(word, 1..5)).prop_map(|(address, values)| {
            let mut pdu = vec![16];
            pdu.extend(address.to_be_bytes());
            pdu.extend([0, u8::try_from(values.len()).unwrap_or(0)]);
            pdu.push(u8::try_from(2 * values.len()).unwrap_or(0));
            pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
            pdu
        }),
        (1_u8..6, 0_u8..8).prop_map(|(code, object)| vec![43, 14, code, object]),
    ]
}

#[test]
fn any_rtu_dialogue_gets_the_same_answers_from_the_c_slave() {
    let turn = prop_oneof![
        6 => pointed_pdu().prop_map(|pdu| Turn::Bytes(rtu_frame(UNIT, &pdu))),
        1 => pointed_pdu().prop_map(|pdu| Turn::Bytes(rtu_frame(rtu::BROADCAST, &pdu))),
        1 => pointed_pdu().prop_map(|pdu| Turn::Bytes(rtu_frame(2, &pdu))),
        1 => line().prop_map(Turn::Bytes),
        2 => Just(Turn::Silence),
    ];
    let turns = prop::collection::vec(turn, 1..20);
    compare("rtu", &turns, |turns| {
        let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
        let said = turns.iter().map(|turn| {
            let (bytes, gap) = match turn {
                Turn::Bytes(bytes) => (&bytes[..], false),
                Turn::Silence => (&[][..], true),
            };
            let mut answers = serve(&mut receiver, &mut bank, bytes, gap);
            answers.retain(|answer| !answer.is_empty());
            answers
        });
        said.collect()
    });
}

#[test]
fn any_stream_dialogue_gets_the_same_answers_from_the_c_slave() {
    let payload =
        prop::collection::vec(prop_oneof![4 => Just(0_u8), 2 => 0..9_u8, 1 => any::<u8>()], 0..9);
    let question = (0_u8..9, any::<u16>(), payload);
    let fitting = (0_u8..9, any::<u16>(), any::<[u8; 6]>(), 0_u8..7).prop_map(
        |(kind, seq, mut payload, small)| {
            let length = [0, 0, 6, 0, 2, 2, 0, 2].get(usize::from(kind)).copied();
            (payload[0], payload[1]) = (0, small);
            (kind, seq, payload[..length.unwrap_or(3)].to_vec())
        },
    );
    let frame = prop_oneof![1 => question, 3 => fitting].prop_map(|(kind, seq, payload)| {
        // Any content in a right frame: the encoder of the crate only makes right ones.
        let mut plain = vec![kind, stream::VERSION];
        plain.extend(seq.to_be_bytes());
        plain.extend([0; 4]);
        plain.extend(payload);
        plain.extend(stream::crc16(&plain).to_be_bytes());
        Turn::Bytes(stuffed(&plain))
    });
    let turn = prop_oneof![
        8 => frame,
        1 => line().prop_map(Turn::Bytes),
        1 => line().prop_map(|mut bytes| { bytes.push(0); Turn::Bytes(bytes) }),
    ];
    let turns = prop::collection::vec(turn, 1..20);
    compare("stream", &turns, |turns| {
        let (mut decoder, mut bank) = (Decoder::new(), Bank::new());
        let said = turns.iter().map(|turn| {
            let Turn::Bytes(bytes) = turn else {
                return Vec::new();
            };
            let received = bytes.iter().filter_map(|byte| decoder.push(*byte));
            let answers = received.filter_map(|received| answer(&mut bank, &received));
            answers.map(|frame| hex(&stream_frame(&frame))).collect()
        });
        said.collect()
    });
}

/// COBS by the book, for at most 254 bytes: each zero becomes the distance to the next.
fn stuffed(plain: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for block in plain.split(|byte| *byte == 0) {
        out.push(u8::try_from(block.len() + 1).expect("a short frame"));
        out.extend(block);
    }
    out.push(0);
    out
}

/// The stream as SPEC.md tells it, over the same bank.
fn answer(bank: &mut Bank, received: &Result<Frame, FrameError>) -> Option<Frame> {
    let refusal = |kind, code| Message::Error(Refusal { kind, code });
    let (seq, message) = match received {
        Ok(Frame { seq, message, .. }) => (*seq, reply(bank, message)?),
        Err(FrameError::UnknownType { kind, seq }) if kind & 0x80 == 0 => {
            (*seq, refusal(*kind, ErrorCode::UnknownMessage))
        }
        Err(FrameError::Payload { kind, seq }) if kind & 0x80 == 0 => {
            (*seq, refusal(*kind, ErrorCode::BadPayload))
        }
        Err(_) => return None,
    };
    if let Message::Telemetry(telemetry) = message {
        return Some(Frame::telemetry(seq, telemetry));
    }
    Some(Frame::answer(seq, bank.telemetry.time_us, message))
}

fn reply(bank: &mut Bank, question: &Message) -> Option<Message> {
    let refused = |code| {
        let kind = question.kind().code();
        Some(Message::Error(Refusal { kind, code }))
    };
    match question {
        Message::Hello => Some(Message::Identity(bank.identity)),
        Message::Command(command) if !bank.supports(command.control) => {
            refused(ErrorCode::NotSupported)
        }
        Message::Command(command) => {
            bank.command.set(*command);
            bank.apply(*command);
            Some(Message::Telemetry(bank.sample(true)))
        }
        Message::TelemetryRequest => Some(Message::Telemetry(bank.sample(true))),
        Message::SetWatchdog(ms) if !registers::WATCHDOG.allows((*ms).into()) => {
            refused(ErrorCode::OutOfRange)
        }
        Message::SetWatchdog(ms) => {
            bank.identity.watchdog_ms = *ms;
            Some(Message::Identity(bank.identity))
        }
        Message::CaptureArm(control) => {
            bank.control_capture(*control);
            Some(capture_status(bank))
        }
        Message::CaptureStatusRequest => Some(capture_status(bank)),
        Message::CaptureRequest(index) => {
            Some(Message::CaptureBlock(CaptureBlock::new(*index, &[])))
        }
        _ => None,
    }
}

fn capture_status(bank: &Bank) -> Message {
    Message::CaptureStatus(CaptureStatus {
        state: bank.capture_state(),
        count: 0,
        first_time_us: 0,
    })
}

/// The C slave looks registers up in the table that the header repeats; nothing else may stand there.
#[test]
fn every_register_is_read_alike_by_the_c_slave() {
    let mut talk = Talk::start("rtu");
    let mut bank = Bank::new();
    let last = REGISTERS.last().expect("a table").address + 200;
    for address in 0..last {
        let [high, low] = address.to_be_bytes();
        let request = [3, high, low, 0, 1];
        let wanted = hex(&rtu_frame(UNIT, &response(&mut bank, &request)));
        let said = talk.ask(&hex(&rtu_frame(UNIT, &request)));
        assert_eq!(said, [wanted], "{address}");
    }
}
