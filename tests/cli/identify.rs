//! `identify` over several runs of one machine, with an added inertia, behind a gearbox; through the real binary.

use crate::kit::prelude::*;

/// A run in virtual time of the plain ZK-22FC with torque constant 0.30 N.m/A and the given inertia, kg.m2.
fn run_with(inertia_kg_m2: f64, seed: u32) -> Recorded {
    let emulator = PLAIN.replace("tolerance = 0.1", "tolerance = 0.0").replace(
        "inertia_kg_m2 = 0.0045",
        &format!("inertia_kg_m2 = {inertia_kg_m2}\ntorque_n_m_per_a = 0.30"),
    );
    let desk = Desk::new();
    let file = desk.put("emulator.toml", &emulator);
    recorded(&format!("--emulator {{}} --seed {seed}"), &[&file])
}

#[test]
fn a_known_added_inertia_gives_the_absolute_scale() {
    let (bare, disc) = (run_with(0.0045, 1), run_with(0.005, 2));
    let added = format!("{}=0.0005", disc.display());
    let text = format!("identify {{}} --added-inertia {added} --json");
    let done = call(&text, &[&bare]).expect(0);
    let found = done.json();
    for (key, truth) in [
        ("torque_n_m_per_a", 0.30),
        ("inertia_kg_m2", 0.0045),
        ("load_torque_n_m", 0.455),
    ] {
        let value = number(&found, &format!("/absolute/{key}/value"));
        let std = number(&found, &format!("/absolute/{key}/std"));
        assert!((value / truth - 1.0).abs() < 0.01, "{key} {value}");
        assert!((value - truth).abs() < 4.0 * std, "{key} {value} +- {std}");
    }
    // Without the disc Kt = Ke = 0.3538 is assumed, and everything mechanical is as much too large.
    let assumed = number(&found, "/parameters/inertia_kg_m2/value");
    assert!((assumed / 0.0045 - 0.3538 / 0.30).abs() < 0.01, "{assumed}");
    lacks(&done.stdout, &["plausible"]);

    let ten_times = format!(
        "identify {{}} --added-inertia {}=0.005 --json",
        disc.display()
    );
    let wrong = call(&ten_times, &[&bare]).expect(0);
    has(&wrong.stdout, &["plausible"]);
}

#[test]
fn several_runs_give_the_spread_between_them() {
    let runs = [
        run_with(0.0045, 3),
        run_with(0.0045, 4),
        run_with(0.0047, 5),
    ];
    let paths: Vec<_> = runs.iter().map(|run| &**run).collect();
    let found = json_of("identify {} {} {} --json --gear-ratio 10", &paths);
    let at = |pointer: &str| number(&found, pointer);
    assert!((at("/parameters/inertia_kg_m2/runs") - 3.0).abs() < 1e-9);
    // 0.0045, 0.0045, 0.0047, times Ke/Kt.
    let expected = 0.3538 / 0.30 * 0.0002 / 3f64.sqrt();
    let spread = at("/parameters/inertia_kg_m2/run_to_run_std");
    assert!(
        (spread / expected - 1.0).abs() < 0.05,
        "{spread} {expected}"
    );
    let reason = &found["parameters"]["inertia_kg_m2"]["reason"];
    assert!(reason.as_str().unwrap().contains("run to run"), "{reason}");
    assert_eq!(found["parameters"]["resistance_ohm"]["verdict"], "settled");
    assert_eq!(found["runs"].as_array().map(Vec::len), Some(3));
    let load = at("/load_shaft/parameters/inertia_kg_m2/value");
    let motor = at("/parameters/inertia_kg_m2/value");
    assert!((load / motor - 100.0).abs() < 1e-9);
}

#[test]
fn a_drive_that_limits_the_voltage_settles_nothing() {
    // The embedded program on twice the inertia: the emulated drive reaches its current limit.
    let heavy = run_with(0.0095, 7);
    let found = json_of("identify {} --json", &[&heavy]);
    for (key, parameter) in found["parameters"].as_object().unwrap() {
        assert_ne!(parameter["verdict"], "settled", "{key} {parameter}");
    }
    assert!(
        found["notes"].to_string().contains("limited it"),
        "{found:#}"
    );
}

#[test]
fn a_nameplate_that_does_not_fit_is_told_with_both_numbers() {
    let run = run_with(0.0045, 8);
    let plate = include_str!("../../bench-configs/motors/zk-22fc.toml");
    let folder = Desk::new();
    let file = folder.path("motor.toml");
    let compare = |text: &str| {
        fs::write(&file, text).expect("a temporary file");
        let options = "identify {} --nameplate {} --json";
        json_of(options, &[&run, &file])
    };
    assert_eq!(compare(plate)["nameplate"]["fits"], true);
    let other = compare(&plate.replace("resistance_ohm = 1.1 ", "resistance_ohm = 3.3 "));
    assert_eq!(other["nameplate"]["fits"], false);
    let rows = other["nameplate"]["rows"].to_string();
    assert!(rows.contains("3.300 ohm"), "{rows}");
}

#[test]
fn a_load_trace_never_overwrites_a_record() {
    let run = run_with(0.0045, 9);
    let samples = run.join("samples.csv");
    let model = run.join("model.toml");
    let before = fs::read(&samples).expect("a record");
    let text = "identify {} --model {} --load-torque {}";
    call(text, &[&samples, &model, &samples]).fails(2, &["never overwritten"]);
    assert_eq!(fs::read(&samples).expect("a record"), before);
}

#[test]
fn wrong_options_are_named_with_what_is_allowed() {
    for (options, phrase) in [
        ("--gear-ratio 0", "0.001 to 100000"),
        ("--added-inertia disc", "RUN=KG_M2"),
        ("--added-inertia disc=-1", "RUN=KG_M2"),
        ("--scheme 4", "output-error"),
    ] {
        let bare = run_with(0.0045, 6);
        let done = call(&format!("identify {{}} {options}"), &[&bare]).expect(2);
        assert!(done.error().contains(phrase), "{options}: {}", done.error());
    }
}
