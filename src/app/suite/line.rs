//! What stands between a command and its software drive where the line itself is to fail: it carries bytes, until it is told to
//! go, to carry nothing, or to lead to another drive.
//!
//! ```text
//! command --> PATH or 127.0.0.1:PORT == Line == terminal or connection of the drive
//! ```

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest wait for bytes, after which it looks at what it is told.
const LOOK_MS: u8 = 2;
const LOOK: Duration = Duration::from_millis(2);

/// What the line does with what comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Carries {
    Everything,
    /// It is there, and nothing goes through.
    Nothing,
    /// It is not there: the terminal is gone, or a connection closed, and none can be made.
    Gone,
    /// As `Gone`, with a reset in place of the end of a TCP connection.
    Reset,
}

impl Carries {
    const ALL: [Self; 4] = [Self::Everything, Self::Nothing, Self::Gone, Self::Reset];
}

#[derive(Default)]
struct Told {
    carries: AtomicU8,
    over: AtomicBool,
    /// Where it leads from the next time that it is there.
    next: Mutex<Option<File>>,
}

impl Told {
    fn carries(&self) -> Carries {
        let told = self.carries.load(Ordering::Acquire);
        let known = Carries::ALL.into_iter().find(|one| *one as u8 == told);
        known.unwrap_or(Carries::Gone)
    }

    fn is_over(&self) -> bool {
        self.over.load(Ordering::Acquire)
    }

    #[cfg(target_os = "linux")]
    fn next(&self) -> Option<File> {
        self.next
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }
}

/// Dropping it takes the line away.
pub(super) struct Line {
    /// As `--port` takes it.
    pub(super) port: String,
    told: Arc<Told>,
    thread: Option<JoinHandle<()>>,
}

impl Line {
    /// A line to the terminal `drive`, under the name `path`.
    #[cfg(target_os = "linux")]
    pub(super) fn to_terminal(drive: &str, path: &Path) -> io::Result<Self> {
        let near = crate::emulator::PtyPort::open()?;
        near.publish(path)?;
        let far = terminal(drive)?;
        let name = path.to_owned();
        Self::of(path.display().to_string(), move |told| {
            carry_terminal(near, far, &name, told);
        })
    }

    #[cfg(not(target_os = "linux"))]
    pub(super) fn to_terminal(_drive: &str, _path: &Path) -> io::Result<Self> {
        Err(ErrorKind::Unsupported.into())
    }

    /// A line to the TCP server `drive`, on a port of its own.
    pub(super) fn to_server(drive: &str) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let port = format!("tcp:{}", listener.local_addr()?);
        let drive = drive.to_owned();
        Self::of(port, move |told| carry_connections(&listener, &drive, told))
    }

    fn of(port: String, carry: impl FnOnce(&Told) + Send + 'static) -> io::Result<Self> {
        let told = Arc::new(Told::default());
        let heard = Arc::clone(&told);
        let thread = std::thread::Builder::new().name("line".to_owned());
        let thread = thread.spawn(move || carry(&heard))?;
        Ok(Self {
            port,
            told,
            thread: Some(thread),
        })
    }

    pub(super) fn set(&self, carries: Carries) {
        self.told.carries.store(carries as u8, Ordering::Release);
    }

    /// From the next time that it is there it leads to this terminal, which is opened at once: a line that cannot lead there
    /// leads nowhere.
    #[cfg(target_os = "linux")]
    pub(super) fn lead_to(&self, drive: &str) -> io::Result<()> {
        let cannot =
            |error| io::Error::other(format!("the line cannot be led to {drive}: {error}"));
        let drive = terminal(drive).map_err(cannot)?;
        let mut next = self
            .told
            .next
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        *next = Some(drive);
        Ok(())
    }

    #[cfg(not(target_os = "linux"))]
    pub(super) fn lead_to(&self, _drive: &str) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.told.over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(target_os = "linux")]
fn terminal(path: &str) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt as _;
    let flags = nix::fcntl::OFlag::O_NOCTTY | nix::fcntl::OFlag::O_NONBLOCK;
    let mut options = File::options();
    options.read(true).write(true).custom_flags(flags.bits());
    options.open(path)
}

/// The drive hears nothing while the line is gone; that its host has closed a terminal it does not hear either.
#[cfg(target_os = "linux")]
fn carry_terminal(near: crate::emulator::PtyPort, mut far: File, name: &Path, told: &Told) {
    use std::os::fd::AsFd as _;

    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

    use crate::emulator::{Port as _, PtyPort};

    let fresh = || -> io::Result<PtyPort> {
        let port = PtyPort::open()?;
        port.publish(name)?;
        Ok(port)
    };
    let mut near = Some(near);
    let mut bytes = [0; 1024];
    while !told.is_over() {
        let carries = told.carries();
        if matches!(carries, Carries::Gone | Carries::Reset) {
            if let Some(port) = near.take() {
                port.unpublish(name);
            }
            std::thread::sleep(LOOK);
            continue;
        }
        if near.is_none() {
            far = told.next().unwrap_or(far);
            near = fresh().ok();
        }
        let Some(port) = &mut near else {
            std::thread::sleep(LOOK);
            continue;
        };
        let mut fds = [
            PollFd::new(port.as_fd(), PollFlags::POLLIN),
            PollFd::new(far.as_fd(), PollFlags::POLLIN),
        ];
        // An interrupted wait is a short wait.
        let _ = poll(&mut fds, PollTimeout::from(LOOK_MS));
        let passes = carries == Carries::Everything;
        match port.read_within(&mut bytes, Duration::ZERO) {
            Ok(0) => {}
            // What a line has no room for is lost, as on a real one.
            Ok(count) if passes => drop(far.write_all(&bytes[..count])),
            Ok(_) => {}
            // The host has closed it: the next one finds a terminal without a past.
            Err(_) => {
                near = fresh().ok();
                continue;
            }
        }
        if let Ok(count @ 1..) = far.read(&mut bytes)
            && passes
        {
            port.write(&bytes[..count]);
        }
    }
    if let Some(port) = near {
        port.unpublish(name);
    }
}

fn carry_connections(listener: &TcpListener, drive: &str, told: &Told) {
    while !told.is_over() {
        let Ok((host, _)) = listener.accept() else {
            std::thread::sleep(LOOK);
            continue;
        };
        if matches!(told.carries(), Carries::Gone | Carries::Reset) {
            continue;
        }
        if let Ok(drive) = TcpStream::connect(drive) {
            carry_connection(&host, &drive, told);
        }
    }
}

/// Until an end closes, or the line is told to go.
fn carry_connection(host: &TcpStream, drive: &TcpStream, told: &Told) {
    for stream in [host, drive] {
        let _ = stream.set_nonblocking(true);
        let _ = stream.set_nodelay(true);
    }
    let mut bytes = [0; 1024];
    while !told.is_over() {
        let carries = told.carries();
        match carries {
            Carries::Gone => {
                let _ = host.shutdown(Shutdown::Both);
                return;
            }
            // What has come and is not read when it is closed makes the system answer with a reset.
            Carries::Reset => {
                if host.peek(&mut bytes).is_ok_and(|count| count > 0) {
                    return;
                }
                std::thread::sleep(Duration::from_micros(200));
                continue;
            }
            Carries::Everything | Carries::Nothing => {}
        }
        let mut has_come = false;
        for (mut from, mut to) in [(host, drive), (drive, host)] {
            match from.read(&mut bytes) {
                Ok(0) => return,
                Ok(count) => {
                    has_come = true;
                    if carries == Carries::Everything && to.write_all(&bytes[..count]).is_err() {
                        return;
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(_) => return,
            }
        }
        if !has_come {
            std::thread::sleep(Duration::from_micros(200));
        }
    }
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_cannot_lead_to_another_drive_says_so() {
        use crate::emulator::PtyPort;

        let folder = tempfile::tempdir().unwrap();
        let [drive, path] = ["drive", "line"].map(|name| folder.path().join(name));
        let terminal = PtyPort::open().unwrap();
        terminal.publish(&drive).unwrap();
        let line = Line::to_terminal(drive.to_str().unwrap(), &path).unwrap();
        line.set(Carries::Gone);
        let absent = folder.path().join("absent");
        let error = line.lead_to(absent.to_str().unwrap()).unwrap_err();
        assert!(error.to_string().contains("cannot be led to"), "{error}");
        line.lead_to(drive.to_str().unwrap()).unwrap();
    }
}
