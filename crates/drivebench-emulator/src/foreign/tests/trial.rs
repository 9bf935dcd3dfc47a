//! A profile is tried without its drive: the emulated one answers by the file, and errors lead back to its lines.

use super::*;

fn acme() -> String {
    let page = include_str!("../../../../../docs/drives.md");
    let (_, rest) = page.split_once("```toml\n").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

fn acme_with(changes: Changes<'_>) -> DriveProfile {
    DriveProfile::parse("acme-40.toml", &changed(&acme(), changes)).unwrap()
}

/// One that the host has identified.
fn acme_table(changes: Changes<'_>) -> Table {
    Table::of(&acme_with(changes), None).known()
}

const READY_FIRST: (&str, &str) = (
    "  { write = \"control_word\", value = 0x0006 },\n  { wait",
    "  { wait",
);
const NO_RUNNING_WAIT: (&str, &str) = (
    "  { wait = \"status\", mask = 0x0004, equals = 0x0004, within_ms = 2000, error = \"operation not enabled\" },\n",
    "",
);

#[test]
fn the_example_with_its_identity_is_identified_enabled_and_stopped() {
    let mut table = Table::of(&acme_with(&[]), None);
    let identity = table.link.identify().unwrap();
    assert!(identity.is_emulator);
    table.enable(speed_ref(0.0));
    table.link.stop().unwrap();
    assert!(!table.far().is_running());
}

#[test]
fn every_kind_of_identity_is_answered_by_the_emulated_drive() {
    let model = "[signals.model]";
    for (identity, quantity) in [
        ("equals = 0x0200", "other"),
        ("mask = 0xFF00, equals = 0x0200", "other"),
        ("one_of = [7, 9]", "other"),
        ("within = [3.0, 5.0]", "other"),
        ("equals = 0x0031", "fault_code"),
        ("mask = 0xF000, equals = 0x2000", "status"),
        ("within = [512, 600]", "status"),
    ] {
        let signal = format!(
            "[[identity]]\nsignal = \"revision\"\n{}\n\n[signals.revision]\naddress = 40030\ntype = \"u16\"\nquantity = \"{quantity}\"\npoll = \"once\"\n\n{model}",
            identity.replace(", ", "\n")
        );
        let signal = signal.replace("[3.0\n5.0]", "[3.0, 5.0]");
        let signal = signal.replace("[7\n9]", "[7, 9]");
        let signal = signal.replace("[512\n600]", "[512, 600]");
        let profile = acme_with(&[(model, &signal)]);
        let mut table = Table::of(&profile, None);
        if let Err(error) = table.link.identify() {
            panic!("{identity} {quantity}: {error}");
        }
    }
}

#[test]
fn a_factor_that_the_identity_asks_for_is_the_one_that_others_are_scaled_with() {
    let identity = "\n[[identity]]\nsignal = \"speed_scaling\"\nwithin = [500, 2000]\n\n[rates]";
    let mut table = Table::identified("abb-efb", &[("\n[rates]", identity)]);
    assert_eq!(table.link.reading("speed_scaling"), Some(1250.0));
    let sample = table.drive(speed_ref(900.0), 6.0);
    let speed = sample.get(Channel::Speed).unwrap();
    let off = speed - drivebench_model::units::rad_s_from_rpm(900.0);
    assert!(off.abs() < 6.0, "{speed}");
}

#[test]
fn an_object_that_the_identity_asks_for_is_told_beside_that_it_is_software() {
    let profile = acme_with(&[
        ("functions = [3, 6, 16]", "functions = [3, 6, 16, 43]"),
        (
            "[setpoints.control_word]",
            "[[identity]]\nobject = 0\ncontains = \"ACME\"\n\n[[identity]]\nobject = 4\ncontains = \"A40\"\n\n[setpoints.control_word]",
        ),
    ]);
    let mut table = Table::of(&profile, None);
    let identity = table.link.identify().unwrap();
    assert_eq!(identity.vendor, "drivebench emulator, ACME");
}

#[test]
fn a_wait_before_the_first_word_is_fulfilled_by_a_drive_at_rest() {
    let mut table = acme_table(&[READY_FIRST]);
    table.enable(speed_ref(0.0));
}

#[test]
fn a_drive_at_rest_does_not_show_that_it_runs() {
    let [ready, running] = ["0x0001", "0x0004"].map(|bit| format!("mask = {bit}, equals = {bit}"));
    let error = acme_table(&[READY_FIRST, (&ready, &running)]).first_error(None);
    assert_says(&error, "enable, step 1 of 3: not ready");
    assert_says(
        &error,
        "status is 0x0000 after 1 s (expected 0x0004 under mask 0x0004",
    );
    // That of the first wait of the enable command.
    let text = changed(&acme(), &[READY_FIRST]);
    let mut lines = text.lines();
    let line = lines.position(|line| line.contains("wait = \"status\", mask"));
    let line = 1 + line.unwrap();
    assert_says(&error, &format!("line {line} of the profile"));
}

#[test]
fn an_enable_command_without_a_wait_for_running_is_enough_for_the_emulated_drive() {
    let mut table = acme_table(&[NO_RUNNING_WAIT]);
    table.enable(speed_ref(0.0));
}

#[test]
fn a_drive_that_does_not_run_after_its_enable_command_names_condition_and_word() {
    let far = acme_with(&[NO_RUNNING_WAIT]);
    let host = acme_with(&[
        NO_RUNNING_WAIT,
        (
            "running = { signal = \"status\", mask = 0x0004, equals = 0x0004 }",
            "running = { signal = \"status\", mask = 0x0100, equals = 0x0100 }",
        ),
    ]);
    let mut table = Table::mixed(&host, &far, None).known();
    assert_says(
        &table.first_error(None),
        "the drive does not run after it: status is 0x0005 where [state] running is looked for (expected 0x0100 under mask 0x0100",
    );
    // It did run, and was told to stop.
    let _ = table.link.stop();
    assert!(!table.far().is_running());
}

#[test]
fn a_drive_that_trips_while_it_is_enabled_is_said_to_be_in_fault() {
    let mut table = acme_table(&[]);
    table.run(None).unwrap();
    table.far().trip();
    let error = table.first_error(None);
    assert_says(&error, "it is in fault: status is 0x0008");
    assert_says(&error, "which may be the cause");
}
