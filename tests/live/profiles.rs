//! Drives of other makes through the real binary: an emulator process answers as the drive over a real pseudo-terminal,
//! another process uses it with the profile.

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;

/// A bench whose motor is the emulated one, at a rate that a loaded machine keeps.
fn bench(desk: &Desk, profile: &str, rate_hz: u32, reference: &str) -> PathBuf {
    let bench = BenchFile {
        profile,
        link: format!("rate_hz = {rate_hz}.0\ndeadline_ms = 2000.0"),
        limits: "link_silence_s = 20.0\ntime_s = 60.0",
        speed: reference,
        sequence: "standstill = { seconds = 0.5 }\nsteps = { levels_v = [12.0, 0.0], hold_s = 1.5 }",
        ..BenchFile::short("")
    };
    desk.put("bench.toml", &bench.text())
}

const SPEED: &str = "[speed]\ncontroller = \"pi\"\ndrive_lag_s = 0.1\n\
                     [[speed.reference]]\nconstant = { speed_rad_s = 40.0, seconds = 2.0 }";

#[test]
fn a_frequency_converter_is_refused_before_anything_is_sent() {
    let desk = Desk::new();
    let pty = desk.path("v20.pty");
    let runs = desk.path("runs");
    let _emulator = Emulator::start("emulate --profile siemens-v20 --pty {}", &[&pty]);
    let bench = bench(&desk, "siemens-v20", 4, "");
    call("run {} --port {} --headless --hardware --out {}", &[&bench, &pty, &runs])
        .fails(2, &["takes no armature voltage", "docs/drives.md"]);
}

/// A profile of a user.
const FILE: &str = "roboteq-120v.toml";

/// A drive in a process of its own, the end of its ready line, and whether it follows a reference of speed; else it takes
/// voltages.
const DRIVES: [(&str, &str, bool); 5] = [
    ("epulse50-dc", "profile=epulse50-dc", true),
    ("odrive-0.5", "profile=odrive-0.5", true),
    ("vesc-dc", "unit=1 baud=115200 profile=vesc-dc", false),
    ("dynamixel-xm430", "unit=1 baud=57600 profile=dynamixel-xm430", false),
    (FILE, "profile=roboteq-dc", false),
];

/// In parallel, since they wait most of the time.
#[test]
fn drives_of_other_makes_run_in_real_time() {
    at_once(DRIVES, |(name, ready, is_followed)| {
        let desk = Desk::new();
        let (pty, runs) = (desk.path("drive.pty"), desk.out());
        let file = desk.put(FILE, &roboteq_of_120_v());
        let profile = if name == FILE { file.to_str().unwrap() } else { name };
        let text = format!("emulate zk-22fc-plain --profile {profile} --pty {{}}");
        let emulator = Emulator::start(&text, &[&pty]);
        assert!(emulator.ready.trim_end().ends_with(ready), "{name}: {}", emulator.ready);
        let (command, reference) = if is_followed { ("speed", SPEED) } else { ("run", "") };
        // Five drives and five programs share the processor.
        let bench = bench(&desk, profile, 8, reference);
        let text =
            format!("{command} {{}} --port {{}} --headless --hardware --waive-watchdog --out {{}}");
        let done = call(&text, &[&bench, &pty, &runs]).expect(0);
        let manifest = desk.manifest();
        assert_eq!(manifest["outcome"], "passed", "{name}");
        assert_eq!(manifest["wire"]["foreign_frames"], 0, "{name}");
        assert!(desk.read("samples.csv").lines().count() > 10, "{name}");
        if is_followed {
            assert_eq!(manifest["signals"]["speed_rad_s"], "measured", "{name}");
        }
        if name == "epulse50-dc" {
            has(&done.stderr, &["drive profile epulse50-dc", "trust manual"]);
            let configs = &manifest["configs"];
            has(word(configs, "/drive"), &["trust = \"manual\""]);
            has(word(configs, "/drive_provenance"), &["trust manual"]);
        }
    });
}

#[test]
fn our_emulator_with_another_profile_counts_as_emulator() {
    let desk = Desk::new();
    let bench = bench(&desk, "epulse50-dc", 20, SPEED);
    let text =
        "speed {} --port emulator --emulator zk-22fc-plain --headless --waive-watchdog --out {}";
    call(text, &[&bench, &desk.out()]).expect(0);
    assert_eq!(desk.manifest()["identity"]["is_emulator"], true);
}

/// The whole way of somebody with such a drive on the desk, in virtual time: the hidden Stribeck friction is named.
#[test]
fn a_vesc_and_a_dynamixel_are_commissioned() {
    for (profile, baud, rate_hz) in [
        ("vesc-dc", 115_200, 100.0),
        ("vesc-foc", 115_200, 100.0),
        ("dynamixel-xm430", 1_000_000, 100.0),
    ] {
        let desk = Desk::new();
        let (bench, runs) = (desk.path("bench.toml"), desk.path("runs"));
        let motor = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/motors/zk-22fc.toml");
        call(
            &format!("init --drive {profile} --port sim: --baud {baud} --motor {{}} --out {{}}"),
            &[&motor, &bench],
        )
        .expect(0);
        let text = fs::read_to_string(&bench).unwrap();
        let rate = text.lines().find(|line| line.starts_with("rate_hz = ")).unwrap();
        fs::write(&bench, text.replace(rate, &format!("rate_hz = {rate_hz:.1}"))).unwrap();
        let done = call("commission {} --headless --json --out {}", &[&bench, &runs]).expect(0);
        let found = done.json();
        assert_eq!(found["truth"]["named_correctly"], true, "{profile}: {}", found["sentence"]);
        let size = &found["truth"]["sizes"][0];
        assert!(size["error_percent"].as_f64().unwrap().abs() < 15.0, "{profile}: {size}");
    }
}

#[test]
fn an_unknown_command_of_a_drive_leads_to_its_setpoints() {
    let desk = Desk::new();
    let bench = bench(&desk, "epulse50-dc", 20, SPEED);
    call("speed {} --actuator voltage --headless", &[&bench])
        .fails(2, &["takes no voltage command", "[setpoints]"]);
}

/// The example of the manual page, as a file of a newcomer.
fn example(desk: &Desk) -> PathBuf {
    let (_, rest) = include_str!("../../docs/drives.md").split_once("```toml\n").unwrap();
    desk.put("acme-40.toml", rest.split_once("```").unwrap().0)
}

#[test]
fn the_example_is_plausible_at_its_own_emulator() {
    let desk = Desk::new();
    let profile = example(&desk);
    let done = call("probe --port emulator --drive {}", &[&profile]).expect(0);
    lacks(&done.stdout, &["FAILED"]);
}

#[test]
fn a_bench_beyond_its_profile_is_refused() {
    let desk = Desk::new();
    let text = include_str!("../../bench-configs/drives/own.toml");
    let profile = desk.put("small.toml", &text.replace("# current_a = 11.4", "current_a = 6.0"));
    let bench = BENCH.replace("\"own\"", &format!("{:?}", profile.to_str().unwrap()));
    let beyond = desk.put("beyond.toml", &bench);
    for command in ["plan {}", "run {} --port sim: --headless"] {
        let error = refusal(command, &[&beyond]);
        has(&error, &["limits.current_a = 13", "allows at most 6"]);
    }
    // Where the bench gives none, the profile's is the limit: the sequence would draw 6.7 A.
    let silent = desk.put("silent.toml", &bench.replace("current_a = 13.0", ""));
    let error = refusal("plan {}", &[&silent]);
    has(&error, &["plan refused", "limit 6"]);
}
