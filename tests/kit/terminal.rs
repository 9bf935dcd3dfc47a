//! The program in a real pseudo-terminal of any size: the screen as a person sees it, keys as a person presses them.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use portable_pty::{Child, CommandBuilder, MasterPty, PtyPair, PtySize, native_pty_system};

/// Generous, because tests share the machine; nothing here waits for time to pass.
const PATIENCE: Duration = Duration::from_secs(120);

/// A pseudo-terminal of `(columns, rows)`.
pub(crate) fn open((cols, rows): (u16, u16)) -> PtyPair {
    let (pixel_width, pixel_height) = (0, 0);
    let size = PtySize {
        rows,
        cols,
        pixel_width,
        pixel_height,
    };
    native_pty_system()
        .openpty(size)
        .expect("a pseudo-terminal")
}

/// What stands on a screen of `(columns, rows)`.
pub(crate) fn parser((columns, rows): (u16, u16)) -> vt100::Parser {
    let [rows, columns] = [rows, columns].map(|count| count.try_into().expect("more than none"));
    vt100::Parser::new(rows, columns, 0)
}

/// A program in the terminal.
pub(crate) fn spawn(
    pair: &PtyPair,
    program: &str,
    arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    folder: &Path,
) -> Box<dyn Child + Send + Sync> {
    let mut command = CommandBuilder::new(program);
    command.args(arguments);
    command.cwd(folder);
    command.env("TERM", "xterm-256color");
    pair.slave.spawn_command(command).expect("it starts")
}

pub(crate) struct Session {
    pub(crate) screen: vt100::Parser,
    /// Every byte that came.
    pub(crate) sent: Vec<u8>,
    output: Receiver<Vec<u8>>,
    keys: Box<dyn Write + Send>,
    child: Box<dyn Child + Send + Sync>,
    /// Modes of the terminal before the program was started.
    modes: String,
    master: Box<dyn MasterPty + Send>,
}

impl Session {
    /// `(columns, rows)`.
    pub(crate) fn start(
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
        folder: &Path,
        (columns, rows): (u16, u16),
    ) -> Self {
        let pair = open((columns, rows));
        let modes = modes(pair.master.as_ref());
        let child = spawn(&pair, super::BINARY, arguments, folder);
        drop(pair.slave);
        let mut reader = pair.master.try_clone_reader().unwrap();
        let keys = pair.master.take_writer().unwrap();
        let (sender, output) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            screen: parser((columns, rows)),
            sent: Vec::new(),
            output,
            keys,
            child,
            modes,
            master: pair.master,
        }
    }

    pub(crate) fn text(&self) -> String {
        self.screen.screen().contents()
    }

    fn take(&mut self, bytes: &[u8]) {
        self.screen.process(bytes);
        self.sent.extend(bytes);
    }

    fn read_until(&mut self, what: &str, wanted: impl Fn(&Self) -> bool) {
        while !wanted(self) {
            match self.output.recv_timeout(PATIENCE) {
                Ok(bytes) => self.take(&bytes),
                Err(RecvTimeoutError::Timeout) => {
                    panic!("waited in vain for {what}:\n{}", self.text())
                }
                Err(RecvTimeoutError::Disconnected) => {
                    panic!("the program ended before {what}:\n{}", self.text())
                }
            }
        }
    }

    /// Reads on until the screen is as wanted.
    pub(crate) fn wait(&mut self, what: &str, wanted: impl Fn(&vt100::Screen) -> bool) {
        self.read_until(what, |session| wanted(session.screen.screen()));
    }

    pub(crate) fn wait_for(&mut self, text: &str) {
        self.wait(text, |screen| screen.contents().contains(text));
    }

    /// Reads on until this has been sent, even if it is wiped away again.
    pub(crate) fn wait_for_sent(&mut self, text: &str) {
        self.read_until(text, |session| {
            String::from_utf8_lossy(&session.sent).contains(text)
        });
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let id = self.child.process_id().unwrap();
        kill(Pid::from_raw(id.cast_signed()), signal).unwrap();
    }

    pub(crate) fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Exit status, after everything that was still to be read.
    pub(crate) fn end(&mut self) -> u32 {
        while let Ok(bytes) = self.output.recv_timeout(PATIENCE) {
            self.take(&bytes);
        }
        self.child.wait().unwrap().exit_code()
    }

    /// Closes the terminal under the program; its exit status.
    pub(crate) fn close(self) -> u32 {
        let mut child = self.child;
        // The reader's thread ends with the next frame, for which nobody waits any more.
        drop((self.output, self.keys, self.master));
        child.wait().unwrap().exit_code()
    }

    /// The shell gets the terminal as it was: its modes, its own screen, a cursor.
    #[track_caller]
    pub(crate) fn expect_terminal_as_it_was(&self) {
        assert_eq!(modes(self.master.as_ref()), self.modes);
        assert!(!self.screen.screen().alternate_screen());
        assert!(!self.screen.screen().hide_cursor());
    }
}

fn modes(master: &dyn MasterPty) -> String {
    format!("{:?}", master.get_termios().unwrap())
}
