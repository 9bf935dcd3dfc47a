//! Data that carry nothing, or not what they are taken for: a clear reason, status 5 or 2, and no number.
//!
//! One good record of a motor is spoilt in every way that users of such tools complain of.

use crate::kit::prelude::*;
use std::sync::OnceLock;

use crate::kit::motor_log::{Bench, COLUMNS, J, Row, csv, noise, push, steps};

const RPM: f64 = 9.549_296_585_513_72;

fn good() -> &'static [Row] {
    static ROWS: OnceLock<Vec<Row>> = OnceLock::new();
    ROWS.get_or_init(|| Bench::PAPER_A.record(steps))
}

/// The good record with each row changed, without the angle.
fn spoilt(change: impl Fn(&mut Row)) -> String {
    spoilt_csv(COLUMNS, change)
}

fn spoilt_csv(header: &str, change: impl Fn(&mut Row)) -> String {
    csv(header, good(), change)
}

/// No parameter has a number; each has the reason.
#[track_caller]
fn nothing_invented(found: &Value) {
    let parameters = found["parameters"].as_object().expect("parameters");
    assert!(parameters.len() >= 5, "{found:#}");
    for (key, parameter) in parameters {
        assert!(parameter["value"].is_null(), "{key}: {parameter}");
        assert!(parameter["std"].is_null(), "{key}: {parameter}");
        assert_eq!(parameter["verdict"], "not_observable", "{key}");
        let reason = parameter["reason"].as_str().unwrap_or_default();
        assert!(reason.len() > 20, "{key}: {reason:?}");
    }
}

/// `identify` on a file of this text, with the nameplate or without a model.
fn identified(text: &str, has_model: bool) -> Done {
    let desk = Desk::new();
    let file = desk.put("log.csv", text);
    if has_model {
        return call("identify {} --json --model {}", &[&file, &desk.nameplate()]);
    }
    call("identify {} --json", &[&file])
}

/// `identify` ends with status 5, each text between two `&` stands in headline or help, and the JSON holds no number.
#[track_caller]
fn refused(words: &str, has_model: bool, text: &str) {
    let done = identified(text, has_model).expect(5);
    has(&done.error(), &words.split(" & ").collect::<Vec<_>>());
    let found = done.json();
    nothing_invented(&found);
    let kind = found["findings"][0]["kind"].as_str().unwrap_or_default();
    assert!(!kind.is_empty(), "{words}: {found:#}");
}

#[test]
fn the_record_itself_is_good() {
    let header = format!("{COLUMNS},angle_rad");
    for (text, has_model) in
        [(spoilt(|_| {}), false), (spoilt_csv(&header, |_| {}), false), (spoilt(|_| {}), true)]
    {
        let done = identified(&text, has_model).expect(0);
        lacks(&done.stderr, &["warning"]);
        let found = done.json();
        assert_eq!(found["parameters"]["back_emf_v_s_per_rad"]["verdict"], "settled");
        assert!(found["notes"].as_array().unwrap().is_empty(), "{found:#}");
        let value = parameter(&found, "inertia_kg_m2").unwrap();
        assert!((value / J - 1.0).abs() < 0.01, "{value}");
    }
}

/// A steady state: voltage, current and speed with the noise of sensors.
fn level(u: f64, i: f64, w: f64) -> String {
    let mut noise = noise(11);
    let mut text = format!("{COLUMNS}\n");
    for row in good() {
        push(&mut text, &[row[0], u, i + noise(0.03), w + noise(0.15)]);
    }
    text
}

/// One row for each sentence: which signal it is about is judged, and tested, in the crate of the identification.
#[test]
fn a_spoilt_record_is_refused_with_its_fault() {
    type Case = (&'static str, fn(&mut Row));
    let cases: [Case; 11] = [
        ("nothing changes", |row| *row = [row[0], 12.0, 1.5, 30.0, 0.0]),
        ("current_a is 1.5 A & not measured", |row| row[2] = 1.5),
        ("speed_rad_s is 30 rad/s & not measured", |row| row[3] = 30.0),
        ("speed reads 0 & the shaft turns", |row| row[3] = 0.0),
        ("speed_rad_s repeats & from 3.500 to", |row| {
            if (3.5..5.5).contains(&row[0]) {
                row[3] = good()[700][3];
            }
        }),
        ("current_a stands at exactly & cut off", |row| row[2] = row[2].clamp(-8.0, 8.0)),
        ("current and speed are swapped & current_a=(column of speed_rad_s)", |row| row.swap(2, 3)),
        // Which of the two it is called does not matter: the voltage's column holds no speed.
        ("speed", |row| row.swap(1, 3)),
        ("sign of the current is reversed & *-1", |row| row[2] = -row[2]),
        ("voltage_v is never negative & lost its sign", |row| row[1] = row[1].abs()),
        ("ms & 0.001 & time_s=COLUMN*0.001", |row| row[0] *= 1e3),
    ];
    for (words, change) in cases {
        refused(words, false, &spoilt(change));
    }
    let (rpm, with_angle) = (|row: &mut Row| row[3] *= RPM, format!("{COLUMNS},angle_rad"));
    let steady = level(24.0, 1.286, 63.8);
    for (words, has_model, text) in [
        ("24 & one operating point & steps of voltage", false, &steady),
        ("one operating point", true, &steady),
        ("stands still & 7.995 s & steps of voltage", false, &level(0.0, 0.0, 0.0)),
        ("r/min & 9.549 & *0.104719755", false, &spoilt_csv(&with_angle, rpm)),
        ("r/min & 9.549 & *0.104719755", true, &spoilt(rpm)),
        ("mA & 1000 & *0.001", true, &spoilt(|row| row[2] *= 1e3)),
    ] {
        refused(words, has_model, text);
    }
}

#[test]
fn a_suspect_speed_with_nothing_to_compare_is_not_settled() {
    let desk = Desk::new();
    let done = desk.on("identify {} --json", &spoilt(|row| row[3] *= RPM)).expect(0);
    has(&done.stderr, &["9.5493"]);
    let found = done.json();
    for (key, verdict) in [
        ("back_emf_v_s_per_rad", "searching"),
        ("inertia_kg_m2", "searching"),
        ("load_torque_n_m", "searching"),
        ("resistance_ohm", "settled"),
    ] {
        assert_eq!(found["parameters"][key]["verdict"], verdict, "{key}");
    }
    assert!(found["notes"][0].as_str().unwrap().contains("r/min"));
}

#[test]
fn a_header_in_another_unit_needs_a_factor() {
    let desk = Desk::new();
    let text = spoilt_csv("t,u,i,speed [rpm]", |row| row[3] *= RPM);
    let file = desk.put("log.csv", &text);
    let identify = |speed: &str| {
        let mut arguments = line("identify {} --json --map", &[&file]);
        arguments.push(format!("time_s=t,voltage_v=u,current_a=i,speed_rad_s={speed}").into());
        drivebench(arguments)
    };
    identify("speed [rpm]").fails(2, &["r/min", "*0.104719755"]);
    let found = identify("speed [rpm]*0.104719755").expect(0).json();
    let value = parameter(&found, "back_emf_v_s_per_rad");
    assert!((value.unwrap() / Bench::PAPER_A.ke - 1.0).abs() < 0.01, "{value:?}");
    // Whoever writes the factor 1 means it.
    identify("speed [rpm]*1").expect(0);
}

#[test]
fn an_unusable_file_is_status_2_for_every_command() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let mut two = format!("{COLUMNS}\n");
    for row in &good()[..2] {
        push(&mut two, &row[..4]);
    }
    let nan = f64::NAN;
    let after = |time_s: f64, place: usize, value: f64| {
        spoilt(move |row| {
            if row[0] > time_s {
                row[place] = value;
            }
        })
    };
    for (part, text) in [
        ("2 usable rows, at least 20", two),
        ("no voltage", spoilt(|row| row[1..].fill(nan))),
        ("neither current nor speed", spoilt(|row| row[2..].fill(nan))),
        ("neither current nor speed", spoilt_csv("time_s,voltage_v", |_| {})),
        ("no known column", spoilt_csv("time_s", |_| {})),
        ("inf", after(3.0, 0, f64::INFINITY)),
        ("size up to 1e12", spoilt(|row| row[0] *= 1e20)),
        ("\"current_a\": 1e300", after(7.9, 2, 1e300)),
    ] {
        let file = desk.put("log.csv", &text);
        for command in ["identify", "compare", "diagnose"] {
            let command = format!("{command} {{}} --json");
            assert_eq!(call(&command, &[&file]).fails(2, &[part]).stdout, "", "{part}");
            let text = format!("{command} --model {{}}");
            refusal(&text, &[&file, &nameplate]);
        }
    }
}

#[test]
fn compare_and_diagnose_do_not_judge_by_spoilt_data() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let swapped = desk.put("swapped.csv", &spoilt(|row| row.swap(1, 2)));
    for command in ["compare {} --json", "diagnose {} --json"] {
        call(command, &[&swapped]).fails(5, &["voltage and current are swapped"]);
    }
    call("diagnose {} --json --model {}", &[&swapped, &nameplate]).fails(5, &["swapped"]);
    // A model as given can be compared with anything; what is wrong stands with the figures.
    let done = call("compare {} --json --model {}", &[&swapped, &nameplate]).expect(0);
    has(&done.stderr, &["swapped"]);
    assert!(done.json()["notes"][0].as_str().unwrap().contains("swapped"));
    // A record that excites nothing has its own verdict in `diagnose`, and its caution.
    let steady = desk.put("steady.csv", &spoilt(|row| *row = [row[0], 12.0, 1.5, 30.0, 0.0]));
    let done = call("diagnose {} --json --model {}", &[&steady, &nameplate]);
    assert!(done.status == 5 || done.status == 0, "{}", done.stderr);
    has(&done.stderr, &["nothing changes"]);
}

#[test]
fn a_locked_rotor_gives_the_winding_and_nothing_else() {
    let mut text = format!("{COLUMNS}\n");
    let locked = Bench { free: false, ..Bench::PAPER_A };
    for row in locked.record(|t| 0.2 * steps(t)) {
        push(&mut text, &row[..4]);
    }
    let desk = Desk::new();
    let done = desk.on("identify {} --json", &text).expect(0);
    has(&done.stderr, &["shaft does not turn"]);
    let found = done.json();
    let value = |key: &str| parameter(&found, key);
    assert!((value("resistance_ohm").unwrap() / Bench::PAPER_A.resistance_ohm - 1.0).abs() < 0.02);
    for key in ["back_emf_v_s_per_rad", "inertia_kg_m2", "load_torque_n_m"] {
        assert!(value(key).is_none(), "{key}: {found:#}");
    }
    desk.on("identify {} --require inertia_kg_m2", &text).expect(5);
}

#[test]
fn the_origin_of_a_signal_limits_what_is_claimed_from_it() {
    let desk = Desk::new();
    let file = desk.put("log.csv", &spoilt(|_| {}));
    let found = call("identify {} --json --origin current_a=supply", &[&file]).expect(5).json();
    assert_eq!(found["signals"]["current_a"]["side"], "supply");
    for key in ["resistance_ohm", "inductance_h", "inertia_kg_m2"] {
        assert_eq!(found["parameters"][key]["verdict"], "invalid", "{key}");
        assert!(found["parameters"][key]["value"].is_number());
    }
    refusals("identify {} --origin speed_rad_s=guessed => guessed & estimated", &[&file]);
}

#[test]
fn the_origin_travels_from_the_drives_profile_to_the_answer() {
    let run = recorded("--emulator zk-22fc-hidden --seed 7", &[]);
    assert_eq!(read_json(run.join("manifest.json"))["sides"]["current_a"], "terminal");
    let done = call("identify {} --json", &[&run]).expect(0);
    // A good run of a motor with a hidden effect is no bad input.
    lacks(&done.stderr, &["warning"]);
    let signals = &done.json()["signals"];
    assert_eq!(signals["voltage_cmd_v"]["origin"], "commanded");
    assert_eq!(signals["voltage_v"]["origin"], "measured");
    assert_eq!(signals["voltage_v"]["side"], "terminal");
    assert_eq!(signals["current_a"]["side"], "terminal");
    assert_eq!(signals["speed_rad_s"]["side"], Value::Null);
}
