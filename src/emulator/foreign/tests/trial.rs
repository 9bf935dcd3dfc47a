//! A profile is tried without its drive: the emulated one answers by the file, and errors lead back to its lines.

use super::*;

fn acme() -> String {
    let page = include_str!("../../../../docs/adding-a-drive.md");
    let (_, rest) = page.split_once("```toml\n").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

fn acme_with(changes: &[(&str, &str)]) -> DriveProfile {
    let mut text = acme();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    DriveProfile::parse("acme-40.toml", &text).unwrap()
}

/// The first error of a run, and the line of the profile in which `key` stands.
fn first_error(profile: &DriveProfile, table: &mut Table) -> LinkError {
    let error = (0..200).find_map(|_| table.run(None).err());
    error.unwrap_or_else(|| panic!("{} runs", profile.name))
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
    table.enable(Some(("speed_ref", 0.0)));
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
        let text = acme();
        assert!(text.contains(model));
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
    let profile = profile_with("abb-efb", &[("\n[rates]", identity)]);
    let mut table = Table::of(&profile, None);
    table.link.identify().unwrap();
    assert_eq!(table.link.reading("speed_scaling"), Some(1250.0));
    table.enable(Some(("speed_ref", 900.0)));
    let sample = table.hold(Some(("speed_ref", 900.0)), 6.0);
    let speed = sample.get(Channel::Speed).unwrap();
    assert!(
        (speed - crate::units::rad_s_from_rpm(900.0)).abs() < 6.0,
        "{speed}"
    );
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
    let mut table = Table::of(&acme_with(&[READY_FIRST]), None);
    table.link.identify().unwrap();
    table.enable(Some(("speed_ref", 0.0)));
}

#[test]
fn a_drive_at_rest_does_not_show_that_it_runs() {
    let profile = acme_with(&[
        READY_FIRST,
        (
            "mask = 0x0001, equals = 0x0001",
            "mask = 0x0004, equals = 0x0004",
        ),
    ]);
    let mut table = Table::of(&profile, None);
    table.link.identify().unwrap();
    let error = first_error(&profile, &mut table).to_string();
    let line = 1 + acme_line(&profile, "wait = \"status\", mask");
    assert_says(&error, "enable, step 1 of 3: not ready");
    assert_says(
        &error,
        "status is 0x0000 after 1 s (expected 0x0004 under mask 0x0004",
    );
    assert!(
        error.contains(&format!("line {line} of the profile")),
        "{error}"
    );
}

/// Position of the first wait of the enable command, from 0.
fn acme_line(profile: &DriveProfile, key: &str) -> usize {
    assert_eq!(profile.name, "acme-40");
    let text = acme().replacen(READY_FIRST.0, READY_FIRST.1, 1);
    text.lines().position(|line| line.contains(key)).unwrap()
}

#[test]
fn an_enable_command_without_a_wait_for_running_is_enough_for_the_emulated_drive() {
    let mut table = Table::of(&acme_with(&[NO_RUNNING_WAIT]), None);
    table.link.identify().unwrap();
    table.enable(Some(("speed_ref", 0.0)));
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
    let mut table = Table::mixed(&host, &far, None);
    table.link.identify().unwrap();
    let error = first_error(&host, &mut table).to_string();
    assert_says(
        &error,
        "the drive does not run after it: status is 0x0005 where [state] running is looked for (expected 0x0100 under mask 0x0100",
    );
    // It did run, and was told to stop.
    let _ = table.link.stop();
    assert!(!table.far().is_running());
}

#[test]
fn a_drive_that_trips_while_it_is_enabled_is_said_to_be_in_fault() {
    let mut table = Table::of(&acme_with(&[]), None);
    table.link.identify().unwrap();
    table.run(None).unwrap();
    table.far().trip();
    let error = first_error(&acme_with(&[]), &mut table).to_string();
    assert_says(&error, "it is in fault: status is 0x0008");
    assert_says(&error, "which may be the cause");
}
