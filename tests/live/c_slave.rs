//! The C reference slave as a drive of its own: another language, another motor model, a process of its own. The real
//! binary identifies it and runs its speed loop over a pseudo-terminal, on both of its links.

#[path = "../../firmware-protocol/tests/c_compiler/mod.rs"]
mod c_compiler;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::channel;
use std::thread::{sleep, spawn};
use std::time::Duration;

use crate::kit::process::Process;
use crate::kit::{Desk, Done, call, json_of, manifest, only_folder, parameter};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// A machine that stands still for longer than the drive's watchdog loses the link, and nobody is to blame.
const ATTEMPTS: usize = 3;
const LINK_LOST: i32 = 3;
/// Whatever is waited for must have come by then.
const PATIENCE: Duration = Duration::from_secs(240);
const POLL: Duration = Duration::from_millis(20);

/// The motor as in `firmware-protocol/c/example/motor_drive.c`; the tests identify it, so the bench knows only the plate.
const BENCH: &str = r#"
name = "c-drive"
[drive]
profile = "own"
[link]
port = "/dev/given-by-port"
protocol = "PROTOCOL"
unit = 1
rate_hz = 50.0
deadline_ms = 400.0
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
current_a = 11.0
speed_rad_s = 340.0
voltage_v = 110.0
slew_v_per_s = 200.0
link_silence_s = 0.75
[speed]
controller = "addc"
[[speed.reference]]
square = { low_rad_s = 60.0, high_rad_s = 90.0, half_period_s = 1.5, periods = 1 }
[[sequence]]
standstill = { seconds = 0.5 }
[[sequence]]
steps = { levels_v = [40.0, -40.0, 0.0], hold_s = 0.5 }
"#;

/// The drive in its own process.
struct Drive {
    _process: Process,
    desk: Desk,
    port: PathBuf,
    ready: String,
}

impl Drive {
    /// `None` where the tests were told to do without a C compiler.
    fn start(link: &str) -> Option<Self> {
        let desk = Desk::new();
        let binary = c_compiler::build("example/motor_drive.c", desk.folder())?;
        let port = desk.path("drive");
        let mut command = Command::new(binary);
        command.args(["--link", link, "--pty"]).arg(&port);
        let mut process = Process::of(command);
        let mut ready = String::new();
        BufReader::new(process.0.stdout.as_mut().expect("it is a pipe"))
            .read_line(&mut ready)
            .expect("a line of text");
        Some(Self {
            _process: process,
            desk,
            port,
            ready,
        })
    }
}

/// Runs a command of the program against the C drive until the link holds; gives what it said and the folder of its run.
#[track_caller]
fn attempt(command: &str, link: &str, bench: &str) -> Option<(Done, PathBuf, Drive)> {
    for number in 1.. {
        let drive = Drive::start(link)?;
        let wanted = format!(
            "ready {link} {} unit=1 baud=115200 profile=own\n",
            drive.port.display()
        );
        assert_eq!(drive.ready, wanted);
        let file = drive
            .desk
            .put("bench.toml", &bench.replace("PROTOCOL", link));
        let out = drive.desk.path("runs");
        let paths: [&Path; 3] = [&file, &drive.port, &out];
        let text = format!("{command} {{}} --port {{}} --out {{}} --json");
        let done = call(&text, &paths);
        if done.status == LINK_LOST && number < ATTEMPTS {
            c_compiler::aloud(&format!(
                "the link was lost (attempt {number} of {ATTEMPTS}), trying again:\n{}",
                done.stderr
            ));
            continue;
        }
        let done = done.expect(0);
        return Some((done, only_folder(&out), drive));
    }
    None
}

#[track_caller]
fn is_identified(link: &'static str) {
    let Some((done, folder, drive)) = attempt("run --headless", link, BENCH) else {
        return;
    };
    assert_eq!(done.json()["outcome"], "done", "{}", done.stdout);
    let manifest = manifest(&drive.desk.path("runs"));
    assert_eq!(manifest["finished"], true);
    assert_eq!(manifest["outcome"], "passed", "{manifest:#}");
    // Only this drive calls itself so; over the stream nobody has a name.
    if link == "modbus-rtu" {
        assert!(
            manifest.to_string().contains("reference slave in C"),
            "{manifest:#}"
        );
    }
    let found = json_of("identify {} --json", &[&folder]);
    for (key, truth, tolerance) in [
        ("resistance_ohm", 1.1, 0.1),
        ("back_emf_v_s_per_rad", 0.3538, 0.05),
        ("inertia_kg_m2", 0.0045, 0.15),
        ("load_torque_n_m", 0.455, 0.25),
    ] {
        let value = parameter(&found, key);
        assert!(
            value.is_some_and(|value| (value / truth - 1.0).abs() < tolerance),
            "{key}: {found:#}"
        );
    }
}

#[test]
fn the_c_drive_is_identified_over_modbus_rtu() {
    is_identified("modbus-rtu");
}

#[test]
fn the_c_drive_is_identified_over_the_stream() {
    is_identified("stream");
}

#[track_caller]
fn keeps_its_speed(link: &'static str) {
    let Some((done, _, _drive)) = attempt("speed", link, BENCH) else {
        return;
    };
    let found = done.json();
    assert_eq!(found["outcome"], "done", "{found:#}");
    let steps = found["loop"]["steps"].as_array().expect("steps");
    assert_eq!(steps.len(), 2, "{found:#}");
    // 30 rad/s over 1.5 s are 45 rad if nothing happens; how much less depends on how busy the machine is.
    let error = steps[1]["absolute_error_rad"].as_f64().expect("a number");
    assert!(error < 20.0, "{}", steps[1]);
}

#[test]
fn the_c_drive_keeps_its_speed_over_modbus_rtu() {
    keeps_its_speed("modbus-rtu");
}

#[test]
fn the_c_drive_keeps_its_speed_over_the_stream() {
    keeps_its_speed("stream");
}

#[test]
fn a_host_that_speaks_the_other_protocol_is_told_so() {
    let Some(drive) = Drive::start("modbus-rtu") else {
        return;
    };
    let file = drive
        .desk
        .put("bench.toml", &BENCH.replace("PROTOCOL", "stream"));
    let out = drive.desk.path("runs");
    let paths: [&Path; 3] = [&file, &drive.port, &out];
    let text = "run {} --port {} --out {} --headless";
    call(text, &paths).expect(LINK_LOST).error();
}

/// Function code 08 and back; `None` where the pseudo-terminal is just being replaced.
fn echoes(port: &Path) -> Option<()> {
    const ECHO: [u8; 8] = [0x01, 0x08, 0x00, 0x00, 0xA5, 0x37, 0xDA, 0x8D];
    let mut host = fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(port)
        .ok()?;
    host.write_all(&ECHO).ok()?;
    let mut answer = Vec::new();
    while answer.len() < ECHO.len() {
        // A request that met the end of the host before is lost with it: nothing comes, and it is asked again.
        let mut fds = [PollFd::new(host.as_fd(), PollFlags::POLLIN)];
        if poll(&mut fds, PollTimeout::from(2000_u16)).ok()? == 0 {
            return None;
        }
        let mut bytes = [0; ECHO.len()];
        let count = host.read(&mut bytes).ok().filter(|count| *count > 0)?;
        answer.extend_from_slice(&bytes[..count]);
    }
    assert_eq!(answer, ECHO);
    Some(())
}

#[test]
fn the_c_drive_serves_one_host_after_another() {
    let Some(drive) = Drive::start("modbus-rtu") else {
        return;
    };
    let port = drive.port.clone();
    let (sender, done) = channel();
    // It may wait for an answer for ever; the test does not.
    spawn(move || {
        for _ in 0..3 {
            while echoes(&port).is_none() {
                sleep(POLL);
            }
        }
        // Who waits may have given up.
        let _ = sender.send(());
    });
    done.recv_timeout(PATIENCE).expect("three hosts are served");
}
