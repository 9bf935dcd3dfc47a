//! A pseudo-terminal as serial port: one fresh pair per session, behind a stable path.
//!
//! ```text
//! stable path --symlink--> /dev/pts/N (slave: the host opens it) <==> master (raw, non-blocking: the drive)
//! ```
//!
//! One drive per path: the serving process holds an abstract socket named after the path, which the kernel releases when the
//! process ends for whatever reason. A symlink left behind is then replaced.
//!
//! A new pair per session, because after the last close of a slave its master reports a hang-up until the next open, hands bytes
//! written meanwhile to the next client, and keeps the exclusive flag of a killed client. A host that opened the path between the
//! hang-up and the next pair stays on this one. The emulator holds no slave open, because a hang-up would not show then. Linux
//! only: there raw mode can be set on the master.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::sys::time::TimeSpec;

use super::session::{Gone, Port};
use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};

/// Where the kernel keeps the slaves.
const SLAVES: &str = "/dev/pts";

/// Lock on a path: this process alone serves it.
pub(super) struct Claim {
    _socket: UnixDatagram,
}

impl Claim {
    /// Refused while another drive serves `stable`, and where something else than a link to a pseudo-terminal is there.
    pub(super) fn of(stable: &Path) -> io::Result<Self> {
        check_free(stable)?;
        let folder = match stable.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let mut name = b"drivebench-pty-".to_vec();
        // The name has room for 107 bytes; two paths of one hash (FNV-1a) would be refused, not mixed up.
        let path = folder.canonicalize()?.join(stable.file_name().unwrap_or_default());
        let hash = fnv_1a(EMPTY, path.as_os_str().as_bytes().iter().copied());
        name.extend_from_slice(format!("{hash:016x}").as_bytes());
        let address = SocketAddr::from_abstract_name(name)?;
        match UnixDatagram::bind_addr(&address) {
            Ok(socket) => Ok(Self { _socket: socket }),
            Err(error) if error.kind() == ErrorKind::AddrInUse => Err(io::Error::new(
                ErrorKind::AddrInUse,
                "another emulator serves a drive there, and still runs",
            )),
            Err(error) => Err(error),
        }
    }
}

/// Whether `stable` may be made a link: nothing is there, or a link to a pseudo-terminal.
fn check_free(stable: &Path) -> io::Result<()> {
    let Ok(existing) = fs::symlink_metadata(stable) else { return Ok(()) };
    let taken = |what: String| Err(io::Error::new(ErrorKind::AlreadyExists, what));
    if !existing.file_type().is_symlink() {
        return taken("something that is not a symlink is there".to_owned());
    }
    let target = fs::read_link(stable)?;
    if target.starts_with(SLAVES) {
        Ok(())
    } else {
        taken(format!("a symlink to {} is there, which is no emulator's", target.display()))
    }
}

/// The drive's end of a pseudo-terminal.
pub(crate) struct PtyPort {
    master: PtyMaster,
    slave: PathBuf,
    hung_up: bool,
}

impl PtyPort {
    /// A new pair, in raw mode before its path is published.
    pub(crate) fn open() -> io::Result<Self> {
        let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
        let master = posix_openpt(flags)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let mut termios = tcgetattr(&master)?;
        cfmakeraw(&mut termios);
        tcsetattr(&master, SetArg::TCSANOW, &termios)?;
        let slave = PathBuf::from(ptsname_r(&master)?);
        let hung_up = false;
        Ok(Self { master, slave, hung_up })
    }

    /// Whether a new host has opened the slave since the hang-up; it is then served like the first.
    pub(crate) fn taken_again(&mut self) -> bool {
        let mut fds = [PollFd::new(self.master.as_fd(), PollFlags::POLLIN)];
        let polled = ppoll(&mut fds, Some(TimeSpec::from_duration(Duration::ZERO)), None);
        let nobody = polled.is_err()
            || (fds[0].revents()).is_none_or(|seen| seen.contains(PollFlags::POLLHUP));
        let again = self.hung_up && !nobody;
        self.hung_up &= !again;
        again
    }

    /// Makes `stable` lead to this pair; the change is atomic. What is there and no link of an emulator is left alone.
    pub(crate) fn publish(&self, stable: &Path) -> io::Result<()> {
        check_free(stable)?;
        let mut fresh = stable.as_os_str().to_owned();
        fresh.push(".new");
        match fs::remove_file(&fresh) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        symlink(&self.slave, &fresh)?;
        fs::rename(&fresh, stable)
    }

    /// Removes `stable` if it still leads here.
    pub(crate) fn unpublish(&self, stable: &Path) {
        if fs::read_link(stable).is_ok_and(|target| target == self.slave) {
            // Nothing can be done about a path that cannot be removed, and nothing depends on it.
            let _ = fs::remove_file(stable);
        }
    }
}

impl Port for PtyPort {
    fn read_within(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, Gone> {
        let mut fds = [PollFd::new(self.master.as_fd(), PollFlags::POLLIN)];
        // An interrupted wait is a short wait.
        let _ = ppoll(&mut fds, Some(TimeSpec::from_duration(timeout)), None);
        match (&self.master).read(buffer) {
            Ok(bytes @ 1..) => Ok(bytes),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                Ok(0)
            }
            // EIO: the last slave was closed and everything it wrote has been read.
            Ok(0) | Err(_) => {
                self.hung_up = true;
                Err(Gone)
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        let mut taken = 0;
        while taken < bytes.len() {
            match (&self.master).write(&bytes[taken..]) {
                Ok(0) => break,
                Ok(count) => taken += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_there_is_not_a_hang_up_and_a_close_is_one() {
        let mut port = PtyPort::open().unwrap();
        let mut buffer = [0; 64];
        assert_eq!(port.read_within(&mut buffer, Duration::from_millis(1)), Ok(0));
        let host = fs::File::options().read(true).write(true).open(&port.slave).unwrap();
        // Control characters would be eaten, echoed or changed on a cooked terminal.
        let bytes = [0x03, 0x04, 0x0D, 0x0A, 0x11, 0x13, 0x1A, 0x7F, 0xFF, 0x00];
        (&host).write_all(&bytes).unwrap();
        drop(host);
        let mut seen = Vec::new();
        loop {
            match port.read_within(&mut buffer, Duration::from_secs(5)) {
                Ok(0) => panic!("neither bytes nor hang-up"),
                Ok(count) => seen.extend_from_slice(&buffer[..count]),
                Err(Gone) => break,
            }
        }
        assert_eq!(seen, bytes);
    }

    #[test]
    fn a_host_that_opens_the_old_pair_again_is_served() {
        let mut port = PtyPort::open().unwrap();
        let slave = port.slave.clone();
        let host = || fs::File::options().read(true).write(true).open(&slave).unwrap();
        let first = host();
        assert!(!port.taken_again(), "nobody has gone");
        drop(first);
        let mut buffer = [0; 64];
        let patience = Duration::from_secs(5);
        assert_eq!(port.read_within(&mut buffer, patience), Err(Gone));
        assert!(!port.taken_again(), "nobody has come");
        let mut second = host();
        assert!(port.taken_again());
        assert!(!port.taken_again(), "it is served, and has not gone");
        second.write_all(b"here").unwrap();
        assert_eq!(port.read_within(&mut buffer, patience), Ok(4));
        assert_eq!(port.write(b"there"), 5);
        let mut answer = [0; 5];
        second.read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"there");
    }

    #[test]
    fn a_host_that_does_not_read_blocks_nobody() {
        let mut port = PtyPort::open().unwrap();
        let _host = fs::File::options().read(true).write(true).open(&port.slave).unwrap();
        assert!(port.write(&vec![0x55; 1 << 20]) < 1 << 20);
    }

    #[test]
    fn the_stable_path_moves_on_and_a_file_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let stable = folder.path().join("drive");
        let (first, second) = (PtyPort::open().unwrap(), PtyPort::open().unwrap());
        first.publish(&stable).unwrap();
        second.publish(&stable).unwrap();
        assert_eq!(fs::read_link(&stable).unwrap(), second.slave);
        first.unpublish(&stable);
        assert!(fs::symlink_metadata(&stable).is_ok(), "it leads to the second by now");
        second.unpublish(&stable);
        assert!(fs::symlink_metadata(&stable).is_err());
        fs::write(&stable, "mine").unwrap();
        assert!(first.publish(&stable).is_err());
        assert_eq!(fs::read_to_string(&stable).unwrap(), "mine");
    }

    #[test]
    fn a_path_has_one_drive_and_a_link_that_was_left_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let stable = folder.path().join("drive");
        let claim = Claim::of(&stable).unwrap();
        let again = folder.path().join(".").join("drive");
        let error = Claim::of(&again).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::AddrInUse);
        assert!(Claim::of(&folder.path().join("other")).is_ok());
        drop(claim);
        // As a killed emulator leaves it.
        symlink("/dev/pts/4000000", &stable).unwrap();
        let port = PtyPort::open().unwrap();
        let _claim = Claim::of(&stable).unwrap();
        port.publish(&stable).unwrap();
        assert_eq!(fs::read_link(&stable).unwrap(), port.slave);
        let foreign = folder.path().join("foreign");
        symlink("/dev/null", &foreign).unwrap();
        let error = Claim::of(&foreign).err().unwrap();
        assert!(error.to_string().contains("/dev/null"), "{error}");
        assert_eq!(fs::read_link(&foreign).unwrap(), Path::new("/dev/null"));
    }
}
