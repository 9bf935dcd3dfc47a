//! A suite that is killed, with a software drive in a process of its own.

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;

/// The kernel sends its command the signal to end, and the command brings the motor to zero.
#[test]
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
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole).to_owned();
        let set_points = column(&whole, "set_point_v");
        (whole, set_points)
    };
    wait_for("a motor that turns", || rows().1.iter().any(|volts| *volts > 35.0).then_some(()));
    process.signal(Signal::SIGKILL);
    let last = wait_for("a drive that got its stop", || {
        let (text, _) = rows();
        let last = text.lines().next_back().unwrap_or_default().to_owned();
        (!last.contains("running")).then_some(last)
    });
    // Its watchdog, which the checks had proven, was not needed.
    assert!(last.contains(",none,"), "{last}");
}
