//! The real binary against the software drive in a process of its own, over real pseudo-terminals and TCP, in real time.

use std::io::{BufRead, BufReader};
use std::time::Duration;

use crate::kit::lab::{BenchFile, LIMITS};
use crate::kit::prelude::*;
use crate::kit::process::{
    FAULT, RUNNING, STATE, WATCHDOG_TRIPPED, ask, now, telemetry as telemetry_words,
};
use tokio_modbus::prelude::Writer;

/// A drive in its own process, and a folder for bench file and runs.
struct Lab {
    desk: Desk,
    drive: Emulator,
}

impl Lab {
    fn new(link: &str) -> Self {
        let desk = Desk::new();
        let drive = desk.drive(link, "");
        Self { desk, drive }
    }

    fn port(&self) -> String {
        self.drive.port()
    }

    fn run(&self, bench: &BenchFile<'_>) -> Done {
        self.desk.at_port("run", &bench.text(), &self.port(), "--headless --json")
    }

    /// Starts a long run and returns once the record shows that the motor turns fast.
    fn until_turning(&self, protocol: &str) -> Process {
        let bench = BenchFile::long(protocol).text();
        self.desk.until_turning(&bench, &self.port(), "")
    }
}

/// Status, fault, speed in rad/s and voltage command in V.
fn telemetry(port: &str) -> Option<(u16, u16, f64, f64)> {
    let words = telemetry_words(port)?;
    let signed = |word: u16| f64::from(word.cast_signed());
    Some((words[0], words[1], 0.02 * signed(words[9]), 0.01 * signed(words[14])))
}

fn reset_fault(port: &str) -> Option<()> {
    ask(port, async |client| client.write_single_register(CONTROL, RESET_FAULT).await)
}

/// Address of the control word, and the word that resets a fault (firmware-protocol/SPEC.md 2.2).
const CONTROL: u16 = 33;
const RESET_FAULT: u16 = 2;
const WATCHDOG: u16 = 1;

#[track_caller]
fn complete_run(link: &'static str) {
    let (done, lab) = in_real_time(|| {
        let lab = Lab::new(link);
        (lab.run(&BenchFile::short(link)), lab)
    });
    let done = done.expect(0);
    let ready = &lab.drive.ready;
    assert!(ready.starts_with(&format!("ready {link} ")), "{ready}");
    has(ready, &["unit=1", "baud=115200", "profile=own"]);
    let result = done.json();
    let folder = lab.desk.run();
    assert_eq!(result["folder"].as_str().map(Path::new), Some(&*folder));
    let manifest = lab.desk.manifest();
    assert_eq!(manifest["finished"], true);
    assert_eq!(manifest["outcome"], "passed", "{manifest:#}");
    let samples = lab.desk.read("samples.csv");
    let rows = samples.lines().count() - 1;
    assert_eq!(manifest["rows"].as_u64(), Some(rows as u64));
    assert!(rows > 50, "{rows} rows");
    let (slowest, fastest) = (column(&samples, "speed_rad_s").iter())
        .fold((0.0_f64, 0.0_f64), |(least, most), speed| (least.min(*speed), most.max(*speed)));
    // 75 either way on a quiet machine. Where cycles are late the slew limit lets the voltage rise less between them.
    assert!(fastest > 25.0 && slowest < -25.0, "{slowest} .. {fastest}");
    for file in ["events.jsonl", "model.toml", "result.json", "report.html"] {
        let size = fs::metadata(folder.join(file)).map_or(0, |metadata| metadata.len());
        assert!(size > 0, "{file}");
    }
    // What was recorded over the wire can be used.
    let found = json_of("identify {} --json", &[&folder]);
    let key = "back_emf_v_s_per_rad";
    expect_near(key, parameter(&found, key), 0.3538, 0.05);
}

#[test]
fn a_run_over_pseudo_terminals_and_tcp() {
    at_once(["modbus-rtu", "stream", "modbus-tcp"], complete_run);
}

#[test]
fn a_port_that_is_not_there_is_status_3_and_names_what_is() {
    let error = call("run --headless --port /dev/ttyNowhere", &[]).expect(3).error();
    has(&error, &["/dev/ttyNowhere"]);
    assert!(error.contains("there are: ") || error.contains("no serial port is there"), "{error}");
    // Port 1 of this machine: nobody listens.
    call("run --headless --port tcp:127.0.0.1:1", &[]).fails(3, &["127.0.0.1:1"]);
}

#[test]
fn a_unit_that_is_not_there_is_status_3_soon() {
    let lab = Lab::new("modbus-rtu");
    let start = now();
    let bench = BenchFile::short("modbus-rtu");
    lab.run(&BenchFile { link: format!("{}\nunit = 9", bench.link), ..bench }).expect(3).error();
    assert!(start.elapsed() < Duration::from_secs(20));
    assert!(!lab.desk.out().exists(), "a run without a drive");
}

#[test]
fn a_second_host_is_status_3_and_the_first_goes_on() {
    at_once(["modbus-rtu", "stream"], |protocol| {
        let lab = Lab::new(protocol);
        let mut first = lab.until_turning(protocol);
        let other = Desk::new();
        let bench = BenchFile::long(protocol).text();
        let second = other.at_port("run", &bench, &lab.port(), "--headless");
        second.fails(3, &[&format!("pid {} (", first.0.id())]);
        assert!(!other.out().exists());
        let still = first.0.try_wait().expect("a child can be waited for");
        assert!(still.is_none(), "{protocol}: the first run ended");
        first.signal(Signal::SIGTERM);
        first.end().expect(130);
    });
}

/// Only root may open a port that another program has for itself.
#[test]
fn a_program_that_reads_the_port_as_well_is_named() {
    if !rustix::process::geteuid().is_root() {
        let skipped = "not tried: another program may read the port only as root\n";
        let _ = std::io::Write::write_all(&mut std::io::stderr(), skipped.as_bytes());
        return;
    }
    let lab = Lab::new("modbus-rtu");
    let bench = BenchFile::long("modbus-rtu").text();
    let run = lab.desk.until_turning(&bench, &lab.port(), "--reopen-s 1");
    let mut reader = std::process::Command::new("cat");
    reader.arg(lab.port()).stdin(std::process::Stdio::null());
    let reader = Process::of(reader);
    // It takes the replies; the commands still arrive at the drive.
    run.end().fails(3, &["(cat) has the port open as well"]);
    drop(reader);
    let (status, ..) = wait_for("an answer", || telemetry(&lab.port()));
    assert_ne!(status & STATE, RUNNING, "status {status:#x}");
}

#[test]
fn an_interrupt_stops_the_motor_and_keeps_the_record() {
    let lab = Lab::new("modbus-rtu");
    let run = lab.until_turning("modbus-rtu");
    run.signal(Signal::SIGINT);
    run.end().expect(130).error();
    let manifest = lab.desk.manifest();
    assert_eq!(manifest["outcome"], "interrupted", "{manifest:#}");
    assert_eq!(manifest["finished"], true);
    let folder = lab.desk.run();
    let samples = lab.desk.read("samples.csv");
    assert_eq!(column(&samples, "voltage_cmd_v").last(), Some(&0.0));
    // The drive got its stop: it is neither running nor did its watchdog have to act.
    let (status, fault, _, command_v) = wait_for("an answer", || telemetry(&lab.port()));
    assert_ne!(status & STATE, RUNNING, "status {status:#x}");
    assert_eq!((fault, command_v), (0, 0.0));
    assert!(folder.join("report.html").exists());
}

#[test]
fn the_drive_stops_itself_when_its_host_is_killed() {
    let lab = Lab::new("modbus-rtu");
    let run = lab.until_turning("modbus-rtu");
    run.signal(Signal::SIGKILL);
    assert_eq!(run.end().status, -1);
    // Another program reads; reading alone does not kick the watchdog.
    let (status, fault, ..) = wait_for("the watchdog", || {
        telemetry(&lab.port()).filter(|(status, ..)| status & STATE == FAULT)
    });
    assert_ne!(status & WATCHDOG_TRIPPED, 0, "status {status:#x}");
    assert_eq!(fault, WATCHDOG);
    // The output goes to zero as fast as the current limit lets it brake, and stays there.
    let at_rest = |(_, _, speed_rad_s, command_v): &(u16, u16, f64, f64)| {
        speed_rad_s.abs() < 2.0 && *command_v == 0.0
    };
    wait_for("the motor at rest", || telemetry(&lab.port()).filter(at_rest));
    let later = wait_for("an answer", || telemetry(&lab.port()));
    assert!(at_rest(&later), "{later:?}");
    // What was recorded until then is there, marked as incomplete.
    let folder = lab.desk.run();
    assert_eq!(lab.desk.manifest()["finished"], false);
    let opened = call("identify {} --json", &[&folder]);
    assert!(opened.status == 0 || opened.status == 5, "{}", opened.stderr);
    has(&opened.stderr, &["warning: ", "not finished"]);
    assert!(opened.json()["rows_dropped"].is_u64());
    // The fault stays latched: the next host is refused until somebody resets it by hand.
    fs::rename(lab.desk.out(), lab.desk.path("before")).expect("renamed");
    let short = BenchFile::short("modbus-rtu");
    lab.run(&short).fails(3, &["fault"]);
    assert!(!lab.desk.out().exists());
    // Each session has a line of its own behind the same path: the next host must not open the one that is going away.
    let mut line_of_reset = None;
    wait_for("the reset", || {
        line_of_reset = fs::read_link(lab.port()).ok();
        reset_fault(&lab.port())
    });
    wait_for("a fresh line", || (fs::read_link(lab.port()).ok() != line_of_reset).then_some(()));
    let again = in_real_time(|| {
        let _ = fs::remove_dir_all(lab.desk.out());
        (lab.run(&short), ())
    });
    again.0.expect(0);
}

#[test]
fn a_motor_faster_than_its_nameplate_is_a_safety_trip() {
    let lab = Lab::new("modbus-rtu");
    // The nameplate lets the plan expect 65 rad/s; the motor goes to more than 100.
    let done = lab.run(&BenchFile {
        back_emf_v_s_per_rad: 0.6,
        limits: &LIMITS.replace("340.0", "85.0"),
        ..BenchFile::short("modbus-rtu")
    });
    done.fails(4, &["speed"]);
    let manifest = lab.desk.manifest();
    assert!(manifest["outcome"].as_str().unwrap_or_default().contains("trip"), "{manifest:#}");
    assert_eq!(manifest["finished"], true);
    // It brakes within the current limit, so the output may take a moment to reach zero.
    wait_for("zero output", || {
        telemetry(&lab.port())
            .filter(|(status, _, _, command_v)| status & STATE != RUNNING && *command_v == 0.0)
    });
}

#[test]
fn an_emulator_ends_quietly_and_takes_its_path_with_it() {
    let mut lab = Lab::new("modbus-rtu");
    let path = PathBuf::from(&lab.port());
    assert!(path.exists());
    lab.drive.process.signal(Signal::SIGTERM);
    let status =
        wait_for("the end of the emulator", || lab.drive.process.0.try_wait().expect("a child"));
    assert_eq!(status.code(), Some(0));
    assert!(fs::symlink_metadata(&path).is_err());
}

#[test]
fn an_emulator_prints_its_states_as_json_one_object_a_line() {
    let desk = Desk::new();
    let pty = desk.path("drive.pty");
    let text = "emulate --json --mystery 3 --pty {}";
    let mut drive = Process::start(&line(text, &[&pty]));
    let mut stdout = BufReader::new(drive.0.stdout.take().expect("a pipe"));
    let mut state = || -> Value {
        let mut text = String::new();
        stdout.read_line(&mut text).expect("a line");
        serde_json::from_str(&text).expect("one object")
    };
    let ready = state();
    assert_eq!(
        ready,
        json!({
            "state": "ready", "link": "modbus-rtu", "address": pty, "unit": 1, "baud": 115_200,
            "profile": "own"
        })
    );
    assert!(pty.exists());
    drive.signal(Signal::SIGINT);
    let stopped = state();
    assert_eq!((&stopped["state"], &stopped["address"]), (&"stopped".into(), &ready["address"]));
    let status = wait_for("the end of the emulator", || drive.0.try_wait().expect("a child"));
    assert_eq!(status.code(), Some(0));
}
