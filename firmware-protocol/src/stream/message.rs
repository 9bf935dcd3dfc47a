//! The messages and their payloads.

use super::capture::{CaptureBlock, CaptureStatus};
use crate::capture::CaptureControl;
use crate::codes::coded;
use crate::command::DriveCommand;
use crate::identity::Identity;
use crate::registers as r;
use crate::registers::{COMMAND_WORDS, IDENTITY_WORDS, Register};
use crate::telemetry::Telemetry;
use crate::wire::{Sink, Source, on_stream};

/// One message with what every message carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// The host counts its messages; an answer repeats the number of the question.
    /// A command's number is also its sequence number that telemetry echoes once it is applied.
    pub seq: u16,
    /// Drive time at which an answer was formed, microseconds; 0 from the host.
    pub time_us: u32,
    /// What is said.
    pub message: Message,
}

impl Frame {
    /// A question of the host.
    pub const fn ask(seq: u16, message: Message) -> Self {
        Self {
            seq,
            time_us: 0,
            message,
        }
    }

    /// A command; its number is that of the frame.
    pub const fn command(command: DriveCommand) -> Self {
        Self::ask(command.seq, Message::Command(command))
    }

    /// The answer to question `seq`: telemetry, stamped with its own time.
    pub const fn telemetry(seq: u16, telemetry: Telemetry) -> Self {
        Self {
            seq,
            time_us: telemetry.time_us,
            message: Message::Telemetry(telemetry),
        }
    }
}

/// What is said.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is no allocator to box a capture block"
)]
pub enum Message {
    /// Host: who are you? Answer: `Identity`.
    Hello,
    /// Host: apply this; kicks the watchdog. Answer: `Telemetry` of a sample taken after it was applied.
    Command(DriveCommand),
    /// Host: how are you? Does not kick the watchdog. Answer: `Telemetry`.
    TelemetryRequest,
    /// Host: set the watchdog to so many milliseconds. Answer: `Identity`.
    SetWatchdog(u16),
    /// Host: abort, arm or start a capture. Answer: `CaptureStatus`.
    CaptureArm(CaptureControl),
    /// Host: how far is the capture? Answer: `CaptureStatus`.
    CaptureStatusRequest,
    /// Host: captured samples from this index on. Answer: `CaptureBlock`.
    CaptureRequest(u16),
    /// Drive: who it is.
    Identity(Identity),
    /// Drive: one measured instant.
    Telemetry(Telemetry),
    /// Drive: where the capture is.
    CaptureStatus(CaptureStatus),
    /// Drive: captured samples.
    CaptureBlock(CaptureBlock),
    /// Drive: the question is refused and had no effect.
    Error(Refusal),
}

/// Which question is refused, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Type byte of the question.
    pub kind: u8,
    /// Why.
    pub code: ErrorCode,
}

coded! {
    /// Type byte; answers of the drive have bit 7 set.
    MessageType: u8 {
        /// [`Message::Hello`].
        Hello = 0x01,
        /// [`Message::Command`].
        Command = 0x02,
        /// [`Message::TelemetryRequest`].
        TelemetryRequest = 0x03,
        /// [`Message::SetWatchdog`].
        SetWatchdog = 0x04,
        /// [`Message::CaptureArm`].
        CaptureArm = 0x05,
        /// [`Message::CaptureStatusRequest`].
        CaptureStatusRequest = 0x06,
        /// [`Message::CaptureRequest`].
        CaptureRequest = 0x07,
        /// [`Message::Identity`].
        Identity = 0x81,
        /// [`Message::Telemetry`].
        Telemetry = 0x82,
        /// [`Message::CaptureStatus`].
        CaptureStatus = 0x85,
        /// [`Message::CaptureBlock`].
        CaptureBlock = 0x87,
        /// [`Message::Error`].
        Error = 0xFF,
    }
}

coded! {
    /// Why a question is refused.
    ErrorCode: u8 {
        /// The type is not known to this drive.
        UnknownMessage = 1,
        /// The payload has the wrong length or carries a code that does not exist.
        BadPayload = 2,
        /// The value is outside the range of the register table.
        OutOfRange = 3,
        /// This drive does not have it: a control word, a capture.
        NotSupported = 4,
        /// The drive failed while it acted.
        DeviceFailure = 5,
    }
}

impl Message {
    /// The type byte's meaning.
    pub const fn kind(&self) -> MessageType {
        match self {
            Self::Hello => MessageType::Hello,
            Self::Command(_) => MessageType::Command,
            Self::TelemetryRequest => MessageType::TelemetryRequest,
            Self::SetWatchdog(_) => MessageType::SetWatchdog,
            Self::CaptureArm(_) => MessageType::CaptureArm,
            Self::CaptureStatusRequest => MessageType::CaptureStatusRequest,
            Self::CaptureRequest(_) => MessageType::CaptureRequest,
            Self::Identity(_) => MessageType::Identity,
            Self::Telemetry(_) => MessageType::Telemetry,
            Self::CaptureStatus(_) => MessageType::CaptureStatus,
            Self::CaptureBlock(_) => MessageType::CaptureBlock,
            Self::Error(_) => MessageType::Error,
        }
    }

    /// Returns the bytes used.
    pub(super) fn encode_payload(&self, out: &mut [u8]) -> usize {
        let mut writer = Writer { out, at: 0 };
        match self {
            Self::Hello | Self::TelemetryRequest | Self::CaptureStatusRequest => {}
            // The frame's own number is the command's: the block goes without its first word.
            Self::Command(command) => writer.words(&command.to_registers()[1..]),
            Self::SetWatchdog(ms) => writer.words(&[*ms]),
            Self::CaptureArm(control) => writer.words(&[control.code()]),
            Self::CaptureRequest(index) => writer.words(&[*index]),
            Self::Identity(identity) => writer.words(&identity.to_registers()),
            Self::Telemetry(telemetry) => telemetry.write(&mut writer),
            Self::CaptureStatus(status) => status.write(&mut writer),
            Self::CaptureBlock(block) => block.write(&mut writer),
            Self::Error(refusal) => writer.bytes(&[refusal.kind, refusal.code.code()]),
        }
        writer.at
    }

    /// `None` if the payload is too short or carries a code that does not exist.
    pub(super) fn decode_payload(
        kind: MessageType,
        seq: u16,
        reader: &mut Reader<'_>,
    ) -> Option<Self> {
        let message = match kind {
            MessageType::Hello => Self::Hello,
            MessageType::Command => {
                let [control, high, low] = reader.words()?;
                let block: [u16; COMMAND_WORDS] = [seq, control, high, low];
                Self::Command(DriveCommand::from_registers(&block).ok()?)
            }
            MessageType::TelemetryRequest => Self::TelemetryRequest,
            MessageType::SetWatchdog => Self::SetWatchdog(reader.words::<1>()?[0]),
            MessageType::CaptureArm => {
                Self::CaptureArm(CaptureControl::from_code(reader.words::<1>()?[0])?)
            }
            MessageType::CaptureStatusRequest => Self::CaptureStatusRequest,
            MessageType::CaptureRequest => Self::CaptureRequest(reader.words::<1>()?[0]),
            MessageType::Identity => {
                let block = reader.words::<IDENTITY_WORDS>()?;
                Self::Identity(Identity::from_registers(&block).ok()?)
            }
            MessageType::Telemetry => Self::Telemetry(Telemetry::read(reader)),
            MessageType::CaptureStatus => Self::CaptureStatus(CaptureStatus::read(reader)?),
            MessageType::CaptureBlock => Self::CaptureBlock(CaptureBlock::read(reader)?),
            MessageType::Error => {
                let [kind, code] = reader.bytes()?;
                let code = ErrorCode::from_code(code)?;
                Self::Error(Refusal { kind, code })
            }
        };
        Some(message)
    }
}

/// Fills a payload; the buffer holds the longest one.
pub(super) struct Writer<'a> {
    out: &'a mut [u8],
    at: usize,
}

impl Writer<'_> {
    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.out[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }

    fn words(&mut self, words: &[u16]) {
        for word in words {
            self.bytes(&word.to_be_bytes());
        }
    }
}

impl Sink for Writer<'_> {
    fn raw(&mut self, register: &Register, raw: i64) {
        // The frame's header carries the time.
        if *register == r::TIME {
            return;
        }
        let bytes = raw.to_be_bytes();
        self.bytes(&bytes[8 - 2 * usize::from(register.words)..]);
    }

    fn value(&mut self, register: &Register, value: f64) {
        let register = on_stream(register);
        self.raw(&register, register.encode(value));
    }
}

/// Takes a payload apart. After the end it gives zeros and remembers that it did.
pub(super) struct Reader<'a> {
    rest: &'a [u8],
    time_us: u32,
    short: bool,
}

impl<'a> Reader<'a> {
    pub(super) const fn new(payload: &'a [u8], time_us: u32) -> Self {
        Self {
            rest: payload,
            time_us,
            short: false,
        }
    }

    /// Neither a byte too few nor one too many.
    pub(super) const fn is_used_up(&self) -> bool {
        self.rest.is_empty() && !self.short
    }

    pub(super) fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let Some((bytes, rest)) = self.rest.split_first_chunk() else {
            self.short = true;
            return None;
        };
        self.rest = rest;
        Some(*bytes)
    }

    fn words<const N: usize>(&mut self) -> Option<[u16; N]> {
        let mut words = [0; N];
        for word in &mut words {
            *word = u16::from_be_bytes(self.bytes()?);
        }
        Some(words)
    }
}

impl Source for Reader<'_> {
    fn raw(&mut self, register: &Register) -> i64 {
        if *register == r::TIME {
            return self.time_us.into();
        }
        let words = if register.words == 1 {
            self.words::<1>().map(|[word]| [word, 0])
        } else {
            self.words::<2>()
        };
        let [first, second] = words.unwrap_or_default();
        register.kind.number(first, second)
    }

    fn value(&mut self, register: &Register) -> f64 {
        let register = on_stream(register);
        let raw = self.raw(&register);
        register.decode(raw)
    }
}
