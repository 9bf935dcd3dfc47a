//! A profile is tried without its drive: the emulated one answers by the file, and errors lead back to its lines.

use super::*;

fn acme() -> String {
    let (_, rest) = include_str!("../../../../../docs/drives.md").split_once("```toml\n").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

fn acme_with(changes: Changes<'_>) -> DriveProfile {
    DriveProfile::parse("acme-40.toml", &changed(&acme(), changes)).unwrap()
}

/// One that the host has identified.
fn acme_table(changes: Changes<'_>) -> Table {
    Table::of(&acme_with(changes), None).known()
}

const READY_FIRST: (&str, &str) =
    ("  { write = \"control_word\", value = 0x0006 },\n  { wait", "  { wait");
const NO_RUNNING_WAIT: (&str, &str) = (
    "  { wait = \"status\", mask = 0x0004, equals = 0x0004, within_ms = 2000, error = \"operation not enabled\" },\n",
    "",
);

#[test]
fn the_example_and_its_variants_are_enabled_and_stopped() {
    for changes in [&[][..], &[READY_FIRST], &[NO_RUNNING_WAIT]] {
        let mut table = acme_table(changes);
        table.enable(speed_ref(0.0));
        table.link.stop().unwrap();
        assert!(!table.far().is_running());
    }
}

#[test]
fn every_kind_of_identity_is_answered_by_the_emulated_drive() {
    let model = "[signals.model]";
    for (test, quantity) in [
        ("equals = 0x0200", "other"),
        ("mask = 0xFF00\nequals = 0x0200", "other"),
        ("one_of = [7, 9]", "other"),
        ("within = [3.0, 5.0]", "other"),
        ("equals = 0x0031", "fault_code"),
        ("mask = 0xF000\nequals = 0x2000", "status"),
        ("within = [512, 600]", "status"),
    ] {
        let signal = format!(
            "[[identity]]\nsignal = \"revision\"\n{test}\n\n[signals.revision]\naddress = 40030\ntype = \"u16\"\nquantity = \"{quantity}\"\npoll = \"once\"\n\n{model}",
        );
        if let Err(error) = Table::of(&acme_with(&[(model, &signal)]), None).link.identify() {
            panic!("{test} {quantity}: {error}");
        }
    }
}

#[test]
fn a_factor_of_the_identity_scales_the_other_signals() {
    let identity = "\n[[identity]]\nsignal = \"speed_scaling\"\nwithin = [500, 2000]\n\n[rates]";
    let mut table = Table::identified("abb-efb", &[("\n[rates]", identity)]);
    assert_eq!(table.link.reading("speed_scaling"), Some(1250.0));
    let speed = table.drive(speed_ref(900.0), 6.0).get(Channel::Speed).unwrap();
    let off = speed - drivebench_model::units::rad_s_from_rpm(900.0);
    assert!(off.abs() < 6.0, "{speed}");
}

#[test]
fn an_object_of_the_identity_is_reported_beside_software() {
    let profile = acme_with(&[
        ("functions = [3, 6, 16]", "functions = [3, 6, 16, 43]"),
        (
            "[setpoints.control_word]",
            "[[identity]]\nobject = 0\ncontains = \"ACME\"\n\n[[identity]]\nobject = 4\ncontains = \"A40\"\n\n[setpoints.control_word]",
        ),
    ]);
    let identity = Table::of(&profile, None).link.identify().unwrap();
    assert_eq!(identity.vendor, "drivebench emulator, ACME");
}

#[test]
fn a_drive_at_rest_does_not_show_that_it_runs() {
    let [ready, running] = ["0x0001", "0x0004"].map(|bit| format!("mask = {bit}, equals = {bit}"));
    let error = acme_table(&[READY_FIRST, (&ready, &running)]).first_error(None);
    assert_contains(&error, "enable, step 1 of 3: not ready");
    assert_contains(&error, "status is 0x0000 after 1 s (expected 0x0004 under mask 0x0004");
    // That of the first wait of the enable command.
    let text = changed(&acme(), &[READY_FIRST]);
    let line = text.lines().position(|line| line.contains("wait = \"status\", mask"));
    let line = 1 + line.unwrap();
    assert_contains(&error, &format!("line {line} of the profile"));
}

#[test]
fn a_drive_that_never_runs_names_condition_and_status() {
    let far = acme_with(&[NO_RUNNING_WAIT]);
    let host = acme_with(&[
        NO_RUNNING_WAIT,
        (
            "running = { signal = \"status\", mask = 0x0004, equals = 0x0004 }",
            "running = { signal = \"status\", mask = 0x0100, equals = 0x0100 }",
        ),
    ]);
    let mut table = Table::mixed(&host, &far, None).known();
    assert_contains(
        &table.first_error(None),
        "the drive does not run after it: status is 0x0005 where [state] running is looked for (expected 0x0100 under mask 0x0100",
    );
    // It did run, and was stopped.
    let _ = table.link.stop();
    assert!(!table.far().is_running());
}

#[test]
fn a_trip_while_enabling_is_reported_as_a_fault() {
    let mut table = acme_table(&[]);
    table.run(None).unwrap();
    table.far().trip();
    let error = table.first_error(None);
    assert_contains(&error, "it is in fault: status is 0x0008");
    assert_contains(&error, "which may be the cause");
}
