//! The real binary against the software drive in a process of its own, over real pseudo-terminals and TCP, in real time.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::kit::process::{
    self, Emulator, FAULT, Process, RUNNING, STATE, WATCHDOG_TRIPPED, ask, now, wait_for,
};
use crate::kit::{
    Desk, Done, call, column, in_real_time, json_of, line, manifest, only_folder, parameter, turns,
};
use nix::sys::signal::Signal;
use serde_json::Value;
use tokio_modbus::prelude::Writer;

/// A plain motor behind a drive whose watchdog leaves a loaded machine some time.
pub(crate) const EMULATOR: &str = r#"
watchdog_ms = 1000
[motor]
name = "ZK-22FC"
rated_voltage_v = 110.0
rated_current_a = 5.7
rated_speed_rad_s = 293.2
resistance_ohm = 1.1
inductance_h = 0.0099
back_emf_v_s_per_rad = 0.3538
inertia_kg_m2 = 0.0045
load_torque_n_m = 0.455
[limits]
current_limit_a = 11.4
bus_v = 120.0
speed_limit_rad_s = 350.0
[noise]
voltage_v = 0.02
current_a = 0.03
speed_rad_s = 0.15
"#;

/// The bench that goes with it. `unit`, the constant of the nameplate, the limit of the speed and the sequence differ
/// from test to test.
pub(crate) struct BenchFile {
    protocol: &'static str,
    unit: u8,
    back_emf_v_s_per_rad: f64,
    speed_rad_s: f64,
    sequence: &'static str,
}

/// About two seconds.
const SHORT: &str = "standstill = { seconds = 0.5 }\n[[sequence]]\nsteps = { levels_v = [40.0, -40.0, 0.0], hold_s = 0.5 }";
/// Long enough to be ended from outside.
const LONG: &str =
    "standstill = { seconds = 0.3 }\n[[sequence]]\nsteps = { levels_v = [40.0], hold_s = 50.0 }";

impl Default for BenchFile {
    fn default() -> Self {
        Self {
            protocol: "modbus-rtu",
            unit: 1,
            back_emf_v_s_per_rad: 0.3538,
            speed_rad_s: 340.0,
            sequence: SHORT,
        }
    }
}

impl BenchFile {
    /// The motor turns until the run is ended from outside.
    pub(crate) fn long(protocol: &'static str) -> Self {
        Self {
            protocol,
            sequence: LONG,
            ..Self::default()
        }
    }

    pub(crate) fn text(&self) -> String {
        let Self {
            protocol,
            unit,
            back_emf_v_s_per_rad,
            speed_rad_s,
            sequence,
        } = self;
        format!(
            r#"
name = "live"
[drive]
profile = "own"
[link]
port = "/dev/given-by-port"
protocol = "{protocol}"
unit = {unit}
rate_hz = 50.0
[motor]
name = "ZK-22FC"
rated_voltage_v = 110.0
rated_current_a = 5.7
rated_speed_rad_s = 293.2
resistance_ohm = 1.1
inductance_h = 0.0099
back_emf_v_s_per_rad = {back_emf_v_s_per_rad:?}
inertia_kg_m2 = 0.0045
load_torque_n_m = 0.455
[limits]
current_a = 11.0
speed_rad_s = {speed_rad_s:?}
voltage_v = 110.0
slew_v_per_s = 200.0
link_silence_s = 0.95
[[sequence]]
{sequence}
"#
        )
    }
}

/// A drive in its own process, and a folder for bench file and runs.
struct Lab {
    desk: Desk,
    drive: Emulator,
    /// As `--port` takes it.
    port: String,
}

impl Lab {
    fn new(link: &str) -> Self {
        let desk = Desk::new();
        let config = desk.put("emulator.toml", EMULATOR);
        let drive = Emulator::on(link, &desk.path("drive"), "{}", &[&config]);
        let port = drive.port();
        Self { desk, drive, port }
    }

    fn out(&self) -> PathBuf {
        self.desk.path("runs")
    }

    fn run_arguments(&self, bench: &BenchFile) -> Vec<PathBuf> {
        let file = self.desk.put("bench.toml", &bench.text());
        line(
            "run {} --port {} --out {} --headless --json",
            &[&file, Path::new(&self.port), &self.out()],
        )
    }

    fn run(&self, bench: &BenchFile) -> Done {
        Process::start(&self.run_arguments(bench)).end()
    }

    /// Starts a long run and returns once the record shows that the motor turns fast.
    fn run_until_turning(&self, protocol: &'static str) -> Process {
        let run = Process::start(&self.run_arguments(&BenchFile::long(protocol)));
        wait_for("a motor that turns", || {
            turns(&self.out(), 80.0).then_some(())
        });
        run
    }

    fn manifest(&self) -> Value {
        manifest(&self.out())
    }
}

/// Status, fault, speed in rad/s and voltage command in V.
fn telemetry(port: &str) -> Option<(u16, u16, f64, f64)> {
    let words = process::telemetry(port)?;
    let signed = |word: u16| f64::from(word.cast_signed());
    Some((
        words[0],
        words[1],
        0.02 * signed(words[9]),
        0.01 * signed(words[14]),
    ))
}

fn reset_fault(port: &str) -> Option<()> {
    ask(port, async |client| {
        client.write_single_register(CONTROL, RESET_FAULT).await
    })
}

/// Address of the control word, and the word that resets a fault (firmware-protocol/SPEC.md 2.2).
const CONTROL: u16 = 33;
const RESET_FAULT: u16 = 2;
const WATCHDOG: u16 = 1;

#[track_caller]
fn complete_run(link: &'static str) {
    let bench = BenchFile {
        protocol: link,
        ..BenchFile::default()
    };
    let (done, lab) = in_real_time(|| {
        let lab = Lab::new(link);
        (lab.run(&bench), lab)
    });
    let done = done.expect(0);
    let ready = &lab.drive.ready;
    assert!(ready.starts_with(&format!("ready {link} ")), "{ready}");
    for word in ["unit=1", "baud=115200", "profile=own"] {
        assert!(ready.contains(word), "{ready}");
    }
    let result = done.json();
    let folder = only_folder(&lab.out());
    assert_eq!(result["folder"].as_str().map(Path::new), Some(&*folder));
    let manifest = lab.manifest();
    assert_eq!(manifest["finished"], true);
    assert_eq!(manifest["outcome"], "passed", "{manifest:#}");
    let samples = fs::read_to_string(folder.join("samples.csv")).expect("samples");
    let rows = samples.lines().count() - 1;
    assert_eq!(manifest["rows"].as_u64(), Some(rows as u64));
    assert!(rows > 50, "{rows} rows");
    let speeds = column(&samples, "speed_rad_s");
    let (slowest, fastest) = (speeds.iter()).fold((0.0_f64, 0.0_f64), |(least, most), speed| {
        (least.min(*speed), most.max(*speed))
    });
    // 75 either way on a quiet machine. Where cycles are late the slew limit lets the voltage rise less between them.
    assert!(fastest > 25.0 && slowest < -25.0, "{slowest} .. {fastest}");
    for file in ["events.jsonl", "model.toml", "result.json", "report.html"] {
        let size = fs::metadata(folder.join(file)).map_or(0, |metadata| metadata.len());
        assert!(size > 0, "{file}");
    }
    // What was recorded over the wire can be used.
    let found = json_of("identify {} --json", &[&folder]);
    let constant = parameter(&found, "back_emf_v_s_per_rad");
    assert!(
        constant.is_some_and(|value| (value / 0.3538 - 1.0).abs() < 0.05),
        "{found:#}"
    );
}

#[test]
fn a_run_over_modbus_rtu_on_a_pseudo_terminal() {
    complete_run("modbus-rtu");
}

#[test]
fn a_run_over_the_stream_on_a_pseudo_terminal() {
    complete_run("stream");
}

#[test]
fn a_run_over_modbus_tcp() {
    complete_run("modbus-tcp");
}

#[test]
fn a_port_that_is_not_there_is_status_3_and_names_what_is() {
    let done = call("run --headless --port /dev/ttyNowhere", &[]).expect(3);
    let error = done.error();
    assert!(error.contains("/dev/ttyNowhere"), "{error}");
    assert!(
        error.contains("there are: ") || error.contains("no serial port is there"),
        "{error}"
    );
    // Port 1 of this machine: nobody listens.
    let done = call("run --headless --port tcp:127.0.0.1:1", &[]).expect(3);
    assert!(done.error().contains("127.0.0.1:1"));
}

#[test]
fn a_unit_that_is_not_there_is_status_3_soon() {
    let lab = Lab::new("modbus-rtu");
    let start = now();
    let done = lab.run(&BenchFile {
        unit: 9,
        ..BenchFile::default()
    });
    done.expect(3).error();
    assert!(start.elapsed() < Duration::from_secs(20));
    assert!(!lab.out().exists(), "a run without a drive");
}

#[test]
fn a_second_host_on_the_same_port_is_status_3_and_the_first_goes_on() {
    for protocol in ["modbus-rtu", "stream"] {
        let lab = Lab::new(protocol);
        let mut first = lab.run_until_turning(protocol);
        let file = lab.desk.path("bench.toml");
        let other = lab.desk.path("other");
        let paths = [&*file, Path::new(&lab.port), &*other];
        let text = "run {} --port {} --out {} --headless";
        let second = Process::start(&line(text, &paths)).end();
        let error = second.expect(3).error();
        let holder = format!("pid {} (", first.0.id());
        assert!(error.contains(&holder), "{error}");
        assert!(!other.exists());
        let still = first.0.try_wait().expect("a child can be waited for");
        assert!(still.is_none(), "{protocol}: the first run ended");
        first.signal(Signal::SIGTERM);
        first.end().expect(130);
    }
}

#[test]
fn an_interrupt_stops_the_motor_and_keeps_the_record() {
    let lab = Lab::new("modbus-rtu");
    let run = lab.run_until_turning("modbus-rtu");
    run.signal(Signal::SIGINT);
    run.end().expect(130).error();
    let manifest = lab.manifest();
    assert_eq!(manifest["outcome"], "interrupted", "{manifest:#}");
    assert_eq!(manifest["finished"], true);
    let folder = only_folder(&lab.out());
    let samples = fs::read_to_string(folder.join("samples.csv")).expect("samples");
    assert_eq!(column(&samples, "voltage_cmd_v").last(), Some(&0.0));
    // The drive was told to stop: it is neither running nor did its watchdog have to act.
    let (status, fault, _, command_v) = wait_for("an answer", || telemetry(&lab.port));
    assert_ne!(status & STATE, RUNNING, "status {status:#x}");
    assert_eq!((fault, command_v), (0, 0.0));
    assert!(folder.join("report.html").exists());
}

#[test]
fn the_drive_stops_itself_when_its_host_is_killed() {
    let lab = Lab::new("modbus-rtu");
    let run = lab.run_until_turning("modbus-rtu");
    run.signal(Signal::SIGKILL);
    assert_eq!(run.end().status, -1);
    // Another program asks; reading alone does not kick the watchdog.
    let (status, fault, ..) = wait_for("the watchdog", || {
        telemetry(&lab.port).filter(|(status, ..)| status & STATE == FAULT)
    });
    assert_ne!(status & WATCHDOG_TRIPPED, 0, "status {status:#x}");
    assert_eq!(fault, WATCHDOG);
    // The output goes to zero as fast as the current limit lets it brake, and stays there.
    let at_rest = |(_, _, speed_rad_s, command_v): &(u16, u16, f64, f64)| {
        speed_rad_s.abs() < 2.0 && *command_v == 0.0
    };
    wait_for("the motor at rest", || telemetry(&lab.port).filter(at_rest));
    let later = wait_for("an answer", || telemetry(&lab.port));
    assert!(at_rest(&later), "{later:?}");
    // What was recorded until then is there, and says that it is not all.
    let folder = only_folder(&lab.out());
    assert_eq!(lab.manifest()["finished"], false);
    let opened = call("identify {} --json", &[&folder]);
    assert!(
        opened.status == 0 || opened.status == 5,
        "{}",
        opened.stderr
    );
    assert!(opened.stderr.contains("warning: "), "{}", opened.stderr);
    assert!(opened.stderr.contains("not finished"), "{}", opened.stderr);
    assert!(opened.json()["rows_dropped"].is_u64());
    // The fault stays latched: the next host is refused until somebody resets it by hand.
    fs::rename(lab.out(), lab.desk.path("before")).expect("renamed");
    let refused = lab.run(&BenchFile::default()).expect(3);
    assert!(refused.error().contains("fault"), "{}", refused.stderr);
    assert!(!lab.out().exists());
    // Each session has a line of its own behind the same path: the next host must not open the one that is going away.
    let mut line_of_reset = None;
    wait_for("the reset", || {
        line_of_reset = fs::read_link(&lab.port).ok();
        reset_fault(&lab.port)
    });
    wait_for("a fresh line", || {
        (fs::read_link(&lab.port).ok() != line_of_reset).then_some(())
    });
    let again = in_real_time(|| {
        let _ = fs::remove_dir_all(lab.out());
        (lab.run(&BenchFile::default()), ())
    });
    again.0.expect(0);
}

#[test]
fn a_motor_that_turns_faster_than_its_nameplate_says_is_a_safety_trip() {
    let lab = Lab::new("modbus-rtu");
    // The nameplate lets the plan expect 65 rad/s; the motor goes to more than 100.
    let done = lab.run(&BenchFile {
        back_emf_v_s_per_rad: 0.6,
        speed_rad_s: 85.0,
        ..BenchFile::default()
    });
    let done = done.expect(4);
    let error = done.error();
    assert!(error.contains("speed"), "{error}");
    let manifest = lab.manifest();
    let outcome = manifest["outcome"].as_str().unwrap_or_default();
    assert!(outcome.contains("trip"), "{manifest:#}");
    assert_eq!(manifest["finished"], true);
    // It brakes within the current limit, so the output may take a moment to reach zero.
    wait_for("zero output", || {
        telemetry(&lab.port)
            .filter(|(status, _, _, command_v)| status & STATE != RUNNING && *command_v == 0.0)
    });
}

#[test]
fn an_emulator_ends_quietly_and_takes_its_path_with_it() {
    let mut lab = Lab::new("modbus-rtu");
    let path = PathBuf::from(&lab.port);
    assert!(path.exists());
    lab.drive.process.signal(Signal::SIGTERM);
    let status = wait_for("the end of the emulator", || {
        lab.drive.process.0.try_wait().expect("a child")
    });
    assert_eq!(status.code(), Some(0));
    assert!(fs::symlink_metadata(&path).is_err());
}

#[test]
fn an_emulator_tells_its_states_as_json_one_object_a_line() {
    let desk = Desk::new();
    let (pty, sealed) = (desk.path("drive.pty"), desk.path("sealed.json"));
    let text = "emulate --json --mystery 3 --pty {} --seal {}";
    let mut drive = Process::start(&line(text, &[&pty, &sealed]));
    let mut stdout = BufReader::new(drive.0.stdout.take().expect("a pipe"));
    let mut state = || -> Value {
        let mut text = String::new();
        stdout.read_line(&mut text).expect("a line");
        serde_json::from_str(&text).expect("one object")
    };
    let ready = state();
    assert_eq!(
        ready,
        serde_json::json!({
            "state": "ready", "link": "modbus-rtu", "address": pty, "unit": 1, "baud": 115_200,
            "profile": "own", "sealed": sealed
        })
    );
    assert!(pty.exists());
    drive.signal(Signal::SIGINT);
    let stopped = state();
    assert_eq!(
        (&stopped["state"], &stopped["address"]),
        (&"stopped".into(), &ready["address"])
    );
    let status = wait_for("the end of the emulator", || {
        drive.0.try_wait().expect("a child")
    });
    assert_eq!(status.code(), Some(0));
}
