//! The C reference slave as a drive of its own: another language, another motor model, a process of its own. The real
//! binary identifies it and runs its speed loop over a pseudo-terminal, on both of its links.

#[path = "../../firmware-protocol/tests/c_compiler/mod.rs"]
mod c_compiler;

use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::process::Command;
use std::sync::mpsc::channel;
use std::thread::{sleep, spawn};
use std::time::Duration;

use crate::kit::lab::{BenchFile, LIMITS};
use crate::kit::prelude::*;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Whatever is waited for must have come by then.
const PATIENCE: Duration = Duration::from_secs(240);
const POLL: Duration = Duration::from_millis(20);

/// The motor as in `firmware-protocol/c/example/motor_drive.c`; the tests identify it, so the bench has only the plate.
fn bench(link: &str) -> String {
    BenchFile {
        link: format!("protocol = {link:?}\nrate_hz = 50.0\ndeadline_ms = 400.0"),
        limits: &LIMITS.replace("0.95", "0.75"),
        speed: "[speed]\ncontroller = \"addc\"\n[[speed.reference]]\n\
                square = { low_rad_s = 60.0, high_rad_s = 90.0, half_period_s = 1.5, periods = 1 }",
        ..BenchFile::short(link)
    }
    .text()
}

/// The drive in its own process.
fn drive(desk: &Desk, link: &str) -> Emulator {
    let binary = c_compiler::build("example/motor_drive.c", desk.folder());
    let port = desk.path("drive");
    let mut command = Command::new(binary);
    command.args(["--link", link, "--pty"]).arg(&port);
    let drive = Emulator::of(Process::of(command));
    let port = port.display();
    assert_eq!(drive.ready, format!("ready {link} {port} unit=1 baud=115200 profile=own\n"));
    drive
}

/// Runs a command of the program against the C drive; gives its output and the folder of its run.
#[track_caller]
fn done(command: &str, link: &str) -> (Done, Desk) {
    let (done, desk) = in_real_time(|| {
        let desk = Desk::new();
        let drive = drive(&desk, link);
        (desk.at_port(command, &bench(link), &drive.port(), "--json"), desk)
    });
    (done.expect(0), desk)
}

#[track_caller]
fn is_identified(link: &str) {
    let (done, desk) = done("run --headless", link);
    assert_eq!(done.json()["outcome"], "done", "{}", done.stdout);
    let manifest = desk.manifest();
    assert_eq!(manifest["finished"], true);
    assert_eq!(manifest["outcome"], "passed", "{manifest:#}");
    // Only this drive calls itself so; over the stream nobody has a name.
    if link == "modbus-rtu" {
        assert!(manifest.to_string().contains("reference slave in C"), "{manifest:#}");
    }
    let found = json_of("identify {} --json", &[&desk.run()]);
    for (key, truth, tolerance) in [
        ("resistance_ohm", 1.1, 0.1),
        ("back_emf_v_s_per_rad", 0.3538, 0.05),
        ("inertia_kg_m2", 0.0045, 0.15),
        ("load_torque_n_m", 0.455, 0.25),
    ] {
        expect_near(key, parameter(&found, key), truth, tolerance);
    }
}

#[track_caller]
fn keeps_its_speed(link: &str) {
    let (done, _desk) = done("speed", link);
    let found = done.json();
    assert_eq!(found["outcome"], "done", "{found:#}");
    let steps = found["loop"]["steps"].as_array().expect("steps");
    assert_eq!(steps.len(), 2, "{found:#}");
    // 30 rad/s over 1.5 s are 45 rad if nothing happens; how much less depends on how busy the machine is.
    let error = steps[1]["absolute_error_rad"].as_f64().expect("a number");
    assert!(error < 20.0, "{}", steps[1]);
}

#[test]
fn the_c_drive_is_identified_and_keeps_its_speed_on_each_link() {
    let tests: [fn(&str); 2] = [is_identified, keeps_its_speed];
    at_once(
        tests.iter().flat_map(|test| ["modbus-rtu", "stream"].map(|link| (test, link))),
        |(test, link)| {
            test(link);
        },
    );
}

#[test]
fn a_host_of_the_other_protocol_gets_that_reason() {
    let desk = Desk::new();
    let drive = drive(&desk, "modbus-rtu");
    desk.at_port("run", &bench("stream"), &drive.port(), "--headless").expect(3).error();
}

/// Function code 08 and back; `None` where the pseudo-terminal is just being replaced.
fn echoes(port: &Path) -> Option<()> {
    const ECHO: [u8; 8] = [0x01, 0x08, 0x00, 0x00, 0xA5, 0x37, 0xDA, 0x8D];
    let mut host = fs::OpenOptions::new().read(true).write(true).open(port).ok()?;
    host.write_all(&ECHO).ok()?;
    let mut answer = Vec::new();
    while answer.len() < ECHO.len() {
        // A request that met the end of the host before is lost with it: nothing comes, and it is sent again.
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
    let desk = Desk::new();
    let drive = drive(&desk, "modbus-rtu");
    let port = PathBuf::from(drive.port());
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
