//! Server of the native stream: one answer per request, with the number of the request.

use firmware_protocol::stream::{
    CAPTURE_BLOCK_SAMPLES, CaptureBlock, CaptureStatus, ErrorCode, Frame, FrameError, Message,
    Refusal,
};

use super::SoftDrive;

/// The answer to what the decoder gave; `None` where nothing that could be answered was understood.
pub(crate) fn answer(drive: &mut SoftDrive, received: &Result<Frame, FrameError>) -> Option<Frame> {
    let (seq, message) = match received {
        Ok(frame) => (frame.seq, respond(drive, frame)?),
        // Bit 7 marks the answer of a drive; a refusal of it would be refused in turn, without end.
        Err(FrameError::UnknownType { kind, seq }) if kind & 0x80 == 0 => {
            (*seq, refusal(*kind, ErrorCode::UnknownMessage))
        }
        Err(FrameError::Payload { kind, seq }) if kind & 0x80 == 0 => {
            (*seq, refusal(*kind, ErrorCode::BadPayload))
        }
        Err(_) => return None,
    };
    Some(Frame::answer(seq, drive.micros(drive.tick), message))
}

fn respond(drive: &mut SoftDrive, frame: &Frame) -> Option<Message> {
    Some(match &frame.message {
        Message::Hello => Message::Identity(*drive.identity()),
        Message::Command(command) => {
            drive.command(*command);
            Message::Telemetry(drive.telemetry())
        }
        Message::TelemetryRequest => Message::Telemetry(drive.telemetry()),
        Message::SetWatchdog(ms) => {
            if drive.set_watchdog_ms(*ms) {
                Message::Identity(*drive.identity())
            } else {
                refusal(frame.message.kind().code(), ErrorCode::OutOfRange)
            }
        }
        Message::CaptureArm(control) => {
            drive.control_capture(*control);
            Message::CaptureStatus(drive.capture_status())
        }
        Message::CaptureStatusRequest => Message::CaptureStatus(drive.capture_status()),
        Message::CaptureRequest(index) => Message::CaptureBlock(CaptureBlock::new(
            *index,
            drive.capture.samples(*index, CAPTURE_BLOCK_SAMPLES),
        )),
        // Another drive's answer on the same line.
        Message::Identity(_)
        | Message::Telemetry(_)
        | Message::CaptureStatus(_)
        | Message::CaptureBlock(_)
        | Message::Error(_) => return None,
    })
}

const fn refusal(kind: u8, code: ErrorCode) -> Message {
    Message::Error(Refusal { kind, code })
}

impl SoftDrive {
    fn capture_status(&self) -> CaptureStatus {
        CaptureStatus {
            state: self.capture.state(),
            count: self.capture.count(),
            first_time_us: self.micros(self.capture.first_tick()),
        }
    }
}
