//! A command of this program as a process of its own: a time limit, an end that stops the motor, and what it said.
//!
//! A process and no thread: a case that crashes or hangs is an error of that case. It is asked to end first, so that its
//! guard brings the motor to zero; only one that does not is killed, and then the drive's watchdog stops the motor.

use std::fs::File;
use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Between two looks at a process.
const LOOK: Duration = Duration::from_millis(5);
/// Time that a process has to end in after it was asked to.
const GRACE: Duration = Duration::from_secs(15);

/// How a process ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// By itself, with this exit status.
    Status(u8),
    /// It did not end in its time, and did so when it was asked to.
    Asked,
    /// It had to be killed, or was by a signal.
    Killed,
}

/// A process that ended.
pub(super) struct Done {
    pub(super) end: End,
    pub(super) took_s: f64,
}

/// A watch on how long something takes.
pub(super) struct Watch(Instant);

impl Watch {
    #[expect(
        clippy::disallowed_methods,
        reason = "a time limit on a process is in real time"
    )]
    pub(super) fn start() -> Self {
        Self(Instant::now())
    }

    pub(super) fn took_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}

/// Runs `command`, whose results and messages go to these files, for `timeout_s` at most or until `stop` is raised.
pub(super) fn finish(
    mut command: Command,
    stdout: &Path,
    stderr: &Path,
    timeout_s: f64,
    stop: &AtomicBool,
) -> io::Result<Done> {
    let watch = Watch::start();
    let mut child = command
        .stdin(Stdio::null())
        .stdout(File::create(stdout)?)
        .stderr(File::create(stderr)?)
        // A key at the terminal is for the suite, which asks the command to end: twice at once would cut its ramp short.
        .process_group(0)
        .spawn()?;
    let end = loop {
        if let Some(status) = child.try_wait()? {
            break ended(status);
        }
        if watch.took_s() > timeout_s || stop.load(Ordering::Acquire) {
            break end(&mut child)?;
        }
        std::thread::sleep(LOOK);
    };
    Ok(Done {
        end,
        took_s: watch.took_s(),
    })
}

fn ended(status: ExitStatus) -> End {
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    code.map_or(End::Killed, End::Status)
}

fn end(child: &mut Child) -> io::Result<End> {
    if let Ok(id) = i32::try_from(child.id()) {
        // A process that has ended in between is waited for all the same.
        let _ = kill(Pid::from_raw(id), Signal::SIGTERM);
    }
    let asked = Watch::start();
    while asked.took_s() < GRACE.as_secs_f64() {
        if child.try_wait()?.is_some() {
            return Ok(End::Asked);
        }
        std::thread::sleep(LOOK);
    }
    child.kill()?;
    child.wait()?;
    Ok(End::Killed)
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
    fn a_process_ends_by_itself_or_is_asked_to() {
        let (done, out) = shell("echo said; exit 4", 60.0);
        assert_eq!((done.end, out.as_str()), (End::Status(4), "said\n"));
        let (done, out) = shell(
            "trap 'echo stopped; exit 130' TERM; while :; do sleep 0.01; done",
            0.3,
        );
        assert_eq!((done.end, out.as_str()), (End::Asked, "stopped\n"));
        assert_eq!(shell("kill -KILL $$", 60.0).0.end, End::Killed);
    }
}
