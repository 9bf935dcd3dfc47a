//! The C header for firmware that is not written in Rust.

use std::fmt::Write as _;

use firmware_protocol::registers::{
    self, CAPTURE_WINDOW_SAMPLES, COMMAND_WORDS, IDENTITY_WORDS, MAGIC, TELEMETRY_WORDS,
};
use firmware_protocol::stream::{self, ErrorCode, MessageType};
use firmware_protocol::{Fault, PROTOCOL_VERSION, REGISTERS, Status};

use crate::support::assert_fresh;

const NAME: &str = "drivebench_protocol.h";

#[test]
fn the_c_header_is_fresh() {
    assert_fresh(NAME, &header());
}

fn header() -> String {
    let mut text = "/* Generated from firmware-protocol/src/registers.rs; see SPEC.md. Do not edit.\n   *_PER_UNIT: raw steps in one SI unit. */\n#ifndef DRIVEBENCH_PROTOCOL_H\n#define DRIVEBENCH_PROTOCOL_H\n\n".to_owned();
    let mut define = |name: &str, value: String| {
        let name = name.to_uppercase().replace([' ', '-'], "_");
        writeln!(text, "#define DB_{name} {value}").expect("a string takes it");
    };
    define("PROTOCOL_VERSION", PROTOCOL_VERSION.to_string());
    define("MAGIC", format!("0x{MAGIC:04X}"));
    define("TELEMETRY_WORDS", TELEMETRY_WORDS.to_string());
    define("COMMAND_WORDS", COMMAND_WORDS.to_string());
    define("IDENTITY_WORDS", IDENTITY_WORDS.to_string());
    define("CAPTURE_WINDOW_SAMPLES", CAPTURE_WINDOW_SAMPLES.to_string());
    define("STREAM_MAX_FRAME", stream::MAX_FRAME.to_string());
    for register in REGISTERS {
        let name = format!("REG_{}", register.name);
        define(&name, register.address.to_string());
        if register.scale < 1.0 {
            let steps = (1.0 / register.scale).round();
            define(&format!("{name}_PER_UNIT"), steps.to_string());
        }
        if let Some(raw) = register.not_available() {
            // The smallest 32-bit number is no literal in C.
            define(
                &format!("{name}_NOT_AVAILABLE"),
                format!("({} - 1)", raw + 1),
            );
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
    for fault in Fault::ALL {
        define(&format!("FAULT_{}", fault.name()), fault.code().to_string());
    }
    for kind in MessageType::ALL {
        define(
            &format!("MESSAGE{}", words(&format!("{kind:?}"))),
            format!("0x{:02X}", kind.code()),
        );
    }
    for error in ErrorCode::ALL {
        define(
            &format!("ERROR{}", words(&format!("{error:?}"))),
            error.code().to_string(),
        );
    }
    text + "\n#endif\n"
}

/// `BadPayload` gives `_Bad_Payload`.
fn words(camel: &str) -> String {
    camel.chars().fold(String::new(), |text, letter| {
        let gap = if letter.is_uppercase() { "_" } else { "" };
        text + gap + letter.encode_utf8(&mut [0; 4])
    })
}

#[test]
fn no_name_of_the_c_header_is_defined_twice() {
    let text = header();
    let names: Vec<_> = text
        .lines()
        .filter_map(|line| line.strip_prefix("#define "))
        .filter_map(|line| line.split(' ').next())
        .collect();
    let unique: std::collections::HashSet<_> = names.iter().collect();
    assert_eq!(unique.len(), names.len());
    assert!(names.contains(&"DB_REG_SET_POINT_PER_UNIT"));
    assert!(names.contains(&"DB_ERROR_BAD_PAYLOAD"));
}
