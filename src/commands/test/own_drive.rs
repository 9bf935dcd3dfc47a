//! A software drive in a process of its own: it outlives the commands of its case.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::Value;

use super::process::{self, Watch};
use drivebench_link::Protocol;

pub(super) struct DriveOrder<'a> {
    pub(super) program: &'a Path,
    pub(super) folder: &'a Path,
    /// Of its files, among several in one folder.
    pub(super) name: String,
    /// Embedded name or file of its motor.
    pub(super) emulator: String,
    pub(super) profile: String,
    pub(super) protocol: Protocol,
    pub(super) seed: u64,
    /// The suite was interrupted.
    pub(super) stop: &'a AtomicBool,
}

/// Dropping it ends the process, and waits for that.
pub(super) struct OwnDrive {
    child: Child,
    /// Path of the terminal, or HOST:PORT.
    address: String,
    is_network: bool,
}

impl OwnDrive {
    /// Starts the process; returns once the drive can be opened, within 60 s.
    pub(super) fn start(order: &DriveOrder<'_>) -> io::Result<Self> {
        let file = |ending: &str| order.folder.join(format!("{}{ending}", order.name));
        let is_network = order.protocol.is_network();
        let mut command = Command::new(order.program);
        command.args(["emulate", &order.emulator]);
        command.args(["--profile", &order.profile]);
        command.args(["--link", order.protocol.name()]);
        command.args(["--seed", &order.seed.to_string(), "--json"]);
        if is_network {
            command.args(["--listen", "127.0.0.1:0"]);
        } else {
            command.arg("--pty").arg(file(".pty"));
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        command.stderr(File::create(file(".txt"))?);
        let mut child = process::start(command)?;
        match ready(&mut child, order.stop, 60.0) {
            Ok(address) => Ok(Self { child, address, is_network }),
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                let messages = fs::read_to_string(file(".txt")).unwrap_or_default();
                let last = messages.lines().last().unwrap_or_default();
                let text = format!("it did not start: {error} {last}");
                Err(io::Error::other(text.trim_end().to_owned()))
            }
        }
    }

    /// As `--port` takes it.
    pub(super) fn port(&self) -> String {
        if self.is_network { format!("tcp:{}", self.address) } else { self.address.clone() }
    }

    pub(super) fn is_gone(&mut self) -> bool {
        !self.child.try_wait().is_ok_and(|ended| ended.is_none())
    }
}

impl Drop for OwnDrive {
    fn drop(&mut self) {
        if matches!(process::end(&mut self.child, 10.0), Ok(None)) && !self.is_network {
            // The name would lead to whichever drive is given the terminal's number next.
            let _ = fs::remove_file(&self.address);
        }
    }
}

/// The address that a drive prints once it can be opened.
fn ready(child: &mut Child, stop: &AtomicBool, limit_s: f64) -> io::Result<String> {
    let no_line = || io::Error::other("it has not printed its address;");
    let stdout = child.stdout.as_mut().ok_or_else(no_line)?;
    process::do_not_block(&*stdout)?;
    let (mut printed, mut bytes) = (Vec::new(), [0; 1024]);
    let watch = Watch::start();
    while !printed.contains(&b'\n') {
        if stop.load(Ordering::Acquire) {
            return Err(io::Error::other("interrupted"));
        }
        if watch.took_s() > limit_s {
            return Err(io::Error::other(format!("not ready in {limit_s} s;")));
        }
        match stdout.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) => printed.extend_from_slice(&bytes[..count]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(process::POLL);
            }
            Err(error) => return Err(error),
        }
    }
    let line = printed.split(|byte| *byte == b'\n').next();
    let ready: Value = serde_json::from_slice(line.unwrap_or_default()).unwrap_or_default();
    ready.get("address").and_then(Value::as_str).map(str::to_owned).ok_or_else(no_line)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Address of a process that runs this script.
    fn opened(script: &str, stop: bool) -> Result<String, String> {
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdout(Stdio::piped());
        let mut child = process::start(command).unwrap();
        let found = ready(&mut child, &AtomicBool::new(stop), 0.5);
        child.kill().unwrap();
        child.wait().unwrap();
        found.map_err(|error| error.to_string())
    }

    #[test]
    fn the_wait_for_the_address_of_a_drive_is_bounded() {
        for (case, script, stop, expected) in [
            ("ready", "echo '{\"address\": \"x\"}'; exec sleep 60", false, Ok("x")),
            ("silent", "exec sleep 60", false, Err("not ready in 0.5 s;")),
            ("interrupted", "exec sleep 60", true, Err("interrupted")),
            ("no address", "echo no", false, Err("it has not printed its address;")),
        ] {
            let found = opened(script, stop);
            assert_eq!(found.as_deref().map_err(String::as_str), expected, "{case}");
        }
    }
}
