//! The messages and their payloads.

use super::capture::{CaptureBlock, CaptureStatus};
use super::payload::{Plain, Reader};
use crate::capture::CaptureControl;
use crate::codes::coded;
use crate::command::DriveCommand;
use crate::identity::Identity;
use crate::registers::{COMMAND_WORDS, IDENTITY_WORDS};
use crate::telemetry::Telemetry;

/// One message with the fields of every frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Number of the request, counted by the host; an answer repeats it. That of a command is also the sequence number that telemetry
    /// echoes once the command is applied.
    pub seq: u16,
    /// Drive time at which an answer was formed, microseconds; 0 from the host.
    pub time_us: u32,
    /// Type and payload.
    pub message: Message,
}

impl Frame {
    /// An answer of the drive, formed at this time.
    pub const fn answer(seq: u16, time_us: u32, message: Message) -> Self {
        Self { seq, time_us, message }
    }

    /// A request of the host.
    pub const fn ask(seq: u16, message: Message) -> Self {
        Self::answer(seq, 0, message)
    }

    /// A command; its number is that of the frame.
    pub const fn command(command: DriveCommand) -> Self {
        Self::ask(command.seq, Message::Command(command))
    }

    /// Telemetry as the answer to request `seq`, with the time of its sample.
    pub const fn telemetry(seq: u16, telemetry: Telemetry) -> Self {
        Self::answer(seq, telemetry.time_us, Message::Telemetry(telemetry))
    }
}

/// Type and payload of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box a capture block")]
pub enum Message {
    /// Host: request of the identity. Answer: `Identity`.
    Hello,
    /// Host: a command, which restarts the watchdog. Answer: `Telemetry` of a sample taken after it was applied.
    Command(DriveCommand),
    /// Host: request of the telemetry, which does not restart the watchdog. Answer: `Telemetry`.
    TelemetryRequest,
    /// Host: time of the watchdog, ms. Answer: `Identity`.
    SetWatchdog(u16),
    /// Host: abort, arm or start a capture. Answer: `CaptureStatus`.
    CaptureArm(CaptureControl),
    /// Host: request of the state of the capture. Answer: `CaptureStatus`.
    CaptureStatusRequest,
    /// Host: request of the captured samples from this index on. Answer: `CaptureBlock`.
    CaptureRequest(u16),
    /// Drive: its identity.
    Identity(Identity),
    /// Drive: one measured instant.
    Telemetry(Telemetry),
    /// Drive: state of the capture.
    CaptureStatus(CaptureStatus),
    /// Drive: captured samples.
    CaptureBlock(CaptureBlock),
    /// Drive: the request is refused and had no effect.
    Error(Refusal),
}

/// Refusal of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Type byte of the request.
    pub kind: u8,
    /// Reason.
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
    /// Reason of a refusal.
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

    /// Puts the payload behind the header.
    pub(super) fn encode_payload(&self, writer: &mut Plain) {
        match self {
            Self::Hello | Self::TelemetryRequest | Self::CaptureStatusRequest => {}
            // The frame's own number is the command's: the block goes without its first word.
            Self::Command(command) => writer.words(&command.to_registers()[1..]),
            Self::SetWatchdog(ms) => writer.words(&[*ms]),
            Self::CaptureArm(control) => writer.words(&[control.code()]),
            Self::CaptureRequest(index) => writer.words(&[*index]),
            Self::Identity(identity) => writer.words(&identity.to_registers()),
            Self::Telemetry(telemetry) => telemetry.write(writer),
            Self::CaptureStatus(status) => status.write(writer),
            Self::CaptureBlock(block) => block.write(writer),
            Self::Error(refusal) => writer.extend(&[refusal.kind, refusal.code.code()]),
        }
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
                Self::Command(DriveCommand::from_registers(&block)?)
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
