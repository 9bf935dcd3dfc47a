//! A command of this program as a process of its own: a time limit, an end that stops the motor, and its error message.
//!
//! A process, not a thread: a case that crashes or hangs is an error of that case. It gets SIGTERM first, so that its guard
//! brings the motor to zero; only one that does not end is killed, and then the drive's watchdog stops the motor. Where the
//! suite itself is gone the kernel sends the signal (on Linux): no command continues unsupervised.

use std::fs::{self, File};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

/// Between two polls of a process.
pub(super) const POLL: Duration = Duration::from_millis(5);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// By itself, with this exit status.
    Status(u8),
    /// It did not end in its time, and did so by SIGTERM: with this exit status, or none.
    Terminated(Option<u8>),
    /// It had to be killed, or was by a signal.
    Killed,
}

pub(super) struct Done {
    pub(super) end: End,
    pub(super) took_s: f64,
}

pub(super) struct Watch(Instant);

impl Watch {
    #[expect(clippy::disallowed_methods, reason = "a time limit on a process is in real time")]
    pub(super) fn start() -> Self {
        Self(Instant::now())
    }

    pub(super) fn took_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}

/// Starts `command` in a group of its own. Ctrl-C at the terminal is for the suite, which ends the command: two signals would
/// cut its ramp short.
pub(super) fn start(mut command: Command) -> io::Result<Child> {
    command.process_group(0);
    #[cfg(target_os = "linux")]
    end_with_parent(&mut command);
    command.spawn()
}

/// The process gets SIGTERM when the thread that starts it is gone, for whatever reason.
#[cfg(target_os = "linux")]
fn end_with_parent(command: &mut Command) {
    use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};
    let parent = getpid();
    let prepare = move || {
        set_parent_process_death_signal(Some(Signal::TERM))?;
        // The parent may have ended before this call.
        if getppid() != Some(parent) {
            return Err(io::Error::from(io::ErrorKind::NotConnected));
        }
        Ok(())
    };
    #[expect(
        unsafe_code,
        reason = "between fork and exec nothing may allocate or lock; these are system calls alone"
    )]
    // SAFETY: the closure reads its copy of `parent` and makes system calls alone.
    unsafe {
        command.pre_exec(prepare);
    }
}

/// From now on a read of this end returns at once.
pub(super) fn do_not_block(end: impl AsFd) -> io::Result<()> {
    let flags = rustix::fs::fcntl_getfl(&end)?;
    Ok(rustix::fs::fcntl_setfl(&end, flags | rustix::fs::OFlags::NONBLOCK)?)
}

/// Runs `command`, whose results and messages go to these files, for `timeout_s` at most or until `stop` is raised.
pub(super) fn finish(
    mut command: Command,
    stdout: &Path,
    stderr: &Path,
    timeout_s: f64,
    stop: &AtomicBool,
) -> io::Result<Done> {
    command.stdin(Stdio::null());
    command.stdout(File::create(stdout)?);
    command.stderr(File::create(stderr)?);
    let mut child = start(command)?;
    let watch = Watch::start();
    let end = loop {
        if let Some(status) = child.try_wait()? {
            break code_of(status).map_or(End::Killed, End::Status);
        }
        if watch.took_s() > timeout_s || stop.load(Ordering::Acquire) {
            let ended = end(&mut child, 15.0)?;
            break ended.map_or(End::Killed, |status| End::Terminated(code_of(status)));
        }
        std::thread::sleep(POLL);
    };
    Ok(Done { end, took_s: watch.took_s() })
}

fn code_of(status: ExitStatus) -> Option<u8> {
    status.code().and_then(|code| u8::try_from(code).ok())
}

/// Terminates a process; its status, unless it has to be killed because it does not end within `patience_s`.
pub(super) fn end(child: &mut Child, patience_s: f64) -> io::Result<Option<ExitStatus>> {
    if let Ok(id) = i32::try_from(child.id()) {
        // A process that has just ended is no error.
        let _ = kill(Pid::from_raw(id), Signal::SIGTERM);
    }
    let watch = Watch::start();
    while watch.took_s() < patience_s {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        std::thread::sleep(POLL);
    }
    child.kill()?;
    child.wait()?;
    Ok(None)
}

pub(super) fn error_message(stderr: &Path) -> Option<String> {
    let text = fs::read_to_string(stderr).ok()?;
    let mut lines = text.lines().filter(|line| line.starts_with("{\"error\""));
    let Some(line) = lines.next_back() else {
        let (_, message) = text.rsplit_once("error: ")?;
        return message.lines().next().map(str::to_owned);
    };
    let error: Value = serde_json::from_str(line).ok()?;
    error.pointer("/error/message")?.as_str().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, timeout_s: f64) -> (Done, String) {
        let folder = tempfile::tempdir().unwrap();
        let [out, err] = ["out", "err"].map(|name| folder.path().join(name));
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        let done = finish(command, &out, &err, timeout_s, &AtomicBool::new(false)).unwrap();
        (done, std::fs::read_to_string(out).unwrap())
    }

    #[test]
    fn a_process_ends_by_itself_or_is_terminated() {
        for (script, timeout_s, expected, output) in [
            ("echo said; exit 4", 60.0, End::Status(4), "said\n"),
            (
                "trap 'echo stopped; exit 130' TERM; while :; do sleep 0.01; done",
                0.3,
                End::Terminated(Some(130)),
                "stopped\n",
            ),
            ("trap 'exit 6' TERM; while :; do sleep 0.01; done", 0.3, End::Terminated(Some(6)), ""),
            // It has no handler.
            ("exec sleep 60", 0.3, End::Terminated(None), ""),
            ("kill -KILL $$", 60.0, End::Killed, ""),
        ] {
            let (done, printed) = shell(script, timeout_s);
            assert_eq!((done.end, printed.as_str()), (expected, output), "{script}");
        }
    }
}
