//! A drive for tests that answers as its script says: late, twice, damaged, in another's name, or not at all.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use firmware_protocol::modbus::{Exception, RegisterBank, RtuReceiver, TcpReceiver, rtu};
use firmware_protocol::registers::{
    COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS, IDENTITY_WORDS, TELEMETRY_ADDRESS,
    TELEMETRY_WORDS,
};
use firmware_protocol::stream::{Decoder, Frame, Message, encode};
use firmware_protocol::{Control, DeviceKind, DriveCommand, Identity, Telemetry};
use firmware_protocol::{State, Status};
use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

/// An RTU frame around a PDU.
pub(super) fn rtu_frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    rtu::encode_frame(unit, pdu).to_vec()
}

/// The drive's end of a fresh pseudo-terminal that changes no byte and never blocks, and where its other end is.
pub(super) fn raw_pty() -> (File, super::Target) {
    let flags = OFlag::O_NONBLOCK | OFlag::O_RDWR | OFlag::O_NOCTTY;
    let master = posix_openpt(flags).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let mut termios = tcgetattr(&master).unwrap();
    cfmakeraw(&mut termios);
    tcsetattr(&master, SetArg::TCSANOW, &termios).unwrap();
    let target = ptsname_r(&master).unwrap().parse().unwrap();
    (File::from(std::os::fd::OwnedFd::from(master)), target)
}

/// What the drive does, one after the other.
pub(super) enum Say {
    Bytes(Vec<u8>),
    WaitMs(u64),
    HangUp,
}

/// One request that came, and what an honest drive would answer.
pub(super) struct Asked {
    /// Counts the requests that carry a command, from 1; 0 in others.
    pub(super) command: usize,
    pub(super) honest: Vec<u8>,
}

#[derive(Clone, Copy)]
pub(super) enum Language {
    Rtu,
    Tcp,
    Stream,
}

/// The drive; it ends with the value.
pub(super) struct Fake {
    pub(super) target: super::Target,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Fake {
    pub(super) fn over_pty(
        language: Language,
        identity: [u16; IDENTITY_WORDS],
        script: impl FnMut(Asked) -> Vec<Say> + Send + 'static,
    ) -> Self {
        let (port, target) = raw_pty();
        let mut ear = Ear::new(language, identity);
        Self::serving(target, move |stop| serve(port, script, &mut ear, stop))
    }

    pub(super) fn over_tcp(
        language: Language,
        script: impl FnMut(Asked) -> Vec<Say> + Send + 'static,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let target = format!("tcp:{}", listener.local_addr().unwrap());
        listener.set_nonblocking(true).unwrap();
        let mut ear = Ear::new(language, identity_block());
        Self::serving(target.parse().unwrap(), move |stop| {
            // A test that fails before it connects must not hang here.
            while !stop.load(Ordering::Relaxed) {
                if let Ok((stream, _)) = listener.accept() {
                    stream.set_nonblocking(true).unwrap();
                    return serve(stream, script, &mut ear, stop);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        })
    }

    /// Whatever works at the far end until it is told to stop.
    pub(super) fn serving(
        target: super::Target,
        work: impl FnOnce(&AtomicBool) + Send + 'static,
    ) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        let thread = Some(std::thread::spawn(move || work(&told)));
        Self {
            target,
            stop,
            thread,
        }
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let result = self.thread.take().map(JoinHandle::join);
        if !std::thread::panicking() {
            assert!(matches!(result, Some(Ok(()))), "the script failed");
        }
    }
}

fn serve(
    mut port: impl Read + Write,
    mut script: impl FnMut(Asked) -> Vec<Say>,
    ear: &mut Ear,
    stop: &AtomicBool,
) {
    let mut bytes = [0; 512];
    while !stop.load(Ordering::Relaxed) {
        let count = match port.read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(Duration::from_micros(200));
                continue;
            }
            Err(_) => return,
        };
        for byte in &bytes[..count] {
            let Some(asked) = ear.push(*byte) else {
                continue;
            };
            for say in script(asked) {
                match say {
                    Say::Bytes(bytes) => {
                        if port.write_all(&bytes).is_err() {
                            return;
                        }
                    }
                    Say::WaitMs(ms) => std::thread::sleep(Duration::from_millis(ms)),
                    Say::HangUp => return,
                }
            }
        }
    }
}

enum Receiver {
    Rtu(Box<RtuReceiver>),
    Tcp(Box<TcpReceiver>),
    Stream(Box<Decoder>),
}

struct Ear {
    receiver: Receiver,
    toy: Toy,
}

impl Ear {
    fn new(language: Language, identity: [u16; IDENTITY_WORDS]) -> Self {
        Self {
            receiver: match language {
                Language::Rtu => Receiver::Rtu(Box::new(RtuReceiver::new(1))),
                Language::Tcp => Receiver::Tcp(Box::default()),
                Language::Stream => Receiver::Stream(Box::default()),
            },
            toy: Toy {
                identity,
                command: DriveCommand::default(),
                commands: 0,
                now_us: 4_294_900_000,
            },
        }
    }

    fn push(&mut self, byte: u8) -> Option<Asked> {
        let before = self.toy.commands;
        let honest = match &mut self.receiver {
            Receiver::Rtu(receiver) => {
                receiver.push(byte);
                receiver.take_frame()?.answer(&mut self.toy).to_vec()
            }
            Receiver::Tcp(receiver) => receiver.push(byte).unwrap()?.answer(&mut self.toy).to_vec(),
            Receiver::Stream(decoder) => {
                let question = decoder.push(byte)?.unwrap();
                let answer = match question.message {
                    Message::Hello => {
                        Message::Identity(Identity::from_registers(&self.toy.identity).unwrap())
                    }
                    Message::Command(command) => {
                        self.toy.apply(command);
                        Message::Telemetry(self.toy.telemetry())
                    }
                    other => panic!("{other:?}"),
                };
                stream_frame(question.seq, self.toy.now_us, answer)
            }
        };
        let is_command = self.toy.commands > before;
        let command = if is_command { self.toy.commands } else { 0 };
        Some(Asked { command, honest })
    }
}

#[expect(
    clippy::large_types_passed_by_value,
    reason = "a test says what it sends in place"
)]
pub(super) fn stream_frame(seq: u16, time_us: u32, message: Message) -> Vec<u8> {
    let frame = Frame::answer(seq, time_us, message);
    encode(&frame).to_vec()
}

pub(super) fn identity_block() -> [u16; IDENTITY_WORDS] {
    Identity {
        kind: DeviceKind(DeviceKind::VOLTAGE),
        serial_number: 4711,
        firmware_version: 0x0203,
        current_limit_a: 11.4,
        voltage_limit_v: f64::NAN,
        watchdog_ms: 250,
        ..Identity::default()
    }
    .to_registers()
}

/// An ideal drive: the voltage is what was asked, and the current is the number of the command.
struct Toy {
    identity: [u16; IDENTITY_WORDS],
    command: DriveCommand,
    commands: usize,
    now_us: u32,
}

impl Toy {
    fn apply(&mut self, command: DriveCommand) {
        self.command = command;
        self.commands += 1;
        self.now_us = self.now_us.wrapping_add(10_000);
    }

    fn telemetry(&self) -> Telemetry {
        let state = match self.command.control {
            Control::Voltage(_) => State::Running,
            _ => State::Ready,
        };
        Telemetry {
            status: Status::new(state),
            seq: self.command.seq,
            time_us: self.now_us,
            applied_us: self.now_us.wrapping_sub(100),
            voltage_v: self.command.control.set_point(),
            current_a: f64::from(self.command.seq) * 0.01,
            ..Telemetry::default()
        }
    }
}

impl RegisterBank for Toy {
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception> {
        let telemetry = self.telemetry().to_registers();
        let (base, block): (u16, &[u16]) = if address < COMMAND_ADDRESS {
            (TELEMETRY_ADDRESS, &telemetry)
        } else {
            (IDENTITY_ADDRESS, &self.identity)
        };
        let at = usize::from(address.checked_sub(base).ok_or(Exception::IllegalAddress)?);
        let block = block.get(at..at + out.len());
        out.copy_from_slice(block.ok_or(Exception::IllegalAddress)?);
        Ok(())
    }

    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception> {
        let block: &[u16; COMMAND_WORDS] = values
            .try_into()
            .ok()
            .filter(|_| address == COMMAND_ADDRESS)
            .ok_or(Exception::IllegalAddress)?;
        self.apply(DriveCommand::from_registers(block).map_err(|_| Exception::IllegalValue)?);
        Ok(())
    }

    fn identification(&self, object: u8) -> Option<&str> {
        (object <= 2).then_some("toy")
    }
}

const _: () = assert!(
    TELEMETRY_WORDS == 16,
    "the toy's telemetry is read in one request"
);
