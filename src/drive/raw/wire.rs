//! A serial port or a network connection as a non-blocking descriptor that is waited on with `ppoll`: three system calls
//! for an exchange and one to see that nothing lies on the line. No reactor.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::io::Errno;
use rustix::termios::{
    ControlModes, OptionalActions, Termios, ioctl_tiocexcl, ioctl_tiocnxcl, tcgetattr, tcsetattr,
};

use super::super::link::LinkError;
use super::super::port::{connect, open_error};
use super::super::serial_ports::holder_names;
use super::super::settings::Framing;

/// The descriptor, and what is to be put back when it is closed.
pub(super) struct Wire {
    fd: OwnedFd,
    /// Settings of the port before we came.
    before: Option<Termios>,
    /// Ends of a network connection: ours and the peer's.
    pub(super) ends: Option<(SocketAddr, SocketAddr)>,
}

impl Wire {
    /// Opens a serial port for ourselves alone.
    ///
    /// Root ignores the exclusive mark, so the port is locked as well.
    pub(super) fn serial(path: &str, baud: u32, framing: Framing) -> Result<Self, LinkError> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let cannot = |error: Errno| open_error(path, &error.into());
        let fd = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
            Errno::BUSY => held(path),
            other => cannot(other),
        })?;
        match flock(&fd, FlockOperation::NonBlockingLockExclusive) {
            Err(Errno::AGAIN) => return Err(held(path)),
            other => other.map_err(cannot)?,
        }
        let before = tcgetattr(&fd).map_err(|error| match error {
            Errno::NOTTY => open(path, "it is no serial port"),
            other => cannot(other),
        })?;
        ioctl_tiocexcl(&fd).map_err(cannot)?;
        let mut termios = before.clone();
        set(&mut termios, baud, framing).map_err(cannot)?;
        // A pseudo-terminal clears parity without a word, so what was set is not read back and compared.
        tcsetattr(&fd, OptionalActions::Now, &termios).map_err(cannot)?;
        Ok(Self {
            fd,
            before: Some(before),
            ends: None,
        })
    }

    pub(super) fn tcp(name: &str, host: &str, port: u16) -> Result<Self, LinkError> {
        let stream = connect(name, host, port)?;
        let cannot = |error: io::Error| open(name, &error.to_string());
        stream.set_nonblocking(true).map_err(cannot)?;
        let ends = (
            stream.local_addr().map_err(cannot)?,
            stream.peer_addr().map_err(cannot)?,
        );
        Ok(Self {
            fd: stream.into(),
            before: None,
            ends: Some(ends),
        })
    }

    /// What is there now; `None`: nothing. An end of file is an error, so that nobody asks a port that is gone again
    /// and again.
    pub(super) fn read(&self, bytes: &mut [u8]) -> io::Result<Option<usize>> {
        match rustix::io::read(&self.fd, bytes) {
            Ok(0) => Err(io::Error::new(
                ErrorKind::BrokenPipe,
                "the other end closed",
            )),
            Ok(count) => Ok(Some(count)),
            Err(Errno::AGAIN | Errno::INTR) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Hands over what the kernel has room for; returns the bytes taken.
    pub(super) fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        match rustix::io::write(&self.fd, bytes) {
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            other => Ok(other?),
        }
    }

    /// Waits for bytes, or no longer than this. An interrupted wait is a short one.
    pub(super) fn wait_readable(&self, longest: Duration) -> io::Result<()> {
        self.wait(PollFlags::IN, longest)
    }

    pub(super) fn wait_writable(&self, longest: Duration) -> io::Result<()> {
        self.wait(PollFlags::OUT, longest)
    }

    fn wait(&self, what: PollFlags, longest: Duration) -> io::Result<()> {
        let mut fds = [PollFd::new(&self.fd, what)];
        let longest = Timespec {
            tv_sec: i64::try_from(longest.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: longest.subsec_nanos().into(),
        };
        match poll(&mut fds, Some(&longest)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // A port that is gone needs no tidying.
            let _ = tcsetattr(&self.fd, OptionalActions::Now, before);
            let _ = ioctl_tiocnxcl(&self.fd);
        }
    }
}

/// Raw bytes, no modem lines, no hang-up of the peer when we close.
fn set(termios: &mut Termios, baud: u32, framing: Framing) -> rustix::io::Result<()> {
    termios.make_raw();
    let modes = &mut termios.control_modes;
    modes.remove(
        ControlModes::PARENB
            | ControlModes::PARODD
            | ControlModes::CSTOPB
            | ControlModes::CRTSCTS
            | ControlModes::HUPCL,
    );
    modes.insert(ControlModes::CREAD | ControlModes::CLOCAL);
    match framing {
        Framing::EightNoneOne => {}
        Framing::EightEvenOne => modes.insert(ControlModes::PARENB),
        Framing::EightOddOne => modes.insert(ControlModes::PARENB | ControlModes::PARODD),
        Framing::EightNoneTwo => modes.insert(ControlModes::CSTOPB),
    }
    termios.set_speed(baud)
}

fn open(link: &str, reason: &str) -> LinkError {
    LinkError::Open(link.to_owned(), reason.to_owned())
}

/// Someone else has the port: who?
fn held(path: &str) -> LinkError {
    let nobody = || "another program holds it".to_owned();
    let reason = holder_names(path).map_or_else(nobody, |names| format!("held by {names}"));
    open(path, &reason)
}
