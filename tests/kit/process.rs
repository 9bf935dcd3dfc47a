//! Processes of the real binary that a test watches and ends, and the waiting for what they do in real time.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Mutex;
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::sys::signal::kill;
use nix::unistd::Pid;
use tokio_modbus::client::{Context, rtu::attach_slave};
use tokio_modbus::prelude::{Reader, Slave};

use super::command;
use super::prelude::*;

/// Whatever is waited for must have come by then; only a hung program takes so long.
const PATIENCE: Duration = Duration::from_secs(90);
const POLL: Duration = Duration::from_millis(20);

#[expect(clippy::disallowed_methods, reason = "these tests run in real time and must end")]
pub(crate) fn now() -> Instant {
    Instant::now()
}

/// Polls until there is something; a loaded machine only takes longer.
#[track_caller]
pub(crate) fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "waited too long for {what}");
        sleep(POLL);
    }
}

/// A child process that never outlives its test.
pub(crate) struct Process(pub(crate) Child);

impl Process {
    pub(crate) fn start(arguments: &[PathBuf]) -> Self {
        Self::of(command(arguments))
    }

    pub(crate) fn of(mut command: Command) -> Self {
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().expect("the program can be started"))
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let id = i32::try_from(self.0.id()).expect("a process id fits");
        kill(Pid::from_raw(id), signal).expect("the process is ours and still there");
    }

    /// Waits for the end. What it prints is little, so that the pipes never fill.
    #[track_caller]
    pub(crate) fn end(mut self) -> Done {
        let status = wait_for("the end of a process", || {
            self.0.try_wait().expect("a child can be waited for")
        });
        let read = |pipe: Option<&mut dyn Read>| {
            let mut bytes = Vec::new();
            pipe.map(|pipe| pipe.read_to_end(&mut bytes).expect("the pipe can be read"));
            bytes
        };
        Done::of(&Output {
            status,
            stdout: read(self.0.stdout.as_mut().map(|pipe| pipe as _)),
            stderr: read(self.0.stderr.as_mut().map(|pipe| pipe as _)),
        })
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Gone already is just as well.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A software drive in a process of its own.
pub(crate) struct Emulator {
    pub(crate) process: Process,
    /// The line with which it said that it is there.
    pub(crate) ready: String,
    /// Path of the terminal, or HOST:PORT.
    pub(crate) address: String,
}

impl Emulator {
    /// `{}` in the arguments are the paths.
    #[track_caller]
    pub(crate) fn start(arguments: &str, paths: &[&Path]) -> Self {
        Self::of(Process::start(&line(arguments, paths)))
    }

    /// A process that says on its first line where the drive is.
    #[track_caller]
    pub(crate) fn of(mut process: Process) -> Self {
        let stdout = process.0.stdout.as_mut().expect("it is a pipe");
        let mut ready = String::new();
        // It prints nothing after this line, so that nothing can be lost in the reader's buffer.
        let read = BufReader::new(stdout).read_line(&mut ready);
        read.expect("a line of text");
        let address = ready.split_whitespace().nth(2);
        assert!(address.is_some(), "{ready:?} is no ready line");
        let address = address.unwrap_or_default().to_owned();
        Self { process, ready, address }
    }

    /// Over `link`: on a free TCP port, or on a pseudo-terminal under the path `pty`.
    #[track_caller]
    pub(crate) fn on(link: &str, pty: &Path, arguments: &str, paths: &[&Path]) -> Self {
        let text = format!("emulate {arguments} --link {link}");
        if link == "modbus-tcp" {
            return Self::start(&format!("{text} --listen 127.0.0.1:0"), paths);
        }
        Self::start(&format!("{text} --pty {{}}"), &[paths, &[pty]].concat())
    }

    /// As `--port` takes it.
    pub(crate) fn port(&self) -> String {
        if self.address.contains(':') {
            format!("tcp:{}", self.address)
        } else {
            self.address.clone()
        }
    }
}

/// How long the threads of processes have been kept waiting for a processor, ns: nothing that they could help.
#[derive(Default)]
pub(crate) struct KeptWaiting(HashMap<PathBuf, u64>);

impl KeptWaiting {
    /// The longest wait of a thread that has ended since the last look, s.
    pub(crate) fn since_last_look_s(&mut self, process: u32) -> f64 {
        let tasks = fs::read_dir(format!("/proc/{process}/task"));
        let mut longest = 0;
        for task in tasks.into_iter().flatten().flatten() {
            let waited = fs::read_to_string(task.path().join("schedstat")).ok();
            let waited = waited.and_then(|text| text.split(' ').nth(1)?.parse().ok());
            if let Some(waited) = waited {
                let before = self.0.insert(task.path(), waited);
                longest = longest.max(waited.saturating_sub(before.unwrap_or(waited)));
            }
        }
        longest as f64 * 1e-9
    }

    /// The same of all processes that this one has started.
    fn of_children_s(&mut self) -> f64 {
        let tasks = fs::read_dir("/proc/self/task").expect("Linux lists our threads");
        let children = tasks.flatten().filter_map(|task| {
            let text = fs::read_to_string(task.path().join("children")).ok()?;
            Some(text.split(' ').filter_map(|id| id.parse().ok()).collect())
        });
        let children: Vec<Vec<u32>> = children.collect();
        let waits = children.concat().into_iter().map(|id| self.since_last_look_s(id));
        waits.fold(0.0, f64::max)
    }
}

/// A machine that kept a thread of a test's processes from running for this long has stood still, s: the least time in which
/// a reply has to be there, so that shorter waits lose nothing.
const STOOD_STILL_S: f64 = 0.02;
/// Statuses of a link that was lost and of a trip: what a machine that stands still ends in, as it must.
const LOST: [i32; 2] = [3, 4];
const ATTEMPTS: u32 = 5;

/// A command in real time, with what it left behind. It is repeated only where it lost its link and the machine is seen to
/// have stood still meanwhile, which says nothing of what is tested; whatever else goes wrong stands.
pub(crate) fn in_real_time<T>(attempt: impl FnMut() -> (Done, T)) -> (Done, T) {
    unless_it_stood_still(attempt, |(done, _)| {
        if LOST.contains(&done.status) { Err(done.stderr.clone()) } else { Ok(()) }
    })
}

/// What an attempt in real time gives. One of which `is_right` says what is wrong is repeated, where the machine is seen to have
/// stood still meanwhile; the last stands.
pub(crate) fn unless_it_stood_still<T>(
    mut attempt: impl FnMut() -> T,
    is_right: impl Fn(&T) -> Result<(), String>,
) -> T {
    for number in 1..ATTEMPTS {
        let (given, stood_still_s) = watched(&mut attempt);
        let Err(wrong) = is_right(&given) else {
            return given;
        };
        if stood_still_s < STOOD_STILL_S {
            return given;
        }
        // Past the capture of the test harness, which keeps the output of a test that passes to itself.
        let told = format!(
            "attempt {number} of {ATTEMPTS}: the machine stood still for {stood_still_s:.3} s\n{wrong}\n"
        );
        let _ = std::io::Write::write_all(&mut std::io::stderr(), told.as_bytes());
    }
    attempt()
}

/// So many wait for time to pass beside each other: hosts and drives that a busy machine still carries.
const AT_ONCE: usize = 4;

/// The same for each, [`AT_ONCE`] beside each other: what waits for time to pass need not wait for its neighbours too.
#[track_caller]
pub(crate) fn at_once<T: Send>(
    all: impl IntoIterator<Item = T, IntoIter: Send>,
    work: impl Fn(T) + Sync,
) {
    let all = Mutex::new(all.into_iter());
    let next = || all.lock().expect("no neighbour fails while it takes one").next();
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some(one) = next() {
                    work(one);
                }
            });
        }
    });
}

/// What something gives, and the longest time for which it or a child of ours was kept waiting meanwhile, s.
fn watched<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let (over, is_over) = std::sync::mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let watch = scope.spawn(move || {
            let (mut kept, mut longest_s, mut before) = (KeptWaiting::default(), 0.0_f64, now());
            while is_over.recv_timeout(POLL) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                let late = before.elapsed().saturating_sub(POLL);
                longest_s = longest_s.max(late.as_secs_f64()).max(kept.of_children_s());
                before = now();
            }
            longest_s
        });
        let given = work();
        drop(over);
        (given, watch.join().expect("the watch ends"))
    })
}

/// Another program's request to the drive; nothing where the port or the drive does not answer.
pub(crate) fn ask<T>(
    port: &str,
    request: impl AsyncFnOnce(&mut Context) -> tokio_modbus::Result<T>,
) -> Option<T> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let talk = async {
        let serial = tokio_serial::SerialStream::open(&tokio_serial::new(port, 115_200)).ok()?;
        let mut client = attach_slave(serial, Slave(1));
        request(&mut client).await.ok()?.ok()
    };
    let talk = async { tokio::time::timeout(Duration::from_secs(2), talk).await };
    runtime.block_on(talk).ok()?
}

/// Its first sixteen registers (firmware-protocol/SPEC.md 2.1), read by another program, which does not kick its watchdog.
pub(crate) fn telemetry(port: &str) -> Option<Vec<u16>> {
    ask(port, async |client| client.read_holding_registers(0, 16).await)
}

/// What the first register of the telemetry says.
pub(crate) const STATE: u16 = 0b111;
pub(crate) const RUNNING: u16 = 2;
pub(crate) const FAULT: u16 = 3;
pub(crate) const WATCHDOG_TRIPPED: u16 = 1 << 6;
