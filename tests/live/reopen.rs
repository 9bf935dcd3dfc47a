//! A drive that is lost in motion, over real pseudo-terminals and TCP: the run ends, the program finds the drive again,
//! brings it to rest and arms nothing.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::thread::{sleep, spawn};
use std::time::Duration;

use crate::kit::lab::BenchFile;
use crate::kit::prelude::*;
use nix::fcntl::OFlag;
use nix::pty::{PtyMaster, posix_openpt};

/// A folder for a bench file whose motor turns for a long time, its drives and its run.
struct Lab {
    desk: Desk,
    protocol: &'static str,
}

impl Lab {
    fn new(protocol: &'static str) -> Self {
        let desk = Desk::new();
        Self { desk, protocol }
    }

    fn drive(&self, seed: u32) -> Emulator {
        self.desk.drive(self.protocol, &format!("--seed {seed}"))
    }

    /// Starts a run and returns once the motor turns fast.
    fn run_until_turning(&self, port: &str, options: &str) -> Process {
        let bench = BenchFile::long(self.protocol).text();
        self.desk.until_turning(&bench, port, options)
    }

    /// A drive and a run over `protocol` in which the motor turns fast.
    fn turning(protocol: &'static str, options: &str) -> (Self, Emulator, Process) {
        let lab = Self::new(protocol);
        let drive = lab.drive(1);
        let run = lab.run_until_turning(&drive.port(), options);
        (lab, drive, run)
    }

    /// The same with everything that goes over the wire in a capture, which is given.
    fn turning_tapped(protocol: &'static str) -> (Self, Emulator, Process, PathBuf) {
        let lab = Self::new(protocol);
        let drive = lab.drive(1);
        let tap = lab.desk.path("tap.pcap");
        let options = format!("--reopen-s 60 --tap {}", tap.display());
        let run = lab.run_until_turning(&drive.port(), &options);
        (lab, drive, run, tap)
    }

    /// The same over TCP through a proxy.
    fn turning_behind_a_proxy() -> (Self, Emulator, Proxy, Process) {
        let lab = Self::new("modbus-tcp");
        let drive = lab.drive(1);
        let proxy = Proxy::new(&drive.address);
        let run = lab.run_until_turning(&format!("tcp:{}", proxy.address), "--reopen-s 60");
        (lab, drive, proxy, run)
    }

    fn events(&self) -> Vec<Value> {
        let text = self.desk.read("events.jsonl");
        text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
    }

    /// The first of this kind, which may be to come.
    fn event(&self, kind: &str) -> Value {
        wait_for(kind, || {
            let mut events = self.events().into_iter();
            events.find(|event| event["event"] == kind)
        })
    }

    /// The run is kept as lost, in one folder with what came after it.
    fn is_kept_as_lost(&self) {
        let manifest = self.desk.manifest();
        let outcome = manifest["outcome"].as_str().unwrap_or_default();
        assert!(outcome.starts_with("link lost"), "{manifest:#}");
        assert_eq!(manifest["finished"], true);
        assert!(manifest["reopened"]["ending"].is_string(), "{manifest:#}");
        let order: Vec<String> = self
            .events()
            .iter()
            .filter_map(|event| event["event"].as_str().map(str::to_owned))
            .filter(|kind| ["finished", "link_lost", "reopened"].contains(&kind.as_str()))
            .collect();
        assert_eq!(order, ["finished", "link_lost", "reopened"]);
    }
}

/// Terminals up to the one under this path, so that nobody gets its number again: other tests free lower ones.
fn take(path: &Path) -> Vec<PtyMaster> {
    let mut taken = Vec::new();
    while !path.exists() {
        taken.push(posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY).expect("a terminal"));
    }
    taken
}

/// Sequence numbers and control words of the commands in a capture of RTU frames, in order.
fn commands(capture: &Path) -> Vec<(u16, u16)> {
    let bytes = fs::read(capture).expect("a capture");
    let word = |at: usize| u16::from_be_bytes([bytes[at], bytes[at + 1]]);
    // Unit, function 23, 16 registers from 0 read, some from 32 written.
    let head = [1, 23, 0, 0, 0, 16, 0, 32];
    let frames = bytes.windows(17).enumerate();
    frames
        .filter(|(_, window)| window.starts_with(&head))
        .map(|(at, _)| (word(at + 11), word(at + 13)))
        .collect()
}

/// The program finds the drive again and brings it to rest.
#[track_caller]
fn is_stopped(run: Process) {
    let done = run.end().expect(3);
    assert_eq!(&done.json()["reopened"]["ending"], "stopped", "{}", done.stderr);
}

/// A control word with which the output is on (firmware-protocol/SPEC.md 2.2).
const fn energises(control: u16) -> bool {
    control >= 3
}

#[test]
fn a_drive_back_under_another_number_is_stopped_not_started() {
    for link in ["modbus-rtu", "stream"] {
        let (lab, drive, run, tap) = Lab::turning_tapped(link);
        let before = fs::read_link(&drive.address).expect("a symlink");
        drive.process.signal(Signal::SIGKILL);
        drop(drive);
        sleep(Duration::from_millis(950));
        let _taken = take(&before);
        let again = lab.drive(1);
        assert_ne!(fs::read_link(&again.address).expect("a symlink"), before);
        let done = run.end().fails(3, &["link lost", "stop confirmed; nothing is armed"]);
        let reopened = &done.json()["reopened"];
        assert_eq!(reopened["ending"], "stopped", "{reopened:#}");
        assert!(reopened["downtime_s"].as_f64() > Some(0.5), "{reopened:#}");
        assert!(reopened["attempts"].as_u64() > Some(1), "{reopened:#}");
        lab.is_kept_as_lost();
        assert_eq!(lab.event("link_lost")["watchdog_s"], 1.0);
        assert_eq!(lab.event("reopened")["state"], "disabled");
        if link == "modbus-rtu" {
            let commands = commands(&tap);
            let last_on = commands.iter().rposition(|(_, word)| energises(*word));
            let after = &commands[last_on.expect("it ran") + 1..];
            // The new link counts anew: its first command is the stop, and none that energises follows.
            let stop = after.iter().position(|(seq, _)| *seq == 1);
            let (_, control) = after[stop.expect("a command to the drive that is back")];
            assert_eq!(control, 1, "{after:?}");
        }
    }
}

#[test]
fn another_drive_under_the_same_name_is_only_read() {
    let (lab, drive, run, tap) = Lab::turning_tapped("modbus-rtu");
    drive.process.signal(Signal::SIGKILL);
    drop(drive);
    let _other = lab.drive(2);
    let done = run.end().expect(3);
    let error = done.error();
    has(&error, &["identity mismatch"]);
    has(&error, &["serial number is \"2\", before it was \"1\""]);
    assert_eq!(done.json()["reopened"]["ending"], "another_drive");
    let commands = commands(&tap);
    assert!(commands.len() > 10, "{commands:?}");
    let restarted = commands.windows(2).any(|pair| pair[1].0 < pair[0].0);
    assert!(!restarted, "something was written to the other drive");
    lab.is_kept_as_lost();
}

#[test]
fn a_drive_that_falls_silent_and_comes_back_is_stopped() {
    let (lab, drive, run) = Lab::turning("modbus-rtu", "--reopen-s 60");
    drive.process.signal(Signal::SIGSTOP);
    lab.event("link_lost");
    sleep(Duration::from_secs(1));
    drive.process.signal(Signal::SIGCONT);
    assert_eq!(run.end().fails(3, &["link silent"]).json()["reopened"]["ending"], "stopped");
    lab.is_kept_as_lost();
}

#[test]
fn a_search_ends_with_ctrl_c_or_its_time_or_at_once() {
    let (lab, drive, run) = Lab::turning("modbus-rtu", "");
    drop(drive);
    lab.event("link_lost");
    // 1 s of watchdog and 10 s would be its time.
    assert_eq!(lab.event("link_lost")["reopens_for_s"], 11.0);
    run.signal(Signal::SIGINT);
    assert_eq!(run.end().expect(3).json()["reopened"]["ending"], "interrupted");
    assert!(lab.event("reopened")["downtime_s"].as_f64() < Some(8.0));

    at_once([("--reopen-s 0.5", "given_up"), ("--reopen-s 0", "")], |(option, ending)| {
        let (_lab, drive, run) = Lab::turning("modbus-rtu", option);
        drop(drive);
        let result = run.end().expect(3).json();
        assert_eq!(result["reopened"]["ending"].as_str().unwrap_or_default(), ending);
    });
}

/// How the proxy treats a connection: bytes go through, go nowhere, or the connection is cut.
const THROUGH: u8 = 0;
const NOWHERE: u8 = 1;
const CUT: u8 = 2;

/// A switch between host and drive.
struct Proxy {
    address: String,
    mode: Arc<AtomicU8>,
}

impl Proxy {
    fn new(drive: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address").to_string();
        let mode = Arc::new(AtomicU8::new(THROUGH));
        let (drive, of_all) = (drive.to_owned(), Arc::clone(&mode));
        // It ends with the process of the tests.
        spawn(move || {
            for host in listener.incoming() {
                let (Ok(host), Ok(drive)) = (host, TcpStream::connect(&drive)) else {
                    continue;
                };
                let mode = Arc::clone(&of_all);
                spawn(move || carry(&host, &drive, &mode));
            }
        });
        Self { address, mode }
    }

    fn set(&self, mode: u8) {
        self.mode.store(mode, Ordering::SeqCst);
    }
}

/// Carries one connection until it is cut or an end closes. What is not read when it is cut makes the system answer with
/// a reset.
fn carry(host: &TcpStream, drive: &TcpStream, mode: &AtomicU8) {
    for stream in [host, drive] {
        let _ = stream.set_read_timeout(Some(Duration::from_millis(2)));
        let _ = stream.set_nodelay(true);
    }
    let mut bytes = [0; 512];
    loop {
        match mode.load(Ordering::SeqCst) {
            CUT => return,
            NOWHERE => {
                sleep(Duration::from_millis(5));
                continue;
            }
            _ => {}
        }
        for (mut from, mut to) in [(host, drive), (drive, host)] {
            match from.read(&mut bytes) {
                Ok(0) => return,
                Ok(count) => {
                    if to.write_all(&bytes[..count]).is_err() {
                        return;
                    }
                }
                Err(_) => {}
            }
        }
    }
}

#[test]
fn a_connection_that_is_cut_is_noticed_at_once_and_made_again() {
    let (lab, _drive, proxy, run) = Lab::turning_behind_a_proxy();
    proxy.set(CUT);
    let gone = lab.event("link_gone");
    proxy.set(THROUGH);
    is_stopped(run);
    let lost = lab.event("link_lost")["time_s"].as_f64();
    let after_s = lost.zip(gone["time_s"].as_f64()).map(|(a, b)| a - b);
    assert!(after_s < Some(2.0), "{after_s:?}");
    lab.is_kept_as_lost();
}

#[test]
fn a_dead_connection_is_lost_after_the_allowed_silence() {
    let (lab, _drive, proxy, run) = Lab::turning_behind_a_proxy();
    proxy.set(NOWHERE);
    let trip = lab.event("trip");
    assert_eq!(trip["trip"]["kind"], "link_silence", "{trip:#}");
    // 0.95 s are allowed; a loaded machine looks a little later. TCP itself would take minutes.
    assert!(trip["trip"]["value"].as_f64() < Some(3.0), "{trip:#}");
    lab.event("link_lost");
    proxy.set(THROUGH);
    is_stopped(run);
    lab.is_kept_as_lost();
}
