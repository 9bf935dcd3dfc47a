//! Suites over software drives in processes of their own: what is done to a command, what the drive's journal says of its
//! motor, and a suite that is killed itself.

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;

/// How often a suite is tried on a machine that stands still.
const ATTEMPTS: u32 = 3;

/// The cases of a shipped suite, or of one that is written for a test, that were judged: one at least. It is repeated as long
/// as some of its `count` cases were not, which is said past the capture of the test harness.
fn verdicts(suite: &Path, out: &Path, filters: &str, count: usize) -> Vec<Value> {
    for attempt in 1..=ATTEMPTS {
        let words = format!("test {{}} --json --out {{}} {filters}");
        let done = call(&words, &[suite, out]);
        assert!([0, 1].contains(&done.status), "{}", done.stderr);
        let found = done.json();
        let cases = found["cases"].as_array().expect("cases");
        assert_eq!(cases.len(), count, "{found:#}");
        let judged: Vec<Value> = cases
            .iter()
            .filter(|case| is_judged(case))
            .cloned()
            .collect();
        if judged.len() == count {
            return judged;
        }
        let told = format!(
            "attempt {attempt} of {ATTEMPTS}: {} of {count} cases were judged\n{}\n",
            judged.len(),
            done.stderr
        );
        let _ = std::io::Write::write_all(&mut std::io::stderr(), told.as_bytes());
        if attempt == ATTEMPTS && !judged.is_empty() {
            return judged;
        }
    }
    panic!("this machine stood still in every attempt: nothing was judged");
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
    for case in verdicts(&suite, &desk.out(), filters, 3) {
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
    let cases = verdicts(&suite, &desk.out(), "", 1);
    let reason = cases[0]["reason"].as_str().expect("it does not pass");
    has(reason, &["has to be < 0.0001"]);
    // In memory there is nothing that could be done to it.
    let done = call(
        "test {} --json --port sim: --out {}",
        &[&suite, &desk.out()],
    )
    .expect(0);
    assert_eq!(done.json()["skipped"], 1, "{}", done.stderr);
}

/// A command that its drive refuses before anything is done to it looks as on a machine that stood still.
#[test]
fn an_attempt_that_says_nothing_is_kept_and_told() {
    let desk = Desk::new();
    desk.put("bench.toml", &BenchFile::long("modbus-rtu").text());
    let suite = desk.put(
        "suite.toml",
        "name = \"early\"\n[[case]]\nname = \"refused\"\nbench = \"bench.toml\"\nemulator = \"zk-22fc-plain\"\n\
         port = \"emulator\"\n[[case.step]]\nfault = { faults = { open_phase = true } }\n\
         [[case.step]]\nexcite = {}\nhost = { act = \"kill\", beyond_v = 20.0 }\nstatus = 137\n",
    );
    let junit = desk.path("j.xml");
    let done = call(
        "test {} --json --out {} --junit {}",
        &[&suite, &desk.out(), &junit],
    );
    let case = &done.json()["cases"][0];
    assert_eq!(case["attempts"], 4, "{case:#}");
    assert!(!is_judged(case), "{case:#}");
    let set_aside = case["set_aside"].as_array().expect("three attempts");
    assert_eq!(set_aside.len(), 3, "{case:#}");
    let folder = only_folder(&desk.out());
    for attempt in 1..4 {
        let kept = folder.join(format!("0001-attempt-{attempt}/01-excite.txt"));
        has(&fs::read_to_string(kept).expect("its evidence"), &["open"]);
    }
    let first = "attempt 1 of 4: excite: exit status 3, has to be 137";
    let told = done.stderr.replace("\n  ", " ");
    has(&told, &[first, "refused, attempt 4 of 4"]);
    has(
        &fs::read_to_string(junit).expect("a file"),
        &["<system-out>", first],
    );
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
