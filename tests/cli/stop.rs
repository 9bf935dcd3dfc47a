//! What is kept of a run that tripped: how it was stopped, and its last seconds.

use crate::kit::prelude::*;

/// The software drive with an encoder that freezes after two seconds.
fn frozen() -> String {
    let example = fs::read_to_string("bench-configs/emulators/example.toml").unwrap();
    let key = "# encoder_frozen_from_s = 2.0";
    assert!(example.contains(key));
    example.replace(key, "encoder_frozen_from_s = 2.0")
}

#[test]
fn a_trip_records_its_stop_and_its_last_seconds() {
    let desk = Desk::new();
    let emulator = desk.put("frozen.toml", &frozen());
    let done =
        call("run --headless --json --port sim: --emulator {} --out {}", &[&emulator, &desk.out()])
            .expect(4);
    let result = done.json();
    let stop = &result["stop"];
    assert_eq!(stop["cause"], "encoder frozen", "{stop:#}");
    assert!(stop["confirmed_after_ms"].is_f64(), "{stop:#}");
    assert_eq!(stop["attempts"], 1);
    let manifest = desk.manifest();
    assert_eq!(&manifest["stop"], stop);
    assert_eq!(manifest["trip"], result["trip"]);
    let samples = desk.read("samples.csv");
    let rows = samples.lines().count() as u64 - 1;
    let (from, to) = (&result["trip"]["from_row"], &result["trip"]["to_row"]);
    assert_eq!(to.as_u64(), Some(rows));
    let times = column(&samples, "time_s");
    let first = usize::try_from(from.as_u64().unwrap()).unwrap() - 1;
    let before_s = result["trip"]["time_s"].as_f64().unwrap() - times[first];
    assert!((1.9..2.1).contains(&before_s), "{before_s} s");
    has(&desk.read("events.jsonl"), &["\"event\":\"stop\""]);
    let page = desk.read("report.html");
    let words = ["The last seconds", "stop sent", "share of the limit"];
    has(&page, &words);
    let report = call("report {}", &[&desk.run()]).expect(0);
    has(&report.stdout, &["stopped", "last 2 s", "samples.csv"]);
}

#[test]
fn a_run_to_its_end_has_its_stop_too_and_no_last_seconds() {
    let desk = Desk::new();
    let done = call("run --headless --json --port sim: --out {}", &[&desk.out()]);
    let result = done.expect(0).json();
    assert_eq!(result["stop"]["cause"], "the end of the sequence");
    assert!(result["stop"]["confirmed_after_ms"].is_f64());
    assert!(result["trip"].is_null());
}
