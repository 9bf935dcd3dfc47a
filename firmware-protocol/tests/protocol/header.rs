//! The C header for firmware that is not written in Rust.

use std::fmt::Write as _;

use firmware_protocol::modbus::{Exception, MAX_PDU, rtu};
use firmware_protocol::registers::{
    self, Access, CAPTURE_WINDOW_SAMPLES, COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_WORDS, Kind,
    MAGIC, TELEMETRY_WORDS,
};
use firmware_protocol::stream::{self, ErrorCode, MessageType};
use firmware_protocol::{
    CaptureControl, CaptureState, Control, DeviceKind, Fault, PROTOCOL_VERSION, REGISTERS, State,
    Status,
};

use crate::support::assert_fresh;

const NAME: &str = "include/drive_protocol.h";

#[test]
fn the_c_header_is_fresh() {
    assert_fresh(NAME, &header());
}

fn header() -> String {
    let mut text = "/* Generated from firmware-protocol/src/registers.rs; see SPEC.md. Do not edit.\n   DB_REG_*: protocol address; *_PER_UNIT: raw steps in one SI unit; DB_STREAM_*: the same value on the stream. */\n#ifndef DRIVE_PROTOCOL_H\n#define DRIVE_PROTOCOL_H\n\n".to_owned();
    let mut define = |name: &str, value: String| {
        let name = name.to_uppercase().replace([' ', '-'], "_");
        writeln!(text, "#define DB_{name} {value}").expect("a string takes it");
    };
    define("PROTOCOL_VERSION", PROTOCOL_VERSION.to_string());
    define("MAGIC", format!("0x{MAGIC:04X}"));
    for (name, number) in [
        ("TELEMETRY_WORDS", TELEMETRY_WORDS),
        ("COMMAND_WORDS", COMMAND_WORDS),
        ("IDENTITY_WORDS", IDENTITY_WORDS),
        ("CAPTURE_WINDOW_SAMPLES", CAPTURE_WINDOW_SAMPLES.into()),
        ("MODBUS_MAX_PDU", MAX_PDU),
        ("RTU_MAX_FRAME", rtu::MAX_FRAME),
        ("STREAM_HEADER", stream::HEADER),
        ("STREAM_MAX_PAYLOAD", stream::MAX_PAYLOAD),
        ("STREAM_MAX_FRAME", stream::MAX_FRAME),
        ("STREAM_BLOCK_SAMPLES", stream::CAPTURE_BLOCK_SAMPLES),
    ] {
        define(name, number.to_string());
    }
    define("STREAM_NOT_AVAILABLE", "(-2147483647 - 1)".to_owned());
    for register in REGISTERS {
        let name = format!("REG_{}", register.name);
        define(&name, register.address.to_string());
        if register.scale < 1.0 {
            let steps = (1.0 / register.scale).round();
            define(&format!("{name}_PER_UNIT"), steps.to_string());
            if register.address < COMMAND_ADDRESS {
                let finer = if register.kind.words() == 1 { 1000.0 } else { 1.0 };
                let name = format!("STREAM_{}_PER_UNIT", register.name);
                define(&name, (finer * steps).to_string());
            }
        }
        if let Some(raw) = register.not_available() {
            // The smallest 32-bit number is no literal in C.
            define(&format!("{name}_NOT_AVAILABLE"), format!("({} - 1)", raw + 1));
        }
    }
    define("WATCHDOG_MIN_MS", registers::WATCHDOG.min.to_string());
    define("WATCHDOG_MAX_MS", registers::WATCHDOG.max.to_string());
    for (name, flag) in [
        ("CURRENT_LIMIT", Status::CURRENT_LIMIT),
        ("VOLTAGE_LIMIT", Status::VOLTAGE_LIMIT),
        ("WATCHDOG", Status::WATCHDOG),
        ("COMMAND_APPLIED", Status::COMMAND_APPLIED),
        ("EMULATOR", Status::EMULATOR),
    ] {
        define(&format!("STATUS_{name}"), format!("0x{flag:04X}"));
    }
    for state in State::ALL {
        define(&format!("STATE_{state:?}"), state.code().to_string());
    }
    for (name, control) in [
        ("DISABLE", Control::Disable),
        ("STOP", Control::Stop),
        ("RESET_FAULT", Control::ResetFault),
        ("VOLTAGE", Control::Voltage(0.0)),
        ("CURRENT", Control::Current(0.0)),
        ("SPEED", Control::Speed(0.0)),
    ] {
        define(&format!("CONTROL_{name}"), control.code().to_string());
    }
    for (name, flag) in [
        ("EMULATOR", DeviceKind::EMULATOR),
        ("VOLTAGE", DeviceKind::VOLTAGE),
        ("CURRENT", DeviceKind::CURRENT),
        ("SPEED", DeviceKind::SPEED),
    ] {
        define(&format!("KIND_{name}"), format!("0x{flag:04X}"));
    }
    for control in CaptureControl::ALL {
        let name = format!("CAPTURE_CONTROL_{control:?}");
        define(&name, control.code().to_string());
    }
    for state in CaptureState::ALL {
        define(&format!("CAPTURE_{state:?}"), state.code().to_string());
    }
    for exception in Exception::ALL {
        let name = words(&format!("{exception:?}"));
        define(&format!("EXCEPTION{name}"), exception.code().to_string());
    }
    for fault in Fault::all() {
        define(&format!("FAULT_{}", fault.name()), fault.code().to_string());
    }
    for kind in MessageType::ALL {
        let name = words(&format!("{kind:?}"));
        define(&format!("MESSAGE{name}"), format!("0x{:02X}", kind.code()));
    }
    for error in ErrorCode::ALL {
        let name = words(&format!("{error:?}"));
        define(&format!("ERROR{name}"), error.code().to_string());
    }
    text + &table() + "\n#endif\n"
}

/// Every row once more, for a drive that looks its registers up.
fn table() -> String {
    let mut text = "\n/* X(name, address, words, is_signed, is_writable, lowest, highest, repeat, stride); raw range of what may be written. */\n#define DB_REGISTERS(X)".to_owned();
    for register in REGISTERS {
        write!(
            text,
            " \\\n    X({}, {}, {}, {}, {}, {}, {}, {}, {})",
            register.name.to_uppercase(),
            register.address,
            register.kind.words(),
            u8::from(matches!(register.kind, Kind::I16 | Kind::I32)),
            u8::from(register.access == Access::ReadWrite),
            register.min,
            register.max,
            register.repeat,
            register.stride,
        )
        .expect("a string takes it");
    }
    text + "\n"
}

/// `BadPayload` gives `_Bad_Payload`.
fn words(camel: &str) -> String {
    camel.chars().fold(String::new(), |text, letter| {
        let gap = if letter.is_uppercase() { "_" } else { "" };
        text + gap + letter.encode_utf8(&mut [0; 4])
    })
}
