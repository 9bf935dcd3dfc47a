//! Every profile of the repository, and what is wrong in profiles.

use super::*;
use crate::drive::{DriveProfile, ProfileError, RegisterTable};
use crate::sample::Channel;

/// Names and texts of the profiles with a register map.
fn foreign() -> Vec<(&'static str, &'static str)> {
    let all = DriveProfile::names().map(|name| (name, DriveProfile::text(name).unwrap()));
    all.filter(|(name, _)| !name.starts_with("own")).collect()
}

fn map(name: &str) -> RegisterMap {
    RegisterMap::parse(name, DriveProfile::text(name).unwrap()).unwrap()
}

#[test]
fn all_eleven_are_there_under_their_names_with_source_and_trust() {
    let profiles = foreign();
    assert_eq!(profiles.len(), 11);
    for (name, _) in profiles {
        let profile = DriveProfile::named(name).unwrap();
        assert_eq!(profile.name, name);
        assert!(profile.registers.is_some(), "{name}");
        let line = profile.provenance();
        assert!(line.contains(profile.trust.name()), "{line}");
        assert!(profile.source.len() > 10, "{line}");
    }
    let doubtful = DriveProfile::named("vacon10").unwrap().provenance();
    assert!(
        doubtful.contains("trust code; unverified: control_word, speed_ref"),
        "{doubtful}"
    );
}

#[test]
fn limits_come_back_from_the_raw_type() {
    for (name, _) in foreign() {
        for point in map(name).set_points {
            let Some(limits) = point.limits else { continue };
            // A factor that the drive gives is that of its motor; any plausible one will do here.
            let factor = if point.numbers.scale_by.is_empty() {
                1.0
            } else {
                1500.0
            };
            for limit in limits {
                let raw = point.numbers.raw(limit, factor);
                let registers = point.location.layout.encode(raw).unwrap();
                let pattern = point.location.layout.pattern(&registers).unwrap();
                let back = point
                    .numbers
                    .value(point.location.layout.number(pattern), factor);
                let step = (point.numbers.scale * factor).abs();
                assert!(
                    (back - limit).abs() <= 0.5 * step + 1e-9,
                    "{name} {}: {limit} {back}",
                    point.name
                );
            }
        }
    }
}

#[test]
fn addresses_are_those_of_the_sources() {
    let wire = |name: &str, signal: &str| map(name).signal(signal).unwrap().location;
    assert_eq!(wire("siemens-v20", "speed").address, 24);
    assert_eq!(wire("abb-efb", "status").address, 3);
    assert_eq!(wire("abb-efb", "current").address, 106);
    assert_eq!(wire("abb-efb", "speed_scaling").address, 29_201);
    assert_eq!(wire("roboteq-dc", "current").address, 0x2001);
    assert_eq!(wire("roboteq-dc", "speed").table, RegisterTable::Input);
    assert_eq!(wire("vacon10", "torque").table, RegisterTable::Input);
    assert_eq!(wire("delta-ms300", "status").address, 0x2101);
    let v20 = map("siemens-v20");
    assert_eq!(v20.set_point("control_word").unwrap().location.address, 99);
    assert_eq!(
        map("roboteq-dc")
            .set_point("release")
            .unwrap()
            .location
            .address,
        0x01A0
    );
    assert_eq!(
        map("yaskawa-a1000")
            .set_point("control_word")
            .unwrap()
            .function,
        16
    );
    assert_eq!(
        map("toshiba-vfs11")
            .set_point("control_word")
            .unwrap()
            .function,
        6
    );
}

#[test]
fn every_required_channel_is_mapped_or_missing_with_a_reason() {
    for (name, _) in foreign() {
        let map = map(name);
        for channel in RegisterMap::REQUIRED {
            let mapped = map.of_channel(channel).is_some();
            let missing = map
                .missing
                .get(channel.key())
                .is_some_and(|why| why.len() > 10);
            assert!(mapped != missing, "{name} {}", channel.key());
        }
    }
    assert!(map("siemens-v20").of_channel(Channel::Torque).is_some());
}

#[test]
fn reads_keep_to_the_limits_of_the_drive_and_serve_every_signal() {
    for (name, _) in foreign() {
        let map = map(name);
        for poll in [PollRate::Fast, PollRate::Slow, PollRate::Once] {
            let mut served = 0;
            for block in plan_reads(&map, poll) {
                assert!(
                    (1..=map.max_read).contains(&block.count),
                    "{name} {block:?}"
                );
                served += block.signals.len();
            }
            assert_eq!(
                served,
                map.signals.iter().filter(|s| s.poll == poll).count(),
                "{name}"
            );
        }
    }
    let fast = |name| plan_reads(&map(name), PollRate::Fast).len();
    assert_eq!(fast("vacon10"), 1, "eleven registers in one read");
    assert_eq!(fast("toshiba-vfs11"), 2, "one register a request");
    assert_eq!(fast("roboteq-dc"), 3);
    assert_eq!(fast("delta-ms300"), 1);
}

#[test]
fn a_block_of_exact_length_is_read_as_a_whole_and_its_bytes_apart() {
    let text = DriveProfile::text("delta-ms300")
        .unwrap()
        .replace("max_hole = 1", "max_hole = 1\nexact_reads = [[0x0018, 6]]")
        + "
[signals.load]
address = 0x0018
type = \"u16\"
byte = \"high\"
unit = \"%\"
quantity = \"other\"
poll = \"fast\"

[signals.drive_status]
address = 0x0018
type = \"u16\"
byte = \"low\"
quantity = \"status\"
poll = \"fast\"
";
    let map = RegisterMap::parse("lenze", &text).unwrap();
    let blocks = plan_reads(&map, PollRate::Fast);
    assert_eq!(blocks.len(), 2);
    assert_eq!(
        (blocks[0].address, blocks[0].count, blocks[0].signals.len()),
        (0x18, 6, 2)
    );
}

/// The error of a profile in which something was exchanged, with what stands at its place.
fn wrong(name: &str, from: &str, to: &str) -> (String, String) {
    let text = DriveProfile::text(name).unwrap();
    assert!(text.contains(from), "{from}");
    let text = text.replacen(from, to, 1);
    let Err(ProfileError::Text(error)) = DriveProfile::parse("x.toml", &text) else {
        panic!("{to} was taken");
    };
    let line = text.lines().nth(error.line - 1).unwrap_or_default();
    let rest: String = line.chars().skip(error.column - 1).collect();
    (format!("{} | {}", error.message, error.help), rest)
}

/// Profile, what is exchanged, the message or its help, and what stands at the place of the error.
const DEFECTS: [(&str, &str, &str, &str, &str); 32] = [
    (
        "siemens-v20",
        "limits = [0, 100]",
        "limits = [5, 100]",
        "0 within for what moves the motor",
        "limits",
    ),
    (
        "siemens-v20",
        "poll = \"fast\"",
        "polls = \"fast\"",
        "did you mean `poll`?",
        "polls",
    ),
    (
        "siemens-v20",
        "address = 40025",
        "adress = 40025",
        "did you mean `address`?",
        "adress",
    ),
    (
        "siemens-v20",
        "max_hole",
        "max_holes",
        "did you mean `max_hole`?",
        "max_holes",
    ),
    (
        "siemens-v20",
        "address = 40025",
        "address = 50025",
        "address 50025 is not allowed",
        "address = 50025",
    ),
    (
        "siemens-v20",
        "limits = [0, 100]",
        "limits = [0, 100000]",
        "that the raw type holds",
        "limits = [0, 100000]",
    ),
    (
        "siemens-v20",
        "{ write = \"control_word\"",
        "{ write = \"control_wrd\"",
        "did you mean `control_word`?",
        "control_wrd",
    ),
    (
        "siemens-v20",
        "wait = \"status\"",
        "wait = \"staus\"",
        "did you mean `status`?",
        "staus",
    ),
    (
        "siemens-v20",
        "voltage_v =",
        "voltage_vv =",
        "did you mean `voltage_v`?",
        "voltage_vv",
    ),
    (
        "siemens-v20",
        "quantity = \"torque\"",
        "quantity = \"torqe\"",
        "did you mean `torque`?",
        "\"torqe\"",
    ),
    (
        "siemens-v20",
        "resync = \"length\"",
        "resync = \"fc08\"",
        "needs function code 8",
        "resync",
    ),
    (
        "siemens-v20",
        "origin = \"measured\"",
        "signed = false",
        "origin is missing",
        "quantity",
    ),
    (
        "toshiba-vfs11",
        "scale_by = [\"rated_current\"]",
        "scale_by = [\"rated_curent\"]",
        "did you mean `rated_current`?",
        "rated_curent",
    ),
    (
        "toshiba-vfs11",
        "functions = [3, 6]",
        "functions = [3, 16]\nmax_holes = 1",
        "did you mean `max_hole`?",
        "max_holes",
    ),
    (
        "yaskawa-a1000",
        "address = 0x0001\n",
        "address = 0x0001\nfunction = 6\n",
        "does not know function code 6",
        "function = 6",
    ),
    (
        "roboteq-dc",
        "max_write = 2",
        "max_write = 1",
        "has 2 registers, and max_write is 1",
        "type",
    ),
    (
        "delta-ms300",
        "mask = 0x00FF, not_equals = 0",
        "mask = 0x00FF, not_equals = 0x100",
        "outside of the mask",
        "mask",
    ),
    (
        "delta-ms300",
        "refresh_ms = 200.0",
        "refresh_ms = 200.0\nnvm = true",
        "must not be refreshed",
        "refresh_ms",
    ),
    (
        "abb-dcs-gateway",
        "quadrants = 4",
        "quadrants = 3",
        "quadrants 3 is not allowed",
        "quadrants",
    ),
    ("epulse50-dc", "unit = 1\n", "unit = 300\n", "", "300"),
    (
        "epulse50-dc",
        "{ write = \"speed_ref\", value = 0 }",
        "{ write = \"speed_ref\", value = 900 }",
        "value 900 rpm would move the motor: speed_ref is a speed (expected 0;",
        "value = 900",
    ),
    (
        "roboteq-dc",
        "reset = [{ write = \"power_ref\", value = 0 }",
        "reset = [{ write = \"power_ref\", value = -1 }",
        "value -1 % would move the motor",
        "value = -1",
    ),
    (
        "epulse50-dc",
        "unit = \"rpm\"",
        "unit = \"V\"",
        "unit \"V\" does not fit quantity \"shaft_speed\" (expected rpm, rad/s, Hz, counts/s or %)",
        "unit = \"V\"",
    ),
    (
        "epulse50-dc",
        "unit = \"rpm\"\nquantity = \"speed\"",
        "unit = \"A\"\nquantity = \"speed\"",
        "setpoint speed_ref: unit \"A\" does not fit quantity \"speed\"",
        "unit = \"A\"",
    ),
    (
        "epulse50-dc",
        "unit = \"A\"\n",
        "",
        "quantity \"current\" needs a unit (expected A or %)",
        "quantity = \"current\"",
    ),
    (
        "epulse50-dc",
        "quantity = \"shaft_speed\"",
        "quantity = \"speed\"",
        "expected \"shaft_speed\" with a sensor on the shaft",
        "quantity = \"speed\"",
    ),
    (
        "epulse50-dc",
        "quantity = \"speed\"",
        "quantity = \"shaft_speed\"",
        "is one of signals (expected \"speed\")",
        "quantity = \"shaft_speed\"",
    ),
    (
        "epulse50-dc",
        "unit = \"rpm\"\nquantity = \"shaft_speed\"",
        "unit = \"Hz\"\nquantity = \"shaft_speed\"",
        "in Hz without pole_pairs it is no speed_rad_s",
        "unit = \"Hz\"",
    ),
    (
        "siemens-v20",
        "set_ms = 1000.0",
        "set_ms = 100000.0",
        "set_ms 100000 is not allowed (expected 1 to 65535, which the register takes in steps of 1 ms)",
        "set_ms",
    ),
    (
        "siemens-v20",
        "unit_ms = 1.0",
        "unit_ms = 1.0, range_ms = [50, 900]",
        "set_ms 1000 is not allowed (expected 50 to 900",
        "set_ms",
    ),
    (
        "siemens-v20",
        "\nreset = [",
        "\nquickstop = [",
        "the command reset is missing: without it no fault can be cleared over the bus",
        "[commands]",
    ),
    (
        "siemens-v20",
        "\ncoast = [",
        "\nquickstop = [",
        "the command coast is missing: it is tried where stop fails",
        "[commands]",
    ),
];

#[test]
fn defects_are_named_with_their_place_and_the_nearest_key() {
    let mut surprises = Vec::new();
    for (name, from, to, message, place) in DEFECTS {
        let (told, at) = wrong(name, from, to);
        if !told.contains(message) || !at.starts_with(place) {
            surprises.push(format!("{to}: {told} stands at {at:?}"));
        }
    }
    assert!(surprises.is_empty(), "{}", surprises.join("\n"));
}

#[test]
fn what_is_neither_mapped_nor_missing_is_an_error() {
    let (told, _) = wrong(
        "siemens-v20",
        "voltage_v = \"the output",
        "temperature_c = \"the output",
    );
    assert!(
        told.contains("voltage_v is neither mapped nor declared missing"),
        "{told}"
    );
    let (told, _) = wrong("siemens-v20", "running = {", "sto = {");
    assert!(told.contains("state running is neither"), "{told}");
}

#[test]
fn a_command_that_a_drive_does_not_have_may_be_declared_empty() {
    let text = DriveProfile::text("siemens-v20").unwrap();
    let (before, rest) = text.split_once("\ncoast = [").unwrap();
    let (_, after) = rest.split_once('\n').unwrap();
    let map = RegisterMap::parse("x", &format!("{before}\ncoast = []\n{after}")).unwrap();
    assert!(map.commands.coast.is_empty() && !map.commands.reset.is_empty());
}

#[test]
fn the_example_of_the_manual_page_is_a_profile() {
    let page = include_str!("../../../docs/adding-a-drive.md");
    let (_, rest) = page.split_once("```toml\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let profile = DriveProfile::parse("acme-40.toml", example).unwrap();
    assert_eq!(profile.name, "acme-40");
    assert!(profile.capabilities.speed_command);
    let map = profile.registers.unwrap();
    assert_eq!(plan_reads(&map, PollRate::Fast).len(), 1);
    assert_eq!(map.watchdog.set_s, Some(0.5));
}
