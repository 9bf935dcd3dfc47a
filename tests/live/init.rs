//! `init` through the real binary: from nothing but profile, port and nameplate to a run.

use crate::kit::prelude::*;

const PLATE: &str = "bench-configs/motors/zk-22fc.toml";

fn plate() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(PLATE)
}

#[test]
fn our_own_drive_is_set_up_planned_and_run() {
    let desk = Desk::new();
    let (file, runs) = (desk.path("bench.toml"), desk.path("runs"));
    let options = "init --drive own --port sim: --motor {} --out {}";
    let done = call(options, &[&plate(), &file]).expect(0);
    assert!(done.stdout.is_empty(), "{}", done.stdout);
    // The next steps as they can be pasted.
    for next in ["plan", "run"] {
        let command = format!("drivebench {next} {}", file.display());
        has(&done.stderr, &[&command]);
    }
    let text = fs::read_to_string(&file).unwrap();
    has(
        &text,
        &[
            "smaller of 2.0 x rated current 5.7 A (nameplate) and the drive's own limit 11.4 A (read back)",
        ],
    );
    assert_eq!(json_of("plan {} --json", &[&file])["refusals"], json!([]));
    let run = "run {} --headless --json --emulator zk-22fc-plain --out {}";
    let found = json_of(run, &[&file, &runs]);
    assert_eq!(desk.manifest()["outcome"], "passed");
    for (key, truth) in [("resistance_ohm", 1.1), ("inertia_kg_m2", 0.0045)] {
        let value = parameter(&found, key).unwrap();
        assert!((value / truth - 1.0).abs() < 0.2, "{key} {value}");
    }
    let speed = "speed {} --headless --json --emulator zk-22fc-plain --out {}";
    call(speed, &[&file, &desk.path("loops")]).expect(0);
    // A second time there is a file.
    call(options, &[&plate(), &file]).fails(2, &["exists already"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
}

#[test]
fn limits_are_read_from_the_drive_and_only_offline_does_without() {
    let desk = Desk::new();
    let pty = desk.path("own.pty");
    let emulator = Emulator::start("emulate zk-22fc-plain --link modbus-rtu --pty {}", &[&pty]);
    let options = "init --drive own --port {} --motor {} --json";
    let made = json_of(options, &[&pty, &plate()]);
    assert_eq!(made["read_back"], true);
    let reason = |made: &Value, key: &str| {
        let values = made["values"].as_array().unwrap();
        let found = values.iter().find(|value| value["key"] == key).unwrap();
        found["reason"].as_str().unwrap().to_owned()
    };
    assert!(reason(&made, "limits.current_a").contains("11.4 A (read back)"));
    assert!(reason(&made, "limits.link_silence_s").contains("watchdog of 0.5 s (read back)"));
    assert!(reason(&made, "limits.bus_max_v").contains("(read back)"));
    // The file cannot exclude that it is the port of a real drive.
    let next = made["next"].as_array().unwrap();
    assert!(next.iter().any(|line| line.as_str().unwrap().ends_with("--hardware --headless")));
    // The file on stdout is a bench file.
    let text = call("init --drive own --port {} --motor {}", &[&pty, &plate()]);
    let bench = desk.put("bench.toml", &text.expect(0).stdout);
    call("plan {}", &[&bench]).expect(0);

    drop(emulator);
    let gone = call(options, &[&desk.path("none"), &plate()]).fails(3, &["--offline"]);
    assert!(gone.stdout.is_empty(), "{}", gone.stdout);
    let offline = "init --drive own --port {} --motor {} --offline --json";
    let made = json_of(offline, &[&pty, &plate()]);
    assert_eq!(made["read_back"], false);
    assert!(reason(&made, "limits.current_a").contains("not read back (--offline)"));
}

#[test]
fn a_wrong_drive_and_a_frequency_converter_are_refused() {
    let desk = Desk::new();
    let pty = desk.path("v20.pty");
    let _emulator = Emulator::start("emulate --profile siemens-v20 --pty {}", &[&pty]);
    let options = "init --drive own --port {} --motor {}";
    call(options, &[&pty, &plate()]).fails(3, &["drivebench probe"]);
    let options = "init --drive siemens-v20 --port {} --motor {}";
    call(options, &[&pty, &plate()]).fails(2, &["takes no armature voltage"]);
}

#[test]
fn a_wrong_plate_or_argument_is_named_and_nothing_written() {
    let desk = Desk::new();
    let file = desk.path("bench.toml");
    let zero = desk.put(
        "motor.toml",
        "name = \"x\"\nrated_voltage_v = 110.0\nrated_current_a = 0.0\nrated_speed_rad_s = 293.2\n",
    );
    let options = "init --drive own --port sim: --motor {} --out {}";
    call(options, &[&zero, &file]).fails(2, &["rated_current_a = 0 is not allowed"]);
    let typo = desk.put("typo.toml", "name = \"x\"\nrated_volts = 110.0\n");
    call(options, &[&typo, &file]).fails(2, &["typo.toml:2"]);
    for text in [
        "init --drive siemens-v30 --port sim: --motor {}",
        "init --drive own --port tcp:x --motor {}",
        "init --drive own --motor {}",
    ] {
        refusal(text, &[&plate()]);
    }
    assert!(!file.exists());
}

#[test]
fn without_a_screen_hardware_needs_its_option() {
    let desk = Desk::new();
    let (pty, runs) = (desk.path("epulse.pty"), desk.path("runs"));
    let _emulator = Emulator::start("emulate --profile epulse50-dc --pty {}", &[&pty]);
    let file = desk.path("bench.toml");
    let options = "init --drive epulse50-dc --port {} --motor {} --out {}";
    call(options, &[&pty, &plate(), &file]).expect(0);
    let run = "speed {} --headless --waive-watchdog --out {}";
    call(run, &[&file, &runs]).fails(3, &["pass --hardware"]);
    assert!(!runs.exists() || fs::read_dir(&runs).unwrap().next().is_none());
}
