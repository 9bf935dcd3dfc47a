//! The first move and what may not be moved freely, through the real binary in virtual time: direction pulse and
//! nameplate, vertical loads, supplies that take nothing back, thyristor converters.

use crate::kit::prelude::*;

/// A short bench over the paper's motor: head, more sections, and the parts of the sequence.
pub(super) fn bench(more: &str, sequence: &str) -> String {
    let (head, _) = BENCH.split_once("# What `drivebench speed` does").unwrap();
    format!("{head}\n{more}\n{sequence}\n")
}

const STEPS: &str = "[[sequence]]\nstandstill = { seconds = 0.2 }\n\
                     [[sequence]]\nsteps = { levels_v = [40.0, 0.0], hold_s = 0.5 }\n";

fn run(desk: &Desk, bench: &str, emulator: &str, options: &str) -> Done {
    let bench = desk.put("bench.toml", bench);
    let emulator = desk.put("emulator.toml", emulator);
    let options = format!("{{}} --headless --emulator {{}} {options}");
    desk.simulate("run", &options, &[&bench, &emulator])
}

#[test]
fn a_record_that_cannot_begin_is_refused_before_any_motion() {
    let desk = Desk::new();
    let file = desk.put("file", "no folder");
    for out in [file.clone(), file.join("runs")] {
        let done = call("run --headless --port sim: --json --out {}", &[&out]);
        let done = done.fails(2, &["cannot create"]);
        assert!(!done.stderr.contains("direction"), "{}", done.stderr);
    }
    // What is refused for another reason leaves no trace of the trial.
    let reversed = format!("{PLAIN}\n[faults]\nencoder_reversed = true\n");
    run(&desk, &bench("", STEPS), &reversed, "").fails(3, &["encoder reversed"]);
    let left = fs::read_dir(desk.path(".")).unwrap().flatten();
    assert!(left.map(|entry| entry.path()).all(|path| path.is_file()));
}

#[test]
fn a_reversed_encoder_is_refused_and_its_waiver_recorded() {
    let desk = Desk::new();
    let reversed = format!("{PLAIN}\n[faults]\nencoder_reversed = true\n");
    let done = run(&desk, &bench("", STEPS), &reversed, "").expect(3);
    let error = done.error();
    has(&error, &["direction: encoder reversed", "help: exchange A and B"]);
    assert!(!desk.path("runs").exists(), "nothing was recorded");

    // What the waived pulse would have shown the run shows itself: no waiver lets an encoder run backwards.
    let done = run(&desk, &bench("", STEPS), &reversed, "--waive-direction").expect(4);
    has(
        &done.stderr,
        &["waived: direction", "WAIVED: no pulse was made", "safety trip: encoder reversed"],
    );
    let waivers = desk.manifest()["waivers"].to_string();
    has(&waivers, &["direction", "plausibility"]);
    has(&desk.read("events.jsonl"), &["\"waived\""]);
}

const VERTICAL: &str = "[load]\nvertical = true\nhold_current_a = 2.26\n\
                        brake_release_s = 0.3\nbrake_apply_s = 0.2\n";
const HOIST: &str = "[brake]\nrelease_s = 0.2\napply_s = 0.1\n\
                     [[hidden]]\nid = \"constant_load\"\nconstant_n_m = 0.8\n";

#[test]
fn a_vertical_load_is_held_while_its_brake_moves() {
    let desk = Desk::new();
    let hoist = format!("{PLAIN}\n{HOIST}");
    run(&desk, &bench(VERTICAL, STEPS), &hoist, "").expect(0);
    let events = desk.read("events.jsonl");
    let at = |words: &str| events.find(words).unwrap_or_else(|| panic!("{words}: {events}"));
    // Held, then moved; at rest, then shut, then off.
    assert!(["releases", "\"running\"", "applies", "\"stopping\""].map(at).is_sorted(), "{events}");
    let samples = desk.read("samples.csv");
    let (angles, volts) = (column(&samples, "angle_rad"), column(&samples, "voltage_cmd_v"));
    // The load is lifted and never sinks below where it hung.
    let start = angles[0];
    assert!(angles.iter().all(|angle| angle - start > -1.0), "it fell");
    assert!(angles.iter().any(|angle| angle - start > 20.0), "it was not lifted");
    // 2.26 A times 1.1 ohm, from the begin to the end of the brake's time.
    let held = volts.iter().filter(|volts| (**volts - 2.486).abs() < 0.02).count();
    assert!(held >= 40, "{held} cycles of holding");
}

#[test]
fn a_vertical_load_is_neither_dropped_nor_moved_without_a_brake() {
    let desk = Desk::new();
    let coast = format!("{STEPS}[[sequence]]\ncoast_down = {{ seconds = 0.5 }}\n");
    let file = desk.put("bench.toml", &bench(VERTICAL, &coast));
    let error = refusal("plan {}", &[&file]);
    has(&error, &["free fall of a vertical load 0.5"]);
    let undescribed = bench("[load]\nvertical = true\n", STEPS);
    let hoist = format!("{PLAIN}\n{HOIST}");
    run(&desk, &undescribed, &hoist, "--waive-direction")
        .fails(3, &["load.hold_current_a is left out"]);
}

#[test]
fn a_supply_without_regeneration_limits_the_deceleration() {
    let fast = "[[sequence]]\nsteps = { levels_v = [95.0, 0.0], hold_s = 1.0 }\n";
    let stiff = PLAIN.replace("bus_v = 120.0", "bus_v = 120.0\nbus_capacitance_f = 1e-3");
    let desk = Desk::new();
    run(&desk, &bench("", fast), &stiff, "").fails(4, &["bus voltage too high"]);

    let desk = Desk::new();
    let limited = bench("[supply]\nregenerates = false\nbrake_power_w = 20.0\n", fast);
    // A small resistor takes the energy that friction and winding do not.
    let sink = stiff.replace("1e-3", "1.0");
    run(&desk, &limited, &sink, "").expect(0);
    assert!(desk.read("events.jsonl").contains("\"supply\":true"));
    let file = desk.put("plan.toml", &limited);
    let plan = json_of("plan {} --json", &[&file]);
    let warnings = plan["warnings"].to_string();
    has(&warnings, &["the supply takes nothing back"]);
    assert!(plan["peak_returned_w"].as_f64().unwrap() < 60.0, "{plan}");
}

/// A controller that takes voltages, made a thyristor bridge of one quadrant with a field that is watched.
fn thyristor(desk: &Desk) -> PathBuf {
    let changes = [
        ("kind = \"dc\"", "kind = \"thyristor_dc\""),
        (
            "[missing]",
            "[signals.field_current]\ncan = [0x2110, 1]\ntype = \"i32\"\nword_order = \"high_first\"\n\
             scale = 0.01\nunit = \"A\"\nquantity = \"field_current\"\npoll = \"fast\"\n\n[missing]",
        ),
        (
            "[rates]",
            "[converter]\ndead_time_ms = 10.0\nquadrants = 1\n\n[limits]\nfield_min_a = 0.3\n\n[rates]",
        ),
    ];
    let changed = changes.iter().fold(roboteq_of_120_v(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    });
    desk.put("bridge.toml", &changed)
}

#[test]
fn one_quadrant_goes_one_way_and_a_lost_field_trips() {
    let desk = Desk::new();
    let profile = thyristor(&desk);
    let with = |sequence: &str| {
        bench("", sequence)
            .replace("profile = \"own\"", &format!("profile = {:?}", profile.to_str().unwrap()))
            .replace("rate_hz = 100.0", "rate_hz = 10.0\ndeadline_ms = 2000.0")
            .replace("link_silence_s = 0.45", "link_silence_s = 20.0")
            .replace("bus_min_v = 100.0", "")
            .replace("bus_max_v = 150.0", "")
    };
    let both = "[[sequence]]\nsteps = { levels_v = [12.0, -12.0], hold_s = 1.0 }\n";
    let file = desk.put("both.toml", &with(both));
    let error = refusal("plan {}", &[&file]);
    has(&error, &["reverse voltage 12"]);

    let forward = with("[[sequence]]\nsteps = { levels_v = [12.0, 6.0], hold_s = 1.5 }\n");
    let done = run(&desk, &forward, PLAIN, "--waive-watchdog").expect(0);
    has(
        &done.stderr,
        &[
            "one way, as the converter has one direction",
            "field              1.000 A, a trip below 0.3 A",
        ],
    );
    let desk = Desk::new();
    let lost = format!("{PLAIN}\n[faults]\nfield_lost_from_s = 4.0\n");
    let longer = forward.replace("hold_s = 1.5", "hold_s = 4.0");
    run(&desk, &longer, &lost, "--waive-watchdog").fails(4, &["field lost: field current 0.000 A"]);
}
