//! Suites over software drives in processes of their own: what is done to a command, what the drive's journal says of its
//! motor, and a suite that is killed itself.

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;

/// A shipped suite, or one that is written for a test; its verdicts by the names of the cases.
fn verdicts(suite: &Path, out: &Path, filters: &str) -> Vec<Value> {
    let done = call(
        &format!("test {{}} --json --out {{}} {filters}"),
        &[suite, out],
    );
    assert!([0, 1].contains(&done.status), "{}", done.stderr);
    let found = done.json();
    let cases = found["cases"].as_array().expect("cases");
    cases.clone()
}

/// A machine that stands still too often says nothing, and the suite says that.
fn is_judged(case: &Value) -> bool {
    !case["reason"]
        .as_str()
        .unwrap_or_default()
        .starts_with("not judged")
}

#[test]
fn what_is_done_to_a_command_is_judged_by_what_its_motor_did() {
    let desk = Desk::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let suite = root.join("bench-configs/suites/faults-host.toml");
    let filters = "--filter SIGKILL --filter SIGTERM --filter check";
    let cases = verdicts(&suite, &desk.out(), filters);
    assert_eq!(cases.len(), 3);
    for case in cases.iter().filter(|case| is_judged(case)) {
        assert_eq!(case["verdict"], "passed", "{case:#}");
    }
}

#[test]
fn a_motor_that_does_not_do_as_it_has_to_fails_its_case() {
    let desk = Desk::new();
    desk.put("bench.toml", &BenchFile::long("modbus-rtu").text());
    let suite = desk.put(
        "suite.toml",
        "name = \"strict\"\n[[case]]\nname = \"too soon\"\nbench = \"bench.toml\"\nemulator = \"zk-22fc-plain\"\n\
         port = \"emulator\"\n[[case.step]]\nexcite = {}\nhost = { act = \"terminate\", beyond_v = 20.0 }\nstatus = 130\n\
         [[case.step]]\nassert = { \"motor.zero_after_s\" = \"< 0.0001\", \"motor.peak_set_point_v\" = \"< 1\" }\n",
    );
    let cases = verdicts(&suite, &desk.out(), "");
    let reason = cases[0]["reason"].as_str().expect("it does not pass");
    assert!(
        reason.contains("has to be < 0.0001") || !is_judged(&cases[0]),
        "{reason}"
    );
    // In memory there is nothing that could be done to it.
    let done = call(
        "test {} --json --port sim: --out {}",
        &[&suite, &desk.out()],
    )
    .expect(0);
    assert_eq!(done.json()["skipped"], 1, "{}", done.stderr);
}

/// The kernel asks its command to end in its place, and the command brings the motor to zero.
#[test]
#[cfg(target_os = "linux")]
fn a_suite_that_is_killed_leaves_no_motor_turning() {
    let desk = Desk::new();
    let journal = desk.path("journal.csv");
    let drive = desk.drive("modbus-rtu", &format!("--journal {}", journal.display()));
    desk.put("bench.toml", &BenchFile::long("modbus-rtu").text());
    let suite = desk.put(
        "suite.toml",
        "name = \"killed\"\n[[case]]\nname = \"a\"\nbench = \"bench.toml\"\n[[case.step]]\nexcite = {}\n",
    );
    let text = format!("test {{}} --port {} --hardware --out {{}}", drive.port());
    let process = Process::start(&line(&text, &[&suite, &desk.out()]));
    let rows = || {
        let text = fs::read_to_string(&journal).expect("a journal");
        let whole = text
            .rsplit_once('\n')
            .map_or("", |(whole, _)| whole)
            .to_owned();
        let set_points = column(&whole, "set_point_v");
        (whole, set_points)
    };
    wait_for("a motor that turns", || {
        rows().1.iter().any(|volts| *volts > 35.0).then_some(())
    });
    process.signal(Signal::SIGKILL);
    let last = wait_for("a drive that is told to stop", || {
        let (text, _) = rows();
        let last = text.lines().next_back().unwrap_or_default().to_owned();
        (!last.contains("running")).then_some(last)
    });
    // Its watchdog, which the checks had proven, was not needed.
    assert!(last.contains(",none,"), "{last}");
}
