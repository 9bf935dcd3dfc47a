//! SPEC.md: the prose stands in `specification.md.in`, every number comes from the code.

use std::fmt::Write as _;

use firmware_protocol::modbus::rtu;
use firmware_protocol::registers::{
    self, Access, CAPTURE_ADDRESS, CAPTURE_WINDOW_SAMPLES, COMMAND_ADDRESS, IDENTITY_ADDRESS,
    REGISTERS, Register, TELEMETRY_ADDRESS,
};
use firmware_protocol::stream::{self, ErrorCode, MessageType};
use firmware_protocol::{Fault, PROTOCOL_VERSION, Telemetry};

use crate::examples;
use crate::support::{assert_fresh, stream_frame, telemetry};

#[test]
fn spec_md_is_fresh() {
    assert_fresh("SPEC.md", &spec());
}

fn spec() -> String {
    let watchdog = registers::WATCHDOG;
    let values = [
        ("version", PROTOCOL_VERSION.to_string()),
        ("telemetry", block(TELEMETRY_ADDRESS..COMMAND_ADDRESS)),
        ("command", block(COMMAND_ADDRESS..IDENTITY_ADDRESS)),
        ("identity", block(IDENTITY_ADDRESS..CAPTURE_ADDRESS)),
        ("capture", block(CAPTURE_ADDRESS..u16::MAX)),
        ("faults", faults()),
        ("messages", messages()),
        ("errors", errors()),
        ("telemetry_payload", telemetry_payload()),
        ("angle_span", Telemetry::ANGLE_SPAN_RAD.to_string()),
        ("watchdog_min", watchdog.min.to_string()),
        ("watchdog_max", watchdog.max.to_string()),
        ("window_samples", CAPTURE_WINDOW_SAMPLES.to_string()),
        ("window_index", registers::WINDOW_INDEX.address.to_string()),
        ("window_count", registers::WINDOW_COUNT.address.to_string()),
        ("window_words", (3 * CAPTURE_WINDOW_SAMPLES + 1).to_string()),
        ("block_samples", stream::CAPTURE_BLOCK_SAMPLES.to_string()),
        ("max_payload", stream::MAX_PAYLOAD.to_string()),
        ("max_frame", stream::MAX_FRAME.to_string()),
        ("modbus_check", format!("{:04X}", rtu::crc16(b"123456789"))),
        ("modbus_examples", examples::modbus()),
        ("stream_examples", examples::stream()),
        ("stream_check", format!("{:04X}", stream::crc16(b"123456789"))),
    ];
    let mut text = include_str!("specification.md.in").to_owned();
    for (name, value) in values {
        let place = format!("{{{{{name}}}}}");
        assert!(text.contains(&place), "the template does not use {place}");
        text = text.replace(&place, &value);
    }
    let text = text.trim_end().to_owned() + "\n";
    assert!(!text.contains("{{"), "the template has a place without a value");
    text
}

/// The table of the registers whose addresses lie in a range.
fn block(addresses: std::ops::Range<u16>) -> String {
    let mut text = "| address | name | type | access | scale | unit | raw range | not available | meaning |\n|---|---|---|---|---|---|---|---|---|\n".to_owned();
    for register in REGISTERS {
        if !addresses.contains(&register.address) {
            continue;
        }
        let access = match register.access {
            Access::Read => "r",
            Access::ReadWrite => "rw",
        };
        let missing = register.not_available().map_or(String::new(), |raw| raw.to_string());
        writeln!(
            text,
            "| {} | `{}` | {} | {access} | {} | {} | {} .. {} | {missing} | {} |",
            places(register),
            register.name,
            register.kind.name(),
            register.scale,
            register.unit,
            register.min,
            register.max,
            register.meaning,
        )
        .expect("a string takes it");
    }
    text
}

fn places(register: &Register) -> String {
    let first = register.address;
    match (register.repeat, register.kind.words()) {
        (1, 1) => first.to_string(),
        (1, words) => format!("{first}-{}", first + u16::from(words) - 1),
        (repeat, _) => format!(
            "{first}, {}, .. {}",
            first + register.stride,
            first + (repeat - 1) * register.stride
        ),
    }
}

fn faults() -> String {
    Fault::all().fold("| code | fault |\n|---|---|\n".to_owned(), |text, fault| {
        text + &format!("| {} | {} |\n", fault.code(), fault.name())
    })
}

fn messages() -> String {
    let mut text =
        "| type | message | from | payload | answer |\n|---|---|---|---|---|\n".to_owned();
    for kind in MessageType::ALL {
        let payload = match kind {
            MessageType::Hello
            | MessageType::TelemetryRequest
            | MessageType::CaptureStatusRequest => "empty",
            MessageType::Command => {
                "`control` u16, `set_point` i32: the command block without its number, which is the frame's"
            }
            MessageType::SetWatchdog => "`watchdog` u16, ms",
            MessageType::CaptureArm => "`capture_control` u16",
            MessageType::CaptureRequest => "u16, index of the first sample wanted",
            MessageType::Identity => "the identity block as it stands in the registers",
            MessageType::Telemetry => "see below",
            MessageType::CaptureStatus => {
                "`capture_state` u16, `capture_count` u16, `capture_time` u32"
            }
            MessageType::CaptureBlock => {
                "u16 index of the first sample, u8 number of samples n, then n times `voltage` i32, `current` i32, `speed` i32, steps as in Telemetry"
            }
            MessageType::Error => "u8 type of the question, u8 error code",
        };
        let answer = match kind {
            MessageType::Hello | MessageType::SetWatchdog => "Identity",
            MessageType::Command => "Telemetry, sampled after the command was applied",
            MessageType::TelemetryRequest => "Telemetry",
            MessageType::CaptureArm | MessageType::CaptureStatusRequest => "CaptureStatus",
            MessageType::CaptureRequest => "CaptureBlock",
            _ => "",
        };
        let from = if kind.code() & 0x80 == 0 { "host" } else { "drive" };
        writeln!(text, "| 0x{:02X} | {kind:?} | {from} | {payload} | {answer} |", kind.code())
            .expect("a string takes it");
    }
    text
}

fn errors() -> String {
    let rows = ErrorCode::ALL.iter();
    rows.fold("| code | error |\n|---|---|\n".to_owned(), |text, error| {
        text + &format!("| {} | {error:?} |\n", error.code())
    })
}

/// What each telemetry register becomes on the stream; the lengths are checked against a real frame below.
fn telemetry_payload() -> String {
    let mut text = "| field | type | scale | unit |\n|---|---|---|---|\n".to_owned();
    for field in telemetry_fields() {
        writeln!(text, "| `{}` | {} | {} | {} |", field.0, field.1, field.2, field.3)
            .expect("a string takes it");
    }
    text
}

fn telemetry_fields() -> Vec<(&'static str, &'static str, String, &'static str)> {
    REGISTERS
        .iter()
        .filter(|register| register.address < COMMAND_ADDRESS && register.name != "time")
        .map(|register| {
            let finer = register.kind.words() == 1 && register.scale < 1.0;
            let (kind, scale) = if finer {
                let steps = (1000.0 / register.scale).round();
                ("i32", (1.0 / steps).to_string())
            } else {
                (register.kind.name(), register.scale.to_string())
            };
            (register.name, kind, scale, register.unit)
        })
        .collect()
}

#[test]
fn the_telemetry_payload_in_spec_md_has_its_real_length() {
    let described: usize = telemetry_fields()
        .iter()
        .map(|(_, kind, ..)| if kind.ends_with("32") { 4 } else { 2 })
        .sum();
    let frame = stream::Frame::telemetry(0x0101, telemetry());
    let length = stream_frame(&frame).len();
    // Delimiter, one code byte (the frame is shorter than 254), header and checksum.
    assert_eq!(described, length - 2 - stream::HEADER - 2);
}
