//! `probe` through the real binary, against the software drive in the guise of every built-in profile in a process of
//! its own. What went over the wire is looked at in the capture: nothing is ever written.

use crate::kit::prelude::*;
use crate::witness::codec::framed;
use drivebench::drive::{DriveProfile, Protocol};

/// On a pseudo-terminal of the desk, as the profile.
fn emulator_of(desk: &Desk, profile: &str) -> Emulator {
    let pty = desk.path(format!("{}.pty", profile.replace('/', "-")));
    let is_modbus = |profile: DriveProfile| profile.link.protocol.is_modbus();
    // Registers can be served as RTU whatever the profile has; another language is its own.
    let link =
        if DriveProfile::named(profile).map_or(true, is_modbus) { "--link modbus-rtu" } else { "" };
    let text = format!("emulate zk-22fc-plain {link} --profile {{}} --pty {{}}");
    Emulator::start(&text, &[Path::new(profile), &pty])
}

fn probe(emulator: &Emulator, options: &str, paths: &[&Path]) -> Done {
    let mut arguments = line(&format!("probe {options}"), paths);
    arguments.extend(["--port", &emulator.port()].map(PathBuf::from));
    if !options.contains("--timeout-ms") {
        arguments.extend(["--timeout-ms", "5000"].map(PathBuf::from));
    }
    drivebench(arguments)
}

/// Function codes of the RTU frames of a capture, those of refusals without their mark. What was sent is always whole; a
/// reply may have come in pieces, and those are left out.
fn functions(file: &Path) -> Vec<u8> {
    let records = capture(file).1;
    let bodies = records.iter().filter_map(|frame| {
        let (body, _) = frame.split_last_chunk::<2>()?;
        (body.len() > 1 && framed(body) == *frame).then_some(body)
    });
    bodies.map(|body| body[1] & 0x7F).collect()
}

/// Nothing but reads, echoes and questions for names went over the wire.
#[track_caller]
fn is_read_only(tap: &Path) {
    let codes = functions(tap);
    let reads = |function: &u8| [3, 4, 8, 43].contains(function);
    assert!(codes.len() > 4 && codes.iter().all(reads), "{codes:?}");
}

/// The emulated supply.
#[track_caller]
fn is_120_v(reading: &Value) {
    assert!((reading["value"].as_f64().unwrap() - 120.0).abs() < 2.0, "{reading}");
}

fn signal<'a>(report: &'a Value, name: &str) -> &'a Value {
    report["signals"].as_array().unwrap().iter().find(|signal| signal["name"] == name).unwrap()
}

#[test]
fn every_profile_is_plausible_and_nothing_is_written() {
    let desk = Desk::new();
    let mapped = DriveProfile::names()
        .filter_map(|name| Some((name, DriveProfile::named(name).unwrap().registers?)));
    let mapped: Vec<_> = mapped.collect();
    assert!(mapped.len() >= 11, "{}", mapped.len());
    at_once(mapped, |(name, map)| {
        let emulator = emulator_of(&desk, name);
        let tap = desk.path(format!("{name}.pcap"));
        let options = format!("--drive {name} --json --tap {{}}");
        let report = probe(&emulator, &options, &[&tap]).expect(0).json();
        assert_eq!(report["verdict"], "plausible", "{name}");
        let signals = report["signals"].as_array().unwrap();
        assert_eq!(signals.len(), map.signals.len(), "{name}");
        for signal in signals {
            assert!(signal["value"].is_number(), "{name}: {signal}");
            assert_ne!(signal["plausible"], false, "{name}: {signal}");
            assert!(signal["candidates"].as_array().unwrap().is_empty());
        }
        if !map.protocol.is_modbus() {
            return moves_nothing(&tap, map.protocol);
        }
        let is_known = map.functions.contains(&43);
        let names = report["names"].as_array().unwrap();
        assert_eq!(names.contains(&Value::from("drivebench emulator")), is_known, "{name}");
        assert_eq!(report["answers_function_8"], map.functions.contains(&8), "{name}");
        is_read_only(&tap);
    });
}

/// In a capture of another language is no request that could move the motor.
fn moves_nothing(tap: &Path, protocol: Protocol) {
    let bytes = fs::read(tap).unwrap();
    let holds = |part: &[u8]| bytes.windows(part.len()).any(|window| window == part);
    let (requests, commands): (&[&[u8]], &[&[u8]]) = match protocol {
        // Selected values; a duty, a current.
        Protocol::Vesc => (&[&[2, 5, 50]], &[&[2, 5, 5], &[2, 5, 6]]),
        // Instruction 2 reads, 3 writes.
        Protocol::Dynamixel => {
            (&[&[0xFD, 0, 1, 7, 0, 2]], &[&[0xFD, 0, 1, 7, 0, 3], &[0xFD, 0, 1, 6, 0, 3]])
        }
        _ => {
            (&[b"test_property", b"?VAR"], &[b"v 0 ", b"requested_state ", b"!G 1", b"!EX", b"!MG"])
        }
    };
    assert!(requests.iter().any(|request| holds(request)), "{protocol}");
    for command in commands {
        assert!(!holds(command), "{protocol}: {command:?}");
    }
}

#[test]
fn an_address_base_that_is_off_by_one_is_named() {
    let desk = Desk::new();
    let emulator = emulator_of(&desk, "delta-ms300");
    let text = DriveProfile::text("delta-ms300").unwrap();
    let wrong = text.replace("address_base = 0", "address_base = 1");
    assert_ne!(wrong, text);
    let profile = desk.put("off-by-one.toml", &wrong);
    let tap = desk.path("wrong.pcap");
    // This drive is silent where it has no register: each of those is waited for in vain.
    let looked = "--drive {} --timeout-ms 300";
    let options = format!("{looked} --json --tap {{}}");
    let done = probe(&emulator, &options, &[&profile, &tap]).expect(1);
    let report = done.json();
    assert_eq!(report["verdict"], "implausible");
    let best = report["hypotheses"][0]["change"].as_str().unwrap();
    assert_eq!(best, "every address one higher (base 0 instead of 1)");
    assert_eq!(report["hypotheses"][0]["plausible"], report["hypotheses"][0]["judged"]);
    // The next register holds noise, which may pass for a small bus voltage when its bytes are exchanged.
    let bus = signal(&report, "bus");
    let candidates = bus["candidates"].as_array().unwrap();
    let higher = candidates
        .iter()
        .find(|candidate| candidate["change"].as_str().unwrap().contains("one higher"));
    is_120_v(higher.expect("the address that is one higher"));
    has(&done.error(), &["bus"]);
    is_read_only(&tap);
    let stdout = probe(&emulator, looked, &[&profile]).expect(1).stdout;
    has(
        &stdout,
        &[
            "with the address one higher (base 0 instead of 1) bus would be 1",
            "is the profile right?",
        ],
    );
}

#[test]
fn a_swapped_word_order_is_named_with_its_value() {
    let desk = Desk::new();
    let bus = |order: &str| {
        let text = DriveProfile::text("roboteq-dc").unwrap();
        let from = "[missing]";
        has(text, &[from]);
        text.replace(
            from,
            &format!(
                "[signals.bus]\ncan = [0x210D, 1]\ntype = \"i32\"\nword_order = \"{order}\"\nscale = 0.1\nunit = \"V\"\nquantity = \"bus_voltage\"\norigin = \"measured\"\npoll = \"fast\"\n\n[missing]"
            ),
        )
    };
    let right = desk.put("right.toml", &bus("high_first"));
    let wrong = desk.put("wrong.toml", &bus("low_first"));
    let emulator = emulator_of(&desk, right.to_str().unwrap());
    let report = probe(&emulator, "--drive {} --json", &[&right]).expect(0).json();
    assert_eq!(signal(&report, "bus")["confirms"], true);
    let report = probe(&emulator, "--drive {} --json", &[&wrong]).expect(1).json();
    let candidate = &signal(&report, "bus")["candidates"][0];
    assert_eq!(candidate["change"], "word_order = \"high_first\"");
    is_120_v(candidate);
    let stdout = probe(&emulator, "--drive {}", &[&wrong]).expect(1).stdout;
    has(
        &stdout,
        &[
            "with word_order = \"high_first\" bus would be 1",
            " V, plausible: is the profile right?",
        ],
    );
}

#[test]
fn our_own_drive_is_looked_at_over_every_link() {
    let desk = Desk::new();
    for (link, drive) in [("modbus-rtu", "own"), ("modbus-tcp", "own"), ("stream", "own-stream")] {
        let emulator = Emulator::on(link, &desk.path(link), "zk-22fc-plain", &[]);
        let report = probe(&emulator, &format!("--drive {drive} --json"), &[]).expect(0).json();
        assert_eq!(report["identity"]["is_emulator"], true, "{link}");
        assert_eq!(report["identity"]["current_limit_a"], 11.4, "{link}");
        assert_eq!(report["watchdog_s"], 0.5, "{link}");
        let bus = signal(&report, "bus_voltage");
        is_120_v(bus);
        assert_eq!(bus["raw"].is_null(), link == "stream", "{link}: {bus}");
        let text = probe(&emulator, &format!("--drive {drive}"), &[]).expect(0).stdout;
        has(&text, &["emulator", "bus_voltage"]);
    }
    let text = call("probe --port emulator --drive own", &[]).expect(0).stdout;
    has(&text, &["those of a drive at rest"]);
}

#[test]
fn without_a_drive_every_profile_is_tried() {
    let desk = Desk::new();
    let own = Emulator::start("emulate --link modbus-rtu --pty {}", &[&desk.path("own")]);
    let survey = probe(&own, "--json --timeout-ms 1500", &[]).expect(0).json();
    let tried = survey["profiles"].as_array().unwrap();
    assert_eq!(tried.len(), DriveProfile::names().count());
    assert_eq!((&tried[0]["profile"], &tried[0]["fit"]), (&"own".into(), &"matches".into()));
    let stream = tried.iter().find(|t| t["profile"] == "own-stream").unwrap();
    assert_eq!(stream["fit"], "not_tried");

    let v20 = emulator_of(&desk, "siemens-v20");
    let tap = desk.path("survey.pcap");
    let survey = probe(&v20, "--json --timeout-ms 1500 --tap {}", &[&tap]).expect(0).json();
    let tried = survey["profiles"].as_array().unwrap();
    let of = |name: &str| tried.iter().find(|t| t["profile"] == name).unwrap();
    assert_eq!(of("siemens-v20")["fit"], "cannot_be_told");
    assert_eq!(of("own")["fit"], "no");
    has(of("vacon10")["reason"].as_str().unwrap(), &["exception"]);
    is_read_only(&tap);
}

#[test]
fn silence_and_another_drive_are_exit_status_3() {
    let desk = Desk::new();
    let emulator = emulator_of(&desk, "siemens-v20");
    let another = probe(&emulator, "--drive own --json", &[]).expect(3);
    assert_eq!(another.json()["verdict"], "wrong_drive");
    has(&another.error(), &["register 64"]);
    let mut arguments = line("probe --drive siemens-v20 --unit 9 --timeout-ms 50 --port", &[]);
    arguments.push(PathBuf::from(&emulator.address));
    assert!(drivebench(arguments).fails(3, &["no reply within 50 ms"]).stdout.is_empty());
    call("probe --drive own --port /dev/drivebench-none", &[]).expect(3).error();
    refusals(
        "probe --drive own
         probe --port sim: --drive own
         probe --port emulator
         probe --port x --drive siemens-v30
         probe --port x --drive own --unit 0",
        &[],
    );
}
