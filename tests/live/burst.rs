//! A burst that the drive records by itself: armed by the run, kept with its samples, and taken as a run of its own.

use crate::kit::prelude::*;

/// The default bench with a burst at this part, over `protocol`.
fn bench(protocol: &str, part: u8) -> String {
    let link = format!("protocol = {protocol:?}");
    BENCH
        .replace("# burst_at = 3", &format!("burst_at = {part}"))
        .replace("protocol = \"modbus-rtu\"", &link)
        .replace("zk-22fc-hidden", "zk-22fc-plain")
}

/// Rows of the capture, and its first and last time.
fn capture(run: &Path) -> (usize, f64, f64) {
    let text = fs::read_to_string(run.join("capture-01.csv")).expect("the capture is kept");
    assert_eq!(text.lines().next(), Some("time_s,voltage_v,current_a,speed_rad_s"));
    let times = column(&text, "time_s");
    (times.len(), times[0], times[times.len() - 1])
}

/// When the drive applied the command that started the burst: the row of `samples.csv` that carries its number.
fn armed_at_s(run: &Path) -> f64 {
    let events = fs::read_to_string(run.join("events.jsonl")).expect("there are events");
    let armed: Value = events
        .lines()
        .filter(|line| line.contains("burst_armed"))
        .map(|line| serde_json::from_str(line).expect("an event"))
        .next()
        .expect("arming is an event");
    armed["time_s"].as_f64().expect("a time")
}

#[test]
fn a_burst_gives_the_winding_of_a_slow_loop() {
    let desk = Desk::new();
    let bench = desk.put("bench.toml", &bench("modbus-rtu", 3));
    let done = desk.simulate("run --headless", "{} --seed 3", &[&bench]).expect(0);
    has(&done.stderr, &["burst capture: 4095 samples at 10000 Hz"]);
    let run = desk.run();
    let (rows, first_s, last_s) = capture(&run);
    assert_eq!(rows, 4095);
    assert!((last_s - first_s - 0.4094).abs() < 1e-6);
    let armed_s = armed_at_s(&run);
    assert!((first_s - armed_s).abs() < 0.05, "{first_s} after {armed_s}");

    // The truth of seed 3 is within 10 % of the plate; the run itself determines it well.
    let identify =
        |data: &Path| json_of("identify {} --json --require resistance_ohm,inductance_h", &[data]);
    let (whole, burst) = (identify(&run), identify(&run.join("capture-01.csv")));
    for key in ["resistance_ohm", "inductance_h"] {
        let (whole, burst) = (parameter(&whole, key), parameter(&burst, key));
        let ratio = burst.expect("a value") / whole.expect("a value");
        assert!((0.99..1.01).contains(&ratio), "{key}: {burst:?} of {whole:?}");
    }
}

#[test]
fn a_burst_is_fetched_over_every_wire() {
    at_once(["modbus-rtu", "stream", "modbus-tcp"], |protocol| {
        let text = bench(protocol, 2);
        let (head, _) = text.split_once("[[sequence]]").expect("it has a sequence");
        // Slow and patient: this test is not about how punctual this machine is.
        let head = head
            .replace("rate_hz = 100.0", "rate_hz = 40.0\ndeadline_ms = 20.0")
            .replace("link_silence_s = 0.45", "link_silence_s = 1.5");
        let short = "[[sequence]]\nstandstill = { seconds = 0.3 }\n[[sequence]]\n\
                     steps = { levels_v = [20.0], hold_s = 0.4 }\n";
        let (done, desk) = in_real_time(|| {
            let desk = Desk::new();
            let bench = format!("{head}{short}");
            (desk.at_port("run", &bench, "emulator", "--headless"), desk)
        });
        let done = done.expect(0);
        let (rows, ..) = capture(&desk.run());
        assert_eq!(rows, 4095, "{protocol}: {}", done.stderr);
    });
}

#[test]
fn a_part_that_is_not_there_is_refused() {
    let desk = Desk::new();
    let text = bench("modbus-rtu", 99);
    let path = desk.put("bench.toml", &text);
    call("plan {}", &[&path]).fails(2, &["runs.burst_at = 99"]);
}

#[test]
fn a_commissioning_at_a_low_rate_takes_a_burst() {
    let desk = Desk::new();
    // 25 Hz against an L/R of 9 ms: the transient is over between two samples.
    let text = BENCH
        .replace("rate_hz = 100.0", "rate_hz = 25.0")
        .replace("zk-22fc-hidden", "zk-22fc-brushes");
    let bench = desk.put("bench.toml", &text);
    let done = desk.simulate("commission --headless", "{} --seed 5", &[&bench]).expect(0).json();
    let burst = &done["burst"];
    assert_eq!(burst["rate_hz"].as_f64().map(f64::round), Some(10_000.0));
    assert_eq!(burst["effects"], json!(["voltage_drop"]), "{burst}");
    let of = |list: &Value| {
        let entries = list.as_array().expect("a list").iter();
        let mut found = entries.filter(|entry| entry["key"] == "inductance_h");
        found.next().and_then(|entry| entry["value"].as_f64())
    };
    let inductance_h = of(&burst["parameters"]).expect("a value from the burst");
    assert!((0.0085..0.0113).contains(&inductance_h), "{inductance_h}");
}
