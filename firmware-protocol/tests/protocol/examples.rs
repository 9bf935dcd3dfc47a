//! The worked examples of SPEC.md: committed vectors, taken apart field by field.

use std::fmt::Write as _;

use firmware_protocol::REGISTERS;
use firmware_protocol::registers::{COMMAND_ADDRESS, IDENTITY_ADDRESS, Register};
use firmware_protocol::stream::MessageType;

use crate::support::{committed, hex, unhex};

/// What a field is called, and its bytes.
type Field = (String, usize);

/// `(what the vector shows, fields of the request, fields of the answer)`.
pub(crate) fn modbus() -> String {
    let telemetry = |bytes: &[u8]| {
        let mut fields = named("unit 1|function 1|byte count 1");
        fields.extend(registers(0, &bytes[3..bytes.len() - 2]));
        fields.extend(named("CRC, low byte first 2"));
        fields
    };
    let command = |bytes: &[u8], before: &str, at: usize| {
        let mut fields = named(before);
        fields.extend(registers(COMMAND_ADDRESS, &bytes[at..bytes.len() - 2]));
        fields.extend(named("CRC 2"));
        fields
    };
    let mut text = String::new();
    let mut example =
        |shows: &str, ask: &dyn Fn(&[u8]) -> Vec<Field>, say: &dyn Fn(&[u8]) -> Vec<Field>| {
            let [request, response] = exchange(shows);
            let sides = [("host", &request, ask(&request)), ("drive", &response, say(&response))];
            writeln!(text, "{shows}:\n\n```text").expect("a string takes it");
            for (who, bytes, fields) in sides {
                take_apart(&mut text, who, bytes, &fields);
            }
            text += "```\n\n";
        };
    let fixed = |text: &'static str| move |_: &[u8]| named(text);
    example(
        "the telemetry block in one request",
        &fixed("unit 1|function 1|first address 2|registers 2|CRC, low byte first 2"),
        &telemetry,
    );
    example(
        "command 2: voltage 12.000 V",
        &|bytes| command(bytes, "unit 1|function 1|first address 2|registers 2|byte count 1", 7),
        &fixed("unit 1|function 1|first address 2|registers 2|CRC 2"),
    );
    example(
        "command 3: speed -10.000 rad/s, and the telemetry block",
        &|bytes| {
            let before =
                "unit 1|function 1|read from 2|registers 2|write to 2|registers 2|byte count 1";
            command(bytes, before, 11)
        },
        &telemetry,
    );
    let single = "unit 1|function 1|address 2|value 2|CRC 2";
    example("watchdog 100 ms", &fixed(single), &fixed(single));
    let refused = "unit 1|function + 128 1|exception 1|CRC 2";
    example("watchdog off is refused", &fixed(single), &fixed(refused));
    example(
        "move the window to sample 40 and read its count and first sample",
        &fixed(
            "unit 1|function 1|read from 2|registers 2|write to 2|registers 2|byte count 1|window_index 2|CRC 2",
        ),
        &fixed(
            "unit 1|function 1|byte count 1|window_count 2|window_voltage: not available 2|window_current 2|window_speed 2|CRC 2",
        ),
    );
    let echo = "unit 1|function 1|sub-function 2|data 2|CRC 2";
    example("echo", &fixed(echo), &fixed(echo));
    example(
        "device identification, object 1",
        &fixed("unit 1|function 1|MEI type 1|read code: one object 1|object 1|CRC 2"),
        &fixed(
            "unit 1|function 1|MEI type 1|read code 1|conformity 1|more follows: no 1|next object 1|objects 1|id 1|length 1|text 6|CRC 2",
        ),
    );
    text
}

/// Every frame of the vectors of the stream, one of each type.
pub(crate) fn stream() -> String {
    let vectors = committed("vectors/stream.txt");
    let mut text = String::new();
    let mut seen = Vec::new();
    let mut shows = "";
    for line in vectors.lines() {
        if let Some(comment) = line.strip_prefix("# ") {
            shows = comment;
            continue;
        }
        let wire = unhex(line);
        let Some(&kind) = wire.get(1) else { continue };
        // The first command with a set-point says more than the first command.
        let is_plain = kind == MessageType::Command.code() && !shows.contains("voltage");
        if is_plain || seen.contains(&kind) {
            continue;
        }
        seen.push(kind);
        let plain = unstuffed(&wire);
        let fields = stream_fields(kind, &plain);
        writeln!(text, "{shows}:\n\n```text\nwire   {}", hex(&wire)).expect("a string takes it");
        take_apart(&mut text, "frame", &plain, &fields);
        text += "```\n\n";
    }
    assert_eq!(seen.len(), MessageType::ALL.len(), "a message has no example");
    text
}

fn stream_fields(kind: u8, plain: &[u8]) -> Vec<Field> {
    let known = MessageType::from_code(kind).expect("the vectors hold known types");
    let mut fields = named("type 1|version 1|sequence number 2|drive time, us 4");
    fields[0].0 = format!("type: {known:?}");
    let payload = &plain[8..plain.len() - 2];
    match known {
        MessageType::Identity => fields.extend(registers(IDENTITY_ADDRESS, payload)),
        MessageType::Telemetry => fields.extend(named(
            "status 2|fault 2|sequence_echo 2|applied_time 4|voltage, 10 uV 4|current, 10 uA 4|speed, 20 urad/s 4|angle, 0.1 mrad 4|bus_voltage, 0.1 mV 4|temperature, 0.1 mC 4|voltage_command, 10 uV 4|telemetry_version 2",
        )),
        MessageType::Command => fields.extend(named("control 2|set_point, mV 4")),
        MessageType::SetWatchdog => fields.extend(named("watchdog, ms 2")),
        MessageType::CaptureArm => fields.extend(named("capture_control 2")),
        MessageType::CaptureStatus => {
            fields.extend(named("capture_state 2|capture_count 2|capture_time, us 4"));
        }
        MessageType::CaptureRequest => fields.extend(named("first sample wanted 2")),
        MessageType::CaptureBlock => fields.extend(named(
            "first sample 2|samples 1|voltage, 10 uV 4|current, 10 uA 4|speed, 20 urad/s 4|voltage: not available 4|current 4|speed 4",
        )),
        MessageType::Error => fields.extend(named("type of the question 1|error code 1")),
        MessageType::Hello | MessageType::TelemetryRequest | MessageType::CaptureStatusRequest => {}
    }
    fields.extend(named("CRC, high byte first 2"));
    fields
}

/// COBS undone, by the book.
fn unstuffed(wire: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    let mut rest = &wire[..wire.len() - 1];
    while let Some((&code, after)) = rest.split_first() {
        let (block, next) = after.split_at(usize::from(code) - 1);
        plain.extend(block);
        if code < 255 && !next.is_empty() {
            plain.push(0);
        }
        rest = next;
    }
    plain
}

/// `name bytes|name bytes`.
fn named(text: &str) -> Vec<Field> {
    text.split('|')
        .map(|field| {
            let (name, bytes) = field.rsplit_once(' ').expect("a name and its bytes");
            (name.to_owned(), bytes.parse().expect("a number of bytes"))
        })
        .collect()
}

/// Registers from `address` on with their values; the bytes end with a whole value.
fn registers(address: u16, bytes: &[u8]) -> Vec<Field> {
    let words = bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
    let block: Vec<u16> = words.collect();
    let end = address + u16::try_from(block.len()).expect("a short block");
    let inside = |register: &&Register| (address..end).contains(&register.address);
    REGISTERS
        .iter()
        .filter(inside)
        .map(|register| {
            let value = register.decode(register.get(&block, address));
            let name = format!("{} = {value} {}", register.name, register.unit);
            (name.trim_end().to_owned(), 2 * usize::from(register.kind.words()))
        })
        .collect()
}

fn take_apart(text: &mut String, who: &str, bytes: &[u8], fields: &[Field]) {
    let told: usize = fields.iter().map(|(_, bytes)| bytes).sum();
    assert_eq!(told, bytes.len(), "{who}: {}", hex(bytes));
    let (mut who, mut at) = (who, 0);
    for (name, count) in fields {
        writeln!(text, "{who:<6} {:<18} {name}", hex(&bytes[at..at + count]))
            .expect("a string takes it");
        (who, at) = ("", at + count);
    }
}

/// Request and response of the vector that shows this.
fn exchange(shows: &str) -> [Vec<u8>; 2] {
    let vectors = committed("vectors/modbus-rtu.txt");
    let mut lines = vectors.lines().skip_while(|line| line.strip_prefix("# ") != Some(shows));
    let mut side = |mark: &str| {
        lines.next();
        let mut here = lines.clone();
        unhex(here.next().and_then(|line| line.strip_prefix(mark)).expect(shows))
    };
    [side("> "), side("< ")]
}
