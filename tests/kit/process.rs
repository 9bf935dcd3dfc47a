//! Processes of the real binary that a test watches and ends, and the waiting for what they do in real time.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use tokio_modbus::client::{Context, rtu::attach_slave};
use tokio_modbus::prelude::{Reader, Slave};

use super::{Done, command, line};

/// Whatever is waited for must have come by then; only a hung program takes so long.
const PATIENCE: Duration = Duration::from_secs(90);
const POLL: Duration = Duration::from_millis(20);

#[expect(
    clippy::disallowed_methods,
    reason = "these tests run in real time and must end"
)]
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
        let mut done = Done {
            status: status.code().unwrap_or(-1),
            stdout: String::new(),
            stderr: String::new(),
        };
        if let Some(mut stdout) = self.0.stdout.take() {
            stdout.read_to_string(&mut done.stdout).expect("text");
        }
        if let Some(mut stderr) = self.0.stderr.take() {
            stderr.read_to_string(&mut done.stderr).expect("text");
        }
        done
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
        let mut process = Process::start(&line(arguments, paths));
        let stdout = process.0.stdout.as_mut().expect("it is a pipe");
        let mut ready = String::new();
        // It prints nothing after this line, so that nothing can be lost in the reader's buffer.
        let read = BufReader::new(stdout).read_line(&mut ready);
        read.expect("a line of text");
        let address = ready.split_whitespace().nth(2);
        assert!(address.is_some(), "{ready:?} is no ready line");
        let address = address.unwrap_or_default().to_owned();
        Self {
            process,
            ready,
            address,
        }
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

/// Another program's request to the drive; nothing where the port or the drive does not answer.
pub(crate) fn ask<T>(
    port: &str,
    request: impl AsyncFnOnce(&mut Context) -> tokio_modbus::Result<T>,
) -> Option<T> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
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
    ask(port, async |client| {
        client.read_holding_registers(0, 16).await
    })
}

/// What the first register of the telemetry says.
pub(crate) const STATE: u16 = 0b111;
pub(crate) const RUNNING: u16 = 2;
pub(crate) const FAULT: u16 = 3;
pub(crate) const WATCHDOG_TRIPPED: u16 = 1 << 6;
