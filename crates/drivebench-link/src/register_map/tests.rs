//! Every profile of the repository, and what is wrong in profiles.

use std::collections::BTreeMap;

use super::*;
use crate::{CellTable, DriveProfile, ProfileError, ReadRequest};

fn foreign() -> Vec<(&'static str, &'static str)> {
    let all = DriveProfile::names().map(|name| (name, DriveProfile::text(name).unwrap()));
    all.filter(|(name, _)| !name.starts_with("own")).collect()
}

fn map(name: &str) -> RegisterMap {
    RegisterMap::parse(name, DriveProfile::text(name).unwrap()).unwrap()
}

#[test]
fn each_has_name_source_and_trust() {
    let profiles = foreign();
    assert_eq!(profiles.len(), 18);
    for (name, _) in profiles {
        let profile = DriveProfile::named(name).unwrap();
        assert_eq!(profile.name, name);
        assert!(profile.registers.is_some(), "{name}");
        let line = profile.provenance();
        assert!(line.contains(profile.trust.name()), "{line}");
        assert!(profile.source.len() > 10, "{line}");
    }
    let doubtful = DriveProfile::named("vacon10").unwrap().provenance();
    assert!(doubtful.contains("trust code; unverified: control_word, speed_ref"), "{doubtful}");
}

#[test]
fn a_vesc_runs_until_its_time_out_and_while_a_current_flows() {
    for (name, signal, limit) in
        [("vesc-dc", "motor_current", "current_limit"), ("vesc-foc", "iq", "phase_current_limit")]
    {
        let map = map(name);
        let runs = |status, amps: Option<f64>| {
            let value =
                |asked: &str| if asked == signal { amps } else { (asked == limit).then_some(60.0) };
            map.state("running").unwrap().holds_by(status, value)
        };
        for (status, amps, expected) in [
            (Some(0), Some(0.0), Some(true)),
            (Some(1), Some(0.9), Some(false)),
            (Some(1), Some(-1.3), Some(true)),
            (Some(0), None, Some(true)),
            (Some(1), None, None),
            (None, Some(0.0), None),
        ] {
            assert_eq!(runs(status, amps), expected, "{name} {status:?} {amps:?}");
        }
    }
}

#[test]
fn addresses_are_those_of_the_sources() {
    for (name, signal, address) in [
        ("siemens-v20", "speed", 24),
        ("abb-efb", "status", 3),
        ("abb-efb", "current", 106),
        ("abb-efb", "speed_scaling", 29_201),
        ("roboteq-dc", "current", 0x2001),
        ("delta-ms300", "status", 0x2101),
    ] {
        assert_eq!(map(name).signal(signal).unwrap().location.address, address, "{name} {signal}");
    }
    for (name, signal) in [("roboteq-dc", "speed"), ("vacon10", "torque")] {
        let table = map(name).signal(signal).unwrap().location.table;
        assert_eq!(table, CellTable::Input, "{name} {signal}");
    }
    for (name, point, address, function) in [
        ("siemens-v20", "control_word", Some(99), None),
        ("roboteq-dc", "release", Some(0x01A0), None),
        ("yaskawa-a1000", "control_word", None, Some(16)),
        ("toshiba-vfs11", "control_word", None, Some(6)),
    ] {
        let map = map(name);
        let found = map.set_point(point).unwrap();
        let is_there = address.is_none_or(|address| found.location.address == address);
        let is_asked = function.is_none_or(|function| found.function == function);
        assert!(is_there && is_asked, "{name} {point}: {found:?}");
    }
}

#[test]
fn reads_keep_the_drives_limits_and_serve_every_signal() {
    for (name, _) in foreign() {
        let map = map(name);
        for poll in [PollRate::Fast, PollRate::Slow, PollRate::Once] {
            let mut served = 0;
            for block in plan_reads(&map, poll) {
                // Lines are bounded by nothing but their number.
                let is_text = matches!(block.read.table, CellTable::Lines(_));
                let fits = is_text || (1..=map.max_read).contains(&block.read.count);
                assert!(fits, "{name} {block:?}");
                served += block.signals.len();
            }
            let read = map.signals.iter().filter(|signal| signal.formula.is_none());
            assert_eq!(served, read.filter(|signal| signal.keys.poll == poll).count(), "{name}");
        }
    }
    // Eleven registers in one read; one register a request.
    for (name, reads) in [
        ("vacon10", 1),
        ("toshiba-vfs11", 2),
        ("roboteq-dc", 3),
        ("delta-ms300", 1),
        ("dynamixel-xm430", 1),
        ("vesc-dc", 1),
    ] {
        assert_eq!(plan_reads(&map(name), PollRate::Fast).len(), reads, "{name}");
    }
}

#[test]
fn the_place_of_a_value_follows_the_firmware_or_is_none() {
    let map = map("vesc-foc");
    let at = |name: &str, raw: Option<u32>| {
        let place = map.signal(name).unwrap().placed(|by| raw.filter(|_| by == "signature"));
        place.map(|place| place.address)
    };
    // 5.03, 6.00, 7.01, and a firmware of which no place is known.
    for (raw, places) in [
        (Some(2_525_666_056), [Some(181), Some(189), Some(193)]),
        (Some(776_184_161), [Some(161), Some(169), Some(173)]),
        (Some(2_466_726_157), [Some(158), Some(166), Some(170)]),
        (Some(3_698_540_221), [None; 3]),
        (None, [None; 3]),
    ] {
        let found = ["inductance", "resistance", "back_emf"];
        assert_eq!(found.map(|name| at(name, raw)), places, "{raw:?}");
    }
    assert_eq!(at("phase_current_limit", None), Some(8));
    // Read last, wherever they lie: their scale has the pole pairs.
    let last = plan_reads(&map, PollRate::Once).pop().unwrap();
    assert_eq!((last.signals.len(), last.read.address, last.read.end()), (3, 157, 197));
}

#[test]
fn a_block_of_exact_length_is_read_whole() {
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
    let blocks = plan_reads(&RegisterMap::parse("lenze", &text).unwrap(), PollRate::Fast);
    assert_eq!(blocks.len(), 2);
    assert_eq!(blocks[0].read, ReadRequest::holding(0x18, 6));
    assert_eq!(blocks[0].signals.len(), 2);
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

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Defect {
    profile: String,
    from: String,
    to: String,
    message: String,
    place: String,
}

#[test]
fn defects_are_named_with_place_and_nearest_key() {
    let text = include_str!("defects.toml");
    let mut defects: BTreeMap<String, Vec<Defect>> = toml::from_str(text).unwrap();
    let defects = defects.remove("defect").unwrap();
    assert_eq!(defects.len(), 56);
    let mut surprises = Vec::new();
    for defect in defects {
        let (error, at) = wrong(&defect.profile, &defect.from, &defect.to);
        if !error.contains(&defect.message) || !at.starts_with(&defect.place) {
            surprises.push(format!("{}: {error} stands at {at:?}", defect.to));
        }
    }
    assert!(surprises.is_empty(), "{}", surprises.join("\n"));
}

#[test]
fn a_missing_command_may_be_declared_empty() {
    let text = DriveProfile::text("siemens-v20").unwrap();
    let (before, rest) = text.split_once("\ncoast = [").unwrap();
    let (_, after) = rest.split_once('\n').unwrap();
    let map = RegisterMap::parse("x", &format!("{before}\ncoast = []\n{after}")).unwrap();
    assert!(map.commands.coast.is_empty() && !map.commands.reset.is_empty());
}
