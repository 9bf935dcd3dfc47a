//! The witness at a pseudo-terminal, in real time: a thread that carries bytes, and measures when it itself stood still.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::os::fd::AsFd;
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::{read, write};

use crate::witness::drive::Drive;

/// A witness that stood still for longer than this has no record of what happened meanwhile, s.
pub(crate) const STOOD_STILL_S: f64 = 0.02;

#[expect(clippy::disallowed_methods, reason = "the witness keeps the time of its log")]
pub(crate) fn now() -> Instant {
    Instant::now()
}

pub(crate) struct Shared {
    pub(crate) drive: Drive,
    /// From when it stood still, or the program was kept from running, and for how long, s.
    pub(crate) gaps: Vec<(f64, f64)>,
}

/// Dropping it ends the drive.
pub(crate) struct Line {
    origin: Instant,
    shared: Arc<Mutex<Shared>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Line {
    /// The terminal has a name of its own, which goes when it is unplugged: its number may then be somebody else's.
    pub(crate) fn open(drive: Drive, path: PathBuf) -> Self {
        // Nobody who is started meanwhile may inherit it, or it would stay open.
        let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC | OFlag::O_NONBLOCK;
        let master = posix_openpt(flags).expect("a pseudo-terminal");
        grantpt(&master).expect("granted");
        unlockpt(&master).expect("unlocked");
        let device = ptsname_r(&master).expect("a path");
        let slave = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(OFlag::O_NOCTTY.bits())
            .open(&device)
            .expect("the other end");
        let mut modes = tcgetattr(&slave).expect("modes of a terminal");
        cfmakeraw(&mut modes);
        tcsetattr(&slave, SetArg::TCSANOW, &modes).expect("raw modes");
        symlink(&device, &path).expect("a name");
        let origin = now();
        let gaps = Vec::new();
        let shared = Arc::new(Mutex::new(Shared { drive, gaps }));
        let ended = Arc::new(AtomicBool::new(false));
        let (mine, over) = (Arc::clone(&shared), Arc::clone(&ended));
        // The slave stays open here, so that the line is there before and after the host.
        let thread = std::thread::spawn(move || {
            carry((master, slave), &path, origin, &mine, &over);
        });
        Self { origin, shared, ended, thread: Some(thread) }
    }

    pub(crate) fn now_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64()
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().expect("the witness lives")
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn carry(
    ends: (PtyMaster, File),
    name: &Path,
    origin: Instant,
    shared: &Mutex<Shared>,
    ended: &AtomicBool,
) {
    let mut ends = Some(ends);
    let mut coming: BTreeMap<(Duration, u64), Vec<u8>> = BTreeMap::new();
    let (mut count, mut last_s) = (0, 0.0);
    while !ended.load(Ordering::Acquire) {
        let mut bytes = [0; 512];
        let heard = if let Some((master, _)) = &ends {
            let mut fds = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
            match poll(&mut fds, PollTimeout::from(1_u8)) {
                Ok(1..) => read(master, &mut bytes).unwrap_or(0),
                _ => 0,
            }
        } else {
            std::thread::sleep(Duration::from_millis(1));
            0
        };
        let now_s = origin.elapsed().as_secs_f64();
        let mut state = shared.lock().expect("the test lives");
        if now_s - last_s > STOOD_STILL_S {
            state.gaps.push((last_s, now_s - last_s));
        }
        last_s = now_s;
        if heard > 0 {
            for (at_s, bytes) in state.drive.hear(now_s, &bytes[..heard]) {
                count += 1;
                coming.insert((Duration::from_secs_f64(at_s), count), bytes);
            }
        } else {
            state.drive.advance(now_s);
        }
        if state.drive.is_unplugged() && ends.take().is_some() {
            let _ = std::fs::remove_file(name);
        }
        drop(state);
        while let Some(first) = coming.first_entry()
            && first.key().0 <= origin.elapsed()
        {
            let bytes = first.remove();
            if let Some((master, _)) = &ends {
                let _ = write(master, &bytes);
            }
        }
    }
}
