//! Endurance in real time: a run over a pseudo-terminal for as long as `DRIVEBENCH_ENDURANCE_S` says, by default an hour, in
//! which memory and handles of both processes stay as they are and the account adds up.

use std::thread::sleep;
use std::time::Duration;

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;
use crate::kit::process::now;

/// Between two looks, and from when on nothing may grow any more.
const LOOK: Duration = Duration::from_secs(5);
const SETTLED_S: f64 = 60.0;
/// kB by which a process may grow after that.
const GROWN_KB: u64 = 4096;

/// Memory of its own, kB, and open files. Pages of the program itself come and go as the kernel pleases.
fn resources(id: u32) -> Option<(u64, usize)> {
    let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("RssAnon:"))?;
    let kilobytes = line.split_whitespace().nth(1)?.parse().ok()?;
    let files = fs::read_dir(format!("/proc/{id}/fd")).ok()?.count();
    Some((kilobytes, files))
}

#[test]
#[ignore = "an hour in real time; DRIVEBENCH_ENDURANCE_S for another length"]
fn an_hour_loses_nothing_and_takes_no_memory() {
    let seconds = std::env::var("DRIVEBENCH_ENDURANCE_S");
    let seconds: f64 = seconds.map_or(3600.0, |text| text.parse().unwrap());
    let desk = Desk::new();
    let drive = desk.drive("modbus-rtu", "");
    let hold_s = seconds / 4.0;
    let sequence = format!(
        "standstill = {{ seconds = 0.5 }}\nsteps = {{ levels_v = [40.0, -40.0, 60.0, -30.0], hold_s = {hold_s:?} }}"
    );
    let limits = format!("{}\ntime_s = {:?}", crate::kit::lab::LIMITS, 1.1 * seconds + 60.0);
    let bench =
        BenchFile { sequence: &sequence, limits: &limits, ..BenchFile::short("modbus-rtu") };
    let mut run = desk.until_turning(&bench.text(), &drive.port(), "");
    let ids = [run.0.id(), drive.process.0.id()];
    let begun = now();
    let (mut first, mut last) = (None, None);
    while run.0.try_wait().unwrap().is_none() {
        let passed_s = begun.elapsed().as_secs_f64();
        assert!(passed_s < seconds + 120.0, "it hangs");
        // While it runs: what is made of the record at the end needs room for it.
        if passed_s < 0.95 * seconds
            && let [Some(host), Some(drive)] = ids.map(resources)
        {
            last = Some([host, drive]);
            if passed_s > SETTLED_S.min(0.3 * seconds) {
                first = first.or(last);
            }
        }
        sleep(LOOK.min(Duration::from_secs_f64(0.02 * seconds)));
    }
    let done = run.end().expect(0);
    let (first, last) = (first.unwrap(), last.unwrap());
    for (begin, end) in first.iter().zip(&last) {
        assert!(end.0 <= begin.0 + GROWN_KB, "{first:?} kB and files, then {last:?}");
        assert_eq!(end.1, begin.1, "files are left open");
    }
    let result = done.json();
    let count = |key: &str, of: &Value| of[key].as_u64().unwrap();
    let (link, timing) = (&result["link"], &result["timing"]);
    let failed = ["timeout", "crc", "stale", "mismatch", "exception", "aborted"];
    let failed: u64 = failed.iter().map(|key| count(key, link)).sum();
    assert_eq!(count("sent", link), count("ok", link) + failed);
    let deadlines = count("cycles", timing) + count("missed_cycles", timing);
    let due = result["duration_s"].as_f64().unwrap() * timing["rate_asked_hz"].as_f64().unwrap();
    assert!((deadlines as f64 - due).abs() < 50.0, "{deadlines} of {due}");
    let rows = desk.read("samples.csv").lines().count() as u64 - 1;
    assert_eq!(count("rows", &result), rows);
    println!(
        "{due:.0} deadlines, {failed} exchanges failed, {rows} rows; {first:?} -> {last:?} kB and files"
    );
}
