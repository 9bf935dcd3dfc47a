//! `bode` through the real binary: a coupling that the drive hides is found with its damping; what does not swing is not named.

use crate::kit::prelude::*;

/// The shipped bench of a frequency response.
const CHIRP: &str = "bench-configs/benches/zk-22fc-frequency-response.toml";

/// A run of the shipped bench on this emulator.
fn chirp(emulator: &str) -> Recorded {
    let options = format!("{{}} --emulator {emulator}");
    recorded(&options, &[Path::new(CHIRP)])
}

/// The modes of a pathway: kind, frequency, damping.
fn modes(found: &Value, pathway: &str) -> Vec<(String, f64, f64)> {
    let all = found["modes"].as_array().expect("a list of modes");
    let own = all.iter().filter(|mode| mode["pathway"] == pathway);
    own.map(|mode| {
        let hertz = number(mode, "/frequency_hz");
        (word(mode, "/kind").to_owned(), hertz, number(mode, "/damping_ratio"))
    })
    .collect()
}

#[test]
fn a_chirp_finds_the_coupling_and_the_model_that_lacks_it() {
    let run = chirp("zk-22fc-elastic");
    let desk = Desk::new();
    let (csv, svg) = (desk.path("bode.csv"), desk.path("bode.svg"));
    let paths: [&Path; 3] = [&run, &csv, &svg];
    let found = call("bode {} --json --csv {} --svg {}", &paths).expect(0).json();
    let mechanics = modes(&found, "current_to_speed");
    let of = |kind: &str| mechanics.iter().find(|mode| mode.0 == kind);
    let (_, hertz, damping) = of("resonance").expect("the coupling swings");
    expect_near("resonance", Some(*hertz), 22.0, 0.02);
    expect_near("damping", Some(*damping), 0.02, 0.2);
    let (_, hertz, _) = of("anti_resonance").expect("the load swings against the held motor");
    expect_near("anti-resonance", Some(*hertz), 22.0 * 0.5_f64.sqrt(), 0.02);
    assert_eq!(mechanics.len(), 2, "{mechanics:?}");
    // The folder's model is the five-parameter baseline.
    let departures = found["departures"].as_array().unwrap();
    let holds = |band: &Value| number(band, "/from_hz") < 22.0 && number(band, "/to_hz") > 22.0;
    assert!(departures.iter().any(holds), "{departures:#?}");
    assert!(found["model"]["pathways"].is_array());

    let rows = fs::read_to_string(&csv).unwrap();
    let mut rows = rows.lines();
    let head =
        "pathway,frequency_hz,magnitude_unit,magnitude,magnitude_low,magnitude_high,phase_rad,";
    assert!(rows.next().unwrap().starts_with(head));
    let count: usize =
        (0..3).map(|own| found["pathways"][own]["points"].as_array().unwrap().len()).sum();
    assert_eq!(rows.count(), count);
    let svg_text = fs::read_to_string(&svg).unwrap();
    has(&svg_text, &["<svg", ">resonance 22", "coherence", ">model</text>"]);
    lacks(&svg_text, &["NaN"]);
    for (option, path) in [("--csv", &csv), ("--svg", &svg)] {
        let error = refusal(&format!("bode {{}} {option} {{}}"), &[&run, path]);
        has(&error, &["exists already", option]);
    }

    let text = call("bode {}", &[&run]).expect(0).stdout;
    let parts = [
        "CURRENT TO SPEED: anti-resonance at 15.",
        "resonance at 22.",
        "sampled at 500 Hz: shown up to 150 Hz",
        "an elastic coupling would cause it",
        "drivebench add elastic_coupling",
    ];
    has(&text, &parts);
    assert!(text.lines().count() <= 30, "{text}");
    let text = call("bode {} --pathway voltage-to-current", &[&run]);
    has(&text.expect(0).stdout, &["VOLTAGE TO CURRENT: ", "A per V"]);
}

#[test]
fn a_rigid_shaft_has_no_resonance_and_its_model_departs_nowhere() {
    let run = chirp("zk-22fc-plain");
    let desk = Desk::new();
    let model = desk.path("model.toml");
    let paths: [&Path; 2] = [&run, &model];
    call("identify {} --output {}", &paths).expect(0);
    let found = call("bode {} --model {} --json", &paths).expect(0).json();
    assert_eq!(found["modes"], json!([]));
    assert_eq!(found["departures"], json!([]));
    let text = call("bode {} --model {}", &paths).expect(0).stdout;
    has(&text, &["no resonance from", "drivebench tune --model"]);
}

#[test]
fn no_mode_is_named_in_an_ordinary_run_of_a_motor_that_has_none() {
    let [brushes, fan] = ["zk-22fc-brushes", "zk-22fc-fan"]
        .map(|emulator| recorded(&format!("--emulator {emulator}"), &[]));
    let runs: [&Path; 4] = [&Runs::hidden().fit, &Runs::plain().fit, &brushes, &fan];
    for run in runs {
        let found = call("bode {} --json", &[run]);
        assert!([0, 5].contains(&found.status), "{}", found.stderr);
        let found = found.json();
        assert_eq!(found["modes"], json!([]), "{}", run.display());
        has(word(&found, "/cautions/0"), &["never turns in one direction", "offset"]);
    }
}

#[test]
fn a_run_in_a_closed_loop_is_taken_with_a_caution() {
    let desk = Desk::new();
    desk.simulate("speed --headless", "--emulator zk-22fc-plain", &[]).expect(0);
    let done = call("bode {} --json", &[&desk.run()]);
    assert!([0, 5].contains(&done.status), "{}", done.stderr);
    let found = done.json();
    assert_eq!(found["modes"], json!([]));
    has(&found["cautions"].to_string(), &["recorded in a closed loop"]);
}

#[test]
fn what_cannot_be_answered_is_refused_with_the_next_step() {
    let desk = Desk::new();
    let mut steady = "time_s,voltage_v,current_a,speed_rad_s\n".to_owned();
    let mut torque = "time_s,current_a,speed_rad_s\n".to_owned();
    for row in 0..600 {
        let time_s = f64::from(row) * 0.01;
        let wave = f64::from(row % 7);
        let _ = writeln!(steady, "{time_s},20,{wave},50");
        let _ = writeln!(torque, "{time_s},{wave},50");
    }
    let (steady, torque) = (desk.put("steady.csv", &steady), desk.put("torque.csv", &torque));
    let done = call("bode {}", &[&steady]).fails(5, &["a constant voltage", "chirp"]);
    assert_eq!(done.stdout, "");
    call("bode {}", &[&torque]).fails(2, &["has no voltage", "--map voltage_v"]);
    call("bode {} --pathway speed", &[&steady]).fails(2, &["voltage-to-speed"]);
}
